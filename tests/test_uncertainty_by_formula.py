"""Parts of the bound by formulas: quantiles of χ², errors of forces, flanks of gears, changes of direction."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.stats import chi2

from postproc import elastostatics, robot
from postproc.elastostatics import uncertainty
from postproc.elastostatics.equilibrium import linear_compliance
from postproc.elastostatics.reversals import flank_covariance
from postproc.elastostatics.uncertainty import LENGTH_95, LoadedPlaces, length_bound, sources_of_error
from postproc.robot import Backlash, LostMotion
from tests.kr270 import ROBOT, tool_at

OFF_AXIS_TOOL = tool_at(0.1, -0.05, 0.35)
Q = np.radians([[10.0, -70.0, 100.0, 20.0, 50.0, 0.0], [-30.0, -60.0, 90.0, 80.0, -40.0, 60.0]])
WRENCH = np.array([[300.0, -200.0, 400.0, 20.0, -30.0, 10.0], [-100.0, 500.0, -50.0, -10.0, 15.0, 25.0]])
REACTION = linear_compliance(ROBOT, Q, OFF_AXIS_TOOL, WRENCH)[:, :3]


@pytest.mark.parametrize("values", [(1.0, 1.0, 1.0), (1.0, 0.5, 0.2), (1.0, 0.9, 0.1), (4.0, 4.0, 0.0)])
def test_the_quantile_of_lengths_is_that_of_the_chi_square_of_two_moments(values):
    """The length by Wilson and Hilferty's quantile is within half a percent of the exact one."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    covariance = turn @ np.diag(values) @ turn.T
    trace, square = sum(values), sum(value**2 for value in values)
    exact = np.sqrt(square / trace * chi2.ppf(0.95, trace**2 / square))
    assert length_bound(covariance[None])[0] == pytest.approx(exact, rel=5e-3)
    assert length_bound(np.eye(3)[None])[0] == pytest.approx(LENGTH_95, rel=5e-3)
    mean = np.array([0.3, -2.0, 1.0])
    first = trace + mean @ mean
    second = 2.0 * square + 4.0 * mean @ covariance @ mean
    exact = np.sqrt(second / (2.0 * first) * chi2.ppf(0.95, 2.0 * first**2 / second))
    assert length_bound(covariance[None], mean[None])[0] == pytest.approx(exact, rel=5e-3)


def test_length_95_is_the_root_of_the_chi_square_of_three():
    assert pytest.approx(np.sqrt(chi2.ppf(0.95, 3)), rel=1e-7) == LENGTH_95


def sources(model=ROBOT, spread=None, in_series=None, proportional=(False, False)):
    """Errors at both poses without what turns."""
    places = LoadedPlaces.of(
        Q, OFF_AXIS_TOOL, WRENCH, force_spread=spread, in_series=in_series, is_proportional=np.array(proportional)
    )
    return sources_of_error(model, places)


def test_certain_forces_have_no_error():
    errors = sources()
    assert len(errors.force_displacements) == 1
    assert errors.force_displacements[0].shape == (2, 3, 0)
    np.testing.assert_allclose(errors.covariances()[0], errors.robot_covariance)


def test_independent_components_displace_the_tool_by_the_compliance():
    spread = np.random.default_rng(3).normal(size=(2, 6, 6))
    series = np.random.default_rng(4).normal(size=(2, 6, 6)) * 1e-8
    errors = sources(spread=spread, in_series=series)
    reaction = REACTION + series[:, :3]
    (by_forces,) = errors.force_displacements
    expected = reaction @ spread @ spread.transpose(0, 2, 1) @ reaction.transpose(0, 2, 1)
    np.testing.assert_allclose(by_forces @ by_forces.transpose(0, 2, 1), expected, rtol=1e-9)
    for row in range(2):
        for column in range(6):
            sign = -1.0 if spread[row, :, column] @ WRENCH[row] < 0.0 else 1.0
            np.testing.assert_allclose(by_forces[row, :, column], sign * reaction[row] @ spread[row, :, column])


