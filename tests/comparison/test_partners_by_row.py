"""Partners of targets row by row: order, targets that were moved alone, those that are passed or missing."""

from __future__ import annotations

import importlib
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import frames
from postproc.comparison import loaded_path, partners
from postproc.comparison.loaded_path import Stretches
from postproc.program import CIRC, LIN, PTP, SPL
from tests.comparison.test_differences_by_pair import COUNT, random_pairs

compare = importlib.import_module("postproc.comparison.compare")
SEEDS = range(20)


@pytest.mark.parametrize("seed", SEEDS)
def test_partners_that_are_not_behind_all_before_them_are_dropped(seed):
    rng = np.random.default_rng(seed)
    partner = rng.integers(-1, 12, 15)
    expected, largest = [], -1
    for value in partner:
        expected.append(value if value > largest else -1)
        largest = max(largest, value)
    assert partners.ordered_partners(partner).tolist() == expected


def test_targets_without_a_partner_have_no_deviation(monkeypatch):
    """The others have that of the tip by the joints of their partners, under the force at the target."""
    rng = np.random.default_rng(2)
    joints, wrench = rng.normal(size=(7, 6)), rng.normal(size=(4, 6))
    nominal = SimpleNamespace(target_rows=np.array([1, 3, 4, 6]))
    corrected = SimpleNamespace(
        target_rows=np.array([0, 2, 5]), joints=joints, carriage_displacement=lambda rows: np.stack([rows] * 3, axis=1)
    )
    calls = []

    def deviation(path, rows, q, forces, displacement):
        calls.append((path, rows.tolist(), q, forces, displacement[:, 0].tolist()))
        return np.full((len(rows), 3), 5.0)

    monkeypatch.setattr(partners, "deviation", deviation)
    found = partners.deviations_by_partners(nominal, corrected, np.array([0, -1, 2, -1]), wrench)
    np.testing.assert_array_equal(found, [[5.0] * 3, [0.0] * 3, [5.0] * 3, [0.0] * 3])
    ((path, rows, q, forces, carried),) = calls
    assert (path, rows, carried) == (nominal, [1, 4], [0, 5])
    np.testing.assert_array_equal(q, joints[[0, 5]])
    np.testing.assert_array_equal(forces, wrench[[0, 2]])


