"""Where a FEED force swings round: pieces of arcs, and places of lines that turn the tool.

Where the travel comes near the direction of the spindle, FEED axes turn by up to half a turn within a short part of the
arc: pieces of one size for the whole arc would be very many. So each piece is halved as long as its circle would miss
the displacement by the force at its quarters. That asks for the wrench alone; what the robot then does is found by the
simulation of the written program.
"""

from __future__ import annotations

import numpy as np

from postproc.forces.along import PathForces
from postproc.forces.feed import lines_run_across
from postproc.forces.knots import FEED
from postproc.frames import Array, norm
from postproc.program import LIN, Ints
from postproc.toolpath import DisplacementEstimate, Pieces, at, circle_through

_SHORTEST = 1e-7
"""Length [m] and share of the arc below which no piece is halved: the text of the program tells no shorter ones."""
_TURNS = 1e-6
"""A motion that turns the tool by less than this [rad] does not turn it."""
_QUARTERS = (0.0, 0.25, 0.5, 0.75, 1.0)


def followed(
    forces: PathForces, arcs: Pieces, estimate: DisplacementEstimate, softness: tuple[float, float], limit: float
) -> Pieces:
    """Return the pieces, halved where the force swings round, until their circles follow it or nothing can.

    :param softness: how far the tool gives way, about, per force [m/N] and per moment [m/(N·m)].
    :param limit: what may be missed [m].
    """
    found = estimate.round[arcs.motion]
    if not found.any():
        return arcs
    left = arcs.take(found)
    left = left.settled(left.least).cut(left.least)
    done = [arcs.take(~found)]
    length = forces.axes.path.length
    while len(left.motion):
        share = left.end - left.begin
        long = np.minimum(share, share * length[left.motion]) > _SHORTEST
        again = long & (_missed(forces, left, softness) > limit)
        done.append(left.take(~again))
        left = left.take(again)
        left = left.cut(np.full(len(left.motion), 2))
    return done[0].joined(*done[1:])


def swung(forces: PathForces, softness: tuple[float, float], limit: float) -> tuple[Ints, Array]:
    """Return places of straight motions, motion (n,) and t (n,), between which the displacement by the force is linear.

    They are asked for where the tool turns through the direction of travel, or near it: FEED axes swing round there.

    :param softness: how far the tool gives way, about, per force [m/N] and per moment [m/(N·m)].
    :param limit: what may be missed between two places [m].
    """
    program, path = forces.axes.program, forces.axes.path
    turns = (program.motions.kind == LIN) & (forces.frame == FEED) & (path.turn > _TURNS) & (path.length > 0.0)
    motion = np.flatnonzero(turns)
    motion = motion[~lines_run_across(program, path, motion, forces.axes.spindle)]
    begin, end = np.zeros(len(motion)), np.ones(len(motion))
    motions, places = [motion[:0]], [begin[:0]]
    while len(motion):
        spots = []
        for share in _QUARTERS:
            wrench = forces.at(at(program, path, motion, begin + share * (end - begin)))
            spots.append(np.hstack([softness[0] * wrench[:, :3], softness[1] * wrench[:, 3:]]))
        first, last = spots[0], spots[-1]
        missed = [norm(spot - first - share * (last - first)) for share, spot in zip(_QUARTERS, spots, strict=True)]
        part = end - begin
        again = (np.maximum.reduce(missed) > limit) & (np.minimum(part, part * path.length[motion]) > _SHORTEST)
        motion, begin, end = motion[again], begin[again], end[again]
        middle = 0.5 * (begin + end)
        motions.append(motion)
        places.append(middle)
        motion, begin, end = np.tile(motion, 2), np.append(begin, middle), np.append(middle, end)
    return np.concatenate(motions), np.concatenate(places)


def _missed(forces: PathForces, arcs: Pieces, softness: tuple[float, float]) -> Array:
    """Return what circles through start, middle and end of pieces (n,) would miss at their quarters, about [m]."""
    spots = []
    for share in _QUARTERS:
        t = np.where(share == 1.0, arcs.end, arcs.begin + share * (arcs.end - arcs.begin))
        sample = at(forces.axes.program, forces.axes.path, arcs.motion, t)
        wrench = forces.at(sample)
        spots.append(sample.pose[:, :3, 3] - softness[0] * wrench[:, :3] - softness[1] * wrench[:, 3:])
    begin, _, middle, _, end = spots
    centre, radial, across, angle = circle_through(begin, middle, end)
    missed = np.zeros(len(begin))
    for share, spot in zip(_QUARTERS, spots, strict=True):
        turned = (angle * share)[:, None]
        missed = np.maximum(missed, norm(spot - centre - np.cos(turned) * radial - np.sin(turned) * across))
    return missed
