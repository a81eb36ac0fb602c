"""How far the predicted deflection may be off, from the covariance of the identified parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from postproc import kinematics
from postproc.chunks import in_chunks
from postproc.elastostatics.balance import asked, beside
from postproc.elastostatics.by_parameter import asked_by, more_at_rest
from postproc.elastostatics.reversals import flank_covariance
from postproc.elastostatics.springs import A2, coordinates, spring_deflection
from postproc.elastostatics.stiffness import tangent_compliance
from postproc.errors import ModelError
from postproc.frames import Array
from postproc.program import Bools
from postproc.robot import CompensatorTorque, Parameter, RobotModel, Spring, file_slopes

_QUANTILE_95 = 1.6448536
"""Of the normal distribution, one-sided."""
_LENGTH_95 = 2.7954835
"""What 95 % of vectors of three standard normal numbers are shorter than (χ² of three degrees of freedom)."""


def position_bound(
    robot: RobotModel,
    q: Array,
    tool: Array,
    wrench: Array,
    force_spread: Array | None = None,
    in_series: Array | None = None,
    turning: Bools | None = None,
) -> Array | None:
    """Return the 95 % bound (N,) [m] on the error of the predicted position of the TCP, or None.

    Five sources, added as covariances: `RobotModel.covariance` through the sensitivity of the TCP to each identified
    parameter, at first order; the covariance of the wrench through the tangent compliance; what the model was off by on
    configurations it was not fitted to (`RobotModel.discrepancy`), in any direction; the flanks that gears with lost
    motion lie on (`flank_covariance`); and, where the geometry was
    calibrated, what that was off by there without load (`RobotModel.geometry_error`).

    :param q: (N, 6) joint angles [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :param force_spread: (N, 6, m) L of the covariance L·Lᵀ of the wrench, root axes; None where it is certain.
    :param in_series: (N, 6, 6) compliance that the force meets beside the robot's, root axes; None where there is none.
    :param turning: (N, 6) joints whose gears turn over next to this place (`reversals`); None where that is not known.
    :raises ModelError: the covariance is of a parameter that the model does not have.
    """
    if robot.covariance is None:
        return None
    covariance = robot.covariance

    def bound(q: Array, tool: Array, wrench: Array, turning: Bools, *forces: Array) -> tuple[Array]:
        s = sensitivity(robot, q, tool, wrench)
        position = s @ covariance.matrix @ np.swapaxes(s, 1, 2)
        if forces:
            spread, compliance = forces
            moved = (tangent_compliance(robot, q, tool, wrench) + compliance)[:, :3] @ spread
            position += moved @ np.swapaxes(moved, 1, 2)
        if robot.discrepancy is not None:
            position += (robot.discrepancy.at(wrench) / _LENGTH_95)[:, None, None] ** 2 * np.eye(3)
        position += (robot.geometry_error / _LENGTH_95) ** 2 * np.eye(3)
        position += flank_covariance(robot, q, tool, wrench, turning)
        return (length_bound(position),)

    beside = np.zeros((len(q), 6, 6)) if in_series is None else in_series
    others = () if force_spread is None else (force_spread, beside)
    turning = np.zeros((len(q), 6), dtype=bool) if turning is None else turning
    return in_chunks(bound, q, np.broadcast_to(tool, (len(q), 4, 4)), wrench, turning, *others)[0]


FORCES = "the cutting forces"
"""Source of uncertainty, see `largest_source`."""


def largest_source(
    robot: RobotModel,
    q: Array,
    tool: Array,
    wrench: Array,
    force_spread: Array | None = None,
    in_series: Array | None = None,
    turning: Bools | None = None,
) -> str:
    """Return what contributes most to `position_bound` of one place, in words: a joint or link, the forces, ….

    Correlated parameters of one joint count together. Parameters as in `position_bound`, with N = 1.
    """
    assert robot.covariance is not None
    s = sensitivity(robot, q, tool, wrench)[0]
    turning = np.zeros((1, 6), dtype=bool) if turning is None else turning
    share = np.einsum("ip,pk,ik->p", s, robot.covariance.matrix, s)
    variance: dict[str, float] = {}
    for parameter, each in zip(robot.covariance.parameters, share.tolist(), strict=True):
        source = f"the model of {parameter.place}"
        variance[source] = variance.get(source, 0.0) + each
    if force_spread is not None:
        compliance = tangent_compliance(robot, q, tool, wrench)[0] + (0.0 if in_series is None else in_series[0])
        variance[FORCES] = float(np.sum((compliance[:3] @ force_spread[0]) ** 2))
    unmodelled = 0.0 if robot.discrepancy is None else float(robot.discrepancy.at(wrench)[0])
    variance["the unmodelled error of the robot model"] = 3.0 * (unmodelled / _LENGTH_95) ** 2
    variance["lost motion of the gears"] = float(np.trace(flank_covariance(robot, q, tool, wrench, turning)[0]))
    variance["the calibrated geometry"] = 3.0 * (robot.geometry_error / _LENGTH_95) ** 2
    return max(variance, key=variance.__getitem__)


def length_bound(covariance: Array) -> Array:
    """Return what the length of normal vectors with covariances (N, 3, 3) stays below with 95 % probability (N,).

    It is bounded by its first two moments: |e|² ~ g·χ²_h with g = tr Σ²/tr Σ, h = tr² Σ/tr Σ² (Satterthwaite 1946), and
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
    linear = file_slopes(order, {parameter: parameter.of(robot) for parameter in order})
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
    at_rest = np.zeros_like(torque)
    nonlinear = robot.terms or any(isinstance(parameter, Spring) and not parameter.linear for parameter in parameters)
    if nonlinear and (robot.carries_weight or not robot.subtract_reference):
        at_rest = -asked(robot, x.T).T
    _, slope = spring_deflection(robot, torque, at_rest)
    share = beside(robot, x.T, slope.T)
    torque[:, second] /= share  # what is left for the gear
    theta, slope = spring_deflection(robot, torque, at_rest)
    reach = jacobian[:, :3].copy()
    reach[:, :, second] /= share[:, None]
    pressed = more_at_rest(robot, torque.T, at_rest.T).T
    columns = []
    for parameter in parameters:
        if isinstance(parameter, Spring):
            row = parameter.row(robot)
            columns.append(reach[:, :, row] * parameter.effect(torque[:, row], at_rest[:, row])[0][:, None])
            continue
        bent = -pressed * asked_by(robot, parameter, x.T).T
        if isinstance(parameter, CompensatorTorque) and robot.compensator is not None:
            stiffer = parameter.effect(robot.compensator, x[:, second])[1]
            bent[:, second] -= slope[:, second] * theta[:, second] * stiffer
        columns.append(np.einsum("nik,nk->ni", reach, bent))
    return np.stack(columns, axis=2)


def _payload(robot: RobotModel, x: Array) -> Array:
    """Return the torque (n, nv) of the payload that the cell adds, at coordinates x (n, nv)."""
    if robot.loaded is robot.actual:
        return np.zeros_like(x)
    loaded, without = (kinematics.posture(chain, x.T, weigh=True).weight() for chain in (robot.loaded, robot.actual))
    return np.asarray((loaded - without).T)
