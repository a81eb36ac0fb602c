"""Comparison with a G-code program whose tool `convert` turned about its axis: the nominal tool is turned as well."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests import commands

TURNED_CELL = """robot = "kuka_kr270"
[base]
X = 1400.0
Y = 150.0
Z = 750.0
A = 30.0
B = 4.0
C = -6.0
[tool]
X = 40.0
Y = -30.0
Z = 300.0
A = 20.0
B = -60.0
C = 10.0
axis = "+X"
[output]
tolerance_mm = 0.01
[gcode]
redundancy = "{mode}"
spindle_on = []
"""
PROGRAM = """G21 G90 G17 G94
S8000 M3
G0 X-10 Y30 Z20
Z-2
G1 X50 F1200
G3 X50 Y50 Z-3 I0 J10
G1 X0 Y55
G0 Z20
M30
"""
FORCES = "line,Fx,Fy,Fz,frame,line_end\n5,200,-200,90,TOOL,7\n"


@pytest.fixture(autouse=True)
def input_files(work_folder):
    Path("part.nc").write_text(PROGRAM)
    Path("forces.csv").write_text(FORCES)


@pytest.mark.parametrize("mode", ["best", "path"])
def test_a_force_in_axes_of_the_tool_has_the_direction_that_the_corrected_program_was_made_for(mode):
    Path("cell.toml").write_text(TURNED_CELL.format(mode=mode))
    commands.run("convert", "part.nc", "--forces", "forces.csv", "-o", "out", code=(0, 3), cell="cell.toml")
    report = json.loads(Path("out/part.report.json").read_text(encoding="utf-8"))
    assert abs(report["redundancy"]["min_deg"]) > 1.0, "else there would be nothing to see"
    content = commands.comparison("part.nc", "out/part.src", "--forces", "forces.csv", cell="cell.toml")
    assert content["verdict"]["state"] == "ok"
    assert content["rotation"]["max_deg"] < 0.1, "of the correction alone"
    assert content["cut"]["corrected"]["max_mm"] < 0.001
    uncorrected = report["before"]["max_mm"]
    assert content["cut"]["nominal"]["max_mm"] == pytest.approx(uncorrected, rel=0.01)
