"""All checks of a commanded path, also between its samples; speeds of rapid moves; the origin that a program states.

The samples of an arc may be 60° apart, those of a line 20 mm: enough for the deflection, but between two of them a
joint may turn fastest, exceed a limit or pass a singularity. Where that is possible, an arc is examined every 5°, and
the piece of a line between two samples every 2 mm and half a degree.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import kinematics, toolpath
from postproc.cell import Cell
from postproc.chunks import chunks, in_chunks
from postproc.correction import checks
from postproc.correction.result import Mode
from postproc.correction.targets import Commands
from postproc.decimals import without_negative_zero
from postproc.dialects import registry
from postproc.errors import Issue
from postproc.frames import M_PER_MM, MM_PER_M, RAD_PER_DEG, Array, any_column, norm, xyzabc_from_pose
from postproc.program import CIRC, LIN, SPL, Bools, Ints, Motions, Program, distinct
from postproc.robot import JOINTS, RobotModel
from postproc.toolpath import Toolpath
from postproc.under_load import ImpossiblePathError, MotionsUnderLoad, PathUnderLoad, unreachable

_SPEED_SHARE = 0.98
"""Share of a joint's largest speed that slowed moves use (assumed)."""
_NEXT_SHARE = 0.95
"""Factor on that share where a joint of the written program is still too fast (assumed)."""
_SHORTEST_TRAVEL = 1e-6
"""A first sample nearer to the start of the program than this [m] has no joint speed by its feed (assumed)."""


class Slowing(Struct, frozen=True):
    """Motions that were slowed.

    :ivar joint: (M,) the joint that would turn too fast, counted from 0; −1 where the motion is as programmed.
    :ivar is_capped: (M,) whether it is a move at feed, not one that positions the tool.
    :ivar count: how often the program was slowed.
    """

    joint: Ints
    is_capped: Bools
    count: int

    def issue(self, motions: Motions) -> Issue:
        """Return the remark: on moves at feed if there are any, else on positioning moves."""
        slowed_motions = np.flatnonzero(self.joint >= 0)
        names = " and ".join(JOINTS[axis] for axis in distinct(self.joint[slowed_motions]).tolist())
        slowed_cuts = slowed_motions[self.is_capped[slowed_motions]]
        if len(slowed_cuts):
            lowest_feed = f"{motions.feed[slowed_cuts].min() * MM_PER_M * 60.0:.0f} mm/min"
            message = f"Moves at feed in which {names} would turn too fast are slowed, to {lowest_feed} at the lowest."
            return motions.issue("warning", "feed-capped", message, slowed_motions)
        slowest_feed = f"{motions.feed[slowed_motions].min():.3g} m/s at the slowest"
        message = f"Positioning moves in which {names} would turn too fast are slowed, to {slowest_feed}."
        return motions.issue("info", "rapid-slowed", message, slowed_motions)


def slow_fast_motions(
    path: PathUnderLoad, q: Array, position: Array, last_slowing: Slowing | None, fast_lines: Collection[int]
) -> tuple[MotionsUnderLoad, Slowing] | None:
    """Return the motions with those slowed in which a joint would turn too fast; None if none is slowed.

    Motions that only position the tool may be slowed (`_is_positioning`). With ``[limits] feed = "cap"`` lines and arcs
    at feed may be, too.

    :param q: (N, 6) commanded joint angles of the samples [rad], `position` (N, 3) commanded positions [m].
    :param last_slowing: the motions that were slowed before, if a joint still turns too fast in the program that was
        written then: that program is a few per cent faster where it is nearly singular, or has more targets. Each time,
        these motions get a smaller share of the largest speed. None: nothing was slowed before.
    :param fast_lines: source lines on which a joint still turns too fast in the written program.
    :returns: all motions, with the feeds of the slow ones lowered, and which were slowed now or before.
    """
    m = path.program.motions
    is_positioning = _is_positioning(path)
    is_cut = np.isin(m.kind, (LIN, CIRC)) & ~m.rapid & ~is_positioning
    is_capped = is_cut & (path.robot_in_cell.cell.limits.feed == "cap")
    is_slowable = is_positioning | is_capped
    if not is_slowable.any():
        return None
    slowdown_count, slow_joint = 0, np.full(len(m), -1)
    if last_slowing is not None:
        slowdown_count, slow_joint = last_slowing.count, last_slowing.joint.copy()
    share_of_limit = _SPEED_SHARE * _NEXT_SHARE**slowdown_count
    # share (M,): largest joint speed on each motion over the limit of that joint
    share, joint = _largest_speeds(path, q, position, is_slowable, share_of_limit)
    is_fast, is_on_fast_line = share > 1.0, is_slowable & np.isin(m.line, list(fast_lines))
    # where no motion on the fast lines may be slowed, another round would not help
    if last_slowing is not None and is_on_fast_line.any():
        is_fast |= (share > share_of_limit) & ((slow_joint >= 0) | is_on_fast_line)
    fast_motions = np.flatnonzero(is_fast)
    if not len(fast_motions):
        return None
    slow_joint[fast_motions] = joint[fast_motions]
    feed = m.feed.copy()
    feed[fast_motions] *= share_of_limit / share[fast_motions]
    slow_program = _with_feed(path.program, feed, is_feed_changed=bool(is_capped[fast_motions].any()))
    return replace(path.motions, program=slow_program), Slowing(slow_joint, is_capped, slowdown_count + 1)


