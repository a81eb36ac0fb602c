"""`postproc place`: from programs and a region to the place of the part."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec
from msgspec import Struct

from postproc import cell as cells
from postproc.cell import Cell, Frame
from postproc.errors import CellError, InputError, OptionError, PostprocError, did_you_mean
from postproc.files import add_record, find_foreign_files, refuse, write_whole
from postproc.frames import M_PER_MM, RAD_PER_DEG
from postproc.jobs.conversion import convert_program, programs_under_force
from postproc.jobs.output_plan import protect
from postproc.jobs.programs import Settings, find_jobs, load_robot
from postproc.jobs.started_program import read_program, read_with_start
from postproc.placement import LeastMargins, PathSamples, region
from postproc.placement.region import AXES, Assessment, JudgedPlace, Region, Search
from postproc.program import Program
from postproc.report import placement as report
from postproc.report import summary as program_summary
from postproc.robot import RobotModel
from postproc.under_load import RobotInCell

FILES = _TABLE, _PAGE, _BASE, _RECORD = ("place.csv", "place.html", "place.toml", "place.json")
"""Files of a search: all places, the report, `[base]` of the best place if there is one, and the record."""
_DEFAULT_HALF_WIDTHS = {"X": 400.0, "Y": 400.0, "Z": 200.0, "A": 45.0}
"""Without a region the place may change by this in both directions [mm, deg]."""
_LARGEST_COORDINATE = 1e5
"""Largest bound of a region [mm, deg] (assumed)."""
_BOUNDS = re.compile(r"\s*(\w+)\s*=\s*([-+.\deE]+)\s*:\s*([-+.\deE]+)\s*")


class PlaceRequest(Struct, frozen=True, kw_only=True):
    """Inputs and output folder of a search for the place of the part.

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
    written_files: tuple[Path, ...]


def make_place(request: PlaceRequest, progress: Callable[[int, int], None] | None = None) -> PlaceFiles:
    """Look for the best place of the part and write the result: all files or none.

    :param progress: called with the number of places done, and of all places; None: not reported.
    :raises PostprocError: an input is unusable, a program has a `$BASE` of its own, or an output must not be written.
    """
    cell = cells.load(request.cell)
    robot = load_robot(cell.robot, cell.folder)
    bounds = region_of(request.region, cell)
    inputs = [Path(program) for program in request.programs]
    protect([*inputs, request.cell, *filter(None, (request.forces, request.process))], request.output, FILES)
    if not request.overwrite:
        refuse(find_foreign_files(request.output, FILES, _RECORD))
    # a conversion chooses a new start at each place; the samples all have the start that is chosen here
    assess = partial(_assessment, request, cell, robot)
    started_cell, start_message = _cell_with_start(request, cell, robot)
    sampled_programs = _samples(request, started_cell, robot)
    clearance = _clearance(request, started_cell)
    is_turn_free = started_cell.gcode.redundancy != "constant"
    programs = region.Programs(
        sampled_programs.samples,
        LeastMargins(joint=request.margin_deg * RAD_PER_DEG),
        turns=is_turn_free and not any(samples.program.keeps_text for samples in sampled_programs.samples),
        clearance_mm=clearance,
    )
    search = region.search(programs, bounds, progress, assess)
    content = report.summary(
        search,
        started_cell,
        programs=[path.name for path in sampled_programs.paths],
        margin_deg=request.margin_deg,
        clearance_mm=clearance,
        region=bounds,
        start=start_message,
        moved_frames=[f"base_data.{number}" for number in sampled_programs.frame_numbers],
    )
    return PlaceFiles(content, _write(request.output, search, started_cell, content))


def _write(output: Path, search: Search, cell: Cell, content: report.PlaceSummary) -> tuple[Path, ...]:
    """Write the files of a search into a folder; return their paths.

    Without a best place, the `[base]` file of an earlier search is removed, unless somebody has changed it.

    :param cell: cell of the search, with [start].
    """
    contents: dict[str, bytes | Iterable[bytes]] = {
        _TABLE: report.places_csv(search),
        _PAGE: report.page(search, content),
    }
    if search.best is not None:
        contents[_BASE] = report.base_toml(search, cell, content)
    is_earlier_place_ours = not find_foreign_files(output, [_BASE], _RECORD)
    written_files = write_whole(
        output, add_record(contents, _RECORD, lambda entries: report.place_json(content, entries))
    )
    if search.best is None and is_earlier_place_ours:
        (output / _BASE).unlink(missing_ok=True)
    return tuple(written_files)


