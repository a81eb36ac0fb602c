"""Joint springs from readings without noise: the serial method, the compensator by levels, priors, and refusals."""

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc import robot
from postproc.compensator import Compensator
from postproc.errors import MeasurementError
from postproc.identification import joint_springs, plausibility, procedure, uncertainty, validation
from postproc.identification.fit import gauss_newton
from postproc.identification.measurement_model import Placement, Structure, locate
from postproc.identification.readings import Measurements
from postproc.robot import JOINT_COMPLIANCES
from samples.paper_study import harness
from tests.kr270 import tool_at
from tests.oracle.arm import Arm

ARM = Arm.load(robot.find("kuka_kr270"))
SPRINGS = np.array([0.3, 0.2, 0.5, 3.0, 5.0, 2.5]) * 1e-6
"""Of the robot that is measured [rad/(N·m)]."""
POINTS = np.array([[0.0, 0.0, 0.12], [0.3, 0.0, 0.05], [-0.1, 0.25, 0.02], [0.1, -0.2, 0.3]])
LOAD_POINT = np.array([0.02, -0.03, 0.35])
LOADED_TIP = tool_at(*LOAD_POINT)


def posed(seed, count):
    """Joint angles (count, 6) of an arm in front of the robot [rad]."""
    low, high = np.radians([[-60, -100, 60, -150, 20, -150], [60, -40, 120, 150, 110, 150]])
    return np.random.default_rng(seed).uniform(low, high, (count, 6))


def readings(wrench, count=10, seed=1, springs=SPRINGS, points=POINTS, device=None):
    """Readings of an arm whose joints turn by k·τ, τ by the transposed Jacobian of its own matrices, in two repeats."""
    q, device = posed(seed, count), np.eye(4) if device is None else device
    place = np.empty((2 * count, len(points), 3))
    for n, angles in enumerate(q):
        work = ARM.gradient(lambda x, n=n: wrench[n, :3] @ ARM.tcp(x, LOADED_TIP)[:3, 3], angles)
        torque = work + ARM.moment_torque(angles, wrench[n, 3:])
        for state, x in ((2 * n, angles), (2 * n + 1, angles + springs * torque)):
            flange = device @ ARM.tcp(x, np.eye(4))
            place[state] = points @ flange[:3, :3].T + flange[:3, 3]
    order = [(s, r, p) for s in range(2 * count) for r in range(2) for p in range(len(points))]
    state, repeat, point = np.array(order).T
    return Measurements(
        file="m.csv", config=1.0 + np.arange(count), q=q, state_config=np.arange(2 * count) // 2,
        load=(np.arange(2 * count) % 2).astype(float),
        wrench=np.stack([np.zeros_like(wrench), wrench], axis=1).reshape(-1, 6),
        points=tuple(f"P{n + 1}" for n in range(len(points))), guess=points, load_point=LOAD_POINT, sigma=1e-5,
        state=state, point=point, repeat=1.0 + repeat, position=place[state, point], line=2 + np.arange(len(order)),
        used=np.ones(len(order), dtype=bool),
    )  # fmt: skip


def placed(data, device=None):
    size = 6 + 3 * len(data.points)
    residual = np.zeros((len(data.q), len(data.points), 3))
    return Placement(np.eye(4) if device is None else device, data.guess, 1e-3 * np.eye(size), residual)


def forces(count, size=100.0, moments=0.0, seed=2):
    rng = np.random.default_rng(seed)
    return np.hstack([rng.normal(size=(count, 3)) * size, rng.normal(size=(count, 3)) * moments])


DEVICE = np.eye(4)
DEVICE[:3, :3] = Rotation.from_euler("xyz", [20, -35, 140], degrees=True).as_matrix()
DEVICE[:3, 3] = [1.2, -3.4, 0.8]


