"""From measurements to an identified robot: the steps in their order, and the fallback of each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import robot as robots
from postproc.frames import MM_PER_M, Array
from postproc.identification import plausibility
from postproc.identification.choice import CLEAR_GAIN, Choice, choose, evidence_of
from postproc.identification.fit import Fit, to_file_units
from postproc.identification.joint_springs import (
    Levels,
    SpringOfJoint2,
    UnobservableParameter,
    compensator_from_levels,
    extended_set,
    fit_joints,
    fit_serial,
    fit_with_prior_values,
    unloaded_joints,
    unobservable_parameters,
)
from postproc.identification.measurement_model import (
    Placement,
    as_positions,
    locate,
    measured_displacements,
    visible_points,
)
from postproc.identification.moved_device import moved_device
from postproc.identification.plausibility import check_loads, displacement_ratio, hysteresis_warnings
from postproc.identification.readings import Measurements, gaps
from postproc.identification.return_error import CLEAR_SCATTER, noise_scatter
from postproc.identification.stated_levels import doubt_of_levels
from postproc.identification.stated_loads import doubt_of_loads
from postproc.identification.stated_points import displaced_points
from postproc.identification.uncertainty import (
    Discrepancy,
    Judgement,
    Workspace,
    add_stated_errors,
    bound_over_workspace,
    discrepancy,
    judge,
    left_out_residuals,
)
from postproc.robot import (
    CompensatorPreload,
    CompensatorSize,
    CompensatorStiffness,
    RobotModel,
)

Method = Literal["enhanced", "serial"]
Depth = Literal["auto", "joints"]
_MOST_OUTLIERS = 0.03
"""Share of the readings that may be left out (assumed): more are no slips, but an error of the model or the set-up."""
_MOST_GROSS_ERRORS = 3
"""Gross errors against a choice of springs that are left out at most (assumed): each needs a new choice."""
_SIGNIFICANT_SIGMAS = 3.29
"""Standard deviations of χ² beyond which joint springs alone do not explain the readings (one in a thousand)."""
_POSSIBLE_SIGMAS = 1.0
"""Standard deviations of χ² from which richer structures are compared with joint springs, by evidence."""


_HIDDEN_SHARE = 0.06
"""Share of the displacements (RMS) that springs of links add at least; the paper's joint springs leave 9 %."""
_VISIBLE_SIGMAS = 10.0
"""Standard deviations of χ² by which link springs of this share must show, or noise hides them."""


class Identification(Struct, frozen=True, eq=False):
    """Identified parameters with the readings used, their placement and their uncertainty.

    :param method: enhanced or serial.
    :param prior: robot with the geometry, masses and compensator geometry that were used; parameters that the readings
        do not determine keep its values.
    :param data: the readings used; gross errors are left out.
    :param placement: base transform and reference points.
    :param fit: the parameters written into the model.
    :param levels: equivalent compliance of joint 2 per level of q2 (enhanced).
    :param spring: K⁰_θ2, K_c, s₀·K_c from three levels or more by Eq. (9), (10) (enhanced); else None.
    :param missing: parameters that the readings do not determine.
    :param choice: structures tried; None: joint springs suffice.
    :param discrepancy: unmodelled error on configurations left out.
    :param workspace: bound over deflection in the workspace.
    :param judgement: whether the model may be used.
    :param left_out: a line for each reading that was left out.
    :param warnings: for the user.
    """

    method: Method
    prior: RobotModel
    data: Measurements
    placement: Placement
    fit: Fit
    levels: Levels | None
    spring: SpringOfJoint2 | None
    missing: tuple[UnobservableParameter, ...]
    choice: Choice | None
    discrepancy: Discrepancy
    workspace: Workspace
    judgement: Judgement
    left_out: tuple[str, ...]
    warnings: tuple[str, ...]

    def robot(self) -> RobotModel:
        """Return the identified robot (without the covariance, which the model file holds)."""
        return self.fit.robot


