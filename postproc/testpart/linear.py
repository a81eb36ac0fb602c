"""Deviations of probed surfaces, linear in the unknowns: predicted, solved for and what remains of them.

The unknowns are the parameters of the robot and the scale of the forces. What the part adds enters by its covariance
(`readings.Readings.part_covariance`). An error that the model does not describe is a share γ of the deflection.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from postproc.chunks import Columns
from postproc.errors import MeasurementError, NotConvergedError
from postproc.frames import Array
from postproc.identification.uncertainty import LOG_SIGMA
from postproc.program import Bools
from postproc.testpart.cut import States
from postproc.testpart.prior import MIN_SHARE, Prior
from postproc.testpart.readings import Readings
from postproc.under_load import RobotInCell

_MOST_ROUNDS = 12
"""Limit of Gauss-Newton rounds (assumed); they end when the step is small."""
_STEP_TOLERANCE = 2e-8
"""Change of a predicted deviation that ends the iteration at fixed forces [m] (assumed)."""
GAMMA = 0.005
"""Median of γ before any reading (assumed)."""
_LIGHT_SHARE = 0.25
"""Passes whose displacement is below this share of the largest are light passes (assumed)."""
_LIGHT_PASS_ERROR = 0.15
"""Relative error of the displacement by a light pass: its chip is the difference of the deflections before; assumed."""


class LinearPrediction(Columns, frozen=True, eq=False):
    """Predicted deviations and their derivatives.

    :param value: (n,) deviations of a program without lift, extrapolated linearly from the lift of the states [m].
    :param slopes: (n, p + 1) derivatives by z and the scale of the forces.
    :param by_lift: (n,) derivatives by the lift of the program over the block.
    :param displacement: (n,) size of the displacement of the tool by forces [m].
    """

    value: Array
    slopes: Array
    by_lift: Array
    displacement: Array


def linearise(
    prior: Prior, readings: Readings, states: States, robot_in_cell: RobotInCell, *, z: Array, scale: float
) -> LinearPrediction:
    """Return predicted deviations and their derivatives at values of the unknowns.

    :param states: states of the robot where the surfaces are made, with the forces.
    :param z: (p,) change of the parameters from the prior, units of files; `scale` factor of the forces.
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
    by_lift = np.einsum("nk,nk->n", weight, states.twist_by_lift(robot_in_cell, robot, scale, twist))
    deflection = scale * np.linalg.norm(by_scale[:, :3], axis=1)
    # a gauge reads the displacement by the weight, which the scale of the cutting forces does not change
    displacement = np.where(readings.probed.mass > 0.0, np.abs(value), deflection)
    return LinearPrediction(value - by_lift * states.lift, slopes, by_lift, displacement)


def noise_covariance(readings: Readings, local: LinearPrediction, gamma: float) -> Array:
    """Return the covariance (n, n) [m²] of the deviations if robot and forces are known exactly.

    :param local: linear model of the deviations.
    :param gamma: unmodelled error as a share of the displacement of the tool.
    """
    variance = np.diag(
        readings.sigma**2 + (gamma * local.displacement) ** 2 + light_pass_variance(readings, local.displacement)
    )
    return np.asarray(variance + readings.part_covariance(local.by_lift))


def light_pass_variance(readings: Readings, displacement: Array) -> Array:
    """Return the variance (n,) [m²] of displacements (n,) [m] by light passes; 0 for other passes and for weights.

    The chip of a light pass is the difference of the deflections of the passes before: its force is hardly known.
    """
    is_light_pass = (readings.probed.mass == 0.0) & (displacement < _LIGHT_SHARE * displacement.max())
    return np.where(is_light_pass, (_LIGHT_PASS_ERROR * displacement) ** 2, 0.0)


class Solution(NamedTuple):
    """The most probable unknowns for fixed forces.

    :param local: linear model at these unknowns.
    :param z: (p,) change of the parameters from the prior, units of files.
    :param scale: factor of the forces.
    :param gamma: unmodelled error γ as a share of the displacement of the tool.
    """

    local: LinearPrediction
    z: Array
    scale: float
    gamma: float


