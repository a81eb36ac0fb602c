"""How often a tracker that was moved between two configurations is named, and one that was not is suspected.

Run: python -m tests.benchmarks.moved_tracker [ROBOTS] [--from SEED] [--shift MM]

Each robot is drawn at random: errors of the geometry of 0.3, 1 or 2 mm, gears that stiffen or not, half of them with
gears that turn wavily, 11 to 19 configurations, in any order or sorted by a joint. Each is read twice, with the tracker
where it was and moved by the shift from a configuration on. Prints a line for each kind. No test: it takes half a
second for each robot.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from postproc.identification.measurement_model import locate
from postproc.identification.moved_device import moved_device
from samples.paper_study import harness, simulator

SIGMA = 0.05e-3
ERRORS = (3e-4, 1e-3, 2e-3)
WAVES = 1.5e-4


def warnings_of(q, force, raw) -> list[str]:
    """Return what is said of the measuring device."""
    with tempfile.TemporaryDirectory() as folder:
        data = harness.load(simulator.write(Path(folder), q, force, raw, SIGMA))
    return moved_device(harness.PRIOR, data, locate(harness.PRIOR, data))


def main() -> None:
    """Print counts by error of the geometry and order of the configurations."""
    options = argparse.ArgumentParser()
    options.add_argument("robots", type=int, nargs="?", default=120)
    options.add_argument("--from", dest="seed", type=int, default=5000)
    options.add_argument("--shift", type=float, default=3.0, help="mm")
    given = options.parse_args()
    count, suspected, named = Counter(), Counter(), Counter()
    for seed in range(given.seed, given.seed + given.robots):
        rng = np.random.default_rng(seed)
        error, poses, is_sorted = float(rng.choice(ERRORS)), int(rng.integers(11, 20)), bool(rng.integers(2))
        true = simulator.hard(rng, geometry=error, gear=str(rng.choice(["linear", "quadratic"])))
        if rng.integers(2):
            true.waves = WAVES * rng.normal(size=(6, 4))
        q, force = simulator.plan(rng, poses)
        if is_sorted:
            order = np.argsort(q[:, int(rng.integers(5))], kind="stable")
            q, force = q[order], force[order]
        _, raw = simulator.measure(true, q, 0.0 * force, rng, SIGMA)
        first, direction = int(rng.integers(4, poses - 3)), rng.normal(size=3)
        moved = raw.copy()
        moved[first:] += 1e-3 * given.shift * direction / np.linalg.norm(direction)
        kind = error, is_sorted
        count[kind] += 1
        suspected[kind] += bool(warnings_of(q, force, raw))
        texts = warnings_of(q, force, moved)
        named[kind] += bool(texts) and abs(int(texts[0].split("config ")[1].split()[0]) - (first + 1)) <= 1
    for error, is_sorted in sorted(count):
        kind = error, is_sorted
        order_text = "sorted by a joint" if is_sorted else "in any order"
        print(
            f"errors of {1e3 * error:.1f} mm, {order_text}: {count[kind]} robots, "
            f"{suspected[kind]} suspected, {named[kind]} moved by {given.shift:g} mm named"
        )


if __name__ == "__main__":
    main()
