"""A program that is cut uncorrected: where its probed surfaces are made, and the state of the robot there.

A wall is made where the cylinder of a flat end mill passes next to it, a floor where its end face passes over it. The
deviation of a surface is the displacement of that point of the deflected tool along the normal of the surface: with the
twist of the tool (displacement d of the tip, rotation r) and the lever l from the tip to the point, n·(d + r × l). The
end face tilts with the tool: of the points of its rim that pass over a place of the floor, the lowest makes it.

The forces are those of the deflected tool: it cuts less wide and less deep than programmed (`machining.Shift`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import elastostatics, toolpath
from postproc.chunks import Columns
from postproc.errors import MeasurementError
from postproc.frames import Array, norm, twist_between
from postproc.kinematics.forward import GRAVITY
from postproc.machining import ProcessSource, Shift
from postproc.program import Bools, Ints, Program
from postproc.robot import Parameter, RobotModel
from postproc.testpart.probing import ProbedSurfaces
from postproc.under_load import ImpossiblePathError, MotionsUnderLoad, PathUnderLoad, RobotInCell

_SURFACE_TOLERANCE = 5e-5
"""Largest distance of a stated point from the surface that the tool makes there [m] (assumed)."""
_FLOOR_COSINE = 0.99
"""Cosine of the angle between normal and tool from which a surface is a floor: up to 8° of slope."""
_WALL_COSINE = 0.05
"""Cosine of the angle between normal and tool up to which a surface is a wall: 3° from the tool."""
_PARAMETER_STEP = 1e-2
"""Relative change of a parameter for the derivative by it: the model is linear in each but for the load's stiffness."""
_SCALE_STEP = 1e-3
"""Relative change of the forces for the derivative by their scale."""
LIFT_STEP = 1e-4
"""Lift of the program over the block for the derivative by it [m]: forces are nearly linear in the depth of cut."""


class TwistSlopes(NamedTuple):
    """Twist of the tool from nominal in n states, and its derivatives; root axes [m, rad].

    :param twist: (n, 6) translation and rotation.
    :param by_parameter: (n, 6, p) derivatives by linear values of parameters, per SI unit.
    :param by_scale: (n, 6) derivatives by the factor of the cutting forces.
    """

    twist: Array
    by_parameter: Array
    by_scale: Array


class Surfaces(Columns, frozen=True, eq=False):
    """The places where n probed surfaces are made.

    :param motion: (n,) row of `Motions` of their program, and `t` (n,) the place on it: 0 at its start, 1 at its end.
    :param by_twist: (n, 2, 6) two derivatives of the deviation by the twist of the tool in the root: the smaller of the
        two deviations remains on the part, see `twist_derivatives`.
    :param is_wall: (n,) True for walls, which a larger tool moves into the material; False for floors and readings of a
        gauge.
    :param weight_wrench: (n, 6) wrench of a weight hung on the tool where a gauge reads its displacement, root axes
        [N, N·m]; zero where surfaces are cut.
    :param point: (n, 3) point of the surface, `$BASE` [m].
    """

    motion: Ints
    t: Array
    by_twist: Array
    is_wall: Bools
    weight_wrench: Array
    point: Array

    def deviation(self, twist: Array) -> tuple[Array, Array]:
        """Return the deviations (n,) [m] for twists of the tool (n, 6), and their derivatives by the twist (n, 6)."""
        deviations = np.einsum("nik,nk->ni", self.by_twist, twist)
        smaller_column = np.argmin(deviations, axis=1)  # what one side of the rim leaves, the other may still cut
        rows = np.arange(len(deviations))
        return deviations[rows, smaller_column], self.by_twist[rows, smaller_column]


