"""A long program in several files: `part1.src`, `part2.src` … and `partMain.src`, which calls them one after the other.

Decisions, where KUKA leaves a choice:

- What is a system variable (`$BASE`, `$VEL.CP`, `$APO.CDIS` …) stays as it is from file to file: all run in one
  interpreter. What is declared in the DEF or in the `.dat` is seen by one file only: constants are declared in each
  file that uses them, and a variable that is written must be used in one file alone.
- The advance run goes on over a call, DEF and END, so that a motion with C_DIS before a cut is approximated as before:
  it stops at statements as WAIT, HALT, INTERRUPT DECL and BAS (#INITMOV), none of which is added (KUKA, Expert
  Programming, 'computer advance run': END stops it only in a module that declares an interrupt that is not GLOBAL). All
  initialisation stays in the main program.
- A cut never falls into a fold, a control structure or a spline, between a TRIGGER and its motion, or behind CONTINUE.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import count, pairwise

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.data_files import data_lines
from postproc.dialects.krl.language.declarations import declared
from postproc.dialects.krl.language.names import DECLARING, MAX_LENGTH, NAME, OPENING, fault_of
from postproc.dialects.krl.language.parts import MAIN, joined, taken_apart
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.statements import MOTION_WORDS, SPLINES, assignment, calls, declares, word_at
from postproc.dialects.krl.write.file_data import with_data
from postproc.dialects.krl.write.renaming import with_name
from postproc.errors import Issue, ProgramError
from postproc.program import Document, Ints, Written

_FOLD = re.compile(r"[ \t]*;[ \t]*(END)?FOLD\b", re.IGNORECASE)
_LABEL = re.compile(r"[A-Za-z_]\w*[ \t]*:$", re.ASCII)
_LOCAL_INTERRUPT = re.compile(r"INTERRUPT[ \t]+DECL\b", re.IGNORECASE)
_INTERRUPT = re.compile(r"(?:GLOBAL[ \t]+)?INTERRUPT\b", re.IGNORECASE)
_LATER = frozenset({"TRIGGER", "ANIN", "DIGIN"})
_CLOSING = frozenset({*OPENING.values(), "UNTIL", "ENDSPLINE"})
_OPENING = frozenset({*OPENING, "REPEAT", "SPLINE", "PTP_SPLINE"})
_ADVICE = "Set lines_per_file = 0 in [output] of the cell to have it in one file."


def in_files(name: str, documents: Sequence[Document], written: Written, limit: int) -> Written:
    """Return a written program in as many files as it needs, or as it had.

    :param name: of the program.
    :param documents: the files that it was read from, if it is KRL that stays as it is; else none.
    :param written: it as one text.
    :param limit: lines of a file at most; 0: a program that was in one file stays in one.
    :raises ProgramError: it is too long, and cannot be divided.
    """
    before = joined(documents) if documents else None
    if before is not None:
        return _as_before(documents, written, limit)
    if not limit or written.documents[0].text.count("\n") < limit:
        source = Source.of(written.documents[0], 0)
        if not limit or len(source.starts) <= limit:
            return written
    return _Splitter(name, written, limit).written()


def _as_before(documents: Sequence[Document], written: Written, limit: int) -> Written:
    """Return a program that was read from several files in these files."""
    whole = joined(documents)
    if whole is None or all(
        one.text == other.text for one, other in zip(written.documents, whole.documents, strict=True)
    ):
        return replace(written, documents=tuple(documents))
    texts = taken_apart(written.documents[0].text)
    known = {document.name: document for document in documents}
    sources = [replace(known[file], text=text) for (file, _), text in zip(whole.files, texts, strict=True)]
    longest = max(sources, key=lambda document: document.text.count("\n"))
    issues = list(written.issues)
    if limit and longest.text.count("\n") > limit:
        message = f"{longest.name} has more than {limit} lines: a program in several files keeps its division."
        issues.append(Issue("warning", "long-file", message))
    files = with_data(sources, written.documents[1] if len(written.documents) > 1 else None)
    return replace(written, documents=tuple(files), issues=tuple(issues))


class _Places(Struct, frozen=True, eq=False):
    """Where a program may be cut.

    :param begin: line of its DEF.
    :param end: line of its END.
    :param cuts: lines (n,) before which it may be cut, ascending.
    :param first: line of its first motion.
    :param declarations: lines that declare.
    """

    begin: int
    end: int
    cuts: Ints
    first: int
    declarations: list[int]


class _Splitter:
    """Divides one program."""

    def __init__(self, name: str, written: Written, limit: int) -> None:
        self.whole, self.limit, self.issues = written, limit, list(written.issues)
        self.source = Source.of(written.documents[0], 0)
        self.places = self._places()
        self.base = self._base(name)
        start = int(self.source.stops[self.places.begin - 1])
        self.line_end = self.source.text[start : int(self.source.starts[self.places.begin])]

    def written(self) -> Written:
        """Return the program in several files, each line of a target counted on from file to file."""
        source, places, text = self.source, self.places, self.source.text
        shared = places.declarations
        header = [line for line in range(1, places.begin) if text[source.starts[line - 1]] == "&"]
        overhead = len(header) + len(shared) + 3
        bounds = self._bounds(overhead)
        main = f"{self.base}{MAIN}"
        called = [f"{self.base}{number}( )" for number in range(1, len(bounds))]
        first = with_name(self._lines(1, bounds[0]), main)
        tail = self._lines(places.end, len(source.starts) + 1)
        sources = [self._document(main, "".join([first, *(call + self.line_end for call in called), tail]))]
        head = self._text_of(header)
        declared_again = self._text_of(shared)
        for number, (begin, beyond) in enumerate(pairwise(bounds), 1):
            name = f"{self.base}{number}"
            own = [f"DEF {name}( )", f";POSTPROC 1 part={number} of={main}"]
            body = "".join(line + self.line_end for line in own)
            parts = [head, body, declared_again, self._lines(begin, beyond), f"END{self.line_end}"]
            sources.append(self._document(name, "".join(parts)))
        self._check_variables(bounds)
        data = self.whole.documents[1] if len(self.whole.documents) > 1 else None
        return replace(
            self.whole,
            documents=tuple(with_data(sources, data)),
            output_line=self._numbers(bounds, overhead, len(called)),
            issues=tuple(self.issues),
        )

    def _numbers(self, bounds: Sequence[int], overhead: int, called: int) -> Ints:
        """Return the lines of the targets, counted on from file to file."""
        line = self.whole.output_line
        part = np.searchsorted(np.array(bounds), line, side="right")
        in_main = bounds[0] - 1 + called + len(self.source.starts) - self.places.end + 1
        behind = in_main - (bounds[0] - 1) + (overhead - 1) + (part - 1) * overhead
        return np.asarray(np.where(part == 0, line, line + behind))

    def _document(self, name: str, text: str) -> Document:
        return replace(self.whole.documents[0], name=f"{name}.src", text=text)

    def _lines(self, first: int, beyond: int) -> str:
        """Return the text of lines first … beyond − 1."""
        starts, text = self.source.starts, self.source.text
        stop = int(starts[beyond - 1]) if beyond <= len(starts) else len(text)
        return text[int(starts[first - 1]) : stop]

    def _text_of(self, lines: Sequence[int]) -> str:
        return "".join(self._lines(line, line + 1) for line in lines)

    def _error(self, problem: str, line: int, advice: str = _ADVICE) -> ProgramError:
        return self.source.line_error(f"the program cannot be divided into files: {problem}", line, advice)

    def _bounds(self, overhead: int) -> list[int]:
        """Return the first line of each part, and END."""
        places, room = self.places, self.limit - overhead
        if room < 1:
            raise self._error(f"{self.limit} lines are not enough for one motion", places.begin)
        before = places.cuts[places.cuts <= places.first]
        if not len(before):
            raise self._error("its first motion stands in a fold or control structure", places.first)
        bounds = [int(before[-1])]
        late = [line for line in places.declarations if line > bounds[0]]
        if late:
            raise self._error("a declaration stands behind the first motion", late[0])
        while places.end - bounds[-1] > room:
            later = places.cuts[places.cuts > bounds[-1]]
            fitting = later[later <= bounds[-1] + room]
            cut = int(fitting[-1]) if len(fitting) else int(later[0]) if len(later) else places.end
            if not len(fitting):
                message = (
                    f"{self.base}{len(bounds)}.src has more than {self.limit} lines: from line {bounds[-1]} to line "
                    f"{cut - 1} stand a fold, a control structure, a spline or a TRIGGER, which are not cut."
                )
                self.issues.append(Issue("warning", "long-file", message))
            if cut == places.end:
                break
            bounds.append(cut)
        return [*bounds, places.end]

    def _places(self) -> _Places:
        """Look at all lines of the program."""
        source, text = self.source, self.source.text
        begin = end = first = depth = 0
        cuts: list[int] = []
        declarations: list[int] = []
        held = False  # a TRIGGER waits for its motion, or CONTINUE for its statement
        for line, start in enumerate(source.starts.tolist(), 1):
            stop = int(source.stops[line - 1])
            fold = _FOLD.match(text, start, stop)
            if begin and not end and depth == 0 and not held and not (fold and fold[1]):
                cuts.append(line)
            if fold:
                depth = max(depth - 1, 0) if fold[1] else depth + 1
                continue
            start, stop = source.code_span(line)
            word = word_at(text, start, stop)
            if word in ("DEF", "DEFFCT") or (word == "GLOBAL" and re.match(r"\w+[ \t]+DEF", text[start:stop], re.I)):
                if begin:
                    problem = "it has routines of its own, which the other files would not see"
                    raise self._error(problem, line, f"Write them into files of their own, or: {_ADVICE}")
                begin = line
            elif word == "END" and begin and not end:
                end = line
            elif begin and not end and start < stop:
                self._check_statement(line, word, text[start:stop], first)
                depth = max(0, depth + (word in _OPENING) - (word in _CLOSING))
                if word in MOTION_WORDS or word in SPLINES:
                    first, held = first or line, False
                elif word in ("TRIGGER", "CONTINUE"):
                    held = True
                elif declares(text, start, stop) or word in DECLARING:
                    declarations.append(line)
        if not first or not end:
            raise self._error("it has no DEF, END or motion", max(begin, 1))
        return _Places(begin, end, np.array(cuts, dtype=np.int64), first, declarations)

    def _check_statement(self, line: int, word: str, code: str, first: int) -> None:
        """Refuse statements that mean something else in a file of their own."""
        if word in ("RETURN", "GOTO") or _LABEL.match(code):
            raise self._error(f"{word or code} leads to another place of it", line)
        if first and _LOCAL_INTERRUPT.match(code):
            raise self._error("an interrupt that is not GLOBAL is declared behind the first motion", line)

    def _base(self, name: str) -> str:
        """Return what the names of the files begin with: valid ones, which the program uses for nothing else."""
        taken = {word.upper() for word in _code_names(self.source)}
        for number in count(1):
            tail = "" if number == 1 else f"_{number}"
            base = name[: MAX_LENGTH - len(MAIN) - len(tail)] + tail
            new = {f"{base}{part}".upper() for part in (MAIN, *range(1, len(self.source.starts) + 1))}
            if not new & taken and not any(fault_of(f"{base}{part}") for part in (MAIN, 1)):
                return base
        raise AssertionError("there is always a free name")  # pragma: no cover

    def _check_variables(self, bounds: Sequence[int]) -> None:
        """Refuse variables of the program that are used in several files and that the program may write."""
        source = self.source
        local = {
            one.name: line
            for line in self.places.declarations
            if word_at(source.text, *source.code_span(line)) not in DECLARING
            for one in declared(source, *source.code_span(line))
        }
        data = self.whole.documents[1:]
        lines = [one for document in data for one in data_lines(Source.of(document, 1)) if not one.public]
        kept = {name for one in lines for name in one.names}
        if not local and not kept:
            return
        users: dict[str, set[int]] = {}
        changing: dict[str, int] = {}
        for line in range(self.places.begin + 1, self.places.end):
            if line in self.places.declarations:
                continue
            start, stop = source.code_span(line)
            names = {word.upper() for word in NAME.findall(source.text, start, stop)}
            part = int(np.searchsorted(np.array(bounds), line, side="right"))
            for name in names & (local.keys() | kept):
                users.setdefault(name, set()).add(part)
            for name in self._written_in(start, stop) & (local.keys() | kept):
                changing.setdefault(name, line)
        for name, parts in users.items():
            if len(parts) > 1 and (name in local or name in changing):
                where = local.get(name, changing.get(name, self.places.begin))
                problem = f"{name} is a variable of it and used in several of the files"
                raise self._error(problem, where, f"Declare it in the $config.dat, or: {_ADVICE}")

    def _written_in(self, start: int, stop: int) -> set[str]:
        """Return the names that a statement may write: by assignment, as argument of a call, as counter of a FOR.

        What is done at another time (TRIGGER, INTERRUPT, ANIN, DIGIN) may write all that is named in it.
        """
        source = self.source
        word = word_at(source.text, start, stop)
        if word == "FOR":
            return {name.upper() for name in NAME.findall(source.text, start, stop)[1:2]}
        if word in _LATER or _INTERRUPT.match(source.text, start, stop):
            return {name.upper() for name in NAME.findall(source.text, start, stop)}
        names = set()
        if word not in MOTION_WORDS:
            found = assignment(source, start, stop)
            if found is not None:
                names.add(found[0].name)
        for call in calls(source, start, stop):
            if call.name != "BAS":
                names |= {name.upper() for span in call.arguments for name in NAME.findall(source.text, *span)}
        return names


def _code_names(source: Source) -> Iterator[str]:
    """Yield the names in the code of a file; those of plain targets are none."""
    for line in range(1, len(source.starts) + 1):
        start, stop = source.code_span(line)
        if word_at(source.text, start, stop) not in MOTION_WORDS or "(" in source.text[start:stop]:
            yield from NAME.findall(source.text, start, stop)
