"""What a plan is compared with: plans at random, the semi-intuitive plan of the serial approach, other sizes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from msgspec.structs import replace

from postproc.frames import Array
from postproc.plan.search import Plan, Task, first_levels, improved
from postproc.program import Ints

RANDOM_PLANS = 200
_BEST_SHARE = 0.2
_FACTORS = (0.4, 0.6, 0.8, 1.0, 1.4, 2.0)


def random_values(task: Task, seed: int, count: int = RANDOM_PLANS) -> Array:
    """Return the criterion (count,) [m²] of plans whose levels, poses and loads are random but can be measured."""
    rng = np.random.default_rng([seed, 1 << 20])
    candidates, out = task.candidates, np.empty(count)
    for index in range(count):
        row = first_levels(task, rng, spread=False)
        level = task.group_of_each(rng)
        pick = rng.integers(0, candidates.q.shape[1], task.count)
        out[index] = task.criterion_at(candidates.q2[row]).value(candidates.information[row[level], pick], level)
    return out


def serial_plan(task: Task) -> Plan:
    """Return the semi-intuitive plan of the serial approach: poses chosen by a kinematic performance measure.

    After Dumas et al. 2011 as quoted in the paper: evenly spaced levels of q2; on each, of the fifth of poses in which
    the Jacobian is best conditioned (lengths over the characteristic one), those farthest apart in joint space.
    """
    candidates = task.candidates
    row = first_levels(task, np.random.default_rng(0), spread=True)
    level = task.group_of_each(np.random.default_rng(0))
    pick = np.zeros(task.count, dtype=np.int64)
    for group in range(task.levels):
        members = np.flatnonzero(level == group)
        dexterity = _dexterity(task, candidates.q[row[group]])
        count = max(len(members), int(_BEST_SHARE * len(dexterity)))
        pick[members] = _far_apart(
            candidates.q[row[group]], np.argsort(-dexterity, kind="stable")[:count], len(members)
        )
    value = task.criterion_at(candidates.q2[row]).value(candidates.information[row[level], pick], level)
    return Plan(candidates.q[row[level], pick], candidates.tilt[row[level], pick], level, candidates.q2[row], value)


def _dexterity(task: Task, q: Array) -> Array:
    """Return 1/condition (C,) of the Jacobian of the load point, lengths over their mean (Angeles and López-Cajún)."""
    posed = task.site.arm.pose(q)
    linear = posed.velocity(posed.point(task.site.load_point[None]))[:, 0]
    length = np.sqrt(np.mean(linear**2)) * np.sqrt(3.0)
    jacobian = np.concatenate([linear / length, posed.axis], axis=2)
    singular = np.linalg.svd(jacobian, compute_uv=False)
    return np.asarray(singular[:, -1] / singular[:, 0])


def _far_apart(q: Array, rows: Ints, count: int) -> list[int]:
    chosen = [int(rows[0])]
    while len(chosen) < count:
        distance = np.linalg.norm(q[rows][:, None] - q[chosen][None], axis=2).min(axis=1)
        distance[np.isin(rows, chosen)] = -1.0
        chosen.append(int(rows[np.argmax(distance)]))
    return chosen


def by_number(task: Task, seed: int, best: Plan) -> Iterator[tuple[int, float, float]]:
    """Yield (number of poses, criterion of the best plan found, median of random plans) [m²] for several sizes.

    A short search: good to some per cent. The size of the plan itself takes its own value.
    """
    least = 1 if task.fixed else task.levels
    for count in sorted({max(least, round(factor * task.count)) for factor in _FACTORS}):
        other = replace(task, count=count)
        value = best.value
        if count != task.count:
            for plan in improved(other, seed, starts=2, kept=1, rounds=8):
                value = plan.value
        yield count, value, float(np.median(random_values(other, seed, 60)))
