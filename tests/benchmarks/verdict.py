"""The two expected errors and the chance of a verdict against simulated robots and forces that share no code with it.

Run: python -m tests.benchmarks.verdict [--runs N] [--targets N]

A program is corrected with a shipped model. Compliances, the spring of the compensator and the forces are then drawn
from their stated spreads, and `tests.oracle.elastic` moves the drawn arm through the uncorrected and the corrected
program. Printed are, for each job: what was stated, what 95 % of the runs stay below at the worst target, the share of
runs and targets inside, and the chance beside the share of runs in which the corrected part is better (RMS).
"""

from __future__ import annotations

import argparse
import tempfile
import tomllib
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from postproc import correction, forces, robot
from postproc.frames import pose_from_xyzabc
from postproc.jobs.started_program import read_program
from tests.kr270 import CELL
from tests.oracle import elastic
from tests.oracle.arm import Arm
from tests.places import ROOT

_PROGRAM = "G21 G90\nG0 X0 Y0 Z20\nG0 Z-1\nG1 X80 F900\nG1 Y60\nG1 X0\nG1 Y0\nG0 Z20\nM2\n"
_FORCES = (
    "line,Fx,Fy,Fz,frame,sigma_percent\n4,-160,220,90,FEED,{0}\n5,-160,220,90,FEED,{0}\n"
    "6,60,-150,200,BASE,{0}\n7,-160,220,90,FEED,{0}\n"
)
_LEAST = 0.05
"""Drawn compliances are not below this share of the stated ones: a spring stays a spring."""
JOBS = (("kuka_kr270", 15.0), ("kuka_kr270", 40.0), ("kuka_kr210_r2700_2", 15.0), ("kuka_kr500_r2830", 25.0))
"""Robots, and standard deviations of the forces [%]."""


class Trial(Struct, frozen=True):
    """A job and what came of its runs; lengths in mm.

    :param stated: expected errors (95 %) at the worst target, uncorrected and corrected.
    :param found: what 95 % of the runs stay below at the worst target, likewise.
    :param inside: share of runs and targets that are inside the expected error, likewise.
    :param chance: stated, and `better` the share of runs in which the corrected part is better.
    """

    stated: tuple[float, float]
    found: tuple[float, float]
    inside: tuple[float, float]
    chance: float
    better: float


def trial(name: str, sigma: float, runs: int, targets: int, *, one_factor: bool, seed: int = 1) -> Trial:
    """Correct a program, and let so many drawn arms run it.

    :param sigma: standard deviation of the forces [%].
    :param targets: number of targets that are looked at, evenly along the cutting path.
    :param one_factor: the forces are off by one factor; else each component by a factor of its own.
    """
    rng = np.random.default_rng(seed)
    result, base = _corrected(name, sigma)
    place = np.cumsum(result.cut_length)
    rows = np.searchsorted(place, np.linspace(0.0, place[-1], targets + 1)[1:] * (1.0 - 1e-12))
    arm = Arm.load(ROOT / "robot_models" / name)
    spread = _spread(name)
    tool = result.program.tools[0]
    nominal = base @ result.nominal[rows]
    joints = [
        [elastic.inverse(arm, pose, tool, q) for pose, q in zip(poses, result.q[rows], strict=True)]
        for poses in (nominal, base @ pose_from_xyzabc(result.printed[rows]))
    ]
    wrench = (result.wrench[rows].reshape(-1, 2, 3) @ base[:3, :3].T).reshape(-1, 6)
    error = np.empty((runs, 2, targets))
    stiffness, comp = arm.stiffness, arm.comp
    for run in range(runs):
        factor = np.maximum(1.0 + spread[:6] * rng.normal(size=6), _LEAST)
        arm.stiffness = stiffness / factor
        if comp is not None:
            arm.comp = comp | {"K": comp["K"] * max(1.0 + spread[6] * rng.normal(), _LEAST)}
        off = sigma / 100.0 * (rng.normal() if one_factor else rng.normal(size=(2, 3)))
        drawn = _scaled(result, rows, base, wrench, off)
        for k, angles in enumerate(joints):
            tips = [elastic.loaded_tip(arm, q, tool, w)[:3, 3] for q, w in zip(angles, drawn, strict=True)]
            error[run, k] = np.linalg.norm(np.array(tips) - nominal[:, :3, 3], axis=1)
    stated = np.array([result.errors.before[rows], result.errors.after[rows]])
    worst = stated.argmax(axis=1)
    rms = np.sqrt(np.mean(error**2, axis=2))
    return Trial(
        stated=tuple(1e3 * stated.max(axis=1)),
        found=tuple(1e3 * float(np.quantile(error[:, k, worst[k]], 0.95)) for k in range(2)),
        inside=tuple(float(np.mean(error[:, k] <= stated[k])) for k in range(2)),
        chance=float(result.errors.chance),
        better=float(np.mean(rms[:, 1] < rms[:, 0])),
    )


