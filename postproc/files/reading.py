"""Strict reading of TOML and CSV: unknown names are errors with file, line and key. Reading of meshes."""

from __future__ import annotations

import contextlib
import io
import logging
import math
import operator
import os
import re
import stat
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from postproc.errors import MAX_ERRORS, InputError, choices, combined_error, did_you_mean, nearest_name
from postproc.files.toml_lines import line_of, line_of_unknown
from postproc.frames import M_PER_MM, Array

T = TypeVar("T")
Error = TypeVar("Error", bound=InputError)


MOST_BYTES = 1 << 30
"""Largest size of an input file: more is no program and no table."""


def resolve(path: Path) -> Path:
    """Return an absolute path without symbolic links; of a link that leads to itself, as far as it leads.

    `Path.resolve` raises for such a link before Python 3.13. To read it is an `OSError` with its cause.
    """
    return Path(os.path.realpath(path))


def read_bytes(path: Path, error: type[InputError], missing_advice: str | None = None) -> bytes:
    """Return the content of a file; `error` names it when it cannot be read.

    :param missing_advice: advice of the error if the file does not exist; None: without advice.
    :raises InputError: (`error`) the file does not exist, is a device, a pipe or a folder, or is larger than
        `MOST_BYTES`.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a device or a pipe"
            raise error(f"{kind}, not a file", file=str(path), advice="Give the path of a file.")
        if status.st_size > MOST_BYTES:
            problem = f"a file of {status.st_size / 2**30:.1f} GiB: at most {MOST_BYTES >> 30} GiB are read"
            raise error(problem, file=str(path), advice="Divide it.")
        return path.read_bytes()
    except FileNotFoundError:
        raise error("no such file", file=str(path), advice=missing_advice) from None
    except OSError as cause:
        raise error(
            f"cannot be read ({cause.strerror})", file=str(path), advice="Check its path, and that you may read it."
        ) from cause


def read_text(path: Path, error: type[InputError], missing_advice: str | None = None) -> str:
    """Return the text of a UTF-8 file (BOM allowed).

    :param error: kind of the errors; they name the file.
    :param missing_advice: advice of the error if the file does not exist; None: without advice.
    :raises InputError: (`error`) the file cannot be read, or is no UTF-8 text.
    """
    try:
        return read_bytes(path, error, missing_advice).decode("utf-8-sig")
    except UnicodeDecodeError as cause:
        raise error(f"not UTF-8 text (byte {cause.start})", file=str(path), advice="Save the file as UTF-8.") from cause


_DEEP_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]+[ \t]*\.[ \t]*){30}""")
"""tomllib takes a time that grows with the square of the number of parts of a key."""


def read_toml(
    path: Path,
    structure: type[T],
    error: type[InputError],
    example: str | None = None,
    missing_advice: str | None = None,
) -> T:
    """Read a TOML file into a msgspec structure.

    :param error: kind of the errors.
    :param example: what such a file looks like, shown where keys are missing; None: no example is shown.
    :param missing_advice: advice of the error if the file does not exist; None: without advice.
    :raises InputError: (`error`) the file cannot be read or is no TOML, keys are unknown or missing (all of them at
        once), or a value has a wrong type, is NaN or infinite; the message names the key and, for an unknown one, the
        valid ones.
    """
    text = read_text(path, error, missing_advice)
    if deep := _DEEP_KEY.search(text):
        line = text.count("\n", 0, deep.start()) + 1
        raise error("a key of more than 30 parts", file=str(path), line=line, advice="Correct the key.")
    try:
        data = tomllib.loads(text)
        for key, value in _entries(data, ""):
            if isinstance(value, float) and not math.isfinite(value):
                raise error(f"{key} is {value}", file=str(path), advice="Give a finite number.")
    except ValueError as cause:  # TOMLDecodeError is one; so is a number of thousands of digits
        raise _syntax_error(str(cause), text, path, error) from cause
    except RecursionError:
        raise error("not valid TOML: nested too deeply", file=str(path)) from None
    return convert(data, structure, str(path), error, example, text)


_PLACE = re.compile(r" \(at line (?P<line>\d+), column (?P<column>\d+)\)$")
_DECIMAL_COMMA = re.compile(r"=\s*(?P<number>[-+]?\d+,\d+)")


