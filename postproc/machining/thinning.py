"""As few places along each motion as a piecewise linear force needs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from postproc.frames import Array
from postproc.program import Ints

_SHARE = 0.01
"""Of the largest force of a motion, what a force between knots may be off by,"""
_LEAST = 1.0
"""but not less than this [N]."""


def thinned(motion: Ints, wrench: Array) -> NDArray[np.int64]:
    """Return the rows (K,) of stations that are needed: between them the force is linear to within a tolerance.

    The first and the last station of each motion are kept, unless the force is the same all along: then one is.

    :param motion: (N,) row of `Motions`, never decreasing.
    :param wrench: (N, 6) [N, N·m].
    """
    if len(motion) == 0:
        return np.zeros(0, dtype=np.int64)
    bounds = np.flatnonzero(np.diff(motion, prepend=-1, append=-1))
    count = np.diff(bounds)
    force = wrench[:, :3]
    size = np.sqrt(np.einsum("ni,ni->n", force, force))
    tolerance = np.maximum(_SHARE * np.maximum.reduceat(size, bounds[:-1]), _LEAST)
    low, high = np.minimum.reduceat(force, bounds[:-1]), np.maximum.reduceat(force, bounds[:-1])
    constant = np.linalg.norm(high - low, axis=1) <= tolerance
    middle = bounds[:-1] + count // 2
    kept = [middle[constant]]
    for place in np.flatnonzero(~constant).tolist():
        begin, end = int(bounds[place]), int(bounds[place + 1])
        kept.append(begin + np.array(sorted(_places(force[begin:end], float(tolerance[place]))), dtype=np.int64))
    return np.sort(np.concatenate(kept))


def _places(force: Array, tolerance: float) -> Iterator[int]:
    """Yield the rows of (n, 3) to keep (Ramer 1972, Douglas and Peucker 1973, over the row number)."""
    yield 0
    last = len(force) - 1
    if last > 0:
        yield last
    todo = [(0, last)]
    while todo:
        a, b = todo.pop()
        if b - a < 2:
            continue
        share = (np.arange(a + 1, b) - a)[:, None] / (b - a)
        off = force[a + 1 : b] - (force[a] + share * (force[b] - force[a]))
        error = np.einsum("ni,ni->n", off, off)
        worst = int(np.argmax(error))
        if error[worst] > tolerance * tolerance:
            yield a + 1 + worst
            todo += [(a, a + 1 + worst), (a + 1 + worst, b)]
