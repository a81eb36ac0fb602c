"""The balance of torques at the virtual springs: θ = c(τ(θ)), the condition that V(θ) is stationary.

The torque on the springs at the actual coordinates x = q + θ is that of the load, JᵀF, minus the static torque of
weights and compensator, ∇U_g + U_c′. The static torque at q is balanced at rest where the geometry describes the robot
under its own weight: τ = JᵀF − (∇U_g + U_c′)(x) + (∇U_g + U_c′)(q). Equilibrium, linearisation and identification all
start from here. Arrays of this module are (nv, n), the sample index last; `coordinates` alone takes rows of samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc import kinematics
from postproc.chunks import in_chunks
from postproc.errors import ModelError
from postproc.frames import Array
from postproc.kinematics import Posture
from postproc.robot import Chain, CompensatorTorque, LinkMass, Parameter, RobotModel, Spring

_Result = TypeVar("_Result", bound="NDArray[Any] | tuple[NDArray[Any], ...]")

A2 = 1
"""Index of joint A2 among the actuated coordinates: the compensator acts on it."""


def coordinates(robot: RobotModel, q: Array) -> Array:
    """Return the coordinates (N, nv) of the elastic chain for joint angles q (N, 6): zero for virtual joints."""
    return elastic_coordinates(robot, q.T).T


def elastic_coordinates(robot: RobotModel, q: Array) -> Array:
    """Return the coordinates (nv, n) of the elastic chain for joint angles q (6, n): zero for virtual joints."""
    x = np.zeros((robot.actual.nv, q.shape[-1]))
    x[list(robot.actuated)] = q if robot.transmission is None else robot.transmission.actual_angles(q)
    return x


def joint_angles(robot: RobotModel, x: Array) -> Array:
    """Return the joint angles (6, n) [rad] that the controller holds at coordinates x (nv, n) of the elastic chain."""
    joints = x[list(robot.actuated)]
    return joints if robot.transmission is None else robot.transmission.commanded_angles(joints)


def spring_deflection(
    robot: RobotModel, x: Array, torque: Array, preload: Array, load_part: Array | None = None
) -> tuple[Array, Array]:
    """Return the deflection θ (nv, n) [rad, m] of the virtual springs, and their tangent compliance (nv, n).

    The tangent compliance [rad/(N·m), m/N] is that of each spring by its own torque; those by torques of other joints
    are in `RobotModel.coupling_compliance`.

    :param x: (nv, n) actual coordinates, where compliances change over the workspace.
    :param torque: (nv, n) on the springs, in addition to the preload [N·m, N].
    :param preload: (nv, n) or (nv, 1) torque at which θ = 0; it matters to springs that are not linear.
    :param load_part: (nv, n) torque of the load alone, if that is not `torque`; it moves lost motion.
    """
    load_part = torque if load_part is None else load_part
    linear_compliance = robot.constant_compliance[:, None]
    # without terms all springs are linear
    if not robot.terms:
        return linear_compliance * torque, np.broadcast_to(linear_compliance, torque.shape)
    theta, slope = linear_compliance * torque, np.repeat(linear_compliance, torque.shape[1], axis=1)
    for parameter, value in robot.torque_terms:
        moving_torque = torque if parameter.with_rest_torque else load_part
        for row, torque_row in robot.pairs(parameter):
            unit_deflection, unit_slope = parameter.effect(moving_torque[torque_row], preload[torque_row])
            theta[row] += value * unit_deflection
            if row == torque_row:  # else a coupling, see `RobotModel.coupling_compliance`
                slope[row] += value * unit_slope
    if robot.over_pose is not None:
        joints = list(robot.actuated)
        compliance = robot.over_pose.compliance(x[joints])
        theta[joints] += compliance * torque[joints]
        slope[joints] += compliance
    return theta, slope


class Balance(Struct, frozen=True, eq=False):
    """Torques at the springs in n states.

    :param robot: the robot.
    :param x: (nv, n) actual coordinates [rad, m].
    :param point: (3, n) position of the tool [m].
    :param jacobian: (6, nv, n) of the tool.
    :param wrench: (6, n) at the TCP, root axes [N, N·m].
    :param rest_torque: (nv, n) or (nv, 1) static torque that is balanced at rest, see `balanced_torque`.
    :param torque: (nv, n) τ [N·m, N].
    :param theta: (nv, n) c(τ), the deflection under τ; equal to x − q in equilibrium.
    :param slope: (nv, n) c′(τ), the tangent compliance.
    """

    robot: RobotModel
    x: Array
    point: Array
    jacobian: Array
    wrench: Array
    rest_torque: Array
    torque: Array
    theta: Array
    slope: Array

    @classmethod
    def at(cls, robot: RobotModel, x: Array, rest_torque: Array, tool: Array, wrench: Array) -> Balance:
        """Return the balance at coordinates x.

        Parameters as the fields of the same names.

        :param tool: (3, 4, n) or (3, 4, 1) in the flange frame [m].
        """
        state = kinematics.posture(robot.loaded, x, tool, weigh=robot.has_weight)
        jacobian = state.jacobian()
        torque = np.einsum("ikn,in->kn", jacobian, wrench) - static_torque(robot, x, state) + rest_torque
        springs = spring_deflection(robot, x, torque, preload(robot, rest_torque), load_torque(robot, x, torque))
        return cls(robot, x, state.point, jacobian, wrench, rest_torque, torque, *springs)

    @property
    def preload(self) -> Array:
        """(nv, n) or (nv, 1) torque at θ = 0, in addition to τ, on gears that are not linear."""
        return preload(self.robot, self.rest_torque)

    @property
    def load_part(self) -> Array:
        """(nv, n) part of τ that comes from the load; it moves lost motion."""
        return load_torque(self.robot, self.x, self.torque)

    @property
    def lost_motion_compliance(self) -> Array:
        """(nv, n) tangent compliance of lost motion, which only the torque of the load moves [rad/(N·m)].

        Zero where τ is the torque of the load alone: `slope` then contains lost motion.
        """
        compliance, load_part = np.zeros_like(self.x), self.load_part
        if load_part is self.torque:  # `load_torque` returns τ itself where all of it is the torque of the load
            return compliance
        for parameter, value in self.robot.terms:
            if not parameter.with_rest_torque:
                row = self.robot.row(parameter)
                _, slope = parameter.effect(load_part[row], np.zeros_like(load_part[row]))
                compliance[row] += value * slope
        return compliance

    def spring_jacobian(self) -> Array:
        """Return J (I − C·H)⁻¹ (n, 6, nv): the tool's motion per deflection of one spring by itself.

        I − C·H is the derivative of θ − c(τ(θ)): C = c′(τ), H = ∂(JᵀF)/∂x − ∂²U_g/∂x² − U_c″. Rigid springs (C = 0)
        need no special case, as they would in K − H. Compliances that change over the workspace add −∂c/∂x at fixed τ.
        """
        jacobian = self.jacobian.transpose(2, 0, 1)
        tangent = self._residual_slopes(jacobian)
        # J·A⁻¹ = (A⁻ᵀ·Jᵀ)ᵀ
        return np.swapaxes(np.linalg.solve(np.swapaxes(tangent, 1, 2), np.swapaxes(jacobian, 1, 2)), 1, 2)

    def _residual_slopes(self, jacobian: Array) -> Array:
        """Return ∂(θ − c(τ(θ)))/∂θ (n, nv, nv), see `spring_jacobian`; `jacobian` (n, 6, nv) of the tool."""
        hessian = kinematics.load_stiffness(jacobian, self.wrench.T) - self._static_stiffness(self.robot.loaded)
        slopes = np.eye(len(self.x)) - self.deflection_under_torque(np.moveaxis(hessian, 0, -1)).transpose(2, 0, 1)
        if (over_pose := self.robot.over_pose) is not None:
            joints = list(self.robot.actuated)
            by_angle = over_pose.slopes(self.x[joints]) * self.torque[joints][:, None]
            slopes[:, np.array(joints)[:, None], joints] -= np.moveaxis(by_angle, -1, 0)
        lost_motion = self.lost_motion_compliance
        if lost_motion.any():  # τ contains the static torque, which does not move it
            slopes -= lost_motion.T[:, :, None] * self._static_stiffness(self.robot.actual)
        return slopes

    def deflection_under_torque(self, torque: Array) -> Array:
        """Return the deflections (nv, ..., n) [rad, m] by small torques, at first order.

        Each torque turns its own coordinate by `slope` (nv, n), and the coupled ones by `coupling_compliance` (nv, nv).

        :param torque: (nv, ..., n) on nv coordinates in n states [N·m, N].
        """
        coordinate_count, state_count = self.slope.shape
        slope = self.slope.reshape(coordinate_count, *(1,) * (torque.ndim - 2), state_count)
        deflection = slope * torque
        if self.robot.coupling_compliance is not None:
            deflection = deflection + np.tensordot(self.robot.coupling_compliance, torque, axes=1)
        return np.asarray(deflection)

    def deflection_by_wrench(self) -> Array:
        """Return the deflections (n, nv, 6) of the springs per unit of the wrench, at first order; SI units."""
        return np.moveaxis(self.deflection_under_torque(np.swapaxes(self.jacobian, 0, 1)), -1, 0)

    def _static_stiffness(self, chain: Chain) -> Array:
        """Return ∂²U_g/∂x² + U_c″ (n, nv, nv), the derivative of the static torque by the coordinates.

        :param chain: of the robot, `loaded` with payload or `actual` without it.
        :raises PostprocError: the chain has masses, and Pinocchio is not installed.
        """
        robot, x = self.robot, self.x
        if robot.has_weight:
            stiffness = kinematics.gravity_stiffness(chain, x.T)
        else:  # a robot without masses needs no Pinocchio
            stiffness = np.zeros((x.shape[1], len(x), len(x)))
        if robot.compensator is not None:
            row = robot.actuated[A2]
            stiffness[:, row, row] += robot.compensator.stiffness_about_joint(x[row])
        return stiffness


def undeflected_balance(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Balance:
    """Return the balance at θ = 0.

    :param q: (N, 6) joint angles that the controller holds [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    """
    x = elastic_coordinates(robot, q.T)
    return Balance.at(robot, x, balanced_torque(robot, x), kinematics.components(tool), wrench.T)


def in_chunks_of_states(
    function: Callable[..., _Result], q: Array, tool: Array, wrench: Array, *columns: Array
) -> _Result:
    """Return `function(q, tool, wrench, *columns)` of N states under load, computed in chunks that fit the cache.

    By it, public functions of this package take any number of states: one state needs some kilobytes of intermediate
    results.

    :param function: takes arrays of n states; see `chunks.in_chunks`.
    :param q: (N, 6) joint angles [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :param columns: further arrays of N rows.
    """
    return in_chunks(function, q, np.broadcast_to(tool, (len(q), 4, 4)), wrench, *columns)


def static_torque(robot: RobotModel, x: Array, state: Posture | None = None) -> Array:
    """Return ∇U_g + U_c′ (nv, n): the static torque of weights and compensator at coordinates x (nv, n).

    :param state: posture at x of the chain whose weights count; None: of the robot without payload.
    """
    if state is None:
        state = kinematics.posture(robot.actual, x, weigh=robot.has_weight)
    torque = state.weight_torques() if robot.has_weight else np.zeros_like(x)
    if robot.compensator is not None:
        row = robot.actuated[A2]
        torque[row] += robot.compensator.gradient(x[row])
    return torque


def balanced_torque(robot: RobotModel, q: Array) -> Array:
    """Return the static torque (nv, n) [N·m, N] that is balanced at rest without payload, at coordinates q (nv, n).

    It is zero (nv, 1) if the geometry is that of a weightless robot.
    """
    return static_torque(robot, q) if robot.subtract_reference else np.zeros((len(q), 1))


def preload(robot: RobotModel, rest_torque: Array) -> Array:
    """Return the torque (nv, n) or (nv, 1) of the weights on gears that are not linear, at rest [N·m, N].

    It is the opposite of the static torque, which holds the weights. Zero if the gears of the model do not carry the
    weights, or if the geometry is that of a weightless robot.

    :param rest_torque: (nv, n) or (nv, 1) from `balanced_torque`.
    """
    has_preload = bool(robot.terms) and robot.carries_weight and robot.subtract_reference
    return -rest_torque if has_preload else np.zeros((len(rest_torque), 1))


def load_torque(robot: RobotModel, x: Array, torque: Array) -> Array:
    """Return the part of the torque τ that comes from the load, payload included (nv, n) [N·m, N].

    It is all of τ if the static torque is balanced at rest. If all springs deflect by all of τ, so that no spring needs
    the part by itself, τ is returned too.

    :param x: (nv, n) actual coordinates.
    :param torque: (nv, n) τ at the springs.
    """
    if robot.subtract_reference or all(parameter.with_rest_torque for parameter, _ in robot.terms):
        return torque
    return torque + static_torque(robot, x)


def compensator_factor(robot: RobotModel, x: Array, slope: Array) -> Array:
    """Return 1 + c·U_c″ (n,), the factor by which the compensator stiffens joint 2; (1,) without compensator.

    :param x: (nv, n) coordinates.
    :param slope: (nv, n) tangent compliance c of the springs.
    """
    if robot.compensator is None:
        return np.ones(1)
    row = robot.actuated[A2]
    return np.asarray(1.0 + slope[row] * robot.compensator.stiffness_about_joint(x[row]))


def twists_by_parameters(state: Balance, spring_jacobian: Array, parameters: Sequence[Parameter], q: Array) -> Array:
    """Return the twists (n, 6, P) [m, rad] of the tool per unit of each parameter p, at fixed joint angles.

    It is J_s·∂c/∂p, with the spring Jacobian J_s and the derivative of the deflection θ = c(τ, τ⁰) at fixed x. For a
    parameter of the static torque T = ∇U_g + U_c′, with τ = JᵀF − T(x) + T(q) and the preload τ⁰ = −T(q):

        ∂c/∂p = −∂c/∂τ·(∂T/∂p(x) − ∂T/∂p(q)) − ∂c/∂τ⁰·∂T/∂p(q)

    Where the geometry is that of a weightless robot, the terms with T(q) are absent. Lost motion then moves by the load
    alone, that is by τ + T(x), which adds c_lost·∂T/∂p(x).

    :param state: balance at the loaded coordinates x; they must be those of the equilibrium.
    :param spring_jacobian: (n, 6, nv) of the state, `Balance.spring_jacobian`.
    :param q: (nv, n) coordinates at rest, without deflection.
    :raises ModelError: the robot does not have one of the parameters.
    """
    robot = state.robot
    twist = np.empty((len(spring_jacobian), 6, len(parameters)))
    static_columns = []
    for column, parameter in enumerate(parameters):
        if isinstance(parameter, Spring):
            twist[:, :, column] = _twist_by_spring(state, spring_jacobian, parameter)
        else:
            static_columns.append(column)
    if not static_columns:
        return twist
    loaded_slopes, rest_slopes = StaticTorqueSlopes(robot, state.x), StaticTorqueSlopes(robot, q)
    by_preload = compliance_by_preload(robot, state.torque, state.preload)
    for column in static_columns:
        loaded_torque = loaded_slopes.slope(parameters[column])
        if robot.subtract_reference:
            rest_torque = rest_slopes.slope(parameters[column])
            deflection = -state.deflection_under_torque(loaded_torque - rest_torque) - by_preload * rest_torque
        else:
            deflection = state.lost_motion_compliance * loaded_torque - state.deflection_under_torque(loaded_torque)
        twist[:, :, column] = np.einsum("nik,kn->ni", spring_jacobian, deflection)
    return twist


def _twist_by_spring(state: Balance, spring_jacobian: Array, parameter: Spring) -> Array:
    """Return the twist (n, 6) [m, rad] of the tool per unit of a parameter of a spring; see `twists_by_parameters`."""
    robot = state.robot
    torque = state.torque if parameter.with_rest_torque else state.load_part
    factor = parameter.factor(state.x[list(robot.actuated)])
    twist = np.zeros((spring_jacobian.shape[0], 6))
    for row, torque_row in robot.pairs(parameter):
        unit_deflection, _ = parameter.effect(torque[torque_row], state.preload[torque_row])
        twist += spring_jacobian[:, :, row] * (factor * unit_deflection)[:, None]
    return twist


class StaticTorqueSlopes:
    """Derivatives of the static torque ∇U_g + U_c′ at coordinates x (nv, n) by link masses and the compensator."""

    def __init__(self, robot: RobotModel, x: Array) -> None:
        self._robot, self._x = robot, x

    @cached_property
    def _unit_masses(self) -> Posture:
        """Posture of the chain whose links have unit masses."""
        return kinematics.posture(self._robot.unit_mass_chain, self._x, weigh=True)

    def slope(self, parameter: Parameter) -> Array:
        """Return the derivative (nv, n) by a link mass or a parameter of the compensator.

        :raises ModelError: the robot does not have the parameter, or it is of another kind.
        """
        robot = self._robot
        row = robot.row(parameter)
        if isinstance(parameter, LinkMass):
            return self._unit_masses.weight_torques(row)
        if not isinstance(parameter, CompensatorTorque) or robot.compensator is None:
            raise ModelError(f"{parameter.name} is no parameter of {robot.name}")
        slopes = np.zeros_like(self._x)
        slopes[row], _ = parameter.effect(robot.compensator, self._x[row])
        return slopes


def compliance_by_preload(robot: RobotModel, torque: Array, preload: Array) -> Array:
    """Return ∂c/∂(preload) (nv, n): change of the deflection under a torque by the preload.

    It is zero for linear springs, and where the preload does not reach the gears. The deflection is that by preload and
    torque less that by the preload, so its derivative is a difference of tangent compliances.

    :param torque: (nv, n) on the springs, in addition to the preload [N·m, N].
    :param preload: (nv, n) or (nv, 1) torque at which the deflection is zero.
    """
    change = np.zeros_like(torque)
    if not robot.carries_weight and robot.subtract_reference:
        return change
    for parameter, value in robot.terms:
        if parameter.with_rest_torque:
            row = robot.row(parameter)
            _, loaded_slope = parameter.effect(torque[row], preload[row])
            _, rest_slope = parameter.effect(np.zeros_like(torque[row]), preload[row])
            change[row] += value * (loaded_slope - rest_slope)
    return change
