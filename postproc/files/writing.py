"""Write files that belong together: all of them are replaced, or none. Records state which program they belong to.

A record, a JSON file, names the files that were written with it and the SHA-256 of each. A single TOML file carries its
own in its first line. A file that no record names, or that was changed since, is not replaced.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import tomli_w
from msgspec import Struct

from postproc import interrupts
from postproc.errors import InputError, first_of
from postproc.files.locking import lock

_LISTED_FILES = 5
"""Largest number of files that a message names."""


class FileEntry(Struct, frozen=True):
    """A file that was written with a record."""

    name: str
    sha256: str


def json_bytes(content: object) -> bytes:
    """Return structures, mappings and lists as JSON in UTF-8, indented, with a line end.

    :raises ValueError: a number is NaN or infinite.
    """
    plain = msgspec.to_builtins(content)
    return (json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode(errors="backslashreplace")


def add_record(
    contents: Mapping[str, bytes | Iterable[bytes]], name: str, render: Callable[[list[FileEntry]], bytes]
) -> dict[str, bytes | Iterable[bytes]]:
    """Return contents for `write_whole`, followed by their record.

    :param contents: file name → content.
    :param name: of the record.
    :param render: makes the record, which holds the entries as ``files``; called when all others are written.
    """
    entries: list[FileEntry] = []

    def digested(name: str, pieces: Iterable[bytes]) -> Iterator[bytes]:
        """Yield the pieces of a file as they are; at its end, note its SHA-256."""
        digest = hashlib.sha256()
        for piece in pieces:
            digest.update(piece)
            yield piece
        entries.append(FileEntry(name, digest.hexdigest()))

    def rendered_record() -> Iterator[bytes]:
        """Yield the record, which is made only when the other files have been written."""
        yield render(entries)

    digested_contents = {
        file_name: digested(file_name, [content] if isinstance(content, bytes) else content)
        for file_name, content in contents.items()
    }
    return {**digested_contents, name: rendered_record()}


def find_foreign_files(folder: Path, names: Iterable[str], record: str) -> list[Path]:
    """Return the paths of files that exist and that postproc did not write, or that were changed since.

    :param names: names of files of the folder.
    :param record: name of the file with the names and digests of the files that were written. If it is missing or no
        such record, all files that exist are foreign.
    """
    digests = _recorded_digests(folder / record)
    return [
        path
        for path in (folder / name for name in names)
        if path.exists() and (digests is None or (path.name != record and digests.get(path.name) != _digest(path)))
    ]


def recorded_files(record: Path) -> dict[str, str]:
    """Return the files that a record lists: name → SHA-256; empty if it is no record of postproc."""
    return _recorded_digests(record) or {}


def recorded_names(record: Path, key: str) -> list[str]:
    """Return the names that a record contains under a key; empty without the key, or if it is no record of postproc."""
    try:
        return [str(name) for name in json.loads(record.read_bytes())[key]]
    except (OSError, ValueError, KeyError, TypeError):
        return []


def recorded_text(record: Path, key: str) -> str:
    """Return the text that a record contains under a key; empty without the key, or if it is no record of postproc."""
    try:
        return str(json.loads(record.read_bytes())[key])
    except (OSError, ValueError, KeyError, TypeError):
        return ""


def seal(text: bytes) -> bytes:
    """Return a text with the SHA-256 of its other lines added to the first one, which is a comment."""
    head, _, body = text.partition(b"\n")
    return b"%s SHA-256 of what follows: %s\n%s" % (head, hashlib.sha256(body).hexdigest().encode(), body)


def find_foreign_file(path: Path) -> list[Path]:
    """Return the path in a list if the file exists and was not written with `seal`, or was changed since.

    `seal` adds to the first line the SHA-256 of all that follows. The list is empty for a file that is missing, or as
    it was written.
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
            f"not written by postproc, or changed since: {path_list(paths)}",
            advice="Nothing was written. Choose another place with -o, or replace the files with --overwrite.",
        )


def path_list(paths: Sequence[Path]) -> str:
    """Return paths as text: the first ones, and the number of others."""
    return first_of([str(path) for path in paths], _LISTED_FILES)


