"""Which target of one program is which of another: the same path, commanded with other numbers and in other steps.

A correction moves targets by millimetres, often by more than they are apart, and inserts some: the nearest one is not
the right one. What it hardly changes is the step from one target to the next, and the length of path between them.
Sought is the assignment, in order, under which these change least (dynamic programming, as in aligning sequences):

- a step that changes costs the logarithm of 1 + its change over a quarter of the step, 1.2 at most, and half as much by
  how much longer or shorter the path is, and 0.6 more from 8 mm on; so a target that was moved costs 4.8 at most;
- targets passed over between two pairs cost nothing (they are inserted) if the path through them is as long as the
  step; by how much it is longer costs as much as a step that changes;
- a target of the first program without a partner costs 3.2: a missing line is cheaper than pairing every later target
  with a neighbour, and a moved target cheaper than one missing and one too many;
- where it only divides a line or an arc, it costs 2: the other program may divide that curve elsewhere.

Only partners at about the same length of path as the last ones are considered.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.frames import Array, norm
from postproc.program import Bools, Ints

_CHANGE_SHARE, _LEAST_CHANGE, _MOST_CHANGE = 0.25, 1e-4, 1e-3
"""A noticeable change of a step: the second [m] plus this share of the step, at most the third [m] (assumed)."""
_STEP_TOLERANCE = 0.1
"""Share of a noticeable change below which steps are equal (assumed)."""
_MAX_CHANGE_COST, _LENGTH_WEIGHT = 1.2, 0.5
"""Largest cost of a change of the offset or of the length of path, so that a jump costs less than a missing target, and
the weight of the change of length where partners follow one another (assumed)."""
_LENGTH_COST, _EXCESS_LENGTH = 0.6, 8e-3
"""Cost of a path that is longer or shorter by the second number [m], which no correction causes (assumed)."""
_MISSING_COST, _PASSED_COST = 3.2, 2.0
"""Cost of a target without a partner, and of one whose motion is continued by the next (assumed)."""
_OTHER_KIND = 2.0
"""Cost of a PTP as the partner of a LIN or CIRC (assumed)."""
_WINDOW = 14
"""Number of partners considered on either side of the place at the same length of path (assumed)."""
_MAX_STATES = 48
"""Largest number of assignments that are kept at each target (assumed)."""
_PASSES = 3
"""Each pass moves a partner by one place at most: assignments are off by no more than three (assumed)."""
_EQUAL_DISTANCE = 5e-6
"""Targets that are this near [m], after steps that differ by no more, are the same ones (assumed)."""
_MIN_RUN, _RUN_CHUNK = 3, 4096
"""Equal targets in a row that leave no other assignment likely, and the number of targets compared at once; assumed."""
_NO_PARTNER = -1
"""Row that no target has."""


class Track(Struct, frozen=True, eq=False):
    """The Cartesian targets of a program.

    :param position: (n, 3) in a frame that both programs share [m].
    :param step: (n,) length of path to each from the one before [m].
    :param joint: (n,) True for PTP.
    :param is_continued: (n,) True where the path goes on along the same line or arc: a division point, no corner.
    """

    position: Array
    step: Array
    joint: Bools
    is_continued: Bools

    def __len__(self) -> int:
        """Return the number of targets."""
        return len(self.position)


def partners(nominal_track: Track, corrected_track: Track) -> Ints:
    """Return the partner (n,) of each target of the nominal program: its index in the other, ascending; −1 for none."""
    partner = np.full(len(nominal_track), _NO_PARTNER)
    if len(corrected_track) < len(nominal_track):  # the assignment needs the one with inserted targets second
        nominal_index = partners(corrected_track, nominal_track)
        corrected_rows = np.flatnonzero(nominal_index != _NO_PARTNER)
        partner[nominal_index[corrected_rows]] = corrected_rows
        return partner
    # the common begin and the common end need no search
    first = _common_length(nominal_track, corrected_track)
    partner[:first] = np.arange(first)
    end_count = _common_length(_reverse_track(nominal_track), _reverse_track(corrected_track))
    end_count = min(end_count, len(nominal_track) - first)
    nominal_range = slice(first, len(nominal_track) - end_count)
    corrected_range = slice(first, len(corrected_track) - end_count)
    partner[nominal_range.stop :] = np.arange(corrected_range.stop, len(corrected_track))
    last_pair = (nominal_track.position[first - 1], corrected_track.position[first - 1]) if first else None
    inner_partner = _assign_partners(
        _part(nominal_track, nominal_range), _part(corrected_track, corrected_range), last_pair
    )
    partner[nominal_range] = np.where(inner_partner == _NO_PARTNER, _NO_PARTNER, inner_partner + first)
    for _ in range(_PASSES):
        _settle_partners(nominal_track, corrected_track, partner)
    return partner


def _settle_partners(nominal_track: Track, corrected_track: Track, partner: Ints) -> None:
    """Replace partners by their free neighbours where the offset then changes less from pair to pair.

    A neighbour is free if it is no partner of another target.

    :param partner: (n,) partner of each nominal target, −1 for none; changed in place.
    """
    paired_rows = np.flatnonzero(partner != _NO_PARTNER)
    previous_row, row, next_row = paired_rows[:-2], paired_rows[1:-1], paired_rows[2:]
    previous_offset, next_offset = (
        corrected_track.position[partner[rows]] - nominal_track.position[rows] for rows in (previous_row, next_row)
    )

    def change(candidate: Ints) -> Array:
        """Return the change of the offset [m] from the pair before plus that to the next pair, for candidates (k,)."""
        offset = corrected_track.position[candidate] - nominal_track.position[row]
        return norm(offset - previous_offset) + norm(offset - next_offset)

    first_change = change(partner[row])
    for step in (-1, 1):  # step 1 does not undo step −1: its change would be the first one again
        candidate = partner[row] + step
        is_free = (candidate > partner[previous_row]) & (candidate < partner[next_row])
        is_same_kind = corrected_track.joint[candidate] == nominal_track.joint[row]
        is_better = is_free & is_same_kind & (change(candidate) < first_change)
        partner[row[is_better]] = candidate[is_better]


def _part(track: Track, rows: slice) -> Track:
    """Return some of the targets of a track; `step` of the first is still that from the target before it."""
    return Track(track.position[rows], track.step[rows], track.joint[rows], track.is_continued[rows])


def _reverse_track(track: Track) -> Track:
    """Return a track backwards: a step leads to the target that was before it, so the steps move by one target."""
    return Track(track.position[::-1], np.roll(track.step, -1)[::-1], track.joint[::-1], track.is_continued[::-1])


def _noticeable_change(step: Array) -> Array:
    """Return the change [m] by which steps of a length `step` [m] change noticeably, in the shape of `step`."""
    return np.asarray(np.minimum(_LEAST_CHANGE + _CHANGE_SHARE * step, _MOST_CHANGE))


def _common_length(nominal_track: Track, corrected_track: Track) -> int:
    """Return the number of equal steps at the beginning of two tracks, less the last two before they differ.

    A step leads from one target to the next; it is equal if neither its length nor the offset of the tracks changes.
    The partners of the last two are uncertain: they are sought together with those of the targets that differ.
    """
    count = min(len(nominal_track), len(corrected_track))
    offset = corrected_track.position[:count] - nominal_track.position[:count]
    change = norm(np.diff(offset, axis=0, prepend=np.zeros((min(1, count), 3))))  # the first one from no offset
    change += np.abs(corrected_track.step[:count] - nominal_track.step[:count])
    is_same = (change < _STEP_TOLERANCE * _noticeable_change(nominal_track.step[:count])) & (
        nominal_track.joint[:count] == corrected_track.joint[:count]
    )
    if is_same.all() and len(nominal_track) == len(corrected_track):
        return count
    same_count = count if is_same.all() else int(np.argmin(is_same))
    return max(0, same_count - 2)


class _States(Struct, eq=False):
    """The w cheapest assignments of the targets so far.

    :param partner: (w,) partner of the last pair, and `row` (w,) its nominal target; −1 before the first.
    :param cost: (w,) of the assignment.
    :param offset: (w, 3) of the last pair [m].
    """

    partner: Ints
    row: Ints
    cost: Array
    offset: Array


class _Origin(NamedTuple):
    """The pair before each possible pair of one nominal target, in the cheapest assignment: for the way back.

    :param window: (k,) possible partners of the target, consecutive.
    :param row: (k,) nominal target of the pair before; −1 for none.
    :param partner: (k,) partner of the pair before; −1 for none.
    """

    window: Ints
    row: Ints
    partner: Ints


def _assign_partners(nominal_track: Track, corrected_track: Track, last_pair: tuple[Array, Array] | None) -> Ints:
    """Return the partners (n,) of nominal targets in the second program, by dynamic programming; −1 for none.

    A state is an assignment of the targets so far, with its cost; the cheapest ones are kept. A run of equal targets is
    paired at once, after a pair of equal targets.

    :param last_pair: positions (3,) of the pair before both tracks begin [m]; None: it is not known.
    """
    if not len(nominal_track) or not len(corrected_track):
        return np.full(len(nominal_track), _NO_PARTNER)
    start_offset = np.zeros((1, 3)) if last_pair is None else (last_pair[1] - last_pair[0])[None]
    tracks = _Tracks.of(nominal_track, corrected_track, has_last_pair=last_pair is not None)
    assignment = np.full(len(nominal_track), _NO_PARTNER)
    states = _States(
        partner=np.array([_NO_PARTNER]), row=np.array([_NO_PARTNER]), cost=np.zeros(1), offset=start_offset
    )
    origins: dict[int, _Origin] = {}  # of each target since the last run of equal ones
    row = 0
    while row < len(nominal_track):
        cheapest = int(np.argmin(states.cost))
        is_previous_paired = states.row[cheapest] == row - 1 >= 0
        if is_previous_paired and norm(states.offset[cheapest]) < _EQUAL_DISTANCE:
            first_partner = int(states.partner[cheapest]) + 1
            run_length = _equal_count(nominal_track, corrected_track, row, first_partner)
            if run_length >= _MIN_RUN:  # nothing else is more likely
                _write_pairs(assignment, states, origins)
                assignment[row : row + run_length] = np.arange(first_partner, first_partner + run_length)
                states = tracks.state_of_pair(row + run_length - 1, first_partner + run_length - 1)
                origins.clear()
                row += run_length
                continue
        pair_states, origins[row] = tracks.pair_states(states, row)
        unpaired_cost = _PASSED_COST if nominal_track.is_continued[row] else _MISSING_COST
        states = _cheapest_states(pair_states, states, unpaired_cost)
        row += 1
    _write_pairs(assignment, states, origins)
    return assignment


class _Tracks(Struct, frozen=True, eq=False):
    """Two tracks whose targets are assigned to each other.

    :param nominal: of n targets, `corrected` of c.
    :param lengths: (n + 1,) length of path from the begin of the nominal track to its begin, and to each target [m].
    :param corrected_lengths: (c + 1,) lengths of path along the corrected track, in the same way [m].
    :param has_last_pair: whether the pair before both tracks is known.
    """

    nominal: Track
    corrected: Track
    lengths: Array
    corrected_lengths: Array
    has_last_pair: bool

    @classmethod
    def of(cls, nominal: Track, corrected: Track, *, has_last_pair: bool) -> _Tracks:
        """Return two tracks with the lengths of path to their targets."""
        lengths, corrected_lengths = (np.append(0.0, np.cumsum(track.step)) for track in (nominal, corrected))
        return cls(nominal, corrected, lengths, corrected_lengths, has_last_pair)

    def state_of_pair(self, row: int, partner: int) -> _States:
        """Return the single assignment that ends with a certain pair; its cost is 0."""
        offset = self.corrected.position[partner] - self.nominal.position[row]
        return _States(np.array([partner]), np.array([row]), np.zeros(1), offset[None])

    def pair_states(self, states: _States, row: int) -> tuple[_States, _Origin]:
        """Return the cheapest assignments that end with the nominal target `row` and each possible partner.

        :param states: the cheapest assignments of the targets before.
        :returns: the assignments, and the pairs before each possible partner in them.
        """
        window = self.window(states, row)
        cost = self.pair_costs(states, row, window)
        previous_state = np.argmin(cost, axis=1)
        is_other_kind = self.nominal.joint[row] != self.corrected.joint[window]
        least_cost = cost[np.arange(len(window)), previous_state] + _OTHER_KIND * is_other_kind
        columns = np.flatnonzero(np.isfinite(least_cost))
        offset = self.corrected.position[window[columns]] - self.nominal.position[row]
        pair_states = _States(window[columns], np.full(len(columns), row), least_cost[columns], offset)
        return pair_states, _Origin(window, states.row[previous_state], states.partner[previous_state])

    def window(self, states: _States, row: int) -> Ints:
        """Return the possible partners (k,) of the nominal target `row`, consecutive and ascending.

        Along the path, they are about as far from the last pair of the cheapest assignment as the nominal target.
        """
        cheapest = int(np.argmin(states.cost))
        length = self.lengths[row + 1] - self.lengths[states.row[cheapest] + 1]
        corrected_length = self.corrected_lengths[states.partner[cheapest] + 1] + length
        expected_partner = int(np.searchsorted(self.corrected_lengths[1:], corrected_length))
        end = min(len(self.corrected), expected_partner + _WINDOW + 1)
        return np.arange(max(0, expected_partner - _WINDOW), end)

    def pair_costs(self, states: _States, row: int, window: Ints) -> Array:
        """Return the costs (k, w) of the nominal target `row` with each of `window` (k,) as partner, after each state.

        The cost is infinite for a partner that does not follow that of the state.
        """
        offset = self.corrected.position[window] - self.nominal.position[row]
        offset_change = norm(offset[:, None] - states.offset)
        # lengths of path from the last pair of each state to the new pair; `lengths` begins with the start of the track
        length = self.lengths[row + 1] - self.lengths[states.row + 1]
        corrected_length = self.corrected_lengths[window + 1][:, None] - self.corrected_lengths[states.partner + 1]
        length_change = np.abs(corrected_length - length)
        scale = _noticeable_change(length)
        cost = np.minimum(np.log1p(offset_change / scale), _MAX_CHANGE_COST)
        if not self.has_last_pair:  # the first pair may have any offset, but no target should precede it
            cost[:, states.row == _NO_PARTNER] = 0.0
        has_passed_targets = window[:, None] - states.partner > 1  # of the second program, between the two pairs
        weight = np.where(has_passed_targets, 1.0, _LENGTH_WEIGHT)
        cost += weight * np.minimum(np.log1p(length_change / scale), _MAX_CHANGE_COST)
        cost += _LENGTH_COST * np.minimum(length_change / _EXCESS_LENGTH, 1.0)
        cost += states.cost
        cost[window[:, None] <= states.partner] = np.inf
        return cost


def _write_pairs(assignment: Ints, states: _States, origins: dict[int, _Origin]) -> None:
    """Write the pairs of the cheapest assignment into `assignment` (n,), in place, from the last pair backwards.

    :param origins: of each target: the pairs before it. The assignment ends at a target that has none.
    """
    cheapest = int(np.argmin(states.cost))
    row, partner = int(states.row[cheapest]), int(states.partner[cheapest])
    while row in origins:
        assignment[row] = partner
        origin = origins[row]
        column = partner - int(origin.window[0])  # a window has consecutive targets
        row, partner = int(origin.row[column]), int(origin.partner[column])


def _equal_count(nominal_track: Track, corrected_track: Track, row: int, partner: int) -> int:
    """Return the number of consecutive targets, from `row` and `partner` on, that are equal in both tracks.

    The positions of equal targets differ by less than `_EQUAL_DISTANCE`, and so do the lengths of the steps to them.
    Both are PTP, or neither is. At most `_RUN_CHUNK` targets are compared.
    """
    count = min(len(nominal_track) - row, len(corrected_track) - partner, _RUN_CHUNK)
    nominal_part = _part(nominal_track, slice(row, row + count))
    corrected_part = _part(corrected_track, slice(partner, partner + count))
    is_same = (norm(corrected_part.position - nominal_part.position) < _EQUAL_DISTANCE) & (
        np.abs(corrected_part.step - nominal_part.step) < _EQUAL_DISTANCE
    )
    is_same &= nominal_part.joint == corrected_part.joint
    return count if is_same.all() else int(np.argmin(is_same))


def _cheapest_states(pair_states: _States, unpaired_states: _States, unpaired_cost: float) -> _States:
    """Return the cheapest assignments of the targets up to one: those that pair it, and those that do not.

    :param pair_states: assignments that end with a pair of this target.
    :param unpaired_states: assignments of the targets before, which leave this target without partner.
    :param unpaired_cost: cost of leaving this target without partner.
    """
    cost = np.concatenate([pair_states.cost, unpaired_states.cost + unpaired_cost])
    cheapest_rows = (
        np.argpartition(cost, _MAX_STATES)[:_MAX_STATES] if len(cost) > _MAX_STATES else np.arange(len(cost))
    )
    return _States(
        np.concatenate([pair_states.partner, unpaired_states.partner])[cheapest_rows],
        np.concatenate([pair_states.row, unpaired_states.row])[cheapest_rows],
        cost[cheapest_rows],
        np.concatenate([pair_states.offset, unpaired_states.offset])[cheapest_rows],
    )
