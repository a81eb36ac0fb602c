"""Elastostatics of the robot: virtual springs, equilibrium under load, Cartesian stiffness.

Source: Klimchik et al., Eq. (1), (4), (5), in the form of a potential (θ: deflections of the virtual springs, q + θ:
actual coordinates):

    V(θ) = ½ θᵀ K⁰ θ + [U_c(q₂+θ₂) − U_c(q₂) − U_c′(q₂) θ₂] + [U_g(q+θ) − U_g(q) − ∇U_g(q)·θ] − W_F(q+θ)

The loaded equilibrium is its minimum. The terms linear in θ inside the brackets are subtracted where the geometry
already holds the state of rest (`RobotModel.subtract_reference`). Wrenches are dead loads at the TCP: force [N] and
moment [N·m] on the tool, root axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from postproc import kinematics
from postproc.errors import NotConvergedError
from postproc.frames import Array, displaced, twist_between
from postproc.robot import RobotModel

_POSITION_TOLERANCE = 1e-9
"""Largest error of the TCP [m] left by the iterations; 1e-7 is asked of the whole correction."""
_MAX_ITERATIONS = 30
_A2 = 1


@dataclass(frozen=True, slots=True, eq=False)
class Deflection:
    """Loaded equilibrium of N configurations.

    :param theta: (N, nv) deflections of the virtual springs [rad, m].
    :param pose: (N, 4, 4) tool frame in the root frame under load [m].
    :param twist: (N, 6) displacement of the tool frame from where it stands with θ = 0: position [m], rotation
        vector [rad], root axes.
    """

    theta: Array
    pose: Array
    twist: Array


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
        row = robot.actuated[_A2]
        stiffness[:, row, row] += robot.compensator.stiffness_about_joint(q[:, row])
    return stiffness


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
    springs = joint_stiffness(robot, x) - hessian
    return np.asarray(jacobian @ np.linalg.solve(springs, np.swapaxes(jacobian, 1, 2)))


def linear_deflection(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return Δt (N, 6) [m, rad] by the paper's linear model, Eq. (1): the first iterate of `deflect`."""
    return np.asarray(np.einsum("nij,nj->ni", tangent_compliance(robot, q, tool, wrench), wrench))


def cartesian_stiffness(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return K_C (N, 6, 6) at configurations q (N, 6), Eq. (5): wrench per displacement of the TCP."""
    return np.asarray(np.linalg.inv(tangent_compliance(robot, q, tool, wrench)))


def deflect(
    robot: RobotModel, q: Array, tool: Array, wrench: Array, guess: Array | None = None, unloaded: Array | None = None
) -> Deflection:
    """Solve the loaded equilibrium by Newton's method.

    :param robot: the robot; its `loaded` model carries the payload.
    :param q: (N, 6) joint angles that the controller holds [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :param guess: (N, nv) start for θ, e.g. the solution of a neighbouring state.
    :param unloaded: (N, 4, 4) pose of the tool frame at θ = 0, if it is known.
    :raises NotConvergedError: the load is beyond what the springs hold, or the numbers are not finite.
    """
    count = len(q)
    x0 = coordinates(robot, q)
    reference = _reference_torque(robot, x0)
    theta = np.zeros_like(x0) if guess is None else np.array(guess)
    pose = np.empty((count, 4, 4))
    rest = kinematics.tcp(robot.loaded, x0, tool)[0] if unloaded is None else unloaded
    rows = np.arange(count)
    previous = np.full(count, np.nan)
    for iteration in range(_MAX_ITERATIONS):
        x = x0[rows] + theta[rows]
        here, jacobian = kinematics.tcp(robot.loaded, x, tool if tool.ndim == 2 else tool[rows])
        force = wrench[rows]
        residual = _spring_torque(robot, x, theta[rows]) - reference[rows]
        residual -= np.einsum("nij,ni->nj", jacobian, force)
        tangent = joint_stiffness(robot, x) - kinematics.load_stiffness(jacobian, force)
        step = -np.linalg.solve(tangent, residual[..., None])[..., 0]
        theta[rows] += step
        moved = np.einsum("nij,nj->ni", jacobian, step)
        pose[rows] = displaced(here, moved)
        size = np.abs(moved[:, :3]).max(axis=1, initial=0.0) + np.abs(moved[:, 3:]).max(axis=1, initial=0.0)
        if not np.isfinite(size).all():
            raise NotConvergedError("equilibrium not found", rows[~np.isfinite(size)])
        # the next step is smaller by at least the ratio of the last two; the first one is judged by its size [1/m]
        ratio = size / previous[rows] if iteration else np.minimum(1.0, 2.0 * size)
        previous[rows] = size
        rows = rows[~(size * np.clip(ratio, 1e-4, 1.0) <= _POSITION_TOLERANCE)]
        if len(rows) == 0:
            return Deflection(theta, pose, twist_between(rest, pose))
    raise NotConvergedError("equilibrium not found", rows)


def springs_at(robot: RobotModel, x: Array, jacobian: Array, wrench: Array) -> Array:
    """Return θ (N, nv) that holds the equilibrium where the ACTUAL coordinates are known: the inverse problem.

    With x = q + θ given, the torque of the load is known, and only the reference state q = x − θ has to be found.

    :param x: (N, nv) actual coordinates [rad, m].
    :param jacobian: (N, 6, nv) of the TCP at x.
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :raises NotConvergedError: no reference state found.
    """
    load = np.einsum("nij,ni->nj", jacobian, wrench)
    at_rest = _spring_torque(robot, x, np.zeros_like(x))
    tangent = joint_stiffness(robot, x)
    theta = np.zeros_like(x)
    rows = np.arange(len(x))
    previous = np.full(len(x), np.nan)
    for iteration in range(_MAX_ITERATIONS):
        held = at_rest[rows] + np.einsum("ij,nj->ni", robot.stiffness, theta[rows])
        residual = held - _reference_torque(robot, x[rows] - theta[rows]) - load[rows]
        step = -np.linalg.solve(tangent[rows], residual[..., None])[..., 0]
        theta[rows] += step
        size = np.abs(step).max(axis=1, initial=0.0)
        if not np.isfinite(size).all():
            raise NotConvergedError("equilibrium not found", rows[~np.isfinite(size)])
        ratio = size / previous[rows] if iteration else np.full(len(rows), 0.05)
        previous[rows] = size
        rows = rows[~(size * np.clip(ratio, 1e-4, 1.0) <= _POSITION_TOLERANCE)]
        if len(rows) == 0:
            return theta
    raise NotConvergedError("equilibrium not found", rows)


def _spring_torque(robot: RobotModel, x: Array, theta: Array) -> Array:
    """Return K⁰θ + U_c′ + ∇U_g at actual coordinates x (N, nv)."""
    torque: Array = theta @ robot.stiffness
    if robot.has_weight:
        torque = torque + kinematics.gravity_torque(robot.loaded, x)
    if robot.compensator is not None:
        row = robot.actuated[_A2]
        torque[:, row] += robot.compensator.gradient(x[:, row])
    return torque


def _reference_torque(robot: RobotModel, x: Array) -> Array:
    """Return U_c′ + ∇U_g of the reference state (N, nv), or zero where the geometry is that of a weightless robot."""
    torque = np.zeros_like(x)
    if not robot.subtract_reference:
        return torque
    if robot.has_weight:
        torque += kinematics.gravity_torque(robot.actual, x)
    if robot.compensator is not None:
        row = robot.actuated[_A2]
        torque[:, row] += robot.compensator.gradient(x[:, row])
    return torque
