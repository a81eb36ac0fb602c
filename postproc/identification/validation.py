"""Validation of a model by readings that it was not identified from: predicted against measured displacements.

The share of displacements inside the bound is estimated from a limited number of configurations. Its limits are those
of Clopper and Pearson (Biometrika 26, 1934) for the number of independent displacements that the scatter between
configurations implies (Korn and Graubard, Survey Methodology 24, 1998): an error of a configuration shows at all its
points. Each level of loads decides alone, with its own count: the bound is kept there if nearly all displacements are
inside and the lower limit, of 95 % confidence, is above a half. A model does not hold if the upper limit of a level is
below the promised share, with 95 % confidence for all levels together (Bonferroni). Otherwise more configurations are
needed.

The verdict is valid for the torques that the loads put on the joints (`Coverage`): on each joint the range in each
direction. Gears with lost motion, friction or breakpoints deflect differently if a torque changes its sign or leaves
that range. So it is valid for a job only as far as the torques of its cutting forces are inside. Torques are those of
the load alone, without weights and compensator.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc import elastostatics
from postproc import robot as robots
from postproc.decimals import without_negative_zero
from postproc.errors import MeasurementError
from postproc.frames import MM_PER_M, Array, norm
from postproc.identification import plausibility, record
from postproc.identification.fit import LENGTH_95
from postproc.identification.measurement_model import (
    Placement,
    as_positions,
    joint_torques,
    measured_displacements,
    visible_points,
)
from postproc.identification.readings import Measurements, read, read_experiment
from postproc.identification.stated_points import displaced_points
from postproc.identification.uncertainty import displacement_noise, levels
from postproc.program import Bools, Ints
from postproc.robot import JOINTS, RobotModel

_BOUND_SHARE = 0.95
"""Share that a 95 % bound promises."""
_MIN_SHARE, _MIN_LOWER_LIMIT = 0.9, 0.5
"""A bound is kept if this share of the displacements is inside, and the lower limit of the share exceeds the second
(assumed)."""
_DOUBT_CHANCE = 0.05
"""Chance that noise alone refutes a bound: of all levels together, or of all joints and senses."""
_NARROW_RATIO = 2.0
"""Up to this ratio of errors to bound, the bound is merely too narrow (assumed)."""
_STANDARD_ERRORS = 2.0
"""Standard errors by which the residual must exceed the noise for a factor; else its lower limit is stated."""
_SAME_ANGLE_TOLERANCE = 1e-4
"""Largest difference [rad] between the angles of one pose (assumed)."""
_SAME_LOAD_TOLERANCE = 0.01
"""Largest relative difference between equal loads (assumed)."""
SIGNS = ("negative", "positive")
LEAST_TORQUE = 1.0
"""Smallest torque [N·m] that counts as having a sign (assumed)."""
MIN_CONFIGURATIONS = 5
"""Configurations needed to cover one sign of torque. If all of them are inside the bound, the share inside is above one
half, with 95 % confidence."""


class ValidatedLevel(Struct, frozen=True, eq=False):
    """Displacements against a model at one level of loads.

    :param load: force [N] and moment [N·m] in one, median.
    :param measured: RMS of the displacements measured [m].
    :param prediction_error: RMS of their prediction errors [m].
    :param noise: RMS of the noise of the readings in the prediction errors [m].
    :param standard_error: of the mean square prediction error, over the loaded states [m²].
    :param inside: share of the displacements whose error is inside bound and noise; NaN without a bound.
    :param limits: lower and upper limit of this share for all displacements of the robot.
    :param error_ratio: 95 % quantile of error over bound and noise; NaN without a bound.
    :param bound: RMS of the bound [m].
    :param configurations: number of configurations with such a load.
    """

    load: float
    measured: float
    prediction_error: float
    noise: float
    standard_error: float
    inside: float
    limits: tuple[float, float]
    error_ratio: float
    bound: float
    configurations: int

    @property
    def is_refuted(self) -> bool:
        """Whether significantly fewer displacements are inside than promised."""
        return self.limits[1] < _BOUND_SHARE

    @property
    def keeps_bound(self) -> bool:
        """Whether enough displacements are inside the bound."""
        return not self.is_refuted and self.inside >= _MIN_SHARE and self.limits[0] >= _MIN_LOWER_LIMIT

    @property
    def exceeds_noise(self) -> bool:
        """Whether the prediction errors exceed the noise; else only a lower limit of the factor is known."""
        return self.prediction_error**2 - self.noise**2 > _STANDARD_ERRORS * self.standard_error

    @property
    def factor(self) -> float:
        """RMS of displacement over prediction error without noise; a lower limit if noise hides the error."""
        square_excess = self.prediction_error**2 - self.noise**2
        if not self.exceeds_noise:
            square_excess = max(square_excess, 0.0) + _STANDARD_ERRORS * self.standard_error
        return float(self.measured / np.sqrt(square_excess)) if square_excess > 0.0 else float("inf")


class Validation(Struct, frozen=True, eq=False):
    """A model against readings.

    :param levels: by load, ascending.
    :param covered: torques that the loads put on the joints.
    :param identified: torques that the model was identified with; empty if the model does not record them.
    :param warnings: gross errors of the readings, and states left out.
    :param jobs: share of each program that is covered; empty if no job was given.
    """

    levels: tuple[ValidatedLevel, ...]
    covered: Coverage
    identified: tuple[record.TorqueRange, ...]
    warnings: tuple[str, ...]
    jobs: tuple[JobShare, ...] = ()

    @property
    def keeps_bound(self) -> bool:
        """Whether the bound was kept at every level."""
        return all(level.keeps_bound for level in self.levels)

    @property
    def holds(self) -> bool:
        """Whether the bound was kept at every level, and the readings cover nearly all of each job."""
        return self.keeps_bound and all(job.share >= _BOUND_SHARE for job in self.jobs)

    @property
    def line(self) -> str:
        """The verdict in one line, with the share of the job that it is valid for."""
        if any(np.isnan(level.inside) for level in self.levels):
            return "the model states no bound: nothing can be validated"
        refuted_levels = [level for level in self.levels if level.is_refuted]
        undecided = [level for level in self.levels if not level.keeps_bound]
        worst = min(refuted_levels or undecided or self.levels, key=lambda level: level.inside)
        low, high = worst.limits
        share = (
            f"at {worst.load:.0f} N {worst.inside:.0%} of the displacements of {worst.configurations} configurations "
            f"are inside its bound, so the share of all is {low:.0%} to {high:.0%}"
        )
        if self.keeps_bound:
            return self._validity_text(share)
        if not refuted_levels:
            return (
                f"IT IS NOT KNOWN whether the model holds: {share}; {_BOUND_SHARE:.0%} are promised. The readings "
                "do not contradict it: measure more configurations."
            )
        widest = max(level.error_ratio for level in refuted_levels)
        if widest < _NARROW_RATIO:
            advice = (
                f"The bound is too narrow: use {widest:.1f} times u95, and identify the robot anew from these and "
                "the earlier readings together."
            )
        else:
            advice = (
                f"The errors reach {widest:.1f} times the bound: the robot does something that the model does not "
                "contain, or it is another robot, payload or load."
            )
        return f"THE MODEL DOES NOT HOLD: {share}; {_BOUND_SHARE:.0%} are promised. {advice}"

    def _validity_text(self, share: str) -> str:
        """Return a sentence on the programs for which the model holds; without jobs, on the torques.

        :param share: clause on the share of displacements inside the bound.
        """
        if not self.jobs:
            return f"the model holds for the torques listed below: {share}"
        parts = [f"{_percent(job.share)} of the cutting path of {job.program}" for job in self.jobs if job.share > 0.0]
        uncovered_programs = [job.program for job in self.jobs if job.share < _BOUND_SHARE]
        measure = (
            f" Measure under the torques that {', '.join(uncovered_programs)} needs, listed below."
            if uncovered_programs
            else ""
        )
        if not parts:
            names = ", ".join(uncovered_programs)
            return f"IT IS NOT KNOWN whether the model holds for {names}: the readings cover none of it.{measure}"
        return f"the model holds for {', '.join(parts)}: {share}.{measure}"


def _percent(share: float) -> str:
    """Return a share in per cent, rounded down, so that 100 % means all."""
    return f"{math.floor(100.0 * share + 1e-9)}%"  # 1e-9: a whole number of per cent may be off by rounding


def validate(model: Path, measurements: Path, experiment: Path) -> Validation:
    """Compare a model folder with readings of the same robot that it was not identified from.

    :param model: folder, or the name of a shipped robot.
    :param experiment: path of `experiment.toml`.
    :raises MeasurementError: the files are unusable, or the model was identified from all loaded states.
    """
    setup = read_experiment(experiment)
    folder = robots.find(str(model))
    robot = robots.load(folder)
    data, placement, outliers = plausibility.check_placement(robot, as_positions(robot, read(measurements, setup)))
    warnings = [f"outlier: {name}" for name in outliers]
    warnings += filter(None, [displaced_points(data, placement)])
    model_data = record.measured_states(folder)
    is_new_state = ~_is_known_state(data, model_data.as_array())
    if not is_new_state.any():
        raise MeasurementError(
            f"the model was identified from these states ({len(is_new_state)} of configuration and load): that it "
            "agrees with them says nothing",
            file=str(measurements),
            advice="Measure some configurations more, and validate with them.",
        )
    if not is_new_state.all():
        warnings.append(
            f"{np.count_nonzero(~is_new_state)} of {len(is_new_state)} loaded states are the model's own: left out"
        )
    comparison = _compare_displacements(robot, data, placement, is_new_state)
    return Validation(
        tuple(_validated_levels(comparison)),
        _checked_coverage(joint_torques(robot, data), comparison),
        tuple(model_data.torques),
        tuple(warnings),
    )


def _is_known_state(data: Measurements, states: Array) -> Bools:
    """Return True for loaded states (L,) of the readings whose configuration and load equal one of some states.

    :param states: (m, 12) joint angles [rad], then force [N] and moment [N·m] at the load point, root axes.
    """
    state_q, state_wrench = np.split(states, [6], axis=1)
    is_known = np.zeros(len(data.loaded_states), dtype=bool)
    for row, state in enumerate(data.loaded_states):
        q, wrench = data.q[data.state_config[state]], data.wrench[state]
        is_same_pose = np.abs(state_q - q).max(axis=1) < _SAME_ANGLE_TOLERANCE
        is_same_load = norm(state_wrench - wrench) < _SAME_LOAD_TOLERANCE * norm(wrench)
        is_known[row] = (is_same_pose & is_same_load).any()
    return is_known


class _Displacements(Struct, frozen=True, eq=False):
    """Displacements of L loaded states at P points.

    :param is_compared: (L, P) whether the displacement counts in the comparison.
    :param config: (L,) index of the configuration, and `load` (L,) force and moment in one [N, N·m].
    :param displacement: (L, P) length of the measured displacement [m].
    :param prediction_error: (L, P) distance from the predicted displacement [m], and its `bound` (L, P) [m].
    :param noise: (L, P) mean square length of the noise [m²].
    :param error_ratio: (L, P) prediction error over bound and noise.
    :param has_bound: whether the model states a bound.
    """

    is_compared: Bools
    config: Ints
    load: Array
    displacement: Array
    prediction_error: Array
    bound: Array
    noise: Array
    error_ratio: Array
    has_bound: bool


def _compare_displacements(
    robot: RobotModel, data: Measurements, placement: Placement, is_new_state: Bools
) -> _Displacements:
    """Return measured displacements, with the error of their prediction by a robot and its bound.

    :param is_new_state: (L,) whether the model was not identified from the loaded state. Only visible points of such
        states are compared.
    """
    displacement = measured_displacements(data, placement)
    prediction, bound = _prediction(robot, data, placement)
    prediction_error, noise = norm(displacement - prediction), displacement_noise(data)
    return _Displacements(
        is_compared=(visible_points(data)[..., 0] > 0.0) & is_new_state[:, None],
        config=data.state_config[data.loaded_states],
        load=norm(data.wrench[data.loaded_states]),
        displacement=norm(displacement),
        prediction_error=prediction_error,
        bound=bound,
        noise=noise,
        # 95 % bound of the error with noise: the bound of the model and the 95 % quantile of the noise
        error_ratio=prediction_error / np.sqrt(bound**2 + LENGTH_95**2 * noise),
        has_bound=robot.covariance is not None,
    )


def _validated_levels(comparison: _Displacements) -> list[ValidatedLevel]:
    """Return the comparison at each level of loads with compared points, from the smallest load on."""
    level = levels(comparison.load)
    count = int(level.max()) + 1
    # a refutation at any level counts, so each level gets a part of the doubt (Bonferroni)
    is_compared_at = ((level == index)[:, None] & comparison.is_compared for index in range(count))
    return [_validated_level(comparison, rows, _DOUBT_CHANCE / count) for rows in is_compared_at if rows.any()]


def _validated_level(comparison: _Displacements, rows: Bools, upper_doubt: float) -> ValidatedLevel:
    """Return the comparison of the displacements of one level.

    Without a bound of the model, the share inside is NaN with the limits 0 and 1.

    :param rows: (L, P) True for displacements of the level; at least one is True.
    :param upper_doubt: probability with which the share inside the bound is above its upper limit.
    """
    has_bound, ratio = comparison.has_bound, comparison.error_ratio[rows]
    lower = _inside_limits(comparison, rows, _DOUBT_CHANCE)[0] if has_bound else 0.0
    upper = _inside_limits(comparison, rows, upper_doubt)[1] if has_bound else 1.0
    states = np.flatnonzero(rows.any(axis=1))
    squares = [np.mean(comparison.prediction_error[state, rows[state]] ** 2) for state in states]
    return ValidatedLevel(
        load=float(np.median(comparison.load[states])),
        measured=_rms(comparison.displacement[rows]),
        prediction_error=_rms(comparison.prediction_error[rows]),
        noise=_rms(np.sqrt(comparison.noise[rows])),
        standard_error=float(np.std(squares, ddof=1) / np.sqrt(len(squares))) if len(squares) > 1 else np.inf,
        inside=float(np.mean(ratio <= 1.0)) if has_bound else float("nan"),
        limits=(lower, upper),
        error_ratio=float(np.quantile(ratio, _BOUND_SHARE)) if has_bound else float("nan"),
        bound=_rms(comparison.bound[rows]),
        configurations=len(np.unique(comparison.config[states])),
    )


def _checked_coverage(torque: Array, comparison: _Displacements) -> Coverage:
    """Return the covered torques, with the joints and signs of torque whose readings contradict the bound.

    :param torque: (L, 6) of the loads on the joints [N·m].
    """
    states = comparison.is_compared.any(axis=1)
    is_refuted = np.zeros((6, 2), dtype=bool)
    if comparison.has_bound:
        for joint, side in np.ndindex(6, 2):
            rows = (split_signs(torque)[:, joint, side] > LEAST_TORQUE)[:, None] & comparison.is_compared
            is_refuted[joint, side] = (
                rows.any() and _inside_limits(comparison, rows, _DOUBT_CHANCE / is_refuted.size)[1] < _BOUND_SHARE
            )
    return coverage(torque[states], comparison.config[states], is_refuted)


def _inside_limits(comparison: _Displacements, rows: Bools, doubt: float) -> tuple[float, float]:
    """Return the lower and upper limit of the share of displacements inside the bound, see `share_limits`.

    :param rows: (L, P) True for displacements that count.
    :param doubt: probability with which the share is below the lower limit, and above the upper one.
    """
    return share_limits(*_counts_by_configuration(comparison.error_ratio <= 1.0, rows, comparison.config), doubt)


def _counts_by_configuration(is_inside: Bools, rows: Bools, config: Ints) -> tuple[Array, Array]:
    """Return the numbers of displacements inside the bound (C,), and of all displacements that count (C,).

    C configurations have displacements that count.

    :param is_inside: (L, P) whether the displacement is inside the bound.
    :param rows: (L, P) True for displacements that count.
    :param config: (L,) index of the configuration of each loaded state.
    """
    total, inside_count = (np.bincount(config, weights=mask.sum(axis=1)) for mask in (rows, is_inside & rows))
    return np.asarray(inside_count[total > 0.0], dtype=float), np.asarray(total[total > 0.0], dtype=float)


def share_limits(inside_counts: Array, counts: Array, doubt: float) -> tuple[float, float]:
    """Return the lower and upper limit of the share of all displacements that is inside, from some configurations.

    Displacements of one configuration are alike, so they count as fewer independent displacements: as many as have the
    scatter between the configurations. A single configuration has no scatter: the limits are 0 and 1. Source: Korn and
    Graubard, Survey Methodology 24, 1998, with the limits of Clopper and Pearson, Biometrika 26, 1934.

    :param inside_counts: (C,) numbers of displacements inside, of `counts` (C,) displacements in each configuration.
    :param doubt: probability with which the share is below the lower limit, and above the upper one.
    """
    from scipy.special import betaincinv, stdtrit  # takes long to import

    configs, count = len(counts), float(counts.sum())
    share = float(inside_counts.sum()) / count
    if configs < 2:
        return 0.0, 1.0
    scatter = configs / (configs - 1.0) * float(np.sum((inside_counts - share * counts) ** 2)) / count**2
    number = float(configs)  # of independent displacements; without scatter each configuration is one
    if scatter > 0.0:
        # the scatter of few configurations is uncertain: by quantiles of Student's t (Korn and Graubard 1998)
        reduction = (stdtrit(count - 1.0, doubt) / stdtrit(configs - 1.0, doubt)) ** 2
        number = min(count, reduction * share * (1.0 - share) / scatter)
    inside_number, outside_number = share * number, (1.0 - share) * number
    low = betaincinv(inside_number, outside_number + 1.0, doubt) if inside_number > 0.0 else 0.0
    high = betaincinv(inside_number + 1.0, outside_number, 1.0 - doubt) if outside_number > 0.0 else 1.0
    return float(low), float(high)


def _rms(values: Array) -> float:
    """Return the root mean square of all values."""
    return float(np.sqrt(np.mean(values**2)))


def _prediction(robot: RobotModel, data: Measurements, placement: Placement) -> tuple[Array, Array]:
    """Return predicted displacements (L, P, 3) of the points by the loads, root axes, and their bounds (L, P) [m].

    The bounds are zero if the robot states none.

    :raises NotConvergedError: the springs have no equilibrium under a load.
    """
    q, wrench = data.q[data.state_config[data.loaded_states]], data.wrench[data.loaded_states]
    load_frame = np.eye(4)
    load_frame[:3, 3] = data.load_point
    pose = elastostatics.deflect(robot, q, load_frame, wrench).pose
    unloaded_pose = elastostatics.deflect(robot, q, load_frame, np.zeros_like(wrench)).pose
    displacement, bound = np.empty((len(q), len(data.points), 3)), np.zeros((len(q), len(data.points)))
    for index, point in enumerate(placement.points):
        lever = np.append(point - data.load_point, 1.0)  # homogeneous: displacements of the load point count too
        displacement[:, index] = ((pose - unloaded_pose) @ lever)[:, :3]
        tool = np.eye(4)
        tool[:3, 3] = point
        point_wrench = wrench.copy()  # the same load, referred to the point
        point_wrench[:, 3:] -= np.cross(unloaded_pose[:, :3, :3] @ lever[:3], wrench[:, :3])
        point_bound = elastostatics.position_bound(robot, q, tool, point_wrench)
        if point_bound is not None:  # the robot states a covariance
            bound[:, index] = point_bound
    return displacement, bound


COMMON_LOAD_ERROR = (
    "not seen by this: an error that all loads share, if they were measured as those of the identification were"
)


def table(result: Validation) -> str:
    """Return the verdict, the comparison by levels as a table, torques and jobs, for a terminal."""
    lines = [
        result.line,
        f"{'load N':>8}{'measured mm':>13}{'left mm':>9}{'noise mm':>10}{'bound mm':>10}{'factor':>8}"
        f"{'inside':>8}{'of all':>14}",
    ]
    for level in result.levels:
        lengths = "".join(
            f"{value * MM_PER_M:{width}.3f}"
            for value, width in (
                (level.measured, 13),
                (level.prediction_error, 9),
                (level.noise, 10),
                (level.bound, 10),
            )
        )
        inside_text, range_text = "–", "–"
        if not np.isnan(level.inside):
            inside_text, range_text = f"{level.inside:.0%}", "{:.0%} to {:.0%}".format(*level.limits)
        factor = f"{'' if level.exceeds_noise else '> '}{level.factor:.3g}"
        lines.append(f"{level.load:8.0f}{lengths}{factor:>8}{inside_text:>8}{range_text:>14}")
    lines += [*torque_lines(result.covered, result.identified), *job_lines(result.jobs), COMMON_LOAD_ERROR]
    return "\n".join(lines)


class Coverage(Struct, frozen=True, eq=False):
    """Torques that the readings covered, by joint and sign (column 0 negative, 1 positive).

    :param largest: (6, 2) largest torque of the sign, as a positive number [N·m]; 0 without one.
    :param configurations: (6, 2) number of configurations with a torque of the sign.
    :param refuted: (6, 2) whether the readings with torques of the sign contradict the model.
    :param least: relative size of the smallest loads that enough configurations have: the largest ratio of a torque
        to `largest`; infinite without configurations.
    """

    largest: Array
    configurations: Array
    refuted: Bools
    least: float

    @property
    def is_covered(self) -> Bools:
        """Whether (6, 2) a sign of torque has enough configurations, and none that contradict the model."""
        return np.asarray((self.configurations >= MIN_CONFIGURATIONS) & ~self.refuted)


class UncoveredShare(Struct, frozen=True):
    """A reason why a share of a job is not covered. Shares of several reasons may overlap."""

    reason: str
    share: float


class JobShare(Struct, frozen=True):
    """Share of a program's cutting path whose torques are covered, and the reasons for uncovered shares."""

    program: str
    share: float
    outside: tuple[UncoveredShare, ...]


