"""A new robot program from a CAM program: lines between its targets, and assembly of its text."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import numpy as np
from msgspec import Struct

from postproc.cell import Cell
from postproc.chunks import chunks
from postproc.decimals import NUMBER_DECIMALS, number_text
from postproc.dialects.cell_lines import lines_of
from postproc.errors import Issue, ProgramError
from postproc.frames import DEG_PER_RAD, Array
from postproc.program import CIRC, LIN, PTP, Event, Ints, Program, Targets, distinct
from postproc.safe_text import one_line

LINE_END = "\r\n"
_WITHOUT_VALUE = ("spindle_off", "coolant_on", "coolant_off")
"""Kinds of events whose value says nothing."""
_FASTEST_TURN = 200.0
"""Largest rotational speed written [deg/s]; above it the controller chooses."""
_NOMINAL_TOLERANCE = 1e-9
"""Commands whose matrices differ by less than this from the programmed ones are nominal (assumed)."""


class Words(Struct, frozen=True):
    """Instructions of a robot language.

    :param comment: prefix of comments.
    :param dwell: statement that waits; ``{}`` is its time [s].
    :param halt: statement that stops the program until it is started again.
    :param wait: statement before lines of the cell that delays them until the robot has reached the target before;
        empty if an exact stop is enough.
    :param axis_motion: returns the statement that moves to joint angles (6,) [rad], KUKA signs.
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

    :ivar motion_of_target: (K,) motion of each target, ascending: rows of `Program.motions`.
    :ivar lines_before: target → lines before it; the key K (number of targets) means the end of the program.
    :ivar stop_targets: targets before which the robot must stop.
    :ivar cell_lines: target → lines of the cell before it; `lines_before` has them too.
    :ivar issues: warnings for the user.
    :ivar events_without_lines: events for which the cell has no lines.
    """

    def __init__(self, program: Program, targets: Targets, cell: Cell, words: Words) -> None:
        self.program, self.targets, self.cell, self.words = program, targets, cell, words
        self.motion_of_target = targets.motion
        self.lines_before: defaultdict[int, list[str]] = defaultdict(list)
        self.stop_targets: set[int] = {len(self.motion_of_target)}
        self.cell_lines: defaultdict[int, list[str]] = defaultdict(list)
        self.issues: list[Issue] = []
        self.events_without_lines: list[Event] = []

    def target_description(self) -> str:
        """Return whether the targets are corrected or nominal, as text for the head of the program."""
        # the last target of each motion: only this one has a programmed pose
        last_targets = np.flatnonzero(
            np.append(self.motion_of_target[1:] != self.motion_of_target[:-1], True)[: len(self.motion_of_target)]
        )
        is_corrected = any(  # in chunks, because the first chunk usually decides
            np.abs(self.program.motions.target[self.motion_of_target[rows]] - self.targets.pose[rows]).max()
            > _NOMINAL_TOLERANCE
            for rows in map(last_targets.__getitem__, chunks(len(last_targets)))
            if len(rows)
        )
        return "targets corrected for deflection" if is_corrected else "nominal targets"

    def frames_of_target(self, k: int) -> tuple[int, int]:
        """Return base and tool of target `k`: rows of `Program.bases` and `Program.tools`; 0 without targets."""
        motions, motion = self.program.motions, int(self.motion_of_target[k]) if len(self.motion_of_target) else 0
        base, tool = (int(rows[motion]) if len(rows) else 0 for rows in (motions.base, motions.tool))
        return base, tool

    def frame_changes(self) -> Iterator[int]:
        """Yield the targets whose base or tool differs from the target before; add each to `stop_targets`."""
        motions = self.program.motions
        base, tool = motions.base[self.motion_of_target], motions.tool[self.motion_of_target]
        for k in (np.flatnonzero((np.diff(base) != 0) | (np.diff(tool) != 0)) + 1).tolist():
            self.stop_targets.add(k)
            yield k

    def add_events(self) -> None:
        """Add the lines of events and the motions to joint angles to `lines_before`.

        Each goes before the first target of the motion that it precedes. Dwells, stops, lines of the cell and motions
        to joint angles are added to `stop_targets`. Events without lines of the cell get a comment and one warning.
        """
        # target before which a statement already stops the advance run (the controller reads ahead): no wait is needed
        # before further lines of the cell there; −1: none
        stopped_before = -1
        words = self.words
        for event in self._ordered_events():
            if isinstance(event, int):  # a motion to joint angles
                k = self._first_target_of(event)
                self.lines_before[k].append(words.axis_motion(self.program.motions.joints[event]))
                self.stop_targets.add(k)
                stopped_before = -1
                continue
            k = self.first_target(event)
            if event.kind == "comment":
                self.lines_before[k].append(f"{words.comment} {words.printable(event.text)}".rstrip())
            elif event.kind in ("dwell", "stop"):
                self.lines_before[k].append(
                    words.halt if event.kind == "stop" else words.dwell.format(number_text(event.value))
                )
                self.stop_targets.add(k)
                stopped_before = k
            else:
                cell_lines = self._lines_or_warning(event)
                if cell_lines and stopped_before != k and words.wait:
                    self.lines_before[k].append(words.wait)
                    stopped_before = k
                if cell_lines:
                    self.stop_targets.add(k)
                    self.cell_lines[k] += cell_lines
                self.lines_before[k] += cell_lines or [f"{words.comment} {no_lines_comment(event)}"]
        if self.events_without_lines:
            names = ", ".join(dict.fromkeys(event.kind for event in self.events_without_lines))
            message = f"The cell has no lines for {names} in [gcode]: the program does nothing there."
            first, count = self.events_without_lines[0].line, len(self.events_without_lines)
            self.issues.append(Issue("warning", "no-lines", message, first, count=count))

    def first_target(self, event: Event) -> int:
        """Return the target before which an event takes place; K (number of targets) for the end of the program."""
        return self._first_target_of(event.before)

    def _first_target_of(self, motion: int) -> int:
        """Return the first target of a motion, or of the next motion that has targets; K if there is none."""
        return int(np.searchsorted(self.motion_of_target, self.motion_of_target.dtype.type(motion)))
        # of the same type as the array: any other type would make NumPy convert the whole array

    def _ordered_events(self) -> Iterator[Event | int]:
        """Yield events, and the rows of motions to joint angles, in execution order; these motions have no target."""
        joint_motions = np.flatnonzero(np.isfinite(self.program.motions.joints[:, 0])).tolist()
        for event in self.program.events:
            while joint_motions and joint_motions[0] < event.before:
                yield joint_motions.pop(0)
            yield event
        yield from joint_motions

    def _lines_or_warning(self, event: Event) -> list[str]:
        """Return the cell's lines for an event, with its value inserted.

        Add a warning to `issues` if M4 uses the lines of M3; add the event to `events_without_lines` if the cell has
        no entry for it.
        """
        gcode, cell_lines = self.cell.gcode, self.lines_of(event)
        if event.kind == "spindle_ccw" and cell_lines and not gcode.spindle_ccw:
            message = "M4 uses the lines of spindle_on: give spindle_ccw in [gcode] if the direction is to change."
            self.issues.append(Issue("warning", "spindle-direction", message, event.line))
        if not cell_lines and event.kind != "m_code" and not self._has_lines(event):
            self.events_without_lines.append(event)
        return cell_lines

    def _has_lines(self, event: Event) -> bool:
        """Return whether the cell has an entry for an event; an empty list is an entry: the event needs no lines."""
        gcode = self.cell.gcode
        kinds = ("spindle_ccw", "spindle_on") if event.kind == "spindle_ccw" else (event.kind,)
        return any(getattr(gcode, kind) is not None for kind in kinds)

    def lines_of(self, event: Event) -> list[str]:
        """Return the cell's lines for an event, with its value inserted, as the controller can show them."""
        return [self.words.printable(line) for line in lines_of(event, self.cell)]

    def approximation_distances(self) -> Array:
        """Return the approximation distance of each target (K,) [m].

        It is 0 before `stop_targets` and before PTP motions: the robot stops there exactly.
        """
        distances = self.targets.blend.copy()
        exact_targets = np.array(sorted(k - 1 for k in self.stop_targets if k > 0), dtype=np.int64)
        distances[exact_targets] = 0.0
        distances[:-1][self.targets.kind[1:] == PTP] = 0.0
        return distances

    def path_speeds(self) -> tuple[Ints, Array]:
        """Return the targets of lines and circles (n,), and the speeds of the tip to them (n,) [1e-6 m/s], rounded.

        :raises ProgramError: a move has no feed, or a feed that would be printed as 0.
        """
        motions = self.program.motions
        path = np.flatnonzero(self.targets.kind != PTP)
        feed = motions.feed[self.motion_of_target[path]]
        millionths = np.rint(feed * 10.0**NUMBER_DECIMALS)
        # NaN without a feed is invalid too
        invalid_rows = np.flatnonzero(~(millionths > 0.0))
        if len(invalid_rows):
            line, speed = int(motions.line[self.motion_of_target[path[invalid_rows[0]]]]), feed[invalid_rows[0]]
            problem = "a move has no feed" if np.isnan(speed) else f"the feed is too small: {speed * 60e3:g} mm/min"
            raise ProgramError(
                problem, file=self.program.documents[0].name, line=line, advice="Give F above 0.06 mm/min."
            )
        return path, millionths

    def turning_speeds(self) -> Array:
        """Return the rotational speed at each target (K,) [deg/s]; NaN where the program states none.

        A program states it for motions that turn the tool without moving its tip.

        Also NaN above `_FASTEST_TURN`: the controller limits the speed itself.
        """
        swivel = self.program.swivel
        if swivel is None:
            return np.full(len(self.motion_of_target), np.nan)
        rate = swivel.rate[self.motion_of_target] * DEG_PER_RAD
        return np.asarray(np.where(rate < _FASTEST_TURN, np.maximum(rate, 10.0**-NUMBER_DECIMALS), np.nan))

    def text_and_lines(
        self, head: Sequence[str], print_lines: Callable[[int, Ints], bytes], end: Sequence[str]
    ) -> tuple[str, Ints]:
        """Return the text of the program, and the 1-based line (K,) of each target.

        :param head: lines before the first target.
        :param print_lines: returns the lines of targets (n,) of one kind (`LIN`, `CIRC`, `PTP`), one line per target.
        :param end: lines after the last target.
        """
        count = len(self.motion_of_target)
        preceded_targets = np.array(sorted(self.lines_before), dtype=np.int64)  # with lines before them
        # number of lines of each target: its own, and those before it
        line_counts = np.ones(count + 1, dtype=np.int32)
        line_counts[preceded_targets] += np.array(
            [len(self.lines_before[k]) for k in preceded_targets.tolist()], dtype=np.int32
        )
        line_counts[0] += len(head)
        text = "".join(line + LINE_END for line in head)
        for chunk in chunks(count):
            rows = np.arange(chunk.start, min(chunk.stop, count))
            is_in_chunk = (preceded_targets >= chunk.start) & (preceded_targets < chunk.stop)
            text += self._chunk_text(rows, print_lines, preceded_targets[is_in_chunk])
        text += "".join(line + LINE_END for line in (*self.lines_before.get(count, ()), *end))
        return text, np.cumsum(line_counts[:count], dtype=line_counts.dtype)

    def _chunk_text(self, rows: Ints, print_lines: Callable[[int, Ints], bytes], preceded_targets: Ints) -> str:
        """Return the lines of consecutive targets, with the lines that precede them.

        Targets are printed kind by kind, in bulk, and the texts are then divided at line ends and put in order. `rank`
        is the number of earlier targets of the same kind.

        :param rows: (n,) the targets, ascending.
        :param print_lines: returns the lines of targets (n,) of one kind (`LIN`, `CIRC`, `PTP`), one line per target.
        :param preceded_targets: (m,) the targets among them that have `lines_before`.
        """
        kind = self.targets.kind[rows]
        rank = np.zeros(len(rows), dtype=np.int64)
        texts, ends = {}, {}
        for code in (LIN, CIRC, PTP):
            indices = np.flatnonzero(kind == code)
            rank[indices] = np.arange(len(indices))
            texts[code] = print_lines(code, rows[indices]) if len(indices) else b""
            ends[code] = np.flatnonzero(np.frombuffer(texts[code], dtype=np.uint8) == ord("\n")) + 1
        changes = np.flatnonzero(np.diff(kind) != 0) + 1
        # a run of targets of one kind begins where the kind changes, and at each target with lines before it
        run_bounds = (
            distinct(np.concatenate([[0], preceded_targets - rows[:1], changes, [len(rows)]])) if len(rows) else rows
        )
        run_texts = []
        for first, last in pairwise(run_bounds.tolist()):
            run_texts += [line + LINE_END for line in self.lines_before.get(int(rows[first]), ())]
            code = int(kind[first])
            begin = int(ends[code][rank[first] - 1]) if rank[first] else 0
            run_texts.append(texts[code][begin : int(ends[code][rank[last - 1]])].decode("ascii"))
        return "".join(run_texts)


def check_name(
    program: Program, language: str, fault_of: Callable[[str], str | None], valid_name: Callable[[str], str]
) -> None:
    """Refuse a program whose name the controller would not accept.

    :param language: name of the robot language, for the message.
    :param fault_of: returns why the controller refuses a name, None if it accepts it; see `dialects.dialect.Writer`.
    :param valid_name: returns a valid name similar to a name; see there.
    :raises ProgramError: the name is invalid; the message gives the reason and a valid name.
    """
    fault = fault_of(program.name)
    if fault:
        raise ProgramError(
            f"{program.name!r} cannot be the name of a {language} program: {fault}",
            file=program.documents[0].name,
            advice=f"Rename the file, for example to {valid_name(program.name)}.",
        )


def no_lines_comment(event: Event) -> str:
    """Return the text of the comment that replaces an event for which the cell has no lines.

    >>> no_lines_comment(Event(0, "spindle_on", 1, 9000.0)), no_lines_comment(Event(0, "coolant_on", 1))
    ('spindle_on 9000: no lines for it in the cell', 'coolant_on: no lines for it in the cell')
    """
    value = "" if event.kind in _WITHOUT_VALUE else f" {number_text(event.value)}"
    return f"{event.kind}{value}: no lines for it in the cell"
