"""Bodies by formulas: round solids and their meshes, a holder, obstacles, spheres and spans around them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from msgspec.structs import replace

from postproc import cell as cells
from postproc.cell import Collision, HolderTable
from postproc.collision import Scene, Solids, bodies, clearance, cylinders, inscribed_capsule
from postproc.collision.distance import link_frames
from postproc.errors import CellError, ModelError
from postproc.robot import urdf
from tests.collision.setting import frame, pose, scene
from tests.kr270 import CELL, CELL_TEXT, ROBOT
from tests.places import ROOT

TURN = pin.exp3(np.array([0.4, -0.5, 0.6]))
BEGIN, END = np.array([0.1, -0.2, 0.3]), np.array([0.4, 0.2, 0.3])  # 0.5 m apart


def in_body(body: bodies.Body, points) -> np.ndarray:
    return (points - body.pose[:3, 3]) @ body.pose[:3, :3]


def samples_of(body: bodies.Body, count: int = 4000) -> np.ndarray:
    """Points on the triangles of a body, in its own axes."""
    mesh = trimesh.Trimesh(body.points, body.faces, process=False)
    return in_body(body, trimesh.sample.sample_surface(mesh, count, seed=1)[0])


@pytest.mark.parametrize("radius", [0.08, 1e-3, 1e-4])
@pytest.mark.parametrize("kind", ["cylinder", "capsule"])
def test_the_mesh_of_a_round_body_is_around_it_by_a_hundredth_of_its_radius_at_most(kind, radius):
    """Also of a thin one: an engraving cutter has some tenths of a millimetre."""
    body = getattr(bodies, kind)("b", 3, "arm", BEGIN, END, radius)
    assert (body.kind, body.size, body.carrier, body.role) == (kind, pytest.approx((radius, 0.5)), 3, "arm")
    np.testing.assert_allclose(body.pose[:3, 3], [0.25, 0.0, 0.3], atol=1e-15)
    np.testing.assert_allclose(body.pose[:3, 2], [0.6, 0.8, 0.0], atol=1e-15)
    np.testing.assert_allclose(body.pose[:3, :3].T @ body.pose[:3, :3], np.eye(3), atol=1e-15)
    assert np.linalg.det(body.pose[:3, :3]) == pytest.approx(1.0)
    assert trimesh.Trimesh(body.points, body.faces).is_watertight
    local = samples_of(body)
    radial, along = np.linalg.norm(local[:, :2], axis=1), local[:, 2]
    if kind == "cylinder":
        is_side = np.abs(along) < 0.25 - 1e-9
        assert (radius * (1.0 - 1e-9) <= radial[is_side]).all()
        assert (radial <= 1.005 * radius).all()
        assert np.abs(along).max() == pytest.approx(0.25)
        return
    beyond = np.hypot(radial, np.maximum(np.abs(along) - 0.25, 0.0))
    assert radius * (1.0 - 1e-9) <= beyond.min()
    assert beyond.max() <= 1.01 * radius
    assert np.abs(in_body(body, body.points))[:, 2].max() >= 0.25 + radius


def test_a_cutter_of_tenths_of_a_millimetre_has_a_mesh():
    body = bodies.cylinder("cutter", 6, "cutter", np.zeros(3), np.array([0.0, 0.0, 3e-4]), 5e-5)
    np.testing.assert_allclose(np.ptp(body.points, axis=0), [1e-4, 1e-4, 3e-4], rtol=0.01)
    capsule = inscribed_capsule(body)
    assert np.ptp(capsule.points, axis=0) == pytest.approx([2e-4, 2e-4, 4e-4], rel=0.01)


def test_a_box_has_its_edges_about_its_middle():
    place = pose(TURN, [1.0, 2.0, 3.0])
    body = bodies.box("b", -1, "part", place, np.array([0.2, 0.4, 0.6]))
    assert body.size == (0.2, 0.4, 0.6)
    np.testing.assert_allclose(np.sort(np.abs(in_body(body, body.points)), axis=0), [[0.1, 0.2, 0.3]] * 8, atol=1e-12)


def test_the_sphere_around_a_body_is_that_of_the_middle_of_its_span():
    body = bodies.box("b", -1, "part", pose(np.eye(3), [1.0, 2.0, 3.0]), np.array([0.2, 0.4, 0.6]))
    centre, radius = body.sphere
    np.testing.assert_allclose(centre, [1.0, 2.0, 3.0], atol=1e-12)
    assert radius == pytest.approx(np.sqrt(0.1**2 + 0.2**2 + 0.3**2))


def test_a_body_is_moved_with_its_pose_and_its_points():
    body, motion = bodies.cylinder("b", -1, "part", BEGIN, END, 0.08), pose(TURN, [1.0, 2.0, 3.0])
    moved = body.transform(motion)
    np.testing.assert_allclose(moved.pose, motion @ body.pose, atol=1e-15)
    np.testing.assert_allclose(moved.points, body.points @ TURN.T + [1.0, 2.0, 3.0], atol=1e-12)


@pytest.mark.parametrize(
    ("length", "radius", "half", "expected"),
    [(0.5, 0.08, 0.17, 0.0795), (0.1, 0.08, 1e-4, 0.0495), (0.0005, 0.01, 1e-4, 1e-4)],
)
def test_the_capsule_in_a_cutter_is_smaller_by_the_accuracy(length, radius, half, expected):
    direction = np.array([0.6, 0.8, 0.0])
    capsule = inscribed_capsule(bodies.cylinder("cutter", 6, "cutter", BEGIN, BEGIN + length * direction, radius))
    assert (capsule.name, capsule.carrier, capsule.role, capsule.kind) == ("cutter", 6, "tool", "capsule")
    assert capsule.size == pytest.approx((expected, 2 * half))
    np.testing.assert_allclose(capsule.pose[:3, 3], BEGIN + 0.5 * length * direction, atol=1e-12)


HOLDER = [
    HolderTable(diameter_mm=20, length_mm=60),
    HolderTable(diameter_mm=50, length_mm=100),
    HolderTable(name="spindle", diameter_mm=120, length_mm=200),
]


def test_cylinders_of_a_holder_are_stacked_from_the_tip():
    stacked = [(c.name, c.radius, c.begin, c.end, c.cuts) for c in cylinders(HOLDER)]
    assert stacked == [
        ("cutter", 0.01, 0.0, pytest.approx(0.06), True),
        ("holder 2", 0.025, pytest.approx(0.06), pytest.approx(0.16), False),
        ("spindle", 0.06, pytest.approx(0.16), pytest.approx(0.36), False),
    ]


@pytest.mark.parametrize(("axis", "column", "sign"), [("+Z", 2, -1), ("-Z", 2, 1), ("+X", 0, -1), ("-Y", 1, 1)])
def test_the_holder_is_behind_the_tip_along_the_axis_of_the_tool(axis, column, sign, tmp_path):
    trimesh.creation.box(bounds=[[100, 200, 300], [400, 600, 800]]).export(tmp_path / "guard.stl")
    parts = [*HOLDER, HolderTable(mesh="guard.stl"), HolderTable(mesh="guard.stl", name="hose")]
    cell = replace(CELL, folder=str(tmp_path), collision=Collision(holder=parts), tool=replace(CELL.tool, axis=axis))
    tool = pose(TURN, [0.1, 0.2, 0.3])
    held = Scene.of(ROBOT, cell, tool=tool).bodies[-5:]
    assert [(body.name, body.role, body.carrier) for body in held] == [
        ("cutter", "cutter", 6), ("holder 2", "tool", 6), ("spindle", "tool", 6), ("holder 4", "tool", 6),
        ("hose", "tool", 6),
    ]  # fmt: skip
    up = sign * TURN[:, column]
    for body, middle, size in zip(held, (0.03, 0.11, 0.26), ((0.01, 0.06), (0.025, 0.1), (0.06, 0.2)), strict=False):
        np.testing.assert_allclose(body.pose[:3, 3], np.array([0.1, 0.2, 0.3]) + middle * up, atol=1e-12)
        np.testing.assert_allclose(body.pose[:3, 2], up, atol=1e-12)
        assert body.size == pytest.approx(size)
    for mesh in held[3:]:
        np.testing.assert_allclose(
            [mesh.points.min(axis=0), mesh.points.max(axis=0)], [[0.1, 0.2, 0.3], [0.4, 0.6, 0.8]]
        )
    own = Scene.of(ROBOT, cell).bodies[-5]  # $TOOL of the cell
    np.testing.assert_allclose(
        own.pose[:3, 3], CELL.tool.pose()[:3, 3] + 0.03 * sign * CELL.tool.pose()[:3, column], atol=1e-12
    )


def test_obstacles_have_their_names_kinds_and_frames(tmp_path):
    trimesh.creation.box(bounds=[[100, 200, 300], [400, 600, 800]]).export(tmp_path / "vice.stl")
    box = "box = { X = [100, 400], Y = [200, 600], Z = [300, 800] }"
    (tmp_path / "cell.toml").write_text(
        f"{CELL_TEXT}\n[collision]\nobstacles = [ {{ frame = 'root', {box} }}, "
        f"{{ frame = 'base', part = true, {box} }}, "
        f"{{ frame = 'base', name = 'jaw', mesh = 'vice.stl' }}, {{ frame = 'root', mesh = 'vice.stl' }} ]\n"
    )
    cell = cells.load(tmp_path / "cell.toml")
    placed = Scene.of(ROBOT, cell)
    assert [(b.name, b.role, b.kind, b.moves_with_base, b.carrier) for b in placed.bodies[-4:]] == [
        ("obstacle 1", "obstacle", "box", False, -1),
        ("obstacle 2", "part", "box", True, -1),
        ("jaw", "obstacle", "mesh", True, -1),
        ("vice.stl", "obstacle", "mesh", False, -1),
    ]
    middle = np.array([0.25, 0.4, 0.55])
    in_base = (cell.base.pose() @ np.append(middle, 1.0))[:3]
    for body, expected in zip(placed.bodies[-4:], (middle, in_base, in_base, middle), strict=True):
        np.testing.assert_allclose(body.sphere[0], expected, atol=1e-6)
    assert placed.bodies[-4].size == pytest.approx((0.3, 0.4, 0.5))
    assert len(placed.remarks) == 1
    assert Scene.of(ROBOT, CELL).bodies == ()


def test_obstacles_in_base_move_with_it_and_others_stay():
    fixed = bodies.box("post", -1, "obstacle", pose(np.eye(3), [1.0, 0, 0]), np.ones(3))
    jaw = replace(bodies.cylinder("jaw", -1, "obstacle", BEGIN, END, 0.05), moves_with_base=True)
    solids = Solids(scene(bodies.capsule("c", 6, "tool", np.zeros(3), np.ones(3), 0.1), fixed, jaw))
    motion = pose(TURN, [1.0, 2.0, 3.0])
    moved = solids.move_base(motion)
    np.testing.assert_allclose(moved.bodies[2].pose, motion @ jaw.pose, atol=1e-14)
    np.testing.assert_allclose(moved.spheres[2][0], (motion @ np.append(jaw.sphere[0], 1.0))[:3], atol=1e-3)
    assert moved.bodies[:2] == solids.bodies[:2]
    assert solids.bodies[2] is jaw


def ring(place=None, height: float = 0.4) -> bodies.Body:
    """A ring of radii 0.2 and 0.3 m, which is not convex."""
    mesh = trimesh.creation.annulus(r_min=0.2, r_max=0.3, height=height, sections=256, transform=place)
    return bodies.Body("r", -1, "obstacle", "mesh", (), np.eye(4), np.asarray(mesh.vertices), np.asarray(mesh.faces))


def test_a_point_is_in_a_mesh_where_the_formula_of_the_ring_says_so():
    """A tiny ball at 400 places: inside, in the hole, beside and above; those near the surface are left out."""
    q = np.radians([[0.0, -90.0, 90.0, 0.0, 0.0, 0.0]])
    place = pose(TURN, frame(q[0], 6)[:3, 3])
    local = np.random.default_rng(3).uniform([-0.35, -0.35, -0.25], [0.35, 0.35, 0.25], (400, 3))
    radial, height = np.linalg.norm(local[:, :2], axis=1), np.abs(local[:, 2])
    depth = np.minimum(0.05 - np.abs(radial - 0.25), 0.2 - height)
    local, depth = local[np.abs(depth) > 2e-3], depth[np.abs(depth) > 2e-3]
    tip = np.linalg.solve(frame(q[0], 6), place @ np.append(np.zeros(3), 1.0))[:3]
    ball = bodies.capsule("ball", 6, "tool", tip, tip + 1e-9, 1e-4)
    solids = Solids(scene(ball, ring(place)))
    assert solids.convex == [True, False]
    shift = local @ TURN.T
    frames = link_frames(ROBOT.nominal, np.repeat(q, len(local), axis=0), shift)
    solid = solids.distance(0, 1, frames, solid=True)
    np.testing.assert_array_equal(solid == 0.0, depth > 0.0)
    assert 50 < (depth > 0.0).sum() < 250
    surface = solids.distance(0, 1, frames, solid=False)
    assert (surface[depth > 0.0] > 0.0).all()
    np.testing.assert_array_equal(surface[depth < 0.0], solid[depth < 0.0])
    assert solids.calls == 2 * len(local)


def test_a_mesh_is_convex_if_it_fills_its_hull():
    cube = trimesh.creation.box((0.2, 0.3, 0.4))
    open_cube = np.asarray(cube.faces)[1:]
    meshes = [
        bodies.Body("b", -1, "obstacle", "mesh", (), np.eye(4), np.asarray(cube.vertices), faces)
        for faces in (np.asarray(cube.faces), np.asarray(cube.faces)[:, ::-1], open_cube)
    ]
    assert Solids(scene(*meshes, ring())).convex == [True, True, False, False]


@pytest.mark.parametrize("need", [1e-6, 0.05, 0.3])
def test_bodies_that_may_be_near_are_all_that_are_and_few_others(need):
    """The bound by spheres and boxes never misses a pair, and is the distance of the sphere from the box at most."""
    rng = np.random.default_rng(5)
    q = rng.uniform(0.4 * ROBOT.lower, 0.4 * ROBOT.upper, (300, 6))
    place = pose(TURN, frame(q[0], 6)[:3, 3])
    what = scene(
        bodies.cylinder("c", 6, "tool", BEGIN, END, 0.08),
        bodies.box("b", -1, "obstacle", place, np.array([0.8, 0.6, 0.4])),
    )
    solids, frames = Solids(what), link_frames(ROBOT.nominal, q)
    near, exact = solids.may_be_near(0, 1, frames, need), solids.distance(0, 1, frames, solid=True)
    assert near[exact < need].all()
    centre, radius = np.array([0.25, 0.0, 0.3]), np.hypot(0.25, 0.08)
    middle = np.array([(frame(row, 6) @ np.append(centre, 1.0))[:3] for row in q])
    gap = np.linalg.norm(np.maximum(np.abs(in_body(what.bodies[1], middle)) - [0.4, 0.3, 0.2], 0.0), axis=1) - radius
    assert not near[gap > need + 1e-3].any()
    back = np.array([(np.linalg.inv(frame(row, 6) @ what.bodies[0].pose) @ place)[:3, 3] for row in q])
    gap = np.linalg.norm(np.maximum(np.abs(back) - [0.0804, 0.0804, 0.25], 0.0), axis=1) - np.hypot(0.5, 0.2)
    assert not near[gap > need + 1e-3].any()
    assert 0 < near.sum() < 300
    for rows in (exact < need, exact >= need + 1e-5):
        assert solids.is_closer(frames[rows], need) is bool((exact[rows] < need).any())


def test_touching_bodies_are_closer_than_nothing():
    at = frame(np.zeros(6), 6)[:3, 3]
    ball = bodies.capsule("ball", 6, "tool", np.zeros(3), np.array([0, 0, 1e-9]), 0.1)
    for gap, is_touching in ((-0.01, True), (0.01, False)):
        cube = bodies.box("b", -1, "obstacle", pose(np.eye(3), at + np.array([0.0, 0.0, 0.6 + gap])), np.ones(3))
        solids = Solids(scene(ball, cube))
        assert solids.is_closer(link_frames(ROBOT.nominal, np.zeros((1, 6))), 0.0) is is_touching


def test_another_mesh_takes_the_place_of_the_last_body():
    q = np.zeros((1, 6))
    at = frame(q[0], 6)[:3, 3]
    ball = bodies.capsule("ball", 6, "tool", np.zeros(3), np.array([0, 0, 1e-9]), 0.05)
    solids = Solids(scene(ball, ring(pose(np.eye(3), at + np.array([9.0, 0.0, 0.0])))))
    other = solids.replace_last(ring(pose(np.eye(3), at)))
    frames = link_frames(ROBOT.nominal, q)
    assert other.distance(0, 1, frames, solid=True)[0] == pytest.approx(0.15, abs=1e-4)
    assert solids.distance(0, 1, frames, solid=True)[0] == pytest.approx(9.0 - 0.35, abs=1e-4)
    np.testing.assert_allclose(other.spheres[1][0], at, atol=1e-9)
    np.testing.assert_allclose(other.spans[1], at + np.array([[-0.3, -0.3, -0.2], [0.3, 0.3, 0.2]]), atol=1e-9)
    assert other.bodies[0] is ball
    cube = bodies.box("b", -1, "obstacle", pose(TURN, [1.0, 2.0, 3.0]), np.array([0.2, 0.4, 0.6]))
    made_anew, changed = Solids(scene(ball, cube, ring())), Solids(scene(ball, cube, ball)).replace_last(ring())
    assert changed.convex == made_anew.convex == [True, True, False]
    for name in ("spheres", "spans"):
        for mine, theirs in zip(getattr(changed, name), getattr(made_anew, name), strict=True):
            for one, other in zip(mine, theirs, strict=True):
                np.testing.assert_array_equal(one, other)
    around = solids.replace_last(ring(pose(np.eye(3), at + np.array([0.25, 0.0, 0.0])), 9.0))
    tiny = replace(ball, size=(1e-3, 1e-9), points=1e-3 * ball.points)
    inside_it = Solids(scene(tiny, ring())).replace_last(around.bodies[1])
    assert inside_it.distance(0, 1, frames, solid=True)[0] == 0.0
    assert inside_it.distance(0, 1, frames, solid=False)[0] > 0.01


def test_bodies_of_the_arm_are_named_by_their_joint():
    named = {body.carrier: body.name for body in Scene.of(ROBOT, replace(CELL, collision=Collision())).bodies}
    assert named == {-1: "base of the robot", **{k: f"link of A{k + 1}" for k in range(5)}}


def test_the_arm_has_the_collision_shapes_of_its_urdf_and_capsules_where_the_cell_asks_for_them(tmp_path):
    """The drawn shape of A3 is another box; a missing file is named."""
    for name, edge in (("drawn", 0.4), ("solid", 0.2)):
        trimesh.creation.box((edge, edge, edge)).export(tmp_path / f"{name}.stl")
    shapes = "".join(
        f'<{kind}><geometry><mesh filename="{name}.stl"/></geometry></{kind}>'
        for kind, name in (("visual", "drawn"), ("collision", "solid"))
    )
    text = (ROOT / "robot_models" / "kuka_kr270" / "robot.urdf").read_text(encoding="utf-8")
    text = text.replace('<link name="link_3">', f'<link name="link_3">{shapes}', 1)
    arm = replace(ROBOT, geometries=urdf.geometries(text, "robot.urdf"), urdf=str(tmp_path / "robot.urdf"))
    placed = Scene.of(arm, replace(CELL, collision=Collision()))
    (link,) = placed.bodies
    assert (link.name, link.carrier, link.role, link.kind, placed.remarks) == ("link of A3", 2, "arm", "mesh", ())
    np.testing.assert_allclose(np.ptp(link.points, axis=0), 0.2, atol=1e-7)
    capsules = Scene.of(arm, replace(CELL, collision=Collision(arm="capsules")))
    assert {body.kind for body in capsules.bodies} == {"capsule"}
    assert len(capsules.remarks) == 1
    (tmp_path / "solid.stl").unlink()
    with pytest.raises(ModelError, match=r"a shape of the arm is missing: solid\.stl: there is no such file"):
        Scene.of(arm, replace(CELL, collision=Collision()))


def test_without_bodies_to_compare_no_distance_is_found():
    found = clearance(scene(bodies.capsule("c", 6, "tool", BEGIN, END, 0.1)), np.zeros((2, 6)))
    assert (found.distance.tolist(), found.first.tolist(), found.second.tolist()) == ([np.inf] * 2, [-1, -1], [-1, -1])
    assert len(clearance(scene(bodies.capsule("c", 6, "tool", BEGIN, END, 0.1)), np.zeros((0, 6))).distance) == 0


def test_a_missing_mesh_is_refused(tmp_path):
    cell = replace(CELL, folder=str(tmp_path), collision=Collision(holder=[HolderTable(mesh="none.stl")]))
    with pytest.raises(CellError, match=r"no such file: mesh of \[collision\]"):
        Scene.of(ROBOT, cell)
