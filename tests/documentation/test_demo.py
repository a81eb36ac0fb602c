"""The demo of the samples: from published values to a measured robot, and what its simulator says of the result."""

from __future__ import annotations

import csv
import json
import re
import runpy

import numpy as np
import pytest

from tests.commands import invoke
from tests.kr270 import FOLDER
from tests.oracle.arm import Arm, abc
from tests.places import SAMPLES
from tests.testpart import demo as demo_part

BASE, TOOLS = abc(1600, -100, 750), {1: abc(0, 0, 350), 2: abc(0, 0, 380)}
TOOL_CHANGE_LINE = 23
_NUMBER = re.compile(r"-?\d+\.?\d*")


@pytest.fixture(scope="module")
def folder(readme):
    """The folder in which the demo was typed as the tutorials show it: with a tracker, and with a test part."""
    return readme[0]


def expected(folder, name):
    return json.loads((folder / name / "bracket.report.json").read_text())["verdict"]["better"]["corrected_mm"]


def true_errors(folder, name):
    """Distance [mm] of the tool of the simulated robot from the nominal place at cutting targets, as corrected."""
    simulator = runpy.run_path(str(SAMPLES / "paper_study" / "simulator.py"))
    arm, true = Arm.load(FOLDER), simulator["paper_like"](np.random.default_rng(1))
    rows = list(csv.DictReader((folder / name / "bracket.targets.csv").read_text().splitlines()))
    errors = []
    for row in [row for row in rows if row["rapid"] == "0"][::6]:
        values = {key: float(value) for key, value in row.items()}
        tool = TOOLS[1 if values["source_line"] < TOOL_CHANGE_LINE else 2]
        command = BASE @ abc(*(values[f"{axis}_cmd"] for axis in "XYZABC"))
        guess = np.radians([values[f"A{k}"] for k in range(1, 7)])
        q = arm.inverse(command, tool, guess)
        force = np.array([[values[f"F{axis}"] for axis in "xyz"]])
        tip = true.solve(q[None], force, point=tool[:3, 3])[0] @ tool
        nominal = BASE @ abc(values["X"], values["Y"], values["Z"])
        errors.append(np.linalg.norm((tip - nominal)[:3, 3]) * 1e3)
    return np.array(errors)


def test_measuring_lowers_the_expected_error_as_the_tutorial_says(folder):
    assert expected(folder, "before") == pytest.approx(0.77, abs=0.02)
    assert expected(folder, "after") == pytest.approx(0.032, abs=0.004)


def test_the_simulated_robot_mills_as_well_as_the_report_promises(folder):
    """The readings are from this robot, and the simulator shares no line with the package."""
    before, after = true_errors(folder, "before"), true_errors(folder, "after")
    assert after.max() < expected(folder, "after")
    assert before.max() < expected(folder, "before")
    assert before.max() > 5.0 * after.max()


def test_the_model_of_the_test_part_is_as_good_as_the_report_promises(folder):
    assert expected(folder, "after_part") == pytest.approx(0.26, abs=0.02)
    errors = true_errors(folder, "after_part")
    assert errors.max() < expected(folder, "after_part")
    assert errors.max() < 0.6 * true_errors(folder, "before").max()


def test_the_touch_off_error_of_the_demo_is_measured(folder):
    report = json.loads((folder / "samples" / "demo" / "part_robot" / "identification.json").read_text())
    (error,) = report["touch_off"]
    assert error["lift_mm"] == pytest.approx(-demo_part.TOP[0], abs=error["ci95"])


@pytest.mark.parametrize("name", demo_part.SEEDS)
def test_the_probed_part_is_that_of_the_simulator(name):
    folder = SAMPLES / "demo" / "testpart"
    shipped = (folder / name).read_text()
    empty = re.sub(r",[^,\n]*$", ",", shipped.partition("\n")[2], flags=re.M)
    made = demo_part.probed(
        (folder / "testpart.nc").read_text(), shipped.partition("\n")[0] + "\n" + empty, demo_part.SEEDS[name]
    )
    numbers = [np.array(_NUMBER.findall(text.partition("\n")[2]), dtype=float) for text in (made, shipped)]
    np.testing.assert_allclose(numbers[0], numbers[1], atol=1e-4)


def test_the_part_of_the_demo_is_the_one_that_the_command_chooses(folder):
    written, shipped = folder / "testpart", SAMPLES / "demo" / "testpart"
    for name in ("testpart.nc", "testpart.process.toml"):
        assert (written / name).read_text() == (shipped / name).read_text()
    points = [
        [line.rpartition(",")[0] for line in path.read_text().splitlines()]
        for path in (written / "probing.csv", shipped / "probed.csv")
    ]
    assert points[0] == points[1]


def test_a_part_with_a_weight_stops_for_it(folder, tmp_path):
    written = folder / "testpart_weight"
    assert (written / "testpart.nc").read_text().count("M0\n") == 3
    assert (written / "testpart.src").read_text().count("HALT") == 4  # one is the tool change
    assert (written / "probing.csv").read_text().splitlines()[-1].endswith(",20")
    page = (written / "testpart.html").read_text()
    assert "the weight on the tool leaves" in page
    assert "hang 20 kg on the tool" in page
    cell = folder / "samples" / "demo" / "cell.toml"
    converted = invoke("convert", written / "testpart.nc", "--nominal", "-o", tmp_path, cell=cell)
    notes = [line for line in converted.output.splitlines() if "info:" in line]
    assert [note for note in notes if "The first move begins below the first target" not in note] == []


def test_the_readings_are_those_of_the_simulator(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["simulator.py", "demo"])
    runpy.run_path(str(SAMPLES / "paper_study" / "simulator.py"), run_name="__main__")
    for name in ("measurements.csv", "validation.csv", "experiment.toml"):
        made, shipped = ((place / name).read_text() for place in (tmp_path / "demo", SAMPLES / "demo"))
        assert made.splitlines()[0] == shipped.splitlines()[0]
        numbers = [np.array(_NUMBER.findall(text.partition("\n")[2]), dtype=float) for text in (made, shipped)]
        np.testing.assert_allclose(numbers[0], numbers[1], atol=2e-4)
