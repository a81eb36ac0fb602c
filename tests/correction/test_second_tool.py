"""A second tool in a cell that does not say how tools are changed."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

import postproc
from postproc.cell import Collision, Frame, HolderTable
from postproc.correction.inspection import holder_issues
from tests.machining.setting import CELL, ROBOT

TWO = "G21 G90 G17\nT1 M6\nG0 X0 Y0 Z50\nG1 X20 F900\n(more)\nT2 M6\nG1 X40\nM30\n"


def written(folder, text, change):
    (folder / "part.nc").write_text(text)
    cell = replace(CELL, gcode=replace(CELL.gcode, tool_change=change))
    program = postproc.read_program(folder / "part.nc", ROBOT, cell)
    return {mode: postproc.process(program, ROBOT, cell, None, mode) for mode in ("convert", "nominal", "predict")}


def test_a_second_tool_is_refused_where_the_cell_does_not_say_how(tmp_path):
    found = written(tmp_path, TWO, None)
    for result in found.values():
        assert result.failed
        (issue,) = [issue for issue in result.issues if issue.level == "error"]
        assert (issue.kind, issue.source_line) == ("tool-change", 6)
        assert "tool_change = []" in issue.message


def test_a_tool_changed_by_hand_or_by_lines_is_written(tmp_path):
    by_hand = written(tmp_path, TWO, [])["convert"]
    assert not by_hand.failed
    assert not any("tool_change" in issue.message for issue in by_hand.issues)
    assert "HALT ;2" in written(tmp_path, TWO, ["HALT ;{T}"])["convert"].documents[0].text
    assert not written(tmp_path, TWO.replace("T2", "T1"), None)["convert"].failed


CUTTER, SPINDLE = HolderTable(diameter_mm=10, length_mm=40), HolderTable(diameter_mm=120, length_mm=180)


@pytest.mark.parametrize(
    ("second", "holder", "lines"),
    [
        ({"Z": 390.0}, [CUTTER, SPINDLE], (7,)),
        ({"Z": 350.0}, [CUTTER, SPINDLE], ()),
        ({"Z": 390.0}, [CUTTER, HolderTable(mesh="spindle.stl")], ()),
        ({"Z": 390.0}, [], ()),
        ({"Z": 390.0}, [CUTTER, HolderTable(mesh="spindle.stl"), SPINDLE], (7,)),
        ({"Z": 350.11}, [CUTTER, SPINDLE], (7,)),
        ({"Z": 350.09}, [CUTTER, SPINDLE], ()),
    ],
    ids=[
        "longer",
        "same",
        "a mesh is placed from the flange",
        "no holder",
        "a mesh in addition",
        "by a tenth of a mm",
        "by less",
    ],
)
def test_tools_of_other_lengths_share_no_holder(tmp_path, second, holder, lines):
    cell = replace(CELL, tools={"1": Frame(Z=350.0), "2": Frame(**second)}, collision=Collision(holder=holder))
    (tmp_path / "part.nc").write_text(TWO)
    program = postproc.read_program(tmp_path / "part.nc", ROBOT, cell)
    found = holder_issues(program, cell)
    assert [(each.level, each.source_line) for each in found] == [("warning", line) for line in lines]
    assert all(f"are {second['Z'] - 350.0:.4g} mm apart" in each.message for each in found)
