"""The mesh of the remaining stock: sections by trimesh, closed forms of walls and grooves, sums cell by cell."""

from __future__ import annotations

import math
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from msgspec.structs import replace

from postproc.jobs import process_forces
from postproc.machining import stock as stocks
from postproc.machining import stock_mesh
from tests.machining import test_cells_by_loop, test_map_by_cell
from tests.machining.setting import AL7075, forces, gcode, line_of, on_line, process, tool

BLOCK = ((-20, 20), (-15, 15), (-10, 0))


def in_mm(mesh):
    """The mesh of trimesh [mm]."""
    return trimesh.Trimesh(mesh.vertices * 1e3, mesh.faces)


def edge_count(faces):
    """How many edges have each number of faces; each edge is used once in each direction if the mesh is closed."""
    directed = Counter((int(a), int(b)) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True))
    return Counter((count, directed[edge[::-1]]) for edge, count in directed.items())


def section(mesh, x):
    """Segments (S, 2, 2), y and z of both ends [mm], of a mesh at one x."""
    return trimesh.intersections.mesh_plane(mesh, [1.0, 0.0, 0.0], [x, 0.0, 0.0])[:, :, 1:]


def heights(segments, y):
    """Heights at which segments of a section cross one y [mm], ascending."""
    begin, end = segments[:, 0], segments[:, 1]
    across = (begin[:, 0] - y) * (end[:, 0] - y) < 0.0
    begin, end = begin[across], end[across]
    return np.sort(begin[:, 1] + (end[:, 1] - begin[:, 1]) * (y - begin[:, 0]) / (end[:, 0] - begin[:, 0]))


@pytest.mark.parametrize("most_cells", [250_000, 150, 30])
@pytest.mark.parametrize("seed", range(4))
def test_the_mesh_of_any_map_is_closed(seed, most_cells):
    """Levels, shares, slopes, floors and empty cells at random; no edge has more than two faces."""
    rng = np.random.default_rng(seed)
    for stock in (test_map_by_cell.made_stock(seed), *(test_cells_by_loop.random_stock(rng, p) for p in (0.2, 0.7))):
        mesh = stock_mesh.mesh_of(stock, most_cells)
        solid = stocks.as_trimesh(mesh.vertices, mesh.faces)
        assert set(edge_count(mesh.faces)) == {(1, 1)}
        assert solid.is_watertight
        assert solid.is_winding_consistent
        assert solid.volume * 1e-9 == pytest.approx(stock.volume(), rel=0.15)
        low, high = solid.bounds * 1e-3
        assert low[2] >= stock.floor.min() - 1e-7
        assert high[2] <= stock.high.max() + 1e-7 or mesh.cell > stock.cell


def test_cells_that_touch_at_a_corner_only_are_separated():
    rng = np.random.default_rng(12)
    for _ in range(30):
        filled = rng.random((6, 7)) < 0.5
        before = filled.copy()
        stock_mesh._separate_diagonal_cells(filled)
        assert not (filled & ~before).any()
        for row, column in np.ndindex(5, 6):
            block = filled[row : row + 2, column : column + 2]
            assert block.sum() != 2 or block[0, 0] != block[1, 1]
        if not (before & ~filled).any():
            assert (filled == before).all()


@pytest.mark.parametrize("factor", [1, 2, 5])
def test_blocks_of_cells_keep_the_volume_and_the_mean_floor_of_their_material(factor):
    """Blocks that the map does not fill count with their whole area."""
    stock = test_cells_by_loop.random_stock(np.random.default_rng(4))
    columns = stock_mesh._columns(stock, factor)
    rows, row_length = columns.floor.shape
    assert rows % stock_mesh._BLOCK == row_length % stock_mesh._BLOCK == 0
    for row, column in np.ndindex(rows, row_length):
        block = slice(row * factor, (row + 1) * factor), slice(column * factor, (column + 1) * factor)
        thickness = stock.thickness()[block]
        solid = thickness > 1e-9
        assert columns.mean[row, column] == pytest.approx(thickness.sum() / factor**2, abs=1e-9)
        floor = float(stock.floor[block][solid].astype(float).mean()) if solid.any() else 0.0
        assert columns.floor[row, column] == pytest.approx(floor, abs=1e-12)
    assert (columns.upper >= columns.lower).all()


