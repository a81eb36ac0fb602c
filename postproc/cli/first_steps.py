"""`postproc init` and `postproc samples`: the first files of a user."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from postproc.cli.asking import is_terminal
from postproc.cli.options import Choice, complete_files, complete_robots
from postproc.cli.ranges import FiniteFloat, FiniteRange

if TYPE_CHECKING:
    from postproc.hosts.robodk_station import Station
    from postproc.jobs.first_steps import CellRequest

_PATH = click.Path(path_type=Path)
_HOME = "Where X, Y, Z are before the first move and after G28 and G53, in $BASE"


def _option_value(kind: str, text: Any) -> Any:
    """Return the value of the text of an option.

    :param kind: name of the function of `jobs.answers` that reads the text, such as "frame".
    :raises click.BadParameter: the text cannot be used.
    """
    from postproc.errors import InputError
    from postproc.jobs import answers

    try:
        return getattr(answers, kind)(text)
    except InputError as cause:
        raise click.BadParameter(str(cause).removesuffix(".")) from None


def _list_parser(kind: str) -> Callable[[str], Any]:
    """Return a function that reads a list of values separated by blanks; `kind` as of `_option_value`."""
    return lambda text: _option_value(kind, text.split())


def _option_callback(kind: str) -> Any:
    """Return a click callback that turns the text of an option into its value, None into None.

    :param kind: as of `_option_value`.
    """
    return lambda _ctx, _param, text: None if text is None else _option_value(kind, text)


@click.command()
@click.argument("files", nargs=-1, type=_PATH, metavar="[CELL] [PROGRAM]...", shell_complete=complete_files)
@click.option("--robot", shell_complete=complete_robots, help="Robot: a name of `postproc robots`, or a model folder.")
@click.option(
    "--base", callback=_option_callback("frame"), metavar="X,Y,Z[,A,B,C]", help="$BASE in the robot root, or a number."
)
@click.option(
    "--tool",
    callback=_option_callback("frame"),
    metavar="X,Y,Z[,A,B,C]",
    help="$TOOL in the flange frame, or a number.",
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
    callback=_option_callback("numbers"),
    metavar="A1,…,A6",
    help="Where programs start, in deg; default: the tip 50 mm above --clearance, over the origin of $BASE.",
)
@click.option("--config-dat", type=_PATH, help="$config.dat of the controller: --base and --tool may be numbers then.")
@click.option(
    "--clearance", type=FiniteFloat(), metavar="Z", help="Z of $BASE to which G28, G30 and G53 retract; default: 200."
)
@click.option(
    "--tool-change",
    callback=_option_callback("line"),
    metavar="LINE",
    help="Line for M6, with {T}; 'hand': the program stops (default); 'none': no line.",
)
@click.option(
    "--tools",
    multiple=True,
    callback=_option_callback("tools"),
    metavar="N=X,Y,Z[,A,B,C]",
    help="$TOOL after T n M6, or its Z alone; once for each tool. Default: --tool for all.",
)
@click.option(
    "--work-offset",
    "work_offsets",
    multiple=True,
    callback=_option_callback("work_offsets"),
    metavar="G55=X,Y,Z[,A,B,C]",
    help="Frame of a work offset in $BASE; once for each. G54 is $BASE itself.",
)
@click.option(
    "--base-data",
    multiple=True,
    callback=_option_callback("numbered_frames"),
    metavar="N=X,Y,Z[,A,B,C]",
    help="BASE_DATA[N] of KRL programs, in the robot root; once for each.",
)
@click.option(
    "--tool-data",
    multiple=True,
    callback=_option_callback("numbered_frames"),
    metavar="N=X,Y,Z[,A,B,C]",
    help="TOOL_DATA[N] of KRL programs, in the flange frame; once for each.",
)
@click.option(
    "--m-code",
    "m_codes",
    multiple=True,
    callback=_option_callback("m_codes"),
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
@click.option("--home", callback=_option_callback("place"), metavar="X,Y,Z", help=f"{_HOME}.")
@click.option(
    "--rotary", callback=_option_callback("rotary_axes"), metavar="C,B", help="Rotary axes from the part outwards."
)
@click.option("--rotary-kind", type=Choice(["tcp", "indexed"]), help="What X, Y, Z are where rotary axes turn.")
@click.option(
    "--rotary-point",
    "rotary_points",
    multiple=True,
    callback=_option_callback("points"),
    metavar="A=X,Y,Z",
    help="A point of an indexed axis in $BASE; once for each.",
)
@click.option(
    "--part-tolerance",
    type=FiniteRange(min=0, min_open=True),
    metavar="MM",
    help="What the part may be off (95 %); default: not judged.",
)
@click.option(
    "--payload",
    callback=_option_callback("payload"),
    metavar="KG[,X,Y,Z]",
    help="Mass that the flange carries, and its centre in the flange frame; RAPID states it as load of the tool.",
)
@click.option(
    "--spindle",
    callback=_option_callback("switch"),
    metavar="ON|OFF",
    help="Lines for M3, with {S}, and for M5, with | between; 'hand': you start it. Default: a warning.",
)
@click.option(
    "--coolant",
    callback=_option_callback("switch"),
    metavar="ON|OFF",
    help="Lines for M7 and M8, and for M9, likewise.",
)
@click.option(
    "--robodk",
    metavar="STATION.rdk",
    help="Station of RoboDK, which must be on this machine: robot, base, tool and start; 'open': the one that is open.",
)
@click.option("--overwrite", is_flag=True, help="Replace a file that is there.")
def init(files: tuple[Path, ...], robodk: str | None, **options: Any) -> None:
    """Write a cell file with comments, by options or by questions.

    CELL is the file to write, cell.toml by default. On a terminal it asks for what no option says; with PROGRAM, for
    what these programs need and nothing else, and then says whether they convert. Lengths are mm, angles degrees.
    With --config-dat, --base 3 takes BASE_DATA[3] and --tool 2 takes TOOL_DATA[2]. With --robodk, RoboDK is asked for
    its robot, the active frame and tool, and the joint angles; options win.

    \b
    Examples:
      postproc init
      postproc init my_cell.toml --robot kuka_kr270 --base 1500,-200,700 --tool 0,0,350
      postproc init part.nc
      postproc init --robot kuka_kr270 --base 1500,0,700 --tools 1=0,0,350 --tools 2=0,0,412.5 --clearance 150
      postproc init --robot kuka_kr270 --base 1500,0,700 --tool 0,0,350 --work-offset G55=300,0,0 --m-code M31
      postproc init --robot kuka_kr210_r2700_2 --config-dat '$config.dat' --base 3 --tool 2
      postproc init --robodk milling.rdk
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.errors import argument
    from postproc.jobs import load_robot
    from postproc.jobs.first_steps import CellRequest, check_new, write_cell

    cell, programs = _cell_and_programs(files)
    check_new(cell, overwrite=options["overwrite"])
    station = None if robodk is None else _station(robodk, options)
    if options["tool"] is None and options["tools"]:  # [tool] is required in a cell: it gets the first numbered tool
        options["tool"] = next(iter(options["tools"].values()))
    if programs:
        request = _request_for_programs(cell, programs, options)
    else:
        request = CellRequest(output=cell, **_cell_values(options))
    remarks = write_cell(request)
    if station is not None:
        remarks = (*remarks, *_station_warnings(station, request.robot))
    language = load_robot(request.robot).language
    to = f" --to {language}" if language not in ("", "krl") else ""
    arguments = " ".join(argument(program) for program in programs) or "PROGRAM"
    click.echo(f"written: {cell}. Look it over, then: postproc convert {arguments} --cell {argument(cell)}{to}")
    for remark in remarks:
        click.echo(f"warning: {remark}", err=True)
    if programs and not _all_convert(programs, cell, language):
        sys.exit(1)


