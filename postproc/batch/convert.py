"""One program from file to files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import msgspec

from postproc import cell as cells
from postproc import files, pipeline, report
from postproc import robot as robots
from postproc.batch.inputs import Job, dialect_of, is_input, read_documents
from postproc.batch.interrupts import Interrupted, held_back
from postproc.batch.outcome import EXCEEDED, FAILED, GOOD, Outcome, Settings
from postproc.cell import Cell
from postproc.errors import InputError, PostprocError
from postproc.forces import read_force_csv
from postproc.frames import M_PER_MM
from postproc.pipeline import Result
from postproc.program import Program
from postproc.report import Summary
from postproc.robot import RobotModel


def load_setup(settings: Settings) -> tuple[Cell, RobotModel]:
    """Read the cell and its robot.

    :raises CellError: the cell is unusable.
    :raises ModelError: its robot is.
    """
    cell = cells.load(settings.cell)
    if settings.tolerance_mm is not None:
        cell = msgspec.structs.replace(
            cell, output=msgspec.structs.replace(cell.output, tolerance_mm=settings.tolerance_mm)
        )
    return cell, load_robot(cell.robot, cell.folder)


def load_robot(name: str, relative_to: str | Path = ".") -> RobotModel:
    """Read a robot model.

    :param name: of a shipped robot (`postproc robots` lists them), or the path of a model folder.
    :param relative_to: folder that the path starts from: for the robot of a cell, `cell.folder`.
    :raises ModelError: there is none, or it is unusable.
    """
    return robots.load(robots.find(name, Path(relative_to)))


def convert_one(job: Job, settings: Settings, cell: Cell, robot: RobotModel) -> Outcome:
    """Convert or predict one program and write its files, all or none.

    Whatever goes wrong with this program is its outcome and no exception, a fault of postproc included.
    """
    try:
        return _converted(job, settings, cell, robot)
    except PostprocError as cause:
        return Outcome(str(job.program), FAILED, message=str(cause))
    except MemoryError:
        message = f"{job.program}: not enough memory. Use fewer --jobs, or split the program."
        return Outcome(str(job.program), FAILED, message=message)
    except Exception as cause:
        message = (
            f"{job.program}: unexpected {type(cause).__name__}: {cause}. This is a fault of postproc: "
            "please report it with the program and the cell."
        )
        return Outcome(str(job.program), FAILED, message=message)


def read_program(path: str | Path, robot: RobotModel, cell: Cell, dialect: str | None = None) -> Program:
    """Read a program file (for KRL with its `.dat`).

    :param path: of the main file.
    :param robot: with the cell, fixes where the program starts.
    :param cell: frames and settings.
    :param dialect: ``"gcode"`` or ``"krl"``; None = by the extension.
    :raises ProgramError: it is not understood; the message names the file by its path.
    """
    path = Path(path)
    dialect = dialect or dialect_of(path)
    documents = read_documents(path, dialect)
    try:
        return pipeline.read(documents, robot, cell, path.stem, dialect)
    except InputError as cause:
        raise cause.with_file(path.name, str(path)) from cause


def _converted(job: Job, settings: Settings, cell: Cell, robot: RobotModel) -> Outcome:
    program = read_program(job.program, robot, cell, job.dialect)
    rows = None if job.forces is None else read_force_csv(job.forces)
    result = pipeline.process(program, robot, cell, rows, settings.mode, linearize_arcs=settings.linearize_arcs)
    if result.failed:
        return Outcome(str(job.program), FAILED, issues=result.issues)
    stated = settings.mode == "convert" or settings.tolerance_mm is not None
    tolerance = cell.output.tolerance_mm * M_PER_MM if stated else None
    content = report.summary(result, tolerance)
    contents = _contents(job, result, content, tolerance)
    with held_back() as interrupts:
        written = files.write_whole(job.output, contents)
    exceeded = settings.mode != "predict" and content["tolerance_held"] is False
    outcome = Outcome(
        str(job.program), EXCEEDED if exceeded else GOOD, summary=content, written=tuple(str(path) for path in written)
    )
    if interrupts:
        raise Interrupted(outcome)
    return outcome


def _contents(
    job: Job, result: Result, content: Summary, tolerance: float | None
) -> dict[str, bytes | Iterable[bytes]]:
    """Return what to write: file name → content."""
    stem = job.program.stem
    contents: dict[str, bytes | Iterable[bytes]] = {doc.name: doc.to_bytes() for doc in result.documents}
    contents[f"{stem}.report.json"] = report.to_json(content)
    contents[f"{stem}.targets.csv"] = report.targets_csv(result)
    contents[f"{stem}.report.html"] = report.page(result, tolerance)
    for name in contents:
        if is_input(job, job.output / name):
            raise InputError(
                "this input would be overwritten", file=str(job.output / name), advice="Choose another -o."
            )
    return contents
