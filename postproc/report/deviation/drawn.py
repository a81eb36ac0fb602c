"""The nominal path as a line to be drawn: arcs are arcs, not the chords between targets."""

from __future__ import annotations

import numpy as np

from postproc.correction import Result
from postproc.frames import Array, norm
from postproc.program import CIRC, Ints

_STEP = tuple(np.radians([10.0, 20.0]))
"""Smallest and largest angle of a chord that an arc is drawn by."""
_UNSEEN = 1.0 / 2000.0
"""Of the extent of the path, what a chord may leave the arc by."""


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
        normal, spoke = moved.normal[motion], end[arcs] - moved.centre[motion]
        height = np.einsum("ni,ni->n", spoke, normal)[:, None] * normal
        radial, across = spoke - height, np.cross(normal, spoke)
        axis = moved.centre[motion] + height
        before = end[np.maximum(arcs - 1, 0)]
        rise = (np.einsum("ni,ni->n", end[arcs] - before, normal) * (arcs > 0))[:, None] * normal
        unseen = _UNSEEN * float(np.ptp(end, axis=0).max())
        step = 2.0 * np.arccos(np.clip(1.0 - unseen / np.maximum(norm(radial), unseen), -1.0, 1.0))
        count = np.ones(len(result), dtype=np.int64)
        count[arcs] = np.maximum(np.ceil(angle / np.clip(step, *_STEP)), 1.0).astype(np.int64)
        row = np.repeat(row, count)
        left = 1.0 - (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[row]
        back = np.flatnonzero(left > 0.0)
        arc, left = np.searchsorted(arcs, row[back]), left[back]
        cos, sin = np.cos(angle[arc] * left)[:, None], np.sin(angle[arc] * left)[:, None]
        end = end[row]
        end[back] = axis[arc] + cos * radial[arc] - sin * across[arc] - left[:, None] * rise[arc]
    bases = result.program.bases
    if len(bases) > 1:
        base = bases[moved.base[result.motion[row]]]
        end = np.einsum("nij,nj->ni", base[:, :3, :3], end) + base[:, :3, 3]
    return np.asarray(end), row
