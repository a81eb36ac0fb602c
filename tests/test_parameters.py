"""Typed parameters of the elastic model: names, files, and a new kind that nothing else has to know of."""

import shutil

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from postproc import elastostatics, robot
from postproc.compensator import Compensator
from postproc.errors import ModelError
from postproc.identification.fit import gauss_newton, to_file_units
from postproc.identification.measurement_model import Structure, measured_displacements, predict
from postproc.robot import parameters
from samples.paper_study import harness, simulator
from tests.kr270 import CONTENT, FOLDER, ROBOT, SIDE_TOOL
from tests.test_flexible_links import cases, flexible

JOINT = st.sampled_from(robot.JOINTS)
ANY = st.one_of(
    st.builds(robot.JointCompliance, JOINT),
    st.builds(robot.FadingPart, JOINT, st.floats(0.01, 1e6).map(lambda value: float(f"{value:.2g}"))),
    st.builds(robot.Knee, JOINT, st.floats(0.01, 1e6).map(lambda value: float(f"{value:.2g}"))),
    st.builds(robot.Backlash, JOINT, st.floats(0.01, 1e6).map(lambda value: float(f"{value:.2g}"))),
    st.builds(robot.LostMotion, JOINT, st.floats(0.01, 1e6).map(lambda value: float(f"{value:.2g}"))),
    st.sampled_from([robot.GearCoupling(*pair) for pair in (("A4", "A5"), ("A4", "A6"), ("A5", "A6"))]),
    st.builds(robot.PoseWave, JOINT, st.tuples(*[st.integers(-9, 9)] * 6).filter(any), st.sampled_from(("cos", "sin"))),
    st.builds(robot.LinkSpring, st.sampled_from(("base", *robot.JOINTS)), st.sampled_from(robot.LINK_AXES)),
    st.sampled_from(robot.COMPENSATOR),
    st.builds(robot.LinkMass, JOINT),
)


@given(ANY)
def test_a_name_in_a_file_is_read_as_the_parameter_that_wrote_it(parameter):
    assert parameters.parameter_of_name(parameter.name) == parameter


@pytest.mark.parametrize(
    "name",
    [
        "",
        "k",
        "k0",
        "k7",
        "k1@",
        "k1@x",
        "A7.X",
        "A2.",
        "A2.end_X",
        "K_c*s_0",
        "k2#1",
        "A7.mass",
        "A2",
        "k54",
        "k44",
        "k3.cos()",
        "k3.cos(+A2)",
        "k3.tan(A2)",
        "k3.cos(A3A2)",
        "k3.cos(A2+A2)",
    ],
)
def test_no_other_name_is_read(name):
    assert parameters.parameter_of_name(name) is None


@pytest.mark.parametrize(
    "kind",
    [
        robot.JointCompliance("A3"),
        robot.FadingPart("A3", 90.0),
        robot.Knee("A3", 90.0),
        robot.Backlash("A3", 20.0),
        robot.LostMotion("A3", 20.0),
        robot.LinkSpring("A3", "RX"),
        robot.GearCoupling("A4", "A6"),
        robot.PoseWave("A3", (0, 1, -1, 0, 0, 0), "sin"),
    ],
)
def test_slope_of_a_spring_is_the_derivative_of_its_deflection(kind):
    torque, rest, h = np.linspace(-300.0, 300.0, 41), np.linspace(-80.0, 200.0, 41), 1e-3
    _, slope = kind.effect(torque, rest)
    difference = (kind.effect(torque + h, rest)[0] - kind.effect(torque - h, rest)[0]) / (2 * h)
    np.testing.assert_allclose(slope, difference, rtol=1e-7, atol=1e-11 * np.abs(slope).max())
    np.testing.assert_array_equal(kind.effect(0.0 * torque, rest)[0], 0.0)


def test_torques_of_the_compensator_add_up_to_its_law():
    law, q2 = Compensator(1.3e5, 0.47, 0.185, 0.686, 0.123), np.radians(np.linspace(-146.0, 20.0, 30))
    sizes = (law.stiffness, law.stiffness * law.free_length)
    for index, whole in enumerate((law.gradient(q2), law.stiffness_about_joint(q2))):
        found = sum(size * kind.effect(law, q2)[index] for size, kind in zip(sizes, robot.COMPENSATOR, strict=True))
        np.testing.assert_allclose(found, whole, atol=1e-12 * np.abs(whole).max())


def test_a_model_file_comes_back_from_the_parameters_of_its_robot():
    masses = msgspec.structs.replace(CONTENT.masses, A3_kg=180.0)
    content = msgspec.structs.replace(CONTENT, links=flexible_links(), masses=masses)
    model = robot.assemble("x", content, ROBOT.nominal)
    stated = parameters.stated_values(content)
    for parameter, value in stated.items():
        assert model.value(parameter) == pytest.approx(value, rel=1e-12)
    tables = {"joints": {}, "links": {}, "compensator": {}, "masses": {}}
    for parameter in stated:
        parameter.write(tables, parameter.file_value(stated)[0], 0.0, "test")
    assert tables["joints"]["A1"]["compliance_urad_per_Nm"] == pytest.approx(0.623)
    assert tables["links"]["A2"] == pytest.approx({"source": "test", "X_um_per_N": 0.02, "end_RY_urad_per_Nm": 0.1})
    assert tables["compensator"]["free_length_mm"] == pytest.approx(content.compensator.free_length_mm)
    assert tables["masses"] == {"A3_kg": 180.0}


def flexible_links():
    return {"A2": robot.LinkSprings(source="test", X_um_per_N=0.02, end_RY_urad_per_Nm=0.1)}


