"""The virtual springs: what they give way under a torque, and what they hold at rest."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from postproc import kinematics
from postproc.frames import Array
from postproc.robot import RobotModel

A2 = 1
"""Place of joint A2 among the actuated coordinates: the compensator stands beside it."""


def coordinates(robot: RobotModel, q: Array) -> Array:
    """Return all coordinates (N, nv) of the elastic chain for joint angles q (N, 6); virtual ones are zero."""
    full = np.zeros((len(q), robot.actual.nv))
    full[:, list(robot.actuated)] = q
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

    Gears that stiffen follow `robot.GearStiffening`; all others are linear.

    :param torque: (N, nv) on the springs, beyond what they hold at rest [N·m, N].
    :param at_rest: (N, nv) torque at rest, where θ = 0; it matters only to gears that stiffen.
    """
    theta = robot.compliance * torque
    slope = np.repeat(robot.compliance[None], len(torque), axis=0)
    if robot.stiffening is None:
        return theta, slope
    law = robot.stiffening
    spread = np.eye(torque.shape[1])[law.row]
    offset = np.zeros((len(torque), len(law.row))) if at_rest is None else at_rest[:, law.row] / law.torque
    u = torque[:, law.row] / law.torque + offset
    theta -= (law.compliance * law.torque * (u - offset - fading(u) + fading(offset))) @ spread
    slope -= (law.compliance * (1.0 - fading_slope(u))) @ spread
    return theta, slope


def fading(u: Array) -> Array:
    """Return f(u) of `robot.GearStiffening`: the deflection, over c·T, of the part of a gear that fades with load."""
    return np.asarray(np.arcsinh(u))


def fading_slope(u: Array) -> Array:
    """Return f′(u)."""
    return np.asarray(1.0 / np.sqrt(1.0 + u**2))


def rest_torque(robot: RobotModel, model: pin.Model, x: Array, weight: Array | None = None) -> Array:
    """Return U_c′ + ∇U_g (N, nv) at coordinates x (N, nv): what compensator and weights ask of the springs.

    :param model: `robot.actual`, or `robot.loaded` with the payload.
    :param weight: (N, nv) ∇U_g, if it is known.
    """
    if weight is None:
        weight = kinematics.gravity_torque(model, x) if robot.has_weight else np.zeros_like(x)
    if robot.compensator is None:
        return weight
    row = robot.actuated[A2]
    torque = weight.copy()
    torque[:, row] += robot.compensator.gradient(x[:, row])
    return torque


def reference_torque(robot: RobotModel, q: Array) -> Array:
    """Return the torque (N, nv) balanced at rest in state q (N, nv); 0 if the geometry is a weightless robot's."""
    return rest_torque(robot, robot.actual, q) if robot.subtract_reference else np.zeros_like(q)


def held_at_rest(robot: RobotModel, balanced: Array) -> Array:
    """Return the torque (N, nv) on the springs at rest that a gear which stiffens feels besides the load."""
    carries = robot.stiffening is not None and robot.stiffening.carries_weight and robot.subtract_reference
    return -balanced if carries else np.zeros_like(balanced)


def compensator_share(robot: RobotModel, x: Array, slope: Array) -> Array:
    """Return 1 + c·U_c″ (N,): how much stiffer joint 2 is for the compensator beside its spring.

    :param slope: (N, nv) tangent compliance of the springs.
    """
    if robot.compensator is None:
        return np.ones(len(x))
    row = robot.actuated[A2]
    return np.asarray(1.0 + slope[:, row] * robot.compensator.stiffness_about_joint(x[:, row]))
