"""The assignment of targets against plain loops over all assignments, with the costs that the module states."""

from __future__ import annotations

import math

import numpy as np
import pytest

from postproc.comparison import pairing
from postproc.comparison.pairing import Track

MM = 1e-3


def cost_of_pair(one, other, last, pair, start):
    """Cost of a pair (row, partner) after the last one; (−1, −1) before the first, with the offset `start` or None."""
    (r, p), (row, q) = last, pair
    step, way = one.step[r + 1 : row + 1].sum(), other.step[p + 1 : q + 1].sum()
    scale = min(0.1 * MM + step / 4, 1.0 * MM)
    offset = other.position[q] - one.position[row]
    before = other.position[p] - one.position[r] if r >= 0 else start
    cost = 0.0 if before is None else min(math.log1p(math.dist(offset, before) / scale), 1.2)
    cost += (0.5 if q == p + 1 else 1.0) * min(math.log1p(abs(way - step) / scale), 1.2)
    cost += 0.6 * min(abs(way - step) / (8 * MM), 1.0)
    return cost + 2.0 * (one.joint[row] != other.joint[q])


def cost_alone(one, first, last):
    return sum(2.0 if one.is_continued[row] else 3.2 for row in range(first, last))


def cost_of(one, other, partner, start):
    """Cost of a whole assignment (n,)."""
    total, last = 0.0, (-1, -1)
    for row, q in enumerate(partner):
        if q >= 0:
            total += cost_alone(one, last[0] + 1, row) + cost_of_pair(one, other, last, (row, q), start)
            last = row, q
    return total + cost_alone(one, last[0] + 1, len(one))


def least_cost(one, other, start):
    """Least cost of all assignments in order: each pair after each earlier one."""
    best = {(-1, -1): 0.0}
    for row in range(len(one)):
        for q in range(len(other)):
            best[row, q] = min(
                known + cost_alone(one, last[0] + 1, row) + cost_of_pair(one, other, last, (row, q), start)
                for last, known in best.items()
                if last[0] < row and last[1] < q
            )
    return min(known + cost_alone(one, last[0] + 1, len(one)) for last, known in best.items())


def track(random, points, joint):
    step = np.linalg.norm(np.diff(points, axis=0, prepend=points[:1] - random.uniform(0, 5 * MM, 3)), axis=1)
    return Track(points, step * random.choice([1.0, 1.2], len(points)), joint, random.random(len(points)) < 0.3)


def pair_of_tracks(seed):
    """Seven targets, and those of another program: moved, missing, additional and of another kind."""
    random = np.random.default_rng(seed)
    size = random.choice([0.6, 4.0, 25.0]) * MM
    points, joint = np.cumsum(random.normal(size=(7, 3)), axis=0) * size, random.random(7) < 0.2
    others, kinds = [], []
    offset = random.normal(size=3) * random.choice([0.02, 0.3]) * MM
    for point, kind in zip(points, joint, strict=True):
        if random.random() < 0.3:
            others.append(point + random.normal(size=3) * random.choice([0.3, 5.0]) * MM)
            kinds.append(False)
        if random.random() < 0.85:
            offset = offset + random.normal(size=3) * random.choice([0.03, 0.1, 1.0]) * MM
            others.append(point + offset)
            kinds.append(bool(kind) ^ (random.random() < 0.1))
    return track(random, points, joint), track(random, np.array(others), np.array(kinds)), random


@pytest.mark.parametrize("known", [False, True])
def test_no_other_assignment_costs_less(known):
    """With and without a pair before the first target; 25 pairs of programs each."""
    missing = 0
    for seed in range(25):
        one, other, random = pair_of_tracks(seed)
        start = random.normal(size=3) * 0.5 * MM if known else None
        at = random.normal(size=3)
        found = pairing._assign_partners(one, other, None if start is None else (at, at + start))
        paired = found[found >= 0]
        missing += len(found) - len(paired)
        assert (np.diff(paired) > 0).all()
        assert cost_of(one, other, found, start) == pytest.approx(least_cost(one, other, start), abs=1e-9), seed
    assert missing > 12


def test_targets_in_equal_places_after_equal_steps_are_paired_in_order_from_there_on():
    """Three equal ones are enough; what follows is assigned anew, from the last equal one."""
    random = np.random.default_rng(7)
    points = np.cumsum(random.normal(size=(20, 3)), axis=0) * 4 * MM
    for seed in range(30):
        random = np.random.default_rng(seed)
        gap, at = random.integers(4, 8), random.integers(0, 4)
        others = np.insert(points, at, points[at] + random.normal(size=3) * 9 * MM, axis=0)  # one more at the beginning
        others = np.delete(others, at + 1 + gap, axis=0)  # one less in the middle
        none = np.zeros(20, dtype=bool)
        one, other = (Track(each, np.linalg.norm(np.diff(each, axis=0, prepend=each[:1]), axis=1), none, none)
                      for each in (points, others))  # fmt: skip
        found = pairing._assign_partners(one, other, None)
        expected = np.arange(20) + (np.arange(20) >= at) - (np.arange(20) > at + gap)
        expected[at + gap] = -1
        assert (found == expected).all(), seed
        assert pairing._equal_count(one, other, at + 1, at + 2) == gap - 1


