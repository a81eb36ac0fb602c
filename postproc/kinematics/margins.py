"""Margins of joint angles to joint limits and to singular poses."""

from __future__ import annotations

import numpy as np

from postproc.frames import Array
from postproc.kinematics.forward import tcp
from postproc.robot import RobotModel

_LOOKED_AT = 2_000
"""Rows of a path that are evaluated in the first pass."""


def joint_margin(robot: RobotModel, q: Array) -> Array:
    """Return the smallest distance (6,) [rad] of each joint to its limits, negative beyond them; q: (N, 6), N ≥ 1."""
    low, high = np.array([(angle.min(), angle.max()) for angle in q.T]).T  # much faster than along short rows
    return np.asarray(np.minimum(low - robot.lower, robot.upper - high))


def smallest_singular_value(robot: RobotModel, q: Array, tool: Array) -> float:
    """Return the smallest singular value of the tool's Jacobian along a path: metres and radians per radian.

    It changes slowly along a dense path. Of more than `_LOOKED_AT` rows, every n-th is evaluated first, then all rows
    around the smallest.

    :param q: (N, 6) joint angles [rad]; the result is NaN if N is 0.
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    """
    if len(q) == 0:
        return float("nan")
    stride = len(q) // _LOOKED_AT + 1

    def tools(rows: slice) -> Array:
        return tool if tool.ndim == 2 else tool[rows]

    some = slice(None, None, stride)
    _, jacobian = tcp(robot.nominal, q[some], tools(some))
    squares = np.linalg.eigvalsh(jacobian @ np.swapaxes(jacobian, 1, 2))  # good enough to find the place, and faster
    around = int(np.argmin(squares[:, 0])) * stride
    rows = slice(max(0, around - stride), around + stride + 1)
    return float(singular_values(robot, q[rows], tools(rows)).min())


def singular_values(robot: RobotModel, q: Array, tool: Array) -> Array:
    """Return the smallest singular value (N,) of the tool's Jacobian: metres and radians per radian.

    :param q: (N, 6) joint angles [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    """
    _, jacobian = tcp(robot.nominal, q, tool)
    return np.asarray(np.linalg.svd(jacobian, compute_uv=False)[:, -1])
