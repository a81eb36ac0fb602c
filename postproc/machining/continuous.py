"""Forces along motions without steps: at the start of a motion the force changes within half the feed per tooth.

The mean force is the mean over the tooth pitch, and after a change of engagement the next tooth cuts the new chip. So
at the start of a motion the force changes from its last value to the new one in much less than a turn. It drops to zero
at once when the tool is retracted.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.frames import Array, norm
from postproc.machining.ways import home_base
from postproc.program import CIRC, Bools, Ints, Program
from postproc.toolpath import Segments, tangent

BASE, FEED = 0, 2
"""Values of `AlongMotions.frame`: places in `program.FORCE_FRAMES`."""


class AlongMotions(Struct, frozen=True, eq=False):
    """Wrenches at K places along motions: linear between the places of a motion.

    :param motion: (K,) row of `Motions`, never decreasing.
    :param t: (K,) place on it, increasing.
    :param wrench: (K, 6) force [N] and moment [N·m] on the tool at its tip, in the axes that `frame` names.
    :param frame: (K,) `BASE` or `FEED`; one for a motion.
    :param sigma: (K, 6) standard deviations of the wrench.
    """

    motion: Ints
    t: Array
    wrench: Array
    frame: Ints
    sigma: Array

    @classmethod
    def joined(cls, parts: list[AlongMotions]) -> AlongMotions:
        """Return wrenches along motions of several parts, in order."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__struct_fields__))


_SHARE = 0.01
"""Changes at the start below this share of the largest force and moment of a motion extend over the whole motion,"""
_LEAST = 1.0, 0.1
"""and so do changes below this [N, N·m]."""


def without_steps(
    program: Program,
    path: Segments,
    stations: tuple[Ints, Array, Array],
    map_in_base: Array,
    rise: Array,
    sigma: tuple[float, float],
    *,
    base_axes: bool,
) -> AlongMotions:
    """Return wrenches that are continuous from motion to motion.

    At the start of a motion the force changes from that at the end of the motion before, zero after a rapid one, to
    its own; at the end of the motion it acts in full.

    :param stations: rows of `Motions` (n,), places on them, and wrenches (n, 6) in FEED axes; on moves along the
        spindle in those of the map.
    :param map_in_base: (4, 4) frame of the map of the stock in `$BASE` of the first cutting motion: z to the spindle.
    :param rise: (M,) length over which the force changes at the start of a motion [m].
    :param sigma: standard deviation as a share of the wrench, and that of the axial force as a share of the force
        across the axis, in addition (0 where axial coefficients are known).
    :param base_axes: give them in `$BASE`; else in FEED, but for moves along the spindle.
    """
    motion, t, wrench = stations
    first = np.flatnonzero(np.diff(motion, prepend=-1))
    last = np.append(first[1:], len(motion)) - 1
    single = first == last
    own = motion[first]
    ends = _turn(_axes(program, path, own, np.ones(len(own)), map_in_base)[0], wrench[last])
    follows = np.flatnonzero(np.diff(own, prepend=-2) == 1)
    before = np.zeros((len(own), 6))
    starts, _ = _axes(program, path, own[follows], np.zeros(len(follows)), map_in_base)
    before[follows] = _turn(np.swapaxes(starts, 1, 2), ends[follows - 1])
    reach = np.minimum(1.0, rise[own] / np.maximum(path.length[own], 1e-9))
    every = np.arange(len(own))
    reach[_alike(before, _at(motion, t, wrench, own, reach), wrench, first)] = 1.0
    # at 0 the force of the motion before, within a turn its own, then its stations, and its own at the end
    row = np.repeat(every, last - first + 1)
    inner = (t > np.where(reach < 1.0, reach, 0.0)[row] + 1e-9) & (t < 1.0) & ~single[row]
    inner &= (reach < 1.0)[row] | (path.length[own] > rise[own])[row]
    soon = np.flatnonzero(reach < 1.0)
    which = np.concatenate([every, soon, row[inner], every])
    places = np.concatenate([np.zeros(len(own)), reach[soon], t[inner], np.ones(len(own))])
    order = np.lexsort((places, which))
    which, places = which[order], places[order]
    values = _at(motion, t, wrench, own[which], places)
    begins = np.flatnonzero(np.diff(which, prepend=-1))
    values[begins] = before
    missing = sigma[1] * norm(values[:, :2])
    count = np.diff(begins, append=len(which))
    motions = own[which]
    axes, along = _axes(program, path, motions, places, map_in_base)
    steady = np.repeat(single, count)
    turning = steady & (program.motions.kind[motions] == CIRC)  # the same in FEED axes: in $BASE it turns
    in_base = (along[np.repeat(np.cumsum(count) - 1, count)] | base_axes) & ~turning
    values[in_base] = _turn(_to_base(program, motions[in_base], map_in_base) @ axes[in_base], values[in_base])
    deviation = np.abs(values) * sigma[0]
    # on moves along the spindle in $BASE axes: z of $BASE is taken for the axis of the tool
    deviation[:, 2] = np.hypot(deviation[:, 2], missing)
    return AlongMotions(motions, places, values, np.where(in_base, BASE, FEED), deviation)


