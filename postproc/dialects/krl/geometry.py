"""Circles through three points, and whether two orientations are the same."""

from __future__ import annotations

import numpy as np

from postproc.dialects.krl.source import Source
from postproc.frames import RAD_PER_DEG, Array, rotation_from_vector
from postproc.program import Bools

_UNCHANGED = 1e-3 * RAD_PER_DEG
"""Orientations closer than this [rad] are the same."""


def circle(source: Source, line: int, start: Array, via: Array, end: Array) -> tuple[Array, Array, float]:
    """Return centre (3,), axis (3,) and angle > 0 [rad] of the arc from `start` through `via` to `end`, (3,) each [m].

    :raises ProgramError: the three points lie on a straight line, or two of them coincide.
    """
    a, b = via - start, end - start
    cross = np.cross(a, b)
    size = np.linalg.norm(cross)
    if not size > 1e-9 * max(a @ a, b @ b, (b - a) @ (b - a)) or size == 0.0:
        raise source.line_error(
            "the three points of the circle lie on a line or coincide",
            line,
            "Choose an auxiliary point well between start and end; for a full circle give CA.",
        )
    to_centre = np.cross((a @ a) * b - (b @ b) * a, cross) / (2.0 * size**2)
    centre, normal = start + to_centre, cross / size
    return centre, normal, _angle(start - centre, end - centre, normal)


def _angle(u: Array, v: Array, normal: Array) -> float:
    """Return the angle from u to v about a unit normal, in (0, 2π)."""
    angle = float(np.arctan2(np.cross(u, v) @ normal, u @ v))
    return angle if angle > 0.0 else angle + 2.0 * np.pi


def turned(start: Array, centre: Array, normal: Array, angle: float) -> Array:
    """Return the point (3,) that a rotation of `start` about an axis through `centre` reaches."""
    moved: Array = centre + rotation_from_vector(normal * angle) @ (start - centre)
    return moved


def same_orientation(one: Array, other: Array) -> Bools:
    """Return whether orientations (..., 3, 3) differ by less than 0.001°."""
    relative = np.einsum("...ij,...ij->...", one, other)  # trace of oneᵀ·other = 1 + 2·cos(angle)
    return np.asarray(relative > 1.0 + 2.0 * np.cos(_UNCHANGED))
