"""Springs of links and gears that stiffen: the folder, the equilibrium forward and inverse, the bound u95."""

import re

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics, kinematics, robot
from postproc.elastostatics import balance
from postproc.elastostatics.equilibrium import deflection_at_target
from postproc.errors import ModelError
from postproc.robot import parameters
from postproc.robot.model_file import Gravity, Stiffening
from tests.kr270 import CONTENT, FOLDER, ROBOT, SIDE_TOOL

PARAMETERS = ["k1", "k2", "k1@500", "K_c", "s_0", "A2.RX", "A5.Z"]


def flexible(translation=0.02, rotation=0.1, **changes):
    links = {
        link: robot.LinkSprings(
            source="test",
            **{f"{a}_um_per_N": translation for a in "XYZ"},
            **{f"{a}_urad_per_Nm": rotation for a in robot.LINK_AXES[3:]},
        )
        for link in ("base", *robot.JOINTS)
    }
    joints = {
        name: msgspec.structs.replace(spring, stiffening=[Stiffening(500.0, 0.1), Stiffening(100.0, 0.05)])
        for name, spring in CONTENT.joints.items()
    }
    content = msgspec.structs.replace(CONTENT, **({"links": links, "joints": joints} | changes))
    return robot.assemble("flexible", content, ROBOT.nominal)


def cases(count=20, force=2000.0):
    rng = np.random.default_rng(0)
    q = np.radians([0, -70, 90, 10, 40, 20]) + rng.uniform(-0.4, 0.4, (count, 6))
    return q, np.c_[rng.uniform(-force, force, (count, 3)), rng.uniform(-0.05, 0.05, (count, 3)) * force]


def test_links_that_hardly_bend_change_nothing():
    q, wrench = cases()
    stiff = flexible(1e-9, 1e-9, joints=CONTENT.joints)
    assert stiff.actual.nv == 6 + 7 * 9
    for function in (elastostatics.deflect, elastostatics.linear_deflection):
        one, other = function(stiff, q, SIDE_TOOL, wrench), function(ROBOT, q, SIDE_TOOL, wrench)
        if function is elastostatics.deflect:
            one, other = one.twist, other.twist
        np.testing.assert_allclose(one, other, atol=2e-8)


@pytest.mark.parametrize("in_gears", [False, True])
@pytest.mark.parametrize("reference", ["calibrated", "rigid"])
def test_inverse_and_compensation_undo_the_deflection(in_gears, reference):
    model = flexible(gravity=Gravity(reference, in_gears))
    q, wrench = cases()
    found = elastostatics.deflect(model, q, SIDE_TOOL, wrench)
    x = (elastostatics.coordinates(model, q) + found.theta).T
    stands = kinematics.posture(model.loaded, x, kinematics.components(SIDE_TOOL), weigh=True)
    load = np.einsum("ikn,ni->kn", stands.jacobian(), wrench)
    theta = deflection_at_target(model, x, load, balance.static_torque(model, x, stands))
    np.testing.assert_allclose(theta, found.theta.T, atol=2e-8)
    target = kinematics.tcp(model.nominal, q, SIDE_TOOL)[0]
    command = elastostatics.compensate(model, target, q, SIDE_TOOL, wrench)
    reached = elastostatics.deflect(model, command.q, SIDE_TOOL, wrench).pose
    np.testing.assert_allclose(reached, target, atol=1e-7)


def test_tangent_compliance_is_the_derivative_of_the_equilibrium():
    model = flexible()
    q, _ = cases(3)
    small = np.eye(6) * 0.5
    for column in range(6):
        wrench = np.repeat(small[None, column], 3, axis=0)
        plus, minus = (elastostatics.deflect(model, q, SIDE_TOOL, sign * wrench).twist for sign in (1, -1))
        tangent = elastostatics.tangent_compliance(model, q, SIDE_TOOL, 0 * wrench)[:, :, column]
        np.testing.assert_allclose(plus - minus, tangent, rtol=1e-3, atol=1e-8)


