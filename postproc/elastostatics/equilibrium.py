"""The loaded equilibrium, forward (from commanded joint angles) and inverse (from targets), and its linear form.

Both directions are solved as θ = c(τ(θ)) (`balance`): compliances c at the torques τ of the deflected state, with the
compensator's part of the derivative taken exactly. The rest of the derivative, compliance × stiffness of load and
weights, is some 10⁻³, so that each round gains about three digits; where it reaches 1 the arm buckles and has no
equilibrium. No matrix per sample is formed. Eq. (1) and (5) of the paper, its linear model, are functions of their own.

`compensate` finds the commands under which the deflected tool is at its targets. The controller turns a commanded pose
into joint angles q by its nominal geometry; the tool is then at g_actual(q + θ(q, F)). Off-line compensation (paper,
Fig. 1) finds the pose for which this is the target, in position and orientation, to convergence. The actual coordinates
x = q + θ at the target are known from inverse kinematics of the actual geometry. So the load on each spring is known,
and with it θ (`deflection_at_target`). If the geometry is nominal and only joints deflect, one evaluation solves the
problem. Otherwise Newton's steps move the joints to the target, and coordinates of link springs to their deflections.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from msgspec import Struct

from postproc import kinematics
from postproc.elastostatics.balance import (
    A2,
    Balance,
    balanced_torque,
    compensator_factor,
    coordinates,
    elastic_coordinates,
    in_chunks_of_states,
    joint_angles,
    load_torque,
    preload,
    spring_deflection,
    static_torque,
    twists_by_parameters,
    undeflected_balance,
)
from postproc.errors import NotConvergedError
from postproc.frames import Array, norm, twist_between
from postproc.program import Bools
from postproc.robot import Parameter, RobotModel

_POSITION_TOLERANCE = 1e-9
"""Largest error of the TCP [m] left by the iterations; the correction needs 1e-7."""
_SPRING_TOLERANCE = 3e-9
"""Largest error of a spring's deflection [rad, m] left by the iterations; the correction needs 1e-8 rad."""
_FIRST_RATIO = 0.02
"""Assumed ratio of the second step to the first; usable arms have a far smaller one."""
_LEAST_RATIO = 1e-4
"""Assumed least ratio of a step to the step before it."""
MAX_ITERATIONS = 40
"""Usable arms need under ten, each step being at most a few hundredths of the one before: more is no convergence."""
_NO_EQUILIBRIUM = "equilibrium not found: check the payload, the forces and the robot model"
_LARGEST_DEFLECTION = 0.1
"""Deflection of a spring [rad, m] beyond which the model is not valid: an error."""
_AT_TARGET = 1e-10
"""Largest distance between actual and target position [m]; 1e-7 is needed, and Newton's last step gives this."""
_ORIENTATION_TOLERANCE = 1e-11
"""Largest angle between actual and target orientation [rad]; 1e-8 is needed."""
_MOST_STEPS = 30
"""Enough for a joint to turn by 6 rad in largest steps; Newton's method then squares the error with each."""
_LARGEST_STEP = 0.2
"""Of a joint in one iteration [rad] (assumed)."""


class Deflection(Struct, frozen=True, eq=False):
    """Loaded equilibrium of N configurations.

    :param theta: (N, nv) deflections of the virtual springs [rad, m].
    :param pose: (N, 4, 4) tool frame in the root frame under load [m].
    :param unloaded_pose: (N, 4, 4) the same with θ = 0.
    """

    theta: Array
    pose: Array
    unloaded_pose: Array

    @property
    def twist(self) -> Array:
        """(N, 6) displacement of the tool frame by θ: position [m], rotation vector [rad], root axes."""
        return twist_between(self.unloaded_pose, self.pose)


