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
from postproc.forces.axes import predecessors
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

    Where branches meet or rounds repeat, all motions that may be the last end without force, or none is released:
    corrected, they would not meet.

    :param path: geometry of all motions.
    :param knots: the forces of the motions, at least one knot on each.
    """
    m, is_released = program.motions, np.zeros(len(program.motions), dtype=np.bool_)
    waiting = program.waiting_motions
    waiting = waiting[waiting >= 0]
    if not len(waiting):
        return is_released
    last = np.searchsorted(knots.motion, np.arange(len(m)), side="right") - 1
    has_force = ~m.rapid & any_column(knots.wrench.take(last, axis=0) != 0.0)
    is_divisible = has_force & np.isin(m.kind, (LIN, CIRC))
    previous = predecessors(program)
    while len(waiting):
        is_released[waiting] = is_divisible[waiting]
        # a short motion has no force at all then, and that of the motion before ends
        waiting = previous[waiting[is_divisible[waiting] & (path.length[waiting] <= _LEAST_LENGTH)]]
        waiting = waiting[waiting >= 0]
        waiting = waiting[~is_released[waiting]]
    meeting_ends = _meeting_ends(program)
    while divided := [
        ends for ends in meeting_ends if is_released[ends].any() and (has_force & ~is_released)[ends].any()
    ]:
        for ends in divided:
            is_released[ends] = False
    return is_released


def _meeting_ends(program: Program) -> list[list[int]]:
    """Return groups of motions: after which of a group the next motion begins is not known before run time."""
    ends_of_motion: dict[int, set[int]] = {}
    previous = predecessors(program)
    for motion, end in program.transitions:
        ends_of_motion.setdefault(motion, {int(previous[motion])}).add(end)
    # the start of the program, −1, has no force
    return [[end for end in ends if end >= 0] for ends in (*program.joins, *ends_of_motion.values())]


def with_releases(forces: PathForces, is_released: Bools, ramp: float) -> PathForces:
    """Return the forces, falling to zero at the end of some motions, and rising from zero at the start of the next.

    The force of a motion with a ramp rises over that ramp, which is left as it is.

    :param is_released: (M,) see `released_motions`.
    :param ramp: length over which the force falls and rises [m], less on short motions.
    """
    if not is_released.any():
        return forces
    length, previous = forces.axes.path.length, predecessors(forces.axes.program)
    is_long = length > _LEAST_LENGTH
    is_resumed = (previous >= 0) & is_released[previous] & ~forces.ramped & is_long
    share = np.minimum(ramp / np.maximum(length, _LEAST_LENGTH), _LARGEST_SHARE)
    fall = np.where(is_long, 1.0 - share, 0.0)  # where it begins
    motion = np.repeat(np.arange(len(length)), np.diff(forces.first))
    falls = is_released[motion] & (forces.t >= fall[motion])
    rises = is_resumed[motion] & (forces.t <= share[motion])
    kept, released, resumed = np.flatnonzero(~falls & ~rises), np.flatnonzero(is_released), np.flatnonzero(is_resumed)
    divided = released[is_long[released]]
    pieces = [
        _WaitKnots(kept, forces.t[kept], forces.wrench.take(kept)),
        # where the fall begins and the rise ends, the force is as given; at the wait it is zero
        _knots_at(forces, divided, fall[divided]),
        _knots_at(forces, resumed, share[resumed]),
        _free_knots(forces.first[released + 1] - 1, 1.0),
        _free_knots(forces.first[resumed], 0.0),
    ]
    return _in_order(forces, motion, _WaitKnots(*map(np.concatenate, zip(*pieces, strict=True))))


class _WaitKnots(NamedTuple):
    """k knots of forces around waits.

    :param knot: (k,) knot of the forces as given, whose motion, frame, standard deviations and factor each has.
    :param t: (k,) place on the motion.
    :param wrench: (k, 6) [N, N·m].
    """

    knot: Ints
    t: Array
    wrench: Array


def _free_knots(knot: Ints, t: float) -> _WaitKnots:
    """Return knots without force at one place of their motions, with the properties of knots (n,) of these motions."""
    return _WaitKnots(knot, np.full(len(knot), t), np.zeros((len(knot), 6)))


def _knots_at(forces: PathForces, motion: Ints, t: Array) -> _WaitKnots:
    """Return knots at places (n,) between the given ones, in the frame of the next one."""
    first, last = forces.first[motion], forces.first[motion + 1] - 1
    right = np.clip(np.searchsorted(forces.place, motion + t), first, last)
    left = np.maximum(right - 1, first)
    is_between = (forces.knot_frame[left] == forces.knot_frame[right]) & (forces.t[left] < t) & (t < forces.t[right])
    left = np.where(is_between, left, right)  # on a ramp, whose first knot has other axes, the force at its end counts
    interval = forces.t[right] - forces.t[left]
    share = (t - forces.t[left]) / np.where(is_between, interval, 1.0)
    begin, end = forces.wrench.take(left), forces.wrench.take(right)
    return _WaitKnots(right, t, begin + share[:, None] * (end - begin))


def _in_order(forces: PathForces, motion: Ints, knots: _WaitKnots) -> PathForces:
    """Return the forces with other knots, sorted along the motions.

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
