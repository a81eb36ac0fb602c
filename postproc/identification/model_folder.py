"""The identified robot as a model folder: robot.urdf, model.toml, identification.json, report.html.

`identify_folder` and `geometry_folder` go from measured files to the folder.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import files
from postproc import robot as robots
from postproc.compensator import Compensator
from postproc.errors import InputError, MeasurementError, ModelError
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm
from postproc.identification import calibration, compensator_geometry, plausibility, record, validation
from postproc.identification.fit import NORMAL_95, FileValues, correlations, to_file_units
from postproc.identification.joint_springs import Levels, SpringOfJoint2
from postproc.identification.measurement_model import (
    MIN_COMPLIANCE,
    Placement,
    base_frame,
    joint_torques,
    point_table,
)
from postproc.identification.moved_device import moved_device
from postproc.identification.procedure import Depth, Identification, Method, identify, rms_distances
from postproc.identification.readings import Experiment, Measurements, Payload, read, read_experiment
from postproc.identification.return_error import GEARS_RETURN
from postproc.identification.stated_points import displaced_points
from postproc.identification.uncertainty import Discrepancy, Workspace
from postproc.robot import (
    COMPENSATOR,
    JOINT_COMPLIANCES,
    JOINTS,
    PER_URAD,
    WITH_LINKS,
    FadingPart,
    JointCompliance,
    Knee,
    Parameter,
    RobotModel,
    urdf,
)
from postproc.robot.model_file import (
    CompensatorEntry,
    CovarianceTable,
    DiscrepancyEntry,
    Gravity,
    JointSpring,
    LinkSprings,
    Masses,
    MeasuredEntry,
    ModelFile,
    PayloadEntry,
)

_COMMENT = f"Written by `postproc identify`. Units are in the names; every entry names its source. {WITH_LINKS}."


def model_file(result: Identification, prior: ModelFile, source: str, geometry_source: str | None) -> ModelFile:
    """Return the content of `model.toml`: identified values with intervals, and the prior's values for the others.

    :param source: text on the origin of the identified values.
    :param geometry_source: of the compensator's geometry if it was identified from markers, else None.
    :raises MeasurementError: the readings do not determine the values in units of the file.
    """
    file_values = to_file_units(result.fit)
    half_widths = NORMAL_95 * np.sqrt(np.diag(file_values.covariance))
    tables = _parameter_tables(file_values.parameters, file_values.values, half_widths, source)
    unobservable = {entry.parameter for entry in result.missing}
    observable_tables = {
        joint.joint: tables["joints"][joint.joint]
        for joint in JOINT_COMPLIANCES
        if joint.joint in tables["joints"] and joint not in unobservable
    }
    joints = _joint_springs(observable_tables, prior, source)
    return ModelFile(
        name=prior.name,
        date=prior.date,
        language=prior.language,
        joints=joints,
        gravity=Gravity(reference=prior.gravity.reference, in_gears=result.fit.structure.carries_weight),
        compensator=_compensator_entry(result, prior, tables["compensator"], source, geometry_source),
        payload=prior.payload,
        geometry=prior.geometry,
        transmission=prior.transmission,
        geometry_error=prior.geometry_error,
        links=msgspec.convert(tables["links"], dict[str, LinkSprings]),
        covariance=_covariance_table(file_values, joints),
        discrepancy=DiscrepancyEntry(
            source=source, load_N=result.discrepancy.load.tolist(), u95_mm=(result.discrepancy.u95 * MM_PER_M).tolist()
        ),
        measured=MeasuredEntry(
            source=source,
            configurations=len(result.data.q),
            torque_Nm=tuple(np.abs(joint_torques(result.prior, result.data)).max(axis=0).tolist()),
            not_trusted=result.judgement.distrust,
        ),
        masses=_masses(prior.masses, tables["masses"], source),
        geometry_nominal=prior.geometry_nominal,
        speeds=prior.speeds,
    )


def _covariance_table(file_values: FileValues, joints: Mapping[str, JointSpring]) -> CovarianceTable:
    """Return [covariance] of the parameters whose variance is not stated by the spring of their joint.

    A joint that keeps the prior's value keeps its `sigma_percent` too; without one its variance is in the table.

    :param joints: springs of the model, by the name of the joint.
    """
    parameters = file_values.parameters
    rows = [
        index
        for index, parameter in enumerate(parameters)
        if not (isinstance(parameter, JointCompliance) and joints[parameter.joint].sigma_percent is not None)
    ]
    return CovarianceTable.of([parameters[index].name for index in rows], file_values.covariance[np.ix_(rows, rows)])


def _parameter_tables(
    parameters: Sequence[Parameter], values: Array, half_widths: Array, source: str
) -> dict[str, Any]:
    """Return the tables of `model.toml` that hold identified parameters: name → content, empty without parameters.

    :param values: (p,) in units of the file, and `half_widths` (p,) of their 95 % intervals.
    """
    tables: dict[str, Any] = {"joints": {}, "links": {}, "compensator": {}, "masses": {}}
    for parameter, value, half_width in zip(parameters, values.tolist(), half_widths.tolist(), strict=True):
        if value > 0.0 or not parameter.sparse:  # a part of a gear that is zero is in [covariance] alone
            parameter.write(tables, value, half_width, source)
    return tables


def _joint_springs(tables: Mapping[str, dict[str, Any]], prior: ModelFile, source: str) -> dict[str, JointSpring]:
    """Return the [joints] of the identified model.

    A joint keeps the prior's compliance if none was identified, or a negative one.

    :param tables: entries of the identified joints, by the name of the joint.
    """
    joints = {}
    for joint in JOINTS:
        table, prior_spring = tables.get(joint), prior.joints[joint]
        if table is not None and table[_COMPLIANCE] >= 0.0:
            # a value near zero is raised, not replaced by the prior's: link springs deflect in place of the joint
            parts = {key: list(map(_with_least_compliance, table[key])) for key in _GEAR_PARTS if key in table}
            joints[joint] = msgspec.convert(_with_least_compliance(table) | parts, JointSpring)
        else:
            joints[joint] = JointSpring(
                source=f"prior, not observable in {source}: {prior_spring.source}",
                assumed=True,
                compliance_urad_per_Nm=prior_spring.compliance_urad_per_Nm,
                sigma_percent=prior_spring.sigma_percent,
            )
    return joints


_COMPLIANCE = "compliance_urad_per_Nm"
_GEAR_PARTS = FadingPart.key, Knee.key
"""Keys of a joint in `model.toml`."""


def _with_least_compliance(table: dict[str, Any]) -> dict[str, Any]:
    """Return a table of `model.toml` with its compliance raised to the least one that a file may hold."""
    return table | {_COMPLIANCE: max(table[_COMPLIANCE], MIN_COMPLIANCE * PER_URAD)}


def _compensator_entry(
    result: Identification, prior: ModelFile, spring_table: dict[str, Any], source: str, geometry_source: str | None
) -> CompensatorEntry | None:
    """Return the [compensator] of the identified model.

    None if the fit has no compensator, or if its lengths are new and its spring was not identified.

    :param spring_table: keys of the identified spring; empty: the spring keeps the prior's values.
    :param geometry_source: origin of identified lengths; None: the lengths are the prior's.
    """
    compensator = result.fit.structure.prior.compensator
    prior_entry = prior.compensator
    if compensator is None or (prior_entry is None and not spring_table):
        return None
    spring: dict[str, Any] = {
        "stiffness_N_per_m": max(compensator.stiffness, 0.0),
        "free_length_mm": max(compensator.free_length * MM_PER_M, 0.0),
        "source": f"prior, not observable in {source}: {'' if prior_entry is None else prior_entry.source}",
        "assumed": True,
    } | spring_table
    if prior_entry is not None:
        spring["spread_percent"] = prior_entry.spread_percent
    return CompensatorEntry(
        L_mm=compensator.L * MM_PER_M,
        a_x_mm=compensator.ax * MM_PER_M,
        a_y_mm=compensator.ay * MM_PER_M,
        sigma_percent=None if prior_entry is None or spring_table else prior_entry.sigma_percent,
        geometry_source=geometry_source or ("" if prior_entry is None else prior_entry.geometry_source),
        **spring,
    )


def _masses(prior: Masses | None, mass_table: dict[str, float], source: str) -> Masses | None:
    """Return the link masses of `model.toml`: the prior's masses, replaced by identified ones; None without any.

    :param mass_table: keys of the identified masses.
    """
    if not mass_table:
        return prior
    prior_masses = Masses(source="robot.urdf", assumed=True) if prior is None else prior
    return msgspec.structs.replace(prior_masses, source=f"{source}, about {prior_masses.source}", **mass_table)


def write(
    folder: Path,
    content: ModelFile,
    data: record.IdentificationRecord,
    prior_folder: Path,
    render: Callable[[record.IdentificationRecord, str], bytes] | None = None,
) -> list[Path]:
    """Write the model folder, all files or none, and return their paths.

    :param content: of `model.toml`.
    :param data: content of `identification.json`; the list of the files written with it is added.
    :param prior_folder: folder of robot.urdf and of the meshes that it names.
    :param render: makes `report.html` from `data` and the name of the model; None: no report.
    :raises InputError: the folder cannot be written, or is the prior's.
    :raises MeasurementError: a number is not finite; the message names it.
    """
    for name, file_content in (("model.toml", content), (record.NAME, data)):
        require_finite(msgspec.to_builtins(file_content), name)
    if folder.resolve() == prior_folder.resolve():
        raise InputError("would overwrite the prior model", file=str(folder), advice="Give another folder with -o.")
    contents: dict[str, bytes | Iterable[bytes]] = {
        "model.toml": files.toml(content, _COMMENT),
        "robot.urdf": (prior_folder / "robot.urdf").read_bytes(),
    }
    text = (prior_folder / "robot.urdf").read_text(encoding="utf-8")
    for geometry in urdf.geometries(text, "robot.urdf"):
        path = prior_folder / geometry.file
        if geometry.file == path.name and path.is_file():  # meshes in other folders are not copied
            contents[path.name] = path.read_bytes()
    if render is not None:
        contents["report.html"] = render(data, folder.resolve().name)

    def record_text(entries: list[files.FileEntry]) -> bytes:
        """Return the text of `identification.json` with a list of the files written with it."""
        return msgspec.structs.replace(data, files=entries).as_json()

    return files.write_whole(folder, files.add_record(contents, record.NAME, record_text))


def require_finite(content: Any, name: str) -> None:
    """Check that all numbers of a content, nested or not, are finite.

    :param name: of the content, for the message: a file, or for nested content ``model.toml: joints.A2``.
    :raises MeasurementError: a number is infinite or NaN; the message names the first.
    """
    if isinstance(content, float) and not np.isfinite(content):
        raise MeasurementError(
            f"{name} would be {content}: the identification failed",
            file="",
            advice="Check loads, joint angles and readings; measure more configurations that load this joint.",
        )
    if isinstance(content, dict):
        for key, value in content.items():
            require_finite(value, f"{name}: {key}" if ":" not in name else f"{name}.{key}")  # colon after the file
    elif isinstance(content, list | tuple):
        for index, value in enumerate(content):
            require_finite(value, f"{name}[{index}]")


def protect(folder: Path) -> None:
    """Check that no model in a folder was written by hand, or changed after postproc identified it.

    :raises InputError: the folder has such a model, which writing would overwrite.
    """
    files.refuse(
        files.find_foreign_files(folder, ("model.toml", "robot.urdf", "report.html", record.NAME), record.NAME)
    )


def read_prior(folder: Path, payload: Payload | None, source: str) -> ModelFile:
    """Return the content of the prior's `model.toml`, with the payload of the experiment.

    :param payload: of the experiment; None: no payload, whatever the prior states.
    :param source: file that states the payload.
    :raises ModelError: the file is unusable.
    """
    content = files.read_toml(folder / "model.toml", ModelFile, ModelError)
    entry = None
    if payload is not None:
        entry = PayloadEntry(
            source=f"stated in {source}", mass_kg=payload.mass_kg, X_mm=payload.X, Y_mm=payload.Y, Z_mm=payload.Z
        )
    return msgspec.structs.replace(content, payload=entry)


def constant_springs_only(content: ModelFile) -> ModelFile:
    """Return the model as a prior: constant joint springs, without springs of links and all other terms of gears.

    Covariance, forces, discrepancy and the record of the measurements belong to these terms, and are removed too.
    """
    joints = {
        name: msgspec.structs.replace(
            spring, stiffening=[], knees=[], backlash=None, lost_motion=None, over_pose=[], coupling={}
        )
        for name, spring in content.joints.items()
    }
    return msgspec.structs.replace(
        content, joints=joints, links={}, covariance=None, forces=None, discrepancy=None, measured=None
    )


def report_data(result: Identification) -> record.IdentificationRecord:
    """Return the content of `identification.json`."""
    file_values = to_file_units(result.fit)
    return record.IdentificationRecord(
        verdict=record.Verdict(bool(result.judgement.distrust), result.judgement.line),
        method=result.method,
        robot=result.prior.name,
        parameters=_parameter_records(result, file_values),
        k2_levels=_level_records(result.levels),
        k2_curve=_k2_curve(result),
        from_levels=_spring_records(result.spring),
        residual=_residual_record(result),
        discrepancy=_discrepancy_records(result.discrepancy),
        return_u95_mm=None if result.discrepancy.return_bound is None else result.discrepancy.return_bound * MM_PER_M,
        workspace=_workspace_records(result.workspace),
        workspace_line=result.workspace.line,
        structure=None
        if result.choice is None
        else record.Structure(result.choice.reason, [candidate.as_record for candidate in result.choice.candidates]),
        sigma_mm=result.data.sigma * MM_PER_M,
        **_placement_entries(result.placement, result.data),
        not_observable=[record.MissingParameter(entry.name, entry.reason, entry.advice) for entry in result.missing],
        held_by_prior=None if result.choice is None else [parameter.name for parameter in result.choice.held_by_prior],
        outliers=list(result.left_out),
        warnings=list(result.warnings),
        assumptions=[GEARS_RETURN] if result.discrepancy.return_bound is None else [],
        correlation=record.Correlation(
            [parameter.name for parameter in file_values.parameters],
            [[round(value, 4) for value in row] for row in correlations(file_values.covariance).tolist()],
        ),
        states=_state_records(result.data),
        torque_Nm=np.abs(joint_torques(result.prior, result.data)).max(axis=0).tolist(),
        torques=validation.torque_record(validation.coverage_of(result.prior, result.data)),
    )


def _placement_entries(placement: Placement, data: Measurements) -> dict[str, Any]:
    """Return entries of `identification.json` by key: base, points and RMS residual of the readings without load."""
    return {
        "base": base_frame(placement),
        "points": point_table(placement, data.points),
        "unloaded_rms_mm": placement.rms * MM_PER_M,
    }


def _level_records(levels: Levels | None) -> list[record.Level]:
    """Return the compliances of joint 2 at the levels of q2, for `identification.json`; empty without levels."""
    if levels is None:
        return []
    deviation = np.sqrt(np.diag(levels.covariance))
    return [
        record.Level(
            float(q * DEG_PER_RAD), float(k * PER_URAD), float(NORMAL_95 * d * PER_URAD) if np.isfinite(d) else None
        )
        for q, k, d in zip(levels.q2, levels.compliance, deviation, strict=True)
    ]


def _spring_records(spring: SpringOfJoint2 | None) -> dict[str, record.FromLevels] | None:
    """Return gear and compensator of joint 2 from the levels, with half 95 % intervals; None if they are unknown."""
    if spring is None:
        return None
    half_widths = (NORMAL_95 * np.sqrt(np.diag(spring.covariance))).tolist()
    names = ("K_theta2_0", "K_c", "K_c*s_0")
    return {
        name: record.FromLevels(value, half_width)
        for name, value, half_width in zip(names, spring.values.tolist(), half_widths, strict=True)
    }


def _residual_record(result: Identification) -> record.Residual:
    """Return the residuals for `identification.json` [mm]: of all readings, and RMS distances by configuration."""
    without_model, with_model = rms_distances(result)
    return record.Residual(
        rms_mm=result.fit.rms * MM_PER_M,
        max_mm=float(norm(result.fit.residual).max()) * MM_PER_M,
        before_rms_mm=float(np.sqrt(np.mean(without_model**2))) * MM_PER_M,
        chi2=result.fit.chi2,
        degrees_of_freedom=result.fit.dof,
        per_configuration=[
            record.OfConfiguration(float(config), float(before) * MM_PER_M, float(after) * MM_PER_M)
            for config, before, after in zip(result.data.config, without_model, with_model, strict=True)
        ],
    )


def _discrepancy_records(discrepancy: Discrepancy) -> list[record.CrossValidation]:
    """Return the cross-validation errors at each level of loads, in mm."""
    lengths = (
        np.stack([discrepancy.held_out, discrepancy.noise, discrepancy.parameter_error, discrepancy.u95], axis=1)
        * MM_PER_M
    )
    return [
        record.CrossValidation(load_N=load, held_out_mm=held_out_mm, noise_mm=noise_mm, own_mm=own_mm, u95_mm=u95_mm)
        for load, (held_out_mm, noise_mm, own_mm, u95_mm) in zip(
            discrepancy.load.tolist(), lengths.tolist(), strict=True
        )
    ]


def _workspace_records(workspace: Workspace) -> list[record.InWorkspace]:
    """Return deflection and bound in the workspace at each load, in mm."""
    return [
        record.InWorkspace(
            load_N=level.load,
            deflection_mm=level.deflection * MM_PER_M,
            bound_mm=level.bound * MM_PER_M,
            worst_share=level.bound_ratio,
            chance=level.chance,
        )
        for level in workspace.levels
    ]


def _state_records(data: Measurements) -> list[record.State]:
    """Return the loaded states of the readings, angles in degrees."""
    angles = (data.q[data.state_config[data.loaded_states]] * DEG_PER_RAD).round(6).tolist()
    return [
        record.State(tuple(q), tuple(load))
        for q, load in zip(angles, data.wrench[data.loaded_states].tolist(), strict=True)
    ]


def _parameter_records(result: Identification, file_values: FileValues) -> dict[str, record.Parameter]:
    """Return the parameters of `identification.json` by name.

    k1…k6, K⁰_θ2, K_c, s₀ (with a compensator) are always present, other parameters if they were identified. Sparse
    parameters (`Parameter.sparse`) count as identified if they are not zero.

    :param file_values: values of the fit in units of the file.
    """
    half_widths = NORMAL_95 * np.sqrt(np.diag(file_values.covariance))
    triples = zip(file_values.parameters, file_values.values.tolist(), half_widths.tolist(), strict=True)
    values = {
        parameter: (value, half_width)
        for parameter, value, half_width in triples
        if value > 0.0 or not parameter.sparse
    }
    prior, unobservable = result.prior, {entry.parameter for entry in result.missing}
    springs = COMPENSATOR if prior.compensator is not None else ()
    always_present = (*JOINT_COMPLIANCES, *(springs if result.fit.structure.prior.compensator is not None else ()))
    # parameters that were fitted about the prior's value
    prior_mean = {p: prior.value(p) for p in values if np.isfinite(prior.prior_sigma(p))}
    prior_values: dict[Parameter, float] = {p: prior.value(p) for p in (*JOINT_COMPLIANCES, *springs)}
    prior_values = prior_values | dict(prior.terms) | prior_mean
    entries: dict[str, record.Parameter] = {}
    for parameter in dict.fromkeys((*always_present, *values)):
        value = None if parameter in unobservable else values.get(parameter)
        prior_value = None
        if parameter in always_present or parameter in prior_mean:
            prior_value, _ = parameter.file_value(prior_values)
        source = record.ABOUT_THE_PRIOR if parameter in prior_mean else None
        entries[parameter.name] = _parameter_record(value, parameter.unit, prior_value, source)
        if parameter == JOINT_COMPLIANCES[-1]:  # the stiffness of joint 2 follows the compliances
            stiffness = _stiffness_record(entries[JOINT_COMPLIANCES[1].name])
            entries |= {} if stiffness is None else {"K_theta2_0": stiffness}
    return entries


def _stiffness_record(compliance: record.Parameter) -> record.Parameter | None:
    """Return the stiffness of a joint [N·m/rad] from its compliance [µrad/(N·m)]; None without a value or a prior."""
    value, ci95, prior_value = compliance.value, compliance.ci95, compliance.prior
    if value is None or prior_value is None:
        return None
    # the interval at first order: the derivative of 1/k is −1/k²
    stiffness = None if ci95 is None else (PER_URAD / value, PER_URAD * ci95 / value**2)
    return _parameter_record(stiffness, "N·m/rad", PER_URAD / prior_value)


def _parameter_record(
    value: tuple[float, float] | None, unit: str, prior_value: float | None, source: str | None = None
) -> record.Parameter:
    """Return the record of a parameter.

    :param value: identified value and half width of its 95 % interval; None: the readings do not show the parameter,
        and it has the value of the prior.
    :param unit: of value and prior value in files.
    :param prior_value: None if the prior does not have the parameter.
    :param source: of an identified value, see `record.Parameter`; None: the readings alone.
    """
    if value is None:
        return record.Parameter(prior_value, None, unit, observable=False, prior=prior_value, source="prior")
    size, half_width = value
    return record.Parameter(
        size,
        half_width,
        unit,
        observable=True,
        determined=bool(half_width <= size),
        prior=prior_value,
        source=source,
    )


_CURVE_POINTS = 41
"""Points of the curve of the compliance of joint 2 (assumed): it looks smooth in the report."""


def _k2_curve(result: Identification) -> list[tuple[float, float]]:
    """Return pairs of q2 [deg] and equivalent compliance of joint 2 [µrad/(N·m)] of the model, over the measured q2.

    Empty without levels of q2.
    """
    if result.levels is None:
        return []
    model = result.robot()
    q2 = np.linspace(result.levels.q2.min(), result.levels.q2.max(), _CURVE_POINTS)
    stiffness = 1.0 / model.compliance[model.actuated[1]]
    spring_stiffness = np.zeros_like(q2) if model.compensator is None else model.compensator.stiffness_about_joint(q2)
    compliance = PER_URAD / (stiffness + spring_stiffness)
    return list(zip((q2 * DEG_PER_RAD).tolist(), compliance.tolist(), strict=True))


_UNCERTAIN_NOTE = "   (not determined: the interval is larger than the value)"


class Choices(Struct, frozen=True, kw_only=True):
    """Inputs and options of an identification.

    :param compensator: file of `identify compensator` with the lengths of the compensator; None: the robot's lengths.
    :param method: see `procedure.identify`.
    :param structure: "auto" also tries springs of links and stiffening gears.
    :param geometry: whether the geometry is calibrated too, with the identified springs.
    """

    compensator: Path | None = None
    method: Method = "enhanced"
    structure: Depth = "auto"
    geometry: bool = False


class IdentifiedFolder(Struct, frozen=True, eq=False):
    """An identification as it was written.

    :param result: the identification of the compliances, if there was one.
    :param data: content of `identification.json`.
    :param text: summary for a terminal.
    """

    result: Identification | None
    data: record.IdentificationRecord
    text: str


def with_compensator_geometry(robot: RobotModel, path: Path) -> RobotModel:
    """Return the robot with L, a_x, a_y from a file of `identify compensator`.

    The spring is the robot's; a robot without compensator gets a spring of zero stiffness.

    :raises MeasurementError: the file is unusable.
    """
    length, ax, ay = compensator_geometry.load(path)
    robot_compensator = robot.compensator
    compensator = Compensator(
        stiffness=0.0 if robot_compensator is None else robot_compensator.stiffness,
        free_length=0.0 if robot_compensator is None else robot_compensator.free_length,
        L=float(length),
        ax=float(ax),
        ay=float(ay),
    )
    return replace(robot, compensator=compensator)


class StartingRobot(NamedTuple):
    """The robot where the search starts, with the payload of the experiment and without springs that are not linear.

    :param folder: of its model.
    :param content: of its `model.toml`.
    :param model: built from it.
    """

    folder: Path
    content: ModelFile
    model: RobotModel


def starting_robot(setup: Experiment, experiment: Path) -> StartingRobot:
    """Return the robot that an experiment names, prepared as the start of the search.

    :param setup: content of `experiment.toml`.
    :param experiment: path of `experiment.toml`: paths in it are relative to its folder.
    :raises ModelError: there is no such robot, or its model is wrong.
    """
    folder = robots.find(setup.robot, experiment.parent)
    stored_robot = robots.load(folder)
    content = constant_springs_only(read_prior(folder, setup.payload, experiment.name))
    return StartingRobot(folder, content, robots.assemble(stored_robot.name, content, stored_robot.nominal))


def identify_folder(
    measurements: Path,
    experiment: Path,
    output: Path,
    choices: Choices = Choices(),
    progress: Callable[[str], None] = lambda _: None,
    render: Callable[[record.IdentificationRecord, str], bytes] | None = None,
) -> IdentifiedFolder:
    """Read measurements, identify, write the model folder.

    :param experiment: path of `experiment.toml`.
    :param output: model folder to write.
    :param progress: called with the name of each step.
    :param render: makes `report.html` from the content of `identification.json` and the name of the model; None: no
        report.
    :raises MeasurementError: the files are unusable.
    :raises InputError: the folder cannot be written.
    """
    setup = read_experiment(experiment)
    prior_folder, prior_content, prior = starting_robot(setup, experiment)
    geometry_source, pivot_doubt = None, ""
    if choices.compensator is not None:
        stated_compensator, prior = prior.compensator, with_compensator_geometry(prior, choices.compensator)
        pivot_doubt = compensator_geometry.pivot_doubt(prior.compensator, stated_compensator)
        geometry_source = f"identified from markers ({choices.compensator.name})"
    readings = read(measurements, setup)
    if choices.geometry:
        _require_positions(readings, measurements)
    result = identify(prior, readings, choices.method, choices.structure, progress)
    result = replace(result, judgement=result.judgement.with_reservation(pivot_doubt))
    data = report_data(result)
    data = msgspec.structs.replace(data, assumptions=[*setup.assumptions, *(data.assumptions or ())])
    source = f"identified from {measurements.name}, {choices.method}"
    content = model_file(result, prior_content, source, geometry_source)
    if choices.geometry:
        progress("geometry")
        geometry = calibration.identify_geometry(content, prior.nominal, prior.name, result.data)
        content = geometry.content
        data = msgspec.structs.replace(
            data,
            geometry=calibration.report_data(geometry),
            warnings=[*data.warnings, *calibration.warnings(geometry, result.data.sigma)],
            **_placement_entries(geometry.placement, result.data),
        )
    write(output, content, data, prior_folder, render)
    return IdentifiedFolder(result, data, summary(data))


def _require_positions(data: Measurements, path: Path) -> None:
    """Check that readings are positions.

    :raises MeasurementError: they are displacements.
    """
    if data.are_displacements:
        raise MeasurementError(
            "displacements do not show the geometry",
            file=str(path),
            advice='Give positions, and leave out `readings = "displacements"` of the experiment.',
        )


def geometry_folder(
    measurements: Path,
    experiment: Path,
    output: Path,
    model: Path | None = None,
    render: Callable[[record.IdentificationRecord, str], bytes] | None = None,
) -> IdentifiedFolder:
    """Calibrate the geometry from readings without load and write the model folder.

    :param measurements: file of the measured positions.
    :param experiment: path of `experiment.toml`.
    :param output: model folder to write.
    :param model: folder of the model whose springs predict the sag; None: the robot of the experiment.
    :param render: see `identify_folder`.
    :raises MeasurementError: the files are unusable.
    :raises InputError: the folder cannot be written.
    """
    setup = read_experiment(experiment)
    folder = model or robots.find(setup.robot, experiment.parent)
    content = read_prior(folder, setup.payload, experiment.name)  # of model.toml
    nominal = robots.load(folder).nominal  # the geometry that the controller uses
    robot = robots.assemble(folder.resolve().name, content, nominal)
    data = read(measurements, setup, needs_loads=False)
    _require_positions(data, measurements)
    data, placement, outliers = plausibility.check_placement(robot, data)
    doubts = [*filter(None, [displaced_points(data, placement)]), *moved_device(robot, data, placement)]
    geometry = calibration.identify_geometry(content, nominal, robot.name, data)
    report = record.IdentificationRecord(
        method="geometry",
        robot=robot.name,
        geometry=calibration.report_data(geometry),
        sigma_mm=setup.sigma_mm,
        **_placement_entries(geometry.placement, data),
        outliers=outliers,
        warnings=[*(f"outlier: {name}" for name in outliers), *doubts, *calibration.warnings(geometry, data.sigma)],
    )
    write(output, geometry.content, report, folder, render)
    return IdentifiedFolder(result=None, data=report, text=summary(report))  # no compliances were identified


def summary(data: record.IdentificationRecord) -> str:
    """Return the verdict, the identified values and their errors as lines for a terminal."""
    lines = [] if data.verdict is None else [data.verdict.line]
    if data.parameters:
        lines += _parameter_lines(data.parameters)
    if data.structure is not None:
        lines.append(data.structure.reason)
    lines += data.error_lines
    if data.workspace_line is not None:
        lines.append(data.workspace_line)
    if data.torque_Nm is not None:
        torques = ", ".join(f"{torque:.0f}" for torque in data.torque_Nm)
        lines.append(f"the loads put up to {torques} N·m on A1 … A6: work that puts more is extrapolated")
    lines += [f"assumed: {text}" for text in data.assumptions or ()]
    if data.residual is not None:
        residual = data.residual
        lines.append(
            f"residual {residual.rms_mm:.3f} mm RMS, {residual.max_mm:.3f} mm max; "
            f"displacements {residual.before_rms_mm:.3f} mm RMS"
        )
    if data.geometry is not None:
        lines += _geometry_lines(data.geometry)
    return "\n".join(lines)


def _parameter_lines(parameters: Mapping[str, record.Parameter]) -> list[str]:
    """Return the identified elastic parameters, one a line, and a line on the source of the intervals.

    Undetermined parameters without a prior are not listed; a line counts them.
    """
    lines, undetermined_count = [], 0
    for name, entry in parameters.items():
        if entry.determined is False and entry.prior is None:
            undetermined_count += 1
            continue
        half = "" if entry.ci95 is None else f" ± {entry.ci95:.3g}"
        note = _UNCERTAIN_NOTE if entry.determined is False else ""
        if not entry.observable:
            note = "   (prior: not observable)"
        elif entry.source == record.ABOUT_THE_PRIOR:
            note = f"   (about the prior's {entry.prior:.4g})"
        lines.append(f"{name:>12} = {entry.value:.5g}{half} {entry.unit}{note}")
    if undetermined_count:
        lines.append(
            f"{undetermined_count} more parameters of links and gears are not determined one by one, only what they "
            "predict together: identification.json"
        )
    return [*lines, f"{robots.WITH_LINKS}: the intervals are of that sum"]


def _geometry_lines(geometry: record.Geometry) -> list[str]:
    """Return the geometry parameters, one a line, and the errors of the variants that were tried.

    A parameter that the readings do not narrow is not observable; it is determined if its interval is at most as large
    as its value. The last line tells how far positions may be off: the bound on errors of programs includes it.
    """
    lines = []
    for name, entry in geometry.parameters.items():
        note = _UNCERTAIN_NOTE if entry.determined is False else ""
        if not entry.observable:
            note = "   (not narrowed by the readings)"
        lines.append(f"{name:>12} = {entry.value:8.4f} ± {entry.ci95:.3g} {entry.unit}{note}")
    for label, rms in geometry.variants.items():
        note = "  <- chosen" if label == geometry.chosen else ""
        lines.append(f"{label}: {rms.rms_mm:.3f} mm RMS, {rms.held_out_rms_mm:.3f} mm on configurations left out{note}")
    lines.append(f"95 % of the errors of the geometry are below {geometry.u95_mm:.3f} mm; that is in the bound")
    return lines
