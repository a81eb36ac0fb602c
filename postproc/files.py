"""Strict reading of TOML and CSV, and writing that leaves whole files or none."""

from __future__ import annotations

import contextlib
import io
import math
import os
import tempfile
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from postproc.errors import MOST, InputError, together
from postproc.frames import Array

T = TypeVar("T")
Error = TypeVar("Error", bound=InputError)


def read_text(path: Path, error: type[InputError]) -> str:
    """Return the text of a UTF-8 file (BOM allowed); `error` names the file when it cannot be read."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise error("no such file", file=str(path)) from None
    except OSError as cause:
        raise error(f"cannot be read ({cause.strerror})", file=str(path)) from cause
    except UnicodeDecodeError as cause:
        raise error(f"not UTF-8 text (byte {cause.start})", file=str(path), advice="Save the file as UTF-8.") from cause


def read_toml(path: Path, structure: type[T], error: type[InputError]) -> T:
    """Read a TOML file into a msgspec structure.

    Unknown keys, missing keys, wrong types, NaN and infinity raise `error`; the message names the key and,
    for an unknown one, the valid ones.
    """
    text = read_text(path, error)
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as cause:
        raise error(f"not valid TOML: {cause}", file=str(path)) from cause
    for key, value in _numbers(data, ""):
        if not math.isfinite(value):
            raise error(f"{key} is {value}", file=str(path), advice="Give a finite number.")
    return convert(data, structure, str(path), error)


def convert(data: object, structure: type[T], file: str, error: type[InputError]) -> T:
    """Check plain data against a msgspec structure; see `read_toml`."""
    try:
        return msgspec.convert(data, structure)
    except msgspec.ValidationError as cause:
        message = str(cause)
        advice = None
        if "unknown field" in message:
            at = message.split("`$")[-1].strip("`") if "`$" in message else ""
            keys = _valid_keys(structure, at)
            advice = f"Valid keys: {', '.join(keys)}." if keys else None
        raise error(message.replace("Object", "table"), file=file, advice=advice) from cause


def _numbers(data: object, key: str) -> Iterator[tuple[str, float]]:
    if isinstance(data, Mapping):
        for name, value in data.items():
            yield from _numbers(value, f"{key}.{name}" if key else str(name))
    elif isinstance(data, list):
        for index, value in enumerate(data):
            yield from _numbers(value, f"{key}[{index}]")
    elif isinstance(data, float):
        yield key, data


def _valid_keys(structure: object, at: str) -> list[str]:
    kind: Any = msgspec.inspect.type_info(structure)
    for part in at.replace("[...]", ".[...]").split("."):
        if isinstance(kind, msgspec.inspect.UnionType):
            kind = next((t for t in kind.types if not isinstance(t, msgspec.inspect.NoneType)), kind)
        if part == "[...]" and isinstance(kind, msgspec.inspect.DictType):
            kind = kind.value_type
        elif isinstance(kind, msgspec.inspect.StructType):
            kind = next((f.type for f in kind.fields if f.encode_name == part), kind)
    if isinstance(kind, msgspec.inspect.UnionType):
        kind = next((t for t in kind.types if isinstance(t, msgspec.inspect.StructType)), kind)
    return [f.encode_name for f in kind.fields] if isinstance(kind, msgspec.inspect.StructType) else []


def read_csv(
    path: Path,
    required: Sequence[str],
    optional: Sequence[str],
    error: type[Error],
    text_columns: Sequence[str] = (),
    may_be_empty: Sequence[str] = (),
) -> tuple[dict[str, Array], dict[str, list[str]], Array]:
    """Read a CSV file as `parse_csv` does; what is wrong in its rows is raised, all together."""
    numbers, texts, line, wrong = parse_csv(path, required, optional, error, text_columns, may_be_empty)
    if wrong:
        raise together(wrong)
    return numbers, texts, line


def parse_csv(
    path: Path,
    required: Sequence[str],
    optional: Sequence[str],
    error: type[Error],
    text_columns: Sequence[str] = (),
    may_be_empty: Sequence[str] = (),
) -> tuple[dict[str, Array], dict[str, list[str]], Array, list[Error]]:
    """Read a CSV file with a header line, comma separated, `.` as decimal point.

    :param required: columns that must be there.
    :param optional: columns that may be there.
    :param error: kind of the errors.
    :param text_columns: those of the columns that hold text.
    :param may_be_empty: those of the numeric columns whose cells may be empty: NaN.
    :returns: numeric columns by name (each (n,)), text columns by name, the 1-based line of each row (n,), and what is
        wrong in single rows: a row of wrong length, which is left out, or a value that is no finite number, NaN here.
    :raises InputError: (`error`) the file cannot be read, or its header line cannot be used.
    """
    import csv

    text = read_text(path, error)
    reader = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True)
    rows, lines, wrong = [], [], []
    try:
        header = _header(next(reader, []), path, required, optional, error)
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != len(header):
                problem, advice = f"{len(row)} values where the header has {len(header)}", None
                if len(row) == 1 and len(row[0].split(";")) == len(header):
                    problem, advice = "values separated by semicolons", _COMMAS
                wrong.append(error(problem, file=str(path), line=reader.line_num, text=",".join(row), advice=advice))
                continue
            rows.append(row)
            lines.append(reader.line_num)
    except csv.Error as cause:
        raise error(f"not a valid CSV file: {cause}", file=str(path), line=reader.line_num) from cause
    columns = dict(zip(header, zip(*rows, strict=True), strict=True)) if rows else dict.fromkeys(header, ())
    numeric: dict[str, Array] = {}
    for name, values in columns.items():
        if name not in text_columns:
            numeric[name], bad = _numeric(values, empty_is_nan=name in may_be_empty)
            wrong += [
                error(
                    f"column {name} is not a finite number: {values[place][:80]!r}",
                    file=str(path),
                    line=lines[place],
                    advice="Use a decimal point, no units and no empty cells.",
                )
                for place in bad[: MOST + 1].tolist()
            ]
    texts = {name: [v.strip() for v in columns[name]] for name in text_columns if name in columns}
    return numeric, texts, np.array(lines, dtype=float), wrong


_COMMAS = "Separate the columns by commas, and write numbers with a decimal point (as English Excel saves CSV)."


def _header(
    row: Sequence[str], path: Path, required: Sequence[str], optional: Sequence[str], error: type[Error]
) -> list[str]:
    """Return the names of the columns, each known, none twice, all required ones there."""
    header = [name.strip() for name in row]
    known = [*required, *optional]
    valid = f"Valid columns: {', '.join(known)}."
    if not any(header):
        raise error("empty file", file=str(path), advice=valid)
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in header[0]:
            raise error(f"columns separated by {name}", file=str(path), line=1, text=row[0], advice=_COMMAS)
    wrong = [f"unknown column {name!r}" for name in dict.fromkeys(header) if name not in known]
    wrong += [f"column {name!r} stands twice" for name in dict.fromkeys(header) if header.count(name) > 1]
    missing = [name for name in required if name not in header]
    if missing:
        wrong.append(f"missing column {', '.join(missing)}")
    if wrong:
        raise error("; ".join(wrong), file=str(path), line=1, advice=valid)
    return header


def _numeric(values: Sequence[str], *, empty_is_nan: bool) -> tuple[Array, NDArray[np.int64]]:
    """Return a column as numbers, NaN where they are none, and the places (n,) of those that are wrong."""
    empty = np.array([empty_is_nan and not value.strip() for value in values], dtype=bool)
    try:
        column = np.array(values, dtype=float)
    except ValueError:
        column = np.full(len(values), np.nan)
        for index, value in enumerate(values):
            with contextlib.suppress(ValueError):
                column[index] = float(value)
    bad = np.flatnonzero(~np.isfinite(column) & ~empty)
    column[bad] = np.nan
    return column, bad


def write_whole(folder: Path, contents: Mapping[str, bytes | Iterable[bytes]]) -> list[Path]:
    """Write files so that all appear whole, or none.

    Every file is written under a temporary name in `folder` (made if needed) and synced; only when all are
    there are they renamed. On any failure, also an interrupt, the temporary files are removed.

    :param folder: where to write.
    :param contents: file name → bytes, or pieces of bytes, which may be made only as they are written.
    :returns: the paths written.
    :raises InputError: the folder or a file cannot be written.
    """
    pending: list[tuple[str, Path]] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            handle, temporary = tempfile.mkstemp(prefix=f".{name}.", suffix=".tmp", dir=folder)
            pending.append((temporary, folder / name))
            with os.fdopen(handle, "wb") as file:
                file.writelines([content] if isinstance(content, bytes) else content)
                file.flush()
                os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        for temporary, final in pending:
            Path(temporary).chmod(0o666 & ~umask)
            Path(temporary).replace(final)
    except OSError as cause:
        raise InputError(
            f"cannot be written ({cause.strerror or cause})",
            file=str(folder),
            advice="Nothing was written for this program. Check the folder, its rights and the free space.",
        ) from cause
    finally:
        for temporary, _ in pending:
            Path(temporary).unlink(missing_ok=True)
    return [final for _, final in pending]
