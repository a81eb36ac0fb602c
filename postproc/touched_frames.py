"""Frames that a controller measured by touching the part with an arm that is not where it has it at rest.

Three points that the tip touches give `$BASE`. So it contains the displacement of the arm at rest, as far as these
points move as a rigid body. Which points were touched is not known: the displacement is fitted over all cuts, and the
difference from it of that of three far points of a `$BASE` is the error of the frame.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np
from msgspec import Struct

from postproc.frames import Array, hat, inverse, norm, rigid_displacement, rotation_vector
from postproc.program import Ints, distinct

_MOST_FAR_POINTS = 8
"""Points of the cuts in each `$BASE`, far from each other, of which three may have been touched (assumed)."""
_TOUCHED_POINTS = 3
"""Points that a controller needs for a frame: origin, one on X, one on Y."""
_LEAST_AREA_SHARE = 0.5
"""Touched points span at least this share of the largest triangle (assumed): who touches takes far ones."""
_FLAT_SHARE = 1e-3
"""Share of the square of their largest distance that points span at most if they are taken for points of a line."""


class TouchedFrames(Struct, frozen=True, eq=False):
    """What frames contain of the displacement of the arm at rest; robot root, metres and radians.

    :param shift: (4, 4) displacement by which they are off.
    :param centre: (3,) of the cuts.
    :param covariance: (6, 6) of the error of that: displacement at the centre, rotation vector.
    """

    shift: Array
    centre: Array
    covariance: Array

    @classmethod
    def of(cls, points: Array, shift: Array, weight: Array, base: Ints) -> TouchedFrames:
        """Fit the displacement over points of the cuts.

        :param points: (n, 3) nominal tip at each point, robot root [m].
        :param shift: (n, 3) displacement of the tip there by the arm at rest [m].
        :param weight: (n,) weights of the points.
        :param base: (n,) row of the `$BASE` of each point in `Program.bases`.
        """
        fit = rigid_displacement(points, shift, weight)
        residual = shift - (points @ fit[:3, :3].T + fit[:3, 3] - points)
        centre = weight @ points / weight.sum()
        errors = np.concatenate(
            [_errors_by_touch(points[rows], residual[rows], centre) for rows in (base == row for row in distinct(base))]
        )
        return cls(fit, centre, errors.T @ errors / len(errors))

    def slopes(self, points: Array) -> Array:
        """Return the derivatives (n, 3, 6) of points (n, 3) [m] by the errors of the frame: displacement, rotation."""
        by_rotation = -hat(points - self.centre)  # r × (p − c) = −(p − c) × r
        by_displacement = np.broadcast_to(np.eye(3), by_rotation.shape)
        return np.concatenate([by_displacement, by_rotation], axis=2)


def _errors_by_touch(points: Array, residual: Array, centre: Array) -> Array:
    """Return the errors (m, 6) of a frame, one for each choice of three touched points.

    Each is the displacement at the centre [m] and the rotation vector [rad], robot root.

    :param points: (n, 3) of the cuts in one `$BASE` [m].
    :param residual: (n, 3) displacement of the arm at rest less that of the rigid body fitted to it [m].
    :param centre: (3,) of all cuts [m].
    """
    far_rows = _far_points(points)
    triples = np.array(list(permutations(far_rows, _TOUCHED_POINTS)), dtype=np.int64).reshape(-1, _TOUCHED_POINTS)
    edges = points[triples[:, 1:]] - points[triples[:, :1]]
    area = norm(np.cross(edges[:, 0], edges[:, 1]))
    largest_edge = norm(edges).max(initial=0.0)
    if area.max(initial=0.0) <= _FLAT_SHARE * largest_edge**2:
        # points on one line give no frame: it was touched elsewhere, and is assumed to be off by their residuals
        return np.concatenate([residual[far_rows], np.zeros((len(far_rows), 3))], axis=1)
    triples = triples[area >= _LEAST_AREA_SHARE * area.max()]
    # from the frame of the points where they are to the frame of the points as the arm touches them
    displacement = _frame_of(points[triples] + residual[triples]) @ inverse(_frame_of(points[triples]))
    rotation = displacement[:, :3, :3]
    return np.concatenate([rotation @ centre + displacement[:, :3, 3] - centre, rotation_vector(rotation)], axis=1)


def _frame_of(touched: Array) -> Array:
    """Return the frames (m, 4, 4) that three touched points (m, 3, 3) [m] give: origin, a point on X, one on Y."""
    x, y = (touched[:, k] - touched[:, 0] for k in (1, 2))
    z = np.cross(x, y)
    axes = [axis / norm(axis)[:, None] for axis in (x, np.cross(z, x), z)]
    frame = np.zeros((len(touched), 4, 4))
    frame[:, :3, :3], frame[:, :3, 3], frame[:, 3, 3] = np.stack(axes, axis=2), touched[:, 0], 1.0
    return frame


def _far_points(points: Array) -> list[int]:
    """Return up to `_MOST_FAR_POINTS` rows of points (n, 3), each the farthest from those before it."""
    distance = norm(points - points.mean(axis=0))
    rows: list[int] = []
    while len(rows) < _MOST_FAR_POINTS and distance.max() > 0.0:
        rows.append(int(np.argmax(distance)))
        to_last = norm(points - points[rows[-1]])
        distance = to_last if len(rows) == 1 else np.minimum(distance, to_last)
    return rows or [0]
