"""`postproc init` and `postproc samples`: the first files of a user."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from postproc.cli.options import Choice, complete_robots

if TYPE_CHECKING:
    from postproc.hosts.robodk_station import Station
    from postproc.jobs.first_steps import Numbers

_PATH = click.Path(path_type=Path)


def _numbers(text: str) -> Numbers:
    try:
        return tuple(float(word) for word in text.replace(";", ",").split(",") if word.strip())
    except ValueError:
        raise click.BadParameter(f"{text!r}: give numbers with commas between, such as 1500,-200,700") from None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a number") from None


def _frame(text: str) -> Numbers | int:
    return int(text) if text.strip().isdecimal() else _numbers(text)


def _tools(texts: Sequence[str]) -> dict[int, Numbers]:
    """Return $TOOL by T number from texts such as ``1=0,0,412.5`` or ``1=412.5``, which is its Z."""
    tools: dict[int, Numbers] = {}
    for text in texts:
        number, equals, words = text.partition("=")
        found = _numbers(words)
        name = number.strip().upper().removeprefix("T")
        if not equals or not name.isdecimal() or not found:
            raise click.BadParameter(f"{text!r}: give the number of the tool and its $TOOL, such as 1=0,0,412.5")
        frame = (0.0, 0.0, *found) if len(found) == 1 else found
        _once(tools, int(name), frame, f"tool {int(name)}")
    return tools


def _once(frames: dict[Any, Numbers], key: Any, frame: Numbers, what: str) -> None:
    """Add a frame; refuse a second, different one."""
    if (other := frames.setdefault(key, frame)) != frame:
        first, second = (",".join(f"{word:g}" for word in words) for words in (other, frame))
        raise click.BadParameter(f"{what} is given twice, {first} and {second}: leave one of them out")


def _tools_line(text: str) -> dict[int, Numbers]:
    return _tools(text.split())


def _work_offsets(texts: Sequence[str]) -> dict[str, Numbers]:
    """Return frames in $BASE by the code of the work offset from texts such as ``G55=300,0,0``."""
    offsets: dict[str, Numbers] = {}
    for text in texts:
        name, _, words = text.partition("=")
        found = _numbers(words)
        code = name.strip().upper()
        if not re.fullmatch(r"G5[4-9]|G59\.[1-3]", code) or not found:
            raise click.BadParameter(f"{text!r}: give G54 to G59.3 and its frame in $BASE, such as G55=300,0,0")
        _once(offsets, code, found, code)
    return offsets


def _work_offsets_line(text: str) -> dict[str, Numbers]:
    return _work_offsets(text.split())


def _m_codes(texts: Sequence[str]) -> list[str]:
    """Return M codes from texts such as ``M31`` or ``31``."""
    from postproc.cell import m_code_fault

    codes = []
    for text in texts:
        name = text.strip().upper().removeprefix("M")
        if not (name.isascii() and name.isdecimal()):
            raise click.BadParameter(f"{text!r}: give an M code, such as M31")
        codes.append(f"M{int(name)}")
        if fault := m_code_fault(codes[-1]):
            raise click.BadParameter(f"{text!r}: {fault[0]}. {fault[1]}")
    return codes


def _m_codes_line(text: str) -> list[str]:
    return _m_codes(text.replace(",", " ").split())


def _line(text: str) -> str:
    """Return a line of the robot's language in which brackets and strings are closed."""
    from postproc.cell import lines_fault

    if fault := lines_fault([text]):
        raise click.BadParameter(fault)
    return text


def _switch(text: str) -> tuple[list[str], list[str]]:
    """Return the lines that switch something on and off, of "ON|OFF"; none for "hand"."""
    from postproc.jobs.first_steps import BY_HAND

    if text.strip() == BY_HAND:
        return [], []
    lines = [_line(line.strip()) for line in text.split("|")]
    if len(lines) != 2 or not all(lines):
        raise click.BadParameter(
            f"{text!r}: give both lines with | between, such as $OUT[1]=TRUE|$OUT[1]=FALSE, or hand"
        )
    return [lines[0]], [lines[1]]


def _tolerance(text: str) -> float | None:
    """Return a length above 0; None for an empty answer."""
    if not text.strip():
        return None
    if not (length := _number(text)) > 0.0:
        raise click.BadParameter(f"{text!r}: give a length above 0")
    return length


def _robot(text: str) -> str:
    from postproc.errors import ModelError
    from postproc.robot import find

    try:
        find(text)
    except ModelError as cause:
        raise click.BadParameter(str(cause)) from None
    return text


def _parsed(kind: Any) -> Any:
    return lambda _ctx, _param, text: None if text is None else kind(text)