def _corrected(name: str, sigma: float) -> tuple[correction.Result, np.ndarray]:
    """Return the result of the program on a robot, and `$BASE` in the root."""
    cell = msgspec.structs.replace(CELL, robot=name, gcode=msgspec.structs.replace(CELL.gcode, approximation_mm=0.0))
    model = robot.load(ROOT / "robot_models" / name)
    with tempfile.TemporaryDirectory() as folder:
        program, table = Path(folder) / "square.nc", Path(folder) / "square.csv"
        program.write_text(_PROGRAM)
        table.write_text(_FORCES.format(sigma))
        read = read_program(program, model, cell)
        result = correction.process(read, model, cell, forces.read(table))
    assert not result.failed, result.issues
    return result, result.program.bases[0]


def _scaled(
    result: correction.Result, rows: np.ndarray, base: np.ndarray, wrench: np.ndarray, off: float | np.ndarray
) -> np.ndarray:
    """Return the wrenches (n, 6) in the root with errors, one factor or one of each component in its own axes."""
    if np.ndim(off) == 0:
        return wrench * (1.0 + off)
    motions, kind = result.program.motions, result.source_line[rows]
    end = motions.target[result.motion[rows]][:, :3, 3]
    begin = motions.target[result.motion[rows] - 1][:, :3, 3]
    out = wrench.reshape(-1, 2, 3).copy()
    for i, line in enumerate(kind):
        axes = np.eye(3)
        if line != 6:  # FEED: x along the travel, z towards the spindle, which is up
            x = (end[i] - begin[i]) / np.linalg.norm(end[i] - begin[i])
            axes = np.stack([x, np.cross([0.0, 0.0, 1.0], x), [0.0, 0.0, 1.0]], axis=1)
        axes = base[:3, :3] @ axes
        out[i] = ((out[i] @ axes) * (1.0 + off)) @ axes.T
    return out.reshape(-1, 6)


def _spread(name: str) -> np.ndarray:
    """Return the stated relative standard deviations of six compliances and the compensator."""
    model = tomllib.loads((ROOT / "robot_models" / name / "model.toml").read_text(encoding="utf-8"))
    out = [model["joints"][f"A{n}"]["sigma_percent"] for n in range(1, 7)]
    return np.array([*out, model.get("compensator", {}).get("sigma_percent", 0.0)]) / 100.0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--targets", type=int, default=12)
    given = parser.parse_args()
    columns = ("stated", "runs 95 %", "inside")
    head = "  ".join(f"{which + ' ' + columns[0]:>19}  {columns[1]}  {columns[2]:>7}" for which in ("before", "after"))
    print(f"{'robot, forces':34} {head}   chance  better")
    for name, sigma in JOBS:
        for one_factor in (True, False):
            each = trial(name, sigma, given.runs, given.targets, one_factor=one_factor)
            columns_of = [
                f"{each.stated[k]:20.3f}  {each.found[k]:9.3f}  {100 * each.inside[k]:5.1f} %" for k in range(2)
            ]
            job = f"{name} {sigma:g} % {'factor' if one_factor else 'components'}"
            print(f"{job:34}", *columns_of, f"{each.chance:7.3f}  {each.better:6.3f}")


if __name__ == "__main__":
    main()