def _with_feed(program: Program, feed: Array, *, is_feed_changed: bool) -> Program:
    """Return a program with feeds (M,) [m/s]; it keeps those that were read as `feed_as_read` if a cut is slowed.

    :param is_feed_changed: True if moves at feed are among the slowed ones. The speed of positioning moves is that of
        the cell: it does not count as changed.
    """
    is_first_change = program.feed_as_read is None and is_feed_changed
    feed_as_read = program.motions.feed if is_first_change else program.feed_as_read
    return replace(program, motions=replace(program.motions, feed=feed), feed_as_read=feed_as_read)


def _largest_speeds(
    path: PathUnderLoad, q: Array, position: Array, is_slowable: Bools, smallest_share: float
) -> tuple[Array, Ints]:
    """Return the largest joint speed on each motion as a share of the limit (M,), and the joint (M,), counted from 0.

    Both are 0 on motions that may not be slowed, and on those on which all joints stay below `smallest_share`.

    :param q: (N, 6) commanded joint angles of the samples [rad], `position` (N, 3) commanded positions [m].
    :param is_slowable: (M,) True for motions that may be slowed.
    """
    program, limit = path.program, path.robot_in_cell.robot.speed
    share, joint = np.zeros(len(is_slowable)), np.zeros(len(is_slowable), dtype=np.int64)

    def add(motion: Ints, speed: Array) -> None:
        """Keep in `share` and `joint` the largest share of its speed limit on each motion, and the joint that has it.

        :param motion: (n,) row of the motion of each speed.
        :param speed: (n, 6) of the joints [rad/s].
        """
        joint_share = speed / limit
        sample_share = joint_share.max(axis=1)
        rows = np.flatnonzero(is_slowable[motion] & (sample_share > smallest_share))
        # in increasing order: of several samples on one motion, the last assignment is the largest
        rows = rows[np.argsort(sample_share[rows])]
        rows = rows[sample_share[rows] > share[motion[rows]]]
        share[motion[rows]], joint[motion[rows]] = sample_share[rows], joint_share[rows].argmax(axis=1)

    speed = commanded_speed(path, q, position)
    for part in chunks(len(path)):
        add(path.sample.motion[part], speed[part])
    _, lines = stretches_to_examine(path, q, speed)
    for places, place_joints, place_position in dense_places(path, q, position, lines):
        place_speed = checks.joint_speed(program, places, path.motions.segments.turn, place_joints, place_position)
        add(places.motion, place_speed)
    return share, joint


def _is_positioning(path: PathUnderLoad) -> Bools:
    """Return True (M,) for lines that only position the tool.

    These are rapid moves, moves at feed from `[start]`, and moves without force at the speed of rapid moves or faster.
    False for all motions of a program that keeps its text (KRL, RAPID): there the speeds are those of the program.
    """
    program, m = path.program, path.program.motions
    if program.keeps_text:
        return np.zeros(len(m), dtype=np.bool_)
    is_positioning = m.rapid.copy()
    is_positioning[program.unforced] = True  # feed moves from [start]
    has_force = np.zeros(len(m), dtype=np.bool_)
    is_force_run = any_column(path.wrench.values != 0.0)  # runs of samples with one wrench
    has_force[path.sample.motion[is_force_run[path.wrench.run]]] = True
    is_positioning |= ~has_force & (m.feed >= path.robot_in_cell.cell.gcode.rapid_m_per_s)
    return np.asarray(is_positioning & (m.kind == LIN))


