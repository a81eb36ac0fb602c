"""What is uncertain beyond the noise: stated errors of loads, configurations left out, the unmodelled error."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics, robot
from postproc.identification.procedure import identify
from postproc.identification.uncertainty import (
    discrepancy,
    displacement_noise,
    left_out_residuals,
    levels,
    unmodelled_error,
)
from samples.paper_study import harness
from tests.benchmarks import truth
from tests.identification.test_truth import JOB, row


def test_a_stated_error_of_the_load_widens_every_interval_by_its_share(tmp_path):
    fits = row("the model fits: joint springs")
    truth.experiment(fits, 1, tmp_path)
    data = harness.load(tmp_path)
    plain, wider = (identify(harness.PRIOR, replace(data, load_error=share)) for share in (0.0, 0.02))
    sigma = 0.02 / 1.96  # what is stated is the bound of 95 %
    for parameter, value, before, after in zip(
        plain.fit.structure.parameters, plain.fit.values, plain.fit.covariance.diagonal(),
        wider.fit.covariance.diagonal(), strict=True,
    ):  # fmt: skip
        assert after == pytest.approx(before + (sigma * value) ** 2, rel=1e-4), parameter.name


def test_a_stated_error_of_the_load_point_is_what_moving_it_does(tmp_path):
    fits = row("the model fits: joint springs")
    truth.experiment(fits, 1, tmp_path)
    data = harness.load(tmp_path)
    plain = identify(harness.PRIOR, data)
    step, expected = 2e-3, np.array(plain.fit.covariance)
    for axis in np.eye(3):
        # readings taken at a moved point, told as if they were not
        moved = identify(harness.PRIOR, replace(data, load_point=data.load_point + step * axis))
        by_step = (moved.fit.values - plain.fit.values) / step
        expected += 25e-6 * np.outer(by_step, by_step)
    found = identify(harness.PRIOR, replace(data, load_point_error=5e-3)).fit.covariance
    np.testing.assert_allclose(np.sqrt(found.diagonal()), np.sqrt(expected.diagonal()), rtol=0.15)


def test_configurations_left_out_are_predicted_as_by_fits_without_them(tmp_path):
    truth.experiment(row("the model fits: joint springs"), 2, tmp_path)
    result = identify(harness.PRIOR, harness.load(tmp_path))
    left = left_out_residuals(result.fit, result.data)
    fit, config = result.fit, np.repeat(result.data.state_config[result.data.loaded_states], 9)
    scale = np.linalg.norm(fit.design, axis=0)
    keep = config != 4
    values = np.linalg.lstsq(fit.design[keep] / scale, fit.target[keep], rcond=None)[0] / scale
    white = fit.target[~keep] - fit.design[~keep] @ values
    # one load, three repeats with and without it: σ²·(1/3 + 1/3)
    own = left[result.data.state_config[result.data.loaded_states] == 4].ravel() / (result.data.sigma * np.sqrt(2 / 3))
    np.testing.assert_allclose(own, white, rtol=1e-4, atol=1e-5)


def test_levels_of_loads_are_told_apart_and_nothing_else():
    np.testing.assert_array_equal(levels(np.array([540.0, 2700.0, 530.0, 2610.0, 600.0])), [0, 1, 0, 1, 0])


def test_loads_without_gaps_form_levels_of_about_as_many_loads_and_at_most_an_octave_each():
    load = np.random.default_rng(8).permutation(np.geomspace(120.0, 1130.0, 43))
    level = levels(load)
    assert np.bincount(level).tolist() == [11, 11, 11, 10]
    assert all(load[level == index].max() < 2.0 * load[level == index].min() for index in range(4))
    assert all(load[level == index].max() < load[level == index + 1].min() for index in range(3))
    np.testing.assert_array_equal(levels(load[:8] * 0.0 + 500.0), 0)


def test_discrepancy_does_not_shrink_below_the_measured_loads_and_is_nothing_without_load():
    off = robot.Discrepancy(np.array([500.0, 2500.0]), np.array([0.04e-3, 0.08e-3]))
    wrench = np.zeros((6, 6))
    wrench[:5, 2] = [-1.0, 100.0, 500.0, 1500.0, 5000.0]
    np.testing.assert_allclose(off.at(wrench) * 1e3, [0.04, 0.04, 0.04, 0.06, 0.16, 0.0])
    model = replace(harness.PRIOR, covariance=robot.Covariance((), np.zeros((0, 0))), discrepancy=off)
    bound = elastostatics.position_bound(model, np.tile(JOB[0][0], (6, 1)), harness.TOOL, wrench)
    np.testing.assert_allclose(bound, off.at(wrench), rtol=0.02)


def test_unmodelled_error_is_found_though_some_configurations_are_open():
    rng = np.random.default_rng(4)
    blur = np.tile(0.03**2 * np.eye(3), (40, 1, 1))
    blur[:3] = np.eye(3)  # there the parameters are open: their errors say nothing
    error = np.einsum("nij,nj->ni", np.linalg.cholesky(blur + 0.04**2 * np.eye(3)), rng.normal(size=(40, 3)))
    assert unmodelled_error(error, blur, 0.003) == pytest.approx(0.04 * 2.795, rel=0.2)
    noise = np.einsum("nij,nj->ni", np.linalg.cholesky(blur), rng.normal(size=(40, 3)))
    assert 0.0 < unmodelled_error(noise, blur, 0.003) < 0.05


def test_unmodelled_error_is_never_zero_is_wider_from_few_configurations_and_has_no_step():
    rng = np.random.default_rng(5)
    noise, blur = rng.normal(size=(200, 3)), np.tile(np.eye(3), (200, 1, 1))
    few, many = (unmodelled_error(noise[:count], blur[:count], 0.2) for count in (6, 200))
    assert few > 1.5 * many > 0.0
    found = [unmodelled_error(share * noise, blur, 0.2) for share in np.linspace(0.9, 1.4, 51)]
    assert np.all(np.diff(found) > 0.0)
    assert np.max(np.diff(found)) < 0.06 * max(found)


def test_an_error_that_the_points_of_a_state_share_is_found_below_the_noise_of_one_point(tmp_path):
    truth.experiment(row("the model fits: joint springs"), 2, tmp_path)
    result = identify(harness.PRIOR, harness.load(tmp_path))
    data = replace(result.data, sigma=0.04e-3)
    rng, noise = np.random.default_rng(3), np.sqrt(displacement_noise(data)[0, 0] / 3.0)
    states, points = len(data.loaded_states), len(data.points)
    bounds = []
    for _ in range(20):
        left = 20e-6 * rng.normal(size=(states, 1, 3)) + noise * rng.normal(size=(states, points, 3))
        bounds.append(discrepancy(data, result.placement, result.fit, left).u95[0])
    assert noise > 30e-6
    assert np.median(bounds) == pytest.approx(2.795 * 20e-6, rel=0.15)


@pytest.mark.parametrize("seed", range(3))
def test_the_unmodelled_error_is_the_quantile_of_a_mixture_over_its_size(seed):
    """Drawn: sizes from the prior, weighted by how probable the errors are with each; lengths of normal vectors."""
    rng = np.random.default_rng(seed)
    spread = rng.normal(size=(5, 3, 3)) * 1e-5
    blur = spread @ np.swapaxes(spread, 1, 2) + (5e-6) ** 2 * np.eye(3)
    error = np.array([rng.multivariate_normal(np.zeros(3), one + (4e-5) ** 2 * np.eye(3)) for one in blur])
    weight = rng.uniform(0.3, 1.0, 5)
    size = 1e-5 * np.exp(1.5 * np.clip(rng.normal(size=20_000), -5.0, 4.5))
    likely = np.zeros(len(size))
    for one, covariance, share in zip(error, blur, weight, strict=True):
        whole = covariance + size[:, None, None] ** 2 * np.eye(3)
        square = np.einsum("i,nij,j->n", one, np.linalg.inv(whole), one)
        likely -= 0.5 * share * (np.linalg.slogdet(whole)[1] + square)
    chance = np.exp(likely - likely.max())
    drawn = rng.choice(size, 200_000, p=chance / chance.sum())
    length = drawn * np.linalg.norm(rng.normal(size=(len(drawn), 3)), axis=1)
    assert unmodelled_error(error, blur, 1e-5, weight) == pytest.approx(np.quantile(length, 0.95), rel=0.03)
