"""The loaded equilibrium: forward (where does the tool go?) and inverse (what do the springs give way there?).

Both are solved as θ = c(τ(θ)) (`balance`): the compliances c applied to the torques τ at the deflected state, with the
compensator's part of the derivative taken exactly. What remains of the derivative, compliance × stiffness of load and
weights, is some 10⁻³, so that each round gains about three digits; where it reaches 1 the arm buckles and there is no
equilibrium to be found. No matrix per sample is formed.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import kinematics
from postproc.elastostatics.balance import Balance, beside, felt, held, load_alone
from postproc.elastostatics.springs import A2, given_way, spread
from postproc.errors import NotConvergedError
from postproc.frames import Array, norm, twist_between
from postproc.program import Bools
from postproc.robot import RobotModel

_POSITION_TOLERANCE = 1e-9
"""Largest error of the TCP [m] left by the iterations; 1e-7 is asked of the whole correction."""
_SPRING_TOLERANCE = 3e-9
"""Largest error of a spring's deflection [rad, m] left by the iterations; 1e-8 rad is asked of the correction."""
_FIRST_RATIO = 0.02
"""Assumed ratio of the second step to the first: far above what arms show that are of any use."""
_MAX_ITERATIONS = 40
_LARGEST_DEFLECTION = 0.1
"""Deflection of a spring [rad, m] beyond which the model means nothing: an error, not a number."""


class Deflection(Struct, frozen=True, eq=False):
    """Loaded equilibrium of N configurations.

    :param theta: (N, nv) deflections of the virtual springs [rad, m].
    :param pose: (N, 4, 4) tool frame in the root frame under load [m].
    :param rest: (N, 4, 4) the same with θ = 0.
    """

    theta: Array
    pose: Array
    rest: Array

    @property
    def twist(self) -> Array:
        """(N, 6) displacement of the tool frame from rest: position [m], rotation vector [rad], root axes."""
        return twist_between(self.rest, self.pose)


def softness(robot: RobotModel, q: Array, tool: Array) -> tuple[float, float]:
    """Return how far the tool gives way at most, at a configuration, per force [m/N] and per moment [m/(N·m)].

    :param q: (6,) joint angles [rad].
    :param tool: (4, 4) tool in the flange frame [m].
    """
    x0 = spread(robot, np.tile(q, (7, 1)).T)
    _, tip = solve_equilibrium(robot, x0, kinematics.components(tool), np.eye(6, 7))
    moved = norm(tip.T[:6] - tip.T[6])
    return float(moved[:3].max()), float(moved[3:].max())


def deflect(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Deflection:
    """Solve the loaded equilibrium.

    :param robot: the robot; its `loaded` model carries the payload.
    :param q: (N, 6) joint angles that the controller holds [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :raises NotConvergedError: the load is beyond what the springs hold, or the numbers are not finite.
    """
    x0 = spread(robot, q.T)
    theta, _ = solve_equilibrium(robot, x0, kinematics.components(tool), wrench.T)
    pose, rest = (kinematics.tcp(robot.loaded, x.T, tool)[0] for x in (x0 + theta, x0))
    return Deflection(theta.T, pose, rest)


def solve_equilibrium(
    robot: RobotModel, x0: Array, tool: Array, wrench: Array, guess: Array | None = None
) -> tuple[Array, Array]:
    """Solve the loaded equilibrium, as `deflect`, with the sample index last.

    :param x0: (nv, n) coordinates that the controller holds.
    :param tool: (3, 4, n) or (3, 4, 1).
    :param wrench: (6, n).
    :param guess: (nv, n) start for θ, e.g. the solution of a neighbouring state.
    :returns: (nv, n) deflections of the springs [rad, m]; (3, n) where the tool tip stands [m].
    """
    balanced, wrench = held(robot, x0), np.ascontiguousarray(wrench)
    theta = np.zeros_like(x0) if guess is None else np.ascontiguousarray(guess)
    previous = np.full(x0.shape[1], np.nan)
    for _ in range(_MAX_ITERATIONS):
        state = Balance.at(robot, x0 + theta, balanced, tool, wrench)
        step = state.theta - theta
        step[robot.actuated[A2]] /= beside(robot, state.x, state.slope)
        theta = theta + step
        moved = np.einsum("ikn,kn->in", state.jacobian, step)
        size = _largest(moved[:3]) + _largest(moved[3:])
        more = _unfinished(size, previous, _POSITION_TOLERANCE)
        if not more.any():
            _check_size(theta)
            return theta, state.point + moved[:3]
        previous = size
    raise NotConvergedError("equilibrium not found", np.flatnonzero(more))


def springs_at(robot: RobotModel, x: Array, load: Array, weights: Array) -> Array:
    """Return θ (nv, n) that holds the equilibrium where the ACTUAL coordinates are known: the inverse problem.

    With x = q + θ given, the torques are known, and only the reference state q = x − θ has to be found.

    :param x: (nv, n) actual coordinates [rad, m].
    :param load: (nv, n) JᵀF at x.
    :param weights: (nv, n) of the loaded robot at x, `balance.asked`.
    :raises NotConvergedError: no reference state found, or the load is beyond what the springs hold.
    """
    # the first reference is that at x itself: without payload it is what is asked for there anyway
    balanced = weights if robot.subtract_reference and robot.loaded is robot.actual else held(robot, x)
    theta = np.zeros_like(x)
    previous = np.full(x.shape[1], np.nan)
    for _ in range(_MAX_ITERATIONS):
        torque = load - weights + balanced
        found, slope = given_way(robot, torque, felt(robot, balanced), load_alone(robot, x, torque))
        step = found - theta
        if robot.subtract_reference:
            step[robot.actuated[A2]] /= beside(robot, x, slope)
        theta = theta + step
        size = _largest(step)
        more = _unfinished(size, previous, _SPRING_TOLERANCE) & robot.subtract_reference
        if not more.any():
            _check_size(theta)
            return theta
        previous = size
        balanced = held(robot, x - theta)
    raise NotConvergedError("equilibrium not found", np.flatnonzero(more))


def _largest(values: Array) -> Array:
    return np.asarray(np.abs(values).max(axis=0))


def _unfinished(size: Array, previous: Array, tolerance: float) -> Bools:
    """Return which samples need another round: the next step, foreseen from the last two, would still matter."""
    if not np.isfinite(size).all():
        raise NotConvergedError("equilibrium not found", np.flatnonzero(~np.isfinite(size)))
    ratio = np.where(np.isnan(previous), _FIRST_RATIO, size / np.where(previous > 0.0, previous, 1.0))
    return np.asarray(~(size * np.clip(ratio, 1e-4, 1.0) <= tolerance))


def _check_size(theta: Array) -> None:
    large = _largest(theta) > _LARGEST_DEFLECTION
    if large.any():
        raise NotConvergedError("the load is beyond what the springs hold", np.flatnonzero(large).tolist())
