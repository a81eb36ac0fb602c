"""The wrench along the path: axes of each frame, and the ramp that keeps it continuous."""

from __future__ import annotations

import numpy as np

from postproc.forces.feed import feed_axes, runs_across
from postproc.forces.per_motion import FEED, TOOL, MotionForces
from postproc.frames import Array, largest, norm
from postproc.program import CIRC, Ints, Program
from postproc.toolpath import Segments, Swing, Toolpath, at


def wrench(program: Program, path: Segments, forces: MotionForces, sample: Toolpath, axis: str, ramp: float) -> Array:
    """Return the wrench at each sample of the path.

    Along a motion the wrench goes linearly from that at the end of the motion before to the motion's own over the
    first `ramp` metres (at most the motion's length); at the end of each motion its own acts in full. It starts at
    zero before the first motion.

    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :param ramp: [m].
    :returns: (N, 6) force [N] and moment [N·m] on the tool at the TCP, `$BASE` axes of the motion.
    """
    own = _in_base(program, path, forces, sample.motion, sample.t, axis)
    previous = _at_start(program, path, forces, sample.motion, axis)
    reach = np.minimum(ramp, path.length[sample.motion])
    share = np.where(reach > 0.0, np.minimum(1.0, sample.distance / np.where(reach > 0.0, reach, 1.0)), sample.t)
    share = np.where(sample.t == 1.0, 1.0, share)[:, None]
    return np.asarray(previous + share * (own - previous))


def swing(
    program: Program, path: Segments, forces: MotionForces, axis: str, ramp: float, softness: tuple[float, float]
) -> Swing:
    """Return how the displacement by the force changes along the motions, roughly.

    :param softness: how far the tool gives way, about, per force [m/N] and per moment [m/(N·m)].
    """
    rows = np.arange(len(program.motions))
    turning = (program.motions.kind == CIRC) & (forces.frame == FEED)
    end = np.minimum(1.0, ramp / np.maximum(path.length, ramp))
    there = np.where(turning, end, 1e-9)  # a force that turns has turned until the end of the ramp
    change = _in_base(program, path, forces, rows, there, axis) - _at_start(program, path, forces, rows, axis)
    end[largest(change) < 1e-9] = 1.0
    across = forces.wrench * turning[:, None] * (1.0, 1.0, 0.0, 1.0, 1.0, 0.0)  # z, along the spindle, does not turn

    def displacement(wrench: Array) -> Array:
        return np.asarray(softness[0] * norm(wrench[:, :3]) + softness[1] * norm(wrench[:, 3:]))

    swings = np.zeros(len(rows), dtype=bool)
    found = np.flatnonzero(turning & across.any(axis=1))
    swings[found] = ~runs_across(program, path, found, axis)
    return Swing(end, displacement(change), displacement(across), displacement(forces.wrench), swings)


def _at_start(program: Program, path: Segments, forces: MotionForces, motion: Ints, axis: str) -> Array:
    """Return the wrench (n, 6) at the start of motions (n,): that of the motion before, in the axes of the motion."""
    before = np.maximum(motion - 1, 0)
    out = _in_base(program, path, forces, before, np.ones(len(motion)), axis)
    out[motion == 0] = 0.0
    here, there = program.motions.base[motion], program.motions.base[before]
    changed = np.flatnonzero(here != there)
    turn = np.swapaxes(program.bases[here[changed], :3, :3], 1, 2) @ program.bases[there[changed], :3, :3]
    for half in (slice(0, 3), slice(3, 6)):
        out[changed, half] = np.einsum("nij,nj->ni", turn, out[changed, half])
    return out


def _in_base(program: Program, path: Segments, forces: MotionForces, motion: Ints, t: Array, axis: str) -> Array:
    """Return the full own wrench (n, 6) at places (motion, t) in `$BASE` axes."""
    out = forces.wrench[motion]
    frame = forces.frame[motion]
    for code in (TOOL, FEED):
        rows = np.flatnonzero((frame == code) & out.any(axis=1))
        if len(rows):
            sample = at(program, path, motion[rows], t[rows])
            rotation = sample.pose[:, :3, :3]
            if code == FEED:
                rotation = feed_axes(program, path, sample, axis, forces.travel)
            for half in (slice(0, 3), slice(3, 6)):
                out[rows, half] = np.einsum("nij,nj->ni", rotation, out[rows, half])
    return out
