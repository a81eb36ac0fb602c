"""Keys of a TOML file as the fields of a form, from the schema that checks it; edits keep its comments."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

import tomlkit
from msgspec import Struct
from tomlkit.container import Container, OutOfOrderTableProxy
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Table

from postproc import files
from postproc.errors import InputError, PostprocError
from postproc.jobs.first_steps import schema_file

Kind = Literal["number", "count", "choice", "text", "span", "flag"]
"""Kind of the text of a field: a number, a whole number, a word of a list, a text, two numbers "0, 100", or "true"."""
_LARGEST_INTEGER = 1e15
"""Whole numbers below are exact as floats, and are written as such."""
_KINDS: dict[str, Kind] = {"number": "number", "integer": "count", "string": "text", "boolean": "flag"}


class FormField(Struct, frozen=True):
    """A key of a file as a field of a form.

    :param table: name of the table of the key, such as ``"tools.1"``.
    :param kind: see `Kind`.
    :param text: value in the file as text; empty: the file does not state it.
    :param least: smallest value; `most`: largest value; None: no limit.
    :param choices: words to choose from; empty: any text.
    :param help: description of the key.
    :param is_required: whether the table is unusable without the key.
    """

    table: str
    key: str
    kind: Kind
    text: str
    least: float | None = None
    most: float | None = None
    choices: tuple[str, ...] = ()
    help: str = ""
    is_required: bool = False

    @property
    def name(self) -> str:
        """Name of the field in forms and messages: table and key, such as ``"tools.1.diameter_mm"``."""
        return f"{self.table}.{self.key}"


class TableSchema(Struct, frozen=True):
    """The schema of a table.

    :param help: description of the table.
    :param keys: key → its part of the schema.
    :param required: keys that the table must have.
    """

    help: str
    keys: Mapping[str, Any]
    required: frozenset[str]


@cache
def table_schema(schema: str, table: str) -> TableSchema:
    """Return the schema of a table of a file, by following its name and references from the top of the schema.

    :param schema: ``"cell"`` or ``"process"``.
    :param table: such as ``"base"``, ``"tools.1"``, ``"stock.box"``.
    """
    content = json.loads(schema_file(schema).read_bytes())
    part = content["$defs"][content["$ref"].rpartition("/")[2]]
    text = ""
    for key in table.split("."):
        part = part["properties"][key] if "properties" in part else part["additionalProperties"]
        text = part.get("description", text)
        reference = part.get("$ref") or next((kind["$ref"] for kind in part.get("anyOf", ()) if "$ref" in kind), None)
        part = part if reference is None else content["$defs"][reference.rpartition("/")[2]]
    return TableSchema(text, part["properties"], frozenset(part.get("required", ())))


def parse(text: str, file: str, error: type[InputError]) -> Any:
    """Return the document of a TOML text.

    :param file: name of the file for messages; `error`: type of the error to raise.
    :raises InputError: the text is no TOML; of the type `error`.
    """
    try:
        return tomlkit.parse(text)
    except TOMLKitError as cause:
        raise error(str(cause), file=file) from cause


def fields_of_table(document: Any, schema: str, table: str, *kinds: Kind) -> Iterator[FormField]:
    """Yield the fields of a table; they are empty if the document lacks the table.

    No field is yielded if the name of the table has another kind of value, nor for a key whose value does not fit
    in a line of text, such as a table.

    :param schema: name of the schema of the file.
    :param kinds: kinds of fields to yield; none given: all.
    """
    content = _table(document, table)
    if content is None:
        return
    limits = table_schema(schema, table)
    for key, key_schema in limits.keys.items():
        field = _field(table, key, key_schema, content.get(key), is_required=key in limits.required)
        if field is not None and (not kinds or field.kind in kinds):
            yield field


def _table(document: Any, table: str) -> Any:
    """Return the content of a table; empty if the document lacks it; None if its name has another kind of value."""
    content: Any = document
    for key in table.split("."):
        content = content.get(key, {})
        if not hasattr(content, "get"):
            return None
    return content


def _field(table: str, key: str, part: Mapping[str, Any], value: Any, *, is_required: bool) -> FormField | None:
    """Return the field of a key; None for a key whose value does not fit in a line of text, such as a table.

    :param part: schema of the key; `value`: its value in the file, None: the file does not state it.
    :param is_required: see `FormField`.
    """
    alternatives = [part, *part.get("anyOf", ())]
    single = next((schema for schema in alternatives if schema.get("type") in _KINDS or "enum" in schema), None)
    pair = next((schema for schema in alternatives if len(schema.get("prefixItems", ())) == 2), None)
    if single is not None:
        limits = single
    elif pair is not None:
        limits = pair["prefixItems"][0]  # both numbers of a pair have one schema
    else:
        return None
    kind: Kind = "span" if pair is not None else "choice" if "enum" in limits else _KINDS[limits["type"]]
    return FormField(
        table=table,
        key=key,
        kind=kind,
        text=_field_text(value),
        least=limits.get("minimum", limits.get("exclusiveMinimum")),
        most=limits.get("maximum", limits.get("exclusiveMaximum")),
        choices=tuple(limits.get("enum", ())),
        help=part.get("description", ""),
        is_required=is_required,
    )


def _field_text(value: Any) -> str:
    """Return a value of a TOML file as the text of a form field; an empty text for None and false."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else ""
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def edit_text(text: str, document: Any, fields: Sequence[FormField], texts: Mapping[str, str]) -> str:
    """Return the text of a document after values of its fields are changed.

    The document is changed too. Comments and unchanged values are kept to the byte.

    :param text: text of the document, which is returned if no value differs.
    :param fields: fields of the document; `texts`: new texts by the name of the field. An empty text removes the key.
    :raises InputError: a text is no number, or a required value is missing in a table that has values.
    """
    is_edited = False
    for field in fields:
        value_text = texts.get(field.name, field.text).strip()
        if field.is_required and not value_text and _has_values(field.table, fields, texts):
            raise InputError(f"{field.name} is missing", advice=f"Give it: {field.help or field.key}.")
        if value_text == field.text:
            continue
        is_edited = True
        if value_text:
            _ensured_table(document, field.table)[field.key] = _parsed_value(field, value_text)
        else:
            _remove(document, field)
    return tomlkit.dumps(document) if is_edited else text


