"""`postproc identify`: from readings to a compensator file or a model folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from postproc import cell as cells
from postproc.files import find_foreign_file, refuse
from postproc.identification import (
    Choices,
    IdentifiedFolder,
    compensator_geometry,
    geometry_folder,
    identify_folder,
    model_folder,
)
from postproc.identification.compensator_geometry import CompensatorGeometry
from postproc.identification.readings import read_experiment
from postproc.identification.validation import Validation, job_share, table, validate
from postproc.jobs.output_plan import protect
from postproc.jobs.programs import load_robot
from postproc.kinematics import require_pinocchio
from postproc.report.identification import page


class ElastostaticsRequest(Choices, frozen=True, kw_only=True):
    """Inputs, choices and output folder of an identification of compliances.

    :param measurements: CSV file of readings, unloaded and loaded.
    :param experiment: experiment.toml.
    :param output: model folder to write.
    :param overwrite: replace files that postproc did not write.
    """

    measurements: Path
    experiment: Path
    output: Path
    overwrite: bool = False


def identify_compensator(markers: Path, output: Path, *, overwrite: bool = False) -> CompensatorGeometry:
    """Identify the geometry of the gravity compensator from readings of markers, and write it.

    :param markers: CSV file.
    :param output: TOML file to write.
    :param overwrite: replace a file that postproc did not write.
    :raises PostprocError: the readings are unusable, or the file must not be replaced.
    """
    protect([markers], output.parent, [output.name])
    if not overwrite:
        refuse(find_foreign_file(output))
    result = compensator_geometry.identify(compensator_geometry.read(markers))
    compensator_geometry.save(output, result, markers.name)
    return result


def identify_elastostatics(
    request: ElastostaticsRequest, progress: Callable[[str], None] = lambda _: None
) -> IdentifiedFolder:
    """Identify compliances, and write the model folder with its report.

    :param progress: called with the name of each step.
    :raises PostprocError: the readings are unusable, or the folder must not be replaced.
    """
    if not request.overwrite:
        model_folder.protect(request.output)
    _check_packages(request.experiment)
    return identify_folder(request.measurements, request.experiment, request.output, request, progress, page)


def identify_geometry(
    measurements: Path, experiment: Path, output: Path, model: Path | None = None, *, overwrite: bool = False
) -> IdentifiedFolder:
    """Calibrate the geometry from readings without load, and write the model folder with its report.

    :param model: folder of the model whose springs predict the sag; None: that of the robot of the experiment.
    :param overwrite: replace files that postproc did not write.
    :raises PostprocError: the readings are unusable, or the folder must not be replaced.
    """
    if not overwrite:
        model_folder.protect(output)
    _check_packages(experiment)
    return geometry_folder(measurements, experiment, output, model, page)


def _check_packages(experiment: Path) -> None:
    """Check, before any work, that the packages which the robot of an experiment needs are installed.

    :raises PostprocError: Pinocchio is missing, or the experiment or the robot model cannot be read.
    """
    robot = load_robot(read_experiment(experiment).robot, experiment.parent)
    if robot.has_weight:
        require_pinocchio(robot.title)


class Work(Struct, frozen=True, kw_only=True):
    """Programs that a model is validated for.

    :param cell: cell file of the programs.
    :param programs: files, folders, patterns.
    :param forces: CSV file of cutting forces, a folder of such files, or process.toml they are computed from.
    """

    cell: Path
    programs: tuple[str, ...]
    forces: Path | None = None


def validate_model(
    model: Path, measurements: Path, experiment: Path, work: Work | None = None
) -> tuple[Validation, str]:
    """Return the comparison of a model with readings that it was not identified from, and its table as text.

    :param work: programs for which the result states how much of their load the readings cover; None: it does not.
    :raises PostprocError: the files are unusable.
    """
    if (robot := load_robot(str(model), Path())).has_weight:
        require_pinocchio(robot.title)
    result = validate(model, measurements, experiment)
    if work is not None:
        from postproc.jobs.plan_files import check_same_arm, cutting_states  # readers of programs come with it

        cell = cells.load(work.cell)
        check_same_arm(robot, load_robot(cell.robot, cell.folder))
        jobs = [
            job_share(states.source, states.torque, states.weight, result.covered)
            for states in cutting_states(work.programs, work.forces, robot, cell)
        ]
        result = replace(result, jobs=tuple(jobs))
    return result, table(result)
