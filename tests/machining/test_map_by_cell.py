"""The map of the stock, function by function: cells, levels and meshes against sums and searches cell by cell."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.errors import ForceError
from postproc.machining import remaining
from postproc.machining import stock as stocks
from postproc.machining.remaining import Ceiling
from postproc.machining.stock import Footprint, Stock
from postproc.machining.tool import Cutter

CELL_SIZE = 1e-3
SIZE = (30, 40)
"""Rows and columns."""


def made_stock(seed=1, x=0.013, y=-0.024, floor=-0.02):
    """A map with random levels; x and y are its corner [m]."""
    rng = np.random.default_rng(seed)
    high = rng.uniform(-0.008, 0.0, SIZE).astype(np.float32)
    share = np.where(rng.random(SIZE) < 0.2, rng.random(SIZE), 0.0).astype(np.float32)
    low = (high - rng.uniform(0.0, 0.005, SIZE)).astype(np.float32)
    floors = np.full(SIZE, floor, dtype=np.float32)
    empty = rng.random(SIZE) < 0.1
    high[empty] = floors[empty]
    return Stock(x, y, CELL_SIZE, high, low, share, stocks.zero_slopes(high), floors, floor)


def middles(stock):
    rows, columns = stock.high.shape
    return np.meshgrid(stock.x + (np.arange(columns) + 0.5) * CELL_SIZE, stock.y + (np.arange(rows) + 0.5) * CELL_SIZE)


def segments(seed, count=12):
    """Begins and ends of segments over a map and beside it, some of them vertical."""
    rng = np.random.default_rng(seed)
    low, high = [0.005, -0.03, -0.01], [0.06, 0.01, 0.002]
    begin, end = rng.uniform(low, high, (2, count, 3))
    end[:2, :2] = begin[:2, :2]
    end[2:5, 2] = begin[2:5, 2]
    return begin, end


@pytest.mark.parametrize("most", [200_000, 700, 1])
@pytest.mark.parametrize("corner", [(0.013, -0.024), (-0.05, 0.004), (0.0, 0.0)])
def test_windows_hold_all_cells_within_reach_of_each_segment(monkeypatch, most, corner):
    """Each segment over the map is in one batch; small windows come first, and a batch is limited in cells."""
    monkeypatch.setattr(stocks, "MOST_CELLS_AT_ONCE", most)
    stock = made_stock(x=corner[0], y=corner[1])
    begin, end = segments(2)
    moved = np.array([*corner, 0.0]) - [0.013, -0.024, 0.0]
    begin, end = begin + moved, end + moved
    reach = 4.2e-3
    x, y = middles(stock)
    seen, sizes = [], []
    for rows, first, window in stocks.windows(stock, reach, begin, end):
        needed = []
        for row, (column, line) in zip(rows, first, strict=True):
            assert column >= 0
            assert line >= 0
            assert column + window[0] <= SIZE[1]
            assert line + window[1] <= SIZE[0]
            low = np.minimum(begin[row], end[row])[:2] - reach
            high = np.maximum(begin[row], end[row])[:2] + reach
            near = (x + 0.5 * CELL_SIZE > low[0]) & (x - 0.5 * CELL_SIZE < high[0])
            near &= (y + 0.5 * CELL_SIZE > low[1]) & (y - 0.5 * CELL_SIZE < high[1])
            lines, columns = np.nonzero(near)
            assert near.any()
            assert columns.min() >= column
            assert columns.max() < column + window[0]
            assert lines.min() >= line
            assert lines.max() < line + window[1]
            needed.append((np.ptp(columns) + 1, np.ptp(lines) + 1))
        seen += rows.tolist()
        sizes.append(max(a * b for a, b in needed))
        assert len(rows) == 1 or len(rows) * sizes[-1] <= most
        assert window.tolist() == np.max(needed, axis=0).tolist()
    assert sizes == sorted(sizes)
    inside = [
        row for row in range(len(begin))
        if ((np.maximum(begin, end)[row, :2] + reach > [stock.x, stock.y])
            & (np.minimum(begin, end)[row, :2] - reach < [stock.x + 0.04, stock.y + 0.03])).all()
    ]  # fmt: skip
    assert sorted(seen) == inside


def lowest(cutter, begin, end, px, py):
    """Lowest level of a tool above a point on a segment [m], by a search over 1001 places; inf where it is beside."""
    t = np.linspace(0.0, 1.0, 1001)[:, None]
    places = begin + t * (end - begin)
    distance = np.hypot(places[:, 0] - px, places[:, 1] - py)
    inside = distance <= cutter.radius
    return float((places[:, 2] + cutter.lower_side(np.minimum(distance, cutter.radius)))[inside].min(initial=np.inf))


CUTTERS = {"flat": Cutter(5e-3, 0.0, 2), "ball": Cutter(5e-3, 5e-3, 2), "bull": Cutter(5e-3, 2e-3, 2)}


@pytest.mark.parametrize("shape", CUTTERS)
@pytest.mark.parametrize("seed", range(4))
def test_the_level_above_a_cell_is_the_lowest_that_the_tool_reaches_there(shape, seed):
    cutter = CUTTERS[shape]
    rng = np.random.default_rng(seed)
    begin = rng.uniform(-0.01, 0.01, (6, 3))
    end = begin + rng.uniform(-0.02, 0.02, (6, 3)) * (1, 1, 0.6)
    end[0, :2], end[1, 2] = begin[0, :2], begin[1, 2]
    if seed == 0:
        end[:, 2] = begin[:, 2]
    points = rng.uniform(-0.02, 0.02, (6, 25, 2))
    px, py = points[..., 0].astype(np.float32)[:, None], points[..., 1].astype(np.float32)[:, None]
    distance, level = stocks.tool_levels(cutter, begin, end, px, py)
    for k in range(6):
        for n in range(25):
            place = begin[k, :2] + points[k, n]
            share = np.clip(points[k, n] @ (end - begin)[k, :2] / max(((end - begin)[k, :2] ** 2).sum(), 1e-18), 0, 1)
            gap = np.hypot(*(place - begin[k, :2] - share * (end - begin)[k, :2]))
            assert distance[k, 0, n] == pytest.approx(gap, abs=2e-8)
            if gap < cutter.radius - 1e-4:
                assert level[k, 0, n] == pytest.approx(lowest(cutter, begin[k], end[k], *place), abs=4e-5)


@pytest.mark.parametrize("shape", CUTTERS)
def test_cells_that_the_tool_covers_are_cut_to_its_lowest_level(shape):
    """Whole cells only where the tool is over all of it; what is lower already stays."""
    cutter = CUTTERS[shape]
    stock = replace(made_stock(3), share=np.zeros(SIZE, dtype=np.float32))
    before = stock.high.copy()
    begin, end = segments(5, 4)
    depth = stocks.depth_of_cut(stock, cutter, begin, end)
    stocks.remove(stock, cutter, begin, end)
    x, y = middles(stock)
    deepest = 0.0
    for row, column in np.ndindex(SIZE):
        px, py = x[row, column], y[row, column]
        levels = [lowest(cutter, begin[k], end[k], px, py) for k in range(4)]
        gaps = []
        for k in range(4):
            chord = (end - begin)[k, :2]
            share = np.clip((np.array([px, py]) - begin[k, :2]) @ chord / max(chord @ chord, 1e-18), 0.0, 1.0)
            gaps.append(float(np.hypot(*(np.array([px, py]) - begin[k, :2] - share * chord))))
        inner = [level for level, gap in zip(levels, gaps, strict=True) if gap < cutter.radius - 0.51 * CELL_SIZE]
        expected = min([float(before[row, column]), *inner])
        if min(gaps) > cutter.radius + 0.51 * CELL_SIZE:
            assert stock.high[row, column] == before[row, column]
        elif inner:
            assert stock.high[row, column] <= expected + 2e-5
            deepest = max(deepest, before[row, column] - max(expected, stock.floor[row, column]))
    assert (stock.high <= before).all()
    assert depth == pytest.approx(deepest, abs=1e-3)


def test_each_cell_of_a_rim_counts_once_with_its_largest_coverage():
    rng = np.random.default_rng(7)
    cell = rng.integers(0, 9, 60)
    coverage, level = rng.permutation(60).astype(np.float32) / 60, rng.normal(size=60).astype(np.float32)
    cells, shares, levels = stocks._largest_coverage(cell, coverage, level)
    assert cells.tolist() == sorted(set(cell.tolist()))
    for k, number in enumerate(cells):
        own = np.flatnonzero(cell == number)
        best = own[np.argmax(coverage[own])]
        assert (shares[k], levels[k]) == (coverage[best], level[best])


def area_of(high, low, share):
    """Mean level of a cell whose left part, a share of it, is lower."""
    return (1.0 - share) * high + share * low


@pytest.mark.parametrize("seed", range(20))
def test_a_cut_of_a_part_of_a_cell_removes_the_volume_of_that_part(seed):
    """Parts of one cell are nested: the smaller of two is inside the larger. By a sum over a thousand strips."""
    rng = np.random.default_rng(seed)
    high, low, share = 0.0, float(-rng.uniform(0.001, 0.01)), float(rng.choice([0.0, rng.random()]))
    coverage, level = float(rng.uniform(0.05, 0.95)), float(rng.uniform(-0.012, 0.003))
    stock = Stock(
        0.0, 0.0, CELL_SIZE, *(np.full((1, 1), value, dtype=np.float32) for value in (high, low, share)),
        np.ones((1, 1, 2), dtype=np.int16), np.full((1, 1), -0.02, dtype=np.float32), -0.02,
    )  # fmt: skip
    numbers = np.array([0]), np.array([coverage], dtype=np.float32), np.array([level], dtype=np.float32)
    stocks._cut_in_part(stock, *numbers)
    strips = (np.arange(1000) + 0.5) / 1000
    surface = np.where(strips < share, low, high)
    if level < high:
        surface = np.minimum(surface, np.where(strips < coverage, level, high))
    found = area_of(float(stock.high[0, 0]), float(stock.low[0, 0]), float(stock.share[0, 0]))
    assert found == pytest.approx(surface.mean(), abs=2e-5)
    assert (stock.slope == 1).all()  # of the part that is not cut
    assert stock.share[0, 0] == pytest.approx(max(share, coverage) if level < high else share)


def test_a_cell_that_is_nearly_covered_is_cut_as_a_whole():
    for coverage, is_whole in ((0.9985, False), (0.9995, True)):
        stock = Stock(
            0.0, 0.0, CELL_SIZE, *(np.full((1, 1), value, dtype=np.float32) for value in (0.0, -0.02, 0.0)),
            np.zeros((1, 1, 2), dtype=np.int16), np.full((1, 1), -0.02, dtype=np.float32), -0.02,
        )  # fmt: skip
        stocks._cut_in_part(stock, np.array([0]), np.float32([coverage]), np.float32([-0.005]))
        assert stock.high[0, 0] == np.float32(-0.005 if is_whole else 0.0)


@pytest.mark.parametrize("shape", CUTTERS)
@pytest.mark.parametrize("slope", [0.0, -0.4, 0.3])
def test_the_front_of_a_tool_is_where_its_surface_moves_outwards(shape, slope):
    """By the level of the tool above a cell a micrometre further on: it is lower there, or the cell is new."""
    cutter, stock = CUTTERS[shape], made_stock()
    travel = np.array([0.6, 0.8, slope])
    travel /= np.linalg.norm(travel)
    point = np.array([stock.x + 0.0202, stock.y + 0.0151, -0.004])
    index = np.arange(stock.high.size)
    x, y = (values.ravel() for values in middles(stock))
    distance = np.hypot(x - point[0], y - point[1])
    near = distance < cutter.radius - 0.2 * CELL_SIZE
    found = stocks._is_under_front(stock, cutter, index, point, travel, rim=False)
    step = 1e-6 * travel
    after = np.hypot(x - point[0] - step[0], y - point[1] - step[1])
    falls = step[2] + cutter.lower_side(after) - cutter.lower_side(distance)
    along = (x - point[0]) * travel[0] + (y - point[1]) * travel[1]
    if shape == "flat" and slope != 0.0:
        expected = np.full(len(x), slope < 0.0)  # the end face moves down, or up
    elif shape == "flat":
        expected = along > 0.0
    elif slope == 0.0:
        expected = along > 0.0
        near &= distance > cutter.radius - cutter.corner + 1e-5  # the flat of the end neither sinks nor rises
    else:
        expected = falls < 0.0
    np.testing.assert_array_equal(found[near], expected[near])
    rim = stocks._is_under_front(stock, cutter, index, point, travel, rim=True)
    np.testing.assert_array_equal(rim, along > 0.0)


def test_a_map_of_a_box_has_its_volume_wherever_its_sides_are():
    """Sides within cells: partly covered cells have the share of their area."""
    rng = np.random.default_rng(9)
    for _ in range(10):
        low = rng.uniform(-0.02, 0.02, 3)
        size = rng.uniform(0.004, 0.02, 3)
        stock = stocks.from_box(low, low + size, CELL_SIZE)
        assert stock.volume() == pytest.approx(size.prod(), rel=1e-5)
        assert stock.top == pytest.approx((low + size)[2], abs=1e-8)
        x0, x1, y0, y1 = stock.bounds
        assert x0 == pytest.approx(low[0] - 2 * CELL_SIZE)
        assert y0 == pytest.approx(low[1] - 2 * CELL_SIZE)
        assert x1 == pytest.approx(x0 + stock.high.shape[1] * CELL_SIZE)
        assert y1 == pytest.approx(y0 + stock.high.shape[0] * CELL_SIZE)
        assert low[0] + size[0] + 1.99 * CELL_SIZE <= x1 < low[0] + size[0] + 3.01 * CELL_SIZE


def test_a_map_that_would_be_too_large_names_a_resolution_that_is_not():
    with pytest.raises(ForceError, match=r"10004 × 10004 cells") as refused:
        stocks.from_box(np.zeros(3), np.array([1.0, 1.0, 0.1]), 1e-4, "process.toml")
    resolution = float(str(refused.value).partition("resolution_mm = ")[2].split()[0])
    assert (1e3 / resolution + 4) ** 2 < 60e6
    assert (1e3 / (0.7 * resolution) + 4) ** 2 > 60e6


def prism(angle, size=(0.012, 0.008, 0.006)):
    """A box turned about z, as a mesh."""
    corners = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)]) * size
    c, s = np.cos(angle), np.sin(angle)
    return corners @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]).T + [0.02, -0.01, 0.003], remaining._FACES


@pytest.mark.parametrize("most", [4_000_000, 300])
@pytest.mark.parametrize("angle", [0.0, 0.4, 1.1])
def test_a_map_of_a_mesh_has_its_volume_and_levels(monkeypatch, most, angle):
    """To the sixteenth of a cell along its sides; in batches of any size."""
    monkeypatch.setattr(stocks, "MOST_PAIRS", most)
    vertices, faces = prism(angle)
    stock = stocks.from_mesh(vertices, faces, 0.5e-3)
    volume, side = 0.012 * 0.008 * 0.006, 2 * (0.012 + 0.008) * 0.006
    assert stock.volume() == pytest.approx(volume, abs=0.07 * side * 0.5e-3)
    solid = stock.high > stock.floor
    np.testing.assert_allclose(stock.high[solid], 0.009, atol=1e-7)
    np.testing.assert_allclose(stock.floor[solid], 0.003, atol=1e-7)
    assert stock.ground == pytest.approx(0.003, abs=2e-6)


def test_a_sloping_face_has_its_level_in_the_middle_of_each_cell():
    """A wedge: the height grows along x from 2 to 8 mm."""
    vertices, faces = prism(0.0)
    vertices[[5, 7], 2] += 0.006
    stock = stocks.from_mesh(vertices, faces, 1e-3)
    x, _ = middles(stock)
    inner = (stock.share == 0.0) & (stock.high > stock.floor)
    expected = 0.009 + 0.006 * (x - 0.02) / 0.012
    np.testing.assert_allclose(stock.high[inner], expected[inner], atol=1e-7)
    assert inner.sum() == 96


@pytest.mark.parametrize("factor", [2, 3])
def test_finer_cells_have_the_surface_of_a_plane_and_the_walls_of_the_wider_ones(factor):
    """A plane with slopes is continued exactly; cells with a wall, or next to one, keep their level."""
    stock = replace(made_stock(5), share=np.zeros(SIZE, dtype=np.float32))
    x, y = middles(stock)

    def plane(px, py):
        return -0.004 + 0.05 * (px - stock.x) - 0.03 * (py - stock.y)

    stock.high[:] = plane(x, y)
    stock.slope[..., 0], stock.slope[..., 1] = 500, -300
    stock.share[10, 12], stock.slope[10, 12] = 0.4, 0
    fine = stocks.refine(stock, factor)
    assert fine.cell == pytest.approx(CELL_SIZE / factor)
    fine_x, fine_y = np.meshgrid(
        stock.x + (np.arange(SIZE[1] * factor) + 0.5) * fine.cell,
        stock.y + (np.arange(SIZE[0] * factor) + 0.5) * fine.cell,
    )
    expected = plane(fine_x, fine_y)
    inner = np.zeros(fine.high.shape, dtype=bool)
    inner[factor:-factor, factor:-factor] = True
    inner[9 * factor : 12 * factor, 11 * factor : 14 * factor] = False
    np.testing.assert_allclose(fine.high[inner], expected[inner], atol=1e-8)
    block = slice(10 * factor, 11 * factor), slice(12 * factor, 13 * factor)
    assert (fine.high[block] == stock.high[10, 12]).all()
    assert (fine.share[block] == np.float32(0.4)).all()
    assert (fine.slope[2 * factor, 2 * factor] == [500, -300]).all()
    assert fine.volume() == pytest.approx(stock.volume(), rel=1e-4)


def test_rectangles_of_one_level_are_all_cells_once():
    rng = np.random.default_rng(13)
    for _ in range(20):
        level = rng.choice([-np.inf, 1.0, 2.0], (7, 9))
        seen = np.full(level.shape, -np.inf)
        boxes = remaining._boxes(level)
        for first, last, top, bottom, height in boxes:
            assert first < last
            assert top < bottom
            assert (seen[top:bottom, first:last] == -np.inf).all()
            seen[top:bottom, first:last] = height
        np.testing.assert_array_equal(seen, level)
    whole = np.ones((4, 5))
    assert remaining._boxes(whole) == [(0, 5, 0, 4, 1.0)]


def test_the_coarse_stock_is_the_highest_material_and_sinks_where_it_is_removed(monkeypatch):
    monkeypatch.setattr(remaining, "MOST_SIDE_CELLS", 14)
    stock = made_stock(6)
    ceiling = Ceiling(stock)
    assert ceiling.cell == pytest.approx(3 * CELL_SIZE)  # 40 cells in 14 at most

    def highest():
        out = np.full((10, 14), -np.inf)
        for row, column in np.ndindex(SIZE):
            if stock.high[row, column] > stock.floor[row, column]:
                out[row // 3, column // 3] = max(out[row // 3, column // 3], stock.high[row, column])
        return out

    first = highest()
    np.testing.assert_array_equal(ceiling.levels_before(0), first)
    x0, y0 = stock.x, stock.y
    low, high = np.array([x0 + 0.0061, y0 + 0.0031, -1.0]), np.array([x0 + 0.0119, y0 + 0.0089, 1.0])
    assert ceiling.highest_level(low, high) == first[1:3, 2:4].max()
    beside = np.array([1.0, 0.0, 0.0])
    assert ceiling.highest_level(low + beside, high + beside) == -np.inf
    stock.high[3:9, 6:12] -= np.float32(0.003)
    ceiling.record_removal(low, high, 4)
    second = highest()
    stock.high[0:3, 0:3] = stock.floor[0:3, 0:3]
    ceiling.record_removal(np.array([x0, y0, 0.0]), np.array([x0 + 0.0029, y0 + 0.0029, 0.0]), 7)
    third = highest()
    assert third[0, 0] == -np.inf
    for motion, expected in ((4, first), (5, second), (7, second), (8, third)):
        np.testing.assert_array_equal(ceiling.levels_before(motion), expected)
    assert ceiling.highest_level(low, high) == second[1:3, 2:4].max()
    vertices, faces = ceiling.mesh(8)
    top = vertices[:, 2].max()
    assert top == pytest.approx(third.max())
    for row, column in np.ndindex(10, 14):
        px, py = x0 + (column + 0.5) * ceiling.cell, y0 + (row + 0.5) * ceiling.cell
        boxes = vertices.reshape(-1, 8, 3)
        inside = (boxes.min(axis=1)[:, :2] < [px, py]).all(axis=1) & (boxes.max(axis=1)[:, :2] > [px, py]).all(axis=1)
        if third[row, column] == -np.inf:
            assert not inside.any()
            continue
        (level,) = boxes[inside].max(axis=1)[:, 2]
        assert third[row, column] - 1e-9 <= level < third[row, column] + 0.5 * ceiling.cell
        assert boxes[inside].min(axis=1)[0, 2] == pytest.approx(-0.02)
    assert faces.shape == (12 * len(boxes), 3)


def test_pieces_of_a_segment_are_equal_and_no_longer_than_the_step():
    begin, end = np.array([1.0, 2.0, 3.0]), np.array([4.0, 6.0, 3.0])
    for step, count in ((5.0, 1), (4.99, 2), (1.0, 5), (0.999, 6), (9.0, 1)):
        pieces = list(remaining._segment_pieces(begin, end, step))
        assert len(pieces) == count
        places = [pieces[0][0][0], *(stop[0] for _, stop in pieces)]
        np.testing.assert_allclose(places, begin + np.linspace(0, 1, count + 1)[:, None] * (end - begin))
        for (_, stop), (start, _) in itertools.pairwise(pieces):
            np.testing.assert_array_equal(stop, start)


def test_a_copied_part_of_a_map_has_its_place_and_its_own_levels():
    stock = made_stock(7)
    stock.slope[5, 9] = 77
    low, high = np.array([stock.x + 0.0062, stock.y + 0.0031, 0]), np.array([stock.x + 0.0118, stock.y + 0.0089, 0])
    part = remaining._copied_part(stock, low, high)
    assert (part.x, part.y) == pytest.approx((stock.x + 0.006, stock.y + 0.003))
    assert part.high.shape == (7, 7)
    for name in ("high", "low", "share", "slope", "floor"):
        np.testing.assert_array_equal(getattr(part, name), getattr(stock, name)[3:10, 6:13])
    assert (part.slope[2, 3] == 77).all()
    part.high[:], part.slope[:] = 9.0, 1
    assert stock.high.max() < 1.0
    assert (stock.slope[5, 9] == 77).all()
    outside = remaining._copied_part(stock, low - 1.0, high + 1.0)
    assert (outside.x, outside.high.shape) == (stock.x, SIZE)


def test_the_mean_thickness_counts_both_levels_of_a_cell():
    stock = made_stock(8)
    expected = np.zeros(SIZE)
    for row, column in np.ndindex(SIZE):
        high, low, floor = (float(values[row, column]) for values in (stock.high, stock.low, stock.floor))
        share = float(stock.share[row, column])
        expected[row, column] = (1 - share) * max(high - floor, 0) + share * max(min(low, high) - floor, 0)
    np.testing.assert_allclose(stock.thickness(), expected, atol=1e-8)
    assert stock.volume() == pytest.approx(expected.sum() * CELL_SIZE**2)
    empty = replace(stock, high=stock.floor)
    assert empty.top == -np.inf
    assert Footprint.empty().path is None


def test_a_long_map_counts_its_cells_by_both_sides():
    """1 m by 2 mm in cells of 0.1 mm is small; 7 m by 0.1 m is too large."""
    stocks.from_box(np.zeros(3), np.array([1.0, 0.002, 0.01]), 1e-4)
    with pytest.raises(ForceError, match=r"1004 × 70004 cells"):
        stocks.from_box(np.zeros(3), np.array([0.1, 7.0, 0.01]), 1e-4)
    with pytest.raises(ForceError, match=r"70004 × 1004 cells"):
        stocks.from_box(np.zeros(3), np.array([7.0, 0.1, 0.01]), 1e-4)


@pytest.mark.parametrize(("covered", "sixteenths"), [(0.1, 0), (0.2, 4), (0.4, 8), (0.7, 12), (0.9, 16)])
def test_a_mesh_covers_sixteenths_of_a_cell(covered, sixteenths):
    """By the middles of four columns of a cell, at its sides along x and y."""
    vertices, faces = prism(0.0, (0.012, 0.008 + covered * CELL_SIZE, 0.006))
    stock = stocks.from_mesh(vertices, faces, CELL_SIZE)
    last = stock.share[10, 5]
    assert last == pytest.approx(1.0 - sixteenths / 16 if sixteenths else 0.0)
    assert (stock.high[10, 5] > stock.floor[10, 5]) == (sixteenths > 0)