def coverage(torque: Array, config: Ints, is_refuted: Bools | None = None) -> Coverage:
    """Return the torques that loaded states cover.

    :param torque: (L, 6) joint torques of each loaded state [N·m].
    :param config: (L,) configuration of each loaded state.
    :param is_refuted: (6, 2) whether the readings with torques of a joint and sign contradict the bound; None: they do
        not.
    """
    sides = split_signs(torque)
    has_torque = sides > LEAST_TORQUE  # (L, 6, 2) of a joint and sign
    largest = np.where(has_torque.any(axis=0), sides.max(axis=0, initial=0.0), 0.0)
    configs, config_row = np.unique(config, return_inverse=True)
    config_has_torque = np.zeros((len(configs), 6, 2), dtype=bool)
    np.logical_or.at(config_has_torque, config_row, has_torque)
    smallest_level = np.full(len(configs), np.inf)  # of the loads of each configuration
    np.minimum.at(smallest_level, config_row, _relative_torque(sides, largest))
    # relative size down to which enough configurations were measured, or all if they are fewer
    config_count = min(MIN_CONFIGURATIONS, len(configs))
    return Coverage(
        largest=largest,
        configurations=config_has_torque.sum(axis=0),
        refuted=np.zeros((6, 2), dtype=bool) if is_refuted is None else is_refuted,
        least=float(np.sort(smallest_level)[config_count - 1]) if config_count else np.inf,
    )


