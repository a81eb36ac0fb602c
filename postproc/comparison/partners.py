"""Which target of the second program belongs to which of the nominal one: pairs, and what has no partner.

A pair is a nominal target and its partner, the target of the second program that is to be the same place on the part.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc import toolpath
from postproc.comparison.loaded_path import deviation, no_equilibrium
from postproc.comparison.paths import (
    NO_DISTANCE,
    Curves,
    PlacedProgram,
    commanded_positions,
    distances_from_path,
    in_cell,
    nearest,
    stretch_limits,
    tool_of_nominal,
)
from postproc.comparison.result import OFF_PATH, TIMES_OFFSET, Comparison
from postproc.errors import NotConvergedError
from postproc.forces import PathForces
from postproc.frames import Array, norm, twist_between
from postproc.program import PTP, Bools, Ints

_MAX_MOVES, _MAX_CANDIDATES = 200, 64
"""Largest number of targets for which other partners are tried, and largest number of partners tried for each: with
more, the second program is another one (assumed)."""


def partners_of(comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram) -> Ints:
    """Return the partner (n,) of each target of the nominal program: its index in the second program; −1 for none.

    Indices are in `PlacedProgram.target_rows`, the motions that have a Cartesian target.
    """
    partner = np.full(len(nominal_path.target_rows), -1)
    partner[np.searchsorted(nominal_path.target_rows, comparison.pair[:, 0])] = np.searchsorted(
        corrected_path.target_rows, comparison.pair[:, 1]
    )
    return partner


def deviations_by_partners(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, partner: Ints, wrench: Array
) -> Array:
    """Return the deviations (n, 3) of the loaded tip by the second program at `nominal_path.target_rows`, `$BASE` [m].

    The deviation of a target without a partner is 0.

    :param partner: (n,) index in `corrected_path.target_rows`; −1 for none.
    :param wrench: (n, 6) at the tip, root axes [N, N·m].
    :raises ForceError: the arm has no equilibrium under a force.
    """
    deviations, has_partner = np.zeros((len(nominal_path.target_rows), 3)), partner >= 0
    rows = corrected_path.target_rows[partner[has_partner]]
    deviations[has_partner] = deviation(
        nominal_path,
        nominal_path.target_rows[has_partner],
        corrected_path.joints[rows],
        wrench[has_partner],
        corrected_path.carriage_displacement(rows),
    )
    return deviations


def partners_under_force(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, partner: Ints, wrench: Array
) -> Ints:
    """Return the partners (n,) of the nominal targets, replaced by free neighbours that bring the loaded tip to them.

    A partner is replaced only if the tip misses the target by more than the tolerance.

    :param partner: (n,) index in `corrected_path.target_rows` of the present partners; −1 for none.
    :param wrench: (n, 6) at the tip, root axes [N, N·m].
    :raises ForceError: the arm has no equilibrium under a force.
    """
    tolerance, new_partner = nominal_path.robot_in_cell.tolerance, partner.copy()
    # a PTP is no partner of a line or an arc
    is_ptp = nominal_path.program.motions.kind[nominal_path.target_rows] == PTP
    is_corrected_ptp = corrected_path.program.motions.kind[corrected_path.target_rows] == PTP
    for _ in range(2):  # a partner that the first pass replaced may be that of a neighbour
        distances = norm(deviations_by_partners(nominal_path, corrected_path, new_partner, wrench))
        is_mismatched = (new_partner < 0) | ~(distances <= tolerance)
        for k in np.flatnonzero(is_mismatched)[:_MAX_MOVES].tolist():
            candidates = _free_neighbours(new_partner, k, len(corrected_path.target_rows))
            candidates = candidates[is_corrected_ptp[candidates] == is_ptp[k]]
            # those next to the present partner first
            candidates = candidates[np.argsort(np.abs(candidates - partner[k]), kind="stable")[:_MAX_CANDIDATES]]
            candidate_distances = _loaded_distances(nominal_path, corrected_path, candidates, k, wrench[k])
            if candidate_distances.min(initial=np.inf) <= tolerance:
                new_partner[k] = candidates[np.argmin(candidate_distances)]
    return new_partner


def _loaded_distances(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, candidates: Ints, k: int, wrench: Array
) -> Array:
    """Return the distances (c,) [m] of the loaded tip from nominal target `k` at targets of the second program.

    :param candidates: (c,) indices of these targets in `corrected_path.target_rows`.
    :param wrench: (6,) at the tip at target `k`, root axes [N, N·m].
    :raises ForceError: the arm has no equilibrium under the force.
    """
    rows, count = corrected_path.target_rows[candidates], len(candidates)
    deviations = deviation(
        nominal_path,
        np.repeat(nominal_path.target_rows[k], count),
        corrected_path.joints[rows],
        np.tile(wrench, (count, 1)),
        corrected_path.carriage_displacement(rows),
    )
    return norm(deviations)


def _free_neighbours(partner: Ints, k: int, count: int) -> Ints:
    """Return the targets of the second program that nominal target `k` may have as partner, ascending.

    They are between the partners of the targets before and after it.

    :param partner: (n,) indices of the partners, ascending; −1 for none.
    :param count: number of targets of the second program.
    """
    preceding_partners, following_partners = (side[side >= 0] for side in (partner[:k], partner[k + 1 :]))
    begin = preceding_partners[-1] + 1 if len(preceding_partners) else 0
    end = following_partners[0] if len(following_partners) else count
    return np.arange(begin, end)


class _PairedTargets(NamedTuple):
    """Offsets of pairs, and the second program's targets without a partner.

    :param pose: (P, 4, 4) poses to which the second program sends the nominal tool, nominal `$BASE` [m].
    :param twist: (P, 6) from the nominal targets to these poses [m, rad].
    :param unpaired_rows: (r,) motions of the second program without a partner.
    :param is_on_path: (r,) True for those on the nominal path between two pairs.
    """

    pose: Array
    twist: Array
    unpaired_rows: Ints
    is_on_path: Bools


def _paired_targets(nominal_path: PlacedProgram, corrected_path: PlacedProgram, pair: Ints) -> _PairedTargets:
    """Return the offsets of pairs (P, 2), and the targets that they leave without a partner."""
    pose, twist = offsets_of(nominal_path, corrected_path, pair)
    unpaired_rows = np.setdiff1d(corrected_path.target_rows, pair[:, 1])
    is_on_path = _is_on_path(nominal_path, corrected_path, pair, norm(twist[:, :3]), unpaired_rows)
    return _PairedTargets(pose, twist, unpaired_rows, is_on_path)


def pair_targets(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, partner: Ints, is_certain: Bools
) -> Comparison:
    """Return the comparison of `nominal_path.target_rows` with their partners.

    All nominal targets without a partner count as missing until `judge_unpaired`; there are no forces and differences.

    :param partner: (n,) index in `corrected_path.target_rows`; −1 for none.
    :param is_certain: (n,) True where the partner is right for certain, so that no neighbour of it is tried.
    """
    nominal, corrected, has_partner = nominal_path.program, corrected_path.program, partner >= 0
    # (P, 2) motions of both programs
    pair = np.stack([nominal_path.target_rows[has_partner], corrected_path.target_rows[partner[has_partner]]], axis=1)
    targets = _paired_targets(nominal_path, corrected_path, pair)
    is_joint_motion = corrected.motions.kind[targets.unpaired_rows] == PTP
    rows_off_path = targets.unpaired_rows[~targets.is_on_path | is_joint_motion]  # a moved target may be a PTP
    if len(rows_off_path):
        pair = moved_pairs(
            nominal_path,
            corrected_path,
            pair,
            offset=targets.twist[:, :3],
            rows=rows_off_path,
            is_certain=is_certain[has_partner],
        )
        targets = _paired_targets(nominal_path, corrected_path, pair)
    curves = Curves.of(nominal_path, corrected_path, pair)
    return Comparison(
        nominal=nominal,
        corrected=corrected,
        robot=nominal_path.robot_in_cell.robot.name,
        pair=pair,
        inserted_rows=targets.unpaired_rows[targets.is_on_path],
        passed_rows=nominal_path.target_rows[:0],
        passing_distance=np.zeros(0),
        only_nominal=nominal_path.target_rows[~has_partner],
        missing_distance=np.full(int((~has_partner).sum()), np.nan),
        additional_rows=targets.unpaired_rows[~targets.is_on_path],
        pose=targets.pose,
        rotation=norm(targets.twist[:, 3:]),
        path_length=nominal_path.segments.length,
        curves=curves,
        path_distance=np.full(len(pair), np.nan) if curves is None else curves.largest_gaps(),
        cuts=None,
        differences=(),
    )


def judge_unpaired(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram, load: PathForces | None
) -> Comparison:
    """Return the comparison with its missing targets divided into those that the second path passes and missing ones.

    :param load: forces along the nominal program; None if they are not known.
    :raises ForceError: the arm has no equilibrium under a force.
    """
    distances, is_passed = missed_targets(comparison, nominal_path, corrected_path, load)
    rows = comparison.only_nominal
    comparison = replace(comparison, passed_rows=rows[is_passed], passing_distance=distances[is_passed])
    return replace(comparison, only_nominal=rows[~is_passed], missing_distance=distances[~is_passed])


def moved_partners(comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram) -> Ints:
    """Return the partners (n,) of nominal targets that the second program has moved away; −1 for none.

    A partner is an index in `corrected_path.target_rows`. If there are equal numbers of missing and additional targets
    between the same two pairs, they are partners in their order: the first missing one and the first additional one,
    and so on. Both must be PTP, or both not.
    """
    partner = np.full(len(nominal_path.target_rows), -1)
    missing_rows, additional_rows = comparison.only_nominal, comparison.additional_rows
    # a gap is the number of pairs before a target: targets of one gap are between the same pairs
    gap_count = len(comparison.pair) + 1
    missing_gap = np.searchsorted(comparison.pair[:, 0], missing_rows)
    additional_gap = np.searchsorted(comparison.pair[:, 1], additional_rows)
    is_equal_count = np.bincount(missing_gap, minlength=gap_count) == np.bincount(additional_gap, minlength=gap_count)
    # rows are ascending, and now equally many in each gap: element k of one array is the partner of k of the other
    missing_rows = missing_rows[is_equal_count[missing_gap]]
    additional_rows = additional_rows[is_equal_count[additional_gap]]
    is_missing_ptp = nominal_path.program.motions.kind[missing_rows] == PTP
    is_additional_ptp = corrected_path.program.motions.kind[additional_rows] == PTP
    is_same_kind = is_missing_ptp == is_additional_ptp
    nominal_indices = np.searchsorted(nominal_path.target_rows, missing_rows[is_same_kind])
    partner[nominal_indices] = np.searchsorted(corrected_path.target_rows, additional_rows[is_same_kind])
    return partner


def ordered_partners(partner: Ints) -> Ints:
    """Return partners (n,) in ascending order: −1 replaces those that are not behind all partners before them.

    :param partner: (n,) index in the second program of the partners of consecutive targets; −1 for none.
    """
    return np.where(partner <= np.maximum.accumulate(np.append(-1, partner[:-1])), -1, partner)


def count_as_inserted(comparison: Comparison, on_path: Bools) -> Comparison:
    """Return the comparison with some additional targets counted as inserted.

    :param on_path: (a,) True for those of `comparison.additional_rows` that count as inserted.
    """
    inserted_rows = np.sort(np.append(comparison.inserted_rows, comparison.additional_rows[on_path]))
    return replace(comparison, inserted_rows=inserted_rows, additional_rows=comparison.additional_rows[~on_path])


def missed_targets(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram, load: PathForces | None
) -> tuple[Array, Bools]:
    """Return the distances of the second path from nominal targets without partner (n,) [m], and which it passes (n,).

    A target without partner is passed if the second path goes through it, and missing if not. With forces, it is passed
    within the tolerance. Without forces the correction is unknown: the difference of the offsets of the two
    neighbouring pairs is subtracted from the distance, and a point that only divides a line or an arc is passed within
    a multiple of these offsets.

    :param load: forces along the nominal program; None if they are not known.
    :raises ForceError: the arm has no equilibrium under a force.
    """
    rows, tolerance = comparison.only_nominal, nominal_path.robot_in_cell.tolerance
    commanded_position, nominal_position = (
        in_cell(comparison.nominal, comparison.pair[:, 0], pose[:, :3, 3])
        for pose in (comparison.pose, comparison.target)
    )
    offset = commanded_position - nominal_position
    distances = missing_distances(nominal_path, corrected_path, comparison.pair, rows, load, offset)
    if load is not None or not len(comparison.pair):
        return distances, distances <= tolerance
    pair_index = np.searchsorted(comparison.pair[:, 0], rows)
    previous_pair, next_pair = np.maximum(pair_index - 1, 0), np.minimum(pair_index, len(comparison.pair) - 1)
    largest_offset = np.maximum(comparison.distance[previous_pair], comparison.distance[next_pair])
    is_near_curve = distances <= OFF_PATH + TIMES_OFFSET * largest_offset
    distances = np.maximum(distances - norm(offset[next_pair] - offset[previous_pair]), 0.0)
    return distances, (distances <= tolerance) | (nominal_path.is_continued[rows] & is_near_curve)


def offsets_of(nominal_path: PlacedProgram, corrected_path: PlacedProgram, pair: Ints) -> tuple[Array, Array]:
    """Return the poses to which the second program sends the nominal tool, and their offsets from the nominal targets.

    :param pair: (P, 2) motions of the pairs.
    :returns: poses (P, 4, 4) in the nominal `$BASE` [m], and twists (P, 6) from the nominal targets to them [m, rad].
    """
    target = corrected_path.program.motions.target[pair[:, 1]]
    pose = tool_of_nominal(nominal_path.program, pair[:, 0], corrected_path.program, pair[:, 1], target)
    return pose, twist_between(nominal_path.program.motions.target[pair[:, 0]], pose)


def moved_pairs(
    nominal_path: PlacedProgram,
    corrected_path: PlacedProgram,
    pair: Ints,
    *,
    offset: Array,
    rows: Ints,
    is_certain: Bools,
) -> Ints:
    """Return pairs (P, 2) in which moved targets replace their inserted neighbours.

    A target off the path (`rows`) takes the partner of the target next to it under three conditions: the offset of that
    pair is unlike those of both neighbouring pairs; the new offset is no larger; the replaced target is on the path, as
    inserted targets are.

    :param pair: (P, 2) motions of the pairs, `offset` (P, 3) of their targets [m].
    :param rows: (r,) motions of the second program without a partner, off the nominal path.
    :param is_certain: (P,) True for pairs that are right for certain.
    """
    pair, distance = pair.copy(), norm(offset)
    change = np.pad(norm(np.diff(offset, axis=0)), 1, constant_values=np.inf)
    # the offset of the pair is unlike those of both neighbours
    is_single_change = (np.minimum(change[:-1], change[1:]) > OFF_PATH) & ~is_certain
    target_number = {
        row: number for number, row in enumerate(corrected_path.target_rows.tolist())
    }  # of motions with a target
    for row in rows[:_MAX_MOVES].tolist():
        next_pair = int(np.searchsorted(pair[:, 1], row))
        adjacent_pairs = [k for k in (next_pair, next_pair - 1) if 0 <= k < len(pair)]  # behind and before the target
        for k in adjacent_pairs:
            are_neighbours = abs(target_number[int(pair[k, 1])] - target_number[row]) == 1
            is_candidate = is_single_change[k] and are_neighbours
            if is_candidate and _is_moved_target(nominal_path, corrected_path, pair, distance, k, row):
                pair[k, 1] = row
                break
    return pair


def _is_moved_target(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, pair: Ints, distance: Array, k: int, row: int
) -> bool:
    """Return whether motion `row` of the second program is a better partner in pair `k`, and the present one inserted.

    :param pair: (P, 2) motions of the pairs, `distance` (P,) sizes of their offsets [m].
    """
    new_pair, new_distance = pair.copy(), distance.copy()
    # the offset of a moved target may be of any size: it does not widen what counts as on the path
    new_pair[k, 1], new_distance[k] = row, 0.0
    _, new_twist = offsets_of(nominal_path, corrected_path, new_pair[k : k + 1])
    if norm(new_twist[:, :3])[0] > distance[k]:
        return False
    present_partner = pair[k, 1:]
    return bool(_is_on_path(nominal_path, corrected_path, new_pair, new_distance, present_partner)[0])


def _is_on_path(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, pair: Ints, distance: Array, rows: Ints
) -> Bools:
    """Return which targets of the second program without a partner are on the nominal path between two pairs.

    They may be as far from it as a multiple of the larger offset of these pairs. Where the nominal program has a PTP to
    a Cartesian target between the pairs, its path is not known, and none is on it.

    :param pair: (P, 2) motions of the pairs, `distance` (P,) sizes of their offsets [m].
    :param rows: (r,) motions of the second program that end at the targets.
    """
    is_on_path = np.zeros(len(rows), dtype=bool)
    next_pair = np.searchsorted(pair[:, 1], rows)  # the first pair behind each target
    candidates = np.flatnonzero(next_pair < len(pair))  # targets behind the last pair are between no two
    candidates = candidates[~_has_ptp_before(nominal_path, pair[:, 0])[next_pair[candidates]]]
    rows, next_pair = rows[candidates], next_pair[candidates]
    position = commanded_positions(nominal_path.program, pair[next_pair, 0], corrected_path.program, rows)
    previous_distance = np.append(0.0, distance)[next_pair]  # 0 before the first pair
    limit = OFF_PATH + TIMES_OFFSET * np.maximum(previous_distance, distance[next_pair])
    begin, end = stretch_limits(nominal_path, pair[:, 0], next_pair)
    corrected_begin, corrected_end = stretch_limits(corrected_path, pair[:, 1], next_pair)
    # three likely places are cheap to try: at the same share of the stretch, at the same length from its begin, and at
    # the same length to its end
    length = corrected_path.arc_length[rows + 1]
    share = (length - corrected_begin) / np.maximum(corrected_end - corrected_begin, NO_DISTANCE)
    likely_lengths = (begin + share * (end - begin), begin + length - corrected_begin, end - (corrected_end - length))
    points = [nominal_path.points(np.clip(likely_length, begin, end)) for likely_length in likely_lengths]
    path_distance = np.minimum.reduce([norm(position - place) for place in points])
    # the whole stretch is searched for targets that are near none of these places
    distant_rows = np.flatnonzero(~(path_distance <= limit))
    if len(distant_rows):
        path_distance[distant_rows] = distances_from_path(
            nominal_path, position[distant_rows], begin[distant_rows], end[distant_rows]
        )
    is_on_path[candidates] = path_distance <= limit
    return is_on_path


def _has_ptp_before(side: PlacedProgram, paired_rows: Ints) -> Bools:
    """Return for each pair (P,) whether a PTP to a Cartesian target, whose path is not known, is on the stretch to it.

    The stretch to a pair is the path from the pair before it.

    :param paired_rows: (P,) motions of the program that end at the pairs.
    """
    m = side.program.motions
    is_axis_target = np.isfinite(m.joints[:, 0])
    ptp_count = np.append(0, np.cumsum((m.kind == PTP) & ~is_axis_target))  # before each motion, and in all
    # two ends of a stretch with the same count have no PTP between them
    count_at_ends = ptp_count[np.append(-1, paired_rows) + 1]
    return np.asarray(np.diff(count_at_ends) > 0)


def missing_distances(
    nominal_path: PlacedProgram,
    corrected_path: PlacedProgram,
    pair: Ints,
    rows: Ints,
    load: PathForces | None,
    offset: Array,
) -> Array:
    """Return the distances of the second path from nominal targets without partner (n,) [m]; NaN for PTP.

    A path is measured by its arc length from the start of the program.
    With forces, the path is that of the loaded tip. Without, the targets are moved by the offsets of the neighbouring
    pairs, interpolated. Each is compared with the second path between the pairs before and after it.

    :param pair: (P, 2) the pairs; `rows` (n,) nominal motions that end at the targets.
    :param load: forces along the nominal program; None if they are not known.
    :param offset: (P, 3) from the nominal to the commanded position at the pairs, in the cell [m].
    :raises ForceError: the arm has no equilibrium under a force.
    """
    distances = np.full(len(rows), np.nan)
    indices = np.flatnonzero(nominal_path.program.motions.kind[rows] != PTP)
    if not len(pair) or not len(indices):
        return distances
    motion = rows[indices]
    length = nominal_path.arc_length[motion + 1]
    positions = nominal_path.points(length)
    wrench = np.zeros((len(indices), 6)) if load is None else nominal_path.wrench(load, motion)
    if load is None:
        pair_length = nominal_path.arc_length[pair[:, 0] + 1]
        positions = positions + np.stack([np.interp(length, pair_length, column) for column in offset.T], axis=1)
    # arc lengths of the second path at which the pairs are, with its begin and its end
    pair_ends = np.concatenate([[0.0], corrected_path.arc_length[pair[:, 1] + 1], corrected_path.arc_length[-1:]])
    next_pair = np.searchsorted(pair[:, 0], motion)
    begin, end = pair_ends[next_pair], pair_ends[next_pair + 1]

    def second_tips(target: Ints, length: Array) -> Array:
        """Return the tips (m, s, 3) of the second program at arc lengths (m, s), with the loads of targets (m,)."""
        target = np.repeat(target, length.shape[1])
        load_wrench = None if load is None else wrench[target]
        tips = _second_tips(nominal_path, corrected_path, motion[target], length.ravel(), load_wrench)
        return tips.reshape(*length.shape, 3)

    _, distances[indices] = nearest(second_tips, positions, begin, end)
    return distances


def _second_tips(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, motion: Ints, length: Array, wrench: Array | None
) -> Array:
    """Return the tips (n, 3) of the nominal tool where the second program moves it, in the cell [m].

    Infinite under a load where the second program commands a pose out of reach.

    :param motion: (n,) nominal motions whose tool and load count.
    :param length: (n,) arc lengths on the second path [m].
    :param wrench: (n, 6) at the tip, root axes [N, N·m]; None: without deflection.
    :raises ForceError: the arm has no equilibrium under a force.
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
    motion, q, wrench = motion[is_reachable], q[is_reachable], wrench[is_reachable]
    try:
        tips[is_reachable] = nominal_path.loaded_tip(motion, q, wrench, displacement)
    except NotConvergedError as cause:
        raise no_equilibrium(nominal_path.program, motion, cause) from None
    return tips
