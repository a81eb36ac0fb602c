"""Distances of bodies at poses against closed forms; meshes against the solids that they approximate."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from msgspec.structs import replace

from postproc import cell as cells
from postproc import robot
from postproc.cell import Collision, HolderTable
from postproc.collision import Scene, bodies, clearance
from tests.collision.setting import frame, from_box, pose, random_scene, sampled, scene
from tests.kr270 import CELL, CELL_TEXT, ROBOT

HALF_MM = 0.5e-3


def poses(count, seed):
    return np.random.default_rng(seed).uniform(ROBOT.lower, ROBOT.upper, (count, 6))


def plane(place):
    """A box so large that its upper face is a plane, z = 0 of `place`."""
    lower = place.copy()
    lower[:3, 3] -= 50.0 * place[:3, 2]
    return bodies.box("table", -1, "obstacle", lower, np.array([100.0, 100.0, 100.0]))


@pytest.mark.parametrize("carrier", [0, 2, 5, 6])
def test_a_capsule_and_a_plane(carrier):
    rng = np.random.default_rng(carrier)
    begin, end, radius = rng.normal(0, 0.2, 3), rng.normal(0, 0.2, 3), 0.11
    turn = pin.exp3(rng.normal(0, 1, 3))
    place = pose(turn, -1.0 * turn[:, 2])
    q = poses(60, carrier)
    found = clearance(scene(bodies.capsule("c", carrier, "arm", begin, end, radius), plane(place)), q)
    for row, distance in zip(q, found.distance, strict=True):
        at = frame(row, carrier)
        ends = np.stack([begin, end]) @ at[:3, :3].T + at[:3, 3]
        height = (ends - place[:3, 3]) @ place[:3, 2]
        assert distance == pytest.approx(max(height.min() - radius, 0.0), abs=HALF_MM)
    assert (found.distance > 0).any()


def test_a_cylinder_and_a_plane():
    rng = np.random.default_rng(9)
    begin, end, radius = rng.normal(0, 0.2, 3), rng.normal(0, 0.2, 3), 0.08
    axis = (end - begin) / np.linalg.norm(end - begin)
    place = pose(np.eye(3), [0, 0, -2.0])
    q = poses(80, 3)
    found = clearance(scene(bodies.cylinder("c", 6, "tool", begin, end, radius), plane(place)), q)
    for row, distance in zip(q, found.distance, strict=True):
        at = frame(row, 6)
        low = min((at[:3, :3] @ point + at[:3, 3])[2] for point in (begin, end))
        drop = radius * np.sqrt(1.0 - (at[:3, :3] @ axis)[2] ** 2)
        assert distance == pytest.approx(max(low - drop + 2.0, 0.0), abs=HALF_MM)


def test_a_cylinder_upright_above_at_the_side_and_at_the_edge_of_a_box():
    q = np.radians([[0.0, -90.0, 90.0, 0.0, 0.0, 0.0]])
    here = frame(q[0], 6)
    inv = np.linalg.inv(here)
    part = bodies.box("b", -1, "obstacle", pose(np.eye(3), [1.0, 0.0, 0.5]), np.array([0.4, 0.6, 1.0]))
    for middle, expected in (
        ([1.0, 0.0, 1.25], 0.05), ([1.5, 0.0, 0.5], 0.26), ([1.0, -0.5, 0.5], 0.16),
        ([1.5, 0.7, 0.5], np.hypot(0.3, 0.4) - 0.04), ([1.34, 0.0, 1.3], np.hypot(0.1, 0.1)), ([1.1, 0.1, 0.9], 0.0),
    ):  # fmt: skip
        ends = [inv[:3, :3] @ (np.add(middle, [0, 0, z])) + inv[:3, 3] for z in (-0.2, 0.2)]
        found = clearance(scene(bodies.cylinder("c", 6, "tool", *ends, 0.04), part), q)
        assert found.distance[0] == pytest.approx(expected, abs=HALF_MM), middle


def test_a_mesh_is_as_far_as_the_solid_that_it_is_made_of():
    """A ring, which is not convex, against a sphere in its hole: the hole is free, and the wall is not."""
    q = np.radians([[0.0, -90.0, 90.0, 0.0, 0.0, 0.0]])
    at = frame(q[0], 6)
    ring = trimesh.creation.annulus(r_min=0.2, r_max=0.3, height=0.4, sections=256, transform=at)
    points, faces = np.asarray(ring.vertices), np.asarray(ring.faces)
    body = bodies.Body("ring", -1, "obstacle", "mesh", (), np.eye(4), points, faces)
    for x, expected in ((0.0, 0.15), (0.1, 0.05), (0.25, 0.0)):
        tip = np.array([x, 0.0, 0.0])
        ball = bodies.capsule("ball", 6, "tool", tip, np.add(tip, [0, 0, 1e-4]), 0.05)
        assert clearance(scene(ball, body), q).distance[0] == pytest.approx(expected, abs=HALF_MM)


def test_what_is_wholly_inside_a_mesh_touches_it():
    q = np.radians([[0.0, -90.0, 90.0, 0.0, 0.0, 0.0]])
    ring = trimesh.creation.annulus(r_min=0.2, r_max=0.9, height=1.4, sections=64, transform=frame(q[0], 6))
    body = bodies.Body("r", -1, "obstacle", "mesh", (), np.eye(4), np.asarray(ring.vertices), np.asarray(ring.faces))
    inside = np.array([0.5, 0.0, 0.0])
    ball = bodies.capsule("ball", 6, "tool", inside, np.add(inside, [0, 0, 0.01]), 0.02)
    assert clearance(scene(ball, body), q).distance[0] == 0.0
    hole = bodies.capsule("ball", 6, "tool", np.zeros(3), np.array([0, 0, 0.01]), 0.02)
    assert clearance(scene(hole, body), q).distance[0] == pytest.approx(0.18, abs=HALF_MM)


def test_random_scenes_against_dense_samples():
    rng = np.random.default_rng(21)
    for _ in range(60):
        what, path, numbers = random_scene(rng)
        exact = clearance(what, path[:1]).distance[0]
        seen = sampled(path[:1], numbers).min()
        assert exact <= seen + HALF_MM
        assert exact >= seen - 0.02  # points of the cylinder are 20 mm apart


def test_the_bodies_that_are_nearest_are_named():
    q = poses(20, 5)
    far = bodies.box("far", -1, "obstacle", pose(np.eye(3), [50, 0, 0]), np.ones(3))
    near = bodies.box("near", -1, "obstacle", pose(np.eye(3), [0, 0, -9]), np.ones(3))
    spindle = bodies.cylinder("spindle", 6, "tool", np.zeros(3), np.array([0, 0, 0.2]), 0.05)
    found = clearance(scene(spindle, far, near), q)
    assert set(found.first) == {0}
    assert set(found.second) == {2}


def test_from_box_itself():
    assert from_box(np.array([[2.0, 0, 0], [0, 0, 0], [1.5, 1.5, 0]]), np.eye(4), (2, 2, 2)) == pytest.approx(
        [1.0, 0.0, np.sqrt(0.5)]
    )


@pytest.mark.parametrize("name", robot.shipped_models())
def test_a_free_arm_does_not_touch_itself(name):
    """Assumed capsules invent no collision of the arm with itself around the usual pose; a long tool bar does hit."""
    arm = robot.load(robot.find(name))
    cell = replace(CELL, collision=Collision())
    rng = np.random.default_rng(1)
    q = np.radians([0, -80, 100, 0, 60, 0]) + rng.uniform(-1, 1, (60, 6)) * np.radians([60, 35, 35, 60, 50, 90])
    assert clearance(Scene.of(arm, cell), np.clip(q, arm.lower, arm.upper)).distance.min() > 0.01
    bar = replace(cell, collision=Collision(holder=[HolderTable(diameter_mm=50, length_mm=3000)]))
    held = Scene.of(arm, bar, tool=np.diag([1.0, 1.0, 1.0, 1.0]))
    hits = clearance(held, np.radians([[0, -80, 100, 0, 60, 0]]))
    assert hits.distance[0] == 0.0
    assert held.bodies[hits.first[0]].name == "cutter"


def test_obstacles_in_base_are_where_the_given_base_is(tmp_path):
    """A box and a mesh of it, turned by 90° about Z: (x, y, z) of `$BASE` is (1 − y, 2 + x, 3 + z) of the root."""
    trimesh.creation.box(bounds=[[100, 200, 300], [400, 600, 800]]).export(tmp_path / "part.stl")
    (tmp_path / "cell.toml").write_text(
        f"{CELL_TEXT}\n[collision]\nobstacles = [ {{ frame = 'base', mesh = 'part.stl' }}, "
        "{ frame = 'base', box = { X = [100, 400], Y = [200, 600], Z = [300, 800] } } ]\n"
    )
    base = pose(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), [1.0, 2.0, 3.0])
    placed = Scene.of(ROBOT, cells.load(tmp_path / "cell.toml"), base=base).bodies[-2:]
    for body in placed:
        np.testing.assert_allclose(body.points.min(axis=0), [0.4, 2.1, 3.3], atol=1e-6)
        np.testing.assert_allclose(body.points.max(axis=0), [0.8, 2.4, 3.8], atol=1e-6)


def test_cutter_and_tool_are_compared_with_the_links_up_to_a4():
    """The flange follows A6: the hand, A5 and A6, turns with it; shapes of the arm keep one more link apart."""
    cube = np.eye(4), np.full(3, 0.1)
    links = [bodies.box(f"A{carrier + 1}", carrier, "arm", *cube) for carrier in range(6)]
    held = [bodies.box(of, bodies.FLANGE, of, *cube) for of in ("cutter", "tool")]
    what = scene(*links, *held)
    names = [(what.bodies[i].name, what.bodies[j].name) for i, j in what.pairs()]
    near = ["A1", "A2", "A3", "A4"]
    assert names == [
        ("A5", "A1"),
        ("A6", "A1"),
        ("A6", "A2"),
        *((of, link) for of in ("cutter", "tool") for link in near),
    ]
