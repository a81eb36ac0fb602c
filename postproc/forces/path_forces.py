"""The wrench anywhere on the path of a program, from the sources of its forces; and where that needs samples.

Samples are needed where the estimated displacement changes, and where FEED axes swing. Near the direction of the
spindle these turn by up to half a turn within a short part of an arc, or of a line that turns the tool. Pieces of one
size for the whole motion would be too many, so each piece is halved as long as its circle or line deviates from the
displacement by the force at its quarters. That needs only the wrench; the simulation of the written program finds the
response of the robot.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.chunks import Runs, compact
from postproc.errors import MAX_ERRORS, ForceError, Issue, combined_error
from postproc.forces.axes import LEAST_TURN, Axes, is_arc_across, is_line_across, last_travel, predecessors
from postproc.forces.precedence import combine, comment_knots, small_force_issues, unused_comment_issues
from postproc.forces.sources import BASE, FEED, ForceSource, Knots, LawForces, StockInTime
from postproc.frames import Array, any_column, largest, norm
from postproc.program import CIRC, LIN, SPL, Bools, Ints, Program, constant, distinct
from postproc.toolpath import DisplacementEstimate, Pieces, Segments, Toolpath, at, circle_through, columns_in_root

BEHIND_STEP = 1e-5
"""Distance behind a force step at which the path is sampled [m]: the correction changes over that length."""
_CONTINUOUS_SHARE = 2e-3
"""Relative change between consecutive forces below which no ramp is inserted (assumed)."""


class PathForces(Struct, frozen=True, eq=False):
    """The forces along the M motions of a program: K knots, at least one for each motion, linear between them.

    The knots are those of the sources. If the force of a motion is ramped, a knot at its start has the wrench at the
    end of the motion before, in `$BASE` axes, and the wrench of the motion follows at the end of the ramp. If a force
    in FEED axes starts with the value at which the force before ends, it has no ramp and turns with the path.

    :param axes: axes of the forces, which rotate them into `$BASE` axes.
    :param first: (M + 1,) the knots of motion i are those from first[i] to first[i + 1] (exclusive).
    :param place: (K,) row of `Motions` plus t: a sorted key; the end of a motion equals the start of the next one.
    :param t: (K,) position on the motion in [0, 1].
    :param wrench: (K, 6) Fx…Mz [N, N·m] on the tool at its tip, in the axes that `knot_frame` names.
    :param knot_frame: (K,) `BASE`, `TOOL` or `FEED`.
    :param spread: (K, 2, 3, 3) L of the covariances L·Lᵀ of force and moment, in the same axes; None if all are zero.
    :param factor: (K,) standard deviation of one factor of the whole wrench, see `Knots`.
    :param frame: (M,) frame in which the force of each motion is given.
    :param ramped: (M,) True if the force builds up over the ramp of the cell.
    :param issues: warnings and notes for the user, e.g. cutting moves without a force.
    :param law_forces: motions whose forces a cutting law computes; None: no law computes any.
    :param stock: the stock over time; None: the source of forces does not know it.
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
    law_forces: LawForces | None
    stock: StockInTime | None = None

    def at(self, sample: Toolpath) -> Array:
        """Return the wrench (N, 6) at samples of the path [N, N·m], `$BASE` axes of their motions."""

        def wrench_columns(knots: Ints) -> Array:
            """Return force and moment (k, 2, 3, 1) at knots (k,), in their frames."""
            return self.wrench.take(knots).reshape(-1, 2, 3, 1)

        return self._columns_in_base(wrench_columns, sample).reshape(-1, 6)

    def spread_at(self, sample: Toolpath) -> Array | None:
        """Return L (N, 2, 3, 3) of the covariances L·Lᵀ of force [N²] and moment [(N·m)²] at samples, `$BASE` axes.

        None if all are zero.
        """
        spread = self.spread
        return None if spread is None else self._columns_in_base(lambda knots: spread.take(knots, axis=0), sample)

    def factor_at(self, sample: Toolpath) -> Array:
        """Return the standard deviation (N,) of one factor of the whole wrench at samples, that at the next knot."""
        return np.asarray(self.factor[self._next_knot(sample)])

    def spread_in_root(self, sample: Toolpath) -> Array | None:
        """Return L of covariances L·Lᵀ of the wrench at samples, root axes; None if forces are certain.

        :returns: (N, 6, 6): six columns for independent errors of the components. If the wrench may have an unknown
            factor, (N, 6, 13), as `elastostatics.position_bound` takes them: behind these columns are six for the
            errors that the factor does not contain, and one for the factor.
        """
        spread = self.spread_at(sample)
        if spread is None:
            return None
        independent = _wrench_columns(columns_in_root(self.axes.program, sample.motion, spread))
        if not self.factor.any():
            return independent
        remaining, factor = (
            columns_in_root(self.axes.program, sample.motion, self._columns_in_base(deviation, sample))
            for deviation in (self._remaining_deviation, self._factor_deviation)
        )
        return np.concatenate([independent, _wrench_columns(remaining), factor.reshape(-1, 6, 1)], axis=2)

    def _factor_deviation(self, knots: Ints) -> Array:
        """Return the change (n, 2, 3, 1) of the wrench at knots for one standard deviation of its factor."""
        return np.asarray((self.wrench.take(knots) * self.factor[knots, None]).reshape(-1, 2, 3, 1))

    def _remaining_deviation(self, knots: Ints) -> Array:
        """Return L (n, 2, 3, 3) of the covariances at knots, without the part of the variance that the factor makes."""
        assert self.spread is not None
        total_variance = np.sum(np.square(self.spread.take(knots, axis=0)), axis=3)
        variance = total_variance - np.square(self._factor_deviation(knots))[..., 0]
        return np.asarray(np.sqrt(np.maximum(variance, 0.0))[..., None] * np.eye(3))

    def wrench_before(self) -> Array:
        """Return for each motion the wrench (M, 6) [N, N·m] at the end of the motion before, in its `$BASE` axes.

        It is zero at the start of the program.
        """
        return _wrench_before(self.wrench.take(self.first[1:] - 1), self.frame, self.axes)

    def is_behind_step(self, motion: Ints, t: Array) -> Bools:
        """Return True for places (n,) just behind the start of a motion without a ramp: the force may have a step.

        Samples behind a step are at the distance `BEHIND_STEP` from it. Places up to 1.5 times as far count: rounding
        moves a sample by less.

        :param motion: (n,) rows of `Motions`, and `t` (n,) the places on them, in [0, 1].
        """
        return np.asarray(~self.ramped[motion] & (self.axes.path.length[motion] * t < 1.5 * BEHIND_STEP))

    def _next_knot(self, sample: Toolpath) -> Ints:
        """Return for each sample the knot (N,) of its motion at or after it, or the last knot of the motion."""
        first, last = self.first[sample.motion], self.first[sample.motion + 1] - 1
        # motion + t is one increasing key of places, see `place`
        return np.clip(np.searchsorted(self.place, sample.motion + sample.t), first, last)

    def _columns_in_base(self, columns: Callable[[Ints], Array], sample: Toolpath) -> Array:
        """Return columns (N, 2, 3, m) of force and moment at samples in `$BASE` axes: linear between knots.

        Between knots of one frame columns are interpolated in that frame and then rotated. On a ramp, whose first knot
        is in `$BASE` axes, the later knot is rotated first.

        :param columns: returns the columns (n, 2, 3, m) at knots (n,), in the frames of the knots.
        """
        t, right = sample.t, self._next_knot(sample)
        # at a knot, and before the first one of a motion, the knot itself counts: left is right there
        left = np.where(self.t[right] > t, np.maximum(right - 1, self.first[sample.motion]), right)
        values, frame = columns(right), self.knot_frame[right]
        inner_rows = np.flatnonzero(left != right)
        left, right = left[inner_rows], right[inner_rows]
        share = ((t[inner_rows] - self.t[left]) / (self.t[right] - self.t[left]))[:, None, None, None]
        begin = columns(left)
        same_frame = self.knot_frame[left] == frame[inner_rows]
        steady_rows, ramp_rows = inner_rows[same_frame], inner_rows[~same_frame]
        values[steady_rows] = begin[same_frame] + share[same_frame] * (values[steady_rows] - begin[same_frame])
        values = self.axes.in_base_axes(values, frame, sample)
        values[ramp_rows] = begin[~same_frame] + share[~same_frame] * (values[ramp_rows] - begin[~same_frame])
        return values


