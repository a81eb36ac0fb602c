"""Poses of successive targets: completes missing components, relative and axis targets, and circles with CA."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

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
from postproc.program import Bools, Carriage, FrameColumns, Ints, Starts

_ANGLE_TOLERANCE = 1e-9
"""Angles that differ by less [deg] count as equal."""
_FRAME_ADVICE = "Write all of X, Y, Z, A, B, C in the first target after $BASE or $TOOL is changed."
_ORIENTATION_TOLERANCE = 1e-3 * RAD_PER_DEG
"""Orientations closer than this [rad] are the same."""


class Arcs(NamedTuple):
    """n arcs.

    :ivar centre: (n, 3) [m].
    :ivar axis: (n, 3) unit vectors; the arc turns about it by the right hand.
    :ivar angle: (n,) from start to end [rad], above 0.
    """

    centre: Array
    axis: Array
    angle: Array


class OrientationControl(Struct, frozen=True, eq=False):
    """Orientation control of M motions, if other than interpolation to their own A, B, C.

    :param keeps_orientation: (M,) True if the start orientation is kept: ``$ORI_TYPE=#CONSTANT``.
    :param turns_with_path: (M,) True if it is kept relative to the path: circles under ``$CIRC_TYPE=#PATH``.
    :param via: (M, 3) auxiliary points of circles [mm], NaN where missing.
    """

    keeps_orientation: Bools
    turns_with_path: Bools
    via: Array


class TextTargets(Struct, frozen=True, eq=False):
    """M targets as the text gives them.

    :param trace: the execution trace, for messages.
    :param trace_row: (M,) rows of the motions in the trace, from 1.
    :param numbers: (M, 6) X, Y, Z [mm], A, B, C [deg] in `$BASE`, NaN where missing; NaN for axis and relative targets.
        `end_poses` completes them in place.
    :param frames: frames of the motions.
    :param statements: row → statement, for axis and relative targets and circles with CA.
    :param control: orientation control of the motions.
    :param carriage: the linear axis that carries the robot; None without one.
    :param is_missing: (M, 6) True where the text does not give the component; False for axis and relative targets.
    """

    trace: Trace
    trace_row: Ints
    numbers: Array
    frames: FrameColumns
    statements: Mapping[int, MotionStatement]
    control: OrientationControl
    carriage: Carriage | None
    is_missing: Bools

    def axis_rows(self) -> list[int]:
        """Return the rows of axis targets."""
        return [row for row, move in self.statements.items() if move.end.position.is_axis]


class EndPoses(Struct, frozen=True, eq=False):
    """M targets, complete.

    :param numbers: (M, 6) X, Y, Z [mm], A, B, C [deg] in `$BASE` where each motion ends.
    :param pose: (M, 4, 4) the same as poses [m].
    :param joints: (M, 6) joint angles of axis targets [rad]; NaN for other targets.
    :param start: poses at which the motions start.
    :param starts_from_joints: (M,) True where the previous position is an axis target or the start of the program.
    :param ignores_orientation: (M,) True where A, B, C of the text differ from those of the target (#CONSTANT).
    :param circles: row → auxiliary and end point (2, 3) [mm] in `$BASE` of relative circles.
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

    :ivar flange: (4, 4) in the robot root [m]; out of date after a Cartesian target, see `_TargetCompleter.flange`.
    :ivar joints: (6,) [rad]; None after a Cartesian target, since the reader does not solve the inverse kinematics.
    :ivar numbers: (6,) X…C of the previous target [mm, deg]; None after an axis target, and at the start.
    :ivar base: row of the `$BASE` of the previous target; `tool` is the row of its `$TOOL`.
    """

    flange: Array
    joints: Array | None
    numbers: Array | None = None
    base: int = 0
    tool: int = 0


class _TargetCompleter:
    """Completes the targets of motions in order: plain ones in bulk, special ones one by one.

    :param targets: completed in place.
    :param robot_position: the robot position before the first motion.
    :param kinematics: (6,) joints [rad] → (4, 4) flange in the robot root [m].
    :ivar robot_position: the robot position before the next motion.
    :ivar joints: row → joint angles (6,) [rad] of axis targets.
    :ivar circles: see `EndPoses.circles`.
    :ivar starts_from_joints: see `EndPoses`.
    """

    def __init__(
        self, targets: TextTargets, robot_position: _RobotPosition, kinematics: Callable[[Array], Array]
    ) -> None:
        """Begin before the first motion."""
        self.targets, self.robot_position, self.kinematics = targets, robot_position, kinematics
        self.trace, self.trace_row, self.control, self.numbers = (
            targets.trace,
            targets.trace_row,
            targets.control,
            targets.numbers,
        )
        self.circles: dict[int, Array] = {}
        self.joints: dict[int, Array] = {}
        self.starts_from_joints = np.zeros(len(targets.numbers), dtype=np.bool_)

    def flange(self) -> Array:
        """Return the present flange (4, 4) in the robot root [m].

        After a Cartesian target it is computed, and stored in `robot_position`.
        """
        robot_position, frames = self.robot_position, self.targets.frames
        if robot_position.numbers is not None:
            tcp = frames.bases[robot_position.base] @ pose_from_xyzabc(robot_position.numbers)
            robot_position.flange = tcp @ inverse(frames.tools[robot_position.tool])
        return robot_position.flange

    def present_numbers(self, row: int) -> Array:
        """Return X…C (6,) [mm, deg] of the present position, in `$BASE` and for `$TOOL` of a motion.

        :param row: row of the motion; its frames may differ from those of the previous target.
        """
        robot_position, frames = self.robot_position, self.targets.frames
        base, tool = int(frames.base[row]), int(frames.tool[row])
        if robot_position.numbers is not None and (robot_position.base, robot_position.tool) == (base, tool):
            return robot_position.numbers
        return xyzabc_from_pose(inverse(frames.bases[base]) @ self.flange() @ frames.tools[tool])

    def go_to_target(self, row: int) -> None:
        """Make the Cartesian target of a motion the present robot position; `row` is the row of the motion."""
        robot_position, frames = self.robot_position, self.targets.frames
        robot_position.numbers, robot_position.joints = self.numbers[row], None
        robot_position.base, robot_position.tool = int(frames.base[row]), int(frames.tool[row])

    def complete_absolute_targets(self, first: int, last: int) -> None:
        """Fill in the missing components of the absolute Cartesian targets of rows first … last − 1.

        The last of these targets becomes the present position.

        :raises ProgramError: a component is missing whose previous value is not certain.
        """
        if first == last:
            return
        self.starts_from_joints[first] = self.robot_position.numbers is None
        for chunk in chunks(last - first):
            self._fill_in_rows(first + chunk.start, min(first + chunk.stop, last))

    def _fill_in_rows(self, first: int, last: int) -> None:
        """Fill in missing components of the absolute targets of rows first … last − 1 from the targets before them.

        A running maximum of row numbers finds, for each component, the latest row that gives it. What the first row
        lacks is taken from the present position, where the motion before has ended. The last target becomes the present
        position.

        :raises ProgramError: as for `complete_absolute_targets`.
        """
        block = self.numbers[first:last]  # (n, 6), a view: it is filled in in place
        is_missing = np.isnan(block)
        if is_missing.any():
            self._check_frames(first, last, any_column(is_missing))
            position = self.present_numbers(first)
            first_row = np.where(is_missing[:1], position, block[:1])  # complete
            # for each component, the latest row of the block that gives it; row 0 gives all
            latest = np.maximum.accumulate(np.where(is_missing, 0, np.arange(len(block))[:, None]), axis=0)
            previous_numbers = np.vstack(
                [position, np.take_along_axis(np.vstack([first_row, block[1:]]), latest, axis=0)]
            )
            block[:] = previous_numbers[1:]  # row 0 of `previous_numbers` is the present position
            self._check_angles(first, is_missing[:, 3:], previous_numbers[:-1, 4])
        self.go_to_target(last - 1)

    def _check_angles(self, first: int, is_missing: Bools, previous_b: Array) -> None:
        """Refuse targets that lack some of A, B, C if the previous B is beyond ±90°.

        The controller may then keep the other set of angles of that orientation: A ± 180, ±180 − B, C ± 180.

        :param first: row of the first target.
        :param is_missing: (n, 3) True where A, B, C are missing, from row `first` on.
        :param previous_b: (n,) B [deg] of the targets before.
        :raises ProgramError: there is such a target.
        """
        is_partial = any_column(is_missing) & ~is_missing.all(axis=1)
        uncertain_rows = np.flatnonzero(is_partial & (np.abs(previous_b) > LARGEST_B))
        if len(uncertain_rows):
            angle = previous_b[uncertain_rows[0]]
            problem = f"A, B or C is missing, and the previous B is {angle:g}°: beyond 90° it is not certain"
            problem += " which angles the controller keeps"
            raise self.trace.error(problem, int(self.trace_row[first + uncertain_rows[0]]), "Write all of A, B, C.")

    def _check_frames(self, first: int, last: int, incomplete: Bools) -> None:
        """Refuse missing components right after a change of frames: the previous values refer to other frames.

        :param first: first row; `last` is the row behind the last.
        :param incomplete: (n,) True where a component is missing, from row `first` on.
        :raises ProgramError: there is such a target.
        """
        robot_position, (base, tool, _, _) = self.robot_position, self.targets.frames
        has_changed = np.zeros(last - first, dtype=np.bool_)
        has_changed[1:] = (np.diff(base[first:last]) != 0) | (np.diff(tool[first:last]) != 0)
        # behind an axis target the components are computed for the present frames
        has_changed[0] = robot_position.numbers is not None and (robot_position.base, robot_position.tool) != (
            base[first],
            tool[first],
        )
        uncertain_rows = np.flatnonzero(has_changed & incomplete)
        if len(uncertain_rows):
            problem = "components are missing right after $BASE or $TOOL changed: the values they keep are not certain"
            raise self.trace.error(problem, int(self.trace_row[first + uncertain_rows[0]]), _FRAME_ADVICE)

    def complete_special_target(self, row: int, move: MotionStatement | None) -> None:
        """Complete the target of one of the `_special_rows`, and make it the present position.

        :param row: row of the motion.
        :param move: its statement; None if it was read in bulk.
        :raises ProgramError: the target is not certain, or the points of a circle do not define a circle.
        """
        if move is not None and move.end.position.is_axis:
            self._complete_axis_target(row, move)
            return
        start, control = self.present_numbers(row).copy(), self.control  # a copy: the array may be changed below
        if move is not None and move.relative_axes:
            self.starts_from_joints[row] = self.robot_position.numbers is None
            self.numbers[row] = self._relative_target(move, start)
            if move.via is not None:
                via = start[:3] + _offset_in_base(move.via.position, move.relative_axes, start)
                self.circles[row] = np.stack([via, self.numbers[row, :3]])
        else:
            if control.keeps_orientation[row]:
                self.numbers[row, 3:] = start[3:]
            self.complete_absolute_targets(row, row + 1)
        angle = None if move is None or move.angle is None else move.angle * RAD_PER_DEG
        if angle is not None or (control.keeps_orientation[row] and control.turns_with_path[row]):
            self._set_end_of_circle(row, start, angle)
        self.go_to_target(row)

    def _set_end_of_circle(self, row: int, start: Array, angle: float | None) -> None:
        """Set the end of a circle in `numbers`.

        With CA the end is the point at that angle. Where the orientation is kept relative to the path, it turns by the
        angle of the arc.

        :param row: row of the circle.
        :param start: (6,) X…C [mm, deg] at the start of the circle.
        :param angle: CA [rad]; None without CA.
        :raises ProgramError: the points do not define a circle.
        """
        begin, end = start[:3] * M_PER_MM, self.numbers[row, :3] * M_PER_MM
        # auxiliary point [mm] of a relative or another circle; missing components are those of the start
        via = self.circles[row][0] if row in self.circles else self.control.via[row]
        via = np.where(np.isnan(via), begin, via * M_PER_MM)
        arcs = circle_geometry(self.trace, self.trace_row[row : row + 1], begin[None], via[None], end[None])
        axis = arcs.axis[0]
        if angle is not None:
            self.numbers[row, :3] = MM_PER_M * rotated_point(begin, arcs.centre[0], axis, angle)
        if self.control.keeps_orientation[row] and self.control.turns_with_path[row]:
            pose = pose_from_xyzabc(self.numbers[row])
            pose[:3, :3] = rotation_from_vector(axis * (arcs.angle[0] if angle is None else angle)) @ pose[:3, :3]
            self.numbers[row, 3:] = xyzabc_from_pose(pose)[3:]

    def _complete_axis_target(self, row: int, move: MotionStatement) -> None:
        """Complete an axis target, in which missing axes keep their angles, and make it the present position.

        :param row: row of the motion; `move` is its statement.
        :raises ProgramError: angles are missing or relative, and the angles before are not known.
        """
        angles, previous_joints = np.array(move.end.position.values) * RAD_PER_DEG, self.robot_position.joints
        if previous_joints is None and (move.relative_axes or np.isnan(angles).any()):
            raise self.trace.error(
                "the joint angles before this motion are not known",
                move.trace_row,
                "Give all of A1 … A6, not relative.",
            )
        if previous_joints is not None:
            angles = (
                previous_joints + np.nan_to_num(angles)
                if move.relative_axes
                else np.where(np.isnan(angles), previous_joints, angles)
            )
        self.starts_from_joints[row] = self.robot_position.numbers is None
        self.joints[row] = angles
        flange = self.kinematics(angles)
        if (carriage := self.targets.carriage) is not None:
            flange = flange_on_track(flange, carriage, float(carriage.end[row]))
        self.robot_position = _RobotPosition(flange, angles)
        self.numbers[row] = self.present_numbers(row)

    def _relative_target(self, move: MotionStatement, start: Array) -> Array:
        """Return X…C (6,) [mm, deg] of a relative target; A, B, C are those of the start.

        :param start: (6,) X…C [mm, deg] at which the motion begins.
        :raises ProgramError: the target turns the tool.
        """
        position = move.end.position
        angle_changes = np.nan_to_num(np.array(position.values)[3:])  # NaN: the text does not state the angle
        if np.any(angle_changes != 0.0):
            raise self.trace.error("relative A, B, C are not supported", move.trace_row, "Write it with LIN or PTP.")
        return np.concatenate([start[:3] + _offset_in_base(position, move.relative_axes, start), start[3:]])


def _offset_in_base(position: Position, axes: str, start: Array) -> Array:
    """Return the offset (3,) [mm] of a relative point from the start of its motion, in `$BASE` axes.

    :param position: the relative point; its missing components are NaN, and count as 0.
    :param axes: ``#BASE`` or ``#TOOL``: the axes in which the text gives the offset.
    :param start: (6,) X…C [mm, deg] at which the motion begins.
    """
    offset = np.nan_to_num(np.array(position.values[:3]))
    return np.asarray(pose_from_xyzabc(start)[:3, :3] @ offset) if axes == "#TOOL" else offset


def flange_on_track(flange: Array, carriage: Carriage, position: float) -> Array:
    """Return a flange pose (4, 4) [m] in the robot root at E1 = 0.

    :param flange: (4, 4) in the robot root at `position` [m].
    :param position: position of the linear axis that carries the robot [m].
    """
    carried_flange = flange.copy()
    carried_flange[:3, 3] += position * carriage.direction
    return carried_flange


def end_poses(
    targets: TextTargets,
    start_joints: Array,
    kinematics: Callable[[Array], Array],
    predecessors: Ints | None = None,
) -> EndPoses:
    """Return the complete targets of M motions.

    :param targets: their `numbers` are completed in place.
    :param start_joints: (6,) joint angles at the start of the program [rad].
    :param kinematics: (6,) joints [rad] → (4, 4) flange in the robot root [m].
    :param predecessors: (M,) the motion at whose end each begins, see `Program.after`; None: the motion before it.
    :raises ProgramError: a component is missing and its previous value is not certain; a relative target turns the
        tool; an axis is missing or relative and its angle before is not known; the points of a circle do not define a
        circle.
    """
    numbers, keeps_orientation = targets.numbers, targets.control.keeps_orientation
    start_flange = kinematics(start_joints)
    if targets.carriage is not None:
        start_flange = flange_on_track(start_flange, targets.carriage, float(targets.carriage.begin[0]))
    programmed_angles, is_incomplete = numbers[keeps_orientation, 3:], any_column(np.isnan(numbers[:, 3:]))
    numbers[keeps_orientation, 3:] = np.nan  # #CONSTANT: filled in from the previous target, as missing components are
    completer = _TargetCompleter(targets, _RobotPosition(start_flange, start_joints), kinematics)
    row = 0
    for special_row in _special_rows(targets):
        completer.complete_absolute_targets(row, special_row)
        completer.complete_special_target(special_row, targets.statements.get(special_row))
        row = special_row + 1
    completer.complete_absolute_targets(row, len(numbers))

    pose = poses_from_xyzabc(numbers)
    start = Starts.of(targets.frames, pose.__getitem__, start_flange, predecessors)
    is_ignored = np.zeros(len(numbers), dtype=np.bool_)
    is_ignored[keeps_orientation] = any_column(
        np.abs(programmed_angles - numbers[keeps_orientation, 3:]) > _ANGLE_TOLERANCE
    )
    _check_ignored(targets, is_incomplete, is_ignored)
    return EndPoses(
        numbers=numbers,
        pose=pose,
        joints=Runs.from_rows(numbers.shape, completer.joints),
        start=start,
        starts_from_joints=completer.starts_from_joints,
        ignores_orientation=is_ignored,
        circles=completer.circles,
    )


def _special_rows(targets: TextTargets) -> list[int]:
    """Return the rows of motions whose targets are completed one by one, in order.

    These motions have axis or relative targets, are circles with CA, or keep the orientation of their start
    (#CONSTANT). A motion under #CONSTANT counts only if it is the first in its frames, or keeps the orientation
    relative to the path of a circle; otherwise A, B, C are filled in like missing components.
    """
    special_rows = {
        row
        for row, move in targets.statements.items()
        if move.end.position.is_axis or move.relative_axes or move.angle is not None
    }
    base, tool, control = targets.frames.base, targets.frames.tool, targets.control
    has_new_frame = np.append(True, (np.diff(base) != 0) | (np.diff(tool) != 0))[: len(base)]  # empty without motions
    oriented_rows = np.flatnonzero(control.keeps_orientation & (has_new_frame | control.turns_with_path))
    return sorted(special_rows.union(oriented_rows.tolist()))


def _check_ignored(targets: TextTargets, is_incomplete: Bools, is_ignored: Bools) -> None:
    """Refuse missing A, B, C behind targets whose A, B, C were ignored: it is not certain which the controller keeps.

    A motion that does not keep the orientation of its start ends the effect of ignored angles before it.

    :param is_incomplete: (M,) True where A, B or C is missing in the text; set to False for axis targets.
    :param is_ignored: (M,) True where A, B, C of the text differ from those of the target.
    :raises ProgramError: there is such a target.
    """
    if not is_ignored.any():
        return
    all_rows, keeps_orientation = np.arange(len(is_ignored)), targets.control.keeps_orientation
    # up to each motion: the last with ignored angles, and the last that does not keep the orientation; −1: none
    last_ignored_row = np.maximum.accumulate(np.where(is_ignored, all_rows, -1))
    last_free_row = np.maximum.accumulate(np.where(keeps_orientation, -1, all_rows))
    is_incomplete[targets.axis_rows()] = False
    follows_ignored = (last_ignored_row > last_free_row)[:-1]  # for each motion from the second on
    rows = np.flatnonzero(is_incomplete[1:] & ~keeps_orientation[1:] & follows_ignored) + 1
    if len(rows):
        raise targets.trace.error(
            "A, B, C are missing behind targets under $ORI_TYPE=#CONSTANT whose own A, B, C were ignored: which of "
            "them stay is not certain",
            int(targets.trace_row[rows[0]]),
            "Write all of A, B, C in this target.",
        )


def circle_geometry(trace: Trace, trace_row: Ints, start: Array, via: Array, end: Array) -> Arcs:
    """Return n arcs, each through three points in `$BASE`.

    :param trace_row: (n,) rows of the circles in the trace, from 1, for messages.
    :param start: (n, 3) start points [m].
    :param via: (n, 3) points between start and end [m].
    :param end: (n, 3) end points [m].
    :raises ProgramError: the three points lie on a straight line, or two of them coincide.
    """
    centre, axis, angle, is_flat = arcs_through(start, via, end)
    if is_flat.any():
        raise trace.error(
            "the three points of the circle lie on a line or coincide",
            int(trace_row[np.argmax(is_flat)]),
            "Choose an auxiliary point well between start and end; for a full circle give CA.",
        )
    return Arcs(centre, axis, angle)


def rotated_point(start: Array, centre: Array, axis: Array, angle: float) -> Array:
    """Return the point (3,) to which a rotation about an axis moves the point `start` (3,).

    :param centre: (3,) a point on the axis.
    :param axis: (3,) unit vector.
    :param angle: angle of the rotation, by the right hand [rad].
    """
    end: Array = centre + rotation_from_vector(axis * angle) @ (start - centre)
    return end


def same_orientation(r1: Array, r2: Array) -> Bools:
    """Return where (...) orientations `r1` and `r2` (..., 3, 3) differ by less than `_ORIENTATION_TOLERANCE`."""
    trace = np.einsum("...ij,...ij->...", r1, r2)  # of r1ᵀ·r2: 1 + 2·cos of the angle between them
    return np.asarray(trace > 1.0 + 2.0 * np.cos(_ORIENTATION_TOLERANCE))
