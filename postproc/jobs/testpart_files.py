"""`postproc testpart`: from cell and process to a part. `postproc identify part`: from the probed part to a model."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import cell as cells
from postproc import correction, files, kinematics, machining
from postproc import robot as robots
from postproc.cell import Box, Cell
from postproc.correction.plausibility import LARGEST_CUTTING_FEED, SMALLEST_CUTTING_FEED
from postproc.dialects import registry
from postproc.errors import ForceError, InputError, MeasurementError, ModelError
from postproc.files import FileEntry
from postproc.forces import ForceSource
from postproc.frames import M_PER_MM, MM_PER_M, Array
from postproc.identification import model_folder, record
from postproc.jobs.conversion import mark_origin
from postproc.jobs.output_plan import protect
from postproc.jobs.programs import Settings, find_jobs, load_robot
from postproc.jobs.started_program import read_program
from postproc.machining import Process, ProcessSource
from postproc.machining.estimate import THICK_CHIP
from postproc.machining.material import CuttingLaw
from postproc.machining.process import ProcessFile, StockTable, ToolTable, is_name
from postproc.report.testpart import design_page, part_page
from postproc.robot import RobotModel
from postproc.robot.model_file import ModelFile
from postproc.robot.rating import exceeded_rating
from postproc.testpart import design, features, probing
from postproc.testpart.cut import ClampedProgram, CutForces, Surfaces, states_at_nominal_height, surfaces
from postproc.testpart.design import MOST_CHANGE, Design, Tests
from postproc.testpart.features import Cutting, Placement
from postproc.testpart.fit import Fit, fit
from postproc.testpart.model import Agreement, PartIdentification, agreement, material, model_file, summary
from postproc.testpart.prior import Prior
from postproc.testpart.probing import ProbedSurfaces
from postproc.testpart.readings import Readings
from postproc.under_load import RobotInCell

_CHIP_SHARE = 0.006
"""Share of the tool diameter as feed per tooth, if no feed is given (assumed)."""
_CUTTING_SPEED = 150.0
"""Cutting speed if the process states no rpm [m/min] (assumed)."""
_LARGEST_RPM = 12_000.0
"""Largest spindle speed if the process states none [1/min] (assumed)."""
_DEPTH_SHARE = 0.2
"""Share of the tool diameter as depth of cut, if none is given (assumed)."""
_MOST_TESTS = 200
"""Number of test poses that are taken evenly from the programs, about (assumed)."""
_HEIGHT_TOLERANCE_MM = 1e-3
"""Heights that differ by less are equal as written [mm]."""
PROCESS = "testpart.process.toml"
_TABLE, _PAGE, _RECORD = "probing.csv", "testpart.html", "testpart.json"
"""Files next to the programs: the table to fill in, the report and the record."""


class TestPartRequest(Struct, frozen=True, kw_only=True):
    """Inputs and output folder of a test part.

    :param placements: numbers of `[base_data]`: further placements of the block, besides `[base]` of the cell.
    :param block: ``"X=0:300,Y=0:200,Z=-40:0"`` in `$BASE`, mm; None: the box of the process.
    :param programs: programs that will be milled, with `forces`; empty: the process cuts all over the block.
    :param count: largest number of features.
    :param depth_mm: largest depth of cut; None: a share of the tool diameter.
    :param feed_mm_per_min: feed of full cuts; None: by the tool diameter.
    :param tool: number of the tool; None: the process has a single tool.
    :param sigma_mm: noise of the probe, and of the gauge.
    :param weight_kg: mass of a weight that will be hung on the tool under a dial gauge; 0: there is none.
    """

    __test__ = False  # not a test of pytest

    cell: Path
    process: Path
    output: Path
    placements: tuple[int, ...] = ()
    block: str | None = None
    programs: tuple[str, ...] = ()
    forces: Path | None = None
    count: int = 12
    depth_mm: float | None = None
    feed_mm_per_min: float | None = None
    tool: int | None = None
    sigma_mm: float = 0.005
    weight_kg: float = 0.0
    overwrite: bool = False


class TestPartFiles(Struct, frozen=True, eq=False):
    """A test part as it was written.

    :param design: its features; `cutting`: how they are cut.
    :param prior: model before the part is probed.
    :param parts: the program of each placement of the block.
    :param warnings: warnings for the user.
    """

    __test__ = False

    design: Design
    prior: Prior
    cutting: Cutting
    parts: dict[Placement, features.Program]
    written_files: tuple[Path, ...]
    warnings: tuple[str, ...]


def block_of(text: str) -> Box:
    """Return the box of the text ``"X=0:300,Y=0:200,Z=-40:0"`` [mm].

    :raises InputError: the text has another form, or a lower bound is not below the upper.
    """
    spans = {}
    for part in text.split(","):
        name, _, span = part.partition("=")
        low, _, high = span.partition(":")
        try:
            spans[name.strip().upper()] = float(low), float(high)
        except ValueError:
            spans[""] = 0.0, 0.0  # no name of an axis: the check below refuses it
    if set(spans) != set("XYZ") or any(not low < high for low, high in spans.values()):
        raise InputError(f"{text!r} is no block", file="--block", advice='For example "X=0:300,Y=0:200,Z=-40:0".')
    return Box(spans["X"], spans["Y"], spans["Z"])


def flat_tool(process: Process, number: int | None) -> tuple[str, ToolTable]:
    """Return the flat end mill of a process: key of its table in [tools], and the table.

    :param number: number of the tool; None: the process has a single tool.
    :raises ForceError: there is no such tool, it has a name in place of a number, or it is not flat.
    """
    tool = process.tool(None if number is None else str(number))
    if tool is None:
        tool_names = ", ".join(process.tools) or "none"
        raise ForceError(
            "the tool of the test part is not given", file=process.path, advice=f"--tool; found: {tool_names}."
        )
    if is_name(tool[0]):
        raise ForceError(
            f"[tools.{tool[0]}] has no tool number, which the program of a test part needs",
            file=process.path,
            advice="Give this cutter a table with a number, such as [tools.1].",
        )
    if tool[1].shape != "flat":
        raise ForceError(
            f"[tools.{tool[0]}] is a {tool[1].shape} tool",
            file=process.path,
            advice="Cut the test part with a flat end mill: its walls and floors are probed.",
        )
    return tool


def make_testpart(request: TestPartRequest, progress: Callable[[str], None] = lambda _: None) -> TestPartFiles:
    """Choose a test part and write it: programs, table to fill in, process and page; all files or none.

    :param progress: called with the name of each step.
    :raises PostprocError: an input is unusable, no feature fits, or an output must not be written.
    """
    cell = cells.load(request.cell)
    robot = load_robot(cell.robot, cell.folder)
    process = machining.load(request.process)
    key, tool = flat_tool(process, request.tool)
    box = process.stock.box if request.block is None else block_of(request.block)
    if box is None:
        raise InputError("no block", file=str(request.process), advice="Give --block, or [stock] box in the process.")
    placements = _cells_of_placements(cell, request.placements)
    _protect_files(request, placements)
    robots_in_cell = tuple(RobotInCell.of(robot, item) for item in placements.values())
    prior = _prior(robots_in_cell[0], process)
    choice = _chosen_part(
        request,
        robots_in_cell,
        process,
        prior,
        cutting=_cutting(request, key, tool, box),
        depth=(request.depth_mm or _DEPTH_SHARE * tool.diameter_mm) * M_PER_MM,
        box=box,
        progress=progress,
    )
    parts = _programs(request, choice, tuple(placements))
    warnings = design_warnings(request.weight_kg, robot, choice.cutting, tool.flutes)
    contents: dict[str, bytes | Iterable[bytes]] = {}
    for placement, placement_cell in placements.items():
        if len(parts[placement].feature):
            contents[placement.name] = parts[placement].text.encode()
            contents |= _robot_program(request, placement.name, parts[placement].text, placement_cell)
    contents[_TABLE] = probing.table(parts)
    contents[PROCESS] = _process_content(process, box)
    contents[_PAGE] = design_page(choice.design, prior, choice.cutting, parts, box, cell.robot)
    data = _design_data(choice.design, prior, choice.cutting, parts) | {"warnings": list(warnings)}
    contents = files.add_record(contents, _RECORD, lambda entries: files.json_bytes({**data, "files": entries}))
    paths = files.write_whole(request.output, contents)
    return TestPartFiles(choice.design, prior, choice.cutting, parts, tuple(paths), warnings)


def _protect_files(request: TestPartRequest, placements: Iterable[Placement]) -> None:
    """Check that no file of the test part would overwrite an input, or a file that postproc did not write.

    The second check is left out if the request allows overwriting.

    :raises InputError: such a file would be overwritten.
    """
    programs = [name for item in placements for name in (item.name, str(Path(item.name).with_suffix(".src")))]
    names = [*programs, _TABLE, PROCESS, _PAGE]
    protect([request.cell, request.process], request.output, [*names, _RECORD])
    if not request.overwrite:
        files.refuse(files.find_foreign_files(request.output, names, _RECORD))


class _ChosenPart(NamedTuple):
    """A test part before it is written.

    :param design: its features.
    :param cutting: how they are cut.
    :param weight_places: (n, 3) positions of the tool for the weight, `$BASE` [m]; n is 0 without a weight.
    :param touches: (k, 3) touch-off points on the uncut top, `$BASE` [m].
    """

    design: Design
    cutting: Cutting
    weight_places: Array
    touches: Array


def _chosen_part(
    request: TestPartRequest,
    robots_in_cell: tuple[RobotInCell, ...],
    process: Process,
    prior: Prior,
    *,
    cutting: Cutting,
    depth: float,
    box: Box,
    progress: Callable[[str], None],
) -> _ChosenPart:
    """Return the features whose readings determine the model best, and how they are cut.

    :param robots_in_cell: the robot in a cell whose `[base]` is that of the block, for each of its placements.
    :param cutting: tool, speed and feed; the choice adds the trim of the features.
    :param depth: largest depth of cut [m].
    :param box: the block.
    :param progress: called with the name of each step.
    :raises PostprocError: no feature fits, or programs of the request cannot be read.
    """
    sigma = request.sigma_mm * M_PER_MM
    progress("candidates")
    candidates, cutting = design.candidates(prior, robots_in_cell, process, cutting, depth=depth, box=box, sigma=sigma)
    tests = _test_states(request, robots_in_cell[0], process, candidates)
    progress("choice of features")
    low, high = (np.array([span[side] for span in (box.X, box.Y, box.Z)]) * M_PER_MM for side in (0, 1))  # corners
    weight_places = features.hanging_places(low, high, cutting.top) if request.weight_kg else np.zeros((0, 3))
    weight_readings = design.gauge_information(
        prior, robots_in_cell, cutting, mass=request.weight_kg, places=weight_places, sigma=sigma
    )
    selection = design.choose(candidates, prior, robots_in_cell[0], tests, request.count, weight_readings)
    touches = features.touch_off_places(selection.features, cutting, low, high)
    return _ChosenPart(selection, cutting, weight_places, touches)


def design_warnings(weight_kg: float, robot: RobotModel, cutting: Cutting, flutes: int) -> tuple[str, ...]:
    """Return warnings for the user: of a weight above the rating of the robot, and of unusual feeds and chips.

    :param weight_kg: mass of the weight, 0 for none; `robot`: robot on whose tool it is hung.
    :param flutes: number of cutting edges of the tool.
    """
    warnings = []
    if (rating := exceeded_rating(weight_kg, robot.title, robot.name)) is not None:
        warnings.append(
            f"the weight of {weight_kg:g} kg is more than the {rating:g} kg that the robot is rated for: take a "
            "lighter one (--weight)"
        )
    feed = cutting.feed * MM_PER_M * 60.0  # [mm/min]
    if not SMALLEST_CUTTING_FEED <= feed <= LARGEST_CUTTING_FEED:
        warnings.append(
            f"a feed of {feed:.4g} mm/min: cutters have {SMALLEST_CUTTING_FEED:g} to {LARGEST_CUTTING_FEED:g}. "
            "Give --feed in mm/min"
        )
    chip = feed / (cutting.rpm * flutes)  # feed per tooth [mm]
    if chip > THICK_CHIP * cutting.diameter * MM_PER_M:
        warnings.append(
            f"{chip:.3g} mm per tooth with a tool of {cutting.diameter * MM_PER_M:.4g} mm: check --feed, and rpm and "
            "flutes of the tool"
        )
    return tuple(warnings)


def _cutting(request: TestPartRequest, key: str, tool: ToolTable, box: Box) -> Cutting:
    """Return tool, speed and feed of the test part.

    Values that neither request nor process states are assumed by the diameter of the tool.

    :param key: key of the tool in the process; `box`: the block.
    """
    usual_rpm = min(_LARGEST_RPM, MM_PER_M * _CUTTING_SPEED / (np.pi * tool.diameter_mm))
    rpm = tool.rpm or float(np.floor(usual_rpm / 100.0) * 100.0)  # whole hundreds
    feed = request.feed_mm_per_min or _CHIP_SHARE * tool.diameter_mm * tool.flutes * rpm
    number = int(key) if key.isdecimal() else 1  # a process with a tool for all numbers: T1
    return Cutting(
        diameter=tool.diameter_mm * M_PER_MM, rpm=rpm, feed=feed * M_PER_MM / 60.0, tool=number, top=box.Z[1] * M_PER_MM
    )


def _programs(
    request: TestPartRequest, choice: _ChosenPart, placements: tuple[Placement, ...]
) -> dict[Placement, features.Program]:
    """Return the program of each placement.

    Numbers of features, weights and touch-off points continue from one program to the next.
    """
    parts = {}
    for number, placement in enumerate(placements):
        part_features = [choice.design.features[k] for k in np.flatnonzero(choice.design.placement == number)]
        feature_count = int((choice.design.placement < number).sum())
        parts[placement] = features.program(
            part_features,
            choice.cutting,
            request.weight_kg,
            choice.weight_places,
            touches=choice.touches if part_features else None,
            first=features.FirstNumbers(
                feature=1 + feature_count,
                weight=1 + len(choice.weight_places) * number,
                touch=1 + len(choice.touches) * number,
            ),
            placement_title=placement.title if len(placements) > 1 else "",
        )
    return parts


def _prior(robot_in_cell: RobotInCell, process: Process) -> Prior:
    """Return the parameters of robot model and cutting law, which are the prior of the identification."""
    law = process.law()
    return Prior.of(robot_in_cell.robot, law.sigma, law.numbers)


def _design_data(
    selection: Design, prior: Prior, cutting: Cutting, parts: dict[Placement, features.Program]
) -> dict[str, object]:
    """Return the design of a test part as the data of its JSON file: numbers are in the units of the keys."""
    names = [*(parameter.name for parameter in prior.parameters), "forces"]
    return {
        "placements": [
            {"program": placement.name, "frame": placement.title, "features": program.features}
            for placement, program in parts.items()
        ],
        "features": len(selection.features),
        "minutes": round(selection.seconds / 60.0, 2),
        "feed_mm_per_min": round(cutting.feed * MM_PER_M * 60.0, 1),
        "rpm": cutting.rpm,
        "trim_mm": round(cutting.trim * MM_PER_M, 3),
        "tests": selection.tests,
        "deflection_mm": round(selection.deflection * MM_PER_M, 4),
        "expected_before_mm": round(selection.before * MM_PER_M, 4),
        "expected_after_mm": round(selection.after * MM_PER_M, 4),
        "known_to": {name: round(float(share), 3) for name, share in zip(names, selection.sigma, strict=True)},
        "change_seen_percent": {
            name: round(100.0 * float(change), 1) if change < MOST_CHANGE else None
            for name, change in zip(names[:-1], selection.change, strict=True)
        },
    }


def _test_states(
    request: TestPartRequest, robot_in_cell: RobotInCell, process: Process, candidates: design.Candidates
) -> Tests:
    """Return the states of the robot whose expected error the part shall reduce.

    They are from the programs of the request, about `_MOST_TESTS` of them; without programs, from cuts in the block.

    :param candidates: features among which is chosen; their cuts are those in the block.
    """
    if not request.programs:
        return design.tests_in_block(candidates)
    from postproc.jobs.conversion import programs_under_force  # late: it imports the readers of programs
    from postproc.plan import milling

    robot, cell, law = robot_in_cell.robot, robot_in_cell.cell, process.law()
    by_program = []
    for _, program, source in programs_under_force(request.programs, request.forces, robot, cell):
        states_of_program = milling.from_program(program, robot, cell, source)
        by_program.append(
            replace(states_of_program, is_law_force=states_of_program.is_law_force & _computes_with_law(source, law))
        )
    poses = milling.join(by_program)
    rows = np.arange(0, len(poses), max(1, len(poses) // _MOST_TESTS))  # every n-th pose
    tool = np.broadcast_to(robot_in_cell.cell.tool.pose(), (len(rows), 4, 4))
    pose = kinematics.tcp(robot_in_cell.robot.nominal, poses.q[rows], tool)[0]
    weight = poses.weight[rows] / poses.weight[rows].sum()
    states = states_at_nominal_height(poses.q[rows], tool, pose, poses.wrench[rows])
    is_scaled = poses.is_law_force[rows]
    suffix = "" if is_scaled.all() else ", without the error of forces that are not of this process"
    return Tests(states=states, weight=weight, is_scaled=is_scaled, source=poses.source + suffix)


def _computes_with_law(source: ForceSource | None, law: CuttingLaw) -> bool:
    """Return whether a source computes its forces with a cutting law: not stated forces, nor another law."""
    if not isinstance(source, ProcessSource) or source.process.material is None:
        return False
    source_law = source.process.law()
    return source_law.numbers == law.numbers if law.numbers else source_law == law


def _robot_program(request: TestPartRequest, name: str, text: str, cell: Cell) -> dict[str, bytes]:
    """Return a program of the test part, uncorrected, in the language of the robot: file name → content.

    :param name: name of the G-code program; `text`: its content.
    :param cell: cell of the placement.
    :raises InputError: the robot cannot run the program.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(text.encode())
        settings = Settings(request.cell, mode="nominal")
        gcode = replace(cell.gcode, redundancy="constant")  # as the part was chosen
        cell = replace(cell, gcode=gcode, output=replace(cell.output, divide_into_modules=False))  # one file
        robot = load_robot(cell.robot, cell.folder)
        to = robot.language if robot.language and registry.dialect_of_name(robot.language).writer is not None else None
        (job,) = find_jobs([str(path)], output=request.output, to=to)
        result = correction.process(
            read_program(path, robot, cell), robot, cell, source=None, mode="nominal", to=job.to
        )
        if result.failed:
            problem = next(issue for issue in result.issues if issue.level == "error")
            raise InputError(problem.message, file=name, line=problem.source_line)
        return {document.name: document.to_bytes() for document in mark_origin(result, job, settings, cell).documents}


