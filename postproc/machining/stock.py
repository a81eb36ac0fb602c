"""The stock as a height map with two levels in each cell, and the removal of what a tool sweeps.

A plain height map locates a wall to half a cell, an error of several per cent of the force at small widths of cut. So
each cell has two levels and the share of its area at the lower one, which locates a wall within the cell. And it has
the slope of the surface in its middle: levels and slopes of neighbours locate the ridge between two passes, and follow
the round of a groove. The errors of volumes and forces are of second order in the width of a cell.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.chunks import ragged_range
from postproc.errors import ForceError
from postproc.frames import Array
from postproc.machining.material import Floats
from postproc.machining.tool import Cutter
from postproc.program import Bools, Ints

_BORDER = 2
"""Number of cells of air around the stock."""
_MOST_CELLS = 60_000_000
"""Largest number of cells of a map: their upper levels take 240 MB."""
SLOPE = 1e-4
"""Unit of slopes in the map,"""
STEEPEST_SLOPE = 3.0
"""and the steepest one: walls are located by the levels of their cells."""
_SLOPE_STEP = 0.25
"""Distance from the middle of a cell of the two levels from which its slope is computed, in cells (assumed)."""
_FLATNESS = 0.05
"""Heights of a mesh in a cell are in a plane if they are at most this far from it, in cells (assumed): a round of three
cells is within 0.04."""
_SUBDIVISION = 4
"""Number of columns and of rows into which a cell is divided to find the share of it that a mesh covers (assumed)."""
MOST_PAIRS = 4_000_000
"""Largest number of pairs of triangle and cell that are processed at once: it limits memory."""


class MapBounds(NamedTuple):
    """The outer edges of a height map [m]."""

    x_low: float
    x_high: float
    y_low: float
    y_high: float


class Stock(Struct, frozen=True, eq=False):
    """Material between `floor` and the levels of its cells. Metres, in the frame of the height map: z along the tool.

    :param x: smallest x of the map, the edge of the first column.
    :param y: smallest y of the map, the edge of the first row.
    :param cell: width of a cell.
    :param high: (ny, nx) upper level; the map is changed in place as material is removed.
    :param low: (ny, nx) lower level; counts only where `share` is not 0.
    :param share: (ny, nx) share of the area of each cell that is at the lower level, 0 … 1.
    :param slope: (ny, nx, 2) slope of the surface along x and y in the middle of the cell, in units of `SLOPE`; 0 where
        the surface is level or its slope is not known.
    :param floor: (ny, nx) lower side of the material; it never changes.
    :param ground: just above the largest value of `floor`, which is rounded to single precision.
    """

    x: float
    y: float
    cell: float
    high: Floats
    low: Floats
    share: Floats
    slope: NDArray[np.int16]
    floor: Floats
    ground: float

    def thickness(self) -> Array:
        """Return the mean thickness of material in each cell (ny, nx) [m]; both levels count by their shares."""
        high = np.maximum(self.high - self.floor, 0.0)
        low = np.maximum(np.minimum(self.low, self.high) - self.floor, 0.0)
        return np.asarray(high + self.share * (low - high), dtype=float)

    def volume(self) -> float:
        """Return the volume of material [m³]."""
        return float(self.thickness().sum()) * self.cell**2

    @property
    def top(self) -> float:
        """Height of the highest material [m]; minus infinity without material."""
        solid = self.high > self.floor
        return float(self.high[solid].max()) if solid.any() else float("-inf")

    @property
    def bounds(self) -> MapBounds:
        """The outer edges of the height map."""
        rows, columns = self.high.shape
        return MapBounds(self.x, self.x + columns * self.cell, self.y, self.y + rows * self.cell)

    @property
    def material_bounds(self) -> MapBounds:
        """The outer edges of the cells with material; those of the height map if there are none."""
        # a cell beside a box may be covered by no more than rounding: all of it is at the lower level then
        is_solid = (self.high > self.floor) & ((self.share < 1.0) | (self.low > self.floor))
        columns, rows = np.flatnonzero(is_solid.any(axis=0)), np.flatnonzero(is_solid.any(axis=1))
        if not len(columns):
            return self.bounds
        return MapBounds(
            self.x + int(columns[0]) * self.cell,
            self.x + (int(columns[-1]) + 1) * self.cell,
            self.y + int(rows[0]) * self.cell,
            self.y + (int(rows[-1]) + 1) * self.cell,
        )


def refine(stock: Stock, factor: int) -> Stock:
    """Return a height map whose cells are narrower by a whole factor.

    Surfaces with slopes are interpolated. A partly cut cell is divided into cells with the same two levels and shares.
    """

    def divided(values: NDArray[Any]) -> NDArray[Any]:
        """Return values of cells (ny, nx, …) repeated for the narrower cells in each."""
        return np.repeat(np.repeat(values, factor, axis=0), factor, axis=1)

    # middles of narrow cells from the middle of the wide cell, in wide cells
    offset = ((np.arange(factor) + 0.5) / factor - 0.5).tolist()
    has_slope = ((stock.share == 0.0) & (stock.high > stock.floor))[..., None]
    slope = np.where(has_slope, stock.slope, np.int16(0)).astype(np.int16)
    rise = slope.astype(np.float32) * np.float32(SLOPE * stock.cell)
    high = divided(stock.high)
    for row, column in np.ndindex(factor, factor):
        high[row::factor, column::factor] = _surface_at(
            stock.high, rise, has_slope[..., 0], offset[row], offset[column]
        )
    low, share, floor = (divided(values) for values in (stock.low, stock.share, stock.floor))
    return Stock(
        x=stock.x,
        y=stock.y,
        cell=stock.cell / factor,
        high=high,
        low=low,
        share=share,
        slope=divided(slope),
        floor=floor,
        ground=stock.ground,
    )


def _surface_at(high: Floats, rise: Floats, has_slope: Bools, y_shift: float, x_shift: float) -> Floats:
    """Return the level of the surface (ny, nx) [m] in each cell, at the same distance from its middle.

    :param high: (ny, nx) upper levels of the cells [m].
    :param rise: (ny, nx, 2) rise of the surface along x and y, over a cell [m].
    :param has_slope: (ny, nx) True for cells whose surface has one level and a slope. The surface of a cell next to a
        cell without one is taken for level.
    :param y_shift: distance from the middles along y, and `x_shift` along x, in cells from −0.5 to 0.5.
    """
    x_side, y_side = 1 if x_shift >= 0.0 else -1, 1 if y_shift >= 0.0 else -1
    steps = [(0, 0), (0, x_side), (y_side, 0), (y_side, x_side)]  # to the four cells around the point: rows, columns
    shape, distance = high.shape, (abs(y_shift), abs(x_shift))
    has_all_slopes, border = np.ones(shape, dtype=bool), ((1, 1), (1, 1))
    padded_high, padded_has_slope = np.pad(high, border, mode="edge"), np.pad(has_slope, border, mode="edge")
    padded_rise = np.pad(rise, (*border, (0, 0)), mode="edge")
    levels, plane_rises, weights = list[Floats](), list[Floats](), list[Floats]()
    for row_step, column_step in steps:
        # the neighbour at this step of each cell; the map begins at 1 in its padded copies
        window = slice(1 + row_step, 1 + row_step + shape[0]), slice(1 + column_step, 1 + column_step + shape[1])
        slope = padded_rise[window]
        has_all_slopes &= padded_has_slope[window]
        levels.append(padded_high[window])
        # of the tangent plane of the neighbour, from the middle of that cell to the point
        plane_rise = np.float32(x_shift - column_step) * slope[..., 0] + np.float32(y_shift - row_step) * slope[..., 1]
        plane_rises.append(np.asarray(plane_rise, dtype=np.float32))
        # bilinear: the nearer the neighbour, the larger its weight
        share = (distance[0] if row_step else 1.0 - distance[0]) * (distance[1] if column_step else 1.0 - distance[1])
        weights.append(np.full(shape, share, dtype=np.float32))
    surface = np.zeros_like(high)
    # the mean of what the four cells give for the surface at the point, each from its level and slope
    for level, weight, rise in zip(levels, weights, surface_rises(levels, weights, plane_rises), strict=True):
        surface += weight * (level + rise)
    return np.where(has_all_slopes, surface, high)


def surface_rises(levels: list[Floats], weights: list[Floats], plane_rises: list[Floats]) -> list[Floats]:
    """Return the rise of the surface [m] from the level of each of four cells to points between them.

    It is that of the tangent plane of the cell, corrected so that a paraboloid is interpolated exactly. Where all four
    planes are above the interpolated levels, there is a ridge between the cells, and the lowest plane counts. All
    arrays have the shape of the points.

    :param levels: four arrays, one for each cell around the points: the level in its middle [m].
    :param weights: four arrays: the weights of bilinear interpolation; their sum is 1.
    :param plane_rises: four arrays: the rise of the plane that touches the surface in the middle of the cell, from that
        middle to the points [m].
    """
    mean_level, half_mean_rise = np.zeros_like(levels[0]), np.zeros_like(levels[0])
    lowest_plane = levels[0] + plane_rises[0]
    for weight, level, rise in zip(weights, levels, plane_rises, strict=True):
        mean_level += weight * level
        half_mean_rise += np.float32(0.5) * (weight * rise)
        lowest_plane = np.minimum(lowest_plane, level + rise)
    is_ridge = lowest_plane > mean_level
    # the mean of interpolated levels and interpolated planes is exact on a paraboloid
    return [
        np.where(is_ridge, lowest_plane - level, rise - half_mean_rise)
        for level, rise in zip(levels, plane_rises, strict=True)
    ]


def zero_slopes(high: Floats) -> NDArray[np.int16]:
    """Return the slopes along x and y (ny, nx, 2) of a level surface: zeros; `high` (ny, nx) gives the size."""
    return np.zeros((*high.shape, 2), dtype=np.int16)


class _MapExtent(NamedTuple):
    """The cells of a height map.

    :param x: smallest x of the map [m].
    :param y: smallest y [m].
    :param column_count: number of cells along x.
    :param row_count: number of cells along y.
    """

    x: float
    y: float
    column_count: int
    row_count: int


def _map_extent(lower: Array, upper: Array, cell: float, file: str) -> _MapExtent:
    """Return the cells of a height map around a box, with a border.

    :param lower: (3,) and `upper` (3,): corners of a box around the stock, frame of the map [m].
    :param cell: width of a cell [m].
    :param file: path of the process or of the mesh, for the message.
    :raises ForceError: the map would have more than `_MOST_CELLS` cells.
    """
    # 1e-6: a box of a whole number of cells needs no further one for rounding
    count = np.ceil((upper[:2] - lower[:2]) / cell - 1e-6).astype(int) + 2 * _BORDER
    if int(count[0]) * int(count[1]) > _MOST_CELLS:
        min_cell_mm = float(np.sqrt((upper[0] - lower[0]) * (upper[1] - lower[1]) / _MOST_CELLS)) * 1e3
        # a fifth more than needed, for the border and the rounding to two digits
        advice = f"Give [stock] resolution_mm = {max(1.2 * min_cell_mm, 1e-3):.2g} or more."
        raise ForceError(f"the map of the stock would have {count[0]} × {count[1]} cells", file=file, advice=advice)
    x, y = (float(corner) - _BORDER * cell for corner in lower[:2])
    return _MapExtent(x, y, int(count[0]), int(count[1]))


def from_box(lower: Array, upper: Array, cell: float, file: str = "stock") -> Stock:
    """Return the height map of a box from corner `lower` (3,) to `upper` (3,) [m], with cells of width `cell` [m].

    Cells that the box covers in part have the height of the box (`high`) on the covered share of their area; `share` is
    the rest, which is at `low` and has no material.

    :param file: path of the process or of the mesh, for the message.
    :raises ForceError: the map would have too many cells.
    """
    x, y, nx, ny = _map_extent(lower, upper, cell, file)
    covered_shares = []  # of the columns in x, of the rows in y
    for first, count, begin, end in ((x, nx, lower[0], upper[0]), (y, ny, lower[1], upper[1])):
        edge = first + cell * np.arange(count + 1)
        covered_shares.append(np.clip(np.minimum(edge[1:], end) - np.maximum(edge[:-1], begin), 0.0, cell) / cell)
    coverage = covered_shares[1][:, None] * covered_shares[0][None, :]
    coverage[coverage > 1.0 - 1e-6] = 1.0  # what is missing is rounding
    floor = np.full((ny, nx), lower[2], dtype=np.float32)
    high = np.where(coverage > 0.0, upper[2], lower[2]).astype(np.float32)
    share = np.where(coverage > 0.0, 1.0 - coverage, 0.0).astype(np.float32)
    # no material is below `ground`; above `floor`, whose values are rounded to single precision
    ground = float(lower[2]) + 1e-6
    return Stock(
        x=x,
        y=y,
        cell=cell,
        high=high,
        low=floor.copy(),
        share=share,
        slope=zero_slopes(high),
        floor=floor,
        ground=ground,
    )


def from_mesh(vertices: Array, faces: NDArray[np.int64], cell: float, file: str = "stock") -> Stock:
    """Return the height map of a closed mesh: material from the lowest to the highest surface of each column.

    Each cell is divided into `_SUBDIVISION` × `_SUBDIVISION` squares, to find the share of it that the mesh covers and
    the mean heights.

    :param vertices: (V, 3) [m], in the frame of the map; `faces` (F, 3).
    :param cell: width of a cell [m].
    :param file: path of the process or of the mesh, for the message.
    :raises ForceError: the map would have too many cells.
    """
    x, y, nx, ny = _map_extent(vertices.min(axis=0), vertices.max(axis=0), cell, file)
    high, low, share = (np.zeros((ny, nx), dtype=np.float32) for _ in range(3))
    slope = zero_slopes(high)
    floor = np.full((ny, nx), np.inf, dtype=np.float32)
    wall_low, wall_share = np.zeros_like(high), np.zeros_like(high)
    rows_at_once = max(1, MOST_PAIRS // (nx * _SUBDIVISION * _SUBDIVISION))
    face_bottom, face_top = (np.asarray(edge(vertices[faces, 1], axis=1)) for edge in (np.min, np.max))
    for first in range(0, ny, rows_at_once):
        row_count = min(rows_at_once, ny - first)
        begin, end = y + first * cell, y + (first + row_count) * cell
        row_faces = faces[(face_top >= begin) & (face_bottom <= end)]
        upper, lower = _surfaces_of_columns(
            vertices, row_faces, (x, begin), cell / _SUBDIVISION, (nx * _SUBDIVISION, row_count * _SUBDIVISION)
        )
        is_solid = upper > lower
        map_rows = slice(first, first + row_count)
        upper, wall_low[map_rows], wall_share[map_rows] = _divided_at_walls(upper, is_solid, cell)
        # axes 1 and 3 are the squares within a cell
        blocks = (row_count, _SUBDIVISION, nx, _SUBDIVISION)
        count = is_solid.reshape(blocks).sum(axis=(1, 3))
        mean = np.where(is_solid, upper, 0.0).reshape(blocks).sum(axis=(1, 3)) / np.maximum(count, 1)
        mean_floor = np.where(is_solid, lower, 0.0).reshape(blocks).sum(axis=(1, 3)) / np.maximum(count, 1)
        high[map_rows], floor[map_rows] = np.where(count > 0, mean, np.nan), np.where(count > 0, mean_floor, np.nan)
        share[map_rows] = np.where(count > 0, 1.0 - count / _SUBDIVISION**2, 0.0)
        slope[map_rows] = _mean_slopes(np.where(is_solid, upper, np.nan).reshape(blocks), cell / _SUBDIVISION)
    is_empty = np.isnan(high)  # cells beside the mesh
    lowest_floor = float(np.nanmin(floor)) if not is_empty.all() else 0.0
    high[is_empty] = floor[is_empty] = lowest_floor  # no thickness
    low[:] = np.where(wall_share > 0.0, wall_low, floor)
    share = np.where(wall_share > 0.0, wall_share, share)
    ground = float(floor.max()) + 1e-6  # above `floor`, whose values are rounded to single precision
    return Stock(x=x, y=y, cell=cell, high=high, low=low, share=share, slope=slope, floor=floor, ground=ground)


def _mean_slopes(upper: Array, step: float) -> NDArray[np.int16]:
    """Return the slopes along x and y (ny, nx, 2) of planes through the heights in each cell, in units of `SLOPE`.

    The slope is 0 where the heights are not in a plane, the plane is steeper than `STEEPEST_SLOPE`, or the mesh covers
    the cell only in part: there may be a wall in the cell.

    :param upper: (ny, s, nx, s) heights in the s × s squares of each cell [m]; NaN: not covered.
    :param step: width of a square [m].
    """
    squares = upper.shape[1]
    offset = (np.arange(squares) - 0.5 * (squares - 1)) * step  # of the middles of squares from that of the cell
    scale = squares * np.square(offset).sum()  # least squares: Σ offset · height / Σ offset²
    slope = np.stack([np.einsum("yixj,j->yx", upper, offset), np.einsum("yixj,i->yx", upper, offset)], axis=-1) / scale
    plane = slope[:, None, :, None, 0] * offset + slope[:, None, :, None, 1] * offset[:, None, None]
    residual = np.abs(upper - upper.mean(axis=(1, 3), keepdims=True) - plane).max(axis=(1, 3))
    # False for NaN
    is_plane = (np.abs(slope) <= STEEPEST_SLOPE).all(axis=-1) & (residual <= _FLATNESS * squares * step)
    return np.where(is_plane[..., None], slope / SLOPE, 0.0).astype(np.int16)


def _divided_at_walls(upper: Array, is_solid: Bools, cell: float) -> tuple[Array, Array, Array]:
    """Return the heights of squares above walls in cells, and level and share of the lower part of each cell.

    A cell has a wall if its squares are at two levels that differ by more than the width of the cell. Squares above the
    mean of the highest and the lowest one are of the upper level, which is their mean height; likewise the lower level.
    The highest and the lowest square must be within a quarter of the width of their levels: a steep plane is no wall.
    Squares at the lower level get the upper one. The share is 0 in cells without a wall.

    :param upper: (ny · s, nx · s) heights of the surface in the s × s squares of each cell [m].
    :param is_solid: (ny · s, nx · s) True for squares with material.
    :param cell: width of a cell of the height map [m].
    """
    blocks = (upper.shape[0] // _SUBDIVISION, _SUBDIVISION, upper.shape[1] // _SUBDIVISION, _SUBDIVISION)
    squares = upper.reshape(blocks)
    is_whole: Bools = np.asarray(is_solid.reshape(blocks).all(axis=(1, 3)))
    squares = np.where(is_whole[:, None, :, None], squares, 0.0)
    highest, lowest = squares.max(axis=(1, 3)), squares.min(axis=(1, 3))
    is_high: Bools = np.asarray(squares >= 0.5 * (highest + lowest)[:, None, :, None])
    high_count = is_high.sum(axis=(1, 3))
    low_count = _SUBDIVISION**2 - high_count
    high = np.where(is_high, squares, 0.0).sum(axis=(1, 3)) / high_count
    low = np.where(is_high, 0.0, squares).sum(axis=(1, 3)) / np.maximum(low_count, 1)
    is_level = np.maximum(highest - high, low - lowest) < 0.25 * cell
    is_wall = is_whole & (low_count > 0) & (high - low > cell) & is_level
    above = np.where(is_wall[:, None, :, None], high[:, None, :, None], upper.reshape(blocks)).reshape(upper.shape)
    return above, low, np.where(is_wall, low_count / _SUBDIVISION**2, 0.0)


def _surfaces_of_columns(
    vertices: Array, faces: NDArray[np.int64], origin: tuple[float, float], step: float, count: tuple[int, int]
) -> tuple[Array, Array]:
    """Return the highest and the lowest height of a mesh over a grid, (ny, nx) each [m]; −inf and inf beside the mesh.

    :param vertices: (V, 3) of the mesh [m], in the frame of the height map, and `faces` (F, 3).
    :param origin: x, y of the corner of the grid [m]; its points are in the middles of squares of a width `step` [m].
    :param count: number of points along x and y.
    """
    nx, ny = count
    upper, lower = np.full(ny * nx, -np.inf), np.full(ny * nx, np.inf)
    corner = vertices[faces]  # (F, 3, 3): corners a, b, c of each triangle
    ab, ac = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    is_not_vertical = np.abs(area) > 1e-16  # vertical triangles have no area seen from above
    corner, ab, ac, area = corner[is_not_vertical], ab[is_not_vertical], ac[is_not_vertical], area[is_not_vertical]
    for index, triangle in _points_in_boxes(corner, origin, step, count):
        dx = origin[0] + (index % nx + 0.5) * step - corner[triangle, 0, 0]
        dy = origin[1] + (index // nx + 0.5) * step - corner[triangle, 0, 1]
        # barycentric coordinates v, w of the point in the triangle seen from above
        v = (dx * ac[triangle, 1] - dy * ac[triangle, 0]) / area[triangle]
        w = (ab[triangle, 0] * dy - ab[triangle, 1] * dx) / area[triangle]
        is_inside = (v >= -1e-9) & (w >= -1e-9) & (v + w <= 1.0 + 1e-9)  # edges count: 1e-9 is rounding
        index, triangle = index[is_inside], triangle[is_inside]
        z = corner[triangle, 0, 2] + v[is_inside] * ab[triangle, 2] + w[is_inside] * ac[triangle, 2]
        np.maximum.at(upper, index, z)
        np.minimum.at(lower, index, z)
    return upper.reshape(ny, nx), lower.reshape(ny, nx)


def _points_in_boxes(
    corner: Array, origin: tuple[float, float], step: float, count: tuple[int, int]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield, in batches, pairs of a triangle and a grid point in its bounding box seen along z.

    :param corner: (F, 3, 3) corners of triangles [m].
    :param origin: corner of the grid x, y [m]; its points are in the middles of squares of a width `step` [m].
    :param count: number of points along x and y.
    :returns: indices of points (n,), counted row by row of the grid, and rows of triangles in `corner` (n,).
    """
    first_index, index_count = [], []  # columns (axis 0) and rows (axis 1) of the points in the box of each triangle
    for axis in range(2):
        low, high = corner[:, :, axis].min(axis=1), corner[:, :, axis].max(axis=1)
        begin = np.clip(np.ceil((low - origin[axis]) / step - 0.5 - 1e-9), 0, count[axis]).astype(np.int64)
        end = np.clip(np.floor((high - origin[axis]) / step - 0.5 + 1e-9) + 1, 0, count[axis]).astype(np.int64)
        first_index.append(begin)
        index_count.append(np.maximum(end - begin, 0))
    point_count = index_count[0] * index_count[1]
    running_count = np.cumsum(point_count)  # batches of whole triangles are taken from it
    begin = 0
    while begin < len(point_count):
        last_count = running_count[begin - 1] if begin else 0
        end = max(begin + 1, int(np.searchsorted(running_count, last_count + MOST_PAIRS, side="right")))
        rows = np.repeat(np.arange(begin, end), point_count[begin:end])
        number = ragged_range(point_count[begin:end])  # of each point within the box of its triangle, row by row
        column = first_index[0][rows] + number % np.maximum(index_count[0][rows], 1)
        row = first_index[1][rows] + number // np.maximum(index_count[0][rows], 1)
        yield row * count[0] + column, rows
        begin = end


