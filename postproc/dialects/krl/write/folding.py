"""From the corrected execution trace of a program back to its files.

A loop whose rounds all have equal corrections stays a loop; otherwise its rounds are written out. A routine whose calls
all have equal corrections is corrected in place; otherwise further calls get copies of it under new names.

Corrections are compared by keys. Each new text of a row has a number; the key of a body lists its changed lines with
these numbers. Bodies with equal keys have equal text, which is made only once.
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

_Key = tuple[tuple[int, object], ...]
"""Changed lines of a body, each with the number of its new text or the key of its part; empty without changes."""


class FoldedProgram(Struct, frozen=True):
    """The files of a program.

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
    """Return the files of a program whose execution trace was corrected.

    :param main: the main routine of the program.
    :param new_rows: the edited rows of the trace, and their texts.
    """
    return _Folder(execution, main, new_rows).fold()


class _Piece(NamedTuple):
    """Lines of a written file.

    :ivar line_count: number of lines.
    :ivar content: in order, texts, and (first, last) for the corrected rows first … last − 1 of the trace.
    :ivar places: (n, first, last): row `first` of the trace begins on line n of the piece, from 0; rows up to last − 1
        follow it.
    """

    line_count: int
    content: Sequence[str | tuple[int, int]]
    places: Sequence[tuple[int, int, int]] = ()


class _Version(Struct, eq=False):
    """A text of a routine, and the name under which it is written.

    :ivar piece: its lines; None until they are made.
    :ivar places: places of the rows of all calls of this version, see `_Piece.places`.
    :ivar is_called_outside: whether another file than that of the routine calls it.
    """

    name: str
    piece: _Piece | None = None
    places: list[tuple[int, int, int]] = []
    is_called_outside: bool = False


