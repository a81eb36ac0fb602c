"""Joint angles along a path by the controller's geometry: branches, turns, reach; margins to limits, singular poses.

`ByWrist` is the orientation on lines on which the wrist axes turn the tool. Under ``$ORI_TYPE=#JOINT`` a KUKA
controller leads the angles of the wrist axes from their values at the start to those at the end, axis by axis, while
the tip stays on its line (Beckhoff, TF5120: KUKA mxAutomation). That they change in proportion to the path length is
assumed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from msgspec import Struct

from postproc.chunks import chunks, in_chunks
from postproc.errors import PostprocError
from postproc.frames import FULL_TURN, Array, angle_between, any_column, largest
from postproc.kinematics.closed_form import closed_form, status_of
from postproc.kinematics.components import components, matrices
from postproc.kinematics.forward import posture, tcp
from postproc.program import Bools, Ints
from postproc.robot import RobotModel

_ANGLE_TOLERANCE = 1e-6
"""Angles beyond a limit by less [rad] are at it: rounding of the closed form."""
_ZERO = 1e-6
"""A joint angle within this of zero [rad] is zero: its sign is rounding."""
_TIP_TOLERANCE = 1e-11
"""The tip is on its line within this [m]."""
_ROUNDS = 12
"""Newton steps: each squares the error, so that many are needed only next to singularities."""
_PIECES = 8
"""Pieces of a motion at whose ends its rotation is measured."""
_TRAVEL_FACTOR = 1.2
"""Factor on the rotation found so: the tool may turn to and fro within a piece."""


class UnreachableError(PostprocError):
    """Poses have no solution on their branch; `rows` are the samples concerned."""

    def __init__(self, rows: Sequence[int]) -> None:
        """Say how many poses are out of reach."""
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
    *,
    is_ptp_target: Bools,
    axis_target: Array,
    status: Ints,
    turn: Ints,
) -> JointPath:
    """Return the joint angles along a path by the controller's geometry, continuous from the start.

    A run of linear and circular moves stays on one branch. A PTP move may change it: to the status S and turn T it
    gives, else it keeps the branch and takes the nearest turn.

    :param robot: the robot.
    :param flange: returns the flange poses (n, 4, 4) in the root [m] of samples (n,).
    :param start: (6,) joint angles before the first sample [rad].
    :param is_ptp_target: (N,) True where the sample is the target of a PTP move; there are J.
    :param axis_target: (J, 6) joint angles of the PTP moves to an axis target [rad], NaN for the others.
    :param status: (J,) S of the PTP targets, −1 where none.
    :param turn: (J,) T of the PTP targets, −1 where none.
    :raises UnreachableError: a pose has no solution on its branch.
    """
    ptp_rows, status, turn = np.flatnonzero(is_ptp_target), status.astype(np.int64), turn.astype(np.int64)
    has_axis_target = np.isfinite(axis_target[:, 0])
    branches = _path_branches(robot, flange(ptp_rows), start, axis_target, status)
    branch = np.repeat(branches, np.diff(ptp_rows, prepend=0, append=len(is_ptp_target)))
    q = np.zeros((len(branch), 6))
    # angles of the last sample of the part before, and the whole turns subtracted from them
    start_angles, removed_turns = np.asarray(start, dtype=float), np.zeros(6)
    unreached: list[int] = []
    for part in chunks(len(branch)):
        rows = np.arange(part.start, min(part.stop, len(branch)))
        exact = branch_joints(robot, flange(rows), branch[part])
        targets = slice(*np.searchsorted(ptp_rows, (part.start, part.stop)))  # PTP moves that end in the part
        target_rows, is_axis_target = ptp_rows[targets] - part.start, has_axis_target[targets]
        exact[target_rows[is_axis_target]] = axis_target[targets][is_axis_target]
        unreached += (part.start + np.flatnonzero(any_column(np.isnan(exact)))).tolist()
        has_turn = ~is_axis_target & (turn[targets] >= 0)
        turn_rows = target_rows[has_turn]
        exact[turn_rows] = _whole_turns(robot, exact[turn_rows], turn[targets][has_turn])
        if len(rows) and not unreached:
            exact_rows = target_rows[is_axis_target | has_turn]  # their whole turns are stated by the target
            q[part], removed_turns = _continuous_angles(exact, start_angles, removed_turns, exact_rows)
            start_angles = exact[-1]
    if unreached:
        raise UnreachableError(unreached)
    return JointPath(q, branch)


def _path_branches(robot: RobotModel, flange: Array, start: Array, axis_target: Array, status: Ints) -> Ints:
    """Return the branch before the first PTP move, and from each PTP move on (J + 1,).

    Moves that state no branch keep the one before, and so do those to a pose that no branch with their status reaches.

    :param flange: (J, 4, 4) flange poses at their targets in the root [m].
    :param start: (6,) joint angles at the start [rad].
    :param axis_target: (J, 6) joint angles of PTP moves to axis targets [rad], NaN for others.
    :param status: (J,) S, −1 if it is not given.
    """
    form = closed_form(robot)
    branch = np.full(len(status) + 1, -1)  # −1: not stated
    branch[0] = form.branch_of(np.asarray(start)[None])[0]
    has_axis_target = np.isfinite(axis_target[:, 0])
    branch[1:][has_axis_target] = form.branch_of(axis_target[has_axis_target])
    pose_targets = np.flatnonzero(~has_axis_target & (status >= 0))
    candidates = form.branches(flange[pose_targets])  # (n, 8, 6)
    candidate_status = status_of(robot, candidates.reshape(-1, 6)).reshape(-1, 8)
    stated_status = status[pose_targets] & 7  # further bits of S state no branch
    fits = np.isfinite(candidates).all(axis=2) & (candidate_status == stated_status[:, None])
    branch[1 + pose_targets] = np.where(fits.any(axis=1), fits.argmax(axis=1), -1)
    # a running maximum finds the last row with a branch; row 0 has one
    last_stated_row = np.maximum.accumulate(np.where(branch >= 0, np.arange(len(branch)), 0))
    return np.asarray(branch[last_stated_row])


def _continuous_angles(q: Array, start_angles: Array, turns_removed: Array, exact_rows: Ints) -> tuple[Array, Array]:
    """Return joint angles (n, 6) [rad] minus the whole turns that make them continuous, and the turns of the last (6,).

    :param q: (n, 6) angles as the closed form returns them, or with the turns of their target [rad]; n ≥ 1.
    :param start_angles: (6,) angles before the first of them, before any turns were subtracted [rad].
    :param turns_removed: (6,) whole turns that are subtracted there.
    :param exact_rows: rows whose angles are kept: continuity begins anew at each.
    """
    turns = np.round(np.diff(q, axis=0, prepend=start_angles[None]) / FULL_TURN)
    if not turns.any() and not turns_removed.any():
        return q, turns_removed
    turns[exact_rows] = 0.0
    total_turns = turns_removed + np.cumsum(turns, axis=0)
    # the last exact row up to each row, −1 before the first
    exact_row = np.full(len(q), -1)
    exact_row[exact_rows] = exact_rows
    exact_row = np.maximum.accumulate(exact_row)
    excess_turns = total_turns - np.where(exact_row[:, None] >= 0, total_turns[exact_row], 0.0)
    return q - FULL_TURN * excess_turns, excess_turns[-1]


def branch_joints(robot: RobotModel, pose_flange_in_root: Array, branch: Ints) -> Array:
    """Return joint angles (N, 6) [rad] of flange poses (N, 4, 4) [m] on their branches 0…7 (N,); NaN out of reach.

    :raises ModelError: the robot has no closed form.
    """
    is_uniform = len(branch) > 0 and bool((branch == branch[0]).all())
    return closed_form(robot).solve(components(pose_flange_in_root), int(branch[0]) if is_uniform else branch).T


def _whole_turns(robot: RobotModel, angles: Array, turn: Ints) -> Array:
    """Return joint angles (J, 6) [rad] with the whole turns that KUKA's T (J,) states: bit n − 1 for a negative axis n.

    Angles within the limits with the stated sign come first, then others within the limits; of these the smallest.

    :param angles: (J, 6) as the closed form returns them [rad].
    """
    # joints turn by at most two turns either way
    candidates = angles[..., None] + FULL_TURN * np.arange(-2, 3)
    is_within_limits = (candidates >= robot.lower[:, None] - _ANGLE_TOLERANCE) & (
        candidates <= robot.upper[:, None] + _ANGLE_TOLERANCE
    )
    is_negative = (turn[:, None] >> np.arange(6) & 1).astype(np.bool_)
    has_sign = is_within_limits & ((candidates < 0.0) == is_negative[..., None])
    # steps of the penalty are larger than any angle [rad], so that it decides
    penalty = np.where(has_sign, 0.0, np.where(is_within_limits, 100.0, 200.0))
    best = np.argmin(np.abs(candidates) + penalty, axis=2)
    return np.asarray(np.take_along_axis(candidates, best[..., None], axis=2)[..., 0])


_MOST_SAMPLED_ROWS = 2_000
"""Rows of a path that are evaluated in the first pass (assumed)."""


def joint_margin(robot: RobotModel, q: Array) -> Array:
    """Return the smallest distance (6,) [rad] of each joint to its limits along a path, negative beyond them.

    :param q: (N, 6) joint angles [rad], N ≥ 1.
    """
    parts = (q[part].T for part in chunks(len(q)))  # by columns: much faster than along short rows
    extremes = np.array([[(angle.min(), angle.max()) for angle in part] for part in parts])
    smallest_angle, largest_angle = extremes[..., 0].min(axis=0), extremes[..., 1].max(axis=0)
    return np.asarray(np.minimum(smallest_angle - robot.lower, robot.upper - largest_angle))


def smallest_singular_value(robot: RobotModel, q: Array, tool: Array) -> float:
    """Return the smallest singular value of the tool's Jacobian along a path: metres and radians per radian.

    It changes slowly along a dense path. Of more than `_MOST_SAMPLED_ROWS` rows, every n-th is evaluated first, then
    all rows around the smallest value.

    :param q: (N, 6) joint angles [rad]; the result is NaN if N is 0.
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    """
    if len(q) == 0:
        return float("nan")
    stride = len(q) // _MOST_SAMPLED_ROWS + 1

    def tools(rows: slice) -> Array:
        """Return the tool frames of some rows; a tool that is the same for all rows is returned as it is."""
        return tool if tool.ndim == 2 else tool[rows]

    sampled_rows = slice(None, None, stride)
    _, jacobian = tcp(robot.nominal, q[sampled_rows], tools(sampled_rows))
    # squares of the singular values, ascending: good enough to find the row, and faster
    squares = np.linalg.eigvalsh(jacobian @ np.swapaxes(jacobian, 1, 2))
    smallest_row = int(np.argmin(squares[:, 0])) * stride
    rows = slice(max(0, smallest_row - stride), smallest_row + stride + 1)
    return float(smallest_singular_values(robot, q[rows], tools(rows)).min())


def smallest_singular_values(robot: RobotModel, q: Array, tool: Array) -> Array:
    """Return the smallest singular value (N,) of the tool's Jacobian: metres and radians per radian.

    :param q: (N, 6) joint angles [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    """
    _, jacobian = tcp(robot.nominal, q, tool)
    return np.asarray(np.linalg.svd(jacobian, compute_uv=False)[:, -1])


class ByWrist(Struct, frozen=True, eq=False):
    """W of M motions on which the wrist turns the tool.

    :param robot: the robot; its nominal geometry is used.
    :param motion: (W,) the motions, ascending.
    :param begin: (W, 6) joint angles at their start [rad], `end` (W, 6) at their end.
    :param tip: (W, 2, 3) tip in the root at their start and end [m].
    :param base: (W, 3, 3) orientation of `$BASE` in the root.
    :param tool: (W, 4, 4) `$TOOL` in the flange frame [m].
    :param active: (M,) True for the W motions.
    :param travel: (M,) upper bound on the rotation of the tool along each of the W motions [rad]; 0 for the others.
    """

    robot: RobotModel
    motion: Ints
    begin: Array
    end: Array
    tip: Array
    base: Array
    tool: Array
    active: Bools
    travel: Array

    @classmethod
    def of(
        cls,
        robot: RobotModel,
        count: int,
        *,
        motion: Ints,
        joints: tuple[Array, Array],
        tip: Array,
        base: Array,
        tool: Array,
    ) -> ByWrist:
        """Return the motions with their rotation.

        Arrays are those of the fields of the same names.

        :param count: M.
        :param joints: angles (W, 6) at start and end [rad].
        :raises UnreachableError: the tip cannot be held on its line on one branch; `rows` are motions.
        """
        active = np.zeros(count, dtype=np.bool_)
        active[motion] = True
        begin, end_joints = joints
        wrist = cls(
            robot=robot,
            motion=motion,
            begin=begin,
            end=end_joints,
            tip=tip,
            base=base,
            tool=tool,
            active=active,
            travel=np.zeros(count),  # filled below
        )
        angle, start = np.zeros(len(motion)), wrist.at(motion, np.zeros(len(motion)))
        for piece in range(1, _PIECES + 1):
            end = wrist.at(motion, np.full(len(motion), piece / _PIECES))
            angle += angle_between(start, end)
            start = end
        wrist.travel[motion] = _TRAVEL_FACTOR * angle
        return wrist

    def at(self, motion: Ints, t: Array) -> Array:
        """Return the orientation of the tool frame (n, 3, 3) in `$BASE` at places on motions.

        :param motion: (n,) motions, each of which is in the field `motion`.
        :param t: (n,) place of the tip on the line of its motion, in [0, 1].
        :raises UnreachableError: the tip cannot be held on its line on one branch; `rows` are motions.
        """
        row = np.searchsorted(self.motion, motion)
        q, pose = in_chunks(self._joints_and_pose, row, t)
        tip_error = largest(pose[:, :3, 3] - self._tip(row, t))
        form = closed_form(self.robot)
        failed_rows = np.flatnonzero(
            ~(tip_error < _TIP_TOLERANCE) | (form.branch_of(q) != form.branch_of(self.begin[row]))
        )
        if len(failed_rows):
            raise UnreachableError(sorted(set(motion[failed_rows].tolist())))
        return np.asarray(np.swapaxes(self.base[row], 1, 2) @ pose[:, :3, :3])

    def _tip(self, row: Ints, t: Array) -> Array:
        """Return the tip (n, 3) on its line, root frame [m].

        :param row: (n,) motions, as rows 0…W − 1 of the fields; `t` (n,) places on them, in [0, 1].
        """
        return np.asarray(self.tip[row, 0] + t[:, None] * (self.tip[row, 1] - self.tip[row, 0]))

    def _joints_and_pose(self, row: Ints, t: Array) -> tuple[Array, Array]:
        """Return the joint angles (n, 6) [rad] and the tool poses (n, 4, 4) in the root [m] at places on motions.

        A4 to A6 move in proportion to t. A1 to A3 keep the tip on its line: they are found by Newton's method, from the
        line between their values at start and end. Where that fails, the tip is not on its line: `at` checks it.

        :param row: (n,) motions, as rows 0…W − 1 of the fields; `t` (n,) places on them, in [0, 1].
        """
        q = (self.begin[row] + t[:, None] * (self.end[row] - self.begin[row])).T.copy()
        tip, tool = self._tip(row, t).T, components(self.tool[row])
        for _ in range(_ROUNDS):
            state = posture(self.robot.nominal, q, tool)
            tip_error = tip - state.point
            if not (np.abs(tip_error).max(initial=0.0) > 0.1 * _TIP_TOLERANCE):
                break
            slope = np.moveaxis(state.jacobian()[:3, :3], -1, 0)  # (n, 3, 3) of the tip by A1 to A3
            try:
                q[:3] += np.linalg.solve(slope, tip_error.T[..., None])[..., 0].T
            except np.linalg.LinAlgError:
                break
        return q.T, matrices(posture(self.robot.nominal, q, tool).pose)
