"""Targets of two programs find each other: paths made up here, with offsets and differences that are known."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.comparison.pairing import Track, partners

MM = 1e-3


def track(points, joint=None):
    step = np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=1)
    none = np.zeros(len(points), dtype=bool)
    return Track(np.asarray(points), step, none if joint is None else joint, none)


def pass_over_a_part(count, step=0.5 * MM):
    """A finishing pass: long straight rows of targets much nearer to each other than they are displaced."""
    along = np.arange(count) * step
    x, y = np.abs(along % 0.24 - 0.12), (along // 0.12) * 1e-4
    return np.stack([x, y, 3 * MM * np.sin(50 * x)], axis=1)


class Pair:
    """A path, and the same path displaced with targets inserted on it; `true` are the partners."""

    def __init__(self, points, offset, inserted, seed=0):
        rng, last = np.random.default_rng(seed), len(points)
        shifted, self.true = [], []
        for index in range(last):
            if index and rng.random() < inserted:
                for share in sorted(rng.uniform(0.1, 0.9, rng.integers(1, 4))):
                    shifted.append(points[index - 1] + share * (points[index] - points[index - 1]) + offset[index])
            self.true.append(len(shifted))
            shifted.append(points[index] + offset[index])
        self.points, self.shifted, self.true = points, np.array(shifted), np.array(self.true)

    def found(self, shifted=None):
        return partners(track(self.points), track(self.shifted if shifted is None else shifted))


def pair(count=400, inserted=0.03):
    points = pass_over_a_part(count)
    ramp = np.clip(np.arange(count) / 2, 0, 1)[:, None]
    return Pair(points, ramp * [1.2 * MM, -0.4 * MM, 0.3 * MM], inserted)


@pytest.mark.parametrize("inserted", [0.0, 0.03, 0.5])
def test_targets_displaced_by_more_than_they_are_apart_find_their_partners(inserted):
    case = pair(inserted=inserted)
    assert (case.found() == case.true).all()


@pytest.mark.parametrize("off", [0.1 * MM, 5 * MM, 50 * MM])
def test_a_target_that_was_moved_keeps_its_partner(off):
    case = pair()
    shifted = case.shifted.copy()
    shifted[case.true[150]] += [0.0, 0.0, off]
    assert (case.found(shifted) == case.true).all()


def test_a_line_that_is_missing_leaves_one_target_alone():
    case = pair()
    expected = case.true.copy()
    expected[200], expected[201:] = -1, expected[201:] - 1
    assert (case.found(np.delete(case.shifted, case.true[200], axis=0)) == expected).all()


def test_a_target_that_was_added_beside_the_path_has_no_partner():
    case = pair()
    place = case.true[100]
    shifted = np.insert(case.shifted, place, case.shifted[place] + [0.0, 0.0, 10 * MM], axis=0)
    assert (case.found(shifted) == case.true + (np.arange(len(case.true)) >= 100)).all()


def test_programs_that_command_the_same_are_paired_in_order_whatever_is_inserted():
    points = np.random.default_rng(3).uniform(-60 * MM, 60 * MM, (300, 3))
    case = Pair(points, np.zeros((300, 3)), 0.5)
    assert (case.found() == case.true).all()


def test_rapid_targets_go_with_rapid_ones():
    points = np.array([[0, 0, 20], [0, 0, 0], [10, 0, 0], [10, 0, 0.01], [30, 0, 0]]) * MM
    joint = np.array([True, False, False, True, False])
    other = np.insert(points, 3, points[2] + [1e-5, 0, 0], axis=0)
    found = partners(track(points, joint), track(other, np.insert(joint, 3, False)))
    assert found.tolist() == [0, 1, 2, 4, 5]


def test_a_program_with_fewer_targets_on_the_same_path_leaves_the_others_alone():
    case = pair(inserted=0.4)
    found = partners(track(case.shifted), track(case.points))
    expected = np.full(len(case.shifted), -1)
    expected[case.true] = np.arange(len(case.points))
    assert (found == expected).all()


@pytest.mark.parametrize("many", [20, 60])
def test_many_targets_inserted_on_one_step_do_not_lose_the_way(many):
    """More of them than partners are looked at: the place at the same length of path is where to look."""
    points = np.random.default_rng(5).uniform(-60 * MM, 60 * MM, (40, 3))
    shifted, true = [], []
    for index, point in enumerate(points):
        if index in (10, 25, 26):
            shifted += [points[index - 1] + share * (point - points[index - 1]) for share in np.arange(1, many) / many]
        true.append(len(shifted))
        shifted.append(point)
    offset = np.array([0.4, -0.3, 0.2]) * MM * np.linspace(1.0, 1.2, len(shifted))[:, None]
    assert partners(track(points), track(np.array(shifted) + offset)).tolist() == true


@pytest.mark.parametrize("length", [1, 3, 8, 20])
def test_a_section_that_is_passed_twice_has_partners_in_one_of_the_passes(length):
    """A spring pass: the other program repeats a part, and every target of the one has an equal partner."""
    points = np.random.default_rng(7).uniform(-60 * MM, 60 * MM, (40, 3))
    repeated = np.insert(points, 10 + length, points[10 : 10 + length], axis=0)
    found = partners(track(points), track(repeated))
    assert (np.diff(found) > 0).all()
    np.testing.assert_array_equal(repeated[found], points)
    assert (np.diff(found) > 1).sum() == 1, "the partners leave the repeated part once"
    back = partners(track(repeated), track(points))
    assert sorted(back[back >= 0].tolist()) == list(range(40))


def test_an_empty_program_has_no_pairs():
    points = pass_over_a_part(5)
    assert partners(track(points), track(points[:0])).tolist() == [-1] * 5
    assert partners(track(points[:0]), track(points)).tolist() == []