@pytest.mark.parametrize("what", ["position", "step", "joint"])
def test_equal_targets_are_counted_up_to_the_first_one_that_differs(what):
    random = np.random.default_rng(1)
    none = np.zeros(9, dtype=bool)
    one = Track(random.normal(size=(9, 3)), random.uniform(1, 9, 9) * MM, none, none)
    for by, limit in ((6e-6, 6), (4e-6, 9)) if what != "joint" else ((0, 6),):
        position, step, joint = one.position.copy(), one.step.copy(), none.copy()
        position[6, 1] += by * (what == "position")
        step[6] -= by * (what == "step")
        joint[6] ^= what == "joint"
        other = Track(position, step, joint, none)
        counts = [pairing._equal_count(one, other, k, k) for k in range(9)]
        assert counts == ([9 - k for k in range(9)] if limit == 9 else [6, 5, 4, 3, 2, 1, 0, 2, 1])


def settled(one, other, partner):
    """One pass in plain loops: all inner partners to the neighbour before, then all to the one behind."""
    row = [k for k, q in enumerate(partner) if q >= 0]
    out = list(partner)
    for step in (-1, 1):
        now = list(out)
        for place, k in list(enumerate(row))[1:-1]:
            before, behind = row[place - 1], row[place + 1]
            ends = [other.position[partner[n]] - one.position[n] for n in (before, behind)]
            change = [
                sum(math.dist(other.position[q] - one.position[k], end) for end in ends) if 0 <= q < len(other) else 9.0
                for q in (now[k] + step, now[k])
            ]
            q = now[k] + step
            if now[before] < q < now[behind] and other.joint[q] == one.joint[k] and change[0] < change[1]:
                out[k] = q
    return out


def test_partners_move_to_free_neighbours_where_offsets_then_change_less():
    moved = 0
    for seed in range(60):
        random = np.random.default_rng(seed)
        one, other, _ = pair_of_tracks(seed)
        partner = np.full(len(one), -1)
        rows = np.sort(random.choice(len(one), min(len(one), len(other)) - 2, replace=False))
        partner[rows] = np.sort(random.choice(len(other), len(rows), replace=False))
        found = partner.copy()
        pairing._settle_partners(one, other, found)
        assert found.tolist() == settled(one, other, partner), seed
        moved += (found != partner).sum()
    assert moved > 20


def test_equal_steps_at_the_beginning_are_taken_at_once_but_for_the_last_two():
    random = np.random.default_rng(2)
    none = np.zeros(12, dtype=bool)
    points = np.cumsum(random.normal(size=(12, 3)), axis=0) * 2 * MM
    step = np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=1)
    one = Track(points, step, none, none)
    scale = np.minimum(0.1 * MM + step / 4, 1.0 * MM)
    assert pairing._common_length(one, one) == 12
    shorter = pairing._part(one, slice(0, 9))
    assert pairing._common_length(one, shorter) == pairing._common_length(shorter, one) == 7
    for at, count in ((0, 0), (1, 0), (5, 3), (11, 9)):
        for share in (0.09, 0.11):
            moved, longer, joint = points.copy(), step.copy(), none.copy()
            moved[at:, 2] += share * scale[at]
            longer[at] -= share * scale[at]
            for other in (Track(moved, step, none, none), Track(points, longer, none, none)):
                assert pairing._common_length(one, other) == (count if share > 0.1 else 12), (at, share)
            joint[at] = True
            assert pairing._common_length(one, Track(points, step, joint, none)) == count
            both = Track((points + moved) / 2, (step + longer) / 2, none, none)  # half of each, together as much
            assert pairing._common_length(one, both) == (count if share > 0.1 else 12)


def test_a_track_backwards_has_the_steps_between_the_same_targets():
    random = np.random.default_rng(3)
    points = random.normal(size=(6, 3))
    step = np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=1)
    back = pairing._reverse_track(Track(points, step, np.arange(6) < 2, np.arange(6) == 4))
    np.testing.assert_array_equal(back.position, points[::-1])
    np.testing.assert_allclose(back.step[1:], [math.dist(points[k], points[k + 1]) for k in (4, 3, 2, 1, 0)])
    assert back.joint.tolist() == [False] * 4 + [True] * 2
    assert back.is_continued.tolist() == [False, True] + [False] * 4
