"""Checks along the path before anything is written; each returns issues that name the source line."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postproc import elastostatics, kinematics
from postproc.chunks import Runs
from postproc.dialects import registry
from postproc.errors import Issue, Level
from postproc.frames import (
    DEG_PER_RAD,
    MM_PER_M,
    MM_PER_MIN,
    RAD_PER_DEG,
    Array,
    largest,
    norm,
    rotation_vector,
    twist_between,
)
from postproc.kinematics import JointPath
from postproc.poses import Poses
from postproc.program import PTP, Bools, Ints, Program
from postproc.robot import JOINTS, RobotModel
from postproc.toolpath import Toolpath

_EQUAL_CORRECTION = 8e-7
"""Corrections of branches that differ by less [m, rad] at a control-flow join are equal: about the rounding of the
written text, which has at least 1e-4 mm and 1e-5° (assumed)."""
_WRIST_ANGLE = 0.2 * RAD_PER_DEG
"""|A5| below this is in the wrist singularity (assumed)."""
_ELBOW_ANGLE = 0.2 * RAD_PER_DEG
"""A3 nearer than this to the stretched arm is in the elbow singularity (assumed)."""
SHOULDER_RADIUS = 0.005
"""A wrist centre nearer than this to the A1 axis [m] is in the shoulder singularity (assumed)."""
_SMALLEST_ROTATION = 1e-9
"""A motion that turns the tool by less than this [rad] does not turn it (assumed)."""
_JUMP_ANGLE = 45.0 * RAD_PER_DEG
"""A joint that turns more than this between neighbouring samples passes (nearly) through a singularity (assumed)."""
_CORRECTED_TWIST = 1e-9
"""Targets that are commanded nearer than this to where they were [m, rad] are as they were (assumed)."""
_HALF_TURN_MARGIN = 0.2 * RAD_PER_DEG
"""A rotation within this of 180° may change its direction by the correction, which turns the tool by less (assumed)."""
_HALF_TURN = 150.0 * RAD_PER_DEG
"""A turn of A4 or A6 from [start] beyond this winds cables and hoses by about half a turn (assumed)."""
_LIMIT_ROUNDING = 1e-9
"""Angles beyond a limit by less [rad] are at it: rounding of the inverse kinematics."""
_START_DEPTH = 1e-3
"""Starts that are lower than they should be by less [m] are not reported (assumed)."""
_SHORTEST_TRAVEL = 1e-6
"""Pieces of path shorter than this [m] have no joint speed by their feed (assumed)."""
_FASTEST_CARRIAGE = 5.0
"""Speed of a linear axis that carries the robot [m/s] that none has (assumed): where the feed would ask for more, the
tool hardly moves, and the speed of that axis times the motion."""
_ORIENTATION_SPEED = 200.0 * RAD_PER_DEG
"""$VEL.ORI1 and $VEL.ORI2 of a KUKA controller by default [rad/s]."""
_TORQUE_FACTOR = 1.1
"""Torque of a load, over the largest that was measured, beyond which the model is extrapolated (assumed)."""
JOINT_SPEED = "joint-speed-"
"""Kinds of issues about joint speeds begin so."""
_SMALLEST_SIGNED_ANGLE = 0.01 * RAD_PER_DEG
"""A joint angle nearer to zero than this has no sign that T could name (assumed)."""


def _issue_of_rows(
    program: Program, motion: Ints, is_bad: Bools, kind: str, message: str, level: Level = "error"
) -> Iterator[Issue]:
    """Yield one issue for all samples with an error, none without one; it names the line of the first.

    :param motion: (N,) row of `Motions` of each sample.
    :param is_bad: (N,) True where the sample has the error.
    :param kind: kind of the issue, such as "joint-limit-A5"; issues of one kind are listed as one.
    """
    if is_bad.any():
        yield program.motions.issue(level, kind, message, motion[is_bad])


def _turn_advice(program: Program) -> str:
    """Return the advice, without a full stop, on how to change the turn of the tool or the branch of the joints.

    A robot program, whose text is kept, states both itself. Of G-code and APT the cell states the turn, and the joints
    to which G28 moves (home).
    """
    if program.keeps_text:
        return "turn the tool about its axis"
    home = ", choose another [machine] home" if np.isfinite(program.motions.joints).any() else ""
    return f"turn the tool about its axis ([gcode] redundancy_deg){home}"


def joint_limit_issues(program: Program, robot: RobotModel, sample: Toolpath, q: Array) -> Iterator[Issue]:
    """Yield an issue for each joint whose commanded angle is beyond a limit at samples.

    :param sample: N samples of the path.
    :param q: (N, 6) commanded joint angles [rad].
    """
    # the conditions are negated so that an angle that is not a number counts as outside
    for axis in np.flatnonzero(~(kinematics.joint_margin(robot, q) >= -_LIMIT_ROUNDING)).tolist():
        low, high = robot.lower[axis], robot.upper[axis]
        is_outside = ~(np.minimum(q[:, axis] - low, high - q[:, axis]) >= -_LIMIT_ROUNDING)
        first_row = int(np.argmax(is_outside))
        message = (
            f"{JOINTS[axis]} = {q[first_row, axis] * DEG_PER_RAD:.3f}° is outside its limits {low * DEG_PER_RAD:g}…"
            f"{high * DEG_PER_RAD:g}°. Move the part, {_turn_advice(program)} or start elsewhere."
        )
        yield from _issue_of_rows(program, sample.motion, is_outside, f"joint-limit-{JOINTS[axis]}", message)


def singularity_issues(
    program: Program, robot: RobotModel, sample: Toolpath, q: Array, sparse_motions: Ints
) -> Iterator[Issue]:
    """Yield issues where the path is near a wrist, elbow or shoulder singularity, or a joint turns far between samples.

    :param sample: N samples of the path.
    :param q: (N, 6) commanded joint angles [rad].
    :param sparse_motions: (n,) motions with samples far apart, for which a large turn between samples is normal.
    """
    geometry = kinematics.closed_form(robot)
    is_path_motion = program.motions.kind[sample.motion] != PTP  # a PTP passes singularities without harm
    is_wrist = is_path_motion & (np.abs(q[:, 4]) < _WRIST_ANGLE)
    is_elbow = is_path_motion & (np.abs(geometry.elbow_angle_from_stretched(q)) < _ELBOW_ANGLE)
    # distance of the wrist centre from the axis of A1 [m]
    is_shoulder = is_path_motion & (np.abs(geometry.wrist_distance_ahead_of_a1(q)) < SHOULDER_RADIUS)
    has_jump = is_path_motion & (largest(np.diff(q, axis=0, prepend=q[:1])) > _JUMP_ANGLE)
    # samples of motions that do not follow each other are not connected: a turn between them is no jump
    has_jump &= (np.diff(sample.motion, prepend=sample.motion[:1]) <= 1) & ~(is_wrist | is_elbow | is_shoulder)
    has_jump &= ~np.isin(sample.motion, sparse_motions)
    samples, is_flip = np.flatnonzero(has_jump), np.zeros(len(q), dtype=np.bool_)
    fastest_joint = np.argmax(np.abs(q[samples] - q[samples - 1]), axis=1)
    is_flip[samples] = np.isin(fastest_joint, (3, 5))  # at a wrist singularity A4 and A6 turn most
    advice = f"Move the part or {_turn_advice(program)}."
    flip_problem = "wrist singularity: A5 passes through or near 0°, A4 and A6 turn by more than 45° at once"
    for is_bad, kind, problem in (
        (is_wrist, "wrist-singularity", "wrist singularity: A5 passes through 0°"),
        (is_elbow, "elbow-singularity", "elbow singularity: the arm is stretched out"),
        (is_shoulder, "shoulder-singularity", "shoulder singularity: the wrist is above the A1 axis"),
        (has_jump & is_flip, "wrist-singularity", flip_problem),
        (has_jump & ~is_flip, "joint-jump", "singularity: a joint turns by more than 45° on a short piece of path"),
    ):
        yield from _issue_of_rows(program, sample.motion, is_bad, kind, f"{problem}. {advice}")


def half_turn_issues(program: Program, sample: Toolpath, turn: Array, pose: Poses) -> Iterator[Issue]:
    """Yield an issue if a motion turns the tool by half a circle: rounding of the last digit decides the direction.

    From the start, or from an axis target, the controller chooses the direction in any case: a warning.

    :param sample: N samples of the path.
    :param turn: (M,) rotation of the tool by each motion [rad]; with that of the path where the tool turns with it.
    :param pose: N commanded tool frames, `$BASE`.
    """
    m = program.motions
    has_open_direction = m.kind != PTP
    if program.turning is not None:  # rotary axes, or the axes of the wrist, turn the tool: they have a direction
        has_open_direction &= ~program.turning.active
    rotation = turn if program.turns_with_path is None else turn - np.where(program.turns_with_path, m.sweep, 0.0)
    motion = np.flatnonzero(has_open_direction & (rotation > np.pi - _HALF_TURN_MARGIN))
    if not len(motion):
        return
    previous = program.predecessors[motion]
    ends = np.flatnonzero(sample.is_end)[np.stack([motion, previous])]
    is_corrected = np.abs(twist_between(sample.pose[ends], pose[ends])).max(axis=2) > _CORRECTED_TWIST
    may_reverse = is_corrected.any(axis=0) & (previous >= 0) & np.isnan(m.joints[previous, 0])
    problem = "this move turns the tool by about 180°: rounding decides the direction"
    advice = "Add a target between that fixes the direction."
    if program.turns_with_path is not None and program.turns_with_path[motion].all():
        advice = (
            "The tool turns with the path of this circle: CirPathMode\\ObjectFrame (RAPID) or $CIRC_TYPE=#BASE (KRL) "
            "keeps its orientation. Or divide the circle."
        )
    cases: tuple[tuple[Bools, Level, str], ...] = (
        (may_reverse, "error", "and a correction may reverse it"),
        (~may_reverse, "warning", "and the joints were checked for one direction only"),
    )
    for has_half_turn, level, consequence in cases:
        yield from _issue_of_rows(
            program, motion, has_half_turn, "half-turn", f"{problem}, {consequence}. {advice}", level
        )


def status_and_turn_issues(program: Program, robot: RobotModel, sample: Toolpath, q: Array) -> Iterator[Issue]:
    """Yield an issue if S and T of a PTP target belong to no configuration within the joint limits.

    :param sample: N samples of the path.
    :param q: (N, 6) joint angles chosen for the nominal path [rad]: with S and T of the program where possible.
    """
    m = program.motions
    is_axis_target = np.isfinite(m.joints[sample.motion, 0])  # it states joint angles, and needs no S and T
    ptp_samples = np.flatnonzero(sample.is_end & (m.kind[sample.motion] == PTP) & ~is_axis_target)
    motion = sample.motion[ptp_samples]
    states_turn, states_status = m.turn[motion] >= 0, m.status[motion] >= 0  # −1: the target does not state it
    has_sign = np.abs(q[ptp_samples]) > _SMALLEST_SIGNED_ANGLE
    turn_bits = m.turn[motion, None] >> np.arange(6) & 1  # bit i of T is 1 where joint i is negative
    wrong_turn = states_turn & (((q[ptp_samples] < 0.0) != (turn_bits == 1)) & has_sign).any(axis=1)
    # bits 0 to 2 of S are overhead, elbow and wrist; higher ones do not concern the posture
    wrong_status = states_status & (kinematics.status_of(robot, q[ptp_samples]) != m.status[motion] & 7)
    wrong_status &= has_sign[:, 4]  # at A5 = 0 the wrist has both configurations
    advice = "The controller would drive the axes elsewhere, or stop: correct S and T, or leave them out."
    for is_wrong, name in ((wrong_status, "status S"), (wrong_turn, "turn T")):
        message = f"no configuration within the joint limits has the {name} of this target. {advice}"
        yield from _issue_of_rows(program, motion, is_wrong, "status-turn", message)


def start_joint_issues(program: Program, robot: RobotModel, start: Array) -> Iterator[Issue]:
    """Yield issues if [start] of the cell (6,) [rad], which fixes the branch, is beyond a limit or ambiguous."""
    margin = kinematics.joint_margin(robot, start[None])
    if (margin < -_LIMIT_ROUNDING).any():
        name = JOINTS[int(np.argmin(margin))]
        message = f"[start] joints of the cell: {name} is outside its limits by {-margin.min() * DEG_PER_RAD:.3f}°."
        yield Issue("error", "start-joints", message, source_line=int(program.motions.line[0]))
    if abs(start[4]) < _WRIST_ANGLE:
        message = "[start] joints of the cell: A5 = 0 leaves the branch open; that with A5 > 0 is taken."
        yield Issue("warning", "start-singular", message, source_line=int(program.motions.line[0]))


def first_move_issues(program: Program, path: JointPath, start: Array) -> Iterator[Issue]:
    """Yield a warning for A4 and A6 if the first PTP turns them by about half a turn or more: cables wind up.

    :param path: joint angles of the samples.
    :param start: (6,) joint angles of [start] of the cell [rad].
    """
    m = program.motions
    is_axis_target = np.isfinite(m.joints[0, 0])  # the program itself states these joint angles
    if m.kind[0] != PTP or is_axis_target:
        return
    rotation = path.q[0] - start
    for axis in (3, 5):  # A4 and A6
        if abs(rotation[axis]) > _HALF_TURN:
            message = (
                f"The first move turns {JOINTS[axis]} by {rotation[axis] * DEG_PER_RAD:.0f}° from the [start] joints "
                f"of the cell. Check cables and hoses; {_turn_advice(program)} or choose other [start] joints."
            )
            yield Issue("warning", f"first-move-{JOINTS[axis]}", message, source_line=int(m.line[0]))


_START_DISTANCE = 1e-5
"""A program whose tip at [start] is nearer to its first target [m] starts there: [start] has four decimals."""


def start_height_issues(program: Program, tip: Array, clearance: float | None) -> Iterator[Issue]:
    """Yield a warning if the first move of a CAM program may pass through part or table.

    It begins below `clearance_Z`, which is above part and clamps, or below its target. Or it passes below its target:
    all axes move at once, so the tip may come down on the way although both ends are high. Coming down to a target
    below `clearance_Z` is what the program asks for. There is no first move if [start] is the first target.

    :param tip: (n, 3) positions of the tip from [start] to the first target in `$BASE` [m].
    :param clearance: [machine] clearance_Z [m]; None: the cell does not state it.
    """
    m = program.motions
    if program.keeps_text or np.isfinite(m.joints[0, 0]):
        return
    if norm(tip[0] - m.target.position[0]) < _START_DISTANCE:
        return
    target_z = float(m.target.position[0, 2])
    start_z, lowest_z = float(tip[0, 2]), float(tip[:, 2].min())
    start_limit, start_name = target_z, "the first target"
    if clearance is not None and clearance > target_z:
        start_limit, start_name = clearance, "clearance_Z"
    path_limit, path_limit_name = target_z, "the first target"
    if clearance is not None and clearance < target_z:
        path_limit, path_limit_name = clearance, "clearance_Z"
    if start_limit - start_z > _START_DEPTH:
        problem = (
            f"The first move begins below {start_name}: at [start] the tip is at Z {start_z * MM_PER_M:.1f} mm of "
            f"$BASE, {(start_limit - start_z) * MM_PER_M:.1f} mm below it."
        )
    elif path_limit - lowest_z > _START_DEPTH:
        problem = (
            f"The first move passes below {path_limit_name}: all axes move at once from [start], and the tip comes "
            f"down to Z {lowest_z * MM_PER_M:.1f} mm of $BASE, {(path_limit - lowest_z) * MM_PER_M:.1f} mm below it."
        )
    else:
        return
    message = f"{problem} Choose [start] joints with the tip above the part, or check that the way from there is free."
    yield Issue("warning", "start-below", message, int(m.line[0]))


def posture_issues(
    program: Program, robot: RobotModel, sample: Toolpath, path: JointPath, start: Array
) -> Iterator[Issue]:
    """Yield an issue if a PTP changes the posture of the arm (status S): overhead, elbow or wrist turned over.

    :param sample: N samples of the path.
    :param path: joint angles of the samples.
    :param start: (6,) joint angles where the program starts [rad].
    """
    ends = np.flatnonzero(sample.is_end & (program.motions.kind[sample.motion] == PTP))
    # a PTP has one sample, at its end: it starts at the sample before
    start_status = kinematics.status_of(robot, np.where(ends[:, None] > 0, path.q[ends - 1], start))
    end_status = kinematics.status_of(robot, path.q[ends])
    changes = np.flatnonzero(start_status != end_status)
    if len(changes):
        old_status, new_status = start_status[changes[0]], end_status[changes[0]]
        status_change = f"status S from {old_status} to {new_status}"
        message = f"The arm changes its posture ({status_change}): the way there is the controller's."
        yield program.motions.issue("info", "posture", message, sample.motion[ends[changes]])


def joint_speed(program: Program, sample: Toolpath, turn: Array, q: Array, position: Array) -> Array:
    """Return the joint speeds at the programmed feed before each sample (N, 6) [rad/s]; 0 if unknown.

    Unknown are the speeds of PTP, of motions in other frames than those before, where the controller's orientation
    speed or the linear axis that carries the robot times a motion, and along steps too short to have a speed.

    :param sample: N samples of the path.
    :param turn: (M,) rotation of the tool by each motion [rad].
    :param q: (N, 6) commanded joint angles [rad].
    :param position: (N, 3) commanded positions [m]: the controller's path speed is along these.
    """
    m, motion = program.motions, sample.motion[1:]  # motion of the step to each sample but the first
    feed = m.feed[motion]
    nominal_travel = norm(np.diff(sample.pose.position, axis=0))
    travel = np.maximum(nominal_travel, norm(np.diff(position, axis=0)))
    motion_step = np.diff(sample.motion)
    is_same_base, is_same_tool = (rows[motion] == rows[sample.motion[:-1]] for rows in (m.base, m.tool))
    has_same_frames = (is_same_base & is_same_tool & (motion_step <= 1)) | (motion_step == 0)
    is_timed_by_feed = (
        (m.kind[motion] != PTP)
        & has_same_frames
        & ~_is_timed_by_turning(sample, turn, nominal_travel, feed)
        & (nominal_travel > _SHORTEST_TRAVEL)
        & (feed > 0)
    )
    if program.carriage is not None:
        carriage_travel = np.abs(np.diff(program.carriage.at(sample.motion, sample.t)))
        is_timed_by_feed &= carriage_travel * feed <= _FASTEST_CARRIAGE * travel
    speed = np.abs(np.diff(q, axis=0, prepend=q[:1]))
    speed[1:] *= np.where(is_timed_by_feed, feed / np.where(is_timed_by_feed, travel, 1.0), 0.0)[:, None]
    return speed


def _is_timed_by_turning(sample: Toolpath, turn: Array, travel: Array, feed: Array) -> Bools:
    """Return which steps between N samples (N − 1,) are timed by the controller's orientation speed, not by the feed.

    Those turn the tool, and would turn it faster at the programmed feed.

    :param turn: (M,) rotation of the tool by each motion [rad].
    :param travel: (N − 1,) lengths of the steps [m].
    :param feed: (N − 1,) programmed feeds [m/s]; NaN for PTP.
    """
    turning_steps = np.flatnonzero(turn[sample.motion[1:]] > _SMALLEST_ROTATION)
    rotation = sample.pose[turning_steps + 1, :3, :3] @ np.swapaxes(sample.pose[turning_steps, :3, :3], 1, 2)
    rotation_at_feed = norm(rotation_vector(rotation)) * np.nan_to_num(feed[turning_steps])
    is_timed_by_turning = np.zeros(len(travel), dtype=bool)
    is_timed_by_turning[turning_steps] = rotation_at_feed > _ORIENTATION_SPEED * travel[turning_steps]
    return is_timed_by_turning


def joint_speed_issues(program: Program, robot: RobotModel, sample: Toolpath, speed: Array) -> Iterator[Issue]:
    """Yield issues where joint speeds at the programmed feed exceed the limits of the robot.

    If a program relies on the default speed, which may be set differently on the controller, it is only a warning.

    :param sample: N samples of the path.
    :param speed: (N, 6) joint speeds [rad/s].
    """
    level: Level = "warning" if any(issue.kind == "default-speed" for issue in program.issues) else "error"
    rapid = program.motions.rapid[sample.motion]
    feed = np.nan_to_num(program.motions.feed[sample.motion])  # NaN of PTP, whose joints are never too fast
    is_too_fast = speed > robot.speed
    for axis, name in enumerate(JOINTS):
        for is_of_group, feed_name, advice in (
            (~rapid, "the programmed feed", "Lower the feed to {feed}"),
            (rapid, "the speed of rapid moves", "Lower rapid_m_per_s in [gcode] of the cell"),
        ):
            is_fast = is_of_group & is_too_fast[:, axis]
            if not is_fast.any():
                continue
            turning_speed = speed[np.flatnonzero(is_fast), axis]
            allowable_feed = float((feed[is_fast] * robot.speed[axis] / turning_speed).min())
            advice = advice.format(feed=_feed_text(allowable_feed, program.dialect))
            message = (
                f"{name} would turn at {turning_speed.max() * DEG_PER_RAD:.0f}°/s at {feed_name} (limit "
                f"{robot.speed[axis] * DEG_PER_RAD:.0f}°/s). {advice} or turn the tool about its axis."
            )
            yield from _issue_of_rows(program, sample.motion, is_fast, f"{JOINT_SPEED}{name}", message, level)


_FEED_UNITS = {"krl": (1.0, "m/s ($VEL.CP)"), "rapid": (MM_PER_M, "mm/s")}
"""Format of a program → units of its feeds in one m/s, and their name; of all others mm/min."""


def _feed_text(feed: float, dialect: str) -> str:
    """Return a feed [m/s] as text, rounded down to two digits, in the unit in which a program of a format states it."""
    factor, unit = _FEED_UNITS.get(dialect, (MM_PER_MIN, "mm/min"))
    return f"{_round_down(feed * factor)} {unit}"


def _round_down(value: float) -> str:
    """Return a positive number as text with two significant digits, rounded down."""
    step = 10.0 ** (np.floor(np.log10(value)) - 1.0)
    # the factor keeps a number of two digits from being rounded down to the one below it
    return f"{np.floor(value / step * (1.0 + 1e-12)) * step:.6g}"


def joint_issues_at_joins(program: Program, sample: Toolpath, q: Array, start: Array) -> Iterator[Issue]:
    """Yield an issue if branches, or rounds of an endless loop, end in one pose with a joint that differs by a turn.

    A join is where branches that are chosen at run time meet again (`Program.joins`). The pose of the tool is the same,
    but the motions after it would begin with that joint 360° farther each time.

    :param sample: N samples of the path.
    :param q: (N, 6) commanded joint angles of the samples [rad].
    :param start: (6,) joint angles where the program starts [rad].
    """
    last_samples = np.flatnonzero(sample.is_end)
    for rows in program.joins:  # motions that end at the join; −1 for the start of the program
        angles = np.array([q[last_samples[row]] if row >= 0 else start for row in rows])
        spread = np.ptp(angles, axis=0)
        axis = int(spread.argmax())
        if not spread[axis] > np.pi:
            continue
        lines = [int(program.motions.line[row]) for row in rows if row >= 0]
        angles_text = " and ".join(
            f"{angle:.0f}°" for angle in sorted({round(value) for value in angles[:, axis] * DEG_PER_RAD})
        )
        message = (
            f"{_BRANCHES} end with A{axis + 1} at {angles_text}: what follows was checked from one of these angles "
            "only. Turn the tool back the way it came, or give all of A1 … A6 there (PTP)."
        )
        yield Issue("error", "branch-joints", message, lines[0], count=len(lines), lines=tuple(lines))


def correction_issues_at_joins(program: Program, sample: Toolpath, pose: Poses, wrench: Runs) -> Iterator[Issue]:
    """Yield an issue if branches taken at run time have different corrections at a control-flow join.

    A join is where branches that are chosen at run time meet again (`Program.joins`).

    :param sample: N samples of the path.
    :param pose: N commanded tool frames, `$BASE` [m].
    :param wrench: (N, 6) process forces at the samples, `$BASE` [N, N·m].
    """
    last_samples = np.flatnonzero(sample.is_end)
    for rows in program.joins:  # motions that end at the join; −1 for the start of the program
        motions = np.array([row for row in rows if row >= 0], dtype=np.int64)
        correction = twist_between(sample.pose[last_samples[motions]], pose[last_samples[motions]])
        if len(motions) < len(rows):
            correction = np.append(correction, np.zeros((1, 6)), axis=0)  # the start, which is not corrected
        if not len(motions) or np.ptp(correction, axis=0).max() < _EQUAL_CORRECTION:
            continue
        lines = program.motions.line[motions].tolist()
        forces = [
            f"line {line}: {_force_text(wrench[last_samples[row]])}"
            for line, row in zip(lines, motions.tolist(), strict=True)
        ]
        message = (
            f"{_BRANCHES} end under different forces ({', '.join(forces)}): the next motion would begin at different "
            "corrected places. Give their last motions the same force in $BASE."
        )
        yield Issue("error", "branch-forces", message, lines[0], count=len(lines), lines=tuple(lines))


_BRANCHES = "branches that are chosen at run time, or the rounds of a LOOP without EXIT,"


def _force_text(wrench: Array) -> str:
    """Return the force of a wrench (6,) [N, N·m] for a message, with four digits."""
    return f"F = ({', '.join(f'{value:.4g}' for value in wrench[:3].tolist())}) N"


def correction_size_issues(program: Program, motion: Ints, correction: Array, limit: float) -> Iterator[Issue]:
    """Yield an issue if a commanded position is farther from nominal than allowed.

    :param motion: (N,) row of `Motions` of each sample.
    :param correction: (N,) distance of the commanded from the nominal position [m].
    :param limit: largest allowed distance [m].
    """
    message = (
        f"the correction of {correction.max() * MM_PER_M:.3f} mm is larger than max_correction_mm = "
        f"{limit * MM_PER_M:g}. Check the forces and the robot model, or raise max_correction_mm in the cell."
    )
    yield from _issue_of_rows(program, motion, ~(correction <= limit), "correction-size", message)


def blending_issues(program: Program, motion: Ints, extra_rounding: Array, tolerance: float) -> Iterator[Issue]:
    """Yield an issue if the correction increases the rounding of a corner by more than the tolerance [m].

    :param motion: (K,) row of `Motions` of each target.
    :param extra_rounding: (K,) rounding of the written path at each target beyond that of the programmed one [m].
    """
    _, writer = registry.written_in(program.dialect)
    message = (
        f"{writer.approximation} rounds the corrected path by up to "
        f"{np.max(extra_rounding, initial=0.0) * MM_PER_M:.3f} mm more "
        f"than the programmed one; tolerance_mm is {tolerance * MM_PER_M:g}. Use a smaller approximation distance "
        "where this matters."
    )
    yield from _issue_of_rows(program, motion, extra_rounding > tolerance, "blending", message, "warning")


def torque_warnings(
    program: Program, robot: RobotModel, motion: Ints, q: Array, tool: Array, wrench: Array
) -> Iterator[Issue]:
    """Yield warnings for loads with more torque on a joint than the measurements of the model had.

    :param motion: (K,) row of `Motions` of each target.
    :param q: (K, 6) commanded joint angles [rad].
    :param tool: (4, 4) or (K, 4, 4) `$TOOL` [m].
    :param wrench: (K, 6) at the TCP, root axes [N, N·m].
    """
    if robot.measured is None:
        return
    torque = np.abs(elastostatics.load_torques(robot, q, tool, wrench))
    is_extrapolated = torque > _TORQUE_FACTOR * robot.measured.torque
    for joint in np.flatnonzero(is_extrapolated.any(axis=0)).tolist():
        message = (
            f"the forces put up to {torque[:, joint].max():.0f} N·m on {JOINTS[joint]}; the robot model was measured "
            f"up to {robot.measured.torque[joint]:.0f}: it and its bound are extrapolated. Measure such loads too."
        )
        yield from _issue_of_rows(
            program, motion, is_extrapolated[:, joint], f"beyond-measured-{JOINTS[joint]}", message, "warning"
        )
