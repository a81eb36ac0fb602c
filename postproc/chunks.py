"""Arrays of many rows: records of columns, and work in chunks that fit the cache.

A function that works on a chunk does not know that it is one.
"""

from __future__ import annotations

import ctypes
import gc
import os
import tempfile
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, Self, TypeAlias

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc.errors import NotConvergedError

_ROWS = 8192
"""Rows of a chunk: with their matrices they fit the cache."""
MANY = 100_000
"""Arrays of more rows are kept in a file between the steps that need them, see `many_rows`."""


class Columns(Struct, frozen=True, eq=False):
    """Base of records whose arrays have one row for each of the same things. Fields that are no arrays are kept."""

    def take(self, rows: NDArray[Any] | slice) -> Self:
        """Return some of the rows."""
        columns = self._columns()
        some = {
            name: each.take(rows) if isinstance(each, Columns) else _rows(each, rows) for name, each in columns.items()
        }
        return replace(self, **some)

    @classmethod
    def joined(cls, parts: Sequence[Self], order: NDArray[Any] | slice = slice(None)) -> Self:
        """Return the rows of several parts, one after the other; other fields are those of the first part.

        :param order: rows of all of them, in another order.
        """
        columns = [part._columns() for part in parts]
        whole = {}
        for name, first in columns[0].items():
            each = [part[name] for part in columns]
            whole[name] = first.joined(each, order) if isinstance(first, Columns) else _rows(_joined(each), order)
        return replace(parts[0], **whole)

    def _columns(self) -> dict[str, Any]:
        fields = {name: getattr(self, name) for name in self.__struct_fields__}
        return {name: value for name, value in fields.items() if isinstance(value, np.ndarray | Columns)}


def _rows(array: NDArray[Any], rows: NDArray[Any] | slice) -> NDArray[Any]:
    """Return some rows of an array; one of one value takes no memory then too."""
    if any(array.strides) or not array.size:
        return np.asarray(array[rows])
    count = len(np.broadcast_to(np.False_, len(array))[rows])
    return np.broadcast_to(array[0], (count, *array.shape[1:]))