def _syntax_error(cause: str, text: str, path: Path, error: type[Error]) -> Error:
    """Return the error for a text that is no TOML, with its line, and a hint where a number has a decimal comma."""
    place = _PLACE.search(cause)
    if place is None:
        return error(f"not valid TOML: {cause}", file=str(path))
    line = int(place["line"])
    content = text.split("\n")[line - 1].partition("#")[0]
    advice = None
    if number := _DECIMAL_COMMA.search(content):
        advice = f"Write decimals with a point, not a comma: {number['number'].replace(',', '.')}."
    problem = f"not valid TOML: {cause[: place.start()]} (column {place['column']})"
    return error(problem, file=str(path), line=line, advice=advice)


def convert(
    data: object, structure: type[T], file: str, error: type[InputError], example: str | None = None, text: str = ""
) -> T:
    """Return plain data as a msgspec structure; parameters as of `read_toml`.

    :param file: name for messages.
    :param text: of the TOML file, in which an error names the line; empty: the data are from no file.
    :raises InputError: (`error`) the data do not have this structure.
    """
    try:
        return msgspec.convert(data, structure)
    except (msgspec.ValidationError, OverflowError) as cause:
        kind = msgspec.inspect.type_info(structure)
        wrong_keys = list(islice(_wrong_keys(data, kind, ""), MAX_ERRORS + 1))
        if wrong_keys:
            raise _error_of_keys(wrong_keys, file, error, example, text) from cause
        raise _error_of_value(str(cause), data, kind, file, error, text) from cause


def _error_of_keys(
    wrong_keys: Sequence[tuple[str, str | None]], file: str, error: type[Error], example: str | None, text: str
) -> Error:
    """Return the error for keys that are unknown or missing.

    :param wrong_keys: problem and advice for each, as of `_wrong_keys`; at least one.
    :param example: added to the last advice if keys are missing and none is unknown; None: no example.
    :param text: see `convert`.
    """
    advices = [advice for _, advice in wrong_keys]
    if example and all(problem.startswith("missing") for problem, _ in wrong_keys):
        advices[-1] = "\n".join(filter(None, (advices[-1], example)))
    return combined_error(
        error(problem, file=file, line=line_of_unknown(text, problem), advice=advice)
        for (problem, _), advice in zip(wrong_keys, advices, strict=True)
    )


def _error_of_value(cause: str, data: object, kind: Any, file: str, error: type[Error], text: str) -> Error:
    """Return the error for a value of a wrong type or out of range.

    :param cause: message of msgspec, which ends with the key after "at `$" if it is about a key.
    :param kind: msgspec's type of the data.
    :param text: see `convert`.
    """
    message, _, path = cause.removesuffix("`").partition(" - at `$")
    key = path.removeprefix(".")
    if path:
        message = _explain_value(f"{key}: {message}", data, key)
    advice = _valid_values(kind, path, re.search(r"enum value '(.*)'", message))
    message = _explain_quoted_number(message)
    for old, new in (("`object`", "a table"), ("`array`", "a list"), ("Invalid enum value", "no such value:")):
        message = message.replace(old, new)
    full_key = message.partition(": ")[0] if path else ""
    line = line_of(text, full_key if "..." not in full_key else key)
    return error(message, file=file, line=line, advice=advice)


_RANGE_MESSAGE = re.compile(r"Expected `(?:float|int)` (?P<relation><=|>=|<|>) (?P<limit>\S+)$")
_OUT_OF_RANGE = {"<=": operator.gt, ">=": operator.lt, "<": operator.ge, ">": operator.le}
_TEXT_FOR_NUMBER = re.compile(r"Expected `(?P<type>float|int)(?: \| null)?`, got `str`$")
_NUMBER = {"float": "a number", "int": "a whole number"}
_INVALID_VALUE_MESSAGE = re.compile("Invalid enum value '?(?P<value>.*?)'?$")
_KIND_MESSAGE = re.compile(r"got `(?P<kind>str|int|float|bool|array|object)`$")
_TYPE_OF_KIND = {"str": str, "int": int, "float": float, "bool": bool, "array": list, "object": dict}


