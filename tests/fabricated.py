"""Results made up for tests of what comes after the correction: no robot is computed here."""

from __future__ import annotations

from functools import cache

import numpy as np
from msgspec.structs import replace

from postproc.correction import ExpectedErrors, Mode, Result
from postproc.errors import Issue
from postproc.frames import Array, pose_from_xyzabc, xyzabc_from_pose
from postproc.poses import Poses
from postproc.program import LIN, Document, Motions, Program
from postproc.robot import RobotModel
from tests.kr270 import ROBOT


def zigzag_program(count: int = 100) -> Program:
    """A zigzag of `count` moves, every 25th rapid; motion i stands on line i + 3."""
    index = np.arange(count)
    way = np.zeros((count, 6))
    way[:, 0] = np.where(index // 20 % 2 == 0, index % 20, 19 - index % 20) * 10.0
    way[:, 1] = index // 20 * 5.0
    way[:, 5] = 180.0
    motions = Motions(
        kind=np.full(count, LIN),
        rapid=index % 25 == 0,
        line=index + 3,
        target=Poses.of(pose_from_xyzabc(way)),
        joints=np.full((count, 6), np.nan),
        centre=np.full((count, 3), np.nan),
        normal=np.full((count, 3), np.nan),
        sweep=np.full(count, np.nan),
        feed=np.full(count, 0.02),
        base=np.zeros(count, dtype=np.int64),
        tool=np.zeros(count, dtype=np.int64),
        blend=np.zeros(count),
        rounding=np.zeros(count),
        status=np.full(count, -1),
        turn=np.full(count, -1),
    )
    return Program("part", "gcode", (Document("part.nc", "G0 X0\n"),), motions, np.eye(4)[None], np.eye(4)[None])


def result(count: int = 100, mode: Mode = "convert") -> Result:
    """A result with smooth deviations; one target per motion."""
    made = zigzag_program(count)
    rapid = made.motions.rapid
    phase = np.linspace(0.0, 12.0, count)
    before = np.where(rapid, 0.0, 1e-3 * (1.0 + 0.5 * np.sin(phase)))
    wrench = np.zeros((count, 6))
    wrench[:, 2] = np.where(rapid, 0.0, 200.0 + 100.0 * np.sin(phase))
    command = made.motions.target[:]
    command[:, 2, 3] += before
    return Result(
        program=made,
        robot=_robot(),
        axis="+Z",
        mode=mode,
        written_dialect="krl",
        documents=() if mode == "predict" else (Document("part.src", "DEF part()\nEND\n"),),
        motion=np.arange(count),
        t=np.ones(count),
        cut_length=np.where(rapid, 0.0, 0.01),
        output_line=np.arange(count) + 20,
        nominal=made.motions.target,
        printed=xyzabc_from_pose(command),
        wrench=wrench,
        deflection=down(before),
        deviation_before=down(before),
        deviation_after=down(np.where(rapid, 0.0, 2e-7) if mode == "convert" else before),
        bound=None,
        q=np.tile(np.radians([0.0, -70.0, 110.0, 0.0, 50.0, 0.0]), (count, 1)),
        joint_margin=np.radians([180.0, 60.0, 40.0, 340.0, 70.0, 350.0]),
        singular_value=0.21,
        path_deviation=4e-6 if mode == "convert" else 1.5e-3,
        rounding=np.zeros(count),
        programmed_rounding=np.zeros(count),
        file_forces=None,
        deflection_by_tool=None,
        largest_correction=1.5e-3,
        issues=(Issue("warning", "no-force", "cutting moves <without> a force: zero force is assumed", 12, count=311),),
    )


def with_changes(base: Result, **changes: object) -> Result:
    """The same result with other fields; distances `before` and `after` are taken straight down."""
    for name in {"before", "after"} & set(changes):
        changes[f"deviation_{name}"] = down(changes.pop(name))
    changed = replace(base, **changes)
    return changed if "errors" in changes else replace(changed, errors=_errors(changed))


def _errors(of: Result, chance: float = 0.99) -> ExpectedErrors | None:
    """Expected errors as if all of the bound were along the deviation, half of its variance by forces."""
    if of.bound is None:
        return None
    more = np.maximum(of.rounding - of.programmed_rounding, 0.0) + of.path_deviation
    after = np.where(of.rapid, 0.0, of.bound + more)
    known = 0.5**0.5 * float(after.max(initial=0.0))
    return ExpectedErrors(np.where(of.rapid, 0.0, of.before + of.bound), after, chance, known, known)


@cache
def _robot() -> RobotModel:
    return ROBOT


def down(distance: Array) -> Array:
    """Deviations (n, 3) straight down by distances (n,) [m]."""
    return np.stack([np.zeros(len(distance)), np.zeros(len(distance)), -distance], axis=1)
