"""Shapes of the links of an arm: triangles from the meshes and primitives that a URDF names."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc.errors import ModelError
from postproc.files import read_mesh
from postproc.frames import Array
from postproc.robot.urdf import Geometry

_FINEST = 1e-3
"""Cells [m] that simplification begins with; each further grid is coarser by `_COARSER`."""
_COARSER = 1.25
"""Factor between grids: the first grid with few enough triangles has at least two thirds of the allowed triangles."""
_MAX_LISTED_PATHS = 3
"""Places of a missing mesh that a note names."""


class LinkShape(Struct, frozen=True, eq=False):
    """Triangles of the link that one joint carries.

    :param carrier: 0…5: the joint A1…A6; −1: the base, which no joint moves.
    :param points: (P, 3) in the frame of this joint, for the base in the root [m].
    :param faces: (F, 3) indices into `points` of the corners of each triangle.
    """

    carrier: int
    points: Array
    faces: NDArray[np.int64]

    def transform(self, pose: Array) -> LinkShape:
        """Return the surface in another frame; `pose` (4, 4): the present frame in the other frame [m]."""
        return replace(self, points=self.points @ pose[:3, :3].T + pose[:3, 3])

    def hull(self) -> LinkShape:
        """Return the convex hull."""
        mesh = self._mesh().convex_hull
        return replace(self, points=np.asarray(mesh.vertices), faces=np.asarray(mesh.faces, dtype=np.int64))

    def stl(self) -> bytes:
        """Return the surface as a binary STL file [m]."""
        return bytes(self._mesh().export(file_type="stl"))

    def _mesh(self) -> Any:
        """Return the triangles as a `trimesh.Trimesh` [m], without merging vertices."""
        import trimesh  # takes long to import

        return trimesh.Trimesh(self.points, self.faces, process=False)


def read(geometries: Iterable[Geometry], urdf: Path) -> tuple[list[LinkShape], list[str]]:
    """Return the surface of each geometry that can be read, in metres, and a sentence for each that cannot.

    :param urdf: path of the file that names the meshes, see `_candidate_paths`.
    """
    surfaces, problems = [], []
    for geometry in geometries:
        try:
            mesh = _mesh(geometry, urdf)
        except ModelError as error:
            problems.append(f"{geometry.file or geometry.kind}: {error.problem}")
            continue
        points, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64)
        surfaces.append(LinkShape(geometry.carrier, points * geometry.scale, faces).transform(geometry.pose))
    return surfaces, problems


def _mesh(geometry: Geometry, urdf: Path) -> Any:
    """Return a geometry in its own frame as a `trimesh.Trimesh` [m]; the scale of a mesh is not applied.

    :param urdf: path of the file that names the mesh.
    :raises ModelError: the mesh is missing or cannot be read, or the kind is unknown.
    """
    if geometry.kind == "mesh":
        paths = _candidate_paths(geometry.file, urdf)
        path = next((path for path in paths if path.is_file()), None)
        if path is None:
            raise ModelError(f"there is no such file; looked for {_path_list(paths)}", file=geometry.file)
        mesh = read_mesh(path, ModelError, "mesh")
        if path.suffix.lower() == ".dae":  # the only format of meshes here that states its unit
            mesh.convert_units("meters")
        return mesh
    from trimesh import creation  # takes long to import

    if geometry.kind == "box":
        return creation.box(extents=geometry.size)
    if geometry.kind == "cylinder":
        radius, length = geometry.size
        # 48 edges: a chord is 0.2 % of the radius off the circle
        return creation.cylinder(radius=radius, height=length, sections=48)
    if geometry.kind == "sphere":
        return creation.icosphere(subdivisions=3, radius=geometry.size[0])
    raise ModelError("is neither a mesh nor a box, cylinder or sphere")


def _path_list(paths: list[Path]) -> str:
    """Return the first `_MAX_LISTED_PATHS` paths as a list with commas, then the number of further paths."""
    suffix = f", and {len(paths) - _MAX_LISTED_PATHS} more above" if len(paths) > _MAX_LISTED_PATHS else ""
    return f"{', '.join(map(str, paths[:_MAX_LISTED_PATHS]))}{suffix}"


def _candidate_paths(name: str, urdf: Path) -> list[Path]:
    """Return the possible paths of a file that a URDF at the path `urdf` names, the likeliest first.

    `package://NAME/…` is below the package folder. This is a folder called NAME above the URDF, a folder NAME in a
    folder above the URDF, or a folder above the URDF whose package.xml states NAME. Other names are relative to the
    folder of the URDF, or absolute.
    """
    scheme, _, relative_path = name.rpartition("://")
    relative_path = relative_path.replace("\\", "/")
    if scheme not in ("package", "model"):
        return [Path(relative_path) if Path(relative_path).is_absolute() else urdf.parent / relative_path]
    package, _, subpath = relative_path.partition("/")
    paths = []
    for parent in urdf.resolve().parents:
        paths.append(parent / package / subpath)
        if parent.name == package or _states_package(parent / "package.xml", package):
            paths.append(parent / subpath)
    return paths


def _states_package(description: Path, package: str) -> bool:
    """Return whether a file `package.xml` exists and states the name of a package."""
    if not description.is_file():
        return False
    name = rf"<name>\s*{re.escape(package)}\s*</name>"
    return re.search(name, description.read_text(errors="replace")) is not None


def simplify(surface: LinkShape, face_limit: int) -> tuple[LinkShape, float]:
    """Return a surface with at most `face_limit` triangles, and the largest displacement of its corners [m].

    Corners in one cell of a grid are merged at their mean; the grid is as fine as the limit allows. A surface with few
    triangles is unchanged. Source: Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex
    scenes", 1993.
    """
    result, displacement, cell = surface, 0.0, _FINEST
    while len(result.faces) > face_limit:
        result, displacement = _cluster(surface, cell)
        cell *= _COARSER
    return result, displacement


def _cluster(surface: LinkShape, cell: float) -> tuple[LinkShape, float]:
    """Return the surface with one point for each cell of a grid, and the largest displacement of a point [m].

    Triangles with two corners in one cell are left out. Of several triangles with the same corners one remains. Source:
    vertex clustering (Rossignac and Borrel 1993).

    :param cell: edge of the cells [m].
    """
    grid_cell = np.floor(surface.points / cell).astype(np.int64)
    _, cluster, count = np.unique(grid_cell, axis=0, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(cluster, weights=values) for values in surface.points.T], axis=1) / count[:, None]
    displacement = float(np.linalg.norm(means[cluster] - surface.points, axis=1).max(initial=0.0))
    faces = cluster[surface.faces]
    has_area = (faces != np.roll(faces, 1, axis=1)).all(axis=1)  # no two corners in one cell
    faces = faces[has_area]
    _, first_rows = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)  # one of each set of equal triangles
    used_means, corners = np.unique(faces[np.sort(first_rows)], return_inverse=True)
    return replace(surface, points=means[used_means], faces=corners.reshape(-1, 3)), displacement


def join_by_carrier(surfaces: Iterable[LinkShape]) -> list[LinkShape]:
    """Return one surface for each carrier with the triangles of all its surfaces, the base first."""
    by_carrier: dict[int, list[LinkShape]] = {}
    for surface in surfaces:
        by_carrier.setdefault(surface.carrier, []).append(surface)
    merged_surfaces = []
    for carrier, parts in sorted(by_carrier.items()):
        first_points = np.cumsum([0, *(len(part.points) for part in parts)])  # row of each part's first point
        faces = np.concatenate([part.faces + first for part, first in zip(parts, first_points, strict=False)])
        merged_surfaces.append(LinkShape(carrier, np.concatenate([part.points for part in parts]), faces))
    return merged_surfaces
