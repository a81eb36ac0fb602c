"""The path between its samples, looked at closely where joints come near what they can do.

The places computed on an arc may be 60° apart, those on a line 20 mm: enough for the deflection, but a joint may turn
fastest, stand beyond a limit or pass a singularity between two of them. Where that is possible at all, an arc is looked
at every 5°, and the piece of a line between two samples every 2 mm and half a degree.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from msgspec import Struct

from postproc import kinematics, toolpath
from postproc.correction import checks
from postproc.errors import Issue
from postproc.frames import RAD_PER_DEG, Array, largest
from postproc.program import CIRC, LIN, Bools, Ints, distinct
from postproc.under_load import PathUnderLoad, unreachable

_SPACING = 5.0 * RAD_PER_DEG
_SHARE_OF_SPEED = 0.75
"""Of a joint's fastest, by the samples: between two that are 60° apart a sine is up to 1 / cos 30° steeper."""
_TURNED = 10.0 * RAD_PER_DEG
"""From one sample to the next; by more a joint turns where the wrist or the shoulder is near a singularity."""
_NEAR_WRIST = 1.0 * RAD_PER_DEG
_NEAR_ELBOW = 20.0 * RAD_PER_DEG
"""A3 changes with the root of the distance to where the arm is stretched: nearer than this it may get there unseen."""
_AT_ONCE = 8192
"""Places looked at together."""
_STEPS = 2.0
"""What changes smoothly passes its values at the samples by less than one of its steps between them."""
_LONG, _TURNS = 0.002, 0.5 * RAD_PER_DEG
"""Shorter pieces of lines that turn the tool less hide nothing; longer ones are looked at so closely."""
_NEAREST = 0.15
"""From the wrist, and the wrist from the axes of A1 to A3 [m], about: a joint turns by no more than the way through it,
unless the arm is nearly singular."""
_PER_TURN = 6.0
"""A joint turns by no more than so many times the angle by which the tool does, unless the wrist is nearly singular."""
_ELBOW_PER_M, _ELBOW_PER_TURN = 5.0, 3.0
"""How much A3 may come nearer to where the arm is stretched within a piece of a line, per way [rad/m] and turn."""
_REACH_PER_TURN = 0.5
"""How far the wrist may move by turning the tool [m/rad]."""


def needed(path: PathUnderLoad, q: Array, speed: Array) -> Ints:
    """Return the arcs (A,), rows of `Motions`, that need a closer look.

    :param q: (N, 6) commanded joint angles of the samples [rad].
    :param speed: (N, 6) joint speeds on the way to each [rad/s].
    """
    sample = path.sample
    rows = np.flatnonzero(path.program.motions.kind[sample.motion] == CIRC)
    if len(rows) == 0:
        return rows
    robot, form = path.setting.robot, kinematics.closed_form(path.setting.robot)
    before = np.concatenate([path.setting.cell.start_joints[None], q])[rows]
    here, speed = q[rows], speed[rows]
    turned, reach = np.abs(here - before), form.reach(here)
    begins = np.diff(sample.motion[rows], prepend=-1) != 0
    step = np.column_stack([turned, np.abs(reach - form.reach(before))])
    step = np.maximum.reduceat(step, np.flatnonzero(begins))[np.cumsum(begins) - 1]
    near = _STEPS * step
    elbow = (here[:, 2] - form.elbow_stretched + np.pi) % (2.0 * np.pi) - np.pi
    close = (np.minimum(here - robot.lower, robot.upper - here) < near[:, :6]).any(axis=1)
    close |= (largest(turned) > _TURNED) | (speed > _SHARE_OF_SPEED * robot.speed).any(axis=1)
    close |= (np.abs(here[:, 4]) < np.maximum(near[:, 4], _NEAR_WRIST)) | (np.abs(elbow) < _NEAR_ELBOW)
    close |= np.abs(reach) < near[:, 6] + checks.SHOULDER
    return distinct(sample.motion[rows[close]])


class Stretches(Struct, frozen=True, eq=False):
    """S stretches of motions that need a closer look, in order along the path.

    :param motion: (S,) row of `Motions`.
    :param begin: (S,) place where it begins, and `end` (S,) where it ends.
    :param count: (S,) of places at which to look, both ends among them.
    """

    motion: Ints
    begin: Array
    end: Array
    count: Ints


def arcs_of(path: PathUnderLoad, arcs: Ints) -> Stretches:
    """Return arcs (A,), rows of `Motions`, as stretches looked at every 5°."""
    count = np.ceil(path.program.motions.sweep[arcs] / _SPACING - 1e-9).astype(np.int64) + 1
    return Stretches(arcs, np.zeros(len(arcs)), np.ones(len(arcs)), count)