class _Folder(Struct, eq=False):
    """Writes the corrected trace of a program back to its files.

    :ivar edited: the edited rows of the trace.
    :ivar versions: routine → key of its changes → version; the first version keeps the name of the routine.
    :ivar names: names in use; None until a new name is needed.
    :ivar outside_calls: calls of routines in other files than the `.src`.
    """

    execution: Execution
    main: Routine
    edited: EditedRows
    versions: defaultdict[Routine, dict[_Key, _Version]] = field(default_factory=lambda: defaultdict(dict))
    names: Names | None = None
    outside_calls: list[InlinedRoutine] = []
    issues: list[Issue] = []
    _keys: dict[Body, _Key] = {}
    _calls: dict[InlinedRoutine, _Version] = {}

    def fold(self) -> FoldedProgram:
        """Return the files of the program: the main file, and other files whose text changes."""
        key = self._body_key(self.execution.body)
        body = self._body_piece(self.execution.body)
        self.versions[self.main][key] = _Version(self.main.name, body, [*body.places])
        sources = dict.fromkeys([self.main.source, *(routine.source for routine in self.versions)])
        file_of = {source: _concatenate(self._file_pieces(source)) for source in sources}
        line, is_in_main = self._lines_in_main(file_of[self.main.source])
        documents = []
        for source, file in file_of.items():
            text = self._text(file)
            if source is self.main.source or text != source.text:
                documents.append(replace(source.document, text=text))
                self._warn_of_other_callers(source)
        return FoldedProgram(tuple(documents), line, is_in_main, tuple(self.issues))

    def _lines_in_main(self, file: _Piece) -> tuple[Ints, Bools]:
        """Return the line (L + 1,) of the `.src` on which each row begins, and whether the row is in it (L + 1,).

        Rows of routines in other files have the line of their call. Rows count from 1; element 0 is unused.

        :param file: the whole `.src`.
        """
        begins = self.edited.begins  # number of lines of the corrected trace before row k + 1
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
            called_lines[called_lines == 0] = line[call.row]
        return line, is_in_main

    def _warn_of_other_callers(self, source: Source) -> None:
        """Add a warning for each other program of the folders that calls routines of a changed file.

        Their subject is the file and the program, with a comma between them.
        """
        name = source.document.name
        for caller in self.execution.other_callers.get(name, ()):
            message = (
                f"{name} is corrected for this program. {caller} of its folders calls it too, and would move by the "
                f"correction made here: give it a {name} of its own."
            )
            self.issues.append(Issue("warning", "shared-file", message, subject=f"{name}, {caller}"))

    # --- keys --------------------------------------------------------------------------------------------------------

    def _body_key(self, body: Body) -> _Key:
        """Return the key of the changes in a body; bodies with equal keys have equal text. The result is stored.

        Assignments to the counter of a FOR do not count as changes.
        """
        key = self._keys.get(body)
        if key is None:
            changes: list[tuple[int, object]] = []
            row = body.first
            for part in body.loops_and_calls:
                part_begin, part_end = (
                    (part.row, part.body.stop) if isinstance(part, InlinedRoutine) else (part.first, part.stop)
                )
                self._add_changes(changes, row, part_begin)
                change = self._call_key(part) if isinstance(part, InlinedRoutine) else self._loop_key(part)
                if change:
                    changes.append((self._line_of_row(part_begin), change))
                row = part_end
            self._add_changes(changes, row, body.stop)
            key = self._keys[body] = tuple(changes)
        return key

    def _add_changes(self, changes: list[tuple[int, object]], first: int, stop: int) -> None:
        """Append to `changes` the line and the key of each changed row among rows first … stop − 1 of the trace."""
        keys = self.edited.keys[first - 1 : stop - 1]  # rows count from 1
        changes += [(self._line_of_row(row), key) for row, key in enumerate(keys, first) if key]  # 0: unchanged

    def _line_of_row(self, row: int) -> int:
        """Return the line of a row of the trace in its file."""
        return self.execution.trace.line.item(row - 1)

    def _loop_key(self, loop: UnrolledLoop) -> object:
        """Return the key of the changes in a loop.

        - Rounds with equal changes: the key of one round. No rounds: the key of the lines of the loop.
        - Rounds with different changes: the value of the counter behind the loop (None if it is not set there), then
          the value of the counter in each round and the key of the round. Information for the user is added to
          `issues`.
        """
        keys = [self._body_key(body) for body in loop.bodies]
        if all(key == keys[0] for key in keys):
            return keys[0] if keys else self._key_of_lines(loop)
        head = loop.opener.strip()
        message = f"The rounds of {head} are corrected differently: they are written out, but for those that are alike."
        line = self.execution.trace.reported_line(loop.first)
        self.issues.append(Issue("info", "loop-written-out", message, line, subject=f"{head} {line}"))
        end = self.execution.counter_value(loop, loop.bodies[-1].stop) if self._sets_counter(loop) else None
        return ("rounds", end, *zip(self._counter_values(loop), keys, strict=True))

    def _sets_counter(self, loop: UnrolledLoop) -> bool:
        """Return whether the trace assigns the counter of a FOR once more behind its last round."""
        return loop.step != 0 and loop.stop > loop.bodies[-1].stop

    def _key_of_lines(self, loop: UnrolledLoop) -> _Key:
        """Return the key of the changes in the lines of a loop without rounds."""
        changes: list[tuple[int, object]] = []
        self._add_changes(changes, loop.first, loop.stop)
        return tuple(changes)

    def _call_key(self, call: InlinedRoutine) -> object:
        """Return the key of the changes on the line of a call: number of its new text, and new name of the routine.

        Empty if neither changes.
        """
        version = self._version(call)
        name = "" if version.name == call.routine.name else version.name
        key = self.edited.keys[call.row - 1]
        return (key, name) if key or name else ()

    def _version(self, call: InlinedRoutine) -> _Version:
        """Return the version of a routine that a call needs, and store it for the call.

        The first version keeps the name of the routine; a version with other changes is a copy with a new name. If the
        routine must not change, the first version is its unchanged text.
        """
        versions, routine = self.versions[call.routine], call.routine
        key = self._body_key(call.body)
        if routine in self.execution.unchanged_routines and not versions:
            text = routine.source.lines_text(routine.first + 1, routine.last - 1)
            versions[()] = _Version(routine.name, _Piece(line_count(text), (text,)))
        if key not in versions:
            versions[key] = _Version(self._name_of_copy(call) if versions else routine.name)
        version = self._calls[call] = versions[key]
        version.is_called_outside |= self.execution.trace.place(call.row)[0] is not routine.source
        return version

    def _counter_values(self, loop: UnrolledLoop) -> list[int]:
        """Return the value of the counter of a FOR in each round; zeros for other loops."""
        return [self.execution.counter_value(loop, body.first) if loop.step != 0 else 0 for body in loop.bodies]

    # --- bodies ------------------------------------------------------------------------------------------------------

    def _body_piece(self, body: Body, begin: int = 0) -> _Piece:
        """Return the corrected lines of a body.

        :param begin: first row of the trace to write; 0: the first row of the body.
        """
        pieces, row = [], begin or body.first
        for part in body.loops_and_calls:
            if isinstance(part, InlinedRoutine):
                pieces += [self._rows_piece(row, part.row), self._call_piece(part)]
                row = part.body.stop
            else:
                pieces += [self._rows_piece(row, part.first), self._loop_piece(part)]
                row = part.stop
        remaining_lines = self._rows_piece(row, body.stop)
        return _concatenate([*pieces, remaining_lines]) if pieces else remaining_lines

    def _rows_piece(self, first: int, last: int) -> _Piece:
        """Return the corrected rows first … last − 1 of the trace, which must be consecutive lines of a file."""
        if last <= first:
            return _Piece(0, ())
        begins = self.edited.begins
        count = int(begins[last - 1] - begins[first - 1])
        return _Piece(count, content=((first, last),), places=((0, first, last),))

    def _counter_piece(self, loop: UnrolledLoop, row: int, blanks: str) -> _Piece:
        """Return a new line that assigns the counter of a FOR the value that a row of the trace assigns it.

        :param blanks: indentation of the line.
        """
        text = f"{blanks}{loop.counter}={self.execution.counter_value(loop, row)}{_line_end(loop.opener)}"
        return _Piece(1, content=(text,), places=((0, row, row + 1),))

    def _loop_piece(self, loop: UnrolledLoop) -> _Piece:
        """Return the corrected lines of a loop.

        It stays a loop if all rounds have equal corrections. Otherwise its rounds are written one after the other.
        """
        # rows that assign the counter of a FOR are in no file: one before each round, and one behind the last round
        counter_rows = int(loop.step != 0)
        if not loop.bodies:
            return self._rows_piece(loop.first, loop.stop - counter_rows)
        keys = [self._body_key(body) for body in loop.bodies]
        rounds = [self._body_piece(body, body.first + counter_rows) for body in loop.bodies]
        if all(key == keys[0] for key in keys):
            return _concatenate([_text_piece(loop.opener), _merge_rounds(rounds), _text_piece(loop.closer)])
        return _concatenate(self._unrolled_pieces(loop, keys, rounds))

    def _unrolled_pieces(self, loop: UnrolledLoop, keys: Sequence[_Key], rounds: Sequence[_Piece]) -> Iterator[_Piece]:
        """Yield the lines of a loop that is written out; runs of rounds with equal corrections become loops.

        If the loop has EXIT, a LOOP of one round is put around its rounds, so that EXIT still leaves them.

        :param keys: key of the changes in each round.
        :param rounds: lines of each round.
        """
        blanks, end = indent(loop.opener), _line_end(loop.opener)
        yield _text_piece(f"{blanks}; {loop.opener.strip()} (written out){end}")
        if loop.has_exit:
            yield _text_piece(f"{blanks}LOOP{end}")
        for first, stop in pairwise([*_run_begins(keys, self._counter_values(loop), loop.step), len(rounds)]):
            yield from self._equal_rounds(loop, first, rounds[first:stop])
        if self._sets_counter(loop):
            yield self._counter_piece(loop, loop.bodies[-1].stop, blanks)
        else:  # rows of the loop behind its last round, such as the evaluation of its condition
            yield self._rows_piece(loop.bodies[-1].stop, loop.stop)
        if loop.has_exit:
            yield _text_piece(f"{blanks}EXIT{end}{blanks}ENDLOOP{end}")

    def _equal_rounds(self, loop: UnrolledLoop, first: int, rounds: Sequence[_Piece]) -> Iterator[_Piece]:
        """Yield the lines of consecutive rounds with equal corrections.

        Several rounds of a FOR without EXIT become a new FOR; all other rounds are written one after the other.

        :param first: number of the first of these rounds, from 0.
        """
        blanks, end = indent(loop.opener), _line_end(loop.opener)
        bodies, is_for = loop.bodies[first : first + len(rounds)], loop.step != 0
        if len(rounds) == 1 or not is_for or loop.has_exit:
            for body, piece in zip(bodies, rounds, strict=True):
                if is_for:
                    yield self._counter_piece(loop, body.first, blanks)
                yield piece
            return
        begin, last = (self.execution.counter_value(loop, body.first) for body in (bodies[0], bodies[-1]))
        step = "" if loop.step == 1 else f" STEP {loop.step}"
        yield _text_piece(f"{blanks}FOR {loop.counter}={begin} TO {last}{step}{end}")
        yield _merge_rounds(rounds)
        yield _text_piece(loop.closer)

    def _call_piece(self, call: InlinedRoutine) -> _Piece:
        """Return the line of a call, with the name of the version that it calls.

        Add the places of the called rows to the version, and its lines if it has none. Add a call of a routine in
        another file to `outside_calls`.
        """
        body, version = self._body_piece(call.body), self._calls[call]
        if version.piece is None:
            version.piece = body
        version.places.extend(body.places)
        line = self._rows_piece(call.row, call.row + 1)
        if call.routine.source is not self.main.source:
            self.outside_calls.append(call)
        if version.name == call.routine.name:
            return line
        text, (source, number) = self._text(line), self.execution.trace.place(call.row)
        # span of the name in the line; `call.name` is its span in the file
        start, stop = (offset - source.starts.item(number - 1) for offset in call.name)
        return line._replace(content=(text[:start] + version.name + text[stop:],))

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

    def _file_pieces(self, source: Source) -> Iterator[_Piece]:
        """Yield the pieces of a file: its corrected routines, each followed by its copies, and all lines between.

        The first version of a routine keeps its name and its lines DEF and END; the others are its copies.
        """
        next_line = 1
        for routine in sorted(self.versions, key=lambda routine: routine.first):
            if routine.source is source:
                yield _text_piece(source.lines_text(next_line, routine.first))
                original, *copies = self.versions[routine].values()
                yield _version_piece(original)
                yield _text_piece(line_text(source, routine.last))
                for version in copies:
                    yield from self._copy_pieces(routine, version)
                next_line = routine.last + 1
        yield _text_piece(source.lines_text(next_line, len(source.starts)))

    def _copy_pieces(self, routine: Routine, version: _Version) -> Iterator[_Piece]:
        """Yield the lines of a copy of a routine, from the empty line before it to its END."""
        line_end, end_text = (
            _line_end(line_text(routine.source, routine.first)),
            line_text(routine.source, routine.last),
        )
        lacks_line_end = not _line_end(end_text)  # END is the last line of the file
        yield _text_piece(line_end + line_end if lacks_line_end else line_end)
        yield _text_piece(self._definition_line(routine, version))
        yield _version_piece(version)
        yield _text_piece(end_text + line_end if lacks_line_end else end_text)

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

    def _text(self, piece: _Piece) -> str:
        """Return the text of a piece."""
        return "".join(part if isinstance(part, str) else self._text_of_rows(*part) for part in piece.content)

    def _text_of_rows(self, first: int, last: int) -> str:
        """Return the corrected text of rows first … last − 1 of the trace, which are consecutive lines of a file."""
        source, line = self.execution.trace.place(first)
        shift = line - first  # from a row to its line in the file
        begin, stop = np.searchsorted(self.edited.rows, [first, last]).tolist()
        texts: list[str] = []
        next_row = first
        for row, new_text in zip(self.edited.rows[begin:stop].tolist(), self.edited.texts[begin:stop], strict=True):
            texts += [source.lines_text(next_row + shift, row + shift - 1), new_text]
            next_row = row + 1
        return "".join([*texts, source.lines_text(next_row + shift, last + shift - 1)])


