"""From the files of a KRL program to a `Program`.

Assumptions that are not certain for every controller become issues: a missing component keeps its previous value
(0 in ``_REL``); subprograms of other files do not move the robot; ``$VEL.CP`` is 2 m/s until it is set. `$ROBROOT` is
taken as the origin of `$WORLD`. C_VEL and C_ORI have no distance: their motions get `blend` 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path, PurePath

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import garbage
from postproc.cell import Cell
from postproc.chunks import in_chunks
from postproc.dialects.krl.course import Occasion
from postproc.dialects.krl.language.positions import LARGEST_COORDINATE
from postproc.dialects.krl.language.routines import Module, Routine, routines
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.read.comments import notes_of, remarks
from postproc.dialects.krl.read.data_lists import read_data, read_shared
from postproc.dialects.krl.read.folder import FolderFiles, Library, code_of, codes_of, needed
from postproc.dialects.krl.read.frames import out_of_reach
from postproc.dialects.krl.read.issues import issues_of, refuse_loaded, refuse_noted, unfollowed
from postproc.dialects.krl.read.joins import (
    BranchError,
    branches,
    branching,
    check_joins,
    check_round,
    free_joins,
    starts,
    transitions,
)
from postproc.dialects.krl.read.known import InexactError
from postproc.dialects.krl.read.main_routine import MainRoutine, Start, course_of
from postproc.dialects.krl.read.motion_columns import MotionColumns, merged
from postproc.dialects.krl.read.motions import OrderedMotions, motions_and_layout, ordered_motions, unsettled
from postproc.dialects.krl.read.next_run import changed_data_issues, kept_values
from postproc.dialects.krl.read.plain_lines import PlainLines, gathered, plain_of
from postproc.dialects.krl.read.unresolved import SeparatedMotions, needs_start, without_unresolved
from postproc.dialects.krl.read.variables import Variables
from postproc.dialects.text import decode
from postproc.errors import CellError, Issue, ProgramError, combined_error
from postproc.frames import DEG_PER_RAD, Array, any_column
from postproc.program import PTP, Document, NeededFile, Program, distinct


def read_program(
    documents: Sequence[Document],
    cell: Cell,
    kinematics: Callable[[Array], Array],
    name: str,
    *,
    _bulk: bool = True,
) -> Program:
    """Read a KRL program.

    :param documents: the `.src` first, then its `.dat` if there is one, and files of routines that it calls, which
        count instead of those of the same name in its folder.
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
        return _followed(documents, cell, kinematics, name, bulk=_bulk)


def _followed(
    documents: Sequence[Document], cell: Cell, kinematics: Callable[[Array], Array], name: str, *, bulk: bool
) -> Program:
    """Return what `read_program` does."""
    source = Source.of(documents[0], 0)
    scanned = [plain_of(source, bulk=bulk)]  # taken out where it is used up, so that its memory is released
    module, entry, faults = _main(source, scanned[0], name)
    other_documents = [document for document in documents[1:] if not _belongs(document, documents[0])]
    library = Library(module, FolderFiles(_folders(documents[0], cell), other_documents))
    code = code_of(source, (np.flatnonzero(scanned[0].others(len(source.starts))) + 1).tolist())
    reading = _Reading(documents, cell, kinematics, name, library, entry, faults, code)
    obstacles: dict[Routine | Occasion, ProgramError] = {}
    while True:
        try:
            return reading.program(
                reading.followed(scanned.pop() if scanned else plain_of(source, bulk=bulk), obstacles, bulk=bulk)
            )
        except RecursionError:
            problem = "calls, control structures and brackets are nested too deeply"
            raise source.line_error(problem, entry.first, "Write fewer of them into each other.") from None
        except ProgramError as cause:
            culprits = _apart(cause, library, keep=cell.krl.keep_unresolved) - obstacles.keys()
            if not culprits:
                raise
            obstacles |= {culprit: _about(cause, culprit) for culprit in culprits}