def identify(
    prior: RobotModel,
    data: Measurements,
    method: Method = "enhanced",
    depth: Depth = "auto",
    progress: Callable[[str], None] = lambda _: None,
) -> Identification:
    """Identify the compliances of a robot.

    :param prior: the robot as shipped, with the compensator geometry to be used.
    :param method: "enhanced": joint springs and compensator by the paper, see `joint_springs`; "serial": joint springs
        of a strict serial chain.
    :param depth: "auto" also tries link springs and gears that are not linear, and takes them if the evidence is for
        them, or if noise would hide them; "joints" does not.
    :param progress: called with a line of text before each step.
    :raises MeasurementError: the readings are unusable; the message names the row or says what to measure.
    """
    checked_readings = check_readings(prior, data)
    if method == "serial":
        return _serial_identification(prior, checked_readings)
    progress("joint springs and compensator")
    joints, data, placement, names = _fit_joints_and_placement(prior, checked_readings.data, checked_readings.placement)
    springs = _Springs(
        fit=joints.fit,
        choice=None,
        data=data,
        placement=placement,
        unobservable_entries=joints.missing,
        outliers=checked_readings.outliers + names,
    )
    if depth == "auto" and (_would_hide_link_springs(joints.fit) or _has_possible_error(joints.fit)):
        progress(f"{_joint_residual_text(joints.fit)}: trying link springs and gears that are not linear")
        springs = _richer_springs(prior, springs)
    warnings = checked_readings.warnings
    if depth == "joints" and _has_unexplained_error(joints.fit):
        warnings = [*warnings, _joint_residual_text(joints.fit)]
        ratio = joints.fit.chi2 / joints.fit.dof  # the unexplained error widens the intervals
        springs = springs._replace(fit=replace(joints.fit, covariance=joints.fit.covariance * ratio))
    return _enhanced_identification(prior, joints, springs, warnings, checked_readings.doubt)


class _Springs(NamedTuple):
    """Springs that were fitted, and the readings that they were fitted to.

    :param fit: of the springs.
    :param choice: structures tried; None: the fit is that of joint springs.
    :param data: readings without gross errors, and their `placement`.
    :param unobservable_entries: parameters that the readings do not determine.
    :param outliers: a line for each reading that was left out.
    """

    fit: Fit
    choice: Choice | None
    data: Measurements
    placement: Placement
    unobservable_entries: list[UnobservableParameter]
    outliers: list[str]


def _richer_springs(prior: RobotModel, joint_springs: _Springs) -> _Springs:
    """Return the mean of structures in place of joint springs, if joint springs do not suffice; else the joint springs.

    Joint springs do not suffice if they leave an unexplained error, if noise would hide other springs, or if the
    evidence for other springs is clear.
    """
    fit, _, data, placement, unobservable_entries, outliers = joint_springs
    data, choice, names = _choose_springs(prior, data, placement)
    is_insufficient = _has_unexplained_error(fit) or _would_hide_link_springs(fit)
    if not is_insufficient and not _has_clear_evidence(choice, fit, data, placement):
        return joint_springs
    if not prior.subtract_reference:  # a weightless geometry: the pose without load depends on the springs
        placement = locate(choice.fit.robot, data)
    unobservable_entries = _undetermined_springs(choice, data, unobservable_entries)
    return _Springs(choice.fit, choice, data, placement, unobservable_entries, outliers + names)


