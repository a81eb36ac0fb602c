"""Poses of successive targets: completes missing components, relative and axis targets, and circles with CA."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from msgspec import Struct

from postproc.chunks import Runs, chunks
from postproc.dialects.circles import arcs_through
from postproc.dialects.krl.language.motion_statements import MotionStatement
from postproc.dialects.krl.language.positions import LARGEST_B, Position
from postproc.dialects.krl.language.trace import Trace
from postproc.frames import (
    M_PER_MM,
    MM_PER_M,
    RAD_PER_DEG,
    Array,
    any_column,
    inverse,
    pose_from_xyzabc,
    rotation_from_vector,
    xyzabc_from_pose,
)
from postproc.poses import Poses, poses_from_xyzabc
from postproc.program import Bools, Carriage, Ints, Starts

_ANGLE_TOLERANCE = 1e-9
"""Angles that differ by less [deg] count as equal."""
_FRAME_ADVICE = "Write all of X, Y, Z, A, B, C in the first target after $BASE or $TOOL is changed."
_UNCHANGED = 1e-3 * RAD_PER_DEG
"""Orientations closer than this [rad] are the same."""


class OrientationControl(Struct, frozen=True, eq=False):
    """Orientation control of M motions, if other than interpolation to their own A, B, C.

    :param keeps_orientation: (M,) True if the start orientation is kept: ``$ORI_TYPE=#CONSTANT``.
    :param turns_with_path: (M,) True if it is kept relative to the path: circles under ``$CIRC_TYPE=#PATH``.
    :param via: (M, 3) auxiliary points of circles [mm], NaN where missing.
    """

    keeps_orientation: Bools
    turns_with_path: Bools
    via: Array


class EndPoses(Struct, frozen=True, eq=False):
    """M targets, complete.

    :param numbers: (M, 6) X, Y, Z [mm], A, B, C [deg] in `$BASE` where each motion ends.
    :param pose: (M, 4, 4) the same as poses [m].
    :param joints: (M, 6) of axis targets [rad], NaN elsewhere.
    :param start: where each motion starts.
    :param starts_from_joints: (M,) True where the previous position is an axis target or the start.
    :param ignores_orientation: (M,) True where A, B, C of the text are not those of the target.
    :param circles: row → auxiliary and end point (2, 3) [mm] of relative circles.
    """

    numbers: Array
    pose: Poses
    joints: Runs
    start: Starts
    starts_from_joints: Bools
    ignores_orientation: Bools
    circles: Mapping[int, Array]


class _RobotPosition(Struct, eq=False):
    """Robot position between two motions.

    :param joints: (6,) [rad], None after a Cartesian target.
    :param numbers: (6,) X…C of the previous target, None after an axis target.
    :param base: its frames.
    """

    flange: Array
    joints: Array | None
    numbers: Array | None = None
    base: int = 0
    tool: int = 0


class _Follower:
    """Completes the targets of motions in order: plain ones in bulk, special ones one by one.

    :ivar present: the robot position before the next motion.
    :ivar joints: row → joint angles (6,) [rad] of axis targets.
    :ivar circles: see `EndPoses.circles`; `starts_from_joints` likewise.
    """

    def __init__(
        self,
        trace: Trace,
        line: Ints,
        numbers: Array,
        frames: tuple[Ints, Ints, Array, Array],
        present: _RobotPosition,
        kinematics: Callable[[Array], Array],
        carriage: Carriage | None,
        control: OrientationControl,
    ) -> None:
        """Begin at the robot position `present`, before the first motion.

        :param numbers: (M, 6) X…C as the text gives them, completed in place; `line` (M,) their lines.
        :param frames: rows of `$BASE` and `$TOOL` (M,) each, and the frames (n, 4, 4) each.
        """
        self.trace, self.line, self.kinematics, self.carriage = trace, line, kinematics, carriage
        self.control = control
        self.circles: dict[int, Array] = {}
        self.base, self.tool, self.bases, self.tools = frames
        self.present = present
        self.numbers = numbers
        self.joints: dict[int, Array] = {}
        self.starts_from_joints = np.zeros(len(numbers), dtype=np.bool_)

    def flange(self) -> Array:
        """Return the present flange (4, 4) in the robot root."""
        present = self.present
        if present.numbers is not None:
            tcp = self.bases[present.base] @ pose_from_xyzabc(present.numbers)
            present.flange = tcp @ inverse(self.tools[present.tool])
        return present.flange

    def present_numbers(self, row: int) -> Array:
        """Return X…C (6,) [mm, deg] of the present position, in the frames of a motion."""
        present, base, tool = self.present, int(self.base[row]), int(self.tool[row])
        if present.numbers is not None and (present.base, present.tool) == (base, tool):
            return present.numbers
        return xyzabc_from_pose(inverse(self.bases[base]) @ self.flange() @ self.tools[tool])

    def arrive(self, row: int) -> None:
        """Make the Cartesian target of a motion the present position."""
        present = self.present
        present.numbers, present.joints = self.numbers[row], None
        present.base, present.tool = int(self.base[row]), int(self.tool[row])

    def complete_absolute(self, first: int, last: int) -> None:
        """Fill in the missing components of the absolute Cartesian targets of rows first … last − 1."""
        if first == last:
            return
        self.starts_from_joints[first] = self.present.numbers is None
        for part in chunks(last - first):
            self._fill_in_rows(first + part.start, min(first + part.stop, last))

    def _fill_in_rows(self, first: int, last: int) -> None:
        """Fill in missing components of the absolute targets first … last − 1, from the targets before.

        The rows are a chunk, which fits the cache. A running maximum of row numbers finds, for each component, the
        latest row that gives it.
        """
        block = self.numbers[first:last]
        is_missing = np.isnan(block)
        if is_missing.any():
            self._check_frames(first, last, any_column(is_missing))
            position = self.present_numbers(first)
            first_row = np.where(is_missing[:1], position, block[:1])
            latest = np.maximum.accumulate(np.where(is_missing, 0, np.arange(len(block))[:, None]), axis=0)
            previous_numbers = np.vstack(
                [position, np.take_along_axis(np.vstack([first_row, block[1:]]), latest, axis=0)]
            )
            block[:] = previous_numbers[1:]
            self._check_angles(first, is_missing[:, 3:], previous_numbers[:-1, 4])
        self.arrive(last - 1)

    def _check_angles(self, first: int, is_missing: Bools, previous_b: Array) -> None:
        """Refuse targets that lack some of A, B, C if two sets of angles describe the previous orientation.

        :param is_missing: (n, 3) True where A, B, C are missing, from row `first` on.
        :param previous_b: (n,) the previous B [deg]; beyond ±90 the controller may keep A ± 180, ±180 − B, C ± 180.
        :raises ProgramError: there is such a target.
        """
        is_partial = any_column(is_missing) & ~is_missing.all(axis=1)
        uncertain_rows = np.flatnonzero(is_partial & (np.abs(previous_b) > LARGEST_B))
        if len(uncertain_rows):
            angle = previous_b[uncertain_rows[0]]
            problem = f"A, B or C is missing, and the previous B is {angle:g}°: beyond 90° it is not certain"
            problem += " which angles the controller keeps"
            raise self.trace.error(problem, int(self.line[first + uncertain_rows[0]]), "Write all of A, B, C.")

    def _check_frames(self, first: int, last: int, incomplete: Bools) -> None:
        """Refuse missing components right after a change of frames: the previous values refer to other frames.

        :param incomplete: (n,) True where a component is missing, from row `first` on.
        :raises ProgramError: there is such a target.
        """
        present = self.present
        frames = np.stack([self.base[first:last], self.tool[first:last]])
        has_changed = np.zeros(last - first, dtype=np.bool_)
        has_changed[1:] = (np.diff(frames, axis=1) != 0).any(axis=0)
        has_changed[0] = present.numbers is not None and (present.base, present.tool) != (
            self.base[first],
            self.tool[first],
        )
        uncertain_rows = np.flatnonzero(has_changed & incomplete)
        if len(uncertain_rows):
            problem = "components are missing right after $BASE or $TOOL changed: the values they keep are not certain"
            raise self.trace.error(problem, int(self.line[first + uncertain_rows[0]]), _FRAME_ADVICE)

    def follow_special(self, row: int, move: MotionStatement | None) -> None:
        """Complete the target of a motion that is not plain.

        That is an axis or relative target, a circle with CA, or a motion that keeps the orientation of its start.
        """
        if move is not None and move.end.position.is_axis:
            self._follow_axis_target(row, move)
            return
        start, control = self.present_numbers(row).copy(), self.control
        if move is not None and move.relative_axes:
            self.starts_from_joints[row] = self.present.numbers is None
            self.numbers[row] = self._relative_target(move, start)
            if move.via is not None:
                via = start[:3] + _relative_offset(move.via.position, move.relative_axes, start)
                self.circles[row] = np.stack([via, self.numbers[row, :3]])
        else:
            if control.keeps_orientation[row]:
                self.numbers[row, 3:] = start[3:]
            self.complete_absolute(row, row + 1)
        angle = None if move is None or move.angle is None else move.angle * RAD_PER_DEG
        if angle is not None or (control.keeps_orientation[row] and control.turns_with_path[row]):
            self._end_of_circle(row, start, angle)
        self.arrive(row)

    def _end_of_circle(self, row: int, start: Array, angle: float | None) -> None:
        """Set the end of a circle: the point at its angle CA, and the orientation, turned if it follows the path.

        :param start: (6,) X…C [mm, deg] at the start of the circle.
        :param angle: CA [rad]; None without it.
        """
        begin, end = start[:3] * M_PER_MM, self.numbers[row, :3] * M_PER_MM
        via = self.circles[row][0] if row in self.circles else self.control.via[row]
        via = np.where(np.isnan(via), begin, via * M_PER_MM)
        centre, axis, sweep = circle_geometry(self.trace, self.line[row : row + 1], begin[None], via[None], end[None])
        if angle is not None:
            self.numbers[row, :3] = MM_PER_M * rotated_point(begin, centre[0], axis[0], angle)
        if self.control.keeps_orientation[row] and self.control.turns_with_path[row]:
            pose = pose_from_xyzabc(self.numbers[row])
            pose[:3, :3] = rotation_from_vector(axis[0] * (sweep[0] if angle is None else angle)) @ pose[:3, :3]
            self.numbers[row, 3:] = xyzabc_from_pose(pose)[3:]

    def _follow_axis_target(self, row: int, move: MotionStatement) -> None:
        """Complete an axis target: missing axes keep their angles.

        :raises ProgramError: angles are missing or relative, and the angles before are not known.
        """
        angles, previous_joints = np.array(move.end.position.values) * RAD_PER_DEG, self.present.joints
        if previous_joints is None and (move.relative_axes or np.isnan(angles).any()):
            raise self.trace.error(
                "the joint angles before this motion are not known", move.line, "Give all of A1 … A6, not relative."
            )
        if previous_joints is not None:
            angles = (
                previous_joints + np.nan_to_num(angles)
                if move.relative_axes
                else np.where(np.isnan(angles), previous_joints, angles)
            )
        self.starts_from_joints[row] = self.present.numbers is None
        self.joints[row] = angles
        flange = self.kinematics(angles)
        if self.carriage is not None:
            flange = flange_on_track(flange, self.carriage, float(self.carriage.end[row]))
        self.present = _RobotPosition(flange, angles)
        self.numbers[row] = self.present_numbers(row)

    def _relative_target(self, move: MotionStatement, numbers: Array) -> Array:
        """Return X…C (6,) [mm, deg] of a target that is relative to a position `numbers` (6,).

        :raises ProgramError: it turns the tool.
        """
        position = move.end.position
        offset = np.nan_to_num(np.array(position.values))
        if np.any(offset[3:] != 0.0):
            raise self.trace.error("relative A, B, C are not supported", move.line, "Write it with LIN or PTP.")
        return np.concatenate([numbers[:3] + _relative_offset(position, move.relative_axes, numbers), numbers[3:]])


def _relative_offset(position: Position, axes: str, numbers: Array) -> Array:
    """Return the offset (3,) [mm] of a relative point in `$BASE`.

    :param axes: ``#BASE`` or ``#TOOL``, in which the offset is given; `numbers` X…C (6,) where it begins.
    """
    step = np.nan_to_num(np.array(position.values[:3]))
    return np.asarray(pose_from_xyzabc(numbers)[:3, :3] @ step) if axes == "#TOOL" else step


def flange_on_track(flange: Array, carriage: Carriage, place: float) -> Array:
    """Return the flange (4, 4) in the robot root at E1 = 0, with the linear axis at another position.

    :param flange: (4, 4) in the present root.
    :param place: position of the linear axis [m].
    """
    carried_flange = flange.copy()
    carried_flange[:3, 3] += place * carriage.direction
    return carried_flange


def end_poses(
    trace: Trace,
    line: Ints,
    numbers: Array,
    frames: tuple[Ints, Ints, Array, Array],
    moves: Mapping[int, MotionStatement],
    start_joints: Array,
    kinematics: Callable[[Array], Array],
    control: OrientationControl,
    carriage: Carriage | None = None,
    predecessors: Ints | None = None,
) -> EndPoses:
    """Return the targets of M motions.

    :param line: (M,) 1-based lines, for messages.
    :param numbers: (M, 6) X…C as the text gives them, NaN where missing; NaN for axis and relative targets. They are
        completed in place.
    :param frames: base (M,) and tool (M,): rows of `$BASE` in the robot root (nb, 4, 4) and `$TOOL` in the flange
        frame (nt, 4, 4).
    :param moves: row → statement, for axis and relative targets and circles with CA.
    :param start_joints: (6,) joint angles at the start [rad].
    :param kinematics: (6,) joints → (4, 4) flange in the robot root.
    :param control: orientation control.
    :param carriage: the linear axis that carries the robot.
    :param predecessors: (M,) the motion at whose end each begins, see `Program.after`.
    :raises ProgramError: a component is missing and its previous value is not certain; a relative target cannot
        be known; an axis is missing; the points of a circle do not define one.
    """
    start_flange = kinematics(start_joints)
    if carriage is not None:
        start_flange = flange_on_track(start_flange, carriage, float(carriage.begin[0]))
    follower = _Follower(
        trace, line, numbers, frames, _RobotPosition(start_flange, start_joints), kinematics, carriage, control
    )
    own_angles, is_incomplete = numbers[control.keeps_orientation, 3:], any_column(np.isnan(numbers[:, 3:]))
    numbers[control.keeps_orientation, 3:] = np.nan  # missing components keep their previous value
    special_rows = {
        special_row
        for special_row, move in moves.items()
        if move.end.position.is_axis or move.relative_axes or move.angle is not None
    }
    has_new_frame = np.append(True, (np.diff(frames[0]) != 0) | (np.diff(frames[1]) != 0))[: len(line)]
    row = 0
    for special_row in sorted(
        special_rows
        | set(np.flatnonzero(control.keeps_orientation & (has_new_frame | control.turns_with_path)).tolist())
    ):
        follower.complete_absolute(row, special_row)
        follower.follow_special(special_row, moves.get(special_row))
        row = special_row + 1
    follower.complete_absolute(row, len(line))

    pose = poses_from_xyzabc(numbers)
    start = Starts.of(frames, pose.__getitem__, start_flange, predecessors)
    is_ignored, constant = np.zeros(len(line), dtype=np.bool_), np.flatnonzero(control.keeps_orientation)
    is_ignored[constant] = any_column(np.abs(own_angles - numbers[constant, 3:]) > _ANGLE_TOLERANCE)
    _check_ignored(trace, line, is_incomplete, moves, control.keeps_orientation, is_ignored)
    joints = Runs.from_rows(numbers.shape, follower.joints)
    return EndPoses(numbers, pose, joints, start, follower.starts_from_joints, is_ignored, follower.circles)


def _check_ignored(
    trace: Trace,
    line: Ints,
    is_missing: Bools,
    moves: Mapping[int, MotionStatement],
    constant: Bools,
    is_ignored: Bools,
) -> None:
    """Refuse missing A, B, C after ignored ones: which of them the controller keeps is not certain.

    :raises ProgramError: there are some.
    """
    if not is_ignored.any():
        return
    all_rows = np.arange(len(line))
    last_ignored_row = np.maximum.accumulate(np.where(is_ignored, all_rows, -1))
    last_free_row = np.maximum.accumulate(np.where(constant, -1, all_rows))
    is_missing[[axis_row for axis_row, move in moves.items() if move.end.position.is_axis]] = False
    rows = np.flatnonzero(is_missing[1:] & ~constant[1:] & (last_ignored_row > last_free_row)[:-1]) + 1
    if len(rows):
        raise trace.error(
            "A, B, C are missing behind targets under $ORI_TYPE=#CONSTANT whose own A, B, C were ignored: which of "
            "them stay is not certain",
            int(line[rows[0]]),
            "Write all of A, B, C in this target.",
        )


def circle_geometry(trace: Trace, line: Ints, start: Array, via: Array, end: Array) -> tuple[Array, Array, Array]:
    """Return centres (n, 3), axes (n, 3) and angles (n,) > 0 [rad] of arcs through three points, (n, 3) each [m].

    :param line: (n,) 1-based lines, for messages.
    :raises ProgramError: the three points lie on a straight line, or two of them coincide.
    """
    centre, normal, angle, flat = arcs_through(start, via, end)
    if flat.any():
        raise trace.error(
            "the three points of the circle lie on a line or coincide",
            int(line[np.argmax(flat)]),
            "Choose an auxiliary point well between start and end; for a full circle give CA.",
        )
    return centre, normal, angle


def rotated_point(start: Array, centre: Array, normal: Array, angle: float) -> Array:
    """Return the point (3,) that a rotation of `start` about an axis through `centre` reaches."""
    end: Array = centre + rotation_from_vector(normal * angle) @ (start - centre)
    return end


def same_orientation(r1: Array, r2: Array) -> Bools:
    """Return whether orientations (..., 3, 3) differ by less than 0.001°."""
    relative = np.einsum("...ij,...ij->...", r1, r2)  # trace of r1ᵀ·r2 = 1 + 2·cos(angle)
    return np.asarray(relative > 1.0 + 2.0 * np.cos(_UNCHANGED))
