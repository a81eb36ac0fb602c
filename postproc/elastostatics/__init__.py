"""Elastostatics of the robot: equilibrium under load, compensation, Cartesian stiffness, uncertainty.

Source: Klimchik et al., Eq. (1), (4), (5), in the form of a potential (θ: deflections of the virtual springs, q + θ:
actual coordinates):

    V(θ) = ½ θᵀ K⁰ θ + [U_c(q₂+θ₂) − U_c(q₂) − U_c′(q₂) θ₂] + [U_g(q+θ) − U_g(q) − ∇U_g(q)·θ] − W_F(q+θ)

The loaded equilibrium is its minimum. The terms linear in θ inside the brackets are subtracted where the geometry
describes the robot at rest (`RobotModel.subtract_reference`). Wrenches are dead loads at the TCP: force [N] and
moment [N·m] on the tool, root axes. These functions take and return rows of samples; inside the package, as in
`kinematics`, the sample index is last.
"""

from postproc.elastostatics.balance import coordinates
from postproc.elastostatics.equilibrium import (
    Compensation,
    Deflection,
    cartesian_stiffness,
    compensate,
    deflect,
    deflection_by_parameter,
    largest_compliance,
    linear_compliance,
    linear_deflection,
    load_torques,
    loaded_pose,
    loaded_tip,
    tangent_compliance,
)
from postproc.elastostatics.expected_error import (
    HARMFUL_CHANCE,
    UNCERTAIN_CHANCE,
    ChanceOfGain,
    ExpectedErrorsAtPlaces,
    chances_of_gain,
    expected_errors,
)
from postproc.elastostatics.reversals import Reversals, reversals
from postproc.elastostatics.tool_spring import ToolSpring
from postproc.elastostatics.uncertainty import (
    LENGTH_95,
    LoadedPlaces,
    SourcesOfError,
    largest_length,
    position_bound,
    sensitivity,
    sources_of_error,
)

__all__ = [
    "HARMFUL_CHANCE",
    "LENGTH_95",
    "UNCERTAIN_CHANCE",
    "ChanceOfGain",
    "Compensation",
    "Deflection",
    "ExpectedErrorsAtPlaces",
    "LoadedPlaces",
    "Reversals",
    "SourcesOfError",
    "ToolSpring",
    "cartesian_stiffness",
    "chances_of_gain",
    "compensate",
    "coordinates",
    "deflect",
    "deflection_by_parameter",
    "expected_errors",
    "largest_compliance",
    "largest_length",
    "linear_compliance",
    "linear_deflection",
    "load_torques",
    "loaded_pose",
    "loaded_tip",
    "position_bound",
    "reversals",
    "sensitivity",
    "sources_of_error",
    "tangent_compliance",
]
