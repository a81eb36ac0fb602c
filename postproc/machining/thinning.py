"""Reduce the stations along each motion to those that a piecewise linear force needs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from postproc.frames import Array, norm
from postproc.program import Ints

_SHARE = 0.01
"""Tolerance between stations as a share of the largest force and of the largest moment of a motion,"""
_LEAST = 1.0, 0.1
"""but at least this [N, N·m]: one newton at 100 mm of tool."""


def thinned(motion: Ints, wrench: Array) -> NDArray[np.int64]:
    """Return the rows (K,) of stations that are needed: between them the wrench is linear to within a tolerance.

    The first and the last station of each motion are kept. A motion with a constant wrench keeps one station.

    :param motion: (N,) row of `Motions`, never decreasing.
    :param wrench: (N, 6) [N, N·m].
    """
    if len(motion) == 0:
        return np.zeros(0, dtype=np.int64)
    bounds = np.flatnonzero(np.diff(motion, prepend=-1, append=-1))
    count = np.diff(bounds)
    halves = np.array(wrench, dtype=float).reshape(-1, 2, 3)
    allowed = np.maximum(_SHARE * np.maximum.reduceat(norm(halves), bounds[:-1]), _LEAST)
    halves /= np.repeat(allowed, count, axis=0)[:, :, None]
    low, high = np.minimum.reduceat(halves, bounds[:-1]), np.maximum.reduceat(halves, bounds[:-1])
    constant = norm(high - low).max(axis=1) <= 1.0
    middle = bounds[:-1] + count // 2
    kept = [middle[constant]]
    for place in np.flatnonzero(~constant).tolist():
        begin, end = int(bounds[place]), int(bounds[place + 1])
        kept.append(begin + np.array(sorted(_places(halves[begin:end])), dtype=np.int64))
    return np.sort(np.concatenate(kept))


def _places(halves: Array) -> Iterator[int]:
    """Yield the rows to keep of forces and moments (n, 2, 3), each in units of its tolerance.

    Ramer 1972, Douglas and Peucker 1973, over the row number.
    """
    last = len(halves) - 1
    yield from {0, last}
    todo = [(0, last)]
    while todo:
        a, b = todo.pop()
        if b - a < 2:
            continue
        share = ((np.arange(a + 1, b) - a) / (b - a))[:, None, None]
        off = norm(halves[a + 1 : b] - (halves[a] + share * (halves[b] - halves[a]))).max(axis=1)
        worst = int(np.argmax(off))
        if off[worst] > 1.0:
            yield a + 1 + worst
            todo += [(a, a + 1 + worst), (a + 1 + worst, b)]
