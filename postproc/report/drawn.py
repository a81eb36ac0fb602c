"""The nominal path as a line to be drawn: arcs are arcs, not the chords between targets."""

from __future__ import annotations

import numpy as np

from postproc.frames import Array, rotation_from_vector
from postproc.pipeline import Result
from postproc.program import CIRC, Ints

_STEP = np.radians(10.0)


def drawn_path(result: Result) -> tuple[Array, Ints]:
    """Return points along the nominal path, and which target each leads to.

    :returns: positions (P, 3) [m] in `$BASE`, or in the robot root if the program has more than one base; and the row
        (P,) of the target at the end of the piece that the point lies on. Each target is the last of its points.
    """
    moved = result.program.motions
    end = result.nominal[:, :3, 3]
    row = np.arange(len(result))
    arcs = np.flatnonzero(moved.kind[result.motion] == CIRC)
    if len(arcs):
        motion = result.motion[arcs]
        same = (arcs > 0) & (result.motion[arcs - 1] == motion)
        begin = np.where(same, result.t[arcs - 1], 0.0)
        angle = moved.sweep[motion] * (result.t[arcs] - begin)
        count = np.ones(len(result), dtype=np.int64)
        count[arcs] = np.maximum(np.ceil(angle / _STEP), 1.0).astype(np.int64)
        row = np.repeat(row, count)
        left = 1.0 - (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[row]
        angles = np.zeros(len(result))
        angles[arcs] = angle
        back = np.flatnonzero(left > 0.0)
        target = row[back]
        normal, centre = moved.normal[result.motion[target]], moved.centre[result.motion[target]]
        turn = rotation_from_vector(-(angles[target] * left[back])[:, None] * normal)
        spoke = np.einsum("nij,nj->ni", turn, end[target] - centre)
        before = end[np.maximum(target - 1, 0)]
        rise = np.einsum("ni,ni->n", end[target] - before, normal) * left[back] * (target > 0)
        end = end[row]
        end[back] = centre + spoke - rise[:, None] * normal
    bases = result.program.bases
    if len(bases) > 1:
        base = bases[moved.base[result.motion[row]]]
        end = np.einsum("nij,nj->ni", base[:, :3, :3], end) + base[:, :3, 3]
    return np.asarray(end), row