def commanded_speed(path: PathUnderLoad, q: Array, position: Array) -> Array:
    """Return the commanded joint speeds at the programmed feed before each sample (N, 6) [rad/s].

    The first sample is reached from `[start]` of the cell.

    :param q: (N, 6) commanded joint angles of the samples [rad], `position` (N, 3) commanded positions [m].
    """
    m, segments = path.program.motions, path.motions.segments
    speed = np.zeros((len(path), 6))
    for part in chunks(len(path)):
        rows_with_previous = slice(max(part.start - 1, 0), part.stop)
        chunk_speed = checks.joint_speed(
            path.program,
            path.sample.take(rows_with_previous),
            segments.turn,
            q[rows_with_previous],
            position[rows_with_previous],
        )
        speed[part] = chunk_speed[part.start - rows_with_previous.start :]
    first_travel = segments.length[0] * path.sample.t[0]
    if first_travel > _SHORTEST_TRAVEL and m.feed[0] > 0.0:  # a PTP has no feed (NaN)
        speed[:1] = np.abs(q[:1] - path.robot_in_cell.cell.start_joints) * m.feed[0] / first_travel
    return speed


_ARC_SPACING = 5.0 * RAD_PER_DEG
"""Spacing of the places on an arc: between two of them a sine leaves its chord by 0.1 % of its size."""
_FAST_SHARE = 0.75
"""A joint is fast from this share of its largest speed on: between two samples of an arc, which may be 60° apart, its
speed, taken for a sine, may be up to 1 / cos 30° higher than at them; with a margin."""
_LARGE_STEP = 10.0 * RAD_PER_DEG
"""Largest rotation of a joint between samples, unless a wrist or shoulder singularity is near (assumed)."""
_NEAR_WRIST = 1.0 * RAD_PER_DEG
"""Smallest change of A5 that is counted between two samples: an arc may pass the wrist singularity there (assumed)."""
_NEAR_ELBOW = 20.0 * RAD_PER_DEG
"""Change of A3 that is counted between two samples (assumed): it changes with the root of the distance to the stretched
arm, so fast that the steps between samples do not bound it."""
SAMPLES_AT_ONCE = 8192
"""Number of places examined in one batch: some megabytes of temporary arrays."""
_STEPS = 2.0
"""A smooth quantity exceeds its values at the samples by less than one step between them; two for safety."""
_LINE_SPACING, _TURN_SPACING = 0.002, 0.5 * RAD_PER_DEG
"""Spacing of the places on a line; pieces that are shorter and turn the tool less are not examined (assumed)."""
_SMALLEST_LEVER = 0.15
"""Smallest lever arm of a joint [m], unless the arm is nearly singular (assumed): on a path of length s, no joint turns
by more than s over this."""
_JOINT_PER_TOOL_TURN = 6.0
"""Largest ratio of joint rotation to tool rotation, unless the wrist is nearly singular (assumed)."""
_ELBOW_PER_M, _ELBOW_PER_TURN = 5.0, 3.0
"""Largest change of A3 towards the stretched arm within a piece of a line, by length [rad/m] and rotation (assumed)."""
_REACH_PER_TURN = 0.5
"""Largest motion of the wrist centre by turning the tool [m/rad] (assumed)."""


class Stretches(Struct, frozen=True, eq=False):
    """S stretches of motions that need a closer look, in order along the path.

    :param motion: (S,) row of `Motions`.
    :param begin: (S,) place where it begins, and `end` (S,) where it ends.
    :param parts: (S,) number of equal parts; the places where they begin and end are examined.
    """

    motion: Ints
    begin: Array
    end: Array
    parts: Ints


_WRIST, _SHOULDER, _ELBOW = 6, 7, 8
"""Rows of the singularity margins, which must not reach zero, after those of the joint angles."""


def stretches_to_examine(path: PathUnderLoad, q: Array, speed: Array) -> tuple[Stretches, Stretches]:
    """Return arcs, and pieces of lines between two samples, that need a closer look between their samples.

    On these a joint is fast, and may exceed its speed between samples; or it is so near to a limit of its angle, or the
    arm to a singularity, that it may reach that between samples.

    :param q: (N, 6) commanded joint angles [rad].
    :param speed: (N, 6) joint speeds on the way to each [rad/s].
    """
    limit = _FAST_SHARE * path.robot_in_cell.robot.speed
    is_fast = np.asarray((speed > limit).any(axis=1))
    return _arc_stretches(path, q, is_fast), _line_stretches(path, q, is_fast)