class _Reading(Struct, frozen=True, eq=False):
    """A program before it is followed; see `read_program`.

    :param code: all lines of the main file that are not plain.
    """

    documents: Sequence[Document]
    cell: Cell
    kinematics: Callable[[Array], Array]
    name: str
    library: Library
    entry: Routine
    faults: list[ProgramError]
    code: str

    def followed(
        self, plain: PlainLines, obstacles: Mapping[Routine | Occasion, ProgramError], *, bulk: bool
    ) -> _ExecutedProgram:
        """Follow the program, and read what moves.

        :param plain: plain lines of the `.src`.
        :param obstacles: see `Run.elsewhere`.
        """
        joints = tuple(float(angle) for angle in self.cell.start_joints * DEG_PER_RAD)
        start = Start(self.library, self.entry, obstacles, self._variables(), self.cell, joints)
        course, collected = course_of(start)
        if not course.straight:
            plain = gathered(course.trace, {self.entry.source: plain}, bulk=bulk)
        if collected is None or self.faults:
            main = MainRoutine(start.collected(course.trace), course, plain)
            self._follow(main, plain)
        else:
            main = MainRoutine(collected, course, plain)
        if not self.cell.krl.keep_unresolved:
            refuse_noted(main.run)
        plain = self._executed(main, plain)
        change_places = kept_values(main)
        parts = [*plain.motions] if change_places else plain.motions  # emptied; a second run needs them
        sequence = ordered_motions(main, parts)
        data_issues = list(changed_data_issues(main, change_places, sequence, plain, joints))
        return _ExecutedProgram(start, main, without_unresolved(main, sequence), data_issues)

    def _follow(self, main: MainRoutine, plain: PlainLines) -> None:
        """Run the statements along the complete trace.

        :raises ProgramError: all that is wrong in them, and settings that motions lack.
        """
        try:
            main.follow(self.faults)
        except RecursionError:
            problem = "calls, control structures and brackets are nested too deeply"
            advice = "Write fewer of them into each other."
            raise main.run.trace.error(problem, main.run.row, advice) from None
        except ProgramError as cause:
            if self.cell.krl.keep_unresolved or isinstance(cause, InexactError | BranchError):
                raise
            faults = [cause, *(error for error in cause.further_errors if isinstance(error, ProgramError))]
            fault_keys = {(fault.file, fault.line, fault.problem) for fault in faults}
            setting_faults = [
                fault
                for fault in unsettled(main, plain.motions)
                if (fault.file, fault.line, fault.problem) not in fault_keys
            ]
            if not setting_faults:
                raise
            raise combined_error([*faults, *setting_faults]) from None

    def _executed(self, main: MainRoutine, plain: PlainLines) -> PlainLines:
        """Return the plain lines that run.

        :raises ProgramError: nothing moves.
        """
        is_executed = main.executed(plain.moving)
        if not is_executed.any() and not len(main.motions) and not main.rounds and not main.run.unresolved:
            raise ProgramError(
                "there are no motions", file=self.documents[0].name, advice="Check that this is the program."
            )
        if is_executed.all():
            return plain
        return replace(plain, motions=[merged(plain.motions, np.arange(len(is_executed))).take(is_executed)])

    def program(self, followed: _ExecutedProgram) -> Program:
        """Return the program, with the layout of its text."""
        main, cell, separation = followed.main, self.cell, followed.separation
        run, course, sequence, trace = main.run, main.course, separation.ordered, main.course.trace
        free = frozenset() if cell.carriage is not None else free_joins(course, sequence)
        notes = notes_of(course, sequence.rows.line, sequence.rows.kind == PTP, run.unforced, free)
        if not cell.krl.keep_unresolved:
            refuse_loaded(run, notes)
        uncorrected_lines = [line for line, _ in run.unresolved]
        predecessors, joins = branching(course, sequence, separation.after, uncorrected_lines, free)
        _check_size(trace, sequence.rows)
        _check_starts(main, sequence)
        motions, layout, assumptions = motions_and_layout(
            main, sequence, cell.start_joints, self.kinematics, predecessors
        )
        issues = [*run.issues, *separation.issues, *assumptions, *followed.data_issues]
        issues += issues_of(main, sequence.states, sequence.state, sequence.rows, layout)
        issues += _issues_of_cell(followed)
        frames = np.stack(run.settings.frames.bases), np.stack(run.settings.frames.tools)
        pose = self.kinematics(cell.start_joints)
        check_joins(course, joins, motions, layout.carriage, frames, pose)
        loop_issues: list[Issue] = []
        rounds: tuple[tuple[int, ...], ...] = ()
        if (loop := course.endless) is not None:
            begins = starts(loop, layout.line, motions, frames, pose, predecessors)
            loop_issues, rounds = check_round(
                course, loop, layout.line, motions, begins, layout.carriage, notes, run.settings
            )
        documents, needed_files = self._files(main)
        return Program(
            self.name,
            "krl",
            documents,
            motions,
            *frames,
            tool_keys=tuple(
                tuple(map(str, sorted(run.settings.frames.tool_numbers.get(row, ())))) for row in range(len(frames[1]))
            ),
            events=remarks(course, layout.line),
            notes=tuple(note for _, note in notes),
            still=trace.shown[distinct(np.array(main.still, dtype=np.int64)) - 1],
            issues=(*issues, *loop_issues),
            carriage=layout.carriage,
            with_path=layout.with_path if layout.with_path.any() else None,
            by_wrist=layout.by_wrist if layout.by_wrist.any() else None,
            after=predecessors,
            joins=(*(join.ends for join in joins), *rounds),
            branches=branches(course, sequence.rows.line),
            transitions=transitions(course, layout.line, predecessors, uncorrected_lines, free),
            unresolved=separation.unresolved,
            unfollowed=() if cell.krl.keep_unresolved else unfollowed(run),
            needed=needed_files,
            layout=replace(layout, notes=tuple(line for line, _ in notes)),
        )

    def _files(self, main: MainRoutine) -> tuple[tuple[Document, ...], tuple[NeededFile, ...]]:
        """Return the files of the program, inlined ones included, and those that it needs besides."""
        library = self.library
        first = self.documents[0]
        own_documents = (d for d in self.documents if d.name == first.name or _belongs(d, first))
        documents = *own_documents, *main.course.files
        files = {document.name for document in main.course.files}
        other_modules = (module for module in library.read() if module.source.document.name in files)
        code = (code for module in (self._with_data(library.program), *other_modules) for code in codes_of(module))
        moving = {m.source.document.name.upper() for m, r in library.found() if main.run.analysis.of(m, r).motion}
        return documents, needed(documents, code, library.files, moving)

    def _with_data(self, program: Module) -> Module:
        """Return the file of the program with its `.dat`."""
        data = [document for document in self.documents[1:] if _belongs(document, self.documents[0])]
        return replace(program, data=Source.of(data[0], 1)) if data else program

    def _variables(self) -> Variables:
        """Return the variables with their initial values: of the .dat, $config.dat and the cell."""
        variables = Variables(self.cell)
        for document in self.documents[1:]:
            if _belongs(document, self.documents[0]):
                read_data(variables, Source.of(document, 1))
        if self.cell.config_dat is not None:
            read_data(variables, _config_source(self.cell, self.cell.config_dat), fill=True, is_global=True)
        program = self.documents[0]
        program_names = [program.name, *(document.name for document in self.documents if _belongs(document, program))]
        read_shared(variables, self.code, program_names, self.library.files, self.entry.local)
        variables.take_cell_values()
        return variables


