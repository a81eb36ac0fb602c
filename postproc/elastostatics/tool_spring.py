"""Holder, spindle and tool as one spring at the tip, in series with the robot.

Its potential ½ δᵀ C⁻¹ δ is added to that of the robot; δ are displacement and rotation of the tip from where the arm
holds it, in the axes of the tool. For a dead force its minimum is δ = C Rᵀ F exactly, with R the orientation of the
tool where the arm holds it, and the arm feels the force where the tip has gone (the moment about where it was grows).
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import kinematics
from postproc.elastostatics.equilibrium import solve_equilibrium
from postproc.frames import Array, rotation_from_vector
from postproc.robot import RobotModel

_ROUNDS = 3
"""Of finding the orientation before the tool twists: each gains as many digits as the twist is small."""


class ToolSpring(Struct, frozen=True, eq=False):
    """The compliance of holder, spindle and tool at the tip.

    :param compliance: (6,) along X, Y, Z [m/N] and about them [rad/(N·m)] of the tool frame.
    """

    compliance: Array

    def given_way(self, orientation: Array, wrench: Array) -> Array:
        """Return how the tip gives way (n, 6): displacement [m] and rotation vector [rad].

        :param orientation: (n, 3, 3) of the tool frame in the axes of the wrench.
        :param wrench: (n, 6) on the tip [N, N·m].
        """
        in_tool = np.einsum("nij,nki->nkj", orientation, wrench.reshape(-1, 2, 3)) * self.compliance.reshape(2, 3)
        return np.asarray(np.einsum("nij,nkj->nki", orientation, in_tool)).reshape(-1, 6)

    def matrices(self, orientation: Array) -> Array:
        """Return the compliance (n, 6, 6) of tool frames with orientations (n, 3, 3), in the axes of these."""
        out = np.zeros((len(orientation), 6, 6))
        for half in (slice(0, 3), slice(3, 6)):
            out[:, half, half] = (orientation * self.compliance[half]) @ np.swapaxes(orientation, 1, 2)
        return out

    def held_by_arm(self, target: Array, wrench: Array) -> tuple[Array, Array]:
        """Return where the arm must hold the tool frame (n, 4, 4) for the tip to stand at its target, and its wrench.

        :param target: (n, 4, 4) of the loaded tip [m], and `wrench` (n, 6) on it, in the same axes.
        """
        held = target.copy()
        for _ in range(_ROUNDS):
            twist = self.given_way(held[:, :3, :3], wrench)
            held[:, :3, :3] = rotation_from_vector(-twist[:, 3:]) @ target[:, :3, :3]
        moved = self.given_way(held[:, :3, :3], wrench)[:, :3]
        held[:, :3, 3] = target[:, :3, 3] - moved
        return held, moved_to(wrench, moved)

    def tip(self, robot: RobotModel, x: Array, tool: Array, wrench: Array, guess: Array | None) -> tuple[Array, Array]:
        """Return where the loaded tip stands (3, n) [m], and how far the tool gave way of that (3, n).

        :param x: (nv, n) coordinates that the controller holds.
        :param tool: (3, 4, n) or (3, 4, 1).
        :param wrench: (6, n) at the tip, root axes [N, N·m].
        :param guess: (nv, n) deflections of the robot's springs, about.
        :raises NotConvergedError: the load is beyond what the springs hold.
        """
        moved = np.zeros((x.shape[1], 3))
        for _ in range(2):
            guess, tip = solve_equilibrium(robot, x, tool, moved_to(wrench.T, moved).T, guess)
            pose = kinematics.matrices(kinematics.posture(robot.loaded, x + guess, tool).pose)
            moved = self.given_way(pose[:, :3, :3], wrench.T)[:, :3]
        return tip + moved.T, moved.T


def moved_to(wrench: Array, lever: Array) -> Array:
    """Return wrenches (n, 6) about points that see where they act at (n, 3) [m]."""
    out = wrench.copy()
    out[:, 3:] += np.cross(lever, wrench[:, :3])
    return out
