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
    :param z: (p,) change of the parameters from the prior, units of model.toml; `scale` factor of the forces.
    :raises MeasurementError: the springs have no equilibrium under the forces.
    """
    robot = prior.robot_with_change(z)
    try:
        twist, by_parameter, by_scale = states.derivatives(robot_in_cell, robot, prior.order, scale)
    except NotConvergedError as cause:
        raise MeasurementError(f"no equilibrium under the cutting forces: {cause}", file=readings.probed.file) from None
    value, by_twist = readings.surfaces.deviation(twist)
    slopes = np.einsum("nk,nkp->np", by_twist, by_parameter) @ prior.by_file
    slopes = np.column_stack([slopes, np.einsum("nk,nk->n", by_twist, by_scale)])
    by_lift = np.einsum("nk,nk->n", by_twist, states.twist_by_lift(robot_in_cell, robot, scale, twist))
    deflection = scale * np.linalg.norm(by_scale[:, :3], axis=1)
    # a gauge reads the displacement by the weight, which the scale of the cutting forces does not change
    displacement = np.where(readings.probed.is_gauge, np.abs(value), deflection)
    value_without_lift = value - by_lift * states.lift
    return LinearPrediction(value=value_without_lift, slopes=slopes, by_lift=by_lift, displacement=displacement)


def noise_covariance(readings: Readings, linear_model: LinearPrediction, gamma: float) -> Array:
    """Return the covariance (n, n) [m²] of the deviations if robot and forces are known exactly.

    :param linear_model: linear model of the deviations.
    :param gamma: unmodelled error as a share of the displacement of the tool.
    """
    variance = np.diag(
        readings.sigma**2
        + (gamma * linear_model.displacement) ** 2
        + light_pass_variance(readings, linear_model.displacement)
    )
    return np.asarray(variance + readings.part_covariance(linear_model.by_lift))


def light_pass_variance(readings: Readings, displacement: Array) -> Array:
    """Return the variance (n,) [m²] of displacements (n,) [m] by light passes; 0 for other passes and for weights.

    A light pass cuts only what the passes before it left because they deflected: its force is hardly known.
    """
    is_light_pass = ~readings.probed.is_gauge & (displacement < _LIGHT_SHARE * displacement.max())
    return np.where(is_light_pass, (_LIGHT_PASS_ERROR * displacement) ** 2, 0.0)


class Solution(NamedTuple):
    """The most probable unknowns for fixed forces.

    :param linear_model: linear model at these unknowns.
    :param z: (p,) change of the parameters from the prior, units of model.toml.
    :param scale: factor of the forces.
    :param gamma: unmodelled error γ as a share of the displacement of the tool.
    """

    linear_model: LinearPrediction
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
    linear_model: LinearPrediction | None = None,
) -> Solution:
    """Return the most probable unknowns for fixed forces.

    Each round solves the linear least squares with the prior, and linearises anew at its solution.

    :param states: states of the robot where the surfaces are made, with the forces.
    :param z: (p,) change of the parameters from the prior to begin with, units of model.toml.
    :param scale: factor of the forces to begin with.
    :param free: (p + 1,) True for parameters, and the scale, that may change.
    :param linear_model: linear model at z and the scale to begin with; None: it is not known.
    :raises MeasurementError: the springs have no equilibrium under the forces.
    """
    # the unknowns are z and the change of the scale from 1; the readings are linear in them about `last_solution`
    prior_covariance = prior.covariance
    gamma = 0.0
    if linear_model is None:
        linear_model = linearise(prior, readings, states, robot_in_cell, z=z, scale=scale)
    for _ in range(_MOST_ROUNDS):
        last_solution = np.append(z, scale - 1.0)
        target = readings.probed.deviation - linear_model.value + linear_model.slopes @ last_solution
        gamma = unmodelled_share(readings, linear_model, prior_covariance, target)
        noise = noise_covariance(readings, linear_model, gamma)
        covariance = linear_model.slopes @ prior_covariance @ linear_model.slopes.T + noise
        solution = free * (prior_covariance @ linear_model.slopes.T @ np.linalg.solve(covariance, target))
        z, scale = solution[:-1], max(1.0 + float(solution[-1]), MIN_SHARE)
        step = float(np.abs(linear_model.slopes @ (solution - last_solution)).max())
        linear_model = linearise(prior, readings, states, robot_in_cell, z=z, scale=scale)
        if step < _STEP_TOLERANCE:
            break
    return Solution(linear_model, z, scale, gamma)


def unmodelled_share(
    readings: Readings, linear_model: LinearPrediction, prior_covariance: Array, target: Array
) -> float:
    """Return the unmodelled error γ as a share of the displacement of the tool: its RMS over the posterior.

    The prior of γ is log-normal about `GAMMA`. The posterior is summed on a grid of logarithms.

    :param linear_model: linear model of the deviations.
    :param prior_covariance: (p + 1, p + 1) prior covariance of parameters and scale.
    :param target: (n,) deviations that the linear model is to explain [m].
    """
    log_ratio = np.linspace(-4.0, 4.0, 97)  # in prior standard deviations; fine enough for γ from 200 readings
    share = GAMMA * np.exp(LOG_SIGMA * log_ratio)
    covariance = linear_model.slopes @ prior_covariance @ linear_model.slopes.T + noise_covariance(
        readings, linear_model, 0.0
    )
    log_density = np.empty(len(share))
    for k, gamma in enumerate(share.tolist()):
        lower = np.linalg.cholesky(covariance + np.diag((gamma * linear_model.displacement) ** 2))
        normalised = np.linalg.solve(lower, target)
        log_density[k] = (
            -0.5 * float(normalised @ normalised) - float(np.log(np.diag(lower)).sum()) - 0.5 * log_ratio[k] ** 2
        )
    density = np.exp(log_density - log_density.max())
    return float(np.sqrt(np.sum(density * share**2) / density.sum()))


def posterior_covariance(
    readings: Readings, linear_model: LinearPrediction, gamma: float, prior_covariance: Array, free: Bools
) -> Array:
    """Return the covariance (p + 1, p + 1) of parameters and scale after the readings.

    A parameter that is not free keeps its value, and its uncertainty adds to that of the free ones: Schmidt,
    "Application of state-space methods to navigation problems", 1966 (consider covariance).

    :param linear_model: linear model of the deviations.
    :param gamma: unmodelled error as a share of the displacement of the tool.
    :param prior_covariance: (p + 1, p + 1) prior covariance of parameters and scale.
    :param free: (p + 1,) True for parameters, and the scale, that were fitted.
    """
    noise = noise_covariance(readings, linear_model, gamma)
    cross_covariance = prior_covariance @ linear_model.slopes.T  # of unknowns and deviations
    gain = free[:, None] * np.linalg.solve(linear_model.slopes @ cross_covariance + noise, cross_covariance.T).T
    error_factor = np.eye(len(prior_covariance)) - gain @ linear_model.slopes  # of prior errors in the result
    return np.asarray(error_factor @ prior_covariance @ error_factor.T + gain @ noise @ gain.T)


def cross_validation_errors(
    readings: Readings, linear_model: LinearPrediction, gamma: float, prior_covariance: Array, *, z: Array, scale: float
) -> tuple[Array, Array]:
    """Return the error (n,) of each point predicted from all others [m], and its variance (n,) [m²].

    Source: Rasmussen and Williams, "Gaussian Processes for Machine Learning", 2006, Eq. (5.12).

    :param linear_model: linear model at z (p,), the change of the parameters from the prior, and the scale of forces.
    :param prior_covariance: (p + 1, p + 1) prior covariance of parameters and scale.
    """
    target = readings.probed.deviation - linear_model.value + linear_model.slopes @ np.append(z, scale - 1.0)
    inverse = np.linalg.inv(
        linear_model.slopes @ prior_covariance @ linear_model.slopes.T + noise_covariance(readings, linear_model, gamma)
    )
    diagonal = np.diag(inverse)
    return inverse @ target / diagonal, 1.0 / diagonal
