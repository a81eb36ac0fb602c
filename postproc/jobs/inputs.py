"""What an output depends on besides the program: files of the cell, of the robot and of the forces, and the code."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from postproc import provenance
from postproc import robot as robots
from postproc.cell import Cell
from postproc.errors import PostprocError
from postproc.jobs.programs import PROCESS

_MODEL = ("robot.urdf", "model.toml")
_PACKAGE = Path(__file__).parent.parent


def cell_inputs(path: Path, cell: Cell) -> list[Path]:
    """Return a cell file and the files that it names, but for those of the robot."""
    names = [cell.config_dat, *cell.rapid.modules]
    if cell.collision is not None:
        names += [table.mesh for table in cell.collision.holder] + [table.mesh for table in cell.collision.obstacles]
    return [path, *(Path(cell.folder) / name for name in names if name is not None)]


def robot_inputs(cell: Cell) -> list[Path]:
    """Return the files of the robot model of a cell.

    :raises ModelError: there is none.
    """
    folder = robots.find(cell.robot, Path(cell.folder))
    return [folder / name for name in _MODEL]


def force_inputs(path: Path) -> list[Path]:
    """Return a file of forces and, of a process, the files of its stock and material."""
    if path.suffix.lower() != PROCESS:
        return [path]
    from postproc.machining import process  # what a cutter does is imported with it

    try:
        process_file = process.load(path)
    except PostprocError:
        return [path]
    names = (process_file.stock.file, None if process_file.material is None else process_file.material.file)
    return [path, *(path.parent / name for name in names if name is not None)]


def sum_of(paths: list[Path]) -> str:
    """Return the SHA-256 of files, one behind the other; without those that are not there.

    :raises OSError: one cannot be read.
    """
    return provenance.digest(path.read_bytes() for path in paths if path.is_file())


def relative_name(path: Path, folder: Path) -> str:
    """Return a path relative to a folder with ``/`` between; absolute where it is on another drive."""
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return path.resolve().as_posix()


def code_sum(package: Path = _PACKAGE) -> str:
    """Return the SHA-256 of the modules of the package, its tables, and the shipped robot models: names and contents.

    Two machines with the same sum convert by the same code.
    """
    return provenance.digest(_contents(package))


def _contents(package: Path) -> Iterator[bytes]:
    """Yield names and contents of the package's code and of the shipped robot models."""
    for name, path in sorted((path.relative_to(package).as_posix(), path) for path in package.rglob("*")):
        if path.suffix in (".py", ".toml") and not name.startswith("robot_models/"):
            yield name.encode()
            yield path.read_bytes()
    for name, folder in robots.shipped_models().items():
        for part in _MODEL:
            yield f"{name}/{part}".encode()
            yield (folder / part).read_bytes()
