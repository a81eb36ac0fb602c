"""A program on its way out: what was chosen, written, read back and simulated, and the result made of it."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import elastostatics, forces, kinematics, toolpath
from postproc.compensation import Compensation
from postproc.correction import blending, checks, commanded, inspection
from postproc.correction.read_back import ReadBack, UnusableTextError, read_back
from postproc.correction.result import Mode, Result
from postproc.correction.targets import Chosen
from postproc.correction.verify import Simulated, simulate
from postproc.dialects.dialect import Writer
from postproc.errors import Issue, group_issues
from postproc.forces import Axes, Knots
from postproc.frames import Array, norm, xyzabc_from_pose
from postproc.program import Program, TargetForces, TargetJoints, Written
from postproc.robot import RobotModel
from postproc.under_load import PathUnderLoad, RobotInCell

_NO_BOUND = (
    "the forces have standard deviations, but the robot model has no covariance: there is no bound (u95_mm) to which "
    "they could be added."
)

_EXACT_FORCES = (
    "the forces state no standard deviation: what is to be expected on the part (u95_mm) counts them as exact. A CSV "
    "says how far they may be off in sFx, sFy, sFz or sigma_percent."
)


class Task(Struct, frozen=True, eq=False):
    """What is to be done with a program, see `process`.

    :param comments: its forces go with it as comments.
    :param in_file: its forces go with it in a file.
    :param told: what there is to say before anything is computed.
    """

    program: Program
    robot: RobotModel
    setting: RobotInCell
    mode: Mode
    linearize_arcs: bool
    writer: Writer
    comments: bool
    in_file: bool
    told: tuple[Issue, ...]

    def issues(self, path: PathUnderLoad, command: Compensation) -> tuple[Issue, ...]:
        """Return what is told of the program, its forces and its path as commanded."""
        of_path = inspection.of_path(path, command)
        return (*self.told, *self.program.issues, *path.motions.forces.issues, *of_path)


class Draft(Struct, frozen=True, eq=False):
    """A program with targets at some of the samples of its path.

    :param path: the path.
    :param q: (N, 6) joint angles that the controller is told at its samples [rad]; its poses stand in the targets.
    :param theta: (N, nv) deflections of the springs there [rad, m].
    :param chosen: the targets.
    :param issues: what there is to tell.
    :param text: the program as text; None as long as it is not written.
    :param back: the text read back; None as long as it is not, or cannot be.
    :param simulated: what the program as written does; None as long as it is not simulated.
    """

    path: PathUnderLoad
    q: Array
    theta: Array
    chosen: Chosen
    issues: tuple[Issue, ...]
    text: Written | None = None
    back: ReadBack | None = None
    simulated: Simulated | None = None

    @property
    def failed(self) -> bool:
        """True if an issue of level error stands against it."""
        return any(issue.level == "error" for issue in self.issues)

    def forces_at_targets(self) -> TargetForces:
        """Return the wrench at each target as the written program must be given it."""
        chosen = self.chosen
        return forces.of_targets(self.path.motions.forces, chosen.targets, chosen.arrive, self.path.wrench[chosen.row])

    def written(self, task: Task) -> Draft:
        """Return the draft with its text.

        :raises ProgramError: it cannot be written.
        """
        chosen = self.chosen
        comments = self.forces_at_targets() if task.comments else None
        q = self.q[chosen.row]
        joints = TargetJoints(q, kinematics.status_of(task.setting.robot, q))
        text = task.writer.write(task.program, chosen.targets, joints, task.setting.cell, comments)
        return replace(self, text=text, issues=(*self.issues, *text.issues))

    def simulated_by(self, task: Task) -> Draft:
        """Return the draft with its text read back and simulated, if that can be done."""
        if self.text is None:
            return self
        try:
            back = read_back(self.path, self.chosen, self.text)
            corrected = task.mode != "nominal"
            simulated = simulate(self.path, self.chosen, self.theta, back, corrected=corrected)
        except UnusableTextError as cause:
            return replace(self, issues=(*self.issues, cause.issue))
        return replace(self, back=back, simulated=simulated, issues=(*self.issues, *simulated.issues))


def result_of(task: Task, draft: Draft) -> Result:
    """Make the result of a draft; what is not written is predicted as it stands."""
    path, row, targets, program = draft.path, draft.chosen.row, draft.chosen.targets, task.program
    rows = np.arange(len(path)) if task.mode == "predict" else row
    without = commanded.uncorrected(path, rows, draft.theta)
    between = float(norm(without.deviation).max(initial=0.0))
    if task.mode == "predict":
        without = without.take(row)
    programmed = np.zeros(len(row))
    if program.keeps_text:
        programmed = blending.programmed(program, path.motions.segments, targets.motion)
    bound, untold = _bound(draft)
    result = Result(
        program=program,
        robot=task.robot,
        axis=task.setting.spindle,
        mode=task.mode,
        documents=(),
        motion=targets.motion,
        t=targets.t,
        output_line=program.motions.line[targets.motion],
        nominal=path.sample.pose[row],
        printed=_numbers(task, draft) if draft.back is None else draft.back.numbers,
        wrench=path.wrench[row],
        deflection=without.deflection,
        deflection_by_tool=None if task.setting.tool_spring is None else without.by_tool,
        deviation_before=without.deviation,
        deviation_after=without.deviation,
        bound=bound,
        q=draft.q[row],
        joint_margin=kinematics.joint_margin(task.robot, draft.q),
        singular_value=kinematics.smallest_singular_value(task.robot, draft.q[row], path.tool(row)),
        between=between,
        rounding=programmed,
        programmed=programmed,
        carried=None,
        largest_correction=float(norm(targets.pose[:, :3, 3] - path.sample.pose[row, :3, 3]).max(initial=0.0)),
        issues=group_issues([*draft.issues, *untold]),
    )
    if draft.text is None or draft.simulated is None or draft.back is None:
        return result
    return replace(
        result,
        documents=() if draft.failed else draft.text.documents,
        output_line=draft.text.output_line,
        deviation_after=draft.simulated.deviation,
        between=draft.simulated.between,
        rounding=draft.simulated.rounding,
        carried=None if draft.failed or not task.in_file else _carried(draft, draft.back),
    )


def _numbers(task: Task, draft: Draft) -> Array:
    """Return X, Y, Z, A, B, C (K, 6) of the targets [mm, deg]; where the text of the program stays, as it has them."""
    targets = draft.chosen.targets
    numbers = xyzabc_from_pose(targets.pose)
    if task.mode == "predict" and task.program.keeps_text:
        ends = targets.t == 1.0
        numbers[ends] = task.program.numbers_as_written()[targets.motion[ends]]
    return numbers


def _bound(draft: Draft) -> tuple[Array | None, list[Issue]]:
    """Return the bound (K,) of what the model and the forces leave open, or None; and what to tell if there is none."""
    path, row = draft.path, draft.chosen.row
    robot = path.setting.robot
    spread = path.motions.forces.spread_at(path.sample.take(row))
    if spread is not None and robot.covariance is None:
        return None, [Issue("info", "no-bound", _NO_BOUND)]
    in_root = None
    if spread is not None:
        halves = toolpath.columns_in_root(path.program, path.sample.motion[row], spread)
        in_root = np.zeros((len(row), 6, 6))
        in_root[:, :3, :3], in_root[:, 3:, 3:] = halves[:, 0], halves[:, 1]
    spring = path.setting.tool_spring
    in_series = None if spring is None else spring.matrices(path.pose_in_root(row)[:, :3, :3])
    q, wrench, tool = draft.q[row], path.wrench_in_root(row), path.tool(row)
    told = list(checks.beyond_measured(path.program, robot, draft.chosen.targets.motion, q, tool, wrench))
    if spread is None and robot.covariance is not None and wrench.any():
        told.append(Issue("info", "exact-forces", _EXACT_FORCES))
    return elastostatics.position_bound(robot, q, tool, wrench, in_root, in_series), told


def _carried(draft: Draft, back: ReadBack) -> Knots:
    """Return the forces that a file gives to the written program."""
    along = draft.path.motions.forces
    travel, _ = forces.last_travel(back.program, back.segments, along.axes.spindle)
    axes = Axes(back.program, back.segments, along.axes.spindle, travel)
    return forces.of_pieces(along, draft.chosen.targets, draft.forces_at_targets(), axes, back.row)
