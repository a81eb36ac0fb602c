"""Kinematics: closed form against Pinocchio on many poses, derivatives against finite differences, S and T."""

from __future__ import annotations

import numpy as np
import pytest

from postproc import frames, kinematics, robot
from postproc.errors import ModelError
from tests.oracle.arm import Arm

TOOL = frames.pose_from_xyzabc([30.0, -20.0, 350.0, 10.0, -20.0, 30.0])
STEP = 1e-6
OFFSET_AND_FOREARM = {
    "abb_irb6700_200_260": (-200, 1142.5),
    "kuka_kr120_r2700_2": (-115, 1220),
    "kuka_kr16_2": (35, 670),
    "kuka_kr210_r2700_2": (-115, 1220),
    "kuka_kr240_r2900_2": (-115, 1220),
    "kuka_kr270": (55, 1100),
    "kuka_kr300_r2700_2": (-115, 1220),
    "kuka_kr500_r2830": (55, 1025),
    "kuka_kr60_3": (-145, 820),
    "kuka_kr6_r900_2": (-25, 420),
}
"""Of the drawings: how far the axis of A4 lies below A3, and how far the wrist is from A3, mm."""


@pytest.fixture(scope="module", params=sorted(robot.shipped()))
def model(request):
    return robot.load(robot.find(request.param))


