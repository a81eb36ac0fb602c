"""`postproc identify`: from readings to a compensator file or a model folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from postproc.files import foreign_single, refuse
from postproc.identification import (
    Choices,
    IdentifiedFolder,
    compensator_geometry,
    geometry_folder,
    identify_folder,
    model_folder,
)
from postproc.identification.compensator_geometry import CompensatorGeometry
from postproc.identification.validation import Validation, table, validate
from postproc.jobs.outputs import protect
from postproc.report.identification import page


class ElastostaticsRequest(Choices, frozen=True, kw_only=True):
    """What compliances are identified from, how, and where the model folder is written.

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
        refuse(foreign_single(output))
    result = compensator_geometry.identify(compensator_geometry.read(markers))
    compensator_geometry.save(output, result, markers.name)
    return result


def identify_elastostatics(
    request: ElastostaticsRequest, progress: Callable[[str], None] = lambda _: None
) -> IdentifiedFolder:
    """Identify compliances, and write the model folder with its report.

    :param progress: told what is being done.
    :raises PostprocError: the readings are unusable, or the folder must not be replaced.
    """
    if not request.overwrite:
        model_folder.protect(request.output)
    return identify_folder(request.measurements, request.experiment, request.output, request, progress, page)


def identify_geometry(
    measurements: Path, experiment: Path, output: Path, model: Path | None = None, *, overwrite: bool = False
) -> IdentifiedFolder:
    """Calibrate the geometry from readings without load, and write the model folder with its report.

    :param model: folder of the model whose springs predict the sag; the robot of the experiment by default.
    :param overwrite: replace files that postproc did not write.
    :raises PostprocError: the readings are unusable, or the folder must not be replaced.
    """
    if not overwrite:
        model_folder.protect(output)
    return geometry_folder(measurements, experiment, output, model, page)


def validate_model(model: Path, measurements: Path, experiment: Path) -> tuple[Validation, str]:
    """Hold a model folder against readings that it was not identified from; return the comparison and its table.

    :raises PostprocError: the files are unusable.
    """
    result = validate(model, measurements, experiment)
    return result, table(result)