def _wrench_columns(columns: Array) -> Array:
    """Return columns (N, 6, 6) of the wrench from columns (N, 2, 3, 3) of force and moment, which are independent."""
    wrench_columns = np.zeros((len(columns), 6, 6))
    wrench_columns[:, :3, :3], wrench_columns[:, 3:, 3:] = columns[:, 0], columns[:, 1]
    return wrench_columns


def assign(program: Program, path: Segments, source: ForceSource | None, axis: str, ramp: float) -> PathForces:
    """Return the forces along the motions of a program; `precedence` states which source counts on which motion.

    Rapid moves have no force.

    :param path: the geometry of the motions.
    :param source: forces in addition to the comments of the program; None: the comments only.
    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :param ramp: length over which a force builds up if it is given for a whole motion [m].
    :raises ForceError: the source cannot be used for this program; a FEED force with a component across the spindle on
        a move along the spindle, without any move across it; a force on a move from [start] of the cell.
    """
    m = program.motions
    stated_forces, issues = _stated_knots(program, path, source)
    law_forces, stock = stated_forces.law_forces, stated_forces.stock
    issues += unused_comment_issues(program)
    if law_forces is None:
        issues += small_force_issues(program, stated_forces)
    is_forceless = np.ones(len(m), dtype=np.bool_)
    is_forceless[stated_forces.motion] = False
    has_travel = ~m.rapid & (path.length > _ZERO_LENGTH)
    issues = _warning(program, np.flatnonzero(is_forceless & has_travel), "no-force", _NO_FORCE_MESSAGE) + issues
    cutting_forces = stated_forces.take(~m.rapid[stated_forces.motion])
    _check_start(program, cutting_forces)
    forceless = np.flatnonzero(is_forceless | m.rapid)
    knots = cutting_forces.with_fallback(
        Knots.throughout(forceless, np.zeros((len(forceless), 6)), np.full(len(forceless), BASE))
    )
    travel, travel_notes = _feed_travel(program, path, knots, axis)
    path_forces = _forces_with_ramps(
        knots, Axes(program, path, axis, travel), ramp, (*issues, *travel_notes), law_forces
    )
    return replace(path_forces, stock=stock)


