"""What the blocks that are not plain motions mean: modes, events, and what the user should know.

Decisions, where controls differ:

- **P** of a cycle is in seconds, as that of G4.
- **/** (block delete): the block is read, as with the switch in its off position, the default of rs274; an issue says
  so.
- **G61, G61.1** switch approximate positioning off, **G64** on again. ``G64 P`` allows the path to leave a corner by P:
  the approximation distance is then at most 2·P, by which no corner is rounded by more than P (the parabola that the
  controller drives leaves the corner by half the distance, times the sine of half the turn).
- **G80** ends a motion mode, as in LinuxCNC: coordinates after it need a G0…G3 first.
- **G4 P** is in seconds, as in LinuxCNC. More than a minute gives a warning: some controls count milliseconds.
- **F** belongs to the units of its own block, also when G20 or G21 stands in the same block.
- **A0, U0** (and B, C, V, W) keep an axis that the robot has not at zero: they are read over, and an issue says so.
- **%**: the first one opens the program (text after it is ignored), the next one ends it; a program that begins with
  % and has no end is incomplete. A closing % without an opening one is accepted.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from msgspec import Struct

from postproc.cell import Cell
from postproc.dialects.gcode import codes
from postproc.dialects.gcode.blocks import BlockError, Fault, words_of
from postproc.dialects.gcode.places import Origin, Places, Return
from postproc.dialects.gcode.switching import RowEvent, Switching
from postproc.dialects.gcode.words import COLUMNS, CUT_SHORT, MARK, Source
from postproc.errors import MOST, Issue, Level
from postproc.frames import M_PER_MM, Array
from postproc.program import Ints

_UNITS_AGAIN = {70.0: 20.0, 71.0: 21.0}
MM_PER_UNIT = {20.0: 25.4, 21.0: 1.0}
_LONG_DWELL_S = 60.0
_OPENING = re.compile(rf"[\n{MARK}]*\n{MARK}*%".encode())
_DELETE = re.compile(rf"{MARK}*/[1-9]?")


class Modes(Struct, frozen=True, eq=False):
    """What the blocks that are not plain say besides coordinates.

    :param rows: number of lines that belong to the program (up to M2, M30 or the closing ``%``); lines after the first
        few faults are none of them.
    :param changes: for each modal group of `codes.GROUPS` its changes (row, code), in order.
    :param blends: changes (row, approximation distance [m]), in order.
    :param roundings: changes (row, what corners may be rounded by [m]), in order; NaN: what the cell says.
    :param origins: changes of the program frame other than by G54…, in order.
    :param returns: row → what goes to a place of the machine there.
    :param tools: changes (row, tool number), in order.
    :param tip: changes (row, whether X, Y, Z are those of the tip although rotary axes turn: 1 or 0), in order.
    :param dwells: rows with G4.
    :param row_events: what the lines switch, in order.
    :param issues: what the user should know.
    :param faults: blocks that cannot be read, in order.
    :param complete: False if an end that must be there is missing.
    """

    rows: int
    changes: Mapping[str, Sequence[tuple[int, float]]]
    blends: Sequence[tuple[int, float]]
    roundings: Sequence[tuple[int, float]]
    origins: Sequence[Origin]
    returns: Mapping[int, Return]
    tools: Sequence[tuple[int, float]]
    tip: Sequence[tuple[int, float]]
    dwells: Sequence[int]
    row_events: Sequence[RowEvent]
    issues: Sequence[Issue]
    faults: Sequence[Fault]
    complete: bool = True


def read_modes(
    source: Source, odd: Ints, columns: Mapping[str, Array], cell: Cell, known: Sequence[Fault] = ()
) -> Modes:
    """Read the lines `odd` and put their coordinates, feeds and motion codes into `columns`.

    :param source: the program.
    :param odd: (n,) rows of the lines to read, ascending.
    :param columns: as `words.read_plain` returns them; rows of `odd` are filled in.
    :param cell: its work offsets, tools, M-codes, approximation distance, and what G28 and G53 mean.
    :param known: what is wrong with lines that are executed.
    """
    opening = _OPENING.match(source.code)
    tape = -1 if opening is None else opening[0].count(b"\n") - 1
    reader = _Reader(columns, cell, tape)
    faults: list[Fault] = []
    rows = len(source)
    for row in odd.tolist():
        code = source.line(row)
        try:
            reader.read(row, code)
        except BlockError as cause:
            faults.append(Fault(row, cause.args[0], cause.args[1], code))
        if reader.ended or len(faults) > MOST:
            rows = row + 1
            if not known and source.goes_on(row):
                faults.append(Fault(row, *CUT_SHORT))
            break
    faults = sorted([*faults, *(fault for fault in known if fault.row < rows)], key=lambda fault: fault.row)
    complete = reader.ended or tape < 0 or len(faults) > MOST or bool(known)
    if not reader.ended and complete:
        message = "The program ends without M2, M30 or %: check that the file is complete."
        reader.issues.append(Issue("warning", "program-end", message, rows))
    return Modes(
        rows=rows,
        changes=reader.changes,
        blends=reader.blends,
        roundings=reader.roundings,
        origins=reader.places.origins,
        returns=reader.places.returns,
        tools=reader.switching.tools,
        tip=reader.tip,
        dwells=reader.dwells,
        row_events=reader.switching.events,
        issues=reader.issues,
        faults=faults,
        complete=complete,
    )


class _Reader:
    """The state that carries over from block to block, and what was read so far."""

    def __init__(self, columns: Mapping[str, Array], cell: Cell, tape: int) -> None:
        self.columns, self.cell, self.tape = columns, cell, tape
        self.approximation = cell.gcode.approximation_mm * M_PER_MM
        self.changes: dict[str, list[tuple[int, float]]] = {group: [] for group in codes.GROUPS}
        self.blends: list[tuple[int, float]] = []
        self.roundings: list[tuple[int, float]] = []
        self.dwells: list[int] = []
        self.smooth: set[int] = set()
        self.issues: list[Issue] = []
        self.places, self.switching = Places(cell), Switching(cell, self.issues, self._tip)
        self.letters = [letter for letter in COLUMNS if letter not in "ABC" or letter in self.places.rotary]
        self.tip: list[tuple[int, float]] = []
        rotary = cell.rotary
        self.tip_on, self.tip_off = ((), ()) if rotary is None else (tuple(rotary.tcp_on), tuple(rotary.tcp_off))
        if rotary is not None and not rotary.tcp_on:
            self.tip_on, self.tip_off = ("G43.4", "M128"), ("M129",)
        self.mm_per_unit = 1.0
        self.taped = False

    @property
    def ended(self) -> bool:
        """Whether the program has ended."""
        return self.taped or self.switching.ended

    def read(self, row: int, code: str) -> None:
        if code.lstrip(MARK).startswith("%"):
            self.taped = row != self.tape
            return
        deleted = _DELETE.match(code)
        if deleted:
            code = code[deleted.end() :]
            self._tell("info", "block-delete", "Blocks with / are executed (block delete switched off).", row)
        words = words_of(code)
        g = [value for letter, value in words if letter == "G"]
        m = [value for letter, value in words if letter == "M"]
        values = {letter: value for letter, value in words if letter not in "GM"}
        refused: BlockError | None = None
        for step in (
            self._smoothing,
            self._modes,
            self._places,
            self._dwell,
            self._blending,
            self._switching,
            self._coordinates,
        ):
            try:
                step(row, g, m, values)
            except BlockError as cause:  # what is understood of the block is taken over: the next blocks build on it
                refused = refused or cause
        if refused is not None:
            raise refused

    def _coordinates(self, row: int, g: Sequence[float], _: Sequence[float], values: dict[str, float]) -> None:
        if codes.TOOL_LENGTH in g or (43.4 in g and self.places.rotary):
            self.switching.tool_length(row, values.pop("H", None))
            values.pop("D", None)  # the number of a radius, which only G41 and G42 use
        elif values.get("H") == 0.0:
            del values["H"]
        for letter in codes.OTHER_AXES:
            if values.get(letter) == 0.0 and letter not in self.places.rotary:
                del values[letter]
                message = f"{letter}0 is read over: the robot has no axis {letter}."
                self._tell("info", "other-axis", message, row, letter)
        backwards = values.get("F", 0.0) < 0.0 and values.pop("F") < 0.0
        for letter in self.letters:
            if letter in values:
                self.columns[letter][row] = values.pop(letter)
        for letter in values:
            raise BlockError(f"{letter} word without a code that uses it", codes.WORD_ADVICE.get(letter))
        if backwards:
            raise BlockError("negative feed", None)

    def _tell(self, level: Level, kind: str, message: str, row: int, subject: str = "") -> None:
        self.issues.append(Issue(level, kind, message, row + 1, subject=subject))

    def _modes(self, row: int, g: Sequence[float], _: object, values: Mapping[str, float]) -> None:
        refused: tuple[str, str | None] | None = None
        for code in g:
            group = codes.GROUP_OF.get(code)
            if group == "offset" and f"G{code:g}" not in self.places.offsets:
                advice = f"Give its place in $BASE in the cell: [work_offsets.G{code:g}]."
                refused = refused or (f"work offset G{code:g} is not in the cell", advice)
            elif group is not None:
                self.changes[group].append((row, code))
                if group == "units":
                    self.mm_per_unit = MM_PER_UNIT[code]
            elif code in codes.MOVING or (code == codes.CANCEL_CYCLE and not set(g) & set(codes.MOVING)):
                self.columns["G"][row] = code
                if code == 84.0 and self.cell.gcode.spindle_on and not self.cell.gcode.spindle_ccw:
                    advice = "Give spindle_ccw in [gcode] of the cell: the KRL lines that turn the spindle backwards."
                    raise BlockError("G84 needs a spindle that is reversed at the bottom", advice)
            elif (
                self._tip(row, f"G{code:g}")
                or self._said_before(code)
                or (row in self.smooth and code in codes.SMOOTHING)
            ):
                pass
            elif code not in codes.ACCEPTED_G or (code == codes.SCALE_OFF and set(values) & set("XYZIJKPS")):
                refused = refused or codes.refusal("G", code)
        if refused is not None:
            raise BlockError(*refused)

    def _places(self, row: int, g: Sequence[float], _: Sequence[float], values: dict[str, float]) -> None:
        self.places.read(row, g, float(self.columns["G"][row]), values, self.mm_per_unit)

    def _switching(self, row: int, _: Sequence[float], m: Sequence[float], values: dict[str, float]) -> None:
        self.switching.read(row, m, values)

    def _smoothing(self, row: int, g: Sequence[float], _: object, values: dict[str, float]) -> None:
        """Read over modes of look-ahead: how exactly corners are cut the cell says."""
        for code in g:
            own = codes.SMOOTHING.get(code)
            if own is None or not set(values) <= set(own):
                continue
            if values or code == 187.0:
                self.smooth.add(row)
                values.clear()
                message = f"G{code:g} is read over: how exactly corners are cut says [gcode] corner_tolerance_mm."
                self._tell("info", "smoothing", message, row, f"G{code:g}")

    def _said_before(self, code: float) -> bool:
        """Return whether G70 or G71, which Vectric's posts write behind G20 or G21, say nothing else."""
        return bool(self.changes["units"]) and self.changes["units"][-1][1] == _UNITS_AGAIN.get(code)

    def _tip(self, row: int, code: str) -> bool:
        """Return whether a code says that X, Y, Z are those of the tip, or no more, although the axes turn."""
        on = code in self.tip_on
        if on or code in self.tip_off:
            self.tip.append((row, float(on)))
            return True
        return False

    def _dwell(self, row: int, g: Sequence[float], _: Sequence[float], values: dict[str, float]) -> None:
        if codes.DWELL in g:
            if not values.get("P", -1.0) >= 0.0:
                raise BlockError("G4 without a time", "Write G4 P with the time in seconds.")
            if self.columns["G"][row] in (2.0, 3.0):
                raise BlockError("G4 in one block with an arc", "Write one block for each.")
            self.dwells.append(row)
            seconds = values.pop("P")
            self.switching.dwell(row, seconds)
            if seconds > _LONG_DWELL_S:
                message = f"Dwell of {seconds:g} s: P counts seconds here, on some controls milliseconds."
                self._tell("warning", "dwell", message, row)

    def _blending(self, row: int, g: Sequence[float], _: Sequence[float], values: dict[str, float]) -> None:
        if codes.BLENDING in g:
            limit = values.pop("P", None)
            values.pop("Q", None)
            distance = self.approximation
            if limit is not None:
                distance = min(distance, 2.0 * max(limit, 0.0) * self.mm_per_unit * M_PER_MM)
            self.blends.append((row, distance))
            given = float("nan") if limit is None else max(limit, 0.0) * self.mm_per_unit * M_PER_MM
            self.roundings.append((row, given))
        elif set(g) & set(codes.EXACT):
            self.blends.append((row, 0.0))