def _clearance(request: PlaceRequest, cell: Cell) -> float | None:
    """Return the distance of the bodies of [collision] to keep [mm]; None: the cell has no such bodies.

    :raises InputError: the request states a distance, and the cell has no bodies.
    """
    if cell.collision is not None:
        return cell.collision.clearance_mm if request.clearance_mm is None else request.clearance_mm
    if request.clearance_mm is not None:
        advice = "Describe holder and obstacles under [collision] in the cell, or leave --clearance-mm out."
        raise InputError("--clearance-mm: the cell has no [collision]", file=str(request.cell), advice=advice)
    return None


def region_of(text: str | None, cell: Cell) -> Region:
    """Return the region of a text; axes that it omits stay at the values of the cell.

    :param text: bounds as in `PlaceRequest`; None: `_DEFAULT_HALF_WIDTHS` around the place of the cell.
    :raises OptionError: the text cannot be read, or names E1 without a linear axis in the cell.
    """
    cell_value = {"X": cell.base.X, "Y": cell.base.Y, "Z": cell.base.Z, "A": cell.base.A, "E1": 0.0}
    low, high = dict(cell_value), dict(cell_value)
    if text is None:
        for axis, half_width in _DEFAULT_HALF_WIDTHS.items():
            low[axis], high[axis] = cell_value[axis] - half_width, cell_value[axis] + half_width
    stated_axes = set[str]()
    for part in () if text is None else text.split(","):
        axis, lower, upper = _bounds(part)
        if axis in stated_axes:
            raise OptionError(f"--region: {axis} is given twice", advice="Give each axis once.")
        stated_axes.add(axis)
        low[axis], high[axis] = lower, upper
    if high["E1"] > low["E1"] and cell.carriage is None:
        raise OptionError("--region names E1, but the cell has no [external_axes.E1]", advice="Leave E1 out.")
    return Region(tuple(low[axis] for axis in AXES), tuple(high[axis] for axis in AXES))


class _AxisBounds(NamedTuple):
    """Bounds of an axis of the place [mm, deg]."""

    axis: str
    lower: float
    upper: float


def _bounds(part: str) -> _AxisBounds:
    """Return the bounds of one axis in --region, ``AXIS=LOW:HIGH``.

    :raises OptionError: the text has another form, or the bounds are exchanged or too large.
    """
    match = _BOUNDS.fullmatch(part)
    advice = f"Write --region X=1200:2000,Y=-600:600,A=-90:90, the smaller number first; axes: {', '.join(AXES)}."
    option = f"--region {part.strip()!r}"
    try:
        if match is None:
            raise ValueError  # noqa: TRY301 - like a word that is no number
        axis, lower, upper = match[1], float(match[2]), float(match[3])
    except ValueError:
        raise OptionError(f"{option}: not AXIS=LOW:HIGH with numbers in mm or degrees", advice=advice) from None
    if axis not in AXES:
        raise OptionError(f"{option}: no axis {axis!r}", advice=f"{did_you_mean(axis, AXES)} {advice}".lstrip())
    if lower > upper:
        raise OptionError(f"{option}: {lower:g} is larger than {upper:g}", advice=advice)
    if max(abs(lower), abs(upper)) > _LARGEST_COORDINATE:
        raise OptionError(f"{option}: farther than {_LARGEST_COORDINATE:g}", advice=advice)
    return _AxisBounds(axis, lower, upper)


def _cell_with_start(request: PlaceRequest, cell: Cell, robot: RobotModel) -> tuple[Cell, str | None]:
    """Return a cell with [start], and a sentence on the choice of the start.

    A cell without [start] gets the start that is chosen for the first program. A cell with [start] is returned as it
    is, with None in place of the sentence.

    :raises PostprocError: the program cannot be read, or no start can be chosen.
    """
    if cell.start is not None:
        return cell, None
    job = next(job for job in find_jobs(list(request.programs)) if not job.callers)
    program, cell = read_with_start(job.program, robot, cell, job.dialect)
    return cell, next(issue.message for issue in program.issues if issue.kind == "start")


def _assessment(request: PlaceRequest, cell: Cell, robot: RobotModel, place: JudgedPlace) -> Assessment:
    """Return deflection, expected errors and chance with the part at a place, each of the worst program.

    The programs are converted as by `postproc convert`. If one fails, the place is unusable, and the assessment has the
    problem alone. The chance is that the correction makes the part better, see `report.summary`.
    """
    cell = _cell_at(cell, place)
    settings = Settings(cell=request.cell)
    verdicts = []
    deflection = 0.0
    for job in find_jobs(list(request.programs), forces=request.forces or request.process, to=robot.language or None):
        if job.callers:  # it is converted with the programs that call it
            continue
        try:
            program, started_cell = read_with_start(job.program, robot, cell, job.dialect)
            result, _ = convert_program(job, settings, started_cell, robot, program)
        except PostprocError as cause:
            return Assessment(problem=str(cause))
        if result.failed:
            error = next(issue for issue in result.issues if issue.level == "error")
            line = "" if error.source_line is None else f", line {error.source_line}"
            return Assessment(problem=f"{job.program.name}{line}: {error.message}")
        content = program_summary(result, cell.tolerance, cell.part_tolerance)
        deflection = max(deflection, content.before.max_mm * M_PER_MM)
        verdicts.append(content.verdict.better)
    comparisons = [verdict for verdict in verdicts if verdict is not None]
    corrected = _worst([comparison.corrected_mm for comparison in comparisons])
    chances = [comparison.chance for comparison in comparisons if comparison.chance is not None]
    return Assessment(
        deflection=deflection,
        uncorrected=None if corrected is None else _worst([comparison.uncorrected_mm for comparison in comparisons]),
        corrected=corrected,
        chance=min(chances, default=None),
    )