def _stated_knots(program: Program, path: Segments, source: ForceSource | None) -> tuple[Knots, list[Issue]]:
    """Return the forces that a source and the comments of the program state, and issues about them.

    Rapid moves keep their forces here. The knots have the law forces and the stock of the source.

    :param path: the geometry of the motions.
    :param source: source of forces; None: the comments of the program only.
    :raises ForceError: the source cannot be used for this program.
    """
    if source is None:
        return comment_knots(program), []
    source_knots = source.along(program, path).check(program, source.name)
    knots, issues = combine(program, source_knots, source.name)
    has_rapid_force = any_column(source_knots.wrench != 0.0) & program.motions.rapid[source_knots.motion]
    issues += source_knots.issues
    issues += _warning(program, source_knots.motion[has_rapid_force], "force-on-rapid", _RAPID_MESSAGE)
    return replace(knots, law_forces=source_knots.law_forces, stock=source_knots.stock), issues


def _check_start(program: Program, knots: Knots) -> None:
    """Refuse forces on moves from `[start]` of the cell: the program does not define the path there.

    :raises ForceError: a knot on one of `Program.unforced` has a force.
    """
    unforced = np.isin(knots.motion, program.unforced)  # few, so that few wrenches are expanded in memory
    motions = knots.motion[unforced][any_column(knots.wrench[unforced] != 0.0)]
    if len(motions):
        advice = "Program X, Y and Z in rapid moves (G0) before cutting, or switch the force on after this move."
        raise _refusal(program, motions, "a force on a move from [start] of the cell", advice)


