"""A new robot program from G-code: lines between its targets, and assembly of its text."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import numpy as np
from msgspec import Struct

from postproc.cell import Cell
from postproc.chunks import chunks
from postproc.decimals import decimal_text
from postproc.errors import Issue, ProgramError
from postproc.frames import DEG_PER_RAD, Array
from postproc.program import CIRC, LIN, PTP, Event, Ints, Program, Targets, distinct
from postproc.safe_text import one_line

LINE_END = "\r\n"
_DECIMALS = 6
"""Of speeds [m/s]: 1e-6 m/s is 0.06 mm/min, finer than feeds are programmed."""
_WITHOUT_VALUE = ("spindle_off", "coolant_on", "coolant_off")
"""Kinds of events whose value says nothing."""
_FASTEST_TURN = 200.0
"""Largest rotational speed written [deg/s]; above it the controller chooses."""
_NOMINAL_TOLERANCE = 1e-9
"""Commands whose matrices differ by less than this from the programmed ones are nominal (assumed)."""


class Words(Struct, frozen=True):
    """Instructions of a robot language.

    :param comment: prefix of comments.
    :param dwell: a wait; ``{}`` is its time [s].
    :param halt: the program stops until it is started again.
    :param wait: statement before lines of the cell that delays them until the robot is there; empty if an exact stop
        is enough.
    :param axis_motion: a motion to joint angles (6,) [rad], KUKA signs.
    :param encoding: code page of the controller.
    """

    comment: str
    dwell: str
    halt: str
    axis_motion: Callable[[Array], str]
    wait: str = ""
    encoding: str = "cp1252"

    def printable(self, text: str) -> str:
        """Return a text as one line in the controller's code page."""
        return one_line(text).encode(self.encoding, "replace").decode(self.encoding)


