"""The shape of a milling cutter as pieces of cutting edge."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.frames import Array

BOTTOM, CORNER, SIDE = range(3)
"""Values of `Edge.part`: the end face of a flat or bull tool, the round of a ball or bull tool, the cylinder."""
_RINGS = 3
_MOST_SLICES = 160


class Cutter(Struct, frozen=True):
    """A milling cutter: a cylinder with a rounded corner.

    :param radius: [m].
    :param corner: radius of the corner [m]: 0 for a flat tool, `radius` for a ball.
    :param teeth: number of teeth.
    :param drill: True for a drill: it cuts with its end only.
    """

    radius: float
    corner: float
    teeth: int
    drill: bool = False

    def height(self, distance: Array) -> Array:
        """Return the height of its lower side above the tip [m] at distances from its axis [m], at most the radius."""
        if self.corner == 0.0:
            return np.zeros_like(distance)
        over = np.minimum(np.maximum(distance - (self.radius - self.corner), 0.0), self.corner)
        return np.asarray(self.corner - np.sqrt(np.maximum(self.corner**2 - over**2, 0.0)))


class Edge(Struct, frozen=True, eq=False):
    """S pieces of the edge of one tooth, from the axis outwards and up.

    :param part: (S,) `BOTTOM`, `CORNER` or `SIDE`.
    :param radius: (S,) distance of the middle of the piece from the axis [m].
    :param low: (S,) height of its lower end above the tip [m].
    :param rise: (S,) its height [m]; infinite for `SIDE`; 0 for `BOTTOM`.
    :param length: (S,) along the edge, without helix [m]; 1 for `SIDE`, whose length is its height.
    :param kappa: (S,) angle between the axis and the normal of the cut surface: 90° on the cylinder, 0 below.
    """

    part: NDArray[np.int64]
    radius: Array
    low: Array
    rise: Array
    length: Array
    kappa: Array


def edge(cutter: Cutter, step: float) -> Edge:
    """Divide the edge of a cutter into pieces of about `step` [m]."""
    flat, corner = cutter.radius - cutter.corner, cutter.corner
    parts, radius, low, rise, length, kappa = [], [], [], [], [], []
    if flat > 0.0:
        rings = max(_RINGS, min(_MOST_SLICES, int(np.ceil(flat / step))))
        width = flat / rings
        parts.append(np.full(rings, BOTTOM))
        radius.append((np.arange(rings) + 0.5) * width)
        low.append(np.zeros(rings))
        rise.append(np.zeros(rings))
        length.append(np.full(rings, width))
        kappa.append(np.zeros(rings))
    if corner > 0.0:
        slices = max(8, min(_MOST_SLICES, int(np.ceil(corner * 0.5 * np.pi / step))))
        bounds = np.linspace(0.0, 0.5 * np.pi, slices + 1)
        middle = 0.5 * (bounds[1:] + bounds[:-1])
        heights = corner * (1.0 - np.cos(bounds))
        parts.append(np.full(slices, CORNER))
        radius.append(flat + corner * np.sin(middle))
        low.append(heights[:-1])
        rise.append(np.diff(heights))
        length.append(np.full(slices, corner * 0.5 * np.pi / slices))
        kappa.append(middle)
    if not cutter.drill:
        parts.append(np.array([SIDE]))
        radius.append(np.array([cutter.radius]))
        low.append(np.array([corner]))
        rise.append(np.array([np.inf]))
        length.append(np.array([1.0]))
        kappa.append(np.array([0.5 * np.pi]))
    joined = [np.concatenate(column) for column in (radius, low, rise, length, kappa)]
    return Edge(np.concatenate(parts).astype(np.int64), *joined)


def some(edge: Edge, pieces: NDArray[np.bool_]) -> Edge:
    """Return some of the pieces (S,) of an edge."""
    columns = (edge.radius, edge.low, edge.rise, edge.length, edge.kappa)
    return Edge(edge.part[pieces], *(column[pieces] for column in columns))
