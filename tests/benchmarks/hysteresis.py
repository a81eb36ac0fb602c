"""Backlash and friction of gears that do not stiffen: are they told, or taken for stiffening?

`python -m tests.benchmarks.hysteresis [ROBOTS]`. Robots of random seeds with springs of links and gears whose
compliance does not change with the torque are measured under 0.54 kN, 2.7 kN and 0.54 kN again: as they are, with
backlash of 0.05 mrad in every joint, and with friction that lets A4, or every joint, lie 0.05 mrad behind while loads
rise, and ahead once they fell. Each row tells which joints are named, the factor and the share inside u95 on milling
jobs, and how much of the compliance of the joints, in the mean, seems to fade between a fiftieth of the largest torque
measured and the whole of it; in truth nothing does.
"""

from __future__ import annotations

import re
import sys
import tempfile
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from postproc import elastostatics, robot
from postproc.identification import identify_folder
from samples.paper_study import harness, simulator
from tests.benchmarks.truth import SIGMA

SHARES = (0.2, 1.0, 0.2)
SIZE = 0.05e-3
A4 = np.array([0, 0, 0, 1, 0, 0])
KINDS = {
    "as they are": (0.0 * A4, 0.0 * A4),
    "backlash in every joint": (SIZE * np.ones(6), 0.0 * A4),
    "friction in A4": (0.0 * A4, SIZE * A4),
    "friction in every joint": (0.0 * A4, SIZE * np.ones(6)),
}
"""(backlash, friction) of A1 … A6 [rad]."""


class Lagging:
    """A robot whose joints lie behind by `loop` (6,) [rad] while loads come up, and ahead by it when they went down.

    :param full: (m, 3) the largest forces [N].
    """

    def __init__(self, true, q, full, loop):
        self.true, self.loop, self.full, self.was_full = true, loop, full, False
        frames = true.frames(true.commanded(q))
        flange = true.flange(frames)
        tip = flange[:, :3, 3] + flange[:, :3, :3] @ simulator.LOAD_POINT
        self.flank = np.sign(true.pulled(frames, true.size - 1, tip, full)[:, true.joint_rows])

    def solve(self, q, force):
        """Return flange poses (m, 4, 4)."""
        behind = np.zeros_like(q)
        if np.abs(force).max() > 0.0:
            behind = self.flank * self.loop * (1.0 if self.was_full else -1.0)
        self.was_full = self.was_full or np.allclose(force, self.full)
        return self.true.solve(q + behind, force)


def experiment(seed, folder, backlash, loop):
    """Measure a robot and write the files of the experiment; return the robot."""
    rng = np.random.default_rng(4000 + seed)
    true = simulator.hard(rng, gear="linear", links="begin")
    q, f = simulator.plan(rng, 30, tilt=50.0)
    true.backlash = backlash
    _, raw = simulator.measure(Lagging(true, q, f, loop), q, f, rng, SIGMA, levels=SHARES)
    simulator.write(folder, q, f, raw, SIGMA, levels=SHARES)
    return true


def fades(model):
    """Share of the compliance of A1 … A6, in the mean, that fades with the torque measured, backlash aside."""
    rows, terms = list(model.actuated), tuple(pair for pair in model.terms if not isinstance(pair[0], robot.Backlash))
    model = replace(model, terms=terms)
    least, most = (share * np.abs(model.measured.torque) for share in (0.02, 1.0))
    torque = np.zeros((2, model.actual.nv))
    torque[:, rows] = least, most
    slope = elastostatics.balance.spring_deflection(model, 0.0 * torque.T, torque.T, np.zeros((torque.shape[1], 1)))[
        1
    ].T[:, rows]
    return float(np.mean(1.0 - slope[1] / slope[0]))


def tried(seed, backlash, loop):
    """Return joints named, factor, share inside, what seems to fade."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        true = experiment(seed, folder, backlash, loop)
        done = identify_folder(folder / "measurements.csv", folder / "experiment.toml", folder / "model")
        model = robot.load(folder / "model")
    moved, left, bound = [], [], []
    for q, f in simulator.milling_jobs(np.random.default_rng(seed)):
        wrench = np.c_[f, 0 * f]
        moved.append(harness.true_deflection(true, q, f))
        left.append(moved[-1] - elastostatics.deflect(model, q, harness.TOOL, wrench).twist[:, :3])
        bound.append(elastostatics.position_bound(model, q, harness.TOOL, wrench))
    error = np.linalg.norm(np.concatenate(left), axis=1)
    named = sorted(set(re.findall(r"backlash or friction in (A\d)", " ".join(done.data.warnings))))
    factor = float(np.sqrt(np.sum(np.concatenate(moved) ** 2) / np.sum(error**2)))
    return named, factor, float(np.mean(error <= np.concatenate(bound))), fades(model)


def main(robots):
    """Print the table."""
    print(f"{'':28}{'factor':>8}{'inside':>8}{'fades':>8}   joints named")
    for label, (backlash, loop) in KINDS.items():
        for seed in range(robots):
            named, factor, inside, share = tried(seed, backlash, loop)
            print(f"{label:28}{factor:8.0f}{inside:8.2f}{share:8.1%}   {', '.join(named) or 'none'}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
