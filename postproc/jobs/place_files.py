"""`postproc place`: from programs and a region to the place of the part."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import msgspec
from msgspec import Struct

from postproc import cell as cells
from postproc.cell import Cell
from postproc.errors import InputError, did_you_mean
from postproc.files import foreign, refuse, with_record, write_whole
from postproc.frames import RAD_PER_DEG
from postproc.jobs.conversion import programs_under_force, read_program, read_started
from postproc.jobs.output_plan import protect
from postproc.jobs.programs import find_jobs, load_robot
from postproc.placement import Keep, PathSamples, region
from postproc.placement.region import AXES, Region
from postproc.report import placement as report
from postproc.robot import RobotModel
from postproc.under_load import RobotInCell

FILES = ("place.csv", "place.html", "place.toml", "place.json")
"""Files of a search, the record last."""
_AROUND = {"X": 400.0, "Y": 400.0, "Z": 200.0, "A": 45.0}
"""Without a region the place may change by this [mm, deg]."""
_FARTHEST = 1e5
"""Largest bound of a region [mm, deg]."""
_BOUNDS = re.compile(r"\s*(\w+)\s*=\s*([-+.\deE]+)\s*:\s*([-+.\deE]+)\s*")


class PlaceRequest(Struct, frozen=True, kw_only=True):
    """What a place is looked for with, and where the result is written.

    :param programs: files, folders, patterns.
    :param forces: file of forces, or a folder of such files; `process` computes them instead.
    :param region: bounds as ``X=1200:2000,Y=-600:600,A=-90:90``; other axes stay as in the cell.
    :param margin_deg: distance to joint limits to keep.
    :param clearance_mm: distance of the bodies of [collision] to keep; None: that of the cell.
    """

    programs: tuple[str, ...]
    cell: Path
    output: Path
    forces: Path | None = None
    process: Path | None = None
    region: str | None = None
    margin_deg: float = 5.0
    clearance_mm: float | None = None
    overwrite: bool = False


class PlaceFiles(Struct, frozen=True, eq=False):
    """A search as it was written: its summary, and the files."""

    summary: report.PlaceSummary
    written: tuple[Path, ...]


def make_place(request: PlaceRequest, progress: Callable[[int, int], None] | None = None) -> PlaceFiles:
    """Look for the best place of the part and write the result, whole or not at all.

    :raises PostprocError: an input is unusable, a program has a `$BASE` of its own, or an output must not be written.
    """
    cell = cells.load(request.cell)
    robot = load_robot(cell.robot, cell.folder)
    bounds = region_of(request.region, cell)
    given = [Path(each) for each in request.programs]
    protect([*given, request.cell, *filter(None, (request.forces, request.process))], request.output, FILES)
    if not request.overwrite:
        refuse(foreign(request.output, FILES, FILES[-1]))
    cell, said = _started(request, cell, robot)
    samples, names = _samples(request, cell, robot)
    turns = cell.gcode.redundancy != "constant" and not any(each.program.keeps_text for each in samples)
    keep, clearance = Keep(joint=request.margin_deg * RAD_PER_DEG), _clearance(request, cell)
    programs = region.Programs(samples, keep, turns=turns, clearance_mm=clearance)
    found = region.search(programs, bounds, progress)
    content = report.summary(found, cell, names, request.margin_deg, clearance, bounds, said)
    contents: dict[str, bytes | Iterable[bytes]] = {
        FILES[0]: report.places_csv(found),
        FILES[1]: report.page(found, content),
    }
    if found.best is not None:
        contents[FILES[2]] = report.base_toml(found, cell, content)
    written = write_whole(
        request.output, with_record(contents, FILES[-1], lambda entries: report.finished(content, entries))
    )
    return PlaceFiles(content, tuple(written))


def _clearance(request: PlaceRequest, cell: Cell) -> float | None:
    """Return the distance to keep [mm]; None: the cell has no bodies."""
    if cell.collision is not None:
        return cell.collision.clearance_mm if request.clearance_mm is None else request.clearance_mm
    if request.clearance_mm is not None:
        advice = "Describe holder and obstacles under [collision] in the cell, or leave --clearance-mm out."
        raise InputError("--clearance-mm: the cell has no [collision]", file=str(request.cell), advice=advice)
    return None


def region_of(text: str | None, cell: Cell) -> Region:
    """Return the region that a text names; what it does not name stays as the cell has it.

    :raises InputError: it cannot be read.
    """
    today = {"X": cell.base.X, "Y": cell.base.Y, "Z": cell.base.Z, "A": cell.base.A, "E1": 0.0}
    low, high = dict(today), dict(today)
    if text is None:
        for axis, reach in _AROUND.items():
            low[axis], high[axis] = today[axis] - reach, today[axis] + reach
    for part in () if text is None else text.split(","):
        axis, one, other = _bounds(part)
        low[axis], high[axis] = one, other
    if high["E1"] > low["E1"] and cell.carriage is None:
        raise InputError("--region names E1, but the cell has no [external_axes.E1]", advice="Leave E1 out.")
    return Region(tuple(low[axis] for axis in AXES), tuple(high[axis] for axis in AXES))


def _bounds(part: str) -> tuple[str, float, float]:
    """Return axis, lower and upper bound of one part of --region."""
    found = _BOUNDS.fullmatch(part)
    advice = f"Write --region X=1200:2000,Y=-600:600,A=-90:90, the smaller number first; axes: {', '.join(AXES)}."
    where = f"--region {part.strip()!r}"
    try:
        axis, one, other = "" if found is None else found[1], *map(float, () if found is None else found.groups()[1:])
    except ValueError:
        raise InputError(f"{where}: not AXIS=LOW:HIGH with numbers in mm or degrees", advice=advice) from None
    if axis not in AXES:
        raise InputError(f"{where}: no axis {axis!r}", advice=f"{did_you_mean(axis, AXES)} {advice}".lstrip())
    if one > other:
        raise InputError(f"{where}: {one:g} is larger than {other:g}", advice=advice)
    if max(abs(one), abs(other)) > _FARTHEST:
        raise InputError(f"{where}: farther than {_FARTHEST:g}", advice=advice)
    return axis, one, other


def _started(request: PlaceRequest, cell: Cell, robot: RobotModel) -> tuple[Cell, str | None]:
    """Return a cell with [start]: its own, or the one of the first program, and how that was chosen."""
    if cell.start is not None:
        return cell, None
    job = next(job for job in find_jobs(list(request.programs)) if not job.callers)
    program, cell = read_started(job.program, robot, cell, job.dialect)
    return cell, next(issue.message for issue in program.issues if issue.kind == "start")


def _samples(request: PlaceRequest, cell: Cell, robot: RobotModel) -> tuple[Sequence[PathSamples], list[str]]:
    robot_in_cell, found, names = RobotInCell.of(robot, cell), [], []
    elsewhere = msgspec.structs.replace(cell, base=msgspec.structs.replace(cell.base, X=cell.base.X + 1.0))
    for path, program, source in programs_under_force(request.programs, request.forces or request.process, robot, cell):
        moved = read_program(path, robot, elsewhere) if program.keeps_text else None
        region.check_base(program, robot_in_cell, moved)
        found.append(PathSamples.of(program, robot_in_cell, source))
        names.append(path.name)
    return found, names
