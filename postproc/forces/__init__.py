"""Cutting forces: their sources, and the wrench anywhere on a tool path.

Every source gives wrenches at places along motions, linear between them (`Knots`). `along` assigns them to the motions
of a program and returns `PathForces`, which gives the wrench at each sample.
"""

from postproc.forces.along import BEHIND_STEP, PathForces, along
from postproc.forces.axes import Axes
from postproc.forces.estimate import estimate
from postproc.forces.feed import last_travel
from postproc.forces.followed import followed, swung
from postproc.forces.knots import ForceSource, Knots
from postproc.forces.sources import read
from postproc.forces.table import read_force_csv
from postproc.forces.written import of_pieces, of_targets, once_a_line

__all__ = [
    "BEHIND_STEP",
    "Axes",
    "ForceSource",
    "Knots",
    "PathForces",
    "along",
    "estimate",
    "followed",
    "last_travel",
    "of_pieces",
    "of_targets",
    "once_a_line",
    "read",
    "read_force_csv",
    "swung",
]
