"""A robot in its cell: what it carries, where it starts, and how the tool gives way there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from postproc import elastostatics, kinematics
from postproc.cell import Cell
from postproc.compensation import Compensation, compensate
from postproc.frames import M_PER_MM, Array
from postproc.robot import RobotModel


@dataclass(frozen=True, slots=True, eq=False)
class RobotInCell:
    """A robot in its cell.

    :param robot: the robot with the cell's payload.
    :param cell: the cell.
    """

    robot: RobotModel
    cell: Cell

    @classmethod
    def of(cls, robot: RobotModel, cell: Cell) -> RobotInCell:
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
    def spindle(self) -> str:
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

    def softness(self, tool: Array) -> tuple[float, float]:
        """Return how far a tool (4, 4) gives way at the start, about, per force [m/N] and per moment [m/(N·m)]."""
        return elastostatics.softness(self.robot, self.cell.start_joints, tool)

    def compensate(self, target: Array, q_nominal: Array, tool: Array, wrench: Array) -> Compensation:
        """Find the commands under which the loaded tool stands at its targets (n, 4, 4), see `compensation.compensate`.

        :param q_nominal: (n, 6) joint angles of the uncorrected targets [rad].
        :param tool: (4, 4) or (n, 4, 4) tool in the flange frame [m].
        :param wrench: (n, 6) at the tip, root axes [N, N·m].
        :raises NotConvergedError: some target cannot be held.
        """
        return compensate(self.robot, target, q_nominal, tool, wrench)

    def tip(self, q: Array, tool: Array, wrench: Array, guess: Array | None = None) -> Array:
        """Return where the loaded tip stands (n, 3) in the root [m].

        :param q: (n, 6) joint angles that the controller holds [rad].
        :param tool: (4, 4) or (n, 4, 4) tool in the flange frame [m].
        :param wrench: (n, 6) at the tip, root axes [N, N·m].
        :param guess: (n, nv) deflections of the springs, about.
        :raises NotConvergedError: the load is beyond what the springs hold.
        """
        x = elastostatics.spread(self.robot, q.T)
        start = None if guess is None else guess.T
        return elastostatics.solve_equilibrium(self.robot, x, kinematics.components(tool), wrench.T, start).tip.T