def _explain_quoted_number(message: str) -> str:
    """Return a message in plain words where a number is in quotes; other messages as they are."""
    return _TEXT_FOR_NUMBER.sub(lambda m: f"{_NUMBER[m['type']]} is expected, not a text in quotes", message)


def _explain_value(message: str, data: object, at: str) -> str:
    """Return a message of msgspec about a value, with the full key of the first entry that it fits.

    msgspec does not say which entry of a table or list with any names it means, so the entry is looked up:

    - "Expected `float` > 0": the entry is a number out of this range; the message gets the number too.
    - "Invalid enum value 'x'": the value of the entry is x.
    - "got `str`": the entry is of this kind.

    A message of another form, or one that fits no entry, is returned as it is.

    :param message: ``KEY: TEXT``.
    :param data: content of the file.
    :param at: key of the value, where `[...]` stands for any name or index.
    """
    key_pattern = re.compile(re.escape(at).replace(re.escape("[...]"), r"(?:\.[^.]+|\[\d+\])"))
    entries = ((name, value) for name, value in _entries(data, "") if key_pattern.fullmatch(name))
    if range_message := _RANGE_MESSAGE.search(message):
        is_out_of_range, limit = _OUT_OF_RANGE[range_message["relation"]], float(range_message["limit"])
        for name, value in entries:
            if isinstance(value, (float, int)) and not isinstance(value, bool) and is_out_of_range(value, limit):
                return f"{name}: {range_message[0]}, not {str(value)[:40]}"
    if invalid := _INVALID_VALUE_MESSAGE.search(message):
        for name, value in entries:
            if str(value) == invalid["value"]:
                return f"{name}: {message.partition(': ')[2]}"
    if kind_message := _KIND_MESSAGE.search(message):
        for name, value in entries:
            if type(value) is _TYPE_OF_KIND[kind_message["kind"]]:
                return f"{name}: {message.partition(': ')[2]}"
    return message


def _entries(data: object, key: str) -> Iterator[tuple[str, object]]:
    """Yield all values of a table, and of the tables and lists in it, with their keys."""
    if key:
        yield key, data
    if isinstance(data, Mapping):
        for name, value in data.items():
            yield from _entries(value, f"{key}.{name}" if key else str(name))
    elif isinstance(data, list):
        for index, value in enumerate(data):
            yield from _entries(value, f"{key}[{index}]")


def _wrong_keys(data: object, kind: Any, at: str, *, is_entry: bool = False) -> Iterator[tuple[str, str | None]]:
    """Yield the errors in the keys of a table and its subtables: problem and advice.

    :param kind: msgspec's type of the data.
    :param at: key of the table; empty: the whole file.
    :param is_entry: the table is an entry of a table with names that the user chooses, such as ``[tools.1]``; a dot in
        such a name must be in quotes.
    """
    kind = _type_without_none(kind)
    if isinstance(kind, msgspec.inspect.DictType) and isinstance(data, Mapping):
        for name, value in data.items():
            yield from _wrong_keys(value, kind.value_type, _full_key(at, str(name)), is_entry=True)
    elif isinstance(kind, msgspec.inspect.ListType) and isinstance(data, list):
        for value in data:
            yield from _wrong_keys(value, kind.item_type, at)
    elif isinstance(kind, msgspec.inspect.StructType) and isinstance(data, Mapping):
        yield from _wrong_keys_of_table(data, kind, at, is_entry=is_entry)
        for field in kind.fields:
            if field.encode_name in data:
                yield from _wrong_keys(data[field.encode_name], field.type, _full_key(at, field.encode_name))


