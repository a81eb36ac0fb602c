"""Which of the computed places become targets in the program: as few as hold the tolerance.

Every motion keeps its end. On straight runs a place is inserted where the line between corrected targets would miss it
by more than the limit; arcs are split into circles through three corrected points until these fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from postproc.frames import Array, norm
from postproc.program import CIRC, LIN, Bools, Ints
from postproc.toolpath import Toolpath

_LARGEST_ARC = np.pi * 2.0 / 3.0
"""Arcs are written in pieces of at most 120°: three points then define the circle well."""
_FLAT = 1e-6
"""Sagitta [m] below which a piece of an arc is written as a line."""


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Rows of the samples that become targets, in order.

    :param row: (K,) row of the samples.
    :param kind: (K,) `LIN`, `CIRC` or `PTP`.
    :param via: (K,) row of the sample that is the auxiliary point of a CIRC; −1 elsewhere.
    """

    row: Ints
    kind: Ints
    via: Ints


def choose(
    kind: Ints,
    sweep: Array,
    sample: Toolpath,
    command: Array,
    start: Array,
    limit: float,
    whole: Bools,
) -> Selection:
    """Choose targets.

    :param kind: (M,) kind of each motion to be written; arcs to be written as lines are given as `LIN`.
    :param sweep: (M,) angle of each arc [rad], NaN elsewhere.
    :param sample: N places on the path.
    :param command: (N, 3) commanded positions there, `$BASE` [m].
    :param start: (M, 3) commanded position at the start of each motion, `$BASE` [m].
    :param limit: what may be missed [m].
    :param whole: (M,) motions that are written as one target whatever lies between (their text is kept).
    """
    ends = np.flatnonzero(sample.ends)
    chosen, via = [ends], [np.full(len(ends), -1)]
    kinds = [kind[sample.motion[ends]]]
    inner = np.bincount(sample.motion, minlength=len(kind)) > 1
    for wanted in (LIN, CIRC):
        motions = np.flatnonzero(inner & (kind == wanted) & ~whole)
        if len(motions) == 0:
            continue
        nodes = _Nodes.of(motions, sample, command, start)
        right, middle = _split(nodes, sweep, limit, arcs=wanted == CIRC)
        rows = nodes.row[right]
        if wanted == CIRC:
            at_end = np.searchsorted(ends, rows)
            is_end = sample.t[rows] == 1.0
            arc_kind = np.where(middle >= 0, CIRC, LIN)
            arc_via = np.where(middle >= 0, nodes.row[middle], -1)
            kinds[0][at_end[is_end]], via[0][at_end[is_end]] = arc_kind[is_end], arc_via[is_end]
            chosen.append(rows[~is_end])
            kinds.append(arc_kind[~is_end])
            via.append(arc_via[~is_end])
        else:
            rows = rows[sample.t[rows] < 1.0]
            chosen.append(rows)
            kinds.append(np.full(len(rows), LIN))
            via.append(np.full(len(rows), -1))
    row = np.concatenate(chosen)
    order = np.argsort(row)
    return Selection(row[order], np.concatenate(kinds)[order], np.concatenate(via)[order])


@dataclass(frozen=True, slots=True, eq=False)
class _Nodes:
    """Samples of some motions with the start of each motion put before them (`row` −1 there)."""

    row: Ints
    motion: Ints
    t: Array
    position: Array

    @classmethod
    def of(cls, motions: Ints, sample: Toolpath, command: Array, start: Array) -> _Nodes:
        rows = np.flatnonzero(np.isin(sample.motion, motions))
        motion = np.concatenate([motions, sample.motion[rows]])
        t = np.concatenate([np.zeros(len(motions)), sample.t[rows]])
        order = np.lexsort((t, motion))
        row = np.concatenate([np.full(len(motions), -1), rows])[order]
        position = np.concatenate([start[motions], command[rows]])[order]
        return cls(row, motion[order], t[order], position)


