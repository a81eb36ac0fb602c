"""Where things are in the robot's root frame: robot, cell and the frames of a program put together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from postproc import kinematics
from postproc.cell import Cell
from postproc.frames import M_PER_MM, Array, inverse
from postproc.program import Ints, Program
from postproc.robot import RobotModel


@dataclass(frozen=True, slots=True, eq=False)
class InRoot:
    """A robot in its cell.

    :param robot: the robot with the cell's payload.
    :param cell: the cell.
    """

    robot: RobotModel
    cell: Cell

    @classmethod
    def of(cls, robot: RobotModel, cell: Cell) -> InRoot:
        """Put a robot into a cell."""
        load = cell.payload
        return cls(robot.with_payload(load.mass_kg, np.array([load.X, load.Y, load.Z]) * M_PER_MM), cell)

    def forward(self, q: Array) -> Array:
        """Return the flange (4, 4) in the root by the controller's geometry for joint angles (6,) [rad]."""
        pose: Array = kinematics.tcp(self.robot.nominal, np.asarray(q, dtype=float)[None], np.eye(4))[0][0]
        return pose

    @property
    def start_flange(self) -> Array:
        """Flange (4, 4) in the root where the program starts [m]."""
        return self.forward(self.cell.start_joints)

    @property
    def axis(self) -> str:
        """Axis of the tool frame that points from the spindle to the tip."""
        return self.cell.tool.axis

    @property
    def ramp(self) -> float:
        """Length over which the force changes [m]."""
        return self.cell.output.force_ramp_mm * M_PER_MM

    @property
    def tolerance(self) -> float:
        """What the predicted path may leave the nominal one by [m]."""
        return self.cell.tolerance

    @property
    def rest_is_nominal(self) -> bool:
        """True if without cutting force the tool stands exactly where the controller believes."""
        robot = self.robot
        return robot.geometry_is_nominal and robot.subtract_reference and self.cell.payload.mass_kg == 0.0

    def tool(self, program: Program, motion: Ints) -> Array:
        """Return `$TOOL` in the flange frame for motions (n,): (4, 4) if there is but one, else (n, 4, 4)."""
        if len(program.tools) == 1:
            return np.asarray(program.tools[0])
        return np.asarray(program.tools[program.motions.tool[motion]])

    def pose(self, program: Program, motion: Ints, pose_in_base: Array) -> Array:
        """Return poses (n, 4, 4) in the root of poses in `$BASE` of their motions."""
        return np.asarray(self._base(program, motion) @ pose_in_base)

    def back(self, program: Program, motion: Ints, pose_in_root: Array) -> Array:
        """Return poses (n, 4, 4) in `$BASE` of their motions of poses in the root."""
        return np.asarray(inverse(self._base(program, motion)) @ pose_in_root)

    def points_back(self, program: Program, motion: Ints, point_in_root: Array) -> Array:
        """Return points (n, 3) in `$BASE` of their motions of points in the root [m]."""
        base = self._base(program, motion)
        return np.asarray(np.einsum("...i,...ij->...j", point_in_root - base[..., :3, 3], base[..., :3, :3]))

    def wrench(self, program: Program, motion: Ints, wrench_in_base: Array) -> Array:
        """Return wrenches (n, 6) in root axes of wrenches in `$BASE` axes."""
        rotation = self._base(program, motion)[..., :3, :3]
        pairs = wrench_in_base.reshape(-1, 2, 3)
        return np.asarray(np.einsum("...ij,...kj->...ki", rotation, pairs)).reshape(-1, 6)

    def spread(self, program: Program, motion: Ints, spread_in_base: Array) -> Array:
        """Return L (n, 6, 6) of the covariance L·Lᵀ of wrenches, root axes, of that of their halves (n, 2, 3, 3)."""
        halves = np.einsum("...ij,...hjm->...him", self._base(program, motion)[..., :3, :3], spread_in_base)
        out = np.zeros((len(motion), 6, 6))
        out[:, :3, :3], out[:, 3:, 3:] = halves[:, 0], halves[:, 1]
        return out

    def _base(self, program: Program, motion: Ints) -> Array:
        if len(program.bases) == 1:
            return np.asarray(program.bases[0])
        return np.asarray(program.bases[program.motions.base[motion]])
