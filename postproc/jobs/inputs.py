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
    """Return a cell file and the files that it names, without those of the robot."""
    names = [cell.config_dat, *cell.rapid.modules]
    if cell.collision is not None:
        names += [table.mesh for table in cell.collision.holder] + [table.mesh for table in cell.collision.obstacles]
    return [path, *(Path(cell.folder) / name for name in names if name is not None)]


def robot_inputs(cell: Cell) -> list[Path]:
    """Return the files of the robot model of a cell.

    :raises ModelError: there is no such model.
    """
    folder = robots.find(cell.robot, Path(cell.folder))
    return [folder / name for name in _MODEL]


def force_inputs(path: Path) -> list[Path]:
    """Return a file of forces; of a process.toml, the files of stock and material that it names too.

    A process.toml that cannot be read is returned alone.
    """
    if path.suffix.lower() != PROCESS:
        return [path]
    from postproc.machining import process  # late: it imports the models of cutting

    try:
        process_file = process.load(path)
    except PostprocError:
        return [path]
    names = (process_file.stock.file, None if process_file.material is None else process_file.material.file)
    return [path, *(path.parent / name for name in names if name is not None)]


def sum_of(paths: list[Path]) -> str:
    """Return the SHA-256 of the contents of files one after the other; missing files are left out.

    :raises OSError: a file cannot be read.
    """
    return provenance.digest(path.read_bytes() for path in paths if path.is_file())


def relative_name(path: Path, folder: Path) -> str:
    """Return a path relative to a folder, with ``/``; an absolute path on another drive of Windows."""
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return path.resolve().as_posix()


def code_sum(package: Path = _PACKAGE) -> str:
    """Return the SHA-256 of names and contents of the modules and tables of the package and the shipped robot models.

    Two machines with the same sum convert by the same code.
    """
    return provenance.digest(_contents(package))


def _contents(package: Path) -> Iterator[bytes]:
    """Yield name and content, in turn, of each module and table of the package and each file of the robot models."""
    for name, path in sorted((path.relative_to(package).as_posix(), path) for path in package.rglob("*")):
        if path.suffix in (".py", ".toml") and not name.startswith("robot_models/"):
            yield name.encode()
            yield path.read_bytes()
    for name, folder in robots.shipped_models().items():
        for part in _MODEL:
            yield f"{name}/{part}".encode()
            yield (folder / part).read_bytes()
