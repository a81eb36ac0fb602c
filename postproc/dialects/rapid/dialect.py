r"""RAPID: writer of new programs, and reader of programs that it has written.

Decisions where RAPID leaves a choice:

- Targets are written in the instructions; tools, work objects, speeds and zones are LOCAL data of the module.
- The first move goes to joint angles (MoveAbsJ). Rapid approaches in joint interpolation are MoveJ, everything else is
  MoveL or MoveC. ``ConfJ\On`` makes MoveJ arrive on the branch of its target; with ``ConfL\Off`` MoveL and
  MoveC keep their branch, which their targets state too.
- ``CirPathMode\ObjectFrame``: along circles, orientations are interpolated in the work object, as in the computation.
- The robot stops in a fine point before lines of the cell, dwells and stops, so that they happen at that point.
- The zone of a move is a circle of the approximation distance around its end, for position and orientation alike.

The reader refuses any other statement, because its effect is not known. It takes numbers as the controller stores them,
in single precision.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from postproc import provenance
from postproc.cell import Cell
from postproc.chunks import Runs
from postproc.decimals import Number, Part, lines
from postproc.dialects import circles, force_comments
from postproc.dialects.force_comments import where
from postproc.dialects.new_program import NewProgram, Words, check_name, number
from postproc.dialects.rapid import language
from postproc.dialects.rapid.language import (
    BEGIN,
    END,
    NO_EXTERNAL_AXES,
    PREFIX,
    abb_from_joints,
    configuration,
    fault_of,
    joints_from_abb,
    poses,
    quaternions,
    status_from_cfx,
    valid,
)
from postproc.dialects.text import line_spans
from postproc.errors import MOST, CellError, InputError, Issue, ProgramError, group_issues, together
from postproc.frames import M_PER_MM, MM_PER_M, RAD_PER_DEG, Array, inverse, xyzabc_from_pose
from postproc.poses import Poses
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
    TargetForces,
    TargetJoints,
    Targets,
    Written,
    constant,
    parse_force_note,
)
from postproc.version import VERSION

_COMMENT = "!"
_MODULE = re.compile(r"(?:\A|(?<=[\r\n]))[ \t]*MODULE[ \t][^\r\n]*(\r{0,2}\n|\r)", re.IGNORECASE)
_OWN = re.compile(r"((?:MODULE[ \t]+mod_)|(?:PROC[ \t]+))[A-Za-z]\w*", re.ASCII)
DECLARATION = re.compile(
    r"LOCAL (?:PERS|CONST) (tooldata|wobjdata|speeddata|zonedata) ([A-Za-z]\w*):=(\[[^;]*\]);", re.ASCII
)
_FARTHEST = 1e6
"""Largest coordinate of a frame [mm]."""


def _to_joints(joints: Array) -> str:
    """Return the motion to joint angles (6,) [rad] that begins with tool and work object of the program."""
    angles = ",".join(f"{angle:.5f}" for angle in (abb_from_joints(joints) + 0.0).tolist())
    return f"MoveAbsJ [[{angles}],{NO_EXTERNAL_AXES}],speed_0,fine,tool_0\\WObj:=wobj_0;"


WORDS = Words("!", "WaitTime {};", "Stop;", _to_joints, encoding="ascii")
_INSTRUCTIONS = {LIN: b"MoveL ", CIRC: b"MoveC ", PTP: b"MoveJ "}
_MILLIMETRES, _QUATERNION = 4, 8
_REORIENTATION, _EXTERNAL = 500.0, "5000,1000"
"""Other numbers of speeddata, as in the controller's own: rotation [deg/s], external axes [mm/s, deg/s]."""
_NO_LOAD = "[0.001,[0,0,0.001],[1,0,0,0],0,0,0]"
"""The load of tool0."""
_SPEED_DECIMALS = 3


