"""The model that a test part gives: `model.toml`, `identification.json`, `material.toml`, and what changed."""

from __future__ import annotations

from typing import Any, Literal

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import files
from postproc.files import FileEntry
from postproc.frames import MM_PER_M, Array
from postproc.identification.fit import NORMAL_95
from postproc.identification.record import CrossValidation, Parameter, Record, Verdict
from postproc.machining import Process
from postproc.machining.material import CuttingLaw, IdentifiedTable
from postproc.machining.material import law as cutting_law
from postproc.robot import FORCES, Discrepancy, JointCompliance, file_slopes
from postproc.robot.model_file import (
    CovarianceTable,
    DiscrepancyEntry,
    ForcesEntry,
    MeasuredEntry,
    ModelFile,
)
from postproc.testpart.features import Placement
from postproc.testpart.fit import HELD_SHARE, MOST_LIFT_SHARE, Fit
from postproc.testpart.prior import MIN_SHARE, Prior
from postproc.testpart.readings import Lift, Top

_DRIFT_SIGMAS = 3.0
"""Change of a parameter that is named, in standard deviations (assumed)."""
_DRIFT_PROBABILITY = 0.005
"""Probability of the deviations if nothing has changed, below which they are a drift (assumed)."""
_MOST_UNMODELLED_SHARE = 0.25
"""Unmodelled error, as a share of the deflection, beyond which the model should not be used (assumed)."""
_PLAUSIBLE_SIGMAS = 4.0
"""Distance of a parameter from its prior, in prior standard deviations, that is not plausible (assumed)."""
_LEAST_CORRELATION = 0.01
"""Correlation with any other parameter below which one that the part does not determine stays out of [covariance]
(assumed)."""
_DOUBTFUL_SIGMAS = 3.0
"""Distance of the scale of the forces from 1, in its standard deviations, that is worth a warning (assumed)."""
_STATED_LIFT = 1e-4
"""Lift of a program over the block that is worth a warning [m] (assumed)."""
_MOST_TILT = 3e-3
"""Tilt of a program against the uncut top [rad]. Assumed: more is a wrong touch-off point, or a wrong `$BASE`."""
_VAGUE_TILT = 10e-3
"""Half width of the 95 % interval of the tilt [rad] beyond which it is not determined (assumed): over 100 mm of part
the depth of cut would be unknown by a millimetre."""
_VAGUE_LIFT_SHARE = 0.25
"""Half width of the 95 % interval of the lift, as a share of the flattest cut, beyond which its depth is not known
(assumed)."""
_FEWEST_CHECKABLE = 4
"""Fewest touch-off points that can contradict each other."""
_OBSERVABLE_SHARE = 0.9
"""The scale of the forces is observable if its standard deviation falls below this share of the prior one (assumed)."""
_CHI2_SIGMAS = 3.29
"""Standard deviations of χ² beyond which the readings do not agree with a model."""


class ProbedPoint(Struct, frozen=True):
    """A probed point: deviation as measured and as predicted, in mm, with the position of the part found."""

    feature: str
    measured_mm: float
    before_mm: float
    after_mm: float
    error_mm: float
    sigma_mm: float


class TouchOffError(Struct, frozen=True):
    """How high a program ran over the uncut top of the block, by the touch-off points.

    :param frame: of the placement, as a table of the cell.
    :param lift_mm: in the middle of the features, positive where the program ran too high; `ci95` of it.
    :param tilt_mm_per_m: of the program against the top.
    :param points: the touch-off points.
    """

    frame: str
    lift_mm: float
    ci95: float
    tilt_mm_per_m: float
    points: list[str]


class Change(Struct, frozen=True):
    """Change of a parameter since the model was identified: value now over value then, at the same forces.

    `sigmas`: change in its standard deviations.
    """

    name: str
    factor: float
    sigmas: float


class Agreement(Struct, frozen=True):
    """How the model before agrees with the part: χ² of the readings, and the parameters that have changed.

    `chance`: of deviations that look as much like a change of one parameter, or of all, if the robot is the same.
    `fault`: of the part, because of which nothing is decided; empty if there is none.
    """

    holds: bool
    fault: str
    line: str
    chi2: float
    points: int
    chance: float
    drifted: list[Change]
    warnings: list[str]


