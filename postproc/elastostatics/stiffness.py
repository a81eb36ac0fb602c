"""The linear model of the paper: Eq. (1) and (5) as functions of their own."""

from __future__ import annotations

import numpy as np

from postproc import kinematics
from postproc.elastostatics.balance import Balance, held
from postproc.elastostatics.springs import spread
from postproc.frames import Array
from postproc.robot import RobotModel


def tangent_compliance(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return J (K_θ(q) − H)⁻¹ Jᵀ (N, 6, 6) at configurations q (N, 6): displacement per wrench, Eq. (1).

    H holds the load and the weights: ∂(JᵀF)/∂q − ∂²U_g/∂q². Gears that stiffen enter with their tangent under the load.

    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    """
    state = _at_reference(robot, q, tool, wrench)
    return np.asarray(state.reach() @ np.moveaxis(state.slope[:, None] * np.swapaxes(state.jacobian, 0, 1), -1, 0))


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
    state = _at_reference(robot, q, tool, wrench)
    return np.asarray((state.reach() @ state.theta.T[..., None])[..., 0])


def cartesian_stiffness(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return K_C (N, 6, 6) at configurations q (N, 6), Eq. (5): wrench per displacement of the TCP."""
    return np.asarray(np.linalg.inv(tangent_compliance(robot, q, tool, wrench)))


def _at_reference(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Balance:
    """Return the balance at θ = 0."""
    x = spread(robot, q.T)
    return Balance.at(robot, x, held(robot, x), kinematics.components(tool), wrench.T)
