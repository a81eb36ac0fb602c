"""Numbers of a cell file as fields, and its robot; edits keep its comments."""

from __future__ import annotations

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
from postproc.jobs.programs import load_robot
from postproc.jobs.start_joints import QUARTER_TURNS, USUAL_START, joints_above_part

TABLES = ("base", "tool", "machine", "payload", "part", "tool_compliance")
"""Tables that have fields: what a shop measures, and the height to which programs retract."""


def fields_of(path: Path, tools: Sequence[int] = ()) -> list[FormField]:
    """Return the fields of a cell file: of its tables, and those of tools by their numbers.

    :param tools: numbers of tools that the file need not have yet.
    :raises CellError: it cannot be read.
    """
    document = parse(files.read_text(path, CellError), str(path), CellError)
    stated_tools = document.get("tools", {})
    names = [name for name in (stated_tools if hasattr(stated_tools, "get") else ()) if name.isdecimal()]
    numbers = sorted({*map(int, names), *tools})
    tables = [*TABLES[:2], *(f"tools.{number}" for number in numbers), *TABLES[2:]]
    return [field for table in tables for field in fields_of_table(document, "cell", table, "number")]


def table_help(table: str) -> str:
    """Return what a table of the cell states."""
    name, _, number = table.partition(".")
    return f"$TOOL after T{number} M6: the tool tip in the flange frame" if number else table_schema("cell", name).help


def kept_frames(path: Path, tools: Sequence[int]) -> tuple[str, tuple[int, ...]]:
    """Return robot and frames of a cell in words, and the tools that share `[tool]` although there are several.

    :param tools: numbers of the tools of a program.
    """
    try:
        cell = cells.load(path)
        robot = load_robot(cell.robot, cell.folder)
    except PostprocError as cause:
        return str(cause), ()
    frames = {"$BASE": cell.base}
    if cell.tools:
        frames |= {f"$TOOL of T{number}": cell.tools[str(number)] for number in tools if str(number) in cell.tools}
    else:
        frames[f"$TOOL{f' of T{tools[0]}' if len(tools) == 1 else ''}"] = cell.tool
    words = [f"{name} {_in_words(frame)}" for name, frame in frames.items()]
    return ", ".join([robot.title, *words]), tuple(tools) if len(tools) > 1 and not cell.tools else ()


def _in_words(frame: cells.Frame) -> str:
    """Return a frame as text [mm, deg]; angles that are all 0 are left out."""
    turn = (frame.A, frame.B, frame.C)
    values = (frame.X, frame.Y, frame.Z, *(turn if any(turn) else ()))
    return " ".join(f"{axis} {value:g}" for axis, value in zip("XYZABC", values, strict=False))


def edit(path: Path, texts: Mapping[str, str], tools: Sequence[int] = ()) -> bool:
    """Write numbers into a cell file, checked as `convert` checks it; return whether anything has changed.

    Only numbers that differ are touched: comments and all else stay. Nothing is written if the cell would be unusable.

    :param texts: numbers by the name of the field; empty: the key is removed.
    :param tools: see `fields_of`.
    :raises InputError: a text is no number, or the cell would be unusable.
    """
    old_text = files.read_text(path, CellError)
    document = parse(old_text, str(path), CellError)
    new_text = edit_text(old_text, document, fields_of(path, tools), texts)
    if new_text == old_text:
        return False
    write_valid(path, new_text, cells.load)
    return True


def set_frames(path: Path, frames: Mapping[str, Mapping[str, float]]) -> None:
    """Write frames into a cell file, checked as `convert` checks it; comments and all else stay.

    :param frames: numbers by axis [mm, deg], by the name of the table: ``"base"``, ``"base_data.1"``.
    :raises InputError: the cell would be unusable.
    """
    old_text = files.read_text(path, CellError)
    document = parse(old_text, str(path), CellError)
    fields = [field for table in frames for field in fields_of_table(document, "cell", table, "number")]
    texts = {f"{table}.{axis}": str(value) for table, frame in frames.items() for axis, value in frame.items()}
    write_valid(path, edit_text(old_text, document, fields, texts), cells.load)


def robot_of(path: Path, model: Path) -> tuple[str, bool]:
    """Return the robot that a cell file names, and whether it is a model folder; empty: the cell is unusable."""
    try:
        cell = cells.load(path)
        return cell.robot, robots.find(cell.robot, Path(cell.folder)).resolve() == model.resolve()
    except PostprocError:
        return "", False


def feed_rule(path: Path) -> str:
    """Return `[output] feed` of a cell file, ``"program"`` or ``"hold"``; empty: there is no tolerance of the part.

    :raises CellError: the cell is unusable.
    """
    cell = cells.load(path)
    return cell.output.feed if cell.part.tolerance_mm is not None else ""


def set_feed_rule(path: Path, rule: str) -> bool:
    """Write `[output] feed` into a cell file; return whether it was another one.

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
    """Write [start] joints with the tip above the origin of `$BASE` into a cell file; return whether it had others.

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
    """Write a model folder into a cell file as its robot; return whether it was another one.

    :raises InputError: the cell or the model would be unusable.
    """
    return set_robot(path, relative_path(path.parent, model))


def set_robot(path: Path, robot: str) -> bool:
    """Write the robot of a cell file; return whether it was another one.

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
        cell = cells.load(trial_path)
        load_robot(cell.robot, cell.folder)

    write_valid(path, new_text, check)
    return True
