"""The life of a program, stage by stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from postproc import elastostatics, forces, kinematics, toolpath
from postproc.cell import Cell
from postproc.chunks import in_chunks
from postproc.compensation import Compensation, compensate
from postproc.correction import blending, bounds, checks, closely, select, swings, verify
from postproc.correction.result import Mode, Result
from postproc.correction.root import InRoot
from postproc.dialects import registry
from postproc.errors import Issue, NotConvergedError, PostprocError, ProgramError, group_issues
from postproc.forces import ForceSource, Knots, PathForces
from postproc.frames import M_PER_MM, Array, largest, norm, twist_between, xyzabc_from_pose
from postproc.kinematics import JointPath, UnreachableError
from postproc.program import CIRC, LIN, PTP, Bools, Document, Ints, Program, TargetForces, TargetJoints, Targets
from postproc.robot import RobotModel
from postproc.toolpath import Pieces, Segments, Toolpath

_UNCHANGED = 1e-7
"""A correction below this [m, rad] is none: the text of a KRL target is left to the byte."""
_ROUNDS = 8
"""How often targets are inserted where the simulation of the written program leaves the tolerance."""
_MOST_PARTS = 4
"""Into so many parts at most a piece of an arc is divided at once there."""
_NO_BALANCE = "no command holds the tool here under this force: singular pose, or a force beyond the springs."
_NO_BOUND = (
    "the forces have standard deviations, but the robot model has no covariance: there is no bound (u95_mm) to which "
    "they could be added."
)
_SHARE_OF_TOLERANCE = 0.4
"""Of the tolerance, what a run between targets may use up at the places computed; the rest is for between them."""


def read(documents: Sequence[Document], robot: RobotModel, cell: Cell, name: str, dialect: str) -> Program:
    """Read a program.

    :param documents: the main file first.
    :param dialect: name of its format, see `dialects.registry`.
    :raises ProgramError: it is not understood; the message names file, line, text and what to do.
    """
    program = registry.by_name(dialect).read(documents, cell, InRoot.of(robot, cell).forward, name)
    if len(program.motions) == 0:
        raise ProgramError("no motion in this program", file=documents[0].name, advice="Nothing can be corrected.")
    return program


class _BlockedError(PostprocError):
    """A stage has no result; `issue` says at which line."""

    def __init__(self, issue: Issue) -> None:
        super().__init__(issue.message)
        self.issue = issue


@dataclass(frozen=True, slots=True, eq=False)
class _Sampled:
    """The nominal path with its forces and joint angles, and the commands found for it. Row i: sample i.

    Poses, those of `command` too, are in `$BASE`.
    """

    path: Segments
    load: PathForces
    arcs: Pieces
    sample: Toolpath
    wrench: Array
    joints: JointPath
    command: Compensation


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
    """Correct a program, or predict what it does as it stands.

    :param program: as read.
    :param robot: the robot model.
    :param cell: the cell.
    :param source: forces beside the comments of the program; they win.
    :param mode: ``"convert"`` corrects, ``"nominal"`` writes the same moves without correction, ``"predict"`` writes
        nothing: it tells what the program does as it stands, at the places where ``"convert"`` would have its targets.
    :param linearize_arcs: write arcs as lines.
    :param to: dialect to write in; None = that of the program if it is written, else KRL.
    :returns: a result; with an issue of level error it holds no documents.
    :raises ForceError: forces that cannot be given to the motions.
    """
    _, writer = registry.written_in(program.dialect, to)
    told = _of_origin(program, mode)
    if _blocked(told):
        return _nothing(program, robot, cell, mode, told[0])
    place = InRoot.of(robot, cell)
    arcs: Pieces | None = None
    also: tuple[Ints, Array] | None = None
    for _ in range(_ROUNDS):
        try:
            sampled = _sample(program, place, source, mode, linearize_arcs, arcs, also)
            if sampled.arcs.uncertain.any():
                arcs = _divided(program, place, sampled)
                sampled = _sample(program, place, source, mode, linearize_arcs, arcs, also)
        except _BlockedError as cause:
            return _nothing(program, robot, cell, mode, cause.issue)
        targets, row, arrive = _targets(program, place, sampled, linearize_arcs)
        issues = [*told, *program.issues, *sampled.load.issues, *_checked(program, place, sampled)]
        text, simulated, at_end = None, None, None
        if not _blocked(issues):
            at_end = forces.of_targets(sampled.load, targets, arrive, sampled.wrench[row])
            try:
                comments = at_end if program.notes and source is None else None
                text = writer.write(program, targets, _joints_at(place, sampled, row), cell, comments)
            except ProgramError:
                if mode == "predict":
                    break
                raise
            issues += text.issues
            if not _blocked(issues):
                simulated = verify.simulate(
                    program, sampled.path, sampled.load, targets, sampled.sample.pose[row, :3, 3], text, place, row,
                    sampled.command.theta, sampled.joints.branch, corrected=mode != "nominal",
                )  # fmt: skip
        if mode == "nominal" or simulated is None or len(simulated.missed[0]) == 0:
            break
        # between its targets the written path leaves the tolerance: look there too, and insert what is needed
        motion, t, missed = simulated.missed
        on_arc = (program.motions.kind[motion] == CIRC) & (not linearize_arcs)
        parts = np.sqrt(missed[on_arc] / (_SHARE_OF_TOLERANCE * place.tolerance))
        arcs = sampled.arcs.finer(motion[on_arc], t[on_arc], np.clip(np.ceil(parts), 2, _MOST_PARTS).astype(np.int64))
        more = motion[~on_arc], t[~on_arc]
        also = more if also is None else _joined(also, more)
    everywhere = row
    if mode == "predict":  # it was corrected only to find the places
        sampled = replace(sampled, command=_as_it_stands(place, sampled.sample, sampled.joints))
        targets, text = replace(targets, pose=sampled.sample.pose[row]), None
        issues = [*told, *program.issues, *sampled.load.issues, *_checked(program, place, sampled)]
        everywhere = np.arange(len(sampled.sample))
    try:
        uncorrected, deflection = _uncorrected(program, place, sampled, everywhere)
    except NotConvergedError as cause:
        motion = sampled.sample.motion[everywhere[list(cause.rows)]]
        return _nothing(program, robot, cell, mode, _at_rows("not-converged", _NO_BALANCE, program, motion))
    between = float(norm(uncorrected).max(initial=0.0))
    if mode == "predict":
        uncorrected, deflection = uncorrected[row], deflection[row]
    as_written = uncorrected
    documents: tuple[Document, ...] = ()
    programmed = np.zeros(len(row))
    if program.keeps_text:
        programmed = blending.programmed(program, sampled.path, targets.motion)
    rounding = programmed
    output_line, printed = program.motions.line[targets.motion], xyzabc_from_pose(targets.pose)
    if mode == "predict" and program.keeps_text:
        ends = targets.t == 1.0
        printed[ends] = program.numbers_as_written()[targets.motion[ends]]
    if text is not None and simulated is not None:
        issues += simulated.issues
        output_line, documents = text.output_line, () if _blocked(issues) else text.documents
        as_written, between, printed = simulated.deviation, simulated.between, simulated.printed
        rounding = simulated.rounding
    carried = None
    if documents and source is not None and at_end is not None and simulated is not None and simulated.written:
        carried = _carried(sampled.load, targets, at_end, *simulated.written)
    tool = place.tool(program, targets.motion)
    q, wrench = sampled.command.q[row], sampled.wrench[row]
    spread = sampled.load.spread_at(sampled.sample.take(row))
    if spread is not None:
        spread = place.spread(program, targets.motion, spread)
        if robot.covariance is None:
            issues.append(Issue("info", "no-bound", _NO_BOUND))
    correction = targets.pose[:, :3, 3] - sampled.sample.pose[row, :3, 3]
    return Result(
        program=program,
        robot=robot,
        axis=place.axis,
        mode=mode,
        documents=documents,
        motion=targets.motion,
        t=targets.t,
        output_line=output_line,
        nominal=sampled.sample.pose[row],
        printed=printed,
        wrench=wrench,
        deflection=deflection,
        deviation_before=uncorrected,
        deviation_after=as_written,
        bound=elastostatics.position_bound(place.robot, q, tool, place.wrench(program, targets.motion, wrench), spread),
        q=q,
        joint_margin=kinematics.joint_margin(robot, sampled.command.q),
        singular_value=kinematics.smallest_singular_value(robot, q, tool),
        between=between,
        rounding=rounding,
        programmed=programmed,
        carried=carried,
        largest_correction=float(norm(correction).max(initial=0.0)),
        issues=group_issues(issues),
    )


def _joints_at(place: InRoot, sampled: _Sampled, row: Ints) -> TargetJoints:
    """Return the joint angles at the targets (K rows of the samples)."""
    q = sampled.command.q[row]
    return TargetJoints(q, kinematics.status_of(place.robot, q))


def _of_origin(program: Program, mode: Mode) -> list[Issue]:
    """Return what there is to say about a program that postproc wrote: it is not corrected a second time."""
    writer = registry.by_name(program.dialect).writer
    origin = None if writer is None else writer.origin(program.documents)
    if origin is None or origin.state == "none":
        return []
    if mode != "predict" and origin.mode != "nominal":
        message = (
            f"this program was corrected by postproc {origin.version} before: its targets are commands already, and "
            "would be corrected twice. Convert the program that it was made from."
        )
        return [Issue("error", "corrected-before", message, origin.line)]
    if origin.state == "changed":
        message = f"this program was changed since postproc {origin.version} wrote it."
        return [Issue("warning", "changed-since", message, origin.line)]
    return []


def _carried(
    load: PathForces, targets: Targets, at_end: TargetForces, written: Program, path: Segments, row: Ints
) -> Knots:
    """Return the forces that a CSV file gives to a written program."""
    spindle = load.axes.spindle
    travel, _ = forces.last_travel(written, path, spindle)
    return forces.of_pieces(load, targets, at_end, forces.Axes(written, path, spindle, travel), row)


def _blocked(issues: Sequence[Issue]) -> bool:
    return any(issue.level == "error" for issue in issues)


def _joined(one: tuple[Ints, Array], other: tuple[Ints, Array]) -> tuple[Ints, Array]:
    return np.concatenate([one[0], other[0]]), np.concatenate([one[1], other[1]])


def _sample(
    program: Program,
    place: InRoot,
    source: ForceSource | None,
    mode: Mode,
    linearize_arcs: bool,
    arcs: Pieces | None,
    also: tuple[Ints, Array] | None,
) -> _Sampled:
    for issue in bounds.ends(program, place.robot):
        raise _BlockedError(issue)
    path = toolpath.segments(program, place.start_flange)
    for issue in bounds.between(program, place.robot, path):
        raise _BlockedError(issue)
    load = forces.along(program, path, source, place.axis, place.ramp)
    softness = elastostatics.softness(place.robot, place.cell.start_joints, program.tools[0])
    estimate = forces.estimate(load, softness)
    if arcs is None:
        arcs = toolpath.pieces(program, path, place.tolerance, estimate, linearize_arcs=linearize_arcs)
        if not linearize_arcs:
            limit = _SHARE_OF_TOLERANCE * place.tolerance
            arcs = swings.followed(program, path, load, arcs, estimate, softness, limit)
    motion, t = toolpath.places(program, path, place.tolerance, estimate, arcs, also)
    sample = toolpath.at(program, path, motion, t)
    wrench = load.at(sample)
    m = program.motions
    free = sample.ends & (m.kind[motion] == PTP)
    ptp = motion[free]

    def flange(rows: Ints) -> Array:
        return toolpath.flange_from_tcp(program, motion[rows], sample.pose[rows])

    try:
        joints = kinematics.follow(
            place.robot, flange, place.cell.start_joints, free, m.joints[ptp], m.status[ptp], m.turn[ptp]
        )
    except UnreachableError as cause:
        bad = np.zeros(len(motion), dtype=bool)
        bad[list(cause.rows)] = True
        raise _BlockedError(next(checks.unreachable(program, motion, bad))) from None
    if mode == "nominal":
        return _Sampled(path, load, arcs, sample, wrench, joints, _as_it_stands(place, sample, joints))
    movable = np.isnan(m.joints[motion, 0])
    try:
        command = _compensated(program, place, sample, wrench, joints, movable)
    except NotConvergedError as cause:
        if mode == "convert":
            raise _BlockedError(_at_rows("not-converged", _NO_BALANCE, program, motion[list(cause.rows)])) from None
        command = _as_it_stands(place, sample, joints)  # what cannot be corrected can still be predicted
    return _Sampled(path, load, arcs, sample, wrench, joints, command)


def _as_it_stands(place: InRoot, sample: Toolpath, joints: JointPath) -> Compensation:
    """Return the commands of the program as it is."""
    return Compensation(joints.q, sample.pose, np.zeros((len(joints.q), place.robot.actual.nv)))


def _at_rows(kind: str, message: str, program: Program, motion: Ints) -> Issue:
    """Return an error that names the first of the motions concerned and counts them."""
    first = int(program.motions.line[motion.min()])
    return Issue("error", kind, message, source_line=first, count=len(np.unique(motion)))


def _compensated(
    program: Program, place: InRoot, sample: Toolpath, wrench: Array, joints: JointPath, movable: Bools
) -> Compensation:
    """Correct all samples but axis targets, which are left as they stand."""

    def corrected(motion: Ints, pose: Array, wrench: Array, q: Array, movable: Bools) -> tuple[Array, Array, Array]:
        rows = np.flatnonzero(movable)
        motion = motion[rows]
        target, force = place.pose(program, motion, pose[rows]), place.wrench(program, motion, wrench[rows])
        try:
            found = compensate(place.robot, target, q[rows], place.tool(program, motion), force)
        except NotConvergedError as cause:
            raise NotConvergedError(str(cause), rows[list(cause.rows)]) from None
        q, pose, theta = q.copy(), pose.copy(), np.zeros((len(q), place.robot.actual.nv))
        q[rows], pose[rows], theta[rows] = found.q, place.back(program, motion, found.pose), found.theta
        return q, pose, theta

    return Compensation(*in_chunks(corrected, sample.motion, sample.pose, wrench, joints.q, movable))


def _checked(program: Program, place: InRoot, sampled: _Sampled) -> list[Issue]:
    """Return the issues of the path as commanded."""
    robot, sample, q = place.robot, sampled.sample, sampled.command.q
    position = sampled.command.pose[:, :3, 3]
    correction = norm(position - sample.pose[:, :3, 3])
    speed = checks.joint_speed(program, sample, sampled.path.turn, q, position)
    arcs = closely.needed(program, place, sample, q, speed)
    found = [
        *checks.start_joints(program, robot, place.cell.start_joints),
        *checks.first_move(program, sampled.joints, place.cell.start_joints),
        *checks.posture(program, robot, sample, sampled.joints, place.cell.start_joints),
        *checks.status_and_turn(program, robot, sample, sampled.joints.q),
        *checks.joint_limits(program, robot, sample, q),
        *checks.singularities(program, robot, sample, q, arcs),
        *checks.joint_speeds(program, robot, sample, speed),
        *checks.correction_size(program, sample.motion, correction, place.cell.output.max_correction_mm * M_PER_MM),
    ]
    told = {issue.kind for issue in found}
    more = closely.look(program, place, sampled.path, sample, q, position, sampled.joints, arcs)
    return [*found, *(issue for issue in more if issue.kind not in told)]


def _unchanged(program: Program, sampled: _Sampled) -> tuple[Bools, Bools]:
    """Return which motions are one target whatever lies between (M,), and which end as their text says (M,).

    Where a program keeps its text, that is those that need no correction. Where a motion starts matters to straight
    lines, which may then have to be divided, and to circles, which are other circles then; a PTP ends where it ends.
    """
    m = program.motions
    if not program.keeps_text:
        return np.zeros(len(m), dtype=bool), np.zeros(len(m), dtype=bool)
    sample = sampled.sample
    moved = largest(twist_between(sample.pose, sampled.command.pose)) > _UNCHANGED
    first = np.flatnonzero(np.concatenate([[True], np.diff(sample.motion) != 0]))
    end_moved = moved[sample.ends]
    any_moved = np.maximum.reduceat(moved, first) | np.concatenate([[False], end_moved[:-1]])
    arcs = m.kind == CIRC
    # a circle is what it was if it starts where it did to the last digit, and so does each circle before it
    rows, changed = np.arange(len(m)), np.where(arcs, any_moved, end_moved)
    last_changed = np.maximum.accumulate(np.where(changed, rows, -2))
    last_other = np.maximum.accumulate(np.where(arcs, -1, rows))
    kept = np.where(arcs, last_changed < last_other, ~end_moved)
    return np.where(m.kind == LIN, ~any_moved, kept), kept


def _starts(program: Program, place: InRoot, sampled: _Sampled) -> Array:
    """Return the commanded positions (M, 3) where the motions start, in their `$BASE` [m]."""
    ends = np.flatnonzero(sampled.sample.ends)
    starts = toolpath.starts(program, lambda motion: sampled.command.pose[ends[motion]], place.start_flange)
    start = np.roll(sampled.command.pose[ends, :3, 3], 1, axis=0)
    start[starts.changed] = starts.pose[:, :3, 3]
    return start


def _divided(program: Program, place: InRoot, sampled: _Sampled) -> Pieces:
    """Return how many pieces of arcs are needed, by what larger ones miss."""
    position, start = sampled.command.pose[:, :3, 3], _starts(program, place, sampled)
    return select.pieces_needed(sampled.arcs, sampled.sample, position, start, _SHARE_OF_TOLERANCE * place.tolerance)


def _targets(program: Program, place: InRoot, sampled: _Sampled, linearize_arcs: bool) -> tuple[Targets, Ints, Array]:
    """Choose what to write; return the targets, the row of each among the samples, and the direction to it (K, 3)."""
    m, sample = program.motions, sampled.sample
    whole, kept = _unchanged(program, sampled)
    position, start = sampled.command.pose[:, :3, 3], _starts(program, place, sampled)
    kind = np.where(m.kind == CIRC, LIN, m.kind) if linearize_arcs else m.kind
    limit = _SHARE_OF_TOLERANCE * place.tolerance
    selected = select.choose(kind, sample, sampled.arcs, position, start, limit, whole)
    movable = np.isnan(m.joints[sample.motion[selected.row], 0])
    row, target_kind, via_row = selected.row[movable], selected.kind[movable], selected.via[movable]
    motion = sample.motion[row]
    via = np.full((len(row), 3), np.nan)
    arcs = via_row >= 0
    via[arcs] = position[via_row[arcs]]
    status, turn = _status_and_turn(program, place, row, motion, sampled.command.q)
    keep = kept[motion] & (sample.t[row] == 1.0)
    pose = sampled.command.pose[row]
    targets = Targets(motion, sample.t[row], target_kind, pose, via, keep, status, turn, m.blend[motion])
    corners, arrive = blending.of_targets(program, targets, start)
    return replace(targets, blend=blending.distances(program, targets, corners, place.cell)), row, arrive


def _status_and_turn(program: Program, place: InRoot, row: Ints, motion: Ints, q: Array) -> tuple[Ints, Ints]:
    """Return S and T of PTP targets: of a program that keeps its text where it gives them, else always."""
    m = program.motions
    status, turn = np.full(len(row), -1), np.full(len(row), -1)
    ptp = np.flatnonzero(m.kind[motion] == PTP)
    if len(ptp):
        new_status, new_turn = kinematics.status_of(place.robot, q[row[ptp]]), kinematics.turn_of(q[row[ptp]])
        if not program.keeps_text:
            status[ptp], turn[ptp] = new_status, new_turn
        else:
            given, given_turn = m.status[motion[ptp]], m.turn[motion[ptp]]
            status[ptp] = np.where(given >= 0, given & ~7 | new_status, -1)
            turn[ptp] = np.where(given_turn >= 0, given_turn & ~63 | new_turn, -1)
    return status, turn


def _uncorrected(program: Program, place: InRoot, sampled: _Sampled, row: Ints) -> tuple[Array, Array]:
    """Return what the targets (K rows of the samples) would do uncorrected.

    That is the tip seen from nominal (K, 3), and the displacement by the wrench alone (K, 3), `$BASE` [m].
    """
    robot = place.robot

    def deflected(row: Ints) -> tuple[Array, Array]:
        motion, nominal = sampled.sample.motion[row], sampled.sample.pose[row, :3, 3]
        force = place.wrench(program, motion, sampled.wrench[row])
        state = sampled.joints.q[row], place.tool(program, motion)
        tip = place.points_back(program, motion, _tip(robot, *state, force, sampled.command.theta[row]))
        if place.rest_is_nominal:
            return tip - nominal, tip - nominal
        rest = _tip(robot, *state, np.zeros_like(force), sampled.command.theta[row])
        return tip - nominal, tip - place.points_back(program, motion, rest)

    deviation, deflection = in_chunks(deflected, row)
    return deviation, deflection


def _tip(robot: RobotModel, q: Array, tool: Array, wrench: Array, guess: Array) -> Array:
    """Return the tip (n, 3) in the root [m] under a wrench."""
    x = elastostatics.spread(robot, q.T)
    return elastostatics.solve_equilibrium(robot, x, kinematics.components(tool), wrench.T, guess.T).tip.T


def _nothing(program: Program, robot: RobotModel, cell: Cell, mode: Mode, issue: Issue) -> Result:
    """Return the result of a program that could not be computed at all."""
    none, frames = np.zeros(0), np.zeros((0, 4, 4))
    rows = np.zeros(0, dtype=np.int64)
    return Result(
        program=program,
        robot=robot,
        axis=cell.tool.axis,
        mode=mode,
        documents=(),
        motion=rows,
        t=none,
        output_line=rows,
        nominal=frames,
        printed=np.zeros((0, 6)),
        wrench=np.zeros((0, 6)),
        deflection=np.zeros((0, 3)),
        deviation_before=np.zeros((0, 3)),
        deviation_after=np.zeros((0, 3)),
        bound=None,
        q=np.zeros((0, 6)),
        joint_margin=np.full(6, np.nan),
        singular_value=np.nan,
        between=np.nan,
        rounding=none,
        programmed=none,
        carried=None,
        largest_correction=np.nan,
        issues=group_issues([*program.issues, issue]),
    )
