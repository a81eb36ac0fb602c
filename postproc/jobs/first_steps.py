"""Files to begin with: the samples, a cell file, and the model folder of a robot.

`postproc samples` copies the samples of the package. `postproc init` writes a commented cell file, from a few facts or
from the controller's `$config.dat`. `postproc robots add` makes a model folder from a URDF.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from os.path import relpath
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Struct

from postproc import correction, files, kinematics
from postproc import robot as robots
from postproc.cell import Cell, Frame, Rotary, Start, Tool, ToolAxis, load
from postproc.correction.plausibility import near_base_question, short_tool_question
from postproc.decimals import without_negative_zero
from postproc.dialects.text import decode
from postproc.errors import CellError, InputError, ModelError, OptionError, ProgramError, first_of
from postproc.files import path_list, read_text, toml, write_whole
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, xyzabc_from_pose
from postproc.jobs.answers import BY_HAND, NO_LINES, Numbers
from postproc.jobs.output_plan import protect
from postproc.jobs.programs import load_robot
from postproc.jobs.start_joints import QUARTER_TURNS, USUAL_START, joints_above_part, low_start, upright_joints
from postproc.robot import JOINTS, RobotModel, shapes
from postproc.robot.from_urdf import AdoptedModel, adopt
from postproc.robot.shapes import LinkShape
from postproc.robot.urdf import Geometry, geometries


def copy_samples(folder: Path, *, overwrite: bool = False) -> list[Path]:
    """Write the samples into a folder.

    :param overwrite: replace existing files that differ.
    :returns: paths of the written files.
    :raises InputError: files exist that differ, and `overwrite` is False.
    """
    root = shipped_samples()
    contents = {path.relative_to(root): path.read_bytes() for path in _sample_files(root)}
    conflicts = [folder / name for name, content in contents.items() if _differs(folder / name, content)]
    if conflicts and not overwrite:
        raise InputError(
            f"these files are there, and differ: {path_list(conflicts)}",
            advice="Choose another folder, or give --overwrite.",
        )
    paths = []
    for subfolder in sorted({name.parent for name in contents}):
        folder_contents = {name.name: content for name, content in contents.items() if name.parent == subfolder}
        paths += write_whole(folder / subfolder, folder_contents)
    return paths


def shipped_samples() -> Path:
    """Return the folder of the samples: in the installed package, or next to it in a checkout."""
    package = Path(__file__).parent.parent
    package_samples = package / "samples"
    return package_samples if package_samples.is_dir() else package.parent / "samples"


SCHEMAS = ("cell", "process", "model", "experiment")
"""Files that have a JSON Schema."""


def schema_file(name: str) -> Path:
    """Return the path of the JSON Schema of a kind of file, one of `SCHEMAS`, by which editors check it."""
    return Path(__file__).parent.parent / "schemas" / f"{name}.schema.json"


def _sample_files(root: Path) -> Iterator[Path]:
    """Yield the files of a folder and its subfolders, sorted, without compiled Python."""
    for path in sorted(root.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            yield path


def _differs(path: Path, content: bytes) -> bool:
    """Return whether a path exists, and is not a file with this content."""
    return path.exists() and not (path.is_file() and path.read_bytes() == content)


CLEARANCE_MM = 200.0
"""Z of `$BASE` to which programs retract unless something else is given: usual CAM set-ups are below it [mm]."""
LARGEST_LENGTH_MM = 1e6
"""Lengths beyond a kilometre are a mistake in the unit."""
_ZERO = (0.0,) * 6


class CellRequest(Struct, frozen=True, kw_only=True):
    """Values for a new cell file.

    :param output: cell file to write.
    :param robot: name of a shipped robot, or path of a model folder (relative to the working folder).
    :param base: `$BASE` in the robot root: X, Y, Z[, A, B, C] in mm and degrees, or the number of a BASE_DATA.
    :param tool: `$TOOL` in the flange frame, likewise, or the number of a TOOL_DATA.
    :param axis: axis of the tool frame that points from the spindle to the tip.
    :param start: A1…A6 where programs start [deg]; None: above the origin of `$BASE`, 50 mm above `clearance`.
    :param config_dat: `$config.dat` of the controller, for frames by number.
    :param clearance: Z of `$BASE` to which G28, G30 and G53 retract [mm].
    :param tool_change: `BY_HAND`, `NO_LINES`, or the line that calls the tool changer, with {T}.
    :param spindle: lines for M3, with {S}, and for M5; empty: by hand; None: not stated.
    :param coolant: lines for M7 and M8, and for M9; likewise.
    :param tools: T number → `$TOOL` in the flange frame, as `tool`; none: `tool` holds for all.
    :param work_offsets: code of a work offset (``G55``) → its frame in `$BASE`, as `base`.
    :param base_data: number → frame that KRL programs name as BASE_DATA[n], in the robot root, as `base`.
    :param tool_data: number → frame that they name as TOOL_DATA[n], in the flange frame.
    :param m_codes: M codes that programs use (``M31``) → lines to write for them; none: no effect on the robot.
    :param home: X, Y, Z of `$BASE` where the machine is first, and after G28 and G53 [mm]; None: not stated.
    :param rotary: rotary axes of the programs; None: there are none.
    :param radius_offsets: content of the radius offsets (D) of the control: "radius" or "wear".
    :param dwell_unit: unit of P of G4 and of cycles on the control: "s" or "ms"; None: not stated.
    :param part_tolerance: allowed error of the part (95 %) [mm]; None: not stated, and the verdict does not use it.
    :param payload: mass [kg] and centre X, Y, Z in the flange frame [mm] of the load of the flange; None: not stated.
    :param overwrite: replace a file that is there.
    """

    output: Path
    robot: str
    base: Numbers | int
    tool: Numbers | int
    start: Numbers | None = None
    axis: ToolAxis = "+Z"
    config_dat: Path | None = None
    clearance: float = CLEARANCE_MM
    tool_change: str = BY_HAND
    spindle: tuple[Sequence[str], Sequence[str]] | None = None
    coolant: tuple[Sequence[str], Sequence[str]] | None = None
    tools: Mapping[int, Numbers] = {}
    work_offsets: Mapping[str, Numbers] = {}
    base_data: Mapping[int, Numbers] = {}
    tool_data: Mapping[int, Numbers] = {}
    m_codes: Mapping[str, Sequence[str]] = {}
    home: Numbers | None = None
    rotary: Rotary | None = None
    radius_offsets: str = "radius"
    dwell_unit: str | None = None
    part_tolerance: float | None = None
    payload: Numbers | None = None
    overwrite: bool = False


def check_new(output: Path, *, overwrite: bool) -> None:
    """Check that a cell file may be written.

    :param overwrite: an existing file may be replaced.
    :raises InputError: the file exists, and `overwrite` is False.
    """
    if output.exists() and not overwrite:
        raise InputError("this file is there", file=str(output), advice="Name another, or give --overwrite.")


def write_cell(request: CellRequest) -> tuple[str, ...]:
    """Write a cell file, whose text is checked before by reading it.

    :returns: warnings for the user.
    :raises InputError: the file exists, or a value is invalid.
    """
    check_new(request.output, overwrite=request.overwrite)
    folder = request.output.parent
    robot = load_robot(request.robot)
    cell = _cell_of(request, robot)
    config = None if request.config_dat is None else relative_path(folder, request.config_dat)
    turn, remarks = _turn_of_tool(cell, robot)
    tools = {
        number: Frame(*_six_values(f"$TOOL of T{number}", words, min_count=3))
        for number, words in request.tools.items()
    }
    remarks = (
        *_metre_questions(cell, tools),
        *_base_warnings(cell),
        *remarks,
        *low_start(cell, robot, request.clearance),
    )
    text = _cell_text(request, cell, robot, turn=turn, config=config, tools=tools)
    _check_text(text, request.output)
    files.write_whole(folder, {request.output.name: text.encode()})
    return remarks


def _cell_of(request: CellRequest, robot: RobotModel) -> Cell:
    """Return the cell of a request: robot, frames, and the joints where programs start.

    A start that the request does not state is above the part; if that is out of reach, it is `USUAL_START`.

    :raises InputError: a value is invalid.
    """
    is_shipped = request.robot in robots.shipped_models()
    robot_path = request.robot if is_shipped else relative_path(request.output.parent, Path(request.robot))
    start = USUAL_START if request.start is None else _six_values("start joints", request.start, min_count=6)
    _check_joint_limits(start, robot)
    if request.part_tolerance is not None and not 0.0 < request.part_tolerance <= LARGEST_LENGTH_MM:
        raise OptionError(f"part tolerance {request.part_tolerance:g} mm", advice="Give a length above 0.")
    if not abs(request.clearance) <= LARGEST_LENGTH_MM:
        raise OptionError(f"clearance {request.clearance:g} mm", advice="Give a Z of $BASE.")
    base = _six_frame_values("BASE_DATA", request.base, request, robot)
    tool = _six_frame_values("TOOL_DATA", request.tool, request, robot)
    tool_frame = Tool(**dict(zip("XYZABC", tool, strict=True)), axis=request.axis)
    cell = Cell(robot=robot_path, base=Frame(*base), tool=tool_frame, start=msgspec.convert({"joints": start}, Start))
    if request.start is not None:
        return cell
    start_joints = joints_above_part(cell, robot, request.clearance, QUARTER_TURNS)
    if start_joints is None:  # the origin of $BASE is out of reach, which a remark says
        return cell
    return msgspec.structs.replace(cell, start=msgspec.convert({"joints": start_joints}, Start))


def _check_joint_limits(start: Numbers, robot: RobotModel) -> None:
    """Check that start joints (6,) [deg] are within the limits of a robot.

    :raises OptionError: a joint is beyond its limits.
    """
    is_outside = (np.radians(start) < robot.lower) | (np.radians(start) > robot.upper)
    if is_outside.any():
        joint = int(np.argmax(is_outside))
        low, high = robot.lower[joint] * DEG_PER_RAD, robot.upper[joint] * DEG_PER_RAD
        raise OptionError(f"{JOINTS[joint]} = {start[joint]:g}° is beyond its limits, {low:.4g}° to {high:.4g}°")


def _check_text(text: str, output: Path) -> None:
    """Check the text of a cell by reading it from a temporary file.

    The file is in the folder of `output`, because paths in the cell are relative to the folder.

    :raises CellError: the cell is unusable; the message names `output`.
    """
    trial = output.with_name(f".{output.name}.new")
    files.write_whole(trial.parent, {trial.name: text.encode()})
    try:
        load(trial)
    except CellError as cause:
        raise cause.with_file(str(trial), str(output)) from None
    finally:
        trial.unlink(missing_ok=True)


def relative_path(folder: Path, path: Path) -> str:
    """Return a path relative to a folder, with ``/``; an absolute path on another drive of Windows."""
    try:
        return Path(relpath(path, folder)).as_posix()
    except ValueError:
        return path.absolute().as_posix()


def usual_base(robot: str) -> Numbers:
    """Return a place for a part that a robot reaches well: X, Y, Z in the root [mm].

    :param robot: name of a shipped robot, or path of a model folder.
    :raises ModelError: there is no such robot.
    """
    # sum of the X offsets [m] of the axes A2 to A5 from the axes before them
    reach = float(np.abs(load_robot(robot).nominal.placement[1:5, 0, 3]).sum()) * MM_PER_M
    # somewhat more than half of the reach in front of the robot, at a quarter of it in height (assumed)
    return round(0.55 * reach, -2), 0.0, round(0.25 * reach, -2)


def _six_values(title: str, values: Numbers, min_count: int) -> Numbers:
    """Return values filled up to six by zeros.

    :param title: name of the values, for messages; `min_count`: least number of values.
    :raises OptionError: there are too few values or more than six, or a value is not finite.
    """
    if not np.isfinite(values).all():
        raise OptionError(f"{title}: {', '.join(f'{value:g}' for value in values)}", advice="Give finite numbers.")
    if not min_count <= len(values) <= 6:
        raise OptionError(
            f"{title}: {len(values)} numbers", advice=f"Give {min_count if min_count == 6 else f'{min_count} to 6'}."
        )
    return (*values, *_ZERO[len(values) :])


def _six_frame_values(array: str, value: Numbers | int, request: CellRequest, robot: RobotModel) -> Numbers:
    """Return X, Y, Z, A, B, C of a frame [mm, deg].

    :param array: ``"BASE_DATA"`` or ``"TOOL_DATA"``.
    :param value: the numbers themselves, or the index of the frame in the `$config.dat` of the request.
    :raises OptionError: an index without a `$config.dat`, or a wrong count of numbers.
    """
    if not isinstance(value, int):
        return _six_values("$BASE" if array == "BASE_DATA" else "$TOOL", value, min_count=3)
    if request.config_dat is None:
        raise OptionError(
            f"{array}[{value}] is in no file", advice="Name it with --config-dat, or give X,Y,Z[,A,B,C] instead."
        )
    return _controller_frame(request.config_dat, array, value, robot)


def _controller_frame(config: Path, array: str, number: int, robot: RobotModel) -> Numbers:
    """Return X, Y, Z, A, B, C [mm, deg] of a frame in a `$config.dat`, by reading a small KRL program that uses it.

    :param config: the file; `array`: ``"BASE_DATA"`` or ``"TOOL_DATA"``; `number`: index of the frame in it.
    :raises InputError: the file has no frame of that number, or cannot be read.
    """
    variable = "$BASE" if array == "BASE_DATA" else "$TOOL"
    unused_variable = "$TOOL" if variable == "$BASE" else "$BASE"
    lines = [
        "DEF ASK()",
        f"{variable}={array}[{number}]",
        f"{unused_variable}=$NULLFRAME",
        "LIN {X 0,Y 0,Z 0,A 0,B 0,C 0}",
        "END",
    ]
    cell = Cell(
        robot=robot.name,
        base=Frame(),
        tool=Tool(),
        start=Start((0.0, -90.0, 90.0, 0.0, 0.0, 0.0)),
        config_dat=config.name,
        folder=str(config.parent),
    )
    try:
        document = decode("ASK.SRC", "\r\n".join(lines).encode())
        program = correction.read([document], robot, cell, "ASK", "krl")
    except ProgramError as cause:
        if cause.file != "ASK.SRC":  # the `$config.dat` itself has the fault
            raise
        raise InputError(f"no {array}[{number}]", file=str(config), advice="Give a number that it has.") from None
    motions = program.motions
    pose = program.bases[motions.base[-1]] if variable == "$BASE" else program.tools[motions.tool[-1]]
    frame: Array = xyzabc_from_pose(pose)
    return tuple(float(value) for value in without_negative_zero(np.round(frame.ravel(), 6)))


_LARGEST_Z = -0.1
"""Largest Z component, in the robot root, of a Z axis that points down (assumed)."""


def _metre_questions(cell: Cell, tools: Mapping[int, Frame]) -> Iterator[str]:
    """Yield a question for each of `$BASE` and the tools that seems to be given in metres."""
    yield from filter(
        None, (near_base_question(cell.base.pose(), "--base"), short_tool_question(cell.tool.pose(), "--tool"))
    )
    yield from filter(
        None, (short_tool_question(tool.pose(), f"the tool of T{number}") for number, tool in tools.items())
    )


def _base_warnings(cell: Cell) -> Iterator[str]:
    """Yield a warning if Z of `$BASE` points down, so that the tool comes from below."""
    if cell.base.pose()[2, 2] < _LARGEST_Z:
        angles = f"A {cell.base.A:g}, B {cell.base.B:g}, C {cell.base.C:g}"
        yield (
            f"Z of $BASE points down ({angles}): the tool would come from below the part. Check "
            "the angles of $BASE: A turns about Z, B about Y, C about X."
        )


def _turn_of_tool(cell: Cell, robot: RobotModel) -> tuple[float, tuple[str, ...]]:
    """Return the constant turn of the tool about its axis [deg], one of `QUARTER_TURNS`, and warnings for the user.

    With this turn A4 and A6 change least on the way from the start to the tool upright on the origin of `$BASE`. If the
    origin is out of reach with each of them, the turn is 0, and a warning says so.
    """
    start = cell.start_joints
    wrist_changes = []
    for turn in QUARTER_TURNS:
        joints = upright_joints(cell, robot, turn=turn, height=0.0)
        changes = np.abs((joints - start + np.pi) % (2.0 * np.pi) - np.pi)  # the shorter way round
        is_reached = np.isfinite(changes).all()
        wrist_changes.append(float(changes[[3, 5]].max()) if is_reached else np.inf)  # A4 and A6
    best = int(np.argmin(wrist_changes))
    if np.isfinite(wrist_changes[best]):
        return QUARTER_TURNS[best], ()
    return 0.0, ("out of reach: the origin of $BASE, with the tool upright on it. Check [base], [tool] and [start].",)


_EXAMPLE_LINES = {
    "krl": """\
