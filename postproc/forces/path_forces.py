"""The wrench anywhere on the path of a program, from the sources of its forces; and where that needs samples.

Samples are needed where the estimated displacement changes, and where FEED axes swing. Near the direction of the
spindle these turn by up to half a turn within a short part of an arc, or of a line that turns the tool. Pieces of one
size for the whole motion would be too many, so each piece is halved as long as its circle or line deviates from the
displacement by the force at its quarters. That needs only the wrench; the simulation of the written program finds the
response of the robot.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.chunks import Runs, compact, in_chunks
from postproc.errors import MAX_ERRORS, ForceError, Issue, combined_error
from postproc.forces.axes import TURNS, Axes, is_arc_across, is_line_across, last_travel, predecessors
from postproc.forces.precedence import combine, comment_knots, small_forces, unused_comments
from postproc.forces.sources import BASE, FEED, ByLaw, ForceSource, Knots, StockInTime
from postproc.frames import Array, any_column, largest, norm
from postproc.program import CIRC, LIN, SPL, Bools, Ints, Program, constant, distinct
from postproc.toolpath import DisplacementEstimate, Pieces, Segments, Toolpath, at, circle_through, columns_in_root

BEHIND_STEP = 1e-5
"""Distance behind a force step at which the path is sampled [m]: the correction changes over that length."""
_CONTINUOUS = 2e-3
"""Relative change between consecutive forces below which no ramp is inserted."""


class PathForces(Struct, frozen=True, eq=False):
    """The forces along the M motions of a program: K knots, at least one for each motion, linear between them.

    The knots are those of the sources. If the force of a motion is ramped, a knot at its start has the wrench at the
    end of the motion before, in `$BASE` axes, and its own wrench follows at the end of the ramp. A force that starts
    with the value at which the one before ends has no ramp; in FEED axes it turns with the path.

    :param axes: rotates forces into `$BASE` axes.
    :param first: (M + 1,) the knots of motion i are those from first[i] to first[i + 1] (exclusive).
    :param place: (K,) row of `Motions` plus t: increasing except at the end of a motion, where the next one starts.
    :param t: (K,) position on the motion in [0, 1].
    :param wrench: (K, 6) Fx…Mz [N, N·m] on the tool at its tip, in the axes that `knot_frame` names.
    :param knot_frame: (K,) `BASE`, `TOOL` or `FEED`.
    :param spread: (K, 2, 3, 3) L of the covariances L·Lᵀ of force and moment, in the same axes; None if all are zero.
    :param factor: (K,) standard deviation of one factor of the whole wrench, see `Knots`.
    :param frame: (M,) frame in which the force of each motion is given.
    :param ramped: (M,) True if the force builds up over the ramp of the cell.
    :param issues: warnings and notes for the user, e.g. cutting moves without a force.
    :param by_law: motions whose forces a cutting law computes; None if there are none.
    :param stock: the stock over time, if the source of forces knows it.
    """

    axes: Axes
    first: Ints
    place: Array
    t: Array
    wrench: Runs
    knot_frame: Ints
    spread: Array | None
    factor: Array
    frame: Ints
    ramped: Bools
    issues: tuple[Issue, ...]
    by_law: ByLaw | None
    stock: StockInTime | None = None

    def at(self, sample: Toolpath) -> Array:
        """Return the wrench (N, 6) at samples of the path [N, N·m], `$BASE` axes of their motions."""

        def wrench(knots: Ints) -> Array:
            return self.wrench.take(knots).reshape(-1, 2, 3, 1)

        def in_chunk(rows: Ints) -> tuple[Array]:
            return (self._columns_in_base(wrench, sample.take(rows)).reshape(-1, 6),)

        return in_chunks(in_chunk, np.arange(len(sample)))[0]

    def spread_at(self, sample: Toolpath) -> Array | None:
        """Return L (N, 2, 3, 3) of the covariances L·Lᵀ of force and moment at samples; None if all are zero."""
        spread = self.spread
        return None if spread is None else self._columns_in_base(lambda knots: spread.take(knots, axis=0), sample)

    def factor_at(self, sample: Toolpath) -> Array:
        """Return `factor` (N,) at samples: that of the next knot."""
        return np.asarray(self.factor[self._next_knot(sample)])

    def spread_in_root(self, sample: Toolpath) -> Array | None:
        """Return L of covariances L·Lᵀ of the wrench at samples, root axes; None if forces are certain.

        :returns: (N, 6, 6) if components are independent. (N, 6, 13) if their errors may also be one factor, with two
            covariances, see `elastostatics.position_bound`: the first six columns are for independent components, the
            other seven for that factor and the errors that it does not contain.
        """
        independent = self.spread_at(sample)
        if independent is None:
            return None
        halves = [independent]
        if self.factor.any():
            halves += [
                self._columns_in_base(self._remaining_deviation, sample),
                self._columns_in_base(self._factor_deviation, sample),
            ]
        in_root = [columns_in_root(self.axes.program, sample.motion, root_columns) for root_columns in halves]
        factors = np.zeros((len(sample), 6, 13 if len(halves) > 1 else 6))
        for place, root_columns in enumerate(in_root[:2]):
            factors[:, :3, 6 * place : 6 * place + 3] = root_columns[:, 0]
            factors[:, 3:, 6 * place + 3 : 6 * place + 6] = root_columns[:, 1]
        if len(halves) > 1:
            factors[:, :, 12] = in_root[2].reshape(-1, 6)
        return factors

    def _factor_deviation(self, knots: Ints) -> Array:
        """Return the change (n, 2, 3, 1) of the wrench at knots for one standard deviation of its factor."""
        return np.asarray((self.wrench.take(knots) * self.factor[knots, None]).reshape(-1, 2, 3, 1))

    def _remaining_deviation(self, knots: Ints) -> Array:
        """Return L (n, 2, 3, 3) at knots without the part of the deviation that is one factor."""
        assert self.spread is not None
        square = (
            np.sum(np.square(self.spread.take(knots, axis=0)), axis=3)
            - np.square(self._factor_deviation(knots))[..., 0]
        )
        return np.asarray(np.sqrt(np.maximum(square, 0.0))[..., None] * np.eye(3))

    def wrench_before(self) -> Array:
        """Return the wrench (M, 6) at the end of the motion before each, `$BASE` axes; zero before the first."""
        return _wrench_before(self.wrench.take(self.first[1:] - 1), self.frame, self.axes)

    def behind_step(self, motion: Ints, t: Array) -> Bools:
        """Return which places (n,) are just behind the start of a motion whose force may start with a step."""
        return np.asarray(~self.ramped[motion] & (self.axes.path.length[motion] * t < 1.5 * BEHIND_STEP))

    def _next_knot(self, sample: Toolpath) -> Ints:
        """Return the knot (N,) at or after each sample on its motion, the last one where there is none."""
        first, last = self.first[sample.motion], self.first[sample.motion + 1] - 1
        return np.clip(np.searchsorted(self.place, sample.motion + sample.t), first, last)

    def _columns_in_base(self, columns: Callable[[Ints], Array], sample: Toolpath) -> Array:
        """Return columns (N, 2, 3, m) of force and moment in `$BASE` axes at samples.

        :param columns: returns those (n, 2, 3, m) at knots (n,).
        """
        t, right = sample.t, self._next_knot(sample)
        left = np.where(self.t[right] > t, np.maximum(right - 1, self.first[sample.motion]), right)
        values, frame = columns(right), self.knot_frame[right]
        inner = np.flatnonzero(left != right)
        left, right = left[inner], right[inner]
        share = ((t[inner] - self.t[left]) / (self.t[right] - self.t[left]))[:, None, None, None]
        begin = columns(left)
        same_frame = self.knot_frame[left] == frame[inner]
        plain, ramp = inner[same_frame], inner[~same_frame]
        values[plain] = begin[same_frame] + share[same_frame] * (values[plain] - begin[same_frame])
        values = self.axes.into_base(values, frame, sample)
        values[ramp] = begin[~same_frame] + share[~same_frame] * (values[ramp] - begin[~same_frame])
        return values


def assign(program: Program, path: Segments, source: ForceSource | None, axis: str, ramp: float) -> PathForces:
    """Assign forces to the motions. `precedence` states which source counts where; rapid moves have no force.

    :param path: the geometry of the motions.
    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :param ramp: length over which a force builds up if it is given for a whole motion [m].
    :raises ForceError: the source cannot be used for this program; a FEED force with a component across the spindle on
        a move along the spindle, without any move across it; a force on a move from [start] of the cell.
    """
    m = program.motions
    by_law = stock = None
    if source is None:
        knots_of_motions, issues = comment_knots(program), list[Issue]()
    else:
        knots = source.along(program, path).check(program, source.name)
        knots_of_motions, issues = combine(program, knots, source.name)
        issues += knots.issues
        by_law, stock = knots.by_law, knots.stock
        has_force = any_column(knots.wrench != 0.0) & m.rapid[knots.motion]
        issues += _warning(program, knots.motion[has_force], "force-on-rapid", _ON_RAPID)
    issues += unused_comments(program)
    if by_law is None:
        issues += small_forces(program, knots_of_motions)
    is_forceless = np.ones(len(m), dtype=np.bool_)
    is_forceless[knots_of_motions.motion] = False
    has_travel = ~m.rapid & (path.length > _NO_LENGTH)
    issues = _warning(program, np.flatnonzero(is_forceless & has_travel), "no-force", _NO_FORCE) + issues
    knots_of_motions = knots_of_motions.take(~m.rapid[knots_of_motions.motion])
    is_forceless |= m.rapid
    _check_start(program, knots_of_motions)
    forceless = np.flatnonzero(is_forceless)
    knots_of_motions = knots_of_motions.or_fallback(
        Knots.throughout(forceless, np.zeros((len(forceless), 6)), np.full(len(forceless), BASE))
    )
    travel, lead = _travel(program, path, knots_of_motions, axis)
    path_forces = _resolve(knots_of_motions, Axes(program, path, axis, travel), ramp, (*issues, *lead), by_law)
    return replace(path_forces, stock=stock)


def _check_start(program: Program, knots: Knots) -> None:
    """Refuse forces on moves from `[start]` of the cell: the program does not define the path there."""
    unforced = np.isin(knots.motion, program.unforced)  # few, so that few wrenches are written out
    motions = knots.motion[unforced][any_column(knots.wrench[unforced] != 0.0)]
    if len(motions):
        advice = "Program X, Y and Z in rapid moves (G0) before cutting, or switch the force on after this move."
        raise _refusal(program, motions, "a force on a move from [start] of the cell", advice)


def _refusal(program: Program, motions: Ints, problem: str, advice: str) -> ForceError:
    """Return one error for each line of motions (n,), as one."""
    name, lines = program.documents[0].name, distinct(program.motions.line[motions])
    lines = lines[: MAX_ERRORS + 1]  # one more than are shown, by which the message says that there are others
    return combined_error(ForceError(problem, file=name, line=line, advice=advice) for line in lines.tolist())


_NO_LENGTH = 1e-9
"""A move of at most this length [m] cuts nothing: its ends differ by rounding as those of a LIN to where a PTP ends."""
_NO_FORCE = "cutting moves without a force: zero force is assumed"
_ON_RAPID = "rapid moves carry no force: the row is ignored"


def _warning(program: Program, motion: Ints, kind: str, message: str) -> list[Issue]:
    """Return one warning for all of the motions (n,) in a list; an empty list without motions."""
    return [program.motions.issue("warning", kind, message, motion)] if len(motion) else []


def _resolve(knots: Knots, axes: Axes, ramp: float, issues: tuple[Issue, ...], by_law: ByLaw | None) -> PathForces:
    """Return the forces from knots that cover every motion, with ramps inserted."""
    motions = np.arange(len(axes.program.motions))
    first = np.searchsorted(knots.motion, np.append(motions, len(motions)))
    last = first[1:] - 1
    has_ramp, frame = knots.ramped[last], knots.frame[last]
    wrench = knots.wrench.take(last, axis=0)
    start, start_frame = _wrench_before(wrench, frame, axes), np.full(len(motions), BASE)
    steady = _continuous(wrench, frame, start, axes)
    start[steady], start_frame[steady] = wrench[steady], frame[steady]
    changes = has_ramp & (any_column(start != wrench) | (start_frame != frame))
    del wrench
    spread = at_start = None
    if knots.sigma.any():
        spread = knots.sigma.reshape(-1, 2, 3, 1) * np.eye(3)
        at_start = axes.at_start(spread[last], frame)
        at_start[steady] = spread[last[steady]]
        changes |= has_ramp & (at_start != spread[last]).any(axis=(1, 2, 3))
    begins = first[:-1][changes]  # the only knot of each
    factor = knots.factor
    if factor.any():
        previous = predecessors(axes.program)[changes]
        factor = np.insert(factor, begins, np.where(previous >= 0, knots.factor[last[previous]], 0.0))
    else:
        factor = constant(0.0, len(factor) + len(begins))
    if spread is not None and at_start is not None:
        spread = np.insert(spread, begins, at_start[changes], axis=0)
    length = axes.path.length[changes]
    t = knots.t.copy()
    t[begins] = ramp / np.maximum(length, ramp)
    t = np.insert(t, begins, 0.0)
    first = first + np.concatenate([[0], np.cumsum(changes)])
    return PathForces(
        axes,
        compact(first, np.int32),
        np.repeat(motions, np.diff(first)) + t,
        t,
        Runs.of(np.insert(knots.wrench, begins, start[changes], axis=0)),
        compact(np.insert(knots.frame, begins, start_frame[changes]), np.int8),
        spread,
        factor,
        compact(frame, np.int8),
        has_ramp,
        issues,
        by_law,
    )


def _wrench_before(wrench: Array, frame: Ints, axes: Axes) -> Array:
    """Return the wrench (M, 6) before each motion, `$BASE` axes, from that at the end of each, in `frame`."""
    return axes.at_start(wrench.reshape(-1, 2, 3, 1), frame).reshape(-1, 6)


def _continuous(wrench: Array, frame: Ints, previous: Array, axes: Axes) -> Ints:
    """Return the motions (n,) with a force in FEED axes that continues the one before: it turns with the path.

    :param wrench: (M, 6) of the motions, in the axes of `frame` (M,).
    :param previous: (M, 6) at the end of the motion before, in `$BASE` axes.
    """
    rows = np.flatnonzero(frame == FEED)
    start = at(axes.program, axes.path, rows, np.zeros(len(rows)))
    begin = axes.into_base(wrench[rows].reshape(-1, 2, 3, 1), frame[rows], start).reshape(-1, 6)
    return rows[any_column(begin != 0.0) & (norm(begin - previous[rows]) < _CONTINUOUS * norm(begin))]


def _travel(program: Program, path: Segments, knots: Knots, axis: str) -> tuple[Array, list[Issue]]:
    """Return `Axes.travel`, and notes about it for the user."""
    m = program.motions
    feed = knots.frame == FEED
    if not feed.any():
        return np.zeros((0, 3)), []
    spline_motions = distinct(knots.motion[feed & (m.kind[knots.motion] == SPL) & any_column(knots.wrench != 0.0)])
    if len(spline_motions):
        problem = "a FEED force on a piece of a spline, whose direction is not known"
        raise _refusal(program, spline_motions, problem, "Give its force in BASE or TOOL axes.")
    travel, needs = last_travel(program, path, axis)
    acts = np.zeros(len(m), dtype=np.bool_)
    is_lateral = (knots.wrench[:, [0, 1, 3, 4]] != 0.0) | (knots.sigma[:, [0, 1, 3, 4]] != 0.0)
    acts[knots.motion[feed & any_column(is_lateral)]] = True
    needs &= acts
    unknown = needs & np.isnan(travel[:, 0])
    if unknown.any():
        advice = (
            "No other move of the program has a feed direction across the spindle that this one could use. "
            "Give its force in BASE or TOOL axes."
        )
        raise _refusal(program, np.flatnonzero(unknown), "a FEED force on a move along the spindle", advice)
    issues = []
    if needs.any():
        message = (
            "a FEED force on a move along the spindle, which has no feed direction: x is the travel direction of the "
            "last move across the spindle, or of the first one if none precedes"
        )
        issues.append(m.issue("info", "feed-direction", message, np.flatnonzero(needs)))
    return travel, issues


_NO_CHANGE = 1e-9
"""Changes of the force below this [N, N·m] count as none (assumed)."""
_STEP = 1e-8
"""Displacement [m] below which a change of the force from motion to motion does not count as a step."""


def displacement_estimate(forces: PathForces, compliance: tuple[float, float]) -> DisplacementEstimate:
    """Return a rough estimate of how the displacement by the force changes along the motions.

    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    """
    m, path = forces.axes.program.motions, forces.axes.path
    turning = (m.kind == CIRC) & (forces.frame == FEED)

    def moves(wrench: Array) -> Array:
        return np.asarray(compliance[0] * norm(wrench[:, :3]) + compliance[1] * norm(wrench[:, 3:]))

    begins = np.zeros(len(forces.t), dtype=np.bool_)
    first = forces.first[:-1]
    begins[first[forces.ramped & (forces.t[first] == 0.0)]] = True  # the force of the motion before

    def largest_of_own(values: Array) -> Array:
        return np.asarray(np.maximum.reduceat(np.where(begins, 0.0, values), first))

    motion = np.repeat(np.arange(len(m)), np.diff(forces.first))
    change, bends = _changes(forces, motion)
    step_size = moves(_steps(forces))
    step = np.flatnonzero(step_size > _STEP)
    step_place = np.minimum(0.5, BEHIND_STEP / np.maximum(path.length[step], BEHIND_STEP))
    swings, rotating_size = np.zeros(len(m), dtype=np.bool_), constant(0.0, len(m))
    if turning.any():
        lateral = forces.wrench[:] * (1.0, 1.0, 0.0, 1.0, 1.0, 0.0)  # z, along the spindle, does not turn
        rotating_size = np.where(turning, largest_of_own(moves(lateral)), 0.0)
        acts = np.zeros(len(m), dtype=np.bool_)
        acts[motion[any_column(lateral != 0.0)]] = True
        arcs = np.flatnonzero(turning & acts)
        swings[arcs] = ~is_arc_across(forces.axes.program, path, arcs, forces.axes.spindle)
    knot_rows = np.flatnonzero(bends | (m.kind[motion] == CIRC))
    places = np.append(motion[knot_rows], step), np.append(forces.t[knot_rows], step_place)
    order = np.lexsort(places[::-1])
    return DisplacementEstimate(
        motion=places[0][order],
        t=places[1][order],
        change=np.append(moves(change)[knot_rows], step_size[step])[order],
        bends=np.append(bends[knot_rows], np.ones(len(step), dtype=np.bool_))[order],
        turning=rotating_size,
        size=largest_of_own(moves(forces.wrench[:])),
        swings=swings,
    )


def _changes(forces: PathForces, motion: Ints) -> tuple[Array, Bools]:
    """Return the change (K, 6) of the force since the knot before, and (K,) True where its rate changes."""
    t, count = forces.t, len(forces.t)
    follows = np.append(False, np.diff(motion) == 0)
    # wrenches in the same frame are subtracted; otherwise both are turned into the axes of the later knot
    same_frame = follows & (np.diff(forces.knot_frame, prepend=0) == 0)
    change = np.diff(forces.wrench[:], axis=0, prepend=forces.wrench[:1])
    change[~same_frame] = 0.0
    rows = np.flatnonzero(follows & ~same_frame)
    place = at(forces.axes.program, forces.axes.path, motion[rows], t[rows])
    change[rows] = forces.at(place) - forces.wrench[rows - 1]
    bends = np.zeros(count, dtype=np.bool_)
    inner = np.flatnonzero((t > 0.0) & (t < 1.0))

    def rate(rows: Ints) -> Array:
        """Return the change (n, 6) per t up to knots (n,); 0 at the first knot of a motion."""
        rates, has_previous = np.zeros((len(rows), 6)), np.append(follows, False)[rows]
        rows = rows[has_previous]
        rates[has_previous] = change[rows] / (t[rows] - t[rows - 1])[:, None]
        return rates

    # a change of slope matters by what it amounts to over the interval before it
    width = np.where(follows[inner], t[inner] - t[inner - 1], 1.0)
    bends[inner] = largest((rate(inner + 1) - rate(inner)) * width[:, None]) >= _NO_CHANGE
    return change, bends


def _steps(forces: PathForces) -> Array:
    """Return the step of the force (M, 6) at the start of each motion, from the end of the motion before."""
    rows = np.flatnonzero(~forces.ramped)
    if not len(rows):
        return np.broadcast_to(0.0, (len(forces.ramped), 6))
    steps, previous = np.zeros((len(forces.ramped), 6)), forces.wrench_before()
    start = at(forces.axes.program, forces.axes.path, rows, np.zeros(len(rows)))
    steps[rows] = forces.at(start) - previous[rows]
    return steps


_SHORTEST = 1e-7
"""Length [m] and share of the arc below which no piece is halved: the decimals of a program resolve none shorter."""
_QUARTERS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of a piece of arc at which it is compared with its chord."""


