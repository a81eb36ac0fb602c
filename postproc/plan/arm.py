"""Joint axes and origins of the arm in many thousand configurations at once, by the controller's geometry."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import kinematics
from postproc.frames import Array
from postproc.robot import Chain, RobotModel


class Arm(Struct, frozen=True, eq=False):
    """Six revolute joints in a chain."""

    chain: Chain

    @classmethod
    def of(cls, robot: RobotModel) -> Arm:
        """Take the controller's geometry of a robot."""
        return cls(robot.nominal)

    def pose(self, q: Array) -> Posed:
        """Return where everything is at configurations q (N, 6) [rad]."""
        state = kinematics.posture(self.chain, q.T)
        origin, axis = (
            np.array([np.broadcast_to(vector, (3, len(q))) for vector in vectors]).transpose(2, 0, 1)
            for vectors in (state.origin, state.axis)
        )
        return Posed(origin, axis, kinematics.matrices(state.pose))


class Posed(Struct, frozen=True, eq=False):
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
