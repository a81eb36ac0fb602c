"""The order in which the poses are visited: least travel, and no straight run of the joints into anything."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from msgspec.structs import replace

from postproc.frames import RAD_PER_DEG, Array
from postproc.plan import constraints
from postproc.plan.site import Site
from postproc.program import Bools, Ints

_STEP = 4.0 * RAD_PER_DEG
_SHAPES = 400
_BLOCKED = 1e3
"""Added seconds of a move that would hit something."""


def travel_times(site: Site, q: Array) -> Array:
    """Return (n, n) seconds from each configuration (n, 6) to each other: PTP, the slowest joint decides."""
    return np.asarray((np.abs(q[:, None] - q[None]) / site.robot.speed).max(axis=2))


def free_moves(site: Site, q: Array) -> Bools:
    """Return (n, n) True where the joint interpolation between two configurations stays clear of everything."""
    count = len(q)
    first, last = np.triu_indices(count, 1)
    free = np.ones((count, count), dtype=bool)
    between, owner = [], []
    for pair, (a, b) in enumerate(zip(q[first], q[last], strict=True)):
        steps = int(np.ceil(np.abs(b - a).max() / _STEP))
        t = np.linspace(0.0, 1.0, steps + 1)[1:-1, None]
        between.append(a * (1.0 - t) + b * t)
        owner.append(np.full(len(t), pair))
    if between:
        places = np.concatenate(between)
        hit = np.zeros(len(first), dtype=bool)
        hit[np.concatenate(owner)[~constraints.passable(site, places)]] = True
        free[first, last] = free[last, first] = ~hit
    return free


def shortest(site: Site, q: Array) -> tuple[Ints, float, Ints]:
    """Return the order (n,) of least travel from where the robot starts, its seconds, and the blocked moves.

    Nearest neighbour, then 2-opt and or-opt until nothing improves (Croes 1958, Or 1976).

    :returns: order, seconds, and the places k in it where the move to order[k] would hit something.
    """
    every = np.vstack([site.start, q])
    seconds = travel_times(site, every)
    blocked = ~free_moves(site, every)
    cost = seconds + _BLOCKED * blocked
    tour = [0]
    while len(tour) < len(every):
        left = [node for node in range(len(every)) if node not in tour]
        tour.append(min(left, key=lambda node: (cost[tour[-1], node], node)))
    while True:
        better = _improved(tour, cost)
        if better is None:
            break
        tour = better
    order = np.array(tour[1:]) - 1
    steps = list(pairwise(tour))
    length = float(sum(seconds[a, b] for a, b in steps))
    return order, length, np.array([k for k, (a, b) in enumerate(steps) if blocked[a, b]], dtype=np.int64)


def _length(tour: list[int], cost: Array) -> float:
    return float(cost[tour[:-1], tour[1:]].sum())


def _improved(tour: list[int], cost: Array) -> list[int] | None:
    now = _length(tour, cost)
    for i in range(1, len(tour)):
        for j in range(i + 1, len(tour) + 1):
            turned = tour[:i] + tour[i:j][::-1] + tour[j:]
            if _length(turned, cost) < now - 1e-9:
                return turned
    for i in range(1, len(tour)):
        for size in (1, 2, 3):
            piece, rest = tour[i : i + size], tour[:i] + tour[i + size :]
            for j in range(1, len(rest) + 1):
                moved = rest[:j] + piece + rest[j:]
                if _length(moved, cost) < now - 1e-9:
                    return moved
    return None


def ways(site: Site, q: Array, hit: Ints) -> tuple[tuple[Array, ...], Ints]:
    """Return what the robot passes on its way to each pose, (k, 6) configurations, and the rows it cannot get to.

    A blocked move goes through the start position, or with the arm as there, or folded, turned by A1 to where it
    comes from and to where it goes.

    :param hit: rows whose direct way is blocked.
    """
    start = site.start
    passed = [np.zeros((0, 6)) for _ in q]
    blocked = []
    shapes = [start, folded(site)] if len(hit) else []
    for row in hit:
        here, there = start if row == 0 else q[row - 1], q[row]
        options = [start[None]]
        for shape in shapes:
            from_here, to_there = shape.copy(), shape.copy()
            from_here[0], to_there[0] = here[0], there[0]
            options += [to_there[None], from_here[None], np.array([from_here, to_there])]
        for between in options:
            stops = np.vstack([here, between, there])
            if constraints.passable(site, between).all() and np.diag(free_moves(site, stops), 1).all():
                passed[row] = between
                break
        else:
            blocked.append(int(row))
    return tuple(passed), np.array(blocked, dtype=np.int64)


def folded(site: Site) -> Array:
    """Return joint angles (6,) [rad] with the smallest horizontal reach of arm and tool, A1 = 0, among random ones."""
    rng = np.random.default_rng(0)
    q = rng.uniform(np.maximum(site.lower, -np.pi), np.minimum(site.upper, np.pi), (_SHAPES, 6))
    q[:, 0] = np.clip(0.0, site.lower[0], site.upper[0])
    posed = site.arm.pose(q)
    places = np.concatenate([posed.origin, posed.point(np.vstack([site.load_point, site.points]))], axis=1)
    reach = np.linalg.norm(places[..., :2], axis=2).max(axis=1)
    alone = replace(site, obstacles=())
    return np.asarray(q[np.argmin(np.where(constraints.passable(alone, q), reach, np.inf))])
