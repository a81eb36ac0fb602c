"""What a comparison takes from each program for the same force on both: feeds, partners, wrenches, deviations."""

from __future__ import annotations

import importlib
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.comparison.result import Cuts
from tests.comparison.test_differences_by_pair import COUNT, random_pairs

compare = importlib.import_module("postproc.comparison.compare")
SEEDS = range(12)


@pytest.mark.parametrize("seed", SEEDS)
def test_forces_of_a_process_are_those_at_the_feeds_of_the_second_program(seed):
    """Of partners of cutting motions whose feed differs by more than a thousandth; the feeds read are kept."""
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    rows = np.sort(rng.choice(COUNT, 9, replace=False)), np.sort(rng.choice(COUNT, 10, replace=False))
    feeds = rng.uniform(0.01, 0.1, COUNT), rng.uniform(0.01, 0.1, COUNT)
    partner = np.where(rng.random(9) < 0.7, np.sort(rng.choice(10, 9, replace=False)), -1)
    for n, k in enumerate(partner):  # most are alike
        if k >= 0:
            share = rng.choice([1.0, 1.0009, 0.9991, 1.0011, 0.5], p=[0.6, 0.15, 0.15, 0.05, 0.05])
            feeds[1][rows[1][k]] = share * feeds[0][rows[0][n]]
    sides = [
        SimpleNamespace(program=replace(made, motions=replace(made.motions, feed=feed)), rows=own)
        for made, feed, own in zip((found.nominal, found.corrected), feeds, rows, strict=True)
    ]
    expected = feeds[0].copy()
    for n, k in enumerate(partner):
        row = rows[0][n]
        if k >= 0 and not sides[0].program.motions.rapid[row]:
            other = feeds[1][rows[1][k]]
            expected[row] = other if abs(other - feeds[0][row]) > 1e-3 * feeds[0][row] else feeds[0][row]
    made = compare._at_partner_feeds(*sides, partner)
    if (expected == feeds[0]).all():
        assert made is None
        return
    np.testing.assert_array_equal(made.motions.feed, expected)
    np.testing.assert_array_equal(made.feed_as_read, feeds[0])
    np.testing.assert_array_equal(sides[0].program.motions.feed, feeds[0])


def test_forces_that_the_second_program_states_act_on_both_at_its_targets(monkeypatch):
    rng = np.random.default_rng(3)
    found = random_pairs(rng)
    sides = []
    for _ in range(2):
        joints, carried = rng.normal(size=(COUNT, 6)), rng.normal(size=(COUNT, 3))
        sides.append(SimpleNamespace(joints=joints, carriage_displacement=lambda rows, values=carried: values[rows]))
        sides[-1].carried = carried
    wrench = rng.normal(size=(COUNT, 6))
    sides[1].forces = lambda source: ("comments", source)
    sides[1].wrench = lambda load, rows: wrench[rows] if load == ("comments", None) else None

    def deviation(side, motion, q, forces, displacement):
        assert side is sides[0]
        return np.column_stack([motion, q[:, 0], forces[:, 0], displacement[:, 0]])

    monkeypatch.setattr(compare, "deviation", deviation)
    monkeypatch.setattr(compare, "pair_cuts", lambda *parts: parts)
    made = compare._add_cuts(found, *sides).cuts
    first, second = found.pair.T
    assert (made[0], made[1], made[2]) == (found, *sides)
    np.testing.assert_array_equal(made[3], wrench[second])
    for side, rows, values in ((sides[0], first, made[4]), (sides[1], second, made[5])):
        expected = [first, side.joints[rows, 0], wrench[second, 0], side.carried[rows, 0]]
        np.testing.assert_array_equal(values, np.transpose(expected))


@pytest.mark.parametrize("seed", SEEDS)
def test_additional_targets_at_which_the_loaded_tip_is_on_the_path_were_inserted(monkeypatch, seed):
    """Within the tolerance; deviations of pairs are those of the nominal targets that have a partner."""
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    rows = np.sort(np.append(found.pair[:, 0], np.setdiff1d(np.arange(COUNT), found.pair[:, 0])[:2]))
    sides = SimpleNamespace(rows=rows), SimpleNamespace(rows=np.arange(COUNT))
    loads = SimpleNamespace(
        path="forces", wrench=rng.normal(size=(len(rows), 6)), deflection=rng.normal(size=(len(rows), 3))
    )
    left = rng.normal(size=(len(rows), 3))
    row, t = np.sort(rng.integers(0, COUNT, 30)), rng.choice([0.5, 1.0], 30)
    distance = rng.choice([0.5e-4, 1e-4, 1.5e-4], 30)

    def remaining(nominal, corrected, partner, wrench):
        by_row = {int(a): int(b) for a, b in found.pair}
        assert partner.tolist() == [by_row.get(int(k), -1) for k in rows]
        np.testing.assert_array_equal(wrench, loads.wrench)
        return left

    def at_pairs(comparison, nominal, corrected, wrench, deflection, remainder):
        index = [rows.tolist().index(k) for k in found.pair[:, 0]]
        for values, whole in ((wrench, loads.wrench), (deflection, loads.deflection), (remainder, left)):
            np.testing.assert_array_equal(values, whole[index])
        return "at pairs"

    def between(comparison, cuts, nominal, corrected, load):
        assert (cuts, load) == ("at pairs", "forces")
        none = np.zeros(30)
        return Cuts(none, none, none, none, row, t, none, distance, none, none)

    for name, function in (("deviation_left", remaining), ("pair_cuts", at_pairs), ("cuts_between_pairs", between)):
        monkeypatch.setattr(compare, name, function)
    made = compare._complete_cuts(found, *sides, loads, 1e-4)
    on_path = {int(row[n]) for n in range(30) if t[n] == 1.0 and distance[n] <= 1e-4}
    moved = [int(k) for k in found.additional_rows if int(k) in on_path]
    assert made.inserted_rows.tolist() == sorted([*found.inserted_rows.tolist(), *moved])
    assert made.additional_rows.tolist() == [int(k) for k in found.additional_rows if int(k) not in on_path]
    assert made.cuts.row is row
