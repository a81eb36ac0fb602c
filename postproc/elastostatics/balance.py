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
from postproc.robot import Chain, RobotModel


class Balance(Struct, frozen=True, eq=False):
    """Torques at the springs in n states.

    :param robot: the robot.
    :param x: (nv, n) actual coordinates [rad, m].
    :param point: (3, n) where the tool stands [m].
    :param jacobian: (6, nv, n) of the tool.
    :param wrench: (6, n) at the TCP, root axes [N, N·m].
    :param held: (nv, n) or (nv, 1) torque that is balanced at rest, see `held`.
    :param torque: (nv, n) τ [N·m, N].
    :param theta: (nv, n) c(τ): what the springs give way under it. Equal to x − q where the torques are balanced.
    :param slope: (nv, n) c′(τ), the tangent compliance.
    """

    robot: RobotModel
    x: Array
    point: Array
    jacobian: Array
    wrench: Array
    held: Array
    torque: Array
    theta: Array
    slope: Array

    @classmethod
    def at(cls, robot: RobotModel, x: Array, held: Array, tool: Array, wrench: Array) -> Balance:
        """Return the balance at coordinates x; `tool` (3, 4, n) or (3, 4, 1) in the flange frame."""
        state = kinematics.posture(robot.loaded, x, tool, weigh=robot.has_weight)
        jacobian = state.jacobian()
        torque = np.einsum("ikn,in->kn", jacobian, wrench) - asked(robot, x, state) + held
        found = given_way(robot, torque, felt(robot, held), load_alone(robot, x, torque))
        return cls(robot, x, state.point, jacobian, wrench, held, torque, *found)

    @property
    def at_rest(self) -> Array:
        """(nv, n) or (nv, 1) torque at θ = 0 that gears which stiffen feel besides τ."""
        return felt(self.robot, self.held)

    @property
    def by_load(self) -> Array:
        """(nv, n) τ less what weights of the links and compensator ask for: what turns lost motion over."""
        return load_alone(self.robot, self.x, self.torque)

    @property
    def loose(self) -> Array:
        """(nv, n) what of the tangent compliance weights and compensator do not move: that of lost motion, where τ is
        not the load's alone.
        """
        out, by_load = np.zeros_like(self.x), self.by_load
        for parameter, value in () if by_load is self.torque else self.robot.terms:
            if not parameter.feels_rest:
                row = parameter.row(self.robot)
                out[row] += value * parameter.effect(by_load[row], np.zeros_like(by_load[row]))[1]
        return out

    def reach(self) -> Array:
        """Return J (I − C·H)⁻¹ (n, 6, nv): how the tool moves in all when one spring gives way by itself.

        I − C·H is the derivative of θ − c(τ(θ)): C = c′(τ), H = ∂(JᵀF)/∂x − ∂²U_g/∂x² − U_c″. Rigid springs (C = 0)
        need no special case, as they would in K − H.
        """
        jacobian, loose = np.moveaxis(self.jacobian, -1, 0), self.loose
        hessian = kinematics.load_stiffness(jacobian, self.wrench.T) - self._asked_more(self.robot.loaded)
        tangent = np.eye(len(self.x)) - self.slope.T[:, :, None] * hessian
        if loose.any():
            tangent -= loose.T[:, :, None] * self._asked_more(self.robot.actual)
        return np.swapaxes(np.linalg.solve(np.swapaxes(tangent, 1, 2), np.swapaxes(jacobian, 1, 2)), 1, 2)

    def _asked_more(self, chain: Chain) -> Array:
        """Return ∂²U_g/∂x² + U_c″ (n, nv, nv)."""
        robot, x = self.robot, self.x
        weighs = robot.has_weight
        out = kinematics.gravity_stiffness(chain, x.T) if weighs else np.zeros((x.shape[1], len(x), len(x)))
        if robot.compensator is not None:
            row = robot.actuated[A2]
            out[:, row, row] += robot.compensator.stiffness_about_joint(x[row])
        return out


def asked(robot: RobotModel, x: Array, state: Posture | None = None) -> Array:
    """Return ∇U_g + U_c′ (nv, n): what weights and compensator ask of the springs at coordinates x (nv, n).

    :param state: of the robot there, with its weights; that without payload by default.
    """
    if state is None:
        state = kinematics.posture(robot.actual, x, weigh=robot.has_weight)
    torque = state.weight() if robot.has_weight else np.zeros_like(x)
    if robot.compensator is not None:
        row = robot.actuated[A2]
        torque[row] += robot.compensator.gradient(x[row])
    return torque


def held(robot: RobotModel, q: Array) -> Array:
    """Return the torque (nv, n) that is balanced at rest at coordinates q (nv, n); 0 if the geometry is a weightless
    robot's. The payload is a load, and not part of it.
    """
    return asked(robot, q) if robot.subtract_reference else np.zeros((len(q), 1))


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
    return torque + asked(robot, x)


def beside(robot: RobotModel, x: Array, slope: Array) -> Array:
    """Return 1 + c·U_c″ (n,): how much stiffer joint 2 is for the compensator beside its spring.

    :param x: (nv, n) coordinates.
    :param slope: (nv, n) tangent compliance of the springs.
    """
    if robot.compensator is None:
        return np.ones(1)
    row = robot.actuated[A2]
    return np.asarray(1.0 + slope[row] * robot.compensator.stiffness_about_joint(x[row]))
