"""Writing files that belong together: all of them are replaced, or none."""

from __future__ import annotations

import contextlib
import errno
import filecmp
import os
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import tomli_w

from postproc import interrupts
from postproc.errors import InputError

if sys.platform == "win32":

    def _lock(_file: BinaryIO) -> None:
        """Nothing to do: an open file cannot be removed on Windows."""

    @contextlib.contextmanager
    def alone_in(_folder: Path) -> Iterator[None]:
        """Nothing to do: folders cannot be locked on Windows."""
        yield
else:
    import fcntl

    def _lock(file: BinaryIO) -> None:
        """Lock a file until it is closed, or its process ends however that may be; `OSError` if another has."""
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    @contextlib.contextmanager
    def alone_in(folder: Path) -> Iterator[None]:
        """Wait until no other process is in here with a folder, which is made if needed; each is let in alone.

        For files that several programs need: what was seen of them stays so until they are written. Where there are no
        locks, as on some network drives, none waits.
        """
        descriptor = None
        try:
            with contextlib.suppress(OSError):
                folder.mkdir(parents=True, exist_ok=True)
                descriptor = os.open(folder, os.O_RDONLY)
                fcntl.flock(descriptor, fcntl.LOCK_EX)
            yield
        finally:
            if descriptor is not None:
                os.close(descriptor)


_STAGE, _LOCK = (".postproc-", ".tmp"), "lock"
"""Prefix and suffix of the folder that files are written in at first; the file in it that its writer keeps open."""


def write_whole(
    folder: Path,
    contents: Mapping[str, bytes | Iterable[bytes]],
    obsolete: Sequence[str] = (),
    shared: Mapping[str, bytes | None] | None = None,
) -> list[Path]:
    """Write files so that all are replaced, or none.

    All are written in a folder of their own inside `folder` (made if needed) and synced; only then those that they
    replace are moved out of the way, the first named one first, and the new ones take their place, the first named one
    last. So at any moment, also if the process is killed: if the first is there, the others belong to it. On any
    failure the old ones come back. A signal is heard while the files are made, and held back while they are replaced.

    :param folder: where to write.
    :param contents: file name → bytes, or pieces of bytes, which may be made only as they are written, in this order.
    :param obsolete: names of files that are removed with those that are replaced, if they are there.
    :param shared: files that another process may write at the same time, and what stood there when it was looked at
        (None: nothing). What came there since, and is not what is written here, is not replaced.
    :returns: the paths written.
    :raises InputError: the folder or a file cannot be written, or a shared file came there since; the message names it.
    """
    with interrupts.held_back():
        at = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for at in (folder / name for name in contents):
                if at.is_dir():
                    raise IsADirectoryError(errno.EISDIR, "a folder of that name is in the way")
            at = folder
            with _stage(folder) as stage:
                with interrupts.heard():
                    for name, content in contents.items():
                        at = folder / name
                        _write(stage / "new" / name, content)
                at = folder
                try:
                    _replace(stage, folder, list(contents), obsolete, shared or {})
                except FileExistsError as cause:
                    raise InputError(
                        "a file of another program came there meanwhile",
                        file=str(cause.filename),
                        advice="Nothing was written. Write this program into another folder with -o.",
                    ) from cause
        except OSError as cause:
            name = Path(cause.filename or "").name
            raise InputError(
                f"cannot be written ({cause.strerror or cause})",
                file=str(folder / name if name in contents else at),
                advice="Nothing was written, what was there is as it was. Check the folder, its rights and the free "
                "space, and that no other program has the file open.",
            ) from cause
    return [folder / name for name in contents]


def remove_leftovers(folder: Path) -> None:
    """Remove what processes that were killed while they wrote left in a folder; not what is being written now."""
    for stage in folder.glob("*".join(_STAGE)):
        with contextlib.suppress(OSError):
            with (stage / _LOCK).open("r+b") as file:
                _lock(file)
            (stage / _LOCK).unlink()
            shutil.rmtree(stage)


@contextlib.contextmanager
def _stage(folder: Path) -> Iterator[Path]:
    """Make a folder with room for new files and old ones, and remove it unless old ones had to stay in it."""
    stage = Path(tempfile.mkdtemp(_STAGE[1], _STAGE[0], dir=folder))
    try:
        with (stage / _LOCK).open("wb") as file:
            with contextlib.suppress(OSError):  # some network drives have no locks
                _lock(file)
            (stage / "new").mkdir()
            (stage / "old").mkdir()
            yield stage
    finally:
        if not any(stage.glob("old/*")):
            shutil.rmtree(stage, ignore_errors=True)


def _write(path: Path, content: bytes | Iterable[bytes]) -> None:
    with path.open("wb") as file:
        file.writelines([content] if isinstance(content, bytes) else content)
        file.flush()
        os.fsync(file.fileno())


def _replace(
    stage: Path, folder: Path, names: Sequence[str], obsolete: Sequence[str], shared: Mapping[str, bytes | None]
) -> None:
    """Put new files in the place of old ones; a single one in one step."""
    aside: list[str] = []
    placed: list[str] = []
    try:
        for name, known in shared.items():
            _refuse_newer(folder / name, known, stage / "new" / name)
        for name in (*obsolete, *(names if len(names) > 1 or obsolete else ())):
            if (folder / name).exists() or (folder / name).is_symlink():
                (folder / name).rename(stage / "old" / name)
                aside.append(name)
        for name in reversed(names):
            if name in shared and not _claimed(folder / name, stage / "new" / name):
                continue
            (stage / "new" / name).replace(folder / name)
            placed.append(name)
    except BaseException as cause:
        for name in placed:
            (folder / name).unlink(missing_ok=True)
        for name in aside:
            with contextlib.suppress(OSError):
                (stage / "old" / name).rename(folder / name)
        left = sorted(path.name for path in stage.glob("old/*"))
        if left:
            problem = f"could not be put back: {', '.join(left)}; the new ones could not be written ({cause})"
            raise InputError(problem, file=str(stage / "old"), advice=f"Move them to {folder} by hand.") from cause
        raise
    shutil.rmtree(stage / "old", ignore_errors=True)


def _refuse_newer(path: Path, known: bytes | None, new: Path) -> None:
    """Raise `FileExistsError` if a file is neither as it was known nor the new one."""
    there = path.read_bytes() if path.exists() else known
    if there != known and there != new.read_bytes():
        raise FileExistsError(errno.EEXIST, "another file came there", str(path))


def _claimed(path: Path, new: Path) -> bool:
    """Make an empty file; False where the same as the new one stands there already.

    :raises FileExistsError: something else stands there.
    """
    try:
        path.open("xb").close()
    except FileExistsError:
        if filecmp.cmp(path, new, shallow=False):
            return False
        raise
    return True


def toml(content: object, comment: str) -> bytes:
    """Return a msgspec structure, or plain data, as TOML in UTF-8 below a line of comment.

    Numbers have ten digits; what has its default is left out.
    """
    return f"# {comment}\n{tomli_w.dumps(_plain(content))}".encode()


def _plain(value: Any) -> Any:
    if isinstance(value, msgspec.Struct):
        fields = ((field, getattr(value, field.name)) for field in msgspec.structs.fields(value))
        return {field.encode_name: _plain(own) for field, own in fields if field.required or own != _default(field)}
    if isinstance(value, Mapping):
        return {name: _plain(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return float(f"{value:.10g}") if isinstance(value, float) else value


def _default(field: msgspec.structs.FieldInfo) -> object:
    return field.default if field.default_factory is msgspec.NODEFAULT else field.default_factory()
