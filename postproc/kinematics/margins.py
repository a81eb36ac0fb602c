"""How far configurations are from joint limits and singularities."""

from __future__ import annotations

import numpy as np

from postproc.frames import Array
from postproc.robot import RobotModel


def joint_margin(robot: RobotModel, q: Array) -> Array:
    """Return the distance to the nearer limit of each joint, (N, 6) [rad]; negative beyond it."""
    return np.minimum(q - robot.lower, robot.upper - q)


def smallest_singular_value(jacobian: Array) -> Array:
    """Return the smallest singular value (N,) of square Jacobians (N, 6, 6): metres and radians per radian."""
    return np.asarray(np.linalg.svd(jacobian, compute_uv=False)[:, -1])
