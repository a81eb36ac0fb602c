"""Tools, material, stock and spindle of a process file as fields; a program without one gets a draft of it.

A draft has the values that comments of the program state. It is not written before it is usable.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from postproc import files
from postproc.errors import ForceError
from postproc.jobs.file_form import FormField, edit_text, fields_of_table, parse, table_schema, write_valid
from postproc.jobs.guided_start import process_head, stock_lines, tool_head
from postproc.jobs.program_needs import ProgramNeeds
from postproc.machining.material import table as material_table
from postproc.machining.process import DEFAULT, StockTable
from postproc.machining.process import load as load_process

_STOCK = ("stock", "stock.box", "stock.place")


class ProcessTable(Struct, frozen=True):
    """A table of a process file.

    :param name: such as ``"tools.1"``.
    :param help: description of the table.
    :param fields: its keys as fields of a form.
    :param comment: comments of the program on this tool; empty: there are none.
    :param is_new: whether the file lacks the table, so that its values are those of the comments.
    """

    name: str
    help: str
    fields: tuple[FormField, ...]
    comment: str = ""
    is_new: bool = False


def process_tables(path: Path, needs: ProgramNeeds) -> list[ProcessTable]:
    """Return the tables of a process file: material, tools, stock, spindle. Tools that the program needs are added.

    :param path: the file; if it does not exist, the tables are those of a draft.
    :raises ForceError: the file cannot be read.
    """
    text = _text_of(path, needs)
    document, new_tools = _document(text, path, needs)
    tables = [_table(document, "material")]
    for key in document.get("tools", {}):
        comment = needs.cutter(key).text
        is_new = not path.is_file() or key in new_tools
        tables.append(replace(_table(document, f"tools.{key}"), comment=comment, is_new=is_new))
    stock = [field for name in _STOCK for field in _table(document, name).fields]
    tables.append(ProcessTable("stock", table_schema("process", "stock").help, tuple(stock), is_new=not path.is_file()))
    tables.append(_table(document, "spindle"))
    return tables


def _table(document: Any, name: str) -> ProcessTable:
    """Return a table of a process file as fields of a form; the name of the material is a choice among all materials.

    :param name: name of the table, such as ``"stock.box"``.
    """
    fields = tuple(fields_of_table(document, "process", name))
    if name == "material":
        names = tuple(material_table())
        fields = tuple(
            replace(field, kind="choice", choices=names) if field.key == "name" else field for field in fields
        )
    return ProcessTable(name, table_schema("process", name).help, fields)


def edit_process(path: Path, needs: ProgramNeeds, texts: Mapping[str, str]) -> bool:
    """Write values into a process file, checked as `convert` checks it; return whether anything has changed.

    A missing file is made from a draft. Comments and unchanged values stay as they are. Nothing is written if the
    process would be unusable.

    :param texts: values by the name of the field; empty: the key is removed.
    :raises InputError: a value is missing or wrong.
    """
    old_text = _text_of(path, needs)
    document, new_tools = _document(old_text, path, needs)
    fields = [field for item in process_tables(path, needs) for field in item.fields]
    new_text = edit_text(old_text, document, fields, texts)
    if path.is_file() and new_text == old_text and not new_tools:
        return False
    if new_tools and new_text == old_text:  # no value has changed, but the tools that the file lacks are added
        new_text = document.as_string()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_valid(path, new_text, _check_process)
    return True


def _check_process(path: Path) -> None:
    """Check that `convert` can read a process file, and that its material has a law of cutting forces.

    :raises InputError: the file is unusable.
    """
    process = load_process(path)
    if process.material is not None or not process.operations:
        process.law()  # raises if the material has no law; operations state their forces themselves


def _text_of(path: Path, needs: ProgramNeeds) -> str:
    """Return the text of a process file; if it does not exist, a draft from comments and moves of its program."""
    if path.is_file():
        return files.read_text(path, ForceError)
    lines = list(process_head(needs, None))
    for key in needs.cutter_keys:
        lines += ["", *_drafted_tool(key, needs)]
    diameters = {key: needs.cutter(key).diameter_mm or 0.0 for key in needs.cutter_keys}
    box = needs.stock_box(diameters)
    stock = ["[stock]"] if box is None else stock_lines(path.parent, StockTable(box=box), is_assumed=True)
    return "\n".join([*lines, "", *stock, ""])


def _drafted_tool(key: str, needs: ProgramNeeds) -> list[str]:
    """Return the lines of the table of a tool, with the keys whose values comments of the program state."""
    tool = needs.cutter(key)
    lines = [tool_head(key, needs)]
    lines += [f'shape = "{tool.shape}"'] if tool.shape is not None else []
    lines += [f"diameter_mm = {tool.diameter_mm:g}"] if tool.diameter_mm is not None else []
    lines += [f"corner_radius_mm = {tool.corner_radius_mm:g}"] if tool.shape == "bull" else []
    lines += [f"flutes = {tool.flutes}"] if tool.flutes is not None else []
    return lines


def _document(text: str, path: Path, needs: ProgramNeeds) -> tuple[Any, frozenset[str]]:
    """Return the document of a process file with the tools that its program needs, and the keys of added tools.

    No tool is added to a file with operations, with a tool for all numbers, or with any tool for a program without
    tool numbers.

    :param text: text of the file or draft; `path`: the file, for messages.
    """
    document = parse(text, str(path), ForceError)
    tools = document.get("tools", {})
    if DEFAULT in tools or (needs.cutter_keys == (DEFAULT,) and tools):
        return document, frozenset()
    stated_keys = {key.upper() for key in tools}
    missing_tools = [key for key in needs.cutter_keys if key.upper() not in stated_keys]
    if not missing_tools or document.get("operations"):
        return document, frozenset()
    lines = [line for key in missing_tools for line in ("", *_drafted_tool(key, needs))]
    document = parse("\n".join([text.rstrip("\n"), *lines, ""]), str(path), ForceError)
    return document, frozenset(missing_tools)
