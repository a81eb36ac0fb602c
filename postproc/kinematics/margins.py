"""How far configurations are from joint limits and singularities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from postproc.frames import Array
from postproc.robot import RobotModel

_DECOMPOSED = 10_000


def joint_margin(robot: RobotModel, q: Array) -> Array:
    """Return the distance to the nearer limit of each joint, (N, 6) [rad]; negative beyond it."""
    return np.minimum(q - robot.lower, robot.upper - q)


def smallest_singular_value(jacobian: NDArray[np.floating]) -> float:
    """Return the smallest singular value of all square Jacobians (N, 6, 6): metres and radians per radian.

    Along a dense path it changes slowly: of more than some ten thousand rows only every n-th is decomposed at first,
    then all around the smallest.
    """
    if len(jacobian) == 0:
        return float("nan")
    stride = len(jacobian) // _DECOMPOSED + 1
    coarse = np.linalg.svd(jacobian[::stride], compute_uv=False)[:, -1]
    around = int(np.argmin(coarse)) * stride
    fine = jacobian[max(0, around - stride) : around + stride + 1]
    return float(min(coarse.min(), np.linalg.svd(fine, compute_uv=False)[:, -1].min()))
