"""Expected errors without and with correction, and the chance of gain, against sampling."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.stats import norm as normal

from postproc.elastostatics import ChanceOfGain, SourcesOfError, expected_errors
from postproc.elastostatics.uncertainty import length_bound

_RUNS = 200_000
RNG = np.random.default_rng(7)


@pytest.mark.parametrize("shape", [(1.0, 0.0, 0.0), (1.0, 0.3, 0.1), (1.0, 1.0, 1.0)])
@pytest.mark.parametrize(
    "mean", [(0.0, 0.0, 0.0), (0.5, 0, 0), (2.0, 0, 0), (0, 2.0, 0), (1.0, 1.0, 1.0), (10.0, 3.0, 0)]
)
def test_the_quantile_of_lengths_about_a_mean_is_that_of_samples(shape, mean):
    drawn = np.linalg.norm(RNG.normal(size=(_RUNS, 3)) * shape + mean, axis=1)
    bound = length_bound(np.diag(np.square(shape))[None], np.array([mean]))[0]
    assert bound == pytest.approx(np.quantile(drawn, 0.95), rel=0.025)  # two moments of three: 2.1 % at most


def test_the_quantile_of_lengths_without_spread_is_the_length():
    found = length_bound(np.zeros((2, 3, 3)), np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]]))
    assert found.tolist() == [5.0, 0.0]


@pytest.mark.parametrize("s", [0.25, 0.5, 1.0])
def test_the_chance_of_one_unknown_factor_is_known_in_closed_form(s):
    deviation = RNG.normal(size=(20, 3))
    assert _chance(_sources(deviation[:, :, None], np.array([[s**2]])), deviation) == pytest.approx(
        normal.cdf(1.0 / (2.0 * s)), abs=1e-12
    )


def _sources(slopes, covariance, force_displacements=None, other_covariances=None):
    n = len(slopes)
    return SourcesOfError(
        slopes,
        covariance,
        (np.zeros((n, 3, 0)),) if force_displacements is None else force_displacements,
        other_covariances or {},
    )


def _chance(sources, deviation, left=None, length=None, parts=1, path_distance=None):
    gain = ChanceOfGain()
    left = np.zeros_like(deviation) if left is None else left
    length = np.ones(len(deviation)) if length is None else length
    path_distance = np.zeros(len(deviation)) if path_distance is None else path_distance
    for rows in np.array_split(np.arange(len(deviation)), parts):
        own = replace(
            sources,
            slopes=sources.slopes[rows],
            force_displacements=tuple(each[rows] for each in sources.force_displacements),
            other_covariances={name: each[rows] for name, each in sources.other_covariances.items()},
        )
        gain.add(own, deviation[rows], left[rows], path_distance[rows], length[rows])
    return gain.chance


def test_the_chance_is_the_share_of_drawn_errors_with_a_smaller_rms():
    n, parameters = 30, 3
    deviation, left = 0.4 * RNG.normal(size=(n, 3)), 0.05 * RNG.normal(size=(n, 3))
    slopes, root = 0.3 * RNG.normal(size=(n, 3, parameters)) + deviation[:, :, None], 0.6 * RNG.normal(size=(3, 3))
    forces = 0.2 * RNG.normal(size=(n, 3, 2)) + 0.3 * deviation[:, :, None]
    length = RNG.uniform(0.1, 3.0, size=n) * (np.arange(n) % 5 != 0)
    chance = _chance(_sources(slopes, root @ root.T, (forces,)), deviation, left, length, parts=4)
    drawn = RNG.normal(size=(_RUNS, 5))
    errors = np.einsum("nip,pk,rk->rni", slopes, root, drawn[:, :3])
    errors += np.einsum("nik,rk->rni", forces, drawn[:, 3:])
    without, after = (np.sum((offset + errors) ** 2, axis=2) @ length for offset in (deviation, left))
    better = after < without
    assert 0.6 < chance < 0.95
    assert chance == pytest.approx(better.mean(), abs=4.0 * np.sqrt(0.25 / _RUNS))


def test_a_target_counts_as_often_as_its_length():
    """Each kind of source: with whole lengths the chance is that of rows that are repeated as often."""
    n = 8
    deviation, left = RNG.normal(size=(n, 3)), 0.3 * RNG.normal(size=(n, 3))
    slopes, factors, unmodelled = RNG.normal(size=(n, 3, 2)), RNG.normal(size=(n, 3, 3)), RNG.uniform(1, 4, size=n)
    length = np.array([3, 0, 1, 5, 2, 2, 0, 1])
    path_distance = np.linalg.norm(left, axis=1) * np.linspace(0.5, 1.5, n)

    def chance(rows, lengths):
        other = {"unmodelled": unmodelled[rows, None, None] * np.eye(3)}
        sources = _sources(slopes[rows], np.diag([0.5, 2.0]), (factors[rows],), other)
        return _chance(sources, deviation[rows], left[rows], lengths, parts=2, path_distance=path_distance[rows])

    repeated = np.repeat(np.arange(n), length)
    weighted = chance(np.arange(n), 0.01 * length)
    assert weighted == pytest.approx(chance(repeated, np.ones(len(repeated))), rel=1e-12)
    assert weighted != pytest.approx(chance(np.arange(n), np.ones(n)), rel=1e-3)


def test_a_path_that_leaves_more_than_its_targets_counts():
    deviation, slopes = np.full((4, 3), 0.1), np.full((4, 3, 1), 0.02)
    size = np.linalg.norm(deviation, axis=1)
    sources = _sources(slopes, np.eye(1))
    chances = [_chance(sources, deviation, path_distance=share * size) for share in (0.0, 0.9, 1.0, 1.2)]
    # the covariance is that of the change at the targets: Φ(½ (1 − share²) Σ|d|² / |Σ d·slope|)
    expected = normal.cdf(0.5 * (1 - np.array([0.0, 0.9, 1.0, 1.2]) ** 2) * np.sum(size**2) / np.sum(deviation * 0.02))
    np.testing.assert_allclose(chances, expected, atol=1e-12)
    assert chances[3] < 0.49


def test_of_two_correlations_of_the_forces_the_one_with_the_smaller_chance_counts():
    deviation = np.ones((4, 3))
    narrow, wide = 0.1 * deviation[:, :, None], 0.9 * deviation[:, :, None]
    none = np.zeros((4, 3, 0)), np.zeros((0, 0))
    both = _chance(_sources(*none, (narrow, wide)), deviation)
    assert both == _chance(_sources(*none, (wide,)), deviation) < _chance(_sources(*none, (narrow,)), deviation)


def test_errors_of_unknown_correlation_count_as_if_they_were_all_the_same():
    deviation = RNG.normal(size=(10, 3))
    size = np.linalg.norm(deviation, axis=1)
    common = (0.5 * size)[:, None, None] ** 2 * np.eye(3)
    found = _chance(
        _sources(np.zeros((10, 3, 0)), np.zeros((0, 0)), other_covariances={"unmodelled": common}), deviation
    )
    assert found == pytest.approx(normal.cdf(0.5 * np.sum(size**2) / np.sum(size * 0.5 * size)))


def test_without_errors_the_chance_is_certain_and_without_change_there_is_none():
    deviation = np.ones((3, 3))
    nothing = _sources(np.zeros((3, 3, 0)), np.zeros((0, 0)))
    assert _chance(nothing, deviation) == 1.0
    assert _chance(nothing, np.zeros((3, 3)), deviation) == 0.0
    assert _chance(nothing, deviation, deviation) is None
    assert ChanceOfGain().chance is None


def test_expected_errors_share_their_covariance_and_fall_with_what_is_known():
    deviation = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    sources = _sources(0.2 * deviation[:, :, None], np.eye(1), (0.1 * deviation[:, :, None],))
    at = expected_errors(sources, deviation, np.zeros_like(deviation))
    size = np.array([1.0, 2.0])
    sigma = np.hypot(0.2, 0.1) * size
    assert at.before == pytest.approx(size + 1.645 * sigma, rel=0.01)
    assert at.after == pytest.approx(1.96 * sigma, rel=0.02)
    assert at.after.tolist() == at.bound.tolist()
    assert at.with_known_robot == pytest.approx(1.96 * 0.1 * size, rel=0.02)
    assert at.with_known_forces == pytest.approx(1.96 * 0.2 * size, rel=0.02)
