"""How the springs give way when a parameter changes: what identification and bound derive everything from."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc import kinematics
from postproc.elastostatics.balance import Balance
from postproc.errors import ModelError
from postproc.frames import Array
from postproc.robot import CompensatorTorque, LinkMass, Parameter, RobotModel, Spring


def moved_by(state: Balance, reach: Array, parameter: Parameter, q: Array) -> Array:
    """Return the twist (n, 6) of the tool per unit of a parameter, at fixed joint angles.

    :param reach: (n, 6, nv), that of the state (`Balance.reach`).
    :param q: (nv, n) coordinates at rest.
    :raises ModelError: the robot does not have the parameter.
    """
    if isinstance(parameter, LinkMass):
        return np.asarray(np.einsum("nik,kn->ni", reach, _given_way_by_mass(state, parameter, q)))
    return np.asarray(reach[:, :, parameter.row(state.robot)] * given_way_by(state, parameter, q)[:, None])


def weight_of(robot: RobotModel, link: LinkMass, x: Array) -> Array:
    """Return ∂(∇U_g)/∂m (nv, n) by the mass of a link, at coordinates x (nv, n) [N·m/kg, N/kg]."""
    state, row = kinematics.posture(robot.a_kilogram_each, x, weigh=True), link.row(robot)
    return replace(state, mass=[float(index == row) for index in range(len(x))]).weight()


def _given_way_by_mass(state: Balance, link: LinkMass, q: Array) -> Array:
    """Return ∂c/∂m (nv, n) of all springs, at fixed coordinates."""
    robot = state.robot
    weight = weight_of(robot, link, state.x)
    if not robot.subtract_reference:
        return np.asarray((state.loose - state.slope) * weight)
    held = weight_of(robot, link, q)
    return np.asarray(-state.slope * (weight - held) - more_at_rest(robot, state.torque, state.at_rest) * held)


def more_at_rest(robot: RobotModel, torque: Array, at_rest: Array) -> Array:
    """Return ∂c/∂(torque at rest) (nv, n): how much more springs give way under a torque when more is on them before.

    Zero for springs that are linear, and where gears do not feel what is there at rest.
    """
    out = np.zeros_like(torque)
    if not robot.carries_weight and robot.subtract_reference:
        return out
    for parameter, value in robot.terms:
        if parameter.feels_rest:
            row, rest = parameter.row(robot), at_rest[parameter.row(robot)]
            slopes = [parameter.effect(on, rest)[1] for on in (torque[row], np.zeros_like(torque[row]))]
            out[row] += value * (slopes[0] - slopes[1])
    return out


def given_way_by(state: Balance, parameter: Parameter, q: Array) -> Array:
    """Return ∂c/∂p (n,) of the spring at `parameter.row`, at fixed coordinates [rad or m per SI unit].

    The tool moves by `state.reach()` times that.

    :param q: (nv, n) coordinates at rest.
    :raises ModelError: the robot does not have the parameter.
    """
    robot, row = state.robot, parameter.row(state.robot)
    if isinstance(parameter, Spring):
        torque = state.torque if parameter.feels_rest else state.by_load
        return parameter.effect(torque[row], state.at_rest[row])[0]
    if not isinstance(parameter, CompensatorTorque) or robot.compensator is None:
        raise ModelError(f"{parameter.name} belongs to no spring of {robot.name}")
    taken, _ = parameter.effect(robot.compensator, state.x[row])
    if not robot.subtract_reference:
        return np.asarray((state.loose - state.slope)[row] * taken)
    held, _ = parameter.effect(robot.compensator, q[row])
    out = -state.slope[row] * (taken - held)
    # the torque that the gears feel at rest changes too
    return np.asarray(out - more_at_rest(robot, state.torque, state.at_rest)[row] * held)
