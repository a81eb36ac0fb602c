"""Circles through three points."""

from __future__ import annotations

import numpy as np

from postproc.frames import Array


def circle_through(a: Array, b: Array, c: Array) -> tuple[Array, Array, Array, Array]:
    """Return the arcs from a through b to c (each (n, 3)).

    :returns: centre (n, 3), radius vector to a (n, 3), the vector square to it in the direction of travel (n, 3), and
        the angle from a to c (n,) in (0, 2π). Points on one line have none: their radius is zero.
    """
    ab, ac = b - a, c - a
    normal = np.cross(ab, ac)
    square = np.einsum("ni,ni->n", normal, normal)[:, None]
    flat = square[:, 0] <= 1e-24 * np.einsum("ni,ni->n", ac, ac) ** 2
    square = np.where(flat[:, None], 1.0, square)
    ab2, ac2 = np.einsum("ni,ni->n", ab, ab)[:, None], np.einsum("ni,ni->n", ac, ac)[:, None]
    centre = a + np.cross(ab2 * ac - ac2 * ab, normal) / (2.0 * square)
    unit = normal / np.sqrt(square)
    radial = a - centre
    across = np.cross(unit, radial)
    to_c = c - centre
    angle = np.arctan2(np.einsum("ni,ni->n", to_c, across), np.einsum("ni,ni->n", to_c, radial)) % (2.0 * np.pi)
    return centre, radial, across, angle
