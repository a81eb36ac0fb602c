"""Where the map of the stock must be finer: passes whose contact with the material is few cells wide.

A first sweep gives for each motion the standard deviation of its force by the cells. A tool may rough and then finish:
so the passes of an operation are judged from the first one on from which all that follow in it need finer cells.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.machining.tool_path import ToolStates
from postproc.operations import operations
from postproc.program import Program

ENOUGH = 0.05
"""Standard deviation of forces by the cells of the map that is enough, as a share of them,"""
COARSE = 0.055
"""and beyond which cells are too wide."""
_MOST_FINE = 12_000_000
"""Cells of a map that is made finer."""


class ThinPasses(Struct, frozen=True):
    """Passes of a tool whose contact is few cells wide.

    :param first: row of their first motion.
    :param tool: index in `ToolStates.keys`.
    :param share: standard deviation of their forces by the cells of the map, RMS, as a share of the forces.
    """

    first: int
    tool: int
    share: float


def thin_passes(program: Program, tools: ToolStates, by_cells: Array) -> list[ThinPasses]:
    """Return the passes of each operation that need finer cells, in order.

    :param by_cells: (M, 2) sums of squares of deviations and forces on each motion [N²], see `Sweep`.
    """
    cuts = ~program.motions.rapid
    pass_begins = np.flatnonzero(np.diff(cuts.astype(np.int8), prepend=0) > 0)
    if not len(pass_begins):
        return []
    sums = np.add.reduceat(by_cells, pass_begins, axis=0)
    operation_begins = [operation.first for operation in operations(program, at_retracts=True)]
    changes = np.flatnonzero(np.diff(tools.tool[pass_begins])) + 1
    blocks = np.unique([0, *np.searchsorted(pass_begins, operation_begins), *changes, len(pass_begins)]).tolist()
    passes = []
    for begin, end in pairwise(blocks):
        pass_share = _rms_shares(sums[begin:end])
        # a finer map holds from a pass to the end of the block: it must be worth it for all of that
        share_to_end = _rms_shares(np.cumsum(sums[begin:end][::-1], axis=0)[::-1])
        is_thin = np.flatnonzero((pass_share > COARSE) & (share_to_end > COARSE))
        if len(is_thin):
            row = int(is_thin[0])
            first = int(pass_begins[begin + row])
            passes.append(ThinPasses(first, int(tools.tool[first]), float(share_to_end[row])))
    return passes


def _rms_shares(sums: Array) -> Array:
    """Return RMS deviations as shares of the forces (n,), from sums of squares of both (n, 2) [N²]."""
    # 1e-300 keeps zero out of the denominator
    return np.asarray(np.sqrt(sums[:, 0] / np.maximum(sums[:, 1], 1e-300)))


def factors(passes: list[ThinPasses], cells: int) -> dict[int, int]:
    """Return by which whole number cells must be divided from a motion on, by motion; at least 2.

    :param cells: number of cells of the map; divided maps have at most `_MOST_FINE`.
    """
    max_factor = int(np.sqrt(_MOST_FINE / cells))
    factor_of_motion = {
        passes_of_tool.first: min(int(np.ceil(passes_of_tool.share / ENOUGH - 0.1)), max_factor)
        for passes_of_tool in passes
    }
    return {first: factor for first, factor in factor_of_motion.items() if factor > 1}
