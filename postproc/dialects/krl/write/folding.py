"""From the corrected execution trace of a program back to its files.

A loop whose rounds have the same corrected text stays a loop; otherwise its rounds are written out. A routine that has
the same corrected text in all its calls is corrected in place; where calls differ, the others get copies of it under
other names.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from postproc.chunks import ragged_range
from postproc.dialects.krl.course import Body, Called, Course, Repeated
from postproc.dialects.krl.language.names import Names
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.routines import Routine
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import NAME, indent
from postproc.dialects.krl.language.tree import Definition
from postproc.dialects.text import line_spans
from postproc.errors import Issue
from postproc.program import Document, Ints


class Folded(Struct, frozen=True):
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


def folded(course: Course, main: Routine, text: str, begins: Ints) -> Folded:
    """Return the files of a program whose trace was corrected.

    :param main: its main routine.
    :param text: the corrected trace.
    :param begins: (L + 1,) offset in it where each line of the trace now begins, and where it ends.
    """
    return _Folder(course, main, text, begins.tolist()).folded()


class _Piece(NamedTuple):
    """Lines of a file.

    :ivar places: (n, first, last): line n of the text, from 0, is where line `first` of the trace begins now; the lines
        up to the one before `last` follow as they do in the corrected trace.
    """

    text: str
    places: Sequence[tuple[int, int, int]] = ()


class _Round(NamedTuple):
    """One round of a loop: the assignment to the counter of FOR, and the other lines."""

    counter: _Piece
    own: _Piece


class _Version(NamedTuple):
    """The name under which a routine has a text, and the places of all calls that read so, see `_Piece`."""

    name: str
    places: list[tuple[int, int, int]]


class _Folder(Struct, eq=False):
    course: Course
    main: Routine
    text: str
    begins: list[int]
    versions: defaultdict[Routine, dict[str, _Version]] = field(default_factory=lambda: defaultdict(dict))
    names: Names | None = None
    outside: list[Called] = []
    issues: list[Issue] = []

    def folded(self) -> Folded:
        text, places = self._body(self.course.body)
        self.versions[self.main][text] = _Version(self.main.name, [*places])
        line = np.zeros(len(self.begins), dtype=np.int64)
        inside = np.zeros(len(self.begins), dtype=np.bool_)
        row = np.searchsorted(line_spans(self.text)[0], self.begins)
        documents = []
        for source in dict.fromkeys([self.main.source, *(routine.source for routine in self.versions)]):
            file = _together(self._file(source))
            if source is self.main.source:
                number, first, last = np.array(file.places, dtype=np.int64).reshape(-1, 3).T
                count = last - first
                own = ragged_range(count, first)
                line[own] = 1 + np.repeat(number - row[first - 1], count) + row[own - 1]
                inside[own] = True
            if source is self.main.source or file.text != source.text:
                documents.append(replace(source.document, text=file.text))
                self._warn_users(source)
        for called in self.outside:
            rows = line[called.body.first : called.body.last]
            rows[rows == 0] = line[called.line]
        return Folded(tuple(documents), line, inside, tuple(self.issues))

    def _warn_users(self, source: Source) -> None:
        """Warn of other programs that call routines of a file that is changed."""
        name = source.document.name
        if users := self.course.users.get(name, ()):
            message = (
                f"{name} is corrected for this program. {', '.join(users)} of its folders call it too, and would "
                f"move by the correction made here: give them a {name} of their own."
            )
            self.issues.append(Issue("warning", "shared-file", message, subject=name))

    # --- bodies ------------------------------------------------------------------------------------------------------

    def _body(self, body: Body, begin: int = 0) -> _Piece:
        """Return the lines of a body as they are now, from a line of the trace on; 0: from its first."""
        pieces, line = [], begin or body.first
        for part in body.parts:
            if isinstance(part, Called):
                pieces += [self._lines(line, part.line), self._call(part)]
                line = part.body.last
            else:
                pieces += [self._lines(line, part.first), self._loop(part)]
                line = part.last
        rest = self._lines(line, body.last)
        return _together([*pieces, rest]) if pieces else rest

    def _lines(self, first: int, last: int) -> _Piece:
        """Return lines first … last − 1 of the trace as they are now."""
        if last <= first:
            return _Piece("")
        return _Piece(self.text[self.begins[first - 1] : self.begins[last - 1]], ((0, first, last),))

    def _loop(self, loop: Repeated) -> _Piece:
        """Return a loop with its body corrected where all rounds read the same, else one round behind the other."""
        if not loop.bodies:
            return self._lines(loop.first, loop.last - (loop.step != 0))
        counted = loop.step != 0
        rounds = [
            _Round(self._lines(body.first, body.first + counted), self._body(body, body.first + counted))
            for body in loop.bodies
        ]
        first = rounds[0].own.text
        if all(each.own.text == first for each in rounds):
            return _together([_Piece(loop.opener), _joined(each.own for each in rounds), _Piece(loop.closer)])
        head, blanks, end = loop.opener.strip(), indent(loop.opener), _line_end(loop.opener)
        out = [piece for run in _alike(rounds, loop.step) for piece in self._run(run, loop)]
        out.append(self._lines(loop.bodies[-1].last, loop.last))
        if loop.left:
            out = [_Piece(f"{blanks}LOOP{end}"), *out, _Piece(f"{blanks}EXIT{end}{blanks}ENDLOOP{end}")]
        message = f"The rounds of {head} are corrected differently: they are written out, but for those that are alike."
        line = int(self.course.source.shown(np.array([loop.first]))[0])
        self.issues.append(Issue("info", "loop-written-out", message, line, subject=f"{head} {line}"))
        return _together([_Piece(f"{blanks}; {head} (written out){end}"), *out])

    def _run(self, rounds: list[_Round], loop: Repeated) -> Iterator[_Piece]:
        """Yield rounds that read the same: one as it is, several of FOR as a FOR of their own."""
        if len(rounds) == 1 or not loop.step or loop.left:
            for each in rounds:
                yield from each
            return
        name, _, first = rounds[0].counter.text.strip().partition("=")
        last = rounds[-1].counter.text.partition("=")[2].strip()
        step = "" if loop.step == 1 else f" STEP {loop.step}"
        yield _Piece(f"{indent(loop.opener)}FOR {name}={first} TO {last}{step}{_line_end(loop.opener)}")
        yield _joined(each.own for each in rounds)
        yield _Piece(loop.closer)

    def _call(self, called: Called) -> _Piece:
        """Return the line of a call, with the name of the version that it calls."""
        name = self._version(called, self._body(called.body))
        text, places = self._lines(called.line, called.line + 1)
        if called.routine.source is not self.main.source:
            self.outside.append(called)
        if name != called.routine.name:
            text = text[: called.name[0]] + name + text[called.name[1] :]
        return _Piece(text, places)

    # --- routines ----------------------------------------------------------------------------------------------------

    def _version(self, called: Called, piece: _Piece) -> str:
        """Return the name under which a routine reads like some lines."""
        versions, routine = self.versions[called.routine], called.routine
        if routine in self.course.pinned and not versions:
            versions[_text(routine.source, routine.first + 1, routine.last - 1)] = _Version(routine.name, [])
        if piece.text not in versions:
            versions[piece.text] = _Version(self._unused(called) if versions else routine.name, [])
        versions[piece.text].places.extend(piece.places)
        return versions[piece.text].name

    def _unused(self, called: Called) -> str:
        """Return a name for a copy of a routine."""
        if self.names is None:
            sources = [self.course.source, self.main.source, *(routine.source for routine in self.versions)]
            words = {word.upper() for source in sources for word in NAME.findall(source.text)}
            self.names = Names(words | self.course.taken)
        routine = called.routine
        head = statement(routine.source, routine.first)
        spelt = head.name if isinstance(head, Definition) else routine.name
        name = self.names.unused(spelt)
        why = "is corrected differently from call to call"
        if routine in self.course.pinned:
            why = "is also called where calls are not followed, and stays as it is there"
        message = f"{spelt}() {why}: this one calls its copy {name}()."
        line = int(self.course.source.shown(np.array([called.line]))[0])
        self.issues.append(Issue("info", "routine-copied", message, line, subject=name))
        return name

    def _file(self, source: Source) -> Iterator[_Piece]:
        """Yield a file with its routines as they are now, copies behind them."""
        line = 1
        for routine in sorted(self.versions, key=lambda routine: routine.first):
            if routine.source is source:
                yield _Piece(_text(source, line, routine.first))
                (text, first), *copies = self.versions[routine].items()
                yield _Piece(text, first.places)
                end = _text(source, routine.last, routine.last)
                line = routine.last + 1
                yield _Piece(end)
                head = _text(source, routine.first, routine.first)
                gap = _line_end(head)
                for text, version in copies:
                    yield _Piece(gap if _line_end(end) else gap + gap)
                    yield _Piece(self._head(routine, version.name))
                    yield _Piece(text, version.places)
                    yield _Piece(end if _line_end(end) else end + gap)
        yield _Piece(_text(source, line, len(source.starts)))

    def _head(self, routine: Routine, name: str) -> str:
        """Return the line of a DEF with another name; in other files it is GLOBAL, for the program to find it."""
        source, text = routine.source, _text(routine.source, routine.first, routine.first)
        here, begin = statement(source, routine.first), int(source.starts[routine.first - 1])
        if not isinstance(here, Definition):
            return text
        start, at = here.start - begin, here.at - begin
        public = "" if here.public or source is self.main.source else "GLOBAL "
        return f"{text[:start]}{public}{text[start:at]}{name}{text[at + len(here.name) :]}"


def _alike(rounds: Sequence[_Round], step: int) -> list[list[_Round]]:
    """Return the rounds of a loop in runs of such as read the same and are counted evenly."""
    runs: list[list[_Round]] = []
    before: tuple[str, int] | None = None
    for each in rounds:
        count = int(each.counter.text.partition("=")[2]) if step else 0
        if before is not None and before == (each.own.text, count - step):
            runs[-1].append(each)
        else:
            runs.append([each])
        before = each.own.text, count
    return runs


def _together(pieces: Iterable[_Piece]) -> _Piece:
    """Return pieces that follow each other as one."""
    texts, places, number = list[str](), list[tuple[int, int, int]](), 0
    for text, own in pieces:
        if text:
            texts.append(text)
            places += [(number + at, first, last) for at, first, last in own]
            number += _count(text)
    return _Piece("".join(texts), places)


def _joined(copies: Iterable[_Piece]) -> _Piece:
    """Return the piece that copies which read the same become, for the lines of all."""
    same = list(copies)
    return _Piece(same[0].text, [place for piece in same for place in piece.places])


def _text(source: Source, first: int, last: int) -> str:
    if last < first:
        return ""
    stop = int(source.starts[last]) if last < len(source.starts) else len(source.text)
    return source.text[int(source.starts[first - 1]) : stop]


def _count(text: str) -> int:
    """Return how many lines a text has."""
    if text.endswith("\n") and text.count("\r") in (0, text.count("\r\n")):
        return text.count("\n")  # counted much faster
    return len(line_spans(text)[0])


def _line_end(text: str) -> str:
    return text[len(text.rstrip("\r\n")) :]
