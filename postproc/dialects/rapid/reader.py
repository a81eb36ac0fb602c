r"""From a RAPID module to a `Program`.

Assumptions: the base frame of the robot is the world frame; routines of modules that neither the file nor the cell
names do not move the robot; vmax is 5000 mm/s. Numbers are taken as the controller stores them, in single precision.

Along a circle the tool turns with the path, unless ``CirPathMode\ObjectFrame`` is set; on a line under
``SingArea\Wrist`` the wrist axes turn it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc import garbage
from postproc.cell import Cell
from postproc.chunks import Runs
from postproc.dialects import circles
from postproc.dialects.changed_data import changed_data_issue
from postproc.dialects.circles import ArcColumns
from postproc.dialects.rapid.execution import EndlessLoop, ExecutedProgram, RapidError, RunBegin
from postproc.dialects.rapid.expansion import ExpandedProgram, expand
from postproc.dialects.rapid.language import abb_from_joints, joints_from_abb, poses, status_from_cfx
from postproc.dialects.rapid.layout import Layout
from postproc.dialects.rapid.loaded import load_modules
from postproc.dialects.rapid.moves import Move
from postproc.dialects.rapid.next_run import ChangedData
from postproc.dialects.rapid.procedures import program_procedures, setting_elsewhere
from postproc.dialects.rapid.syntax import Comment, RapidSyntaxError, Statement, all_statements
from postproc.dialects.rapid.syntax import Instruction as RapidInstruction
from postproc.dialects.rapid.values import NOT_CONNECTED, UnknownValueError, Value, record_numbers
from postproc.dialects.text import line_spans
from postproc.errors import InputError, Issue, ProgramError, combined_error, first_of, line_names
from postproc.frames import M_PER_MM, RAD_PER_DEG, Array, inverse, norm, xyzabc_from_pose
from postproc.poses import Poses
from postproc.program import (
    CIRC,
    FORCE_COMMENT,
    LIN,
    PTP,
    Bools,
    Document,
    Event,
    ForceNote,
    FrameColumns,
    Ints,
    Motions,
    Program,
    Starts,
    parse_force_note,
)

_NORM_TOLERANCE = 1e-3
"""Largest difference of the sum of squares of a quaternion from 1: its numbers may have three decimals."""
_LARGEST_COORDINATE = 1e5
"""Largest coordinate of a target or frame [mm] (assumed)."""
_LENGTH_TOLERANCE = 1e-9
"""Shorter moves [m] are rounding."""
_ROTATION_TOLERANCE = 1e-6
"""Smaller changes of a rotation matrix (Frobenius norm) are the rounding of written quaternions."""
_MOST_NAMES = 5
"""Largest number of names in one message; further names are counted."""


def read(document: Document, cell: Cell, forward_kinematics: Callable[[Array], Array], name: str) -> Program:
    """Read a RAPID module.

    :param cell: its start position, and the tool and work object of modules that declare none.
    :param forward_kinematics: (6,) joints [rad] → (4, 4) flange in the robot root [m], by the nominal geometry of the
        controller.
    :param name: name of the program.
    :raises InputError: all statements that cannot be followed, together, each with its line and advice.
    """
    with garbage.collection_paused():
        return _Reader(document, cell).program(forward_kinematics, name)


class _Path(NamedTuple):
    """The M motions of a module.

    :param motions: the motions.
    :param bases: (n, 4, 4) frames of the work objects in the robot root [m].
    :param tools: (n, 4, 4) frames of the tools in the flange [m].
    :param numbers: (M, 6) X, Y, Z, A, B, C [mm, deg] of the targets, exactly as in the text; for joint targets, of the
        poses that they reach.
    :param is_wrist_led: (M,) True if the wrist axes turn the tool.
    :param turns_with_path: (M,) True if the tool turns with its path.
    """

    motions: Motions
    bases: Array
    tools: Array
    numbers: Array
    is_wrist_led: Bools
    turns_with_path: Bools


class _Reader:
    """Reader of one module.

    :ivar loaded: modules that the controller has loaded in addition.
    :ivar names: type, TOOLDATA or WOBJDATA → names of data of this type that no module declares.
    :ivar frames: type → frame of the cell that is used for these data.
    """

    def __init__(self, document: Document, cell: Cell) -> None:
        self.document, self.cell = document, cell
        self.loaded = load_modules(cell)
        self.names: dict[str, set[str]] = {}
        self.frames: dict[str, _FrameOfCell] = {}

    def program(self, forward_kinematics: Callable[[Array], Array], name: str) -> Program:
        """Return the program.

        :param forward_kinematics: (6,) joints [rad] → (4, 4) flange in the robot root [m].
        :param name: name of the program.
        :raises InputError: the module cannot be followed, or has no motions.
        """
        expanded_program = self._expand(name)
        execution = expanded_program.executed
        line = self._file_lines(  # of each move
            expanded_program, np.array([move.statement.start for move in execution.moves], dtype=np.int64)
        )
        if execution.errors:
            lines = self._file_lines(expanded_program, np.array([cause.start for cause in execution.errors])).tolist()
            pairs = zip(execution.errors, lines, strict=True)
            raise combined_error([self._error(cause.problem, at, cause.advice) for cause, at in pairs])
        if not execution.moves:
            raise ProgramError(
                "there are no motions", file=self.document.name, advice="Check that this is the program."
            )
        comments, notes = self._notes(expanded_program)
        self._check_force_of_rounds(expanded_program, notes)
        self._check_force_of_runs(expanded_program, notes)
        predecessor = _predecessors(execution)
        path = self._motions(execution.moves, line, forward_kinematics, predecessor)
        is_plain = not expanded_program.loop_lines and not expanded_program.copied_names  # nothing was expanded
        all_modules = (*self.loaded.modules, *expanded_program.modules)
        data_names = frozenset(data.name for module in all_modules for data in module.data)
        return Program(
            name,
            "rapid",
            (self.document,),
            path.motions,
            path.bases,
            path.tools,
            tool_keys=_tool_names(execution.moves, path.motions.tool, len(path.tools)),
            events=self._waits(expanded_program),
            notes=notes,
            issues=tuple(self._issues(expanded_program)),
            after=predecessor,
            is_wrist_led=path.is_wrist_led if path.is_wrist_led.any() else None,
            turns_with_path=path.turns_with_path if path.turns_with_path.any() else None,
            turn_speeds=_turn_speeds(execution.moves),
            layout=Layout(path.numbers, expanded_program.text, is_plain, tuple(execution.moves), comments, data_names),
        )

    # --- text

    def _expand(self, name: str) -> ExpandedProgram:
        """Return the executed program, with loops and calls expanded so that each statement moves once.

        :param name: name of the program.
        :raises ProgramError: it is not valid RAPID, or cannot be followed.
        """
        text = self.document.text
        try:
            procedures_of = partial(
                program_procedures,
                file_name=self.document.name,
                program_name=name,
                procedure_names=self.cell.rapid.procedures,
            )
            start_numbers = [*abb_from_joints(self.cell.start_joints).tolist(), *[NOT_CONNECTED] * 6]
            return expand(
                text, procedures_of, self._cell_frame, self.cell.rapid.without_effect, self.loaded, start_numbers
            )
        except RapidSyntaxError as cause:
            advice = "Check the file in RobotStudio. If it is accepted there, please report this."
            if cause.is_at_end:
                advice = "The file is not complete: write or copy it again."
            # number of lines that begin at or before the offset
            line = int(np.searchsorted(line_spans(text)[0], cause.start, side="right"))
            raise self._error(cause.problem, line, advice) from None
        except RapidError as cause:
            raise self._error(cause.problem, max(cause.line, 1), cause.advice) from None

    @staticmethod
    def _file_lines(expanded_program: ExpandedProgram, start: Ints) -> Ints:
        """Return the lines (n,) of the file from which the characters at n offsets of the expanded text come.

        The expanded text: loops with moves are written out, and routines have a copy for each call.

        :param start: (n,) offsets.
        """
        # the last line that begins at or before each offset
        return np.asarray(
            expanded_program.line[np.searchsorted(line_spans(expanded_program.text)[0], start, side="right") - 1]
        )

    def _waits(self, expanded_program: ExpandedProgram) -> tuple[Event, ...]:
        """Return the waits in execution order, each as a dwell at the next motion; their times are not stated."""
        waits = expanded_program.executed.waits
        lines = self._file_lines(expanded_program, np.array([start for start, _ in waits], dtype=np.int64)).tolist()
        return tuple(
            Event(before=count, kind="dwell", line=line, value=np.nan)
            for (_, count), line in zip(waits, lines, strict=True)
        )

    def _cell_frame(self, name: str, type_: str) -> Value | None:
        """Return [tool] or [base] of the cell for data that no module declares.

        :param name: name of the data.
        :param type_: TOOLDATA or WOBJDATA.
        :raises UnknownValueError: the program uses other data of this type too: the cell has one frame for it.
        """
        type_names = self.names.setdefault(type_, set())
        type_names.add(name)
        if len(type_names) > 1:
            raise UnknownValueError(
                f"{first_of(sorted(type_names), _MOST_NAMES)} are not declared in this file, and the cell has but one "
                f"{'tool' if type_ == 'TOOLDATA' else 'base'}"
            )
        if type_ not in self.frames:
            self.frames[type_] = _FrameOfCell(self.cell.tool.pose() if type_ == "TOOLDATA" else self.cell.base.pose())
        return self.frames[type_]

    def _notes(self, expanded_program: ExpandedProgram) -> tuple[tuple[Comment, ...], tuple[ForceNote, ...]]:
        """Return the force comments, and of each the note: its wrench, and the index of the motion that it precedes.

        :raises InputError: force comments cannot be read; all errors together.
        """
        comments: list[Comment] = []
        notes: list[ForceNote] = []
        errors: list[InputError] = []
        starts = line_spans(expanded_program.text)[0]
        for comment, motion_index in expanded_program.executed.notes:
            # the last line of the text that begins at or before the comment
            line = int(expanded_program.line[np.searchsorted(starts, comment.start, side="right") - 1])
            try:
                note = parse_force_note(comment.text, line, self.document.name)
            except InputError as cause:
                errors.append(cause)
                continue
            if note is not None:
                comments.append(comment)
                notes.append(replace(note, before=motion_index))
        if errors:
            raise combined_error(errors)
        return tuple(comments), tuple(notes)

    def _check_force_of_rounds(self, expanded_program: ExpandedProgram, notes: Sequence[ForceNote]) -> None:
        """Refuse a loop without end whose first straight or circular move has another force in the second round.

        A force comment before that move, in the loop, makes the two forces equal. Other moves have no force.

        :param notes: the force comments, in order.
        :raises ProgramError: the force differs.
        """
        executed = expanded_program.executed
        loop = executed.endless_loop
        if loop is None or not _keeps_force(executed, notes, loop):
            return
        count = _count_force_comments(executed, loop.note_count)
        # the last force before the loop, and at the end of its round; none if it is zero, in whatever axes
        begin_force, end_force = (
            [(note.wrench, note.frame) for note in acting[-1:] if any(note.wrench)] for acting in (notes[:count], notes)
        )
        if begin_force != end_force:
            problem = "this loop never ends, and its round ends under another force than it began with"
            advice = "Write a force comment, such as FORCE OFF, before the first move of the loop."
            raise self._error(problem, self._loop_line(expanded_program, loop), advice)

    def _check_force_of_runs(self, expanded_program: ExpandedProgram, notes: Sequence[ForceNote]) -> None:
        """Refuse a run whose first straight or circular move would have the force with which the run before it ends.

        Whether that run is before it is not known. A force comment before the move decides.

        :param notes: the force comments, in order.
        :raises ProgramError: the force does not vanish.
        """
        executed = expanded_program.executed
        for begin in executed.begins:
            # the last force comment before the run; there may be none
            last_note = notes[: _count_force_comments(executed, begin.note_count)][-1:]
            if _keeps_force(executed, notes, begin) and any(any(note.wrench) for note in last_note):
                problem = "the procedure before this one ends under a force, and it is not known whether it runs before"
                advice = "Write a force comment, such as FORCE OFF, at the end of that procedure."
                line = int(self._file_lines(expanded_program, np.array([begin.start]))[0])
                raise self._error(problem, line, advice)

    def _loop_line(self, expanded_program: ExpandedProgram, loop: EndlessLoop) -> int:
        """Return the line of a loop without end in the file."""
        return int(self._file_lines(expanded_program, np.array([loop.start]))[0])

    # --- motions

    def _motions(
        self,
        moves: list[Move],
        line: Ints,
        forward_kinematics: Callable[[Array], Array],
        predecessor: Ints | None,
    ) -> _Path:
        """Return the motions of M moves.

        :param line: (M,) lines of the moves in the file.
        :param forward_kinematics: (6,) joints [rad] → (4, 4) flange in the robot root [m].
        :param predecessor: (M,) move at whose end each begins, −1 for the start of the program; None: the move before.
        :raises ProgramError: a number or frame of a move is not valid, or its way of turning the tool is not known.
        """
        kind = np.array([move.kind for move in moves], dtype=np.int64)
        has_joints = np.array([move.has_joint_target for move in moves])
        base, bases = self._frames(moves, line, [(move.wobj, True) for move in moves], self._wobj_frame)
        tool, tools = self._frames(moves, line, [(move.tool, move.tool_name != "") for move in moves], self._tool_frame)
        target_numbers, joints = self._target_values(moves, line, has_joints)
        pose, numbers = np.empty((len(line), 4, 4)), np.full((len(line), 6), np.nan)
        pose_numbers = target_numbers[~has_joints, :7]  # x, y, z [mm], q1…q4
        pose[~has_joints], numbers[~has_joints] = poses(pose_numbers), _xyzabc_in_text(pose_numbers)
        for row in np.flatnonzero(has_joints).tolist():
            pose[row] = inverse(bases[base[row]]) @ forward_kinematics(joints[row]) @ tools[tool[row]]
        if has_joints.any():
            numbers[has_joints] = xyzabc_from_pose(pose[has_joints])
        frames = FrameColumns(base, tool, bases, tools)
        starts = Starts.of(frames, pose.__getitem__, forward_kinematics(self.cell.start_joints), predecessor)
        start = starts.at(np.arange(len(line)))
        arcs = self._arcs(moves, start, pose, line, kind == CIRC)
        is_wrist_led, turns_with_path = self._turning_modes(moves, kind, start, pose, line)
        status = np.full(len(line), -1)
        has_status = np.array([move.setting.follows_configuration for move in moves]) & (kind == PTP) & ~has_joints
        status[has_status] = status_from_cfx(target_numbers[has_status, 10].astype(np.int64))  # column 10: cfx
        motions = Motions(
            kind=kind,
            rapid=kind == PTP,
            line=line,
            target=Poses.of(pose),
            joints=Runs.of(joints),
            centre=arcs.centre,
            normal=arcs.normal,
            sweep=arcs.sweep,
            feed=self._tcp_speed(moves, kind, start, pose, arcs, line),
            base=base,
            tool=tool,
            blend=_single_precision([move.zone for move in moves]) * M_PER_MM,
            rounding=np.full(len(line), np.inf),
            status=status,
            turn=np.full(len(line), -1),
        )
        return _Path(motions, bases, tools, numbers, is_wrist_led, turns_with_path)

    def _target_values(self, moves: list[Move], line: Ints, has_joints: Bools) -> tuple[Array, Array]:
        """Return the numbers of robtargets (M, 17), and joint angles (M, 6) [rad]; NaN where a move has none.

        :param line: (M,) lines of the moves.
        :param has_joints: (M,) True for moves to joint angles.
        :raises ProgramError: a number is not valid, or an external axis is not at 0.
        """
        target_numbers, joints = np.full((len(moves), 17), np.nan), np.full((len(moves), 6), np.nan)
        if not has_joints.all():
            target_numbers[~has_joints] = [move.target.numbers for move in moves if not move.has_joint_target]
        angles = np.array([move.target.numbers for move in moves if move.has_joint_target]).reshape(-1, 12)
        self._check_targets(target_numbers[~has_joints], line[~has_joints])
        self._check_external(
            np.concatenate([target_numbers[~has_joints][:, 11:], angles[:, 6:]]),
            np.concatenate([line[~has_joints], line[has_joints]]),
        )
        joints[has_joints] = joints_from_abb(angles[:, :6].astype(np.float32).astype(np.float64))
        return target_numbers, joints

    def _error(self, problem: str, line: int, advice: str) -> ProgramError:
        """Return an error at a line of the file, from 1."""
        starts, stops = line_spans(self.document.text)
        line_text = self.document.text[starts[line - 1] : stops[line - 1]].strip()
        return ProgramError(problem, file=self.document.name, line=line, text=line_text, advice=advice)

    def _frames(
        self, moves: list[Move], line: Ints, values: list[tuple[Value, bool]], pose_of: Callable[[Value], Array]
    ) -> tuple[Ints, Array]:
        """Return the row of the frame of each motion (M,), and the frames (n, 4, 4) [m].

        Equal values have one row, except that data with a name share no row with other values. For speed, an object
        that was compared before is recognised by its id.

        :param line: (M,) lines of the moves.
        :param values: for each motion, the value of its tool or work object, and True if this is data with a name.
        :param pose_of: returns the frame of a value.
        :raises ProgramError: a value is no valid frame.
        """
        row_of_object: dict[tuple[int, bool], int] = {}  # id of a value → row
        row_of_text: dict[tuple[str, bool], int] = {}  # text of a value → row
        frames: list[Array] = []
        frame_rows = np.zeros(len(moves), dtype=np.int64)
        for k, (value, is_named) in enumerate(values):
            row = row_of_object.get((id(value), is_named))
            if row is None:
                key = repr(value), is_named
                row = row_of_text.get(key)
                if row is None:
                    try:
                        frames.append(pose_of(value))
                    except UnknownValueError as cause:
                        advice = "Give it as a plain declaration in this file."
                        raise self._error(cause.problem, int(line[k]), advice) from None
                    row = row_of_text[key] = len(frames) - 1
                row_of_object[id(value), is_named] = row
            frame_rows[k] = row
        return frame_rows, np.stack(frames)

    @staticmethod
    def _tool_frame(value: Value) -> Array:
        """Return the frame (4, 4) of a tooldata value in the flange [m].

        :raises UnknownValueError: the value is no tooldata, or the robot does not hold the tool.
        """
        if isinstance(value, _FrameOfCell):
            return value.pose
        if not isinstance(value, list) or len(value) != 3 or not isinstance(value[0], bool):
            raise UnknownValueError("the tool is no tooldata")
        if not value[0]:
            raise UnknownValueError(
                "the tool is fixed in the room and the robot holds the part, which is not supported"
            )
        return _pose(value[1])

    @staticmethod
    def _wobj_frame(value: Value) -> Array:
        """Return the frame (4, 4) of a wobjdata value in the world [m].

        :raises UnknownValueError: the value is no wobjdata, the work object moves, or the robot holds it.
        """
        if isinstance(value, _FrameOfCell):
            return value.pose
        if not isinstance(value, list) or len(value) != 5:
            raise UnknownValueError("the work object is no wobjdata")
        is_held, is_fixed, unit, user, frame = value
        if is_held is not False:
            raise UnknownValueError("the robot holds the work object, which is not supported")
        if is_fixed is not True or unit != "":
            raise UnknownValueError(f"the work object moves with the mechanical unit {unit!r}, which is not supported")
        return np.asarray(_pose(user) @ _pose(frame))

    def _check_targets(self, numbers: Array, line: Ints) -> None:
        """Check the numbers (n, 17) of robtargets; errors name the lines (n,).

        They are x, y, z [mm], q1…q4, cf1, cf4, cf6, cfx and six external axes.

        :raises ProgramError: a target is out of reach of any robot, or its orientation or configuration is not valid.
        """
        is_too_far = np.abs(numbers[:, :3]) > _LARGEST_COORDINATE
        if is_too_far.any():
            raise self._error(
                "no robot reaches this target", int(line[np.argmax(is_too_far.any(axis=1))]), "Coordinates are in mm."
            )
        is_not_unit = np.abs(np.einsum("ni,ni->n", numbers[:, 3:7], numbers[:, 3:7]) - 1.0) > _NORM_TOLERANCE
        if is_not_unit.any():
            advice = "The squares of q1…q4 must add up to 1: give them with more decimals."
            raise self._error("the orientation is not a unit quaternion", int(line[np.argmax(is_not_unit)]), advice)
        has_invalid_axis_data = (
            (numbers[:, 7:11] != np.round(numbers[:, 7:11])).any(axis=1) | (numbers[:, 10] < 0) | (numbers[:, 10] > 7)
        )
        if has_invalid_axis_data.any():
            raise self._error(
                "the configuration (cf1, cf4, cf6, cfx) is not understood",
                int(line[np.argmax(has_invalid_axis_data)]),
                "It has four whole numbers, the last from 0 to 7.",
            )

    def _check_external(self, values: Array, line: Ints) -> None:
        """Check that the external axes (n, 6) [mm, deg] of targets are 0 or not connected; errors name the lines (n,).

        :raises ProgramError: an axis is not at 0: it may displace robot or part.
        """
        is_used = (np.abs(values) < NOT_CONNECTED) & (values != 0.0)
        if is_used.any():
            row, column = np.argwhere(is_used)[0].tolist()
            name = f"eax_{'abcdef'[column]}"
            problem = (
                f"the external axis {name} is at {values[row, column]:g}: where it carries robot or part is not known"
            )
            advice = f"Post the program with {name} at 0, or at 9E9 if it takes no part."
            raise self._error(problem, int(line[row]), advice)

    def _arcs(self, moves: list[Move], start: Array, pose: Array, line: Ints, is_circle: Bools) -> ArcColumns:
        """Return the arcs of motions; NaN for motions that are no circles.

        :param start: (M, 4, 4) poses at the starts of the motions [m].
        :param pose: (M, 4, 4) poses at their ends [m].
        :param line: (M,) lines of the moves.
        :param is_circle: (M,) True for circles.
        :raises ProgramError: three points are not on a circle, or a point on it is not valid.
        """
        rows = np.flatnonzero(is_circle)
        columns = ArcColumns.unset(len(line))
        if len(rows):
            via_numbers = np.array([move.via.numbers for move in moves if move.via is not None])
            self._check_targets(via_numbers, line[rows])
            via_points = poses(via_numbers[:, :7])[:, :3, 3]
            arcs = circles.arcs_through(start[rows, :3, 3], via_points, pose[rows, :3, 3])
            if arcs.is_flat.any():
                circle_line = int(line[rows[np.argmax(arcs.is_flat)]])
                problem = "the three points of the circle are on a line or coincide"
                raise self._error(problem, circle_line, "Write MoveL, or give the circle another point.")
            # centre, normal, sweep; `arcs` has is_flat too
            for column, values in zip(columns, arcs, strict=False):
                column[rows] = values
        return columns

    def _turning_modes(
        self, moves: list[Move], kind: Ints, start: Array, pose: Array, line: Ints
    ) -> tuple[Bools, Bools]:
        r"""Return which motions turn the tool by the wrist axes (M,) (SingArea\Wrist), and which with their path (M,).

        :param kind: (M,) `LIN`, `CIRC` or `PTP`.
        :param start: (M, 4, 4) poses at the starts of the motions.
        :param pose: (M, 4, 4) poses at their ends.
        :param line: (M,) lines of the moves.
        :raises ProgramError: a motion turns the tool in a way that is not known.
        """
        singularity_mode = np.array([move.setting.singularity_mode for move in moves])
        circle_mode = np.array([move.setting.circle_mode for move in moves])
        is_turned = norm((start[:, :3, :3] - pose[:, :3, :3]).reshape(-1, 9)) > _ROTATION_TOLERANCE
        faults = (
            (
                (singularity_mode == "LOCKAXIS4") & is_turned & (kind != PTP),
                "the turn of the tool is not known under SingArea\\LockAxis4",
            ),
            (
                (singularity_mode == "WRIST") & is_turned & (kind == CIRC),
                "the turn along a circle is not known under SingArea\\Wrist",
            ),
            (
                (kind == CIRC) & ~np.isin(circle_mode, ("PATHFRAME", "OBJECTFRAME")) & is_turned,
                "this CirPathMode is not followed",
            ),
        )
        for is_invalid, problem in faults:
            if is_invalid.any():
                advice = "Use SingArea\\Off and CirPathMode\\ObjectFrame, or keep the orientation along this move."
                raise self._error(problem, int(line[np.argmax(is_invalid)]), advice)
        is_wrist_led = (singularity_mode == "WRIST") & (kind == LIN)
        return is_wrist_led, (kind == CIRC) & (circle_mode == "PATHFRAME")

    def _tcp_speed(
        self, moves: list[Move], kind: Ints, start: Array, pose: Array, arcs: ArcColumns, line: Ints
    ) -> Array:
        """Return the speed of the TCP (M,) [m/s], in single precision; NaN for joint interpolation.

        For moves with a duration, it is the length of the path divided by the duration.

        :param kind: (M,) `LIN`, `CIRC` or `PTP`.
        :param start: (M, 4, 4) poses at the starts of the motions [m].
        :param pose: (M, 4, 4) poses at their ends [m].
        :param arcs: arcs of circles.
        :param line: (M,) lines of the moves.
        :raises ProgramError: a move without length has a duration.
        """
        speed = _single_precision([move.speed for move in moves]) * M_PER_MM
        duration = np.array([move.duration for move in moves])
        timed_rows = np.flatnonzero((duration > 0.0) & (kind != PTP))
        if len(timed_rows):
            length = norm(pose[timed_rows, :3, 3] - start[timed_rows, :3, 3])
            radius = norm(start[timed_rows, :3, 3] - arcs.centre[timed_rows])
            length = np.where(kind[timed_rows] == CIRC, radius * arcs.sweep[timed_rows], length)
            if (length < _LENGTH_TOLERANCE).any():
                move_line = int(line[timed_rows[np.argmin(length)]])
                raise self._error("a move without length has a duration (\\T)", move_line, "Give it a speed instead.")
            speed[timed_rows] = length / duration[timed_rows]
        return np.where(kind == PTP, np.nan, speed)

    # --- issues

    def _issues(self, expanded_program: ExpandedProgram) -> Iterator[Issue]:
        """Yield information and warnings on how the module was read."""
        execution = expanded_program.executed
        for name, (first_call_offset, count) in execution.unknown_calls.items():
            message = f"{name} is in no module of this file: it is assumed not to move the robot."
            line = int(self._file_lines(expanded_program, np.array([first_call_offset]))[0])
            yield Issue("warning", "external-call", message, line, subject=name.upper(), count=count)
        yield from self._cell_frame_issues(execution)
        for changed_data in expanded_program.changed_data:
            yield self._changed_data_issue(changed_data)
        yield from self._uncalled_issues(expanded_program)
        yield from self._setting_issues(expanded_program)
        if execution.endless_loop is not None:
            message = (
                "WHILE TRUE never ends: one round is corrected, and is what all rounds do. What follows it never runs."
            )
            yield Issue("info", "endless-loop", message, self._loop_line(expanded_program, execution.endless_loop))
        if execution.begins:
            procedures = [name for name in self.cell.rapid.procedures if name.upper() in execution.followed_names]
            names = first_of(procedures, _MOST_NAMES)
            message = f"Procedures that the cell names are corrected, each as a run of its own from [start]: {names}."
            yield Issue("info", "procedures", message)
        if expanded_program.loop_lines:
            lines = line_names(sorted(set(expanded_program.loop_lines)), _MOST_NAMES)
            message = f"Loops with moves are written out, round by round ({lines}): each round has its own targets."
            yield Issue("info", "loop-expanded", message, min(expanded_program.loop_lines))
        if expanded_program.copied_names:
            names = first_of(list(dict.fromkeys(expanded_program.copied_names)), _MOST_NAMES)
            message = f"Routines with moves that are called more than once get a copy for each call: {names}."
            yield Issue("info", "routine-copied", message)

    def _changed_data_issue(self, changed_data: ChangedData) -> Issue:
        """Return a warning that a later run of the program moves differently."""

        def file_line(start: int) -> int:
            """Return the line of the file at an offset."""
            return int(np.searchsorted(line_spans(self.document.text)[0], start, side="right"))

        change_places: dict[str, str] = {}
        for name, start in changed_data.changes.items():
            place = "its line is not known" if start is None else f"line {file_line(start)}"
            suffix = ", VAR: until PP to Main" if name in changed_data.variables else ""
            change_places[name] = f"{place}{suffix}"
        line = file_line(changed_data.start)
        return changed_data_issue(change_places, line, is_certain=changed_data.is_certain)

    def _uncalled_issues(self, expanded_program: ExpandedProgram) -> Iterator[Issue]:
        """Yield a warning for each routine that moves and is not followed."""
        routines = [routine for module in expanded_program.modules for routine in module.routines]
        for routine in routines:
            first_move = next(filter(_is_move, all_statements(routine.body)), None)
            if first_move is not None and routine.name not in expanded_program.executed.followed_names:
                message = (
                    f"{routine.kind} {routine.name} is not run by what is corrected: its moves are left as they are."
                )
                line = int(self._file_lines(expanded_program, np.array([first_move.start]))[0])
                yield Issue("warning", "uncalled-motions", message, line, subject=routine.name)

    def _setting_issues(self, expanded_program: ExpandedProgram) -> Iterator[Issue]:
        """Yield a warning for each routine that is not followed, and changes settings for procedures that it calls."""
        followed_names = expanded_program.executed.followed_names
        for routine in (routine for module in expanded_program.modules for routine in module.routines):
            statement = None if routine.name in followed_names else setting_elsewhere(routine, followed_names)
            if statement is not None:
                word = expanded_program.text[statement.start : statement.start + len(statement.name)]
                message = (
                    f"{routine.kind} {routine.name} is not followed, and changes {word} for procedures that it calls: "
                    "they are corrected with the settings of a new program. Make the settings in the procedures."
                )
                line = int(self._file_lines(expanded_program, np.array([statement.start]))[0])
                yield Issue("warning", "settings-elsewhere", message, line, subject=routine.name)

    @staticmethod
    def _cell_frame_issues(execution: ExecutedProgram) -> Iterator[Issue]:
        """Yield a warning for each tool and work object that is taken from the cell."""
        for name, type_ in execution.cell_data.items():
            section = "[tool]" if type_ == "TOOLDATA" else "[base]"
            message = (
                f"{name} is not declared in this file: {section} of the cell is taken for it. Check that they agree, "
                "or name its module in [rapid] modules."
            )
            yield Issue("warning", "frame-from-cell", message, subject=name)


class _FrameOfCell:
    """A frame of the cell in place of data that no module declares."""

    def __init__(self, pose: Array) -> None:
        self.pose = pose

    def __repr__(self) -> str:
        """Return a text by which the reader compares the frame with values of other tools and work objects."""
        return f"cell {self.pose.tolist()}"


def _predecessors(execution: ExecutedProgram) -> Ints | None:
    """Return the move (M,) at whose end each of M moves begins; −1 for the first move of each run. None for one run.

    −1 stands for the start of the program.
    """
    if not execution.begins:
        return None
    predecessor = np.arange(len(execution.moves)) - 1
    predecessor[[begin.move_count for begin in execution.begins]] = -1
    return predecessor


def _count_force_comments(executed: ExecutedProgram, note_count: int) -> int:
    """Return the number of force comments among the first comments of a program.

    :param note_count: number of these comments.
    """
    return sum(FORCE_COMMENT.match(comment.text) is not None for comment, _ in executed.notes[:note_count])


def _keeps_force(executed: ExecutedProgram, notes: Sequence[ForceNote], begin: EndlessLoop | RunBegin) -> bool:
    """Return whether the first straight or circular move of a loop or run has the force that holds before it.

    Otherwise a force comment before this move, in the loop or run, decides, or there is no such move.

    :param notes: the force comments, in order.
    """
    later_begins = [later.move_count for later in executed.begins if later.move_count > begin.move_count]
    end = min(later_begins, default=None)  # of this run; None: the end of the program
    moves = enumerate(executed.moves[begin.move_count : end], begin.move_count)
    first_path_move = next((row for row, move in moves if move.kind != PTP), None)
    count = _count_force_comments(executed, begin.note_count)
    return first_path_move is not None and not any(note.before <= first_path_move for note in notes[count:])


def _is_move(statement: Statement) -> bool:
    """Return whether a statement is an instruction whose name begins with Move."""
    return isinstance(statement, RapidInstruction) and statement.name.startswith("MOVE")


def _tool_names(moves: list[Move], tool: Ints, count: int) -> tuple[tuple[str, ...], ...]:
    """Return the names of the tooldata of each tool, in order of first use; several tooldata may have equal values.

    :param tool: (M,) index of the tool of each move.
    :param count: number of tools.
    """
    names: list[dict[str, None]] = [{} for _ in range(count)]
    for row, move in zip(tool.tolist(), moves, strict=True):
        if move.tool_name:
            names[row][move.tool_name] = None
    return tuple(map(tuple, names))


def _single_precision(values: list[float]) -> Array:
    """Return numbers rounded to single precision, as the controller stores them."""
    return np.array(values).astype(np.float32).astype(np.float64)


def _turn_speeds(moves: list[Move]) -> Runs | None:
    """Return the limits (M, 3) of rotational speed [rad/s] of M moves; None if no move has a rotational speed.

    The columns are those of `Program.turn_speeds`; infinite where there is no limit.
    """
    speeds = np.full((len(moves), 3), np.inf)
    # v_ori limits any rotation; RAPID has no limits for single axes of the tool: the other columns
    speeds[:, 0] = _single_precision([move.turn_speed for move in moves]) * RAD_PER_DEG
    return Runs.of(speeds) if np.isfinite(speeds).any() else None


def _pose(value: Value) -> Array:
    """Return the pose (4, 4) [m] of a RAPID value of type `pose`, [[x, y, z], [q1, q2, q3, q4]] [mm].

    :raises UnknownValueError: the value has another form, or a number is not valid.
    """
    numbers = np.array(record_numbers(value, 3, 4))
    if (np.abs(numbers[:3]) > _LARGEST_COORDINATE).any():
        raise UnknownValueError("the frame is beyond any cell")
    if abs(float(numbers[3:] @ numbers[3:]) - 1.0) > _NORM_TOLERANCE:
        raise UnknownValueError("the orientation of the frame is not a unit quaternion")
    return np.asarray(poses(numbers[None])[0])


def _xyzabc_in_text(stored_numbers: Array) -> Array:
    """Return X, Y, Z [mm], A, B, C [deg] (n, 6) of targets.

    X, Y, Z are the numbers in the text, not rounded as in the controller.

    :param stored_numbers: (n, 7) x, y, z [mm], q1…q4 in the text.
    """
    if not len(stored_numbers):
        return np.zeros((0, 6))
    matrices = poses(np.column_stack([np.zeros((len(stored_numbers), 3)), stored_numbers[:, 3:]]))
    numbers = xyzabc_from_pose(matrices)
    numbers[:, :3] = stored_numbers[:, :3]
    return np.asarray(numbers)
