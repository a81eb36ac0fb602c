"""The motions of a program in execution order, and the settings in force at each."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.dialects.krl.execution import (
    Body,
    Branch,
    Execution,
    Fork,
    ForkVisit,
    Join,
    Lines,
    PlainRounds,
    RoutineEntry,
    UnresolvedStructure,
)
from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.names import MOTION_WORDS, RESERVED, fault_of
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.routines import Routine
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.structures import Block, Node, checked_nodes, is_outside_structures, nodes_of
from postproc.dialects.krl.language.tokens import NAME
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.language.tree import CallStatement, For, Goto, Motion, Return, Statement
from postproc.dialects.krl.read.collected import CollectedMotions
from postproc.dialects.krl.read.computed_rounds import computed_motions
from postproc.dialects.krl.read.flow import Flow
from postproc.dialects.krl.read.folder import Library
from postproc.dialects.krl.read.interpreter import JUMP_ADVICE
from postproc.dialects.krl.read.motion_reader import MotionReader
from postproc.dialects.krl.read.plain_lines import PlainLines, is_not_plain
from postproc.dialects.krl.read.plain_rounds import ElementMotions, motions_and_settings_of
from postproc.dialects.krl.read.plain_settings import PlainAssignments, PlainSettings
from postproc.dialects.krl.read.run import Run
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.state import FIELD_OF_SETTING
from postproc.dialects.krl.read.tracing import Recorder
from postproc.dialects.krl.read.variables import Variables
from postproc.errors import MAX_ERRORS, ProgramError, combined_error
from postproc.program import Bools, Ints

_MOST_FREE_SETTINGS = 1000
"""Most plain settings outside of control structures that are run one by one."""
_INSTRUCTION_WORDS = MOTION_WORDS | RESERVED | {"BAS"}
"""Words that begin a statement and are no variables, which a fault would leave without a value."""


class Start(Struct, frozen=True, eq=False):
    """What the run of a program begins with.

    :param library: finds called routines.
    :param main: the main routine.
    :param obstacles: see `Run.obstacles`.
    :param variables: the variables before the first statement.
    :param joints: joint angles at the start [deg].
    """

    library: Library
    main: Routine
    obstacles: Mapping[Routine | ForkVisit, ProgramError]
    variables: Variables
    cell: Cell
    joints: tuple[float, ...]

    def new_collection(self, trace: Trace | None = None, *, has_rows: bool = True) -> CollectedMotions:
        """Return an empty collection of motions for a run of the program, which gets its own copy of the variables.

        :param trace: the execution trace; None: the lines of the main file, one after the other.
        :param has_rows: see `Run.has_rows`.
        """
        settings = Settings(self.variables.copy_for_run(), self.cell)
        run = Run(self.library, self.main, settings, trace or Trace.of(self.main.source), has_rows=has_rows)
        run.obstacles = self.obstacles
        return CollectedMotions(run, MotionReader(settings, self.joints))


def execution_of(start: Start) -> tuple[Execution, CollectedMotions | None]:
    """Return the execution trace of a program, and the motions that its statements have made.

    :returns: the trace and the motions. None for the motions if the statements must run once more, along the complete
        trace: if the lines run one after the other, branches not known before run time meet, a structure is left
        uncorrected, rounds are taken at once, or a statement has an error.
    :raises ProgramError: the order of execution is not known before the program runs, or a control structure is not
        closed.
    """
    if not start.cell.krl.keep_unresolved:
        with suppress(ProgramError):  # raised again below: this message may depend on the trace, which is not complete
            return _execution(start, collects=True)
    return _execution(start, collects=False)


def _execution(start: Start, *, collects: bool) -> tuple[Execution, CollectedMotions | None]:
    """Return the execution trace of a program, and its motions or None, as `execution_of` does.

    :param collects: False to record the trace alone; the motions are None then.
    :raises ProgramError: see `execution_of`.
    """
    main, recorder = start.main, Recorder(start.main)
    collected_motions = start.new_collection(has_rows=collects)
    run, settings = collected_motions.run, collected_motions.run.settings
    # free settings are outside of all control structures
    lines, free_settings = _split_plain_settings(main.source, main.other_lines, main.setting_lines)
    nodes = checked_nodes(main.source, nodes_of(main.source, lines))
    # many plain settings are not run one by one here, so that speeds and distances have no values
    settings.follows_numbers = len(free_settings) <= _MOST_FREE_SETTINGS
    run.is_final = collects and settings.follows_numbers
    flow = _collecting_flow(collected_motions, recorder)
    if _is_straight(main, flow, nodes):
        return _with_used_names(_straight_execution(main, run.trace), start), None
    if settings.follows_numbers and len(free_settings):  # with plain settings among the statements
        nodes = nodes_of(main.source, main.statement_lines)
    _note_submit_programs(run)
    flow.follow(main.source, nodes)
    if run.level.jump_line:
        raise _jump_error(main, flow, run.level.jump_line)
    if not run.level.return_line:  # the lines up to END run
        recorder.record_run_lines(main.last - 1)
    recorder.record_passed_lines(main.last - 1, is_executed=False)
    execution = _with_used_names(recorder.execution(run.unfollowed_routines), start)
    has_all_motions = run.is_final and recorder.is_final and not settings.lacked_numbers
    has_open_part = collected_motions.splines.open_block is not None or bool(run.level.open_structures)
    # errors are reported when the statements run once more
    has_faulty_name = any(fault_of(routine.name) for routine in (main, *execution.inlined_routines))
    if not has_all_motions or has_open_part or has_faulty_name:
        return execution, None
    run.trace, run.recorded_line = execution.trace, 0  # 0: the trace has the line to report
    return execution, collected_motions


def _collecting_flow(collected_motions: CollectedMotions, recorder: Recorder) -> Flow:
    """Return a `Flow` that follows a program, records its trace, and collects its motions.

    Motions are collected only as long as `Run.is_final` and `Recorder.is_final` are True.

    :param collected_motions: gets the motions.
    """
    run = collected_motions.run

    def take_motion(place: Place, stmt: Statement) -> None:
        """Follow the functions in a motion, and collect the motion as long as run and trace are final."""
        flow.interpreter.follow_functions(place, stmt.values)  # they may change what a condition depends on
        if run.is_final and recorder.is_final:
            collected_motions.take_motion(place, stmt)

    def note_fault(_place: Place, _cause: ProgramError) -> None:
        """Note that a statement has an error, which is reported when the recorded trace is followed."""
        run.is_final = False

    flow = Flow(run, take_motion, note_fault, recorder)
    return flow


def _is_straight(main: Routine, flow: Flow, nodes: Sequence[Node]) -> bool:
    """Return whether the lines of the main routine with motions or force comments run one after the other, once each.

    :param nodes: the statements and control structures of the routine other than plain lines.
    """
    if _returns_early(main):
        return False
    control_nodes = (node for node in nodes if isinstance(node, Block) or _may_leave_line(main, node))
    return not any(flow.belongs_in_trace(main.source, node) for node in control_nodes)


def _straight_execution(main: Routine, trace: Trace) -> Execution:
    """Return the execution trace of a program whose lines run one after the other."""
    return Execution(main, trace, (Lines(main.first + 1, main.last - 1),), Body(main.first + 1, main.last))


def _with_used_names(execution: Execution, start: Start) -> Execution:
    """Return an execution trace with the names that new routines and programs must not have, if there may be new ones.

    With inlined routines of other files, which may be copied: names of programs and GLOBAL routines, and the programs
    that call these routines. With a program that may be divided into parts: names of programs. Else the trace is
    returned unchanged.
    """
    library = start.library
    foreign_routines = {routine for routine in execution.inlined_routines if routine.source is not start.main.source}
    if foreign_routines:
        return replace(
            execution,
            used_names=library.program_and_routine_names(),
            other_callers=library.programs_calling(foreign_routines),
        )
    # a long program may be divided into parts
    return replace(execution, used_names=library.program_names()) if start.cell.output.lines_per_file else execution


def _jump_error(main: Routine, flow: Flow, line: int) -> ProgramError:
    """Return the error that the label of a GOTO cannot be reached.

    :param line: line of the GOTO in the file of the main routine.
    """
    label = flow.label_of(main.source, line)
    problem = f"there is no label {label} in {main.name}"
    if label in flow.labels(main.source, main.other_lines):
        problem = f"the label {label} precedes GOTO, or is in a control structure that GOTO is not in"
    return main.source.line_error(problem, line, JUMP_ADVICE)


def _check_names(routines: Iterable[Routine]) -> None:
    """Check that the controller accepts the names of the routines of a program.

    :raises ProgramError: it refuses some of them.
    """
    advice = "Rename it, and its file if that has the same name, also where it is called."
    errors = [
        routine.source.line_error(f"{routine.name} is not a valid name: {fault}", routine.first, advice)
        for routine in sorted(routines, key=lambda routine: (routine.source.document.name, routine.first))
        if (fault := fault_of(routine.name))
    ]
    if errors:
        raise combined_error(errors)


def _may_leave_line(main: Routine, line: int) -> bool:
    """Return whether a statement, by its text, may run other lines before the next one: a GOTO, or a call.

    :param line: line of the statement.
    """
    stmt = statement(main.source, line)
    return isinstance(stmt, Goto) or ("(" in main.source.text[stmt.start : stmt.stop] and not isinstance(stmt, Motion))


def _returns_early(main: Routine) -> bool:
    """Return whether RETURN may end the main routine before its last statement."""
    # both lists ascend
    last = max([*main.other_lines[-1:], *main.motion_lines[-1:].tolist()], default=0)
    return any(line < last and isinstance(statement(main.source, line), Return) for line in main.other_lines)


def _note_submit_programs(run: Run) -> None:
    """Note that the variables which submit programs write may change at any time."""
    for module in run.library.submit_programs():
        for routine in module.routines.values():
            effects = run.analysis.effects_of(module, routine)
            run.note_possible_changes(effects.writes | effects.volatile_writes, f"the submit program {module.name}")


class TraceFollower:
    """Follows the execution trace of a program through the lines that are not plain motions.

    The execution trace: the lines of the program in the order in which they are executed, as rows from 1. Plain motions
    and plain settings are lines of the common form, which are read in bulk.

    :param collected_motions: the motions of the program if its statements have run; else an empty collection.
    :param execution: the execution trace.
    :param plain: the plain lines, or plain rows of the trace.
    :ivar run: the program as far as it has run.
    :ivar motions: motions that are read as statements, in order.
    :ivar rounds: motions of loops over the points of an array, read in bulk.
    :ivar idle_rows: rows of the trace with motions to where the robot is already.
    :ivar splines: the spline blocks.
    """

    def __init__(self, collected_motions: CollectedMotions, execution: Execution, plain: PlainLines) -> None:
        """Begin before the first statement."""
        self.execution = execution
        self.run, self.reader = collected_motions.run, collected_motions.reader
        self._collected = collected_motions
        self.motions, self.idle_rows, self.splines = (
            collected_motions.motions,
            collected_motions.idle_rows,
            collected_motions.splines,
        )
        self._flow = Flow(self.run, self._take_motion, self._note_fault)
        self._errors: list[ProgramError] = []
        self._faulty_names: set[str] = set()  # variables whose statements had errors
        self.rounds: list[ElementMotions] = []
        self._plain_motion_rows, self._plain_settings = plain.motion_lines, plain.settings

    @cached_property
    def _plain_setting_rows(self) -> list[int]:
        """Rows of the trace with plain settings, in order."""
        lines: list[int] = self._plain_settings.line.tolist()
        return lines

    @cached_property
    def _is_other_row(self) -> Bools:
        """(L,) True for the rows of the trace that are not plain."""
        return is_not_plain(len(self.run.trace), self._plain_motion_rows, self._plain_settings)

    @cached_property
    def _trigger_rows(self) -> frozenset[int]:
        """Rows of the trace with TRIGGER statements; to be read when all statements have run."""
        return frozenset(self.run.triggers)

    @cached_property
    def _plain_rounds(self) -> list[PlainRounds]:
        """The rounds of FOR loops whose bodies are plain, in order."""
        return self.execution.plain_rounds()

    @cached_property
    def _other_rows(self) -> Sequence[int]:
        """The rows of the trace that have code and are neither plain nor in plain rounds."""
        return self.run.routine.other_lines if self.execution.is_straight else self._rows_outside_rounds()

    def follow(self, faults: Sequence[ProgramError]) -> None:
        """Run the statements of the execution trace in order: collect motions, settings and errors.

        :param faults: errors in the bounds of routines, which are reported too.
        :raises ProgramError: the statements have errors; all of them together, as far as `MAX_ERRORS`.
        """
        run = self.run
        _check_names([run.routine, *self.execution.inlined_routines])
        _note_submit_programs(run)
        self._errors += faults
        lines = self._split_settings()
        for step in self.execution.steps:
            if isinstance(step, Lines):
                self._run_step(step, lines[step])
            elif isinstance(step, UnresolvedStructure):
                self._pass_structure(step)
            elif isinstance(step, Fork | Branch | Join):
                self._follow_division(step)
            elif isinstance(step, RoutineEntry):
                self._enter_routine(step)
            else:  # RoutineExit
                self._flow.interpreter.calls.leave_routine()
            if len(self._errors) > MAX_ERRORS:
                break
        errors = self._errors or self._unclosed_errors()
        if errors:
            # rounds of a loop repeat errors: the first of equal errors is the last to get into the dictionary
            raise combined_error(
                {(error.file, error.line, error.problem): error for error in reversed(errors)}.values()
            )

    def _unclosed_errors(self) -> list[ProgramError]:
        """Return the error that a spline block or a control structure is not closed; empty if all are closed."""
        if self.splines.open_block is not None:
            problem, advice = "the spline block is not closed", "Write ENDSPLINE behind its last motion."
            return [self.splines.open_block.place.error(problem, advice)]
        if self.run.level.open_structures:
            word, line = self.run.level.open_structures[-1]
            source = self.run.routine.source
            return [source.line_error(f"{word} is not closed", line, "Check that the file is complete.")]
        return []

    def _rows_of_step(self, step: Lines | UnresolvedStructure) -> tuple[Sequence[int], Sequence[int]]:
        """Return the rows of a step that are not plain, and the rows of its plain settings, both ascending."""
        rows, setting_rows = self._other_rows, self._plain_setting_rows  # both ascend
        settings_in_step = setting_rows[bisect_left(setting_rows, step.first) : bisect_right(setting_rows, step.last)]
        return rows[bisect_left(rows, step.first) : bisect_right(rows, step.last)], settings_in_step

    def _split_settings(self) -> dict[Lines, Sequence[int]]:
        """Return step → rows of the step that are run one by one, for steps that are `Lines`.

        A plain setting is an assignment of a number to a speed or a distance, read in bulk. Those outside of control
        structures are not run: they become `Settings.plain_assignments`, which come into force at their rows.
        """
        step_rows: dict[Lines, Sequence[int]] = {}
        is_free_row = np.zeros(len(self.run.trace) + 1, dtype=np.bool_)  # outside of control structures; rows from 1
        for step in self.execution.steps:
            if isinstance(step, Lines):
                step_rows[step], free_rows = _split_plain_settings(self.run.trace, *self._rows_of_step(step))
                is_free_row[free_rows] = True
        settings = self._plain_settings
        is_free = is_free_row[settings.line]
        self.run.settings.plain_assignments = PlainAssignments(
            PlainSettings(settings.line[is_free], settings.values[:, is_free])
        )
        return step_rows

    def _run_step(self, step: Lines, lines: Sequence[int]) -> None:
        """Run the rows of a step that are not plain, and its plain rounds, in order, up to RETURN.

        :param lines: the rows of the step that are run one by one.
        """
        run = self.run
        nodes: list[Node | PlainRounds] = [*nodes_of(run.trace, lines)]
        # plain rounds that begin in the step; they ascend by their first rows
        begin, end = (bisect_left(self._plain_rounds, row, key=_first_row) for row in (step.first, step.last))
        if begin < end:
            nodes = sorted([*nodes, *self._plain_rounds[begin:end]], key=_first_row)
        for node in nodes:
            run.settings.apply_assignments_before(_first_row(node))
            if isinstance(node, PlainRounds):
                self._follow_rounds(node)
                continue
            self._follow_node(node)
            if run.level.return_line:
                return
        run.settings.apply_assignments_before(step.last + 1)

    def _follow_rounds(self, rounds: PlainRounds) -> None:
        """Take all plain rounds of a FOR at once if that is possible, else run their rows one by one."""
        take_rounds = self._take_computed_rounds if rounds.body.is_computed else self._take_element_rounds
        if not take_rounds(rounds):
            self._follow_rows(np.arange(rounds.first, rounds.stop_row), rounds)

    def _take_computed_rounds(self, rounds: PlainRounds) -> bool:
        """Take all rounds of a FOR that computes its targets at once; return False if that is not possible."""
        moves = computed_motions(self.run, self.reader, rounds)
        if moves is None:
            return False
        for move in moves:
            self.motions.add(move, self.run.settings.state)
        assignment_rows = map(rounds.rows_of_statement, (rounds.head, *rounds.body.assignments))
        # the first round shows errors, the last leaves its values: assignments of all others have no effect
        end_rows = [rows[index] for rows in assignment_rows for index in (0, -1)]
        self._follow_rows(np.sort(np.array(end_rows)), rounds)
        return True

    def _take_element_rounds(self, rounds: PlainRounds) -> bool:
        """Take all rounds of a FOR over the points of an array at once; return False if that is not possible."""
        run = self.run
        motions_and_settings = motions_and_settings_of(run, self.reader, rounds)
        if motions_and_settings is None:
            return False
        element_motions, settings = motions_and_settings
        self.rounds += element_motions
        run.settings.plain_assignments.insert(settings)
        trigger_rows = [rounds.rows_of_statement(line) for line in rounds.body.triggers]
        trigger_count = len(run.triggers)
        last_round = rounds.stop_row - rounds.length  # row that sets the counter for the last round
        self._follow_rows(np.array([rounds.first, last_round, *(rows[-1] for rows in trigger_rows)]), rounds)
        if trigger_rows:  # triggers of the last round alone have been run: note those of all rounds
            run.triggers[trigger_count:] = np.sort(np.concatenate(trigger_rows)).tolist()
        return True

    def _follow_node(self, node: Node, number: int | None = None) -> None:
        """Run a row of the trace, or a control structure given by its rows.

        :param number: value to which the row sets the counter of plain rounds; None for other rows.
        """
        row = _first_row(node)
        place = self.run.go_to_row(row)
        if number is None:
            number = self.execution.counter_of_row.get(row)
        if number is None:  # the row does not set a counter
            # `Flow` takes lines of the file in place of rows
            file_node = node.shifted(-self.run.shift) if isinstance(node, Block) else place.line
            self._flow.follow(place.source, (file_node,))
            self.run.level.is_left = False  # the next row of the trace is the one that runs after EXIT
            return
        stmt = statement(place.source, place.line)
        if isinstance(stmt, For) and stmt.counter is not None:
            self._flow.set_counter(place, stmt.counter, number)

    def _follow_rows(self, lines: Ints, rounds: PlainRounds | None = None) -> None:
        """Run some rows of the trace, without rows that are plain or have no code.

        :param lines: (n,) the rows, in order.
        :param rounds: the plain rounds that contain the rows; None outside of such rounds.
        """
        for line in _rows_with_code(self.run.trace, lines[self._is_other_row[lines - 1]]):
            self.run.settings.apply_assignments_before(line)
            self._follow_node(line, None if rounds is None else rounds.counter_value(line))

    def _rows_outside_rounds(self) -> list[int]:
        """Return the rows of the trace that have code and are neither plain nor in plain rounds."""
        is_other = self._is_other_row.copy()
        for rounds in self._plain_rounds:
            is_other[rounds.first - 1 : rounds.stop_row - 1] = False
        return _rows_with_code(self.run.trace, np.flatnonzero(is_other) + 1)

    def executed_motions(self, motion_lines: Ints) -> Bools:
        """Return which of n plain motions run (n,): those in `Lines` of the trace.

        :param motion_lines: (n,) rows of the motions in the trace, ascending.
        :raises ProgramError: a motion is outside of DEF … END.
        """
        if self.execution.is_straight:
            self._refuse_motions_outside_routines(motion_lines)
        # steps ascend and do not overlap; the first is none, for motions before all steps: rows count from 1
        steps = [(0, 0), *((step.first, step.last) for step in self.execution.steps if isinstance(step, Lines))]
        first_rows, last_rows = np.array(steps).T
        index = np.searchsorted(first_rows, motion_lines, side="right") - 1  # the last step that begins by each motion
        return np.asarray(motion_lines <= last_rows[index])

    def _refuse_motions_outside_routines(self, motion_lines: Ints) -> None:
        """Refuse motions outside of the routines of the file.

        :param motion_lines: (n,) lines of the motions in the file, ascending.
        :raises ProgramError: a motion is outside of DEF … END.
        """
        is_in_routine = np.zeros(len(motion_lines), dtype=np.bool_)
        for routine in self.run.library.program.routines.values():
            is_in_routine |= (motion_lines > routine.first) & (motion_lines < routine.last)
        outside_lines = motion_lines[~is_in_routine]
        if len(outside_lines):
            raise self.run.trace.error(
                "the motion is outside of DEF … END", int(outside_lines[0]), advice="Move it into a routine."
            )

    def are_in_one_block(self, first: int, last: int) -> bool:
        """Return whether no spline block ends between two rows of the trace, given from 1."""
        return not any(first < line < last for line in self.splines.end_rows)

    def has_only_comments(self, first: int, last: int) -> bool:
        """Return whether the rows first … last of the trace contain nothing but comments and TRIGGERs."""
        trace = self.run.trace
        for row in range(first, last + 1):
            source, line = trace.place(row)
            start, stop = source.code_span(line)
            has_code = start < stop or trace.is_counter_row[row - 1]  # the latter: the row sets the counter of a FOR
            if has_code and row not in self._trigger_rows:
                return False
        return True

    def _enter_routine(self, step: RoutineEntry) -> None:
        """Make a called routine the running routine and set its parameters; functions in the arguments are followed."""
        place = self.run.go_to_row(step.row)
        stmt = statement(place.source, place.line)
        if isinstance(stmt, CallStatement):
            for inner in calls(stmt.call.arguments):
                self._flow.interpreter.calls.follow_call(place, inner, is_certain=False)
            self._flow.interpreter.calls.enter_routine(place, stmt.call, step.module, step.routine)

    def _follow_division(self, step: Fork | Branch | Join) -> None:
        """Follow a fork (store values and settings), a branch (restore them) or a join (merge them)."""
        self.run.row = step.row
        if isinstance(step, Fork):
            self.run.begin_fork()
        elif isinstance(step, Branch):
            self.run.begin_branch()
        else:
            self.run.join_branches(self.run.trace.place(step.row), is_exhaustive=step.is_exhaustive)

    def _pass_structure(self, step: UnresolvedStructure) -> None:
        """Pass over a control structure whose branch taken is not known before run time.

        Variables that it may write become unknown, and its motions stay uncorrected.
        """
        run = self.run
        lines, setting_lines = self._rows_of_step(step)
        for node in nodes_of(run.trace, sorted([*lines, *setting_lines])):
            if isinstance(node, Block):
                place = run.go_to_row(node.first)
                self._flow.follow_roughly(place.source, node.shifted(-run.shift))
        motion_lines = self._plain_motion_rows  # ascending
        first, stop = np.searchsorted(motion_lines, [step.first, step.last + 1])
        run.unresolved_motions += [(line, step.reason) for line in motion_lines[first:stop].tolist()]
        run.unresolved_motions = [*dict(run.unresolved_motions).items()]  # the last reason for each line

    def _note_fault(self, place: Place, cause: ProgramError) -> None:
        """Note an error of a statement, unless the statement names a variable whose own statement had an error.

        :param place: file and line of the statement.
        """
        names = [name.upper() for name in NAME.findall(place.source.text, *place.source.code_span(place.line))]
        if self._faulty_names.isdisjoint(names):
            self._errors.append(cause)
        # the first name is the variable that the statement sets
        self._faulty_names.update(
            name for name in names[:1] if name not in FIELD_OF_SETTING and name not in _INSTRUCTION_WORDS
        )

    def _take_motion(self, place: Place, stmt: Statement) -> None:
        """Run the functions in a motion, and collect it.

        :param place: file and line of the motion.
        """
        self._flow.interpreter.follow_functions(place, stmt.values)
        self._collected.take_motion(place, stmt)


def _first_row(node: Node | PlainRounds) -> int:
    """Return the row of the trace at which a statement (given by its row), a control structure or rounds begin."""
    return node if isinstance(node, int) else node.first


def _split_plain_settings(
    source: Source | Trace, lines: Sequence[int], settings: Sequence[int]
) -> tuple[Sequence[int], Ints]:
    """Return the lines that are run one by one, and the lines (n,) of the other plain settings.

    Plain settings inside control structures are run one by one, as all other statements are.

    :param source: a file; or the trace, whose rows then count as lines.
    :param lines: lines that are not plain, ascending.
    :param settings: lines of plain settings, ascending.
    """
    setting_lines = np.array(settings, dtype=np.int64)
    if not settings:
        return lines, setting_lines
    is_free = is_outside_structures(source, lines, setting_lines)
    lines_to_run = lines if is_free.all() else sorted([*lines, *setting_lines[~is_free].tolist()])
    return lines_to_run, setting_lines[is_free]


def _rows_with_code(trace: Trace, rows: Ints) -> list[int]:
    """Return the rows of a trace that have code, of some rows (n,), in order; each line of a file is examined once."""
    has_code = trace.is_counter_row[rows - 1].copy()  # rows that set the counter of a FOR
    file, line = trace.file[rows - 1], trace.line[rows - 1]
    for number, source in enumerate(trace.sources):
        indices = np.flatnonzero((file == number) & ~has_code)
        lines, of_row = np.unique(line[indices], return_inverse=True)
        is_code = np.array([_is_code(source, line) for line in lines.tolist()], dtype=np.bool_)
        has_code[indices] = is_code[of_row]
    coded_rows: list[int] = rows[has_code].tolist()
    return coded_rows


def _is_code(source: Source, line: int) -> bool:
    """Return whether a line has code; a header line such as ``&ACCESS`` has none."""
    start, stop = source.code_span(line)
    return start < stop and source.text[start] != "&"
