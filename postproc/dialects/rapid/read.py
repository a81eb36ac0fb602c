"""A RAPID module as `write` makes them, and no other: what cannot be followed statement by statement is refused.

Numbers are taken as the controller holds them, in single precision.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.dialects import circles
from postproc.dialects.rapid import instructions
from postproc.dialects.rapid.conventions import joints_from_abb, poses, status_from_cfx
from postproc.dialects.rapid.data import DECLARATION, Data
from postproc.dialects.rapid.instructions import BEGIN, END, NO_EXTERNAL_AXES
from postproc.dialects.text import line_spans
from postproc.errors import MOST, InputError, Issue, ProgramError, together
from postproc.frames import M_PER_MM, Array, inverse, xyzabc_from_pose
from postproc.program import (
    CIRC,
    LIN,
    PTP,
    Bools,
    Document,
    ForceNote,
    Ints,
    Motions,
    Program,
    Starts,
    parse_force_note,
)

_N = r"([-+]?[0-9]{1,9}(?:\.[0-9]{1,12})?)"
_I = r"(-?[0-9])"
_AXES = re.escape(NO_EXTERNAL_AXES)
_TARGET = rf"\[\[{_N},{_N},{_N}\],\[{_N},{_N},{_N},{_N}\],\[{_I},{_I},{_I},([0-7])\],{_AXES}\]"
_REST = r",(\w+),(\w+),(\w+)\\WObj:=(\w+);"
_MOVE = re.compile(rf"Move([LJ]) {_TARGET}{_REST}", re.ASCII)
_CIRCLE = re.compile(rf"MoveC {_TARGET},{_TARGET}{_REST}", re.ASCII)
_ABSOLUTE = re.compile(rf"MoveAbsJ \[\[{','.join([_N] * 6)}\],{_AXES}\]{_REST}", re.ASCII)
_MODULE = re.compile(r"MODULE [A-Za-z]\w*", re.ASCII)
_PROCEDURE = re.compile(r"PROC ([A-Za-z]\w*)\(\)", re.ASCII)
_KINDS = {"L": LIN, "J": PTP}
_COLUMNS = 11
"""x, y, z, q1…q4, cf1, cf4, cf6, cfx."""
_ADVICE = "Only RAPID that postproc wrote is read. Convert the G-code that the program was made from."
_NOT_NORMALISED = 1e-4


class Layout(Struct, frozen=True, eq=False):
    """What the text of M motions commands.

    :param numbers: (M, 6) X, Y, Z [mm], A, B, C [deg] in the work objects.
    """

    numbers: Array

    def places(self, rows: Ints) -> None:
        """Return None: a module is one file."""


class _Moves(Struct, eq=False):
    """What stands in the moves, row by row."""

    line: list[int] = field(default_factory=list)
    kind: list[int] = field(default_factory=list)
    target: list[tuple[str, ...]] = field(default_factory=list)
    via: dict[int, tuple[str, ...]] = field(default_factory=dict)
    joints: dict[int, tuple[str, ...]] = field(default_factory=dict)
    named: list[tuple[str, ...]] = field(default_factory=list)

    def add(self, line: int, kind: int, target: tuple[str, ...], named: tuple[str, ...]) -> None:
        self.line.append(line)
        self.kind.append(kind)
        self.target.append(target)
        self.named.append(named)


_NOWHERE = ("nan",) * _COLUMNS


def read(document: Document, cell: Cell, forward: Callable[[Array], Array], name: str) -> Program:
    """Read a RAPID module.

    :param cell: where the robot stands first.
    :param forward: (6,) joints [rad] → (4, 4) flange in the robot root [m], by the controller's nominal geometry.
    :raises InputError: it is not as `write` makes them; all such lines together, each with what to do.
    """
    return _Reader(document, cell).program(forward, name)


class _Reader:
    """Goes through the lines."""

    def __init__(self, document: Document, cell: Cell) -> None:
        self.document, self.cell = document, cell
        self.data, self.moves = Data(), _Moves()
        self.notes: list[ForceNote] = []
        self.procedures: dict[str, tuple[int, int]] = {}
        starts, stops = line_spans(document.text)
        spans = zip(starts.tolist(), stops.tolist(), strict=True)
        self.lines = [document.text[start:stop].strip(" \t\r") for start, stop in spans]

    def error(self, problem: str, line: int, advice: str = _ADVICE) -> ProgramError:
        """Return an error at a 1-based line."""
        return ProgramError(problem, file=self.document.name, line=line, text=self.lines[line - 1], advice=advice)

    def program(self, forward: Callable[[Array], Array], name: str) -> Program:
        """Return the program."""
        errors: list[InputError] = []
        first, last = self._head(errors)
        for line in range(first, last):
            try:
                self._statement(line + 1, self.lines[line])
            except InputError as cause:
                errors.append(cause)
                if len(errors) > MOST:
                    break
        if errors:
            raise together(errors)
        if not self.moves.line:
            raise ProgramError("the program moves nothing", file=self.document.name, advice=_ADVICE)
        motions, numbers, bases, tools = self._motions(forward)
        return Program(
            name,
            "rapid",
            (self.document,),
            motions,
            bases,
            tools,
            notes=tuple(self.notes),
            issues=tuple(self._issues()),
            layout=Layout(numbers),
        )

    def _head(self, errors: list[InputError]) -> tuple[int, int]:
        """Read declarations and what stands around the moves; return the rows of the lines between."""
        lines = self.lines
        code = [row for row, line in enumerate(lines) if line and not line.startswith("!")]
        begin = next((row for row in code if _PROCEDURE.fullmatch(lines[row])), None)
        ended = [lines[row] for row in code[-2:]] == ["ENDPROC", "ENDMODULE"]
        if not code or not _MODULE.fullmatch(lines[code[0]]) or begin is None or not ended:
            raise self.error("this is not one module with one procedure, from MODULE to ENDMODULE", 1)
        for row in code[1 : code.index(begin)]:
            match = DECLARATION.fullmatch(lines[row])
            fault = self.data.declare(match[1], match[2], match[3]) if match else "the declaration is not understood"
            if fault is not None:
                errors.append(self.error(fault, row + 1))
        inside = code[code.index(begin) + 1 : -2]
        settings = inside[: len(BEGIN)], inside[-len(END) :]
        for rows, given in zip(settings, (BEGIN, END), strict=True):
            if tuple(lines[row] for row in rows) != given:
                raise self.error(f"the moves do not stand between {' '.join(BEGIN)} and {' '.join(END)}", begin + 1)
        return settings[0][-1] + 1, settings[1][0]

    def _statement(self, line: int, text: str) -> None:
        """Take one statement of the procedure."""
        if match := _MOVE.fullmatch(text):
            groups = match.groups()
            self.moves.add(line, _KINDS[groups[0]], groups[1 : 1 + _COLUMNS], groups[1 + _COLUMNS :])
        elif match := _CIRCLE.fullmatch(text):
            groups = match.groups()
            self.moves.via[len(self.moves.line)] = groups[:_COLUMNS]
            self.moves.add(line, CIRC, groups[_COLUMNS : 2 * _COLUMNS], groups[2 * _COLUMNS :])
        elif match := _ABSOLUTE.fullmatch(text):
            self.moves.joints[len(self.moves.line)] = match.groups()[:6]
            self.moves.add(line, PTP, _NOWHERE, match.groups()[6:])
        elif text.startswith("!"):
            note = parse_force_note(text[1:], line, self.document.name)
            if note is not None:
                self.notes.append(replace(note, before=len(self.moves.line)))
        else:
            fault = instructions.fault_of(text)
            if fault is not None:
                raise self.error(f"the statement is not understood: {fault}", line)
            word = instructions.procedure(text) if text else None
            if word is not None:
                self.procedures.setdefault(word, (line, 0))
                self.procedures[word] = (self.procedures[word][0], self.procedures[word][1] + 1)

    def _motions(self, forward: Callable[[Array], Array]) -> tuple[Motions, Array, Array, Array]:
        """Return the motions, the numbers of their text, and the frames."""
        moves = self.moves
        kind, line = np.array(moves.kind, dtype=np.int64), np.array(moves.line, dtype=np.int64)
        speed, blend, tool, base = self._named()
        bases, tools = np.stack([*self.data.bases.values()]), np.stack([*self.data.tools.values()])
        given = _floats(moves.target)
        joints = np.full((len(line), 6), np.nan)
        axis = np.array(sorted(moves.joints), dtype=np.int64)
        pose = np.empty((len(line), 4, 4))
        cartesian = np.delete(np.arange(len(line)), axis)
        self._check_quaternions(given[cartesian], line[cartesian])
        pose[cartesian] = poses(given[cartesian, :7])
        numbers = xyzabc_from_pose(_exact(given)) if len(cartesian) else np.full((len(line), 6), np.nan)
        if len(axis):
            angles = _floats([moves.joints[row] for row in axis.tolist()])
            joints[axis] = joints_from_abb(angles.astype(np.float32).astype(np.float64))
            for row in axis.tolist():
                pose[row] = inverse(bases[base[row]]) @ forward(joints[row]) @ tools[tool[row]]
            numbers[axis] = xyzabc_from_pose(pose[axis])
        starts = Starts.of((base, tool, bases, tools), pose.__getitem__, forward(self.cell.start_joints))
        centre, normal, sweep = self._arcs(starts, pose, line, kind == CIRC)
        status = np.full(len(line), -1)
        free = (kind == PTP) & np.isnan(joints[:, 0])
        status[free] = status_from_cfx(given[free, 10].astype(np.int64))
        motions = Motions(
            kind=kind,
            rapid=kind == PTP,
            line=line,
            target=pose,
            joints=joints,
            centre=centre,
            normal=normal,
            sweep=sweep,
            feed=np.where(kind == PTP, np.nan, speed),
            base=base,
            tool=tool,
            blend=blend,
            rounding=np.full(len(line), np.inf),
            status=status,
            turn=np.full(len(line), -1),
        )
        return motions, numbers, bases, tools

    def _named(self) -> tuple[Array, Array, Ints, Ints]:
        """Return speed [m/s], approximation distance [m], and rows of tools and bases of each motion."""
        tools = {name: row for row, name in enumerate(self.data.tools)}
        bases = {name: row for row, name in enumerate(self.data.bases)}
        speed, zone, tool, base = (list(names) for names in zip(*self.moves.named, strict=True))
        return (
            np.array(self._values(self.data.speeds, speed)),
            np.array(self._values(self.data.zones, zone)),
            np.array(self._values(tools, tool), dtype=np.int64),
            np.array(self._values(bases, base), dtype=np.int64),
        )

    def _values(self, known: Mapping[str, float], names: list[str]) -> list[float]:
        """Return what is declared under some names."""
        missing = next((row for row, name in enumerate(names) if name not in known), None)
        if missing is not None:
            raise self.error(f"{names[missing]} is not declared in this module", self.moves.line[missing])
        return [known[name] for name in names]

    def _check_quaternions(self, given: Array, line: Ints) -> None:
        off = np.abs(np.einsum("ni,ni->n", given[:, 3:7], given[:, 3:7]) - 1.0) > _NOT_NORMALISED
        if off.any():
            raise self.error("the orientation is no unit quaternion", int(line[np.argmax(off)]))

    def _arcs(self, starts: Starts, pose: Array, line: Ints, circular: Bools) -> tuple[Array, Array, Array]:
        """Return centre (M, 3), normal (M, 3) and sweep (M,) of circles; NaN elsewhere."""
        rows = np.flatnonzero(circular)
        centre, normal, sweep = (
            np.full((len(line), 3), np.nan),
            np.full((len(line), 3), np.nan),
            np.full(len(line), np.nan),
        )
        if len(rows):
            via = poses(_floats([self.moves.via[row] for row in rows.tolist()])[:, :7])[:, :3, 3]
            start = starts.at(rows)[:, :3, 3]
            centre[rows], normal[rows], sweep[rows], flat = circles.through(start, via, pose[rows, :3, 3])
            if flat.any():
                at = int(line[rows[np.argmax(flat)]])
                raise self.error("the three points of the circle lie on a line or coincide", at)
        return centre, normal, sweep

    def _issues(self) -> Iterator[Issue]:
        """Tell of procedures that may do anything."""
        for name, (line, count) in self.procedures.items():
            message = (
                f"{name} is no instruction known here: it is assumed not to move the robot, nor to change its data."
            )
            yield Issue("warning", "external-call", message, line, subject=name.upper(), count=count)


def _floats(rows: list[tuple[str, ...]]) -> Array:
    """Return texts of numbers as an array; much faster than one by one."""
    return np.array(" ".join(" ".join(row) for row in rows).split(" "), dtype=np.float64).reshape(len(rows), -1)


def _exact(given: Array) -> Array:
    """Return the poses (M, 4, 4) [m] of targets as their text has them; unit poses where there are none."""
    numbers = np.where(np.isnan(given[:, :7]), [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], given[:, :7])
    out = poses(np.column_stack([np.zeros((len(numbers), 3)), numbers[:, 3:]]))
    out[:, :3, 3] = numbers[:, :3] * M_PER_MM
    return out