def coverage_of(robot: RobotModel, data: Measurements) -> Coverage:
    """Return the torques that readings cover."""
    return coverage(joint_torques(robot, data), data.state_config[data.loaded_states])


def split_signs(torque: Array) -> Array:
    """Return torques (N, 6) as (N, 6, 2): size of the negative and of the positive part [N·m]."""
    return np.stack([np.maximum(-torque, 0.0), np.maximum(torque, 0.0)], axis=-1)


def is_inside_coverage(torque: Array, torque_range: Coverage) -> Bools:
    """Return (T,) whether torques (T, 6) [N·m] are covered on all joints, and not all below those of small loads."""
    faults = _coverage_faults(torque, torque_range)
    return np.asarray(~((faults.lacks_sign | faults.exceeds_range).any(axis=(1, 2)) | faults.is_small))


def job_share(program: str, torque: Array, weight: Array, torque_range: Coverage) -> JobShare:
    """Return the covered share of a program, with reasons for uncovered shares, the largest first.

    :param program: name, for the user.
    :param torque: (T, 6) joint torques of the cutting forces at places along its cutting moves [N·m].
    :param weight: (T,) share of the cutting path at each place, sum 1.
    """
    faults = _coverage_faults(torque, torque_range)
    entries = [UncoveredShare("all torques below those of the smallest loads", float(weight @ faults.is_small))]
    for joint, side in np.ndindex(6, 2):
        subject = f"{SIGNS[side]} torque on {JOINTS[joint]}"
        count = int(torque_range.configurations[joint, side])
        if torque_range.refuted[joint, side]:
            sign_text = f"{subject}: there the readings contradict the model"
        elif count:
            sign_text = f"{subject}: {count} of {MIN_CONFIGURATIONS} configurations needed have it"
        else:
            sign_text = f"{subject}: no reading has it"
        size_text = f"{subject} beyond {torque_range.largest[joint, side]:.0f} N·m"
        entries += [
            UncoveredShare(sign_text, float(weight @ faults.lacks_sign[:, joint, side])),
            UncoveredShare(size_text, float(weight @ faults.exceeds_range[:, joint, side])),
        ]
    reasons = sorted((reason for reason in entries if reason.share > 0.0), key=lambda entry: -entry.share)
    return JobShare(program, float(weight @ is_inside_coverage(torque, torque_range)), tuple(reasons))