@pytest.mark.parametrize("moments", [0.0, 60.0])
def test_the_serial_method_finds_the_springs_of_a_serial_chain(moments):
    """Displacements are rigid motions of the load point; by 100 N the arm turns little enough to be linear."""
    data = readings(forces(10, moments=moments), device=DEVICE)
    placement = placed(data, DEVICE)
    moved = joint_springs.flange_displacements(data, placement)
    for n, angles in enumerate(data.q):
        before, after = (
            data.position[(data.state == 2 * n + k) & (data.repeat == 1.0)] - DEVICE[:3, 3] for k in (0, 1)
        )
        before, after = before @ DEVICE[:3, :3], after @ DEVICE[:3, :3]  # in root axes
        turn, _ = Rotation.align_vectors(after - after.mean(axis=0), before - before.mean(axis=0))
        np.testing.assert_allclose(moved[n, 3:], turn.as_rotvec(), atol=1e-9)
        tip = ARM.tcp(angles, LOADED_TIP)[:3, 3]
        np.testing.assert_allclose(
            moved[n, :3], turn.apply(tip - before.mean(axis=0)) + after.mean(axis=0) - tip, atol=1e-9
        )
    fit = joint_springs.fit_serial(harness.PRIOR, data, placement)
    np.testing.assert_allclose(fit.values, SPRINGS, rtol=2e-3)
    np.testing.assert_allclose(fit.residual, 0.0, atol=2e-6)
    assert fit.dof == 10 * 4 * 3 - 6


def test_uncertainty_of_the_serial_method_is_that_of_least_squares():
    """σ² (AᵀA)⁻¹ with A from differences of the arm, σ² from what is left."""
    data = readings(forces(12, seed=5), count=12)
    rng = np.random.default_rng(3)
    data = replace(data, position=data.position + rng.normal(0.0, 2e-5, data.position.shape))
    fit = joint_springs.fit_serial(harness.PRIOR, data, placed(data))
    moved, wrench = joint_springs.flange_displacements(data, placed(data)), data.wrench[1::2]
    rows = []
    for n, angles in enumerate(data.q):
        position = np.array([ARM.gradient(lambda x, a=a: ARM.tcp(x, LOADED_TIP)[a, 3], angles) for a in range(3)])
        turning = np.array([ARM.moment_torque(angles, axis) for axis in np.eye(3)])
        rows.append(np.vstack([position, turning]) * (wrench[n, :3] @ position))
    design, target = np.vstack(rows), moved.ravel()
    values = np.linalg.lstsq(design / 1e6, target, rcond=None)[0] / 1e6
    left = target - design @ values
    np.testing.assert_allclose(fit.values, values, rtol=1e-6)
    covariance = left @ left / (len(target) - 6) * np.linalg.inv(design.T @ design)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-5, atol=1e-18)


def test_poses_need_three_points_that_are_not_on_a_line_and_more_readings_than_springs():
    for points in (POINTS[:2], np.outer([0.0, 0.1, 0.3], [1.0, 2.0, 0.5])):
        data = readings(forces(3), count=3, points=points)
        with pytest.raises(MeasurementError, match="three points that are not on a line"):
            joint_springs.flange_displacements(data, placed(data))
    one = readings(forces(1), count=1)
    with pytest.raises(MeasurementError, match="6 components of displacements for 6 compliances"):
        joint_springs.fit_serial(harness.PRIOR, one, placed(one))
    data = readings(forces(3), count=3)
    hidden = replace(data, used=~((data.state == 3) & (data.point < 2)))  # two of four points under load: no pose
    assert np.isnan(joint_springs.flange_displacements(hidden, placed(data))).all(axis=1).tolist() == [
        False,
        True,
        False,
    ]
    hidden = replace(data, used=~((data.state == 2) & (data.point < 1)))  # three are enough
    np.testing.assert_allclose(
        joint_springs.flange_displacements(hidden, placed(data)),
        joint_springs.flange_displacements(data, placed(data)), atol=1e-9,
    )  # fmt: skip


def test_a_joint_without_torque_keeps_the_springs_of_the_prior_in_the_serial_model():
    """The load acts on the axis of A6: its compliance is the prior's, as uncertain as that states."""
    wrench = forces(10)
    data = readings(wrench)
    on_axis = readings_on_axis(wrench)
    stated = robot.Covariance(robot.JOINT_COMPLIANCES, np.diag([1.0, 2, 3, 4, 5, 6.0]) ** 2 * 1e-2)
    prior = replace(harness.PRIOR, covariance=stated)
    result = procedure._serial_identification(prior, procedure.CheckedReadings(on_axis, placed(on_axis), [], [], ""))
    assert [entry.parameter for entry in result.missing] == [robot.JOINT_COMPLIANCES[5]]
    assert "on A6 (they act on its axis)" in result.missing[0].reason
    assert "on a bracket" in result.missing[0].advice
    assert result.fit.values[5] == prior.compliance[5]
    np.testing.assert_allclose(result.fit.values[:5], SPRINGS[:5], rtol=5e-3)
    np.testing.assert_allclose(result.fit.covariance[5], [0, 0, 0, 0, 0, (0.6e-6) ** 2])
    np.testing.assert_array_equal(result.fit.covariance[:, 5], result.fit.covariance[5])
    whole = procedure._serial_identification(prior, procedure.CheckedReadings(data, placed(data), [], [], ""))
    assert whole.missing == ()
    published = joint_springs.fit_with_prior_values(whole.fit, list(result.missing))
    plain = replace(published.structure, prior=harness.PRIOR)
    again = joint_springs.fit_with_prior_values(replace(whole.fit, structure=plain), list(result.missing))
    assert again.covariance[5, 5] == pytest.approx(
        (0.5 * harness.PRIOR.compliance[5]) ** 2
    )  # half of it, if not stated
    assert published.values[:5].tolist() == whole.fit.values[:5].tolist()
    np.testing.assert_array_equal(published.covariance[:5, :5], whole.fit.covariance[:5, :5])


