"""The two paths between targets: both at the same share of the way from one pair to the next."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import toolpath
from postproc.chunks import in_chunks
from postproc.frames import Array, norm, twist_between
from postproc.program import CIRC, PTP, Bools, Ints, Program
from postproc.toolpath import Segments

SAME_FRAME = 1e-6
"""Frames that differ by less [m, rad] are the same."""
_SAMPLES, _ROUNDS = 9, 4
"""Where arcs are farthest apart is looked for at so many places, and so often, each time beside the best one."""
_NOTHING = 1e-12


class Chain(Struct, frozen=True, eq=False):
    """The motions of a program from its first to its last pair, by their share of the way: pair k stands at u = k.

    :param program: the program; `path` its geometry.
    :param row: (m,) its motions, in order.
    :param begin: (m,) u where each begins, `end` (m,) where it ends.
    """

    program: Program
    path: Segments
    row: Ints
    begin: Array
    end: Array

    @classmethod
    def of(cls, program: Program, path: Segments, paired: Ints) -> Chain:
        """Return the chain between the motions that pairs (P,) end."""
        row = np.arange(paired[0] + 1, paired[-1] + 1)
        pair = np.searchsorted(paired, row)
        along = np.concatenate([[0.0], np.cumsum(path.length[row])])
        at_pair = paired - paired[0]
        before = along[at_pair[pair - 1]]
        whole = along[at_pair[pair]] - before
        ordinal = (row - paired[pair - 1]) / (paired[pair] - paired[pair - 1])
        share = np.where(whole > _NOTHING, (along[1:] - before) / np.maximum(whole, _NOTHING), ordinal)
        end = np.where(row == paired[pair], pair, np.minimum(pair - 1 + share, pair))
        return cls(program, path, row, np.concatenate([[0.0], end[:-1]]), end)

    def at(self, u: Array) -> tuple[Ints, Array]:
        """Return the places (motion, t), each (n,), at shares u (n,) of the way, 0 < u <= P − 1."""
        index = np.minimum(np.searchsorted(self.end, u), len(self.end) - 1)
        width = np.maximum(self.end[index] - self.begin[index], _NOTHING)
        return self.row[index], np.clip((u - self.begin[index]) / width, 1e-9, 1.0)

    def any(self, wanted: Bools) -> Bools:
        """Return for each pair (P,) whether any of the motions (M,) between it and the one before is wanted."""
        out = np.zeros(int(self.end[-1]) + 1, dtype=bool)
        out[np.ceil(self.end[wanted[self.row]] - _NOTHING).astype(np.int64)] = True
        return out


class Curves(Struct, frozen=True, eq=False):
    """Both paths between pairs. Of a spline the chords of its pieces stand for it; where PTP goes is not known.

    :param one: of the nominal program, `other` of the second one.
    """

    one: Chain
    other: Chain

    @classmethod
    def of(cls, one: tuple[Program, Segments], other: tuple[Program, Segments], pair: Ints) -> Curves | None:
        """Return the curves of programs and their geometry between pairs (P, 2); None for less than two."""
        return cls(Chain.of(*one, pair[:, 0]), Chain.of(*other, pair[:, 1])) if len(pair) > 1 else None

    def at(self, u: Array) -> tuple[Array, Array]:
        """Return where the nominal tool is sent by both programs (n, 3) at shares u (n,), nominal `$BASE` [m]."""
        motion, t = self.one.at(u)
        row, share = self.other.at(u)
        nominal, second = self.one.program, self.other.program
        mine = toolpath.positions(nominal, self.one.path, motion, t)
        if self._same_tool:
            point = toolpath.positions(second, self.other.path, row, share)
            base = toolpath.base_of(second, row)
            point = np.einsum("...ij,...j->...i", base[..., :3, :3], point) + base[..., :3, 3]
            return mine, toolpath.points_in_base(nominal, motion, point, None)
        pose = toolpath.at(second, self.other.path, row, share).pose
        flange = toolpath.flange_from_tcp(second, row, pose, None)
        theirs = toolpath.pose_in_base(nominal, motion, flange @ toolpath.tool_of(nominal, motion), None)
        return mine, theirs[:, :3, 3]

    def apart(self) -> Array:
        """Return how far both are apart at most on the way to each pair from the one before (P,) [m].

        NaN for the first pair, and where a PTP is between: where it goes is not known.
        """
        out = np.full(int(self.one.end[-1]) + 1, np.nan)
        knots = np.unique(np.concatenate([[0.0], self.one.end, self.other.end]))
        knots = knots[np.diff(knots, prepend=-1.0) > _NOTHING]
        begin, end = knots[:-1], knots[1:]
        pair = np.ceil(end - _NOTHING).astype(np.int64)
        known = ~(self.one.any(self.one.program.motions.kind == PTP) | self.other.any(self._kind == PTP))
        largest = np.maximum(self._distance(begin + 1e-9 * (end - begin)), self._distance(end))
        curved = np.flatnonzero(known[pair] & self._curved(end))
        if len(curved):
            largest[curved] = np.maximum(largest[curved], in_chunks(self._largest, begin[curved], end[curved])[0])
        np.fmax.at(out, pair, largest)
        out[~known] = np.nan
        return out

    def parts(self, angle: float) -> Ints:
        """Return by how many chords (P,) the way to each pair is drawn, of arcs one for so much of an angle [rad]."""
        out = np.ones(int(self.one.end[-1]) + 1, dtype=np.int64)
        for chain in (self.one, self.other):
            arc = np.flatnonzero(chain.program.motions.kind[chain.row] == CIRC)
            turned = np.zeros(len(out))
            pair = np.ceil(chain.end[arc] - _NOTHING).astype(np.int64)
            np.add.at(turned, pair, chain.program.motions.sweep[chain.row[arc]])
            out = np.maximum(out, np.ceil(turned / angle).astype(np.int64))
        return out

    @property
    def _kind(self) -> Ints:
        return self.other.program.motions.kind

    @property
    def _same_tool(self) -> bool:
        tools = (self.one.program.tools, self.other.program.tools)
        return len(tools[0]) == len(tools[1]) == 1 and bool(np.abs(twist_between(*tools)).max() <= SAME_FRAME)

    def _curved(self, u: Array) -> Bools:
        """Return where (n,) the distance may be largest between the ends of a piece: not for two straight lines."""
        if not self._same_tool:
            return np.ones(len(u), dtype=bool)
        motion, row = self.one.at(u)[0], self.other.at(u)[0]
        return np.asarray((self.one.program.motions.kind[motion] == CIRC) | (self._kind[row] == CIRC))

    def _distance(self, u: Array) -> Array:
        one, other = self.at(u)
        return norm(other - one)

    def _largest(self, begin: Array, end: Array) -> tuple[Array]:
        """Return the largest distances (n,) between shares; the paths are smooth there."""
        best = np.zeros(len(begin))
        for _ in range(_ROUNDS):
            u = begin[:, None] + np.linspace(1e-9, 1.0, _SAMPLES) * (end - begin)[:, None]
            distance = self._distance(u.ravel()).reshape(u.shape)
            place = distance.argmax(axis=1)
            row = np.arange(len(u))
            best = np.maximum(best, distance[row, place])
            begin, end = u[row, np.maximum(place - 1, 0)], u[row, np.minimum(place + 1, _SAMPLES - 1)]
        return (best,)
