"""The surface against closed forms: a plane, a sphere, a step; all within a micrometre."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from msgspec.structs import replace

from postproc.files import read_facets
from postproc.frames import pose_from_xyzabc
from postproc.machining.tool import Cutter
from postproc.poses import Poses
from postproc.report.surface import Surface, glb, ply, surface
from tests import fabricated
from tests.report import overlapping
from tests.report.setting import result_of

MICRON = 1e-6
BALL = {0: Cutter(0.005, 0.005, 2)}
FLAT = {0: Cutter(0.005, 0.0, 2)}


def _zigzag(x, y, height):
    """Passes along x at each y; `height` of the tip over them."""
    rows = [np.column_stack([x if k % 2 == 0 else x[::-1], np.full(len(x), at)]) for k, at in enumerate(y)]
    way = np.concatenate(rows)
    return np.column_stack([way, height(way[:, 0], way[:, 1])])


def _facets(vertices, faces):
    return np.asarray(vertices)[np.asarray(faces)]


def _plane(size, count):
    x, y = np.meshgrid(np.linspace(0.001, size - 0.001, count), np.linspace(0.001, size - 0.001, count))
    low = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    return low[:, None] + np.array([[0, 0, 0], [1e-4, 0, 0], [0, 1e-4, 0]])


def test_on_a_plane_it_is_the_upright_part_of_the_deviation_there():
    size = 0.05
    points = _zigzag(np.linspace(-0.01, size + 0.01, 15), np.arange(0, size + 0.003, 0.003), lambda x, y: 0 * x)
    slope = np.column_stack([2e-4 + 0 * points[:, 0], -1e-4 + 0 * points[:, 0], -1e-4 + 0.004 * points[:, 0]])
    corners = _plane(size, 17)
    x, y, _ = corners.mean(axis=1).T
    exact = {  # the path at x is moved to x + 0.2 mm, y − 0.1 mm
        "flat": _lowest_of_a_slope(x, y) + 1e-4,
        "ball": 0.004 * (x - 2e-4) + _ridge(y + 1e-4) - _ridge(y),
        "unknown": 0.004 * x,
    }
    for name, cutters in {"flat": FLAT, "ball": BALL, "unknown": None}.items():
        shown = surface(result_of(points, slope), corners, cutters)
        assert (shown.row >= 0).all()
        np.testing.assert_allclose(shown.before, exact[name] - 1e-4, atol=MICRON, err_msg=name)
        assert shown.bound == pytest.approx(2e-5)
    np.testing.assert_allclose(shown.after, 0.01 * (exact["unknown"] - 1e-4), atol=MICRON)


def _lowest_of_a_slope(x, y):
    """What a flat tool of 5 mm leaves by passes 3 mm apart that are moved by 0.2, −0.1 and −0.1 + 0.004·x mm."""
    beside = y + 1e-4 - np.round((y + 1e-4) / 0.003) * 0.003
    return -1e-4 + 0.004 * (x - 2e-4 - np.sqrt(0.005**2 - beside**2))


def _ridge(y):
    """Height that a ball of 5 mm leaves at y by passes 3 mm apart."""
    return 0.005 - np.sqrt(0.005**2 - (y - np.round(y / 0.003) * 0.003) ** 2)


def test_on_a_sphere_it_is_the_part_along_the_radius():
    radius, tool = 0.02, 0.005
    off = np.array([1.5e-5, -1e-5, 2e-5])  # ridges between passes, of slopes up to 0.1, move sideways
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    corners = _facets(ball.vertices, ball.faces)
    corners = corners[corners.mean(axis=1)[:, 2] > 0.6 * radius]
    reach = np.linspace(-0.026, 0.026, 105)

    def height(x, y):
        """Tip of a ball that rolls over the sphere: its centre is on a larger sphere."""
        return np.sqrt(np.maximum((radius + tool) ** 2 - x**2 - y**2, 0.0)) - tool

    points = _zigzag(reach, reach, height)
    found = surface(result_of(points, off), corners, BALL)
    out = corners.mean(axis=1)
    out /= np.linalg.norm(out, axis=1)[:, None]
    assert (found.row >= 0).all()
    assert np.abs(found.before - out @ off).max() < 0.1 * np.linalg.norm(off)


def test_a_step_has_floor_and_wall_each_along_its_normal_and_what_is_out_of_reach_is_not_told():
    off = np.array([3e-5, 1e-5, -2e-5])
    y = np.linspace(-0.02, 0.02, 21)
    wall = np.column_stack([np.full(21, -0.005), y, np.zeros(21)])  # beside the wall x = 0, on the floor z = 0
    floor = np.column_stack([np.full(21, -0.012), y[::-1], np.zeros(21)])
    top = np.column_stack([np.full(21, 0.004), y, np.full(21, 0.006)])
    points = np.concatenate([wall, floor, [[-0.012, -0.02, 0.03], [0.004, -0.02, 0.03]], top])
    rapid = np.zeros(len(points), dtype=bool)
    rapid[[0, 42, 43]] = True
    small = np.array([[0, 0, 0], [1e-4, 0, 0], [0, 1e-4, 0]])
    on_floor = np.array([-0.007, 0.003, 0.0]) + small
    on_wall = np.array([0.0, 0.004, 0.003]) + small[:, [2, 0, 1]][::-1]  # its normal is −x
    on_top = np.array([0.003, 0.0, 0.006]) + small
    beyond = np.array([0.05, 0.0, 0.006]) + small
    below = np.array([0.003, 0.0, -0.006]) + small[::-1]  # seen from below
    found = surface(result_of(points, off, rapid), np.stack([on_floor, on_wall, on_top, beyond, below]), FLAT)
    assert found.normal[1] == pytest.approx([-1.0, 0.0, 0.0])
    assert found.before[:3] == pytest.approx([-2e-5, -3e-5, -2e-5], abs=MICRON)
    assert np.isnan(found.before[3:]).all()
    assert found.row[3:].tolist() == [-1, -1]


@pytest.mark.parametrize("kind", overlapping.JOBS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_where_passes_overlap_the_deepest_one_counts_as_in_a_swept_height_field(kind, seed):
    """Deviations up to 0.4 mm, on floors, freeform surfaces and walls; samples of the path leave some micrometres."""
    job = overlapping.JOBS[kind](np.random.default_rng(seed), 25)
    exact = overlapping.exact(job)
    shown = overlapping.shown(job)
    assert np.isfinite(exact).all()
    assert (shown.row >= 0).all()
    assert np.abs(exact).max() > 1e-4
    np.testing.assert_allclose(shown.before, exact, atol=5 * MICRON)


def test_a_rough_pass_that_deflects_below_the_finish_is_named_and_a_corrected_one_is_not():
    """Two flat passes over one place: the upper one goes 0.1 mm below the lower one without correction."""
    x = np.linspace(0.0, 0.02, 5)
    tip = np.column_stack([x, 0 * x, 0 * x])
    points = np.concatenate([tip + np.array([0, 0, 2e-4]), tip[::-1]])
    deviation = np.repeat([[0, 0, -3e-4], [0, 0, -2e-5]], 5, axis=0)
    corners = np.array([0.01, 0.001, 0.0]) + 1e-4 * np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    shown = surface(result_of(points, deviation), corners, FLAT)
    assert shown.before == pytest.approx(-1e-4, abs=1e-8)
    assert shown.after == pytest.approx(-2e-7, abs=1e-8)
    assert shown.row >= 5


def test_where_the_normal_misses_the_deflected_tool_material_of_its_displacement_is_left():
    """A wall by the side of a tool that is lifted by 0.2 mm: its lowest 0.2 mm are not cut."""
    y = np.linspace(0.0, 0.02, 5)
    points = np.column_stack([np.full(5, 0.005), y, 0 * y])
    small = 2e-5 * np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1]])
    corners = np.array([[0.0, 0.01, 1e-4], [0.0, 0.01, 1e-3]])[:, None] + small
    shown = surface(result_of(points, [0, 0, 2e-4]), corners, FLAT)
    assert shown.before == pytest.approx([2e-4, 0.0], abs=1e-8)


def test_without_shapes_a_face_counts_only_where_a_tool_of_some_shape_can_touch_it():
    """A pocket of 30 by 20 mm, 5 mm deep, by a cutter R5 in a block of 60 by 50 by 20 mm."""
    points = _zigzag(np.linspace(-0.01, 0.01, 21), np.arange(-0.005, 0.0051, 0.002), lambda x, y: -0.005 + 0 * x)
    above = points[:1] + np.array([0.0, 0.0, 0.02])  # from where it plunges as it cuts
    points = np.concatenate([above, points])
    x, y = np.meshgrid(np.linspace(-0.029, 0.029, 30), np.linspace(-0.024, 0.024, 25))
    x, y = x.ravel(), y.ravel()
    floor = (np.abs(x) < 0.0145) & (np.abs(y) < 0.0095)
    rim = (np.abs(x) > 0.0155) | (np.abs(y) > 0.0105)
    small = 1e-4 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    top = np.column_stack([x, y, 0 * x])
    faces = {
        "floor": (top[floor] - [0, 0, 0.005])[:, None] + small,
        "top": top[rim][:, None] + small,
        "bottom": (top - [0, 0, 0.02])[:, None] + small[::-1],
        "inner wall": np.column_stack([0.015 + 0 * y, np.clip(y, -0.009, 0.009), -0.003 + 0 * y])[:, None]
        + small[:, [2, 0, 1]][::-1],
        "outer wall": np.column_stack([0.03 + 0 * y, y, -0.003 + 0 * y])[:, None] + small[:, [2, 0, 1]],
        "outer wall below": np.column_stack([x, 0.025 + 0 * x, -0.012 + 0 * x])[:, None] + small[:, [1, 2, 0]],
    }
    touched = {"floor", "inner wall"}
    for name, corners in faces.items():
        assert (surface(result_of(points, [0, 0, -1e-5]), corners, None).row >= 0).mean() == (name in touched), name
    within = surface(result_of(points, [0, 0, -1e-5]), np.concatenate([faces["floor"], faces["top"]]), FLAT)
    assert within.is_touched.sum() <= len(faces["floor"])  # no more than with the shape


def test_a_part_whose_program_has_two_bases_lies_in_its_own_frame():
    """Half of the path in a $BASE that is moved and turned: the surface is that of the same path in one."""
    size = 0.05
    points = _zigzag(np.linspace(-0.01, size + 0.01, 15), np.arange(0, size + 0.003, 0.003), lambda x, y: 0 * x)
    off = np.column_stack([2e-4 + 0 * points[:, 0], -1e-4 + 0 * points[:, 0], -1e-4 + 0.004 * points[:, 0]])
    one = result_of(points, off)
    part = np.array(pose_from_xyzabc([1500.0, -200.0, 700.0, 20.0, 5.0, -3.0]))
    other = part @ pose_from_xyzabc([60.0, 10.0, -30.0, -40.0, 80.0, 15.0])
    base = (np.arange(len(points)) >= len(points) // 2).astype(np.int64)
    back = np.linalg.inv(np.stack([part, other])) @ part  # from the frame of the part into each $BASE
    pose = back[base] @ one.nominal
    motions = replace(one.program.motions, target=Poses.of(pose), base=base)
    turned = np.einsum("kij,kj->ki", back[base][:, :3, :3], off)
    two = fabricated.with_changes(
        one,
        program=replace(one.program, motions=motions, bases=np.stack([part, other])),
        nominal=Poses.of(pose),
        deviation_before=turned,
        deviation_after=0.01 * turned,
    )
    corners = _plane(size, 17)
    shown = surface(two, corners, FLAT, part)
    exact = _lowest_of_a_slope(*corners.mean(axis=1)[:, :2].T)
    assert (shown.row >= 0).all()
    np.testing.assert_allclose(shown.before, exact, atol=MICRON)
    moved = surface(one, corners @ part[:3, :3].T + part[:3, 3], FLAT, np.linalg.inv(part))
    np.testing.assert_allclose(moved.before, surface(one, corners, FLAT).before, atol=MICRON)


@pytest.mark.parametrize("cutters", [FLAT, BALL, None])
@pytest.mark.parametrize("higher", [0.0, 2e-4, 1e-3, 3e-3, 8e-3])
def test_a_mesh_that_is_too_high_is_cut_into_by_the_programmed_path_as_deep(cutters, higher):
    """Passes at two depths: the deeper one cuts, and is found where the upper one is nearer."""
    x, y = np.linspace(-0.01, 0.04, 11), np.arange(-0.005, 0.036, 0.003)
    lower = _zigzag(x, y, lambda x, y: 0 * x)
    points = np.concatenate([lower + np.array([0, 0, 0.009]), lower])
    box = trimesh.creation.box(bounds=[[0, 0, -0.01], [0.03, 0.03, higher]])
    vertices, faces = trimesh.remesh.subdivide_to_size(box.vertices, box.faces, 0.0021)
    corners = _facets(vertices, faces)
    upper = (corners[:, :, 2] > higher - 1e-9).all(axis=1)
    found = surface(result_of(points, [0, 0, -1e-5]), corners, cutters)
    if higher == 0.0:
        assert (found.programmed_row < 0).all()
        ridge = _ridge(corners[upper].mean(axis=1)[:, 1] + 0.005) if cutters is BALL else 0.0
        if cutters is None:  # what remains is not known
            assert np.isnan(found.programmed).all()
        else:
            assert found.programmed[upper] == pytest.approx(ridge, abs=MICRON)
        return
    cut = found.programmed_row >= 0
    assert (found.programmed_row[cut] >= len(lower)).all()
    ridge = 0.0 if cutters is not BALL else 0.005 - np.sqrt(0.005**2 - 0.0015**2)  # half-way between passes
    assert -found.programmed[cut].min() == pytest.approx(higher, abs=MICRON)
    inner = upper & (np.abs(corners[:, :, :2] - 0.015) < 0.0065).all(axis=(1, 2))  # no side of the box is nearer
    assert cutters is None or found.programmed[inner].max() <= max(-(higher - ridge - 2e-6), 0.0) + MICRON


def test_a_mesh_that_is_shifted_sideways_is_cut_into_by_the_shift_not_by_its_height():
    box = trimesh.creation.box(extents=(0.03, 0.02, 0.01))
    box.apply_translation((0.0, 0.0, -0.005))
    way = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * [0.02, 0.015]
    points = np.column_stack([way, np.full(5, -0.011)])  # a tool of radius 5 mm along the outline, through its bottom
    vertices, faces = trimesh.remesh.subdivide_to_size(box.vertices, box.faces, 2e-3)
    for shift in (0.0, 1e-3):
        shown = surface(result_of(points, [0, 0, -1e-5]), _facets(vertices + np.array([shift, 0, 0]), faces), FLAT)
        assert -shown.programmed[shown.programmed_row >= 0].min(initial=0.0) == pytest.approx(shift, abs=2e-5)


def test_at_an_edge_the_surface_moves_by_no_more_than_the_tool():
    """A wall beside it is cut away along its whole length: the normal of a facet at the edge goes all through it."""
    box = trimesh.creation.box(extents=(0.03, 0.02, 0.01))
    box.apply_translation((0.0, 0.0, -0.005))
    vertices, faces = trimesh.remesh.subdivide_to_size(box.vertices, box.faces, 1.1e-3)
    way = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * [0.02, 0.015]
    points = np.column_stack([way, np.full(5, -0.011)])
    deviation = np.array([-4e-4, -3e-4, 0.0])
    shown = surface(result_of(points, deviation), _facets(vertices, faces), FLAT)
    normal_part = shown.normal @ deviation
    middle = (np.abs(shown.normal[:, 0]) > 0.9) & (np.abs(shown.corners.mean(axis=1)[:, 1]) < 0.008) & shown.is_touched
    np.testing.assert_allclose(shown.before[middle], normal_part[middle], atol=MICRON)
    assert middle.sum() > 100
    assert np.nanmin(shown.before) == pytest.approx(-4e-4, abs=1.5e-4)
    assert np.nanmax(np.abs(shown.before)) <= 5e-4 + MICRON


def test_a_mesh_that_is_too_low_is_left_by_the_programmed_path():
    size = 0.05
    points = _zigzag(np.linspace(-0.01, size + 0.01, 15), np.arange(0, size + 0.003, 0.003), lambda x, y: 0 * x)
    found = surface(result_of(points, [0, 0, -1e-5]), _plane(size, 17) - np.array([0, 0, 5e-4]), FLAT)
    assert (found.programmed_row < 0).all()
    assert found.programmed == pytest.approx(5e-4, abs=MICRON)


def test_what_a_coarse_mesh_stands_off_its_surface_is_not_cut_into(tmp_path):
    """A hole as its chords: a tool along its wall, exactly, cuts into the chords by their height."""
    ring = trimesh.creation.annulus(r_min=10.0, r_max=20.0, height=5.0, sections=24)
    ring.apply_translation((0, 0, -2.5))
    ring.export(tmp_path / "ring.stl")
    corners, coarse = read_facets(tmp_path / "ring.stl")
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    points = np.column_stack([0.005 * np.cos(angle), 0.005 * np.sin(angle), np.full(361, -0.006)])
    exact = surface(result_of(points, [0, 0, -1e-5]), corners, FLAT)
    height = 0.01 * (1.0 - np.cos(np.pi / 24))
    assert -np.nanmin(exact.programmed) == pytest.approx(height, rel=0.05)
    assert coarse.max() == pytest.approx(2 * height, rel=0.1)  # of the outer side, which is twice as large
    allowed = surface(result_of(points, [0, 0, -1e-5]), corners, FLAT, facet_error=coarse)
    assert (allowed.programmed_row < 0).all()


def test_rapid_moves_touch_nothing():
    points = _zigzag(np.linspace(0, 0.05, 11), np.arange(0, 0.05, 0.004), lambda x, y: 0 * x)
    found = surface(result_of(points, [0, 0, 1e-4], np.ones(len(points), dtype=bool)), _plane(0.05, 5), FLAT)
    assert (found.row < 0).all()


def test_colours_and_numbers_of_the_file_are_those_of_the_facets():
    corners = _plane(0.05, 3)
    values = np.linspace(-2e-5, 2e-5, 9)
    values[4] = np.nan
    row = np.where(np.isnan(values), -1, 3)
    normal = np.tile([0.0, 0, 1], (9, 1))
    made = Surface(corners, normal, values, 0.1 * values, None, row, np.zeros(9), np.full(9, -1))
    content = ply(made, 1e-5)
    mesh = trimesh.load(trimesh.util.wrap_as_stream(content), file_type="ply", process=False)
    assert mesh.faces.tolist() == np.arange(27).reshape(9, 3).tolist()
    np.testing.assert_allclose(mesh.vertices.reshape(9, 3, 3), corners * 1e3, atol=1e-5)
    colour = mesh.visual.vertex_colors.reshape(9, 3, 4)
    assert (colour == colour[:, :1]).all()
    assert colour[0, 0].tolist() == colour[1, 0].tolist()  # both beyond the limit
    assert colour[0, 0, 0] > colour[0, 0, 2]  # gouged: towards orange
    assert colour[8, 0, 2] > colour[8, 0, 0]  # material left: towards blue
    scene = trimesh.load(trimesh.util.wrap_as_stream(glb(made, 1e-5)), file_type="glb", process=False)
    (shown,) = scene.geometry.values()
    np.testing.assert_allclose(shown.vertices[shown.faces], mesh.vertices[mesh.faces], atol=1e-5)
    assert (shown.visual.vertex_colors[shown.faces] == mesh.visual.vertex_colors[mesh.faces]).all()
    head, _, body = content.partition(b"end_header\n")
    assert b"property float before_mm" in head
    stored = np.frombuffer(body[: 27 * 27], dtype=[("x", "<f4", 3), ("c", "u1", 3), ("v", "<f4", 3)])
    np.testing.assert_allclose(stored["v"][::3, 0], values * 1e3, atol=1e-8)