def _alike(before: Array, own: Array, wrench: Array, first: Ints) -> Bools:
    """Return which motions begin with a force (k, 6) that is about that at the end of the motion before."""
    out = np.ones(len(own), dtype=bool)
    for half, least in zip((slice(0, 3), slice(3, 6)), _LEAST, strict=True):
        largest = np.maximum.reduceat(norm(wrench[:, half]), first)
        out &= norm(own[:, half] - before[:, half]) <= np.maximum(_SHARE * largest, least)
    return out


def _at(motion: Ints, t: Array, wrench: Array, own: Ints, places: Array) -> Array:
    """Return wrenches (k, 6) at places on motions: linear between the stations of each, constant outside of them."""
    after = np.searchsorted(motion + 0.5 * t, own + 0.5 * places)
    low, high = np.searchsorted(motion, own, side="left"), np.searchsorted(motion, own, side="right") - 1
    b = np.clip(after, low, high)
    a = np.clip(after - 1, low, high)
    gap = t[b] - t[a]
    share = np.clip((places - t[a]) / np.where(gap > 0.0, gap, 1.0), 0.0, 1.0)
    return np.asarray(wrench[a] + share[:, None] * (wrench[b] - wrench[a]))


def _axes(program: Program, path: Segments, motion: Ints, t: Array, map_in_base: Array) -> tuple[Array, Bools]:
    """Return FEED axes (n, 3, 3) as columns in those of the map, and which places lie on moves along the spindle."""
    direction = tangent(program, path, motion, t)
    to_map = np.swapaxes(_to_base(program, motion, map_in_base), 1, 2)
    direction = np.einsum("nij,nj->ni", to_map, direction)
    across = np.hypot(direction[:, 0], direction[:, 1])
    along = across < 1e-3
    u = np.where(along[:, None], [1.0, 0.0], direction[:, :2] / np.where(along, 1.0, across)[:, None])
    out = np.zeros((len(motion), 3, 3))
    out[:, 0, 0], out[:, 1, 0] = u[:, 0], u[:, 1]
    out[:, 0, 1], out[:, 1, 1] = -u[:, 1], u[:, 0]
    out[:, 2, 2] = 1.0
    return out, np.asarray(along)


def _to_base(program: Program, motion: Ints, map_in_base: Array) -> Array:
    """Return the axes of the map (n, 3, 3) in the `$BASE` of motions."""
    base = program.motions.base[motion]
    home = program.bases[home_base(program), :3, :3]
    return np.asarray(np.swapaxes(program.bases[base, :3, :3], 1, 2) @ home @ map_in_base[:3, :3])


def _turn(rotation: Array, wrench: Array) -> Array:
    """Return wrenches (n, 6) in other axes."""
    halves = [np.einsum("nij,nj->ni", rotation, wrench[:, half]) for half in (slice(0, 3), slice(3, 6))]
    return np.concatenate(halves, axis=1)
