"""Candidates: poses that can be measured, level by level of q2, from which the search chooses.

Every one satisfies all constraints. Poses are drawn at random: joints uniform within their limits, loads
uniform over the directions that the rig allows.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.errors import PlanError
from postproc.frames import Array
from postproc.plan import constraints
from postproc.plan.sensitivity import Readings, direction
from postproc.plan.site import Site

_GRID = 24
_PER_LEVEL = 100
_ROUND = 400
_ROUNDS = 40
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

    def only(self, keep: tuple[int, ...]) -> Candidates:
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
        good = constraints.feasible(site, q, tilt)
        found_q.append(q[good])
        found_tilt.append(tilt[good])
        have += int(good.sum())
        if have >= count or (have == 0 and len(found_q) >= _ROUNDS // 4):
            break
    return np.concatenate(found_q)[:count], np.concatenate(found_tilt)[:count]


def draw_candidates(site: Site, readings: Readings, rng: np.random.Generator, fixed: Array | None = None) -> Candidates:
    """Draw candidates on a grid of levels over the range of q2, and at `fixed` levels (first among them).

    :param readings: with all six compliances.

    :raises PlanError: no pose can be measured; the message says which constraints block.
    """
    lower, upper = site.lower[1], site.upper[1]
    levels = np.concatenate([np.zeros(0) if fixed is None else fixed, np.linspace(lower, upper, _GRID)])
    drawn = [feasible_at(site, float(level), _PER_LEVEL, rng) for level in levels]
    enough = np.array([len(q) >= _PER_LEVEL // 10 for q, _ in drawn])
    if not enough.any():
        raise PlanError(*blocking(site, rng))
    known = 0 if fixed is None else len(fixed)
    kept = [index for index in range(len(levels)) if enough[index] or index < known]
    q, tilt = np.zeros((len(kept), _PER_LEVEL, 6)), np.zeros((len(kept), _PER_LEVEL, 2))
    real = np.zeros((len(kept), _PER_LEVEL), dtype=bool)
    for place, index in enumerate(kept):
        found_q, found_tilt = drawn[index]
        if len(found_q):
            row = np.arange(_PER_LEVEL) % len(found_q)  # repeated where there are fewer
            q[place], tilt[place], real[place] = found_q[row], found_tilt[row], True
    information = readings.information(q.reshape(-1, 6), tilt.reshape(-1, 2)).reshape(*q.shape[:2], 6, 6)
    information *= real[:, :, None, None]  # no information from a level at which nothing can be measured any more
    load = readings.force * direction(tilt.reshape(-1, 2))
    torque = readings.torque(q.reshape(-1, 6), load).reshape(*q.shape[:2], 6) * real[:, :, None]
    return Candidates(levels[kept], q, tilt, information, torque)


def blocking(site: Site, rng: np.random.Generator) -> tuple[str]:
    """Say which constraints leave no pose: what each forbids alone, and how many poses there are without it."""
    q, tilt = draw(site, _LOOK, rng)
    found = constraints.failures(site, q, tilt)
    count = sum(found.values(), np.zeros(_LOOK, dtype=int))
    lines = []
    for name, forbidden in sorted(found.items(), key=lambda entry: -entry[1].mean()):
        without = int(np.count_nonzero((count == 1) & forbidden))
        if forbidden.any():
            note = f", without it {without} poses were possible" if without else ""
            lines.append((without, forbidden.mean(), f"{name} forbids {100 * forbidden.mean():.1f} %{note}"))
    alone = [line for line in lines if line[1] > 0.999]
    freeing = sorted((line for line in lines if line[0]), reverse=True)
    culprit = (freeing or alone or lines)[0][2].split(" forbids")[0]
    shown = "; ".join(text for _, _, text in lines[:6])
    return (f"no pose can be measured: what blocks is: {culprit}. Of {_LOOK} poses at random: {shown}",)
