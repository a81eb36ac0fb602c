"""Where the path needs samples because the force changes: estimated displacement, and where FEED axes swing.

Near the direction of the spindle, FEED axes turn by up to half a turn within a short part of an arc, or of a line that
turns the tool. Pieces of one size for the whole motion would be too many, so each piece is halved as long as its circle
or line deviates from the displacement by the force at its quarters. That needs only the wrench; the simulation of the
written program finds the response of the robot.
"""

from __future__ import annotations

import numpy as np

from postproc.forces.axes import TURNS, lines_run_across, runs_across
from postproc.forces.path_forces import BEHIND_STEP, PathForces
from postproc.forces.sources import FEED
from postproc.frames import Array, any_column, largest, norm
from postproc.program import CIRC, LIN, Bools, Ints, constant
from postproc.toolpath import DisplacementEstimate, Pieces, at, circle_through

_SAME = 1e-9
"""Changes of the force below this [N, N·m] count as none."""
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
    change, bent = _changes(forces, motion)
    stepped = moves(_steps(forces))
    step = np.flatnonzero(stepped > _STEP)
    behind = np.minimum(0.5, BEHIND_STEP / np.maximum(path.length[step], BEHIND_STEP))
    swings, turned = np.zeros(len(m), dtype=np.bool_), constant(0.0, len(m))
    if turning.any():
        across = forces.wrench * (1.0, 1.0, 0.0, 1.0, 1.0, 0.0)  # z, along the spindle, does not turn
        turned = np.where(turning, largest_of_own(moves(across)), 0.0)
        acts = np.zeros(len(m), dtype=np.bool_)
        acts[motion[any_column(across != 0.0)]] = True
        found = np.flatnonzero(turning & acts)
        swings[found] = ~runs_across(forces.axes.program, path, found, forces.axes.spindle)
    kept = np.flatnonzero(bent | (m.kind[motion] == CIRC))
    places = np.append(motion[kept], step), np.append(forces.t[kept], behind)
    order = np.lexsort(places[::-1])
    return DisplacementEstimate(
        motion=places[0][order],
        t=places[1][order],
        change=np.append(moves(change)[kept], stepped[step])[order],
        bent=np.append(bent[kept], np.ones(len(step), dtype=np.bool_))[order],
        turning=turned,
        size=largest_of_own(moves(forces.wrench)),
        swings=swings,
    )


def _changes(forces: PathForces, motion: Ints) -> tuple[Array, Bools]:
    """Return the change (K, 6) of the force since the knot before, and (K,) True where its rate changes."""
    t, count = forces.t, len(forces.t)
    follows = np.append(False, np.diff(motion) == 0)
    alike = follows & (np.diff(forces.knot_frame, prepend=0) == 0)
    change = np.diff(forces.wrench, axis=0, prepend=forces.wrench[:1])
    change[~alike] = 0.0
    rows = np.flatnonzero(follows & ~alike)
    place = at(forces.axes.program, forces.axes.path, motion[rows], t[rows])
    change[rows] = forces.at(place) - forces.wrench[rows - 1]
    bent = np.zeros(count, dtype=np.bool_)
    inner = np.flatnonzero((t > 0.0) & (t < 1.0))

    def rate(rows: Ints) -> Array:
        """Return the change (n, 6) per t up to knots (n,); 0 at the first knot of a motion."""
        out, known = np.zeros((len(rows), 6)), np.append(follows, False)[rows]
        rows = rows[known]
        out[known] = change[rows] / (t[rows] - t[rows - 1])[:, None]
        return out

    width = np.where(follows[inner], t[inner] - t[inner - 1], 1.0)
    bent[inner] = largest((rate(inner + 1) - rate(inner)) * width[:, None]) >= _SAME
    return change, bent


def _steps(forces: PathForces) -> Array:
    """Return the step of the force (M, 6) at the start of each motion, from the end of the motion before."""
    rows = np.flatnonzero(~forces.ramped)
    if not len(rows):
        return np.broadcast_to(0.0, (len(forces.ramped), 6))
    out, before = np.zeros((len(forces.ramped), 6)), forces.before()
    start = at(forces.axes.program, forces.axes.path, rows, np.zeros(len(rows)))
    out[rows] = forces.at(start) - before[rows]
    return out


_SHORTEST = 1e-7
"""Length [m] and share of the arc below which no piece is halved: the decimals of a program resolve none shorter."""
_QUARTERS = (0.0, 0.25, 0.5, 0.75, 1.0)


def refined_arcs(
    forces: PathForces, arcs: Pieces, estimate: DisplacementEstimate, compliance: tuple[float, float], limit: float
) -> Pieces:
    """Return the pieces, halved where the force swings, until their circles follow it or the pieces are too short.

    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    :param limit: permitted deviation [m].
    """
    found = estimate.swings[arcs.motion]
    if not found.any():
        return arcs
    left = arcs.take(found)
    left = left.settled(left.least).cut(left.least)
    done = [arcs.take(~found)]
    length = forces.axes.path.length
    while len(left.motion):
        share = left.end - left.begin
        long = np.minimum(share, share * length[left.motion]) > _SHORTEST
        again = long & (_missed(forces, left, compliance) > limit)
        done.append(left.take(~again))
        left = left.take(again)
        left = left.cut(np.full(len(left.motion), 2))
    return Pieces.joined(done).in_order()


def swing_places(forces: PathForces, compliance: tuple[float, float], limit: float) -> tuple[Ints, Array]:
    """Return places of straight motions, motion (n,) and t (n,), between which the displacement by the force is linear.

    They are needed where the tool axis passes near the direction of travel: FEED axes swing there.

    :param compliance: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    :param limit: permitted deviation between two places [m].
    """
    program, path = forces.axes.program, forces.axes.path
    turns = (program.motions.kind == LIN) & (forces.frame == FEED) & (path.turn > TURNS) & (path.length > 0.0)
    motion = np.flatnonzero(turns)
    motion = motion[~lines_run_across(program, path, motion, forces.axes.spindle)]
    begin, end = np.zeros(len(motion)), np.ones(len(motion))
    motions, places = [motion[:0]], [begin[:0]]
    while len(motion):
        spots = []
        for share in _QUARTERS:
            wrench = forces.at(at(program, path, motion, begin + share * (end - begin)))
            spots.append(np.hstack([compliance[0] * wrench[:, :3], compliance[1] * wrench[:, 3:]]))
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


def _missed(forces: PathForces, arcs: Pieces, compliance: tuple[float, float]) -> Array:
    """Return the largest deviation (n,) [m] of circles through start, middle and end at the quarters of pieces."""
    spots = []
    for share in _QUARTERS:
        t = np.where(share == 1.0, arcs.end, arcs.begin + share * (arcs.end - arcs.begin))
        sample = at(forces.axes.program, forces.axes.path, arcs.motion, t)
        wrench = forces.at(sample)
        spots.append(sample.pose[:, :3, 3] - compliance[0] * wrench[:, :3] - compliance[1] * wrench[:, 3:])
    begin, _, middle, _, end = spots
    centre, radial, across, angle = circle_through(begin, middle, end)
    missed = np.zeros(len(begin))
    for share, spot in zip(_QUARTERS, spots, strict=True):
        turned = (angle * share)[:, None]
        missed = np.maximum(missed, norm(spot - centre - np.cos(turned) * radial - np.sin(turned) * across))
    return missed
