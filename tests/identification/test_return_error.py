"""The tool does not return to its place after a load: from the states without load of three repeats."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.identification import joint_springs, uncertainty
from postproc.identification.return_error import return_errors
from tests.identification.test_joint_springs import forces, harness, placed, readings

NOISE = 5e-6


def three_repeats(count, hysteresis, drift, seed=3, noise=NOISE):
    """Readings in three repeats; in the first one the unloaded tool is off by `hysteresis` (a normal vector) [m].

    From each repeat to the next the device drifts by the vector `drift` [m].
    """
    rng = np.random.default_rng(seed)
    two = readings(forces(count), count)
    third = replace(two, repeat=two.repeat + 2.0)
    rows = np.concatenate([np.arange(len(two.state)), np.flatnonzero(two.repeat == 1.0)])
    repeat = np.concatenate([two.repeat, third.repeat[two.repeat == 1.0]])
    state, point = two.state[rows], two.point[rows]
    off = hysteresis * rng.normal(size=(count, 3))
    is_first = (repeat == 1.0) & (two.load[state] == 0)
    position = two.position[rows] + off[two.state_config[state]] * is_first[:, None]
    position += np.asarray(drift) * repeat[:, None] + noise * rng.normal(size=(len(rows), 3))
    data = replace(
        two, state=state, point=point, repeat=repeat, position=position, line=2 + np.arange(len(rows)),
        used=np.ones(len(rows), dtype=bool),
    )  # fmt: skip
    return data, off


def bound(data):
    placement = placed(data)
    fit = joint_springs.fit_serial(harness.PRIOR, data, placement)
    no_error = np.zeros((len(data.loaded_states), len(data.points), 3))
    return uncertainty.discrepancy(data, placement, fit, no_error)


@pytest.mark.parametrize("drift", [(0.0, 0.0, 0.0), (2e-4, -1e-4, 3e-4)])
def test_return_errors_are_those_of_the_first_repeat_without_an_even_drift(drift):
    data, off = three_repeats(40, 5e-5, drift)
    errors = return_errors(data)
    np.testing.assert_allclose(errors.error, off, atol=5 * np.sqrt(1.5 / 4) * NOISE)  # four points
    assert errors.variance == pytest.approx(1.5 * NOISE**2 / 4, rel=0.4)
    found = bound(data)
    assert found.return_bound == pytest.approx(2.795 * 5e-5, rel=0.2)
    assert found.u95.min() == found.return_bound  # configurations left out show nothing of it


def test_a_robot_that_returns_has_a_bound_of_a_few_micrometres():
    data, _ = three_repeats(40, 0.0, (1e-4, 0.0, 0.0))
    assert bound(data).return_bound < 2.0 * NOISE


def test_points_that_were_not_read_in_all_three_repeats_do_not_count():
    data, off = three_repeats(10, 5e-5, (0.0, 0.0, 0.0), noise=0.0)
    unread = (data.state == 4) & (data.point == 2) & (data.repeat == 2.0)
    shifted = data.position + np.where((data.state == 4) & (data.point == 2), 1e-3, 0.0)[:, None]
    errors = return_errors(replace(data, position=shifted, used=~unread))
    np.testing.assert_allclose(errors.error, off, atol=1e-9)
    gone = (data.state == 4) & (data.repeat == 2.0)
    assert len(return_errors(replace(data, used=~gone)).error) == 9


def test_two_repeats_displacements_and_few_configurations_show_no_return_error():
    data, _ = three_repeats(10, 5e-5, (0.0, 0.0, 0.0))
    assert return_errors(readings(forces(10))) is None
    assert bound(readings(forces(10))).return_bound is None
    assert return_errors(replace(data, are_displacements=True)) is None
    few, _ = three_repeats(3, 5e-5, (0.0, 0.0, 0.0))
    assert return_errors(few) is None


def unloaded_readings(repeats, count, hysteresis, seed, drift_spread=0.0, noise=2e-5):
    """Readings without load of one point that returns elsewhere after the first repeat, and the return errors [m].

    :param hysteresis: standard deviation of a coordinate of the return error [m].
    :param drift_spread: standard deviation of the drift from repeat to repeat between configurations [m].
    """
    rng = np.random.default_rng(seed)
    data, _ = three_repeats(count, 0.0, (0.0, 0.0, 0.0))
    off = hysteresis * rng.normal(size=(count, 3))
    drift = 1e-5 + drift_spread * rng.normal(size=(count, 3))
    config, repeat = (table.ravel() for table in np.mgrid[:count, :repeats])
    position = off[config] * (repeat == 0)[:, None] + drift[config] * repeat[:, None]
    data = replace(
        data, state=2 * config, point=0 * config, repeat=1.0 + repeat, line=2 + np.arange(len(config)), sigma=noise,
        position=position + noise * rng.normal(size=position.shape), used=np.ones(len(config), dtype=bool),
        points=("P1",), guess=data.guess[:1],
    )  # fmt: skip
    return data, off


def coverage(repeats, count, hysteresis):
    """Return the mean share of the return errors of the same robot within the bound, of 60 robots."""
    lengths = hysteresis * np.linalg.norm(np.random.default_rng(0).normal(size=(2000, 3)), axis=1)
    bounds = [
        uncertainty._return_bound(unloaded_readings(repeats, count, hysteresis, seed)[0], 1e-6) for seed in range(60)
    ]
    return float(np.mean([np.mean(lengths <= bound) for bound in bounds]))


@pytest.mark.parametrize(("repeats", "count", "least"), [(4, 4, 0.85), (6, 4, 0.83), (3, 8, 0.9), (5, 8, 0.9)])
def test_the_bound_holds_for_few_configurations(repeats, count, least):
    assert coverage(repeats, count, 5e-5) > least


@pytest.mark.parametrize("drift_spread", [0.0, 1e-4])
def test_each_repeat_narrows_the_return_errors(drift_spread):
    """Even where the device drifts by another amount in each configuration."""
    misses = []
    for repeats in (3, 6):
        data, off = unloaded_readings(repeats, 60, 5e-5, 1, drift_spread)
        errors = return_errors(data)
        misses.append(float(np.std(errors.error - off)))
        is_drift_hidden = repeats == 3 and drift_spread > 0.0  # two later places do not tell drift from noise
        assert is_drift_hidden or errors.variance == pytest.approx(misses[-1] ** 2, rel=0.4)
    assert misses[1] < 0.95 * misses[0]
    assert misses[1] < 2e-5 * (1.2 if drift_spread == 0.0 else 1.7)


def test_robots_that_return_have_a_bound_of_about_the_noise_of_a_place():
    bounds = [uncertainty._return_bound(unloaded_readings(4, 8, 0.0, seed)[0], 1e-6) for seed in range(20)]
    assert np.median(bounds) < 2e-5
