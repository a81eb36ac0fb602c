"""What all programs of a run share: the cell and its robot."""

from __future__ import annotations

from pathlib import Path

import msgspec

from postproc import cell as cells
from postproc import robot as robots
from postproc.cell import Cell
from postproc.jobs.outcome import Settings
from postproc.robot import RobotModel


def load_setup(settings: Settings) -> tuple[Cell, RobotModel]:
    """Read the cell and its robot.

    :raises CellError: the cell is unusable.
    :raises ModelError: its robot is.
    """
    cell = as_stated(cells.load(settings.cell), settings)
    return cell, load_robot(cell.robot, cell.folder)


def as_stated(cell: Cell, settings: Settings) -> Cell:
    """Return a cell with what settings replace."""
    stated = {name: getattr(settings, name) for name in ("tolerance_mm", "lines_per_file")}
    stated = {name: value for name, value in stated.items() if value is not None}
    if stated:
        cell = msgspec.structs.replace(cell, output=msgspec.structs.replace(cell.output, **stated))
    if settings.part_tolerance_mm is not None:
        part = msgspec.structs.replace(cell.part, tolerance_mm=settings.part_tolerance_mm)
        cell = msgspec.structs.replace(cell, part=part)
    if settings.keep_unresolved:
        cell = msgspec.structs.replace(cell, krl=msgspec.structs.replace(cell.krl, keep_unresolved=True))
    return cell


def load_robot(name: str, relative_to: str | Path = ".") -> RobotModel:
    """Read a robot model.

    :param name: of a shipped robot (`postproc robots` lists them), or the path of a model folder.
    :param relative_to: folder that the path starts from: for the robot of a cell, `cell.folder`.
    :raises ModelError: there is none, or it is unusable.
    """
    return robots.load(robots.find(name, Path(relative_to)))
