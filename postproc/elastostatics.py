"""Elastostatics of the robot: virtual springs, equilibrium under load, Cartesian stiffness.

Source: Klimchik et al., Eq. (1), (4), (5), in the form of a potential (θ: deflections of the virtual springs, q + θ:
actual coordinates):

    V(θ) = ½ θᵀ K⁰ θ + [U_c(q₂+θ₂) − U_c(q₂) − U_c′(q₂) θ₂] + [U_g(q+θ) − U_g(q) − ∇U_g(q)·θ] − W_F(q+θ)

The loaded equilibrium is its minimum. The terms linear in θ inside the brackets are subtracted where the geometry
already holds the state of rest (`RobotModel.subtract_reference`). Wrenches are dead loads at the TCP: force [N] and
moment [N·m] on the tool, root axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from postproc import kinematics
from postproc.errors import ModelError, NotConvergedError
from postproc.frames import M_PER_MM, Array, displaced, twist_between
from postproc.robot import RobotModel

_POSITION_TOLERANCE = 1e-9
"""Largest error of the TCP [m] left by the iterations; 1e-7 is asked of the whole correction."""
_SPRING_TOLERANCE = 3e-9
"""Largest error of a spring's deflection [rad, m] left by the iterations; 1e-8 rad is asked of the correction."""
_MAX_ITERATIONS = 30
_LARGEST_DEFLECTION = 0.1
"""Deflection of a spring [rad, m] beyond which the model means nothing: an error, not a number."""
_CHUNK = 4096
_A2 = 1
_JOINT_PARAMETERS = ("k1", "k2", "k3", "k4", "k5", "k6")


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
    if _by_compliance(robot):
        load = np.einsum("nij,ni->nj", jacobian, wrench)
        at_rest = _held_at_rest(robot, _reference_torque(robot, x), np.zeros_like(x))
        _, slope = spring_deflection(robot, load, at_rest)
        if robot.compensator is not None:
            row = robot.actuated[_A2]
            hessian[:, row, row] -= robot.compensator.stiffness_about_joint(x[:, row])
        turned = slope[:, :, None] * np.swapaxes(jacobian, 1, 2)
        return np.asarray(jacobian @ np.linalg.solve(np.eye(x.shape[1]) - slope[:, :, None] * hessian, turned))
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
    if _by_compliance(robot):
        return _deflect_by_compliance(robot, q, tool, wrench, guess, unloaded)
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
            _check_size(theta)
            return Deflection(theta, pose, rest)
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
    if _by_compliance(robot):
        return _springs_by_compliance(robot, x, load)
    tangent = joint_stiffness(robot, x)
    theta = np.zeros_like(x)
    rows = np.arange(len(x))
    previous = np.full(len(x), np.nan)
    # without payload, what compensator and weights ask of the springs at x is the reference itself while θ = 0
    balanced = robot.subtract_reference and robot.loaded is robot.actual
    at_rest = None if balanced else _spring_torque(robot, x, theta)
    for iteration in range(_MAX_ITERATIONS):
        residual = theta[rows] @ robot.stiffness - load[rows]
        if iteration or not balanced:
            at_rest = _spring_torque(robot, x, np.zeros_like(x)) if at_rest is None else at_rest
            residual += at_rest[rows] - _reference_torque(robot, x[rows] - theta[rows])
        step = -np.linalg.solve(tangent[rows], residual[..., None])[..., 0]
        theta[rows] += step
        size = np.abs(step).max(axis=1, initial=0.0)
        if not np.isfinite(size).all():
            raise NotConvergedError("equilibrium not found", rows[~np.isfinite(size)])
        ratio = size / previous[rows] if iteration else np.full(len(rows), 0.05)
        previous[rows] = size
        rows = rows[~(size * np.clip(ratio, 1e-4, 1.0) <= _SPRING_TOLERANCE)]
        if len(rows) == 0:
            _check_size(theta)
            return theta
    raise NotConvergedError("equilibrium not found", rows)


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


