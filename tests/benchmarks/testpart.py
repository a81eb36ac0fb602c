"""What a test part is worth: simulated robots mill it, it is probed, and the model is identified from it.

    python -m tests.benchmarks.testpart --robots 40
    python -m tests.benchmarks.testpart --robots 40 --rich      gears that bend, links that are flexible
    python -m tests.benchmarks.testpart --random 200            the chosen part against parts taken at random
    python -m tests.benchmarks.testpart --drift 20              a smaller part again: nothing, a joint or all changed
    python -m tests.benchmarks.testpart --drift 20 --weight 20  the same with a weight on the tool [kg]

Compliances differ from the model by 30 % (log-normal), forces by 10 %, the probe has a noise of 5 µm. The part is cut
by `tests.testpart.machine`. Errors are those of the deflection on 40 places of other jobs of the cell, under forces
scaled as found.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from postproc.report.testpart import design_lines
from postproc.testpart import design
from tests.testpart import trial


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--robots", type=int, default=0)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--rich", action="store_true")
    options.add_argument("--random", type=int, default=0)
    options.add_argument("--drift", type=int, default=0)
    options.add_argument("--weight", type=float, default=0.0)
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if given.drift:
            part = trial.part(
                Path(folder), box=((0, 150), (0, 120), (-40, 0)), count=8, resolution=0.5, mass=given.weight
            )
            for line in design_lines(part.chosen, part.prior, part.cutting, part.made):
                print(line, flush=True)
            drift(part, given.first, given.drift)
            return
        part = trial.part(Path(folder), resolution=0.5)
        chosen = part.chosen
        print(
            f"{len(chosen.features)} features, {chosen.seconds / 60:.1f} min; expected error before "
            f"{1e6 * chosen.before:.1f} µm, after {1e6 * chosen.after:.2f} µm, of {1e6 * chosen.deflection:.0f} µm",
            flush=True,
        )
        if given.random:
            rng, tests = np.random.default_rng(7), design.tests_in_block(part.found)
            others = [trial.at_random(part.found, chosen.seconds, rng) for _ in range(given.random)]
            after = [
                design.evaluate(part.found, part.prior, part.robot_in_cell, tests, other).after for other in others
            ]
            print(f"{given.random} random parts: best {1e6 * min(after):.2f}, median {1e6 * np.median(after):.2f} µm")
        rows = []
        for seed in range(given.first, given.first + given.robots):
            one = trial.worth(part, seed, "rich" if given.rich else "joints")
            rows.append((one.after / one.before, one.inside, one.bound / one.after))
            print(
                f"robot {seed}: {1e6 * one.before:.1f} → {1e6 * one.after:.1f} µm of {1e6 * one.size:.0f}, "
                f"inside {one.inside:.2f}, "
                f"bound {1e6 * one.bound:.1f} ({1e6 * one.apart:.1f} apart), scale {one.fit.scale / one.scale:.3f}, "
                f"γ {one.fit.gamma:.4f}, left out {len(one.left_out)}",
                flush=True,
            )
        if rows:
            ratio, inside, wide = np.array(rows).T
            print(f"left of the error: median {np.median(ratio):.2f}, worst {ratio.max():.2f}; "
                  f"inside the bound {inside.mean():.3f}, least {inside.min():.2f}; "
                  f"bound over error (RMS) {wide.min():.1f} to {wide.max():.1f}")  # fmt: skip


def drift(part, first, robots):
    every = []
    for seed in range(first, first + robots):
        every.append(trial.drifts(part, seed))
        print(
            f"robot {seed}: " + " ".join(f"{one.chance:.3f}{' ' if one.holds else '!'}" for one in every[-1]),
            flush=True,
        )
    for number, case in enumerate(trial.DRIFTS):
        off = np.mean([not one[number].holds for one in every])
        print(f"{case or 'nothing changed'}: {100 * off:.0f} % do not hold")


if __name__ == "__main__":
    main()
