"""How the springs give way when a parameter changes: what identification and bound derive everything from."""

from __future__ import annotations

import numpy as np

from postproc.elastostatics.balance import Balance
from postproc.elastostatics.springs import given_way
from postproc.errors import ModelError
from postproc.frames import Array
from postproc.robot import CompensatorTorque, Parameter, Spring


def given_way_by(state: Balance, parameter: Parameter, q: Array) -> Array:
    """Return ∂c/∂p (n,) of the spring at `parameter.row`, at fixed coordinates [rad or m per SI unit].

    The tool moves by `state.reach()` times that.

    :param q: (nv, n) coordinates at rest.
    :raises ModelError: the robot does not have the parameter.
    """
    robot, row = state.robot, parameter.row(state.robot)
    if isinstance(parameter, Spring):
        return parameter.effect(state.torque[row], state.at_rest[row])[0]
    if not isinstance(parameter, CompensatorTorque) or robot.compensator is None:
        raise ModelError(f"{parameter.name} belongs to no spring of {robot.name}")
    taken, _ = parameter.effect(robot.compensator, state.x[row])
    if not robot.subtract_reference:
        return np.asarray(-state.slope[row] * taken)
    held, _ = parameter.effect(robot.compensator, q[row])
    out = -state.slope[row] * (taken - held)
    if robot.terms and robot.carries_weight:  # the torque that the gears feel at rest changes too
        _, before = given_way(robot, np.zeros_like(state.torque), state.at_rest)
        out -= (state.slope - before)[row] * held
    return np.asarray(out)