class _Faults(NamedTuple):
    """Reasons that torques at T places are not covered, by joint and sign (column 0 negative, 1 positive).

    :param lacks_sign: (T, 6, 2) whether a torque has a sign that the readings do not cover.
    :param exceeds_range: (T, 6, 2) whether a torque is beyond the largest covered torque of its sign.
    :param is_small: (T,) whether all torques of the place are below those of the smallest loads.
    """

    lacks_sign: Bools
    exceeds_range: Bools
    is_small: Bools


def _coverage_faults(torque: Array, torque_range: Coverage) -> _Faults:
    """Return the reasons that torques (T, 6) [N·m] are not covered."""
    sides, is_covered = split_signs(torque), torque_range.is_covered
    has_torque = sides > LEAST_TORQUE
    return _Faults(
        lacks_sign=has_torque & ~is_covered,
        exceeds_range=has_torque & is_covered & (sides > torque_range.largest),
        is_small=_relative_torque(sides, torque_range.largest) < torque_range.least,
    )


def _relative_torque(sides: Array, largest: Array) -> Array:
    """Return the relative size (N,) of torques: the largest ratio of a torque to the largest covered torque.

    :param sides: (N, 6, 2) torques by sign, as positive numbers [N·m].
    :param largest: (6, 2) largest covered torque of each joint and sign [N·m].
    """
    ratio = np.divide(sides, largest, out=np.zeros_like(sides), where=largest > 0.0)
    return np.asarray(ratio.max(axis=(1, 2)))


