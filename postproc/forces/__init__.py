"""Cutting forces: their sources, and the wrench anywhere on a tool path.

Every source gives wrenches at places along motions, linear between them (`Knots`). `assign` gives them to the motions
of a program and returns `PathForces`, which gives the wrench at each sample.
"""

from postproc.forces.assignment import assign
from postproc.forces.axes import Axes, last_travel
from postproc.forces.path_forces import BEHIND_STEP, PathForces, displacement_estimate, refined_arcs, swing_places
from postproc.forces.sources import ForceSource, Knots, LawForces, StockInTime, read
from postproc.forces.table import first_pass_knots, piece_knots, read_force_csv, target_forces

__all__ = [
    "BEHIND_STEP",
    "Axes",
    "ForceSource",
    "Knots",
    "LawForces",
    "PathForces",
    "StockInTime",
    "assign",
    "displacement_estimate",
    "first_pass_knots",
    "last_travel",
    "piece_knots",
    "read",
    "read_force_csv",
    "refined_arcs",
    "swing_places",
    "target_forces",
]