def _process_content(process: Process, box: Box) -> bytes:
    """Return the content of a process file with the tools and material of the process, and the block as its stock.

    The path of a material file becomes absolute.
    """
    material_table = process.material
    if material_table is not None and material_table.file is not None:
        material_table = replace(material_table, file=str((Path(process.path).parent / material_table.file).resolve()))
    content = ProcessFile(material_table, process.tools, StockTable(box=box, resolution_mm=process.stock.resolution_mm))
    return files.toml(
        content, "Written by `postproc testpart`: the process, with the block of the test part as its stock."
    )


class PartRequest(Struct, frozen=True, kw_only=True):
    """Inputs for the identification of a model from a probed part.

    :param probed: probing.csv filled in.
    :param cell: the cell in which the part was cut; its robot is the prior.
    :param process: process.toml with which the part was cut.
    :param programs: testpart.nc, and the programs of further placements of the block.
    :param tool: number of the tool; None: the process has a single tool.
    :param sigma_mm: standard deviation of the probe.
    """

    probed: Path
    cell: Path
    process: Path
    programs: tuple[Path, ...]
    tool: int | None = None
    sigma_mm: float = 0.005


class PartFiles(Struct, frozen=True, eq=False):
    """A model from a test part.

    :param data: the identification.
    :param written_files: files of the model folder; empty: the part was only compared with the model.
    """

    data: PartIdentification
    written_files: tuple[Path, ...]


