"""What two programs would cut under the same force: at pairs, at inserted targets, and on the way to them."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import toolpath
from postproc.chunks import in_chunks
from postproc.comparison.result import Comparison, Cuts
from postproc.comparison.side import Side, at
from postproc.errors import ForceError, NotConvergedError
from postproc.forces import BEHIND_STEP, PathForces
from postproc.frames import Array, angle_between, norm
from postproc.program import CIRC, PTP, SPL, Bools, Ints, Program

_ROUNDS, _AHEAD = 3, 1e-3
"""Rounds in which the nearest place of the path is found, and over which share of the way its direction is taken."""
_FAR = 0.2
"""Of the tolerance, what the tip may leave to that place without others being tried."""
_TRIED, _RAMPS, _SAMPLES, _CLOSER = 65, 3.0, 9, 3
"""Places tried, on the whole move and on the ramp of its force (so many times as long), and so often more closely."""
_PROBE = np.array([100.0, 100.0, 100.0, 10.0, 10.0, 10.0])
"""Forces [N] and moments [N·m] that tell how the tip gives way."""
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
    return Cuts(turned, nominal, corrected, _turned(found, one, wrench), np.zeros(0, dtype=np.int64), *(5 * (none,)))


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

    def left(row: Ints, t: Array, q: Array, motion: Ints, share: Array) -> tuple[Array, ...]:
        nominal, corrected, share = _left(one, load, motion, share, q, other.stands(row, t))
        turned = np.zeros(len(row))
        ends = np.flatnonzero(t == 1.0)
        turned[ends] = _turned_at(one, other, load, motion[ends], share[ends], row[ends])
        return nominal, corrected, turned, share

    motion = found.pair[behind, 0]
    nominal, corrected, turned, share = in_chunks(left, row, t, q, motion, np.clip(share, 1e-9, 1.0))
    return replace(
        cuts,
        row=row,
        t=t,
        between_nominal=nominal,
        between_corrected=corrected,
        between_turned=turned,
        share=share,
    )


def _turned_at(one: Side, other: Side, load: PathForces, motion: Ints, share: Array, row: Ints) -> Array:
    """Return by how much targets (n,) of the second program turn the loaded tool from the nominal path (n,) [rad].

    :param motion: (n,) motions of the nominal program, and where on them (n,) the targets stand.
    """
    program, wrench = one.program, one.wrench(load, motion, share)
    pose = toolpath.pose_in_root(program, motion, toolpath.at(program, one.path, motion, share).pose, share)
    tool = toolpath.tool_of(program, motion)
    try:
        wanted = one.place.compensate(pose, one.joints_at(motion, share), tool, wrench).pose
    except NotConvergedError as cause:
        raise _not_held(program, motion, cause) from None
    flange = toolpath.flange_from_tcp(other.program, row, other.program.motions.target[row], None)
    given = flange @ tool
    turned = angle_between(wanted[:, :3, :3], given[:, :3, :3])
    return np.asarray(np.minimum(turned, angle_between(pose[:, :3, :3], given[:, :3, :3])))


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


def _left(
    one: Side, load: PathForces, motion: Ints, share: Array, q: Array, stands: Array
) -> tuple[Array, Array, Array]:
    """Return how far the loaded tip would stand from the nominal path by each program (n,) [m], and where (n,) that is.

    By the nominal program, from the place on that path which is nearest to where it stands by the second one.

    :param load: the forces along the nominal program.
    :param motion: (n,) motions of the nominal program, and about where on them (n,).
    :param q: (n, 6) joint angles that the second program holds [rad], and where a carriage stands then (n, 3) [m].
    """
    program, path = one.program, one.path

    def tip(motion: Ints, wrench: Array, q: Array, stands: Array) -> Array:
        try:
            spot = one.place.tip(q, toolpath.tool_of(program, motion), wrench) + stands
        except NotConvergedError as cause:
            raise _not_held(program, motion, cause) from None
        return toolpath.points_in_base(program, motion, spot, None)

    share = share.copy()
    for _ in range(_ROUNDS):
        moved = tip(motion, one.wrench(load, motion, share), q, stands)
        step = np.minimum(share + _AHEAD, 1.0), np.maximum(share - _AHEAD, 1e-9)
        here, ahead, back = (toolpath.positions(program, path, motion, at) for at in (share, *step))
        tangent = (ahead - back) / (step[0] - step[1])[:, None]
        long = np.maximum(np.einsum("ni,ni->n", tangent, tangent), 1e-24)
        share = np.clip(share + np.einsum("ni,ni->n", moved - here, tangent) / long, 1e-9, 1.0)
    moved = tip(motion, one.wrench(load, motion, share), q, stands)
    far = np.flatnonzero(norm(moved - toolpath.positions(program, path, motion, share)) > _FAR * one.place.tolerance)
    if len(far):
        rest = tip(motion[far], np.zeros((len(far), 6)), q[far], stands[far])
        units = [tip(motion[far], np.tile(unit, (len(far), 1)), q[far], stands[far]) - rest for unit in np.diag(_PROBE)]
        nearest = _Nearest(one, load, motion[far], rest, np.stack(units, axis=2) / _PROBE)
        share[far] = nearest.found()
        for _ in range(_ROUNDS):
            moved[far] = tip(motion[far], one.wrench(load, motion[far], share[far]), q[far], stands[far])
            off = moved[far] - toolpath.positions(program, path, motion[far], share[far])
            share[far] = nearest.corrected(share[far], off)
        moved[far] = tip(motion[far], one.wrench(load, motion[far], share[far]), q[far], stands[far])
    here = toolpath.positions(program, path, motion, share)
    wrench = one.wrench(load, motion, share)
    nominal = tip(motion, wrench, one.joints_at(motion, share), one.stands(motion, share))
    return norm(nominal - here), norm(moved - here), share


class _Nearest(Struct, frozen=True, eq=False):
    """Looks for the places on motions (n,) to which the loaded tip is nearest.

    The force there moves the tip: on a steep ramp it may run back while the path goes on. So many places are tried.

    :param rest: (n, 3) where the tip stands without force [m], `$BASE`.
    :param compliance: (n, 3, 6) how far it moves by a force and a moment on it, root axes, about.
    """

    one: Side
    load: PathForces
    motion: Ints
    rest: Array
    compliance: Array

    def off(self, share: Array) -> Array:
        """Return where the tip stands about, seen from places (n, k) on the path: (n, k, 3) [m]."""
        which = np.repeat(np.arange(len(self.motion)), share.shape[1])
        motion, flat = self.motion[which], share.ravel()
        moved = np.einsum("nij,nj->ni", self.compliance[which], self.one.wrench(self.load, motion, flat))
        here = toolpath.positions(self.one.program, self.one.path, motion, flat)
        return np.asarray(self.rest[which] + moved - here).reshape(*share.shape, 3)

    def found(self) -> Array:
        """Return the nearest places (n,) by all that were tried."""
        even = np.linspace(1e-9, 1.0, _TRIED)
        length = np.maximum(self.one.path.length[self.motion], 1e-12)
        ramp = np.minimum(_RAMPS * self.one.place.ramp / length, 1.0)[:, None]
        tried = np.sort(np.hstack([np.tile(even, (len(ramp), 1)), np.maximum(ramp * even, 1e-9)]), axis=1)
        rows = np.arange(len(ramp))
        for _ in range(_CLOSER):
            best = np.argmin(norm(self.off(tried)), axis=1)
            share = tried[rows, best]
            begin, end = tried[rows, np.maximum(best - 1, 0)], tried[rows, np.minimum(best + 1, tried.shape[1] - 1)]
            tried = begin[:, None] + (end - begin)[:, None] * np.linspace(0.0, 1.0, _SAMPLES)
        return np.asarray(share)

    def corrected(self, share: Array, off: Array) -> Array:
        """Return places (n,) that are nearer, where the tip stands (n, 3) from places (n,) in truth [m]."""
        ahead, back = np.minimum(share + _AHEAD, 1.0), np.maximum(share - _AHEAD, 1e-9)
        one, other = np.moveaxis(self.off(np.stack([back, ahead], axis=1)), 1, 0)
        change = (other - one) / (ahead - back)[:, None]
        step = np.einsum("ni,ni->n", off, change) / np.maximum(np.einsum("ni,ni->n", change, change), 1e-24)
        return np.asarray(np.clip(share - step, 1e-9, 1.0))
