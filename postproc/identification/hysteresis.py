"""Loads up and down: gears with backlash or friction deflect differently after a larger load.

Where a configuration is measured under the same load twice, a larger one between, the difference of the two readings is
the hysteresis of the joints. It is reported by joint; as an error of configurations left out it is in the bound
already.
"""

from __future__ import annotations

import numpy as np

from postproc import elastostatics, kinematics
from postproc.frames import MM_PER_M, Array, norm
from postproc.identification.displacements import measured_displacements, visible
from postproc.identification.measurements import Measurements
from postproc.identification.observability import joint_torques
from postproc.identification.placement import Placement
from postproc.program import Ints
from postproc.robot import JOINTS, RobotModel

_SAME_LOAD, _LARGER = 0.02, 1.2
"""Difference of two loads that are one, and what a load is larger by, as a share."""
_TORQUE = 0.05
"""Share of the largest torque on a joint above which the flank of its gear is known."""
_CERTAIN = 4.0
"""Standard errors beyond which a loop is no noise."""
_LEAST = 1e-5
"""Half width of a loop [rad] that is worth a word."""


def loops(robot: RobotModel, data: Measurements, placement: Placement) -> list[str]:
    """Return the hysteresis of each joint in sentences; none where no load was measured both ways."""
    from scipy.optimize import nnls

    up, down = up_and_down(data)
    if len(up) == 0:
        return []
    moved, seen = measured_displacements(data, placement), visible(data)[..., 0]
    both = (seen[up] * seen[down]).astype(bool)
    count = np.maximum(data.means()[1][data.loaded], 1.0)
    noise = data.sigma * np.sqrt(1.0 / count[up] + 1.0 / count[down])
    torque = joint_torques(robot, data)
    flank = np.sign(torque[up]) * (np.abs(torque[up]) > _TORQUE * np.abs(torque).max(axis=0))
    x = elastostatics.coordinates(robot, data.q[data.state_config[data.loaded[up]]])
    columns = np.empty((*both.shape, 3, 6))
    for index, point in enumerate(placement.points):
        tool = np.eye(4)
        tool[:3, 3] = point
        jacobian = kinematics.tcp(robot.actual, x, tool)[1][:, :3, list(robot.actuated)]
        columns[:, index] = jacobian * flank[:, None]
    rows = (columns / noise[..., None, None])[both].reshape(-1, 6)
    target = ((moved[down] - moved[up]) / noise[..., None])[both].ravel()
    scale = norm(rows.T)
    reached = np.flatnonzero(scale > 0.0)
    found, _ = nnls(rows[:, reached] / scale[reached], target)
    inverse = np.linalg.pinv((rows[:, reached] / scale[reached]).T @ (rows[:, reached] / scale[reached]))
    clear = found > _CERTAIN * np.sqrt(np.diag(inverse))
    half = 0.5 * found / scale[reached]
    return [
        f"loads up and down differ: looks like {half[row] * MM_PER_M:.3f} mrad of backlash or friction in "
        f"{JOINTS[joint]}"
        for row, joint in enumerate(reached.tolist())
        if clear[row] and half[row] > _LEAST
    ]


def up_and_down(data: Measurements) -> tuple[Ints, Ints]:
    """Return pairs of rows of the loaded states: the same load of a configuration before and after a larger one."""
    load, config = data.wrench[data.loaded], data.state_config[data.loaded]
    number, size = data.load[data.loaded], norm(load)
    pairs = [
        (first, second)
        for first in range(len(load))
        for second in np.flatnonzero(config == config[first]).tolist()
        if number[first] < number[second]
        and norm(load[first] - load[second]) < _SAME_LOAD * size[first]
        and _larger_between(size, number, config, first, second)
    ]
    up, down = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return up, down


def _larger_between(size: Array, number: Array, config: Ints, first: int, second: int) -> bool:
    between = (config == config[first]) & (number > number[first]) & (number < number[second])
    return bool((size[between] > _LARGER * size[first]).any())