class _Margins(NamedTuple):
    """Margins of n motions between samples, (9, n) each.

    :param start: at the samples before.
    :param end: at the samples.
    :param step: sizes of the changes between them, of A1…A6 those of the angle.
    """

    start: Array
    end: Array
    step: Array


def _margins_and_steps(path: PathUnderLoad, q: Array, rows: Ints) -> _Margins:
    """Return margins at the samples before `rows` (n,) and at `rows`, and the changes between them.

    Rows of the arrays are A1…A6 to their nearer limits [rad]; |A5| [rad]; the distance of the wrist centre from the
    axis of A1 [m]; A3 from the stretched arm [rad].

    :param q: (N, 6) joint angles at all samples [rad]; the arm is at [start] before the first.
    """
    robot = path.robot_in_cell.robot
    previous_q = np.where(rows[:, None] > 0, q[rows - 1], path.robot_in_cell.cell.start_joints)
    start, end = _limited_quantities(robot, previous_q), _limited_quantities(robot, q[rows])
    return _Margins(_margins(robot, start), _margins(robot, end), np.abs(end - start))


def _limited_quantities(robot: RobotModel, q: Array) -> Array:
    """Return the quantities (9, n) whose margins are watched: A1…A6, and those that are 0 at a singularity.

    The latter are A5, the distance of the wrist centre from the axis of A1, and A3 from the stretched arm.

    :param q: (n, 6) joint angles [rad].
    """
    geometry, quantities = kinematics.closed_form(robot), np.empty((9, len(q)))
    quantities[:6], quantities[_WRIST] = q.T, q[:, 4]
    quantities[_SHOULDER] = geometry.wrist_distance_ahead_of_a1(q)  # signed: negative behind the axis of A1 [m]
    quantities[_ELBOW] = geometry.elbow_angle_from_stretched(q)  # [rad]
    return quantities


def _margins(robot: RobotModel, quantities: Array) -> Array:
    """Return the margins (9, n) of `_limited_quantities`: of joints to their nearer limits, of the others to 0."""
    margin = np.abs(quantities)
    margin[:6] = np.minimum(quantities[:6] - robot.lower[:, None], robot.upper[:, None] - quantities[:6])
    return margin


def _arc_stretches(path: PathUnderLoad, q: Array, is_fast: Bools) -> Stretches:
    """Return the arcs to be examined every 5°: their margins are small compared with the steps between samples.

    A margin is the distance of a joint from a limit or of the arm from a singularity, a step its change from one sample
    to the next.

    :param q: (N, 6) joint angles at the samples [rad].
    :param is_fast: (N,) samples that a joint reaches near its largest speed: their arcs are examined in any case.
    """
    m, motion = path.program.motions, path.sample.motion
    rows = np.flatnonzero(m.kind[motion] == CIRC)
    if len(rows):
        _, margin, step = _margins_and_steps(path, q, rows)
        fast_motions = motion[rows[is_fast[rows] | (step[:6].max(axis=0) > _LARGE_STEP)]]
        # a cheap first pass with the largest step of any arc: no other arc can be near a limit by its own steps
        is_candidate = (margin < _margin_changes(step.max(axis=1, keepdims=True))).any(axis=0)
        is_on_candidate_arc = np.isin(motion[rows], motion[rows[is_candidate]])
        rows, margin, step = rows[is_on_candidate_arc], margin[:, is_on_candidate_arc], step[:, is_on_candidate_arc]
        # of each arc, the smallest margin and the largest step of its samples, which are consecutive
        first_rows = np.flatnonzero(np.diff(motion[rows], prepend=-1))
        threshold = _margin_changes(np.maximum.reduceat(step, first_rows, axis=1))
        is_near_limit = (np.minimum.reduceat(margin, first_rows, axis=1) < threshold).any(axis=0)
        rows = distinct(np.append(fast_motions, motion[rows[first_rows[is_near_limit]]]))
    # a sweep of a whole number of spacings, but for rounding, gets no further part
    parts = np.ceil(m.sweep[rows] / _ARC_SPACING - 1e-9).clip(1).astype(np.int64)
    return Stretches(rows, np.zeros(len(rows)), np.ones(len(rows)), parts)


