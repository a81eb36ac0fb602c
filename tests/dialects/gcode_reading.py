"""What the tests of the G-code reader share: a cell, and short ways to read."""

import numpy as np

from postproc.cell import Cell, Frame, GCode, Start, Tool
from postproc.dialects.gcode import reader
from postproc.dialects.text import decode
from postproc.errors import PostprocError
from postproc.frames import Array, pose_from_xyzabc
from postproc.program import Program

CELL = Cell(
    robot="kuka_kr270",
    base=Frame(X=1500.0, Y=-200.0, Z=700.0, A=90.0),
    tool=Tool(Z=350.0),
    start=Start((0.0, -70.0, 110.0, 0.0, 50.0, 0.0)),
    gcode=GCode(rapid_m_per_s=0.4, approximation_mm=0.5),
    work_offsets={"G55": Frame(X=100.0, Z=-5.0), "G56": Frame(X=10.0, Y=20.0, Z=30.0, A=30.0, B=10.0)},
)
AT_Z10 = "G21 G90 G17\nG0 X0 Y0 Z10\n"
START_FLANGE = pose_from_xyzabc([1600.0, -150.0, 1500.0, 0.0, 0.0, 180.0])
"""With `CELL`: the tool tip starts at X50 Y-100 Z450 of `$BASE`."""


def forward(joints: Array) -> Array:
    """Where the flange stands: a stand-in for a robot, that tells joint angles apart."""
    start = np.array(CELL.start.joints)
    return START_FLANGE + pose_from_xyzabc([*(np.rad2deg(joints) - start)[:3], 0.0, 0.0, 0.0]) - np.eye(4)


def read(text: str | bytes, cell: Cell = CELL, *, bulk: bool = True) -> Program:
    data = text.encode() if isinstance(text, str) else text
    return reader._read(decode("part.nc", data), cell, forward, "part", bulk=bulk)


def ends(program: Program) -> Array:
    """End points of all motions, (M, 3) [mm]."""
    return program.motions.target[:, :3, 3] * 1e3


def outcome(text: str, cell: Cell = CELL, *, bulk: bool) -> list[object]:
    """Everything that reading a text gives: an error's message, or all arrays and tuples of the program."""
    try:
        program = read(text, cell, bulk=bulk)
    except PostprocError as error:
        return [type(error), str(error)]
    motions = program.motions
    arrays = [np.asarray(getattr(motions, name)).tobytes() for name in type(motions).__slots__]
    return [*arrays, program.notes, program.events, program.issues]
