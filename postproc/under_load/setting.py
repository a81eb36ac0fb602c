"""A robot in its cell: payload, start position, and compliance of the tool."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from msgspec import Struct

from postproc import elastostatics, kinematics, toolpath
from postproc.cell import Cell
from postproc.elastostatics import Compensation, ToolSpring
from postproc.frames import M_PER_MM, Array
from postproc.kinematics import JointPath
from postproc.program import PTP, Ints, Program
from postproc.robot import RobotModel


class RobotInCell(Struct, frozen=True, eq=False, dict=True):
    """A robot in its cell.

    :param robot: the robot with the cell's payload.
    :param cell: the cell.
    """

    robot: RobotModel
    cell: Cell

    @classmethod
    def of(cls, robot: RobotModel, cell: Cell) -> RobotInCell:
        """Combine a robot and a cell; the robot gets the payload of the cell."""
        load = cell.payload
        return cls(robot.with_payload(load.mass_kg, np.array([load.X, load.Y, load.Z]) * M_PER_MM), cell)

    def forward(self, q: Array) -> Array:
        """Return the flange (4, 4) in the root by the controller's geometry for joint angles (6,) [rad]."""
        state = kinematics.posture(self.robot.nominal, np.asarray(q, dtype=float)[:, None])
        return np.asarray(kinematics.matrices(state.pose)[0])

    def follow(self, program: Program, motion: Ints, t: Array, pose: Array) -> JointPath:
        """Solve the joint angles of a path from where the cell starts, see `kinematics.follow`.

        :param motion: (N,) row of `Motions` of each of its places, in order; `t` (N,) the place on it; `pose` (N, 4, 4)
            the tool frame in its `$BASE` [m].
        :raises UnreachableError: a pose has no solution on its branch.
        """
        m = program.motions
        free = (t == 1.0) & (m.kind[motion] == PTP)
        ptp = motion[free]

        def flange(rows: Ints) -> Array:
            return toolpath.flange_from_tcp(program, motion[rows], pose.take(rows, axis=0), t[rows])

        start = self.cell.start_joints
        return kinematics.follow(self.robot, flange, start, free, m.joints[ptp], m.status[ptp], m.turn[ptp])

    @cached_property
    def tool_spring(self) -> ToolSpring | None:
        """Holder, spindle and tool as a spring at the tip; None where they are rigid."""
        compliance = self.cell.tool_compliance.diagonal()
        return ToolSpring(compliance) if compliance.any() else None

    @cached_property
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
        """Permitted deviation of the predicted path from the nominal one [m]."""
        return self.cell.tolerance

    @property
    def rest_is_nominal(self) -> bool:
        """True if the tool is exactly at the commanded pose without cutting force."""
        robot = self.robot
        return robot.geometry_is_nominal and robot.subtract_reference and self.cell.payload.mass_kg == 0.0

    def softness(self, tool: Array) -> tuple[float, float]:
        """Return the approximate compliance of a tool (4, 4) at the start: per force [m/N] and per moment [m/(N·m)]."""
        force, moment = elastostatics.largest_compliance(self.robot, self.cell.start_joints, tool)
        own = self.cell.tool_compliance.diagonal()
        return force + float(own[:3].max()), moment + float(own[3:].max())

    def compensate(self, target: Array, q_nominal: Array, tool: Array, wrench: Array) -> Compensation:
        """Find the commanded poses that put the loaded tool at its targets (n, 4, 4): `elastostatics.compensate`.

        :param q_nominal: (n, 6) joint angles of the uncorrected targets [rad].
        :param tool: (4, 4) or (n, 4, 4) tool in the flange frame [m].
        :param wrench: (n, 6) at the tip, root axes [N, N·m].
        :raises NotConvergedError: a target has no loaded equilibrium.
        """
        if (spring := self.tool_spring) is not None:
            target, wrench = spring.arm_target(target, wrench)
        return elastostatics.compensate(self.robot, target, q_nominal, tool, wrench)

    def tip(self, q: Array, tool: Array, wrench: Array, guess: Array | None = None) -> Array:
        """Return the position (n, 3) of the loaded tip in the root [m]."""
        return self.tip_and_share(q, tool, wrench, guess)[0]

    def tip_and_share(self, q: Array, tool: Array, wrench: Array, guess: Array | None = None) -> tuple[Array, Array]:
        """Return the position (n, 3) of the loaded tip in the root [m], and the deflection of holder, spindle and tool.

        :param q: (n, 6) commanded joint angles [rad].
        :param tool: (4, 4) or (n, 4, 4) tool in the flange frame [m].
        :param wrench: (n, 6) at the tip, root axes [N, N·m].
        :param guess: (n, nv) initial guess of the deflections of the springs.
        :raises NotConvergedError: the load is too large for the springs.
        """
        if (spring := self.tool_spring) is not None:
            return spring.loaded_tip(self.robot, q, tool, wrench, guess)
        tip = elastostatics.loaded_tip(self.robot, q, tool, wrench, guess)
        return tip, np.zeros_like(tip)
