"""Passes whose contact with the material is few cells wide, so that the map of the stock must be finer there.

A first sweep gives for each motion the standard deviation of its force by the cells. Cells are finer only where that
matters: where it is a large part of the force, adds to the deviation by the material, and moves a robot at all. A tool
may rough and then finish in one operation: cells are made finer from the first pass on that needs it, if the rest of
the operation needs it too. On steep surfaces and walls the cells must be fine from the start: a coarse map does not
know where the surface was before the pass, and finer cells cannot tell.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.machining.cutting import Loads
from postproc.machining.tool_path import ToolStates
from postproc.operations import operations
from postproc.program import Program

_ACCEPTED_SHARE = 0.05
"""Standard deviation of a force by the cells of the map that is accepted, as a share of the force,"""
_ACCEPTED_SHARE_OF_MATERIAL = 0.2
"""as a share of the standard deviation by the material: both together are 2 % larger than the latter,"""
_ACCEPTED_FORCE = 2.0
"""and in N, as it moves the tip of a robot by 1 to 4 µm (0.5 to 2 µm/N): cells are fine enough if one of them holds."""
_TOLERANCE = 1.1
"""Cells are made finer where the deviation is larger than the accepted one by this factor."""
_MOST_FINE_CELLS = 12_000_000
"""Largest number of cells of a map that is made finer."""


class ThinPasses(Struct, frozen=True):
    """Passes of a tool whose contact with the stock is few cells of its height map wide.

    A pass is a run of cutting motions between two rapid ones.

    :param first: row of their first motion.
    :param tool: index in `ToolStates.keys`.
    :param force_share: standard deviation of their forces by the cells of the map, RMS, as a share of the forces.
    :param excess: that deviation over the accepted one: cells of the width divided by this number are fine enough.
    :param is_steep: they need finer cells because of steep surfaces or walls.
    """

    first: int
    tool: int
    force_share: float
    excess: float
    is_steep: bool = False


class CellErrors(NamedTuple):
    """Squares of forces at n stations, or their sums over the stations of M motions [N²].

    :param error: of the standard deviation by the cells of the height map.
    :param gentle_error: of the part of it by surfaces that are not steep.
    :param accepted: of the standard deviation by the cells that is accepted.
    :param force: of the force.
    """

    error: Array
    gentle_error: Array
    accepted: Array
    force: Array

    @classmethod
    def of(cls, loads: Loads, material_sigma: float) -> CellErrors:
        """Return the squares at the stations of `loads`.

        :param material_sigma: standard deviation of the forces by the material, as a share of them, as far as
            `Loads.deviation` does not have it.
        """
        force = np.square(loads.wrench[:, :3]).sum(axis=1)
        error, gentle_error = (np.square(share) * force for share in (loads.cell_error_share, loads.gentle_error_share))
        by_material = np.square(loads.deviation[:, :3]).sum(axis=1) - error + material_sigma**2 * force
        accepted = np.maximum(_ACCEPTED_SHARE**2 * force, _ACCEPTED_SHARE_OF_MATERIAL**2 * by_material)
        # stations in air must not add to what their pass may have
        accepted = np.where(force > 0.0, np.maximum(accepted, _ACCEPTED_FORCE**2), 0.0)
        return cls(error, gentle_error, accepted, force)


def thin_passes(program: Program, tools: ToolStates, sums: CellErrors) -> list[ThinPasses]:
    """Return the passes that need finer cells of the height map: the first one of each operation and tool, in order.

    From that pass to the end of the operation the map has finer cells. A pass is a run of cutting motions between two
    rapid ones.

    :param sums: sums (M,) over the stations of each motion.
    """
    cuts = ~program.motions.rapid
    pass_begins = np.flatnonzero(np.diff(cuts.astype(np.int8), prepend=0) > 0)
    if not len(pass_begins):
        return []
    sums_of_pass = CellErrors(*(np.add.reduceat(column, pass_begins) for column in sums))
    operation_begins = [operation.first for operation in operations(program, at_retracts=True)]
    changes = np.flatnonzero(np.diff(tools.tool[pass_begins])) + 1
    # blocks of passes end where an operation begins or the tool changes; a motion in a pass counts for the next pass
    blocks = np.unique([0, *np.searchsorted(pass_begins, operation_begins), *changes, len(pass_begins)]).tolist()
    passes = []
    for begin, end in pairwise(blocks):
        of_pass = CellErrors(*(column[begin:end] for column in sums_of_pass))
        # a finer map is used from a pass to the end of the block: that part as a whole must need it
        to_end = CellErrors(*(_sums_to_end(column) for column in of_pass))
        excess = _rms_ratio(to_end.error, to_end.accepted)
        is_thin = np.minimum(_rms_ratio(of_pass.error, of_pass.accepted), excess) > _TOLERANCE
        if is_thin.any():
            row = int(np.argmax(is_thin))
            first = int(pass_begins[begin + row])
            is_steep = bool(_rms_ratio(to_end.gentle_error, to_end.accepted)[row] <= _TOLERANCE)
            force_share = float(_rms_ratio(to_end.error, to_end.force)[row])
            passes.append(ThinPasses(first, int(tools.tool[first]), force_share, float(excess[row]), is_steep))
    return passes


def _sums_to_end(values: Array) -> Array:
    """Return the sum (n,) of each value and those after it."""
    return np.cumsum(values[::-1])[::-1]


def _rms_ratio(squares: Array, reference_squares: Array) -> Array:
    """Return the ratios (n,) of root mean squares of two quantities, from their sums of squares, (n,) each [N²]."""
    # 1e-300 keeps zero out of the denominator
    return np.asarray(np.sqrt(squares / np.maximum(reference_squares, 1e-300)))


def cell_divisors(passes: list[ThinPasses], cell_count: int, setup_begins: list[int]) -> dict[int, int]:
    """Return row of a motion → whole number, at least 2, by which the width of cells must be divided from there on.

    :param passes: passes whose contact is few cells wide.
    :param setup_begins: first motions of the set-ups, ascending; for steep surfaces cells are fine from there on.
    :param cell_count: number of cells of the height map; divided maps have at most `_MOST_FINE_CELLS`.
    """
    max_factor = int(np.sqrt(_MOST_FINE_CELLS / cell_count))
    # the deviation falls with the width of a cell; a tenth more than enough is accepted
    factor_of_motion: dict[int, int] = {}
    for thin_pass in passes:
        factor = min(int(np.ceil(thin_pass.excess - 0.1)), max_factor)
        first = thin_pass.first
        if thin_pass.is_steep:
            first = max(begin for begin in setup_begins if begin <= first)
        if factor > 1:
            factor_of_motion[first] = max(factor, factor_of_motion.get(first, 1))
    return factor_of_motion
