"""One program from file to files: read, corrected, marked with its provenance, staged."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import correction, files, forces, provenance, report
from postproc.cell import Cell
from postproc.correction import Result
from postproc.dialects import registry
from postproc.dialects.dialect import SubprogramCopies
from postproc.errors import InputError, Issue, PostprocError, ProgramError, SubprogramError
from postproc.forces import ForceSource
from postproc.frames import M_PER_MM, Array
from postproc.jobs import inputs
from postproc.jobs.output_plan import Task, copy_subprograms, differing_files, needed_copies, needed_warnings
from postproc.jobs.programs import (
    FAILED,
    GOOD,
    PROCESS,
    Job,
    Outcome,
    Settings,
    check_utf8,
    find_jobs,
)
from postproc.jobs.started_program import read_program, read_with_start
from postproc.program import Document, Ints, Motions, Program
from postproc.report import Summary
from postproc.report.record import Record, today
from postproc.report.summary import Inputs
from postproc.robot import RobotModel
from postproc.version import VERSION

_OPTIONS = ("tolerance_mm", "part_tolerance_mm", "lines_per_file", "linearize_arcs", "keep_unresolved")
"""Settings that a written program depends on in addition to its files."""


def options_of(settings: Settings) -> dict[str, str]:
    """Return the settings that the user gave, as text for the line of origin: name → value.

    A switch that is on is ``"1"``; a float has all its digits, so that the same settings give the same text.
    """
    values = {name: getattr(settings, name) for name in _OPTIONS}
    stated_values = {name: value for name, value in values.items() if value is not None and value is not False}
    return {name: repr(value) if isinstance(value, float) else f"{value:d}" for name, value in stated_values.items()}


def mark_origin(
    result: Result, job: Job, settings: Settings, cell: Cell, names_as_read: Mapping[str, str] | None = None
) -> Result:
    """Return a result whose program states its origin in a comment line; `output_line` counts the inserted lines.

    The line of origin has version, options and the checksums of all inputs, so that a written program can be traced. A
    program that is unchanged to the byte gets no such line, and a result without documents is returned as it is.

    :param names_as_read: new names of copies of subprograms → names as they were read; None: there are no copies.
    """
    if not result.documents or _file_contents(result.documents) == _file_contents(result.program.documents):
        return result
    mode: Literal["corrected", "nominal"] = "nominal" if settings.mode == "nominal" else "corrected"
    origin = origin_of(result.program.documents, settings.cell, cell, job.forces, mode)
    origin = replace(origin, options=options_of(settings))
    if result.modules:
        return _mark_modules(result, job, origin)
    documents, first_shifted_line = job.writer.mark(_mark_subprograms(result, job, origin, names_as_read or {}), origin)
    line = result.output_line
    if first_shifted_line:  # lines from this one on have moved down by the inserted line; 0: no line has moved
        line = line + (line >= first_shifted_line)
    return replace(result, documents=documents, output_line=line)


def _file_contents(documents: Sequence[Document]) -> list[tuple[bytes, str, str]]:
    """Return byte-order mark, encoding and text of each file; programs with equal ones are equal to the byte."""
    return [(document.bom, document.encoding, document.text) for document in documents]


def _mark_modules(result: Result, job: Job, origin: provenance.Origin) -> Result:
    """Return a result whose modules state their origin, their number from 1, and the number of modules.

    `Result.modules` has the index of the first target of each module.
    """
    documents, line, count = list[Document](), result.output_line.copy(), len(result.modules)
    for number, (document, first_target) in enumerate(zip(result.documents, result.modules, strict=True), start=1):
        options = {**origin.options, "module": str(number), "modules": str(count)}
        documents += job.writer.mark([document], replace(origin, options=options))[0]
        line[first_target:] += 1  # the line of origin is inserted at the top of the module
    return replace(result, documents=tuple(documents), output_line=line)


def subprogram_file_names(result: Result, job: Job, names_as_read: Mapping[str, str]) -> list[str]:
    """Return the names of the written files that contain only subprograms, not the program of the job itself.

    :param names_as_read: new names of copies of subprograms → names as they were read.
    """
    job_files = {path.name for path in job.input_files()}
    called_files = {document.name for document in result.program.documents} - job_files
    return [
        document.name
        for document in result.documents
        if names_as_read.get(document.name, document.name) in called_files
    ]


def _mark_subprograms(
    result: Result, job: Job, origin: provenance.Origin, names_as_read: Mapping[str, str]
) -> list[Document]:
    """Return the files of a program, with a line of origin in each file of a subprogram that differs from its source.

    That line does not name the calling program, so that two programs that call one subprogram can share its file.

    :param names_as_read: new names of copies of subprograms → names as they were read.
    """
    documents_as_read = {document.name: document for document in result.program.documents}
    output_documents = {document.name: document for document in result.documents}
    for name in subprogram_file_names(result, job, names_as_read):
        if Path(name).suffix.lower() != job.writer.extension:
            continue  # a .dat is marked with its .src
        stem = Path(name).stem.lower()
        file_names = [name, *(file for file in output_documents if file != name and Path(file).stem.lower() == stem)]
        sources = [documents_as_read[names_as_read.get(file, file)] for file in file_names]
        outputs = [output_documents[file] for file in file_names]
        if any(source.text != output.text for source, output in zip(sources, outputs, strict=True)):
            subprogram_origin = replace(origin, source=provenance.digest_of(sources), forces="-", options={})
            # the line of origin is in the first file, the .src
            output_documents[name] = job.writer.mark(outputs, subprogram_origin)[0][0]
    return list(output_documents.values())


def origin_of(
    source: Sequence[Document], path: Path, cell: Cell, forces: Path | None, mode: Literal["corrected", "nominal"]
) -> provenance.Origin:
    """Return the provenance of a program that is made from the present inputs: version, mode, checksums.

    :param source: files of the program as they were read.
    :param path: cell file; `cell`: its content.
    :param forces: CSV file or process.toml; None: there are no forces, and their checksum is "-".
    """
    return provenance.Origin(
        version=VERSION,
        mode=mode,
        source=provenance.digest_of(source),
        cell=inputs.sum_of(inputs.cell_inputs(path, cell)),
        model=inputs.sum_of(inputs.robot_inputs(cell)),
        forces="-" if forces is None else inputs.sum_of(inputs.force_inputs(forces)),
    )


def _report_inputs(origin: provenance.Origin, program: Program, output: Path) -> Inputs:
    """Return the inputs of a result as its report in the folder `output` states them.

    Names of files are relative to this folder. Without needed files their checksum is "-".
    """
    needed_files = [Path(file.path) for file in program.needed]
    return Inputs(
        program=origin.source,
        program_files=[inputs.relative_name(Path(file.folder) / file.name, output) for file in program.documents],
        needed=inputs.sum_of(needed_files) if needed_files else "-",
        needed_files=[inputs.relative_name(path, output) for path in needed_files],
        cell=origin.cell,
        model=origin.model,
        forces=origin.forces,
        version=origin.version,
    )


def _check_unchanged(origin: provenance.Origin, summary: Summary) -> None:
    """Check that cell, robot model and forces have not changed during the conversion.

    :param origin: checksums before the conversion; `summary`: states the checksums after it.
    :raises InputError: a file was changed meanwhile.
    """
    inputs = summary.inputs
    if inputs is not None and (inputs.cell, inputs.model, inputs.forces) != (origin.cell, origin.model, origin.forces):
        problem = "the cell, the robot model or the forces were changed while the program was converted"
        raise InputError(problem, file=summary.program, advice="Convert it again.")


def _report_record(origin: provenance.Origin, path: Path, cell: Cell) -> Record:
    """Return the record for the head of the report: title, customer, checksums of the inputs, date of today.

    :param path: cell file; `cell`: its content.
    """
    sums = {"program": origin.source, "cell": origin.cell, "robot model": origin.model, "forces": origin.forces}
    return Record(cell.report.title, cell.report.customer, path.name, sums, today())


if TYPE_CHECKING:
    from postproc.machining import ProcessForces
    from postproc.machining.tool import Cutter
    from postproc.report.surface import Surface


def convert(
    task: Task, settings: Settings, cell: Cell, robot: RobotModel, progress: Callable[[int, int], None] | None = None
) -> Outcome:
    """Convert or predict one program and stage its files (`Outcome.staged_files`).

    An error of any kind becomes the outcome of this program, not an exception; a fault of postproc too. A subprogram
    that the user did not name, and that cannot be read alone, is skipped: the programs that call it convert it.

    :param progress: called during sweeps of the stock, see `process_forces.read`; None: not reported.
    :raises KeyboardInterrupt: nothing was staged.
    """
    job = task.job
    is_computed = False  # True: only the staging of the files can fail, and the files of an earlier run stay
    try:
        check_utf8(job.program)
        name, setup_cell = None if job.keeps_text else job.stem, cell  # the cell before the start of the program
        origin = origin_of((), settings.cell, cell, job.forces, "corrected")
        program, cell = read_with_start(job.program, robot, cell, job.dialect, name)
        result, process = convert_program(job, settings, cell, robot, program, progress)
        if result.failed:
            return Outcome(str(job.program), FAILED, issues=result.issues)
        if job.same_stock:
            from postproc.jobs.shared_stock import shared_stock_issues  # late: it loads the models of cutting

            result = replace(result, issues=(*result.issues, *shared_stock_issues(job, robot, setup_cell)))
        output = _output_of(job, settings, cell, _add_subprograms(task, settings, cell, robot, result), process)
        _check_unchanged(origin, output.summary)
        is_computed = True
        staged_files = files.stage(job.output, output.contents)
    except Exception as cause:
        if isinstance(cause, SubprogramError) and not job.is_named_by_user:
            return Outcome(str(job.program), GOOD, message=f"{cause.file}: {cause.problem}: skipped.")
        return replace(failure(job, cause), keeps_old_files=is_computed)
    return Outcome(
        str(job.program),
        output.summary.verdict.exit_code,
        replace(output.summary, files=output.listed_files),
        copied_files=tuple(str(job.output / name) for name in output.copied_files),
        staged_files=staged_files,
        shared_files=output.shared_files,
        read=output.read,
    )


def force_source(path: Path | None, cell: Cell) -> ForceSource | None:
    """Return the source of forces in a file, `path`: a table of forces, or a process.toml; None without a file.

    :raises ForceError: the file is unusable.
    """
    if path is None or path.suffix.lower() != PROCESS:
        return None if path is None else forces.read(path)
    from postproc.jobs import process_forces  # late: it loads the models of cutting

    return process_forces.read(path, cell)


def programs_under_force(
    programs: Sequence[str], force_path: Path | None, robot: RobotModel, cell: Cell
) -> Iterator[tuple[Path, Program, ForceSource | None]]:
    """Yield path, program and source of forces of each program.

    Subprograms that other programs call are left out: they are read as parts of their callers.

    :param programs: files, folders, patterns.
    :param force_path: CSV file of forces, a folder of such files, or process.toml they are computed from.
    :raises PostprocError: a program or its forces cannot be read.
    """
    for job in find_jobs(programs, forces=force_path):
        check_utf8(job.program)
        if not job.callers:
            yield job.program, read_program(job.program, robot, cell, job.dialect), force_source(job.forces, cell)


def convert_program(
    job: Job,
    settings: Settings,
    cell: Cell,
    robot: RobotModel,
    program: Program,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Result, ProcessForces | None]:
    """Return the result of one program before anything is written, and the forces that its process computes.

    The forces are None without a process, and if the program has an error that was found before they were computed.

    :param program: program of the job, as `read_with_start` returns it with the cell.
    :param progress: called during sweeps of the stock, see `process_forces.read`; None: not reported.
    :raises PostprocError: forces are unusable, or the program cannot be corrected.
    """
    mode, linearize = settings.mode, settings.linearize_arcs
    if mode == "convert" and cell.output.feed == "hold":
        check_held_feed(cell, process=job.process is not None)
    computed_forces: ProcessForces | None = None
    if job.process is None:
        source = force_source(job.forces, cell)
        result = correction.process(program, robot, cell, source, mode=mode, linearize_arcs=linearize, to=job.to)
    else:
        result, computed_forces = _convert_with_process(
            job, settings, cell, robot, program, process=job.process, progress=progress
        )
    if job.forces is None and job.process is None:
        result = replace(result, issues=tuple(_name_force_file(issue, job) for issue in result.issues))
    return _under_job_name(result, job, settings), computed_forces


def _convert_with_process(
    job: Job,
    settings: Settings,
    cell: Cell,
    robot: RobotModel,
    program: Program,
    *,
    process: Path,
    progress: Callable[[int, int], None] | None,
) -> tuple[Result, ProcessForces | None]:
    """Return the result of a program under the forces of its process, and these forces.

    "predict" cuts with the deflected tool; "convert" holds the tolerance by the feeds if the cell says so. The forces
    are None if they were not computed: the program has an error that was found before.

    :param process: process.toml; other parameters: see `convert_program`.
    :raises PostprocError: the process is unusable, or the program cannot be corrected.
    """
    from postproc.jobs import process_forces  # late: it loads the models of cutting

    linearize, source = settings.linearize_arcs, process_forces.read(process, cell, progress)
    if settings.mode == "predict":
        result, source = process_forces.predict_in_material(program, robot, cell, source)
    elif settings.mode == "convert" and cell.output.feed == "hold":
        result = process_forces.convert_with_held_feed(
            program, robot, cell, source, linearize_arcs=linearize, to=job.to
        )
    else:
        result = process_forces.at_written_feed(
            program, robot, cell, source, settings.mode, linearize_arcs=linearize, to=job.to
        )
    return result, source.process_forces


def _under_job_name(result: Result, job: Job, settings: Settings) -> Result:
    """Return a result under the name of its job.

    A robot program whose text is kept is renamed if the job has a name. A new program already has a valid name: a note
    is added if the controller does not accept the name of its source.
    """
    if job.keeps_text and job.name is not None:
        result = replace(result, documents=job.writer.rename(result.documents, job.name))
    name = registry.program_name(job.program)
    fault = job.writer.fault_of(name)
    if settings.mode == "predict" or job.keeps_text or fault is None:
        return result
    file_name = f"{job.stem}{job.writer.extension}"
    note = f"written as {file_name}: the controller does not accept the name {name!r}, {fault}."
    return replace(result, issues=(*result.issues, Issue("info", "name", note)))


def check_held_feed(cell: Cell, *, process: bool) -> None:
    """Check that the inputs for held feeds are there: a tolerance of the part, and a process.

    :param process: whether the forces come from a process.
    :raises InputError: one of them is missing.
    """
    if cell.part_tolerance is None:
        advice = "Give tolerance_mm in [part] of the cell, or --part-tolerance."
        raise InputError('[output] feed = "hold" without a tolerance of the part', advice=advice)
    if not process:
        advice = 'Give --process process.toml: only it says how forces depend on the feed. Or write feed = "program".'
        raise InputError('[output] feed = "hold" without a process', advice=advice)


def _name_force_file(issue: Issue, job: Job) -> Issue:
    """Return an issue; one that says that forces are missing names the force file next to the program, if it exists."""
    force_file = job.program.with_name(f"{registry.program_name(job.program)}.forces.csv")
    if issue.kind != "no-force" or not force_file.is_file():
        return issue
    return replace(
        issue, message=f"{issue.message} (give --forces {force_file} to use {force_file.name}, which is next to it)"
    )


class _ProgramOutput(Struct, frozen=True, eq=False):
    """Output of a program, before it is written.

    :param summary: content of `report.json` without its list of files.
    :param listed_files: the list of files of `report.json`; it is filled when `contents` are written.
    :param contents: file name → content.
    :param copied_files: names of files that the program needs and that are written as they were read.
    :param shared_files: names of files that other programs may need too.
    :param read: files that were read.
    """

    summary: Summary
    listed_files: list[files.FileEntry]
    contents: dict[str, bytes | Iterable[bytes]]
    copied_files: tuple[str, ...]
    shared_files: tuple[str, ...]
    read: tuple[str, ...]


def _output_of(
    job: Job,
    settings: Settings,
    cell: Cell,
    marked_output: _MarkedResult,
    process: ProcessForces | None,
) -> _ProgramOutput:
    """Return the files to write for a result: programs, tables, report and pictures.

    :param process: forces that the process computes; None: there is no process, or they were not computed.
    :raises InputError: the mesh of the part is unusable.
    """
    result, needed_files = marked_output.result, marked_output.result.program.needed
    surface = None
    if settings.part is not None and len(result):
        surface = surface_of(result, settings.part, job.process, cell.part_in_root())
    origin = origin_of(result.program.documents, settings.cell, cell, job.forces, "corrected")
    tolerance = _judged_tolerance(settings, cell)
    summary = replace(
        report.summary(result, tolerance=tolerance, part_tolerance=cell.part_tolerance, surface=surface),
        copied=_motionless_copies(marked_output) or None,
        inputs=_report_inputs(origin, result.program, job.output),
    )
    report_name = job.report_name(settings.mode)
    stem = report_name.removesuffix("report.json")
    contents: dict[str, bytes | Iterable[bytes]] = {doc.name: doc.pieces() for doc in result.documents}
    contents |= marked_output.copies
    contents |= _tables_of(result, stem)
    if surface is not None:
        contents |= _surface_files(surface, cell.tolerance, stem)
    record = _report_record(origin, settings.cell, cell)
    contents[f"{stem}report.html"] = report.page(
        result,
        tolerance,
        surface=surface,
        process=process,
        part_tolerance=cell.part_tolerance,
        stem=stem,
        record=record,
    )
    if process is not None:
        from postproc.jobs import process_forces  # late: it loads the models of cutting

        contents[f"{stem}stock.glb"] = process_forces.stock_glb(process)
    file_entries: list[files.FileEntry] = []

    def rendered(entries: list[files.FileEntry]) -> bytes:
        """Return the content of `report.json` with a list of files, and add the list to `file_entries`."""
        file_entries.extend(entries)
        return files.json_bytes(replace(summary, files=entries))

    sources = [Path(document.folder) / document.name for document in result.program.documents if document.folder]
    return _ProgramOutput(
        summary=summary,
        listed_files=file_entries,
        contents=files.add_record(contents, report_name, rendered),
        copied_files=tuple(marked_output.copies),
        shared_files=(*marked_output.subprogram_files, *marked_output.copies),
        read=tuple(map(str, [*sources, *(file.path for file in needed_files)])),
    )


def _motionless_copies(marked_output: _MarkedResult) -> list[str]:
    """Return the names of the files that are written as they were read, and that have no motions."""
    motionless_names = {Path(file.path).name for file in marked_output.result.program.needed if not file.moves}
    return [name for name in marked_output.copies if name in motionless_names]


def _judged_tolerance(settings: Settings, cell: Cell) -> float | None:
    """Return the tolerance of the path [m] by which a report judges.

    None: the program is not corrected, and the user gave no tolerance, so there is none to hold.
    """
    if settings.mode != "convert" and settings.tolerance_mm is None:
        return None
    return cell.output.tolerance_mm * M_PER_MM


def _surface_files(surface: Surface, tolerance: float, stem: str) -> dict[str, bytes | Iterable[bytes]]:
    """Return the files of a surface: file name → content.

    :param tolerance: tolerance of the path [m], for the colours; `stem`: see `_tables_of`.
    """
    from postproc.report.surface import glb, ply  # late: only reports of surfaces need it

    return {f"{stem}surface.{ending}": encode(surface, tolerance) for ending, encode in (("ply", ply), ("glb", glb))}


def _tables_of(result: Result, stem: str) -> dict[str, bytes | Iterable[bytes]]:
    """Return the tables of forces and targets: file name → content.

    :param stem: beginning of the names, with a full stop at its end.
    """
    tables: dict[str, bytes | Iterable[bytes]] = {}
    if result.modules:
        tables |= report.forces_by_module(result)
    elif (force_table := report.forces_csv(result)) is not None:
        tables[f"{stem}forces.csv"] = force_table
    return tables | {f"{stem}targets.csv": report.targets_csv(result)}


def surface_of(result: Result, part: Path, process: Path | None, mesh_frame: Array | None = None) -> Surface:
    """Return the deviations along the surface of a part.

    :param part: mesh in mm (STL, PLY, OBJ …).
    :param process: process.toml whose [tools] state the shapes of the cutters; None: shapes are not known, and the
        deviation of a point is that of the nearest sample of the path.
    :param mesh_frame: (4, 4) frame of the mesh in the robot root [m]; None: it is in the `$BASE` of the program.
    :raises InputError: the mesh or the process is unusable, or its frame is not stated and there are several `$BASE`.
    """
    corners, facet_error = files.read_facets(part)
    if mesh_frame is None and len(result.program.bases) > 1:
        raise InputError(
            "the program has several $BASE: to which the part belongs is not known",
            file=str(part),
            advice="State the frame of the mesh in the robot root in the cell: [part] with X, Y, Z, A, B, C.",
        )
    from postproc.report.surface import surface  # late: it imports trees of points

    cutters: dict[int, Cutter] | None = None
    tool_of_target: Ints | None = None
    if process is not None:
        from postproc import machining
        from postproc.machining.tool import Cutter
        from postproc.machining.tool_path import cutter_entries

        process_file = machining.load(process)
        tool_of_target = cutter_entries(result.program, process_file)[result.motion]
        cutters = {}
        for entry, tool in enumerate(process_file.tools.values()):
            radius = 0.5 * tool.diameter_mm * M_PER_MM
            corner = radius if tool.shape == "ball" else tool.corner_radius_mm * M_PER_MM
            cutters[entry] = Cutter(radius, corner, tool.flutes)
    return surface(
        result,
        corners=corners,
        cutters=cutters,
        mesh_frame=mesh_frame,
        facet_error=facet_error,
        tool=tool_of_target,
    )


class _MarkedResult(NamedTuple):
    """A result with its line of origin and the files of its subprograms.

    :param result: the result with its documents as they are written.
    :param subprogram_files: names of the files that contain only subprograms.
    :param copies: files that are written as they were read: name → content.
    """

    result: Result
    subprogram_files: list[str]
    copies: dict[str, bytes]


def _add_subprograms(task: Task, settings: Settings, cell: Cell, robot: RobotModel, result: Result) -> _MarkedResult:
    """Return a result with its line of origin, and with subprograms that do not clash with those of other programs.

    A subprogram that was written differently for another program is written under another name. Each renaming may
    cause new clashes, so this is repeated until there are none.

    :raises InputError: see `output_plan.copy_subprograms`.
    """
    job, read = task.job, result.program.documents
    names_as_read: dict[str, str] = {}
    while True:
        marked_result = mark_origin(result, job, settings, cell, names_as_read)
        subprogram_files = subprogram_file_names(result, job, names_as_read)
        if not marked_result.documents or settings.mode == "predict":
            return _MarkedResult(marked_result, subprogram_files, {})
        names = [document.name for document in marked_result.documents]
        copies = needed_copies(task, result.program.needed, [*names, *names_as_read.values()])
        texts = {document.name: document.to_bytes() for document in marked_result.documents} if job.keeps_text else {}
        conflicts = differing_files(task, texts | copies, subprogram_files, copies, read)
        if not conflicts:
            warnings = needed_warnings(task, result.program.needed, copies, texts | copies)
            issues = (*_without_callers_of_run(marked_result.issues, task), *warnings)
            return _MarkedResult(replace(marked_result, issues=issues), subprogram_files, copies)
        renamed = copy_subprograms(task, result.documents, conflicts, subprogram_files, copies)
        _check_same_motions(result, renamed.documents, robot, cell)
        names_as_read |= {new: names_as_read.get(old, old) for new, old in renamed.file_names.items()}
        issues = _issues_of_copies(result.issues, renamed, conflicts)
        result = replace(result, documents=renamed.documents, issues=issues)


def _issues_of_copies(
    issues: Sequence[Issue], renamed: SubprogramCopies, conflicts: Mapping[str, str]
) -> tuple[Issue, ...]:
    """Return the issues of a program after subprograms were renamed, with a note for each renamed one.

    Issues that a renamed file is shared with other programs are left out. An issue that a routine was copied names the
    copy as it is called now.

    :param conflicts: file name → program for which it was written differently.
    """
    kept_issues = [
        _issue_of_renamed_routine(issue, renamed.routine_names)
        for issue in issues
        if issue.kind != "shared-file" or issue.subject.partition(", ")[0] not in renamed.file_names.values()
    ]
    for new, old in sorted(renamed.file_names.items()):
        if old in conflicts:
            note = f"{old} is written as {new}: it differs from the one written for {conflicts[old]}."
            kept_issues.append(Issue("info", "own-copy", note))
    return tuple(kept_issues)


def _issue_of_renamed_routine(issue: Issue, new_names: Mapping[str, str]) -> Issue:
    """Return an issue that names a copied routine with the new name of the copy; unchanged if it has none.

    :param new_names: old name of a routine, upper case → new name.
    """
    new_name = new_names.get(issue.subject.upper()) if issue.kind == "routine-copied" else None
    if new_name is None:
        return issue
    return replace(issue, subject=new_name, message=issue.message.replace(f"{issue.subject}()", f"{new_name}()"))


def _without_callers_of_run(issues: Sequence[Issue], task: Task) -> list[Issue]:
    """Return issues without those that a file is shared with a program which the run converts too.

    That program gets the same file, or one of its own if its corrections differ.
    """
    return [
        issue
        for issue in issues
        if issue.kind != "shared-file" or PurePath(issue.subject.partition(", ")[2]).stem.lower() not in task.names
    ]


def _check_same_motions(result: Result, new_documents: Sequence[Document], robot: RobotModel, cell: Cell) -> None:
    """Check, by reading both versions, that a program moves as before after subprograms were renamed in it.

    :param result: the result with the documents before the renaming; `new_documents`: the documents after it.
    :raises InputError: motions or numbers differ, or the renamed program cannot be read.
    """
    name, dialect = result.program.name, result.program.dialect
    try:
        first_program, second_program = (
            correction.read(documents, robot, cell, name, dialect) for documents in (result.documents, new_documents)
        )
        pairs = [
            (getattr(first_program.motions, field), getattr(second_program.motions, field))
            for field in Motions.__struct_fields__
        ]
        pairs.append((first_program.numbers_as_written(), second_program.numbers_as_written()))
        is_same = all(np.array_equal(first, second, equal_nan=True) for first, second in pairs)
    except ProgramError:
        is_same = False
    if not is_same:
        old_names, new_names = (
            {document.name for document in documents} for documents in (result.documents, new_documents)
        )
        names = ", ".join(sorted(new_names - old_names))
        raise InputError(
            f"with subprograms under names of their own ({names}) the program would move differently",
            file=result.documents[0].name,
            advice="Write this program into another folder with -o, and report this fault of postproc, please.",
        )


def failure(job: Job, cause: Exception) -> Outcome:
    """Return the outcome of a program whose conversion an exception ended.

    Errors of inputs, lack of memory and errors of the system give a message. Any other exception is a fault of
    postproc: its outcome has the traceback too.
    """
    program = str(job.program)
    if isinstance(cause, InputError):
        cause = cause.with_file(job.program.name, program)  # the errors of one program name it alike
    if isinstance(cause, PostprocError):
        return Outcome(program, FAILED, message=str(cause))
    if isinstance(cause, MemoryError):
        return Outcome(
            program, FAILED, message=f"{program}: not enough memory. Use fewer --jobs, or split the program."
        )
    if isinstance(cause, OSError):  # of the machine, not of postproc
        return Outcome(program, FAILED, message=f"{program}: {cause}")
    text = "".join(traceback.format_exception(cause))
    return Outcome(program, FAILED, message=f"{program}: unexpected {type(cause).__name__}: {cause}", traceback=text)
