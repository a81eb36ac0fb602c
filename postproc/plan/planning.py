"""From test poses and a site to a plan: what is asked for, the steps, and the result."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.errors import PlanError
from postproc.frames import DEG_PER_RAD, RAD_PER_DEG, Array, norm
from postproc.identification.measurements import Measurements
from postproc.plan import accuracy, baselines, order
from postproc.plan.accuracy import Accuracy
from postproc.plan.candidate_poses import draw_candidates
from postproc.plan.criterion import Criterion, Joint2, Measured, measured
from postproc.plan.directions import Directions, directions, out_of_reach
from postproc.plan.milling import TestPoses, thinned
from postproc.plan.remarks import NO_TORQUES, NO_TRACKER, VERTICAL, hidden_by_rig, left_uncertain, second_load
from postproc.plan.search import Plan, Task, exchange, improved
from postproc.plan.sensitivity import Readings, direction
from postproc.plan.site import Site
from postproc.program import Ints
from postproc.robot import CompensatorStiffness


class Options(Struct, frozen=True):
    """How a plan is made.

    :param configurations: number of poses.
    :param levels: number of levels of q2.
    :param seed: the same seed gives the same plan.
    :param grouped: the criterion as printed instead of pooled.
    :param test_poses: how many poses stand for the programs.
    :param repeats: readings of each point in each state.
    :param starts: starts of the search.
    :param rounds: of refinement, at most.
    :param comparisons: compare with other plans and sizes.
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


class Size(Struct, frozen=True, eq=False):
    """What other numbers of poses would give: criterion of the best plan found, and median of random plans [m²]."""

    configurations: int
    value: float
    random: float


class PlanResult(Struct, frozen=True, eq=False):
    """A plan in the order of least travel, and what it is worth. Row i is the same pose in all arrays.

    :param options: what was asked for.
    :param robot: name of the model.
    :param site: where it is measured.
    :param tests: the test poses.
    :param represented: how far Σ w A₀ᵀA₀ of the test poses is from that of all cutting samples, relative.
    :param plan: the poses; angles and forces as written to the file.
    :param force: (n, 3) at the load point, root axes [N].
    :param second_load: over the first, in the same direction; what to expect counts the first alone.
    :param torque: (n, 6) of the load on the joints [N·m].
    :param directions: to which sides joints were to be loaded.
    :param accuracy: what to expect of the plan (with what was measured already).
    :param before: the same with what was measured already alone, or None.
    :param random: (R,) criterion of random plans [m²].
    :param serial: the semi-intuitive plan of the serial approach, or None.
    :param sizes: other numbers of poses.
    :param seconds: least travel time, the slowest joint at full speed.
    :param via: for each pose the configurations (k, 6) that the robot passes on its way there, none if straight.
    :param blocked: rows to which no free way was found.
    :param compensator_free: K_c and s₀ can be determined too; else they stay at the robot's values.
    :param warnings: what the user should know before measuring.
    :param interrupted: the search was stopped; the plan is the best found so far.
    """

    options: Options
    robot: str
    site: Site
    tests: TestPoses
    represented: float
    plan: Plan
    force: Array
    second_load: float
    torque: Array
    directions: Directions
    accuracy: Accuracy
    before: Accuracy | None
    random: Array
    serial: Plan | None
    sizes: tuple[Size, ...]
    seconds: float
    via: tuple[Array, ...]
    blocked: Ints
    compensator_free: bool
    warnings: tuple[str, ...]
    interrupted: bool


_KEPT = 3
_ANGLE_DECIMALS, _FORCE_DECIMALS = 3, 1

Progress = Callable[[str, float, float], None]
"""Called with what is done, how far it is (0…1), and the square root of the criterion of the best plan so far [m]."""


class _Problem(Struct, frozen=True, eq=False):
    """Task and what it was made of."""

    task: Task
    readings: Readings
    joint2: Joint2
    known: Measured | None
    warnings: tuple[str, ...]