def surfaces(program: Program, robot_in_cell: RobotInCell, probe_data: ProbedSurfaces, radius: float) -> Surfaces:
    """Return the places on the path of a program where its probed surfaces are made.

    :param probe_data: the points of these surfaces, and readings of a gauge while a weight hangs on the tool.
    :param radius: radius of the tool, a flat end mill [m].
    :raises MeasurementError: a row names no cutting move, or a point that the tool does not make on this move.
    """
    is_gauge = probe_data.is_gauge
    motion = _motions_of(program, probe_data, is_gauge)
    segments = toolpath.segments(program, robot_in_cell.start_flange)
    tip_place = toolpath.at(program, segments, motion, probe_data.t)
    travel = toolpath.tangent(program, segments, motion, probe_data.t)
    # the axis of the tool frame that points from the spindle to the tip: its column, and the sign from tip to spindle
    column, sign = {"+Z": (2, -1.0), "-Z": (2, 1.0), "+X": (0, -1.0), "-X": (0, 1.0)}[robot_in_cell.spindle]
    axis = sign * tip_place.pose[:, :3, column]
    lever = probe_data.point - tip_place.pose.position
    height = np.einsum("ni,ni->n", lever, axis)  # of the point above the tip, along the tool
    radial = lever - height[:, None] * axis
    cosine = np.einsum("ni,ni->n", probe_data.normal, axis)
    is_floor, is_wall = cosine > _FLOOR_COSINE, np.abs(cosine) < _WALL_COSINE
    # distance of the point from the end face, or from the line where the cylinder touches the wall
    offset = np.where(is_floor, np.abs(height), norm(radial + radius * probe_data.normal))
    is_possible = (
        (is_floor | is_wall)
        & (offset < _SURFACE_TOLERANCE)
        & (norm(radial) <= radius + _SURFACE_TOLERANCE)
        & (height >= -_SURFACE_TOLERANCE)
    )
    _check_points(probe_data, is_possible | is_gauge)  # a gauge may be anywhere on the tool
    by_twist = twist_derivatives(probe_data.normal, lever, axis, travel, radius)
    # a gauge reads n·(d + r × lever) = n·d + (lever × n)·r
    gauge_by_twist = np.concatenate([probe_data.normal, np.cross(lever, probe_data.normal)], axis=1)
    by_twist[is_gauge] = gauge_by_twist[is_gauge, None]
    weight_wrench = np.zeros((len(motion), 6))
    weight_wrench[:, 2] = -GRAVITY * probe_data.mass
    rotation = np.broadcast_to(toolpath.base_of(program, motion)[..., :3, :3], (len(motion), 3, 3))
    return Surfaces(
        motion=motion,
        t=probe_data.t,
        by_twist=rotated_derivatives(rotation, by_twist),
        is_wall=np.asarray(is_wall & ~is_gauge),
        weight_wrench=weight_wrench,
        point=probe_data.point,
    )


def _check_points(probe_data: ProbedSurfaces, is_possible: Bools) -> None:
    """Refuse points that the tool does not make.

    :param is_possible: (n,) True for points that the tool makes.
    :raises MeasurementError: the tool does not make one of the points; the error names the first of these.
    """
    if is_possible.all():
        return
    first = int(np.argmin(is_possible))
    raise MeasurementError(
        f"{probe_data.name[first]}: the tool makes no surface with this normal at this point",
        file=probe_data.file,
        line=int(probe_data.row[first]),
        advice="Points are on walls along the axis of a flat end mill, or on the floor below it.",
    )


def _motions_of(program: Program, probe_data: ProbedSurfaces, is_gauge: Bools) -> Ints:
    """Return the motions (n,) on the program lines that the probed points name.

    :param is_gauge: (n,) True for readings of a gauge under a weight: their lines are rapid moves; all other lines are
        cutting moves.
    :raises MeasurementError: a line has no such move, or several.
    """
    motions = program.motions
    motion = np.empty(len(probe_data), dtype=np.int64)
    for k, line in enumerate(probe_data.line.tolist()):
        moves = np.flatnonzero((motions.line == line) & (motions.rapid == is_gauge[k]))
        if len(moves) != 1:
            raise MeasurementError(
                f"line {line} of the program is not one {'rapid' if is_gauge[k] else 'cutting'} move",
                file=probe_data.file,
                line=int(probe_data.row[k]),
                advice="Give the program that the part was cut with, and its probing.csv.",
            )
        motion[k] = moves[0]
    return motion