class _FitInput(Struct, frozen=True, eq=False):
    """A probed part and the model to fit.

    :param prior: parameters before the fit.
    :param readings: readings of the probed points.
    :param parts: the program of each placement, with the robot in its cell.
    """

    prior: Prior
    readings: Readings
    parts: tuple[ClampedProgram, ...]
    process: Process

    def fit(self, prior: Prior) -> tuple[Fit, tuple[str, ...]]:
        """Return the fit of the model to the probed points, and the points that are left out as gross errors."""
        return fit(prior, self.readings, self.parts[0].robot_in_cell, CutForces(self.parts))


def _read_part(request: PartRequest, model: str | None = None) -> _FitInput:
    """Return a probed part as it is read, with the model to fit.

    :param model: name or folder of the robot model; None: that of the cell.
    :raises PostprocError: an input is unusable.
    """
    cell = cells.load(request.cell)
    robot = load_robot(cell.robot, cell.folder) if model is None else load_robot(model, Path())
    process = machining.load(request.process)
    _, tool = flat_tool(process, request.tool)
    probe_data = probing.read(request.probed)
    _check_top(probe_data, process)
    rows, parts = [], []
    for path, base in programs_of(probe_data, request.programs).items():
        placement_cell = cell_of_placement(cell, Placement.of_base(base), probe_data.file)
        program, robot_in_cell = read_program(path, robot, placement_cell), RobotInCell.of(robot, placement_cell)
        rows.append(np.flatnonzero(probe_data.base == base))  # probed points of this placement
        contact_surfaces = surfaces(
            program, robot_in_cell, probe_data.take(rows[-1]), 0.5 * tool.diameter_mm * M_PER_MM
        )
        parts.append(
            ClampedProgram(program, robot_in_cell, ProcessSource(process, robot_in_cell.spindle), contact_surfaces)
        )
    contact_surfaces = Surfaces.join([part.surfaces for part in parts])
    readings = Readings.of(probe_data.take(np.concatenate(rows)), contact_surfaces, request.sigma_mm * M_PER_MM)
    return _FitInput(_prior(parts[0].robot_in_cell, process), readings, tuple(parts), process)


