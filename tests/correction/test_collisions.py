"""[collision] in the cell: clearances of a program that geometry gives, and errors that write nothing."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import trimesh
from click.testing import CliRunner

from postproc.cli import main
from tests.documentation.pages import ROOT

pytest.importorskip("fcl")
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
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("part.nc").write_text(PROGRAM)


def converted(collision: str | None, *more: str, program: str = "part.nc"):
    """Exit code, output and report of `convert` in the cell of the samples with this [collision]."""
    text = (
        (ROOT / "samples" / "cell_kr270.toml").read_text().replace("[0, -70, 110, 0, 50, 0]", "[0, -90, 100, 0, 80, 0]")
    )
    Path("cell.toml").write_text(text if collision is None else f"{text}\n[collision]\n{collision}\n")
    done = CliRunner().invoke(main, ["convert", program, "--cell", "cell.toml", "-o", "out", *more])
    report = Path("out/part.report.json")
    return done.exit_code, done.output, json.loads(report.read_text()) if report.exists() else None


def test_the_smallest_clearance_is_that_of_the_drawing():
    """The cutter, D 63, passes at Y = 0 a vice that ends at Y = -40: 8.5 mm, less the correction of some 0.3 mm."""
    code, output, report = converted(f"{HOLDER}\nobstacles = [ {VICE} ]")
    assert code == 0, output
    less = re.search(r"less by as far as the correction moves a body, ([\d.]+) mm", output)
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
    assert "collisions are not checked: the cell has no [collision]" in output
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