def _has_values(table: str, fields: Sequence[FormField], texts: Mapping[str, str]) -> bool:
    """Return whether a field of a table has a text: the new text if there is one, else the text in the file."""
    return any(texts.get(field.name, field.text).strip() for field in fields if field.table == table)


def _ensured_table(document: Any, table: str) -> Any:
    """Return a table of a document, which is added if the document lacks it."""
    content = document
    for key in table.split("."):
        if key not in content:
            # a section [a.b] goes into the document, a table in several parts or a table that has only sections
            is_section = isinstance(content, (Container, OutOfOrderTableProxy)) or (
                isinstance(content, Table) and content.is_super_table()
            )
            content[key] = tomlkit.table() if is_section else tomlkit.inline_table()
        content = content[key]
    return content


def _remove(document: Any, field: FormField) -> None:
    """Remove the key of a field; if its table is within another table and empty then, remove the table too."""
    content = _table(document, field.table)
    content.remove(field.key)
    parent, _, key = field.table.rpartition(".")
    if parent and not content:
        _table(document, parent).remove(key)


def _parsed_value(field: FormField, text: str) -> Any:
    """Return the value that the text of a form field states, by the kind of the field.

    :raises InputError: a number is expected, and the text is none.
    """
    if field.kind == "span":
        words = [word.strip() for word in text.split(",")]
        if len(words) != 2 or not all(words):
            raise InputError(f"{field.name} = {text!r}: two numbers are needed", advice="Give both, such as 0 and 100.")
        return [_parsed_number(field.name, word) for word in words]
    if field.kind in ("number", "count"):
        return _parsed_number(field.name, text)
    return text == "true" if field.kind == "flag" else text


def _parsed_number(name: str, text: str) -> float | int:
    """Return the number in a text, also with a decimal comma; a whole number as int.

    :param name: name of the field, for messages.
    :raises InputError: the text is no finite number.
    """
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{name} = {text!r} is no number", advice="Give a number such as 350 or -12.5.")
    return int(value) if value.is_integer() and abs(value) < _LARGEST_INTEGER else value


def changes_of_user(fields: Sequence[FormField], texts: Mapping[str, str], shown: Mapping[str, str]) -> dict[str, str]:
    """Return the texts that a user changed in a form, by the name of the field.

    Other values keep what others have written into the file since the form was opened.

    :param fields: fields of the file as it is now.
    :param texts: texts that the user posted, by the name of the field.
    :param shown: texts that the form showed when it was opened; a field that is not in it counts as changed.
    :raises InputError: a value that the user changed was also changed in the file, to something else.
    """
    changes = {name: text for name, text in texts.items() if text.strip() != shown.get(name)}
    for field in fields:
        shown_text, text = shown.get(field.name, field.text), changes.get(field.name, "").strip()
        if field.name in changes and field.text not in (shown_text, text):
            raise InputError(
                f"{field.name} was {shown_text or 'not stated'} when you opened this page, and is now "
                f"{field.text or 'not stated'} in the file: nothing was written",
                advice=f"Save again to write {text}." if text else "Save again to remove it.",
            )
    return changes


def write_valid(path: Path, text: str, check: Callable[[Path], object]) -> None:
    """Write a text into a file if it is usable; else nothing is written.

    :param check: reads a trial file with this text, in the same folder, and raises `PostprocError` if it is unusable.
    :raises InputError: the text is unusable.
    """
    trial_path = path.with_name(f".{path.name}.edited.toml")
    try:
        trial_path.write_bytes(text.encode())
        check(trial_path)
    except PostprocError as cause:
        raise InputError(str(cause).replace(str(trial_path), path.name)) from cause
    finally:
        trial_path.unlink(missing_ok=True)
    files.write_whole(path.parent, {path.name: text.encode()})