class _ExecutedProgram(Struct, frozen=True, eq=False):
    """A program whose statements have run.

    :param separation: its motions, those that stay as they are apart.
    :param data_issues: warnings that its next run moves differently.
    """

    start: Start
    main: MainRoutine
    separation: SeparatedMotions
    data_issues: list[Issue]


def _issues_of_cell(followed: _ExecutedProgram) -> Iterator[Issue]:
    """Yield what is taken from the cell: the home position, values of variables."""
    main, start = followed.main, followed.start
    if main.reader.home_used:
        message = "The home position is in no file of the program: the joints of [start] in the cell are taken for it."
        line = main.course.trace.shown_line(main.reader.home_used)
        yield Issue("info", "home-from-cell", message, line)
    if relied_names := start.variables.relied:
        given = start.cell.krl.values
        values = ", ".join(f"{name} = {value}" for name, value in given.items() if name.upper() in relied_names)
        message = f"Values of [krl.values] in the cell: {values}. The output holds for these values only."
        yield Issue("warning", "values-from-cell", message)


def _belongs(data: Document, source: Document) -> bool:
    """Return whether a file is the `.dat` of a program."""
    return PurePath(data.name).suffix.upper() == ".DAT" and data.name[:-4].upper() == PurePath(source.name).stem.upper()


