"""Circles through three points."""

from __future__ import annotations

import numpy as np

from postproc.frames import Array
from postproc.program import Bools

_FLAT = 1e-9
"""Three points whose triangle is lower than this, in its longest side, lie on a line."""


def through(start: Array, via: Array, end: Array) -> tuple[Array, Array, Array, Bools]:
    """Return centres (n, 3), axes (n, 3) and angles (n,) > 0 [rad] of arcs through three points, (n, 3) each [m].

    :returns: besides (n,) True where the three points lie on a straight line, or two of them coincide: no circle.
    """
    a, b = via - start, end - start
    aa, bb, cc = (np.einsum("ni,ni->n", v, v) for v in (a, b, b - a))
    cross = np.cross(a, b)
    size = np.linalg.norm(cross, axis=1)
    flat = ~(size > _FLAT * np.maximum(np.maximum(aa, bb), cc))
    size = np.where(flat, 1.0, size)
    centre = start + np.cross(aa[:, None] * b - bb[:, None] * a, cross) / (2.0 * size**2)[:, None]
    normal = cross / size[:, None]
    u, v = start - centre, end - centre
    angle = np.arctan2(np.einsum("ni,ni->n", np.cross(u, v), normal), np.einsum("ni,ni->n", u, v))
    return centre, normal, np.where(angle > 0.0, angle, angle + 2.0 * np.pi), flat
