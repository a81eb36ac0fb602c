"""Programs whose forces are stated, not computed by the process of the part: its force scale is no part of their error.

The oracle is the independent arm: the sum of squares of its changes by one standard deviation of each parameter.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from postproc import machining
from postproc.jobs import testpart_files
from postproc.jobs.testpart_files import TestPartRequest
from postproc.testpart.cut import states_at_nominal_height
from postproc.testpart.design import Criterion, Tests
from postproc.testpart.prior import Prior
from postproc.under_load import RobotInCell
from tests.oracle.whole_arm import WholeArm
from tests.testpart import trial

SCALE = 0.1
"""Standard deviation of the scale of the forces of the process."""
ROBOT_IN_CELL = RobotInCell.of(trial.ROBOT, trial.CELL)
PRIOR = Prior.of(trial.ROBOT, SCALE)
COUNT = 5


@pytest.fixture(scope="module")
def job():
    return trial.jobs(np.random.default_rng(3), COUNT)


def arm(number=None, step=0.0):
    """The arm of the model; joint `number` (or, after the joints, the compensator) changed by a share of its value."""
    content = trial.content()
    if number is not None and number < 6:
        joint = content.joints[f"A{number + 1}"]
        changed = msgspec.structs.replace(joint, compliance_urad_per_Nm=(1.0 + step) * joint.compliance_urad_per_Nm)
        content = msgspec.structs.replace(content, joints={**content.joints, f"A{number + 1}": changed})
    elif number is not None:
        spring = content.compensator
        changed = msgspec.structs.replace(spring, stiffness_N_per_m=(1.0 + step) * spring.stiffness_N_per_m)
        content = msgspec.structs.replace(content, compensator=changed)
    return WholeArm((trial.FOLDER / "robot.urdf").read_text(), content)


@pytest.fixture(scope="module")
def by_parameters(job):
    """Mean square error [m²] of the tip if the parameters are as well known as the model states."""
    model, step, total = trial.content(), 1e-2, 0.0
    shares = [*(model.joints[name].sigma_percent for name in trial.JOINTS), model.compensator.sigma_percent]
    q, force = job
    for number, percent in enumerate(shares):
        # also the sag moves with a parameter: a nominal geometry has none of it
        upper, lower = (positions(arm(number, sign * step), q, force) for sign in (1.0, -1.0))
        total += np.mean(np.sum(((upper - lower) / (2.0 * step) * 0.01 * percent) ** 2, axis=1))
    return float(total)


def positions(elastic, q, force):
    tool = np.eye(4)
    tool[2, 3] = 0.35
    wrenches = np.hstack([force, np.zeros((len(q), 3))])
    return np.array([elastic.equilibrium(row, tool, w)[1][:3, 3] for row, w in zip(q, wrenches, strict=True)])


def criterion(job, is_scaled):
    q, force = job
    tool = np.broadcast_to(np.eye(4), (COUNT, 4, 4)).copy()
    tool[:, 2, 3] = 0.35
    pose = np.array([arm().nominal(row, tool[0]) for row in q])
    states = states_at_nominal_height(q, tool, pose, np.hstack([force, np.zeros((COUNT, 3))]))
    tests = Tests(states, np.full(COUNT, 1.0 / COUNT), np.full(COUNT, is_scaled), "job")
    return Criterion.of(PRIOR, ROBOT_IN_CELL, tests, len(PRIOR.sigma))


def test_the_error_under_stated_forces_is_that_by_the_parameters(job, by_parameters):
    before = float(criterion(job, False)(np.eye(len(PRIOR.sigma))))
    assert np.sqrt(before) == pytest.approx(np.sqrt(by_parameters), rel=0.01)


def test_the_error_under_computed_forces_has_that_of_their_scale_too(job, by_parameters):
    by_scale = SCALE**2 * float(np.mean(np.sum(trial.deflections(arm(), *job) ** 2, axis=1)))
    before = float(criterion(job, True)(np.eye(len(PRIOR.sigma))))
    assert by_scale > 0.05 * by_parameters  # it shows
    assert before == pytest.approx(by_parameters + by_scale, rel=0.02)


def test_a_part_that_shows_only_products_promises_little_for_stated_forces(job, by_parameters):
    """It shows 1 + e + f for each compliance (1 + e) and the scale (1 + f) to 0.1 %: neither is known by itself.

    The compliances are then off by the common factor, whose posterior follows from the priors of all. The gravity
    compensator is known.
    """
    relative = PRIOR.sigma[:-1] / PRIOR.values
    columns = np.eye(7, 8) * np.append(relative, SCALE)
    columns[:6, 7] = SCALE
    columns[6, 7] = 0.0
    information = np.eye(8) + columns.T @ columns / 1e-3**2
    common = 1.0 / np.sqrt(1.0 / SCALE**2 + np.sum(1.0 / relative[:6] ** 2))
    size = np.sqrt(np.mean(np.sum(trial.deflections(arm(), *job) ** 2, axis=1)))
    stated, computed = (float(np.sqrt(criterion(job, is_scaled)(information))) for is_scaled in (False, True))
    assert stated == pytest.approx(common * size, rel=0.1)
    assert computed < 0.1 * stated


PROGRAM = "G21 G90 G17 G94\nT1 M6\nS6000 M3\nG0 X20 Y20 Z5\n{force}\nG1 Z-2 F600\nX90\nY70\n{off}\nG0 Z20\nM30\n"
OTHER = "kc11_N_per_mm2 = 1500.0\nmc = 0.2"


@pytest.fixture
def process(tmp_path):
    text = trial.process_text(((0, 110), (0, 90), (-30, 0)), 1.0)
    (tmp_path / "process.toml").write_text(text)
    (tmp_path / "harder.toml").write_text(text.replace('name = "al_7075_t6_carbide"', OTHER))
    return machining.load(tmp_path / "process.toml")


@pytest.mark.parametrize("source", ["comments", "process.toml", "harder.toml"])
def test_the_scale_is_that_of_programs_with_this_material(tmp_path, process, source):
    is_stated = source == "comments"
    text = PROGRAM.format(force="(FORCE FX=100 FY=50)" if is_stated else "", off="(FORCE OFF)" if is_stated else "")
    (tmp_path / "job.nc").write_text(text)
    request = TestPartRequest(
        cell=Path("cell.toml"), process=tmp_path / "process.toml", output=tmp_path / "out",
        programs=(str(tmp_path / "job.nc"),), forces=None if is_stated else tmp_path / source,
    )  # fmt: skip
    tests = testpart_files._test_states(request, ROBOT_IN_CELL, process, None)
    assert len(tests.is_scaled) == len(tests.weight) > 1
    is_same = source == "process.toml"
    assert tests.is_scaled.all() if is_same else not tests.is_scaled.any()
    assert tests.source == "job.nc" + ("" if is_same else ", without the error of forces that are not of this process")
