from __future__ import annotations

from itertools import pairwise, permutations

import numpy as np
from msgspec.structs import replace

from postproc.plan import planning
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
    passed, stuck = planning.detours(site, q[sequence], blocked)
    assert stuck.tolist() == []
    stops = np.vstack([q[sequence[1]], passed[2], q[sequence[2]]])
    assert len(stops) > 2  # behind the wall, with the arm folded
    assert np.diag(planning.free_moves(site, stops), 1).all()


def test_a_pose_that_cannot_be_reached_on_a_free_way_is_told(tmp_path):
    wall = "[[boxes]]\nname = 'wall'\nX = 0\nY = -1100\nZ = 1500\nsize = [6000, 100, 6000]\n"
    site = setting.site(tmp_path, BASIC + RIG + wall)
    inside = np.radians([[90.0, -20, 40, 0, 40, 0]])  # stretched through the wall: not even passable
    _, stuck = planning.detours(site, inside, np.array([0]))
    assert stuck.tolist() == [0]