# spindle_on = ["$ANOUT[1]={S}/24000.0", "$OUT[1]=TRUE"]    # KRL for M3; {S}: speed in rpm
# spindle_off = ["$OUT[1]=FALSE"]
# coolant_on = ["$OUT[2]=TRUE"]
# coolant_off = ["$OUT[2]=FALSE"]""",
    "rapid": """\
# spindle_on = ["SetAO aoSpindle,{S};", "SetDO doSpindle,1;"]    # RAPID for M3; {S}: speed in rpm
# spindle_off = ["SetDO doSpindle,0;"]
# coolant_on = ["SetDO doCoolant,1;"]
# coolant_off = ["SetDO doCoolant,0;"]""",
}
"""Examples of lines by the language of the robot's controller."""
_TOOL_BY_HAND = {"krl": ["; tool {T} by hand", "HALT"], "rapid": ["! tool {T} by hand", "Stop;"]}


def _cell_text(
    request: CellRequest,
    cell: Cell,
    robot: RobotModel,
    *,
    turn: float,
    config: str | None,
    tools: Mapping[int, Frame],
) -> str:
    """Return the text of a new cell file, with comments.

    :param cell: robot, frames and start; the request has the other values.
    :param turn: constant turn of the tool about its axis [deg].
    :param config: path of `$config.dat` relative to the cell; None: there is none.
    :param tools: T number → `$TOOL`; empty: [tool] holds for all tools.
    """
    language = robot.language if robot.language in _EXAMPLE_LINES else "krl"
    return f"""\
#:schema {schema_file("cell").as_uri()}
# Cell file of postproc: mm, degrees, N. docs/reference describes every key; what follows # is optional.
robot = {toml_string(cell.robot)}    # {robot.title}
frames = "controller"            # it measured [base] and [tool] with this arm; "model": a laser tracker did
{_config_line(config)}

[base]                           # $BASE in the robot root: where the part lies
{_frame_lines(cell.base)}

[tool]                           # $TOOL: the tool tip in the flange frame
{_frame_lines(cell.tool)}
axis = "{cell.tool.axis}"                      # axis of the tool frame that points from the spindle to the tip

[start]
joints = [{", ".join(map(_decimal, cell.start_angles))}]    # A1 to A6 where programs start: fixes the branch of the arm

[output]
tolerance_mm = 0.01              # what the predicted path may leave the nominal one by
max_correction_mm = 8.0          # a larger correction is an error

{_part_table(request.part_tolerance)}

{_gcode_table(request, turn, language)}

[machine]                        # G28, G30 and G53, by which most CAM systems retract
clearance_Z = {_decimal(request.clearance)}              # Z of $BASE to which they retract: above part and clamps
{_home_line(request.home)}
{_tool_tables(tools)}
{_work_offset_tables(request.work_offsets)}
{_numbered_frame_tables("base_data", request.base_data)}{_numbered_frame_tables("tool_data", request.tool_data)}\
{_rotary_table(request.rotary)}
{_m_code_table(request.m_codes)}

{_payload_table(request.payload)}
"""


