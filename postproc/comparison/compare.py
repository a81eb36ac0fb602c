"""Two programs compared: targets paired, offsets, and where each would cut under the same force.

Both are seen by the robot: a target is the pose that the flange is sent to, so that programs with different `$BASE` or
`$TOOL` may command the same. Offsets are those of the nominal program's tool, in its `$BASE`.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc import toolpath
from postproc.cell import Cell
from postproc.chunks import in_chunks
from postproc.comparison import deviations
from postproc.comparison.differences import differences
from postproc.comparison.pairing import partners
from postproc.comparison.paths import Curves, PlacedProgram, in_cell, nearest, tool_of_nominal
from postproc.comparison.result import OFF_PATH, TIMES_OFFSET, Comparison
from postproc.forces import ForceSource, PathForces
from postproc.frames import Array, norm, twist_between
from postproc.program import PTP, Bools, Ints, Program
from postproc.robot import RobotModel
from postproc.under_load import RobotInCell

_MOST_MOVED, _MOST_TRIED = 200, 64
"""Targets for which other partners are tried, and how many: where there are more, it is another program."""


def compare(
    nominal: Program,
    corrected: Program,
    robot: RobotModel,
    cell: Cell,
    source: ForceSource | None = None,
    *,
    same_origin: bool = False,
) -> Comparison:
    """Compare two programs for one part.

    :param nominal: the program as it should be cut.
    :param corrected: the program to compare with it.
    :param robot: the robot model.
    :param cell: the cell.
    :param source: forces of the nominal program, in addition to its comments. Without either, the comments of the other
        program count.
    :param same_origin: both are as one conversion read or wrote them: they differ by the correction alone.
    :raises ProgramError: a target is out of reach.
    :raises ForceError: forces that cannot be assigned to the motions, or without an equilibrium of the arm.
    """
    place = RobotInCell.of(robot, cell)
    one, other = PlacedProgram.of(nominal, place), PlacedProgram.of(corrected, place)
    if source is None and not nominal.notes:
        load, wrench = None, np.zeros((len(one.rows), 6))
        partner = partners(one.track(), other.track())
        certain = np.full(len(one.rows), same_origin)
    else:
        load = one.forces(source)
        wrench = one.wrench(load, one.rows)
        off = deviations.deviation(one, one.rows, one.joints[one.rows], wrench, one.carried(one.rows))
        # the second program is expected to command poses that the deflection takes back to the targets
        partner = _under_force(one, other, partners(one.track(-off), other.track()), wrench)
        certain = norm(_left(one, other, partner, wrench)) <= place.tolerance
    # a target that only divides a line or an arc may have a partner that divides it elsewhere: the path passes it then
    divides = one.continued[one.rows] & (partner >= 0) & ~certain & (load is not None)
    found = _judged(_paired(one, other, np.where(divides, -1, partner), certain), one, other, load)
    moved = _moved_alone(found, one, other)
    missing = np.isin(one.rows, found.only_nominal) & divides
    moved[missing] = partner[missing]
    if (moved >= 0).any():
        partner = _in_order(np.maximum(_partner_of(found, one, other), moved))
        found = _judged(_paired(one, other, partner, np.ones(len(partner), dtype=bool)), one, other, load)
    if load is not None:
        kept = np.searchsorted(one.rows, found.pair[:, 0])
        left = _left(one, other, _partner_of(found, one, other), wrench)
        cuts = deviations.at_pairs(found, one, other, wrench[kept], off[kept], left[kept])
        cuts = deviations.between(found, cuts, one, other, load)
        ends = cuts.row[(cuts.t == 1.0) & (cuts.between_corrected <= place.tolerance)]
        found = _with_inserted(replace(found, cuts=cuts), np.isin(found.only_corrected, ends))
    else:
        if same_origin:
            rows, by = (found.passed, found.only_nominal), (found.passed_by, found.missed)
            found = replace(found, passed=np.concatenate(rows), passed_by=np.concatenate(by))
            found = replace(found, only_nominal=one.rows[:0], missed=found.missed[:0])
            found = _with_inserted(found, np.ones(len(found.only_corrected), dtype=bool))
        if corrected.notes:
            first, two = found.pair.T
            wrench = other.wrench(other.forces(None), two)
            offs = (
                deviations.deviation(one, first, side.joints[rows], wrench, side.carried(rows))
                for side, rows in ((one, first), (other, two))
            )
            found = replace(found, cuts=deviations.at_pairs(found, one, other, wrench, *offs))
    return replace(
        found, differences=differences(found, one, other, in_file=source is not None, same_origin=same_origin)
    )


def _partner_of(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Ints:
    """Return the index in `other.rows` of the partner of each of `one.rows`; −1 for none."""
    partner = np.full(len(one.rows), -1)
    partner[np.searchsorted(one.rows, found.pair[:, 0])] = np.searchsorted(other.rows, found.pair[:, 1])
    return partner


def _left(one: PlacedProgram, other: PlacedProgram, partner: Ints, wrench: Array) -> Array:
    """Return the deviations (n, 3) of the loaded tip by the second program at `one.rows`, `$BASE`; 0 without partner.

    :param partner: (n,) index in `other.rows`; −1 for none.
    :param wrench: (n, 6) at the tip, root axes.
    """
    out, has = np.zeros((len(one.rows), 3)), partner >= 0
    rows = other.rows[partner[has]]
    out[has] = deviations.deviation(one, one.rows[has], other.joints[rows], wrench[has], other.carried(rows))
    return out


def _under_force(one: PlacedProgram, other: PlacedProgram, partner: Ints, wrench: Array) -> Ints:
    """Return partners (n,) of `one.rows`, exchanged for free neighbours where only those bring the tip to the target.

    :param wrench: (n, 6) at the tip, root axes.
    """
    tolerance, out = one.place.tolerance, partner.copy()
    kinds = one.program.motions.kind[one.rows] == PTP, other.program.motions.kind[other.rows] == PTP
    for _ in range(2):  # a partner may have been that of a neighbour
        wrong = (out < 0) | ~(norm(_left(one, other, out, wrench)) <= tolerance)
        for k in np.flatnonzero(wrong)[:_MOST_MOVED].tolist():
            before, behind = out[:k][out[:k] >= 0], out[k + 1 :][out[k + 1 :] >= 0]
            first = before[-1] + 1 if len(before) else 0
            free = np.arange(first, behind[0] if len(behind) else len(other.rows))
            free = free[kinds[1][free] == kinds[0][k]]
            free = free[np.argsort(np.abs(free - partner[k]), kind="stable")[:_MOST_TRIED]]
            rows, index = other.rows[free], np.full(len(free), k)
            q, carried = other.joints[rows], other.carried(rows)
            left = norm(deviations.deviation(one, one.rows[index], q, wrench[index], carried))
            if len(free) and left.min() <= tolerance:
                out[k] = free[np.argmin(left)]
    return out


def _near(one: PlacedProgram, spot: Array, begin: Array, end: Array) -> Array:
    """Return the distances (n,) of points (n, 3) from the nominal path between two arc lengths (n,) [m]."""

    def distances(spot: Array, begin: Array, end: Array) -> tuple[Array]:
        return (nearest(lambda at: one.points(at.ravel()).reshape(*at.shape, 3), spot, begin, end)[1],)

    return in_chunks(distances, spot, begin, end)[0]


def _paired(one: PlacedProgram, other: PlacedProgram, partner: Ints, certain: Bools) -> Comparison:
    """Return the comparison of `one.rows` with these partners (n,), indices in `other.rows`; −1 for none.

    :param certain: (n,) True where the partner is right for certain, so that no neighbour of it is tried.
    """
    nominal, corrected, has = one.program, other.program, partner >= 0
    pair = np.stack([one.rows[has], other.rows[partner[has]]], axis=1)
    pose, off = _offsets(one, other, pair)
    rest = np.setdiff1d(other.rows, pair[:, 1])
    on_path = _on_path(one, other, pair, norm(off[:, :3]), rest)
    if (~on_path).any():
        pair = _moved(one, other, pair, off[:, :3], rest[~on_path], certain[has])
        pose, off = _offsets(one, other, pair)
        rest = np.setdiff1d(other.rows, pair[:, 1])
        on_path = _on_path(one, other, pair, norm(off[:, :3]), rest)
    curves = Curves.of(one, other, pair)
    return Comparison(
        nominal=nominal,
        corrected=corrected,
        robot=one.place.robot.name,
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


def _judged(found: Comparison, one: PlacedProgram, other: PlacedProgram, load: PathForces | None) -> Comparison:
    """Return the comparison with nominal targets without partner divided into passed and missing ones."""
    missed, passed = _missing(found, one, other, load)
    rows = found.only_nominal
    found = replace(found, passed=rows[passed], passed_by=missed[passed])
    return replace(found, only_nominal=rows[~passed], missed=missed[~passed])


def _moved_alone(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Ints:
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


def _in_order(partner: Ints) -> Ints:
    """Return partners (n,) without those that are not behind all partners before them; −1 for none."""
    return np.where(partner <= np.maximum.accumulate(np.append(-1, partner[:-1])), -1, partner)


def _with_inserted(found: Comparison, on_path: Bools) -> Comparison:
    """Return the comparison with some of the additional targets, (n,) of them, counted as inserted ones."""
    inserted = np.sort(np.append(found.inserted, found.only_corrected[on_path]))
    return replace(found, inserted=inserted, only_corrected=found.only_corrected[~on_path])


def _missing(
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
    missed = deviations.missed_by(one, other, found.pair, rows, load, offset)
    if load is not None or not len(found.pair):
        return missed, missed <= one.place.tolerance
    way = np.searchsorted(found.pair[:, 0], rows)
    before, behind = np.maximum(way - 1, 0), np.minimum(way, len(found.pair) - 1)
    divides = missed <= OFF_PATH + TIMES_OFFSET * np.maximum(found.distance[before], found.distance[behind])
    missed = np.maximum(missed - norm(offset[behind] - offset[before]), 0.0)
    return missed, (missed <= one.place.tolerance) | (one.continued[rows] & divides)


def _offsets(one: PlacedProgram, other: PlacedProgram, pair: Ints) -> tuple[Array, Array]:
    """Return where the second program sends the nominal tool (P, 4, 4), nominal `$BASE`, and the twists (P, 6)."""
    target = other.program.motions.target[pair[:, 1]]
    pose = tool_of_nominal(one.program, pair[:, 0], other.program, pair[:, 1], target)
    return pose, twist_between(one.program.motions.target[pair[:, 0]], pose)


def _moved(one: PlacedProgram, other: PlacedProgram, pair: Ints, offset: Array, rows: Ints, certain: Bools) -> Ints:
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
            if norm(_offsets(one, other, tried[k : k + 1])[1][:, :3])[0] > distance[k]:
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
    target = toolpath.at(other.program, other.path, rows, np.ones(len(rows))).pose[:]
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
        aside[far] = _near(one, spot[far], begin[far], end[far])
    out[between] = aside <= allowed
    return out
