"""Files of `postproc forces` (forces of a program) and of `postproc identify forces` (cutting coefficients)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from msgspec import Struct

from postproc import cell as cells
from postproc import machining, toolpath
from postproc.errors import ForceError, InputError, Issue
from postproc.files import foreign, foreign_single, refuse, with_record, write_whole
from postproc.forces import Knots
from postproc.jobs.conversion import read_started
from postproc.jobs.output_plan import protect
from postproc.jobs.programs import load_robot
from postproc.machining import Process, ProcessForces, identification
from postproc.machining.identification import IdentifiedMaterial
from postproc.machining.stock import as_trimesh
from postproc.program import Program
from postproc.report import process_forces
from postproc.report.material import material_page
from postproc.under_load import RobotInCell

_MESHES = (".stl", ".glb", ".ply", ".obj")


class ForcesRequest(Struct, frozen=True, kw_only=True):
    """What forces are made from, and where they are written.

    :param program: file.
    :param process: process.toml.
    :param output: CSV file to write; a JSON file of the same name is written next to it.
    :param stock: mesh, instead of the stock of the process.
    :param stock_out: file for the remaining stock.
    :param base_axes: wrenches in `$BASE` axes, not FEED.
    """

    program: Path
    cell: Path
    process: Path
    output: Path
    stock: Path | None = None
    stock_out: Path | None = None
    base_axes: bool = False
    dialect: str | None = None
    overwrite: bool = False


class ForcesFiles(Struct, frozen=True, eq=False):
    """Forces as they were written: the summary, what the user should know, and the files."""

    summary: process_forces.ForcesSummary
    issues: tuple[Issue, ...]
    written: tuple[Path, ...]


def make_forces(request: ForcesRequest, progress: Callable[[int, int], None] | None = None) -> ForcesFiles:
    """Compute the forces of a program and write them, whole or not at all.

    :raises PostprocError: an input is unusable, or an output must not be written.
    """
    process = machining.load(request.process)
    cell = cells.load(request.cell)
    robot = load_robot(cell.robot, cell.folder)
    program, cell = read_started(request.program, robot, cell, request.dialect)
    place = RobotInCell.of(robot, cell)
    path = toolpath.segments(program, place.start_flange)
    folder, names = _names(request)
    protect(filter(None, (request.program, request.cell, request.process, request.stock)), folder, names)
    if not request.overwrite:
        refuse(foreign(folder, names, names[-1]))
    found = None
    if process.material is not None:
        found = machining.estimate(
            program,
            path,
            process,
            place.spindle,
            stock=request.stock,
            base_axes=request.base_axes,
            progress=progress,
        )
    knots = _knots(program, process, found)
    content = process_forces.summary(program, found, int(knots.ramped.sum()))
    rows = machining.one_move_a_line(program, path, place.spindle, knots)
    contents: dict[str, bytes | Iterable[bytes]] = {names[0]: process_forces.forces_csv(program, rows)}
    if request.stock_out is not None:
        if found is None:
            raise InputError(
                "--stock-out without [material]", advice="The remaining stock is known only where the tool is swept."
            )
        mesh = as_trimesh(*found.mesh())
        contents[names[1]] = bytes(mesh.export(file_type=request.stock_out.suffix[1:].lower()))
    issues = () if found is None else found.issues
    record = with_record(contents, names[-1], lambda entries: process_forces.finished(content, issues, entries))
    return ForcesFiles(content, issues, tuple(write_whole(folder, record)))


def _names(request: ForcesRequest) -> tuple[Path, list[str]]:
    folder, names = request.output.parent, [request.output.name]
    if request.stock_out is not None:
        if request.stock_out.parent.resolve() != folder.resolve():
            raise InputError(
                "-o and --stock-out are in different folders", advice="They are written together: give one."
            )
        if request.stock_out.suffix.lower() not in _MESHES:
            advice = f"Known: {', '.join(_MESHES)}."
            raise InputError(f"--stock-out {request.stock_out.name}: not a kind of mesh file", advice=advice)
        names.append(request.stock_out.name)
    return folder, [*names, f"{request.output.stem}.json"]


def _knots(program: Program, process: Process, found: ProcessForces | None) -> Knots:
    """Return the forces of all moves; those of operations take precedence."""
    if found is None:
        return machining.by_operation(program, process)
    return machining.by_operation(program, process).over(found.along) if process.operations else found.along


def identify_forces(
    measured: Path, process: Path, output: Path, tool: int | None, *, overwrite: bool = False
) -> tuple[IdentifiedMaterial, list[Path]]:
    """Identify cutting coefficients, and write them as TOML with a page of the same name.

    :param measured: CSV file of readings.
    :param process: process.toml with the tool.
    :param tool: number of the tool; None: the only one.
    :raises PostprocError: the readings are unusable, or the file must not be replaced.
    """
    page = output.with_suffix(".html")
    protect([measured, process], output.parent, [output.name, page.name])
    if not overwrite:
        refuse(foreign_single(output))
    given = machining.load(process, tools_only=True)
    _, entry = identification.tool_of(given, tool)
    readings = identification.read(measured)
    found = identification.identify(readings, entry, given.material, str(measured))
    contents = {
        output.name: identification.as_toml(found, entry, measured.name),
        page.name: material_page(found, readings, measured.name),
    }
    return found, write_whole(output.parent, contents)


def propose_cuts(process: Path, output: Path, tool: int | None, *, overwrite: bool = False) -> list[Path]:
    """Write test cuts as G-code, and the CSV file to fill in next to it.

    :raises PostprocError: the process has no such tool, or a file must not be replaced.
    """
    given = machining.load(process, tools_only=True)
    key, entry = identification.tool_of(given, tool)
    table = output.with_suffix(".csv")
    protect([process], output.parent, [output.name, table.name])
    there = [path for path in (output, table) if path.exists()]
    if there and not overwrite:
        raise ForceError("this file exists", file=str(there[0]), advice="Give another name, or --overwrite.")
    program, rows = identification.proposal(given, key, entry)
    return write_whole(output.parent, {output.name: program, table.name: rows})
