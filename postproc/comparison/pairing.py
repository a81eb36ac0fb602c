"""Which target of one program is which of another: the same path, commanded with other numbers and in other steps.

A correction moves targets by millimetres, often by more than they are apart, and inserts some: the nearest one is not
the right one. What it hardly changes is the step from one target to the next, and the length of the way between them.
Sought is the assignment, in order, under which these change least (dynamic programming, as in aligning sequences):

- a step that changes costs the logarithm of 1 + its change over a quarter of the step, 1.2 at most, and half as much by
  how much longer or shorter the way is, and 0.6 more from 8 mm on; so a target that was moved costs 4.8 at most;
- targets passed over between two pairs cost nothing (they are inserted) if the way through them is as long as the step;
  by how much it is longer costs as much as a step that changes;
- a target of the first program without a partner costs 3.2: a missing line is cheaper than pairing every later target
  with a neighbour, and a moved target cheaper than one missing and one too many;
- where it only divides a line or an arc, it costs 2: the other program may divide that curve elsewhere.

Only partners at about the same length of path as the last ones are considered.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.frames import Array, norm
from postproc.program import Bools, Ints

_SHARE, _LEAST, _MOST = 0.25, 1e-4, 1e-3
"""A step changes noticeably by this share of it, but by so much [m] at least and at most."""
_ALIKE = 0.1
"""Of that, what steps differ by that are taken for the same at once."""
_CAP, _WAY = 1.2, 0.5
_OTHER_WAY, _LONGER = 0.6, 8e-3
"""A way that is longer or shorter by the second number [m], which no correction causes, costs the first more."""
_MISSING, _PASSED = 3.2, 2.0
_OTHER_KIND = 2.0
"""A PTP is no LIN or CIRC."""
_WINDOW = 14
"""Partners looked at on either side of the place at the same length of path."""
_KEPT = 48
"""Assignments followed at the same time."""
_PASSES = 3
_EQUAL = 5e-6
"""Targets that are this near [m], after steps that differ by no more, are the same ones."""
_RUN, _AT_ONCE = 3, 4096
_NONE = -1


class Track(Struct, frozen=True, eq=False):
    """The Cartesian targets of a program.

    :param position: (n, 3) in a frame that both programs share [m].
    :param step: (n,) length of the way to each from the one before [m]; of an arc, along it.
    :param joint: (n,) True for PTP.
    :param continued: (n,) True where the path goes on along the same line or arc: a division point, no corner.
    """

    position: Array
    step: Array
    joint: Bools
    continued: Bools

    def __len__(self) -> int:
        return len(self.position)


def partners(one: Track, other: Track) -> Ints:
    """Return the target of the other program for each of one (n,), ascending; −1 where it has none."""
    out = np.full(len(one), _NONE)
    if len(other) < len(one):  # it is the first one, then, that has targets between
        found = partners(other, one)
        paired = np.flatnonzero(found != _NONE)
        out[found[paired]] = paired
        return out
    begin = _alike(one, other)
    out[:begin] = np.arange(begin)
    end = min(_alike(_reversed(one), _reversed(other)), len(one) - begin, len(other) - begin)
    rest, place = slice(begin, len(one) - end), slice(begin, len(other) - end)
    out[len(one) - end :] = np.arange(len(other) - end, len(other))
    before = (one.position[begin - 1], other.position[begin - 1]) if begin else None
    found = _assigned(_part(one, rest), _part(other, place), before)
    out[rest] = np.where(found == _NONE, _NONE, found + begin)
    for _ in range(_PASSES):
        _settle(one, other, out)
    return out


def _settle(one: Track, other: Track, partner: Ints) -> None:
    """Move partners (n,) to a free neighbour where the offsets then change less, in metres, from pair to pair."""
    row = np.flatnonzero(partner != _NONE)[1:-1]
    if not len(row):
        return
    place = np.searchsorted(row, row) + 1
    paired = np.flatnonzero(partner != _NONE)
    before, behind = paired[place - 1], paired[place + 1]
    ends = [other.position[partner[k]] - one.position[k] for k in (before, behind)]

    def change(candidate: Ints) -> Array:
        offset = other.position[candidate] - one.position[row]
        return norm(offset - ends[0]) + norm(offset - ends[1])

    own = change(partner[row])
    for step in (-1, 1):
        candidate = partner[row] + step
        free = (
            (candidate > partner[before]) & (candidate < partner[behind]) & (other.joint[candidate] == one.joint[row])
        )
        better = free & (change(candidate) < own)
        partner[row[better]] = candidate[better]
        own = np.minimum(own, np.where(better, change(candidate), own))


def _part(track: Track, rows: slice) -> Track:
    return Track(track.position[rows], track.step[rows], track.joint[rows], track.continued[rows])


def _reversed(track: Track) -> Track:
    return Track(track.position[::-1], np.roll(track.step, -1)[::-1], track.joint[::-1], track.continued[::-1])


def _scale(step: Array) -> Array:
    return np.asarray(np.minimum(_LEAST + _SHARE * step, _MOST))


def _alike(one: Track, other: Track) -> int:
    """Return how many targets at the beginning are the same steps, less the last few, where they begin to differ."""
    count = min(len(one), len(other))
    offset = other.position[:count] - one.position[:count]
    change = norm(np.diff(offset, axis=0, prepend=np.zeros((min(1, count), 3))))
    change += np.abs(other.step[:count] - one.step[:count])
    same = (change < _ALIKE * _scale(one.step[:count])) & (one.joint[:count] == other.joint[:count])
    if same.all() and len(one) == len(other):
        return count
    return max(0, (count if same.all() else int(np.argmin(same))) - 2)


class _States(Struct, eq=False):
    """The cheapest assignments of the targets so far whose last pair is (`row`, `partner`); each field (w,)."""

    partner: Ints
    row: Ints
    cost: Array
    offset: Array


def _assigned(one: Track, other: Track, before: tuple[Array, Array] | None) -> Ints:
    """Return the partners (n,) of the targets of one program in the other; `before`: the pair before both begin."""
    if not len(one) or not len(other):
        return np.full(len(one), _NONE)
    start = np.zeros((1, 3)) if before is None else (before[1] - before[0])[None]
    along, along_other = np.append(0.0, np.cumsum(one.step)), np.append(0.0, np.cumsum(other.step))
    out = np.full(len(one), _NONE)
    states = _States(np.array([_NONE]), np.array([_NONE]), np.zeros(1), start)
    origins: dict[int, tuple[Ints, Ints, Ints]] = {}  # of each row: its window of partners, and the pair before each
    row = 0
    while row < len(one):
        best = int(np.argmin(states.cost))
        if states.row[best] == row - 1 >= 0 and norm(states.offset[best]) < _EQUAL:
            run = _equal(one, other, row, int(states.partner[best]) + 1)
            if run >= _RUN:  # nothing else is more likely
                _follow(out, states, origins)
                place = int(states.partner[best]) + run
                out[row : row + run] = np.arange(place - run, place) + 1
                row += run
                offset = other.position[place] - one.position[row - 1]
                states = _States(np.array([place]), np.array([row - 1]), np.zeros(1), offset[None])
                origins.clear()
                continue
        passed = along[row + 1] - along[states.row[best] + 1]
        middle = int(np.searchsorted(along_other[1:], along_other[states.partner[best] + 1] + passed))
        window = np.arange(max(0, middle - _WINDOW), min(len(other), middle + _WINDOW + 1))
        offset = other.position[window] - one.position[row]
        change = norm(offset[:, None] - states.offset)
        step = along[row + 1] - along[states.row + 1]
        way = along_other[window + 1][:, None] - along_other[states.partner + 1]
        scale = _scale(step)
        cost = np.minimum(np.log1p(change / scale), _CAP)
        if before is None:  # nothing is known of the step to the first pair, but that nothing should come before it
            cost[:, states.row == _NONE] = 0.0
        weight = np.where(window[:, None] - states.partner > 1, 1.0, _WAY)
        cost += weight * np.minimum(np.log1p(np.abs(way - step) / scale), _CAP)
        cost += _OTHER_WAY * np.minimum(np.abs(way - step) / _LONGER, 1.0)
        cost += states.cost
        cost[window[:, None] <= states.partner] = np.inf
        last = np.argmin(cost, axis=1)
        own = cost[np.arange(len(window)), last] + _OTHER_KIND * (one.joint[row] != other.joint[window])
        origins[row] = window, states.row[last], states.partner[last]
        good = np.flatnonzero(np.isfinite(own))
        paired = _States(window[good], np.full(len(good), row), own[good], offset[good])
        states = _cheapest(paired, states, _PASSED if one.continued[row] else _MISSING)
        row += 1
    _follow(out, states, origins)
    return out


def _follow(out: Ints, states: _States, origins: dict[int, tuple[Ints, Ints, Ints]]) -> None:
    """Write the pairs of the cheapest assignment into `out` (n,), from the last back to where `origins` begin."""
    best = int(np.argmin(states.cost))
    row, partner = int(states.row[best]), int(states.partner[best])
    while row in origins:
        out[row] = partner
        window, rows, others = origins[row]
        place = partner - int(window[0])
        row, partner = int(rows[place]), int(others[place])


def _equal(one: Track, other: Track, row: int, partner: int) -> int:
    """Return how many targets from these on are in the same places, after steps of the same length."""
    count = min(len(one) - row, len(other) - partner, _AT_ONCE)
    mine, theirs = _part(one, slice(row, row + count)), _part(other, slice(partner, partner + count))
    same = (norm(theirs.position - mine.position) < _EQUAL) & (np.abs(theirs.step - mine.step) < _EQUAL)
    same &= mine.joint == theirs.joint
    return count if same.all() else int(np.argmin(same))


def _cheapest(paired: _States, older: _States, alone: float) -> _States:
    """Return the cheapest assignments, of those that end with this target and those that leave it without partner.

    :param alone: cost of the latter.
    """
    cost = np.concatenate([paired.cost, older.cost + alone])
    keep = np.argpartition(cost, _KEPT)[:_KEPT] if len(cost) > _KEPT else np.arange(len(cost))
    return _States(
        np.concatenate([paired.partner, older.partner])[keep],
        np.concatenate([paired.row, older.row])[keep],
        cost[keep],
        np.concatenate([paired.offset, older.offset])[keep],
    )
