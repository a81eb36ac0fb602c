"""The folder of a window: its programs, their results, and files that are added.

Paths that lead out of the folder, also by symbolic links, are refused.
"""

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
"""Folder of the identified models, each in a folder with the name of its readings."""
LARGEST_BYTES = 256 * 2**20
"""Largest size of a program that is added; CAM systems write up to 100 MB."""
MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".nc": "text/plain; charset=utf-8",
    ".src": "text/plain; charset=utf-8",
    ".dat": "text/plain; charset=utf-8",
    ".mod": "text/plain; charset=utf-8",
    ".csv": "text/csv; charset=utf-8",
    ".json": "application/json",
}
"""Extensions of results that the window sends → media type."""
_REFUSED_NAME = re.compile(r'[\x00-\x1f<>:"/\\|?*]|^[-.~]|[. ]$|^(con|prn|aux|nul|com\d|lpt\d)(\.|$)', re.IGNORECASE)
"""File names that contain folders, look like options of a command, or are devices of Windows."""
_PIECE_BYTES = 1 << 20
"""Bytes of an added file that are read at once, so that a large file is not held in memory."""


_LANGUAGES = ("krl", "rapid")
"""Languages in which programs are written."""


class Bytes(Protocol):
    """A stream of bytes to read: a socket or a file."""

    def read(self, size: int, /) -> bytes:
        """Return `size` bytes; fewer at the end of the stream."""
        ...


class Item(Struct, frozen=True):
    """A program of the folder and its results.

    :param entry: result of the program; None: it has no result.
    :param changes: inputs that have changed since the result was made, see `currency.changes`; empty: it is current.
    :param name_fault: reason why the window cannot use the name; empty: it can.
    """

    name: str
    entry: Entry | None
    changes: tuple[str, ...] = ()
    name_fault: str = ""

    @property
    def is_current(self) -> bool:
        """True if there is a result, and it was made from the present inputs."""
        return self.entry is not None and not self.changes and not self.name_fault