def readings_on_axis(wrench):
    axis = np.array([0.0, 0.0, 0.35])
    data = readings(wrench)
    q, place = data.q, data.position.copy()
    tool = np.eye(4)
    tool[:3, 3] = axis
    for n, angles in enumerate(q):
        torque = ARM.gradient(lambda x, n=n: wrench[n, :3] @ ARM.tcp(x, tool)[:3, 3], angles)
        flange = ARM.tcp(angles + SPRINGS * torque, np.eye(4))
        rows = np.flatnonzero(data.state == 2 * n + 1)
        place[rows] = POINTS[data.point[rows]] @ flange[:3, :3].T + flange[:3, 3]
    return replace(data, position=place, load_point=axis)


def test_a_compensator_from_levels_is_the_weighted_least_squares_of_eq_9_and_10():
    law = Compensator(stiffness=8e4, free_length=0.45, L=0.184, ax=0.685, ay=0.12)
    q2 = np.radians([-120.0, -95.0, -70.0, -45.0, -20.0])
    true = np.array([4.2e6, 8e4, 0.45 * 8e4])
    a = np.hypot(0.685, 0.12)
    angle = np.arctan2(0.12, 0.685) - q2
    s = np.sqrt(a**2 + 0.184**2 + 2 * a * 0.184 * np.cos(angle))

    def equivalent(values):
        """Stiffness of joint 2 by differences of the energy of the spring."""
        h = 1e-4

        def energy(by):
            length = np.sqrt(a**2 + 0.184**2 + 2 * a * 0.184 * np.cos(angle - by))
            return 0.5 * values[1] * length**2 - values[2] * length

        return values[0] + (energy(h) - 2 * energy(0.0) + energy(-h)) / h**2

    assert s.min() > 0.45
    rng = np.random.default_rng(4)
    root_of = rng.normal(size=(5, 5)) * 2e-9
    covariance = root_of @ root_of.T + np.diag([1, 4, 2, 9, 3]) * 1e-18
    exact = joint_springs.compensator_from_levels(joint_springs.Levels(q2, 1.0 / equivalent(true), covariance), law)
    np.testing.assert_allclose(exact.values, true, rtol=1e-4)
    k = 1.0 / equivalent(true) * np.array([1.0, 1.01, 0.99, 1.02, 0.985])
    found = joint_springs.compensator_from_levels(joint_springs.Levels(q2, k, covariance), law)
    columns = np.column_stack([equivalent(unit) for unit in np.eye(3)])
    weight = np.linalg.inv(np.diag(1 / k**2) @ covariance @ np.diag(1 / k**2))
    normal = columns.T @ weight @ columns
    np.testing.assert_allclose(found.values, np.linalg.solve(normal, columns.T @ weight @ (1 / k)), rtol=1e-3)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(normal), rtol=2e-3)
    bad = covariance.copy()
    bad[1, 1] = np.inf
    k[3] = -1.0
    rest = [0, 2, 4]
    few = joint_springs.compensator_from_levels(joint_springs.Levels(q2, k, bad), law)
    alone = joint_springs.Levels(q2[rest], k[rest], covariance[np.ix_(rest, rest)])
    np.testing.assert_allclose(few.values, joint_springs.compensator_from_levels(alone, law).values)
    k[4] = 0.0
    assert joint_springs.compensator_from_levels(joint_springs.Levels(q2, k, bad), law) is None


def turned_from(data, config, pose):
    """Readings from a configuration on, in another frame of the device."""
    rows = data.state_config[data.state] >= config
    position = data.position.copy()
    position[rows] = position[rows] @ pose[:3, :3].T + pose[:3, 3]
    return replace(data, position=position)


