"""Circles through three points, and whether two orientations are the same."""

from __future__ import annotations

import numpy as np

from postproc.chunks import in_chunks
from postproc.dialects.circles import through
from postproc.dialects.krl.language.source import Source
from postproc.frames import RAD_PER_DEG, Array, rotation_from_vector
from postproc.program import Bools, Ints

_UNCHANGED = 1e-3 * RAD_PER_DEG
"""Orientations closer than this [rad] are the same."""


def circles(source: Source, line: Ints, start: Array, via: Array, end: Array) -> tuple[Array, Array, Array]:
    """Return centres (n, 3), axes (n, 3) and angles (n,) > 0 [rad] of arcs through three points, (n, 3) each [m].

    :param line: (n,) 1-based lines, for messages.
    :raises ProgramError: the three points lie on a straight line, or two of them coincide.
    """
    centre, normal, angle, flat = in_chunks(through, start, via, end)
    if flat.any():
        raise source.line_error(
            "the three points of the circle lie on a line or coincide",
            int(line[np.argmax(flat)]),
            "Choose an auxiliary point well between start and end; for a full circle give CA.",
        )
    return centre, normal, angle


def turned(start: Array, centre: Array, normal: Array, angle: float) -> Array:
    """Return the point (3,) that a rotation of `start` about an axis through `centre` reaches."""
    moved: Array = centre + rotation_from_vector(normal * angle) @ (start - centre)
    return moved


def same_orientation(one: Array, other: Array) -> Bools:
    """Return whether orientations (..., 3, 3) differ by less than 0.001°."""
    relative = np.einsum("...ij,...ij->...", one, other)  # trace of oneᵀ·other = 1 + 2·cos(angle)
    return np.asarray(relative > 1.0 + 2.0 * np.cos(_UNCHANGED))