def _margin_changes(step: Array) -> Array:
    """Return by how much margins may change between two samples of each of n arcs (9, n), see `_margins_and_steps`.

    :param step: (9, n) largest change from one sample of the arc to the next.
    """
    # between samples a smooth quantity changes little more than by the step from one to the next
    change = _STEPS * step
    # near a singularity the steps do not bound the change: at least so much is counted
    change[_WRIST] = np.maximum(change[_WRIST], _NEAR_WRIST)
    change[_SHOULDER] += checks.SHOULDER_RADIUS
    change[_ELBOW] = _NEAR_ELBOW
    return change


def _line_stretches(path: PathUnderLoad, q: Array, is_fast: Bools) -> Stretches:
    """Return the pieces of lines, from one sample to the next, to be examined every 2 mm and half a degree.

    :param q: (N, 6) joint angles at the samples [rad].
    :param is_fast: (N,) samples that a joint reaches near its largest speed: the pieces to them are examined in any
        case.
    """
    sample, segments = path.sample, path.motions.segments
    is_first_of_motion = np.diff(sample.motion, prepend=-1) != 0
    begin = np.where(is_first_of_motion, 0.0, np.roll(sample.t, 1))  # t at the sample before, 0 at the start
    length, turn = (of_motion[sample.motion] * (sample.t - begin) for of_motion in (segments.travel, segments.turn))
    rows = np.flatnonzero(
        np.isin(path.program.motions.kind[sample.motion], (LIN, SPL))
        & ((length > _LINE_SPACING) | (turn > _TURN_SPACING))
    )
    length, turn = length[rows], turn[rows]

    def is_near_limit(rows: Ints, length: Array, turn: Array) -> Bools:
        """Return on which rows (n,) a margin is smaller than its largest change between samples.

        :param rows: (n,) samples at the end of a step.
        :param length: (n,) of the step of the tool [m].
        :param turn: (n,) of the tool [rad].
        """
        start_margin, margin, step = _margins_and_steps(path, q, rows)
        change = _STEPS * step  # rows: A1…A6 and |A5| [rad], shoulder [m], elbow [rad]
        change[:_SHOULDER] += length / _SMALLEST_LEVER + _JOINT_PER_TOOL_TURN * turn
        change[_SHOULDER] += length + _REACH_PER_TURN * turn + checks.SHOULDER_RADIUS
        change[_ELBOW] = _ELBOW_PER_M * length + _ELBOW_PER_TURN * turn
        return np.asarray((np.minimum(start_margin, margin) < change).any(axis=0))

    # in chunks: nine quantities of a million long lines, at both ends, would exceed 1 GiB with the program
    is_examined = in_chunks(is_near_limit, rows, length, turn) | is_fast[rows]
    rows, length, turn = rows[is_examined], length[is_examined], turn[is_examined]
    return Stretches(
        sample.motion[rows],
        begin[rows],
        sample.t[rows],
        toolpath.even_parts(length, turn, _LINE_SPACING, _TURN_SPACING),
    )


def issues_between_samples(
    path: PathUnderLoad, q: Array, position: Array, stretches: Stretches, sparse_motions: Ints
) -> Iterator[Issue]:
    """Yield issues of joint limits, singularities and joint speeds between samples.

    :param stretches: parts of motions that are examined at places between their samples.
    :param q: (N, 6) commanded joint angles of the samples [rad], `position` (N, 3) commanded positions [m].
    :param sparse_motions: motions with gaps between their stretches, over which a joint may turn far.
    """
    program, robot = path.program, path.robot_in_cell.robot
    try:
        for places, place_joints, place_position in dense_places(path, q, position, stretches):
            yield from checks.joint_limit_issues(program, robot, places, place_joints)
            yield from checks.singularity_issues(program, robot, places, place_joints, sparse_motions)
            speed = checks.joint_speed(program, places, path.motions.segments.turn, place_joints, place_position)
            yield from checks.joint_speed_issues(program, robot, places, speed)
    except ImpossiblePathError as cause:
        yield cause.issue


