"""Passes whose contact with the material is few cells wide, so that the map of the stock must be finer there.

A first sweep gives for each motion the standard deviation of its force by the cells. A tool may rough and then finish
in one operation: cells are made finer from the first pass on that needs it, if the rest of the operation needs it too.
On steep surfaces and walls the cells must be fine from the start: a coarse map does not know where the surface was
before the pass, and finer cells cannot tell.
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
    :param is_steep: they need finer cells because of steep surfaces or walls.
    """

    first: int
    tool: int
    share: float
    is_steep: bool = False


def thin_passes(program: Program, tools: ToolStates, cell_error_sums: Array) -> list[ThinPasses]:
    """Return the passes that need finer cells: for each operation and tool the first one, if any, in order.

    From that pass to the end of the operation the map has finer cells. A pass is a run of cutting motions between two
    rapid ones.

    :param cell_error_sums: (M, 3) for each motion sums over its stations, see `Sweep.cell_error_sums` [N²].
    """
    cuts = ~program.motions.rapid
    pass_begins = np.flatnonzero(np.diff(cuts.astype(np.int8), prepend=0) > 0)
    if not len(pass_begins):
        return []
    squares, gentle_squares, force_squares = np.add.reduceat(cell_error_sums, pass_begins, axis=0).T
    operation_begins = [operation.first for operation in operations(program, at_retracts=True)]
    changes = np.flatnonzero(np.diff(tools.tool[pass_begins])) + 1
    # blocks of passes end where an operation begins or the tool changes; a motion in a pass counts for the next pass
    blocks = np.unique([0, *np.searchsorted(pass_begins, operation_begins), *changes, len(pass_begins)]).tolist()
    passes = []
    for begin, end in pairwise(blocks):
        block = slice(begin, end)
        pass_share = _rms_shares(squares[block], force_squares[block])  # of each pass of the block
        # a finer map is used from a pass to the end of the block: that part as a whole must need it
        share_to_end, gentle_share_to_end = (
            _rms_shares(_sums_to_end(values[block]), _sums_to_end(force_squares[block]))
            for values in (squares, gentle_squares)
        )
        is_thin = np.flatnonzero((pass_share > TOO_COARSE_SHARE) & (share_to_end > TOO_COARSE_SHARE))
        if len(is_thin):
            row = int(is_thin[0])
            first = int(pass_begins[begin + row])
            is_steep = bool(gentle_share_to_end[row] <= TOO_COARSE_SHARE)
            passes.append(ThinPasses(first, int(tools.tool[first]), float(share_to_end[row]), is_steep))
    return passes


def _sums_to_end(values: Array) -> Array:
    """Return the sum (n,) of each value and those after it."""
    return np.cumsum(values[::-1])[::-1]


def _rms_shares(squares: Array, force_squares: Array) -> Array:
    """Return RMS deviations as shares of the forces (n,), from sums of squares of both, (n,) each [N²]."""
    # 1e-300 keeps zero out of the denominator
    return np.asarray(np.sqrt(squares / np.maximum(force_squares, 1e-300)))


def cell_divisors(passes: list[ThinPasses], cell_count: int, setup_begins: list[int]) -> dict[int, int]:
    """Return row of a motion → whole number, at least 2, by which the width of cells must be divided from there on.

    :param passes: passes whose contact is few cells wide.
    :param setup_begins: first motions of the set-ups, ascending; for steep surfaces cells are fine from there on.
    :param cell_count: number of cells of the map; divided maps have at most `_MOST_FINE_CELLS`.
    """
    max_factor = int(np.sqrt(_MOST_FINE_CELLS / cell_count))
    # the deviation falls with the width of a cell; a tenth more than enough is accepted
    factor_of_motion: dict[int, int] = {}
    for thin_pass in passes:
        factor = min(int(np.ceil(thin_pass.share / FINE_ENOUGH_SHARE - 0.1)), max_factor)
        first = thin_pass.first
        if thin_pass.is_steep:
            first = max(begin for begin in setup_begins if begin <= first)
        if factor > 1:
            factor_of_motion[first] = max(factor, factor_of_motion.get(first, 1))
    return factor_of_motion
