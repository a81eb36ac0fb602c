"""The pages of the window: results of jobs as HTML, in the style of the reports."""

from __future__ import annotations

import json
import secrets
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

import msgspec
from jinja2 import Environment, PackageLoader, StrictUndefined
from msgspec import Struct
from msgspec.structs import replace

from postproc import actions, robot
from postproc.app.arm_view import arm_view
from postproc.app.models import identify_arguments
from postproc.app.runs import Run, command_line
from postproc.app.testpart import SENT_FILES as PART_FILES
from postproc.app.testpart import TestPart
from postproc.app.workspace import MEDIA_TYPES, RESULTS, Item, Workspace
from postproc.dialects import registry
from postproc.errors import InputError, PostprocError
from postproc.jobs.cell_edit import FRAMES, feed_rule, frame_tables, robot_name, table_help, uses_model
from postproc.jobs.cell_picture import cell_picture
from postproc.jobs.experiments import Readings, model_of
from postproc.jobs.file_form import FormField
from postproc.jobs.probing_list import probing_list
from postproc.jobs.process_edit import ProcessTable
from postproc.jobs.setup_form import Field, SetupForm
from postproc.machining.material import table
from postproc.report.answers import chance_in_words
from postproc.report.formatting import two_digit_text
from postproc.report.verdict import ASSUMED_STOCK, STOCK_REMARK

FORM_OPTIONS = tuple(option for option in actions.CONVERSION if option.label)
"""Options of `convert` that the form of a program has."""
_FRAME_KEYS = ("base", "tool", "work_offset", "base_data", "tool_data")
"""Questions whose answer is a frame: first parts of their keys."""
_NUMBER_KEYS = ("flutes", "rpm", "clearance", "part_tolerance")
"""Questions whose answer is a number."""
_CHOICES = {
    "rotary_kind": ("tcp", "indexed"),
    "radius_offsets": ("radius", "wear"),
    "dwell_unit": ("s", "ms"),
    "cutter": ("flat", "ball", "bull", "drill"),
}
"""Question → words to choose from."""
_STATE_TEXTS = {"ok": "Yes", "warning": "Look first", "no forces": "No forces", "failed": "No"}
"""State of a result → answer to the question whether the program may be run."""
_STATE_KINDS = {"ok": "good", "warning": "warning", "no forces": "warning", "failed": "error"}
"""State of a result → style of this answer."""


class Page(Struct, frozen=True):
    """A page as HTML, and the nonce of its script: the number by which the browser knows that it may run."""

    html: bytes
    nonce: str


