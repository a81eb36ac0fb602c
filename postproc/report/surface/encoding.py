"""Files of a coloured surface: PLY and glTF."""

from __future__ import annotations

from typing import Any

import numpy as np

from postproc.frames import MM_PER_M, Array
from postproc.report.surface.map import Surface

_UNTOUCHED_COLOUR = (150, 150, 150)
"""Grey (red, green, blue) of facets that no tool reaches."""
_SCALE_COLOURS = np.array([[179, 88, 6], [247, 247, 247], [5, 48, 97]], dtype=float)
"""Colours (red, green, blue) of the deviations −limit, 0 and limit: orange where the tool gouges, blue where it leaves
material; distinct for colour-blind eyes."""
_PLY_HEAD = """ply
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
"""Vertices and faces of a binary PLY file."""


def ply(surface: Surface, limit: float) -> bytes:
    """Return a PLY file in mm, coloured by the deviation without correction.

    Facets share no vertices, so that each facet has one colour.

    :param limit: deviation [m] from which on the colour does not change.
    """
    count = len(surface.corners)
    bound = np.full(count, np.nan) if surface.bound is None else surface.bound
    vertices = np.empty(3 * count, dtype=_VERTEX)
    vertices["at"] = surface.corners.reshape(-1, 3) * MM_PER_M
    vertices["colour"] = np.repeat(_colours(surface.before, limit), 3, axis=0)
    vertices["values"] = np.repeat(np.stack([surface.before, surface.after, bound], axis=1) * MM_PER_M, 3, axis=0)
    faces = np.empty(count, dtype=_FACE)
    faces["count"], faces["corners"] = 3, np.arange(3 * count).reshape(-1, 3)
    return _PLY_HEAD.format(vertices=3 * count, faces=count).encode() + vertices.tobytes() + faces.tobytes()


def glb(surface: Surface, limit: float) -> bytes:
    """Return a binary glTF file in mm, like the mesh of the part, with the facets and colours of `ply`.

    :param limit: deviation [m] from which on the colour does not change.
    """
    import trimesh  # takes long to import

    count = len(surface.corners)
    colours = np.full((3 * count, 4), 255, dtype=np.uint8)
    colours[:, :3] = np.repeat(_colours(surface.before, limit), 3, axis=0)
    faces = np.arange(3 * count).reshape(-1, 3)
    points = surface.corners.reshape(-1, 3) * MM_PER_M
    mesh: Any = trimesh.Trimesh(points, faces, vertex_colors=colours, process=False)
    return bytes(mesh.export(file_type="glb"))


def _colours(values: Array, limit: float) -> np.ndarray:
    """Return colours (n, 3), 0 to 255, of deviations (n,) [m]; grey for NaN.

    :param limit: deviation [m] from which on the colour does not change.
    """
    share = np.clip(np.nan_to_num(values) / limit, -1.0, 1.0)
    colour = np.stack([np.interp(share, [-1.0, 0.0, 1.0], _SCALE_COLOURS[:, channel]) for channel in range(3)], axis=1)
    colour[np.isnan(values)] = _UNTOUCHED_COLOUR
    return np.round(colour).astype(np.uint8)
