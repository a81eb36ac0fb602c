"""From test poses and a site to a plan: options, order of travel, warnings, and the result.

The poses are visited in the order of least travel, without a straight joint motion into an obstacle. Warnings state
what the rig cannot excite, what stays uncertain, and what was not checked.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.decimals import without_negative_zero
from postproc.errors import PlanError
from postproc.frames import DEG_PER_RAD, MM_PER_M, RAD_PER_DEG, Array, norm
from postproc.identification.readings import Measurements
from postproc.identification.uncertainty import fewest_configurations, load_directions
from postproc.kinematics.forward import GRAVITY
from postproc.plan import constraints
from postproc.plan.criterion import (
    LEAST_LEVELS,
    Accuracy,
    Criterion,
    Directions,
    Joint2,
    MeasuredLoads,
    expected_accuracy,
    measured_information,
    required_directions,
    unidentifiable_joints,
    unreachable_direction_warnings,
)
from postproc.plan.milling import TestPoses, representatives
from postproc.plan.search import (
    SIZE_FACTORS,
    Candidates,
    Plan,
    SizeResult,
    Task,
    criterion_by_number,
    draw_candidates,
    exchange,
    improve,
    random_values,
    serial_plan,
)
from postproc.plan.sensitivity import Readings, direction
from postproc.plan.site import Site
from postproc.program import Bools, Ints
from postproc.robot import JOINT_COMPLIANCES, CompensatorStiffness, JointCompliance
from postproc.robot.rating import exceeded_rating

NO_TORQUES = (
    "static joint torques are not checked: robot.urdf states no limits (effort) and [rig] no max_torque_Nm; see that "
    "the robot may carry the load"
)
OVER_RATING = (
    "{subject} more than the {kg:g} kg ({rated:.0f} N) that the robot is rated for: take a lighter "
    "weight, or give [rig] max_torque_Nm as the manufacturer allows it"
)
NO_TRACKER = "line of sight is not checked: the experiment has no [tracker]"
VERTICAL_TILT = 0.02
"""Largest angle [rad] of a load that counts as vertical (assumed)."""
_SHARE_OF_SEARCH, _SHARE_OF_PLAN = 0.65, 0.7
"""Shares of the time, for the progress, that have passed after the search, and after order and accuracy (assumed)."""
_CANDIDATE_STREAM, _TRIAL_STREAM = 1 << 16, 1 << 17
"""Streams of random numbers of the candidates and of the trial plan: the search does not use them."""
_LEAST_SHARE, _LARGEST_SHARE = 0.1, 0.4
"""Limits of the second load over the first: a smaller load is lost in the noise, a larger one shows the same as the
first."""


def unchecked_warnings(site: Site) -> list[str]:
    """Return warnings on constraints that the plan cannot check: the experiment or the robot lacks the numbers."""
    warnings = []
    if site.torque_limit is None:
        warnings.append(NO_TORQUES)
        weight = site.rig.force + site.payload_mass * GRAVITY
        rating = exceeded_rating(weight / GRAVITY, site.robot.title, site.robot.name)
        if rating is not None:
            subject = f"load and [payload] of {weight:.0f} N together are"
            subject = subject if site.payload_mass else f"the load of {weight:.0f} N is"
            warnings.append(OVER_RATING.format(subject=subject, kg=rating, rated=rating * GRAVITY))
    if site.tracker is None:
        warnings.append(NO_TRACKER)
    return warnings


def hidden_compliance_warnings(
    site: Site, tests: TestPoses, robot_compliance: Array, hidden_joints: tuple[int, ...]
) -> tuple[str, ...]:
    """Return warnings on compliances that the rig does not excite, with reason, remedy and part of the deflection.

    :param robot_compliance: (6,) compliances of the robot [rad/(N·m)].
    :param hidden_joints: joints, from 0, whose compliance neither rig nor earlier readings show.
    :raises PlanError: A2 is among them: the load is too small for any plan.
    """
    if 1 in hidden_joints:
        raise PlanError(
            "the load is too small: not even the compliance of A2 can be seen in the readings",
            advice="Use a heavier weight ([rig] mass_kg) or a better measuring device (sigma_mm).",
        )
    warnings = []
    for joint in hidden_joints:
        square = np.sum(tests.regressor[:, :, joint] ** 2, axis=1)
        share = float(np.sqrt(tests.weight @ square)) * robot_compliance[joint] * MM_PER_M
        reason, advice = "the load puts too little torque on it", "Use a heavier weight."
        if joint == 0 and site.rig.largest_tilt < VERTICAL_TILT:
            reason = "every load it can apply hangs vertically, parallel to the axis of A1"
            advice = "Pull sideways too, by a cable over a pulley ([rig] max_angle_deg)."
        elif joint == 5:
            reason = "the load acts on the axis of A6"
            advice = "Hang the load at a distance from that axis, on a bracket ([load_point])."
        name = JOINT_COMPLIANCES[joint].name
        warnings.append(
            f"{name} is not observable with this rig: {reason}. {advice} As it is, the identification keeps the "
            f"robot's own value; {share:.3g} mm (RMS) of the deflection at the test poses rest on it, and the expected "
            "accuracy does not count how wrong it may be"
        )
    return tuple(warnings)


def second_load(site: Site, tests: TestPoses) -> float:
    """Return the ratio of the second load of each pose to the first load.

    Two loads show gears that stiffen, have breakpoints or backlash. The second load is near the RMS cutting force, so
    that gears are measured at the torques of milling; the ratio is limited.
    """
    rms_force = float(np.sqrt(tests.weight @ np.sum(tests.wrench[:, :3] ** 2, axis=1)))
    return float(np.clip(rms_force / site.rig.force, _LEAST_SHARE, _LARGEST_SHARE))


def uncertainty_warnings(accuracy: Accuracy, joint2: Joint2, blocked_rows: Ints) -> list[str]:
    """Return warnings on parameters that stay uncertain with the plan, and on blocked moves.

    :param blocked_rows: rows of poses, from 0, without a path that is clear of obstacles.
    """
    warnings = []
    uncertain_names = [parameter.name for parameter in accuracy.uncertain if isinstance(parameter, JointCompliance)]
    if uncertain_names:
        warnings.append(
            f"{', '.join(uncertain_names)}: the 95 % interval will be wider than half the value, so that the "
            "identification keeps the robot's own. If the programs need it, plan more poses, more weight or more "
            "repeats"
        )
    if joint2.compensator is not None and not joint2.has_free_compensator:
        warnings.append(
            "the spring of the gravity compensator (K_c, s_0) cannot be determined from such measurements: the "
            "identification keeps the robot's values"
        )
    if len(blocked_rows):
        rows = ", ".join(str(row + 1) for row in blocked_rows)
        warnings.append(f"the robot would hit something on its way to configuration {rows}: jog it there by hand")
    return warnings


_COMPENSATOR_PARAMETERS = 2
"""K_c and s₀."""
_CHECKED_STEP = 4.0 * RAD_PER_DEG
"""Largest turn of a joint between two checked poses of a move (assumed)."""
_FOLDED_TRIALS = 400
"""Random poses from which the folded arm is chosen (assumed)."""
_BLOCKED_COST = 1e3
"""Added seconds of a move that would hit something (assumed)."""


def travel_times(site: Site, q: Array) -> Array:
    """Return the durations (n, n) [s] of PTP motions between configurations (n, 6) [rad], by the slowest joint."""
    return np.asarray((np.abs(q[:, None] - q[None]) / site.robot.speed).max(axis=2))


def free_moves(site: Site, q: Array) -> Bools:
    """Return True for pairs (n, n) of configurations between which a joint interpolation is clear of everything.

    The configurations themselves are not checked.

    :param q: (n, 6) the configurations [rad].
    """
    count = len(q)
    first, last = np.triu_indices(count, 1)
    is_free = np.ones((count, count), dtype=bool)
    samples, pair_of_sample = [], []
    for pair, (begin, end) in enumerate(zip(q[first], q[last], strict=True)):
        steps = int(np.ceil(np.abs(end - begin).max() / _CHECKED_STEP))
        t = np.linspace(0.0, 1.0, steps + 1)[1:-1, None]  # without both ends
        samples.append(begin * (1.0 - t) + end * t)
        pair_of_sample.append(np.full(len(t), pair))
    if samples:
        is_passable = constraints.are_passable(site, np.concatenate(samples))
        is_blocked = np.zeros(len(first), dtype=bool)
        is_blocked[np.concatenate(pair_of_sample)[~is_passable]] = True
        is_free[first, last] = is_free[last, first] = ~is_blocked
    return is_free


class Travel(NamedTuple):
    """A path through n configurations from the start of the robot.

    :param order: (n,) rows of the configurations, in the order of the path.
    :param seconds: duration.
    :param blocked: indices k for which the direct move to configuration `order[k]` would hit something.
    """

    order: Ints
    seconds: float
    blocked: Ints


def least_travel(site: Site, q: Array) -> Travel:
    """Return the order of least travel time from the start of the robot through configurations (n, 6) [rad].

    Nearest neighbour, then 2-opt and or-opt until nothing improves (Croes 1958, Or 1976). Blocked moves are avoided as
    far as possible.
    """
    stops = np.vstack([site.start, q])
    seconds = travel_times(site, stops)
    is_blocked = ~free_moves(site, stops)
    cost = seconds + _BLOCKED_COST * is_blocked
    tour = [0]  # node 0 is the start, node k configuration k − 1
    while len(tour) < len(stops):
        unvisited = [node for node in range(len(stops)) if node not in tour]
        tour.append(min(unvisited, key=lambda node: (cost[tour[-1], node], node)))
    while (shorter_tour := _shorter_tour(tour, cost)) is not None:
        tour = shorter_tour
    order = np.array(tour[1:]) - 1
    moves = list(pairwise(tour))
    duration = float(sum(seconds[begin, end] for begin, end in moves))
    blocked_moves = [k for k, (begin, end) in enumerate(moves) if is_blocked[begin, end]]
    return Travel(order, duration, np.array(blocked_moves, dtype=np.int64))


def _tour_cost(tour: list[int], cost: Array) -> float:
    """Return the sum of the costs of the moves of a tour, a list of nodes; `cost` (n, n) between nodes."""
    return float(cost[tour[:-1], tour[1:]].sum())


def _shorter_tour(tour: list[int], cost: Array) -> list[int] | None:
    """Return a tour of less cost, by reversing a piece (2-opt) or moving up to three nodes (Or-opt).

    None if no such change gains anything.

    :param tour: nodes in order; the first node stays.
    :param cost: (n, n) of the moves between nodes.
    """
    limit = _tour_cost(tour, cost) - 1e-9  # a smaller gain is rounding
    for i in range(1, len(tour)):
        for j in range(i + 1, len(tour) + 1):
            reversed_tour = tour[:i] + tour[i:j][::-1] + tour[j:]
            if _tour_cost(reversed_tour, cost) < limit:
                return reversed_tour
    for i in range(1, len(tour)):
        for size in (1, 2, 3):
            piece, remaining_tour = tour[i : i + size], tour[:i] + tour[i + size :]
            for j in range(1, len(remaining_tour) + 1):
                new_tour = remaining_tour[:j] + piece + remaining_tour[j:]
                if _tour_cost(new_tour, cost) < limit:
                    return new_tour
    return None


def via_poses(site: Site, q: Array, hit_rows: Ints) -> tuple[tuple[Array, ...], Ints]:
    """Return via configurations (k, 6) [rad] before each pose of a sequence, and the rows of poses without a free path.

    A blocked move goes through the start position. If that is blocked too, the arm takes the shape of the start
    position, or the folded shape, with A1 of the second pose, of the first pose, or of the first and then the second.

    :param q: (n, 6) the poses in order [rad]; the robot begins at the start of the site.
    :param hit_rows: rows of poses whose direct move from the pose before would hit something.
    """
    start = site.start
    via_poses = [np.zeros((0, 6)) for _ in q]
    blocked_rows = []
    shapes = [start, folded_pose(site)] if len(hit_rows) else []  # joint angles (6,) of which A1 is replaced
    for row in hit_rows:
        origin, goal = start if row == 0 else q[row - 1], q[row]
        candidates = [start[None]]
        for shape in shapes:
            start_shape, end_shape = shape.copy(), shape.copy()
            start_shape[0], end_shape[0] = origin[0], goal[0]
            candidates += [end_shape[None], start_shape[None], np.array([start_shape, end_shape])]
        for via in candidates:
            stops = np.vstack([origin, via, goal])
            if constraints.are_passable(site, via).all() and np.diag(free_moves(site, stops), 1).all():
                via_poses[row] = via
                break
        else:
            blocked_rows.append(int(row))
    return tuple(via_poses), np.array(blocked_rows, dtype=np.int64)


def folded_pose(site: Site) -> Array:
    """Return joint angles (6,) [rad] with the smallest horizontal reach of arm and tool, of random poses with A1 = 0.

    A1 is its nearest limit if 0 is out of range. Obstacles do not count, as they depend on A1.
    """
    rng = np.random.default_rng(0)
    q = rng.uniform(np.maximum(site.lower, -np.pi), np.minimum(site.upper, np.pi), (_FOLDED_TRIALS, 6))
    q[:, 0] = np.clip(0.0, site.lower[0], site.upper[0])
    arm_pose = site.arm.pose(q)
    points = np.concatenate([arm_pose.origin, arm_pose.point(np.vstack([site.load_point, site.points]))], axis=1)
    reach = np.linalg.norm(points[..., :2], axis=2).max(axis=1)
    empty_site = replace(site, obstacles=())
    return np.asarray(q[np.argmin(np.where(constraints.are_passable(empty_site, q), reach, np.inf))])


class Options(Struct, frozen=True):
    """Options of a plan.

    :param configurations: number of poses.
    :param levels: number of levels of q2.
    :param seed: the same seed gives the same plan.
    :param grouped: whether each level of q2 is identified alone, see `criterion`; else the levels are pooled.
    :param test_poses: number of poses that represent the programs.
    :param repeats: readings of each point in each state.
    :param starts: number of starts of the search.
    :param rounds: largest number of rounds of refinement.
    :param comparisons: whether the plan is compared with other plans and sizes.
    """

    configurations: int = 15
    levels: int = 5
    seed: int = 0
    grouped: bool = False
    test_poses: int = 20
    repeats: int = 3
    starts: int = 8
    rounds: int = 40
    comparisons: bool = True


class PlanResult(Struct, frozen=True, eq=False):
    """A plan in the order of least travel, with its expected accuracy. Row i is the same pose in all arrays.

    :param options: of the plan.
    :param robot: name of the model.
    :param site: place of the measurement.
    :param tests: the test poses.
    :param moment_error: relative error of the matrix Σ w A₀ᵀA₀, by which poses count in the criterion: of the test
        poses, against all cutting samples.
    :param plan: the poses; angles and forces as written to the file.
    :param force: (n, 3) at the load point, root axes [N].
    :param second_load: ratio of the second load to the first, in the same direction; `accuracy` counts the first alone.
    :param torque: (n, 6) of the load on the joints [N·m].
    :param directions: demand on the directions of the joint torques.
    :param accuracy: expected with the plan, together with earlier readings.
    :param unobservable: names of the compliances that neither rig nor earlier readings show: `accuracy` does not count
        their errors.
    :param initial_accuracy: expected with the earlier readings alone; None: there are none.
    :param random: (R,) criterion of random plans [m²]; empty without comparisons.
    :param serial: the semi-intuitive plan of the serial approach; None without comparisons.
    :param sizes: results for other numbers of poses; empty without comparisons.
    :param seconds: least travel time, the slowest joint at full speed.
    :param via: via configurations (k, 6) before each pose; k is 0 if the move is direct.
    :param blocked: rows of poses without a free path.
    :param compensator_free: whether K_c and s₀ can be determined too; else they keep the robot's values.
    :param warnings: for the user, before measuring.
    :param interrupted: whether Ctrl-C stopped the search; the plan is the best so far then.
    """

    options: Options
    robot: str
    site: Site
    tests: TestPoses
    moment_error: float
    plan: Plan
    force: Array
    second_load: float
    torque: Array
    directions: Directions
    accuracy: Accuracy
    unobservable: tuple[str, ...]
    initial_accuracy: Accuracy | None
    random: Array
    serial: Plan | None
    sizes: tuple[SizeResult, ...]
    seconds: float
    via: tuple[Array, ...]
    blocked: Ints
    compensator_free: bool
    warnings: tuple[str, ...]
    interrupted: bool


_FINALISTS = 3
"""Best starts that are improved to the end (assumed)."""
_ANGLE_DECIMALS, _FORCE_DECIMALS = 3, 1
"""Decimals of a plan: 0.001° as controllers show it, 0.1 N of forces, as gauges show them."""

Progress = Callable[[str, float, float], None]
"""Called with the present step, the share done (0…1), and the root of the criterion of the best plan so far [m]."""


class _Problem(Struct, frozen=True, eq=False):
    """The search task and its inputs.

    :param task: choice of the poses.
    :param readings: geometry, load and noise of the measurement.
    :param joint2: model of joint 2, with a free compensator or not.
    :param earlier_data: readings that were already made; None: there are none.
    :param warnings: for the user.
    """

    task: Task
    readings: Readings
    joint2: Joint2
    earlier_data: MeasuredLoads | None
    warnings: tuple[str, ...]


def plan_measurements(
    site: Site,
    tests: TestPoses,
    options: Options,
    data: Measurements | None = None,
    progress: Progress | None = None,
) -> PlanResult:
    """Return the plan of measurements with the smallest expected error at the test poses.

    Ctrl-C (`KeyboardInterrupt`) ends the search; the best plan so far is the result.

    :param tests: poses and forces at which the accuracy counts.
    :param data: earlier readings; the plan adds to them.
    :param progress: called at each step.
    :raises PlanError: no pose can be measured, or the readings are fewer than the unknowns.
    """
    _check_identifiable(len(JOINT_COMPLIANCES), options, len(site.points), data)
    if data is None:
        _check_level_count(options)
    report = progress or (lambda *_: None)
    robot_compliance = site.robot.compliance[list(site.robot.actuated)]
    test_sample = representatives(tests, robot_compliance, options.test_poses, options.seed)
    report("drawing poses that can be measured", 0.0, np.nan)
    problem = _planning_problem(site, test_sample, robot_compliance, options, data)
    plan, is_interrupted = _search(problem.task, options, report)
    ordered_plan = _order_plan(problem, plan)
    comparison = _OtherPlans(np.zeros(0), None, (), is_interrupted)
    if options.comparisons and not is_interrupted:
        comparison = _comparison_plans(problem.task, options, ordered_plan.plan, report)
    accuracy = _accuracy(problem, test_sample, ordered_plan.plan.q, ordered_plan.force)
    initial_accuracy = None
    if problem.earlier_data is not None:  # of a plan without poses
        initial_accuracy = _accuracy(problem, test_sample, np.zeros((0, 6)), np.zeros((0, 3)))
    return PlanResult(
        options=options,
        robot=site.robot.name,
        site=site,
        tests=test_sample,
        moment_error=_moment_error(tests, test_sample, robot_compliance),
        plan=ordered_plan.plan,
        force=ordered_plan.force,
        second_load=second_load(site, tests),
        torque=problem.readings.torque(ordered_plan.plan.q, ordered_plan.force),
        directions=problem.task.directions,
        accuracy=accuracy,
        unobservable=tuple(
            c.name for k, c in enumerate(JOINT_COMPLIANCES) if k not in problem.readings.identified_joints
        ),
        initial_accuracy=initial_accuracy,
        random=comparison.random,
        serial=comparison.serial,
        sizes=comparison.sizes,
        seconds=ordered_plan.seconds,
        via=ordered_plan.via,
        blocked=ordered_plan.blocked,
        compensator_free=problem.joint2.has_free_compensator,
        warnings=(*problem.warnings, *uncertainty_warnings(accuracy, problem.joint2, ordered_plan.blocked)),
        interrupted=comparison.is_interrupted,
    )


def _check_level_count(options: Options) -> None:
    """Check that each level of q2 may have a configuration.

    :raises PlanError: there are more levels than configurations.
    """
    if options.levels > options.configurations:
        raise PlanError(
            f"{options.levels} levels of q2 for {options.configurations} configurations",
            advice="Each level needs at least one: ask for fewer with --q2-levels.",
        )


def _moment_error(tests: TestPoses, sample: TestPoses, robot_compliance: Array) -> float:
    """Return the largest difference of Σ w A₀ᵀA₀ between all test poses and a sample, relative to the largest entry.

    The criterion depends on the test poses by this matrix: weights w, regressor A₀ of the tool tip by the compliances.

    :param robot_compliance: (6,) compliances of the robot [rad/(N·m)].
    """
    full_moment, sample_moment = (
        poses.second_moment * np.outer(robot_compliance, robot_compliance) for poses in (tests, sample)
    )
    return float(np.abs(full_moment - sample_moment).max() / np.abs(full_moment).max())


def _accuracy(problem: _Problem, tests: TestPoses, q: Array, force: Array) -> Accuracy:
    """Return the expected accuracy at the test poses with the earlier readings and a plan.

    :param q: (n, 6) poses of the plan [rad], and `force` (n, 3) at the load point, root axes [N].
    """
    information = problem.readings.information_of(q, force)
    return expected_accuracy(tests, problem.readings, problem.joint2, q, information, problem.earlier_data)


class _OtherPlans(Struct, frozen=True, eq=False):
    """Plans for comparison.

    :param random: (R,) criterion of random plans [m²].
    :param serial: plan of the serial approach; None: not computed.
    :param sizes: other numbers of poses.
    :param is_interrupted: Ctrl-C ended the comparison.
    """

    random: Array
    serial: Plan | None
    sizes: tuple[SizeResult, ...]
    is_interrupted: bool


def _comparison_plans(task: Task, options: Options, plan: Plan, report: Progress) -> _OtherPlans:
    """Return other plans to compare `plan` with.

    Ctrl-C (`KeyboardInterrupt`) ends their computation; the plans that are ready are returned.
    """
    random, serial = np.zeros(0), None
    sizes: list[SizeResult] = []
    is_interrupted = False
    try:
        report("comparing with other plans", _SHARE_OF_PLAN, np.sqrt(plan.value))
        random = random_values(task, options.seed)
        serial = serial_plan(task)
        for size in criterion_by_number(task, options.seed, plan):
            sizes.append(size)
            share = _SHARE_OF_PLAN + (1.0 - _SHARE_OF_PLAN) * len(sizes) / len(SIZE_FACTORS)
            report("comparing with other numbers of poses", share, np.sqrt(plan.value))
    except KeyboardInterrupt:
        is_interrupted = True
    return _OtherPlans(random, serial, tuple(sizes), is_interrupted)


def _planning_problem(
    site: Site, tests: TestPoses, robot_compliance: Array, options: Options, data: Measurements | None
) -> _Problem:
    """Return the search task, with candidates, compliances that the load excites, and demanded directions of torques.

    :param robot_compliance: (6,) compliances of the robot [rad/(N·m)].
    :param data: earlier readings; None: there are none.
    :raises PlanError: too few levels of q2 can be measured, or too few readings are planned.
    """
    pool = _candidate_pool(site, robot_compliance, options, data)
    readings, earlier_data = pool.readings, pool.earlier_data
    hidden_joints = tuple(joint for joint in range(len(JOINT_COMPLIANCES)) if joint not in readings.identified_joints)
    hidden_warnings = hidden_compliance_warnings(site, tests, robot_compliance, hidden_joints)
    _check_reading_count(options, readings, len(site.points), pool.levels, earlier_data)
    torque = pool.candidates.torque.reshape(-1, 6)
    has_pose = torque.any(axis=1)
    data_torque = None if data is None else _largest_torques(data, readings)
    demand = required_directions(torque[has_pose], tests, options.configurations, data_torque)

    def with_joint2(joint2: Joint2) -> Task:
        """Return the task of choosing configurations for a model of joint 2."""
        return Task(
            site=site,
            readings=readings,
            criterion_at=lambda q2: Criterion.of(tests, readings, joint2, q2, options.grouped, earlier_data),
            candidates=pool.candidates,
            count=options.configurations,
            levels=pool.levels,
            directions=demand,
            fixed_count=pool.fixed_levels,
        )

    joint2 = _joint2_model(site, tests, earlier_data, with_joint2, options.seed)
    if joint2.has_free_compensator:  # two parameters more
        _check_identifiable(len(JOINT_COMPLIANCES) + _COMPENSATOR_PARAMETERS, options, len(site.points), data)
    direction_warnings = unreachable_direction_warnings(demand, site.rig.largest_tilt < VERTICAL_TILT)
    warnings = (*hidden_warnings, *unchecked_warnings(site), *direction_warnings)
    return _Problem(with_joint2(joint2), readings, joint2, earlier_data, warnings)


class _CandidatePool(NamedTuple):
    """Poses to choose from, and the compliances that they can show.

    :param candidates: with the information on these compliances; fixed levels come first.
    :param readings: sensitivity of measurements to these compliances.
    :param earlier_data: readings that were already made, on these compliances; None: there are none.
    :param levels: number of levels of q2 of the plan, fixed levels included.
    :param fixed_levels: number of levels at which readings were already made.
    """

    candidates: Candidates
    readings: Readings
    earlier_data: MeasuredLoads | None
    levels: int
    fixed_levels: int


def _candidate_pool(site: Site, robot_compliance: Array, options: Options, data: Measurements | None) -> _CandidatePool:
    """Return the poses to choose from, and the compliances that they show; parameters: see `_planning_problem`.

    :raises PlanError: too few levels of q2 can be measured.
    """
    # a displacement is a difference of two means of the repeats
    noise = site.sigma * np.sqrt(2.0 / options.repeats)
    readings = Readings(
        arm=site.arm,
        load_point=site.load_point,
        points=site.points,
        force=site.rig.force,
        noise=noise,
        unit_compliance=robot_compliance,
    )
    earlier_data = None if data is None else measured_information(data, readings, site.sigma)
    fixed_levels = 0 if earlier_data is None else len(earlier_data.q2)
    levels = min(max(options.levels, fixed_levels), fixed_levels + options.configurations)
    rng = np.random.default_rng([options.seed, _CANDIDATE_STREAM])
    candidates = draw_candidates(site, readings, rng, None if earlier_data is None else earlier_data.q2)
    if levels > len(candidates):
        raise PlanError(
            f"poses can be measured at {len(candidates)} of the levels of q2 tried only, {levels} are asked for",
            advice="Ask for fewer with --q2-levels, or move the obstacles.",
        )
    hidden_joints = _hidden_joints(candidates, options.configurations, earlier_data)
    if hidden_joints:
        joints = tuple(joint for joint in range(6) if joint not in hidden_joints)
        readings, candidates = replace(readings, identified_joints=joints), candidates.take_parameters(joints)
        earlier_data = None if data is None else measured_information(data, readings, site.sigma)
    return _CandidatePool(candidates, readings, earlier_data, levels, fixed_levels)


def _hidden_joints(candidates: Candidates, configurations: int, earlier_data: MeasuredLoads | None) -> tuple[int, ...]:
    """Return the joints, from 0, whose compliance neither candidates nor earlier readings can determine.

    :param configurations: number of configurations of the plan.
    """
    information = candidates.information.reshape(-1, 6, 6)
    if earlier_data is None:
        return unidentifiable_joints(information, configurations)
    information = np.concatenate([information, earlier_data.information])
    return unidentifiable_joints(information, configurations + len(earlier_data.q))


def _largest_torques(data: Measurements, readings: Readings) -> Array:
    """Return the torques (C, 6) [N·m] on the joints by the largest load of each configuration that was loaded."""
    config, load = data.state_config[data.loaded_states], data.wrench[data.loaded_states]
    descending_rows = np.argsort(norm(load))[::-1]
    # unique() returns first occurrences: with descending loads, the row of the largest load of each configuration
    _, first = np.unique(config[descending_rows], return_index=True)
    largest = descending_rows[first]
    return readings.torque(data.q[config[largest]], load[largest, :3])


def _joint2_model(
    site: Site, tests: TestPoses, earlier_data: MeasuredLoads | None, with_joint2: Callable[[Joint2], Task], seed: int
) -> Joint2:
    """Return joint 2 with a free compensator if a plan can determine its stiffness K_c, else with the robot's value.

    The identification decides by the same criterion. A trial plan by exchange shows the expected interval of K_c.

    :param with_joint2: returns the search task for a model of joint 2.
    """
    free = Joint2.of(site.robot, free=True)
    prior = Joint2.of(site.robot, free=False)
    task = with_joint2(free)
    if free.compensator is None or task.levels < LEAST_LEVELS:
        return prior
    trial = exchange(task, np.random.default_rng([seed, _TRIAL_STREAM]), spread=True)
    readings = task.readings
    information = readings.information(trial.q, trial.tilt)
    accuracy = expected_accuracy(tests, readings, free, trial.q, information, earlier_data)
    return prior if CompensatorStiffness() in accuracy.uncertain else free


def _search(task: Task, options: Options, report: Progress) -> tuple[Plan, bool]:
    """Return the best plan, and True if Ctrl-C ended the search, so that the plan is the best so far.

    :raises KeyboardInterrupt: Ctrl-C before there is a plan.
    """
    best: Plan | None = None
    steps = options.starts + _FINALISTS * options.rounds // 2
    try:
        for step, plan in enumerate(improve(task, options.seed, options.starts, _FINALISTS, options.rounds)):
            best = plan
            report("searching", _SHARE_OF_SEARCH * min(1.0, (step + 1) / steps), np.sqrt(plan.value))
    except KeyboardInterrupt:
        if best is None:
            raise
        return best, True
    assert best is not None
    return best, False


class _OrderedPlan(NamedTuple):
    """A plan in the order in which it is measured.

    :param plan: with angles rounded as printed.
    :param force: (n, 3) at the load point, root axes, rounded as printed [N].
    :param seconds: duration of the travel.
    :param via: via configurations (k, 6) before each pose [rad].
    :param blocked: rows of poses without a free path.
    """

    plan: Plan
    force: Array
    seconds: float
    via: tuple[Array, ...]
    blocked: Ints


def _order_plan(problem: _Problem, plan: Plan) -> _OrderedPlan:
    """Return the plan in the order of least travel, with angles and forces rounded as printed."""
    site = problem.task.site
    q2 = np.round(plan.q2 * DEG_PER_RAD, _ANGLE_DECIMALS) * RAD_PER_DEG
    q = np.round(plan.q * DEG_PER_RAD, _ANGLE_DECIMALS) * RAD_PER_DEG
    order, seconds, hit_rows = least_travel(site, q)
    q, tilt, level = q[order], plan.tilt[order], plan.level[order]
    force = without_negative_zero(np.round(site.rig.force * direction(tilt), _FORCE_DECIMALS))
    value = problem.task.criterion_at(q2).value(problem.readings.information_of(q, force), level)
    via, blocked_rows = via_poses(site, q, hit_rows)
    return _OrderedPlan(Plan(q, tilt, level, q2, value), force, seconds, via, blocked_rows)


def _check_identifiable(parameter_count: int, options: Options, point_count: int, data: Measurements | None) -> None:
    """Check that the identification would trust a model from the planned and measured configurations.

    :param parameter_count: number of parameters of least squares.
    :param point_count: number of reference points.
    :param data: earlier readings; None: there are none.
    :raises PlanError: there are too few configurations.
    """
    # number of load directions of each configuration; both loads of a planned one have the same direction
    measured_counts = [] if data is None else load_directions(data)
    direction_counts = [*measured_counts, *[1] * options.configurations]
    count = len(direction_counts)
    fewest = fewest_configurations(parameter_count, point_count, float(np.mean(direction_counts)))
    if count >= fewest:
        return
    note = "" if data is None else f" with the {len(data.q)} that were measured"
    raise PlanError(
        f"{count} configurations of {point_count} points{note} are too few: `identify` would not trust a model "
        f"from fewer than {fewest}",
        advice=f"Ask for {options.configurations + fewest - count} or more with --configurations"
        + (" (15 are usual), or give earlier readings with --measured." if data is None else "."),
    )


def _check_reading_count(
    options: Options, readings: Readings, points: int, levels: int, earlier_data: MeasuredLoads | None
) -> None:
    """Check that a plan without earlier readings has as many coordinates of readings as unknowns.

    With `options.grouped` each level of q2 must have as many.

    :param points: number of reference points.
    :param levels: number of levels of q2.
    :raises PlanError: there are fewer coordinates than unknowns.
    """
    if earlier_data is not None:
        return
    unknowns = len(readings.identified_joints) if options.grouped else len(readings.identified_joints) - 1 + levels
    poses = options.configurations // levels if options.grouped else options.configurations
    if 3 * points * poses < unknowns:
        raise PlanError(
            f"{poses} poses of {points} points {'on a level ' if options.grouped else ''}are {3 * points * poses} "
            f"coordinates for {unknowns} compliances",
            advice="Plan more configurations, fewer levels of q2, or more points.",
        )
