"""Reference points that come out far from where the experiment states them in the flange frame.

Readings without load determine the points, whatever the stated guesses are. But A6 with another zero turns all of them
about the flange axis and leaves no residual, while load point and payload stay where they are stated.
"""

from __future__ import annotations

import numpy as np

from postproc.errors import first_of
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm
from postproc.identification.fit import LENGTH_95
from postproc.identification.measurement_model import Placement
from postproc.identification.readings import Measurements

_MAX_DISTANCE = 0.03
"""Distance [m] from the stated point that no careless guess has (assumed): points are stated by a ruler or a drawing,
and a wrong zero of A6 or a wrong frame moves them by decimetres."""
_MOST_NAMES = 6
"""Points that the text lists."""


def displaced_points(data: Measurements, placement: Placement) -> str:
    """Return a clause on points that are far from their stated positions in the flange frame, with what to check.

    A point is far if its distance, less its 95 % uncertainty, exceeds `_MAX_DISTANCE`. Empty if no point is far.
    """
    distance = norm(placement.points - data.guess)
    far_points = np.flatnonzero(distance - _point_uncertainty(placement) > _MAX_DISTANCE)
    if len(far_points) == 0:
        return ""
    worst = int(far_points[np.argmax(distance[far_points])])
    clause = (
        f"point {data.points[worst]} comes out at {coordinates_text(placement.points[worst])} mm in the flange frame, "
        f"{distance[worst] * MM_PER_M:.0f} mm from the stated {coordinates_text(data.guess[worst])}"
    )
    other_texts = [
        f"{data.points[index]} by {distance[index] * MM_PER_M:.0f} mm"
        for index in far_points.tolist()
        if index != worst
    ]
    if other_texts:
        clause += f" ({first_of(other_texts, _MOST_NAMES)})"
    turn = _flange_turn(data.guess, placement.points)
    if turn is not None:
        subject = "all points are" if len(data.points) > 1 else "it is"
        clause += f"; {subject} turned by {turn * DEG_PER_RAD:.0f}° about Z of the flange frame"
    return f"{clause}: check A6, the flange frame of the stated points and of the load point, and their unit (mm)"


def _point_uncertainty(placement: Placement) -> Array:
    """Return the 95 % uncertainty (P,) of the points [m], by the residuals of the readings without load."""
    variance = np.diag(placement.covariance)[6:].reshape(-1, 3).sum(axis=1)  # after the twist of the root
    return np.asarray(LENGTH_95 * placement.rms * np.sqrt(variance))


def _flange_turn(stated: Array, points: Array) -> float | None:
    """Return the rotation [rad] about Z of the flange frame from stated to measured points.

    None if no rotation brings all stated points within `_MAX_DISTANCE` of the measured points.

    :param stated: (P, 3) stated points, and `points` (P, 3) measured points, in the flange frame [m].
    """
    plane_stated, plane_points = stated[:, :2] @ [1.0, 1.0j], points[:, :2] @ [1.0, 1.0j]  # x + i·y
    turn = np.angle(np.sum(plane_points * plane_stated.conj()))
    distance = np.hypot(np.abs(plane_points - plane_stated * np.exp(1j * turn)), points[:, 2] - stated[:, 2])
    return float(turn) if distance.max() < _MAX_DISTANCE else None


def coordinates_text(point: Array) -> str:
    """Return the coordinates of a point (3,) [m] in whole mm."""
    return ", ".join(str(round(value * MM_PER_M)) for value in point.tolist())
