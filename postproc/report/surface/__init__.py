"""The surface of a part: what the tool will leave of it."""

from postproc.report.surface.facets import Surface, surface
from postproc.report.surface.files import glb, ply

__all__ = ["Surface", "glb", "ply", "surface"]
