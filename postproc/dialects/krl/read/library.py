"""Routines by name: in the file that calls them, in the folder of the program, in the folders that the cell names."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np

from postproc.dialects.krl.language.routines import Module, Routine, routines
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.read import plain_lines
from postproc.dialects.krl.read.folder_files import GLOBAL_ROUTINE, FolderFiles, has
from postproc.errors import ProgramError, together


class Library:
    """Finds what a program calls.

    :param files: in which it is looked for, beside the program.
    :ivar faults: name of a routine → why the file that it stands in cannot be read.
    """

    def __init__(self, program: Module, files: FolderFiles) -> None:
        self.program, self.files = program, files
        self.faults: dict[str, str] = {}
        self._modules: dict[Path, Module | None] = {}
        self._found: dict[str, tuple[Module, Routine] | None] = {}

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
        for file, path in self.files.paths.items():
            if file.endswith(".SUB") and (module := self._module(path)) is not None:
                yield module

    def found(self) -> Iterator[tuple[Module, Routine]]:
        """Yield the routines of other files that were looked for and found."""
        yield from (found for found in self._found.values() if found is not None)

    def read(self) -> Iterator[Module]:
        """Yield the files that were read."""
        yield from (module for module in self._modules.values() if module is not None)

    def programs(self) -> frozenset[str]:
        """Return the names of the programs of all folders, upper case."""
        return frozenset(path.stem.upper() for path in self.files.paths.values() if path.suffix.upper() != ".DAT")

    def names(self) -> frozenset[str]:
        """Return the names of the programs and GLOBAL routines of all folders, upper case."""
        paths = (path for path in self.files.paths.values() if path.suffix.upper() != ".DAT")
        return self.programs().union(*(self.files.declared(path, GLOBAL_ROUTINE) for path in paths))

    def users(self, routines: Collection[Routine]) -> Mapping[str, tuple[str, ...]]:
        """Return which programs that were not read name routines, by the file of these."""
        read = {module.source.document.name.upper() for module in (self.program, *self.read())}
        unread = [path for file, path in self.files.paths.items() if not file.endswith(".DAT") and file not in read]
        found: dict[str, tuple[str, ...]] = {}
        for routine in sorted(routines, key=lambda routine: routine.first):
            called = re.compile(rf"^[^;\r\n]*\b{re.escape(routine.name)}[ \t]*\(".encode(), re.I | re.M)
            file = routine.source.document.name
            found[file] = tuple(sorted({*found.get(file, ()), *(p.name for p in unread if has(p, called))}))
        return found

    def _search(self, name: str) -> tuple[Module, Routine] | None:
        program = self.program.routines.get(name)
        if program is not None and (program.public or name == self.program.name):
            return self.program, program
        path = self.files.paths.get(f"{name}.SRC")
        if path is not None:
            module = self._module(path, name)
            routine = module.main(name) if module is not None else None
            if module is not None and routine is not None:
                return module, routine
        for file, path in self.files.paths.items():
            if file.endswith(".SRC") and name in self.files.declared(path, GLOBAL_ROUTINE):
                module = self._module(path, name)
                if module is not None and name in module.routines:
                    return module, module.routines[name]
        return None

    def _module(self, path: Path, name: str = "") -> Module | None:
        if path not in self._modules:
            self._modules[path] = None
            try:
                source = self.files.source(path)
                self._modules[path] = module_of(source, self._data(path))
            except ProgramError as cause:
                self.faults[name] = str(cause)
        return self._modules[path]

    def _data(self, path: Path) -> Source | None:
        data = self.files.paths.get(f"{path.stem.upper()}.DAT")
        if data is None or data.parent != path.parent:
            return None
        try:
            return self.files.source(data)
        except ProgramError:
            return None  # its variables have no values then


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
