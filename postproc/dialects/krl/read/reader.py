"""From the files of a KRL program to a `Program`.

Assumptions that are not certain for every controller become issues: a missing component keeps its previous value
(0 in ``_REL``); subprograms of other files do not move the robot; ``$VEL.CP`` is 2 m/s until it is set. `$ROBROOT` is
taken as the origin of `$WORLD`. C_VEL and C_ORI have no distance: their motions get `blend` 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path, PurePath
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import garbage
from postproc.cell import Cell
from postproc.dialects.krl.execution import BranchError, Execution, ForkVisit, Join
from postproc.dialects.krl.language.positions import LARGEST_COORDINATE
from postproc.dialects.krl.language.routines import Module, Routine, routines
from postproc.dialects.krl.language.source import DAT, OTHER_FILE, SRC, Source
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.layout import Layout
from postproc.dialects.krl.read.comments import force_notes, remarks
from postproc.dialects.krl.read.data_lists import read_data, read_shared
from postproc.dialects.krl.read.folder import FolderFiles, Library, codes_of, find_needed_files, text_of_lines
from postproc.dialects.krl.read.frames import out_of_reach_error
from postproc.dialects.krl.read.issues import (
    issues_of,
    refuse_routines_under_force,
    refuse_routines_with_force_comments,
    unfollowed_calls,
)
from postproc.dialects.krl.read.joins import (
    FramesAndStart,
    JoinedEnds,
    branch_spans,
    check_endless_loop,
    check_joins,
    endless_loop_issue,
    endless_rounds,
    is_ptp_to_joints,
    joins_before_joint_targets,
    motions_before,
    predecessors_and_joins,
    transitions,
)
from postproc.dialects.krl.read.known import UnknownOrderError
from postproc.dialects.krl.read.main_routine import Start, TraceFollower, execution_of
from postproc.dialects.krl.read.motion_columns import MotionColumns, merged_motions
from postproc.dialects.krl.read.motions import (
    OrderedMotions,
    motions_and_layout,
    ordered_motions,
    setting_errors,
    stated_turn_speeds,
)
from postproc.dialects.krl.read.next_run import changed_data_issues, kept_values
from postproc.dialects.krl.read.plain_lines import PlainLines, plain_lines_of, plain_rows_of_trace
from postproc.dialects.krl.read.run import Run
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.unresolved import SeparatedMotions, depends_on_start, without_unresolved
from postproc.dialects.krl.read.variables import Variables
from postproc.dialects.krl.read.waits import waits
from postproc.dialects.text import decode
from postproc.errors import CellError, Issue, ProgramError, combined_error
from postproc.frames import DEG_PER_RAD, Array, any_column
from postproc.program import PTP, Bools, Document, Event, ForceNote, Ints, Motions, NeededFile, Program, distinct


def read_program(
    documents: Sequence[Document],
    cell: Cell,
    kinematics: Callable[[Array], Array],
    name: str,
    *,
    _bulk: bool = True,  # False in tests: plain lines are read one by one too, and the results compared
) -> Program:
    """Read a KRL program.

    :param documents: the `.src` first, then its `.dat` if there is one, and files of routines that it calls, which
        replace files of the same name in its folder.
    :param cell: frames for programs that set none of their own, frames by number, the start position of the robot.
    :param kinematics: (6,) joints [rad] → (4, 4) flange in the robot root [m], by the controller's nominal geometry.
    :param name: name of the program.
    :returns: the program; its `layout` is a `Layout`.
    :raises ProgramError: the program is not complete, something that changes motion is not understood or not known
        before the program runs; it names file, line, text and what to do.
    :raises ForceError: a force comment cannot be read.
    :raises CellError: the `$config.dat` that the cell names cannot be read, or the cell and the files give different
        frames for one number.
    """
    with garbage.collection_paused():
        return _read_program(documents, cell, kinematics, name, bulk=_bulk)


def _read_program(
    documents: Sequence[Document], cell: Cell, kinematics: Callable[[Array], Array], name: str, *, bulk: bool
) -> Program:
    """Read a KRL program, see `read_program`.

    Routines of other files and forks (an IF or SWITCH whose branch taken is not known before run time) that cannot be
    corrected become obstacles: the program is followed again, and leaves their motions uncorrected, until no new one is
    found.

    :param bulk: False to read plain lines (motions and settings of the common form) one by one, as all others.
    :raises ProgramError: see `read_program`.
    """
    source = Source.of(documents[0], SRC)
    # in a list, from which the first reading takes them, so that their memory is released
    scanned_lines = [plain_lines_of(source, bulk=bulk)]
    module, entry, routine_faults = _main_routine(source, scanned_lines[0], name)
    other_documents = [document for document in documents[1:] if not _is_data_of(document, documents[0])]
    library = Library(module, FolderFiles(_folders(documents[0], cell), other_documents))
    code = text_of_lines(source, (np.flatnonzero(scanned_lines[0].is_other_line(len(source.starts))) + 1).tolist())
    reading = _Reading(
        documents, cell, kinematics, name, library=library, entry=entry, routine_faults=routine_faults, code=code
    )
    obstacles: dict[Routine | ForkVisit, ProgramError] = {}
    while True:
        try:
            plain_lines = scanned_lines.pop() if scanned_lines else plain_lines_of(source, bulk=bulk)
            return reading.program(reading.follow(plain_lines, obstacles, bulk=bulk))
        except RecursionError:
            problem = "calls, control structures and brackets are nested too deeply"
            raise source.line_error(problem, entry.first, "Write fewer of them into each other.") from None
        except ProgramError as cause:
            keeps_branches = cell.krl.keep_unresolved
            new_obstacles = _obstacles_of(cause, library, keeps_branches=keeps_branches) - obstacles.keys()
            if not new_obstacles:
                raise
            obstacles |= {obstacle: _error_of_obstacle(cause, obstacle) for obstacle in new_obstacles}


class _Reading(Struct, frozen=True, eq=False):
    """A program before it is followed; for the first four parameters see `read_program`.

    :param library: finds the routines that the program calls.
    :param entry: the main routine.
    :param routine_faults: errors in the bounds of routines, such as DEF without END.
    :param code: text of all lines of the main file that are not plain.
    """

    documents: Sequence[Document]
    cell: Cell
    kinematics: Callable[[Array], Array]
    name: str
    library: Library
    entry: Routine
    routine_faults: list[ProgramError]
    code: str

    def follow(
        self, plain_lines: PlainLines, obstacles: Mapping[Routine | ForkVisit, ProgramError], *, bulk: bool
    ) -> _ExecutedProgram:
        """Follow the program line by line in the order of execution, and read its motions.

        :param plain_lines: plain lines of the `.src`; their motions are emptied.
        :param obstacles: routines, and visits to forks, that are not followed, each with the reason.
        :param bulk: False to read plain lines one by one.
        :raises ProgramError: something that changes motion is not understood or not known before the program runs.
        """
        joints = tuple(float(angle) for angle in self.cell.start_joints * DEG_PER_RAD)
        variables = self._initial_variables()
        start = Start(self.library, self.entry, obstacles, variables=variables, cell=self.cell, joints=joints)
        execution, collected_motions = execution_of(start)
        if not execution.is_straight:  # from lines of files to rows of the execution trace
            plain_lines = plain_rows_of_trace(execution.trace, {self.entry.source: plain_lines}, bulk=bulk)
        # None: the motions have not been collected while the trace was recorded
        if collected_motions is None or self.routine_faults:
            follower = TraceFollower(start.new_collection(execution.trace), execution, plain_lines)
            self._run_statements(follower, plain_lines)
        else:
            follower = TraceFollower(collected_motions, execution, plain_lines)
        if not self.cell.krl.keep_unresolved:
            refuse_routines_with_force_comments(follower.run)
        plain_lines = self._executed_lines(follower, plain_lines)
        change_places = kept_values(follower)
        # variables keep changed values: the next run is followed too, and needs its own list, since this one is emptied
        plain_motions = [*plain_lines.motions] if change_places else plain_lines.motions
        sequence = ordered_motions(follower, plain_motions)
        data_issues = list(changed_data_issues(follower, change_places, sequence, plain_lines, joints))
        return _ExecutedProgram(start, follower, without_unresolved(follower, sequence), data_issues)

    def _run_statements(self, follower: TraceFollower, plain_lines: PlainLines) -> None:
        """Run the statements along the complete trace.

        :param plain_lines: the plain lines; their motions are emptied if statements have errors.
        :raises ProgramError: all errors in the statements, and of motions that depend on unknown settings.
        """
        try:
            follower.follow(self.routine_faults)
        except RecursionError:
            problem = "calls, control structures and brackets are nested too deeply"
            advice = "Write fewer of them into each other."
            raise follower.run.trace.error(problem, follower.run.row, advice) from None
        except ProgramError as cause:
            # under `--keep-unresolved` unknown settings are no errors; the other two errors end the run early
            if self.cell.krl.keep_unresolved or isinstance(cause, UnknownOrderError | BranchError):
                raise
            faults = [cause, *(error for error in cause.further_errors if isinstance(error, ProgramError))]
            fault_keys = {(fault.file, fault.line, fault.problem) for fault in faults}
            setting_faults = [
                fault
                for fault in setting_errors(follower, plain_lines.motions)
                if (fault.file, fault.line, fault.problem) not in fault_keys
            ]
            if not setting_faults:
                raise
            raise combined_error([*faults, *setting_faults]) from None

    def _executed_lines(self, follower: TraceFollower, plain_lines: PlainLines) -> PlainLines:
        """Return the plain lines without motions that do not run.

        :raises ProgramError: the program has no motion that runs.
        """
        is_executed = follower.executed_motions(plain_lines.motion_lines)
        has_statements = bool(len(follower.motions) or follower.rounds or follower.run.unresolved_motions)
        if not is_executed.any() and not has_statements:
            raise ProgramError(
                "there are no motions", file=self.documents[0].name, advice="Check that this is the program."
            )
        if is_executed.all():
            return plain_lines
        return replace(
            plain_lines, motions=[merged_motions(plain_lines.motions, np.arange(len(is_executed))).take(is_executed)]
        )

    def program(self, executed_program: _ExecutedProgram) -> Program:
        """Return the program with its motions and the layout of its text.

        :param executed_program: the program with its ordered motions.
        :raises ProgramError: motions end in different poses where branches meet or a LOOP without EXIT begins its next
            round, a target is not known before run time, or a coordinate is out of reach.
        """
        follower, separation = executed_program.follower, executed_program.separation
        run, execution = follower.run, follower.execution
        sequence = separation.sequence  # the motions that can be corrected
        order = self._motion_order(follower, separation)
        _check_size(execution.trace, sequence.columns)
        _check_starts(follower, sequence)
        motions, layout, assumptions = motions_and_layout(
            follower, sequence, self.cell.start_joints, self.kinematics, order.predecessors
        )
        issues = list(_program_issues(executed_program, layout, assumptions))
        path = _frames_and_start(run.settings, self.kinematics(self.cell.start_joints))
        joined_ends = _checked_ends(follower, order, motions, layout, path)
        documents, needed_files = self._program_files(follower)
        return Program(
            name=self.name,
            dialect="krl",
            documents=documents,
            motions=motions,
            bases=path.bases,
            tools=path.tools,
            tool_keys=_tool_keys(run.settings),
            events=(*remarks(execution, layout.trace_row), *self._waits(run, execution, layout.trace_row)),
            notes=tuple(note for _, note in order.notes),
            still=_reported_lines(execution.trace, follower.idle_rows),
            issues=tuple(issues),
            carriage=layout.carriage,
            turns_with_path=_none_if_all_false(layout.turns_with_path),
            is_wrist_led=_none_if_all_false(layout.is_wrist_led),
            turn_speeds=stated_turn_speeds(sequence.numbers),
            after=order.predecessors,
            joins=joined_ends,
            branches=branch_spans(execution, sequence.columns.trace_row),
            transitions=transitions(
                execution, layout.trace_row, order.predecessors, order.uncorrected_rows, order.unchecked_joins
            ),
            unresolved=separation.unresolved,
            unfollowed=() if self.cell.krl.keep_unresolved else unfollowed_calls(run),
            needed=needed_files,
            layout=replace(layout, notes=tuple(line for line, _ in order.notes)),
        )

    def _waits(self, run: Run, execution: Execution, trace_row: Ints) -> Iterator[Event]:
        """Yield the waits of a program as dwells, one for each motion at whose end the program may wait.

        :param trace_row: (M,) rows of the trace with the motions.
        """
        times = waits(execution, self._routines(), run.waiting_calls)
        uncorrected_rows = [row for row, _ in run.unresolved_motions]
        for row, motion in motions_before(execution, trace_row, uncorrected_rows, times) if times else ():
            yield Event(before=motion + 1, kind="dwell", line=execution.trace.reported_line(row), value=times[row])

    def _motion_order(self, follower: TraceFollower, separation: SeparatedMotions) -> _MotionOrder:
        """Return which motions of a program follow each other, and under which force comments.

        :param separation: the motions that are corrected.
        :raises ProgramError: the force on a motion is not known, or an unfollowed routine is called under force.
        :raises BranchError: a motion in or after a branch depends on more than its start pose.
        """
        run, execution, sequence = follower.run, follower.execution, separation.sequence
        # on a linear axis no join is unchecked: E1 must be in one position at each join
        unchecked_joins = (
            frozenset() if self.cell.carriage is not None else joins_before_joint_targets(execution, sequence)
        )
        notes = force_notes(
            execution,
            sequence.columns.trace_row,
            sequence.columns.kind == PTP,
            run.unknown_force_reasons,
            unchecked_joins,
        )
        if not self.cell.krl.keep_unresolved:
            refuse_routines_under_force(run, notes)
        uncorrected_rows = [line for line, _ in run.unresolved_motions]
        predecessors, joins = predecessors_and_joins(
            execution, sequence, separation.predecessors, uncorrected_rows, unchecked_joins
        )
        return _MotionOrder(notes, predecessors, joins, unchecked_joins, uncorrected_rows)

    def _program_files(self, follower: TraceFollower) -> tuple[tuple[Document, ...], tuple[NeededFile, ...]]:
        """Return the files that are written, and the other files that the program needs.

        Written are those of the program, and those of routines that are in the execution trace (inlined).
        """
        library = self.library
        program = self.documents[0]
        program_documents = (d for d in self.documents if d.name == program.name or _is_data_of(d, program))
        documents = *program_documents, *follower.execution.files
        inlined_files = {document.name for document in follower.execution.files}
        inlined_modules = (module for module in library.read_modules() if module.source.document.name in inlined_files)
        modules = self._module_with_data(library.program), *inlined_modules
        code = (code for module in modules for code in codes_of(module))
        moving_files = {
            module.source.document.name.upper()
            for module, routine in library.called_routines()
            if follower.run.analysis.effects_of(module, routine).motion
        }
        return documents, find_needed_files(documents, code, library.files, moving_files)

    def _routines(self) -> Iterator[Routine]:
        """Yield all routines of the program and of the files that have been read."""
        for module in (self.library.program, *self.library.read_modules()):
            yield from module.routines.values()

    def _module_with_data(self, program: Module) -> Module:
        """Return the module of the program with its `.dat`, if there is one."""
        data = [document for document in self.documents[1:] if _is_data_of(document, self.documents[0])]
        return replace(program, data=Source.of(data[0], DAT)) if data else program

    def _initial_variables(self) -> Variables:
        """Return the variables as they are before the program runs: from the `.dat`, `$config.dat` and the cell.

        Values of the cell replace those of files; the `.dat` comes before the `$config.dat`, and GLOBAL variables of
        other files come last.

        :raises CellError: the `$config.dat` cannot be read, or two places give different frames for one number.
        """
        variables = Variables(self.cell)
        for document in self.documents[1:]:
            if _is_data_of(document, self.documents[0]):
                read_data(variables, Source.of(document, DAT))
        if self.cell.config_dat is not None:
            read_data(variables, _config_source(self.cell, self.cell.config_dat), fills_gaps=True, is_global=True)
        program = self.documents[0]
        program_names = [
            program.name,
            *(document.name for document in self.documents if _is_data_of(document, program)),
        ]
        read_shared(variables, self.code, program_names, self.library.files, self.entry.local_names)
        variables.take_cell_values()
        return variables


class _MotionOrder(NamedTuple):
    """Which of M motions follow each other, and under which force.

    :ivar notes: force comments, each with its row of the trace.
    :ivar predecessors: (M,) the motion at whose end each begins, see `Program.after`; None: the motion before it.
    :ivar joins: control-flow joins at which branches must end in one pose.
    :ivar unchecked_joins: control-flow joins at which branches may end in different poses.
    :ivar uncorrected_rows: rows of the trace with uncorrected motions.
    """

    notes: list[tuple[int, ForceNote]]
    predecessors: Ints | None
    joins: list[JoinedEnds]
    unchecked_joins: frozenset[Join]
    uncorrected_rows: list[int]


def _checked_ends(
    follower: TraceFollower, order: _MotionOrder, motions: Motions, layout: Layout, path: FramesAndStart
) -> tuple[tuple[int, ...], ...]:
    """Return the groups of motions that end in one pose: before each join, and before a round of a LOOP without EXIT.

    :param path: frames of the program and flange at its start.
    :raises ProgramError: motions of a group end in different poses, or a round ends with other settings than it began.
    """
    execution = follower.execution
    check_joins(execution, order.joins, motions, layout.carriage, path)
    ends = tuple(join.ends for join in order.joins)
    if (loop := execution.endless_loop) is None:
        return ends
    rounds = endless_rounds(loop, layout, motions, path, order.predecessors)
    check_endless_loop(execution, rounds, follower.run.settings)
    return (*ends, *rounds.joined_ends())


class _ExecutedProgram(Struct, frozen=True, eq=False):
    """A program that has been followed.

    :param start: what it began with.
    :param follower: has followed its statements.
    :param separation: the motions, separated by whether they can be corrected.
    :param data_issues: warnings that the next run moves differently.
    """

    start: Start
    follower: TraceFollower
    separation: SeparatedMotions
    data_issues: list[Issue]


def _program_issues(
    executed_program: _ExecutedProgram, layout: Layout, assumptions: Sequence[Issue]
) -> Iterator[Issue]:
    """Yield the issues about a program that has been followed, in the order in which they are reported.

    :param layout: the layout of the text of its motions.
    :param assumptions: issues about assumptions on its motions.
    :raises ProgramError: a called program is known to move the robot by a sensor.
    """
    follower, separation = executed_program.follower, executed_program.separation
    yield from (*follower.run.issues, *separation.issues, *assumptions, *executed_program.data_issues)
    yield from issues_of(follower, separation.sequence.motion_states, separation.sequence.columns, layout)
    yield from _cell_value_issues(executed_program)
    if follower.execution.endless_loop is not None:
        yield endless_loop_issue(follower.execution)


def _frames_and_start(settings: Settings, start_flange: Array) -> FramesAndStart:
    """Return the frames that a program has used, and the flange at its start.

    :param start_flange: (4, 4) flange at the start of the program, in the robot root [m].
    """
    return FramesAndStart(np.stack(settings.frames.bases), np.stack(settings.frames.tools), start_flange)


def _reported_lines(trace: Trace, rows: Sequence[int]) -> Ints:
    """Return the lines of the `.src` to report for rows of the trace, from 1; each row once, ascending."""
    return trace.reported_lines[distinct(np.array(rows, dtype=np.int64)) - 1]


def _none_if_all_false(flags: Bools) -> Bools | None:
    """Return the flags (M,) of motions; None, which takes no memory, if they are False throughout."""
    return flags if flags.any() else None


def _tool_keys(settings: Settings) -> tuple[tuple[str, ...], ...]:
    """Return `Program.tool_keys`: for each tool frame of a program the numbers n of its `TOOL_DATA[n]`, as text."""
    numbers = settings.frames.tool_numbers
    return tuple(tuple(map(str, sorted(numbers.get(row, ())))) for row in range(len(settings.frames.tools)))


def _cell_value_issues(executed_program: _ExecutedProgram) -> Iterator[Issue]:
    """Yield an issue if the home position is that of the cell, and one if values of [krl.values] have been read."""
    follower, start = executed_program.follower, executed_program.start
    if follower.reader.home_motion_row:
        message = "The home position is in no file of the program: the joints of [start] in the cell are taken for it."
        line = follower.execution.trace.reported_line(follower.reader.home_motion_row)
        yield Issue("info", "home-from-cell", message, line)
    if relied_names := start.variables.used_cell_values:
        cell_values = start.cell.krl.values
        values = ", ".join(f"{name} = {value}" for name, value in cell_values.items() if name.upper() in relied_names)
        message = f"Values of [krl.values] in the cell: {values}. The output holds for these values only."
        yield Issue("warning", "values-from-cell", message)


def _is_data_of(data: Document, source: Document) -> bool:
    """Return whether a file is the `.dat` of a `.src`, by its name."""
    return PurePath(data.name).suffix.upper() == ".DAT" and data.name[:-4].upper() == PurePath(source.name).stem.upper()


def _obstacles_of(cause: ProgramError, library: Library, *, keeps_branches: bool) -> frozenset[Routine | ForkVisit]:
    """Return the routines of other files, or the visits to forks, that are left uncorrected because of an error.

    A fork is an IF or SWITCH whose branch taken is not known before run time. In a loop, each iteration visits it anew.

    :param keeps_branches: True if motions in branches may be left uncorrected (`--keep-unresolved`).
    :returns: empty if the error is in the program itself, which is then refused.
    """
    if isinstance(cause, BranchError) and keeps_branches:
        return cause.fork_visits
    if isinstance(cause, UnknownOrderError) and cause.routine is not None:  # a call that cannot be followed
        is_in_program = cause.routine.source is library.program.source
        return frozenset(() if is_in_program else {cause.routine})
    files = {error.file for error in (cause, *cause.further_errors)}
    # an error in another file may be in any of its routines, or between them: all of them are left uncorrected
    return frozenset(
        routine
        for module in library.read_modules()
        if module.source.document.name in files
        for routine in module.routines.values()
    )


def _error_of_obstacle(cause: ProgramError, obstacle: Routine | ForkVisit) -> ProgramError:
    """Return why a routine, or a visit to a fork, is not followed: the first error in the file of the routine.

    :param cause: the error that ended the reading; others are its `further_errors`.
    :returns: `cause` itself for a fork, and if no error is in that file.
    """
    if not isinstance(obstacle, Routine):
        return cause
    errors = [error for error in (cause, *cause.further_errors) if isinstance(error, ProgramError)]
    return next((error for error in errors if error.file == obstacle.source.document.name), cause)


def _config_source(cell: Cell, path: str) -> Source:
    """Return the `$config.dat` of a cell.

    :param path: path of the file, relative to the folder of the cell.
    :raises CellError: the file cannot be read.
    """
    file = Path(cell.folder) / path
    try:
        data = file.read_bytes()
    except OSError as cause:
        raise CellError(
            f"config_dat cannot be read ({cause.strerror})", file=str(file), advice="The path is relative to the cell."
        ) from cause
    return Source.of(decode(file.name, data), OTHER_FILE)


class _MainRoutine(NamedTuple):
    """The main routine of a program.

    :ivar module: the file with all its routines.
    :ivar routine: the routine with the name of the program; if there is none, the first routine.
    :ivar routine_faults: errors in the bounds of routines, such as DEF without END.
    """

    module: Module
    routine: Routine
    routine_faults: list[ProgramError]


def _main_routine(source: Source, plain_lines: PlainLines, name: str) -> _MainRoutine:
    """Return the main routine of a program.

    :param plain_lines: plain lines of the file.
    :param name: name of the program.
    :raises ProgramError: the file has no routine, or the bounds of all routines are wrong.
    """
    other_lines = np.flatnonzero(plain_lines.is_other_line(len(source.starts))) + 1
    by_name, faults = routines(
        source, other_lines.tolist(), plain_lines.motion_lines, plain_lines.settings.line.tolist()
    )
    module = Module(source, by_name)
    routine = module.main_routine(name)
    if routine is None and faults:
        raise combined_error(faults)
    if routine is None:
        raise ProgramError(
            "there is no DEF", file=source.document.name, line=1, advice="Check that this is a KRL program."
        )
    return _MainRoutine(module, routine, faults)


def _folders(document: Document, cell: Cell) -> list[Path]:
    """Return the folders that are searched for called programs: the program's own, then those that the cell names."""
    own_folders = [Path(document.folder)] if document.folder else []
    return own_folders + [Path(cell.folder) / folder for folder in cell.krl.search]


