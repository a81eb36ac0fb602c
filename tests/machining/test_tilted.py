"""Tools that stand askew to the stock, and several set-ups: against the cutter that is turned tooth by tooth."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from msgspec.structs import replace

from postproc.cell import Rotary
from tests.machining.setting import AL7075, CELL, forces, gcode, line_of, on_line, process, tool
from tests.machining.test_against_teeth import close, tooth_by_tooth
from tests.oracle.teeth import Teeth

FIVE = replace(CELL, rotary=Rotary(axes=["C", "B"], signs=[1, 1], kind="tcp"))
BOX = ((0, 60), (-40, 40), (-20, 0))


def in_box(point, top=0.0):
    inside = np.all([(point[:, k] > BOX[k][0]) & (point[:, k] < BOX[k][1]) for k in range(3)], axis=0)
    return inside & (point[:, 2] < top)


def tilted(degrees):
    """Columns: axes of the tool, z to the spindle, after B turned by an angle."""
    s, c = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def expected(teeth, axes, tip, direction, material, per_tooth=0.1):
    return tooth_by_tooth(
        teeth, axes.T @ tip, axes.T @ direction, per_tooth, lambda p: material(p @ axes.T), steps=180,
    )  # fmt: skip


@pytest.mark.parametrize("degrees", [-15.0, 25.0, 60.0])
@pytest.mark.parametrize("shape", ["flat", "ball"])
def test_a_tool_askew_along_an_edge(tmp_path, degrees, shape):
    """Along the edge at x = 60, z = 0, so that the tool cuts a chamfer or a groove."""
    block = "Y50 (here)"
    text = gcode(f"G0 B{degrees} X58 Y-60 Z-1.5", "G1 Y-50 F2400", block)
    program, found = forces(tmp_path, text, process(tool(10, 4, shape), BOX), FIVE)
    teeth = Teeth(5.0, 5.0 if shape == "ball" else 0.0, 4, AL7075).side(40.0, discs=500)
    force = expected(teeth, tilted(degrees), np.array([58, 0, -1.5]), np.array([0, 1.0, 0]), in_box)
    close(on_line(program, found, line_of(text, block), 0.5), force)


@pytest.mark.parametrize("degrees", [-20.0, 20.0])
def test_a_ball_askew_that_is_drawn_or_pushed(tmp_path, degrees):
    text = gcode(f"G0 B{degrees} X70 Y0 Z10", "Z-2", "G1 X-10 F2400 (here)")
    program, found = forces(tmp_path, text, process(tool(10, 4, "ball"), BOX), FIVE)
    teeth = Teeth(5.0, 5.0, 4, AL7075, discs=400)
    force = expected(teeth, tilted(degrees), np.array([30, 0, -2.0]), np.array([-1.0, 0, 0]), in_box)
    close(on_line(program, found, line_of(text, "G1 X-10 F2400 (here)"), 0.5), force)


TWO = process(tool(10, 4), BOX).replace("[stock]", "[tools.2]\n" + tool(100, 4) + "[stock]")
FACE = ("T2 M6", "S6000 M3", "G0 X30 Y-100 Z-2", "G1 Y100 F2400", "G0 Z50", "T1 M6", "S6000 M3")


def test_a_tool_that_is_turned_between_two_cuts_meets_what_is_left(tmp_path):
    """A face of 2 mm, then an edge of what is left with the tool at 30°."""
    text = gcode(*FACE, "G0 B30", "X58 Y-60 Z-3.5", "G1 Y-50 F2400", "Y50 (here)")
    program, found = forces(tmp_path, text, TWO, FIVE)
    teeth = Teeth(5.0, 0.0, 4, AL7075).side(20.0, discs=500)
    force = expected(
        teeth, tilted(30.0), np.array([58, 0, -3.5]), np.array([0, 1.0, 0]), lambda p: in_box(p, -2.0)
    )  # fmt: skip
    close(on_line(program, found, line_of(text, "Y50 (here)"), 0.5), force)
    x, z = np.meshgrid(np.arange(50.005, 60.0, 0.01), np.arange(-9.995, -2.0, 0.01))
    across, _, up = (np.stack([x - 58, 0 * x, z + 3.5], axis=-1) @ tilted(30.0)).reshape(-1, 3).T
    edge = 0.01**2 * np.count_nonzero((np.abs(across) < 5.0) & (up > 0.0))
    assert edge > 1.0
    assert found.removed_volume == pytest.approx((60 * 2 + edge) * 80e-9, rel=0.005)


def test_what_one_program_leaves_is_the_stock_of_the_next(tmp_path):
    _, first = forces(tmp_path, gcode(*FACE[:-2]), TWO)
    vertices, faces, _ = first.mesh()
    trimesh.Trimesh(vertices * 1e3, faces).export(tmp_path / "rest.stl")
    text = gcode("G0 X-10 Y0 Z5", "G1 Z-3 F2400", "X70 (here)")
    program, found = forces(tmp_path, text, TWO, stock=tmp_path / "rest.stl")
    teeth = Teeth(5.0, 0.0, 4, AL7075).side(3.0)
    force = tooth_by_tooth(teeth, (30, 0, -3), (1, 0, 0), 0.1, lambda p: in_box(p, -2.0), steps=360)
    close(on_line(program, found, line_of(text, "X70 (here)"), 0.5), force)
