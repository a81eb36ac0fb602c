"""A milling cell whose spindle is across the flange: the turn about the tool axis moves all joints of the wrist."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc import cell as cells
from postproc import correction, robot
from postproc.cell import CellFile, Frame, Start, Tool
from tests.corrections import read_files

ROBOTS = {"kuka_kr270": (0, -90, 110, 0, 60, 0), "abb_irb6700_200_260": (0, -80, 110, 0, 60, 0)}


def cell(name="kuka_kr270", base=(0.0, 0.0, 700.0), tool=(350.0, 200.0), **gcode):
    made = CellFile(
        robot=name,
        base=Frame(X=base[0], Y=base[1], Z=base[2]),
        tool=Tool(X=tool[0], Z=tool[1], axis="+X"),
        start=Start(joints=ROBOTS[name]),
    )
    made = cells.Cell(**{field: getattr(made, field) for field in made.__struct_fields__})
    return replace(made, gcode=replace(made.gcode, rapid_m_per_s=0.3, **gcode))


def read_with_robot(text, cell, dialect="gcode"):
    model = robot.load(robot.find(cell.robot))
    name = "part.nc" if dialect == "gcode" else "part.src"
    return read_files({name: text}, cell, model), model


def process_text(text, cell, **options):
    program, model = read_with_robot(text, cell)
    return correction.process(program, model, cell, None, to=model.language or None, **options)


def around(radius, degrees, count=61, feed=3000):
    """An arc about the robot, in chords: the robot turns A1, the tool must turn with it to be reached."""
    angles = np.radians(np.linspace(-degrees, degrees, count))
    points = [f"X{radius * np.cos(a):.2f} Y{radius * np.sin(a):.2f}" for a in angles]
    lines = ["G21 G90", f"G0 {points[0]} Z60", "G1 Z0 F1500", *(f"G1 {p} F{feed}" for p in points[1:]), "G0 Z60"]
    return "\n".join(lines) + "\n"


TWO_POCKETS = """G21 G90
(FORCE FX=-110 FY=-190 FZ=130 FRAME=FEED)
G0 X{0} Y-150 Z60
G1 Z0 F600
G1 X{1} F2000
G1 Y-50
G1 X{0}
G0 Z60
G0 X{0} Y450
G1 Z0 F600
G1 X{1} Y450 F2000
G1 Y550
G0 Z60
"""
