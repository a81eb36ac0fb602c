"""Branches of a program whose condition only the running robot knows, and the stock that they leave.

The stock is cut by all motions in the order of the text. On the robot one branch runs, so that what another branch
removed is still there: for the branches after it, and for what follows them.
"""

from __future__ import annotations

import numpy as np

from postproc.errors import ForceError
from postproc.machining.tool_path import StraightSegments
from postproc.program import Bools, Ints, Program

_ADVICE = (
    "Say in [krl.values] of the cell what the condition asks, and convert once for each case; or give the forces by "
    "force comments or a CSV file."
)


def check_branches(program: Program, cutting_rows: Ints, is_near: Bools) -> None:
    """Refuse a program in which a branch removes material and a later motion comes near the stock.

    The condition of the branch is known on the running robot only, so the stock after the branch is unknown.

    :param cutting_rows: (n,) rows of motions that remove material.
    :param is_near: (M,) motions that come near the stock as it is before the program.
    :raises ForceError: names the first cut of the branch, and the first motion near the stock after it.
    """
    removes_material = np.zeros(len(program.motions), dtype=bool)
    removes_material[cutting_rows] = True
    for first, end in program.branches:  # rows of the motions of a branch; `end` is exclusive
        later_rows = np.flatnonzero(is_near[end:])
        if removes_material[first:end].any() and len(later_rows):
            first_cut = first + np.argmax(removes_material[first:end])
            source_lines = program.places(np.array([first_cut, end + later_rows[0]]))
            (file, line), (later_file, later_line) = source_lines.of(0), source_lines.of(1)
            later_place = f"line {later_line}" if later_file == file else f"{later_file}:{later_line}"
            problem = (
                "whether this motion cuts is decided while the robot runs, by the condition of its branch, so that "
                f"the stock on {later_place} is not known"
            )
            raise ForceError(problem, file=file, line=line, advice=_ADVICE)


def near_stock(segments: StraightSegments, bounds: tuple[float, ...], margin: float, count: int) -> Bools:
    """Return True for motions (count,) with a segment within `margin` of the stock in x and y, and below its top.

    :param segments: segments of all motions, in the frame of the height map of the stock.
    :param bounds: smallest and largest x, smallest and largest y, and top of the stock [m].
    :param margin: radius of the widest tool [m].
    :param count: number of motions of the program.
    """
    low, high = np.minimum(segments.begin, segments.end), np.maximum(segments.begin, segments.end)
    x_low, x_high, y_low, y_high, top = bounds
    is_near_segment = (high[:, 0] > x_low - margin) & (low[:, 0] < x_high + margin)
    is_near_segment &= (high[:, 1] > y_low - margin) & (low[:, 1] < y_high + margin) & (low[:, 2] < top)
    is_near_motion = np.zeros(count, dtype=bool)
    is_near_motion[segments.motion[is_near_segment]] = True
    return is_near_motion