def write(
    program: Program, targets: Targets, joints: TargetJoints, cell: Cell, carried: TargetForces | None
) -> Written:
    """Return a program read from G-code as RAPID.

    :param joints: joint angles of the targets, which give their branches.
    :param carried: forces to be written as comments, on lines before their targets.
    :returns: one document, ``NAME.mod``, CR LF.
    :raises ProgramError: the name is not valid in RAPID; a move has no feed, or one that would be printed as 0.
    :raises CellError: a line of the cell is not RAPID.
    """
    check_name(program, "RAPID", fault_of, valid)
    return _NewModule(program, targets, joints, cell, carried).written()


class _NewModule:
    """Writer of all targets at once, with the lines that `NewProgram` collects between them."""

    def __init__(
        self, program: Program, targets: Targets, joints: TargetJoints, cell: Cell, carried: TargetForces | None
    ) -> None:
        self.program, self.targets, self.joints, self.cell, self.carried = program, targets, joints, cell, carried
        self.new = NewProgram(program, targets, cell, WORDS)

    def written(self) -> Written:
        """Return the document."""
        new, program = self.new, self.program
        for _ in new.frame_changes():
            pass  # each target names its frames, but the robot must stop there
        new.events()
        self._check_lines()
        distances = new.distances()
        zones, self.zone = np.unique(distances, return_inverse=True)
        if not len(zones) or zones[0] > 0.0:
            zones, self.zone = np.append(0.0, zones), self.zone + 1
        speeds = self._speeds()
        self._note_forces()
        head = self._head(zones, speeds)
        text, output_line = new.joined(head, self._lines, [*(f"    {line}" for line in END), "  ENDPROC", "ENDMODULE"])
        limit = self.cell.output.lines_per_file
        if limit and text.count("\n") > limit:
            message = f"The module has more than {limit} lines: lines_per_file divides only KRL."
            new.issues.append(Issue("warning", "long-file", message))
        document = Document(f"{program.name}.mod", text, "ascii")
        return Written((document,), output_line, "rapid", group_issues(new.issues))

    def _check_lines(self) -> None:
        """Refuse lines of the cell that are not RAPID or move the robot; indent the others."""
        for k, own in self.new.before.items():
            for line in own:
                fault = language.line_fault(line)
                if fault is not None:
                    raise CellError(
                        f"a line of [gcode] is not allowed in a RAPID program: {line!r}: {fault}",
                        advice='Write it as RAPID in the cell, for example spindle_on = ["SetDO doSpindle,1;"].',
                    )
            self.new.before[k] = [f"    {line}" for line in own]

    def _speeds(self) -> Array:
        """Return the distinct speeds (S, 2) [mm/s, deg/s], MoveJ's first; store the index of each target."""
        path, millionths = self.new.speeds()
        steps = np.rint(millionths * 10.0 ** (_SPEED_DECIMALS - 3)) / 10.0**_SPEED_DECIMALS
        turns = np.nan_to_num(self.new.turning_speeds()[path], nan=_REORIENTATION)
        values, which = np.unique(np.stack([steps, turns], axis=1), axis=0, return_inverse=True)
        self.speed = np.zeros(len(self.targets), dtype=np.int64)
        self.speed[path] = which.reshape(-1) + 1
        return np.concatenate([[[self.cell.gcode.rapid_m_per_s * MM_PER_M, _REORIENTATION]], values])

    def _note_forces(self) -> None:
        """Put force comments before the targets that need one."""
        if self.carried is None:
            return
        none = constant(-1, len(self.targets))
        rows = np.flatnonzero(force_comments.needed(self.carried, self.targets.kind, none, (), np.nan))
        for k, text in zip(rows.tolist(), force_comments.texts(b"!", self.carried, rows), strict=True):
            self.new.before[k].append(f"    {text}")

    def _head(self, zones: Array, speeds: Array) -> list[str]:
        """Return the lines up to the start position."""
        program, cell = self.program, self.cell
        start = ",".join(f"{angle:.5f}" for angle in (abb_from_joints(cell.start_joints) + 0.0).tolist())
        base, tool = self.new.frames(0)
        load = self._load()
        return [
            f"MODULE {PREFIX}{program.name}",
            f"  ! generated by postproc {VERSION} from {WORDS.printable(program.documents[0].name)}",
            f"  ! {self.new.kind()}, robot {WORDS.printable(PurePath(cell.robot).name)}",
            *(
                f"  LOCAL PERS tooldata tool_{row}:=[TRUE,{_frame(pose)},{load}];"
                for row, pose in enumerate(program.tools)
            ),
            *(
                f'  LOCAL PERS wobjdata wobj_{row}:=[FALSE,TRUE,"",{_frame(pose)},[[0,0,0],[1,0,0,0]]];'
                for row, pose in enumerate(program.bases)
            ),
            *(
                f"  LOCAL CONST speeddata speed_{row}:=[{number(speed)},{number(turning)},{_EXTERNAL}];"
                for row, (speed, turning) in enumerate(speeds.tolist())
            ),
            *(
                f"  LOCAL CONST zonedata zone_{row}:={_zonedata(zone)};"
                for row, zone in enumerate(zones.tolist())
                if row
            ),
            f"  PROC {program.name}()",
            *(f"    {line}" for line in BEGIN),
            f"    MoveAbsJ [[{start}],{NO_EXTERNAL_AXES}],speed_0,fine,tool_{tool}\\WObj:=wobj_{base};",
        ]

    def _load(self) -> str:
        """Return the loaddata of the tools: the payload of the cell, or that of tool0 with a warning."""
        payload = self.cell.payload
        if payload.mass_kg > 0.0:
            centre = ",".join(number(value) for value in (payload.X, payload.Y, payload.Z))
            return f"[{number(payload.mass_kg)},[{centre}],[1,0,0,0],0,0,0]"
        message = (
            "The tool data have no load, because the cell has no [payload]. Set the load in the controller before the "
            "program runs, for example with LoadIdentify."
        )
        self.new.issues.append(Issue("warning", "tool-load", message))
        return _NO_LOAD

    def _lines(self, kind: int, k: Ints) -> bytes:
        """Return the lines of some targets of a kind."""
        motions, motion = self.program.motions, self.targets.motion[k]
        target = [b",", *_columns(quaternions(self.targets.pose[k, :3, :3]), _QUATERNION)]
        branch = configuration(self.joints.q[k], self.joints.status[k])
        target += [b",", *_columns(branch.astype(np.float64), 0), f",{NO_EXTERNAL_AXES}]".encode()]
        end = [b"[", *_columns(self.targets.pose[k, :3, 3] * MM_PER_M, _MILLIMETRES), *target]
        via: list[Part] = []
        if kind == CIRC:
            via = [b"[", *_columns(self.targets.via[k] * MM_PER_M, _MILLIMETRES), *target, b","]
        stops = self.zone[k] == 0
        return lines(
            [
                b"    " + _INSTRUCTIONS[kind],
                *via,
                *end,
                b",speed_",
                Number.of(self.speed[k].astype(np.float64), 0),
                where(b",fine", stops),
                where(b",zone_", ~stops),
                Number.of(np.where(stops, np.nan, self.zone[k]), 0),
                b",tool_",
                Number.of(motions.tool[motion].astype(np.float64), 0),
                b"\\WObj:=wobj_",
                Number.of(motions.base[motion].astype(np.float64), 0),
                b";\r\n",
            ]
        )


