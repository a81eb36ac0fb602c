from __future__ import annotations

import numpy as np
import pytest
import trimesh

from postproc.errors import PlanError
from postproc.identification.readings import Box, MeshFile
from postproc.plan.site import BoxShape, MeshShape, points_on_segments, segment_distances


def point_to_segment(p, a, b):
    size = (b - a) @ (b - a)
    t = 0.0 if size == 0.0 else min(max((p - a) @ (b - a) / size, 0.0), 1.0)
    return float(np.linalg.norm(p - a - t * (b - a)))


def segment_distance(a, b, c, d):
    """Least distance by cases: an end of one and the other, or the common perpendicular if both feet are inside."""
    found = [
        point_to_segment(a, c, d), point_to_segment(b, c, d), point_to_segment(c, a, b), point_to_segment(d, a, b)
    ]  # fmt: skip
    normal = np.cross(b - a, d - c)
    if np.linalg.norm(normal) > 1e-9:
        s, t, height = np.linalg.solve(np.column_stack([b - a, c - d, normal]), c - a)
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            found.append(abs(height) * float(np.linalg.norm(normal)))
    return min(found)


def test_distances_between_segments_are_those_of_their_ends_or_of_the_common_perpendicular():
    rng = np.random.default_rng(0)
    p, p_end, r, r_end = rng.uniform(-1, 1, (4, 400, 3))
    p_end[:20], r_end[10:40] = p[:20], r[10:40]  # points, ten times both
    r_end[40:80] = r[40:80] + rng.uniform(-2, 2, (40, 1)) * (p_end[40:80] - p[40:80])  # parallel
    r[80:100] = p[80:100] + rng.uniform(-1, 2, (20, 1)) * (p_end[80:100] - p[80:100])  # on one line
    r_end[80:100] = p[80:100] + rng.uniform(-1, 2, (20, 1)) * (p_end[80:100] - p[80:100])
    expected = [segment_distance(*row) for row in zip(p, p_end, r, r_end, strict=True)]
    np.testing.assert_allclose(segment_distances(p, p_end, r, r_end), expected, atol=1e-9)
    np.testing.assert_allclose(segment_distances(r, r_end, p_end, p), expected, atol=1e-9)


def test_points_along_segments_are_evenly_spaced_close_enough_and_hold_both_ends():
    start, end = np.random.default_rng(3).uniform(-1, 1, (2, 7, 3))
    length = float(np.linalg.norm(end - start, axis=1).max())
    points = points_on_segments(start, end, length)
    np.testing.assert_allclose(points[:, 0], start, atol=1e-15)
    np.testing.assert_allclose(points[:, -1], end, atol=1e-15)
    steps = np.diff(points, axis=1)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[:, :1], steps.shape), atol=1e-12)
    gap = float(np.linalg.norm(steps, axis=2).max())
    assert 0.02 < gap <= 0.04 + 1e-12  # less than the radii of the arm; not so fine that it costs much
    assert points_on_segments(start, start, 0.0).shape == (7, 2, 3)


def box(**values):
    return BoxShape.of(Box(**{"size": (400.0, 200.0, 600.0), "X": 1000.0, "A": 30.0, "B": 10.0, **values}), 1)


def test_distances_to_a_turned_box_are_those_of_its_mesh():
    shape = box()
    mesh = trimesh.creation.box(extents=[0.4, 0.2, 0.6])
    points = np.random.default_rng(1).uniform([0.5, -0.5, -0.6], [1.5, 0.5, 0.6], (200, 3))
    surface = _fine_surface(mesh)
    placed = surface @ np.linalg.inv(shape.to_box)[:3, :3].T + np.linalg.inv(shape.to_box)[:3, 3]
    nearest = np.array([np.linalg.norm(placed - p, axis=1).min() for p in points])
    assert np.abs(np.abs(shape.distance(points)) - nearest).max() < 0.012


def _fine_surface(mesh):
    vertices, _ = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 0.015)
    return vertices


def test_a_line_of_sight_is_blocked_by_a_box_between_and_by_nothing_else():
    shape = box(A=0.0, B=0.0)
    eye = np.array([3.0, 0.0, 0.0])
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.5, 0.0], [1.5, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.8]])
    assert shape.blocks(np.broadcast_to(eye, ends.shape), ends).tolist() == [True, False, False, True, False]


def test_lines_of_sight_at_random_are_blocked_where_a_point_of_them_is_in_the_box():
    shape = box(A=35.0, B=20.0)
    start, end = np.random.default_rng(5).uniform([0.4, -0.6, -0.6], [1.6, 0.6, 0.6], (2, 300, 3))
    share = np.linspace(0.0, 1.0, 1201)[:, None]
    depth = np.array([shape.distance(a + share * (b - a)).min() for a, b in zip(start, end, strict=True)])
    clear = np.abs(depth) > 1e-3  # points are 2 mm apart
    assert 30 < np.count_nonzero(depth[clear] < 0.0) < 250
    np.testing.assert_array_equal(shape.blocks(start, end)[clear], depth[clear] < 0.0)


@pytest.fixture
def stl(tmp_path):
    trimesh.creation.box(extents=[400, 200, 600]).export(tmp_path / "thing.stl")
    return MeshShape.of(MeshFile(file="thing.stl", X=1000.0), tmp_path)


def test_a_mesh_is_as_far_as_it_is_or_a_little_nearer(stl):
    same = box(A=0.0, B=0.0)
    points = np.random.default_rng(2).uniform([0.2, -0.8, -0.9], [1.8, 0.8, 0.9], (300, 3))
    outside = points[same.distance(points) > 0.05]
    gap = same.distance(outside) - stl.distance(outside)
    assert gap.min() >= -1e-9
    assert gap.max() <= stl.vertex_gap + 1e-9


def test_a_line_of_sight_is_blocked_by_a_mesh_between(stl):
    eye = np.array([[3.0, 0.0, 0.0]] * 3)
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.9, 0.0], [1.6, 0.0, 0.0]])
    assert stl.blocks(eye, ends).tolist() == [True, False, False]


def test_lines_of_sight_in_rows_and_columns_are_those_one_by_one(stl):
    start, end = np.random.default_rng(9).uniform([0.2, -0.8, -0.9], [1.8, 0.8, 0.9], (2, 4, 6, 3))
    for shape in (stl, box()):
        found = shape.blocks(start, end)
        assert found.shape == (4, 6)
        assert 0 < found.sum() < 24
        alone = [
            bool(shape.blocks(a[None], b[None])[0])
            for a, b in zip(start.reshape(-1, 3), end.reshape(-1, 3), strict=True)
        ]
        assert found.ravel().tolist() == alone


def test_meshes_that_cannot_be_used_are_named(tmp_path):
    with pytest.raises(PlanError, match="no such file"):
        MeshShape.of(MeshFile(file="absent.stl"), tmp_path)
    (tmp_path / "bad.stl").write_text("this is no mesh")
    with pytest.raises(PlanError, match=r"bad\.stl"):
        MeshShape.of(MeshFile(file="bad.stl"), tmp_path)
