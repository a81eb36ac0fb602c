"""The search for the best plan: many starts, exchange of poses and levels, then steps along the gradient.

Exchange (Fedorov 1972; Mitchell 1974): each pose in turn is replaced by the candidate that lowers the criterion most,
each level of q2 with its whole group by another one. From the best few, poses move freely: steps along the gradient and
at random, the best of those that can be measured is taken. Nothing depends on time: the same seed gives the same plan.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.frames import RAD_PER_DEG, Array
from postproc.plan import constraints
from postproc.plan.candidate_poses import Candidates
from postproc.plan.criterion import Criterion
from postproc.plan.directions import Directions
from postproc.plan.sensitivity import Readings, direction
from postproc.plan.site import Site
from postproc.program import Bools, Ints

_APART = 8.0 * RAD_PER_DEG
"""Least distance of two levels of q2: the identification takes angles within 2° for one level."""
_EXCHANGE_ROUNDS = 12
_ENOUGH = 1e-3
_STEPS = (0.5, 0.25, 0.12, 0.06, 0.03, 0.012, 0.004)
_RANDOM = 24
_SHIFTS = np.array([12.0, 6.0, 3.0, 1.5, 0.5]) * RAD_PER_DEG

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
    :param criterion_at: what a plan with given levels is worth.
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
        return self.directions.counted(self.readings.torque(q, self.readings.force * direction(tilt)))

    def group_of_each(self, rng: np.random.Generator) -> Ints:
        """Return the level (n,) of each pose: groups as equal as can be; at random where levels were measured."""
        if self.fixed:
            return rng.integers(0, self.levels, self.count)
        return np.sort(np.arange(self.count) % self.levels)


def improved(task: Task, seed: int, starts: int, kept: int, rounds: int) -> Iterator[Plan]:
    """Yield better and better plans; the last one is the result.

    :param starts: number of starts from other levels and poses.
    :param kept: how many of them are refined.
    :param rounds: of refinement.
    """
    rough: list[Plan] = []
    best: Plan | None = None
    for start in range(starts):
        rough.append(exchange(task, np.random.default_rng([seed, start]), spread=start == 0))
        best = rough[-1] if best is None or rough[-1].value < best.value else best
        yield best
    assert best is not None
    for rank, plan in enumerate(sorted(rough, key=lambda one: one.value)[:kept]):
        rng = np.random.default_rng([seed, starts + rank])
        for refined in refine(task, plan, rng, rounds):
            best = refined if refined.value < best.value else best
            yield best


class _Choice(Struct, frozen=True, eq=False):
    """Candidates chosen, and what they are worth together.

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
    level = task.group_of_each(rng)
    pick = rng.integers(0, candidates.q.shape[1], task.count)
    criterion = task.criterion_at(candidates.q2[row])
    value = criterion.value(candidates.information[row[level], pick], level)
    best = _Choice(row, level, pick, criterion, value)
    for _ in range(_EXCHANGE_ROUNDS):
        before = best.value
        best = _exchange_poses(task, best)
        for group in range(task.fixed, task.levels):
            best = _exchange_level(task, best, group)
        if best.value > before * (1.0 - _ENOUGH):
            break
    best = _exchange_poses(task, _to_both_sides(task, best))
    at = best.row[best.level], best.pick
    return Plan(candidates.q[at], candidates.tilt[at], best.level, candidates.q2[best.row], best.value)


def first_levels(task: Task, rng: np.random.Generator, spread: bool) -> Ints:
    """Return levels (m,) of A2 as rows of the candidates: the fixed ones, then evenly spread or random ones."""
    free = np.arange(task.fixed, len(task.candidates))
    wanted = task.levels - task.fixed
    row = list(range(task.fixed))
    if spread and task.fixed == 0:
        return free[np.round(np.linspace(0, len(free) - 1, wanted)).astype(np.int64)]
    for candidate in rng.permutation(free):
        if len(row) < task.levels and _apart(task.candidates.q2[row], task.candidates.q2[candidate]):
            row.append(int(candidate))
    for candidate in rng.permutation(free):  # too many levels for the distance: nearer ones, but different
        if len(row) < task.levels and int(candidate) not in row:
            row.append(int(candidate))
    return np.array(row)


def _apart(others: Array, q2: float) -> bool:
    return bool((np.abs(others - q2) >= _APART - 1e-9).all())


def _to_both_sides(task: Task, choice: _Choice) -> _Choice:
    """Replace poses within their levels until each joint is loaded with both signs; the smallest criterion wins."""
    information, row, criterion, level = task.candidates.information, choice.row, choice.criterion, choice.level
    pick, wanted = choice.pick.copy(), task.directions
    sides = wanted.counted(task.candidates.torque[row]).astype(np.int64)
    while True:
        own = sides[level, pick]
        missing = wanted.missing(own.sum(axis=0))
        total = criterion.total(information[row[level], pick], level)
        best = (np.inf, 0, 0)
        for place in range(task.count) if missing > 0 else ():
            new = np.flatnonzero(wanted.missing(own.sum(axis=0) - own[place] + sides[level[place]]) < missing)
            old = information[row[level[place]], pick[place]]
            if len(new):
                values = criterion.exchanged(total, old, information[row[level[place]], new], int(level[place]))
                best = min(best, (float(values.min()), place, int(new[np.argmin(values)])))
        if not np.isfinite(best[0]):
            return replace(choice, pick=pick, value=criterion.value(information[row[level], pick], level))
        pick[best[1]] = best[2]