class NewProgram:
    """Collects the lines between the targets.

    :ivar before: lines before each target; the key K (number of targets) means the end of the program.
    :ivar stops: targets before which the robot must stop.
    :ivar cell_lines: lines of the cell before each target that has some; they are in `before` too.
    :ivar issues: warnings for the user.
    """

    def __init__(self, program: Program, targets: Targets, cell: Cell, words: Words) -> None:
        self.program, self.targets, self.cell, self.words = program, targets, cell, words
        self.row = targets.motion
        self.before: defaultdict[int, list[str]] = defaultdict(list)
        self.stops: set[int] = {len(self.row)}
        self.cell_lines: defaultdict[int, list[str]] = defaultdict(list)
        self.issues: list[Issue] = []
        self.without_lines: list[Event] = []

    def kind(self) -> str:
        """Return the description of the targets for the head of the program; the first chunk usually decides it."""
        ends = np.flatnonzero(np.append(self.row[1:] != self.row[:-1], True)[: len(self.row)])
        is_corrected = any(
            np.abs(self.program.motions.target[self.row[part]] - self.targets.pose[part]).max() > _NOMINAL_TOLERANCE
            for part in map(ends.__getitem__, chunks(len(ends)))
            if len(part)
        )
        return "targets corrected for deflection" if is_corrected else "nominal targets"

    def frames(self, k: int) -> tuple[int, int]:
        """Return base and tool of a target: rows of `Program.bases` and `Program.tools`."""
        motions, motion = self.program.motions, int(self.row[k]) if len(self.row) else 0
        base, tool = (int(rows[motion]) if len(rows) else 0 for rows in (motions.base, motions.tool))
        return base, tool

    def frame_changes(self) -> Iterator[int]:
        """Yield the targets that have other frames than the one before; the robot stops before them."""
        motions = self.program.motions
        base, tool = motions.base[self.row], motions.tool[self.row]
        for k in (np.flatnonzero((np.diff(base) != 0) | (np.diff(tool) != 0)) + 1).tolist():
            self.stops.add(k)
            yield k

    def events(self) -> None:
        """Write the cell's lines at the first target of the motion that they precede."""
        waiting = -1  # the target before which the advance run already stops
        words = self.words
        for event in self._ordered_events():
            if isinstance(event, int):
                k = self._first(event)
                self.before[k].append(words.axis_motion(self.program.motions.joints[event]))
                self.stops.add(k)
                waiting = -1
                continue
            k = self.first_target(event)
            if event.kind == "comment":
                self.before[k].append(f"{words.comment} {words.printable(event.text)}".rstrip())
            elif event.kind in ("dwell", "stop"):
                self.before[k].append(words.halt if event.kind == "stop" else words.dwell.format(number(event.value)))
                self.stops.add(k)
                waiting = k
            else:
                cell_lines = self._lines_or_warning(event)
                if cell_lines and waiting != k and words.wait:
                    self.before[k].append(words.wait)
                    waiting = k
                if cell_lines:
                    self.stops.add(k)
                    self.cell_lines[k] += cell_lines
                self.before[k] += cell_lines or [f"{words.comment} {no_lines(event)}"]
        if self.without_lines:
            names = ", ".join(dict.fromkeys(event.kind for event in self.without_lines))
            message = f"The cell has no lines for {names} in [gcode]: the program does nothing there."
            first, count = self.without_lines[0].line, len(self.without_lines)
            self.issues.append(Issue("warning", "no-lines", message, first, count=count))

    def first_target(self, event: Event) -> int:
        """Return the target before which an event takes place; their number at the end."""
        return self._first(event.before)

    def _first(self, motion: int) -> int:
        """Return the first target of a motion, or of the next one that has targets."""
        return int(np.searchsorted(self.row, self.row.dtype.type(motion)))  # another type would convert all rows

    def _ordered_events(self) -> Iterator[Event | int]:
        """Yield events, and the rows of motions to joint angles, which have no target, in order."""
        axes = np.flatnonzero(np.isfinite(self.program.motions.joints[:, 0])).tolist()
        for event in self.program.events:
            while axes and axes[0] < event.before:
                yield axes.pop(0)
            yield event
        yield from axes

    def _lines_or_warning(self, event: Event) -> list[str]:
        """Return the cell's lines for an event, with its value inserted; warn if there are none."""
        gcode, cell_lines = self.cell.gcode, self.lines_of(event)
        if event.kind == "spindle_ccw" and cell_lines and not gcode.spindle_ccw:
            message = "M4 uses the lines of spindle_on: give spindle_ccw in [gcode] if the direction is to change."
            self.issues.append(Issue("warning", "spindle-direction", message, event.line))
        if not cell_lines and event.kind != "m_code" and not self._has_lines(event):
            self.without_lines.append(event)
        return cell_lines

    def _has_lines(self, event: Event) -> bool:
        """Return whether the cell says what an event needs; an empty list says that it needs nothing."""
        gcode = self.cell.gcode
        kinds = ("spindle_ccw", "spindle_on") if event.kind == "spindle_ccw" else (event.kind,)
        return any(getattr(gcode, kind) is not None for kind in kinds)

    def lines_of(self, event: Event) -> list[str]:
        """Return the cell's lines for an event, with its value inserted; those of M3 for M4 without own ones."""
        if event.kind == "m_code":
            return [self.words.printable(line) for line in self.cell.m_codes[f"M{number(event.value)}"]]
        cell_lines: Sequence[str] = getattr(self.cell.gcode, event.kind) or []
        if event.kind == "spindle_ccw":
            cell_lines = cell_lines or self.cell.gcode.spindle_on or []
        value = number(event.value)
        return [self.words.printable(line.replace("{S}", value).replace("{T}", value)) for line in cell_lines]

    def distances(self) -> Array:
        """Return the approximation distance of each target (K,) [m]; 0 where the robot must stop."""
        distances = self.targets.blend.copy()
        exact = np.array(sorted(k - 1 for k in self.stops if k > 0), dtype=np.int64)
        distances[exact] = 0.0
        distances[:-1][self.targets.kind[1:] == PTP] = 0.0
        return distances

    def speeds(self) -> tuple[Ints, Array]:
        """Return the targets of paths (n,) and their speeds (n,) in millionths of a metre per second, whole numbers.

        :raises ProgramError: a move has no feed, or one that would be printed as 0.
        """
        motions = self.program.motions
        path = np.flatnonzero(self.targets.kind != PTP)
        feed = motions.feed[self.row[path]]
        millionths = np.rint(feed * 10.0**_DECIMALS)
        invalid_rows = np.flatnonzero(~(millionths > 0.0))
        if len(invalid_rows):
            line, speed = int(motions.line[self.row[path[invalid_rows[0]]]]), feed[invalid_rows[0]]
            problem = "a move has no feed" if np.isnan(speed) else f"the feed is too small: {speed * 60e3:g} mm/min"
            raise ProgramError(
                problem, file=self.program.documents[0].name, line=line, advice="Give F above 0.06 mm/min."
            )
        return path, millionths

    def turning_speeds(self) -> Array:
        """Return the rotational speed at each target (K,) [deg/s] if the program gives it, else NaN.

        NaN also above the largest speed of controllers: they limit it.
        """
        swivel = self.program.swivel
        if swivel is None:
            return np.full(len(self.row), np.nan)
        rate = swivel.rate[self.row] * DEG_PER_RAD
        return np.asarray(np.where(rate < _FASTEST_TURN, np.maximum(rate, 10.0**-_DECIMALS), np.nan))

    def text_and_lines(
        self, head: Sequence[str], print_lines: Callable[[int, Ints], bytes], end: Sequence[str]
    ) -> tuple[str, Ints]:
        """Return the text of the program, and the line of each target (K,).

        :param head: lines before the first target.
        :param print_lines: returns the lines of targets (n,) of a kind, in order.
        :param end: lines after the last target.
        """
        count = len(self.row)
        note_targets = np.array(sorted(self.before), dtype=np.int64)
        step = np.ones(count + 1, dtype=np.int32)
        step[note_targets] += np.array([len(self.before[k]) for k in note_targets.tolist()], dtype=np.int32)
        step[0] += len(head)
        text = "".join(line + LINE_END for line in head)
        for part in chunks(count):
            rows = np.arange(part.start, min(part.stop, count))
            text += self._chunk(
                rows, print_lines, note_targets[(note_targets >= part.start) & (note_targets < part.stop)]
            )  # extended in place
        text += "".join(line + LINE_END for line in (*self.before.get(count, ()), *end))
        return text, np.cumsum(step[:count], dtype=step.dtype)

    def _chunk(self, rows: Ints, print_lines: Callable[[int, Ints], bytes], note_targets: Ints) -> str:
        """Return the lines of consecutive targets (n,), with those before targets `note_targets` (m,) of them.

        Targets are printed kind by kind, in bulk. `rank` is the place of a target among those of its kind, so that
        the texts can be cut at line ends and put in order.
        """
        kind = self.targets.kind[rows]
        rank = np.zeros(len(rows), dtype=np.int64)
        texts, ends = {}, {}
        for value in (LIN, CIRC, PTP):
            indices = np.flatnonzero(kind == value)
            rank[indices] = np.arange(len(indices))
            texts[value] = print_lines(value, rows[indices]) if len(indices) else b""
            ends[value] = np.flatnonzero(np.frombuffer(texts[value], dtype=np.uint8) == ord("\n")) + 1
        changes = np.flatnonzero(np.diff(kind) != 0) + 1
        cuts = distinct(np.concatenate([[0], note_targets - rows[:1], changes, [len(rows)]])) if len(rows) else rows
        parts = []
        for first, last in pairwise(cuts.tolist()):
            parts += [line + LINE_END for line in self.before.get(int(rows[first]), ())]
            value = int(kind[first])
            begin = int(ends[value][rank[first] - 1]) if rank[first] else 0
            parts.append(texts[value][begin : int(ends[value][rank[last - 1]])].decode("ascii"))
        return "".join(parts)


