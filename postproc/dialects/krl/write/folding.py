"""From the corrected execution trace of a program back to its files.

The trace has the lines in execution order, with loops unrolled and called routines inlined. A loop whose rounds all
have equal corrections stays a loop; otherwise its rounds are written out. A routine whose calls all have equal
corrections is corrected in place; otherwise further calls get copies of it under new names.

Corrections are compared by numbers: equal new texts of a line have one number (`EditedRows.text_numbers`). The changes
of a body, which is one round of a loop or one run of a routine, are its changed lines with these numbers. Bodies of one
loop or routine with equal changes have equal text, which is made only once.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from postproc.chunks import ragged_range
from postproc.dialects.krl.execution import Body, Execution, InlinedRoutine, UnrolledLoop
from postproc.dialects.krl.language.names import Names
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.routines import Routine
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import indent, names_in
from postproc.dialects.krl.language.tree import Definition
from postproc.dialects.krl.write.edited_rows import EditedRows, line_count, line_text
from postproc.errors import Issue
from postproc.program import Bools, Document, Ints

_Changes = tuple[tuple[int, object], ...]
"""Changed lines of a body, each with the number of its new text, or with the changes of the loop or call that begins on
it; empty without changes.
"""


class FoldedProgram(Struct, frozen=True):
    """The files of a program, and the lines on which the L rows of its trace (lines in execution order) now are.

    :ivar documents: the `.src`, then changed files of routines that it calls.
    :ivar line: (L + 1,) line of the `.src` on which each row of the trace (from 1) now begins; for rows in other files,
        the line of the call.
    :ivar is_in_main: (L + 1,) True where the row is in the `.src`.
    :ivar issues: warnings for the user.
    """

    documents: tuple[Document, ...]
    line: Ints
    is_in_main: Bools
    issues: tuple[Issue, ...]


def fold(execution: Execution, main: Routine, new_rows: EditedRows) -> FoldedProgram:
    """Return the files of a program whose execution trace (its lines in execution order) was corrected.

    :param main: the main routine of the program.
    :param new_rows: the edited rows of the trace, and their texts.
    """
    return _Folder(execution, main, new_rows).fold()


class _WrittenLines(NamedTuple):
    """Consecutive lines of a written file.

    :ivar line_count: number of lines.
    :ivar content: in order, texts, and (first, stop) for the corrected rows first … stop − 1 of the trace.
    :ivar places: where rows of the trace are: (n, first, stop) if row `first` begins on line n of these lines, from 0,
        and rows up to stop − 1 follow it. Lines that run several times are the place of several rows.
    """

    line_count: int
    content: Sequence[str | tuple[int, int]]
    places: Sequence[tuple[int, int, int]] = ()


class _Version(Struct, eq=False):
    """A text of a routine, and the name under which it is written: calls with other corrections need other versions.

    :ivar lines: the lines between DEF and END; None until they are made.
    :ivar places: places of the rows of all calls of this version, see `_WrittenLines`.
    :ivar is_called_outside: whether another file than that of the routine calls it.
    """

    name: str
    lines: _WrittenLines | None = None
    places: list[tuple[int, int, int]] = []
    is_called_outside: bool = False


class _Folder(Struct, eq=False):
    """Writes the corrected trace of a program back to its files.

    :ivar edited: the edited rows of the trace.
    :ivar versions: routine → changes of its body → version; the first version keeps the name of the routine.
    :ivar names: names in use; None until a new name is needed.
    :ivar outside_calls: calls of routines in other files than the `.src`.
    """

    execution: Execution
    main: Routine
    edited: EditedRows
    versions: defaultdict[Routine, dict[_Changes, _Version]] = field(default_factory=lambda: defaultdict(dict))
    names: Names | None = None
    outside_calls: list[InlinedRoutine] = []
    issues: list[Issue] = []
    _changes_of_body: dict[Body, _Changes] = {}
    _version_of_call: dict[InlinedRoutine, _Version] = {}

    def fold(self) -> FoldedProgram:
        """Return the files of the program: the main file, and other files whose text changes."""
        changes = self._body_changes(self.execution.body)  # chooses the versions of all called routines
        body = self._body_lines(self.execution.body)
        self.versions[self.main][changes] = _Version(self.main.name, lines=body, places=[*body.places])
        sources = dict.fromkeys([self.main.source, *(routine.source for routine in self.versions)])  # each once
        file_of = {source: _concatenate(self._file_lines(source)) for source in sources}
        line, is_in_main = self._lines_in_main(file_of[self.main.source])
        documents = []
        for source, file in file_of.items():
            text = self._text(file)
            if source is self.main.source or text != source.text:
                documents.append(replace(source.document, text=text))
                self._warn_of_other_callers(source)
        return FoldedProgram(tuple(documents), line, is_in_main, tuple(self.issues))

    def _lines_in_main(self, file: _WrittenLines) -> tuple[Ints, Bools]:
        """Return the line (L + 1,) of the `.src` on which each row begins, and whether the row is in it (L + 1,).

        Rows are those of the trace, the lines of the program in execution order. Rows of routines in other files have
        the line of their call. Rows count from 1; element 0 is unused.

        :param file: the whole `.src`.
        """
        begins = self.edited.begins  # element k: number of lines of the corrected trace before row k + 1
        line = np.zeros(len(begins), dtype=np.int64)
        is_in_main = np.zeros(len(begins), dtype=np.bool_)
        # each place: number of lines before it in the file, its first row, the row behind its last; there may be none
        lines_before, first, stop = np.array(file.places, dtype=np.int64).reshape(-1, 3).T
        row_count = stop - first
        rows = ragged_range(row_count, first)
        # line of the file minus number of lines before it in the corrected trace: constant within each place
        shift = 1 + lines_before - begins[first - 1]
        line[rows] = np.repeat(shift, row_count) + begins[rows - 1]
        is_in_main[rows] = True
        for call in self.outside_calls:
            called_lines = line[call.body.first : call.body.stop]  # a view: the assignment changes `line`
            called_lines[called_lines == 0] = line[call.row]  # 0: not in the `.src`
        return line, is_in_main

    def _warn_of_other_callers(self, source: Source) -> None:
        """Add a warning for each other program of the folders that calls routines of a changed file.

        The subject of such a warning is the file and the program, with a comma between them.
        """
        name = source.document.name
        for caller in self.execution.other_callers.get(name, ()):
            message = (
                f"{name} is corrected for this program. {caller} of its folders calls it too, and would move by the "
                f"correction made here: give it a {name} of its own."
            )
            self.issues.append(Issue("warning", "shared-file", message, subject=f"{name}, {caller}"))

    # --- changes -----------------------------------------------------------------------------------------------------

    def _body_changes(self, body: Body) -> _Changes:
        """Return the changes of a body: its changed lines with the numbers of their new texts. The result is stored.

        A body is one round of a loop, or one run of a routine. Assignments to the counter of a FOR do not count as
        changes: they differ in all rounds.
        """
        if body in self._changes_of_body:
            return self._changes_of_body[body]
        changes: list[tuple[int, object]] = []
        row = body.first
        for structure in body.loops_and_calls:
            if isinstance(structure, InlinedRoutine):
                begin, stop, inner_changes = structure.row, structure.body.stop, self._call_changes(structure)
            else:
                begin, stop, inner_changes = structure.first, structure.stop, self._loop_changes(structure)
            self._add_changes(changes, row, begin)
            if inner_changes:
                changes.append((self._line_of_row(begin), inner_changes))
            row = stop
        self._add_changes(changes, row, body.stop)
        result = self._changes_of_body[body] = tuple(changes)
        return result

    def _add_changes(self, changes: list[tuple[int, object]], first: int, stop: int) -> None:
        """Append, of changed rows among rows first … stop − 1 of the trace, the line and the number of the new text."""
        numbers = self.edited.text_numbers[first - 1 : stop - 1]  # rows count from 1
        changes += [(self._line_of_row(row), number) for row, number in enumerate(numbers, first) if number]
        # 0: unchanged

    def _line_of_row(self, row: int) -> int:
        """Return the line in its file of a row of the trace (of the lines in execution order)."""
        return self.execution.trace.line.item(row - 1)

    def _loop_changes(self, loop: UnrolledLoop) -> object:
        """Return the changes in a loop, in a form that is equal for two runs of a loop if their written lines are.

        - Rounds with equal changes: the changes of one round. No rounds: those of the lines of the loop.
        - Rounds with different changes, which are written out: the value of the counter behind the loop (None if it is
          not set there), then the value of the counter in each round and the changes of the round. Information for the
          user is added to `issues`.
        """
        round_changes = [self._body_changes(body) for body in loop.bodies]
        if all(changes == round_changes[0] for changes in round_changes):
            return round_changes[0] if round_changes else self._changes_of_lines(loop)
        head = loop.opener.strip()
        message = f"The rounds of {head} are corrected differently: they are written out, but for those that are alike."
        line = self.execution.trace.reported_line(loop.first)
        self.issues.append(Issue("info", "loop-written-out", message, line, subject=f"{head} {line}"))
        end = self.execution.counter_value(loop, loop.bodies[-1].stop) if self._sets_counter_behind(loop) else None
        return ("rounds", end, *zip(self._counter_values(loop), round_changes, strict=True))

    def _sets_counter_behind(self, loop: UnrolledLoop) -> bool:
        """Return whether the trace assigns the counter of a FOR once more behind its last round, as controllers do."""
        return loop.is_for and loop.stop > loop.bodies[-1].stop

    def _changes_of_lines(self, loop: UnrolledLoop) -> _Changes:
        """Return the changes in the lines of a loop without rounds."""
        changes: list[tuple[int, object]] = []
        self._add_changes(changes, loop.first, loop.stop)
        return tuple(changes)

    def _call_changes(self, call: InlinedRoutine) -> object:
        """Return the changes on the line of a call: number of its new text, and new name of the routine.

        Empty if neither changes.
        """
        version = self._version(call)
        new_name = "" if version.name == call.routine.name else version.name
        text_number = self.edited.text_numbers[call.row - 1]  # 0: unchanged; rows count from 1
        return (text_number, new_name) if text_number or new_name else ()

    def _version(self, call: InlinedRoutine) -> _Version:
        """Return the version (text and name) of a routine that a call needs, and store it for the call.

        The first version keeps the name of the routine; a version with other changes is a copy with a new name. If the
        routine must not change (calls that are not followed reach it too), the first version is its unchanged text.
        """
        versions, routine = self.versions[call.routine], call.routine
        changes = self._body_changes(call.body)
        if routine in self.execution.unchanged_routines and not versions:
            text = routine.source.lines_text(routine.first + 1, routine.last - 1)  # between DEF and END
            no_changes = ()
            versions[no_changes] = _Version(routine.name, lines=_text_lines(text))
        if changes not in versions:
            versions[changes] = _Version(self._name_of_copy(call) if versions else routine.name)
        version = self._version_of_call[call] = versions[changes]
        version.is_called_outside |= self.execution.trace.source(call.row) is not routine.source
        return version

    def _counter_values(self, loop: UnrolledLoop) -> list[int]:
        """Return the value of the counter of a FOR in each round; zeros for other loops."""
        return [self.execution.counter_value(loop, body.first) if loop.is_for else 0 for body in loop.bodies]

    # --- bodies ------------------------------------------------------------------------------------------------------

    def _body_lines(self, body: Body, begin: int = 0) -> _WrittenLines:
        """Return the corrected lines of a body: of one round of a loop, or one run of a routine.

        :param begin: first row of the trace (line in execution order) to write; 0: the first row of the body.
        """
        written_lines, row = [], begin or body.first
        for structure in body.loops_and_calls:
            if isinstance(structure, InlinedRoutine):
                written_lines += [self._row_lines(row, structure.row), self._call_line(structure)]
                row = structure.body.stop
            else:
                written_lines += [self._row_lines(row, structure.first), self._loop_lines(structure)]
                row = structure.stop
        remaining_lines = self._row_lines(row, body.stop)
        return _concatenate([*written_lines, remaining_lines]) if written_lines else remaining_lines

    def _row_lines(self, first: int, stop: int) -> _WrittenLines:
        """Return the corrected rows first … stop − 1 of the trace (lines in execution order) as written lines.

        They must be consecutive lines of a file.
        """
        if stop <= first:
            return _WrittenLines(0, ())
        begins = self.edited.begins  # lines that are written before each row; rows count from 1
        count = int(begins[stop - 1] - begins[first - 1])
        return _WrittenLines(count, content=((first, stop),), places=((0, first, stop),))

    def _counter_line(self, loop: UnrolledLoop, row: int, blanks: str) -> _WrittenLines:
        """Return a new line that assigns the counter of a FOR the value that a row of the trace assigns it.

        The trace has the lines in execution order, and a row for the counter of each round.

        :param blanks: indentation of the line.
        """
        text = f"{blanks}{loop.counter}={self.execution.counter_value(loop, row)}{_line_end(loop.opener)}"
        return _WrittenLines(1, content=(text,), places=((0, row, row + 1),))

    def _loop_lines(self, loop: UnrolledLoop) -> _WrittenLines:
        """Return the corrected lines of a loop.

        It stays a loop if all rounds have equal corrections. Otherwise its rounds are written one after the other.
        """
        # rows that assign the counter of a FOR are in no file: one before each round, and one behind the last round
        counter_rows = 1 if loop.is_for else 0
        if not loop.bodies:
            return self._row_lines(loop.first, loop.stop - counter_rows)
        round_changes = [self._body_changes(body) for body in loop.bodies]
        rounds = [self._body_lines(body, body.first + counter_rows) for body in loop.bodies]
        if all(changes == round_changes[0] for changes in round_changes):
            return _concatenate([_text_lines(loop.opener), _merge_rounds(rounds), _text_lines(loop.closer)])
        return _concatenate(self._unrolled_lines(loop, round_changes, rounds))

    def _unrolled_lines(
        self, loop: UnrolledLoop, round_changes: Sequence[_Changes], rounds: Sequence[_WrittenLines]
    ) -> Iterator[_WrittenLines]:
        """Yield the lines of a loop that is written out; runs of rounds with equal corrections become loops.

        If the loop has EXIT, a LOOP of one round is put around its rounds, so that EXIT still leaves them.

        :param round_changes: changes in each round.
        :param rounds: lines of each round.
        """
        blanks, end = indent(loop.opener), _line_end(loop.opener)
        yield _text_lines(f"{blanks}; {loop.opener.strip()} (written out){end}")
        if loop.has_exit:
            yield _text_lines(f"{blanks}LOOP{end}")
        begins = _run_begins(round_changes, self._counter_values(loop), loop.step)
        for first, stop in pairwise([*begins, len(rounds)]):
            yield from self._equal_rounds(loop, first, rounds[first:stop])
        if self._sets_counter_behind(loop):
            yield self._counter_line(loop, loop.bodies[-1].stop, blanks)
        else:  # rows of the loop behind its last round, such as the evaluation of its condition
            yield self._row_lines(loop.bodies[-1].stop, loop.stop)
        if loop.has_exit:
            yield _text_lines(f"{blanks}EXIT{end}{blanks}ENDLOOP{end}")

    def _equal_rounds(self, loop: UnrolledLoop, first: int, rounds: Sequence[_WrittenLines]) -> Iterator[_WrittenLines]:
        """Yield the lines of consecutive rounds with equal corrections.

        Several rounds of a FOR without EXIT become a new FOR; all other rounds are written one after the other.

        :param first: number of the first of these rounds, from 0.
        """
        blanks, end = indent(loop.opener), _line_end(loop.opener)
        bodies, is_for = loop.bodies[first : first + len(rounds)], loop.is_for
        if len(rounds) == 1 or not is_for or loop.has_exit:
            for body, round_lines in zip(bodies, rounds, strict=True):
                if is_for:
                    yield self._counter_line(loop, body.first, blanks)
                yield round_lines
            return
        begin, last = (self.execution.counter_value(loop, body.first) for body in (bodies[0], bodies[-1]))
        step = "" if loop.step == 1 else f" STEP {loop.step}"
        yield _text_lines(f"{blanks}FOR {loop.counter}={begin} TO {last}{step}{end}")
        yield _merge_rounds(rounds)
        yield _text_lines(loop.closer)

    def _call_line(self, call: InlinedRoutine) -> _WrittenLines:
        """Return the line of a call, with the name of the version that it calls.

        Add the places of the called rows to the version, and its lines if it has none. Add a call of a routine in
        another file to `outside_calls`: its rows are reported at the call.
        """
        body, version = self._body_lines(call.body), self._version_of_call[call]
        if version.lines is None:
            version.lines = body
        version.places.extend(body.places)
        call_line = self._row_lines(call.row, call.row + 1)
        if call.routine.source is not self.main.source:
            self.outside_calls.append(call)
        if version.name == call.routine.name:
            return call_line
        text, (source, line) = self._text(call_line), self.execution.trace.place(call.row)
        # span of the name in the line; `call.name` is its span in the file
        start, stop = (offset - source.starts.item(line - 1) for offset in call.name)
        return call_line._replace(content=(text[:start] + version.name + text[stop:],))

    # --- routines ----------------------------------------------------------------------------------------------------

    def _used_names(self) -> Names:
        """Return all names that the program and its files use: no copy of a routine may have them."""
        sources = dict.fromkeys([*self.execution.trace.sources, *(routine.source for routine in self.versions)])
        names_by_file = (names_in(source.text) for source in sources)
        return Names(set(self.execution.used_names).union(*names_by_file))

    def _name_of_copy(self, call: InlinedRoutine) -> str:
        """Return a new name for the copy of a routine that a call gets; add the reason for the copy to `issues`."""
        if self.names is None:
            self.names = self._used_names()
        routine = call.routine
        head = statement(routine.source, routine.first)
        spelling = head.name if isinstance(head, Definition) else routine.name  # as its file writes it
        name = self.names.unused_name(spelling)
        reason = "is corrected differently from call to call"
        if routine in self.execution.unchanged_routines:
            reason = "is also called where calls are not followed, and stays as it is there"
        message = f"{spelling}() {reason}: this one calls its copy {name}()."
        line = self.execution.trace.reported_line(call.row)
        self.issues.append(Issue("info", "routine-copied", message, line, subject=name))
        return name

    def _file_lines(self, source: Source) -> Iterator[_WrittenLines]:
        """Yield the lines of a file: its corrected routines, each followed by its copies, and all lines between.

        The first version of a routine keeps its name and its lines DEF and END; the others are its copies.
        """
        next_line = 1
        for routine in sorted(self.versions, key=lambda routine: routine.first):
            if routine.source is source:
                yield _text_lines(source.lines_text(next_line, routine.first))
                original, *copies = self.versions[routine].values()
                yield _version_lines(original)
                yield _text_lines(line_text(source, routine.last))
                for version in copies:
                    yield from self._copy_lines(routine, version)
                next_line = routine.last + 1
        yield _text_lines(source.lines_text(next_line, len(source.starts)))

    def _copy_lines(self, routine: Routine, version: _Version) -> Iterator[_WrittenLines]:
        """Yield the lines of a copy of a routine, from the empty line before it to its END."""
        line_end, end_text = (
            _line_end(line_text(routine.source, routine.first)),
            line_text(routine.source, routine.last),
        )
        lacks_line_end = not _line_end(end_text)  # END is the last line of the file
        yield _text_lines(line_end + line_end if lacks_line_end else line_end)
        yield _text_lines(self._definition_line(routine, version))
        yield _version_lines(version)
        yield _text_lines(end_text + line_end if lacks_line_end else end_text)

    def _definition_line(self, routine: Routine, version: _Version) -> str:
        """Return the DEF line of a copy of a routine: GLOBAL if another file calls it."""
        source, text = routine.source, line_text(routine.source, routine.first)
        definition, begin = statement(source, routine.first), int(source.starts[routine.first - 1])
        if not isinstance(definition, Definition):
            return text
        start, name_start = definition.start - begin, definition.name_start - begin
        prefix = "GLOBAL " if version.is_called_outside and not definition.is_global else ""
        return (
            f"{text[:start]}{prefix}{text[start:name_start]}{version.name}{text[name_start + len(definition.name) :]}"
        )

    # --- text --------------------------------------------------------------------------------------------------------

    def _text(self, lines: _WrittenLines) -> str:
        """Return the text of written lines."""
        return "".join(item if isinstance(item, str) else self._text_of_rows(*item) for item in lines.content)

    def _text_of_rows(self, first: int, stop: int) -> str:
        """Return the corrected text of rows first … stop − 1 of the trace (lines in execution order).

        They are consecutive lines of a file.
        """
        source, line = self.execution.trace.place(first)
        shift = line - first  # from a row to its line in the file
        edited = slice(*np.searchsorted(self.edited.rows, [first, stop]).tolist())  # those of the edited rows
        texts: list[str] = []
        next_row = first
        for row, new_text in zip(self.edited.rows[edited].tolist(), self.edited.texts[edited], strict=True):
            texts += [source.lines_text(next_row + shift, row + shift - 1), new_text]  # unchanged lines before it
            next_row = row + 1
        return "".join([*texts, source.lines_text(next_row + shift, stop + shift - 1)])


def _run_begins(round_changes: Sequence[_Changes], counter_values: Sequence[int], step: int) -> list[int]:
    """Return the numbers, from 0, of the first rounds of runs: consecutive rounds that one new loop can replace.

    In a run all rounds have equal changes, and the counter increases by `step` from round to round.

    :param round_changes: changes in each round.
    :param counter_values: value of the counter in each round.
    """
    begins = [0]
    for number in range(1, len(round_changes)):
        has_equal_changes = round_changes[number] == round_changes[number - 1]
        if not has_equal_changes or counter_values[number] != counter_values[number - 1] + step:
            begins.append(number)
    return begins


def _text_lines(text: str) -> _WrittenLines:
    """Return the lines of a text that contains no rows of the trace."""
    return _WrittenLines(line_count(text), (text,))


def _version_lines(version: _Version) -> _WrittenLines:
    """Return the lines of a version, with the places of the rows of all its calls."""
    lines = version.lines or _text_lines("")
    return lines._replace(places=version.places)


def _concatenate(blocks: Iterable[_WrittenLines]) -> _WrittenLines:
    """Return blocks of lines that follow each other as one block."""
    content, places, count = list[str | tuple[int, int]](), list[tuple[int, int, int]](), 0
    for lines in blocks:
        content += lines.content
        places += [(count + line, first, stop) for line, first, stop in lines.places]
        count += lines.line_count
    return _WrittenLines(count, content, places)


def _merge_rounds(rounds: Sequence[_WrittenLines]) -> _WrittenLines:
    """Return the lines of rounds with equal text: the lines of the first, with the places of the rows of all rounds."""
    return rounds[0]._replace(places=[place for lines in rounds for place in lines.places])


def _line_end(text: str) -> str:
    """Return the CR and LF at the end of a text; empty without a line end."""
    return text[len(text.rstrip("\r\n")) :]