def _check_top(probe_data: ProbedSurfaces, process: Process) -> None:
    """Check that touch-off points are on the top of the block of the process; without a block nothing is checked.

    :raises MeasurementError: a point is not on the top.
    """
    if process.stock.box is None:
        return
    top = process.stock.box.Z[1]
    for name, height in zip(probe_data.touch_off.name, probe_data.touch_off.point[:, 2].tolist(), strict=True):
        if abs(height * MM_PER_M - top) > _HEIGHT_TOLERANCE_MM:
            raise MeasurementError(
                f"{name} is at Z {height * MM_PER_M:g}, the top of the block in {Path(process.path).name} at Z {top:g}",
                file=probe_data.file,
                advice="Give X, Y, Z as programmed, and what was measured as deviation_mm.",
            )


def _cells_of_placements(cell: Cell, numbers: tuple[int, ...]) -> dict[Placement, Cell]:
    """Return the cell of each placement of the block; the first placement is at the `[base]` of the cell itself.

    :param numbers: N of `[base_data.N]` of the further placements.
    :raises InputError: a number is given twice, or the cell does not know it.
    """
    cells = {Placement(): cell}
    for number in numbers:
        placement = Placement(str(number))
        if placement in cells:
            raise InputError(f"{placement.title} is given twice", file="--placement", advice="Give each number once.")
        cells[placement] = cell_of_placement(cell, placement, "--placement")
    return cells


