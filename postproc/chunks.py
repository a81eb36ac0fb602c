"""Large arrays worked on in pieces that fit the cache. What works on a piece does not know that it is one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from postproc.errors import NotConvergedError

_ROWS = 8192
"""Rows of a chunk: with their matrices they fit the cache."""


def chunks(count: int) -> Iterator[slice]:
    """Yield the rows of each chunk of `count` rows; one, empty, for none."""
    return (slice(start, start + _ROWS) for start in range(0, max(1, count), _ROWS))


def in_chunks(
    function: Callable[..., tuple[NDArray[Any], ...]], first: NDArray[Any], *others: NDArray[Any]
) -> tuple[NDArray[Any], ...]:
    """Return `function(first, *others)`, worked on in chunks of the arrays' first axis.

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
