"""Deviations of the tool along the surface of a part: of the programmed path, and before and after correction.

What remains after all passes is compared with what would remain if no tool deviated. Where passes overlap, the deepest
one counts (`envelope`). Without the shapes of the tools, the nearest place of the path from which a tool can touch
counts: its deviation d shifts the surface along the outward normal n by d·n.

The programmed path itself should leave the finished part: `Surface.programmed` says where it does not.
"""

from postproc.report.surface.encoding import glb, ply
from postproc.report.surface.map import Surface, surface

__all__ = ["Surface", "glb", "ply", "surface"]
