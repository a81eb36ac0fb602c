"""The shape of a milling cutter, and the edge of its teeth as sample points within a turn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.frames import Array
from postproc.machining.material import CuttingLaw, Floats
from postproc.program import Bools, Ints

BOTTOM, CORNER, SIDE = range(3)
"""Values of `Edge.part`: the end face of a flat or bull tool, the round of a ball or bull tool, the cylinder."""
_RINGS = 3
"""Smallest number of rings of a flat face (assumed)."""
_CORNER_SLICES = 8
"""Smallest number of slices of a rounded corner (assumed)."""
_MOST_SLICES = 160
"""Largest number of slices of an edge: time grows with it (assumed)."""


class Cutter(Struct, frozen=True):
    """A milling cutter: a cylinder with a rounded corner.

    :param radius: radius of the cylinder [m].
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
        """The shape of the end of the tool: "flat", "ball" or "bull"."""
        if self.corner == 0.0:
            return "flat"
        return "ball" if self.corner >= self.radius * (1.0 - 1e-9) else "bull"

    def lower_side(self, distance: Array) -> Array:
        """Return the heights of the lower side of the tool above its tip [m], in the shape of `distance`.

        :param distance: distances from the axis of the tool [m]; beyond the radius the height is that at the radius.
        """
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
    :param kappa: (S,) angle between the axis and the normal of the cut surface in the middle of the piece [rad]: 90° on
        the cylinder, 0 on the end face.
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
    """Return the edge of a cutter in pieces about `step` [m] long: of the end face, of the corner, of the cylinder.

    The cylinder is one piece without an upper end. A drill has no cylinder: it cuts with its end only.
    """
    part_edges = []
    if cutter.radius > cutter.corner:
        part_edges.append(_face_edge(cutter, step))
    if cutter.corner > 0.0:
        part_edges.append(_corner_edge(cutter, step))
    if not cutter.drill:
        side = {
            "radius": cutter.radius,
            "low": cutter.corner,
            "rise": np.inf,
            "length": 1.0,
            "kappa": 0.5 * np.pi,
            "bend": 0.0,
        }
        part_edges.append(Edge(part=np.array([SIDE]), **{name: np.array([value]) for name, value in side.items()}))
    part = np.concatenate([part_edge.part for part_edge in part_edges]).astype(np.int64)
    return Edge(part, *(np.concatenate([getattr(part_edge, name) for part_edge in part_edges]) for name in _COLUMNS))


def _face_edge(cutter: Cutter, step: float) -> Edge:
    """Return the edge on the flat end face of a cutter, in rings about `step` [m] wide."""
    flat_radius = cutter.radius - cutter.corner
    rings = max(_RINGS, min(_MOST_SLICES, int(np.ceil(flat_radius / step))))
    width, zero = flat_radius / rings, np.zeros(rings)
    radius = np.asarray((np.arange(rings) + 0.5) * width, dtype=float)
    return Edge(
        part=np.full(rings, BOTTOM),
        radius=radius,
        low=zero,
        rise=zero,
        length=np.full(rings, width),
        kappa=zero,
        bend=zero,
    )


def _corner_edge(cutter: Cutter, step: float) -> Edge:
    """Return the edge on the rounded corner of a cutter, in slices of equal angles about `step` [m] long."""
    corner = cutter.corner
    slices = max(_CORNER_SLICES, min(_MOST_SLICES, int(np.ceil(corner * 0.5 * np.pi / step))))
    bounds = np.linspace(0.0, 0.5 * np.pi, slices + 1)
    middle = 0.5 * (bounds[1:] + bounds[:-1])
    heights = corner * (1.0 - np.cos(bounds))
    radius = cutter.radius - corner + corner * np.sin(middle)
    bend = np.full(slices, 0.5 * np.pi / slices)
    length = np.full(slices, corner * 0.5 * np.pi / slices)
    return Edge(
        part=np.full(slices, CORNER),
        radius=radius,
        low=heights[:-1],
        rise=np.diff(heights),
        length=length,
        kappa=middle,
        bend=bend,
    )