STATES = pytest.mark.parametrize(
    "gravity", [Gravity(r, g) for r in ("calibrated", "rigid") for g in (False, True)], ids=str
)


def newton_step(model, q, wrench):
    """First Newton step to θ = c(τ(θ)) from θ = 0, the derivative by central differences; τ written down anew."""
    x0 = elastostatics.coordinates(model, q)
    second = model.actuated[1]

    def held(robot, x):
        torque = kinematics.gravity_torque(robot, x)
        torque[:, second] += model.compensator.gradient(x[:, second])
        return torque

    rest = held(model.actual, x0)
    feels = -rest if model.subtract_reference and model.carries_weight else 0.0 * rest

    def given(theta):
        _, jacobian = kinematics.tcp(model.loaded, x0 + theta, SIDE_TOOL)
        torque = np.einsum("nij,ni->nj", jacobian, wrench) - held(model.loaded, x0 + theta)
        return balance.spring_deflection(model, (x0 + theta).T, (torque + rest * model.subtract_reference).T, feels.T)[
            0
        ].T

    h, size = 1e-5, x0.shape[1]
    slope = np.stack([(given(h * e) - given(-h * e)) / (2 * h) for e in np.eye(size)], axis=2)
    _, jacobian = kinematics.tcp(model.loaded, x0, SIDE_TOOL)
    step = np.linalg.solve(np.eye(size) - slope, given(np.zeros_like(x0))[:, :, None])
    return (jacobian @ step)[..., 0]


@STATES
def test_linear_deflection_is_the_first_newton_step_by_finite_differences(gravity):
    model = flexible(gravity=gravity).with_payload(40.0, [0.1, 0.0, 0.2])
    q, wrench = cases(5)
    expected = newton_step(model, q, wrench)
    linear = elastostatics.linear_deflection(model, q, SIDE_TOOL, wrench)
    np.testing.assert_allclose(linear, expected, atol=1e-7 * np.abs(expected).max())


@STATES
def test_linear_deflection_is_that_of_the_solver_but_for_the_load_stiffness(gravity):
    """They differ by C·H of load and weights; the tangent alone would be off by a fifth."""
    model = flexible(gravity=gravity).with_payload(40.0, [0.1, 0.0, 0.2])
    q, wrench = cases()
    nonlinear = elastostatics.deflect(model, q, SIDE_TOOL, wrench).twist[:, :3]
    linear = elastostatics.linear_deflection(model, q, SIDE_TOOL, wrench)[:, :3]
    assert np.all(np.linalg.norm(linear - nonlinear, axis=1) < 0.01 * np.linalg.norm(nonlinear, axis=1))


def test_linear_deflection_of_stiffening_gears_meets_the_equilibrium_with_the_square_of_the_load():
    model = flexible()
    q, wrench = cases(force=1000.0)
    gap = []
    for size in (1.0, 2.0):
        found = elastostatics.deflect(model, q, SIDE_TOOL, size * wrench).twist[:, :3]
        linear = elastostatics.linear_deflection(model, q, SIDE_TOOL, size * wrench)[:, :3]
        gap.append(np.linalg.norm(linear - found, axis=1) / np.linalg.norm(found, axis=1))
    assert np.median(gap[0]) < 2e-3  # the tangent compliance under the load times the load: 0.03
    assert np.median(gap[1] / gap[0]) == pytest.approx(2.0, abs=0.3)


def test_gears_grow_stiffer_with_load_and_never_softer():
    model = flexible()
    torque = np.linspace(0.0, 5000.0, 200)[:, None] * np.ones(model.actual.nv)
    theta, slope = (
        each.T for each in balance.spring_deflection(model, 0.0 * torque.T, torque.T, np.zeros_like(torque.T))
    )
    row = model.actuated[0]
    assert np.all(np.diff(slope[:, row]) < 0)
    assert np.all(slope[:, row] > 0)
    np.testing.assert_allclose(np.gradient(theta[:, row], torque[:, 0])[1:-1], slope[1:-1, row], rtol=1e-2)


