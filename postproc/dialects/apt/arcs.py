"""Arcs of cutter-location files: which way they turn, and how far.

- ``CIRCLE/x,y,z,i,j,k,r`` turns right-handed about i, j, k. Source: PTC, Creo NC, "CL Output for Circular
  Interpolation".
- ``CIRCLE/x,y,z,i,j,k,r,t,f,d,e`` of Siemens NX turns *clockwise* about i, j, k (t, f: tolerances; d, e: the tool).
  Source: the NX documentation of the CLSF Manager, and CLSF files with rounded corners.
- ``MOVARC/x,y,z,i,j,k,r,ANGLE,a`` turns right-handed by a [deg]. Source: Autodesk's post "Common ISO 4343 APT".
- ``INDIRV/i,j,k`` and ``TLON,GOFWD/(CIRCLE/x,y,z,r),ON,(LINE/…)`` of CATIA and Creo (APT_FORMAT) turn so that they
  leave the start along i, j, k. The line leads from the centre to the end. ``ON,2,INTOF`` is the end
  beyond half a turn.

The end is that of the GOTO that follows, or of the line. Heights of start and end along the axis may differ: a helix.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from msgspec import Struct

from postproc.frames import Array, norm

TOLERANCE_MM = 0.02 * np.sqrt(2.0)
"""Difference of radii that is accepted [mm], as for G-code by LinuxCNC; beyond it 0.1 % of the radius."""
_RELATIVE = 1e-3
_SAME_MM = 1e-6
_LEAST_MM = 1e-3


class Circle(Struct, frozen=True, eq=False):
    """A circle in the program frame [mm].

    :param centre: (3,) at any height along the axis.
    :param axis: (3,) unit vector about which the tool turns right-handed.
    :param radius: as stated.
    """

    centre: Array
    axis: Array
    radius: float

    def polar(self, point: Array) -> tuple[Array, float]:
        """Return the component of a point (3,) across the axis, seen from the centre (3,), and its length."""
        radial = point - self.centre
        radial = radial - self.axis * (self.axis @ radial)
        return radial, float(norm(radial))

    def fault_at(self, point: Array) -> str | None:
        """Return why a point (3,) is not on the circle, or None if it is."""
        length = self.polar(point)[1]
        off = abs(length - self.radius)
        if self.radius < _LEAST_MM or off > max(TOLERANCE_MM, _RELATIVE * self.radius):
            return f"{length:.4f} mm from the axis of a circle with radius {self.radius:.4f} mm"
        return None

    def sweep(self, start: Array, end: Array) -> float:
        """Return the angle from one point (3,) to another [rad], in (0, 2π]."""
        one, other = self.polar(start)[0], self.polar(end)[0]
        if norm(other - one) <= _SAME_MM:
            return 2.0 * np.pi
        angle = float(np.arctan2(self.axis @ np.cross(one, other), one @ other))
        return angle if angle > 0.0 else angle + 2.0 * np.pi

    def at_height_of(self, point: Array) -> Array:
        """Return the centre (3,) at the height of a point."""
        return np.asarray(point - self.polar(point)[0])


def leaving(start: Array, direction: Array, centre: Array, radius: float) -> Circle | None:
    """Return the circle that leaves a start along a direction (3,), or None if there is none."""
    axis = np.cross(start - centre, direction)
    size = float(norm(axis))
    across = float(norm(start - centre)) * float(norm(direction))
    if across == 0.0 or size < 0.99 * across:
        return None
    return Circle(centre, axis / size, radius)


def belonging(circle: Circle, start: Array, points: Array) -> int | None:
    """Return how many points (n, 3) after a CIRCLE belong to its arc; None if that is ambiguous.

    Creo divides an arc by points on it, evenly spaced. A straight line whose end happens to be on the circle must not
    be taken for a piece of the arc.
    """
    count = 0
    while count < len(points) and circle.fault_at(points[count]) is None:
        count += 1
    if count <= 1:
        return 1
    way = np.vstack([start[None], points[:count]])
    sweeps = np.array([circle.sweep(one, other) for one, other in pairwise(way)])
    close = circle.radius * (1.0 - np.cos(np.minimum(sweeps[1:], np.pi) / 2.0)) < TOLERANCE_MM
    even = count > 2 and np.ptp(sweeps) < 0.02 * sweeps.mean() and sweeps.sum() < 2.0 * np.pi * 1.001
    return count if close.all() or even else None
