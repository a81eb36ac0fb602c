"""Collisions along a path: none between two samples is missed, and none is invented.

`python -m tests.collision.test_along --count 10000` tries as many random scenes.
"""

from __future__ import annotations

import argparse

import numpy as np
import pinocchio as pin
import pytest

from postproc.collision import Solids, bodies, clearance, hits, path_hits
from postproc.collision.along import motion_bound
from postproc.collision.distance import link_frames
from tests.collision.setting import frame, pose, random_scene, sampled, scene
from tests.kr270 import ROBOT


def check(rng) -> str:
    """Try one scene, and return what it was."""
    what, path, numbers = random_scene(rng)
    seen = sampled(path, numbers)
    need = float(rng.choice([0.0, 0.005, 0.05]))
    found = path_hits(what, path, need)
    assert found.closest is not None
    assert found.closest.distance <= seen.min() + 0.5e-3
    exact = np.array([clearance(what, path[:1] + s * (b - path[0])).distance[0] for b in path[1:2] for s in (0.0, 1.0)])
    assert found.closest.distance <= exact.min() + 1e-6
    hit = {int(first) for first in found.first}
    for body, distance in enumerate(seen):
        if distance < need - 1e-4 or distance == 0.0:
            assert body in hit, (distance, need)
        if body in hit:
            assert distance < need + 0.025  # the samples of the oracle are some 20 mm apart
    assert (found.distance <= need).all()
    return "hit" if hit else "free"


def test_random_scenes_against_dense_samples():
    rng = np.random.default_rng(33)
    kinds = [check(rng) for _ in range(24)]
    assert 4 < kinds.count("hit") < 22


def test_a_post_between_two_samples_is_not_missed():
    """A1 swings the spindle through a post that both ends of the motion are far from."""
    q = np.radians([[-60.0, -90.0, 90.0, 0.0, 0.0, 0.0], [60.0, -90.0, 90.0, 0.0, 0.0, 0.0]])
    tip = frame(np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]), 6)[:3, 3]
    post = bodies.box("post", -1, "obstacle", pose(np.eye(3), np.add(tip, [0.05, 0, 0])), np.array([0.02, 0.02, 1.0]))
    spindle = bodies.cylinder("spindle", 6, "tool", np.zeros(3), np.array([0, 0, 0.2]), 0.05)
    assert clearance(scene(spindle, post), q).distance.min() > 1.0
    found = path_hits(scene(spindle, post), q, 0.0)
    assert found.row.tolist() == [1]
    assert found.distance[0] == 0.0


def test_a_clearance_that_is_held_everywhere_is_no_hit():
    """The spindle sweeps along a plate at 30 mm; 29 are kept and 31 are not."""
    turn = np.linspace(-0.5, 0.5, 400)
    q = np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]) + turn[:, None] * np.eye(6)[0]
    height = frame(q[0], 6)[2, 3]
    plate = bodies.box("plate", -1, "obstacle", pose(np.eye(3), [0, 0, height - 0.58]), np.array([9.0, 9.0, 1.0]))
    spindle = bodies.cylinder("spindle", 6, "tool", np.zeros(3), np.array([0, 0, 0.2]), 0.05)
    kept, broken = (path_hits(scene(spindle, plate), q, need) for need in (0.029, 0.031))
    assert len(kept.row) == 0
    assert kept.closest.distance == pytest.approx(0.03, abs=0.5e-3)
    assert set(broken.row) == set(range(400))


