"""[collision] in the cell: clearances of a program that geometry gives, and errors that write nothing."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.commands import invoke
from tests.kr270 import CELL_TEXT
from tests.places import ROOT

PROGRAM = """G21 G90 G17 G94
T1 M6
S9000 M3
G0 X0 Y0 Z30
(FORCE FX=-110 FY=-190 FZ=130 FRAME=FEED)
G1 Z5 F1200
G1 X100
G0 Z30
M30
"""
HOLDER = "holder = [ { diameter_mm = 63, length_mm = 80 }, { name = 'spindle', diameter_mm = 120, length_mm = 180 } ]"
VICE = "{ name = 'vice', box = { X = [20, 60], Y = [-80, -40], Z = [-20, 60] } }"


@pytest.fixture(autouse=True)
def input_files(work_folder):
    Path("part.nc").write_text(PROGRAM)


def converted(collision: str | None, *more: str, program: str = "part.nc"):
    """Exit code, output and report of `convert` in the cell of the samples with this [collision]."""
    Path("cell.toml").write_text(CELL_TEXT if collision is None else f"{CELL_TEXT}\n[collision]\n{collision}\n")
    done = invoke("convert", program, "-o", "out", *more, cell="cell.toml")
    report = Path("out/part.report.json")
    return done.exit_code, done.output, json.loads(report.read_text()) if report.exists() else None


def test_the_smallest_clearance_is_that_of_the_drawing():
    """The cutter, D 63, passes at Y = 0 a vice that ends at Y = -40: 8.5 mm, less the correction of some 0.3 mm."""
    code, output, report = converted(f"{HOLDER}\nobstacles = [ {VICE} ]")
    assert code == 0, output
    less = re.search(r"motion of the bodies due to the correction, ([\d.]+) mm", output)
    assert report["max_correction_mm"] <= float(less[1]) <= 3.0 * report["max_correction_mm"]
    assert 8.5 - float(less[1]) - 0.01 <= report["collision"]["min_clearance_mm"] < 8.5
    assert "capsules of assumed radius" in output
    assert report["collision"]["bodies"] == ["cutter", "vice"]
    assert report["collision"]["source_line"] in (6, 7, 8)
    assert "smallest clearance 8" in output


def test_less_than_the_clearance_is_an_error_and_nothing_is_written():
    code, output, _ = converted(f"clearance_mm = 9.5\n{HOLDER}\nobstacles = [ {VICE} ]")
    assert code == 1
    assert "cutter comes within 8 mm of vice" in output
    assert "of vice; [collision] asks for 9.5 mm" in output
    assert "part.nc:6: collision" in output or "part.nc:7: collision" in output
    assert not Path("out/part.src").exists()


def test_contact_on_a_rapid_move_is_found_between_its_ends():
    """A post between the ends of the retract from X = 100 to the start: the tool goes through it."""
    Path("part.nc").write_text(PROGRAM.replace("G0 Z30\nM30", "G0 Z30\nG0 X500\nM30"))
    post = "{ name = 'post', box = { X = [298, 302], Y = [-2, 2], Z = [-20, 60] } }"
    code, output, _ = converted(f"{HOLDER}\nobstacles = [ {post} ]")
    assert code == 1
    assert "cutter touches or is inside post" in output
    assert "part.nc:9: collision" in output


@pytest.mark.parametrize(("size", "is_asked"), [(0.2, True), (11.9, True), (12.1, False), (200.0, False)])
@pytest.mark.parametrize("is_holder", [True, False])
def test_a_mesh_that_is_too_small_is_asked_for_its_unit(size, is_asked, is_holder):
    trimesh.creation.box(extents=[0.5 * size, size, 0.1 * size]).apply_translation(
        [0, 0, 300] if is_holder else [0, -500, -100]
    ).export("clamp.stl")
    mesh = f"holder = [ {HOLDER.partition('[')[2].rpartition(']')[0]}, {{ name = 'clamp', mesh = 'clamp.stl' }} ]"
    table = mesh if is_holder else f"{HOLDER}\nobstacles = [ {{ name = 'clamp', mesh = 'clamp.stl' }} ]"
    code, output, report = converted(table)
    asked = [issue for issue in (report or {"issues": []})["issues"] if issue["kind"] == "mesh-units"]
    assert bool(asked) == is_asked, output
    if is_asked:
        assert code == 0
        assert f"The mesh of clamp is {size:.2g} mm large: is it in mm?" in asked[0]["message"]
        assert report["verdict"]["state"] != "ok"


@pytest.mark.parametrize(
    ("radius", "angle", "gap"),
    [(17.0, 22.5, 0.2), (17.0, 22.5, -1.0), (25.0, 67.5, 0.2), (25.0, 67.5, -1.0), (60.0, 11.25, 2.0)],
)
def test_arcs_without_force_are_compared_as_arcs(radius, angle, gap):
    """The tool, D 20, drives over half a circle past a pin outside of it, and one inside; chords would be off."""
    tool = "holder = [ { diameter_mm = 20, length_mm = 80 } ]"
    for sign in (1, -1):
        reach = radius + sign * (10.0 + 2.0 + gap)
        x, y = 60.0 + reach * np.cos(np.radians(angle)), reach * np.sin(np.radians(angle))
        pin = trimesh.creation.cylinder(radius=2.0, height=80.0, sections=90)  # sides 1 µm inside of the circle
        pin.apply_translation([x, y, 40.0])
        pin.export("pin.stl")
        lines = [
            f"G0 X{60.0 + radius} Y-80 Z60",
            "G1 Z30 F1200",
            "G1 Y0 (to the arc)",
            f"G3 X{60.0 - radius} Y0 I{-radius} J0",
            "G0 Z60",
        ]
        if sign < 0 and reach < 14.0:
            continue  # the pin would be in the way of the tool on another part of the arc
        Path("part.nc").write_text("\n".join(["G21 G90 G17 G94", "S9000 M3", *lines, "M30", ""]))
        code, output, report = converted(
            f"clearance_mm = 0.1\n{tool}\nobstacles = [ {{ mesh = 'pin.stl', part = false }} ]",
            "--nominal",
            "--overwrite",
        )
        if gap < 0:
            assert code == 1, output
            assert "part.nc:6: collision: cutter touches or is inside pin" in output
        else:
            assert code == 0, output
            assert gap - 0.06 <= report["collision"]["min_clearance_mm"] <= gap + 0.01
            assert report["collision"]["source_line"] in (5, 6)


def test_the_cutter_may_touch_the_part_and_the_spindle_may_not():
    trimesh.creation.box(bounds=[[0, -50, -20], [100, 50, 8]]).export("blank.stl")
    low = HOLDER.replace("length_mm = 80", "length_mm = 4")  # the spindle begins 9 mm above Z = 0
    for holder, frame, expected in ((HOLDER, "part = true", 0), (HOLDER, "part = false", 1), (low, "part = true", 1)):
        code, output, _ = converted(f"{holder}\nobstacles = [ {{ mesh = 'blank.stl', {frame} }} ]", "--overwrite")
        assert code == expected, output
    assert re.search(r"spindle comes within 0\.[5-9]\d* mm of blank.stl", output)  # 1 mm, less the correction


def test_without_the_table_nothing_is_checked_and_the_verdict_says_so():
    code, output, report = converted(None)
    assert code == 0
    assert report["collision"] is None
    assert "not checked: collisions (the cell has no [collision])" in output
    assert "the cell has no [collision]" in Path("out/part.report.html").read_text()


def test_assumed_shapes_of_the_arm_are_named():
    converted(f"{HOLDER}\nobstacles = [ {VICE} ]")
    assert "capsules of assumed radius" in Path("out/part.report.html").read_text()


@pytest.mark.parametrize(
    ("wrong", "advice"),
    [
        ("holder = [ { diameter_mm = 63 } ]", "[collision] holder, part 1: no length_mm"),
        ("obstacles = [ { name = 'vice' } ]", "[collision] obstacles, number 1: neither mesh nor box"),
        (
            "obstacles = [ { box = { X = [1, 0], Y = [0, 1], Z = [0, 1] } } ]",
            "[collision] obstacles, number 1: box X = [1, 0] has no inside",
        ),
        ("obstacles = [ { mesh = 'none.stl' } ]", "no such file: mesh of [collision]"),
    ],
)
def test_a_body_that_is_none_is_refused(wrong, advice):
    code, output, _ = converted(wrong)
    assert code == 1
    assert advice in output


@pytest.mark.parametrize("carried", [100, 0])
def test_a_robot_that_an_axis_carries_holds_the_tool_where_the_program_says(carried):
    """The cutter, D 63, ends at Y = 100 before a vice at Y = 150: 18.5 mm, wherever the axis stands."""
    Path("part.src").write_text(
        "DEF part()\n$VEL.CP=0.05\nPTP {A1 0,A2 -90,A3 100,A4 0,A5 80,A6 0,E1 0}\n"
        f"LIN {{X 0,Y 0,Z 5,A 0,B 0,C 180,E1 0}}\nLIN {{X 0,Y 100,Z 5,A 0,B 0,C 180,E1 {carried}}}\nEND\n"
    )
    vice = "{ name = 'vice', box = { X = [-20, 20], Y = [150, 190], Z = [-20, 60] } }"
    axis = "[external_axes.E1]\ndirection = [0, 1, 0]"
    code, output, report = converted(f"{HOLDER}\nobstacles = [ {vice} ]\n{axis}", program="part.src")
    assert code == 0, output
    assert report["collision"]["min_clearance_mm"] == pytest.approx(18.5, abs=0.5)
    assert report["collision"]["bodies"] == ["cutter", "vice"]


MILLED = """G21 G90 G17 G94
T1 M6
S9000 M3
G0 X-30 Y0 Z40
{first}
{then}
G0 Z40
M30
"""
SLOT = "G0 Z-5\nG1 X110 F3000\nG0 Z40\nG0 X-30"
WAY = "G0 Z-5\nG0 X110\nG0 Z40\nG0 X-30"
MILL = "holder = [ { diameter_mm = 20, length_mm = 60 }, { name = 'spindle', diameter_mm = 120, length_mm = 180 } ]"


def milled(first: str, then: str, collision: str = MILL, command: str = "convert"):
    """Exit code and output for a program through a block of 100 × 60 × 30 mm."""
    Path("part.nc").write_text(MILLED.format(first=first, then=then))
    Path("process.toml").write_text(
        '[material]\nname = "al_7075_t6_carbide"\n[tools.1]\ndiameter_mm = 20\nflutes = 4\n[stock]\n'
        "box = { X = [0, 100], Y = [-30, 30], Z = [-30, 0] }\nresolution_mm = 1.0\n"
    )
    Path("cell.toml").write_text(f"{CELL_TEXT}\n[collision]\n{collision}\n")
    arguments = [command, "part.nc", "--cell", "cell.toml", "-o", "out", "--process", "process.toml", "--overwrite"]
    done = invoke(*arguments)
    return done.exit_code, done.output


def test_a_rapid_through_stock_is_an_error_until_the_stock_was_cut():
    code, output = milled(SLOT, WAY)
    assert code == 0, output
    assert "the stock of the process is compared as it is at each move" in output
    assert re.search(r"smallest clearance [\d.]+ mm, of .* at line \d+; stock not counted", output)
    code, output = milled(WAY, SLOT.replace("Z-5", "Z-8"))
    assert code == 1
    assert "part.nc:6: collision: cutter goes 5 mm deep into the stock in a rapid move" in output


def test_the_spindle_that_goes_into_a_wall_is_an_error_with_millimetres():
    """The spindle, D 120, begins 12 mm above the tip: in a slot 8 deep it is 4 mm above the top."""
    short = MILL.replace("length_mm = 60", "length_mm = 12")
    deep = SLOT.replace("Z-5", "Z-8")
    code, output = milled(deep, "", f"clearance_mm = 3.9\n{short}")
    assert code == 0, output
    code, output = milled(deep, "", f"clearance_mm = 4.5\n{short}")
    assert code == 1
    assert "spindle comes within 4 mm of the stock that is left here; [collision] asks for 4.5 mm" in output
    assert "part.nc:5: collision" in output  # at X-30 it is over the block already


def test_a_mesh_of_the_spindle_is_compared_with_the_stock_at_its_time():
    """A box around the tool, 4 mm above the top in a slot 8 deep, less what the correction moves it by."""
    tool = trimesh.creation.box(bounds=[[-60, -60, 0], [60, 60, 338]])  # the tip is at Z = 350 of the flange
    tool.export("spindle.stl")
    held = "holder = [ { diameter_mm = 20, length_mm = 60 }, { name = 'spindle', mesh = 'spindle.stl' } ]"
    deep = SLOT.replace("Z-5", "Z-8")
    code, output = milled(deep, "", f"clearance_mm = 1\n{held}")
    assert code == 0, output
    less = float(re.search(r"motion of the bodies due to the correction, ([\d.]+) mm", output)[1])
    code, output = milled(deep, "", f"clearance_mm = 4.5\n{held}")
    assert code == 1
    found = float(re.search(r"part.nc:[567]: collision: spindle comes within ([\d.]+) mm of stock", output)[1])
    assert found == pytest.approx(4.0 - less, abs=0.1)


TURNED = """G21 G90 G17 G94
T1 M6
S6000 M3
G0 X30 Y-40 Z20 B0 C0
Z-2
G1 Y-10 F1200
{turn}
Y40 B0
G0 Z60
M30
"""
"""The tool is tilted while it cuts along a block of 60 × 40 × 20 mm, or on its way back over it."""


def turned(turn: str, cutter_mm: float, clearance_mm: float):
    """Exit code and output of a five-axis program with a holder, D 40, that begins above a cutter of this length."""
    Path("part.nc").write_text(TURNED.format(turn=turn))
    Path("process.toml").write_text(
        '[material]\nname = "al_7075_t6_carbide"\n[tools.1]\nshape = "ball"\ndiameter_mm = 8\nflutes = 2\n[stock]\n'
        "box = { X = [0, 60], Y = [-20, 20], Z = [-20, 0] }\nresolution_mm = 0.5\n"
    )
    rotary = '[rotary]\naxes = ["C", "B"]\nsigns = [1, 1]\nkind = "tcp"'
    cutter, holder = f"diameter_mm = 8, length_mm = {cutter_mm}", "name = 'holder', diameter_mm = 40, length_mm = 60"
    table = f"clearance_mm = {clearance_mm}\nholder = [ {{ {cutter} }}, {{ {holder} }} ]\n{rotary}"
    code, output, _ = converted(table, "--process", "process.toml", "--overwrite")
    return code, output


def test_a_holder_that_sweeps_through_the_stock_in_a_turning_cut_is_an_error():
    """Its lower edge is at Z = -2 + L·cos 30° - 20·sin 30° when the tool is tilted by 30°: for L = 12 at -1.6 mm."""
    code, output = turned("Y10 B30", 12.0, 0.5)
    assert code == 1
    assert "part.nc:7: collision: holder touches or is inside stock, which is rounded up to cells of" in output
    assert "asks for 0.5 mm. Use a longer tool, cut here first, tilt the tool less" in output
    assert not Path("out/part.src").exists()


def test_a_holder_that_clears_the_stock_in_a_turning_cut_is_accepted_to_its_distance():
    """For L = 20 the edge is 5.32 mm above the block, less what the correction moves it by."""
    code, output = turned("Y10 B30", 20.0, 4.5)
    assert code == 0, output
    assert "May it be driven? yes\n" in output
    less = float(re.search(r"motion of the bodies due to the correction, ([\d.]+) mm", output)[1])
    code, output = turned("Y10 B30", 20.0, 6.0)
    assert code == 1
    error = r"part.nc:[78]: collision: holder comes within ([\d.]+) mm of stock, .* rounded up to cells of ([\d.]+) mm"
    distance, cell = map(float, re.search(error, output).groups())
    assert 5.32 - less - cell < distance < 5.32 - less + 0.05


def test_a_holder_that_meets_the_stock_between_the_ends_of_a_turning_cut_is_an_error():
    """Its ends are 60 mm away from the block on both sides; over it the tool is tilted by about 30°."""
    code, output = turned("G0 Z30\nY-80 B20\nZ-2\nG1 Y80 B40", 12.0, 0.5)
    assert code == 1
    assert re.search(r"part.nc:(\d+): collision: holder touches or is inside stock", output)[1] == "10"


def test_a_rapid_that_turns_the_tool_through_stock_is_an_error():
    code, output = turned("G0 Z-6 Y12 B20", 40.0, 0.5)
    assert code == 1
    assert re.search(r"part.nc:7: collision: cutter goes [\d.]+ mm deep into the stock in a rapid move", output)


def test_a_rapid_of_the_cutter_through_a_stated_part_is_an_error_without_a_process():
    trimesh.creation.box(bounds=[[0, -50, -20], [100, 50, 8]]).export("blank.stl")
    through = PROGRAM.replace("G0 Z30\nM30", "G0 X200\nM30")
    part = f"{HOLDER}\nobstacles = [ {{ mesh = 'blank.stl', part = true }} ]"
    code, output, _ = converted(part)
    assert code == 0, output
    Path("part.nc").write_text(through.replace("G1 X100", "G1 X10"))
    code, output, _ = converted(part, "--overwrite")
    assert code == 1
    assert "part.nc:8: collision: cutter touches or is inside blank.stl" in output


def test_a_collision_on_the_way_from_the_start_says_so():
    part = "obstacles = [ { name = 'blank', box = { X = [0, 300], Y = [0, 300], Z = [-60, 0] } } ]"
    # the tip starts 105 mm below the origin of $BASE
    text = CELL_TEXT.replace("[0, -90, 100, 0, 80, 0]", "[0, -70, 110, 0, 50, 0]")
    Path("cell.toml").write_text(f"{text}\n[collision]\n{HOLDER}\n{part}\n")
    Path("part.nc").write_text("G21 G90 G17\nG0 X50 Y100 Z40\nX60\nM30\n")
    done = invoke("convert", "part.nc", "-o", "out", cell="cell.toml")
    assert done.exit_code == 1
    assert "part.nc:2: collision: cutter touches or is inside blank on the way from [start] to the first" in done.output
    Path("part.nc").write_text("G21 G90 G17\nG0 X50 Y100 Z40\nZ-30\nM30\n")
    Path("cell.toml").write_text(f"{CELL_TEXT}\n[collision]\n{HOLDER}\n{part}\n")
    done = invoke("convert", "part.nc", "-o", "out", cell="cell.toml")
    assert done.exit_code == 1
    assert "part.nc:3: collision: cutter touches or is inside blank; " in done.output


def test_a_first_target_that_collides_itself_is_not_the_way_from_the_start():
    """The cutter, D 63, is in a block at the first target, and enters it on the way from [start]."""
    block = "obstacles = [ { name = 'block', box = { X = [-20, 20], Y = [-80, -10], Z = [-60, 20] } } ]"
    Path("part.nc").write_text(PROGRAM.replace("G0 X0 Y0 Z30", "G0 X0 Y0 Z10"))
    code, output, _ = converted(f"{HOLDER}\n{block}")
    assert code == 1
    assert "part.nc:4: collision: cutter touches or is inside block; " in output
    assert "on the way from [start]" not in output


def test_a_holder_of_another_tool_than_that_of_the_process_writes_nothing():
    code, output = milled(SLOT, "", MILL.replace("diameter_mm = 20", "diameter_mm = 16"))
    assert code == 1
    assert "begins with a cutter of 16 mm, but tools.1 of the process has 20 mm" in output
    assert not Path("out/part.src").exists()


def test_collisions_are_checked_after_a_plain_installation():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert any(each.startswith("python-fcl") for each in project["dependencies"])