def _config_line(config: str | None) -> str:
    """Return the line of a `$config.dat` (path as the cell states it); a comment with an example if it is None."""
    return (
        '# config_dat = "$config.dat"    # KRL: a $config.dat of the controller, for BASE_DATA and TOOL_DATA'
        if config is None
        else f"config_dat = {toml_string(config)}    # KRL: frames that programs name by number"
    )


def _gcode_table(request: CellRequest, turn: float, language: str) -> str:
    """Return the table that says how G-code becomes a program of the robot.

    :param turn: constant turn of the tool about its axis [deg].
    :param language: language of its lines and examples, ``"krl"`` or ``"rapid"``.
    """
    change = {BY_HAND: _TOOL_BY_HAND[language], NO_LINES: []}.get(request.tool_change, [request.tool_change])
    change_line = f"tool_change = [{', '.join(map(toml_string, change))}]"
    dwell = "s" if request.dwell_unit is None else request.dwell_unit
    comment = "# " if request.dwell_unit is None else ""
    dwell_line = (
        f'{comment}dwell_unit = {toml_string(dwell)}               # P of G4 and cycles: "ms" for Fanuc, Haas, Mach3'
    )
    return f"""\
[gcode]                          # how G-code becomes {language.upper()}
radius_offsets = {toml_string(request.radius_offsets)}        # "wear": D holds wear, the path is of the tool centre
{dwell_line}
redundancy_deg = {_decimal(turn)}             # turn of the tool about its axis: so that A4 and A6 stay near their start
rapid_m_per_s = 0.5              # speed of G0
approximation_mm = 0.5           # $APO.CDIS, or the zone; 0: exact stops
corner_tolerance_mm = 0.05       # a corner that approximation would round by more is an exact stop
{change_line}    # M6; {{T}}: number of the tool
{_switching_lines("spindle", request.spindle, language)}
{_switching_lines("coolant", request.coolant, language)}"""