def torque_record(torque_range: Coverage) -> list[record.TorqueRange]:
    """Return the covered torques for `identification.json`, one entry a joint; negative torques have their sign."""
    # columns: 0 negative, 1 positive
    return [
        record.TorqueRange(name, without_negative_zero(float(-sides[0])), float(sides[1]), int(count[0]), int(count[1]))
        for name, sides, count in zip(JOINTS, torque_range.largest, torque_range.configurations, strict=True)
    ]


def torque_lines(torque_range: Coverage, model_ranges: Sequence[record.TorqueRange]) -> list[str]:
    """Return a table for the terminal: covered torques by joint and sign, next to torques of the identification.

    :param model_ranges: torques that the model was identified with; empty if the model does not record them.
    """
    lines = [
        "torques that the loads put on the joints, N·m; in brackets: configurations, "
        f"{MIN_CONFIGURATIONS} cover a direction"
    ]
    head = f"{'':>4}{'negative':>16}{'positive':>16}"
    lines.append(head + (f"{'identified with':>24}" if model_ranges else ""))
    for joint, name in enumerate(JOINTS):
        cells = [_torque_cell(torque_range, joint, side) for side in (0, 1)]
        row = f"{name:>4}{cells[0]:>16}{cells[1]:>16}"
        if model_ranges:
            model_range = model_ranges[joint]
            row += f"{f'{model_range.negative_Nm:.0f} … {model_range.positive_Nm:.0f}':>24}"
        lines.append(row)
    if not model_ranges:
        lines.append("the model does not record which torques it was identified with")
    open_sides = [
        f"{name} {' and '.join(sign for sign, is_covered in zip(SIGNS, sides, strict=True) if not is_covered)}"
        for name, sides in zip(JOINTS, torque_range.is_covered, strict=True)
        if not sides.all()
    ]
    if open_sides:
        lines.append(f"not covered: torques on {', '.join(open_sides)}")
    return lines


def _torque_cell(torque_range: Coverage, joint: int, side: int) -> str:
    """Return a cell of the table of torques: largest torque with its sign, and number of configurations in brackets.

    It ends with "off" if readings with these torques contradict the model. It is "none" without configurations.

    :param joint: 0…5, and `side` 0 for negative torques, 1 for positive torques.
    """
    count = int(torque_range.configurations[joint, side])
    if count == 0:
        return "none"
    largest = torque_range.largest[joint, side] if side else -torque_range.largest[joint, side]
    suffix = " off" if torque_range.refuted[joint, side] else ""
    return f"{largest:.0f} ({count}){suffix}"


def job_lines(jobs: Sequence[JobShare]) -> list[str]:
    """Return lines for the terminal: covered share of each program, and the reasons for uncovered shares."""
    lines = []
    for job in jobs:
        lines.append(f"{job.program}: {job.share:.0%} of the cutting path is inside these torques")
        lines += [f"  outside {entry.share:.0%}: {entry.reason}" for entry in job.outside]
    return lines