def _run_begins(keys: Sequence[_Key], counts: Sequence[int], step: int) -> list[int]:
    """Return the numbers, from 0, of the first rounds of runs.

    In a run all rounds have equal changes, and the counter increases by `step` from round to round.

    :param keys: key of the changes in each round.
    :param counts: value of the counter in each round.
    """
    begins = [0]
    for number in range(1, len(keys)):
        if keys[number] != keys[number - 1] or counts[number] != counts[number - 1] + step:
            begins.append(number)
    return begins


def _text_piece(text: str) -> _Piece:
    """Return a text as a piece that contains no rows of the trace."""
    return _Piece(line_count(text), (text,))


def _version_piece(version: _Version) -> _Piece:
    """Return the lines of a version, with the places of the rows of all its calls."""
    piece = version.piece or _text_piece("")
    return piece._replace(places=version.places)


def _concatenate(pieces: Iterable[_Piece]) -> _Piece:
    """Return pieces that follow each other as one piece."""
    content, places, number = list[str | tuple[int, int]](), list[tuple[int, int, int]](), 0
    for piece in pieces:
        content += piece.content
        places += [(number + line, first, last) for line, first, last in piece.places]
        number += piece.line_count
    return _Piece(number, content, places)


def _merge_rounds(rounds: Sequence[_Piece]) -> _Piece:
    """Return the lines of rounds with equal text: the lines of the first, with the places of the rows of all rounds."""
    return rounds[0]._replace(places=[place for piece in rounds for place in piece.places])


def _line_end(text: str) -> str:
    """Return the CR and LF at the end of a text; empty without a line end."""
    return text[len(text.rstrip("\r\n")) :]
