"""Where the tip of a tool is when the tool touches a facet, and the place of the path that touches.

With corner radius r, radius R, spindle direction a, outward normal n, and m the component of n square to a, a tool
touches a facet at x if its tip is at x + r·n + (R − r)·m/|m| − r·a. On a level face (m = 0) it may be anywhere within
R − r of that, on a wall also below.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from postproc.frames import Array, norm
from postproc.machining.tool import Cutter
from postproc.program import Bools, Ints
from postproc.report.surface.path import CutPath

LENGTH_IN_RADII = 4.0
"""Length of a tool above its tip, in radii (assumed)."""
LEAST_COSINE = -0.05
"""Smallest cosine of normal and spindle at which a facet can be cut from above (assumed)."""
LEVEL_SINE, WALL_SINE = 1e-3, 0.999
"""Sine of the angle of normal and spindle: facets are level below the first, walls above the second (assumed)."""
_CONTACT_SHARE = 0.35
"""Share of the tool's radius by which the path may be off the place of contact: finishing passes are closer together.

It is at least `_LEAST_CONTACT`."""
_LEAST_CONTACT = 3e-4
"""Smallest value of that distance [m], for small tools, whose passes are farther apart than the share (assumed)."""
_WALL_HEIGHT_TOLERANCE = 1e-6
"""Height [m] up to which the tip may be above the place of a wall that its side touches (assumed)."""
_MOST_RADIUS = 0.025
"""Largest radius of a tool of unknown shape [m] (assumed)."""
_PASS_TOLERANCE = 5e-4
"""Length [m] by which the tip of a tool of unknown shape may be above, below or inside its contact (assumed)."""
_STEEP_COSINE = 0.7
"""Cosine to the spindle above which a move is a plunge, and a facet is not steep: plunges leave none (assumed)."""
_MOST_CANDIDATES = 96
"""Number of samples of the path that are examined for each facet: 1 cm on either side if there is one pass."""


def touching_tips(axis: Array, centre: Array, normal: Array, cutter: Cutter) -> Array:
    """Return the tip positions (n, 3) [m] at which the tool touches facets at their centres, see the module docstring.

    :param axis: (n, 3) unit vectors from the tip to the spindle.
    :param centre: (n, 3) centres of the facets [m], `normal` (n, 3) their outward normals.
    """
    across_axis = normal - np.einsum("ni,ni->n", normal, axis)[:, None] * axis
    width = norm(across_axis)
    m = across_axis / np.where(width > LEVEL_SINE, width, 1.0)[:, None]
    m[width <= LEVEL_SINE] = 0.0
    return np.asarray(centre + cutter.corner * (normal - axis) + (cutter.radius - cutter.corner) * m)


def contact_tolerance(cutter: Cutter) -> float:
    """Return the largest distance of the path from the place of contact [m] at which the tool counts as touching."""
    return max(_LEAST_CONTACT, _CONTACT_SHARE * cutter.radius)


def is_touching(from_contact: Array, axis: Array, normal: Array, cutter: Cutter) -> Bools:
    """Return whether tools count as touching facets (n,).

    Level facets: the tip is at their height, and they are under the flat of the tool.
    Walls: the tip is beside them or lower, within the length of the tool.
    Other facets: the tip is at the place of contact. All up to `contact_tolerance`.

    :param from_contact: (n, 3) tips relative to the place of contact [m].
    :param axis: (n, 3) unit vectors from the tip to the spindle.
    :param normal: (n, 3) outward normals of the facets.
    """
    cosine = np.einsum("ni,ni->n", normal, axis)
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    height = np.einsum("ni,ni->n", from_contact, axis)  # of the tip over the place of contact, along the spindle
    lateral = norm(from_contact - height[:, None] * axis)
    limit = contact_tolerance(cutter)
    on_level = (np.abs(height) <= limit) & (lateral <= cutter.radius - cutter.corner + limit)
    on_wall = (height <= _WALL_HEIGHT_TOLERANCE) & (height >= -LENGTH_IN_RADII * cutter.radius) & (lateral <= limit)
    is_level, is_wall = (cosine > 0.0) & (sine <= LEVEL_SINE), sine >= WALL_SINE
    return np.asarray(np.where(is_level, on_level, np.where(is_wall, on_wall, np.hypot(height, lateral) <= limit)))


class NearestPlace(NamedTuple):
    """Places of the path from which a tool can touch n facets.

    :param row: (n,) row of the result at the end of the piece of path; −1: no tool can touch the facet.
    :param share: (n,) share of that piece from its start to the place.
    :param distance: (n,) distance of the tip from the centre of the facet [m]; infinite without a place.
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
    cosine = np.einsum("ni,ni->n", normal, axis)  # between normal and spindle
    # facets on the first axis of the arrays, their candidates on the second
    _, candidates = path.tree.query(centre, k=min(_MOST_CANDIDATES, len(path.point)))
    candidates = candidates.reshape(len(centre), -1)
    point, step_share = path.nearest_points(centre, candidates)
    from_centre = point - centre[:, None]
    height = np.einsum("nki,ni->nk", from_centre, axis)
    outward_distance = np.einsum("nki,ni->nk", from_centre, normal)
    distance = np.linalg.norm(from_centre, axis=-1)
    can_touch = (distance <= _MOST_RADIUS) & _can_touch(height, outward_distance, cosine[:, None])
    step = path.step[candidates]
    # 1e-300 keeps zero out of the denominator
    step_cosine = np.abs(np.einsum("nki,ni->nk", step, axis)) / np.maximum(np.linalg.norm(step, axis=-1), 1e-300)
    is_plunge = step_cosine > _STEEP_COSINE
    can_touch &= ~is_plunge | (cosine <= _STEEP_COSINE)[:, None]
    distance = np.where(can_touch, distance, np.inf)
    facets, best = np.arange(len(centre)), np.argmin(distance, axis=1)
    sample, smallest = candidates[facets, best], distance[facets, best]
    row = np.where(np.isfinite(smallest), path.row[sample], -1)
    share = path.share[sample] + step_share[facets, best] * path.share_step[sample]
    return NearestPlace(row, share, smallest)


def _can_touch(height: Array, outward_distance: Array, cosine: Array) -> Bools:
    """Return whether tools of any shape, of a radius up to `_MOST_RADIUS`, can touch n facets from k places each.

    The tip must be outside of the facet, and lower than it by r (1 − n·a) at most, see the module docstring.

    :param height: (n, k) height of the tip above the facet along the spindle [m].
    :param outward_distance: (n, k) distance of the tip from the facet along the normal [m].
    :param cosine: (n, 1) cosine between normal and spindle.
    """
    is_reachable = (height <= _PASS_TOLERANCE) & (outward_distance >= -_PASS_TOLERANCE) & (cosine >= LEAST_COSINE)
    return np.asarray(is_reachable & (height >= -_MOST_RADIUS * (1.0 - cosine) - _PASS_TOLERANCE))