class PartIdentification(Record, frozen=True, kw_only=True, omit_defaults=True):
    """Content of `identification.json` of a model from a test part.

    `force_scale`: measured forces over those computed. `agreement`: of the model before, where it is compared.
    `left_mm`: RMS of what the model leaves of the deviations; `without_mm`: of what the model before leaves;
    `deviation_mm`: of the deviations themselves.
    """

    verdict: Verdict
    method: Literal["part"] = "part"
    robot: str
    parameters: dict[str, Parameter]
    force_scale: Parameter
    sigma_mm: float
    left_mm: float
    without_mm: float
    deviation_mm: float
    unmodelled_percent: float
    discrepancy: list[CrossValidation]
    touch_off: list[TouchOffError]
    agreement: Agreement | None = None
    points: list[ProbedPoint]
    held_by_prior: list[str]
    outliers: list[str]
    warnings: list[str]
    files: list[FileEntry] | None = None


def file_values(fit: Fit) -> tuple[Array, Array]:
    """Return the fitted parameters in units of model.toml (p,), and their covariance (p + 1, p + 1) with the scale.

    The last row and column of the covariance are for the relative error of the scale of the forces.
    """
    prior, robot = fit.prior, fit.robot
    robot_values = {parameter: robot.value(parameter) for parameter in prior.order}
    values = np.array([parameter.file_value(robot_values)[0] for parameter in prior.parameters])
    rows = [prior.order.index(parameter) for parameter in prior.parameters]
    slopes = np.zeros_like(fit.covariance)
    slopes[:-1, :-1] = (file_slopes(prior.order, robot_values) @ prior.by_file)[rows]
    slopes[-1, -1] = 1.0 / fit.scale
    return values, slopes @ fit.covariance @ slopes.T


def agreement(fit: Fit, prior: Prior, outliers: tuple[str, ...] = ()) -> Agreement:
    """Return how a model agrees with a test part that was cut with the robot and then probed.

    :param fit: fit of the part with `prior.widen()`, wider by changes of the robot, so that the readings decide.
    :param prior: the model with its own covariance. The last entry of its `sigma`, and of the change from it, is the
        scale of the forces.
    :param outliers: names of points left out of the fit.
    """
    fault = _part_fault(fit, outliers)
    count, comparison = len(fit.readings.probed), fit.compare_with_prior(prior)
    # quantile of χ² by its mean, its spread, and 7 ≈ 2/3 (3.29² − 1) for its skewness (Cornish and Fisher)
    largest_chi2 = count + _CHI2_SIGMAS * float(np.sqrt(2.0 * count)) + 7.0
    is_changed = comparison.no_change_probability < _DRIFT_PROBABILITY
    factor = np.maximum(1.0 + comparison.change[:-1] / prior.values, MIN_SHARE)
    changes = [
        Change(
            name=parameter.name,
            factor=round(float(factor[k]), 3),
            sigmas=round(float(comparison.change[k] / comparison.spread[k]), 1),
        )
        for k, parameter in enumerate(prior.parameters)
        if is_changed and abs(comparison.change[k]) > _DRIFT_SIGMAS * comparison.spread[k] > 0.0
    ]
    line = f"χ² {comparison.chi2:.0f} of {count} points (at most {largest_chi2:.0f})"
    if is_changed:
        names = ", ".join(f"{change.name} × {change.factor:.2f}" for change in changes)
        line += f"; the arm deflects otherwise under these forces: {names or 'no single joint'}"
    warnings = []
    is_scale_certain = prior.sigma[-1] == 0.0
    if not prior.has_forces_of_model and not is_scale_certain:
        warnings.append(
            "the model was not identified with these forces, so a change of all compliances by one factor is hardly "
            "seen: give the process with the material.toml of the model"
        )
    return Agreement(
        holds=comparison.chi2 <= largest_chi2 and not is_changed and not fault,
        fault=fault,
        line=line,
        chi2=round(comparison.chi2, 2),
        points=count,
        chance=round(comparison.no_change_probability, 4),
        drifted=changes,
        warnings=warnings,
    )


