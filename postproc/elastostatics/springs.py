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
    """Return all coordinates (nv, n) of the elastic chain for joint angles q (6, n)."""
    full = np.zeros((robot.actual.nv, q.shape[-1]))
    full[list(robot.actuated)] = q
    return full


def joint_stiffness(robot: RobotModel, q: Array) -> Array:
    """Return K_θ(q) (N, nv, nv): the springs with the compensator in place 2, Eq. (4).

    :param q: (N, nv) coordinates [rad].
    """
    stiffness = np.repeat(robot.stiffness[None], len(q), axis=0)
    if robot.compensator is not None:
        row = robot.actuated[A2]
        stiffness[:, row, row] += robot.compensator.stiffness_about_joint(q[:, row])
    return stiffness


def spring_deflection(robot: RobotModel, torque: Array, at_rest: Array | None = None) -> tuple[Array, Array]:
    """Return θ (N, nv) of the virtual springs under torques, and its derivative, the tangent compliance (N, nv).

    :param torque: (N, nv) on the springs, beyond what they hold at rest [N·m, N].
    :param at_rest: (N, nv) torque at rest, where θ = 0; it matters only to gears that stiffen.
    """
    theta, slope = given_way(robot, torque.T, np.zeros((torque.shape[1], 1)) if at_rest is None else at_rest.T)
    return theta.T, slope.T


def given_way(robot: RobotModel, torque: Array, at_rest: Array) -> tuple[Array, Array]:
    """Return θ (nv, n) and the tangent compliance (nv, n) as `spring_deflection`; `at_rest` (nv, n) or (nv, 1).

    Gears that stiffen follow `robot.GearStiffening`; all others are linear.
    """
    compliance = robot.compliance[:, None]
    if robot.stiffening is None:
        return compliance * torque, np.broadcast_to(compliance, torque.shape)
    theta, slope = compliance * torque, np.repeat(compliance, torque.shape[1], axis=1)
    law = robot.stiffening
    for row, limit, part in zip(law.row, law.torque, law.compliance, strict=True):
        before = at_rest[row] / limit
        u = torque[row] / limit + before
        theta[row] -= part * limit * (u - before - fading(u) + fading(before))
        slope[row] -= part * (1.0 - fading_slope(u))
    return theta, slope


def fading(u: Array) -> Array:
    """Return f(u) of `robot.GearStiffening`: the deflection, over c·T, of the part of a gear that fades with load."""
    return np.asarray(np.arcsinh(u))


def fading_slope(u: Array) -> Array:
    """Return f′(u)."""
    return np.asarray(1.0 / np.sqrt(1.0 + u**2))
