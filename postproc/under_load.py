"""The path of a program with its forces, tools and joint angles, in the root frame of the robot.

Correction, planning and reports start from a `PathUnderLoad`; no later stage needs the `$BASE` of a motion to find the
load on the robot. `RobotInCell` is a robot with payload, start position and compliance of the tool. `MotionsUnderLoad`
are the motions with the forces along them, from which the samples of the path are chosen. A path beyond the reach of
the robot is refused before it is sampled, which might take hours.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import force_setattr, replace

from postproc import elastostatics, forces, kinematics, toolpath
from postproc.cell import Cell
from postproc.chunks import Runs
from postproc.elastostatics import Compensation, ToolSpring
from postproc.errors import Issue, PostprocError
from postproc.forces import ForceSource, PathForces
from postproc.frames import M_PER_MM, MM_PER_M, Array, inverse, norm, product
from postproc.kinematics import ByWrist, JointPath, UnreachableError
from postproc.poses import Poses
from postproc.program import CIRC, PTP, Bools, Ints, Program, read_only
from postproc.robot import RobotModel
from postproc.toolpath import DisplacementEstimate, Pieces, Segments, Toolpath
from postproc.touched_frames import TouchedFrames

_GRID = np.radians(np.arange(-180.0, 180.0, 30.0))
"""Angles of A2, A3 and A5 [rad] that the reach is sought over; `_MARGIN` covers what is between."""
_MARGIN = 1.15
"""Factor on the reach found on a grid of joint angles: between points it is larger by up to 1 / cos(15°) per joint."""
_MOST_TURNS = 1000
"""An arc with more turns is refused: 1000 turns make a metre of thread."""
_MOST_REACHES = 10_000
"""A path longer than this many times the reach is refused: it would take two days at 10 m/min."""
_MOST_CUTS = 2000
"""Cuts by which the displacement of the arm at rest is fitted: it changes little over a part."""
_LEAST_CHECKED_SHARE = 0.1
"""Arcs shorter than this share of the reach are checked only at their ends (assumed)."""


class ImpossiblePathError(PostprocError):
    """A path that the robot cannot follow; `issue` has the place and the reason."""

    def __init__(self, issue: Issue) -> None:
        super().__init__(issue.message)
        self.issue = issue


def unreachable(program: Program, motion: Ints) -> Issue:
    """Return the error for motions (n,) that the robot cannot reach."""
    message = "out of reach (on the branch of [start] joints). Move the part or start in another configuration."
    return program.motions.issue("error", "unreachable", message, motion)


def check_ends(program: Program, robot: RobotModel) -> None:
    """Check that every Cartesian target is within reach of the flange.

    :raises ImpossiblePathError: a target is out of reach.
    """
    cartesian = np.flatnonzero(np.isnan(program.motions.joints[:, 0]))
    distance = _root_distance(program, cartesian, program.motions.target[cartesian], 1.0)
    reach = _reach(robot)
    largest_distance = float(np.nanmax(distance, initial=0.0))
    message = (
        f"out of reach: the flange would be up to {largest_distance * MM_PER_M:.0f} mm from the robot's root, "
        f"and its reach is {reach * MM_PER_M:.0f} mm. Check units, work offset and [base], or the targets."
    )
    _refuse_impossible(program, cartesian, ~(distance <= reach), "unreachable", message)


def check_arcs(program: Program, robot: RobotModel, path: Segments) -> None:
    """Check that arcs are within reach, and that their numbers of turns and the length of the path are plausible.

    Arcs of less than a turn are checked at their quarters, whole circles by their radius.

    :raises ImpossiblePathError: a check fails.
    """
    m = program.motions
    reach = _reach(robot)
    arcs = np.flatnonzero(m.kind == CIRC)
    radius = norm(path.start.at(arcs)[:, :3, 3] - m.centre[arcs])
    turns = m.sweep[arcs] / (2.0 * np.pi)
    is_invalid = ~(turns <= _MOST_TURNS)
    message = f"an arc of {turns.max(initial=0.0):.1f} turns, more than the permitted {_MOST_TURNS}. Check its angle."
    _refuse_impossible(program, arcs, is_invalid, "turns", message)
    is_invalid = (turns >= 1.0) & ~(radius <= reach)
    long_arcs = np.flatnonzero((turns < 1.0) & (path.length[arcs] > _LEAST_CHECKED_SHARE * reach))
    for share in (0.25, 0.5, 0.75):
        pose = toolpath.at(program, path, arcs[long_arcs], np.full(len(long_arcs), share)).pose[:]
        is_invalid[long_arcs] |= ~(_root_distance(program, arcs[long_arcs], pose, share) <= reach)
    message = (
        f"out of reach: the arc leaves the reach of the flange, {reach * MM_PER_M:.0f} mm from the robot's root. "
        "Check its centre or radius, and its plane."
    )
    _refuse_impossible(program, arcs, is_invalid, "unreachable", message)
    length = float(path.length.sum())
    if not length <= _MOST_REACHES * reach:
        message = (
            f"the path is {length / 1e3:.0f} km long, more than {_MOST_REACHES} times the reach of the robot. "
            "Check the units, or split the program."
        )
        raise ImpossiblePathError(Issue("error", "path-length", message, source_line=int(m.line[0])))


def _root_distance(program: Program, motion: Ints, pose: Array, t: float) -> Array:
    """Return the distance of the flange from the robot's root (n,) [m] for tool frames in `$BASE` (n, 4, 4).

    :param t: place on the motions at which the frames are, 0 at their start and 1 at their end.
    """
    return norm(toolpath.flange_points(program, motion, pose, np.zeros(3), t))


@lru_cache(maxsize=1)
def _reach(robot: RobotModel) -> float:
    """Return the largest distance of the flange from the robot's root [m], without joint limits."""
    q = np.zeros((len(_GRID) ** 3, 6))
    # A1 turns all of the arm; at the largest distance the wrist is stretched, where A4 and A6 only spin the flange
    q[:, 1], q[:, 2], q[:, 4] = (angle.ravel() for angle in np.meshgrid(_GRID, _GRID, _GRID))
    return _MARGIN * float(norm(kinematics.tcp(robot.nominal, q, np.eye(4))[0][:, :3, 3]).max())


