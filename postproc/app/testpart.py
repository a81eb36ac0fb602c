"""The test part of the folder: its files, and the commands that write it and make a model of it."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

from msgspec import Struct

from postproc.app.workspace import MODELS, RESULTS, Bytes, Workspace
from postproc.errors import InputError
from postproc.jobs.probing_list import LARGEST_BYTES, check_probed

FOLDER = "testpart"
PROBED_FILE = "probed.csv"
SENT_FILES = ("testpart.src", "testpart.nc", "probing.csv", "testpart.html")
"""Files that the window sends."""
_NUMBERS = {"count": "--features", "depth": "--depth", "weight": "--weight"}
"""Fields of the form, and their options."""


class TestPart(Struct, frozen=True):
    """The test part of a folder; it may not be written yet."""

    __test__ = False  # not a test of pytest

    workspace: Workspace

    @property
    def folder(self) -> Path:
        """The folder of its files."""
        return self.workspace.folder / FOLDER

    @property
    def probing_path(self) -> Path:
        """The file with the deviations that were probed."""
        return self.folder / PROBED_FILE

    @property
    def model(self) -> Path:
        """The folder of the model that is identified from the test part."""
        return self.workspace.folder / MODELS / FOLDER

    def file(self, name: str) -> Path:
        """Return the path of a file that is sent.

        :raises InputError: there is none of this name.
        """
        path = self.folder / name
        if name not in SENT_FILES or not path.is_file():
            raise InputError(f"no file {name!r} of the test part", advice="Write the part first.")
        return self.workspace.path_in_folder(path)

    def processes(self) -> list[str]:
        """Return the names of the process files that it can be made with."""
        paths = sorted(self.workspace.results.glob("*.toml")) if self.workspace.results.is_dir() else []
        return [path.name for path in paths if path.name.endswith("process.toml") and not path.name.startswith(".")]

    def writing(self, form: Mapping[str, str]) -> list[str]:
        """Return the arguments of the command that writes it.

        :param form: `process` (default: the first), `block`, and numbers; empty ones are left out.
        :raises InputError: there is no such process file.
        """
        names = self.processes()
        process = form.get("process", "") or next(iter(names), "process.toml")
        if names and process not in names:
            raise InputError(f"no process file {process!r} in {RESULTS}")
        arguments = ["testpart", "--cell", f"{RESULTS}/cell.toml", "--process", f"{RESULTS}/{process}"]
        for field, flag in (("block", "--block"), *_NUMBERS.items()):
            if text := form.get(field, "").strip():
                arguments.append(f"{flag}={text}")
        return [*arguments, "-o", FOLDER]

    def identification(self, *, compare: bool = False) -> list[str]:
        """Return the arguments of the command that makes a model of it; `compare`: that checks the cell's model."""
        arguments = ["identify", "part", f"{FOLDER}/{PROBED_FILE}", "--cell", f"{RESULTS}/cell.toml"]
        arguments += ["--process", f"{FOLDER}/testpart.process.toml", "--program", f"{FOLDER}/testpart.nc"]
        return [*arguments, *(["--compare"] if compare else ["-o", f"{MODELS}/{FOLDER}"])]

    def add_probed(self, content: Bytes, size: int) -> None:
        """Take a probing file that was filled in: whole, or not at all; it replaces an earlier one.

        :raises InputError: the part is not written, or it is no such file.
        """
        self.file("testpart.nc")
        if not 0 < size <= LARGEST_BYTES:
            raise InputError("the file is empty or too large", advice="Choose probing.csv with its deviations.")
        with tempfile.NamedTemporaryFile(dir=self.folder, prefix=".postproc-", suffix=".csv", delete=False) as file:
            trial_path = Path(file.name)
            data = content.read(size)
            file.write(data)
        try:
            if len(data) != size:
                raise InputError("the file did not come whole", advice="Drop it again.")
            check_probed(trial_path)
            trial_path.replace(self.probing_path)
        finally:
            trial_path.unlink(missing_ok=True)