def largest_compliance(robot: RobotModel, q: Array, tool: Array) -> tuple[float, float]:
    """Return the largest displacement of the tool per force [m/N] and per moment [m/(N·m)] along the root axes.

    :param q: (6,) joint angles [rad].
    :param tool: (4, 4) tool in the flange frame [m].
    :raises NotConvergedError: 1 N or 1 N·m is too large for the springs.
    """
    # states: a unit force along each axis, a unit moment about each, no load
    x0 = elastic_coordinates(robot, np.tile(q, (7, 1)).T)
    _, tip = solve_equilibrium(robot, x0, kinematics.components(tool), np.eye(6, 7))
    displacement = norm(tip.T[:6] - tip.T[6])
    return float(displacement[:3].max()), float(displacement[3:].max())


def deflect(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Deflection:
    """Solve the loaded equilibrium.

    :param robot: the robot; its `loaded` model carries the payload.
    :param q: (N, 6) joint angles that the controller holds [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :raises NotConvergedError: the load is too large for the springs, or the numbers are not finite.
    """
    x0 = elastic_coordinates(robot, q.T)
    theta, _ = solve_equilibrium(robot, x0, kinematics.components(tool), wrench.T)
    pose, unloaded_pose = (kinematics.tool_pose(robot.loaded, x.T, tool) for x in (x0 + theta, x0))
    return Deflection(theta.T, pose, unloaded_pose)


def loaded_pose(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return the pose (N, 4, 4) of the loaded tool in the root [m]; parameters as of `deflect`.

    :raises NotConvergedError: the load is too large for the springs, or the numbers are not finite.
    """
    x0 = elastic_coordinates(robot, q.T)
    theta, _ = solve_equilibrium(robot, x0, kinematics.components(tool), wrench.T)
    return kinematics.tool_pose(robot.loaded, (x0 + theta).T, tool)


def loaded_tip(robot: RobotModel, q: Array, tool: Array, wrench: Array, guess: Array | None = None) -> Array:
    """Return the position (N, 3) of the loaded tool in the root [m]; parameters as of `deflect`.

    :param guess: (N, nv) start for the deflections of the springs, e.g. the solution of a neighbouring state; None:
        zero.
    :raises NotConvergedError: the load is too large for the springs, or the numbers are not finite.
    """

    def tips(q: Array, tool: Array, wrench: Array, guess: Array) -> Array:
        """Return the positions in some of the states."""
        x0 = elastic_coordinates(robot, q.T)
        _, tip = solve_equilibrium(robot, x0, kinematics.components(tool), wrench.T, guess.T)
        return tip.T

    guess = np.broadcast_to(0.0, (len(q), robot.actual.nv)) if guess is None else guess
    return in_chunks_of_states(tips, q, tool, wrench, guess)


def deflection_by_parameter(
    robot: RobotModel, q: Array, tool: Array, wrench: Array, parameters: Sequence[Parameter]
) -> tuple[Deflection, Array]:
    """Return the loaded equilibrium and its derivatives (N, 6, P): twist of the tool per unit of each parameter, SI.

    Parameters as of `deflect`.

    :raises ModelError: the robot does not have one of the parameters.
    :raises NotConvergedError: the load is too large for the springs, or the numbers are not finite.
    """
    deflection, x0 = deflect(robot, q, tool, wrench), elastic_coordinates(robot, q.T)
    x, tools = x0 + deflection.theta.T, kinematics.components(tool)
    state = Balance.at(robot, x, balanced_torque(robot, x0), tools, wrench.T)
    return deflection, twists_by_parameters(state, state.spring_jacobian(), parameters, x0)


def solve_equilibrium(
    robot: RobotModel, x0: Array, tool: Array, wrench: Array, guess: Array | None = None
) -> tuple[Array, Array]:
    """Return the deflections of the joint springs and the tool position at which loads and springs balance.

    Iterates n samples at once; the sample index is last. The last step is added to the tool position by the Jacobian,
    without another evaluation.

    :param x0: (nv, n) coordinates that the controller holds [rad, m].
    :param tool: (3, 4, n) or (3, 4, 1) tool in the flange frame [m].
    :param wrench: (6, n) at the TCP, root axes [N, N·m].
    :param guess: (nv, n) start for the deflections θ, e.g. those of a neighbouring sample; zero by default.
    :returns: (nv, n) deflections of the springs [rad, m]; (3, n) position of the loaded tool in the root [m].
    :raises NotConvergedError: no equilibrium is found, or the load is too large for the springs.
    """
    rest_torque, wrench = balanced_torque(robot, x0), np.ascontiguousarray(wrench)
    theta = np.zeros_like(x0) if guess is None else np.ascontiguousarray(guess)
    previous_size = np.full(x0.shape[1], np.nan)
    for _ in range(MAX_ITERATIONS):
        state = Balance.at(robot, x0 + theta, rest_torque, tool, wrench)
        step = state.theta - theta
        step[robot.actuated[A2]] /= compensator_factor(robot, state.x, state.slope)
        theta = theta + step
        tool_step = np.einsum("ikn,kn->in", state.jacobian, step)
        step_size = _largest(tool_step[:3]) + _largest(tool_step[3:])  # [m] + [rad]
        is_moving = _needs_iteration(step_size, previous_size, _POSITION_TOLERANCE)
        if not is_moving.any():
            _check_size(theta)
            return theta, state.point + tool_step[:3]
        previous_size = step_size
    raise NotConvergedError(_NO_EQUILIBRIUM, np.flatnonzero(is_moving))


def deflection_at_target(robot: RobotModel, x: Array, load: Array, weights: Array) -> Array:
    """Return the deflection θ (nv, n) [rad, m] of the equilibrium at actual coordinates x = q + θ, the inverse problem.

    With x given, the torques are known, and only the reference state q = x − θ has to be found.

    :param x: (nv, n) actual coordinates [rad, m].
    :param load: (nv, n) torque JᵀF of the wrench at x [N·m, N].
    :param weights: (nv, n) of the loaded robot at x, `balance.static_torque` [N·m, N].
    :raises NotConvergedError: no reference state found, or the load is too large for the springs.
    """
    # the first reference is x itself: without payload its static torque is known already
    rest_torque = weights if robot.subtract_reference and robot.loaded is robot.actual else balanced_torque(robot, x)
    theta = np.zeros_like(x)
    previous_size = np.full(x.shape[1], np.nan)
    for _ in range(MAX_ITERATIONS):
        torque = load - weights + rest_torque
        deflection, slope = spring_deflection(
            robot, x, torque, preload(robot, rest_torque), load_torque(robot, x, torque)
        )
        step = deflection - theta
        if robot.subtract_reference:
            step[robot.actuated[A2]] /= compensator_factor(robot, x, slope)
        theta = theta + step
        step_size = _largest(step)
        # a weightless robot's geometry has no reference state: the first step is exact
        is_moving = _needs_iteration(step_size, previous_size, _SPRING_TOLERANCE) & robot.subtract_reference
        if not is_moving.any():
            _check_size(theta)
            return theta
        previous_size = step_size
        rest_torque = balanced_torque(robot, x - theta)
    raise NotConvergedError(_NO_EQUILIBRIUM, np.flatnonzero(is_moving))


def _largest(values: Array) -> Array:
    """Return the largest absolute value of each column (n,) of values (k, n)."""
    return np.asarray(np.abs(values).max(axis=0))


def _needs_iteration(step_size: Array, previous_size: Array, tolerance: float) -> Bools:
    """Return which samples (n,) need another iteration: the next step, extrapolated from the last two, is too large.

    :param step_size: (n,) size of the last step.
    :param previous_size: (n,) size of the step before; NaN if there was none.
    :param tolerance: largest size of a step that is negligible.
    :raises NotConvergedError: a step is not finite.
    """
    if not np.isfinite(step_size).all():
        raise NotConvergedError(_NO_EQUILIBRIUM, np.flatnonzero(~np.isfinite(step_size)))
    ratio = step_size / np.where(previous_size > 0.0, previous_size, 1.0)
    ratio = np.where(np.isnan(previous_size), _FIRST_RATIO, ratio)
    # a step that is tiny by accident is not followed by none; steps that grow are not extrapolated
    next_size = step_size * np.clip(ratio, _LEAST_RATIO, 1.0)
    return np.asarray(next_size > tolerance)


def _check_size(theta: Array) -> None:
    """Check that deflections (nv, n) [rad, m] are in the range of the linear springs.

    :raises NotConvergedError: one is not; it names the columns.
    """
    is_too_large = _largest(theta) > _LARGEST_DEFLECTION
    if is_too_large.any():
        raise NotConvergedError("the load is too large for the springs", np.flatnonzero(is_too_large).tolist())


def tangent_compliance(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return J (K_θ(q) − H)⁻¹ Jᵀ (N, 6, 6) at configurations q (N, 6): displacement per wrench, Eq. (1).

    H holds the load and the weights: ∂(JᵀF)/∂q − ∂²U_g/∂q². Springs that are not linear enter with their tangent
    compliance under the load.

    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    """
    state = undeflected_balance(robot, q, tool, wrench)
    return np.asarray(state.spring_jacobian() @ state.deflection_by_wrench())


def linear_compliance(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return J C Jᵀ (N, 6, 6) at configurations q (N, 6): displacement per wrench, at first order.

    C are the compliances of the springs under the load; at A2 the compensator carries its part of the torque. Unlike
    `tangent_compliance` it leaves out H in Eq. (1), how load and weights change their own torques: some thousandths of
    the stiffness of a milling robot (4 % for a KR 6 under 700 N). Computing H needs Pinocchio.

    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    """
    state = undeflected_balance(robot, q, tool, wrench)
    deflection = state.deflection_by_wrench()
    deflection[:, robot.actuated[A2]] /= compensator_factor(robot, state.x, state.slope)[:, None]
    return np.asarray(np.moveaxis(state.jacobian, -1, 0) @ deflection)


def linear_deflection(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return Δt (N, 6) [m, rad] by Newton's first step to the equilibrium of `deflect`, from θ = 0.

    θ = c(τ(θ)) becomes Δt = J (I − C·H)⁻¹ c(τ₀), C = c′(τ₀). Where all springs are linear, c(τ₀) = C·JᵀF and this is
    Eq. (1), the paper's linear model. As in `deflect`, τ₀ includes the payload, and the own weight where the
    geometry is that of a weightless robot.

    >>> from postproc import robot
    >>> arm, tool = robot.load(robot.find("kuka_kr270")), np.eye(4)
    >>> pose = np.radians([[0.0, -70.0, 110.0, 0.0, 50.0, 0.0]])
    >>> twist = linear_deflection(arm, pose, tool, np.array([[0.0, 0.0, -1000.0, 0.0, 0.0, 0.0]]))
    >>> (twist[0, :3] * 1e3).round(3).tolist()  # 1 kN downwards at the flange: mm
    [-0.255, 0.0, -0.731]
    """
    state = undeflected_balance(robot, q, tool, wrench)
    return np.asarray((state.spring_jacobian() @ state.theta.T[..., None])[..., 0])


def load_torques(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return the torques (N, 6) of loads about the axes of the joints [N·m].

    :param q: (N, 6) joint angles that the controller holds [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    """

    def torques(q: Array, tool: Array, wrench: Array) -> Array:
        """Return the torques of some of the loads."""
        _, jacobian = kinematics.tcp(robot.actual, coordinates(robot, q), tool)
        return np.asarray(np.einsum("kij,ki->kj", jacobian, wrench)[:, list(robot.actuated)])

    return in_chunks_of_states(torques, q, tool, wrench)


def cartesian_stiffness(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return K_C (N, 6, 6) at configurations q (N, 6), Eq. (5) of the paper: wrench per displacement of the TCP.

    Parameters as of `tangent_compliance`.
    """
    return np.asarray(np.linalg.inv(tangent_compliance(robot, q, tool, wrench)))


class Compensation(Struct, frozen=True, eq=False):
    """Corrected commands of N targets, converged.

    :param q: (N, 6) joint angles that the controller will hold [rad].
    :param pose: (N, 4, 4) commanded tool frame by the nominal geometry [m]; from `compensate` in the robot root.
    :param theta: (N, nv) deflections of the springs at the target [rad, m].
    """

    q: Array
    pose: Array
    theta: Array


def compensate(robot: RobotModel, target: Array, q_nominal: Array, tool: Array, wrench: Array) -> Compensation:
    """Find the commands under which the loaded tool is at its targets.

    :param robot: the robot (with its payload).
    :param target: (N, 4, 4) tool frame in the robot root [m].
    :param q_nominal: (N, 6) joint angles of the uncorrected targets by the nominal geometry [rad]: they fix the branch.
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :raises NotConvergedError: a target has no converged command; `rows` says which.
    """
    return Compensation(*in_chunks_of_states(partial(_commands, robot), q_nominal, tool, wrench, target))


def _commands(robot: RobotModel, q_nominal: Array, tool: Array, wrench: Array, target: Array) -> tuple[Array, ...]:
    """Return the fields of `Compensation` for n targets that are solved at once; parameters as of `compensate`."""
    tools, goal, wrench = kinematics.components(tool), kinematics.components(target), np.ascontiguousarray(wrench.T)
    # coordinates of the six joints, and of link springs, which no motor drives
    joints, passive = np.array(robot.actuated), np.array(robot.passive, dtype=np.int64)
    x = elastic_coordinates(robot, q_nominal.T)
    theta = np.zeros_like(x)
    for _ in range(_MOST_STEPS):
        state = kinematics.posture(robot.loaded, x, tools, weigh=robot.has_weight)
        jacobian, missing_twist = state.jacobian(), kinematics.twist_between(state.pose, goal)
        error = np.abs(missing_twist)
        # without link springs the deflection matters at the target only: no step depends on it
        if len(passive) or not _exceeds_tolerance(error).any():
            load = np.einsum("ikn,in->kn", jacobian, wrench)
            theta = deflection_at_target(robot, x, load, static_torque(robot, x, state))
            # twist of the tool by what the coordinates of link springs lack to their deflections
            link_twist = np.einsum("ikn,kn->in", jacobian[:, passive], (theta - x)[passive])
            error, missing_twist = error + np.abs(link_twist), missing_twist - link_twist
        rows = np.flatnonzero(_exceeds_tolerance(error))
        if len(rows) == 0:
            q = joint_angles(robot, x - theta)
            pose = kinematics.posture(robot.nominal, q, tools).pose
            return q.T, kinematics.matrices(pose), theta.T
        step = _newton_step(jacobian[:, joints][..., rows], missing_twist[:, rows])
        x[np.ix_(joints, rows)] += np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
        x[np.ix_(passive, rows)] = theta[np.ix_(passive, rows)]
    raise NotConvergedError("no loaded equilibrium at the target: pose singular or load too large", rows.tolist())


def _exceeds_tolerance(error: Array) -> Bools:
    """Return which errors of a pose (n,) exceed the tolerance of position or orientation.

    :param error: (6, n) sizes of the components of the twist [m, rad]; NaN exceeds the tolerance.
    """
    position_error, orientation_error = error[:3].max(axis=0), error[3:].max(axis=0)
    return np.asarray(~((position_error <= _AT_TARGET) & (orientation_error <= _ORIENTATION_TOLERANCE)))


def _newton_step(jacobian: Array, twist: Array) -> Array:
    """Return the step (6, n) [rad] of the joints that moves the tool by a twist (6, n) [m, rad]; NaN where singular.

    :param jacobian: (6, 6, n) of the tool by the joints.
    """
    square = np.moveaxis(jacobian, -1, 0)
    is_regular = np.linalg.det(square) != 0.0
    step = np.full(twist.shape, np.nan)
    step[:, is_regular] = np.linalg.solve(square[is_regular], twist.T[is_regular, :, None])[..., 0].T
    return step
