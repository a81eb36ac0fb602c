"""Arrays of many rows: records of columns, and work in chunks that fit the cache.

A function that works on a chunk does not know that it is one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Self, TypeVar, cast

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc.errors import NotConvergedError

_Result = TypeVar("_Result", bound="NDArray[Any] | tuple[NDArray[Any], ...]")

ROWS = 8192
"""Rows of a chunk: with their matrices they fit the cache. No result depends on it: tests set it to a few."""


class Columns(Struct, frozen=True, eq=False):
    """Base of records whose arrays have one row for each of the same things. Fields that are no arrays are kept."""

    def take(self, rows: NDArray[Any] | slice) -> Self:
        """Return the record with the chosen rows of each of its arrays."""
        columns = self._columns()
        rows_of_columns = {
            name: column.take(rows) if isinstance(column, Columns) else _rows(column, rows)
            for name, column in columns.items()
        }
        return replace(self, **rows_of_columns)

    @classmethod
    def join(cls, parts: Sequence[Self], order: NDArray[Any] | slice = slice(None)) -> Self:
        """Return the rows of several parts, one after the other; other fields are those of the first part.

        :param order: rows of all of them, in another order.
        """
        columns_of_parts = [part._columns() for part in parts]
        joined_columns = {}
        for name, first in columns_of_parts[0].items():
            pieces = [columns[name] for columns in columns_of_parts]
            joined_columns[name] = (
                first.join(pieces, order) if isinstance(first, Columns) else _rows(_concatenation(pieces), order)
            )
        return replace(parts[0], **joined_columns)

    def _columns(self) -> dict[str, Any]:
        """Return the fields that have a row for each thing: name → array or record of arrays."""
        fields = {name: getattr(self, name) for name in self.__struct_fields__}
        return {name: value for name, value in fields.items() if isinstance(value, np.ndarray | Columns)}


def _rows(array: NDArray[Any], rows: NDArray[Any] | slice) -> NDArray[Any]:
    """Return the chosen rows of an array; where the array repeats one value without memory, so does the result."""
    if any(array.strides) or not array.size:
        return np.asarray(array[rows])
    count = len(np.broadcast_to(np.False_, len(array))[rows])
    return np.broadcast_to(array[0], (count, *array.shape[1:]))


def _concatenation(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return arrays one after the other; if all have the same one value, the result takes no memory either."""
    arrays = [part for part in parts if len(part)] or parts[:1]
    first = arrays[0]
    # an array whose strides are all 0 repeats one value
    is_one_value = first.size and all(
        not any(part.strides) and part.dtype == first.dtype and part.flat[0] == first.flat[0] for part in arrays
    )
    if is_one_value:
        return np.broadcast_to(first[0], (sum(map(len, arrays)), *first.shape[1:]))
    return np.concatenate(parts)


class Runs(Struct, frozen=True, eq=False):
    """An array of N rows, indexed like one, of which rows that equal the one before (NaN too) are not kept.

    :param values: (R, ...) first row of each run of equal rows.
    :param run: (N,) run of each row.

    >>> runs = Runs.of(np.array([[1.0, 2.0], [1.0, 2.0], [3.0, 4.0]]))
    >>> len(runs.values), runs.take([1, 2]).tolist(), runs[:, 0].tolist()
    (2, [[1.0, 2.0], [3.0, 4.0]], [1.0, 1.0, 3.0])
    """

    values: NDArray[np.float64]
    run: NDArray[np.int32]

    @classmethod
    def of(cls, array: Runs | NDArray[np.float64]) -> Runs:
        """Return an array as runs of equal rows."""
        if isinstance(array, Runs):
            return array
        begins_run = np.ones(len(array), dtype=np.bool_)
        for part in chunks(len(array)):
            start = max(part.start, 1)
            rows = array[start : part.stop]
            previous_rows = array[start - 1 : start - 1 + len(rows)]
            is_nan_in_both = np.isnan(rows) & np.isnan(previous_rows)
            begins_run[start : part.stop] = ((rows != previous_rows) & ~is_nan_in_both).any(axis=1)
        if np.count_nonzero(begins_run) == 1:  # an index that repeats 0 takes no memory
            return cls(array[:1].copy(), np.broadcast_to(np.int32(0), (len(array),)))
        return cls(array[begins_run], np.cumsum(begins_run, dtype=np.int32) - 1)

    @classmethod
    def from_rows(cls, shape: tuple[int, int], row_values: Mapping[int, NDArray[np.float64]]) -> Runs:
        """Return an array (N, n) of NaN in which some rows are given (n,)."""
        run = np.zeros(shape[0], dtype=np.int32)
        run[list(row_values)] = np.arange(1, len(row_values) + 1)
        return cls(np.stack([np.full(shape[1], np.nan), *row_values.values()]), run)

    def take(self, rows: Any) -> NDArray[np.float64]:
        """Return some of the rows."""
        return np.asarray(self.values.take(self.run[rows], axis=0))

    def of_rows(self, rows: Any) -> Runs:
        """Return the chosen rows as runs of equal rows, without writing them out."""
        return Runs(self.values, self.run[rows])

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        return len(self.run), *self.values.shape[1:]

    def __len__(self) -> int:
        return len(self.run)

    def __getitem__(self, key: Any) -> NDArray[np.float64]:
        rows, *entries = key if isinstance(key, tuple) else (key,)
        return np.asarray(self.values[(self.run[rows], *entries)])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self[:], dtype)


