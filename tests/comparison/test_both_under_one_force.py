"""What a comparison takes from each program for the same force on both: feeds, partners, wrenches, deviations."""

from __future__ import annotations

import importlib
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.comparison import loaded_path
from postproc.comparison.result import Cuts
from postproc.errors import NotConvergedError
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
        SimpleNamespace(program=replace(made, motions=replace(made.motions, feed=feed)), target_rows=own)
        for made, feed, own in zip((found.nominal, found.corrected), feeds, rows, strict=True)
    ]
    expected = feeds[0].copy()
    for n, k in enumerate(partner):
        row = rows[0][n]
        if k >= 0 and not sides[0].program.motions.rapid[row]:
            other = feeds[1][rows[1][k]]
            expected[row] = other if abs(other - feeds[0][row]) > 1e-3 * feeds[0][row] else feeds[0][row]
    made = compare._with_partner_feeds(*sides, partner)
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
    monkeypatch.setattr(compare, "pair_cuts", lambda *parts, **deviations: (parts, deviations))
    (comparison, path, acting), deviations = compare._add_cuts(found, *sides).cuts
    first, second = found.pair.T
    assert (comparison, path) == (found, sides[0])
    np.testing.assert_array_equal(acting, wrench[second])
    by_nominal, by_corrected = deviations["nominal_deviation"], deviations["corrected_deviation"]
    for side, rows, values in ((sides[0], first, by_nominal), (sides[1], second, by_corrected)):
        expected = [first, side.joints[rows, 0], wrench[second, 0], side.carried[rows, 0]]
        np.testing.assert_array_equal(values, np.transpose(expected))


@pytest.mark.parametrize("seed", SEEDS)
def test_additional_targets_at_which_the_loaded_tip_is_on_the_path_were_inserted(monkeypatch, seed):
    """Within the tolerance; deviations of pairs are those of the nominal targets that have a partner."""
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    rows = np.sort(np.append(found.pair[:, 0], np.setdiff1d(np.arange(COUNT), found.pair[:, 0])[:2]))
    sides = (
        SimpleNamespace(target_rows=rows, robot_in_cell=SimpleNamespace(tolerance=1e-4)),
        SimpleNamespace(target_rows=np.arange(COUNT)),
    )
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

    def at_pairs(comparison, nominal, wrench, *, nominal_deviation, corrected_deviation):
        index = [rows.tolist().index(k) for k in found.pair[:, 0]]
        expected = ((wrench, loads.wrench), (nominal_deviation, loads.deflection), (corrected_deviation, left))
        for values, whole in expected:
            np.testing.assert_array_equal(values, whole[index])
        return "at pairs"

    def between(comparison, cuts, nominal, corrected, load):
        assert (cuts, load) == ("at pairs", "forces")
        none = np.zeros(30)
        return Cuts(none, none, none, none, row, t, none, distance, none, none)

    for name, function in (
        ("deviations_by_partners", remaining),
        ("pair_cuts", at_pairs),
        ("cuts_between_pairs", between),
    ):
        monkeypatch.setattr(compare, name, function)
    made = compare._complete_cuts(found, *sides, loads)
    on_path = {int(row[n]) for n in range(30) if t[n] == 1.0 and distance[n] <= 1e-4}
    moved = [int(k) for k in found.additional_rows if int(k) in on_path]
    assert made.inserted_rows.tolist() == sorted([*found.inserted_rows.tolist(), *moved])
    assert made.additional_rows.tolist() == [int(k) for k in found.additional_rows if int(k) not in on_path]
    assert made.cuts.row is row


def test_a_force_without_an_equilibrium_names_the_motion_of_the_first_of_its_places():
    made = random_pairs(np.random.default_rng(1)).nominal
    error = loaded_path.no_equilibrium(made, np.array([9, 4, 7, 2]), NotConvergedError("too large", [2, 3]))
    assert (error.problem, error.line) == ("the arm does not hold this force here: too large", 8)
    assert error.file.endswith("part.nc")


