"""`postproc start`: from a program to a corrected one, by questions or by options."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from postproc.cli.asking import is_terminal
from postproc.cli.options import complete_files, complete_robots

if TYPE_CHECKING:
    from postproc.jobs import Outcome
    from postproc.jobs.guided_start import Answers, Question
    from postproc.jobs.program_needs import ProgramNeeds

_PATH = click.Path(path_type=Path)
_ANSWER_NAMES = {"rotary": "rotary_axes"}
"""Option → name of its answer, if it has another name."""
_NUMBERED_OPTIONS = {"tools": "tool", "work_offset": "work_offset", "base_data": "base_data",
             "tool_data": "tool_data", "m_code": "m_code", "rotary_point": "rotary_point",
             "cutter": "cutter", "flutes": "flutes", "rpm": "rpm"}  # fmt: skip
"""Options that may be repeated: option → first part of the names of its answers, such as "tool" of "tool.3"."""
_PROCESS_ANSWERS = ("material", "cutter", "flutes", "rpm", "stock")
"""First parts of the names of answers that are about the process file; all others are about the cell file."""


@click.command()
@click.argument("program", type=_PATH, shell_complete=complete_files)
@click.option("-o", "--output", type=_PATH, help="Folder to write into; default: corrected/ next to the program.")
@click.option("--cell", "cell_file", type=_PATH, help="Cell file that is there: nothing is asked about the cell.")
@click.option("--process", "process_file", type=_PATH, help="Process file that is there: nothing is asked about it.")
@click.option("--forces", type=_PATH, help="File of cutting forces, instead of a process.")
@click.option("--robot", shell_complete=complete_robots, help="Robot: a name of `postproc robots`, or a model folder.")
@click.option("--base", metavar="X,Y,Z[,A,B,C]", help="$BASE in the robot root.")
@click.option("--tool", metavar="X,Y,Z[,A,B,C]", help="$TOOL in the flange frame.")
@click.option("--tools", multiple=True, metavar="N=X,Y,Z", help="$TOOL of tool N; once for each that is changed to.")
@click.option("--work-offset", multiple=True, metavar="G55=X,Y,Z", help="Frame of a work offset in $BASE.")
@click.option("--base-data", multiple=True, metavar="N=X,Y,Z", help="BASE_DATA[N], which a KRL program names.")
@click.option("--tool-data", multiple=True, metavar="N=X,Y,Z", help="TOOL_DATA[N], likewise.")
@click.option("--m-code", multiple=True, metavar="M31[=LINE]", help="M code: without effect, or the line to write.")
@click.option("--rotary", metavar="C,B", help="Rotary axes from the part outwards.")
@click.option("--rotary-kind", metavar="KIND", help="What X, Y, Z are: tcp or indexed.")
@click.option("--rotary-point", multiple=True, metavar="A=X,Y,Z", help="A point of an indexed axis in $BASE.")
@click.option("--home", metavar="X,Y,Z", help="Where X, Y, Z are before the first move and after G28, G53.")
@click.option("--radius-offsets", metavar="WEAR", help="What D of G41 and G42 holds: wear or radius.")
@click.option("--dwell-unit", metavar="UNIT", help="P of G4 and of cycles: s or ms.")
@click.option("--clearance", metavar="Z", help="Z of $BASE to which G28, G30 and G53 retract.")
@click.option("--tool-change", metavar="LINE", help="Line for M6, with {T}; hand or none. Default: hand.")
@click.option("--spindle", metavar="ON|OFF", help="Lines for M3, with {S}, and M5; default: hand.")
@click.option("--coolant", metavar="ON|OFF", help="Lines for M7 and M8, and for M9; default: hand.")
@click.option("--part-tolerance", metavar="MM", help="What the part may be off (95 %); default: not judged.")
@click.option("--payload", metavar="KG,X,Y,Z", help="Mass on the flange and its centre; RAPID: load of the tool.")
@click.option("--material", metavar="NAME", help="Material: a name of `postproc forces --materials`.")
@click.option("--cutter", multiple=True, metavar="[N=]SHAPE,D[,R]", help="Cutter: flat,12; ball,6; bull,12,1; drill,8.")
@click.option("--flutes", multiple=True, metavar="[N=]COUNT", help="Cutting edges, of tool N (3, tMill) or of all.")
@click.option("--rpm", multiple=True, metavar="[N=]RPM", help="Spindle speed where the program states none.")
@click.option("--stock", metavar="BOX|STL", help="Stock: X=0:100,Y=0:80,Z=-20:0 in $BASE, or a mesh.")
@click.option("--to", metavar="NAME", help="Language to write; default: that of the robot.")
@click.option("--no-open", is_flag=True, help="Do not open the report.")
@click.option("--overwrite", is_flag=True, help="Replace a cell and a process that were edited, and results.")
@click.pass_context
def start(ctx: click.Context, /, program: Path, output: Path | None, no_open: bool, **options: Any) -> None:
    """Correct a first program, and ask for what is missing.

    Tools, work offsets, spindle speeds and M codes are read from the program and from the comments of the CAM system.
    Each answer is checked at once and kept in NAME.answers.toml: an interrupted start goes on where it was. Writes a
    cell and a process file with comments, next to the results. Without a terminal all answers are options, and what
    is missing is listed.

    \b
    Examples:
      postproc start part.nc
      postproc start part.nc --robot kuka_kr270 --base 1500,0,700 --tool 0,0,350 --material al_7075_hss --flutes 3
    """  # noqa: D301 - click: keep these lines as they are
    from postproc.dialects import registry
    from postproc.jobs.guided_start import Answers, is_edited, load_answers, write_files
    from postproc.jobs.program_needs import needs_of

    needs = needs_of(program)
    print_needs(needs)
    if needs.refusal:
        raise click.ClickException(f"{needs.refusal}\nNo answer makes this program readable: nothing was asked.")
    folder = program.parent / "corrected" if output is None else output
    name = registry.program_name(program)
    answers_path = folder / f"{name}.answers.toml"
    answer_file = load_answers(answers_path, program)
    own_cell, own_process = folder / "cell.toml", folder / f"{name}.process.toml"  # files that this command writes
    # files that the user names, and own files that the user has edited, are used as they are
    edited_files = [
        path for path in (own_cell, own_process) if is_edited(path, answer_file) and not options["overwrite"]
    ]
    cell, process = options["cell_file"], options["process_file"] or options["forces"]
    keep_cell = cell is not None or own_cell in edited_files
    cell = cell or own_cell
    keep_process = process is not None or own_process in edited_files
    if process is None and (keep_process or not needs.has_forces):
        process = own_process
    for path in (cell, process):
        if path in edited_files:
            click.echo(f"{path} is used as it is.")
    answers = Answers()
    kept_files = [file for file, is_kept in (("cell", keep_cell), ("process", keep_process)) if is_kept]
    is_asked = {"cell": not keep_cell, "process": not keep_process and process is not None}
    option_texts = _option_answers(options, needs)
    _collect_answers(needs, answers, answer_file, answers_path, option_texts, is_asked=is_asked, kept_files=kept_files)
    files = write_files(
        needs, answers, answer_file, cell=cell, process=process, keep_cell=keep_cell, keep_process=keep_process
    )
    _save_answers(answers_path, answer_file)
    for remark in files.remarks:
        click.echo(f"warning: {remark}", err=True)
    outcome = _convert_and_print(ctx, program, folder, files.cell, files.process, options)
    _offer_place(outcome, program, files.cell, files.process)
    if outcome.written_files:
        program_name = Path(outcome.written_files[0]).name.partition(".")[0]
        page = folder / f"{program_name}.report.html"
        if page.is_file() and not no_open and sys.stdout.isatty():
            click.launch(str(page))
    ctx.exit(outcome.code)


def print_needs(needs: ProgramNeeds) -> None:
    """Print the tools, frames, axes and codes that a program names, and the span of its cuts."""
    parts = [
        f"T{number}" + (f" ({cutter.text})" if (cutter := needs.cutters.get(number)) else "") for number in needs.tools
    ]
    facts = [f"tools: {', '.join(parts)}"] if parts else []
    facts += [f"work offsets: G54, {', '.join(needs.work_offsets)}"] if needs.work_offsets else []
    facts += [f"frames by number: {', '.join(map(_frame_name, needs.frames))}"] if needs.frames else []
    facts += [f"rotary axes: {', '.join(needs.rotary)}"] if needs.rotary else []
    facts += [f"M codes of the machine: {', '.join(needs.m_codes)}"] if needs.m_codes else []
    facts += ["cutting forces in comments"] if needs.has_forces else []
    if needs.span is not None:
        spans = (f"{axis} {low:g} to {high:g}" for axis, low, high in zip("XYZ", *needs.span, strict=True))
        facts.append(f"cuts {', '.join(spans)} mm")
    click.echo("\n  ".join([f"{needs.file.name}:", *facts]))


def _frame_name(table: str) -> str:
    """Return the KRL name of a frame from the name of its table in the cell: BASE_DATA[3] for base_data.3."""
    name, _, number = table.upper().partition(".")
    return f"{name}[{number}]"


def _option_answers(options: Mapping[str, Any], needs: ProgramNeeds) -> dict[str, str]:
    """Return the answers that options give: name of the answer → text.

    `--tools` for the only tool of the program is the answer to the question for `$TOOL`, unless `--tool` is given.
    """
    # --to is an option of the conversion, not an answer
    texts = {
        _ANSWER_NAMES.get(name, name): value
        for name, value in options.items()
        if isinstance(value, str) and name != "to"
    }
    for option, name in _NUMBERED_OPTIONS.items():
        for text in options[option]:
            texts |= dict(_answers_of_option(option, name, text, needs))
    only_tool = f"tool.{needs.only_tool}"
    if only_tool in texts and "tool" not in texts:
        texts["tool"] = texts.pop(only_tool)
    return texts


def _answers_of_option(option: str, name: str, text: str, needs: ProgramNeeds) -> Iterator[tuple[str, str]]:
    """Yield names and texts of the answers that an option gives.

    `KEY=VALUE` is the answer for one tool, axis or code. `VALUE` alone of a process option is the answer for all tools;
    of `--tools` a value without commas is the Z of `$TOOL`. `--m-code CODE` alone means that the code has no effect.

    :param option: name of the option, `name` the first part of the names of its answers, `text` the text of the option.
    :raises click.BadParameter: the option needs a key.
    """
    key, equals, value = text.partition("=")
    key = key.strip().upper()
    tool_names = {tool_name.upper(): tool_name for tool_name in needs.robot_tools}  # tools of robot programs have names
    if option == "m_code":
        yield f"{name}.{key}", value or "none"
    elif not equals and option in _PROCESS_ANSWERS:
        for tool in needs.cutter_keys:
            yield f"{name}.{tool}", text
    elif not equals:
        raise click.BadParameter(f"{text!r}: write NAME=VALUE.", param_hint=f"--{option.replace('_', '-')}")
    else:
        if option in _PROCESS_ANSWERS and key in tool_names:
            key = tool_names[key]
        elif option in ("tools", *_PROCESS_ANSWERS):
            key = key.removeprefix("T")
        yield f"{name}.{key}", f"0,0,{value}" if option == "tools" and "," not in value else value


def _collect_answers(
    needs: ProgramNeeds,
    answers: Answers,
    answer_file: Any,
    answers_path: Path,
    option_texts: Mapping[str, str],
    *,
    is_asked: Mapping[str, bool],
    kept_files: Collection[str],
) -> None:
    """Put the answers to all questions into `answers`: from options, from an earlier start, or from the terminal.

    Answers of the user are saved at once. Without a terminal, optional questions are answered by their default.

    :param answer_file: answers of an earlier start; answers of the user are added to it.
    :param option_texts: answers given by options: name → text.
    :param is_asked: "cell" and "process" → whether questions about this file are asked.
    :param kept_files: "cell" and "process" if these files are used as they are.
    :raises click.UsageError: an answer is missing and there is no terminal, or an answer cannot be used.
    """
    from postproc.errors import InputError
    from postproc.jobs.guided_start import next_question

    on_terminal = is_terminal()
    unanswered: list[Question] = []
    question_keys: set[str] = set()
    while question := next_question(needs, answers, {item.key for item in unanswered}, **is_asked):
        question_keys.add(question.key)
        text = option_texts.get(question.key, answer_file.answers.get(question.key))
        if text is None and on_terminal:
            text = prompt(question, first=not answers.values)
        elif text is None and question.optional and question.default is not None:
            text = question.default
        if text is None:
            unanswered.append(question)
            continue
        try:
            answers.put(question, text, is_stated=question.key in option_texts or question.key in answer_file.answers)
        except InputError as cause:
            source = question.option.split()[0] if question.key in option_texts else str(answers_path)
            raise click.BadParameter(str(cause), param_hint=source) from None
        # a stock that was only offered, and not checked by the user, is not saved
        is_unchecked_stock = question.key == "stock" and "stock" in answers.offered_keys
        if (on_terminal and not is_unchecked_stock) or question.key in option_texts:
            answer_file.answers[question.key] = text
            _save_answers(answers_path, answer_file)
    _report_unused(option_texts, option_texts.keys() - question_keys, answer_file, kept_files)
    if unanswered:
        lines = [f"  {item.option}    {item.text}" for item in unanswered]
        raise click.UsageError("\n".join(["Missing, and there is no terminal to ask on:", *lines]))


def _report_unused(
    option_texts: Mapping[str, str], unused_names: set[str], answer_file: Any, kept_files: Collection[str]
) -> None:
    """Print a note on each answer of an option that no question needed.

    :param option_texts: all answers given by options: name → text.
    :param unused_names: names of the answers without a question.
    :param kept_files: "cell" and "process" if these files are used as they are.
    :raises click.UsageError: an answer contradicts the one from which a kept file was made.
    """
    for file in kept_files:
        names = {name for name in unused_names if _file_of(name) == file}
        if conflicting_names := sorted(name for name in names if option_texts[name] != answer_file.answers.get(name)):
            problem = (
                f"{', '.join(conflicting_names)}: the {file} file is used as it is, and these answers would not count"
            )
            raise click.UsageError(f"{problem}. Leave them out, or give --overwrite to write the file anew.")
        unused_names = unused_names - names  # the file was made from these answers, and edited since
    for name in sorted(unused_names):
        click.echo(f"note: this program needs no answer about {name}: it is not used", err=True)


def _file_of(name: str) -> str:
    """Return the file that an answer is for, "cell" or "process".

    :param name: name of the answer, such as "cutter.3".
    """
    return "process" if name.partition(".")[0] in _PROCESS_ANSWERS else "cell"


def _save_answers(path: Path, answer_file: Any) -> None:
    """Write the answers to a file; its folder is created if needed."""
    from postproc.jobs.guided_start import save_answers

    path.parent.mkdir(parents=True, exist_ok=True)
    save_answers(path, answer_file)


def prompt(question: Question, *, first: bool) -> str:
    """Ask a question on the terminal until the answer can be used; return the text of the answer.

    :param first: it is the first question: explain units and keys before it.
    """
    if first:
        click.echo("Lengths in mm, angles in degrees. Enter takes the value in brackets. Ctrl-C keeps the answers.")
    if question.hint:
        click.echo(question.hint)
    answer: str = click.prompt(
        question.text,
        default=question.default,
        show_default=bool(question.default),
        value_proc=_prompt_check(question.parse),
    )
    return answer


def _prompt_check(parse: Callable[[str], Any]) -> Callable[[str], str]:
    """Return a function that returns a text unchanged if `parse` accepts it, and else makes click ask again."""
    from postproc.errors import InputError

    def check(text: str) -> str:
        """Return the text of an answer.

        :raises click.BadParameter: the text cannot be used; click then asks again.
        """
        try:
            parse(text)
        except InputError as cause:
            raise click.BadParameter(str(cause)) from None
        return text

    return check


def _convert_and_print(
    ctx: click.Context, program: Path, folder: Path, cell: Path, process: Path | None, options: Mapping[str, Any]
) -> Outcome:
    """Convert the program, print its summary or the reason of its failure, and return the outcome.

    :param folder: output folder.
    :param process: process file or file of forces; None: no forces.
    :param options: options of `start`.
    """
    from postproc.cli.outcomes import run_jobs
    from postproc.jobs import Settings, find_jobs
    from postproc.jobs.programs import load_setup

    language = load_setup(Settings(cell=cell))[1].language
    to = options["to"] or (language if language not in ("", "krl") else None)
    jobs = find_jobs([str(program)], forces=process, output=folder, to=to)
    settings = Settings(cell=cell, overwrite=options["overwrite"])
    (outcome,) = run_jobs(ctx, jobs, settings, as_json=False)
    return outcome


def _offer_place(outcome: Outcome, program: Path, cell: Path, process: Path | None) -> None:
    """Offer to search another place of the part if that may help: print the command, and run it if the user agrees.

    :param process: process file or file of forces; None: no forces.
    """
    from postproc.errors import argument

    if (reason := _reason_to_search_place(outcome)) is None:
        return
    folder = cell.parent / "place"
    is_process = process is not None and process.suffix.lower() == ".toml"
    option = "--process" if is_process else "--forces"
    forces = "" if process is None else f" {option} {argument(process)}"
    command = f"postproc place {argument(program)} --cell {argument(cell)}{forces} -o {argument(folder)}"
    click.echo(f"{reason}: another place of the part may help.\n  {command}")
    if not is_terminal() or not click.confirm("Look for one now?", default=False):
        return
    from postproc.jobs.place_files import PlaceRequest, make_place
    from postproc.report import placement

    request = PlaceRequest(
        programs=(str(program),),
        cell=cell,
        output=folder,
        forces=None if is_process else process,
        process=process if is_process else None,
        overwrite=True,
    )
    files = make_place(request)
    click.echo(placement.as_text(files.summary))
    if files.summary.best is not None:
        click.echo(f"Put the frames of {folder / 'place.toml'} into {cell}, and run start again.")


_PLACE_ISSUES = ("joint-limit", "joint-speed", "singular", "reach", "branch", "collision")
"""Beginnings of the kinds of issues that another place of the part may avoid."""


def _reason_to_search_place(outcome: Outcome) -> str | None:
    """Return the problem that another place of the part may solve, as a clause; None without such a problem."""
    issues = outcome.issues if outcome.summary is None else outcome.summary.issues
    if any(issue.kind.startswith(_PLACE_ISSUES) and issue.level != "info" for issue in issues):
        return "The robot is near a limit here"
    verdict = None if outcome.summary is None else outcome.summary.verdict
    if verdict is not None and verdict.tolerance is not None and not verdict.tolerance.held:
        return "The tolerance is not held"
    return None