def _exchange_poses(task: Task, choice: _Choice) -> _Choice:
    """Replace each pose in turn by the best candidate of its level, or of any level if the levels are fixed.

    An exchange never reduces the signs of torque with which the joints are loaded.
    """
    information, row, criterion = task.candidates.information, choice.row, choice.criterion
    level, pick, wanted = choice.level.copy(), choice.pick.copy(), task.directions
    sides = wanted.counted(task.candidates.torque[row]).astype(np.int64)
    for place in range(task.count):
        count = sides[level, pick].sum(axis=0)
        worse = wanted.missing(count - sides[level[place], pick[place]] + sides) > wanted.missing(count)
        own = information[row[level[place]], pick[place]]
        total = criterion.total(information[row[level], pick], level)
        values = criterion.exchanged(total, own, information[row[level[place]]], int(level[place]))
        if not task.fixed:
            pick[place] = int(np.argmin(np.where(worse[level[place]], np.inf, values)))
        else:
            rest = np.delete(np.arange(task.count), place)
            without = criterion.total(information[row[level[rest]], pick[rest]], level[rest])
            nothing = np.zeros_like(own)
            every = [criterion.exchanged(without, nothing, information[r], g) for g, r in enumerate(row)]
            best = int(np.argmin(np.where(worse, np.inf, every)))
            level[place], pick[place] = np.unravel_index(best, (task.levels, information.shape[1]))
    value = criterion.value(information[row[level], pick], level)
    return replace(choice, level=level, pick=pick, value=value)


def _exchange_level(task: Task, choice: _Choice, group: int) -> _Choice:
    """Return the choice with one level of q2 moved to the candidate that gives the smallest criterion."""
    candidates, level = task.candidates, choice.level
    members = np.flatnonzero(level == group)
    others = np.delete(choice.row, group)
    best = choice
    for other in range(task.fixed, len(candidates)):
        if other in choice.row or not _apart(candidates.q2[others], candidates.q2[other]):
            continue
        row, pick = choice.row.copy(), choice.pick.copy()
        row[group] = other
        there = task.criterion_at(candidates.q2[row])
        rest = level != group
        total = there.total(candidates.information[row[level[rest]], pick[rest]], level[rest])
        nothing = np.zeros_like(candidates.information[0, 0])
        for place in members:  # greedily, one after the other
            values = there.exchanged(total, nothing, candidates.information[other], group)
            pick[place] = int(np.argmin(values))
            added = np.array([group])
            total = total + there.total(candidates.information[other, pick[place]][None], added) - there.before
        found = float(there.of_totals(total[None])[0])
        if found < best.value * (1.0 - _ENOUGH):
            best = _Choice(row, level, pick, there, found)
    return best


def refine(task: Task, plan: Plan, rng: np.random.Generator, rounds: int) -> Iterator[Plan]:
    """Yield plans, each no worse than the one before, with poses and levels moved off the candidates."""
    scale = 0.3
    for _ in range(rounds):
        before = plan.value
        plan = _move_poses(task, plan, rng, scale)
        plan = _move_levels(task, plan)
        yield plan
        if plan.value > before * (1.0 - 3.0 * _ENOUGH):
            if scale < 0.02:
                return
            scale *= 0.4


def _move_poses(task: Task, plan: Plan, rng: np.random.Generator, scale: float) -> Plan:
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
        values = criterion.exchanged(total, information[place], new, int(plan.level[place]))
        order = np.argsort(values, kind="stable")
        order = order[values[order] < value * (1.0 - 1e-5)]
        new_sides, count = task.sides(new_q, new_tilt), sides.sum(axis=0)
        worse = task.directions.missing(count - sides[place] + new_sides) > task.directions.missing(count)
        order = order[~worse[order]]
        allowed = constraints.feasible(task.site, new_q[order], new_tilt[order])
        if allowed.any():
            best = order[np.argmax(allowed)]
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
    along = -slope / max(float(np.abs(slope).max()), 1e-300)
    steps = [step * along for step in _STEPS]
    noise = rng.normal(0.0, scale, (_RANDOM, 8))
    noise[: _RANDOM // 2] *= rng.random((_RANDOM // 2, 8)) < 0.3  # some joints only
    delta = np.vstack([steps, noise])
    new_q = np.clip(q + delta[:, :6], site.lower, site.upper)
    new_q[:, 1] = q[1]
    new_tilt = tilt + delta[:, 6:]
    size = np.linalg.norm(new_tilt, axis=1, keepdims=True)
    return new_q, new_tilt * np.minimum(1.0, site.rig.largest_tilt / np.maximum(size, 1e-300))


def _move_levels(task: Task, plan: Plan) -> Plan:
    """Shift each level that is not fixed, with its group: link 2 alone, or so that the forearm keeps its direction."""
    wanted = task.directions
    for group in range(task.fixed, len(plan.q2)):
        members = plan.level == group
        missing = wanted.missing(task.sides(plan.q, plan.tilt).sum(axis=0))
        for shift in (*_SHIFTS, *-_SHIFTS):
            q2 = plan.q2.copy()
            q2[group] += shift
            inside = task.site.lower[1] <= q2[group] <= task.site.upper[1]
            if not inside or not _apart(np.delete(q2, group), q2[group]):
                continue
            criterion = task.criterion_at(q2)
            for follow in (0.0, -shift):
                q = plan.q.copy()
                q[members, 1] = q2[group]
                q[members, 2] += follow
                value = criterion.value(task.readings.information(q, plan.tilt), plan.level)
                better = value < plan.value * (1.0 - 1e-5)
                better = better and bool(wanted.missing(task.sides(q, plan.tilt).sum(axis=0)) <= missing)
                if better and constraints.feasible(task.site, q[members], plan.tilt[members]).all():
                    plan = replace(plan, q=q, q2=q2, value=value)
                    break
            if plan.q2[group] == q2[group]:
                break
    return plan
