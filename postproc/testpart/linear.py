"""Deviations of probed surfaces, linear in the unknowns: predicted, solved for and what remains of them.

The unknowns are the parameters of the robot and the scale of the forces. What the part adds enters by its covariance
(`readings.Readings.part_covariance`). An error that the model does not describe is a share γ of the deflection.
"""

from __future__ import annotations

import numpy as np

from postproc.chunks import Columns
from postproc.errors import MeasurementError, NotConvergedError
from postproc.frames import Array
from postproc.identification.uncertainty import WIDTH
from postproc.program import Bools
from postproc.testpart.cut import States
from postproc.testpart.prior import MIN_SHARE, Prior
from postproc.testpart.readings import Readings
from postproc.under_load import RobotInCell

_ROUNDS = 12
"""Limit of Gauss-Newton rounds (assumed); they end when the step is small."""
_STEP_TOLERANCE = 2e-8
"""Change of a predicted deviation that ends the iteration at fixed forces [m] (assumed)."""
GAMMA = 0.005
"""Median of γ before any reading (assumed)."""
_LIGHT = 0.25
"""Displacements below this share of the largest are those of light passes (assumed)."""
_LIGHT_PASS_ERROR = 0.15
"""Relative error of the displacement by a light pass: its chip is the difference of the deflections before; assumed."""


class LinearPrediction(Columns, frozen=True, eq=False):
    """Predicted deviations and their derivatives.

    :param value: (n,) deviations at no lift, linear from the lift of the states [m].
    :param slopes: (n, p + 1) derivatives by z and the scale of the forces.
    :param by_lift: (n,) derivatives by the lift of the program over the block.
    :param displacement: (n,) displacements of the tool [m].
    """

    value: Array
    slopes: Array
    by_lift: Array
    displacement: Array


def linearise(
    prior: Prior, readings: Readings, states: States, robot_in_cell: RobotInCell, z: Array, scale: float
) -> LinearPrediction:
    """Return predicted deviations and their derivatives at values of the unknowns.

    :raises MeasurementError: the springs have no equilibrium under the forces.
    """
    robot = prior.robot_with_change(z)
    try:
        twist, by_parameter, by_scale = states.derivatives(robot_in_cell, robot, prior.order, scale)
    except NotConvergedError as cause:
        raise MeasurementError(f"no equilibrium under the cutting forces: {cause}", file=readings.probed.file) from None
    value, weight = readings.surfaces.deviation(twist)
    slopes = np.einsum("nk,nkp->np", weight, by_parameter) @ prior.by_file
    slopes = np.column_stack([slopes, np.einsum("nk,nk->n", weight, by_scale)])
    by_lift = np.einsum("nk,nk->n", weight, states.twist_by_lift(robot_in_cell, robot, scale))
    deflection = scale * np.linalg.norm(by_scale[:, :3], axis=1)
    displacement = np.where(readings.probed.mass > 0.0, np.abs(value), deflection)
    return LinearPrediction(value - by_lift * states.lift, slopes, by_lift, displacement)


def noise_of(readings: Readings, local: LinearPrediction, gamma: float) -> Array:
    """Return the covariance (n, n) [m²] of the deviations for a robot and forces that are known."""
    variance = np.diag(
        readings.sigma**2 + (gamma * local.displacement) ** 2 + light_pass_variance(readings, local.displacement)
    )
    return np.asarray(variance + readings.part_covariance(local.by_lift))


def light_pass_variance(readings: Readings, displacement: Array) -> Array:
    """Return the variance (n,) [m²] of displacements (n,) because the chips of light passes are hardly known."""
    cut = readings.probed.mass == 0.0
    return np.where(cut & (displacement < _LIGHT * displacement.max()), (_LIGHT_PASS_ERROR * displacement) ** 2, 0.0)


def solve(
    prior: Prior, readings: Readings, states: States, robot_in_cell: RobotInCell, z: Array, scale: float, free: Bools
) -> tuple[LinearPrediction, Array, float, float]:
    """Return the model linearised at the solution for fixed forces, and z, the scale and γ there.

    Each round solves the linear least squares with the prior, and linearises anew at its solution.

    :param z: (P,) unknowns of the model where it begins, see `Prior.robot_with_change`.
    :param scale: factor of the forces there.
    :param free: (P + 1,) which of z and the scale may change.
    """
    whole = prior.covariance
    gamma = 0.0
    for _ in range(_ROUNDS):
        local = linearise(prior, readings, states, robot_in_cell, z, scale)
        x = np.append(z, scale - 1.0)
        target = readings.probed.deviation - local.value + local.slopes @ x
        gamma = unmodelled_share(readings, local, whole, target)
        noise = noise_of(readings, local, gamma)
        covariance = local.slopes @ whole @ local.slopes.T + noise
        solution = free * (whole @ local.slopes.T @ np.linalg.solve(covariance, target))
        z, scale = solution[:-1], max(1.0 + float(solution[-1]), MIN_SHARE)
        if float(np.abs(local.slopes @ (solution - x)).max()) < _STEP_TOLERANCE:
            break
    return linearise(prior, readings, states, robot_in_cell, z, scale), z, scale, gamma


def unmodelled_share(readings: Readings, local: LinearPrediction, whole: Array, target: Array) -> float:
    """Return γ: the root of its mean square, given the readings."""
    log_ratio = np.linspace(-4.0, 4.0, 97)  # fine enough for γ from 200 readings
    share = GAMMA * np.exp(WIDTH * log_ratio)
    covariance = local.slopes @ whole @ local.slopes.T + noise_of(readings, local, 0.0)
    likely = np.empty(len(share))
    for k, gamma in enumerate(share.tolist()):
        lower = np.linalg.cholesky(covariance + np.diag((gamma * local.displacement) ** 2))
        white = np.linalg.solve(lower, target)
        likely[k] = -0.5 * float(white @ white) - float(np.log(np.diag(lower)).sum()) - 0.5 * log_ratio[k] ** 2
    chance = np.exp(likely - likely.max())
    return float(np.sqrt(np.sum(chance * share**2) / chance.sum()))


def posterior(readings: Readings, local: LinearPrediction, gamma: float, whole: Array, free: Bools) -> Array:
    """Return the covariance (p + 1, p + 1) after the readings.

    A parameter that is not free keeps its value, and its uncertainty counts for those that are: Schmidt, "Application
    of state-space methods to navigation problems", 1966 (consider covariance).
    """
    noise = noise_of(readings, local, gamma)
    spread = whole @ local.slopes.T
    gain = free[:, None] * np.linalg.solve(local.slopes @ spread + noise, spread.T).T
    left = np.eye(len(whole)) - gain @ local.slopes
    return np.asarray(left @ whole @ left.T + gain @ noise @ gain.T)


def cross_validation_errors(
    readings: Readings, local: LinearPrediction, gamma: float, whole: Array, z: Array, scale: float
) -> tuple[Array, Array]:
    """Return the error (n,) of each point predicted from all others, and its variance (n,).

    Source: Rasmussen and Williams, "Gaussian Processes for Machine Learning", 2006, Eq. (5.12).
    """
    target = readings.probed.deviation - local.value + local.slopes @ np.append(z, scale - 1.0)
    inverse = np.linalg.inv(local.slopes @ whole @ local.slopes.T + noise_of(readings, local, gamma))
    diagonal = np.diag(inverse)
    return inverse @ target / diagonal, 1.0 / diagonal
