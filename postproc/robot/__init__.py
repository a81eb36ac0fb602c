"""A robot is a folder: `robot.urdf` (geometry, limits, speeds, masses) and `model.toml` (what was identified).

`load` reads the folder into a `RobotModel`: two chains (the controller's nominal geometry, and the actual one with the
calibrated geometry), the springs, the compensator, the covariance, and the source of each value.
"""

from postproc.robot.chain import Chain, elastic_chain
from postproc.robot.folder import assemble, find, load, shipped_models
from postproc.robot.model import (
    FORCES,
    GEAR_TERMS,
    Covariance,
    Discrepancy,
    ForceFactor,
    GeometryError,
    MeasuredRange,
    RobotModel,
    SourcedValue,
    Transmission,
    waves,
)
from postproc.robot.model_file import BASE, FLANGE, JOINTS, Displacement, LinkSprings, ModelFile
from postproc.robot.parameters import (
    COMPENSATOR,
    JOINT_COMPLIANCES,
    LINK_AXES,
    PER_URAD,
    Backlash,
    CompensatorPreload,
    CompensatorSize,
    CompensatorStiffness,
    CompensatorTorque,
    FadingPart,
    GearCoupling,
    JointCompliance,
    Knee,
    LinkMass,
    LinkSpring,
    LostMotion,
    Parameter,
    PoseWave,
    Spring,
    file_slopes,
)

WITH_LINKS = "k1 … k6, of A1 … A6, contain the spring of the link about the same axis"
"""State it wherever their values are shown: readings cannot separate the two."""

__all__ = [
    "BASE",
    "COMPENSATOR",
    "FLANGE",
    "FORCES",
    "GEAR_TERMS",
    "JOINTS",
    "JOINT_COMPLIANCES",
    "LINK_AXES",
    "PER_URAD",
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
    "ForceFactor",
    "GearCoupling",
    "GeometryError",
    "JointCompliance",
    "Knee",
    "LinkMass",
    "LinkSpring",
    "LinkSprings",
    "LostMotion",
    "MeasuredRange",
    "ModelFile",
    "Parameter",
    "PoseWave",
    "RobotModel",
    "SourcedValue",
    "Spring",
    "Transmission",
    "assemble",
    "elastic_chain",
    "file_slopes",
    "find",
    "load",
    "shipped_models",
    "waves",
]