@click.command()
@click.argument("cell", type=_PATH, default="cell.toml")
@click.option("--robot", shell_complete=complete_robots, help="Robot: a name of `postproc robots`, or a model folder.")
@click.option("--base", callback=_parsed(_frame), metavar="X,Y,Z[,A,B,C]", help="$BASE in the robot root, or a number.")
@click.option(
    "--tool", callback=_parsed(_frame), metavar="X,Y,Z[,A,B,C]", help="$TOOL in the flange frame, or a number."
)
@click.option(
    "--axis",
    type=Choice(["+Z", "-Z", "+X", "-X"]),
    default="+Z",
    show_default=True,
    help="Axis of the tool frame that points from the spindle to the tip.",
)
@click.option(
    "--start",
    callback=_parsed(_numbers),
    metavar="A1,…,A6",
    help="Where programs start, in deg; default: the tip 50 mm above --clearance, over the origin of $BASE.",
)
@click.option("--config-dat", type=_PATH, help="$config.dat of the controller: --base and --tool may be numbers then.")
@click.option(
    "--clearance", type=float, metavar="Z", help="Z of $BASE to which G28, G30 and G53 retract; default: 200."
)
@click.option(
    "--tool-change",
    callback=_parsed(_line),
    metavar="LINE",
    help="Line for M6, with {T}; 'hand': the program stops (default); 'none': no line.",
)
@click.option(
    "--tools",
    multiple=True,
    callback=lambda _ctx, _param, texts: _tools(texts),
    metavar="N=X,Y,Z[,A,B,C]",
    help="$TOOL after T n M6, or its Z alone; once for each tool. Default: --tool for all.",
)
@click.option(
    "--work-offset",
    "work_offsets",
    multiple=True,
    callback=lambda _ctx, _param, texts: _work_offsets(texts),
    metavar="G55=X,Y,Z[,A,B,C]",
    help="Frame of a work offset in $BASE; once for each. G54 is $BASE itself.",
)
@click.option(
    "--m-code",
    "m_codes",
    multiple=True,
    callback=lambda _ctx, _param, texts: _m_codes(texts),
    metavar="M31",
    help="M code of the machine that has no effect on the robot; once for each.",
)
@click.option(
    "--radius-offsets",
    type=Choice(["radius", "wear"]),
    default="radius",
    show_default=True,
    help="What D of G41 and G42 holds. With wear the path of the program is that of the tool centre.",
)
@click.option(
    "--dwell-unit",
    type=Choice(["s", "ms"]),
    help="What the control counts in P of G4 and of cycles: s (LinuxCNC) or ms (Fanuc, Haas, Mach3).",
)
@click.option(
    "--part-tolerance", type=float, metavar="MM", help="What the part may be off (95 %); default: not judged."
)
@click.option(
    "--spindle",
    callback=_parsed(_switch),
    metavar="ON|OFF",
    help="Lines for M3, with {S}, and for M5, with | between; 'hand': you start it. Default: a warning.",
)
@click.option(
    "--coolant",
    callback=_parsed(_switch),
    metavar="ON|OFF",
    help="Lines for M7 and M8, and for M9, likewise.",
)
@click.option(
    "--robodk",
    metavar="STATION.rdk",
    help="Station of RoboDK, which must be on this machine: robot, base, tool and start; 'open': the one that is open.",
)
@click.option("--overwrite", is_flag=True, help="Replace a file that is there.")
def init(cell: Path, robodk: str | None, **given: Any) -> None:
    """Write a cell file with comments, by options or by questions.

    CELL is the file to write, cell.toml by default. On a terminal it asks for what no option says. Lengths are mm,
    angles degrees. With --config-dat, --base 3 takes BASE_DATA[3] and --tool 2 takes TOOL_DATA[2]. With --robodk,
    RoboDK is asked for its robot, the active frame and tool, and the joint angles; options win.

    \b
    Examples:
      postproc init
      postproc init my_cell.toml --robot kuka_kr270 --base 1500,-200,700 --tool 0,0,350
      postproc init --robot kuka_kr270 --base 1500,0,700 --tools 1=0,0,350 --tools 2=0,0,412.5 --clearance 150
      postproc init --robot kuka_kr270 --base 1500,0,700 --tool 0,0,350 --work-offset G55=300,0,0 --m-code M31
      postproc init --robot kuka_kr210_r2700_2 --config-dat '$config.dat' --base 3 --tool 2
      postproc init --robodk milling.rdk
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.errors import argument
    from postproc.jobs import load_robot
    from postproc.jobs.first_steps import CellRequest, check_new, write_cell

    check_new(cell, overwrite=given["overwrite"])
    station = None if robodk is None else _station(robodk, given)
    asked = _asked(given)
    remarks = write_cell(CellRequest(output=cell, **asked))
    if station is not None:
        remarks = (*remarks, *_of_station(station, asked["robot"]))
    language = load_robot(asked["robot"]).language
    to = f" --to {language}" if language not in ("", "krl") else ""
    click.echo(f"written: {cell}. Look it over, then: postproc convert PROGRAM --cell {argument(cell)}{to}")
    for remark in remarks:
        click.echo(f"warning: {remark}", err=True)


def _station(robodk: str, given: dict[str, Any]) -> Station:
    """Fill values without an option from a station of RoboDK; return the station."""
    from postproc.hosts.robodk_station import read

    station = read(robodk)
    for name, value in (("base", station.base), ("tool", station.tool), ("start", station.start)):
        if given[name] is None:
            given[name] = value
    if given["robot"] is None:
        given["robot"] = station.shipped()
    if given["robot"] is None:
        click.echo(f"The robot of the station is {station.robot}: there is no robot model of this name.", err=True)
    return station


def _of_station(station: Station, robot: str) -> tuple[str, ...]:
    """Return warnings about a cell from a station."""
    from postproc.jobs import load_robot

    warning = station.check_flange(load_robot(robot))
    return (*station.remarks, *(() if warning is None else (warning,)))


def _asked(given: dict[str, Any]) -> dict[str, Any]:
    """Ask for values without an option; without a terminal take the default, or raise if there is none."""
    from postproc.jobs import first_steps

    if given["tool"] is None and given["tools"]:
        given["tool"] = next(iter(given["tools"].values()))
    missing = [name for name in ("robot", "base", "tool") if given[name] is None]
    if missing and not _terminal():
        raise click.UsageError(f"Give {', '.join(f'--{name}' for name in missing)} (there is no terminal to ask on).")

    def ask(name: str, text: str, default: Any, parse: Any) -> None:
        if given[name] is None:
            given[name] = click.prompt(text, default=default, value_proc=parse) if missing else parse(str(default))

    if missing:
        click.echo("Lengths in mm, angles in degrees. Enter takes the value in brackets.")
    if given["robot"] is None:
        from postproc.robot import shipped

        click.echo(f"Robots: {', '.join(shipped())}")
    ask("robot", "Robot, or the path of a model folder", "kuka_kr270", _robot)
    if given["base"] is None:
        usual = ",".join(f"{value:g}" for value in first_steps.usual_base(given["robot"]))
        ask("base", "$BASE in the robot root: X,Y,Z[,A,B,C]", usual, _frame)
    ask("tool", "$TOOL, the tool tip in the flange frame: X,Y,Z[,A,B,C]", "0,0,350", _frame)
    if missing and not given["tools"]:
        text = "Tools that programs change to, such as 1=0,0,350 2=0,0,412.5 (empty: $TOOL holds for all)"
        given["tools"] = click.prompt(text, default="", show_default=False, value_proc=_tools_line)
    if missing and not given["work_offsets"]:
        text = "Work offsets that programs use in addition to G54, such as G55=300,0,0 (empty: none)"
        given["work_offsets"] = click.prompt(text, default="", show_default=False, value_proc=_work_offsets_line)
    if missing and not given["m_codes"]:
        text = "M codes that have no effect on the robot, such as M31 M33 (empty: none)"
        given["m_codes"] = click.prompt(text, default="", show_default=False, value_proc=_m_codes_line)
    if missing and given["start"] is None:
        text = "Joints where programs start: A1,…,A6 (empty: chosen with the tip above the part)"
        given["start"] = click.prompt(text, default="", show_default=False, value_proc=_numbers) or None
    ask("clearance", "Z of $BASE to which programs retract (G28, G30, G53)", f"{first_steps.CLEARANCE_MM:g}", _number)
    text = "Tool change: hand (the program stops), none, or a line that calls the changer, with {T}"
    ask("tool_change", text, first_steps.BY_HAND, _line)
    if missing:
        if given["spindle"] is None:
            text = "Spindle: lines for M3, with {S}, and M5, with | between, or hand"
            given["spindle"] = click.prompt(text, default=first_steps.BY_HAND, value_proc=_switch)
        if given["coolant"] is None:
            text = "Coolant: lines for M7 and M8, and for M9, with | between, or hand"
            given["coolant"] = click.prompt(text, default=first_steps.BY_HAND, value_proc=_switch)
        if given["part_tolerance"] is None:
            text = "What the part may be off (95 %) (empty: nothing is judged by it)"
            given["part_tolerance"] = click.prompt(text, default="", show_default=False, value_proc=_tolerance)
    return given


def _terminal() -> bool:
    return sys.stdin.isatty()


@click.command()
@click.argument("folder", type=_PATH, default="samples")
@click.option("--overwrite", is_flag=True, help="Replace files that are there and differ.")
def samples(folder: Path, overwrite: bool) -> None:
    """Write the samples into a folder.

    Programs, forces, cells, and the study of the paper. FOLDER is made if it is not there; samples by default.

    \b
    Example:
      postproc samples my_samples
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.errors import argument
    from postproc.jobs.first_steps import copy_samples

    written = copy_samples(folder, overwrite=overwrite)
    click.echo(f"written: {len(written)} files in {folder}. To try them:")
    program, cell = argument(folder / "pocket.nc"), argument(folder / "cell_kr270.toml")
    click.echo(f"  postproc convert {program} --cell {cell} -o out")