class DensePlaces(NamedTuple):
    """n places between samples of a path.

    :param sample: the places, with nominal poses.
    :param q: (n, 6) commanded joint angles [rad].
    :param position: (n, 3) commanded positions, `$BASE` [m].
    """

    sample: Toolpath
    q: Array
    position: Array


def dense_places(path: PathUnderLoad, q: Array, position: Array, stretches: Stretches) -> Iterator[DensePlaces]:
    """Yield the places on stretches in batches of about `SAMPLES_AT_ONCE`, each of whole stretches.

    A stretch is a part of a motion; a place is a motion and t on it, 0 at its start and 1 at its end.

    :param q: (N, 6) commanded joint angles of the samples [rad], `position` (N, 3) commanded positions [m]: the
        correction of both is taken for linear between samples.
    :raises ImpossiblePathError: a place is out of reach.
    """
    if len(stretches.motion) == 0:
        return
    end_samples = np.flatnonzero(path.sample.is_end)
    sample_place = path.sample.motion + path.sample.t
    group = np.cumsum(stretches.parts + 1) // SAMPLES_AT_ONCE  # of each stretch: batches have whole stretches
    # motion + t increases along the program: corrections are interpolated over it
    for batch in np.split(np.arange(len(group)), np.flatnonzero(np.diff(group)) + 1):
        stretch, share = toolpath.even_places(batch, stretches.parts[batch], "both ends")
        begin, end = stretches.begin[stretch], stretches.end[stretch]
        motion, t = stretches.motion[stretch], begin + (end - begin) * share
        places = toolpath.at(path.program, path.motions.segments, motion, t)
        nominal_q = _nominal_joints(path, places, path.joints.branch[end_samples[motion]])
        path_q, q_correction, position_correction = _between_samples(path, q, position, sample_place, motion + t)
        # the branch gives angles within one turn: those of the path are the nearest by whole turns
        whole_turns = 2.0 * np.pi * np.round((path_q - nominal_q) / (2.0 * np.pi))
        commanded_q = nominal_q + (whole_turns + q_correction)
        yield DensePlaces(places, commanded_q, places.pose.position + position_correction)


def _nominal_joints(path: PathUnderLoad, places: Toolpath, branch: Ints) -> Array:
    """Return the nominal joint angles (n, 6) [rad] at n places, each within one turn.

    :param branch: (n,) branch of the inverse kinematics.
    :raises ImpossiblePathError: a place is out of reach.
    """
    flange = toolpath.flange_from_tcp(path.program, places.motion, places.pose[:], places.t)
    q = kinematics.branch_joints(path.robot_in_cell.robot, flange, branch)
    is_out_of_reach = any_column(np.isnan(q))
    if is_out_of_reach.any():
        raise ImpossiblePathError(unreachable(path.program, places.motion[is_out_of_reach]))
    return q


class _InterpolatedValues(NamedTuple):
    """Values at n places, linear between the samples of a path.

    :param nominal_q: (n, 6) joint angles of the nominal path [rad].
    :param q_correction: (n, 6) commanded minus nominal joint angles [rad].
    :param position_correction: (n, 3) commanded minus nominal position, `$BASE` [m].
    """

    nominal_q: Array
    q_correction: Array
    position_correction: Array


def _between_samples(
    path: PathUnderLoad, q: Array, position: Array, sample_place: Array, place: Array
) -> _InterpolatedValues:
    """Return joint angles and corrections at places (n,), interpolated between the samples of the path.

    :param q: (N, 6) commanded joint angles of the samples [rad], `position` (N, 3) commanded positions [m].
    :param sample_place: (N,) motion + t of the samples, and `place` (n,) of the places.
    """
    # only the samples around the places are needed: there may be 10⁶ in all
    first_sample, last_sample = np.searchsorted(sample_place, [place.min(), place.max()]).tolist()
    neighbours = slice(max(first_sample - 1, 0), last_sample + 1)
    nominal_q = path.joints.q[neighbours]
    position_correction = position[neighbours] - path.sample.pose.position[neighbours]
    values = np.column_stack([nominal_q, q[neighbours] - nominal_q, position_correction])
    at_places = np.column_stack([np.interp(place, sample_place[neighbours], column) for column in values.T])
    return _InterpolatedValues(at_places[:, :6], at_places[:, 6:12], at_places[:, 12:])


