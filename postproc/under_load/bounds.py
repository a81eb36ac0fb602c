"""Early checks: refuse a path beyond the reach of the robot before it is sampled, which might take hours."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from postproc import kinematics, toolpath
from postproc.errors import Issue, PostprocError
from postproc.frames import MM_PER_M, Array, norm
from postproc.program import CIRC, Bools, Ints, Program
from postproc.robot import RobotModel
from postproc.toolpath import Segments

_GRID = np.radians(np.arange(-180.0, 180.0, 30.0))
_MARGIN = 1.15
"""Factor on the reach found on a grid of joint angles: between points it is larger by up to 1 / cos(15°) per joint."""
_MOST_TURNS = 1000
"""An arc with more turns is refused: 1000 turns make a metre of thread."""
_MOST_REACHES = 10_000
"""A path longer than this many times the reach is refused: it would take two days at 10 m/min."""
_WIDE = 0.1
"""Arcs shorter than this share of the reach are checked only at their ends."""


class ImpossiblePathError(PostprocError):
    """A path that the robot cannot follow; `issue` has the place and the reason."""

    def __init__(self, issue: Issue) -> None:
        super().__init__(issue.message)
        self.issue = issue


def unreachable(program: Program, motion: Ints) -> Issue:
    """Return the error for motions (n,) that the robot cannot reach."""
    message = "out of reach (on the branch of [start] joints). Move the part or start in another configuration."
    return program.motions.issue("error", "unreachable", message, motion)


def check_ends(program: Program, robot: RobotModel) -> None:
    """Check that every Cartesian target is within reach of the flange.

    :raises ImpossiblePathError: a target is out of reach.
    """
    cartesian = np.flatnonzero(np.isnan(program.motions.joints[:, 0]))
    away = _away(program, cartesian, program.motions.target[cartesian], 1.0)
    reach = _reach(robot)
    far = float(np.nanmax(away, initial=0.0))
    message = (
        f"out of reach: the flange would be up to {far * MM_PER_M:.0f} mm from the robot's root, and its reach is "
        f"{reach * MM_PER_M:.0f} mm. Check units, work offset and [base], or the targets."
    )
    _check(program, cartesian, ~(away <= reach), "unreachable", message)


def check_between(program: Program, robot: RobotModel, path: Segments) -> None:
    """Check that arcs are within reach, and that their numbers of turns and the length of the path are plausible.

    :raises ImpossiblePathError: a check fails.
    """
    m = program.motions
    reach = _reach(robot)
    arcs = np.flatnonzero(m.kind == CIRC)
    radius = norm(path.start.at(arcs)[:, :3, 3] - m.centre[arcs])
    turns = m.sweep[arcs] / (2.0 * np.pi)
    bad = ~(turns <= _MOST_TURNS)
    message = f"an arc of {turns.max(initial=0.0):.1f} turns, more than the permitted {_MOST_TURNS}. Check its angle."
    _check(program, arcs, bad, "turns", message)
    bad = (turns >= 1.0) & ~(radius <= reach)
    wide = np.flatnonzero((turns < 1.0) & (path.length[arcs] > _WIDE * reach))
    for share in (0.25, 0.5, 0.75):
        spot = toolpath.at(program, path, arcs[wide], np.full(len(wide), share)).pose
        bad[wide] |= ~(_away(program, arcs[wide], spot, share) <= reach)
    message = (
        f"out of reach: the arc leaves the reach of the flange, {reach * MM_PER_M:.0f} mm from the robot's root. "
        "Check its centre or radius, and its plane."
    )
    _check(program, arcs, bad, "unreachable", message)
    length = float(path.length.sum())
    if not length <= _MOST_REACHES * reach:
        message = (
            f"the path is {length / 1e3:.0f} km long, more than {_MOST_REACHES} times the reach of the robot. "
            "Check the units, or split the program."
        )
        raise ImpossiblePathError(Issue("error", "path-length", message, source_line=int(m.line[0])))


def _away(program: Program, motion: Ints, pose: Array, t: float) -> Array:
    """Return the distance of the flange from the robot's root (n,) [m] for tool frames in `$BASE` (n, 4, 4)."""
    return norm(toolpath.flange_points(program, motion, pose, np.zeros(3), t))


@lru_cache(maxsize=1)
def _reach(robot: RobotModel) -> float:
    """Return the largest distance of the flange from the robot's root [m], without joint limits."""
    q = np.zeros((len(_GRID) ** 3, 6))
    q[:, 1], q[:, 2], q[:, 4] = (angle.ravel() for angle in np.meshgrid(_GRID, _GRID, _GRID))
    return _MARGIN * float(norm(kinematics.tcp(robot.nominal, q, np.eye(4))[0][:, :3, 3]).max())


def _check(program: Program, motion: Ints, bad: Bools, kind: str, message: str) -> None:
    if bad.any():
        raise ImpossiblePathError(program.motions.issue("error", kind, message, motion[bad]))
