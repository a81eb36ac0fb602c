"""Deviations of the tool along the surface of a part."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.correction import Result
from postproc.frames import Array, norm
from postproc.machining.tool import Cutter
from postproc.program import Bools, Ints, distinct
from postproc.report.surface.contact import nearest_place
from postproc.report.surface.envelope import RemainingSurface, remaining_surface
from postproc.report.surface.path import CHORD, CutPath, Frames, piece_start, tool_path
from postproc.report.surface.programmed import Mesh, add_tips, cut_depths

_CHUNK = 20_000
"""Facets computed at once: arrays of their candidates are 46 MB each."""


class Surface(Struct, frozen=True, eq=False):
    """F facets of a part, in the frame of its mesh [m]. NaN where no tool touches.

    :param corners: (F, 3, 3) of each facet.
    :param normal: (F, 3) outward.
    :param before: (F,) by how much the surface is changed along the normal if nothing is corrected, relative to that of
        the programmed path: what remains after all passes, less what would remain if no tool deviated. Below 0 the tool
        gouges, above 0 it leaves material.
    :param after: (F,) the same with the program as written.
    :param bound: (F,) 95 % bound of what will remain, or None where the model has none.
    :param row: (F,) row of the result at the end of the piece of path that leaves the surface with the program as
        written, −1 where no tool touches.
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
    def is_touched(self) -> Bools:
        """(F,) True for facets that a tool touches."""
        return np.asarray(self.row >= 0)

    @property
    def is_reached(self) -> Bools:
        """(F,) True for facets that a tool touches or cuts into."""
        return np.asarray((self.row >= 0) | (self.programmed_row >= 0))

    @property
    def area(self) -> Array:
        """(F,) area of each facet [m²]."""
        return 0.5 * norm(np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]))


