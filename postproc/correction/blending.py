"""What approximate positioning (C_DIS) does to the path: how far it rounds corners, and where it must not.

A controller leaves its path so far before the target as `$APO.CDIS` says, but half the way to a neighbouring target at
the most, and drives a parabola whose tangents are the two pieces of path. With directions a and b there, and the
distance d, the parabola passes the corner at d/4 · |b − a| = d/2 · sin(turn/2) (the middle of the quadratic Bézier
curve through corner − d·a, corner, corner + d·b).
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import toolpath
from postproc.cell import Cell
from postproc.chunks import in_chunks
from postproc.frames import M_PER_MM, Array, norm, sine_and_cosine
from postproc.program import CIRC, PTP, SPL, Bools, Ints, Program, Targets
from postproc.toolpath import Segments, circle_through

_SHARE = 0.2
"""Of the tolerance, what rounding may use up at inserted targets."""
_PRINTED = 7
"""Decimals of positions [m] in the written text: on short arcs they turn the direction."""
_STEPS = np.array([1.0, 2.0, 5.0])


class Corners(Struct, frozen=True):
    """The K targets of a path as corners.

    :ivar sharp: (K,) |b − a| = 2 sin(turn/2); 0 where nothing can be rounded: at PTP, at pieces of splines,
        at the end, where frames change.
    :ivar reach: (K,) half the length of the shorter one of the neighbouring pieces [m]: blending begins no earlier.
    """

    sharp: Array
    reach: Array

    def rounding(self, distance: Array) -> Array:
        """Return how far each corner is passed at (K,) [m] for approximation distances (K,) [m]."""
        return np.asarray(0.25 * np.minimum(distance, self.reach) * self.sharp)


def _corners(arrive: Array, leave: Array, length: Array, joined: Bools) -> Corners:
    """Return corners.

    :param arrive: (K, 3) unit direction at the end of each piece; `leave` at its start; zero where it has none.
    :param length: (K,) [m].
    :param joined: (K,) whether the next piece follows at once, in the same frames.
    """
    sharp, reach = np.zeros(len(length)), np.zeros(len(length))
    reach[:-1] = 0.5 * np.minimum(length[:-1], length[1:])
    sharp[:-1] = np.where(joined[:-1] & (reach[:-1] > 0.0), norm(leave[1:] - arrive[:-1]), 0.0)
    return Corners(sharp, reach)


def _joined(program: Program, motion: Ints, kind: Ints) -> Bools:
    m = program.motions
    after = np.append(motion[1:], -1)
    same = (after - motion <= 1) & (m.base[after] == m.base[motion]) & (m.tool[after] == m.tool[motion])
    if program.after is not None:  # at the start of branches, or where the position of the robot is unknown
        same &= (after == motion) | (program.after[after] == motion)
    path = (kind != PTP) & (kind != SPL)
    return np.asarray((after >= 0) & same & path & np.append(path[1:], False))


def of_targets(program: Program, targets: Targets, start: Array) -> tuple[Corners, Array]:
    """Return the corners of a path as it is to be written, and the direction in which it comes to them (K, 3).

    :param start: (M, 3) commanded position at the start of each motion, `$BASE` [m].
    """
    end, start = (np.round(spot, _PRINTED) for spot in (targets.pose[:, :3, 3], start))
    first = np.append(True, np.diff(targets.motion) != 0)[: len(end)]
    begin = np.where(first[:, None], start[targets.motion], np.roll(end, 1, axis=0))
    step = end - begin
    length = norm(step)
    leave = step / np.where(length > 0.0, length, 1.0)[:, None]
    arrive = leave.copy()
    arcs = np.flatnonzero(targets.kind == CIRC)
    if len(arcs):
        _, radial, across, angle = circle_through(begin[arcs], np.round(targets.via[arcs], _PRINTED), end[arcs])
        radius, (sine, cosine) = norm(radial), sine_and_cosine(angle[:, None])
        leave[arcs] = across / radius[:, None]
        arrive[arcs] = (cosine * across - sine * radial) / radius[:, None]
        length[arcs] = radius * angle
    return _corners(arrive, leave, length, _joined(program, targets.motion, targets.kind)), arrive


def of_motions(program: Program, path: Segments, motion: Ints) -> Corners:
    """Return the corners at the ends of some motions (n,), in order."""
    kind = program.motions.kind[motion]

    def at_ends(motion: Ints) -> tuple[Array, Array]:
        begin, end = np.zeros(len(motion)), np.ones(len(motion))
        return toolpath.tangent(program, path, motion, end), toolpath.tangent(program, path, motion, begin)

    arrive, leave = in_chunks(at_ends, motion)
    return _corners(arrive, leave, path.length[motion], _joined(program, motion, kind))


def programmed(program: Program, path: Segments, motion: Ints) -> Array:
    """Return how far a program itself rounds its path at its targets (K,) [m]; 0 at inserted ones, and in G-code.

    :param motion: (K,) motion of each target, never decreasing.
    """
    out = np.zeros(len(motion))
    if not program.keeps_text:
        return out
    last = np.append(np.diff(motion) != 0, True)[: len(motion)]
    own = motion[last]
    out[last] = of_motions(program, path, own).rounding(program.motions.blend[own])
    return out


def distances(program: Program, targets: Targets, corners: Corners, cell: Cell) -> Array:
    """Return with which distance each target is approximated (K,) [m]; 0: an exact stop.

    The end of a motion has the distance that the program gives it, unless blending would round it by more than
    `Motions.rounding` allows: then it is an exact stop. The robot does not stop at inserted targets. Where one of them
    is a corner, because the force changes, its distance is made smaller in a program from G-code; in KRL, where
    `$APO.CDIS` is the program's own, the robot stops there if it also stops at the end of that motion.

    :param cell: the approximation distance of inserted targets, and the tolerance.
    """
    m, motion = program.motions, targets.motion
    at_end = m.blend[motion]
    stop = corners.rounding(at_end) > m.rounding[motion]
    allowed = 4.0 * _SHARE * cell.tolerance / np.maximum(corners.sharp, 1e-9)
    if program.keeps_text:
        between = np.where((at_end > 0.0) | (corners.reach <= allowed), np.inf, 0.0)
    else:
        between = np.maximum(at_end, cell.gcode.approximation_mm * M_PER_MM)
        narrow = allowed < np.minimum(between, corners.reach)
        between[narrow] = _rounded_down(allowed[narrow])
    out = np.where(targets.t == 1.0, np.where(stop, 0.0, at_end), between)
    return np.where(targets.kind == PTP, 0.0, out)


def _rounded_down(distance: Array) -> Array:
    """Return distances [m] as 1, 2 or 5 times a power of ten millimetres, so that few of them are different."""
    step = _STEPS * 10.0 ** np.floor(np.log10(distance / M_PER_MM))[:, None]
    below = np.where(step * M_PER_MM <= distance[:, None] * (1.0 + 1e-9), step, 0.0)
    return np.asarray(below.max(axis=1) * M_PER_MM)
