"""Elastostatics against an oracle that shares no code with it, and derivatives against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics, frames, kinematics, robot
from postproc.elastostatics import balance
from postproc.elastostatics.equilibrium import deflection_at_target
from postproc.errors import NotConvergedError
from tests.kr270 import FOLDER, ROBOT, TURNED_TOOL
from tests.oracle.arm import Arm

ROBOTS = sorted(robot.shipped_models())


@pytest.fixture(scope="module", params=ROBOTS)
def pair(request):
    folder = robot.find(request.param)
    return robot.load(folder), Arm.load(folder)


def loads(rng, count, force, moment):
    directions = rng.normal(size=(count, 2, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    return np.concatenate([force * directions[:, 0], moment * directions[:, 1]], axis=1)


def test_deflection_equals_the_energy_oracle_at_2700_N_and_300_Nm(pair):
    model, arm = pair
    rng = np.random.default_rng(1)
    q = rng.uniform(model.lower, model.upper, (12, 6))
    scale = 1.0 if model.name == "kuka_kr270" else 0.2
    wrench = loads(rng, len(q), 2700.0 * scale, 300.0 * scale)
    state = elastostatics.deflect(model, q, TURNED_TOOL, wrench)
    for row in range(len(q)):
        tip = arm.loaded_tcp(q[row], TURNED_TOOL, wrench[row])
        expected = tip[:3, 3] - arm.tcp(q[row], TURNED_TOOL)[:3, 3]
        assert np.linalg.norm(state.twist[row, :3] - expected) <= 1e-6 * np.linalg.norm(expected)
        np.testing.assert_allclose(state.pose[row], tip, atol=1e-8)


def test_payload_and_rigid_reference_equal_the_oracle(pair):
    import dataclasses

    from msgspec.structs import replace

    model, arm = pair
    rng = np.random.default_rng(2)
    q = rng.uniform(model.lower, model.upper, (6, 6))
    centre = np.array([0.05, -0.1, 0.2])
    loaded = replace(model, subtract_reference=False).with_payload(60.0, centre)
    arm = dataclasses.replace(arm, rigid=True, payload=(60.0, centre))
    wrench = loads(rng, len(q), 200.0, 20.0)
    state = elastostatics.deflect(loaded, q, TURNED_TOOL, wrench)
    for row in range(len(q)):
        np.testing.assert_allclose(state.pose[row], arm.loaded_tcp(q[row], TURNED_TOOL, wrench[row]), atol=2e-9)


def test_springs_at_a_known_actual_pose_invert_the_deflection(pair):
    model, _ = pair
    rng = np.random.default_rng(3)
    q = rng.uniform(model.lower, model.upper, (200, 6))
    wrench = loads(rng, len(q), 500.0, 50.0)
    state = elastostatics.deflect(model, q, TURNED_TOOL, wrench)
    x = (q + state.theta).T
    stands = kinematics.posture(model.loaded, x, kinematics.components(TURNED_TOOL), weigh=True)
    load = np.einsum("ikn,ni->kn", stands.jacobian(), wrench)
    found = deflection_at_target(model, x, load, balance.static_torque(model, x, stands))
    np.testing.assert_allclose(found, state.theta.T, atol=1e-8)  # rad: what is asked of the correction


def test_linear_model_is_the_limit_for_small_loads_and_differs_with_the_square_of_the_load(pair):
    model, _ = pair
    rng = np.random.default_rng(4)
    q = rng.uniform(model.lower, model.upper, (50, 6))
    direction = loads(rng, len(q), 1.0, 0.1)
    gap = []
    small = 100.0 * min(1.0, 2e-6 / float(model.compliance[0]))  # N; a load that hardly bends a small arm either
    for size in (small, 2.0 * small):
        state = elastostatics.deflect(model, q, TURNED_TOOL, size * direction)
        linear = elastostatics.linear_deflection(model, q, TURNED_TOOL, size * direction)
        gap.append(np.linalg.norm((linear - state.twist)[:, :3], axis=1) / size**2)
        assert np.median(gap[-1] * size**2 / np.linalg.norm(state.twist[:, :3], axis=1)) < 2e-3
    np.testing.assert_allclose(np.median(gap[1] / gap[0]), 1.0, atol=0.05)


def test_cartesian_stiffness_is_the_inverse_of_finite_differences_of_the_equilibrium(pair):
    model, _ = pair
    rng = np.random.default_rng(5)
    q = rng.uniform(model.lower, model.upper, (5, 6))
    wrench = np.zeros((5, 6))
    stiffness = elastostatics.cartesian_stiffness(model, q, TURNED_TOOL, wrench)
    compliance = elastostatics.tangent_compliance(model, q, TURNED_TOOL, wrench)
    np.testing.assert_allclose(stiffness @ compliance, np.tile(np.eye(6), (5, 1, 1)), atol=1e-8)
    for column, step in enumerate((200.0, 200.0, 200.0, 40.0, 40.0, 40.0)):
        change = np.zeros((5, 6))
        change[:, column] = step
        plus = elastostatics.deflect(model, q, TURNED_TOOL, change).twist
        minus = elastostatics.deflect(model, q, TURNED_TOOL, -change).twist
        slope = (plus - minus) / (2 * step)
        scale = np.abs(compliance[:, :, column]).max(axis=1, keepdims=True)
        np.testing.assert_allclose(slope / scale, compliance[:, :, column] / scale, atol=2e-4)


def test_joint_stiffness_in_place_2_is_equation_4(pair):
    model, arm = pair
    if model.compensator is None:
        pytest.skip("this robot has no compensator: nothing to add in place 2")
    q2 = np.linspace(model.lower[1], model.upper[1], 9)
    h = 1e-4
    second = [(arm.spring_energy(a + h) - 2 * arm.spring_energy(a) + arm.spring_energy(a - h)) / h**2 for a in q2]
    added = model.compensator.stiffness_about_joint(q2)
    np.testing.assert_allclose(added, second, rtol=1e-5, atol=0.05)


def test_scale_of_the_paper_200_random_poses_deflect_by_about_5_9_mm_rms():
    rng = np.random.default_rng(6)
    q = rng.uniform(ROBOT.lower, ROBOT.upper, (200, 6))
    wrench = np.tile([0.0, 0.0, -2700.0, 0.0, 0.0, 0.0], (200, 1))
    twist = elastostatics.deflect(ROBOT, q, frames.pose_from_xyzabc([0, 0, 350, 0, 0, 0]), wrench).twist
    rms = np.sqrt(np.mean(np.sum(twist[:, :3] ** 2, axis=1)))
    assert 4.7e-3 < rms < 7.1e-3  # 5.9 mm ± 20 %: the paper's poses and load point are not published


def test_a_load_beyond_the_springs_is_an_error_and_not_a_number(pair):
    model, _ = pair
    q = np.radians([[0.0, -70.0, 110.0, 0.0, 50.0, 0.0]])
    with pytest.raises(NotConvergedError):
        elastostatics.deflect(model, q, TURNED_TOOL, np.array([[np.nan, 0, 0, 0, 0, 0]]))
    with pytest.raises(NotConvergedError):
        elastostatics.deflect(model, q, TURNED_TOOL, np.array([[0.0, 0, -5e7, 0, 0, 0]]))


def test_the_compliance_of_a_robot_without_masses_needs_no_pinocchio(monkeypatch):
    monkeypatch.setattr(kinematics.hessian, "import_module", lambda name: pytest.fail(f"{name} is imported"))
    kinematics.hessian.pinocchio_model.cache_clear()
    whole, arm = robot.load(FOLDER), Arm.load(FOLDER)
    chain = replace(whole.nominal, mass=np.zeros(6))
    light = replace(whole, nominal=chain, actual=chain, loaded=chain, compensator=None)
    q = np.radians([[10.0, -70.0, 105.0, 20.0, 50.0, 30.0]])
    linear = [arm.gradient(lambda x, k=k: arm.tcp(x, TURNED_TOOL)[k, 3], q[0]) for k in range(3)]
    jacobian = np.array([*linear, *(arm.moment_torque(q[0], axis) for axis in np.eye(3))])
    found = elastostatics.tangent_compliance(light, q, TURNED_TOOL, np.zeros((1, 6)))[0]
    np.testing.assert_allclose(found, jacobian @ np.diag(1.0 / arm.stiffness) @ jacobian.T, rtol=1e-9, atol=1e-15)
    rigid = elastostatics.deflect(replace(light, subtract_reference=False), q, TURNED_TOOL, np.zeros((1, 6)))
    assert not rigid.theta.any()


@pytest.mark.parametrize("name", ["kuka_kr270", "kuka_kr210_r2700_2", "abb_irb6700_200_260"])
def test_the_linear_compliance_is_the_exact_one_but_for_the_torques_that_change_with_the_pose(name):
    """Pinocchio's Hessian of weights and load is in the exact one; it is some thousandths of a stiff robot's."""
    model = robot.load(robot.find(name))
    random = np.random.default_rng(5)
    q = random.uniform(np.maximum(model.lower, -1.5), np.minimum(model.upper, 1.5), (50, 6))
    wrench = np.concatenate([random.normal(0.0, 300.0, (50, 3)), random.normal(0.0, 20.0, (50, 3))], axis=1)
    linear = elastostatics.linear_compliance(model, q, TURNED_TOOL, wrench)[:, :3]
    exact = elastostatics.tangent_compliance(model, q, TURNED_TOOL, wrench)[:, :3]
    difference = np.linalg.norm(linear - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    assert 0.0 < difference.max() < 0.005  # of the compliance