def test_sensitivity_of_the_bound_is_that_of_the_deflection():
    """Central differences in each parameter, at small load, where first order is exact to a per cent."""
    covariance = robot.Covariance.of(PARAMETERS, np.eye(len(PARAMETERS)))
    model = replace(flexible(), covariance=covariance)
    q, wrench = cases(force=100.0)
    slopes = elastostatics.sensitivity(model, q, SIDE_TOOL, wrench)

    def joint(name, step, part=0.0):
        old = flexible_content().joints[name]
        parts = [Stiffening(500.0, 0.1 + part), Stiffening(100.0, 0.05)]
        new = msgspec.structs.replace(old, compliance_urad_per_Nm=old.compliance_urad_per_Nm + step, stiffening=parts)
        return {"joints": {**flexible_content().joints, name: new}}

    def link(name, key, step):
        old = flexible_content().links[name]
        return {
            "links": {**flexible_content().links, name: msgspec.structs.replace(old, **{key: getattr(old, key) + step})}
        }

    def spring(key, step):
        old = CONTENT.compensator
        return {"compensator": msgspec.structs.replace(old, **{key: getattr(old, key) + step})}

    steps = {
        "k1": (1e-2, lambda h: joint("A1", h)),
        "k2": (1e-2, lambda h: joint("A2", h)),
        "k1@500": (1e-2, lambda h: joint("A1", 0.0, h)),
        "K_c": (1e5, lambda h: spring("stiffness_N_per_m", h)),
        "s_0": (50.0, lambda h: spring("free_length_mm", h)),
        "A2.RX": (1e-2, lambda h: link("A2", "RX_urad_per_Nm", h)),
        "A5.Z": (1e-3, lambda h: link("A5", "Z_um_per_N", h)),
    }  # fmt: skip
    for index, name in enumerate(PARAMETERS):
        h, change = steps[name]
        plus, minus = (
            elastostatics.deflect(flexible(**change(sign * h)), q, SIDE_TOOL, wrench).twist[:, :3] for sign in (1, -1)
        )
        slope = (plus - minus) / (2 * h)
        np.testing.assert_allclose(slopes[:, :, index], slope, atol=3e-2 * np.abs(slope).max(), err_msg=name)


@pytest.mark.parametrize("gravity", [Gravity("calibrated", in_gears=True), Gravity("rigid"), Gravity()])
def test_bound_counts_masses_and_compensator_where_gears_feel_them_at_rest(gravity):
    """Central differences of what the load does, in masses that press on the gears before it."""
    names = ["A2.mass", "A3.mass", "A6.mass", "K_c"]
    model = replace(flexible(gravity=gravity), covariance=robot.Covariance.of(names, np.eye(4)))
    q, wrench = cases(force=100.0)
    slopes = elastostatics.sensitivity(model, q, SIDE_TOOL, wrench)
    felt = gravity != Gravity()
    assert (np.abs(slopes[:, :, :3]).max() > 1e-8) == felt
    if not felt:
        return
    values = [model.value(parameters.parameter_of_name(name)) for name in names]
    for index, value in enumerate(values):
        h = 0.02 * value
        kind = robot.CompensatorSize() if names[index] == "K_c" else parameters.parameter_of_name(names[index])
        one, other = (by_load(model.with_values({kind: value + sign * h}), q, wrench) for sign in (1, -1))
        slope = (one - other) / (2 * h)
        np.testing.assert_allclose(slopes[:, :, index], slope, atol=0.1 * np.abs(slope).max(), err_msg=names[index])


