"""Work in chunks: the same result as at once, and errors that name the rows of the whole."""

from __future__ import annotations

import errno
import io
import os

import numpy as np
import pytest

from postproc import chunks
from postproc.errors import NotConvergedError


@pytest.mark.parametrize("count", [0, 1, 6, 7, 8, 21, 50])
def test_chunks_cover_all_rows_once_and_results_come_in_their_order(monkeypatch, count):
    monkeypatch.setattr(chunks, "_ROWS", 7)
    a, b = np.arange(count), np.arange(2.0 * count).reshape(count, 2)
    assert [row for part in chunks.chunks(count) for row in a[part]] == a.tolist()
    total, twice = chunks.in_chunks(lambda a, b: (a[:, None] + b, 2 * a), a, b)
    np.testing.assert_array_equal(total, a[:, None] + b)
    np.testing.assert_array_equal(twice, 2 * a)


def test_an_error_names_the_rows_of_the_whole(monkeypatch):
    monkeypatch.setattr(chunks, "_ROWS", 7)

    def fails(a):
        if 16 in a:
            raise NotConvergedError("not found", np.flatnonzero(a == 16))
        return (a,)

    with pytest.raises(NotConvergedError, match="not found") as found:
        chunks.in_chunks(fails, np.arange(40))
    assert found.value.rows == (16,)


def test_whole_numbers_in_a_smaller_type_are_the_same_or_refused():
    column = np.array([-1, 127, 5])
    column.setflags(write=False)
    small = chunks.compact(column, np.int8)
    assert (small.dtype, small.tolist(), small.flags.writeable) == (np.int8, [-1, 127, 5], False)
    assert chunks.compact(np.broadcast_to(np.array(-1), (9,)), np.int8).strides == (0,)
    with pytest.raises(OverflowError, match="int8"):
        chunks.compact(np.array([0, 128]), np.int8)
    with pytest.raises(OverflowError, match="int8"):
        chunks.compact(np.broadcast_to(np.array(300), (9,)), np.int8)


def test_an_array_with_few_rows_and_rows_computed_on_demand_are_indexed_like_arrays():
    rows = {3: np.array([1.0, 2.0]), 1: np.array([5.0, 6.0])}
    whole = np.full((5, 2), np.nan)
    for row, values in rows.items():
        whole[row] = values
    np.testing.assert_array_equal(chunks.Runs.few((5, 2), rows)[:], whole)
    np.testing.assert_array_equal(chunks.Runs.of(whole)[:], whole)
    again = chunks.Computed(np.array([4, 3, 1]), whole.__getitem__)
    np.testing.assert_array_equal(chunks.in_chunks(lambda part: (part,), again)[0], whole[[4, 3, 1]])


def test_a_column_without_a_change_is_one_run():
    runs = chunks.Runs.of(np.full((20_000, 2), np.nan))
    assert (len(runs.values), runs.run.strides, runs.shape) == (1, (0,), (20_000, 2))


@pytest.mark.parametrize("count", [1, 9, 40, 200])
def test_rows_in_a_file_are_indexed_like_an_array(monkeypatch, count):
    monkeypatch.setattr(chunks, "_ROWS", 8)
    monkeypatch.setattr(chunks, "MANY", 0)
    rng = np.random.default_rng(count)
    array, kept = np.zeros((count, 3)), chunks.many_rows(count, 3)
    assert isinstance(kept, chunks.InFile)
    assert (len(kept), kept.shape) == (count, (count, 3))
    for rows in (slice(0, count // 2), slice(count // 3, None), np.arange(0, count, 2), np.zeros(0, dtype=np.int64)):
        values = rng.normal(size=array[rows].shape)
        array[rows] = kept[rows] = values
    somewhere = rng.integers(-count, count, 3 * count)
    keys = (slice(None), slice(2, 7), slice(None, None, 3), somewhere, somewhere[:0], np.arange(count)[::-1])
    for key in (*keys, (slice(None), 1), (somewhere, slice(None, 2)), (slice(1, 5), slice(None, 2))):
        np.testing.assert_array_equal(kept[key], array[key])
        np.testing.assert_array_equal(chunks.Computed(np.arange(count), kept.take)[key], array[key])
    for key in (0, -1, (0, 2)):
        np.testing.assert_array_equal(kept[key], array[key])
    np.testing.assert_array_equal(np.asarray(kept), array)
    np.testing.assert_array_equal(chunks.rows_of(kept, np.arange(0, count, 3))[:], array[::3])


def test_few_rows_are_an_array():
    assert isinstance(chunks.many_rows(chunks.MANY, 2), np.ndarray)


@pytest.mark.parametrize("call", ["truncate", "write"])
def test_without_room_for_files_it_is_said_where_and_how_much(monkeypatch, tmp_path, call):
    monkeypatch.setattr(chunks, "MANY", 0)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    class Full(io.BytesIO):
        pass

    def full(self, _):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    setattr(Full, call, full)
    monkeypatch.setattr("tempfile.TemporaryFile", lambda **_: Full())
    with pytest.raises(OSError, match="no room for temporary files") as found:
        chunks.many_rows(1_000_000, 6)[:2] = np.ones((2, 6))
    assert all(part in str(found.value) for part in (str(tmp_path), "288 MB", "TMPDIR", os.strerror(errno.ENOSPC)))


def test_a_file_that_became_shorter_is_an_error_and_no_endless_reading(monkeypatch):
    monkeypatch.setattr(chunks, "MANY", 0)
    kept = chunks.many_rows(10, 2)
    kept._file.truncate(100)
    with pytest.raises(OSError, match="shorter"):
        kept[:]
