"""Numbers of a cell file as fields, and its robot; edits keep its comments."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import tomlkit
from msgspec.structs import replace

from postproc import cell as cells
from postproc import files
from postproc import robot as robots
from postproc.errors import CellError, InputError, PostprocError
from postproc.jobs.file_form import FormField, edit_text, fields_of_table, parse, table_schema, write_valid
from postproc.jobs.first_steps import CLEARANCE_MM, relative_path
from postproc.jobs.program_needs import ProgramNeeds
from postproc.jobs.programs import load_robot
from postproc.jobs.start_joints import QUARTER_TURNS, USUAL_START, joints_above_part

TABLES = ("base", "tool", "machine", "payload", "part", "tool_compliance")
"""Tables that have fields: what a shop measures, and the height to which programs retract."""


FRAMES: Mapping[str, tuple[str, str]] = {
    "tools": ("Tool {}", "$TOOL after T{} M6: the tool tip in the flange frame"),
    "work_offsets": ("Work offset {}", "Place of {} in $BASE"),
    "base_data": ("BASE_DATA[{}]", "$BASE number {} of the controller, in the robot root"),
    "tool_data": ("TOOL_DATA[{}]", "$TOOL number {} of the controller: the tool tip in the flange frame"),
}
"""Tables of frames by number or code → heading, and what they state."""
_FRAME_TABLE = re.compile(r"(?:tools|base_data|tool_data)\.[0-9]{1,4}|work_offsets\.G5[4-9]", re.ASCII)


def frame_tables(text: str) -> tuple[str, ...]:
    """Return the names of tables of frames, such as ``"tools.2"``, in a text with commas; other words are left out."""
    return tuple(word for word in text.split(",") if _FRAME_TABLE.fullmatch(word))


def fields_of(path: Path, frames: Sequence[str] = ()) -> list[FormField]:
    """Return the fields for numbers of a cell file: of `TABLES`, and of its frames by number or code.

    :param frames: further tables of frames, such as ``"tools.2"``, which the file need not have yet.
    :raises CellError: the file cannot be read.
    """
    document = parse(files.read_text(path, CellError), str(path), CellError)
    stated_tables = ((name, document.get(name, {})) for name in FRAMES)
    names = [f"{name}.{key}" for name, table in stated_tables if hasattr(table, "get") for key in table]
    names = [*{*filter(_FRAME_TABLE.fullmatch, names), *frames}]
    names.sort(key=lambda name: (list(FRAMES).index(name.partition(".")[0]), len(name), name))
    tables = [*TABLES[:2], *names, *TABLES[2:]]
    return [field for table in tables for field in fields_of_table(document, "cell", table, "number")]


def table_help(table: str) -> str:
    """Return what a table of the cell states, as help for its form.

    :param table: such as ``"base"`` or ``"tools.2"``.
    """
    name, _, number = table.partition(".")
    return FRAMES[name][1].format(number) if number else table_schema("cell", name).help


def missing_frames(path: Path, needs: ProgramNeeds) -> tuple[str, ...]:
    """Return the tables of frames that a program needs and a cell lacks, such as ``"base_data.3"``.

    Frames by number are left out if the cell has a `config_dat`, which may have them. Of an unusable cell none is
    returned.
    """
    try:
        cell = cells.load(path)
    except PostprocError:
        return ()
    stated_frames = {f"{name}.{key}" for name in FRAMES for key in getattr(cell, name)}
    tools = [f"tools.{number}" for number in needs.tools if number] if cell.tools or needs.changes_tools else []
    by_number = () if cell.config_dat else needs.frames
    offsets = [f"work_offsets.{code}" for code in needs.work_offsets]
    return tuple(table for table in (*tools, *offsets, *by_number) if table not in stated_frames)


def robot_and_frames_text(path: Path, tools: Sequence[int]) -> str:
    """Return robot, `$BASE` and `$TOOL` of a cell as a line of text; the error text if the cell is unusable.

    :param tools: numbers of the tools of a program; only these of [tools] are named.
    """
    try:
        cell = cells.load(path)
        robot = load_robot(cell.robot, cell.folder)
    except PostprocError as cause:
        return str(cause)
    frames = {"$BASE": cell.base}
    if cell.tools:
        frames |= {f"$TOOL of T{number}": cell.tools[str(number)] for number in tools if str(number) in cell.tools}
    else:
        frames[f"$TOOL{f' of T{tools[0]}' if len(tools) == 1 else ''}"] = cell.tool
    words = [f"{name} {_frame_text(frame)}" for name, frame in frames.items()]
    return ", ".join([robot.title, *words])


def _frame_text(frame: cells.Frame) -> str:
    """Return a frame as text [mm, deg]; angles that are all 0 are left out."""
    angles = (frame.A, frame.B, frame.C)
    values = (frame.X, frame.Y, frame.Z, *(angles if any(angles) else ()))
    return " ".join(f"{axis} {value:g}" for axis, value in zip("XYZABC", values, strict=False))


def edit(path: Path, texts: Mapping[str, str], frames: Sequence[str] = ()) -> bool:
    """Write numbers into a cell file, checked as `convert` checks it; return whether anything has changed.

    Only numbers that differ are touched: comments and all else stay. Nothing is written if the cell would be unusable.

    :param texts: numbers by the name of the field; empty: the key is removed.
    :param frames: see `fields_of`.
    :raises InputError: a text is no number, or the cell would be unusable.
    """
    old_text = files.read_text(path, CellError)
    document = parse(old_text, str(path), CellError)
    new_text = edit_text(old_text, document, fields_of(path, frames), texts)
    if new_text == old_text:
        return False
    write_valid(path, new_text, cells.load)
    return True


def robot_name(path: Path) -> str:
    """Return the name or path of the robot in a cell file; empty if the cell is unusable."""
    try:
        return cells.load(path).robot
    except PostprocError:
        return ""


def uses_model(path: Path, model: Path) -> bool:
    """Return whether a model folder is the robot of a cell file; False if the cell is unusable."""
    try:
        cell = cells.load(path)
        return robots.find(cell.robot, Path(cell.folder)).resolve() == model.resolve()
    except PostprocError:
        return False


def feed_rule(path: Path) -> str:
    """Return `[output] feed` of a cell file, ``"program"`` or ``"hold"``; empty: there is no tolerance of the part.

    :raises CellError: the cell is unusable.
    """
    cell = cells.load(path)
    return cell.output.feed if cell.part.tolerance_mm is not None else ""


def set_feed_rule(path: Path, rule: str) -> bool:
    """Write `[output] feed` into a cell file; return whether the text has changed.

    :param rule: ``"program"`` or ``"hold"``.
    :raises InputError: the cell would be unusable, or there is no such rule.
    """
    old_text = files.read_text(path, CellError)
    document = parse(old_text, str(path), CellError)
    document.setdefault("output", tomlkit.table())["feed"] = rule
    new_text = tomlkit.dumps(document)
    if new_text != old_text:
        write_valid(path, new_text, cells.load)
    return new_text != old_text


def choose_start(path: Path) -> bool:
    """Write [start] joints with the tip above the origin of `$BASE` into a cell file; return whether the text changed.

    :raises InputError: no such joints are within reach, or the cell is unusable.
    """
    cell = cells.load(path)
    robot = load_robot(cell.robot, cell.folder)
    if cell.start is None:
        cell = replace(cell, start=cells.Start(USUAL_START))
    clearance = CLEARANCE_MM if cell.machine.clearance_Z is None else cell.machine.clearance_Z
    turns = (cell.gcode.redundancy_deg,) if cell.gcode.redundancy == "constant" else QUARTER_TURNS
    joints = joints_above_part(cell, robot, clearance, turns)
    if joints is None:
        problem = f"no [start] is within reach above the origin of $BASE, with the tip above Z {clearance:g}"
        raise InputError(problem, file=str(path), advice="Check [base], [tool] and clearance_Z.")
    old_text = files.read_text(path, CellError)
    document = parse(old_text, str(path), CellError)
    document.setdefault("start", tomlkit.table())["joints"] = list(joints)
    new_text = tomlkit.dumps(document)
    if new_text != old_text:
        write_valid(path, new_text, cells.load)
    return new_text != old_text


def use_model(path: Path, model: Path) -> bool:
    """Write a model folder into a cell file as its robot; return whether the text has changed.

    :raises InputError: the cell or the model would be unusable.
    """
    return set_robot(path, relative_path(path.parent, model))


def set_robot(path: Path, robot: str) -> bool:
    """Write the robot into a cell file; return whether the text has changed.

    :param robot: name of a shipped robot, or the path of a model folder as the cell states it.
    :raises InputError: the cell or the model would be unusable.
    """
    old_text = files.read_text(path, CellError)
    document = parse(old_text, str(path), CellError)
    document["robot"] = robot
    new_text = tomlkit.dumps(document)
    if new_text == old_text:
        return False

    def check(trial_path: Path) -> None:
        """Check that a cell file and its robot can be read.

        :raises PostprocError: the cell or the robot is unusable.
        """
        cell = cells.load(trial_path)
        load_robot(cell.robot, cell.folder)

    write_valid(path, new_text, check)
    return True
