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
    np.testing.assert_allclose(errors.error, off, atol=5 * np.sqrt(6 / 4) * NOISE)  # four points
    assert errors.variance == pytest.approx(6 * NOISE**2 / 4, rel=0.4)
    found = bound(data)
    assert found.returned == pytest.approx(2.795 * 5e-5, rel=0.2)
    assert found.u95.min() == found.returned  # configurations left out show nothing of it


def test_a_robot_that_returns_has_a_bound_of_a_few_micrometres():
    data, _ = three_repeats(40, 0.0, (1e-4, 0.0, 0.0))
    assert bound(data).returned < 2.0 * NOISE


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
    assert bound(readings(forces(10))).returned is None
    assert return_errors(replace(data, are_displacements=True)) is None
    few, _ = three_repeats(3, 5e-5, (0.0, 0.0, 0.0))
    assert return_errors(few) is None