def as_trimesh(vertices: Array, faces: NDArray[np.int64]) -> Any:
    """Return a mesh of vertices (V, 3) [m] and faces (F, 3) as a `trimesh.Trimesh` in mm."""
    import trimesh

    return trimesh.Trimesh(vertices * 1e3, faces, process=False)


_GOLDEN_SECTIONS = 18
"""Number of golden sections: an interval of 10 mm becomes 2 µm."""
_WHOLE_SHARE = np.float32(0.999)
"""A cell that is cut over at least this share of its area counts as fully cut (assumed)."""
_EQUAL_LEVEL = np.float32(1e-6)
"""Levels of a cell that differ by less [m] are equal: those under one place of the tool differ by rounding only."""
MOST_CELLS_AT_ONCE = 200_000
"""Largest number of cells under segments that are processed at once: it limits memory."""


class Footprint(Struct, frozen=True, eq=False):
    """Cells of the height map under some segments of the path, one row for each cell and segment.

    :param cell: (n,) index, row by row of the map, of cells that the tool covers fully.
    :param level: (n,) lower side of the tool in these cells [m].
    :param segment: (n,) row of the segment in `path`.
    :param rim: (r,) index, row by row of the map, of cells that the cylinder of the tool covers partly.
    :param coverage: (r,) share of these cells that it covers, 0 … 1.
    :param rim_level: (r,) lower side of the tool in these cells [m].
    :param path: tool, and begins (L, 3) and ends (L, 3) of segments [m]; None: the surface has no known slope.
    """

    cell: Ints
    level: Floats
    segment: NDArray[np.int32]
    rim: Ints
    coverage: Floats
    rim_level: Floats
    path: tuple[Cutter, Array, Array] | None

    @classmethod
    def empty(cls) -> Footprint:
        """Return a footprint without cells."""
        cells, levels = np.zeros(0, dtype=np.int64), np.zeros(0, np.float32)
        return cls(cells, levels, np.zeros(0, np.int32), cells, levels, levels, None)

    @classmethod
    def join(cls, parts: list[Footprint], path: tuple[Cutter, Array, Array]) -> Footprint:
        """Return the cells of several parts of one path."""
        parts = parts or [cls.empty()]
        return cls(
            np.concatenate([part.cell for part in parts]), np.concatenate([part.level for part in parts]),
            np.concatenate([part.segment for part in parts]), np.concatenate([part.rim for part in parts]),
            np.concatenate([part.coverage for part in parts]), np.concatenate([part.rim_level for part in parts]), path,
        )  # fmt: skip

    def selected(self, cells: Bools, rims: Bools) -> Footprint:
        """Return the footprint of selected cells only.

        :param cells: (n,) True for the selected cells that the tool covers fully.
        :param rims: (r,) True for the selected cells of the rim, which it covers partly.
        """
        return Footprint(
            self.cell[cells], self.level[cells], self.segment[cells], self.rim[rims], self.coverage[rims],
            self.rim_level[rims], self.path,
        )  # fmt: skip

    def not_covered_by(self, cover: Footprint) -> Footprint:
        """Return the cells that another footprint does not cover, or covers less deep.

        :param cover: the other footprint. Cells of the rim remain only if they are not in it at all.
        """
        if not len(cover.cell):
            return self.selected(np.ones(len(self.cell), dtype=bool), ~np.isin(self.rim, cover.rim))
        order = np.lexsort((cover.level, cover.cell))  # the lowest level of each cell comes first
        cell, level = cover.cell[order], cover.level[order]
        row = np.minimum(np.searchsorted(cell, self.cell), len(cell) - 1)  # first row of each cell in the sorted cover
        is_covered = (cell[row] == self.cell) & (level[row] <= self.level + _EQUAL_LEVEL)
        return self.selected(~is_covered, ~(np.isin(self.rim, cell) | np.isin(self.rim, cover.rim)))

    def outside_circle(self, stock: Stock, point: Array, radius: float) -> Footprint:
        """Return the footprint without cells whose middles are within a circle, seen along z.

        Cells of the rim, which the tool covers partly, all remain.

        :param stock: map of the cells.
        :param point: (3,) middle of the circle [m].
        :param radius: radius of the circle [m]; < 0: no cell is within it.
        """
        row, column = np.divmod(self.cell, stock.high.shape[1])
        x, y = stock.x + (column + 0.5) * stock.cell - point[0], stock.y + (row + 0.5) * stock.cell - point[1]
        return self.selected(np.hypot(x, y) >= radius, np.ones(len(self.rim), dtype=bool))