@pytest.mark.parametrize("axis", [0, 4, 5])
def test_a_bar_that_turns_past_a_post_is_seen_at_every_sample(axis):
    """Against the distance at each of 700 samples: the search leaves most of them out, by how far the bar moves."""
    q = np.tile(np.radians([0.0, -90.0, 90.0, 0.0, 30.0, 0.0]), (700, 1))
    q[:, axis] += np.linspace(-1.6, 1.6, 700)
    bar = bodies.cylinder("bar", 6, "tool", np.zeros(3), np.array([0.9, 0.3, 0.2]), 0.03)
    at = frame(q[350], 6)
    post = bodies.box(
        "post", -1, "obstacle", pose(np.eye(3), at[:3, :3] @ [0.8, 0.3, 0.2] + at[:3, 3]), np.full(3, 0.1)
    )
    what = scene(bar, post)
    exact = clearance(what, q).distance
    found = path_hits(what, q, 0.05)
    close = np.flatnonzero(exact < 0.05)
    assert 10 < len(close) < 500
    assert set(close.tolist()) <= set(found.row.tolist()) <= set(close.tolist()) | {int(close[-1]) + 1}
    free = path_hits(what, q[: close[0] - 1], 0.05)
    assert free.closest.distance == pytest.approx(exact[: close[0] - 1].min(), abs=0.3e-3)
    assert len(free.row) == 0


def test_a_bar_that_turns_into_a_beam_about_the_middle_of_the_beam_is_seen():
    """A6 turns the bar about the middle of a beam: seen from the flange that middle does not move."""
    q = np.tile(np.radians([0.0, -90.0, 90.0, 0.0, 30.0, 0.0]), (700, 1))
    q[:, 5] += np.linspace(-1.4, 1.4, 700)
    bar = bodies.cylinder("bar", 6, "tool", np.array([0.4, 0.0, 0.2]), np.array([0.9, 0.0, 0.2]), 0.03)
    at = frame(q[350], 6)
    middle = pose(at[:3, :3], at[:3, :3] @ [0.0, 0.0, 0.2] + at[:3, 3])
    what = scene(bar, bodies.box("beam", -1, "obstacle", middle, np.array([2.0, 0.05, 0.05])))
    close = np.flatnonzero(clearance(what, q).distance < 0.05)
    assert 10 < len(close) < 300
    assert set(close.tolist()) <= set(path_hits(what, q, 0.05).row.tolist())


def test_a_long_path_far_from_everything_costs_little():
    turn = np.linspace(-0.5, 0.5, 20_000)
    q = np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]) + turn[:, None] * np.eye(6)[0]
    post = bodies.box("post", -1, "obstacle", pose(np.eye(3), [-5, 0, 0]), np.ones(3))
    spindle = bodies.cylinder("spindle", 6, "tool", np.zeros(3), np.array([0, 0, 0.2]), 0.05)
    assert path_hits(scene(spindle, post), q, 0.005).calls < 2000


@pytest.mark.parametrize("carrier", [0, 2, 5, 6])
def test_a_body_may_be_nearer_by_as_far_as_it_moves_to_the_commanded_angles(carrier):
    """Corners of a box, moved by joint frames of another library; the bound by its middle and its turn."""
    rng = np.random.default_rng(carrier)
    what = scene(
        bodies.box("b", carrier, "arm", pose(np.eye(3), [0.1, -0.2, 0.15]), np.array([0.2, 0.3, 0.1])),
        bodies.box("far", -1, "obstacle", pose(np.eye(3), [20, 0, 0]), np.ones(3)),
    )
    q = rng.uniform(ROBOT.lower, ROBOT.upper, (30, 6))
    off = rng.normal(0.0, 1e-3, (30, 6))
    corners = np.array([[x, y, z] for x in (0.0, 0.2) for y in (-0.35, -0.05) for z in (0.1, 0.2)])
    moved, bound, centre, radius = [], [], [0.1, -0.2, 0.15, 1.0], np.linalg.norm([0.1, 0.15, 0.05])
    for one, other in zip(q, q + off, strict=True):
        a, b = (frame(each, carrier) for each in (one, other))
        angle = np.linalg.norm(pin.log3(a[:3, :3].T @ b[:3, :3]))
        bound.append(np.linalg.norm((b - a) @ centre) + 2.0 * np.sin(0.5 * angle) * radius)
        moved.append(np.linalg.norm(corners @ (b[:3, :3] - a[:3, :3]).T + b[:3, 3] - a[:3, 3], axis=1).max())
    found = path_hits(what, q, 0.0, commanded_q=q + off)
    assert max(moved) <= found.largest_decrease
    assert found.largest_decrease == pytest.approx(1.001 * max(bound), rel=1e-6)  # of the arc, by its chord
    here = path_hits(what, q, 0.0)
    assert here.largest_decrease == 0.0
    assert found.closest.distance == pytest.approx(here.closest.distance - found.largest_decrease, abs=1e-3)