def _joined(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return arrays one after the other; if all have the same one value, the result takes no memory either."""
    filled = [part for part in parts if len(part)] or parts[:1]
    first = filled[0]
    if first.size and not any(
        any(part.strides) or part.flat[0] != first.flat[0] or part.dtype != first.dtype for part in filled
    ):
        return np.broadcast_to(first[0], (sum(map(len, filled)), *first.shape[1:]))
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
        begins = np.ones(len(array), dtype=np.bool_)
        for part in chunks(len(array)):
            start = max(part.start, 1)
            own = array[start : part.stop]
            before = array[start - 1 : start - 1 + len(own)]
            begins[start : part.stop] = ((own != before) & ~(np.isnan(own) & np.isnan(before))).any(axis=1)
        if np.count_nonzero(begins) == 1:
            return cls(array[:1].copy(), np.broadcast_to(np.int32(0), (len(array),)))
        return cls(array[begins], np.cumsum(begins, dtype=np.int32) - 1)

    @classmethod
    def few(cls, shape: tuple[int, int], given: Mapping[int, NDArray[np.float64]]) -> Runs:
        """Return an array (N, n) of NaN in which some rows are given (n,)."""
        run = np.zeros(shape[0], dtype=np.int32)
        run[list(given)] = np.arange(1, len(given) + 1)
        return cls(np.stack([np.full(shape[1], np.nan), *given.values()]), run)

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


class Computed(Struct, frozen=True, eq=False):
    """Rows of an array that are computed each time they are indexed, and take no memory.

    :param row: (n,) the rows.
    :param of: returns some of them (m, ...).
    """

    row: NDArray[np.int64]
    of: Callable[[NDArray[np.int64]], NDArray[Any]]

    def __len__(self) -> int:
        return len(self.row)

    def __getitem__(self, key: Any) -> NDArray[Any]:
        rows, *entries = key if isinstance(key, tuple) else (key,)
        found = self.of(self.row[rows])
        return np.asarray(found[(..., *entries)]) if entries else found

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self[:], dtype)


_FILES = 6
"""Arrays of a program that are in files at the same time."""


class InFile:
    """An array (N, n) of numbers in a temporary file, indexed like an array: rows are read when they are needed.

    The file has no name, and goes with the array.
    """

    def __init__(self, count: int, columns: int) -> None:
        """Make an array of zeros.

        :raises OSError: there is no room for the file; assignments raise it too.
        """
        self.shape = (count, columns)
        self._row = columns * np.dtype(np.float64).itemsize
        try:
            self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - closed with the array
            weakref.finalize(self, self._file.close)
            self._file.truncate(count * self._row)
        except OSError as cause:
            raise self._no_room(cause) from cause

    def __len__(self) -> int:
        return self.shape[0]

    def __setitem__(self, rows: slice | NDArray[Any], values: NDArray[np.float64]) -> None:
        """Set some of the rows (n,), in increasing order."""
        at = np.arange(*rows.indices(len(self))) if isinstance(rows, slice) else rows
        begins = np.flatnonzero(np.diff(at, prepend=-2) != 1).tolist()
        for begin, end in pairwise([*begins, len(at)]):
            self._file.seek(int(at[begin]) * self._row)
            data = np.ascontiguousarray(values[begin:end], dtype=np.float64).data.cast("B")
            try:
                while len(data):  # an unbuffered file may take less than it is given
                    data = data[self._file.write(data) :]
            except OSError as cause:
                raise self._no_room(cause) from cause

    def __getitem__(self, key: Any) -> NDArray[np.float64]:
        rows, *entries = key if isinstance(key, tuple) else (key,)
        if isinstance(rows, slice):
            found = self._read(*rows.indices(len(self))[:2])[:: rows.step or 1]
        elif np.ndim(rows) == 0:
            at = int(rows) % len(self)
            found = self._read(at, at + 1)[0]
        else:
            found = self.take(rows)
        return np.asarray(found[(..., *entries)]) if entries else found

    def take(self, rows: Any) -> NDArray[np.float64]:
        """Return some of the rows (n,), in any order; negative ones count from the end."""
        rows = np.asarray(rows) % len(self)
        out = np.empty((len(rows), self.shape[1]))
        if not len(rows):
            return out
        low, high = int(rows.min()), int(rows.max()) + 1
        if high - low <= 2 * _ROWS:
            return np.asarray(self._read(low, high).take(rows - low, axis=0))
        order = np.argsort(rows, kind="stable")
        for part in np.split(order, np.flatnonzero(np.diff(rows[order] // _ROWS)) + 1):
            low, high = int(rows[part[0]]), int(rows[part[-1]]) + 1
            out[part] = self._read(low, high).take(rows[part] - low, axis=0)
        return out

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self[:], dtype)

    def _no_room(self, cause: OSError) -> OSError:
        return OSError(
            f"no room for temporary files in {tempfile.gettempdir()} ({cause.strerror}). Free about "
            f"{_FILES * len(self) * self._row / 1e6:.0f} MB there, or let the environment variable TMPDIR name a "
            "folder with more."
        )

    def _read(self, begin: int, end: int) -> NDArray[np.float64]:
        out = np.empty((max(0, end - begin), self.shape[1]))
        self._file.seek(begin * self._row)
        data = out.data.cast("B") if len(out) else memoryview(b"")
        while len(data):
            count = self._file.readinto(data)
            if not count:
                raise OSError("a temporary file of postproc has become shorter while it was in use")
            data = data[count:]
        return out


Rows: TypeAlias = NDArray[np.float64] | InFile | Computed
"""An array of numbers, or what is indexed like one."""


def many_rows(count: int, columns: int) -> NDArray[np.float64] | InFile:
    """Return an array of zeros to be filled; of more than `MANY` rows in a file."""
    return np.zeros((count, columns)) if count <= MANY else InFile(count, columns)


def release(count: int) -> None:
    """Give memory back to the operating system between the steps of a program of more than `MANY` rows.

    Readers leave reference cycles, which hold columns. And glibc keeps what is freed for itself.
    """
    if count <= MANY:
        return
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
    if trim is not None:
        trim(0)


def set_aside(array: Rows) -> Rows:
    """Return an array (N, n); one of more than `MANY` rows in a file."""
    if len(array) <= MANY:
        return array
    kept = InFile(len(array), array[:1].shape[1])
    for part in chunks(len(array)):
        kept[part] = array[part]
    return kept


def compact(column: NDArray[Any], kind: type[np.integer[Any]]) -> NDArray[Any]:
    """Return a column of whole numbers in a smaller type that holds them.

    One of one value still takes no memory, and one that is read-only stays so.

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


def rows_of(array: Rows, rows: NDArray[Any]) -> Any:
    """Return rows (n,) of an array, in increasing order; without a copy if they follow one another or are in a file."""
    if not isinstance(array, np.ndarray):
        return Computed(rows, array.__getitem__)
    if len(rows) and rows[-1] - rows[0] == len(rows) - 1:
        return array[rows[0] : rows[-1] + 1]
    return np.asarray(array.take(rows, axis=0))


def chunks(count: int) -> Iterator[slice]:
    """Yield the rows of each chunk of `count` rows; one, empty, for none."""
    return (slice(start, start + _ROWS) for start in range(0, max(1, count), _ROWS))


def in_chunks(
    function: Callable[..., tuple[NDArray[Any], ...]], first: NDArray[Any] | Rows, *others: NDArray[Any] | Rows
) -> tuple[NDArray[Any], ...]:
    """Return `function(first, *others)`, computed for chunks of the rows of all arrays and joined.

    :param function: takes arrays of n rows and returns arrays of n rows, each row made from the same row only.
    :raises NotConvergedError: of the function; `rows` are then those of the whole.
    """
    whole: tuple[NDArray[Any], ...] = ()
    for part in chunks(len(first)):
        try:
            pieces = function(first[part], *(array[part] for array in others))
        except NotConvergedError as cause:
            raise NotConvergedError(str(cause), [part.start + row for row in cause.rows]) from None
        whole = whole or tuple(np.empty((len(first), *piece.shape[1:]), piece.dtype) for piece in pieces)
        for array, piece in zip(whole, pieces, strict=True):
            array[part] = piece
    return whole
