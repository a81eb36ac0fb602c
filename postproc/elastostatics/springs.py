"""The virtual springs: what they give way under a torque. Arrays (nv, n): the sample index last, as in `kinematics`."""

from __future__ import annotations

import numpy as np

from postproc.frames import Array
from postproc.robot import RobotModel

A2 = 1
"""Place of joint A2 among the actuated coordinates: the compensator stands beside it."""


def coordinates(robot: RobotModel, q: Array) -> Array:
    """Return all coordinates (N, nv) of the elastic chain for joint angles q (N, 6); virtual ones are zero."""
    return spread(robot, q.T).T


def spread(robot: RobotModel, q: Array) -> Array:
    """Return all coordinates (nv, n) of the elastic chain for joint angles q (6, n) that the controller holds."""
    full = np.zeros((robot.actual.nv, q.shape[-1]))
    full[list(robot.actuated)] = q if robot.transmission is None else robot.transmission.actual(q)
    return full


def commanded(robot: RobotModel, x: Array) -> Array:
    """Return the joint angles (6, n) that the controller holds at coordinates x (nv, n): what `spread` starts from."""
    joints = x[list(robot.actuated)]
    return joints if robot.transmission is None else robot.transmission.commanded(joints)


def spring_deflection(robot: RobotModel, torque: Array, at_rest: Array | None = None) -> tuple[Array, Array]:
    """Return θ (N, nv) of the virtual springs under torques, and its derivative, the tangent compliance (N, nv).

    :param torque: (N, nv) on the springs, beyond what they hold at rest [N·m, N].
    :param at_rest: (N, nv) torque at rest, where θ = 0; it matters only to springs that are not linear.
    """
    theta, slope = given_way(robot, torque.T, np.zeros((torque.shape[1], 1)) if at_rest is None else at_rest.T)
    return theta.T, slope.T


def given_way(robot: RobotModel, torque: Array, at_rest: Array, by_load: Array | None = None) -> tuple[Array, Array]:
    """Return θ (nv, n) and the tangent compliance (nv, n) as `spring_deflection`; `at_rest` (nv, n) or (nv, 1).

    :param by_load: (nv, n) what the load alone puts on the springs, if that is not `torque`.
    """
    by_load = torque if by_load is None else by_load
    steady = robot.steady[:, None]
    if not robot.terms:
        return steady * torque, np.broadcast_to(steady, torque.shape)
    theta, slope = steady * torque, np.repeat(steady, torque.shape[1], axis=1)
    for parameter, value in robot.terms:
        row = parameter.row(robot)
        share, tangent = parameter.effect((torque if parameter.feels_rest else by_load)[row], at_rest[row])
        theta[row] += value * share
        slope[row] += value * tangent
    return theta, slope
