"""From the corrected execution trace of a program back to its files.

A loop whose rounds have the same corrected text stays a loop; otherwise its rounds are written out. A routine that has
the same corrected text in all its calls is corrected in place; where calls differ, the others get copies of it under
other names.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from postproc.dialects.krl.course import Body, Called, Course, Repeated
from postproc.dialects.krl.language.names import unused
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
    """Some lines of a file, and which lines of the trace begin with them."""

    text: str
    lines: tuple[int, ...] = ()


class _Version(Struct, eq=False):
    """A routine as it is written, under one name."""

    name: str
    pieces: list[_Piece]


class _Folder(Struct, eq=False):
    course: Course
    main: Routine
    text: str
    begins: list[int]
    versions: defaultdict[Routine, list[_Version]] = field(default_factory=lambda: defaultdict(list))
    taken: set[str] = set()
    outside: list[Called] = []
    issues: list[Issue] = []

    def folded(self) -> Folded:
        pieces = self._body(self.course.body)
        self.versions[self.main].append(_Version(self.main.name, pieces))
        line = np.zeros(len(self.begins), dtype=np.int64)
        inside = np.zeros(len(self.begins), dtype=np.bool_)
        documents = []
        for source in dict.fromkeys([self.main.source, *(routine.source for routine in self.versions)]):
            file = list(self._file(source))
            if source is self.main.source:
                number = 1
                for piece in file:
                    line[list(piece.lines)] = number
                    inside[list(piece.lines)] = True
                    number += _count(piece.text)
            text = "".join(piece.text for piece in file)
            if source is self.main.source or text != source.text:
                documents.append(replace(source.document, text=text))
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

    def _body(self, body: Body) -> list[_Piece]:
        pieces, line = [], body.first
        for part in body.parts:
            if isinstance(part, Called):
                pieces += [*self._lines(line, part.line), self._call(part)]
                line = part.body.last
            else:
                pieces += [*self._lines(line, part.first), *self._loop(part)]
                line = part.last
        return [*pieces, *self._lines(line, body.last)]

    def _lines(self, first: int, last: int) -> list[_Piece]:
        """Return lines first … last − 1 of the trace as they are now."""
        begins, text = self.begins, self.text
        return [_Piece(text[begins[line - 1] : begins[line]], (line,)) for line in range(first, last)]

    def _loop(self, loop: Repeated) -> list[_Piece]:
        """Return a loop with its body corrected where all rounds read the same, else one round behind the other."""
        if not loop.bodies:
            return self._lines(loop.first, loop.last - (loop.step != 0))
        rounds = [self._body(body) for body in loop.bodies]
        own = [pieces[1:] if loop.step else pieces for pieces in rounds]
        texts = [piece.text for piece in own[0]]
        if all([piece.text for piece in pieces] == texts for pieces in own[1:]):
            return [_Piece(loop.opener), *_joined(own), _Piece(loop.closer)]
        runs = _alike(rounds, loop.step)
        head, blanks, end = loop.opener.strip(), indent(loop.opener), _line_end(loop.opener)
        out = [piece for run in runs for piece in self._run(run, loop)]
        out += self._lines(loop.bodies[-1].last, loop.last)
        if loop.left:
            out = [_Piece(f"{blanks}LOOP{end}"), *out, _Piece(f"{blanks}EXIT{end}{blanks}ENDLOOP{end}")]
        message = f"The rounds of {head} are corrected differently: they are written out, but for those that are alike."
        line = int(self.course.source.shown(np.array([loop.first]))[0])
        self.issues.append(Issue("info", "loop-written-out", message, line, subject=f"{head} {line}"))
        return [_Piece(f"{blanks}; {head} (written out){end}"), *out]

    def _run(self, rounds: list[list[_Piece]], loop: Repeated) -> list[_Piece]:
        """Return rounds that read the same: one as it is, several of FOR as a FOR of their own."""
        if len(rounds) == 1 or not loop.step or loop.left:
            return [piece for pieces in rounds for piece in pieces]
        name, _, first = rounds[0][0].text.strip().partition("=")
        last = rounds[-1][0].text.partition("=")[2].strip()
        step = "" if loop.step == 1 else f" STEP {loop.step}"
        opener = f"{indent(loop.opener)}FOR {name}={first} TO {last}{step}{_line_end(loop.opener)}"
        return [_Piece(opener), *_joined([pieces[1:] for pieces in rounds]), _Piece(loop.closer)]

    def _call(self, called: Called) -> _Piece:
        """Return the line of a call, with the name of the version that it calls."""
        name = self._version(called, self._body(called.body))
        (text, lines) = self._lines(called.line, called.line + 1)[0]
        if called.routine.source is not self.main.source:
            self.outside.append(called)
        if name != called.routine.name:
            text = text[: called.name[0]] + name + text[called.name[1] :]
        return _Piece(text, lines)

    # --- routines ----------------------------------------------------------------------------------------------------

    def _version(self, called: Called, pieces: list[_Piece]) -> str:
        """Return the name under which a routine reads like some pieces."""
        versions = self.versions[called.routine]
        routine = called.routine
        if routine in self.course.pinned and not versions:
            own = [_Piece(_text(routine.source, line, line)) for line in range(routine.first + 1, routine.last)]
            versions.append(_Version(routine.name, own))
        texts = [piece.text for piece in pieces]
        for version in versions:
            if [piece.text for piece in version.pieces] == texts:
                version.pieces = _joined([version.pieces, pieces])
                return version.name
        name = self._unused(called) if versions else called.routine.name
        versions.append(_Version(name, pieces))
        return name

    def _unused(self, called: Called) -> str:
        """Return a name for a copy of a routine."""
        if not self.taken:
            sources = [self.course.source, self.main.source, *(routine.source for routine in self.versions)]
            self.taken = {word.upper() for source in sources for word in NAME.findall(source.text)} | self.course.taken
        routine = called.routine
        head = statement(routine.source, routine.first)
        spelt = head.name if isinstance(head, Definition) else routine.name
        name = unused(spelt, self.taken)
        self.taken.add(name.upper())
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
                first, *copies = self.versions[routine]
                yield from first.pieces
                end = _text(source, routine.last, routine.last)
                line = routine.last + 1
                yield _Piece(end)
                head = _text(source, routine.first, routine.first)
                gap = _line_end(head)
                for version in copies:
                    yield _Piece(gap if _line_end(end) else gap + gap)
                    yield _Piece(self._head(routine, version.name))
                    yield from version.pieces
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


def _alike(rounds: list[list[_Piece]], step: int) -> list[list[list[_Piece]]]:
    """Return the rounds of a loop in runs of such as read the same and are counted evenly."""
    runs: list[list[list[_Piece]]] = []
    before: tuple[list[str], int] | None = None
    for pieces in rounds:
        texts = [piece.text for piece in (pieces[1:] if step else pieces)]
        count = int(pieces[0].text.partition("=")[2]) if step else 0
        if before is not None and before == (texts, count - step):
            runs[-1].append(pieces)
        else:
            runs.append([pieces])
        before = texts, count
    return runs


def _joined(copies: Sequence[list[_Piece]]) -> list[_Piece]:
    """Return the pieces of copies that read the same, each for the lines of all."""
    together = zip(*copies, strict=True)
    return [_Piece(same[0].text, tuple(line for piece in same for line in piece.lines)) for same in together]


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
