"""Removing what a tool sweeps on a straight way from the map of the stock."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from postproc.frames import Array
from postproc.machining.stock import Floats, Stock
from postproc.machining.tool import Cutter

_NOTHING = np.float32(np.inf)
_HALVINGS = 18
_WHOLE = np.float32(0.999)
"""A cell that is cut to this share is cut."""


def remove(stock: Stock, cutter: Cutter, begin: Array, end: Array, *, last: bool) -> float:
    """Remove what a tool sweeps from one tip position to another, both (3,) [m]; the tool stands along z.

    Where the tool stands at the end, the half of it that is ahead is left for the next way, which begins there: the
    front of the next way then sees material as it is, and no cells that the end of this way has cut in part.

    :param last: nothing follows that begins here: the whole end is removed.
    :returns: how deep material was cut at most, in cells that the tool covers wholly [m].
    """
    radius, cell = cutter.radius, stock.cell
    (x0, y0, z0), (x1, y1, z1) = begin, end
    dx, dy = x1 - x0, y1 - y0
    length = math.hypot(dx, dy)
    reach = radius + cell
    rows, columns = stock.high.shape
    c0 = max(0, int((min(x0, x1) - reach - stock.x) / cell))
    c1 = min(columns, int((max(x0, x1) + reach - stock.x) / cell) + 1)
    r0 = max(0, int((min(y0, y1) - reach - stock.y) / cell))
    r1 = min(rows, int((max(y0, y1) + reach - stock.y) / cell) + 1)
    if c0 >= c1 or r0 >= r1:
        return 0.0
    here = (slice(r0, r1), slice(c0, c1))
    high = stock.high[here]
    lowest = min(z0, z1)
    if float(high.max()) <= lowest:
        return 0.0
    px = (np.arange(c0, c1, dtype=np.float32) + np.float32(0.5)) * np.float32(cell) + np.float32(stock.x - x0)
    py = ((np.arange(r0, r1, dtype=np.float32) + np.float32(0.5)) * np.float32(cell) + np.float32(stock.y - y0))[
        :, None
    ]
    if length < 1e-9:
        if not last and z1 >= z0:
            return 0.0
        away = np.sqrt(px * px + py * py)
        return _lower(stock, here, cutter, away, np.float32(lowest) + cutter.height(away).astype(np.float32), lowest)
    ux, uy, slope = np.float32(dx / length), np.float32(dy / length), (z1 - z0) / length
    along = ux * px + uy * py
    across = ux * py - uy * px
    square = across * across
    level: Floats
    if abs(slope) < 1e-9:
        nearest = np.minimum(np.maximum(along, 0.0), np.float32(length))
        away = np.sqrt(square + (along - nearest) ** 2)
        level = np.float32(z0) + cutter.height(away).astype(np.float32)
    else:
        away, level = _sloping(cutter, along, square, length, slope, z0)
    if not last:
        away = np.where(along > np.float32(length), _NOTHING, away)
    return _lower(stock, here, cutter, away, level, lowest)


def _sloping(
    cutter: Cutter, along: Floats, square: Floats, length: float, slope: float, z0: float
) -> tuple[Floats, Floats]:
    """Return the distance of each cell from the way, and the lowest level of the tool above it.

    Above a cell the height of the tool is z0 + slope·t + height(distance at t), which is convex in t.
    """
    nearest = np.minimum(np.maximum(along, 0.0), np.float32(length))
    away = np.sqrt(square + (along - nearest) ** 2)
    half = np.sqrt(np.maximum(cutter.radius**2 - square, 0.0))
    if cutter.corner == 0.0:
        t = along + half if slope < 0.0 else along - half
    elif cutter.corner >= cutter.radius * (1.0 - 1e-9):  # a ball: where its normal is square to the way
        t = along - np.float32(slope / math.sqrt(1.0 + slope * slope)) * half
    else:
        t = _lowest(cutter, along, square, half, length, slope)
    t = np.minimum(np.maximum(t, 0.0), np.float32(length))
    over = np.sqrt(square + (along - t) ** 2)
    level = np.float32(z0) + np.float32(slope) * t + cutter.height(over).astype(np.float32)
    return away, np.asarray(level, dtype=np.float32)


def _lowest(cutter: Cutter, along: Floats, square: Floats, half: Floats, length: float, slope: float) -> Array:
    """Return where on the way (t) a tool with a rounded corner is lowest above each cell, by golden section."""
    a = np.clip(along - half, 0.0, length).astype(float)
    b = np.clip(along + half, 0.0, length).astype(float)
    ratio = 0.5 * (math.sqrt(5.0) - 1.0)

    def height(t: Array) -> Array:
        return np.asarray(slope * t + cutter.height(np.sqrt(square + (along - t) ** 2)))

    for _ in range(_HALVINGS):
        one, other = b - ratio * (b - a), a + ratio * (b - a)
        left = height(one) < height(other)
        a, b = np.where(left, a, one), np.where(left, other, b)
    return np.asarray(0.5 * (a + b), dtype=np.float32)


def _lower(
    stock: Stock, here: tuple[slice, slice], cutter: Cutter, away: Floats, level: Floats, lowest: float
) -> float:
    """Lower the cells of a window under a tool, by their distance from its way; those at its rim in part."""
    high, cell = stock.high[here], np.float32(stock.cell)
    inner = np.float32(cutter.radius) - np.float32(0.5) * cell
    wall = lowest + cutter.corner < float(high.max())
    full = away < (inner if wall else np.float32(cutter.radius))
    new = np.where(full, level, _NOTHING)
    depth = float((high - np.maximum(new, stock.floor[here])).max())
    np.minimum(high, new, out=high)
    if wall:
        row, column = np.nonzero((away >= inner) & (away < inner + cell))
        if len(row):
            covered = np.minimum((inner + cell - away[row, column]) / cell, np.float32(1.0))
            _cut_in_part(stock, (row + here[0].start, column + here[1].start), covered, level[row, column])
    return max(depth, 0.0)


def _cut_in_part(stock: Stock, at: tuple[NDArray[np.int64], NDArray[np.int64]], covered: Floats, level: Floats) -> None:
    """Cut shares of cells down to levels: walls of one cell are taken to lie side by side, the deeper one inside."""
    high, low, share = stock.high[at], stock.low[at], stock.share[at]
    cuts = level < high
    low = np.minimum(low, high)
    low = np.where(share > 0.0, low, high)
    both = np.minimum(share, covered)
    most = np.maximum(share, covered)
    rest = np.where(share > covered, low, np.minimum(level, high))
    mean = (both * np.minimum(low, level) + (most - both) * rest) / np.maximum(most, np.float32(1e-6))
    stock.low[at] = np.where(cuts, mean, low)
    stock.share[at] = np.where(cuts, most, share)
    stock.high[at] = np.where(cuts & (covered > _WHOLE), level, high)
