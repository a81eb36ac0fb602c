"""Compensation to convergence: the loaded tool, by an oracle of its own, stands at its target."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from postproc import elastostatics, frames, kinematics, robot
from postproc.elastostatics import compensate
from postproc.errors import NotConvergedError
from tests.kr270 import TOOL
from tests.oracle.arm import Arm

START = np.radians([5.0, -70.0, 105.0, 20.0, 50.0, 30.0])


def targets(model, count, seed):
    rng = np.random.default_rng(seed)
    q = START + rng.uniform(-0.2, 0.2, (count, 6))
    wrench = rng.normal(size=(count, 6)) * [400.0, 400, 400, 30, 30, 30]
    return q, kinematics.tcp(model.nominal, q, TOOL)[0], wrench


@pytest.fixture(scope="module", params=sorted(robot.shipped_models()))
def pair(request):
    folder = robot.find(request.param)
    return robot.load(folder), Arm.load(folder)


def test_the_oracle_finds_the_loaded_tool_at_its_target(pair):
    model, arm = pair
    q, target, wrench = targets(model, 8, 1)
    found = compensate(model, target, q, TOOL, wrench)
    for row in range(len(q)):
        np.testing.assert_allclose(arm.loaded_tcp(found.q[row], TOOL, wrench[row]), target[row], atol=1e-8)
        np.testing.assert_allclose(arm.nominal_tcp(found.q[row], TOOL), found.pose[row], atol=1e-12)


def test_sag_payload_and_calibrated_geometry_are_corrected_too(pair, tmp_path):
    model, arm = pair
    folder = robot.find(model.name)
    (tmp_path / "robot.urdf").write_text((folder / "robot.urdf").read_text(encoding="utf-8"), encoding="utf-8")
    text = (folder / "model.toml").read_text(encoding="utf-8").replace('"calibrated"', '"rigid"')
    text += '[geometry.A3]\nX_mm = 0.4\nZ_mm = -0.3\nRX_deg = 0.02\nRY_deg = -0.03\nsource = "test"\n'
    (tmp_path / "model.toml").write_text(text, encoding="utf-8")
    changed = robot.load(tmp_path).with_payload(40.0, np.array([0.0, 0.05, 0.1]))
    moved = [o.copy() for o in arm.origins]
    shift = np.eye(4)
    shift[:3, :3] = frames.rotation_from_vector(np.radians([0.02, -0.03, 0.0]))
    shift[:3, 3] = [0.4e-3, 0.0, -0.3e-3]
    moved[2] = moved[2] @ shift
    truth = dataclasses.replace(arm, origins=moved, rigid=True, payload=(40.0, np.array([0.0, 0.05, 0.1])))
    q, target, wrench = targets(changed, 5, 2)
    found = compensate(changed, target, q, TOOL, wrench)
    for row in range(len(q)):
        np.testing.assert_allclose(truth.loaded_tcp(found.q[row], TOOL, wrench[row]), target[row], atol=2e-8)


def test_zero_force_on_a_calibrated_robot_needs_no_correction(pair):
    model, _ = pair
    q, target, _ = targets(model, 50, 3)
    found = compensate(model, target, q, TOOL, np.zeros((50, 6)))
    assert np.abs(found.pose - target).max() < 1e-12


def test_the_correction_is_not_just_the_mirrored_deflection(pair):
    """One mirror step leaves an error of second order; convergence does not."""
    model, _ = pair
    q, target, wrench = targets(model, 20, 4)
    once = elastostatics.deflect(model, q, TOOL, 3 * wrench)
    mirrored = target.copy()
    mirrored[:, :3, 3] -= once.twist[:, :3]
    branch = kinematics.closed_form(model).branch_of(q)
    q_mirrored = kinematics.branch_joints(model, mirrored @ frames.inverse(TOOL), branch)
    left = elastostatics.deflect(model, q_mirrored, TOOL, 3 * wrench).pose - target
    found = compensate(model, target, q, TOOL, 3 * wrench)
    rest = elastostatics.deflect(model, found.q, TOOL, 3 * wrench).pose - target
    assert np.abs(rest[:, :3, 3]).max() < 1e-8 < 1e-6 < np.abs(left[:, :3, 3]).max()


def test_rows_that_cannot_be_held_are_named(pair):
    model, _ = pair
    q, target, wrench = targets(model, 4, 5)
    wrench[2, 2] = np.nan
    with pytest.raises(NotConvergedError) as found:
        compensate(model, target, q, TOOL, wrench)
    assert found.value.rows == (2,)