def _enhanced_identification(
    prior: RobotModel, joints: _Joints, springs: _Springs, warnings: list[str], doubt: str
) -> Identification:
    """Return the identification by the enhanced method: the springs with their uncertainty and the verdict.

    :param joints: fit of joint springs alone.
    :param springs: springs of the model.
    :param warnings: warnings of the earlier steps.
    :param doubt: clause on axes and point of the loads; may be empty.
    """
    choice, data, placement, outliers = springs.choice, springs.data, springs.placement, springs.outliers
    fit = fit_with_prior_values(springs.fit, springs.unobservable_entries) if choice is None else springs.fit
    model_error = discrepancy(
        data, placement, fit, left_out_residuals(fit, data) if choice is None else choice.left_out
    )
    fit = fit if choice is None else replace(fit, covariance=choice.bound_covariance)
    fit = add_stated_errors(fit, data, placement, None if choice is None else choice.influence)
    workspace = bound_over_workspace(_robot_with_bound(fit, model_error), data)
    judgement = judge(data, fit, choice, workspace, displacement_ratio(prior, data, placement))
    judgement = judgement.with_reservation(displaced_points(data, placement)).with_reservation(doubt)
    if choice is not None:
        judgement = judgement.with_reservation(doubt_of_levels(choice.fit, data, placement))
    return Identification(
        method="enhanced",
        prior=prior,
        data=data,
        placement=placement,
        fit=fit,
        levels=joints.levels,
        spring=joints.spring,
        missing=tuple(springs.unobservable_entries),
        choice=choice,
        discrepancy=model_error,
        workspace=workspace,
        judgement=judgement,
        left_out=tuple(outliers),
        warnings=(
            *warnings,
            *_spring_warnings(springs.unobservable_entries, outliers),
            *judgement.notes,
            *hysteresis_warnings(prior, data, placement),
        ),
    )


def _spring_warnings(unobservable_entries: list[UnobservableParameter], outliers: list[str]) -> list[str]:
    """Return a warning for each parameter that is not observable, and for each reading that was left out."""
    return [str(entry) for entry in unobservable_entries] + [f"outlier: {name}" for name in outliers]


_CHECK_ANGLES = " Check [angles] too: sign, offset_deg and A3_per_J2."
"""Displacements show wrong angles only by their directions; positions are compared with the geometry of the arm."""


class CheckedReadings(Struct, frozen=True, eq=False):
    """Readings that may be fitted.

    :param data: without gross errors, and with their noise.
    :param placement: base transform and reference points.
    :param outliers: a line for each reading that was left out.
    :param warnings: for the user.
    :param doubt: clause on axes and point of the loads, a reservation of the model; may be empty.
    """

    data: Measurements
    placement: Placement
    outliers: list[str]
    warnings: list[str]
    doubt: str


def check_readings(prior: RobotModel, data: Measurements) -> CheckedReadings:
    """Check the readings before any spring is fitted; gross errors are left out.

    :raises MeasurementError: the readings are unusable.
    """
    advice = _CHECK_ANGLES if data.are_displacements else ""
    data, placement, outliers = plausibility.check_placement(prior, as_positions(prior, data))
    warnings = [*gaps(data), *moved_device(prior, data, placement)]
    doubt = doubt_of_loads(prior, data, placement)
    warnings += check_loads(prior, data, placement, advice)
    data, notes = _readings_with_checked_noise(data)
    return CheckedReadings(data, placement, outliers, warnings + notes, doubt)


class _JointsAndPlacement(NamedTuple):
    """Joint springs, and the readings that they were fitted to.

    :param joints: the fit.
    :param data: readings without gross errors, and their `placement`.
    :param outliers: names of the readings that are left out.
    """

    joints: _Joints
    data: Measurements
    placement: Placement
    outliers: list[str]


def _fit_joints_and_placement(prior: RobotModel, data: Measurements, placement: Placement) -> _JointsAndPlacement:
    """Fit joint springs and compensator, and the placement again if the robot sags by its springs without load.

    Gross errors are left out if joint springs then explain all other readings.
    """
    joints = _fit_of_joints(prior, data, placement)
    if not prior.subtract_reference:  # a weightless geometry: the pose without load depends on the springs
        placement = locate(joints.fit.robot, data)
        joints = _fit_of_joints(prior, data, placement)
    if _has_unexplained_error(joints.fit):
        clean_data, clean_fit, names = _remove_outliers(prior, data, placement, joints.fit)
        if names and not _has_unexplained_error(clean_fit):
            placement = locate(prior if prior.subtract_reference else clean_fit.robot, clean_data)
            return _JointsAndPlacement(_fit_of_joints(prior, clean_data, placement), clean_data, placement, names)
    return _JointsAndPlacement(joints, data, placement, [])