def _wrong_keys_of_table(
    data: Mapping[Any, Any], kind: msgspec.inspect.StructType, at: str, *, is_entry: bool
) -> Iterator[tuple[str, str | None]]:
    """Yield the unknown and the missing keys of a table, without its subtables: problem and advice.

    :param is_entry: see `_wrong_keys`.
    """
    fields = {field.encode_name: field for field in kind.fields}
    table = f" in [{at}]" if at else ""
    unknown_names = [str(name) for name in data if name not in fields] if kind.forbid_unknown_fields else []
    for name in unknown_names:
        key = f"table [{_full_key(at, name)}]" if isinstance(data[name], Mapping) else f"key {name!r}{table}"
        advice = choices(name, fields, "Valid keys")
        if is_entry and isinstance(data[name], Mapping):
            parent, _, entry = at.rpartition(".")
            advice = f'A name with a dot is in quotes: [{parent}."{entry}.{name}"]. {advice}'
        yield f"unknown {key}", advice
    # the key that a misspelt one means is not missing too
    intended_names = {nearest_name(name, fields) for name in unknown_names}
    missing_keys = [
        f"[{_full_key(at, name)}]" if isinstance(_type_without_none(field.type), msgspec.inspect.StructType) else name
        for name, field in fields.items()
        if field.required and name not in data and name not in intended_names
    ]
    if missing_keys:
        yield f"missing {'key' if len(missing_keys) == 1 else 'keys'}{table}: {', '.join(missing_keys)}", None


def _full_key(at: str, name: str) -> str:
    """Return a key with its tables."""
    return f"{at}.{name}" if at else name


def _type_without_none(kind: Any) -> Any:
    """Return msgspec's type of an optional value without None: X of ``X | None``; other types as they are."""
    if isinstance(kind, msgspec.inspect.UnionType):
        return next((member for member in kind.types if not isinstance(member, msgspec.inspect.NoneType)), kind)
    return kind


_KEY_PART = re.compile(r"\[[^\]]*\]|[^.\[]+")
"""`[...]` of a table with any names, an index, or a name."""


def _valid_values(kind: Any, at: str, invalid_value: re.Match[str] | None) -> str | None:
    """Return the values that a key may have as a sentence, with their description; None if they are no list of values.

    :param kind: msgspec description of the structure.
    :param at: path of the key in msgspec's form, as ``.gcode.turn``.
    :param invalid_value: match of the invalid value in msgspec's message: the valid value nearest to it is named first.
        None: the message names no value.
    """
    for part in _KEY_PART.findall(at):
        kind = _type_without_none(kind)
        if part == "[...]" and isinstance(kind, msgspec.inspect.DictType):
            kind = kind.value_type
        elif part.startswith("[") and isinstance(kind, msgspec.inspect.ListType):
            kind = kind.item_type
        elif isinstance(kind, msgspec.inspect.StructType):
            kind = next((field.type for field in kind.fields if field.encode_name == part), kind)
    description = ""
    if isinstance(kind, msgspec.inspect.Metadata):
        kind, description = kind.type, f" {(kind.extra_json_schema or {})['description']}"
    if isinstance(_type_without_none(kind), msgspec.inspect.LiteralType):
        values = _type_without_none(kind).values
        question = did_you_mean(invalid_value[1], map(str, values)) if invalid_value else ""
        return f"{question} Valid values: {', '.join(map(repr, values))}.{description}".lstrip()
    return None


class ParsedCsv(NamedTuple, Generic[Error]):
    """The n rows of a CSV file, and what is wrong with it.

    :ivar numbers: numeric columns by name, (n,) each; NaN for values that are no finite numbers.
    :ivar texts: text columns by name, n texts each.
    :ivar lines: (n,) 1-based line of each row.
    :ivar faults: of single rows: one of wrong length, which is left out, or a value that is no finite number.
    """

    numbers: dict[str, Array]
    texts: dict[str, list[str]]
    lines: Array
    faults: list[Error]


class CsvTable(NamedTuple):
    """The n rows of a CSV file.

    :ivar numbers: numeric columns by name, (n,) each.
    :ivar texts: text columns by name, n texts each.
    :ivar lines: (n,) 1-based line of each row.
    """

    numbers: dict[str, Array]
    texts: dict[str, list[str]]
    lines: Array


def read_csv(
    path: Path,
    required_columns: Sequence[str],
    optional: Sequence[str],
    error: type[Error],
    text_columns: Sequence[str] = (),
    may_be_empty: Sequence[str] = (),
) -> CsvTable:
    """Read a CSV file as `parse_csv` does.

    :raises InputError: (`error`) the file cannot be read, or rows have faults; all of them together.
    """
    numbers, texts, lines, faults = parse_csv(path, required_columns, optional, error, text_columns, may_be_empty)
    if faults:
        raise combined_error(faults)
    return CsvTable(numbers, texts, lines)