def test_forces_that_may_err_by_one_factor_are_compared_both_ways():
    spread = np.random.default_rng(3).normal(size=(2, 6, 13))
    independent, by_factor = sources(spread=spread).force_displacements
    assert independent.shape == (2, 3, 6)
    assert by_factor.shape == (2, 3, 7)
    both = np.concatenate([independent, by_factor], axis=2)
    sign = np.where(np.einsum("nik,ni->nk", spread, WRENCH) < 0.0, -1.0, 1.0)
    np.testing.assert_allclose(both, REACTION @ (spread * sign[:, None]), rtol=1e-9)


def test_the_factor_of_forces_counts_with_the_parameters_where_the_law_is_its_own():
    """At the second pose alone: its column is C·w, its covariance that of the file, and the last cause is left out."""
    covariance = robot.Covariance.of(["k1", "k2"], [[0.04, 0.001], [0.001, 0.01]])
    factor = robot.ForceFactor((1.0,), np.array([0.002, -0.003, 0.09]))
    model = replace(ROBOT, covariance=covariance, force_factor=factor)
    spread = np.random.default_rng(3).normal(size=(2, 6, 13))
    errors = sources(model, spread, proportional=(False, True))
    plain = sources(model, spread)
    assert plain.slopes.shape == (2, 3, 2)
    np.testing.assert_allclose(errors.slopes[:, :, :2], plain.slopes)
    np.testing.assert_allclose(errors.slopes[0, :, 2], 0.0)
    np.testing.assert_allclose(errors.slopes[1, :, 2], REACTION[1] @ WRENCH[1])
    np.testing.assert_allclose(errors.covariance, [[0.04, 0.001, 0.002], [0.001, 0.01, -0.003], [0.002, -0.003, 0.09]])
    independent, by_factor = errors.force_displacements
    np.testing.assert_allclose(independent[0], plain.force_displacements[0][0])
    np.testing.assert_allclose(by_factor[0], plain.force_displacements[1][0])
    np.testing.assert_allclose(by_factor[1, :, :6], plain.force_displacements[1][1, :, :6])
    np.testing.assert_allclose(by_factor[1, :, 6], 0.0)
    np.testing.assert_allclose(independent[1], plain.force_displacements[1][1, :, :6])
    (six,) = sources(model, spread[:, :, :6], proportional=(False, True)).force_displacements
    assert not six[1].any()
    assert six[0].any()


def test_sources_of_the_robot_add_up_as_covariances():
    everywhere = robot.GeometryError(3e-4, np.full(6, -np.inf), np.full(6, np.inf))
    off = robot.Discrepancy(np.array([1.0, 1e4]), np.array([1e-4, 1e-4]))
    model = replace(ROBOT, geometry_error=everywhere, discrepancy=off, terms=((Backlash("A1", 1e9), 1e-4),))
    errors = sources(model)
    assert set(errors.other_covariances) == {
        "the calibrated geometry", "the unmodelled error of the robot model", "lost motion of the gears",
    }  # fmt: skip
    np.testing.assert_allclose(
        errors.other_covariances["the calibrated geometry"][0], np.eye(3) * (3e-4 / LENGTH_95) ** 2
    )
    np.testing.assert_allclose(
        errors.other_covariances["the unmodelled error of the robot model"][1], np.eye(3) * (1e-4 / LENGTH_95) ** 2
    )
    by_parameters = errors.slopes @ ROBOT.covariance.matrix @ errors.slopes.transpose(0, 2, 1)
    np.testing.assert_allclose(
        errors.robot_covariance, by_parameters + sum(errors.other_covariances.values()), rtol=1e-12
    )
    assert set(sources().other_covariances) == {"lost motion of the gears"}
    bound = uncertainty.position_bound(model, Q, OFF_AXIS_TOOL, WRENCH)
    np.testing.assert_allclose(bound, length_bound(errors.robot_covariance), rtol=1e-9)
    assert uncertainty.position_bound(replace(model, covariance=None), Q, OFF_AXIS_TOOL, WRENCH) is None


def lever(joint: int, row: int) -> np.ndarray:
    """What a radian of a joint displaces the tip by at a pose (3,), by differences [m]."""
    step = 1e-6 * np.eye(6)[joint]
    plus, minus = (ROBOT.nominal.joint_frames((Q[row] + s * step)[None])[1][0] @ OFF_AXIS_TOOL for s in (1, -1))
    return (plus[:3, 3] - minus[:3, 3]) / 2e-6


