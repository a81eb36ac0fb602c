"""Kinematics of the arm for many thousand configurations at once, in plain numpy.

The planner asks for joint axes and origins too, which `kinematics.tcp` does not give. Same geometry (the controller's),
same signs; a plan needs it to a millimetre only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from postproc import kinematics
from postproc.frames import Array
from postproc.robot import FLANGE, RobotModel


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """Six revolute joints in a chain.

    :param placement: (6, 4, 4) of each joint on the link before it [m].
    :param axis: (6, 3) unit axis of each joint in its own frame.
    :param flange: (4, 4) on the last link [m].
    """

    placement: Array
    axis: Array
    flange: Array

    @classmethod
    def of(cls, robot: RobotModel) -> Arm:
        """Take the controller's geometry of a robot."""
        model = robot.nominal
        placement = np.array([place.homogeneous for place in model.jointPlacements][1:])
        _, jacobian = kinematics.tcp(model, np.zeros((1, 6)), np.eye(4))
        turned, axis = np.eye(3), np.empty((6, 3))
        for index in range(6):
            turned = turned @ placement[index, :3, :3]
            axis[index] = turned.T @ jacobian[0, 3:, index]
        return cls(placement, axis, model.frames[model.getFrameId(FLANGE)].placement.homogeneous.copy())

    def pose(self, q: Array) -> Posed:
        """Return where everything is at configurations q (N, 6) [rad]."""
        here = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        origin, direction = np.empty((len(q), 6, 3)), np.empty((len(q), 6, 3))
        for index in range(6):
            x, y, z = self.axis[index]
            hat = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            turn = np.zeros((len(q), 4, 4))
            angle = q[:, index, None, None]
            turn[:, :3, :3] = np.eye(3) + np.sin(angle) * hat + (1.0 - np.cos(angle)) * (hat @ hat)
            turn[:, 3, 3] = 1.0
            here = here @ self.placement[index]
            origin[:, index] = here[:, :3, 3]
            direction[:, index] = here[:, :3, :3] @ self.axis[index]
            here = here @ turn
        return Posed(origin, direction, here @ self.flange)


@dataclass(frozen=True, slots=True, eq=False)
class Posed:
    """The arm in N configurations, root frame.

    :param origin: (N, 6, 3) of the joints [m].
    :param axis: (N, 6, 3) unit axes.
    :param flange: (N, 4, 4) [m].
    """

    origin: Array
    axis: Array
    flange: Array

    def point(self, in_flange: Array) -> Array:
        """Return points (N, P, 3) in the root, of points (P, 3) in the flange frame [m]."""
        placed: Array = np.einsum("nij,pj->npi", self.flange[:, :3, :3], in_flange) + self.flange[:, None, :3, 3]
        return placed

    def velocity(self, point: Array) -> Array:
        """Return how points (N, P, 3) move per radian of each joint: (N, P, 6, 3) [m/rad], ω × (p − o)."""
        return np.asarray(np.cross(self.axis[:, None], point[:, :, None] - self.origin[:, None]))
