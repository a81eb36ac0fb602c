"""The stock over time, as an upper bound in coarse cells, and the parts of the tool that must stay clear of it.

What does not cut must not touch the material that is there at that time. Parts of the tool along its axis (shank,
holder, spindle) are compared with the map of the stock while it is swept: before the material of a group of segments is
removed, the map is an upper bound of the material. Where that is not enough, the group is divided, and its material is
removed piece by piece. For all other bodies the coarse cells and the times at which they sink are kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc.frames import Array
from postproc.machining.material import Floats
from postproc.machining.stock import Stock, cell_middles, remove, tool_levels, window_cells, windows
from postproc.machining.tool import Cutter
from postproc.machining.tool_path import StraightSegments
from postproc.program import Bools, Ints

MOST_SIDE_CELLS = 128
"""Coarse cells along a side of the stock (assumed)."""
_HALF_DIAGONAL = 0.7072
"""Half of the diagonal of a cell, √2 / 2 of its width, rounded up: a tool that touches a cell reaches its middle."""
_FLUSH_DEPTH = 1e-6
"""Bodies that reach into material by less [m] are flush with it (assumed)."""
_DISTANCE_ERROR = 5e-5
"""Error of the distance of a part that is too close [m]."""
_MOST_HITS = 20
"""Motions on which a part of the tool is too close, after which it is not compared any more."""
_LEVEL_STEP_SHARE = 0.5
"""Levels of a mesh are rounded up to multiples of this share of a coarse cell (assumed)."""


class ToolPart(Struct, frozen=True):
    """A cylinder of the tool that does not cut: shank, holder or spindle. It extends upwards without limit.

    :param name: name in messages.
    :param radius: [m].
    :param bottom: height of its lower end above the tip [m].
    """

    name: str
    radius: float
    bottom: float


def touches(stock: Stock, body: Cutter, begin: Array, end: Array) -> Bools:
    """Return True for segments (L,) on which a body along z reaches into material; it extends upwards without limit.

    A cell of the height map counts as a whole, up to its higher level, if the body covers any of it.

    :param body: shape of the body, whose lower end has the form of a cutter.
    :param begin: (L, 3) lower end of the body where a segment begins, and `end` (L, 3) where it ends, frame of the map
        [m].
    """
    is_touching = np.zeros(len(begin), dtype=bool)
    # cells are compared by their middles: a body that covers any of a cell reaches its middle if it is this much wider
    widened_body = replace(body, radius=body.radius + _HALF_DIAGONAL * stock.cell)
    high, floor = stock.high.reshape(-1), stock.floor.reshape(-1)
    for rows, corner, window in windows(stock, widened_body.radius + stock.cell, begin, end):
        index, row, column = window_cells(stock, corner, window)
        distance, level = tool_levels(
            widened_body, begin[rows], end[rows], *cell_middles(stock, begin[rows], row, column)
        )
        material = high[index]
        is_hit = (
            (distance < np.float32(widened_body.radius))
            & (material > level + np.float32(_FLUSH_DEPTH))
            & (material > floor[index])
        )
        is_touching[rows] = is_hit.any(axis=(1, 2))
    return is_touching


class Ceiling:
    """Upper bound of the stock over time: its highest level in coarse cells, and the motions after which it is lower.

    :ivar stock: height map of the stock, which the sweep changes in place.
    :ivar cell: width of a coarse cell [m].
    """

    def __init__(self, stock: Stock) -> None:
        """Begin with a height map of the uncut stock, which is kept and not copied."""
        self.stock = stock
        self._factor = max(1, math.ceil(max(stock.high.shape) / MOST_SIDE_CELLS))  # fine cells along a coarse one
        self.cell = self._factor * stock.cell
        self._level = self._highest_material(slice(None), slice(None))
        self._start_level = self._level.copy()
        self._changes: list[tuple[int, Ints, Floats]] = []  # motion, flat indices of cells and their new levels

    def _highest_material(self, rows: slice, columns: slice) -> Floats:
        """Return the highest level of material of coarse cells (ny, nx) [m]; −inf for cells without material.

        :param rows: rows of the height map, and `columns`: columns; both begin at the edge of a coarse cell.
        """
        high, floor = self.stock.high[rows, columns], self.stock.floor[rows, columns]
        high = np.where(high > floor, high, -np.inf)
        for axis in (0, 1):
            high = np.maximum.reduceat(high, np.arange(0, high.shape[axis], self._factor), axis=axis)
        return np.asarray(high, dtype=np.float32)

    def _window(self, low: Array, high: Array) -> tuple[slice, slice]:
        """Return rows and columns of the coarse cells between two corners `low` and `high` (3,) of a box [m]."""
        origin = np.array([self.stock.x, self.stock.y])
        size = self._level.shape[::-1]
        first = np.clip(np.floor((low[:2] - origin) / self.cell).astype(int), 0, size)
        last = np.clip(np.floor((high[:2] - origin) / self.cell).astype(int) + 1, 0, size)
        return slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))

    def highest_level(self, low: Array, high: Array) -> float:
        """Return the highest level of material in a box seen along z [m]; −inf without material.

        :param low: (3,) and `high` (3,): lower and upper corner of the box [m].
        """
        return float(self._level[self._window(low, high)].max(initial=-np.inf))

    def record_removal(self, low: Array, high: Array, motion: int) -> None:
        """Lower the bound after material in a box was removed from the height map, and record the change.

        :param low: (3,) and `high` (3,): lower and upper corner of the box [m].
        :param motion: row of the motion at whose end the material is removed.
        """
        rows, columns = self._window(low, high)
        old_level = self._level[rows, columns]
        if not old_level.size:
            return
        factor = self._factor
        new_level = self._highest_material(
            slice(rows.start * factor, rows.stop * factor), slice(columns.start * factor, columns.stop * factor)
        )
        row, column = np.nonzero(new_level < old_level)
        if len(row):
            index = (row + rows.start) * self._level.shape[1] + column + columns.start
            self._changes.append((motion, index, new_level[row, column]))
            self._level[rows, columns] = new_level

    def levels_before(self, motion: int) -> Floats:
        """Return the highest levels (ny, nx) of material of the coarse cells when a motion begins [m]."""
        level = self._start_level.copy()
        flat_level = level.reshape(-1)
        for end_motion, index, lower_level in self._changes:  # in the order of motions
            if end_motion >= motion:
                break
            flat_level[index] = lower_level
        return level

    def mesh(self, motion: int) -> tuple[Array, NDArray[np.int64]]:
        """Return boxes that contain all material when a motion begins: vertices (V, 3) [m], faces (F, 3).

        Levels are rounded up, so that cells of about one level make one box.
        """
        level = self.levels_before(motion).astype(float)
        solid = np.isfinite(level)
        step, top = _LEVEL_STEP_SHARE * self.cell, float(level.max(initial=-np.inf))
        level[solid] = top - step * np.floor((top - level[solid]) / step + 1e-9)  # 1e-9: rounding
        boxes, cell = _boxes(level), self.cell
        x, y, bottom = self.stock.x, self.stock.y, float(self.stock.floor.min())
        low = [(x + cell * box.first_column, y + cell * box.first_row, bottom) for box in boxes]
        high = [(x + cell * box.end_column, y + cell * box.end_row, box.level) for box in boxes]
        corners = np.where(
            _IS_UPPER, np.array(high).reshape(-1, 1, 3), np.array(low).reshape(-1, 1, 3)
        )  # (boxes, 8, 3)
        faces = 8 * np.arange(len(boxes))[:, None, None] + _FACES  # (boxes, 12, 3)
        return corners.reshape(-1, 3), faces.reshape(-1, 3).astype(np.int64)


class StockInTime(Struct, frozen=True, eq=False):
    """The stock of a program over time, as an upper bound. Implements `forces.StockInTime`.

    :param first: first motion of each set-up, ascending.
    :param frame: frame (4, 4) of the height map of each set-up in the robot root.
    :param ceiling: upper bound of the stock of each set-up.
    :param is_compared: (M,) motions on which the parts of the tool along its axis were compared with the stock.
    :param removes_material: (M,) motions that remove material.
    """

    first: tuple[int, ...]
    frame: tuple[Array, ...]
    ceiling: tuple[Ceiling, ...]
    is_compared: Bools
    removes_material: Bools

    @property
    def accuracy(self) -> float:
        """Largest width of a coarse cell [m]: the bound exceeds the stock by no more, across and along the tool."""
        return float(max(ceiling.cell for ceiling in self.ceiling))

    def mesh(self, motion: int) -> tuple[Array, NDArray[np.int64]]:
        """Return boxes that hold all material when a motion begins: vertices (V, 3) in the root [m], faces (F, 3)."""
        # the last set-up whose first motion is not after this one; motions before the first set-up belong to it
        setup = int(np.searchsorted(self.first[1:], motion, side="right"))
        vertices, faces = self.ceiling[setup].mesh(motion)
        frame = self.frame[setup]
        return vertices @ frame[:3, :3].T + frame[:3, 3], faces


_IS_UPPER = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)], dtype=bool)
"""(8, 3) True where a corner of a box is at its upper end in x, y, z."""
_FACES = np.array([
    [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
    [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
])  # fmt: skip
"""(12, 3) corners of the triangles of a box, two for each side; rows of `_IS_UPPER`."""


class _Box(NamedTuple):
    """A rectangle of cells with the same level [m]; the ends of columns and rows are exclusive."""

    first_column: int
    end_column: int
    first_row: int
    end_row: int
    level: float


def _boxes(level: Array) -> list[_Box]:
    """Return the rectangles of cells with one level that cover all cells with material.

    A run of cells of one level in a row is joined with an equal run in the row before. A rectangle ends before the
    first row that lacks its run.

    :param level: (ny, nx) of the cells [m]; −inf without material.
    """
    boxes = list[_Box]()
    first_rows: dict[tuple[int, int, float], int] = {}  # first column, end column and level of a run → its first row
    row_after_last = np.full(level.shape[1], -np.inf)  # without material: it ends all rectangles
    for row, row_levels in enumerate([*level, row_after_last]):
        ends = np.append(np.flatnonzero(row_levels[1:] != row_levels[:-1]) + 1, len(row_levels))
        starts = np.append(0, ends[:-1])
        runs = {
            (int(start), int(end), float(row_levels[start]))
            for start, end in zip(starts, ends, strict=True)
            if np.isfinite(row_levels[start])
        }
        for run in [run for run in first_rows if run not in runs]:
            first_column, end_column, run_level = run
            boxes.append(_Box(first_column, end_column, first_rows.pop(run), row, run_level))
        for run in runs:
            first_rows.setdefault(run, row)
    return boxes


class _SweptVolume(NamedTuple):
    """A body along z and the path of its lower end.

    :param body: its shape.
    :param begin: (L, 3) positions of its lower end where segments begin [m].
    :param end: (L, 3) where they end [m].
    """

    body: Cutter
    begin: Array
    end: Array


class Guard(Struct, eq=False):
    """Parts of the tool that must stay clear of the stock.

    :ivar parts: parts that do not cut, from the cutter upwards.
    :ivar min_distance: smallest allowed distance [m]; 0: they must not touch.
    :ivar cutter: diameter of the cutter with which arm and obstacles are compared [m]; None: there is none.
    :ivar close_distances: (name of a part, row of a motion) → smallest distance [m], if it is below `min_distance`; 0:
        they touch.
    """

    parts: Sequence[ToolPart]
    min_distance: float
    cutter: float | None = None
    close_distances: dict[tuple[str, int], float] = field(default_factory=dict)

    def check(
        self, ceiling: Ceiling, segments: StraightSegments, rows: slice, cutter: Cutter, *, removes: bool
    ) -> None:
        """Record in `close_distances` the parts that are closer to the stock than allowed on some segments.

        Quick tests come first: against the upper bound of the stock, against the volume that the cutter sweeps, and of
        the whole path at once. Only parts that fail all of them are compared piece by piece.

        :param ceiling: the stock before the material of these segments is removed.
        :param rows: rows of the segments that are compared.
        :param cutter: cutter of the tool, the same on all of them.
        :param removes: whether the segments remove material.
        """
        begin, end = segments.begin[rows], segments.end[rows]
        low, high = np.minimum(begin, end).min(axis=0), np.maximum(begin, end).max(axis=0)  # box around all tips
        for tool_part in self.parts:
            reach = tool_part.radius + self.min_distance + ceiling.cell
            highest_level = ceiling.highest_level(low - reach, high + reach)
            is_above_material = highest_level <= low[2] + tool_part.bottom - self.min_distance
            has_enough_hits = sum(name == tool_part.name for name, _ in self.close_distances) >= _MOST_HITS
            if is_above_material or has_enough_hits or self._is_in_sweep(tool_part, cutter, ceiling.stock.cell):
                continue
            if touches(ceiling.stock, *self._swept_volume(tool_part, begin, end, self.min_distance)).any():
                self._compare_pieces(tool_part, ceiling.stock, segments, rows, cutter, removes=removes)

    def _is_in_sweep(self, tool_part: ToolPart, cutter: Cutter, cell: float) -> bool:
        """Return whether a part of the tool, with its clearance, is inside the volume that the cutter below it sweeps.

        Such a part, as a thin shank, cannot touch what the cutter leaves.

        :param cell: width of a cell of the height map [m]. The part must be two cells inside of the cutter: the map
            locates the walls that the cutter leaves in the stock no better.
        """
        reach = tool_part.radius + self.min_distance
        if reach > cutter.radius - 2.0 * cell:
            return False
        # heights above the tip: of the lower end of the part, and of the lower side of the cutter at this radius
        return tool_part.bottom - self.min_distance >= float(cutter.lower_side(np.array([reach]))[0])

    def _swept_volume(self, tool_part: ToolPart, begin: Array, end: Array, clearance: float) -> _SweptVolume:
        """Return all points within a clearance of a part of the tool as a body along z, and the path of its lower end.

        :param clearance: [m], which also is the radius of the rounded lower edge of the body.
        :param begin: (L, 3) positions of the tip where segments begin, and `end` (L, 3) where they end [m].
        """
        tip_to_bottom = np.array([0.0, 0.0, tool_part.bottom - clearance])
        body = Cutter(radius=tool_part.radius + clearance, corner=clearance, teeth=1)  # its teeth do not matter
        return _SweptVolume(body, begin + tip_to_bottom, end + tip_to_bottom)

    def _compare_pieces(
        self,
        tool_part: ToolPart,
        stock: Stock,
        segments: StraightSegments,
        rows: slice,
        cutter: Cutter,
        *,
        removes: bool,
    ) -> None:
        """Compare a part of the tool with the stock along short pieces of segments, in order.

        The material of each piece is removed from a copy of the height map before the next one is compared.

        Where the segments continue others, the material under the front of the cutter (the half that faces the travel)
        is still in the map, as the sweep removes it later: it is removed from the copy first.

        :param stock: before the material of the segments is removed.
        :param rows: rows of the segments that are compared.
        :param cutter: cutter of the tool.
        :param removes: whether the segments remove material.
        """
        begin, end, motion = segments.begin[rows], segments.end[rows], segments.motion[rows]
        reach = max(tool_part.radius + self.min_distance, cutter.radius) + 3.0 * stock.cell
        remaining_stock = _copied_part(
            stock, np.minimum(begin, end).min(axis=0) - reach, np.maximum(begin, end).max(axis=0) + reach
        )
        if segments.continues[rows.start]:
            remove(remaining_stock, cutter, begin[:1], begin[:1])  # the cutter at rest where they begin
        # pieces so short that even on a plunge the part stays above what the cutter removes in the same piece
        step = max(stock.cell, 0.5 * (tool_part.bottom - self.min_distance))
        for start, stop, row_motion in zip(begin, end, motion.tolist(), strict=True):
            if not removes:
                self._record_distance(tool_part, remaining_stock, row_motion, (start[None], stop[None]))
                continue
            for piece_begin, piece_end in _segment_pieces(start, stop, step):
                volume = self._swept_volume(tool_part, piece_begin, piece_end, self.min_distance)
                if touches(remaining_stock, *volume)[0]:
                    for short_piece in _segment_pieces(piece_begin[0], piece_end[0], stock.cell):
                        self._record_distance(tool_part, remaining_stock, row_motion, short_piece)
                        remove(remaining_stock, cutter, *short_piece)
                else:
                    remove(remaining_stock, cutter, piece_begin, piece_end)

    def _record_distance(self, tool_part: ToolPart, stock: Stock, motion: int, segment: tuple[Array, Array]) -> None:
        """Record the distance of a part of the tool from the stock on a segment, if it is below the allowed one.

        The smallest distance of each part on each motion is kept, in `close_distances`.

        :param motion: row of `Motions`; `segment`: positions of the tip at both ends, (1, 3) each [m].
        """
        key = tool_part.name, motion

        def has_contact(clearance: float) -> bool:
            """Return whether the part, enlarged by a clearance [m], touches the stock on the segment."""
            return bool(touches(stock, *self._swept_volume(tool_part, *segment, clearance))[0])

        # bisection: the part with a larger clearance touches wherever that with a smaller one does
        low, high = 0.0, self.close_distances.get(key, self.min_distance)
        if not has_contact(high):
            return
        if has_contact(low):
            high = low  # the part itself touches: its distance is 0
        while high - low > _DISTANCE_ERROR:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if has_contact(middle) else (middle, high)
        self.close_distances[key] = high


def _segment_pieces(begin: Array, end: Array, step: float) -> Iterator[tuple[Array, Array]]:
    """Yield begin and end (1, 3) of equal pieces, at most `step` [m] long, of a segment from `begin` to `end` (3,)."""
    count = max(1, int(np.ceil(np.sqrt(np.sum((end - begin) ** 2)) / step - 1e-9)))
    places = begin + np.linspace(0.0, 1.0, count + 1)[:, None] * (end - begin)
    for k in range(count):
        yield places[k : k + 1], places[k + 1 : k + 2]


def _copied_part(stock: Stock, low: Array, high: Array) -> Stock:
    """Return a copy of the part of the height map between the corners `low` (3,) and `high` (3,) of a box [m]."""
    origin = np.array([stock.x, stock.y])
    first_cell = np.floor((low[:2] - origin) / stock.cell).astype(int).clip(0)
    end_cell = np.ceil((high[:2] - origin) / stock.cell).astype(int).clip(0) + 1
    window = slice(int(first_cell[1]), int(end_cell[1])), slice(int(first_cell[0]), int(end_cell[0]))
    upper, lower, share, floor = (values[window].copy() for values in (stock.high, stock.low, stock.share, stock.floor))
    x, y = origin + first_cell * stock.cell
    return Stock(
        x=float(x),
        y=float(y),
        cell=stock.cell,
        high=upper,
        low=lower,
        share=share,
        slope=stock.slope[window].copy(),
        floor=floor,
        ground=stock.ground,
    )
