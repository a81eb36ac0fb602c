"""Remove the volume that a tool sweeps on straight segments from the map of the stock."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.machining.stock import Floats, Stock
from postproc.machining.tool import Cutter
from postproc.program import Bools, Ints

_HALVINGS = 18
_WHOLE = np.float32(0.999)
"""A cell that is cut over at least this share of its area counts as fully cut."""
_CELLS = 200_000
"""Cells under segments that are processed together."""


class _Footprint(Struct, frozen=True, eq=False):
    """Cells under some segments, one row for each cell and segment.

    :param cell: (n,) index in the flat map of cells that the tool covers fully; level: (n,) its lower side there [m].
    :param rim: (r,) cells that its cylinder covers partly; covered: (r,) the share; rim_level: (r,) [m].
    """

    cell: Ints
    level: Floats
    rim: Ints
    covered: Floats
    rim_level: Floats


def remove(stock: Stock, cutter: Cutter, begin: Array, end: Array, last: Bools) -> None:
    """Remove the volume that a tool along z sweeps from tip positions to others, both (L, 3) [m].

    The segments make one surface: where several cover a part of one cell, the one that covers most of it counts.

    :param last: (L,) False if the next segment continues here. The half of the tool ahead of the end is then left for
        it, so that its front meets uncut material and no cells that the end of this segment has partly cut.
    """
    high = stock.high.reshape(-1)
    rims = []
    for under in _footprints(stock, cutter, begin, end, last):
        np.minimum.at(high, under.cell, under.level)
        rims.append((under.rim, under.covered, under.rim_level))
    if rims:
        cell, covered, level = (np.concatenate(column) for column in zip(*rims, strict=True))
        if len(cell):
            _cut_in_part(stock, *_widest(cell, covered, level))


def depth_of(stock: Stock, cutter: Cutter, begin: Array, end: Array) -> float:
    """Return the largest depth of cut [m] from one tip position to another, (3,) [m], in cells that the tool covers."""
    high, floor, deepest = stock.high.reshape(-1), stock.floor.reshape(-1), 0.0
    for under in _footprints(stock, cutter, begin[None], end[None], np.ones(1, dtype=bool)):
        cut = high[under.cell] - np.maximum(under.level, floor[under.cell])
        deepest = max(deepest, float(cut.max(initial=0.0)))
    return deepest


def _footprints(stock: Stock, cutter: Cutter, begin: Array, end: Array, last: Bools) -> Iterator[_Footprint]:
    """Yield the cells under segments, a few segments at a time, small ones first."""
    reach, cell = cutter.radius + stock.cell, stock.cell
    origin = np.array([stock.x, stock.y])
    most = np.array(stock.high.shape[::-1])
    low = np.minimum(begin[:, :2], end[:, :2]) - reach - origin
    high = np.maximum(begin[:, :2], end[:, :2]) + reach - origin
    first = np.clip(np.floor(low / cell).astype(np.int64), 0, most)
    count = np.clip(np.floor(high / cell).astype(np.int64) + 1, 0, most) - first
    size = count[:, 0] * count[:, 1]
    order = np.argsort(size, kind="stable")
    order = order[size[order] > 0]
    done = 0
    while done < len(order):
        rows = order[done : done + max(1, _CELLS // int(size[order[done]]))]
        rows = rows[: max(1, _CELLS // int(size[rows[-1]]))]
        done += len(rows)
        window = np.minimum(count[rows].max(axis=0), most)
        corner = np.minimum(first[rows], most - window)
        under = _under(stock, cutter, (begin[rows], end[rows], last[rows]), corner, window)
        if under is not None:
            yield under


def _under(
    stock: Stock, cutter: Cutter, segments: tuple[Array, Array, Bools], corner: Ints, window: Ints
) -> _Footprint | None:
    """Return the cells under segments (L, 3), each within a window of the map that begins at `corner` (L, 2)."""
    begin, end, last = segments
    cell, columns = stock.cell, stock.high.shape[1]
    column = corner[:, 0, None, None] + np.arange(window[0])
    row = corner[:, 1, None, None] + np.arange(window[1])[:, None]
    index = row * columns + column
    lowest = np.minimum(begin[:, 2], end[:, 2])
    top = float(stock.high[int(row.min()) : int(row.max()) + 1, int(column.min()) : int(column.max()) + 1].max())
    if top <= float(lowest.min()):
        return None
    origin = (begin[:, :2] - (stock.x, stock.y) - 0.5 * cell)[:, :, None, None]
    px = (column * cell - origin[:, 0]).astype(np.float32)
    py = (row * cell - origin[:, 1]).astype(np.float32)
    away, level, ahead = _tool_over(cutter, begin, end, px, py)
    inner = np.float32(cutter.radius - 0.5 * cell)
    wall = lowest + cutter.corner < top
    full = away < np.where(wall, inner, np.float32(cutter.radius)).astype(np.float32)[:, None, None]
    if not last.all():
        full &= ~ahead | last[:, None, None]
    rim, covered, rim_level = np.zeros(0, dtype=np.int64), np.zeros(0, np.float32), np.zeros(0, np.float32)
    if wall.any():
        part = (away >= inner) & (away < inner + np.float32(cell)) & wall[:, None, None]
        if not last.all():
            part &= ~ahead | last[:, None, None]
        rim, rim_level = index[part], level[part]
        covered = np.minimum((inner + np.float32(cell) - away[part]) / np.float32(cell), np.float32(1.0))
    return _Footprint(index[full], level[full], rim, covered, rim_level)


def _tool_over(cutter: Cutter, begin: Array, end: Array, px: Floats, py: Floats) -> tuple[Floats, Floats, Bools]:
    """Return for the cells of each segment, all (L, h, w): their distance from it [m], the lowest level of the tool
    above them [m], and whether they lie ahead of its end. Positions of cells are relative to the start of the segment.

    Above a cell the height of the tool is z + slope·t + height(distance at t), which is convex in t.
    """
    chord = end - begin
    run = np.hypot(chord[:, 0], chord[:, 1])
    still = run < 1e-9
    unit = np.where(still[:, None], [1.0, 0.0], chord[:, :2] / np.where(still, 1.0, run)[:, None])
    ux, uy, length = (one.astype(np.float32)[:, None, None] for one in (unit[:, 0], unit[:, 1], run))
    along = ux * px + uy * py
    across = ux * py - uy * px
    square = across * across
    nearest = np.minimum(np.maximum(along, 0.0), length)
    away = np.sqrt(square + (along - nearest) ** 2)
    z = np.where(still, np.minimum(begin[:, 2], end[:, 2]), begin[:, 2]).astype(np.float32)[:, None, None]
    slope = np.where(still, 0.0, chord[:, 2] / np.where(still, 1.0, run))
    up = still & (chord[:, 2] >= 0.0)  # or no motion: all of it is left for the next segment
    ahead = np.where(still[:, None, None], up[:, None, None], along > length)
    if np.abs(slope).max() < 1e-9:
        return away, np.broadcast_to(z + cutter.height(away).astype(np.float32), away.shape), ahead
    slope_ = slope.astype(np.float32)[:, None, None]
    half = np.sqrt(np.maximum(np.float32(cutter.radius**2) - square, 0.0))
    if cutter.corner == 0.0:
        t = np.where(slope_ < 0.0, along + half, along - half)
    elif cutter.corner >= cutter.radius * (1.0 - 1e-9):  # a ball: where its normal is square to the segment
        t = along - slope_ / np.sqrt(1.0 + slope_ * slope_) * half
    else:
        t = _lowest(cutter, along, square, half, length, slope_)
    t = np.minimum(np.maximum(t, 0.0), length)
    over = np.sqrt(square + (along - t) ** 2)
    return away, np.asarray(z + slope_ * t + cutter.height(over), dtype=np.float32), ahead


def _lowest(cutter: Cutter, along: Floats, square: Floats, half: Floats, length: Floats, slope: Floats) -> Floats:
    """Return the position t on the segment where a bull-nose tool is lowest above each cell, by golden section."""
    a = np.minimum(np.maximum(along - half, 0.0), length).astype(float)
    b = np.minimum(np.maximum(along + half, 0.0), length).astype(float)
    ratio = 0.5 * (math.sqrt(5.0) - 1.0)

    def height(t: Array) -> Array:
        return np.asarray(slope * t + cutter.height(np.sqrt(square + (along - t) ** 2)))

    for _ in range(_HALVINGS):
        one, other = b - ratio * (b - a), a + ratio * (b - a)
        left = height(one) < height(other)
        a, b = np.where(left, a, one), np.where(left, other, b)
    return np.asarray(0.5 * (a + b), dtype=np.float32)


def _widest(cell: Ints, covered: Floats, level: Floats) -> tuple[Ints, Floats, Floats]:
    """Return each cell once, with the largest share that a segment covers, and the level of that segment."""
    order = np.lexsort((covered, cell))
    final = order[np.flatnonzero(np.diff(cell[order], append=-1))]
    return cell[final], covered[final], level[final]


def _cut_in_part(stock: Stock, at: Ints, covered: Floats, level: Floats) -> None:
    """Cut shares of cells down to levels. Cut areas of one cell are assumed nested, the smaller inside the larger."""
    own_high, own_low, own_share = (one.reshape(-1) for one in (stock.high, stock.low, stock.share))
    high, low, share = own_high[at], own_low[at], own_share[at]
    cuts = level < high
    low = np.where(share > 0.0, np.minimum(low, high), high)
    both = np.minimum(share, covered)
    most = np.maximum(share, covered)
    rest = np.where(share > covered, low, np.minimum(level, high))
    mean = (both * np.minimum(low, level) + (most - both) * rest) / np.maximum(most, np.float32(1e-6))
    own_low[at] = np.where(cuts, mean, low)
    own_share[at] = np.where(cuts, most, share)
    own_high[at] = np.where(cuts & (covered > _WHOLE), level, high)
