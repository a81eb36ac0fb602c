"""Fit of a robot model to the probed deviations of a test part, with the prior of the model.

Maximum a posteriori by Gauss–Newton (Tarantola, "Inverse Problem Theory", 2005, ch. 3): parameters of the robot about
the values and the covariance of the model, and the scale of the forces about 1 with the standard deviation of the
process. What the part adds is linear and enters by its covariance: the position of the part (six numbers, free, for
each placement of the block), the radius of the tool, the path of the robot without force at each feature (three
numbers), and the noise of the probe.

Where passes cut next to nothing, the displacement is known to a share only. An error that the model does not describe
is a share γ of the deflection, in any direction. Its size follows from the readings: before them γ is log-normal, as
the unmodelled error of tracker readings is (`identification.discrepancy`).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from math import erfc, sqrt

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import kinematics
from postproc.chunks import Columns
from postproc.elastostatics import LENGTH_95
from postproc.errors import MeasurementError, NotConvergedError
from postproc.frames import Array
from postproc.identification.uncertainty import WIDTH, levels, unmodelled
from postproc.program import Bools
from postproc.robot import Parameter, RobotModel, Spring, file_slopes
from postproc.testpart.cut import States, Surfaces
from postproc.testpart.probing import Probed
from postproc.under_load import RobotInCell

PATH_ERROR = 1e-4
"""Standard deviation of the path of the robot without force from one feature to another [m]."""
RADIUS_ERROR = 5e-5
"""Standard deviation of the radius at which the tool cuts, run-out included [m]."""
_SHIFT, _TURN = 1e-2, 1e-1
"""Standard deviations of the position of the part where it is probed [m, rad]: free."""
_ROUNDS = 12
_STEP_TOLERANCE = 2e-8
"""Change of a predicted deviation that ends the iteration at fixed forces [m]."""
_CONVERGENCE_RMS, _LARGEST_RESIDUAL = 1.5e-6, 5e-6
"""RMS change by new forces of the deflected tool that ends the iteration [m], and the largest one that may remain:
the cells of the map of the stock make some 1e-6."""
_MEDIAN = 0.6745
"""Median of the size of a standard normal number."""
_OUTLIER = 5.0
"""Error of a point predicted by all others, over its usual size, beyond which it is left out."""
_MOST_OUTLIERS = 0.05
HELD = 0.9
"""A parameter whose standard deviation stays above this share of the prior one is not determined by the part."""
_UNMEASURED = 0.3
"""Relative standard deviation of a parameter of a robot that may have changed."""
_GAMMA = 0.005
"""Median of γ before any reading."""
ELSEWHERE = 0.08
"""Unmodelled error (95 %) at other places than those of the part, as a share of the deflection. Assumed: simulated
robots whose gears bend and whose links are flexible are off there by 5 % (RMS), which their parts do not show."""
_SWAP_DECREASE = 25.0
"""Decrease of χ², over the usual χ² of a point, by which two features were probed in each other's place."""
_LIGHT = 0.25
"""Displacements below this share of the largest are those of light passes."""
_LIGHT_PASS_ERROR = 0.15
"""Relative error of the displacement by a light pass: its chip is the difference of the deflections before."""
_FACTOR = 5.0
"""Probed deviations beyond this factor of the predicted ones, or below its inverse, are a mistake of the user's."""
LEAST = 0.02
"""Least value of a compliance, and of the scale of the forces, as a share of its prior."""