def remove(stock: Stock, cutter: Cutter, begin: Array, end: Array, heading: Array | None = None) -> Footprint:
    """Remove the volume that a tool along z sweeps as its tip moves along L segments.

    The segments make one surface: where several cover a part of one cell, the segment that covers most of it counts.

    :param begin: (L, 3) positions of the tip where segments begin, and `end` (L, 3) where they end [m].
    :param heading: (3,) direction in which the tool moves on. The material under its front at the last position is then
        kept, as the front must meet uncut material next, not cells that it has partly cut. None: all is removed.
    :returns: the cells whose material is kept, to be removed later by `cut`.
    """
    parts = list(_footprints(stock, cutter, begin, end))
    footprint = Footprint.join(parts, (cutter, begin, end))
    if heading is None:
        cut(stock, footprint)
        return Footprint.empty()
    is_front = _is_under_front(stock, cutter, footprint.cell, end[-1], heading, rim=False)
    is_front_rim = _is_under_front(stock, cutter, footprint.rim, end[-1], heading, rim=True)
    cut(stock, footprint.selected(~is_front, ~is_front_rim))
    return footprint.selected(is_front, is_front_rim)


def cut(stock: Stock, footprint: Footprint) -> None:
    """Lower the cells of a footprint to its levels, in place; cells of its rim are cut in part."""
    high = stock.high.reshape(-1)
    deeper_rows = np.flatnonzero(footprint.level < high[footprint.cell])
    cell, level = footprint.cell[deeper_rows], footprint.level[deeper_rows]
    np.minimum.at(high, cell, level)
    is_lowest = level <= high[cell]  # of several rows of one cell, those that set its new level
    stock.slope.reshape(-1, 2)[cell[is_lowest]] = _slopes(stock, footprint, deeper_rows[is_lowest])
    if len(footprint.rim):
        _cut_in_part(stock, *_largest_coverage(footprint.rim, footprint.coverage, footprint.rim_level))


