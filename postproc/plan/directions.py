"""Directions of joint torques: each joint is to be loaded to both sides, as far as the rig can and near the work.

Gears with lost motion, friction or a preload deflect otherwise to the other side. The criterion knows linear springs
alone and does not see that, so the directions are a condition on the plan.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.identification.coverage import ENOUGH, LEAST_TORQUE, SIGNS, signed
from postproc.plan.milling import TestPoses
from postproc.program import Bools, Ints
from postproc.robot import JOINTS

_OF_POSES = 3
"""At least one of this many poses must load a joint to a side; from `ENOUGH` poses on a direction is covered."""
_TYPICAL = 0.95
_RARE = 0.01
"""Share of poses below which a direction counts as out of reach."""
_SMALLEST, _LARGEST = 0.1, 0.5
"""Limits of the torque from which on a pose counts, over what poses that can be measured typically reach."""


class Directions(Struct, frozen=True, eq=False):
    """Number of poses that are to load each joint to each side (column 0 negative, 1 positive).

    :param need: (6, 2) number of poses, without those measured already; 0 where the rig cannot.
    :param least: (6, 2) torque from which on a pose counts [N·m].
    :param reached: (6, 2) typical largest torque of poses that can be measured; 0 where too few reach any [N·m].
    :param work: (6, 2) typical largest torque of the work [N·m].
    """

    need: Ints
    least: Array
    reached: Array
    work: Array

    def counted(self, torque: Array) -> Bools:
        """Return which sides (..., 6, 2) poses with torques (..., 6) [N·m] load."""
        return np.asarray(signed(torque) >= self.least)

    def missing(self, count: Ints) -> Ints:
        """Return how many poses lack (...), summed over joints and sides, for numbers of poses (..., 6, 2)."""
        return np.asarray(np.maximum(self.need - count, 0).sum(axis=(-2, -1)))


def directions(torque: Array, tests: TestPoses, poses: int, measured: Array | None = None) -> Directions:
    """Return the directions to load.

    :param torque: (N, 6) of many poses that can be measured [N·m].
    :param tests: the work.
    :param poses: number of poses of the plan.
    :param measured: (m, 6) torques of configurations measured already [N·m].
    """
    sides = signed(torque)
    reached = _typical(sides, np.full(len(torque), 1.0 / max(len(torque), 1)))
    work = _typical(signed(tests.torque), tests.weight)
    least = np.clip(work, _SMALLEST * reached, _LARGEST * reached)
    before = np.zeros((0, 6)) if measured is None else measured
    need = np.where(reached > 0.0, min(ENOUGH, (poses + len(before)) // _OF_POSES), 0)
    empty = Directions(need, np.maximum(least, LEAST_TORQUE), reached, work)
    left = np.maximum(need - empty.counted(before).sum(axis=0), 0)
    return Directions(left, empty.least, reached, work)


def _typical(sides: Array, weight: Array) -> Array:
    """Return the weighted 95 % quantile (6, 2) of the torques on each side that are any; 0 where fewer than 1 % are."""
    out = np.zeros((6, 2))
    for joint, side in np.ndindex(6, 2):
        values = sides[:, joint, side]
        rows = np.flatnonzero(values > LEAST_TORQUE)
        if weight[rows].sum() > _RARE:
            rows = rows[np.argsort(values[rows])]
            share = np.cumsum(weight[rows]) / weight[rows].sum()
            out[joint, side] = values[rows[np.searchsorted(share, _TYPICAL)]]
    return out


def out_of_reach(found: Directions, vertical: bool) -> tuple[str, ...]:
    """Return a sentence on the joints whose torque the rig cannot turn to one side or the other; none if it can.

    :param vertical: whether every load hangs vertically.
    """
    parts = []
    for joint, name in enumerate(JOINTS):
        missing = [sign for side, sign in enumerate(SIGNS) if found.reached[joint, side] == 0.0]
        work = [f"{found.work[joint, side]:.0f} N·m {sign}" for side, sign in enumerate(SIGNS) if sign in missing]
        worked = [text for text, sign in zip(work, missing, strict=True) if found.work[joint, SIGNS.index(sign)] > 0.0]
        if missing:
            note = f"; the work has up to {' and '.join(worked)}" if worked else ""
            parts.append(f"{name} ({' and '.join(missing)}{note})")
    if not parts:
        return ()
    advice = "another load point, or [rig] max_angle_deg if a pulley can turn the pull, may reach it"
    if not vertical:
        advice = "another load point or a larger [rig] max_angle_deg may reach it"
    return (
        f"with this rig the load cannot turn the torque on {', '.join(parts)}: lost motion to that side stays unknown, "
        f"and `identify validate` covers no job that needs it; {advice}",
    )
