"""A robot is a folder: `robot.urdf` (geometry, limits, speeds, masses) and `model.toml` (what was identified).

`load` reads the folder into a `RobotModel`: two chains (the controller's nominal geometry, and the actual
one with the calibrated geometry), the springs, the compensator, the covariance, and where each value comes from.
"""

from postproc.robot.chain import Chain
from postproc.robot.compensator_parameters import CompensatorPreload, CompensatorStiffness
from postproc.robot.flexible import elastic_chain
from postproc.robot.folder import assemble, find, load, shipped
from postproc.robot.model import Covariance, Discrepancy, Measured, RobotModel
from postproc.robot.model_file import BASE, FLANGE, JOINTS, Displacement, LinkSprings, ModelFile
from postproc.robot.parameter import CompensatorTorque, Parameter, Spring
from postproc.robot.parameters import COMPENSATOR, JOINT_COMPLIANCES, file_slopes
from postproc.robot.rest_parameters import CompensatorSize, LinkMass
from postproc.robot.spring_parameters import (
    LINK_AXES,
    Backlash,
    FadingPart,
    JointCompliance,
    Knee,
    LinkSpring,
    LostMotion,
)
from postproc.robot.transmission import GEAR_TERMS, Transmission, waves
from postproc.robot.value_sources import WITH_LINKS, SourcedValue

__all__ = [
    "BASE",
    "COMPENSATOR",
    "FLANGE",
    "GEAR_TERMS",
    "JOINTS",
    "JOINT_COMPLIANCES",
    "LINK_AXES",
    "WITH_LINKS",
    "Backlash",
    "Chain",
    "CompensatorPreload",
    "CompensatorSize",
    "CompensatorStiffness",
    "CompensatorTorque",
    "Covariance",
    "Discrepancy",
    "Displacement",
    "FadingPart",
    "JointCompliance",
    "Knee",
    "LinkMass",
    "LinkSpring",
    "LinkSprings",
    "LostMotion",
    "Measured",
    "ModelFile",
    "Parameter",
    "RobotModel",
    "SourcedValue",
    "Spring",
    "Transmission",
    "assemble",
    "elastic_chain",
    "file_slopes",
    "find",
    "load",
    "shipped",
    "waves",
]