def _check_size(trace: Trace, columns: MotionColumns) -> None:
    """Refuse coordinates beyond `LARGEST_COORDINATE`, which no robot reaches.

    :param columns: all motions of the program.
    :raises ProgramError: a motion has such a coordinate; the first one is named.
    """
    is_too_far = any_column(np.abs(columns.numbers) > LARGEST_COORDINATE) | any_column(
        np.abs(columns.via) > LARGEST_COORDINATE
    )
    if is_too_far.any():
        row = int(np.argmax(is_too_far))
        largest = max(float(np.nanmax(np.abs(values[row]), initial=0.0)) for values in (columns.numbers, columns.via))
        raise out_of_reach_error(trace.place(int(columns.trace_row[row])), largest)


def _check_starts(follower: TraceFollower, sequence: OrderedMotions) -> None:
    """Refuse motions that depend on their start pose, if that is not known.

    The next motion behind a call that RESUME may break off must not depend on its start. The next motion behind a call
    that moves the robot and is not followed must be a PTP to joint angles: no other leads the arm to one configuration.

    :raises ProgramError: there is such a motion.
    """
    if follower.run.keeps_unresolved:
        return  # such motions have been left out as uncorrected
    trace_row = sequence.columns.trace_row
    for call_row, reason in follower.run.interruptible_calls:
        motion = int(np.searchsorted(trace_row, call_row))  # the next motion
        if motion < len(trace_row) and depends_on_start(sequence, motion):
            raise reason
    for call in follower.run.untraced_calls:
        motion = int(np.searchsorted(trace_row, call.row))  # the next motion
        if motion < len(trace_row) and not is_ptp_to_joints(sequence, motion):
            raise call.reason