def _switching_lines(
    device: Literal["spindle", "coolant"], lines: tuple[Sequence[str], Sequence[str]] | None, language: str
) -> str:
    """Return the keys for switching spindle or coolant.

    :param lines: lines that switch it on and off; both empty: it is switched by hand; None: the lines are not stated,
        and comments with examples are returned.
    """
    if lines is None:
        return "\n".join(line for line in _EXAMPLE_LINES[language].splitlines() if line.startswith(f"# {device}"))
    by_hand = "" if any(lines) else "    # by hand"
    keys = zip(("on", "off"), lines, strict=True)
    return "\n".join(
        f"{device}_{key} = [{', '.join(map(toml_string, statements))}]{by_hand}" for key, statements in keys
    )


def _part_table(tolerance: float | None) -> str:
    """Return the table of the part with its tolerance [mm]; a comment with an example if it is None."""
    comment = "# error allowed on the part (95 %)"
    if tolerance is None:
        return f"# [part]\n# tolerance_mm = 0.5             {comment}: the verdict judges by it"
    return f"[part]\ntolerance_mm = {_decimal(tolerance)}               {comment}"


def _tool_tables(tools: Mapping[int, Frame]) -> str:
    """Return the tables of tools, or an example of one."""
    if tools:
        tables = "\n".join(f"\n[tools.{number}]\n{_frame_lines(frame)}" for number, frame in tools.items())
        return f"\n# $TOOL after T1 M6 and so on{tables}\n"
    return """
# [tools.1]                      # $TOOL after T1 M6; without [tools] the [tool] above holds for all
# Z = 350.0
"""