def _slopes(stock: Stock, footprint: Footprint, rows: Ints) -> NDArray[np.int16]:
    """Return the slopes along x and y (k, 2), in units of `SLOPE`, of the surface that a tool leaves in some cells.

    They are computed from the levels of the tool on both sides of the middle of each cell. They are 0 if the footprint
    has no path, or if a flat tool moves on level segments.

    :param rows: (k,) rows of the cells in the footprint.
    """
    slopes = np.zeros((len(rows), 2), dtype=np.int16)
    if footprint.path is None or not len(rows):
        return slopes
    cutter, segment_begins, segment_ends = footprint.path
    segment = footprint.segment[rows]
    begin, end = segment_begins[segment], segment_ends[segment]
    if cutter.corner == 0.0 and (begin[:, 2] == end[:, 2]).all():
        return slopes
    # one cell for each segment: arrays (k, 1, 1)
    row, column = (index[:, None, None] for index in np.divmod(footprint.cell[rows], stock.high.shape[1]))
    x, y = cell_middles(stock, begin, row, column)  # relative to the starts of the segments, as `tool_levels` needs
    step = np.float32(_SLOPE_STEP * stock.cell)
    for axis, (x_step, y_step) in enumerate(((step, 0.0 * step), (0.0 * step, step))):
        _, lower_level = tool_levels(cutter, begin, end, x - x_step, y - y_step)
        _, upper_level = tool_levels(cutter, begin, end, x + x_step, y + y_step)
        slope = (upper_level - lower_level)[:, 0, 0] / (2.0 * step)  # (k,)
        slopes[:, axis] = np.clip(slope, -STEEPEST_SLOPE, STEEPEST_SLOPE) / SLOPE
    return slopes


