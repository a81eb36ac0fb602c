"""The nominal tool path: poses anywhere on the motions of a program, and where to look at them.

A place on the path is (motion, t), t in (0, 1] along the motion. Row i of a `Toolpath` is one sample; the samples of a
motion are consecutive and in order, and its end (t = 1) is always among them.
"""

from postproc.toolpath.cut_length import cut_lengths
from postproc.toolpath.path import (
    Arcs,
    JointMoves,
    Segments,
    Toolpath,
    at,
    base_of,
    circle_through,
    columns_in_root,
    continues,
    directions_in_root,
    flange_from_tcp,
    flange_points,
    points_in_base,
    pose_in_base,
    pose_in_root,
    positions,
    segments,
    starts,
    tangent,
    tool_of,
    wrench_in_root,
)
from postproc.toolpath.retracts import retract_motions
from postproc.toolpath.sampling import (
    DisplacementEstimate,
    Pieces,
    even_parts,
    even_places,
    pieces,
    places,
    swivel_pieces,
)
from postproc.toolpath.tip_speed import tip_speeds, turn_seconds

__all__ = [
    "Arcs",
    "DisplacementEstimate",
    "JointMoves",
    "Pieces",
    "Segments",
    "Toolpath",
    "at",
    "base_of",
    "circle_through",
    "columns_in_root",
    "continues",
    "cut_lengths",
    "directions_in_root",
    "even_parts",
    "even_places",
    "flange_from_tcp",
    "flange_points",
    "pieces",
    "places",
    "points_in_base",
    "pose_in_base",
    "pose_in_root",
    "positions",
    "retract_motions",
    "segments",
    "starts",
    "swivel_pieces",
    "tangent",
    "tip_speeds",
    "tool_of",
    "turn_seconds",
    "wrench_in_root",
]