def compact(column: NDArray[Any], kind: type[np.integer[Any]]) -> NDArray[Any]:
    """Return a column of whole numbers in a smaller type that holds them.

    A column that repeats one value without memory (stride 0) still does, and one that is read-only stays read-only.

    :raises OverflowError: the type does not hold them.
    """
    if column.dtype == kind:
        return column
    if len(column) and column.strides[0] == 0:
        return np.broadcast_to(compact(column[:1].copy(), kind)[0], column.shape)
    limits = np.iinfo(kind)
    if len(column) and not (limits.min <= column.min() and column.max() <= limits.max):
        raise OverflowError(f"a number that does not fit {kind.__name__}")
    smaller = column.astype(kind)
    smaller.setflags(write=column.flags.writeable)
    return smaller


def ragged_range(count: NDArray[np.integer[Any]], first: NDArray[np.int64] | int = 0) -> NDArray[np.int64]:
    """Return the integers from `first` (G,) on, `count` (G,) of them, of all groups one after the other.

    >>> ragged_range(np.array([2, 0, 3])).tolist()
    [0, 1, 0, 1, 2]
    >>> ragged_range(np.array([2, 0, 3]), np.array([7, 9, 4])).tolist()
    [7, 8, 4, 5, 6]
    """
    group_start = np.cumsum(count) - count
    return np.asarray(np.arange(int(np.sum(count))) - np.repeat(group_start - first, count), dtype=np.int64)


def chunks(count: int) -> Iterator[slice]:
    """Yield the rows of each chunk of `count` rows; one, empty, for none."""
    return (slice(start, start + ROWS) for start in range(0, max(1, count), ROWS))


def in_chunks(function: Callable[..., _Result], first: NDArray[Any], *other_arrays: NDArray[Any]) -> _Result:
    """Return `function(first, *others)`, computed for chunks of the rows of all arrays and joined.

    For functions whose intermediate arrays are many times larger than their result.

    :param function: takes arrays of n rows. Returns an array of n rows, or several in a plain tuple, each row made from
        the same row only.
    :raises NotConvergedError: of the function; `rows` are then those of the whole.

    >>> in_chunks(lambda a, b: a + b[:, 0], np.array([1, 2]), np.array([[10], [20]])).tolist()
    [11, 22]
    """
    joined_arrays: tuple[NDArray[Any], ...] = ()
    for part in chunks(len(first)):
        try:
            result = function(first[part], *(array[part] for array in other_arrays))
        except NotConvergedError as cause:
            raise NotConvergedError(str(cause), [part.start + row for row in cause.rows]) from None
        pieces: tuple[NDArray[Any], ...] = (result,) if isinstance(result, np.ndarray) else result
        # shapes and types are known after the first chunk
        joined_arrays = joined_arrays or tuple(
            np.empty((len(first), *piece.shape[1:]), piece.dtype) for piece in pieces
        )
        for array, piece in zip(joined_arrays, pieces, strict=True):
            array[part] = piece
    return cast("_Result", joined_arrays[0] if isinstance(result, np.ndarray) else joined_arrays)
