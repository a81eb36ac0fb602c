"""A robot with all kinds of terms: bounds of its errors, and what its methods change and leave alone."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import frames, robot
from postproc.errors import ModelError
from postproc.robot import parameters
from postproc.robot.model import Discrepancy, OverPose
from postproc.robot.model_file import Displacement, Masses, ModelFile, PayloadEntry
from tests import test_all_terms
from tests.kr270 import CONTENT, ROBOT


@pytest.fixture(scope="module")
def content() -> ModelFile:
    return test_all_terms.content(3, test_all_terms.GRAVITIES[0])


@pytest.fixture(scope="module")
def model(content):
    return robot.assemble("all", content, ROBOT.nominal)


def assembled(**changes) -> robot.RobotModel:
    return robot.assemble("arm", replace(CONTENT, **changes), ROBOT.nominal)


def test_discrepancy_is_constant_below_the_measured_loads_linear_between_and_in_proportion_above():
    law = Discrepancy(np.array([300.0, 500.0, 1500.0]), np.array([1e-4, 2e-4, 6e-4]))
    wrench = np.zeros((7, 6))
    wrench[1:, 0] = [3e-3, 180.0, -300.0, 240.0, 600.0, -1800.0]
    wrench[1:, 5] = [4e-3, 240.0, 0.0, -320.0, 800.0, 2400.0]  # loads of 0, 0.005, 300, 300, 400, 1000 and 3000
    np.testing.assert_allclose(law.at(wrench), [0.0, 1e-4, 1e-4, 1e-4, 1.5e-4, 4e-4, 12e-4], rtol=1e-12)


def test_beyond_the_measured_angles_the_error_of_the_geometry_grows_as_that_of_a_line_through_even_readings():
    """The reference is the variance of a least-squares line, its mean inside taken as the square of the bound."""
    readings = np.linspace(-0.4, 0.6, 2001)
    design = np.stack([np.ones_like(readings), readings], axis=1)
    places = np.array([0.0, 0.59, 0.61, 0.8, 1.6, -1.4])
    reached = np.stack([np.ones_like(places), places], axis=1)
    variance = np.einsum("ni,ij,nj->n", reached, np.linalg.inv(design.T @ design), reached) * len(readings)
    error = robot.GeometryError(2e-4, np.full(6, -0.4), np.full(6, 0.6))
    q = np.zeros((6, 6))
    q[:, 2] = places
    growth = (error.at(q) / 2e-4) ** 2
    np.testing.assert_array_equal(growth[:2], 1.0)
    at_end = 4.0  # in units of the variance of the mean of the readings, of which the mean inside is 2
    np.testing.assert_allclose(growth[2:], 1.0 + (variance[2:] - at_end) / 2.0, rtol=2e-3)
    both = np.array([0.8, 0.0, 0.8, 0.0, 0.0, 0.0])[None]
    alone = (error.at(q[3:4]) / 2e-4) ** 2
    np.testing.assert_allclose((error.at(both) / 2e-4) ** 2 - 1.0, 2.0 * (alone - 1.0))


def test_what_was_not_measured_comes_in_by_the_share_beyond_and_in_full_at_one_span():
    """A span below 10° counts as 10°; joints without stated angles are never beyond."""
    lower, upper = np.full(6, -np.inf), np.full(6, np.inf)
    lower[0], upper[0], lower[3], upper[3] = -0.5, 0.5, 0.1, 0.1
    inside = robot.GeometryError(3e-4, lower, upper)
    error = replace(inside, unmeasured=4e-4)
    q = np.zeros((5, 6))
    q[:, 3] = 0.1
    q[1, 0], q[2, 0], q[3, 0], q[4, 3] = 0.75, -1.5, 2.5, 0.1 + np.radians(5.0)
    q[0, 1] = 50.0
    shares = [0.0, 0.25, 1.0, 1.0, 0.5]
    np.testing.assert_allclose(np.sqrt(error.at(q) ** 2 - inside.at(q) ** 2), 4e-4 * np.array(shares), atol=1e-12)
    np.testing.assert_allclose((inside.at(q[[1, 2, 4]]) / 3e-4) ** 2, [1 + 6 * (x + x * x) for x in (0.25, 1.0, 0.5)])


def test_slopes_of_compliances_over_the_pose_are_differences_of_their_sum():
    """Three waves, two of which share their turns, at two joints; the sum is written out."""
    turns = (0, 1, -1, 0, 0, 0)
    waves = [
        (robot.PoseWave("A2", turns, "cos"), 3e-7), (robot.PoseWave("A2", turns, "sin"), 2e-7),
        (robot.PoseWave("A5", turns, "sin"), -4e-7), (robot.PoseWave("A5", (0, 0, 0, 0, 2, 3), "cos"), 5e-7),
    ]  # fmt: skip
    over_pose = OverPose.of([*waves, (robot.GearCoupling("A4", "A5"), 1.0)])
    q = np.random.default_rng(2).uniform(-3, 3, (6, 4))
    expected = np.zeros((6, 4))
    expected[1] = 3e-7 * np.cos(q[1] - q[2]) + 2e-7 * np.sin(q[1] - q[2])
    expected[4] = -4e-7 * np.sin(q[1] - q[2]) + 5e-7 * np.cos(2 * q[4] + 3 * q[5])
    np.testing.assert_allclose(over_pose.compliance(q), expected, atol=1e-21)
    h = 1e-6
    for joint, step in enumerate(h * np.eye(6)):
        difference = (over_pose.compliance(q + step[:, None]) - over_pose.compliance(q - step[:, None])) / (2 * h)
        np.testing.assert_allclose(over_pose.slopes(q)[:, joint], difference, atol=1e-15)
    assert OverPose.of([(robot.GearCoupling("A4", "A5"), 1.0)]) is None


def test_each_parameter_acts_at_its_own_coordinate(model):
    """Seven springs of links, in the order of the chain: base Z, RX, A1, A2, A2 Y, end, A3, RZ, A4, A5, A6, X, end."""
    rows = {
        "base.Z": 0, "base.RX": 1, "k1": 2, "k2": 3, "A2.Y": 4, "A2.end_RY": 5, "k3": 6, "A3.RZ": 7, "k4": 8, "k5": 9,
        "k6": 10, "A6.X": 11, "A6.end_RZ": 12, "k5@9": 9, "k45": 8, "K_c": 3, "s_0": 3, "k3.cos(A1)": 6,
        "A1.mass": 2, "A2.mass": 4, "A3.mass": 7, "A4.mass": 8, "A6.mass": 11,
    }  # fmt: skip
    assert {name: model.row(parameters.parameter_of_name(name)) for name in rows} == rows
    assert model.actuated == (2, 3, 6, 8, 9, 10)
    assert model.passive == (0, 1, 4, 5, 7, 11, 12)
    assert model.pairs(parameters.parameter_of_name("k46")) == ((8, 10), (10, 8))
    assert model.pairs(parameters.parameter_of_name("k4@9")) == ((8, 8),)


def test_a_parameter_that_the_robot_does_not_have_is_zero_and_has_no_coordinate():
    bare = assembled(compensator=None)
    for name in ("K_c", "s_0", "A2.RX"):
        assert bare.value(parameters.parameter_of_name(name)) == 0.0
        with pytest.raises(ModelError, match=f"names '{name}', which the model does not have"):
            bare.row(parameters.parameter_of_name(name))
    assert bare.value(parameters.parameter_of_name("k1@500")) == 0.0


def test_values_that_are_set_are_read_back_and_all_others_stay(content, model):
    stated = parameters.stated_values(content) | {robot.LinkMass(joint): None for joint in robot.JOINTS}
    before = {parameter: model.value(parameter) for parameter in stated}
    for parameter in stated:
        changed = model.with_values({parameter: 1.25 * before[parameter]})
        for other in stated:
            factor = 1.25 if other == parameter else 1.0
            assert changed.value(other) == pytest.approx(factor * before[other], rel=1e-12), (parameter, other)
    whole = {name: spring.compliance_urad_per_Nm for name, spring in content.joints.items()}
    at_rest = model.compliance[list(model.actuated)]  # parts that fade are in it; backlash and couplings are not
    np.testing.assert_allclose(at_rest, [1e-6 * whole[joint] for joint in robot.JOINTS], rtol=1e-12)


def test_the_size_of_the_compensator_changes_its_stiffness_and_keeps_the_free_length():
    law = ROBOT.with_values({robot.CompensatorSize(): 3e5}).compensator
    assert (law.stiffness, law.free_length) == pytest.approx((3e5, 0.458))
    stiffer = ROBOT.with_values({robot.CompensatorStiffness(): 3e5}).compensator
    assert stiffer.stiffness * stiffer.free_length == pytest.approx(1.2e5 * 0.458)


def test_a_payload_moves_the_centre_of_the_last_link_and_of_no_other():
    centre = np.array([0.1, -0.2, 0.15])
    loaded = ROBOT.with_payload(60.0, centre)
    chain, last = ROBOT.nominal, ROBOT.nominal.centre[-1]
    at = chain.flange[:3, :3] @ centre + chain.flange[:3, 3]
    mass = chain.mass[-1] + 60.0
    np.testing.assert_allclose(loaded.loaded.mass, [*chain.mass[:-1], mass])
    np.testing.assert_allclose(loaded.loaded.centre[-1], (chain.mass[-1] * last + 60.0 * at) / mass, atol=1e-15)
    np.testing.assert_array_equal(loaded.loaded.centre[:-1], chain.centre[:-1])
    assert loaded.actual is ROBOT.actual
    assert ROBOT.with_payload(0.0, centre) is ROBOT


def test_the_payload_of_the_measurements_is_part_of_the_actual_arm_and_not_of_the_nominal_one():
    entry = PayloadEntry(source="test", mass_kg=50.0, X_mm=100.0, Y_mm=-200.0, Z_mm=150.0)
    model = assembled(payload=entry)
    expected = ROBOT.with_payload(50.0, np.array([0.1, -0.2, 0.15])).loaded
    np.testing.assert_allclose(model.actual.centre, expected.centre, atol=1e-15)
    np.testing.assert_allclose(model.actual.mass, expected.mass)
    np.testing.assert_array_equal(model.nominal.mass, ROBOT.nominal.mass)
    assert model.loaded is model.actual


def test_other_masses_of_links_leave_the_payload_as_it_is():
    loaded = ROBOT.with_payload(60.0, np.array([0.1, -0.2, 0.15]))
    lighter = loaded.with_values({robot.LinkMass("A6"): 0.0, robot.LinkMass("A3"): 100.0})
    payload_alone = loaded.nominal.flange[:3, :3] @ [0.1, -0.2, 0.15] + loaded.nominal.flange[:3, 3]
    np.testing.assert_allclose(lighter.loaded.centre[-1], payload_alone, atol=1e-12)
    assert lighter.loaded.mass[-1] == pytest.approx(60.0)
    assert (lighter.nominal.mass[[2, 5]] == [100.0, 0.0]).all()
    assert (lighter.actual.mass[[2, 5]] == [100.0, 0.0]).all()
    np.testing.assert_allclose(lighter.actual.centre[:5], ROBOT.actual.centre[:5], atol=1e-15)
    without = ROBOT.with_values({robot.LinkMass(joint): 0.0 for joint in robot.JOINTS})
    assert ROBOT.has_weight
    assert not without.has_weight
    assert without.with_payload(1.0, np.zeros(3)).has_weight


def test_a_kilogram_at_each_link_is_at_its_centre_and_at_the_coordinate_that_carries_it(model):
    light = model.unit_mass_chain
    carriers = [2, 4, 7, 8, 9, 11]  # behind the springs at the beginning of the link
    assert np.flatnonzero(light.mass).tolist() == carriers
    assert (light.mass[carriers] == 1.0).all()
    np.testing.assert_array_equal(light.centre[carriers], model.nominal.centre)


def test_calibrated_geometry_is_a_displacement_in_the_axes_of_the_joint_or_flange():
    shift = Displacement(source="test", X_mm=1.0, Y_mm=-2.0, Z_mm=3.0, RX_deg=0.1, RY_deg=0.2, RZ_deg=-0.3)
    model = assembled(geometry={"A4": shift, "flange": shift})
    move = np.eye(4)
    move[:3, :3] = frames.rotation_from_vector(np.radians([0.1, 0.2, -0.3]))
    move[:3, 3] = [1e-3, -2e-3, 3e-3]
    np.testing.assert_allclose(model.actual.placement[3], ROBOT.nominal.placement[3] @ move, atol=1e-15)
    np.testing.assert_allclose(model.actual.flange, ROBOT.nominal.flange @ move, atol=1e-15)
    np.testing.assert_array_equal(np.delete(model.actual.placement, 3, 0), np.delete(ROBOT.nominal.placement, 3, 0))
    np.testing.assert_array_equal(model.nominal.flange, ROBOT.nominal.flange)


def test_whether_the_geometry_is_nominal(model):
    shift = Displacement(source="test", X_mm=1.0)
    assert ROBOT.geometry_is_nominal
    assert not model.geometry_is_nominal
    for place in ("A2", "flange"):
        assert not assembled(geometry={place: shift}).geometry_is_nominal
    entries = test_all_terms.content(1, test_all_terms.GRAVITIES[0]).transmission
    assert not assembled(transmission=entries).geometry_is_nominal
    springs = robot.LinkSprings(source="test", RX_urad_per_Nm=0.1)
    assert assembled(links={"A2": springs}).geometry_is_nominal


def test_spreads_of_masses_and_of_the_compensator_are_shares_of_their_values():
    model = assembled(masses=Masses(source="test", spread_percent=20.0))
    assert model.prior_sigma(robot.LinkMass("A2")) == pytest.approx(0.2 * 232.1)
    assert model.prior_sigma(robot.CompensatorSize()) == pytest.approx(0.15 * 1.2e5)
    assert model.prior_sigma(robot.JointCompliance("A2")) == np.inf
    assert assembled(masses=None).prior_sigma(robot.LinkMass("A2")) == pytest.approx(0.15 * 232.1)
    assert assembled(compensator=None).compensator_spread == 0.0


def test_springs_of_links_are_rigid_until_they_have_values():
    springs = [robot.LinkSpring("A6", "X"), robot.LinkSpring("base", "RX"), robot.LinkSpring("A6", "X")]
    model = ROBOT.with_link_springs(springs)
    assert model.link_springs == (springs[1], springs[0])
    np.testing.assert_allclose(model.compliance, [0.0, *ROBOT.compliance, 0.0], rtol=1e-12)
    assert model.compliance[0] == model.compliance[-1] == 0.0
    assert ROBOT.with_link_springs([]) is ROBOT


def test_a_law_of_forces_is_the_same_within_a_millionth():
    factor = robot.ForceFactor((600.0, 200.0, 0.25), np.zeros(1))
    assert factor.is_of((600.0 * (1 + 5e-7), 200.0, 0.25))
    assert not factor.is_of((600.0 * (1 + 3e-6), 200.0, 0.25))
    assert not factor.is_of((600.0, 200.0))