def cell_of_placement(cell: Cell, placement: Placement, source: str) -> Cell:
    """Return a cell whose `[base]` is that of a placement of the block.

    :param source: file or option that names the placement.
    :raises InputError: the cell does not know it.
    """
    if not placement.number:
        return cell
    frame = cell.base_data.get(placement.number)
    if frame is None:
        placements = ", ".join(f"[base_data.{number}]" for number in cell.base_data) or "none"
        raise InputError(
            f"the cell has no {placement.title}",
            file=source,
            advice=f"Give the frame of the block there in the robot root; found: {placements}.",
        )
    return replace(cell, base=frame)


def programs_of(probe_data: ProbedSurfaces, paths: tuple[Path, ...]) -> dict[Path, int]:
    """Return the programs that made probed points: path → number of its placement, −1 for `[base]`.

    A table without the column of programs must be of a single program.

    :param paths: the programs that the user gave.
    :raises MeasurementError: a program that a row names is not given, or programs and placements do not match.
    """
    placement_of = dict(zip(probe_data.program, probe_data.base.tolist(), strict=True))
    if placement_of == {"": -1}:  # the table lacks the columns of programs and placements
        if len(paths) == 1:
            return {paths[0]: -1}
        advice = "Give one --program, or the probing.csv with the column program."
        raise MeasurementError("the rows do not name the program that makes them", file=probe_data.file, advice=advice)
    advice = "Give --program once for each name in the column program of probing.csv."
    by_name = {path.name: path for path in paths}
    for k, (name, base) in enumerate(zip(probe_data.program, probe_data.base.tolist(), strict=True)):
        if name not in by_name:
            problem = f"program {name!r} is not given"
        elif placement_of[name] != base:
            problem = f"{name} has two placements"
        elif list(placement_of.values()).count(base) > 1:
            problem = f"{name} has the placement of another program"
        else:
            continue
        raise MeasurementError(problem, file=probe_data.file, line=int(probe_data.row[k]), advice=advice)
    return {by_name[name]: base for name, base in placement_of.items()}