def _columns(values: Array, decimals: int) -> list[Part]:
    """Return the parts of ``[…,…]`` for (n, c) numbers."""
    parts: list[Part] = []
    for column in values.T:
        parts += [b"," if parts else b"[", Number.of(column, decimals)]
    return [*parts, b"]"]


def _frame(pose: Array) -> str:
    """Return a pose (4, 4) [m] as RAPID has it: millimetres and a quaternion."""
    place = ",".join(number(value) for value in (pose[:3, 3] * MM_PER_M).tolist())
    turn = ",".join(f"{value + 0.0:.{_QUATERNION}f}" for value in quaternions(pose[None, :3, :3])[0].tolist())
    return f"[[{place}],[{turn}]]"


def _zonedata(distance: float) -> str:
    """Return zonedata of an approximation distance [m]; reorientation begins with the path."""
    mm = number(distance * MM_PER_M)
    tenth = number(0.1 * distance * MM_PER_M)
    return f"[FALSE,{mm},{mm},{mm},{tenth},{mm},{tenth}]"


class Data(Struct, eq=False):
    """Tools, work objects, speeds and zones of a module, by name.

    :ivar tools: `$TOOL` in the flange frame (4, 4) [m].
    :ivar bases: `$BASE` in the robot root (4, 4) [m].
    :ivar speeds: of the TCP [m/s].
    :ivar zones: approximation distance [m]; 0 for fine.
    """

    tools: dict[str, Array] = field(default_factory=dict)
    bases: dict[str, Array] = field(default_factory=dict)
    speeds: dict[str, float] = field(default_factory=dict)
    zones: dict[str, float] = field(default_factory=lambda: {"fine": 0.0})

    def declare(self, kind: str, name: str, text: str) -> str | None:
        """Add a declaration; return why it cannot be used, or None."""
        try:
            value = json.loads(text.replace("TRUE", "true").replace("FALSE", "false"))
            _READERS[kind](self, name, value)
        except (ValueError, TypeError, LookupError, RecursionError):
            return f"the {kind} differs from what postproc writes"
        return None


