"""Fit of a robot model to the probed deviations of a test part, with the prior of the model.

Maximum a posteriori by Gauss–Newton (Tarantola, "Inverse Problem Theory", 2005, ch. 3): parameters of the robot about
the values and the covariance of the model, and the scale of the forces about 1 with the standard deviation of the
process. What the part adds is linear and enters by its covariance: the position of the cuts against the uncut top of
the block (six numbers, free, for each placement of the block), the radius of the tool, the path of the robot without
force at each feature (three numbers), and the noise of the probe. The depth of cut follows that position: each round
computes the forces at the lift over the block that the round before found.

Where passes cut next to nothing, the displacement is known to a share only. An error that the model does not describe
is a share γ of the deflection, in any direction. Its size follows from the readings: before them γ is log-normal, as
the unmodelled error of tracker readings is (`identification.discrepancy`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from math import erfc, sqrt
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import kinematics
from postproc.elastostatics import LENGTH_95
from postproc.errors import MeasurementError
from postproc.frames import Array
from postproc.identification.uncertainty import levels, unmodelled_error
from postproc.program import Bools, Ints
from postproc.robot import RobotModel
from postproc.testpart.cut import Heights, States
from postproc.testpart.linear import (
    GAMMA,
    LinearPrediction,
    cross_validation_errors,
    light_pass_variance,
    linearise,
    noise_covariance,
    posterior_covariance,
    solve,
)
from postproc.testpart.prior import Prior
from postproc.testpart.readings import Lift, Readings
from postproc.under_load import RobotInCell

_MOST_ROUNDS = 12
"""Limit of solving and cutting anew; each point left out takes a round (assumed)."""
_CONVERGENCE_RMS, _LARGEST_RESIDUAL = 1.5e-6, 5e-6
"""RMS change by new forces of the deflected tool that ends the iteration [m], and the largest one that may remain:
the cells of the map of the stock make some 1e-6."""
_NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal number."""
_OUTLIER_RATIO = 5.0
"""Ratio of the error of a point predicted by all others to its usual size, beyond which it is left out (assumed)."""
_MOST_OUTLIERS_SHARE = 0.05
"""Share of the points that may be left out (assumed): more are no slips, but another part or robot."""
HELD_SHARE = 0.9
"""A parameter whose standard deviation stays above this share of the prior one is not determined by the part
(assumed)."""
UNMODELLED_SHARE = 0.10
"""Unmodelled error (95 %) at other places than those of the part, as a share of the deflection. Assumed: simulated
robots whose gears bend and whose links are flexible are off there by 5 % (RMS), mostly along the force, which their
parts do not show: 1.96 of these."""
_LOADED_SHARE = 0.25
"""Share of the largest load below which a point does not count in the unmodelled error (assumed)."""
_MEDIAN_FACTOR = 0.1
"""Median of the unmodelled error before any reading, over the share `GAMMA` of the displacement (assumed)."""
_LEAST_VARIANCE_SHARE = 0.1
"""Least share of the variance of a point that is not of the unmodelled error (assumed)."""
_SWAP_DECREASE = 25.0
"""Decrease of χ², over the usual χ² of a point, by which two features were probed in each other's place (assumed)."""
MOST_LIFT_SHARE = 0.5
"""Lift of a program over the block that is counted, as a share of the flattest cut (assumed)."""
_LARGEST_FACTOR = 5.0
"""Largest ratio of probed to predicted deviations, and of predicted to probed ones: beyond it the user has made a
mistake (assumed)."""


