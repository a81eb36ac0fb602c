"""The length of cut for which each target stands: its sum, its halves, and integrals along paths of any division."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from postproc.toolpath import cut_lengths


def _targets(rng, motions):
    """Motions and places of targets: each motion has its end, and up to three others."""
    count = rng.integers(0, 4, size=motions)
    places = [np.append(np.sort(rng.uniform(0.05, 0.95, size=n)), 1.0) for n in count]
    return np.repeat(np.arange(motions), count + 1), np.concatenate(places)


def test_each_piece_counts_by_halves_for_both_ends_or_wholly_for_its_end():
    rng = np.random.default_rng(8)
    for _ in range(50):
        rapid, length = rng.random(20) < 0.3, rng.uniform(0.1, 2.0, size=20)
        motion, t = _targets(rng, 20)
        goes_on = rng.random(len(motion)) < 0.6
        expected = np.zeros(len(motion))
        for k, (row, end) in enumerate(zip(motion, t, strict=True)):
            if rapid[row]:
                continue
            begins_here = k == 0 or motion[k - 1] != row
            piece = length[row] * (end - (0.0 if begins_here else t[k - 1]))
            if k and goes_on[k] and not rapid[motion[k - 1]]:
                expected[k - 1] += 0.5 * piece
                expected[k] += 0.5 * piece
            else:
                expected[k] += piece
        weight = cut_lengths(SimpleNamespace(rapid=rapid), length, motion, t, goes_on)
        np.testing.assert_allclose(weight, expected, rtol=1e-12, atol=1e-15)
        assert weight.sum() == pytest.approx(length[~rapid].sum())


def test_the_mean_square_along_a_path_does_not_depend_on_its_division():
    """A deviation that grows as the square of the path: ∫s⁴ds = 1/5, with 400 of 418 targets in its last tenth."""
    place = np.concatenate([np.linspace(0.05, 0.9, 18), np.linspace(0.9, 1.0, 401)[1:]])
    one_motion = np.zeros(len(place), dtype=int), place
    chords = np.arange(len(place)), np.ones(len(place))
    for (motion, t), length in ((one_motion, np.ones(1)), (chords, np.diff(place, prepend=0.0))):
        cuts = SimpleNamespace(rapid=np.zeros(len(length), dtype=bool))
        weight = cut_lengths(cuts, length, motion, t, np.ones(len(motion), dtype=bool))
        assert weight @ place**4 == pytest.approx(0.2, abs=2e-3)
        assert np.mean(place**4) == pytest.approx(0.79, abs=0.02)  # what the number of targets would say


def test_a_cut_that_only_turns_the_tool_counts_among_the_cuts_and_adds_no_length():
    cuts = SimpleNamespace(rapid=np.array([True, False, False]))
    ones = np.ones(3, dtype=bool)
    weight = cut_lengths(cuts, np.array([1.0, 0.0, 0.0]), np.arange(3), np.ones(3), ones)
    assert weight[0] == 0.0
    assert (weight[1:] > 0.0).all()
    assert weight.sum() < 1e-8
    assert len(cut_lengths(cuts, np.zeros(3), np.zeros(0, dtype=int), np.zeros(0), ones[:0])) == 0