def summary(fit: Fit, outliers: tuple[str, ...]) -> PartIdentification:
    """Return the content of `identification.json`: parameters, points, errors and the verdict on the model.

    :param outliers: names of points left out of the fit.
    """
    readings, prior = fit.readings, fit.prior
    parameters, held_names = _parameters(fit)
    scale = Parameter(
        value=float(fit.scale),
        ci95=float(NORMAL_95 * np.sqrt(fit.covariance[-1, -1])),
        unit="1",
        observable=bool(fit.sigma[-1] < _OBSERVABLE_SHARE),
        prior=1.0,
    )
    load, u95 = fit.u95()
    deviation = readings.probed.deviation
    return PartIdentification(
        verdict=_verdict(fit, outliers),
        robot=prior.robot.name,
        parameters=parameters,
        force_scale=scale,
        sigma_mm=readings.sigma * MM_PER_M,
        left_mm=_rms_mm(fit.prediction - deviation),
        without_mm=_rms_mm(fit.prior_prediction - deviation),
        deviation_mm=_rms_mm(deviation),
        unmodelled_percent=round(100.0 * fit.gamma, 2),
        discrepancy=[
            CrossValidation(
                load_N=float(level),
                held_out_mm=_rms_mm(fit.error),
                noise_mm=readings.sigma * MM_PER_M,
                own_mm=_rms_mm(fit.spread),
                u95_mm=float(bound) * MM_PER_M,
            )
            for level, bound in zip(load, u95, strict=True)
        ],
        touch_off=_touch_off_errors(fit),
        points=_probed_points(fit),
        held_by_prior=held_names,
        outliers=list(outliers),
        warnings=_remarks(fit, held_names, outliers),
    )


def _probed_points(fit: Fit) -> list[ProbedPoint]:
    """Return the points with their measured and predicted deviations from the touched-off top, in mm."""
    readings = fit.readings
    columns = (
        readings.probed.deviation + readings.datum,
        fit.prior_prediction + readings.datum,
        fit.prediction + readings.datum,
        fit.error,
        fit.spread,
    )
    return [
        ProbedPoint(name, *(round(float(value) * MM_PER_M, 5) for value in row))
        for name, *row in zip(readings.probed.name, *columns, strict=True)
    ]


def _parameters(fit: Fit) -> tuple[dict[str, Parameter], list[str]]:
    """Return name → parameter with its 95 % interval, in units of model.toml; and the names that keep their prior."""
    values, covariance = file_values(fit)
    half_width = NORMAL_95 * np.sqrt(np.diag(covariance))[:-1]
    parameters, held_names = {}, []
    for k, (parameter, prior_value) in enumerate(zip(fit.prior.parameters, fit.prior.values.tolist(), strict=True)):
        is_held = not fit.free[k]
        if is_held:
            held_names.append(parameter.name)
        parameters[parameter.name] = Parameter(
            value=float(prior_value if is_held else values[k]),
            ci95=float(half_width[k]),
            unit=parameter.unit,
            observable=not is_held,
            prior=float(prior_value),
            source="prior" if is_held else None,
        )
    return parameters, held_names


def _touch_off_errors(fit: Fit) -> list[TouchOffError]:
    """Return the touch-off error of each placement in which something was cut."""
    errors = []
    for top, lift in _cut_tops(fit):
        frame = Placement.of_base(top.base).title
        height, half_width = float(lift.coefficients[0]), NORMAL_95 * float(np.sqrt(lift.covariance[0, 0]))
        tilt = float(np.linalg.norm(lift.coefficients[1:]))
        errors.append(
            TouchOffError(
                frame=frame,
                lift_mm=round(height * MM_PER_M, 4),
                ci95=round(half_width * MM_PER_M, 4),
                tilt_mm_per_m=round(tilt * MM_PER_M, 3),
                points=list(top.points),
            )
        )
    return errors


def _cut_tops(fit: Fit) -> list[tuple[Top, Lift]]:
    """Return the top and the lift of each placement in which something was cut."""
    lift_by_base = {lift.base: lift for lift in fit.lifts}
    return [(top, lift_by_base[top.base]) for top in fit.readings.tops]