def solve(
    prior: Prior,
    readings: Readings,
    states: States,
    robot_in_cell: RobotInCell,
    *,
    z: Array,
    scale: float,
    free: Bools,
    local: LinearPrediction | None = None,
) -> Solution:
    """Return the most probable unknowns for fixed forces.

    Each round solves the linear least squares with the prior, and linearises anew at its solution.

    :param states: states of the robot where the surfaces are made, with the forces.
    :param z: (p,) change of the parameters from the prior to begin with, units of files.
    :param scale: factor of the forces to begin with.
    :param free: (p + 1,) True for parameters, and the scale, that may change.
    :param local: linear model at z and the scale to begin with; None: it is not known.
    :raises MeasurementError: the springs have no equilibrium under the forces.
    """
    prior_covariance = prior.covariance
    gamma = 0.0
    if local is None:
        local = linearise(prior, readings, states, robot_in_cell, z=z, scale=scale)
    for _ in range(_MOST_ROUNDS):
        last_solution = np.append(z, scale - 1.0)
        target = readings.probed.deviation - local.value + local.slopes @ last_solution
        gamma = unmodelled_share(readings, local, prior_covariance, target)
        noise = noise_covariance(readings, local, gamma)
        covariance = local.slopes @ prior_covariance @ local.slopes.T + noise
        solution = free * (prior_covariance @ local.slopes.T @ np.linalg.solve(covariance, target))
        z, scale = solution[:-1], max(1.0 + float(solution[-1]), MIN_SHARE)
        step = float(np.abs(local.slopes @ (solution - last_solution)).max())
        local = linearise(prior, readings, states, robot_in_cell, z=z, scale=scale)
        if step < _STEP_TOLERANCE:
            break
    return Solution(local, z, scale, gamma)


def unmodelled_share(readings: Readings, local: LinearPrediction, whole: Array, target: Array) -> float:
    """Return the unmodelled error γ as a share of the displacement of the tool: its RMS over the posterior.

    The prior of γ is log-normal about `GAMMA`. The posterior is summed on a grid of logarithms.

    :param local: linear model of the deviations.
    :param whole: (p + 1, p + 1) prior covariance of parameters and scale.
    :param target: (n,) deviations that the linear model is to explain [m].
    """
    log_ratio = np.linspace(-4.0, 4.0, 97)  # fine enough for γ from 200 readings
    share = GAMMA * np.exp(LOG_SIGMA * log_ratio)
    covariance = local.slopes @ whole @ local.slopes.T + noise_covariance(readings, local, 0.0)
    log_density = np.empty(len(share))
    for k, gamma in enumerate(share.tolist()):
        lower = np.linalg.cholesky(covariance + np.diag((gamma * local.displacement) ** 2))
        white = np.linalg.solve(lower, target)
        log_density[k] = -0.5 * float(white @ white) - float(np.log(np.diag(lower)).sum()) - 0.5 * log_ratio[k] ** 2
    density = np.exp(log_density - log_density.max())
    return float(np.sqrt(np.sum(density * share**2) / density.sum()))


def posterior_covariance(readings: Readings, local: LinearPrediction, gamma: float, whole: Array, free: Bools) -> Array:
    """Return the covariance (p + 1, p + 1) of parameters and scale after the readings.

    A parameter that is not free keeps its value, and its uncertainty adds to that of the free ones: Schmidt,
    "Application of state-space methods to navigation problems", 1966 (consider covariance).

    :param local: linear model of the deviations.
    :param gamma: unmodelled error as a share of the displacement of the tool.
    :param whole: (p + 1, p + 1) prior covariance of parameters and scale.
    :param free: (p + 1,) True for parameters, and the scale, that were fitted.
    """
    noise = noise_covariance(readings, local, gamma)
    spread = whole @ local.slopes.T
    gain = free[:, None] * np.linalg.solve(local.slopes @ spread + noise, spread.T).T
    error_factor = np.eye(len(whole)) - gain @ local.slopes  # of prior errors in the result
    return np.asarray(error_factor @ whole @ error_factor.T + gain @ noise @ gain.T)


def cross_validation_errors(
    readings: Readings, local: LinearPrediction, gamma: float, whole: Array, *, z: Array, scale: float
) -> tuple[Array, Array]:
    """Return the error (n,) of each point predicted from all others [m], and its variance (n,) [m²].

    Source: Rasmussen and Williams, "Gaussian Processes for Machine Learning", 2006, Eq. (5.12).

    :param local: linear model at z (p,), the change of the parameters from the prior, and the scale of the forces.
    :param whole: (p + 1, p + 1) prior covariance of parameters and scale.
    """
    target = readings.probed.deviation - local.value + local.slopes @ np.append(z, scale - 1.0)
    inverse = np.linalg.inv(local.slopes @ whole @ local.slopes.T + noise_covariance(readings, local, gamma))
    diagonal = np.diag(inverse)
    return inverse @ target / diagonal, 1.0 / diagonal