def plan_measurements(
    site: Site,
    tests: TestPoses,
    options: Options,
    data: Measurements | None = None,
    progress: Progress | None = None,
) -> PlanResult:
    """Plan the measurements that make the error at the test poses smallest.

    Ctrl-C (`KeyboardInterrupt`) ends the search; the best plan so far is the result.

    :param tests: poses and forces at which the accuracy counts.
    :param data: what was measured so far; the plan says what to measure next.
    :param progress: told how far the work is.
    :raises PlanError: no pose can be measured, or more is asked for than can be determined.
    """
    if data is None and options.levels > options.configurations:
        raise PlanError(
            f"{options.levels} levels of q2 for {options.configurations} configurations",
            advice="Each level needs at least one: ask for fewer with --q2-levels.",
        )
    tell = progress or (lambda *_: None)
    scale = site.robot.compliance[list(site.robot.actuated)]
    few = thinned(tests, scale, options.test_poses, options.seed)
    tell("drawing poses that can be measured", 0.0, np.nan)
    problem = _problem(site, few, scale, options, data)
    plan, interrupted = _searched(problem.task, options, tell)
    plan, force, seconds, via, blocked = _ordered(problem, plan)
    information = problem.readings.information_of(plan.q, force)
    found = accuracy.expected(few, problem.readings, problem.joint2, plan.q, information, problem.known)
    before = None
    if problem.known is not None:
        none = np.zeros((0, *information.shape[1:]))
        before = accuracy.expected(few, problem.readings, problem.joint2, np.zeros((0, 6)), none, problem.known)
    random, serial, sizes = np.zeros(0), None, []
    if options.comparisons and not interrupted:
        try:
            tell("comparing with other plans", 0.7, np.sqrt(plan.value))
            random = baselines.random_values(problem.task, options.seed)
            serial = baselines.serial_plan(problem.task)
            for count, value, median in baselines.by_number(problem.task, options.seed, plan):
                sizes.append(Size(count, value, median))
                tell("comparing with other numbers of poses", 0.7 + 0.3 * len(sizes) / 6, np.sqrt(plan.value))
        except KeyboardInterrupt:
            interrupted = True
    warnings = (*problem.warnings, *left_uncertain(found, problem.joint2, blocked))
    wanted, got = (t.second_moment * np.outer(scale, scale) for t in (tests, few))
    return PlanResult(
        options=options,
        robot=site.robot.name,
        site=site,
        tests=few,
        represented=float(np.abs(wanted - got).max() / np.abs(wanted).max()),
        plan=plan,
        force=force,
        second_load=second_load(site, tests),
        torque=problem.readings.torque(plan.q, force),
        directions=problem.task.directions,
        accuracy=found,
        before=before,
        random=random,
        serial=serial,
        sizes=tuple(sizes),
        seconds=seconds,
        via=via,
        blocked=blocked,
        compensator_free=problem.joint2.free,
        warnings=warnings,
        interrupted=interrupted,
    )


def _problem(site: Site, tests: TestPoses, scale: Array, options: Options, data: Measurements | None) -> _Problem:
    # loaded minus unloaded, each the mean of the repeats
    noise = site.sigma * np.sqrt(2.0 / options.repeats)
    readings = Readings(site.arm, site.load_point, site.points, site.rig.force, noise, scale)
    known = None if data is None else measured(data, readings, site.sigma)
    fixed = 0 if known is None else len(known.q2)
    levels = min(max(options.levels, fixed), fixed + options.configurations)
    rng = np.random.default_rng([options.seed, 1 << 16])
    candidates = draw_candidates(site, readings, rng, None if known is None else known.q2)
    if levels > len(candidates):
        raise PlanError(
            f"poses can be measured at {len(candidates)} of the levels of q2 tried only, {levels} are asked for",
            advice="Ask for fewer with --q2-levels, or move what stands in the way.",
        )
    most = candidates.information.reshape(-1, 6, 6)
    if known is not None:
        most = np.concatenate([most, known.information])
    missing = accuracy.not_visible(readings, most, options.configurations + (0 if known is None else len(known.q)))
    warnings = hidden_by_rig(site, tests, scale, missing)
    if missing:
        keep = tuple(j for j in range(6) if j not in missing)
        readings, candidates = replace(readings, keep=keep), candidates.only(keep)
        known = None if data is None else measured(data, readings, site.sigma)
    _check_number(options, readings, len(site.points), levels, known)
    if site.torque_limit is None:
        warnings = (*warnings, NO_TORQUES)
    if site.tracker is None:
        warnings = (*warnings, NO_TRACKER)

    torque = candidates.torque.reshape(-1, 6)
    loaded = directions(
        torque[torque.any(axis=1)], tests, options.configurations, None if data is None else _largest(data, readings)
    )
    warnings = (*warnings, *out_of_reach(loaded, site.rig.largest_tilt < VERTICAL))

    def with_joint2(joint2: Joint2) -> Task:
        return Task(
            site,
            readings,
            lambda q2: Criterion.of(tests, readings, joint2, q2, options.grouped, known),
            candidates,
            options.configurations,
            levels,
            loaded,
            fixed,
        )

    joint2 = _joint2(site, tests, known, with_joint2, options.seed)
    return _Problem(with_joint2(joint2), readings, joint2, known, warnings)