def parse_csv(
    path: Path,
    required_columns: Sequence[str],
    optional: Sequence[str],
    error: type[Error],
    text_columns: Sequence[str] = (),
    may_be_empty: Sequence[str] = (),
) -> ParsedCsv[Error]:
    """Read a CSV file with a header line, comma separated, `.` as decimal point.

    :param required_columns: columns that must be there.
    :param optional: columns that may be there.
    :param error: kind of the errors.
    :param text_columns: those of the columns that hold text.
    :param may_be_empty: those of the numeric columns whose cells may be empty: NaN.
    :raises InputError: (`error`) the file cannot be read, or its header line cannot be used.
    """
    header, rows, lines, faults = _rows_of_csv(path, required_columns, optional, error)
    columns = dict(zip(header, zip(*rows, strict=True), strict=True)) if rows else dict.fromkeys(header, ())
    numeric: dict[str, Array] = {}
    for name, values in columns.items():
        if name not in text_columns:
            numeric[name], invalid_rows = _number_column(values, empty_is_nan=name in may_be_empty)
            faults += [
                error(
                    f"column {name} is not a finite number: {values[place][:80]!r}",
                    file=str(path),
                    line=lines[place],
                    advice="Use a decimal point, no units and no empty cells.",
                )
                for place in invalid_rows[: MAX_ERRORS + 1].tolist()
            ]
    texts = {name: [v.strip() for v in columns[name]] for name in text_columns if name in columns}
    return ParsedCsv(numeric, texts, np.array(lines, dtype=float), faults)


class _CsvRows(NamedTuple, Generic[Error]):
    """Cells of a CSV file.

    :ivar header: names of the columns.
    :ivar rows: the cells of each row that has as many as the header.
    :ivar lines: 1-based line of each of these.
    :ivar faults: of rows of another length; one for all if no row is right.
    """

    header: list[str]
    rows: list[list[str]]
    lines: list[int]
    faults: list[Error]


def _rows_of_csv(
    path: Path, required_columns: Sequence[str], optional: Sequence[str], error: type[Error]
) -> _CsvRows[Error]:
    """Return the cells of a CSV file; parameters as of `parse_csv`.

    :raises InputError: (`error`) the file cannot be read, or its header line cannot be used.
    """
    import csv

    text = read_text(path, error)
    reader = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True)
    rows: list[list[str]] = []
    lines: list[int] = []
    faults: list[Error] = []
    try:
        header = _header(next(reader, []), path, required_columns, optional, error)
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != len(header):
                problem, advice = f"{len(row)} values where the header has {len(header)}", None
                if len(row) == 1 and len(row[0].split(";")) == len(header):
                    problem, advice = "values separated by semicolons", _COMMAS
                elif len(row) > len(header):
                    advice = "Write numbers with a decimal point (0.034), not with a comma, which separates values."
                faults.append(error(problem, file=str(path), line=reader.line_num, text=",".join(row), advice=advice))
                continue
            rows.append(row)
            lines.append(reader.line_num)
    except csv.Error as cause:
        raise error(f"not a valid CSV file: {cause}", file=str(path), line=reader.line_num) from cause
    if not rows and len(faults) > 1 and len({row_error.problem for row_error in faults}) == 1:  # one cause, stated once
        first_error = faults[0]
        problem = f"{first_error.problem}, in all {len(faults)} rows"
        faults = [
            error(problem, file=str(path), line=first_error.line, text=first_error.text, advice=first_error.advice)
        ]
    return _CsvRows(header, rows, lines, faults)


def check_sizes(
    path: Path, numbers: dict[str, Array], lines: Array, largest: Sequence[tuple[str, float, str]], error: type[Error]
) -> None:
    """Check that the numbers of a CSV file are not too large.

    :param numbers: columns by name, `lines` their lines, as `read_csv` returns them.
    :param largest: name of a column, largest size of its cells, and their unit with a blank before.
    :raises InputError: (`error`) some are; all errors are raised together.
    """
    faults = [
        error(
            f"column {name} is {numbers[name][row]:g}: expected {-limit:g} to {limit:g}{unit}",
            file=str(path),
            line=int(lines[row]),
        )
        for name, limit, unit in largest
        for row in np.flatnonzero(np.abs(numbers[name]) > limit)
    ]
    if faults:
        raise combined_error(faults)