def test_readings_that_do_not_fit_the_geometry_say_which_and_why():
    data = readings(forces(9), count=9)
    found = plausibility.checked_frames(harness.PRIOR, turned_from(data, 0, DEVICE))
    np.testing.assert_allclose(found.root_in_device, DEVICE, atol=1e-6)
    for split in (3, 4, 6):
        with pytest.raises(MeasurementError, match=f"readings from config {split + 1} on are in another") as caught:
            plausibility.checked_frames(harness.PRIOR, turned_from(data, split, DEVICE))
        assert caught.value.line == 2 + 16 * split  # two states, two repeats, four points
    for row in (0, 5):
        q = data.q.copy()
        q[row, 0] += 0.5
        with pytest.raises(MeasurementError, match=f"config {row + 1}: the readings without load are far") as caught:
            plausibility.checked_frames(harness.PRIOR, replace(data, q=q))
        assert caught.value.line == 2 + 16 * row
    with pytest.raises(MeasurementError, match="off the geometry of"):
        plausibility.checked_frames(harness.PRIOR, replace(data, q=data.q * [1, 1, 1, -1, 1, -1]))


def test_unmodelled_errors_by_level_are_sums_over_configurations():
    """Mean error of the points, its noise and its uncertainty by the parameters, by loops."""
    wrench = forces(10)
    wrench[:5] *= 400.0 / np.linalg.norm(wrench[:5], axis=1, keepdims=True)
    wrench[5:] *= 1500.0 / np.linalg.norm(wrench[5:], axis=1, keepdims=True)
    data = readings(wrench)
    rng = np.random.default_rng(8)
    data = replace(data, position=data.position + rng.normal(0.0, 1e-5, data.position.shape))
    data = replace(data, used=~((data.state == 5) & (data.point == 1)))
    placement = placed(data)
    fit = joint_springs.fit_serial(harness.PRIOR, data, placement)
    off = rng.normal(0.0, 3e-5, (10, 4, 3))
    off[2, 1] = 0.0
    result = uncertainty.discrepancy(data, placement, fit, off)
    np.testing.assert_allclose(result.load, [400.0, 1500.0])
    held_out, noise = [], []
    squares, dof = data.scatter()
    for n in range(10):
        points = [p for p in range(4) if (n, p) != (2, 1)]
        held_out.append(np.sum(np.mean([off[n, p] for p in points], axis=0) ** 2))
        noise.append(len(points) * 3 * squares / dof * (1 / 2 + 1 / 2) / len(points) ** 2)
    assert dof > 30
    for level, rows in enumerate((range(5), range(5, 10))):
        assert result.held_out[level] == pytest.approx(np.sqrt(np.mean([held_out[n] for n in rows])))
        assert result.noise[level] == pytest.approx(np.sqrt(np.mean([noise[n] for n in rows])))
        own = []
        for n in rows:
            slopes = np.zeros((3, 6))
            points = [p for p in range(4) if (n, p) != (2, 1)]
            for p in points:
                shift = np.eye(4)
                shift[:3, 3] = POINTS[p]
                position = np.array(
                    [ARM.gradient(lambda x, a=a, s=shift: ARM.tcp(x, s)[a, 3], data.q[n]) for a in range(3)]
                )
                torque = ARM.gradient(lambda x, n=n: wrench[n, :3] @ ARM.tcp(x, LOADED_TIP)[:3, 3], data.q[n])
                slopes += position * torque / len(points)
            own.append(np.trace(slopes @ fit.covariance @ slopes.T))
        assert result.parameter_error[level] == pytest.approx(np.sqrt(np.mean(own)), rel=0.02)  # linear in the load


