"""Length of cutting edge in material, at points around the tool."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.machining.stock import Floats, Stock
from postproc.machining.turn import Turn

_NOTHING = 1e-6
"""Engaged edge lengths below this [m] are rounding errors."""


class Engaged(Struct, frozen=True, eq=False):
    """Engaged cutting edge at n stations, at the P points of a turn.

    :param length: (n, P) length of edge in material [m].
    :param moment: (n, C) ∫ z dz over the edge in material at the C points on the cylinder, z above the tip [m²].
    """

    length: Floats
    moment: Floats


class _Corners(Struct, frozen=True, eq=False):
    """The four cells around each point: their indices in the flat map, and their weights of interpolation."""

    cell: tuple[NDArray[np.int32], ...]
    weight: tuple[Floats, ...]


def engaged(stock: Stock, turn: Turn, x: Floats, y: Floats, tip: Floats, descent: Floats) -> Engaged:
    """Return the cutting edge in material.

    :param x: (n, P) and y: coordinates of the points in the map [m].
    :param tip: (n,) height of the tip [m].
    :param descent: (n,) descent of the tool in one turn [m], > 0: the end face cuts material within it.
    """
    out = np.zeros(x.shape, dtype=np.float32)
    z = tip[:, None]
    end = turn.side.start
    if end > 0:
        around = _around(stock, x[:, :end], y[:, :end])
        in_part = _partly(stock, around)
        on_floor = float(tip.min()) < stock.ground
        if turn.round.start < end:
            level = _levels(stock, around, turn.round, z, in_part, on_floor)
            level -= z
            level -= turn.low[turn.round]
            rise = turn.rise[turn.round]
            inside = np.minimum(np.maximum(level, 0.0, out=level), rise, out=level)
            if on_floor:
                floor = stock.floor.reshape(-1).take(around.cell[0][:, turn.round]) - z
                inside -= np.minimum(np.maximum(floor - turn.low[turn.round], 0.0), rise)
                np.maximum(inside, 0.0, out=inside)
            out[:, turn.round] = inside * (turn.length[turn.round] / rise)
        if turn.bottom.start < turn.bottom.stop:
            depth = np.maximum(descent, np.float32(1e-7))[:, None]
            under = _blend(
                stock, around, turn.bottom, lambda level: np.minimum(np.maximum(level - z, 0.0), depth), in_part
            )
            out[:, turn.bottom] = under / depth * turn.length[turn.bottom]
    moment = np.zeros((len(x), 0), dtype=np.float32)
    if turn.side.start < turn.side.stop:
        at = _nearest(stock, x[:, turn.side], y[:, turn.side])
        out[:, turn.side], moment = _cylinder(stock, at, z, turn.low[turn.side.start])
    out[out < _NOTHING] = 0.0
    return Engaged(out, moment)


def _around(stock: Stock, x: Floats, y: Floats) -> _Corners:
    rows, columns = stock.high.shape
    scale = np.float32(1.0 / stock.cell)
    fx = (x - np.float32(stock.x)) * scale - np.float32(0.5)
    fy = (y - np.float32(stock.y)) * scale - np.float32(0.5)
    np.clip(fx, 0.0, np.float32(columns - 1.001), out=fx)
    np.clip(fy, 0.0, np.float32(rows - 1.001), out=fy)
    column, row = fx.astype(np.int32), fy.astype(np.int32)
    fx -= column
    fy -= row
    first = row * np.int32(columns) + column
    both = fx * fy
    return _Corners(
        (first, first + 1, first + columns, first + (columns + 1)), (1 - fx - fy + both, fx - both, fy - both, both)
    )


def _nearest(stock: Stock, x: Floats, y: Floats) -> NDArray[np.int32]:
    """Return the index of the cell that contains each point."""
    rows, columns = stock.high.shape
    scale = np.float32(1.0 / stock.cell)
    column = ((x - np.float32(stock.x)) * scale).astype(np.int32)
    row = ((y - np.float32(stock.y)) * scale).astype(np.int32)
    np.clip(column, 0, columns - 1, out=column)
    np.clip(row, 0, rows - 1, out=row)
    row *= np.int32(columns)
    row += column
    return row


def _partly(stock: Stock, around: _Corners) -> bool:
    """Return whether any of the cells is partly cut."""
    first = around.cell[0]
    columns = stock.high.shape[1]
    low, high = int(first.min()), int(first.max())
    rows = slice(low // columns, high // columns + 2)
    return bool(stock.share[rows].any())


def _blend(
    stock: Stock, around: _Corners, pieces: slice, function: Callable[[Floats], Floats], in_part: bool
) -> Floats:
    """Return function(level) − function(floor), interpolated between the cells around each point."""
    high, low, share, floor = (one.reshape(-1) for one in (stock.high, stock.low, stock.share, stock.floor))
    out = None
    for cell, weight in zip(around.cell, around.weight, strict=True):
        at = cell[:, pieces]
        top = high.take(at)
        value = function(top)
        if in_part:
            part = share.take(at)
            if part.any():
                value += part * (function(np.minimum(low.take(at), top)) - value)
        value = value - function(floor.take(at))
        np.maximum(value, 0.0, out=value)
        value *= weight[:, pieces]
        out = value if out is None else out + value
    return np.asarray(out)


def _cylinder(stock: Stock, nearest: NDArray[np.int32], tip: Floats, start: np.float32) -> tuple[Floats, Floats]:
    """Return the engaged height of the cylinder (n, K) [m], and its first moment (n, K) [m²].

    The cell that contains the point counts by its share: a second pass along the same wall is then in air.
    """
    high, low, share, floor = (
        one.reshape(-1).take(nearest) for one in (stock.high, stock.low, stock.share, stock.floor)
    )
    under = np.maximum(floor - tip, start)
    top = np.maximum(high - tip, under)
    height, moment = top - under, top * top - under * under
    if share.any():
        deep = np.maximum(np.minimum(low - tip, top), under)
        height += share * (deep - top)
        moment += share * (deep * deep - top * top)
    return height, np.float32(0.5) * moment


def _levels(stock: Stock, around: _Corners, pieces: slice, z: Floats, in_part: bool, on_floor: bool) -> Floats:
    """Return the level at each point, interpolated between the cells around it, not below the tip."""
    high, low, share, floor = (one.reshape(-1) for one in (stock.high, stock.low, stock.share, stock.floor))
    out = None
    for cell, weight in zip(around.cell, around.weight, strict=True):
        at = cell[:, pieces]
        value = high.take(at)
        np.maximum(value, z, out=value)
        if on_floor:
            empty = high.take(at) <= floor.take(at)
            np.copyto(value, np.broadcast_to(z, value.shape), where=empty)
        if in_part:
            part = share.take(at)
            if part.any():
                value += part * (np.minimum(np.maximum(low.take(at), z), value) - value)
        value *= weight[:, pieces]
        out = value if out is None else np.add(out, value, out=out)
    return np.asarray(out)
