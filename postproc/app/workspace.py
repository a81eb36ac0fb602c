"""The folder of a window: its programs, their results, and files that are added. No path leads out of it."""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Protocol

from msgspec import Struct

from postproc.dialects import registry
from postproc.errors import InputError
from postproc.jobs.arrivals import stamps
from postproc.jobs.currency import Setup, changes
from postproc.jobs.experiments import Readings, readings_of
from postproc.jobs.programs import process_of
from postproc.jobs.runs import reported_programs
from postproc.report.index import Entry

RESULTS = "corrected"
MODELS = "models"
"""Folder of the models that are identified, each in a folder of the name of its readings."""
LARGEST_BYTES = 256 * 2**20
"""Size of a program that is added; CAM systems write up to 100 MB."""
MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".nc": "text/plain; charset=utf-8",
    ".src": "text/plain; charset=utf-8",
    ".dat": "text/plain; charset=utf-8",
    ".mod": "text/plain; charset=utf-8",
    ".csv": "text/csv; charset=utf-8",
    ".json": "application/json",
}
"""Results that the window sends, with their types."""
_FOREIGN = re.compile(r'[\x00-\x1f<>:"/\\|?*]|^[-.~]|[. ]$|^(con|prn|aux|nul|com\d|lpt\d)(\.|$)', re.IGNORECASE)
"""Names that lead elsewhere, are options of a command, or devices of Windows."""
_PIECE = 1 << 20
"""Bytes read at once of a file that is added, so that a long one is not held in memory."""


_LANGUAGES = ("krl", "rapid")
"""Languages that programs are written in."""


class Bytes(Protocol):
    """What is read from: a socket, a file."""

    def read(self, size: int, /) -> bytes:
        """Return that many bytes; fewer at the end."""
        ...


class Item(Struct, frozen=True):
    """A program of the folder and its results.

    :param changes: what differs from what the results were made from, see `currency.changes`; empty: they are current.
    :param name_fault: why the window cannot use its name; empty: it can.
    """

    name: str
    entry: Entry | None
    changes: tuple[str, ...] = ()
    name_fault: str = ""

    @property
    def is_current(self) -> bool:
        """Return whether the results are those of the present inputs."""
        return self.entry is not None and not self.changes and not self.name_fault


