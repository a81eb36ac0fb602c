"""The files in the folders of a program, and what they declare for all."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import cache, cached_property, lru_cache
from pathlib import Path

from msgspec.structs import replace

from postproc.dialects.krl.language.names import PURE, RESERVED, STANDARD
from postproc.dialects.krl.language.source import Source
from postproc.dialects.text import decode
from postproc.errors import ProgramError
from postproc.program import Document

_LARGEST = 20_000_000
"""Bytes of the largest file that is searched."""
GLOBAL_ROUTINE = re.compile(rb"^[ \t]*GLOBAL[ \t]+DEF(?:FCT[ \t]+\w+(?:[ \t]*\[[ ,\t]*\])?)?[ \t]+(\w+)", re.I | re.M)
_NO_CODE = re.compile(r"\"[^\"\r\n]*\"|;[^\r\n]*")
_CALL = re.compile(r"([A-Za-z_]\w*)[ \t]*\(", re.ASCII)
_MOTION = re.compile(r"\bS?(?:PTP|LIN|CIRC|SPL)", re.I)
_OF_THE_CONTROLLER = PURE | STANDARD | RESERVED | {"BAS"}
_OWN = re.compile(r"^[ \t]*(?:GLOBAL[ \t]+)?DEF(?:FCT[ \t]+\w+(?:[ \t]*\[[ ,\t]*\])?)?[ \t]+(\w+)", re.I | re.M)


class FolderFiles:
    """The `.src`, `.dat` and `.sub` files of some folders; the first folder that has one counts.

    :param documents: files that count instead of those of the same name in the folders.
    """

    def __init__(self, folders: Sequence[Path], documents: Sequence[Document] = ()) -> None:
        self._folders = folders
        self._given = {document.name.upper(): document for document in documents}

    @cached_property
    def paths(self) -> dict[str, Path]:
        """The files by name, upper case."""
        found: dict[str, Path] = {}
        for path in _listed(self._folders):
            found.setdefault(path.name.upper(), path)
        for name, document in self._given.items():
            found.setdefault(name, Path(document.folder) / document.name)
        return found

    @cached_property
    def _public(self) -> dict[str, Path]:
        """The `.src` files by the names, upper case, of their GLOBAL routines: all of them are read for it."""
        found: dict[str, Path] = {}
        for path in (path for name, path in self.paths.items() if name.endswith(".SRC")):
            for name in self.declared(path, GLOBAL_ROUTINE):
                found.setdefault(name, path)
        return found

    def called(self, code: str) -> set[Path]:
        """Return the `.src` files that code without comments may call."""
        names = {name.upper() for name in _CALL.findall(code)} - {name.upper() for name in _OWN.findall(code)}
        paths = {name: self.paths.get(f"{name}.SRC") for name in names - _OF_THE_CONTROLLER}
        found = {self._public.get(name) if path is None else path for name, path in paths.items()}
        return {path for path in found if path is not None}

    def reached(self, code: str) -> Iterator[str]:
        """Yield code, and that of the files that it calls, one through the other."""
        waiting, done = [code], set[Path]()
        while waiting:
            code = without_comments(waiting.pop())
            yield code
            new = sorted(self.called(code) - done)
            done.update(new)
            for path in new:
                with suppress(ProgramError):  # what calls it says so
                    waiting.append(self.source(path).text)

    def source(self, path: Path) -> Source:
        """Return the text of a file.

        :raises ProgramError: it cannot be read.
        """
        given = self._given.get(path.name.upper())
        if given is not None:
            return Source.of(given, 2)
        try:
            return Source.of(replace(decode(path.name, path.read_bytes()), folder=str(path.parent)), 2)
        except OSError as cause:
            raise ProgramError(f"cannot be read ({cause.strerror})", file=str(path)) from cause

    def declared(self, path: Path, pattern: re.Pattern[bytes]) -> frozenset[str]:
        """Return the names that a pattern finds in a file, upper case; none where it cannot be read."""
        given = self._given.get(path.name.upper())
        if given is not None:
            return _names(given.to_bytes(), pattern)
        try:
            stat = path.stat()
        except OSError:
            return frozenset()
        return _names_in(path, pattern, stat.st_mtime_ns, stat.st_size) if stat.st_size <= _LARGEST else frozenset()


def without_comments(text: str) -> str:
    """Return code without comments and strings."""
    return _NO_CODE.sub(" ", text)


def moving(paths: Sequence[Path], search: Sequence[Path]) -> dict[Path, set[Path]]:
    """Return the files with motions that each of some programs of one folder may call, one through the other.

    :param search: folders in which they are looked for after that of the programs.
    """
    files = FolderFiles([paths[0].parent, *search])

    @cache
    def called(path: Path) -> tuple[bool, set[Path]]:
        try:
            code = without_comments(decode(path.name, path.read_bytes()).text)
        except (OSError, ProgramError):  # what calls it says so
            return False, set()
        return _MOTION.search(code) is not None, files.called(code)

    found: dict[Path, set[Path]] = {}
    for path in paths:
        reached: set[Path] = set()
        new = called(path)[1]
        while new:
            reached |= new
            new = set().union(*(called(other)[1] for other in new)) - reached
        found[path] = {other for other in reached if called(other)[0]}
    return found


def _listed(folders: Sequence[Path]) -> Iterator[Path]:
    for folder in folders:
        try:
            yield from sorted(path for path in folder.iterdir() if path.suffix.upper() in (".SRC", ".DAT", ".SUB"))
        except OSError:
            continue


def has(path: Path, pattern: re.Pattern[bytes]) -> bool:
    """Return whether a pattern is found in a file on the disk; not where it cannot be read."""
    try:
        return path.stat().st_size <= _LARGEST and pattern.search(path.read_bytes()) is not None
    except OSError:
        return False


@lru_cache(maxsize=4096)
def _names_in(path: Path, pattern: re.Pattern[bytes], modified: int, size: int) -> frozenset[str]:
    del modified, size  # a file that changes is read again
    try:
        return _names(path.read_bytes(), pattern)
    except OSError:
        return frozenset()


def _names(content: bytes, pattern: re.Pattern[bytes]) -> frozenset[str]:
    return frozenset(name.decode("ascii", "replace").upper() for name in pattern.findall(content))
