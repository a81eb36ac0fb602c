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
"""Files of the test part that the window sends to the browser."""
_NUMBER_FLAGS = {"count": "--features", "depth": "--depth", "weight": "--weight"}
"""Field of the form → option of the command."""


class TestPart(Struct, frozen=True):
    """The test part of a folder; it may not be written yet."""

    __test__ = False  # not a test of pytest

    workspace: Workspace

    @property
    def folder(self) -> Path:
        """Folder of the files of the test part."""
        return self.workspace.folder / FOLDER

    @property
    def probing_path(self) -> Path:
        """File with the probed deviations."""
        return self.folder / PROBED_FILE

    @property
    def model(self) -> Path:
        """Folder of the model that is identified from the test part."""
        return self.workspace.folder / MODELS / FOLDER

    def file(self, name: str) -> Path:
        """Return the path of a file that the window sends.

        :raises InputError: the name is not in `SENT_FILES`, or the file is not written yet.
        """
        path = self.folder / name
        if name not in SENT_FILES or not path.is_file():
            raise InputError(f"no file {name!r} of the test part", advice="Write the part first.")
        return self.workspace.check_inside(path)

    def processes(self) -> list[str]:
        """Return the names of the process files from which the test part can be made, sorted."""
        paths = sorted(self.workspace.results.glob("*.toml")) if self.workspace.results.is_dir() else []
        return [path.name for path in paths if path.name.endswith("process.toml") and not path.name.startswith(".")]

    def write_arguments(self, form: Mapping[str, str]) -> list[str]:
        """Return the arguments of the command that writes the test part.

        :param form: values of the form: `process` (default: the first process file), `block`, and numbers as of
            `_NUMBER_FLAGS`; empty values are left out.
        :raises InputError: there is no process file of this name.
        """
        names = self.processes()
        process = form.get("process", "") or next(iter(names), "process.toml")
        if names and process not in names:
            raise InputError(f"no process file {process!r} in {RESULTS}")
        arguments = ["testpart", "--cell", f"{RESULTS}/cell.toml", "--process", f"{RESULTS}/{process}"]
        for field, flag in (("block", "--block"), *_NUMBER_FLAGS.items()):
            if text := form.get(field, "").strip():
                arguments.append(f"{flag}={text}")
        return [*arguments, "-o", FOLDER]

    def identify_arguments(self, *, compare: bool = False) -> list[str]:
        """Return the arguments of the command that identifies a model from the test part.

        :param compare: of the command that checks the model of the cell by the test part instead.
        """
        arguments = ["identify", "part", f"{FOLDER}/{PROBED_FILE}", "--cell", f"{RESULTS}/cell.toml"]
        arguments += ["--process", f"{FOLDER}/testpart.process.toml", "--program", f"{FOLDER}/testpart.nc"]
        return [*arguments, *(["--compare"] if compare else ["-o", f"{MODELS}/{FOLDER}"])]

    def add_probed(self, content: Bytes, size: int) -> None:
        """Save a probing file that was filled in, in place of an earlier one; nothing is changed if it is refused.

        :param content: stream from which the file is read.
        :param size: its size [bytes].
        :raises InputError: the test part is not written, or the file is no probing file, incomplete or too large.
        """
        self.file("testpart.nc")  # raises if the test part is not written
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
