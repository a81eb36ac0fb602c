"""From files to a model folder: what the command `identify elastostatics` does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from postproc import robot as robots
from postproc.compensator import Compensator
from postproc.identification import compensator_geometry, model_folder
from postproc.identification.identify import Depth, Identification, Method, identify
from postproc.identification.measurements import read, read_experiment
from postproc.robot import RobotModel


@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedFolder:
    """What was written.

    :param result: the identification.
    :param data: content of `identification.json`.
    :param text: summary for a terminal.
    """

    result: Identification
    data: dict[str, Any]
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
    compensator: Path | None = None,
    method: Method = "enhanced",
    depth: Depth = "auto",
    progress: Callable[[str], None] = lambda _: None,
    render: Callable[[dict[str, Any]], bytes] | None = None,
) -> IdentifiedFolder:
    """Read measurements, identify, write the model folder.

    :param render: makes `report.html` from the content of `identification.json`.

    :raises MeasurementError: the files are unusable.
    :raises InputError: the folder cannot be written.
    """
    setup = read_experiment(experiment)
    prior_folder = robots.find(setup.robot, experiment.parent)
    prior = robots.load(prior_folder)
    if compensator is not None:
        prior = with_compensator_geometry(prior, compensator)
    result = identify(prior, read(measurements, setup), method, depth, progress)
    data = model_folder.report_data(result)
    geometry = None if compensator is None else f"identified from markers ({compensator.name})"
    source = f"identified from {measurements.name}, {method}"
    report = {} if render is None else {"report.html": render(data)}
    model_folder.write(output, result, prior_folder, source, geometry, report)
    return IdentifiedFolder(result, data, summary(data))


def summary(data: dict[str, Any]) -> str:
    """Return the identified values as a table for a terminal."""
    lines = []
    for name, entry in data["parameters"].items():
        half = "" if entry["ci95"] is None else f" ± {entry['ci95']:.3g}"
        mark = "" if entry["observable"] else "   (prior: not observable)"
        lines.append(f"{name:>12} = {entry['value']:.5g}{half} {entry['unit']}{mark}")
    residual = data["residual"]
    lines.append(
        f"residual {residual['rms_mm']:.3f} mm RMS, {residual['max_mm']:.3f} mm max; "
        f"displacements {residual['before_rms_mm']:.3f} mm RMS"
    )
    return "\n".join(lines)
