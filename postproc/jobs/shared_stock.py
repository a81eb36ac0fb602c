"""Programs of one run that cut the same material of one stock: each is computed from the whole stock.

The cuts are swept through a coarse map of the uncut stock. Two programs cut the same material where both lower a
column of the map. Programs whose tools lean from z of `$BASE` are not compared.

Imported only where a process is given: the models of cutting are loaded with it.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from postproc import machining
from postproc.cell import Cell
from postproc.dialects import registry
from postproc.errors import Issue, PostprocError
from postproc.frames import M_PER_MM, Array
from postproc.jobs.programs import Job
from postproc.jobs.started_program import read_with_start
from postproc.machining.estimate import stock_map
from postproc.machining.stock import remove
from postproc.machining.tool_path import AXIS_TOLERANCE, Directions, home_base, straight_segments, tool_states
from postproc.robot import RobotModel
from postproc.under_load import RobotInCell, segments_in_cell

_LEAST_CELL = 0.5e-3
"""Least width of the cells of the coarse map [m] (assumed)."""
_CELLS_ACROSS_TOOL = 16.0
"""Cells across the smallest tool (assumed)."""
_BATCH = 256
"""Number of segments that are removed together."""
_SHARED_SHARE = 0.02
"""Warn if two programs share this share of the smaller of their removed volumes (assumed): maps of cuts that only touch
have a few common cells along their rim."""


def shared_stock_issues(job: Job, robot: RobotModel, cell: Cell) -> list[Issue]:
    """Return a warning if other programs of the run cut material that a program cuts, from the same stock.

    Programs that cannot be read or swept are left out: their own conversion says why.
    """
    if job.process is None or not job.same_stock:
        return []
    setup = _Setup(robot, cell)
    own_cut = _cut(job, setup)
    if own_cut is None:
        return []
    shares = {}
    for other in job.same_stock:
        other_cut = _cut(other, setup)
        if other_cut is not None and (share := own_cut.shared_share(other_cut)) >= _SHARED_SHARE:
            shares[other.program.name] = share
    if not shares:
        return []
    names = ", ".join(f"{name} ({100 * share:.0f} %)" for name, share in shares.items())
    first = next(iter(shares))
    message = (
        f"cuts material that other programs of this run cut too: {names} of the smaller cut. Each program is computed "
        f"from the whole stock of {job.process.name}. For the one that runs later give the stock that the earlier one "
        f'leaves, in a process of its own, such as [stock] file = "{registry.program_name(Path(first))}.stock.glb"'
    )
    return [Issue("warning", "shared-stock", message, count=len(shares), subject=first)]


class _Cut(NamedTuple):
    """The material that a program cuts from the whole stock, by columns of a map.

    :param base: (4, 4) `$BASE` of the stock in the root.
    :param depth: (ny, nx) depth that is removed from each column [m].
    """

    base: Array
    depth: Array

    def shared_share(self, other: _Cut) -> float:
        """Return the volume that both programs cut as a share of the smaller of their volumes; 0 for other frames."""
        if self.depth.shape != other.depth.shape or not np.allclose(self.base, other.base, atol=1e-6):
            return 0.0
        smaller = min(float(self.depth.sum()), float(other.depth.sum()))
        return float(np.minimum(self.depth, other.depth).sum()) / smaller if smaller > 0.0 else 0.0


class _Setup:
    """Robot and cell of a run, compared by identity, so that cuts are computed once for each run."""

    def __init__(self, robot: RobotModel, cell: Cell) -> None:
        self.robot, self.cell = robot, cell

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Setup) and self.robot is other.robot and self.cell is other.cell

    def __hash__(self) -> int:
        return hash((id(self.robot), id(self.cell)))


def _cut(job: Job, setup: _Setup) -> _Cut | None:
    """Return the material that a program cuts from the uncut stock; None if it is not compared.

    It is not if it cannot be read or its tool cannot be swept through the stock.
    """
    if job.process is None:
        return None
    try:
        times = job.program.stat().st_mtime_ns, job.process.stat().st_mtime_ns
        return _cut_of_files(job.program, job.dialect, job.process, times, setup)
    except (PostprocError, OSError):
        return None


@lru_cache(maxsize=64)
def _cut_of_files(
    program_path: Path,
    dialect: str,
    process_path: Path,
    times: tuple[int, int],
    setup: _Setup,
) -> _Cut | None:
    """Return the material that a program cuts from the uncut stock; None if it is not compared.

    Forces that operations state need no sweep, and a map of heights shows no cuts of a tool that leans from Z.

    :param times: times of the last changes of both files: a changed file is read again.
    :raises PostprocError: the program or its process is unusable.
    """
    process = machining.load(process_path)
    program, cell = read_with_start(program_path, setup.robot, setup.cell, dialect)
    if process.material is None:
        return None
    path = segments_in_cell(program, RobotInCell.of(setup.robot, cell))
    directions = Directions.of(program, path, cell.tool.axis)
    is_upright = directions.is_within(np.array([0.0, 0.0, 1.0]), AXIS_TOLERANCE)
    if not is_upright[~program.motions.rapid].all():
        return None
    diameter = min(tool.diameter_mm for tool in process.tools.values()) * M_PER_MM
    width = max(diameter / _CELLS_ACROSS_TOOL, process.stock.cell, _LEAST_CELL)
    in_base = np.eye(4)  # the map is in `$BASE` of the stock
    material, _ = stock_map(process, in_base, width, None)
    uncut = material.high.copy()
    tools = tool_states(program, process)
    segments = straight_segments(program, path, tools, in_base, material.cell, directions=directions)
    segments = segments.take(np.flatnonzero(segments.cutting & ~segments.leans))
    tool = tools.tool[segments.motion]
    # segments from one tool change to the next
    tool_changes = [*np.flatnonzero(np.diff(tool, prepend=-1)).tolist(), len(tool)]
    for first, end in pairwise(tool_changes):
        cutter = process.cutter(tools.keys[tool[first]])
        for begin in range(first, end, _BATCH):
            rows = slice(begin, min(begin + _BATCH, end))
            remove(material, cutter, segments.begin[rows], segments.end[rows])
    return _Cut(program.bases[home_base(program)], uncut.astype(float) - material.high)
