"""A program as it was read: every line kept, its motions as arrays.

A `Program` is what a dialect's reader makes and what the rest of the package works on. It owns no
physics. The text stays in `Document`s to the byte; `Motions` says what the lines mean.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any, Literal, NamedTuple, Protocol, TypeVar

import numpy as np
from msgspec import Struct, field
from msgspec.structs import force_setattr
from numpy.typing import NDArray

from postproc.chunks import Runs, compact
from postproc.errors import ForceError, Issue, Level, ProgramError, choices
from postproc.frames import Array, inverse, norm, rotation_from_vector
from postproc.poses import Poses, as_poses

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LIN, CIRC, PTP, SPL = 0, 1, 2, 3
"""Values of `Motions.kind`: straight line of the TCP, circular arc (or helix) of the TCP, joint interpolation, piece of
a spline, of whose path only the end is known."""


_PIECE = 2**20
"""Characters of a piece of a document."""


class Document(Struct, frozen=True, eq=False):
    """One file of a program, lossless: ``text`` encoded with ``encoding`` (BOM first if it had one) is the file.

    :param name: file name with extension, e.g. ``part.src``.
    :param text: content with its own line ends (never translated), without the BOM.
    :param encoding: Python codec that was used to decode, e.g. ``utf-8`` or ``cp1252``.
    :param bom: bytes of the byte order mark, or empty.
    :param folder: where it was read from; empty if from nowhere.
    """

    name: str
    text: str
    encoding: str = "utf-8"
    bom: bytes = b""
    folder: str = ""

    def to_bytes(self) -> bytes:
        """Return the content of the file."""
        return b"".join(self.pieces())

    def pieces(self, size: int = _PIECE) -> Iterator[bytes]:
        """Yield the content of the file in pieces of `size` characters, so that a long text is not held twice."""
        yield self.bom
        for start in range(0, len(self.text), size):
            yield self.text[start : start + size].encode(self.encoding)


def _make_compact(record: Struct, **kinds: type[np.integer[Any]]) -> None:
    """Replace columns of whole numbers of a record, by their names, with columns of smaller types.

    :raises OverflowError: a type does not hold the numbers.
    """
    for name, kind in kinds.items():
        force_setattr(record, name, compact(np.asarray(getattr(record, name)), kind))


class Motions(Struct, frozen=True, eq=False):
    """M motions in the order of execution, one end point each. Lengths m, angles rad, speeds m/s.

    :param kind: (M,) `LIN`, `CIRC`, `PTP` or `SPL`.
    :param rapid: (M,) True for G0 and PTP: moves that never carry force.
    :param line: (M,) 1-based line of the (first) document that makes the motion.
    :param target: M poses of the tool frame in `$BASE` at the end (for axis targets: by the controller's forward
        kinematics); an array (M, 4, 4) of a reader becomes `Poses`.
    :param joints: (M, 6) end in joint angles, KUKA signs, for axis targets (PTP {A1 …}); NaN elsewhere. An array
        becomes `Runs`.
    :param centre: (M, 3) centre of the arc at the start's height, `$BASE`; NaN unless CIRC.
    :param normal: (M, 3) unit axis of the arc, `$BASE`; NaN unless CIRC.
    :param sweep: (M,) angle turned about `normal` (right hand, > 0); NaN unless CIRC. A helix rises along
        `normal` linearly with the angle; its rise is the component of end − start along `normal`.
    :param feed: (M,) speed of the TCP [m/s]; NaN for PTP (the controller's joint interpolation).
    :param base: (M,) row of `Program.bases` in force.
    :param tool: (M,) row of `Program.tools` in force.
    :param blend: (M,) approximation distance [m] before the target (C_DIS with $APO.CDIS); 0 = exact stop.
    :param rounding: (M,) what blending may round the path by at the end [m]: where it would be more, an exact stop is
        written. Infinite in KRL, whose C_DIS stay.
    :param status: (M,) KUKA S of a PTP target; −1 where none is given.
    :param turn: (M,) KUKA T of a PTP target; −1 where none is given.
    """

    kind: Ints
    rapid: Bools
    line: Ints
    target: Poses
    joints: Runs
    centre: Array
    normal: Array
    sweep: Array
    feed: Array
    base: Ints
    tool: Ints
    blend: Array
    rounding: Array
    status: Ints
    turn: Ints

    def __post_init__(self) -> None:
        force_setattr(self, "target", as_poses(self.target))
        force_setattr(self, "joints", Runs.of(self.joints))
        _make_compact(self, kind=np.int8, line=np.int32, base=np.int32, tool=np.int32, status=np.int16, turn=np.int16)

    def __len__(self) -> int:
        return len(self.line)

    def issue(self, level: Level, kind: str, message: str, motion: Ints) -> Issue:
        """Return an issue of motions (n,), n ≥ 1: it names the line of the first, and counts them."""
        line = self.line[motion]
        lines = tuple(distinct(line).tolist())
        return Issue(level, kind, message, source_line=int(line[0]), count=len(distinct(motion)), lines=lines)


class Swivel(Struct, frozen=True, eq=False):
    """How motions turn the tool where its orientation is given by rotary axes, which turn evenly along a motion.

    The direction d from the tip to the spindle is that of R₁(a)·R₂(b)·z. The tool is tilted from z to d by the smallest
    rotation. It never spins about its axis, so nothing jumps where the axis next to the part is parallel to the tool.

    :param begin: (M, k) angles of the axes at the start of each motion, k = 1 or 2 [rad]; `end` (M, k) at its end.
        With k = 3 both are directions d, and d turns between them by the shortest way.
    :param axes: (k, 3) what they turn about, from the part outwards, in the program frame; sign included.
    :param frame: (M,) row of `frames` (nf, 3, 3): orientation of the program frame in `$BASE`.
    :param tool: (3, 3) orientation of the tool frame in the program frame at d = z.
    :param active: (M,) True for motions that these axes turn; False for those that do not start where the angles say.
    :param rate: (M,) how fast motions turn the tool that do not move its tip [rad/s]; NaN: as fast as the controller
        does it, and for all others.
    :param spin: (M, 2) turn of the tool about d in addition, at the start and at the end of each motion [rad]; None: it
        is that of `tool` everywhere.
    """

    begin: Array
    end: Array
    axes: Array
    frame: Ints
    frames: Array
    tool: Array
    active: Bools
    rate: Array
    spin: Array | None = None

    @property
    def travel(self) -> Array:
        """(M,) largest rotation of the tool [rad]: 0 where it is parallel to the axis that turns."""
        rotation = largest_rotation(self.axes, self.begin, self.end)
        if self.spin is not None:
            rotation = rotation + np.abs(self.spin[:, 1] - self.spin[:, 0])
        return np.asarray(np.where(self.active, rotation, 0.0))

    def at(self, motion: Ints, t: Array) -> Array:
        """Return the orientation of the tool frame (n, 3, 3) in `$BASE` at places (motion, t)."""
        begin, end = self.begin[motion], self.end[motion]
        orientation = self.orientation(begin + t[:, None] * (end - begin), self.frame[motion])
        if self.spin is None:
            return orientation
        start_spin, end_spin = self.spin[motion].T
        spin = start_spin + t * (end_spin - start_spin)
        # a turn about d is a turn about z of the program frame before the tool is tilted
        z_in_tool = self.tool[2]
        spin_rotation = rotation_from_vector(spin[:, None] * z_in_tool)
        return np.asarray(orientation @ spin_rotation)

    def orientation(self, angles: Array, frame: Ints) -> Array:
        """Return the orientation of the tool frame (n, 3, 3) in `$BASE` for angles (n, k) [rad] in frames (n,)."""
        return np.asarray(self.frames[frame] @ tilt_to(self.direction(angles)) @ self.tool)

    def direction(self, angles: Array) -> Array:
        """Return d (n, 3), in the program frame, for angles (n, k) [rad]."""
        return direction(self.axes, angles)


class Turning(Protocol):
    """How motions turn the tool along their path if not by one rotation: see `Swivel`, and `kinematics.ByWrist`."""

    @property
    def active(self) -> Bools:
        """(M,) False for motions that turn it by one rotation."""

    @property
    def travel(self) -> Array:
        """(M,) largest rotation of the tool [rad]."""

    def at(self, motion: Ints, t: Array) -> Array:
        """Return the orientation of the tool frame (n, 3, 3) in `$BASE` at places (motion, t)."""


COMPONENTS = 3
"""Columns of angles that are components of a direction: a tool has at most two rotary axes."""


def direction(axes: Array, angles: Array) -> Array:
    """Return the direction R₁(a)·R₂(b)·z (n, 3) of a tool on rotary axes (k, 3), for angles (n, k) [rad].

    Angles (n, 3) are components of the direction itself, of any length.
    """
    if angles.shape[1] == COMPONENTS:
        return np.asarray(angles / norm(angles)[:, None])
    vector = np.broadcast_to([0.0, 0.0, 1.0], (len(angles), 3)).copy()
    for axis, angle in zip(axes[::-1], angles.T[::-1], strict=True):
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        vector = vector * cos + np.cross(axis, vector) * sin + (vector @ axis)[:, None] * axis * (1.0 - cos)
    return vector


def largest_rotation(axes: Array, begin: Array, end: Array) -> Array:
    """Return the largest rotation of a tool (n,) [rad] while rotary axes turn evenly from `begin` to `end` (n, k).

    An axis at the angle β to the tool moves its direction by sin β times its own turn; tilted by the shortest way
    (`tilt_to`), the tool then turns by 1/cos(θ/2) times as much, where θ is how far it leans from z.
    """
    shares = np.linspace(0.0, 1.0, 5)
    tool_direction = np.stack([direction(axes, begin + share * (end - begin)) for share in shares])
    axis_turn = np.abs(end - begin)
    # 1/cos(θ/2) = √(2/(1 + cos θ)); near θ = 180°, where `tilt_to` has no value, it is bounded
    factor = np.sqrt(2.0 / np.maximum(1.0 + tool_direction[..., 2].min(axis=0), 1e-3))
    if begin.shape[1] == COMPONENTS:  # the direction itself turns, by the angle of its chord
        return np.asarray(2.0 * np.arcsin(norm(tool_direction[-1] - tool_direction[0]) / 2.0) * factor)
    sine = norm(np.cross(tool_direction, axes[0])).max(axis=0)
    if len(axes) == 1:
        return np.asarray(axis_turn[:, 0] * sine * factor)
    # from the nearest of these places the inner axis turns by half a step at most, and changes the sine by no more
    sine = np.minimum(sine + axis_turn[:, 1] / (2 * (len(shares) - 1)), 1.0)
    inner_sine = float(norm(np.cross(axes[-1], [0.0, 0.0, 1.0])))
    return np.asarray((axis_turn[:, 0] * sine + axis_turn[:, 1] * inner_sine) * factor)


class Carriage(Struct, frozen=True, eq=False):
    """Position of the linear axis E1 that carries the robot along M motions: it moves evenly with them.

    :param begin: (M,) E1 at the start of each motion [m]; `end` (M,) at its end.
    :param direction: (3,) unit vector in the robot root: direction of travel of the robot for positive E1.
    """

    begin: Array
    end: Array
    direction: Array

    @property
    def travel(self) -> Array:
        """(M,) its travel along each motion [m]."""
        return np.asarray(np.abs(self.end - self.begin))

    def at(self, motion: Ints, t: Array | float = 1.0) -> Array:
        """Return E1 (n,) [m] at places (motion, t)."""
        begin = self.begin[motion]
        return np.asarray(begin + t * (self.end[motion] - begin))

    def offset(self, motion: Ints, t: Array | float = 1.0) -> Array:
        """Return the position of the robot root (n, 3) [m] at places (motion, t), relative to that at E1 = 0."""
        return np.asarray(self.at(motion, t)[:, None] * self.direction)


def tilt_to(direction: Array) -> Array:
    """Return the rotations (n, 3, 3) that turn z into unit vectors (n, 3) by the shortest way; not into −z.

    >>> tilt_to(np.array([[1.0, 0.0, 0.0]])).round(12).tolist()
    [[[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]]
    """
    x, y, z = direction.T
    factor = 1.0 / (1.0 + z)
    rotation = np.empty((len(direction), 3, 3))
    # 0 − a is never −0, which −a may be
    rotation[:, 0] = np.stack([1.0 - x * x * factor, 0.0 - x * y * factor, x], axis=1)
    rotation[:, 1] = np.stack([0.0 - x * y * factor, 1.0 - y * y * factor, y], axis=1)
    rotation[:, 2] = np.stack([0.0 - x, 0.0 - y, z], axis=1)
    return rotation


class FrameColumns(NamedTuple):
    """Frames of M motions.

    :ivar base: (M,) row of the `$BASE` of each motion in `bases`.
    :ivar tool: (M,) row of the `$TOOL` of each motion in `tools`.
    :ivar bases: (nb, 4, 4) in the robot root [m].
    :ivar tools: (nt, 4, 4) in the flange frame [m].
    """

    base: Ints
    tool: Ints
    bases: Array
    tools: Array


class Starts(Struct, frozen=True, eq=False):
    """Start poses of M motions: the end of the motion before, in the `$BASE` and with the `$TOOL` of the motion itself.

    :param end: returns the tool frames (n, 4, 4) at the ends of motions (n,), `$BASE` of those motions [m].
    :param changed: (S,) motions whose start is expressed in other frames than the end of the one before: the first,
        and those with another base or tool.
    :param pose: (S, 4, 4) tool frame at their start, in their `$BASE` [m].
    """

    end: Callable[[Ints], Array]
    changed: Ints
    pose: Array

    @classmethod
    def of(
        cls,
        frames: FrameColumns,
        end: Callable[[Ints], Array],
        start_flange_in_root: Array,
        predecessor: Ints | None = None,
    ) -> Starts:
        """Return the starts of motions.

        :param frames: of the M motions.
        :param start_flange_in_root: (4, 4) flange pose before the first motion [m].
        :param predecessor: (M,) the motion at whose end each begins, see `Program.after`; None: the motion before it.
        """
        base, tool, bases, tools = frames
        # motions whose start is expressed in other frames than the end of the motion before
        changed = np.flatnonzero((np.diff(base) != 0) | (np.diff(tool) != 0)) + 1
        previous = changed - 1
        if predecessor is not None:
            changed = distinct(np.append(changed, np.flatnonzero(predecessor != np.arange(len(base)) - 1)))
            previous = predecessor[changed]
        # flange in the root where each of them begins
        flange = bases[base[previous]] @ end(previous) @ inverse(tools[tool[previous]])
        flange[previous < 0] = start_flange_in_root
        if not len(changed) or changed[0] > 0:  # motion 0 begins where the program starts, not at the end of another
            changed = np.concatenate([[0], changed])
            flange = np.concatenate([start_flange_in_root[None], flange])
        return cls(end, changed, inverse(bases[base[changed]]) @ flange @ tools[tool[changed]])

    def at(self, motion: Ints) -> Array:
        """Return the tool frames (n, 4, 4) at the start of motions (n,), in their `$BASE` [m]."""
        pose = self.end(motion - 1)  # of motion 0, which is a changed one, replaced below
        index, is_changed = self.find_changed(motion)
        pose[is_changed] = self.pose[index[is_changed]]
        return pose

    def find_changed(self, motion: Ints) -> tuple[Ints, Bools]:
        """Return the index (n,) of motions in `changed`, and which (n,) are in it; the other indices mean nothing."""
        index = np.searchsorted(self.changed, motion)
        return index, np.append(self.changed, -1)[index] == motion


ForceFrame = Literal["BASE", "TOOL", "FEED"]
FORCE_FRAMES: tuple[ForceFrame, ...] = ("BASE", "TOOL", "FEED")
WRENCH = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
"""Components of a wrench [N, N·m], as columns of files are called."""
MOST_FORCE = 1e6
"""A force or moment beyond this [N, N·m], a hundred times the load of any arm, is an input error."""


class ForceNote(Struct, frozen=True):
    """A force comment of the program: modal from its line on, until the next note.

    :param line: 1-based line of the comment.
    :param wrench: Fx, Fy, Fz [N], Mx, My, Mz [N·m]; all zero for ``FORCE OFF``.
    :param frame: axes of the wrench: BASE, TOOL or FEED.
    :param before: row of the first motion that gets the force: on the line of the comment, or executed after it; −1
        until the reader of a dialect has said it.
    :param is_restated: True if the text has no comment here: where branches begin or meet, the reader states the force
        that acts again.
    """

    line: int
    wrench: tuple[float, float, float, float, float, float]
    frame: ForceFrame = "BASE"
    before: int = -1
    is_restated: bool = False


_PROSE = (
    r"[ \t-]+(?![ \t-])(?![^\r\n]{300})"
    r"(?![^\r\n]*(?:[\d=]|\b(?:OFF|ON|NO|NOT|NONE|NULL|ZERO|END|STOP|AUS|F[XYZ]|M[XYZ]|FRAME)\b))"
    r"[^\W\d_]{3,}[ \t-]+[^\W\d_]"
)
"""What follows FORCE in a comment such as "Force exact path": two words, and nothing that gives or ends a force, in
less than 300 characters: so a line costs no more than its length, however often FORCE is in it."""
FORCE_COMMENT = re.compile(
    rf"[ \t(]*FORCE(?!{_PROSE})(?:\b|\w?[ \t]*OFF\b)|(?![ \t]*FOLD\b)[^\r\n;]*?\bF[XYZ][ \t]*=[ \t]*[-+.\d]",
    re.IGNORECASE,
)
"""The beginning of a comment that is about forces, or was meant to be: it begins with the word FORCE, unless prose
follows, or gives FX, FY or FZ a number. (The inline forms of KRL, ``;FOLD …``, give their parameters in this way.)"""
_FORCE_WORD = re.compile(r"\s*FORCE\b", re.IGNORECASE)
_FORCE_PART = re.compile(
    r"\s*(?:(?P<component>F[XYZ]|M[XYZ])\s*=\s*(?P<value>[^\s=]+)|FRAME\s*=\s*(?P<frame>\w+))", re.IGNORECASE
)
"""A component of a force comment, such as ``FX=120``, or its frame."""


def parse_force_note(comment: str, line: int, file: str) -> ForceNote | None:
    """Read ``FORCE FX=120 FY=-40.5 FZ=300 [MX= MY= MZ=] [FRAME=TOOL]`` or ``FORCE OFF`` from a comment.

    :param comment: text of the comment without its brackets or semicolon.
    :returns: the note, without `before`; None if the comment is not about forces, see `FORCE_COMMENT`.
    :raises ForceError: it is, but cannot be read to its end, a word is misspelt or a value is out of range.
    """
    if FORCE_COMMENT.match(comment) is None:
        return None
    advice = "Write FORCE FX=120 FY=-40.5 FZ=300 [MX= MY= MZ=] [FRAME=BASE|TOOL|FEED], or FORCE OFF (N, N·m)."
    force_word = _FORCE_WORD.match(comment)
    if force_word is None and comment.lstrip(" \t").startswith("("):
        raise ForceError(
            "the force comment is in brackets", file=file, line=line, text=comment, advice=f"Leave them out. {advice}"
        )
    if force_word is None:
        problem = "looks like a force comment, but does not begin with the word FORCE"
        raise ForceError(problem, file=file, line=line, text=comment, advice=advice)
    remaining_text = comment[force_word.end() :]
    if remaining_text.strip().upper() == "OFF":
        return ForceNote(line, (0.0,) * 6)
    wrench: dict[str, float] = {}
    frame: ForceFrame = "BASE"
    position, end = 0, len(remaining_text.rstrip())
    while position < end:
        part = _FORCE_PART.match(remaining_text, position)
        try:
            if part is None:
                raise ValueError  # noqa: TRY301
            if part["frame"]:
                frame = FORCE_FRAMES[FORCE_FRAMES.index(part["frame"].upper())]
            else:
                component, value = part["component"].upper(), float(part["value"])
                if not abs(value) <= MOST_FORCE or component in wrench:
                    raise ValueError  # noqa: TRY301
                wrench[component] = value
        except ValueError:
            problem = "force comment cannot be read"
            if part is not None and (name := part["frame"]):
                problem, advice = f"unknown frame {name!r}", choices(name, FORCE_FRAMES, "Valid frames")
            raise ForceError(problem, file=file, line=line, text=comment, advice=advice) from None
        position = part.end()
    if not wrench:
        raise ForceError("force comment without a component", file=file, line=line, text=comment, advice=advice)
    fx, fy, fz, mx, my, mz = (wrench.get(name, 0.0) for name in ("FX", "FY", "FZ", "MX", "MY", "MZ"))
    return ForceNote(line, (fx, fy, fz, mx, my, mz), frame)


EventKind = Literal[
    "spindle_on",
    "spindle_ccw",
    "spindle_off",
    "coolant_on",
    "coolant_off",
    "tool_change",
    "dwell",
    "stop",
    "m_code",
    "comment",
]


SWITCHED_OFF: dict[EventKind, EventKind] = {
    "spindle_on": "spindle_off",
    "spindle_ccw": "spindle_off",
    "coolant_on": "coolant_off",
}
"""Kind of an event that switches something on → the kind that switches it off."""


class Event(Struct, frozen=True):
    """What a program does besides moving, in order; of G-code it becomes lines of KRL.

    Of KRL comments and waits are known, first all comments; of RAPID waits. A wait of KRL is one event for each motion
    at whose end the program may wait there.

    :param before: row of the motion before which it takes place (number of motions = after the last).
    :param kind: see `EventKind`; ``dwell`` is G4, ``stop`` M0/M1, ``m_code`` one of `[m_codes]`.
    :param line: 1-based source line.
    :param value: spindle speed [rpm], tool number, dwell [s], NaN if it is not known, number of the
        M-code; 0 where there is none.
    :param text: text of a comment.
    :param waits: True if the robot waits in the lines that the cell has for it.
    """

    before: int
    kind: EventKind
    line: int
    value: float = 0.0
    text: str = ""
    waits: bool = False


class Places(Struct, frozen=True, eq=False):
    """Files and lines of n motions of a program.

    :param files: names of files.
    :param file: (n,) index in `files`.
    :param line: (n,) 1-based line of that file.
    """

    files: tuple[str, ...]
    file: Ints
    line: Ints

    def of(self, row: int) -> tuple[str, int]:
        """Return file and line of a row."""
        return self.files[int(self.file[row])], int(self.line[row])


class UnresolvedMotion(Struct, frozen=True):
    """A motion that is left unchanged: its target, or whether it runs, is only known at run time.

    :param file: name of its file; `line` its 1-based line there.
    :param text: the statement.
    :param why: reason why it cannot be resolved.
    """

    file: str
    line: int
    text: str
    why: str


class NeededFile(Struct, frozen=True):
    """A file next to a program that it needs to run, and that is left unchanged.

    :param path: of the file.
    :param moves: True if the routine called there moves the robot.
    :param uncorrected: True if the file has motions.
    :param program: name of a program with motions to which a data file belongs, which is not written for its GLOBAL
        variables alone; empty: the file is written.
    :param variables: names of the variables that the program takes from there, if `program` is given; empty if a
        data list imports some.
    """

    path: str
    moves: bool
    uncorrected: bool = False
    program: str = ""
    variables: tuple[str, ...] = ()


class UnfollowedCall(Struct, frozen=True, eq=False):
    """A call of a routine in another file that cuts, and whose motions are unknown.

    :param line: of the main file.
    :param error: raised if a force acts there; names the statement that cannot be followed.
    """

    line: int
    error: ProgramError


class Layout(Protocol):
    """Positions of the numbers in the text of a program: left by a reader for the writer of the same dialect."""

    @property
    def numbers(self) -> Array:
        """X, Y, Z [mm], A, B, C [deg] (M, 6) of its motions as the text commands them."""
        ...

    def places(self, rows: Ints) -> Places | None:
        """Return file and line of motions (n,); None if all are in the main file, where `Motions.line` is the line."""
        ...

    def orientation_types(self, rows: Ints) -> NDArray[np.str_] | None:
        """Return the orientation control of motions (n,) that the text sets (`$ORI_TYPE`); None without such a
        setting.
        """
        ...


class Program(Struct, frozen=True, eq=False):
    """A program: its documents to the byte, its motions as arrays.

    :param name: name of the program (stem of its file); the written program gets the same.
    :param dialect: name of the format it was read from: ``"gcode"``, ``"krl"``, see `dialects.registry`.
    :param documents: the main file first (`.src`, `.nc`), then `.dat` where there is one.
    :param motions: motions in execution order.
    :param bases: (nb, 4, 4) `$BASE` in `$ROBROOT` at E1 = 0, row `motions.base[i]` for motion i [m].
    :param tools: (nt, 4, 4) `$TOOL` in the flange frame, row `motions.tool[i]` [m].
    :param tool_keys: for each of `tools` the names by which a process may state its cutter: n of each `TOOL_DATA[n]`
        (KRL) or the tooldata (RAPID) that the program takes it from; empty: tools have T numbers, as in G-code.
    :param notes: force comments in order of their lines.
    :param events: instructions other than motions, in order; for KRL only comments (it keeps its text instead).
    :param still: (s,) lines of moves of zero length: they have no row in `motions`, but may have a force.
    :param issues: issues of the reader; none of level error (a reader raises instead).
    :param after: (M,) row of the motion at whose end each begins, −1 for the start of the program; its own row if its
        start is unknown: it is assumed to begin at its end. None: each begins where the one before ends.
    :param joins: control-flow joins: rows of motions (−1: the start) that end branches not known before run time, or
        iterations of an endless loop.
    :param branches: first motion of each branch not known before run time, and the one behind its last (rows).
    :param transitions: motions that may also begin at the end of another one than `after` says, and that one (rows;
        −1: the start): behind branches that end apart, and in the second round of a LOOP without EXIT.
    :param swivel: orientation along motions given by rotary axes; None: LIN and CIRC turn it by one rotation.
    :param is_wrist_led: (M,) True for lines on which the wrist axes turn the tool (``$ORI_TYPE=#JOINT``); None: none.
    :param wrist: how they do so with the robot of the cell, see `under_load.led_by_wrist`.
    :param carriage: the linear axis that carries the robot; None: there is none.
    :param turns_with_path: (M,) True for arcs along which the tool turns with the direction of travel: the orientation
        relative to this direction changes by one rotation. None: there are none.
    :param turn_speeds: (M, 3) largest speeds at which motions may turn the tool [rad/s]: any turn (RAPID, v_ori), that
        of its x axis and that about it (`$VEL.ORI1`, `$VEL.ORI2`); infinite where none is stated. None: none is.
    :param unforced: rows of feed moves that come from `[start]` of the cell: an error if a force acts there.
    :param unresolved: motions that are left unchanged: `motions` has no row for them.
    :param unfollowed: calls of routines that cut, and have no rows either: an error if a force acts there.
    :param needed: files next to it that it needs to run, and that are left unchanged.
    :param layout: positions of its numbers in its text; None for G-code and APT, whose text is not written again.
    :param feed_as_read: (M,) feeds as its text states them [m/s], if those of `motions` were lowered since; else None.
    """

    name: str
    dialect: str
    documents: tuple[Document, ...]
    motions: Motions
    bases: Array
    tools: Array
    tool_keys: tuple[tuple[str, ...], ...] = ()
    notes: tuple[ForceNote, ...] = ()
    events: tuple[Event, ...] = ()
    still: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    issues: tuple[Issue, ...] = ()
    after: Ints | None = None
    joins: tuple[tuple[int, ...], ...] = ()
    branches: tuple[tuple[int, int], ...] = ()
    transitions: tuple[tuple[int, int], ...] = ()
    swivel: Swivel | None = None
    is_wrist_led: Bools | None = None
    wrist: Turning | None = None
    carriage: Carriage | None = None
    turns_with_path: Bools | None = None
    turn_speeds: Runs | None = None
    unforced: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    unresolved: tuple[UnresolvedMotion, ...] = ()
    unfollowed: tuple[UnfollowedCall, ...] = ()
    needed: tuple[NeededFile, ...] = ()
    layout: Layout | None = None
    feed_as_read: Array | None = None

    def __repr__(self) -> str:
        """Return name, format and number of motions: arrays are too long to show."""
        return f"<Program {self.name} ({self.dialect}): {len(self.motions)} motions>"

    @property
    def predecessors(self) -> Ints:
        """(M,) row of the motion at whose end each motion begins.

        −1: the start of the program; its own row: its start is unknown.
        """
        return np.arange(len(self.motions)) - 1 if self.after is None else self.after

    @property
    def turning(self) -> Turning | None:
        """How motions turn the tool that do not turn it by one rotation; None: all do."""
        return self.wrist if self.swivel is None else self.swivel

    @property
    def waiting_motions(self) -> Ints:
        """Motions (n,) at whose end the program waits, −1 for the start of the program.

        Known are G4, M0, M1, DELAY, cycles with a dwell, WAIT and HALT of KRL, Wait and Stop instructions of RAPID, and
        those of both in lines of the cell, such as spindle_on.
        Busy waiting, as by ``WHILE NOT $IN[3]``, is not found; a wait that is never reached may be among them.
        """
        return np.array(
            [
                event.before - 1  # an event is before a motion: the wait is at the end of the one before that
                for event in self.events
                if event.waits or event.kind == "stop" or (event.kind == "dwell" and event.value != 0.0)
            ],
            dtype=np.int64,
        )

    @property
    def keeps_text(self) -> bool:
        """True if it is a robot program, written again with only the numbers of targets changed."""
        return self.layout is not None

    def tool_text(self, key: str) -> str:
        """Return a number or name of a tool as the program writes it, see `tool_text`."""
        return tool_text(key, is_of_robot=bool(self.tool_keys))

    def places(self, rows: Ints) -> Places:
        """Return files and lines of motions (n,)."""
        layout_places = None if self.layout is None else self.layout.places(rows)
        if layout_places is None:
            layout_places = Places(
                (self.documents[0].name,), np.zeros(len(rows), dtype=np.int64), self.motions.line[rows]
            )
        return layout_places

    def numbers_as_written(self) -> Array:
        """Return X, Y, Z [mm], A, B, C [deg] (M, 6) of its motions as its text commands them.

        :raises ValueError: it has none in its text: it was read from G-code.
        """
        if self.layout is None:
            raise ValueError("a program read from G-code does not command poses")
        return self.layout.numbers


class Targets(Struct, frozen=True, eq=False):
    """K Cartesian targets to be written, in order: at least the end of each motion, and inserted ones before it.

    Motions with axis targets (`Motions.joints`) have no row: they are written unchanged.

    :param motion: (K,) row of `Motions` that the target belongs to, never decreasing.
    :param t: (K,) place of the target on that motion, in (0, 1]; the last one of each motion has 1.
    :param kind: (K,) `LIN`, `CIRC`, `PTP` or `SPL`; a CIRC motion may be written as several CIRC or LIN targets.
    :param pose: K poses of the tool frame in `$BASE` to be commanded [m]; an array (K, 4, 4) becomes `Poses`.
    :param via: (K, 3) auxiliary point of a CIRC target, `$BASE` [m]; NaN elsewhere.
    :param keep: (K,) True where the text of the motion already commands this pose: it is left to the byte.
    :param status: (K,) KUKA S for PTP targets; −1 = unchanged (or none).
    :param turn: (K,) KUKA T for PTP targets; −1 = unchanged (or none).
    :param blend: (K,) approximation distance [m]; 0 = exact stop. In KRL the distance is that of the program, and only
        inserted targets of motions that stop look here whether they stop too.
    """

    motion: Ints
    t: Array
    kind: Ints
    pose: Poses
    via: Array
    keep: Bools
    status: Ints
    turn: Ints
    blend: Array

    def __post_init__(self) -> None:
        force_setattr(self, "pose", as_poses(self.pose))
        _make_compact(self, motion=np.int32, kind=np.int8, status=np.int16, turn=np.int16)

    def __len__(self) -> int:
        return len(self.motion)

    def begin(self, row: NDArray[np.integer[Any]]) -> Array:
        """Return where on its motion the piece to each of some targets (n,) begins: t, in [0, 1).

        A piece leads to a target from the one before it on the same motion, or from the start of the motion.
        """
        previous = np.maximum(row - 1, 0)
        is_first_of_motion = (row == 0) | (self.motion[row] != self.motion[previous])
        return np.where(is_first_of_motion, 0.0, self.t[previous])


class TargetJoints(Struct, frozen=True, eq=False):
    """Joint angles at K targets by the controller's nominal geometry: they select the branch of the inverse kinematics.

    :param q: (K, 6) KUKA signs, turns counted [rad].
    :param status: (K,) KUKA S.
    """

    q: Array
    status: Ints


class TargetForces(Struct, frozen=True, eq=False):
    """The wrench at each of K targets, in the form that a written program needs.

    :param wrench: (K, 6) Fx…Mz [N, N·m] in the axes that `frame` names; an array becomes `Runs`.
    :param frame: (K,) place in `FORCE_FRAMES`.
    """

    wrench: Runs
    frame: Ints

    def __post_init__(self) -> None:
        force_setattr(self, "wrench", Runs.of(self.wrench))
        _make_compact(self, frame=np.int8)


class Modules(Struct, frozen=True, eq=False):
    """A program of K targets as n self-contained programs, which are loaded and run one after another.

    :param documents: (n) files, in order.
    :param first: (n,) row of the first target of each.
    :param output_line: (K,) 1-based line of each target; lines count on from file to file.
    """

    documents: tuple[Document, ...]
    first: tuple[int, ...]
    output_line: Ints


class WrittenProgram(Struct, frozen=True, eq=False):
    """A program as text, before it is released.

    :param documents: files to write, the main one (`NAME.src`) first.
    :param output_line: (K,) 1-based line of each row of `Targets` in the main document (the motion statement; for a
        named point the statement that uses it).
    :param dialect: name of their dialect.
    :param issues: issues of the writer.
    :param modules: the same program as modules, which are released in place of `documents`; None if it is in one piece.
    """

    documents: tuple[Document, ...]
    output_line: Ints
    dialect: str
    issues: tuple[Issue, ...] = ()
    modules: Modules | None = None

    def __post_init__(self) -> None:
        _make_compact(self, output_line=np.int32)

    @property
    def size(self) -> int:
        """Size of all files [bytes]; characters take one byte in the code pages of controllers."""
        return sum(len(document.text) for document in self.documents)


Record = TypeVar("Record")


def tool_text(key: str, *, is_of_robot: bool) -> str:
    """Return a number or name of a tool as a program writes it: T3; TOOL_DATA[3] of KRL and tMill of RAPID programs.

    :param is_of_robot: the program is one of a robot controller, in which tools are named by what states their frame.
    """
    if not key.isdecimal():
        return key
    return f"TOOL_DATA[{key}]" if is_of_robot else f"T{key}"


def constant(value: float, rows: int) -> NDArray[Any]:
    """Return an array (rows,) of one value, read-only, which takes no memory; a whole number gives integers."""
    return np.broadcast_to(np.array(value), (rows,))


def distinct(values: Ints) -> Ints:
    """Return the sorted unique integers: `np.unique`, without the masked arrays that it imports.

    >>> distinct(np.array([7, 3, 7])).tolist()
    [3, 7]
    """
    in_order = np.sort(values, axis=None)
    return np.asarray(in_order[np.diff(in_order, prepend=in_order[:1] - 1) != 0])


def read_only(record: Record) -> Record:
    """Make all arrays of a record, and of the records in it, read-only; return the record.

    :param record: a Struct; other fields are left unchanged.
    """
    for name in type(record).__match_args__:  # type: ignore[attr-defined]
        value = getattr(record, name)
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
        elif hasattr(type(value), "__match_args__"):
            read_only(value)
    return record
