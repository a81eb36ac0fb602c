"""Files that the programs of a folder call, so that a change of one of them counts as a change of the program."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from pathlib import Path

from postproc.cell import Cell
from postproc.dialects import registry
from postproc.dialects.dialect import WithCalledFiles
from postproc.errors import InputError, ProgramError

_FolderState = frozenset[tuple[str, int, int]]
"""Names, sizes [bytes] and times of change [ns] of the files of a folder."""


class CalledFiles:
    """Files that each program of a folder may call; they are searched for again when a file of the folders changes.

    :param folder: folder of the programs.
    :param dialect: format in which all programs are read; None: by the extension.
    :ivar folders: the folders in which files are searched for: that of the programs, and those of `[krl] search`.
    """

    def __init__(self, folder: Path, dialect: str | None = None) -> None:
        self._folder, self._dialect = folder, dialect
        self.folders: tuple[Path, ...] = (folder,)
        self._cell: Cell | None = None
        self._state: dict[Path, _FolderState] = {}
        self._programs: frozenset[Path] = frozenset()
        self._called_files: dict[Path, list[Path]] = {}

    def update(self, programs: Collection[Path], cell: Cell | None) -> None:
        """Search for the called files if programs, cell or a file of the folders have changed since the last update.

        :param cell: the cell of the programs; None: it is unusable, and no files are known.
        :raises OSError: a folder cannot be read, or is gone since the last update.
        """
        search = [] if cell is None else [Path(cell.folder) / name for name in cell.krl.search]
        folders = (self._folder, *search)
        state = {folder: self._state_of(folder) for folder in folders}
        if (state, frozenset(programs), cell) == (self._state, self._programs, self._cell):
            return
        self._called_files = {} if cell is None else self._find_files(sorted(programs), cell)
        self.folders, self._state, self._programs, self._cell = folders, state, frozenset(programs), cell

    def files_of(self, program: Path) -> list[Path]:
        """Return the files that a program may call, as of the last update; without those that did not exist."""
        return self._called_files.get(program, [])

    def _state_of(self, folder: Path) -> _FolderState:
        """Return the state of a folder; empty if it has never existed.

        :raises OSError: the folder cannot be read, or is gone since the last update.
        """
        try:
            with os.scandir(folder) as entries:
                status_of_name = {entry.name: entry.stat() for entry in entries if entry.is_file()}
        except FileNotFoundError:
            if not self._state.get(folder) or folder.is_dir():  # a file has gone between the two calls
                return frozenset()
            raise
        return frozenset((name, status.st_size, status.st_mtime_ns) for name, status in status_of_name.items())

    def _find_files(self, programs: Sequence[Path], cell: Cell) -> dict[Path, list[Path]]:
        """Return the files that each program may call; programs whose dialect is unusable have none."""
        programs_of_dialect: dict[str, list[Path]] = {}
        for path in programs:
            try:
                programs_of_dialect.setdefault(registry.dialect_of_file(path, self._dialect).name, []).append(path)
            except (ProgramError, InputError):  # reported when the program is converted
                continue
        called_files: dict[Path, list[Path]] = {}
        for name, paths in programs_of_dialect.items():
            dialect = registry.dialect_of_name(name)
            if isinstance(dialect, WithCalledFiles):
                called_files |= dialect.called_files(paths, cell)
        return called_files