def _joint_residual_text(fit: Fit) -> str:
    """Return a text on the residual that joint springs and compensator leave unexplained."""
    return (
        f"joint springs and compensator leave {fit.rms * MM_PER_M:.3f} mm RMS, {fit.chi2 / fit.dof:.1f} times the "
        "noise variance"
    )


def _robot_with_bound(fit: Fit, model_error: Discrepancy) -> RobotModel:
    """Return the identified robot with the covariance of its parameters and the unmodelled error, for its bound."""
    file_values = to_file_units(fit)
    covariance = robots.Covariance(file_values.parameters, file_values.covariance)
    unmodelled = robots.Discrepancy(model_error.load, model_error.u95)
    return replace(fit.robot, covariance=covariance, discrepancy=unmodelled)


def _has_clear_evidence(richer: Choice, fit: Fit, data: Measurements, placement: Placement) -> bool:
    """Return whether the log evidence for a richer structure exceeds that of a fit by `CLEAR_GAIN`."""
    return richer.evidence > evidence_of(fit.structure, fit.values, data, placement) + CLEAR_GAIN


class _ChosenSprings(NamedTuple):
    """A choice of springs, the readings without gross errors that it was fitted to, and a line for each gross error."""

    data: Measurements
    choice: Choice
    outliers: list[str]


def _choose_springs(prior: RobotModel, data: Measurements, placement: Placement) -> _ChosenSprings:
    """Choose the springs, leave out the worst gross error against them, and choose again.

    At most `_MOST_GROSS_ERRORS` are left out.
    """
    choice = choose(prior, data, placement)
    outliers: list[str] = []
    for _ in range(_MOST_GROSS_ERRORS):
        clean_data, names = plausibility.remove_worst_residual(data, placement, choice.fit)
        if not names:
            break
        data, outliers = clean_data, outliers + names
        choice = choose(prior, data, placement)
    return _ChosenSprings(data, choice, outliers)


def _undetermined_springs(
    choice: Choice, data: Measurements, unobservable_entries: list[UnobservableParameter]
) -> list[UnobservableParameter]:
    """Return entries of the springs that the mean of structures does not determine.

    These are springs of unloaded joints, and K_c or s₀ of a compensator with the prior's stiffness.

    :param unobservable_entries: entries of the fit of joint springs alone, which have the reasons for unloaded joints.
    """
    fit, entry_by_parameter = choice.fit, {entry.parameter: entry for entry in unobservable_entries}
    joints = [
        entry_by_parameter.get(joint)
        or UnobservableParameter(joint, "the loads put no torque on it", f"Load {joint.joint} more.")
        for joint in unloaded_joints(fit.structure.prior, data)
    ]
    if fit.structure.prior.compensator is None or CompensatorStiffness() in fit.parameter_values:
        return joints
    advice = "Take it from the drawing of the compensator."
    if CompensatorSize() in fit.parameter_values:
        reason = "the torque on the gears at rest shows how strong it is, which is attributed to K_c"
        return [*joints, UnobservableParameter(CompensatorPreload(), reason, advice)]
    reason = "next to link springs its effect on joint 2 is too small"
    return [*joints, UnobservableParameter(CompensatorStiffness(), reason, advice)]


class _Joints(Struct, frozen=True, eq=False):
    """Joint springs and compensator.

    :param levels: equivalent compliance of joint 2 at each level of q2; None: too few readings.
    :param spring: gear and compensator of joint 2 from the levels; None: no compensator, or too few levels.
    :param missing: parameters that the readings do not determine.
    """

    fit: Fit
    levels: Levels | None
    spring: SpringOfJoint2 | None
    missing: list[UnobservableParameter]