def _refusal(program: Program, motions: Ints, problem: str, advice: str) -> ForceError:
    """Return one error for all source lines of motions (n,), each with the same problem and advice."""
    name, lines = program.documents[0].name, distinct(program.motions.line[motions])
    lines = lines[: MAX_ERRORS + 1]  # one more than are shown, by which the message says that there are others
    return combined_error(ForceError(problem, file=name, line=line, advice=advice) for line in lines.tolist())


_ZERO_LENGTH = 1e-9
"""A move of at most this length [m] cuts nothing: its ends differ by rounding as those of a LIN to where a PTP ends."""
_NO_FORCE_MESSAGE = "cutting moves without a force: zero force is assumed"
_RAPID_MESSAGE = "rapid moves carry no force: the row is ignored"


def _warning(program: Program, motion: Ints, kind: str, message: str) -> list[Issue]:
    """Return a list with one warning for all motions (n,); an empty list without motions."""
    return [program.motions.issue("warning", kind, message, motion)] if len(motion) else []


def _forces_with_ramps(
    knots: Knots, axes: Axes, ramp: float, issues: tuple[Issue, ...], law_forces: LawForces | None
) -> PathForces:
    """Return the forces from knots that cover every motion, with ramps inserted.

    A ramp needs a second knot at the start of its motion, with the values at the end of the motion before. The only
    knot of a ramped motion moves to the end of the ramp.

    :param knots: in order, at least one on every motion.
    :param axes: axes of the forces, with program and path.
    :param ramp: length over which a force builds up if it is given for a whole motion [m].
    :param issues: warnings and notes for the user, and `law_forces` the motions whose forces a cutting law computes.
    """
    motions = np.arange(len(axes.program.motions))
    first = np.searchsorted(knots.motion, np.append(motions, len(motions)))
    last = first[1:] - 1  # last knot of each motion
    start = _start_forces(knots, last, axes)
    has_ramp = knots.ramped[last]
    changes = has_ramp & _has_changed_force(start, knots, last)
    ramp_knots = first[:-1][changes]  # a ramped motion has one knot
    t = knots.t.copy()
    t[ramp_knots] = ramp / np.maximum(axes.path.length[changes], ramp)  # a motion shorter than the ramp is all ramp
    t = np.insert(t, ramp_knots, 0.0)
    spread = None
    if start.spread is not None:
        spread = np.insert(_covariance_factors(knots.sigma), ramp_knots, start.spread[changes], axis=0)
    first = first + np.concatenate([[0], np.cumsum(changes)])  # after the inserted knots
    return PathForces(
        axes=axes,
        first=compact(first, np.int32),
        place=np.repeat(motions, np.diff(first)) + t,
        t=t,
        wrench=Runs.of(np.insert(knots.wrench, ramp_knots, start.wrench[changes], axis=0)),
        knot_frame=compact(np.insert(knots.frame, ramp_knots, start.frame[changes]), np.int8),
        spread=spread,
        factor=_factors_with_ramps(knots.factor, last, changes, ramp_knots, axes.program),
        frame=compact(knots.frame[last], np.int8),
        ramped=has_ramp,
        issues=issues,
        law_forces=law_forces,
    )


class _StartForces(NamedTuple):
    """The forces at the start of each motion, before its ramp.

    :param wrench: (M, 6) [N, N·m], in the axes that `frame` names.
    :param frame: (M,) `BASE`; on a motion whose force continues the force before, the frame of the motion.
    :param spread: (M, 2, 3, 3) L of the covariances L·Lᵀ of force and moment, in the same axes; None if all are zero.
    """

    wrench: Array
    frame: Ints
    spread: Array | None


def _start_forces(knots: Knots, last: Ints, axes: Axes) -> _StartForces:
    """Return the forces with which ramps begin: those at the end of the motion before.

    Where the force of a motion continues the force before, it begins with the force of the motion: there is no ramp.

    :param last: (M,) the last knot of each motion.
    """
    wrench, frame = knots.wrench.take(last, axis=0), knots.frame[last]
    start_wrench, start_frame = _wrench_before(wrench, frame, axes), np.full(len(last), BASE)
    steady = _continuing_motions(wrench, frame, start_wrench, axes)
    start_wrench[steady], start_frame[steady] = wrench[steady], frame[steady]
    if not knots.sigma.any():
        return _StartForces(start_wrench, start_frame, None)
    spread = _covariance_factors(knots.sigma[last])
    start_spread = axes.columns_at_start(spread, frame)
    start_spread[steady] = spread[steady]
    return _StartForces(start_wrench, start_frame, start_spread)


