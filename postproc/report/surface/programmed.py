"""Where the programmed path itself cuts into the part, and how deep.

A facet is cut into where the tool, as programmed, contains its centre. The depth is the length of the normal inside the
tool, or the distance of its end from the mesh if that is shorter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct
from scipy.spatial import cKDTree

from postproc.frames import Array
from postproc.machining.tool import Cutter
from postproc.program import Bools, Ints
from postproc.report.surface.contact import LEAST_COSINE, LENGTH_IN_RADII, touching_tips
from postproc.report.surface.path import CutPath

_PROBE_DEPTHS = (0.0, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
"""Depths [m] below a facet at which a tool that cuts into it is searched (assumed)."""
_PROBE_SAMPLES = 3
"""Number of samples of the path that are examined at each of these depths (assumed)."""
_BISECTIONS = 40
"""Halvings of an interval: to 10⁻¹² of its length."""
_NEAREST_FACETS = 8
"""Number of facets with the nearest centres, among which the nearest facet is searched (assumed)."""
_MOST_TIPS = 50_000
"""Number of tips that are tested for being inside the mesh: of longer paths each second, third … (assumed)."""


class Mesh(Struct, frozen=True, eq=False):
    """Facets of a part.

    :param corners: (F, 3, 3) three corners of each facet [m].
    :param normal: (F, 3) outward normals.
    :param tree: tree of the centres of the facets, for searches of the nearest.
    """

    corners: Array
    normal: Array
    tree: cKDTree

    @classmethod
    def of(cls, corners: Array, normal: Array) -> Mesh:
        """Return the mesh of facets with corners (F, 3, 3) [m] and outward normals (F, 3)."""
        return cls(corners, normal, cKDTree(corners.mean(axis=1)))

    def distance(self, point: Array) -> tuple[Array, Ints]:
        """Return the distances (n,) of points (n, 3) from the mesh [m], and the nearest facet (n,) of each.

        Distances are negative inside. A point whose nearest place is on an edge counts as outside: on which side of the
        mesh it is is uncertain.
        """
        _, facet = self.tree.query(point, k=min(_NEAREST_FACETS, len(self.corners)))
        facet = facet.reshape(len(point), -1)
        from_a, from_b, from_c = (point[:, None] - self.corners[facet, k] for k in range(3))
        edges = [self.corners[facet, (k + 1) % 3] - self.corners[facet, k] for k in range(3)]
        normal = self.normal[facet]
        height = _dot(from_a, normal)
        # within the prism over the facet its plane is nearest, elsewhere one of its edges
        is_within = np.ones(facet.shape, dtype=bool)
        edge_distance = np.full(facet.shape, np.inf)
        for corner, edge in zip((from_a, from_b, from_c), edges, strict=True):
            is_within &= _dot(np.cross(edge, corner), normal) >= 0.0
            # nearest place on the edge, as a share of it; 1e-300 keeps zero out of the denominator
            t = np.clip(_dot(corner, edge) / np.maximum(_dot(edge, edge), 1e-300), 0.0, 1.0)
            gap = corner - t[..., None] * edge
            edge_distance = np.minimum(edge_distance, np.sqrt(_dot(gap, gap)))
        distance = np.where(is_within, np.abs(height), edge_distance)
        rows, best = np.arange(len(point)), np.argmin(distance, axis=1)
        is_inside = is_within[rows, best] & (height[rows, best] < 0.0)
        return np.where(is_inside, -1.0, 1.0) * distance[rows, best], facet[rows, best]


def _dot(a: Array, b: Array) -> Array:
    """Return the scalar products (n, k) of vectors (n, k, 3)."""
    return np.asarray(np.einsum("nki,nki->nk", a, b))


def cut_depths(mesh: Mesh, path: CutPath, centre: Array, normal: Array, cutter: Cutter) -> tuple[Array, Ints]:
    """Return the depth by which the programmed path of a tool cuts into each of n facets, and its row of the result.

    :param centre: (n, 3) centres of the facets [m], `normal` (n, 3) their outward normals.
    :returns: (n,) depth [m], 0 without a cut; (n,) row of the result that cuts deepest, −1 without a cut.
    """
    depth, deepest_row = np.zeros(len(centre)), np.full(len(centre), -1)
    facet, row, tip, axis = _tools_inside(path, centre, normal, cutter)
    if not len(facet):
        return depth, deepest_row
    from_tip, inward = centre[facet] - tip, -normal[facet]
    # the length of the normal inside the tool by bisection: the tool is convex, so that the normal leaves it once, and
    # sooner than at twice the length of the tool
    low, high = np.zeros(len(facet)), np.full(len(facet), 2.0 * LENGTH_IN_RADII * cutter.radius)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        is_inner = _is_inside(from_tip + middle[:, None] * inward, axis, cutter)
        low, high = np.where(is_inner, middle, low), np.where(is_inner, high, middle)
    # where the normal leaves the tool, another side of the part may be nearer: thin walls are cut through
    end_distance, _ = mesh.distance(centre[facet] + low[:, None] * inward)
    facet_depth = np.minimum(low, np.abs(end_distance))
    order = np.argsort(facet_depth, kind="stable")
    depth[facet[order]], deepest_row[facet[order]] = facet_depth[order], row[order]  # the deepest is written last
    return depth, deepest_row


class _Tools(NamedTuple):
    """m tools on the path, each with a facet.

    :param facet: (m,) index of the facet.
    :param row: (m,) row of the result at the end of the piece of path.
    :param tip: (m, 3) position of the tip [m].
    :param axis: (m, 3) unit vectors from the tip to the spindle.
    """

    facet: Ints
    row: Ints
    tip: Array
    axis: Array


def _tools_inside(path: CutPath, centre: Array, normal: Array, cutter: Cutter) -> _Tools:
    """Return the m tools of the programmed path that contain the centre of a facet: candidates for the deepest cut.

    :param centre: (n, 3) centres of the facets [m], `normal` (n, 3) their outward normals.
    """
    _, nearest = path.tree.query(centre)
    tip_on_facet = touching_tips(path.axis[nearest], centre, normal, cutter)
    tools = [_tools_near(tip_on_facet - depth * normal, path, centre, normal, cutter) for depth in _PROBE_DEPTHS]
    facet, row, tip, axis = (np.concatenate(columns) for columns in zip(*tools, strict=True))
    return _Tools(facet, row, tip, axis)


def _tools_near(probe_point: Array, path: CutPath, centre: Array, normal: Array, cutter: Cutter) -> _Tools:
    """Return the tools with their tips next to probe points that contain the centre of the facet.

    :param probe_point: (n, 3) a point for each facet [m].
    :param centre: (n, 3) centres of the facets [m], `normal` (n, 3) their outward normals.
    """
    _, sample = path.tree.query(probe_point, k=min(_PROBE_SAMPLES, len(path.point)))
    sample = sample.reshape(len(centre), -1)
    tip, _ = path.nearest_points(probe_point, sample)
    axis = path.axis[sample]
    is_inside = _is_inside(centre[:, None] - tip, axis, cutter)
    is_inside &= np.einsum("nki,ni->nk", axis, normal) >= LEAST_COSINE
    facet, column = np.nonzero(is_inside)
    return _Tools(facet, path.row[sample[facet, column]], tip[facet, column], axis[facet, column])


def _is_inside(from_tip: Array, axis: Array, cutter: Cutter) -> Bools:
    """Return whether points (...) are inside the tool.

    :param from_tip: (..., 3) points relative to the tip [m].
    :param axis: (..., 3) unit vectors from the tip to the spindle.
    """
    height = np.einsum("...i,...i->...", from_tip, axis)
    distance = np.linalg.norm(from_tip - height[..., None] * axis, axis=-1)
    return np.asarray(
        (distance < cutter.radius)
        & (height > cutter.lower_side(distance))
        & (height <= LENGTH_IN_RADII * cutter.radius)
    )


def add_tip_depths(mesh: Mesh, path: CutPath, depth: Array, row: Ints) -> None:
    """Increase `depth` and set `row` in place at facets next to which a tip of the path is deeper inside the mesh.

    For tools of unknown shape, of which only the tip is known.

    :param depth: (F,) depth of the cuts in each facet [m].
    :param row: (F,) row of the result that cuts deepest.
    """
    sample_rows = slice(None, None, -(-len(path.point) // _MOST_TIPS))  # rounded up
    distance, facet = mesh.distance(path.point[sample_rows])
    tips = np.argsort(-distance, kind="stable")  # the deepest of a facet is written last
    tips = tips[-distance[tips] > depth[facet[tips]]]
    depth[facet[tips]], row[facet[tips]] = -distance[tips], path.row[sample_rows][tips]
