"""Where the loaded tip goes by each of two programs, at the pairs of their targets and between them.

Both are simulated by `simulation.DrivenProgram`, under the force that acts where the tool is on the nominal path.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import toolpath
from postproc.chunks import in_chunks, ragged_range
from postproc.comparison.paths import PlacedProgram, file_and_line
from postproc.comparison.result import Comparison, Cuts
from postproc.errors import ForceError, NotConvergedError
from postproc.forces import BEHIND_STEP, PathForces
from postproc.frames import Array, angle_between, norm
from postproc.program import CIRC, LIN, PTP, SPL, Bools, Ints, Program
from postproc.simulation import number_of_places

_ROUNDS, _AHEAD, _STILL = 4, 1e-6, 0.05
"""Gauss-Newton steps to the nearest place of the path; the step of its finite differences [m]; a rate of change per
length below which the place does not matter."""
_EXACT = 1e-8
"""A distance at targets that is not improved further [m]."""
_CLOSE = 0.2
"""A distance at targets, as a share of the tolerance, that is not sought elsewhere."""
_TRIED, _RAMPS, _SAMPLES, _CLOSER = 65, 3.0, 9, 3
"""Places tried on the whole way, and on this many times the ramp of a force; then refined so often."""
_FIRST = np.geomspace(1e-5, 1e-2, 13)
"""And these shares of the way: where a move begins with a step, the force may change over some micrometres."""
_PROBE = np.array([100.0, 100.0, 100.0, 10.0, 10.0, 10.0])
"""Forces [N] and moments [N·m] from which the compliance at the tip is taken."""
_LEAST = 2
"""Places at which pieces of the second program are checked at least: it may leave its path between targets."""
_STEEP = 2e-4
"""A piece is steep if what its ends are displaced by differs by more than this [m]."""
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
        tip = side.loaded_tip(motion, q, wrench, carried)
        return (side.in_base(motion, tip) - program.motions.target[motion, :3, 3],)

    try:
        return in_chunks(off, motion, q, wrench, carried)[0]
    except NotConvergedError as cause:
        raise no_equilibrium(program, motion, cause) from None


def no_equilibrium(program: Program, motion: Ints, cause: NotConvergedError) -> ForceError:
    """Return the error for a force that the arm does not hold at the first of motions (n,) that the cause names."""
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
        wanted = one.robot_in_cell.compensate(
            target, one.joints[motion], toolpath.tool_of(program, motion), wrench
        ).pose
        wanted = toolpath.pose_in_base(program, motion, wanted)
        return (angle_between(wanted[:, :3, :3], pose[:, :3, :3]),)

    try:
        return in_chunks(angle, found.pair[:, 0], wrench, found.pose)[0]
    except NotConvergedError as cause:
        raise no_equilibrium(program, found.pair[:, 0], cause) from None


def between(found: Comparison, cuts: Cuts, one: PlacedProgram, other: PlacedProgram, load: PathForces) -> Cuts:
    """Return the deviations with those at the other targets of the second program, and between targets.

    Each place of the second program belongs to the place of the nominal path, on the way between the same pairs, that
    the loaded tip is nearest to.

    :param load: the forces along the nominal program.
    """
    ways = Ways.of_pairs(found, one, other)
    ends, pieces = ways.targets(found), ways.pieces()
    reached = np.isfinite(joints := other.joints_at(ends, np.ones(len(ends)))).all(axis=1)
    ends, joints = ends[reached], joints[reached]
    search = Search(one, other, load, ways)
    at_ends = search.found(ends, np.ones(len(ends)), joints, ways.guess(ends), enough=_EXACT)
    place = np.full(len(other.program.motions), np.nan)
    place[found.pair[:, 1]] = one.along[found.pair[:, 0] + 1]
    place[ends] = at_ends[0]
    begin = ways.begins(pieces, place)
    settled = (place[pieces] - begin > _SHORTEST) & ~_begins_with_step(one, load, place[pieces])
    pieces, begin = pieces[settled], begin[settled]
    row, t = places_on_pieces(other, pieces, _steep(one, other, pieces, place))
    which = np.searchsorted(pieces, row)
    guess = begin[which] + t * (place[row] - begin[which])
    joints = in_chunks(lambda row, t: (other.joints_at(row, t),), row, t)[0]
    reached = np.isfinite(joints).all(axis=1)
    row, t, guess, joints = row[reached], t[reached], guess[reached], joints[reached]
    inside = search.found(row, t, joints, guess, enough=one.robot_in_cell.tolerance)
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


class Ways(Struct, frozen=True, eq=False):
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
    def of_pairs(cls, found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Ways:
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
    return np.asarray((before == rows) | (axis & (not side.robot_in_cell.rest_is_nominal)))


def _steep(one: PlacedProgram, other: PlacedProgram, pieces: Ints, place: Array) -> Bools:
    """Return which lines and arcs (n,) of the second program are displaced differently at their ends.

    :param place: (M,) arc lengths on the nominal path of the ends of its motions [m]; NaN where unknown.
    """
    ends = np.flatnonzero(np.isfinite(place))
    displaced = np.full((len(place), 3), np.nan)
    displaced[ends] = other.points(other.along[ends + 1]) - one.points(place[ends])
    before = np.maximum(np.searchsorted(other.rows, pieces) - 1, 0)
    return np.asarray(~(norm(displaced[pieces] - displaced[other.rows[before]]) <= _STEEP))


def places_on_pieces(other: PlacedProgram, pieces: Ints, steep: Bools) -> tuple[Ints, Array]:
    """Return places (row, t) inside of lines and arcs (n,) of the second program."""
    kind, segments = other.program.motions.kind[pieces], other.segments
    arcs = kind == CIRC
    length, turn = segments.length[pieces], segments.turn[pieces]
    number = number_of_places(kind, length, turn, curved=arcs, steep=arcs | steep)
    parts = np.maximum(number, _LEAST)
    which = np.repeat(np.arange(len(pieces)), parts - 1)
    index = ragged_range(parts - 1) + 1
    return pieces[which], index / parts[which]


def _turned_at(one: PlacedProgram, other: PlacedProgram, load: PathForces, length: Array, row: Ints) -> Array:
    """Return the angles (n,) by which targets of the second program turn the loaded tool from the nominal path [rad].

    :param length: (n,) arc lengths on the nominal path; `row` (n,) motions of the second program.
    """
    program, (motion, t) = one.program, one.at(length)
    wrench = one.wrench(load, motion, t)
    pose = toolpath.pose_in_root(program, motion, toolpath.at(program, one.segments, motion, t).pose[:], t)
    tool = toolpath.tool_of(program, motion)
    try:
        wanted = one.robot_in_cell.compensate(pose, one.joints_at(motion, t), tool, wrench).pose
    except NotConvergedError as cause:
        raise no_equilibrium(program, motion, cause) from None
    flange = toolpath.flange_from_tcp(other.program, row, other.program.motions.target[row], None)
    given = flange @ tool
    turned = angle_between(wanted[:, :3, :3], given[:, :3, :3])
    return np.asarray(np.minimum(turned, angle_between(pose[:, :3, :3], given[:, :3, :3])))


class Search(Struct, frozen=True, eq=False):
    """Finds the place of the nominal path that the loaded tip of the second program is nearest to.

    The force acts where the tool is on the nominal path, so it depends on the place that is sought.
    """

    one: PlacedProgram
    other: PlacedProgram
    load: PathForces
    ways: Ways

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
            length, distance = self._improved(q, carried, np.clip(guess, low, high), (low, high), enough)
            far = np.flatnonzero(distance > max(enough, _CLOSE * self.one.robot_in_cell.tolerance))
            if len(far):
                limits = low[far], high[far]
                tried = self._anywhere(q[far], carried[far], limits)
                tried, there = self._improved(q[far], carried[far], tried, limits, _EXACT)
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
            return self.one.loaded_tip(motion, q, wrench, carried)
        except NotConvergedError as cause:
            raise no_equilibrium(self.one.program, motion, cause) from None

    def _improved(
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
        whole, ramp = (high - low)[:, None], np.minimum(_RAMPS * self.one.robot_in_cell.ramp, high - low)[:, None]
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
