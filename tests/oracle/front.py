"""Mean milling forces along a path in a plane, exact in geometry: no map, no cells, no grouping of moves.

A point of the cylinder at an angle is in material if it is in the stock and farther than the radius from all of the
path before. The teeth at that angle make the average force of the linear edge-force model. Shares no code with the
package. Units: mm, N. The tool turns clockwise seen from the spindle (M3).
"""

from __future__ import annotations

import math

import numpy as np


class Path:
    """A polyline in the plane: points (n + 1, 2), of which some segments cut; a row number of the move for each."""

    def __init__(self, points, move):
        self.points, self.move = np.asarray(points, float), np.asarray(move)
        chord = np.diff(self.points, axis=0)
        self.length = np.linalg.norm(chord, axis=1)
        self.unit = chord / self.length[:, None]


def forces(path, radius, teeth, depth, per_tooth, k, in_stock, places, angles=240):
    """Return mean forces (m, 3) in the axes of the plane and up, at places (segment, share of it).

    :param per_tooth: of each segment; k: (Ktc, Kte, Krc, Kre, Kac, Kae) [N/mm², N/mm].
    :param in_stock: of points (n, 2): is there material before the first cut?
    """
    ktc, kte, krc, kre, kac, kae = k
    phi = (np.arange(angles) + 0.5) * math.pi / angles  # the front half: from the left of the travel to its right
    out = np.zeros((len(places), 3))
    for row, (segment, share) in enumerate(places):
        unit = path.unit[segment]
        left = np.array([-unit[1], unit[0]])
        centre = path.points[segment] + share * path.length[segment] * unit
        outward = np.sin(phi)[:, None] * unit + np.cos(phi)[:, None] * left
        point = centre + radius * outward
        inside = in_stock(point)
        inside[inside] = ~_cut(path, segment, share, point[inside], radius)
        if not inside.any():
            continue
        chip = per_tooth[segment] * np.sin(phi[inside])
        tangential, radial, axial = ktc * chip + kte, krc * chip + kre, kac * chip + kae
        moves = np.cos(phi[inside])[:, None] * unit - np.sin(phi[inside])[:, None] * left
        plane = -tangential[:, None] * moves - radial[:, None] * outward[inside]
        share_of_turn = teeth * depth / (2.0 * angles)
        out[row, :2] = plane.sum(axis=0) * share_of_turn
        out[row, 2] = axial.sum() * share_of_turn
    return out


def area(path, radius, box, step=0.05):
    """Return the area of a box ((x0, x1), (y0, y1)) that is within the radius of the path: by lines along x."""
    (x0, x1), (y0, y1) = box
    total = 0.0
    begin, end = path.points[:-1], path.points[1:]
    along, normal = path.unit * path.length[:, None], np.stack([-path.unit[:, 1], path.unit[:, 0]], axis=-1)
    for y in np.arange(y0 + 0.5 * step, y1, step):
        low, high = np.full(len(begin), np.inf), np.full(len(begin), -np.inf)
        for centre in (begin, end):
            square = radius**2 - (y - centre[:, 1]) ** 2
            half = np.sqrt(np.maximum(square, 0.0))
            low = np.where(square > 0.0, np.minimum(low, centre[:, 0] - half), low)
            high = np.where(square > 0.0, np.maximum(high, centre[:, 0] + half), high)
        for side in (-radius, radius):  # the straight edges of the way of the disc
            corner = begin + side * normal
            with np.errstate(divide="ignore", invalid="ignore"):
                share = (y - corner[:, 1]) / along[:, 1]
            x = corner[:, 0] + share * along[:, 0]
            crosses = (share >= 0.0) & (share <= 1.0)
            low, high = np.where(crosses, np.minimum(low, x), low), np.where(crosses, np.maximum(high, x), high)
        low, high = np.maximum(low, x0), np.minimum(high, x1)
        order = np.argsort(low[high > low])
        low, high = low[high > low][order], high[high > low][order]
        if len(low):
            reached = np.maximum.accumulate(high)
            total += step * np.sum(np.maximum(high - np.maximum(low, np.concatenate([[-np.inf], reached[:-1]])), 0.0))
    return total


def _cut(path, segment, share, point, radius, slack=1e-7):
    """Which points are within the radius of the path before a place."""
    begin, unit, length = path.points[:segment], path.unit[:segment], path.length[:segment]
    begin = np.vstack([begin, path.points[segment]])
    unit = np.vstack([unit, path.unit[segment]])
    length = np.append(length, share * path.length[segment])
    middle = 0.5 * (path.points[segment] + path.points[segment + 1])
    near = np.linalg.norm(begin - middle, axis=1) < 2.0 * radius + length + path.length[segment] + 1.0
    begin, unit, length = begin[near], unit[near], length[near]
    off = point[:, None] - begin
    along = np.clip(np.einsum("nki,ki->nk", off, unit), 0.0, length)
    away = off - along[..., None] * unit
    return (np.einsum("nki,nki->nk", away, away) < (radius - slack) ** 2).any(axis=1)
