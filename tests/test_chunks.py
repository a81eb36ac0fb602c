"""Work in chunks: the same result as at once, and errors that name the rows of the whole."""

from __future__ import annotations

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