class Workspace(Struct, frozen=True):
    """A folder.

    :param folder: absolute, without symbolic links.
    """

    folder: Path

    @property
    def results(self) -> Path:
        """The folder of the results."""
        return self.folder / RESULTS

    @property
    def cell(self) -> Path:
        """The cell that all programs are corrected with."""
        return self.results / "cell.toml"

    def program(self, name: str) -> Path:
        """Return the path of a program of the folder.

        :raises InputError: there is none of this name in it.
        """
        return _path_in_folder(self.folder, name)

    def sole_program(self, name: str) -> Path:
        """Return the path of a program whose results are its own.

        :raises InputError: there is none of this name, or another program would be written to the same files.
        """
        if fault := self.name_fault(name):
            raise InputError(f"{name}: {fault}", advice="Rename it.")
        return self.program(name)

    def name_fault(self, name: str) -> str:
        """Return why the window cannot use the name of a program; empty: it can."""
        return _name_fault(name, self._names())

    def _names(self) -> list[str]:
        """Return the names of the programs of the folder, sorted."""
        extensions = set(registry.extensions())
        return sorted(
            path.name for path in self.folder.iterdir() if path.suffix.lower() in extensions and path.is_file()
        )

    def result(self, name: str) -> Path:
        """Return the path of a result, in `RESULTS` or a folder of it: ``part.report.html``, ``place/place.html``.

        :raises InputError: there is none of this name in it.
        """
        folder, _, file = name.rpartition("/")
        if _FOREIGN.search(folder) or Path(file).suffix.lower() not in MEDIA_TYPES:
            raise InputError(f"no result {name!r}")
        return self.path_in_folder(_path_in_folder(self.results / folder, file))

    def stated_cell(self) -> Path:
        """Return the path of the cell, which is there.

        :raises InputError: it is not, or it is elsewhere.
        """
        return self.path_in_folder(_path_in_folder(self.results, self.cell.name))

    def place(self, name: str) -> Path:
        """Return the file of the best place for a program.

        :raises InputError: there is none.
        """
        return self.path_in_folder(_path_in_folder(self.results / f"place-{Path(name).stem}", "place.toml"))

    def path_in_folder(self, path: Path) -> Path:
        """Return a path that no link of a folder leads out of `folder`.

        :raises InputError: one does.
        """
        if not path.resolve().is_relative_to(self.folder):
            raise InputError(f"{path.name} is not in {self.folder.name}")
        return path

    def process(self, name: str) -> Path | None:
        """Return the process file of a program; None: there is none."""
        path = process_of(self.folder / name, self.results)
        return None if path is None else self.path_in_folder(path)

    def process_to_edit(self, name: str) -> Path:
        """Return the process file of a program, or the path at which it will be made."""
        return self.process(name) or self.results / f"{self.program(name).stem}.process.toml"

    def conversion(self, name: str) -> list[str]:
        """Return the arguments of the command that corrects a program."""
        return self.cell_arguments("convert", name)

    def cell_arguments(self, command: str, name: str, output: str = RESULTS) -> list[str]:
        """Return the arguments of a command about a program, with the cell and the process of it."""
        process = self.process(name)
        process_option = [] if process is None else ["--process", f"{RESULTS}/{process.name}"]
        return [command, name, "--cell", f"{RESULTS}/{self.cell.name}", *process_option, "-o", output]

    def stamp(self) -> str:
        """Return a text that changes when a program, a result, the cell or a process does."""
        kinds = (*registry.extensions(), ".toml")
        content = stamps({self.folder: kinds, self.results: (".toml", ".report.json")})
        return hashlib.sha256(repr(content).encode(errors="replace")).hexdigest()

    def readings(self, name: str) -> Readings:
        """Return the readings of an experiment, such as ``"demo/experiment.toml"``.

        :raises InputError: there is none of this name in the folder.
        """
        for entry in readings_of(self.folder):
            if self.relative(entry.experiment) == name:
                self.path_in_folder(entry.experiment)
                return entry
        raise InputError(f"no experiment {name!r} in {self.folder.name}")

    def model(self, experiment: Path) -> Path:
        """Return the folder of the model that is identified from an experiment."""
        name = experiment.stem if experiment.parent == self.folder else experiment.parent.name
        return self.folder / MODELS / name

    def model_page(self, model: Path) -> Path:
        """Return the report of a model.

        :raises InputError: there is none.
        """
        return self.path_in_folder(_path_in_folder(model, "report.html"))

    def relative(self, path: Path) -> str:
        """Return the path of a file of the folder as commands name it, with ``/``."""
        return path.relative_to(self.folder).as_posix()

    def items(self) -> list[Item]:
        """Return the programs of the folder, sorted by name."""
        entries = {entry.name: entry for entry in reported_programs(self.results)} if self.results.is_dir() else {}
        setup, names = Setup.of(self.cell), self._names()
        return [
            Item(name, entries.get(name), self._changes(name, entries.get(name), setup), _name_fault(name, names))
            for name in names
        ]

    def _changes(self, name: str, entry: Entry | None, setup: Setup) -> tuple[str, ...]:
        """Return what has changed since the result of a program; empty without a result."""
        if entry is None:
            return ()
        report = self.results / f"{entry.page.removesuffix('.html')}.json"
        return changes(report, self.folder / name, setup, self.process(name))

    def add(self, name: str, content: Bytes, size: int) -> Path:
        """Write a program into the folder: whole, or not at all.

        :raises InputError: its name or size is refused, a file of this name is there, or it did not come whole.
        """
        if _FOREIGN.search(name) or len(name.encode(errors="replace")) > 200:
            raise InputError(f"{name!r} is no name of a program", advice="Rename the file.")
        if Path(name).suffix.lower() not in registry.extensions():
            kinds = " ".join(sorted(registry.extensions()))
            raise InputError(f"{name}: no known kind of program", advice=f"Known are {kinds}.")
        if not 0 < size <= LARGEST_BYTES:
            limit = f"{LARGEST_BYTES >> 20} MB"
            raise InputError(f"{name} is empty or larger than {limit}", advice="Copy it into the folder instead.")
        path = self.folder / name
        if os.path.lexists(path):
            advice = "Rename the new one, or replace the file in the folder."
            raise InputError(f"{name} is in the folder already", advice=advice)
        if fault := self.name_fault(name):
            raise InputError(f"{name}: {fault}, which is in the folder", advice="Rename the new one.")
        with tempfile.NamedTemporaryFile(dir=self.folder, prefix=".postproc-", delete=False) as file:
            upload_path = Path(file.name)
            missing_bytes = size
            while missing_bytes and (piece := content.read(min(_PIECE, missing_bytes))):
                file.write(piece)
                missing_bytes -= len(piece)
        try:
            if missing_bytes:
                raise InputError(f"{name} did not come whole", advice="Drop it again.")
            if os.path.lexists(path):
                raise InputError(f"{name} is in the folder already", advice="Another window added it.")
            upload_path.replace(path)
        finally:
            upload_path.unlink(missing_ok=True)
        return path


def _name_fault(name: str, names: Sequence[str]) -> str:
    """Return why the window cannot use the name of a program; empty: it can.

    :param names: of all programs: two must not be written to the same files, in a robot's language or by the window.
    """
    if _FOREIGN.search(name):
        return "its name has a character, a beginning or an end that Windows or a command line would not take"
    stems = _written_stems(name)
    same_stem_names = (
        program_name for program_name in names if program_name != name and stems & _written_stems(program_name)
    )
    conflict = next(same_stem_names, "")
    return f"its files would be those of {conflict}" if conflict else ""


@cache
def _written_stems(name: str) -> frozenset[str]:
    """Return the names without extension, lower case, that the files of a program may have."""
    stem = Path(name).stem
    return frozenset(
        text.lower() for text in (stem, *(registry.written_in(language)[1].valid_name(stem) for language in _LANGUAGES))
    )


def _path_in_folder(folder: Path, name: str) -> Path:
    """Return the path of a file of a folder.

    :raises InputError: the name leads elsewhere, also by a symbolic link, or there is no such file.
    """
    path = folder / name
    if _FOREIGN.search(name) or not name or not path.is_file() or path.resolve().parent != folder.resolve():
        raise InputError(f"no file {name!r} in {folder.name}")
    return path
