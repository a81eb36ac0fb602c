"""Deviations of the tool along the surface of a part: of the programmed path, and before and after correction.

The tool, moved by its deviation d, shifts the surface that it touches along the outward normal n by d·n (first order:
the surface of the tool and that of the part have the same normal where they touch). Which sample of the path touches a
facet follows from the shape of the tool: with corner radius r, radius R, spindle direction a, and m the part of n
square to a, the tip is at x + r·n + (R − r)·m/|m| − r·a. On a level face (m = 0) it may be anywhere within R − r of
that, on a wall also below.

The programmed path itself should leave the finished part: `Surface.programmed` says where it does not. A facet is cut
into where the tool, as programmed, contains its centre. The depth is the length of the normal inside the tool, or the
distance of its end from the mesh if that is shorter.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from msgspec import Struct
from scipy.spatial import cKDTree

from postproc.chunks import ragged_range
from postproc.correction import Result
from postproc.forces.axes import axes_of_travel
from postproc.frames import MM_PER_M, Array, norm
from postproc.machining.tool import Cutter
from postproc.program import Bools, Ints
from postproc.report.path import drawn_path, operations

_SPACING = 2e-4
_MOST_SAMPLES = 1_500_000
_CHORD = 1e-6
"""Distance [m] of the samples on an arc from it."""
_CONTACT_SHARE = 0.35
"""Share of the tool's radius, and at least `_LEAST` [m], by which the path may pass next to the place of contact:
the next pass is never further than that where a surface is finished."""
_LEAST_CONTACT = 3e-4
_REACH = 0.025
"""Tools of unknown shape have a radius of at most this [m]. The nearest place counts from which one can touch."""
_PASS_HEIGHT = 5e-4
"""Passes next to the place of contact may be this much higher or lower, or further in [m]."""
_STEEP = 0.7
"""Moves that are steeper (cosine to the spindle), plunges, leave no faces that are less steep."""
_UNSHAPED_CANDIDATES = 96
_NEARER = 0.05
"""Of places that touch alike, such as passes at several depths along a wall, the nearest counts."""
_LEVEL = 1e-6
"""The tip is not above what its side touches [m]."""
_FLAT, _UPRIGHT = 1e-3, 0.999
_CANDIDATES = 12
_CHUNK = 20_000
_PROBES = (0.0, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
"""Depths [m] below a facet at which a tool that cuts into it is looked for,"""
_SAMPLES_OF_FACET = 3
"""with this many samples of the path at each."""
_LONG = 4.0
"""Length of a tool above its tip, in radii."""
_OVERHANG = -0.05
"""Facets whose normal points away from the spindle by more (cosine) are not cut into from above."""
_BISECTIONS = 40
_FACET_COUNT = 8
_MOST_TIPS = 50_000


class Surface(Struct, frozen=True, eq=False):
    """F facets of a part, in the frame of its mesh [m]. NaN where no tool touches.

    :param corners: (F, 3, 3) of each facet.
    :param normal: (F, 3) outward.
    :param before: (F,) expected distance of the surface from the mesh along the normal if nothing is corrected; below 0
        the tool gouges, above 0 it leaves material. Relative to the programmed path.
    :param after: (F,) the same with the program as written.
    :param bound: (F,) 95 % bound of what will remain, or None where the model has none.
    :param row: (F,) row of the result at the end of the piece of path that touches, −1 where none does.
    :param programmed: (F,) distance of the surface that the programmed path makes from the mesh along the normal; below
        0 the programmed path itself cuts into the part. NaN where no tool reaches, and without shapes of the tools
        where no tip is inside the mesh.
    :param programmed_row: (F,) row of the result that cuts into the facet as programmed, −1 where none does.
    """

    corners: Array
    normal: Array
    before: Array
    after: Array
    bound: Array | None
    row: Ints
    programmed: Array
    programmed_row: Ints

    @property
    def touched(self) -> Bools:
        """(F,) True for facets that a tool touches."""
        return np.asarray(self.row >= 0)

    @property
    def reached(self) -> Bools:
        """(F,) True for facets that a tool touches or cuts into."""
        return np.asarray((self.row >= 0) | (self.programmed_row >= 0))

    @property
    def area(self) -> Array:
        """(F,) area of each facet [m²]."""
        return 0.5 * norm(np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]))


class _Frames(Struct, frozen=True, eq=False):
    """Transformations from the frames of a program into that of the mesh.

    :param drawn: (4, 4) of the frame that `drawn_path` is in [m].
    :param rotation: (K, 3, 3) of the `$BASE` of each target.
    """

    drawn: Array
    rotation: Array

    @classmethod
    def of(cls, result: Result, mesh_frame: Array | None) -> _Frames:
        bases = result.program.bases
        root = np.linalg.inv(bases[0] if mesh_frame is None else mesh_frame)
        in_mesh = root @ bases
        of_target = result.program.motions.base[result.motion]
        return cls(in_mesh[0] if len(bases) == 1 else root, in_mesh[of_target, :3, :3])

    def turned(self, vectors: Array) -> Array:
        """Return vectors (K, 3) of `$BASE` in the axes of the mesh."""
        return np.asarray(np.einsum("kij,kj->ki", self.rotation, vectors))


class _Path(Struct, frozen=True, eq=False):
    """Cutting pieces of the path of one tool: S samples close to each other, in the frame of the mesh.

    :param point: (S, 3) positions of the tip [m].
    :param step: (S, 3) of the path at each [m].
    :param row: (S,) row of the result at the end of the piece.
    :param share: (S,) of the piece that is behind the sample.
    :param axis: (S, 3) direction from the tip to the spindle.
    :param tree: of the points.
    """

    point: Array
    step: Array
    row: Ints
    share: Array
    axis: Array
    tree: cKDTree

    def near(self, contact_point: Array, index: Ints) -> tuple[Array, Array]:
        """Return the points (n, k, 3) of the path around samples (n, k) that are nearest to wanted points (n, 3).

        :returns: points, and (n, k) how far along its step each is (−0.5 … 0.5).
        """
        step = self.step[index]
        long = np.einsum("nki,nki->nk", step, step)
        share = np.einsum("nki,nki->nk", contact_point[:, None] - self.point[index], step) / np.where(
            long > 0.0, long, 1.0
        )
        share = np.clip(share, -0.5, 0.5)
        return self.point[index] + share[..., None] * step, share


def surface(
    result: Result,
    corners: Array,
    cutters: Mapping[int, Cutter] | None = None,
    mesh_frame: Array | None = None,
    coarse: Array | None = None,
) -> Surface:
    """Return the deviations along the facets of a part.

    :param result: of one program.
    :param corners: (F, 3, 3) of each facet, counter-clockwise seen from outside, in the frame of the mesh [m].
    :param cutters: shape of each tool by T number, 0 for those without an entry; None: unknown, the nearest place of
        the path counts.
    :param mesh_frame: (4, 4) frame of the mesh in the robot root [m]; None: it is in the `$BASE` of the program,
        its only one.
    :param coarse: (F,) distance of the facets from the surface that they approximate [m]; None: 0. What the programmed
        path cuts into them by less is not counted.
    """
    centre = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(norm(normal), 1e-300)[:, None]
    count = len(corners)
    row, share, distance, left = np.full(count, -1), np.zeros(count), np.full(count, np.inf), np.full(count, np.nan)
    depth, cut_row = np.zeros(count), np.full(count, -1)
    mesh = _Mesh.of(corners, normal)
    tools, frames = _tools(result), _Frames.of(result, mesh_frame)
    for number in np.unique(tools[~result.rapid]).tolist():
        cutter = None if cutters is None else cutters.get(number, cutters.get(0))
        path = _sampled(result, frames, tools == number)
        if path is None or (cutters is not None and cutter is None):
            continue
        if cutter is None:
            _add_tips(mesh, path, depth, cut_row)
        for first in range(0, count, _CHUNK):
            part = slice(first, first + _CHUNK)
            contact = _touching(path, centre[part], normal[part], cutter)
            better = contact[2] < distance[part]
            for best_values, new in zip((row, share, distance, left), contact, strict=True):
                best_values[part] = np.where(better, new, best_values[part])
            if cutter is not None:
                deep, rows_of_cut = _cut_into(mesh, path, centre[part], normal[part], cutter)
                deeper = deep > depth[part]
                cut_row[part] = np.where(deeper, rows_of_cut, cut_row[part])
                depth[part] = np.where(deeper, deep, depth[part])
    cut_row[depth <= (_CHORD if coarse is None else coarse + _CHORD)] = -1
    contact_facets = np.flatnonzero(row >= 0)
    at, before_it = row[contact_facets], np.maximum(row[contact_facets] - 1, 0)

    def of(values: Array) -> Array:
        weight = share[contact_facets].reshape(-1, *(1,) * (values.ndim - 1))
        of_facets: Array = np.full((count, *values.shape[1:]), np.nan)
        start = np.where(result.rapid[before_it].reshape(weight.shape), values[at], values[before_it])
        of_facets[contact_facets] = (1.0 - weight) * start + weight * values[at]
        return of_facets

    return Surface(
        corners=corners,
        normal=normal,
        before=np.einsum("fi,fi->f", of(frames.turned(result.deviation_before)), normal),
        after=np.einsum("fi,fi->f", of(frames.turned(result.deviation_after)), normal),
        bound=None if result.bound is None else of(result.bound),
        row=row,
        programmed=np.where(cut_row >= 0, -depth, np.where(row >= 0, np.maximum(left, 0.0), np.nan)),
        programmed_row=cut_row,
    )


def _tools(result: Result) -> Ints:
    """Return the number of the tool (K,) of each target."""
    tool_number = np.zeros(len(result), dtype=np.int64)
    for operation in operations(result):
        tool_number[operation.first : operation.last + 1] = operation.tool
    return tool_number


def _sampled(result: Result, frames: _Frames, is_chosen: Bools) -> _Path | None:
    """Return the cutting pieces to chosen targets (K,); None if there are none."""
    position, row = drawn_path(result, _CHORD)
    position = position @ frames.drawn[:3, :3].T + frames.drawn[:3, 3]
    number = np.arange(len(row)) - np.searchsorted(row, row) + 1
    of_row = np.bincount(row, minlength=len(result))
    begin, step = position[:-1], np.diff(position, axis=0)
    cuts = (~result.rapid & is_chosen)[row[1:]]
    begin, step, row, number = begin[cuts], step[cuts], row[1:][cuts], number[1:][cuts]
    if len(row) == 0:
        return None
    length = norm(step)
    spacing = max(_SPACING, float(length.sum()) / _MOST_SAMPLES)
    count = np.maximum(np.ceil(length / spacing), 1.0).astype(np.int64)
    piece = np.repeat(np.arange(len(count)), count)
    piece_share = (ragged_range(count) + 0.5) / count[piece]
    share = (number[piece] - 1 + piece_share) / of_row[row[piece]]
    point, of_sample = begin[piece] + piece_share[:, None] * step[piece], row[piece]
    spindle = frames.turned(_spindle(result))
    axis = (1.0 - share)[:, None] * spindle[np.maximum(of_sample - 1, 0)] + share[:, None] * spindle[of_sample]
    axis /= np.maximum(norm(axis), 1e-300)[:, None]
    return _Path(point, step[piece] / count[piece, None], of_sample, share, axis, cKDTree(point))


def _contact(axis: Array, centre: Array, normal: Array, cutter: Cutter) -> Array:
    """Return where the tip (n, 3) is if the tool touches facets at their centres."""
    across_axis = normal - np.einsum("ni,ni->n", normal, axis)[:, None] * axis
    width = norm(across_axis)
    m = across_axis / np.where(width > _FLAT, width, 1.0)[:, None]
    m[width <= _FLAT] = 0.0
    return np.asarray(centre + cutter.corner * (normal - axis) + (cutter.radius - cutter.corner) * m)


def _touching(path: _Path, centre: Array, normal: Array, cutter: Cutter | None) -> tuple[Ints, Array, Array, Array]:
    """Return which place of the path touches each of n facets.

    :returns: row of the result (−1: none), share of the piece to it, distance from the exact place of contact [m], and
        how far above the facet the tool passes along its normal [m], NaN without a shape of the tool.
    """
    _, nearest = path.tree.query(centre)
    a = path.axis[nearest]
    up = np.einsum("ni,ni->n", normal, a)
    width = norm(normal - up[:, None] * a)
    contact_point = centre if cutter is None else _contact(a, centre, normal, cutter)
    count = _UNSHAPED_CANDIDATES if cutter is None else _CANDIDATES
    _, index = path.tree.query(contact_point, k=min(count, len(path.point)))
    index = index.reshape(len(centre), -1)
    point, step_share = path.near(contact_point, index)
    rest = point - contact_point[:, None]
    height = np.einsum("nki,ni->nk", rest, a)
    lateral = norm((rest - height[..., None] * a[:, None]).reshape(-1, 3)).reshape(height.shape)
    whole = np.hypot(height, lateral)
    if cutter is None:
        fits = (whole <= _REACH) & _can_touch(height, np.einsum("nki,ni->nk", rest, normal), up[:, None])
        step = path.step[index]
        climb = np.abs(np.einsum("nki,ni->nk", step, a)) / np.maximum(np.linalg.norm(step, axis=-1), 1e-300)
        fits &= (climb <= _STEEP) | (up <= _STEEP)[:, None]
        distance = whole
    else:
        tolerance = max(_LEAST_CONTACT, _CONTACT_SHARE * cutter.radius)
        level, wall = (up > 0.0)[:, None] & (width <= _FLAT)[:, None], (width >= _UPRIGHT)[:, None]
        flat = cutter.radius - cutter.corner
        fits = np.where(
            level,
            (np.abs(height) <= tolerance) & (lateral <= flat + tolerance),
            np.where(
                wall,
                (height <= _LEVEL) & (height >= -_LONG * cutter.radius) & (lateral <= tolerance),
                whole <= tolerance,
            ),
        )
        distance = np.where(level, np.abs(height) + np.maximum(lateral - flat, 0.0), np.where(wall, lateral, whole))
    distance = np.where(fits, distance + _NEARER * whole, np.inf)
    best = np.argmin(distance, axis=1)
    facets = np.arange(len(centre))
    sample = index[facets, best]
    smallest = distance[facets, best]
    row = np.where(np.isfinite(smallest), path.row[sample], -1)
    share = path.share[sample] + step_share[facets, best] * _share_of_step(path)[sample]
    height_over_facet = (
        np.full(len(centre), np.nan) if cutter is None else np.einsum("ni,ni->n", rest[facets, best], normal)
    )
    return row, share, smallest, height_over_facet


def _can_touch(height: Array, outwards: Array, up: Array) -> Bools:
    """Return whether a tool of any shape, of a radius up to `_REACH`, can touch facets with its tip at places (n, k).

    The tip is at x + r·n + (R − r)·m − r·a, see above: outside of the facet, and lower by r (1 − n·a).

    :param height: of the tip above the facet along the spindle [m]; outwards: its distance along the normal [m].
    :param up: (n, 1) cosine between normal and spindle.
    """
    reachable = (height <= _PASS_HEIGHT) & (outwards >= -_PASS_HEIGHT) & (up >= _OVERHANG)
    return np.asarray(reachable & (height >= -_REACH * (1.0 - up) - _PASS_HEIGHT))


def _share_of_step(path: _Path) -> Array:
    """Return the share (S,) of the piece to its target that the step of each sample covers."""
    same_row = np.diff(path.row) == 0
    share = np.ones(len(path.row))
    change = np.diff(path.share)
    share[:-1][same_row] = change[same_row]
    share[1:][same_row] = change[same_row]
    first = np.flatnonzero(share == 1.0)
    share[first] = 2.0 * path.share[first]  # a single sample covers its whole piece
    return np.minimum(share, 1.0)


def _spindle(result: Result) -> Array:
    """Return the direction from the tip to the spindle (K, 3) at each target, `$BASE`."""
    x_or_z = np.zeros((len(result), 3))
    x_or_z[:, 0] = 1.0
    axes, _ = axes_of_travel(result.nominal[:, :3, :3], x_or_z, result.axis)
    return np.asarray(axes[:, :, 2])


# ---- the programmed path and the mesh ----


class _Mesh(Struct, frozen=True, eq=False):
    """Facets and a tree of their centres [m]."""

    corners: Array
    normal: Array
    tree: cKDTree

    @classmethod
    def of(cls, corners: Array, normal: Array) -> _Mesh:
        return cls(corners, normal, cKDTree(corners.mean(axis=1)))

    def distance(self, point: Array) -> tuple[Array, Ints]:
        """Return the distances (n,) of points (n, 3) from the mesh, and the nearest facet of each.

        Distances are negative inside. Points nearest to an edge count as outside: there, which side they are on is not
        certain.
        """
        _, facet = self.tree.query(point, k=min(_FACET_COUNT, len(self.corners)))
        facet = facet.reshape(len(point), -1)
        from_a, from_b, from_c = (point[:, None] - self.corners[facet, k] for k in range(3))
        edges = [self.corners[facet, (k + 1) % 3] - self.corners[facet, k] for k in range(3)]
        normal = self.normal[facet]
        height = _dot(from_a, normal)
        is_within = np.ones(facet.shape, dtype=bool)
        side = np.full(facet.shape, np.inf)
        for corner, edge in zip((from_a, from_b, from_c), edges, strict=True):
            is_within &= _dot(np.cross(edge, corner), normal) >= 0.0
            t = np.clip(_dot(corner, edge) / np.maximum(_dot(edge, edge), 1e-300), 0.0, 1.0)
            gap = corner - t[..., None] * edge
            side = np.minimum(side, np.sqrt(_dot(gap, gap)))
        distance = np.where(is_within, np.abs(height), side)
        rows, best = np.arange(len(point)), np.argmin(distance, axis=1)
        is_inside = is_within[rows, best] & (height[rows, best] < 0.0)
        return np.where(is_inside, -1.0, 1.0) * distance[rows, best], facet[rows, best]


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("nki,nki->nk", a, b))


def _cut_into(mesh: _Mesh, path: _Path, centre: Array, normal: Array, cutter: Cutter) -> tuple[Array, Ints]:
    """Return the depth [m] by which the programmed path cuts into each of n facets (0: it does not), and the row."""
    _, nearest = path.tree.query(centre)
    contact_point = _contact(path.axis[nearest], centre, normal, cutter)
    sample_count = min(_SAMPLES_OF_FACET, len(path.point))
    inside_of, tip, axis, facet = [], [], [], []
    for probe in _PROBES:
        probe_point = contact_point - probe * normal
        _, index = path.tree.query(probe_point, k=sample_count)
        index = index.reshape(len(centre), -1)
        point, _ = path.near(probe_point, index)
        direction = path.axis[index]
        is_inside = _inside(centre[:, None] - point, direction, cutter)
        is_inside &= np.einsum("nki,ni->nk", direction, normal) >= _OVERHANG
        at, sample = np.nonzero(is_inside)
        facet.append(at)
        inside_of.append(path.row[index[at, sample]])
        tip.append(point[at, sample])
        axis.append(direction[at, sample])
    of, row = np.concatenate(facet), np.concatenate(inside_of)
    depth, best = np.zeros(len(centre)), np.full(len(centre), -1)
    if not len(of):
        return depth, best
    from_tip, directions, inward = centre[of] - np.concatenate(tip), np.concatenate(axis), -normal[of]
    low, high = np.zeros(len(of)), np.full(len(of), 2.0 * _LONG * cutter.radius)
    for _ in range(_BISECTIONS):  # the tool is convex: the normal leaves it once
        middle = 0.5 * (low + high)
        stays_inside = _inside(from_tip + middle[:, None] * inward, directions, cutter)
        low, high = np.where(stays_inside, middle, low), np.where(stays_inside, high, middle)
    end, _ = mesh.distance(centre[of] + low[:, None] * inward)
    facet_depth = np.minimum(low, np.abs(end))
    order = np.argsort(facet_depth, kind="stable")
    depth[of[order]], best[of[order]] = facet_depth[order], row[order]  # the deepest is written last
    return depth, best


def _inside(from_tip: Array, axis: Array, cutter: Cutter) -> Bools:
    """Return whether points relative to the tip (..., 3) are inside the tool."""
    height = np.einsum("...i,...i->...", from_tip, axis)
    distance = np.linalg.norm(from_tip - height[..., None] * axis, axis=-1)
    return np.asarray(
        (distance < cutter.radius) & (height > cutter.height(distance)) & (height <= _LONG * cutter.radius)
    )


def _add_tips(mesh: _Mesh, path: _Path, depth: Array, row: Ints) -> None:
    """Enter the depth [m] of tips inside the mesh at the facets (F,) next to them, and the rows that cut there."""
    sample_rows = slice(None, None, -(-len(path.point) // _MOST_TIPS))
    distance, facet = mesh.distance(path.point[sample_rows])
    order = np.argsort(-distance, kind="stable")
    order = order[-distance[order] > depth[facet[order]]]
    depth[facet[order]], row[facet[order]] = -distance[order], path.row[sample_rows][order]


# ---- files ----

_UNTOUCHED = (150, 150, 150)
_STOPS = np.array([[179, 88, 6], [247, 247, 247], [5, 48, 97]], dtype=float)
"""Orange where the tool gouges, white, blue where it leaves material: distinct for colour-blind eyes."""
_HEAD = """ply
format binary_little_endian 1.0
comment postproc: deviation along the normal, mm; below 0 the tool gouges
element vertex {vertices}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
property float before_mm
property float after_mm
property float u95_mm
element face {faces}
property list uchar int vertex_indices
end_header
"""
_VERTEX = np.dtype([("at", "<f4", 3), ("colour", "u1", 3), ("values", "<f4", 3)])
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def ply(surface: Surface, limit: float) -> bytes:
    """Return the file: each facet with corners of its own, coloured by the deviation before.

    :param limit: deviation [m] of the full colours.
    """
    count = len(surface.corners)
    bound = np.full(count, np.nan) if surface.bound is None else surface.bound
    vertices = np.empty(3 * count, dtype=_VERTEX)
    vertices["at"] = surface.corners.reshape(-1, 3) * MM_PER_M
    vertices["colour"] = np.repeat(_colours(surface.before, limit), 3, axis=0)
    vertices["values"] = np.repeat(np.stack([surface.before, surface.after, bound], axis=1) * MM_PER_M, 3, axis=0)
    faces = np.empty(count, dtype=_FACE)
    faces["count"], faces["corners"] = 3, np.arange(3 * count).reshape(-1, 3)
    return _HEAD.format(vertices=3 * count, faces=count).encode() + vertices.tobytes() + faces.tobytes()


def glb(surface: Surface, limit: float) -> bytes:
    """Return the file, for viewers of glTF, in mm like the mesh of the part; see `ply`."""
    import trimesh

    count = len(surface.corners)
    colours = np.full((3 * count, 4), 255, dtype=np.uint8)
    colours[:, :3] = np.repeat(_colours(surface.before, limit), 3, axis=0)
    faces = np.arange(3 * count).reshape(-1, 3)
    points = surface.corners.reshape(-1, 3) * MM_PER_M
    mesh: Any = trimesh.Trimesh(points, faces, vertex_colors=colours, process=False)
    return bytes(mesh.export(file_type="glb"))


def _colours(values: Array, limit: float) -> np.ndarray:
    share = np.clip(np.nan_to_num(values) / limit, -1.0, 1.0)
    colour = np.stack([np.interp(share, [-1.0, 0.0, 1.0], _STOPS[:, channel]) for channel in range(3)], axis=1)
    colour[np.isnan(values)] = _UNTOUCHED
    return np.round(colour).astype(np.uint8)
