"""Tracker readings and a milled part in one model: the covariance of the tracker's model is the prior of the part's."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

import postproc
from postproc.identification import identify_folder
from postproc.robot.model_file import JointSpring
from postproc.testpart.model import summary
from postproc.testpart.prior import Prior
from postproc.under_load import RobotInCell
from samples.paper_study import simulator
from tests.oracle.whole_arm import WholeArm
from tests.testpart import trial

SCALE = 1.12
BLOCK = ((0, 110), (0, 90), (-30, 0))


@pytest.fixture(scope="module")
def robots(tmp_path_factory):
    """A robot by a tracker, by a part, and by both; the simulators share no code with the package."""
    folder = tmp_path_factory.mktemp("together")
    rng = np.random.default_rng(5)
    true = simulator.paper_like(rng)
    q, f = simulator.plan(rng, 15)
    simulator.write(folder, q, f, simulator.measure(true, q, f, rng, 0.03e-3)[1])
    identify_folder(folder / "measurements.csv", folder / "experiment.toml", folder / "tracked")
    tracked = postproc.load_robot(str(folder / "tracked"))
    model = trial.content()
    joints = {
        name: JointSpring(source="truth", compliance_urad_per_Nm=1e6 / k)
        for name, k in zip(trial.JOINTS, true.gear.k, strict=True)
    }
    spring = msgspec.structs.replace(
        model.compensator, stiffness_N_per_m=true.comp[0], free_length_mm=1e3 * true.comp[1]
    )
    arm = WholeArm(
        (trial.FOLDER / "robot.urdf").read_text(), msgspec.structs.replace(model, joints=joints, compensator=spring)
    )
    part = trial.part(folder, box=BLOCK, count=4)
    path = trial.probed(part, arm, rng, SCALE)
    robot_in_cell, law = RobotInCell.of(tracked, trial.CELL), part.process.law()
    together = trial.fitted(
        part, path, Prior.of(robot_in_cell.robot, law.sigma, law.numbers), robot_in_cell, part.process
    )
    return arm, tracked, trial.identified(part, path), together, part, folder


def test_both_are_better_than_either(robots):
    arm, tracked, (alone, _), (together, left_out), part, folder = robots
    data = summary(together, left_out)
    assert not data.verdict.refused
    assert together.scale == pytest.approx(SCALE, abs=3.0 * np.sqrt(together.covariance[-1, -1]))
    assert together.sigma[-1] < 0.3  # the tracker knows the compliances, so the part knows the forces
    assert alone.sigma[-1] > 0.6
    q, force = trial.jobs(np.random.default_rng(8), 25)
    true = trial.deflections(arm, q, SCALE * force)
    model, law = trial.model(together, part.process, folder, folder / "tracked")
    errors = {}
    for name, robot, scale in (
        ("tracker", tracked, 1.0),
        ("part", alone.robot, alone.scale),
        ("both", model, together.scale),
    ):
        off = np.linalg.norm(trial.predicted(robot, q, scale * force) - true, axis=1)
        errors[name] = np.sqrt(np.mean(off**2))
    assert errors["both"] < 0.3 * errors["tracker"]
    assert errors["both"] < errors["part"]
    off = np.linalg.norm(trial.predicted(model, q, together.scale * force) - true, axis=1)
    assert np.mean(off <= trial.bound(model, law, q, together.scale * force)) >= 0.9


def test_what_the_tracker_measured_stays(robots):
    _, tracked, _, (together, _), part, folder = robots
    model, _ = trial.model(together, part.process, folder, folder / "tracked")
    assert (model.measured.torque >= tracked.measured.torque).all()
    wrench = np.array([[level, 0.0, 0.0, 0.0, 0.0, 0.0] for level in (50.0, 300.0, 1000.0, 3000.0)])
    assert (model.discrepancy.at(wrench) >= (1.0 - 1e-9) * tracked.discrepancy.at(wrench)).all()
    sigma = [np.sqrt(np.diag(each.covariance.matrix))[:6] for each in (model, tracked)]
    assert (sigma[0] <= 1.001 * sigma[1]).all()