def _refuse_impossible(program: Program, motion: Ints, is_impossible: Bools, kind: str, message: str) -> None:
    """Refuse a program with impossible motions: the error names all of them.

    :param motion: (n,) rows of `Motions`, and `is_impossible` (n,) True for those that are.
    :param kind: of the issue, and `message` its text.
    :raises ImpossiblePathError: a motion is impossible.
    """
    if is_impossible.any():
        raise ImpossiblePathError(program.motions.issue("error", kind, message, motion[is_impossible]))


class RobotInCell(Struct, frozen=True, eq=False, dict=True):
    """A robot in its cell.

    :param robot: the robot with the cell's payload.
    :param cell: the cell.
    :param touched_frames: displacement that was taken out of the model of the arm, since frames that the controller
        measured contain it. None: nothing was.
    """

    robot: RobotModel
    cell: Cell
    touched_frames: TouchedFrames | None = None

    @classmethod
    def of(cls, robot: RobotModel, cell: Cell) -> RobotInCell:
        """Combine a robot and a cell; the robot gets the payload of the cell."""
        load = cell.payload
        return cls(robot.with_payload(load.mass_kg, np.array([load.X, load.Y, load.Z]) * M_PER_MM), cell)

    def forward(self, q: Array) -> Array:
        """Return the flange (4, 4) in the root by the controller's geometry for joint angles (6,) [rad]."""
        state = kinematics.posture(self.robot.nominal, np.asarray(q, dtype=float)[:, None])
        return np.asarray(kinematics.matrices(state.pose)[0])

    def follow(self, program: Program, motion: Ints, t: Array, pose: Poses) -> JointPath:
        """Solve the joint angles of a path from where the cell starts, see `kinematics.follow`.

        :param motion: (N,) row of `Motions` of each of its places, in order; `t` (N,) the place on it; `pose` the
            N tool frames in its `$BASE` [m].
        :raises UnreachableError: a pose has no solution on its branch.
        """
        m = program.motions
        is_ptp_target = (t == 1.0) & (m.kind[motion] == PTP)
        ptp = motion[is_ptp_target]

        def flange(rows: Ints) -> Array:
            """Return the nominal flange (n, 4, 4) in the root at some of the places [m]."""
            return toolpath.flange_from_tcp(program, motion[rows], pose[rows], t[rows])

        return kinematics.follow(
            self.robot,
            flange,
            self.cell.start_joints,
            is_ptp_target=is_ptp_target,
            axis_target=m.joints[ptp],
            status=m.status[ptp],
            turn=m.turn[ptp],
        )

    def end_joints(self, program: Program) -> Array:
        """Return the joint angles (M, 6) at the ends of all motions of a program [rad].

        :raises ImpossiblePathError: a target is out of reach.
        """
        motions = np.arange(len(program.motions))
        try:
            return self.follow(program, motions, np.ones(len(motions)), program.motions.target).q
        except UnreachableError as cause:
            raise ImpossiblePathError(unreachable(program, np.array(cause.rows))) from None

    def has_model_factor(self, path_forces: PathForces, motion: Ints) -> Bools:
        """Return True (n,) for motions whose forces come from the cutting law that the robot model was identified with.

        The error of these forces is one factor, `RobotModel.force_factor`, which is a parameter of the model. False for
        all motions if the model has no such factor, or if the factor is that of another law.
        """
        factor, computed_cuts = self.robot.force_factor, path_forces.law_forces
        if factor is None or computed_cuts is None or not factor.is_of(computed_cuts.numbers):
            return np.zeros(len(motion), dtype=np.bool_)
        return np.asarray(np.isin(motion, computed_cuts.motion))

    @cached_property
    def tool_spring(self) -> ToolSpring | None:
        """Holder, spindle and tool as a spring at the tip; None where they are rigid."""
        compliance = self.cell.tool_compliance.diagonal()
        return ToolSpring(compliance) if compliance.any() else None

    @cached_property
    def start_flange(self) -> Array:
        """Flange (4, 4) in the root where the program starts [m]."""
        return self.forward(self.cell.start_joints)

    @property
    def spindle(self) -> str:
        """Axis of the tool frame that points from the spindle to the tip."""
        return self.cell.tool.axis

    @property
    def ramp(self) -> float:
        """Length over which the force changes [m]."""
        return self.cell.output.force_ramp_mm * M_PER_MM

    @property
    def tolerance(self) -> float:
        """Permitted deviation of the predicted path from the nominal one [m]."""
        return self.cell.tolerance

    @property
    def rest_is_nominal(self) -> bool:
        """True if the tool is exactly at the commanded pose without cutting force."""
        robot = self.robot
        return robot.geometry_is_nominal and robot.subtract_reference and self.cell.payload.mass_kg == 0.0

    def in_touched_frames(self, program: Program, segments: Segments) -> RobotInCell:
        """Return the robot as frames that its controller measured see it: `frames = "controller"` in the cell.

        A tip that touches the part is where the arm has it at rest, and the controller notes where its own geometry has
        it. So `$BASE` contains the displacement of the arm at rest, as far as that moves the part as a rigid body.
        This is fitted over the cuts, since the touched points are on the part too, and taken out of the arm. By this
        the arm leans a milliradian against its weights, which changes its sag by a micrometre.

        :raises ImpossiblePathError: a target is out of reach.
        """
        if self.cell.frames != "controller" or self.rest_is_nominal or self.touched_frames is not None:
            return self
        cuts, q = self._cut_ends(program, segments)
        if len(cuts) == 0:
            return self
        tool = toolpath.tool_of(program, cuts)
        nominal_tip = kinematics.tcp(self.robot.nominal, q, tool)[0][:, :3, 3]
        shift = elastostatics.loaded_tip(self.robot, q, tool, np.zeros((len(q), 6))) - nominal_tip
        frames = TouchedFrames.of(nominal_tip, shift, segments.length[cuts], program.motions.base[cuts])
        return RobotInCell(self.robot.with_root(inverse(frames.shift)), self.cell, frames)

    def _cut_ends(self, program: Program, segments: Segments) -> tuple[Ints, Array]:
        """Return cutting motions (n,), of many a part, and the joint angles (n, 6) at their ends [rad].

        :raises ImpossiblePathError: a target is out of reach.
        """
        m = program.motions
        cuts = np.flatnonzero(~m.rapid & (m.kind != PTP) & (segments.length > 0.0))
        if len(cuts) == 0:
            return cuts, np.empty((0, 6))
        cuts = cuts[:: -(-len(cuts) // _MOST_CUTS)]  # every k-th one, k rounded up
        return cuts, self.end_joints(program)[cuts]

    def tip_compliance(self, tool: Array) -> tuple[float, float]:
        """Return the approximate compliance of a tool (4, 4) at the start: per force [m/N] and per moment [m/(N·m)]."""
        force, moment = elastostatics.largest_compliance(self.robot, self.cell.start_joints, tool)
        tool_compliance = self.cell.tool_compliance.diagonal()
        return force + float(tool_compliance[:3].max()), moment + float(tool_compliance[3:].max())

    def compensate(self, target: Array, q_nominal: Array, tool: Array, wrench: Array) -> Compensation:
        """Find the commanded poses that put the loaded tool at its targets: see `elastostatics.compensate`.

        A compliant holder, spindle or tool deflects beyond the arm: the arm then aims at targets moved against that
        deflection, and carries the moment about its own tip.

        :param target: (n, 4, 4) tool frames in the root [m].
        :param q_nominal: (n, 6) joint angles of the uncorrected targets [rad].
        :param tool: (4, 4) or (n, 4, 4) tool in the flange frame [m].
        :param wrench: (n, 6) at the tip, root axes [N, N·m].
        :raises NotConvergedError: a target has no loaded equilibrium.
        """
        if (spring := self.tool_spring) is not None:
            target, wrench = spring.arm_target(target, wrench)
        return elastostatics.compensate(self.robot, target, q_nominal, tool, wrench)

    def tip(self, q: Array, tool: Array, wrench: Array, guess: Array | None = None) -> Array:
        """Return the position (n, 3) of the loaded tip in the root [m]; parameters: see `tip_and_tool_deflection`."""
        return self.tip_and_tool_deflection(q, tool, wrench, guess)[0]

    def tip_and_tool_deflection(
        self, q: Array, tool: Array, wrench: Array, guess: Array | None = None
    ) -> tuple[Array, Array]:
        """Return the loaded tip (n, 3) in the root, and the deflection (n, 3) of holder, spindle and tool in it [m].

        :param q: (n, 6) commanded joint angles [rad].
        :param tool: (4, 4) or (n, 4, 4) tool in the flange frame [m].
        :param wrench: (n, 6) at the tip, root axes [N, N·m].
        :param guess: (n, nv) initial guess of the deflections of the springs; None: zero.
        :raises NotConvergedError: the load is too large for the springs.
        """
        if (spring := self.tool_spring) is not None:
            return spring.loaded_tip(self.robot, q, tool, wrench, guess)
        tip = elastostatics.loaded_tip(self.robot, q, tool, wrench, guess)
        return tip, np.zeros_like(tip)


class _PtpEnds(NamedTuple):
    """Begin and end of the P PTP motions of a program.

    :param row: (P,) rows of `Motions`.
    :param begin: (P, 6) joint angles at their begin [rad].
    :param end: (P, 6) joint angles at their end [rad].
    """

    row: Ints
    begin: Array
    end: Array

    def joints_of(self, motion: Ints) -> tuple[Array, Array]:
        """Return the joint angles (n, 6) at begin and end of PTP motions (n,), rows of `Motions` [rad]."""
        ptp = np.searchsorted(self.row, motion)
        return self.begin[ptp], self.end[ptp]


_STEP_ANGLE = 0.5 * np.pi
"""Motions that turn the tool by more [rad] are followed at places between their ends: no axis gains a turn unseen."""


class PtpMoves(Struct, frozen=True, eq=False, dict=True):
    """The PTP motions of a program in its cell: all axes begin and end together, and move in proportion.

    Synchronous PTP of KUKA controllers: KUKA System Software, operating and programming instructions, "PTP motion". The
    path does not depend on speed or acceleration; approximated ends are taken as exact ones. Implements
    `toolpath.JointMoves`.

    :param program: the program.
    :param robot_in_cell: the robot in its cell.
    :param segments: start and length of the motions, without their PTPs.
    """

    program: Program
    robot_in_cell: RobotInCell
    segments: Segments

    @cached_property
    def _ends(self) -> _PtpEnds:
        """Joint angles at begin and end of the PTPs.

        All motions up to the last of them are followed, since a joint angle depends on the turns before it.

        :raises ImpossiblePathError: a pose before the last of them is out of reach.
        """
        program, cell = self.program, self.robot_in_cell.cell
        ptp = np.flatnonzero(program.motions.kind == PTP)
        rows = np.arange(int(ptp[-1]) + 1)
        is_path_motion = program.motions.kind[rows] != PTP
        step_count = np.where(is_path_motion, np.ceil(self.segments.turn[rows] / _STEP_ANGLE), 1.0)
        place_count = step_count.astype(np.int64).clip(1)
        motion, t = toolpath.even_places(rows, place_count)
        last_places = np.cumsum(place_count) - 1
        sample = toolpath.at(program, self.segments, motion, t)
        try:
            q = self.robot_in_cell.follow(program, motion, t, sample.pose).q[last_places]
        except UnreachableError as cause:
            raise ImpossiblePathError(unreachable(program, motion[list(cause.rows)])) from None
        previous = program.predecessors[ptp]
        begin = np.where(previous[:, None] >= 0, q[previous], cell.start_joints)
        return _PtpEnds(ptp, begin, q[ptp])

    def at(self, motion: Ints, t: Array) -> Array:
        """Return the tool frames (n, 4, 4) in `$BASE` [m] at places (motion, t) of PTP motions.

        :raises ImpossiblePathError: a pose before the last PTP is out of reach.
        """
        begin, end = self._ends.joints_of(motion)
        q = begin + t[:, None] * (end - begin)
        flange = kinematics.matrices(kinematics.posture(self.robot_in_cell.robot.nominal, q.T).pose)
        pose = product(flange, toolpath.tool_of(self.program, motion))
        return toolpath.pose_in_base(self.program, motion, pose, t)

    def turn(self, motion: Ints) -> Array:
        """Return the sum of the turns of all axes (n,) [rad] on PTP motions.

        :raises ImpossiblePathError: a pose before the last PTP is out of reach.
        """
        begin, end = self._ends.joints_of(motion)
        return np.asarray(np.abs(end - begin).sum(axis=1))


def segments_in_cell(program: Program, robot_in_cell: RobotInCell) -> Segments:
    """Return start and length of the motions of a program, and its PTPs as this robot drives them."""
    path = toolpath.segments(program, robot_in_cell.start_flange)
    if not (program.motions.kind == PTP).any():
        return path
    return replace(path, joint_moves=PtpMoves(program, robot_in_cell, path))


_MOST_WRIST_TURN = np.radians(90.0)
"""Farther than this no wrist axis may turn on a motion: which way round would not be certain."""
_LEAST_A5 = np.radians(1.0)
"""A5 may not be nearer to 0 where the wrist turns the tool: A4 and A6 are not certain there."""
_WRIST_ADVICE = "Use $ORI_TYPE=#VAR, or divide the motion."


def led_by_wrist(program: Program, robot_in_cell: RobotInCell) -> Program:
    """Return a program with `Program.wrist`: how the robot turns the tool on motions on which the wrist axes do so.

    A program without such motions is returned as it is. Both ends are on the branch of the path, so that A5 does not
    pass through 0.

    :raises ImpossiblePathError: a wrist axis turns too far to be certain, or a pose has no solution.
    """
    if program.is_wrist_led is None:
        return program
    check_ends(program, robot_in_cell.robot)
    m, motion = program.motions, np.flatnonzero(program.is_wrist_led)
    start_pose = toolpath.segments(program, robot_in_cell.start_flange).start.at(motion)
    start_tip, end_tip = (
        toolpath.pose_in_root(program, motion, pose)[:, :3, 3] for pose in (start_pose, m.target[motion])
    )
    joints = _wrist_led_joints(program, robot_in_cell, motion)
    try:
        wrist = ByWrist.of(
            robot_in_cell.robot,
            count=len(m),
            motion=motion,
            joints=joints,
            tip=np.stack([start_tip, end_tip], axis=1),
            base=program.bases[m.base[motion], :3, :3],
            tool=program.tools[m.tool[motion]],
        )
    except UnreachableError as cause:
        raise ImpossiblePathError(unreachable(program, np.array(cause.rows))) from None
    return replace(program, wrist=wrist)


def _wrist_led_joints(program: Program, robot_in_cell: RobotInCell, motion: Ints) -> tuple[Array, Array]:
    """Return the joint angles (n, 6) [rad] at start and end of motions (n,) on which the wrist axes turn the tool.

    From start to end each joint turns by the shorter way.

    :raises ImpossiblePathError: a wrist axis turns too far to be certain, or a target is out of reach.
    """
    end = robot_in_cell.end_joints(program)
    previous = program.predecessors[motion]  # −1: the start of the program
    begin = np.where(previous[:, None] >= 0, end[previous], robot_in_cell.cell.start_joints)
    change = (end[motion] - begin + np.pi) % (2.0 * np.pi) - np.pi
    is_unclear = (np.abs(change[:, 3:]) > _MOST_WRIST_TURN).any(axis=1)
    is_unclear |= np.minimum(np.abs(begin[:, 4]), np.abs(end[motion, 4])) < _LEAST_A5
    message = (
        "under $ORI_TYPE=#JOINT this motion begins or ends near the singular pose of the wrist, or a wrist axis turns "
        f"by more than {np.degrees(_MOST_WRIST_TURN):g}°: how the controller leads A4 to A6 is not certain. "
        f"{_WRIST_ADVICE}"
    )
    _refuse_impossible(program, motion, is_unclear, "wrist-led", message)
    return begin, begin + change


SHARE_OF_TOLERANCE = 0.4
"""Share of the tolerance for deviations at the samples of the path; the rest is for deviations between them."""


class MotionsUnderLoad(Struct, frozen=True, eq=False):
    """The motions of a program with the forces along them, in the cell of a robot.

    :param program: the program.
    :param robot_in_cell: the robot in its cell.
    :param segments: start and length of the motions.
    :param forces: the forces along them.
    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    :param estimate: approximate displacement of the tool by the forces.
    :param swing_places: places of straight motions that are needed where FEED forces swing: motion (n,) and t (n,).
    """

    program: Program
    robot_in_cell: RobotInCell
    segments: Segments
    forces: PathForces
    compliance: tuple[float, float]
    estimate: DisplacementEstimate
    swing_places: tuple[Ints, Array]

    @classmethod
    def of(cls, program: Program, robot_in_cell: RobotInCell, source: ForceSource | None) -> MotionsUnderLoad:
        """Assign forces to the motions of a program.

        :param source: forces that take precedence over the comments of the program; None: the comments alone.
        :raises ImpossiblePathError: the path is out of reach or implausibly long.
        :raises ForceError: the forces do not match the motions.
        """
        check_ends(program, robot_in_cell.robot)
        segments = segments_in_cell(program, robot_in_cell)
        check_arcs(program, robot_in_cell.robot, segments)
        robot_in_cell = robot_in_cell.in_touched_frames(program, segments)
        path_forces = forces.assign(program, segments, source, robot_in_cell.spindle, robot_in_cell.ramp)
        compliance = robot_in_cell.tip_compliance(program.tools[0])
        swing_places = forces.swing_places(path_forces, compliance, SHARE_OF_TOLERANCE * robot_in_cell.tolerance)
        return cls(
            program=program,
            robot_in_cell=robot_in_cell,
            segments=segments,
            forces=path_forces,
            compliance=compliance,
            estimate=forces.displacement_estimate(path_forces, compliance),
            swing_places=swing_places,
        )

    def pieces(self, *, linearize_arcs: bool) -> Pieces:
        """Return the initial division of the arcs into pieces.

        :param linearize_arcs: replace arcs by chords.
        """
        tolerance = self.robot_in_cell.tolerance
        arcs = toolpath.pieces(self.segments, tolerance, self.estimate, linearize_arcs=linearize_arcs)
        return forces.refined_arcs(self.forces, arcs, self.estimate, self.compliance, SHARE_OF_TOLERANCE * tolerance)


class PathUnderLoad(Struct, frozen=True, eq=False):
    """N samples of the nominal path of a program. Row i of every array is the same sample.

    :param motions: the motions and the forces along them.
    :param arcs: the pieces of its arcs.
    :param sample: the places and their poses in `$BASE`.
    :param wrench: (N, 6) wrench on the tool at its tip [N, N·m], `$BASE` axes; an array becomes `Runs`.
    :param joints: joint angles by the controller's nominal geometry, and their branch.
    """

    motions: MotionsUnderLoad
    arcs: Pieces
    sample: Toolpath
    wrench: Runs
    joints: JointPath

    def __post_init__(self) -> None:
        force_setattr(self, "wrench", Runs.of(self.wrench))

    @classmethod
    def of(
        cls, motions: MotionsUnderLoad, arcs: Pieces, extra_places: tuple[Ints, Array] | None = None
    ) -> PathUnderLoad:
        """Sample the motions as closely as arcs and forces need, and solve the joint angles.

        :param arcs: the pieces of the arcs.
        :param extra_places: places of straight motions that are needed: motion (n,), t (n,); default:
            `motions.swing_places`.
        :raises ImpossiblePathError: a sample is out of reach.
        """
        program, robot_in_cell = motions.program, motions.robot_in_cell
        extra_places = motions.swing_places if extra_places is None else extra_places
        motion, t = toolpath.places(
            program, motions.segments, robot_in_cell.tolerance, motions.estimate, arcs, extra_places
        )
        sample = toolpath.at(program, motions.segments, motion, t)
        try:
            joints = robot_in_cell.follow(program, motion, t, sample.pose)
        except UnreachableError as cause:
            raise ImpossiblePathError(unreachable(program, motion[list(cause.rows)])) from None
        return read_only(cls(motions, arcs, sample, Runs.of(motions.forces.at(sample)), joints))

    def __len__(self) -> int:
        return len(self.sample)

    @property
    def program(self) -> Program:
        """The program."""
        return self.motions.program

    def tool(self, rows: Ints) -> Array:
        """Return `$TOOL` in the flange frame at samples (n,) [m]: (4, 4) if the program has one, else (n, 4, 4)."""
        return toolpath.tool_of(self.program, self.sample.motion[rows])

    def pose_in_root(self, rows: Ints) -> Array:
        """Return the tool frame in the robot root at samples (n,): (n, 4, 4) [m]."""
        motion, t = self.sample.motion[rows], self.sample.t[rows]
        return toolpath.pose_in_root(self.program, motion, self.sample.pose[rows], t)

    def wrench_in_root(self, rows: Ints) -> Array:
        """Return the wrench in root axes at samples (n,): (n, 6) [N, N·m]."""
        return toolpath.wrench_in_root(self.program, self.sample.motion[rows], self.wrench.take(rows))

    def tip_in_base(self, rows: Ints, q: Array, wrench_in_root: Array, guess: Array) -> tuple[Array, Array]:
        """Return the loaded tip (n, 3) at samples (n,), and the deflection of holder, spindle and tool (n, 3).

        Both are in the `$BASE` of the motions [m]; the deflection is included in the tip position.

        :param q: (n, 6) joint angles [rad].
        :param wrench_in_root: (n, 6) [N, N·m].
        :param guess: (n, nv) initial guess of the deflections of the springs.
        :raises NotConvergedError: no loaded equilibrium: the load is too large for the springs.
        """
        motion = self.sample.motion[rows]
        tip, tool_deflection = self.robot_in_cell.tip_and_tool_deflection(q, self.tool(rows), wrench_in_root, guess)
        if self.robot_in_cell.tool_spring is not None:
            rotation = toolpath.base_of(self.program, motion)[..., :3, :3]
            tool_deflection = np.asarray(np.einsum("...i,...ij->...j", tool_deflection, rotation))
        return toolpath.points_in_base(self.program, motion, tip, self.sample.t[rows]), tool_deflection

    @property
    def robot_in_cell(self) -> RobotInCell:
        """The robot in its cell."""
        return self.motions.robot_in_cell