_COMMAS = "Separate the columns by commas, and write numbers with a decimal point (as English Excel saves CSV)."


def _header(
    row: Sequence[str], path: Path, required_columns: Sequence[str], optional: Sequence[str], error: type[Error]
) -> list[str]:
    """Return the names of the columns, each known, none twice, all required ones there.

    :param row: cells of the first line; other parameters as of `parse_csv`.
    :raises InputError: (`error`) they are not.
    """
    header = [name.strip() for name in row]
    valid_names = [*required_columns, *optional]
    valid = f"Valid columns: {', '.join(valid_names)}."
    if not any(header):
        raise error("empty file", file=str(path), advice=valid)
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in header[0]:
            raise error(f"columns separated by {name}", file=str(path), line=1, text=row[0], advice=_COMMAS)
    unknown = [name for name in dict.fromkeys(header) if name not in valid_names]
    faults = [f"unknown column {name!r}" for name in unknown]
    faults += [f"column {name!r} is given twice" for name in dict.fromkeys(header) if header.count(name) > 1]
    missing_names = [name for name in required_columns if name not in header]
    if missing_names:
        faults.append(f"missing column {', '.join(missing_names)}")
    if faults:
        questions = [
            did_you_mean(name, [valid_name for valid_name in valid_names if valid_name not in header])
            for name in unknown
        ]
        raise error("; ".join(faults), file=str(path), line=1, advice=" ".join([*filter(None, questions), valid]))
    return header


def _number_column(values: Sequence[str], *, empty_is_nan: bool) -> tuple[Array, NDArray[np.int64]]:
    """Return a column of numbers, NaN for cells that are no finite number, and the rows (n,) of cells that are wrong.

    :param empty_is_nan: an empty cell is not wrong.
    """
    is_empty = np.array([empty_is_nan and not value.strip() for value in values], dtype=bool)
    try:
        column = np.array(values, dtype=float)
    except ValueError:
        column = np.full(len(values), np.nan)
        for index, value in enumerate(values):
            with contextlib.suppress(ValueError):
                column[index] = float(value)
    invalid_rows = np.flatnonzero(~np.isfinite(column) & ~is_empty)
    column[invalid_rows] = np.nan
    return column, invalid_rows


_NORMAL = re.compile(rb"facet\s+normal[^\r\n]*", re.IGNORECASE)
_BINARY_TITLE, _BINARY_HEADER, _BINARY_FACET = 80, 84, 50
"""Bytes of a binary STL file before the number of its facets, before its facets, and of each facet."""


def read_mesh(path: Path, error: type[InputError], kind: str) -> Any:
    """Return the triangles of a file as a `trimesh.Trimesh`, in the unit of the file.

    The normals of an ASCII STL file are not read: the order of the corners gives the outer side. Its name and comments
    may be in any encoding.

    :param error: exception to raise.
    :param kind: names the file in messages, such as "mesh of the part".
    :raises InputError: there is no such file, it cannot be read, or it has no surface.
    """
    import trimesh

    if not path.is_file():
        raise error(f"no such file: {kind}", file=str(path), advice="Give a mesh in mm: STL, PLY, OBJ or GLB.")
    if path.suffix.lower().lstrip(".") not in trimesh.available_formats():
        advice = "Export the body from CAD as binary STL, in mm."
        raise error(
            f"the {kind} cannot be read: no reader of {path.suffix} is installed", file=str(path), advice=advice
        )
    logger = logging.getLogger("trimesh")
    old_state, logger.disabled = logger.disabled, True  # faults become the exception below, without a traceback
    try:
        if path.suffix.lower() == ".stl":
            mesh: Any = trimesh.load(io.BytesIO(_plain_stl(path.read_bytes())), file_type="stl", force="mesh")
        else:
            mesh = trimesh.load(path, force="mesh")
        corners = np.asarray(mesh.triangles)
    except Exception as cause:  # trimesh raises whatever its readers raise
        advice = "Export it anew from CAD, in mm, as binary STL."
        raise error(f"the {kind} cannot be read ({cause})", file=str(path), advice=advice) from None
    finally:
        logger.disabled = old_state
    if len(corners) == 0 or not np.isfinite(corners).all():
        advice = "Export the body from CAD as binary STL."
        raise error(f"the {kind} has no surface, or corners that are no numbers", file=str(path), advice=advice)
    return mesh


