"""Records of a folder: which program each written file belongs to.

A record, a JSON file, names those that were written with it and the SHA-256 of each; a single TOML file carries its own
in its first line. A file that is not named there, or was changed since, is not ours to replace.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypedDict

from postproc.errors import InputError

_SHOWN = 5
"""Largest number of files that a message names."""


class FileEntry(TypedDict):
    """A file that was written with a record."""

    name: str
    sha256: str


def with_record(
    contents: Mapping[str, bytes | Iterable[bytes]], name: str, render: Callable[[list[FileEntry]], bytes]
) -> dict[str, bytes | Iterable[bytes]]:
    """Return contents for `write_whole`, followed by their record.

    :param contents: file name → content.
    :param name: of the record.
    :param render: makes the record, which holds the entries as ``files``; called when all others are written.
    """
    entries: list[FileEntry] = []

    def digested(name: str, pieces: Iterable[bytes]) -> Iterator[bytes]:
        digest = hashlib.sha256()
        for piece in pieces:
            digest.update(piece)
            yield piece
        entries.append({"name": name, "sha256": digest.hexdigest()})

    def last() -> Iterator[bytes]:
        yield render(entries)

    made = {n: digested(n, [c] if isinstance(c, bytes) else c) for n, c in contents.items()}
    return {**made, name: last()}


def foreign(folder: Path, names: Iterable[str], record: str) -> list[Path]:
    """Return those of the files that exist and are not as postproc wrote them.

    :param record: name of the record.
    """
    known = _read(folder / record)
    return [
        path
        for path in (folder / name for name in names)
        if path.exists() and (known is None or (path.name != record and known.get(path.name) != _digest(path)))
    ]


def recorded(record: Path) -> dict[str, str]:
    """Return the files that a record lists: name → SHA-256; empty if it is no record of postproc."""
    return _read(record) or {}


def noted(record: Path, key: str) -> list[str]:
    """Return the names that a record contains under a key; empty without the key, or if it is no record of postproc."""
    try:
        return [str(name) for name in json.loads(record.read_bytes())[key]]
    except (OSError, ValueError, KeyError, TypeError):
        return []


def sealed(text: bytes) -> bytes:
    """Return a text with the SHA-256 of its other lines added to the first one, which is a comment."""
    head, _, body = text.partition(b"\n")
    return b"%s SHA-256 of what follows: %s\n%s" % (head, hashlib.sha256(body).hexdigest().encode(), body)


def foreign_single(path: Path) -> list[Path]:
    """Return the path in a list if the file exists and was not written with `sealed`, or changed since; else no
    path.
    """
    if not path.exists():
        return []
    head, _, body = path.read_bytes().partition(b"\n") if path.is_file() else (b"", b"", b"")
    return [] if head.endswith(hashlib.sha256(body).hexdigest().encode()) else [path]


def refuse(paths: Sequence[Path]) -> None:
    """Refuse to replace files that postproc did not write.

    :raises InputError: there are some.
    """
    if paths:
        raise InputError(
            f"not written by postproc, or changed since: {listed(paths)}",
            advice="Nothing was written. Choose another place with -o, or replace the files with --overwrite.",
        )


def listed(paths: Sequence[Path]) -> str:
    """Return paths as text: the first ones, and the number of others."""
    more = f" and {len(paths) - _SHOWN} more" if len(paths) > _SHOWN else ""
    return ", ".join(str(path) for path in paths[:_SHOWN]) + more


def _read(path: Path) -> dict[str, str] | None:
    """Return the files that a record lists: name → SHA-256; None if it is no record of postproc."""
    try:
        return {entry["name"]: entry["sha256"] for entry in json.loads(path.read_bytes())["files"]}
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file; empty if it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""