class Workspace(Struct, frozen=True):
    """The folder of a window.

    :param folder: absolute path, without symbolic links.
    """

    folder: Path

    @property
    def results(self) -> Path:
        """Folder of the results."""
        return self.folder / RESULTS

    @property
    def cell(self) -> Path:
        """Path of the cell for all programs; the file may not exist yet."""
        return self.results / "cell.toml"

    def program_file(self, name: str) -> Path:
        """Return the path of a program of the folder.

        :raises InputError: the folder has no file of this name.
        """
        return _existing_file(self.folder, name)

    def usable_program(self, name: str) -> Path:
        """Return the path of a program whose name the window can use, see `name_fault`.

        :raises InputError: the folder has no file of this name, or the window cannot use the name.
        """
        if fault := self.name_fault(name):
            raise InputError(f"{name}: {fault}", advice="Rename it.")
        return self.program_file(name)

    def name_fault(self, name: str) -> str:
        """Return the reason why the window cannot use the name of a program; empty: it can."""
        return _name_fault(name, self._program_names())

    def _program_names(self) -> list[str]:
        """Return the names of the programs of the folder, sorted."""
        paths = (path for path in self.folder.iterdir() if registry.has_known_extension(path) and path.is_file())
        return [path.name for path in registry.newest_versions(sorted(paths))]

    def result_file(self, name: str) -> Path:
        """Return the path of a result, in `RESULTS` or a folder of it: ``part.report.html``, ``place/place.html``.

        :raises InputError: there is no such result, or the window does not send files of its type.
        """
        folder, _, file = name.rpartition("/")
        if _REFUSED_NAME.search(folder) or Path(file).suffix.lower() not in MEDIA_TYPES:
            raise InputError(f"no result {name!r}")
        return self.check_inside(_existing_file(self.results / folder, file))

    def existing_cell(self) -> Path:
        """Return the path of the cell; unlike `cell`, the file exists and is in the folder.

        :raises InputError: there is no cell, or a symbolic link leads out of the folder.
        """
        return self.check_inside(_existing_file(self.results, self.cell.name))

    def best_place_file(self, name: str) -> Path:
        """Return the path of `place.toml`, the best place for a program.

        :raises InputError: no best place was found for it yet.
        """
        folder = self.results / f"place-{registry.program_name(Path(name))}"
        return self.check_inside(_existing_file(folder, "place.toml"))

    def check_inside(self, path: Path) -> Path:
        """Check that a path does not lead out of `folder` by symbolic links, and return it unchanged.

        :raises InputError: a link leads out of it.
        """
        if not path.resolve().is_relative_to(self.folder):
            raise InputError(f"{path.name} is not in {self.folder.name}")
        return path

    def process_file(self, name: str) -> Path | None:
        """Return the process file of a program; None if it has none.

        :raises InputError: a symbolic link leads out of the folder.
        """
        path = process_of(self.folder / name, self.results)
        return None if path is None else self.check_inside(path)

    def process_to_edit(self, name: str) -> Path:
        """Return the process file of a program, or the path at which it will be written if it has none."""
        program = self.program_file(name)
        return self.process_file(name) or self.results / f"{registry.program_name(program)}.process.toml"

    def conversion_arguments(self, name: str) -> list[str]:
        """Return the arguments of the command that corrects a program."""
        return self.command_arguments("convert", name)

    def command_arguments(self, command: str, name: str, output: str = RESULTS) -> list[str]:
        """Return the arguments of a command about a program, with the cell, its process if it has one, and the output.

        :param command: name of the command.
        :param output: output folder.
        """
        process = self.process_file(name)
        process_option = [] if process is None else ["--process", f"{RESULTS}/{process.name}"]
        return [command, name, "--cell", f"{RESULTS}/{self.cell.name}", *process_option, "-o", output]

    def stamp(self) -> str:
        """Return a text that changes when a program, a result, the cell or a process file changes."""
        endings = (*(name.lower() for name in self._program_names()), ".toml")  # a name is an ending of itself
        content = stamps({self.folder: endings, self.results: (".toml", ".report.json")})
        return hashlib.sha256(repr(content).encode(errors="replace")).hexdigest()

    def readings(self, name: str) -> Readings:
        """Return the readings of an experiment.

        :param name: path of the experiment in the folder, such as ``"demo/experiment.toml"``.
        :raises InputError: the folder has no experiment of this name.
        """
        for entry in readings_of(self.folder):
            if self.relative_name(entry.experiment) == name:
                self.check_inside(entry.experiment)
                return entry
        raise InputError(f"no experiment {name!r} in {self.folder.name}")

    def model_folder(self, experiment: Path) -> Path:
        """Return the folder of the robot model that is identified from the readings of an experiment.

        It has the name of the folder of the experiment; directly in `folder`, that of its file.
        """
        name = experiment.stem if experiment.parent == self.folder else experiment.parent.name
        return self.folder / MODELS / name

    def model_page(self, model: Path) -> Path:
        """Return the path of the report of a robot model that was identified in this folder.

        :param model: folder of the model.
        :raises InputError: the model has no report, or a symbolic link leads out of the folder.
        """
        return self.check_inside(_existing_file(model, "report.html"))

    def relative_name(self, path: Path) -> str:
        """Return the path of a file relative to the folder, with ``/``, as commands name it."""
        return path.relative_to(self.folder).as_posix()

    def items(self) -> list[Item]:
        """Return the programs of the folder with their results, sorted by name."""
        entries = {entry.name: entry for entry in reported_programs(self.results)} if self.results.is_dir() else {}
        setup, names = Setup.of(self.cell), self._program_names()
        return [
            Item(name, entries.get(name), self._changes(name, entries.get(name), setup), _name_fault(name, names))
            for name in names
        ]

    def _changes(self, name: str, entry: Entry | None, setup: Setup) -> tuple[str, ...]:
        """Return the inputs that have changed since the result of a program was made; empty without a result.

        :param setup: cell and robot as they are now.
        """
        if entry is None:
            return ()
        report = self.results / f"{entry.page.removesuffix('.html')}.json"
        return changes(report, self.folder / name, setup, self.process_file(name))

    def add(self, name: str, content: Bytes, size: int) -> Path:
        """Write a program into the folder and return its path; nothing is written if it is refused.

        :param content: stream from which the program is read.
        :param size: its size [bytes].
        :raises InputError: the name or size is refused, the folder has a file of this name, or the stream ends early.
        """
        # 200 of the 255 bytes that file systems allow: results have longer names
        if _REFUSED_NAME.search(name) or len(name.encode(errors="replace")) > 200:
            raise InputError(f"{name!r} is no name of a program", advice="Rename the file.")
        if not registry.has_known_extension(Path(name)):
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
            missing_bytes = size  # the stream of a socket does not end after them
            while missing_bytes and (piece := content.read(min(_PIECE_BYTES, missing_bytes))):
                file.write(piece)
                missing_bytes -= len(piece)
        try:
            if missing_bytes:
                raise InputError(f"{name} did not come whole", advice="Drop it again.")
            if os.path.lexists(path):  # added while this one was read
                raise InputError(f"{name} is in the folder already", advice="Another window added it.")
            upload_path.replace(path)
        finally:
            upload_path.unlink(missing_ok=True)
        return path


def _name_fault(name: str, names: Sequence[str]) -> str:
    """Return the reason why the window, the page of `postproc app`, cannot use the name of a program; empty: it can.

    Reasons are characters of the name, and another program whose results would have the same file names.

    :param names: names of all programs.
    """
    if _REFUSED_NAME.search(name):
        return "its name has a character, a beginning or an end that Windows or a command line would not take"
    stems = _written_stems(name)
    same_stem_names = (
        program_name for program_name in names if program_name != name and stems & _written_stems(program_name)
    )
    conflict = next(same_stem_names, "")
    return f"its files would be those of {conflict}" if conflict else ""


@cache
def _written_stems(name: str) -> frozenset[str]:
    """Return the names, without extension and in lower case, that written files of a program may have."""
    stem = registry.program_name(Path(name))
    stems = {stem}  # of the reports; written programs have a name that their language allows
    for language in _LANGUAGES:
        _, writer = registry.written_in(language)
        stems.add(writer.valid_name(stem))
    return frozenset(text.lower() for text in stems)


def _existing_file(folder: Path, name: str) -> Path:
    """Return the path of a file directly in a folder.

    :raises InputError: there is no such file, or its name or a symbolic link leads out of the folder.
    """
    path = folder / name
    if _REFUSED_NAME.search(name) or not name or not path.is_file() or path.resolve().parent != folder.resolve():
        raise InputError(f"no file {name!r} in {folder.name}")
    return path
