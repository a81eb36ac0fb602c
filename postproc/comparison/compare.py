"""Two programs compared: targets paired, offsets, and where each would cut under the same force, also between targets.

Both are seen by the robot: a target is the pose that the flange is sent to, so that programs with different `$BASE` or
`$TOOL` may command the same. Offsets are those of the nominal program's tool, in its `$BASE`.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import toolpath
from postproc.cell import Cell
from postproc.chunks import in_chunks
from postproc.comparison.differences import differences
from postproc.comparison.pairing import partners
from postproc.comparison.paths import Curves, PlacedProgram, file_and_line, in_cell, nearest, tool_of_nominal
from postproc.comparison.result import OFF_PATH, TIMES_OFFSET, Comparison, Cuts
from postproc.errors import ForceError, NotConvergedError
from postproc.forces import BEHIND_STEP, ForceSource, PathForces
from postproc.frames import Array, angle_between, norm, twist_between
from postproc.program import CIRC, LIN, PTP, SPL, Bools, Ints, Program
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
    ends: Bools | None = None,
) -> Comparison:
    """Compare two programs for one part.

    :param nominal: the program as it should be cut.
    :param corrected: the program to compare with it.
    :param robot: the robot model.
    :param cell: the cell.
    :param source: forces of the nominal program, in addition to its comments. Without either, the comments of the other
        program count.
    :param same_origin: both are as one conversion read or wrote them: they differ by the correction alone.
    :param ends: (n,) whether Cartesian targets of the second program end a motion of the first, or were inserted, as
        the conversion states it; None: pairs follow from their places.
    :raises ProgramError: a target is out of reach.
    :raises ForceError: forces that cannot be assigned to the motions, or without an equilibrium of the arm.
    """
    place = RobotInCell.of(robot, cell)
    one, other = PlacedProgram.of(nominal, place), PlacedProgram.of(corrected, place)
    stated = _stated_partners(one, other, ends)
    if source is None and not nominal.notes:
        load, wrench = None, np.zeros((len(one.rows), 6))
        partner = partners(one.track(), other.track()) if stated is None else stated
        certain = np.full(len(one.rows), same_origin)
    else:
        load = one.forces(source)
        wrench = one.wrench(load, one.rows)
        off = deviation(one, one.rows, one.joints[one.rows], wrench, one.carried(one.rows))
        if stated is None:
            # the second program is expected to command poses that the deflection takes back to the targets
            partner = _under_force(one, other, partners(one.track(-off), other.track()), wrench)
            certain = norm(_left(one, other, partner, wrench)) <= place.tolerance
        else:
            partner, certain = stated, np.ones(len(stated), dtype=bool)
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
        cuts = at_pairs(found, one, other, wrench[kept], off[kept], left[kept])
        cuts = between(found, cuts, one, other, load)
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
                deviation(one, first, side.joints[rows], wrench, side.carried(rows))
                for side, rows in ((one, first), (other, two))
            )
            found = replace(found, cuts=at_pairs(found, one, other, wrench, *offs))
    known = load is not None or stated is not None
    options = {"in_file": source is not None, "same_origin": same_origin, "pairs_are_known": known}
    return replace(found, differences=differences(found, one, other, **options))


def _stated_partners(one: PlacedProgram, other: PlacedProgram, ends: Bools | None) -> Ints | None:
    """Return the index in `other.rows` of the partner of each of `one.rows` (n,), as the conversion states it.

    :returns: None where nothing is stated, or not for programs of so many targets.
    """
    if ends is None or len(ends) != len(other.rows) or int(np.count_nonzero(ends)) != len(one.rows):
        return None
    return np.flatnonzero(ends)


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
    out[has] = deviation(one, one.rows[has], other.joints[rows], wrench[has], other.carried(rows))
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
            left = norm(deviation(one, one.rows[index], q, wrench[index], carried))
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
    missed = missed_by(one, other, found.pair, rows, load, offset)
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


_ROUNDS, _AHEAD, _STILL = 4, 1e-6, 0.05
"""Gauss-Newton steps to the nearest place of the path; the step of its finite differences [m]; a rate of change per
length below which the place does not matter."""
_EXACT = 1e-8
"""A distance at targets that is not improved further [m]."""
_CLOSE = 0.2
"""A distance between targets, as a share of the tolerance, that is not improved further."""
_TRIED, _RAMPS, _SAMPLES, _CLOSER = 65, 3.0, 9, 3
"""Places tried on the whole way, and on this many times the ramp of a force; then refined so often."""
_FIRST = np.geomspace(1e-5, 1e-2, 13)
"""And these shares of the way: where a move begins with a step, the force may change over some micrometres."""
_PROBE = np.array([100.0, 100.0, 100.0, 10.0, 10.0, 10.0])
"""Forces [N] and moments [N·m] from which the compliance at the tip is taken."""
_LONG, _SPACING = 0.005, 0.010
"""Lines longer than the first [m] are checked at the spacing of the second, shorter ones in their middle."""
_QUARTERS = 4
"""Parts at the ends of which an arc is checked at least."""
_SHORTEST = 2.0 * BEHIND_STEP
"""Nominal way [m] below which a piece is not checked between its ends."""


def deviation(side: PlacedProgram, motion: Ints, q: Array, wrench: Array, carried: Array) -> Array:
    """Return the loaded tip minus the targets of motions (n,), as (n, 3) in their `$BASE` [m].

    :param q: (n, 6) commanded joint angles [rad].
    :param wrench: (n, 6) at the tip, root axes [N, N·m].
    :param carried: (n, 3) how far E1 has carried the robot [m].
    :raises ForceError: the arm has no equilibrium under the force.
    """
    program = side.program

    def off(motion: Ints, q: Array, wrench: Array, carried: Array) -> tuple[Array]:
        tip = side.place.tip(q, toolpath.tool_of(program, motion), wrench) + carried
        return (toolpath.points_in_base(program, motion, tip, None) - program.motions.target[motion, :3, 3],)

    try:
        return in_chunks(off, motion, q, wrench, carried)[0]
    except NotConvergedError as cause:
        raise _no_equilibrium(program, motion, cause) from None


def _no_equilibrium(program: Program, motion: Ints, cause: NotConvergedError) -> ForceError:
    file, line = file_and_line(program, int(motion[cause.rows[0]]))
    return ForceError(f"the arm does not hold this force here: {cause}", file=file, line=line)


def at_pairs(
    found: Comparison, one: PlacedProgram, other: PlacedProgram, wrench: Array, nominal: Array, corrected: Array
) -> Cuts:
    """Return the deviations at the pairs.

    :param wrench: (P, 6) at the tip, root axes [N, N·m].
    :param nominal: (P, 3) by the nominal program, `corrected` (P, 3) by the second one, nominal `$BASE` [m].
    """
    rotation = found.nominal.bases[found.nominal.motions.base[found.pair[:, 0]], :3, :3]
    turned = np.einsum("nji,nkj->nki", rotation, wrench.reshape(-1, 2, 3)).reshape(-1, 6)
    none = np.zeros(0)
    return Cuts(turned, nominal, corrected, _turned(found, one, wrench), np.zeros(0, dtype=np.int64), *(5 * (none,)))


def _turned(found: Comparison, one: PlacedProgram, wrench: Array) -> Array:
    """Return the angle between the commanded orientation and the one that keeps the loaded tool nominal (P,) [rad]."""
    program = found.nominal

    def angle(motion: Ints, wrench: Array, pose: Array) -> tuple[Array]:
        target = toolpath.pose_in_root(program, motion, program.motions.target[motion])
        wanted = one.place.compensate(target, one.joints[motion], toolpath.tool_of(program, motion), wrench).pose
        wanted = toolpath.pose_in_base(program, motion, wanted)
        return (angle_between(wanted[:, :3, :3], pose[:, :3, :3]),)

    try:
        return in_chunks(angle, found.pair[:, 0], wrench, found.pose)[0]
    except NotConvergedError as cause:
        raise _no_equilibrium(program, found.pair[:, 0], cause) from None


def between(found: Comparison, cuts: Cuts, one: PlacedProgram, other: PlacedProgram, load: PathForces) -> Cuts:
    """Return the deviations with those at the other targets of the second program, and between targets.

    Each place of the second program belongs to the place of the nominal path, on the way between the same pairs, that
    the loaded tip is nearest to.

    :param load: the forces along the nominal program.
    """
    ways = _Ways.of_pairs(found, one, other)
    ends, pieces = ways.targets(found), ways.pieces()
    reached = np.isfinite(joints := other.joints_at(ends, np.ones(len(ends)))).all(axis=1)
    ends, joints = ends[reached], joints[reached]
    search = _Search(one, other, load, ways)
    at_ends = search.found(ends, np.ones(len(ends)), joints, ways.guess(ends), enough=_EXACT)
    place = np.full(len(other.program.motions), np.nan)
    place[found.pair[:, 1]] = one.along[found.pair[:, 0] + 1]
    place[ends] = at_ends[0]
    begin = ways.begins(pieces, place)
    settled = (place[pieces] - begin > _SHORTEST) & ~_begins_with_step(one, load, place[pieces])
    pieces, begin = pieces[settled], begin[settled]
    row, t = _spread(other, pieces)
    which = np.searchsorted(pieces, row)
    guess = begin[which] + t * (place[row] - begin[which])
    joints = in_chunks(lambda row, t: (other.joints_at(row, t),), row, t)[0]
    reached = np.isfinite(joints).all(axis=1)
    row, t, guess, joints = row[reached], t[reached], guess[reached], joints[reached]
    inside = search.found(row, t, joints, guess, enough=_CLOSE * one.place.tolerance)
    turned = np.zeros(len(ends) + len(row))
    turned[: len(ends)] = in_chunks(lambda length, row: (_turned_at(one, other, load, length, row),), at_ends[0], ends)[
        0
    ]
    row, t = np.append(ends, row), np.append(np.ones(len(ends)), t)
    length, nominal, corrected = (np.append(*both) for both in zip(at_ends, inside, strict=True))
    order = np.lexsort((t, row))
    return replace(
        cuts,
        row=row[order],
        t=t[order],
        between_nominal=nominal[order],
        between_corrected=corrected[order],
        between_turned=turned[order],
        length=length[order],
    )


class _Ways(Struct, frozen=True, eq=False):
    """The ways between pairs: way k leads to pair k from pair k − 1, the first one from the start of the program.

    :param other: the second program, of M motions.
    :param way: (M,) the way of each motion; P for those after the last pair.
    :param begin: (P,) arc lengths on the nominal path at which the ways begin, `end` (P,) at which they end [m].
    :param second: (P, 2) the same on the second path.
    :param known: (P,) True where the whole nominal way consists of cutting lines and arcs that can be corrected.
    """

    other: PlacedProgram
    way: Ints
    begin: Array
    end: Array
    second: Array
    known: Bools

    @classmethod
    def of_pairs(cls, found: Comparison, one: PlacedProgram, other: PlacedProgram) -> _Ways:
        """Return the ways between the pairs of a comparison."""
        m, (first, two) = one.program.motions, found.pair.T
        unknown = (np.isin(m.kind, (PTP, SPL)) | m.rapid) & np.isnan(m.joints[:, 0])
        count = np.append(0, np.cumsum(unknown | _uncorrected_start(one)))
        before = np.append(-1, first[:-1]) + 1
        second = other.along[np.stack([np.append(-1, two[:-1]) + 1, two + 1], axis=1)]
        way = np.searchsorted(two, np.arange(len(other.program.motions)))
        return cls(other, way, one.along[before], one.along[first + 1], second, count[first + 1] == count[before])

    def _of_known(self, row: Ints) -> Bools:
        """Return which motions (n,) of the second program are on a known way."""
        return np.append(self.known, False)[self.way[row]]

    def targets(self, found: Comparison) -> Ints:
        """Return the motions (n,) whose ends, without partner, are compared with the nominal path."""
        more = found.only_corrected
        kind = self.other.program.motions.kind
        more = more[self._of_known(more) & np.isin(kind[more], (LIN, CIRC))]
        return np.sort(np.append(found.inserted, more))

    def pieces(self) -> Ints:
        """Return the lines and arcs (n,) of the second program that are compared with the nominal path inside."""
        rows = self.other.rows[np.isin(self.other.program.motions.kind[self.other.rows], (LIN, CIRC))]
        return rows[self._of_known(rows) & ~_uncorrected_start(self.other)[rows]]

    def guess(self, row: Ints) -> Array:
        """Return arc lengths (n,) on the nominal path at the same share of the way as the ends of motions (n,)."""
        way = self.way[row]
        begin, end = self.second[way].T
        share = (self.other.along[row + 1] - begin) / np.maximum(end - begin, 1e-12)
        return np.asarray(self.begin[way] + share * (self.end[way] - self.begin[way]))

    def begins(self, row: Ints, place: Array) -> Array:
        """Return the arc lengths (n,) on the nominal path at which motions (n,) begin, by those of the ends (M,)."""
        index = np.searchsorted(self.other.rows, row) - 1
        return np.where(index >= 0, place[self.other.rows[index]], self.begin[self.way[row]])


def _begins_with_step(one: PlacedProgram, load: PathForces, place: Array) -> Bools:
    """Return which pieces, by the arc lengths of their ends (n,), cover a step of the force at the start of a move."""
    return load.behind_step(*one.at(np.nan_to_num(place)))


def _uncorrected_start(side: PlacedProgram) -> Bools:
    """(M,) True for motions that begin at an unknown place, or at the start or an axis target that is not nominal."""
    m, after = side.program.motions, side.program.after
    rows = np.arange(len(m))
    before = rows - 1 if after is None else after
    axis = np.append(np.isfinite(m.joints[:, 0]), True)[before]
    return np.asarray((before == rows) | (axis & (not side.place.rest_is_nominal)))


def _spread(other: PlacedProgram, pieces: Ints) -> tuple[Ints, Array]:
    """Return places (row, t) inside of lines and arcs (n,) of the second program."""
    length = other.path.length[pieces]
    parts = np.where(other.program.motions.kind[pieces] == CIRC, _QUARTERS, 2)
    parts = np.where(length > _LONG, np.maximum(parts, np.ceil(length / _SPACING).astype(np.int64)), parts)
    which = np.repeat(np.arange(len(pieces)), parts - 1)
    index = np.arange(len(which)) - np.repeat(np.cumsum(parts - 1) - (parts - 1), parts - 1) + 1
    return pieces[which], index / parts[which]


def _turned_at(one: PlacedProgram, other: PlacedProgram, load: PathForces, length: Array, row: Ints) -> Array:
    """Return the angles (n,) by which targets of the second program turn the loaded tool from the nominal path [rad].

    :param length: (n,) arc lengths on the nominal path; `row` (n,) motions of the second program.
    """
    program, (motion, t) = one.program, one.at(length)
    wrench = one.wrench(load, motion, t)
    pose = toolpath.pose_in_root(program, motion, toolpath.at(program, one.path, motion, t).pose[:], t)
    tool = toolpath.tool_of(program, motion)
    try:
        wanted = one.place.compensate(pose, one.joints_at(motion, t), tool, wrench).pose
    except NotConvergedError as cause:
        raise _no_equilibrium(program, motion, cause) from None
    flange = toolpath.flange_from_tcp(other.program, row, other.program.motions.target[row], None)
    given = flange @ tool
    turned = angle_between(wanted[:, :3, :3], given[:, :3, :3])
    return np.asarray(np.minimum(turned, angle_between(pose[:, :3, :3], given[:, :3, :3])))


class _Search(Struct, frozen=True, eq=False):
    """Finds the place of the nominal path that the loaded tip of the second program is nearest to.

    The force acts where the tool is on the nominal path, so it depends on the place that is sought.
    """

    one: PlacedProgram
    other: PlacedProgram
    load: PathForces
    ways: _Ways

    def found(self, row: Ints, t: Array, q: Array, guess: Array, *, enough: float) -> tuple[Array, Array, Array]:
        """Return arc lengths (n,) on the nominal path, and the deviations (n,) by the nominal and the second program.

        :param row: (n,) motions of the second program; `t` (n,) places on them; `q` (n, 6) joint angles there [rad].
        :param guess: (n,) approximate arc lengths [m].
        :param enough: a deviation that is small enough [m].
        """

        def in_chunk(row: Ints, t: Array, q: Array, guess: Array) -> tuple[Array, ...]:
            way, carried = self.ways.way[row], self.other.carried(row, t)
            low, high = self.ways.begin[way], self.ways.end[way]
            low = np.minimum(low + _SHORTEST * 1e-4, high)  # behind the end of the motion before
            length, distance = self._near(q, carried, np.clip(guess, low, high), (low, high), enough)
            far = np.flatnonzero(distance > _CLOSE * self.one.place.tolerance)
            if len(far):
                limits = low[far], high[far]
                tried = self._anywhere(q[far], carried[far], limits)
                tried, there = self._near(q[far], carried[far], tried, limits, _EXACT)
                better = there < distance[far]
                length[far[better]], distance[far[better]] = tried[better], there[better]
            motion, t = self.one.at(length)
            mine = norm(self._off(self.one.joints_at(motion, t), self.one.carried(motion, t), length))
            return length, mine, distance

        length, mine, distance = in_chunks(in_chunk, row, t, q, guess)
        return length, mine, distance

    def _off(self, q: Array, carried: Array, length: Array) -> Array:
        """Return the tips (n, 3) under the forces at arc lengths (n,), minus the nominal path, in the cell [m]."""
        motion, t = self.one.at(length)
        return self._tip(q, carried, motion, self.one.wrench(self.load, motion, t)) - self.one.points(length)

    def _tip(self, q: Array, carried: Array, motion: Ints, wrench: Array) -> Array:
        try:
            return np.asarray(self.one.place.tip(q, toolpath.tool_of(self.one.program, motion), wrench) + carried)
        except NotConvergedError as cause:
            raise _no_equilibrium(self.one.program, motion, cause) from None

    def _near(
        self, q: Array, carried: Array, length: Array, limits: tuple[Array, Array], enough: float
    ) -> tuple[Array, Array]:
        """Return arc lengths (n,) on the path nearest to the tip, by Newton's method from start values, and distances
        (n,).
        """
        off = self._off(q, carried, length)
        best, distance = length.copy(), norm(off)
        rows = np.flatnonzero(distance > enough)
        for _ in range(_ROUNDS):
            if not len(rows):
                break
            low, high = limits[0][rows], limits[1][rows]
            step = np.where(length[rows] + _AHEAD < high, _AHEAD, -_AHEAD)
            change = (self._off(q[rows], carried[rows], length[rows] + step) - off[rows]) / step[:, None]
            square = np.einsum("ni,ni->n", change, change)
            moves = square > _STILL**2  # else the path only turns the tool here
            step = np.where(moves, -np.einsum("ni,ni->n", off[rows], change) / np.where(moves, square, 1.0), 0.0)
            length[rows] = np.clip(length[rows] + step, low, high)
            off[rows] = self._off(q[rows], carried[rows], length[rows])
            new = norm(off[rows])
            better = new < distance[rows]
            best[rows[better]], distance[rows[better]] = length[rows[better]], new[better]
            rows = rows[distance[rows] > enough]
        return best, distance

    def _anywhere(self, q: Array, carried: Array, limits: tuple[Array, Array]) -> Array:
        """Return the arc lengths (n,) nearest to the tip among many between limits, with the compliance at the first.

        The force moves the tip: on a steep ramp the tip may move back while the path goes on.
        """
        low, high = limits
        motion = self.one.at(high)[0]
        rest = self._tip(q, carried, motion, np.zeros((len(q), 6)))
        units = [self._tip(q, carried, motion, np.tile(unit, (len(q), 1))) - rest for unit in np.diag(_PROBE)]
        compliance = np.stack(units, axis=2) / _PROBE
        even = np.linspace(0.0, 1.0, _TRIED)
        whole, ramp = (high - low)[:, None], np.minimum(_RAMPS * self.one.place.ramp, high - low)[:, None]
        tried = low[:, None] + np.sort(np.hstack([whole * even, ramp * even, whole * _FIRST]), axis=1)
        rows = np.arange(len(q))
        for _ in range(_CLOSER):
            which = np.repeat(rows, tried.shape[1])
            motion, t = self.one.at(tried.ravel())
            moved = np.einsum("nij,nj->ni", compliance[which], self.one.wrench(self.load, motion, t))
            off = norm(rest[which] + moved - self.one.points(tried.ravel())).reshape(tried.shape)
            best = np.argmin(off, axis=1)
            begin, end = tried[rows, np.maximum(best - 1, 0)], tried[rows, np.minimum(best + 1, tried.shape[1] - 1)]
            length = tried[rows, best]
            tried = begin[:, None] + (end - begin)[:, None] * np.linspace(0.0, 1.0, _SAMPLES)
        return np.asarray(length)


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
            tool = toolpath.tool_of(one.program, motion[which])
            if load is None:
                pose = toolpath.at(other.program, other.path, row, t).pose[:]
                spot = (toolpath.flange_from_tcp(other.program, row, pose, None) @ tool)[:, :3, 3]
            else:
                q = other.joints_at(row, t)
                spot = np.full((len(q), 3), np.inf)
                good = np.isfinite(q).all(axis=1)
                tools = tool if tool.ndim == 2 else tool[good]
                spot[good] = one.place.tip(q[good], tools, wrench[which][good]) + other.carried(row, t)[good]
            return spot.reshape(*length.shape, 3)

        try:
            return (nearest(points, wanted, begin, end)[1],)
        except NotConvergedError as cause:
            raise _no_equilibrium(one.program, motion[:1], NotConvergedError(str(cause), [0])) from None

    out[some] = in_chunks(distance, motion, wanted, wrench, begin, end)[0]
    return out