def _pose(value: Any) -> Array:
    place, turn = value
    numbers = np.array([*place, *turn], dtype=np.float64)
    norm = float(np.sqrt(numbers[3:] @ numbers[3:])) if numbers.shape == (7,) else 0.0
    if not (np.abs(numbers) < _FARTHEST).all() or abs(norm - 1.0) > 1e-5:
        raise ValueError
    return np.asarray(poses(numbers[None])[0])


def _tool(data: Data, name: str, value: Any) -> None:
    held, frame, _load = value
    if held is not True:
        raise ValueError
    data.tools[name] = _pose(frame)


def _work_object(data: Data, name: str, value: Any) -> None:
    held, fixed, unit, user, frame = value
    if (held, fixed, unit) != (False, True, ""):
        raise ValueError
    data.bases[name] = _pose(user) @ _pose(frame)


def _speed(data: Data, name: str, value: Any) -> None:
    tcp, _turning, _linear, _rotating = (_single(number) for number in value)
    if not 0.0 < tcp < _FARTHEST:
        raise ValueError
    data.speeds[name] = tcp * M_PER_MM


def _zone(data: Data, name: str, value: Any) -> None:
    fine, *distances = value
    path, turning, *_others = (_single(number) for number in distances)
    if fine is not False or len(distances) != 6 or not 0.0 < path <= turning < _FARTHEST:
        raise ValueError
    data.zones[name] = path * M_PER_MM


def _single(number: Any) -> float:
    """Return a number as the controller stores it."""
    if isinstance(number, bool):
        raise TypeError
    return float(np.float32(number))


_READERS: dict[str, Callable[[Data, str, Any], None]] = {
    "tooldata": _tool,
    "wobjdata": _work_object,
    "speeddata": _speed,
    "zonedata": _zone,
}


