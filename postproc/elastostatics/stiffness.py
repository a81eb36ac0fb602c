"""The linear model of the paper: Eq. (1) and (5) as functions of their own."""

from __future__ import annotations

import numpy as np

from postproc import kinematics
from postproc.elastostatics.springs import (
    A2,
    coordinates,
    held_at_rest,
    reference_torque,
    rest_torque,
    spring_deflection,
)
from postproc.frames import Array
from postproc.robot import RobotModel


def tangent_compliance(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return J (K_θ(q) − H)⁻¹ Jᵀ (N, 6, 6) at configurations q (N, 6): displacement per wrench, Eq. (1).

    H holds the load and the weights: ∂(JᵀF)/∂q − ∂²U_g/∂q². Gears that stiffen enter with their tangent under the load.

    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    """
    jacobian, _, slope, tangent = _at_reference(robot, q, tool, wrench)
    return np.asarray(jacobian @ np.linalg.solve(tangent, slope[:, :, None] * np.swapaxes(jacobian, 1, 2)))


def linear_deflection(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return Δt (N, 6) [m, rad] by Newton's first step to the equilibrium of `deflect`, from θ = 0.

    θ = c(τ(θ)) becomes Δt = J (I − C·H)⁻¹ c(τ₀), C = c′(τ₀). Where all springs are linear, c(τ₀) = C·JᵀF and this is
    Eq. (1), the paper's linear model. Like `deflect` it counts, in τ₀, the payload, and the own weight of a robot whose
    geometry is that of a weightless one.

    >>> from postproc import robot
    >>> arm, tool = robot.load(robot.find("kuka_kr270")), np.eye(4)
    >>> pose = np.radians([[0.0, -70.0, 110.0, 0.0, 50.0, 0.0]])
    >>> twist = linear_deflection(arm, pose, tool, np.array([[0.0, 0.0, -1000.0, 0.0, 0.0, 0.0]]))
    >>> (twist[0, :3] * 1e3).round(3).tolist()  # 1 kN downwards at the flange: mm
    [-0.255, 0.0, -0.731]
    """
    jacobian, theta, _, tangent = _at_reference(robot, q, tool, wrench)
    return np.asarray((jacobian @ np.linalg.solve(tangent, theta[:, :, None]))[..., 0])


def _at_reference(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> tuple[Array, Array, Array, Array]:
    """Return, at θ = 0: J (N, 6, nv), c(τ₀) (N, nv), c′(τ₀) (N, nv), and I − C·H (N, nv, nv).

    I − C·H instead of K − H, with the compliances C: springs that are rigid (C = 0) need no special case.
    """
    x = coordinates(robot, q)
    _, jacobian = kinematics.tcp(robot.loaded, x, tool)
    hessian = kinematics.load_stiffness(jacobian, wrench)
    if robot.has_weight:
        hessian = hessian - kinematics.gravity_stiffness(robot.loaded, x)
    if robot.compensator is not None:
        row = robot.actuated[A2]
        hessian[:, row, row] -= robot.compensator.stiffness_about_joint(x[:, row])
    reference = reference_torque(robot, x)
    torque = np.einsum("nij,ni->nj", jacobian, wrench) + (reference - rest_torque(robot, robot.loaded, x))
    theta, slope = spring_deflection(robot, torque, held_at_rest(robot, reference))
    return jacobian, theta, slope, np.eye(x.shape[1]) - slope[:, :, None] * hessian


def cartesian_stiffness(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return K_C (N, 6, 6) at configurations q (N, 6), Eq. (5): wrench per displacement of the TCP."""
    return np.asarray(np.linalg.inv(tangent_compliance(robot, q, tool, wrench)))
