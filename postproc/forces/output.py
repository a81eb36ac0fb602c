"""Forces for the written program: the wrench on each of its pieces.

Every written piece is a motion of its own. If the force of a motion is ramped, the force of a piece is ramped at the
start of the piece and acts in full at its end: so each target gets the wrench that acts there. A force that is given
along a motion is also given along each of its pieces.

The axes are those of `$BASE`, in which the force on a straight piece is constant. A FEED force on an arc, and FEED and
TOOL forces on a motion that turns the tool, keep their axes, which turn along the piece.
"""

from __future__ import annotations

import numpy as np

from postproc.forces.axes import TURNS, Axes, across
from postproc.forces.path_forces import PathForces
from postproc.forces.sources import BASE, FEED, TOOL, Knots
from postproc.frames import Array, any_column, largest, norm
from postproc.program import CIRC, Ints, TargetForces, Targets
from postproc.toolpath import at

_APART = 1e-9
"""Positions on a motion that differ by less count as one."""
_SAME = 1e-6
"""Changes of the force below this [N, N·m] count as none: the file has three decimals."""

_ROUNDED = 2e-3
"""Forces of two passes of a line that differ by less [N, N·m] count as equal: the file has three decimals."""


def of_targets(forces: PathForces, targets: Targets, arrive: Array, wrench: Array) -> TargetForces:
    """Return the wrench at each target for the comments of the written program.

    :param forces: those of the program as read.
    :param targets: the targets to write.
    :param arrive: (K, 3) direction of travel at the end of each piece, `$BASE`.
    :param wrench: (K, 6) wrench that acts there [N, N·m], `$BASE` axes.
    """
    frame = np.where(any_column(wrench != 0.0), _frame(forces, targets), BASE)
    out = wrench.copy()
    for code in (TOOL, FEED):
        rows = np.flatnonzero(frame == code)
        axes = targets.pose[rows, :3, :3]
        if code == FEED:
            axes, found = across(axes, arrive[rows], forces.axes.spindle)
            frame[rows[~found]] = BASE
            rows, axes = rows[found], axes[found]
        for half in (slice(0, 3), slice(3, 6)):
            out[rows, half] = np.einsum("nji,nj->ni", axes, wrench[rows, half])
    return TargetForces(out, frame)


def of_pieces(forces: PathForces, targets: Targets, at_end: TargetForces, written: Axes, row: Ints) -> Knots:
    """Return the wrench along each piece for the CSV file of the written program.

    :param forces: those of the program as read, and `targets` the written targets.
    :param at_end: the wrench at the targets, see `of_targets`.
    :param written: the axes of forces along the program as written.
    :param row: (K,) motion of the written program that ends at each target.
    :returns: knots; `motion` is here the row of the target at the end of the piece, and t the place on the piece.
    """
    ramped = forces.ramped[targets.motion]
    target, share = _places(forces, targets)
    whole = ramped[target]
    frame = np.where(whole, at_end.frame[target], _frame(forces, targets)[target])
    begin, end = targets.begin[target], targets.t[target]
    program, path = forces.axes.program, forces.axes.path
    nominal = at(program, path, targets.motion[target], np.where(share == 1.0, end, begin + share * (end - begin)))
    there = at(written.program, written.path, row[target], share)
    wrench = written.out_of_base(forces.at(nominal).reshape(-1, 2, 3, 1), frame, there).reshape(-1, 6)
    wrench[whole] = at_end.wrench[target[whole]]
    spread = forces.spread_at(nominal)
    sigma = np.zeros_like(wrench)
    if spread is not None:
        sigma = norm(written.out_of_base(spread, frame, there)).reshape(-1, 6)
    return _shortened(Knots(target, share, wrench, frame, sigma, whole))


def once_a_line(knots: Knots, line: Ints) -> tuple[Knots, Ints]:
    """Return the knots of one pass of each line, by line, and rows of targets of which other passes have other forces.

    A line is passed several times in loops; a force file has one force for all of its passes.

    :param knots: as from `of_pieces`.
    :param line: (K,) line of each target in the written program.
    """
    target, begin, count = np.unique(knots.motion, return_index=True, return_counts=True)
    _, first, of = np.unique(line[target], return_index=True, return_inverse=True)
    differ = []
    for k in np.flatnonzero(first[of] != np.arange(len(target))).tolist():
        one = first[of[k]]
        same = count[k] == count[one]
        if same:
            a, b = (slice(begin[i], begin[i] + count[i]) for i in (k, one))
            same = bool((knots.frame[a] == knots.frame[b]).all())
            for values, least in ((knots.t, _APART), (knots.wrench, _ROUNDED), (knots.sigma, _ROUNDED)):
                same &= bool(np.abs(values[a] - values[b]).max() <= least)
        if not same:
            differ.append(target[k])
    kept = np.flatnonzero(np.isin(knots.motion, target[first]))
    return knots.take(kept[np.argsort(line[knots.motion[kept]], kind="stable")]), np.array(differ, dtype=np.int64)


def _places(forces: PathForces, targets: Targets) -> tuple[Ints, Array]:
    """Return the places on the pieces where the force is given: row of the target (p,) and position on its piece.

    That is the end of the piece if the force is ramped, else its start, its end and the knots between.
    """
    begin, end = targets.begin, targets.t
    low = np.searchsorted(forces.place, targets.motion + begin + _APART)
    high = np.maximum(np.searchsorted(forces.place, targets.motion + end - _APART), low)
    count = np.where(forces.ramped[targets.motion], 1, high - low + 2)
    target = np.repeat(np.arange(len(targets)), count)
    inside = np.arange(len(target)) - np.repeat(np.cumsum(count) - count, count)
    last = inside == count[target] - 1
    knot = np.where(last | (inside == 0), 0, low[target] + inside - 1)
    share = (forces.t[knot] - begin[target]) / (end - begin)[target]
    return target, np.where(last, 1.0, np.where(inside == 0, 0.0, share))


def _shortened(knots: Knots) -> Knots:
    """Return fewer knots: of a piece with constant force only the last one."""
    last = np.flatnonzero(np.diff(knots.motion, append=-1) != 0)
    end = last[np.searchsorted(last, np.arange(len(knots)))]
    differs = largest(np.hstack([knots.wrench - knots.wrench[end], knots.sigma - knots.sigma[end]])) > _SAME
    changes = np.zeros(len(knots), dtype=np.bool_)
    changes[end[differs]] = True
    keep = changes[end]
    keep[last] = True
    return knots.take(keep)


def _frame(forces: PathForces, targets: Targets) -> Ints:
    """Return the frame in which the force on each piece (K,) is constant or changes linearly."""
    frame, turn = forces.frame[targets.motion], forces.axes.path.turn[targets.motion]
    turns = turn > TURNS
    turning = (frame == FEED) & ((targets.kind == CIRC) | turns) | (frame == TOOL) & turns
    return np.where(turning, frame, BASE)
