"""What the surface of a part will look like: how far the tool leaves it along its normal, before and after.

The tool, moved by its deviation d, shifts the surface that it touches along the outward normal n by d·n (first order:
the surface of the tool and that of the part have the same normal where they touch). Which place of the path touches a
facet follows from the shape of the tool: with corner radius r and radius R, spindle direction a, and m the part of n
square to a, the tip stands at x + r·n + (R − r)·m/|m| − r·a; on a floor (m = 0) anywhere within R − r beside that, on a
wall also below.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from msgspec import Struct
from scipy.spatial import cKDTree

from postproc.correction import Result
from postproc.forces.feed import across
from postproc.frames import Array, norm
from postproc.machining.tool import Cutter
from postproc.program import Ints
from postproc.report.deviation.drawn import drawn_path
from postproc.report.deviation.operations import operations

_SPACING = 2e-4
_MOST_SAMPLES = 1_500_000
_NEAR = 0.35
"""Share of the tool's radius, and at least `_LEAST` [m], by which the path may pass beside the place where it touches:
the next pass is never further than that where a surface is finished."""
_LEAST = 3e-4
_REACH = 0.025
"""Without a shape of the tool, the nearest place of the path within so far counts [m]."""
_NEARER = 0.05
"""Of places that touch alike, such as passes at several depths along a wall, the nearest counts."""
_LEVEL = 1e-6
"""The tip is not above what its side touches [m]."""
_FLAT, _UPRIGHT = 1e-3, 0.999
_CANDIDATES = 12
_AT_ONCE = 50_000


class Surface(Struct, frozen=True, eq=False):
    """F facets of a part, in the frame of its mesh [m]. NaN where no tool touches.

    :param corners: (F, 3, 3) of each facet.
    :param normal: (F, 3) outward.
    :param before: (F,) how far the surface will be off along the normal if nothing is corrected; below 0 the tool
        gouges, above 0 it leaves material.
    :param after: (F,) the same with the program as written.
    :param bound: (F,) 95 % bound of what will remain, or None where the model has none.
    :param row: (F,) row of the result at the end of the piece of path that touches, −1 where none does.
    """

    corners: Array
    normal: Array
    before: Array
    after: Array
    bound: Array | None
    row: Ints


class _Frames(Struct, frozen=True, eq=False):
    """How what is known in the frames of a program stands in that of the mesh.

    :param drawn: (4, 4) of the frame that `drawn_path` is in [m].
    :param rotation: (K, 3, 3) of the `$BASE` of each target.
    """

    drawn: Array
    rotation: Array

    @classmethod
    def of(cls, result: Result, placed: Array | None) -> _Frames:
        bases = result.program.bases
        root = np.linalg.inv(bases[0] if placed is None else placed)
        in_mesh = root @ bases
        of_target = result.program.motions.base[result.motion]
        return cls(in_mesh[0] if len(bases) == 1 else root, in_mesh[of_target, :3, :3])

    def turned(self, vectors: Array) -> Array:
        """Return vectors (K, 3) of `$BASE` in the axes of the mesh."""
        return np.asarray(np.einsum("kij,kj->ki", self.rotation, vectors))


class _Path(Struct, frozen=True, eq=False):
    """Cutting pieces of the path, S samples close to each other, row i of all arrays, in the frame of the mesh."""

    point: Array
    step: Array
    row: Ints
    share: Array


def surface(
    result: Result, corners: Array, cutters: Mapping[int, Cutter] | None = None, placed: Array | None = None
) -> Surface:
    """Return what will become of the facets of a part.

    :param result: of one program.
    :param corners: (F, 3, 3) of each facet, counter-clockwise seen from outside, in the frame of the mesh [m].
    :param cutters: shape of each tool by T number, 0 for those without an entry; None: unknown, the nearest place of
        the path counts.
    :param placed: (4, 4) frame of the mesh in the robot root [m]; None: it is in the `$BASE` of the program, its only
        one.
    """
    centre = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(norm(normal), 1e-300)[:, None]
    row, share = np.full(len(corners), -1), np.zeros(len(corners))
    off = np.full(len(corners), np.inf)
    tools, frames = _tools(result), _Frames.of(result, placed)
    spindle = frames.turned(_spindle(result))
    for number in np.unique(tools[~result.rapid]).tolist():
        cutter = None if cutters is None else cutters.get(number, cutters.get(0))
        path = _sampled(result, frames, tools == number)
        if len(path.point) == 0 or (cutters is not None and cutter is None):
            continue
        for first in range(0, len(corners), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            found = _touching(spindle, path, centre[part], normal[part], cutter)
            better = found[2] < off[part]
            for out, new in zip((row, share, off), found, strict=True):
                out[part] = np.where(better, new, out[part])
    touched = np.flatnonzero(row >= 0)
    at, before_it = row[touched], np.maximum(row[touched] - 1, 0)

    def of(values: Array) -> Array:
        mixed = share[touched].reshape(-1, *(1,) * (values.ndim - 1))
        out: Array = np.full((len(corners), *values.shape[1:]), np.nan)
        start = np.where(result.rapid[before_it].reshape(mixed.shape), values[at], values[before_it])
        out[touched] = (1.0 - mixed) * start + mixed * values[at]
        return out

    return Surface(
        corners=corners,
        normal=normal,
        before=np.einsum("fi,fi->f", of(frames.turned(result.deviation_before)), normal),
        after=np.einsum("fi,fi->f", of(frames.turned(result.deviation_after)), normal),
        bound=None if result.bound is None else of(result.bound),
        row=row,
    )


def _tools(result: Result) -> Ints:
    """Return the number of the tool (K,) of each target."""
    out = np.zeros(len(result), dtype=np.int64)
    for operation in operations(result):
        out[operation.first : operation.last + 1] = operation.tool
    return out


def _sampled(result: Result, frames: _Frames, chosen: np.ndarray) -> _Path:
    """Return the cutting pieces to chosen targets (K,)."""
    position, row = drawn_path(result)
    position = position @ frames.drawn[:3, :3].T + frames.drawn[:3, 3]
    number = np.arange(len(row)) - np.searchsorted(row, row) + 1
    of_row = np.bincount(row, minlength=len(result))
    begin, step = position[:-1], np.diff(position, axis=0)
    cuts = (~result.rapid & chosen)[row[1:]]
    begin, step, row, number = begin[cuts], step[cuts], row[1:][cuts], number[1:][cuts]
    length = norm(step)
    spacing = max(_SPACING, float(length.sum()) / _MOST_SAMPLES)
    count = np.maximum(np.ceil(length / spacing), 1.0).astype(np.int64)
    piece = np.repeat(np.arange(len(count)), count)
    within = (np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[piece]
    share = (number[piece] - 1 + within) / of_row[row[piece]]
    return _Path(begin[piece] + within[:, None] * step[piece], step[piece] / count[piece, None], row[piece], share)


def _touching(
    spindle: Array, path: _Path, centre: Array, normal: Array, cutter: Cutter | None
) -> tuple[Ints, Array, Array]:
    """Return row, share of its piece, and how far beside the exact place the path passes [m]; row −1 for none."""
    tree = cKDTree(path.point)
    _, nearest = tree.query(centre)
    a = spindle[path.row[nearest]]
    up = np.einsum("ni,ni->n", normal, a)
    beside = normal - up[:, None] * a
    width = norm(beside)
    wanted = centre
    if cutter is not None:
        m = beside / np.where(width > _FLAT, width, 1.0)[:, None]
        m[width <= _FLAT] = 0.0
        wanted = centre + cutter.corner * (normal - a) + (cutter.radius - cutter.corner) * m
    _, index = tree.query(wanted, k=min(_CANDIDATES, len(path.point)))
    index = index.reshape(len(centre), -1)
    step = path.step[index]
    long = np.einsum("nki,nki->nk", step, step)
    along = np.einsum("nki,nki->nk", wanted[:, None] - path.point[index], step) / np.where(long > 0.0, long, 1.0)
    along = np.clip(along, -0.5, 0.5)
    rest = path.point[index] + along[..., None] * step - wanted[:, None]
    height = np.einsum("nki,ni->nk", rest, a)
    lateral = norm((rest - height[..., None] * a[:, None]).reshape(-1, 3)).reshape(height.shape)
    whole = np.hypot(height, lateral)
    if cutter is None:
        fits, off = whole <= _REACH, whole
    else:
        near = max(_LEAST, _NEAR * cutter.radius)
        floor, wall = (up > 0.0)[:, None] & (width <= _FLAT)[:, None], (width >= _UPRIGHT)[:, None]
        flat = cutter.radius - cutter.corner
        fits = np.where(
            floor,
            (np.abs(height) <= near) & (lateral <= flat + near),
            np.where(wall, (height <= _LEVEL) & (height >= -4.0 * cutter.radius) & (lateral <= near), whole <= near),
        )
        off = np.where(floor, np.abs(height) + np.maximum(lateral - flat, 0.0), np.where(wall, lateral, whole))
    off = np.where(fits, off + _NEARER * whole, np.inf)
    best = np.argmin(off, axis=1)
    every = np.arange(len(centre))
    chosen = index[every, best]
    least = off[every, best]
    row = np.where(np.isfinite(least), path.row[chosen], -1)
    return row, path.share[chosen] + along[every, best] * _share_of_step(path)[chosen], least


def _share_of_step(path: _Path) -> Array:
    """Return which share (S,) of the piece to its target each sample stands for."""
    same = np.diff(path.row) == 0
    out = np.ones(len(path.row))
    change = np.diff(path.share)
    out[:-1][same] = change[same]
    out[1:][same] = change[same]
    first = np.flatnonzero(out == 1.0)
    out[first] = 2.0 * path.share[first]  # the only sample of its piece stands for all of it
    return np.minimum(out, 1.0)


def _spindle(result: Result) -> Array:
    """Return the direction from the tip to the spindle (K, 3) at each target, `$BASE`."""
    x_or_z = np.zeros((len(result), 3))
    x_or_z[:, 0] = 1.0
    axes, _ = across(result.nominal[:, :3, :3], x_or_z, result.axis)
    return np.asarray(axes[:, :, 2])