def twist_derivatives(normal: Array, lever: Array, axis: Array, travel: Array, radius: float) -> Array:
    """Return two derivatives (n, 2, 6) of the deviation of each surface by the twist of the tool at its tip.

    Floor: the rim of a flat end mill passes over a point ahead of the axis and behind it, and the smaller of the two
    deviations remains. Wall: both derivatives are equal. With the normal n and the lever l from the tip, the deviation
    is n·d + (l × n)·r for a displacement d and a rotation r.

    :param normal: (n, 3) unit normals of the surfaces, and `lever` (n, 3) from the tip to the points [m].
    :param axis: (n, 3) unit directions from the tip to the spindle, and `travel` (n, 3) unit directions of travel.
    :param radius: radius of the tool [m].
    """
    is_floor = np.einsum("ni,ni->n", normal, axis) > _FLOOR_COSINE
    left = np.cross(axis, travel)
    lateral = np.einsum("ni,ni->n", lever, left)
    half_chord = np.sqrt(np.maximum(radius**2 - lateral**2, 0.0))
    levers = np.stack([lever, lever], axis=1)
    for k, sign in enumerate((1.0, -1.0)):
        rim = lateral[:, None] * left + sign * half_chord[:, None] * travel
        levers[is_floor, k] = rim[is_floor]
    normals = np.broadcast_to(normal[:, None], levers.shape)
    return np.concatenate([normals, np.cross(levers, normals)], axis=2)


def rotated_derivatives(rotation: Array, by_twist: Array) -> Array:
    """Return derivatives (n, 2, 6) by the twist of the tool (its translation, then its rotation) in other axes.

    :param rotation: (n, 3, 3) matrices that turn vectors in the present axes into those in the other axes.
    :param by_twist: (n, 2, 6) derivatives in the present axes.
    """
    return np.asarray(np.einsum("nij,nkhj->nkhi", rotation, by_twist.reshape(-1, 2, 2, 3))).reshape(-1, 2, 6)


class States(Columns, frozen=True, eq=False):
    """The robot at n places of a program.

    :param q: (n, 6) joint angles [rad].
    :param tool: (n, 4, 4) `$TOOL` in the flange frame [m].
    :param pose: (n, 4, 4) nominal tool frame in the root [m].
    :param wrench: (n, 6) cutting wrench on the tool at its tip, root axes [N, N·m].
    :param weight_wrench: (n, 6) wrench of a weight hung on the tool, known exactly; zero without a weight.
    :param lift: (n,) height of the program over the block above the written height, where the wrench acts [m].
    :param by_lift: (n, 6) derivative of the wrench by the lift.
    """

    q: Array
    tool: Array
    pose: Array
    wrench: Array
    weight_wrench: Array
    lift: Array
    by_lift: Array

    def twist(self, robot_in_cell: RobotInCell, robot: RobotModel, scale: float) -> Array:
        """Return the displacement (n, 6) of the tool from nominal under its forces, root axes [m, rad].

        :param scale: factor of the cutting forces; the weight is not scaled.
        :raises NotConvergedError: the springs have no equilibrium.
        """
        wrench = scale * self.wrench + self.weight_wrench
        displacement = twist_between(self.pose, elastostatics.loaded_pose(robot, self.q, self.tool, wrench))
        if (spring := robot_in_cell.tool_spring) is not None:
            displacement = displacement + spring.deflection(self.pose[:, :3, :3], wrench)
        return displacement

    def derivatives(
        self, robot_in_cell: RobotInCell, robot: RobotModel, parameters: tuple[Parameter, ...], scale: float
    ) -> TwistSlopes:
        """Return the twist and its derivatives by linear parameters [SI] and by the scale of the forces.

        They are differences of equilibria: exact derivatives need Pinocchio, which is not available on Windows.

        :param parameters: p parameters in whose SI values the deflection is linear.
        :param scale: factor of the cutting forces.
        :raises NotConvergedError: the springs have no equilibrium.
        """
        twist = self.twist(robot_in_cell, robot, scale)
        by_parameter = np.empty((*twist.shape, len(parameters)))
        for column, parameter in enumerate(parameters):
            value = robot.value(parameter)
            step = _PARAMETER_STEP * (abs(value) or parameter.usual)  # a usual value where the robot has zero
            changed_robot = robot.with_values({parameter: value + step})
            by_parameter[:, :, column] = (self.twist(robot_in_cell, changed_robot, scale) - twist) / step
        twist_at_step = self.twist(robot_in_cell, robot, scale + _SCALE_STEP)
        return TwistSlopes(twist, by_parameter, (twist_at_step - twist) / _SCALE_STEP)

    def twist_by_lift(self, robot_in_cell: RobotInCell, robot: RobotModel, scale: float, twist: Array) -> Array:
        """Return the derivative (n, 6) of the twist by the lift of the program over the block [1, rad/m].

        The lift is the height of the program above the one it is written for: the higher, the less deep the tool cuts.
        The derivative is a difference of equilibria.

        :param scale: factor of the cutting forces.
        :param twist: (n, 6) twist under these forces, from `twist`.
        :raises NotConvergedError: the springs have no equilibrium.
        """
        higher_states = replace(self, wrench=self.wrench + LIFT_STEP * self.by_lift)
        return np.asarray((higher_states.twist(robot_in_cell, robot, scale) - twist) / LIFT_STEP)


