"""The cell: which robot, where `$BASE` and `$TOOL` are, where the program starts, how strict to be.

docs/reference/cell.md describes `cell.toml`; `Cell` is its content in SI units, checked.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np

from postproc import files
from postproc.errors import CellError, argument
from postproc.frames import M_PER_MM, RAD_PER_DEG, Array, pose_from_xyzabc

Positive = Annotated[float, msgspec.Meta(gt=0, le=1e6)]
NotNegative = Annotated[float, msgspec.Meta(ge=0, le=1e6)]
Length = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
Angle = Annotated[float, msgspec.Meta(ge=-3600, le=3600)]
PayloadMass = Annotated[float, msgspec.Meta(ge=0, le=3000)]
"""The largest robots carry 2.3 t at the flange: more is a mass in grams."""
ToolAxis = Literal["+Z", "-Z", "+X", "-X"]


_AXES, _JOINTS = 3, 6
"""Numbers of a home position: X, Y, Z of a machine, or the angles of the six joints."""


class Frame(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A KUKA frame as written in a file: mm and degrees."""

    X: Length = 0.0
    Y: Length = 0.0
    Z: Length = 0.0
    A: Angle = 0.0
    B: Angle = 0.0
    C: Angle = 0.0

    def pose(self) -> Array:
        """Return the frame as a (4, 4) pose [m]."""
        return pose_from_xyzabc([self.X, self.Y, self.Z, self.A, self.B, self.C])

    @property
    def is_turned(self) -> bool:
        """Whether its axes are not those of the frame that it is in."""
        return bool(self.A or self.B or self.C)


class Tool(Frame, frozen=True):
    """`$TOOL` in the flange frame, and which of its axes points from the spindle to the tip."""

    axis: ToolAxis = "+Z"


