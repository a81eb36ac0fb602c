"""What the same part shows later: the size of changes that are seen, and the chance of an alarm."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.testpart import design
from postproc.testpart.fit import _no_change_probability
from postproc.testpart.prior import Prior
from postproc.testpart.readings import RADIUS_ERROR
from tests.testpart import trial


@pytest.fixture(scope="module")
def prior():
    return Prior.of(trial.RobotInCell.of(trial.ROBOT, trial.CELL).robot, 0.1)


def test_an_alarm_is_as_rare_as_it_says_and_a_small_effect_is_seen_next_to_large_ones():
    """Scores of four unknowns, one of which the readings show a tenth as well as the others."""
    rng = np.random.default_rng(3)
    slopes = rng.normal(size=(40, 4)) * [1.0, 1.0, 0.1, 1.0]
    information = slopes.T @ slopes
    scores = (slopes.T @ rng.normal(size=(40, 20_000))).T
    alarms = np.mean([_no_change_probability(score, information) < 0.05 for score in scores])
    assert 0.03 < alarms < 0.055  # five per cent, less what Bonferroni gives away
    changed = 5.1 / np.sqrt(information[2, 2]) * slopes[:, 2]
    scores = (slopes.T @ (changed[:, None] + rng.normal(size=(40, 4_000)))).T
    assert np.mean([_no_change_probability(score, information) < 0.005 for score in scores]) > 0.94


def test_the_smallest_change_is_that_of_the_readings_of_two_parts(prior):
    """By the whole covariance of the second part's readings, without eliminating anything."""
    rng = np.random.default_rng(4)
    size, n, noise = len(prior.parameters) + 1, 60, 5e-6
    slopes = rng.normal(size=(n, size)) * 3e-5  # by unknowns in units of their prior
    radius, pose = RADIUS_ERROR * (rng.random(n) < 0.5), rng.normal(size=(n, 6)) * 1e-2
    columns = np.column_stack([slopes, radius, pose])
    start = design._prior_information(prior, size + 7)
    nuisance = noise**2 * np.eye(n) + np.outer(radius, radius) + 1e4 * pose @ pose.T
    before = np.linalg.inv(start[:size, :size])
    first = np.linalg.inv(np.linalg.inv(before) + slopes.T @ np.linalg.solve(nuisance, slopes))
    expected = slopes @ first @ slopes.T + nuisance
    per_sigma = np.sqrt(np.einsum("nk,nk->k", slopes, np.linalg.solve(expected, slopes)))[:-1]
    relative = 5.1 / (per_sigma * prior.values / prior.sigma[:-1])
    np.testing.assert_allclose(design._visible_changes(prior, columns.T @ columns / noise**2), relative, rtol=1e-4)
