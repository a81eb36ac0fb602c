"""Cutting forces: one wrench for each sample of a tool path."""

from postproc.forces.per_motion import MotionForces, per_motion, read_force_csv
from postproc.forces.wrench import swing, wrench
from postproc.forces.written import of_targets

__all__ = ["MotionForces", "of_targets", "per_motion", "read_force_csv", "swing", "wrench"]
