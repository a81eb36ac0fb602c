"""The balance of torques at the virtual springs: θ = c(τ(θ)), the condition that V(θ) is stationary.

What pulls at the actual coordinates x = q + θ is the load, JᵀF, less what weights and compensator ask for, ∇U_g + U_c′.
What the geometry already holds at rest, at q, is balanced there: τ = JᵀF − (∇U_g + U_c′)(x) + (∇U_g + U_c′)(q). All
that solves, linearises or identifies starts from here. Arrays (nv, n): the sample index last.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import kinematics
from postproc.elastostatics.springs import A2, given_way
from postproc.frames import Array
from postproc.kinematics import Posture
from postproc.robot import RobotModel


class Balance(Struct, frozen=True, eq=False):
    """Torques at the springs in n states.

    :param robot: the robot.
    :param x: (nv, n) actual coordinates [rad, m].
    :param pose: (3, 4, n) of the tool [m].
    :param jacobian: (6, nv, n) of the tool.
    :param wrench: (6, n) at the TCP, root axes [N, N·m].
    :param torque: (nv, n) τ [N·m, N].
    :param at_rest: (nv, n) or (nv, 1) torque at θ = 0 that gears which stiffen feel besides τ.
    :param theta: (nv, n) c(τ): what the springs give way under it. Equal to x − q where the torques are balanced.
    :param slope: (nv, n) c′(τ), the tangent compliance.
    """

    robot: RobotModel
    x: Array
    pose: Array
    jacobian: Array
    wrench: Array
    torque: Array
    at_rest: Array
    theta: Array
    slope: Array

    @classmethod
    def at(cls, robot: RobotModel, x: Array, held: Array, tool: Array, wrench: Array) -> Balance:
        """Return the balance at coordinates x (nv, n) of a robot that holds torques `held` (see there) at rest.

        :param tool: (3, 4, n) or (3, 4, 1) in the flange frame.
        :param wrench: (6, n).
        """
        state = kinematics.posture(robot.loaded, x, tool, weigh=robot.has_weight)
        jacobian = state.jacobian()
        torque = np.einsum("ikn,in->kn", jacobian, wrench) - asked(robot, x, state) + held
        at_rest = felt(robot, held)
        return cls(robot, x, state.pose, jacobian, wrench, torque, at_rest, *given_way(robot, torque, at_rest))

    def moved(self, change: Array) -> Array:
        """Return the twist (6, n) of the tool when the coordinates change by (nv, n)."""
        return np.asarray(np.einsum("ikn,kn->in", self.jacobian, change))

    def tangent(self) -> Array:
        """Return I − C·H (n, nv, nv), the derivative of θ − c(τ(θ)).

        C = c′(τ), H = ∂(JᵀF)/∂x − ∂²U_g/∂x² − U_c″. Rigid springs (C = 0) need no special case, as they
        would in K − H.
        """
        hessian = kinematics.load_stiffness(np.moveaxis(self.jacobian, -1, 0), self.wrench.T)
        if self.robot.has_weight:
            hessian -= kinematics.gravity_stiffness(self.robot.loaded, self.x.T)
        if self.robot.compensator is not None:
            row = self.robot.actuated[A2]
            hessian[:, row, row] -= self.robot.compensator.stiffness_about_joint(self.x[row])
        return np.eye(len(self.x)) - self.slope.T[:, :, None] * hessian

    def reach(self) -> Array:
        """Return J (I − C·H)⁻¹ (n, 6, nv): how the tool moves in all when one spring gives way by itself."""
        jacobian = np.moveaxis(self.jacobian, -1, 0)
        return np.swapaxes(np.linalg.solve(np.swapaxes(self.tangent(), 1, 2), np.swapaxes(jacobian, 1, 2)), 1, 2)


def asked(robot: RobotModel, x: Array, state: Posture) -> Array:
    """Return ∇U_g + U_c′ (nv, n): what weights and compensator ask of the springs at coordinates x (nv, n)."""
    torque = state.weight() if robot.has_weight else np.zeros_like(x)
    if robot.compensator is not None:
        row = robot.actuated[A2]
        torque[row] += robot.compensator.gradient(x[row])
    return torque


def held(robot: RobotModel, q: Array) -> Array:
    """Return the torque (nv, n) that is balanced at rest at coordinates q (nv, n); 0 if the geometry is a weightless
    robot's. The payload is a load, and not part of it.
    """
    if not robot.subtract_reference:
        return np.zeros((len(q), 1))
    return asked(robot, q, kinematics.posture(robot.actual, q, weigh=robot.has_weight))


def felt(robot: RobotModel, held: Array) -> Array:
    """Return the torque at rest (nv, n) that a gear which stiffens feels besides the load."""
    carries = bool(robot.terms) and robot.carries_weight and robot.subtract_reference
    return -held if carries else np.zeros((len(held), 1))


def beside(robot: RobotModel, x: Array, slope: Array) -> Array:
    """Return 1 + c·U_c″ (n,): how much stiffer joint 2 is for the compensator beside its spring.

    :param x: (nv, n) coordinates.
    :param slope: (nv, n) tangent compliance of the springs.
    """
    if robot.compensator is None:
        return np.ones(1)
    row = robot.actuated[A2]
    return np.asarray(1.0 + slope[row] * robot.compensator.stiffness_about_joint(x[row]))
