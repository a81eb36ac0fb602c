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

_MOST_MOVED, _MOST_TRIED = 200, 64
"""Targets for which other partners are tried, and how many: where there are more, it is another program."""


def partners_of(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Ints:
    """Return the index in `other.rows` of the partner of each of `one.rows`; −1 for none."""
    partner = np.full(len(one.rows), -1)
    partner[np.searchsorted(one.rows, found.pair[:, 0])] = np.searchsorted(other.rows, found.pair[:, 1])
    return partner


def deviation_left(one: PlacedProgram, other: PlacedProgram, partner: Ints, wrench: Array) -> Array:
    """Return the deviations (n, 3) of the loaded tip by the second program at `one.rows`, `$BASE`; 0 without partner.

    :param partner: (n,) index in `other.rows`; −1 for none.
    :param wrench: (n, 6) at the tip, root axes.
    """
    out, has = np.zeros((len(one.rows), 3)), partner >= 0
    rows = other.rows[partner[has]]
    out[has] = deviation(one, one.rows[has], other.joints[rows], wrench[has], other.carried(rows))
    return out


def partners_under_force(one: PlacedProgram, other: PlacedProgram, partner: Ints, wrench: Array) -> Ints:
    """Return partners (n,) of `one.rows`, exchanged for free neighbours where only those bring the tip to the target.

    :param wrench: (n, 6) at the tip, root axes.
    """
    tolerance, out = one.robot_in_cell.tolerance, partner.copy()
    kinds = one.program.motions.kind[one.rows] == PTP, other.program.motions.kind[other.rows] == PTP
    for _ in range(2):  # a partner may have been that of a neighbour
        wrong = (out < 0) | ~(norm(deviation_left(one, other, out, wrench)) <= tolerance)
        for k in np.flatnonzero(wrong)[:_MOST_MOVED].tolist():
            before, behind = out[:k][out[:k] >= 0], out[k + 1 :][out[k + 1 :] >= 0]
            first = before[-1] + 1 if len(before) else 0
            free = np.arange(first, behind[0] if len(behind) else len(other.rows))
            free = free[kinds[1][free] == kinds[0][k]]
            free = free[np.argsort(np.abs(free - partner[k]), kind="stable")[:_MOST_TRIED]]
            rows, index = other.rows[free], np.full(len(free), k)
            q, carried = other.joints[rows], other.carried(rows)
            left = norm(deviation(one, one.rows[index], q, wrench[index], carried))
            if len(free) and left.min() <= tolerance:
                out[k] = free[np.argmin(left)]
    return out


def distances_from_path(one: PlacedProgram, spot: Array, begin: Array, end: Array) -> Array:
    """Return the distances (n,) of points (n, 3) from the nominal path between two arc lengths (n,) [m]."""

    def distances(spot: Array, begin: Array, end: Array) -> tuple[Array]:
        return (nearest(lambda at: one.points(at.ravel()).reshape(*at.shape, 3), spot, begin, end)[1],)

    return in_chunks(distances, spot, begin, end)[0]


def paired(one: PlacedProgram, other: PlacedProgram, partner: Ints, certain: Bools) -> Comparison:
    """Return the comparison of `one.rows` with these partners (n,), indices in `other.rows`; −1 for none.

    :param certain: (n,) True where the partner is right for certain, so that no neighbour of it is tried.
    """
    nominal, corrected, has = one.program, other.program, partner >= 0
    pair = np.stack([one.rows[has], other.rows[partner[has]]], axis=1)
    pose, off = offsets_of(one, other, pair)
    rest = np.setdiff1d(other.rows, pair[:, 1])
    on_path = _on_path(one, other, pair, norm(off[:, :3]), rest)
    if (~on_path).any():
        pair = moved_pairs(one, other, pair, off[:, :3], rest[~on_path], certain[has])
        pose, off = offsets_of(one, other, pair)
        rest = np.setdiff1d(other.rows, pair[:, 1])
        on_path = _on_path(one, other, pair, norm(off[:, :3]), rest)
    curves = Curves.of(one, other, pair)
    return Comparison(
        nominal=nominal,
        corrected=corrected,
        robot=one.robot_in_cell.robot.name,
        pair=pair,
        inserted=rest[on_path],
        passed=one.rows[:0],
        passed_by=np.zeros(0),
        only_nominal=one.rows[~has],
        missed=np.full(int((~has).sum()), np.nan),
        only_corrected=rest[~on_path],
        pose=pose,
        rotation=norm(off[:, 3:]),
        curves=curves,
        between=np.full(len(pair), np.nan) if curves is None else curves.apart(),
        cuts=None,
        differences=(),
    )


def judged(found: Comparison, one: PlacedProgram, other: PlacedProgram, load: PathForces | None) -> Comparison:
    """Return the comparison with nominal targets without partner divided into passed and missing ones."""
    missed, passed = missed_targets(found, one, other, load)
    rows = found.only_nominal
    found = replace(found, passed=rows[passed], passed_by=missed[passed])
    return replace(found, only_nominal=rows[~passed], missed=missed[~passed])


def moved_alone(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Ints:
    """Return the indices (n,) in `other.rows` of targets that were moved away from `one.rows`; −1 for none.

    Those are missing and additional ones, if as many of them are between the same pairs.
    """
    out = np.full(len(one.rows), -1)
    alone = found.only_nominal, found.only_corrected
    gaps = [np.searchsorted(found.pair[:, k], rows) for k, rows in enumerate(alone)]
    counts = [np.bincount(gap, minlength=len(found.pair) + 1) for gap in gaps]
    same = counts[0] == counts[1]
    first, second = (rows[same[gap]] for rows, gap in zip(alone, gaps, strict=True))
    alike = (one.program.motions.kind[first] == PTP) == (other.program.motions.kind[second] == PTP)
    out[np.searchsorted(one.rows, first[alike])] = np.searchsorted(other.rows, second[alike])
    return out


def in_order(partner: Ints) -> Ints:
    """Return partners (n,) without those that are not behind all partners before them; −1 for none."""
    return np.where(partner <= np.maximum.accumulate(np.append(-1, partner[:-1])), -1, partner)


def with_inserted(found: Comparison, on_path: Bools) -> Comparison:
    """Return the comparison with some of the additional targets, (n,) of them, counted as inserted ones."""
    inserted = np.sort(np.append(found.inserted, found.only_corrected[on_path]))
    return replace(found, inserted=inserted, only_corrected=found.only_corrected[~on_path])


def missed_targets(
    found: Comparison, one: PlacedProgram, other: PlacedProgram, load: PathForces | None
) -> tuple[Array, Bools]:
    """Return by how much the second path misses nominal targets without partner (n,) [m], and which it passes (n,).

    Without forces the correction is unknown. What the offsets of the pairs next to it differ by is then no miss, and a
    point that only divides a line or an arc is passed within a multiple of them, as inserted targets are on the path.
    """
    rows = found.only_nominal
    offset = in_cell(found.nominal, found.pair[:, 0], found.pose[:, :3, 3]) - in_cell(
        found.nominal, found.pair[:, 0], found.target[:, :3, 3]
    )
    missed = missed_by(one, other, found.pair, rows, load, offset)
    if load is not None or not len(found.pair):
        return missed, missed <= one.robot_in_cell.tolerance
    way = np.searchsorted(found.pair[:, 0], rows)
    before, behind = np.maximum(way - 1, 0), np.minimum(way, len(found.pair) - 1)
    divides = missed <= OFF_PATH + TIMES_OFFSET * np.maximum(found.distance[before], found.distance[behind])
    missed = np.maximum(missed - norm(offset[behind] - offset[before]), 0.0)
    return missed, (missed <= one.robot_in_cell.tolerance) | (one.continued[rows] & divides)


def offsets_of(one: PlacedProgram, other: PlacedProgram, pair: Ints) -> tuple[Array, Array]:
    """Return where the second program sends the nominal tool (P, 4, 4), nominal `$BASE`, and the twists (P, 6)."""
    target = other.program.motions.target[pair[:, 1]]
    pose = tool_of_nominal(one.program, pair[:, 0], other.program, pair[:, 1], target)
    return pose, twist_between(one.program.motions.target[pair[:, 0]], pose)


def moved_pairs(
    one: PlacedProgram, other: PlacedProgram, pair: Ints, offset: Array, rows: Ints, certain: Bools
) -> Ints:
    """Return pairs (P, 2) with targets that were moved instead of their neighbours.

    A target off the path (`rows`) next to one that has a partner was moved, and not added, if that other one is on
    the path as inserted ones are, and its offset is like that of neither neighbouring pair, and the larger one.
    """
    pair, distance = pair.copy(), norm(offset)
    change = np.pad(norm(np.diff(offset, axis=0)), 1, constant_values=np.inf)
    odd = (np.minimum(change[:-1], change[1:]) > OFF_PATH) & ~certain
    index = {int(row): place for place, row in enumerate(other.rows.tolist())}
    for row in rows[:_MOST_MOVED].tolist():
        behind = int(np.searchsorted(pair[:, 1], row))
        for k in (behind, behind - 1):
            if not 0 <= k < len(pair) or not odd[k] or abs(index[int(pair[k, 1])] - index[row]) != 1:
                continue
            released, tried, known = pair[k, 1:], pair.copy(), distance.copy()
            tried[k, 1], known[k] = row, 0.0
            if norm(offsets_of(one, other, tried[k : k + 1])[1][:, :3])[0] > distance[k]:
                continue
            if _on_path(one, other, tried, known, released.copy())[0]:
                pair = tried
                break
    return pair


def _on_path(one: PlacedProgram, other: PlacedProgram, pair: Ints, distance: Array, rows: Ints) -> Bools:
    """Return which of the second program's targets without partner, `rows` (r,), are on the nominal path.

    That is: on the way to a pair, hardly farther from the nominal path than the offsets (P,) there.
    """
    out, m = np.zeros(len(rows), dtype=bool), one.program.motions
    behind = np.searchsorted(pair[:, 1], rows)
    between = np.flatnonzero((behind < len(pair)) & (other.program.motions.kind[rows] != PTP))
    unknown = np.append(0, np.cumsum((m.kind == PTP) & np.isnan(m.joints[:, 0])))
    last, before = pair[behind[between], 0], np.append(-1, pair[:, 0])[behind[between]]
    between = between[unknown[last + 1] == unknown[before + 1]]
    rows, behind = rows[between], behind[between]
    last, before = pair[behind, 0], np.append(-1, pair[:, 0])[behind]
    target = toolpath.at(other.program, other.segments, rows, np.ones(len(rows))).pose[:]
    pose = toolpath.flange_from_tcp(other.program, rows, target, None) @ toolpath.tool_of(one.program, last)
    spot = pose[:, :3, 3]
    allowed = OFF_PATH + TIMES_OFFSET * np.maximum(np.append(0.0, distance)[behind], distance[behind])
    begin, end = one.along[before + 1], one.along[last + 1]
    first, final = other.along[np.append(-1, pair[:, 1])[behind] + 1], other.along[pair[behind, 1] + 1]
    here, aside = other.along[rows + 1], np.full(len(rows), np.inf)
    # a detour of the other program is on one side only
    share = begin + (here - first) / np.maximum(final - first, 1e-12) * (end - begin)
    for length in (share, begin + here - first, end - (final - here)):
        aside = np.minimum(aside, norm(spot - one.points(np.clip(length, begin, end))))
    far = np.flatnonzero(~(aside <= allowed))
    if len(far):
        aside[far] = distances_from_path(one, spot[far], begin[far], end[far])
    out[between] = aside <= allowed
    return out


def missed_by(
    one: PlacedProgram, other: PlacedProgram, pair: Ints, rows: Ints, load: PathForces | None, offset: Array
) -> Array:
    """Return by how much the second path misses nominal targets without partner (n,) [m]; NaN for PTP.

    Under the forces if they are known; else after moving the path back by the offsets of the pairs next to them.

    :param pair: (P, 2) the pairs; `rows` (n,) motions of the nominal program.
    :param load: forces along the nominal program, or None.
    :param offset: (P, 3) from the nominal to the commanded position at the pairs, in the cell [m].
    """
    out = np.full(len(rows), np.nan)
    some = np.flatnonzero(one.program.motions.kind[rows] != PTP)
    if not len(pair) or not len(some):
        return out
    motion, wanted = rows[some], one.points(one.along[rows[some] + 1])
    wrench = np.zeros((len(some), 6)) if load is None else one.wrench(load, motion)
    way = np.searchsorted(pair[:, 0], motion)
    last = np.minimum(way, len(pair) - 1)
    begin = np.where(way > 0, other.along[pair[way - 1, 1] + 1], 0.0)
    end = np.where(way < len(pair), other.along[pair[last, 1] + 1], other.along[-1])
    if load is None:
        lengths = one.along[pair[:, 0] + 1]
        moved = [np.interp(one.along[motion + 1], lengths, column) for column in offset.T]
        wanted = wanted + np.stack(moved, axis=1)

    def distance(motion: Ints, wanted: Array, wrench: Array, begin: Array, end: Array) -> tuple[Array]:
        def points(length: Array) -> Array:
            which = np.repeat(np.arange(len(length)), length.shape[1])
            row, t = other.at(length.ravel())
            if load is None:
                tool = toolpath.tool_of(one.program, motion[which])
                pose = toolpath.at(other.program, other.segments, row, t).pose[:]
                spot = (toolpath.flange_from_tcp(other.program, row, pose, None) @ tool)[:, :3, 3]
            else:
                q = other.joints_at(row, t)
                spot = np.full((len(q), 3), np.inf)
                good = np.isfinite(q).all(axis=1)
                which = which[good]
                carried = other.carried(row, t)[good]
                spot[good] = one.loaded_tip(motion[which], q[good], wrench[which], carried)
            return spot.reshape(*length.shape, 3)

        try:
            return (nearest(points, wanted, begin, end)[1],)
        except NotConvergedError as cause:
            raise no_equilibrium(one.program, motion[:1], NotConvergedError(str(cause), [0])) from None

    out[some] = in_chunks(distance, motion, wanted, wrench, begin, end)[0]
    return out