def _touch_off_fault(fit: Fit) -> str:
    """Return why the depth of cut is unknown or too far from the programmed one; empty if it is known and near."""
    depth = fit.readings.least_depth
    for (top, lift), error in zip(_cut_tops(fit), _touch_off_errors(fit), strict=True):
        points = fit.readings.probed.point[fit.readings.probed.base == top.base]
        if top.is_contradictory:
            return (
                f"the touch-off points {', '.join(top.points)} are on no plane: probe them again, or leave the wrong "
                "deviation_mm empty"
            )
        # 2 for 1.96: half width of the 95 % interval
        half_tilt = 2.0 * float(np.sqrt(np.trace(lift.covariance[1:, 1:])))
        if half_tilt > _VAGUE_TILT:
            return _vague_tilt_fault(fit, top, half_tilt)
        if np.abs(lift.heights(points)).max() > MOST_LIFT_SHARE * depth:
            return (
                f"the program ran {_lift_text(error.lift_mm)} over the block at {error.frame}, more than half of the "
                f"flattest cut ({depth * MM_PER_M:g} mm): touch off again, and cut and probe a new part"
            )
        if np.hypot(*lift.coefficients[1:]) > _MOST_TILT + half_tilt:
            return (
                f"the program is tilted by {error.tilt_mm_per_m:.1f} mm/m against the uncut top at {error.frame}: "
                "probe the touch-off points again; if they agree, measure $BASE anew and cut a new part"
            )
        if error.ci95 > _VAGUE_LIFT_SHARE * depth * MM_PER_M:
            return (
                f"the depth of the cuts at {error.frame} is known to ± {error.ci95:.2g} mm only: probe the floors "
                "(floor, ref_floor) of the features too"
            )
    return ""


def _vague_tilt_fault(fit: Fit, top: Top, half_tilt: float) -> str:
    """Return the message that the features of a placement determine the tilt of the program too poorly.

    The tilt is that of the program against the top of the block.

    :param half_tilt: half width of the 95 % interval of the tilt [rad].
    """
    probe_data = fit.readings.probed
    # readings of a gauge under a weight are no cuts
    rows = np.flatnonzero((probe_data.base == top.base) & ~probe_data.is_gauge)
    count = len({probe_data.name[row].partition(".")[0] for row in rows})  # a name is such as T01.wall
    frame = Placement.of_base(top.base).title
    features = "one feature is too few" if count == 1 else f"{count} features so close together are too few"
    return (
        f"{features} at {frame}: how the program is tilted against the uncut top is known to "
        f"± {half_tilt * MM_PER_M:.2g} mm/m only; probe more features, far from each other"
    )


def _lift_text(lift_mm: float) -> str:
    """Return a lift in words: "0.12 mm too high", or low."""
    return f"{abs(lift_mm):.2f} mm too {'high' if lift_mm > 0.0 else 'low'}"


def _rms_mm(values: Array) -> float:
    """Return the root mean square of lengths (n,) [m] in mm, rounded."""
    return round(float(np.sqrt(np.mean(np.square(values)))) * MM_PER_M, 5)


def _part_fault(fit: Fit, outliers: tuple[str, ...]) -> str:
    """Return a clause on readings of the part that contradict each other, with a remedy; empty if none do."""
    if fault := _touch_off_fault(fit):
        return fault
    if fit.exchanged_pair is not None:
        first, second = fit.exchanged_pair
        return f"{first} and {second} look exchanged: exchange their rows of deviation_mm, or probe both again"
    if outliers:
        verb = "contradicts" if len(outliers) == 1 else "contradict"
        return f"{', '.join(outliers)} {verb} the other points: probe again, or leave deviation_mm empty there"
    return ""


def _verdict(fit: Fit, outliers: tuple[str, ...]) -> Verdict:
    """Return the verdict whether the fitted model may be used; if not, with the first reason against it."""
    size = len(fit.prior.parameters)
    sigma = fit.prior.sigma
    shift = np.abs(fit.z) / np.where(sigma > 0.0, sigma, np.inf)[:-1]
    reason = ""
    if fault := _part_fault(fit, outliers):
        reason = fault
    elif fit.gamma > _MOST_UNMODELLED_SHARE:
        reason = f"{100 * fit.gamma:.0f} % of the deflection are not described by the model: check part and program"
    elif shift.max() > _PLAUSIBLE_SIGMAS:
        name = fit.prior.parameters[int(np.argmax(shift))].name
        reason = f"{name} would be {shift.max():.1f} standard deviations from its prior: check material and process"
    elif abs(fit.scale - 1.0) > _PLAUSIBLE_SIGMAS * sigma[-1] > 0.0:
        reason = f"forces would be {fit.scale:.2f} times those computed: check material, feed and depth"
    elif not fit.free[:size].any() and fit.sigma[-1] > HELD_SHARE:
        reason = "the part determines neither a parameter of the robot nor the forces"
    if reason:
        return Verdict(refused=True, line=f"NOT TO BE TRUSTED: {reason}")
    return Verdict(refused=False, line="the model may be used, within its bound")


