"""Which of the computed places become targets in the program: as few as hold the tolerance.

Every motion keeps its end. On straight runs a place is inserted where the line between corrected targets would miss it
by most, as long as it is missed by more than the limit. Arcs are written as circles through the corrected start, middle
and end of their pieces (`toolpath.Pieces`).
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import toolpath
from postproc.elastostatics import Compensation
from postproc.frames import Array, norm
from postproc.program import CIRC, LIN, Bools, Ints
from postproc.toolpath import Pieces, Toolpath, circle_through
from postproc.under_load import SHARE_OF_TOLERANCE, PathUnderLoad

_FLAT = 1e-6
"""Sagitta [m] below which a piece of an arc is written as a line."""


class CommandedPath(Struct, frozen=True, eq=False):
    """A path as it is commanded.

    :param sample: N places on the path.
    :param arcs: the pieces of its arcs.
    :param position: (N, 3) commanded positions at the places, `$BASE` [m].
    :param start: (M, 3) commanded position at the start of each motion, `$BASE` [m].
    :param limit: what may be missed between targets [m].
    """

    sample: Toolpath
    arcs: Pieces
    position: Array
    start: Array
    limit: float

    @classmethod
    def of(cls, path: PathUnderLoad, command: Compensation) -> CommandedPath:
        """Return the path of commands, in `$BASE`."""
        ends = np.flatnonzero(path.sample.ends)
        starts = toolpath.starts(
            path.program, lambda motion: command.pose.take(ends[motion], axis=0), path.setting.start_flange
        )
        position = command.pose[:, :3, 3]
        start = np.roll(position[ends], 1, axis=0)
        start[starts.changed] = starts.pose[:, :3, 3]
        return cls(path.sample, path.arcs, position, start, SHARE_OF_TOLERANCE * path.setting.tolerance)


def choose(
    path: CommandedPath, kind: Ints, whole: Bools, every: Bools, least_arc: tuple[float, float]
) -> tuple[Ints, Ints, Ints]:
    """Choose which samples become targets.

    :param kind: (M,) kind of each motion to be written; arcs to be written as lines are given as `LIN`.
    :param whole: (M,) motions that are written as one target whatever lies between (their text is kept).
    :param every: (M,) motions of which every sample becomes a target.
    :param least_arc: see `dialects.dialect.Writer`; a piece of an arc that is less becomes a line.
    :returns: (K,) rows of the samples, in order; (K,) `LIN`, `CIRC`, `PTP` or `SPL`; (K,) row of the sample that is the
        auxiliary point of a CIRC, −1 elsewhere.
    """
    sample, arcs = path.sample, path.arcs
    chosen, kinds, via = sample.ends | every[sample.motion], kind[sample.motion], np.full(len(sample), -1)
    count = np.bincount(sample.motion, minlength=len(kind))
    lines = np.flatnonzero((count > 1) & (kind == LIN) & ~whole)
    if len(lines):
        chosen[_divided(path, lines)] = True
    circles = np.flatnonzero(((kind == CIRC) & ~whole)[arcs.motion])
    if len(circles):
        before, middle, end = _ends(path, circles)
        curved = ~_is_flat(before, path.position[middle], path.position[end], *least_arc)
        chosen[end], kinds[end], via[end] = True, np.where(curved, CIRC, LIN), np.where(curved, middle, -1)
    row = np.flatnonzero(chosen)
    return row, kinds[row], via[row]


def pieces_needed(path: CommandedPath) -> Pieces:
    """Return how many pieces of arcs are needed, by what circles through twice as large ones miss."""
    arcs, command = path.arcs, path.position
    stretch = np.flatnonzero(arcs.uncertain)
    begin, middle_row, end_row = _ends(path, stretch)
    before, quarter, middle = begin[::2], middle_row[::2], end_row[::2]
    three_quarters, end = middle_row[1::2], end_row[1::2]
    centre, radial, across, angle = circle_through(before, command[middle], command[end])
    missed = np.zeros(len(end))
    for share, row in ((0.25, quarter), (0.75, three_quarters)):
        turned = (angle * share)[:, None]
        spot = centre + np.cos(turned) * radial + np.sin(turned) * across
        missed = np.maximum(missed, norm(command[row] - spot))
    pairs = arcs.number[stretch] // 2
    number = arcs.number.copy()
    worst = np.maximum.reduceat(missed, np.cumsum(pairs) - pairs)
    number[stretch] = np.ceil(pairs * np.sqrt(worst / path.limit)).astype(np.int64)
    return arcs.settled(number)


def _ends(path: CommandedPath, stretch: Ints) -> tuple[Array, Ints, Ints]:
    """Return where pieces start (n, 3), and the samples (n,) at their middle and end, for all pieces of stretches."""
    arcs, sample = path.arcs, path.sample
    size = arcs.number * arcs.each
    first = np.flatnonzero(np.isin(sample.motion, arcs.motion))[np.cumsum(size) - size]
    number, each = arcs.number[stretch], np.repeat(arcs.each[stretch], arcs.number[stretch])
    inside = np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number)
    row = np.repeat(first[stretch], number) + inside * each
    before = path.position[row - 1]
    fresh = (inside == 0) & (np.repeat(arcs.begin[stretch], number) == 0.0)
    before[fresh] = path.start[sample.motion[row[fresh]]]
    return before, row + each // 2 - 1, row + each - 1


def _divided(path: CommandedPath, motions: Ints) -> Ints:
    """Divide lines where they are missed most until every piece fits; return the samples (n,) where pieces end."""
    count = np.bincount(path.sample.motion, minlength=len(path.start))
    size = count[motions] + 1  # the start of each motion is put before its samples
    first = np.cumsum(size) - size
    row = np.arange(size.sum()) + np.repeat((np.cumsum(count) - count)[motions] - first - 1, size)
    t, position = path.sample.t[row], path.position[row]
    t[first], position[first] = 0.0, path.start[motions]
    left, right = first, first + size - 1
    done: list[Ints] = []
    while len(left):
        count = right - left - 1
        piece = np.repeat(np.arange(len(left)), count)
        node = np.arange(len(piece)) - np.repeat(np.cumsum(count) - count - left - 1, count)
        share = (t[node] - t[left][piece]) / (t[right] - t[left])[piece]
        a, b = position[left], position[right]
        miss = norm(position[node] - a[piece] - share[:, None] * (b - a)[piece])
        order = np.lexsort((miss, piece))
        last = order[np.cumsum(count[count > 0]) - 1]
        worst, cut = np.zeros(len(left)), np.full(len(left), -1)
        worst[piece[last]], cut[piece[last]] = miss[last], node[last]
        again = worst > path.limit
        done.append(right[~again])
        cut = cut[again]
        left, right = np.concatenate([left[again], cut]), np.concatenate([cut, right[again]])
    return np.asarray(row[np.concatenate(done)])


def _is_flat(a: Array, b: Array, c: Array, distance: float, angle: float) -> Bools:
    """Return which arcs from a through b to c are lines: flat to a micrometre, or less than a controller takes."""
    chord, first = c - a, b - a
    length, height = norm(chord), norm(np.cross(chord, first))
    flat = height < _FLAT * length
    small = np.minimum(length, norm(first)) < distance
    return np.asarray((length > 0.0) & (flat | small | (height < np.tan(angle) * (chord * first).sum(axis=1))))
