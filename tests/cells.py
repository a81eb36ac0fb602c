"""Cells of the samples by the names of their files."""

from __future__ import annotations

from functools import cache

from postproc import cell as cells
from postproc import robot
from postproc.cell import Cell
from postproc.robot import RobotModel
from tests.places import SAMPLES


@cache
def sample(name: str = "cell_kr270.toml") -> tuple[Cell, RobotModel]:
    """Return a cell of the samples and its robot."""
    cell = cells.load(SAMPLES / name)
    return cell, robot.load(robot.find(cell.robot))
