"""Sensitivity of readings to the joint compliances.

`Arm` gives joint axes and origins in many thousand configurations at once, by the controller's geometry; `Readings` the
sensitivity of the readings. Source: Klimchik et al., Eq. (2), (8): the displacement of a point is A k with columns
J_i J_iᵀ F; here the load acts at the load point and the displacement is that of each reference point. Derivatives for
the search: for a chain of revolute joints ∂v_i/∂q_a = ω_min(a,i) × v_max(a,i).
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import kinematics
from postproc.chunks import Columns
from postproc.frames import Array
from postproc.robot import Chain, RobotModel


class Arm(Struct, frozen=True, eq=False):
    """Arm of six revolute joints in a chain."""

    chain: Chain

    @classmethod
    def of(cls, robot: RobotModel) -> Arm:
        """Return the arm with the geometry of the controller of a robot."""
        return cls(robot.nominal)

    def pose(self, q: Array) -> ArmPoses:
        """Return joint origins, axes and flange poses at configurations q (N, 6) [rad]."""
        state = kinematics.posture(self.chain, q.T)
        origin, axis = np.empty((2, 6, 3, len(q)))
        for joint in range(6):  # a vector that is the same at all configurations has one column
            origin[joint], axis[joint] = state.origin[joint], state.axis[joint]
        return ArmPoses(origin.transpose(2, 0, 1), axis.transpose(2, 0, 1), kinematics.matrices(state.pose))


class ArmPoses(Columns, frozen=True, eq=False):
    """The arm in N configurations, root frame.

    :param origin: (N, 6, 3) origins of the joints [m].
    :param axis: (N, 6, 3) unit axes of the joints.
    :param flange: (N, 4, 4) poses of the flange [m].
    """

    origin: Array
    axis: Array
    flange: Array

    def point(self, in_flange: Array) -> Array:
        """Return the positions (N, P, 3) in the root frame of points (P, 3) in the flange frame [m]."""
        in_root: Array = np.einsum("nij,pj->npi", self.flange[:, :3, :3], in_flange) + self.flange[:, None, :3, 3]
        return in_root

    def velocity(self, point: Array) -> Array:
        """Return the derivatives (N, P, 6, 3) [m/rad] of points (N, P, 3) by the joint angles: axis × (point − origin).

        :param point: in the root frame [m].
        """
        return np.asarray(np.cross(self.axis[:, None], point[:, :, None] - self.origin[:, None]))


_JOINT_NEARER_TO_BASE = np.minimum.outer(np.arange(6), np.arange(6))
_JOINT_NEARER_TO_TOOL = np.maximum.outer(np.arange(6), np.arange(6))
"""(6, 6) for each pair of joints the index of the one that is nearer to the base, and to the tool: axes move with
joints before them."""


def direction(tilt: Array) -> Array:
    """Return unit directions (N, 3) of the load in root axes; straight down for a tilt of zero.

    :param tilt: (N, 2) vectors along the horizontal part of the load, as long as its angle from straight down [rad].
    """
    angle = np.linalg.norm(tilt, axis=-1)
    sinc = np.sinc(angle / np.pi)  # sin(angle) / angle, 1 for a vertical load
    return np.concatenate([tilt * sinc[..., None], -np.cos(angle)[..., None]], axis=-1)


def direction_slope(tilt: Array) -> Array:
    """Return the derivatives (N, 3, 2) of the directions of the load by tilts (N, 2) [rad], see `direction`.

    The direction is (t·sinc α, −cos α) for a tilt t of the length α. Its derivative is
    (sinc α·1 + (cos α − sinc α)/α² · t tᵀ, sinc α · tᵀ).
    """
    angle = np.linalg.norm(tilt, axis=-1)
    sinc = np.sinc(angle / np.pi)  # sin(angle) / angle
    # (cos α − sinc α)/α²; near 0 the quotient loses all digits, and its limit −1/3 is taken
    is_large = angle > 1e-4
    sinc_slope = np.where(is_large, (np.cos(angle) - sinc) / np.where(is_large, angle, 1.0) ** 2, -1.0 / 3.0)
    slope = np.empty((*tilt.shape[:-1], 3, 2))
    slope[..., :2, :] = (
        sinc[..., None, None] * np.eye(2) + sinc_slope[..., None, None] * tilt[..., :, None] * tilt[..., None, :]
    )
    slope[..., 2, :] = sinc[..., None] * tilt
    return slope


class Readings(Struct, frozen=True, eq=False):
    """Arm, load and reference points of a measurement.

    :param arm: geometry.
    :param load_point: (3,) in the flange frame [m].
    :param points: (P, 3) reference points in the flange frame [m].
    :param force: size of the load [N].
    :param noise: standard deviation of one coordinate of a measured displacement [m].
    :param unit_compliance: (6,) unit of each compliance [rad/(N·m)]: the robot's value, so that results are relative.
    :param identified_joints: (p,) joints, from 0, whose compliance is identified.
    """

    arm: Arm
    load_point: Array
    points: Array
    force: float
    noise: float
    unit_compliance: Array
    identified_joints: tuple[int, ...] = (0, 1, 2, 3, 4, 5)

    def regressor(self, q: Array, load: Array) -> Array:
        """Return the whitened derivatives (N, 3P, 6) of the displacements of the points by the relative compliances.

        It is the regressor of Eq. (8) of Klimchik et al., over the noise.

        :param q: (N, 6) joint angles [rad].
        :param load: (N, 3) forces [N], or (N, 6) with moments [N·m], at the load point, root axes.
        """
        arm_pose = self.arm.pose(q)
        at_load = arm_pose.velocity(arm_pose.point(self.load_point[None]))[:, 0]
        torque = np.einsum("nij,nj->ni", at_load, load[:, :3])
        if load.shape[1] == 6:
            torque += np.einsum("nij,nj->ni", arm_pose.axis, load[:, 3:])
        torque *= self.unit_compliance / self.noise  # displacements over their noise, per unit of compliance
        velocity = arm_pose.velocity(arm_pose.point(self.points)) * torque[:, None, :, None]
        return np.ascontiguousarray(np.swapaxes(velocity, 2, 3)).reshape(len(q), 3 * len(self.points), 6)

    def torque(self, q: Array, load: Array) -> Array:
        """Return the torques on A1…A6 (N, 6) [N·m] at joint angles q (N, 6) [rad].

        :param load: (N, 3) forces at the load point, root axes [N].
        """
        arm_pose = self.arm.pose(q)
        at_load = arm_pose.velocity(arm_pose.point(self.load_point[None]))[:, 0]
        return np.asarray(np.einsum("nij,nj->ni", at_load, load))

    def information(self, q: Array, tilt: Array) -> Array:
        """Return the information matrix (N, p, p) of each measurement, on the p identified compliances.

        :param q: (N, 6) joint angles [rad].
        :param tilt: (N, 2) of the load [rad], along its horizontal part, as long as its angle from straight down.
        """
        return self.information_of(q, self.force * direction(tilt))

    def information_of(self, q: Array, load: Array) -> Array:
        """Return the information matrix (N, p, p) of each measurement, on the p identified compliances.

        :param q: (N, 6) joint angles [rad].
        :param load: (N, 3) forces [N], or (N, 6) with moments [N·m], at the load point, root axes.
        """
        regressor = self.regressor(q, load)[:, :, list(self.identified_joints)]
        return np.asarray(np.swapaxes(regressor, 1, 2) @ regressor)

    def slope(self, q: Array, tilt: Array, weight: Array) -> Array:
        """Return the gradient (N, 8) of tr(weight·information) by joint angles (6) and tilt (2).

        A column of the regressor is the velocity of the points by a joint times the torque on the joint; both change
        with the joint angles. For revolute joints ∂v_i/∂q_a = ω_min(a,i) × v_max(a,i).

        :param q: (N, 6) joint angles, and `tilt` (N, 2) of the load [rad].
        :param weight: (N, p, p) symmetric, on the p identified compliances.
        """
        joints = list(self.identified_joints)
        arm_pose = self.arm.pose(q)
        load = self.force * direction(tilt)
        factor = self.unit_compliance / self.noise
        at_load = arm_pose.velocity(arm_pose.point(self.load_point[None]))[:, 0]
        velocity = arm_pose.velocity(arm_pose.point(self.points))
        torque = np.einsum("nij,nj->ni", at_load, load) * factor
        columns = velocity * torque[:, None, :, None]  # (N, P, 6, 3)
        # half the gradient by the columns, and by the torques
        by_columns = np.zeros_like(columns)
        by_columns[:, :, joints] = np.einsum("npix,nij->npjx", columns[:, :, joints], weight)
        by_torque = np.einsum("npix,npix->ni", by_columns, velocity) * factor
        # derivatives of the velocities i by the joint angles a: (N, P, i, a, 3) and (N, i, a, 3)
        velocity_slope = np.cross(
            arm_pose.axis[:, _JOINT_NEARER_TO_BASE][:, None], velocity[:, :, _JOINT_NEARER_TO_TOOL]
        )
        at_load_slope = np.cross(arm_pose.axis[:, _JOINT_NEARER_TO_BASE], at_load[:, _JOINT_NEARER_TO_TOOL])
        gradient = np.empty((len(q), 8))
        gradient[:, :6] = np.einsum("npix,npiax,ni->na", by_columns, velocity_slope, torque)
        gradient[:, :6] += np.einsum("ni,niax,nx->na", by_torque, at_load_slope, load)
        gradient[:, 6:] = self.force * np.einsum("ni,nix,nxt->nt", by_torque, at_load, direction_slope(tilt))
        return 2.0 * gradient