def _largest(data: Measurements, readings: Readings) -> Array:
    """Return the torques (C, 6) of the largest load of each configuration that was loaded [N·m]."""
    config, load = data.state_config[data.loaded], data.wrench[data.loaded]
    order = np.argsort(norm(load))[::-1]
    first = order[np.unique(config[order], return_index=True)[1]]
    return readings.torque(data.q[config[first]], load[first, :3])


def _joint2(
    site: Site, tests: TestPoses, known: Measured | None, with_joint2: Callable[[Joint2], Task], seed: int
) -> Joint2:
    """Decide as the identification will: K_c is identified only if a plan made for it can determine it."""
    free = Joint2.of(site.robot, free=True)
    prior = Joint2.of(site.robot, free=False)
    task = with_joint2(free)
    if free.compensator is None or task.levels < 3:
        return prior
    trial = exchange(task, np.random.default_rng([seed, 1 << 17]), spread=True)
    readings = task.readings
    information = readings.information(trial.q, trial.tilt)
    found = accuracy.expected(tests, readings, free, trial.q, information, known)
    return prior if CompensatorStiffness() in found.uncertain else free


def _searched(task: Task, options: Options, tell: Progress) -> tuple[Plan, bool]:
    best: Plan | None = None
    steps = options.starts + _KEPT * options.rounds // 2
    try:
        for step, plan in enumerate(improved(task, options.seed, options.starts, _KEPT, options.rounds)):
            best = plan
            tell("searching", 0.65 * min(1.0, (step + 1) / steps), np.sqrt(plan.value))
    except KeyboardInterrupt:
        if best is None:
            raise
        return best, True
    assert best is not None
    return best, False


def _ordered(problem: _Problem, plan: Plan) -> tuple[Plan, Array, float, tuple[Array, ...], Ints]:
    """Round the plan as printed, order it by travel, and check the paths between its poses."""
    site = problem.task.site
    q2 = np.round(plan.q2 * DEG_PER_RAD, _ANGLE_DECIMALS) * RAD_PER_DEG
    q = np.round(plan.q * DEG_PER_RAD, _ANGLE_DECIMALS) * RAD_PER_DEG
    sequence, seconds, hit = order.shortest(site, q)
    q, tilt, level = q[sequence], plan.tilt[sequence], plan.level[sequence]
    force = np.round(site.rig.force * direction(tilt), _FORCE_DECIMALS) + 0.0
    value = problem.task.criterion_at(q2).value(problem.readings.information_of(q, force), level)
    via, blocked = order.ways(site, q, hit)
    return Plan(q, tilt, level, q2, value), force, seconds, via, blocked


def _check_number(options: Options, readings: Readings, points: int, levels: int, known: Measured | None) -> None:
    """Raise a `PlanError` if there are fewer readings than unknowns; with `grouped`, within each level of A2."""
    if known is not None:
        return
    unknowns = len(readings.keep) if options.grouped else len(readings.keep) - 1 + levels
    poses = options.configurations // levels if options.grouped else options.configurations
    if 3 * points * poses < unknowns:
        raise PlanError(
            f"{poses} poses of {points} points {'on a level ' if options.grouped else ''}are {3 * points * poses} "
            f"coordinates for {unknowns} compliances",
            advice="Plan more configurations, fewer levels of q2, or more points.",
        )