def _cell_and_programs(files: tuple[Path, ...]) -> tuple[Path, list[Path]]:
    """Return the cell file to write, cell.toml by default, and the programs for which it is.

    Files with the extension of a program are programs.

    :raises click.UsageError: several files are no programs.
    """
    from postproc.dialects import registry

    programs = [file for file in files if registry.has_known_extension(file)]
    cells = [file for file in files if file not in programs]
    if len(cells) > 1:
        raise click.UsageError(f"Two cell files: {cells[0]} and {cells[1]}. Name one, and programs with an extension.")
    return next(iter(cells), Path("cell.toml")), programs


def _cell_values(options: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of `CellRequest` by name, from options and from answers on the terminal.

    :raises click.UsageError: robot, base or tool is missing, and there is no terminal.
    """
    # the options --rotary, --rotary-kind and --rotary-point together are the field `rotary`
    values = {key: value for key, value in _complete_options(options).items() if not key.startswith("rotary")}
    no_lines: list[str] = []  # written for an M code that has no effect on the robot
    values["m_codes"] = dict.fromkeys(options["m_codes"], no_lines)
    return values | _rotary_field(options)


def _rotary_field(options: dict[str, Any]) -> dict[str, Any]:
    """Return the field `rotary` of `CellRequest` by name; empty if no option names rotary axes.

    Their kind says what X, Y, Z of a program are: "tcp", the tool tip in the part; "indexed", axes of the machine.

    :raises click.UsageError: the kind of the rotary axes is not stated.
    """
    from postproc.jobs import answers

    if options["rotary"] is None:
        return {}
    if options["rotary_kind"] is None:
        raise click.UsageError("Give --rotary-kind tcp or indexed with --rotary.")
    return {"rotary": answers.rotary(options["rotary"], options["rotary_kind"], options["rotary_points"])}


_SAME_OPTIONS = (
    "robot",
    "base",
    "tool",
    "clearance",
    "tool_change",
    "spindle",
    "coolant",
    "part_tolerance",
    "home",
    "payload",
)
"""Options of `init` with the same name as their answer."""


def _answers_of_options(options: dict[str, Any], only_tool: int | None) -> dict[str, Any]:
    """Return the answers that options of `init` give to questions on the cell: key of the question → value.

    :param only_tool: number of the only tool of the programs, whose `$TOOL` in `--tools` also answers for `--tool`;
        None: they have several tools.
    """
    values = {name: options[name] for name in _SAME_OPTIONS if options[name] is not None}
    values |= {f"tool.{number}": frame for number, frame in options["tools"].items()}
    if only_tool in options["tools"]:
        values.setdefault("tool", options["tools"][only_tool])
    values |= {f"work_offset.{code}": frame for code, frame in options["work_offsets"].items()}
    for table in ("base_data", "tool_data"):
        values |= {f"{table}.{number}": frame for number, frame in options[table].items()}
    values |= {f"m_code.{code}": "none" for code in options["m_codes"]}
    values |= {f"rotary_point.{letter}": point for letter, point in options["rotary_points"].items()}
    texts = {
        "rotary_axes": options["rotary"],
        "rotary_kind": options["rotary_kind"],
        "dwell_unit": options["dwell_unit"],
    }
    # the option has a default, which is no answer of the user
    texts |= {"radius_offsets": options["radius_offsets"]} if _is_stated("radius_offsets") else {}
    return values | {name: value for name, value in texts.items() if value is not None}


def _request_for_programs(cell: Path, programs: list[Path], options: dict[str, Any]) -> CellRequest:
    """Return the request for a cell that some programs need; ask on the terminal for answers that no option gives.

    Without a terminal, optional questions are answered by their default.

    :raises click.UsageError: an answer is missing and there is no terminal.
    """
    from msgspec.structs import replace

    from postproc.cli.start import print_needs, prompt
    from postproc.jobs import guided_start
    from postproc.jobs.program_needs import needs_of

    needs_of_programs = [needs_of(program) for program in programs]
    for needs in needs_of_programs:
        print_needs(needs)
        if needs.refusal:
            click.echo(f"no answer makes this program readable: {needs.refusal}", err=True)
    needs = guided_start.merge_needs(needs_of_programs)
    if options["config_dat"] is not None:
        needs = replace(needs, frames=())  # nothing is asked: frames by number are in the file of the controller
    answers = guided_start.Answers(_answers_of_options(options, needs.only_tool))
    unanswered_questions: list[guided_start.Question] = []
    while question := guided_start.next_question(
        needs, answers, {item.key for item in unanswered_questions}, process=False
    ):
        if is_terminal():
            answers.put(question, prompt(question, first=not answers.values))
        elif question.optional and question.default is not None:
            answers.put(question, question.default)
        else:
            unanswered_questions.append(question)
    if unanswered_questions:
        lines = [f"  {question.option}    {question.text}" for question in unanswered_questions]
        raise click.UsageError("\n".join(["Missing, and there is no terminal to ask on:", *lines]))
    cell_options = {name: options[name] for name in ("axis", "start", "config_dat", "overwrite")}
    return guided_start.cell_request(cell, answers, **cell_options)


def _is_stated(name: str) -> bool:
    """Return whether the user gave an option, on the command line or by an environment variable."""
    source = click.get_current_context().get_parameter_source(name)
    return source is not None and source.name not in ("DEFAULT", "DEFAULT_MAP")


def _all_convert(programs: list[Path], cell: Path, language: str) -> bool:
    """Try to convert each program with the cell, without forces and without writing files; print the outcomes.

    Return whether all programs convert.

    :param language: robot language of the controller; empty: KRL.
    """
    from postproc.jobs.guided_start import problems_of

    all_convert = True
    for program in programs:
        problems = problems_of(program, cell, None if language in ("", "krl") else language)
        all_convert = all_convert and not problems
        if problems:
            click.echo("\n  ".join([f"{program.name}: it does not convert yet.", *problems]), err=True)
        else:
            click.echo(f"{program.name}: it converts.")
    return all_convert


def _station(robodk: str, options: dict[str, Any]) -> Station:
    """Return a station of RoboDK; set robot, base, tool and start of `options` from it where the user gave none.

    :param robodk: file of the station; "open": the station that is open.
    """
    from postproc.hosts.robodk_station import read

    station = read(robodk)
    for name, value in (("base", station.base), ("tool", station.tool), ("start", station.start)):
        if options[name] is None:
            options[name] = value
    if options["robot"] is None:
        options["robot"] = station.shipped_model()
    if options["robot"] is None:
        click.echo(f"The robot of the station is {station.robot}: there is no robot model of this name.", err=True)
    return station


def _station_warnings(station: Station, robot: str) -> tuple[str, ...]:
    """Return warnings about a cell that is made from a station.

    :param robot: robot of the cell.
    """
    from postproc.jobs import load_robot

    warning = station.check_flange(load_robot(robot))
    return (*station.remarks, *(() if warning is None else (warning,)))


def _complete_options(options: dict[str, Any]) -> dict[str, Any]:
    """Return `options`, in which missing values are set.

    If robot, base or tool is missing, the user is asked for all missing values; else they get their defaults.

    :raises click.UsageError: robot, base or tool is missing, and there is no terminal.
    """
    from postproc.jobs import answers, first_steps

    absent_names = [name for name in ("robot", "base", "tool") if options[name] is None]
    if absent_names and not is_terminal():
        raise click.UsageError(
            f"Give {', '.join(f'--{name}' for name in absent_names)} (there is no terminal to ask on)."
        )

    def set_option(name: str, text: str, default: Any, kind: str) -> None:
        """Set `options[name]` if it is None: ask the user if robot, base or tool is missing, else take the default.

        :param text: the question.
        :param kind: as of `_option_value`.
        """
        if options[name] is None:
            options[name] = (
                click.prompt(text, default=default, value_proc=partial(_option_value, kind))
                if absent_names
                else _option_value(kind, str(default))
            )

    if absent_names:
        click.echo("Lengths in mm, angles in degrees. Enter takes the value in brackets.")
    if options["robot"] is None:
        from postproc.robot import shipped_models

        click.echo(f"Robots: {', '.join(shipped_models())}")
    set_option("robot", "Robot, or the path of a model folder", "kuka_kr270", "robot")
    if options["base"] is None:
        default_base = ",".join(f"{value:g}" for value in first_steps.usual_base(options["robot"]))
        set_option("base", "$BASE in the robot root: X,Y,Z[,A,B,C]", default_base, "frame")
    set_option("tool", "$TOOL, the tool tip in the flange frame: X,Y,Z[,A,B,C]", "0,0,350", "frame")
    if absent_names:
        _ask_for_program(options)
    set_option(
        "clearance", "Z of $BASE to which programs retract (G28, G30, G53)", f"{first_steps.CLEARANCE_MM:g}", "number"
    )
    text = "Tool change: hand (the program stops), none, or a line that calls the changer, with {T}"
    set_option("tool_change", text, answers.BY_HAND, "line")
    if absent_names:
        _ask_for_shop(options, answers.BY_HAND)
    return options


def _ask_for_program(options: dict[str, Any]) -> None:
    """Ask for tools, work offsets, M codes and start joints of programs that `options` lacks, and set them there.

    An empty answer leaves an option empty.
    """
    if not options["tools"]:
        text = "Tools that programs change to, such as 1=0,0,350 2=0,0,412.5 (empty: $TOOL holds for all)"
        options["tools"] = click.prompt(text, default="", show_default=False, value_proc=_list_parser("tools"))
    if not options["work_offsets"]:
        text = "Work offsets that programs use in addition to G54, such as G55=300,0,0 (empty: none)"
        options["work_offsets"] = click.prompt(
            text, default="", show_default=False, value_proc=_list_parser("work_offsets")
        )
    if not options["m_codes"]:
        text = "M codes that have no effect on the robot, such as M31 M33 (empty: none)"
        options["m_codes"] = click.prompt(
            text,
            default="",
            show_default=False,
            value_proc=lambda text: _option_value("m_codes", text.replace(",", " ").split()),
        )
    if options["start"] is None:
        text = "Joints where programs start: A1,…,A6 (empty: chosen with the tip above the part)"
        options["start"] = (
            click.prompt(text, default="", show_default=False, value_proc=partial(_option_value, "numbers")) or None
        )


def _ask_for_shop(options: dict[str, Any], by_hand: str) -> None:
    """Ask for lines that switch spindle and coolant, and for the tolerance of parts, that `options` lacks.

    Set them there.

    :param by_hand: default answer: the user switches them by hand.
    """
    if options["spindle"] is None:
        text = "Spindle: lines for M3, with {S}, and M5, with | between, or hand"
        options["spindle"] = click.prompt(text, default=by_hand, value_proc=partial(_option_value, "switch"))
    if options["coolant"] is None:
        text = "Coolant: lines for M7 and M8, and for M9, with | between, or hand"
        options["coolant"] = click.prompt(text, default=by_hand, value_proc=partial(_option_value, "switch"))
    if options["part_tolerance"] is None:
        text = "What the part may be off (95 %) (empty: nothing is judged by it)"
        options["part_tolerance"] = click.prompt(
            text, default="", show_default=False, value_proc=partial(_option_value, "tolerance")
        )


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

    paths = copy_samples(folder, overwrite=overwrite)
    click.echo(f"written: {len(paths)} files in {folder}. To try them:")
    program, cell = argument(folder / "pocket.nc"), argument(folder / "cell_kr270.toml")
    click.echo(f"  postproc convert {program} --cell {cell} -o out")
