"""Read meshes: STL, PLY, OBJ and other formats of trimesh."""

from __future__ import annotations

import io
import logging
import re
from pathlib import Path
from typing import Any

import numpy as np

from postproc.errors import InputError

_NORMAL = re.compile(rb"facet\s+normal[^\r\n]*", re.IGNORECASE)
_BINARY_HEADER, _BINARY_FACET = 84, 50
"""Bytes of a binary STL file before its facets, and of each facet."""


def read_mesh(path: Path, error: type[InputError], kind: str) -> Any:
    """Return the triangles of a file as a `trimesh.Trimesh`, in the unit of the file.

    The normals of an ASCII STL file are not read: the order of the corners gives the outer side. Its name and comments
    may be in any encoding.

    :param error: exception to raise.
    :param kind: names the file in messages, such as "mesh of the part".
    :raises InputError: there is no such file, it cannot be read, or it has no surface.
    """
    import trimesh

    if not path.is_file():
        raise error(f"no such file: {kind}", file=str(path), advice="Give a mesh in mm: STL, PLY, OBJ or GLB.")
    logger = logging.getLogger("trimesh")
    logged, logger.disabled = logger.disabled, True  # faults become the exception below, without a traceback
    try:
        if path.suffix.lower() == ".stl":
            mesh: Any = trimesh.load(io.BytesIO(_plain_stl(path.read_bytes())), file_type="stl", force="mesh")
        else:
            mesh = trimesh.load(path, force="mesh")
        corners = np.asarray(mesh.triangles)
    except Exception as cause:  # trimesh raises whatever its readers raise
        advice = "Export it anew from CAD, in mm, as binary STL."
        raise error(f"the {kind} cannot be read ({cause})", file=str(path), advice=advice) from None
    finally:
        logger.disabled = logged
    if len(corners) == 0 or not np.isfinite(corners).all():
        advice = "Export the body from CAD as binary STL."
        raise error(f"the {kind} has no surface, or corners that are no numbers", file=str(path), advice=advice)
    return mesh


def _plain_stl(content: bytes) -> bytes:
    """Return the bytes of an STL file in a form that trimesh reads: text in ASCII, with normals of zero.

    A binary file is returned unchanged.
    """
    count = int.from_bytes(content[80:84], "little")
    if len(content) >= _BINARY_HEADER and len(content) == _BINARY_HEADER + _BINARY_FACET * count:
        return content
    if content.lstrip()[:5].lower() != b"solid":
        return content
    return _NORMAL.sub(b"facet normal 0 0 0", content).decode("ascii", errors="replace").replace("\ufffd", "?").encode()