def test_loads_in_the_workspace_are_those_that_were_measured_and_no_joint_gets_more_torque():
    wrench = forces(10, 500.0)
    data = readings(wrench)
    sigma = 0.02 * harness.PRIOR.compliance * 1e6
    model = replace(harness.PRIOR, covariance=robot.Covariance(robot.JOINT_COMPLIANCES, np.diag(sigma**2)))
    q, direction = uncertainty._random_poses(model, LOADED_TIP)
    assert len(q) == 100
    tips = np.array([ARM.tcp(angles, LOADED_TIP)[:3, 3] for angles in q])
    assert tips[:, 2].min() > 0.0
    assert np.hypot(tips[:, 0], tips[:, 1]).min() > 0.6  # a quarter of the reach, about
    assert np.hypot(tips[:, 0], tips[:, 1]).min() < 0.9
    assert np.abs(tips[:, :2]).min(axis=0).max() < 0.1  # all around the axis of A1
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0)

    def torques(angles, force):
        return np.abs(ARM.gradient(lambda x: force @ ARM.tcp(x, LOADED_TIP)[:3, 3], angles))

    measured = np.max([torques(angles, wrench[n, :3]) for n, angles in enumerate(data.q)], axis=0)
    largest = np.linalg.norm(wrench[:, :3], axis=1).max()
    size = [
        largest * min(1.0, (measured / torques(angles, largest * unit)).min())
        for angles, unit in zip(q, direction, strict=True)
    ]
    found = uncertainty.bound_over_workspace(model, data)
    loads = [level.load for level in found.levels]
    np.testing.assert_allclose(loads, np.median(size) * np.array([0.05, 0.1, 0.2, 0.5, 1.0]), rtol=1e-6)
    assert np.min(size) < 0.5 * largest
    assert found.least_load == pytest.approx(np.linalg.norm(wrench[:, :3], axis=1).min())


def test_frames_and_points_are_found_from_a_guess_with_the_covariance_of_small_errors():
    """Changes of base and points by one reading each, squared and summed: the covariance for unit noise."""
    data = readings(forces(6), count=6, points=POINTS[:2], device=DEVICE)
    true = np.array([[0.0, 0.0, 0.12], [0.3, 0.0, 0.05]])
    data = replace(data, guess=true + np.array([[0.02, -0.01, 0.03], [-0.01, 0.02, 0.01]]))
    found = locate(harness.PRIOR, data)
    np.testing.assert_allclose(found.root_in_device, DEVICE, atol=1e-9)
    np.testing.assert_allclose(found.points, true, atol=1e-9)
    assert found.rms < 1e-9
    step, expected = 1e-5, np.zeros((12, 12))
    for row in np.flatnonzero(data.state % 2 == 0):
        for axis in range(3):
            position = data.position.copy()
            position[row, axis] += step
            moved = locate(harness.PRIOR, replace(data, position=position))
            turn = Rotation.from_matrix(moved.root_in_device[:3, :3] @ DEVICE[:3, :3].T).as_rotvec()
            shift = moved.root_in_device[:3, 3] - DEVICE[:3, 3]
            change = np.concatenate([shift, turn, (moved.points - true).ravel()]) / step
            expected += np.outer(change, change)
    np.testing.assert_allclose(found.covariance, expected, rtol=2e-3, atol=2e-3 * np.abs(expected).max())
    without = replace(data, used=~((data.state == 4) & (data.point == 0)))
    np.testing.assert_allclose(locate(harness.PRIOR, without).points, true, atol=1e-9)
    assert (locate(harness.PRIOR, without).residual[2, 0] == 0.0).all()


def test_vertical_loads_say_nothing_of_a1_and_that_is_the_reason():
    wrench = forces(10)
    wrench[:, :2] = 0.0
    data = readings(wrench)
    result = procedure._serial_identification(harness.PRIOR, procedure.CheckedReadings(data, placed(data), [], [], ""))
    assert robot.JOINT_COMPLIANCES[0] in [entry.parameter for entry in result.missing]
    reason = next(entry for entry in result.missing if entry.parameter == robot.JOINT_COMPLIANCES[0])
    assert "on A1 (they are vertical, parallel to its axis)" in reason.reason
    assert "sideways" in reason.advice


@pytest.mark.parametrize(
    ("dof", "chi2", "unexplained"),
    [(50, 50 + 3.29 * 10 + 7 - 0.1, False), (50, 50 + 3.29 * 10 + 7 + 0.1, True), (0, 1e9, False), (-3, 1e9, False)],
)
def test_squares_beyond_three_standard_deviations_of_their_sum_and_seven_are_unexplained(dof, chi2, unexplained):
    """χ² of 50 degrees of freedom has a standard deviation of 10."""
    assert procedure._has_unexplained_error(SimpleNamespace(dof=dof, chi2=chi2)) == unexplained