def sides_of(found):
    """Two paths whose Cartesian targets are all motions but some of the first program."""
    rows = np.setdiff1d(np.arange(COUNT), np.setdiff1d(np.arange(COUNT), found.pair[:, 0])[:1])
    return (
        SimpleNamespace(program=found.nominal, target_rows=rows),
        SimpleNamespace(program=found.corrected, target_rows=np.arange(COUNT)),
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_as_many_missing_as_additional_targets_between_two_pairs_were_moved(seed):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    sides = sides_of(found)
    for made in (found.nominal, found.corrected):
        made.motions.kind[rng.random(COUNT) < 0.3] = PTP
    missing = np.setdiff1d(sides[0].target_rows, found.pair[:, 0])
    found = replace(found, only_nominal=missing)
    gaps = [{}, {}]
    for n, rows in enumerate((missing, found.additional_rows)):
        for row in rows:
            gaps[n].setdefault(int(sum(found.pair[:, n] < row)), []).append(int(row))
    expected = np.full(len(sides[0].target_rows), -1)
    for gap, rows in gaps[0].items():
        others = gaps[1].get(gap, [])
        for row, other in zip(rows, others, strict=True) if len(rows) == len(others) else ():
            if (found.nominal.motions.kind[row] == PTP) == (found.corrected.motions.kind[other] == PTP):
                expected[sides[0].target_rows.tolist().index(row)] = other
    assert partners.moved_partners(found, *sides).tolist() == expected.tolist()
    by_row = {int(a): int(b) for a, b in found.pair}
    of_rows = [by_row.get(int(row), -1) for row in sides[0].target_rows]
    assert partners.partners_of(found, *sides).tolist() == of_rows


@pytest.mark.parametrize("seed", SEEDS)
def test_some_additional_targets_become_inserted_ones(seed):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    on_path = rng.random(len(found.additional_rows)) < 0.5
    changed = partners.count_as_inserted(found, on_path)
    moved = [row for row, is_moved in zip(found.additional_rows, on_path, strict=True) if is_moved]
    assert changed.inserted_rows.tolist() == sorted([*found.inserted_rows, *moved])
    assert changed.additional_rows.tolist() == [row for row in found.additional_rows if row not in moved]


@pytest.mark.parametrize("with_load", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_target_without_partner_is_passed_within_the_tolerance_or_as_a_point_of_a_line(monkeypatch, seed, with_load):
    """Without forces the offsets next to it may differ, and points of lines be off by 0.1 mm and thrice the offset."""
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    base = frames.pose_from_xyzabc([[1500.0, -200, 700, 30, 0, 0]])
    missing = np.setdiff1d(np.arange(COUNT), found.pair[:, 0])
    pose = found.pose.copy()
    pose[:, :3, 3] += rng.normal(0.0, 6e-5, (8, 3))
    found = replace(found, nominal=replace(found.nominal, bases=base), pose=pose, only_nominal=missing)
    missed = rng.choice([5e-5, 1.5e-4, 4e-4, 2e-3], len(missing))
    continued = rng.random(COUNT) < 0.5
    calls = []

    def missed_by(nominal_path, corrected_path, pair, rows, load, offset):
        calls.append(offset)
        return missed.copy()

    monkeypatch.setattr(partners, "missing_distances", missed_by)
    path = SimpleNamespace(robot_in_cell=SimpleNamespace(tolerance=1e-4), is_continued=continued)
    distances, is_passed = partners.missed_targets(found, path, None, "load" if with_load else None)
    offsets = [base[0, :3, :3] @ (pose[k] - found.nominal.motions.target[found.pair[k, 0]])[:3, 3] for k in range(8)]
    np.testing.assert_allclose(calls[0], offsets, atol=1e-12)
    for n, row in enumerate(missing):
        after = min(int(sum(found.pair[:, 0] < row)), 7)
        before = max(int(sum(found.pair[:, 0] < row)) - 1, 0)
        expected, passed = missed[n], missed[n] <= 1e-4
        if not with_load:
            largest = max(np.linalg.norm(offsets[k]) for k in (before, after))
            expected = max(missed[n] - np.linalg.norm(offsets[after] - offsets[before]), 0.0)
            passed = expected <= 1e-4 or (continued[row] and missed[n] <= 1e-4 + 3.0 * largest)
        assert distances[n] == pytest.approx(expected, abs=1e-12)
        assert is_passed[n] == passed


def ways_of(rng, rest_is_nominal=True):
    """Two programs with kinds by chance, their pairs and arc lengths."""
    found = random_pairs(rng)
    kinds = rng.choice([LIN, CIRC, PTP, SPL], (2, COUNT), p=[0.5, 0.2, 0.2, 0.1])
    joints = np.full((2, COUNT, 6), np.nan)
    joints[rng.random((2, COUNT)) < 0.15] = 0.2
    sides = []
    for n, made in enumerate((found.nominal, found.corrected)):
        motions = replace(made.motions, kind=kinds[n], joints=joints[n])
        after = np.arange(-1, COUNT - 1)
        after[rng.integers(1, COUNT)] = rng.integers(0, COUNT)
        made = replace(made, motions=motions, after=after if rng.random() < 0.5 else None)
        arc_length = np.append(0.0, np.cumsum(rng.uniform(0.001, 0.02, COUNT)))
        rows = np.flatnonzero(np.isnan(joints[n][:, 0]))
        cell = SimpleNamespace(rest_is_nominal=rest_is_nominal)
        sides.append(SimpleNamespace(program=made, arc_length=arc_length, target_rows=rows, robot_in_cell=cell))
    return replace(found, nominal=sides[0].program, corrected=sides[1].program), sides


def starts_uncorrected(side):
    """Motions that begin at an unknown place, or where nothing was corrected."""
    m, result = side.program.motions, []
    for row in range(COUNT):
        before = row - 1 if side.program.after is None else int(side.program.after[row])
        is_axis = before < 0 or np.isfinite(m.joints[before, 0])
        result.append(before == row or (is_axis and not side.robot_in_cell.rest_is_nominal))
    return result


@pytest.mark.parametrize("rest_is_nominal", [True, False])
@pytest.mark.parametrize("seed", SEEDS)
def test_ways_between_pairs_are_compared_where_all_of_the_nominal_way_is_known(seed, rest_is_nominal):
    rng = np.random.default_rng(seed)
    found, (nominal, corrected) = ways_of(rng, rest_is_nominal)
    ways = Stretches.from_pairs(found, nominal, corrected)
    m = nominal.program.motions
    uncorrected = starts_uncorrected(nominal)
    assert loaded_path._has_uncorrected_start(nominal).tolist() == uncorrected
    known = []
    for k in range(8):
        before = int(found.pair[k - 1, 0]) if k else -1
        rows = range(before + 1, int(found.pair[k, 0]) + 1)
        unknown = [(m.kind[row] in (PTP, SPL) or m.rapid[row]) and np.isnan(m.joints[row, 0]) for row in rows]
        known.append(not any(unknown) and not any(uncorrected[row] for row in rows))
        begins = [
            side.arc_length[(found.pair[k - 1, n] if k else -1) + 1] for n, side in enumerate((nominal, corrected))
        ]
        ends = [side.arc_length[found.pair[k, n] + 1] for n, side in enumerate((nominal, corrected))]
        assert (ways.begin[k], ways.end[k]) == (begins[0], ends[0])
        assert ways.corrected_span[k].tolist() == [begins[1], ends[1]]
    assert ways.is_comparable.tolist() == known
    way = [int(sum(found.pair[:, 1] < row)) for row in range(COUNT)]
    assert ways.stretch.tolist() == way
    kind = corrected.program.motions.kind
    is_known = [way[row] < 8 and known[way[row]] for row in range(COUNT)]
    additional = [int(row) for row in found.additional_rows if is_known[row] and kind[row] in (LIN, CIRC)]
    assert ways.targets(found).tolist() == sorted([*found.inserted_rows.tolist(), *additional])
    begins_uncorrected = starts_uncorrected(corrected)
    pieces = [
        r
        for r in corrected.target_rows.tolist()
        if kind[r] in (LIN, CIRC) and is_known[r] and not begins_uncorrected[r]
    ]
    assert ways.pieces().tolist() == pieces
    inside = np.array([row for row in range(COUNT) if way[row] < 8])
    expected = []
    for row in inside:
        begin, end = ways.corrected_span[way[row]]
        share = (corrected.arc_length[row + 1] - begin) / (end - begin)
        expected.append(ways.begin[way[row]] + share * (ways.end[way[row]] - ways.begin[way[row]]))
    np.testing.assert_allclose(ways.guessed_lengths(inside), expected)
    place = rng.uniform(0.0, 1.0, COUNT)
    rows = corrected.target_rows[corrected.target_rows < found.pair[-1, 1]]
    before = [corrected.target_rows[corrected.target_rows < row] for row in rows]
    begins = [place[b[-1]] if len(b) else ways.begin[way[row]] for b, row in zip(before, rows, strict=True)]
    np.testing.assert_allclose(ways.begin_lengths(rows, place), begins)


@pytest.mark.parametrize("seed", SEEDS)
def test_pieces_are_steep_where_their_ends_are_displaced_differently(seed):
    """By 0.2 mm, or where one of the two is not known."""
    rng = np.random.default_rng(seed)
    rows = np.sort(rng.choice(COUNT, 9, replace=False))
    place = np.where(rng.random(COUNT) < 0.8, rng.uniform(0.0, 1.0, COUNT), np.nan)
    displaced = np.cumsum(rng.choice([0.0, 1.5e-4, 2.5e-4], (COUNT, 1)) * np.eye(3)[rng.integers(0, 3, COUNT)], axis=0)
    arc_length = np.arange(COUNT + 1.0)
    nominal = SimpleNamespace(points=lambda length: np.stack([length, 2 * length, 0 * length], axis=1))

    def points(length):
        row = length.astype(int) - 1
        return nominal.points(np.nan_to_num(place[row])) + displaced[row]

    corrected = SimpleNamespace(points=points, arc_length=arc_length, target_rows=rows)
    expected = []
    for k, row in enumerate(rows):
        before = rows[max(k - 1, 0)]
        is_known = np.isfinite(place[[row, before]]).all()
        expected.append(not is_known or np.linalg.norm(displaced[row] - displaced[before]) > 2e-4)
    assert loaded_path._is_steep(nominal, corrected, rows, place).tolist() == expected


@pytest.mark.parametrize("seed", SEEDS)
def test_wrenches_at_pairs_are_in_the_base_of_the_nominal_program(monkeypatch, seed):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    bases = frames.pose_from_xyzabc(rng.uniform(-180.0, 180.0, (2, 6)))
    motions = replace(found.nominal.motions, base=rng.integers(0, 2, COUNT))
    found = replace(found, nominal=replace(found.nominal, bases=bases, motions=motions))
    monkeypatch.setattr(loaded_path, "_orientation_errors", lambda comparison, path, wrench: wrench[:, 0])
    wrench, nominal, corrected = rng.normal(size=(8, 6)), rng.normal(size=(8, 3)), rng.normal(size=(8, 3))
    cuts = loaded_path.pair_cuts(found, None, wrench, nominal_deviation=nominal, corrected_deviation=corrected)
    for k in range(8):
        axes = bases[motions.base[found.pair[k, 0]], :3, :3]
        expected = np.concatenate([axes.T @ wrench[k, :3], axes.T @ wrench[k, 3:]])
        np.testing.assert_allclose(cuts.wrench[k], expected, atol=1e-12)
    assert (cuts.nominal is nominal, cuts.corrected_deviation is corrected) == (True, True)
    np.testing.assert_array_equal(cuts.rotation, wrench[:, 0])
    assert all(len(getattr(cuts, name)) == 0 for name in ("row", "t", "nominal_distance", "length", "path_rotation"))


@pytest.mark.parametrize(
    ("ends", "count", "expected"),
    [
        ([1, 0, 1, 1, 0], 3, [0, 2, 3]), ([0, 1, 1, 0, 1], 3, [1, 2, 4]), ([1, 0, 1, 1, 0], 4, None),
        ([1, 0, 1, 1], 3, None), (None, 3, None),
    ],
)  # fmt: skip
def test_pairs_that_a_conversion_states_are_the_ends_of_motions(ends, count, expected):
    sides = SimpleNamespace(target_rows=np.arange(count)), SimpleNamespace(target_rows=np.arange(5))
    found = compare._stated_partners(*sides, None if ends is None else np.array(ends, dtype=bool))
    assert (None if found is None else found.tolist()) == expected


@pytest.mark.parametrize("seed", SEEDS)
def test_targets_without_a_partner_in_one_conversion_were_inserted_or_passed(seed):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    rest = np.setdiff1d(np.arange(COUNT), found.pair[:, 0])
    found = replace(
        found, passed_rows=rest[:1], passing_distance=np.array([1e-5]), only_nominal=rest[1:],
        missing_distance=rng.uniform(0.0, 1e-3, len(rest) - 1),
    )  # fmt: skip
    changed = compare._explain_as_inserted(found, SimpleNamespace(target_rows=np.arange(COUNT)))
    assert changed.passed_rows.tolist() == rest.tolist()
    np.testing.assert_array_equal(changed.passing_distance, [1e-5, *found.missing_distance])
    assert (len(changed.only_nominal), len(changed.missing_distance), len(changed.additional_rows)) == (0, 0, 0)
    assert changed.inserted_rows.tolist() == sorted([*found.inserted_rows, *found.additional_rows])


@pytest.mark.parametrize("has_load", [True, False])
@pytest.mark.parametrize("seed", SEEDS)
def test_points_of_lines_are_paired_only_where_the_other_path_misses_them(monkeypatch, seed, has_load):
    """Under a load a point that divides a line may be divided elsewhere; missing ones get their partner back."""
    rng = np.random.default_rng(seed)
    rows = np.arange(COUNT)
    partner = np.where(rng.random(COUNT) < 0.8, np.arange(COUNT), -1)
    certain, continued = rng.random(COUNT) < 0.3, rng.random(COUNT) < 0.5
    missing = rows[rng.random(COUNT) < 0.3]
    moved = np.where(rng.random(COUNT) < 0.1, np.arange(COUNT) // 2, -1)
    asked = []

    def paired(nominal, corrected, partners, is_certain):
        asked.append((partners.tolist(), is_certain.tolist()))
        return SimpleNamespace(partner=partners)

    def judged(pairs, nominal, corrected, load):
        assert load == ("forces" if has_load else None)
        return SimpleNamespace(only_nominal=missing, partner=pairs.partner)

    for name, function in (
        ("pair_targets", paired), ("judge_unpaired", judged), ("moved_partners", lambda *parts: moved.copy()),
        ("partners_of", lambda comparison, *parts: comparison.partner),
    ):  # fmt: skip
        monkeypatch.setattr(compare, name, function)
    loads = SimpleNamespace(path="forces") if has_load else None
    sides = SimpleNamespace(target_rows=rows, is_continued=continued), SimpleNamespace(target_rows=rows)
    found = compare._all_pairs(*sides, partner, certain, loads)
    divides = [bool(continued[k] and partner[k] >= 0 and not certain[k] and has_load) for k in range(COUNT)]
    first = [-1 if divides[k] else int(partner[k]) for k in range(COUNT)]
    assert asked[0] == (first, certain.tolist())
    displaced = [int(partner[k]) if k in missing and divides[k] else int(moved[k]) for k in range(COUNT)]
    if max(displaced) < 0:
        assert len(asked) == 1
        return
    both = [max(a, b) for a, b in zip(first, displaced, strict=True)]
    assert asked[1] == (partners.ordered_partners(np.array(both)).tolist(), [True] * COUNT)
    assert found.partner.tolist() == asked[1][0]


def test_stated_pairs_hold_under_a_load_and_others_follow_from_the_deflection(monkeypatch):
    """Targets are predicted against the deflection; pairs are certain where the loaded tip is within the tolerance."""
    rng = np.random.default_rng(2)
    deflection, wrench = rng.normal(size=(5, 3)), rng.normal(size=(5, 6))
    left = np.array([0.0, 0.9e-4, 1.0e-4, 1.1e-4, np.nan])[:, None] * np.array([[0.6, 0.0, -0.8]])
    robot_in_cell = SimpleNamespace(tolerance=1.05e-4)
    sides = (
        SimpleNamespace(track=lambda offset: ("first", offset), robot_in_cell=robot_in_cell),
        SimpleNamespace(track=lambda: "second"),
    )

    def swapped(nominal, corrected, partner, forces):
        assert (nominal, corrected) == sides
        np.testing.assert_array_equal(forces, wrench)
        return partner[::-1]

    def remaining(nominal, corrected, partner, forces):
        assert (nominal, corrected, partner.tolist()) == (*sides, [4, 3, 2, 1, 0])
        np.testing.assert_array_equal(forces, wrench)
        return left

    def paired(first, second):
        np.testing.assert_array_equal(first[1], -deflection)
        assert (first[0], second) == ("first", "second")
        return np.arange(5)

    for name, function in (
        ("partners", paired),
        ("partners_under_force", swapped),
        ("deviations_by_partners", remaining),
    ):
        monkeypatch.setattr(compare, name, function)
    loads = SimpleNamespace(deflection=deflection, wrench=wrench)
    partner, certain = compare._partners_under_load(*sides, loads, None)
    assert (partner.tolist(), certain.tolist()) == ([4, 3, 2, 1, 0], [True, True, True, False, False])
    partner, certain = compare._partners_under_load(*sides, loads, np.array([0, 2, -1]))
    assert (partner.tolist(), certain.tolist()) == ([0, 2, -1], [True] * 3)
