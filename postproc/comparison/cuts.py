"""What two programs would cut under the same force: at pairs, at inserted targets, and on the way to them."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc import toolpath
from postproc.chunks import in_chunks
from postproc.comparison.result import Comparison, Cuts
from postproc.comparison.side import Side, at
from postproc.errors import ForceError, NotConvergedError
from postproc.forces import BEHIND_STEP, PathForces
from postproc.frames import Array, angle_between, norm
from postproc.program import CIRC, PTP, SPL, Bools, Ints, Program

_ROUNDS, _SETTLED, _AHEAD = 12, 1e-7, 1e-3
"""Rounds at most in which the nearest place of the path is found, how near it is then [m], and over which share of the
way its direction is taken."""
_SLOPES = -3.0, -0.15
"""Between these is by how much what is left of the way to the nearest place changes with the way: −1, where the force
stays as it is; on a ramp of the force the tip runs ahead or lags behind."""
_LONG, _SPACING = 0.005, 0.010
"""Lines longer than the first [m] are looked at as often as the second says, arcs at every quarter at least; shorter
lines in their middle."""
_QUARTERS = 4
_SHORTEST = 2.0 * BEHIND_STEP
"""Moves shorter than this [m] are not looked at between their ends."""


def deviation(side: Side, motion: Ints, q: Array, wrench: Array, stands: Array) -> Array:
    """Return how far the loaded tip stands from the targets of motions (n,) [m], `$BASE`.

    :param q: (n, 6) joint angles that the controller holds [rad].
    :param wrench: (n, 6) at the tip, root axes.
    :param stands: (n, 3) where a carriage has brought the robot [m].
    :raises ForceError: the arm does not hold the force.
    """
    program = side.program

    def off(motion: Ints, q: Array, wrench: Array, stands: Array) -> tuple[Array]:
        tip = side.place.tip(q, toolpath.tool_of(program, motion), wrench) + stands
        return (toolpath.points_in_base(program, motion, tip, None) - program.motions.target[motion, :3, 3],)

    try:
        return in_chunks(off, motion, q, wrench, stands)[0]
    except NotConvergedError as cause:
        raise _not_held(program, motion, cause) from None


def _not_held(program: Program, motion: Ints, cause: NotConvergedError) -> ForceError:
    file, line = at(program, int(motion[cause.rows[0]]))
    return ForceError(f"the arm does not hold this force here: {cause}", file=file, line=line)


def at_pairs(found: Comparison, one: Side, other: Side, wrench: Array, nominal: Array) -> Cuts:
    """Return what both programs cut at the pairs.

    :param wrench: (P, 6) at the tip, root axes.
    :param nominal: (P, 3) what the nominal program cuts, found already.
    """
    first, two = found.pair.T
    corrected = deviation(one, first, other.joints[two], wrench, other.stands(two))
    rotation = found.nominal.bases[found.nominal.motions.base[first], :3, :3]
    turned = np.einsum("nji,nkj->nki", rotation, wrench.reshape(-1, 2, 3)).reshape(-1, 6)
    none = np.zeros(0)
    return Cuts(turned, nominal, corrected, _turned(found, one, wrench), np.zeros(0, dtype=np.int64), none, none, none)


def _turned(found: Comparison, one: Side, wrench: Array) -> Array:
    """Return by how much the second program turns the loaded tool from its nominal orientation (P,) [rad]."""
    program = found.nominal

    def angle(motion: Ints, wrench: Array, pose: Array) -> tuple[Array]:
        target = toolpath.pose_in_root(program, motion, program.motions.target[motion])
        wanted = one.place.compensate(target, one.joints[motion], toolpath.tool_of(program, motion), wrench).pose
        wanted = toolpath.pose_in_base(program, motion, wanted)
        return (angle_between(wanted[:, :3, :3], pose[:, :3, :3]),)

    try:
        return in_chunks(angle, found.pair[:, 0], wrench, found.pose)[0]
    except NotConvergedError as cause:
        raise _not_held(program, found.pair[:, 0], cause) from None


def between(found: Comparison, cuts: Cuts, one: Side, other: Side, load: PathForces) -> Cuts:
    """Return the cuts with what the loaded tip would leave at inserted targets, and between targets.

    :param load: the forces along the nominal program.
    """
    inserted = found.inserted
    row, t = _probes(found, one, other)
    row, t = np.append(inserted, row), np.append(np.ones(len(inserted)), t)
    order = np.lexsort((t, row))
    row, t = row[order], t[order]
    q = in_chunks(lambda row, t: (other.joints_at(row, t),), row, t)[0]
    reached = np.isfinite(q).all(axis=1)
    row, t, q = row[reached], t[reached], q[reached]
    behind = np.searchsorted(found.pair[:, 1], row)
    along = np.append(0.0, np.cumsum(other.path.length))
    first, last = along[np.append(-1, found.pair[:, 1])[behind] + 1], along[found.pair[behind, 1] + 1]
    share = (along[row + 1] - (1.0 - t) * other.path.length[row] - first) / np.maximum(last - first, 1e-12)

    def left(row: Ints, t: Array, q: Array, motion: Ints, share: Array) -> tuple[Array, Array]:
        return _left(one, load, motion, share, q, other.stands(row, t))

    motion = found.pair[behind, 0]
    nominal, corrected = in_chunks(left, row, t, q, motion, np.clip(share, 1e-9, 1.0))
    return replace(cuts, row=row, t=t, between_nominal=nominal, between_corrected=corrected)


def _probes(found: Comparison, one: Side, other: Side) -> tuple[Ints, Array]:
    """Return the places (motion, t) at which the second program is looked at between its targets.

    They are on lines and arcs between pairs that follow one another in the nominal program. Left out are rapid moves,
    pieces of splines, whose path is not known, and moves that begin where no correction was possible.
    """
    m, kind, path = other.program.motions, found.nominal.motions.kind, other.path
    row = np.flatnonzero((m.kind != PTP) & (m.kind != SPL) & (path.length > _SHORTEST) & ~_uncorrected_start(other))
    behind = np.searchsorted(found.pair[:, 1], row)
    row, behind = row[behind < len(found.pair)], behind[behind < len(found.pair)]
    motion, before = found.pair[behind, 0], np.append(-1, found.pair[:, 0])[behind]
    known = one.follows(before, motion) & ~np.isin(kind[motion], (PTP, SPL)) & ~found.rapid[behind]
    row = row[known & ~_uncorrected_start(one)[motion]]
    parts = np.where(m.kind[row] == CIRC, _QUARTERS, 2)
    length = path.length[row]
    parts = np.where(length > _LONG, np.maximum(parts, np.ceil(length / _SPACING).astype(np.int64)), parts)
    which = np.repeat(np.arange(len(row)), parts - 1)
    index = np.arange(len(which)) - np.repeat(np.cumsum(parts - 1) - (parts - 1), parts - 1) + 1
    return row[which], index / parts[which]


def _uncorrected_start(side: Side) -> Bools:
    """(M,) True for motions that begin nobody knows where, or at the start or an axis target that is not nominal."""
    m, after = side.program.motions, side.program.after
    rows = np.arange(len(m))
    before = rows - 1 if after is None else after
    axis = np.append(np.isfinite(m.joints[:, 0]), True)[before]
    return np.asarray((before == rows) | (axis & (not side.place.rest_is_nominal)))


def _left(one: Side, load: PathForces, motion: Ints, share: Array, q: Array, stands: Array) -> tuple[Array, Array]:
    """Return how far the loaded tip would stand from the nominal path by each program (n,) [m].

    By the nominal program, from the place on that path which is nearest to where it stands by the second one.

    :param load: the forces along the nominal program.
    :param motion: (n,) motions of the nominal program, and about where on them (n,).
    :param q: (n, 6) joint angles that the second program holds [rad], and where a carriage stands then (n, 3) [m].
    """
    program, path = one.program, one.path

    def tip(motion: Ints, share: Array, q: Array, stands: Array) -> Array:
        wrench = one.wrench(load, motion, share)
        try:
            spot = one.place.tip(q, toolpath.tool_of(program, motion), wrench) + stands
        except NotConvergedError as cause:
            raise _not_held(program, motion, cause) from None
        return toolpath.points_in_base(program, motion, spot, None)

    share, moved, slope = share.copy(), np.zeros((len(share), 3)), np.full(len(share), -1.0)
    known, missed = np.full((2, len(share)), np.nan)
    rows = np.arange(len(share))
    for _ in range(_ROUNDS):
        on, s = motion[rows], share[rows]
        moved[rows] = tip(on, s, q[rows], stands[rows])
        step = np.minimum(s + _AHEAD, 1.0), np.maximum(s - _AHEAD, 1e-9)
        here, ahead, back = (toolpath.positions(program, path, on, at) for at in (s, *step))
        tangent = (ahead - back) / (step[0] - step[1])[:, None]
        long = np.maximum(np.einsum("ni,ni->n", tangent, tangent), 1e-24)
        left = np.einsum("ni,ni->n", moved[rows] - here, tangent) / long
        gone = s - known[rows]
        found = np.clip((left - missed[rows]) / np.where(gone == 0.0, np.nan, gone), *_SLOPES)
        slope[rows] = np.where(np.isnan(found), slope[rows], found)
        known[rows], missed[rows] = s, left
        share[rows] = np.clip(s - left / slope[rows], 1e-9, 1.0)
        rows = rows[(np.abs(left) * np.sqrt(long) > _SETTLED) & (share[rows] != s)]
        if not len(rows):
            break
    here = toolpath.positions(program, path, motion, share)
    nominal = tip(motion, share, one.joints_at(motion, share), one.stands(motion, share))
    return norm(nominal - here), norm(moved - here)