def test_what_is_proportional_to_the_load_and_what_is_not():
    """A load cell that is wrong by a share makes compliances wrong by it, those of a spring by its opposite."""
    shares = {
        robot.JOINT_COMPLIANCES[2]: 1.0,
        robot.LinkSpring("A2", robot.LINK_AXES[0]): 1.0,
        robot.CompensatorStiffness(): -1.0,
        robot.CompensatorPreload(): -1.0,
        robot.LinkMass("A3"): 0.0,
        robot.CompensatorSize(): 0.0,
        robot.Backlash("A2", 30.0): 0.0,
        robot.LostMotion("A2", 30.0): 0.0,
    }
    assert {parameter: uncertainty._load_sensitivity(parameter) for parameter in shares} == shares


def test_displacements_and_bounds_of_a_point_are_the_same_from_whichever_point_the_load_is_given():
    """The moment about the point is that about the load point less the lever times the force."""
    sigma = np.array([2.0, 5.0, 3.0, 9.0, 4.0, 8.0]) * 1e-2 * harness.PRIOR.compliance * 1e6
    model = replace(harness.PRIOR, covariance=robot.Covariance(robot.JOINT_COMPLIANCES, np.diag(sigma**2)))
    wrench = forces(4, 900.0, 200.0)
    data = readings(wrench, count=4)
    moved, bound = validation._prediction(model, data, placed(data))
    assert bound.min() > 1e-6
    for index, point in enumerate(POINTS):
        about = data.wrench.copy()
        for n, angles in enumerate(data.q):
            lever = ARM.tcp(angles, np.eye(4))[:3, :3] @ (point - LOAD_POINT)
            about[2 * n + 1, 3:] -= np.cross(lever, wrench[n, :3])
        there = validation._prediction(model, replace(data, wrench=about, load_point=point), placed(data))
        np.testing.assert_allclose(bound[:, index], there[1][:, index], rtol=1e-9)
        # the moment turns with the arm from there on: a small share of what it moves
        np.testing.assert_allclose(there[0][:, index], moved[:, index], atol=5e-3 * np.abs(moved).max())


def test_points_that_were_not_read_leave_no_residual_and_do_not_move_the_frame():
    """One point without load, another under load: what is not read is neither at zero nor where the model has it."""
    data = readings(forces(6), count=6)
    hidden = replace(
        data,
        used=~(((data.state == 2) & (data.point == 0)) | ((data.state == 5) & (data.point == 1))),
    )
    structure = Structure(JOINT_COMPLIANCES, harness.PRIOR)
    left = gauss_newton(structure, hidden, placed(data)).residual
    assert not left[1, 0].any()
    assert not left[2, 1].any()
    assert (np.abs(np.delete(left.reshape(-1, 3), [1 * 4, 2 * 4 + 1], axis=0)).max(axis=1) > 0.0).all()
    whole, partial = (locate(harness.PRIOR, measured) for measured in (data, hidden))
    np.testing.assert_allclose(partial.root_in_device, whole.root_in_device, atol=1e-6)


def readings_under_two_loads(first, second):
    """Readings of the same configurations without load, under a first and under a second load."""
    data, other = readings(first), readings(second)
    rows, configs = np.flatnonzero(np.isin(other.state, other.loaded_states)), len(data.q)
    columns = {name: getattr(other, name)[rows] for name in ("point", "repeat", "position", "line", "used")}
    columns["state"] = 2 * configs + other.state_config[other.state[rows]]
    return replace(
        data, state_config=np.append(data.state_config, np.arange(configs)),
        load=np.append(data.load, np.full(configs, 2.0)),
        wrench=np.vstack([data.wrench, other.wrench[other.loaded_states]]),
        **{name: np.concatenate([getattr(data, name), values]) for name, values in columns.items()},
    )  # fmt: skip


@pytest.mark.parametrize("state", [0, 1])
def test_a_point_without_a_reading_with_or_without_load_does_not_move_the_springs(state):
    """Under two loads the difference between them weighs as much as each: nothing may be compared with zero there."""
    data = readings_under_two_loads(forces(10, 500.0), forces(10, 500.0, seed=5))
    hidden = replace(data, used=~((data.state % 2 == state) & (data.state < 8) & (data.point == 0)))
    assert np.count_nonzero(~hidden.used) == 8
    structure = Structure(JOINT_COMPLIANCES, harness.PRIOR)
    whole, partial = (gauss_newton(structure, measured, placed(data)) for measured in (data, hidden))
    np.testing.assert_allclose(partial.values, whole.values, rtol=1e-3)
    np.testing.assert_allclose(partial.values, SPRINGS, rtol=5e-3)
    assert partial.chi2 < whole.chi2 + 1e-9
    assert (np.diag(partial.covariance) > np.diag(whole.covariance)).all()  # it rests on fewer readings