def check_name(
    program: Program, language: str, fault_of: Callable[[str], str | None], valid_name: Callable[[str], str]
) -> None:
    """Refuse a program whose name the controller would not accept.

    :param language: for the message.
    :param fault_of: see `dialects.dialect.Writer`, and `valid_name`.
    :raises ProgramError: the name is invalid; the message gives the reason and a valid name.
    """
    fault = fault_of(program.name)
    if fault:
        raise ProgramError(
            f"{program.name!r} cannot be the name of a {language} program: {fault}",
            file=program.documents[0].name,
            advice=f"Rename the file, for example to {valid_name(program.name)}.",
        )


def no_lines(event: Event) -> str:
    """Return the comment in place of an event that the cell has no lines for.

    >>> no_lines(Event(0, "spindle_on", 1, 9000.0)), no_lines(Event(0, "coolant_on", 1))
    ('spindle_on 9000: no lines for it in the cell', 'coolant_on: no lines for it in the cell')
    """
    value = "" if event.kind in _WITHOUT_VALUE else f" {number(event.value)}"
    return f"{event.kind}{value}: no lines for it in the cell"


def number(value: float) -> str:
    """Return a number in fixed-point notation without needless zeros.

    >>> number(12.5), number(-0.0), number(3.0)
    ('12.5', '0', '3')
    """
    return decimal_text(value, _DECIMALS).rstrip("0").rstrip(".")