def slice_cylinder(edge: Edge, step: float, height: float) -> Edge:
    """Return an edge whose cylinder is divided into pieces of about `step` [m], up to `height` above the tip [m].

    The new pieces have the part `CORNER`, with a normal square to the axis: on a tool that leans, each of them is
    compared with the stock by itself. An edge without a cylinder, that of a drill, is returned as it is.
    """
    is_side = edge.part == SIDE
    if not is_side.any():
        return edge
    low, radius = float(edge.low[is_side][0]), float(edge.radius[is_side][0])
    count = max(1, int(np.ceil((height - low) / step)))
    rise, ones = max(height - low, step) / count, np.ones(count)
    side_columns = {
        "radius": radius * ones,
        "low": low + rise * np.arange(count),
        "rise": rise * ones,
        "length": rise * ones,
        "kappa": 0.5 * np.pi * ones,
        "bend": 0.0 * ones,
    }
    end_pieces = take_pieces(edge, ~is_side)
    columns = {name: np.concatenate([getattr(end_pieces, name), column]) for name, column in side_columns.items()}
    return Edge(part=np.concatenate([end_pieces.part, np.full(count, CORNER)]), **columns)


def take_pieces(edge: Edge, pieces: NDArray[np.bool_]) -> Edge:
    """Return the pieces of an edge that are True in `pieces` (S,)."""
    return Edge(edge.part[pieces], *(getattr(edge, name)[pieces] for name in _COLUMNS))


_COLUMNS = ("radius", "low", "rise", "length", "kappa", "bend")
"""The columns of `Edge` after `part`, in order."""


DRILL_THRUST = 0.65
"""Radial by tangential coefficient of a drill: see `postproc.machining.cutting`."""
_SAMPLING = {"ball": 1.0, "flat": 1.7, "bull": 5.1}
"""Error of forces by the cells of the map, relative to that of a ball with a contact of the same area: RMS against
exact fronts on random surfaces with cells of 0.25 mm. The contact of a bull-nose tool is a strip along its corner."""
_LEAST_RIM_COSINE = 0.5
"""Mean cosine of the slope of a ball within half a cell of its rim, over √(cell / radius): the middle of that strip is
√(cell · radius) long, and cell / 2 wide seen from above."""
_LEAST_POINTS, _LEAST_RIM_POINTS = 8, 24
"""Minimum number of sample points in half a turn: on a circle, and on the rim (assumed)."""
_LEAST_COSINE = 1e-12
"""Cosines below this are 0: that of 90° is 6e-17 in floating point."""
_LEAST_CHIP_SHARE = 1e-9
"""Chips below this share of the feed per tooth are none (assumed)."""


