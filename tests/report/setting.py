"""Results with made-up paths and deviations for tests of the surface."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc.poses import Poses
from postproc.program import LIN
from tests import fabricated


def result_of(points, deviation, rapid=None, after=0.01, **changes):
    """A program through points (K, 3) [m], tool upright, with these deviations before; after is a share of them."""
    count = len(points)
    base = fabricated.result(count)
    pose = np.tile(np.diag([-1.0, 1.0, -1.0, 1.0]), (count, 1, 1))
    pose[:, :3, 3] = points
    rapid = np.arange(count) == 0 if rapid is None else rapid
    motions = replace(base.program.motions, kind=np.full(count, LIN), rapid=rapid, target=Poses.of(pose))
    deviation = np.broadcast_to(deviation, (count, 3))
    return fabricated.with_changes(
        base,
        program=replace(base.program, motions=motions),
        nominal=Poses.of(pose),
        deviation_before=deviation,
        deviation_after=after * deviation,
        bound=np.full(count, 2e-5),
        **changes,
    )
