"""A program as it is read from its files, and the start of a cell that states none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from msgspec.structs import replace

from postproc import correction, placement
from postproc.cell import Cell, Start
from postproc.dialects import registry
from postproc.errors import InputError, Issue, ProgramError
from postproc.frames import Array
from postproc.jobs.programs import read_documents
from postproc.placement.turning import ChosenStart, chosen_start
from postproc.program import Program
from postproc.robot import RobotModel
from postproc.under_load import RobotInCell


def read_program(
    path: str | Path, robot: RobotModel, cell: Cell, dialect: str | None = None, name: str | None = None
) -> Program:
    """Read a program file (for KRL with its `.dat`).

    :param path: of the main file.
    :param robot: with the cell, fixes where the program starts.
    :param cell: frames and settings.
    :param dialect: name of its format; None = by the extension.
    :param name: of the program; None = that of the file.
    :raises ProgramError: it is not understood; the message names the file by its path.
    """
    path = Path(path)
    dialect = dialect or registry.dialect_of_file(path).name
    documents = read_documents(path, dialect)
    try:
        return correction.read(documents, robot, cell, path.stem if name is None else name, dialect)
    except InputError as cause:
        raise cause.with_file(path.name, str(path)) from cause


_PROVISIONAL_START = Start((0.3257, -88.6413, 91.7269, 2.8391, 43.4173, -1.6427))
"""A start from which a program is read until its own is known: angles that no program states."""


def read_with_start(
    path: str | Path, robot: RobotModel, cell: Cell, dialect: str | None = None, name: str | None = None
) -> tuple[Program, Cell]:
    """Read a program as `read_program` does; a cell without [start] gets the one that is chosen for the program.

    :raises ProgramError: it is not understood, or its motions depend on where it starts.
    :returns: the program, and the cell with its start.
    """
    if cell.start is not None:
        return read_program(path, robot, cell, dialect, name), cell
    provisional_cell = replace(cell, start=_PROVISIONAL_START)
    first = read_program(path, robot, provisional_cell, dialect, name)
    try:
        start = _start_in_turn(first, robot, cell, chosen_start(first, RobotInCell.of(robot, provisional_cell)))
    except ProgramError as cause:
        raise cause.with_file(Path(path).name, str(path)) from cause
    cell = replace(cell, start=Start(start.joints))
    program = read_program(path, robot, cell, dialect, name)
    first_motions, motions = first.motions, program.motions
    is_same = (
        len(first_motions) == len(motions)
        and _are_equal(first_motions.target[:], motions.target[:])
        and _are_equal(first_motions.joints[:], motions.joints[:])
    )
    if not is_same or start.joints == _PROVISIONAL_START.joints:
        raise ProgramError(
            "the first motions depend on where the program starts, and the cell has no [start]",
            file=str(path),
            advice="Give [start] joints, or state in the program where the first move goes.",
        )
    return replace(program, issues=(*program.issues, Issue("info", "start", start.message))), cell


def _start_in_turn(program: Program, robot: RobotModel, cell: Cell, start: ChosenStart) -> ChosenStart:
    """Return the start at the first target of a program with its tool turned about its axis as the cell asks.

    Forces that the program does not state may change the turn: then the first move turns the tool.

    :param start: for the tool as the program is read.
    """
    robot_in_cell = RobotInCell.of(robot, replace(cell, start=Start(start.joints)))
    turned_program = placement.in_chosen_turn(program, robot_in_cell, None)
    if turned_program.turn is None:
        return start
    constant_turn = replace(robot_in_cell.cell, gcode=replace(cell.gcode, redundancy="constant"))
    return chosen_start(turned_program.program, RobotInCell.of(robot, constant_turn))


def _are_equal(first: Array, second: Array) -> bool:
    """Return whether numbers differ by rounding only, a nanometre or a nanoradian; NaN equals NaN."""
    return bool(np.allclose(first, second, rtol=0.0, atol=1e-9, equal_nan=True))