class Fit(Struct, frozen=True, eq=False):
    """A fitted model.

    :param prior: knowledge before the part.
    :param readings: the readings that were used.
    :param z: (p,) change of the parameters from the prior, units of model.toml.
    :param scale: factor of the forces.
    :param covariance: (p + 1, p + 1) of z and, last, the scale.
    :param free: (p + 1,) True for parameters, and the scale, that were fitted; the others keep their prior values.
    :param prior_prediction: (n,) deviations predicted by the prior [m].
    :param prediction: (n,) deviations predicted by the fit [m]. Both predictions include the estimated position of the
        part, radius of the tool and path without force.
    :param load: (n,) size of the force at each point [N].
    :param displacement: (n,) predicted displacement of the tool at each point [m].
    :param error: (n,) error of each point predicted from all others [m], and `spread` (n,) its standard deviation.
    :param gamma: unmodelled error as a share of the deflection.
    :param prior_error: (n,) measured deviations minus those that the prior predicts [m].
    :param slopes: (n, p + 1) derivatives of the predicted deviations at the prior.
    :param torque: (6,) largest torque of the forces on A1…A6 [N·m].
    :param lifts: lift of the program of each placement over the block.
    :param by_lift: (n,) derivative of the deviations by the lift.
    :param exchanged_pair: names of two features whose readings look exchanged; None: there are none.
    """

    prior: Prior
    readings: Readings
    z: Array
    scale: float
    covariance: Array
    free: Bools
    prior_prediction: Array
    prediction: Array
    load: Array
    displacement: Array
    error: Array
    spread: Array
    gamma: float
    prior_error: Array
    slopes: Array
    torque: Array
    lifts: tuple[Lift, ...]
    by_lift: Array
    exchanged_pair: tuple[str, str] | None = None

    @property
    def robot(self) -> RobotModel:
        """The fitted robot, without its covariance."""
        return self.prior.robot_with_change(self.z)

    def compare_with_prior(self, prior: Prior) -> PriorComparison:
        """Return how the readings differ from the prediction of a prior, for a fit that began with `prior.widen()`.

        The changes of the parameters are estimated as a step from the prior with the spread `prior.drift`: the Bayesian
        linear model with that prior covariance.
        """
        unmodelled = self.gamma * self.displacement  # standard deviation of what the model lacks [m]
        # a model that was identified from a part with these forces states its error at other places, not at the part
        if (discrepancy := prior.robot.discrepancy) is not None and not prior.has_forces_of_model:
            wrench = np.pad(self.load[:, None], ((0, 0), (0, 5)))  # only the size of the force counts
            # 95 % bounds of lengths, divided to get standard deviations along a normal
            unmodelled = np.maximum(unmodelled, discrepancy.at(wrench) / LENGTH_95)
        noise = self.readings.part_covariance(self.by_lift) + np.diag(
            self.readings.sigma**2 + unmodelled**2 + light_pass_variance(self.readings, self.displacement)
        )
        slopes = self.slopes
        precision = np.linalg.inv(slopes @ prior.covariance @ slopes.T + noise)
        score, information = slopes.T @ precision @ self.prior_error, slopes.T @ precision @ slopes
        # of changes in units of their drift, whose prior precision is the unit matrix
        change_covariance = np.linalg.inv(np.eye(len(information)) + np.outer(prior.drift, prior.drift) * information)
        return PriorComparison(
            chi2=float(self.prior_error @ precision @ self.prior_error),
            no_change_probability=_no_change_probability(score, information),
            change=prior.drift * (change_covariance @ (prior.drift * score)),
            spread=prior.drift * np.sqrt(np.maximum(np.diag(change_covariance), 0.0)),
        )

    @property
    def sigma(self) -> Array:
        """(p + 1,) standard deviations after the fit, as shares of those before it."""
        # 1e-300 keeps zero out of the denominator
        return np.sqrt(np.diag(self.covariance) / np.maximum(np.diag(self.prior.covariance), 1e-300))

    def u95(self) -> tuple[Array, Array]:
        """Return levels of load (m,) [N], and the 95 % bound (m,) of the unmodelled error at each level [m].

        The bound is computed from the part of the cross-validation errors that their noise does not explain. Points of
        one feature count as one. Points with less than `_LOADED_SHARE` of the largest load are left out. The bound does
        not fall with the load.
        """
        loaded_rows = np.flatnonzero(self.load > _LOADED_SHARE * self.load.max())
        level = levels(self.load[loaded_rows])
        group = self.readings.probed.group[loaded_rows]
        load, bound = [], []
        for index in range(int(level.max()) + 1):
            rows = loaded_rows[level == index]
            share = 1.0 / np.bincount(group)[group[level == index]]  # of each point in its feature
            median = _MEDIAN_FACTOR * GAMMA * float(np.sqrt(np.mean(self.displacement[rows] ** 2)))
            # variance without the unmodelled error, at least a tenth of the total
            noise = self.spread[rows] ** 2 - (self.gamma * self.displacement[rows]) ** 2
            smallest_variance = _LEAST_VARIANCE_SHARE * self.spread[rows] ** 2
            variance = np.maximum(noise, smallest_variance)
            level_bound = unmodelled_error(self.error[rows][:, None], variance[:, None, None], median, share)
            bound.append(
                float(np.hypot(level_bound, UNMODELLED_SHARE * np.sqrt(np.mean(self.displacement[rows] ** 2))))
            )
            load.append(float(np.median(self.load[rows])))
        return np.array(load), np.maximum.accumulate(bound)