def by_load(model, q, wrench):
    there, here = (elastostatics.deflect(model, q, SIDE_TOOL, share * wrench).pose for share in (1.0, 0.0))
    return (there - here)[:, :3, 3]


def flexible_content():
    links = {
        link: robot.LinkSprings(
            source="test",
            **{f"{a}_um_per_N": 0.02 for a in "XYZ"},
            **{f"{a}_urad_per_Nm": 0.1 for a in robot.LINK_AXES[3:]},
        )
        for link in ("base", *robot.JOINTS)
    }
    return msgspec.structs.replace(CONTENT, links=links)


def test_95_percent_of_random_parameters_stay_within_the_bound():
    rng = np.random.default_rng(1)
    spread = 0.05
    names = ["k1", "k2", "k3", "k4", "k5", "k6"]
    values = np.array([CONTENT.joints[j].compliance_urad_per_Nm for j in robot.JOINTS])
    model = replace(ROBOT, covariance=robot.Covariance.of(names, np.diag((spread * values) ** 2)))
    q, wrench = cases(30, 600.0)
    bound = elastostatics.position_bound(model, q, SIDE_TOOL, wrench)
    nominal = elastostatics.deflect(model, q, SIDE_TOOL, wrench).twist[:, :3]
    inside = []
    for _ in range(200):
        drawn = values * (1 + spread * rng.normal(size=6))
        other = replace(model, stiffness=np.diag(1e6 / drawn))
        error = elastostatics.deflect(other, q, SIDE_TOOL, wrench).twist[:, :3] - nominal
        inside.append(np.linalg.norm(error, axis=1) <= bound)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)
    assert elastostatics.position_bound(replace(ROBOT, covariance=None), q, SIDE_TOOL, wrench) is None


@pytest.mark.parametrize("name", ["k9", "A2.RQ", "k2@x", "K_theta2_0", "A2.RX"])  # A2.RX: the robot has no such spring
def test_covariance_that_names_what_the_model_does_not_have_is_refused(tmp_path, name):
    (tmp_path / "robot.urdf").write_bytes((FOLDER / "robot.urdf").read_bytes())
    text = (FOLDER / "model.toml").read_text(encoding="utf-8")
    table = f'\n[covariance]\nparameters = ["{name}"]\nmatrix = [[1.0]]\n'
    (tmp_path / "model.toml").write_text(text + table, encoding="utf-8")
    with pytest.raises(ModelError, match=re.escape(name)):
        robot.load(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('\n[links.A9]\nsource = "x"\nX_um_per_N = 0.1\n', "unknown joint 'A9'"),
        ('\n[links.A2]\nsource = "x"\nXX_um_per_N = 0.1\n', "unknown key 'XX_um_per_N'"),
        ('\n[links.A2]\nsource = "x"\nX_um_per_N = -0.1\n', "X_um_per_N"),
    ],
)
def test_wrong_link_entries_are_named(tmp_path, text, message):
    (tmp_path / "robot.urdf").write_bytes((FOLDER / "robot.urdf").read_bytes())
    (tmp_path / "model.toml").write_text((FOLDER / "model.toml").read_text(encoding="utf-8") + text, encoding="utf-8")
    with pytest.raises(ModelError, match=message):
        robot.load(tmp_path)


def test_stiffening_beyond_the_whole_compliance_is_refused(tmp_path):
    text = (FOLDER / "model.toml").read_text(encoding="utf-8")
    parts = "compliance_urad_per_Nm = 0.623\nstiffening = [{ torque_Nm = 500.0, compliance_urad_per_Nm = 0.7 }]"
    (tmp_path / "robot.urdf").write_bytes((FOLDER / "robot.urdf").read_bytes())
    (tmp_path / "model.toml").write_text(text.replace("compliance_urad_per_Nm = 0.623", parts), encoding="utf-8")
    with pytest.raises(ModelError, match="sum of the stiffening parts exceeds the compliance"):
        robot.load(tmp_path)
