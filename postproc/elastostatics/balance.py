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
    :param by_load: (nv, n) τ less what weights of the links and compensator ask for: what turns lost motion over.
    :param theta: (nv, n) c(τ): what the springs give way under it. Equal to x − q where the torques are balanced.
    :param slope: (nv, n) c′(τ), the tangent compliance.
    :param loose: (nv, n) or (nv, 1) what of it weights and compensator do not move: that of lost motion, where τ is not
        the load's alone.
    """

    robot: RobotModel
    x: Array
    pose: Array
    jacobian: Array
    wrench: Array
    torque: Array
    at_rest: Array
    by_load: Array
    theta: Array
    slope: Array
    loose: Array

    @classmethod
    def at(cls, robot: RobotModel, x: Array, held: Array, tool: Array, wrench: Array) -> Balance:
        """Return the balance at coordinates x (nv, n) of a robot that holds torques `held` (see there) at rest.

        :param tool: (3, 4, n) or (3, 4, 1) in the flange frame.
        :param wrench: (6, n).
        """
        state = kinematics.posture(robot.loaded, x, tool, weigh=robot.has_weight)
        jacobian = state.jacobian()
        torque = np.einsum("ikn,in->kn", jacobian, wrench) - asked(robot, x, state) + held
        at_rest, by_load = felt(robot, held), load_alone(robot, x, torque)
        found = given_way(robot, torque, at_rest, by_load)
        loose = np.zeros((len(x), 1)) if by_load is torque else _of_lost_motion(robot, by_load)
        return cls(robot, x, state.pose, jacobian, wrench, torque, at_rest, by_load, *found, loose)

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
        tangent = np.eye(len(self.x)) - self.slope.T[:, :, None] * hessian
        return tangent if self.by_load is self.torque else tangent - self.loose.T[:, :, None] * self._asked_more()

    def _asked_more(self) -> Array:
        """Return ∂²U_g/∂x² + U_c″ (n, nv, nv) without payload."""
        robot, x = self.robot, self.x
        hessian = kinematics.gravity_stiffness(robot.actual, x.T)
        if robot.compensator is not None:
            row = robot.actuated[A2]
            hessian[:, row, row] += robot.compensator.stiffness_about_joint(x[row])
        return hessian

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


def load_alone(robot: RobotModel, x: Array, torque: Array) -> Array:
    """Return what of the torque τ (nv, n) at coordinates x (nv, n) is the load's, payload included.

    Where the geometry holds the state at rest that is all of it.
    """
    if robot.subtract_reference or all(parameter.feels_rest for parameter, _ in robot.terms):
        return torque
    return torque + asked(robot, x, kinematics.posture(robot.actual, x, weigh=robot.has_weight))


def _of_lost_motion(robot: RobotModel, by_load: Array) -> Array:
    """Return the tangent compliance (nv, n) of what the load alone turns over."""
    out = np.zeros_like(by_load)
    for parameter, value in robot.terms:
        if not parameter.feels_rest:
            row = parameter.row(robot)
            out[row] += value * parameter.effect(by_load[row], np.zeros_like(by_load[row]))[1]
    return out


def beside(robot: RobotModel, x: Array, slope: Array) -> Array:
    """Return 1 + c·U_c″ (n,): how much stiffer joint 2 is for the compensator beside its spring.

    :param x: (nv, n) coordinates.
    :param slope: (nv, n) tangent compliance of the springs.
    """
    if robot.compensator is None:
        return np.ones(1)
    row = robot.actuated[A2]
    return np.asarray(1.0 + slope[row] * robot.compensator.stiffness_about_joint(x[row]))
