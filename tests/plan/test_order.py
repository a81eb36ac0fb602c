from __future__ import annotations

from itertools import pairwise, permutations
from types import SimpleNamespace

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.plan import planning, search
from tests.plan import setting
from tests.plan.setting import BASIC, RIG

START = setting.CELL.start_joints


def test_the_order_is_the_shortest_of_all(tmp_path):
    site = setting.site(tmp_path, BASIC + RIG)
    rng = np.random.default_rng(2)
    q = np.radians([0.0, -80, 90, 0, 60, 0]) + rng.uniform(-0.5, 0.5, (6, 6))
    sequence, seconds, blocked = planning.least_travel(site, q)
    times = planning.travel_times(site, np.vstack([START, q]))
    lengths = [times[0, p[0] + 1] + sum(times[a + 1, b + 1] for a, b in pairwise(p)) for p in permutations(range(6))]
    assert len(blocked) == 0
    assert sorted(sequence) == list(range(6))
    assert seconds <= min(lengths) * 1.1
    assert seconds < np.median(lengths)


def test_the_slowest_joint_decides_how_long_a_move_takes(tmp_path):
    site = setting.site(tmp_path, BASIC + RIG)
    turned = START + np.radians([86.0, 0, 0, 0, 0, 0])  # A1 does 86°/s
    assert np.abs(planning.travel_times(site, np.array([START, turned]))[0, 1] - 1.0) < 1e-9


def test_a_way_through_an_obstacle_is_avoided(tmp_path):
    wall = "[[boxes]]\nname = 'wall'\nX = 1800\nZ = 1500\nsize = [1500, 100, 3000]\n"
    site = setting.site(tmp_path, BASIC + RIG + wall)
    left, right = (np.radians([[a1, -80, 95, 0, 60, 0]]) for a1 in (-60.0, 60.0))
    assert not planning.free_moves(site, np.vstack([left, right]))[0, 1]
    behind = np.radians([[100.0, -80, 95, 0, 60, 0]])
    assert planning.free_moves(site, np.vstack([right, behind]))[0, 1]
    # both on one side first, though the order given alternates
    start = np.radians([-100.0, -80, 95, 0, 60, 0])
    q = np.vstack([left, right, left + 0.1, right + 0.1])
    site = replace(site, start=start)
    sequence, _, blocked = planning.least_travel(site, q)
    assert sorted(sequence[:2]) == [0, 2]
    assert blocked.tolist() == [2]
    passed, stuck = planning.via_poses(site, q[sequence], blocked)
    assert stuck.tolist() == []
    stops = np.vstack([q[sequence[1]], passed[2], q[sequence[2]]])
    assert len(stops) > 2  # behind the wall, with the arm folded
    assert np.diag(planning.free_moves(site, stops), 1).all()


def test_a_pose_that_cannot_be_reached_on_a_free_way_is_told(tmp_path):
    wall = "[[boxes]]\nname = 'wall'\nX = 0\nY = -1100\nZ = 1500\nsize = [6000, 100, 6000]\n"
    site = setting.site(tmp_path, BASIC + RIG + wall)
    inside = np.radians([[90.0, -20, 40, 0, 40, 0]])  # stretched through the wall: not even passable
    _, stuck = planning.via_poses(site, inside, np.array([0]))
    assert stuck.tolist() == [0]


def test_no_turn_of_a_part_and_no_other_place_for_a_short_piece_makes_an_order_shorter():
    """Tours of nine at random, from any order; the first stays first."""
    rng, changed = np.random.default_rng(4), 0
    for _ in range(25):
        cost = rng.uniform(0.1, 1.0, (9, 9))
        cost = cost + cost.T
        tour = [0, *(1 + rng.permutation(8)).tolist()]

        def length(order, cost=cost):
            return sum(cost[a, b] for a, b in pairwise(order))

        while (better := planning._shorter_tour(tour, cost)) is not None:
            assert length(better) < length(tour)
            assert sorted(better) == list(range(9))
            tour, changed = better, changed + 1
        assert tour[0] == 0
        least = length(tour) - 1e-9
        for i in range(1, 9):
            assert all(length(tour[:i] + tour[i:j][::-1] + tour[j:]) >= least for j in range(i + 1, 10))
            for size in (1, 2, 3):
                rest = tour[:i] + tour[i + size :]
                assert all(length(rest[:j] + tour[i : i + size] + rest[j:]) >= least for j in range(1, len(rest) + 1))
    assert changed > 60


def test_a_move_is_looked_at_every_four_degrees_between_its_ends(tmp_path, monkeypatch):
    """And one place that is hit blocks its own move, both ways."""
    site = setting.site(tmp_path, BASIC + RIG)
    q = np.radians(
        [[0.0, -80, 90, 0, 60, 0], [9.0, -80, 91, 0, 60, 0], [0.0, -80, 90, 3, 60, 0], [0.0, -70, 90, 0, 43, 20]]
    )
    expected = []
    for a, b in ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)):
        steps = int(np.ceil(np.degrees(np.abs(q[b] - q[a]).max()) / 4.0 - 1e-9))
        expected += [(a, b, q[a] + k / steps * (q[b] - q[a])) for k in range(1, steps)]
    for hit in range(len(expected)):
        seen = []

        def passable(_, places, seen=seen, hit=hit):
            seen.append(places)
            return np.arange(len(places)) != hit

        monkeypatch.setattr(planning.constraints, "are_passable", passable)
        free = planning.free_moves(site, q)
        np.testing.assert_allclose(seen[0], [place for *_, place in expected], atol=1e-12)
        a, b, _ = expected[hit]
        blocked = np.zeros((4, 4), dtype=bool)
        blocked[a, b] = blocked[b, a] = True
        np.testing.assert_array_equal(~free, blocked)


def test_plans_of_other_sizes_are_from_two_fifths_to_twice_as_many_poses(monkeypatch):
    monkeypatch.setattr(search, "improve", lambda task, seed, **_: iter([SimpleNamespace(value=float(task.count))]))
    monkeypatch.setattr(search, "random_values", lambda task, seed, count: np.array([1.0, 2.0, 9.0]) * task.count)

    class Task(Struct, frozen=True):
        count: int
        levels: int
        fixed_count: int = 0

    found = list(search.criterion_by_number(Task(10, 5), 0, SimpleNamespace(value=99.0)))
    sizes = [5, 6, 8, 10, 14, 20]  # no fewer than levels
    assert found == [(count, 99.0 if count == 10 else float(count), 2.0 * count) for count in sizes]
    assert [row[0] for row in search.criterion_by_number(Task(10, 5, 1), 0, SimpleNamespace(value=1.0))] == [
        4,
        6,
        8,
        10,
        14,
        20,
    ]
