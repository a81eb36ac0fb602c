"""The lines of a program in the order in which a control executes them, with numbers where expressions stood.

Subprograms, loops and branches are written out: what comes out is a program of plain lines, which is then read like any
other, and each line of it knows where it stands. Runs of lines that hold neither parameters nor O-words are taken over
as they are, so that this costs little for a program whose subprograms are paths.
"""

from __future__ import annotations

import re

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.dialects.gcode import words
from postproc.dialects.gcode.blocks import BlockError, Fault
from postproc.dialects.gcode.control import Block, Order, Unit, is_controlled, ordered
from postproc.dialects.gcode.executed import Executed, Piece, put_together
from postproc.dialects.gcode.expressions import whole
from postproc.dialects.gcode.parameters import Parameters
from postproc.dialects.gcode.subprograms import Library
from postproc.dialects.gcode.words import MARK
from postproc.dialects.text import line_starts
from postproc.errors import MOST, SubprogramError
from postproc.program import Document

_MOST_ORDERS = 2_000_000
"""So many lines with parameters or O-words are executed at most: more are taken for an endless loop."""
_MOST_ROWS = 10_000_000
_DEEPEST = 10
"""Subprograms may call each other to this depth, as in LinuxCNC."""
_CALL = re.compile(r"([PL])([+-]?(?:\d+\.?\d*|\.\d+))|M0*9[89]")
_ENDLESS = "An endless loop? Check what ends it."


def executed(document: Document) -> Executed:
    """Execute what decides about the order of lines and about their numbers.

    :raises SubprogramError: there is nothing to be executed, only to be called.
    """
    source = words.split(document, line_starts(document.text))
    if is_controlled(source):
        unit = Unit.of(document, source)
        name = None if unit.faults else unit.only_defines()
        if name is not None:
            raise SubprogramError(
                f"this is a subprogram, {name}",
                file=document.name,
                advice="It is converted with each program that calls it: convert that.",
            )
        return _Run(unit).result()
    line = np.arange(1, len(source) + 1)
    return Executed(source, (document,), np.zeros(len(source), dtype=np.int64), line, line)


class _Frame(Struct, frozen=True):
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
        self.end = len(unit.source)
        self.library = Library(unit)
        self.units = self.library.units
        self.unit, self.row, self.main = 0, 0, -1
        self.known = Parameters()
        self.frames: list[_Frame] = []
        self.counts: dict[tuple[int, int, int], int] = {}
        self.pieces: list[Piece] = []
        self.rows = self.orders = 0
        self.wrong: dict[tuple[int, int], Fault] = {}

    def result(self) -> Executed:
        """Execute the program from its first line, unless its O-words are wrong."""
        for fault in self.units[0].faults:
            self._wrong(fault.row, fault.problem, fault.advice)
        try:
            while not self.units[0].faults:
                self._step()
        except _EndError:
            pass
        return put_together(self.units, self.pieces, list(self.wrong.values()), self.end)

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
        self.pieces.append(Piece(self.unit, first, last, main, text))
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
        if not opens and self.frames:
            self.row = len(source)
        elif not opens and source.goes_on(row):
            self._stop(row, *words.CUT_SHORT)
        elif not self.frames:
            self._take(row, row + 1)
            if not opens:
                raise _EndError

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
        self.end = row if self.unit == 0 else self.main
        raise _EndError

    def _call_number(self, row: int, number: dict[str, float]) -> None:
        if "P" not in number:
            raise BlockError("M98 without P", "Write M98 P100 L3: subprogram O100, three times.")
        label, times = str(whole(number["P"])), whole(number.get("L", 1.0))
        found = self.library.find(label, self.unit, own=False)
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
            self.frames[-1] = replace(frame, again=frame.again - 1)
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
        found = self.library.find(label, self.unit, own=True)
        if found is None:
            raise BlockError(f"subprogram O<{label}> is neither in this file nor in its folder", None)
        self._enter(_Frame(label, True, self.unit, self.row, self.main, 0, found[1]), found[0], row)
        self.known.enter(arguments)

    def _return(self, order: Order) -> None:
        frame = self.frames[-1] if self.frames else None
        if frame is None or not frame.own or (order.keyword == "ENDSUB" and frame.label != order.label):
            raise BlockError(f"O{order.label} {order.keyword} outside of O{order.label} SUB", None)
        value = order.values[0](self.known) if order.values else 0.0
        self._leave()
        self.known.put("_value", value)
        self.known.put("_value_returned", float(len(order.values)))
