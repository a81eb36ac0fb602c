"""Where on the path to compute: as few places as the tolerance allows.

A place is a motion and t along it, 0 at its start, 1 at its end. Deflection changes along the path over lengths of the
order of the arm, so that samples every 20 mm and 3° catch its curvature to a fraction of 0.01 mm. An arc is written in
pieces, each a circle through three corrected points; how many it takes depends on how the displacement by the force
turns and grows along it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc.chunks import Columns, ragged_range
from postproc.frames import RAD_PER_DEG, Array, angle_between, interpolate, norm
from postproc.program import CIRC, LIN, PTP, SPL, Bools, Ints, Program
from postproc.toolpath.path import Segments

_STEP = 0.020
"""Spacing of samples [m] for a tolerance of 0.01 mm; it grows with the root of the tolerance (a chord's sagitta)."""
_REFERENCE_TOLERANCE = 1e-5
"""Tolerance [m] that `_STEP` is for."""
_SAMPLE_ROTATION = 3.0 * RAD_PER_DEG
"""Largest rotation of the tool between samples (assumed)."""
_LEVER = 0.1
"""Length of tool [m] over which an error of its orientation must stay within the tolerance (assumed)."""
_MOST_SWIVEL = 60.0 * RAD_PER_DEG
"""Largest turn of rotary axes on one piece: the two rotations between its ends are then distinct (assumed)."""
_LARGEST_ANGLE = 120.0 * RAD_PER_DEG
"""Largest angle of a piece of an arc: three points then define the circle well (assumed)."""
_COARSE_ANGLE = 45.0 * RAD_PER_DEG
"""Pieces at most this large show how many are needed: their error grows with the square of their angle."""
_TURNING_ERROR, _GROWING_ERROR = 0.2, 0.13
"""A circle through three points of an arc misses displacements that turn with the arc by the first times the square of
its angle [1/rad²], and those that grow along it by the second times its angle [1/rad] (found by trying: of their
size)."""
_DEFLECTION_LENGTH = 1.0
"""Length [m] over which the deflection changes by its own size: about that of an arm (assumed)."""
_LEAST_CHANGE_SHARE = 0.1
"""Share of the tolerance by which the displacement must change along an arc that is divided at bends of the force
(assumed)."""
_ACCEPTED_SHARE = 0.2
"""Share of the tolerance up to which the estimated error of a piece is accepted without being measured (assumed)."""
_SAME_PLACE = 1e-9
"""Places t on a motion that differ by less are one place: the difference is rounding."""
_ROUNDING = 1e-9
"""Subtracted before a number of parts is rounded up: a whole number but for rounding remains as it is."""


_Row = TypeVar("_Row", bound=np.integer[Any])
_OFFSET = {"start": 0.0, "middle": 0.5, "end": 1.0, "both ends": 0.0}
"""Offset of the first place from the start of a motion or piece, in parts."""


def even_places(
    rows: NDArray[_Row], parts: NDArray[np.integer[Any]], at: Literal["start", "middle", "end", "both ends"] = "end"
) -> tuple[NDArray[_Row], Array]:
    """Return the places that divide motions, or pieces of them, into equal parts: rows (N,) and shares (N,) in [0, 1].

    All samples of a path come from here. Shares are those of the motion or piece: 0 at its start, 1 at its end. How
    many parts there are is up to the purpose: `even_parts` by length and rotation, others by sagitta, ridges or cells.

    >>> even_places(np.array([4, 7]), np.array([2, 1]))
    (array([4, 4, 7]), array([0.5, 1. , 1. ]))
    >>> even_places(np.array([4, 7]), np.array([2, 1]), "both ends")
    (array([4, 4, 4, 7, 7]), array([0. , 0.5, 1. , 0. , 1. ]))

    :param rows: (K,) motions or pieces, `parts` (K,) the number of parts of each.
    :param at: where in each part; "both ends" gives one place more than there are parts.
    """
    count = parts + 1 if at == "both ends" else parts
    return np.repeat(rows, count), (ragged_range(count) + _OFFSET[at]) / np.repeat(parts, count)


def even_parts(length: Array, turn: Array, spacing: float, rotation: float) -> Ints:
    """Return the least number of equal parts (K,) of pieces that are no longer than, and turn by no more than, limits.

    :param length: (K,) length of each piece [m].
    :param turn: (K,) rotation of the tool along each piece [rad].
    :param spacing: largest length of a part [m].
    :param rotation: largest rotation of the tool along a part [rad].
    """
    parts = np.ceil(np.maximum(length / spacing, turn / rotation) - _ROUNDING)
    return np.maximum(parts, 1.0).astype(np.int64)


class DisplacementEstimate(Struct, frozen=True, eq=False):
    """Estimated change of the tool's displacement by its force along M motions, to find the places to compute.

    :param motion: (K,) row of `Motions` of places where the force is given, in order along the path: all of arcs, of
        other motions those where it bends.
    :param t: (K,) place on it, in [0, 1].
    :param change: (K,) change of the displacement since the previous place on the motion [m].
    :param is_bend: (K,) True inside a motion where the rate of the force changes, or the force has a step.
    :param turning: (M,) size of the displacement that turns with the direction of travel [m].
    :param size: (M,) largest size of the displacement [m].
    :param swings: (M,) True for arcs that come near the direction of the spindle, where FEED axes turn quickly.
    """

    motion: Ints
    t: Array
    change: Array
    is_bend: Bools
    turning: Array
    size: Array
    swings: Bools


class Pieces(Columns, frozen=True, eq=False):
    """The division of arcs into pieces, each written as one circle: S stretches, each with a number of equal pieces.

    Stretches are bounded by the places where the rate of the force changes (bends), and where the number of pieces per
    length changes.

    :param motion: (S,) row of `Motions`, never decreasing.
    :param begin: (S,) place t where the stretch begins, in order along a motion.
    :param end: (S,) place t where it ends.
    :param number: (S,) of pieces.
    :param min_number: (S,) the least number, whatever the force.
    :param samples: (S,) number of samples that the stretch needs, whatever the pieces.
    :param uncertain: (S,) True where the number is a first try: even, and to be corrected by the error of such pieces.
    """

    motion: Ints
    begin: Array
    end: Array
    number: Ints
    min_number: Ints
    samples: Array
    uncertain: Bools

    @property
    def samples_per_piece(self) -> Ints:
        """(S,) samples on each piece: an even number, so that its middle is one."""
        return 2 * np.maximum(1, np.ceil(self.samples / (2 * self.number) - _ROUNDING).astype(np.int64))

    def with_enough_pieces(self, number: Ints) -> Pieces:
        """Return the stretches with the numbers (S,) of pieces that are estimated to be enough."""
        return replace(
            self, number=np.maximum(number, self.min_number), uncertain=np.zeros(len(self.motion), dtype=bool)
        )

    def sort(self) -> Pieces:
        """Return the stretches in order along the path."""
        return self.take(np.lexsort((self.begin, self.motion)))

    def divided(self, parts: Ints) -> Pieces:
        """Return the stretches divided into equal parts, which are stretches too; each gets its share of the pieces.

        Shares are rounded up. A stretch that is divided into as many parts as it has pieces becomes one stretch for
        each piece.

        :param parts: (S,) number of parts of each stretch.
        """
        stretches = self.take(np.repeat(np.arange(len(parts)), parts))
        index = ragged_range(parts)
        parts = np.repeat(parts, parts)
        begin = stretches.begin + (stretches.end - stretches.begin) * (index / parts)
        # a part ends exactly where the next one begins, the last part exactly where the stretch ends
        end = np.where(index == parts - 1, stretches.end, np.roll(begin, -1))
        number, min_pieces = -(-stretches.number // parts), -(-stretches.min_number // parts)  # rounded up
        return Pieces(stretches.motion, begin, end, number, min_pieces, stretches.samples / parts, stretches.uncertain)

    def refined_at(self, motion: Ints, t: Array, piece_count: Ints) -> Pieces:
        """Return the stretches with the pieces divided on which the path exceeds the tolerance.

        :param motion: (n,) rows of `Motions`, and t: (n,) places on them at which the path exceeds the tolerance.
        :param piece_count: (n,) least number of pieces that replace the piece at each place.
        """
        is_exceeded = np.zeros(len(self.motion), dtype=bool)
        is_exceeded[self._stretch_at(motion, t)] = True
        # each piece of such a stretch becomes a stretch of its own, whose number of pieces can then grow alone
        stretches = self.divided(np.where(is_exceeded, self.number, 1))
        number = stretches.number.copy()
        np.maximum.at(number, stretches._stretch_at(motion, t), piece_count)  # several places may be on one piece
        return stretches.with_enough_pieces(number)

    def _stretch_at(self, motion: Ints, t: Array) -> Ints:
        """Return the stretches (n,) on which t (n,), in (0, 1], of motions (n,) are.

        Since t is at most 1, motion + t grows along all stretches: one search finds the last that begins before it.
        """
        return np.searchsorted(self.motion + self.begin, motion + t) - 1


def pieces(path: Segments, tolerance: float, estimate: DisplacementEstimate, *, linearize_arcs: bool = False) -> Pieces:
    """Return the numbers of pieces with which the subdivision of the arcs begins.

    The least number of pieces is final if its estimated error is small. Else an even number is a first try.

    :param tolerance: largest path error [m].
    :param estimate: the change of the displacement along the motions.
    :param linearize_arcs: pieces are chords that keep half the tolerance; their number is final.
    """
    arcs = path.arcs
    stretches = _stretches(arcs.motion, estimate, tolerance)
    arc, motion = stretches.arc, arcs.motion[stretches.arc]
    share = stretches.end - stretches.begin  # of the arc
    angle, radius = arcs.sweep[arc] * share, norm(arcs.radial)[arc]
    step = _STEP * np.sqrt(tolerance / _REFERENCE_TOLERANCE)
    samples = share * np.maximum(path.travel[motion] / step, path.turn[motion] / _SAMPLE_ROTATION)
    if linearize_arcs:  # the sagitta radius·(angle/n)²/8 of n chords is half the tolerance
        samples = np.maximum(samples, angle * np.sqrt(radius / tolerance) / 2.0)
    min_pieces = np.maximum(1, np.ceil(angle / _LARGEST_ANGLE - _ROUNDING).astype(np.int64))
    path_error = _stretch_errors(path, estimate, stretches) / min_pieces**2
    uncertain = (path_error > _ACCEPTED_SHARE * tolerance) & (not linearize_arcs)
    even_number = 2 * np.ceil(np.maximum(angle / _COARSE_ANGLE, min_pieces) / 2.0 - _ROUNDING).astype(np.int64)
    return Pieces(
        motion=motion,
        begin=stretches.begin,
        end=stretches.end,
        number=np.where(uncertain, even_number, min_pieces),
        min_number=min_pieces,
        samples=samples,
        uncertain=uncertain,
    )


def _stretch_errors(path: Segments, estimate: DisplacementEstimate, stretches: _Stretches) -> Array:
    """Return the estimated path errors (S,) [m] of stretches that are each written as one circle.

    :param estimate: the change of the displacement along the motions.
    """
    arcs, arc = path.arcs, stretches.arc
    motion, share = arcs.motion[arc], stretches.end - stretches.begin
    # size: largest displacement by the force on the motion [m]
    angle, radius, size = arcs.sweep[arc] * share, norm(arcs.radial)[arc], estimate.size[motion]
    # displacements that turn with the arc, and those that grow along it [m]
    turning_part = estimate.turning[motion] + size * radius / _DEFLECTION_LENGTH
    growth = norm(arcs.climb)[arc] + np.abs(arcs.growth[arc]) * radius + size * path.turn[motion]
    growing_part = stretches.change + share * growth
    return _TURNING_ERROR * angle**2 * turning_part + _GROWING_ERROR * angle * growing_part


class _Stretches(NamedTuple):
    """S stretches of arcs between the places where the force bends, in order.

    :param arc: (S,) its arc, a row of those that are divided.
    :param begin: (S,) where it begins on the arc, in [0, 1), and `end` (S,) where it ends.
    :param change: (S,) change of the displacement on it [m]; 0 on arcs on which it changes by too little to matter.
    """

    arc: Ints
    begin: Array
    end: Array
    change: Array


def _stretches(arcs: Ints, estimate: DisplacementEstimate, tolerance: float) -> _Stretches:
    """Return the stretches of arcs (A,), rows of `Motions`, between the bends: places where the force's rate changes.

    Arcs along which the displacement changes by much less than the tolerance are one stretch each.

    :param estimate: changes of the displacement at places along the motions.
    :param tolerance: largest path error [m].
    """
    rows = np.flatnonzero(np.isin(estimate.motion, arcs))
    arc_of_row = np.searchsorted(arcs, estimate.motion[rows])
    is_noticeable = np.bincount(arc_of_row, estimate.change[rows], len(arcs)) > _LEAST_CHANGE_SHARE * tolerance
    rows, arc_of_row = rows[is_noticeable[arc_of_row]], arc_of_row[is_noticeable[arc_of_row]]
    # stretches begin at the starts of the arcs and at the bends
    is_bend = estimate.is_bend[rows]
    arc = np.concatenate([np.arange(len(arcs)), arc_of_row[is_bend]])
    begin = np.concatenate([np.zeros(len(arcs)), estimate.t[rows[is_bend]]])
    # a stretch ends where the next one of its arc begins, the last one of an arc at t = 1
    order = np.lexsort((begin, arc))
    arc, begin = arc[order], begin[order]
    is_last = np.append(np.diff(arc) != 0, np.ones(min(1, len(arc)), dtype=np.bool_))
    end = np.where(is_last, 1.0, np.append(begin[1:], 1.0)[: len(arc)])
    # arc + t grows along all arcs, since t is in 0 … 1: one search finds the stretch of each knot
    stretch = np.searchsorted(arc + begin, arc_of_row + estimate.t[rows]) - 1
    is_inside = estimate.t[rows] > 0.0
    change: Array = np.bincount(stretch[is_inside], estimate.change[rows][is_inside], len(arc)).astype(float)
    return _Stretches(arc, begin, end, change)


def places(
    program: Program,
    path: Segments,
    tolerance: float,
    estimate: DisplacementEstimate,
    arcs: Pieces,
    extra_places: tuple[Ints, Array] | None = None,
) -> tuple[Ints, Array]:
    """Return the places at which the path is computed: ends of motions, middles and ends of pieces, and between.

    :param tolerance: largest path error [m].
    :param estimate: says where the rate of the force changes.
    :param arcs: the division of the arcs into pieces, each of which is written as one circle.
    :param extra_places: further places of straight motions: motion (n,) and t (n,); None: there are none.
    :returns: motion (N,) and t (N,), 0 at the start of a motion and 1 at its end, in order.
    """
    bends = np.flatnonzero(estimate.is_bend & (program.motions.kind[estimate.motion] == LIN))
    further_places = [(estimate.motion[bends], estimate.t[bends]), _arc_places(arcs)]
    if extra_places is not None:
        further_places.append(extra_places)
    return _merge_places(_straight_places(program, path, tolerance), further_places)


def _straight_places(program: Program, path: Segments, tolerance: float) -> tuple[Ints, Array]:
    """Return the places on motions other than arcs, without regard to forces: motion (n,) and t (n,), in order.

    PTP motions and pieces of splines are computed at their ends only: nothing is inserted into them.

    :param tolerance: largest path error [m].
    """
    kind = program.motions.kind
    step = _STEP * np.sqrt(tolerance / _REFERENCE_TOLERANCE)
    parts = np.maximum(
        even_parts(path.travel, path.turn, step, _SAMPLE_ROTATION), swivel_pieces(program, path, tolerance)
    )
    parts[(kind == PTP) | (kind == SPL)] = 1
    straight = np.flatnonzero(kind != CIRC)
    return even_places(straight, parts[straight])


def _arc_places(arcs: Pieces) -> tuple[Ints, Array]:
    """Return the samples on the pieces of arcs: motion (n,) and t (n,), in order of the stretches."""
    stretch, share = even_places(np.arange(len(arcs.motion)), arcs.number * arcs.samples_per_piece)
    begin, end = arcs.begin[stretch], arcs.end[stretch]
    return arcs.motion[stretch], np.where(share == 1.0, end, begin + (end - begin) * share)


def _merge_places(
    ordered_places: tuple[Ints, Array], further_places: Sequence[tuple[Ints, Array]]
) -> tuple[Ints, Array]:
    """Return all places in order, each once: motion (N,) and t (N,) along it, in (0, 1].

    :param ordered_places: motion and t of places that are in order already, and of which none is repeated.
    :param further_places: motion and t of others, in any order.
    """
    motion, t = ordered_places
    if not any(len(rows) for rows, _ in further_places):
        return motion, t
    motion = np.concatenate([motion, *(rows for rows, _ in further_places)])
    t = np.concatenate([t, *(values for _, values in further_places)])
    order = np.lexsort((t, motion))
    motion, t = motion[order], t[order]
    # of places that differ by rounding the later one stays: it may be the end, t = 1
    repetitions = np.flatnonzero((np.diff(motion) == 0) & (np.diff(t) < _SAME_PLACE))
    return np.delete(motion, repetitions), np.delete(t, repetitions)


def swivel_pieces(program: Program, path: Segments, tolerance: float) -> Ints:
    """Return the number of pieces (M,) of straight motions along which the tool turns as `Program.turning` says.

    A robot turns the tool by one rotation along each piece. The error of the orientation is proportional to the square
    of the length of a piece; times `_LEVER` it must stay within the tolerance.

    :param tolerance: largest path error [m].
    """
    number = np.ones(len(program.motions), dtype=np.int64)
    turning = program.turning
    if turning is None:
        return number
    travel = turning.travel
    rows = np.flatnonzero((travel > 0.0) & (program.motions.kind == LIN))
    start, end = path.start.at(rows), program.motions.target[rows]
    orientation_error = np.zeros(len(rows))  # [rad]
    for share in (0.25, 0.5, 0.75):
        t = np.full(len(rows), share)
        orientation_error = np.maximum(
            orientation_error, angle_between(interpolate(start, end, t)[:, :3, :3], turning.at(rows, t))
        )
    piece_count = np.maximum(np.sqrt(orientation_error * _LEVER / tolerance), travel[rows] / _MOST_SWIVEL)
    number[rows] = np.maximum(1, np.ceil(piece_count - _ROUNDING)).astype(np.int64)
    return number