@pytest.mark.parametrize("kind", [LostMotion, Backlash])
def test_flanks_that_are_not_known_scatter_the_tool_by_the_lever_of_the_joint(kind):
    """b² (1 − tanh²(τ/T)) along the lever of A1 and of A3; at a joint that turns, b² whatever the torque."""
    values = {"A1": 1e-4, "A3": 2e-4}
    model = replace(ROBOT, terms=tuple((kind(joint, 300.0), value) for joint, value in values.items()))
    torque = np.array([[WRENCH[n, :3] @ lever(j, n) for j in (0, 2)] for n in range(2)])
    axes = [np.array([0.0, 0.0, -1.0]), None]
    for n in range(2):
        torque[n, 0] += WRENCH[n, 3:] @ axes[0]
        a3 = np.array([-np.sin(-Q[n, 0]), np.cos(-Q[n, 0]), 0.0])  # axis of A3: Y turned by A1, which turns about −Z
        torque[n, 1] += WRENCH[n, 3:] @ a3
    turning = np.zeros((2, 6), dtype=bool)
    turning[1, 2] = True
    found = flank_covariance(model, Q, OFF_AXIS_TOOL, WRENCH, turning)
    for n in range(2):
        expected = np.zeros((3, 3))
        for column, (joint, value) in enumerate(zip((0, 2), values.values(), strict=True)):
            share = 1.0 if turning[n, joint] else 1.0 - np.tanh(torque[n, column] / 300.0) ** 2
            expected += value**2 * share * np.outer(lever(joint, n), lever(joint, n))
        np.testing.assert_allclose(found[n], expected, rtol=1e-6, atol=1e-16)
    assert not flank_covariance(ROBOT, Q, OFF_AXIS_TOOL, WRENCH, turning).any()
    zero = replace(ROBOT, terms=((kind("A1", 300.0), 0.0),))
    assert not flank_covariance(zero, Q, OFF_AXIS_TOOL, WRENCH, turning).any()


def forces_on_a1(torques) -> np.ndarray:
    """Wrenches (n, 6) with these moments about A1 alone [N·m]."""
    wrench = np.zeros((len(torques), 6))
    wrench[:, 5] = -np.asarray(torques)
    return wrench


@pytest.mark.parametrize(
    ("torques", "expected"),
    [
        ((5.0, 3.0, -2.0, -4.0), [(1, 2)]),
        ((5.0, 0.04, -0.04, -5.0), [(0, 3)]),  # below 1 % of the largest: between flanks
        ((5.0, 0.06, -0.06, -5.0), [(1, 2)]),
        ((5.0, 0.0, 0.0, 5.0), []),
        ((-0.002, 0.002, 0.002, -0.002), [(0, 1), (2, 3)]),
        ((-9e-4, 9e-4, 9e-4, -9e-4), []),  # below 1 mN·m
    ],
)
def test_a_direction_changes_between_the_last_and_the_next_torque_that_counts(torques, expected):
    q = np.repeat(Q[:1], 4, axis=0)
    found = elastostatics.reversals(ROBOT, q, OFF_AXIS_TOOL, forces_on_a1(torques))
    pairs = [(int(a), int(b)) for a, b, j in zip(found.previous_row, found.row, found.joint, strict=True) if j == 0]
    assert pairs == expected
    assert (np.diff(found.row) >= 0).all()


@pytest.mark.parametrize("torque", [2.0, 4.0])
def test_a_gear_with_lost_motion_changes_its_flank_beyond_its_own_torque(torque):
    model = replace(ROBOT, terms=((LostMotion("A1", torque), 1e-4), (Backlash("A6", 1e-3), 0.0)))
    q = np.repeat(Q[:1], 4, axis=0)
    found = elastostatics.reversals(model, q, OFF_AXIS_TOOL, forces_on_a1((5.0, 3.0, -3.0, -5.0)))
    (at,) = np.flatnonzero(found.joint == 0)
    assert (found.previous_row[at], found.row[at]) == ((1, 2) if torque == 2.0 else (0, 3))
    assert found.step[at] == pytest.approx(2e-4 * np.linalg.norm(lever(0, 0)), rel=1e-6)
    assert (found.step[found.joint != 0] == 0.0).all()
