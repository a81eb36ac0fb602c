"""Numbers of a cell file as fields, from the schema that editors check it by; edits keep its comments."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import tomlkit
from msgspec import Struct
from tomlkit.exceptions import TOMLKitError

from postproc import cell as cells
from postproc import files
from postproc.errors import CellError, InputError
from postproc.jobs.first_steps import schema_file

TABLES = ("base", "tool", "payload", "part", "tool_compliance")
"""Tables that have fields: what a shop measures."""


class NumberField(Struct, frozen=True):
    """A number of the cell: ``table.key``, its text in the file (empty: not stated), its limits and what it is."""

    table: str
    key: str
    text: str
    least: float | None
    most: float | None
    help: str

    @property
    def name(self) -> str:
        """Return the name of the field."""
        return f"{self.table}.{self.key}"


def fields_of(path: Path) -> list[NumberField]:
    """Return the fields of a cell file.

    :raises CellError: it cannot be read.
    """
    content = _document(path)
    return list(_fields(content))


def table_help(table: str) -> str:
    """Return what a table of the cell states."""
    schema = json.loads(schema_file("cell").read_bytes())
    text: str = schema["$defs"]["CellFile"]["properties"][table].get("description", "")
    return text


def _document(path: Path) -> Any:
    try:
        return tomlkit.parse(files.read_text(path, CellError))
    except TOMLKitError as cause:
        raise CellError(str(cause), file=str(path)) from cause


def _fields(content: Any) -> Iterator[NumberField]:
    schema = json.loads(schema_file("cell").read_bytes())
    for table in TABLES:
        table_schema = schema["$defs"]["CellFile"]["properties"][table]
        reference = table_schema.get("$ref") or next(kind["$ref"] for kind in table_schema["anyOf"] if "$ref" in kind)
        table_content = content.get(table, {})
        for key, limits in schema["$defs"][reference.rpartition("/")[2]]["properties"].items():
            number = next((kind for kind in limits.get("anyOf", [limits]) if kind.get("type") == "number"), None)
            if number is not None and hasattr(table_content, "get"):
                minimum = number.get("minimum", number.get("exclusiveMinimum"))
                maximum = number.get("maximum", number.get("exclusiveMaximum"))
                yield NumberField(
                    table, key, str(table_content.get(key, "")), minimum, maximum, limits.get("description", "")
                )


def edit(path: Path, texts: Mapping[str, str]) -> bool:
    """Write numbers into a cell file, checked as `convert` checks it; return whether anything has changed.

    Only numbers that differ are touched: comments and all else stay. Nothing is written if the cell would be unusable.

    :param texts: numbers by the name of the field; empty: the key is removed.
    :raises InputError: a text is no number, or the cell would be unusable.
    """
    old_text = files.read_text(path, CellError)
    content = _document(path)
    for field in list(_fields(content)):
        text = texts.get(field.name, field.text).strip()
        if text == field.text:
            continue
        if not text:
            content[field.table].remove(field.key)
            continue
        content.setdefault(field.table, tomlkit.table())[field.key] = _number(field.name, text)
    new_text = tomlkit.dumps(content)
    if new_text == old_text:
        return False
    trial_path = path.with_name(f".{path.name}.edited.toml")
    try:
        trial_path.write_bytes(new_text.encode())
        cells.load(trial_path)
    except CellError as cause:
        raise InputError(str(cause).replace(str(trial_path), path.name)) from cause
    finally:
        trial_path.unlink(missing_ok=True)
    files.write_whole(path.parent, {path.name: new_text.encode()})
    return True


def _number(name: str, text: str) -> float | int:
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{name} = {text!r} is no number", advice="Give a number such as 350 or -12.5.")
    return int(value) if value.is_integer() and abs(value) < 1e15 else value
