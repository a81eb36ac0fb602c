"""Draft of a program: targets chosen, text written, read back and simulated; and the result made from it."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import elastostatics, forces, kinematics, toolpath
from postproc.cell import Cell
from postproc.correction import checks, commanded, inspection
from postproc.correction.read_back import ReadBack, UnusableTextError, read_back
from postproc.correction.result import Doubt, Mode, Result, doubtful
from postproc.correction.targets import Chosen
from postproc.correction.verify import Simulated, simulate
from postproc.dialects.dialect import Writer
from postproc.elastostatics import Compensation, Reversals
from postproc.errors import Issue, group_issues
from postproc.forces import Axes, Knots
from postproc.frames import Array, norm, xyzabc_from_pose
from postproc.placement import Turn
from postproc.program import Ints, TargetForces, TargetJoints, Written
from postproc.robot import RobotModel
from postproc.under_load import PathUnderLoad

_MB = 1e6
_NO_BOUND = (
    "the forces have standard deviations, but the robot model has no covariance: there is no bound (u95_mm) to which "
    "they could be added."
)

_NOT_FINITE = (
    "the expected error of the tool position (u95_mm) is not a number here: the pose is singular, or [covariance] of "
    "the robot model is wrong."
)

_BY_PASS = (
    "passes of this line have different forces: no force file can hold them, and none is written. `predict` of the "
    "written program needs the process, or forces as comments."
)


class Task(Struct, frozen=True, eq=False):
    """Settings for processing a program, see `process`.

    :param in_file: True if its forces are read from and written to a file, False for comments.
    :param initial_issues: issues found before anything is computed.
    :param turn: the turn of the tool about its axis, if it was chosen.
    """

    robot: RobotModel
    mode: Mode
    linearize_arcs: bool
    writer: Writer
    in_file: bool
    initial_issues: tuple[Issue, ...]
    turn: Turn | None = None


class Draft(Struct, frozen=True, eq=False):
    """A program with targets at some of the samples of its path.

    :param path: the path.
    :param q: (N, 6) commanded joint angles at its samples [rad]; the commanded poses are in the targets.
    :param theta: (N, nv) deflections of the springs there [rad, m].
    :param chosen: the targets.
    :param issues: issues found so far.
    :param simulated: simulation of the written program; None if it is not written yet, or cannot be used.
    :param carried: forces that a file must give to the written program, and `unlike`, the issues of that file; None if
        its comments do.
    """

    path: PathUnderLoad
    q: Array
    theta: Array
    chosen: Chosen
    issues: tuple[Issue, ...]
    simulated: Simulated | None = None
    carried: Knots | None = None
    unlike: tuple[Issue, ...] = ()

    @classmethod
    def of(cls, task: Task, path: PathUnderLoad, command: Compensation, chosen: Chosen) -> Draft:
        """Return the draft with the issues of the task, the program, its forces and its commanded path."""
        issues = (
            *task.initial_issues,
            *path.program.issues,
            *path.motions.forces.issues,
            *inspection.of_path(path, command),
        )
        return cls(path, command.q, command.theta, chosen, issues)

    @property
    def failed(self) -> bool:
        """True if it has an issue of level error."""
        return any(issue.level == "error" for issue in self.issues)

    def forces_at_targets(self) -> TargetForces:
        """Return the wrench at each target in the form that the written program needs."""
        chosen = self.chosen
        return forces.of_targets(self.path.motions.forces, chosen.targets, chosen.arrive, self.path.wrench[chosen.row])

    def written(self, task: Task) -> Draft:
        """Return the draft written, read back and simulated, as far as possible.

        :raises ProgramError: it cannot be written.
        """
        path, chosen, text = self.path, self.chosen, self._text(task)
        draft = replace(self, issues=(*self.issues, *text.issues, *_too_large(text, path.setting.cell)))
        if draft.failed:
            return draft
        try:
            back = read_back(path, chosen, text)
            simulated = simulate(path, chosen, self.theta, back, corrected=task.mode != "nominal")
        except UnusableTextError as cause:
            return replace(draft, issues=(*draft.issues, cause.issue))
        known = {issue.kind for issue in draft.issues}
        more = [issue for issue in simulated.issues if issue.kind not in known or issue.kind == "blending"]
        draft = replace(draft, simulated=simulated, issues=(*draft.issues, *more))
        if draft.failed or not task.in_file:
            return draft
        carried, unlike = _carried(draft, back)
        return replace(draft, carried=carried, unlike=unlike)

    def _text(self, task: Task) -> Written:
        path, q = self.path, self.q.take(self.chosen.row, axis=0)
        comments = self.forces_at_targets() if path.program.notes and not task.in_file else None
        joints = TargetJoints(q, kinematics.status_of(task.robot, q))
        return task.writer.write(path.program, self.chosen.targets, joints, path.setting.cell, comments)


def _too_large(text: Written, cell: Cell) -> tuple[Issue, ...]:
    """Return a warning if a written program is larger than the memory of the controller."""
    size, memory = text.size / _MB, cell.output.program_memory_MB
    if size <= memory:
        return ()
    message = (
        f"the program has {size:.3g} MB, {size / memory:.2g} times program_memory_MB = {memory:g} of [output]: the "
        "controller may not load it. Raise tolerance_mm, give forces as a file instead of comments, or divide "
        "the job into several programs, one for each operation."
    )
    return (Issue("warning", "program-memory", message),)


def result_of(task: Task, draft: Draft) -> Result:
    """Return the result of a draft; a program that is not written is predicted without correction."""
    path, row, targets, program = draft.path, draft.chosen.row, draft.chosen.targets, draft.path.program
    rows = np.arange(len(path)) if task.mode == "predict" else row
    without = commanded.uncorrected(path, rows, draft.theta)
    between = float(norm(without[0]).max(initial=0.0))
    if task.mode == "predict":
        without = tuple(each[row] for each in without)
    deviation, deflection, by_tool = without
    turned = _reversals(draft)
    bound, doubt, more = _bound(draft, norm(deviation), turned)
    result = Result(
        program=program,
        robot=task.robot,
        axis=path.setting.spindle,
        mode=task.mode,
        issues=group_issues([*draft.issues, *more]),
        motion=targets.motion,
        t=targets.t,
        output_line=program.motions.line[targets.motion],
        nominal=_at(path.sample.pose, row),
        printed=_numbers(task, draft),
        wrench=_at(path.wrench, row),
        deflection=deflection,
        deflection_by_tool=None if path.setting.tool_spring is None else by_tool,
        deviation_before=deviation,
        deviation_after=deviation,
        bound=bound,
        doubt=doubt if task.mode == "convert" else None,
        q=_at(draft.q, row),
        joint_margin=kinematics.joint_margin(task.robot, draft.q),
        singular_value=kinematics.smallest_singular_value(task.robot, draft.q[row], path.tool(row)),
        between=between,
        rounding=draft.chosen.programmed,
        programmed=draft.chosen.programmed,
        reversals=turned,
        causes=_causes(path),
        exact_forces=path.motions.forces.spread is None,
        turn=task.turn,
        redundancy_deg=None if program.keeps_text else path.setting.cell.gcode.redundancy_deg,
        largest_correction=float(norm(targets.pose[:, :3, 3] - path.sample.pose[row, :3, 3]).max(initial=0.0)),
    )
    if (written := draft.simulated) is None:
        return result
    return replace(
        result,
        issues=group_issues([*result.issues, *draft.unlike]),
        documents=() if draft.failed else written.text.documents,
        output_line=written.text.output_line,
        deviation_after=written.deviation,
        between=written.between,
        rounding=written.rounding,
        carried=draft.carried,
    )


def _at(samples: Array, row: Ints) -> Array:
    """Return rows (K,) of an array of samples; the array itself, without a copy, if these are all of them."""
    return samples if len(row) == len(samples) else samples.take(row, axis=0)


def _causes(path: PathUnderLoad) -> tuple[str, ...]:
    """Return the causes of deviation from nominal, in words."""
    setting = path.setting
    robot = setting.robot
    return tuple(
        cause
        for cause, acts in (
            ("the cutting forces", bool(path.wrench.any())),
            ("the payload", setting.cell.payload.mass_kg > 0.0),
            ("the calibrated geometry", not robot.geometry_is_nominal),
            ("the weight of the arm", robot.has_weight and not robot.subtract_reference),
        )
        if acts
    )


def _numbers(task: Task, draft: Draft) -> Array:
    """Return X, Y, Z, A, B, C (K, 6) of the targets [mm, deg] as printed in the written (or unchanged) text."""
    if draft.simulated is not None:
        return draft.simulated.numbers
    targets, program = draft.chosen.targets, draft.path.program
    numbers = xyzabc_from_pose(targets.pose)
    if task.mode == "predict" and program.keeps_text:
        ends = targets.t == 1.0
        numbers[ends] = program.numbers_as_written()[targets.motion[ends]]
    return numbers


def _reversals(draft: Draft) -> Reversals:
    """Return where joints change the direction of their torque on cutting moves; rows are those of the targets."""
    path, row = draft.path, draft.chosen.row
    found = elastostatics.reversals(path.setting.robot, draft.q[row], path.tool(row), path.wrench_in_root(row))
    cuts = ~path.program.motions.rapid[draft.chosen.targets.motion[found.row]]
    return Reversals(found.row[cuts], found.before[cuts], found.joint[cuts], found.step[cuts])


def _bound(draft: Draft, corrected: Array, turned: Reversals) -> tuple[Array | None, Doubt | None, list[Issue]]:
    """Return the expected error (K,) by model and forces (95 %), or None; where it exceeds the correction; issues.

    :param corrected: (K,) distance of the uncorrected tip from nominal [m].
    :param turned: torque reversals: at the targets next to one, gears may be on either flank.
    """
    path, row = draft.path, draft.chosen.row
    robot = path.setting.robot
    spread = path.motions.forces.spread_at(path.sample.take(row))
    if spread is not None and robot.covariance is None:
        return None, None, [Issue("info", "no-bound", _NO_BOUND)]
    in_root = None
    if spread is not None:
        halves = toolpath.columns_in_root(path.program, path.sample.motion[row], spread)
        in_root = np.zeros((len(row), 6, 6))
        in_root[:, :3, :3], in_root[:, 3:, 3:] = halves[:, 0], halves[:, 1]
    spring = path.setting.tool_spring
    in_series = None if spring is None else spring.matrices(path.pose_in_root(row)[:, :3, :3])
    q, wrench, tool = draft.q[row], path.wrench_in_root(row), path.tool(row)
    issues = list(checks.beyond_measured(path.program, robot, draft.chosen.targets.motion, q, tool, wrench))
    turning = np.zeros((len(row), 6), dtype=bool)
    turning[turned.row, turned.joint] = turning[turned.before, turned.joint] = True
    bound = elastostatics.position_bound(robot, q, tool, wrench, in_root, in_series, turning)
    if bound is None:
        return None, None, issues
    motion = draft.chosen.targets.motion
    if not np.isfinite(bound).all():
        return (
            None,
            None,
            [*issues, path.program.motions.issue("error", "no-bound", _NOT_FINITE, motion[~np.isfinite(bound)])],
        )
    found = doubtful(bound, corrected, path.program.motions.rapid[motion])
    if found is None:
        return bound, None, issues
    at, level = found
    one = slice(at, at + 1)
    forces_there, series = (each if each is None else each[one] for each in (in_root, in_series))
    tool = tool[one] if tool.ndim == 3 else tool
    source = elastostatics.largest_source(robot, q[one], tool, wrench[one], forces_there, series, turning=turning[one])
    return bound, Doubt(at, float(bound[at]), level, source), issues


def _carried(draft: Draft, back: ReadBack) -> tuple[Knots | None, tuple[Issue, ...]]:
    """Return the forces that a file gives to the written program, None with a warning if it cannot hold them."""
    along, targets = draft.path.motions.forces, draft.chosen.targets
    travel, _ = forces.last_travel(back.program, back.segments, along.axes.spindle)
    axes = Axes(back.program, back.segments, along.axes.spindle, travel)
    every = forces.of_pieces(along, targets, draft.forces_at_targets(), axes, back.row)
    knots, differ = forces.once_a_line(every, back.text.output_line)
    if not len(differ):
        return knots, ()
    return None, (draft.path.program.motions.issue("warning", "forces-by-pass", _BY_PASS, targets.motion[differ]),)
