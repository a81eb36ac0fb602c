"""Elastostatics and compensation of arms in which every term of the model counts, against an oracle of its own.

Masses far off axis, moments as large as forces, a compensator as stiff as its joint, springs of links, gears that
stiffen, with breakpoints, backlash and lost motion, a payload, errors of geometry and of transmission, and torques that
change sign; in each of the four states of [gravity].
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics, frames, kinematics, robot
from postproc.elastostatics import balance, equilibrium
from postproc.elastostatics.equilibrium import deflection_at_target
from postproc.errors import ModelError, NotConvergedError
from postproc.robot import parameters, urdf
from postproc.robot.model_file import (
    BacklashEntry,
    CompensatorEntry,
    Displacement,
    Gravity,
    JointSpring,
    LinkSprings,
    ModelFile,
    PoseWaveEntry,
    Stiffening,
    TransmissionEntry,
)
from tests.kr270 import FOLDER
from tests.oracle import whole_arm
from tests.oracle.whole_arm import WholeArm, slopes, twist
from tests.test_pinocchio import any_urdf

KUKA = (FOLDER / "robot.urdf").read_text(encoding="utf-8")
FAR_OFFSET_TOOL = frames.pose_from_xyzabc([230.0, -120.0, 350.0, 10.0, -20.0, 30.0])
PAYLOAD = (60.0, (0.1, -0.2, 0.15))
NO_PAYLOAD = (0.0, (0.0, 0.0, 0.0))
GRAVITIES = [Gravity(reference, in_gears) for reference in ("calibrated", "rigid") for in_gears in (False, True)]


def content(seed, gravity):
    """A model file in which nothing is zero."""
    rng = np.random.default_rng(seed)

    def about(value):
        return float(value * rng.uniform(0.6, 1.4))

    joints = {
        name: JointSpring(
            source="test",
            compliance_urad_per_Nm=3.0 if name == "A2" else about(1.0),
            stiffening=[Stiffening(about(300.0), about(0.2))],
            knees=[Stiffening(about(800.0), about(0.15))],
            backlash=BacklashEntry(about(60.0), about(80.0)),
            lost_motion=BacklashEntry(about(50.0), about(60.0)),
            over_pose=[
                PoseWaveEntry((0, 1, -1, 0, 0, 0), about(0.1), about(-0.2)),
                PoseWaveEntry((0, 0, 0, 2, 0, 1), sin_urad_per_Nm=about(0.3)),
            ],
            coupling={"A4": {"A5": about(0.4), "A6": about(-0.3)}, "A5": {"A6": about(0.2)}}.get(name, {}),
        )
        for name in robot.JOINTS
    }
    return ModelFile(
        name="all terms",
        joints=joints,
        gravity=gravity,
        compensator=CompensatorEntry(
            source="test", L_mm=190.0, a_x_mm=620.0, a_y_mm=210.0, stiffness_N_per_m=6e5, free_length_mm=600.0
        ),
        geometry={
            name: Displacement(
                source="test",
                **{key: about(1.0) for key in ("X_mm", "Y_mm", "Z_mm")},
                **{key: about(0.05) for key in ("RX_deg", "RY_deg", "RZ_deg")},
            )
            for name in (*robot.JOINTS, "flange")
        },
        transmission={
            name: TransmissionEntry(
                source="test", **{f"{term}_urad": about(200.0) for term in ("sin", "cos", "sin2", "cos2")}
            )
            for name in robot.JOINTS
        },
        links={
            "base": LinkSprings(source="test", RX_urad_per_Nm=about(0.1), Z_um_per_N=about(0.03)),
            "A2": LinkSprings(source="test", Y_um_per_N=about(0.02), end_RY_urad_per_Nm=about(0.2)),
            "A3": LinkSprings(source="test", RZ_urad_per_Nm=about(0.2)),
            "A6": LinkSprings(source="test", X_um_per_N=about(0.03), end_RZ_urad_per_Nm=about(0.2)),
        },
    )


def arms(seed, gravity, payload=PAYLOAD, urdf_of=None):
    """A robot of the package, the same by the oracle, joint angles (3, 6) and wrenches (3, 6)."""
    rng = np.random.default_rng(seed)
    text = KUKA if seed == 0 else any_urdf(rng)
    file = content(seed, gravity)
    model = robot.assemble("all terms", file, urdf.read(text, "any.urdf")).with_payload(
        payload[0], np.array(payload[1])
    )
    q = np.radians([10.0, -60, 80, 20, 40, 30]) + rng.uniform(-0.5, 0.5, (3, 6))
    wrench = rng.uniform(-1.0, 1.0, (3, 6)) * [1000.0, 1000, 1000, 900, 900, 900]
    return model, WholeArm(text, file, payload), q, wrench


STATES = pytest.mark.parametrize("gravity", GRAVITIES, ids=str)
ARMS = pytest.mark.parametrize("seed", [0, 1, 7])


@STATES
@ARMS
def test_the_loaded_equilibrium_and_the_command_that_undoes_it_are_those_of_the_oracle(seed, gravity):
    model, arm, q, wrench = arms(seed, gravity)
    state = elastostatics.deflect(model, q, FAR_OFFSET_TOOL, wrench)
    x = (elastostatics.coordinates(model, q) + state.theta).T
    there = kinematics.posture(model.loaded, x, kinematics.components(FAR_OFFSET_TOOL), weigh=True)
    load = np.einsum("ikn,ni->kn", there.jacobian(), wrench)
    springs = deflection_at_target(model, x, load, balance.static_torque(model, x, there))
    for row in range(len(q)):
        theta, pose = arm.equilibrium(q[row], FAR_OFFSET_TOOL, wrench[row])
        assert np.linalg.norm(pose[:3, 3] - arm.given(q[row], FAR_OFFSET_TOOL, wrench[row])[1](0.0)[0][:3, 3]) > 5e-4
        np.testing.assert_allclose(state.theta[row], theta, rtol=0, atol=3e-9)  # rad, m
        np.testing.assert_allclose(state.pose[row], pose, rtol=0, atol=3e-9)
        np.testing.assert_allclose(state.twist[row], twist(state.unloaded_pose[row], pose), rtol=0, atol=1e-8)
        np.testing.assert_allclose(springs[:, row], theta, rtol=0, atol=1e-8)
    target = np.array([arm.nominal(row, FAR_OFFSET_TOOL) for row in q])
    found = elastostatics.compensate(model, target, q, FAR_OFFSET_TOOL, wrench)
    for row in range(len(q)):
        theta, pose = arm.equilibrium(found.q[row], FAR_OFFSET_TOOL, wrench[row])
        np.testing.assert_allclose(pose, target[row], rtol=0, atol=2e-8)
        np.testing.assert_allclose(found.theta[row], theta, rtol=0, atol=2e-8)
        np.testing.assert_allclose(found.pose[row], arm.nominal(found.q[row], FAR_OFFSET_TOOL), rtol=0, atol=1e-12)


@STATES
@ARMS
def test_linear_deflection_compliance_and_stiffness_are_those_by_differences_of_the_oracle(seed, gravity):
    model, arm, q, wrench = arms(seed, gravity)
    linear = elastostatics.linear_deflection(model, q, FAR_OFFSET_TOOL, wrench)
    compliance = elastostatics.tangent_compliance(model, q, FAR_OFFSET_TOOL, wrench)
    stiffness = elastostatics.cartesian_stiffness(model, q, FAR_OFFSET_TOOL, wrench)
    for row in range(len(q)):
        given, tcp = arm.given(q[row], FAR_OFFSET_TOOL, wrench[row])
        zero = np.zeros(len(arm.linear))
        by_theta = slopes(given, zero, 1e-7)
        by_force = slopes(lambda force, given=given, zero=zero: given(zero, force), wrench[row], 1e-2)
        reach = tcp(zero)[1] @ np.linalg.inv(np.eye(len(zero)) - by_theta)
        np.testing.assert_allclose(linear[row], reach @ given(zero), rtol=0, atol=1e-6 * np.abs(linear[row]).max())
        expected = reach @ by_force
        for found, size in ((compliance[row], expected), (np.linalg.inv(stiffness[row]), expected)):
            for rows in (slice(0, 3), slice(3, 6)):
                for columns in (slice(0, 3), slice(3, 6)):
                    scale = np.abs(size[rows, columns]).max()
                    np.testing.assert_allclose(found[rows, columns], size[rows, columns], rtol=0, atol=1e-5 * scale)


def all_names(model):
    """Names in files of every parameter of a robot: springs, compensator, masses."""
    springs = [f"k{n}" for n in range(1, 7)] + [parameter.name for parameter, _ in model.terms]
    return springs + [spring.name for spring in model.link_springs] + ["K_c", "s_0", "A2.mass", "A3.mass", "A6.mass"]


def step_of(name):
    """Step [SI] of differences by a parameter: torques change by some N·m, deflections by much more than rounding."""
    if name in ("K_c", "s_0", "size"):
        return 10.0
    if name.endswith(".mass"):
        return 0.02
    if "backlash" in name or "lost_motion" in name:
        return 1e-6
    return 1e-11 if name[-2] == "." and name[-1] in "XYZ" else 5e-10


@pytest.mark.parametrize(("seed", "gravity"), [(0, GRAVITIES[1]), *((7, gravity) for gravity in GRAVITIES)], ids=str)
def test_what_the_tool_moves_with_each_parameter_is_that_by_differences_of_the_oracle(seed, gravity):
    model, arm, q, wrench = arms(seed, gravity)
    q, wrench = q[:2], wrench[:2]
    x0 = elastostatics.coordinates(model, q).T
    held = balance.balanced_torque(model, x0)
    theta, _ = equilibrium.solve_equilibrium(model, x0, kinematics.components(FAR_OFFSET_TOOL), wrench.T)
    state = balance.Balance.at(model, x0 + theta, held, kinematics.components(FAR_OFFSET_TOOL), wrench.T)
    np.testing.assert_allclose(state.theta, theta, rtol=0, atol=2e-8)
    reach = state.spring_jacobian()
    for name in [*all_names(model), "size"]:
        parameter = robot.CompensatorSize() if name == "size" else parameters.parameter_of_name(name)
        found = balance.twists_by_parameters(state, reach, [parameter], x0)[..., 0]
        step = step_of(name)
        expected = np.array([arm.by_parameter(name, step, q[n], FAR_OFFSET_TOOL, wrench[n]) for n in range(len(q))])
        for rows in (slice(0, 3), slice(3, 6)):
            scale = np.abs(expected[:, rows]).max()
            rounding = 1e-13 / step
            np.testing.assert_allclose(
                found[:, rows], expected[:, rows], rtol=0, atol=2e-3 * scale + rounding, err_msg=name
            )


def straight(arm):
    """The arm whose gears deflect in proportion to their own torque, by their whole compliance, at every pose."""
    linear = arm.linear.copy()
    for function, row, _, value in arm.parts:
        linear[row] += value * (function in (whole_arm._fading, whole_arm._knee))
    return arm.but(linear=linear, parts=[], over_pose=[], couplings={})


def at_first_order(arm, q, tool, wrench):
    """Displacement (3,) under a small load and the payload: J (C⁻¹ + U_c″)⁻¹ τ, C the slopes of the springs at rest."""
    tcp, loaded, bare = arm.loads(tool)
    x = arm.held_by_motors(q)
    rest = -bare(x) if arm.rigid or arm.in_gears else 0.0 * x
    size = 1e-2  # N·m, N
    compliance = np.stack(
        [(arm.law(x, h, rest, h) - arm.law(x, -h, rest, -h)) / (2 * size) for h in size * np.eye(len(x))], axis=1
    )
    second, step = arm.rows[1], 1e-4
    at = x[second]
    stiffer = np.zeros((len(x), len(x)))
    stiffer[second, second] = (arm.compensator(at + step) - arm.compensator(at - step)) / (2 * step)
    jacobian = tcp(x)[1]
    theta = np.linalg.solve(
        np.eye(len(x)) + compliance @ stiffer, compliance @ (jacobian.T @ wrench - loaded(x) + bare(x))
    )
    return jacobian[:3] @ theta


@pytest.mark.parametrize(
    ("seed", "payload", "gravity"),
    [(0, NO_PAYLOAD, GRAVITIES[1]), (1, PAYLOAD, GRAVITIES[0]), (1, PAYLOAD, GRAVITIES[3])]
    + [(7, NO_PAYLOAD, gravity) for gravity in GRAVITIES],
    ids=str,
)
def test_sensitivity_of_the_bound_is_that_of_the_deflection_at_first_order(payload, seed, gravity):
    model, arm, q, wrench = arms(seed, gravity, payload)
    if payload is PAYLOAD:  # what it bends is no small load to gears that stiffen
        model, arm = replace(model, terms=()), straight(arm)
    names = all_names(model)
    model = replace(model, covariance=robot.Covariance.of(names, np.eye(len(names))))
    small = wrench * 1e-6  # torques of some mN·m: what gears that stiffen add to them is below the tolerance
    found = elastostatics.sensitivity(model, q, FAR_OFFSET_TOOL, small)
    order = [parameters.parameter_of_name(name) for name in names]
    found = found @ parameters.file_slopes(order, {each: model.value(each) for each in order})  # by linear values
    slope = np.zeros_like(found)
    for column, name in enumerate(names):
        step = step_of(name)
        for n in range(len(q)):
            one, other = (at_first_order(arm.changed(name, h), q[n], FAR_OFFSET_TOOL, small[n]) for h in (-step, step))
            slope[n, :, column] = (other - one) / (2 * step)
    usual = np.array([parameter.usual for parameter in order])
    scale = np.abs(slope).max(axis=(0, 1))
    felt = model.terms and (gravity.in_gears or gravity.reference == "rigid")
    counts = scale * usual > 1e-9 * (scale * usual).max()
    none = [name for name, each in zip(names, counts, strict=True) if not each and "backlash" not in name]
    assert none == ([] if felt else names[-3:])  # and backlash of gears that the weights press to one side
    rounding = 1e-7 * (scale * usual).max() / usual
    for column, name in enumerate(names):
        atol = 2e-3 * scale[column] + rounding[column]
        np.testing.assert_allclose(found[..., column], slope[..., column], rtol=0, atol=atol, err_msg=name)


@pytest.mark.parametrize("gravity", [GRAVITIES[0], GRAVITIES[2]], ids=str)
@pytest.mark.parametrize("row", range(3))
def test_softness_is_how_far_a_unit_of_force_or_moment_along_an_axis_moves_the_tip_at_most(row, gravity):
    model, arm, q, _ = arms(1, gravity)
    q = q[row]

    def away(load):
        loaded, rest = (arm.equilibrium(q, FAR_OFFSET_TOOL, wrench)[1][:3, 3] for wrench in (load, np.zeros(6)))
        return np.linalg.norm(loaded - rest)

    by_force, by_moment = elastostatics.largest_compliance(model, q, FAR_OFFSET_TOOL)
    moved = [away(unit) for unit in np.eye(6)]
    assert by_force == pytest.approx(max(moved[:3]), rel=1e-3)
    assert by_moment == pytest.approx(max(moved[3:]), rel=1e-2)


def test_the_tip_that_the_solver_returns_is_that_of_the_deflections_it_returns():
    model, _, q, wrench = arms(7, GRAVITIES[1])
    x0, tool = balance.elastic_coordinates(model, q.T), kinematics.components(FAR_OFFSET_TOOL)
    theta, tip = equilibrium.solve_equilibrium(model, x0, tool, wrench.T)
    reached = kinematics.posture(model.loaded, x0 + theta, tool).point
    np.testing.assert_allclose(tip, reached, rtol=0, atol=1e-13)
    again, _ = equilibrium.solve_equilibrium(model, x0, tool, wrench.T, guess=theta)
    np.testing.assert_allclose(again, theta, rtol=0, atol=1e-9)
    state = elastostatics.deflect(model, q, FAR_OFFSET_TOOL, wrench)
    np.testing.assert_allclose(state.pose[:, :3, 3].T, tip, rtol=0, atol=1e-12)


def test_errors_name_the_rows_that_have_no_equilibrium(monkeypatch):
    model, _, q, wrench = arms(0, GRAVITIES[0])
    heavy = wrench.copy()
    heavy[1] *= 100.0
    with pytest.raises(NotConvergedError, match="too large for the springs") as found:
        elastostatics.deflect(model, q, FAR_OFFSET_TOOL, heavy)
    assert found.value.rows == (1,)
    spoilt = wrench.copy()
    spoilt[2, 4] = np.nan
    with pytest.raises(
        NotConvergedError, match="not found: check the payload, the forces and the robot model"
    ) as found:
        elastostatics.deflect(model, q, FAR_OFFSET_TOOL, spoilt)
    assert found.value.rows == (2,)
    x = balance.elastic_coordinates(model, q.T)
    load = np.zeros_like(x)
    load[3, 1] = 1e6
    with pytest.raises(NotConvergedError, match="too large for the springs") as found:
        deflection_at_target(model, x, load, balance.static_torque(model, x))
    assert found.value.rows == (1,)
    monkeypatch.setattr(elastostatics.equilibrium, "MAX_ITERATIONS", 1)
    still = wrench * [[1.0], [0.0], [1.0]]
    model, _, q, _ = arms(0, GRAVITIES[0], payload=NO_PAYLOAD)
    with pytest.raises(NotConvergedError, match="not found") as found:
        elastostatics.deflect(model, q, FAR_OFFSET_TOOL, still)  # row 1 has no load: it does not move
    assert found.value.rows == (0, 2)
    load = np.zeros_like(x)
    load[3, [0, 2]] = 500.0
    with pytest.raises(NotConvergedError, match="not found") as found:
        deflection_at_target(model, x, load, balance.static_torque(model, x))
    assert found.value.rows == (0, 2)


def test_targets_out_of_reach_or_at_singular_poses_are_named():
    model, arm, q, wrench = arms(0, GRAVITIES[0])
    target = np.array([arm.nominal(row, FAR_OFFSET_TOOL) for row in q])
    target[1, :3, 3] += [0.0, 8.0, 0.0]
    with pytest.raises(NotConvergedError, match="no loaded equilibrium") as found:
        elastostatics.compensate(model, target, q, FAR_OFFSET_TOOL, wrench)
    assert found.value.rows == (1,)


def test_a_singular_pose_has_no_step_and_others_have_theirs():
    square = np.random.default_rng(3).normal(size=(6, 6, 3))
    square[:, 2, 1] = 0.0
    twist_of = np.ones((6, 3))
    step = equilibrium._newton_step(square, twist_of)
    assert np.isnan(step[:, 1]).all()
    for row in (0, 2):
        np.testing.assert_allclose(square[..., row] @ step[:, row], twist_of[:, row], rtol=1e-9)


@pytest.mark.parametrize("row", range(6))
def test_a_command_is_not_done_while_any_component_of_the_pose_is_off(row):
    most = equilibrium._AT_TARGET if row < 3 else equilibrium._ORIENTATION_TOLERANCE
    left = np.zeros((6, 3))
    left[row] = np.array([0.0, 0.999, 1.001]) * most
    assert equilibrium._exceeds_tolerance(left).tolist() == [False, False, True]


def test_links_that_hardly_deflect_do_not_end_the_search_before_the_tool_is_at_its_target():
    file = content(0, GRAVITIES[0])
    stiff = {"A2": LinkSprings(source="test", Y_um_per_N=1e-9), "A3": LinkSprings(source="test", RZ_urad_per_Nm=1e-9)}
    file = replace(file, links=stiff)
    model, arm = robot.assemble("stiff links", file, urdf.read(KUKA, "any.urdf")), WholeArm(KUKA, file)
    _, _, q, wrench = arms(0, GRAVITIES[0])
    target = np.array([arm.nominal(row, FAR_OFFSET_TOOL) for row in q])
    found = elastostatics.compensate(model, target, q, FAR_OFFSET_TOOL, wrench)
    for row in range(len(q)):
        np.testing.assert_allclose(
            arm.equilibrium(found.q[row], FAR_OFFSET_TOOL, wrench[row])[1], target[row], rtol=0, atol=2e-8
        )


@pytest.mark.parametrize("gravity", GRAVITIES[:2], ids=str)
def test_a_compensator_stiffer_than_its_joint_is_solved(gravity):
    """The gear alone would swing about the equilibrium, farther each round."""
    file = content(0, gravity)
    file = replace(
        file,
        joints=file.joints | {"A2": replace(file.joints["A2"], compliance_urad_per_Nm=8.0)},
        compensator=replace(file.compensator, stiffness_N_per_m=6e6),
    )
    model, arm = robot.assemble("stiff compensator", file, urdf.read(KUKA, "any.urdf")), WholeArm(KUKA, file)
    _, _, q, wrench = arms(0, gravity)
    x = balance.coordinates(model, q).T
    factor = balance.compensator_factor(model, x, np.repeat(model.constant_compliance[:, None], len(q), axis=1))
    assert (factor > 2.0).sum() == 2
    state = elastostatics.deflect(model, q, FAR_OFFSET_TOOL, wrench)
    target = np.array([arm.nominal(row, FAR_OFFSET_TOOL) for row in q])
    found = elastostatics.compensate(model, target, q, FAR_OFFSET_TOOL, wrench)
    for row in range(len(q)):
        theta, pose = arm.equilibrium(q[row], FAR_OFFSET_TOOL, wrench[row])
        np.testing.assert_allclose(state.theta[row], theta, rtol=0, atol=3e-9)  # rad, m
        np.testing.assert_allclose(state.pose[row], pose, rtol=0, atol=3e-9)
        np.testing.assert_allclose(
            arm.equilibrium(found.q[row], FAR_OFFSET_TOOL, wrench[row])[1], target[row], rtol=0, atol=2e-8
        )


@pytest.mark.parametrize(("seed", "most"), [(0, 4), (1, 4), (7, 4)])
def test_commands_converge_in_a_few_steps_to_the_last_digits(seed, most, monkeypatch):
    model, arm, q, wrench = arms(seed, GRAVITIES[1])
    target, rounds, solve = np.array([arm.nominal(row, FAR_OFFSET_TOOL) for row in q]), [], equilibrium._newton_step
    monkeypatch.setattr(equilibrium, "_newton_step", lambda *given: (rounds.append(1), solve(*given))[1])
    found = elastostatics.compensate(model, target, q, FAR_OFFSET_TOOL, wrench)
    assert len(rounds) <= most
    x = balance.elastic_coordinates(model, found.q.T) + found.theta.T
    reached = kinematics.tcp(model.loaded, x.T, FAR_OFFSET_TOOL)[0]
    np.testing.assert_allclose(reached, target, rtol=0, atol=2e-10)


def length_95(covariance):
    """Return what 95 % of normal vectors of a covariance are shorter than, by 400 000 of them in its principal axes."""
    return math.sqrt(np.quantile(squared_normals() @ np.linalg.eigvalsh(covariance), 0.95))


@cache
def squared_normals():
    """Return the squares (400 000, 3) of standard normal numbers."""
    return np.square(np.random.default_rng(5).standard_normal((400_000, 3)))


def test_the_length_bound_is_the_quantile_of_lengths_whatever_the_shape_of_the_covariance():
    turned = frames.rotation_from_vector(np.array([0.4, -1.0, 0.7]))
    shapes = [turned @ np.diag(np.square(sizes)) @ turned.T for sizes in ([1, 1, 1], [3, 1, 0.2], [0, 2, 2], [0, 0, 5])]
    found = elastostatics.uncertainty.length_bound(np.array([*shapes, np.zeros((3, 3))]))
    np.testing.assert_allclose(found[:4], [length_95(shape) for shape in shapes], rtol=0.02)
    assert found[4] == 0.0


def test_the_bound_adds_parameters_forces_tool_discrepancy_and_geometry_as_covariances():
    model, _, q, wrench = arms(0, GRAVITIES[0])
    model = replace(model, terms=())
    rng = np.random.default_rng(8)
    names = ["k1", "k2", "k5", "K_c", "A2.Y"]
    factor = rng.normal(size=(5, 5)) * np.array([0.1, 0.3, 0.1, 5e4, 2e-3])[:, None]
    spread = rng.normal(size=(3, 6, 4)) * 40.0
    half = rng.normal(size=(3, 6, 6)) * 2e-4
    series = half @ np.swapaxes(half, 1, 2)
    off = robot.model.Discrepancy(np.array([300.0, 1500.0]), np.array([1e-4, 4e-4]))
    everywhere = robot.GeometryError(3e-4, np.full(6, -np.inf), np.full(6, np.inf))
    nothing = robot.Covariance.of([], np.zeros((0, 0)))
    some = robot.Covariance.of(names, factor @ factor.T)
    bare = replace(model, covariance=nothing)
    sources = {
        "parameters": (replace(model, covariance=some), None, None),
        "forces": (bare, spread, None),
        "tool": (bare, spread, series),
        "discrepancy": (replace(bare, discrepancy=off), None, None),
        "geometry": (replace(bare, geometry_error=everywhere), None, None),
    }
    everything = (replace(model, covariance=some, discrepancy=off, geometry_error=everywhere), spread, series)
    sensitivity = elastostatics.sensitivity(sources["parameters"][0], q, FAR_OFFSET_TOOL, wrench)
    compliance = elastostatics.linear_compliance(model, q, FAR_OFFSET_TOOL, wrench)[:, :3]
    force = np.linalg.norm(wrench, axis=1)
    isotropic = 2.7954835**-2 * np.eye(3)
    by_parameters = np.einsum("nip,pr,njr->nij", sensitivity, factor @ factor.T, sensitivity)
    by_force = [np.einsum("nif,nfm->nim", part, spread) for part in (compliance, compliance + series[:, :3])]
    by_force = [np.einsum("nim,njm->nij", part, part) for part in by_force]
    level = np.interp(force, [300.0, 1500.0], [1e-4, 4e-4]) * np.maximum(force / 1500.0, 1.0)
    by_discrepancy, by_geometry = level[:, None, None] ** 2 * isotropic, 9e-8 * isotropic
    expected = {
        "parameters": by_parameters, "forces": by_force[0], "tool": by_force[1], "discrepancy": by_discrepancy,
        "geometry": np.tile(by_geometry, (3, 1, 1)),
    }  # fmt: skip

    def bound_of(arm, spread, series):
        return elastostatics.position_bound(arm, q, FAR_OFFSET_TOOL, wrench, force_spread=spread, in_series=series)

    for name, source in sources.items():
        found = bound_of(*source)
        np.testing.assert_allclose(found, [length_95(one) for one in expected[name]], rtol=0.02, err_msg=name)
    whole = by_parameters + by_force[1] + by_discrepancy + by_geometry
    found = bound_of(*everything)
    np.testing.assert_allclose(found, [length_95(one) for one in whole], rtol=0.02)


SOURCES = ("A3", "compensator", "forces", "discrepancy", "geometry", "lost motion")


@pytest.mark.parametrize("series", [None, 3e-4], ids=["rigid tool", "compliant tool"])
@pytest.mark.parametrize("name", SOURCES)
def test_the_bound_of_each_source_alone_is_that_of_its_covariance(name, series):
    model, _, q, wrench = arms(0, GRAVITIES[0])
    q, wrench = q[:1], wrench[:1]
    gears = [(term, value) for term, value in model.terms if isinstance(term, robot.LostMotion)]
    spread = np.random.default_rng(8).normal(size=(1, 6, 4)) * 40.0
    turning = np.ones((1, 6), dtype=bool)
    own = None if series is None else np.diag([series, 2 * series, 3 * series, 4 * series, series, series])[None] * 1e-2

    def given(size):
        """The model and the spread of the forces, with the standard deviations of each source times a factor."""
        about = np.diag([*[size["A3"]] * 2, size["compensator"]])
        matrix = about @ np.array([[0.04, 3.0, 0.0], [3.0, 900.0, 0.0], [0.0, 0.0, 9e8]]) @ about
        level = size["discrepancy"] * np.array([1e-4, 4e-4])
        changed = replace(
            model,
            covariance=robot.Covariance.of(["k3", "A3.mass", "K_c"], matrix),
            discrepancy=robot.model.Discrepancy(np.array([300.0, 1500.0]), level) if level.any() else None,
            geometry_error=robot.GeometryError(3e-4 * size["geometry"], np.full(6, -np.inf), np.full(6, np.inf)),
            terms=tuple((term, value * size["lost motion"]) for term, value in gears),
        )
        return changed, spread * size["forces"]

    def bound(size):
        changed, forces = given(size)
        return elastostatics.position_bound(
            changed, q, FAR_OFFSET_TOOL, wrench, force_spread=forces, in_series=own, changes_flank=turning
        )[0]

    nothing = dict.fromkeys(SOURCES, 0.0)
    changed, forces = given(nothing | {name: 1.0})
    reach = kinematics.tcp(changed.loaded, elastostatics.coordinates(changed, q), FAR_OFFSET_TOOL)[1][0, :3]
    flanks = np.array([value * reach[:, changed.row(term)] for term, value in changed.terms])
    covariance = flanks.T @ flanks
    if name in ("A3", "compensator"):
        by_parameter = elastostatics.sensitivity(changed, q, FAR_OFFSET_TOOL, wrench)[0]
        covariance = by_parameter @ changed.covariance.matrix @ by_parameter.T
    if name == "forces":
        compliance = elastostatics.linear_compliance(changed, q, FAR_OFFSET_TOOL, wrench)[0] + (
            0.0 if own is None else own[0]
        )
        covariance = compliance[:3] @ forces[0] @ forces[0].T @ compliance[:3].T
    if name in ("discrepancy", "geometry"):
        force = np.linalg.norm(wrench)
        level = np.interp(force, [300.0, 1500.0], [1e-4, 4e-4]) * max(force / 1500.0, 1.0)
        covariance = ((3e-4 if name == "geometry" else level) / 2.7954835) ** 2 * np.eye(3)
    assert bound(nothing | {name: 1.0}) == pytest.approx(length_bound(covariance), rel=1e-9)


def length_bound(covariance):
    return elastostatics.uncertainty.length_bound(covariance[None])[0]


@STATES
def test_the_bound_counts_the_flanks_of_gears_by_how_far_their_torque_is_from_turning_over(gravity):
    model, arm, q, wrench = arms(0, gravity, NO_PAYLOAD)
    wrench *= 0.05  # torques that are near to turning gears over
    turning = np.zeros((3, 6), dtype=bool)
    turning[1, [0, 4]] = True
    model = replace(model, covariance=robot.Covariance.of([], np.zeros((0, 0))))
    found = elastostatics.position_bound(model, q, FAR_OFFSET_TOOL, wrench, changes_flank=turning)
    expected = []
    for n in range(3):
        tcp, loaded, bare = arm.loads(FAR_OFFSET_TOOL)
        x = arm.held_by_motors(q[n])
        jacobian, rest = tcp(x)[1], 0.0 * x if arm.rigid else bare(x)
        torque = jacobian.T @ wrench[n] - loaded(x) + rest
        by_load = torque + bare(x) if arm.rigid else torque
        pressed = torque - rest if arm.in_gears else torque
        covariance = np.zeros((3, 3))
        for function, row, scale, value in arm.parts:
            if function in (whole_arm._backlash, None):
                share = 1.0 - np.tanh((by_load if function is None else pressed)[row] / scale) ** 2
                reach = jacobian[:3, row]
                covariance += value**2 * (1.0 if turning[n, arm.rows.index(row)] else share) * np.outer(reach, reach)
        expected.append(length_95(covariance))
    np.testing.assert_allclose(found, expected, rtol=0.02)


def test_sensitivity_without_parameters_is_empty_and_with_a_spring_that_is_none_an_error():
    model, _, q, wrench = arms(0, GRAVITIES[0])
    assert elastostatics.sensitivity(replace(model, covariance=None), q, FAR_OFFSET_TOOL, wrench).shape == (3, 3, 0)
    slack = replace(
        model, compensator=replace(model.compensator, stiffness=0.0), covariance=robot.Covariance.of(["s_0"], np.eye(1))
    )
    with pytest.raises(ModelError, match="no spring"):
        elastostatics.sensitivity(slack, q, FAR_OFFSET_TOOL, wrench)


def test_a_parameter_that_the_robot_does_not_have_is_an_error():
    model, _, q, wrench = arms(0, GRAVITIES[0])
    x = balance.elastic_coordinates(model, q.T)
    state = balance.Balance.at(
        model, x, balance.balanced_torque(model, x), kinematics.components(FAR_OFFSET_TOOL), wrench.T
    )
    for lacks, name in ((replace(state, robot=replace(model, compensator=None)), "K_c"), (state, "A4.X")):
        with pytest.raises(ModelError, match="which the model does not have"):
            balance.twists_by_parameters(lacks, state.spring_jacobian(), [parameters.parameter_of_name(name)], x)


@pytest.mark.parametrize("compliance", [20.0, 30.0, 40.0])
def test_a_soft_arm_is_solved_as_exactly_as_a_stiff_one(compliance):
    """Each round of its equilibrium gains a digit only: how many are needed is foreseen from the last two steps."""
    joints = {name: JointSpring(source="test", compliance_urad_per_Nm=compliance) for name in robot.JOINTS}
    file = replace(content(0, GRAVITIES[0]), joints=joints, compensator=None, links={})
    model, arm = robot.assemble("soft", file, urdf.read(KUKA, "soft.urdf")), WholeArm(KUKA, file)
    _, _, q, wrench = arms(0, GRAVITIES[0])
    wrench *= 0.3
    theta = elastostatics.deflect(model, q, FAR_OFFSET_TOOL, wrench).theta
    expected = np.array([arm.equilibrium(q[row], FAR_OFFSET_TOOL, wrench[row])[0] for row in range(len(q))])
    np.testing.assert_allclose(theta, expected, rtol=0, atol=5e-10)  # rad; deflections of 10 to 20 mrad
    x = (elastostatics.coordinates(model, q) + expected).T
    there = kinematics.posture(model.loaded, x, kinematics.components(FAR_OFFSET_TOOL), weigh=True)
    load = np.einsum("ikn,ni->kn", there.jacobian(), wrench)
    springs = deflection_at_target(model, x, load, balance.static_torque(model, x, there))
    np.testing.assert_allclose(springs.T, expected, rtol=0, atol=3e-9)
