"""The remaining stock as a closed mesh, with vertical walls where the map of the stock has them.

Cells become four-sided faces that share corners. Where the surface has a step, each side of it has its own height at
the corner, and a vertical face connects them. The corners along a wall are moved across it to where the partly cut
cells locate it. Level regions are merged to large faces, so that the mesh keeps the width of the cells of the map
elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from postproc.frames import Array
from postproc.machining.stock import STEEPEST_SLOPE, Stock
from postproc.program import Bools, Ints

MOST_FILE_CELLS = 500_000
"""Largest number of cells beside level regions in a mesh from which another map is made: an STL file has 100 MB."""
_MOST_MAP_CELLS = 4_000_000
"""Largest number of cells from which a mesh is made: it limits memory."""
_STEP_RATIO = 3.0
"""Differences of height this many times as large as those before and after them are steps (assumed),"""
_LEAST_STEP = 0.02
"""unless they are smaller than this, in widths of a cell (assumed)."""
_LEAST_THICKNESS = 1e-6
"""Thinner material [m] is rounding: it would make a mesh of no thickness."""
_LARGEST_SHIFT = 0.499
"""Corners move by this at most, in widths of a cell: faces keep an area."""
_HEIGHT_STEP = 1e-7
"""Heights are rounded to this [m]: an STL file has single precision [mm]."""
_BLOCK = 8
"""Number of columns and of rows of cells that are merged where the surface is level; even."""


class RemainingMesh(NamedTuple):
    """The remaining stock as a closed mesh.

    :param vertices: (V, 3) [m]; `faces`: (F, 3).
    :param cell: width of the cells of the mesh [m]; larger than that of the height map if the mesh was made coarser.
    """

    vertices: Array
    faces: NDArray[np.int64]
    cell: float


def mesh_of(stock: Stock, most_cells: int = 250_000) -> RemainingMesh:
    """Return the remaining stock as a closed mesh.

    :param most_cells: if more cells than this are not in level regions, the mesh is made coarser, to about this many.
    """
    factor = math.ceil(math.sqrt(stock.high.size / _MOST_MAP_CELLS))
    surface = _surface(stock, factor)
    if surface.cell_count > most_cells:
        surface = _surface(stock, math.ceil(factor * math.sqrt(surface.cell_count / most_cells)))
    return surface.mesh()


class _Columns(NamedTuple):
    """The material in cells (ny, nx) of a mesh, whose numbers are multiples of `_BLOCK`.

    :param floor: mean lower side of the material [m].
    :param upper: thickness of the higher part of each cell [m].
    :param lower: thickness of its lower part [m]; that of the higher one in cells with one level.
    :param share: share of the area of the lower part, 0 … 1.
    """

    floor: Array
    upper: Array
    lower: Array
    share: Array

    @property
    def mean(self) -> Array:
        """Mean thickness (ny, nx) [m]."""
        return np.asarray(self.upper + self.share * (self.lower - self.upper))


def _columns(stock: Stock, factor: int) -> _Columns:
    """Return the material in blocks of factor × factor cells of the height map; the volume remains.

    The levels of a block are divided at the middle between the highest and the lowest: their means are its two levels.
    """
    floor = stock.floor.astype(float)
    high = np.maximum(stock.high - floor, 0.0)
    low = np.clip(stock.low - floor, 0.0, high)
    multiple = factor * _BLOCK
    rows, columns = (-(-size // multiple) * _BLOCK for size in floor.shape)
    pad = ((0, rows * factor - floor.shape[0]), (0, columns * factor - floor.shape[1]))

    def blocks(values: NDArray[Any]) -> NDArray[Any]:
        """Return values of cells of the height map by block: (ny, nx, factor²)."""
        by_axis = np.pad(values, pad).reshape(rows, factor, columns, factor)
        return by_axis.swapaxes(1, 2).reshape(rows, columns, factor * factor)

    high, low, share, floor = (blocks(values) for values in (high, low, stock.share.astype(float), floor))
    low = np.where(share > 0.0, low, high)
    is_solid = high + share * (low - high) > 1e-9  # thinner material [m] is rounding
    mean_floor = np.where(is_solid, floor, 0.0).sum(axis=-1) / np.maximum(is_solid.sum(axis=-1), 1)
    highest, lowest = high.max(axis=-1), low.min(axis=-1)
    middle = 0.5 * (highest + lowest)[..., None]
    upper_weight = (1.0 - share) * (high >= middle) + share * (low >= middle)
    upper_sum = ((1.0 - share) * high * (high >= middle) + share * low * (low >= middle)).sum(axis=-1)
    total = ((1.0 - share) * high + share * low).sum(axis=-1)
    upper_count, count = upper_weight.sum(axis=-1), factor * factor
    width = stock.cell * factor
    # several cells: a slope of 1 is no wall
    least_step = width * (_LEAST_STEP if factor == 1 else 1.0)
    has_wall = (highest - lowest > least_step) & (upper_count > 1e-6) & (count - upper_count > 1e-6)
    upper = np.where(has_wall, upper_sum / np.maximum(upper_count, 1e-6), total / count)
    lower = np.where(has_wall, (total - upper_sum) / np.maximum(count - upper_count, 1e-6), upper)
    return _Columns(mean_floor, upper, lower, np.where(has_wall, 1.0 - upper_count / count, 0.0))


class _Sides(NamedTuple):
    """Values at the sides between neighbouring cells, with empty cells around all.

    :param x: (ny, nx + 1) between the columns c − 1 and c.
    :param y: (ny + 1, nx) between the rows r − 1 and r.
    """

    x: NDArray[Any]
    y: NDArray[Any]


def _rises(top: Array, thickness: Array) -> _Sides:
    """Return by how much the material rises at each side of cells [m]; empty cells have the thickness 0.

    :param top: (ny, nx) upper side [m], and `thickness` (ny, nx) of the material [m].
    """
    rises = []
    for axis in (1, 0):
        pad = ((0, 0), (1, 1)) if axis == 1 else ((1, 1), (0, 0))
        level, depth = np.pad(top, pad), np.pad(thickness, pad)
        is_filled = depth > _LEAST_THICKNESS
        before, after = ((slice(None), part) if axis == 1 else part for part in (slice(None, -1), slice(1, None)))
        both = is_filled[before] & is_filled[after]
        rise = np.where(both, level[after] - level[before], depth[after] * is_filled[after])
        rises.append(np.where(both | is_filled[after], rise, -depth[before] * is_filled[before]))
    return _Sides(*rises)


def _steps(level: Array, is_filled: Bools, width: float) -> _Sides:
    """Return True at sides between filled cells whose heights differ by more than a slope explains.

    :param level: (ny, nx) height of one surface [m].
    :param width: width of a cell of the mesh [m].
    """
    steps = []
    for values, filled in ((level, is_filled), (level.T, is_filled.T)):
        difference = np.zeros((values.shape[0], values.shape[1] + 1))
        difference[:, 1:-1] = np.abs(np.diff(values, axis=1)) * (filled[:, 1:] & filled[:, :-1])
        padded = np.pad(difference, ((0, 0), (1, 1)))
        neighbour = np.maximum(padded[:, :-2], padded[:, 2:])
        is_step = (difference > _LEAST_STEP * width) & (
            (difference > STEEPEST_SLOPE * width) | (difference > _STEP_RATIO * neighbour)
        )
        steps.append(is_step)
    return _Sides(steps[0], steps[1].T)


class _Layout(NamedTuple):
    """The material of each cell, and the places of corners.

    :param thickness: (ny, nx) thickness [m]; 0 in empty cells.
    :param shift_x: (ny + 1, nx + 1) shift of each corner along x, in widths of a cell; `shift_y` along y.
    """

    thickness: Array
    shift_x: Array
    shift_y: Array


def _layout(columns: _Columns, width: float) -> _Layout:
    """Return the layout of a mesh: partly cut cells have the level of their larger part, and walls move into them.

    A wall is a side at which the material steps. It moves by so much that the volume remains. Partly cut cells without
    a wall of their height next to them have their mean level.

    :param width: width of a cell of the mesh [m].
    """
    mean = columns.mean
    is_partial = columns.share > 0.0
    thickness = np.where(columns.share > 0.5, columns.lower, columns.upper)
    thickness = np.where(thickness > _LEAST_THICKNESS, thickness, 0.0)
    height = columns.upper - columns.lower
    slope_y, slope_x = np.gradient(mean)
    weights = (slope_x**2 + 1e-15, slope_y**2 + 1e-15)  # the wall is across the slope; 1e-15 [m²]: none
    for is_last in (False, True):  # a second time with mean levels where the first one finds no wall
        excess = np.where(is_partial, thickness - mean, 0.0)  # by how much a cell is higher than its material [m]
        rises = _rises(columns.floor + thickness, thickness)
        moves: list[Array] = []  # of the sides before and after each cell along x, then along y
        total = np.zeros_like(mean)
        for rise, weight, axis in ((rises.x, weights[0], 1), (rises.y, weights[1], 0)):
            for side, sign in ((0, -1.0), (1, 1.0)):
                step = sign * np.take(rise, np.arange(mean.shape[axis]) + side, axis=axis)  # seen from the cell
                is_wall = (np.abs(step) > 0.5 * height) & (step * excess < 0.0)
                move = np.where(is_wall, weight, 0.0)
                total += move
                moves.append(np.where(is_wall, move * np.abs(excess) / np.maximum(np.abs(step), 1e-12), 0.0))
        is_alone = is_partial & (total == 0.0) & (np.abs(excess) > 1e-9)
        if is_last or not is_alone.any():
            break
        thickness = np.where(is_alone, mean, thickness)
        thickness = np.where(thickness > _LEAST_THICKNESS, thickness, 0.0)
        is_partial &= ~is_alone
    total = np.maximum(total, 1e-300)
    moves = [move / total for move in moves]
    is_filled = thickness > 0.0
    steps = _steps(columns.floor + thickness, is_filled, width)
    is_x_wall = steps.x | (np.diff(np.pad(is_filled, ((0, 0), (1, 1))).astype(int), axis=1) != 0)
    is_y_wall = steps.y | (np.diff(np.pad(is_filled, ((1, 1), (0, 0))).astype(int), axis=0) != 0)
    # 1 for a wall at 45° to the sides, 0 for one along them; ends of a side move by half a cell at most
    largest_move = np.maximum.reduce(moves)
    skew = 4.0 * weights[0] * weights[1] / (weights[0] + weights[1]) ** 2
    skew = np.clip(np.minimum(skew, _LARGEST_SHIFT / np.maximum(largest_move, 1e-12) - 1.0), 0.0, 1.0)
    x_skew, y_skew = (skew * np.sign(moves[k + 1] - moves[k]) for k in (2, 0))
    x_shift = _corner_shift(moves[0], moves[1], x_skew, is_x_wall)
    y_shift = _corner_shift(moves[2].T, moves[3].T, y_skew.T, is_y_wall.T).T
    return _Layout(thickness, x_shift, y_shift)


def _corner_shift(before: Array, after: Array, skew: Array, is_wall: Bools) -> Array:
    """Return the shift of each corner (ny + 1, nx + 1) along x: the mean of those of the walls that meet there.

    Where two walls of a cell meet, their common corner moves farther than their other ends: of a stair of cells the
    outer corners alone move, and it becomes a straight wall.

    :param before: (ny, nx) move of the side before each cell into it, in widths of a cell, and `after` (ny, nx) of the
        side after it.
    :param skew: (ny, nx) share by which the ends of both sides in the next row move farther, and the others less.
    :param is_wall: (ny, nx + 1) whether a side is a wall.
    """
    total = np.zeros((before.shape[0] + 1, before.shape[1] + 1))
    total[:-1, :-1] += (1.0 - skew) * before
    total[1:, :-1] += (1.0 + skew) * before
    total[:-1, 1:] -= (1.0 - skew) * after
    total[1:, 1:] -= (1.0 + skew) * after
    walls = np.pad(is_wall, ((1, 1), (0, 0))).astype(float)
    shift = total / np.maximum(walls[1:] + walls[:-1], 1.0)
    return np.asarray(np.clip(shift, -_LARGEST_SHIFT, _LARGEST_SHIFT))


def _around_corners(values: NDArray[Any]) -> list[NDArray[Any]]:
    """Return values of cells (ny, nx) at each corner (ny + 1, nx + 1), for the four cells around it in a ring.

    In rows and columns from the corner: (−1, −1), (−1, 0), (0, 0), (0, −1); outside of all cells 0.
    """
    padded = np.pad(values, 1)
    return [padded[:-1, :-1], padded[:-1, 1:], padded[1:, 1:], padded[1:, :-1]]


def _corner_levels(level: Array, is_filled: Bools, width: float, sign: float) -> tuple[list[Array], Array]:
    """Return the heights of a surface at each corner, for the four cells around it in a ring, and their common mean.

    Cells without a step between them have the mean of their heights in common.

    :param level: (ny, nx) height in the middle of each cell [m].
    :param width: width of a cell of the mesh [m].
    :param sign: 1 for the upper surface, −1 for the lower one.
    """
    steps = _steps(level, is_filled, width)
    filled = _around_corners(is_filled)
    levels = _around_corners(np.where(is_filled, level, 0.0))
    pad_x, pad_y = np.pad(steps.x, ((1, 1), (0, 0))), np.pad(steps.y, ((0, 0), (1, 1)))
    # between the cells 0–1, 1–2, 2–3 and 3–0 of the ring
    step = [pad_x[:-1], pad_y[:, 1:], pad_x[1:], pad_y[:, :-1]]
    is_linked = [filled[k] & filled[(k + 1) % 4] & ~step[k] for k in range(4)]
    heights = []
    for k in range(4):
        next_link, last_link = is_linked[k], is_linked[k - 1]
        opposite_by_next, opposite_by_last = next_link & is_linked[(k + 1) % 4], last_link & is_linked[(k + 2) % 4]
        members = [
            filled[k],
            next_link | (opposite_by_last & is_linked[(k + 1) % 4]),
            opposite_by_next | opposite_by_last,
            last_link | (opposite_by_next & is_linked[(k + 2) % 4]),
        ]
        total = sum(np.where(member, levels[(k + j) % 4], 0.0) for j, member in enumerate(members))
        heights.append(np.asarray(total / np.maximum(sum(member.astype(float) for member in members), 1.0)))
    mean = np.asarray(
        sum(np.where(cell, value, 0.0) for cell, value in zip(filled, levels, strict=True))
        / np.maximum(sum(cell.astype(float) for cell in filled), 1.0)
    )
    # a cell that is lower than both neighbours in the ring, opposite another one or an empty cell: vertical edges would
    # have four faces in common
    is_lowest = [
        filled[k] & filled[k - 1] & filled[(k + 1) % 4]
        & (sign * heights[k] < sign * heights[k - 1]) & (sign * heights[k] < sign * heights[(k + 1) % 4])
        for k in range(4)
    ]  # fmt: skip
    is_pinched = np.zeros(mean.shape, dtype=bool)
    for k in range(4):
        is_pinched |= is_lowest[k] & (is_lowest[(k + 2) % 4] | ~filled[(k + 2) % 4])
    return [np.where(is_pinched, mean, height) for height in heights], mean


class _Surface(NamedTuple):
    """Both surfaces of the mesh by corner and cell.

    :param x: (ny + 1, nx + 1) place of each corner [m], and `y`.
    :param is_filled: (ny, nx) True for cells with material.
    :param height: (2, 4, ny + 1, nx + 1) heights of the upper and of the lower surface at each corner, for the four
        cells around it in a ring, in units of `_HEIGHT_STEP`.
    :param is_merged: (2, ny / `_BLOCK`, nx / `_BLOCK`) True for level blocks of each surface.
    :param cell: width of a cell of the mesh [m].
    """

    x: Array
    y: Array
    is_filled: Bools
    height: Ints
    is_merged: Bools
    cell: float

    @property
    def cell_count(self) -> int:
        """Number of cells that are not merged, in the mean of both surfaces."""
        cells = self.is_filled.reshape(self.is_merged.shape[1], _BLOCK, self.is_merged.shape[2], _BLOCK)
        return int((cells.sum(axis=(1, 3)) * ~self.is_merged).sum()) // 2

    def mesh(self) -> RemainingMesh:
        """Return the mesh of both surfaces and the walls between them."""
        triangles = np.concatenate([*self._cell_faces(), *self._block_faces(), *self._walls()])
        a, b, c = triangles.T
        keys, faces = np.unique(triangles[(a != b) & (b != c) & (c != a)], return_inverse=True)
        corner, height = np.divmod(keys, _KEYS)
        z = (height - _KEYS // 2) * _HEIGHT_STEP
        vertices = np.column_stack([self.x.reshape(-1)[corner], self.y.reshape(-1)[corner], z])
        return RemainingMesh(vertices, faces.reshape(-1, 3).astype(np.int64), self.cell)

    @property
    def _turns_diagonal(self) -> Bools:
        """True for cells (ny, nx) with larger triangles if the second and the fourth corner are joined."""
        corner = np.stack([self.x, self.y])
        a, b, c, d = corner[:, :-1, :-1], corner[:, :-1, 1:], corner[:, 1:, 1:], corner[:, 1:, :-1]

        def area(first: Array, second: Array, third: Array) -> Array:
            """Return twice the areas (ny, nx) of triangles [m²], positive if anticlockwise."""
            u, v = second - first, third - first
            return np.asarray(u[0] * v[1] - u[1] * v[0])

        smallest = np.minimum(area(a, b, c), area(a, c, d))
        # 1e-3: of unmoved cells only rounding differs
        return np.asarray(np.minimum(area(a, b, d), area(b, c, d)) > smallest + 1e-3 * self.cell**2)

    def _key(self, height: Ints, row: Ints, column: Ints) -> Ints:
        """Return the keys of vertices: the corner, and the height in units of `_HEIGHT_STEP`."""
        return np.asarray((row * self.x.shape[1] + column) * _KEYS + height + _KEYS // 2)

    def _corner_keys(self, side: int, row: Ints, column: Ints) -> list[Ints]:
        """Return the keys of the corners of cells, anticlockwise seen from above."""
        heights = self.height[side]
        return [
            self._key(heights[ring][row + j, column + k], row + j, column + k)
            for ring, j, k in ((2, 0, 0), (3, 0, 1), (0, 1, 1), (1, 1, 0))
        ]

    def _cell_faces(self) -> Iterator[Ints]:
        """Yield the triangles (F, 3) of cells that are not merged, by the keys of their vertices."""
        for side, is_merged in enumerate(self.is_merged):
            merged_cells = np.repeat(np.repeat(is_merged, _BLOCK, axis=0), _BLOCK, axis=1)
            row, column = np.nonzero(self.is_filled & ~merged_cells)
            a, b, c, d = self._corner_keys(side, row, column)
            turns = self._turns_diagonal[row, column]
            for first, second, third in ((a, b, np.where(turns, d, c)), (np.where(turns, b, a), c, d)):
                yield np.column_stack([first, second, third] if side == 0 else [third, second, first])

    def _block_faces(self) -> Iterator[Ints]:
        """Yield the triangles (F, 3) of merged blocks, by the keys of their vertices.

        Two merged blocks of the same height have the ends of their common side in common only, else all corners of
        cells there. All triangles of a block meet in its middle.
        """
        for side, is_merged in enumerate(self.is_merged):
            level = self.height[side, 2, :-1:_BLOCK, :-1:_BLOCK]
            block_row, block_column = np.nonzero(is_merged)
            row, column, height = block_row * _BLOCK, block_column * _BLOCK, level[block_row, block_column]
            middle = self._key(height, row + _BLOCK // 2, column + _BLOCK // 2)
            padded_merged, padded_level = np.pad(is_merged, 1), np.pad(level, 1)
            for row_step, column_step, begin, along in (
                (-1, 0, (0, 0), (0, 1)), (0, 1, (0, 1), (1, 0)), (1, 0, (1, 1), (0, -1)), (0, -1, (1, 0), (-1, 0)),
            ):  # fmt: skip
                neighbour = block_row + 1 + row_step, block_column + 1 + column_step
                is_simple = padded_merged[neighbour] & (padded_level[neighbour] == height)
                first_row, first_column = row + begin[0] * _BLOCK, column + begin[1] * _BLOCK
                # blocks, and begin and end of a part of their side in cells: the whole side, or the side of each cell
                side_parts = [(is_simple, 0, _BLOCK), *((~is_simple, k, k + 1) for k in range(_BLOCK))]
                for has_part, start, end in side_parts:
                    ends = [
                        self._key(
                            height[has_part],
                            first_row[has_part] + k * along[0],
                            first_column[has_part] + k * along[1],
                        )
                        for k in (start, end)
                    ]
                    yield np.column_stack([middle[has_part], *(ends if side == 0 else ends[::-1])])

    def _walls(self) -> Iterator[Ints]:
        """Yield the triangles (F, 3) of vertical faces, by the keys of their vertices.

        Between two filled cells they connect the heights of each surface, towards empty cells both surfaces.
        """
        upper, lower = self.height
        padded_map = np.pad(self.is_filled, 1)
        # step in rows and columns to a neighbour, and of both corners of the side towards it, anticlockwise: step in
        # rows and columns, and places of the cell and of its neighbour in the ring of four cells around the corner
        for row_step, column_step, begin, end in (
            (-1, 0, (0, 0, 2, 1), (0, 1, 3, 0)), (0, 1, (0, 1, 3, 2), (1, 1, 0, 1)),
            (1, 0, (1, 1, 0, 3), (1, 0, 1, 2)), (0, -1, (1, 0, 1, 0), (0, 0, 2, 3)),
        ):  # fmt: skip
            row, column = np.nonzero(self.is_filled)
            is_open = ~padded_map[row + 1 + row_step, column + 1 + column_step]
            chains = [
                self._chain(row[is_open] + j, column[is_open] + k, upper[cell_place], lower[cell_place], (0, 1))
                for j, k, cell_place, _ in (begin, end)
            ]
            yield from _strip(*chains)
            if row_step + column_step < 0:
                continue  # each side between two filled cells once
            row, column = row[~is_open], column[~is_open]
            for side in (0, 1):
                heights = self.height[side]
                is_wall = np.zeros(len(row), dtype=bool)
                for j, k, cell_place, next_place in (begin, end):
                    corner_row, corner_column = row + j, column + k
                    heights_of_cell, heights_of_next = heights[cell_place], heights[next_place]
                    is_wall |= heights_of_cell[corner_row, corner_column] != heights_of_next[corner_row, corner_column]
                chains = [
                    self._chain(
                        row[is_wall] + j, column[is_wall] + k, heights[cell_place], heights[next_place], (side,)
                    )
                    for j, k, cell_place, next_place in (begin, end)
                ]
                yield from _strip(*(chains if side == 0 else chains[::-1]))

    def _chain(self, row: Ints, column: Ints, first: Ints, last: Ints, sides: tuple[int, ...]) -> Ints:
        """Return the keys of the vertices (n, k) of vertical edges at corners; repeated where there are fewer.

        :param row: (n,) rows of the corners, and `column` (n,) their columns.
        :param first: (ny + 1, nx + 1) height at which an edge begins, and `last` at which it ends.
        :param sides: surfaces whose heights divide the edge; towards empty cells and where a corner has one, both.
        """
        begin, end = first[row, column], last[row, column]
        is_closed = np.logical_and.reduce([cell[row, column] for cell in _around_corners(self.is_filled)])
        low, high = np.minimum(begin, end), np.maximum(begin, end)
        heights = [begin, end]
        for side in (0, 1):
            for ring, cell in zip(self.height[side], _around_corners(self.is_filled), strict=True):
                is_used = cell[row, column] & (~is_closed | (side in sides))
                heights.append(np.where(is_used, np.clip(ring[row, column], low, high), low))
        ordered = np.sort(np.column_stack(heights), axis=1)
        ordered = np.where((begin > end)[:, None], ordered[:, ::-1], ordered)
        return self._key(ordered, row[:, None], column[:, None])


_KEYS = 1 << 30
"""Number of heights in units of `_HEIGHT_STEP`: ± 53 m."""


def _strip(left: Ints, right: Ints) -> Iterator[Ints]:
    """Yield the triangles (F, 3) between two vertical edges of faces, by the keys of their vertices.

    :param left: (n, k) vertices of the edges at the begin of the side of a cell, and `right` (n, k) at its end.
    """
    for k in range(left.shape[1] - 1):
        yield np.column_stack([right[:, 0], left[:, k], left[:, k + 1]])
        yield np.column_stack([left[:, -1], right[:, k + 1], right[:, k]])


def _surface(stock: Stock, factor: int) -> _Surface:
    """Return the surfaces of the mesh of a height map, with cells that are wider by a whole factor."""
    width = stock.cell * factor
    columns = _columns(stock, factor)
    layout = _layout(columns, width)
    is_filled = layout.thickness > 0.0
    _separate_diagonal_cells(is_filled)
    floor = columns.floor
    upper, upper_mean = _corner_levels(floor + layout.thickness, is_filled, width, 1.0)
    lower, lower_mean = _corner_levels(floor, is_filled, width, -1.0)
    # a column above another one or below it: without a step the surfaces do not cross
    filled = _around_corners(is_filled)
    lowest = np.minimum.reduce([np.where(cell, level, np.inf) for cell, level in zip(filled, upper, strict=True)])
    highest = np.maximum.reduce([np.where(cell, level, -np.inf) for cell, level in zip(filled, lower, strict=True)])
    is_crossed = lowest <= highest
    upper = [np.where(is_crossed, upper_mean, level) for level in upper]
    lower = [np.where(is_crossed, lower_mean, level) for level in lower]
    height = np.rint(np.stack([np.stack(upper), np.stack(lower)]) / _HEIGHT_STEP).astype(np.int64)
    x, y = np.meshgrid(np.arange(floor.shape[1] + 1.0), np.arange(floor.shape[0] + 1.0))
    is_moved = (layout.shift_x != 0.0) | (layout.shift_y != 0.0)
    return _Surface(
        stock.x + width * (x + layout.shift_x),
        stock.y + width * (y + layout.shift_y),
        is_filled,
        height,
        np.stack([_level_blocks(heights, is_filled, is_moved) for heights in height]),
        width,
    )


def _level_blocks(heights: Ints, is_filled: Bools, is_moved: Bools) -> Bools:
    """Return True for blocks of `_BLOCK` × `_BLOCK` cells that are filled, level and without a moved corner.

    :param heights: (4, ny + 1, nx + 1) heights of a surface at each corner, for the four cells around it in a ring.
    :param is_moved: (ny + 1, nx + 1) True for corners that are moved.
    """
    # heights at the four corners of each cell, which has another place in the ring around each of them
    corners = [heights[2][:-1, :-1], heights[3][:-1, 1:], heights[0][1:, 1:], heights[1][1:, :-1]]
    low, high = np.minimum.reduce(corners), np.maximum.reduce(corners)
    is_fixed = ~(is_moved[:-1, :-1] | is_moved[:-1, 1:] | is_moved[1:, 1:] | is_moved[1:, :-1])
    blocks = (low.shape[0] // _BLOCK, _BLOCK, low.shape[1] // _BLOCK, _BLOCK)
    is_level = low.reshape(blocks).min(axis=(1, 3)) == high.reshape(blocks).max(axis=(1, 3))
    return np.asarray(is_level & (is_filled & is_fixed).reshape(blocks).all(axis=(1, 3)))


def _separate_diagonal_cells(is_filled: Bools) -> None:
    """Empty one of two filled cells that touch at a corner only, until there are no more such pairs.

    The two cells would share an edge that four faces have in common: such a mesh is not closed.

    :param is_filled: (ny, nx) True for filled cells; changed in place.
    """
    is_diagonal: Bools = np.ones(1, dtype=bool)
    while is_diagonal.any():
        main_diagonal = is_filled[:-1, :-1] & is_filled[1:, 1:] & ~is_filled[:-1, 1:] & ~is_filled[1:, :-1]
        cross_diagonal = is_filled[:-1, 1:] & is_filled[1:, :-1] & ~is_filled[:-1, :-1] & ~is_filled[1:, 1:]
        is_diagonal = main_diagonal | cross_diagonal
        is_filled[:-1, :-1] &= ~main_diagonal
        is_filled[:-1, 1:] &= ~cross_diagonal
