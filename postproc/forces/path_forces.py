"""The wrench anywhere on the path of a program, from the sources of its forces; and where that needs samples.

Samples are needed where the estimated displacement changes, and where FEED axes swing. Near the direction of the
spindle these turn by up to half a turn within a short part of an arc, or of a line that turns the tool. Pieces (parts
of a motion, each written as one motion) of one size for the whole motion would be too many, so each piece is halved as
long as its circle or line deviates from the displacement by the force at its quarters. That needs only the wrench; the
simulation of the written program finds the response of the robot.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from msgspec import Struct

from postproc.chunks import Runs
from postproc.errors import Issue
from postproc.forces.axes import LEAST_TURN, Axes, is_arc_across, is_line_across
from postproc.forces.sources import FEED, LawForces, StockInTime
from postproc.frames import Array, any_column, largest, norm
from postproc.program import CIRC, LIN, Bools, Ints, constant
from postproc.toolpath import DisplacementEstimate, Pieces, Toolpath, at, circle_through, columns_in_root

BEHIND_STEP = 1e-5
"""Distance behind a force step at which the path is sampled [m]: the correction changes over that length."""


class PathForces(Struct, frozen=True, eq=False):
    """The forces along the M motions of a program: K knots, at least one for each motion, linear between them.

    A knot is a wrench at a place on a motion; the sources of forces state them. A force is ramped if it builds up over
    the first `force_ramp_mm` of its motion: a knot at the start has the wrench at the end of the motion before, in
    `$BASE` axes, and the wrench of the motion follows at the end of the ramp. If a force in FEED axes starts with the
    value at which the force before ends, it has no ramp and turns with the path.

    :param axes: axes of the forces, which rotate them into `$BASE` axes.
    :param first: (M + 1,) the knots of motion i are those from first[i] to first[i + 1] (exclusive).
    :param place: (K,) row of `Motions` plus t: a sorted key; the end of a motion equals the start of the next one.
    :param t: (K,) position on the motion: 0 at its start, 1 at its end.
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
    issues: tuple[Issue, ...] = ()
    law_forces: LawForces | None = None
    stock: StockInTime | None = None

    def at(self, sample: Toolpath) -> Array:
        """Return the wrench (N, 6) at samples of the path [N, N·m] on the tool at its tip, `$BASE` axes."""

        def wrench_columns(knots: Ints) -> Array:
            """Return force and moment (k, 2, 3, 1) at knots (k,), in their frames."""
            return self.wrench.take(knots).reshape(-1, 2, 3, 1)

        return self._columns_in_base(wrench_columns, sample).reshape(-1, 6)

    def spread_at(self, sample: Toolpath) -> Array | None:
        """Return the spread L (N, 2, 3, 3) of force and moment at samples, `$BASE` axes; None if all are zero.

        The covariances of force [N²] and moment [(N·m)²] are L·Lᵀ.
        """
        spread = self.spread
        return None if spread is None else self._columns_in_base(lambda knots: spread.take(knots, axis=0), sample)

    def factor_at(self, sample: Toolpath) -> Array:
        """Return the standard deviation (N,) of one unknown factor of the whole wrench at samples.

        Such a factor is common to all forces of a cutting law, as for a harder material. A sample has that of the next
        knot.
        """
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
        independent_columns = _wrench_columns(columns_in_root(self.axes.program, sample.motion, spread))
        if not self.factor.any():
            return independent_columns
        remaining, factor = (
            columns_in_root(self.axes.program, sample.motion, self._columns_in_base(deviation, sample))
            for deviation in (self._remaining_deviation, self._factor_deviation)
        )
        return np.concatenate([independent_columns, _wrench_columns(remaining), factor.reshape(-1, 6, 1)], axis=2)

    def _factor_deviation(self, knots: Ints) -> Array:
        """Return the change (n, 2, 3, 1) of force and moment at knots (n,) for one standard deviation of the factor."""
        return np.asarray((self.wrench.take(knots) * self.factor[knots, None]).reshape(-1, 2, 3, 1))

    def _remaining_deviation(self, knots: Ints) -> Array:
        """Return the spread L (n, 2, 3, 3) at knots (n,), without the variance that the unknown factor causes."""
        assert self.spread is not None
        total_variance = np.sum(np.square(self.spread.take(knots, axis=0)), axis=3)
        variance = total_variance - np.square(self._factor_deviation(knots))[..., 0]
        return np.asarray(np.sqrt(np.maximum(variance, 0.0))[..., None] * np.eye(3))

    def wrench_before(self) -> Array:
        """Return for each motion the wrench (M, 6) [N, N·m] at the end of the motion before, in its `$BASE` axes.

        It is zero at the start of the program.
        """
        return self.axes.wrench_at_start(self.wrench.take(self.first[1:] - 1), self.frame)

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

        Knots are the places on motions at which the forces are given.

        Between knots of one frame columns are interpolated in that frame and then rotated. On a ramp, whose first knot
        is in `$BASE` axes, the later knot is rotated first.

        :param columns: returns the columns (n, 2, 3, m) at knots (n,), in the frames of the knots.
        """
        t, right = sample.t, self._next_knot(sample)
        # at a knot, and before the first one of a motion, the knot itself counts: left is right there
        left = np.where(self.t[right] > t, np.maximum(right - 1, self.first[sample.motion]), right)
        values, frame = columns(right), self.knot_frame[right]
        inner_rows = np.flatnonzero(left != right)  # samples between two knots
        left, right = left[inner_rows], right[inner_rows]
        share = ((t[inner_rows] - self.t[left]) / (self.t[right] - self.t[left]))[:, None, None, None]
        left_values = columns(left)
        has_same_frame = self.knot_frame[left] == frame[inner_rows]
        same_frame_rows, ramp_rows = inner_rows[has_same_frame], inner_rows[~has_same_frame]
        difference = values[same_frame_rows] - left_values[has_same_frame]
        values[same_frame_rows] = left_values[has_same_frame] + share[has_same_frame] * difference
        values = self.axes.in_base_axes(values, frame, sample)
        ramp_difference = values[ramp_rows] - left_values[~has_same_frame]
        values[ramp_rows] = left_values[~has_same_frame] + share[~has_same_frame] * ramp_difference
        return values


def _wrench_columns(columns: Array) -> Array:
    """Return columns (N, 6, 6) of the wrench from columns (N, 2, 3, 3) of force and moment, which are independent."""
    wrench_columns = np.zeros((len(columns), 6, 6))
    wrench_columns[:, :3, :3], wrench_columns[:, 3:, 3:] = columns[:, 0], columns[:, 1]
    return wrench_columns


_LEAST_CHANGE = 1e-9
"""Changes of the force below this [N, N·m] count as none (assumed)."""
_LEAST_STEP = 1e-8
"""Displacement [m] by the least change of the force from motion to motion that counts as a step (assumed)."""


def displacement_estimate(forces: PathForces, compliance: tuple[float, float]) -> DisplacementEstimate:
    """Return a rough estimate of how the displacement by the force changes along the motions.

    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    """
    m, path = forces.axes.program.motions, forces.axes.path
    motion = np.repeat(np.arange(len(m)), np.diff(forces.first))  # of each knot
    change, has_bend = _changes_and_bends(forces, motion)
    step_size = _displacement_sizes(_force_steps(forces), compliance)
    step_motions = np.flatnonzero(step_size > _LEAST_STEP)
    # `BEHIND_STEP` behind the start of the motion, at most in its middle
    step_t = np.minimum(0.5, BEHIND_STEP / np.maximum(path.length[step_motions], BEHIND_STEP))
    turning_size, swings = _turning_displacements(forces, motion, compliance)
    # places: the knots that count, and the places behind steps
    knots = np.flatnonzero(has_bend | (m.kind[motion] == CIRC))
    place_motion, place_t = np.append(motion[knots], step_motions), np.append(forces.t[knots], step_t)
    order = np.lexsort((place_t, place_motion))  # by motion, then by t
    return DisplacementEstimate(
        motion=place_motion[order],
        t=place_t[order],
        change=np.append(_displacement_sizes(change, compliance)[knots], step_size[step_motions])[order],
        is_bend=np.append(has_bend[knots], np.ones(len(step_motions), dtype=np.bool_))[order],
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
    is_ramp_start = np.zeros(len(forces.t), dtype=np.bool_)
    is_ramp_start[first[forces.ramped & (forces.t[first] == 0.0)]] = True
    return np.asarray(np.maximum.reduceat(np.where(is_ramp_start, 0.0, values), first))


def _turning_displacements(forces: PathForces, motion: Ints, compliance: tuple[float, float]) -> tuple[Array, Bools]:
    """Return sizes (M,) [m] of the displacement that turns with arcs, and True (M,) for arcs on which FEED axes swing.

    They swing where the travel comes near the direction of the spindle: there they turn much faster than the travel.

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
    has_predecessor = np.append(False, np.diff(motion) == 0)  # knots that follow another knot of the same motion
    # wrenches in the same frame are subtracted; otherwise both are turned into the axes of the later knot
    has_same_frame = has_predecessor & (np.diff(forces.knot_frame, prepend=0) == 0)
    change = np.diff(forces.wrench[:], axis=0, prepend=forces.wrench[:1])
    change[~has_same_frame] = 0.0
    rows = np.flatnonzero(has_predecessor & ~has_same_frame)  # ends of ramps: the knot before is in `$BASE` axes
    place = at(forces.axes.program, forces.axes.path, motion[rows], t[rows])
    change[rows] = forces.at(place) - forces.wrench[rows - 1]
    return change, _has_rate_change(t, change, has_predecessor)


