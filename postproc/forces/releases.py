"""Where the force of a cut ends because the program waits, and begins again behind the wait.

While a program waits, nothing is fed: the cutter cuts on until no chip is left, and the arm springs to the commanded
place. That must be the nominal one, so the force counts as falling to zero over the last `force_ramp_mm` before the
wait, as it rises over the first ones of a cut. The correction ends with it. Where the cut is fed to the end, the tool
stays behind over this length, and comes to the nominal place while the program waits. A correction that ended later
would let the tool spring beyond the nominal place first: without feed the force is gone within some teeth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc.chunks import Runs, compact
from postproc.forces.path_forces import BEHIND_STEP, PathForces
from postproc.forces.sources import Knots
from postproc.frames import Array, any_column
from postproc.program import CIRC, LIN, Bools, Ints, Program
from postproc.toolpath import Segments

_LEAST_LENGTH = 4.0 * BEHIND_STEP
"""A motion up to this length [m] before a wait has no force: it is too short to cut."""
_LARGEST_SHARE = 0.4
"""Largest share of a motion over which the force falls, or rises: both may be on one motion (assumed)."""


def released_motions(program: Program, path: Segments, knots: Knots) -> Bools:
    """Return True for the motions (M,) at whose end the force ends: lines and arcs under force before a wait.

    At a control-flow join (several branches, or the iterations of a loop, lead to one motion) the motions that may be
    the last one before it either all end without force, or none does: their corrected ends would be at different places
    otherwise, and the motion after the join begins at one.

    :param path: geometry of all motions.
    :param knots: the forces of the motions, at least one knot on each.
    """
    m, is_released = program.motions, np.zeros(len(program.motions), dtype=np.bool_)
    waiting_motions = program.waiting_motions  # at whose ends the program waits; −1: before the first motion
    waiting_motions = waiting_motions[waiting_motions >= 0]
    if not len(waiting_motions):
        return is_released
    last_knot = np.searchsorted(knots.motion, np.arange(len(m)), side="right") - 1
    has_force = ~m.rapid & any_column(knots.wrench.take(last_knot, axis=0) != 0.0)
    is_divisible = has_force & np.isin(m.kind, (LIN, CIRC))  # PTP and splines take no targets between their ends
    previous = program.predecessors
    while len(waiting_motions):
        is_released[waiting_motions] = is_divisible[waiting_motions]
        # a short motion has no force at all then, and that of the motion before ends
        is_short = is_divisible[waiting_motions] & (path.length[waiting_motions] <= _LEAST_LENGTH)
        waiting_motions = previous[waiting_motions[is_short]]
        waiting_motions = waiting_motions[waiting_motions >= 0]
        waiting_motions = waiting_motions[~is_released[waiting_motions]]
    motions_before_joins = _motions_before_joins(program)
    while mixed_groups := [
        group for group in motions_before_joins if is_released[group].any() and (has_force & ~is_released)[group].any()
    ]:
        for group in mixed_groups:
            is_released[group] = False
    return is_released


def _motions_before_joins(program: Program) -> list[list[int]]:
    """Return groups of motions: after which one of a group the next motion begins is not known before run time."""
    group_of_motion: dict[int, set[int]] = {}  # motion → the motions at whose ends it may begin
    previous = program.predecessors
    for motion, end in program.transitions:
        group_of_motion.setdefault(motion, {int(previous[motion])}).add(end)
    # the start of the program, −1, has no force
    return [[end for end in ends if end >= 0] for ends in (*program.joins, *group_of_motion.values())]


def with_releases(forces: PathForces, is_released: Bools, ramp: float) -> PathForces:
    """Return the forces, falling to zero at the end of some motions, and rising from zero at the start of the next.

    Forces are wrenches at knots (places along the motions) and linear between them, so knots are replaced. The force of
    a motion with a ramp rises over that ramp, which is left as it is.

    :param is_released: (M,) True for motions at whose end the force ends, see `released_motions`.
    :param ramp: length over which the force falls and rises [m], less on short motions.
    """
    if not is_released.any():
        return forces
    length, previous = forces.axes.path.length, forces.axes.program.predecessors
    is_long = length > _LEAST_LENGTH
    is_resumed = (previous >= 0) & is_released[previous] & ~forces.ramped & is_long  # the force rises from zero
    share = np.minimum(ramp / np.maximum(length, _LEAST_LENGTH), _LARGEST_SHARE)
    # t of a motion (0: start, 1: end) at which its force begins to fall; a short motion has none at all
    fall_begin = np.where(is_long, 1.0 - share, 0.0)
    rise_end = share
    motion = np.repeat(np.arange(len(length)), np.diff(forces.first))  # of each knot
    is_in_fall = is_released[motion] & (forces.t >= fall_begin[motion])
    is_in_rise = is_resumed[motion] & (forces.t <= rise_end[motion])
    unchanged_knots = np.flatnonzero(~is_in_fall & ~is_in_rise)
    released_rows, resumed_rows = np.flatnonzero(is_released), np.flatnonzero(is_resumed)
    falling_rows = released_rows[is_long[released_rows]]
    knot_groups = [
        _NewKnots(unchanged_knots, forces.t[unchanged_knots], forces.wrench.take(unchanged_knots)),
        # where the fall begins and the rise ends, the force is as given; at the wait it is zero
        _interpolated_knots(forces, falling_rows, fall_begin[falling_rows]),
        _interpolated_knots(forces, resumed_rows, rise_end[resumed_rows]),
        _zero_knots(forces.first[released_rows + 1] - 1, t=1.0),
        _zero_knots(forces.first[resumed_rows], t=0.0),
    ]
    return _with_knots(forces, motion, _NewKnots(*map(np.concatenate, zip(*knot_groups, strict=True))))


class _NewKnots(NamedTuple):
    """k knots that replace those of forces around waits: wrenches at places along motions.

    :param knot: (k,) knot of the forces as given, whose motion, frame, standard deviations and factor each has.
    :param t: (k,) place on that motion: 0 at its start, 1 at its end.
    :param wrench: (k, 6) [N, N·m].
    """

    knot: Ints
    t: Array
    wrench: Array


def _zero_knots(knot: Ints, t: float) -> _NewKnots:
    """Return knots without force at one place of their motions: `t`, 0 at the start and 1 at the end.

    :param knot: (n,) knots of these motions, whose other properties they get.
    """
    return _NewKnots(knot, np.full(len(knot), t), np.zeros((len(knot), 6)))


def _interpolated_knots(forces: PathForces, motion: Ints, t: Array) -> _NewKnots:
    """Return knots with the force that acts at places between the given knots.

    Each is in the axes (`BASE`, `TOOL`, `FEED`) of the next given knot. On a ramp, whose first knot is in other axes,
    it has the force at the end of the ramp.

    :param motion: (n,) rows of `Motions`.
    :param t: (n,) place on each motion: 0 at its start, 1 at its end.
    """
    first, last = forces.first[motion], forces.first[motion + 1] - 1  # given knots of each motion
    right = np.clip(np.searchsorted(forces.place, motion + t), first, last)  # `place` is motion + t of the given knots
    left = np.maximum(right - 1, first)
    has_same_axes = forces.knot_frame[left] == forces.knot_frame[right]
    is_between = has_same_axes & (forces.t[left] < t) & (t < forces.t[right])
    left = np.where(is_between, left, right)  # else the next knot alone counts
    interval = forces.t[right] - forces.t[left]
    share = (t - forces.t[left]) / np.where(is_between, interval, 1.0)
    left_wrench, right_wrench = forces.wrench.take(left), forces.wrench.take(right)
    return _NewKnots(right, t, left_wrench + share[:, None] * (right_wrench - left_wrench))


def _with_knots(forces: PathForces, motion: Ints, knots: _NewKnots) -> PathForces:
    """Return the forces with other knots, which are put in order along the motions.

    :param motion: (K,) motion of each knot as given.
    """
    order = np.lexsort((knots.t, motion[knots.knot]))
    knot, t, wrench = knots.knot[order], knots.t[order], knots.wrench[order]
    spread = forces.spread
    if spread is not None:
        spread = np.where(any_column(wrench != 0.0)[:, None, None, None], spread[knot], 0.0)
    return replace(
        forces,
        first=compact(np.searchsorted(motion[knot], np.arange(len(forces.frame) + 1)), np.int32),
        place=motion[knot] + t,
        t=t,
        wrench=Runs.of(wrench),
        knot_frame=forces.knot_frame[knot],
        spread=spread,
        factor=forces.factor[knot],
    )
