"""From the corrected execution trace of a program back to its files.

A loop whose rounds are corrected alike stays a loop; otherwise its rounds are written out. A routine that is corrected
alike in all its calls is corrected in place; where calls differ, the others get copies of it under other names.

What is alike is decided by keys, numbers of the changes of rows: two executions of a body are written alike if the same
of its lines have the same keys. Text is made once, of what is written.
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
from postproc.dialects.krl.course import Body, Course, InlinedRoutine, UnrolledLoop
from postproc.dialects.krl.language.names import Names
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.routines import Routine
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import indent, names_in
from postproc.dialects.krl.language.tree import Definition
from postproc.dialects.krl.write.edited_rows import EditedRows, line_count, line_text
from postproc.errors import Issue
from postproc.program import Document, Ints

_Key = tuple[tuple[int, object], ...]
"""Changed lines of a body, each with what it becomes; empty if nothing changes."""


class FoldedProgram(Struct, frozen=True):
    """The files of a program.

    :ivar documents: the `.src`, then changed files of routines that it calls.
    :ivar line: (L + 1,) line of the `.src` on which each line of the trace begins now; of lines in other files that
        of the call.
    :ivar inside: (L + 1,) True where the line is in the `.src`.
    :ivar issues: warnings for the user.
    """

    documents: tuple[Document, ...]
    line: Ints
    inside: np.ndarray
    issues: tuple[Issue, ...]


def fold(course: Course, main: Routine, new_rows: EditedRows) -> FoldedProgram:
    """Return the files of a program whose trace was corrected.

    :param main: its main routine.
    """
    return _Folder(course, main, new_rows).fold()


class _Piece(NamedTuple):
    """Lines of a file.

    :ivar lines: number of lines.
    :ivar content: texts, and rows first … last − 1 of the trace as they are written.
    :ivar places: (n, first, last): line n of the piece, from 0, is where row `first` of the trace begins now; the rows
        up to the one before `last` follow as they do in the corrected trace.
    """

    lines: int
    content: Sequence[str | tuple[int, int]]
    places: Sequence[tuple[int, int, int]] = ()


class _Version(Struct, eq=False):
    """A text of a routine: the name under which it has it, and the places of all calls that read so."""

    name: str
    piece: _Piece | None = None
    places: list[tuple[int, int, int]] = []


class _Folder(Struct, eq=False):
    course: Course
    main: Routine
    edited: EditedRows
    versions: defaultdict[Routine, dict[_Key, _Version]] = field(default_factory=lambda: defaultdict(dict))
    names: Names | None = None
    outside: list[InlinedRoutine] = []
    issues: list[Issue] = []
    _keys: dict[Body, _Key] = {}
    _calls: dict[InlinedRoutine, _Version] = {}

    def fold(self) -> FoldedProgram:
        """Return the files of the program, with the line of each row of the trace in the main file."""
        key = self._key(self.course.body)
        body = self._body(self.course.body)
        self.versions[self.main][key] = _Version(self.main.name, body, [*body.places])
        begins = self.edited.begins
        line = np.zeros(len(begins), dtype=np.int64)
        is_inside = np.zeros(len(begins), dtype=np.bool_)
        documents = []
        for source in dict.fromkeys([self.main.source, *(routine.source for routine in self.versions)]):
            file = _concatenate(self._file(source))
            if source is self.main.source:
                number, first, last = np.array(file.places, dtype=np.int64).reshape(-1, 3).T
                count = last - first
                rows_of_file = ragged_range(count, first)
                line[rows_of_file] = 1 + np.repeat(number - begins[first - 1], count) + begins[rows_of_file - 1]
                is_inside[rows_of_file] = True
            text = self._text(file)
            if source is self.main.source or text != source.text:
                documents.append(replace(source.document, text=text))
                self._warn_users(source)
        for call in self.outside:
            rows = line[call.body.first : call.body.last]
            rows[rows == 0] = line[call.row]
        return FoldedProgram(tuple(documents), line, is_inside, tuple(self.issues))

    def _warn_users(self, source: Source) -> None:
        """Warn of other programs that call routines of a file that is changed."""
        name = source.document.name
        if users := self.course.users.get(name, ()):
            message = (
                f"{name} is corrected for this program. {', '.join(users)} of its folders call it too, and would "
                f"move by the correction made here: give them a {name} of their own."
            )
            self.issues.append(Issue("warning", "shared-file", message, subject=name))

    # --- keys --------------------------------------------------------------------------------------------------------

    def _key(self, body: Body) -> _Key:
        """Return a key of the changes in a body, by its lines; assignments to the counter of FOR do not count."""
        key = self._keys.get(body)
        if key is None:
            changes: list[tuple[int, object]] = []
            row = body.first
            for part in body.parts:
                first, last = (
                    (part.row, part.body.last) if isinstance(part, InlinedRoutine) else (part.first, part.last)
                )
                self._add_changes(changes, row, first)
                change = self._call_key(part) if isinstance(part, InlinedRoutine) else self._loop_key(part)
                if change:
                    changes.append((self._line(first), change))
                row = last
            self._add_changes(changes, row, body.last)
            key = self._keys[body] = tuple(changes)
        return key

    def _add_changes(self, changes: list[tuple[int, object]], first: int, last: int) -> None:
        """Add the changes of rows first … last − 1."""
        keys = self.edited.keys[first - 1 : last - 1]
        if any(keys):
            changes += [(self._line(row), key) for row, key in enumerate(keys, first) if key]

    def _line(self, row: int) -> int:
        return self.course.trace.line.item(row - 1)

    def _loop_key(self, loop: UnrolledLoop) -> object:
        """Return a key of the changes in a loop: of its body if all rounds are alike, else of each round."""
        keys = [self._key(body) for body in loop.bodies]
        if all(key == keys[0] for key in keys):
            return keys[0] if keys else self._key_of_lines(loop)
        head = loop.opener.strip()
        message = f"The rounds of {head} are corrected differently: they are written out, but for those that are alike."
        line = self.course.trace.shown_line(loop.first)
        self.issues.append(Issue("info", "loop-written-out", message, line, subject=f"{head} {line}"))
        end = self.course.count(loop, loop.bodies[-1].last) if self._sets_counter(loop) else None
        return ("rounds", end, *zip(self._counts(loop), keys, strict=True))

    def _sets_counter(self, loop: UnrolledLoop) -> bool:
        """Return whether the counter of a FOR is set behind its last round."""
        return loop.step != 0 and loop.last > loop.bodies[-1].last

    def _key_of_lines(self, loop: UnrolledLoop) -> _Key:
        """Return the key of the changes in the lines of a loop without rounds."""
        changes: list[tuple[int, object]] = []
        self._add_changes(changes, loop.first, loop.last)
        return tuple(changes)

    def _call_key(self, call: InlinedRoutine) -> object:
        """Return what changes in a call: the line itself, and the name of the version that is called."""
        version = self._version(call)
        name = "" if version.name == call.routine.name else version.name
        key = self.edited.keys[call.row - 1]
        return (key, name) if key or name else ()

    def _version(self, call: InlinedRoutine) -> _Version:
        """Return the version of a routine that a call needs."""
        versions, routine = self.versions[call.routine], call.routine
        key = self._key(call.body)
        if routine in self.course.pinned and not versions:
            text = line_text(routine.source, routine.first + 1, routine.last - 1)
            versions[()] = _Version(routine.name, _Piece(line_count(text), (text,)))
        if key not in versions:
            versions[key] = _Version(self._unused_name(call) if versions else routine.name)
        self._calls[call] = versions[key]
        return versions[key]

    def _counts(self, loop: UnrolledLoop) -> list[int]:
        """Return the counter of a FOR in each round; of other loops zeros."""
        return [self.course.count(loop, body.first) if loop.step else 0 for body in loop.bodies]

    # --- bodies ------------------------------------------------------------------------------------------------------

    def _body(self, body: Body, begin: int = 0) -> _Piece:
        """Return the lines of a body as they are written, from a row of the trace on; 0: from its first."""
        pieces, row = [], begin or body.first
        for part in body.parts:
            if isinstance(part, InlinedRoutine):
                pieces += [self._lines(row, part.row), self._call(part)]
                row = part.body.last
            else:
                pieces += [self._lines(row, part.first), self._loop(part)]
                row = part.last
        remaining_lines = self._lines(row, body.last)
        return _concatenate([*pieces, remaining_lines]) if pieces else remaining_lines

    def _lines(self, first: int, last: int) -> _Piece:
        """Return rows first … last − 1 of the trace as they are written."""
        if last <= first:
            return _Piece(0, ())
        begins = self.edited.begins
        return _Piece(int(begins[last - 1] - begins[first - 1]), ((first, last),), ((0, first, last),))

    def _counter(self, loop: UnrolledLoop, row: int, blanks: str) -> _Piece:
        """Return an assignment to the counter of a FOR; `blanks` are those before it."""
        text = f"{blanks}{loop.counter}={self.course.count(loop, row)}{_line_end(loop.opener)}"
        return _Piece(1, (text,), ((0, row, row + 1),))

    def _loop(self, loop: UnrolledLoop) -> _Piece:
        """Return a loop with its body corrected where all rounds are alike, else one round behind the other."""
        if not loop.bodies:
            return self._lines(loop.first, loop.last - (loop.step != 0))
        has_counter = loop.step != 0
        keys = [self._key(body) for body in loop.bodies]
        rounds = [self._body(body, body.first + has_counter) for body in loop.bodies]
        if all(key == keys[0] for key in keys):
            return _concatenate([_of(loop.opener), _merge_rounds(rounds), _of(loop.closer)])
        blanks, end = indent(loop.opener), _line_end(loop.opener)
        pieces = [_of(f"{blanks}; {loop.opener.strip()} (written out){end}")]
        if loop.left:
            pieces.append(_of(f"{blanks}LOOP{end}"))
        for first, stop in pairwise([*_runs(keys, self._counts(loop), loop.step), len(rounds)]):
            pieces += self._run(loop, first, rounds[first:stop])
        if self._sets_counter(loop):
            pieces.append(self._counter(loop, loop.bodies[-1].last, blanks))
        else:
            pieces.append(self._lines(loop.bodies[-1].last, loop.last))
        if loop.left:
            pieces.append(_of(f"{blanks}EXIT{end}{blanks}ENDLOOP{end}"))
        return _concatenate(pieces)

    def _run(self, loop: UnrolledLoop, first: int, rounds: Sequence[_Piece]) -> Iterator[_Piece]:
        """Yield the text of equal rounds: a single one unchanged, several of FOR as a new FOR.

        :param first: number of the first of them, from 0.
        """
        blanks, end = indent(loop.opener), _line_end(loop.opener)
        if len(rounds) == 1 or not loop.step or loop.left:
            for number, piece in enumerate(rounds, first):
                if loop.step:
                    yield self._counter(loop, loop.bodies[number].first, blanks)
                yield piece
            return
        begin, last = (self.course.count(loop, loop.bodies[n].first) for n in (first, first + len(rounds) - 1))
        step = "" if loop.step == 1 else f" STEP {loop.step}"
        yield _of(f"{blanks}FOR {loop.counter}={begin} TO {last}{step}{end}")
        yield _merge_rounds(rounds)
        yield _of(loop.closer)

    def _call(self, call: InlinedRoutine) -> _Piece:
        """Return the line of a call, with the name of the version that it calls."""
        body, version = self._body(call.body), self._calls[call]
        if version.piece is None:
            version.piece = body
        version.places.extend(body.places)
        line = self._lines(call.row, call.row + 1)
        if call.routine.source is not self.main.source:
            self.outside.append(call)
        if version.name == call.routine.name:
            return line
        text, (source, number) = self._text(line), self.course.trace.place(call.row)
        start, stop = (offset - source.starts.item(number - 1) for offset in call.name)
        return line._replace(content=(text[:start] + version.name + text[stop:],))

    # --- routines ----------------------------------------------------------------------------------------------------

    def _unused_name(self, call: InlinedRoutine) -> str:
        """Return a new name for the copy of a routine, and note for the user why it is copied."""
        if self.names is None:
            sources = dict.fromkeys([*self.course.trace.sources, *(routine.source for routine in self.versions)])
            words = (names_in(source.text) for source in sources)
            self.names = Names(set(self.course.taken).union(*words))
        routine = call.routine
        head = statement(routine.source, routine.first)
        spelling = head.name if isinstance(head, Definition) else routine.name
        name = self.names.unused(spelling)
        reason = "is corrected differently from call to call"
        if routine in self.course.pinned:
            reason = "is also called where calls are not followed, and stays as it is there"
        message = f"{spelling}() {reason}: this one calls its copy {name}()."
        line = self.course.trace.shown_line(call.row)
        self.issues.append(Issue("info", "routine-copied", message, line, subject=name))
        return name

    def _file(self, source: Source) -> Iterator[_Piece]:
        """Yield a file with its routines as they are written, copies behind them."""
        line = 1
        for routine in sorted(self.versions, key=lambda routine: routine.first):
            if routine.source is source:
                yield _of(line_text(source, line, routine.first))
                original, *copies = self.versions[routine].values()
                yield _version_piece(original)
                end = line_text(source, routine.last)
                line = routine.last + 1
                yield _of(end)
                gap = _line_end(line_text(source, routine.first))
                for version in copies:
                    yield _of(gap if _line_end(end) else gap + gap)
                    yield _of(self._head(routine, version.name))
                    yield _version_piece(version)
                    yield _of(end if _line_end(end) else end + gap)
        yield _of(line_text(source, line, len(source.starts)))

    def _head(self, routine: Routine, name: str) -> str:
        """Return the line of a DEF with another name; in other files it is GLOBAL, for the program to find it."""
        source, text = routine.source, line_text(routine.source, routine.first)
        node, begin = statement(source, routine.first), int(source.starts[routine.first - 1])
        if not isinstance(node, Definition):
            return text
        start, at = node.start - begin, node.at - begin
        public = "" if node.public or source is self.main.source else "GLOBAL "
        return f"{text[:start]}{public}{text[start:at]}{name}{text[at + len(node.name) :]}"

    # --- text --------------------------------------------------------------------------------------------------------

    def _text(self, piece: _Piece) -> str:
        """Return the text of a piece."""
        return "".join(part if isinstance(part, str) else self._row_text(*part) for part in piece.content)

    def _row_text(self, first: int, last: int) -> str:
        """Return the text of rows first … last − 1, which are consecutive lines of a file."""
        source, line = self.course.trace.place(first)
        shift = line - first
        begin, stop = np.searchsorted(self.edited.rows, [first, last]).tolist()
        texts = []
        for row, text in zip(self.edited.rows[begin:stop].tolist(), self.edited.texts[begin:stop], strict=True):
            texts += [line_text(source, first + shift, row + shift - 1), text] if row > first else [text]
            first = row + 1
        if first < last:
            texts.append(line_text(source, first + shift, last + shift - 1))
        return "".join(texts)


def _runs(keys: Sequence[_Key], counts: Sequence[int], step: int) -> list[int]:
    """Return the first rounds of runs that are equal and evenly counted."""
    begins = [0]
    for number in range(1, len(keys)):
        if keys[number] != keys[number - 1] or counts[number] != counts[number - 1] + step:
            begins.append(number)
    return begins


def _of(text: str) -> _Piece:
    return _Piece(line_count(text), (text,))


def _version_piece(version: _Version) -> _Piece:
    """Return the lines of a version, for the rows of all its calls."""
    piece = version.piece or _of("")
    return piece._replace(places=version.places)


def _concatenate(pieces: Iterable[_Piece]) -> _Piece:
    """Return pieces that follow each other as one."""
    content, places, number = list[str | tuple[int, int]](), list[tuple[int, int, int]](), 0
    for piece in pieces:
        content += piece.content
        places += [(number + at, first, last) for at, first, last in piece.places]
        number += piece.lines
    return _Piece(number, content, places)


def _merge_rounds(rounds: Sequence[_Piece]) -> _Piece:
    """Return the piece that rounds which are alike become, for the rows of all."""
    return rounds[0]._replace(places=[place for piece in rounds for place in piece.places])


def _line_end(text: str) -> str:
    return text[len(text.rstrip("\r\n")) :]
