"""The search for the best plan: candidate poses, exchange, steps along the gradient; and plans to compare with.

Candidates: poses that can be measured, level by level of q2, drawn at random. Joints are uniform within their limits,
loads uniform over the directions that the rig allows; every candidate satisfies all constraints.

Exchange (Fedorov 1972; Mitchell 1974): each pose in turn is replaced by the candidate that lowers the criterion most,
each level of q2 with its whole group by another one. From the best few, poses move freely: of steps along the gradient
and at random the best that can be measured is taken. Nothing depends on time: the same seed gives the same plan.

A plan is compared with random plans, with the semi-intuitive plan of the serial approach, and with other sizes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.errors import PlanError
from postproc.frames import RAD_PER_DEG, Array
from postproc.plan import constraints
from postproc.plan.criterion import Criterion, Directions
from postproc.plan.sensitivity import Readings, direction
from postproc.plan.site import Site
from postproc.program import Bools, Ints

_GRID = 24
"""Levels of q2 at which poses are drawn, besides fixed ones (assumed)."""
_PER_LEVEL = 100
"""Poses that are drawn for each level (assumed); the search then moves them."""
_ROUND = 400
"""Poses that are drawn at once."""
_ROUNDS = 40
"""After as many draws a level is left with the poses that it has; after a quarter of them, if it has none (assumed)."""
_LOOK = 4000
"""Poses at random by which constraints are judged when there is no candidate."""


class Candidates(Struct, frozen=True, eq=False):
    """Feasible poses at L levels of q2, C each; levels with none are left out.

    :param q2: (L,) [rad].
    :param q: (L, C, 6) [rad].
    :param tilt: (L, C, 2) of the load [rad].
    :param information: (L, C, p, p).
    :param torque: (L, C, 6) of the load on the joints; 0 where there is no pose [N·m].
    """

    q2: Array
    q: Array
    tilt: Array
    information: Array
    torque: Array

    def take_parameters(self, keep: tuple[int, ...]) -> Candidates:
        """Return the candidates with the information on some compliances only."""
        return replace(self, information=self.information[:, :, keep][:, :, :, keep])

    def __len__(self) -> int:
        return len(self.q2)


def draw(site: Site, count: int, rng: np.random.Generator, q2: float | None = None) -> tuple[Array, Array]:
    """Return random joint angles (count, 6) [rad] within ±180° and tilts of the load (count, 2), feasible or not."""
    lower, upper = np.maximum(site.lower, -np.pi), np.minimum(site.upper, np.pi)
    q = rng.uniform(lower, upper, (count, 6))
    if q2 is not None:
        q[:, 1] = q2
    # uniform over the cap of the sphere: cos(angle) is uniform
    angle = np.arccos(rng.uniform(np.cos(site.rig.largest_tilt), 1.0, count))
    heading = rng.uniform(-np.pi, np.pi, count)
    return q, angle[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)


def feasible_at(site: Site, q2: float, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return up to `count` feasible configurations and tilts at one level of q2."""
    found_q, found_tilt, have = [], [], 0
    for _ in range(_ROUNDS):
        q, tilt = draw(site, _ROUND, rng, q2)
        is_feasible = constraints.feasible(site, q, tilt)
        found_q.append(q[is_feasible])
        found_tilt.append(tilt[is_feasible])
        have += int(is_feasible.sum())
        if have >= count or (have == 0 and len(found_q) >= _ROUNDS // 4):
            break
    return np.concatenate(found_q)[:count], np.concatenate(found_tilt)[:count]


def draw_candidates(
    site: Site, readings: Readings, rng: np.random.Generator, fixed_levels: Array | None = None
) -> Candidates:
    """Draw candidates on a grid of levels over the range of q2, and at `fixed_levels` levels (first among them).

    :param readings: with all six compliances.
    :raises PlanError: no pose can be measured; the message names the constraints that block.
    """
    lower, upper = site.lower[1], site.upper[1]
    levels = np.concatenate([np.zeros(0) if fixed_levels is None else fixed_levels, np.linspace(lower, upper, _GRID)])
    draws = [feasible_at(site, float(level), _PER_LEVEL, rng) for level in levels]
    is_sufficient = np.array([len(q) >= _PER_LEVEL // 10 for q, _ in draws])
    if not is_sufficient.any():
        raise PlanError(*blocking(site, rng))
    fixed_count = 0 if fixed_levels is None else len(fixed_levels)
    rows = [index for index in range(len(levels)) if is_sufficient[index] or index < fixed_count]
    q, tilt = np.zeros((len(rows), _PER_LEVEL, 6)), np.zeros((len(rows), _PER_LEVEL, 2))
    real = np.zeros((len(rows), _PER_LEVEL), dtype=bool)
    for place, index in enumerate(rows):
        found_q, found_tilt = draws[index]
        if len(found_q):
            row = np.arange(_PER_LEVEL) % len(found_q)  # repeated where there are fewer
            q[place], tilt[place], real[place] = found_q[row], found_tilt[row], True
    information = readings.information(q.reshape(-1, 6), tilt.reshape(-1, 2)).reshape(*q.shape[:2], 6, 6)
    information *= real[:, :, None, None]  # no information from a level at which nothing can be measured any more
    load = readings.force * direction(tilt.reshape(-1, 2))
    torque = readings.torque(q.reshape(-1, 6), load).reshape(*q.shape[:2], 6) * real[:, :, None]
    return Candidates(levels[rows], q, tilt, information, torque)


def blocking(site: Site, rng: np.random.Generator) -> tuple[str]:
    """Return the error text if no pose is feasible: share that each constraint forbids, and poses possible without
    it.
    """
    q, tilt = draw(site, _LOOK, rng)
    failures = constraints.failures(site, q, tilt)
    count = sum(failures.values(), np.zeros(_LOOK, dtype=int))
    lines = []
    for name, is_forbidden in sorted(failures.items(), key=lambda entry: -entry[1].mean()):
        freed_poses = int(np.count_nonzero((count == 1) & is_forbidden))
        if is_forbidden.any():
            note = f", without it {freed_poses} poses were possible" if freed_poses else ""
            lines.append((freed_poses, is_forbidden.mean(), f"{name} forbids {100 * is_forbidden.mean():.1f} %{note}"))
    sole_causes = [line for line in lines if line[1] > 0.999]
    freeing = sorted((line for line in lines if line[0]), reverse=True)
    culprit = (freeing or sole_causes or lines)[0][2].split(" forbids")[0]
    summary = "; ".join(text for _, _, text in lines[:6])
    return (f"no pose can be measured: what blocks is: {culprit}. Of {_LOOK} poses at random: {summary}",)


_LEAST_DISTANCE = 8.0 * RAD_PER_DEG
"""Least distance of two levels of q2: the identification takes angles within 2° for one level."""
_EXCHANGE_ROUNDS = 12
"""Limit of the rounds of exchanges (assumed)."""
_MIN_GAIN = 1e-3
"""A change of the criterion below a thousandth is not worth a further round (assumed)."""
_STEPS = (0.5, 0.25, 0.12, 0.06, 0.03, 0.012, 0.004)
"""Lengths down the gradient that are tried [rad]: by factors of two to three, down to a quarter of a degree."""
_RANDOM = 24
"""Random places around a pose that are tried, half of them with some joints changed only (assumed)."""
_SHIFTS = np.array([12.0, 6.0, 3.0, 1.5, 0.5]) * RAD_PER_DEG
"""Changes of the levels of q2 that are tried, both ways (assumed)."""

CriterionAt = Callable[[Array], Criterion]
"""Levels q2 (m,) [rad] → the criterion there."""


class Plan(Struct, frozen=True, eq=False):
    """n poses with their loads.

    :param q: (n, 6) [rad]; q[:, 1] is that of the level.
    :param tilt: (n, 2) of the load [rad].
    :param level: (n,) row of `q2`.
    :param q2: (m,) levels [rad].
    :param value: criterion [m²].
    """

    q: Array
    tilt: Array
    level: Ints
    q2: Array
    value: float

    def __len__(self) -> int:
        return len(self.q)


class Task(Struct, frozen=True, eq=False):
    """Task of the search.

    :param site: constraints.
    :param readings: information of the measurements.
    :param criterion_at: criterion of plans with given levels.
    :param candidates: to choose from; their first `fixed` levels are kept (they were measured).
    :param count: number of poses.
    :param levels: number of levels of q2, the fixed ones included.
    :param directions: to which sides joints are to be loaded.
    :param fixed: number of fixed levels.
    """

    site: Site
    readings: Readings
    criterion_at: CriterionAt
    candidates: Candidates
    count: int
    levels: int
    directions: Directions
    fixed: int = 0

    def sides(self, q: Array, tilt: Array) -> Bools:
        """Return which sides (N, 6, 2) poses with loads count for."""
        return self.directions.loaded_sides(self.readings.torque(q, self.readings.force * direction(tilt)))

    def pose_levels(self, rng: np.random.Generator) -> Ints:
        """Return the level (n,) of each pose: groups as equal as can be; at random where levels were measured."""
        if self.fixed:
            return rng.integers(0, self.levels, self.count)
        return np.sort(np.arange(self.count) % self.levels)


def improve(task: Task, seed: int, starts: int, finalists: int, rounds: int) -> Iterator[Plan]:
    """Yield better and better plans; the last one is the result.

    :param starts: number of starts from other levels and poses.
    :param finalists: how many of them are refined.
    :param rounds: of refinement.
    """
    rough: list[Plan] = []
    best: Plan | None = None
    for start in range(starts):
        rough.append(exchange(task, np.random.default_rng([seed, start]), spread=start == 0))
        best = rough[-1] if best is None or rough[-1].value < best.value else best
        yield best
    assert best is not None
    for rank, plan in enumerate(sorted(rough, key=lambda entry: entry.value)[:finalists]):
        rng = np.random.default_rng([seed, starts + rank])
        for refined_plan in refine(task, plan, rng, rounds):
            best = refined_plan if refined_plan.value < best.value else best
            yield best


class _Choice(Struct, frozen=True, eq=False):
    """Candidates chosen, and the criterion of their plan.

    :param row: (m,) levels of q2, rows of the candidates.
    :param level: (n,) level of each pose, a place in `row`.
    :param pick: (n,) which candidate of its level each pose is.
    :param criterion: for these levels.
    :param value: of the criterion.
    """

    row: Ints
    level: Ints
    pick: Ints
    criterion: Criterion
    value: float


def exchange(task: Task, rng: np.random.Generator, spread: bool = False) -> Plan:
    """Return a plan of candidates that no exchange of one pose or one level improves."""
    candidates = task.candidates
    row = first_levels(task, rng, spread)
    level = task.pose_levels(rng)
    pick = rng.integers(0, candidates.q.shape[1], task.count)
    criterion = task.criterion_at(candidates.q2[row])
    value = criterion.value(candidates.information[row[level], pick], level)
    best = _Choice(row, level, pick, criterion, value)
    for _ in range(_EXCHANGE_ROUNDS):
        old_value = best.value
        best = _exchange_poses(task, best)
        for group in range(task.fixed, task.levels):
            best = _exchange_level(task, best, group)
        if best.value > old_value * (1.0 - _MIN_GAIN):
            break
    best = _exchange_poses(task, _load_both_signs(task, best))
    at = best.row[best.level], best.pick
    return Plan(candidates.q[at], candidates.tilt[at], best.level, candidates.q2[best.row], best.value)


def first_levels(task: Task, rng: np.random.Generator, spread: bool) -> Ints:
    """Return levels (m,) of A2 as rows of the candidates: the fixed ones, then evenly spread or random ones."""
    free = np.arange(task.fixed, len(task.candidates))
    free_levels = task.levels - task.fixed
    row = list(range(task.fixed))
    if spread and task.fixed == 0:
        return free[np.round(np.linspace(0, len(free) - 1, free_levels)).astype(np.int64)]
    for candidate in rng.permutation(free):
        if len(row) < task.levels and _is_distant(task.candidates.q2[row], task.candidates.q2[candidate]):
            row.append(int(candidate))
    for candidate in rng.permutation(free):  # too many levels for the distance: nearer ones, but different
        if len(row) < task.levels and int(candidate) not in row:
            row.append(int(candidate))
    return np.array(row)


def _is_distant(levels: Array, q2: float) -> bool:
    return bool((np.abs(levels - q2) >= _LEAST_DISTANCE - 1e-9).all())


def _load_both_signs(task: Task, choice: _Choice) -> _Choice:
    """Replace poses within their levels until each joint is loaded with both signs; the smallest criterion wins."""
    information, row, criterion, level = task.candidates.information, choice.row, choice.criterion, choice.level
    pick, demand = choice.pick.copy(), task.directions
    sides = demand.loaded_sides(task.candidates.torque[row]).astype(np.int64)
    while True:
        pose_sides = sides[level, pick]
        shortfall = demand.missing_count(pose_sides.sum(axis=0))
        total = criterion.total(information[row[level], pick], level)
        best = (np.inf, 0, 0)
        for place in range(task.count) if shortfall > 0 else ():
            new = np.flatnonzero(
                demand.missing_count(pose_sides.sum(axis=0) - pose_sides[place] + sides[level[place]]) < shortfall
            )
            old = information[row[level[place]], pick[place]]
            if len(new):
                values = criterion.exchange_values(total, old, information[row[level[place]], new], int(level[place]))
                best = min(best, (float(values.min()), place, int(new[np.argmin(values)])))
        if not np.isfinite(best[0]):
            return replace(choice, pick=pick, value=criterion.value(information[row[level], pick], level))
        pick[best[1]] = best[2]


def _exchange_poses(task: Task, choice: _Choice) -> _Choice:
    """Replace each pose in turn by the best candidate of its level, or of any level if the levels are fixed.

    An exchange never reduces the signs of torque with which the joints are loaded.
    """
    information, row, criterion = task.candidates.information, choice.row, choice.criterion
    level, pick, demand = choice.level.copy(), choice.pick.copy(), task.directions
    sides = demand.loaded_sides(task.candidates.torque[row]).astype(np.int64)
    for place in range(task.count):
        count = sides[level, pick].sum(axis=0)
        worse = demand.missing_count(count - sides[level[place], pick[place]] + sides) > demand.missing_count(count)
        old = information[row[level[place]], pick[place]]
        total = criterion.total(information[row[level], pick], level)
        values = criterion.exchange_values(total, old, information[row[level[place]]], int(level[place]))
        if not task.fixed:
            pick[place] = int(np.argmin(np.where(worse[level[place]], np.inf, values)))
        else:
            other_poses = np.delete(np.arange(task.count), place)
            reduced_total = criterion.total(information[row[level[other_poses]], pick[other_poses]], level[other_poses])
            zero = np.zeros_like(old)
            values_by_level = [
                criterion.exchange_values(reduced_total, zero, information[r], g) for g, r in enumerate(row)
            ]
            best = int(np.argmin(np.where(worse, np.inf, values_by_level)))
            level[place], pick[place] = np.unravel_index(best, (task.levels, information.shape[1]))
    value = criterion.value(information[row[level], pick], level)
    return replace(choice, level=level, pick=pick, value=value)


def _exchange_level(task: Task, choice: _Choice, group: int) -> _Choice:
    """Return the choice with one level of q2 moved to the candidate that gives the smallest criterion."""
    candidates, level = task.candidates, choice.level
    members = np.flatnonzero(level == group)
    other_rows = np.delete(choice.row, group)
    best = choice
    for candidate in range(task.fixed, len(candidates)):
        if candidate in choice.row or not _is_distant(candidates.q2[other_rows], candidates.q2[candidate]):
            continue
        row, pick = choice.row.copy(), choice.pick.copy()
        row[group] = candidate
        criterion = task.criterion_at(candidates.q2[row])
        is_in_other_level = level != group
        total = criterion.total(
            candidates.information[row[level[is_in_other_level]], pick[is_in_other_level]], level[is_in_other_level]
        )
        zero = np.zeros_like(candidates.information[0, 0])
        for place in members:  # greedily, one after the other
            values = criterion.exchange_values(total, zero, candidates.information[candidate], group)
            pick[place] = int(np.argmin(values))
            groups = np.array([group])
            total = (
                total + criterion.total(candidates.information[candidate, pick[place]][None], groups) - criterion.before
            )
        value = float(criterion.of_totals(total[None])[0])
        if value < best.value * (1.0 - _MIN_GAIN):
            best = _Choice(row, level, pick, criterion, value)
    return best


def refine(task: Task, plan: Plan, rng: np.random.Generator, rounds: int) -> Iterator[Plan]:
    """Yield plans, each no worse than the one before, with poses and levels moved off the candidates."""
    scale = 0.3  # standard deviation of random steps [rad]; smaller after each round without a gain
    for _ in range(rounds):
        old_value = plan.value
        plan = _move_poses(task, plan, rng, scale)
        plan = _move_levels(task, plan)
        yield plan
        if plan.value > old_value * (1.0 - 3.0 * _MIN_GAIN):
            if scale < 0.02:  # about a degree
                return
            scale *= 0.4


def _move_poses(task: Task, plan: Plan, rng: np.random.Generator, scale: float) -> Plan:
    """Return the plan with each pose moved to its best feasible neighbour, if that is better.

    :param scale: standard deviation of the random steps of angles and tilts [rad].
    """
    q, tilt = plan.q.copy(), plan.tilt.copy()
    criterion = task.criterion_at(plan.q2)
    value = plan.value
    information, sides = task.readings.information(q, tilt), task.sides(q, tilt)
    for place in range(len(q)):
        total = criterion.total(information, plan.level)
        push = criterion.push(total, plan.level[[place]])
        slope = task.readings.slope(q[[place]], tilt[[place]], push)[0]
        new_q, new_tilt = _proposals(task.site, q[place], tilt[place], slope, rng, scale)
        new = task.readings.information(new_q, new_tilt)
        values = criterion.exchange_values(total, information[place], new, int(plan.level[place]))
        order = np.argsort(values, kind="stable")
        order = order[values[order] < value * (1.0 - 1e-5)]
        new_sides, count = task.sides(new_q, new_tilt), sides.sum(axis=0)
        worse = task.directions.missing_count(count - sides[place] + new_sides) > task.directions.missing_count(count)
        order = order[~worse[order]]
        is_feasible = constraints.feasible(task.site, new_q[order], new_tilt[order])
        if is_feasible.any():
            best = order[np.argmax(is_feasible)]
            sides[place] = new_sides[best]
            q[place], tilt[place], information[place], value = new_q[best], new_tilt[best], new[best], values[best]
    return replace(plan, q=q, tilt=tilt, value=float(value))


def _proposals(
    site: Site, q: Array, tilt: Array, slope: Array, rng: np.random.Generator, scale: float
) -> tuple[Array, Array]:
    """Return places around a pose: down the gradient, at random, and with the load turned; q2 stays."""
    slope = slope.copy()
    slope[1] = 0.0
    if site.rig.largest_tilt == 0.0:
        slope[6:] = 0.0
    # 1e-300 keeps zero out of the denominator
    descent = -slope / max(float(np.abs(slope).max()), 1e-300)
    steps = [step * descent for step in _STEPS]
    noise = rng.normal(0.0, scale, (_RANDOM, 8))
    noise[: _RANDOM // 2] *= rng.random((_RANDOM // 2, 8)) < 0.3  # some joints only
    delta = np.vstack([steps, noise])
    new_q = np.clip(q + delta[:, :6], site.lower, site.upper)
    new_q[:, 1] = q[1]
    new_tilt = tilt + delta[:, 6:]
    size = np.linalg.norm(new_tilt, axis=1, keepdims=True)
    # 1e-300 keeps zero out of the denominator
    return new_q, new_tilt * np.minimum(1.0, site.rig.largest_tilt / np.maximum(size, 1e-300))


def _move_levels(task: Task, plan: Plan) -> Plan:
    """Shift each level that is not fixed, with its group: link 2 alone, or so that the forearm keeps its direction."""
    demand = task.directions
    for group in range(task.fixed, len(plan.q2)):
        members = plan.level == group
        shortfall = demand.missing_count(task.sides(plan.q, plan.tilt).sum(axis=0))
        for shift in (*_SHIFTS, *-_SHIFTS):
            q2 = plan.q2.copy()
            q2[group] += shift
            is_in_range = task.site.lower[1] <= q2[group] <= task.site.upper[1]
            if not is_in_range or not _is_distant(np.delete(q2, group), q2[group]):
                continue
            criterion = task.criterion_at(q2)
            for follow in (0.0, -shift):
                q = plan.q.copy()
                q[members, 1] = q2[group]
                q[members, 2] += follow
                value = criterion.value(task.readings.information(q, plan.tilt), plan.level)
                better = value < plan.value * (1.0 - 1e-5)
                better = better and bool(demand.missing_count(task.sides(q, plan.tilt).sum(axis=0)) <= shortfall)
                if better and constraints.feasible(task.site, q[members], plan.tilt[members]).all():
                    plan = replace(plan, q=q, q2=q2, value=value)
                    break
            if plan.q2[group] == q2[group]:
                break
    return plan


RANDOM_PLANS = 200
"""Random plans that a plan is compared with in its page (assumed)."""
_BEST_SHARE = 0.2
"""Of the poses of a level, the share with the largest dexterity, of which those furthest apart are taken (assumed)."""
FACTORS = (0.4, 0.6, 0.8, 1.0, 1.4, 2.0)
"""Numbers of configurations that are tried, as factors of the one asked for."""


def random_values(task: Task, seed: int, count: int = RANDOM_PLANS) -> Array:
    """Return the criterion (count,) [m²] of plans whose levels, poses and loads are random but can be measured."""
    rng = np.random.default_rng([seed, 1 << 20])
    candidates, values = task.candidates, np.empty(count)
    for index in range(count):
        row = first_levels(task, rng, spread=False)
        level = task.pose_levels(rng)
        pick = rng.integers(0, candidates.q.shape[1], task.count)
        values[index] = task.criterion_at(candidates.q2[row]).value(candidates.information[row[level], pick], level)
    return values


def serial_plan(task: Task) -> Plan:
    """Return the semi-intuitive plan of the serial approach: poses chosen by a kinematic performance measure.

    After Dumas et al. 2011 as quoted in the paper: evenly spaced levels of q2; on each, of the fifth of poses in which
    the Jacobian is best conditioned (lengths over the characteristic one), those farthest apart in joint space.
    """
    candidates = task.candidates
    row = first_levels(task, np.random.default_rng(0), spread=True)
    level = task.pose_levels(np.random.default_rng(0))
    pick = np.zeros(task.count, dtype=np.int64)
    for group in range(task.levels):
        members = np.flatnonzero(level == group)
        dexterity = _dexterity(task, candidates.q[row[group]])
        count = max(len(members), int(_BEST_SHARE * len(dexterity)))
        pick[members] = _distant_rows(
            candidates.q[row[group]], np.argsort(-dexterity, kind="stable")[:count], len(members)
        )
    value = task.criterion_at(candidates.q2[row]).value(candidates.information[row[level], pick], level)
    return Plan(candidates.q[row[level], pick], candidates.tilt[row[level], pick], level, candidates.q2[row], value)


def _dexterity(task: Task, q: Array) -> Array:
    """Return 1/condition (C,) of the Jacobian of the load point, lengths over their mean (Angeles and López-Cajún)."""
    arm_pose = task.site.arm.pose(q)
    linear = arm_pose.velocity(arm_pose.point(task.site.load_point[None]))[:, 0]
    length = np.sqrt(np.mean(linear**2)) * np.sqrt(3.0)
    jacobian = np.concatenate([linear / length, arm_pose.axis], axis=2)
    singular = np.linalg.svd(jacobian, compute_uv=False)
    return np.asarray(singular[:, -1] / singular[:, 0])


def _distant_rows(q: Array, rows: Ints, count: int) -> list[int]:
    """Return rows whose joint angles are far apart: each the farthest from those before."""
    selection = [int(rows[0])]
    while len(selection) < count:
        distance = np.linalg.norm(q[rows][:, None] - q[selection][None], axis=2).min(axis=1)
        distance[np.isin(rows, selection)] = -1.0
        selection.append(int(rows[np.argmax(distance)]))
    return selection


def criterion_by_number(task: Task, seed: int, best: Plan) -> Iterator[tuple[int, float, float]]:
    """Yield (number of poses, criterion of the best plan found, median of random plans) [m²] for several sizes.

    A short search: good to some per cent. The size of the plan itself takes its own value.
    """
    min_count = 1 if task.fixed else task.levels
    for count in sorted({max(min_count, round(factor * task.count)) for factor in FACTORS}):
        resized_task = replace(task, count=count)
        value = best.value
        if count != task.count:
            for plan in improve(resized_task, seed, starts=2, finalists=1, rounds=8):
                value = plan.value
        yield count, value, float(np.median(random_values(resized_task, seed, 60)))