@pytest.mark.parametrize("offset", [0.0, 0.06, 0.125, 0.19])
def test_walls_of_a_slot_are_vertical_and_in_their_place(tmp_path, offset):
    """Two depths of one slot: sections of the mesh by trimesh against the tool's radius; the volume is exact."""
    text = gcode(
        f"G0 X-30 Y{offset} Z5", "G1 Z-3 F2400", "X30", f"G0 Z5 X-30 Y{offset + 2}", "G1 Z-6", "X30", "G0 Z20"
    )  # fmt: skip
    _, found = forces(tmp_path, text, process(tool(10, 4), BLOCK))
    mesh = in_mm(found.mesh())
    assert mesh.is_watertight
    # the second pass is 2 mm beside the first: a step of 3 mm at y = offset − 3, one of 6 mm at offset + 7
    assert mesh.volume == pytest.approx(40 * (30 * 10 - 10 * 3 - 10 * 6 + 8 * 3), rel=3e-5)
    for x in (-13.13, 0.07, 17.33):
        lines = section(mesh, x)
        for wall, low, high in ((offset - 5, -3, 0), (offset - 3, -6, -3), (offset + 7, -6, 0)):
            outside, inside = (0.01, -0.01) if wall > offset else (-0.01, 0.01)
            np.testing.assert_allclose(heights(lines, wall + outside), [-10.0, high], atol=1e-3)
            np.testing.assert_allclose(heights(lines, wall + inside), [-10.0, low], atol=1e-3)


@pytest.mark.parametrize("degrees", [20, 41])
def test_a_wall_at_an_angle_has_its_place_within_a_quarter_of_a_cell(tmp_path, degrees):
    """A slot at an angle to the cells: distances of a section's corners from the axis; no face is folded."""
    tangent = math.tan(math.radians(degrees))
    text = gcode(f"G0 X-40 Y{-40 * tangent:.5f} Z5", "G1 Z-6 F2400", f"X40 Y{40 * tangent:.5f}", "G0 Z20")
    _, found = forces(tmp_path, text, process(tool(10, 4), BLOCK))
    solid = in_mm(found.mesh())
    lines = trimesh.intersections.mesh_plane(solid, [0.0, 0.0, 1.0], [0.0, 0.0, -2.999])[:, :, :2]
    across = np.abs(lines @ [-math.sin(math.radians(degrees)), math.cos(math.radians(degrees))])
    is_wall = (np.abs(lines[..., 0]).max(axis=1) < 5.0) & (across.max(axis=1) < 6.0)
    assert is_wall.sum() > 60
    assert np.abs(across[is_wall] - 5.0).max() < 0.25 / 4
    assert np.mean(across[is_wall]) == pytest.approx(5.0, abs=0.01)
    is_level = np.ptp(solid.triangles[:, :, 2], axis=1) == 0.0
    upwards = solid.triangles_center[:, 2] > -9.0
    assert (solid.triangles_cross[is_level & upwards, 2] > 0.0).all()


def test_a_groove_of_a_ball_stays_smooth(tmp_path):
    """Below 45° the mesh has no vertical faces, and its section is the circle of the ball."""
    text = gcode("G0 X-30 Y0.07 Z5", "G1 Z-3 F2400", "X30", "G0 Z20")
    _, found = forces(tmp_path, text, process(tool(12, 2, "ball"), BLOCK))
    mesh = in_mm(found.mesh())
    assert mesh.is_watertight
    area = 36 * math.acos(0.5) - 3 * math.sqrt(27)  # of a segment of the circle, 3 mm high
    assert mesh.volume == pytest.approx(40 * (300 - area), rel=1e-4)
    lines = section(mesh, 3.13)
    for y in np.arange(-4.017, 4.1, 0.37):
        assert heights(lines, y)[-1] == pytest.approx(3.0 - math.sqrt(36 - (y - 0.07) ** 2), abs=0.01)
    is_vertical = np.abs(mesh.face_normals[:, 2]) < 1e-6
    middle = mesh.triangles_center[is_vertical]
    assert not ((np.abs(middle[:, 1]) < 4.2) & (np.abs(middle[:, 0]) < 19.0)).any()