def position_bound(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array | None:
    """Return the 95 % bound (N,) [m] on the error of the predicted deflection of the TCP, or None.

    From `RobotModel.covariance` and the sensitivity of the TCP to each identified parameter, at first order. The length
    of a normal vector with covariance Σ is bounded by its first two moments: |e|² ~ g·χ²_h with g = tr Σ²/tr Σ,
    h = tr² Σ/tr Σ² (Satterthwaite 1946), and the quantile of χ² by Wilson and Hilferty (1931), good to 1.5 %.

    :param q: (N, 6) joint angles [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :raises ModelError: the covariance names a parameter that the model does not have.
    """
    if robot.covariance is None:
        return None
    bound = np.empty(len(q))
    covariance = np.array(robot.covariance.matrix, dtype=float)
    for begin in range(0, len(q), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        s = sensitivity(robot, q[part], tool if tool.ndim == 2 else tool[part], wrench[part])
        spread = s @ covariance @ np.swapaxes(s, 1, 2)
        trace = np.trace(spread, axis1=1, axis2=2)
        square = np.sum(spread**2, axis=(1, 2))
        h = np.divide(trace**2, square, out=np.ones_like(trace), where=square > 0.0)
        g = np.divide(square, trace, out=np.zeros_like(trace), where=trace > 0.0)
        bound[part] = np.sqrt(g * h * (1.0 - 2.0 / (9.0 * h) + 1.6448536 * np.sqrt(2.0 / (9.0 * h))) ** 3)
    return bound


def sensitivity(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return (N, 3, P) ∂(position of the TCP)/∂(parameter), in m per unit of the file, at first order in the load.

    Parameters by name, in the order of `robot.covariance`: ``k1``…``k6`` [µrad/(N·m)], ``k1@800`` the part of k1 that
    fades beyond 800 N·m, ``K_c`` [N/m], ``s_0`` [mm], ``A2.RX`` the springs of links [µm/N, µrad/(N·m)].
    """
    names = robot.covariance.parameters if robot.covariance is not None else []
    x = coordinates(robot, q)
    _, jacobian = kinematics.tcp(robot.loaded, x, tool)
    torque = np.einsum("nij,ni->nj", jacobian, wrench)
    second = robot.actuated[_A2]
    share = _compensator_share(robot, x, np.repeat(robot.compliance[None], len(x), axis=0))
    torque[:, second] /= share  # what is left for the gear
    reach = jacobian[:, :3].copy()
    reach[:, :, second] /= share[:, None]
    link_rows = dict(zip((f"{s.link}.{s.axis}" for s in robot.link_springs), robot.passive, strict=True))
    columns = []
    for name in names:
        joint, _, limit = name.partition("@")
        if name in ("K_c", "s_0") and robot.compensator is not None:
            law = robot.compensator
            unit = replace(law, stiffness=1.0)
            factor = unit.stiffness_about_joint(x[:, second])
            if name == "s_0":
                longer = replace(law, free_length=law.free_length + M_PER_MM)
                factor = longer.stiffness_about_joint(x[:, second]) - law.stiffness_about_joint(x[:, second])
            columns.append(
                reach[:, :, second] * (-(robot.compliance[second] ** 2) * torque[:, second] * factor)[:, None]
            )
        elif name in link_rows:
            columns.append(1e-6 * reach[:, :, link_rows[name]] * torque[:, link_rows[name], None])
        elif joint in _JOINT_PARAMETERS:
            row = robot.actuated[_JOINT_PARAMETERS.index(joint)]
            amount = torque[:, row]
            if limit:
                amount = float(limit) * fading(amount / float(limit)) - amount
            columns.append(1e-6 * reach[:, :, row] * amount[:, None])
        else:
            raise ModelError(f"[covariance] names {name!r}, which the model does not have")
    return np.stack(columns, axis=2) if columns else np.zeros((len(q), 3, 0))


def _by_compliance(robot: RobotModel) -> bool:
    """Link springs and gears that stiffen are solved in compliance form, without a matrix per sample."""
    return robot.stiffening is not None or robot.actual.nv > len(robot.actuated)


def _held_at_rest(robot: RobotModel, balanced: Array, shift: Array) -> Array:
    """Return the torque at rest on the springs (N, nv) that a stiffening gear feels besides the load."""
    carries = robot.stiffening is not None and robot.stiffening.carries_weight and robot.subtract_reference
    return -balanced if carries else shift


def _deflect_by_compliance(
    robot: RobotModel, q: Array, tool: Array, wrench: Array, guess: Array | None, unloaded: Array | None
) -> Deflection:
    """`deflect` as the fixed point θ = c(τ(θ)), with the compensator's part of the derivative taken exactly.

    What remains of the derivative, compliance × load stiffness, is some 10⁻³: each round gains three digits. No
    (nv, nv) matrix is formed, so that thirty coordinates cost little more than six.
    """
    count = len(q)
    pose = np.empty((count, 4, 4))
    if unloaded is None:
        unloaded = np.empty((count, 4, 4))
        known = False
    else:
        known = True
    theta = np.zeros((count, robot.actual.nv)) if guess is None else np.array(guess)
    for begin in range(0, count, _CHUNK):
        part = slice(begin, begin + _CHUNK)
        tools = tool if tool.ndim == 2 else tool[part]
        x0 = coordinates(robot, q[part])
        if not known:
            unloaded[part] = kinematics.tcp(robot.loaded, x0, tools)[0]
        try:
            theta[part], pose[part] = _fixed_point(robot, x0, theta[part], tools, wrench[part])
        except NotConvergedError as cause:
            raise NotConvergedError(str(cause), [begin + row for row in cause.rows]) from None
    return Deflection(theta, pose, unloaded)


def _fixed_point(robot: RobotModel, x0: Array, start: Array, tool: Array, wrench: Array) -> tuple[Array, Array]:
    theta = start.copy()
    pose = np.empty((len(x0), 4, 4))
    reference = _reference_torque(robot, x0)
    at_rest = _held_at_rest(robot, reference, np.zeros_like(x0))
    rows = np.arange(len(x0))
    previous = np.full(len(x0), np.nan)
    for iteration in range(_MAX_ITERATIONS):
        x = x0[rows] + theta[rows]
        here, jacobian = kinematics.tcp(robot.loaded, x, tool if tool.ndim == 2 else tool[rows])
        torque = np.einsum("nij,ni->nj", jacobian, wrench[rows]) + reference[rows]
        torque -= _spring_torque_of_position(robot, x)
        step, slope = spring_deflection(robot, torque, at_rest[rows])
        step -= theta[rows]
        step[:, robot.actuated[_A2]] /= _compensator_share(robot, x, slope)
        theta[rows] += step
        moved = np.einsum("nij,nj->ni", jacobian, step)
        pose[rows] = displaced(here, moved)
        size = np.abs(moved[:, :3]).max(axis=1, initial=0.0) + np.abs(moved[:, 3:]).max(axis=1, initial=0.0)
        if not np.isfinite(size).all():
            raise NotConvergedError("equilibrium not found", rows[~np.isfinite(size)])
        ratio = size / previous[rows] if iteration else np.minimum(1.0, 2.0 * size)
        previous[rows] = size
        rows = rows[~(size * np.clip(ratio, 1e-4, 1.0) <= _POSITION_TOLERANCE)]
        if len(rows) == 0:
            return theta, pose
    raise NotConvergedError("equilibrium not found", rows)


def _springs_by_compliance(robot: RobotModel, x: Array, load: Array) -> Array:
    """`springs_at` in compliance form: θ = c(τ) with τ known but for the reference state q = x − θ."""
    here = _spring_torque_of_position(robot, x)
    theta = np.zeros_like(x)
    rows = np.arange(len(x))
    for _ in range(_MAX_ITERATIONS):
        reference = _reference_torque(robot, x[rows] - theta[rows])
        at_rest = _held_at_rest(robot, reference, np.zeros_like(reference))
        step, slope = spring_deflection(robot, load[rows] + reference - here[rows], at_rest)
        step -= theta[rows]
        step[:, robot.actuated[_A2]] /= _compensator_share(robot, x[rows], slope)
        theta[rows] += step
        size = np.abs(step).max(axis=1, initial=0.0)
        if not np.isfinite(size).all():
            raise NotConvergedError("equilibrium not found", rows[~np.isfinite(size)])
        rows = rows[size > 0.1 * _POSITION_TOLERANCE]
        if len(rows) == 0:
            _check_size(theta)
            return theta
    raise NotConvergedError("equilibrium not found", rows)


def _compensator_share(robot: RobotModel, x: Array, slope: Array) -> Array:
    """Return 1 + c·U_c″ (N,): how much stiffer joint 2 is for the compensator beside its spring."""
    if robot.compensator is None:
        return np.ones(len(x))
    row = robot.actuated[_A2]
    share: Array = 1.0 + slope[:, row] * robot.compensator.stiffness_about_joint(x[:, row])
    return share


def _check_size(theta: Array) -> None:
    large = np.abs(theta).max(axis=1, initial=0.0) > _LARGEST_DEFLECTION
    if large.any():
        raise NotConvergedError("the load is beyond what the springs hold", np.flatnonzero(large).tolist())


def _spring_torque(robot: RobotModel, x: Array, theta: Array) -> Array:
    """Return K⁰θ + U_c′ + ∇U_g at actual coordinates x (N, nv)."""
    return np.asarray(theta @ robot.stiffness + _spring_torque_of_position(robot, x))


def _spring_torque_of_position(robot: RobotModel, x: Array) -> Array:
    """Return U_c′ + ∇U_g at actual coordinates x (N, nv)."""
    torque = np.zeros_like(x)
    if robot.has_weight:
        torque += kinematics.gravity_torque(robot.loaded, x)
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