def _remarks(fit: Fit, held_names: list[str], outliers: tuple[str, ...]) -> list[str]:
    """Return remarks for the user on undetermined parameters, outliers, touch-off, and the scale of the forces.

    :param held_names: names of parameters that keep their prior.
    :param outliers: names of points left out of the fit.
    """
    remarks = []
    if held_names:
        remarks.append(f"the part does not determine {', '.join(held_names)}: they keep their prior")
    remarks += [f"outlier: {name}" for name in outliers]
    for error in _touch_off_errors(fit):
        if abs(error.lift_mm) > max(_STATED_LIFT * MM_PER_M, error.ci95):
            remarks.append(
                f"the program ran {_lift_text(error.lift_mm)} over the block at {error.frame} (± {error.ci95:.2f} mm): "
                "the forces are computed for the depths that were cut"
            )
        if len(error.points) < _FEWEST_CHECKABLE:
            remarks.append(
                f"three touch-off points at {error.frame} cannot be checked against each other: probe a fourth"
            )
    if abs(fit.scale - 1.0) > _DOUBTFUL_SIGMAS * fit.prior.sigma[-1] > 0.0:
        remarks.append(
            f"forces would be {fit.scale:.2f} times those computed, more than three standard deviations "
            f"({300.0 * fit.prior.sigma[-1]:.0f} %) off: check material, tool, feed and depth"
        )
    covariance = fit.covariance
    sigma = np.sqrt(np.diag(covariance))
    size = len(fit.prior.parameters)
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.nan_to_num(covariance[-1, :size] / (sigma[-1] * sigma[:size]))
    # the deflection is compliance times force: both are known by their product only (limit assumed)
    correlated_names = [fit.prior.parameters[k].name for k in range(size) if fit.free[k] and correlation[k] < -0.6]
    if correlated_names:
        remarks.append(
            f"{', '.join(correlated_names)} and the scale of the forces are known by their product only (scale ± "
            f"{100 * NORMAL_95 * sigma[-1]:.0f} %): use material.toml together with this model"
        )
    return remarks


def model_file(fit: Fit, prior: ModelFile, process: Process, source: str) -> ModelFile:
    """Return the content of `model.toml`: identified values with intervals, prior values of undetermined parameters.

    Its covariance contains the scale of the forces, for robots under forces by the `material.toml` of this part.

    :param prior: the model file before the part.
    :param process: the process with which the part was cut.
    :param source: origin of the values, for the file.
    """
    values, covariance = file_values(fit)
    half_width = NORMAL_95 * np.sqrt(np.diag(covariance))[:-1]
    deviation = np.sqrt(np.diag(covariance))
    # the diagonal always counts: more than one entry is a correlation with another parameter
    is_correlated = (np.abs(covariance) > _LEAST_CORRELATION * np.outer(deviation, deviation)).sum(axis=0) > 1
    content = _with_values(msgspec.to_builtins(prior), fit, values, half_width, source)
    stated_rows = [
        k  # of the others value and spread stay as they are in the file
        for k, parameter in enumerate(fit.prior.parameters)
        if fit.free[k] or parameter not in fit.prior.robot.stated_spread or is_correlated[k]
    ]
    names = [fit.prior.parameters[k].name for k in stated_rows]
    forces = _forces_entry(fit, process, source)
    if forces is not None:
        names.append(FORCES)
        stated_rows.append(len(fit.prior.parameters))
    load, u95 = _discrepancy(fit)
    measured_range = fit.prior.robot.measured
    torque = fit.torque if measured_range is None else np.maximum(fit.torque, measured_range.torque)
    extra = {
        "covariance": CovarianceTable.of(names, covariance[np.ix_(stated_rows, stated_rows)]),
        "forces": forces,
        "discrepancy": DiscrepancyEntry(source=source, load_N=load.tolist(), u95_mm=(u95 * MM_PER_M).tolist()),
        "measured": MeasuredEntry(
            source=source,
            configurations=len(set(fit.readings.probed.group.tolist()))
            + (0 if prior.measured is None else prior.measured.configurations),
            torque_Nm=tuple(torque.tolist()),
            not_trusted="",
        ),
    }
    return msgspec.structs.replace(msgspec.convert(content, ModelFile), **extra)


