"""Commands that identify a model from readings of the folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from postproc.app.workspace import Workspace
from postproc.errors import InputError
from postproc.jobs.experiments import Readings


def identify_arguments(workspace: Workspace, entry: Readings, form: Mapping[str, str]) -> list[str]:
    """Return the arguments of the command that identifies a model.

    :param entry: the experiment with its files of readings.
    :param form: values of the form: `readings` and `compensator` are names of files (default: the first file of
        readings, and no compensator); `geometry`, if not empty, calibrates the geometry too.
    :raises InputError: a file is not next to the experiment.
    """
    readings = file_of_name(entry.files, form.get("readings", "") or next((path.name for path in entry.files), ""))
    arguments = ["identify", "elastostatics", workspace.relative_name(readings)]
    arguments += ["--experiment", workspace.relative_name(entry.experiment)]
    if compensator := form.get("compensator", ""):
        arguments += ["--compensator", workspace.relative_name(file_of_name(entry.compensators, compensator))]
    if form.get("geometry"):
        arguments.append("--geometry")
    return [*arguments, "-o", workspace.relative_name(workspace.model_folder(entry.experiment))]


def file_of_name(paths: Sequence[Path], name: str) -> Path:
    """Return the path with a file name.

    :raises InputError: no path has this file name.
    """
    for path in paths:
        if path.name == name:
            return path
    raise InputError(f"no file {name!r} next to the experiment", advice="Choose one of the list.")
