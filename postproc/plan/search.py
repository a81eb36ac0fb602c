"""The search for the best plan: candidate poses, exchange, steps along the gradient; and plans to compare with.

Candidates: poses that can be measured, level by level of q2, drawn at random. Joints are uniform within their limits,
loads uniform over the directions that the rig allows; every candidate satisfies all constraints.

Exchange (Fedorov 1972; Mitchell 1974): each pose in turn is replaced by the candidate that lowers the criterion most,
each level of q2 with its whole group by another one. From the best few, poses move freely: of steps along the gradient
and at random the best that can be measured is taken. Nothing depends on time: the same seed gives the same plan.

A plan is compared with random plans, with the semi-intuitive plan of the serial approach, and with other sizes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

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

_LEVELS = 24
"""Levels of q2 at which poses are drawn, besides fixed ones (assumed)."""
_POSES_PER_LEVEL = 100
"""Poses that are drawn for each level (assumed); the search then moves them."""
_POSES_PER_DRAW = 400
"""Poses that are drawn at once."""
_MAX_DRAWS = 40
"""Draws after which a level keeps the poses that it has; a quarter of these draws if it has none (assumed)."""
_TRIAL_POSES = 4000
"""Poses at random by which constraints are judged if there is no candidate."""
_FULL_SHARE = 0.999
"""Share of these poses from which on a constraint forbids practically all (assumed)."""


class Candidates(Struct, frozen=True, eq=False):
    """Feasible poses at L levels of q2, C at each level. Levels with earlier readings may have no poses.

    A level is an angle of joint 2 that several poses share, so that they show the same effect of the compensator.

    :param q2: (L,) levels [rad].
    :param q: (L, C, 6) joint angles [rad].
    :param tilt: (L, C, 2) of the load [rad], along its horizontal part, as long as its angle from straight down.
    :param information: (L, C, p, p) on the p identified compliances; 0 for levels without poses.
    :param torque: (L, C, 6) of the load on the joints [N·m]; 0 for levels without poses.
    """

    q2: Array
    q: Array
    tilt: Array
    information: Array
    torque: Array

    def take_parameters(self, joints: tuple[int, ...]) -> Candidates:
        """Return the candidates with the information on the compliances of some joints only, (p,) from 0."""
        return replace(self, information=self.information[:, :, joints][:, :, :, joints])

    def __len__(self) -> int:
        return len(self.q2)


def draw_poses(site: Site, count: int, rng: np.random.Generator, q2: float | None = None) -> tuple[Array, Array]:
    """Return random configurations, feasible or not.

    :param q2: level of q2 [rad]; None: at random too.
    :returns: (count, 6) joint angles within ±180° and the limits [rad]; (count, 2) tilts of the load [rad]: along its
        horizontal part, as long as its angle from straight down.
    """
    lower, upper = np.maximum(site.lower, -np.pi), np.minimum(site.upper, np.pi)
    q = rng.uniform(lower, upper, (count, 6))
    if q2 is not None:
        q[:, 1] = q2
    # uniform over the cap of the sphere: cos(angle) is uniform
    angle = np.arccos(rng.uniform(np.cos(site.rig.largest_tilt), 1.0, count))
    heading = rng.uniform(-np.pi, np.pi, count)
    return q, angle[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)


def draw_feasible_poses(site: Site, q2: float, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return up to `count` random feasible configurations at one level q2 [rad].

    They are fewer, or none, if hardly any pose is feasible: the number of draws is limited.

    :returns: (k, 6) joint angles [rad]; (k, 2) tilts of the load [rad].
    """
    feasible_q, feasible_tilt, feasible_count = [], [], 0
    for _ in range(_MAX_DRAWS):
        q, tilt = draw_poses(site, _POSES_PER_DRAW, rng, q2)
        is_feasible = constraints.are_feasible(site, q, tilt)
        feasible_q.append(q[is_feasible])
        feasible_tilt.append(tilt[is_feasible])
        feasible_count += int(is_feasible.sum())
        if feasible_count >= count or (feasible_count == 0 and len(feasible_q) >= _MAX_DRAWS // 4):
            break
    return np.concatenate(feasible_q)[:count], np.concatenate(feasible_tilt)[:count]


def draw_candidates(
    site: Site, readings: Readings, rng: np.random.Generator, fixed_levels: Array | None = None
) -> Candidates:
    """Return random candidates at fixed levels of q2 and at a grid of levels over its range.

    Levels of the grid with few feasible poses are left out.

    :param readings: sensitivity of measurements to all six compliances.
    :param fixed_levels: (m,) levels of earlier readings [rad], which come first; None: there are none.
    :raises PlanError: no pose can be measured; the message names the constraints that block.
    """
    lower, upper = site.lower[1], site.upper[1]
    levels = np.concatenate([np.zeros(0) if fixed_levels is None else fixed_levels, np.linspace(lower, upper, _LEVELS)])
    draws = [draw_feasible_poses(site, float(level), _POSES_PER_LEVEL, rng) for level in levels]
    is_sufficient = np.array([len(q) >= _POSES_PER_LEVEL // 10 for q, _ in draws])
    if not is_sufficient.any():
        raise PlanError(blocking_text(site, rng))
    fixed_count = 0 if fixed_levels is None else len(fixed_levels)
    is_sufficient[:fixed_count] = True  # fixed levels stay, even if nothing can be measured there any more
    level_draws = [poses for poses, is_candidate in zip(draws, is_sufficient, strict=True) if is_candidate]
    return _candidates_of(readings, levels[is_sufficient], level_draws)


def _candidates_of(readings: Readings, q2: Array, draws: Sequence[tuple[Array, Array]]) -> Candidates:
    """Return the candidates at levels q2 (L,) [rad], `_POSES_PER_LEVEL` at each; fewer drawn poses are repeated.

    :param draws: joint angles (k, 6) and tilts of the load (k, 2) [rad] for each level. The candidates of a level
        without poses have zero information and torque.
    """
    q, tilt = np.zeros((len(q2), _POSES_PER_LEVEL, 6)), np.zeros((len(q2), _POSES_PER_LEVEL, 2))
    has_pose = np.zeros((len(q2), _POSES_PER_LEVEL), dtype=bool)
    for row, (level_q, level_tilt) in enumerate(draws):
        if len(level_q):
            pick = np.arange(_POSES_PER_LEVEL) % len(level_q)  # repeats the poses
            q[row], tilt[row], has_pose[row] = level_q[pick], level_tilt[pick], True
    information = readings.information(q.reshape(-1, 6), tilt.reshape(-1, 2)).reshape(*q.shape[:2], 6, 6)
    load = readings.force * direction(tilt.reshape(-1, 2))
    torque = readings.torque(q.reshape(-1, 6), load).reshape(*q.shape[:2], 6)
    return Candidates(
        q2=q2,
        q=q,
        tilt=tilt,
        information=information * has_pose[:, :, None, None],
        torque=torque * has_pose[:, :, None],
    )


class _Blockage(NamedTuple):
    """A constraint that forbids random poses.

    :param freed_count: number of poses that this constraint alone forbids: they were possible without it.
    :param share: share of the poses that it forbids.
    :param name: of the constraint.
    """

    freed_count: int
    share: float
    name: str

    def __str__(self) -> str:
        note = f", without it {self.freed_count} poses were possible" if self.freed_count else ""
        return f"{self.name} forbids {100 * self.share:.1f} %{note}"


def blocking_text(site: Site, rng: np.random.Generator) -> str:
    """Return the message of the error that no pose is feasible, which names the constraint that blocks most.

    For up to six constraints it has the share of random poses that the constraint forbids, and the number of poses
    that were possible without it.
    """
    q, tilt = draw_poses(site, _TRIAL_POSES, rng)
    failures = constraints.failures(site, q, tilt)
    failure_count = sum(failures.values(), np.zeros(_TRIAL_POSES, dtype=int))  # of each pose
    blockages = [
        _Blockage(int(np.count_nonzero((failure_count == 1) & is_forbidden)), float(is_forbidden.mean()), name)
        for name, is_forbidden in failures.items()
        if is_forbidden.any()
    ]
    blockages.sort(key=lambda blockage: -blockage.share)
    # the constraint without which most poses were possible; else one that forbids all poses; else the strictest one
    sole_blockages = sorted((blockage for blockage in blockages if blockage.freed_count), reverse=True)
    full_blockages = [blockage for blockage in blockages if blockage.share > _FULL_SHARE]
    culprit = (sole_blockages or full_blockages or blockages)[0].name
    summary = "; ".join(map(str, blockages[:6]))
    return f"no pose can be measured: what blocks is: {culprit}. Of {_TRIAL_POSES} poses at random: {summary}"


_LEAST_DISTANCE = 8.0 * RAD_PER_DEG
"""Least distance of two levels of q2 [rad]: the identification takes angles within 2° for one level."""
_EXCHANGE_ROUNDS = 12
"""Limit of the rounds of exchanges (assumed)."""
_MIN_GAIN = 1e-3
"""A change of the criterion below a thousandth is not worth a further round (assumed)."""
_LEAST_RELATIVE_GAIN = 1e-5
"""Relative change of the criterion below which a moved pose is no better but for rounding (assumed)."""
_DESCENT_STEPS = (0.5, 0.25, 0.12, 0.06, 0.03, 0.012, 0.004)
"""Lengths down the gradient that are tried [rad]: by factors of two to three, down to a quarter of a degree."""
_RANDOM_STEPS = 24
"""Random places around a pose that are tried, half of them with some joints changed only (assumed)."""
_CHANGED_SHARE = 0.3
"""Share of the joint angles and tilts that change at those places (assumed)."""
_FIRST_SCALE, _LAST_SCALE = 0.3, 0.02
"""Standard deviation of the random steps [rad] at first, and the one below which the refinement ends (assumed)."""
_SCALE_FACTOR = 0.4
"""Factor of that standard deviation after a round without a gain (assumed)."""
_MIN_ROUND_GAIN = 3e-3
"""A round of refinement that changes the criterion by less has no gain (assumed)."""
_LEVEL_SHIFTS = np.array([12.0, 6.0, 3.0, 1.5, 0.5]) * RAD_PER_DEG
"""Changes of the levels of q2 that are tried, both ways (assumed)."""

CriterionAt = Callable[[Array], Criterion]
"""Levels q2 (m,) [rad] → the criterion there."""


class Plan(Struct, frozen=True, eq=False):
    """n poses with their loads.

    :param q: (n, 6) joint angles [rad]; q[:, 1] equals q2[level].
    :param tilt: (n, 2) of the load [rad], along its horizontal part, as long as its angle from straight down.
    :param level: (n,) level of each pose, an index into `q2`.
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

    :param site: with the constraints.
    :param readings: sensitivity of the measurements.
    :param criterion_at: criterion of plans with given levels.
    :param candidates: poses to choose from; their first `fixed_count` levels are kept, as they were measured.
    :param count: number of poses.
    :param levels: number of levels of q2, fixed levels included.
    :param directions: demand on the directions of the joint torques.
    :param fixed_count: number of fixed levels: those with earlier readings.
    """

    site: Site
    readings: Readings
    criterion_at: CriterionAt
    candidates: Candidates
    count: int
    levels: int
    directions: Directions
    fixed_count: int = 0

    def loaded_sides(self, q: Array, tilt: Array) -> Bools:
        """Return True for the sides (N, 6, 2), negative and positive of each joint, that poses load enough to count.

        :param q: (N, 6) joint angles, and `tilt` (N, 2) of the load [rad].
        """
        return self.directions.loaded_sides(self.readings.torque(q, self.readings.force * direction(tilt)))

    def pose_levels(self, rng: np.random.Generator) -> Ints:
        """Return the level (n,) of each pose: at random with fixed levels, else levels with equal numbers of poses."""
        if self.fixed_count:
            return rng.integers(0, self.levels, self.count)
        return np.sort(np.arange(self.count) % self.levels)


def improve(task: Task, seed: int, starts: int, finalists: int, rounds: int) -> Iterator[Plan]:
    """Yield the best plan so far after each step of the search; the last plan is the result.

    :param starts: number of plans by exchange, each from other levels and poses; at least 1.
    :param finalists: number of the best plans by exchange that are refined.
    :param rounds: largest number of rounds of refinement of a plan.
    """
    exchange_plans: list[Plan] = []
    best: Plan | None = None
    for start in range(starts):
        plan = exchange(task, np.random.default_rng([seed, start]), spread=start == 0)
        exchange_plans.append(plan)
        best = plan if best is None or plan.value < best.value else best
        yield best
    assert best is not None
    for rank, plan in enumerate(sorted(exchange_plans, key=lambda entry: entry.value)[:finalists]):
        rng = np.random.default_rng([seed, starts + rank])
        for refined_plan in refine(task, plan, rng, rounds):
            best = refined_plan if refined_plan.value < best.value else best
            yield best


class _Choice(Struct, frozen=True, eq=False):
    """A plan of n poses at m levels, made of candidates.

    :param row: (m,) index of each level among the levels of the candidates.
    :param level: (n,) level of each pose, an index into `row`.
    :param pick: (n,) index of each pose among the candidates of its level.
    :param criterion: criterion at these levels.
    :param value: criterion of the plan [m²].
    """

    row: Ints
    level: Ints
    pick: Ints
    criterion: Criterion
    value: float


def exchange(task: Task, rng: np.random.Generator, spread: bool = False) -> Plan:
    """Return a plan of candidates that hardly any exchange of one pose or one level improves.

    Then poses are exchanged so that each joint is loaded in both directions as the task demands.

    :param spread: whether the levels at the start are evenly spread over the range of q2; else they are random.
    """
    candidates = task.candidates
    row = first_levels(task, rng, spread)
    level = task.pose_levels(rng)
    pick = rng.integers(0, candidates.q.shape[1], task.count)  # of the candidates of the level of each pose
    criterion = task.criterion_at(candidates.q2[row])
    value = criterion.value(candidates.information[row[level], pick], level)
    best = _Choice(row, level, pick, criterion, value)
    for _ in range(_EXCHANGE_ROUNDS):
        old_value = best.value
        best = _exchange_poses(task, best)
        for group in range(task.fixed_count, task.levels):
            best = _exchange_level(task, best, group)
        if best.value > old_value * (1.0 - _MIN_GAIN):
            break
    best = _exchange_poses(task, _load_both_signs(task, best))
    index = best.row[best.level], best.pick
    return Plan(
        q=candidates.q[index],
        tilt=candidates.tilt[index],
        level=best.level,
        q2=candidates.q2[best.row],
        value=best.value,
    )


def first_levels(task: Task, rng: np.random.Generator, spread: bool) -> Ints:
    """Return the levels of q2 (angles of joint 2) to begin with, as indices (m,) among the levels of the candidates.

    Without fixed levels they may be spread evenly. Else fixed levels come first, then random levels, distant from each
    other as far as possible.

    :param spread: spread the levels evenly over the range of q2; ignored with fixed levels.
    """
    free_rows = np.arange(task.fixed_count, len(task.candidates))
    rows = list(range(task.fixed_count))
    if spread and task.fixed_count == 0:
        return free_rows[np.round(np.linspace(0, len(free_rows) - 1, task.levels)).astype(np.int64)]
    for candidate in rng.permutation(free_rows):
        if len(rows) < task.levels and _is_distant(task.candidates.q2[rows], task.candidates.q2[candidate]):
            rows.append(int(candidate))
    for candidate in rng.permutation(free_rows):  # too few distant levels: near levels, but different
        if len(rows) < task.levels and int(candidate) not in rows:
            rows.append(int(candidate))
    return np.array(rows)


def _is_distant(levels: Array, q2: float) -> bool:
    """Return whether a level q2 is at least `_LEAST_DISTANCE` from all other levels (m,) [rad]."""
    # 1e-9 rad: rounding
    return bool((np.abs(levels - q2) >= _LEAST_DISTANCE - 1e-9).all())


def _load_both_signs(task: Task, choice: _Choice) -> _Choice:
    """Return the choice with poses exchanged within their levels until each joint is loaded in both directions.

    Each time the exchange with the smallest criterion is made, of exchanges that reduce the number of missing poses:
    those that the demand on directions still requires. If there is none, the demand is met as far as possible.
    """
    information = task.candidates.information[choice.row]  # (m, C, p, p)
    level, pick, demand = choice.level, choice.pick.copy(), task.directions
    candidate_sides = demand.loaded_sides(task.candidates.torque[choice.row]).astype(np.int64)  # (m, C, 6, 2)
    while (shortfall := demand.missing_count(candidate_sides[level, pick].sum(axis=0))) > 0:
        pose_sides = candidate_sides[level, pick]
        matrix = choice.criterion.normal_matrix(information[level, pick], level)
        best_value, best_pose, best_pick = np.inf, 0, 0
        for pose in range(task.count):
            changed_counts = pose_sides.sum(axis=0) - pose_sides[pose] + candidate_sides[level[pose]]
            better_picks = np.flatnonzero(demand.missing_count(changed_counts) < shortfall)
            if len(better_picks):
                old, new = information[level[pose], pick[pose]], information[level[pose], better_picks]
                values = choice.criterion.exchange_values(matrix, old, new, int(level[pose]))
                if float(values.min()) < best_value:
                    best_value, best_pose, best_pick = float(values.min()), pose, int(better_picks[np.argmin(values)])
        if not np.isfinite(best_value):  # no exchange reduces the number of missing poses
            break
        pick[best_pose] = best_pick
    return replace(choice, pick=pick, value=choice.criterion.value(information[level, pick], level))


def _exchange_poses(task: Task, choice: _Choice) -> _Choice:
    """Return the choice with each pose in turn exchanged for the candidate with the smallest criterion.

    Without fixed levels, all levels keep their numbers of poses: candidates are those of the level of the pose. With
    fixed levels, candidates are those of all levels of the choice. The levels themselves do not change. No exchange
    leaves the plan with fewer of the demanded directions of joint torques.
    """
    information, criterion = task.candidates.information[choice.row], choice.criterion  # (m, C, p, p)
    level, pick, demand = choice.level.copy(), choice.pick.copy(), task.directions
    sides = demand.loaded_sides(task.candidates.torque[choice.row]).astype(np.int64)  # (m, C, 6, 2)
    for pose in range(task.count):
        count = sides[level, pick].sum(axis=0)  # poses of the plan for each direction
        remaining_count = count - sides[level[pose], pick[pose]]
        is_worse = demand.missing_count(remaining_count + sides) > demand.missing_count(count)  # (m, C)
        if not task.fixed_count:
            old, new = information[level[pose], pick[pose]], information[level[pose]]
            matrix = criterion.normal_matrix(information[level, pick], level)
            values = criterion.exchange_values(matrix, old, new, int(level[pose]))
            pick[pose] = int(np.argmin(np.where(is_worse[level[pose]], np.inf, values)))
        else:
            # the plan without the pose; then each candidate of each level is added to it
            other_poses = np.delete(np.arange(task.count), pose)
            other_levels = level[other_poses]
            matrix = criterion.normal_matrix(information[other_levels, pick[other_poses]], other_levels)
            no_information = np.zeros_like(information[0, 0])
            values_by_level = [
                criterion.exchange_values(matrix, no_information, new, group) for group, new in enumerate(information)
            ]
            best = int(np.argmin(np.where(is_worse, np.inf, values_by_level)))
            level[pose], pick[pose] = np.unravel_index(best, is_worse.shape)
    value = criterion.value(information[level, pick], level)
    return replace(choice, level=level, pick=pick, value=value)


def _exchange_level(task: Task, choice: _Choice, group: int) -> _Choice:
    """Return the choice with level number `group` of q2 exchanged for the candidate level with the smallest criterion.

    The poses of the level are chosen anew at each candidate level. Without a gain the choice is unchanged.
    """
    candidates, best = task.candidates, choice
    other_rows = np.delete(choice.row, group)
    for candidate in range(task.fixed_count, len(candidates)):
        if candidate in choice.row or not _is_distant(candidates.q2[other_rows], candidates.q2[candidate]):
            continue
        trial = _with_level(task, choice, group, candidate)
        if trial.value < best.value * (1.0 - _MIN_GAIN):
            best = trial
    return best


def _with_level(task: Task, choice: _Choice, group: int, candidate: int) -> _Choice:
    """Return the choice with level number `group` of q2 replaced, and its poses chosen anew, greedily one by one.

    :param candidate: index of the new level among the levels of the candidates.
    """
    candidates, level = task.candidates, choice.level
    row, pick = choice.row.copy(), choice.pick.copy()
    row[group] = candidate
    criterion = task.criterion_at(candidates.q2[row])
    is_in_other_level = level != group
    other_levels = level[is_in_other_level]
    matrix = criterion.normal_matrix(candidates.information[row[other_levels], pick[is_in_other_level]], other_levels)
    no_information = np.zeros_like(candidates.information[0, 0])
    for pose in np.flatnonzero(level == group):
        values = criterion.exchange_values(matrix, no_information, candidates.information[candidate], group)
        pick[pose] = int(np.argmin(values))
        information = candidates.information[candidate, pick[pose]]
        # both matrices contain the earlier readings
        matrix = matrix + criterion.normal_matrix(information[None], np.array([group])) - criterion.earlier_matrix
    return _Choice(row, level, pick, criterion, float(criterion.matrix_values(matrix[None])[0]))


def refine(task: Task, plan: Plan, rng: np.random.Generator, rounds: int) -> Iterator[Plan]:
    """Yield plans, each no worse than the plan before, with joint angles, loads and levels changed continuously.

    :param rounds: largest number of plans; they end earlier if there is no more gain.
    """
    scale = _FIRST_SCALE
    for _ in range(rounds):
        old_value = plan.value
        plan = _move_poses(task, plan, rng, scale)
        plan = _move_levels(task, plan)
        yield plan
        if plan.value > old_value * (1.0 - _MIN_ROUND_GAIN):
            if scale < _LAST_SCALE:
                return
            scale *= _SCALE_FACTOR


def _move_poses(task: Task, plan: Plan, rng: np.random.Generator, scale: float) -> Plan:
    """Return the plan with each pose in turn moved to the best feasible pose around it, if that lowers the criterion.

    :param scale: standard deviation of the random steps of angles and tilts [rad].
    """
    q, tilt, value = plan.q.copy(), plan.tilt.copy(), plan.value
    criterion, demand = task.criterion_at(plan.q2), task.directions
    information, sides = task.readings.information(q, tilt), task.loaded_sides(q, tilt)
    for pose in range(len(q)):
        matrix = criterion.normal_matrix(information, plan.level)
        information_slope = criterion.information_slope(matrix, plan.level[[pose]])
        slope = task.readings.slope(q[[pose]], tilt[[pose]], information_slope)[0]
        new_q, new_tilt = _proposed_poses(task.site, q[pose], tilt[pose], slope, rng, scale)
        new_information, new_sides = task.readings.information(new_q, new_tilt), task.loaded_sides(new_q, new_tilt)
        values = criterion.exchange_values(matrix, information[pose], new_information, int(plan.level[pose]))
        count = sides.sum(axis=0)
        is_worse = demand.missing_count(count - sides[pose] + new_sides) > demand.missing_count(count)
        rows = np.argsort(values, kind="stable")  # the best proposal first
        rows = rows[(values[rows] < value * (1.0 - _LEAST_RELATIVE_GAIN)) & ~is_worse[rows]]
        is_feasible = constraints.are_feasible(task.site, new_q[rows], new_tilt[rows])
        if is_feasible.any():
            best = rows[np.argmax(is_feasible)]  # the best feasible proposal
            q[pose], tilt[pose], value = new_q[best], new_tilt[best], values[best]
            information[pose], sides[pose] = new_information[best], new_sides[best]
    return replace(plan, q=q, tilt=tilt, value=float(value))


def _proposed_poses(
    site: Site, q: Array, tilt: Array, slope: Array, rng: np.random.Generator, scale: float
) -> tuple[Array, Array]:
    """Return joint angles (k, 6) and tilts of the load (k, 2) [rad] around a pose: down the gradient, and at random.

    q2 does not change; the results are within the joint limits and the largest tilt.

    :param q: (6,) joint angles, and `tilt` (2,) of the load [rad].
    :param slope: (8,) gradient of the criterion by joint angles and tilt.
    :param scale: standard deviation of the random steps [rad].
    """
    slope = slope.copy()
    slope[1] = 0.0  # q2
    if site.rig.largest_tilt == 0.0:  # the load hangs: no tilt changes
        slope[6:] = 0.0
    # 1e-300 keeps zero out of the denominator
    descent = -slope / max(float(np.abs(slope).max()), 1e-300)
    steps = [step * descent for step in _DESCENT_STEPS]
    noise = rng.normal(0.0, scale, (_RANDOM_STEPS, 8))
    noise[: _RANDOM_STEPS // 2] *= rng.random((_RANDOM_STEPS // 2, 8)) < _CHANGED_SHARE  # some joints only
    delta = np.vstack([steps, noise])
    new_q = np.clip(q + delta[:, :6], site.lower, site.upper)
    new_q[:, 1] = q[1]
    new_tilt = tilt + delta[:, 6:]
    size = np.linalg.norm(new_tilt, axis=1, keepdims=True)
    # 1e-300 keeps zero out of the denominator
    return new_q, new_tilt * np.minimum(1.0, site.rig.largest_tilt / np.maximum(size, 1e-300))


def _move_levels(task: Task, plan: Plan) -> Plan:
    """Return the plan with each level of q2 that is not fixed shifted with its poses, if that lowers the criterion.

    Either q2 alone changes, or q3 too, so that the forearm keeps its direction.
    """
    for group in range(task.fixed_count, len(plan.q2)):
        for shift in (*_LEVEL_SHIFTS, *-_LEVEL_SHIFTS):
            better_plan = _with_shifted_level(task, plan, group, float(shift))
            if better_plan is not None:
                plan = better_plan
                break
    return plan


def _with_shifted_level(task: Task, plan: Plan, group: int, shift: float) -> Plan | None:
    """Return the plan with level number `group` of q2 shifted with its poses [rad]; None if that is no better.

    It is better if the criterion is lower, all poses can be measured, and no demanded direction of torques is lost.
    q3 keeps its value, or is shifted by the opposite angle, so that the forearm keeps its direction.
    """
    q2, members, demand = plan.q2.copy(), plan.level == group, task.directions
    q2[group] += shift
    is_in_range = task.site.lower[1] <= q2[group] <= task.site.upper[1]
    if not is_in_range or not _is_distant(np.delete(q2, group), q2[group]):
        return None
    criterion = task.criterion_at(q2)
    shortfall = demand.missing_count(task.loaded_sides(plan.q, plan.tilt).sum(axis=0))
    for q3_shift in (0.0, -shift):
        q = plan.q.copy()
        q[members, 1] = q2[group]
        q[members, 2] += q3_shift
        value = criterion.value(task.readings.information(q, plan.tilt), plan.level)
        if value >= plan.value * (1.0 - _LEAST_RELATIVE_GAIN):
            continue
        has_directions = demand.missing_count(task.loaded_sides(q, plan.tilt).sum(axis=0)) <= shortfall
        if has_directions and constraints.are_feasible(task.site, q[members], plan.tilt[members]).all():
            return replace(plan, q=q, q2=q2, value=value)
    return None


RANDOM_PLANS = 200
"""Random plans that a plan is compared with in its page (assumed)."""
_RANDOM_PLAN_STREAM = 1 << 20
"""Stream of the random numbers of these plans: the search does not use it."""
_BEST_SHARE = 0.2
"""Share of the poses of a level with the largest dexterity, of which poses far from each other are taken (assumed)."""
SIZE_FACTORS = (0.4, 0.6, 0.8, 1.0, 1.4, 2.0)
"""Numbers of configurations that are tried, as factors of the one asked for."""


def random_values(task: Task, seed: int, count: int = RANDOM_PLANS) -> Array:
    """Return the criterion (count,) [m²] of plans with random candidates at random levels."""
    rng = np.random.default_rng([seed, _RANDOM_PLAN_STREAM])
    candidates, values = task.candidates, np.empty(count)
    for index in range(count):
        row = first_levels(task, rng, spread=False)
        level = task.pose_levels(rng)
        pick = rng.integers(0, candidates.q.shape[1], task.count)
        values[index] = task.criterion_at(candidates.q2[row]).value(candidates.information[row[level], pick], level)
    return values


def serial_plan(task: Task) -> Plan:
    """Return the semi-intuitive plan of the serial approach: poses chosen by a kinematic performance measure.

    After Dumas et al. 2011 as quoted in the paper. Levels of q2 are evenly spaced. The poses of a level are from the
    fifth of the candidates with the best conditioned Jacobian, far from each other in joint space.
    """
    candidates = task.candidates
    row = first_levels(task, np.random.default_rng(0), spread=True)
    level = task.pose_levels(np.random.default_rng(0))
    pick = np.zeros(task.count, dtype=np.int64)
    for group in range(task.levels):
        members = np.flatnonzero(level == group)
        level_q = candidates.q[row[group]]
        dexterity = _dexterity(task, level_q)
        count = max(len(members), int(_BEST_SHARE * len(dexterity)))
        best_rows = np.argsort(-dexterity, kind="stable")[:count]
        pick[members] = _distant_rows(level_q, best_rows, len(members))
    index = row[level], pick
    value = task.criterion_at(candidates.q2[row]).value(candidates.information[index], level)
    return Plan(q=candidates.q[index], tilt=candidates.tilt[index], level=level, q2=candidates.q2[row], value=value)


def _dexterity(task: Task, q: Array) -> Array:
    """Return the reciprocal condition number (C,) of the Jacobian of the load point at configurations q (C, 6) [rad].

    Lengths are divided by the characteristic length, their RMS over all configurations (Angeles and López-Cajún 1992).
    """
    arm_pose = task.site.arm.pose(q)
    linear = arm_pose.velocity(arm_pose.point(task.site.load_point[None]))[:, 0]
    length = np.sqrt(np.mean(linear**2)) * np.sqrt(3.0)  # RMS of vectors of three components
    jacobian = np.concatenate([linear / length, arm_pose.axis], axis=2)
    singular = np.linalg.svd(jacobian, compute_uv=False)
    return np.asarray(singular[:, -1] / singular[:, 0])


def _distant_rows(q: Array, rows: Ints, count: int) -> list[int]:
    """Return `count` of some rows with joint angles far from each other: each is the farthest from the rows before.

    :param q: (C, 6) joint angles [rad].
    :param rows: rows of q to choose from, `count` or more; the first is always chosen.
    """
    selection = [int(rows[0])]
    while len(selection) < count:
        distance = np.linalg.norm(q[rows][:, None] - q[selection][None], axis=2).min(axis=1)
        distance[np.isin(rows, selection)] = -1.0  # never chosen again
        selection.append(int(rows[np.argmax(distance)]))
    return selection


class SizeResult(NamedTuple):
    """Result for a number of poses.

    :param configurations: number of poses.
    :param value: criterion of the best plan of this size [m²].
    :param random: median of the criterion of random plans of this size [m²].
    """

    configurations: int
    value: float
    random: float


def criterion_by_number(task: Task, seed: int, best: Plan) -> Iterator[SizeResult]:
    """Yield the results of some numbers of poses, ascending.

    The search is short: criteria are right to some per cent.

    :param best: best plan with the number of poses of the task, which is not searched again.
    """
    min_count = 1 if task.fixed_count else task.levels
    for count in sorted({max(min_count, round(factor * task.count)) for factor in SIZE_FACTORS}):
        resized_task = replace(task, count=count)
        value = best.value
        if count != task.count:
            for plan in improve(resized_task, seed, starts=2, finalists=1, rounds=8):
                value = plan.value  # of the last plan, the best
        yield SizeResult(count, value, float(np.median(random_values(resized_task, seed, 60))))
