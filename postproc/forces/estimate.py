"""Rough displacement of the tool by the force along the motions, to choose the samples of the path."""

from __future__ import annotations

import numpy as np

from postproc.forces.along import BEHIND_STEP, PathForces
from postproc.forces.feed import runs_across
from postproc.forces.knots import FEED
from postproc.frames import Array, any_column, largest, norm
from postproc.program import CIRC, Bools, Ints
from postproc.toolpath import DisplacementEstimate, at

_SAME = 1e-9
"""Changes of the force below this [N, N·m] count as none."""
_STEP = 1e-8
"""Displacement [m] below which a change of the force from motion to motion does not count as a step."""


def estimate(forces: PathForces, softness: tuple[float, float]) -> DisplacementEstimate:
    """Return a rough estimate of how the displacement by the force changes along the motions.

    :param softness: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    """
    m, path = forces.axes.program.motions, forces.axes.path
    turning = (m.kind == CIRC) & (forces.frame == FEED)

    def moves(wrench: Array) -> Array:
        return np.asarray(softness[0] * norm(wrench[:, :3]) + softness[1] * norm(wrench[:, 3:]))

    begins = np.zeros(len(forces.t), dtype=np.bool_)
    begins[forces.first[:-1][forces.ramped]] = True  # the force of the motion before

    def largest_of_own(values: Array) -> Array:
        return np.asarray(np.maximum.reduceat(np.where(begins, 0.0, values), forces.first[:-1]))

    motion = np.repeat(np.arange(len(m)), np.diff(forces.first))
    change, bent = _changes(forces, motion)
    stepped = moves(_steps(forces))
    step = np.flatnonzero(stepped > _STEP)
    behind = np.minimum(0.5, BEHIND_STEP / np.maximum(path.length[step], BEHIND_STEP))
    swings, turned = np.zeros(len(m), dtype=np.bool_), np.zeros(len(m))
    if turning.any():
        across = forces.wrench * (1.0, 1.0, 0.0, 1.0, 1.0, 0.0)  # z, along the spindle, does not turn
        turned = np.where(turning, largest_of_own(moves(across)), 0.0)
        acts = np.zeros(len(m), dtype=np.bool_)
        acts[motion[any_column(across != 0.0)]] = True
        found = np.flatnonzero(turning & acts)
        swings[found] = ~runs_across(forces.axes.program, path, found, forces.axes.spindle)
    order = np.lexsort((np.append(forces.t, behind), np.append(motion, step)))
    return DisplacementEstimate(
        motion=np.append(motion, step)[order],
        t=np.append(forces.t, behind)[order],
        change=np.append(moves(change), stepped[step])[order],
        bent=np.append(bent, np.ones(len(step), dtype=np.bool_))[order],
        turning=turned,
        size=largest_of_own(moves(forces.wrench)),
        round=swings,
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
    out = np.zeros_like(forces.before)
    rows = np.flatnonzero(~forces.ramped)
    start = at(forces.axes.program, forces.axes.path, rows, np.zeros(len(rows)))
    out[rows] = forces.at(start) - forces.before[rows]
    return out
