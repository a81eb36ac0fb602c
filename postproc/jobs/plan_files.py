"""`postproc plan`: from experiment, cell and programs to the files of a plan."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path, PurePath

from msgspec import Struct
from msgspec.structs import replace

from postproc import cell as cells
from postproc import interrupts
from postproc.cell import Cell
from postproc.dialects.krl.dialect import KRL
from postproc.errors import InputError, MeasurementError
from postproc.files import FileEntry, add_record, find_foreign_files, json_bytes, refuse, write_whole
from postproc.frames import RAD_PER_DEG
from postproc.identification.readings import Angles, read, read_experiment
from postproc.jobs.conversion import programs_under_force
from postproc.jobs.output_plan import protect
from postproc.jobs.programs import load_robot
from postproc.kinematics import require_pinocchio
from postproc.plan import Options, PlanResult, compensator, milling, plan_measurements
from postproc.plan.compensator import CompensatorOptions, CompensatorPlan, plan_compensator
from postproc.plan.milling import TestPoses
from postproc.plan.planning import Progress
from postproc.plan.site import site_of
from postproc.report.plan import krl_program, plan_csv, plan_json, plan_page
from postproc.robot import RobotModel

_ARM_TOLERANCE = 1e-6
"""Entries of joint placements [m, 1] and of joint axes [1] that differ by less are equal but for rounding."""


class PlanRequest(Struct, frozen=True, kw_only=True):
    """Inputs and output of a plan of measurements. See `plan.Options` for the numbers.

    :param experiment: experiment.toml with [rig], which states how measurements are taken.
    :param cell: cell file of the programs.
    :param programs: programs that will be milled: files, folders, patterns; empty with `poses`.
    :param output: CSV file to write; `.src`, `.html` and `.json` are written next to it.
    :param forces: CSV file of cutting forces, or a folder of such files.
    :param poses: CSV file of test poses; None: they are those of the programs.
    :param measured: CSV file of readings so far; None: there are none.
    :param margin: distance to keep from joint limits [deg].
    :param overwrite: replace files that postproc did not write.
    """

    experiment: Path
    cell: Path
    programs: tuple[str, ...]
    output: Path
    forces: Path | None = None
    poses: Path | None = None
    measured: Path | None = None
    configurations: int = 15
    q2_levels: int = 5
    grouped: bool = False
    test_poses: int = 20
    repeats: int = 3
    margin: float = 5.0
    seed: int = 0
    overwrite: bool = False

    def options(self) -> Options:
        """Return the options of the search for a plan."""
        return Options(
            configurations=self.configurations,
            levels=self.q2_levels,
            seed=self.seed,
            grouped=self.grouped,
            test_poses=self.test_poses,
            repeats=self.repeats,
        )

    def input_files(self) -> list[Path]:
        """Return the files that are read."""
        option_files = filter(None, (self.forces, self.poses, self.measured))
        return [self.experiment, self.cell, *option_files, *map(Path, self.programs)]


class PlanFiles(Struct, frozen=True, eq=False):
    """A plan as it was written.

    :param result: the plan.
    :param written_files: its files, the CSV first and the JSON last.
    """

    result: PlanResult
    written_files: tuple[Path, ...]


def make_plan(request: PlanRequest, progress: Progress | None = None) -> PlanFiles:
    """Plan measurements and write the plan: all files or none.

    Ctrl-C ends the search; the best plan so far is written.

    :param progress: called with the name of the step and the share done; None: not reported.
    :raises PostprocError: an input is unusable, no pose can be measured, or an output must not be written.
    """
    setup = read_experiment(request.experiment)
    if setup.angles != Angles():
        raise MeasurementError(
            "[angles] are of another controller, but a plan states A1 … A6 with KUKA's signs",
            file=str(request.experiment),
            advice="Leave out [angles], and give --measured with A1 … A6.",
        )
    cell = cells.load(request.cell)
    robot = load_robot(setup.robot, request.experiment.parent)
    check_same_arm(robot, load_robot(cell.robot, cell.folder))
    if robot.has_weight:
        require_pinocchio(robot.title)
    site = site_of(robot, setup, request.experiment.parent, cell.start_joints, request.margin * RAD_PER_DEG)
    tests = _test_poses(request, robot, cell)
    data = None if request.measured is None else read(request.measured, setup)
    folder, stem = request.output.parent, request.output.stem
    csv, src = request.output.name, f"{KRL.writer.valid_name(stem)}.src"
    html, record = f"{stem}.html", f"{stem}.json"
    names = (csv, src, html, record)
    protect(request.input_files(), folder, names)
    if not request.overwrite:
        refuse(find_foreign_files(folder, names, record))
    with interrupts.interruptible_search():
        result = plan_measurements(site, tests, request.options(), data, progress)
    contents: dict[str, bytes | Iterable[bytes]] = {csv: plan_csv(result)}
    if robot.language in ("", KRL.name):
        contents[src] = krl_program(result, cell, PurePath(src).stem).to_bytes()
    else:
        note = f"no {src}: the controller of {robot.title} reads {robot.language}, and only KRL is written for plans"
        result = replace(result, warnings=(*result.warnings, note))
    contents[html] = plan_page(result, stem)
    paths = write_whole(folder, add_record(contents, record, lambda files: plan_json(result, files)))
    return PlanFiles(result, tuple(paths))


class CompensatorRequest(Struct, frozen=True, kw_only=True):
    """Inputs and output of a plan of readings of the gravity compensator. See `CompensatorOptions` for the numbers.

    :param experiment: experiment.toml: robot and sigma_mm.
    :param output: CSV file to write, to be filled in with readings; `.json` next to it.
    :param margin: distance to keep from the limits of A2 [deg].
    :param overwrite: replace files that postproc did not write.
    """

    experiment: Path
    output: Path
    angles: int = 6
    markers: int = 4
    repeats: int = 3
    margin: float = 5.0
    overwrite: bool = False


class CompensatorPlanFiles(Struct, frozen=True, eq=False):
    """A plan of the compensator's readings as it was written.

    :param plan: the plan.
    :param written_files: its files, the CSV first and the JSON last.
    """

    plan: CompensatorPlan
    written_files: tuple[Path, ...]


def make_compensator_plan(request: CompensatorRequest) -> CompensatorPlanFiles:
    """Plan the readings that determine the compensator's geometry L, a_x, a_y, and write the plan: all files or none.

    :raises PostprocError: an input is unusable, or an output must not be written.
    """
    setup = read_experiment(request.experiment)
    robot = load_robot(setup.robot, request.experiment.parent)
    folder, csv, record = request.output.parent, request.output.name, f"{request.output.stem}.json"
    protect([request.experiment], folder, (csv, record))
    if not request.overwrite:
        refuse(find_foreign_files(folder, (csv, record), record))
    options = CompensatorOptions(
        angles=request.angles, markers=request.markers, repeats=request.repeats, margin=request.margin * RAD_PER_DEG
    )
    plan = plan_compensator(robot, setup.sigma, options)

    def rendered(files: list[FileEntry]) -> bytes:
        """Return the record of the plan with the list of its files."""
        return json_bytes({**compensator.summary(plan), "files": files})

    contents: dict[str, bytes | Iterable[bytes]] = {csv: compensator.template(plan)}
    return CompensatorPlanFiles(plan, tuple(write_whole(folder, add_record(contents, record, rendered))))


def _test_poses(request: PlanRequest, robot: RobotModel, cell: Cell) -> TestPoses:
    """Return the poses and loads for which the identified model must be accurate.

    They are from the file `poses` of the request, or else from the cutting motions of its programs.
    """
    if request.poses is not None:
        return milling.from_file(request.poses, robot, cell)
    return milling.join(cutting_states(request.programs, request.forces, robot, cell))


def cutting_states(programs: Sequence[str], force_path: Path | None, robot: RobotModel, cell: Cell) -> list[TestPoses]:
    """Return poses and forces along the cutting moves of each program, as test poses.

    :param programs: files, folders, patterns; subprograms are read as parts of their callers.
    :param force_path: CSV file of forces, a folder of such files, or process.toml that computes them; None: the
        programs state their forces in comments.
    :raises PostprocError: a program or its forces cannot be read or followed, or none of its moves carries a force.
    """
    return [
        milling.from_program(program, robot, cell, source)
        for _, program, source in programs_under_force(programs, force_path, robot, cell)
    ]


def check_same_arm(measured_robot: RobotModel, milling_robot: RobotModel) -> None:
    """Check that two models are of one arm, by placements and axes of their joints; their compliances may differ.

    :param measured_robot: robot of the experiment; `milling_robot`: robot of the cell.
    :raises InputError: the arms differ.
    """
    measured_arm, milling_arm = measured_robot.nominal, milling_robot.nominal
    placement_difference = abs(measured_arm.placement - milling_arm.placement).max()
    axis_difference = abs(measured_arm.axis - milling_arm.axis).max()
    if max(placement_difference, axis_difference) > _ARM_TOLERANCE:
        raise InputError(
            f"the experiment is with robot {measured_robot.name}, the cell has {milling_robot.name}, an arm of other "
            "dimensions",
            advice="Plan the measurements for the robot that mills.",
        )
