"""A robot that an axis carries past obstacles: distances by formulas, at each sample and between any two."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.collision import Solids, bodies, hits, pair_hits, path_hits
from postproc.collision.distance import link_frames
from tests.collision.setting import frame, pose, scene
from tests.collision.test_bodies import ring
from tests.kr270 import ROBOT

Q = np.radians([20.0, -80.0, 100.0, 30.0, 60.0, 10.0])
TIP = np.linalg.solve(frame(Q, 6), np.append(frame(Q, 6)[:3, 3] + [0.3, 0.2, 0.1], 1.0))[:3]
"""Of the flange frame: 0.3, 0.2, 0.1 m beside the flange in the root [m]."""
START = frame(Q, 6)[:3, 3] + [0.3, 0.2, 0.1]
RADIUS = 0.05
HALF = 0.1
ROUNDING = 1e-5
"""Of distances to a round body [m]: they are found by iteration."""


def ball() -> bodies.Body:
    """A ball of 50 mm (a capsule of no length) around the tip."""
    return bodies.capsule("ball", 6, "tool", TIP, TIP + 1e-9, RADIUS)


def post(name: str, place) -> bodies.Body:
    """A cube of 200 mm around a point, seen from where the tip starts."""
    return bodies.box(name, -1, "obstacle", pose(np.eye(3), START + place), np.full(3, 2 * HALF))


def distances(place, moved) -> np.ndarray:
    """Distance of ball and cube (n,) when the robot is carried by `moved` (n, 3) [m]."""
    beside = np.maximum(np.abs(moved - np.array(place)) - HALF, 0.0)
    return np.maximum(np.linalg.norm(beside, axis=1) - RADIUS, 0.0)


def least(place, moved) -> np.ndarray:
    """Smallest distances (n - 1,) between places: convex along a line, so that thirds are left out again and again."""
    low, high = np.zeros(len(moved) - 1), np.ones(len(moved) - 1)
    step = np.diff(moved, axis=0)
    for _ in range(80):
        first, second = low + (high - low) / 3, high - (high - low) / 3
        is_lower = distances(place, moved[:-1] + first[:, None] * step) < distances(
            place, moved[:-1] + second[:, None] * step
        )
        low, high = np.where(is_lower, low, first), np.where(is_lower, second, high)
    return distances(place, moved[:-1] + low[:, None] * step)


def path(seed: int, count: int) -> np.ndarray:
    """Places along X from -1 to 3 m, at uneven steps, and a little aside."""
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(-1.0, 3.0, count))
    return np.stack([x, *rng.uniform(-0.004, 0.004, (2, count))], axis=1)


PLACES = {"left": (0.0, 0.25, 0.0), "right": (1.1, -0.21, 0.0), "above": (2.2, 0.0, 0.165)}


def expected_hits(moved, place, need: float, slack: float) -> set[int]:
    """Samples at or before which the cube is closer than `need`, by as much as `slack` at least."""
    there = distances(place, moved)
    is_between = (np.minimum(there[:-1], there[1:]) >= need) & (least(place, moved) < need - slack)
    return set(np.flatnonzero(there < need - slack).tolist()) | set((np.flatnonzero(is_between) + 1).tolist())


@pytest.mark.parametrize(("seed", "count"), [(1, 12), (2, 40), (3, 150), (4, 64), (5, 65), (6, 2)])
@pytest.mark.parametrize("need", [0.012, 0.06, 0.11])
def test_hits_and_the_smallest_distance_are_those_of_the_drawing(seed, count, need):
    """0.1 mm on both sides of the limit are left open: shorter motions are not halved."""
    moved, what = path(seed, count), scene(ball(), *(post(name, place) for name, place in PLACES.items()))
    result = path_hits(what, np.tile(Q, (count, 1)), need, moved)
    surely, perhaps = set(), set()
    for number, place in enumerate(PLACES.values(), 1):
        surely |= {(row, 0, number) for row in expected_hits(moved, place, need, 1e-4)}
        left = np.flatnonzero(least(place, moved) < need + 1e-4) + 1  # the search may see it on the way out, too
        perhaps |= {(row, 0, number) for row in {*expected_hits(moved, place, need, -1e-4), *left.tolist()}}
    listed = list(zip(result.row.tolist(), result.first.tolist(), result.second.tolist(), strict=True))
    assert listed == sorted(listed)
    assert surely <= set(listed) <= perhaps
    smallest = np.array([least(place, moved) for place in PLACES.values()])
    for (row, _, number), distance in zip(listed, result.distance, strict=True):
        at_row = distances(list(PLACES.values())[number - 1], moved[row : row + 1])[0]
        assert smallest[number - 1, max(row - 1, 0)] - ROUNDING <= distance < need
        assert distance <= at_row + ROUNDING or at_row >= need
    exact = smallest.min()
    assert exact - ROUNDING <= result.closest.distance <= exact + 0.25e-3
    near = smallest[result.closest.second - 1, max(result.closest.row - 1, 0) : result.closest.row + 1]
    assert near.min() <= exact + 0.25e-3
    assert result.closest.first == 0
    assert result.largest_decrease == 0.0


@pytest.mark.parametrize(("seed", "count"), [(1, 12), (3, 150), (8, 3)])
def test_samples_alone_are_looked_at_where_that_is_asked_for(seed, count):
    moved, what = path(seed, count), scene(ball(), *(post(name, place) for name, place in PLACES.items()))
    q, need = np.tile(Q, (count, 1)), 0.06
    at_samples = np.min([distances(place, moved) for place in PLACES.values()], axis=0)
    there = hits(Solids(what), q, need, moved, between_samples=False)
    np.testing.assert_array_equal(there, at_samples < need)
    surely, perhaps = (
        set().union(*(expected_hits(moved, place, need, slack) for place in PLACES.values())) for slack in (1e-4, -1e-4)
    )
    assert surely <= set(np.flatnonzero(hits(Solids(what), q, need, moved)).tolist()) <= perhaps


def test_bodies_that_touch_are_a_hit_even_if_no_distance_is_asked_for():
    """The ball grazes nothing at 1 mm, and is 1 mm deep in the cube on the other path."""
    for beside, is_hit in ((0.151, False), (0.149, True)):
        moved = np.stack([np.linspace(-1, 1, 7), np.zeros(7), np.zeros(7)], axis=1)
        result = path_hits(scene(ball(), post("cube", (0.0, beside, 0.0))), np.tile(Q, (7, 1)), 0.0, moved)
        assert (len(result.row) > 0) is is_hit
        assert result.closest.distance == pytest.approx(0.0 if is_hit else 0.001, abs=0.25e-3)
        if is_hit:
            assert result.distance.max() == 0.0


@pytest.mark.parametrize(("aside", "rows"), [(0.25, [0]), (0.0, [])])
def test_a_path_that_never_leaves_the_material_of_a_ring_is_a_hit_and_one_in_its_hole_is_not(aside, rows):
    """The surfaces do not touch: the ball is 50 mm below the surface, or 200 mm off it."""
    small_ball = bodies.capsule("ball", 6, "tool", TIP, TIP + 1e-9, 1e-3)
    what = scene(small_ball, ring(pose(np.eye(3), START - [aside, 0.0, 0.0])))
    moved = np.linspace([0.0, 0.0, -0.1], [0.0, 0.0, 0.1], 20)
    result = path_hits(what, np.tile(Q, (20, 1)), 0.0, moved)
    assert result.row.tolist() == rows
    assert result.distance.tolist() == [0.0] * len(rows)


def test_one_pose_and_no_pose_are_paths_too():
    what = scene(ball(), post("cube", (0.3, 0.0, 0.0)))
    alone = path_hits(what, Q[None], 0.2, np.zeros((1, 3)))
    assert alone.row.tolist() == [0]
    assert alone.distance[0] == pytest.approx(0.15, abs=ROUNDING)
    assert alone.closest.row == 0
    for none in (path_hits(what, np.zeros((0, 6)), 0.2), path_hits(scene(ball()), Q[None], 0.2)):
        assert none.closest is None
        assert len(none.row) == len(none.first) == len(none.second) == len(none.distance) == 0
    assert hits(Solids(what), np.zeros((0, 6)), 0.2).shape == (0,)
    assert hits(Solids(what), Q[None], 0.2).tolist() == [True]


def test_distances_are_computed_where_they_can_count_alone():
    """A ball that passes a cube at 4000 samples: most of the path is decided by a few distances."""
    moved = np.stack([np.linspace(-5, 5, 4000), np.zeros(4000), np.zeros(4000)], axis=1)
    q = np.tile(Q, (4000, 1))
    result = path_hits(scene(ball(), post("cube", (0.0, 0.25, 0.0))), q, 0.02, moved)
    assert result.closest.distance == pytest.approx(0.1, abs=0.25e-3)
    assert len(result.row) == 0
    assert result.calls < 800  # all between the first and the last at which a smaller distance is possible


def test_only_the_pairs_that_are_given_are_compared():
    what = scene(ball(), *(post(name, place) for name, place in PLACES.items()))
    moved = path(3, 60)
    result = pair_hits(Solids(what, [(0, 2)]), np.tile(Q, (60, 1)), 0.11, moved)
    assert set(result.second) == {2}
    assert result.closest.distance == pytest.approx(least(PLACES["right"], moved).min(), abs=0.25e-3)


def test_frames_of_all_links_are_those_of_another_library_carried_by_the_axis():
    rng = np.random.default_rng(4)
    q, moved = rng.uniform(ROBOT.lower, ROBOT.upper, (3, 6)), rng.normal(0, 1, (3, 3))
    for shift in (None, moved):
        frames = link_frames(ROBOT.nominal, q, shift)
        for row in range(3):
            for carrier in range(-1, 7):
                expected = frame(q[row], carrier).copy()
                expected[:3, 3] += 0.0 if shift is None else moved[row]
                np.testing.assert_allclose(frames[row, carrier + 1], expected, atol=1e-12)


def test_two_bodies_of_the_arm_move_with_it_and_keep_their_distance():
    """Both are carried along: an axis that carries the robot brings them no closer, and an obstacle comes closer."""
    fixed = bodies.box("vice", -1, "obstacle", pose(np.eye(3), START + np.array([0.0, 5.0, 0.0])), np.full(3, 0.2))
    foot = bodies.box("foot", -1, "arm", pose(np.eye(3), START + np.array([0.0, 0.5, 0.0])), np.full(3, 0.2))
    moved = np.stack([np.zeros(9), np.linspace(0.0, 4.0, 9), np.zeros(9)], axis=1)
    result = path_hits(scene(foot, ball(), fixed), np.tile(Q, (9, 1)), 0.36, moved)
    assert {(int(a), int(b)) for a, b in zip(result.first, result.second, strict=True)} == {(1, 0)}
    assert result.row.tolist() == list(range(9))
    np.testing.assert_allclose(result.distance, 0.35, atol=ROUNDING)
    nearer = path_hits(scene(ball(), fixed), np.tile(Q, (9, 1)), 0.9, moved)
    assert nearer.closest.distance == pytest.approx(5.0 - 4.0 - 0.1 - 0.05, abs=ROUNDING)
