"""Choice of the features of a test part: those after which the least error is expected where the shop mills.

The criterion is that of `plan` (Klimchik et al., second Eq. (10)): the expected square of the deflection error at test
poses, here of the posterior covariance of model and force scale, with what a probe sees: deviations along normals.
Features are taken one by one, each the one that gains most for its time, and then exchanged while that helps (Fedorov,
"Theory of Optimal Experiments", 1972).
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import forces, toolpath
from postproc.cell import Box
from postproc.dialects import registry
from postproc.errors import MeasurementError, PlanError
from postproc.frames import MM_PER_M, Array
from postproc.kinematics import UnreachableError
from postproc.kinematics.forward import GRAVITY
from postproc.machining import Process, ProcessSource
from postproc.machining.process import StockTable
from postproc.poses import Poses
from postproc.program import Bools, Document, Ints, Program, read_only
from postproc.testpart import features
from postproc.testpart.cut import LIFT_STEP, States, Surfaces, rotated_derivatives, twist_derivatives
from postproc.testpart.features import Cutting, Feature, Kind, MiddleLine, Placement
from postproc.testpart.prior import Prior
from postproc.testpart.readings import PATH_ERROR, RADIUS_ERROR, UNEVENNESS
from postproc.under_load import RobotInCell

_DIRECTION_COUNT = 12
"""Number of directions of a feature that are tried: every 30°."""
_MOST_PLACES = 60
"""Number of places of features that are tried in the block, over all its placements (assumed)."""
_ROW_PITCH_DIAMETERS = 4.0
"""Distance of neighbours in the simulated row of features, in diameters of the tool (assumed): they do not touch."""
_DEPTH_SHARES = (1.0, 0.5)
"""Depths that are tried, as shares of the largest (assumed)."""
_LEAST_FLOOR_THICKNESS = 2e-3
"""Least thickness of the block below the features [m] (assumed)."""
_POSITION_SIGMAS = 1e-2, 1e-1
"""Standard deviations of the position of the part where it is probed [m, rad], so large that it is free."""
_UNKNOWNS_OF_PLACEMENT = 7
"""Number of unknowns of a placement: six of the position of the part, and the height of the uncut top."""
_MODEL_ERROR_SHARE = 0.005
"""Expected unmodelled error of the prediction, as a share of the deflection (assumed)."""
_TEST_POSES = 48
"""Number of test poses over the whole block (assumed)."""
_MOST_EXCHANGE_ROUNDS = 20
"""Largest number of rounds of exchanges (assumed)."""
_LEAST_GAIN = 1e-4
"""Share of the criterion by which an exchange must lower it; less is no gain on a part (assumed)."""
MOST_CHANGE = 1.0
"""Relative change of a parameter beyond which it counts as not shown."""
_DETECTION_SIGMAS = 5.1
"""Size of a change, in standard deviations of the readings, that `identify part --compare` sees in 95 of 100 cases:
3.4 raise its alarm."""
_TRIM_FACTOR = 1.3
"""First trimming passes take off this multiple of the largest deflection expected (assumed)."""


def read_text(text: str, robot_in_cell: RobotInCell) -> Program:
    """Return the program of the G-code of a test part.

    :raises ProgramError: the cell does not allow it.
    """
    document = Document(Placement().name, text)
    return read_only(
        registry.dialect_of_name("gcode").read([document], robot_in_cell.cell, robot_in_cell.forward, "testpart")
    )


class Candidates(Struct, frozen=True, eq=False):
    """Features that can be cut.

    :param feature: (c,) the features.
    :param placement: (c,) number of the placement in which each is cut, from 0.
    :param information: (c, m, m) information of each feature on the m unknowns: parameters and force scale in units of
        their prior standard deviations, radius of the tool, position of the cuts and height of the uncut top in each
        placement.
    :param seconds: (c,) cutting time of each feature [s].
    :param is_apart: (c, c) True for two features that do not touch.
    :param deflection: (c,) largest expected displacement of the tool in each feature [m].
    :param states: (c,) state of the robot with this displacement.
    """

    feature: tuple[Feature, ...]
    placement: Ints
    information: Array
    seconds: Array
    is_apart: Bools
    deflection: Array
    states: States


class Tests(Struct, frozen=True, eq=False):
    """Test poses: where the shop mills, and with which forces.

    :param states: (T,) poses and wrenches.
    :param weight: (T,) share of each pose in the work; their sum is 1.
    :param is_scaled: (T,) True if the process of the part computes the forces: then its force scale applies.
    :param source: origin of the poses, in words.
    """

    __test__ = False  # not a test of pytest

    states: States
    weight: Array
    is_scaled: Bools
    source: str


class Design(Struct, frozen=True, eq=False):
    """A chosen part.

    :param chosen: (k,) rows of the candidates, in the order of cutting: one placement after another.
    :param sigma: (p + 1,) standard deviations of parameters and force scale after the part, as shares of those before.
    :param sigma_without_weight: (p + 1,) these shares without the weight on the tool; None if no weight is hung on it.
    :param change: (p,) smallest relative change of each parameter that the same part shows later.
    :param before: RMS of the expected error at the test poses without the part [m], and `after` with the part.
    :param deflection: RMS deflection at the test poses [m].
    :param seconds: cutting time [s].
    :param tests: origin of the test poses, in words.
    """

    candidates: Candidates
    chosen: Ints
    sigma: Array
    sigma_without_weight: Array | None
    change: Array
    before: float
    after: float
    deflection: float
    seconds: float
    tests: str

    @property
    def features(self) -> tuple[Feature, ...]:
        """The chosen features, in the order of cutting."""
        return tuple(self.candidates.feature[k] for k in self.chosen)

    @property
    def placement(self) -> Ints:
        """(k,) number of the placement in which each feature is cut, from 0."""
        return self.candidates.placement[self.chosen]


class Loads(Struct, frozen=True, eq=False):
    """Loads of the tool where the s surfaces of one kind of feature are made, in the axes of the feature.

    :param tip: (s, 3) tip of the tool [m].
    :param wrench: (s, 6) on the tool at its tip [N, N·m].
    :param travel: (s, 3) direction of travel.
    :param by_lift: (s, 6) derivative of the wrench by the lift of the program over the block.
    """

    tip: Array
    wrench: Array
    travel: Array
    by_lift: Array


def loads(kinds: list[Kind], cutting: Cutting, process: Process, robot_in_cell: RobotInCell) -> list[Loads]:
    """Return the loads of the tool in each kind of feature, from a simulated cut of a row of them in another block.

    :raises ForceError: the process cannot be used.
    """
    pitch = _ROW_PITCH_DIAMETERS * cutting.diameter
    row = [Feature(kind, 0.0, k * pitch, 0.0) for k, kind in enumerate(kinds)]
    part = features.program(row, cutting)
    program = read_text(part.text, robot_in_cell)
    path = toolpath.segments(program, robot_in_cell.start_flange)
    motion = np.array([int(np.flatnonzero(program.motions.line == line)[0]) for line in part.line])
    places = toolpath.at(program, path, motion, part.t)
    travel = toolpath.tangent(program, path, motion, part.t)
    # a program that runs higher over the block is one in a lower block
    wrench, lifted_wrench = (
        forces.assign(program, path, source, robot_in_cell.spindle, robot_in_cell.ramp).at(places)
        for source in (
            _source(kinds, replace(cutting, top=cutting.top - lift), process, robot_in_cell)
            for lift in (0.0, LIFT_STEP)
        )
    )
    by_lift = (lifted_wrench - wrench) / LIFT_STEP
    loads_by_kind, first = [], 0  # row of the first point of a feature
    for feature in row:
        rows = slice(first, first + len(features.probes(feature.kind, cutting)))
        # features of the row are not turned: their axes are those of `$BASE`, displaced
        tip = places.pose.position[rows] - np.array([feature.x, feature.y, cutting.top])
        loads_by_kind.append(Loads(tip, wrench[rows], travel[rows], by_lift[rows]))
        first = rows.stop
    return loads_by_kind


def _source(kinds: list[Kind], cutting: Cutting, process: Process, robot_in_cell: RobotInCell) -> ProcessSource:
    """Return the process as a source of forces in a block around a row of features, one of each kind."""
    half_length, pitch = features.half_length(cutting.diameter), _ROW_PITCH_DIAMETERS * cutting.diameter
    thickness = max(kind.depth for kind in kinds) + 5e-3  # 5 mm of material below the deepest feature
    x_span = -2.0 * half_length, 2.0 * half_length
    spans = x_span, (-pitch, len(kinds) * pitch), (cutting.top - thickness, cutting.top)
    box = Box(*((low * MM_PER_M, high * MM_PER_M) for low, high in spans))
    stock = StockTable(box=box, resolution_mm=process.stock.resolution_mm)
    return ProcessSource(replace(process, stock=stock, operations={}), robot_in_cell.spindle)


def candidates(
    prior: Prior,
    placements: tuple[RobotInCell, ...],
    process: Process,
    cutting: Cutting,
    *,
    depth: float,
    box: Box,
    sigma: float,
) -> tuple[Candidates, Cutting]:
    """Return the features that fit into a block, and how they are cut: trimmed by more than the tool deflects.

    :param placements: for each placement of the block, the robot in a cell whose `[base]` is that of the block.
    :param cutting: how features are cut, with the least trimming.
    :param depth: largest depth of cut [m].
    :param box: the block, `$BASE` [mm].
    :param sigma: noise of the probe [m].
    :raises PlanError: the block is too thin, no feature fits, or the robot reaches none in a placement.
    :raises ForceError: the process cannot be used.
    """
    sides = 0, 1, -1  # a groove, and steps that are cut down- and up-milling
    kinds = [Kind(round(share * depth, 6), side) for share in _DEPTH_SHARES for side in sides]
    low, high = (np.array([span[k] for span in (box.X, box.Y, box.Z)]) / MM_PER_M for k in (0, 1))
    for _ in range(2):  # a second time with deeper trimming, if the tool deflects further than was assumed
        if depth + cutting.trims[-1].floor + _LEAST_FLOOR_THICKNESS > high[2] - low[2]:
            raise PlanError(f"the block is too thin for grooves of {depth * MM_PER_M:g} mm", file=process.path)
        loads_by_kind = loads(kinds, cutting, process, placements[0])
        all_features = _inside_block(kinds, cutting, (low, high), max(1, _MOST_PLACES // len(placements)))
        survey = _Survey(prior, cutting, sigma)
        by_placement = [
            _reachable_features(survey, robot_in_cell, all_features, dict(zip(kinds, loads_by_kind, strict=True)))
            for robot_in_cell in placements
        ]
        largest_deflection = max(entry.deflection for reachable in by_placement for entry in reachable)
        trim = float(np.round(_TRIM_FACTOR * largest_deflection, 4))
        if trim <= cutting.trim:
            break
        cutting = replace(cutting, trim=trim)
    return _join_candidates(by_placement, cutting), cutting


def _inside_block(kinds: list[Kind], cutting: Cutting, box: tuple[Array, Array], max_places: int) -> list[Feature]:
    """Return the features that fit into a block: each kind at places of a grid, in several directions.

    :param box: lower (3,) and upper (3,) corner of the block, `$BASE` [m].
    :param max_places: approximate largest number of places of the grid.
    :raises PlanError: no feature fits.
    """
    half_length = features.half_length(cutting.diameter)
    low, high = box
    size = high[:2] - low[:2]
    # places closer than a quarter of a feature show the same (assumed)
    pitch = max(0.5 * half_length, float(np.sqrt(size[0] * size[1] / max_places)))
    counts = [max(1, int(size[k] / pitch)) for k in (0, 1)]
    x_positions, y_positions = (low[k] + size[k] * (np.arange(counts[k]) + 0.5) / counts[k] for k in (0, 1))
    angles = 2.0 * np.pi * np.arange(_DIRECTION_COUNT) / _DIRECTION_COUNT
    all_features = [
        Feature(kind, float(x), float(y), float(angle))
        for kind, x, y, angle in product(kinds, x_positions, y_positions, angles)
    ]
    fitting = [feature for feature in all_features if _is_in_box(feature, cutting, box)]
    if not fitting:
        raise PlanError(
            f"no feature fits into the block: each takes {2 * half_length * MM_PER_M:.0f} mm and the tool's diameter",
            file="--block",
            advice="Give a larger block, or a smaller tool.",
        )
    return fitting


class _Survey(NamedTuple):
    """Knowledge and method on which the information of all features depends.

    :param prior: knowledge of robot and forces before the part.
    :param cutting: how features are cut.
    :param sigma: noise of the probe [m].
    """

    prior: Prior
    cutting: Cutting
    sigma: float


class _ReachableFeature(NamedTuple):
    """A feature that the robot reaches in a placement.

    :param feature: kind and place.
    :param information: (m, m) information of its probed points on the unknowns, with one position of the part.
    :param deflection: largest displacement of the tool at these points [m].
    :param state: state of the robot with this displacement.
    """

    feature: Feature
    information: Array
    deflection: float
    state: States


def _join_candidates(by_placement: list[list[_ReachableFeature]], cutting: Cutting) -> Candidates:
    """Return the candidates of all placements.

    The unknowns that all placements have in common come first, then the position of the part in each placement.
    """
    entries = [entry for placement in by_placement for entry in placement]
    number = np.repeat(np.arange(len(by_placement)), [len(placement) for placement in by_placement])
    features_in_order = tuple(entry.feature for entry in entries)
    seconds = {kind: features.seconds(kind, cutting) for kind in {feature.kind for feature in features_in_order}}
    information_in_placement = np.array([entry.information for entry in entries])
    common_count = information_in_placement.shape[1] - _UNKNOWNS_OF_PLACEMENT
    size = common_count + _UNKNOWNS_OF_PLACEMENT * len(by_placement)
    information = np.zeros((len(entries), size, size))
    for k in range(len(by_placement)):
        rows = np.flatnonzero(number == k)
        placement_unknowns = common_count + _UNKNOWNS_OF_PLACEMENT * k + np.arange(_UNKNOWNS_OF_PLACEMENT)
        unknowns = np.append(np.arange(common_count), placement_unknowns)
        information[np.ix_(rows, unknowns, unknowns)] = information_in_placement[rows]
    return Candidates(
        feature=features_in_order,
        placement=number,
        information=information,
        seconds=np.array([seconds[feature.kind] for feature in features_in_order]),
        is_apart=_apart_features(features_in_order, cutting),
        deflection=np.array([entry.deflection for entry in entries]),
        states=States.join([entry.state for entry in entries]),
    )


def _reachable_features(
    survey: _Survey, robot_in_cell: RobotInCell, all_features: list[Feature], load_of_kind: dict[Kind, Loads]
) -> list[_ReachableFeature]:
    """Return the features that the robot reaches in a placement, kind by kind.

    :param load_of_kind: kind of feature → loads of the tool in it, in its axes.
    :raises PlanError: the robot reaches no feature.
    """
    reachable: list[_ReachableFeature] = []
    for kind, load in load_of_kind.items():
        features_of_kind = [feature for feature in all_features if feature.kind == kind]
        if features_of_kind:
            reachable += _features_of_kind(survey, robot_in_cell, features_of_kind, load)
    if not reachable:
        base = robot_in_cell.cell.base
        raise PlanError(
            f"the robot reaches no place of the block at X {base.X:g}, Y {base.Y:g}, Z {base.Z:g}",
            file="--block",
            advice="Check [base] and [base_data] of the cell.",
        )
    return reachable


def _features_of_kind(
    survey: _Survey, robot_in_cell: RobotInCell, features_of_kind: list[Feature], load: Loads
) -> list[_ReachableFeature]:
    """Return the features of one kind that the robot reaches, with information, displacement and most displaced state.

    :param load: loads of the tool in a feature of this kind, in its axes.
    """
    cutting, count = survey.cutting, len(load.tip)
    tip = _in_base(features_of_kind, cutting, load.tip)
    wrench, by_lift = (_wrenches_in_base(features_of_kind, cutting, column) for column in (load.wrench, load.by_lift))
    states, is_reached, rotation = _states(robot_in_cell, tip, wrench, by_lift, cutting=cutting, count=count)
    if not is_reached.any():
        return []
    points = _probed_points(features_of_kind, load, cutting, tip, rotation, np.repeat(is_reached, count))
    information, deflection = _information(survey, robot_in_cell, states, points)
    worst_probe = np.argmax(deflection, axis=1)  # states are by feature, `count` of each
    reached_features = [
        feature for feature, reached in zip(features_of_kind, is_reached.tolist(), strict=True) if reached
    ]
    return [
        _ReachableFeature(
            feature, information[k], float(deflection[k].max()), states.take(np.array([k * count + worst_probe[k]]))
        )
        for k, feature in enumerate(reached_features)
    ]


def _in_base(features_of_kind: list[Feature], cutting: Cutting, vectors: Array, *, is_direction: bool = False) -> Array:
    """Return vectors in `$BASE` (k·s, 3), feature after feature, that are given in the frame of each of k features.

    :param vectors: (s, 3) points [m] in the frame of a feature, or directions if `is_direction`.
    """
    return np.concatenate(
        [features.to_base(feature, cutting.top, vectors, is_direction=is_direction) for feature in features_of_kind]
    )


def _wrenches_in_base(features_of_kind: list[Feature], cutting: Cutting, wrench: Array) -> Array:
    """Return wrenches in `$BASE` axes (k·s, 6), feature after feature, that are given in the axes of k features.

    :param wrench: (s, 6) in the axes of a feature.
    """
    halves = [_in_base(features_of_kind, cutting, half, is_direction=True) for half in (wrench[:, :3], wrench[:, 3:])]
    return np.concatenate(halves, axis=1)


class _ProbedPoints(NamedTuple):
    """The n probed points of features of one kind, feature after feature, `$BASE`.

    :param surfaces: the surfaces at these points.
    :param arm: (n, 3) from a fixed point of the block to the points [m].
    :param normal: (n, 3) unit normals of the surfaces.
    :param point_count: number of points of one feature.
    """

    surfaces: Surfaces
    arm: Array
    normal: Array
    point_count: int


def _probed_points(
    features_of_kind: list[Feature], load: Loads, cutting: Cutting, tip: Array, rotation: Array, is_reached: Bools
) -> _ProbedPoints:
    """Return the probed points of the features of one kind that the robot reaches.

    :param load: loads of the tool in a feature of this kind, in its axes.
    :param tip: (n, 3) tip of the tool at the points of all features, `$BASE` [m].
    :param rotation: (n, 3, 3) axes of `$BASE` as columns in the root.
    :param is_reached: (n,) True for points of features that the robot reaches.
    """
    probes = features.probes(features_of_kind[0].kind, cutting)
    local_points = np.array([probe.point for probe in probes])
    point = _in_base(features_of_kind, cutting, local_points)
    normals = np.array([probe.normal for probe in probes])
    normal = _in_base(features_of_kind, cutting, normals, is_direction=True)
    travel = _in_base(features_of_kind, cutting, load.travel, is_direction=True)
    axis = np.broadcast_to([0.0, 0.0, 1.0], normal.shape)  # from the tip to the spindle
    by_twist = twist_derivatives(normal, point - tip, axis, travel, 0.5 * cutting.diameter)
    no_wrench = np.zeros((int(is_reached.sum()), 6))
    surfaces = Surfaces(
        motion=no_wrench[:, 0].astype(np.int64),  # motions and their places count for the program of a part only
        t=no_wrench[:, 0],
        by_twist=rotated_derivatives(rotation, by_twist)[is_reached],
        is_wall=np.asarray(np.abs(normal[:, 2]) < 0.5)[is_reached],  # normals are along Z or across it
        weight_wrench=no_wrench,
        point=point[is_reached],
    )
    arm = point - local_points.mean(axis=0)
    return _ProbedPoints(surfaces, arm[is_reached], normal[is_reached], len(probes))


def _information(
    survey: _Survey, robot_in_cell: RobotInCell, states: States, points: _ProbedPoints
) -> tuple[Array, Array]:
    """Return the information (k, m, m) of k features, and the displacements (k, s) [m] at the s points of each.

    :param states: states at the k·s points, feature after feature.
    :param points: these points.
    """
    prior, count = survey.prior, points.point_count
    twist, by_parameter, by_scale = states.derivatives(robot_in_cell, prior.robot, prior.order, 1.0)
    _, by_twist = points.surfaces.deviation(twist)
    # derivatives by unknowns in units of their prior standard deviations; the last one is the scale of the forces
    slopes = np.einsum("nk,nkp->np", by_twist, by_parameter) @ prior.by_file * prior.sigma[:-1]
    deflection = np.linalg.norm(by_scale[:, :3], axis=1).reshape(-1, count)
    by_force = prior.sigma[-1] * np.einsum("nk,nk->n", by_twist, by_scale)
    by_lift = np.einsum("nk,nk->n", by_twist, states.twist_by_lift(robot_in_cell, prior.robot, 1.0, twist))
    # direction in which a displacement of the cuts is seen, see `readings`
    direction = points.normal + by_lift[:, None] * np.array([0.0, 0.0, 1.0])
    shift_sigma, turn_sigma = _POSITION_SIGMAS
    position = np.concatenate([shift_sigma * direction, turn_sigma * np.cross(points.arm, direction)], axis=1)
    # unknowns scaled to unit standard deviation: parameters, force, cutter radius, position of the part, lift
    columns = np.column_stack(
        [slopes, by_force, RADIUS_ERROR * points.surfaces.is_wall, position, UNEVENNESS * by_lift]
    )
    # from here on by feature: errors of its points have causes in common
    columns = columns.reshape(-1, count, columns.shape[1])
    direction, by_lift = direction.reshape(-1, count, 3), by_lift.reshape(-1, count, 1)
    noise = PATH_ERROR**2 * direction @ np.swapaxes(direction, 1, 2) + survey.sigma**2 * np.eye(count)
    noise += UNEVENNESS**2 * by_lift @ np.swapaxes(by_lift, 1, 2)
    noise += (_MODEL_ERROR_SHARE * deflection)[:, :, None] ** 2 * np.eye(count)
    return np.swapaxes(columns, 1, 2) @ np.linalg.solve(noise, columns), deflection


class _ReachedStates(NamedTuple):
    """States at the points of features that the robot reaches; features have `count` points each, n in all.

    :param states: states at the points of the reached features.
    :param is_reached: (n / count,) True for features that are reached.
    :param rotation: (n, 3, 3) axes of `$BASE` as columns in the root.
    """

    states: States
    is_reached: Bools
    rotation: Array


def _states(
    robot_in_cell: RobotInCell, tip: Array, wrench: Array, by_lift: Array, *, cutting: Cutting, count: int
) -> _ReachedStates:
    """Return the states at points of features that the robot reaches within its joint limits.

    :param tip: (n, 3) positions of the tip in `$BASE` [m], `count` for each feature.
    :param wrench: (n, 6) on the tool at its tip, and `by_lift` (n, 6) its derivative by the lift, `$BASE` axes.
    """
    # a program whose last move is with this tool at feed: it has the frames and the orientation of the tool
    text = f"G21 G90 G17 G94\nT{cutting.tool} M6\nG0 X0 Y0 Z0\nG1 X0 Y0 Z1 F100\n"
    program = read_text(text, robot_in_cell)
    last = len(program.motions) - 1
    motion = np.full(len(tip), last)
    pose = Poses.fixed(tip, program.motions.target.rotation[last])
    t = np.full(len(tip), 0.5)  # any place: frames are the same along the move
    q, is_reached = _reached_angles(robot_in_cell, program, motion, t, pose, count=count)
    rows = np.flatnonzero(np.repeat(is_reached, count))
    rotation = np.broadcast_to(toolpath.base_of(program, motion)[..., :3, :3], (len(tip), 3, 3))
    wrench_in_root, by_lift_in_root = (
        toolpath.wrench_in_root(program, motion[rows], vectors[rows]) for vectors in (wrench, by_lift)
    )
    states = States(
        q=q,
        tool=np.broadcast_to(toolpath.tool_of(program, motion[rows]), (len(rows), 4, 4)),
        pose=toolpath.pose_in_root(program, motion[rows], pose[rows], t[rows]),
        wrench=wrench_in_root,
        weight_wrench=np.zeros((len(rows), 6)),
        lift=np.zeros(len(rows)),
        by_lift=by_lift_in_root,
    )
    return _ReachedStates(states, is_reached, rotation)


def _reached_angles(
    robot_in_cell: RobotInCell, program: Program, motion: Ints, t: Array, pose: Poses, *, count: int
) -> tuple[Array, Bools]:
    """Return the joint angles (k, 6) [rad] at points of reached features, and True (n / count,) for these features.

    A feature with a point that is out of reach or beyond a joint limit is left out, and the others are followed again.
    Without a reached feature, there are no joint angles (0, 6).

    :param motion: (n,) motion of each point, and `t` (n,) its place on the motion.
    :param pose: (n,) poses of the tool at the points.
    :param count: number of points of a feature.
    """
    robot = robot_in_cell.robot
    is_reached = np.ones(len(motion) // count, dtype=bool)
    while is_reached.any():
        rows = np.flatnonzero(np.repeat(is_reached, count))
        try:
            q = robot_in_cell.follow(program, motion[rows], t[rows], pose.take(rows)).q[:]
        except UnreachableError as cause:
            is_reached[rows[list(cause.rows)] // count] = False
            continue
        within_limits = ((q >= robot.lower) & (q <= robot.upper)).all(axis=1)
        if within_limits.all():
            return q, is_reached
        is_reached[rows[~within_limits] // count] = False
    return np.zeros((0, 6)), is_reached


def _is_in_box(feature: Feature, cutting: Cutting, box: tuple[Array, Array]) -> bool:
    """Return whether a feature with half a wall around it is between two corners (3,) of a box [m], seen along Z."""
    begin, end, half_width = features.middle_line(feature, cutting)
    low, high = (corner[:2] for corner in box)
    return all(bool(((point - half_width >= low) & (point + half_width <= high)).all()) for point in (begin, end))


def _apart_features(all_features: tuple[Feature, ...], cutting: Cutting) -> Bools:
    """Return True (c, c) for pairs of features that do not touch, whatever their placements.

    Features that differ by depth or placement only have the same outline: each outline is compared once.
    """
    outlines = [(feature.kind.side, feature.x, feature.y, feature.angle) for feature in all_features]
    feature_of_outline = dict(zip(outlines, all_features, strict=True))
    is_apart = _apart_lines([features.middle_line(feature, cutting) for feature in feature_of_outline.values()])
    number_of_outline = {outline: k for k, outline in enumerate(feature_of_outline)}
    row = np.array([number_of_outline[outline] for outline in outlines])
    return np.asarray(is_apart[np.ix_(row, row)])


def _apart_lines(lines: list[MiddleLine]) -> Bools:
    """Return True (l, l) for pairs of middle lines that are further apart than the sum of their half widths.

    Nine points of each line are compared with all of every other line, both ways. Between these points a line may be
    nearer: three tenths of half their spacing are added to the half widths (assumed).
    """
    begin, end = np.array([line.begin for line in lines]), np.array([line.end for line in lines])
    half_width = np.array([line.half_width for line in lines])
    is_apart = np.empty((len(lines), len(lines)), dtype=bool)
    share = np.linspace(0.0, 1.0, 9)
    chord = end - begin
    points = begin[:, None] + share[:, None] * chord[:, None]
    for k in range(len(lines)):
        offset = points[k][None] - begin[:, None]
        share_on_chord = np.clip(
            np.einsum("csi,ci->cs", offset, chord) / np.einsum("ci,ci->c", chord, chord)[:, None], 0.0, 1.0
        )
        distance = np.linalg.norm(offset - share_on_chord[..., None] * chord[:, None], axis=2).min(axis=1)
        half_spacing = 0.5 * float(np.linalg.norm(chord[k])) / (len(share) - 1)
        is_apart[k] = distance > half_width + half_width[k] + 0.3 * half_spacing
    return np.asarray(is_apart & is_apart.T)


def tests_in_block(candidates_in_block: Candidates) -> Tests:
    """Return test poses all over the block: the most displaced states of candidates, taken evenly from their list."""
    rows = np.unique(np.linspace(0, len(candidates_in_block.feature) - 1, _TEST_POSES).astype(np.int64))
    suffix = " in all its placements" if candidates_in_block.placement.any() else ""
    return Tests(
        states=candidates_in_block.states.take(rows),
        weight=np.full(len(rows), 1.0 / len(rows)),
        is_scaled=np.ones(len(rows), dtype=np.bool_),
        source=f"this process all over the block{suffix}",
    )


class Criterion(Struct, frozen=True, eq=False):
    """Expected square error [m²] at test poses, for the information of a part.

    :param weight: (m, m) Σ w DᵀD over the test poses, with their shares w and the derivatives D (3, m) of the
        displacement by the unknowns.
    """

    weight: Array

    @classmethod
    def of(cls, prior: Prior, robot_in_cell: RobotInCell, tests: Tests, unknown_count: int) -> Criterion:
        """Return the criterion for test poses.

        At poses whose forces another source states, only the parameters count: the force scale is that of the process.

        :param unknown_count: number m of unknowns of the information; parameters and force scale are the first of them.
        """
        _, by_parameter, by_scale = tests.states.derivatives(robot_in_cell, prior.robot, prior.order, 1.0)
        slopes = by_parameter[:, :3] @ prior.by_file * prior.sigma[:-1]
        by_force = prior.sigma[-1] * tests.is_scaled[:, None] * by_scale[:, :3]
        slopes = np.concatenate([slopes, by_force[:, :, None]], axis=2)
        size = slopes.shape[2]
        weight = np.zeros((unknown_count, unknown_count))
        weight[:size, :size] = np.einsum("t,tip,tiq->pq", tests.weight, slopes, slopes)
        return cls(weight)

    def __call__(self, information: Array) -> Array:
        """Return the expected square error (...) after information (..., m, m)."""
        covariance = np.linalg.inv(information)
        return np.asarray(np.einsum("...ij,ji->...", covariance, self.weight))


def _prior_information(prior: Prior, size: int) -> Array:
    """Return the information (m, m) before the part, for unknowns in units of their prior standard deviations.

    It is the inverse correlation of parameters and force scale, and the unit matrix for all other unknowns. A parameter
    with a prior standard deviation of 0 has the information 1.

    :param size: number m of unknowns.
    """
    sigma = prior.sigma
    products = np.outer(sigma, sigma)
    correlation = np.divide(prior.covariance, products, out=np.eye(len(sigma)), where=products > 0.0)
    information = np.eye(size)
    information[: len(sigma), : len(sigma)] = np.linalg.pinv(correlation, hermitian=True)
    return information


def gauge_information(
    prior: Prior, placements: tuple[RobotInCell, ...], cutting: Cutting, mass: float, places: Array, sigma: float
) -> Array:
    """Return the information (m, m) of a gauge that reads how far a weight moves the tool down in each placement.

    It is in the units of `Candidates.information`. The force is known: only parameters of the robot are determined.

    :param mass: mass of the weight [kg].
    :param places: (n, 3) positions of the tip in `$BASE` [m]; without any, the information is zero.
    :param sigma: noise of the gauge [m].
    :raises PlanError: the robot does not reach a place.
    """
    # parameters and force scale, radius of the tool, then position and height of the top in each placement
    size = len(prior.sigma) + 1 + _UNKNOWNS_OF_PLACEMENT * len(placements)
    information = np.zeros((size, size))
    if not len(places):
        return information
    weight_wrench = np.zeros((len(places), 6))
    weight_wrench[:, 2] = -GRAVITY * mass
    for robot_in_cell in placements:
        no_wrench = np.zeros((len(places), 6))
        states, reachable, rotation = _states(robot_in_cell, places, no_wrench, no_wrench, cutting=cutting, count=1)
        if not reachable.all():
            raise PlanError("the robot does not reach the places of the weight above the block", file="--weight")
        twist, by_parameter, _ = replace(states, weight_wrench=weight_wrench).derivatives(
            robot_in_cell, prior.robot, prior.order, 1.0
        )
        gravity_direction = -rotation[:, :, 2]
        columns = np.zeros((len(places), size))
        slopes = np.einsum("nk,nkp->np", gravity_direction, by_parameter[:, :3])
        columns[:, : len(prior.parameters)] = slopes @ prior.by_file * prior.sigma[:-1]
        sag = np.einsum("nk,nk->n", gravity_direction, twist[:, :3])
        information += (columns / (sigma**2 + (_MODEL_ERROR_SHARE * sag) ** 2)[:, None]).T @ columns
    return information


def choose(
    candidates_in_block: Candidates,
    prior: Prior,
    robot_in_cell: RobotInCell,
    tests: Tests,
    count: int,
    weight_information: Array | float = 0.0,
) -> Design:
    """Return the design of a part, whose features make the expected error at test poses small.

    They are chosen one by one by the gain per second, then exchanged until no exchange makes the error smaller,
    or for `_MOST_EXCHANGE_ROUNDS` rounds.

    :param candidates_in_block: features to choose from, with their information on m unknowns.
    :param prior: model and forces before the part is probed, with their covariance.
    :param robot_in_cell: the robot at the test poses.
    :param tests: poses at which the expected error counts.
    :param count: number of features at most.
    :param weight_information: (m, m) information of a gauge that reads the displacement by a weight; 0: no weight.
    :raises MeasurementError: no feature can be chosen.
    """
    unknown_count = candidates_in_block.information.shape[1]
    criterion = Criterion.of(prior, robot_in_cell, tests, unknown_count)
    start = _prior_information(prior, unknown_count) + weight_information
    rows = _best_one_by_one(candidates_in_block, criterion, start, count)
    for _ in range(_MOST_EXCHANGE_ROUNDS):
        if not _exchange(candidates_in_block, criterion, start, rows):  # changes `rows`
            break
    return evaluate(
        candidates_in_block, prior, robot_in_cell, tests, np.array(rows, dtype=np.int64), weight_information
    )


def _best_one_by_one(candidates_in_block: Candidates, criterion: Criterion, start: Array, count: int) -> list[int]:
    """Return the rows of at most `count` features that do not touch: in each step the one with most gain per second.

    :param start: (m, m) information without features.
    """
    rows: list[int] = []
    information = start
    for _ in range(count):
        # features that touch none of the chosen ones
        fitting_rows = np.flatnonzero(candidates_in_block.is_apart[:, rows].all(axis=1))
        if not len(fitting_rows):
            break
        gain = criterion(information) - criterion(information + candidates_in_block.information[fitting_rows])
        best = int(fitting_rows[np.argmax(gain / candidates_in_block.seconds[fitting_rows])])
        rows.append(best)
        information = information + candidates_in_block.information[best]
    return rows


def _exchange(candidates_in_block: Candidates, criterion: Criterion, start: Array, rows: list[int]) -> bool:
    """Replace each feature by the best one that takes no longer, if it is better; return whether any was replaced.

    :param start: (m, m) information without features.
    :param rows: rows of the features; changed in place.
    """
    is_changed = False
    for index in range(len(rows)):
        other_rows = rows[:index] + rows[index + 1 :]
        other_information = start + candidates_in_block.information[other_rows].sum(axis=0)
        time_left = candidates_in_block.seconds[rows].sum() - candidates_in_block.seconds[other_rows].sum()
        # 1e-9: rounding; the present feature is always among them
        is_short = candidates_in_block.seconds <= time_left + 1e-9
        fitting_rows = np.flatnonzero(candidates_in_block.is_apart[:, other_rows].all(axis=1) & is_short)
        best = int(
            fitting_rows[np.argmin(criterion(other_information + candidates_in_block.information[fitting_rows]))]
        )
        new_value, old_value = (
            float(criterion(other_information + candidates_in_block.information[row])) for row in (best, rows[index])
        )
        if new_value < (1.0 - _LEAST_GAIN) * old_value:
            rows[index], is_changed = best, True
    return is_changed


def evaluate(
    candidates_in_block: Candidates,
    prior: Prior,
    robot_in_cell: RobotInCell,
    tests: Tests,
    rows: Ints,
    weight_information: Array | float = 0.0,
) -> Design:
    """Return the design with the features in `rows` of the candidates, and its expected standard deviations and errors.

    :param tests: poses at which the expected error counts.
    :param weight_information: (m, m) information of a gauge that reads the displacement by a weight; 0: no weight.
    :raises MeasurementError: `rows` is empty.
    """
    if not len(rows):
        raise MeasurementError("no feature was chosen", file="--block", advice="Give a larger block.")
    unknown_count = candidates_in_block.information.shape[1]
    criterion = Criterion.of(prior, robot_in_cell, tests, unknown_count)
    start = _prior_information(prior, unknown_count)
    information = start + candidates_in_block.information[rows].sum(axis=0)
    covariance_without_weight, covariance = np.linalg.inv(information), np.linalg.inv(information + weight_information)
    size = len(prior.parameters) + 1  # parameters and force scale
    # of the cutting forces alone: without forces the robot still deflects under its own weight
    deflection = (
        tests.states.twist(robot_in_cell, prior.robot, 1.0)[:, :3]
        - tests.states.twist(robot_in_cell, prior.robot, 0.0)[:, :3]
    )

    # features are cut by placement, along Y, then along X
    x, y = (np.array([getattr(candidates_in_block.feature[row], axis) for row in rows]) for axis in "xy")
    order = np.lexsort((x, y, candidates_in_block.placement[rows]))
    return Design(
        candidates=candidates_in_block,
        chosen=rows[order],
        sigma=np.sqrt(np.diag(covariance)[:size]),
        sigma_without_weight=np.sqrt(np.diag(covariance_without_weight)[:size]) if np.any(weight_information) else None,
        change=_visible_changes(prior, information + weight_information - start),
        before=float(np.sqrt(criterion(start))),
        after=float(np.sqrt(np.sum(covariance * criterion.weight))),
        deflection=float(np.sqrt(np.sum(tests.weight * np.sum(deflection**2, axis=1)))),
        seconds=float(candidates_in_block.seconds[rows].sum()),
        tests=tests.source,
    )


def _visible_changes(prior: Prior, information: Array) -> Array:
    """Return the smallest relative change (p,) of each parameter that is seen (95 %) when the part is cut again.

    The second part is compared with the model from the first one, under the same forces. With J the information
    of a part on parameters and scale, its position and radius eliminated, and P the covariance before it, the
    deviations of the second part have the information (J⁻¹ + (P⁻¹ + J)⁻¹)⁻¹ = J − J (P⁻¹ + 2 J)⁻¹ J (Woodbury).

    :param information: (m, m) information of the part, in the units of `Candidates.information`.
    :returns: the changes; infinite for parameters that the part does not determine.
    """
    size = len(prior.parameters) + 1  # parameters and force scale; the nuisance unknowns follow
    nuisance = information[size:, size:].copy()
    # prior information of radius, position and height of the top: in their units, the position is as good as free
    nuisance += np.eye(len(nuisance))
    coupling = information[:size, size:]
    part_information = information[:size, :size] - coupling @ np.linalg.pinv(nuisance, hermitian=True) @ coupling.T
    information_of_two = (
        part_information
        - part_information @ np.linalg.inv(_prior_information(prior, size) + 2.0 * part_information) @ part_information
    )
    visibility = np.sqrt(np.maximum(np.diag(information_of_two)[:-1], 0.0)) * prior.values
    return np.asarray(
        np.divide(
            _DETECTION_SIGMAS * prior.sigma[:-1], visibility, out=np.full(size - 1, np.inf), where=visibility > 0.0
        )
    )