class Turn(Struct, frozen=True, eq=False):
    """P sample points of the edge of a tooth within a turn, and the contribution of each to the wrench.

    Points are about as far apart on small circles as on the rim; points of one kind of edge are contiguous.

    :param sampling: error of forces by the cells of the height map, relative to that of a ball.
    :param least_cosine: smallest cosine of the slope that counts for that error; 1: the slope does not count.
    :param phi: (P,) angle of the turn [rad]: the middle of a part of the turn that is `width` (P,) [rad] wide.
    :param radius: (P,) distance from the axis [m].
    :param low: (P,) height of the lower end of the piece of edge above the tip [m].
    :param rise: (P,) height of the piece of edge [m]; 0 on the end face, infinite on the cylinder.
    :param length: (P,) length of the piece of edge [m]; 1 on the cylinder.
    :param bottom: slice of the points on the end face, `round` of those on the corner, `side` on the cylinder.
    :param normal_x: (P,) component of the normal of the edge along x, and `normal_down` (P,) along −z.
    :param tangent: (P, 3) half of the change of the normal along the piece of edge, outwards and up; 0 where straight.
    :param cut_wrench: (P, 6) wrench about the tip per engaged length and per chip thickness [N/m², N/m]; on the
        cylinder without the moment due to the height of the force.
    :param rub_wrench: (P, 6) wrench about the tip per engaged length, of the edge forces [N/m, N].
    :param unit_wrench: (3, P, 6) wrench for a tangential, radial and axial coefficient of 1; (0, P, 6) if the
        coefficients have no covariance.
    :param height_share: (P, A) for each of A equal angles of the turn that the point covers, height over length of the
        piece of edge; 0 for angles that it does not cover.
    """

    law: CuttingLaw
    teeth: int
    drill: bool
    sampling: float
    least_cosine: float
    phi: Array
    width: Array
    radius: Floats
    low: Floats
    rise: Floats
    length: Floats
    bottom: slice
    round: slice
    side: slice
    normal_x: Floats
    normal_down: Floats
    tangent: Floats
    cut_wrench: Floats
    rub_wrench: Floats
    unit_wrench: Floats
    height_share: Floats

    @classmethod
    def of(cls, edge: Edge, cutter: Cutter, law: CuttingLaw, step: float, descent: float | None) -> Turn:
        """Return the sample points of a turn, about `step` [m] apart on the rim, and their wrenches.

        :param descent: sine of the steepest downward angle of the feed, < 0 upward: points without a possible chip
            are omitted. None: the tool turns, and any point may have one.
        """
        half_count = _half_turn_count(cutter, step)
        row, angle, width = _points_of_turn(edge, cutter, half_count)
        is_used = _can_have_chip(edge, row, angle, descent)
        row, angle, width = row[is_used], angle[is_used], width[is_used]
        directions, part, rise = _EdgeDirections.of(edge, row, angle), edge.part[row], edge.rise[row]
        # the moment of the height of forces on the cylinder is added later, as it depends on the contact
        z = np.where(part == CORNER, edge.low[row] + 0.5 * np.where(np.isfinite(rise), rise, 0.0), 0.0)
        point = np.stack([edge.radius[row] * np.sin(angle), edge.radius[row] * np.cos(angle), z], axis=-1)
        share = (cutter.teeth * width / (2.0 * np.pi))[:, None]  # mean number of teeth in the part of the turn

        def wrench(coefficients: Sequence[float]) -> Floats:
            """Return the wrench (P, 6) for a tangential, a radial and an axial coefficient [N/m² or N/m]."""
            force = directions.force(*coefficients, is_drill=cutter.drill)
            return _as_single(np.concatenate([force, np.cross(point, force)], axis=-1) * share)

        unit_wrench = np.zeros((0, len(row), 6), dtype=np.float32)
        if law.covariance is not None:
            unit_wrench = np.stack([wrench(unit) for unit in np.eye(3).tolist()])
        # points are in the order of `part`
        first, second, third, end = np.searchsorted(part, [BOTTOM, CORNER, SIDE, SIDE + 1]).tolist()
        height_of_length = (np.where(np.isfinite(rise), rise, 1.0) / edge.length[row])[:, None]
        return cls(
            law=law,
            teeth=cutter.teeth,
            drill=cutter.drill,
            sampling=_SAMPLING[cutter.shape],
            least_cosine=_LEAST_RIM_COSINE * float(np.sqrt(step / cutter.radius)) if cutter.shape == "ball" else 1.0,
            phi=angle,
            width=width,
            radius=_as_single(edge.radius[row]),
            low=_as_single(edge.low[row]),
            rise=_as_single(rise),
            length=_as_single(edge.length[row]),
            bottom=slice(first, second),
            round=slice(second, third),
            side=slice(third, end),
            normal_x=_as_single(directions.normal[:, 0]),
            normal_down=_as_single(-directions.normal[:, 2]),
            tangent=_as_single(0.5 * edge.bend[row][:, None] * directions.axial),
            cut_wrench=wrench(law.cutting),
            rub_wrench=wrench(law.edge),
            unit_wrench=unit_wrench,
            height_share=_as_single(_covered_parts(angle, width, 2 * half_count) * height_of_length),
        )


def _as_single(column: Array) -> Floats:
    """Return a column in single precision, contiguous in memory."""
    return np.ascontiguousarray(column, dtype=np.float32)


class _EdgeDirections(NamedTuple):
    """Unit directions (P, 3) at sample points, in the axes of `postproc.machining.cutting`.

    :param normal: normal of the cut surface, into the material.
    :param tangential: direction of the tangential force on the tool, against the motion of the tooth.
    :param axial: direction along the edge, outwards and up.
    """

    normal: Array
    tangential: Array
    axial: Array

    @classmethod
    def of(cls, edge: Edge, row: Ints, angle: Array) -> _EdgeDirections:
        """Return the directions at sample points.

        :param row: (P,) rows of the pieces of edge, and `angle` (P,) angles of the turn [rad].
        """
        sine, cosine, zero = np.sin(angle), np.cos(angle), np.zeros(len(row))
        sin_kappa, cos_kappa = _sine_and_cosine_of_kappa(edge, row)
        return cls(
            normal=np.stack([sin_kappa * sine, sin_kappa * cosine, zero - cos_kappa], axis=-1),
            tangential=np.stack([zero - cosine, sine, zero], axis=-1),
            axial=np.stack([cos_kappa * sine, cos_kappa * cosine, sin_kappa], axis=-1),
        )

    def force(self, tangential: float, radial: float, axial: float, *, is_drill: bool) -> Array:
        """Return the force on the tool (P, 3) for three coefficients [N/m² or N/m].

        The radial coefficient of a drill is `DRILL_THRUST` times the tangential one.
        """
        radial = DRILL_THRUST * tangential if is_drill else radial
        return np.asarray(tangential * self.tangential - radial * self.normal + axial * self.axial)