class PriorComparison(Struct, frozen=True, eq=False):
    """How n probed deviations differ from those that a model predicts with its covariance.

    :param chi2: squared distance in units of the covariance; about n if the model is right.
    :param no_change_probability: probability of deviations that look as much like a change of one parameter, or of all,
        if none has changed.
    :param change: (p + 1,) estimated changes of the parameters, units of model.toml, at the forces of the model.
    :param spread: (p + 1,) standard deviations of these changes.
    """

    chi2: float
    no_change_probability: float
    change: Array
    spread: Array


def _no_change_probability(score: Array, information: Array) -> float:
    """Return the probability of deviations that look as much like a change of one unknown, if nothing has changed.

    Each unknown is tested by itself, so that a small effect is seen next to large ones; the scale of the forces is the
    test of all compliances together. The number of tests counts (Bonferroni).

    :param score: (p + 1,) derivatives of the log likelihood by the unknowns, and `information` (p + 1, p + 1) their
        covariance.
    """
    variance = np.diag(information)
    is_testable = variance > 1e-9 * variance.max()  # the readings do not depend on the other unknowns
    largest_score = float((np.abs(score[is_testable]) / np.sqrt(variance[is_testable])).max(initial=0.0))
    return min(1.0, int(is_testable.sum()) * erfc(largest_score / sqrt(2.0)))


CutAt = Callable[[RobotModel, float, Sequence[Heights]], States]
"""Returns the states where the points are made, for a robot that deflects the tool, a factor of the forces and the lift
of each program over the block; no lifts: all run as written."""


class _Estimate(Struct, frozen=True, eq=False):
    """State of the iteration.

    :param readings: the n readings that count, and `rows` (n,) their rows among all readings.
    :param outliers: names of points left out.
    :param free: (p + 1,) True for parameters, and the scale, that are fitted.
    :param states: states where the points are made, under the forces of the last round.
    :param z: (p,) change of the parameters from the prior, units of model.toml.
    :param scale: factor of the forces.
    :param gamma: unmodelled error as a share of the deflection.
    :param linear_model: linear model at this solution; None: it is not known yet.
    """

    readings: Readings
    rows: Ints
    outliers: tuple[str, ...]
    free: Bools
    states: States
    z: Array
    scale: float
    gamma: float = 0.0
    linear_model: LinearPrediction | None = None


class _PriorPrediction(NamedTuple):
    """Prediction of the prior model under the forces of the tool that the first solution deflects.

    :param linear_model: the linear model at the prior, for k readings.
    :param rows: (k,) ascending numbers of these readings among all that were read.
    """

    linear_model: LinearPrediction
    rows: Ints

    def for_readings(self, rows: Ints) -> LinearPrediction:
        """Return the prediction for some of the k readings, by their ascending numbers (n,) among all readings."""
        return self.linear_model.take(np.searchsorted(self.rows, rows))


