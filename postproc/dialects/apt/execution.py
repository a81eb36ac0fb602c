"""Execution of a cutter-location file: from statements to moves in the program frame [mm].

- **RAPID** applies to the next motion only (ISO 4343:2000, 5.42); behind it the last feed applies again.
- **GOTO/x,y,z,i,j,k** states the direction from the tip to the spindle. A GOTO with three numbers keeps the last
  direction (Siemens NX states it once). In files of Creo, three numbers mean the direction z (PTC, Creo NC, "CL Output
  for Circular Interpolation"). ``MULTAX/OFF`` of CATIA keeps the direction (Dassault Systèmes, CATIA V5, "MULTAX
  Influence on APT Source"); in files of other systems it must then be stated again.
- **FROM** states the position of the tool at the beginning of the program: it becomes a joint motion to this position.
- **CYCLE**: the GOTO statements behind it are the tops of holes, see `cycles`.
- **CSYS** of SolidWorks CAM (after ``TRNTYP/WORLD``) states the axes of a setup and moves nothing: coordinates are
  those of the fixture already. Its third column is the direction of the tool. Source: the files. In one, an operation
  and its copies, turned by 90° and 180°, have CSYS that map each copy onto the first: their coordinates are where the
  copies are.
- **INSERT** of text that names a tool, a holder or the stock is a comment, see `inserted`; ``INSERT/STOP …`` stops.
- Arcs: see `arcs`.
- **LOADTL** selects the tool of this number in `[tools]`, stops the spindle, and leaves the tip where it is.
- **GOHOME** and **RETRCT** go where `[machine]` of the cell says, as G28 and G53 do; ``GOHOME/x,y,z`` in rapid to this
  place.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from msgspec.structs import replace

from postproc.cell import Cell, m_code_fault
from postproc.dialects.apt.arcs import (
    ARC_ADVICE,
    UNKNOWN_START,
    Compensation,
    PendingArc,
    axis_distance,
    circle_of,
    stated_angle,
    tangent_arc,
    turn_count,
)
from postproc.dialects.apt.cycles import Cycle, cycle_words
from postproc.dialects.apt.execution_result import ARC, LINE, RAPID, ExecutionResult, Fault, MoveEvent, MoveRun, Remark
from postproc.dialects.apt.inserted import inserted_comment, inserted_fault
from postproc.dialects.apt.statements import (
    COORDINATES_ADVICE,
    LENGTH_TOLERANCE,
    NEAR_MM,
    REFUSED,
    TEXT,
    WITHOUT_EFFECT,
    StatementError,
    Statements,
    numbers_of,
    refusal,
    values,
)
from postproc.dialects.apt.systems import sequence_at, sequence_lines, system_of
from postproc.dialects.circles import Circle, arc_point_count
from postproc.errors import MAX_ERRORS
from postproc.frames import MM_PER_INCH, Array, norm
from postproc.program import Bools, EventKind, Ints

_PER_MINUTE = {
    "MMPM": 1.0,
    "IPM": MM_PER_INCH,
    "FPM": 12 * MM_PER_INCH,
}
"""Unit of a feed per minute → millimetres in this unit."""
_PER_TURN = {"MMPR": 1.0, "IPR": MM_PER_INCH, "FPR": 12 * MM_PER_INCH}
"""Unit of a feed per turn of the spindle → millimetres in this unit."""
_UNITS = {"MM": 1.0, "INCH": MM_PER_INCH, "INCHES": MM_PER_INCH, "IN": MM_PER_INCH, "CM": 10.0}
"""Unit of length → its length [mm]."""
_UPRIGHT, _IS_DIRECTION = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), np.arange(6) >= 3
"""The six numbers of a GOTO with the direction z, and which of the six are the direction."""
_UNDIVIDED_SAGITTA_MM = 0.1
"""If an arc higher than this above its chord has one point, Creo does not divide the arcs of its sequence (assumed)."""
_COORDINATE_ROUNDING = 1e-3
"""More than the rounding of coordinates, in the unit of the file: files have four decimals or more."""
_MIN_AXIS_Z = 0.2
"""Smallest z of the tool direction for a retract along the tool: flatter retracts would be too long."""
_COMPENSATION_FAULT = (
    "the radius of the tool is in the control, not in the program",
    "Let the CAM system write the path of the tool's centre. If it is, and the offsets of the control hold wear only, "
    'write radius_offsets = "wear" in [gcode] of the cell.',
)
_AMBIGUOUS_POINTS = (
    "all GOTO after CIRCLE end on this circle: they may divide the arc, or be straight moves from one to the next",
    "Let the CAM system write one GOTO for each arc, or points only (Creo: CIRC_INTERPOLATION).",
)


class _Executor:
    """Executor of statements: state of the machine, and the moves, events and faults so far (`result`).

    In all methods, `row` is the row of the statement that is executed.

    :ivar place: (3,) position of the tool tip [mm], if `is_place_known`.
    :ivar axis: (3,) unit direction from the tip to the spindle.
    :ivar unit: length of a unit of the file [mm].
    :ivar is_next_rapid: True if the next move is rapid.
    :ivar feed: feed [mm/min], or [mm/turn] if `is_feed_per_turn`; 0: not stated.
    :ivar spindle_speed: speed of the spindle [1/min]; 0: not stated.
    :ivar spindle: kind of the last event of the spindle.
    :ivar tool: number of the tool in the spindle; None: the program has not selected a tool.
    :ivar pending_arc: arc that ends at the next GOTO; None without one.
    :ivar last_arc_circle: circle of the arc that ends at the last GOTO, if further points may belong to it; else None.
    :ivar sequence_lines: first lines of the NC sequences of Creo.
    :ivar undivided_sequences: sequences in which each arc has one point.
    :ivar leaving_direction: (3,) direction of INDIRV for the next arc; None without one.
    :ivar cycle: active drilling cycle; None without one.
    :ivar is_cycle_refused: True if the active CYCLE has a fault.
    :ivar axis_system: values of MSYS; None: not stated.
    :ivar has_world_system: True behind TRNTYP/WORLD.
    :ivar is_tilted_setup: True behind a CSYS with a tilted tool.
    :ivar system_of_file: CAM system that wrote the file; None: not stated.
    :ivar is_direction_required: True if the next GOTO must state the direction of the tool.
    :ivar work_offset: number of ZERO; None: not stated.
    :ivar cutter_radius: radius of CUTTER [mm]; NaN: not stated.
    :ivar compensation: active CUTCOM; None without one.
    :ivar move_count: number of moves so far.
    :ivar inch_feed_row: row of the first feed in inches or feet; None without one.
    :ivar end_row: row of FINI or END; −1 without one.
    :ivar has_fault_since_goto: True if a statement since the last GOTO had a fault: the next arc cannot be checked.
    :ivar partno_row: row of PARTNO; −1 without one.
    :ivar has_path_ended: True if END-OF-PATH was the last statement.
    """

    def __init__(self, statements: Statements, cell: Cell) -> None:
        """Begin with a tool whose position is not known."""
        self.statements, self.cell = statements, cell
        self.result = ExecutionResult()
        self.place, self.is_place_known = np.zeros(3), False
        self.axis = np.array([0.0, 0.0, 1.0])
        self.unit = 1.0
        self.is_next_rapid = False
        self.feed, self.is_feed_per_turn = 0.0, False
        self.spindle_speed, self.spindle = 0.0, "spindle_off"
        self.is_coolant_on = False
        self.tool: float | None = None
        self.pending_arc: PendingArc | None = None
        self.last_arc_circle: Circle | None = None
        self.sequence_lines = sequence_lines(statements.comments)
        self.undivided_sequences: set[int] = set()
        self.leaving_direction: Array | None = None
        self.cycle: Cycle | None = None
        self.is_cycle_refused = False
        self.axis_system: list[float | str] | None = None
        self.has_world_system = self.is_tilted_setup = False
        self.system_of_file = system_of(statements.comments)
        self.is_direction_required = False
        self.work_offset: float | None = None
        self.cutter_radius = np.nan
        self.compensation: Compensation | None = None
        self.move_count = 0
        self.inch_feed_row: int | None = None
        self.end_row = -1
        self.has_fault_since_goto = False
        self.partno_row = -1
        self.has_path_ended = False

    @property
    def has_ended(self) -> bool:
        """Whether FINI or END has been executed."""
        return self.end_row >= 0

    def run(self) -> ExecutionResult:
        """Execute all statements in order, and return the result.

        The execution stops behind the end of the program, and after more than `MAX_ERRORS` faults.
        """
        statements, result = self.statements, self.result
        next_row = 0
        for row in statements.other_rows.tolist():
            self._run_plain_gotos(next_row, row)
            next_row = row + 1
            if self.has_ended or len(result.faults) > MAX_ERRORS:
                break
            try:
                self._execute(row, statements.of(row))
            except StatementError as cause:
                result.faults.append(_fault_of(cause, row))
                self.has_fault_since_goto = True
        else:
            self._run_plain_gotos(next_row, len(statements))
        self._end_compensation()
        if self.pending_arc is not None and not result.faults:
            problem = "an arc without a GOTO behind it"
            result.faults.append(Fault(self.pending_arc.row, problem, "Write the end of the arc."))
        self._check_end()
        if self.inch_feed_row is not None and not result.has_units:
            result.faults.append(
                Fault(self.inch_feed_row, "a feed in inches, but no UNITS", "Write UNITS/MM or UNITS/INCHES.")
            )
        return result

    def _check_end(self) -> None:
        """Fill `result.after_end` with the statements behind the end of the program.

        Without an end, add a fault if the program begins with PARTNO; otherwise a warning, unless END-OF-PATH was the
        last statement, or there are faults.
        """
        statements, result = self.statements, self.result
        if self.has_ended:
            other_rows = [
                row for row in statements.other_rows.tolist() if row > self.end_row and statements.of(row) != "FINI"
            ]
            # `goto_rows` ascend
            goto_rows = statements.goto_rows[np.searchsorted(statements.goto_rows, self.end_row) :].tolist()
            result.after_end = (*other_rows, *goto_rows)
        elif self.partno_row >= 0 and not result.faults:
            problem = "the program begins with PARTNO but ends without FINI"
            result.faults.append(Fault(len(statements) - 1, problem, "Check that the file was transferred completely."))
        elif not result.faults and not self.has_path_ended:
            message = "The program ends without FINI, END or END-OF-PATH. Check that the file is complete."
            result.remarks.append(Remark(len(statements) - 1, "warning", "program-end", message))

    def _run_plain_gotos(self, begin: int, end: int) -> None:
        """Execute the plain GOTO statements from row `begin` to row `end` (exclusive); add an error to the faults.

        Statements behind FINI or END are not executed.
        """
        statements = self.statements
        # `goto_rows` ascend: indices of the first one in the range, and behind the last
        first, last = np.searchsorted(statements.goto_rows, [begin, end]).tolist()
        if first < last and not self.has_ended:
            self.has_path_ended = False
            try:
                self._add_gotos(statements.goto_rows[first:last], statements.numbers[first:last])
            except StatementError as cause:
                self.result.faults.append(_fault_of(cause, int(statements.goto_rows[first])))

    def _add_gotos(self, row: Ints, numbers: Array) -> None:
        """Add the moves of GOTO statements.

        The first points may belong to a pending arc; the others are holes of a cycle, or ends of straight moves.

        :param row: (n,) rows of the statements, n > 0.
        :param numbers: (n, 6) x, y, z, i, j, k in the unit of the file; i, j, k are NaN if they are not stated.
        :raises StatementError: a statement cannot be executed.
        """
        self._check_directions(row, np.isnan(numbers[:, 3]))
        if self.system_of_file == "Creo":
            # Creo omits i, j, k of an upright tool
            numbers = np.where(np.isnan(numbers[:, 3:4]) & _IS_DIRECTION, _UPRIGHT, numbers)
        end, axis = numbers[:, :3] * self.unit, self._axes(row, numbers[:, 3:])
        self.is_direction_required = False
        first_remaining = 0  # index of the first statement behind the arc
        circle, self.last_arc_circle = self.last_arc_circle, None
        is_on_last_circle = circle is not None and circle.fault_at(end[0]) is None
        if is_on_last_circle:  # the point may belong to the last arc, or begin the next move
            raise StatementError(*_AMBIGUOUS_POINTS, int(row[0]))
        if self.pending_arc is not None:
            pending, self.pending_arc = self.pending_arc, None
            # an arc that cannot be checked, because of a fault before, is not added: its end is taken as one point
            first_remaining = 1 if self.has_fault_since_goto else self._add_pending_arc(pending, row, end, axis)
        if self.cycle is not None:
            for n in range(first_remaining, len(row)):
                self._add_hole(int(row[n]), end[n], axis[n], self.cycle)
            self.is_next_rapid = False
        elif self.is_cycle_refused:  # the points are holes: as straight moves they would cause further errors
            self.place, self.is_place_known, self.is_next_rapid = end[-1], True, False
        elif first_remaining < len(row):
            self._add_straight_moves(row[first_remaining:], end[first_remaining:], axis[first_remaining:])
        self.axis = axis[-1]
        self.has_fault_since_goto = False

    def _check_directions(self, row: Ints, has_no_direction: Bools) -> None:
        """Check that GOTO statements state the direction of the tool where they must.

        They must in a tilted CSYS, and the first one must behind MULTAX/OFF of a tilted tool.

        :param row: (n,) rows of the statements.
        :param has_no_direction: (n,) True for statements without a direction.
        :raises StatementError: a direction is missing.
        """
        if self.is_tilted_setup and has_no_direction.any():
            advice = "Let the CAM system write the direction of the tool, i, j, k, in each GOTO."
            raise StatementError(
                "GOTO without a direction in a tilted CSYS", advice, int(row[np.argmax(has_no_direction)])
            )
        if self.is_direction_required and has_no_direction[0]:
            advice = "Write the direction of the tool, i, j, k, in this GOTO, or TLAXIS/i,j,k before it."
            raise StatementError("GOTO without a direction behind MULTAX/OFF of a tilted tool", advice, int(row[0]))

    def _add_straight_moves(self, row: Ints, end: Array, axis: Array) -> None:
        """Add straight moves; the first may be rapid, or begin at a position that is not known.

        :param row: (n,) rows of the statements, n > 0.
        :param end: (n, 3) ends of the moves [mm].
        :param axis: (n, 3) directions of the tool at the ends.
        :raises StatementError: a move has no feed.
        """
        first = 0
        if self.is_next_rapid or not self.is_place_known:
            self._add_single_move(int(row[0]), end[0], axis[0])
            first = 1
        if first < len(row):
            self._add_moves(row[first:], end[first:], axis[first:], LINE, self._feed_per_minute(int(row[first])))

    def _axes(self, row: Ints, words: Array) -> Array:
        """Return the unit directions of the tool (n, 3) of GOTO statements.

        A statement without a direction has the direction of the statement before it.

        :param row: (n,) rows of the statements.
        :param words: (n, 3) i, j, k; NaN where they are not stated.
        :raises StatementError: a direction does not have length 1; further such errors are added to the faults.
        """
        length = norm(words)
        is_stated = ~np.isnan(length)
        if not is_stated.any():
            return np.broadcast_to(self.axis, words.shape)
        non_unit_rows = np.flatnonzero(np.abs(length - 1.0) > LENGTH_TOLERANCE)
        if len(non_unit_rows):
            advice = "GOTO takes x, y, z, or x, y, z and the direction of the tool i, j, k."
            problem = "the last three numbers are not a direction of length 1"
            self.result.faults += [Fault(n, problem, advice) for n in row[non_unit_rows[1:MAX_ERRORS]].tolist()]
            raise StatementError(problem, advice, int(row[non_unit_rows[0]]))
        with np.errstate(invalid="ignore"):
            unit = np.concatenate([self.axis[None], words / length[:, None]])
        # row k of `unit` is the direction of statement k − 1; row 0 is the direction before the first statement
        latest_row = np.maximum.accumulate(np.append(0, np.where(is_stated, np.arange(1, len(row) + 1), 0)))
        return np.asarray(unit[latest_row][1:])

    def _add_single_move(self, row: int, end: Array, axis: Array) -> None:
        """Add a move that is rapid, or that begins at a position that is not known.

        The position is not known at the beginning of the program and behind GOHOME.

        - Position known: a rapid move, or a line at feed.
        - First move of the program: a joint motion, or a line at feed from `[start]`.
        - Rapid behind GOHOME: a joint motion to clearance_Z above the end, then down along the tool; or a joint motion
          to the end if that is not below clearance_Z.

        :param end: (3,) end of the move [mm].
        :param axis: (3,) direction of the tool at the end.
        :raises StatementError: the move is at feed behind GOHOME, or has no feed.
        """
        is_rapid, self.is_next_rapid = self.is_next_rapid, False
        if self.is_place_known:
            self._add_move(row, end, axis, RAPID if is_rapid else LINE, 0.0 if is_rapid else self._feed_per_minute(row))
            return
        has_motions = bool(self.result.move_runs)
        if not is_rapid:
            if has_motions:
                raise StatementError("GOTO at feed behind GOHOME", "Write RAPID before: the tool is at home.", row)
            self._add_first_move_at_feed(row, end, axis)
            return
        clearance = self.cell.machine.clearance_Z
        if has_motions and clearance is not None and end[2] < clearance - NEAR_MM and axis[2] > _MIN_AXIS_Z:
            self._add_move(row, end + axis * ((clearance - end[2]) / axis[2]), axis, RAPID, 0.0, is_joint_motion=True)
            self._add_move(row, end, axis, RAPID, 0.0)
        else:
            self._add_move(row, end, axis, RAPID, 0.0, is_joint_motion=True)
        self.is_place_known = True

    def _add_first_move_at_feed(self, row: int, end: Array, axis: Array) -> None:
        """Add a first move of the program that is not rapid, with a warning: it begins at `[start]` of the cell.

        :param end: (3,) end of the move [mm].
        :param axis: (3,) direction of the tool at the end.
        :raises StatementError: no feed is known.
        """
        message = "The first GOTO is at feed: it begins at [start] of the cell. Check that the path from there is free."
        self.result.remarks.append(Remark(row, "warning", "from-start", message))
        self.result.begins_at_start = True
        feed, self.is_place_known = self._feed_per_minute(row), True
        self._add_move(row, end, axis, LINE, feed)

    def _feed_per_minute(self, row: int) -> float:
        """Return the feed of a move [mm/min].

        :raises StatementError: no feed is known, or it is per turn and the speed of the spindle is not known.
        """
        if not self.feed > 0.0:
            raise StatementError("cutting move without a feed", "Write FEDRAT before it.", row)
        if not self.is_feed_per_turn:
            return self.feed
        if not self.spindle_speed > 0.0:
            raise StatementError("a feed per turn, but no speed of the spindle", "Write SPINDL/n,RPM before.", row)
        return self.feed * self.spindle_speed

    def _add_pending_arc(self, pending: PendingArc, row: Ints, end: Array, axis: Array) -> int:
        """Add the arc of a CIRCLE; return the number of the following points that belong to it.

        Creo may divide an arc into several points. Fill `undivided_sequences` (NC sequences in which each arc has one
        point), and `last_arc_circle` if all points belong to the arc.

        :param row: (n,) rows of the statements of the points, n > 0.
        :param end: (n, 3) the points [mm].
        :param axis: (n, 3) directions of the tool at the points.
        :raises StatementError: the number of points is ambiguous, or the arc has a fault.
        """
        count: int | None = 1  # None: ambiguous
        if pending.may_have_points and len(row) > 1:
            count = arc_point_count(pending.circle, self.place, end, _COORDINATE_ROUNDING * self.unit)
            sequence = sequence_at(self.sequence_lines, int(self.statements.line[row[0]]))
            if count is None and sequence in self.undivided_sequences:
                count = 1
            elif count == 1 and pending.circle.sagitta(self.place, end[0]) > _UNDIVIDED_SAGITTA_MM:
                self.undivided_sequences.add(sequence)
        if count is None:
            raise StatementError(*_AMBIGUOUS_POINTS, int(row[1]))
        if pending.may_have_points and count == len(row):
            self.last_arc_circle = pending.circle  # a later GOTO, behind other statements, may belong to the arc too
        for n in range(count):
            self._add_arc(int(row[n]), pending, end[n], axis[n])
        return count

    def _add_arc(self, row: int, pending: PendingArc, end: Array, axis: Array) -> None:
        """Add an arc from the position of the tool; mark the compensation if the arc shows its kind of path.

        :param pending: circle of the arc.
        :param end: (3,) end of the arc [mm].
        :param axis: (3,) direction from the tip to the spindle at the end.
        :raises StatementError: the position is not known, start or end is not on the circle, the move is rapid or has
            no feed.
        """
        if not self.is_place_known:
            raise StatementError(*UNKNOWN_START, row)
        try:
            sweep = pending.sweep(self.place, end)
        except StatementError as cause:
            raise StatementError(cause.problem, cause.advice, row) from None
        if self.is_next_rapid:
            raise StatementError("an arc in rapid", ARC_ADVICE, row)
        circle = pending.circle
        if self.compensation is not None and self.compensation.shows_centre(circle, self.axis, self.cutter_radius):
            self.compensation = replace(self.compensation, is_centre=True)
        arc_circle = Circle(circle.centre_at_height(self.place), circle.axis, circle.radius)
        self._add_move(row, end, axis, ARC, self._feed_per_minute(row), circle=arc_circle, sweep=sweep)

    def _add_hole(self, row: int, top: Array, axis: Array, cycle: Cycle) -> None:
        """Add the moves of the active cycle at a hole; heights count from its top along the tool.

        :param top: (3,) top of the hole [mm].
        :param axis: (3,) direction of the tool.
        :raises StatementError: the position is not known, or the tool turns.
        """
        if not self.is_place_known:
            raise StatementError("a cycle before the position is known", "Write RAPID and a GOTO before it.", row)
        self._check_same_axis(row, axis)
        start_height = float((self.place - top) @ axis)
        if start_height < cycle.clear_height - NEAR_MM:
            self._add_move(row, self.place + axis * (cycle.clear_height - start_height), axis, RAPID, 0.0)
        height = max(start_height, cycle.clear_height)
        for rapid_height in (height, cycle.clear_height, cycle.feed_height):
            self._add_move(row, top + axis * rapid_height, axis, RAPID, 0.0)
        for bottom in cycle.pecks():
            self._add_move(row, top + axis * bottom, axis, LINE, cycle.feed, is_exact_stop=True)
            for retract_height in cycle.retract_heights(bottom):
                self._add_move(row, top + axis * retract_height, axis, RAPID, 0.0, is_exact_stop=True)
        self._add_move(row, top - axis * cycle.depth, axis, LINE, cycle.feed, is_exact_stop=True)
        if cycle.dwell > 0.0:
            self._add_event(row, "dwell", cycle.dwell)
        self._add_move(
            row, top + axis * (height if cycle.return_height is None else cycle.return_height), axis, RAPID, 0.0
        )

    def _check_same_axis(self, row: int, axis: Array) -> None:
        """Check that the tool has the present direction at a hole.

        :param axis: (3,) unit direction at the hole.
        :raises StatementError: it has another direction.
        """
        if norm(np.cross(axis, self.axis)) > LENGTH_TOLERANCE or axis @ self.axis < 0.0:
            raise StatementError("the tool turns in a cycle", "Write a GOTO with the new direction before CYCLE.", row)

    def _add_move(self, row: int, end: Array, axis: Array, code: int, feed: float, **properties: Any) -> None:
        """Add one move; its end becomes the position of the tool, and its axis the direction of the tool.

        :param end: (3,) end of the move [mm].
        :param axis: (3,) direction of the tool at the end.
        :param code: `RAPID`, `LINE` or `ARC`.
        :param feed: feed [mm/min]; 0 for rapid.
        :param properties: further fields of `MoveRun`.
        """
        self._add_moves(np.array([row]), end[None], axis[None], code, feed, **properties)
        self.axis = axis

    def _add_moves(self, row: Ints, end: Array, axis: Array, code: int, feed: float, **properties: Any) -> None:
        """Add moves to the result; the end of the last becomes the position of the tool.

        :param row: (n,) rows of the statements.
        :param end: (n, 3) ends of the moves [mm].
        :param axis: (n, 3) directions of the tool at the ends.
        :param code: `RAPID`, `LINE` or `ARC`.
        :param feed: feed [mm/min]; 0 for rapid.
        :param properties: further fields of `MoveRun`.
        """
        self.result.move_runs.append(MoveRun(row, end, axis, code, feed, self.tool, **properties))
        self.move_count += len(row)
        self.place = end[-1]

    def _add_event(self, row: int, kind: EventKind, value: float = 0.0, text: str = "") -> None:
        """Add an event behind the moves so far; `kind`, `value` and `text` as in `program.Event`."""
        self.result.events.append(MoveEvent(self.move_count, row, kind, value, text))

    def _execute(self, row: int, code: str) -> None:
        """Execute a statement that is not a plain GOTO.

        :param code: the statement in upper case, without white space and comment.
        :raises StatementError: it is not supported or not understood.
        """
        for word in TEXT:  # the text follows the word, with or without a slash
            if code.startswith(word):
                if word == "PARTNO" and self.partno_row < 0:
                    self.partno_row = row
                self._add_event(row, "comment", text=self._text_behind(row, word))
                return
        if code.startswith("INSERT"):
            self._read_insert(row, "INSERT")
            return
        major, slash, minor_words = code.partition("/")
        self.has_path_ended = major == "END-OF-PATH"
        if major != "GOTO":
            self.last_arc_circle = None
        if code.startswith("TOOLPATH/"):
            self._add_event(row, "comment", text=self._text_behind(row, "TOOL"))
            return
        if major == "TLON,GOFWD":
            self._read_tangent_arc(row, minor_words)
            return
        if major == "CSI_INSERT_CUSTOM_GCODE":
            self._read_insert(row, major)
            return
        if major in WITHOUT_EFFECT or major.startswith("CSI_SET_"):
            return
        words = values(minor_words) if slash else []
        if major in ("ORIGIN", "TRANS") and words and all(value == 0.0 for value in words):
            return
        handler = _HANDLERS.get(major)
        if handler is None and major not in REFUSED and major in self.cell.apt.without_effect:
            return
        if handler is None or (major == "GODLTA" and len(words) != 3):
            raise StatementError(*refusal(major))
        handler(self, row, words)

    def _text_behind(self, row: int, word: str) -> str:
        """Return the text behind the major word of a statement, from its first line as it is in the file.

        Comment, slash, quotes and the ``$`` of a continuation at its ends are left out.
        """
        text = self.statements.text(row).partition("$$")[0].strip()
        return text[len(word) :].lstrip(" \t/").strip("' \t$")

    def _one_number(self, words: list[float | str], subject: str) -> float:
        """Return the first number among the values of a statement.

        :param subject: name of the statement, for the message.
        :raises StatementError: there is no number.
        """
        numbers = [value for value in words if isinstance(value, float)]
        if not numbers:
            raise StatementError(f"{subject} without a number", "Check the values behind /.")
        return numbers[0]

    def _read_goto(self, row: int, words: list[float | str]) -> None:
        """Read a GOTO that is not plain.

        Behind a circle, one GOTO may have up to 100 points of three numbers (Creo). Six numbers are then one point
        with a direction if the last three have length 1, otherwise two points.

        :param words: numbers behind ``GOTO/``: x, y, z, and perhaps i, j, k; or several points.
        :raises StatementError: the numbers are not those of points, or the move cannot be executed.
        """
        # up to 100 points of three numbers
        points = numbers_of(words, *((3, 6) if self.pending_arc is None else range(3, 301, 3)))
        if len(points) in (3, 6) and (len(points) == 3 or abs(norm(points[3:]) - 1.0) < LENGTH_TOLERANCE):
            numbers = np.append(points, np.full(6 - len(points), np.nan))[None]
        elif self.pending_arc is not None:
            numbers = np.hstack([points.reshape(-1, 3), np.full((len(points) // 3, 3), np.nan)])
        else:
            numbers = points[None]
        self._add_gotos(np.full(len(numbers), row), numbers)

    def _add_goto(self, row: int, numbers: Array) -> None:
        """Add the move of a statement to one point.

        :param numbers: (3,) x, y, z, or (6,) with i, j, k, in the unit of the file.
        :raises StatementError: the move cannot be executed.
        """
        self._add_gotos(np.array([row]), np.append(numbers, np.full(6 - len(numbers), np.nan))[None])

    def _read_step(self, row: int, words: list[float | str]) -> None:
        """Read GODLTA: a move by a step from the position of the tool.

        :param words: the step behind ``GODLTA/``: x, y, z, in the unit of the file.
        :raises StatementError: the position is not known.
        """
        step = numbers_of(words, 3) * self.unit
        if not self.is_place_known:
            raise StatementError("GODLTA before the position is known", "Write RAPID and a GOTO before it.")
        self._add_goto(row, (self.place + step) / self.unit)

    def _read_start(self, row: int, words: list[float | str]) -> None:
        """Read FROM: a rapid move to a point if the position of the tool is not known; otherwise only a check.

        :param words: the point behind ``FROM/``: x, y, z, and perhaps i, j, k, in the unit of the file.
        :raises StatementError: the tool is known to be at another point.
        """
        numbers = numbers_of(words, 3, 6)
        place = numbers[:3] * self.unit
        if self.is_place_known:
            if norm(place - self.place) > NEAR_MM:
                raise StatementError("FROM at another place than the tool", "Write RAPID and GOTO instead.")
            return
        self.is_next_rapid = True
        self._add_goto(row, numbers)

    def _read_home(self, row: int, words: list[float | str]) -> None:
        """Read GOHOME.

        With a point: a rapid move to it. Without: a retract to clearance_Z and a joint motion to home, as far as the
        cell states them. Behind home the position is not known.

        :param words: the point behind ``GOHOME/``: x, y, z, in the unit of the file; empty: home of the cell.
        :raises StatementError: no point is given, and the cell states neither home nor clearance_Z.
        """
        machine = self.cell.machine
        if words:
            self.is_next_rapid = True
            self._add_goto(row, numbers_of(words, 3))
            return
        if machine.home_joints is None and machine.clearance_Z is None:
            advice = "Give [machine] home or clearance_Z in the cell."
            raise StatementError("GOHOME: where it goes is not known", advice)
        if self.is_place_known and machine.clearance_Z is not None:
            self._add_retract(row, machine.clearance_Z)
        if machine.home_joints is not None:
            self._add_move(row, self.place, self.axis, RAPID, 0.0, is_joint_motion=True, is_to_home=True)
            self.is_place_known = False

    def _read_retract(self, row: int, words: list[float | str]) -> None:
        """Read RETRCT: a retract to clearance_Z of the cell; no move if the position is not known.

        :param words: values behind ``RETRCT/``, which must be empty.
        :raises StatementError: the cell states no clearance_Z, or there are values.
        """
        clearance = self.cell.machine.clearance_Z
        if words or clearance is None:
            advice = "Give [machine] clearance_Z in the cell, and write RETRCT without values."
            raise StatementError("RETRCT: how high it goes is not known", advice)
        if self.is_place_known:
            self._add_retract(row, clearance)

    def _add_retract(self, row: int, clearance: float) -> None:
        """Add a rapid move along the tool up to z = `clearance` [mm], if the tool is below it.

        :raises StatementError: the tool axis is nearly horizontal.
        """
        if self.place[2] >= clearance - NEAR_MM:
            return
        if self.axis[2] < _MIN_AXIS_Z:
            raise StatementError("retract with a nearly horizontal tool", "Retract along the tool by GOTO before.")
        rise = (clearance - self.place[2]) / self.axis[2]
        self._add_move(row, self.place + self.axis * rise, self.axis, RAPID, 0.0)

    def _read_rapid(self, row: int, words: list[float | str]) -> None:
        """Read RAPID: the next move is rapid.

        :param words: values behind ``RAPID/``, which must be empty.
        :raises StatementError: it has values.
        """
        del row
        if words:
            raise StatementError("RAPID with values", "Write RAPID alone.")
        self.is_next_rapid = True

    def _read_feed(self, row: int, words: list[float | str]) -> None:
        """Read FEDRAT: the feed, per minute or per turn.

        ``INVERS,OFF`` has no effect.

        :param words: values behind ``FEDRAT/``: a number, and perhaps its unit.
        :raises StatementError: the feed is not understood, or not above zero.
        """
        units = [value for value in words if isinstance(value, str)]
        if units == ["INVERS", "OFF"]:
            return
        self.feed, self.is_feed_per_turn = self._feed_of(row, words, "FEDRAT")

    def _feed_of(self, row: int, words: list[float | str], subject: str) -> tuple[float, bool]:
        """Return a feed [mm/min or mm/turn], and whether it is per turn; fill `inch_feed_row`.

        Without a unit, it is per minute, in the unit of the file.

        :param words: one number, and perhaps its unit.
        :param subject: name of the value, for messages.
        :raises StatementError: it is not understood, or not above zero.
        """
        units = [value for value in words if isinstance(value, str)]
        numbers = [value for value in words if isinstance(value, float)]
        factors = {**_PER_MINUTE, **_PER_TURN, "PERMIN": self.unit, "PERREV": self.unit}
        if len(numbers) != 1 or len(units) > 1 or not set(units) <= set(factors):
            raise StatementError(f"{subject} is not understood", f"Give one number and one of {', '.join(factors)}.")
        word = units[0] if units else "PERMIN"
        if word in ("IPM", "FPM", "IPR", "FPR"):  # inches or feet
            self.inch_feed_row = row if self.inch_feed_row is None else self.inch_feed_row
        if not numbers[0] > 0.0:
            raise StatementError(f"{subject} is not above zero", None)
        return numbers[0] * factors[word], word in (*_PER_TURN, "PERREV")

    def _read_units(self, row: int, words: list[float | str]) -> None:
        """Read UNITS: the unit of length of the file.

        :param words: values behind ``UNITS/``: the name of a unit.
        :raises StatementError: the unit is unknown, or changes after a motion.
        """
        del row
        unit = _UNITS.get(str(words[0])) if len(words) == 1 else None
        if unit is None:
            raise StatementError("UNITS is not understood", f"Write UNITS/ and one of {', '.join(_UNITS)}.")
        if unit != self.unit and self.result.move_runs:
            raise StatementError("UNITS change behind a motion", "Write UNITS before all motions.")
        self.unit = unit
        self.result.has_units = True

    def _read_multiaxis(self, row: int, words: list[float | str]) -> None:
        """Read MULTAX, which states whether GOTO has a direction of the tool.

        Behind OFF of a tilted tool, the next GOTO must state the direction, except in files of CATIA and Creo.

        :param words: values behind ``MULTAX/``: ON, OFF or none.
        :raises StatementError: the value is not understood.
        """
        del row
        if words not in ([], ["ON"], ["OFF"]):
            raise StatementError("MULTAX is not understood", "Write MULTAX/ON or MULTAX/OFF.")
        if words == ["OFF"] and self.system_of_file is None:
            # such files do not say whether OFF keeps the direction. 1 − z is about half the square of the tilt: smaller
            # ones are rounding
            self.is_direction_required = bool(self.axis[2] < 1.0 - LENGTH_TOLERANCE**2)

    def _read_tool_axis(self, row: int, words: list[float | str]) -> None:
        """Read TLAXIS: the direction of the tool.

        :param words: i, j, k behind ``TLAXIS/``.
        :raises StatementError: the direction does not have length 1.
        """
        axis = numbers_of(words, 3)
        if abs(norm(axis) - 1.0) > LENGTH_TOLERANCE:
            raise StatementError("the direction of the tool does not have length 1", "Check i, j, k.")
        del row
        self._set_axis(axis / norm(axis))

    def _set_axis(self, axis: Array) -> None:
        """Set the direction `axis` (3,) of the following moves; the tool turns to it with the next move."""
        self.axis, self.is_direction_required = axis, False

    def _read_circle(self, row: int, words: list[float | str]) -> None:
        """Read CIRCLE: an arc that ends at the next GOTO.

        6 numbers: SolidWorks CAM, without a radius. 7 numbers: Creo, whose arcs may have several points. 11 numbers:
        Siemens NX, left-handed. See `arcs`.

        :param words: numbers behind ``CIRCLE/``, and perhaps TIMES with the number of turns.
        :raises StatementError: the numbers are not those of a circle, or no arc is possible here.
        """
        turns = 1
        if words[-2:-1] == ["TIMES"]:
            turns, words = turn_count(words[-1]), words[:-2]
        numbers = numbers_of(words, *((6, 7, 11) if turns == 1 else (11,)))
        if len(numbers) == 6:
            if not self.is_place_known:
                raise StatementError(*UNKNOWN_START)
            numbers = np.append(numbers, axis_distance(numbers, self.place / self.unit))
        is_nx = len(numbers) == 11
        self._set_pending_arc(row, numbers, is_right_hand=not is_nx, may_have_points=len(words) == 7, turns=turns - 1)

    def _read_arc(self, row: int, words: list[float | str]) -> None:
        """Read MOVARC: an arc of a stated angle that ends at the next GOTO.

        :param words: values behind ``MOVARC/``, see `stated_angle`.
        :raises StatementError: the numbers are not those of an arc, or no arc is possible here.
        """
        numbers, angle = stated_angle(words)
        self._set_pending_arc(row, numbers, is_right_hand=True, angle=angle)

    def _set_pending_arc(self, row: int, numbers: Array, *, is_right_hand: bool, **properties: Any) -> None:
        """Set `pending_arc`, which ends at the next GOTO.

        :param numbers: (7,) centre, axis, radius, in the unit of the file.
        :param is_right_hand: True if the arc turns right-handed about the axis.
        :param properties: further fields of `PendingArc`.
        :raises StatementError: the axis does not have length 1, another arc or a cycle is active, or the move is rapid.
        """
        circle = circle_of(numbers, self.unit, is_right_hand=is_right_hand)
        if self.pending_arc is not None or self.cycle is not None:
            raise StatementError("an arc where none is possible", "Write a GOTO for the end of the arc before.")
        if self.is_next_rapid:
            raise StatementError("an arc in rapid", ARC_ADVICE)
        self.pending_arc = PendingArc(row, circle, **properties)

    def _read_direction(self, row: int, words: list[float | str]) -> None:
        """Read INDIRV: the direction in which the next arc leaves its start.

        :param words: x, y, z of the direction behind ``INDIRV/``.
        :raises StatementError: these are not three numbers.
        """
        del row
        self.leaving_direction = numbers_of(words, 3)

    def _read_tangent_arc(self, row: int, code: str) -> None:
        """Read TLON,GOFWD/(CIRCLE/x,y,z,r),ON,(LINE/…): an arc that leaves its start along INDIRV.

        :param code: text behind ``TLON,GOFWD/``.
        :raises StatementError: it is not understood, or the arc has a fault.
        """
        direction, self.leaving_direction = self.leaving_direction, None
        circle, end = tangent_arc(code, direction, self.place if self.is_place_known else None, self.unit)
        self._add_arc(row, PendingArc(row, circle), end, self.axis)

    def _read_cycle(self, row: int, values: list[float | str]) -> None:
        """Read CYCLE: the following GOTO are holes; OFF and CLEAR end this, INIT has no effect.

        :param values: values behind ``CYCLE/``: OFF, CLEAR, INIT, or the kind of the cycle with its lengths and feed.
        :raises StatementError: the cycle is not supported, or has no feed.
        """
        if values == ["INIT"]:
            return
        self.is_cycle_refused = False
        if values[:1] in (["OFF"], ["CLEAR"]):
            self.cycle = None
            return
        self.cycle, self.is_cycle_refused = None, True  # until the cycle has been read without an error
        words = cycle_words(values, (*_PER_MINUTE, *_PER_TURN))
        if words.rates:
            rate, is_per_turn = self._feed_of(row, list(words.rates), "the feed of the cycle")
            feed = rate * self.spindle_speed if is_per_turn else rate
        else:
            feed = self._feed_per_minute(row)
        if not feed > 0.0:
            raise StatementError("a feed per turn, but no speed of the spindle", "Write SPINDL/n,RPM before.")
        self.cycle, self.is_cycle_refused = words.cycle(self.unit, feed), False

    def _read_spindle(self, row: int, words: list[float | str]) -> None:
        """Read SPINDL: speed [1/min], direction, or OFF.

        Without a speed, the last speed applies. Without a direction, the last direction does, or CLW behind OFF.

        :param words: values behind ``SPINDL/``.
        :raises StatementError: a word is not supported, or the speed is missing.
        """
        unknown_words = {value for value in words if isinstance(value, str)} - _SPINDLE_WORDS
        if unknown_words:
            raise StatementError(
                f"SPINDL with {min(unknown_words)} is not supported", "Give the speed as SPINDL/n,RPM,CLW."
            )
        if "OFF" in words:
            self.spindle = "spindle_off"
            self._add_event(row, "spindle_off")
            return
        numbers = [value for value in words if isinstance(value, float)]
        if len(numbers) > 1 or (not numbers and not self.spindle_speed):
            raise StatementError("SPINDL without one speed", "Give the speed as SPINDL/n,RPM,CLW.")
        self.spindle_speed = numbers[0] if numbers else self.spindle_speed
        if "CCLW" in words:
            self.spindle = "spindle_ccw"
        elif "CLW" in words or self.spindle == "spindle_off":
            self.spindle = "spindle_on"
        self._add_event(row, "spindle_ccw" if self.spindle == "spindle_ccw" else "spindle_on", self.spindle_speed)

    def _read_coolant(self, row: int, words: list[float | str]) -> None:
        """Read COOLNT: on, unless its value is OFF.

        :param words: values behind ``COOLNT/``, such as ON, FLOOD, OFF.
        """
        self.is_coolant_on = "OFF" not in words
        self._add_event(row, "coolant_on" if self.is_coolant_on else "coolant_off")

    def _read_tool(self, row: int, words: list[float | str]) -> None:
        """Read LOADTL: a tool change, which stops the spindle; the new tip moves to the present position.

        :param words: values behind ``LOADTL/``: the number of the tool first; or behind ``LOAD/``: TOOL and the number.
        :raises StatementError: the number is invalid, the cell has no such tool, or a cycle is active.
        """
        if words[:1] == ["TOOL"]:
            words = words[1:]
        if self.cycle is not None:
            raise StatementError("the tool changes within a cycle", "Write CYCLE/OFF behind the last hole.")
        number = self._one_number(words[:1], "the tool")
        if number < 0.0 or number != int(number):
            raise StatementError("the number of the tool is not a whole number", None)
        if self.spindle != "spindle_off":
            self.spindle = "spindle_off"
            self._add_event(row, "spindle_off")
        self._add_event(row, "tool_change", number)
        tools = self.cell.tools
        if tools and f"{number:g}" not in tools:
            raise StatementError(f"tool {number:g} is not in the cell", f"Write [tools.{number:g}] in the cell.")
        if number not in self.result.tools:
            self.result.tools.append(number)
        tool_differs = tools and number != self.tool
        self.tool = number
        if tool_differs and self.is_place_known:
            self._add_move(row, self.place, self.axis, RAPID, 0.0)

    def _read_delay(self, row: int, words: list[float | str]) -> None:
        """Read DELAY or DWELL: a dwell.

        :param words: values behind ``DELAY/`` or ``DWELL/``: the time [s].
        :raises StatementError: the time is missing, or in turns.
        """
        words = [value for value in words if value != "DWELL"]
        if "REV" in words:
            raise StatementError("DELAY in turns", "Give it in seconds.")
        self._add_event(row, "dwell", float(numbers_of(words, 1)[0]))

    def _read_stop(self, row: int, words: list[float | str]) -> None:
        """Read STOP or OPSTOP, with any `words`: the program waits until it is started again."""
        del words
        self._add_event(row, "stop")

    def _read_skip(self, row: int, words: list[float | str]) -> None:
        """Read OPSKIP, which has no effect; unless it is OFF, add a remark that the following statements are executed.

        :param words: values behind ``OPSKIP/``: ON or OFF.
        """
        if words != ["OFF"]:
            message = "OPSKIP: the statements behind it are executed, as with the switch off."
            self.result.remarks.append(Remark(row, "info", "block-delete", message))

    def _read_auxiliary(self, row: int, words: list[float | str]) -> None:
        """Read AUXFUN: an M code by its number.

        :param words: values behind ``AUXFUN/``: the number of the M code.
        :raises StatementError: the number is missing, or the code is not known.
        """
        self._execute_machine_code(row, f"M{self._one_number(words, 'AUXFUN'):g}")

    def _read_insert(self, row: int, word: str) -> None:
        """Read INSERT: a comment, a stop (text that begins with STOP) or an M code.

        :param word: INSERT, or the word of SolidWorks CAM with the same meaning.
        :raises StatementError: the text is in several lines, or may be code of a control.
        """
        text = self._text_behind(row, word).upper()
        if "".join(text.split()) != self.statements.of(row)[len(word) :].lstrip("/").strip("'"):
            raise StatementError("INSERT in more than one line", "Write the text in one line.")
        comment = inserted_comment(text)
        if comment is not None:
            self._add_event(row, "comment", text=comment)
            if text.startswith("STOP"):
                self._add_event(row, "stop")
            return
        self._execute_machine_code(row, text)

    def _execute_machine_code(self, row: int, code: str) -> None:
        """Execute an M code as the APT statement with the same meaning, or add an event with the lines of the cell.

        An M code with an empty list of lines in the cell has no effect.

        :param code: text in upper case, such as ``M08``.
        :raises StatementError: the text is no M code, or is unknown to APT and to the cell.
        """
        code = _LEADING_ZEROS.sub("M", code)
        if code in _EQUIVALENTS:
            handler, words = _EQUIVALENTS[code]
            handler(self, row, words)
            return
        cell_lines = self.cell.m_codes.get(code)
        if cell_lines is None:
            if not _M_CODE.fullmatch(code):
                raise StatementError(*inserted_fault(code))
            advice = f"Say what it does: [m_codes] {code} = [] for nothing, or lines of KRL."
            if m_code_fault(code):
                advice = "Remove it: LOADTL changes the tool, FINI ends the program."
            raise StatementError(f"{code!r} is for one control", advice)
        if cell_lines:
            self._add_event(row, "m_code", float(code[1:]))

    def _read_compensation(self, row: int, words: list[float | str]) -> None:
        """Read CUTCOM: end radius compensation and, unless OFF, begin a new one.

        :param words: values behind ``CUTCOM/``: LEFT, RIGHT or OFF among others.
        :raises StatementError: neither LEFT nor RIGHT is stated, so that arcs cannot show that the path is that of the
            tool's centre, and the cell does not state it either.
        """
        self._end_compensation()
        if words[:1] == ["OFF"]:
            return
        # if the offsets of the control contain the wear of the tool only, the path is that of its centre
        is_centre = self.cell.gcode.radius_offsets == "wear"
        side = next((word for word in ("LEFT", "RIGHT") if word in words), None)
        if side is None and not is_centre:
            raise StatementError(*_COMPENSATION_FAULT)
        self.compensation = Compensation(row, 1.0 if side == "LEFT" else -1.0, is_centre=is_centre)

    def _end_compensation(self) -> None:
        """End the active compensation: add a remark if its path is that of the tool's centre, else a fault."""
        compensation, self.compensation = self.compensation, None
        if compensation is None:
            return
        if not compensation.is_centre:
            self.result.faults.append(Fault(compensation.row, *_COMPENSATION_FAULT))
            return
        message = "CUTCOM has no effect: the path is that of the tool's centre, and the offsets hold wear only."
        self.result.remarks.append(Remark(compensation.row, "info", "radius-compensation", message))

    def _read_cutter(self, row: int, words: list[float | str]) -> None:
        """Read CUTTER: the diameter of the cutter; without a number the radius is NaN.

        :param words: numbers behind ``CUTTER/``, in the unit of the file: the diameter first.
        """
        del row
        self.cutter_radius = words[0] * self.unit / 2.0 if words and isinstance(words[0], float) else np.nan

    def _check_transformation(self, row: int, words: list[float | str]) -> None:
        """Check that TRNTYP is WORLD.

        :param words: values behind ``TRNTYP/``.
        :raises StatementError: it is another value.
        """
        del row
        if words[:1] != ["WORLD"]:
            raise StatementError("TRNTYP other than WORLD", "Let the CAM system write all coordinates in one system.")
        self.has_world_system = True

    def _read_setup_axes(self, row: int, words: list[float | str]) -> None:
        """Read CSYS: the axes of a setup, a matrix (3, 4) whose third column is the direction of the tool.

        :param words: twelve numbers behind ``CSYS/``, row by row.
        :raises StatementError: the axes are not unit vectors at right angles, or TRNTYP is missing, so that the system
            of the coordinates is not known.
        """
        del row
        rows = numbers_of(words, 12).reshape(3, 4)
        # the matrix of the axes is orthogonal
        if np.abs(rows[:, :3] @ rows[:, :3].T - np.eye(3)).max() > LENGTH_TOLERANCE:
            raise StatementError("CSYS has no axes of length 1 at right angles", "Check its twelve numbers.")
        if not self.has_world_system and not np.array_equal(rows, np.eye(3, 4)):
            advice = "Let the CAM system write all coordinates in one system (TRNTYP/WORLD)."
            raise StatementError("CSYS without TRNTYP: the system of the coordinates is not known", advice)
        axis = rows[:, 2] / norm(rows[:, 2])
        self.is_tilted_setup = bool(axis[2] < 1.0 - LENGTH_TOLERANCE**2)
        self._set_axis(axis)

    def _read_mode(self, row: int, words: list[float | str]) -> None:
        """Read MODE; only MILL is supported.

        :param words: values behind ``MODE/``.
        :raises StatementError: it is another mode.
        """
        del row
        if words != ["MILL"]:
            raise StatementError("MODE is not understood", "Only milling programs (MODE/MILL) are supported.")

    def _read_coordinate_system(self, row: int, words: list[float | str]) -> None:
        """Read MSYS: the coordinate system, which must be $BASE of the cell; add a remark about it.

        :param words: values behind ``MSYS/``, which are only compared.
        :raises StatementError: the system changes within the program.
        """
        if self.axis_system is not None and words != self.axis_system:
            advice = "Write one file for each MSYS, and give its place as [base] of a cell."
            raise StatementError("MSYS changes within the program", advice)
        if self.axis_system is None:
            message = "MSYS: coordinates are those of this system, which is $BASE of the cell."
            self.result.remarks.append(Remark(row, "info", "coordinate-system", message))
        self.axis_system = words

    def _read_section_axes(self, row: int, words: list[float | str]) -> None:
        """Read MCS of Autodesk: axes and origin of the coordinates of a section, which must be those of the program.

        :param words: twelve numbers behind ``MCS/``: three axes, then the origin.
        :raises StatementError: axes or origin differ from those of the program.
        """
        del row
        if not np.array_equal(numbers_of(words, 12), np.append(np.eye(3), np.zeros(3))):
            raise StatementError("MCS: the coordinates of this section are in axes of its own", COORDINATES_ADVICE)

    def _read_work_offset(self, row: int, words: list[float | str]) -> None:
        """Read ZERO: the work offset, which must be $BASE of the cell; add a remark about it.

        :param words: values behind ``ZERO/``: the number of the offset.
        :raises StatementError: the offset changes within the program.
        """
        offset = self._one_number(words, "ZERO")
        if self.work_offset not in (None, offset):
            advice = "Write one file for each work offset, and give its place as [base] of a cell."
            raise StatementError("ZERO: the work offset changes within the program", advice)
        if self.work_offset is None:
            message = f"ZERO: coordinates are those of work offset {offset:g}, which is $BASE of the cell."
            self.result.remarks.append(Remark(row, "info", "coordinate-system", message))
        self.work_offset = offset

    def _read_end(self, row: int, words: list[float | str]) -> None:
        """Read FINI or END, with any `words`: the end of the program; switch spindle and coolant off if they are on."""
        del words
        self.end_row = row
        if self.spindle != "spindle_off":
            self._add_event(row, "spindle_off")
        if self.is_coolant_on:
            self._add_event(row, "coolant_off")

    def _read_without_effect(self, row: int, words: list[float | str]) -> None:
        """Read a statement that has no effect on the motion, with any `words`: it does nothing."""
        del row, words


