"""A weight hung on the tool under a dial gauge: its force is known, and tells compliances from cutting forces."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.errors import MeasurementError
from postproc.report.testpart import design_lines
from postproc.testpart import design, probing
from postproc.testpart.cut import ClampedProgram, CutForces, surfaces
from postproc.testpart.linear import linearise
from postproc.testpart.readings import Readings
from tests.oracle.whole_arm import WholeArm
from tests.testpart import trial

MASS = 30.0
BLOCK = ((0, 110), (0, 90), (-30, 0))


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    return trial.part(tmp_path_factory.mktemp("weight"), box=BLOCK, count=4, mass=MASS)


SCALE = 1.15


@pytest.fixture(scope="module")
def milled(part):
    """The part milled and probed, under forces larger than computed: the name of the file."""
    rng = np.random.default_rng(4)
    return trial.probed(part, trial.truth(rng), rng, SCALE)


def only(part):
    (program,) = part.programs.values()
    return program


def test_the_gauge_reads_what_the_independent_arm_deflects_under_the_weight(part):
    arm = WholeArm((trial.FOLDER / "robot.urdf").read_text(), trial.content())
    cutter = trial.machine(arm)
    table = (part.folder / "probing.csv").read_text()
    rows = [line for line in table.splitlines() if line.startswith(("feature", "W"))]
    assert len(rows) == 4
    names, line, t, mass = [], [], [], []
    exact = []
    for row in rows[1:]:
        fields = row.split(",")
        names.append(fields[0])
        line.append(int(fields[1]))
        t.append(float(fields[2]))
        mass.append(float(fields[-1]))
        point = np.array([float(value) for value in fields[3:6]])
        moved, _ = cutter.deflected(cutter.joints(point, cutter.start), np.array([0.0, 0.0, -9.81 * MASS]))
        exact.append(-moved[2] * 1e-3)
    assert mass == [MASS] * 3
    points = np.array([[float(value) for value in row.split(",")[3:6]] for row in rows[1:]]) * 1e-3
    down = np.tile([0.0, 0.0, -1.0], (3, 1))
    read = probing.ProbedSurfaces(
        tuple(names), np.array(line), np.array(t), points, down, np.array(exact), np.array(mass), ("",) * 3,
        np.full(3, -1), np.arange(3) + 2, "x",
    )  # fmt: skip
    where = surfaces(only(part), part.robot_in_cell, read, 0.005)
    source = trial.ProcessSource(part.process, trial.CELL.tool.axis)
    states = CutForces([ClampedProgram(only(part), part.robot_in_cell, source, where)])(part.robot_in_cell.robot, 1.0)
    given = Readings.of(read, where, trial.SIGMA)
    found = linearise(part.prior, given, states, part.robot_in_cell, z=np.zeros(len(part.prior.parameters)), scale=1.0)
    assert min(exact) > 5e-5
    np.testing.assert_allclose(found.value, exact, atol=2e-7)
    np.testing.assert_array_equal(found.slopes[:, -1], 0.0)  # the cutting forces have no part in it


def test_the_weight_tells_forces_from_compliances(part, milled):
    """The same part with and without the rows of the gauge."""
    found, left_out = trial.identified(part, milled)
    rows = milled.read_text().splitlines()
    (part.folder / "without.csv").write_text("\n".join(row for row in rows if not row.startswith("W")) + "\n")
    without, _ = trial.identified(part, part.folder / "without.csv")
    assert not left_out
    sigma = [float(np.sqrt(each.covariance[-1, -1])) for each in (found, without)]
    assert sigma[0] < 0.85 * sigma[1]
    assert abs(found.scale - SCALE) < 3.0 * sigma[0]
    assert part.chosen.sigma[-1] < 0.85 * part.chosen.sigma_without_weight[-1]  # the design says so before
    assert part.chosen.sigma[-1] == pytest.approx(found.sigma[-1], rel=0.3)


def test_the_weight_shows_changes_of_joint_2_that_cutting_hides(part):
    tests = design.tests_in_block(part.found)
    without = design.evaluate(part.found, part.prior, part.robot_in_cell, tests, part.chosen.chosen)
    (k2,) = [k for k, parameter in enumerate(part.prior.parameters) if parameter.name == "k2"]
    assert part.chosen.change[k2] < 0.3 < 0.6 < without.change[k2]
    said = [" ".join(design_lines(each, part.prior, part.cutting, part.made)) for each in (part.chosen, without)]
    assert "would not be seen for sure in k2" in said[1]
    assert "k2 (" not in said[0]


def test_the_position_of_the_part_does_not_move_the_gauge(part, milled):
    read = probing.read(milled)
    where = surfaces(only(part), part.robot_in_cell, read, 0.005)
    added = Readings.of(read, where, trial.SIGMA).part_covariance(np.zeros(len(read)))
    hung = read.mass > 0.0
    assert hung.sum() == 3
    assert not added[hung].any()
    assert (np.diag(added)[~hung] > 0.0).all()


def test_a_weight_on_a_cutting_move_is_refused(part):
    rows = (part.folder / "probing.csv").read_text().splitlines()
    row = next(k for k, text in enumerate(rows) if text.startswith("F"))
    fields = rows[row].split(",")
    rows[1:] = [",".join([*row.split(",")[:-2], "0.01", row.split(",")[-1]]) for row in rows[1:]]
    rows[row] = ",".join([*fields[:-2], "0.01", "12"])
    (part.folder / "wrong.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(MeasurementError, match="is not one rapid move"):
        surfaces(only(part), part.robot_in_cell, probing.read(part.folder / "wrong.csv"), 0.005)
    rows[row] = ",".join([*fields[:-2], "0.01", "-3"])
    (part.folder / "wrong.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(MeasurementError, match="mass_kg is not between"):
        probing.read(part.folder / "wrong.csv")


def test_a_weight_on_a_touch_off_point_is_refused(part):
    rows = (part.folder / "probing.csv").read_text().splitlines()
    rows[1:] = [",".join([*row.split(",")[:-2], "0.01", row.split(",")[-1]]) for row in rows[1:]]
    rows[1] = ",".join([*rows[1].split(",")[:-1], "12"])
    (part.folder / "wrong.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(MeasurementError, match=r"T01\.top is no point of the top"):
        probing.read(part.folder / "wrong.csv")