def fit(prior: Prior, readings: Readings, robot_in_cell: RobotInCell, cut_at: CutAt) -> tuple[Fit, tuple[str, ...]]:
    """Return the fit of a model to a part, without gross errors, with undetermined parameters at their prior values.

    Each round solves for fixed forces. Then it leaves out one gross error, or holds undetermined parameters; if there
    are none, it computes new forces. It ends when new forces no longer change the predicted deviations.

    :param cut_at: returns the states under new forces.
    :returns: the fit, and the names of points left out.
    :raises MeasurementError: no robot near the model makes these deviations, or the fit does not settle.
    """
    prior_covariance = prior.covariance
    no_change = np.zeros(len(prior.parameters))
    states = cut_at(prior.robot, 1.0, ())
    linear_model = linearise(prior, readings, states, robot_in_cell, z=no_change, scale=1.0)
    _check_size(readings, linear_model)
    exchanged_pair = swapped_features(prior, readings, linear_model)
    rows, free = np.arange(len(readings.probed)), np.diag(prior_covariance) > 0.0  # certain values are not fitted
    estimate = end = _Estimate(
        readings=readings,
        rows=rows,
        outliers=(),
        free=free,
        states=states,
        z=no_change,
        scale=1.0,
        linear_model=linear_model,
    )
    max_outliers = int(_MOST_OUTLIERS_SHARE * len(readings.probed))
    prior_prediction: _PriorPrediction | None = None
    change = np.inf
    for _ in range(_MOST_ROUNDS):
        estimate = _solve(prior, robot_in_cell, estimate)
        smaller_estimate = _without_outlier(estimate, prior_covariance, max_outliers) or _with_held_parameters(
            estimate, prior_covariance
        )
        if smaller_estimate is not None:
            estimate = smaller_estimate
            continue
        z, scale, linear_model = estimate.z, estimate.scale, _linear_model(estimate)
        heights = _heights(_lifts(estimate, prior_covariance), MOST_LIFT_SHARE * readings.least_depth)
        states = cut_at(prior.robot_with_change(z), scale, heights).take(estimate.rows)
        if prior_prediction is None:  # the tool of the prior model deflects by nearly as much
            prior_local = linearise(prior, estimate.readings, states, robot_in_cell, z=no_change, scale=1.0)
            prior_prediction = _PriorPrediction(prior_local, estimate.rows)
        next_local = linearise(prior, estimate.readings, states, robot_in_cell, z=z, scale=scale)
        change = float(np.sqrt(np.mean((next_local.value - linear_model.value) ** 2)))
        end = replace(estimate, states=states)
        if change < _CONVERGENCE_RMS:
            break
        estimate = replace(end, linear_model=next_local)
    if not change < _LARGEST_RESIDUAL or prior_prediction is None:
        raise MeasurementError(
            "the fit of the test part does not settle", file=readings.probed.file, advice="Check the deviations."
        )
    prior_linear = prior_prediction.for_readings(end.rows)
    return _fit_at_end(prior, end, prior_linear, exchanged_pair), end.outliers


def _linear_model(estimate: _Estimate) -> LinearPrediction:
    """Return the linear model of an estimate that has one, as any that `_solve` returns."""
    assert estimate.linear_model is not None
    return estimate.linear_model


def _solve(prior: Prior, robot_in_cell: RobotInCell, estimate: _Estimate) -> _Estimate:
    """Return the estimate with the solution for its fixed forces."""
    linear_model, z, scale, gamma = solve(
        prior,
        estimate.readings,
        estimate.states,
        robot_in_cell,
        z=estimate.z,
        scale=estimate.scale,
        free=estimate.free,
        linear_model=estimate.linear_model,
    )
    return replace(estimate, linear_model=linear_model, z=z, scale=scale, gamma=gamma)


def _without_outlier(estimate: _Estimate, prior_covariance: Array, max_outliers: int) -> _Estimate | None:
    """Return the estimate without its worst gross error; None if no error is gross, or too many points are left out.

    :param prior_covariance: (p + 1, p + 1) prior covariance of parameters and scale.
    :param max_outliers: largest number of points that may be left out.
    """
    # with the median of γ before any reading: a gross error enlarges γ, and would hide in it
    error, variance = cross_validation_errors(
        estimate.readings, _linear_model(estimate), GAMMA, prior_covariance, z=estimate.z, scale=estimate.scale
    )
    size = np.abs(error) / np.sqrt(variance)
    worst = int(np.argmax(size))
    usual_size = max(1.0, float(np.median(size)) / _NORMAL_MEDIAN)
    if len(estimate.outliers) >= max_outliers or size[worst] <= _OUTLIER_RATIO * usual_size:
        return None
    kept_rows = np.delete(np.arange(len(size)), worst)
    return replace(
        estimate,
        outliers=(*estimate.outliers, estimate.readings.probed.name[worst]),
        readings=estimate.readings.take(kept_rows),
        rows=estimate.rows[kept_rows],
        states=estimate.states.take(kept_rows),
        linear_model=_linear_model(estimate).take(kept_rows),
    )


