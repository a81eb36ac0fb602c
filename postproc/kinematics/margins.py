"""How far configurations are from joint limits and singularities."""

from __future__ import annotations

import numpy as np

from postproc.frames import Array
from postproc.robot import RobotModel


def joint_margin(robot: RobotModel, q: Array) -> Array:
    """Return the distance to the nearer limit of each joint, (N, 6) [rad]; negative beyond it."""
    return np.minimum(q - robot.lower, robot.upper - q)


def smallest_singular_value(jacobian: Array) -> float:
    """Return the smallest singular value of all square Jacobians (N, 6, 6): metres and radians per radian.

    1/‖J⁻¹‖_F bounds it to within a factor √6, so that only the worst rows need a decomposition.
    """
    if len(jacobian) == 0:
        return float("nan")
    try:
        bound = 1.0 / np.linalg.norm(np.linalg.inv(jacobian), axis=(1, 2))
    except np.linalg.LinAlgError:
        return 0.0
    worst = np.flatnonzero(bound <= bound.min() * np.sqrt(6.0))
    worst = worst[np.argsort(bound[worst])][:2000]
    return float(np.linalg.svd(jacobian[worst], compute_uv=False)[:, -1].min())
