"""The part that a program makes: its mesh, and the shapes of the tools that touch it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from postproc import machining
from postproc.correction import Result
from postproc.errors import InputError
from postproc.frames import M_PER_MM, Array
from postproc.machining.tool import Cutter
from postproc.report.surface import Surface, surface

_MOST_FACETS = 60_000
_ALONG = 60.0
"""Facets are divided until the longest is this share of the part, or there are too many."""


def surface_of(result: Result, part: Path, process: Path | None, placed: Array | None = None) -> Surface:
    """Return what will become of the surface of a part.

    :param part: mesh in mm (STL, PLY, OBJ …).
    :param process: process.toml whose [tools] say the shapes; None: the nearest place of the path counts.
    :param placed: (4, 4) frame of the mesh in the robot root [m]; None: it is in the `$BASE` of the program.
    :raises InputError: the mesh or the process is unusable, or its frame is not stated and there are several `$BASE`.
    """
    corners = read_facets(part)
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
    return surface(result, corners, cutters, placed)


def read_facets(path: Path) -> Array:
    """Return the facets (F, 3, 3) of a mesh [m], large ones divided.

    :raises InputError: there is no such file, or no facet in it.
    """
    import trimesh

    try:
        mesh: Any = trimesh.load(path, force="mesh")
        corners: Array = np.asarray(mesh.triangles) * M_PER_MM
    except Exception as cause:  # trimesh raises what its readers raise
        raise InputError(f"no mesh that can be read ({cause})", file=str(path), advice="Give an STL in mm.") from None
    if len(corners) == 0 or not np.isfinite(corners).all():
        raise InputError("there is no surface in this file", file=str(path), advice="Give an STL in mm.")
    if mesh.is_watertight and mesh.volume < 0.0:
        corners = corners[:, ::-1]
    return _divided(corners)


def _divided(corners: Array) -> Array:
    """Return facets whose longest side is short beside the part, as far as there are not too many."""
    limit = float(np.ptp(corners.reshape(-1, 3), axis=0).max()) / _ALONG
    while True:
        side = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)  # from corner i to i + 1
        longest = np.argmax(side, axis=1)
        split = side.max(axis=1) > limit
        if not split.any() or len(corners) + np.count_nonzero(split) > _MOST_FACETS:
            return corners
        rows, first = np.flatnonzero(split), longest[split]
        a, b, c = (corners[rows, (first + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        halves = [np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        corners = np.concatenate([corners[~split], *halves])
