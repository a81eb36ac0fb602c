"""The linear model of the paper: Eq. (1) and (5) as functions of their own."""

from __future__ import annotations

import numpy as np

from postproc import kinematics
from postproc.elastostatics.springs import A2, coordinates, held_at_rest, reference_torque, spring_deflection
from postproc.frames import Array
from postproc.robot import RobotModel


def tangent_compliance(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return J (K_θ(q) − H)⁻¹ Jᵀ (N, 6, 6) at configurations q (N, 6): displacement per wrench, Eq. (1).

    H holds the load and the weights: ∂(JᵀF)/∂q − ∂²U_g/∂q².

    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    """
    x = coordinates(robot, q)
    _, jacobian = kinematics.tcp(robot.loaded, x, tool)
    hessian = kinematics.load_stiffness(jacobian, wrench)
    if robot.has_weight:
        hessian = hessian - kinematics.gravity_stiffness(robot.loaded, x)
    load = np.einsum("nij,ni->nj", jacobian, wrench)
    _, slope = spring_deflection(robot, load, held_at_rest(robot, reference_torque(robot, x)))
    if robot.compensator is not None:
        row = robot.actuated[A2]
        hessian[:, row, row] -= robot.compensator.stiffness_about_joint(x[:, row])
    # (K − H)⁻¹ Jᵀ = (I − C·H)⁻¹ C Jᵀ with the compliances C: springs that are rigid (C = 0) need no special case
    turned = slope[:, :, None] * np.swapaxes(jacobian, 1, 2)
    return np.asarray(jacobian @ np.linalg.solve(np.eye(x.shape[1]) - slope[:, :, None] * hessian, turned))


def linear_deflection(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return Δt (N, 6) [m, rad] by the paper's linear model, Eq. (1): the first iterate of `deflect`."""
    return np.asarray(np.einsum("nij,nj->ni", tangent_compliance(robot, q, tool, wrench), wrench))


def cartesian_stiffness(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return K_C (N, 6, 6) at configurations q (N, 6), Eq. (5): wrench per displacement of the TCP."""
    return np.asarray(np.linalg.inv(tangent_compliance(robot, q, tool, wrench)))
