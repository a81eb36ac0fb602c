"""One program from file to files."""

from __future__ import annotations

import contextlib
import traceback
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

from postproc import correction, files, forces, interrupts, report
from postproc.cell import Cell
from postproc.correction import Mode, Result
from postproc.dialects import registry
from postproc.errors import InputError, Issue, PostprocError, SubprogramError
from postproc.frames import M_PER_MM
from postproc.jobs import outputs, shared_files
from postproc.jobs.inputs import read_documents
from postproc.jobs.job import Job
from postproc.jobs.marking import marked, subprograms
from postproc.jobs.outcome import EXCEEDED, FAILED, GOOD, Outcome, Settings
from postproc.program import Program
from postproc.report import Summary
from postproc.robot import RobotModel

if TYPE_CHECKING:
    from postproc.machining import ProcessForces


def convert_one(job: Job, settings: Settings, cell: Cell, robot: RobotModel) -> Outcome:
    """Convert or predict one program and write its files, all or none.

    Whatever goes wrong with this program is its outcome and no exception, a fault of postproc included. If nothing
    comes of the program, what an earlier run wrote for it is renamed; if it can only not be written, that stays.

    :raises KeyboardInterrupt: nothing was written.
    """
    mode = settings.mode
    with contextlib.ExitStack() as turn:
        try:
            with interrupts.heard():
                name = None if job.keeps_text else job.stem
                program = read_program(job.program, robot, cell, job.dialect, name)
                result, process = _result(job, settings, cell, robot, program)
                if result.failed:
                    made = None
                else:
                    if result.program.needed or subprograms(result, job):
                        turn.enter_context(files.alone_in(job.output))
                    made = _made(job, settings, cell, result, process)
        except Exception as cause:
            if isinstance(cause, SubprogramError) and not job.named:
                return Outcome(str(job.program), GOOD, message=f"{cause.file}: {cause.problem}: skipped.")
            return replace(failure(job, cause), earlier=outputs.set_aside(job, mode))
        if made is None:
            return Outcome(str(job.program), FAILED, issues=result.issues, earlier=outputs.set_aside(job, mode))
        try:
            with shared_files.retiring(job, made.replaced, mode):
                written = files.write_whole(job.output, made.contents, made.obsolete, made.shared)
            return _written(job, made, written, mode)
        except Exception as cause:
            return replace(failure(job, cause), earlier=outputs.left([job], mode))


def _written(job: Job, made: _Made, written: Sequence[Path], mode: Mode) -> Outcome:
    exceeded = mode != "predict" and made.summary["verdict"]["state"] == "failed"
    return Outcome(
        str(job.program),
        EXCEEDED if exceeded else GOOD,
        made.summary,
        written=tuple(str(path) for path in written),
        copied=tuple(str(job.output / name) for name in made.copied),
    )


def read_program(
    path: str | Path, robot: RobotModel, cell: Cell, dialect: str | None = None, name: str | None = None
) -> Program:
    """Read a program file (for KRL with its `.dat`).

    :param path: of the main file.
    :param robot: with the cell, fixes where the program starts.
    :param cell: frames and settings.
    :param dialect: name of its format; None = by the extension.
    :param name: of the program; None = that of the file.
    :raises ProgramError: it is not understood; the message names the file by its path.
    """
    path = Path(path)
    dialect = dialect or registry.of_file(path).name
    documents = read_documents(path, dialect)
    try:
        return correction.read(documents, robot, cell, path.stem if name is None else name, dialect)
    except InputError as cause:
        raise cause.with_file(path.name, str(path)) from cause


def _result(
    job: Job, settings: Settings, cell: Cell, robot: RobotModel, program: Program
) -> tuple[Result, ProcessForces | None]:
    """Return the result, and what a process makes of the program."""
    mode, linearize, found = settings.mode, settings.linearize_arcs, None
    if job.process is None:
        source = None if job.forces is None else forces.read(job.forces)
        result = correction.process(program, robot, cell, source, mode, linearize_arcs=linearize, to=job.to)
    else:
        from postproc.jobs import process_forces  # what a cutter does is imported with it

        process = process_forces.read(job.process, cell)
        if mode == "predict":
            result, process = process_forces.predicted(program, robot, cell, process)
        else:
            result = correction.process(program, robot, cell, process, mode, linearize_arcs=linearize, to=job.to)
        found = process.found
    if job.forces is None and job.process is None:
        result = replace(result, issues=tuple(_with_file_beside(issue, job) for issue in result.issues))
    if job.keeps_text and job.name is not None:
        result = replace(result, documents=job.writer.renamed(result.documents, job.name))
    result = marked(result, job, settings, cell)
    fault = job.writer.fault_of(job.program.stem)
    if settings.mode != "predict" and not job.keeps_text and fault is not None:
        written = f"{job.stem}{job.writer.extension}"
        note = f"written as {written}: the controller does not accept the name {job.program.stem!r}, {fault}."
        result = replace(result, issues=(*result.issues, Issue("info", "name", note)))
    return result, found


