"""From a program to a cell and a process: the questions that are open, their answers, the files that they make.

`postproc start` and `postproc init PROGRAM` ask the same questions about the cell. Each question depends on the program
(`program_needs.ProgramNeeds`) and on earlier answers, so `next_question` is called again after each answer.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tomli_w
from msgspec import Struct, field

from postproc import files
from postproc import robot as robots
from postproc.cell import Box
from postproc.errors import InputError
from postproc.jobs import answers as parse
from postproc.jobs.answers import BY_HAND, CutterShape, Numbers, box_text
from postproc.jobs.first_steps import (
    CLEARANCE_MM,
    CellRequest,
    relative_path,
    schema_file,
    toml_string,
    usual_base,
    write_cell,
)
from postproc.jobs.program_needs import ProgramNeeds
from postproc.jobs.programs import Settings, find_jobs, load_robot
from postproc.jobs.runs import convert_all
from postproc.machining.material import table
from postproc.machining.process import DEFAULT, StockTable
from postproc.machining.process import load as load_process
from postproc.machining.tool_comments import CommentedTool
from postproc.program import tool_text

_RETRACT_ABOVE_CUTS_MM = 50.0
"""Offered height of retracts above the highest cutting move [mm] (assumed)."""
_CELL_COUNT = 500.0
"""Largest number of cells of the stock map across, within the limits of `_RESOLUTIONS` (assumed)."""
_RESOLUTIONS = (0.25, 1.0)
"""Finest and coarsest cells that are proposed [mm] (assumed)."""
_USUAL_TOOL = "0,0,350"
"""X, Y, Z of a tool tip in the flange frame that is offered [mm] (assumed)."""
MACHINE_QUESTION = "m_code."
"""Beginning of the keys of questions on M codes."""


class Question(Struct, frozen=True):
    """A question to the user.

    :param key: name of the answer, such as ``"robot"``, ``"cutter.3"``.
    :param text: the question.
    :param option: the command-line option that answers it, with an example.
    :param parse: function from the text of an answer to its value; raises `InputError` with what to write instead.
    :param default: text that is offered; None: no text is offered.
    :param optional: whether the default is taken without a terminal.
    :param hint: a line before the question; empty: none.
    """

    key: str
    text: str
    option: str
    parse: Callable[[str], Any]
    default: str | None = None
    optional: bool = False
    hint: str = ""


class Answers(Struct):
    """Answers so far.

    :ivar values: key of a question → value of its answer.
    :ivar offered_keys: keys of questions whose offered text was taken as it is.
    """

    values: dict[str, Any] = field(default_factory=dict)
    offered_keys: set[str] = field(default_factory=set)

    def put(self, question: Question, text: str, *, is_stated: bool = True) -> None:
        """Add the answer to a question.

        :param is_stated: True if the user gave the text; False if it may be the text that was offered.
        :raises InputError: the text is no valid answer.
        """
        self.values[question.key] = question.parse(text)
        if not is_stated and text == question.default:
            self.offered_keys.add(question.key)

    def by_number(self, name: str) -> dict[int, Any]:
        """Return the answers with keys ``name.N``: N → value."""
        return {int(key.partition(".")[2]): value for key, value in self.values.items() if key.startswith(f"{name}.")}

    def by_code(self, name: str) -> dict[str, Any]:
        """Return the answers with keys ``name.CODE``: CODE → value."""
        return {key.partition(".")[2]: value for key, value in self.values.items() if key.startswith(f"{name}.")}


def next_question(
    needs: ProgramNeeds,
    answers: Answers,
    skipped_keys: Collection[str] = (),
    *,
    cell: bool = True,
    process: bool = True,
) -> Question | None:
    """Return the first question that is neither answered nor skipped; None if there is none.

    :param cell: whether to ask for the cell.
    :param process: whether to ask for the process; a program that states its forces needs none.
    """
    questions = [*(_cell_questions(needs, answers) if cell else ())]
    if process and not needs.has_forces:
        questions += _process_questions(needs, answers)
    return next((item for item in questions if item.key not in answers.values and item.key not in skipped_keys), None)


def _cell_questions(needs: ProgramNeeds, answers: Answers) -> Iterator[Question]:
    """Yield the questions whose answers make the cell, in the order in which they are asked.

    Answers so far decide whether later questions are asked, and what they offer.
    """
    yield Question(
        key="robot",
        text="Robot, or the path of a model folder",
        option="--robot kuka_kr270",
        parse=parse.robot,
        default="kuka_kr270",
        hint=f"Robots: {', '.join(robots.shipped_models())}",
    )
    base = _usual_base(answers)
    yield from _frame_questions(needs, base)
    # a robot program that names a frame by number, such as BASE_DATA[3], does not use [base] or [tool] of the cell
    stated_tables = {frame.partition(".")[0] for frame in needs.frames} if needs.is_robot_program else ()
    if "base_data" not in stated_tables:
        yield Question(
            key="base",
            text="$BASE in the robot root: X,Y,Z[,A,B,C]",
            option="--base X,Y,Z",
            parse=parse.full_frame,
            default=base,
        )
    if needs.changes_tools or "tool_data" not in stated_tables:
        yield from _tool_questions(needs)
    for code in needs.work_offsets:
        text = f"{code}, which the program uses, in $BASE: X,Y,Z[,A,B,C]"
        yield Question(
            key=f"work_offset.{code}", text=text, option=f"--work-offset {code}=X,Y,Z", parse=parse.full_frame
        )
    for code in needs.m_codes:
        text = f"{code} of the machine: none if it has no effect on the robot, or the line to write for it"
        yield Question(
            key=MACHINE_QUESTION + code, text=text, option=f"--m-code {code}", parse=parse.line, default=parse.NO_LINES
        )
    yield from _rotary_questions(needs, answers)
    yield from _setting_questions(needs)
    yield from _machine_questions(needs)
    text = "What the part may be off, mm (95 %); empty: nothing is judged by it"
    yield Question(
        key="part_tolerance", text=text, option="--part-tolerance MM", parse=parse.tolerance, default="", optional=True
    )
    if "robot" in answers.values and load_robot(answers.values["robot"]).language == "rapid":
        text = "Spindle, holder and tool on the flange: kg,X,Y,Z of the centre of mass; empty: set in the controller"
        yield Question(
            key="payload", text=text, option="--payload KG,X,Y,Z", parse=parse.payload, default="", optional=True
        )


def _frame_questions(needs: ProgramNeeds, base: str | None) -> Iterator[Question]:
    """Yield the questions on frames that the program names by number, such as ``base_data.3``.

    :param base: place of a part that is offered, ``X,Y,Z`` [mm]; None: no place is offered.
    """
    for frame in needs.frames:
        name, _, number = frame.partition(".")
        place, example = ("robot root", base) if name == "base_data" else ("flange frame", _USUAL_TOOL)
        text = f"{name.upper()}[{number}], which the program uses, in the {place}: X,Y,Z[,A,B,C]"
        option = f"--{name.replace('_', '-')} {number}=X,Y,Z"
        yield Question(key=frame, text=text, option=option, parse=parse.stated_frame, default=example)


def _tool_questions(needs: ProgramNeeds) -> Iterator[Question]:
    """Yield the questions on `$TOOL`: one for each tool if the program changes tools, else a single one."""
    if not needs.changes_tools:
        text = "$TOOL, the tool tip in the flange frame: X,Y,Z[,A,B,C]"
        yield Question(key="tool", text=text, option="--tool X,Y,Z", parse=parse.full_frame, default=_USUAL_TOOL)
        return
    for number in needs.tools:
        yield Question(
            key=f"tool.{number}",
            text=f"$TOOL of T{number}{_comment_text(needs, str(number))}, tip in the flange frame: X,Y,Z[,A,B,C]",
            option=f"--tools {number}=X,Y,Z",
            parse=parse.full_frame,
            default=_USUAL_TOOL,
        )


def _machine_questions(needs: ProgramNeeds) -> Iterator[Question]:
    """Yield the questions on retraction, tool changer, spindle and coolant that the program raises."""
    if not needs.is_robot_program:
        height = CLEARANCE_MM
        if needs.span is not None:
            _, (_, _, highest_cut) = needs.span  # smallest and largest X, Y, Z
            height = max(height, round(highest_cut + _RETRACT_ABOVE_CUTS_MM, -1))  # to whole centimetres
        text = "Z of $BASE to which programs retract (G28, G30, G53)"
        yield Question(
            key="clearance", text=text, option="--clearance Z", parse=parse.number, default=f"{height:g}", optional=True
        )
    if needs.changes_tools:
        text = "Tool change: hand (the program stops), none, or a line that calls the changer, with {T}"
        yield Question(
            key="tool_change", text=text, option="--tool-change LINE", parse=parse.line, default=BY_HAND, optional=True
        )
    for name, codes in (("spindle", "M3, with {S}, and M5"), ("coolant", "M7 and M8, and for M9")):
        if name in needs.switches:
            text = f"{name.capitalize()}: lines for {codes}, with | between, or hand"
            yield Question(
                key=name, text=text, option=f'--{name} "ON|OFF"', parse=parse.switch, default=BY_HAND, optional=True
            )


def _usual_base(answers: Answers) -> str | None:
    """Return a place that the chosen robot reaches well, as ``X,Y,Z`` [mm]; None if no robot was chosen yet."""
    robot = answers.values.get("robot")
    return None if robot is None else ",".join(f"{value:g}" for value in usual_base(robot))


def _comment_text(needs: ProgramNeeds, key: str) -> str:
    """Return what comments of the program say of a tool, in brackets after a blank; empty if they say nothing.

    :param key: key of the tool in [tools] of a process.
    """
    comment = needs.cutter(key).text
    return f" ({comment})" if comment else ""


def _rotary_questions(needs: ProgramNeeds, answers: Answers) -> Iterator[Question]:
    """Yield the questions on rotary axes, if the programs use some."""
    if not needs.rotary:
        return
    default_order = ",".join(letter for letter in "CBA" if letter in needs.rotary)
    text = "Rotary axes from the part outwards"
    yield Question(
        key="rotary_axes",
        text=text,
        option=f"--rotary {default_order}",
        parse=parse.rotary_axes,
        default=default_order,
        optional=len(needs.rotary) == 1,
    )
    text = "X, Y, Z of the program: tcp (tip in the part, tool-centre-point control) or indexed (the part turns)"
    # a program that switches tool-centre-point control on means the tip
    kind = "tcp" if needs.tip_controlled else None
    yield Question(
        key="rotary_kind",
        text=text,
        option="--rotary-kind tcp",
        parse=parse.choice_parser("tcp", "indexed"),
        default=kind,
        optional=needs.tip_controlled,
    )
    if answers.values.get("rotary_kind") == "indexed":
        for letter in answers.values.get("rotary_axes", ()):
            text = f"A point of the rotary axis {letter} in $BASE: X,Y,Z"
            yield Question(
                key=f"rotary_point.{letter}", text=text, option=f"--rotary-point {letter}=X,Y,Z", parse=parse.place
            )


def _setting_questions(needs: ProgramNeeds) -> Iterator[Question]:
    """Yield the questions on settings of the control that the program relies on (`ProgramNeeds.settings`)."""
    if "home" in needs.settings:
        text = "Where X, Y, Z are before the first move and after G28, G53, in $BASE: X,Y,Z"
        yield Question(key="home", text=text, option="--home X,Y,Z", parse=parse.place)
    if "radius_offsets" in needs.settings:
        text = "G41 and G42: does D of the control hold wear only (the path is that of the tool centre)? wear or radius"
        yield Question(
            key="radius_offsets", text=text, option="--radius-offsets wear", parse=parse.choice_parser("wear", "radius")
        )
    if "dwell_unit" in needs.settings:
        text = "P of G4 and of cycles: s (LinuxCNC) or ms (Fanuc, Haas, Mach3)"
        yield Question(key="dwell_unit", text=text, option="--dwell-unit ms", parse=parse.choice_parser("s", "ms"))


def _process_questions(needs: ProgramNeeds, answers: Answers) -> Iterator[Question]:
    """Yield the questions on material, tools and stock, whose answers make the process."""
    yield Question(
        key="material",
        text="Material",
        option="--material NAME",
        parse=parse.material,
        hint=f"Materials: {', '.join(table())}",
    )
    for key in needs.cutter_keys:
        name, prefix = "the tool", ""
        if key != DEFAULT:
            name, prefix = tool_text(key, is_of_robot=bool(needs.robot_tools)), f"{key}="
        comment = needs.cutter(key)
        yield Question(
            key=f"cutter.{key}",
            text=f"Cutter of {name}{_comment_text(needs, key)}: shape and diameter, such as flat,12; bull,12,1; "
            "ball,6; drill,8",
            option=f"--cutter {prefix}flat,12",
            parse=parse.cutter,
            default=_cutter_text(comment),
            optional=_cutter_text(comment) is not None,
        )
        yield Question(
            key=f"flutes.{key}",
            text=f"Cutting edges of {name}",
            option=f"--flutes {prefix}3",
            parse=parse.flutes,
            default=None if comment.flutes is None else str(comment.flutes),
            optional=comment.flutes is not None,
        )
        if not needs.has_speeds:
            text = f"Spindle speed of {name}, 1/min: the program states none"
            yield Question(key=f"rpm.{key}", text=text, option=f"--rpm {prefix}12000", parse=parse.speed)
    box = _stock_guess(needs, answers)
    has_size = needs.stock_mm is not None
    source = "its comments state the size: check the place" if has_size else "around what the tools sweep: check it"
    yield Question(
        key="stock",
        text=f"Stock in $BASE, mm, or the path of an STL ({source})"
        if box
        else "Stock in $BASE, mm, or the path of an STL",
        option="--stock X=0:100,Y=0:80,Z=-20:0",
        parse=parse.stock,
        default=None if box is None else box_text(box),
        optional=box is not None,
    )


def _cutter_text(comment: CommentedTool) -> str | None:
    """Return a cutter as the text that `answers.cutter` reads; None if comments do not state shape and diameter."""
    if comment.shape is None or comment.diameter_mm is None:
        return None
    corner = f",{comment.corner_radius_mm:g}" if comment.shape == "bull" else ""
    return f"{comment.shape},{comment.diameter_mm:g}{corner}"


def _stock_guess(needs: ProgramNeeds, answers: Answers) -> Box | None:
    """Return the stock that comments or the cutting moves suggest, in `$BASE` [mm]; None if nothing is cut."""
    diameters = {key: shape.diameter_mm for key, shape in answers.by_code("cutter").items()}
    return needs.stock_box(diameters)


class StartFiles(Struct, frozen=True):
    """Files that `postproc start` has written or found.

    :param cell: the cell file; `process`: the process file, None: no process is needed.
    :param remarks: remarks on values that the user should check.
    """

    cell: Path
    process: Path | None
    remarks: tuple[str, ...]


def cell_request(output: Path, answers: Answers, **fields: Any) -> CellRequest:
    """Return the request for the cell file that the answers describe; values without an answer get their default.

    :param output: cell file to write.
    :param fields: further fields of the request, such as ``axis``; they replace answers.
    """
    values = answers.values
    tools, bases = answers.by_number("tool"), answers.by_number("base_data")
    first_tools: dict[int, Numbers] = {**tools, **(tool_data := answers.by_number("tool_data"))}
    # [tool] and [base] of the cell are required: without an answer they are the first numbered frame
    request: dict[str, Any] = {
        "tool": values["tool"] if "tool" in values else next(iter(first_tools.values())),
        "tools": tools,
        "base_data": bases,
        "tool_data": tool_data,
        "work_offsets": answers.by_code("work_offset"),
        "m_codes": {code: [] if text == parse.NO_LINES else [text] for code, text in answers.by_code("m_code").items()},
    }
    if bases:
        request["base"] = next(iter(bases.values()))
    names = ("robot", "base", "clearance", "tool_change", "spindle", "coolant", "part_tolerance", "home", "payload")
    request |= {name: values[name] for name in (*names, "radius_offsets", "dwell_unit") if name in values}
    if "rotary_axes" in values:
        points = answers.by_code("rotary_point")
        request["rotary"] = parse.rotary(values["rotary_axes"], values["rotary_kind"], points)
    return CellRequest(output=output, **(request | fields))


def write_process(path: Path, needs: ProgramNeeds, answers: Answers) -> tuple[str, ...]:
    """Write a process file with comments, and read it back.

    :returns: remarks on values that the user should check.
    :raises InputError: it cannot be written, or a value is invalid.
    """
    stock: StockTable = answers.values["stock"]
    is_assumed = stock.box is not None and "stock" in answers.offered_keys
    lines = [*process_head(needs, answers.values["material"])]
    for key, shape in answers.by_code("cutter").items():
        lines += ["", *_tool_lines(key, shape, needs, answers)]
    lines += ["", *stock_lines(path.parent, stock, is_assumed=is_assumed)]
    files.write_whole(path.parent, {path.name: ("\n".join(lines) + "\n").encode()})
    load_process(path)
    if is_assumed:
        source = (
            "what the tools sweep"
            if needs.stock_mm is None
            else "its size in comments, in the middle of what the tools sweep"
        )
        return (f"{path.name}: the stock is assumed from {source}. Check it: forces depend on it.",)
    return ()


def process_head(needs: ProgramNeeds, material: str | None) -> Iterator[str]:
    """Yield the first lines of a process file, up to its material.

    :param material: name of the material; None: the line is left out.
    """
    yield f"#:schema {schema_file('process').as_uri()}"
    yield f"# Process of {needs.file.name} for postproc: mm, 1/min. docs/reference/forces.md describes every key."
    yield "[material]"
    if material is not None:
        yield f"name = {toml_string(material)}    # postproc forces --materials lists them, with sources"


def tool_head(key: str, needs: ProgramNeeds) -> str:
    """Return the first line of the table of a tool in a process file, with comments of the program on the tool.

    :param key: key of the tool in [tools].
    """
    comment = needs.cutter(key).text
    remark = f"    # {' '.join(comment.split())}" if comment.isprintable() and comment else ""
    return f"[tools.{key if key.isascii() else toml_string(key)}]{remark}"


def _tool_lines(key: str, shape: CutterShape, needs: ProgramNeeds, answers: Answers) -> Iterator[str]:
    """Yield the lines of a tool in the process file."""
    yield tool_head(key, needs)
    yield f'shape = "{shape.shape}"'
    yield f"diameter_mm = {shape.diameter_mm:g}"
    if shape.shape == "bull":
        yield f"corner_radius_mm = {shape.corner_radius_mm:g}"
    yield f"flutes = {answers.values[f'flutes.{key}']}"
    if f"rpm.{key}" in answers.values:
        yield f"rpm = {answers.values[f'rpm.{key}']:g}"


def stock_lines(folder: Path, stock: StockTable, *, is_assumed: bool) -> Iterator[str]:
    """Yield the lines of `[stock]` in a process file.

    :param folder: folder of the process file, from which the path of a mesh is relative.
    :param is_assumed: whether the stock was guessed from the program; a line says so.
    """
    yield "[stock]                          # before this program"
    if is_assumed:
        yield "assumed = true                   # from what the tools sweep: check it, then remove this line"
    if stock.box is None:
        yield f"file = {toml_string(relative_path(folder, Path(stock.file or '')))}    # closed mesh, mm, in $BASE"
        return
    spans = {axis: getattr(stock.box, axis) for axis in "XYZ"}
    yield "box = { " + ", ".join(f"{axis} = [{low:g}, {high:g}]" for axis, (low, high) in spans.items()) + " }"
    largest_span, (finest, coarsest) = max(high - low for low, high in spans.values()), _RESOLUTIONS
    yield f"resolution_mm = {min(max(largest_span / _CELL_COUNT, finest), coarsest):.2g}"


class AnswerFile(Struct, forbid_unknown_fields=True):
    """Content of NAME.answers.toml.

    :param program: SHA-256 of the program that the answers are for.
    :param answers: key of the question → text of the answer.
    :param written: name of each file made from the answers → SHA-256.
    """

    program: str = ""
    answers: dict[str, str] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)


_TEXT_DEPENDENT_KEYS = ("cutter.", "flutes.", "rpm.", "stock", "home")
"""Beginnings of the keys of answers that may be wrong for another text of the program."""


def load_answers(path: Path, program: Path) -> AnswerFile:
    """Return the answers of an earlier start; without answers if the file does not exist.

    Answers that depend on the text of the program are left out if it has changed since.

    :raises InputError: the file cannot be read.
    """
    if not path.is_file():
        return AnswerFile(program=sum_of(program))
    content = files.read_toml(path, AnswerFile, InputError)
    if content.program != sum_of(program):
        content.answers = {
            key: text for key, text in content.answers.items() if not key.startswith(_TEXT_DEPENDENT_KEYS)
        }
        content.program = sum_of(program)
    return content


def save_answers(path: Path, content: AnswerFile) -> None:
    """Write answers, so that an interrupted start goes on with them."""
    head = "# Answers of `postproc start`: remove a line to be asked again.\n"
    data = {"program": content.program, "answers": content.answers, "written": content.written}
    files.write_whole(path.parent, {path.name: (head + tomli_w.dumps(data)).encode()})


def sum_of(path: Path) -> str:
    """Return the SHA-256 of a file; an empty text if it does not exist."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def is_edited(path: Path, content: AnswerFile) -> bool:
    """Return whether a file exists and was not written from the answers, or was edited afterwards."""
    return path.exists() and content.written.get(path.name) != sum_of(path)