class Prior(Struct, frozen=True, eq=False):
    """Knowledge before the part is probed: model, covariance, forces.

    :param robot: the model.
    :param parameters: (p,) of its covariance.
    :param order: (o,) these and the linear parameters that their values in files depend on.
    :param by_file: (o, p) linear values (SI) by values in files.
    :param covariance: (p + 1, p + 1) of the parameters in units of files, and of the scale of the forces.
    """

    robot: RobotModel
    parameters: tuple[Parameter, ...]
    order: tuple[Parameter, ...]
    by_file: Array
    covariance: Array

    @classmethod
    def of(cls, robot: RobotModel, sigma_scale: float, law: tuple[float, ...] = ()) -> Prior:
        """Take the prior of a model.

        :param sigma_scale: standard deviation of the scale of the forces.
        :param law: numbers of the cutting law that computes them; where the model was identified with it, the scale
            and the compliances are known together.
        :raises MeasurementError: the model states no covariance and no `sigma_percent`.
        """
        if robot.covariance is None or not robot.covariance.parameters:
            raise MeasurementError(
                f"the model {robot.name} does not state how certain its values are",
                file=robot.name,
                advice="Give sigma_percent with the compliances of model.toml.",
            )
        parameters = robot.covariance.parameters
        order = tuple(dict.fromkeys([*parameters, *(p for each in parameters for p in each.partners())]))
        slopes = file_slopes(order, {parameter: robot.value(parameter) for parameter in order})
        by_file = np.asarray(np.linalg.inv(slopes)[:, [order.index(parameter) for parameter in parameters]])
        size = len(parameters)
        covariance = np.zeros((size + 1, size + 1))
        covariance[:size, :size], covariance[size, size] = robot.covariance.matrix, sigma_scale**2
        if robot.force_factor is not None and robot.force_factor.is_of(law):
            covariance[size] = covariance[:, size] = robot.force_factor.covariance
        return cls(robot, parameters, order, by_file, covariance)

    @property
    def sigma(self) -> Array:
        """(p + 1,) standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def values(self) -> Array:
        """(p,) values of the parameters in units of files."""
        robot_values = {parameter: self.robot.value(parameter) for parameter in self.order}
        return np.array([parameter.in_file(robot_values)[0] for parameter in self.parameters])

    @property
    def drift(self) -> Array:
        """(p + 1,) standard deviations of what may have changed since: not the forces."""
        return np.append(np.where(self.sigma[:-1] > 0.0, _UNMEASURED * self.values, 0.0), 0.0)

    def widened(self) -> Prior:
        """Return the same values, each at least as uncertain as a robot that was never measured."""
        return replace(self, covariance=self.covariance + np.diag(self.drift**2))

    def moved(self, z: Array) -> RobotModel:
        """Return the robot with its parameters changed by z (p,), in units of files; compliances stay positive."""
        changes = dict(zip(self.order, (self.by_file @ z).tolist(), strict=True))
        values = {}
        for parameter, change in changes.items():
            value = self.robot.value(parameter)
            smallest = LEAST * value if isinstance(parameter, Spring) and value > 0.0 else -np.inf
            values[parameter] = max(value + change, smallest)
        return self.robot.with_values(values)


class Readings(Columns, frozen=True, eq=False):
    """Probed deviations and where they come from.

    :param probed: the points.
    :param where: where they are made.
    :param sigma: noise of the probe [m].
    """

    probed: Probed
    where: Surfaces
    sigma: float

    def by_part(self) -> Array:
        """Return the covariance (n, n) [m²] that the part and the path without force add to the readings."""
        probe_data = self.probed
        normal = probe_data.normal * (probe_data.mass == 0.0)[:, None]  # a gauge reads displacements, wherever it is
        pose = []
        for base in np.unique(probe_data.base):
            is_here = (probe_data.base == base)[:, None]
            arm = probe_data.point - probe_data.point.mean(axis=0, where=is_here)
            pose += [_SHIFT * normal * is_here, _TURN * np.cross(arm, normal) * is_here]
        by_pose = np.concatenate(pose, axis=1)
        same_group = probe_data.group[:, None] == probe_data.group[None, :]
        radius = RADIUS_ERROR * self.where.wall
        return np.asarray(
            by_pose @ by_pose.T + PATH_ERROR**2 * same_group * (normal @ normal.T) + np.outer(radius, radius)
        )


class Fit(Struct, frozen=True, eq=False):
    """A fitted model.

    :param prior: what was known before.
    :param readings: those used.
    :param z: (p,) change of the parameters, units of files.
    :param scale: of the forces.
    :param covariance: (p + 1, p + 1) of z and the scale.
    :param free: (p + 1,) what was fitted; the rest keeps its prior value.
    :param before: (n,) deviations predicted by the prior [m].
    :param after: (n,) by the fit, each with the position of the part, the tool's radius and the path without force [m].
    :param load: (n,) size of the force at each point [N].
    :param moved: (n,) predicted displacement of the tool there [m].
    :param error: (n,) of each point predicted from all others [m], and `spread` (n,) its standard deviation.
    :param gamma: unmodelled error as a share of the deflection.
    :param missed: (n,) deviations as measured less those that the prior predicts [m], and `slopes` (n, p + 1) their
        derivatives.
    :param torque: (6,) largest torque of the forces on A1…A6 [N·m].
    :param swapped: two features whose readings look exchanged.
    """

    prior: Prior
    readings: Readings
    z: Array
    scale: float
    covariance: Array
    free: Bools
    before: Array
    after: Array
    load: Array
    moved: Array
    error: Array
    spread: Array
    gamma: float
    missed: Array
    slopes: Array
    torque: Array
    swapped: tuple[str, str] | None = None

    @property
    def robot(self) -> RobotModel:
        """The fitted robot, without its covariance."""
        return self.prior.moved(self.z)

    def against(self, prior: Prior) -> Surprise:
        """Compare the readings with the prediction of a prior: for a fit of `prior.widened()`."""
        unmodelled = self.gamma * self.moved
        # of a model from a part the error elsewhere is no error at the part
        if (discrepancy := prior.robot.discrepancy) is not None and not prior.covariance[-1, :-1].any():
            wrench = np.pad(self.load[:, None], ((0, 0), (0, 5)))
            unmodelled = np.maximum(unmodelled, discrepancy.at(wrench) / LENGTH_95)
        noise = self.readings.by_part() + np.diag(
            self.readings.sigma**2 + unmodelled**2 + _of_light(self.readings, self.moved)
        )
        slopes = self.slopes
        precision = np.linalg.inv(slopes @ prior.covariance @ slopes.T + noise)
        score, information = slopes.T @ precision @ self.missed, slopes.T @ precision @ slopes
        posterior = np.linalg.inv(np.eye(len(information)) + np.outer(prior.drift, prior.drift) * information)
        return Surprise(
            float(self.missed @ precision @ self.missed),
            _chance(score, information),
            prior.drift * (posterior @ (prior.drift * score)),
            prior.drift * np.sqrt(np.maximum(np.diag(posterior), 0.0)),
        )

    @property
    def sigma(self) -> Array:
        """(p + 1,) standard deviations after the fit over those before."""
        return np.sqrt(np.diag(self.covariance) / np.maximum(np.diag(self.prior.covariance), 1e-300))

    def u95(self) -> tuple[Array, Array]:
        """Return levels of load (m,) [N], and the 95 % bound of the unmodelled error at each (m,) [m]."""
        loaded_rows = np.flatnonzero(self.load > 0.25 * self.load.max())
        level = levels(self.load[loaded_rows])
        group = self.readings.probed.group[loaded_rows]
        load, bound = [], []
        for index in range(int(level.max()) + 1):
            rows = loaded_rows[level == index]
            share = 1.0 / np.bincount(group)[group[level == index]]
            usual = 0.1 * _GAMMA * float(np.sqrt(np.mean(self.moved[rows] ** 2)))
            noise = self.spread[rows] ** 2 - (self.gamma * self.moved[rows]) ** 2
            smallest_variance = 0.1 * self.spread[rows] ** 2
            variance = np.maximum(noise, smallest_variance)
            bound_here = unmodelled(self.error[rows][:, None], variance[:, None, None], usual, share)
            bound.append(float(np.hypot(bound_here, ELSEWHERE * np.sqrt(np.mean(self.moved[rows] ** 2)))))
            load.append(float(np.median(self.load[rows])))
        return np.array(load), np.maximum.accumulate(bound)


class Surprise(Struct, frozen=True, eq=False):
    """How probed deviations differ from those that a model predicts with its covariance.

    :param chi2: squared distance; about n where the model is right.
    :param chance: of deviations that look as much like a change of one parameter, or of all, where none has changed.
    :param change: (p + 1,) estimated changes of the parameters, units of files, at the forces of the model;
        `spread` (p + 1,) their standard deviations.
    """

    chi2: float
    chance: float
    change: Array
    spread: Array


def _chance(score: Array, information: Array) -> float:
    """Return the chance of scores as large as the largest of these, in its standard deviations, if nothing changed.

    Each unknown by itself is tested, so that a small effect is seen next to large ones. The scale of the forces is the
    test of all compliances together. The number of tests counts (Bonferroni).
    """
    variance = np.diag(information)
    is_testable = variance > 1e-9 * variance.max()
    largest_score = float((np.abs(score[is_testable]) / np.sqrt(variance[is_testable])).max(initial=0.0))
    return min(1.0, int(is_testable.sum()) * erfc(largest_score / sqrt(2.0)))


class _Linear(Struct, frozen=True, eq=False):
    """Predicted deviations (n,) [m], and their derivatives (n, p + 1) by z and the scale; displacements (n,) [m]."""

    value: Array
    slopes: Array
    moved: Array


def linearised(
    prior: Prior, readings: Readings, states: States, robot_in_cell: RobotInCell, z: Array, scale: float
) -> _Linear:
    """Return predicted deviations and their derivatives at values of the unknowns.

    :raises MeasurementError: the springs have no equilibrium under the forces.
    """
    robot = prior.moved(z)
    try:
        twist, by_parameter, by_scale = states.derivatives(robot_in_cell, robot, prior.order, scale)
    except NotConvergedError as cause:
        raise MeasurementError(f"no equilibrium under the cutting forces: {cause}", file=readings.probed.file) from None
    value, weight = readings.where.deviation(twist)
    slopes = np.einsum("nk,nkp->np", weight, by_parameter) @ prior.by_file
    slopes = np.column_stack([slopes, np.einsum("nk,nk->n", weight, by_scale)])
    deflection = scale * np.linalg.norm(by_scale[:, :3], axis=1)
    return _Linear(value, slopes, np.where(readings.probed.mass > 0.0, np.abs(value), deflection))


def fit(
    prior: Prior,
    readings: Readings,
    robot_in_cell: RobotInCell,
    states: Callable[[RobotModel, float], States],
) -> tuple[Fit, tuple[str, ...]]:
    """Fit the model, leave out gross errors, and hold parameters that the part does not determine.

    :param states: returns the states where the points are made, under the forces of the tool as deflected by a model
        under forces times a scale; called once a round.
    :returns: the fit, and the points left out.
    """
    whole = prior.covariance
    free = np.diag(whole) > 0.0
    z, scale, gamma = np.zeros(len(prior.parameters)), 1.0, 0.0
    outliers: list[str] = []
    max_outliers = int(_MOST_OUTLIERS * len(readings.probed))
    states_here = states(prior.robot, 1.0)
    local = linearised(prior, readings, states_here, robot_in_cell, z, scale)
    _check_size(readings, local)
    exchanged_pair = swapped(prior, readings, local)
    at_prior = None
    rows, change = np.arange(len(readings.probed)), np.inf
    for _ in range(_ROUNDS):
        local, z, scale, gamma = _solved(prior, readings, states_here, robot_in_cell, z, scale, free)
        # with the γ that a gross error makes, it would not be seen
        error, variance = _left_out(readings, local, _GAMMA, whole, z, scale)
        size = np.abs(error) / np.sqrt(variance)
        worst = int(np.argmax(size))
        if len(outliers) < max_outliers and size[worst] > _OUTLIER * max(1.0, float(np.median(size)) / _MEDIAN):
            outliers.append(readings.probed.name[worst])
            keep = np.delete(np.arange(len(readings.probed)), worst)
            readings, rows, states_here = readings.take(keep), rows[keep], states_here.take(keep)
            continue
        sure = np.sqrt(np.diag(_posterior(readings, local, gamma, whole, np.ones_like(free))))
        is_held = free & (sure > HELD * np.sqrt(np.diag(whole)))
        is_held[-1] = False
        if is_held.any():
            free = free & ~is_held
            z = np.where(free[:-1], z, 0.0)
            continue
        states_here = states(prior.moved(z), scale).take(rows)
        if at_prior is None:  # the tool of the prior model deflects by nearly as much
            at_prior = linearised(prior, readings, states_here, robot_in_cell, np.zeros_like(z), 1.0), rows
        new_value = linearised(prior, readings, states_here, robot_in_cell, z, scale).value
        change = float(np.sqrt(np.mean((new_value - local.value) ** 2)))
        if change < _CONVERGENCE_RMS:
            break
    if not change < _LARGEST_RESIDUAL:
        raise MeasurementError(
            "the fit of the test part does not settle", file=readings.probed.file, advice="Check the deviations."
        )
    covariance = _posterior(readings, local, gamma, whole, free)
    noise = _noise(readings, local, gamma)
    gain = readings.by_part() @ np.linalg.inv(noise)
    residual = readings.probed.deviation - local.value
    assert at_prior is not None
    prior_rows = np.searchsorted(at_prior[1], rows)
    prior_value, slopes = at_prior[0].value[prior_rows], at_prior[0].slopes[prior_rows]
    prior_residual = readings.probed.deviation - prior_value
    error, variance = _left_out(readings, local, gamma, whole, z, scale)
    return (
        Fit(
            prior,
            readings,
            z,
            scale,
            covariance,
            free,
            prior_value + readings.by_part() @ np.linalg.solve(noise, prior_residual),
            local.value + gain @ residual,
            scale * np.linalg.norm(states_here.wrench[:, :3], axis=1),
            local.moved,
            error,
            np.sqrt(variance),
            gamma,
            prior_residual,
            slopes,
            np.abs(
                np.einsum(
                    "nij,ni->nj",
                    kinematics.tcp(prior.robot.nominal, states_here.q, states_here.tool)[1],
                    states_here.wrench,
                )
            ).max(axis=0)
            * scale,
            exchanged_pair,
        ),
        tuple(outliers),
    )


def swapped(prior: Prior, readings: Readings, local: _Linear) -> tuple[str, str] | None:
    """Return two features whose readings agree with the model if they are exchanged, and do not as they are.

    :param local: the prior model; χ² counts its covariance, so a robot that differs from it is no exchange.
    """
    points = readings.probed
    rows: dict[str, dict[str, int]] = {}
    for row, name in enumerate(points.name):
        feature, _, surface = name.partition(".")
        rows.setdefault(feature, {})[surface] = row
    covariance = local.slopes @ prior.covariance @ local.slopes.T + _noise(readings, local, _GAMMA)
    inverse = np.linalg.inv(covariance)
    as_read = points.deviation - local.value
    smallest_chi2, pair = np.inf, None
    for first, second in combinations(rows, 2):
        if rows[first].keys() != rows[second].keys():
            continue
        first_rows, second_rows = list(rows[first].values()), [rows[second][surface] for surface in rows[first]]
        deviation = points.deviation.copy()
        deviation[first_rows], deviation[second_rows] = points.deviation[second_rows], points.deviation[first_rows]
        chi2 = float((deviation - local.value) @ inverse @ (deviation - local.value))
        if chi2 < smallest_chi2:
            smallest_chi2, pair = chi2, (first, second)
    decrease = float(as_read @ inverse @ as_read) - smallest_chi2
    return pair if decrease > _SWAP_DECREASE * max(1.0, smallest_chi2 / len(points)) else None


def _check_size(readings: Readings, local: _Linear) -> None:
    """Refuse deviations that no robot near the model can make: of the other sign, of another unit, or none at all.

    :raises MeasurementError: they are not between a fifth of what the model predicts and five times that.
    """
    weighted_prediction = np.linalg.solve(_noise(readings, local, _GAMMA), local.value)
    share = float(weighted_prediction @ readings.probed.deviation) / float(weighted_prediction @ local.value)
    if 1.0 / _FACTOR <= share <= _FACTOR:
        return
    if share < -1.0 / _FACTOR:
        advice = "deviation_mm is positive where material is left: is the sign the other way?"
    elif share > _FACTOR:
        advice = "Is deviation_mm in millimetres? Are program and process those that the part was cut with?"
    else:
        advice = "The part shows hardly any deflection. Was testpart.src cut as it was written, not corrected?"
    problem = f"the probed deviations are {share:.2g} times what the model predicts"
    raise MeasurementError(problem, file=readings.probed.file, advice=advice)


def _noise(readings: Readings, local: _Linear, gamma: float) -> Array:
    variance = np.diag(readings.sigma**2 + (gamma * local.moved) ** 2 + _of_light(readings, local.moved))
    return np.asarray(variance + readings.by_part())


def _of_light(readings: Readings, displacement: Array) -> Array:
    """Return the variance (n,) [m²] of displacements (n,) because the chips of light passes are hardly known."""
    cut = readings.probed.mass == 0.0
    return np.where(cut & (displacement < _LIGHT * displacement.max()), (_LIGHT_PASS_ERROR * displacement) ** 2, 0.0)


def _solved(
    prior: Prior, readings: Readings, states: States, robot_in_cell: RobotInCell, z: Array, scale: float, free: Bools
) -> tuple[_Linear, Array, float, float]:
    """Return the model linearised at the solution for fixed forces, z, the scale and γ there."""
    whole = prior.covariance
    gamma = 0.0
    for _ in range(_ROUNDS):
        local = linearised(prior, readings, states, robot_in_cell, z, scale)
        x = np.append(z, scale - 1.0)
        target = readings.probed.deviation - local.value + local.slopes @ x
        gamma = _unmodelled_share(readings, local, whole, target)
        noise = _noise(readings, local, gamma)
        covariance = local.slopes @ whole @ local.slopes.T + noise
        solution = free * (whole @ local.slopes.T @ np.linalg.solve(covariance, target))
        z, scale = solution[:-1], max(1.0 + float(solution[-1]), LEAST)
        if float(np.abs(local.slopes @ (solution - x)).max()) < _STEP_TOLERANCE:
            break
    return linearised(prior, readings, states, robot_in_cell, z, scale), z, scale, gamma


def _unmodelled_share(readings: Readings, local: _Linear, whole: Array, target: Array) -> float:
    """Return γ: the root of its mean square, given the readings."""
    log_ratio = np.linspace(-4.0, 4.0, 97)  # fine enough for γ from 200 readings
    share = _GAMMA * np.exp(WIDTH * log_ratio)
    covariance = local.slopes @ whole @ local.slopes.T + _noise(readings, local, 0.0)
    likely = np.empty(len(share))
    for k, gamma in enumerate(share.tolist()):
        lower = np.linalg.cholesky(covariance + np.diag((gamma * local.moved) ** 2))
        white = np.linalg.solve(lower, target)
        likely[k] = -0.5 * float(white @ white) - float(np.log(np.diag(lower)).sum()) - 0.5 * log_ratio[k] ** 2
    chance = np.exp(likely - likely.max())
    return float(np.sqrt(np.sum(chance * share**2) / chance.sum()))


def _posterior(readings: Readings, local: _Linear, gamma: float, whole: Array, free: Bools) -> Array:
    """Return the covariance (p + 1, p + 1) after the readings.

    A parameter that is not free keeps its value, and its uncertainty counts for those that are: Schmidt, "Application
    of state-space methods to navigation problems", 1966 (consider covariance).
    """
    noise = _noise(readings, local, gamma)
    spread = whole @ local.slopes.T
    gain = free[:, None] * np.linalg.solve(local.slopes @ spread + noise, spread.T).T
    left = np.eye(len(whole)) - gain @ local.slopes
    return np.asarray(left @ whole @ left.T + gain @ noise @ gain.T)


def _left_out(
    readings: Readings, local: _Linear, gamma: float, whole: Array, z: Array, scale: float
) -> tuple[Array, Array]:
    """Return the error (n,) of each point predicted from all others, and its variance (n,).

    Source: Rasmussen and Williams, "Gaussian Processes for Machine Learning", 2006, Eq. (5.12).
    """
    target = readings.probed.deviation - local.value + local.slopes @ np.append(z, scale - 1.0)
    inverse = np.linalg.inv(local.slopes @ whole @ local.slopes.T + _noise(readings, local, gamma))
    diagonal = np.diag(inverse)
    return inverse @ target / diagonal, 1.0 / diagonal
