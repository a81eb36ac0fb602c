"""Which places become targets, against a recursion for lines and a loop for arcs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from postproc.correction.targets import CommandedPath, arc_pieces, choose_samples
from postproc.poses import Poses
from postproc.program import CIRC, LIN, PTP, SPL
from postproc.toolpath import Pieces, Toolpath

LIMIT = 4e-6
KINDS = np.array([PTP, LIN, CIRC, LIN, SPL, LIN, CIRC, LIN])
STRETCHES = ((2, 0.0, 0.4, 3, 2.0), (2, 0.4, 1.0, 2, 5.0), (6, 0.0, 1.0, 4, 11.0))
"""Motion, begin, end, pieces and least samples of stretches of arcs."""
LEAST = (3e-4, np.radians(0.5))


def commanded(seed):
    """A path whose lines are bent by some limits, and whose arcs are arcs of some radii, wide ones among them."""
    rng = np.random.default_rng(seed)
    columns = (np.array(column) for column in zip(*STRETCHES, strict=True))
    motion, begin, end, number, samples = columns
    arcs = Pieces(motion, begin, end, number, np.ones(3, int), samples, np.zeros(3, bool))
    rows, start, last = [], np.empty((8, 3)), np.zeros(3)
    for k, kind in enumerate(KINDS):
        start[k] = last + np.array([0.0, 1e-3, 0.0]) * (k == 5)  # the base changes
        if kind == CIRC:
            t = np.concatenate([
                b + (e - b) * np.arange(1, n * each + 1) / (n * each)
                for (m, b, e, n, _), each in zip(STRETCHES, arcs.samples_per_piece, strict=True) if m == k
            ])  # fmt: skip
            radius = 10 ** rng.uniform(-3.5, 1.0)
            angle = min(5.0, 0.02 / radius) * t
            flat = radius * np.column_stack([np.cos(angle) - 1.0, np.sin(angle), 0 * t])
            place = start[k] + Rotation.random(random_state=rng).apply(flat)
        else:
            t = np.append(np.sort(rng.uniform(0.0, 0.95, rng.integers(0, 40) if kind == LIN else 3)), 1.0)
            place = start[k] + 0.05 * t[:, None] * rng.normal(size=3)
            place += 1e-4 * np.outer(
                np.sin(rng.uniform(0.0, 9.0) * t) + 0.02 * rng.normal(size=len(t)), rng.normal(size=3)
            )
        rows += list(zip([k] * len(t), t, place, strict=True))
        last = place[-1]
    motion, t, place = (np.array(column) for column in zip(*rows, strict=True))
    pose = np.tile(np.eye(4), (len(t), 1, 1))
    return CommandedPath(Toolpath(motion, t, Poses.of(pose), 0 * t), arcs, place, start, LIMIT)


def divided(t, place):
    """Rows of the ends of pieces of a line; row 0 is its start."""
    share = ((t - t[0]) / (t[-1] - t[0]))[:, None]
    miss = np.linalg.norm(place - place[0] - share * (place[-1] - place[0]), axis=1)[1:-1]
    if not len(miss) or miss.max() <= LIMIT:
        return [len(t) - 1]
    cut = 1 + int(np.argmax(miss))
    return divided(t[: cut + 1], place[: cut + 1]) + [cut + row for row in divided(t[cut:], place[cut:])]


def is_line(a, b, c):
    """Whether the arc from a through b to c is no arc to a controller, or flat to a micrometre on a metre."""
    chord, first = c - a, b - a
    length = np.linalg.norm(chord)
    if length == 0.0:
        return False
    height = np.linalg.norm(np.cross(chord, first)) / length
    angle = np.arctan2(height, first @ chord / length)
    return height < 1e-6 or min(length, np.linalg.norm(first)) < LEAST[0] or angle < LEAST[1]


def by_loops(path, whole, every):
    """Row, kind and auxiliary row of each target."""
    out, sample = [], path.sample
    for k, kind in enumerate(KINDS):
        own = np.flatnonzero(sample.motion == k)
        if every[k]:
            targets = [(row, kind, -1) for row in own]
        elif whole[k] or kind in (PTP, SPL):
            targets = [(own[-1], kind, -1)]
        elif kind == LIN:
            t, place = np.append(0.0, sample.t[own]), np.vstack([path.start[k], path.position[own]])
            targets = [(own[row - 1], LIN, -1) for row in divided(t, place)]
        else:
            targets, row = [], own[0]
            for (m, _, _, number, _), each in zip(STRETCHES, path.arcs.samples_per_piece, strict=True):
                for _ in range(number if m == k else 0):
                    before = path.start[k] if row == own[0] else path.position[row - 1]
                    middle, end = row + each // 2 - 1, row + each - 1
                    line = is_line(before, path.position[middle], path.position[end])
                    targets.append((end, LIN, -1) if line else (end, CIRC, middle))
                    row += each
        out += targets
    return out


@pytest.mark.parametrize("seed", range(12))
def test_targets_are_those_of_the_recursion_and_of_the_loop(seed):
    path = commanded(seed)
    nothing, rng = np.zeros(8, bool), np.random.default_rng(seed)
    whole, every = rng.random(8) < 0.2, (rng.random(8) < 0.2) & (KINDS != CIRC)
    for kept, all_ in ((nothing, nothing), (whole, nothing), (nothing, every)):
        found = np.transpose(choose_samples(path, KINDS, kept, all_, LEAST))
        np.testing.assert_array_equal(found, by_loops(path, kept, all_))


def test_both_kinds_of_pieces_and_of_lines_are_among_them():
    found = [
        np.transpose(choose_samples(commanded(seed), KINDS, np.zeros(8, bool), np.zeros(8, bool), LEAST))
        for seed in range(12)
    ]
    on_arcs = [kind for rows, seed in zip(found, range(12), strict=True)
               for row, kind, _ in rows if commanded(seed).sample.motion[row] in (2, 6)]  # fmt: skip
    assert min(np.bincount(on_arcs)[[LIN, CIRC]]) > 10
    assert max(len(rows) for rows in found) > 30


@pytest.mark.parametrize("seed", range(6))
def test_as_many_pieces_of_an_arc_are_needed_as_what_twice_as_large_ones_miss_asks_for(seed):
    """What a circle misses falls with the square of its length, about: the number by the root, rounded up."""
    rng = np.random.default_rng(seed)
    arcs = Pieces(np.array([2, 2, 6]), np.array([0.0, 0.4, 0.0]), np.array([0.4, 1.0, 1.0]), np.array([4, 2, 6]),
                  np.array([1, 2, 1]), np.array([3.0, 4.0, 20.0]), np.array([True, False, True]))  # fmt: skip
    path = commanded(seed)
    motion, t, place, size = [0], [1.0], [np.zeros(3)], arcs.number * arcs.samples_per_piece
    for s in range(3):
        share = np.arange(1, size[s] + 1) / size[s]
        here = arcs.begin[s] + (arcs.end[s] - arcs.begin[s]) * share
        motion += [int(arcs.motion[s])] * size[s]
        t += here.tolist()
        bend = 1e-4 * rng.uniform(0.01, 1.0) * np.sin(7.0 * here)
        place += list(np.column_stack([0.05 * np.cos(2 * here), 0.05 * np.sin(2 * here), bend]))
    sample = Toolpath(np.array(motion), np.array(t), Poses.of(np.tile(np.eye(4), (len(t), 1, 1))), np.zeros(len(t)))
    start = np.tile([0.05, 0.0, 0.0], (8, 1))
    path = CommandedPath(sample, arcs, np.array(place), start, LIMIT)
    found = arc_pieces(path)
    first = 1 + np.cumsum(size) - size
    for s in range(3):
        if not arcs.uncertain[s]:
            assert found.number[s] == max(arcs.number[s], arcs.min_number[s])
            continue
        worst = 0.0
        for pair in range(arcs.number[s] // 2):
            rows = (
                first[s] + 2 * pair * arcs.samples_per_piece[s] + np.arange(1, 5) * arcs.samples_per_piece[s] // 2 - 1
            )
            begin = (
                start[0]
                if pair == 0 and arcs.begin[s] == 0.0
                else path.position[rows[0] - arcs.samples_per_piece[s] // 2]
            )
            spots = np.vstack([begin, path.position[rows]])
            worst = max(worst, missed_at_quarters(spots))
        expected = int(np.ceil(arcs.number[s] // 2 * np.sqrt(worst / LIMIT)))
        assert found.number[s] == max(expected, arcs.min_number[s])
    assert not found.uncertain.any()


def missed_at_quarters(spots):
    """What the circle through the first, third and fifth of five spots misses of the others."""
    a, b, c = spots[0], spots[2], spots[4]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    centre = np.linalg.solve(
        [b - a, c - a, normal], [(b - a) @ (a + b) / 2, (c - a) @ (a + c) / 2, normal @ a]
    )  # fmt: skip
    one, last = a - centre, c - centre
    angle = np.arctan2(np.cross(one, last) @ normal, one @ last) % (2 * np.pi)
    return max(
        np.linalg.norm(spots[k] - centre - Rotation.from_rotvec(normal * angle * k / 4).apply(one)) for k in (1, 3)
    )
