"""Whether a result agrees with its present inputs, by the checksums that its report states.

Dates of files are not used: an edited file may have an old date, and a file with a new date may be unchanged. A result
that cannot be compared is not current.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec
from msgspec import Struct

from postproc import cell as cells
from postproc import provenance
from postproc.cell import Cell
from postproc.dialects import registry
from postproc.errors import PostprocError
from postproc.files import FileEntry
from postproc.jobs import inputs
from postproc.report.summary import Inputs
from postproc.version import VERSION

UNKNOWN = "what it was made from is unknown"
_CONTROLLER_EXTENSIONS = (".src", ".dat", ".mod", ".modx")


class _ReportedFiles(Struct, frozen=True):
    """Content of a `report.json`: its inputs and written files."""

    inputs: Inputs
    files: list[FileEntry]


class Setup(Struct, frozen=True):
    """The cell with whose present content results are compared.

    :param path: the cell file; `cell`: its content, None: the cell is unusable.
    """

    path: Path
    cell: Cell | None

    @classmethod
    def of(cls, path: Path) -> Setup:
        """Return the set-up of a cell file, which may be missing or unusable."""
        try:
            return cls(path, cells.load(path))
        except PostprocError:
            return cls(path, None)


def changes(report: Path, program: Path, setup: Setup, forces: Path | None) -> tuple[str, ...]:
    """Return the names of the inputs of a result that have changed, such as ``"the cell"``; empty if it is current.

    `UNKNOWN` is returned if the report or an input cannot be read.

    :param report: the `report.json` of the result; `program`: the program file.
    :param forces: file of forces or process that the program has now; None: it has none.
    """
    try:
        stated_inputs = msgspec.json.decode(report.read_bytes(), type=_ReportedFiles)
        return tuple(_changed_inputs(stated_inputs, report.parent, program, setup, forces))
    except (OSError, ValueError, PostprocError):
        return (UNKNOWN,)


def _changed_inputs(
    stated_inputs: _ReportedFiles, folder: Path, program: Path, setup: Setup, forces: Path | None
) -> Iterator[str]:
    """Yield the names of the inputs that have changed since the results of a program were written.

    Written programs that were edited afterwards are yielded too.

    :param folder: folder of the results, from which the names of inputs are relative; other parameters: see `changes`.
    :raises OSError: an input cannot be read.
    """
    if stated_inputs.inputs.version != VERSION:
        yield "postproc"
    sources = [folder / name for name in stated_inputs.inputs.program_files]
    companions = registry.dialect_of_file(program).companions(program)
    present_files = {path.resolve() for path in (program, *companions)}
    if (
        not present_files <= {path.resolve() for path in sources}
        or _sum_of_present(sources) != stated_inputs.inputs.program
    ):
        yield "the program"
    if stated_inputs.inputs.needed_files:
        needed_files = [folder / name for name in stated_inputs.inputs.needed_files]
        if _sum_of_present(needed_files) != stated_inputs.inputs.needed:
            yield "a file that the program needs"
    if setup.cell is None or inputs.sum_of(inputs.cell_inputs(setup.path, setup.cell)) != stated_inputs.inputs.cell:
        yield "the cell"
    if setup.cell is not None and inputs.sum_of(inputs.robot_inputs(setup.cell)) != stated_inputs.inputs.model:
        yield "the robot model"
    if ("-" if forces is None else inputs.sum_of(inputs.force_inputs(forces))) != stated_inputs.inputs.forces:
        yield "tools, material, stock or forces"
    for entry in stated_inputs.files:
        path = folder / entry.name
        if path.suffix.lower() in _CONTROLLER_EXTENSIONS and provenance.digest([path.read_bytes()]) != entry.sha256:
            yield f"{entry.name}, edited after it was written,"


def _sum_of_present(paths: list[Path]) -> str:
    """Return the checksum of files; an empty text if one of them is missing."""
    return inputs.sum_of(paths) if all(path.is_file() for path in paths) else ""
