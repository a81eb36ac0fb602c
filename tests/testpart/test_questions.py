"""Weights and feeds of a test part that are questioned, by the limits of plans and of programs."""

import json

import pytest

from postproc import robot as robots
from postproc.errors import ForceError
from postproc.jobs.testpart_files import design_warnings, flat_tool
from postproc.machining.process import Process, ToolTable
from postproc.testpart.features import Cutting
from tests.commands import run
from tests.places import SAMPLES

CALM = "no warning"


@pytest.mark.parametrize(
    ("weight", "feed", "rpm", "text"),
    [
        (0.0, 1000.0, 6000.0, CALM), (320.0, 1000.0, 6000.0, CALM),  # 1.2 times the 270 kg
        (330.0, 1000.0, 6000.0, "the weight of 330 kg is more than the 270 kg that the robot is rated for"),
        (0.0, 9.0, 6000.0, "a feed of 9 mm/min: cutters have 10 to 30000"), (0.0, 11.0, 6000.0, CALM),
        (0.0, 29e3, 18e3, CALM), (0.0, 31e3, 18e3, "a feed of 3.1e+04 mm/min: cutters have 10 to 30000"),
        (0.0, 5900.0, 2000.0, CALM), (0.0, 6100.0, 2000.0, "1.02 mm per tooth with a tool of 10 mm: check --feed"),
    ],
)  # fmt: skip
def test_weights_above_the_rating_and_feeds_of_no_cutter_are_questioned(weight, feed, rpm, text):
    """A tool of 10 mm with three flutes: a tenth of its diameter per tooth is 1 mm."""
    arm = robots.load(robots.find("kuka_kr270"))
    warnings = design_warnings(weight, arm, Cutting(0.01, rpm, feed / 60e3, 1, 0.0), 3)
    assert len(warnings) == (text != CALM)
    if warnings:
        assert warnings[0].startswith(text)


def test_a_tool_by_name_has_no_number_for_the_program_of_a_test_part():
    tool = ToolTable(diameter_mm=10.0, flutes=3)
    with pytest.raises(ForceError, match=r"\[tools\.tMill\] has no tool number.* such as \[tools\.1\]"):
        flat_tool(Process(tools={"tMill": tool}), None)
    assert flat_tool(Process(tools={"tMill": tool, "2": tool}), 2)[0] == "2"


def test_the_command_prints_them(tmp_path):
    demo = SAMPLES / "demo"
    output = run(
        "testpart", "--cell", demo / "cell.toml", "--process", demo / "process.toml", "--features", "2",
        "--block", "X=0:160,Y=0:120,Z=-30:0", "--weight", "500", "-o", tmp_path / "part",
    ).output  # fmt: skip
    assert "warning: the weight of 500 kg is more than the 270 kg" in output
    (text,) = json.loads((tmp_path / "part" / "testpart.json").read_text())["warnings"]
    assert text in output