def origin_issues(program: Program, mode: Mode) -> list[Issue]:
    """Return the issues of a program that postproc wrote: it must not be corrected a second time.

    Its origin is stated in a comment of its text. A nominal program, which postproc wrote without correction, may be
    corrected.
    """
    writer = registry.dialect_of_name(program.dialect).writer
    if writer is None:
        return []
    origin = writer.origin(program.documents)
    if origin.part_of:
        message = (
            f"this file is a part of {origin.part_of}, which calls it and sets its start position, frames "
            f"and speed. Name {origin.part_of} instead."
        )
        return [Issue("error", "part-of-program", message, origin.line)]
    if mode != "predict":
        for document in program.documents[1:]:
            module_origin = writer.origin([document])
            if module_origin.mode == "corrected" and origin.mode != "corrected":
                message = (
                    f"{document.name}, which this program calls, was corrected by postproc {module_origin.version} "
                    "before: its targets are commands already, and would be corrected twice. Put the original there."
                )
                return [Issue("error", "corrected-before", message)]
    if origin.state == "none":
        return []
    if mode != "predict" and origin.mode != "nominal":
        message = (
            f"this program was corrected by postproc {origin.version} before: its targets are commands already, and "
            "would be corrected twice. Convert the program that it was made from."
        )
        return [Issue("error", "corrected-before", message, origin.line)]
    if origin.state == "changed":
        message = f"this program was changed since postproc {origin.version} wrote it."
        return [Issue("warning", "changed-since", message, origin.line)]
    return []


def tool_change_issues(program: Program, cell: Cell) -> list[Issue]:
    """Return what is wrong where a program changes to another tool, and the cell knows one tool only.

    An error if the cell does not say how the tool is changed, else a warning if it has no `[tools.n]`: all tools then
    have the length of `[tool]`.
    """
    changes = [event for event in program.events if event.kind == "tool_change"]
    second = next((event for event in changes if event.value != changes[0].value), None)
    if program.keeps_text or second is None:
        return []
    if cell.gcode.tool_change is not None:  # lines that change the tool; []: it is changed by hand
        message = "The program uses several tools, but the cell has only [tool]. Give [tools.n] for each."
        return [] if cell.tools else [Issue("warning", "tool-change", message, second.line)]
    message = (
        f"the program changes from tool {changes[0].value:g} to tool {second.value:g}, but the cell has no tool_change "
        'lines. Give [gcode] tool_change = ["…"], or tool_change = [] if the tool is changed by hand, without a line.'
    )
    return [Issue("error", "tool-change", message, second.line)]


_SAME_LENGTH = 1e-4
"""Tips of tools that are less [m] apart count as one (assumed)."""


def holder_issues(program: Program, cell: Cell) -> list[Issue]:
    """Return a warning if tools with other tips share the cylinders of [collision], which are placed from the tip."""
    cylinder_count = 0 if cell.collision is None else sum(part.mesh is None for part in cell.collision.holder)
    if cylinder_count < 2:  # the first cylinder is the cutter, which is at the tip of every tool
        return []
    m, tip = program.motions, program.tools[:, :3, 3]
    cutting = np.flatnonzero(~m.rapid)
    tip_distance = norm(tip[m.tool[cutting]] - tip[m.tool[cutting[:1]]])
    other_tips = cutting[tip_distance > _SAME_LENGTH]
    if not len(other_tips):
        return []
    message = (
        "[collision] holder is placed from the tip upwards, but the tips of the tools are "
        f"{tip_distance.max() * MM_PER_M:.4g} mm apart at the flange: with one of them, holder and spindle are "
        "checked that far from where they are. Give them as meshes, which are placed from the flange, or divide "
        "the program by tools, with a cell for each"
    )
    return [m.issue("warning", "holder-of-tools", message, other_tips)]


_SAME_FRAME = 1e-6
"""Entries of frames that differ by less [m, 1] are equal (assumed)."""


def _motions_in_other_frame(program: Program, frames: Array, row: Ints, cell_frame: Array) -> Ints:
    """Return the motions with a Cartesian target whose frame is not that of the cell.

    :param frames: (F, 4, 4) [m], and `row` (M,) that of each motion.
    :param cell_frame: (4, 4) [m].
    """
    is_other = np.abs(frames - cell_frame).max(axis=(1, 2)) > _SAME_FRAME
    return np.flatnonzero(is_other[row] & np.isnan(program.motions.joints[:, 0]))


