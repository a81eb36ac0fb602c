"""A configuration whose readings without load contradict those of all others: an angle or a point that was noted wrong.

Least squares spread one wrong configuration over all others: 3° of A2 at one of 30 move a calibrated length by 5 mm.
So each configuration is judged by what the others predict for it. For linear least squares that needs no second fit
(deletion diagnostics: Belsley, Kuh and Welsch 1980, chapter 2; Cook and Weisberg 1982, section 2.2).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from postproc import elastostatics, kinematics
from postproc.errors import MeasurementError
from postproc.frames import DEG_PER_RAD, MM_PER_M, RAD_PER_DEG, Array, norm
from postproc.identification.measurement_model import Placement, in_root_axes
from postproc.identification.readings import Measurements
from postproc.robot import JOINTS, RobotModel

_OUTLIER_RATIO = 8.0
"""Ratio of the error of a configuration to its uncertainty from which it is an outlier. Errors of a geometry are far
from normal: of 448 clean sets of simulated arms whose geometry is off by millimetres the largest is 6.9."""
_MIN_DISTANCE = 1e-3
"""Distance [m] of the points below which it is no wrong note but friction or temperature (assumed): 0.05° of A1."""
_MIN_CONFIGURATIONS = 10
"""Configurations from which the scatter of the others is known well enough to judge one."""
_NO_SCATTER = 1e-15
"""Scatter of readings that were made from the model itself, in any unit: rounding."""
_SINGULAR_SHARE = 1e-6
"""Share of a direction that the other configurations leave open, below which they predict nothing along it."""
_EXPLAINED_SHARE = 0.2
"""Share of an error that a wrong joint angle may leave: other errors leave most of it."""
_MOST_ANGLE = 10.0 * RAD_PER_DEG
"""Error of an angle up to which the displacement of a point is linear in it, by 2 %."""


class Deletion(NamedTuple):
    """Error of each configuration against a fit to the other configurations.

    :param error: (C, m) readings less their prediction by the other configurations, in the unit of the residuals.
    :param ratio: (C,) size of the error over its uncertainty, which is from the scatter of the other configurations.
    """

    error: Array
    ratio: Array


def deletion(design: Array, residual: Array, ridge: Array) -> Deletion:
    """Return the error (C, m) of each configuration against a fit to the others, and its ratio (C,) to its uncertainty.

    Linear least squares need no second fit. With H_i the block of the hat matrix and r_i the residuals of configuration
    i, the error is e_i = (I − H_i)⁻¹ r_i. Its covariance is s² (I − H_i)⁻¹, so the ratio is √(r_iᵀ e_i / m) / s.

    The scatter s is the median of the RMS residuals of the other configurations in the fit without configuration i,
    over √(degrees of freedom / readings), by which residuals are smaller than the noise. A second outlier does not
    spoil a median.

    :param design: (C, m, p) derivatives of the readings of each configuration by the unknowns, whitened.
    :param residual: (C, m) residuals of the fit to all configurations, whitened.
    :param ridge: (k, p) rows of a prior on the unknowns; k may be zero.
    """
    count, m, _ = design.shape
    # orthonormal: the block H_i of the hat matrix is basis[i] @ basis[i].T
    basis = np.linalg.qr(np.concatenate([*design, ridge]))[0][: count * m].reshape(count, m, -1)
    error, ratio = np.empty_like(residual), np.empty(count)
    degrees_of_freedom = count * m - float(np.sum(basis**2))
    shrinkage = np.sqrt(max(degrees_of_freedom, 1.0) / (count * m))
    for i in range(count):
        inverse = np.linalg.pinv(np.eye(m) - basis[i] @ basis[i].T, rcond=_SINGULAR_SHARE, hermitian=True)
        error[i] = inverse @ residual[i]
        residual_without_i = residual + basis @ (basis[i].T @ error[i])  # of all, in the fit without configuration i
        other_residuals = np.delete(residual_without_i, i, axis=0)
        scatter = np.median(np.sqrt(np.mean(other_residuals**2, axis=1))) / shrinkage
        ratio[i] = np.sqrt(residual[i] @ error[i] / m) / max(scatter, _NO_SCATTER)
    return Deletion(error, ratio)


def check_configurations(
    robot: RobotModel, data: Measurements, placement: Placement, design: Array, ridge: Array, weight: Array
) -> None:
    """Check that no configuration contradicts all others without load, if they are `_MIN_CONFIGURATIONS` or more.

    :param robot: with the geometry of the fit.
    :param placement: of the fit, with its residuals.
    :param design: (C, 3·P, p) derivatives of the mean positions, device axes, by the p unknowns of the fit, times
        weight.
    :param ridge: (k, p) rows of a prior on the unknowns; k may be zero.
    :param weight: (C, 3·P) factors on the mean positions, in proportion to 1/σ; zero without readings.
    :raises MeasurementError: a configuration does; the message names it, and a joint angle that would explain it.
    """
    if len(data.q) < _MIN_CONFIGURATIONS:
        return
    deletions = deletion(design, placement.residual.reshape(weight.shape) * weight, ridge)
    error = np.divide(deletions.error, weight, out=np.zeros_like(weight), where=weight > 0.0).reshape(
        len(data.q), -1, 3
    )
    distance = np.sqrt(np.mean(np.sum(error**2, axis=2), axis=1))
    worst = int(np.argmax(deletions.ratio))
    if deletions.ratio[worst] < _OUTLIER_RATIO or distance[worst] < _MIN_DISTANCE:
        return
    raise MeasurementError(
        f"config {data.config[worst]:g}: without load the points are {distance[worst] * MM_PER_M:.1f} mm from where "
        f"the other configurations put them, {deletions.ratio[worst]:.0f} times as far as usual"
        f"{_wrong_angle(robot, data.q[worst], placement.points, in_root_axes(placement, error[worst]))}",
        file=data.file,
        line=data.first_line(worst),
        advice="Correct its angles or readings, or leave the configuration out.",
    )


def _wrong_angle(robot: RobotModel, q: Array, points: Array, error: Array) -> str:
    """Return, as the end of a sentence, the wrong joint angle that would explain an error; empty if none would.

    :param q: (6,) joint angles as noted [rad].
    :param error: (P, 3) of the points, root axes [m].
    """
    tools = np.tile(np.eye(4), (len(points), 1, 1))
    tools[:, :3, 3] = points
    x = elastostatics.coordinates(robot, np.tile(q, (len(points), 1)))
    _, tool_jacobian = kinematics.tcp(robot.actual, x, tools)
    jacobian = tool_jacobian[:, :3, list(robot.actuated)].reshape(-1, len(JOINTS))
    # least squares with each joint alone; 1e-12: points on the axis of a joint are not moved
    angle = jacobian.T @ error.ravel() / np.maximum(norm(jacobian.T) ** 2, 1e-12)
    unexplained = norm(error.ravel() - (jacobian * angle).T)
    best = int(np.argmin(unexplained))
    if unexplained[best] > _EXPLAINED_SHARE * norm(error.ravel()) or abs(angle[best]) > _MOST_ANGLE:
        return ""
    comparative = "larger" if angle[best] > 0.0 else "smaller"
    return (
        f". An {JOINTS[best]} that is {abs(angle[best]) * DEG_PER_RAD:.2f}° {comparative} (KUKA signs) would explain it"
    )
