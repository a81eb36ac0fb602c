"""Reading of a program from its files, and choice of a start for a cell without [start]."""

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

    :param path: main file of the program.
    :param robot: robot of the cell.
    :param cell: frames, settings and start.
    :param dialect: name of its format; None: by the extension.
    :param name: name of the program; None: that of the file.
    :raises ProgramError: the program is not understood; the message names the file by its path.
    """
    path = Path(path)
    dialect = registry.dialect_of_file(path, dialect).name
    documents = read_documents(path, dialect)
    try:
        return correction.read(documents, robot, cell, registry.program_name(path) if name is None else name, dialect)
    except InputError as cause:
        raise cause.with_file(path.name, str(path)) from cause


_PROVISIONAL_START = Start((0.3257, -88.6413, 91.7269, 2.8391, 43.4173, -1.6427))
"""Start from which a program is read before its own start is chosen: angles that no program states."""


def read_with_start(
    path: str | Path, robot: RobotModel, cell: Cell, dialect: str | None = None, name: str | None = None
) -> tuple[Program, Cell]:
    """Read a program as `read_program` does; a cell without [start] gets a start that is chosen for the program.

    The start is the joints before the first move; it decides on which branch (posture) the arm moves.

    :returns: the program, with a note on a chosen start, and the cell with its start.
    :raises ProgramError: the program is not understood, or its motions depend on where it starts.
    """
    if cell.start is not None:
        return read_program(path, robot, cell, dialect, name), cell
    provisional_cell = replace(cell, start=_PROVISIONAL_START)
    provisional_program = read_program(path, robot, provisional_cell, dialect, name)
    try:
        first_start = chosen_start(provisional_program, RobotInCell.of(robot, provisional_cell))
        start = _start_in_turn(provisional_program, robot, cell, first_start)
    except ProgramError as cause:
        raise cause.with_file(Path(path).name, str(path)) from cause
    cell = replace(cell, start=Start(start.joints))
    program = read_program(path, robot, cell, dialect, name)
    provisional_motions, motions = provisional_program.motions, program.motions
    is_same = (
        len(provisional_motions) == len(motions)
        and _are_equal(provisional_motions.target[:], motions.target[:])
        and _are_equal(provisional_motions.joints[:], motions.joints[:])
    )
    # at the provisional start the program does not state where its first move goes
    if not is_same or start.joints == _PROVISIONAL_START.joints:
        raise ProgramError(
            "the first motions depend on where the program starts, and the cell has no [start]",
            file=str(path),
            advice="Give [start] joints, or state in the program where the first move goes.",
        )
    return replace(program, issues=(*program.issues, Issue("info", "start", start.message))), cell


def _start_in_turn(program: Program, robot: RobotModel, cell: Cell, start: ChosenStart) -> ChosenStart:
    """Return the start at the first target of a program with its tool turned about its axis as the cell asks.

    If the turn depends on forces from a file, it may be another one in the conversion: the first move then turns the
    tool.

    :param start: start for the turn of the tool as the program is read; returned if the cell chooses no turn.
    """
    robot_in_cell = RobotInCell.of(robot, replace(cell, start=Start(start.joints)))
    turned_program = placement.in_chosen_turn(program, robot_in_cell, None)
    if turned_program.turn is None:
        return start
    constant_turn = replace(robot_in_cell.cell, gcode=replace(cell.gcode, redundancy="constant"))
    return chosen_start(turned_program.program, RobotInCell.of(robot, constant_turn))


def _are_equal(first: Array, second: Array) -> bool:
    """Return whether lengths [m] or angles [rad] differ by 1e-9 at most, which is rounding; NaN equals NaN."""
    return bool(np.allclose(first, second, rtol=0.0, atol=1e-9, equal_nan=True))