def states_at_nominal_height(
    q: Array, tool: Array, pose: Array, wrench: Array, weight_wrench: Array | None = None
) -> States:
    """Return states of a program at its written height over the block; their forces do not change with the height.

    :param q: (n, 6) joint angles [rad].
    :param tool: (n, 4, 4) `$TOOL` in the flange frame, and `pose` (n, 4, 4) nominal tool frame in the root [m].
    :param wrench: (n, 6) cutting wrench on the tool at its tip, root axes [N, N·m].
    :param weight_wrench: (n, 6) wrench of a weight, root axes [N, N·m]; None: no weight.
    """
    no_wrench = np.zeros((len(q), 6))
    return States(
        q=q,
        tool=tool,
        pose=pose,
        wrench=wrench,
        weight_wrench=no_wrench if weight_wrench is None else weight_wrench,
        lift=np.zeros(len(q)),
        by_lift=no_wrench,
    )


class Cut(Struct, frozen=True, eq=False):
    """A program under the forces of its process.

    :param surface_states: the states where probed surfaces are made.
    :param path_states: the states at N samples of the path.
    :param motion: (N,) row of `Motions` of each sample, and `t` (N,) its place on the motion, 0 … 1.
    :param tip: (N, 3) nominal tip at each sample, `$BASE` [m].
    :param program: the program.
    """

    surface_states: States
    path_states: States
    motion: Ints
    t: Array
    tip: Array
    program: Program

    def shift(self, robot_in_cell: RobotInCell, robot: RobotModel, scale: float, lift: Heights) -> Shift:
        """Return the displacement of the tip along the path, for the forces of the deflected tool.

        :param scale: factor of the cutting forces.
        :param lift: height of the program above the written one, at points.
        """
        displacement = self.path_states.twist(robot_in_cell, robot, scale)[:, :3]
        return self._shift(displacement + lift(self.tip)[:, None] * self.up_direction)

    def lift_displacement(self, height: float) -> Shift:
        """Return the displacement of the tip of a rigid robot whose program runs too high over the block.

        :param height: height above the written one [m].
        """
        return self._shift(height * self.up_direction)

    def _shift(self, displacement: Array) -> Shift:
        """Return displacements (N, 3) of the samples, root axes [m], as a shift of the tip along the path."""
        program = self.program
        return Shift(self.motion, self.t, displacement, program.bases[:, :3, :3], program.motions.base)

    @property
    def up_direction(self) -> Array:
        """(N, 3) Z of the `$BASE` of each sample, root axes."""
        return np.broadcast_to(toolpath.base_of(self.program, self.motion)[..., :3, 2], (len(self.motion), 3))