def _recorded_digests(path: Path) -> dict[str, str] | None:
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


_STAGE_PREFIX, _STAGE_SUFFIX = ".postproc-", ".tmp"
"""Beginning and end of the name of the folder that files are written in at first."""


class StagedFiles(Struct, frozen=True):
    """Files that are complete, in a folder of their own inside the one that they are for.

    :param path: of that folder.
    :param names: of the files. The first is the last to appear in its place, and the first to go.
    """

    path: Path
    names: tuple[str, ...]


def write_whole(folder: Path, contents: Mapping[str, bytes | Iterable[bytes]]) -> list[Path]:
    """Write files so that all are replaced, or none, also where several processes write into a folder.

    A signal interrupts while the files are made, and is held back while they are replaced.

    :param folder: made if needed.
    :param contents: file name → bytes, or pieces of bytes, which may be made only as they are written, in this order.
    :returns: the paths written.
    :raises InputError: the folder or a file cannot be written; the message names it.
    """
    with interrupts.defer():
        with interrupts.allow():  # another process may hold the lock for long
            folder_lock = contextlib.ExitStack()
            folder_lock.enter_context(lock([folder]))
        with folder_lock:
            with interrupts.allow():
                file_set = stage(folder, contents)  # in a folder of their own, so that nothing is replaced yet
            return replace(folder, [file_set])


def stage(folder: Path, contents: Mapping[str, bytes | Iterable[bytes]]) -> StagedFiles:
    """Write files into a new folder inside `folder` and sync them; `replace` puts them in their places.

    :param contents: see `write_whole`.
    :raises InputError: the folder or a file cannot be written; the message names it.
    """
    with _errors_that_name_file(folder, contents) as paths:
        folder.mkdir(parents=True, exist_ok=True)
        for name in contents:
            if (folder / name).is_dir():
                paths.append(folder / name)
                raise IsADirectoryError(errno.EISDIR, "a folder of that name is in the way")
        path = Path(tempfile.mkdtemp(suffix=_STAGE_SUFFIX, prefix=_STAGE_PREFIX, dir=folder))
        try:
            (path / "new").mkdir()
            (path / "old").mkdir()
            for name, content in contents.items():
                paths.append(folder / name)
                _write(path / "new" / name, content)
        except BaseException:
            shutil.rmtree(path, ignore_errors=True)
            raise
    return StagedFiles(path, tuple(contents))


def replace(folder: Path, file_sets: Sequence[StagedFiles], obsolete: Sequence[str] = ()) -> list[Path]:
    """Put staged files, which are complete in a folder of their own, in their places: all of them, or none.

    The caller has locked the folder. The files that they replace are moved out of the way, then the new ones take their
    places. So at any moment, also if the process is killed: if the first file of a set is there, the others belong to
    it. On any failure the old ones come back.

    :param obsolete: names of files that are removed with those that are replaced, if they are there.
    :returns: the paths written.
    :raises InputError: a file cannot be replaced; the message names it.
    """
    # the first file of each set is moved away before all others, and its new version comes last
    first_names = [file_set.names[0] for file_set in file_sets]
    names = list(dict.fromkeys([*first_names, *(name for file_set in file_sets for name in file_set.names)]))
    with interrupts.defer():
        try:
            with _errors_that_name_file(folder, names):
                _replace(file_sets, folder, names, obsolete)
        finally:
            for file_set in file_sets:
                discard(file_set)
    return [folder / name for file_set in file_sets for name in file_set.names]


def discard(file_set: StagedFiles) -> None:
    """Remove staged files, unless files that they should have replaced could not be put back."""
    if not any(file_set.path.glob("old/*")):
        shutil.rmtree(file_set.path, ignore_errors=True)


def remove_leftovers(folder: Path) -> None:
    """Remove staged files of processes that were killed. The caller has locked the folder."""
    for path in folder.glob(f"{_STAGE_PREFIX}*{_STAGE_SUFFIX}"):
        shutil.rmtree(path, ignore_errors=True)


