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
from postproc.report.surface.path import CHORD_DISTANCE, CutPath, Frames, piece_start, tool_path
from postproc.report.surface.programmed import Mesh, add_tip_depths, cut_depths

_CHUNK_FACETS = 20_000
"""Number of facets that are computed at once: arrays of their candidates are 46 MB each."""


class Surface(Struct, frozen=True, eq=False):
    """Deviations of the surface of a part at the F facets of its mesh [m], in the frame of the mesh.

    Deviations are along the outward normal: below 0 the tool gouges, above 0 it leaves material. NaN where no tool
    touches a facet.

    :param corners: (F, 3, 3) three corners of each facet.
    :param normal: (F, 3) outward normals.
    :param before: (F,) deviation of the surface if nothing is corrected: the surface after all passes, less the surface
        if no tool deviated.
    :param after: (F,) deviation of the surface with the program as written, likewise.
    :param bound: (F,) 95 % bound of the error with the program as written; None if the model states no uncertainty.
    :param row: (F,) target, as row of the result, at the end of the piece of path that leaves the surface with the
        program as written; −1 where no tool touches. A piece leads from one target to the next.
    :param programmed: (F,) distance of the surface that the programmed path makes from the mesh; below 0 the programmed
        path itself cuts into the part. NaN where no tool reaches, and without shapes of the tools where no tip is
        inside the mesh.
    :param programmed_row: (F,) row of the result that cuts into the facet as programmed; −1 where no tool cuts in.
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
    facet_error: Array | None = None,
    *,
    tool: Ints | None = None,
) -> Surface:
    """Return the deviations of the surface of a part at its facets.

    :param result: result of one program.
    :param corners: (F, 3, 3) three corners of each facet, counter-clockwise seen from outside, in the frame of the
        mesh [m].
    :param cutters: number of each tool in `tool` → its shape; tools that are not in it are left out. None: shapes are
        unknown, and the nearest place of the path counts.
    :param mesh_frame: (4, 4) frame of the mesh in the robot root [m]; None: the mesh is in the only `$BASE` of the
        program.
    :param facet_error: (F,) distance of each facet from the surface that it approximates [m]; smaller cuts of the
        programmed path do not count. None: 0.
    :param tool: (K,) number of the tool of each target; None: all targets have tool 0.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(norm(normal), 1e-300)[:, None]  # a facet without area keeps a normal of zero
    frames = Frames.of(result, mesh_frame)
    tool_number = np.zeros(len(result), dtype=np.int64) if tool is None else tool
    paths = list(_tool_paths(result, frames, cutters, tool_number))
    depth, cut_row = _programmed_cuts(paths, corners, normal)
    # cuts up to the distance of arcs from their chords are not certain
    cut_row[depth <= (CHORD_DISTANCE if facet_error is None else facet_error + CHORD_DISTANCE)] = -1
    centre = corners.mean(axis=1)
    if cutters is None:
        place = _nearest_places(paths, centre, normal)
        uncorrected_change, corrected_change = (
            np.einsum("fi,fi->f", _interpolated_values(result, place, frames.to_mesh(values)), normal)
            for values in (result.deviation_before, result.deviation_after)
        )
        remaining_height = np.full(len(corners), np.nan)  # unknown: the tool has no shape
    else:
        surfaces = [remaining_surface(path, centre, normal, cutter) for path, cutter in paths if cutter is not None]
        remaining_height, uncorrected_change, corrected_change, place = _deepest_surfaces(surfaces, len(corners))
    return Surface(
        corners=corners,
        normal=normal,
        before=uncorrected_change,
        after=corrected_change,
        bound=None if result.bound is None else _interpolated_values(result, place, result.bound),
        row=place.row,
        programmed=np.where(cut_row >= 0, -depth, np.maximum(remaining_height, 0.0)),
        programmed_row=cut_row,
    )


class _Place(NamedTuple):
    """Places of the path that leave F facets.

    :param row: (F,) row of the result at the end of the piece of path; −1: no piece leaves the facet.
    :param share: (F,) share of the piece from its start to the place.
    """

    row: Ints
    share: Array


