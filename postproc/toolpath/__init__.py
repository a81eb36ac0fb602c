"""The nominal tool path: poses anywhere on the motions of a program, and where to look at them.

A place on the path is (motion, t), t in (0, 1] along the motion. Row i of a `Toolpath` is one sample; the samples of a
motion stand together in order, and its end (t = 1) is always among them.
"""

from postproc.toolpath.path import (
    Arcs,
    Segments,
    Toolpath,
    at,
    flange_from_tcp,
    flange_points,
    positions,
    segments,
    starts,
    tangent,
)
from postproc.toolpath.places import DisplacementEstimate, Pieces, pieces, places

__all__ = [
    "Arcs",
    "DisplacementEstimate",
    "Pieces",
    "Segments",
    "Toolpath",
    "at",
    "flange_from_tcp",
    "flange_points",
    "pieces",
    "places",
    "positions",
    "segments",
    "starts",
    "tangent",
]