def _has_changed_force(start: _StartForces, knots: Knots, last: Ints) -> Bools:
    """Return True for motions (M,) whose wrench, frame or standard deviation differs from that at their start.

    :param last: (M,) the last knot of each motion.
    """
    differs = any_column(start.wrench != knots.wrench.take(last, axis=0)) | (start.frame != knots.frame[last])
    if start.spread is not None:
        differs |= (start.spread != _covariance_factors(knots.sigma[last])).any(axis=(1, 2, 3))
    return np.asarray(differs)


def _covariance_factors(sigma: Array) -> Array:
    """Return L (n, 2, 3, 3) of the covariances L·Lᵀ of force and moment, from standard deviations (n, 6)."""
    return np.asarray(sigma.reshape(-1, 2, 3, 1) * np.eye(3))


def _factors_with_ramps(factor: Array, last: Ints, changes: Bools, ramp_knots: Ints, program: Program) -> Array:
    """Return the standard deviations of the factor at knots, after knots are inserted for ramps.

    An inserted knot gets the value of the motion before; 0 at the start of the program.

    :param factor: (K,) values at the knots without the inserted ones, and `last` (M,) the last knot of each motion.
    :param changes: (M,) True for motions with an inserted knot.
    :param ramp_knots: the knots before which they are inserted.
    """
    if not factor.any():
        return constant(0.0, len(factor) + len(ramp_knots))
    previous = predecessors(program)[changes]
    return np.insert(factor, ramp_knots, np.where(previous >= 0, factor[last[previous]], 0.0))


def _wrench_before(wrench: Array, frame: Ints, axes: Axes) -> Array:
    """Return for each motion the wrench (M, 6) at the end of the motion before, in `$BASE` axes of the motion.

    :param wrench: (M, 6) wrench at the end of each motion [N, N·m], in the axes of `frame` (M,).
    """
    return axes.columns_at_start(wrench.reshape(-1, 2, 3, 1), frame).reshape(-1, 6)


def _continuing_motions(wrench: Array, frame: Ints, previous: Array, axes: Axes) -> Ints:
    """Return the motions (n,) with a force in FEED axes that continues the force before: it turns with the path.

    :param wrench: (M, 6) wrenches of the motions [N, N·m], in the axes of `frame` (M,).
    :param previous: (M, 6) wrenches at the end of the motion before, in `$BASE` axes.
    """
    rows = np.flatnonzero(frame == FEED)
    start = at(axes.program, axes.path, rows, np.zeros(len(rows)))
    start_wrench = axes.in_base_axes(wrench[rows].reshape(-1, 2, 3, 1), frame[rows], start).reshape(-1, 6)
    difference = norm(start_wrench - previous[rows])
    return rows[any_column(start_wrench != 0.0) & (difference < _CONTINUOUS_SHARE * norm(start_wrench))]


