"""The part that a program makes: its mesh, and the shapes of the tools that touch it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from postproc import files, machining
from postproc.correction import Result
from postproc.errors import InputError
from postproc.frames import M_PER_MM, Array
from postproc.machining.tool import Cutter
from postproc.report.surface import Surface, surface

_MOST_FACETS = 60_000
_EDGE = np.radians(30.0)
"""Facets that meet at a smaller angle belong to one smooth surface."""
_ALONG = 60.0
"""Facets are divided until the longest is this share of the part, or there are too many."""


def surface_of(result: Result, part: Path, process: Path | None, placed: Array | None = None) -> Surface:
    """Return the deviations along the surface of a part.

    :param part: mesh in mm (STL, PLY, OBJ …).
    :param process: process.toml whose [tools] say the shapes; None: the nearest place of the path counts.
    :param placed: (4, 4) frame of the mesh in the robot root [m]; None: it is in the `$BASE` of the program.
    :raises InputError: the mesh or the process is unusable, or its frame is not stated and there are several `$BASE`.
    """
    corners, coarse = read_facets(part)
    if placed is None and len(result.program.bases) > 1:
        raise InputError(
            "the program has several $BASE: to which the part belongs is not known",
            file=str(part),
            advice="State the frame of the mesh in the robot root in the cell: [part] with X, Y, Z, A, B, C.",
        )
    cutters: dict[int, Cutter] | None = None
    if process is not None:
        cutters = {}
        for name, tool in machining.load(process).tools.items():
            radius = 0.5 * tool.diameter_mm * M_PER_MM
            corner = radius if tool.shape == "ball" else tool.corner_radius_mm * M_PER_MM
            cutters[0 if name == "default" else int(name)] = Cutter(radius, corner, tool.flutes)
    return surface(result, corners, cutters, placed, coarse)


def read_facets(path: Path) -> tuple[Array, Array]:
    """Return the facets of a mesh, large ones divided.

    :returns: corners (F, 3, 3) [m], and distance of each facet from the smooth surface it approximates (F,) [m].
    :raises InputError: there is no such file, it cannot be read, or it has no facet.
    """
    mesh = files.read_mesh(path, InputError, "mesh of the part")
    corners: Array = np.asarray(mesh.triangles) * M_PER_MM
    coarse = _chord_heights(mesh) * M_PER_MM
    if mesh.is_watertight and mesh.volume < 0.0:
        corners = corners[:, ::-1]
    return _divided(corners, coarse)


def _chord_heights(mesh: Any) -> Array:
    """Return the height (F,) of the arc over each facet, as its neighbours continue it; 0 on flat faces.

    A facet of width c that meets the next one at the angle θ is a chord of an arc of height c/2·tan(θ/4).
    """
    facets, angle = np.asarray(mesh.face_adjacency), np.asarray(mesh.face_adjacency_angles)
    smooth = angle < _EDGE
    ends = np.asarray(mesh.vertices)[np.asarray(mesh.face_adjacency_edges)[smooth]]
    length = np.maximum(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 1e-12)
    height = np.zeros(len(mesh.faces))
    for side in range(2):
        of = facets[smooth, side]
        width = 2.0 * np.asarray(mesh.area_faces)[of] / length
        np.maximum.at(height, of, 0.5 * width * np.tan(0.25 * angle[smooth]))
    return height


def _divided(corners: Array, coarse: Array) -> tuple[Array, Array]:
    """Return facets whose longest side is short compared with the part, up to a number of them, and their `coarse`."""
    limit = float(np.ptp(corners.reshape(-1, 3), axis=0).max()) / _ALONG
    while True:
        side = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)  # from corner i to i + 1
        longest = np.argmax(side, axis=1)
        split = side.max(axis=1) > limit
        if not split.any() or len(corners) + np.count_nonzero(split) > _MOST_FACETS:
            return corners, coarse
        rows, first = np.flatnonzero(split), longest[split]
        a, b, c = (corners[rows, (first + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        halves = [np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        corners = np.concatenate([corners[~split], *halves])
        coarse = np.concatenate([coarse[~split], coarse[split], coarse[split]])