def test_forward_after_inverse_returns_100_000_random_poses(model):
    q = np.random.default_rng(1).uniform(model.lower, model.upper, (100_000, 6))
    pose, _ = kinematics.tcp(model.nominal, q, np.eye(4))
    branches = kinematics.closed_form(model).branches(pose)
    apart = np.abs((branches - q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=2)
    best = np.nanargmin(apart, axis=1)
    found = branches[np.arange(len(q)), best]
    back, _ = kinematics.tcp(model.nominal, found, np.eye(4))
    assert np.abs(back - pose).max() < 1e-9


def test_forward_kinematics_equals_the_oracle_read_from_the_urdf(model):
    arm = Arm.load(robot.find(model.name))
    q = np.random.default_rng(2).uniform(model.lower, model.upper, (20, 6))
    pose, _ = kinematics.tcp(model.nominal, q, TOOL)
    np.testing.assert_allclose(pose, [arm.tcp(row, TOOL) for row in q], atol=1e-12)


@pytest.mark.parametrize("count", [0, 64, 65, 67])
def test_many_configurations_at_once_are_each_what_they_are_alone(model, count):
    q = np.random.default_rng(6).uniform(model.lower, model.upper, (count, 6))
    together = (*kinematics.tcp(model.loaded, q, TOOL), kinematics.gravity_torque(model.loaded, q))
    for row in range(count):
        one = q[row : row + 1]
        alone = (*kinematics.tcp(model.loaded, one, TOOL), kinematics.gravity_torque(model.loaded, one))
        for one, all_ in zip(alone, together, strict=True):
            np.testing.assert_allclose(one[0], all_[row], rtol=1e-12, atol=1e-9)
    assert [len(part) for part in together] == [count] * 3


def test_flange_at_zero_is_stretched_along_x_with_kuka_orientation(model):
    pose, _ = kinematics.tcp(model.nominal, np.zeros((1, 6)), np.eye(4))
    np.testing.assert_allclose(frames.xyzabc_from_pose(pose)[0, 3:], [0.0, 90.0, 0.0], atol=1e-9)
    assert pose[0, 0, 3] > 0.9


def test_positive_a1_turns_clockwise_seen_from_above_and_positive_a2_lowers_the_arm(model):
    pose, _ = kinematics.tcp(model.nominal, np.radians([[10.0, 0, 0, 0, 0, 0], [0, 10.0, 0, 0, 0, 0]]), np.eye(4))
    rest, _ = kinematics.tcp(model.nominal, np.zeros((1, 6)), np.eye(4))
    assert pose[0, 1, 3] < -0.1
    assert pose[1, 2, 3] < rest[0, 2, 3]


def test_jacobian_equals_central_differences_of_the_pose(model):
    q = np.random.default_rng(3).uniform(model.lower, model.upper, (50, 6))
    _, jacobian = kinematics.tcp(model.nominal, q, TOOL)
    for joint in range(6):
        change = np.eye(6)[joint] * STEP
        plus, minus = (kinematics.tcp(model.nominal, q + sign * change, TOOL)[0] for sign in (1, -1))
        np.testing.assert_allclose(frames.twist_between(minus, plus) / (2 * STEP), jacobian[:, :, joint], atol=1e-8)


def test_load_stiffness_equals_differences_of_the_joint_torques_of_a_dead_load(model):
    rng = np.random.default_rng(4)
    q, wrench = rng.uniform(model.lower, model.upper, (50, 6)), rng.normal(size=(50, 6))
    _, jacobian = kinematics.tcp(model.nominal, q, TOOL)
    hessian = kinematics.load_stiffness(jacobian, wrench)
    for joint in range(6):
        change = np.eye(6)[joint] * STEP
        plus, minus = (kinematics.tcp(model.nominal, q + sign * change, TOOL)[1] for sign in (1, -1))
        slope = np.einsum("nij,ni->nj", (plus - minus) / (2 * STEP), wrench)
        np.testing.assert_allclose(slope, hessian[:, :, joint], atol=1e-8)


def test_gravity_torque_and_stiffness_are_derivatives_of_the_potential_energy(model):
    arm = Arm.load(robot.find(model.name))
    q = np.random.default_rng(5).uniform(model.lower, model.upper, (10, 6))
    expected = [arm.gradient(arm.weight_energy, row) for row in q]
    np.testing.assert_allclose(kinematics.gravity_torque(model.loaded, q), expected, atol=1e-8)
    stiffness = kinematics.gravity_stiffness(model.loaded, q)
    for joint in range(6):
        change = np.eye(6)[joint] * STEP
        slope = kinematics.gravity_torque(model.loaded, q + change) - kinematics.gravity_torque(
            model.loaded, q - change
        )
        np.testing.assert_allclose(slope / (2 * STEP), stiffness[:, :, joint], atol=1e-4)


def test_status_and_turn_of_the_usual_home_position_are_2_and_the_signs_of_the_axes(model):
    q = np.radians([[0, -90, 90, 0, 10, 0], [0, -90, 90, 0, -10, 0], [5, -90, -50, 0, 20, -1.0]])
    np.testing.assert_array_equal(kinematics.status_of(model, q), [2, 6, 1])
    np.testing.assert_array_equal(kinematics.turn_of(q), [0b000010, 0b010010, 0b100110])


def test_status_bit_1_changes_where_the_wrist_centre_crosses_the_line_through_axes_2_and_3(model):
    edge = kinematics.closed_form(model).elbow_stretched
    offset, forearm = OFFSET_AND_FOREARM[model.name]
    assert np.degrees(edge) == pytest.approx(-np.degrees(np.arctan2(offset, forearm)), abs=1e-6)
    q = np.array([[0, -0.5, edge + 1e-4, 0, 0.3, 0], [0, -0.5, edge - 1e-4, 0, 0.3, 0]])
    assert (kinematics.status_of(model, q) & 2).tolist() == [2, 0]


def test_follow_keeps_turns_and_branch_along_a_line_and_takes_s_and_t_of_a_ptp(model):
    start = np.radians([10.0, -70.0, 100.0, 170.0, 40.0, 200.0])
    q = start + np.linspace(0, 1, 30)[:, None] * np.radians([5, 5, 5, 20, 5, 30.0])
    pose, _ = kinematics.tcp(model.nominal, q, np.eye(4))
    n = len(q)
    free = np.zeros(n, dtype=bool)
    path = kinematics.follow(model, pose.__getitem__, start, free, np.empty((0, 6)), np.empty(0), np.empty(0))
    np.testing.assert_allclose(path.q, q, atol=1e-9)
    flipped = np.radians([10.0, -70.0, 100.0, -10.0, -40.0, 20.0])
    free[0] = True
    status, turn = kinematics.status_of(model, flipped[None]), kinematics.turn_of(flipped[None])
    path = kinematics.follow(model, pose.__getitem__, start, free, np.full((1, 6), np.nan), status, turn)
    np.testing.assert_allclose(path.q[0], flipped, atol=1e-9)
    np.testing.assert_allclose(kinematics.tcp(model.nominal, path.q, np.eye(4))[0], pose, atol=1e-9)


def test_out_of_reach_names_the_rows(model):
    pose = np.tile(np.eye(4), (3, 1, 1))
    pose[:, :3, 3] = [[1.2, 0.2, 1.0], [9.0, 0, 1.0], [1.2, 0.2, 1.0]]
    with pytest.raises(kinematics.UnreachableError) as found:
        kinematics.follow(
            model, pose.__getitem__, np.radians([0, -70, 110, 0, 50, 0]), np.zeros(3, dtype=bool),
            np.empty((0, 6)), np.empty(0), np.empty(0),
        )  # fmt: skip
    assert 1 in found.value.rows


def test_an_arm_without_spherical_wrist_is_refused(tmp_path):
    folder = robot.find("kuka_kr270")
    for name in ("robot.urdf", "model.toml"):
        (tmp_path / name).write_text(
            (folder / name).read_text(encoding="utf-8").replace('xyz="0.23 0 0"', 'xyz="0.23 0 0.02"'), encoding="utf-8"
        )
    with pytest.raises(ModelError, match="spherical wrist"):
        kinematics.closed_form(robot.load(tmp_path))