def write_files(
    needs: ProgramNeeds,
    answers: Answers,
    answer_file: AnswerFile,
    *,
    cell: Path,
    process: Path | None,
    keep_cell: bool,
    keep_process: bool,
    **fields: Any,
) -> StartFiles:
    """Write cell file and process file from the answers.

    :param answer_file: the checksums of the written files are added to it.
    :param cell: cell file to write.
    :param process: process file to write; None: no process is needed.
    :param keep_cell: leave the cell file as it is; `keep_process`: leave the process file as it is.
    :param fields: further fields of `CellRequest`.
    """
    remarks: tuple[str, ...] = ()
    if not keep_cell:
        remarks += write_cell(cell_request(cell, answers, overwrite=True, **fields))
        answer_file.written[cell.name] = sum_of(cell)
    if process is not None and not keep_process:
        remarks += write_process(process, needs, answers)
        answer_file.written[process.name] = sum_of(process)
    return StartFiles(cell, process, remarks)


def merge_needs(programs: list[ProgramNeeds]) -> ProgramNeeds:
    """Return what several programs need together, for one cell and one process.

    File and dialect are those of the first program that is not a robot program, else of the first. Lists are joined.
    Forces and speeds count as stated only if all programs state them. The cutter of a number is that of the first
    program with it.
    """
    first = next((program for program in programs if not program.is_robot_program), programs[0])
    spans = [program.span for program in programs if program.span is not None]
    span: Any = None
    if spans:
        low_corners, high_corners = zip(*spans, strict=True)
        span = (
            tuple(min(values) for values in zip(*low_corners, strict=True)),
            tuple(max(values) for values in zip(*high_corners, strict=True)),
        )
    union: dict[str, Any] = {
        name: tuple(dict.fromkeys(value for program in programs for value in getattr(program, name)))
        for name in ("tools", "work_offsets", "frames", "m_codes", "rotary", "settings")
    }
    return ProgramNeeds(
        first.file,
        first.dialect,
        cutters={number: cutter for program in reversed(programs) for number, cutter in program.cutters.items()},
        tip_controlled=all(program.tip_controlled for program in programs if program.rotary),
        switches=frozenset().union(*(program.switches for program in programs)),
        has_forces=all(program.has_forces for program in programs),
        has_speeds=all(program.has_speeds for program in programs),
        span=span,
        **union,
    )


def problems_of(program: Path, cell: Path, to: str | None) -> list[str]:
    """Return the problems that stop the conversion of a program without a process; empty if it can be converted.

    It is converted into a temporary folder.

    :param to: language to write; None: that of the program, or KRL.
    """
    with TemporaryDirectory() as folder:
        jobs = find_jobs([str(program)], output=Path(folder), to=to)
        (outcome,) = convert_all(jobs, Settings(cell=cell))  # one program
    if outcome.summary is not None:
        return []
    issues = [
        f"line {issue.source_line}: {issue.message}" if issue.source_line else issue.message
        for issue in outcome.issues
        if issue.level == "error"
    ]
    return issues or [outcome.message]
