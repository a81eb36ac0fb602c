"""A program's path with all that acts on it: forces, tool, joint angles, in the root of the robot; made once.

What corrects, plans or reports starts from a `PathUnderLoad`; no stage after it asks which `$BASE` a motion lives in to
know what the robot feels.
"""

from postproc.under_load.bounds import ImpossiblePathError, unreachable
from postproc.under_load.motions import SHARE_OF_TOLERANCE, MotionsUnderLoad
from postproc.under_load.path import PathUnderLoad
from postproc.under_load.setting import RobotInCell

__all__ = [
    "SHARE_OF_TOLERANCE",
    "ImpossiblePathError",
    "MotionsUnderLoad",
    "PathUnderLoad",
    "RobotInCell",
    "unreachable",
]
