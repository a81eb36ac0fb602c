"""Where the tip of a tool is when the tool touches a facet, and the place of the path that touches.

With corner radius r, radius R, spindle direction a, outward normal n, and m the part of n square to a, a tool touches a
facet at x if its tip is at x + r·n + (R − r)·m/|m| − r·a. On a level face (m = 0) it may be anywhere within R − r of
that, on a wall also below.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from postproc.frames import Array, norm
from postproc.machining.tool import Cutter
from postproc.program import Bools, Ints
from postproc.report.surface.path import CutPath

LONG = 4.0
"""Length of a tool above its tip, in radii (assumed)."""
OVERHANG = -0.05
"""Facets whose normal points away from the spindle by more (cosine) are not cut from above (assumed)."""
FLAT, UPRIGHT = 1e-3, 0.999
"""Faces are level or walls if the part of their normal square to the spindle is smaller or larger (assumed)."""
_CONTACT_SHARE = 0.35
"""Share of the tool's radius, and at least `_LEAST_CONTACT` [m], by which the path may pass next to the place of
contact: the next pass is never further than that where a surface is finished."""
_LEAST_CONTACT = 3e-4
"""For small tools, whose share would be less than what passes are apart (assumed)."""
_LEVEL = 1e-6
"""The tip is not above what its side touches [m] (assumed)."""
_REACH = 0.025
"""Tools of unknown shape have a radius of at most this [m]. The nearest place counts from which one can touch."""
_PASS_HEIGHT = 5e-4
"""Passes next to the place of contact may be this much higher or lower, or further in [m] (assumed)."""
_STEEP = 0.7
"""Moves that are steeper (cosine to the spindle), plunges, leave no faces that are less steep (assumed)."""
_CANDIDATES = 96
"""Samples of the path looked at for each facet: 1 cm on either side where there is one pass."""


def touching_tips(axis: Array, centre: Array, normal: Array, cutter: Cutter) -> Array:
    """Return the tip positions (n, 3) [m] at which the tool touches facets at their centres.

    :param axis: (n, 3) unit vectors from the tip to the spindle.
    :param centre: (n, 3) centres of the facets [m], `normal` (n, 3) their outward normals.
    """
    across_axis = normal - np.einsum("ni,ni->n", normal, axis)[:, None] * axis
    width = norm(across_axis)
    m = across_axis / np.where(width > FLAT, width, 1.0)[:, None]
    m[width <= FLAT] = 0.0
    return np.asarray(centre + cutter.corner * (normal - axis) + (cutter.radius - cutter.corner) * m)


def contact_tolerance(cutter: Cutter) -> float:
    """Return the largest distance [m] of the path from the place of contact at which the tool counts as touching."""
    return max(_LEAST_CONTACT, _CONTACT_SHARE * cutter.radius)


def is_touching(from_contact: Array, axis: Array, normal: Array, cutter: Cutter) -> Bools:
    """Return whether tools count as touching facets (n,): level ones, walls and others by rules of their own.

    :param from_contact: (n, 3) tips relative to the place of contact [m].
    :param axis: (n, 3) unit vectors from the tip to the spindle, `normal` (n, 3) outward normals.
    """
    up = np.einsum("ni,ni->n", normal, axis)
    width = np.sqrt(np.maximum(1.0 - up**2, 0.0))
    height = np.einsum("ni,ni->n", from_contact, axis)
    lateral = norm(from_contact - height[:, None] * axis)
    limit = contact_tolerance(cutter)
    on_level = (np.abs(height) <= limit) & (lateral <= cutter.radius - cutter.corner + limit)
    on_wall = (height <= _LEVEL) & (height >= -LONG * cutter.radius) & (lateral <= limit)
    is_level, is_wall = (up > 0.0) & (width <= FLAT), width >= UPRIGHT
    return np.asarray(np.where(is_level, on_level, np.where(is_wall, on_wall, np.hypot(height, lateral) <= limit)))


class NearestPlace(NamedTuple):
    """Places of the path from which a tool can touch n facets.

    :param row: (n,) of the result, at the end of the piece; −1: none.
    :param share: (n,) of that piece.
    :param distance: (n,) of the tip from the centre of the facet [m]; infinite without a place.
    """

    row: Ints
    share: Array
    distance: Array


def nearest_place(path: CutPath, centre: Array, normal: Array) -> NearestPlace:
    """Return the nearest place of the path from which a tool of any shape can touch each of n facets.

    :param centre: (n, 3) centres of the facets [m], `normal` (n, 3) their outward normals.
    """
    _, nearest = path.tree.query(centre)
    axis = path.axis[nearest]  # one spindle direction for all candidates of a facet: it changes little between them
    up = np.einsum("ni,ni->n", normal, axis)
    _, candidates = path.tree.query(centre, k=min(_CANDIDATES, len(path.point)))
    candidates = candidates.reshape(len(centre), -1)
    point, step_share = path.nearest_points(centre, candidates)
    from_centre = point - centre[:, None]
    height = np.einsum("nki,ni->nk", from_centre, axis)
    outward_distance = np.einsum("nki,ni->nk", from_centre, normal)
    distance = np.linalg.norm(from_centre, axis=-1)
    can_touch = (distance <= _REACH) & _can_touch(height, outward_distance, up[:, None])
    step = path.step[candidates]
    # 1e-300 keeps zero out of the denominator
    climb = np.abs(np.einsum("nki,ni->nk", step, axis)) / np.maximum(np.linalg.norm(step, axis=-1), 1e-300)
    can_touch &= (climb <= _STEEP) | (up <= _STEEP)[:, None]
    distance = np.where(can_touch, distance, np.inf)
    facets, best = np.arange(len(centre)), np.argmin(distance, axis=1)
    sample, smallest = candidates[facets, best], distance[facets, best]
    row = np.where(np.isfinite(smallest), path.row[sample], -1)
    share = path.share[sample] + step_share[facets, best] * path.share_step[sample]
    return NearestPlace(row, share, smallest)


def _can_touch(height: Array, outward_distance: Array, up: Array) -> Bools:
    """Return whether a tool of any shape, of a radius up to `_REACH`, can touch facets with its tip at places (n, k).

    The tip is outside of the facet, and lower than it by r (1 − n·a) at most, see above.

    :param height: (n, k) of the tip above the facet along the spindle [m].
    :param outward_distance: (n, k) of the tip from the facet along the normal [m].
    :param up: (n, 1) cosine between normal and spindle.
    """
    reachable = (height <= _PASS_HEIGHT) & (outward_distance >= -_PASS_HEIGHT) & (up >= OVERHANG)
    return np.asarray(reachable & (height >= -_REACH * (1.0 - up) - _PASS_HEIGHT))
