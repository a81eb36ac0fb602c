"""Elastostatics of the robot: virtual springs, equilibrium under load, Cartesian stiffness, uncertainty.

Source: Klimchik et al., Eq. (1), (4), (5), in the form of a potential (θ: deflections of the virtual springs, q + θ:
actual coordinates):

    V(θ) = ½ θᵀ K⁰ θ + [U_c(q₂+θ₂) − U_c(q₂) − U_c′(q₂) θ₂] + [U_g(q+θ) − U_g(q) − ∇U_g(q)·θ] − W_F(q+θ)

The loaded equilibrium is its minimum. The terms linear in θ inside the brackets are subtracted where the geometry
already holds the state of rest (`RobotModel.subtract_reference`). Wrenches are dead loads at the TCP: force [N] and
moment [N·m] on the tool, root axes.
"""

from postproc.elastostatics.balance import Balance, asked, held
from postproc.elastostatics.by_parameter import moved_by
from postproc.elastostatics.equilibrium import Deflection, deflect, softness, solve_equilibrium, springs_at
from postproc.elastostatics.reversals import Reversals, reversals
from postproc.elastostatics.springs import commanded, coordinates, spread, spring_deflection
from postproc.elastostatics.stiffness import cartesian_stiffness, linear_deflection, tangent_compliance
from postproc.elastostatics.tool_spring import ToolSpring
from postproc.elastostatics.uncertainty import FORCES, largest_source, position_bound, sensitivity

__all__ = [
    "FORCES",
    "Balance",
    "Deflection",
    "Reversals",
    "ToolSpring",
    "asked",
    "cartesian_stiffness",
    "commanded",
    "coordinates",
    "deflect",
    "held",
    "largest_source",
    "linear_deflection",
    "moved_by",
    "position_bound",
    "reversals",
    "sensitivity",
    "softness",
    "solve_equilibrium",
    "spread",
    "spring_deflection",
    "springs_at",
    "tangent_compliance",
]
