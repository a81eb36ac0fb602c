"""Cutter-location files for tests: short ways to read them."""

from postproc.cell import Cell
from postproc.dialects.apt import reader
from postproc.dialects.text import decode
from postproc.frames import Array
from postproc.program import Program
from tests.dialects.gcode_reading import CELL, forward

AT_Z9 = "UNITS/MM\nFEDRAT/600,MMPM\nRAPID\nGOTO/0,0,9\n"


def read(text: str | bytes, cell: Cell = CELL) -> Program:
    """Read a program."""
    return reader.read(decode("part.apt", text.encode() if isinstance(text, str) else text), cell, forward, "part")


def points(program: Program) -> Array:
    """Return the end points of all motions, (M, 3) [mm]."""
    return program.motions.target[:, :3, 3] * 1e3
