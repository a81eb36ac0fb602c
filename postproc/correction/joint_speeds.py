"""Speeds of the joints: rapid moves are slowed where a joint would turn too fast, and the written path is checked."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from msgspec.structs import replace

from postproc.chunks import in_chunks
from postproc.correction import checks, closely
from postproc.correction.read_back import ReadBack
from postproc.correction.targets import Chosen
from postproc.errors import Issue
from postproc.frames import Array, norm
from postproc.program import LIN, PTP, Ints
from postproc.robot import JOINTS
from postproc.under_load import MotionsUnderLoad, PathUnderLoad

_NEAR = 0.75
"""Share of a joint's largest speed from which on the written path is examined closely."""
_STILL = 1e-6
"""Pieces shorter than this [m] have no speed."""
_USED = 0.98
"""Share of a joint's largest speed that slowed rapid moves use."""


def slowed(path: PathUnderLoad, q: Array, position: Array) -> tuple[MotionsUnderLoad, Issue] | None:
    """Return the motions with rapid moves slowed to what the joints can do, and the remark; None if none is too fast.

    Only programs whose text is written anew have rapid straight moves with a speed of their own.

    :param q: (N, 6) commanded joint angles of the samples [rad], `position` (N, 3) commanded positions [m].
    """
    program, robot = path.program, path.setting.robot
    m = program.motions
    if program.keeps_text or not (m.rapid & (m.kind == LIN)).any():
        return None
    speed = commanded_speed(path, q, position)
    share = np.zeros(len(m))
    joint = np.zeros(len(m), dtype=np.int64)

    def take(motion: Ints, speed: Array) -> None:
        of_limit = speed / robot.speed
        worst = of_limit.max(axis=1)
        rows = np.flatnonzero(m.rapid[motion] & (m.kind[motion] == LIN) & (worst > _USED))
        rows = rows[np.argsort(worst[rows])]
        rows = rows[worst[rows] > share[motion[rows]]]
        share[motion[rows]], joint[motion[rows]] = worst[rows], of_limit[rows].argmax(axis=1)

    take(path.sample.motion, speed)
    _, lines = closely.stretches(path, q, speed)
    for close, exact, position_there in closely.places(path, q, position, lines):
        take(close.motion, checks.joint_speed(program, close, path.motions.segments.turn, exact, position_there))
    fast = np.flatnonzero(share > 1.0)
    if not len(fast):
        return None
    feed = m.feed.copy()
    feed[fast] *= _USED / share[fast]
    names = " and ".join(JOINTS[axis] for axis in np.unique(joint[fast]).tolist())
    message = (
        f"Rapid moves in which {names} would turn too fast are slowed, to {feed[fast].min():.3g} m/s at the slowest."
    )
    issue = m.issue("info", "rapid-slowed", message, fast)
    slow = replace(program, motions=replace(m, feed=feed))
    return replace(path.motions, program=slow), issue


def commanded_speed(path: PathUnderLoad, q: Array, position: Array) -> Array:
    """Return how fast the joints turn at the programmed feed on the way to each sample (N, 6) [rad/s].

    The first sample is reached from `[start]` of the cell.

    :param q: (N, 6) commanded joint angles of the samples [rad], `position` (N, 3) commanded positions [m].
    """
    m, segments = path.program.motions, path.motions.segments
    speed = checks.joint_speed(path.program, path.sample, segments.turn, q, position)
    travel = segments.length[0] * path.sample.t[0]
    if m.kind[0] != PTP and np.isnan(m.joints[0, 0]) and travel > 1e-6 and m.feed[0] > 0.0:
        speed[0] = np.abs(q[0] - path.setting.cell.start_joints) * m.feed[0] / travel
    return speed


def of_written(
    path: PathUnderLoad, chosen: Chosen, back: ReadBack, target: Ints, q: Array, position: Array
) -> Iterator[Issue]:
    """Yield the joint speeds of the written program beyond the limits, as a prediction of it finds them.

    :param target: (n,) target at the end of the piece on which each place is.
    :param q: (n, 6) joint angles at places along the written program [rad], in order; `position` (n, 3) there [m].
    """
    written, robot = back.program, path.setting.robot

    def steps(place: Array, next_place: Array, q: Array, next_q: Array) -> tuple[Array, Array]:
        return norm(next_place - place), (np.abs(next_q - q) / robot.speed).max(axis=1, initial=0.0)

    travel, turned = in_chunks(steps, position[:-1], position[1:], q[:-1], q[1:])
    feed = np.nan_to_num(written.motions.feed[back.row[target[1:]]])
    if not ((turned * feed > _NEAR * travel) & (travel > _STILL)).any():
        return
    motions = MotionsUnderLoad.of(written, path.setting, None)
    simulated = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    speed = commanded_speed(simulated, simulated.joints.q, simulated.sample.pose[:, :3, 3])
    _, lines = closely.stretches(simulated, simulated.joints.q, speed)
    found = list(checks.joint_speeds(written, robot, simulated.sample, speed))
    for close, exact, there in closely.places(simulated, simulated.joints.q, simulated.sample.pose[:, :3, 3], lines):
        speed = checks.joint_speed(written, close, simulated.motions.segments.turn, exact, there)
        found += checks.joint_speeds(written, robot, close, speed)
    seen = set()
    for issue in found:
        if issue.kind not in seen:
            seen.add(issue.kind)
            at = int(np.argmax(written.motions.line[back.row] == issue.source_line))
            line = int(path.program.motions.line[chosen.targets.motion[at]])
            yield replace(issue, output_line=issue.source_line, source_line=line, lines=(line,))
