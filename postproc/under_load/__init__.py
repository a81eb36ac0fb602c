"""The path of a program with its forces, tools and joint angles, in the root frame of the robot.

Correction, planning and reports start from a `PathUnderLoad`. After it, no stage needs the `$BASE` of a motion to find
the load on the robot.
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
