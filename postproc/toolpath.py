"""The nominal tool path: poses anywhere on the motions of a program, and where to look at them.

A place on the path is (motion, t), t in (0, 1] along the motion. Row i of a `Toolpath` is one sample; the samples of a
motion stand together in order, and its end (t = 1) is always among them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from postproc.chunks import in_chunks
from postproc.frames import RAD_PER_DEG, Array, interpolated, inverse, norm, twist_between
from postproc.program import CIRC, LIN, PTP, Bools, Ints, Program, Starts

_STEP = 0.020
"""Spacing of samples [m] for a tolerance of 0.01 mm; it grows with the root of the tolerance (a chord's sagitta)."""
_REFERENCE_TOLERANCE = 1e-5
_TURN = 3.0 * RAD_PER_DEG
_ARC = 5.0 * RAD_PER_DEG


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """The geometry of M motions: where each starts, how long it is. `$BASE` of the motion, metres.

    :param start: tool frames where the motions start.
    :param length: (M,) path length of the TCP; 0 for PTP.
    :param turn: (M,) angle between the orientations at start and end [rad].
    """

    start: Starts
    length: Array
    turn: Array


@dataclass(frozen=True, slots=True, eq=False)
class Toolpath:
    """N samples of the nominal path.

    :param motion: (N,) row of `Motions`.
    :param t: (N,) place on the motion, in (0, 1].
    :param pose: (N, 4, 4) tool frame in the motion's `$BASE` [m].
    :param distance: (N,) travelled from the start of the motion [m].
    """

    motion: Ints
    t: Array
    pose: Array
    distance: Array

    def __len__(self) -> int:
        return len(self.motion)

    @property
    def ends(self) -> Bools:
        """(N,) True at the ends of motions."""
        return np.asarray(self.t == 1.0)


def flange_from_tcp(program: Program, motion: Ints, pose_tcp_in_base: Array) -> Array:
    """Return flange poses in the robot root (N, 4, 4) for tool frames in `$BASE` of the given motions."""
    moved = program.motions
    if len(program.bases) == len(program.tools) == 1:
        return np.asarray(program.bases[0] @ pose_tcp_in_base @ inverse(program.tools[0]))
    return np.asarray(program.bases[moved.base[motion]] @ pose_tcp_in_base @ inverse(program.tools)[moved.tool[motion]])


def flange_points(program: Program, motion: Ints, pose_tcp_in_base: Array, point: Array) -> Array:
    """Return where a point (3,) of the flange frame stands in the robot root (N, 3) [m]; poses as `flange_from_tcp`."""
    m = program.motions
    in_tool = inverse(program.tools) @ np.append(point, 1.0)
    if len(program.bases) == len(program.tools) == 1:
        return np.asarray((pose_tcp_in_base @ in_tool[0]) @ program.bases[0, :3].T)
    in_base = pose_tcp_in_base @ in_tool[m.tool[motion]][..., None]
    return np.asarray((program.bases[m.base[motion], :3] @ in_base)[..., 0])


def starts(program: Program, end: Callable[[Ints], Array], start_flange_in_root: Array) -> Starts:
    """Return where motions start: `end` returns their ends (n, 4, 4); the robot stands at a flange (4, 4) first."""
    m = program.motions
    return Starts.of((m.base, m.tool, program.bases, program.tools), end, start_flange_in_root)


def segments(program: Program, start_flange_in_root: Array) -> Segments:
    """Return where each motion starts and how long it is.

    :param start_flange_in_root: (4, 4) where the robot stands before the first motion [m].
    """
    m = program.motions
    start = starts(program, m.target.__getitem__, start_flange_in_root)

    def chord(rows: Ints) -> tuple[Array, Array]:
        between = twist_between(start.at(rows), m.target[rows])
        return norm(between[:, :3]), norm(between[:, 3:])

    length, turn = in_chunks(chord, np.arange(len(m)))
    arcs = np.flatnonzero(m.kind == CIRC)
    begin = start.at(arcs)[:, :3, 3]
    rise = np.einsum("ni,ni->n", m.target[arcs, :3, 3] - begin, m.normal[arcs])
    length[arcs] = np.hypot(norm(begin - m.centre[arcs]) * m.sweep[arcs], rise)
    length[m.kind == PTP] = 0.0
    return Segments(start, length, turn)


def places(
    program: Program,
    path: Segments,
    tolerance: float,
    kinks: Array,
    *,
    linearize_arcs: bool = False,
    also: tuple[Ints, Array] | None = None,
) -> tuple[Ints, Array]:
    """Choose where on the path to compute: every end, and enough places between.

    Deflection changes along a straight run over lengths of the order of the arm, so that samples every 20 mm and 3°
    catch its curvature to a fraction of 0.01 mm; arcs are sampled every 5°, or as their chords need, and their force
    ramps, along which travel and force turn, at eight places.

    :param tolerance: what the path may be left by [m].
    :param kinks: (M,) place t on each motion where the force stops changing (end of its ramp), 1 where nowhere.
    :param linearize_arcs: sample arcs so finely that their chords keep half the tolerance.
    :param also: further places: motion (n,) and t (n,).
    :returns: motion (N,) and t (N,), in order.
    """
    m = program.motions
    factor = np.sqrt(tolerance / _REFERENCE_TOLERANCE)
    count = np.ceil(np.maximum(path.length / (_STEP * factor), path.turn / _TURN) - 1e-9)
    arcs = np.flatnonzero(m.kind == CIRC)
    step = np.full(len(arcs), _ARC)
    if linearize_arcs:
        radius = norm(path.start.at(arcs)[:, :3, 3] - m.centre[arcs])
        step = np.minimum(step, 2.0 * np.sqrt(tolerance / np.maximum(radius, tolerance)))
    count[arcs] = np.maximum(count[arcs], 2.0 * np.ceil(m.sweep[arcs] / step / 2.0 - 1e-9))
    count[m.kind == PTP] = 1.0
    number = np.maximum(count, 1.0).astype(np.int64)
    motion = np.repeat(np.arange(len(m)), number)
    index = np.arange(len(motion)) - np.repeat(np.cumsum(number) - number, number) + 1
    t = index / number[motion]
    more = [also] if also is not None else []
    bent = np.flatnonzero(kinks < 1.0)
    more.append((bent, kinks[bent]))
    bent = bent[m.kind[bent] == CIRC]
    more += [(bent, kinks[bent] * eighth / 8.0) for eighth in range(1, 8)]
    if sum(len(rows) for rows, _ in more):
        motion = np.concatenate([motion, *(rows for rows, _ in more)])
        t = np.concatenate([t, *(places for _, places in more)])
        order = np.lexsort((t, motion))
        motion, t = motion[order], t[order]
        again = np.flatnonzero((np.diff(motion) == 0) & (np.diff(t) < 1e-9))
        motion, t = np.delete(motion, again), np.delete(t, again)
    return motion, t


def at(program: Program, path: Segments, motion: Ints, t: Array) -> Toolpath:
    """Return the nominal path at places (motion, t).

    LIN: position linear, orientation by one rotation. CIRC: rotation about the arc's axis with a linear rise, the
    orientation as for LIN. PTP: only its end (t = 1) is known here.
    """
    m = program.motions
    pose = m.target[motion]
    kind = m.kind[motion]
    inner = np.flatnonzero((t < 1.0) & (kind != PTP))
    if len(inner):
        rows = motion[inner]
        pose[inner] = interpolated(path.start.at(rows), m.target[rows], t[inner])
    arcs = inner[kind[inner] == CIRC]
    if len(arcs):
        pose[arcs, :3, 3] = _on_arc(program, path, motion[arcs], t[arcs])[0]
    return Toolpath(motion, t, pose, path.length[motion] * t)


def tangent(program: Program, path: Segments, motion: Ints, t: Array) -> Array:
    """Return the unit direction of travel (n, 3), `$BASE`, at places (motion, t); zero without travel, and for PTP."""
    m = program.motions
    out = np.zeros((len(motion), 3))
    kind = m.kind[motion]
    long = np.flatnonzero((kind == LIN) & (path.length[motion] > 0.0))
    rows = motion[long]
    out[long] = (m.target[rows, :3, 3] - path.start.at(rows)[:, :3, 3]) / path.length[rows, None]
    arcs = np.flatnonzero(kind == CIRC)
    if len(arcs):
        velocity = _on_arc(program, path, motion[arcs], t[arcs])[1]
        out[arcs] = velocity / np.linalg.norm(velocity, axis=1, keepdims=True)
    return out


def _on_arc(program: Program, path: Segments, motion: Ints, t: Array) -> tuple[Array, Array]:
    """Return positions and their derivatives by t (n, 3) on CIRC motions."""
    m = program.motions
    start = path.start.at(motion)[:, :3, 3]
    from_centre = start - m.centre[motion]
    normal, sweep = m.normal[motion], m.sweep[motion, None]
    height = np.einsum("ni,ni->n", from_centre, normal)[:, None] * normal
    radial = from_centre - height
    across = np.cross(normal, radial)
    climb = np.einsum("ni,ni->n", m.target[motion, :3, 3] - start, normal)[:, None] * normal
    sin, cos = np.sin(sweep * t[:, None]), np.cos(sweep * t[:, None])
    # programmed radii at start and end may differ by the tolerance of the control: the radius then changes linearly
    end = m.target[motion, :3, 3] - m.centre[motion] - height - climb
    growth = (norm(end) / norm(radial) - 1.0)[:, None]
    scale = 1.0 + growth * t[:, None]
    spot = m.centre[motion] + height + scale * (cos * radial + sin * across) + climb * t[:, None]
    turning = sweep * scale * (cos * across - sin * radial)
    return spot, turning + growth * (cos * radial + sin * across) + climb
