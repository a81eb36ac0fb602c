"""Arcs looked at closely where joints come near what they can do.

The places computed on an arc may be 60° apart: enough for its deflection, but a joint may turn fastest, stand beyond a
limit or pass a singularity between two of them. Where that is possible at all, the arc is looked at every 5°.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postproc import kinematics, toolpath
from postproc.correction import checks
from postproc.errors import Issue
from postproc.frames import RAD_PER_DEG, Array, largest
from postproc.program import CIRC, Ints
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
    return np.unique(sample.motion[rows[close]])


def look(path: PathUnderLoad, q: Array, position: Array, arcs: Ints) -> Iterator[Issue]:
    """Yield what the checks of joints find on arcs (A,) looked at every 5°.

    :param q: (N, 6) commanded joint angles of the samples [rad], `position` (N, 3) commanded positions [m]: the
        correction of both is taken for linear between samples.
    """
    program, robot, sample, joints = path.program, path.setting.robot, path.sample, path.joints
    if len(arcs) == 0:
        return
    last = np.flatnonzero(sample.ends)
    known = sample.motion + sample.t
    values = np.column_stack([joints.q, q - joints.q, position - sample.pose[:, :3, 3]])
    count = np.ceil(program.motions.sweep[arcs] / _SPACING - 1e-9).astype(np.int64) + 1
    group = np.cumsum(count) // _AT_ONCE
    for part in np.split(np.arange(len(arcs)), np.flatnonzero(np.diff(group)) + 1):
        which = np.repeat(part, count[part])
        index = np.arange(len(which)) - np.flatnonzero(np.diff(which, prepend=-1))[which - part[0]]
        motion, t = arcs[which], index / (count[which] - 1)
        close = toolpath.at(program, path.motions.segments, motion, t)
        flange = toolpath.flange_from_tcp(program, motion, close.pose)
        exact = kinematics.on_branch(robot, flange, joints.branch[last[motion]])
        bad = np.asarray(np.isnan(exact).any(axis=1))
        if bad.any():
            yield unreachable(program, motion[bad])
            return
        between = np.column_stack([np.interp(motion + t, known, column) for column in values.T])
        exact += 2.0 * np.pi * np.round((between[:, :6] - exact) / (2.0 * np.pi)) + between[:, 6:12]
        yield from checks.joint_limits(program, robot, close, exact)
        yield from checks.singularities(program, robot, close, exact, arcs[:0])
        speed = checks.joint_speed(
            program, close, path.motions.segments.turn, exact, close.pose[:, :3, 3] + between[:, 12:]
        )
        yield from checks.joint_speeds(program, robot, close, speed)
