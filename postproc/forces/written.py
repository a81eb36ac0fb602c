"""Forces that travel with a program: the wrench at each target of the written one, as it must be given to that.

Every piece that is written is a motion of its own, whose force comes up over its own beginning and acts in full at its
end. So each target gets the wrench that acts there. Its axes are those of `$BASE`, in which a straight piece has the
same force throughout; a FEED force on an arc and a TOOL force on a motion that turns keep theirs, as these turn along
the piece.
"""

from __future__ import annotations

import numpy as np

from postproc.forces.feed import across
from postproc.forces.per_motion import BASE, FEED, TOOL, MotionForces
from postproc.frames import Array
from postproc.program import CIRC, TargetForces, Targets
from postproc.toolpath import Segments

_TURNS = 1e-6
"""A motion that turns the tool by less than this [rad] does not turn it."""


def of_targets(
    path: Segments, load: MotionForces, targets: Targets, arrive: Array, wrench: Array, axis: str
) -> TargetForces:
    """Return the wrench at each target as a comment or a CSV row of the written program must give it.

    :param path: the geometry of the program as read, and `load` its forces.
    :param targets: what is to be written.
    :param arrive: (K, 3) direction of travel at the end of each piece, `$BASE`.
    :param wrench: (K, 6) what acts there [N, N·m], `$BASE` axes.
    :param axis: axis of the tool frame that points from the spindle to the tip.
    """
    frame = load.frame[targets.motion]
    turning = (frame == FEED) & (targets.kind == CIRC) | (frame == TOOL) & (path.turn[targets.motion] > _TURNS)
    frame = np.where(turning & wrench.any(axis=1), frame, BASE)
    out = wrench.copy()
    for code in (TOOL, FEED):
        rows = np.flatnonzero(frame == code)
        axes = targets.pose[rows, :3, :3]
        if code == FEED:
            axes, found = across(axes, arrive[rows], axis)
            frame[rows[~found]] = BASE
            rows, axes = rows[found], axes[found]
        for half in (slice(0, 3), slice(3, 6)):
            out[rows, half] = np.einsum("nji,nj->ni", axes, wrench[rows, half])
    return TargetForces(out, frame)
