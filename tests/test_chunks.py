"""Work in chunks: the same result as at once, and errors that name the rows of the whole."""

from __future__ import annotations

import numpy as np
import pytest

from postproc import chunks
from postproc.errors import NotConvergedError


@pytest.mark.parametrize("count", [0, 1, 6, 7, 8, 21, 50])
def test_chunks_cover_all_rows_once_and_results_come_in_their_order(monkeypatch, count):
    monkeypatch.setattr(chunks, "ROWS", 7)
    a, b = np.arange(count), np.arange(2.0 * count).reshape(count, 2)
    assert [row for part in chunks.chunks(count) for row in a[part]] == a.tolist()
    total, twice = chunks.in_chunks(lambda a, b: (a[:, None] + b, 2 * a), a, b)
    np.testing.assert_array_equal(total, a[:, None] + b)
    np.testing.assert_array_equal(twice, 2 * a)


def test_an_error_names_the_rows_of_the_whole(monkeypatch):
    monkeypatch.setattr(chunks, "ROWS", 7)

    def fails(a):
        if 16 in a:
            raise NotConvergedError("not found", np.flatnonzero(a == 16))
        return a

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


def test_an_array_with_few_rows_is_indexed_like_one_with_all():
    rows = {3: np.array([1.0, 2.0]), 1: np.array([5.0, 6.0])}
    whole = np.full((5, 2), np.nan)
    for row, values in rows.items():
        whole[row] = values
    np.testing.assert_array_equal(chunks.Runs.from_rows((5, 2), rows)[:], whole)
    np.testing.assert_array_equal(chunks.Runs.of(whole)[:], whole)


def test_a_column_without_a_change_is_one_run():
    runs = chunks.Runs.of(np.full((20_000, 2), np.nan))
    assert (len(runs.values), runs.run.strides, runs.shape) == (1, (0,), (20_000, 2))


def test_ragged_ranges_are_those_of_each_group():
    rng = np.random.default_rng(5)
    for groups in (0, 1, 30):
        count, first = rng.integers(0, 5, groups), rng.integers(-9, 9, groups)
        expected = [n for start, number in zip(first, count, strict=True) for n in range(start, start + number)]
        assert chunks.ragged_range(count, first).tolist() == expected
        assert chunks.ragged_range(count).tolist() == [n for number in count for n in range(number)]
