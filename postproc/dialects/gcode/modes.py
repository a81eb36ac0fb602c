"""Blocks that are not plain motions: modal state, spindle, tools, origins, machine positions, stops.

Decisions where controls differ:

- **P** of a cycle and of **G4** is in seconds, as in LinuxCNC. More than a minute in G4 gives a warning, because some
  controls count milliseconds. Without P the seconds of G4 are X or U (Fanuc), F (Sinumerik) or S (Marlin), which then
  set neither feed nor speed.
- **/** (block delete): the block is executed, as with the switch off, the default of rs274. An issue says so.
- **G61, G61.1** switch approximate positioning off, **G64** switches it on again. ``G64 P`` allows the path to leave a
  corner by P. The approximation distance is then at most 2·P: the parabola of the controller leaves the corner by half
  the distance times the sine of half the turn, so no corner is rounded by more than P.
- **G80** ends a motion mode, as in LinuxCNC: coordinates after it need a G0…G3 first. A retract along the tool, and
  moves at heights to which the program has moved in rapid, are rapids, as on Fanuc controls, whose posts rely on it.
- **G41, G42** with D0 are without effect, and all where the cell states that the offsets hold wear only. Others are
  refused: the radius is not in the program.
- **F** is in the units of its own block, also if G20 or G21 is in the same block.
- **A0, U0** (and B, C, V, W) keep an axis at zero that the robot does not have: they are ignored, and an issue says so.
- **%**: the first one opens the program (text after it is ignored), the next one ends it. A program that begins with %
  and has no end is incomplete. A closing % without an opening one is accepted.
- **M2, M30** end the program and switch off spindle and coolant, as in LinuxCNC.
- **M6** stops the spindle first, as in LinuxCNC. Without a T before it the tool is unknown: an error if the cell has
  `[tools]`, else a warning.
- **T M6** selects the tool of this number in `[tools]`; without `[tools]`, the cell's `[tool]` holds for all.
- **G43** makes a control apply a stored tool length, so that X Y Z are those of the tool tip. On the robot `$TOOL`
  contains the length and X Y Z are always those of the tip. So G43 is accepted without effect; only in a program
  without M6 its H selects the tool. Nearly every CAM program has a G43.
- A new S while the spindle turns is an event like M3 with that speed.
- **G28, G30, G53** go to positions of the machine; `[machine]` of the cell says what they mean on the robot. Words of
  G28 and G30 define an intermediate point only; letters without numbers name axes alone. Without `home` the tool stays
  above its place.
- **$H** of Grbl is G28 without an intermediate point. Other commands to Grbl that only show something or release an
  alarm ($$, $G, $I, $N, $X, ?) have no effect. Source: Grbl v1.1, "Commands" and "Interface".
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from msgspec import Struct

from postproc.cell import FIXED_M_CODES, TURNED_OFFSET, TURNED_OFFSET_ADVICE, Cell, DwellUnit, Rotary
from postproc.dialects.gcode import codes
from postproc.dialects.gcode.words import (
    COLUMNS,
    COMMENT_MARK,
    EARLY_PERCENT,
    BlockError,
    Fault,
    Source,
    Words,
    words_of,
)
from postproc.errors import MAX_ERRORS, Issue, Level
from postproc.frames import M_PER_MM, MM_PER_INCH
from postproc.program import EventKind, Ints

_SPINDLE: dict[float, EventKind] = {3.0: "spindle_on", 4.0: "spindle_ccw", 5.0: "spindle_off"}


class RowEvent(Struct, frozen=True):
    """An event of a line.

    :param row: row of the line.
    :param is_after_motion: True if it follows the motion of the line, False if it precedes it.
    :param kind: see `EventKind`; `value`: see `Event`.
    """

    row: int
    is_after_motion: bool
    kind: EventKind
    value: float = 0.0


class Switching:
    """State of spindle, coolant and tools, line by line.

    :ivar events: in order of lines.
    :ivar tools: changes (row, tool number), in order.
    :ivar ended: whether the program has ended.
    """

    def __init__(self, cell: Cell, issues: list[Issue], reads_code: Callable[[int, str], bool]) -> None:
        """Begin with spindle and coolant off and no tool.

        :param issues: list to which remarks are added.
        :param reads_code: function of a row and an M code such as ``M128``: reads the code if it switches
            tool-centre-point control, and returns whether it does.
        """
        self.cell, self.issues, self.reads_code = cell, issues, reads_code
        self.events: list[RowEvent] = []
        self.tools: list[tuple[int, float]] = []
        self.ended = False
        self._spindle: EventKind = "spindle_off"
        self._coolant = False
        self._speed = 0.0
        self._tool: float | None = None
        """Selected by T; M6 mounts it."""
        self._spindle_tool: float | None = None

    def read(self, row: int, m: Sequence[float], values: dict[str, float]) -> None:
        """Read the M codes, T and S of a block; add its events and tool changes.

        :param row: row of the block; `m`: its M codes.
        :param values: its other words by letter; words that are used are removed.
        :raises BlockError: a code is unknown or impossible.
        """
        self._tool = values.pop("T", self._tool)
        self._ignore_spindle_power(row, m, values)
        if codes.CHANGE in m:
            self._add_tool_change(row)
        self._read_spindle(row, m, values.pop("S", None))
        for code in m:
            if code in codes.COOLANT:
                self._coolant = code != codes.COOLANT[-1]
                self._add_event(row, "coolant_on" if self._coolant else "coolant_off")
            elif code in codes.STOP:
                self._add_event(row, "stop", is_after_motion=True)
            elif code in codes.END:
                self._end_program(row)
        for code in m:
            if not self.reads_code(row, f"M{code:g}"):
                self._read_machine_code(row, code, values)

    def _read_machine_code(self, row: int, code: float, values: dict[str, float]) -> None:
        """Record an M code for which the cell has KRL lines; accept a code without effect.

        :param row: row of the block; `code`: number of the M code.
        :param values: words of the block by letter; P and Q are removed if they belong to the code.
        :raises BlockError: the code is unknown or impossible.
        """
        cell_lines = None if code in FIXED_M_CODES else self.cell.m_codes.get(f"M{code:g}")
        if cell_lines is None and code in codes.OVERRIDES and values.pop("P", -1.0) in (0.0, 1.0):  # −1: no P
            return
        if cell_lines is None and code not in codes.ACCEPTED_M:
            raise BlockError(*codes.refusal("M", code))
        if cell_lines == []:  # without effect, and so are its words
            values.pop("P", None)
            values.pop("Q", None)
        if cell_lines:
            self._add_event(row, "m_code", code)

    def check_tool_length(self, row: int, length: float | None) -> None:
        """Check G43 against the tool in the spindle; add a remark if H names another tool.

        In a cell with [tools], H selects the tool before the first M6.

        :param row: row of the block.
        :param length: number of the stored tool length (H); None or 0: the block has none.
        """
        tools = self.cell.tools
        mounted_tool = self._tool if self._spindle_tool is None else self._spindle_tool
        if not tools:
            message = "G43 has no effect: $TOOL contains the tool length, and X Y Z are those of the tool tip."
            self._add_remark("info", "tool-length", message, row)
            if length and mounted_tool and length != mounted_tool:
                message = (
                    f"G43 H{length:g} with tool {mounted_tool:g}: the length of another tool. Its tip is elsewhere if "
                    f"[tool] of the cell is not that of tool {mounted_tool:g}."
                )
                self._add_remark("warning", "tool-length", message, row, f"{length:g}")
        elif length and self._spindle_tool is None and f"{length:g}" in tools:
            self.tools.append((row, length))
            message = "There is no M6 before G43: the tool is selected by H."
            self._add_remark("info", "tool-length", message, row)
        elif length and length != mounted_tool and f"{length:g}" in tools:
            message = f"G43 H{length:g} is not the tool in the spindle: $TOOL of tool {mounted_tool or 0:g} is used."
            self._add_remark("warning", "tool-length", message, row, f"{length:g}")

    def add_dwell(self, row: int, seconds: float) -> None:
        """Record a dwell (G4) [s] of the block in a row."""
        self._add_event(row, "dwell", seconds)

    def _add_tool_change(self, row: int) -> None:
        """Record a tool change (M6) to the tool that T has selected, which stops the spindle.

        :raises BlockError: the cell has [tools], and T is missing or names a tool that is not among them.
        """
        if self._spindle != "spindle_off":
            self._spindle = "spindle_off"
            self._add_event(row, "spindle_off")
        number = self._tool or 0.0
        self._add_event(row, "tool_change", number)
        self._spindle_tool = number
        if self._tool is None and self.cell.tools:
            raise BlockError("M6 without a T before it", "Write the number of the tool in [tools]: T1 M6.")
        if self._tool is None:
            message = "M6 without a T before it: the tool is unknown."
            self._add_remark("warning", "tool-change", message, row)
        elif self.cell.tools and number:
            if f"{number:g}" not in self.cell.tools:
                raise BlockError(f"tool {number:g} is not in the cell", f"Give its $TOOL: [tools.{number:g}].")
            self.tools.append((row, number))

    def _ignore_spindle_power(self, row: int, m: Sequence[float], values: dict[str, float]) -> None:
        """Ignore P of M3 and M4 with a warning: on Snapmaker machines it is a share of an unknown full speed.

        A block with further words than P and S is left alone, because P may belong to a code.

        :param row: row of the block; `m`: its M codes; `values`: its other words by letter, from which P is removed.
        :raises BlockError: the lines of the cell need the speed in rpm.
        """
        if "P" not in values or not set(m) & set(codes.SPINDLE[:2]) or set(values) - {"P", "S"}:
            return
        gcode = self.cell.gcode
        if any("{S}" in line for line in (*(gcode.spindle_on or ()), *(gcode.spindle_ccw or ()))):
            problem = f"M3 P{values['P']:g}: the speed is a share of the full one (Snapmaker)"
            raise BlockError(problem, "Write S with the speed in rpm instead of P: spindle_on of the cell needs it.")
        message = (
            f"P{values.pop('P'):g} of M3 is ignored: a share of the full speed (Snapmaker). Set the speed by hand."
        )
        self._add_remark("warning", "spindle-speed", message, row)

    def _read_spindle(self, row: int, m: Sequence[float], speed: float | None) -> None:
        """Record the spindle speed, and M3, M4 or M5; a new speed of a turning spindle is an event too.

        :param row: row of the block; `m`: its M codes; `speed`: its S [1/min], or None.
        :raises BlockError: the speed is negative.
        """
        if speed is not None:
            if speed < 0.0:
                raise BlockError("negative spindle speed", None)
            self._speed = speed
        command = next((kind for code, kind in _SPINDLE.items() if code in m), None)  # M3, M4 or M5
        self._spindle = command or self._spindle
        has_new_speed = speed is not None and self._spindle != "spindle_off"
        if command == "spindle_off":
            self._add_event(row, "spindle_off")
        elif command or has_new_speed:
            self._add_event(row, self._spindle, self._speed)
            if self._speed == 0.0:
                self._add_remark(
                    "warning", "spindle-speed", "The spindle starts without a speed. Program S before M3 or M4.", row
                )

    def _end_program(self, row: int) -> None:
        """End the program: switch spindle and coolant off after the motion of the block in a row."""
        self.ended = True
        if self._spindle != "spindle_off":
            self._add_event(row, "spindle_off", is_after_motion=True)
        if self._coolant:
            self._add_event(row, "coolant_off", is_after_motion=True)

    def _add_event(self, row: int, kind: EventKind, value: float = 0.0, *, is_after_motion: bool = False) -> None:
        """Record an event of the block in a row.

        :param value: see `Event`.
        :param is_after_motion: True if the event follows the motion of the block, False if it precedes it.
        """
        self.events.append(RowEvent(row, is_after_motion, kind, value))

    def _add_remark(self, level: Level, kind: str, message: str, row: int, subject: str = "") -> None:
        """Add a remark on the line in a row (from 0) for the user; `subject`: see `Issue`."""
        self.issues.append(Issue(level, kind, message, row + 1, subject=subject))


TCP_ON = ("G43.4", "M128")
"""Codes that switch tool-centre-point control on (Fanuc, Heidenhain), where the cell names none."""
DIRECTIONS_ON = ("G43.5",)
"""Codes that switch it on and make I, J, K of G0 and G1 the direction of the tool."""
TCP_OFF = ("G49", "G43", "M129")
"""Codes that switch it off, where the cell names none. G43 and G49 are in one modal group with G43.4."""


def tip_codes(rotary: Rotary) -> tuple[str, ...]:
    """Return the codes that switch tool-centre-point control on where the cell names none."""
    return DIRECTIONS_ON if rotary.kind == "vector" else TCP_ON


class TipControl:
    """State of tool-centre-point control, line by line.

    :ivar changes: (row, 1 if it is on, else 0), in order.
    """

    def __init__(self, rotary: Rotary | None) -> None:
        """Take the codes of the cell, or `tip_codes` and `TCP_OFF` if it names none.

        :param rotary: rotary axes of the cell; None: it has none, and no code switches tool-centre-point control.
        """
        self.changes: list[tuple[int, float]] = []
        self._on_codes: tuple[str, ...] = ()
        self._off_codes: tuple[str, ...] = ()
        if rotary is not None and rotary.tcp_on:
            self._on_codes, self._off_codes = tuple(rotary.tcp_on), tuple(rotary.tcp_off)
        elif rotary is not None:
            self._on_codes, self._off_codes = tip_codes(rotary), TCP_OFF

    def read(self, row: int, code: str) -> bool:
        """Record a code, such as ``M128``, if it switches tool-centre-point control; return whether it does."""
        is_on = code in self._on_codes
        if is_on or code in self._off_codes:
            self.changes.append((row, float(is_on)))
            return True
        return False


class Origin(Struct, frozen=True):
    """A change of the program frame by G10, G52 or G92 to G92.3; lengths in mm.

    :ivar code: number of the G code.
    :ivar axes: axis 0…2 → its word.
    :ivar system: work offset that G10 sets: 1 for G54 to 9 for G59.3, 0 for the active work offset.
    :ivar rotation_deg: R of G10: rotation of the work offset about Z [deg]; None without R.
    :ivar is_here: whether the words are the coordinates of the present position (G10 L20).
    """

    row: int
    code: float
    axes: Mapping[int, float]
    system: int = 0
    rotation_deg: float | None = None
    is_here: bool = False


class Return(Struct, frozen=True):
    """A line with G28, G30 or G53: its axes with their words [mm], NaN where it has the letter alone."""

    row: int
    code: float
    axes: Mapping[int, float]


class FrameCodes:
    """Reader of codes that change the program frame (G10, G52, G92 …) or go to machine positions (G28, G30, G53).

    :ivar rotary: letters of the rotary axes.
    :ivar offsets: names of the work offsets that the cell or the program has set.
    :ivar origins: changes of the program frame, in order.
    :ivar returns: row → move to a machine position.
    """

    def __init__(self, cell: Cell) -> None:
        self.machine = cell.machine
        self.rotary = "" if cell.rotary is None else "".join(cell.rotary.axes)
        self.offsets = {"G54", *cell.work_offsets}
        self.origins: list[Origin] = []
        self.returns: dict[int, Return] = {}
        self._has_shift = False

    def read(self, row: int, g: Sequence[float], motion: float, values: dict[str, float], mm_per_unit: float) -> None:
        """Record the code of a block that changes the program frame or goes to a machine position, if it has one.

        :param row: row of the block; `g`: its G codes; `motion`: its motion code, or NaN.
        :param values: its words by letter; X, Y, Z and words of G10 are removed, rotary axes are set to 0.
        :param mm_per_unit: length of the active unit [mm].
        :raises BlockError: the code cannot be executed on the robot.
        """
        frame_codes = [code for code in g if code in codes.ORIGINS or code in codes.RETURNS]
        if not frame_codes:
            return
        position_words = {letter: values.pop(letter) for letter in "XYZ" if letter in values}
        rotary_letters = [letter for letter in self.rotary if letter in values]
        if rotary_letters and (frame_codes[0] in codes.ORIGINS or self.machine.home_joints is None):
            raise BlockError(
                f"{rotary_letters[0]} in a block with G{frame_codes[0]:g}", "Write X, Y and Z alone there."
            )
        for letter in rotary_letters:
            values[letter] = 0.0  # at home the axes are at zero
        axes = {"XYZ".index(letter): value * mm_per_unit for letter, value in position_words.items()}
        conflicts = [f"G{code:g}" for code in g if code in frame_codes or code in (2.0, 3.0, *codes.CYCLES)]
        if len(conflicts) > 1:
            raise BlockError(
                f"{conflicts[0]} and {conflicts[1]} in one block use the same words", "Write one block for each."
            )
        code = frame_codes[0]
        if code in codes.RETURNS:
            self._add_return(row, code, motion, axes)
        elif code == codes.STORE:
            self._add_work_offset(row, axes, values)
        else:
            self._add_shift(row, code, axes)

    def _add_shift(self, row: int, code: float, axes: Mapping[int, float]) -> None:
        """Record G52, G92 or G92.1 to G92.3.

        :param row: row of the block; `code`: number of the G code; `axes`: axis 0…2 → its word [mm].
        :raises BlockError: G52 or G92 has no axis, or G92.3 has no earlier G52 or G92.
        """
        if code in (codes.LOCAL, codes.SHIFT) and not axes:
            raise BlockError(f"G{code:g} without X, Y or Z", None)
        if code == codes.SHIFT_ON and not self._has_shift:
            raise BlockError(
                "G92.3 restores an offset that the program has not set", "Set it with G92 before, or remove G92.3."
            )
        self._has_shift |= code in (codes.LOCAL, codes.SHIFT)
        self.origins.append(Origin(row, code, axes))

    def _add_return(self, row: int, code: float, motion: float, axes: Mapping[int, float]) -> None:
        """Record G28, G30 or G53.

        :param row: row of the block; `code`: number of the G code; `motion`: motion code of the block, or NaN.
        :param axes: axis 0…2 → its word [mm].
        :raises BlockError: the cell states neither home nor a clearance height, or G53 is in a block with G1 to G3.
        """
        machine, name = self.machine, f"G{code:g}"
        if machine.home is None and machine.clearance_Z is None:
            advice = "Give [machine] clearance_Z or home in the cell, or remove the block."
            raise BlockError(f"{name} is not supported without [machine] in the cell", advice)
        if code == codes.MACHINE and motion in (1.0, 2.0, 3.0):
            advice = "Use G53 with G0 only, or write the move in coordinates of the part."
            raise BlockError(f"{name} with G{motion:g}", advice)
        self.returns[row] = Return(row, code, axes)

    def _add_work_offset(self, row: int, axes: Mapping[int, float], values: dict[str, float]) -> None:
        """Record a work offset that the program sets: G10 L2 by its frame, G10 L20 by the present coordinates.

        :param row: row of the block; `axes`: axis 0…2 → its word [mm].
        :param values: other words of the block by letter, from which L, P and R are removed.
        :raises BlockError: G10 sets something else, or P names no work offset.
        """
        setting, rotation_deg = values.pop("L", 0.0), values.pop("R", None)  # L says what G10 sets
        system = values.pop("P", -1.0)  # −1, which names no work offset: no P
        if setting not in (2.0, 20.0) or (setting == 20.0 and rotation_deg is not None):
            raise BlockError(f"G10 L{setting:g} is not supported", "Tools are in the cell: [tools.1] …")
        if system not in range(10):
            raise BlockError("G10 without a work offset", "Write P1 for G54 … P9 for G59.3, P0 for the active one.")
        number = int(system)
        if number:
            self.offsets.add(f"G{codes.WORK_OFFSETS[number - 1]:g}")
        is_here = setting == 20.0
        self.origins.append(Origin(row, codes.STORE, axes, system=number, rotation_deg=rotation_deg, is_here=is_here))


_UNIT_SYNONYMS = {70.0: 20.0, 71.0: 21.0}
MM_PER_UNIT = {20.0: MM_PER_INCH, 21.0: 1.0}
_LEAST_MILLISECONDS = 10.0
"""Least time of a dwell that may be in milliseconds: nobody waits for less than a hundredth of a second."""
_TIME_WITH_POINT = re.compile(r"[PXU][+]?[0-9]*\.")
_P_WITH_POINT = re.compile(r"P[+]?[0-9]*\.")
_GRBL_HOMING = re.compile(r"\$H([XYZ]?)")
_GRBL_WITHOUT_MOTION = frozenset(("$", "$$", "$G", "$I", "$N", "$X", "$?"))
"""Commands to Grbl; ``$?`` is what `words.split` makes of a line with ? alone."""
_OPENING_PERCENT = re.compile(rf"[\n{COMMENT_MARK}]*\n{COMMENT_MARK}*%".encode())
_DELETE_MARK = re.compile(rf"{COMMENT_MARK}*/[1-9]?")


def dwell_time(word: str, number: float, unit: DwellUnit | None, *, has_point: bool = False) -> float:
    """Return the time of a dwell [s].

    LinuxCNC and Grbl count in seconds. Fanuc, Haas and Mach3 count in milliseconds, but Fanuc and Haas read a number
    with a decimal point in seconds.

    Without a stated unit, a number below `_LEAST_MILLISECONDS` is in seconds.

    :param word: code and letter, for messages; `number`: the number as written.
    :param unit: unit in which the control counts; None: the cell does not say.
    :param has_point: whether the number is known to have a decimal point.
    :raises BlockError: the unit is not stated and the number may be in either; or it is milliseconds, and the number
        looks like seconds.
    """
    if unit == "s" or number == 0.0 or (unit is None and number < _LEAST_MILLISECONDS):
        return number
    if unit is None:
        advice = "LinuxCNC reads seconds; Fanuc, Haas and Mach3 read milliseconds. "
        advice += 'Write dwell_unit = "s" or dwell_unit = "ms" in [gcode] of the cell.'
        raise BlockError(f"{word}{number:g} is {number:g} s or {number:g} ms: the cell does not say", advice)
    if has_point or number % 1.0 or number < _LEAST_MILLISECONDS:
        advice = "Fanuc and Haas read seconds where there is a decimal point. "
        advice += 'Write whole milliseconds without one, or dwell_unit = "s" in [gcode] of the cell.'
        raise BlockError(f"{word}{number:g} looks like seconds, but the cell says milliseconds", advice)
    return 1e-3 * number


class _Block(Struct):
    """Codes and words of a block that have not been used yet.

    :ivar row: row of its line.
    :ivar g: its G codes; `m`: its M codes; in order.
    :ivar values: its other words by letter; each step of reading removes the words that it uses.
    """

    row: int
    g: list[float]
    m: list[float]
    values: dict[str, float]


class Modes(Struct, frozen=True, eq=False):
    """Modal state, events and remarks of the blocks that are not plain.

    :param row_count: number of lines of the program, up to M2, M30 or the closing ``%``, or up to the first few faults.
    :param changes: modal group of `codes.GROUPS` → its changes (row, code), in order.
    :param blends: changes (row, approximation distance [m]), in order.
    :param roundings: changes (row, allowed rounding of corners [m]), in order; NaN for the value of the cell.
    :param origins: changes of the program frame other than by G54…, in order.
    :param returns: row → move to a machine position.
    :param tools: changes (row, tool number), in order.
    :param tip_control_changes: changes (row, 1 if tool-centre-point control is on, else 0), in order.
    :param dwell_rows: rows with G4.
    :param dwell_unit: unit of P of cycles, see `dwell_time`; `rows_with_point`: rows whose P has a decimal point.
    :param row_events: events of the lines, in order.
    :param issues: remarks for the user.
    :param faults: faults of blocks, in order.
    :param is_complete: False if the required end is missing.
    """

    row_count: int
    changes: Mapping[str, Sequence[tuple[int, float]]]
    blends: Sequence[tuple[int, float]]
    roundings: Sequence[tuple[int, float]]
    origins: Sequence[Origin]
    returns: Mapping[int, Return]
    tools: Sequence[tuple[int, float]]
    tip_control_changes: Sequence[tuple[int, float]]
    dwell_rows: Sequence[int]
    row_events: Sequence[RowEvent]
    issues: Sequence[Issue]
    faults: Sequence[Fault]
    dwell_unit: DwellUnit | None = None
    rows_with_point: frozenset[int] = frozenset()
    is_complete: bool = True


def read_modes(
    source: Source, other_rows: Ints, words: Words, cell: Cell, faults_of_run: Sequence[Fault] = ()
) -> Modes:
    """Read the lines that are not plain motion blocks, and put their coordinates, feeds and motion codes into `words`.

    :param other_rows: (n,) rows of the lines to read, ascending.
    :param words: as `words.read_plain` returns them; rows of `other_rows` are filled in.
    :param cell: work offsets, tools, M-codes, approximation distance, meaning of G28 and G53.
    :param faults_of_run: faults found when the program was executed.
    :returns: modes up to the end of the program, or up to the first `MAX_ERRORS` + 1 faults.
    """
    opening = _OPENING_PERCENT.match(source.code)
    tape_row = -1 if opening is None else opening[0].count(b"\n") - 1  # row of the % that opens the program
    reader = _Reader(words, cell, tape_row)
    faults: list[Fault] = []
    row_count = len(source)
    for row in other_rows.tolist():
        code = source.line(row)
        try:
            reader.read(row, code)
        except BlockError as cause:
            faults.append(cause.fault(row, code))
        if reader.has_ended or len(faults) > MAX_ERRORS:  # no more faults are shown
            row_count = row + 1
            if not faults_of_run and source.has_coordinates_after_percent(row):
                faults.append(Fault(row, *EARLY_PERCENT))
            break
    faults = sorted(
        [*faults, *(fault for fault in faults_of_run if fault.row < row_count)], key=lambda fault: fault.row
    )
    # a program that begins with % must have an end, unless faults may hide it
    is_complete = reader.has_ended or tape_row < 0 or len(faults) > MAX_ERRORS or bool(faults_of_run)
    if not reader.has_ended and is_complete:
        message = "The program ends without M2, M30 or %. Check that the file is complete."
        reader.issues.append(Issue("warning", "program-end", message, row_count))
    return Modes(
        row_count=row_count,
        changes=reader.changes,
        blends=reader.blends,
        roundings=reader.roundings,
        origins=reader.frame_codes.origins,
        returns=reader.frame_codes.returns,
        tools=reader.switching.tools,
        tip_control_changes=reader.tip_control.changes,
        dwell_rows=reader.dwell_rows,
        row_events=reader.switching.events,
        issues=reader.issues,
        faults=faults,
        dwell_unit=cell.gcode.dwell_unit,
        rows_with_point=frozenset(reader.rows_with_point),
        is_complete=is_complete,
    )


class _Reader:
    """Reader of the blocks that are not plain, with the modal state and the results so far.

    :ivar words: words of all lines; `put` enters those of the blocks that are read.
    :ivar tape_row: row of the ``%`` that opens the program; −1: there is none.
    :ivar is_tape_closed: whether the closing ``%`` has been read.
    :ivar code: text of the present block.
    :ivar rows_with_point: rows whose P has a decimal point.
    :ivar approximation: approximation distance of the cell [m].
    :ivar changes, blends, roundings, dwell_rows, issues: see `Modes`.
    :ivar smoothing_rows: rows whose code is a mode of smoothing, which is ignored.
    :ivar letters: letters whose words are put into `words`.
    :ivar takes_directions: whether I, J, K of G0 and G1 are the direction of the tool.
    :ivar mm_per_unit: length of the active unit [mm].
    """

    def __init__(self, words: Words, cell: Cell, tape_row: int) -> None:
        self.words, self.cell, self.tape_row = words, cell, tape_row
        self.code = ""
        self.rows_with_point: set[int] = set()
        self.approximation = cell.gcode.approximation_mm * M_PER_MM
        self.changes: dict[str, list[tuple[int, float]]] = {group: [] for group in codes.GROUPS}
        self.blends: list[tuple[int, float]] = []
        self.roundings: list[tuple[int, float]] = []
        self.dwell_rows: list[int] = []
        self.smoothing_rows: set[int] = set()
        self.issues: list[Issue] = []
        self.tip_control = TipControl(cell.rotary)
        self.frame_codes, self.switching = FrameCodes(cell), Switching(cell, self.issues, self.tip_control.read)
        self.letters = [letter for letter in COLUMNS if letter not in "ABC" or letter in self.frame_codes.rotary]
        self.takes_directions = cell.rotary is not None and cell.rotary.kind == "vector"
        self.mm_per_unit = 1.0
        self.is_tape_closed = False

    @property
    def has_ended(self) -> bool:
        """Whether the program has ended."""
        return self.is_tape_closed or self.switching.ended

    def read(self, row: int, code: str) -> None:
        """Read the codes and words of a block; its valid words count even if it has a fault.

        :param row: row of the block; `code`: its packed code: upper case, without blanks, comments replaced by marks.
        :raises BlockError: the first fault of the block.
        """
        if code.lstrip(COMMENT_MARK).startswith("%"):
            self.is_tape_closed = row != self.tape_row  # the % of `tape_row` opens the program
            return
        delete_mark = _DELETE_MARK.match(code)
        if delete_mark:
            code = code[delete_mark.end() :]
            self._add_remark("info", "block-delete", "Blocks with / are executed (block delete is off).", row)
        if code.endswith("%"):  # the end of the tape in the last block
            code, self.is_tape_closed = code.removesuffix("%"), True
        code = self._replace_sender_command(row, code)
        self.code = code
        if _P_WITH_POINT.search(code):  # the point may decide the unit of a dwell: see `dwell_time`
            self.rows_with_point.add(row)
        words = words_of(code)
        block = _Block(
            row,
            [value for letter, value in words if letter == "G"],
            [value for letter, value in words if letter == "M"],
            {letter: value for letter, value in words if letter not in "GM"},
        )
        first_error: BlockError | None = None
        for read_step in (  # in this order: each step removes the words that it uses
            self._ignore_smoothing,
            self._read_modes,
            self._ignore_radius,
            self._read_frames,
            self._read_dwell,
            self._read_blending,
            self._read_switching,
            self._read_coordinates,
        ):
            try:
                read_step(block)
            except BlockError as cause:  # keep the valid words of the block: later blocks depend on them
                first_error = first_error or cause
        if first_error is not None:
            raise first_error

    def _replace_sender_command(self, row: int, code: str) -> str:
        """Return the code of a block with commands to Grbl replaced.

        ``$H`` becomes G28. A command that moves nothing becomes an empty block, and a remark. Other blocks are returned
        as they are.
        """
        command = code.strip(COMMENT_MARK)
        if not command.startswith("$"):
            return code
        homing = _GRBL_HOMING.fullmatch(command)
        if homing is not None:
            return f"G28{homing[1]}"
        if command in _GRBL_WITHOUT_MOTION:
            name = "?" if command == "$?" else command  # `words.split` makes $? of a line with ? alone
            message = f"{name} is a command to Grbl: it moves nothing."
            self._add_remark("info", "sender-command", message, row)
            return ""
        return code

    def _read_coordinates(self, block: _Block) -> None:
        """Put the coordinates and other numbers of a block into `words`: all words that no other step has used.

        Words of axes that the robot does not have are ignored at zero.

        :raises BlockError: no code uses a letter, or the feed is negative.
        """
        values = block.values
        self._read_tool_length(block)
        for letter in codes.OTHER_AXES:
            if values.get(letter) == 0.0 and letter not in self.frame_codes.rotary:
                del values[letter]
                message = f"{letter}0 is ignored: the robot has no axis {letter}."
                self._add_remark("info", "other-axis", message, block.row, letter)
        is_negative_feed = values.get("F", 0.0) < 0.0
        if is_negative_feed:
            del values["F"]
        for letter in self.letters:
            if letter in values:
                self.words.put(letter, block.row, values.pop(letter))
        if values:
            letter = next(iter(values))
            raise BlockError(f"{letter} word without a code that uses it", codes.WORD_ADVICE.get(letter))
        if is_negative_feed:
            raise BlockError("negative feed", None)

    def _read_tool_length(self, block: _Block) -> None:
        """Read and remove H of a code that applies a tool length (G43, G43.4, G43.5); remove H0 without such a code."""
        applies_length = (
            codes.TOOL_LENGTH in block.g
            or (43.4 in block.g and self.frame_codes.rotary)
            or (43.5 in block.g and self.takes_directions)
        )
        if applies_length:
            self.switching.check_tool_length(block.row, block.values.pop("H", None))
            block.values.pop("D", None)  # a radius, which only G41 and G42 use
        elif block.values.get("H") == 0.0:
            del block.values["H"]

    def _add_remark(self, level: Level, kind: str, message: str, row: int, subject: str = "") -> None:
        """Add a remark on the line in a row (from 0) for the user; `subject`: see `Issue`."""
        self.issues.append(Issue(level, kind, message, row + 1, subject=subject))

    def _offset_refusal(self, code: float) -> codes.Refusal | None:
        """Return the refusal of a work offset that cannot be used; None if it can be used.

        :param code: number of its G code, such as 54.0.
        """
        if f"G{code:g}" not in self.frame_codes.offsets:
            name = f"G{code:g}" if code.is_integer() else f'"G{code:g}"'  # TOML: a name with a dot is in quotes
            advice = f"Give its frame in $BASE in the cell: [work_offsets.{name}]."
            return codes.Refusal(f"work offset G{code:g} is not in the cell", advice)
        frame, rotary = self.cell.work_offsets.get(f"G{code:g}"), self.cell.rotary
        if frame is not None and frame.is_turned and rotary is not None and rotary.kind == "indexed":
            return codes.Refusal(f"[work_offsets.G{code:g}] {TURNED_OFFSET}", TURNED_OFFSET_ADVICE)
        return None

    def _warn_of_tapping(self, row: int) -> None:
        """Warn that G84 needs a floating holder.

        :raises BlockError: the cell starts the spindle, but has no lines that reverse it.
        """
        if self.cell.gcode.spindle_on and not self.cell.gcode.spindle_ccw:
            advice = "Give spindle_ccw in [gcode] of the cell: KRL lines that reverse the spindle."
            raise BlockError("G84 reverses the spindle at the bottom, but the cell has no spindle_ccw", advice)
        if self.cell.gcode.spindle_ccw:
            advice = (
                "Let the lines of spindle_ccw and spindle_on wait for the reversal, and keep the override at 100 %."
            )
        else:
            advice = (
                "No line reverses the spindle at the bottom, because the cell has no spindle_ccw: take a holder that "
                "reverses by itself, and keep the override at 100 %."
            )
        message = f"G84 with a robot taps in a floating holder only: feed and spindle are not in step. {advice}"
        self._add_remark("warning", "tapping", message, row)

    def _read_modes(self, block: _Block) -> None:
        """Record the modal codes of a block, and check that its other G codes are accepted.

        :raises BlockError: a code is not supported, or a work offset is not in the cell.
        """
        row, g, values = block.row, block.g, block.values
        first_refusal: codes.Refusal | None = None
        for code in g:
            group = codes.GROUP_OF.get(code)
            if group == "offset" and (refusal := self._offset_refusal(code)) is not None:
                first_refusal = first_refusal or refusal
            elif group is not None:
                self.changes[group].append((row, code))
                if group == "units":
                    self._change_units(row, code, has_feed="F" in values)
            # G80 in a block with a motion code has no effect
            elif code in codes.MOVING or (code == codes.CANCEL_CYCLE and not set(g) & set(codes.MOVING)):
                self.words.put("G", row, code)
                if code == 84.0:
                    self._warn_of_tapping(row)
            elif self._is_read_elsewhere(row, code):
                continue
            elif code not in codes.ACCEPTED_G or (code == codes.SCALE_OFF and set(values) & set("XYZIJKPS")):
                first_refusal = first_refusal or codes.refusal("G", code)
        if first_refusal is not None:
            raise BlockError(*first_refusal)

    def _change_units(self, row: int, code: float, *, has_feed: bool) -> None:
        """Apply G20 or G21; warn if F is in a block that changes the units, since controls differ in the units of F.

        :param row: row of the block; `code`: 20 or 21; `has_feed`: whether the block has F.
        """
        if has_feed and MM_PER_UNIT[code] != self.mm_per_unit:
            message = "F in the block of G20 or G21 is in the new units. LinuxCNC reads it in those before."
            self._add_remark("warning", "feed-units", message, row)
        self.mm_per_unit = MM_PER_UNIT[code]

    def _is_read_elsewhere(self, row: int, code: float) -> bool:
        """Return whether another step of `read` uses a G code, or the code has no effect in this block.

        A code that switches tool-centre-point control is recorded.
        """
        return (
            self.tip_control.read(row, f"G{code:g}")
            or self._repeats_units(code)
            or code in codes.RADIUS
            or (row in self.smoothing_rows and code in codes.SMOOTHING_MODES)
        )

    def _read_frames(self, block: _Block) -> None:
        """Read the codes of shifts, work offsets (G10) and machine positions; G53 without an axis is ignored.

        :raises BlockError: a code cannot be executed on the robot.
        """
        row, g, values = block.row, block.g, block.values
        if codes.MACHINE in g and not set(values) & {"X", "Y", "Z", *self.frame_codes.rotary}:
            g = [code for code in g if code != codes.MACHINE]
            message = "G53 without X, Y or Z has no effect: it holds for its own block only."
            self._add_remark("info", "machine-position", message, row)
        self.frame_codes.read(row, g, motion=self._motion_code(row), values=values, mm_per_unit=self.mm_per_unit)

    def _read_switching(self, block: _Block) -> None:
        """Record M codes, T and S of a block.

        :raises BlockError: a code is unknown or impossible.
        """
        self.switching.read(block.row, block.m, block.values)

    def _ignore_smoothing(self, block: _Block) -> None:
        """Ignore look-ahead modes, and remove their words: the cell says how exactly corners are cut.

        A code with other words than those of `codes.SMOOTHING_MODES` is no look-ahead mode. Without words, G103 and
        G187 are look-ahead modes, the other codes are not.
        """
        for code in block.g:
            code_words = codes.SMOOTHING_MODES.get(code)
            if code_words is None or not set(block.values) <= set(code_words):
                continue
            if block.values or code in (103.0, 187.0):
                self.smoothing_rows.add(block.row)
                block.values.clear()
                message = f"G{code:g} is ignored: [gcode] corner_tolerance_mm says how exactly corners are cut."
                self._add_remark("info", "smoothing", message, block.row, f"G{code:g}")

    def _repeats_units(self, code: float) -> bool:
        """Return whether G70 or G71 repeats the last G20 or G21, as Vectric's posts write it."""
        return bool(self.changes["units"]) and self.changes["units"][-1][1] == _UNIT_SYNONYMS.get(code)

    def _motion_code(self, row: int) -> float:
        """Return the motion code of the block of a line, or NaN."""
        return float(self.words.column("G")[row])

    def _read_dwell(self, block: _Block) -> None:
        """Record G4 with its time in seconds, and remove the word of the time.

        :raises BlockError: the time is missing or ambiguous, or the block has an arc.
        """
        row, values = block.row, block.values
        if codes.DWELL not in block.g:
            return
        if self._motion_code(row) in (2.0, 3.0):
            raise BlockError("G4 in one block with an arc", "Write one block for each.")
        letter = next((letter for letter in codes.DWELL_WORDS if letter in values), None)
        if letter is None or not values[letter] >= 0.0:  # also NaN
            raise BlockError("G4 without a time", "Write G4 P with the time in seconds.")
        if letter != "P" and not np.isnan(self._motion_code(row)):
            raise BlockError(f"G4 {letter} in one block with a motion code", "Write one block for each.")
        seconds = values.pop(letter)
        has_point = _TIME_WITH_POINT.search(self.code) is not None
        # X and U with a decimal point are seconds, and so are F and S
        if letter == "P" or (letter in "XU" and not has_point):
            seconds = dwell_time(f"G4 {letter}", seconds, self.cell.gcode.dwell_unit, has_point=has_point)
        self.dwell_rows.append(row)
        self.switching.add_dwell(row, seconds)
        if letter == "S":
            message = f"G4 S{seconds:g} is read as seconds (Marlin). Sinumerik controls count turns of the spindle."
            self._add_remark("info", "dwell", message, row)

    def _ignore_radius(self, block: _Block) -> None:
        """Ignore radius compensation without effect on the path, and remove its words D and H.

        It is without effect with D0. G41, G42, G41.2 and G42.2 are without effect, too, if the cell says that the
        offsets of the control hold wear only. D of G41.1 and G42.1 is a diameter, not the number of an offset.

        :raises BlockError: the compensation has an effect.
        """
        g, values = block.g, block.values
        offsets_hold_wear = self.cell.gcode.radius_offsets == "wear"
        for code in g:
            is_wear = offsets_hold_wear and code in codes.RADIUS_BY_OFFSET
            if code in codes.RADIUS and values.get("D") != 0.0 and not is_wear:
                raise BlockError(*codes.refusal("G", code))
            if code in codes.RADIUS:
                has_d0 = values.pop("D", None) == 0.0
                if codes.TOOL_LENGTH not in g:
                    values.pop("H", None)  # the offset of older Fanuc controls
                reason = "with D0" if has_d0 else "by offsets that hold wear only ([gcode] radius_offsets)"
                message = f"Radius compensation {reason} has no effect: the path is read as that of the tool centre."
                self._add_remark("info", "radius-compensation", message, block.row)

    def _read_blending(self, block: _Block) -> None:
        """Record the approximation distance [m] that G64, G61 or G9 sets, and the rounding [m] that G64 P allows.

        With G64 P the approximation distance is at most 2·P: the corner is then rounded by no more than P.
        """
        row = block.row
        if codes.BLENDING in block.g:
            tolerance_word = block.values.pop("P", None)
            block.values.pop("Q", None)
            distance, tolerance = self.approximation, float("nan")
            if tolerance_word is not None:
                tolerance = max(tolerance_word, 0.0) * self.mm_per_unit * M_PER_MM
                distance = min(distance, 2.0 * tolerance)
            self.blends.append((row, distance))
            self.roundings.append((row, tolerance))
        elif set(block.g) & set(codes.EXACT):
            self.blends.append((row, 0.0))
        elif codes.EXACT_BLOCK in block.g:
            # G9 holds for its own block: from the next row on, the distance before it is valid again
            previous_blend = self.blends[-1][1] if self.blends else self.approximation
            self.blends += [(row, 0.0), (row + 1, previous_blend)]
