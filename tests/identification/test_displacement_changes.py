"""Gears with hysteresis, seen in displacements: the first repeat differs from the later ones, which is no noise."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.identification import joint_springs, plausibility, uncertainty
from postproc.identification.measurement_model import as_positions
from postproc.identification.procedure import check_readings
from postproc.identification.readings import Measurements
from postproc.identification.return_error import displacement_changes, noise_scatter, noise_variance
from samples.paper_study import harness
from tests.identification.test_joint_springs import ARM, LOAD_POINT, LOADED_TIP, POINTS, SPRINGS, placed, posed

NOISE = 2e-5
FRICTION = np.array([50.0, 70.0, 40.0, 8.0, 6.0, 4.0])
"""Half width of the play of each gear [N·m]."""
LEVELS = (0.2, 1.0)
"""Loads over the largest."""


def points_at(x):
    """Return the positions (P, 3) [m] of the points at joint angles x (6,) [rad]."""
    flange = ARM.tcp(x, np.eye(4))
    return POINTS @ flange[:3, :3].T + flange[:3, 3]


def displacements(repeats, friction=FRICTION, count=15, noise=NOISE, seed=4):
    """Return displacements of a robot whose gears are springs, each in series with a play, and their return errors.

    A gear at the torque τ deflects by k·w, w the torque in its spring: the play moves only at its ends, τ ± r. The
    robot arrives with any w between them. Each repeat is from its own state without load, through two loads.

    :param friction: (6,) half width r of each play [N·m].
    :returns: the readings; (count, P, 3) displacements of the points from the arrival to the return without load [m].
    """
    rng = np.random.default_rng(seed)
    q = posed(seed, count)
    force = rng.normal(size=(count, 3))
    force *= 2500.0 / np.linalg.norm(force, axis=1, keepdims=True)
    rows, return_errors = [], []
    for config, angles in enumerate(q):
        torque = ARM.gradient(lambda x, load=force[config]: load @ ARM.tcp(x, LOADED_TIP)[:3, 3], angles)
        arrival = w = rng.uniform(-1.0, 1.0, 6) * friction
        for repeat in range(1, repeats + 1):
            w = np.clip(w, -friction, friction)
            if repeat == 2:
                return_errors.append(points_at(angles + SPRINGS * w) - points_at(angles + SPRINGS * arrival))
            start = points_at(angles + SPRINGS * w)
            for level, share in enumerate(LEVELS):
                w = np.clip(w, share * torque - friction, share * torque + friction)
                moved = points_at(angles + SPRINGS * w) - start + rng.normal(size=POINTS.shape) * noise
                rows += [(3 * config + 1 + level, point, repeat, *moved[point]) for point in range(len(POINTS))]
        rows += [(3 * config, point, 1, 0.0, 0.0, 0.0) for point in range(len(POINTS))]
    table = np.array(rows)
    wrench = np.zeros((3 * count, 6))
    wrench[1::3, :3], wrench[2::3, :3] = LEVELS[0] * force, LEVELS[1] * force
    data = Measurements(
        file="m.csv", config=1.0 + np.arange(count), q=q, state_config=np.arange(3 * count) // 3,
        load=(np.arange(3 * count) % 3).astype(float), wrench=wrench, points=("P1", "P2", "P3", "P4"), guess=POINTS,
        load_point=LOAD_POINT, sigma=NOISE, state=table[:, 0].astype(np.int64), point=table[:, 1].astype(np.int64),
        repeat=table[:, 2], position=table[:, 3:], line=2 + np.arange(len(table)), used=np.ones(len(table), dtype=bool),
        are_displacements=True,
    )  # fmt: skip
    return as_positions(harness.PRIOR, data), np.array(return_errors)


def returned(data):
    """Return the bound on the return error of readings that configurations left out show no error of [m]."""
    placement = placed(data)
    fit = joint_springs.fit_serial(harness.PRIOR, data, placement)
    no_error = np.zeros((len(data.loaded_states), len(data.points), 3))
    result = uncertainty.discrepancy(data, placement, fit, no_error)
    assert result.return_bound is None or result.u95.min() >= result.return_bound
    return result.return_bound


@pytest.mark.parametrize("repeats", [2, 3, 6])
def test_the_first_repeat_differs_from_the_later_ones_by_the_return_error(repeats):
    data, return_errors = displacements(repeats)
    changes = displacement_changes(data)
    under_largest_load = changes.state % 3 == 2
    np.testing.assert_allclose(changes.weight, 4 * (repeats - 1) / repeats)
    sigma = NOISE / np.sqrt(changes.weight[0])
    is_slipped = np.linalg.norm(changes.change[under_largest_load] - return_errors.mean(axis=1), axis=1) < 5.0 * sigma
    assert np.mean(is_slipped) > 0.7  # else a small torque leaves a gear within its play
    lengths = np.linalg.norm(return_errors.mean(axis=1), axis=1)
    bound = returned(data)
    assert np.mean(lengths <= bound) >= 0.93
    assert bound < 2.5 * lengths.max()


@pytest.mark.parametrize("repeats", [2, 3, 6])
def test_hysteresis_is_no_noise_of_the_device(repeats):
    data, _ = displacements(repeats)
    squares, dof = data.scatter()
    assert squares / dof > 1.4 * NOISE**2
    # points of one repeat turn by the return error too, some micrometres from their mean
    assert noise_variance(data) == pytest.approx(NOISE**2, rel=0.15)
    still, _ = displacements(repeats, friction=np.zeros(6))
    assert noise_variance(still) == pytest.approx(NOISE**2, rel=0.15)
    assert noise_scatter(still)[1] == still.scatter()[1] - 3 * 30


def test_no_note_says_that_the_hysteresis_is_used_as_noise():
    data, _ = displacements(4)
    checked = check_readings(harness.PRIOR, data)
    assert checked.data.sigma == NOISE
    assert not [warning for warning in checked.warnings if "sigma_mm" in warning]


@pytest.mark.parametrize("repeats", [2, 4])
def test_a_robot_that_returns_has_a_bound_below_the_noise(repeats):
    data, _ = displacements(repeats, friction=np.zeros(6))
    assert returned(data) < NOISE


def test_one_repeat_few_configurations_and_positions_show_no_change():
    single, _ = displacements(1)
    few, _ = displacements(3, count=3)
    assert returned(single) is None
    assert displacement_changes(few) is None
    data, _ = displacements(3)
    positions = replace(data, has_unloaded_readings=True)
    assert displacement_changes(positions) is None
    assert noise_scatter(positions) == positions.scatter()


def test_points_without_a_first_or_later_reading_do_not_count():
    data, _ = displacements(3, noise=0.0)
    state = 2
    whole = displacement_changes(data)
    unread = (data.state == state) & (data.point == 1) & (data.repeat == 1.0)
    changes = displacement_changes(replace(data, used=~unread))
    row = int(np.flatnonzero(changes.state == state)[0])
    weights = whole.weight.copy()
    weights[row] *= 3 / 4
    np.testing.assert_allclose(changes.weight, weights)
    later_only = (data.state == state) & (data.repeat == 1.0)
    assert state not in displacement_changes(replace(data, used=~later_only)).state


def test_the_return_error_of_little_noise_is_no_gross_error_but_a_slip_of_one_point_is():
    data, return_errors = displacements(6, noise=2e-6)
    assert np.linalg.norm(return_errors, axis=2).max() > 9.0 * 2e-6
    data = replace(data, sigma=2e-6)
    assert plausibility.remove_gross_errors(data)[1] == []
    # repeats of positions have no such change
    assert len(plausibility.remove_gross_errors(replace(data, has_unloaded_readings=True))[1]) > 10
    row = int(np.flatnonzero((data.state == 4) & (data.point == 2) & (data.repeat == 1.0))[0])
    position = data.position.copy()
    position[row, 0] += 1e-3
    (sentence,) = plausibility.remove_gross_errors(replace(data, position=position))[1]
    assert sentence.startswith(data.name(row))