def _feed_travel(program: Program, path: Segments, knots: Knots, axis: str) -> tuple[Array, list[Issue]]:
    """Return `Axes.travel` (M, 3), and notes about it for the user; (0, 3) and no note without forces in FEED axes.

    :raises ForceError: a FEED force on a piece of a spline, or on a move along the spindle without a travel direction.
    """
    m = program.motions
    feed = knots.frame == FEED
    if not feed.any():
        return np.zeros((0, 3)), []
    spline_motions = distinct(knots.motion[feed & (m.kind[knots.motion] == SPL) & any_column(knots.wrench != 0.0)])
    if len(spline_motions):
        problem = "a FEED force on a piece of a spline, whose direction is not known"
        raise _refusal(program, spline_motions, problem, "Give its force in BASE or TOOL axes.")
    travel, needs_direction = last_travel(program, path, axis)
    # components along z, the spindle, are the same for any travel direction: those along x and y need one
    lateral = [0, 1, 3, 4]
    is_lateral = (knots.wrench[:, lateral] != 0.0) | (knots.sigma[:, lateral] != 0.0)
    has_lateral_force = np.zeros(len(m), dtype=np.bool_)
    has_lateral_force[knots.motion[feed & any_column(is_lateral)]] = True
    needs_direction &= has_lateral_force
    is_undefined = needs_direction & np.isnan(travel[:, 0])
    if is_undefined.any():
        advice = (
            "No other move of the program has a feed direction across the spindle that this one could use. "
            "Give its force in BASE or TOOL axes."
        )
        raise _refusal(program, np.flatnonzero(is_undefined), "a FEED force on a move along the spindle", advice)
    issues = []
    if needs_direction.any():
        message = (
            "a FEED force on a move along the spindle, which has no feed direction: x is the travel direction of the "
            "last move across the spindle, or of the first one if none precedes"
        )
        issues.append(m.issue("info", "feed-direction", message, np.flatnonzero(needs_direction)))
    return travel, issues


_LEAST_CHANGE = 1e-9
"""Changes of the force below this [N, N·m] count as none (assumed)."""
_LEAST_STEP = 1e-8
"""Displacement [m] by the least change of the force from motion to motion that counts as a step (assumed)."""


def displacement_estimate(forces: PathForces, compliance: tuple[float, float]) -> DisplacementEstimate:
    """Return a rough estimate of how the displacement by the force changes along the motions.

    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    """
    m, path = forces.axes.program.motions, forces.axes.path
    motion = np.repeat(np.arange(len(m)), np.diff(forces.first))
    change, bends = _changes_and_bends(forces, motion)
    step_size = _displacement_sizes(_force_steps(forces), compliance)
    step_motions = np.flatnonzero(step_size > _LEAST_STEP)
    # `BEHIND_STEP` behind the start of the motion, at most in its middle
    step_t = np.minimum(0.5, BEHIND_STEP / np.maximum(path.length[step_motions], BEHIND_STEP))
    turning_size, swings = _turning_displacements(forces, motion, compliance)
    # places: the knots that count, and the places behind steps
    knots = np.flatnonzero(bends | (m.kind[motion] == CIRC))
    place_motion, place_t = np.append(motion[knots], step_motions), np.append(forces.t[knots], step_t)
    order = np.lexsort((place_t, place_motion))  # by motion, then by t
    return DisplacementEstimate(
        motion=place_motion[order],
        t=place_t[order],
        change=np.append(_displacement_sizes(change, compliance)[knots], step_size[step_motions])[order],
        is_bend=np.append(bends[knots], np.ones(len(step_motions), dtype=np.bool_))[order],
        turning=turning_size,
        size=_largest_of_motions(forces, _displacement_sizes(forces.wrench[:], compliance)),
        swings=swings,
    )


def _displacement_sizes(wrench: Array, compliance: tuple[float, float]) -> Array:
    """Return upper bounds (n,) [m] of the displacements by wrenches (n, 6) [N, N·m].

    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    """
    return np.asarray(compliance[0] * norm(wrench[:, :3]) + compliance[1] * norm(wrench[:, 3:]))


def _largest_of_motions(forces: PathForces, values: Array) -> Array:
    """Return for each motion the largest of the values at its knots (M,).

    A knot at the start of a ramp has the force of the motion before: it does not count.

    :param values: (K,) values at all knots, 0 or larger.
    """
    first = forces.first[:-1]
    is_inherited = np.zeros(len(forces.t), dtype=np.bool_)
    is_inherited[first[forces.ramped & (forces.t[first] == 0.0)]] = True
    return np.asarray(np.maximum.reduceat(np.where(is_inherited, 0.0, values), first))