def _is_under_front(stock: Stock, cutter: Cutter, cell: Ints, point: Array, direction: Array, *, rim: bool) -> Bools:
    """Return True for cells (n,) under the front of a tool: there its surface moves outwards, into the material.

    :param cell: (n,) index in the height map, row by row.
    :param point: (3,) position of the tip [m]; `direction` (3,) unit direction of its travel.
    :param rim: True: the cells are those that the cylinder covers in part; False: those under the end of the tool.
    """
    # x, y: middle of each cell from the tip
    row, column = np.divmod(cell, stock.high.shape[1])
    x = stock.x + (column + 0.5) * stock.cell - point[0]
    y = stock.y + (row + 0.5) * stock.cell - point[1]
    advance = x * direction[0] + y * direction[1]
    if rim or (cutter.corner == 0.0 and direction[2] == 0.0):
        return np.asarray(advance > 0.0)
    distance = np.hypot(x, y)
    corner_distance = np.maximum(distance - (cutter.radius - cutter.corner), 0.0)
    # the surface moves outwards where its outward normal, times the radius of the corner, has a part along the travel
    radial_normal = corner_distance / np.maximum(distance, 1e-12)
    axial_normal = np.sqrt(np.maximum(cutter.corner**2 - corner_distance**2, 0.0)) if cutter.corner > 0.0 else 1.0
    return np.asarray(
        (advance * radial_normal - axial_normal * direction[2] > 0.0) & (distance < cutter.radius + stock.cell)
    )


