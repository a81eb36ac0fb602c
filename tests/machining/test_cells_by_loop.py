"""Cells of the map around an edge, and what a tool leaves in them, against loops over single points and cells."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.machining import cutting
from postproc.machining import stock as stocks
from postproc.machining.stock import Footprint, Stock
from postproc.machining.tool import Cutter

CELL = 0.8e-3
X, Y = 0.011, -0.027
SHAPE = (24, 31)
"""Rows and columns."""
TIP = -2e-3
CUTTERS = {"flat": Cutter(5e-3, 0.0, 2), "ball": Cutter(5e-3, 5e-3, 2), "bull": Cutter(5e-3, 2e-3, 2)}


def random_stock(rng, partly_cut=0.5):
    """Return a map whose cells differ in levels, shares, slopes and floors."""
    shape = SHAPE
    high = rng.uniform(-6e-3, 0.0, shape).astype(np.float32)
    low = (high - rng.uniform(-1e-3, 5e-3, shape)).astype(np.float32)
    share = np.where(rng.random(shape) < partly_cut, rng.uniform(0.02, 1.0, shape), 0.0).astype(np.float32)
    floor = np.where(rng.random(shape) < 0.2, rng.uniform(-5e-3, -1e-3, shape), -8e-3).astype(np.float32)
    slope = np.where(rng.random((*shape, 1)) < 0.7, rng.integers(-9000, 9000, (*shape, 2)), 0).astype(np.int16)
    return Stock(X, Y, CELL, high, low, share, slope, floor, float(floor.max()) + 1e-6)


def rim(rng, stock, count, radius=5e-3):
    """Return tips (3, 3) and, for points on the cylinder around each, the cells (3, count) that contain them."""
    tip = np.column_stack([rng.uniform(X + 6e-3, X + 18e-3, 3), rng.uniform(Y + 6e-3, Y + 12e-3, 3), [TIP] * 3])
    phi = (np.arange(count) + 0.5) * math.pi / count
    x, y = tip[:, :1] + radius * np.sin(phi), tip[:, 1:2] + radius * np.cos(phi)
    column, row = ((x - X) / CELL).astype(np.int32), ((y - Y) / CELL).astype(np.int32)
    return tip, (row * SHAPE[1] + column).astype(np.int32)


@pytest.mark.parametrize("seed", range(8))
def test_an_edge_is_on_the_side_of_an_earlier_cut_that_all_cells_within_two_of_it_show(seed):
    """A cell cut in part shows it by its share against that covered, one cut as a whole by its level.

    The rounding of coordinates, a hundredth of a cell, counts as equal.
    """
    rng = np.random.default_rng(seed)
    stock, radius, count = random_stock(rng, 0.2 + 0.1 * seed), 5e-3, 60
    tip, nearest = rim(rng, stock, count)
    columns = SHAPE[1]
    along_wall = rng.random() < 0.7  # most cells as a wall along the rim leaves them
    for n, k in np.ndindex(nearest.shape):
        row, column = divmod(int(nearest[n, k]), columns)
        gap = math.hypot(X + (column + 0.5) * CELL - tip[n, 0], Y + (row + 0.5) * CELL - tip[n, 1])
        covered = (radius - gap) / CELL + 0.5
        if along_wall and rng.random() < 0.9:
            shift = rng.choice([-0.3, -0.012, -0.008, 0.008, 0.012, 0.3], p=[0.05, 0.1, 0.1, 0.35, 0.1, 0.3])
            stock.share[row, column] = min(max(covered + shift, 0.0), 1.0)
    high, low, share = (values.reshape(-1).take(nearest) for values in (stock.high, stock.low, stock.share))
    # the first point of the turn is on the end face: widths and radii count from the second on
    turn = SimpleNamespace(
        radius=np.array([1e-3, *[radius] * count], np.float32), side=slice(1, 1 + count),
        width=np.array([0.9, *[math.pi / count] * count]),
    )  # fmt: skip
    levels = cutting._CellLevels(high, low, share, np.zeros_like(high))
    inside, outside = cutting._sides_of_earlier_cut(stock, nearest, tip.astype(np.float32), turn, levels)
    reach = math.ceil(2.0 * CELL / (math.pi / count * radius))
    for n in range(3):
        mids = [0.5 * (h + min(lo, h)) for h, lo, s in zip(high[n], low[n], share[n], strict=True) if s > 0.0]
        shows_inside, shows_outside, near_limit = [], [], []
        for k in range(count):
            row, column = divmod(int(nearest[n, k]), columns)
            gap = math.hypot(X + (column + 0.5) * CELL - tip[n, 0], Y + (row + 0.5) * CELL - tip[n, 1])
            covered, cut = (radius - gap) / CELL + 0.5, float(share[n, k])
            is_whole_cut = cut == 0.0 and bool(mids) and high[n, k] <= np.mean(mids)
            if is_whole_cut:
                shows_inside.append(True)
                shows_outside.append(False)
            else:
                shows_inside.append(cut > 0.0 and 0.0 < covered <= cut + 0.01)
                shows_outside.append(cut + 0.01 < covered < 1.0)
            near_limit.append(min(abs(covered - cut - 0.01), abs(covered - 1.0), abs(covered)) < 2e-4)
        for k in range(count):
            window = slice(max(k - reach, 0), k + reach + 1)
            if any(near_limit[window]):
                continue
            assert inside[n, k] == (not any(shows_outside[window]))
            assert outside[n, k] == (not any(shows_inside[window]))


def random_points(rng, count):
    """Return x, y and z (1, count) of points over the map and beside it [m]."""
    x = rng.uniform(X - 2 * CELL, X + (SHAPE[1] + 2) * CELL, (1, count)).astype(np.float32)
    y = rng.uniform(Y - 2 * CELL, Y + (SHAPE[0] + 2) * CELL, (1, count)).astype(np.float32)
    return x, y, rng.uniform(-6e-3, 0.0, (1, count)).astype(np.float32)


def around(x, y):
    """Return the four cells around a point as row, column and shares along x and y."""
    a = min(max((float(x) - X) / CELL - 0.5, 0.0), SHAPE[1] - 1.001)
    b = min(max((float(y) - Y) / CELL - 0.5, 0.0), SHAPE[0] - 1.001)
    column, row = int(a), int(b)
    along, across = a - column, b - row
    return [
        (row + j, column + i, along - i, across - j, (along if i else 1 - along) * (across if j else 1 - across))
        for j in (0, 1) for i in (0, 1)
    ]  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_pieces_of_a_round_are_in_material_by_the_surfaces_of_four_random_cells(seed):
    """Cell by cell: below the surface, above the floor, by the shares of both levels; then interpolated."""
    rng = np.random.default_rng(seed)
    stock = random_stock(rng, (0.0, 0.3, 0.6, 1.0)[seed])
    if seed == 1:
        stock.slope[:] = 0
    x, y, _ = random_points(rng, 400)
    low, rise = (rng.uniform(1e-4, 1e-3, 400).astype(np.float32) for _ in range(2))
    turn = SimpleNamespace(low=low, rise=rise, length=2 * rise, round=slice(0, 400))
    corners = cutting.nearby_cells(stock, x, y)
    compared = 0
    for z in (-6e-3, -3e-3):
        lengths = cutting._round_lengths(stock, turn, corners, np.full((1, 1), z, np.float32), seed > 0)
        for n in range(400):
            cells = around(x[0, n], y[0, n])
            highs = [float(stock.high[row, column]) for row, column, *_ in cells]
            slopes = [stock.slope[row, column] * 1e-4 * CELL for row, column, *_ in cells]
            rises = [float(slope @ (dx, dy)) for slope, (_, _, dx, dy, _) in zip(slopes, cells, strict=True)]
            weights = [cell[4] for cell in cells]
            level, lowest = np.dot(weights, highs), min(np.add(highs, rises))
            if stock.slope.any() and abs(lowest - level) < 1e-6:
                continue
            surfaces = [lowest] * 4 if lowest > level else np.add(highs, rises) - 0.5 * np.dot(weights, rises)
            bottom, expected = z + float(low[n]), 0.0
            for (row, column, *_), surface, weight in zip(cells, surfaces, weights, strict=True):
                share, lower, floor = (float(v[row, column]) for v in (stock.share, stock.low, stock.floor))
                lower = min(lower, float(stock.high[row, column]))
                upper_part, lower_part, air = (
                    min(max(v - bottom, 0.0), float(rise[n])) for v in (surface, lower, floor)
                )
                share *= seed > 0
                expected += weight * max((1 - share) * upper_part + share * lower_part - air, 0.0)
            assert float(lengths[0, n]) == pytest.approx(2 * expected, abs=4e-6)
            compared += 0.0 < expected < 0.99 * float(rise[n])
    assert compared > 60


@pytest.mark.parametrize("has_partly_cut", [False, True])
def test_differences_between_surface_and_floor_are_interpolated(has_partly_cut):
    """By a function of the levels, here a depth that is limited; both levels of a cell count by their shares."""
    rng = np.random.default_rng(5)
    stock = random_stock(rng, 0.5 if has_partly_cut else 0.0)
    x, y, _ = random_points(rng, 300)

    def depth(level):
        return np.minimum(np.maximum(level + 5e-3, 0.0), 2e-3)

    corners = cutting.nearby_cells(stock, x, y)
    differences = cutting._interpolated_difference(stock, corners, slice(100, 300), depth, has_partly_cut)
    for n in range(200):
        expected = 0.0
        for row, column, _, _, weight in around(x[0, 100 + n], y[0, 100 + n]):
            high, low, share, floor = (float(v[row, column]) for v in (stock.high, stock.low, stock.share, stock.floor))
            value = (1.0 - share) * depth(high) + share * depth(min(low, high)) - depth(floor)
            expected += weight * max(value, 0.0)
        assert float(differences[0, n]) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_the_side_of_a_tool_is_in_material_by_the_levels_of_its_cells(seed):
    """Without cells cut in part: between the floor or the lower end of the side, and the surface."""
    rng = np.random.default_rng(seed)
    stock = random_stock(rng, 0.0)
    tip, nearest = rim(rng, stock, 30)
    turn = SimpleNamespace(low=np.array([0.0, 7e-4], np.float32), side=slice(1, 31))
    height, moment = cutting._cylinder_contact(stock, nearest, tip.astype(np.float32), turn)
    for n, k in np.ndindex(nearest.shape):
        row, column = divmod(int(nearest[n, k]), SHAPE[1])
        bottom = max(float(stock.floor[row, column]) - TIP, 7e-4)
        top = max(float(stock.high[row, column]) - TIP, bottom)
        assert float(height[n, k]) == pytest.approx(top - bottom, abs=2e-9)
        assert float(moment[n, k]) == pytest.approx(0.5 * (top**2 - bottom**2), abs=1e-11)


def footprint(rng, count=40, rims=25, path=None):
    """Return random cells of a small map, several times each."""
    return Footprint(
        rng.integers(0, 30, count), rng.choice(np.arange(-8, 0) * 1e-3, count).astype(np.float32),
        np.arange(count, dtype=np.int32), rng.integers(0, 60, rims), rng.random(rims).astype(np.float32),
        rng.uniform(-8e-3, 0.0, rims).astype(np.float32), path,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
def test_of_two_footprints_the_first_keeps_what_the_second_does_not_cover_as_deep(seed):
    """Levels that differ by less than a micrometre are equal; rims are kept where the second has neither."""
    rng = np.random.default_rng(seed)
    first, second = footprint(rng), footprint(rng, 12, 8)
    if seed == 4:
        second = replace(second, cell=second.cell[:0], level=second.level[:0], segment=second.segment[:0])
    # some levels a little above and below those of the other footprint
    first.level[:] += rng.choice([-2e-6, -5e-7, 0.0, 5e-7, 2e-6], len(first.cell)).astype(np.float32)
    remaining = first.not_covered_by(second)
    kept = []
    for k, (cell, level) in enumerate(zip(first.cell, first.level, strict=True)):
        others = [float(lv) for c, lv in zip(second.cell, second.level, strict=True) if c == cell]
        if not others or min(others) > float(level) + 1e-6:
            kept.append(k)
    assert remaining.segment.tolist() == kept
    np.testing.assert_array_equal(remaining.level, first.level[kept])
    np.testing.assert_array_equal(remaining.cell, first.cell[kept])
    rims = [k for k, cell in enumerate(first.rim) if cell not in {*second.cell.tolist(), *second.rim.tolist()}]
    for name in ("rim", "coverage", "rim_level"):
        np.testing.assert_array_equal(getattr(remaining, name), getattr(first, name)[rims])


@pytest.mark.parametrize("radius", [-1e-3, 0.0, 1.9e-3, 4e-3])
def test_cells_within_a_circle_are_left_out_and_rims_are_not(radius):
    rng = np.random.default_rng(2)
    stock = random_stock(rng)
    given = footprint(rng)
    given = replace(given, cell=rng.integers(0, SHAPE[0] * SHAPE[1], 40))
    point = np.array([X + 9e-3, Y + 7e-3, 0.0])
    left = given.outside_circle(stock, point, radius)
    kept = [
        k for k, cell in enumerate(given.cell.tolist())
        if math.hypot(X + (cell % SHAPE[1] + 0.5) * CELL - point[0], Y + (cell // SHAPE[1] + 0.5) * CELL - point[1])
        >= radius
    ]  # fmt: skip
    assert left.segment.tolist() == kept
    np.testing.assert_array_equal(left.rim, given.rim)


def test_cells_of_several_parts_are_joined_in_order():
    rng = np.random.default_rng(3)
    path = (CUTTERS["flat"], np.zeros((1, 3)), np.ones((1, 3)))
    parts = [footprint(rng, 3, 2), footprint(rng, 4, 0), footprint(rng, 0, 3)]
    joined = Footprint.join(parts, path)
    assert joined.path is path
    for name in ("cell", "level", "segment", "rim", "coverage", "rim_level"):
        assert getattr(joined, name).tolist() == [value for part in parts for value in getattr(part, name).tolist()]
    nothing = Footprint.join([], path)
    assert (len(nothing.cell), len(nothing.rim), nothing.path) == (0, 0, path)


def lower_side(cutter, begin, end, x, y):
    """Return the lowest level of a tool over a point on a segment [m], by a dense search; inf beside its way."""
    t = np.linspace(0.0, 1.0, 4001)[:, None]
    tips = begin + t * (end - begin)
    gap = np.hypot(tips[:, 0] - x, tips[:, 1] - y)
    return float(
        np.where(gap < cutter.radius, tips[:, 2] + cutter.lower_side(np.minimum(gap, cutter.radius)), np.inf).min()
    )


@pytest.mark.parametrize("shape", CUTTERS)
@pytest.mark.parametrize(("dz", "heading"), [(0.0, None), (-2.5e-3, None), (2e-3, 0), (-9e-3, 1)])
def test_a_pass_leaves_the_lower_side_of_the_tool_with_its_slopes_and_the_shares_of_its_rim(shape, dz, heading):
    """Two segments: a cell has the lowest of both, unless it is lower; slopes are those of the surface around it.

    A cell that the cylinder covers in part has the share of a straight rim, if the wall is above the round.
    """
    cutter, rng = CUTTERS[shape], np.random.default_rng(8)
    stock = random_stock(rng, 0.0)
    stock.high[:] = np.where(rng.random(SHAPE) < 0.1, -9e-3, 0.0)
    stock.floor[:] = -1.2e-2
    stock.slope[:] = 1234
    before, slope_before = stock.high.copy(), stock.slope.copy()
    begin = np.array([[X + 6.3e-3, Y + 7.1e-3, -4e-3], [X + 15.3e-3, Y + 9.6e-3, -4e-3 + dz]])
    end = np.array([begin[1], [X + 15.3e-3, Y + 15e-3, -4e-3 + dz]])
    ahead = np.array([0.0, 1.0, 0.0])
    front = stocks.remove(stock, cutter, begin, end, None if heading is None else ahead)
    cells_ahead = set(front.cell.tolist())
    assert (len(front.cell) > 0) == (heading is not None)
    compared, sloped = 0, 0
    for row, column in np.ndindex(SHAPE):
        x, y, index = X + (column + 0.5) * CELL, Y + (row + 0.5) * CELL, row * SHAPE[1] + column
        gaps = []
        for a, b in zip(begin, end, strict=True):
            chord = (b - a)[:2]
            share = min(max(float((np.array([x, y]) - a[:2]) @ chord / (chord @ chord)), 0.0), 1.0)
            gaps.append(math.hypot(*(np.array([x, y]) - a[:2] - share * chord)))
        old = before[row, column]
        if index in cells_ahead or index in set(front.rim.tolist()):
            assert (stock.slope[row, column] == 1234).all() or min(gaps) < cutter.radius
            continue
        if min(gaps) > cutter.radius + 0.51 * CELL:
            assert stock.high[row, column] == old
            assert stock.share[row, column] == 0.0
            continue
        is_full = [gap < cutter.radius - 0.5 * CELL - 1e-8 for gap in gaps]
        if any(is_full):
            level = min(lower_side(cutter, a, b, x, y) for a, b, full in zip(begin, end, is_full, strict=True) if full)
            assert stock.high[row, column] == pytest.approx(min(level, old), abs=3e-6)
            compared += 1
            if level > old:
                assert (stock.slope[row, column] == slope_before[row, column]).all()
                continue
            if shape == "flat" and dz == 0.0:
                assert (stock.slope[row, column] == 0).all() or stock.share[row, column] == 0.0
            step, ways = 0.25 * CELL, [k for k in range(2) if is_full[k]]
            if len(ways) == 1 and abs(gaps[0] - gaps[1]) > 2 * CELL and max(gaps) > cutter.radius + CELL:
                a, b = begin[ways[0]], end[ways[0]]
                rises = [
                    lower_side(cutter, a, b, x + dx, y + dy) - lower_side(cutter, a, b, x - dx, y - dy)
                    for dx, dy in ((step, 0.0), (0.0, step))
                ]
                if np.isfinite(rises).all() and gaps[ways[0]] < cutter.radius - 1.0 * CELL:
                    expected = np.clip(np.array(rises) / (2 * step), -3.0, 3.0)
                    np.testing.assert_allclose(stock.slope[row, column] * 1e-4, expected, atol=6e-3)
                    sloped += bool(np.abs(expected).max() > 0.01)
        elif min(gaps) > cutter.radius - 0.5 * CELL + 1e-8 and stock.share[row, column] > 0.0:
            assert stock.share[row, column] == pytest.approx(0.5 + (cutter.radius - min(gaps)) / CELL, abs=1e-4)
            if not any(gap < cutter.radius for gap in gaps):
                assert (stock.slope[row, column] == 1234).all()  # of the part that is not cut
    assert compared > 60
    assert sloped > 5 or (shape == "flat" and dz >= -2.5e-3)
