"""Which cutter cuts in a robot program: TOOL_DATA[n] of KRL is [tools.n]; other tools have no numbers."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from tests.commands import convert_text, run

TWO_TOOLS_CELL = """robot = "kuka_kr270"
[base]
X = 1500.0
Y = -200.0
Z = 700.0
[tool]
Z = 350.0
[start]
joints = [0, -90, 100, 0, 80, 0]
[tool_data.1]
Z = 350.0
[tool_data.2]
Z = {length}
[krl]
initmov = "cell"
"""
CUTTER = """[tools.{number}]
shape = "flat"
diameter_mm = 10.0
flutes = 3
rpm = {speed}
"""
PROCESS = """[material]
name = "al_6082_t6_carbide"
{tools}[stock]
box = {{ X = [0, 120], Y = [0, 80], Z = [-15, 0] }}
resolution_mm = 1.0
"""


def slot(y):
    places = ((-10, 20), (-10, -2), (130, -2), (130, 20))
    return "".join(f"LIN {{X {x},Y {y},Z {z},A 180,B 0,C 180}}\n" for x, z in places)


def mill_two_slots(folder, tools, *, first="TOOL_DATA[1]", second="TOOL_DATA[2]", length=320.0, code=0):
    """Two slots, each with a tool and the speed of its entry; return what is printed, and the largest force in each."""
    text = (
        f"DEF part( )\n$VEL.CP=0.02\n$BASE={{X 1500,Y -200,Z 700,A 0,B 0,C 0}}\n$TOOL={first}\n"
        f"PTP {{X -10,Y 20,Z 40,A 180,B 0,C 180}}\n{slot(20)}$TOOL={second}\n"
        f"PTP {{X -10,Y 60,Z 40,A 180,B 0,C 180}}\n{slot(60)}END\n"
    )
    (folder / "cell.toml").write_text(TWO_TOOLS_CELL.format(length=length))
    entries = "".join(CUTTER.format(number=number, speed=speed) for number, speed in tools.items())
    process = PROCESS.format(tools=entries)
    printed = convert_text(folder, "part.src", text, process=process, code=code, cell=folder / "cell.toml").output
    if code:
        return printed, []
    with (folder / "out" / "part.targets.csv").open() as file:
        rows = [
            (int(row["source_line"]), *(float(row[name]) for name in ("Fx", "Fy", "Fz")))
            for row in csv.DictReader(file)
        ]
    lines = np.array([row[0] for row in rows])
    forces = np.linalg.norm(np.array([row[1:] for row in rows]), axis=1)
    return printed, [forces[lines <= 9].max(), forces[lines > 10].max()]


def test_the_number_of_a_tool_is_that_of_its_cutter(tmp_path):
    printed, both = mill_two_slots(tmp_path, {1: 8000, 2: 2000})
    assert "one cutter" not in printed
    alone = [mill_two_slots(tmp_path, {"default": speed}, length=350.0)[1] for speed in (8000, 2000)]
    np.testing.assert_allclose(both, [alone[0][0], alone[1][1]], rtol=0.02)
    assert both[1] > 1.3 * both[0], "the chips are four times as thick"


@pytest.mark.parametrize("tools", [{"default": 8000}, {1: 8000}])
def test_two_tools_that_cut_by_one_entry_are_asked_about(tmp_path, tools):
    printed, forces = mill_two_slots(tmp_path, tools)
    assert "30 mm apart" in printed
    assert "are they one cutter? Give" in printed
    assert "[tools.2]" in printed
    assert forces[0] == pytest.approx(forces[1], rel=0.02)


def test_one_cutter_that_was_measured_twice_is_not_asked_about(tmp_path):
    printed, _ = mill_two_slots(tmp_path, {"default": 8000}, length=350.05)
    assert "one cutter" not in printed


def test_a_tool_whose_lines_only_position_is_not_asked_about(tmp_path):
    """A pointed tool that marks a place above the part by LIN, before the cutter cuts."""
    mill_two_slots(tmp_path, {"default": 8000})
    text = (tmp_path / "part.src").read_text()
    lines = text[text.index("LIN {X -10,Y 60") : text.index("END")]
    (tmp_path / "part.src").write_text(text.replace(lines, "LIN {X 60,Y 60,Z 10,A 180,B 0,C 180}\n"))
    words = (tmp_path / "part.src", "--process", tmp_path / "process.toml", "-o", tmp_path / "out2")
    assert "one cutter" not in run("convert", *words, cell=tmp_path / "cell.toml").output


def test_equal_frames_with_different_cutters_are_refused(tmp_path):
    printed, _ = mill_two_slots(tmp_path, {1: 8000, 2: 2000}, length=350.0, code=1)
    assert "TOOL_DATA[1] and TOOL_DATA[2] are one frame" in printed


def test_a_tool_without_number_needs_the_entry_for_all(tmp_path):
    frame = "{X 0,Y 0,Z 350,A 0,B 0,C 0}"
    printed, _ = mill_two_slots(tmp_path, {1: 8000, 2: 2000}, first=frame, second=frame, length=320.0, code=1)
    assert "no cutter for the $TOOL of this move, which has no number" in printed
    assert "Give [tools.default]" in printed


def test_a_line_to_the_place_of_the_tool_cuts_nothing(tmp_path):
    """A PTP above the part, and a LIN to the same point: a move of no length had "no force"."""
    printed, _ = mill_two_slots(tmp_path, {"default": 8000}, second="TOOL_DATA[1]")
    assert "without a force" not in printed
    (tmp_path / "part.src").write_text((tmp_path / "part.src").read_text().replace("Y 60,Z 40", "Y 60,Z 20"))
    words = (tmp_path / "part.src", "--process", tmp_path / "process.toml", "-o", tmp_path / "out2")
    assert "without a force" not in run("convert", *words, cell=tmp_path / "cell.toml").output


def test_the_set_up_asks_for_the_cutter_of_each_tool(tmp_path):
    mill_two_slots(tmp_path, {1: 8000, 2: 2000})
    printed = run("start", tmp_path / "part.src", code=2).output
    assert "--cutter 1=flat,12    Cutter of TOOL_DATA[1]" in printed
    assert "--cutter 2=flat,12    Cutter of TOOL_DATA[2]" in printed
