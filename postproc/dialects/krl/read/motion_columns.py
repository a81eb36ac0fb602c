"""Motions as columns: the contents of their lines, before components are completed and frames applied."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from postproc.chunks import Columns, compact
from postproc.dialects.krl.language.motion_statements import MotionStatement
from postproc.dialects.krl.language.positions import COLUMNS
from postproc.dialects.krl.language.values import Number
from postproc.dialects.krl.layout import Offsets
from postproc.dialects.krl.read.state import State
from postproc.frames import Array
from postproc.program import Bools, Ints

_BATCH_SIZE = 1000
"""Motions that are collected before they become columns."""


class MotionColumns(Columns, frozen=True, eq=False):
    """R motions.

    :param trace_row: (R,) row of the execution trace, from 1; before a trace is recorded, line of the file. Offsets are
        those in the file.
    :param kind: (R,) `LIN`, `CIRC`, `PTP` or `SPL`.
    :param numbers: (R, 6) X, Y, Z [mm], A, B, C [deg] as the text gives them; NaN where missing.
    :param posture: (R, 2) S and T; −1 where missing.
    :param external: (R, 6) E1…E6 [mm, deg]; NaN where missing.
    :param relative_spans: (R, 8, 2) spans of the texts of X…T, counted from the start of the target, in as few bytes as
        they need; 0 where missing.
    :param keyword: (R,) offset of the instruction.
    :param target: (R, 2) span of the target.
    :param tail: (R, 2) span of the text behind the target: approximation, WITH.
    :param approximated: (R,) True where `$APO.CDIS` applies.
    :param via: (R, 3) X, Y, Z of the auxiliary point of a circle [mm]; NaN elsewhere.
    :param via_spans: (R, 3, 2) spans of the texts of X, Y, Z of the auxiliary point; −1 where missing.
    :param via_target: (R, 2) span of the auxiliary point; −1 where it is not in the line.
    """

    trace_row: Ints
    kind: Ints
    numbers: Array
    posture: Ints
    external: Array
    relative_spans: NDArray[np.unsignedinteger[Any]]
    keyword: Offsets
    target: Offsets
    tail: Offsets
    approximated: Bools
    via: Array
    via_spans: Offsets
    via_target: Ints

    def __len__(self) -> int:
        """Return the number of motions."""
        return len(self.trace_row)

    def columns(self) -> list[Any]:
        """Return all columns."""
        return [getattr(self, name) for name in self.__struct_fields__]


class MotionCollector:
    """Collects motion statements one by one, as rows of columns.

    :ivar states: state in force at each statement.
    :ivar special_moves: the statements that are not plain: index among all statements, and statement.
    """

    def __init__(self) -> None:
        """Begin without statements; they are converted to columns in batches."""
        self.states: list[State] = []
        self.special_moves: list[tuple[int, MotionStatement]] = []
        self._unconverted: list[MotionStatement] = []
        self._converted_parts: list[MotionColumns] = []

    def __len__(self) -> int:
        """Return the number of statements."""
        return len(self.states)

    def add(self, move: MotionStatement, state: State) -> None:
        """Add the next statement, and the state in force for it."""
        if not move.is_plain:
            self.special_moves.append((len(self.states), move))
        self.states.append(state)
        self._unconverted.append(move)
        if len(self._unconverted) == _BATCH_SIZE:
            self._convert()

    def _convert(self) -> None:
        """Convert the latest statements to columns."""
        self._converted_parts.append(_columns_of(self._unconverted))
        self._unconverted = []

    def columns(self) -> MotionColumns:
        """Return all statements as columns; rows of plain lines equal what `plain_lines` reads.

        Numbers of axis and relative targets are NaN, except E1…E6.
        """
        self._convert()
        return merged_motions([*self._converted_parts], np.arange(len(self.states)))


def _columns_of(moves: Sequence[MotionStatement]) -> MotionColumns:
    """Return motion statements as columns.

    Numbers of axis and relative targets are NaN. Spans of components count from the start of their target, which takes
    fewer bytes.
    """
    numbers, external = (np.full((len(moves), 6), np.nan) for _ in range(2))
    component_spans = np.zeros((len(moves), len(COLUMNS), 2), dtype=np.int32)
    for row, move in enumerate(moves):
        position = move.end.position
        if not position.is_axis and not move.relative_axes:
            numbers[row] = position.values
        if position.external:
            external[row] = position.external
        if move.is_plain and position.aggregate is not None:
            for column, name in enumerate(COLUMNS):
                item = position.aggregate.items.get(name)
                if isinstance(item, Number):
                    component_spans[row, column] = item.start - move.end.start, item.stop - move.end.start
    postures = [(move.end.position.status, move.end.position.turn) for move in moves]  # −1 where missing
    via_points = _via_points_of(moves)
    return MotionColumns(
        trace_row=compact(np.array([move.trace_row for move in moves], dtype=np.int64), np.int32),
        kind=compact(np.array([move.kind for move in moves], dtype=np.int64), np.int8),
        numbers=numbers,
        posture=compact_postures(np.array(postures).reshape(-1, 2)),
        external=compact_if_missing(external),
        relative_spans=narrow_integers(component_spans),
        keyword=_offsets([move.keyword[0] for move in moves]),
        target=_offsets([(move.end.start, move.end.stop) for move in moves]).reshape(-1, 2),
        tail=_offsets([(move.tail_start, move.stop) for move in moves]).reshape(-1, 2),
        approximated=np.array([move.is_approximated for move in moves], dtype=np.bool_),
        via=via_points.numbers,
        via_spans=via_points.spans,
        via_target=via_points.targets,
    )


def _via_points_of(moves: Sequence[MotionStatement]) -> ViaPoints:
    """Return the auxiliary points of motion statements; spans only for statements that are plain."""
    points = no_via_points(len(moves))
    if all(move.via is None for move in moves):
        return points
    via, spans, targets = points.numbers.copy(), points.spans.copy(), points.targets.copy()
    for row, move in enumerate(moves):
        if move.via is not None:
            via[row] = move.via.position.values[:3]
            if move.is_plain and move.via.position.aggregate is not None:
                targets[row] = move.via.start, move.via.stop
                items = move.via.position.aggregate.items
                spans[row] = [(items[name].start, items[name].stop) for name in COLUMNS[:3]]
    return ViaPoints(via, spans, targets)


def compact_if_missing(column: Array) -> Array:
    """Return a copy of a column (n, …); if it is NaN throughout, a read-only column that takes no memory."""
    return np.broadcast_to(np.nan, column.shape) if np.isnan(column).all() else column.copy()


def compact_postures(numbers: NDArray[Any]) -> Ints:
    """Return S and T (R, 2) as integers of two bytes; a read-only column that takes no memory if all are −1."""
    return compact(np.broadcast_to(np.int64(-1), numbers.shape) if (numbers == -1).all() else numbers, np.int16)


def narrow_integers(numbers: NDArray[Any]) -> NDArray[np.unsignedinteger[Any]]:
    """Return integers ≥ 0 in the smallest unsigned type that can store them."""
    return np.asarray(numbers.astype(np.min_scalar_type(int(numbers.max(initial=0)))))


class ViaPoints(NamedTuple):
    """Auxiliary points of R motions, see `MotionColumns`.

    :ivar numbers: (R, 3) column `via`.
    :ivar spans: (R, 3, 2) column `via_spans`.
    :ivar targets: (R, 2) column `via_target`.
    """

    numbers: Array
    spans: Offsets
    targets: Ints


def no_via_points(count: int) -> ViaPoints:
    """Return the auxiliary points of motions that have none; the columns are read-only and take no memory."""
    spans, target = np.array(-1, dtype=np.int32), np.array(-1, dtype=np.int64)
    return ViaPoints(
        np.broadcast_to(np.nan, (count, 3)),
        np.broadcast_to(spans, (count, 3, 2)),
        np.broadcast_to(target, (count, 2)),
    )


def _offsets(values: Sequence[object]) -> Offsets:
    """Return offsets as 32-bit integers."""
    return np.array(values, dtype=np.int32)


def merged_motions(parts: list[MotionColumns], place: Ints) -> MotionColumns:
    """Return the motions of at least one part, each at its place among all R motions.

    :param parts: the motions in parts; the list is emptied, so that each column can be released when it is copied.
    :param place: (R,) places, from 0, of the motions of the first part, then of the motions of the next part, …
    """
    destinations = _destinations([len(columns) for columns in parts], place)
    remaining_columns = [columns.columns()[::-1] for columns in parts]  # the first column last, to be popped
    parts.clear()
    merged_columns = []
    while remaining_columns[0]:
        values = [columns.pop() for columns in remaining_columns]
        column = _empty_column(len(place), values)
        if column.flags.writeable:  # else it is complete
            for destination, part_values in zip(destinations, values, strict=True):
                column[destination] = part_values
        merged_columns.append(column)
    return MotionColumns(*merged_columns)


def _destinations(counts: Sequence[int], place: Ints) -> list[Ints | slice]:
    """Return the places of the motions of each part; as a slice, which is faster, if they follow each other.

    :param counts: number of motions of each part.
    :param place: (R,) see `merged_motions`.
    """
    destinations: list[Ints | slice] = []
    begin = 0
    for count in counts:
        end = begin + count
        # places ascend within a part: no motion of another part is between its first and its last
        is_contiguous = count > 0 and place[end - 1] - place[begin] == count - 1
        destinations.append(slice(place[begin], place[begin] + count) if is_contiguous else place[begin:end])
        begin = end
    return destinations


def _empty_column(count: int, parts: Sequence[Any]) -> Any:
    """Return a column of `count` motions that is to be filled.

    If the columns of all parts hold one value throughout and take no memory, the result does so too: it is complete,
    and read-only. All parts have the same value then, the one for missing numbers.

    :param parts: the column of each part.
    """
    nonempty_parts = [values for values in parts if len(values)]
    if nonempty_parts and all(values.strides[0] == 0 for values in nonempty_parts):  # stride 0: one value for all
        return np.broadcast_to(nonempty_parts[0][0], (count, *nonempty_parts[0].shape[1:]))
    return np.empty((count, *parts[0].shape[1:]), np.result_type(*parts))


def no_motions() -> MotionColumns:
    """Return columns without a motion."""
    return _columns_of([])
