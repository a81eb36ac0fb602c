"""A block that is clamped in two places: programs, probed points, and the model from both."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from postproc import machining, robot
from postproc.errors import MeasurementError
from postproc.jobs.testpart_files import programs_of
from postproc.testpart import probing
from postproc.testpart.cut import ClampedProgram, CutForces, Surfaces, surfaces
from postproc.testpart.linear import linearise
from postproc.testpart.prior import Prior
from postproc.testpart.readings import Readings
from tests.commands import run
from tests.oracle.whole_arm import WholeArm
from tests.places import SAMPLES
from tests.testpart import trial

BLOCK = ((0, 110), (0, 90), (-30, 0))
BASES = {"testpart.nc": (1500.0, -200.0, 700.0, 0.0), "testpart_4.nc": (1400.0, 100.0, 1150.0, 30.0)}
NUMBERS = {"testpart.nc": -1, "testpart_4.nc": 4}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("placements")
    x, y, z, a = BASES["testpart_4.nc"]
    text = (SAMPLES / "cell_kr270.toml").read_text()
    (folder / "cell.toml").write_text(f"{text}\n[base_data.4]\nX = {x}\nY = {y}\nZ = {z}\nA = {a}\n")
    (folder / "process.toml").write_text(trial.process_text(BLOCK, 0.5))
    given = ("--cell", folder / "cell.toml", "--process", folder / "process.toml", "--features", 4, "--depth", 3)
    done = run("testpart", *given, "--placement", 4, "-o", folder / "out")
    assert "block at [base]: " in done.output
    return folder / "out"


def cut(folder, arm, rng=None, scale=1.0):
    """Cut and probe the part in both places with the independent machine; return the probed table."""
    head, *rows = (folder / "probing.csv").read_text().splitlines()
    out = [head]
    for name, base in BASES.items():
        table = "\n".join([head, *(row for row in rows if f",{name}," in row), ""])
        machine = trial.machine(arm, scale, 5.0 if rng is None else 5.006, base)
        out += machine.probed((folder / name).read_text(), table, rng).splitlines()[1:]
    return "\n".join([*out, ""])


def test_each_placement_has_a_program_in_its_own_frame(folder):
    rows = list(csv.DictReader((folder / "probing.csv").read_text().splitlines()))
    of = {name: {row["feature"][:3] for row in rows if row["program"] == name} for name in BASES}
    assert all(of.values())
    touched = [f"T{number:02d}" for number in range(1, 9)]
    assert sorted([*of["testpart.nc"], *of["testpart_4.nc"]]) == ["F01", "F02", "F03", "F04", *touched]
    assert {(row["program"], row["base"]) for row in rows} == {("testpart.nc", ""), ("testpart_4.nc", "4")}
    assert "$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}" in (folder / "testpart.src").read_text()
    text = (folder / "testpart_4.src").read_text()
    assert "$BASE={X 1400,Y 100,Z 1150,A 30,B 0,C 0}" in text
    assert "mode=nominal" in text
    listed = json.loads((folder / "testpart.json").read_text())["placements"]
    assert [each["frame"] for each in listed] == ["[base]", "[base_data.4]"]
    assert sum(each["features"] for each in listed) == 4
    page = (folder / "testpart.html").read_text()
    assert "With the block at [base_data.4] of the cell cut testpart_4.src" in page


def test_no_features_of_two_placements_touch(folder):
    """It may be the same block: 10 mm wide grooves, their points apart by more than the tool."""
    rows = list(csv.DictReader((folder / "probing.csv").read_text().splitlines()))
    point = {name: [] for name in BASES}
    for row in rows:
        if row["feature"].startswith("F"):
            point[row["program"]].append((float(row["X"]), float(row["Y"])))
    one, other = (np.array(points) for points in point.values())
    assert np.linalg.norm(one[:, None] - other[None], axis=2).min() > 5.0


def test_the_model_predicts_the_surfaces_of_both_placements(folder):
    arm = WholeArm((trial.FOLDER / "robot.urdf").read_text(), trial.content())
    (folder / "exact.csv").write_text(cut(folder, arm))
    read, parts = probing.read(folder / "exact.csv"), []
    process = machining.load(folder / "testpart.process.toml")
    cell = trial.postproc.load_cell(folder.parent / "cell.toml")
    for name, number in NUMBERS.items():
        own = trial.msgspec.structs.replace(cell, base=cell.base if number < 0 else cell.base_data[str(number)])
        robot_in_cell = trial.RobotInCell.of(trial.ROBOT, own)
        program = trial.postproc.read_program(folder / name, trial.ROBOT, own)
        where = surfaces(program, robot_in_cell, read.take(np.flatnonzero(read.base == number)), 5e-3)
        parts.append(ClampedProgram(program, robot_in_cell, trial.ProcessSource(process, own.tool.axis), where))
    given = Readings.of(read, Surfaces.join([part.surfaces for part in parts]), trial.SIGMA)
    prior = Prior.of(robot_in_cell.robot, 0.1)
    states = CutForces(parts)
    states(robot_in_cell.robot, 1.0)
    found = linearise(
        prior, given, states(robot_in_cell.robot, 1.0), robot_in_cell, z=np.zeros(len(prior.parameters)), scale=1.0
    )
    off = found.value - read.deviation
    for number in NUMBERS.values():
        here = read.base == number
        assert np.abs(read.deviation[here]).max() > 3e-4
        assert np.sqrt(np.mean(off[here] ** 2)) < 4e-6
    added = given.part_covariance(np.zeros(len(read)))
    common = np.outer(given.surfaces.is_wall, given.surfaces.is_wall) * 5e-5**2  # the radius of the tool
    across = np.ix_(read.base == -1, read.base == 4)
    np.testing.assert_allclose(added[across], common[across], atol=1e-18)  # each placement has a position of its own


def test_a_robot_is_identified_from_both_placements(folder):
    rng = np.random.default_rng(6)
    arm, scale = trial.truth(rng), 1.1
    (folder / "probed.csv").write_text(cut(folder, arm, rng, scale))
    process = ("--process", folder / "testpart.process.toml")
    given = (folder / "probed.csv", "--cell", folder.parent / "cell.toml", *process)
    both = ("--program", folder / "testpart_4.nc", folder / "testpart.nc")
    done = run("identify", "part", *given, *both, "-o", folder / "my_robot")
    assert "the model may be used" in done.output
    assert "outlier" not in done.output
    model = robot.load(folder / "my_robot")
    factor = machining.load(_found(folder)).law().cutting[0] / (trial.AL7075[0] * 1e6)
    q, force = trial.jobs(np.random.default_rng(8), 25)
    true = trial.deflections(arm, q, scale * force)
    before = np.linalg.norm(trial.predicted(trial.ROBOT, q, force) - true, axis=1)
    after = np.linalg.norm(trial.predicted(model, q, factor * force) - true, axis=1)
    assert np.sqrt(np.mean(after**2)) < 0.4 * np.sqrt(np.mean(before**2))
    done = run("identify", "part", *given, "--program", folder / "testpart.nc", "--compare", code=1)
    assert "program 'testpart_4.nc' is not given" in done.output


def _found(folder: Path) -> Path:
    text = (folder / "testpart.process.toml").read_text().partition("[tools")[2]
    path = folder / "found.process.toml"
    path.write_text('[material]\nfile = "my_robot/material.toml"\n[tools' + text)
    return path


def test_rows_that_do_not_name_their_placement_are_refused(folder):
    rows = [row.split(",") for row in (folder / "probing.csv").read_text().splitlines()]
    filled = [[*row[:-1], "0.1" if k else row[-1]] for k, row in enumerate(rows)]

    def written(rows):
        (folder / "wrong.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
        return folder / "wrong.csv"

    for wrong in (
        [[*row[:2], *row[3:]] for row in filled],
        [filled[0], *([*r[:2], "4.5", *r[3:]] for r in filled[1:])],
    ):
        with pytest.raises(MeasurementError, match="do not name program and placement"):
            probing.read(written(wrong))
    both = tuple(folder / name for name in BASES)
    assert programs_of(probing.read(written(filled)), both) == dict(zip(both, NUMBERS.values(), strict=True))
    first = next(k for k, row in enumerate(filled) if row[0].startswith("F"))
    moved = [[row[0], "testpart.nc", "4", *row[3:]] for row in filled[first : first + 2]]
    swapped = [*filled[:first], *moved, *filled[first + 2 :]]
    with pytest.raises(MeasurementError, match="has two placements"):
        programs_of(probing.read(written(swapped)), both)
    one_place = [filled[0], *([*row[:2], filled[first][2], *row[3:]] for row in filled[1:])]
    with pytest.raises(MeasurementError, match="has the placement of another program"):
        programs_of(probing.read(written(one_place)), both)
    alone = probing.read(written([[row[0], *row[3:]] for row in filled]))
    assert programs_of(alone, both[:1]) == {both[0]: -1}
    with pytest.raises(MeasurementError, match="do not name the program"):
        programs_of(alone, both)


def test_a_placement_that_the_cell_does_not_know_is_refused(folder, tmp_path):
    given = ("--cell", folder.parent / "cell.toml", "--process", folder.parent / "process.toml")
    done = run("testpart", *given, "--placement", 7, "-o", tmp_path / "out", code=1)
    assert "the cell has no [base_data.7]" in done.output
    assert "[base_data.4]" in done.output
    done = run("testpart", *given, "--placement", 4, "--placement", 4, "-o", tmp_path / "out", code=1)
    assert "[base_data.4] is given twice" in done.output
