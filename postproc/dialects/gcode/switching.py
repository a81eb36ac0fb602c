"""What lines switch: spindle, coolant, tools, stops, the end of the program, M-codes of the shop.

- **M2, M30** end the program; spindle and coolant that still run are switched off there, as LinuxCNC does.
- **M6** stops the spindle first, as LinuxCNC does. Without a T before it nobody knows which tool is meant: an error
  where `[tools]` says that it matters, else a warning.
- **T M6**: the tool that `[tools]` has by this number; without `[tools]`, the cell's `[tool]` for all.
- **G43** makes a control take X Y Z as those of the tool tip, by a stored length. On the robot `$TOOL` holds the length
  and X Y Z are those of the tip anyway: G43 is accepted and changes nothing (but in a program that never says M6: there
  H is the tool). Nearly every CAM file has one.
- A new S while the spindle runs is an event like M3 with that speed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from msgspec import Struct

from postproc.cell import Cell
from postproc.dialects.gcode import codes
from postproc.dialects.gcode.blocks import BlockError
from postproc.errors import Issue, Level
from postproc.program import EventKind

_SPINDLE: dict[float, EventKind] = {3.0: "spindle_on", 4.0: "spindle_ccw", 5.0: "spindle_off"}


class RowEvent(Struct, frozen=True):
    """An event of a line: row of the line, whether it follows the motion of that line, kind and value of `Event`."""

    row: int
    after: bool
    kind: EventKind
    value: float = 0.0


class Switching:
    """What is switched, line after line.

    :ivar events: in order.
    :ivar tools: changes (row, tool number), in order.
    :ivar ended: whether the program has ended.
    """

    def __init__(self, cell: Cell, issues: list[Issue], is_known: Callable[[int, str], bool]) -> None:
        """Start with all switched off.

        :param issues: where to put what the user should know.
        :param is_known: tells whether somebody else reads a code of a line, such as ``M128``.
        """
        self.cell, self.issues, self.is_known = cell, issues, is_known
        self.events: list[RowEvent] = []
        self.tools: list[tuple[int, float]] = []
        self.ended = False
        self._spindle: EventKind = "spindle_off"
        self._coolant = False
        self._speed = 0.0
        self._tool: float | None = None
        self._mounted: set[float] = set()

    def read(self, row: int, m: Sequence[float], values: dict[str, float]) -> None:
        """Take the M codes, T and S of a block.

        :param values: its words by letter; what is used is taken away.
        :raises BlockError: a code is not known, or cannot be.
        """
        self._tool = values.pop("T", self._tool)
        if codes.CHANGE in m:
            self._change(row)
        self._turn(row, m, values.pop("S", None))
        for code in m:
            if code in codes.COOLANT:
                self._coolant = code != codes.COOLANT[-1]
                self._event(row, "coolant_on" if self._coolant else "coolant_off")
            elif code in codes.STOP:
                self.events.append(RowEvent(row, True, "stop"))
            elif code in codes.END:
                self._end(row)
        for code in m:
            if self.is_known(row, f"M{code:g}"):
                continue
            own = None if code in codes.READING else self.cell.m_codes.get(f"M{code:g}")
            if own is None and code in codes.OVERRIDES and values.pop("P", -1.0) in (0.0, 1.0):
                continue
            if own is None and code not in codes.ACCEPTED_M:
                raise BlockError(*codes.refusal("M", code))
            if own == []:  # nothing, with its words
                values.pop("P", None)
                values.pop("Q", None)
            if own:
                self.events.append(RowEvent(row, False, "m_code", code))

    def tool_length(self, row: int, length: float | None) -> None:
        """Take G43, with its H."""
        tools = self.cell.tools
        if not tools:
            message = "G43 has no effect: $TOOL holds the tool length, and X Y Z are those of the tool tip."
            self._tell("info", "tool-length", message, row)
        elif length and not self._mounted and f"{length:g}" in tools:
            self.tools.append((row, length))
            message = "There is no M6 before G43 H: the tool is taken from H."
            self._tell("info", "tool-length", message, row)
        elif length and length not in self._mounted and f"{length:g}" in tools:
            message = f"G43 H{length:g} with another tool in the spindle: $TOOL stays that of tool {self._tool or 0:g}."
            self._tell("warning", "tool-length", message, row, f"{length:g}")

    def dwell(self, row: int, seconds: float) -> None:
        """Take a G4."""
        self._event(row, "dwell", seconds)

    def _change(self, row: int) -> None:
        if self._spindle != "spindle_off":
            self._spindle = "spindle_off"
            self._event(row, "spindle_off")
        number = self._tool or 0.0
        self._event(row, "tool_change", number)
        self._mounted.add(number)
        if self._tool is None and self.cell.tools:
            raise BlockError("M6 without a T before it", "Say which of [tools] it is: T1 M6.")
        if self._tool is None:
            message = "M6 without a T before it: which tool is meant is not said."
            self._tell("warning", "tool-change", message, row)
        elif self.cell.tools and number:
            if f"{number:g}" not in self.cell.tools:
                raise BlockError(f"tool {number:g} is not in the cell", f"Give its $TOOL: [tools.{number:g}].")
            self.tools.append((row, number))
        elif len(self._mounted) > 1:
            message = "More than one tool is used: the cell's [tool] is taken for all of them, see [tools]."
            self._tell("warning", "tool-change", message, row)

    def _turn(self, row: int, m: Sequence[float], speed: float | None) -> None:
        if speed is not None:
            if speed < 0.0:
                raise BlockError("negative spindle speed", None)
            self._speed = speed
        switched = next((kind for code, kind in _SPINDLE.items() if code in m), None)
        self._spindle = switched or self._spindle
        if switched == "spindle_off":
            self._event(row, "spindle_off")
        elif switched or (speed is not None and self._spindle != "spindle_off"):
            self._event(row, self._spindle, self._speed)
            if self._speed == 0.0:
                self._tell("warning", "spindle-speed", "The spindle is started without a speed (S).", row)

    def _end(self, row: int) -> None:
        self.ended = True
        if self._spindle != "spindle_off":
            self.events.append(RowEvent(row, True, "spindle_off"))
        if self._coolant:
            self.events.append(RowEvent(row, True, "coolant_off"))

    def _event(self, row: int, kind: EventKind, value: float = 0.0) -> None:
        self.events.append(RowEvent(row, False, kind, value))

    def _tell(self, level: Level, kind: str, message: str, row: int, subject: str = "") -> None:
        self.issues.append(Issue(level, kind, message, row + 1, subject=subject))
