"""What is left of the front of a tool when it goes on: cells that the new front covers as deep wait with it."""

from __future__ import annotations

import numpy as np

from postproc.machining import stock as stocks
from postproc.machining.stock import Footprint


def footprint(cells, levels, rim=()):
    cells, rim = np.array(cells, dtype=np.int64), np.array(rim, dtype=np.int64)
    zeros = np.zeros(len(rim), np.float32)
    return Footprint(
        cells, np.array(levels, np.float32), np.zeros(len(cells), np.int32), rim, zeros + 0.5, zeros - 1e-3, None
    )


def test_cells_that_the_new_front_covers_less_deep_are_left():
    old = footprint([3, 5, 7, 9], [-2e-3, -2e-3, -2e-3, -2e-3], rim=[11, 12, 13])
    new = footprint([9, 5, 7, 5, 13], [-3e-3, -1e-3, -1e-3, -2.5e-3, -1e-3], rim=[12])
    left = old.not_covered_by(new)
    assert left.cell.tolist() == [3, 7]  # 5 is covered twice, once deeper
    assert left.rim.tolist() == [11]
    assert old.not_covered_by(Footprint.empty()).cell.tolist() == [3, 5, 7, 9]
    assert old.not_covered_by(footprint([], [], rim=[11])).rim.tolist() == [12, 13]
    assert len(Footprint.empty().not_covered_by(new).cell) == 0


def test_levels_that_differ_by_rounding_are_equal():
    old = footprint([1, 2], [-1e-3, -1e-3])
    assert old.not_covered_by(footprint([1, 2], [-1e-3 + 5e-7, -1e-3 + 2e-6])).cell.tolist() == [2]


def test_cells_around_a_circle():
    stock = stocks.from_box(np.array([0.0, 0.0, -1e-2]), np.array([1e-2, 1e-2, 0.0]), 1e-3)
    row, column = np.divmod(np.arange(stock.high.size), stock.high.shape[1])
    x, y = (column - 1.5) * 1e-3, (row - 1.5) * 1e-3
    whole = footprint(np.arange(stock.high.size), np.zeros(stock.high.size), rim=[4])
    around = whole.outside_circle(stock, np.array([4e-3, 6e-3, 0.0]), 3e-3)
    np.testing.assert_array_equal(around.cell, np.flatnonzero((x - 4e-3) ** 2 + (y - 6e-3) ** 2 >= 9e-6))
    assert around.rim.tolist() == [4]
    assert len(whole.outside_circle(stock, np.zeros(3), -1e-3).cell) == stock.high.size