@cache
def _environment() -> Environment:
    """Return the environment of the templates; it contains the style and the script of all pages."""
    environment = Environment(
        autoescape=True,
        loader=PackageLoader("postproc.app"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    root = Path(__file__).parent
    style = root.parent / "report" / "kit" / "templates" / "style.css"
    environment.globals["style"] = "".join(
        path.read_text(encoding="utf-8") for path in (style, root / "templates" / "app.css")
    )
    environment.globals["script"] = (root / "templates" / "app.js").read_text(encoding="utf-8")
    return environment


def _page(template: str, **context: Any) -> Page:
    """Return the page of a template, with a new random nonce for its script.

    :param context: values that the template uses.
    """
    nonce = secrets.token_urlsafe(16)
    html = _environment().get_template(template).render(nonce=nonce, **context)
    return Page(html.encode(errors="replace"), nonce)


def result_texts(item: Item) -> dict[str, Any]:
    """Return what the templates show of the result of a program: name → text.

    `run` says whether the program may be run, `kind` is the style of that text. Without a result, or with a name that
    the window cannot use, there are only `state`, `run`, `kind`, `headline` and `reasons`.
    """
    content = None if item.entry is None else item.entry.content
    if item.name_fault:
        problem = f"Rename it: {item.name_fault}"
        return {"state": "unusable name", "run": problem, "kind": "error", "headline": "", "reasons": []}
    if item.entry is None or content is None:
        return {"state": "new", "run": "Not corrected yet", "kind": "soft", "headline": "", "reasons": []}
    uncorrected_text, corrected_text = (
        "unknown" if length is None else f"{two_digit_text(length)} mm" for length in content.expected_mm
    )
    better, state = content.verdict.better, item.entry.state
    return {
        "state": state if item.is_current else "changed",
        "run": _STATE_TEXTS.get(state, state) if item.is_current else "Changed since: correct it again",
        "changes": ", ".join(item.changes),
        "kind": _STATE_KINDS.get(state, "") if item.is_current else "warning",
        "headline": content.verdict.headline,
        "remark": STOCK_REMARK if any(issue.kind == ASSUMED_STOCK for issue in content.issues) else "",
        "reasons": content.verdict.reasons,
        "uncorrected": uncorrected_text,
        "corrected": corrected_text,
        "better": "unknown" if better is None or better.chance is None else f"chance {chance_in_words(better.chance)}",
        "tolerance": "" if content.verdict.tolerance is None else f"{content.verdict.tolerance.mm:g} mm",
    }


class Row(Struct, frozen=True):
    """A program of the list.

    :param run: latest command about the program; None: there was none.
    :param waits_for: input that is not stated yet; empty: the program can be corrected.
    """

    item: Item
    run: Run | None
    waits_for: str


def programs_page(workspace: Workspace, programs: Sequence[Row], stamp: str, *, is_automatic: bool) -> Page:
    """Return the page of all programs.

    :param programs: rows of the list, in order.
    :param stamp: text that changes when the content of the page changes.
    :param is_automatic: programs are corrected as they arrive.
    """
    rows = [
        {
            "name": row.item.name,
            **result_texts(row.item),
            "active": row.run if row.run is not None and row.run.is_running else None,
            "failure": row.run if row.run is not None and not row.item.is_current and row.run.is_failure else None,
            "waits_for": row.waits_for,
        }
        for row in programs
    ]
    return _page(
        "programs.html",
        here="programs",
        title=workspace.folder.name or str(workspace.folder),
        rows=rows,
        stamp=stamp,
        is_automatic=is_automatic,
        open_row=next((row for row in rows if row["state"] in ("new", "changed") and row["active"] is None), None),
        command=command_line(["watch", ".", "--cell", f"{RESULTS}/cell.toml", "--serve"])
        if workspace.cell.is_file()
        else "",
        has_cell=workspace.cell.is_file(),
    )


def _control_values(field: Field) -> dict[str, Any]:
    """Return the controls of a question as values for the template; `kind` says which it shows.

    Kinds are: frame, cutter, box (of the stock), number, choice, and text, a line for anything else.
    """
    # the key of a question is such as "tool.3"
    question, kind = field.question, field.question.key.partition(".")[0]
    control = {"key": question.key, "text": question.text, "fault": field.fault, "value": field.text}
    control["id"], control["hint"] = question.key.replace(".", "-"), ""
    example = "" if question.optional else question.default or ""
    if kind in _FRAME_KEYS:
        if example:
            pairs = zip("XYZABC", example.split(","), strict=False)  # A, B, C may be missing
            control["hint"] = f"for example {', '.join(' '.join(pair) for pair in pairs)}"
        words = [word.strip() for word in field.text.split(",")] if field.text else []
        values = list(zip("XYZABC", [*words, *[""] * 6][:6], strict=True))  # numbers not given are empty
        return {**control, "kind": "frame", "values": values, "text": question.text.partition(": X,Y")[0]}
    if kind == "cutter":
        sizes = [*field.text.replace(",", " ").split(), "", "", ""][:3]  # shape, diameter, corner radius
        title = question.text.partition(": shape")[0]
        return {**control, "kind": "cutter", "values": sizes, "choices": _choices(kind), "text": title}
    if kind == "stock" and (spans := _spans(field.text)) is not None:
        control["text"] = "Stock before the program, in $BASE"
        return {**control, "kind": "box", "spans": spans, "is_guess": field.is_guess, "is_checked": field.is_checked}
    if kind in _NUMBER_KEYS:
        return {**control, "kind": "number"}
    choices = _choices(kind)
    if not choices:
        return {**control, "kind": "text", "hint": f"for example {example}" if example else ""}
    other_choice = {field.text: field.text} if field.text and field.text not in choices else {}
    title = "Robot" if kind == "robot" else question.text
    return {**control, "kind": "choice", "choices": choices | other_choice, "text": title}


def _spans(text: str) -> list[tuple[str, str, str]] | None:
    """Return axis, smallest and largest coordinate of a box as texts, for each axis; None if the text is not a box.

    :param text: answer as of `answers.stock`: a box or a file; empty: a box without numbers.
    """
    parts = [part.partition("=") for part in (text or "X=,Y=,Z=").split(",")]
    if [axis for axis, _, _ in parts] != list("XYZ"):
        return None
    # [::2]: without the colon between the ends
    return [(axis, *ends.partition(":")[::2]) for axis, _, ends in parts]


def _choices(kind: str) -> dict[str, str]:
    """Return the possible answers to a question: word → its title; empty: any text is possible.

    :param kind: first part of the key of the question.
    """
    if kind == "robot":
        return _robot_titles()
    if kind == "material":
        return {name: entry.title or name for name, entry in table().items()}
    return {word: word for word in _CHOICES.get(kind, ())}


@cache
def _robot_titles() -> dict[str, str]:
    """Return the shipped robots: name → title."""
    return {name: robot.load(folder).title for name, folder in robot.shipped_models().items()}


def posted_answers(form: dict[str, str]) -> dict[str, str]:
    """Return the answers of a posted form: key of the question → text.

    Fields such as ``base/X`` and ``base/Y`` are parts of one answer, which are joined.
    """
    texts: dict[str, str] = {}
    parts_of_answer: dict[str, dict[str, str]] = {}
    for name, value in form.items():
        key, slash, part = name.partition("/")
        if slash:
            parts_of_answer.setdefault(key, {})[part] = value.strip()
        else:
            texts[key] = value
    for key, parts in parts_of_answer.items():
        texts[key] = (
            _cutter_text(parts) if "shape" in parts else _box_text(parts) if key == "stock" else _frame_text(parts)
        )
    return texts


def _cutter_text(parts: Mapping[str, str]) -> str:
    """Return a posted cutter as `answers.cutter` takes it; empty if it has no diameter.

    :param parts: texts of "shape", "diameter" and "corner"; only a bull nose has a corner radius.
    """
    if not parts.get("diameter"):
        return ""
    corner = f",{parts.get('corner', '')}" if parts["shape"] == "bull" else ""
    return f"{parts['shape']},{parts['diameter']}{corner}"


def _box_text(parts: Mapping[str, str]) -> str:
    """Return a posted box as `answers.stock` takes it; empty if all fields are empty.

    :param parts: ends of the box by name of the field: ``X/from``, ``X/to`` and so on.
    """
    spans = {axis: (parts.get(f"{axis}/from", ""), parts.get(f"{axis}/to", "")) for axis in "XYZ"}
    box = ",".join(f"{axis}={low}:{high}" for axis, (low, high) in spans.items())
    return box if any(map(any, spans.values())) else ""


def _frame_text(parts: Mapping[str, str]) -> str:
    """Return a posted frame as ``X,Y,Z`` or, if it has angles, ``X,Y,Z,A,B,C``; empty if all fields are empty.

    :param parts: texts of the numbers by axis; an empty one counts as 0.
    """
    values = [parts.get(axis, "") for axis in "XYZABC"]
    if not any(values):
        return ""
    has_angles = any(values[3:])
    return ",".join(value or "0" for value in (values if has_angles else values[:3]))


def setup_page(
    name: str,
    *,
    facts: Sequence[str],
    refusal: str,
    form: SetupForm,
    command: str,
    fault: str,
    is_posted: bool,
    kept_cell: str = "",
    frames: Sequence[str] = (),
) -> Page:
    """Return the page of the set-up of a program: the questions that it raises.

    :param name: file name of the program.
    :param facts: sentences on tools from the comments of the program.
    :param refusal: reason why the program cannot be read at all; empty: it can.
    :param form: questions and answers.
    :param command: the command of these answers, as it is typed in a terminal.
    :param fault: reason why the command did not begin though all answers can be used; empty: no such reason.
    :param is_posted: the user has sent the form: faults of its answers are shown.
    :param kept_cell: robot and frames of the cell that is used as it is; empty: the page asks for them.
    :param frames: tables of frames that the program needs and this cell lacks, such as ``"tools.2"``.
    """
    groups: dict[str, list[dict[str, Any]]] = {"Robot and cell": [], "Tool, material and stock": [], "Details": []}
    faulty_answers = sum(bool(field.fault) for field in form.fields)
    if is_posted and not fault and faulty_answers:
        fault = f"Nothing was begun. Missing or unusable answers: {faulty_answers}."
    for field in form.fields:
        kind = field.question.key.partition(".")[0]
        is_of_cutting = kind in ("material", "cutter", "flutes", "rpm", "stock")
        is_of_cell = kind in ("robot", "base", "tool", "part_tolerance") or not field.question.optional
        group = "Tool, material and stock" if is_of_cutting else "Robot and cell" if is_of_cell else "Details"
        control = _control_values(field)
        groups[group].append(control if is_posted else {**control, "fault": ""})
    return _page(
        "setup.html",
        here="programs",
        title=name,
        facts=facts,
        refusal=refusal,
        groups=groups,
        command=command,
        fault=fault,
        kept_cell=kept_cell,
        frames=",".join(frame_tables(",".join(frames))),
        frame_titles=", ".join(map(_table_title, frames)),
    )


def program_page(
    item: Item, workspace: Workspace, other_programs: Sequence[str], *, run: Run | None, command: str
) -> Page:
    """Return the page of one program.

    :param other_programs: results and programs with which it can be compared.
    :param run: latest command about the program; None: there was none.
    :param command: the command that corrects the program, as it is typed in a terminal.
    """
    stem = Path(item.entry.page.removesuffix(".report.html") if item.entry else item.name).stem
    file_names = sorted(path.name for path in workspace.results.glob(f"{stem}*")) if item.entry else []
    files = [name for name in file_names if Path(name).suffix.lower() in MEDIA_TYPES and not name.endswith(".json")]
    place = workspace.results / f"place-{registry.program_name(Path(item.name))}"
    return _page(
        "program.html",
        here="programs",
        title=item.name,
        answers=result_texts(item),
        page=item.entry.page if item.entry else "",
        programs=[name for name in files if Path(name).suffix.lower() in (".src", ".mod", ".dat")],
        tables=[name for name in files if Path(name).suffix.lower() == ".csv"],
        others=other_programs,
        run=run,
        place=f"{place.name}/place.html" if (place / "place.html").is_file() else "",
        can_take=(place / "place.toml").is_file(),
        compared=next((name for name in files if name.endswith(".compare.report.html")), ""),
        options=[option._asdict() for option in FORM_OPTIONS],
        feed_rule=_feed_rule(workspace, item.name),
        command=command,
    )


def _feed_rule(workspace: Workspace, name: str) -> str:
    """Return the rule of feeds of the cell, see `feed_rule`; empty without a process or a readable cell.

    Without a process feeds cannot be lowered.
    """
    try:
        return feed_rule(workspace.cell) if workspace.process_file(name) is not None else ""
    except PostprocError:
        return ""


def _menu_of(run: Run) -> str:
    """Return the entry of the menu to which the page of a command belongs."""
    return "testpart" if run.page == "/testpart" else "robots" if run.page else "programs"


def run_page(run: Run) -> Page:
    """Return the page of a command with its output and its exit state."""
    return _page(
        "run.html",
        here=_menu_of(run),
        title=run.title,
        run=run,
        code=run.code,
        command=run.command,
    )


def _posted_fields(fields: Sequence[FormField], texts: Mapping[str, str]) -> list[FormField]:
    """Return fields with posted texts in place of those of the file.

    :param texts: posted texts by name of the field; fields without one keep their text.
    """
    return [replace(field, text=texts.get(field.name, field.text)) for field in fields]


def _hidden_text(fields: Sequence[FormField]) -> str:
    """Return the texts of the file that a form shows, as JSON for a hidden field of the form; see `shown_texts`."""
    return json.dumps({field.name: field.text for field in fields})


def shown_texts(form: Mapping[str, str]) -> dict[str, str]:
    """Return the texts that a form showed when it was opened, by name of the field; empty if the form lacks them."""
    try:
        return msgspec.json.decode(form.get("shown", "{}"), type=dict[str, str])
    except msgspec.DecodeError:
        return {}


_CELL_TITLES = {
    "base": "Part: $BASE",
    "tool": "Tool: $TOOL",
    "machine": "Height to which programs retract",
    "payload": "Load on the flange",
    "part": "Tolerance of the part, and its mesh",
    "tool_compliance": "Compliance of holder, spindle and tool",
}


def _table_title(table: str) -> str:
    """Return the heading of a table of the cell.

    :param table: name of the table, such as "base" or "tools.2".
    """
    name, _, number = table.partition(".")
    if not number:
        return _CELL_TITLES[name]
    title, _ = FRAMES[name]
    return title.format(number)


def cell_page(
    workspace: Workspace,
    fields: Sequence[FormField],
    *,
    fault: str,
    texts: Mapping[str, str],
    is_saved: bool,
    frames: str = "",
) -> Page:
    """Return the page of the cell.

    :param fields: fields of the form, with the texts of the file.
    :param fault: reason why posted numbers were not written; empty: none were refused.
    :param texts: posted numbers that were not written, by name of the field.
    :param is_saved: posted numbers were written: the page says so.
    :param frames: names of further tables of frames in the form, with commas between.
    """
    filled_fields = _posted_fields(fields, texts)
    tables = [
        {
            "name": name,
            "title": _table_title(name),
            "help": table_help(name),
            "fields": [field for field in filled_fields if field.table == name],
        }
        for name in dict.fromkeys(field.table for field in filled_fields)
    ]
    file = f"{RESULTS}/{workspace.cell.name}"
    return _page(
        "cell.html",
        here="cell",
        title="Cell",
        tables=tables,
        shown=_hidden_text(fields),
        fault=fault,
        saved=is_saved,
        file=file,
        frames=frames,
        robots=_robot_titles(),
        cell_robot=robot_name(workspace.cell),
        command="",
        **_picture_values(workspace.cell),
    )


_PROCESS_TITLES = {"material": "Material", "stock": "Stock before the program", "spindle": "Spindle"}
_FOLDED_KEYS = {
    "material": ("A material of your own", lambda key: key != "name"),
    "tools": ("Details", lambda key: key in ("helix_deg", "rpm", "spindle")),
    "stock": ("A mesh instead of the box, and the map", lambda key: key in ("file", "resolution_mm", *"ABC")),
}
"""Table → title of its details, and whether a key belongs to them: details are shown on request."""


def posted_fields(form: Mapping[str, str], fields: Sequence[FormField]) -> dict[str, str]:
    """Return the texts of fields from a posted form: name of the field → text.

    Span: both ends, joined by a comma, or empty. Flag: empty if it is not ticked, as forms then do not send it. Other
    fields that the form does not contain are left out.
    """
    texts = {}
    for field in fields:
        if field.kind == "span":
            ends = [form.get(f"{field.name}/{end}", "").strip().replace(",", ".") for end in ("from", "to")]
            texts[field.name] = ", ".join(ends) if any(ends) else ""
        elif field.kind == "flag":
            texts[field.name] = form.get(field.name, "")
        elif field.name in form:
            texts[field.name] = form[field.name]
    return texts


def process_page(
    name: str,
    path: Path,
    workspace: Workspace,
    tables: Sequence[ProcessTable],
    *,
    fault: str,
    texts: Mapping[str, str],
    is_saved: bool,
) -> Page:
    """Return the page of the process file of a program.

    :param name: file name of the program.
    :param path: process file, which may not exist yet.
    :param fault: reason why posted values were not written; empty: none were refused.
    :param texts: posted values that were not written, by name of the field.
    :param is_saved: posted values were written: the page says so.
    """
    file = f"{RESULTS}/{path.name}"
    return _page(
        "process.html",
        here="process",
        title=f"Process of {name}",
        program=name,
        file=file,
        is_there=path.is_file(),
        shared=path.name == "process.toml",
        has_cell=workspace.cell.is_file(),
        tables=[_shown_table(replace(item, fields=tuple(_posted_fields(item.fields, texts)))) for item in tables],
        shown=_hidden_text([field for item in tables for field in item.fields]),
        fault=fault,
        saved=is_saved,
        command=command_line(["convert", name, "--cell", f"{RESULTS}/cell.toml", "--process", file, "-o", RESULTS]),
    )


def _shown_table(item: ProcessTable) -> dict[str, Any]:
    """Return a table of the process as values for the template; keys that few users need are among its details."""
    kind, _, number = item.name.partition(".")
    details_title, is_detail_key = _FOLDED_KEYS.get(kind, ("", lambda _: False))

    def is_detail(field: FormField) -> bool:
        """Return whether a field is among the details."""
        return field.table == "stock.place" or (field.table != "stock.box" and is_detail_key(field.key))

    return {
        "title": _PROCESS_TITLES.get(kind) or ("Every tool" if number == "default" else f"Tool {number}"),
        "help": item.help,
        "comment": item.comment,
        "is_new": item.is_new,
        "fields": [field for field in item.fields if not is_detail(field)],
        "details": [field for field in item.fields if is_detail(field)],
        "details_title": details_title,
    }


def processes_page(rows: Sequence[tuple[str, str]]) -> Page:
    """Return the page with the list of programs and the sources of their forces.

    :param rows: name and source of each program, such as its process file.
    """
    return _page("processes.html", here="process", title="What cuts", rows=rows, command="")


def _picture_values(path: Path) -> dict[str, Any]:
    """Return the values for the template of the robot of a cell in two views.

    If the cell is unusable, there are no views, and `unusable` is the reason.
    """
    try:
        picture = cell_picture(path)
    except PostprocError as cause:
        return {"robot": "", "views": [], "is_start": False, "start_warning": "", "unusable": str(cause)}
    views = [arm_view(picture, name, axes) for name, axes in (("From the side", (0, 2)), ("From above", (0, 1)))]
    return {
        "robot": picture.title,
        "views": views,
        "is_start": picture.is_start,
        "start_warning": f"{picture.warning[:1].upper()}{picture.warning[1:]}",
        "unusable": "",
    }


def robots_page(name: str, workspace: Workspace, readings: Sequence[Readings]) -> Page:
    """Return the page of all robot models, or of one with the source of each value.

    :param name: name of the model; empty: all models.
    :param readings: readings from which a model can be identified.
    :raises InputError: there is no model of this name.
    """
    folders = robot.shipped_models()
    if name and name not in folders:
        raise InputError(f"no robot {name!r}", advice="Choose one of the list.")
    models = {} if name else {key: robot.load(folder) for key, folder in folders.items()}
    model = robot.load(folders[name]) if name else None
    return _page(
        "robots.html",
        here="robots",
        title=model.title if model else "Robot models",
        # name, title, numbers of assumed values and of all values
        rows=[
            (key, item.title, sum(entry.assumed for entry in item.sources), len(item.sources))
            for key, item in models.items()
        ],
        model=model,
        readings=[_readings_row(workspace, entry) for entry in readings],
        command=command_line(["robots", *([name] if name else [])]),
    )


def _readings_row(workspace: Workspace, entry: Readings) -> dict[str, Any]:
    """Return the values for the template of an experiment: name, files of readings and verdict on its model."""
    model = model_of(workspace.model_folder(entry.experiment))
    verdict = "not identified yet" if model is None else model.verdict or "geometry only"
    return {
        "name": workspace.relative_name(entry.experiment),
        "files": [path.name for path in entry.files],
        "model": verdict,
    }


def readings_page(name: str, workspace: Workspace, entry: Readings) -> Page:
    """Return the page of the readings of an experiment: commands that identify a model, its verdict and its use.

    :param name: path of the experiment in the folder of the window.
    """
    names = [path.name for path in entry.files]
    return _page(
        "readings.html",
        here="robots",
        title=f"Model from {name}",
        name=name,
        files=names,
        other_files=names[1:],
        compensators=[path.name for path in entry.compensators],
        use=_use_of_model(name, workspace, workspace.model_folder(entry.experiment)),
        command=command_line(identify_arguments(workspace, entry, {})) if entry.files else "",
    )


def _use_of_model(name: str, workspace: Workspace, folder: Path) -> dict[str, Any] | None:
    """Return the values for the template of a model and its use; None if there is no model yet.

    :param name: path of its experiment in the folder of the window; empty: the model of the test part.
    :param folder: folder of the model.
    """
    model = model_of(folder)
    if model is None:
        return None
    has_cell = workspace.cell.is_file()
    return {
        "name": name,
        "model": model,
        "has_cell": has_cell,
        "cell_robot": robot_name(workspace.cell) if has_cell else "",
        "is_used": has_cell and uses_model(workspace.cell, folder),
        "page": f"/model?name={quote(name)}",
        "material": f"../{workspace.relative_name(folder)}/material.toml"
        if (folder / "material.toml").is_file()
        else "",
    }


def testpart_page(part: TestPart) -> Page:
    """Return the page of the test part: its program, the points to probe, the probed deviations, the model."""
    workspace = part.workspace
    is_written, is_probed = (part.folder / "testpart.nc").is_file(), part.probing_path.is_file()
    command = part.identify_arguments() if is_probed else part.write_arguments({})
    return _page(
        "testpart.html",
        here="testpart",
        title="Test part",
        has_cell=workspace.cell.is_file(),
        processes=part.processes(),
        is_written=is_written,
        is_probed=is_probed,
        downloads=[name for name in PART_FILES if (part.folder / name).is_file() and not name.endswith(".html")],
        points=probing_list(part.folder / "probing.csv"),
        use=_use_of_model("", workspace, part.model) if is_written else None,
        command=command_line(command),
    )


def message_page(title: str, text: str) -> Page:
    """Return a page with a sentence: what is wrong, and what to do."""
    return _page("message.html", here="", title=title, text=text, command="")