def _work_offset_tables(frame_values: Mapping[str, Numbers]) -> str:
    """Return the tables of work offsets, or an example of one."""
    frames = {code: Frame(*_six_values(code, words, min_count=3)) for code, words in frame_values.items()}
    tables = "\n".join(f"\n[work_offsets.{_table_key(code)}]\n{_frame_lines(frame)}" for code, frame in frames.items())
    if tables:
        return f"# frames in $BASE after G55 and so on; G54 is $BASE itself{tables}"
    return """\
# [work_offsets.G55]             # G54 is $BASE itself; others must be given to be used
# X = 0.0"""


def _numbered_frame_tables(table: Literal["base_data", "tool_data"], values: Mapping[int, Numbers]) -> str:
    """Return the tables of frames that KRL programs name by number; an empty text if there are none."""
    frames = {
        number: Frame(*_six_values(f"{table.upper()}[{number}]", words, min_count=3))
        for number, words in values.items()
    }
    return "".join(
        f"\n{f'[{table}.{number}]':<33}# {table.upper()}[{number}] of KRL programs\n{_frame_lines(frame)}\n"
        for number, frame in frames.items()
    )


def _payload_table(values: Numbers | None) -> str:
    """Return the table of the payload: mass [kg] and centre X, Y, Z [mm]; a comment with an example if it is None."""
    head = "[payload]                      # carried in addition to the state that the robot model was calibrated in"
    if values is None:
        return f"# {head}\n# mass_kg = 0.0"
    mass, *centre = map(_decimal, values)
    axes = (f"{axis} = {value}" for axis, value in zip("XYZ", centre, strict=True))
    return "\n".join([head, f"mass_kg = {mass}", *axes])


