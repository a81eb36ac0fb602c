"""Bodies that do not cut against the stock that remains at that time, and against parts that the cell states.

The stock before a motion holds all that is there while the motion runs, and the stock before a group of motions all
that is there during any of them. So a path is compared with the stock at its beginning, and divided only where that is
not enough. The cylinders of the tool were compared while the stock was swept, on motions along which the tool does not
turn; here they are compared on the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import collision
from postproc.collision import Body, Scene, Solids
from postproc.forces import StockInTime
from postproc.frames import Array
from postproc.program import Bools, Ints

STOCK = "stock"
_MOST = 200
"""Stocks of one group of bodies that are compared; pairs not decided by then count as too close."""


class States(Struct, frozen=True, eq=False):
    """States of the robot at N samples of a path with one tool, and before them.

    :param motion: (N,) row of `Motions`.
    :param q: (N + 1, 6) joint angles [rad]; the first row is before the first sample.
    :param commanded: (N + 1, 6) those that the arm may have instead [rad], see `collision.along`.
    :param shift: (N + 1, 3) how far E1 carries the robot [m]; None if nothing carries it.
    """

    motion: Ints
    q: Array
    commanded: Array | None
    shift: Array | None

    def part(self, low: int, high: int) -> States:
        """Return the samples from `low` to `high` (exclusive)."""
        part = slice(low, high + 1)
        commanded, shift = (None if each is None else each[part] for each in (self.commanded, self.shift))
        return States(self.motion[low:high], self.q[part], commanded, shift)


class Contact(Struct, frozen=True):
    """Two bodies that come closer than allowed on a motion; `distance` and `need` [m]."""

    names: tuple[str, str]
    motion: int
    distance: float
    need: float


def with_stock(scene: Scene, states: States, stock: StockInTime, need: float) -> Iterator[Contact]:
    """Yield where arm, meshes of the tool, and on motions that turn it all of it come too close to the stock.

    :param need: smallest allowed distance [m]; the cutter must not touch.
    """
    moving = [body for body in scene.bodies if not body.fixed]
    others = [body for body in moving if body.of == "arm" or (body.of == "tool" and body.kind == "mesh")]
    held = [body for body in moving if body.of == "tool" and body.kind != "mesh"]
    cutters = [collision.inside(body) for body in moving if body.of == "cutter"]
    everywhere = np.ones(len(states.motion), dtype=bool)
    turning = ~stock.compared[states.motion]
    nominal = replace(states, commanded=None)
    for bodies, own, own_need, rows in (
        (others, states, need, everywhere),
        (held, states, need, turning),
        (cutters, nominal, 0.0, turning),
    ):
        if bodies and rows.any():
            yield from _Search(scene, bodies, own, stock, own_need).over(rows)


def with_parts(scene: Scene, states: States, rapid: Bools) -> Iterator[Contact]:
    """Yield where the cutter goes into a part of [collision] on rapid moves, on which the tool is on its nominal path.

    :param rapid: (N,) samples on rapid moves along which the tool does not just leave its cut.
    """
    parts = [body for body in scene.bodies if body.of == "part"]
    cutters = [collision.inside(body) for body in scene.bodies if body.of == "cutter"]
    if parts and cutters and rapid.any():
        solids = _solids(scene, cutters, parts)
        for low, high in _runs(rapid):
            yield from _contacts(solids, replace(states.part(low, high), commanded=None), 0.0)


class _Search:
    """The search of bodies along a path, with the stock of the time."""

    def __init__(self, scene: Scene, bodies: Sequence[Body], states: States, stock: StockInTime, need: float) -> None:
        self.states, self.stock, self.need = states, stock, need
        self.solids: Solids | None = None
        self.scene, self.bodies, self.compared = scene, bodies, 0

    def over(self, rows: Bools) -> Iterator[Contact]:
        """Yield what comes too close at, or before, samples (N,)."""
        motion = self.states.motion
        left = rows
        while left.any():
            first = int(motion[np.argmax(left)])
            found = self._at(first, left)
            now = [each for each in found if each.motion == first or self.compared >= _MOST]
            yield from now
            later = np.unique([each.motion for each in found if each.motion != first])
            if self.compared >= _MOST or not len(later):
                return
            # the stock of `first` is an upper bound for what follows: only motions that are too close to it are open,
            # the first half of them by the stock before them, the others by that in their middle
            middle = int(later[len(later) // 2])
            open_ = left & np.isin(motion, later)
            yield from self.over(open_ & (motion < middle))
            left = open_ & (motion >= middle)

    def _at(self, motion: int, rows: Bools) -> list[Contact]:
        """Return what comes too close to the stock before a motion at, or before, samples (N,)."""
        points, faces = self.stock.mesh(motion)
        self.compared += 1
        if not len(points):
            return []
        body = Body(STOCK, -1, "obstacle", "mesh", (), np.eye(4), points, faces)
        self.solids = _solids(self.scene, self.bodies, [body]) if self.solids is None else self.solids.with_last(body)
        solids = self.solids
        return [each for low, high in _runs(rows) for each in _contacts(solids, self.states.part(low, high), self.need)]


def _solids(scene: Scene, moving: Sequence[Body], fixed: Sequence[Body]) -> Solids:
    pairs = [(i, len(moving) + j) for i in range(len(moving)) for j in range(len(fixed)) if moving[i].carrier >= 0]
    return Solids(Scene(scene.robot, (*moving, *fixed)), pairs)


def _contacts(solids: Solids, states: States, need: float) -> Iterator[Contact]:
    found = collision.among(solids, states.q, need, states.shift, states.commanded)
    before = np.append(states.motion[:1], states.motion)
    for row, first, second, distance in zip(found.row, found.first, found.second, found.distance, strict=True):
        names = solids.bodies[int(first)].name, solids.bodies[int(second)].name
        yield Contact(names, int(before[row]), float(distance), need)


def _runs(rows: Bools) -> Iterator[tuple[int, int]]:
    """Yield first and last (exclusive) of the runs of samples (N,)."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]])))
    yield from zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True)
