"""Routines by name: in the file that calls them, in the folder of the program, in the folders that the cell names."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from postproc.dialects.krl.language.routines import Module, Routine, routines
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.read import plain_lines
from postproc.dialects.text import decode
from postproc.errors import ProgramError, together
from postproc.program import Document

_GLOBAL = re.compile(rb"^[ \t]*GLOBAL[ \t]+DEF(?:FCT[ \t]+\w+(?:[ \t]*\[[ ,\t]*\])?)?[ \t]+(\w+)", re.I | re.M)
_LARGEST = 20_000_000
"""Bytes of the largest file that is searched for GLOBAL routines."""


class Library:
    """Finds what a program calls.

    :param documents: files that count instead of those of the same name in the folders.
    :ivar faults: name of a routine → why the file that it stands in cannot be read.
    """

    def __init__(self, program: Module, folders: Sequence[Path], documents: Sequence[Document] = ()) -> None:
        self.program, self.folders = program, folders
        self._given = {document.name.upper(): document for document in documents}
        self.faults: dict[str, str] = {}
        self._modules: dict[Path, Module | None] = {}
        self._found: dict[str, tuple[Module, Routine] | None] = {}
        self._listed: dict[str, Path] | None = None

    def find(self, name: str, caller: Module) -> tuple[Module, Routine] | None:
        """Return a routine and its module, as seen from the module that calls it; None if it is nowhere."""
        own = caller.routines.get(name)
        if own is not None:
            return caller, own
        if name not in self._found:
            self._found[name] = self._search(name)
        return self._found[name]

    def submit(self) -> Iterator[Module]:
        """Yield the submit programs (`.sub`), which run beside the program all the time."""
        for file, path in self._files().items():
            if file.endswith(".SUB") and (module := self._module(path)) is not None:
                yield module

    def read(self) -> Iterator[Module]:
        """Yield the files that were read."""
        yield from (module for module in self._modules.values() if module is not None)

    def names(self) -> frozenset[str]:
        """Return the names of the programs and GLOBAL routines of all folders, upper case."""
        paths = [path for path in self._files().values() if path.suffix.upper() != ".DAT"]
        return frozenset(path.stem.upper() for path in paths).union(*map(self._public_names, paths))

    def users(self, routines: Collection[Routine]) -> Mapping[str, tuple[str, ...]]:
        """Return which programs that were not read name routines, by the file of these."""
        read = {module.source.document.name.upper() for module in (self.program, *self.read())}
        unread = [path for file, path in self._files().items() if not file.endswith(".DAT") and file not in read]
        found: dict[str, tuple[str, ...]] = {}
        for routine in sorted(routines, key=lambda routine: routine.first):
            called = re.compile(rf"^[^;\r\n]*\b{re.escape(routine.name)}[ \t]*\(".encode(), re.I | re.M)
            file = routine.source.document.name
            found[file] = tuple(sorted({*found.get(file, ()), *(p.name for p in unread if _has(p, called))}))
        return found

    def _search(self, name: str) -> tuple[Module, Routine] | None:
        program = self.program.routines.get(name)
        if program is not None and (program.public or name == self.program.name):
            return self.program, program
        path = self._files().get(f"{name}.SRC")
        if path is not None:
            module = self._module(path, name)
            routine = module.main(name) if module is not None else None
            if module is not None and routine is not None:
                return module, routine
        for file, path in self._files().items():
            if file.endswith(".SRC") and name in self._public_names(path):
                module = self._module(path, name)
                if module is not None and name in module.routines:
                    return module, module.routines[name]
        return None

    def _files(self) -> dict[str, Path]:
        """Return the files of all folders by name, upper case; the first folder that has one counts."""
        if self._listed is None:
            self._listed = {}
            for folder in self.folders:
                for path in _listing(folder):
                    self._listed.setdefault(path.name.upper(), path)
            for file, document in self._given.items():
                self._listed.setdefault(file, Path(document.folder) / document.name)
        return self._listed

    def _module(self, path: Path, name: str = "") -> Module | None:
        if path not in self._modules:
            self._modules[path] = None
            try:
                source = self._source(path)
                self._modules[path] = module_of(source, self._data(path))
            except ProgramError as cause:
                self.faults[name] = str(cause)
        return self._modules[path]

    def _data(self, path: Path) -> Source | None:
        data = self._files().get(f"{path.stem.upper()}.DAT")
        if data is None or data.parent != path.parent:
            return None
        try:
            return self._source(data)
        except ProgramError:
            return None  # its variables have no values then

    def _source(self, path: Path) -> Source:
        given = self._given.get(path.name.upper())
        return _source(path) if given is None else Source.of(given, 2)

    def _public_names(self, path: Path) -> frozenset[str]:
        given = self._given.get(path.name.upper())
        return _public_names(path) if given is None else _named(given.to_bytes())


def module_of(source: Source, data: Source | None = None) -> Module:
    """Return the routines of a file.

    :raises ProgramError: a DEF has no END, or a motion stands outside of DEF … END.
    """
    plain = np.concatenate([rows.line for rows in plain_lines.scan(source)])
    others = np.ones(len(source.starts), dtype=np.bool_)
    others[plain - 1] = False
    found, faults = routines(source, (np.flatnonzero(others) + 1).tolist(), plain.tolist())
    if faults:
        raise together(faults)
    return Module(source, found, data)


def _source(path: Path) -> Source:
    try:
        return Source.of(replace(decode(path.name, path.read_bytes()), folder=str(path.parent)), 2)
    except OSError as cause:
        raise ProgramError(f"cannot be read ({cause.strerror})", file=str(path)) from cause


def _listing(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if path.suffix.upper() in (".SRC", ".DAT", ".SUB"))
    except OSError:
        return []


def _public_names(path: Path) -> frozenset[str]:
    """Return the names of the GLOBAL routines of a file."""
    try:
        stat = path.stat()
    except OSError:
        return frozenset()
    return _names_in(path, stat.st_mtime_ns, stat.st_size) if stat.st_size <= _LARGEST else frozenset()


@lru_cache(maxsize=4096)
def _names_in(path: Path, modified: int, size: int) -> frozenset[str]:
    del modified, size  # a file that changes is read again
    try:
        return _named(path.read_bytes())
    except OSError:
        return frozenset()


def _has(path: Path, pattern: re.Pattern[bytes]) -> bool:
    try:
        return path.stat().st_size <= _LARGEST and pattern.search(path.read_bytes()) is not None
    except OSError:
        return False


def _named(content: bytes) -> frozenset[str]:
    return frozenset(name.decode("ascii", "replace").upper() for name in _GLOBAL.findall(content))
