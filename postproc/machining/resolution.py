"""Passes whose contact with the material is few cells wide, so that the map of the stock must be finer there.

A first sweep gives for each motion the standard deviation of its force by the cells. A tool may rough and then finish
in one operation: cells are made finer from the first pass on that needs it, if the rest of the operation needs it too.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.machining.tool_path import ToolStates
from postproc.operations import operations
from postproc.program import Program

FINE_ENOUGH_SHARE = 0.05
"""Standard deviation of forces by the cells of the map that is enough, as a share of them,"""
TOO_COARSE_SHARE = 0.055
"""and beyond which cells are too wide."""
_MOST_FINE_CELLS = 12_000_000
"""Largest number of cells of a map that is made finer."""


class ThinPasses(Struct, frozen=True):
    """Passes of a tool whose contact is few cells wide.

    :param first: row of their first motion.
    :param tool: index in `ToolStates.keys`.
    :param share: standard deviation of their forces by the cells of the map, RMS, as a share of the forces.
    """

    first: int
    tool: int
    share: float


def thin_passes(program: Program, tools: ToolStates, cell_error_sums: Array) -> list[ThinPasses]:
    """Return the passes that need finer cells: for each operation and tool the first one, if any, in order.

    From that pass to the end of the operation the map has finer cells. A pass is a run of cutting motions between two
    rapid ones.

    :param cell_error_sums: (M, 2) for each motion, sums over its stations of squares of the standard deviation by the
        cells of the map, and of the force [N²].
    """
    cuts = ~program.motions.rapid
    pass_begins = np.flatnonzero(np.diff(cuts.astype(np.int8), prepend=0) > 0)
    if not len(pass_begins):
        return []
    sums = np.add.reduceat(cell_error_sums, pass_begins, axis=0)
    operation_begins = [operation.first for operation in operations(program, at_retracts=True)]
    changes = np.flatnonzero(np.diff(tools.tool[pass_begins])) + 1
    # blocks of passes end where an operation begins or the tool changes; a motion in a pass counts for the next pass
    blocks = np.unique([0, *np.searchsorted(pass_begins, operation_begins), *changes, len(pass_begins)]).tolist()
    passes = []
    for begin, end in pairwise(blocks):
        pass_share = _rms_shares(sums[begin:end])  # of each pass of the block
        # a finer map is used from a pass to the end of the block: that part as a whole must need it
        share_to_end = _rms_shares(np.cumsum(sums[begin:end][::-1], axis=0)[::-1])
        is_thin = np.flatnonzero((pass_share > TOO_COARSE_SHARE) & (share_to_end > TOO_COARSE_SHARE))
        if len(is_thin):
            row = int(is_thin[0])
            first = int(pass_begins[begin + row])
            passes.append(ThinPasses(first, int(tools.tool[first]), float(share_to_end[row])))
    return passes


def _rms_shares(sums: Array) -> Array:
    """Return RMS deviations as shares of the forces (n,), from sums of squares of both (n, 2) [N²]."""
    # 1e-300 keeps zero out of the denominator
    return np.asarray(np.sqrt(sums[:, 0] / np.maximum(sums[:, 1], 1e-300)))


def cell_divisors(passes: list[ThinPasses], cell_count: int) -> dict[int, int]:
    """Return row of a motion → whole number, at least 2, by which the width of cells must be divided from there on.

    :param passes: passes whose contact is few cells wide.
    :param cell_count: number of cells of the map; divided maps have at most `_MOST_FINE_CELLS`.
    """
    max_factor = int(np.sqrt(_MOST_FINE_CELLS / cell_count))
    # the deviation falls with the width of a cell; a tenth more than enough is accepted
    factor_of_motion = {
        thin_pass.first: min(int(np.ceil(thin_pass.share / FINE_ENOUGH_SHARE - 0.1)), max_factor)
        for thin_pass in passes
    }
    return {first: factor for first, factor in factor_of_motion.items() if factor > 1}
