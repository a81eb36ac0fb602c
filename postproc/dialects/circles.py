"""Circles of programs: through three points, and about an axis."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.frames import Array, norm
from postproc.program import Bools

_FLATNESS_TOLERANCE = 1e-9
"""Three points lie on a line if the height of their triangle is less than this share of its longest side (assumed)."""
TOLERANCE_MM = 0.02 * np.sqrt(2.0)
"""Difference of radii that is accepted [mm], as for G-code by LinuxCNC; beyond it 0.1 % of the radius."""
_RADIUS_TOLERANCE = 1e-3
"""Share of the radius by which radii may differ, as for LinuxCNC."""
_COINCIDENCE_TOLERANCE_MM = 1e-6
"""Start and end of a full circle coincide if their distance is less than this: it is rounding."""
_MIN_RADIUS_MM = 1e-3
"""A circle with a smaller radius is the rounding of one point."""
_SPACING_TOLERANCE = 0.02
"""Points are evenly spaced if the angles between them differ by less than this share of their mean (assumed)."""
_TURN_TOLERANCE = 1e-3
"""Share by which an arc of points may exceed a whole turn, because their coordinates are rounded."""
_OFF_CIRCLE_FACTOR = 100.0
"""A point is not of the arc if it is this many times as far from the circle as the start and first point (assumed)."""
_MIN_TANGENT_SINE = 0.99
"""Sine of the angle between radius and tangent; 8° are more than the rounding of coordinates (assumed)."""


class ArcColumns(NamedTuple):
    """Arcs of motions in `$BASE`; NaN for motions without an arc.

    :ivar centre: (M, 3) [m]; `normal`: (M, 3) unit axes; `sweep`: (M,) angles about them [rad].
    """

    centre: Array
    normal: Array
    sweep: Array

    @classmethod
    def unset(cls, count: int) -> ArcColumns:
        """Return the columns of motions without an arc, to be filled in."""
        return cls(np.full((count, 3), np.nan), np.full((count, 3), np.nan), np.full(count, np.nan))


class ArcsThroughPoints(NamedTuple):
    """Arcs through three points each.

    :ivar centre: (n, 3) [m]; `normal`: (n, 3) unit axes; `sweep`: (n,) angles about them > 0 [rad].
    :ivar is_flat: (n,) True where the points are on a straight line, or two of them coincide: there is no circle.
    """

    centre: Array
    normal: Array
    sweep: Array
    is_flat: Bools


def arcs_through(start: Array, via: Array, end: Array) -> ArcsThroughPoints:
    """Return the arcs from `start` through `via` to `end`, (n, 3) each [m].

    Centre: circumcentre of the triangle, c = s + ((v·v) e − (e·e) v) × (v × e) / (2 |v × e|²), v and e seen from s.
    """
    to_via, to_end = via - start, end - start
    # squared lengths
    via_square, end_square, chord_square = (np.einsum("ni,ni->n", v, v) for v in (to_via, to_end, to_end - to_via))
    cross = np.cross(to_via, to_end)
    size = np.linalg.norm(cross, axis=1)
    longest_square = np.maximum(np.maximum(via_square, end_square), chord_square)
    is_flat = ~(size > _FLATNESS_TOLERANCE * longest_square)  # size is height times base; NaN counts as flat
    size = np.where(is_flat, 1.0, size)
    centre = (
        start + np.cross(via_square[:, None] * to_end - end_square[:, None] * to_via, cross) / (2.0 * size**2)[:, None]
    )
    normal = cross / size[:, None]
    start_vector, end_vector = start - centre, end - centre
    sine = np.einsum("ni,ni->n", np.cross(start_vector, end_vector), normal)
    angle = np.arctan2(sine, np.einsum("ni,ni->n", start_vector, end_vector))
    sweep = np.where(angle > 0.0, angle, angle + 2.0 * np.pi)
    return ArcsThroughPoints(centre, normal, sweep, is_flat)


class Circle(Struct, frozen=True, eq=False):
    """A circle in the program frame [mm].

    :param centre: (3,) a point on the axis.
    :param axis: (3,) unit vector about which the tool turns right-handed.
    :param radius: radius that the program states [mm].
    """

    centre: Array
    axis: Array
    radius: float

    def polar_components(self, point: Array) -> tuple[Array, float]:
        """Return the vector (3,) from the axis to a point (3,), at right angles to the axis, and its length [mm]."""
        radial = point - self.centre
        radial = radial - self.axis * (self.axis @ radial)
        return radial, float(norm(radial))

    def fault_at(self, point: Array) -> str | None:
        """Return the reason that a point (3,) is not on the circle, or None if it is on it."""
        _, length = self.polar_components(point)
        deviation = abs(length - self.radius)
        if self.radius < _MIN_RADIUS_MM or deviation > max(TOLERANCE_MM, _RADIUS_TOLERANCE * self.radius):
            return f"{length:.4f} mm from the axis of a circle with radius {self.radius:.4f} mm"
        return None

    def sweep(self, start: Array, end: Array) -> float:
        """Return the angle from `start` (3,) to `end` (3,) [rad], in (0, 2π]; 2π if the points coincide."""
        (start_vector, _), (end_vector, _) = self.polar_components(start), self.polar_components(end)
        if norm(end_vector - start_vector) <= _COINCIDENCE_TOLERANCE_MM:
            return 2.0 * np.pi
        angle = float(np.arctan2(self.axis @ np.cross(start_vector, end_vector), start_vector @ end_vector))
        return angle if angle > 0.0 else angle + 2.0 * np.pi

    def sagitta(self, start: Array, end: Array) -> float:
        """Return the largest distance between the arc from `start` (3,) to `end` (3,) and its chord [mm]."""
        return float(self.radius * (1.0 - np.cos(self.sweep(start, end) / 2.0)))

    def centre_at_height(self, point: Array) -> Array:
        """Return the point (3,) of the axis that is nearest to a point (3,)."""
        radial, _ = self.polar_components(point)
        return np.asarray(point - radial)


def tangent_circle(start: Array, direction: Array, centre: Array, radius: float) -> Circle | None:
    """Return the circle about a centre (3,) on which the tool leaves a start (3,) along a direction (3,).

    None if the direction is more than 8° from the tangent, or has no length, or if start and centre coincide.

    :param radius: radius that the program states [mm].
    """
    axis = np.cross(start - centre, direction)
    size = float(norm(axis))
    largest_size = float(norm(start - centre)) * float(norm(direction))
    if largest_size == 0.0 or size < _MIN_TANGENT_SINE * largest_size:
        return None
    return Circle(centre, axis / size, radius)


def arc_point_count(circle: Circle, start: Array, points: Array, digit_mm: float) -> int | None:
    """Return the number of points after a CIRCLE that belong to its arc; None if it is ambiguous.

    The first point always belongs to the arc, and the first point off the circle ends it. The points before that one
    divide the arc in two cases:

    - they are evenly spaced, on one turn at most, as Creo writes them;
    - the chords between them leave the circle by less than the tolerance, so that arc and chords are one path.

    Else it is ambiguous: they may also be ends of straight lines that happen to be on the circle.

    :param start: (3,) start of the arc [mm], and `points` (n, 3) the points after it.
    :param digit_mm: largest rounding of a point [mm].
    """
    count = 0
    while count < len(points) and circle.fault_at(points[count]) is None:
        count += 1
    if count <= 1:
        return 1
    path = np.vstack([start[None], points[:count]])
    sweeps = np.array([circle.sweep(begin, end) for begin, end in pairwise(path)])  # from point to point [rad]
    is_off_circle = _is_off_circle(circle, path, sweeps, digit_mm)
    if is_off_circle.any():
        count = int(np.argmax(is_off_circle))
        sweeps = sweeps[:count]
    if count <= 1:
        return 1
    # the way to the first point is an arc in any case; the sagitta of the others' chords, over half a turn at most
    is_close = circle.radius * (1.0 - np.cos(np.minimum(sweeps[1:], np.pi) / 2.0)) < TOLERANCE_MM
    is_one_turn = sweeps.sum() < 2.0 * np.pi * (1.0 + _TURN_TOLERANCE)
    is_even = count > 2 and np.ptp(sweeps) < _SPACING_TOLERANCE * sweeps.mean() and is_one_turn
    return count if is_close.all() or is_even else None


def _is_off_circle(circle: Circle, path: Array, sweeps: Array, digit_mm: float) -> Bools:
    """Return which points (n,) of a path cannot belong to the arc that leads from its start to its first point.

    - Points off the helix through start and first point: a retract at the end of a full circle.
    - Points `_OFF_CIRCLE_FACTOR` times as far from the circle as start and first point, and more than `digit_mm`.

    :param path: (n + 1, 3) the start and the points [mm].
    :param sweeps: (n,) angle about the axis from each of them to the next [rad].
    :param digit_mm: largest rounding of a point [mm].
    """
    # angle of each point from the start, and its height along the axis
    total_sweep, height = np.cumsum(sweeps), (path[1:] - path[0]) @ circle.axis
    is_off_helix = np.abs(height - height[0] * total_sweep / total_sweep[0]) > TOLERANCE_MM
    lengths = (length for _, length in map(circle.polar_components, path))
    deviation = np.array([abs(length - circle.radius) for length in lengths])
    is_beside = deviation[1:] > max(digit_mm, _OFF_CIRCLE_FACTOR * float(deviation[:2].max()))
    return np.asarray(is_off_helix | is_beside)