_N = r"([-+]?[0-9]{1,9}(?:\.[0-9]{1,12})?)"
_I = r"(-?[0-9])"
_AXES = re.escape(NO_EXTERNAL_AXES)
_TARGET = rf"\[\[{_N},{_N},{_N}\],\[{_N},{_N},{_N},{_N}\],\[{_I},{_I},{_I},([0-7])\],{_AXES}\]"
_REST = r",(\w+),(\w+),(\w+)\\WObj:=(\w+);"
_MOVE = re.compile(rf"Move([LJ]) {_TARGET}{_REST}", re.ASCII)
_CIRCLE = re.compile(rf"MoveC {_TARGET},{_TARGET}{_REST}", re.ASCII)
_ABSOLUTE = re.compile(rf"MoveAbsJ \[\[{','.join([_N] * 6)}\],{_AXES}\]{_REST}", re.ASCII)
_FIRST_LINE = re.compile(r"MODULE [A-Za-z]\w*", re.ASCII)
_PROCEDURE = re.compile(r"PROC ([A-Za-z]\w*)\(\)", re.ASCII)
_KINDS = {"L": LIN, "J": PTP}
_COLUMNS = 11
"""x, y, z, q1…q4, cf1, cf4, cf6, cfx."""
_ADVICE = "Only RAPID that postproc wrote is read. Convert the G-code that the program was made from."
_NOT_NORMALISED = 1e-4


class Layout(Struct, frozen=True, eq=False):
    """Commanded poses of M motions as written.

    :param numbers: (M, 6) X, Y, Z [mm], A, B, C [deg] in the work objects.
    """

    numbers: Array

    def places(self, rows: Ints) -> None:
        """Return None: a module is one file."""

    def orientation_types(self, rows: Ints) -> None:
        """Return None: RAPID has no such setting."""