class Part(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Tolerance of the part (95 %), and the frame of its mesh in the robot root: mm and degrees."""

    tolerance_mm: Positive | None = None
    X: Length | None = None
    Y: Length | None = None
    Z: Length | None = None
    A: Angle | None = None
    B: Angle | None = None
    C: Angle | None = None


class Start(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Where the program starts: A1…A6 [deg]."""

    joints: tuple[Angle, Angle, Angle, Angle, Angle, Angle]


class Payload(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Carried in addition to the state the model was calibrated in: kg, and mm in the flange frame."""

    mass_kg: PayloadMass = 0.0
    X: Length = 0.0
    Y: Length = 0.0
    Z: Length = 0.0


class ToolCompliance(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Compliance of holder, spindle and tool at the tip, in the axes of the tool frame."""

    X_um_per_N: NotNegative = 0.0
    Y_um_per_N: NotNegative = 0.0
    Z_um_per_N: NotNegative = 0.0
    RX_urad_per_Nm: NotNegative = 0.0
    RY_urad_per_Nm: NotNegative = 0.0
    RZ_urad_per_Nm: NotNegative = 0.0

    def diagonal(self) -> Array:
        """Return the compliances (6,) [m/N, rad/(N·m)]."""
        translations = (self.X_um_per_N, self.Y_um_per_N, self.Z_um_per_N)
        return np.array([*translations, self.RX_urad_per_Nm, self.RY_urad_per_Nm, self.RZ_urad_per_Nm]) * 1e-6


class Output(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """How strict to be and how to write; mm. Programs of more lines than `lines_per_file` are divided; 0: never.

    :param program_memory_MB: memory of the controller for programs [MB]; a larger program gets a warning.
    :param divide_into_modules: such a program becomes several, which are loaded and run one after another.
    :param feed: "hold": the feed of cutting moves is lowered where the tolerance of the part would be exceeded, but not
        below `min_feed_mm_per_min`; needs a process. "program": feeds are those of the program.
    :param unheld: feed of a move that holds the tolerance at no feed: that of the program, or the lowest one.
    """

    tolerance_mm: Annotated[float, msgspec.Meta(ge=1e-4, le=1e6)] = 0.01  # positions are printed to 1e-4 mm
    max_correction_mm: Positive = 8.0
    force_ramp_mm: Positive = 1.0
    controller: Annotated[
        Literal["KRC4", "KRC2"],
        msgspec.Meta(description="A KR C5 with KSS 8.7 reads KRL for a KRC4; iiQKA.OS was not tried."),
    ] = "KRC4"
    lines_per_file: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)] = 0
    program_memory_MB: Positive = 4.0  # noqa: N815 - key of the file
    divide_into_modules: bool = False
    feed: Literal["program", "hold"] = "program"
    min_feed_mm_per_min: Positive = 300.0
    unheld: Literal["program", "lowest"] = "program"


DwellUnit = Literal["s", "ms"]


class GCode(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Conversion of G-code to KRL. Each list holds KRL lines; {S} is the spindle speed in rpm, {T} the tool number.

    :param tool_change: None: the cell does not say how a tool is changed, so a second tool is refused; []: it is
        changed by hand, without lines in the program.
    :param redundancy: turn of the tool about its axis: `redundancy_deg` everywhere, the best one for each operation, or
        one that changes along the path.
    :param motions: path motions of new KRL: LIN and CIRC, or the spline motions SLIN and SCIRC of a KRC4.
    :param radius_offsets: what the control's radius offsets (D) contain: the radius of the tool, or its wear only, so
        that the program has the path of the tool's centre.
    :param dwell_unit: unit of P of G4 and of cycles; None: short times are seconds, long ones are asked for.
    """

    redundancy_deg: Angle = 0.0
    redundancy: Literal["constant", "best", "path"] = "constant"
    rapid_m_per_s: Annotated[float, msgspec.Meta(gt=0, le=10)] = 0.5
    approximation_mm: NotNegative = 0.5
    corner_tolerance_mm: NotNegative = 0.05
    motions: Literal["LIN", "SLIN"] = "LIN"
    radius_offsets: Literal["radius", "wear"] = "radius"
    dwell_unit: DwellUnit | None = None
    spindle_on: list[str] | None = None
    spindle_ccw: list[str] | None = None
    spindle_off: list[str] | None = None
    coolant_on: list[str] | None = None
    coolant_off: list[str] | None = None
    tool_change: list[str] | None = None


class Machine(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Meaning of G28, G30 and G53 on this robot.

    :param home: A1…A6 [deg] where G28 and G30 go; or X, Y, Z of `$BASE` [mm] where the machine is before the first move
        and after G28, G30 and G53; None: the tool stays above its place.
    :param clearance_Z: Z of `$BASE` [mm] to which G53 Z… retracts, and G28 Z… where there is no `home`.
    """

    home: Annotated[list[Length], msgspec.Meta(min_length=3, max_length=6)] | None = None
    clearance_Z: Length | None = None  # noqa: N815 - key of the file

    @property
    def home_joints(self) -> list[float] | None:
        """A1…A6 [deg] of home, if it is given so."""
        return self.home if self.home is not None and len(self.home) == _JOINTS else None

    @property
    def home_place(self) -> list[float] | None:
        """X, Y, Z of home in `$BASE` [mm], if it is given so."""
        return self.home if self.home is not None and len(self.home) == _AXES else None


class IndexedAxis(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Axis of a rotary table of the machine, in `$BASE`, with all rotary axes at zero.

    :param point: a point on the axis [mm].
    :param direction: of the axis: positive angles turn the tool about it relative to the part, by the right-hand rule.
    """

    point: tuple[Length, Length, Length]
    direction: tuple[float, float, float]


class Rotary(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Rotary axes of a program.

    :param axes: their letters from the part outwards: A, B, C turn about X, Y, Z; none for ``"vector"``.
    :param signs: 1 or −1 for each.
    :param tcp_on: codes between which (and `tcp_off`) alone X, Y, Z are those of the tip; none: those of the program.
    :param kind: ``"tcp"``: X, Y, Z are the tool tip in the part; ``"indexed"``: the part turns, X, Y, Z are machine
        axes; ``"vector"``: X, Y, Z are the tip, and I, J, K of G0 and G1 the direction from it to the spindle; None:
        not stated, and a program that turns them is refused.
    :param A: place of the axis on the machine, for ``"indexed"``; `B`, `C`: likewise.
    """

    axes: list[Literal["A", "B", "C"]] = []
    signs: list[Literal[1, -1]] = []
    tcp_on: list[str] = []
    tcp_off: list[str] = []
    kind: Literal["tcp", "indexed", "vector"] | None = None
    A: IndexedAxis | None = None
    B: IndexedAxis | None = None
    C: IndexedAxis | None = None

    @property
    def places(self) -> list[IndexedAxis | None]:
        """Places of the axes on the machine, in the order of `axes`; None for an axis whose place is not stated."""
        by_letter = {"A": self.A, "B": self.B, "C": self.C}
        return [by_letter[letter] for letter in self.axes]


class Apt(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """How cutter-location files are read.

    :param without_effect: major words, in upper case, that move nothing in this shop: their statements are passed over.
    """

    without_effect: list[str] = []


class Krl(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """How KRL is read.

    :param search: folders, relative to the cell, where called programs are looked for after the program's own folder.
    :param initmov: what BAS(#INITMOV,0) gives a program that sets no frames: those of the ``"cell"``, or KUKA's
        (``"bas"``): BASE(0) and TOOL_DATA[1]. None: the cell's, with a warning.
    :param keep_unresolved: leave motions as they are whose targets, or whether they run, only the running robot knows.
    :param values: values that are not known before the program runs, by name: inputs, parameters of the main program,
        variables.
    """

    search: list[str] = []
    initmov: Literal["cell", "bas"] | None = None
    keep_unresolved: bool = False
    values: dict[str, bool | int | float] = {}


class Rapid(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """How RAPID modules are read.

    :param modules: files, relative to the cell, that the controller loads beside the program: tools, work objects and
        other data are read there.
    :param without_effect: routines of other files that neither move the robot nor change data of the module.
    :param procedures: procedures that are each a run of their own: of modules that have some of them, these are the
        program, in this order.
    """

    modules: list[str] = []
    without_effect: list[str] = []
    procedures: list[str] = []


class ExternalAxis(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A linear axis that carries the robot.

    :param direction: in the robot root, where the robot goes for positive values.
    """

    direction: tuple[Length, Length, Length]


class Box(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A box along the axes of its frame: smallest and largest X, Y, Z [mm]."""

    X: tuple[Length, Length]
    Y: tuple[Length, Length]
    Z: tuple[Length, Length]


class HolderTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A cylinder on the one before it, the first, the cutter, from the tip upwards; or a mesh in the flange frame."""

    name: str | None = None
    diameter_mm: Positive | None = None
    length_mm: Positive | None = None
    mesh: str | None = None


class ObstacleTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A mesh [mm] or a box, in the cell's `$BASE` or in the robot root.

    :param part: it is the part or the remaining stock, which the cutter may touch.
    """

    name: str | None = None
    mesh: str | None = None
    box: Box | None = None
    frame: Literal["base", "root"] = "base"
    part: bool = False


class Collision(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """What the arm must not touch.

    :param clearance_mm: smallest allowed distance; 0: no contact.
    :param arm: collision shapes of robot.urdf, or capsules along the links.
    """

    clearance_mm: NotNegative = 5.0
    holder: list[HolderTable] = []
    obstacles: list[ObstacleTable] = []
    arm: Literal["urdf", "capsules"] = "urdf"


class Limits(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """What happens where the robot cannot follow the program.

    :param feed: a move at feed in which a joint would turn too fast is an error, or is slowed with a warning.
    """

    feed: Literal["refuse", "cap"] = "refuse"


class Report(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Lines of the page: a title such as the order, and the customer. Empty: none."""

    title: str = ""
    customer: str = ""


class CellFile(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Content of a `cell.toml`, in the units of the file."""

    robot: str
    base: Frame
    tool: Tool
    start: Start | None = None
    payload: Payload = Payload()
    tool_compliance: ToolCompliance = ToolCompliance()
    output: Output = Output()
    gcode: GCode = GCode()
    krl: Krl = Krl()
    rapid: Rapid = Rapid()
    machine: Machine = Machine()
    rotary: Rotary | None = None
    apt: Apt = Apt()
    limits: Limits = Limits()
    m_codes: dict[str, list[str]] = {}
    tools: dict[str, Frame] = {}
    work_offsets: dict[str, Frame] = {}
    base_data: dict[str, Frame] = {}
    tool_data: dict[str, Tool] = {}
    config_dat: str | None = None
    frames: Literal["controller", "model"] | None = None
    part: Part = Part()
    external_axes: dict[str, ExternalAxis] = {}
    collision: Collision | None = None
    report: Report = Report()


class Cell(CellFile, frozen=True):
    """A checked cell; `folder` is the folder of its file, from which paths in it are relative."""

    folder: str = "."

    @property
    def start_angles(self) -> tuple[float, float, float, float, float, float]:
        """A1…A6 at the start of the program [deg].

        :raises CellError: the cell has no [start].
        """
        if self.start is None:
            raise CellError(
                "the cell has no [start]", advice="Give A1 to A6: [start] joints = [0, -90, 100, 0, 80, 0]."
            )
        return self.start.joints

    @property
    def start_joints(self) -> Array:
        """A1…A6 at the start of the program, (6,) [rad].

        :raises CellError: the cell has no [start].
        """
        return np.array(self.start_angles) * RAD_PER_DEG

    @property
    def carriage(self) -> Array | None:
        """Direction of E1 in the robot root, a unit vector (3,), if it carries the robot."""
        axis = self.external_axes.get("E1")
        return None if axis is None else np.array(axis.direction) / np.linalg.norm(axis.direction)

    @property
    def tolerance(self) -> float:
        """Largest allowed distance of the predicted path from the nominal one [m]."""
        return self.output.tolerance_mm * M_PER_MM

    def part_in_root(self) -> Array | None:
        """Return the frame (4, 4) of the part's mesh in the robot root [m]; None: the mesh is in `$BASE`."""
        frame = {axis: value for axis in "XYZABC" if (value := getattr(self.part, axis)) is not None}
        return Frame(**frame).pose() if frame else None

    @property
    def part_tolerance(self) -> float | None:
        """Tolerance of the part [m], 95 %; None: not stated."""
        return None if self.part.tolerance_mm is None else self.part.tolerance_mm * M_PER_MM

    def tool_orientation(self) -> Array:
        """Return the orientation (3, 3) of the tool frame in the program frame of 3-axis G-code.

        The tool axis points along −Z of the program frame; `redundancy_deg` turns the tool about program Z.
        """
        # A, B, C [deg] that turn the axis from spindle to tip to −Z
        abc = {"+Z": (0, 0, 180), "-Z": (0, 0, 0), "+X": (0, 90, 0), "-X": (0, -90, 0)}[self.tool.axis]
        turn = pose_from_xyzabc([0, 0, 0, self.gcode.redundancy_deg, 0, 0])
        orientation: Array = (turn @ pose_from_xyzabc([0, 0, 0, *abc]))[:3, :3]
        return orientation


def _looks_like_radians(joints: tuple[float, ...]) -> bool:
    """Return whether all angles are below 2π and one has a fraction: in degrees the arm would be stretched out."""
    return max(map(abs, joints)) < 2.0 * math.pi and any(angle % 1.0 for angle in joints)


_IN_GCODE = "Give its lines in [gcode]: "
FIXED_M_CODES: Mapping[int, str] = {
    **dict.fromkeys((0, 1), "The program stops there: leave it out."),
    **dict.fromkeys((2, 30), "The program ends there: leave it out."),
    3: f"{_IN_GCODE}spindle_on.",
    4: f"{_IN_GCODE}spindle_ccw.",
    5: f"{_IN_GCODE}spindle_off.",
    6: f"{_IN_GCODE}tool_change, [] for none.",
    **dict.fromkeys((7, 8), f"{_IN_GCODE}coolant_on."),
    9: f"{_IN_GCODE}coolant_off.",
    **dict.fromkeys((61, 70, 71, 72, 73, 97), "It changes how later lines are read: leave it out."),
    **dict.fromkeys((98, 99), "Subprograms are followed: leave it out."),
}
"""M codes that `[m_codes]` cannot give another meaning, with what to do instead."""


class KeyFault(NamedTuple):
    """Problem of a key, and advice."""

    problem: str
    advice: str


def m_code_fault(key: str) -> KeyFault | None:
    """Return the fault of a key that `[m_codes]` does not take; None: it takes the key."""
    if not (key[:1] == "M" and key[1:].isascii() and key[1:].isdecimal() and len(key) <= 5):
        return KeyFault(key, "Valid names: M10, M111 …")
    number = int(key[1:])
    if number in FIXED_M_CODES:
        return KeyFault(f"{key} has a meaning already", FIXED_M_CODES[number])
    return None if key == f"M{number}" else KeyFault(key, f"Write M{number}.")


_STRING = re.compile('"[^"]*"')
_CLOSING = {"(": ")", "[": "]", "{": "}"}


def lines_fault(lines: Sequence[str]) -> str | None:
    """Return the bracket or string that lines of KRL or RAPID leave open, in words; None: all are closed.

    Comments do not count. A bracket may be closed in a later line.
    """
    open_brackets = ""  # from the outermost to the innermost
    for line in lines:
        is_rapid_comment = line.lstrip().startswith("!")
        if is_rapid_comment:
            continue
        # in RAPID ; ends a statement, in KRL it begins a comment: brackets are closed before it in both
        code = _STRING.sub("", line).partition(";")[0]
        if '"' in code:
            return f'{line!r}: the string after " has no end'
        for sign in code:
            if sign in _CLOSING:
                open_brackets += sign
            elif sign in _CLOSING.values():
                if not open_brackets:
                    return f"{line!r}: {sign} closes no bracket"
                if _CLOSING[open_brackets[-1]] != sign:
                    return f"{line!r}: {open_brackets[-1]} is not closed"
                open_brackets = open_brackets[:-1]
    return f"{lines[-1]!r}: {open_brackets[-1]} is not closed" if open_brackets else None


_PATH_MOTION = re.compile(
    r"\s*(?:(?:S?LIN|S?CIRC|SPL)(?:_REL)?[\s{]|S?PTP(?:_REL)?\s*\{(?!.*\bA[1-6]\b))", re.IGNORECASE | re.ASCII
)
"""KRL to a Cartesian target. Motions to joint angles or to a name, such as HOME, are no targets of a program."""


def motion_fault(lines: Sequence[str]) -> str | None:
    """Return the error of the first KRL line that moves the tool to a target; None: no line does.

    Such a target is not in the program that postproc reads, so it would not be corrected.
    """
    motion = next((line for line in lines if _PATH_MOTION.match(line)), None)
    return None if motion is None else f"{motion!r} moves the tool to a target"


_VARIABLE = re.compile(r"[A-Za-z_$][\w$]*(\[[0-9]{1,6}(,[0-9]{1,6}){0,2}\])?", re.ASCII)
_LARGEST_VALUE = 2**31 - 1
"""Largest value of an INT of KRL, which has 32 bits."""
_EXAMPLE = """The least that a cell needs, for example:

robot = "kuka_kr270"                    # a robot that `postproc robots` lists, or the path of a model folder

[base]                                  # $BASE in the robot root: mm, degrees
X = 1500
Y = -200
Z = 700

[tool]                                  # $TOOL in the flange frame
Z = 350

[start]
joints = [0, -90, 100, 0, 80, 0]        # A1…A6 where the program starts
"""


def load(path: str | Path) -> Cell:
    """Read and check a cell file.

    :returns: the content of the file (`CellFile`) with its folder, from which paths in it are relative.
    :raises CellError: it cannot be read, has unknown keys, wrong types or values out of range; the message
        names the key and its valid values.
    """
    path = Path(path)
    file = str(path)
    missing_advice = f"Write one with: postproc init {argument(path)}"
    cell = files.read_toml(path, CellFile, CellError, example=_EXAMPLE, missing_advice=missing_advice)
    if cell.start is not None and _looks_like_radians(cell.start.joints):
        advice = "Angles are in degrees: write 110 for 1.92 rad. If degrees are meant, round them."
        raise CellError(f"[start] joints = {list(cell.start.joints)} look like radians", file=file, advice=advice)
    _check_numbered_tables(cell, file)
    _check_line_templates(cell, file)
    _check_krl_values(cell.krl.values, file)
    _check_external_axes(cell.external_axes, file)
    if cell.gcode.motions == "SLIN" and cell.output.controller == "KRC2":
        advice = 'Write motions = "LIN", or name a KRC4.'
        raise CellError('[gcode] motions = "SLIN": a KRC2 has no spline motions', file=file, advice=advice)
    if cell.machine.home is not None and len(cell.machine.home) not in (_AXES, _JOINTS):
        advice = "Give A1 to A6 in degrees, or X, Y and Z of $BASE in mm."
        raise CellError(f"[machine] home has {len(cell.machine.home)} numbers", file=file, advice=advice)
    if cell.rotary is not None:
        _check_rotary(cell.rotary, file)
        _check_indexed_axes(cell.rotary, cell.work_offsets, file)
    if cell.collision is not None:
        _check_collision(cell.collision, file)
    values = {name: getattr(cell, name) for name in cell.__struct_fields__} | _paths_with_slashes(cell)
    return Cell(**values, folder=str(path.parent))


def _check_numbered_tables(cell: CellFile, file: str) -> None:
    """Check the keys of numbered tables: frames, tools, work offsets and M codes.

    :raises CellError: a name is not valid.
    """
    for table, name in ((cell.base_data, "base_data"), (cell.tool_data, "tool_data"), (cell.tools, "tools")):
        for key in table:
            if not (key.isascii() and key.isdecimal() and len(key) <= 4):
                raise CellError(f"[{name}.{key}]: {key!r} is not a number", file=file)
    for key in cell.work_offsets:
        if key not in {"G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3"}:
            raise CellError(f"[work_offsets.{key}]", file=file, advice="Valid names: G54 … G59, G59.1 … G59.3.")
    for key in cell.m_codes:
        if fault := m_code_fault(key):
            raise CellError(f"[m_codes] {fault.problem}", file=file, advice=fault.advice)


def _check_line_templates(cell: CellFile, file: str) -> None:
    """Check the lines of [gcode] and [m_codes], which are written into programs as they are.

    Their brackets and strings must be closed, and they must not move the tool: no target of the program is there.

    :raises CellError: a line leaves something open, or is a motion to a pose.
    """
    for section, values in (("gcode", msgspec.structs.asdict(cell.gcode)), ("m_codes", cell.m_codes)):
        for key, lines in values.items():
            if isinstance(lines, list) and (open_end := lines_fault(lines)):
                raise CellError(f"[{section}] {key}, {open_end}", file=file, advice="Correct the line.")
            if isinstance(lines, list) and (motion := motion_fault(lines)):
                advice = "Move by joint angles, PTP {A1 0, A2 -90, …}, or put the motion into a subprogram and call it."
                raise CellError(f"[{section}] {key}, {motion}", file=file, advice=advice)


def _check_krl_values(values: Mapping[str, float], file: str) -> None:
    """Check the values of variables that [krl.values] states.

    :raises CellError: a name is no variable or element of KRL, or a value is too large.
    """
    for key, value in values.items():
        if not _VARIABLE.fullmatch(key) or abs(value) > _LARGEST_VALUE:
            advice = 'Give numbers or true and false for names and elements: lnActSt = 1, "$IN[5]" = false.'
            raise CellError(f"[krl.values] {key} = {value}", file=file, advice=advice)


def _check_external_axes(axes: Mapping[str, ExternalAxis], file: str) -> None:
    """Check that E1 alone carries the robot, and that its direction is not zero.

    :raises CellError: it is another axis, or the direction is zero.
    """
    for key, axis in axes.items():
        if key != "E1":
            raise CellError(f"[external_axes.{key}]", file=file, advice="Only E1 may carry the robot.")
        if not any(axis.direction):
            advice = "Give where the robot goes for positive values in the robot root, e.g. [0, 1, 0]."
            raise CellError(f"[external_axes.{key}] direction is zero", file=file, advice=advice)


def _check_rotary(rotary: Rotary, file: str) -> None:
    """Check that [rotary] names its axes, signs and codes completely.

    :raises CellError: a key is missing or contradicts another one.
    """
    if rotary.kind == "vector":
        if rotary.axes:
            advice = "I, J, K of the program are the direction of the tool: leave axes out."
            raise CellError('[rotary] axes with kind = "vector"', file=file, advice=advice)
    elif len(rotary.axes) not in (1, 2) or len(set(rotary.axes)) != len(rotary.axes):  # none, too many, or one twice
        raise CellError("[rotary] axes", file=file, advice='One or two letters, from the part outwards: ["C", "B"].')
    if len(rotary.signs) not in (0, len(rotary.axes)):
        raise CellError("[rotary] signs", file=file, advice="Give 1 or -1 for each of the axes.")
    if bool(rotary.tcp_on) != bool(rotary.tcp_off):
        raise CellError("[rotary] tcp_on without tcp_off, or the reverse", file=file, advice="Give both, or none.")


TURNED_OFFSET = "is turned, and the rotary axes are indexed"
TURNED_OFFSET_ADVICE = "X, Y, Z are machine axes there: turn [base] instead, so that its axes are those of the machine."


def _check_indexed_axes(rotary: Rotary, work_offsets: Mapping[str, Frame], file: str) -> None:
    """Check that indexed axes have a place, and that nothing contradicts them.

    :param file: of the cell, for messages.
    :raises CellError: an axis has no place or direction, TCP codes are given, or the work offset G54 is turned.
    """
    if rotary.kind != "indexed":
        return
    if rotary.tcp_on:
        advice = 'Write kind = "tcp", or remove tcp_on and tcp_off.'
        raise CellError("[rotary] tcp_on with indexed axes", file=file, advice=advice)
    for letter, place in zip(rotary.axes, rotary.places, strict=True):
        if place is None or not any(place.direction):
            problem = f"[rotary] {letter}: {'no place' if place is None else 'direction is zero'}"
            axis = [int(letter == name) for name in "ABC"]
            example = f"{letter} = {{ point = [0, 0, -120], direction = {axis} }}"
            advice = f"Give a point of the axis and its direction in $BASE: {example}."
            raise CellError(problem, file=file, advice=advice)
    if work_offsets.get("G54", Frame()).is_turned:  # the others are judged where a program uses them
        raise CellError(f"[work_offsets.G54] {TURNED_OFFSET}", file=file, advice=TURNED_OFFSET_ADVICE)


def _check_collision(collision: Collision, file: str) -> None:
    """Check that each holder part and obstacle of [collision] has exactly one kind of shape.

    :raises CellError: a shape is missing, stated twice or empty.
    """
    _check_holder(collision.holder, file)
    _check_obstacles(collision.obstacles, file)


def _check_holder(holder: Sequence[HolderTable], file: str) -> None:
    """Check that each part of the holder is a cylinder with both lengths, or a mesh.

    :raises CellError: a part is neither or both.
    """
    for number, part in enumerate(holder, start=1):
        sizes = {"diameter_mm": part.diameter_mm, "length_mm": part.length_mm}
        stated_keys = [key for key, value in sizes.items() if value is not None]
        if part.mesh is None and len(stated_keys) < len(sizes):
            problem = f"no {' and no '.join(key for key in sizes if key not in stated_keys)}"
        elif part.mesh is not None and stated_keys:
            problem = f"mesh together with {' and '.join(stated_keys)}"
        else:
            continue
        advice = 'Give { diameter_mm = 63, length_mm = 80 }, from the tip upwards, or { mesh = "spindle.stl" }.'
        raise CellError(f"[collision] holder, part {number}: {problem}", file=file, advice=advice)


def _check_obstacles(obstacles: Sequence[ObstacleTable], file: str) -> None:
    """Check that each obstacle is a mesh or a box with an inside.

    :raises CellError: an obstacle is neither or both, or its box is empty.
    """
    for number, obstacle in enumerate(obstacles, start=1):
        if (obstacle.mesh is None) == (obstacle.box is None):
            problem = "neither mesh nor box" if obstacle.mesh is None else "mesh together with box"
            advice = 'Give { mesh = "fixture.stl" } or { box = { X = [0, 200], Y = [0, 300], Z = [-60, -20] } }.'
            raise CellError(f"[collision] obstacles, number {number}: {problem}", file=file, advice=advice)
        for axis in "XYZ" if obstacle.box is not None else "":  # no axis of a mesh
            low, high = getattr(obstacle.box, axis)
            if low >= high:
                problem = f"box {axis} = [{low:g}, {high:g}] has no inside"
                advice = "Give the smaller number first."
                raise CellError(f"[collision] obstacles, number {number}: {problem}", file=file, advice=advice)


def _paths_with_slashes(cell: CellFile) -> dict[str, object]:
    """Return the values of the keys that name files and folders, with / for the backslash of Windows."""
    return {
        "config_dat": None if cell.config_dat is None else _with_slashes(cell.config_dat),
        "krl": msgspec.structs.replace(cell.krl, search=[_with_slashes(folder) for folder in cell.krl.search]),
        "rapid": msgspec.structs.replace(cell.rapid, modules=[_with_slashes(file) for file in cell.rapid.modules]),
    }


def _with_slashes(path: str) -> str:
    """Return a path with /, which Windows takes too: a cell may be written there and used elsewhere."""
    return path.replace("\\", "/")