def _home_line(home: Numbers | None) -> str:
    """Return the line of the home position in `$BASE` [mm]; a comment with an example if it is None."""
    if home is None:
        example = "# home = [0, -90, 100, 0, 80, 0]   # A1 to A6: G28 and G30 go there"
        return f"{example}; without it the tool stays above its place"
    return f"home = [{', '.join(map(_decimal, home))}]    # X, Y, Z before the first move, and after G28 and G53"


def _rotary_table(rotary: Rotary | None) -> str:
    """Return the table of rotary axes; an empty text if there are none."""
    if rotary is None:
        return ""
    lines = ["", "[rotary]                         # rotary axes from the part outwards; A, B, C turn about X, Y, Z"]
    lines += [f"axes = [{', '.join(map(toml_string, rotary.axes))}]", f"kind = {toml_string(rotary.kind or '')}"]
    for letter, axis in zip(rotary.axes, rotary.places, strict=True):
        if axis is not None:
            point, direction = (", ".join(map(_decimal, values)) for values in (axis.point, axis.direction))
            lines.append(f"{letter} = {{ point = [{point}], direction = [{direction}] }}    # in $BASE, mm")
    return "\n".join(lines) + "\n"


def _m_code_table(codes: Mapping[str, Sequence[str]]) -> str:
    """Return the table of M codes, or an example of one."""
    if codes:
        lines = "\n".join(f"{code} = [{', '.join(map(toml_string, texts))}]" for code, texts in codes.items())
        return f"[m_codes]                        # lines for M codes of the machine; []: without effect here\n{lines}"
    return """\
# [m_codes]                      # lines for M codes of the machine; []: without effect here
# M31 = []"""


