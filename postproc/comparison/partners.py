"""Which target of the second program belongs to which of the nominal one: pairs, and what has no partner."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc import toolpath
from postproc.chunks import in_chunks
from postproc.comparison.loaded_path import deviation, no_equilibrium
from postproc.comparison.paths import Curves, PlacedProgram, in_cell, nearest, tool_of_nominal
from postproc.comparison.result import OFF_PATH, TIMES_OFFSET, Comparison
from postproc.errors import NotConvergedError
from postproc.forces import PathForces
from postproc.frames import Array, norm, twist_between
from postproc.program import PTP, Bools, Ints

_MAX_MOVES, _MAX_CANDIDATES = 200, 64
"""Largest numbers of targets for which other partners are tried, and of partners that are tried (assumed): with more,
it is another program."""


def partners_of(comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram) -> Ints:
    """Return the partner (n,) of each of `nominal_path.rows`: its index in `corrected_path.rows`; −1 for none."""
    partner = np.full(len(nominal_path.rows), -1)
    partner[np.searchsorted(nominal_path.rows, comparison.pair[:, 0])] = np.searchsorted(
        corrected_path.rows, comparison.pair[:, 1]
    )
    return partner


def deviation_left(nominal_path: PlacedProgram, corrected_path: PlacedProgram, partner: Ints, wrench: Array) -> Array:
    """Return the deviations (n, 3) of the loaded tip by the second program at `nominal_path.rows`, `$BASE`.

    0 without partner.

    :param partner: (n,) index in `corrected_path.rows`; −1 for none.
    :param wrench: (n, 6) at the tip, root axes.
    """
    deviations, has_partner = np.zeros((len(nominal_path.rows), 3)), partner >= 0
    rows = corrected_path.rows[partner[has_partner]]
    deviations[has_partner] = deviation(
        nominal_path,
        nominal_path.rows[has_partner],
        corrected_path.joints[rows],
        wrench[has_partner],
        corrected_path.carriage_displacement(rows),
    )
    return deviations


def partners_under_force(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, partner: Ints, wrench: Array
) -> Ints:
    """Return partners (n,) of `nominal_path.rows`, swapped for free neighbours that bring the tip to the target.

    :param partner: (n,) index in `corrected_path.rows` of the present partners; −1 for none.
    :param wrench: (n, 6) at the tip, root axes [N, N·m].
    """
    tolerance, new_partner = nominal_path.robot_in_cell.tolerance, partner.copy()
    kinds = (
        nominal_path.program.motions.kind[nominal_path.rows] == PTP,
        corrected_path.program.motions.kind[corrected_path.rows] == PTP,
    )
    for _ in range(2):  # what the first pass frees may be the partner of a neighbour
        is_mismatched = (new_partner < 0) | ~(
            norm(deviation_left(nominal_path, corrected_path, new_partner, wrench)) <= tolerance
        )
        for k in np.flatnonzero(is_mismatched)[:_MAX_MOVES].tolist():
            lower_partners, upper_partners = (
                new_partner[:k][new_partner[:k] >= 0],
                new_partner[k + 1 :][new_partner[k + 1 :] >= 0],
            )
            first_candidate = lower_partners[-1] + 1 if len(lower_partners) else 0
            candidates = np.arange(
                first_candidate, upper_partners[0] if len(upper_partners) else len(corrected_path.rows)
            )
            candidates = candidates[kinds[1][candidates] == kinds[0][k]]
            candidates = candidates[np.argsort(np.abs(candidates - partner[k]), kind="stable")[:_MAX_CANDIDATES]]
            rows, index = corrected_path.rows[candidates], np.full(len(candidates), k)
            q, displacement = corrected_path.joints[rows], corrected_path.carriage_displacement(rows)
            distance = norm(deviation(nominal_path, nominal_path.rows[index], q, wrench[index], displacement))
            if len(candidates) and distance.min() <= tolerance:
                new_partner[k] = candidates[np.argmin(distance)]
    return new_partner


def distances_from_path(nominal_path: PlacedProgram, positions: Array, begin: Array, end: Array) -> Array:
    """Return the distances (n,) of points from the nominal path between two arc lengths [m].

    :param positions: (n, 3) the points, in the cell [m].
    :param begin: (n,) arc length from which the path counts, `end` (n,) to which [m].
    """

    def distances(positions: Array, begin: Array, end: Array) -> tuple[Array]:
        """Return the distances of some of the points."""
        return (
            nearest(
                lambda lengths: nominal_path.points(lengths.ravel()).reshape(*lengths.shape, 3), positions, begin, end
            )[1],
        )

    return in_chunks(distances, positions, begin, end)[0]


def pair_targets(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, partner: Ints, certain: Bools
) -> Comparison:
    """Return the comparison of `nominal_path.rows` with partners (n,), indices in `corrected_path.rows`; −1 for none.

    :param certain: (n,) True where the partner is right for certain, so that no neighbour of it is tried.
    """
    nominal, corrected, has_partner = nominal_path.program, corrected_path.program, partner >= 0
    pair = np.stack([nominal_path.rows[has_partner], corrected_path.rows[partner[has_partner]]], axis=1)
    pose, twists = offsets_of(nominal_path, corrected_path, pair)
    unpaired_rows = np.setdiff1d(corrected_path.rows, pair[:, 1])
    on_path = _is_on_path(nominal_path, corrected_path, pair, norm(twists[:, :3]), unpaired_rows)
    if (~on_path).any():
        pair = moved_pairs(
            nominal_path, corrected_path, pair, twists[:, :3], unpaired_rows[~on_path], certain[has_partner]
        )
        pose, twists = offsets_of(nominal_path, corrected_path, pair)
        unpaired_rows = np.setdiff1d(corrected_path.rows, pair[:, 1])
        on_path = _is_on_path(nominal_path, corrected_path, pair, norm(twists[:, :3]), unpaired_rows)
    curves = Curves.of(nominal_path, corrected_path, pair)
    return Comparison(
        nominal=nominal,
        corrected=corrected,
        robot=nominal_path.robot_in_cell.robot.name,
        pair=pair,
        inserted_rows=unpaired_rows[on_path],
        passed_rows=nominal_path.rows[:0],
        passing_distance=np.zeros(0),
        only_nominal=nominal_path.rows[~has_partner],
        missing_distance=np.full(int((~has_partner).sum()), np.nan),
        additional_rows=unpaired_rows[~on_path],
        pose=pose,
        rotation=norm(twists[:, 3:]),
        path_length=nominal_path.segments.length,
        curves=curves,
        path_distance=np.full(len(pair), np.nan) if curves is None else curves.largest_gaps(),
        cuts=None,
        differences=(),
    )


def judge_unpaired(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram, load: PathForces | None
) -> Comparison:
    """Return the comparison with nominal targets without partner divided into passed and missing ones."""
    distances, is_passed = missed_targets(comparison, nominal_path, corrected_path, load)
    rows = comparison.only_nominal
    comparison = replace(comparison, passed_rows=rows[is_passed], passing_distance=distances[is_passed])
    return replace(comparison, only_nominal=rows[~is_passed], missing_distance=distances[~is_passed])


def moved_partners(comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram) -> Ints:
    """Return the indices (n,) in `corrected_path.rows` of targets moved away from `nominal_path.rows`; −1 for none.

    Those are missing and additional ones, if as many of them are between the same pairs.
    """
    partner = np.full(len(nominal_path.rows), -1)
    unpaired_rows = comparison.only_nominal, comparison.additional_rows
    # a gap is the number of pairs before a target: targets of one gap are between the same pairs
    gaps = [np.searchsorted(comparison.pair[:, k], rows) for k, rows in enumerate(unpaired_rows)]
    counts = [np.bincount(gap, minlength=len(comparison.pair) + 1) for gap in gaps]
    same_count = counts[0] == counts[1]
    missing_rows, additional_rows = (rows[same_count[gap]] for rows, gap in zip(unpaired_rows, gaps, strict=True))
    is_same_kind = (nominal_path.program.motions.kind[missing_rows] == PTP) == (
        corrected_path.program.motions.kind[additional_rows] == PTP
    )
    partner[np.searchsorted(nominal_path.rows, missing_rows[is_same_kind])] = np.searchsorted(
        corrected_path.rows, additional_rows[is_same_kind]
    )
    return partner


def ordered_partners(partner: Ints) -> Ints:
    """Return partners (n,) in ascending order: −1 replaces those that are not behind all partners before them.

    :param partner: (n,) index in the second program of the partners of consecutive targets; −1 for none.
    """
    return np.where(partner <= np.maximum.accumulate(np.append(-1, partner[:-1])), -1, partner)


def count_as_inserted(comparison: Comparison, on_path: Bools) -> Comparison:
    """Return the comparison with those additional targets counted as inserted that are True in `on_path`.

    :param on_path: (a,) one for each of `comparison.additional_rows`.
    """
    inserted_rows = np.sort(np.append(comparison.inserted_rows, comparison.additional_rows[on_path]))
    return replace(comparison, inserted_rows=inserted_rows, additional_rows=comparison.additional_rows[~on_path])


def missed_targets(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram, load: PathForces | None
) -> tuple[Array, Bools]:
    """Return the distances of the second path from nominal targets without partner (n,) [m], and which it passes (n,).

    Without forces the correction is unknown. A distance up to the difference of the offsets of the neighbouring pairs
    is then no miss, and a point that only divides a line or an arc is passed within a multiple of them, as inserted
    targets are on the path.
    """
    rows = comparison.only_nominal
    offset = in_cell(comparison.nominal, comparison.pair[:, 0], comparison.pose[:, :3, 3]) - in_cell(
        comparison.nominal, comparison.pair[:, 0], comparison.target[:, :3, 3]
    )
    distances = missing_distances(nominal_path, corrected_path, comparison.pair, rows, load, offset)
    if load is not None or not len(comparison.pair):
        return distances, distances <= nominal_path.robot_in_cell.tolerance
    pair_after = np.searchsorted(comparison.pair[:, 0], rows)
    previous_pair, next_pair = np.maximum(pair_after - 1, 0), np.minimum(pair_after, len(comparison.pair) - 1)
    is_near_curve = distances <= OFF_PATH + TIMES_OFFSET * np.maximum(
        comparison.distance[previous_pair], comparison.distance[next_pair]
    )
    distances = np.maximum(distances - norm(offset[next_pair] - offset[previous_pair]), 0.0)
    return distances, (distances <= nominal_path.robot_in_cell.tolerance) | (
        nominal_path.is_continued[rows] & is_near_curve
    )


def offsets_of(nominal_path: PlacedProgram, corrected_path: PlacedProgram, pair: Ints) -> tuple[Array, Array]:
    """Return where the second program sends the nominal tool, and the twists from the nominal targets to there.

    :param pair: (P, 2) motions of the pairs.
    :returns: poses (P, 4, 4) in the nominal `$BASE`, and twists (P, 6) [m, rad].
    """
    target = corrected_path.program.motions.target[pair[:, 1]]
    pose = tool_of_nominal(nominal_path.program, pair[:, 0], corrected_path.program, pair[:, 1], target)
    return pose, twist_between(nominal_path.program.motions.target[pair[:, 0]], pose)


def moved_pairs(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, pair: Ints, offset: Array, rows: Ints, certain: Bools
) -> Ints:
    """Return pairs (P, 2) in which moved targets replace their inserted neighbours.

    A target off the path (`rows`) next to one with a partner was moved, and not added, under two conditions: the target
    with the partner is on the path, as inserted ones are, and its offset is the larger one and unlike those of the
    neighbouring pairs.

    :param pair: (P, 2) motions of the pairs, `offset` (P, 3) of their targets [m].
    :param rows: (r,) motions of the second program without a partner, off the nominal path.
    :param certain: (P,) True for pairs that are right for certain.
    """
    pair, distance = pair.copy(), norm(offset)
    change = np.pad(norm(np.diff(offset, axis=0)), 1, constant_values=np.inf)
    # a target moved alone: its offset is unlike those of both neighbours
    is_single_change = (np.minimum(change[:-1], change[1:]) > OFF_PATH) & ~certain
    index = {
        int(row): place for place, row in enumerate(corrected_path.rows.tolist())
    }  # of targets, without the others
    for row in rows[:_MAX_MOVES].tolist():
        next_pair = int(np.searchsorted(pair[:, 1], row))
        for k in (next_pair, next_pair - 1):
            if not 0 <= k < len(pair) or not is_single_change[k] or abs(index[int(pair[k, 1])] - index[row]) != 1:
                continue
            replaced_row, new_pair, new_distance = pair[k, 1:].copy(), pair.copy(), distance.copy()
            # the offset of the moved target may be of any size: it does not widen what counts as on the path
            new_pair[k, 1], new_distance[k] = row, 0.0
            if norm(offsets_of(nominal_path, corrected_path, new_pair[k : k + 1])[1][:, :3])[0] > distance[k]:
                continue
            if _is_on_path(nominal_path, corrected_path, new_pair, new_distance, replaced_row)[0]:
                pair = new_pair
                break
    return pair


def _is_on_path(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, pair: Ints, distance: Array, rows: Ints
) -> Bools:
    """Return which of the second program's targets without partner, `rows` (r,), are on the nominal path.

    They are on the path between two pairs, hardly farther from the nominal path than these are from their partners.

    :param pair: (P, 2) motions of the pairs, `distance` (P,) sizes of their offsets [m].
    """
    is_on_path, m = np.zeros(len(rows), dtype=bool), nominal_path.program.motions
    next_pair = np.searchsorted(pair[:, 1], rows)
    candidates = np.flatnonzero((next_pair < len(pair)) & (corrected_path.program.motions.kind[rows] != PTP))
    # no target on the path if a PTP, whose path is not known, is between the pairs
    ptp_count = np.append(0, np.cumsum((m.kind == PTP) & np.isnan(m.joints[:, 0])))
    next_row, previous_row = pair[next_pair[candidates], 0], np.append(-1, pair[:, 0])[next_pair[candidates]]
    candidates = candidates[ptp_count[next_row + 1] == ptp_count[previous_row + 1]]
    rows, next_pair = rows[candidates], next_pair[candidates]
    next_row, previous_row = pair[next_pair, 0], np.append(-1, pair[:, 0])[next_pair]
    target = toolpath.at(corrected_path.program, corrected_path.segments, rows, np.ones(len(rows))).pose[:]
    pose = toolpath.flange_from_tcp(corrected_path.program, rows, target, None) @ toolpath.tool_of(
        nominal_path.program, next_row
    )
    position = pose[:, :3, 3]
    limit = OFF_PATH + TIMES_OFFSET * np.maximum(np.append(0.0, distance)[next_pair], distance[next_pair])
    begin, end = nominal_path.arc_length[previous_row + 1], nominal_path.arc_length[next_row + 1]
    first_length, last_length = (
        corrected_path.arc_length[np.append(-1, pair[:, 1])[next_pair] + 1],
        corrected_path.arc_length[pair[next_pair, 1] + 1],
    )
    length_at_row, path_distance = corrected_path.arc_length[rows + 1], np.full(len(rows), np.inf)
    # a detour of the other program is on one side only
    share = begin + (length_at_row - first_length) / np.maximum(last_length - first_length, 1e-12) * (end - begin)
    for length in (share, begin + length_at_row - first_length, end - (last_length - length_at_row)):
        path_distance = np.minimum(path_distance, norm(position - nominal_path.points(np.clip(length, begin, end))))
    distant_rows = np.flatnonzero(~(path_distance <= limit))
    if len(distant_rows):
        path_distance[distant_rows] = distances_from_path(
            nominal_path, position[distant_rows], begin[distant_rows], end[distant_rows]
        )
    is_on_path[candidates] = path_distance <= limit
    return is_on_path


def missing_distances(
    nominal_path: PlacedProgram,
    corrected_path: PlacedProgram,
    pair: Ints,
    rows: Ints,
    load: PathForces | None,
    offset: Array,
) -> Array:
    """Return the distances of the second path from nominal targets without partner (n,) [m]; NaN for PTP.

    Under the forces if they are known; else after moving the path back by the offsets of the pairs next to them.

    :param pair: (P, 2) the pairs; `rows` (n,) motions of the nominal program.
    :param load: forces along the nominal program, or None.
    :param offset: (P, 3) from the nominal to the commanded position at the pairs, in the cell [m].
    """
    distances = np.full(len(rows), np.nan)
    indices = np.flatnonzero(nominal_path.program.motions.kind[rows] != PTP)
    if not len(pair) or not len(indices):
        return distances
    motion, positions = rows[indices], nominal_path.points(nominal_path.arc_length[rows[indices] + 1])
    wrench = np.zeros((len(indices), 6)) if load is None else nominal_path.wrench(load, motion)
    pair_after = np.searchsorted(pair[:, 0], motion)
    next_pair = np.minimum(pair_after, len(pair) - 1)
    # a missing target is sought on the second path between the pairs before and behind it
    is_after_pair, is_before_pair = pair_after > 0, pair_after < len(pair)
    begin = np.where(is_after_pair, corrected_path.arc_length[pair[pair_after - 1, 1] + 1], 0.0)
    end = np.where(is_before_pair, corrected_path.arc_length[pair[next_pair, 1] + 1], corrected_path.arc_length[-1])
    if load is None:
        lengths = nominal_path.arc_length[pair[:, 0] + 1]
        offsets = [np.interp(nominal_path.arc_length[motion + 1], lengths, column) for column in offset.T]
        positions = positions + np.stack(offsets, axis=1)

    def distances_in_chunk(motion: Ints, positions: Array, wrench: Array, begin: Array, end: Array) -> tuple[Array]:
        """Return the distances (k,) of the second path from some of the positions (k, 3) [m]."""

        def positions_at(length: Array) -> Array:
            """Return the tips (k, s, 3) of the second program at arc lengths (k, s), with the loads of the targets."""
            index = np.repeat(np.arange(len(length)), length.shape[1])
            load_wrench = None if load is None else wrench[index]
            return _second_tips(nominal_path, corrected_path, motion[index], length.ravel(), load_wrench).reshape(
                *length.shape, 3
            )

        try:
            return (nearest(positions_at, positions, begin, end)[1],)
        except NotConvergedError as cause:
            raise no_equilibrium(nominal_path.program, motion[:1], NotConvergedError(str(cause), [0])) from None

    distances[indices] = in_chunks(distances_in_chunk, motion, positions, wrench, begin, end)[0]
    return distances


def _second_tips(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, motion: Ints, length: Array, wrench: Array | None
) -> Array:
    """Return the tips (n, 3) of the nominal tool where the second program moves it, in the cell [m].

    Infinite where the second program commands a pose out of reach of the loaded robot.

    :param motion: (n,) nominal motions whose tool and load count.
    :param length: (n,) arc lengths on the second path [m].
    :param wrench: (n, 6) at the tip, root axes [N, N·m]; None: without deflection.
    """
    row, t = corrected_path.at(length)
    if wrench is None:
        tool = toolpath.tool_of(nominal_path.program, motion)
        pose = toolpath.at(corrected_path.program, corrected_path.segments, row, t).pose[:]
        return np.asarray((toolpath.flange_from_tcp(corrected_path.program, row, pose, None) @ tool)[:, :3, 3])
    q = corrected_path.joints_at(row, t)
    tips = np.full((len(q), 3), np.inf)
    is_reachable = np.isfinite(q).all(axis=1)
    displacement = corrected_path.carriage_displacement(row, t)[is_reachable]
    tips[is_reachable] = nominal_path.loaded_tip(
        motion[is_reachable], q[is_reachable], wrench[is_reachable], displacement
    )
    return tips
