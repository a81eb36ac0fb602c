"""From files to a model folder: what the command `identify elastostatics` does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from postproc import robot as robots
from postproc.compensator import Compensator
from postproc.frames import MM_PER_M
from postproc.identification import calibration, compensator_geometry, model_folder, outliers, record
from postproc.identification.experiment import read_experiment
from postproc.identification.placement import describe, describe_points
from postproc.identification.plausibility import check_frames, check_points
from postproc.identification.procedure import Depth, Identification, Method, identify
from postproc.identification.readings import read
from postproc.identification.report_data import report_data
from postproc.robot import RobotModel

_NOT_DETERMINED = "   (not determined: the interval is larger than the value)"


class Choices(Struct, frozen=True, kw_only=True):
    """Inputs and options of an identification.

    :param compensator: file of `identify compensator`, whose geometry is taken; None = that of the robot.
    :param method: see `procedure.identify`.
    :param structure: whether springs of links and stiffening gears are looked for.
    :param geometry: calibrate the geometry too, with the springs found.
    """

    compensator: Path | None = None
    method: Method = "enhanced"
    structure: Depth = "auto"
    geometry: bool = False


class IdentifiedFolder(Struct, frozen=True, eq=False):
    """What was written.

    :param result: the identification of the compliances, if there was one.
    :param data: content of `identification.json`.
    :param text: summary for a terminal.
    """

    result: Identification | None
    data: record.Identified
    text: str


def with_compensator_geometry(robot: RobotModel, path: Path) -> RobotModel:
    """Return the robot with L, a_x, a_y from a file of `identify compensator`."""
    length, ax, ay = compensator_geometry.load(path)
    old = robot.compensator
    law = Compensator(
        stiffness=0.0 if old is None else old.stiffness,
        free_length=0.0 if old is None else old.free_length,
        L=float(length),
        ax=float(ax),
        ay=float(ay),
    )
    return replace(robot, compensator=law)


def identify_folder(
    measurements: Path,
    experiment: Path,
    output: Path,
    choices: Choices = Choices(),
    progress: Callable[[str], None] = lambda _: None,
    render: Callable[[record.Identified, str], bytes] | None = None,
) -> IdentifiedFolder:
    """Read measurements, identify, write the model folder.

    :param progress: called with the name of each step.
    :param render: makes `report.html` from the content of `identification.json` and the name of the model.
    :raises MeasurementError: the files are unusable.
    :raises InputError: the folder cannot be written.
    """
    setup = read_experiment(experiment)
    prior_folder = robots.find(setup.robot, experiment.parent)
    shipped = robots.load(prior_folder)
    before = model_folder.without_found_springs(model_folder.read_prior(prior_folder, setup.payload, experiment.name))
    prior = robots.assemble(shipped.name, before, shipped.nominal)
    marked = None
    if choices.compensator is not None:
        prior = with_compensator_geometry(prior, choices.compensator)
        marked = f"identified from markers ({choices.compensator.name})"
    result = identify(prior, read(measurements, setup), choices.method, choices.structure, progress)
    data = report_data(result)
    source = f"identified from {measurements.name}, {choices.method}"
    content = model_folder.model_file(result, before, source, marked)
    if choices.geometry:
        progress("geometry")
        found = calibration.identify_geometry(content, prior.nominal, prior.name, result.data)
        content = found.content
        data = msgspec.structs.replace(
            data,
            geometry=calibration.report_data(found),
            warnings=[*data.warnings, *calibration.contradictions(found)],
        )
    model_folder.write(output, content, data, prior_folder, render)
    return IdentifiedFolder(result, data, summary(data))


def geometry_folder(
    measurements: Path,
    experiment: Path,
    output: Path,
    model: Path | None = None,
    render: Callable[[record.Identified, str], bytes] | None = None,
) -> IdentifiedFolder:
    """Calibrate the geometry from readings without load and write the model folder.

    :param model: folder of the model whose springs predict the sag; the robot of the experiment by default.
    :raises MeasurementError: the files are unusable.
    :raises InputError: the folder cannot be written.
    """
    setup = read_experiment(experiment)
    folder = model or robots.find(setup.robot, experiment.parent)
    content = model_folder.read_prior(folder, setup.payload, experiment.name)
    nominal = robots.load(folder).nominal
    robot = robots.assemble(folder.resolve().name, content, nominal)
    data = read(measurements, setup, loads=False)
    check_points(data)
    check_frames(robot, data)
    data, left_out = outliers.model_free(data)
    found = calibration.identify_geometry(content, nominal, robot.name, data)
    report = record.Identified(
        method="geometry",
        robot=robot.name,
        geometry=calibration.report_data(found),
        sigma_mm=setup.sigma_mm,
        base=describe(found.placement),
        points=describe_points(found.placement, data.points),
        unloaded_rms_mm=found.placement.rms * MM_PER_M,
        outliers=left_out,
        warnings=[*(f"outlier: {name}" for name in left_out), *calibration.contradictions(found)],
    )
    model_folder.write(output, found.content, report, folder, render)
    return IdentifiedFolder(None, report, summary(report))


def summary(data: record.Identified) -> str:
    """Return the identified values as a table for a terminal."""
    lines = [] if data.verdict is None else [data.verdict.line]
    together = 0
    for name, entry in (data.parameters or {}).items():
        if entry.determined is False and entry.prior is None:
            together += 1
            continue
        half = "" if entry.ci95 is None else f" ± {entry.ci95:.3g}"
        mark = _NOT_DETERMINED if entry.determined is False else ""
        if not entry.observable:
            mark = "   (prior: not observable)"
        elif entry.source == record.ABOUT_THE_PRIOR:
            mark = f"   (about the prior's {entry.prior:.4g})"
        lines.append(f"{name:>12} = {entry.value:.5g}{half} {entry.unit}{mark}")
    if together:
        lines.append(
            f"{together} more parameters of links and gears are not determined one by one, only what they predict "
            "together: identification.json"
        )
    if data.parameters:
        lines.append(f"{robots.WITH_LINKS}: the intervals are of that sum")
    if data.structure is not None:
        lines.append(data.structure.reason)
    lines += [level.line for level in data.discrepancy or ()]
    if data.workspace_line is not None:
        lines.append(data.workspace_line)
    if data.torque_Nm is not None:
        torques = ", ".join(f"{torque:.0f}" for torque in data.torque_Nm)
        lines.append(f"the loads put up to {torques} N·m on A1 … A6: work that puts more is extrapolated")
    if data.residual is not None:
        residual = data.residual
        lines.append(
            f"residual {residual.rms_mm:.3f} mm RMS, {residual.max_mm:.3f} mm max; "
            f"displacements {residual.before_rms_mm:.3f} mm RMS"
        )
    if data.geometry is not None:
        for name, entry in data.geometry.parameters.items():
            mark = _NOT_DETERMINED if entry.determined is False else ""
            if not entry.observable:
                mark = "   (not narrowed by the readings)"
            lines.append(f"{name:>12} = {entry.value:8.4f} ± {entry.ci95:.3g} {entry.unit}{mark}")
        for label, rms in data.geometry.variants.items():
            mark = "  <- chosen" if label == data.geometry.chosen else ""
            lines.append(
                f"{label}: {rms.rms_mm:.3f} mm RMS, {rms.held_out_rms_mm:.3f} mm on configurations left out{mark}"
            )
        lines.append(
            f"95 % of the errors of the geometry are below {data.geometry.u95_mm:.3f} mm; that is in the bound"
        )
    return "\n".join(lines)
