"""Joint angles along a path by the controller's geometry: branches, turns, reach; margins to limits, singular poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from msgspec import Struct

from postproc.chunks import in_chunks
from postproc.errors import PostprocError
from postproc.frames import Array, any_column
from postproc.kinematics.closed_form import closed_form, status_of
from postproc.kinematics.components import components
from postproc.kinematics.forward import tcp
from postproc.program import Bools, Ints
from postproc.robot import RobotModel

_TURN = 2.0 * np.pi
_SAME = 1e-6
_ZERO = 1e-6
"""A joint angle within this of zero [rad] is zero: its sign is rounding."""


class UnreachableError(PostprocError):
    """Poses have no solution on their branch; `rows` are the samples concerned."""

    def __init__(self, rows: Sequence[int]) -> None:
        super().__init__(f"{len(rows)} poses out of reach")
        self.rows = tuple(rows)


class JointPath(Struct, frozen=True, eq=False):
    """Joint angles of every sample of a path; exists only if every sample was solved.

    :param q: (N, 6) A1…A6 [rad], KUKA signs, continuous along the path (turns included).
    :param branch: (N,) branch 0…7 of the closed form.
    """

    q: Array
    branch: Ints


def turn_of(q: Array) -> Ints:
    """Return KUKA T (N,) of configurations (N, 6): bit n − 1 is set when axis n is negative, beyond rounding."""
    return np.asarray((q < -_ZERO) @ (1 << np.arange(6)), dtype=np.int64)


def follow(
    robot: RobotModel,
    flange: Callable[[Ints], Array],
    start: Array,
    free: Bools,
    axis_target: Array,
    status: Ints,
    turn: Ints,
) -> JointPath:
    """Solve a path by the controller's geometry, continuous from the start.

    A run of linear and circular moves stays on one branch. A PTP move may change it: to the status S and turn T it
    gives, else it keeps the branch and takes the nearest turn.

    :param robot: the robot.
    :param flange: returns the flange poses (n, 4, 4) in the root [m] of samples (n,).
    :param start: (6,) joint angles before the first sample [rad].
    :param free: (N,) True where the sample is the target of a PTP move.
    :param axis_target: (J, 6) joint angles of the PTP moves to an axis target [rad], NaN for the others.
    :param status: (J,) S of the PTP targets, −1 where none.
    :param turn: (J,) T of the PTP targets, −1 where none.
    :raises UnreachableError: a pose has no solution on its branch.
    """
    jumps, status, turn = np.flatnonzero(free), status.astype(np.int64), turn.astype(np.int64)
    by_axes = np.isfinite(axis_target[:, 0])
    slots = _branches_along(robot, flange(jumps), start, axis_target, status)
    branch = np.repeat(slots, np.diff(jumps, prepend=0, append=len(free)))

    def solved(rows: Ints, branch: Ints) -> tuple[Array]:
        return (on_branch(robot, flange(rows), branch),)

    q = in_chunks(solved, np.arange(len(branch)), branch)[0]
    q[jumps[by_axes]] = axis_target[by_axes]
    unreached = np.flatnonzero(any_column(np.isnan(q)))
    if len(unreached):
        raise UnreachableError(unreached.tolist())
    given = np.flatnonzero(~by_axes & (turn >= 0))
    q[jumps[given]] = _turned(robot, q[jumps[given]], turn[given])
    return JointPath(_continuous(start, q, jumps[by_axes | (turn >= 0)]), branch)


def _branches_along(robot: RobotModel, flange: Array, start: Array, axis_target: Array, status: Ints) -> Ints:
    """Return the branch before the first PTP move, and from each of them on (J + 1,)."""
    form = closed_form(robot)
    known = np.full(len(status) + 1, -1)
    known[0] = form.branch_of(np.asarray(start)[None])[0]
    by_axes = np.isfinite(axis_target[:, 0])
    known[1:][by_axes] = form.branch_of(axis_target[by_axes])
    asked = np.flatnonzero(~by_axes & (status >= 0))
    candidates = form.branches(flange[asked])
    fits = np.isfinite(candidates).all(axis=2)
    fits &= status_of(robot, candidates.reshape(-1, 6)).reshape(-1, 8) == (status[asked] & 7)[:, None]
    known[1 + asked] = np.where(fits.any(axis=1), fits.argmax(axis=1), -1)
    last = np.maximum.accumulate(np.where(known >= 0, np.arange(len(known)), 0))
    return np.asarray(known[last])


def _continuous(start: Array, q: Array, held: Ints) -> Array:
    """Return angles (N, 6) with the whole turns that make them continuous from the start; those `held` stay."""
    turns = np.round(np.diff(q, axis=0, prepend=np.asarray(start, dtype=float)[None]) / _TURN)
    if not turns.any():
        return q
    turns[held] = 0.0
    total = np.append(np.cumsum(turns, axis=0), np.zeros((1, 6)), axis=0)  # its last row: before all
    since = np.full(len(q), -1)
    since[held] = held
    return q - _TURN * (total[:-1] - total[np.maximum.accumulate(since)])


def on_branch(robot: RobotModel, pose_flange_in_root: Array, branch: Ints) -> Array:
    """Return joint angles (N, 6) of flange poses (N, 4, 4) on given branches (N,); NaN out of reach."""
    one = len(branch) > 0 and bool((branch == branch[0]).all())
    return closed_form(robot).solve(components(pose_flange_in_root), int(branch[0]) if one else branch).T


def _turned(robot: RobotModel, angles: Array, turn: Ints) -> Array:
    """Return angles (J, 6) with the whole turns that T (J,) asks for: inside the limits if that is possible."""
    options = angles[..., None] + _TURN * np.arange(-2, 3)
    inside = (options >= robot.lower[:, None] - _SAME) & (options <= robot.upper[:, None] + _SAME)
    negative = (turn[:, None] >> np.arange(6) & 1).astype(np.bool_)
    signed = inside & ((options < 0.0) == negative[..., None])
    worse = np.where(signed, 0.0, np.where(inside, 100.0, 200.0))
    best = np.argmin(np.abs(options) + worse, axis=2)
    return np.asarray(np.take_along_axis(options, best[..., None], axis=2)[..., 0])


_LOOKED_AT = 2_000
"""Rows of a path that are evaluated in the first pass."""


def joint_margin(robot: RobotModel, q: Array) -> Array:
    """Return the smallest distance (6,) [rad] of each joint to its limits, negative beyond them; q: (N, 6), N ≥ 1."""
    low, high = np.array([(angle.min(), angle.max()) for angle in q.T]).T  # much faster than along short rows
    return np.asarray(np.minimum(low - robot.lower, robot.upper - high))


def smallest_singular_value(robot: RobotModel, q: Array, tool: Array) -> float:
    """Return the smallest singular value of the tool's Jacobian along a path: metres and radians per radian.

    It changes slowly along a dense path. Of more than `_LOOKED_AT` rows, every n-th is evaluated first, then all rows
    around the smallest.

    :param q: (N, 6) joint angles [rad]; the result is NaN if N is 0.
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    """
    if len(q) == 0:
        return float("nan")
    stride = len(q) // _LOOKED_AT + 1

    def tools(rows: slice) -> Array:
        return tool if tool.ndim == 2 else tool[rows]

    some = slice(None, None, stride)
    _, jacobian = tcp(robot.nominal, q[some], tools(some))
    squares = np.linalg.eigvalsh(jacobian @ np.swapaxes(jacobian, 1, 2))  # good enough to find the place, and faster
    around = int(np.argmin(squares[:, 0])) * stride
    rows = slice(max(0, around - stride), around + stride + 1)
    return float(singular_values(robot, q[rows], tools(rows)).min())


def singular_values(robot: RobotModel, q: Array, tool: Array) -> Array:
    """Return the smallest singular value (N,) of the tool's Jacobian: metres and radians per radian.

    :param q: (N, 6) joint angles [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    """
    _, jacobian = tcp(robot.nominal, q, tool)
    return np.asarray(np.linalg.svd(jacobian, compute_uv=False)[:, -1])
