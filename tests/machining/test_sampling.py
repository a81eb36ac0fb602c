"""Edge in material at places of a map, against loops over places and cells; and the height of a tool over a cell."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.machining.cutting import cut_edge
from postproc.machining.material import CuttingLaw
from postproc.machining.stock import Stock, tool_levels
from postproc.machining.tool import Cutter, Turn, edge

LAW = CuttingLaw((800e6, 500e6, -300e6), (30e3, -20e3, 12e3), 0.0, 0.1, "linear")
FLAT, BALL, BULL = Cutter(5e-3, 0.0, 3), Cutter(5e-3, 5e-3, 2), Cutter(8e-3, 2e-3, 5)
CELL_SIZE = 1e-3


def stock_of(seed, *, parts, floor, slopes):
    """A map of 12 by 15 cells whose levels differ from cell to cell; some cells are empty, some cut in part.

    Without slopes all cells are level; with them they are up to 0.9 steep.
    """
    rng = np.random.default_rng(seed)
    shape = (12, 15)
    ground = rng.uniform(-2e-3, 2e-3, shape) if floor else np.full(shape, -20e-3)
    high = rng.uniform(-3e-3, 6e-3, shape)
    high = np.where(rng.random(shape) < 0.2, ground, np.maximum(high, ground))
    share = np.where(rng.random(shape) < 0.5, rng.random(shape), 0.0) if parts else np.zeros(shape)
    low = high - rng.uniform(-1e-3, 3e-3, shape)
    single = [one.astype(np.float32) for one in (high, low, share, ground)]
    upper, lower, covered, under = single
    slope = rng.integers(-9000, 9000, (*shape, 2)) if slopes else np.zeros((*shape, 2))
    return Stock(0.02, -0.01, CELL_SIZE, upper, lower, covered, slope.astype(np.int16), under, float(ground.max()))


def corners(stock, x, y):
    """Cells (row, column) around a point and their weights; the first is that below and to the left."""
    rows, columns = stock.high.shape
    fx = np.clip((x - stock.x) / CELL_SIZE - 0.5, 0.0, columns - 1.001)
    fy = np.clip((y - stock.y) / CELL_SIZE - 0.5, 0.0, rows - 1.001)
    column, row = int(fx), int(fy)
    fx, fy = fx - column, fy - row
    return [
        ((row, column), (1 - fx) * (1 - fy)), ((row, column + 1), fx * (1 - fy)),
        ((row + 1, column), (1 - fx) * fy), ((row + 1, column + 1), fx * fy),
    ]  # fmt: skip


def cell_of(stock, x, y):
    """Row and column of the cell with a point, or of the nearest one."""
    rows, columns = stock.high.shape
    row, column = int((y - stock.y) / CELL_SIZE), int((x - stock.x) / CELL_SIZE)
    return min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)


def sides_of_earlier_cut(stock, turn, x, y, axis):
    """For points of the cylinder about an axis, whether they, and two cells to both sides, are inside what was cut
    before, and whether all these are outside.

    A point is outside if the cylinder covers more of its cell than was cut of it, unless that cell was cut as a whole:
    it is then as low as the cut shares of others are. Cells that the cylinder covers fully or not at all do not tell.
    """
    radius = float(turn.radius[turn.side.start])
    cells = [cell_of(stock, *point) for point in zip(x, y, strict=True)]
    middles = [
        0.5 * (float(stock.high[cell]) + min(float(stock.high[cell]), float(stock.low[cell])))
        for cell in cells
        if stock.share[cell] > 0.0
    ]
    outside, inside = [], []
    for row, column in cells:
        place = stock.x + (column + 0.5) * CELL_SIZE, stock.y + (row + 0.5) * CELL_SIZE
        covered, share = (
            (radius - np.hypot(*np.subtract(place, axis))) / CELL_SIZE + 0.5,
            float(stock.share[row, column]),
        )
        is_low = share == 0.0 and bool(middles) and stock.high[row, column] <= np.mean(middles)
        outside.append(share + 0.01 < covered < 1.0 and not is_low)
        inside.append(is_low or (share > 0.0 and 0.0 < covered <= share + 0.01))
    reach = int(np.ceil(2.0 * CELL_SIZE / (turn.width[turn.side.start] * radius)))
    around = [slice(max(k - reach, 0), k + reach + 1) for k in range(len(cells))]
    return [not any(outside[near]) for near in around], [not any(inside[near]) for near in around]


def by_loops(stock, turn, x, y, position, descent):
    """Length (n, P) and moment (n, C) of the edge in material."""
    side, tip = turn.side, position[:, 2]
    sides = [
        sides_of_earlier_cut(stock, turn, x[n, side], y[n, side], position[n, :2]) if side.start < side.stop else []
        for n in range(len(x))
    ]
    length, moment = np.zeros(x.shape), np.zeros((len(x), turn.side.stop - turn.side.start))
    for n, p in np.ndindex(*x.shape):
        z, low, rise = tip[n], float(turn.low[p]), float(turn.rise[p])
        around = corners(stock, x[n, p], y[n, p])
        if p < turn.bottom.stop:  # all that is between the tip and what it goes down by
            deep = max(descent[n], 1e-7)
            inside = 0.0
            for cell, weight in around:
                high, floor, share = (float(one[cell]) for one in (stock.high, stock.floor, stock.share))
                below = min(float(stock.low[cell]), high)
                upper, lower, under = (min(max(level - z, 0.0), deep) for level in (high, below, floor))
                inside += weight * max((1 - share) * upper + share * lower - under, 0.0)
            length[n, p] = inside / deep * turn.length[p]
        elif p < turn.round.stop:
            share_x, share_y = around[1][1] + around[3][1], around[2][1] + around[3][1]
            levels, rises, weights = [], [], [weight for _, weight in around]
            for cell, _ in around:
                steep = [1e-4 * float(each) for each in stock.slope[cell]]
                dx = (share_x - (cell[1] - around[0][0][1])) * CELL_SIZE
                dy = (share_y - (cell[0] - around[0][0][0])) * CELL_SIZE
                levels.append(float(stock.high[cell]))
                rises.append(steep[0] * dx + steep[1] * dy)
            lowest = min(level + plane_rise for level, plane_rise in zip(levels, rises, strict=True))
            is_ridge = stock.slope.any() and lowest > np.dot(weights, levels)
            inside = 0.0
            for (cell, weight), high, plane_rise in zip(around, levels, rises, strict=True):
                surface = lowest if is_ridge else high + plane_rise - 0.5 * np.dot(weights, rises)
                share, lower, floor = float(stock.share[cell]), min(float(stock.low[cell]), high), stock.floor[cell]
                upper_part, lower_part, air = (
                    min(max(level - z - low, 0.0), rise) for level in (surface, lower, floor)
                )
                inside += weight * max((1 - share) * upper_part + share * lower_part - air, 0.0)
            length[n, p] = inside / rise * turn.length[p]
        else:
            cell = cell_of(stock, x[n, p], y[n, p])
            high, floor, share = (float(one[cell]) for one in (stock.high, stock.floor, stock.share))
            if share > 0.0:
                is_inside, is_outside = (points[p - side.start] for points in sides[n])
                share = 1.0 if is_inside else 0.0 if is_outside else share
            start = float(turn.low[turn.side.start])
            under = max(floor - z, start)
            top = max(high - z, under)
            deep = max(min(float(stock.low[cell]) - z, top), under)
            length[n, p] = (1 - share) * (top - under) + share * (deep - under)
            squares = (1 - share) * (top**2 - under**2) + share * (deep**2 - under**2)
            moment[n, p - turn.side.start] = 0.5 * squares
    return length, moment


@pytest.mark.parametrize("cutter", [FLAT, BALL, BULL], ids=["flat", "ball", "bull"])
@pytest.mark.parametrize(
    ("parts", "floor", "slopes"),
    [
        (False, False, False),
        (True, False, False),
        (True, True, False),
        (False, True, False),
        (False, False, True),
        (True, True, True),
    ],
)
def test_edge_in_material_is_that_by_loops_over_places_and_cells(cutter, parts, floor, slopes):
    stock = stock_of(4, parts=parts, floor=floor, slopes=slopes)
    turn = Turn.of(edge(cutter, 2e-3), cutter, LAW, 2e-3, 0.5)
    rng = np.random.default_rng(7)
    count, places = 12, len(turn.phi)
    x = rng.uniform(0.018, 0.037, (count, places)).astype(np.float32)  # beyond the edges too
    y = rng.uniform(-0.012, 0.004, (count, places)).astype(np.float32)
    tip = rng.uniform(-4e-3, 2e-3, count).astype(np.float32)
    descent = np.where(np.arange(count) % 3, rng.uniform(1e-4, 1e-3, count), 0.0).astype(np.float32)
    axis = np.stack([rng.uniform(0.02, 0.03, count), rng.uniform(-0.008, 0.0, count)], axis=1)
    position = np.column_stack([axis, tip]).astype(np.float32)
    found = cut_edge(stock, turn, x, y, position, descent)
    length, moment = by_loops(
        stock, turn, x.astype(float), y.astype(float), position.astype(float), descent.astype(float)
    )
    # single precision; a millionth of a metre in material is taken for none
    np.testing.assert_allclose(found.length, length, rtol=2e-3, atol=3e-6)
    assert not found.length[length < 0.9e-6].any()
    np.testing.assert_allclose(found.moment, moment, rtol=1e-3, atol=2e-8)
    assert (length > 1e-5).mean() > 0.15


@pytest.mark.parametrize("cutter", [FLAT, BALL, BULL], ids=["flat", "ball", "bull"])
@pytest.mark.parametrize(
    "end", [(8e-3, 3e-3, 0.0), (8e-3, 3e-3, -4e-3), (-5e-3, 6e-3, 7e-3), (0, 0, -2e-3), (0, 0, 2e-3)]
)
def test_the_lowest_level_of_atool_over_a_cell_is_that_of_many_places_along_its_way(cutter, end):
    begin, end = np.array([[1.0, 2.0, 5e-3]]), np.array([[1.0, 2.0, 5e-3]]) + end
    px, py = np.meshgrid(np.linspace(-14e-3, 16e-3, 21), np.linspace(-13e-3, 15e-3, 19))
    away, level = tool_levels(cutter, begin, end, px[None].astype(np.float32), py[None].astype(np.float32))
    share = np.linspace(0.0, 1.0, 4001)[:, None, None]
    chord = end[0] - begin[0]
    distance = np.hypot(px - share * chord[0], py - share * chord[1])
    nearest = distance.min(axis=0)
    np.testing.assert_allclose(away[0], nearest, rtol=0, atol=3e-6)
    under = nearest < cutter.radius - 2e-5
    over = begin[0, 2] + share * chord[2] + cutter.lower_side(np.minimum(distance, cutter.radius))
    lowest = np.where(distance <= cutter.radius, over, np.inf).min(axis=0)
    np.testing.assert_allclose(
        level[0][under], lowest[under], rtol=0, atol=1.5e-5
    )  # places 2 µm apart, steep at the rim