def _turning_displacements(forces: PathForces, motion: Ints, compliance: tuple[float, float]) -> tuple[Array, Bools]:
    """Return sizes (M,) [m] of the displacement that turns with arcs, and True (M,) for arcs on which FEED axes swing.

    :param motion: (K,) motion of each knot.
    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    """
    m, path = forces.axes.program.motions, forces.axes.path
    has_turning_force = (m.kind == CIRC) & (forces.frame == FEED)
    swings = np.zeros(len(m), dtype=np.bool_)
    if not has_turning_force.any():
        return constant(0.0, len(m)), swings
    lateral = forces.wrench[:] * (1.0, 1.0, 0.0, 1.0, 1.0, 0.0)  # z, along the spindle, does not turn
    size = np.where(has_turning_force, _largest_of_motions(forces, _displacement_sizes(lateral, compliance)), 0.0)
    has_force = np.zeros(len(m), dtype=np.bool_)
    has_force[motion[any_column(lateral != 0.0)]] = True
    arcs = np.flatnonzero(has_turning_force & has_force)
    swings[arcs] = ~is_arc_across(forces.axes.program, path, arcs, forces.axes.spindle)
    return size, swings


def _changes_and_bends(forces: PathForces, motion: Ints) -> tuple[Array, Bools]:
    """Return the change (K, 6) of the force since the knot before, and True (K,) for knots at which its rate changes.

    :param motion: (K,) motion of each knot.
    :returns: the change [N, N·m] in the axes of the later knot, zero at the first knot of a motion.
    """
    t = forces.t
    follows = np.append(False, np.diff(motion) == 0)  # knots that follow another knot of the same motion
    # wrenches in the same frame are subtracted; otherwise both are turned into the axes of the later knot
    same_frame = follows & (np.diff(forces.knot_frame, prepend=0) == 0)
    change = np.diff(forces.wrench[:], axis=0, prepend=forces.wrench[:1])
    change[~same_frame] = 0.0
    rows = np.flatnonzero(follows & ~same_frame)
    place = at(forces.axes.program, forces.axes.path, motion[rows], t[rows])
    change[rows] = forces.at(place) - forces.wrench[rows - 1]
    return change, _has_rate_change(t, change, follows)


def _has_rate_change(t: Array, change: Array, follows: Bools) -> Bools:
    """Return True for knots (K,) inside of a motion at which the rate of the force changes.

    :param t: (K,) position of the knots on their motions, in [0, 1].
    :param change: (K, 6) change of the force since the knot before [N, N·m].
    :param follows: (K,) True for knots that follow another knot of the same motion.
    """
    bends = np.zeros(len(t), dtype=np.bool_)
    knots = np.flatnonzero((t > 0.0) & (t < 1.0))
    # t since the knot before; infinite where there is none, also behind the last knot: the rate is 0 there
    interval = np.append(np.where(follows, np.diff(t, prepend=0.0), np.inf), np.inf)
    next_change = change[np.minimum(knots + 1, len(t) - 1)]
    rate_change = next_change / interval[knots + 1, None] - change[knots] / interval[knots, None]
    # a change of the rate counts by the change of force that it makes over the interval before it
    width = np.where(follows[knots], interval[knots], 1.0)
    bends[knots] = largest(rate_change * width[:, None]) >= _LEAST_CHANGE
    return bends


def _force_steps(forces: PathForces) -> Array:
    """Return the step (M, 6) [N, N·m] of the force at the start of each motion, `$BASE` axes; zero on ramps."""
    rows = np.flatnonzero(~forces.ramped)
    if not len(rows):
        return np.broadcast_to(0.0, (len(forces.ramped), 6))
    steps, previous = np.zeros((len(forces.ramped), 6)), forces.wrench_before()
    start = at(forces.axes.program, forces.axes.path, rows, np.zeros(len(rows)))
    steps[rows] = forces.at(start) - previous[rows]
    return steps