def _with_file_beside(issue: Issue, job: Job) -> Issue:
    """Return an issue that forces are missing with the name of a force file that lies beside the program."""
    beside = job.program.with_name(f"{job.program.stem}.forces.csv")
    if issue.kind != "no-force" or not beside.is_file():
        return issue
    return replace(issue, message=f"{issue.message} ({beside.name} lies beside: give --forces {beside})")


class _Made(Struct, frozen=True, eq=False):
    """What is to be written for a program.

    :param contents: file name → content; `copied` names those that it needs and that are as they were.
    :param shared: what stands there of files that other programs need too.
    :param replaced: those of them that change.
    :param obsolete: files of an earlier run that go.
    """

    summary: Summary
    contents: dict[str, bytes | Iterable[bytes]]
    copied: tuple[str, ...]
    shared: dict[str, bytes | None]
    replaced: list[str]
    obsolete: list[str]


def _made(job: Job, settings: Settings, cell: Cell, result: Result, process: ProcessForces | None) -> _Made:
    """Return what is to be written.

    :raises InputError: it must not be, for what stands in the folder.
    """
    mode, needed = settings.mode, result.program.needed
    stated = mode == "convert" or settings.tolerance_mm is not None
    tolerance = cell.output.tolerance_mm * M_PER_MM if stated else None
    content = report.summary(result, tolerance, cell.part_tolerance)
    name = job.report(mode)
    stem = name.removesuffix("report.json")
    contents: dict[str, bytes | Iterable[bytes]] = {doc.name: doc.to_bytes() for doc in result.documents}
    copies = shared_files.copies(job, needed, contents, mode) if contents else {}
    contents |= copies
    carried = report.forces_csv(result)
    if carried is not None:
        contents[f"{stem}forces.csv"] = carried
    contents[f"{stem}targets.csv"] = report.targets_csv(result)
    surface = None
    if settings.part is not None and len(result):
        from postproc.jobs.part_file import surface_of  # meshes and trees of points are imported with it
        from postproc.report.surface import glb, ply

        surface = surface_of(result, settings.part, job.process, cell.part_in_root())
        for ending, made in (("ply", ply), ("glb", glb)):
            contents[f"{stem}surface.{ending}"] = made(surface, cell.tolerance)
    contents[f"{stem}report.html"] = report.page(result, tolerance, surface, process, cell.part_tolerance)
    if process is not None:
        from postproc.jobs import process_forces

        contents[f"{stem}stock.glb"] = process_forces.stock(process)
    documents = result.program.documents
    read = [Path(document.folder) / document.name for document in documents if document.folder]
    outputs.protect([*read, *(Path(each.path) for each in needed)], job.output, contents)  # files of subprograms too
    texts = {document.name: document.to_bytes() for document in result.documents if job.keeps_text} | copies
    shared = shared_files.check_shared(job, texts, subprograms(result, job), copies, documents, mode)
    same = [file for file, there in shared.items() if there == texts[file]]
    outputs.check_more(job, [*contents, name], mode, overwrite=settings.overwrite, same=same)
    still = [Path(each.path).name for each in needed if not each.moves]
    if beside := [file for file in copies if file in still]:
        content["copied"] = beside

    def rendered(entries: list[files.FileEntry]) -> bytes:
        content["files"] = entries
        return report.to_json(content)

    return _Made(
        summary=content,
        contents=files.with_record(contents, name, rendered),
        copied=tuple(copies),
        shared=shared,
        replaced=[file for file, there in shared.items() if there is not None and file not in same],
        obsolete=outputs.obsolete(job, [*contents, name], mode, overwrite=settings.overwrite),
    )


def failure(job: Job, cause: Exception) -> Outcome:
    """Return the outcome of a program that an exception ended."""
    program = str(job.program)
    if isinstance(cause, PostprocError):
        return Outcome(program, FAILED, message=str(cause))
    if isinstance(cause, MemoryError):
        return Outcome(
            program, FAILED, message=f"{program}: not enough memory. Use fewer --jobs, or split the program."
        )
    if isinstance(cause, OSError):  # of the machine, not of postproc
        return Outcome(program, FAILED, message=f"{program}: {cause}")
    told = "".join(traceback.format_exception(cause))
    return Outcome(program, FAILED, message=f"{program}: unexpected {type(cause).__name__}: {cause}", traceback=told)
