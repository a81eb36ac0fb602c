"""Where a program starts if the cell does not say: at its first target, on the branch with the most margin.

The margin of a branch is the smallest along the program: distance of each joint to its limits, of A5 from where A4 and
A6 are in line, of A3 from the stretched arm. Where the cell leaves the turn of the tool open, the best turn counts at
each sample. Branches on which bodies of [collision] come too close are taken only if there is no other.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.errors import ProgramError
from postproc.frames import DEG_PER_RAD, RAD_PER_DEG, Array
from postproc.kinematics.components import components
from postproc.placement import drive
from postproc.placement.bodies import Bodies
from postproc.placement.samples import PathSamples
from postproc.program import Ints, Program
from postproc.under_load import RobotInCell

_MOST = 4000
"""Samples of a program by which branches are judged."""
_TURNS = np.arange(-180.0, 180.0, 30.0) * RAD_PER_DEG
_BRANCHES = 8
_FAR = 100.0
_MOST_COMPARED = 120
"""Samples at which branches are looked at for collisions."""
_DECIMALS = 4
"""Of the joint angles [deg]."""
_NO_WAY = (
    "the cell has no [start], and no branch of the arm reaches the first target of the program. Move the part, or give "
    "[start] joints."
)


class ChosenStart(Struct, frozen=True):
    """Where a program starts.

    :param joints: A1…A6 [deg].
    :param message: how they were found, in words.
    """

    joints: tuple[float, float, float, float, float, float]
    message: str


def choose(program: Program, robot_in_cell: RobotInCell) -> ChosenStart:
    """Choose the joint angles at the first target of a program.

    A program that states them, or status and turn of its first target, starts there.

    :param robot_in_cell: the robot in a cell with any [start].
    :raises ProgramError: the first target is out of reach on all branches.
    """
    m = program.motions
    if np.isfinite(m.joints[0]).all():
        return _start(m.joints[0], "whose joint angles it states")
    samples = PathSamples.of(program, robot_in_cell, None)
    motion = samples.sample.motion
    if m.status[0] >= 0:
        first = int(np.argmax(samples.sample.t == 1.0))
        part = slice(first, first + 1)
        found = robot_in_cell.follow(program, motion[part], samples.sample.t[part], samples.sample.pose.take(part))
        return _start(found.q[0], "with the status and turn that it states")
    stated = np.flatnonzero(np.isfinite(m.joints[:, 0]) | (m.status >= 0))
    first = int(np.argmax(samples.sample.t == 1.0))  # samples before are on the way from a start that is not known
    own = np.flatnonzero(motion < (stated[0] if len(stated) else len(m)))
    own = own[own >= first]
    rows = own[np.unique(np.linspace(0, len(own) - 1, min(_MOST, len(own))).astype(np.int64))]
    turns = _TURNS if robot_in_cell.cell.gcode.redundancy != "constant" and not program.keeps_text else np.zeros(1)
    found_q = [[_solved(samples, rows, turn, branch) for turn in turns] for branch in range(_BRANCHES)]
    margin = np.array([[_margin(robot_in_cell, q) for q in each] for each in found_q])
    at_best_turn = margin.max(axis=1)
    worst, reached = at_best_turn.min(axis=1), np.isfinite(at_best_turn).sum(axis=1)
    worst = np.where(np.isfinite(margin[:, :, 0].max(axis=1)), worst, -np.inf)
    easy = [
        -np.abs(np.nan_to_num(q[0][[3, 5], 0], nan=_FAR)).sum() for q in found_q
    ]  # of branches alike: A4, A6 near 0
    free = _free_of_collisions(samples, rows, found_q, worst)
    order = sorted(
        range(_BRANCHES), key=lambda k: (free[k], round(float(worst[k]), 6), reached[k], easy[k]), reverse=True
    )
    best = order[0]
    if not np.isfinite(margin[best, :, 0]).any():
        raise ProgramError(_NO_WAY, file=program.documents[0].name, line=int(m.line[0]))
    q = found_q[best][int(margin[best, :, 0].argmax())]
    if not np.isfinite(worst[best]):
        return _start(q[:, 0], "on the branch that reaches most of the program")
    among = (
        " of those without collisions" if not all(free[k] for k in range(_BRANCHES) if np.isfinite(worst[k])) else ""
    )
    words = (
        f"on the branch{among} with the most margin to joint limits and singular poses, "
        f"{worst[best] * DEG_PER_RAD:.1f}°"
    )
    if np.isfinite(worst[order[1]]) and free[order[1]]:
        words += f" (the next best has {worst[order[1]] * DEG_PER_RAD:.1f}°)"
    return _start(_unwound(robot_in_cell, q) if len(turns) == 1 else q[:, 0], words)


def _free_of_collisions(samples: PathSamples, rows: Ints, found_q: list[list[Array]], worst: Array) -> list[bool]:
    """Return on which branches some turn of the tool is without collision at each of some samples.

    All are if the cell has no [collision], or if none is: the check of the path then names the bodies.
    """
    table = samples.robot_in_cell.cell.collision
    able = [k for k in range(_BRANCHES) if np.isfinite(worst[k])]
    if table is None or len(able) < 2:
        return [True] * _BRANCHES
    bodies = Bodies(samples, table.clearance_mm)
    some = np.unique(np.linspace(0, len(rows) - 1, min(_MOST_COMPARED, len(rows))).astype(np.int64))
    apart = np.ones(len(some), dtype=bool)
    out = [False] * _BRANCHES
    for k in able:
        struck = [bodies.along(q[:, some].T, rows[some], apart, between=False) for q in found_q[k]]
        out[k] = not np.logical_and.reduce(struck).any()
    return out if any(out) else [True] * _BRANCHES


def _start(q: Array, how: str) -> ChosenStart:
    joints = [round(float(angle), _DECIMALS) + 0.0 for angle in q * DEG_PER_RAD]
    named = ", ".join(f"{angle:.1f}" for angle in joints)
    message = f"The cell has no [start]: the program starts at A1…A6 = {named}, its first target, {how}."
    return ChosenStart((joints[0], joints[1], joints[2], joints[3], joints[4], joints[5]), message)


def _solved(samples: PathSamples, rows: Ints, turn: float, branch: int) -> Array:
    flange = samples.flange(rows, np.full(len(rows), turn))
    return drive.solve(samples.robot_in_cell.robot, components(flange), branch)


def _margin(robot_in_cell: RobotInCell, q: Array) -> Array:
    """Return the smallest margin (n,) of joints, wrist and elbow [rad]; −inf out of reach or beyond a limit."""
    found = drive.margins(robot_in_cell.robot, q)
    least = np.minimum(np.minimum(found.joint, found.wrist), found.elbow)
    return np.where(np.isnan(least) | (found.joint < 0.0), -np.inf, least)


def _unwound(robot_in_cell: RobotInCell, q: Array) -> Array:
    """Return the first of joint angles (6, n), A4 and A6 with the whole turns that keep the path within limits."""
    robot, out = robot_in_cell.robot, q[:, 0].copy()
    for axis in drive.WINDING:
        along = q[axis, 0] + np.append(0.0, np.cumsum(np.nan_to_num(drive.wrapped(np.diff(q[axis])))))
        room = [
            min(along.min() + whole - robot.lower[axis], robot.upper[axis] - along.max() - whole)
            for whole in 2.0 * np.pi * np.array([0.0, -1.0, 1.0])
        ]
        out[axis] += 2.0 * np.pi * (0.0, -1.0, 1.0)[int(np.argmax(room))]
    return out
