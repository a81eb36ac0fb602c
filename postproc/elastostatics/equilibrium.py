"""The loaded equilibrium: forward (where does the tool go?) and inverse (what do the springs give way there?).

Both are solved as θ = c(τ(θ)): the compliances c applied to the torques τ at the deflected state, with the
compensator's part of the derivative taken exactly. What remains of the derivative, compliance × stiffness of load and
weights, is some 10⁻³, so that each round gains about three digits; where it reaches 1 the arm buckles and there is no
equilibrium to be found. No matrix per sample is formed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from postproc import kinematics
from postproc.chunks import in_chunks
from postproc.elastostatics.springs import (
    A2,
    compensator_share,
    coordinates,
    held_at_rest,
    reference_torque,
    rest_torque,
    spring_deflection,
)
from postproc.errors import NotConvergedError
from postproc.frames import Array, displaced, largest, norm, twist_between
from postproc.program import Bools, Ints
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


@dataclass(frozen=True, slots=True, eq=False)
class Deflection:
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
    loaded = deflect(robot, np.tile(q, (7, 1)), tool, np.eye(7, 6)).pose[:, :3, 3]
    moved = norm(loaded[:6] - loaded[6])
    return float(moved[:3].max()), float(moved[3:].max())


def deflect(
    robot: RobotModel, q: Array, tool: Array, wrench: Array, guess: Array | None = None, unloaded: Array | None = None
) -> Deflection:
    """Solve the loaded equilibrium.

    :param robot: the robot; its `loaded` model carries the payload.
    :param q: (N, 6) joint angles that the controller holds [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :param guess: (N, nv) start for θ, e.g. the solution of a neighbouring state.
    :param unloaded: (N, 4, 4) pose of the tool frame at θ = 0, if it is known.
    :raises NotConvergedError: the load is beyond what the springs hold, or the numbers are not finite.
    """
    x0 = coordinates(robot, q)
    tools = np.broadcast_to(tool, (len(q), 4, 4))

    def solve(x0: Array, start: Array, tool: Array, wrench: Array) -> tuple[Array, Array]:
        return _fixed_point(robot, x0, start, tool, wrench)

    theta, pose = in_chunks(solve, x0, np.zeros_like(x0) if guess is None else guess, tools, wrench)
    return Deflection(theta, pose, kinematics.tcp(robot.loaded, x0, tool)[0] if unloaded is None else unloaded)


def _fixed_point(robot: RobotModel, x0: Array, start: Array, tool: Array, wrench: Array) -> tuple[Array, Array]:
    theta = start.copy()
    pose = np.empty((len(x0), 4, 4))
    reference = reference_torque(robot, x0)
    at_rest = held_at_rest(robot, reference)
    rows = np.arange(len(x0))
    previous = np.full(len(x0), np.nan)
    for _ in range(_MAX_ITERATIONS):
        x = x0[rows] + theta[rows]
        here, jacobian, weight = kinematics.tcp_and_weight(robot.loaded, x, tool[rows])
        torque = np.einsum("nij,ni->nj", jacobian, wrench[rows]) + reference[rows]
        torque -= rest_torque(robot, robot.loaded, x, weight)
        step, slope = spring_deflection(robot, torque, at_rest[rows])
        step -= theta[rows]
        step[:, robot.actuated[A2]] /= compensator_share(robot, x, slope)
        theta[rows] += step
        moved = np.einsum("nij,nj->ni", jacobian, step)
        pose[rows] = displaced(here, moved)
        size = largest(moved[:, :3]) + largest(moved[:, 3:])
        more = _unfinished(rows, size, previous[rows], _POSITION_TOLERANCE)
        previous[rows] = size
        rows = rows[more]
        if len(rows) == 0:
            _check_size(theta)
            return theta, pose
    raise NotConvergedError("equilibrium not found", rows)


def springs_at(robot: RobotModel, x: Array, jacobian: Array, wrench: Array, weight: Array | None = None) -> Array:
    """Return θ (N, nv) that holds the equilibrium where the ACTUAL coordinates are known: the inverse problem.

    With x = q + θ given, the torque of the load is known, and only the reference state q = x − θ has to be found.

    :param x: (N, nv) actual coordinates [rad, m].
    :param jacobian: (N, 6, nv) of the TCP at x.
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :param weight: (N, nv) ∇U_g of the loaded robot at x, if it is known.
    :raises NotConvergedError: no reference state found, or the load is beyond what the springs hold.
    """
    torque = np.einsum("nij,ni->nj", jacobian, wrench) - rest_torque(robot, robot.loaded, x, weight)
    # the first reference is that at x itself: without payload it is what the torque holds anyway
    known = weight if robot.loaded is robot.actual else None
    reference = rest_torque(robot, robot.actual, x, known) if robot.subtract_reference else np.zeros_like(x)
    theta = np.zeros_like(x)
    rows = np.arange(len(x))
    previous = np.full(len(x), np.nan)
    for iteration in range(_MAX_ITERATIONS):
        if iteration:
            reference = reference_torque(robot, x[rows] - theta[rows])
        step, slope = spring_deflection(robot, torque[rows] + reference, held_at_rest(robot, reference))
        if not robot.subtract_reference:
            _check_size(step)
            return step
        step -= theta[rows]
        step[:, robot.actuated[A2]] /= compensator_share(robot, x[rows], slope)
        theta[rows] += step
        size = largest(step)
        more = _unfinished(rows, size, previous[rows], _SPRING_TOLERANCE)
        previous[rows] = size
        rows = rows[more]
        if len(rows) == 0:
            _check_size(theta)
            return theta
    raise NotConvergedError("equilibrium not found", rows)


def _unfinished(rows: Ints, size: Array, previous: Array, tolerance: float) -> Bools:
    """Return which rows need another round: the next step, foreseen from the last two, would still matter."""
    if not np.isfinite(size).all():
        raise NotConvergedError("equilibrium not found", rows[~np.isfinite(size)])
    ratio = np.where(np.isnan(previous), _FIRST_RATIO, size / np.where(previous > 0.0, previous, 1.0))
    return np.asarray(~(size * np.clip(ratio, 1e-4, 1.0) <= tolerance))


def _check_size(theta: Array) -> None:
    large = largest(theta) > _LARGEST_DEFLECTION
    if large.any():
        raise NotConvergedError("the load is beyond what the springs hold", np.flatnonzero(large).tolist())
