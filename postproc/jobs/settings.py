"""Options of a run over several programs, and the outcome of each."""

from __future__ import annotations

from pathlib import Path

import msgspec
from msgspec import Struct

from postproc import cell as cells
from postproc import robot as robots
from postproc.cell import Cell
from postproc.correction import Mode
from postproc.errors import Issue
from postproc.files import Staged
from postproc.report import Summary
from postproc.robot import RobotModel

GOOD, FAILED, EXCEEDED = 0, 1, 3
"""Exit codes of one program."""


class Settings(Struct, frozen=True):
    """Options for every program of a run.

    :param cell: cell file.
    :param mode: see `correction.process`.
    :param tolerance_mm: replaces that of the cell; if the written program exceeds it, the exit code says so.
    :param part_tolerance_mm: what the part may be off, 95 %; replaces that of the cell.
    :param lines_per_file: replaces that of the cell.
    :param linearize_arcs: write arcs as lines.
    :param keep_unresolved: leave motions of KRL as they are that only the running robot knows.
    :param part: mesh of the part, whose surface is looked at; None = none.
    :param overwrite: replace files that postproc did not write.
    """

    cell: Path
    mode: Mode = "convert"
    tolerance_mm: float | None = None
    part_tolerance_mm: float | None = None
    lines_per_file: int | None = None
    linearize_arcs: bool = False
    keep_unresolved: bool = False
    overwrite: bool = False
    part: Path | None = None


class Outcome(Struct, frozen=True):
    """What came of one program.

    :param program: its file as the user named it.
    :param code: 0 good, 1 nothing was written, 3 written, but the verdict is "failed": a stated tolerance is exceeded,
        or the expected error is larger than the correction.
    :param summary: content of `report.json`; None if nothing was written, with code 0 where nothing was to be.
    :param message: why nothing was written, if `issues` do not state it.
    :param issues: problems of the program, if it was read but not written.
    :param written: files written.
    :param copied: those of them that it needs, and that are as they were.
    :param earlier: what became of the results of an earlier run, where there are none of this one.
    :param traceback: of a fault of postproc.
    :param staged: files that are complete and not yet in their places, see `output_plan`.
    :param shared: names of those of them that other programs may need too.
    :param read: files that were read.
    :param keeps_earlier: whether the results of an earlier run stay, although there are none of this one: the program
        could be converted, and not written.
    """

    program: str
    code: int
    summary: Summary | None = None
    message: str = ""
    issues: tuple[Issue, ...] = ()
    written: tuple[str, ...] = ()
    copied: tuple[str, ...] = ()
    earlier: str = ""
    traceback: str = ""
    staged: Staged | None = None
    shared: tuple[str, ...] = ()
    read: tuple[str, ...] = ()
    keeps_earlier: bool = False

    @property
    def skipped(self) -> bool:
        """Whether nothing was to be written: a subprogram, which is converted with the programs that call it."""
        return self.summary is None and self.code == GOOD


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