def _worst(errors_mm: Sequence[float | None]) -> float | None:
    """Return the largest of the errors of programs [mm] in metres; None if an error is None, or if there are none."""
    known_errors = [error for error in errors_mm if error is not None]
    return max(known_errors) * M_PER_MM if known_errors and len(known_errors) == len(errors_mm) else None


def _cell_at(cell: Cell, place: JudgedPlace) -> Cell:
    """Return the cell with the part at a place.

    If the linear axis E1 moves the robot by some distance, the part moves back by it in the robot root. The obstacles
    of the cell would have to move too, so collisions are not checked then.
    """
    x, y, z, a, e1 = place.place
    if not e1:
        return _moved_cell(cell, msgspec.structs.replace(cell.base, X=x, Y=y, Z=z, A=a))
    assert cell.carriage is not None, "a region names E1 only if it carries the robot"
    dx, dy, dz = (cell.carriage * e1).tolist()
    base = msgspec.structs.replace(cell.base, X=x - dx, Y=y - dy, Z=z - dz, A=a)
    return msgspec.structs.replace(_moved_cell(cell, base), collision=None)


def _moved_cell(cell: Cell, base: Frame) -> Cell:
    """Return the cell with another `[base]`; frames by number that equal its `[base]` are replaced too."""
    moved_frames = dict.fromkeys(region.numbers_of_base(cell), base)
    return msgspec.structs.replace(cell, base=base, base_data=cell.base_data | moved_frames)


class _SampledPrograms(NamedTuple):
    """Programs of a search.

    :param samples: samples of the path of each program.
    :param paths: file of each program.
    :param frame_numbers: numbers of the frames of the controller that a program uses and that equal `[base]`: they must
        move with it.
    """

    samples: Sequence[PathSamples]
    paths: list[Path]
    frame_numbers: list[str]


def _samples(request: PlaceRequest, cell: Cell, robot: RobotModel) -> _SampledPrograms:
    """Read the programs, and return samples of their paths.

    A robot program is read a second time, with `[base]` and all frames equal to it shifted, each by another length. The
    shift of `$BASE` in the program that is read shows which of these frames it uses.

    :raises InputError: a program has frames of its own, so that moving $BASE would not move it.
    """
    robot_in_cell, samples, paths = RobotInCell.of(robot, cell), list[PathSamples](), list[Path]()
    base = cell.base
    # `[base]` is shifted by 1 mm, the frames that are equal to it by 2, 3 … mm
    shifted_frames = {
        number: msgspec.structs.replace(base, X=base.X + shift)
        for shift, number in enumerate(region.numbers_of_base(cell), start=2)
    }
    shifted_cell = msgspec.structs.replace(
        cell, base=msgspec.structs.replace(base, X=base.X + 1.0), base_data=cell.base_data | shifted_frames
    )
    used_numbers = set[str]()
    for path, program, source in programs_under_force(request.programs, request.forces or request.process, robot, cell):
        shifted_program = _shifted_program(path, robot, shifted_cell) if program.keeps_text else None
        region.check_base(program, robot_in_cell, shifted_program)
        if shifted_program is not None:
            used_numbers |= {
                number for number, frame in shifted_frames.items() if region.has_base(shifted_program, frame)
            }
        samples.append(PathSamples.of(program, robot_in_cell, source))
        paths.append(path)
    return _SampledPrograms(samples, paths, [number for number in shifted_frames if number in used_numbers])


def _shifted_program(path: Path, robot: RobotModel, shifted_cell: Cell) -> Program:
    """Return a robot program as it is read with shifted frames.

    :raises InputError: a file of the program states one of these frames too.
    """
    try:
        return read_program(path, robot, shifted_cell)
    except CellError as cause:
        raise InputError(
            "a .dat states a frame by number that is [base] of the cell: it would not move with it",
            file=path.name,
            advice="Take BASE_DATA out of the .dat, or convert with other frames there to compare places.",
        ) from cause