_LEAST_PIECE = 1e-7
"""Pieces shorter than this [m, share of the motion] are not halved: the decimals of a program do not resolve them."""
_QUARTERS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of a piece at which its circle, or its chord, is compared with the displacement."""


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
    open_pieces = arcs.take(swings)
    open_pieces = open_pieces.with_enough_pieces(open_pieces.min_number).cut(open_pieces.min_number)
    finished_pieces = [arcs.take(~swings)]
    length = forces.axes.path.length
    while len(open_pieces.motion):
        share = open_pieces.end - open_pieces.begin
        is_divisible = np.minimum(share, share * length[open_pieces.motion]) > _LEAST_PIECE
        is_too_coarse = is_divisible & (_circle_deviation(forces, open_pieces, compliance) > limit)
        finished_pieces.append(open_pieces.take(~is_too_coarse))
        open_pieces = open_pieces.take(is_too_coarse)
        open_pieces = open_pieces.cut(np.full(len(open_pieces.motion), 2))
    return Pieces.join(finished_pieces).sort()


def swing_places(forces: PathForces, compliance: tuple[float, float], limit: float) -> tuple[Ints, Array]:
    """Return places of straight motions, motion (n,) and t (n,), between which the displacement by the force is linear.

    They are needed where the tool axis passes near the direction of travel: FEED axes swing there.

    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    :param limit: permitted deviation between two places [m].
    """
    program, path = forces.axes.program, forces.axes.path
    is_turning = (program.motions.kind == LIN) & (forces.frame == FEED) & (path.turn > LEAST_TURN) & (path.length > 0.0)
    motion = np.flatnonzero(is_turning)
    motion = motion[~is_line_across(program, path, motion, forces.axes.spindle)]
    begin, end = np.zeros(len(motion)), np.ones(len(motion))
    motions, places = [motion[:0]], [begin[:0]]
    while len(motion):
        length_share = end - begin
        is_divisible = np.minimum(length_share, length_share * path.length[motion]) > _LEAST_PIECE
        is_too_coarse = is_divisible & (_line_deviation(forces, motion, begin, end, compliance) > limit)
        motion, begin, end = motion[is_too_coarse], begin[is_too_coarse], end[is_too_coarse]
        middle = 0.5 * (begin + end)
        motions.append(motion)
        places.append(middle)
        # both halves of each piece are the pieces of the next round
        motion, begin, end = np.tile(motion, 2), np.append(begin, middle), np.append(middle, end)
    return np.concatenate(motions), np.concatenate(places)


def _line_deviation(
    forces: PathForces, motion: Ints, begin: Array, end: Array, compliance: tuple[float, float]
) -> Array:
    """Return the largest deviation (n,) [m] of the displacement on pieces of motions from a linear change.

    Displacements are compared at quarters of the pieces. Displacements by forces and by moments are three components
    each, so that they do not cancel.

    :param motion: (n,) motion of each piece.
    :param begin: (n,) place on the motion where the piece begins, in [0, 1], and `end` (n,) where it ends.
    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    """
    displacements = []
    for share in _QUARTERS:
        wrench = forces.at(at(forces.axes.program, forces.axes.path, motion, begin + share * (end - begin)))
        displacements.append(np.hstack([compliance[0] * wrench[:, :3], compliance[1] * wrench[:, 3:]]))
    start_displacement, end_displacement = displacements[0], displacements[-1]
    deviations = [
        norm(displacement - start_displacement - share * (end_displacement - start_displacement))
        for share, displacement in zip(_QUARTERS, displacements, strict=True)
    ]
    return np.asarray(np.maximum.reduce(deviations))


def _circle_deviation(forces: PathForces, arcs: Pieces, compliance: tuple[float, float]) -> Array:
    """Return the largest deviation (n,) [m] of pieces from circles through their starts, middles and ends.

    At quarters of the pieces, the positions of the tool displaced by the force are compared with the circle.

    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    """
    positions = []
    for share in _QUARTERS:
        t = np.where(share == 1.0, arcs.end, arcs.begin + share * (arcs.end - arcs.begin))
        sample = at(forces.axes.program, forces.axes.path, arcs.motion, t)
        wrench = forces.at(sample)
        positions.append(sample.pose.position - compliance[0] * wrench[:, :3] - compliance[1] * wrench[:, 3:])
    begin, _, middle, _, end = positions  # at five shares, see `_QUARTERS`
    arc = circle_through(begin, middle, end)
    deviation = np.zeros(len(begin))
    for share, position in zip(_QUARTERS, positions, strict=True):
        angle = (arc.angle * share)[:, None]
        on_circle = np.cos(angle) * arc.radial, np.sin(angle) * arc.tangential
        deviation = np.maximum(deviation, norm(position - arc.centre - on_circle[0] - on_circle[1]))
    return deviation