def test_level_regions_are_merged_and_others_keep_the_cells_of_the_map():
    """A box of 240 × 160 cells has a seventh of the faces of all cells; a rough surface is made coarser."""
    low, high = np.array([-0.03, -0.02, -0.01]), np.array([0.03, 0.02, 0.0])
    stock = stocks.from_box(low, high, 0.25e-3)
    box = stock_mesh.mesh_of(stock)
    assert len(box.faces) < 4 * 240 * 160 / 7
    assert in_mm(box).volume == pytest.approx(60 * 40 * 10, rel=1e-9)
    assert box.cell == stock.cell
    rng = np.random.default_rng(1)
    rough = replace(stock, high=(stock.high - rng.uniform(0, 1e-4, stock.high.shape)).astype(np.float32))
    coarse = stock_mesh.mesh_of(rough, 2000)
    assert coarse.cell > 2.5 * stock.cell
    assert len(coarse.faces) < 4 * 2000 * 1.5


@pytest.mark.parametrize("width", [0.5, 1.0])
def test_a_pass_along_the_wall_of_a_program_before_has_the_force_of_its_width(tmp_path, width):
    """A flat end of 12 mm, up-milling of a wall: sums over the angles in contact, by the linear law."""
    slot = gcode("G0 X-30 Y0 Z5", "G1 Z-6 F2400", "X30", "G0 Z20")
    _, first = forces(tmp_path, slot, process(tool(12, 3), BLOCK))
    in_mm(first.mesh()).export(tmp_path / "left.stl")
    text = gcode(f"G0 X-30 Y{-width} Z5", "G1 Z-6 F1200", "X30 (here)", "G0 Z20")
    program, found = forces(tmp_path, text, process(tool(12, 3), BLOCK), stock=tmp_path / "left.stl")
    ktc, kte, krc, kre, kac, kae = AL7075
    limit = math.acos(1.0 - width / 6.0)
    phi = math.pi - limit + (np.arange(2000) + 0.5) * limit / 2000
    chip = 1200 / 6000 / 3 * np.sin(phi)
    tangential, radial, axial = ktc * chip + kte, krc * chip + kre, kac * chip + kae
    share = 3 * 6.0 / (2 * math.pi) * limit / 2000
    x = share * np.sum(-tangential * np.cos(phi) - radial * np.sin(phi))
    y = share * np.sum(tangential * np.sin(phi) - radial * np.cos(phi))
    expected = np.array([x, y, share * axial.sum()])
    force = on_line(program, found, line_of(text, "X30 (here)"), 0.5)[:3]
    assert np.linalg.norm(force - expected) < 0.06 * np.linalg.norm(expected)


@pytest.mark.parametrize(("cell", "is_named"), [(0.25e-3, False), (0.5e-3, True)])
def test_a_mesh_with_wider_cells_than_the_map_is_a_warning_with_both_widths(cell, is_named):
    mesh = stock_mesh.RemainingMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), cell)
    issues = process_forces._coarse_mesh_issues(mesh, SimpleNamespace(stock=SimpleNamespace(cell=0.25e-3)))
    assert [(issue.level, issue.kind) for issue in issues] == [("warning", "coarse-stock")] * is_named
    assert all("cells of 0.5 mm instead of 0.25 mm" in issue.message for issue in issues)


@pytest.mark.parametrize("cell", [0.2e-3, 0.25e-3])
def test_a_wall_that_is_read_back_is_in_its_place_within_its_cell(tmp_path, cell):
    """Cells that a wall crosses have both levels, and the area below it to a quarter of a cell."""
    text = gcode("G0 X-30 Y0.06 Z5", "G1 Z-6 F2400", "X30", "G0 Z20")
    _, found = forces(tmp_path, text, process(tool(10, 4), BLOCK))
    mesh = found.mesh()
    stock = stocks.from_mesh(mesh.vertices, mesh.faces, cell)
    column = stock.high.shape[1] // 2
    y = stock.y + (np.arange(len(stock.high)) + 0.5) * cell
    covered = np.clip(0.5 + (5e-3 - np.abs(y - 0.06e-3)) / cell, 0.0, 1.0)
    inner = np.abs(y) < 10e-3
    high, low, share = (values[inner, column] for values in (stock.high, stock.low, stock.share))
    share = np.where(high < -5.9e-3, 1.0, share)
    np.testing.assert_allclose(share, covered[inner], atol=0.126)
    np.testing.assert_allclose(low[(share > 0.0) & (share < 1.0)], -6e-3, atol=1e-6)
    np.testing.assert_allclose(high[share < 1.0], 0.0, atol=1e-6)
