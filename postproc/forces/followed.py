"""Subdivide arcs, and lines that turn the tool, where the axes of a FEED force swing.

Near the direction of the spindle, FEED axes turn by up to half a turn within a short part of the arc. Pieces of one
size for the whole arc would be too many, so each piece is halved as long as its circle deviates from the displacement
by the force at its quarters. That needs only the wrench; the simulation of the written program finds the response of
the robot.
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
"""Length [m] and share of the arc below which no piece is halved: the decimals of a program resolve none shorter."""
_TURNS = 1e-6
"""Rotations of the tool below this [rad] count as none."""
_QUARTERS = (0.0, 0.25, 0.5, 0.75, 1.0)


def followed(
    forces: PathForces, arcs: Pieces, estimate: DisplacementEstimate, softness: tuple[float, float], limit: float
) -> Pieces:
    """Return the pieces, halved where the force swings, until their circles follow it or the pieces are too short.

    :param softness: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    :param limit: permitted deviation [m].
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

    They are needed where the tool axis passes near the direction of travel: FEED axes swing there.

    :param softness: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    :param limit: permitted deviation between two places [m].
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
    """Return the largest deviation (n,) [m] of circles through start, middle and end at the quarters of pieces."""
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