def _frame_lines(frame: Frame) -> str:
    """Return the lines ``X = …`` to ``C = …`` of a frame [mm, deg]."""
    return "\n".join(f"{key} = {_decimal(getattr(frame, key))}" for key in "XYZABC")


def _table_key(name: str) -> str:
    """Return a name as a key of a TOML table; one with a dot, such as ``G54.1``, in quotes."""
    return toml_string(name) if "." in name else name


def toml_string(text: str) -> str:
    """Return a text as a TOML string (JSON strings are valid in TOML)."""
    return json.dumps(text, ensure_ascii=False)


def _decimal(value: float) -> str:
    """Return a number as text with ten significant digits at most; −0 becomes 0."""
    return repr(without_negative_zero(float(f"{value:.10g}")))


_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_COMMENT = "Written by `postproc robots add`. Units are in the names; assumed = true: not known of this robot."
_MOST_TRIANGLES = 1000
"""Triangles of a link that pages draw."""


class AddedRobot(Struct, frozen=True):
    """A model folder that was written.

    :param title: name of the robot.
    :param folder: model folder.
    :param notes: notes on the model for the user.
    """

    title: str
    folder: Path
    notes: tuple[str, ...]


def add_robot(
    urdf: Path, name: str | None = None, output: Path | None = None, *, overwrite: bool = False
) -> AddedRobot:
    """Make a model folder from the URDF of a KUKA arm.

    :param urdf: URDF file in the form of ROS-Industrial.
    :param name: name of the robot and its folder; None: the name in the URDF.
    :param output: folder to write; None: a folder of that name in the working folder.
    :param overwrite: replace an existing model.
    :raises ModelError: the arm cannot be used.
    :raises InputError: the folder has a model already, or the name is not valid or that of a shipped robot.
    """
    text = read_text(urdf, ModelError)
    arm = adopt(text, urdf.name, name)
    robot_name = name or re.sub(r"\W+", "_", arm.content.name, flags=re.ASCII).strip("_")
    if not _NAME.fullmatch(robot_name):
        raise OptionError(
            f"{robot_name!r} cannot be the name of a robot", advice="Give --name with letters, digits and _."
        )
    if robot_name in robots.shipped_models():
        raise OptionError(f"a shipped robot is called {robot_name}", advice="Give another --name.")
    folder = output or Path(robot_name)
    meshes, notes = _link_meshes(geometries(text, urdf.name), urdf, arm)
    contents: dict[str, bytes | Iterable[bytes]] = {
        "model.toml": toml(arm.content, _COMMENT),
        "robot.urdf": arm.urdf({key: _mesh_file_name(*key) for key in meshes}),
        **{_mesh_file_name(*key): surface.stl() for key, surface in meshes.items()},
    }
    protect([urdf], folder, contents)
    conflicts = [folder / file for file in contents if (folder / file).exists()]
    if conflicts and not overwrite:
        raise InputError(
            "the folder holds a robot model already",
            file=str(conflicts[0]),
            advice="Choose another -o, or --overwrite.",
        )
    kinematics.closed_form(robots.assemble(robot_name, arm.content, arm.chain))  # raises for an unusable arm
    write_whole(folder, contents)
    return AddedRobot(arm.content.name, folder, (*arm.notes, *notes))


def _mesh_file_name(carrier: int, kind: str) -> str:
    """Return the file name of the mesh of a link.

    :param carrier: index of the joint that moves the link, −1 for the base.
    :param kind: ``"visual"`` or ``"collision"``.
    """
    name = "base" if carrier < 0 else JOINTS[carrier]
    return f"{name}.stl" if kind == "visual" else f"{name}_collision.stl"