def _fault_of(error: StatementError, row: int) -> Fault:
    """Return an error as a fault; `row` is the row of the executed statement, for errors that name no row."""
    return Fault(row if error.row is None else error.row, error.problem, error.advice)


_SPINDLE_WORDS = {"RPM", "CLW", "CCLW", "ON", "OFF"}
_LEADING_ZEROS = re.compile(r"^M0+(?=\d)")
_M_CODE = re.compile(r"M\d{1,9}")
_EQUIVALENTS: Mapping[str, tuple[Any, list[float | str]]] = {
    **dict.fromkeys(("M0", "M1"), (_Executor._read_stop, [])),
    "M3": (_Executor._read_spindle, ["CLW"]),
    "M4": (_Executor._read_spindle, ["CCLW"]),
    "M5": (_Executor._read_spindle, ["OFF"]),
    **dict.fromkeys(("M7", "M8"), (_Executor._read_coolant, ["ON"])),
    "M9": (_Executor._read_coolant, ["OFF"]),
}
"""M code → method and values of the statement with the same effect; `[m_codes]` of the cell does not accept them."""
_HANDLERS: Mapping[str, Any] = {
    "GOTO": _Executor._read_goto,
    "GODLTA": _Executor._read_step,
    "FROM": _Executor._read_start,
    "GOHOME": _Executor._read_home,
    "RETRCT": _Executor._read_retract,
    "RAPID": _Executor._read_rapid,
    "FEDRAT": _Executor._read_feed,
    "UNITS": _Executor._read_units,
    "UNIT": _Executor._read_units,
    "CUTTER": _Executor._read_cutter,
    "CSYS": _Executor._read_setup_axes,
    "TRNTYP": _Executor._check_transformation,
    "SETUP": _Executor._read_without_effect,
    "MULTAX": _Executor._read_multiaxis,
    "TLAXIS": _Executor._read_tool_axis,
    "CIRCLE": _Executor._read_circle,
    "MOVARC": _Executor._read_arc,
    "INDIRV": _Executor._read_direction,
    "CYCLE": _Executor._read_cycle,
    "SPINDL": _Executor._read_spindle,
    "COOLNT": _Executor._read_coolant,
    "LOADTL": _Executor._read_tool,
    "LOAD": _Executor._read_tool,
    "DELAY": _Executor._read_delay,
    "DWELL": _Executor._read_delay,
    "STOP": _Executor._read_stop,
    "OPSTOP": _Executor._read_stop,
    "OPSKIP": _Executor._read_skip,
    "AUXFUN": _Executor._read_auxiliary,
    "CUTCOM": _Executor._read_compensation,
    "MODE": _Executor._read_mode,
    "MSYS": _Executor._read_coordinate_system,
    "MCS": _Executor._read_section_axes,
    "ZERO": _Executor._read_work_offset,
    "END": _Executor._read_end,
    "FINI": _Executor._read_end,
    "REWIND": _Executor._read_without_effect,
}


def execute(statements: Statements, cell: Cell) -> ExecutionResult:
    """Return the moves, events and faults of a file; with faults the moves are incomplete."""
    return _Executor(statements, cell).run()
