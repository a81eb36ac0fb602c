"""`postproc forces`: from a program and its process to a file of forces."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from msgspec import Struct

from postproc import cell as cells
from postproc import machining, toolpath
from postproc.errors import InputError, Issue
from postproc.files import foreign, refuse, with_record, write_whole
from postproc.forces import Knots
from postproc.jobs.conversion import read_program
from postproc.jobs.output_plan import protect
from postproc.jobs.settings import load_robot
from postproc.machining import Process, ProcessForces
from postproc.machining.stock import as_trimesh
from postproc.program import Program
from postproc.report import process_forces
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
    program = read_program(request.program, robot, cell, request.dialect)
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