_READER_ADVICE = {"no reader of .dae is installed": "pip install pycollada gives one"}
"""End of the reason why a mesh cannot be read → advice."""
_MOST_NAMES = 8
"""Names that a note lists; the others are counted."""


def _shape_notes(problems: Sequence[str]) -> Iterator[str]:
    """Yield a note for each reason why shapes are left out, with their files.

    Reasons that differ only after a semicolon count as one.

    :param problems: texts ``FILE: reason``.
    """
    files_of_fault: dict[str, dict[str, str]] = {}
    for problem in problems:
        file, _, reason = problem.partition(": ")
        files_of_fault.setdefault(reason.partition(";")[0], {})[file] = reason
    for fault, reason_of_file in files_of_fault.items():
        names, reason = list(reason_of_file), next(iter(reason_of_file.values()))
        advice = next((f" ({text})" for end, text in _READER_ADVICE.items() if fault.endswith(end)), "")
        subject = "a shape is" if len(names) == 1 else f"{len(names)} shapes are"
        yield f"{subject} left out: {first_of(names, _MOST_NAMES)}: {reason}{advice}"


class _LinkMeshes(NamedTuple):
    """Shapes of links.

    :param shapes: (index of the joint that moves the link, −1 for the base; "visual" or "collision") → shape.
    :param notes: notes for the user.
    """

    shapes: dict[tuple[int, str], LinkShape]
    notes: list[str]


def _link_meshes(geometry: Sequence[Geometry], urdf: Path, arm: AdoptedModel) -> _LinkMeshes:
    """Return the shapes of the links in the frames of the model: simplified drawings and solids.

    A link without <collision> gets the convex hull of its drawing as its solid. A link without <visual> is drawn by its
    solid.

    :param geometry: shapes that the URDF names; `urdf`: its file.
    """
    if not geometry:
        return _LinkMeshes({}, ["the URDF names no shapes: pages draw the arm as solids of revolution"])
    file_visuals, problems = shapes.read([shape for shape in geometry if shape.drawn], urdf)
    file_solids, solid_problems = shapes.read([shape for shape in geometry if not shape.drawn], urdf)
    visuals, solids = (
        # a carrier is the joint that moves the link: row 0 of `moved` is that of the base, whose carrier is −1
        [shape.transform(arm.moved[shape.carrier + 1]) for shape in shapes.join_by_carrier(file_shapes)]
        for file_shapes in (file_visuals, file_solids)
    )
    drawn_carriers = {shape.carrier for shape in visuals}
    solid_carriers = {shape.carrier for shape in solids}
    all_solids = solids + [shape.hull() for shape in visuals if shape.carrier not in solid_carriers]
    drawings = visuals + [shape for shape in solids if shape.carrier not in drawn_carriers]
    simplified = [shapes.simplify(shape, _MOST_TRIANGLES) for shape in drawings]
    link_shapes = [shape for shape, _ in simplified]
    notes = [*_shape_notes(problems + solid_problems)]
    if link_shapes:
        largest_mm = max(displacement for _, displacement in simplified) * MM_PER_M
        notes.append(_size_note(link_shapes, drawings, largest_mm))
    elif notes:
        notes.append("pages draw the arm as solids of revolution")
    surfaces = {(shape.carrier, "visual"): shape for shape in link_shapes}
    return _LinkMeshes(surfaces | {(shape.carrier, "collision"): shape for shape in all_solids}, notes)


def _size_note(link_shapes: Sequence[LinkShape], drawings: Sequence[LinkShape], largest_mm: float) -> str:
    """Return the note on triangles and size of the shapes that pages draw.

    :param drawings: the shapes before they were simplified; `largest_mm`: largest displacement of their corners [mm].
    """
    count, old_count = (sum(len(shape.faces) for shape in group) for group in (link_shapes, drawings))
    points = sum(len(shape.points) for shape in link_shapes)
    size = 16 * (count + points)  # three numbers of 4 bytes are 16 characters in base64
    change_text = "" if count == old_count else f" of {old_count}, corners moved by at most {largest_mm:.2g} mm"
    return f"shapes of {len(link_shapes)} links: {count} triangles{change_text}; {size / 1000:.0f} kB in a page"