class _Moves(Struct, eq=False):
    """Texts of the moves, one entry a move."""

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

    :param cell: its start position.
    :param forward: (6,) joints [rad] → (4, 4) flange in the robot root [m], by the controller's nominal geometry.
    :raises InputError: lines that `write` does not write, all together, each with advice.
    """
    return _Reader(document, cell).program(forward, name)


class _Reader:
    """Reader of the lines of a module."""

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
        """Read declarations and settings; return first and last row of the moves."""
        lines = self.lines
        code = [row for row, line in enumerate(lines) if line and not line.startswith("!")]
        begin = next((row for row in code if _PROCEDURE.fullmatch(lines[row])), None)
        ended = [lines[row] for row in code[-2:]] == ["ENDPROC", "ENDMODULE"]
        if not code or not _FIRST_LINE.fullmatch(lines[code[0]]) or begin is None or not ended:
            raise self.error("the file is not one module with one procedure", 1)
        for row in code[1 : code.index(begin)]:
            match = DECLARATION.fullmatch(lines[row])
            fault = self.data.declare(match[1], match[2], match[3]) if match else "the declaration is not understood"
            if fault is not None:
                errors.append(self.error(fault, row + 1))
        inside = code[code.index(begin) + 1 : -2]
        settings = inside[: len(BEGIN)], inside[-len(END) :]
        for rows, given in zip(settings, (BEGIN, END), strict=True):
            if tuple(lines[row] for row in rows) != given:
                raise self.error(f"the moves are not between {' '.join(BEGIN)} and {' '.join(END)}", begin + 1)
        return settings[0][-1] + 1, settings[1][0]

    def _statement(self, line: int, text: str) -> None:
        """Read one statement of the procedure."""
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
            fault = language.line_fault(text)
            if fault is not None:
                raise self.error(f"the statement is not understood: {fault}", line)
            word = language.procedure(text) if text else None
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
            target=Poses.of(pose),
            joints=Runs.of(joints),
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
        """Return the declared values of names."""
        missing = next((row for row, name in enumerate(names) if name not in known), None)
        if missing is not None:
            raise self.error(f"{names[missing]} is not declared in this module", self.moves.line[missing])
        return [known[name] for name in names]

    def _check_quaternions(self, given: Array, line: Ints) -> None:
        off = np.abs(np.einsum("ni,ni->n", given[:, 3:7], given[:, 3:7]) - 1.0) > _NOT_NORMALISED
        if off.any():
            raise self.error("the orientation is not a unit quaternion", int(line[np.argmax(off)]))

    def _arcs(self, starts: Starts, pose: Array, line: Ints, circular: Bools) -> tuple[Array, Array, Array]:
        """Return centre (M, 3), normal (M, 3) and sweep (M,) of circles; NaN elsewhere."""
        rows = np.flatnonzero(circular)
        centre, normal, sweep = (
            np.full((len(line), 3), np.nan),
            np.full((len(line), 3), np.nan),
            np.full(len(line), np.nan),
        )
        if len(rows):
            given = _floats([self.moves.via[row] for row in rows.tolist()])
            self._check_quaternions(given, line[rows])
            via = poses(given[:, :7])[:, :3, 3]
            start = starts.at(rows)[:, :3, 3]
            centre[rows], normal[rows], sweep[rows], flat = circles.through(start, via, pose[rows, :3, 3])
            if flat.any():
                at = int(line[rows[np.argmax(flat)]])
                raise self.error("the three points of the circle are on a line or coincide", at)
        return centre, normal, sweep

    def _issues(self) -> Iterator[Issue]:
        """Yield a warning for each procedure of the user."""
        for name, (line, count) in self.procedures.items():
            message = f"{name} is an unknown procedure: it is assumed neither to move the robot nor to change its data."
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


class _Writer:
    """Writes RAPID: new programs only."""

    extension = ".mod"
    approximation = "approximation (zones)"
    least_arc = (1.01e-4, 1.01 * RAD_PER_DEG)
    """Limits of MoveC, 0.1 mm and 1 deg (Technical reference manual, RAPID Instructions), and 1 % for rounding."""

    def fault_of(self, name: str) -> str | None:
        """Return why the controller would refuse a name for a program, or None if it would not."""
        return language.fault_of(name)

    def valid(self, name: str) -> str:
        """Return the name itself if the controller accepts it, otherwise a similar valid one."""
        return language.valid(name)

    def write(
        self, program: Program, targets: Targets, joints: TargetJoints, cell: Cell, comments: TargetForces | None
    ) -> Written:
        """Return a program as text, see `write`.

        :raises ProgramError: the program was read from RAPID, which can be predicted but not corrected.
        """
        if isinstance(program.layout, Layout):
            raise ProgramError(
                "a RAPID program cannot be corrected",
                file=program.documents[0].name,
                advice="Convert the G-code that it was made from, or see its deviation by `postproc predict`.",
            )
        return write(program, targets, joints, cell, comments)

    def renamed(self, documents: Sequence[Document], name: str) -> tuple[Document, ...]:
        """Return a program under another name: file, module and procedure."""
        (document,) = documents
        text = _OWN.sub(lambda match: match[1] + name, document.text, count=2)
        return (replace(document, name=f"{name}{Path(document.name).suffix}", text=text),)

    def marked(self, documents: Sequence[Document], origin: provenance.Origin) -> tuple[tuple[Document, ...], int]:
        """Return the file with the line of its provenance, below MODULE."""
        return provenance.marked(documents, origin, _COMMENT, _MODULE)

    def origin(self, documents: Sequence[Document]) -> provenance.Provenance:
        """Return the provenance that a program states."""
        return provenance.of(documents, _COMMENT)


class Rapid:
    """ABB RAPID as this package writes it."""

    name = "rapid"
    extensions = (".mod", ".modx")
    command_decimals = (6, 6, 6, 6, 6, 6)
    writer = _Writer()

    def companions(self, path: Path) -> list[Path]:
        """Return no files: a program is one module."""
        del path
        return []

    def read(self, documents: Sequence[Document], cell: Cell, forward: Callable[[Array], Array], name: str) -> Program:
        """Return a program, see `read`."""
        return read(documents[0], cell, forward, name)


RAPID = Rapid()
