"""The surface map where passes overlap, against a height field swept by the deflected tool.

Run: python -m tests.benchmarks.surface [--seeds N]

Draws floors, freeform surfaces and walls, their tools, passes and deviations of up to 0.4 mm. Prints for each kind the
share of places whose change is off by more than 20 µm, and the largest error.
"""

from __future__ import annotations

import argparse

import numpy as np

from tests.report import overlapping

PLACES = 60
OFF = 2e-5


def main() -> None:
    """Print a line for each kind of job."""
    options = argparse.ArgumentParser()
    options.add_argument("--seeds", type=int, default=5)
    for kind, draw in overlapping.JOBS.items():
        errors, untouched = [], 0
        for seed in range(options.parse_args().seeds):
            job = draw(np.random.default_rng(1000 + seed), PLACES)
            exact = overlapping.exact(job, 5e-5)
            shown = overlapping.shown(job)
            counted = np.isfinite(exact) & shown.is_touched
            untouched += int((np.isfinite(exact) & ~shown.is_touched).sum())
            errors.append((shown.before - exact)[counted])
        error = np.abs(np.concatenate(errors))
        print(
            f"{kind:9} {len(error):4} places, {100.0 * np.mean(error > OFF):5.1f} % off by more than {OFF * 1e6:.0f} µm"
            f", largest {1e3 * error.max():.3f} mm, {untouched} not touched"
        )


if __name__ == "__main__":
    main()