@contextlib.contextmanager
def _errors_that_name_file(folder: Path, names: Collection[str]) -> Iterator[list[Path]]:
    """Turn an `OSError` inside the context into an `InputError` that names a file.

    The error names the file that the operating system reports, if it is among `names`; else the last of the paths.

    :param names: names of files of the folder that the error may name.
    :returns: paths; the caller adds each file when it begins to write it.
    :raises InputError: an `OSError` was raised.
    """
    paths = [folder]
    try:
        yield paths
    except OSError as cause:
        name = Path(cause.filename or "").name
        raise InputError(
            f"cannot be written ({cause.strerror or cause})",
            file=str(folder / name if name in names else paths[-1]),
            advice="Nothing was written; existing files are unchanged. Check the folder, its rights and the free "
            "space, and that no other program has the file open.",
        ) from cause


def _write(path: Path, content: bytes | Iterable[bytes]) -> None:
    """Write a file and wait until it is on the disk, so that a rename afterwards is safe."""
    with path.open("wb") as file:
        file.writelines([content] if isinstance(content, bytes) else content)
        file.flush()
        os.fsync(file.fileno())


def _replace(file_sets: Sequence[StagedFiles], folder: Path, names: Sequence[str], obsolete: Sequence[str]) -> None:
    """Put staged files in the place of old ones; on a failure the old ones come back.

    A single file without obsolete ones is replaced in one step. Else the old files are moved out of the way first.

    :param names: of all files, in the order in which they are moved away; new ones appear in the opposite order.
    :param obsolete: names of old files that are removed.
    :raises InputError: old files could not be put back; other errors are raised as they are.
    """
    staged_path = {name: file_set.path / "new" / name for file_set in file_sets for name in file_set.names}
    old_names: list[str] = []  # moved away so far
    new_names: list[str] = []  # in their places so far
    old_folder = file_sets[0].path / "old"
    try:
        is_single_step = len(names) == 1 and not obsolete
        for name in (*obsolete, *(() if is_single_step else names)):
            if (folder / name).exists() or (folder / name).is_symlink():
                (folder / name).rename(old_folder / name)
                old_names.append(name)
        for name in reversed(names):
            staged_path[name].replace(folder / name)
            new_names.append(name)
    except BaseException as cause:
        for name in new_names:
            (folder / name).unlink(missing_ok=True)
        for name in old_names:
            with contextlib.suppress(OSError):
                (old_folder / name).rename(folder / name)
        stranded_names = sorted(path.name for path in old_folder.iterdir())
        if stranded_names:
            problem = f"could not be put back: {', '.join(stranded_names)}; the new ones could not be written ({cause})"
            raise InputError(problem, file=str(old_folder), advice=f"Move them to {folder} by hand.") from cause
        raise
    shutil.rmtree(old_folder, ignore_errors=True)


def toml(content: object, comment: str) -> bytes:
    """Return a msgspec structure, or plain data, as TOML in UTF-8 below a line of comment.

    Numbers have ten digits; what has its default is left out. A list of numbers is one line: a number a line makes the
    covariance of a robot twice as large.
    """
    text = _LIST_OF_NUMBERS.sub(lambda match: f"[{' '.join(match[1].split())}]", tomli_w.dumps(_builtins(content)))
    return f"# {comment}\n{text}".encode()


_LIST_OF_NUMBERS = re.compile(r"\[\n\s*([-+.\deE]+(?:,\s+[-+.\deE]+)*),?\s*\]")
"""A list of numbers over several lines, as tomli_w writes it; strings have no line breaks, so it is in none."""


def _builtins(value: Any) -> Any:
    """Return a record as builtins without its defaults; floats have ten digits."""
    if isinstance(value, msgspec.Struct):
        fields = ((field, getattr(value, field.name)) for field in msgspec.structs.fields(value))
        return {
            field.encode_name: _builtins(field_value)
            for field, field_value in fields
            if field.required or field_value != _default(field)
        }
    if isinstance(value, Mapping):
        return {name: _builtins(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_builtins(entry) for entry in value]
    return float(f"{value:.10g}") if isinstance(value, float) else value


def _default(field: msgspec.structs.FieldInfo) -> object:
    """Return the default of a field that has one."""
    return field.default if field.default_factory is msgspec.NODEFAULT else field.default_factory()