def cut(program: Program, robot_in_cell: RobotInCell, source: ProcessSource, probed_surfaces: Surfaces) -> Cut:
    """Return a program under the forces of a source.

    :param probed_surfaces: surfaces of the program that are probed; their places are samples of the path.
    :raises MeasurementError: the robot cannot follow the program.
    :raises ForceError: the process cannot be used for this program.
    """
    try:
        motions = MotionsUnderLoad.of(program, robot_in_cell, source)
        swing_motion, swing_t = motions.swing_places  # where FEED axes swing about the tool axis
        extra_samples = (
            np.concatenate([swing_motion, probed_surfaces.motion]),
            np.concatenate([swing_t, probed_surfaces.t]),
        )
        path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False), extra_samples)
    except ImpossiblePathError as cause:
        line = cause.issue.source_line
        raise MeasurementError(cause.issue.message, file=program.documents[0].name, line=line) from None
    rows = np.arange(len(path))
    path_states = states_at_nominal_height(
        path.joints.q[:],
        np.broadcast_to(path.tool(rows), (len(path), 4, 4)),
        path.pose_in_root(rows),
        path.wrench_in_root(rows),
    )
    motion, t = path.sample.motion, path.sample.t
    nearest_samples = []
    for surface_motion, surface_t in zip(probed_surfaces.motion.tolist(), probed_surfaces.t.tolist(), strict=True):
        samples = np.flatnonzero(motion == surface_motion)
        nearest_samples.append(int(samples[np.argmin(np.abs(t[samples] - surface_t))]))
    surface_states = replace(path_states.take(np.array(nearest_samples)), weight_wrench=probed_surfaces.weight_wrench)
    return Cut(surface_states, path_states, motion, t, path.sample.pose.position, program)


class ClampedProgram(Struct, frozen=True, eq=False):
    """A program that is cut with the block in one placement, and where its probed surfaces are made.

    :param robot_in_cell: the robot in a cell whose `[base]` is that of the block.
    :param source: the forces of the process.
    """

    program: Program
    robot_in_cell: RobotInCell
    source: ProcessSource
    surfaces: Surfaces


Heights = Callable[[Array], Array]
"""Heights (n,) [m] at points (n, 3) in `$BASE` [m]."""


def no_lift(points: Array) -> Array:
    """Return zero heights: the program runs over the block as it is written."""
    return np.zeros(len(points))


class CutForces:
    """Forces where the surfaces of programs are made, with the tool deflected by the forces of the last call.

    The first call cuts each program twice with a rigid robot, for the derivative of the forces by the lift. Each later
    call cuts each program once.

    :param parts: the programs.
    """

    def __init__(self, parts: Sequence[ClampedProgram]) -> None:
        self._parts = parts
        self._cuts: list[Cut] = []
        self._by_lift: list[Array] = []

    def __call__(self, robot: RobotModel, scale: float, lifts: Sequence[Heights] = ()) -> States:
        """Return the states where the surfaces are made, of one program after the other.

        :param robot: the robot that deflects the tool; not used by the first call, whose robot is rigid.
        :param scale: factor of the forces; not used by the first call.
        :param lifts: height of each program above the written one; empty: all run as written.
        """
        lifts = lifts or [no_lift] * len(self._parts)
        if not self._cuts:
            self._begin()
        else:
            self._cuts = [
                _recut(part, last_cut.shift(part.robot_in_cell, robot, scale, lift))
                for part, last_cut, lift in zip(self._parts, self._cuts, lifts, strict=True)
            ]
        return States.join(
            [
                replace(part_cut.surface_states, lift=lift(part.surfaces.point), by_lift=by_lift)
                for part, part_cut, lift, by_lift in zip(self._parts, self._cuts, lifts, self._by_lift, strict=True)
            ]
        )

    def _begin(self) -> None:
        """Cut with a rigid robot at the written height and above it; store the cuts and their derivatives by lift."""
        for part in self._parts:
            rigid_cut = cut(part.program, part.robot_in_cell, part.source, part.surfaces)
            upper_cut = _recut(part, rigid_cut.lift_displacement(LIFT_STEP))
            self._cuts.append(rigid_cut)
            self._by_lift.append((upper_cut.surface_states.wrench - rigid_cut.surface_states.wrench) / LIFT_STEP)


def _recut(part: ClampedProgram, shift: Shift) -> Cut:
    """Return a program under the forces of its tool with a displaced tip."""
    return cut(part.program, part.robot_in_cell, part.source.shift_tip(shift), part.surfaces)