def refined_arcs(
    forces: PathForces, arcs: Pieces, estimate: DisplacementEstimate, compliance: tuple[float, float], limit: float
) -> Pieces:
    """Return the pieces, halved where the force swings, until their circles follow it or the pieces are too short.

    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    :param limit: permitted deviation [m].
    """
    swings = estimate.swings[arcs.motion]
    if not swings.any():
        return arcs
    left = arcs.take(swings)
    left = left.with_enough_pieces(left.min_number).cut(left.min_number)
    pieces = [arcs.take(~swings)]
    length = forces.axes.path.length
    while len(left.motion):
        share = left.end - left.begin
        long = np.minimum(share, share * length[left.motion]) > _SHORTEST
        too_coarse = long & (_circle_deviation(forces, left, compliance) > limit)
        pieces.append(left.take(~too_coarse))
        left = left.take(too_coarse)
        left = left.cut(np.full(len(left.motion), 2))
    return Pieces.join(pieces).sort()


def swing_places(forces: PathForces, compliance: tuple[float, float], limit: float) -> tuple[Ints, Array]:
    """Return places of straight motions, motion (n,) and t (n,), between which the displacement by the force is linear.

    They are needed where the tool axis passes near the direction of travel: FEED axes swing there.

    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    :param limit: permitted deviation between two places [m].
    """
    program, path = forces.axes.program, forces.axes.path
    turns = (program.motions.kind == LIN) & (forces.frame == FEED) & (path.turn > TURNS) & (path.length > 0.0)
    motion = np.flatnonzero(turns)
    motion = motion[~is_line_across(program, path, motion, forces.axes.spindle)]
    begin, end = np.zeros(len(motion)), np.ones(len(motion))
    motions, places = [motion[:0]], [begin[:0]]
    while len(motion):
        displacements = []
        for share in _QUARTERS:
            wrench = forces.at(at(program, path, motion, begin + share * (end - begin)))
            displacements.append(np.hstack([compliance[0] * wrench[:, :3], compliance[1] * wrench[:, 3:]]))
        first, last = displacements[0], displacements[-1]
        deviations = [
            norm(displacement - first - share * (last - first))
            for share, displacement in zip(_QUARTERS, displacements, strict=True)
        ]
        length_share = end - begin
        too_coarse = (np.maximum.reduce(deviations) > limit) & (
            np.minimum(length_share, length_share * path.length[motion]) > _SHORTEST
        )
        motion, begin, end = motion[too_coarse], begin[too_coarse], end[too_coarse]
        middle = 0.5 * (begin + end)
        motions.append(motion)
        places.append(middle)
        motion, begin, end = np.tile(motion, 2), np.append(begin, middle), np.append(middle, end)
    return np.concatenate(motions), np.concatenate(places)


def _circle_deviation(forces: PathForces, arcs: Pieces, compliance: tuple[float, float]) -> Array:
    """Return the largest deviation (n,) [m] of circles through start, middle and end at the quarters of pieces."""
    displacements = []
    for share in _QUARTERS:
        t = np.where(share == 1.0, arcs.end, arcs.begin + share * (arcs.end - arcs.begin))
        sample = at(forces.axes.program, forces.axes.path, arcs.motion, t)
        wrench = forces.at(sample)
        displacements.append(sample.pose[:, :3, 3] - compliance[0] * wrench[:, :3] - compliance[1] * wrench[:, 3:])
    begin, _, middle, _, end = displacements
    centre, radial, tangential, angle = circle_through(begin, middle, end)
    deviation = np.zeros(len(begin))
    for share, displacement in zip(_QUARTERS, displacements, strict=True):
        part_angle = (angle * share)[:, None]
        deviation = np.maximum(
            deviation, norm(displacement - centre - np.cos(part_angle) * radial - np.sin(part_angle) * tangential)
        )
    return deviation