def compare_part(request: PartRequest, model: str | None = None) -> tuple[PartIdentification, Agreement]:
    """Return the fit of a model to a probed part with its agreement, and the agreement itself.

    :param model: name or folder of the robot model; None: that of the cell.
    :raises PostprocError: an input is unusable.
    """
    part_data = _read_part(request, model)
    # the wider prior allows for changes of the robot since its model was identified
    fit, rejected_rows = part_data.fit(part_data.prior.widen())
    part_agreement = agreement(fit, part_data.prior, rejected_rows)
    return replace(summary(fit, rejected_rows), agreement=part_agreement), part_agreement


def identify_part(request: PartRequest, output: Path | None, *, overwrite: bool = False) -> PartFiles:
    """Identify a model from a probed part, and write the model folder.

    :param output: model folder to write; None: the model of the cell is only compared with the part.
    :param overwrite: replace files that postproc did not write.
    :raises PostprocError: an input is unusable, or the folder must not be replaced.
    """
    cell = cells.load(request.cell)
    folder = robots.find(cell.robot, Path(cell.folder))
    if output is not None:
        if not overwrite:
            model_folder.protect(output)
        if output.resolve() == folder.resolve():
            raise InputError("would overwrite the prior model", file=str(output), advice="Give another folder with -o.")
    if output is None:
        return PartFiles(compare_part(request)[0], ())
    part_data = _read_part(request)
    fit, rejected_rows = part_data.fit(part_data.prior)
    data = summary(fit, rejected_rows)
    prior = files.read_toml(folder / "model.toml", ModelFile, ModelError)
    content = model_file(fit, prior, part_data.process, f"{request.probed.name} (test part)")
    for name, part in (("model.toml", content), (record.NAME, data)):
        model_folder.require_finite(msgspec.to_builtins(part), name)
    contents: dict[str, bytes | Iterable[bytes]] = {
        "model.toml": files.toml(content, "Written by `postproc identify part`. Units are in the names."),
        "robot.urdf": (folder / "robot.urdf").read_bytes(),
        "material.toml": material(fit, part_data.process, request.probed.name),
        "report.html": part_page(data, output.resolve().name),
    }

    def rendered(entries: list[FileEntry]) -> bytes:
        """Return the record of the model with the list of its files."""
        return replace(data, files=entries).as_json()

    return PartFiles(data, tuple(files.write_whole(output, files.add_record(contents, record.NAME, rendered))))
