"""How the springs give way when a parameter changes: what identification and bound derive everything from."""

from __future__ import annotations

import numpy as np

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
    robot = state.robot
    if isinstance(parameter, Spring):
        row = parameter.row(robot)
        torque = state.torque if parameter.feels_rest else state.by_load
        return np.asarray(reach[:, :, row] * parameter.effect(torque[row], state.at_rest[row])[0][:, None])
    there = asked_by(robot, parameter, state.x)
    if robot.subtract_reference:
        here = asked_by(robot, parameter, q)  # the torque that the gears feel at rest changes too
        bent = -state.slope * (there - here) - more_at_rest(robot, state.torque, state.at_rest) * here
    else:
        bent = (state.loose - state.slope) * there
    return np.asarray(np.einsum("nik,kn->ni", reach, bent))


def asked_by(robot: RobotModel, parameter: Parameter, x: Array) -> Array:
    """Return ∂(∇U_g + U_c′)/∂p (nv, n) at coordinates x (nv, n): by the mass of a link, or a value of the compensator.

    :raises ModelError: the robot does not have the parameter, or it is none of these.
    """
    row = parameter.row(robot)
    if isinstance(parameter, LinkMass):
        return kinematics.posture(robot.a_kilogram_each, x, weigh=True).weight(row)
    if not isinstance(parameter, CompensatorTorque) or robot.compensator is None:
        raise ModelError(f"{parameter.name} belongs to no spring of {robot.name}")
    out = np.zeros_like(x)
    out[row] = parameter.effect(robot.compensator, x[row])[0]
    return out


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