def _half_turn_count(cutter: Cutter, step: float) -> int:
    """Return the number of sample points in half a turn of the rim, about `step` [m] apart.

    It is a multiple of the number of teeth, so that half a tooth pitch has a whole number of points.
    """
    least_count = -(-_LEAST_RIM_POINTS // cutter.teeth)  # of half a tooth pitch, rounded up
    return cutter.teeth * max(int(np.ceil(np.pi * cutter.radius / step / cutter.teeth)), least_count)


class _TurnPoints(NamedTuple):
    """The P sample points of a turn of an edge.

    :param piece: (P,) row of the piece of edge.
    :param phi: (P,) angle of the turn [rad].
    :param width: (P,) width of the part of the turn whose middle is the point [rad].
    """

    piece: Ints
    phi: Array
    width: Array


def _points_of_turn(edge: Edge, cutter: Cutter, half_count: int) -> _TurnPoints:
    """Return the sample points of a turn.

    A piece on the rim has 2 · `half_count` points. A piece on a smaller circle has this number divided by a power of 2,
    so that its points are about as far apart as those on the rim, but at least `_LEAST_POINTS` in half a turn.
    """
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
    return _TurnPoints(np.concatenate(piece), np.concatenate(phi), np.concatenate(width))


def _can_have_chip(edge: Edge, row: Ints, angle: Array, descent: float | None) -> Bools:
    """Return True for sample points (P,) that can have a chip; for all points if none can, or if the feed is not known.

    :param row: (P,) rows of the pieces of edge, and `angle` (P,) angles of the turn [rad].
    :param descent: sine of the steepest downward angle of the feed; None: not known.
    """
    all_points = np.ones(len(row), dtype=bool)
    if descent is None:
        return all_points
    sine, level = np.sin(angle), np.sqrt(1.0 - descent**2)
    sin_kappa, cos_kappa = _sine_and_cosine_of_kappa(edge, row)
    # the chip is the component of the feed, of length 1, along the normal; this turns by `bend` along a piece
    chip_in_middle = sin_kappa * sine * level + cos_kappa * descent
    chip_per_kappa = cos_kappa * sine * level - sin_kappa * descent
    largest_chip = chip_in_middle + 0.5 * edge.bend[row] * np.abs(chip_per_kappa)  # at one end of the piece
    can_have_chip = largest_chip > _LEAST_CHIP_SHARE
    return can_have_chip if can_have_chip.any() else all_points


def _sine_and_cosine_of_kappa(edge: Edge, row: Ints) -> tuple[Array, Array]:
    """Return the sine (P,) and the cosine (P,) of `Edge.kappa` of the pieces of edge `row` (P,)."""
    cosine = np.cos(edge.kappa)[row]
    return np.sin(edge.kappa)[row], np.where(np.abs(cosine) < _LEAST_COSINE, 0.0, cosine)


def _covered_parts(phi: Array, width: Array, part_count: int) -> Floats:
    """Return 1 for equal parts of a turn whose middles are in an interval of angles, 0 for the others: (P, part_count).

    :param phi: (P,) centres of the intervals [rad], and `width` (P,) their widths [rad].
    :param part_count: number of equal parts of the turn.
    """
    middle = (np.arange(part_count) + 0.5) * (2.0 * np.pi / part_count)
    # differences are from −π to π, also over the start of the turn
    distance = np.abs((middle - phi[:, None] + np.pi) % (2.0 * np.pi) - np.pi)
    return np.asarray(distance < 0.5 * width[:, None], dtype=np.float32)