def _with_values(content: dict[str, Any], fit: Fit, values: Array, half_width: Array, source: str) -> dict[str, Any]:
    """Return the tables of `model.toml` with the identified values in place of the prior's.

    Parameters that the part does not determine keep their entries.

    :param content: the tables of the prior as plain data; they are changed in place.
    :param values: (p,) parameters in the units of the file, and `half_width` (p,) of their 95 % intervals.
    :param source: origin of the values.
    """
    identified = [
        (parameter, float(values[k]), float(half_width[k]))
        for k, parameter in enumerate(fit.prior.parameters)
        if fit.free[k]
    ]
    tables: dict[str, Any] = {"joints": {}, "links": {}, "compensator": {}, "masses": {}}
    for parameter, value, interval in identified:
        parameter.write(tables, value, interval, source)
    for table, entries in tables.items():
        if not entries:
            continue
        if table in ("compensator", "masses"):
            prior_table = content.get(table) or {"source": source}
            content[table] = prior_table | entries
        else:
            for name, entry in entries.items():
                content[table][name] = content[table].get(name, {}) | entry
    for parameter, *_ in identified:
        if isinstance(parameter, JointCompliance):
            content["joints"][parameter.joint] |= {"sigma_percent": None, "assumed": False}
    return content


def _discrepancy(fit: Fit) -> tuple[Array, Array]:
    """Return levels of load (m,) [N], and the 95 % bound (m,) of the unmodelled error at each level [m].

    The bound is the larger of that of the part and that of the prior model, if it states one.
    """
    load, u95 = fit.u95()
    prior_discrepancy = fit.prior.robot.discrepancy
    if prior_discrepancy is None:
        return load, u95
    all_loads = np.union1d(load, prior_discrepancy.load)
    wrench = np.pad(all_loads[:, None], ((0, 0), (0, 5)))  # only the size of the force counts
    return all_loads, np.maximum(Discrepancy(load, u95).at(wrench), prior_discrepancy.at(wrench))


def _forces_entry(fit: Fit, process: Process, source: str) -> ForcesEntry | None:
    """Return the cutting law with scaled forces for `model.toml`; None for a certain scale or an unknown axial force.

    The numbers are rounded as those that are read from `material.toml`: both files are recognised as one law.
    """
    # Ktc, Krc, Kac, Kte, Kre, Kae, mc, σ [%]; empty if the axial force is unknown
    numbers = cutting_law(_scaled_law(fit, process, source), process.path).numbers
    if not numbers or not numbers[-1] > 0.0:  # no axial force, or σ 0: a certain scale
        return None
    return ForcesEntry(
        source=source,
        cutting_N_per_mm2=(numbers[0], numbers[1], numbers[2]),
        edge_N_per_mm=(numbers[3], numbers[4], numbers[5]),
        mc=numbers[6],
        sigma_percent=numbers[7],
    )


def material(fit: Fit, process: Process, source: str) -> bytes:
    """Return the content of `material.toml`: the cutting law of the process with its forces scaled as fitted."""
    comment = "Written by `postproc identify part`; process.toml takes it by [material] file."
    return files.toml({"material": _scaled_law(fit, process, source)}, comment)


def _scaled_law(fit: Fit, process: Process, source: str) -> IdentifiedTable:
    """Return the cutting law with its forces multiplied by the fitted scale, as [material] of a process file."""
    law: CuttingLaw = process.law()
    # the file has N/mm² and N/mm
    tangential, radial, axial, *edge = (fit.scale * value for value in (*law.cutting, *law.edge))
    table = IdentifiedTable(
        sigma_percent=round(100.0 * float(np.sqrt(fit.covariance[-1, -1])) / fit.scale, 3),
        source=f"{law.name}, forces scaled by {fit.scale:.3f}: {source}",
        Kte_N_per_mm=edge[0] / 1e3,
        Kre_N_per_mm=edge[1] / 1e3,
        Kae_N_per_mm=edge[2] / 1e3,
    )
    if law.exponent:
        return replace(
            table,
            kc11_N_per_mm2=tangential / 1e6,
            mc=law.exponent,
            radial_ratio=law.cutting[1] / law.cutting[0],
            axial_ratio=law.cutting[2] / law.cutting[0],
        )
    return replace(table, Ktc_N_per_mm2=tangential / 1e6, Krc_N_per_mm2=radial / 1e6, Kac_N_per_mm2=axial / 1e6)