def lines(path: PathUnderLoad, q: Array, speed: Array) -> Stretches:
    """Return the pieces of lines between two samples within which a joint may come to what it cannot do.

    :param q: (N, 6) commanded joint angles of the samples [rad].
    :param speed: (N, 6) joint speeds on the way to each [rad/s].
    """
    sample, segments = path.sample, path.motions.segments
    first = np.diff(sample.motion, prepend=-1) != 0
    begin = np.where(first, 0.0, np.roll(sample.t, 1))
    way, turn = (each[sample.motion] * (sample.t - begin) for each in (segments.way, segments.turn))
    long = (path.program.motions.kind[sample.motion] == LIN) & ((way > _LONG) | (turn > _TURNS))
    rows = np.flatnonzero(long)
    close = rows[_close(path, q, speed, rows, way[rows], turn[rows])]
    count = np.ceil(np.maximum(way[close] / _LONG, turn[close] / _TURNS)).astype(np.int64) + 1
    return Stretches(sample.motion[close], begin[close], sample.t[close], count)


def _close(path: PathUnderLoad, q: Array, speed: Array, rows: Ints, way: Array, turn: Array) -> Bools:
    """Return on the way to which samples, `rows` (n,), a joint may come to what it cannot do."""
    robot, form = path.setting.robot, kinematics.closed_form(path.setting.robot)
    before, here = np.concatenate([path.setting.cell.start_joints[None], q])[rows], q[rows]
    near = _STEPS * np.abs(here - before) + (way / _NEAREST + _PER_TURN * turn)[:, None]
    margin = np.minimum(*(np.minimum(each - robot.lower, robot.upper - each) for each in (before, here)))
    elbow = (np.stack([before, here])[..., 2] - form.elbow_stretched + np.pi) % (2.0 * np.pi) - np.pi
    reach = np.stack([form.reach(before), form.reach(here)])
    near_reach = _STEPS * np.abs(reach[1] - reach[0]) + way + _REACH_PER_TURN * turn + checks.SHOULDER
    out = (margin < near).any(axis=1) | (speed[rows] > _SHARE_OF_SPEED * robot.speed).any(axis=1)
    out |= np.minimum(np.abs(before[:, 4]), np.abs(here[:, 4])) < near[:, 4]
    out |= np.abs(elbow).min(axis=0) < _ELBOW_PER_M * way + _ELBOW_PER_TURN * turn
    return np.asarray(out | (np.abs(reach).min(axis=0) < near_reach))


def look(path: PathUnderLoad, q: Array, position: Array, stretches: Stretches, apart: Ints) -> Iterator[Issue]:
    """Yield what the checks of joints find on stretches looked at closely.

    :param q: (N, 6) commanded joint angles of the samples [rad], `position` (N, 3) commanded positions [m]: the
        correction of both is taken for linear between samples.
    :param apart: motions of whose stretches not all follow each other.
    """
    program, robot, sample, joints = path.program, path.setting.robot, path.sample, path.joints
    if len(stretches.motion) == 0:
        return
    last = np.flatnonzero(sample.ends)
    known = sample.motion + sample.t
    values = np.column_stack([joints.q, q - joints.q, position - sample.pose[:, :3, 3]])
    count = stretches.count
    group = np.cumsum(count) // _AT_ONCE
    for part in np.split(np.arange(len(count)), np.flatnonzero(np.diff(group)) + 1):
        which = np.repeat(part, count[part])
        index = np.arange(len(which)) - np.flatnonzero(np.diff(which, prepend=-1))[which - part[0]]
        begin, end = stretches.begin[which], stretches.end[which]
        motion, t = stretches.motion[which], begin + (end - begin) * (index / (count[which] - 1))
        close = toolpath.at(program, path.motions.segments, motion, t)
        flange = toolpath.flange_from_tcp(program, motion, close.pose, t)
        exact = kinematics.on_branch(robot, flange, joints.branch[last[motion]])
        bad = np.asarray(np.isnan(exact).any(axis=1))
        if bad.any():
            yield unreachable(program, motion[bad])
            return
        between = np.column_stack([np.interp(motion + t, known, column) for column in values.T])
        exact += 2.0 * np.pi * np.round((between[:, :6] - exact) / (2.0 * np.pi)) + between[:, 6:12]
        yield from checks.joint_limits(program, robot, close, exact)
        yield from checks.singularities(program, robot, close, exact, apart)
        commanded = close.pose[:, :3, 3] + between[:, 12:]
        speed = checks.joint_speed(program, close, path.motions.segments.turn, exact, commanded)
        yield from checks.joint_speeds(program, robot, close, speed)