def surface(
    result: Result,
    corners: Array,
    cutters: Mapping[int, Cutter] | None = None,
    mesh_frame: Array | None = None,
    coarse: Array | None = None,
    *,
    tool: Ints | None = None,
) -> Surface:
    """Return the deviations along the facets of a part.

    :param result: of one program.
    :param corners: (F, 3, 3) of each facet, counter-clockwise seen from outside, in the frame of the mesh [m].
    :param cutters: shape of each tool by its number in `tool`; None: unknown, the nearest place of the path counts.
    :param mesh_frame: (4, 4) frame of the mesh in the robot root [m]; None: it is in the `$BASE` of the program,
        its only one.
    :param coarse: (F,) distance of the facets from the surface that they approximate [m]; None: 0. What the programmed
        path cuts into them by less is not counted.
    :param tool: (K,) number of the tool of each target; None: 0, one tool.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(norm(normal), 1e-300)[:, None]  # a facet without area keeps a normal of zero
    frames = Frames.of(result, mesh_frame)
    paths = list(_tool_paths(result, frames, cutters, np.zeros(len(result), dtype=np.int64) if tool is None else tool))
    depth, cut_row = _programmed_cuts(paths, corners, normal)
    cut_row[depth <= (CHORD if coarse is None else coarse + CHORD)] = -1
    centre = corners.mean(axis=1)
    if cutters is None:
        place = _nearest_places(paths, centre, normal)
        uncorrected_change, corrected_change = (
            np.einsum("fi,fi->f", _interpolated(result, place, frames.to_mesh(values)), normal)
            for values in (result.deviation_before, result.deviation_after)
        )
        remaining_height = np.full(len(corners), np.nan)  # the tip alone does not tell what remains on the part
    else:
        surfaces = [remaining_surface(path, centre, normal, cutter) for path, cutter in paths if cutter is not None]
        remaining_height, uncorrected_change, corrected_change, place = _deepest_surfaces(surfaces, len(corners))
    return Surface(
        corners=corners,
        normal=normal,
        before=uncorrected_change,
        after=corrected_change,
        bound=None if result.bound is None else _interpolated(result, place, result.bound),
        row=place.row,
        programmed=np.where(cut_row >= 0, -depth, np.maximum(remaining_height, 0.0)),
        programmed_row=cut_row,
    )


class _Place(NamedTuple):
    """Row of the result at the end of a piece of path (F,), −1 for none, and share (F,) of the piece."""

    row: Ints
    share: Array


def _tool_paths(
    result: Result, frames: Frames, cutters: Mapping[int, Cutter] | None, tool: Ints
) -> Iterator[tuple[CutPath, Cutter | None]]:
    """Yield the cutting path of each tool with its shape, which is None for all if shapes are unknown."""
    for number in distinct(tool[~result.rapid]).tolist():
        cutter = None if cutters is None else cutters.get(number)
        if cutters is None or cutter is not None:
            path = tool_path(result, frames, tool == number, _ball_radius(cutter))
            if path is not None:
                yield path, cutter


def _ball_radius(cutter: Cutter | None) -> float | None:
    """Return the radius [m] of a ball cutter; None for other and unknown shapes."""
    return cutter.radius if cutter is not None and cutter.shape == "ball" else None


def _programmed_cuts(paths: list[tuple[CutPath, Cutter | None]], corners: Array, normal: Array) -> tuple[Array, Ints]:
    """Return the depth [m] by which the programmed path cuts into each facet (F,), 0 without a cut, and where.

    :param corners: (F, 3, 3) of the facets [m], `normal` (F, 3) their outward normals.
    :returns: depths, and rows of the result (F,) that cut there, −1 for none.
    """
    depth, row = np.zeros(len(corners)), np.full(len(corners), -1)
    mesh, centre = Mesh.of(corners, normal), corners.mean(axis=1)
    for path, cutter in paths:
        if cutter is None:
            add_tips(mesh, path, depth, row)
            continue
        for first in range(0, len(centre), _CHUNK):
            part = slice(first, first + _CHUNK)
            tool_depth, tool_row = cut_depths(mesh, path, centre[part], normal[part], cutter)
            deeper = tool_depth > depth[part]
            row[part] = np.where(deeper, tool_row, row[part])
            depth[part] = np.where(deeper, tool_depth, depth[part])
    return depth, row


def _nearest_places(paths: list[tuple[CutPath, Cutter | None]], centre: Array, normal: Array) -> _Place:
    """Return the nearest places of all paths from which a tool of any shape can touch F facets.

    :param centre: (F, 3) centres of the facets [m], `normal` (F, 3) their outward normals.
    """
    row, share, distance = np.full(len(centre), -1), np.zeros(len(centre)), np.full(len(centre), np.inf)
    for path, _ in paths:
        for first in range(0, len(centre), _CHUNK):
            part = slice(first, first + _CHUNK)
            place = nearest_place(path, centre[part], normal[part])
            is_nearer = place.distance < distance[part]
            row[part] = np.where(is_nearer, place.row, row[part])
            share[part] = np.where(is_nearer, place.share, share[part])
            distance[part] = np.where(is_nearer, place.distance, distance[part])
    return _Place(row, share)


class _DeepestSurface(NamedTuple):
    """The surface that remains at F facets after all tools; heights are NaN where no tool touches.

    :param programmed: (F,) height of the programmed surface over the facet [m].
    :param uncorrected_change: (F,) its change by the deviation without correction [m].
    :param corrected_change: (F,) the same with the program as written [m].
    :param place: that leaves the surface as written.
    """

    programmed: Array
    uncorrected_change: Array
    corrected_change: Array
    place: _Place


def _deepest_surfaces(surfaces: list[RemainingSurface], count: int) -> _DeepestSurface:
    """Return the surface that remains at F facets after all tools.

    :param surfaces: of each tool.
    :param count: F.
    """
    programmed_height, deflected_heights = np.full(count, np.inf), np.full((2, count), np.inf)
    row, share = np.full(count, -1), np.zeros(count)
    for tool in surfaces:
        is_deeper = tool.deflected[1] < deflected_heights[1]
        row, share = np.where(is_deeper, tool.row, row), np.where(is_deeper, tool.share, share)
        programmed_height = np.minimum(programmed_height, tool.programmed)
        deflected_heights = np.minimum(deflected_heights, tool.deflected)
    programmed_height[row < 0] = np.nan
    deflected_heights[:, row < 0] = np.nan
    return _DeepestSurface(
        programmed_height,
        deflected_heights[0] - programmed_height,
        deflected_heights[1] - programmed_height,
        _Place(row, share),
    )


def _interpolated(result: Result, place: _Place, values: Array) -> Array:
    """Return values (F, …) at places of the path, linear between targets; NaN where there is no place.

    :param values: (K, …) at the targets.
    """
    facets = np.flatnonzero(place.row >= 0)
    end = place.row[facets]
    weight = place.share[facets].reshape(-1, *(1,) * (values.ndim - 1))  # of as many axes as the values have
    of_facets: Array = np.full((len(place.row), *values.shape[1:]), np.nan)
    of_facets[facets] = (1.0 - weight) * values[piece_start(result, end)] + weight * values[end]
    return of_facets