def _with_held_parameters(estimate: _Estimate, prior_covariance: Array) -> _Estimate | None:
    """Return the estimate with undetermined parameters at their prior values; None if all free ones are determined.

    The scale of the forces is never held.

    :param prior_covariance: (p + 1, p + 1) prior covariance of parameters and scale.
    """
    # as if all were free: the uncertainty of parameters that are held already would widen that of the others
    all_free = np.ones_like(estimate.free)
    sigma = np.sqrt(
        np.diag(
            posterior_covariance(estimate.readings, _linear_model(estimate), estimate.gamma, prior_covariance, all_free)
        )
    )
    is_held = estimate.free & (sigma > HELD_SHARE * np.sqrt(np.diag(prior_covariance)))
    is_held[-1] = False  # the scale of the forces
    if not is_held.any():
        return None
    free = estimate.free & ~is_held
    return replace(estimate, free=free, z=np.where(free[:-1], estimate.z, 0.0), linear_model=None)


def _lifts(estimate: _Estimate, prior_covariance: Array) -> tuple[Lift, ...]:
    """Return the lift of each program over the block, estimated from the readings.

    :param prior_covariance: (p + 1, p + 1) prior covariance of parameters and scale.
    """
    readings, linear_model = estimate.readings, _linear_model(estimate)
    target = (
        readings.probed.deviation
        - linear_model.value
        + linear_model.slopes @ np.append(estimate.z, estimate.scale - 1.0)
    )
    covariance = linear_model.slopes @ prior_covariance @ linear_model.slopes.T + noise_covariance(
        readings, linear_model, estimate.gamma
    )
    return readings.lifts(linear_model.by_lift, np.asarray(np.linalg.inv(covariance)), target)


def _heights(lifts: Sequence[Lift], limit: float) -> list[Heights]:
    """Return the lifts as functions of points, limited to ± `limit` [m]: a part with larger ones is refused."""

    def limited(lift: Lift) -> Heights:
        """Return a lift as a function of points (n, 3) in `$BASE` [m], with limited values (n,) [m]."""
        return lambda points: np.clip(lift.heights(points), -limit, limit)

    return [limited(lift) for lift in lifts]


def _fit_at_end(
    prior: Prior, estimate: _Estimate, prior_linear: LinearPrediction, exchanged_pair: tuple[str, str] | None
) -> Fit:
    """Return the fit at the end of the iteration.

    :param prior_linear: the linear model at the prior, under the forces of the tool that the first fit deflects.
    :param exchanged_pair: features whose readings look exchanged; None: there are none.
    """
    readings, linear_model, gamma, prior_covariance = (
        estimate.readings,
        _linear_model(estimate),
        estimate.gamma,
        prior.covariance,
    )
    states, scale = estimate.states, estimate.scale
    deviation = readings.probed.deviation
    # the share of an error of the prediction that position of the part, radius of the tool and path explain
    gain = readings.part_covariance(linear_model.by_lift) @ np.linalg.inv(
        noise_covariance(readings, linear_model, gamma)
    )
    prior_residual = deviation - prior_linear.value
    error, variance = cross_validation_errors(
        readings, linear_model, gamma, prior_covariance, z=estimate.z, scale=scale
    )
    jacobian = kinematics.tcp(prior.robot.nominal, states.q, states.tool)[1]
    return Fit(
        prior=prior,
        readings=readings,
        z=estimate.z,
        scale=scale,
        covariance=posterior_covariance(readings, linear_model, gamma, prior_covariance, estimate.free),
        free=estimate.free,
        prior_prediction=prior_linear.value + gain @ prior_residual,
        prediction=linear_model.value + gain @ (deviation - linear_model.value),
        load=scale * np.linalg.norm(states.wrench[:, :3], axis=1),
        displacement=linear_model.displacement,
        error=error,
        spread=np.sqrt(variance),
        gamma=gamma,
        prior_error=prior_residual,
        slopes=prior_linear.slopes,
        torque=scale * np.abs(np.einsum("nij,ni->nj", jacobian, states.wrench)).max(axis=0),
        lifts=_lifts(estimate, prior_covariance),
        by_lift=linear_model.by_lift,
        exchanged_pair=exchanged_pair,
    )