def _split(nodes: _Nodes, sweep: Array, limit: float, *, arcs: bool) -> tuple[Ints, Ints]:
    """Split each motion's nodes until every piece fits; return right and middle node of each piece."""
    left = np.flatnonzero(nodes.t == 0.0)
    right = np.flatnonzero(nodes.t == 1.0)
    done: list[tuple[Ints, Ints]] = []
    while len(left):
        count = right - left - 1
        piece = np.repeat(np.arange(len(left)), count)
        node = np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count) + left[piece] + 1
        middle = np.full(len(left), -1)
        if arcs:
            span = 0.5 * (nodes.t[left] + nodes.t[right])
            nearest = np.lexsort((np.abs(nodes.t[node] - span[piece]), piece))
            first = nearest[np.cumsum(count[count > 0]) - count[count > 0]]
            middle[piece[first]] = node[first]
            middle[_is_flat(nodes, left, middle, right)] = -1
        miss = _miss(nodes, left, right, middle, piece, node) if len(node) else np.zeros(0)
        worst = np.zeros(len(left))
        split_at = middle.copy()
        if len(node):
            order = np.lexsort((miss, piece))
            last = order[np.cumsum(count[count > 0]) - 1]
            worst[piece[last]] = miss[last]
            split_at[piece[last]] = node[last]
        again = (worst > limit) & (count > 0)
        if arcs:
            wide = sweep[nodes.motion[left]] * (nodes.t[right] - nodes.t[left]) > _LARGEST_ARC + 1e-6
            split_at = np.where(wide & (middle >= 0), middle, split_at)
            again |= wide & (split_at >= 0)
        done.append((right[~again], middle[~again]))
        cut = split_at[again]
        left, right = np.concatenate([left[again], cut]), np.concatenate([cut, right[again]])
    return np.concatenate([part[0] for part in done]), np.concatenate([part[1] for part in done])


def _is_flat(nodes: _Nodes, left: Ints, middle: Ints, right: Ints) -> Bools:
    """Return which pieces deviate from their chord by less than a micrometre: they are lines, not circles."""
    a, b, c = (nodes.position[index] for index in (left, middle, right))
    chord = c - a
    length = norm(chord)
    height = norm(np.cross(chord, b - a)) / np.where(length > 0.0, length, 1.0)
    return np.asarray((middle >= 0) & (length > 0.0) & (height < _FLAT))


def _miss(nodes: _Nodes, left: Ints, right: Ints, middle: Ints, piece: Ints, node: Ints) -> Array:
    """Return how far each inner node lies from the line or circle that its piece would be written as [m]."""
    share = (nodes.t[node] - nodes.t[left[piece]]) / (nodes.t[right] - nodes.t[left])[piece]
    a, b = nodes.position[left], nodes.position[right]
    straight = a[piece] + share[:, None] * (b - a)[piece]
    off = nodes.position[node] - straight
    curved = np.flatnonzero(middle >= 0)
    if len(curved):
        centre, radial, across, angle = circle_through(a[curved], nodes.position[middle[curved]], b[curved])
        place = np.full(len(left), -1)
        place[curved] = np.arange(len(curved))
        on_arc = np.flatnonzero(place[piece] >= 0)
        which = place[piece[on_arc]]
        turned = (angle[which] * share[on_arc])[:, None]
        spot = centre[which] + np.cos(turned) * radial[which] + np.sin(turned) * across[which]
        off[on_arc] = nodes.position[node[on_arc]] - spot
    return norm(off)


def circle_through(a: Array, b: Array, c: Array) -> tuple[Array, Array, Array, Array]:
    """Return the arcs from a through b to c (each (n, 3)).

    :returns: centre (n, 3), radius vector to a (n, 3), the vector square to it in the direction of travel (n, 3), and
        the angle from a to c (n,) in (0, 2π). Points on one line give a circle of very large radius.
    """
    ab, ac = b - a, c - a
    normal = np.cross(ab, ac)
    square = np.einsum("ni,ni->n", normal, normal)[:, None]
    flat = square[:, 0] <= 1e-24 * np.einsum("ni,ni->n", ac, ac) ** 2
    square = np.where(flat[:, None], 1.0, square)
    ab2, ac2 = np.einsum("ni,ni->n", ab, ab)[:, None], np.einsum("ni,ni->n", ac, ac)[:, None]
    centre = a + np.cross(ab2 * ac - ac2 * ab, normal) / (2.0 * square)
    unit = normal / np.sqrt(square)
    radial = a - centre
    across = np.cross(unit, radial)
    to_c = c - centre
    angle = np.arctan2(np.einsum("ni,ni->n", to_c, across), np.einsum("ni,ni->n", to_c, radial)) % (2.0 * np.pi)
    return centre, radial, across, angle
