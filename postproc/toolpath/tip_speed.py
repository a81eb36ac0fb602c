"""The speed of the tip that a controller holds where the tool turns: a program states how fast it may turn.

A controller moves and turns the tool in one time, the longer one of the two. Speeds of turning are `$VEL.ORI1` and
`$VEL.ORI2` of KRL (swivel and rotation; KUKA, System Variables) and `v_ori` of a speeddata of RAPID (ABB, 3HAC16581).
The tool direction of KUKA is X of the tool, as `$TOOL_DIRECTION` is delivered.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from postproc.frames import Array, norm, rotation_vector
from postproc.program import CIRC, LIN, Program
from postproc.toolpath.path import Segments, at

_PARTS = 8
"""Parts of a motion whose turns are added: none is half a turn, after which another rotation would be shorter."""
_MIN_LENGTH = 1e-9
"""A motion whose tip moves by less [m] only turns the tool."""
_SAME_TIME = 1e-9
"""Times that differ by a smaller share are equal but for rounding."""


def tip_speeds(program: Program, path: Segments) -> Array:
    """Return the speed of the tip (M,) [m/s]: the feed, or less where the tool would turn faster than it may.

    PTP, pieces of splines, whose length is not known, and motions that only turn the tool keep their feed (PTP: NaN).

    :param path: geometry of the motions.
    """
    feed, limits = program.motions.feed, program.turn_speeds
    if limits is None:
        return feed
    has_feed = np.isin(program.motions.kind, (LIN, CIRC)) & (path.length > _MIN_LENGTH) & (feed > 0.0)
    seconds = path.length / np.where(has_feed, feed, 1.0)
    least_limit = limits.values.min(axis=1)[limits.run]
    rows = np.flatnonzero(has_feed & (path.turn / least_limit > seconds))  # `turn` is an upper bound
    # orientations where the parts begin and end, made as they are needed: those of two places are kept at a time
    rotations = (at(program, path, rows, np.full(len(rows), part / _PARTS)).pose.rotation for part in range(_PARTS + 1))
    part_seconds = [turn_seconds(start, end, limits.take(rows)) for start, end in pairwise(rotations)]
    turning = np.stack(part_seconds, axis=1).sum(axis=1)
    is_slowed = turning > seconds[rows] * (1.0 + _SAME_TIME)
    speed = feed.copy()
    speed[rows[is_slowed]] = path.length[rows[is_slowed]] / turning[is_slowed]
    return speed


def turn_seconds(start: Array, end: Array, limits: Array) -> Array:
    """Return the least time (...) [s] in which the tool may turn from one orientation to another.

    :param start: (..., 3, 3) orientations of the tool frame; `end`: (..., 3, 3), less than half a turn from these.
    :param limits: (..., 3) largest speeds [rad/s] of any turn, of the turn of the x axis (swivel), and of the turn
        about the x axis (rotation), see `Program.turn_speeds`.
    """
    turn = rotation_vector(np.swapaxes(start, -1, -2) @ end)
    swivel, rotation = norm(turn[..., 1:]), np.abs(turn[..., 0])
    return np.asarray((np.stack([norm(turn), swivel, rotation], axis=-1) / limits).max(axis=-1))
