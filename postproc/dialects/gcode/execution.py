"""The lines of a program in the order in which a control executes them, with numbers where expressions stood.

Subprograms, loops and branches are written out: what comes out is a program of plain lines, which is then read like any
other, and each line of it knows where it stands. Runs of lines that hold neither parameters nor O-words are taken over
as they are, so that this costs little for a program whose subprograms are paths.

A subprogram that is not in the file is looked for in the folder of the program: ``O<name> CALL`` in ``name.ngc``, M98
P100 in ``100.ngc``, ``O100.nc``, ``o0100.nc`` and so on, first with the extension of the program.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from postproc.dialects.gcode import words
from postproc.dialects.gcode.blocks import BlockError, Fault
from postproc.dialects.gcode.control import Block, Order, Unit, is_controlled, ordered
from postproc.dialects.gcode.expressions import whole
from postproc.dialects.gcode.parameters import Parameters
from postproc.dialects.gcode.words import MARK, Source
from postproc.dialects.text import decode, line_starts
from postproc.errors import MOST, ProgramError
from postproc.program import Document, Ints

_EXTENSIONS = (".ngc", ".nc", ".tap", ".cnc", ".gcode", ".mpf", ".ptp", ".txt", ".sub", "")
_MOST_ORDERS = 2_000_000
"""So many lines with parameters or O-words are executed at most: more are taken for an endless loop."""
_MOST_ROWS = 10_000_000
_DEEPEST = 10
"""Subprograms may call each other to this depth, as in LinuxCNC."""
_CALL = re.compile(r"([PL])([+-]?(?:\d+\.?\d*|\.\d+))|M0*9[89]")
_ENDLESS = "An endless loop? Check what ends it."


@dataclass(frozen=True, slots=True, eq=False)
class Executed:
    """A program as it is executed.

    :param source: its lines in order, each as often as it is executed.
    :param documents: the files that they stand in, the program first.
    :param document: (L,) which of these each line stands in.
    :param line: (L,) its 1-based line there.
    :param main: (L,) its line in the program itself: for one of another file, that of the call.
    :param faults: why it could not be executed (further), in rows of `source`.
    """

    source: Source
    documents: tuple[Document, ...]
    document: Ints
    line: Ints
    main: Ints
    faults: tuple[Fault, ...] = ()


def executed(document: Document) -> Executed:
    """Execute what decides about the order of lines and about their numbers."""
    source = words.split(document, line_starts(document.text))
    if is_controlled(source):
        return _Run(Unit.of(document, source)).result()
    line = np.arange(1, len(source) + 1)
    return Executed(source, (document,), np.zeros(len(source), dtype=np.int64), line, line)


class _Piece(NamedTuple):
    """Lines `first` to `last` (exclusive) of a file; `text` if one that is executed with other words than it has."""

    unit: int
    first: int
    last: int
    main: int
    text: str | None = None


class _Frame(NamedTuple):
    """A subprogram that is being executed: its label, whether LinuxCNC's kind, and where it was called.

    `again`: how often M98 calls it once more, from row `begin`.
    """

    label: str
    own: bool
    unit: int
    row: int
    main: int
    again: int
    begin: int


class _EndError(Exception):
    """The program ends."""


class _Run:
    def __init__(self, unit: Unit) -> None:
        self.units = [unit]
        self.unit, self.row, self.main = 0, 0, -1
        self.known = Parameters()
        self.frames: list[_Frame] = []
        self.counts: dict[tuple[int, int, int], int] = {}
        self.pieces: list[_Piece] = []
        self.rows = self.orders = 0
        self.wrong: dict[tuple[int, int], Fault] = {}
        self.files: dict[str, Path] | None = None

    def result(self) -> Executed:
        """Execute the program from its first line, unless its O-words are wrong."""
        for fault in self.units[0].faults:
            self._wrong(fault.row, fault.problem, fault.advice)
        try:
            while not self.units[0].faults:
                self._step()
        except _EndError:
            pass
        return self._written()

    def _step(self) -> None:
        unit, row = self.units[self.unit], self.row
        at = unit.following[row]
        if at > row:
            self._take(row, at)
        if at == len(unit.source):
            if self.frames:
                end = "ENDSUB" if self.frames[-1].own else "M99"
                self._stop(at - 1, f"subprogram O{self.frames[-1].label} does not end with {end}")
            raise _EndError
        self.orders += 1
        if self.orders > _MOST_ORDERS or self.rows > _MOST_ROWS:
            self._stop(at, f"more than {_MOST_ORDERS:,} lines with parameters and O-words are executed", _ENDLESS)
        self.row = at + 1
        try:
            line = unit.at(at)
            if isinstance(line, Order):
                self._obey(at, line)
            elif isinstance(line, Block):
                self._execute(at, line)
            else:
                self._tape(at)
        except BlockError as cause:
            self._wrong(at, *cause.args)
            if isinstance(unit.lines.get(at), Order) or len(self.wrong) > MOST:
                raise _EndError from cause  # where it goes on is not known

    def _take(self, first: int, last: int, text: str | None = None) -> None:
        main = self.main if self.unit else -1
        self.pieces.append(_Piece(self.unit, first, last, main, text))
        self.rows += last - first

    def _wrong(self, row: int, problem: str, advice: str | None = None) -> None:
        """Note what is wrong; the line stays as it is written, so that what it changes is known to be unknown."""
        if (self.unit, row) not in self.wrong:
            self.wrong[self.unit, row] = Fault(self.rows, problem, advice, self.units[self.unit].source.line(row))
        self._take(row, row + 1, "")

    def _stop(self, row: int, problem: str, advice: str | None = None) -> None:
        self._wrong(row, problem, advice)
        raise _EndError

    def _tape(self, row: int) -> None:
        """Open the tape, or end it: the first % of a file opens it."""
        source = self.units[self.unit].source
        opens = not source.code[: source.ends[row] + 1].strip(b"\n" + MARK.encode())
        if self.unit == 0 and not self.frames:
            self._take(row, row + 1)
        if not opens and not self.frames:
            raise _EndError
        if not opens:
            self.row = len(source)

    def _execute(self, row: int, line: Block) -> None:
        text = line.text(self.known)
        orders = ordered(text) if "M" in text else {}
        if not orders:
            if text:
                self._take(row, row + 1, text)
            return
        if "98" in orders or "99" in orders:
            number = {match[1]: float(match[2]) for match in _CALL.finditer(text) if match[1]}
            rest = _CALL.sub("", text)
            if rest.strip("/"):
                self._take(row, row + 1, rest)
            if "98" in orders:
                self._call_number(row, number)
            else:
                self._return_number(row, number)
            return
        self._take(row, row + 1, text)
        raise _EndError

    def _call_number(self, row: int, number: dict[str, float]) -> None:
        if "P" not in number:
            raise BlockError("M98 without P", "Write M98 P100 L3: subprogram O100, three times.")
        label, times = str(whole(number["P"])), whole(number.get("L", 1.0))
        found = self._find(label, own=False)
        if found is None:
            advice = "Write M98 P100 L3 for three times." if number["P"] >= 1e4 and "L" not in number else None
            raise BlockError(f"subprogram O{label} is neither in this file nor in its folder", advice)
        if times > 0:
            self._enter(_Frame(label, False, self.unit, self.row, self.main, times - 1, found[1]), found[0], row)
            self.known.enter(None)

    def _return_number(self, row: int, number: dict[str, float]) -> None:
        if not self.frames:
            advice = "A program ends with M30. A subprogram is converted with the program that calls it."
            raise BlockError("M99 in a program that nothing has called: it would run without end", advice)
        if "P" in number:
            raise BlockError("M99 with P", "Returning to another line than that of the call is not read.")
        frame = self.frames[-1]
        if frame.own:
            raise BlockError(f"M99 in O{frame.label} SUB", f"It ends with O{frame.label} ENDSUB.")
        if frame.again:
            self.frames[-1] = frame._replace(again=frame.again - 1)
            self.row = frame.begin
            self.known.leave()
            self.known.enter(None)
            return
        self._leave()

    def _enter(self, frame: _Frame, unit: int, row: int) -> None:
        if len(self.frames) >= _DEEPEST - 1:
            advice = "Does one call itself without end?"
            raise BlockError(f"subprograms call each other more than {_DEEPEST - 1} levels deep", advice)
        self.frames.append(frame)
        if self.unit == 0:
            self.main = row
        self.unit, self.row = unit, frame.begin

    def _leave(self) -> None:
        frame = self.frames.pop()
        self.unit, self.row, self.main = frame.unit, frame.row, frame.main
        self.known.leave()

    def _obey(self, row: int, order: Order) -> None:
        unit, keyword = self.units[self.unit], order.keyword
        if self.wrong and keyword in ("IF", "ELSEIF", "WHILE", "REPEAT"):
            raise _EndError  # the condition may be wrong only because of what is wrong already
        link = unit.links.get(row, (row,))
        if keyword == "SUB":
            self.row = link[-1] + 1
        elif keyword in ("ENDSUB", "RETURN"):
            self._return(order)
        elif keyword == "CALL":
            self._call(row, order)
        elif keyword == "IF":
            self._branch(order, link)
        elif keyword in ("ELSEIF", "ELSE", "BREAK"):
            self.row = link[-1] + 1
        elif keyword == "WHILE" and row == link[0]:
            if order.values[0](self.known) == 0.0:
                self.row = link[-1] + 1
        elif keyword == "WHILE":
            if order.values[0](self.known) != 0.0:
                self.row = link[0] + 1
        elif keyword == "ENDWHILE":
            self.row = link[0]
        elif keyword == "CONTINUE":
            test = unit.at(link[-1])
            self.row = link[-1] if isinstance(test, Order) and test.keyword == "WHILE" else link[0]
        elif keyword in ("REPEAT", "ENDREPEAT"):
            self._repeat(order, link)

    def _branch(self, order: Order, link: tuple[int, ...]) -> None:
        unit = self.units[self.unit]
        for row in link[:-1]:
            branch = unit.at(row)
            self.row = row + 1
            if not isinstance(branch, Order) or not branch.values or branch.values[0](self.known) != 0.0:
                return
        self.row = link[-1] + 1

    def _repeat(self, order: Order, link: tuple[int, ...]) -> None:
        key = (len(self.frames), self.unit, link[0])
        if order.keyword == "REPEAT":
            self.counts[key] = int(np.floor(order.values[0](self.known) + 0.5))
        else:
            self.counts[key] -= 1
        self.row = (link[0] if self.counts[key] > 0 else link[-1]) + 1

    def _call(self, row: int, order: Order) -> None:
        label = order.label if isinstance(order.label, str) else str(whole(order.label(self.known)))
        arguments = [value(self.known) for value in order.values]
        found = self._find(label, own=True)
        if found is None:
            raise BlockError(f"subprogram O<{label}> is neither in this file nor in its folder", None)
        self._enter(_Frame(label, True, self.unit, self.row, self.main, 0, found[1]), found[0], row)
        self.known.enter(arguments)

    def _return(self, order: Order) -> None:
        if not self.frames or not self.frames[-1].own or self.frames[-1].label != order.label:
            raise BlockError(f"O{order.label} {order.keyword} outside of O{order.label} SUB", None)
        value = order.values[0](self.known) if order.values else 0.0
        self._leave()
        self.known.put("_value", value)
        self.known.put("_value_returned", float(len(order.values)))

    def _find(self, label: str, *, own: bool) -> tuple[int, int] | None:
        """Return file and first row of a subprogram."""
        for n in dict.fromkeys((self.unit, 0)):
            place = (self.units[n].subs if own else self.units[n].numbers).get(label)
            if place is not None:
                return n, place + 1
        loaded = self._loaded(label)
        if loaded is None:
            return None
        unit = self.units[loaded]
        place = (unit.subs if own else unit.numbers).get(label, -1)
        if own and place < 0:
            raise BlockError(f"{unit.document.name} has no O<{label}> SUB", None)
        return loaded, place + 1

    def _loaded(self, label: str) -> int | None:
        """Return the file of the folder that a subprogram stands in."""
        for n, unit in enumerate(self.units):
            if n and _stem(unit.document.name) == label:
                return n
        path = self._file(label)
        if path is None:
            return None
        try:
            document = replace(decode(path.name, path.read_bytes()), folder=str(path.parent))
        except OSError as cause:
            raise BlockError(f"subprogram O{label}: {path.name} cannot be read ({cause.strerror})", None) from cause
        except ProgramError as cause:
            raise BlockError(f"subprogram O{label}: {cause.problem}", None) from cause
        unit = Unit.of(document, words.split(document, line_starts(document.text)))
        if unit.faults:
            problem, line = unit.faults[0].problem, unit.faults[0].row + 1
            raise BlockError(f"subprogram O{label}: {path.name}:{line}: {problem}", None)
        self.units.append(unit)
        return len(self.units) - 1

    def _file(self, label: str) -> Path | None:
        main = self.units[0].document
        if self.files is None:
            self.files = {}
            folder = Path(main.folder) if main.folder else None
            for path in sorted(folder.iterdir()) if folder is not None and folder.is_dir() else ():
                if path.name != main.name and path.suffix.lower() in (*_EXTENSIONS, Path(main.name).suffix.lower()):
                    self.files[path.name.lower()] = path
        for extension in dict.fromkeys((Path(main.name).suffix.lower(), *_EXTENSIONS)):
            for name, path in self.files.items():
                if Path(name).suffix == extension and _stem(name) == label and path.is_file():
                    return path
        return None

    def _written(self) -> Executed:
        """Return the lines that were executed as one program."""
        units = self.units
        documents = tuple(unit.document for unit in units)
        code = b"\n" + b"".join(self._bytes())
        unit, first, last, main = (
            np.array(column) for column in zip(*(piece[:4] for piece in self.pieces), strict=True)
        )
        count = last - first
        row = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)
        document, main = np.repeat(unit, count), np.repeat(main, count)
        comments, rows = self._comments(document, row)
        ends = np.flatnonzero(np.frombuffer(code, dtype=np.uint8) == ord("\n"))
        source, line = Source(code, ends, comments, rows + 1), row + 1
        return Executed(
            source, documents, document, line, np.where(main < 0, line, main + 1), tuple(self.wrong.values())
        )

    def _bytes(self) -> Iterator[bytes]:
        sources = [(unit.source.code, unit.source.ends.tolist()) for unit in self.units]
        for piece in self.pieces:
            if piece.text is not None:
                yield piece.text.encode("ascii") + b"\n"
            else:
                code, ends = sources[piece.unit]
                yield code[ends[piece.first] + 1 : ends[piece.last] + 1]

    def _comments(self, document: Ints, row: Ints) -> tuple[tuple[str, ...], Ints]:
        """Return the comments of the lines executed, and the row of each."""
        texts: list[str] = []
        at: list[Ints] = []
        index: list[Ints] = []
        for n, unit in enumerate(self.units):
            rows = np.flatnonzero(document == n)
            lines = unit.source.comment_lines - 1
            begin, stop = np.searchsorted(lines, row[rows], "left"), np.searchsorted(lines, row[rows], "right")
            count = stop - begin
            at.append(np.repeat(rows, count))
            index.append(len(texts) + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - begin, count))
            texts += unit.source.comments
        order = np.argsort(np.concatenate(at), kind="stable")
        chosen = np.concatenate(index)[order].tolist()
        return tuple(texts[n] for n in chosen), np.concatenate(at)[order]


def _stem(file: str) -> str:
    """Return the label that a file is named by: ``O0100.nc`` → ``100``."""
    stem = Path(file).stem.lower()
    number = re.fullmatch(r"o?(\d+)", stem)
    return stem if number is None else str(int(number[1]))