def depth_of_cut(stock: Stock, cutter: Cutter, begin: Array, end: Array) -> float:
    """Return the largest depth of cut [m] as the tip moves from `begin` (L, 3) to `end` (L, 3) [m].

    Only cells that the tool covers fully count: a height map locates walls no better than a cell.
    """
    high, floor, deepest = stock.high.reshape(-1), stock.floor.reshape(-1), 0.0
    for footprint in _footprints(stock, cutter, begin, end):
        depth = high[footprint.cell] - np.maximum(footprint.level, floor[footprint.cell])
        deepest = max(deepest, float(depth.max(initial=0.0)))
    return deepest


def _footprints(stock: Stock, cutter: Cutter, begin: Array, end: Array) -> Iterator[Footprint]:
    """Yield the cells under segments from `begin` (L, 3) to `end` (L, 3) [m], in batches of segments, short ones first.

    Batches whose cells have no material above the tip are omitted.
    """
    for batch in windows(stock, cutter.radius + stock.cell, begin, end):
        footprint = _footprint(stock, cutter, begin, end, batch)
        if footprint is not None:
            yield footprint


class SegmentWindows(NamedTuple):
    """Rectangular windows of a height map around k segments, all of one size.

    :param rows: (k,) rows of the segments.
    :param corner: (k, 2) column and row of the first cell of each window.
    :param size: (2,) number of columns and of rows of all windows.
    """

    rows: Ints
    corner: Ints
    size: Ints