def _has_rate_change(t: Array, change: Array, has_predecessor: Bools) -> Bools:
    """Return True for knots (K,) inside of a motion at which the rate of the force changes.

    :param t: (K,) position of the knots on their motions, in [0, 1].
    :param change: (K, 6) change of the force since the knot before [N, N·m].
    :param has_predecessor: (K,) True for knots that follow another knot of the same motion.
    """
    has_change = np.zeros(len(t), dtype=np.bool_)
    knots = np.flatnonzero((t > 0.0) & (t < 1.0))
    # t since the knot before; infinite where there is none, also behind the last knot: the rate is 0 there
    interval = np.append(np.where(has_predecessor, np.diff(t, prepend=0.0), np.inf), np.inf)
    next_change = change[np.minimum(knots + 1, len(t) - 1)]
    rate_change = next_change / interval[knots + 1, None] - change[knots] / interval[knots, None]
    # a change of the rate counts by the change of force that it makes over the interval before it
    width = np.where(has_predecessor[knots], interval[knots], 1.0)
    has_change[knots] = largest(rate_change * width[:, None]) >= _LEAST_CHANGE
    return has_change


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
"""Shares of a piece (0 at its start, 1 at its end) at which its circle or chord is compared with the displacement."""


def refined_arcs(
    forces: PathForces, arcs: Pieces, estimate: DisplacementEstimate, compliance: tuple[float, float], limit: float
) -> Pieces:
    """Return the pieces, halved where the force swings, until their circles follow it or the pieces are too short.

    :param arcs: the division of the arcs into pieces, each of which is written as one circle.
    :param estimate: says on which arcs the force swings.
    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    :param limit: permitted deviation [m].
    """
    swings = estimate.swings[arcs.motion]
    if not swings.any():
        return arcs
    open_pieces = arcs.take(swings)
    open_pieces = open_pieces.with_enough_pieces(open_pieces.min_number).divided(open_pieces.min_number)
    finished_pieces = [arcs.take(~swings)]
    length = forces.axes.path.length
    while len(open_pieces.motion):
        share = open_pieces.end - open_pieces.begin
        is_divisible = np.minimum(share, share * length[open_pieces.motion]) > _LEAST_PIECE
        is_too_coarse = is_divisible & (_circle_deviation(forces, open_pieces, compliance) > limit)
        finished_pieces.append(open_pieces.take(~is_too_coarse))
        open_pieces = open_pieces.take(is_too_coarse)
        open_pieces = open_pieces.divided(np.full(len(open_pieces.motion), 2))
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
    """Return the largest deviation (n,) [m] of corrected pieces from circles through their starts, middles and ends.

    A corrected position is about the nominal one less the displacement by the force. It is compared with the circle at
    the start, the quarters and the end of each piece.

    :param arcs: n pieces of arcs.
    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    """
    corrected_positions = []
    for share in _QUARTERS:
        t = np.where(share == 1.0, arcs.end, arcs.begin + share * (arcs.end - arcs.begin))
        sample = at(forces.axes.program, forces.axes.path, arcs.motion, t)
        wrench = forces.at(sample)
        # a moment counts as a displacement along its axis: only size and change matter to the estimate
        displacement = compliance[0] * wrench[:, :3], compliance[1] * wrench[:, 3:]
        corrected_positions.append(sample.pose.position - displacement[0] - displacement[1])
    begin, _, middle, _, end = corrected_positions  # without those at 0.25 and 0.75
    arc = circle_through(begin, middle, end)
    deviation = np.zeros(len(begin))
    for share, position in zip(_QUARTERS, corrected_positions, strict=True):
        angle = (arc.angle * share)[:, None]
        # `radial` and `tangential` have the length of the radius
        circle_position = np.cos(angle) * arc.radial, np.sin(angle) * arc.tangential
        deviation = np.maximum(deviation, norm(position - arc.centre - circle_position[0] - circle_position[1]))
    return deviation
