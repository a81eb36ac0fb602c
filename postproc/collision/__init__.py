"""Distances between arm, tool and obstacles: at poses, and along a path with a bound on the motion between samples.

The arm has the geometry of the controller: the tool of a corrected program is on the nominal path, so the arm is where
the nominal geometry has it, but for its deflection. Bodies are convex solids and meshes; FCL computes their distances
(Pan, Chitta, Manocha, "FCL: a general purpose library for collision and proximity queries", ICRA 2012).
"""

from postproc.collision.along import Hits, SmallestDistance, hits, pair_hits, path_hits
from postproc.collision.bodies import Body, Cylinder, Scene, cylinders, inscribed_capsule
from postproc.collision.distance import Clearance, Solids, clearance, link_frames

__all__ = [
    "Body",
    "Clearance",
    "Cylinder",
    "Hits",
    "Scene",
    "SmallestDistance",
    "Solids",
    "clearance",
    "cylinders",
    "hits",
    "inscribed_capsule",
    "link_frames",
    "pair_hits",
    "path_hits",
]