def _apart(cause: ProgramError, library: Library, *, keep: bool) -> frozenset[Routine | Occasion]:
    """Return the routines of other files that an error is about, or branches: their motions are left as they are."""
    if isinstance(cause, BranchError) and keep:
        return cause.occasions
    if isinstance(cause, InexactError) and cause.routine is not None:
        return frozenset({cause.routine} if cause.routine.source is not library.program.source else ())
    files = {error.file for error in (cause, *cause.further_errors)}
    return frozenset(
        routine
        for module in library.read()
        if module.source.document.name in files
        for routine in module.routines.values()
    )


def _about(cause: ProgramError, culprit: Routine | Occasion) -> ProgramError:
    """Return which of the errors that came together is about a routine."""
    errors = [error for error in (cause, *cause.further_errors) if isinstance(error, ProgramError)]
    own_errors = [e for e in errors if isinstance(culprit, Routine) and e.file == culprit.source.document.name]
    return own_errors[0] if own_errors else cause


def _config_source(cell: Cell, path: str) -> Source:
    """Return the `$config.dat` of a cell.

    :param path: relative to the folder of the cell.
    :raises CellError: it cannot be read.
    """
    file = Path(cell.folder) / path
    try:
        data = file.read_bytes()
    except OSError as cause:
        raise CellError(
            f"config_dat cannot be read ({cause.strerror})", file=str(file), advice="The path is relative to the cell."
        ) from cause
    return Source.of(decode(file.name, data), 2)


def _main(source: Source, plain: PlainLines, name: str) -> tuple[Module, Routine, list[ProgramError]]:
    """Return the routines, the one to follow (that of the program's name, else the first), and faults of bounds."""
    other_lines = np.flatnonzero(plain.others(len(source.starts))) + 1
    by_name, faults = routines(source, other_lines.tolist(), plain.moving, plain.settings.line.tolist())
    module = Module(source, by_name)
    main = module.main(name)
    if main is None and faults:
        raise combined_error(faults)
    if main is None:
        raise ProgramError(
            "there is no DEF", file=source.document.name, line=1, advice="Check that this is a KRL program."
        )
    return module, main, faults


def _folders(document: Document, cell: Cell) -> list[Path]:
    """Return the folders searched for called programs: that of the program, then those of the cell."""
    own_folders = [Path(document.folder)] if document.folder else []
    return own_folders + [Path(cell.folder) / folder for folder in cell.krl.search]


def _check_size(trace: Trace, rows: MotionColumns) -> None:
    """Refuse coordinates that no robot reaches."""
    (is_too_far,) = in_chunks(
        lambda numbers, via: (
            any_column(np.abs(numbers) > LARGEST_COORDINATE) | any_column(np.abs(via) > LARGEST_COORDINATE),
        ),
        rows.numbers,
        rows.via,
    )
    if is_too_far.any():
        row = int(np.argmax(is_too_far))
        largest = max(float(np.nanmax(np.abs(values[row]), initial=0.0)) for values in (rows.numbers, rows.via))
        raise out_of_reach(trace.place(int(rows.line[row])), largest)


def _check_starts(main: MainRoutine, sequence: OrderedMotions) -> None:
    """Refuse a motion that begins where a called program has left the robot, unless it goes to joint angles."""
    for line, reason in () if main.run.keep else main.run.stops:
        row = int(np.searchsorted(sequence.rows.line, line))
        if row < len(sequence.rows) and needs_start(sequence, row):
            raise reason
    for call in () if main.run.keep else main.run.moved:
        row = int(np.searchsorted(sequence.rows.line, call.row))
        if row < len(sequence.rows):
            move = sequence.moves.get(row)
            position = move.end.position if move is not None and not move.relative else None
            if position is None or not position.axis or not position.complete:
                raise call.reason
