"""Programs through a stock, for tests: text in, forces out."""

from __future__ import annotations

import numpy as np

import postproc
from postproc import machining, toolpath
from postproc.under_load import RobotInCell
from tests.kr270 import CELL, ROBOT

AL7075 = (767.01, 27.7, 168.8, 26.6, 222.0, 0.7)
"""Ktc, Kte, Krc, Kre, Kac, Kae of al_7075_t6_carbide."""


def process(tool, box, resolution=0.25, material='name = "al_7075_t6_carbide"'):
    """Text of a process.toml with one tool, T1."""
    spans = ", ".join(f"{axis} = {list(map(float, span))}" for axis, span in zip("XYZ", box, strict=True))
    return f"[material]\n{material}\n[tools.1]\n{tool}\n[stock]\nbox = {{ {spans} }}\nresolution_mm = {resolution}\n"


def tool(diameter, flutes, shape="flat", corner=0.0):
    text = f'shape = "{shape}"\ndiameter_mm = {diameter}\nflutes = {flutes}\n'
    return text + (f"corner_radius_mm = {corner}\n" if shape == "bull" else "")


def gcode(*blocks, spindle="S6000 M3"):
    """A program: G21 G90, T1, the spindle, and blocks."""
    return "\n".join(("G21 G90 G17 G94", "T1 M6", spindle, *blocks, "M30", ""))


def read(folder, text, name="part.nc", cell=CELL):
    (folder / name).write_text(text)
    return postproc.read_program(folder / name, ROBOT, cell)


def forces(folder, text, process_text, cell=CELL, name="part.nc", **options):
    """Return the program and its `ProcessForces`."""
    program = read(folder, text, name, cell)
    (folder / "process.toml").write_text(process_text)
    place = RobotInCell.of(ROBOT, cell)
    path = toolpath.segments(program, place.start_flange)
    return program, machining.estimate(program, path, machining.load(folder / "process.toml"), place.spindle, **options)


def on_line(program, found, line, t):
    """Return the wrench (6,) at a place of the motion of a line: linear between the places given."""
    (motion,) = np.flatnonzero(program.motions.line == line)
    rows = found.cuts.motion == motion
    return np.array([np.interp(t, found.cuts.t[rows], found.cuts.wrench[rows, k]) for k in range(6)])


def line_of(text, block):
    """Return the number of the line that holds a block, the last of them."""
    return max(number for number, line in enumerate(text.splitlines(), start=1) if line == block)