def _fit_of_joints(prior: RobotModel, data: Measurements, placement: Placement) -> _Joints:
    """Fit joint springs and compensator; start values are from the levels of q2 if these are enough, else the prior's.

    :raises MeasurementError: there are fewer readings than unknowns, or they determine none of the compliances.
    """
    by_level = extended_set(prior, data, placement)
    levels = None if by_level is None else by_level.levels
    spring = None
    if levels is not None and prior.compensator is not None:
        spring = compensator_from_levels(levels, prior.compensator)
    fit, unobservable_entries = fit_joints(prior, data, placement, spring)
    return _Joints(fit, levels, spring, unobservable_entries)


def _serial_identification(prior: RobotModel, checked: CheckedReadings) -> Identification:
    """Return the identification by the serial method: springs of joints alone, linear in the load.

    :param checked: the readings, with outliers and warnings of their checks.
    :raises MeasurementError: the readings give no full poses, or too few.
    """
    data, placement, outliers = checked.data, checked.placement, checked.outliers
    fit = fit_serial(prior, data, placement)
    unobservable_entries = unobservable_parameters(fit, data, covariance_has_misfit=True)
    fit = fit_with_prior_values(fit, unobservable_entries)
    model_error = discrepancy(data, placement, fit, fit.residual)
    fit = add_stated_errors(fit, data, placement, None)
    workspace = bound_over_workspace(_robot_with_bound(fit, model_error), data)
    judgement = judge(data, fit, None, workspace, displacement_ratio(prior, data, placement))
    judgement = judgement.with_reservation(displaced_points(data, placement)).with_reservation(checked.doubt)
    return Identification(
        method="serial",
        prior=prior,
        data=data,
        placement=placement,
        fit=fit,
        levels=None,
        spring=None,
        missing=tuple(unobservable_entries),
        choice=None,
        discrepancy=model_error,
        workspace=workspace,
        judgement=judgement,
        left_out=tuple(outliers),
        warnings=(*checked.warnings, *_spring_warnings(unobservable_entries, outliers), *judgement.notes),
    )


def _readings_with_checked_noise(data: Measurements) -> tuple[Measurements, list[str]]:
    """Return the readings, with the scatter of the repeats as noise if it clearly exceeds the stated noise; and notes.

    A note says that the scatter is used, or that the stated noise is clearly larger than the scatter and is kept.
    """
    squares, dof = noise_scatter(data)
    if dof < CLEAR_SCATTER:
        return data, []
    scatter = float(np.sqrt(squares / dof))
    # a scatter has a relative standard deviation of 1/√(2 dof): four of these are clear
    if scatter > data.sigma * (1.0 + 4.0 / np.sqrt(2.0 * dof)):
        note = (
            f"sigma_mm = {data.sigma * MM_PER_M:g} is stated; the repeats scatter by {scatter * MM_PER_M:.3f} mm: used"
        )
        return replace(data, sigma=scatter), [note]
    if scatter < data.sigma * (0.8 - 4.0 / np.sqrt(2.0 * dof)):  # a fifth less is not worth a note (assumed)
        return data, [
            f"sigma_mm = {data.sigma * MM_PER_M:g} is stated, the repeats scatter by {scatter * MM_PER_M:.3f} mm only; "
            "the stated noise is kept (repeats share what the set-up adds)"
        ]
    return data, []


def _has_unexplained_error(fit: Fit) -> bool:
    """Return whether χ² of a fit is above the value that noise exceeds once in a thousand.

    That value is close to dof + 3.29·√(2 dof) + 7; the constant counts for few degrees of freedom. False without
    degrees of freedom.
    """
    return fit.dof > 0 and fit.chi2 > fit.dof + _SIGNIFICANT_SIGMAS * np.sqrt(2.0 * fit.dof) + 7.0