def _plain_stl(content: bytes) -> bytes:
    """Return the bytes of an STL file in a form that trimesh reads: text in ASCII, with normals of zero.

    A binary file is returned unchanged.

    :raises ValueError: a binary file ends too early.
    """
    count = int.from_bytes(content[_BINARY_TITLE:_BINARY_HEADER], "little")
    if len(content) >= _BINARY_HEADER and len(content) == _BINARY_HEADER + _BINARY_FACET * count:
        return content
    if content.lstrip()[:5].lower() != b"solid":
        if len(content) < _BINARY_HEADER + _BINARY_FACET * count:
            present = max(len(content) - _BINARY_HEADER, 0) // _BINARY_FACET
            raise ValueError(f"the file ends after {present} of {count} facets")
        return content
    return _NORMAL.sub(b"facet normal 0 0 0", content).decode("ascii", errors="replace").replace("\ufffd", "?").encode()


_MOST_FACETS = 60_000
"""Limit of division: the time of a surface map grows with its facets."""
_EDGE = np.radians(30.0)
"""Facets that meet at a smaller angle belong to one smooth surface (assumed)."""
_SIDES_PER_PART = 60.0
"""Facets are divided until the longest is this share of the part, or there are too many (assumed)."""


def read_facets(path: Path) -> tuple[Array, Array]:
    """Return the facets of a mesh, large ones divided.

    :returns: corners (F, 3, 3) [m], and distance of each facet from the smooth surface it approximates (F,) [m].
    :raises InputError: there is no such file, it cannot be read, or it has no facet.
    """
    mesh = read_mesh(path, InputError, "mesh of the part")
    corners: Array = np.asarray(mesh.triangles) * M_PER_MM
    if mesh.is_watertight and mesh.volume < 0.0:  # inside out
        corners = corners[:, ::-1]
    return _subdivide(corners, _chord_heights(mesh) * M_PER_MM)


def _chord_heights(mesh: Any) -> Array:
    """Return the height (F,) of the arc over each facet, as its neighbours continue it; 0 on flat faces.

    A mesh approximates a curved surface by flat facets; the height is the largest distance between both, in the unit of
    the mesh. A facet of width c that meets the next one at the angle θ is a chord of an arc of height c/2·tan(θ/4).
    """
    facets, angle = np.asarray(mesh.face_adjacency), np.asarray(mesh.face_adjacency_angles)
    is_smooth = angle < _EDGE
    ends = np.asarray(mesh.vertices)[np.asarray(mesh.face_adjacency_edges)[is_smooth]]
    length = np.maximum(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 1e-12)  # it is a divisor
    height = np.zeros(len(mesh.faces))
    for side in range(2):  # the two facets at each edge
        facet = facets[is_smooth, side]
        width = 2.0 * np.asarray(mesh.area_faces)[facet] / length  # height of the triangle over the common edge
        np.maximum.at(height, facet, 0.5 * width * np.tan(0.25 * angle[is_smooth]))
    return height


def _subdivide(corners: Array, chord_height: Array) -> tuple[Array, Array]:
    """Return facets, halved until the longest side of each is short compared with the part, or there are too many.

    :param corners: (F, 3, 3) [m].
    :param chord_height: (F,) [m]; the halves of a facet inherit it.
    :returns: corners (G, 3, 3) [m] and chord heights (G,) [m] of the halved facets.
    """
    limit = float(np.ptp(corners.reshape(-1, 3), axis=0).max()) / _SIDES_PER_PART
    while True:
        side = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)  # from corner i to i + 1
        longest_side = np.argmax(side, axis=1)
        is_long = side.max(axis=1) > limit
        if not is_long.any() or len(corners) + np.count_nonzero(is_long) > _MOST_FACETS:
            return corners, chord_height
        # a and b are the ends of the longest side
        rows, first_corner = np.flatnonzero(is_long), longest_side[is_long]
        a, b, c = (corners[rows, (first_corner + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        halves = [np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        corners = np.concatenate([corners[~is_long], *halves])
        chord_height = np.concatenate([chord_height[~is_long], chord_height[is_long], chord_height[is_long]])
