"""How often loads of one level that are stated wrong are named, and right ones doubted.

Run: python -m tests.benchmarks.stated_levels [ROBOTS] [--from SEED]

Each robot is drawn at random: of the kinds of `tests.benchmarks.truth` or with gears that soften, in 10, 15 or 30
configurations under two or three loads, half of them each with backlash, lost motion, friction, breakpoints, a coupled
wrist, compliances over the pose, a payload that is not stated and noise common to a state. It is identified twice: with
the loads as they were, and with one level stated wrong by 10, 15 or 20 %. Prints a line for each, and how many were
named. No test: it takes half a minute for each robot.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from postproc.frames import norm
from postproc.identification.procedure import identify
from postproc.identification.readings import Measurements
from postproc.identification.uncertainty import levels
from samples.paper_study import harness, simulator
from tests.benchmarks import truth

SOFTENING = ({"gear": "softening", "links": "begin"}, {"gear": "softening", "links": "end", "feel_rest": False})
SHARES = ((0.2, 1.0), (0.4, 1.0), (0.2, 0.6, 1.0))
SIZES = (0.1, 0.15, 0.2)


class Gear(simulator.Gear):
    """A gear that may also soften: its secant stiffness falls to 0.7 k."""

    def torque(self, t):
        if self.kind != "softening":
            return super().torque(t)
        u = np.abs(t) / (0.2 * self.bend)
        stiffness = self.k * (1.0 - 0.3 * u / (1.0 + u))
        return stiffness * t, stiffness - self.k * 0.3 * u / (1.0 + u) ** 2


def robot_row(seed: int) -> truth.Row:
    """Return a way to measure a robot, drawn at random."""
    rng = np.random.default_rng(seed)
    kinds = (*truth.KINDS, *truth.VARIED, *SOFTENING)
    kind = kinds[int(rng.integers(len(kinds)))]

    def one_of_two(value: float) -> float:
        return float(rng.choice([0.0, value]))

    return truth.Row(
        "random",
        kinds=(kind,),
        poses=int(rng.choice([10, 15, 30])),
        levels=SHARES[int(rng.integers(len(SHARES)))],
        payload=one_of_two(150.0),
        backlash=one_of_two(0.05e-3),
        friction=one_of_two(0.05e-3),
        coupled=one_of_two(0.3),
        by_pose=one_of_two(0.15),
        knee=0.0 if kind in SOFTENING else one_of_two(0.1),
        lost_motion=one_of_two(0.05e-3),
        common=one_of_two(0.03e-3),
    )


def stated_wrong(data: Measurements, level: int, factor: float) -> Measurements:
    """Return readings whose loads of a level are stated as `factor` times what they were."""
    states = data.loaded_states[levels(norm(data.wrench[data.loaded_states])) == level]
    wrench = data.wrench.copy()
    wrench[states] *= factor
    return replace(data, wrench=wrench)


def doubt(data: Measurements) -> str:
    """Return the part of the verdict that names a level; empty if none does."""
    reservation = identify(harness.PRIOR, data).judgement.reservation
    return next((part for part in reservation.split("; ") if "fit the others as" in part), "")


def main() -> None:
    """Print a line for each robot, and the sums."""
    parser = argparse.ArgumentParser(description="Are loads of one level that are stated wrong named?")
    parser.add_argument("robots", nargs="?", type=int, default=20, help="number of robots")
    parser.add_argument("--from", dest="first", type=int, default=0, metavar="SEED", help="first seed")
    options = parser.parse_args()
    named, drawn = Counter[float](), Counter[float]()
    simulator.Gear = Gear
    for seed in range(options.first, options.first + options.robots):
        row, rng = robot_row(seed), np.random.default_rng(10**6 + seed)
        with tempfile.TemporaryDirectory() as name:
            truth.experiment(row, seed, Path(name))
            data = harness.load(Path(name))
        level, size = int(rng.integers(len(row.levels))), float(rng.choice(SIZES))
        factor = 1.0 + size * float(rng.choice([-1.0, 1.0]))
        for error, readings in ((0.0, data), (size, stated_wrong(data, level, factor))):
            text = doubt(readings)
            drawn[error] += 1
            named[error] += bool(text)
            print(f"{seed} {row.poses} {row.levels} level {level} wrong by {error:.2f}: {text or '-'}", flush=True)
    print(", ".join(f"wrong by {100 * error:.0f} %: {named[error]} of {drawn[error]} named" for error in sorted(drawn)))


if __name__ == "__main__":
    main()
