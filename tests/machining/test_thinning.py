"""Stations that are left out: between those that are kept, force and moment are linear to within a tolerance."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.machining.profiles import thin_out


def between(rows, kept, wrench):
    """Wrenches (n, 6) at rows, linear between those that are kept."""
    return np.stack([np.interp(rows, kept, column[kept]) for column in wrench.T], axis=1)


def allowed(wrench):
    """What force [N] and moment [N·m] may be off by."""
    size = [np.linalg.norm(wrench[:, half], axis=1).max() for half in (slice(0, 3), slice(3, 6))]
    return max(0.01 * size[0], 1.0), max(0.01 * size[1], 0.1)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("scale", [(300.0, 0.1), (5.0, 0.05), (30.0, 40.0), (2000.0, 3.0)])
def test_what_is_left_out_is_linear_between_what_is_kept(seed, scale):
    rng = np.random.default_rng(seed)
    wrench, motion = [], []
    for k, n in enumerate((200, 1, 2, 90, 3)):
        smooth = np.cumsum(np.cumsum(rng.normal(size=(n, 6)), axis=0), axis=0)
        smooth /= np.abs(smooth).max(axis=0)
        wrench.append(smooth * np.repeat(scale, 3) * (1.0 + 2.0 * (k % 2)))
        motion.append(np.full(n, 3 * k))
    wrench, motion = np.concatenate(wrench), np.concatenate(motion)
    kept = thin_out(motion, wrench)
    assert (np.diff(kept) > 0).all()
    assert len(kept) < len(motion)
    for k in np.unique(motion):
        own, rows = np.flatnonzero(motion == k), kept[motion[kept] == k]
        force, moment = allowed(wrench[own])
        if len(rows) > 1:
            assert (rows[0], rows[-1]) == (own[0], own[-1])
        off = wrench[own] - between(own, rows, wrench)
        assert np.linalg.norm(off[:, :3], axis=1).max() <= force
        assert np.linalg.norm(off[:, 3:], axis=1).max() <= moment
        # no station between two others is kept that those would do without, the largest deviation first
        for at in range(1, len(rows) - 1):
            span = np.arange(rows[at - 1], rows[at + 1] + 1)
            off = wrench[span] - between(span, rows[[at - 1, at + 1]], wrench)
            assert (
                np.linalg.norm(off[:, :3], axis=1).max() > 0.2 * force
                or np.linalg.norm(off[:, 3:], axis=1).max() > 0.2 * moment
            )


@pytest.mark.parametrize("column", range(6))
def test_the_knots_of_a_polygon_are_what_is_kept(column):
    knots = np.array([0, 17, 40, 41, 90])
    values = np.array([0.0, 200.0, -150.0, 150.0, 0.0]) * (1.0 if column < 3 else 0.1)
    wrench = np.full((91, 6), 3.0)
    wrench[:, column] += np.interp(np.arange(91), knots, values)
    assert thin_out(np.full(91, 4), wrench).tolist() == knots.tolist()


@pytest.mark.parametrize(("column", "least", "large"), [(1, 1.0, 500.0), (5, 0.1, 60.0)])
def test_a_wrench_that_changes_by_less_than_the_tolerance_is_one_in_the_middle(column, least, large):
    """One per cent of the largest, and at least 1 N and 0.1 N·m: then the same all along."""
    for size, change in ((0.0, least), (large, 0.01 * large)):
        for share, count in ((0.97, 1), (1.05, 2)):
            wrench = np.zeros((11, 6))
            wrench[:, column - 1] = size
            wrench[:, column] = np.linspace(0.0, share * change, 11)
            kept = thin_out(np.zeros(11, dtype=int), wrench)
            assert kept.tolist() == ([5] if count == 1 else [0, 10])


def test_nothing_and_one_station():
    assert thin_out(np.zeros(0, dtype=int), np.zeros((0, 6))).tolist() == []
    assert thin_out(np.array([3]), np.ones((1, 6))).tolist() == [0]
    assert thin_out(np.array([1, 2, 2, 5]), np.full((4, 6), 7.0)).tolist() == [0, 2, 3]