@pytest.mark.parametrize("seed", SEEDS)
def test_pieces_are_looked_at_inside_if_they_cover_some_of_the_nominal_path_without_a_step_of_the_force(
    monkeypatch, seed
):
    """Places out of reach are left out; each place has the length along its piece, and ends have their own."""
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    ends = np.sort(rng.choice(np.setdiff1d(np.arange(COUNT), found.pair[:, 1]), 3, replace=False))
    pieces = np.sort(rng.choice(np.union1d(found.pair[:, 1], ends), 8, replace=False))
    arc_length = np.append(0.0, np.cumsum(rng.uniform(0.01, 0.03, COUNT)))
    out_of_reach = {int(ends[0])} if rng.random() < 0.5 else set()
    at_end = {int(row): rng.uniform(0.0, 0.1) for row in ends}
    place = {int(b): arc_length[a + 1] for a, b in found.pair} | at_end
    for row in out_of_reach:
        del place[row]
    begin = np.array([place.get(int(row), 0.0) - rng.choice([-0.01, 1.9e-5, 2.1e-5, 0.01]) for row in pieces])
    with_step = {float(place[int(row)]) for row in pieces if int(row) in place and rng.random() < 0.2}
    asked = []

    def deviations(self, row, t, q, guess, *, sufficient_distance):
        asked.append((row.tolist(), t.tolist(), guess.tolist(), sufficient_distance))
        length = np.array([at_end[int(k)] for k in row] if (t == 1.0).all() and len(row) else guess)
        return SimpleNamespace(length=length, nominal_distance=10.0 * t, corrected_distance=20.0 * t)

    def samples(side, rows, steep):
        assert steep.tolist() == (rows % 2 == 0).tolist()
        return np.repeat(rows, 2), np.tile([0.25, 0.75], len(rows))

    ways = SimpleNamespace(
        targets=lambda comparison: ends, pieces=lambda: pieces, guessed_lengths=lambda rows: rows * 1e-3,
        begin_lengths=lambda rows, values: begin,
    )  # fmt: skip
    for name, value in (
        ("Stretches", SimpleNamespace(from_pairs=lambda *sides: ways)),
        ("_covers_step", lambda side, load, values: np.array([float(v) in with_step for v in values], dtype=bool)),
        ("_is_steep", lambda one, other, rows, values: rows % 2 == 0), ("places_on_pieces", samples),
        ("_orientation_errors_at", lambda one, other, load, length, row: length + row),
    ):  # fmt: skip
        monkeypatch.setattr(loaded_path, name, value)
    monkeypatch.setattr(loaded_path.Search, "deviations", deviations)

    def joints_at(row, t):
        bad = [(int(k) in out_of_reach and s == 1.0) or (k % 5 == 0 and s == 0.75) for k, s in zip(row, t, strict=True)]
        q = np.zeros((len(row), 6))
        q[np.array(bad, dtype=bool), 2] = np.nan
        return q

    nominal = SimpleNamespace(arc_length=arc_length, robot_in_cell=SimpleNamespace(tolerance=1e-4))
    corrected = SimpleNamespace(program=found.corrected, joints_at=joints_at)
    empty = np.zeros(0)
    cuts = loaded_path.cuts_between_pairs(found, Cuts(*[empty] * 10), nominal, corrected, "forces")
    reached = [int(row) for row in ends if int(row) not in out_of_reach]
    assert asked[0] == (reached, [1.0] * len(reached), [row * 1e-3 for row in reached], 1e-8)
    expected = [(row, 1.0, at_end[row], 10.0, 20.0, at_end[row] + row) for row in reached]
    for row, start in zip(pieces.tolist(), begin, strict=True):
        end = place.get(row, np.nan)
        if end - start > 2e-5 and end not in with_step:
            for t in (0.25, 0.75):
                if not (row % 5 == 0 and t == 0.75):
                    expected.append((row, t, start + t * (end - start), 10.0 * t, 20.0 * t, 0.0))
    names = ("row", "t", "length", "nominal_distance", "corrected_distance", "path_rotation")
    columns = np.transpose([getattr(cuts, name) for name in names])
    np.testing.assert_allclose(columns, sorted(expected), rtol=1e-12)
    assert asked[1][3] == 1e-4
