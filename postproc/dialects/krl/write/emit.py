"""A new KRL program, from G-code: header, frames, start position, motions, and the cell's lines for its events.

Decisions, where KUKA leaves a choice:

- Lines of the cell for spindle, coolant and tool change are preceded by ``WAIT SEC 0``, and the motion before them has
  no C_DIS: the advance run stops there, so that outputs switch once the robot stops, not up to three motions early.
- With ``[gcode] motions = "SLIN"`` path motions are SLIN and SCIRC with C_SPL, which keep the programmed path at any
  speed. PTP gets no C_DIS then: spline and other motions are not approximated into each other.
- Frames are set after these lines. If the lines call a program, all that it may have changed is set again: `$BASE`,
  `$TOOL`, `$APO.CDIS` and speeds. A routine that changes the tool drives to the magazine with frames of its own.
- C_DIS is also left out before a dwell, a HALT, a change of `$BASE` or `$TOOL`, a PTP, and at the end.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import PurePath

import numpy as np

from postproc.cell import Cell
from postproc.decimals import Number, Part, lines, number_text, without_negative_zero, without_trailing_zeros
from postproc.dialects import force_comments
from postproc.dialects.force_comments import text_in_rows
from postproc.dialects.krl.language.names import fault_of, valid_name
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.positions import CARTESIAN
from postproc.dialects.krl.language.source import SRC, Source
from postproc.dialects.krl.language.tree import CallStatement
from postproc.dialects.krl.write.target_numbers import DECIMALS, fixed_point
from postproc.dialects.krl.write.target_statements import aggregate_text
from postproc.dialects.new_program import LINE_END, NewProgram, Words, check_name
from postproc.errors import Issue, group_issues
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, xyzabc_from_pose
from postproc.program import CIRC, PTP, Bools, Document, Ints, Program, TargetForces, Targets, WrittenProgram, constant
from postproc.version import VERSION

_FRAME_DECIMALS = 6
"""Decimals of `$BASE` and `$TOOL` [mm, deg]: far below the tolerance of corrections, also at a lever of metres."""
ANGLE_DECIMALS = 5
"""Decimals of joint angles [deg]: at a lever of 3 m, 0.3 µm."""
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
_WORDS = Words(
    comment=";",
    dwell="WAIT SEC {}",
    halt="HALT",
    axis_motion=lambda joints: axis_motion(joints * DEG_PER_RAD, ANGLE_DECIMALS),
    wait="WAIT SEC 0",
)
_PER_M = 1e6
"""Micrometres in a metre, for the speeds of `NewProgram.path_speeds`."""


def emit(program: Program, targets: Targets, cell: Cell, comment_forces: TargetForces | None = None) -> WrittenProgram:
    """Return a program read from G-code as KRL for the cell's controller.

    :param program: its motions, frames, events and name.
    :param targets: commanded poses.
    :param cell: start position, approximation, lines for events, controller.
    :param comment_forces: forces to be written as comments, on the lines of their targets; None: no force comments.
    :returns: one document, ``NAME.src``, CR LF.
    :raises ProgramError: the controller refuses the name; a move has no feed, or a feed that would be printed as 0.
    :raises ValueError: a number is too large to be written.
    """
    check_name(program, "KRL", fault_of, valid_name)
    return Emitter(program, targets, cell, comment_forces).write()


class Emitter:
    """Prints all targets in bulk, and between them the lines that `NewProgram` collects.

    :param comment_forces: forces that comments state; None: no force comments.
    :param starts: targets before which the program is divided into modules: the robot stops before them, and the first
        path target of each module has a force comment.
    :ivar has_force_comment: (T,) True for targets with a force comment on their line.
    :ivar call_targets: targets before which lines of the cell call other programs, which may change `$BASE` and
        `$TOOL`.
    """

    def __init__(
        self,
        program: Program,
        targets: Targets,
        cell: Cell,
        comment_forces: TargetForces | None,
        starts: Sequence[int] = (),
    ) -> None:
        """Prepare an empty program; `write` fills it."""
        self.program, self.targets, self.cell = program, targets, cell
        self.comment_forces, self.starts = comment_forces, starts
        self.new_program = NewProgram(program, targets, cell, _WORDS)
        self.has_force_comment = np.zeros(len(targets), dtype=np.bool_)
        self.call_targets: list[int] = []

    def write(self) -> WrittenProgram:
        """Return the written program; fill `new_program`, `has_force_comment` and `call_targets`."""
        new, count = self.new_program, len(self.targets)  # `new` collects the lines before each target
        new.stop_targets |= set(self.starts)  # the robot stops before them
        head = [*self.header_lines(self.program.name), *self.start_lines()]
        new.add_events()
        self.call_targets = [
            target
            for target, statements in sorted(new.cell_lines.items())
            if target < count and calls_program(statements)
        ]
        new.issues += self._tool_change_issues()
        frame_changes = set(new.frame_changes())
        for target in sorted(frame_changes.union(self.call_targets)):
            self._set_frames(target)
        distances = new.approximation_distances()
        self._set_distances(distances)
        self._set_speeds()
        self._set_turn_speeds()
        if self.comment_forces is not None:
            # a new program has no notes; NaN: the first path target needs a comment
            self.has_force_comment = force_comments.needs_comment(
                self.comment_forces, self.targets.kind, constant(-1, count), (), start=np.nan
            )
            path_targets = np.flatnonzero(self.targets.kind != PTP)
            # the first path target at or behind each start, if there is one
            path_rows = np.searchsorted(path_targets, np.array(self.starts, dtype=path_targets.dtype))
            self.has_force_comment[path_targets[path_rows[path_rows < len(path_targets)]]] = True
        text, output_line = new.text_and_lines(
            head,
            lambda kind, rows: without_trailing_zeros(self._motion_lines(kind, rows, distances[rows] > 0.0)),
            ["END"],
        )
        # for ASCII text the bytes are the same, and encoding is much faster
        encoding = "ascii" if text.isascii() else "cp1252"
        document = Document(f"{self.program.name}.src", text, encoding)
        return WrittenProgram((document,), output_line, "krl", group_issues(new.issues))

    def header_lines(self, name: str, *comments: str) -> list[str]:
        """Return the header and the initialisation of a module.

        :param name: name of the module.
        :param comments: further comments of the header, without ``;``.
        """
        controller = self.cell.output.controller
        source = _WORDS.printable(self.program.documents[0].name)
        return [
            *head(name, controller, _PARAMETERS_KRC2 if controller == "KRC2" else _PARAMETERS),
            f"; generated by postproc {VERSION} from {source}",
            f"; {self.new_program.target_description()}, robot {_WORDS.printable(PurePath(self.cell.robot).name)}",
            *(f"; {comment}" for comment in comments),
            *_INITIALISATION,
        ]

    def start_lines(self) -> list[str]:
        """Return the lines that set the frames and the first approximation distance, and move to the start position."""
        base, tool = self.new_program.frames_of_target(0)
        blend = self.targets.blend[self.targets.blend > 0.0]
        return [
            f"$BASE={_frame_text(self.program.bases[base])}",
            f"$TOOL={_frame_text(self.program.tools[tool])}",
            *([f"$APO.CDIS={number_text(MM_PER_M * blend[0])}"] if len(blend) else []),
            axis_motion(self.cell.start_angles, ANGLE_DECIMALS),
        ]

    def _set_frames(self, target: int) -> None:
        """Set `$BASE` and `$TOOL` before a target if they change there; both if a program is called before it."""
        base, tool = self.new_program.frames_of_target(target)
        # −1: a called program may have changed them
        old_base, old_tool = (-1, -1) if target in self.call_targets else self.new_program.frames_of_target(target - 1)
        if base != old_base:
            self.new_program.lines_before[target].append(f"$BASE={_frame_text(self.program.bases[base])}")
        if tool != old_tool:
            self.new_program.lines_before[target].append(f"$TOOL={_frame_text(self.program.tools[tool])}")

    def _tool_change_issues(self) -> Iterator[Issue]:
        """Yield an issue for each tool change that calls a program: the path behind the call is not checked."""
        for event in self.program.events:
            target = self.new_program.first_target(event)
            if event.kind != "tool_change" or target == len(self.targets):
                continue
            for line in self.new_program.lines_of(event):
                if calls_program([line]):
                    call = line.strip()
                    message = (
                        f"The path from where {call} leaves the robot to the next target is not checked. Let the "
                        "called program return to where it was called."
                    )
                    yield Issue("info", "after-tool-change", message, event.line, subject=call)

    def _follows_call(self, rows: Ints) -> Bools:
        """Return whether a target (n,) is the first of `rows` at or behind a call of a program.

        :param rows: (n,) targets, ascending, such as all path targets.
        """
        # rows ascend: the first one at or behind each call
        first_indices = np.searchsorted(rows, np.array(self.call_targets, dtype=np.int64))
        return np.isin(np.arange(len(rows)), first_indices)

    def _set_distances(self, distances: Array) -> None:
        """Set `$APO.CDIS` before each target where it changes, or where a called program may have changed it.

        :param distances: (T,) approximation distances of the targets [m]; 0 where the robot stops.
        """
        blend_rows = np.flatnonzero(distances > 0.0)
        blend_distances = distances[blend_rows]
        start_distance = self.targets.blend[self.targets.blend > 0.0][:1]  # set by `start_lines`
        # each distance against the one before it
        changes = blend_distances != np.append(start_distance, blend_distances)[: len(blend_rows)]
        for target in blend_rows[changes | self._follows_call(blend_rows)].tolist():
            self.new_program.lines_before[target].append(f"$APO.CDIS={number_text(MM_PER_M * distances[target])}")

    def _set_speeds(self) -> None:
        """Set `$VEL.CP` before each target where it changes, or where a called program may have changed it."""
        path, speeds = self.new_program.path_speeds()
        # speeds are above 0: the first target of a path always sets its speed
        change_rows = np.flatnonzero((np.diff(speeds, prepend=0.0) != 0.0) | self._follows_call(path))
        for target, speed in zip(path[change_rows].tolist(), speeds[change_rows].tolist(), strict=True):
            self.new_program.lines_before[target].append(f"$VEL.CP={speed / _PER_M:.6f}")

    def _set_turn_speeds(self) -> None:
        """Set `$VEL.ORI1` and `$VEL.ORI2` before each path target at which the rotational speed of the tool changes.

        They are set again behind a called program. Where the program states no speed, they get the values of
        BAS(#INITMOV).
        """
        path = np.flatnonzero(self.targets.kind != PTP)
        speeds = np.nan_to_num(self.new_program.turning_speeds()[path])  # 0: not stated
        change_rows = np.flatnonzero((np.diff(speeds, prepend=0.0) != 0.0) | (self._follows_call(path) & speeds.any()))
        for target, speed in zip(path[change_rows].tolist(), speeds[change_rows].tolist(), strict=True):
            for name in ("ORI1", "ORI2"):
                self.new_program.lines_before[target].append(
                    f"$VEL.{name}={number_text(speed) if speed else f'$VEL_MA.{name}'}"
                )

    def _motion_lines(self, kind: int, rows: Ints, is_blended: Bools) -> bytes:
        """Return the motion lines of n targets of one kind; numbers keep their trailing zeros.

        :param kind: `LIN`, `CIRC` or `PTP`.
        :param rows: (n,) rows of the targets.
        :param is_blended: (n,) True where the motion is approximated.
        """
        numbers = self.targets.pose.xyzabc(rows)
        end = _aggregate_parts(numbers)  # the last part is the closing bracket
        spline = b"S" if self.cell.gcode.motions == "SLIN" else b""
        is_blended = is_blended & (not spline or kind != PTP)  # KRL approximates no PTP into spline motions
        tail: list[Part] = [text_in_rows(b" C_SPL" if spline else b" C_DIS", is_blended)]
        has_comment = self.has_force_comment[rows]
        if self.comment_forces is not None and has_comment.any():
            tail += [
                text_in_rows(b" ", has_comment),
                *force_comments.columns(b";", self.comment_forces, rows, has_comment),
            ]
        tail.append(b"\r\n")
        if kind == PTP:
            status, turn = self.targets.status[rows], self.targets.turn[rows]
            end = [*end[:-1], *_bits_parts(b",S ", status), *_bits_parts(b",T ", turn), b"}"]
            return lines([b"PTP ", *end, *tail])
        if kind == CIRC:
            via = _aggregate_parts(self.targets.via[rows] * MM_PER_M)
            return lines([spline + b"CIRC ", *via, b",", *end, *tail])
        return lines([spline + b"LIN ", *end, *tail])


def calls_program(statements: Sequence[str]) -> bool:
    """Return whether one of some lines of KRL is a call."""
    source = Source.of(Document("cell.toml", "\n".join(statements)), SRC)
    return any(isinstance(statement(source, line + 1), CallStatement) for line in range(len(source.starts)))


def _aggregate_parts(numbers: Array) -> list[Part]:
    """Return ``{X …,Y …}`` for n targets, as columns of text that are printed side by side.

    :param numbers: (n, 3) X, Y, Z [mm], or (n, 6) with A, B, C [deg].
    """
    parts: list[Part] = []
    for name, values, decimals in zip(CARTESIAN, numbers.T, DECIMALS.tolist(), strict=False):
        parts += [f"{',' if parts else '{'}{name} ".encode(), Number.of(values, decimals)]
    return [*parts, b"}"]


def _bits_parts(prefix: bytes, values: Ints) -> list[Part]:
    """Return S or T for n targets, as columns of text that are printed side by side.

    :param prefix: text before the number.
    :param values: (n,) numbers; neither prefix nor number is printed for a negative one.
    """
    is_stated = values >= 0
    return [text_in_rows(prefix, is_stated), Number.of(np.where(is_stated, values, np.nan), 0)]


def _frame_text(pose: Array) -> str:
    """Return a pose (4, 4) [m] as an aggregate of KRL: X, Y, Z [mm], A, B, C [deg]."""
    numbers = zip("XYZABC", xyzabc_from_pose(pose).tolist(), strict=True)
    return aggregate_text({name: fixed_point(value, _FRAME_DECIMALS, 0) for name, value in numbers})


_HEADER = ("&ACCESS RVP", "&REL 1")
_DECLARATIONS_KRC2 = ("EXT BAS (BAS_COMMAND :IN,REAL :IN )",)  # KRC2: BAS must be declared in each program


def head(name: str, controller: str, parameters: Sequence[str] = ()) -> list[str]:
    """Return the first lines of a program: header, DEF and, for KRC2, the declaration of BAS.

    :param controller: ``"KRC4"`` or ``"KRC2"``.
    :param parameters: further lines of the header, with ``&``.
    """
    declarations = _DECLARATIONS_KRC2 if controller == "KRC2" else ()
    return [*_HEADER, *parameters, f"DEF {name}( )", *declarations]


def axis_motion(angles: Iterable[float], decimals: int) -> str:
    """Return the PTP to joint angles A1…A6 [deg], printed with `decimals` decimals."""
    joints = ",".join(f"A{axis} {without_negative_zero(angle):.{decimals}f}" for axis, angle in enumerate(angles, 1))
    return f"PTP {{{joints}}}"


def document(name: str, lines: Iterable[str]) -> Document:
    """Return the file of a program: the lines, then END."""
    return Document(f"{name}.src", "".join(line + LINE_END for line in (*lines, "END")), "cp1252")
