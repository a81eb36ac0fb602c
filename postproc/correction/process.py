"""Processing stages of a program: path under load, commands, targets, text, read back, simulated, result.

A *draft* is a program with its targets chosen; it is written, read back and simulated. Where the simulation exceeds the
tolerance, targets are inserted and the next draft is made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import elastostatics, forces, kinematics, placement, toolpath
from postproc.cell import Cell
from postproc.chunks import chunks, in_chunks
from postproc.correction import checks, collisions, inspection, plausibility
from postproc.correction.dwells import dwell_issues
from postproc.correction.result import ExpectedErrors, Mode, Result
from postproc.correction.targets import CommandedPath, Commands, TargetSelection, arc_pieces, choose_targets
from postproc.correction.verify import (
    Exceedances,
    ReadBackProgram,
    SimulatedPath,
    UnusableTextError,
    read_back,
    simulate,
)
from postproc.dialects import registry
from postproc.dialects.dialect import Writer
from postproc.elastostatics import Reversals
from postproc.errors import InputError, Issue, NotConvergedError, ProgramError, group_issues
from postproc.forces import Axes, ForceSource, Knots
from postproc.frames import Array, norm, xyzabc_from_pose
from postproc.placement import Turn
from postproc.poses import Poses
from postproc.program import CIRC, Bools, Document, Ints, Program, TargetForces, TargetJoints, WrittenProgram, read_only
from postproc.robot import RobotModel
from postproc.toolpath import Pieces
from postproc.under_load import (
    SHARE_OF_TOLERANCE,
    ImpossiblePathError,
    MotionsUnderLoad,
    PathUnderLoad,
    RobotInCell,
    led_by_wrist,
)

_NO_BALANCE = "no loaded equilibrium: the pose is singular or the load too large. Move the part or check the forces."


def programmed_commands(path: PathUnderLoad) -> Commands:
    """Return the uncorrected commands of the program, with springs that are not deflected; poses in `$BASE`."""
    theta = np.broadcast_to(0.0, (len(path), path.robot_in_cell.robot.actual.nv))
    return Commands(path.joints.q, path.sample.pose, theta)


def corrected_commands(path: PathUnderLoad) -> Commands:
    """Return the corrected commands of all samples; poses in `$BASE`. Axis targets are not corrected.

    :raises ImpossiblePathError: a sample has no loaded equilibrium.
    """
    is_axis_target = np.isfinite(path.program.motions.joints[path.sample.motion, 0])
    q = np.zeros((len(path), 6))
    theta = np.zeros((len(path), path.robot_in_cell.robot.actual.nv))

    def commands_at(row: Ints) -> tuple[Array, Array]:
        """Return position (n, 3) [m] and A, B, C (n, 3) [deg] of the commands of samples, `$BASE`; set q and theta."""
        pose, tool, wrench = path.pose_in_root(row), path.tool(row), path.wrench_in_root(row)
        compensation = path.robot_in_cell.compensate(pose, path.joints.q[row], tool, wrench)
        motion, t = path.sample.motion[row], path.sample.t[row]
        command = toolpath.pose_in_base(path.program, motion, compensation.pose, t)
        q[row], theta[row] = compensation.q, compensation.theta
        return command[:, :3, 3], xyzabc_from_pose(command)[:, 3:]

    corrected_rows, uncorrected_rows = np.flatnonzero(~is_axis_target), np.flatnonzero(is_axis_target)
    corrected_position, corrected_angles = _solve_in_chunks(path, commands_at, corrected_rows)
    if not len(uncorrected_rows):
        return Commands(q, Poses(corrected_position, corrected_angles), theta)
    q[uncorrected_rows] = path.joints.q[uncorrected_rows]
    nominal = path.sample.pose
    position, angles = nominal.position.copy(), nominal.xyzabc(slice(None))[:, 3:]
    position[corrected_rows], angles[corrected_rows] = corrected_position, corrected_angles
    return Commands(q, Poses(position, angles), theta)


class UncorrectedDeviations(NamedTuple):
    """Deviations of the tool tip at n samples without correction, `$BASE` [m].

    :param deviation: (n, 3) from nominal.
    :param displacement: (n, 3) by the wrench alone; the same array where the robot at rest is nominal.
    :param by_tool: (n, 3) of that, the deflection of holder, spindle and tool; None if they are rigid.
    """

    deviation: Array
    displacement: Array
    by_tool: Array | None


def uncorrected_deviations(path: PathUnderLoad, rows: Ints, theta: Array) -> UncorrectedDeviations:
    """Return the deviation and displacement of the tool at samples (n,) without correction.

    :param theta: (N, nv) approximate deflections of the springs: start values.
    :raises ImpossiblePathError: there is no equilibrium somewhere.
    """
    robot_in_cell = path.robot_in_cell

    def deviations(row: Ints) -> tuple[Array, ...]:
        """Return deviation (n, 3), then displacement and part by the tool (n, 3), unless they are left out, see below.

        All are in `$BASE` [m].
        """
        q, wrench, start_theta = path.joints.q[row], path.wrench_in_root(row), theta[row]
        tip, by_tool = path.tip_in_base(row, q, wrench, start_theta)
        columns = [tip - path.sample.pose.position[row]]
        if not robot_in_cell.rest_is_nominal:  # without a force the tip is not at its nominal place
            columns.append(tip - path.tip_in_base(row, q, np.zeros_like(wrench), start_theta)[0])
        if robot_in_cell.tool_spring is not None:
            columns.append(by_tool)
        return tuple(columns)

    # columns that would equal another one or zero are neither computed nor kept: there may be 10⁶ samples
    deviation, *other_columns = _solve_in_chunks(path, deviations, rows)
    displacement = deviation if robot_in_cell.rest_is_nominal else other_columns[0]
    return UncorrectedDeviations(
        deviation, displacement, None if robot_in_cell.tool_spring is None else other_columns[-1]
    )


def _solve_in_chunks(
    path: PathUnderLoad, function: Callable[[Ints], tuple[Array, ...]], rows: Ints
) -> tuple[Array, ...]:
    """Return the results of a function of samples (n,), computed in chunks: matrices of all samples are never kept.

    :param function: takes the samples (k,) of a chunk; returns arrays of k rows.
    :raises ImpossiblePathError: there is no equilibrium somewhere; it lists the motions.
    """
    try:
        return in_chunks(function, rows)
    except NotConvergedError as cause:
        motion = path.sample.motion[rows[list(cause.rows)]]
        raise ImpossiblePathError(path.program.motions.issue("error", "not-converged", _NO_BALANCE, motion)) from None


_MB = 1e6
"""Bytes of a megabyte, as controllers state their memory."""
_NO_BOUND = "the forces have standard deviations, but the robot model has no covariance: u95_mm is not computed."

_NOT_FINITE = (
    "the expected error of the tool position (u95_mm) is not a number here: the pose is singular, or [covariance] of "
    "the robot model is wrong."
)

_NO_DEVIATION = 1e-6
"""Uncorrected deviations below this everywhere leave nothing to judge on a part [m] (assumed)."""
_DIFFERENT_PASSES = (
    "passes of this line have different forces: no force file can hold them, and none is written. `predict` of the "
    "written program needs the process, or forces as comments."
)


class Task(Struct, frozen=True, eq=False):
    """Settings for processing a program, see `process`.

    :param robot: the robot model, `mode` and `linearize_arcs` as given to `process`.
    :param written_dialect: name of the dialect of the written program.
    :param has_force_file: True if its forces are read from and written to a file, False for comments.
    :param initial_issues: issues found before anything is computed.
    :param turn: the turn of the tool about its axis, if it was chosen.
    """

    robot: RobotModel
    mode: Mode
    linearize_arcs: bool
    written_dialect: str
    has_force_file: bool
    initial_issues: tuple[Issue, ...]
    turn: Turn | None = None

    @property
    def writer(self) -> Writer:
        """Writer of the dialect of the written program."""
        return registry.written_in(self.written_dialect)[1]


class Draft(Struct, frozen=True, eq=False):
    """A program with targets at some of the samples of its path.

    :param path: the path.
    :param q: (N, 6) commanded joint angles at its samples [rad]; the commanded poses are in the targets.
    :param theta: (N, nv) deflections of the springs there [rad, m].
    :param selection: the targets.
    :param issues: issues found so far.
    :param simulation: simulation of the written program; None if it is not written yet, or cannot be used.
    :param file_forces: forces that a file must give to the written program; None if its comments give them.
    :param force_file_issues: issues of that file.
    """

    path: PathUnderLoad
    q: Array
    theta: Array
    selection: TargetSelection
    issues: tuple[Issue, ...]
    simulation: SimulatedPath | None = None
    file_forces: Knots | None = None
    force_file_issues: tuple[Issue, ...] = ()

    @classmethod
    def of(cls, task: Task, path: PathUnderLoad, command: Commands, selection: TargetSelection) -> Draft:
        """Return the draft with the issues of the task, the program, its forces and its commanded path."""
        issues = (
            *task.initial_issues,
            *path.program.issues,
            *path.motions.forces.issues,
            *inspection.path_issues(path, command),
        )
        return cls(path, command.q, command.theta, selection, issues)

    @property
    def failed(self) -> bool:
        """True if it has an issue of level error."""
        return any(issue.level == "error" for issue in self.issues)

    def forces_at_targets(self) -> TargetForces:
        """Return the wrench at each target in the form that the written program needs."""
        selection = self.selection
        # `arrive`: directions of travel, for forces in axes of the feed
        return forces.target_forces(
            self.path.motions.forces, selection.targets, selection.arrive, self.path.wrench.of_rows(selection.row)
        )

    def cut_lengths(self) -> Array:
        """Return the length (K,) of the cutting path for which each target stands [m], see `toolpath.cut_lengths`."""
        # samples with equal wrenches have the same number of a run
        motion, wrench_run = self.selection.targets.motion, self.path.wrench.run[self.selection.row]
        # within a motion there are targets where the force changes; from one to the next it goes on if it stays equal
        force_goes_on = (np.diff(motion, prepend=-1) == 0) | (np.diff(wrench_run, prepend=-1) == 0)
        segments = self.path.motions.segments
        return toolpath.cut_lengths(
            self.path.program.motions, segments.length, motion, self.selection.targets.t, force_goes_on
        )

    def write(self, task: Task) -> Draft:
        """Return the draft written, read back and simulated, as far as possible.

        :raises ProgramError: it cannot be written.
        """
        path, selection, text = self.path, self.selection, self._text(task)
        draft = replace(self, issues=(*self.issues, *text.issues, *_memory_warning(text, path.robot_in_cell.cell)))
        if draft.failed:
            return draft
        try:
            readback = read_back(path, selection, text)
            simulation = simulate(path, selection, self.theta, readback, is_corrected=task.mode != "nominal")
        except UnusableTextError as cause:
            return replace(draft, issues=(*draft.issues, cause.issue))
        known_kinds = {issue.kind for issue in draft.issues}
        new_issues = [issue for issue in simulation.issues if issue.kind not in known_kinds or issue.kind == "blending"]
        draft = replace(draft, simulation=simulation, issues=(*draft.issues, *new_issues))
        if draft.failed or not task.has_force_file:
            return draft
        knots, force_file_issues = _readback_forces(draft, readback)
        return replace(draft, file_forces=knots, force_file_issues=force_file_issues)

    def _text(self, task: Task) -> WrittenProgram:
        """Return the program with the targets of this draft, as its dialect writes it."""
        path, row = self.path, self.selection.row
        has_force_comments = bool(path.program.notes) and not task.has_force_file  # else a file gives the forces
        comments = self.forces_at_targets() if has_force_comments else None
        q = self.q[row]
        joints = TargetJoints(q, kinematics.status_of(task.robot, q))
        return task.writer.write(path.program, self.selection.targets, joints, path.robot_in_cell.cell, comments)


def _memory_warning(text: WrittenProgram, cell: Cell) -> tuple[Issue, ...]:
    """Return a warning if a written program in one piece is larger than the memory of the controller."""
    size, memory = text.size / _MB, cell.output.program_memory_MB
    if size <= memory or text.modules is not None:
        return ()
    option = "set divide_into_modules = true in [output] (KRL from G-code or APT)"
    if cell.output.divide_into_modules:
        option = "convert G-code or APT to KRL: divide_into_modules divides no other programs"
    message = (
        f"the program has {size:.3g} MB, {size / memory:.2g} times program_memory_MB = {memory:g} of [output]: the "
        "controller may not load it. Raise tolerance_mm, give forces as a file instead of comments, divide "
        f"the job into several programs, one for each operation, or {option}."
    )
    return (Issue("warning", "program-memory", message),)


def result_of(task: Task, draft: Draft, corrected_draft: Draft) -> Result:
    """Return the result of a draft; a program that is not written is predicted without correction.

    :param corrected_draft: the draft with corrected commands; of a nominal program the same one.
    """
    # row (K,): the sample of the path at each target
    path, row, targets, program = draft.path, draft.selection.row, draft.selection.targets, draft.path.program
    uncorrected = _uncorrected_at_targets(task, draft)
    reversals = _reversals(corrected_draft)
    cut_length = draft.cut_lengths()
    expectation = _expected_errors(task, corrected_draft, uncorrected.deviation, reversals, cut_length)
    correction = norm(targets.pose.position - path.sample.pose.position[row])
    issues = [*draft.issues, *expectation.issues, *_frame_questions(task, draft, uncorrected)]
    if task.mode == "convert":
        tolerance = path.robot_in_cell.tolerance
        issues += dwell_issues(program, targets.motion, targets.t, uncorrected.deflection, tolerance)
    result = Result(
        program=program,
        robot=task.robot,
        axis=path.robot_in_cell.spindle,
        mode=task.mode,
        written_dialect=task.written_dialect,
        issues=group_issues(issues),
        motion=targets.motion,
        t=targets.t,
        cut_length=cut_length,
        output_line=program.motions.line[targets.motion],
        nominal=path.sample.pose if len(row) == len(path) else path.sample.pose.take(row),
        printed=_printed_numbers(task, draft),
        wrench=path.wrench.of_rows(row),
        deflection=uncorrected.deflection,
        deflection_by_tool=uncorrected.by_tool,
        deviation_before=uncorrected.deviation,
        deviation_after=uncorrected.deviation,
        bound=expectation.bound,
        errors=expectation.errors,
        q=draft.q[row],
        joint_margin=kinematics.joint_margin(task.robot, draft.q),
        singular_value=kinematics.smallest_singular_value(task.robot, draft.q[row], path.tool(row)),
        path_deviation=uncorrected.largest,
        rounding=draft.selection.programmed_rounding,
        programmed_rounding=draft.selection.programmed_rounding,
        reversals=reversals,
        causes=_causes_of_deviation(task, path),
        is_stock_known=path.motions.forces.law_forces is not None,
        exact_forces=path.motions.forces.spread is None,
        turn=task.turn,
        redundancy_deg=None if program.keeps_text else path.robot_in_cell.cell.gcode.redundancy_deg,
        largest_correction=float(correction.max(initial=0.0)),
    )
    return result if draft.simulation is None else _with_simulation(result, draft, draft.simulation)


def _with_simulation(result: Result, draft: Draft, simulation: SimulatedPath) -> Result:
    """Return a result with the documents of the written program and the values that its simulation predicts.

    Issues of the force file are added. A draft that failed gets no documents.
    """
    divided_text = simulation.text.modules  # None: the program is written as one
    text = divided_text or simulation.text
    return replace(
        result,
        issues=group_issues([*result.issues, *draft.force_file_issues]),
        documents=() if draft.failed else text.documents,
        output_line=text.output_line,
        modules=() if divided_text is None else divided_text.first,
        deviation_after=simulation.deviation,
        path_deviation=simulation.largest_path_distance,
        rounding=simulation.rounding,
        file_forces=draft.file_forces,
    )


class _UncorrectedTargets(NamedTuple):
    """Deviations of the tool tip at the K targets without correction, `$BASE` [m].

    :param deviation: (K, 3) from nominal.
    :param deflection: (K, 3) by the wrench alone.
    :param by_tool: (K, 3) of that, by holder, spindle and tool; None if they are rigid.
    :param largest: largest distance from nominal: of a prediction along the whole path, else at the targets.
    """

    deviation: Array
    deflection: Array
    by_tool: Array | None
    largest: float


def _uncorrected_at_targets(task: Task, draft: Draft) -> _UncorrectedTargets:
    """Return the deviations at the targets without correction.

    :raises ImpossiblePathError: there is no equilibrium somewhere.
    """
    path, row = draft.path, draft.selection.row
    if task.mode != "predict":
        deviation, deflection, by_tool = uncorrected_deviations(path, row, draft.theta)
        return _UncorrectedTargets(deviation, deflection, by_tool, float(norm(deviation).max(initial=0.0)))
    all_samples = np.arange(len(path))
    deviation, deflection, by_tool = uncorrected_deviations(path, all_samples, draft.theta)
    largest = float(norm(deviation).max(initial=0.0))
    target_deviation = deviation[row]
    # one array where the load is the only cause of deviation: both have the same values
    deflection = target_deviation if deflection is deviation else deflection[row]
    return _UncorrectedTargets(target_deviation, deflection, by_tool if by_tool is None else by_tool[row], largest)


def _frame_questions(task: Task, draft: Draft, uncorrected: _UncorrectedTargets) -> Iterator[Issue]:
    """Yield the question whether `$BASE` contains the deviation without a force; none for a nominal program."""
    robot_in_cell = draft.path.robot_in_cell
    causes = _causes_at_rest(task.robot, robot_in_cell.cell)
    if causes and task.mode != "nominal":
        shift = norm(uncorrected.deviation - uncorrected.deflection)
        motion = draft.selection.targets.motion
        yield from plausibility.frame_question(draft.path.program, motion, shift, causes, robot_in_cell.cell)


def _causes_of_deviation(task: Task, path: PathUnderLoad) -> tuple[str, ...]:
    """Return the causes of deviation from nominal without correction, in words."""
    by_force = ("the cutting forces",) if path.wrench.values.any() else ()
    return by_force + _causes_at_rest(task.robot, path.robot_in_cell.cell)


def _causes_at_rest(robot: RobotModel, cell: Cell) -> tuple[str, ...]:
    """Return the causes of deviation from nominal without a force, in words."""
    return tuple(
        cause
        for cause, is_present in (
            ("the payload", cell.payload.mass_kg > 0.0),
            ("the calibrated geometry", not robot.geometry_is_nominal),
            # with `subtract_reference` deflections count from the arm under its own weight
            ("the weight of the arm", robot.has_weight and not robot.subtract_reference),
        )
        if is_present
    )


def _printed_numbers(task: Task, draft: Draft) -> Array:
    """Return X, Y, Z, A, B, C (K, 6) of the targets [mm, deg] as printed in the written (or unchanged) text."""
    if draft.simulation is not None:
        return draft.simulation.numbers
    targets, program = draft.selection.targets, draft.path.program
    numbers = targets.pose.xyzabc(slice(None))
    if task.mode == "predict" and program.keeps_text:  # the text of the program itself states the ends of motions
        ends = targets.t == 1.0
        numbers[ends] = program.numbers_as_written()[targets.motion[ends]]
    return numbers


class _TargetLoads(NamedTuple):
    """Loads at the K targets.

    :param q: (K, 6) joint angles [rad].
    :param tool: (4, 4) or (K, 4, 4) in the flange frame [m].
    :param wrench: (K, 6) on the tool at its tip, in the root [N, N·m].
    """

    q: Array
    tool: Array
    wrench: Array


def _loads(draft: Draft) -> _TargetLoads:
    """Return the loads at the targets of a draft."""
    path, row = draft.path, draft.selection.row
    return _TargetLoads(draft.q[row], path.tool(row), path.wrench_in_root(row))


def _reversals(draft: Draft) -> Reversals:
    """Return where joints change the direction of their torque on cutting moves; its rows are targets."""
    path = draft.path
    reversals = elastostatics.reversals(path.robot_in_cell.robot, *_loads(draft))
    is_cut = ~path.program.motions.rapid[draft.selection.targets.motion[reversals.row]]
    return Reversals(
        row=reversals.row[is_cut],
        previous_row=reversals.previous_row[is_cut],
        joint=reversals.joint[is_cut],
        step=reversals.step[is_cut],
    )


class _Expectation(NamedTuple):
    """What is expected on the part.

    :param bound: (K,) bound of the prediction (95 %) at targets [m]; None if it is not known.
    :param errors: expected on the part; None if `bound` is.
    :param issues: on the model and the loads.
    """

    bound: Array | None
    errors: ExpectedErrors | None
    issues: list[Issue]


def _expected_errors(
    task: Task, draft: Draft, deviation: Array, reversals: Reversals, cut_length: Array
) -> _Expectation:
    """Return the bound of the prediction and the expected errors on the part.

    Both are None, with an issue that says so, if the spread of the forces is stated but the robot model has no
    covariance, or if a bound is not finite. They are None without an issue if neither is stated.

    :param draft: with corrected commands.
    :param deviation: (K, 3) of the uncorrected tip from nominal, `$BASE` [m].
    :param reversals: torque reversals of joints: at the targets next to one, a gear may be on either flank.
    :param cut_length: (K,) length of the cutting path that each target represents [m].
    """
    path, row = draft.path, draft.selection.row
    robot, program = path.robot_in_cell.robot, path.program
    motion = draft.selection.targets.motion
    if robot.covariance is None:  # the model states no uncertainty of its parameters
        if path.motions.forces.spread is not None:  # the forces have standard deviations
            return _Expectation(None, None, [Issue("info", "no-bound", _NO_BOUND)])
        return _Expectation(None, None, list(checks.torque_warnings(program, robot, motion, *_loads(draft))))
    issues = list(checks.torque_warnings(program, robot, motion, *_loads(draft)))
    part_errors = _PartErrors(task, draft, deviation, cut_length, reversals)
    for part in chunks(len(row)):  # the displacement of a target by each parameter takes hundreds of bytes
        part_errors.add(part)
    bound = part_errors.bound
    if not np.isfinite(bound).all():
        issues.append(program.motions.issue("error", "no-bound", _NOT_FINITE, motion[~np.isfinite(bound)]))
        return _Expectation(None, None, issues)
    return _Expectation(bound, part_errors.expected(), issues)


class _PartErrors:
    """Errors on the part at the K targets of a draft, which are added part by part, and their sums over all.

    :ivar bound: (K,) bound of the prediction (95 %) at the targets [m].
    :ivar uncorrected_error: (K,) expected error of the position without correction [m]; `corrected_error` (K,) with it.
    :ivar deviation: (K, 3) of the uncorrected tip from nominal, `$BASE` [m]; `remaining_deviation` (K, 3) with
        correction.
    :ivar path_distance: (K,) largest distance from the path on the way to each target, with correction [m].
    :ivar path_excess: (K,) its excess over the distance at the target [m].
    :ivar extra_rounding: (K,) rounding by approximate positioning beyond that of the program as read [m].
    :ivar cut_length: (K,) length of the cutting path for which each target stands [m]; 0 on rapid moves.
    :ivar reverses: (K, 6) joints that may be on either flank of their gear.
    :ivar is_scaled: (K,) forces that the force factor of the robot model scales.
    :ivar gain: sums for the chance that correction lowers the errors.
    :ivar largest_errors: (2,) largest error with correction, if the robot or if the forces were known [m].
    """

    def __init__(self, task: Task, draft: Draft, deviation: Array, cut_length: Array, reversals: Reversals) -> None:
        path, count = draft.path, len(cut_length)
        self.bound, self.uncorrected_error, self.corrected_error = np.zeros((3, count))
        self.reverses = _joints_near_reversal(reversals, count)
        self.is_scaled = path.robot_in_cell.has_model_factor(
            path.motions.forces, path.sample.motion[draft.selection.row]
        )
        self.draft, self.deviation, self.cut_length = draft, deviation, cut_length
        self.remaining_deviation, self.path_distance = _remaining_errors(task, draft)
        self.path_excess = np.maximum(self.path_distance - norm(self.remaining_deviation), 0.0)
        self.extra_rounding = _extra_rounding(draft)
        self.gain, self.largest_errors = elastostatics.ChanceOfGain(), np.zeros(2)

    def add(self, targets: slice) -> None:
        """Compute the errors at some of the targets, and add them to the sums over all."""
        draft, path = self.draft, self.draft.path
        sample, motion = draft.selection.row[targets], draft.selection.targets.motion[targets]
        spread, tool_compliance = _load_uncertainty(path, sample)
        places = elastostatics.LoadedPlaces.of(
            draft.q[sample],
            path.tool(sample),
            path.wrench_in_root(sample),
            force_spread=spread,
            in_series=tool_compliance,
            changes_flank=self.reverses[targets],
            is_proportional=self.is_scaled[targets],
        )
        sources = elastostatics.sources_of_error(path.robot_in_cell.robot, places)
        frames = path.robot_in_cell.touched_frames
        if frames is not None:
            slopes = frames.slopes(path.pose_in_root(sample)[:, :3, 3])
            sources = sources.with_parameters(slopes, frames.covariance)
        uncorrected, corrected = (
            toolpath.directions_in_root(path.program, motion, offset[targets])
            for offset in (self.deviation, self.remaining_deviation)
        )
        cut_length = self.cut_length[targets]
        self.gain.add(sources, uncorrected, corrected, self.path_distance[targets], cut_length)
        expectation = elastostatics.expected_errors(sources, uncorrected, corrected)
        is_cut = cut_length > 0.0
        for k, error in enumerate((expectation.with_known_robot, expectation.with_known_forces)):
            total_error = error + self.extra_rounding[targets] + self.path_excess[targets]
            largest_error = np.max(total_error, initial=0.0, where=is_cut)
            self.largest_errors[k] = max(self.largest_errors[k], largest_error)
        self.bound[targets] = expectation.bound
        self.uncorrected_error[targets], self.corrected_error[targets] = expectation.before, expectation.after

    def expected(self) -> ExpectedErrors:
        """Return the expected errors on the part, after all targets were added."""
        # a robot program is rounded as read without correction too: its own rounding is no error
        uncorrected_rounding = 0.0 if self.draft.path.program.keeps_text else self.extra_rounding
        is_cut = self.cut_length > 0.0
        has_deviation = float(norm(self.deviation).max(initial=0.0)) > _NO_DEVIATION
        with_known_robot, with_known_forces = self.largest_errors.tolist()
        return ExpectedErrors(
            before=np.where(is_cut, self.uncorrected_error + uncorrected_rounding, 0.0),
            after=np.where(is_cut, self.corrected_error + self.extra_rounding + self.path_excess, 0.0),
            chance=self.gain.chance if has_deviation else None,
            with_known_robot=with_known_robot,
            with_known_forces=with_known_forces,
        )


def _remaining_errors(task: Task, draft: Draft) -> tuple[Array, Array]:
    """Return the errors with correction: deviations (K, 3) at targets, `$BASE`, and path errors (K,) before them [m].

    Both are zero without a simulation, and for a nominal program, which is judged by an exact correction.
    """
    count = len(draft.selection.row)
    if draft.simulation is None or task.mode == "nominal":
        return np.broadcast_to(0.0, (count, 3)), np.zeros(count)
    return draft.simulation.deviation, draft.simulation.path_distance


def _joints_near_reversal(reversals: Reversals, count: int) -> Bools:
    """Return which joints may be on either flank of their gear at each target, (count, 6): next to a reversal."""
    reverses = np.zeros((count, 6), dtype=bool)
    # the reversal is somewhere between the targets `previous_row` and `row`
    reverses[reversals.row, reversals.joint] = reverses[reversals.previous_row, reversals.joint] = True
    return reverses


def _extra_rounding(draft: Draft) -> Array:
    """Return the rounding (K,) at targets by approximate positioning beyond that of the program as read [m]."""
    if draft.simulation is None:
        return np.zeros(len(draft.selection.row))
    return np.maximum(draft.simulation.rounding - draft.selection.programmed_rounding, 0.0)


def _load_uncertainty(path: PathUnderLoad, row: Ints) -> tuple[Array | None, Array | None]:
    """Return the uncertainty of loads at samples (n,): the spread of the wrench and the compliance of the tool.

    :returns: the spread as in `elastostatics.position_bound`, or None if no force states one; (n, 6, 6) compliance in
        root axes [m/N, rad/(N·m)], or None if the tool is rigid.
    """
    spread, spring = path.motions.forces.spread_in_root(path.sample.take(row)), path.robot_in_cell.tool_spring
    return spread, None if spring is None else spring.matrices(path.pose_in_root(row)[:, :3, :3])


def _readback_forces(draft: Draft, readback: ReadBackProgram) -> tuple[Knots | None, tuple[Issue, ...]]:
    """Return the forces that a file gives to the written program; None with a warning if a file cannot give them.

    A file gives one force to a line, but passes of a line (rounds of a loop) may have different ones.
    """
    path_forces, targets = draft.path.motions.forces, draft.selection.targets
    travel, _ = forces.last_travel(readback.program, readback.segments, path_forces.axes.spindle)
    axes = Axes(readback.program, readback.segments, path_forces.axes.spindle, travel)
    piece_forces = forces.piece_knots(path_forces, targets, draft.forces_at_targets(), axes, readback.row)
    knots, ambiguous_targets = forces.first_pass_knots(piece_forces, readback.text.output_line)
    if not len(ambiguous_targets):
        return knots, ()
    return None, (
        draft.path.program.motions.issue(
            "warning", "forces-by-pass", _DIFFERENT_PASSES, targets.motion[ambiguous_targets]
        ),
    )


_ROUNDS = 8
"""Largest number of rounds that insert targets where the simulated program exceeds the tolerance (assumed)."""
_SLOWINGS = 5
"""Largest number of times that moves are slowed further, by 5 % each, if joints of the written program are too fast
(assumed)."""
_MOST_PARTS = 4
"""Largest number of parts into which a piece of an arc is divided in one round (assumed)."""


def read(documents: Sequence[Document], robot: RobotModel, cell: Cell, name: str, dialect: str) -> Program:
    """Read a program.

    :param documents: the main file first.
    :param dialect: name of its format, see `dialects.registry`.
    :raises InputError: the robot's controller does not read this language.
    :raises ProgramError: it cannot be interpreted; the message gives file, line, text and advice.
    """
    if registry.dialect_of_name(dialect).writer is not None:
        _check_language(documents[0].name, robot, dialect)
    robot_in_cell = RobotInCell.of(robot, cell)
    program = registry.dialect_of_name(dialect).read(documents, cell, robot_in_cell.forward, name)
    if len(program.motions) == 0:
        raise ProgramError("no motion in this program", file=documents[0].name, advice="Nothing can be corrected.")
    try:
        return read_only(led_by_wrist(program, robot_in_cell))
    except ImpossiblePathError as cause:
        problem, line = cause.issue.message.removesuffix("."), cause.issue.source_line
        raise ProgramError(problem, file=documents[0].name, line=line) from None


def process(
    program: Program,
    robot: RobotModel,
    cell: Cell,
    source: ForceSource | None = None,
    mode: Mode = "convert",
    *,
    linearize_arcs: bool = False,
    to: str | None = None,
) -> Result:
    """Correct a program, or predict its uncorrected path.

    :param program: as read.
    :param robot: the robot model.
    :param cell: the cell.
    :param source: forces in addition to the force comments of the program; they take precedence. None: the comments
        alone.
    :param mode: ``"convert"`` corrects, ``"nominal"`` writes the same moves without correction, ``"predict"`` writes
        nothing: it predicts the path of the uncorrected program at the targets that ``"convert"`` would write.
    :param linearize_arcs: write arcs as lines.
    :param to: dialect to write in; None = that of the program if it is written, else KRL.
    :returns: a result; with an issue of level error it holds no documents.
    :raises InputError: the program would be in a language that the robot's controller does not read.
    :raises ForceError: forces that cannot be given to the motions.
    """
    written_dialect, _ = registry.written_in(program.dialect, to)
    if mode != "predict":
        _check_language(program.documents[0].name, robot, written_dialect)
    task = Task(
        robot=robot,
        mode=mode,
        linearize_arcs=linearize_arcs,
        written_dialect=written_dialect,
        has_force_file=source is not None,
        initial_issues=_initial_issues(program, robot, cell, mode),
    )
    errors = [issue for issue in task.initial_issues if issue.level == "error"]
    robot_in_cell = RobotInCell.of(robot, cell)
    if not errors:
        turned_program = placement.in_chosen_turn(program, robot_in_cell, source)
        program = turned_program.program
        task = replace(task, turn=turned_program.turn, initial_issues=(*task.initial_issues, *turned_program.issues))
        errors = [issue for issue in turned_program.issues if issue.level == "error"]
    if not errors:
        try:
            motions = MotionsUnderLoad.of(program, robot_in_cell, source)
            questions = plausibility.force_questions(program, motions.forces, cell, robot)
            return _result_under_load(replace(task, initial_issues=(*task.initial_issues, *questions)), motions)
        except ImpossiblePathError as cause:
            errors = [cause.issue]
    return Result(program, robot, cell.tool.axis, mode, written_dialect, group_issues([*program.issues, *errors]))


def _initial_issues(program: Program, robot: RobotModel, cell: Cell, mode: Mode) -> tuple[Issue, ...]:
    """Return the issues of program and cell that need no kinematics and no forces."""
    return (
        *inspection.origin_issues(program, mode),
        *inspection.tool_change_issues(program, cell),
        *inspection.frame_issues(program, cell),
        *inspection.holder_issues(program, cell),
        *inspection.obstacle_issues(program, cell),
        *plausibility.setup_questions(program, cell, robot),
        *plausibility.tool_change_warnings(program, cell.tool.axis),
    )


def _result_under_load(task: Task, motions: MotionsUnderLoad) -> Result:
    """Return the result of motions under load: drafted until the tolerance holds, and checked for collisions.

    A draft is a program with its targets chosen, written as text, read back and simulated under load. Drafting may add
    an issue to the task. In the mode "predict", the correction only serves to place the targets.

    :raises ImpossiblePathError: a pose is out of reach or has no loaded equilibrium.
    """
    task, draft = _refine_until_tolerated(task, motions)
    smallest_clearance, collision_issues = collisions.path_clearance(draft.path, draft.q)
    draft = replace(draft, issues=(*draft.issues, *collision_issues))
    result = result_of(task, _without_correction(task, draft) if task.mode == "predict" else draft, draft)
    return replace(result, clearance=smallest_clearance)


def _check_language(file: str, robot: RobotModel, language: str) -> None:
    """Check that the controller reads the language.

    :raises InputError: it reads another one.
    """
    if robot.language not in ("", language):
        raise InputError(
            f"a program in {language} for {robot.title}, whose controller reads {robot.language}",
            file=file,
            advice=f"Name another robot in the cell, or convert G-code with --to {robot.language}. The "
            "language of a robot is in its model.toml.",
        )


class _Division(NamedTuple):
    """Places of a path that are sampled in addition to the ends of motions.

    :param pieces: the pieces of its arcs.
    :param extra_places: motion (n,) and t (n,) of places on straight motions.
    """

    pieces: Pieces
    extra_places: tuple[Ints, Array]


def _refine_until_tolerated(task: Task, motions: MotionsUnderLoad) -> tuple[Task, Draft]:
    """Draft the program; insert targets each round where its simulation exceeds the tolerance.

    A draft is a program with its targets chosen, written as text, read back and simulated under load.

    :returns: the task, with an issue if moves were slowed, and the draft.
    """
    division = _Division(_first_pieces(task, motions), motions.swing_places)
    drafts = _SlowedDrafts(task, motions)
    for _ in range(_ROUNDS):
        draft = drafts.draft(division)
        if draft.simulation is None or task.mode == "nominal" or len(draft.simulation.exceedances.motion) == 0:
            break
        division = _refine(task, draft.path, draft.simulation.exceedances, division.extra_places)
    return drafts.task, draft


class _SlowedDrafts:
    """Drafts of a program whose moves are slowed while joints of the written program are too fast.

    :ivar task: the task, with an issue once moves were slowed.
    :ivar motions: the motions at the feeds that were reached so far: later drafts begin with these.
    :ivar slowing: the motions that were slowed so far; None if none was.
    """

    def __init__(self, task: Task, motions: MotionsUnderLoad) -> None:
        self.task, self.motions = task, motions
        self.slowing: inspection.Slowing | None = None
        self._issues_before = task.initial_issues

    def draft(self, division: _Division) -> Draft:
        """Return the draft of a division of the path.

        Motions in which a joint is too fast are slowed, `_SLOWINGS` times at most; `motions`, `slowing` and `task` are
        then those of the slowed program.
        """
        draft = self._written(division)
        for _ in range(_SLOWINGS):
            too_fast = [issue for issue in draft.issues if issue.kind.startswith(checks.JOINT_SPEED)]
            if not too_fast:
                break
            fast_lines = {line for issue in too_fast for line in (issue.source_line or 0, *issue.lines)}
            q, position = draft.q, draft.path.sample.pose.position
            slow_motions = inspection.slow_fast_motions(draft.path, q, position, self.slowing, fast_lines)
            if slow_motions is None:  # nothing that may be slowed is too fast
                break
            self.motions, self.slowing = slow_motions
            issue = self.slowing.issue(self.motions.program.motions)
            self.task = replace(self.task, initial_issues=(*self._issues_before, issue))
            draft = self._written(division)
        return draft

    def _written(self, division: _Division) -> Draft:
        """Return the draft of a division of the path at the present feeds."""
        return _written_draft(self.task, PathUnderLoad.of(self.motions, division.pieces, division.extra_places))


def _first_pieces(task: Task, motions: MotionsUnderLoad) -> Pieces:
    """Return the first division of the arcs into pieces, each of which is written as one circle.

    Where the number of pieces is uncertain, it follows from the path error of larger ones.
    """
    pieces = motions.pieces(linearize_arcs=task.linearize_arcs)
    if pieces.uncertain.any():  # arcs whose path error is not known from the forces alone
        path = PathUnderLoad.of(motions, pieces)
        pieces = arc_pieces(CommandedPath.of(path, _commands(task, path)))
    return pieces


def _refine(task: Task, path: PathUnderLoad, exceedances: Exceedances, extra_places: tuple[Ints, Array]) -> _Division:
    """Return finer pieces of arcs and more places on straight motions where the path left the tolerance.

    :param extra_places: motion and t of the places that were inserted before; the new ones are appended.
    """
    motion, t, distance = exceedances
    is_on_arc = (path.program.motions.kind[motion] == CIRC) & (not task.linearize_arcs)
    # the path error falls with the square of the length of a piece
    part_count = np.sqrt(distance[is_on_arc] / (SHARE_OF_TOLERANCE * path.robot_in_cell.tolerance))
    part_count = np.clip(np.ceil(part_count), 2, _MOST_PARTS).astype(np.int64)
    pieces = path.arcs.refined_at(motion[is_on_arc], t[is_on_arc], part_count)
    is_straight = ~is_on_arc
    places = np.append(extra_places[0], motion[is_straight]), np.append(extra_places[1], t[is_straight])
    return _Division(pieces, places)


def _commands(task: Task, path: PathUnderLoad) -> Commands:
    """Return commanded joint angles and poses of all samples, by the mode of the task; poses in `$BASE`."""
    if task.mode == "nominal":
        return programmed_commands(path)
    try:
        return corrected_commands(path)
    except ImpossiblePathError:
        if task.mode == "convert":
            raise
        return programmed_commands(path)  # what cannot be corrected can still be predicted


def _written_draft(task: Task, path: PathUnderLoad) -> Draft:
    """Draft the program with targets at some of the samples; write it and read it back unless there is an error."""
    draft = _unwritten_draft(task, path)
    try:
        return draft if draft.failed else draft.write(task)
    except ProgramError:
        if task.mode == "predict":  # nothing is to be written: the text only serves to simulate the correction
            return draft
        raise


def _unwritten_draft(task: Task, path: PathUnderLoad) -> Draft:
    """Draft the program with targets at some of the samples, without its text and simulation."""
    command = _commands(task, path)
    selection = choose_targets(path, command, task.writer.least_arc, linearize_arcs=task.linearize_arcs)
    return Draft.of(task, path, command, selection)


def _without_correction(task: Task, draft: Draft) -> Draft:
    """Return the draft with the uncorrected commands: the correction only served to place the targets."""
    path, selection = draft.path, draft.selection
    selection = replace(selection, targets=replace(selection.targets, pose=path.sample.pose.take(selection.row)))
    return Draft.of(task, path, programmed_commands(path), selection)
