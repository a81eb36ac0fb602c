"""Uncertainty of the predicted deflection: 95 % bound, sensitivities to parameters, the largest source."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from postproc import kinematics
from postproc.chunks import in_chunks
from postproc.elastostatics.balance import (
    A2,
    compensator_factor,
    compliance_by_preload,
    coordinates,
    spring_deflection,
    static_torque,
    static_torque_by_parameter,
)
from postproc.elastostatics.equilibrium import tangent_compliance
from postproc.elastostatics.reversals import flank_covariance
from postproc.errors import ModelError
from postproc.frames import Array
from postproc.program import Bools
from postproc.robot import CompensatorTorque, Parameter, RobotModel, Spring, file_slopes

_QUANTILE_95 = 1.6448536
"""Of the normal distribution, one-sided."""
LENGTH_95 = 2.7954835
"""95 % of vectors of three standard normal numbers are shorter (χ² of three degrees of freedom)."""


def position_bound(
    robot: RobotModel,
    q: Array,
    tool: Array,
    wrench: Array,
    force_spread: Array | None = None,
    in_series: Array | None = None,
    turning: Bools | None = None,
    scaled: Bools | None = None,
) -> Array | None:
    """Return the 95 % bound (N,) [m] on the error of the predicted position of the TCP, or None.

    Five sources, added as covariances: `RobotModel.covariance` through the sensitivity of the TCP to each identified
    parameter, at first order; the covariance of the wrench through the tangent compliance; the unmodelled error
    (`RobotModel.discrepancy`), in any direction; the unknown flanks of gears with lost motion (`flank_covariance`); and
    the error of a calibrated geometry without load (`RobotModel.geometry_error`).

    **Correlated forces.** If the components of a wrench w are off by one factor of standard deviation f (a harder
    material, a worn tool), their displacements C·w add up with their signs: the covariance is f²·(C w)(C w)ᵀ (JCGM
    100:2008, "Guide to the expression of uncertainty in measurement", 5.2.2: inputs with correlation +1 add
    linearly). If they are independent, it is f²·C diag(w²) Cᵀ. With a correlation ρ between, it is ρ times the former
    plus 1 − ρ times the latter. ρ is not known, since published sets of coefficients differ in size and in ratios. The
    covariance is linear in ρ, so its trace is largest at one of the two ends: the larger of their bounds counts.

    :param q: (N, 6) joint angles [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :param force_spread: (N, 6, 6) L of the covariance L·Lᵀ of the wrench, root axes; None if it is certain. (N, 6, 13)
        where errors may also be one factor: then six columns L for independent components, and seven for one factor.
    :param in_series: (N, 6, 6) compliance in series with the robot's, root axes; None if there is none.
    :param turning: (N, 6) joints whose gears change their flank next to this place (`reversals`); None if not known.
    :param scaled: (N,) places where the error of the wrench is one factor, `RobotModel.force_factor`, correlated with
        the parameters; `force_spread` does not count there. None: nowhere.
    :raises ModelError: the covariance is of a parameter that the model does not have.
    """
    if robot.covariance is None:
        return None

    def bound(q: Array, tool: Array, wrench: Array, turning: Bools, scaled: Bools, *forces: Array) -> tuple[Array]:
        forces = _reaction(robot, q, tool, wrench, *forces)
        s, covariance = _with_factor(robot, sensitivity(robot, q, tool, wrench), wrench, scaled, *forces)
        by_model = s @ covariance @ np.swapaxes(s, 1, 2)
        rest = sum(_others(robot, q, tool, wrench, turning).values(), by_model)
        return (np.max([length_bound(rest + each) for each in _by_forces(scaled, *forces)], axis=0),)

    if turning is None:
        turning = np.zeros((len(q), 6), dtype=bool)
    if scaled is None:
        scaled = np.zeros(len(q), dtype=bool)
    forces = _given(q, force_spread, in_series)
    return in_chunks(bound, q, np.broadcast_to(tool, (len(q), 4, 4)), wrench, turning, scaled, *forces)[0]


def _given(q: Array, force_spread: Array | None, in_series: Array | None) -> tuple[Array, ...]:
    if force_spread is None:
        return ()
    return force_spread, np.zeros((len(q), 6, 6)) if in_series is None else in_series


def _reaction(robot: RobotModel, q: Array, tool: Array, wrench: Array, *forces: Array) -> tuple[Array, ...]:
    """Return `force_spread`, and (N, 3, 6) displacement by the wrench; nothing where the forces are certain."""
    if not forces:
        return ()
    spread, compliance = forces
    return spread, (tangent_compliance(robot, q, tool, wrench) + compliance)[:, :3]


def _with_factor(robot: RobotModel, s: Array, wrench: Array, scaled: Bools, *forces: Array) -> tuple[Array, Array]:
    """Return sensitivities (N, 3, P) to parameters with that to the factor of forces, and their covariance."""
    assert robot.covariance is not None
    matrix, factor = robot.covariance.matrix, robot.force_factor
    if factor is None or not forces or not scaled.any():
        return s, matrix
    by_factor = np.einsum("nij,nj->ni", forces[1], wrench) * scaled[:, None]
    size = len(matrix)
    joint = np.empty((size + 1, size + 1))
    joint[:size, :size], joint[size], joint[:, size] = matrix, factor.covariance, factor.covariance
    return np.concatenate([s, by_factor[:, :, None]], axis=2), joint


FORCES = "the cutting forces"
"""Source of uncertainty, see `largest_source`."""


def _others(robot: RobotModel, q: Array, tool: Array, wrench: Array, turning: Bools) -> dict[str, Array]:
    """Return the covariances (N, 3, 3) [m²] of the position that come from neither parameters nor forces."""
    out = {}
    out["the calibrated geometry"] = _any_direction(np.full(len(q), robot.geometry_error))
    if robot.discrepancy is not None:
        out["the unmodelled error of the robot model"] = _any_direction(robot.discrepancy.at(wrench))
    out["lost motion of the gears"] = flank_covariance(robot, q, tool, wrench, turning)
    return out


_COMPONENTS = 6
"""Columns of `force_spread` for independent components of the wrench."""


def _by_forces(scaled: Bools, *forces: Array) -> list[Array]:
    """Return the covariance (N, 3, 3) [m²] of the position by the forces for each correlation that is possible.

    :param forces: from `_reaction`.
    """
    if not forces:
        return [np.zeros((len(scaled), 3, 3))]
    spread, reaction = forces
    moved = reaction @ spread * ~scaled[:, None, None]
    ends = [moved[:, :, :_COMPONENTS], moved[:, :, _COMPONENTS:]][: 1 if spread.shape[2] == _COMPONENTS else 2]
    return [each @ np.swapaxes(each, 1, 2) for each in ends]


def _any_direction(length: Array) -> Array:
    """Return the covariances (N, 3, 3) of errors whose length stays below `length` (N,) in 95 % of cases."""
    return np.asarray((length / LENGTH_95)[:, None, None] ** 2 * np.eye(3))


def largest_source(
    robot: RobotModel,
    q: Array,
    tool: Array,
    wrench: Array,
    force_spread: Array | None = None,
    in_series: Array | None = None,
    *,
    turning: Bools,
    scaled: Bools | None = None,
) -> str:
    """Return the largest contribution to `position_bound` of one place, in words: a joint or link, the forces, ….

    Correlated parameters of one joint count together. Parameters as in `position_bound`, with N = 1.
    """
    assert robot.covariance is not None
    if scaled is None:
        scaled = np.zeros(1, dtype=bool)
    forces = _reaction(robot, q, tool, wrench, *_given(q, force_spread, in_series))
    s, joint = _with_factor(robot, sensitivity(robot, q, tool, wrench), wrench, scaled, *forces)
    variance: dict[str, float] = {}
    sources = [*(f"the model of {parameter.place}" for parameter in robot.covariance.parameters), FORCES]
    for source, each in zip(sources, np.einsum("ip,pk,ik->p", s[0], joint, s[0]).tolist(), strict=False):
        variance[source] = variance.get(source, 0.0) + each
    for source, covariance in _others(robot, q, tool, wrench, turning).items():
        variance[source] = variance.get(source, 0.0) + float(np.trace(covariance[0]))
    by_forces = max(float(np.trace(each[0])) for each in _by_forces(scaled, *forces))
    variance[FORCES] = variance.get(FORCES, 0.0) + by_forces
    return max(variance, key=variance.__getitem__)


def length_bound(covariance: Array) -> Array:
    """Return the 95 % quantile (N,) of the length of normal vectors with covariances (N, 3, 3).

    It follows from the first two moments: |e|² ~ g·χ²_h with g = tr Σ²/tr Σ, h = tr² Σ/tr Σ² (Satterthwaite 1946), and
    the quantile of χ² by Wilson and Hilferty (1931), good to 1.5 %.
    """
    trace = np.trace(covariance, axis1=1, axis2=2)
    square = np.sum(covariance**2, axis=(1, 2))
    h = np.divide(trace**2, square, out=np.ones_like(trace), where=square > 0.0)
    g = np.divide(square, trace, out=np.zeros_like(trace), where=trace > 0.0)
    quantile = h * (1.0 - 2.0 / (9.0 * h) + _QUANTILE_95 * np.sqrt(2.0 / (9.0 * h))) ** 3
    return np.asarray(np.sqrt(g * quantile))


def sensitivity(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return (N, 3, P) ∂(position of the TCP)/∂(parameter), in m per unit of the file, at first order in the load.

    The parameters are those of `robot.covariance`, as files hold them: whole, each at fixed values of the others.
    """
    parameters = robot.covariance.parameters if robot.covariance is not None else ()
    if not parameters:
        return np.zeros((len(q), 3, 0))
    order = list(dict.fromkeys([*parameters, *(p for each in parameters for p in each.partners())]))
    linear = file_slopes(order, {parameter: robot.value(parameter) for parameter in order})
    try:
        by_file = np.linalg.inv(linear)[:, [order.index(parameter) for parameter in parameters]]
    except np.linalg.LinAlgError:
        raise ModelError("[covariance] is of a compensator that has no spring") from None
    return np.asarray(_linear_sensitivity(robot, order, q, tool, wrench) @ by_file)


def _linear_sensitivity(
    robot: RobotModel, parameters: Sequence[Parameter], q: Array, tool: Array, wrench: Array
) -> Array:
    """Return (N, 3, P) by the linear values of the parameters [m per SI unit]."""
    x = coordinates(robot, q)
    _, jacobian = kinematics.tcp(robot.loaded, x, tool)
    torque = np.einsum("nij,ni->nj", jacobian, wrench) - _payload(robot, x)
    second = robot.actuated[A2]
    preload = np.zeros_like(torque)
    if robot.carries_weight or not robot.subtract_reference:
        preload = -static_torque(robot, x.T).T
    _, slope = spring_deflection(robot, torque.T, preload.T)
    share = compensator_factor(robot, x.T, slope)
    torque[:, second] /= share  # the rest is the compensator's
    theta, slope = (each.T for each in spring_deflection(robot, torque.T, preload.T))
    lever = jacobian[:, :3].copy()
    lever[:, :, second] /= share[:, None]
    by_preload = compliance_by_preload(robot, torque.T, preload.T).T
    columns = []
    for parameter in parameters:
        if isinstance(parameter, Spring):
            row = robot.row(parameter)
            columns.append(lever[:, :, row] * parameter.effect(torque[:, row], preload[:, row])[0][:, None])
            continue
        shift = -by_preload * static_torque_by_parameter(robot, parameter, x.T).T
        if isinstance(parameter, CompensatorTorque) and robot.compensator is not None:
            stiffer = parameter.effect(robot.compensator, x[:, second])[1]
            shift[:, second] -= slope[:, second] * theta[:, second] * stiffer
        columns.append(np.einsum("nik,nk->ni", lever, shift))
    return np.stack(columns, axis=2)


def _payload(robot: RobotModel, x: Array) -> Array:
    """Return the torque (n, nv) of the cell's payload at coordinates x (n, nv)."""
    if robot.loaded is robot.actual:
        return np.zeros_like(x)
    loaded, without = (kinematics.posture(chain, x.T, weigh=True).weight() for chain in (robot.loaded, robot.actual))
    return np.asarray((loaded - without).T)