def windows(stock: Stock, reach: float, begin: Array, end: Array) -> Iterator[SegmentWindows]:
    """Yield rectangular windows of the height map around segments, in batches of segments, small windows first.

    All windows of a batch have the size of its largest, so that arrays hold them. The number of cells of a batch is
    limited. Segments without a cell of the map in their window are omitted.

    :param reach: distance of the edge of a window from the segment [m].
    :param begin: (L, 3) begins of segments [m], and `end` (L, 3) their ends.
    """
    cell = stock.cell
    origin = np.array([stock.x, stock.y])
    map_size = np.array(stock.high.shape[::-1])
    low = np.minimum(begin[:, :2], end[:, :2]) - reach - origin
    high = np.maximum(begin[:, :2], end[:, :2]) + reach - origin
    first = np.clip(np.floor(low / cell).astype(np.int64), 0, map_size)
    count = np.clip(np.floor(high / cell).astype(np.int64) + 1, 0, map_size) - first
    cell_count = count[:, 0] * count[:, 1]  # of each window
    order = np.argsort(cell_count, kind="stable")
    order = order[cell_count[order] > 0]
    done_count = 0
    while done_count < len(order):
        # as many windows as are allowed if all have the size of the first, the smallest; of these as many as are
        # allowed if all have the size of the last, the largest, as they will
        rows = order[done_count : done_count + max(1, MOST_CELLS_AT_ONCE // int(cell_count[order[done_count]]))]
        rows = rows[: max(1, MOST_CELLS_AT_ONCE // int(cell_count[rows[-1]]))]
        done_count += len(rows)
        window = np.minimum(count[rows].max(axis=0), map_size)
        corner = np.minimum(first[rows], map_size - window)  # windows at the upper edges move inwards
        yield SegmentWindows(rows, corner, window)


def _footprint(stock: Stock, cutter: Cutter, begin: Array, end: Array, batch: SegmentWindows) -> Footprint | None:
    """Return the cells under some segments; None if none of their windows has material above the tip.

    :param begin: (L, 3) begins of all segments [m], and `end` (L, 3) their ends.
    :param batch: the segments that count, and the windows of the height map around them.
    """
    cell, path = stock.cell, (cutter, begin, end)
    begin, end = begin[batch.rows], end[batch.rows]
    index, row, column = window_cells(stock, batch.corner, batch.size)
    tip_height = np.minimum(begin[:, 2], end[:, 2])
    row_range = slice(int(row.min()), int(row.max()) + 1)
    column_range = slice(int(column.min()), int(column.max()) + 1)
    top = float(stock.high[row_range, column_range].max())
    if top <= float(tip_height.min()):
        return None
    distance, level = tool_levels(cutter, begin, end, *cell_middles(stock, begin, row, column))
    inner_radius = np.float32(cutter.radius - 0.5 * cell)
    # where the cylinder is below the material it leaves a wall: cells on its rim are cut in part, those inside fully
    is_wall = tip_height + cutter.corner < top
    is_full = distance < np.where(is_wall, inner_radius, np.float32(cutter.radius)).astype(np.float32)[:, None, None]
    rim, coverage, rim_level = np.zeros(0, dtype=np.int64), np.zeros(0, np.float32), np.zeros(0, np.float32)
    if is_wall.any():
        is_partial = (distance >= inner_radius) & (distance < inner_radius + np.float32(cell)) & is_wall[:, None, None]
        rim, rim_level = index[is_partial], level[is_partial]
        coverage = np.minimum(
            (inner_radius + np.float32(cell) - distance[is_partial]) / np.float32(cell), np.float32(1.0)
        )
    return Footprint(
        cell=index[is_full],
        level=level[is_full],
        segment=np.repeat(batch.rows.astype(np.int32), np.count_nonzero(is_full, axis=(1, 2))),
        rim=rim,
        coverage=coverage,
        rim_level=rim_level,
        path=path,
    )


class WindowCells(NamedTuple):
    """The cells in k windows of w columns and h rows.

    :param cell: (k, h, w) index in the flat map.
    :param row: (k, h, 1) rows of the height map.
    :param column: (k, 1, w) columns of the map.
    """

    cell: Ints
    row: Ints
    column: Ints


def window_cells(stock: Stock, corner: Ints, window: Ints) -> WindowCells:
    """Return the cells of a height map in k windows.

    :param corner: (k, 2) column and row of the first cell of each window.
    :param window: (2,) number of columns w and of rows h of all windows.
    """
    column = corner[:, 0, None, None] + np.arange(window[0])
    row = corner[:, 1, None, None] + np.arange(window[1])[:, None]
    return WindowCells(row * stock.high.shape[1] + column, row, column)


def cell_middles(stock: Stock, begin: Array, row: Ints, column: Ints) -> tuple[Floats, Floats]:
    """Return x (k, 1, w) and y (k, h, 1) of the middles of cells, relative to the starts of segments [m].

    :param begin: (k, 3) starts of segments [m].
    :param row: (k, h, 1) rows of the cells in the height map, and `column` (k, 1, w) their columns.
    """
    # each start of a segment from the middle of the first cell of the map
    origin = (begin[:, :2] - (stock.x, stock.y) - 0.5 * stock.cell)[:, :, None, None]
    return (column * stock.cell - origin[:, 0]).astype(np.float32), (row * stock.cell - origin[:, 1]).astype(np.float32)


def tool_levels(cutter: Cutter, begin: Array, end: Array, px: Floats, py: Floats) -> tuple[Floats, Floats]:
    """Return the distances of cells from segments, and the lowest levels of the tool above them, (L, h, w) each [m].

    Distances are seen along z. At a length t along the segment, the height of the tool above a cell is that of the tip,
    z + slope·t, plus the height of its lower side at the distance of the cell from the axis: convex in t.

    :param begin: (L, 3) positions of the tip where segments begin, and `end` (L, 3) where they end [m].
    :param px: x of the cells from the start of each segment [m], and `py` their y: broadcast to the shape (L, h, w).
    """
    chord = end - begin
    travel_length = np.hypot(chord[:, 0], chord[:, 1])
    is_vertical = travel_length < 1e-9  # [m]: rounding; its level is that of its lower end
    unit = np.where(is_vertical[:, None], [1.0, 0.0], chord[:, :2] / np.where(is_vertical, 1.0, travel_length)[:, None])
    ux, uy, length = (
        component.astype(np.float32)[:, None, None] for component in (unit[:, 0], unit[:, 1], travel_length)
    )
    travel = ux * px + uy * py  # of the cell along the segment
    offset = ux * py - uy * px  # of the cell from the line of the segment
    square = offset * offset
    nearest_travel = np.minimum(np.maximum(travel, 0.0), length)
    distance = np.sqrt(square + (travel - nearest_travel) ** 2)
    z = np.where(is_vertical, np.minimum(begin[:, 2], end[:, 2]), begin[:, 2]).astype(np.float32)[:, None, None]
    slope = np.where(is_vertical, 0.0, chord[:, 2] / np.where(is_vertical, 1.0, travel_length))
    if np.abs(slope).max() < 1e-9:  # no segment rises: the tool is lowest where its axis is nearest
        return distance, np.broadcast_to(z + cutter.lower_side(distance).astype(np.float32), distance.shape)
    slope_of_row = slope.astype(np.float32)[:, None, None]
    t = _lowest_travel(cutter, travel, square, length, slope_of_row)
    axis_distance = np.sqrt(square + (travel - t) ** 2)
    return distance, np.asarray(z + slope_of_row * t + cutter.lower_side(axis_distance), dtype=np.float32)


def _lowest_travel(cutter: Cutter, travel: Floats, square: Floats, length: Floats, slope: Floats) -> Floats:
    """Return the length t (L, h, w) along the segment, on it, at which the tool is lowest above each cell [m].

    - Flat end: its rear rim is above the cell on a descent, its front rim on a climb.
    - Ball: its normal at the cell is square to the segment.
    - Bull nose: see `_lowest_position`.

    :param travel: (L, h, w) length along the segment of the point nearest to the cell [m]; `square` the square of the
        distance of the cell from the line of the segment [m²].
    :param length: (L, 1, 1) of the segments, seen from above [m]; `slope` (L, 1, 1) of their rise.
    """
    half_chord = np.sqrt(np.maximum(np.float32(cutter.radius**2) - square, 0.0))  # of the tool over the cell
    if cutter.corner == 0.0:
        t = np.where(slope < 0.0, travel + half_chord, travel - half_chord)
    elif cutter.corner >= cutter.radius * (1.0 - 1e-9):  # a ball, but for rounding
        t = travel - slope / np.sqrt(1.0 + slope * slope) * half_chord
    else:
        t = _lowest_position(cutter, travel, square, half_chord, length, slope)
    return np.asarray(np.minimum(np.maximum(t, 0.0), length))


def _lowest_position(
    cutter: Cutter, travel: Floats, square: Floats, half_chord: Floats, length: Floats, slope: Floats
) -> Floats:
    """Return the length t (L, h, w) along the segment at which a bull-nose tool is lowest above each cell [m].

    By golden section between the places where the cell is at the rim of the tool; the height is convex there.

    :param travel: (L, h, w) length along the segment of the point nearest to the cell [m]; `square` the square of the
        distance of the cell from the line of the segment [m²]; `half_chord` half the chord of the tool over the cell
        [m].
    :param length: (L, 1, 1) of the segments, seen from above [m]; `slope` (L, 1, 1) their rise over that length.
    """
    a = np.minimum(np.maximum(travel - half_chord, 0.0), length).astype(float)
    b = np.minimum(np.maximum(travel + half_chord, 0.0), length).astype(float)
    ratio = 0.5 * (math.sqrt(5.0) - 1.0)

    def height(t: Array) -> Array:
        """Return the height of the tool above the cells [m] at lengths t [m], less that of the tip at t = 0."""
        return np.asarray(slope * t + cutter.lower_side(np.sqrt(square + (travel - t) ** 2)))

    for _ in range(_GOLDEN_SECTIONS):
        first, second = b - ratio * (b - a), a + ratio * (b - a)
        is_left_lower = height(first) < height(second)
        a, b = np.where(is_left_lower, a, first), np.where(is_left_lower, second, b)
    return np.asarray(0.5 * (a + b), dtype=np.float32)


class _Coverage(NamedTuple):
    """Cells that a cylinder covers in part, each once.

    :param cell: (k,) index in the flat map.
    :param share: (k,) largest share of it that a segment covers.
    :param level: (k,) lower side of the tool there, on that segment [m].
    """

    cell: Ints
    share: Floats
    level: Floats


def _largest_coverage(cell: Ints, coverage: Floats, level: Floats) -> _Coverage:
    """Return each cell once, with the largest share of it that a segment covers.

    :param cell: (r,) index in the flat map; `coverage` (r,) share of it and `level` (r,) [m] of one segment.
    """
    # sorted by cell, then by coverage: the last entry of each cell is the largest
    order = np.lexsort((coverage, cell))
    largest = order[np.flatnonzero(np.diff(cell[order], append=-1))]
    return _Coverage(cell[largest], coverage[largest], level[largest])


def _cut_in_part(stock: Stock, cell: Ints, coverage: Floats, level: Floats) -> None:
    """Cut shares of cells of the height map down to levels, in place.

    The areas of a cell that several cuts cover are assumed nested, the smaller in the larger.

    The new share of a cell is the larger of both shares (that of earlier cuts, and that of this one), and its lower
    level the mean over that area: where both cuts overlap the deeper one counts, elsewhere the only one.

    :param cell: (k,) index in the map, row by row, each once.
    :param coverage: (k,) share of the cell that the cylinder covers, and `level` (k,) its lower side there [m].
    """
    flat_high, flat_low, flat_share = (values.reshape(-1) for values in (stock.high, stock.low, stock.share))
    high, low, share = flat_high[cell], flat_low[cell], flat_share[cell]
    is_cut = level < high
    low = np.where(share > 0.0, np.minimum(low, high), high)  # a cell without a share has one level
    overlap, union = np.minimum(share, coverage), np.maximum(share, coverage)
    single_level = np.where(share > coverage, low, np.minimum(level, high))  # where only one of the cuts is
    level_sum = overlap * np.minimum(low, level) + (union - overlap) * single_level
    flat_low[cell] = np.where(is_cut, level_sum / np.maximum(union, np.float32(1e-6)), low)
    flat_share[cell] = np.where(is_cut, union, share)
    is_cut_whole = is_cut & (coverage > _WHOLE_SHARE)
    flat_high[cell] = np.where(is_cut_whole, level, high)
    stock.slope.reshape(-1, 2)[cell[is_cut_whole]] = 0  # other cells keep the slope of the part that is not cut