def test_slopes_in_files_are_those_by_finite_differences():
    model = flexible()
    order = [parameters.parameter_of_name(name) for name in ("k1", "k1@500", "k1@100", "K_c", "s_0", "A2.RX")]
    at = {parameter: model.value(parameter) for parameter in order}
    slopes = parameters.file_slopes(order, at)
    for column, parameter in enumerate(order):
        h = 1e-4 * at[parameter]
        more, less = ({**at, parameter: at[parameter] + sign * h} for sign in (1, -1))
        difference = [(p.file_value(more)[0] - p.file_value(less)[0]) / (2 * h) for p in order]
        np.testing.assert_allclose(slopes[:, column], difference, rtol=1e-6, atol=1e-12)


class Play(robot.Spring, frozen=True):
    """A kind that the package does not have: play of a joint, taken up as the torque passes 20 N·m."""

    joint: str
    linear = False
    sparse = True

    @property
    def name(self):
        return f"play_{self.joint}"

    @classmethod
    def from_name(cls, name):
        return next((cls(joint) for joint in robot.JOINTS if name == cls(joint).name), None)

    @classmethod
    def from_file(cls, content):  # model.toml has no key for it yet
        return iter(())

    def write(self, tables, value, half, source):
        raise NotImplementedError

    def effect(self, torque, rest):
        there, here = np.tanh((torque + rest) / 20.0), np.tanh(rest / 20.0)
        return there - here, (1.0 - there**2) / 20.0


def test_a_new_kind_is_one_class(tmp_path, monkeypatch):
    """Equilibrium, derivative, fit, values in files and bound take it as it is."""
    monkeypatch.setattr(parameters, "KINDS", (*parameters.KINDS, Play))
    play = parameters.parameter_of_name("play_A4")
    true = ROBOT.with_values({play: 200e-6, robot.JointCompliance("A3"): 0.5e-6})
    rng = np.random.default_rng(3)
    q, f = simulator.plan(rng, 12)
    data = harness.load(simulator.write(tmp_path, q, f, rng.normal(size=(12, 2, 3, 3, 3))))
    structure = Structure((*robot.JOINT_COMPLIANCES, play), ROBOT)
    placement = harness.placed(ROBOT, data)
    values = np.array([true.value(parameter) for parameter in structure.parameters])
    moved, slopes = predict(structure, values, data, placement)
    h = 1e-6
    plus, minus = (predict(structure, values + s * h * np.eye(7)[6], data, placement)[0] for s in (1, -1))
    np.testing.assert_allclose(slopes[..., 6], (plus - minus) / (2 * h), atol=1e-4 * np.abs(slopes[..., 6]).max())

    exact = replace(data, position=placed_readings(data, moved))
    np.testing.assert_allclose(measured_displacements(exact, placement), moved, atol=1e-12)
    fit = gauss_newton(structure, exact, placement)
    np.testing.assert_allclose(fit.values, values, rtol=1e-4)
    found, in_file, covariance = to_file_units(fit)
    assert found[6] == play
    assert in_file[6] == pytest.approx(200.0, rel=1e-4)
    job, wrench = cases(force=300.0)
    model = replace(fit.robot, covariance=robot.Covariance(found, covariance))
    without = replace(fit.robot, covariance=robot.Covariance(found[:6], covariance[:6, :6]))
    bound, less = (elastostatics.position_bound(each, job, SIDE_TOOL, wrench) for each in (model, without))
    assert np.all(bound > 0)
    assert not np.allclose(bound, less, rtol=1e-3)


def placed_readings(data, moved):
    """Readings that show displacements (L, P, 3) exactly, the unloaded ones at the origin."""
    position = np.zeros_like(data.position)
    for row, state in enumerate(data.loaded_states):
        mine = data.state == state
        position[mine] = moved[row, data.point[mine]]
    return position


@pytest.mark.parametrize(
    ("matrix", "is_valid"),
    [
        ([[2.0], [1.0, 2.0]], True),
        ([[1.0], [1.0, 1.0]], True),  # known in their sum alone
        ([[1.0], [2.0, 1.0]], False),  # correlated by more than 1
        ([[1.0], [0.0, -1.0]], False),
        ([[1.0, 0.5], [0.1, 1.0]], False),
    ],
)
def test_a_covariance_that_none_can_be_is_refused(tmp_path, matrix, is_valid):
    shutil.copytree(FOLDER, tmp_path / "arm")
    with (tmp_path / "arm" / "model.toml").open("a", encoding="utf-8") as file:
        file.write(f'\n[covariance]\nparameters = ["k2", "k3"]\nmatrix = {matrix}\n')
    if is_valid:
        assert robot.load(tmp_path / "arm").covariance is not None
        return
    with pytest.raises(ModelError, match="not symmetric positive semidefinite"):
        robot.load(tmp_path / "arm")


def test_the_size_of_the_compensator_moves_its_torque_at_a_constant_free_length():
    """Derivatives of the energy of a spring of 1 N/m, by differences."""
    law = Compensator(stiffness=1.2e5, free_length=0.458, L=0.18472, ax=0.68593, ay=0.1233)
    q2, h = np.linspace(-2.3, 0.3, 14), 1e-4
    low, middle, high = (replace(law, stiffness=1.0).energy(q2 + shift) for shift in (-h, 0.0, h))
    gradient, stiffness = robot.CompensatorSize().effect(law, q2)
    np.testing.assert_allclose(gradient, (high - low) / (2 * h), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(stiffness, (high - 2 * middle + low) / h**2, rtol=1e-5, atol=1e-6)