def _has_possible_error(fit: Fit) -> bool:
    """Return whether χ² of a fit exceeds its mean for noise by `_POSSIBLE_SIGMAS`: other structures may fit better."""
    return bool(fit.chi2 > fit.dof + _POSSIBLE_SIGMAS * np.sqrt(2.0 * max(fit.dof, 0)))


def _would_hide_link_springs(fit: Fit) -> bool:
    """Return whether noise would hide the springs of links, so that a good fit of joint springs does not exclude them.

    Link springs with the smallest share of the displacements, `_HIDDEN_SHARE`, would add less to χ² than
    `_VISIBLE_SIGMAS` standard deviations of χ².
    """
    visible_chi2 = _HIDDEN_SHARE**2 * float(fit.target @ fit.target)
    return bool(visible_chi2 < _VISIBLE_SIGMAS * np.sqrt(2.0 * max(fit.dof, 0)))


class _CleanFit(NamedTuple):
    """A fit of joint springs, the readings without gross errors that it is of, and a line for each gross error."""

    data: Measurements
    fit: Fit
    outliers: list[str]


def _remove_outliers(prior: RobotModel, data: Measurements, placement: Placement, fit: Fit) -> _CleanFit:
    """Leave out gross errors against the joint springs one at a time, until the springs explain the other readings.

    At most the share `_MOST_OUTLIERS` of the readings is left out; none if even this share cannot explain the misfit.
    """
    names: list[str] = []
    limit = max(1, int(_MOST_OUTLIERS * len(data.state)))
    # a reading without load counts in the displacements of all loads of its configuration
    if not _can_outliers_explain(fit, limit * (len(data.loaded_states) // len(data.q))):
        return _CleanFit(data, fit, names)
    for _ in range(limit):
        clean_data, new_names = plausibility.remove_worst_residual(data, placement, fit)
        if not new_names:
            break
        data, names = clean_data, names + new_names
        fit = _fit_of_joints(prior, data, placement).fit
        if not _has_unexplained_error(fit):
            break
    return _CleanFit(data, fit, names)


def _can_outliers_explain(fit: Fit, limit: int) -> bool:
    """Return whether only noise remains in a linearised fit without the points with the largest residuals.

    This is quick, and few robots with more than joint springs pass it.

    :param limit: largest number of points, each in one loaded state, that are left out.
    """
    # 1e-300 keeps zero out of the denominator
    design, target = fit.design / np.maximum(np.linalg.norm(fit.design, axis=0), 1e-300), fit.target.copy()
    for count in range(1, limit + 1):  # rcond: directions that are rounding alone
        residual = (target - design @ np.linalg.lstsq(design, target, rcond=1e-9)[0]).reshape(-1, 3)
        worst = int(np.argmax(np.sum(residual**2, axis=1)))
        outlier_rows = slice(3 * worst, 3 * worst + 3)  # three coordinates of a point
        design[outlier_rows], target[outlier_rows] = 0.0, 0.0
        residual = target - design @ np.linalg.lstsq(design, target, rcond=1e-9)[0]
        if not _has_unexplained_error(replace(fit, chi2=float(residual @ residual), dof=fit.dof - 3 * count)):
            return True
    return False


def rms_distances(result: Identification) -> tuple[Array, Array]:
    """Return the RMS of measured displacements (C,) and of residuals (C,) of the points of each configuration [m].

    Points without a reading do not count; 0 for a configuration in which no point has readings with and without load.
    """
    config = result.data.state_config[result.data.loaded_states]
    visible_count = visible_points(result.data).sum(axis=(1, 2))
    count = np.bincount(config, weights=visible_count, minlength=len(result.data.q))

    def rms(vectors: Array) -> Array:
        """Return the RMS length (C,) of vectors (L, P, 3) of loaded states, 0 for points without a reading."""
        square = np.bincount(config, weights=np.sum(vectors**2, axis=(1, 2)), minlength=len(count))
        return np.asarray(np.sqrt(square / np.maximum(count, 1.0)))

    return rms(measured_displacements(result.data, result.placement)), rms(result.fit.residual)
