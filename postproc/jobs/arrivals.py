"""Programs of a folder that are ready to be corrected by the window: unchanged for some time, with cell and forces.

As in `watching`, only scans of the folder decide. Both find the process of a program by `programs.process_of`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from postproc import cell as cells
from postproc.cell import Cell
from postproc.dialects import registry
from postproc.dialects.dialect import Calling
from postproc.errors import PostprocError
from postproc.jobs import inputs
from postproc.jobs.called_files import CalledFiles
from postproc.jobs.programs import find_jobs, is_utf8, process_of, states_forces
from postproc.jobs.watching import QUIET, FileStamp, Signature


class Arrivals:
    """State of the programs of a folder, from scan to scan.

    :param folder: the folder of the programs.
    :param output: folder of the results, with the process files.
    :param cell: cell file of all programs; no program is ready before it exists.
    """

    def __init__(self, folder: Path, output: Path, cell: Path) -> None:
        self.folder, self.output, self.cell = folder, output, cell
        self._last_changes: dict[Path, tuple[Signature, float]] = {}
        """Signature of the inputs of each program, and monotonic time of the scan that first had it [s]."""
        self._finished: dict[Path, Signature] = {}
        """Signature of the inputs with which each program was last converted, or passed to `finish`."""
        self._program_files: dict[Path, Signature] = {}
        """Signature of the files that each program is read from, at the last scan.

        While a command works on the program, that before the command."""
        self._busy: set[Path] = set()
        """Programs that a command worked on at the last scan."""
        self._called_files = CalledFiles(folder)

    def ready(self, time_s: float, busy: Collection[str] = ()) -> list[Path]:
        """Return the programs that are ready to be converted, sorted.

        A signature is the names, sizes and times of files: while it is equal, they have not changed. The inputs of
        ready programs differ from those of the last conversion, and have not changed for `QUIET` s. They have forces
        and can be read. Programs that others of the folder call are left out: they are converted with their callers.

        :param time_s: monotonic time [s].
        :param busy: names of programs that a command works on. It may write a process file or the cell. When it has
            ended, the inputs of these programs count as converted, unless a program itself has changed meanwhile.
        """
        if not self.cell.is_file():
            return []
        cell = self._load_cell()
        setup_files = [self.cell] if cell is None else self._setup_files(cell)
        paths = self._programs()
        self._called_files.update(paths, cell)
        ready_paths = []
        for path in paths:
            program_files = _signature([*_program_files(path), *self._called_files.files_of(path)])
            signature = (*program_files, *_signature([*self._force_files(path), *setup_files]))
            if path.name in busy:
                self._busy.add(path)
                self._program_files.setdefault(path, program_files)
                continue
            self._end_command(path, program_files, signature)
            if self._is_quiet(path, signature, time_s) and self._has_forces(path) and _is_readable(path):
                ready_paths.append(path)
        self._forget(paths)
        return self._main_programs(ready_paths) if ready_paths else []

    def _end_command(self, path: Path, program_files: Signature, signature: Signature) -> None:
        """Record that no command works on a program.

        If a command did so at the last scan, the inputs count as converted, unless the program itself has changed.

        :param program_files: signature of the program itself; `signature`: signature of all its inputs.
        """
        if path in self._busy:
            self._busy.remove(path)
            if self._program_files[path] == program_files:
                self._finished[path] = signature
        self._program_files[path] = program_files

    def _is_quiet(self, path: Path, signature: Signature, time_s: float) -> bool:
        """Return whether the inputs of a program are not converted yet, and have not changed for `QUIET` s.

        The time of a change is recorded.

        :param signature: signature of all its inputs; `time_s`: monotonic time [s].
        """
        if self._finished.get(path) == signature:
            return False
        last_signature, change_time = self._last_changes.get(path, ((), time_s))
        if last_signature != signature:
            self._last_changes[path] = (signature, time_s)
            return False
        return time_s - change_time >= QUIET

    def finish(self, path: Path) -> None:
        """Record that a ready program is being converted or need not be; it is ready again when its inputs change."""
        self._finished[path] = self._last_changes[path][0]

    def _forget(self, paths: Collection[Path]) -> None:
        """Remove the state of programs that are not in the folder any more.

        :param paths: the programs of the folder.
        """
        for path in self._program_files.keys() - set(paths):
            self._program_files.pop(path)
            self._last_changes.pop(path, None)
            self._finished.pop(path, None)
            self._busy.discard(path)

    def _programs(self) -> list[Path]:
        """Return the programs of the folder, sorted; hidden and temporary files and names not in UTF-8 are left out."""
        programs = (
            path
            for path in self.folder.iterdir()
            if registry.has_known_extension(path)
            and not path.name.startswith((".", "~"))
            and is_utf8(path.name)
            and path.is_file()
        )
        return registry.newest_versions(sorted(programs))

    def _load_cell(self) -> Cell | None:
        """Return the cell; None if it is unusable."""
        try:
            return cells.load(self.cell)
        except PostprocError:
            return None

    def _setup_files(self, cell: Cell) -> list[Path]:
        """Return the files of cell and robot; the cell file alone if there is no such robot."""
        try:
            return [*inputs.cell_inputs(self.cell, cell), *inputs.robot_inputs(cell)]
        except PostprocError:
            return [self.cell]

    def _force_files(self, path: Path) -> list[Path]:
        """Return the process file of a program and the files that it names; empty: the program has no process file."""
        process = process_of(path, self.output)
        return [] if process is None else inputs.force_inputs(process)

    def _has_forces(self, path: Path) -> bool:
        """Return whether the forces of a program are known: by a process file, or by comments in the program."""
        return process_of(path, self.output) is not None or states_forces(path)

    def _main_programs(self, paths: list[Path]) -> list[Path]:
        """Return programs without those that others of the folder call.

        If a program of the folder cannot be read, that is not known: then all of a dialect with calls are left out.
        """
        try:
            jobs = find_jobs([str(self.folder)], output=self.output)
        except PostprocError:  # one of the others cannot be read yet
            return [path for path in paths if not isinstance(registry.dialect_of_file(path), Calling)]
        main_programs = {job.program for job in jobs if not job.callers}
        return [path for path in paths if path in main_programs]


def _program_files(path: Path) -> list[Path]:
    """Return the files of a program: its own, and companions such as the ``.dat`` of a ``.src``."""
    return [path, *registry.dialect_of_file(path).companions(path)]


def _signature(paths: Collection[Path]) -> Signature:
    """Return names, sizes and times of files."""
    return tuple(_stamp(path) for path in paths)


def _stamp(path: Path) -> FileStamp:
    """Return name, size and time of change of a file; size −1 if it is missing."""
    try:
        return FileStamp.of(path)
    except OSError:
        return FileStamp(path.name, -1, 0)


def _is_readable(path: Path) -> bool:
    """Return whether a program can be read: on Windows not while another program writes it."""
    try:
        with path.open("rb"):
            return True
    except OSError:
        return False


def stamps(folders: Mapping[Path, Collection[str]]) -> Signature:
    """Return names, sizes and times of files in folders, sorted within each folder.

    :param folders: folder → endings of the names of its files; a folder that does not exist has no files.
    """
    paths = (
        path
        for folder, endings in folders.items()
        if folder.is_dir()
        for path in sorted(folder.iterdir())
        if path.name.lower().endswith(tuple(endings))
    )
    return _signature(list(paths))
