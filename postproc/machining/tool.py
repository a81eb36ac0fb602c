"""The shape of a milling cutter, and the edge of its teeth as sample points within a turn."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.frames import Array
from postproc.machining.material import CuttingLaw, Floats

BOTTOM, CORNER, SIDE = range(3)
"""Values of `Edge.part`: the end face of a flat or bull tool, the round of a ball or bull tool, the cylinder."""
_RINGS = 3
"""Smallest number of rings of a flat face (assumed)."""
_MOST_SLICES = 160
"""Largest number of slices of an edge: time grows with it (assumed)."""


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

    @property
    def shape(self) -> str:
        """Return the shape of its end: "flat", "ball" or "bull"."""
        if self.corner == 0.0:
            return "flat"
        return "ball" if self.corner >= self.radius * (1.0 - 1e-9) else "bull"

    def height(self, distance: Array) -> Array:
        """Return the height of its lower side above the tip [m] at distances from its axis [m], at most the radius."""
        if self.corner == 0.0:
            return np.zeros_like(distance)
        corner_distance = np.minimum(np.maximum(distance - (self.radius - self.corner), 0.0), self.corner)
        return np.asarray(self.corner - np.sqrt(np.maximum(self.corner**2 - corner_distance**2, 0.0)))


class Edge(Struct, frozen=True, eq=False):
    """S pieces of the edge of one tooth, from the axis outwards and up.

    :param part: (S,) `BOTTOM`, `CORNER` or `SIDE`.
    :param radius: (S,) distance of the middle of the piece from the axis [m].
    :param low: (S,) height of its lower end above the tip [m].
    :param rise: (S,) its height [m]; infinite for `SIDE`; 0 for `BOTTOM`.
    :param length: (S,) along the edge, without helix [m]; 1 for `SIDE`, whose length is its height.
    :param kappa: (S,) angle between the axis and the normal of the cut surface in the middle of the piece: 90° on the
        cylinder, 0 below.
    :param bend: (S,) change of that angle along the piece [rad].
    """

    part: NDArray[np.int64]
    radius: Array
    low: Array
    rise: Array
    length: Array
    kappa: Array
    bend: Array


def edge(cutter: Cutter, step: float) -> Edge:
    """Return the edge of a cutter in pieces of about `step` [m]: of the end, of the corner, and the cylinder."""
    flat_radius, corner = cutter.radius - cutter.corner, cutter.corner
    parts, radius, low, rise, length, kappa, bend = [], [], [], [], [], [], []
    if flat_radius > 0.0:
        rings = max(_RINGS, min(_MOST_SLICES, int(np.ceil(flat_radius / step))))
        width = flat_radius / rings
        parts.append(np.full(rings, BOTTOM))
        radius.append((np.arange(rings) + 0.5) * width)
        low.append(np.zeros(rings))
        rise.append(np.zeros(rings))
        length.append(np.full(rings, width))
        kappa.append(np.zeros(rings))
        bend.append(np.zeros(rings))
    if corner > 0.0:
        slices = max(8, min(_MOST_SLICES, int(np.ceil(corner * 0.5 * np.pi / step))))
        bounds = np.linspace(0.0, 0.5 * np.pi, slices + 1)
        middle = 0.5 * (bounds[1:] + bounds[:-1])
        heights = corner * (1.0 - np.cos(bounds))
        parts.append(np.full(slices, CORNER))
        radius.append(flat_radius + corner * np.sin(middle))
        low.append(heights[:-1])
        rise.append(np.diff(heights))
        length.append(np.full(slices, corner * 0.5 * np.pi / slices))
        kappa.append(middle)
        bend.append(np.full(slices, 0.5 * np.pi / slices))
    if not cutter.drill:
        parts.append(np.array([SIDE]))
        radius.append(np.array([cutter.radius]))
        low.append(np.array([corner]))
        rise.append(np.array([np.inf]))
        length.append(np.array([1.0]))
        kappa.append(np.array([0.5 * np.pi]))
        bend.append(np.zeros(1))
    columns = [np.concatenate(column) for column in (radius, low, rise, length, kappa, bend)]
    return Edge(np.concatenate(parts).astype(np.int64), *columns)


def slice_cylinder(edge: Edge, step: float, height: float) -> Edge:
    """Return an edge whose cylinder is divided into pieces of about `step` [m], up to a height above the tip [m].

    The pieces are those of a corner whose normal is square to the axis: on a tool that leans, each is in material or
    not.
    """
    side = edge.part == SIDE
    if not side.any():
        return edge
    low, radius = float(edge.low[side][0]), float(edge.radius[side][0])
    count = max(1, int(np.ceil((height - low) / step)))
    end_pieces, width, unit = take_pieces(edge, ~side), max(height - low, step) / count, np.ones(count)
    columns = (
        radius * unit, low + width * np.arange(count), width * unit, width * unit, 0.5 * np.pi * unit, 0.0 * unit,
    )  # fmt: skip
    arrays = (
        np.concatenate([getattr(end_pieces, name), column]) for name, column in zip(_COLUMNS, columns, strict=True)
    )
    return Edge(np.concatenate([end_pieces.part, np.full(count, CORNER)]), *arrays)


def take_pieces(edge: Edge, pieces: NDArray[np.bool_]) -> Edge:
    """Return some of the pieces (S,) of an edge."""
    return Edge(edge.part[pieces], *(getattr(edge, name)[pieces] for name in _COLUMNS))


_COLUMNS = ("radius", "low", "rise", "length", "kappa", "bend")


DRILL_THRUST = 0.65
"""Radial by tangential coefficient of a drill: see `postproc.machining.cutting`."""
_SAMPLING = {"ball": 1.0, "flat": 1.7, "bull": 5.1}
"""Error of forces by the cells of the map, relative to that of a ball with a contact of the same area: RMS against
exact fronts on random surfaces with cells of 0.25 mm. The contact of a bull-nose tool is a strip along its corner."""
_LEAST_POINTS = 8
"""Minimum number of sample points in half a turn (assumed)."""


class Turn(Struct, frozen=True, eq=False):
    """P sample points of the edge of a tooth within a turn, and the contribution of each to the wrench.

    Points are about as far apart on small circles as on the rim; points of one kind of edge are contiguous.

    :param sampling: error by the cells of the map, relative to that of a ball.
    :param phi: (P,) angles [rad], the middles of parts of the turn that are `width` (P,) wide.
    :param radius: (P,) distance from the axis [m]; low: (P,) height of the lower end of the piece of edge above the
        tip [m]; rise: (P,) its height [m], 0 on the end face, infinite on the cylinder; length: (P,) along it [m].
    :param bottom: slice of the points on the end face, and round, side: of the corner and of the cylinder.
    :param front: (P,) and axial: components of the normal along x and −z.
    :param tangent: (P, 3) half of what the normal changes by along the piece of edge, outwards and up; 0 but on rounds.
    :param cut: (P, 6) wrench about the tip per engaged length and per chip [N/m², N/m]; on the cylinder without the
        moment due to the height of the force.
    :param rub: (P, 6) the same per engaged length alone [N/m, N].
    :param unit_wrench: (3, P, 6) the same for a tangential, radial and axial coefficient of 1; (0, P, 6) without a
        covariance.
    :param tall: (P, A) height of the edge over its length for each of A angles of the turn that the point covers, or 0.
    """

    law: CuttingLaw
    teeth: int
    drill: bool
    sampling: float
    phi: Array
    width: Array
    radius: Floats
    low: Floats
    rise: Floats
    length: Floats
    bottom: slice
    round: slice
    side: slice
    front: Floats
    axial: Floats
    tangent: Floats
    cut: Floats
    rub: Floats
    unit_wrench: Floats
    tall: Floats

    @classmethod
    def of(cls, edge: Edge, cutter: Cutter, law: CuttingLaw, step: float, descent: float | None) -> Turn:
        """Return the sample points of a turn, about `step` [m] apart, and their wrenches per coefficient.

        :param descent: sine of the steepest downward angle of the feed, < 0 upward: points without a possible chip
            are omitted. None: the tool turns, and any point may have one.
        """
        half_count = cutter.teeth * max(
            int(np.ceil(np.pi * cutter.radius / step / cutter.teeth)), -(-24 // cutter.teeth)
        )
        piece, phi, width = [], [], []
        for piece_number, radius in enumerate(edge.radius.tolist()):
            divisor = 1
            while (
                half_count % (2 * divisor) == 0
                and half_count // (2 * divisor) >= _LEAST_POINTS
                and 2 * divisor * radius <= cutter.radius
            ):
                divisor *= 2
            count = 2 * half_count // divisor
            piece.append(np.full(count, piece_number))
            phi.append((np.arange(count) + 0.5) * (2.0 * np.pi / count))
            width.append(np.full(count, 2.0 * np.pi / count))
        row, angle, point_width = (np.concatenate(column) for column in (piece, phi, width))
        sine, cosine = np.sin(angle), np.cos(angle)
        sin_kappa, cos_kappa = np.sin(edge.kappa)[row], np.cos(edge.kappa)[row]
        cos_kappa = np.where(np.abs(cos_kappa) < 1e-12, 0.0, cos_kappa)
        is_used, half_bend = np.zeros(len(row), dtype=bool), 0.5 * edge.bend[row]
        if descent is not None:
            level = np.sqrt(1.0 - descent**2)
            chip_change = half_bend * np.abs(cos_kappa * sine * level - sin_kappa * descent)
            is_used = sin_kappa * sine * level + cos_kappa * descent + chip_change > 1e-9
        if not is_used.any():
            is_used[:] = True
        columns = row, angle, point_width, sine, cosine, sin_kappa, cos_kappa, half_bend
        row, angle, point_width, sine, cosine, sin_kappa, cos_kappa, half_bend = (column[is_used] for column in columns)
        zero, part, rise = np.zeros(len(row)), edge.part[row], edge.rise[row]
        normal = np.stack([sin_kappa * sine, sin_kappa * cosine, zero - cos_kappa], axis=-1)
        tangential = np.stack([zero - cosine, sine, zero], axis=-1)
        axial = np.stack([cos_kappa * sine, cos_kappa * cosine, sin_kappa], axis=-1)
        z = np.where(part == CORNER, edge.low[row] + 0.5 * np.where(np.isfinite(rise), rise, 0.0), 0.0)
        point = np.stack([edge.radius[row] * sine, edge.radius[row] * cosine, z], axis=-1)
        share = (cutter.teeth * point_width / (2.0 * np.pi))[:, None]

        def wrench(k: tuple[float, float, float]) -> Floats:
            """Return the wrench (P, 6) for a tangential, a radial and an axial coefficient."""
            radial = DRILL_THRUST * k[0] if cutter.drill else k[1]
            force = k[0] * tangential - radial * normal + k[2] * axial
            return np.asarray(np.concatenate([force, np.cross(point, force)], axis=-1) * share, dtype=np.float32)

        axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)) if law.covariance is not None else ()
        unit_wrench = (
            np.stack([wrench(axis) for axis in axes]) if axes else np.zeros((0, len(row), 6), dtype=np.float32)
        )

        def as_single(column: Array) -> Floats:
            return np.ascontiguousarray(column, dtype=np.float32)

        first, second, third, end = np.searchsorted(part, [BOTTOM, CORNER, SIDE, SIDE + 1]).tolist()
        height = (np.where(np.isfinite(rise), rise, 1.0) / edge.length[row])[:, None]
        return cls(
            law, cutter.teeth, cutter.drill, _SAMPLING[cutter.shape], angle, point_width,
            as_single(edge.radius[row]), as_single(edge.low[row]),
            as_single(rise), as_single(edge.length[row]), slice(first, second), slice(second, third), slice(third, end),
            as_single(normal[:, 0]), as_single(-normal[:, 2]), as_single(half_bend[:, None] * axial),
            wrench(law.cutting), wrench(law.edge),
            unit_wrench, as_single(_is_covered(angle, point_width, 2 * half_count) * height),
        )  # fmt: skip


def _is_covered(phi: Array, width: Array, number: int) -> Floats:
    """Return which of equal parts of a turn are covered (P, number): 1 or 0.

    :param phi: (P,) centre of the covered interval [rad].
    :param width: (P,) its width [rad].
    """
    middle = (np.arange(number) + 0.5) * (2.0 * np.pi / number)
    angle = np.abs((middle - phi[:, None] + np.pi) % (2.0 * np.pi) - np.pi)
    return np.asarray(angle < 0.5 * width[:, None] - 1e-9, dtype=np.float32)