def _tool_paths(
    result: Result, frames: Frames, cutters: Mapping[int, Cutter] | None, tool: Ints
) -> Iterator[tuple[CutPath, Cutter | None]]:
    """Yield the cutting path of each tool with its shape; parameters as of `surface`.

    If shapes are known, tools without a shape are left out; else each shape is None. Tools that cut nothing are left
    out.
    """
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
    """Return the depth by which the programmed path cuts into each facet, and the target (row of the result) there.

    :param corners: (F, 3, 3) corners of the facets [m], `normal` (F, 3) their outward normals.
    :returns: (F,) depth [m], 0 without a cut; (F,) row of the result that cuts deepest, −1 without a cut.
    """
    depth, row = np.zeros(len(corners)), np.full(len(corners), -1)
    mesh, centre = Mesh.of(corners, normal), corners.mean(axis=1)
    for path, cutter in paths:
        if cutter is None:
            add_tip_depths(mesh, path, depth, row)  # changes depth and row
            continue
        for first in range(0, len(centre), _CHUNK_FACETS):
            part = slice(first, first + _CHUNK_FACETS)
            tool_depth, tool_row = cut_depths(mesh, path, centre[part], normal[part], cutter)
            is_deeper = tool_depth > depth[part]
            row[part] = np.where(is_deeper, tool_row, row[part])
            depth[part] = np.where(is_deeper, tool_depth, depth[part])
    return depth, row


def _nearest_places(paths: list[tuple[CutPath, Cutter | None]], centre: Array, normal: Array) -> _Place:
    """Return the nearest places of all paths from which a tool of any shape can touch F facets.

    :param centre: (F, 3) centres of the facets [m], `normal` (F, 3) their outward normals.
    """
    row, share, distance = np.full(len(centre), -1), np.zeros(len(centre)), np.full(len(centre), np.inf)
    for path, _ in paths:
        for first in range(0, len(centre), _CHUNK_FACETS):
            part = slice(first, first + _CHUNK_FACETS)
            place = nearest_place(path, centre[part], normal[part])
            is_nearer = place.distance < distance[part]
            row[part] = np.where(is_nearer, place.row, row[part])
            share[part] = np.where(is_nearer, place.share, share[part])
            distance[part] = np.where(is_nearer, place.distance, distance[part])
    return _Place(row, share)


class _DeepestSurface(NamedTuple):
    """The surface that remains at F facets after all tools; heights and changes are NaN where no tool touches.

    :param programmed: (F,) height of the programmed surface over the facet [m].
    :param uncorrected_change: (F,) change of the surface by deviations without correction [m].
    :param corrected_change: (F,) change of the surface by deviations with the program as written [m].
    :param place: place of the path that leaves the surface with the program as written.
    """

    programmed: Array
    uncorrected_change: Array
    corrected_change: Array
    place: _Place


def _deepest_surfaces(surfaces: list[RemainingSurface], count: int) -> _DeepestSurface:
    """Return the surface that remains at F facets after all tools.

    :param surfaces: surface that each tool leaves at the facets.
    :param count: F, the number of facets.
    """
    programmed_height, deflected_heights = np.full(count, np.inf), np.full((2, count), np.inf)
    row, share = np.full(count, -1), np.zeros(count)
    for surface_of_tool in surfaces:
        is_deeper = surface_of_tool.deflected[1] < deflected_heights[1]  # 1: with the program as written
        row = np.where(is_deeper, surface_of_tool.row, row)
        share = np.where(is_deeper, surface_of_tool.share, share)
        programmed_height = np.minimum(programmed_height, surface_of_tool.programmed)
        deflected_heights = np.minimum(deflected_heights, surface_of_tool.deflected)
    programmed_height[row < 0] = np.nan
    deflected_heights[:, row < 0] = np.nan
    return _DeepestSurface(
        programmed_height,
        deflected_heights[0] - programmed_height,
        deflected_heights[1] - programmed_height,
        _Place(row, share),
    )


def _interpolated_values(result: Result, place: _Place, values: Array) -> Array:
    """Return values (F, …) at places of the path, linear between targets; NaN where there is no place.

    :param values: (K, …) values at the targets.
    """
    facets = np.flatnonzero(place.row >= 0)
    end = place.row[facets]
    weight = place.share[facets].reshape(-1, *(1,) * (values.ndim - 1))  # of as many axes as the values have
    facet_values: Array = np.full((len(place.row), *values.shape[1:]), np.nan)
    facet_values[facets] = (1.0 - weight) * values[piece_start(result, end)] + weight * values[end]
    return facet_values
