"""Where on the path to compute: as few places as the tolerance allows.

Deflection changes along a run over lengths of the order of the arm, so that samples every 20 mm and 3° catch its
curvature to a fraction of 0.01 mm. An arc is written in pieces, each a circle through three corrected points; how many
it takes depends on how the displacement by the force turns and grows along it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from postproc.frames import RAD_PER_DEG, Array, norm
from postproc.program import CIRC, PTP, Bools, Ints, Program
from postproc.toolpath.path import Segments

_STEP = 0.020
"""Spacing of samples [m] for a tolerance of 0.01 mm; it grows with the root of the tolerance (a chord's sagitta)."""
_REFERENCE_TOLERANCE = 1e-5
_TURN = 3.0 * RAD_PER_DEG
_LARGEST = 120.0 * RAD_PER_DEG
"""Pieces of arcs turn by at most this angle: three points then define the circle well."""
_MEASURED = 45.0 * RAD_PER_DEG
"""Pieces at most this large tell how many are needed: what they miss goes with the square of their angle."""
_TURNING, _GROWING = 0.2, 0.13
"""A circle through three points of an arc misses displacements that turn with the arc by the first times the square of
its angle [1/rad²], and those that grow along it by the second times its angle [1/rad] (found by trying: of their
size)."""
_ARM = 1.0
"""Length [m] over which the deflection changes by its own size."""
_CERTAIN = 0.2
"""Of the tolerance, what a piece may miss by this estimate without being measured."""


@dataclass(frozen=True, slots=True, eq=False)
class Swing:
    """How the displacement of the tool by its force changes along M motions: roughly, to tell where to look.

    :param ramp_end: (M,) place t where the force stops growing; 1 where it changes nowhere or all along.
    :param ramp: (M,) how much the displacement changes until there [m].
    :param turning: (M,) how large the displacement is that turns with the direction of travel [m].
    :param size: (M,) how large the displacement is [m].
    :param round: (M,) True for arcs that come near the direction of the spindle, where a FEED force swings round.
    """

    ramp_end: Array
    ramp: Array
    turning: Array
    size: Array
    round: Bools


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Into how many equal pieces arcs are divided: S stretches of arcs, before and behind the end of a force ramp, and
    wherever more of them are needed than elsewhere.

    :param motion: (S,) row of `Motions`, never decreasing.
    :param begin: (S,) place t where the stretch begins, in order along a motion.
    :param end: (S,) place t where it ends.
    :param number: (S,) of pieces.
    :param least: (S,) the least number, whatever the force.
    :param samples: (S,) how many samples the stretch needs, whatever the pieces.
    :param uncertain: (S,) True where the number is even and yet to be found by what such pieces miss.
    """

    motion: Ints
    begin: Array
    end: Array
    number: Ints
    least: Ints
    samples: Array
    uncertain: Bools

    @property
    def each(self) -> Ints:
        """(S,) samples on each piece: an even number, so that its middle is one."""
        return 2 * np.maximum(1, np.ceil(self.samples / (2 * self.number) - 1e-9).astype(np.int64))

    def settled(self, number: Ints) -> Pieces:
        """Return the stretches with numbers (S,) that are known to be enough, as far as can be told."""
        return replace(self, number=np.maximum(number, self.least), uncertain=np.zeros(len(self.motion), dtype=bool))

    def take(self, rows: Ints | Bools) -> Pieces:
        """Return some of the stretches."""
        return Pieces(*(getattr(self, field.name)[rows] for field in fields(self)))

    def joined(self, *others: Pieces) -> Pieces:
        """Return these stretches and others, in order along the path."""
        every = (self, *others)
        out = Pieces(*(np.concatenate([getattr(one, field.name) for one in every]) for field in fields(self)))
        return out.take(np.lexsort((out.begin, out.motion)))

    def cut(self, parts: Ints) -> Pieces:
        """Return the stretches cut into equal parts (S,): by their number of pieces each piece is a stretch."""
        out = self.take(np.repeat(np.arange(len(parts)), parts))
        inside = np.arange(len(out.motion)) - np.repeat(np.cumsum(parts) - parts, parts)
        parts = np.repeat(parts, parts)
        begin = out.begin + (out.end - out.begin) * (inside / parts)
        end = np.where(inside == parts - 1, out.end, np.append(begin[1:], 1.0))
        number, least = -(-out.number // parts), -(-out.least // parts)
        return Pieces(out.motion, begin, end, number, least, out.samples / parts, out.uncertain)

    def finer(self, motion: Ints, t: Array, parts: Ints) -> Pieces:
        """Return the stretches with the pieces divided on which the path was missed.

        :param motion: (n,) and t (n,): where it was missed.
        :param parts: (n,) into how many the piece there is to be divided.
        """
        hit = np.zeros(len(self.motion), dtype=bool)
        hit[self._at(motion, t)] = True
        out = self.cut(np.where(hit, self.number, 1))
        number = out.number.copy()
        np.maximum.at(number, out._at(motion, t), parts)
        return out.settled(number)

    def _at(self, motion: Ints, t: Array) -> Ints:
        """Return the stretches (n,) on which places lie."""
        return np.searchsorted(self.motion + self.begin, motion + t) - 1


def pieces(program: Program, path: Segments, tolerance: float, swing: Swing, *, linearize_arcs: bool = False) -> Pieces:
    """Return how many pieces of its arcs to begin with.

    :param tolerance: what the path may be left by [m].
    :param linearize_arcs: pieces are chords that keep half the tolerance.
    """
    arcs = path.arcs
    noticed = swing.ramp[arcs.motion] > 0.1 * tolerance
    ramp_end = np.where(noticed, swing.ramp_end[arcs.motion], 1.0)
    bent = np.flatnonzero(ramp_end < 1.0)
    arc = np.concatenate([np.arange(len(arcs.motion)), bent])
    begin = np.concatenate([np.zeros(len(arcs.motion)), ramp_end[bent]])
    end = np.concatenate([ramp_end, np.ones(len(bent))])
    order = np.lexsort((begin, arc))
    arc, begin, end = arc[order], begin[order], end[order]
    motion = arcs.motion[arc]

    share = end - begin
    angle, radius = arcs.sweep[arc] * share, norm(arcs.radial)[arc]
    step = _STEP * np.sqrt(tolerance / _REFERENCE_TOLERANCE)
    samples = share * np.maximum(path.length[motion] / step, path.turn[motion] / _TURN)
    if linearize_arcs:
        samples = np.maximum(samples, angle * np.sqrt(radius / tolerance) / 2.0)
    least = np.maximum(1, np.ceil(angle / _LARGEST - 1e-9).astype(np.int64))
    turning = swing.turning[motion] + swing.size[motion] * radius / _ARM
    growing = np.where(noticed[arc] & (begin == 0.0), swing.ramp[motion], 0.0)
    growing += share * (
        norm(arcs.climb)[arc] + np.abs(arcs.growth[arc]) * radius + swing.size[motion] * path.turn[motion]
    )
    missed = (_TURNING * angle**2 * turning + _GROWING * angle * growing) / least**2
    uncertain = (missed > _CERTAIN * tolerance) & (not linearize_arcs)
    measured = 2 * np.ceil(np.maximum(angle / _MEASURED, least) / 2.0 - 1e-9).astype(np.int64)
    return Pieces(motion, begin, end, np.where(uncertain, measured, least), least, samples, uncertain)


def places(
    program: Program,
    path: Segments,
    tolerance: float,
    swing: Swing,
    arcs: Pieces,
    also: tuple[Ints, Array] | None = None,
) -> tuple[Ints, Array]:
    """Choose where on the path to compute: every end, middle and end of each piece of an arc, enough places between.

    :param tolerance: what the path may be left by [m].
    :param also: further places of straight motions: motion (n,) and t (n,).
    :returns: motion (N,) and t (N,), in order.
    """
    m = program.motions
    step = _STEP * np.sqrt(tolerance / _REFERENCE_TOLERANCE)
    count = np.ceil(np.maximum(path.length / step, path.turn / _TURN) - 1e-9)
    count[m.kind == PTP] = 1.0
    straight = np.flatnonzero(m.kind != CIRC)
    motion, t = _even(straight, np.maximum(count[straight], 1.0).astype(np.int64))
    bent = straight[swing.ramp_end[straight] < 1.0]
    more = [(bent, swing.ramp_end[bent]), *([also] if also is not None else [])]
    if len(arcs.motion):
        stretch, share = _even(np.arange(len(arcs.motion)), arcs.number * arcs.each)
        begin, end = arcs.begin[stretch], arcs.end[stretch]
        more.append((arcs.motion[stretch], np.where(share == 1.0, end, begin + (end - begin) * share)))
    if any(len(rows) for rows, _ in more):
        motion = np.concatenate([motion, *(rows for rows, _ in more)])
        t = np.concatenate([t, *(places for _, places in more)])
        order = np.lexsort((t, motion))
        motion, t = motion[order], t[order]
        again = np.flatnonzero((np.diff(motion) == 0) & (np.diff(t) < 1e-9))
        motion, t = np.delete(motion, again), np.delete(t, again)
    return motion, t


def _even(rows: Ints, number: Ints) -> tuple[Ints, Array]:
    """Return each row as often as its number says, and places in even distances up to 1."""
    which = np.repeat(np.arange(len(rows)), number)
    index = np.arange(len(which)) - np.repeat(np.cumsum(number) - number, number) + 1
    return rows[which], index / number[which]
