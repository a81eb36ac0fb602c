"""`init`, `samples`, shell completion, `python -m postproc`."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from postproc import cell as cells
from postproc import robot
from tests.commands import invoke
from tests.oracle.arm import Arm, abc
from tests.places import ROOT

pytestmark = pytest.mark.usefixtures("work_folder")

CONFIG = """&ACCESS RVO
DEFDAT  $CONFIG
DECL FRAME BASE_DATA[32]
BASE_DATA[1]={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}
BASE_DATA[3]={X 1200.0,Y 10.5,Z 650.25,A 30.0,B 0.0,C -1.5}
TOOL_DATA[2]={X 10,Y 0.0,Z 412.125,A 0.0,B 0.0,C 0.0}
ENDDAT
"""
FRAMES = ("--base", "1500,-200,700", "--tool", "0,0,350")


def keys(frame):
    return [frame.X, frame.Y, frame.Z, frame.A, frame.B, frame.C]


@pytest.mark.parametrize("name", [name for name in robot.shipped_models() if name.startswith("kuka_")])
def test_a_cell_by_options_holds_what_was_given(name):
    done = invoke(
        "init", "my.toml", "--robot", name, "--base", "-600.5,-20,400,10,-20,30", "--tool", "1,2,150", "--axis=-Z",
        "--start", "1,-71,101,3,51,5",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    cell = cells.load("my.toml")
    assert cell.robot == name
    assert keys(cell.base) == [-600.5, -20, 400, 10, -20, 30]
    assert keys(cell.tool) == [1, 2, 150, 0, 0, 0]
    assert cell.tool.axis == "-Z"
    assert cell.start.joints == (1, -71, 101, 3, 51, 5)


def test_the_cell_of_the_samples_made_by_options_converts_a_sample():
    assert invoke("init", "--robot", "kuka_kr270", *FRAMES).exit_code == 0
    done = invoke("convert", str(ROOT / "samples" / "pocket.nc"), "--cell", "cell.toml", "-o", "out")
    assert done.exit_code == 0, done.output


def test_a_cell_for_an_arm_that_reads_rapid_has_lines_of_rapid_and_says_how_to_convert():
    done = invoke("init", "--robot", "abb_irb6700_200_260", *FRAMES)
    assert done.exit_code == 0, done.output
    assert "--cell cell.toml --to rapid" in done.output
    text = Path("cell.toml").read_text()
    assert "how G-code becomes RAPID" in text
    Path("cell.toml").write_text(re.sub(r"^# (\w+ = \[\".*)$", r"\1", text, flags=re.M))
    assert cells.load("cell.toml").gcode.tool_change == ["! tool {T} by hand", "Stop;"]
    made = invoke("convert", str(ROOT / "samples" / "pocket.nc"), "--cell", "cell.toml", "--to", "rapid", "-o", "out")
    assert made.exit_code == 0, made.output


@pytest.mark.parametrize("robot_name", ["kuka_kr270", "abb_irb6700_200_260"])
def test_every_line_that_is_commented_out_in_a_cell_can_be_used(robot_name):
    assert invoke("init", "--robot", robot_name, *FRAMES).exit_code == 0
    text = Path("cell.toml").read_text()
    used = re.sub(r"^# (?!config_dat)(\[?\w[\w.]*(?:\]| = ).*)$", r"\1", text, flags=re.M)
    Path("cell.toml").write_text(used)
    cell = cells.load("cell.toml")
    assert cell.machine.clearance_Z == 200.0
    assert cell.gcode.spindle_on != []


@pytest.mark.parametrize("axis", ["+Z", "-Z", "+X"])
def test_the_tool_is_turned_so_that_a6_stays_near_its_start(axis):
    tool = {"+Z": "0,0,350", "-Z": "0,0,350,0,180,0", "+X": "0,0,350,0,-90,0"}[axis]
    start = "0,-70,110,0,50,0"
    invoke("init", "--robot", "kuka_kr270", "--base", "1500,-200,700", "--tool", tool, "--start", start, "--axis", axis)
    done = invoke("convert", str(ROOT / "samples" / "pocket.nc"), "--cell", "cell.toml", "-o", "out")
    assert done.exit_code == 0, done.output
    assert "first move turns" not in done.output
    text = Path("cell.toml").read_text()
    turned = cells.load("cell.toml").gcode.redundancy_deg
    Path("other.toml").write_text(text.replace(f"redundancy_deg = {turned}", f"redundancy_deg = {turned - 180}"))
    done = invoke("convert", str(ROOT / "samples" / "pocket.nc"), "--cell", "other.toml", "-o", "out")
    assert "first move turns" in done.output


def test_who_gives_no_cell_is_told_how_to_get_one():
    for command in ("convert", "predict"):
        done = invoke(command, "part.nc")
        assert done.exit_code == 2
        assert "postproc init writes one" in done.stderr


def test_what_is_optional_can_be_used_by_taking_the_comment_sign_away():
    invoke("init", "--robot", "kuka_kr270", *FRAMES)
    text = Path("cell.toml").read_text()
    lines = [line.removeprefix("# ") if "=" in line or line.startswith("# [") else line for line in text.splitlines()]
    Path("more.toml").write_text("\n".join(lines))
    cell = cells.load("more.toml")
    assert cell.gcode.spindle_on == ["$ANOUT[1]={S}/24000.0", "$OUT[1]=TRUE"]
    assert list(cell.work_offsets) == ["G55"]


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_frames_by_number_are_those_of_the_config_dat(end):
    Path("R1").mkdir()
    Path("R1/$config.dat").write_bytes(CONFIG.replace("\n", end).encode())
    Path("cells").mkdir()
    done = invoke(
        "init", "cells/c.toml", "--robot", "kuka_kr270", "--config-dat", "R1/$config.dat", "--base", "3", "--tool", "2"
    )
    assert done.exit_code == 0, done.output
    cell = cells.load("cells/c.toml")
    np.testing.assert_allclose(keys(cell.base), [1200, 10.5, 650.25, 30, 0, -1.5], atol=1e-6)
    np.testing.assert_allclose(keys(cell.tool), [10, 0, 412.125, 0, 0, 0], atol=1e-6)
    assert (Path("cells") / cell.config_dat).resolve() == Path("R1/$config.dat").resolve()


@pytest.mark.parametrize(
    ("options", "message", "code"),
    [
        (("--config-dat", "c.dat", "--base", "7", "--tool", "2"), "c.dat: no BASE_DATA[7]", 1),
        (("--config-dat", "c.dat", "--base", "3", "--tool", "9"), "c.dat: no TOOL_DATA[9]", 1),
        (("--config-dat", "none.dat", "--base", "3", "--tool", "2"), "none.dat", 1),
        (("--base", "3", "--tool", "0,0,1"), "Name it with --config-dat", 2),
        (("--base", "1,2", "--tool", "0,0,1"), "$BASE: 2 numbers", 2),
        (("--base", "1,2,nan", "--tool", "0,0,1"), "$BASE: 1, 2, nan. Give finite numbers.", 2),
        ((*FRAMES, "--start", "0,-70,110"), "start joints: 3 numbers", 2),
        ((*FRAMES, "--start", "0,90,110,0,50,0"), "A2 = 90° is beyond its limits, -146° to 0°", 2),
        ((*FRAMES, "--robot", "kuka_kr999"), "no robot 'kuka_kr999'", 1),
    ],
)
def test_what_cannot_be_is_told_and_nothing_is_written(options, message, code):
    Path("c.dat").write_text(CONFIG)
    done = invoke("init", "--robot", "kuka_kr270", *options)
    assert done.exit_code == code
    assert message in done.stderr
    assert not Path("cell.toml").exists()


def test_a_base_out_of_reach_is_written_and_told():
    done = invoke("init", "--robot", "kuka_kr270", "--base", "5000,0,700", "--tool", "0,0,350")
    assert done.exit_code == 0
    assert "out of reach: the origin of $BASE" in done.stderr


def test_a_cell_that_is_there_is_replaced_with_overwrite_only():
    Path("cell.toml").write_text("mine")
    arguments = ("init", "--robot", "kuka_kr270", *FRAMES)
    assert "this file is there" in invoke(*arguments).stderr
    assert Path("cell.toml").read_text() == "mine"
    assert invoke(*arguments, "--overwrite").exit_code == 0
    assert cells.load("cell.toml").robot == "kuka_kr270"
    before = Path("cell.toml").read_bytes()
    done = invoke("init", "--robot", "kuka_kr270", "--base", "1500,0,700", "--tool", "0,0,1e308", "--overwrite")
    assert done.exit_code == 1
    assert Path("cell.toml").read_bytes() == before
    assert [path.name for path in Path().iterdir() if path.name.startswith(".cell")] == []


def test_a_model_folder_is_named_by_its_way_from_the_cell():
    source = robot.find("kuka_kr16_2")
    Path("models/mine").mkdir(parents=True)
    for name in ("robot.urdf", "model.toml"):
        (Path("models/mine") / name).write_bytes((source / name).read_bytes())
    Path("cells").mkdir()
    assert invoke("init", "cells/c.toml", "--robot", "models/mine", *FRAMES).exit_code == 0
    assert cells.load("cells/c.toml").robot == "../models/mine"


def test_a_model_folder_on_another_drive_is_named_as_it_stands(monkeypatch):
    def none(*_):
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    source = robot.find("kuka_kr16_2")
    Path("mödel 🤖").mkdir()
    for name in ("robot.urdf", "model.toml"):
        (Path("mödel 🤖") / name).write_bytes((source / name).read_bytes())
    monkeypatch.setattr("postproc.jobs.first_steps.relpath", none)
    assert invoke("init", "--robot", "mödel 🤖", *FRAMES).exit_code == 0
    assert Path(cells.load("cell.toml").robot) == Path("mödel 🤖").absolute()


def tip_at_start(cell):
    """X, Y and Z of the tip in `$BASE` [mm] at [start], by another arm."""
    arm = Arm.load(robot.find(cell.robot))
    pose = arm.nominal_tcp(np.radians(cell.start.joints), abc(*keys(cell.tool)))
    return (1e3 * (np.linalg.inv(abc(*keys(cell.base))) @ pose)[:3, 3]).tolist()


@pytest.mark.parametrize("name", ["kuka_kr270", "kuka_kr6_r900_2", "abb_irb6700_200_260"])
def test_programs_start_above_the_height_of_retracts_unless_joints_are_given(name):
    base = "500,-100,200,30,0,0" if name == "kuka_kr6_r900_2" else "1500,-200,700,30,0,0"
    frames = ("--robot", name, "--base", base, "--tool", "0,0,150", "--clearance", "120")
    done = invoke("init", *frames)
    assert (done.exit_code, done.stderr) == (0, "")
    assert tip_at_start(cells.load("cell.toml")) == pytest.approx([0, 0, 170], abs=5)
    Path("part.nc").write_text("G21 G90 G17\nG28 G91 Z0\nG90\nG0 X50 Y100\nZ5\nG1 Z-2 F300\nX60 F900\nM30\n")
    to = ["--to", "rapid"] if name.startswith("abb") else []
    done = invoke("convert", "part.nc", "--cell", "cell.toml", "-o", "out", *to)
    assert done.exit_code == 0, done.output
    assert "first move" not in done.output


def test_a_start_below_the_height_of_retracts_is_reported():
    done = invoke("init", "--robot", "kuka_kr270", "--base", "1500,-200,700", "--tool", "0,0,350",
               "--clearance", "150", "--start", "0,-70,110,0,50,0")  # fmt: skip
    assert done.exit_code == 0
    assert "the tip is at X 85, Y 200, Z -105 of $BASE, 255 mm below clearance_Z" in done.stderr
    Path("part.nc").write_text("G21 G90 G17\nG28 G91 Z0\nG90\nG0 X50 Y100\nZ5\nG1 Z-2 F300\nX60 F900\nM30\n")
    done = invoke("convert", "part.nc", "--cell", "cell.toml", "-o", "out")
    assert done.exit_code == 0, done.output
    where = "The first move begins below clearance_Z: at [start] the tip is at Z -104.6 mm of $BASE, 254.6 mm below it."
    assert where in " ".join(done.output.split())
    text = Path("cell.toml").read_text()
    Path("cell.toml").write_text(text.replace("clearance_Z = 150.0", ""))
    Path("part.nc").write_text("G21 G90 G17\nG0 X50 Y100 Z5\nG1 Z-2 F300\nX60 F900\nM30\n")
    done = invoke("convert", "part.nc", "--cell", "cell.toml", "-o", "out", "--overwrite")
    assert "- line 2: The first move begins below the first target" in done.output
    assert "109.6 mm below it" in done.output


@pytest.mark.parametrize("angles", ["0,180,0", "0,0,180", "30,-100,0"])
def test_a_base_upside_down_gets_a_warning(angles):
    done = invoke("init", "--robot", "kuka_kr270", "--base", f"1500,0,700,{angles}", "--tool", "0,0,350")
    assert done.exit_code == 0
    a, b, c = angles.split(",")
    assert f"warning: Z of $BASE points down (A {a}, B {b}, C {c}): the tool would come from below" in done.stderr
    for usual in ("180,0,0", "0,90,0", "90,0,-60"):
        done = invoke(
            "init", "--robot", "kuka_kr270", "--base", f"1500,0,700,{usual}", "--tool", "0,0,350", "--overwrite"
        )
        assert "points down" not in done.stderr


def test_a_tool_or_a_base_in_metres_is_asked_about():
    done = invoke("init", "--robot", "kuka_kr270", "--base", "1.5,0,0.7", "--tool", "0,0,0.35")
    assert done.exit_code == 0
    assert "is 1.66 mm from the robot root: are X, Y, Z in mm? --base is in mm: 1.5 m are 1500" in done.stderr
    assert "is 0.35 mm from the flange: is Z in mm? --tool is in mm: a tool of 0.35 m has Z = 350" in done.stderr
    done = invoke("init", "--robot", "kuka_kr270", "--base", "1500,0,700", "--tool", "0,0,350", "--overwrite")
    assert "in mm?" not in done.stderr


def test_without_a_terminal_what_is_missing_is_wrong_usage():
    done = invoke("init", "--base", "0,0,0")
    assert done.exit_code == 2
    assert "Give --robot, --tool" in done.stderr
    assert invoke("init", "--base", "a,b,c").exit_code == 2


def test_on_a_terminal_it_asks_and_takes_what_stands_in_brackets(monkeypatch):
    monkeypatch.setattr("postproc.cli.first_steps.is_terminal", lambda: True)
    for name in robot.shipped_models():
        done = invoke("init", f"{name}.toml", input=f"{name}\n\n0,0,100\n" + 9 * "\n")
        assert done.exit_code == 0, done.output
        assert "out of reach" not in done.stderr
    done = invoke("init", input="KR270\n\nnonsense\n900,0,600\n" + 10 * "\n")
    assert done.exit_code == 0, done.output
    assert "no robot 'KR270'" in done.output
    cell = cells.load("cell.toml")
    assert (cell.robot, keys(cell.base)[:3], cell.tool.Z) == ("kuka_kr270", [900, 0, 600], 350)
    assert tip_at_start(cell) == pytest.approx([0, 0, 250], abs=5)
    assert (cell.machine.clearance_Z, cell.part.tolerance_mm, cell.tools) == (200.0, None, {})
    assert (cell.gcode.spindle_on, cell.gcode.coolant_off) == ([], [])
    assert cell.gcode.tool_change == ["; tool {T} by hand", "HALT"]


def test_answers_for_retract_tools_tool_change_and_tolerance_are_in_the_cell(monkeypatch):
    monkeypatch.setattr("postproc.cli.first_steps.is_terminal", lambda: True)
    answers = [
        "",
        "1000,0,500",
        "",
        "T1=310 1.5=3 2=1,2,412.5",
        "1=310 2=1,2,412.5",
        "G60=1,2,3",
        "G55=300,0,0 g59.1=0,250,-20,90",
        "M31 coolant",
        "M31, m08 33",
        "M31, m010 33",
        "",
        "high",
        "150",
        "CHANGE({T)",
        "CHANGE({T})",
        "$OUT[1]=TRUE",
        "SPIN({S})|$OUT[1]=FALSE",
        "hand",
        "-1",
        "0.2",
    ]
    done = invoke("init", input="\n".join([*answers, ""]))
    assert done.exit_code == 0, done.output
    assert "'high' is not a number" in done.output
    assert "'$OUT[1]=TRUE': give both lines" in done.output
    assert "'-1': give a length above 0" in done.output
    gcode = cells.load("cell.toml").gcode
    assert (gcode.spindle_on, gcode.spindle_off, gcode.coolant_on) == (["SPIN({S})"], ["$OUT[1]=FALSE"], [])
    assert "'1.5=3': give the number of the tool" in done.output
    assert "'G60=1,2,3': give G54 to G59.3" in done.output
    assert "'coolant': give an M code" in done.output
    assert "'CHANGE({T)': { is not closed" in done.output
    assert "'m08': M8 has a meaning already. Give its lines in [gcode]: coolant_on." in done.output
    cell = cells.load("cell.toml")
    assert {number: (tool.X, tool.Y, tool.Z) for number, tool in cell.tools.items()} == {
        "1": (0, 0, 310), "2": (1, 2, 412.5)
    }  # fmt: skip
    assert (cell.machine.clearance_Z, cell.part.tolerance_mm) == (150.0, 0.2)
    assert cell.gcode.tool_change == ["CHANGE({T})"]
    assert {code: keys(frame) for code, frame in cell.work_offsets.items()} == {
        "G55": [300, 0, 0, 0, 0, 0], "G59.1": [0, 250, -20, 90, 0, 0]
    }  # fmt: skip
    assert cell.m_codes == {"M31": [], "M10": [], "M33": []}


def test_a_new_cell_converts_a_program_with_work_offsets_m_codes_and_radius_compensation():
    Path("part.nc").write_text(
        "G21 G90 G17\nM31\nT1 M6\nS9000 M3\nG55 G0 X0 Y0\nG43 H1 Z50.\nG1 Z-2. F300\nG41 D1 X5.\nX40. F900\n"
        "G40 X50.\nG0 Z50.\nM30\n"
    )
    options = ("--robot", "kuka_kr270", *FRAMES, "--overwrite")
    more = ("--work-offset", "G55=300,-40,0", "--m-code", "31", "--radius-offsets", "wear")
    for left_out, message in zip(
        (more[2:], more[:2] + more[4:], more[:4]),
        ("work offset G55 is not in the cell", "M31 is not known", "G41 is not supported"),
        strict=True,
    ):
        assert invoke("init", *options, *left_out).exit_code == 0
        done = invoke("convert", "part.nc", "--cell", "cell.toml", "-o", "out")
        assert message in done.output
    assert invoke("init", *options, *more).exit_code == 0
    done = invoke("convert", "part.nc", "--cell", "cell.toml", "-o", "out")
    assert done.exit_code == 0, done.output
    assert "X 340,Y -40,Z -2," in Path("out/part.src").read_text()


@pytest.mark.parametrize("words", [("--work-offset", "G55"), ("--work-offset", "G53=0,0,0"), ("--m-code", "G31")])
def test_work_offsets_and_m_codes_that_cannot_be_are_wrong_usage(words):
    done = invoke("init", "--robot", "kuka_kr270", *FRAMES, *words)
    assert done.exit_code == 2
    assert f"{words[1]!r}: give" in done.stderr
    assert not Path("cell.toml").exists()


@pytest.mark.parametrize(
    ("option", "values", "message"),
    [
        ("--tools", ("1=350", "T1=0,0,300"), "tool 1 is given twice, 0,0,350 and 0,0,300: leave one"),
        ("--work-offset", ("G55=300,0,0", "g55=400,0,0"), "G55 is given twice, 300,0,0 and 400,0,0: leave one"),
    ],
)
def test_options_that_contradict_each_other_are_wrong_usage(option, values, message):
    """The last one held."""
    options = ("--robot", "kuka_kr270", *FRAMES, option)
    done = invoke("init", *options, values[0], option, values[1])
    assert done.exit_code == 2
    assert message in " ".join(done.stderr.split())
    assert not Path("cell.toml").exists()
    assert invoke("init", *options, values[0], option, values[0]).exit_code == 0


def test_a_line_of_the_tool_change_that_is_not_closed_is_wrong_usage():
    """It was written, and `convert` called it a fault of its own."""
    done = invoke("init", "--robot", "kuka_kr270", *FRAMES, "--tool-change", "CHG({T)")
    assert done.exit_code == 2
    assert "'CHG({T)': { is not closed" in done.stderr
    assert not Path("cell.toml").exists()


def test_tables_of_a_new_cell_have_an_empty_line_between_them():
    more = ("--tools", "1=350", "--work-offset", "G55=300,0,0", "--work-offset", "G56=1,0,0", "--m-code", "M31")
    assert invoke("init", "--robot", "kuka_kr270", *FRAMES, *more).exit_code == 0
    lines = Path("cell.toml").read_text().splitlines()
    tables = [k for k, line in enumerate(lines) if line.startswith("[")]
    assert [lines[k] for k in tables[-4:]][:3] == ["[tools.1]", "[work_offsets.G55]", "[work_offsets.G56]"]
    assert all("" in lines[first:second] for first, second in pairwise(tables))


@pytest.mark.parametrize("code", ["M0", "6", "M30", "m98", "M10000"])
def test_an_m_code_that_has_a_meaning_already_is_wrong_usage(code):
    done = invoke("init", "--robot", "kuka_kr270", *FRAMES, "--m-code", code)
    assert done.exit_code == 2
    assert f"{code!r}: M" in done.stderr
    assert not Path("cell.toml").exists()


def test_a_new_cell_converts_a_program_that_retracts_and_changes_tools():
    Path("part.nc").write_text(
        "%\nG21 G90 G17 G40 G80\nG28 G91 Z0.\nG90\nT1 M6\nS9000 M3\nG54\nG0 X0 Y0\nG43 H1 Z50.\nG1 Z-2. F300\n"
        "G1 X40. F900\nG0 Z50.\nM5\nG53 G0 Z0.\nT2 M6\nM3\nG0 X0 Y10. Z50.\nG1 Z-2. F300\nX40.\nG28 G91 Z0.\nM30\n%\n"
    )
    options = ("--robot", "kuka_kr270", "--base", "1500,0,700", "--tools", "1=350", "--tools", "2=0,0,380")
    assert invoke("init", *options, "--clearance", "120").exit_code == 0
    done = invoke("convert", "part.nc", "--cell", "cell.toml", "-o", "out")
    assert done.exit_code == 0, done.output
    text = Path("out/part.src").read_text()
    assert text.count("HALT") == 2
    assert "Z 120," in text
    assert "Z 380" in text


@pytest.mark.parametrize(
    ("options", "message"),
    [(("--clearance", "nan"), "nan is no number"), (("--part-tolerance", "0"), "0.0 is not in the range")],
)
def test_numbers_that_cannot_be_are_refused_before_anything_is_written(options, message):
    done = invoke("init", "--robot", "kuka_kr270", *FRAMES, *options)
    assert done.exit_code == 2
    assert message in done.stderr
    assert not Path("cell.toml").exists()


@pytest.mark.parametrize("programs", [(), ("part.nc",)])
def test_a_payload_is_in_the_cell_and_the_load_of_a_rapid_tool(programs):
    """Without it a RAPID program has a warning that no answer of init took away."""
    Path("part.nc").write_text("G21 G90\nG0 X0 Y0 Z20\nG1 Z-1 F900\nG1 X80\nG0 Z60\nM2\n")
    command = ("init", "cell.toml", *programs, "--robot", "abb_irb6700_200_260", *FRAMES)
    for payload, warned in (("28,0,0,140", False), ("", True)):
        done = invoke(*command, *(("--payload", payload) if payload else ()), "--overwrite")
        assert done.exit_code == 0, done.output
        stated = cells.load("cell.toml").payload
        assert (stated.mass_kg, stated.X, stated.Y, stated.Z) == ((28, 0, 0, 140) if payload else (0, 0, 0, 0))
        done = invoke("convert", "part.nc", "--cell", "cell.toml", "--to", "rapid", "-o", payload or "none")
        assert ("The tool data have no load" in done.output) == warned
        assert ("[28,[0,0,140]" in (Path(payload or "none") / "part.mod").read_text()) != warned


@pytest.mark.parametrize("text", ["0", "28,0", "many", "-3,0,0,100", "inf"])
def test_a_payload_that_cannot_be_is_refused(text):
    done = invoke("init", "--robot", "abb_irb6700_200_260", *FRAMES, "--payload", text)
    assert done.exit_code == 2
    assert "--payload" in done.stderr
    assert not Path("cell.toml").exists()


def test_a_cell_file_that_is_missing_points_to_init():
    done = invoke("convert", str(ROOT / "samples" / "pocket.nc"), "--cell", "shop.toml")
    assert done.exit_code == 1
    assert "shop.toml: no such file" in done.stderr
    assert "postproc init shop.toml" in done.stderr


def test_samples_are_copied_and_not_over_changed_ones():
    done = invoke("samples", "mine")
    assert done.exit_code == 0, done.output
    for name in ("pocket.nc", "cell_kr270.toml", "paper_study/study.py", "paper_study/README.md"):
        assert (Path("mine") / name).read_bytes() == (ROOT / "samples" / name).read_bytes()
    assert invoke("samples", "mine").exit_code == 0
    Path("mine/pocket.nc").write_text("G0 X0\n")
    changed = invoke("samples", "mine")
    assert changed.exit_code == 1
    assert str(Path("mine/pocket.nc")) in changed.stderr
    assert Path("mine/pocket.nc").read_text() == "G0 X0\n"
    assert invoke("samples", "mine", "--overwrite").exit_code == 0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("postproc robots kuka_kr27", "plain,kuka_kr270"),
        ("postproc robots show kuka_kr1", "plain,kuka_kr16_2"),
        ("postproc init --robot kuka_kr27", "plain,kuka_kr270"),
        ("postproc con", "plain,convert"),
        ("postproc convert part.nc --cell ", "file,"),
        ("postproc convert ", "file,"),
    ],
)
def test_the_shell_completes_commands_robots_and_files(words, expected):
    given = words.split(" ")
    environment = os.environ | {
        "_POSTPROC_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(len(given) - 1)
    }  # fmt: skip
    command = [sys.executable, "-c", "from postproc.__main__ import main; main()"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert expected in done.stdout.splitlines(), done.stdout + done.stderr


def test_python_m_postproc_is_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "postproc", "robots", "--json"], capture_output=True, text=True, check=True
    )
    assert "kuka_kr270" in done.stdout


def test_commands_to_type_have_names_with_blanks_in_quotes(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    missing = invoke("convert", "part.nc", cell="my cell.toml")
    given = ["--robot", "kuka_kr270", "--base", "1500,-200,700", "--tool", "0,0,350"]
    written = invoke("init", "my cell.toml", *given)
    samples = invoke("samples", "my samples")
    assert 'Write one with: postproc init "my cell.toml"' in missing.output
    assert 'postproc convert PROGRAM --cell "my cell.toml"' in written.output
    assert f'postproc convert "{Path("my samples", "pocket.nc")}" --cell "' in samples.output


def test_a_file_that_is_there_is_noticed_before_the_first_question(monkeypatch):
    monkeypatch.setattr("postproc.cli.first_steps.is_terminal", lambda: True)
    Path("cell.toml").write_text("mine")
    done = invoke("init", input="\n" * 20)
    assert done.exit_code == 1
    assert "this file is there" in done.stderr
    assert "Robot" not in done.output.replace(done.stderr, "")


def test_the_cell_that_it_writes_converts_a_clean_program_with_forces_to_green(monkeypatch):
    monkeypatch.setattr("postproc.cli.first_steps.is_terminal", lambda: True)
    assert invoke("init", input="\n" * 20).exit_code == 0
    block = "G0 X0 Y0 Z50\nS9000 M3\nM8\n(FORCE FX=120 FY=80 FZ=200)\nG1 Z-1 F500\nG1 X50\nG0 Z50\nM9\nM5\nM30\n"
    Path("part.nc").write_text(f"G90 G21 G17\n{block}")
    done = invoke("convert", "part.nc", "--cell", "cell.toml")
    assert done.exit_code == 0, done.output
    assert "\nMay be run. Uncorrected up to " in done.output, done.output
