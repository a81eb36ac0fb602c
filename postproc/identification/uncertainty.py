"""Uncertainty of an identified model: unmodelled error, errors of the set-up, bound in the workspace, verdict.

**Unmodelled error** (`discrepancy`), by load level. Friction, or a breakpoint that the model lacks, shows on
configurations left out, as an error beyond noise and parameter uncertainty. Points of one state share most of it, but
not their noise, so the mean of the points of a state is judged. Its error is normal with a covariance V + δ²·1, V that
of noise and parameters. δ is estimated from the errors, each configuration weighted by its precision. Before any
reading δ is log-normal about a thousandth of the displacements at its level, and one standard deviation is a
factor of 4.5; so it is never zero, and few configurations leave it wide. The result is the 95 % quantile of the errors,
integrated over the distribution of δ: a smooth function of the readings, without a threshold. Hysteresis of gears shows
in the states without load too, and in displacements from repeat to repeat (`return_error`): the unmodelled error is at
least how far the tool does not return.

**Errors of the set-up** (`add_stated_errors`) that no reading shows, as the experiment states them: of all loads, and
of the load point. A load cell that is wrong by 2 % makes every spring look 2 % softer without any residual; an error of
the load point is a wrong lever, which looks like compliance. Both go into the covariance of the parameters.

**Workspace** (`bound_over_workspace`): how large is the bound over the deflection that the model corrects, and what is
the chance that correction makes a place better? Readings are taken at some poses; work is done at others. The model is
evaluated at random poses within the joint limits, under forces in random directions from a small share of the largest
load measured up to all of it, smaller where a joint would get more torque than was measured. At small forces every
model is worth less: the unmodelled error does not shrink with the force. The verdict counts loads that were measured.

**Verdict** (`judge`): whether the model may be used, and notes on gaps of its readings. A model may not be used if
correction is expected to do more harm than good (a chance below `elastostatics.HARMFUL_CHANCE`). With an error of mean
zero the chance is Φ(d/2σ) at a place with the deflection d (`elastostatics.expected_error`): a wide bound brings it
near to one half, and never below. So width alone refuses no model. Where it is below `elastostatics.UNCERTAIN_CHANCE`
at 5 % of the poses, the verdict says so, and where the bound is about as large as the deflection; each program that is
converted states its own chance. A robot that deflects as no robot of its kind does gets a reservation too: a common
error of all loads is in no residual. Refused are readings from which no bound can be estimated, and models that have no
equilibrium under loads that were measured. Noise of the measuring device decides nothing: a better one shows more of
what the model lacks, of the same robot.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import elastostatics, kinematics
from postproc.errors import NotConvergedError, first_of
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm
from postproc.identification.choice import Choice
from postproc.identification.fit import NORMAL_95, Fit
from postproc.identification.joint_springs import PRIOR_SPREAD_SHARE, prior_spread
from postproc.identification.measurement_model import (
    Placement,
    joint_torques,
    measured_displacements,
    predict,
    unwhiten,
    visible_points,
    whiten,
    whitening,
)
from postproc.identification.readings import Measurements
from postproc.identification.record import RESERVATION
from postproc.identification.return_error import displacement_changes, noise_variance, return_errors
from postproc.program import Ints
from postproc.robot import (
    JOINT_COMPLIANCES,
    JOINTS,
    Backlash,
    CompensatorSize,
    CompensatorTorque,
    FadingPart,
    GearCoupling,
    JointCompliance,
    Knee,
    LinkMass,
    LinkSpring,
    LostMotion,
    Parameter,
    PoseWave,
    RobotModel,
)

_SAME_LEVEL = 1.25
"""Sorted loads belong to one level while each is less than this times the one before (assumed)."""
_MIN_LOADS = 10
"""Fewest loads of a level that is part of a wider range without gaps (assumed)."""
_MEDIAN_SHARE = 0.001
"""Median of δ over the displacements (RMS of a component) before any reading (assumed)."""
LOG_SIGMA = 1.5
"""Standard deviation of the logarithm of δ before any reading (assumed)."""
_DELTA_COUNT, _DELTA_SPAN = 241, (-5.0, 4.5)
"""Values of δ that are tried, and between which standard deviations of its prior."""
_LENGTH_COUNT = 2000
"""Number of lengths between which the 95 % quantile is interpolated (assumed): neighbours differ by a per cent or
less."""


class Discrepancy(Struct, frozen=True, eq=False):
    """Cross-validation errors at m load levels.

    :param load: (m,) force [N] and moment [N·m] in one.
    :param held_out: (m,) RMS distance of the mean of the points from its prediction [m].
    :param noise: (m,) part of `held_out` that the noise of the readings makes, RMS [m].
    :param parameter_error: (m,) part of `held_out` that the uncertainty of the parameters makes, RMS [m].
    :param u95: (m,) bound of 95 % on the unmodelled error [m], at least `return_bound`.
    :param return_bound: bound of 95 % on the distance of the unloaded tool from its place after loads [m]; None: the
        readings do not show it.
    """

    load: Array
    held_out: Array
    noise: Array
    parameter_error: Array
    u95: Array
    return_bound: float | None


def discrepancy(data: Measurements, placement: Placement, fit: Fit, fold_residual: Array) -> Discrepancy:
    """Return cross-validation errors by load level, with the unmodelled error beyond noise and covariance of the fit.

    Levels without readings are left out.

    :param fold_residual: (L, P, 3) measured − predicted displacements, each by a fit without its configuration [m].
    """
    is_visible = visible_points(data)[..., 0] > 0.0
    errors = _mean_point_errors(data, fit, fold_residual)
    displacement = measured_displacements(data, placement)
    load = norm(data.wrench[data.loaded_states])
    level = levels(load)
    rows_by_level = [
        np.flatnonzero((level == index) & is_visible.any(axis=1)) for index in range(int(level.max()) + 1)
    ]  # of the loaded states with readings
    rows_by_level = [rows for rows in rows_by_level if len(rows) > 0]
    # of the standard deviation δ of the unmodelled error before any reading, in proportion to the displacements
    prior_medians = [
        _MEDIAN_SHARE * float(np.sqrt(np.mean(displacement[rows][is_visible[rows]] ** 2))) for rows in rows_by_level
    ]
    return_bound = _return_bound(data, prior_medians[0])  # of positions; displacements show a change instead
    if return_bound is None:
        return_bound = _change_bound(data, prior_medians[0])
    u95 = [
        max(unmodelled_error(errors.error[rows], errors.covariance[rows], median), return_bound or 0.0)
        for rows, median in zip(rows_by_level, prior_medians, strict=True)
    ]
    mean_squares = (np.sum(errors.error**2, axis=1), errors.noise, errors.fit_variance)
    fold_rms, noise_rms, fit_rms = np.sqrt([[values[rows].mean() for rows in rows_by_level] for values in mean_squares])
    return Discrepancy(
        load=np.array([np.median(load[rows]) for rows in rows_by_level]),
        held_out=fold_rms,
        noise=noise_rms,
        parameter_error=fit_rms,
        u95=np.maximum.accumulate(u95),  # an error under a load also exists under a larger one
        return_bound=return_bound,
    )


def _return_bound(data: Measurements, median: float) -> float | None:
    """Return the bound of 95 % on the distance of the unloaded tool from its place after loads [m]; None: not known.

    :param median: median of its standard deviation before any reading [m].
    """
    errors = return_errors(data)
    if errors is None:
        return None
    covariance = np.tile(errors.variance * np.eye(3), (len(errors.error), 1, 1))
    return _small_sample_factor(len(errors.error)) * unmodelled_error(errors.error, covariance, median)


def _small_sample_factor(count: int) -> float:
    """Return by how much the bound on the next length is wider, as its standard deviation is known from few lengths.

    It is the root of the ratio of the 95 % quantiles of F with 3 and 3n degrees of freedom and of χ² with 3, over 3:
    1.15 for four, 1.03 for 20 (prediction interval: Hahn and Meeker, Statistical Intervals, 1991).

    :param count: number n of lengths, of three coordinates each.
    """
    from scipy.special import chdtri, fdtri  # takes long to import

    return float(np.sqrt(3.0 * fdtri(3, 3 * count, 0.95) / chdtri(3, 0.05)))


def _change_bound(data: Measurements, median: float) -> float | None:
    """Return the bound of 95 % on the change of displacements from the first repeat to later ones [m]; None: not known.

    :param median: median of its standard deviation before any reading [m].
    """
    changes = displacement_changes(data)
    if changes is None:
        return None
    variance = noise_variance(data) / changes.weight
    config = data.state_config[changes.state]
    weight = 1.0 / np.bincount(config)[config]  # the loads of a configuration share the state without load
    bound = unmodelled_error(changes.change, variance[:, None, None] * np.eye(3), median, weight)
    return _small_sample_factor(len(np.unique(config))) * bound


class _MeanPointErrors(NamedTuple):
    """Cross-validation errors of the mean of the visible points in L loaded states; 0 for states without such points.

    :param error: (L, 3) measured − predicted [m].
    :param noise: (L,) mean square length of the noise [m²].
    :param fit_variance: (L,) mean square length of errors by the uncertainty of the parameters [m²].
    :param covariance: (L, 3, 3) of noise and parameters together [m²].
    """

    error: Array
    noise: Array
    fit_variance: Array
    covariance: Array


def _mean_point_errors(data: Measurements, fit: Fit, fold_residual: Array) -> _MeanPointErrors:
    """Return the errors of the mean of the visible points of each loaded state; parameters: see `discrepancy`."""
    is_visible = visible_points(data)[..., 0] > 0.0
    share = is_visible / np.maximum(is_visible.sum(axis=1), 1)[:, None]  # of each point in the mean
    slopes = unwhiten(whitening(data), fit.design.reshape((*fold_residual.shape, len(fit.values))))
    mean_slopes = np.einsum("lp,lpia->lia", share, slopes)
    fit_covariance = mean_slopes @ fit.covariance @ np.swapaxes(mean_slopes, 1, 2)
    noise = np.sum(share**2 * displacement_noise(data), axis=1)
    return _MeanPointErrors(
        error=np.einsum("lp,lpi->li", share, fold_residual),
        noise=noise,
        fit_variance=np.trace(fit_covariance, axis1=1, axis2=2),
        covariance=fit_covariance + noise[:, None, None] / 3.0 * np.eye(3),
    )


def unmodelled_error(error: Array, covariance: Array, median: float, weight: Array | float = 1.0) -> float:
    """Return the 95 % quantile of the length of unmodelled errors [m].

    Their components have the standard deviation δ. The quantile is integrated numerically over the posterior
    distribution of δ (see the module).

    :param error: (n, 3) errors [m].
    :param covariance: (n, 3, 3) of the errors without δ: by noise and parameters [m²].
    :param median: of δ before any reading [m].
    :param weight: (n,) of each error in the likelihood; below one for errors that share their unmodelled part.
    """
    from scipy.special import gammainc  # takes long to import

    variance, axes = np.linalg.eigh(covariance)  # along principal axes the components are independent
    square = np.einsum("nij,ni->nj", axes, error) ** 2
    z = np.linspace(*_DELTA_SPAN, _DELTA_COUNT)  # of log δ, in standard deviations: standard normal before any reading
    # 1e-9 m: δ has a logarithm even if nothing moved
    delta = max(median, 1e-9) * np.exp(LOG_SIGMA * z)
    total_variance = variance + delta[:, None, None] ** 2  # for each δ, error and axis
    log_density = (
        -0.5 * np.sum((np.log(total_variance) + square / total_variance).sum(axis=2) * weight, axis=1) - 0.5 * z**2
    )
    probability = np.exp(log_density - log_density.max())
    probability /= probability.sum()
    length = np.geomspace(delta[0], 4.0 * delta[-1], _LENGTH_COUNT)  # 4 δ: practically no error is longer

    def share_below(size: float) -> float:
        """Return the share of unmodelled errors shorter than a length [m]: χ² of three degrees of freedom."""
        return float(gammainc(1.5, 0.5 * (size / delta) ** 2) @ probability)

    # the share grows with the length: the 95 % quantile is between two neighbouring lengths
    upper = max(1, bisect_left(length, 0.95, hi=len(length) - 1, key=share_below))
    bracket = length[upper - 1 : upper + 1]
    return float(np.interp(0.95, [share_below(size) for size in bracket], bracket))


def levels(load: Array) -> Ints:
    """Return the number of the level (L,), from 0 up, of each load (L,) [N].

    Sorted loads are split at gaps. A range without gaps is split further, into as many levels as the load doubles, if
    each level has `_MIN_LOADS` loads; its levels have about the same number of loads.
    """
    order = np.argsort(load)
    # a gap: the next load is larger by more than the share _SAME_LEVEL − 1
    first_after_gap = np.flatnonzero(np.diff(load[order]) > (_SAME_LEVEL - 1.0) * load[order][:-1]) + 1
    parts: list[Ints] = []
    for rows in np.split(order, first_after_gap):
        # 1e-9: rounding of a range of exactly one doubling
        doublings = max(1, int(np.ceil(np.log2(load[rows[-1]] / load[rows[0]]) - 1e-9)))
        parts += np.array_split(rows, min(doublings, max(1, len(rows) // _MIN_LOADS)))
    level = np.empty(len(load), dtype=np.int64)
    for number, rows in enumerate(parts):
        level[rows] = number
    return level


def displacement_noise(data: Measurements) -> Array:
    """Return the mean square length (L, P) of the noise of displacements [m²], of P points in L loaded states.

    The noise of a reading is the scatter of the repeats if its degrees of freedom are enough, else the stated noise.
    """
    sigma2 = noise_variance(data)
    _, reading_count = data.means()
    count = np.maximum(reading_count, 1.0)
    unloaded_state = data.unloaded_states[data.state_config[data.loaded_states]]
    # three coordinates of a difference of two means
    return np.asarray(3.0 * sigma2 * (1.0 / count[data.loaded_states] + 1.0 / count[unloaded_state]))


def left_out_residuals(fit: Fit, data: Measurements) -> Array:
    """Return the residuals (L, P, 3) [m] of the points, each when its configuration is left out of a least-squares fit.

    With the derivatives at the fit they are (I − H)⁻¹ r. r are the residuals of the configuration in the fit, and H is
    its block of the hat matrix.
    """
    shape = (len(data.loaded_states), len(data.points), 3)
    scale = np.linalg.norm(fit.design, axis=0)
    rows = fit.design / np.where(scale > 0.0, scale, 1.0)
    inverse = np.linalg.pinv(rows.T @ rows, hermitian=True)
    residual = fit.target - fit.design @ fit.values
    config = np.repeat(data.state_config[data.loaded_states], 3 * len(data.points))
    fold_residual = np.empty_like(residual)
    for index in range(len(data.q)):
        is_left_out = config == index
        hat = rows[is_left_out] @ inverse @ rows[is_left_out].T
        # 1e-9: a configuration that alone determines a parameter leaves no residual, and I − H is singular
        fold_residual[is_left_out] = np.linalg.solve(np.eye(len(hat)) - hat * (1.0 - 1e-9), residual[is_left_out])
    return unwhiten(whitening(data), fold_residual.reshape(shape))


_POINT_STEP = 1e-3
"""Shift of the load point [m] for a difference quotient: displacements are nearly linear in it."""


def add_stated_errors(fit: Fit, data: Measurements, placement: Placement, influence: Array | None) -> Fit:
    """Return the fit with a covariance that contains the stated errors of the loads and of the load point too.

    :param influence: (p, rows) derivatives of the parameters by the whitened readings; None: those of least squares.
    """
    effects = []  # of one standard deviation of each independent error on the parameters, (p,) each
    if data.load_error > 0.0:  # relative, 95 %
        share = np.array([_load_sensitivity(parameter) for parameter in fit.structure.parameters])
        effects.append(data.load_error / NORMAL_95 * share * fit.values)
    if data.load_point_error > 0.0:
        if influence is None:
            scale = np.linalg.norm(fit.design, axis=0)
            scale[scale == 0.0] = 1.0
            # rcond: directions that are rounding alone
            influence = np.linalg.pinv(fit.design / scale, rcond=1e-9) / scale[:, None]
        w = whitening(data)
        prediction, _ = predict(fit.structure, fit.values, data, placement)
        for axis in np.eye(3):
            shifted_data = replace(data, load_point=data.load_point + _POINT_STEP * axis)
            shifted_prediction, _ = predict(fit.structure, fit.values, shifted_data, placement)
            effects.append(
                data.load_point_error * influence @ whiten(w, (shifted_prediction - prediction) / _POINT_STEP).ravel()
            )
    return replace(fit, covariance=fit.covariance + sum(np.outer(effect, effect) for effect in effects))


def _load_sensitivity(parameter: Parameter) -> float:
    """Return the relative error of a parameter by the relative error of all loads: 1, −1 for stiffnesses, or 0.

    It is 0 for sources of torque at rest, and for angles of backlash, which do not depend on the size of the load.
    """
    if isinstance(parameter, Backlash | LinkMass | CompensatorSize):
        return 0.0
    return -1.0 if isinstance(parameter, CompensatorTorque) else 1.0


SHARES = (0.05, 0.1, 0.2, 0.5, 1.0)
"""Shares of the largest load measured."""
_POSES = 100
"""Random poses of the workspace (assumed)."""
_POSE_SHARE = 0.95
"""Share of the poses at which bound over deflection is below the stated value."""
_TORQUE_SHARE = 0.02
"""Largest torque on a joint over the largest on any, below which the readings do not load it."""
_SIMILAR_RATIO = 0.9
"""Bound over deflection from which they are about equal, so that it is not certain that correction leaves less: both
are known to a tenth (assumed)."""
_CLEARANCE_SHARE = 0.25
"""Distance from the axis of A1 over the largest reach, nearer than which no work is done."""


class WorkspaceLevel(Struct, frozen=True):
    """Bound over deflection at a share of the largest load, over the workspace.

    :param load: force [N], median over the poses.
    :param deflection: of the tool [m], median.
    :param bound: u95 [m], median.
    :param bound_ratio: bound over deflection that 95 % of the poses are below.
    :param chance: that correction makes a place better, which 95 % of the poses are above.
    """

    load: float
    deflection: float
    bound: float
    bound_ratio: float
    chance: float


class Workspace(Struct, frozen=True):
    """Bound over deflection in the workspace.

    :param levels: by load, ascending; empty if the springs have no equilibrium under measured loads.
    :param least_load: smallest load measured [N].
    :param cause: joint and parameter with the largest part of the bound, at the worst pose under measured loads; or
        the load without an equilibrium.
    :param pose: (6,) joint angles of this pose [rad].
    """

    levels: tuple[WorkspaceLevel, ...]
    least_load: float
    cause: str
    pose: tuple[float, ...]

    @property
    def measured_levels(self) -> tuple[WorkspaceLevel, ...]:
        """Levels from the smallest measured load on; if all are below it, the level of the largest load."""
        return tuple(level for level in self.levels if level.load >= self.least_load) or self.levels[-1:]

    @property
    def worst_level(self) -> WorkspaceLevel:
        """The level of measured loads at which bound over deflection is largest; there must be levels."""
        return max(self.measured_levels, key=lambda level: level.bound_ratio)

    @property
    def refusal(self) -> str:
        """Pose and load under which the model has no equilibrium, as a clause; empty if it has one everywhere."""
        return "" if self.levels else f"at A1 … A6 = {self._angles}° {self.cause}"

    @property
    def reservation(self) -> str:
        """Clause on measured loads under which correction may gain little, and the cause; empty if there are none.

        It may gain little if the chance that correction makes the part better is below
        `elastostatics.UNCERTAIN_CHANCE` in 5 % of the poses, or if the bound is about as large as the deflection.
        """
        weakest_level = min(self.measured_levels, key=lambda level: level.chance, default=None)
        if weakest_level is None:
            return ""
        is_wide = weakest_level.chance < elastostatics.UNCERTAIN_CHANCE
        if not is_wide and self.worst_level.bound_ratio < _SIMILAR_RATIO:
            return ""
        chance = (
            f"under {weakest_level.load:.0f} N there are poses where correction makes the part better with a chance of "
            f"{100.0 * weakest_level.chance:.0f} % only; "
        )
        return (
            f"{chance if is_wide else ''}under {self.worst_level.load:.0f} N the bound is up to "
            f"{self.worst_level.bound_ratio:.2g} times the deflection (A1 … A6 = {self._angles}°): {self.cause}"
        )

    @property
    def _angles(self) -> str:
        """The joint angles of the pose, for messages [deg]."""
        return ", ".join(f"{angle * DEG_PER_RAD:.0f}" for angle in self.pose)

    @property
    def line(self) -> str:
        """Sentence on bound over deflection in the workspace; without an equilibrium, on that."""
        if not self.levels:
            return f"workspace: {self.refusal}"
        text = (
            "bound over deflection in the workspace: below "
            f"{self.worst_level.bound_ratio:.2g} in 95 % of the poses from "
            f"{self.measured_levels[0].load:.0f} N to {self.levels[-1].load:.0f} N"
        )
        exceeded_levels = [level for level in self.levels if level.bound_ratio > 1.0]
        if exceeded_levels and exceeded_levels[-1].load < self.least_load:
            text += f"; at {exceeded_levels[-1].load:.0f} N and below the bound can exceed the deflection"
        return text


def bound_over_workspace(robot: RobotModel, data: Measurements) -> Workspace:
    """Return bound over deflection of an identified robot at random poses, under shares of the largest measured load.

    :param robot: with covariance and discrepancy.
    """
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    q, direction = _random_poses(robot, tool)
    least_load = float(norm(data.wrench[data.loaded_states, :3]).min())
    largest_force = _largest_forces(robot, data, q, direction)
    levels: list[WorkspaceLevel] = []
    largest_ratio, cause, worst_pose = 0.0, "", q[0]  # of levels of measured loads
    for share in SHARES:
        wrench = np.concatenate([share * largest_force[:, None] * direction, np.zeros_like(direction)], axis=1)
        try:
            deflection = elastostatics.deflect(robot, q, tool, wrench).twist[:, :3]
        except NotConvergedError as error:
            row = int(error.rows[0])
            cause = f"the springs have no equilibrium under {share * largest_force[row]:.0f} N"
            return Workspace((), least_load, cause, tuple(q[row].tolist()))
        errors = elastostatics.sources_of_error(robot, elastostatics.LoadedPlaces.of(q, tool, wrench))
        bound = elastostatics.largest_length(errors.covariances())
        # 1e-12 m keeps zero out of the denominator
        ratio = bound / np.maximum(norm(deflection), 1e-12)
        level = WorkspaceLevel(
            load=float(np.median(share * largest_force)),
            deflection=float(np.median(norm(deflection))),
            bound=float(np.median(bound)),
            bound_ratio=float(np.quantile(ratio, _POSE_SHARE)),
            chance=float(np.quantile(elastostatics.chances_of_gain(errors, deflection), 1.0 - _POSE_SHARE)),
        )
        levels.append(level)
        if level.load >= least_load and level.bound_ratio > largest_ratio:
            row = int(np.argmin(np.abs(ratio - level.bound_ratio)))
            largest_ratio, worst_pose = level.bound_ratio, q[row]
            cause = _main_cause(robot, q[row], tool, wrench[row], float(bound[row]))
    return Workspace(tuple(levels), least_load, cause, tuple(worst_pose.tolist()))


def _largest_forces(robot: RobotModel, data: Measurements, q: Array, direction: Array) -> Array:
    """Return the largest force (n,) [N] at each pose whose torques are in the range of the readings.

    It is the largest measured force, or less if that would put more torque on a joint than was measured. Joints that
    the readings hardly load do not limit it.

    :param q: (n, 6) joint angles [rad], and `direction` (n, 3) unit direction of the force at each pose, root axes.
    """
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    largest = norm(data.wrench[data.loaded_states, :3]).max()
    data_torque = np.abs(joint_torques(robot, data)).max(axis=0)
    _, jacobian = kinematics.tcp(robot.loaded, elastostatics.coordinates(robot, q), tool)
    torque = np.abs(np.einsum("nij,ni->nj", jacobian[:, :3, list(robot.actuated)], direction)) * largest
    is_loaded = data_torque > _TORQUE_SHARE * data_torque.max()
    # 1e-9 N·m keeps zero out of the denominator
    limits = (data_torque[is_loaded] / np.maximum(torque[:, is_loaded], 1e-9)).min(axis=1)
    return np.asarray(largest * np.minimum(1.0, limits))


def _random_poses(robot: RobotModel, tool: Array) -> tuple[Array, Array]:
    """Return random joint angles (n, 6) [rad], and random unit directions (n, 3) of forces, with a fixed seed.

    The tool is above the floor and away from the axis of A1. n is `_POSES`, or less if few random poses are.

    :param tool: (4, 4) in the flange frame [m].
    """
    rng = np.random.default_rng(0)
    q = rng.uniform(robot.lower, robot.upper, (8 * _POSES, 6))  # more than are needed: many are not clear
    pose, _ = kinematics.tcp(robot.loaded, elastostatics.coordinates(robot, q), tool)
    position = pose[:, :3, 3]
    reach = norm(position[:, :2])
    clear_rows = np.flatnonzero((position[:, 2] > 0.0) & (reach > _CLEARANCE_SHARE * reach.max()))[:_POSES]
    direction = rng.normal(size=(len(clear_rows), 3))
    return q[clear_rows], direction / norm(direction)[:, None]


def _main_cause(robot: RobotModel, q: Array, tool: Array, wrench: Array, bound: float) -> str:
    """Return, as a clause, the joint and its parameter with the largest part of the bound at a pose.

    The clause names the unmodelled error instead if that is more than half of the bound.

    :param q: (6,) joint angles [rad].
    :param tool: (4, 4) in the flange frame [m].
    :param wrench: (6,) force [N] and moment [N·m] on the tool, root axes.
    :param bound: of the position of the tool [m].
    """
    covariance = robot.covariance
    assert covariance is not None, "the robot states a covariance"
    slopes = elastostatics.sensitivity(robot, q[None], tool, wrench[None])[0]
    # parts of the trace of the covariance of the position: diagonal of Sᵀ S C, for slopes S and covariance C
    part = np.einsum("ai,ai->i", slopes, slopes @ covariance.matrix)
    part_of_joint: dict[str, float] = {}
    for parameter, value in zip(covariance.parameters, part.tolist(), strict=True):
        joint = _joint_name(parameter)
        part_of_joint[joint] = part_of_joint.get(joint, 0.0) + value
    unmodelled_error = 0.0 if robot.discrepancy is None else float(robot.discrepancy.at(wrench[None])[0])
    if unmodelled_error > 0.5 * bound or not part_of_joint:
        return f"the unmodelled error is {unmodelled_error * MM_PER_M:.3f} of {bound * MM_PER_M:.3f} mm"
    main_joint = max(part_of_joint, key=lambda name: part_of_joint[name])
    rows = [row for row, parameter in enumerate(covariance.parameters) if _joint_name(parameter) == main_joint]
    main_row = max(rows, key=lambda row: (part[row], covariance.parameters[row].title))
    return (
        f"most of it comes from {main_joint}, whose readings do not determine {covariance.parameters[main_row].title}"
    )


def _joint_name(parameter: Parameter) -> str:
    """Return the name of the joint or link that a parameter belongs to; A2 for the compensator."""
    if isinstance(parameter, LinkSpring):
        return parameter.link
    return str(getattr(parameter, "joint", JOINTS[1]))


_MAX_SQUARE_ERROR = 4.0
"""Mean square cross-validation error, in σ², beyond which the model is incomplete: its bound contains what it lacks."""
_LARGE_MISFIT = 0.3
"""Cross-validation error over displacement (RMS) beyond which the set-up is in question: exchanged axes of the forces
left half of the displacements of a measured robot, true ones less than a tenth (assumed)."""
_USELESS_MISFIT = 0.5
"""Cross-validation error over displacement (RMS) beyond which a model may not be used: right set-ups leave less than a
tenth (assumed)."""
_MIN_CONFIGURATIONS = 3
"""Fewest configurations whose scatter can be estimated."""
_FEW_CONFIGURATIONS = 5
"""Configurations below which the scatter is known badly: the bound of one simulated robot in ten did not hold."""
_NUMBERS_BY_POINTS = {1: 3, 2: 5}
"""Numbers that the displacements of one, two, three points determine; three and more give the six of a rigid body."""
_IMPLAUSIBLE_SIGMAS = 3.0
"""Difference of all compliances from the prior, in its standard deviations, beyond which the loads are wrong (assumed:
three right robots in a thousand have as much)."""
_MIN_NUMBERS_PER_PARAMETER = 2.0
"""Least numbers measured for each parameter of least squares."""
_SAME_DIRECTION = 0.1
"""Singular value of unit wrenches below which they count as dependent (assumed): some degrees between directions."""
_MIN_BACKLASH = 1e-5
"""Smallest backlash [rad] that is reported (assumed)."""
_KIND_NAMES: tuple[tuple[type[Parameter], str], ...] = (
    (JointCompliance, "joints"),
    (LinkSpring, "link springs"),
    (Knee, "breakpoints"),
    (FadingPart, "fading parts of gears"),
    (LostMotion, "lost motion"),
    (Backlash, "backlash"),
    (GearCoupling, "couplings"),
    (PoseWave, "waves over the pose"),
    (LinkMass, "masses"),
    (CompensatorSize, "compensator"),
)
_MAX_NAMES = 6
"""Names of a kind that a warning lists."""


class Judgement(Struct, frozen=True):
    """Whether a model may be used.

    :param distrust: reason that it may not be used; empty if it may.
    :param reservation: clauses that the user of the model must know; empty if there are none.
    :param notes: on gaps of the readings, for the user.
    """

    distrust: str
    reservation: str
    notes: list[str]

    @property
    def line(self) -> str:
        """The verdict in one line."""
        if self.distrust:
            return f"NOT TO BE TRUSTED: {self.distrust}"
        usable = "the model may be used, within its bound"
        return f"{usable}{RESERVATION}{self.reservation}" if self.reservation else usable

    def with_reservation(self, reservation: str) -> Judgement:
        """Return the judgement with a further reservation, before the others; an empty text changes nothing."""
        return replace(self, reservation="; ".join(filter(None, (reservation, self.reservation))))


class _Misfit(NamedTuple):
    """Error of the displacements that a model describes.

    :param error: RMS of the error [m].
    :param size: RMS of the displacements [m].
    :param is_noise: whether noise explains an error of this size.
    """

    error: float
    size: float
    is_noise: bool

    def text_beyond(self, share: float) -> str:
        """Return a clause on the error; empty if noise explains it, or if it is below a share of the displacements."""
        if self.is_noise or self.error <= share * self.size:
            return ""
        return (
            f"the model is off by {self.error * MM_PER_M:.2g} mm RMS of displacements of {self.size * MM_PER_M:.2g} "
            "mm: check axes, signs and units of forces and positions"
        )


def judge(data: Measurements, fit: Fit, choice: Choice | None, workspace: Workspace, ratio: float) -> Judgement:
    """Return whether a model may be used, with reservations and notes.

    :param choice: structures tried; None: joint springs alone.
    :param ratio: of measured displacements to displacements of the prior robot, see `plausibility.displacement_ratio`.
    """
    misfit = _misfit(data, fit, choice)
    reservations = [
        misfit.text_beyond(_LARGE_MISFIT),
        _few_configurations(data),
        workspace.reservation,
        _implausible_scale(fit.structure.prior, ratio),
    ]
    return Judgement(
        distrust=_too_few_configurations(data, fit, choice) or misfit.text_beyond(_USELESS_MISFIT) or workspace.refusal,
        reservation="; ".join(filter(None, reservations)),
        notes=_gap_notes(data, fit, choice),
    )


def _few_configurations(data: Measurements) -> str:
    """Return a reservation if fewer than `_FEW_CONFIGURATIONS` were measured; else empty."""
    if len(data.q) >= _FEW_CONFIGURATIONS:
        return ""
    return (
        f"{len(data.q)} configurations show little of what the model lacks: measure {_FEW_CONFIGURATIONS} or more "
        "(30 are usual)"
    )


def _implausible_scale(robot: RobotModel, ratio: float) -> str:
    """Return a reservation if all compliances would be implausibly far from the prior robot; else empty.

    :param ratio: of measured displacements to displacements of the prior robot.
    """
    spread = sum(prior_spread(robot, joint) for joint in JOINT_COMPLIANCES)
    largest_ratio = 1.0 + _IMPLAUSIBLE_SIGMAS * max(
        spread / sum(map(robot.value, JOINT_COMPLIANCES)), PRIOR_SPREAD_SHARE
    )
    if 1.0 / largest_ratio < ratio < largest_ratio:
        return ""
    return (
        f"all points move {ratio:.2g} times as far as {robot.name} would, and robots of one kind differ by a factor of "
        f"{largest_ratio:.1f} at most: check the scale and the unit of the forces (N), and the robot of the experiment"
    )


def _misfit(data: Measurements, fit: Fit, choice: Choice | None) -> _Misfit:
    """Return the RMS error of the displacements: in cross-validation if a structure was chosen, else of the fit."""
    mean, _ = data.means()
    unloaded_states = data.unloaded_states[data.state_config[data.loaded_states]]
    measured = np.nan_to_num(mean[data.loaded_states] - mean[unloaded_states])
    residual = fit.residual if choice is None else choice.left_out
    visibility = visible_points(data)
    error, size = (
        float(np.sqrt(np.sum((vectors * visibility) ** 2) / max(1.0, visibility.sum())))
        for vectors in (residual, measured)
    )
    return _Misfit(error, size, _square_error(fit, choice) <= _MAX_SQUARE_ERROR)


def _square_error(fit: Fit, choice: Choice | None) -> float:
    """Return the mean square error [σ²]: of configurations left out if a structure was chosen, else of the fit."""
    return fit.chi2 / max(fit.dof, 1) if choice is None else float(choice.held_out.mean())


def _too_few_configurations(data: Measurements, fit: Fit, choice: Choice | None) -> str:
    """Return a clause if the configurations are too few to estimate a bound; empty if they are enough.

    Least squares need spare readings: with fewer they describe the readings and not the robot. Structures with priors
    take as many numbers from the readings as these determine.
    """
    directions = float(np.mean(load_directions(data)))
    parameters = 0 if choice is not None else len(fit.values)
    fewest = fewest_configurations(parameters, len(data.points), directions)
    if len(data.q) >= fewest:
        return ""
    return (
        f"{len(data.q)} configurations were measured, which determine about "
        f"{_numbers_of_a_configuration(len(data.points), directions):.0f} numbers each; the model needs {fewest} "
        "configurations at least (30 are usual)"
    )


def fewest_configurations(parameters: int, points: int, directions: float) -> int:
    """Return the number of configurations below which a model may not be used.

    :param parameters: number of parameters of least squares; 0 for parameters with priors.
    :param points: number of reference points.
    :param directions: mean number of independent loads of a configuration.
    """
    numbers = _numbers_of_a_configuration(points, directions)
    return max(_MIN_CONFIGURATIONS, int(np.ceil(_MIN_NUMBERS_PER_PARAMETER * parameters / numbers)))


def load_directions(data: Measurements) -> list[int]:
    """Return the number of linearly independent loads (rank of the unit wrenches) of each configuration.

    Loads whose directions differ by a few degrees count as one.
    """
    wrench, config = data.wrench[data.loaded_states], data.state_config[data.loaded_states]
    unit_wrench = wrench / norm(wrench)[:, None]
    return [
        int(np.linalg.matrix_rank(unit_wrench[config == index], tol=_SAME_DIRECTION)) for index in range(len(data.q))
    ]


def _numbers_of_a_configuration(points: int, directions: float) -> float:
    """Return the number of spring parameters that a configuration determines, by its points and load directions."""
    return _NUMBERS_BY_POINTS.get(points, 6) * directions  # 6: three points and more show all of a rigid body


def _gap_notes(data: Measurements, fit: Fit, choice: Choice | None) -> list[str]:
    """Return sentences on doubts that the fit or the readings leave, for the report.

    They name a mean square error above the noise, readings at one load level only, parameters that the readings do not
    narrow, joints with a compliance of zero, and backlash beyond its 95 % half width.

    :param choice: structures tried; None: joint springs alone.
    """
    notes = []
    load = norm(data.wrench[data.loaded_states])  # [N]
    square_error = _square_error(fit, choice)
    if square_error > _MAX_SQUARE_ERROR:
        basis = "on configurations left out" if choice is not None else "on the readings"
        notes.append(
            f"{basis} the mean square error is {square_error:.1f} σ² (noise alone: 1): the robot does something that "
            "the model does not describe, which the bound contains, or the set-up is stated wrong, which it does not."
        )
    if choice is not None:
        if int(levels(load).max()) == 0:  # all loads are of level 0
            notes.append(
                f"one level of loads ({np.median(load):.0f} N): gears that stiffen or have breakpoints are seen only "
                "near the cutting force. Measure each configuration under a second load of about that force."
            )
        notes += _unidentified_notes(choice)
    notes += _joint_notes(fit, fit if choice is None else choice.fit)
    return notes


def _joint_notes(fit: Fit, posterior_fit: Fit) -> Iterator[str]:
    """Yield sentences on joints with a compliance of zero, and on backlash beyond its 95 % half width.

    :param fit: the fit with the covariance of the bound.
    :param posterior_fit: the fit with the covariance of the posterior, which is narrower and decides on backlash.
    """
    half_widths = dict(zip(posterior_fit.structure.parameters, posterior_fit.ci95.tolist(), strict=True))
    for parameter, value in fit.parameter_values.items():
        if isinstance(parameter, JointCompliance):
            compliance, _ = parameter.file_value(fit.parameter_values)  # fading parts included
            if compliance <= 0.0:
                yield f"{parameter.joint} has no compliance of its own: springs of the links take its place"
        if isinstance(parameter, Backlash) and value > max(_MIN_BACKLASH, half_widths[parameter]):
            yield f"looks like {value * MM_PER_M:.3f} mrad of backlash or friction in {parameter.joint}"


def _unidentified_notes(choice: Choice) -> list[str]:
    """Return one sentence on the parameters that the readings do not narrow, by kind; empty without such parameters."""
    names_by_kind: dict[str, list[str]] = {}
    for parameter in choice.held_by_prior:
        kind = next((name for of_kind, name in _KIND_NAMES if isinstance(parameter, of_kind)), "other parameters")
        names_by_kind.setdefault(kind, []).append(parameter.name)
    if not names_by_kind:
        return []
    parts = [f"{kind} {first_of(names, _MAX_NAMES)}" for kind, names in names_by_kind.items()]
    return [
        "not identified, held by a prior of physical size, which counts in the bound: "
        f"{'; '.join(parts)} (all of them: held_by_prior in identification.json)"
    ]