def test_the_way_out_of_a_contact_is_said_at_the_contact_alone():
    """A1 turns the spindle away from a post that it stands in, or into it: one hit, at the pose in contact."""
    q = np.radians([[0.0, -90.0, 90.0, 0.0, 0.0, 0.0], [60.0, -90.0, 90.0, 0.0, 0.0, 0.0]])
    post = bodies.box("post", -1, "obstacle", pose(np.eye(3), frame(q[0], 6)[:3, 3]), np.full(3, 0.2))
    spindle = bodies.cylinder("spindle", 6, "tool", np.zeros(3), np.array([0, 0, 0.2]), 0.05)
    solids = Solids(scene(spindle, post))
    assert hits(solids, q, 0.0).tolist() == [True, False]
    assert hits(solids, q[::-1], 0.0).tolist() == [False, True]


@pytest.mark.parametrize(
    ("carrier", "reference"), [(0, -1), (2, -1), (4, -1), (5, -1), (6, -1), (6, 2), (5, 1), (6, 3)]
)
def test_no_point_of_a_body_moves_further_than_the_bound(carrier, reference):
    """Corners of a box, moved by the joint frames of another library, between 40 pairs of poses; and the bound is near.

    A bound that is too small misses what stands between two samples.
    """
    rng = np.random.default_rng(10 * carrier + reference + 1)
    corner = np.array([[x, y, z] for x in (-0.1, 0.3) for y in (-0.2, 0.05) for z in (0.0, 0.5)])
    middle, edges = corner.mean(axis=0), np.ptp(corner, axis=0)
    solids = Solids(
        scene(
            bodies.box("b", carrier, "tool", pose(np.eye(3), middle), edges),
            bodies.box("c", reference, "obstacle" if reference < 0 else "arm", pose(np.eye(3), [9, 0, 0]), np.ones(3)),
        )
    )
    nearness = []
    for size in (0.003, 0.03, 0.3, 1.0):
        for _ in range(10):
            q = rng.uniform(ROBOT.lower, ROBOT.upper) + np.outer([0.0, 1.0], rng.normal(0.0, size, 6))
            bound = motion_bound(solids, 0, 1, q, link_frames(ROBOT.nominal, q))[0]
            there = []
            for share in np.linspace(0.0, 1.0, 21):
                between = q[0] + share * (q[1] - q[0])
                body_frame = np.linalg.solve(frame(between, reference), frame(between, carrier))
                there.append(corner @ body_frame[:3, :3].T + body_frame[:3, 3])
            way = [
                np.linalg.norm(point - there[0], axis=1) + np.linalg.norm(there[-1] - point, axis=1) for point in there
            ]
            assert np.max(way) <= bound
            frames = [frame(q[0], k)[:3, 3] for k in range(reference, carrier + 1)]
            reach = np.linalg.norm(np.diff(frames, axis=0), axis=1).sum() + np.linalg.norm(corner, axis=1).max()
            turned = np.abs(np.diff(q, axis=0))[0, reference + 1 : carrier + 1].sum()
            assert bound >= 0.25 * turned**2 * reach  # no tighter one is proved
            nearness.append(bound / np.max(way))
    assert np.median(nearness[:20]) < 3.0  # a bound that is far too large costs time alone


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--count", type=int, default=1000)
    options.add_argument("--seed", type=int, default=1)
    chosen = options.parse_args()
    random = np.random.default_rng(chosen.seed)
    outcomes = [check(random) for _ in range(chosen.count)]
    print(f"{chosen.count} scenes, {outcomes.count('hit')} with hits: none missed")