def frame_issues(program: Program, cell: Cell) -> list[Issue]:
    """Return notes if `$BASE` or `$TOOL` of a robot program are its own, and not those of the cell."""
    if not program.keeps_text:
        return []
    m = program.motions
    issues = []
    for name, section, frames, row, cell_frame in (
        ("$BASE", "[base]", program.bases, m.base, cell.base),
        ("$TOOL", "[tool]", program.tools, m.tool, cell.tool),
    ):
        motion = _motions_in_other_frame(program, frames, row, cell_frame.pose())
        if len(motion):
            values = without_negative_zero(xyzabc_from_pose(frames[row[motion[0]]]).round(4)).tolist()
            frame = ", ".join(f"{axis} {value:.8g}" for axis, value in zip("XYZABC", values, strict=True))
            message = (
                f"{name} is {{{frame}}} by the program; {section} of the cell, which is another, is not used there."
            )
            issues.append(m.issue("info", f"own-{section.strip('[]')}", message, motion))
    return issues


def obstacle_issues(program: Program, cell: Cell) -> list[Issue]:
    """Return a warning if a robot program moves in another `$BASE` than the one that obstacles of the cell stand in."""
    if not program.keeps_text or cell.collision is None:
        return []
    m = program.motions
    motion = _motions_in_other_frame(program, program.bases, m.base, cell.base.pose())
    count = sum(obstacle.frame == "base" for obstacle in cell.collision.obstacles)
    if not count or not len(motion):
        return []
    stand = "1 obstacle of [collision] stands" if count == 1 else f"{count} obstacles of [collision] stand"
    message = (
        f"{stand} in [base] of the cell, but the program moves in its own $BASE: do they belong to this part? Then "
        'they are not where they are checked. Make [base] equal to $BASE, or give them frame = "root"'
    )
    return [m.issue("warning", "obstacles-elsewhere", message, motion)]


_FIRST_MOVE_PARTS = 200
"""Number of parts of the first move: the tip, moved by joints, is at most some tenths of a millimetre lower between."""


def _first_tips(path: PathUnderLoad) -> Array:
    """Return positions of the tip (n, 3) in `$BASE` [m] from [start] to the end of the first motion."""
    motion = np.zeros(_FIRST_MOVE_PARTS + 1, dtype=np.int64)
    share = np.linspace(0.0, 1.0, _FIRST_MOVE_PARTS + 1)
    return toolpath.positions(path.program, path.motions.segments, motion, share)


def path_issues(path: PathUnderLoad, command: Commands) -> list[Issue]:
    """Return the issues of the path as commanded.

    :param command: commands of the samples, in `$BASE`.
    """
    program, robot, sample, cell = path.program, path.robot_in_cell.robot, path.sample, path.robot_in_cell.cell
    q, position, start = command.q, command.pose.position, cell.start_joints
    speed = commanded_speed(path, q, position)
    arcs, lines = stretches_to_examine(path, q, speed)
    limit = cell.output.max_correction_mm * M_PER_MM
    clearance = cell.machine.clearance_Z
    issues = [
        *checks.start_joint_issues(program, robot, start),
        *checks.first_move_issues(program, path.joints, start),
        *checks.start_height_issues(program, _first_tips(path), None if clearance is None else clearance * M_PER_MM),
        *checks.half_turn_issues(program, sample, path.motions.segments.turn, command.pose),
        *checks.posture_issues(program, robot, sample, path.joints, start),
        *checks.status_and_turn_issues(program, robot, sample, path.joints.q),
        *checks.joint_limit_issues(program, robot, sample, q),
        *checks.singularity_issues(program, robot, sample, q, arcs.motion),
        *checks.joint_speed_issues(program, robot, sample, speed),
        *checks.joint_issues_at_joins(program, sample, q, start),
        *checks.correction_issues_at_joins(program, sample, command.pose, path.wrench),
        *checks.correction_size_issues(program, sample.motion, norm(position - sample.pose.position), limit),
    ]
    # what was found at samples is not reported again between them; whole arcs are examined, of lines only some pieces
    kinds = {issue.kind for issue in issues}
    for stretches, sparse_motions in ((arcs, arcs.motion[:0]), (lines, lines.motion)):
        issues += (
            issue
            for issue in issues_between_samples(path, q, position, stretches, sparse_motions)
            if issue.kind not in kinds
        )
        kinds |= {issue.kind for issue in issues}
    return issues
