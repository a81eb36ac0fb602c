"""Holder, spindle and tool as one spring at the tip, in series with the robot.

Its potential ½ δᵀ C⁻¹ δ is added to that of the robot; δ are displacement and rotation of the tip from where the arm
holds it, in the axes of the tool. For a dead force its minimum is δ = C Rᵀ F exactly, with R the orientation of the
tool where the arm holds it, and the arm feels the force where the tip has gone (the moment about where it was grows).
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import kinematics
from postproc.elastostatics.balance import elastic_coordinates
from postproc.elastostatics.equilibrium import solve_equilibrium
from postproc.frames import Array, rotation_from_vector
from postproc.robot import RobotModel

_ROUNDS = 3
"""Rounds that find the orientation before the tool twists: each reduces the error by a factor of about the twist."""


class ToolSpring(Struct, frozen=True, eq=False):
    """The compliance of holder, spindle and tool at the tip.

    :param compliance: (6,) along X, Y, Z [m/N] and about them [rad/(N·m)] of the tool frame.
    """

    compliance: Array

    def deflection(self, orientation: Array, wrench: Array) -> Array:
        """Return the deflection of the tip (n, 6): displacement [m] and rotation vector [rad].

        :param orientation: (n, 3, 3) of the tool frame in the axes of the wrench.
        :param wrench: (n, 6) on the tip [N, N·m].
        """
        # (n, 2, 3): force and moment, or displacement and rotation
        wrench_in_tool = np.einsum("nij,nki->nkj", orientation, wrench.reshape(-1, 2, 3))
        deflection_in_tool = wrench_in_tool * self.compliance.reshape(2, 3)
        return np.asarray(np.einsum("nij,nkj->nki", orientation, deflection_in_tool)).reshape(-1, 6)

    def matrices(self, orientation: Array) -> Array:
        """Return the compliance (n, 6, 6) of tool frames with orientations (n, 3, 3), in the axes of these."""
        compliance = np.zeros((len(orientation), 6, 6))
        for half in (slice(0, 3), slice(3, 6)):
            compliance[:, half, half] = (orientation * self.compliance[half]) @ np.swapaxes(orientation, 1, 2)
        return compliance

    def arm_target(self, target: Array, wrench: Array) -> tuple[Array, Array]:
        """Return the pose (n, 4, 4) [m] of the unbent tool for a loaded tip at its target, and the wrench (n, 6).

        The arm has to hold the unbent tool there. The wrench is that on the tip, with the moment about the tip of the
        unbent tool.

        :param target: (n, 4, 4) of the loaded tip [m], and `wrench` (n, 6) on it, in the same axes.
        """
        arm_pose = target.copy()
        for _ in range(_ROUNDS):
            twist = self.deflection(arm_pose[:, :3, :3], wrench)
            arm_pose[:, :3, :3] = rotation_from_vector(-twist[:, 3:]) @ target[:, :3, :3]
        tip_shift = self.deflection(arm_pose[:, :3, :3], wrench)[:, :3]
        arm_pose[:, :3, 3] = target[:, :3, 3] - tip_shift
        return arm_pose, wrench_on_arm(wrench, tip_shift)

    def loaded_tip(
        self, robot: RobotModel, q: Array, tool: Array, wrench: Array, guess: Array | None
    ) -> tuple[Array, Array]:
        """Return the position (n, 3) of the loaded tip [m], and the part of it (n, 3) that the tool deflects.

        :param q: (n, 6) joint angles that the controller holds [rad].
        :param tool: (4, 4) or (n, 4, 4) tool in the flange frame [m].
        :param wrench: (n, 6) at the tip, root axes [N, N·m].
        :param guess: (n, nv) start for the deflections of the robot's springs; None: they start at zero.
        :raises NotConvergedError: the load is too large for the springs.
        """
        x, tools = elastic_coordinates(robot, q.T), kinematics.components(tool)
        theta = None if guess is None else guess.T
        tip_shift = np.zeros((len(q), 3))
        # the second round has the moment that the force gets by the shift of the tip
        for _ in range(2):
            theta, tip = solve_equilibrium(robot, x, tools, wrench_on_arm(wrench, tip_shift).T, theta)
            pose = kinematics.matrices(kinematics.posture(robot.loaded, x + theta, tools).pose)
            tip_shift = self.deflection(pose[:, :3, :3], wrench)[:, :3]
        return tip.T + tip_shift, tip_shift


def wrench_on_arm(wrench: Array, lever: Array) -> Array:
    """Return the wrenches (n, 6) on the arm, with their moments about the tip of the unbent tool [N, N·m].

    :param wrench: (n, 6) on the deflected tip.
    :param lever: (n, 3) from the tip of the unbent tool to the deflected tip [m].
    """
    arm_wrench = wrench.copy()
    arm_wrench[:, 3:] += np.cross(lever, wrench[:, :3])
    return arm_wrench
