"""A new KRL program, from G-code: header, frames, start position, motions, and the cell's lines for its events.

Decisions, where KUKA leaves a choice:

- Lines of the cell for spindle, coolant and tool change are preceded by ``WAIT SEC 0``, and the motion before them has
  no C_DIS: the advance run stops there, so that outputs switch when the robot stands, not up to three motions early.
- C_DIS is also left out before a dwell, a HALT, a change of `$BASE` or `$TOOL`, a PTP, and at the end.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import PurePath

import numpy as np

from postproc.cell import Cell
from postproc.chunks import chunks
from postproc.decimals import Bytes, fixed, lines
from postproc.dialects.krl.language.names import fault_of, valid
from postproc.dialects.krl.language.positions import CARTESIAN
from postproc.dialects.krl.write import force_comments
from postproc.dialects.krl.write.force_comments import where
from postproc.dialects.krl.write.frame import LINE_END, axis_motion, head
from postproc.dialects.krl.write.target_numbers import DECIMALS, printed
from postproc.dialects.krl.write.target_statements import aggregate_text
from postproc.errors import Issue, ProgramError, group_issues
from postproc.frames import MM_PER_M, Array, xyzabc_from_pose
from postproc.program import CIRC, LIN, PTP, Bools, Document, Event, Ints, Program, TargetForces, Targets, Written
from postproc.version import VERSION

_SPEED_DECIMALS = 6
_FRAME_DECIMALS = 6
_CORRECTED = 1e-9
"""Commands whose matrices differ by less than this from the programmed ones are nominal."""
_PARAMETERS = ("&PARAM TEMPLATE = C:\\KRC\\Roboter\\Template\\vorgabe",)
_PARAMETERS_KRC2 = (*_PARAMETERS, "&PARAM EDITMASK = *")
_INITIALISATION = (
    ";FOLD INI",
    "  ;FOLD BASISTECH INI",
    "    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )",
    "    INTERRUPT ON 3",
    "    BAS (#INITMOV,0 )",
    "  ;ENDFOLD (BASISTECH INI)",
    "  ;FOLD USER INI",
    "    ;Make your modifications here",
    "",
    "  ;ENDFOLD (USER INI)",
    ";ENDFOLD (INI)",
    "",
)
_NO_LINES = {"spindle": "no-spindle-lines", "coolant": "no-coolant-lines", "tool": "no-tool-change-lines"}


def emit(program: Program, targets: Targets, cell: Cell, carried: TargetForces | None = None) -> Written:
    """Return a program read from G-code as KRL for the cell's controller.

    :param program: its motions, frames, events and name.
    :param targets: what is to be commanded.
    :param cell: start position, approximation, lines for events, controller.
    :param carried: forces to be written as comments, on the lines of their targets.
    :returns: one document, ``NAME.src``, CR LF.
    :raises ProgramError: the name is not one of KRL; a move has no feed, or one that would be printed as 0.
    :raises ValueError: a number is too large to be written.
    """
    fault = fault_of(program.name)
    if fault:
        raise ProgramError(
            f"{program.name!r} cannot be the name of a KRL program: {fault}",
            file=program.documents[0].name,
            advice=f"Rename the file, for example to {valid(program.name)}.",
        )
    return _Emitter(program, targets, cell, carried).written()


class _Emitter:
    """Collects what stands between the targets, then prints all targets at once."""

    def __init__(self, program: Program, targets: Targets, cell: Cell, carried: TargetForces | None) -> None:
        self.program, self.targets, self.cell, self.carried = program, targets, cell, carried
        self.row = targets.motion
        self.last = np.append(self.row[1:] != self.row[:-1], True) if len(self.row) else np.zeros(0, dtype=np.bool_)
        self.before: defaultdict[int, list[str]] = defaultdict(list)
        self.stops: set[int] = {len(self.row)}
        self.noted = np.zeros(len(self.row), dtype=np.bool_)
        self.issues: list[Issue] = []

    def written(self) -> Written:
        """Return the document."""
        head = self._head()
        self._frames()
        self._events()
        approximated = self._approximation()
        self._speeds()
        none = np.full(len(self.row), -1)
        if self.carried is not None:
            self.noted = force_comments.needed(self.carried, self.targets.kind, none, (), np.nan)
        printed = [self._print(kind, approximated) for kind in (LIN, CIRC, PTP)]
        text, output_line = self._joined(head, printed)
        encoding = "ascii" if text.isascii() else "cp1252"  # the same bytes, but much faster
        document = Document(f"{self.program.name}.src", text, encoding)
        return Written((document,), output_line, "krl", group_issues(self.issues))

    def _head(self) -> list[str]:
        """Return header, initialisation and start position."""
        program, cell = self.program, self.cell
        controller = cell.output.controller
        kind = "targets corrected for deflection" if self._corrected() else "nominal targets"
        source = _printable(program.documents[0].name)
        return [
            *head(program.name, controller, _PARAMETERS_KRC2 if controller == "KRC2" else _PARAMETERS),
            f"; generated by postproc {VERSION} from {source}",
            f"; {kind}, robot {_printable(PurePath(cell.robot).name)}",
            *_INITIALISATION,
            *self._frame_lines(0, bases=True, tools=True),
            *self._distance_line(self.targets.blend),
            axis_motion(cell.start.joints, 5),
        ]

    def _corrected(self) -> bool:
        """Return whether any motion ends elsewhere than it did; most often the first ones already tell."""
        ends = np.flatnonzero(self.last)
        return any(
            np.abs(self.program.motions.target[self.row[part]] - self.targets.pose[part]).max() > _CORRECTED
            for part in map(ends.__getitem__, chunks(len(ends)))
            if len(part)
        )

    def _frame_lines(self, k: int, *, bases: bool, tools: bool) -> list[str]:
        """Return the lines that set the frames of a target."""
        motions, motion = self.program.motions, int(self.row[k]) if len(self.row) else 0
        base, tool = (int(rows[motion]) if len(rows) else 0 for rows in (motions.base, motions.tool))
        out = [f"$BASE={_frame(self.program.bases[base])}"] if bases else []
        return out + ([f"$TOOL={_frame(self.program.tools[tool])}"] if tools else [])

    def _frames(self) -> None:
        """Set frames anew where they change."""
        motions = self.program.motions
        base, tool = motions.base[self.row], motions.tool[self.row]
        for k in (np.flatnonzero((np.diff(base) != 0) | (np.diff(tool) != 0)) + 1).tolist():
            new = self._frame_lines(k, bases=bool(base[k] != base[k - 1]), tools=bool(tool[k] != tool[k - 1]))
            self.before[k] += new
            self.stops.add(k)

    def _events(self) -> None:
        """Write the cell's lines at the first target of the motion that they precede."""
        waiting = -1  # the target before which the advance run already stops
        for event in self.program.events:
            k = int(np.searchsorted(self.row, event.before))
            if event.kind == "comment":
                self.before[k].append(f"; {_printable(event.text)}".rstrip())
            elif event.kind in ("dwell", "stop"):
                self.before[k].append("HALT" if event.kind == "stop" else f"WAIT SEC {_number(event.value)}")
                self.stops.add(k)
                waiting = k
            else:
                own = self._own_lines(event)
                if own and waiting != k:
                    self.before[k].append("WAIT SEC 0")
                    waiting = k
                if own:
                    self.stops.add(k)
                self.before[k] += own or [f"; {event.kind} {_number(event.value)}: no lines for it in the cell"]

    def _own_lines(self, event: Event) -> list[str]:
        """Return the cell's lines for an event, its value put in; tell the user if there are none."""
        gcode = self.cell.gcode
        own: Sequence[str] = getattr(gcode, event.kind)
        if event.kind == "spindle_ccw" and not own and gcode.spindle_on:
            own = gcode.spindle_on
            message = "M4 uses the lines of spindle_on: give spindle_ccw in [gcode] if the direction is to change."
            self.issues.append(Issue("warning", "spindle-direction", message, event.line))
        if not own:
            kind = _NO_LINES[event.kind.partition("_")[0]]
            message = f"The cell has no {event.kind} lines in [gcode]: the program does nothing there."
            self.issues.append(Issue("warning", kind, message, event.line, subject=event.kind))
        return [
            _printable(line.replace("{S}", _number(event.value)).replace("{T}", _number(event.value))) for line in own
        ]

    def _distance_line(self, distances: Array) -> list[str]:
        given = distances[distances > 0.0]
        return [f"$APO.CDIS={_number(MM_PER_M * given[0])}"] if len(given) else []

    def _approximation(self) -> Bools:
        """Set `$APO.CDIS` anew where it changes; return which targets get C_DIS, (K,)."""
        distances = self.targets.blend.copy()
        exact = np.array(sorted(k - 1 for k in self.stops if k > 0), dtype=np.int64)
        distances[exact] = 0.0
        distances[:-1][self.targets.kind[1:] == PTP] = 0.0
        given = np.flatnonzero(distances > 0.0)
        first = self.targets.blend
        current = first[first > 0.0][:1]
        changed = given[np.append(current, distances[given])[:-1] != distances[given]] if len(given) else given
        for k in changed.tolist():
            self.before[k].append(f"$APO.CDIS={_number(MM_PER_M * distances[k])}")
        return distances > 0.0

    def _speeds(self) -> None:
        """Set `$VEL.CP` where it changes."""
        motions = self.program.motions
        path = np.flatnonzero(self.targets.kind != PTP)
        feed = motions.feed[self.row[path]]
        printed = np.rint(feed * 10.0**_SPEED_DECIMALS)
        bad = np.flatnonzero(~(printed > 0.0))
        if len(bad):
            at, speed = int(motions.line[self.row[path[bad[0]]]]), feed[bad[0]]
            problem = "a move has no feed" if np.isnan(speed) else f"the feed is too small: {speed * 60e3:g} mm/min"
            raise ProgramError(
                problem, file=self.program.documents[0].name, line=at, advice="Give F above 0.06 mm/min."
            )
        changed = np.flatnonzero(np.diff(printed, prepend=0.0) != 0.0)
        for k, speed in zip(path[changed].tolist(), printed[changed].tolist(), strict=True):
            self.before[k].append(f"$VEL.CP={speed / 10.0**_SPEED_DECIMALS:.{_SPEED_DECIMALS}f}")

    def _print(self, kind: int, approximated: Bools) -> tuple[bytes, Ints]:
        """Return the lines of all targets of a kind, and where each of them ends."""
        k = np.flatnonzero(self.targets.kind == kind)
        parts = map(k.__getitem__, chunks(len(k)))
        text = b"".join([self._lines(kind, rows, approximated[rows]) for rows in parts if len(rows)])
        return text, np.flatnonzero(np.frombuffer(text, dtype=np.uint8) == ord("\n")) + 1

    def _lines(self, kind: int, k: Ints, approximated: Bools) -> bytes:
        """Return the lines of some targets of a kind."""
        numbers = xyzabc_from_pose(self.targets.pose[k])
        end = _aggregate(numbers)
        tail: list[Bytes | bytes] = [where(b" C_DIS", approximated)]
        if self.carried is not None and self.noted[k].any():
            tail += [where(b" ", self.noted[k]), *force_comments.columns(self.carried, k, self.noted[k])]
        tail.append(b"\r\n")
        if kind == PTP:
            status, turn = self.targets.status[k], self.targets.turn[k]
            end = [*end[:-1], *_bits(b",S ", status), *_bits(b",T ", turn), b"}"]
            return lines([b"PTP ", *end, *tail])
        if kind == CIRC:
            via = _aggregate(self.targets.via[k] * MM_PER_M)
            return lines([b"CIRC ", *via, b",", *end, *tail])
        return lines([b"LIN ", *end, *tail])

    def _joined(self, head: list[str], printed: list[tuple[bytes, Ints]]) -> tuple[str, Ints]:
        """Return the text of the program, and the line of each target (K,)."""
        count = len(self.row)
        kind = self.targets.kind
        rank = np.zeros(count, dtype=np.int64)
        for value in (LIN, CIRC, PTP):
            rank[kind == value] = np.arange(np.count_nonzero(kind == value))
        cuts = set(self.before) | set((np.flatnonzero(np.diff(kind) != 0) + 1).tolist()) | {0, count}
        parts = [line + LINE_END for line in head]
        extra = np.zeros(count + 1, dtype=np.int64)
        for first, last in pairwise([*sorted(cuts), count]):
            parts += [line + LINE_END for line in self.before.get(first, ())]
            extra[first] = len(self.before.get(first, ()))
            if first < last:
                text, ends = printed[int(kind[first])]
                begin = int(ends[rank[first] - 1]) if rank[first] else 0
                parts.append(text[begin : int(ends[rank[last - 1]])].decode("ascii"))
        parts.append(f"END{LINE_END}")
        line = len(head) + np.cumsum(extra[:count]) + np.arange(count) + 1
        return "".join(parts), line


def _aggregate(numbers: Array) -> list[Bytes | bytes]:
    """Return the parts of ``{X …,Y …}`` for (n, 3) or (n, 6) numbers."""
    parts: list[Bytes | bytes] = []
    for name, values, decimals in zip(CARTESIAN, numbers.T, DECIMALS.tolist(), strict=False):
        parts += [f"{',' if parts else '{'}{name} ".encode(), fixed(values, decimals)]
    return [*parts, b"}"]


def _bits(prefix: bytes, values: Ints) -> list[Bytes]:
    """Return S or T where they are given."""
    given = values >= 0
    return [where(prefix, given), fixed(np.where(given, values, np.nan), 0)]


def _frame(pose: Array) -> str:
    numbers = zip("XYZABC", xyzabc_from_pose(pose).tolist(), strict=True)
    return aggregate_text({name: printed(value, _FRAME_DECIMALS, 0) for name, value in numbers})


def _number(value: float) -> str:
    """Return a number without needless zeros."""
    return printed(value, _FRAME_DECIMALS, 0)


def _printable(text: str) -> str:
    """Return a text that stands on one line and in the controller's code page."""
    return " ".join(text.splitlines()).strip().encode("cp1252", "replace").decode("cp1252")