def swapped_features(prior: Prior, readings: Readings, linear_model: LinearPrediction) -> tuple[str, str] | None:
    """Return two features whose readings agree with the model only if they are exchanged.

    Of all pairs with the same surfaces, their exchange lowers χ² most, and by more than `_SWAP_DECREASE`. χ² counts the
    covariance of the model, so that a robot that differs from the model is not taken for an exchange.

    :param linear_model: the linear model at the prior.
    :returns: names of the features; None if no exchange is clear.
    """
    points = readings.probed
    rows: dict[str, dict[str, int]] = {}  # feature → surface → row
    for row, name in enumerate(points.name):
        feature, _, surface = name.partition(".")
        rows.setdefault(feature, {})[surface] = row
    covariance = linear_model.slopes @ prior.covariance @ linear_model.slopes.T + noise_covariance(
        readings, linear_model, GAMMA
    )
    inverse = np.linalg.inv(covariance)
    residual = points.deviation - linear_model.value
    smallest_chi2, pair = np.inf, None
    for first, second in combinations(rows, 2):
        if rows[first].keys() != rows[second].keys():
            continue
        first_rows, second_rows = list(rows[first].values()), [rows[second][surface] for surface in rows[first]]
        deviation = points.deviation.copy()
        deviation[first_rows], deviation[second_rows] = points.deviation[second_rows], points.deviation[first_rows]
        chi2 = float((deviation - linear_model.value) @ inverse @ (deviation - linear_model.value))
        if chi2 < smallest_chi2:
            smallest_chi2, pair = chi2, (first, second)
    decrease = float(residual @ inverse @ residual) - smallest_chi2
    # χ² per point is above 1 if the part fits the model badly: then a larger decrease is needed
    return pair if decrease > _SWAP_DECREASE * max(1.0, smallest_chi2 / len(points)) else None


_MM_PER_INCH = 25.4
_ALIKE_COSINE = 0.8
"""Cosine between probed and predicted deviations, in units of their noise, from which they differ by size alone."""


def _cosine_between(deviation: Array, prediction: Array, noise: Array) -> float:
    """Return the cosine between probed and predicted deviations (n,) in units of their noise; 0 if one of them is zero.

    :param noise: (n, n) covariance of the deviations.
    """
    weighted = np.linalg.solve(noise, np.stack([deviation, prediction], axis=1))
    product = np.stack([deviation, prediction]) @ weighted
    size = float(np.sqrt(product[0, 0] * product[1, 1]))
    return float(product[0, 1]) / size if size > 0.0 else 0.0


def _opposite_rows(names: Sequence[str]) -> Ints:
    """Return for each point the row (n,) of the opposite surface of its feature: ``right`` for ``left``, and so on.

    A point whose surface has no opposite surface among the probed ones gets its own row.

    :param names: (n,) names of feature and surface, ``F01.left``.
    """
    row_of = {name: row for row, name in enumerate(names)}
    opposite = {"left": "right", "right": "left"}
    rows = []
    for row, name in enumerate(names):
        feature, _, surface = name.partition(".")
        rows.append(row_of.get(f"{feature}.{opposite.get(surface, surface)}", row))
    return np.array(rows)


def _check_size(readings: Readings, linear_model: LinearPrediction) -> None:
    """Refuse deviations that no robot near the model can make: with the wrong sign or unit, or almost zero.

    :raises MeasurementError: they are less than a fifth of the predicted deviations, or more than five times these.
    """
    noise, deviation = noise_covariance(readings, linear_model, GAMMA), readings.probed.deviation
    weighted_prediction = np.linalg.solve(noise, linear_model.value)
    # factor of the predicted deviations that fits the probed ones best
    share = float(weighted_prediction @ deviation) / float(weighted_prediction @ linear_model.value)
    if 1.0 / _LARGEST_FACTOR <= share <= _LARGEST_FACTOR:
        return
    exchanged = deviation[_opposite_rows(readings.probed.name)]
    if (
        _cosine_between(exchanged, linear_model.value, noise)
        > _ALIKE_COSINE
        > _cosine_between(deviation, linear_model.value, noise)
    ):
        advice = "They fit if left and right of all features are exchanged: left is that seen along the groove, on +v."
    elif share < -1.0 / _LARGEST_FACTOR:
        advice = "deviation_mm is positive where material is left: is the sign the other way?"
    elif share > _LARGEST_FACTOR:
        advice = "Is deviation_mm in millimetres? Are program and process those that the part was cut with?"
    elif 0.5 < share * _MM_PER_INCH < 2.0 and _cosine_between(deviation, linear_model.value, noise) > _ALIKE_COSINE:
        advice = "Is deviation_mm in inch? Give it in mm."
    else:
        advice = "The part shows hardly any deflection. Was testpart.src cut as it was written, not corrected?"
    problem = f"the probed deviations are {share:.2g} times what the model predicts"
    raise MeasurementError(problem, file=readings.probed.file, advice=advice)
