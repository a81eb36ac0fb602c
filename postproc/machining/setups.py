"""Set-ups of a program: motions that share a map of the stock, along one direction of the tool."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.errors import ForceError
from postproc.frames import Array
from postproc.machining.tool_path import AXIS_TOLERANCE, Directions
from postproc.program import Bools, Program

_CONE_STEPS = 60
"""Steps of the search for the middle of directions: the error of the middle falls with one over this (assumed)."""


class Setup(Struct, frozen=True, eq=False):
    """Motions with one height map of the stock.

    :param frame: (4, 4) frame of the map in the `$BASE` of the stock (`home_base`): z from the tip to the spindle.
    :param motions: (M,) True for the motions of the set-up.
    :param factor: number by which the width of the cells of the map is divided.
    """

    frame: Array
    motions: Bools
    factor: int = 1


def setups(program: Program, directions: Directions, max_tilt: float) -> list[Setup]:
    """Return the set-ups of a program in order: each has a height map of the stock along one direction of the tool.

    A set-up begins where a run of cuts has another direction of the tool. In a run in which the tool turns, one begins
    where the tool leaves a cone of half angle `max_tilt` about the direction of the map. Rapid motions belong to the
    set-up before them, as they move through the stock that it leaves.

    :param directions: directions of the tool on all motions.
    :param max_tilt: largest angle between a tool that turns while it cuts and the direction of the map [rad].
    :raises ForceError: no motion cuts, or the tool turns by more than twice `max_tilt` in one move.
    """
    cuts = directions.cuts
    if not cuts.any():
        raise ForceError("no cutting move in this program", file=program.documents[0].name)
    # begin and end (exclusive) of each run of cutting motions
    ranges_of_cuts = np.flatnonzero(np.diff(cuts.astype(np.int8), prepend=0, append=0)).reshape(-1, 2).tolist()
    map_directions: list[Array] = []
    starts: list[int] = []
    for begin, end in ranges_of_cuts:
        first_direction = directions.end[begin]
        if (directions.of_range(begin, end) @ first_direction > np.cos(AXIS_TOLERANCE)).all():
            if not map_directions or first_direction @ map_directions[-1] < np.cos(AXIS_TOLERANCE):
                map_directions.append(first_direction)
                starts.append(begin)
            continue
        while begin < end:
            row = begin
            if map_directions:
                row = _first_row_outside(directions, begin, end, map_directions[-1], max_tilt)
            if row < end:
                map_directions.append(_cone_axis(program, directions, row, max_tilt))
                starts.append(row)
            begin = row
    # set-ups begin at `starts`, which ascend; motions before the first start belong to the first set-up
    setup_number = np.searchsorted(starts[1:], np.arange(len(cuts)), side="right")
    return [Setup(_frame(direction), np.asarray(setup_number == k)) for k, direction in enumerate(map_directions)]


def _first_row_outside(directions: Directions, begin: int, end: int, map_direction: Array, max_tilt: float) -> int:
    """Return the first motion from row `begin` on whose tool leaves a cone about a direction; `end` if none does.

    :param end: row after the last motion of a run of cuts.
    :param map_direction: (3,) unit axis of the cone, and `max_tilt` its half angle [rad].
    """
    row = begin
    while row < end and (directions.of_range(row, row + 1) @ map_direction > np.cos(max_tilt)).all():
        row += 1
    return row


def divide_by_cells(ordered_setups: list[Setup], cell_factors: dict[int, int], cuts: Bools) -> list[Setup]:
    """Return set-ups divided where the cells of their height map become finer; a part without cuts joins the next.

    A set-up is a range of motions that share a height map of the stock.

    :param cell_factors: row of a motion → whole number by which the width of cells is divided from there to the end of
        its set-up; a later smaller number has no effect.
    :param cuts: (M,) True for cutting motions.
    """
    divided_setups = []
    for setup in ordered_setups:
        rows = np.flatnonzero(setup.motions)
        change_rows = [row for row in sorted(cell_factors) if setup.motions[row]]
        begin, factor, motion_rows = int(rows[0]), 1, np.arange(len(setup.motions))
        for end in [*change_rows, int(rows[-1]) + 1]:
            if cuts[begin:end].any():
                is_part = np.asarray((motion_rows >= begin) & (motion_rows < end))
                divided_setups.append(Setup(setup.frame, is_part, factor))
                begin = end
            factor = max(factor, cell_factors.get(end, 1))
    return divided_setups


def _cone_axis(program: Program, directions: Directions, begin: int, max_tilt: float) -> Array:
    """Return the unit axis (3,) of a cone that contains the directions of the tool on cutting motions from `begin` on.

    The number of motions is halved until a cone of the half angle `max_tilt` [rad] contains their directions. The axis
    is the centre of the smallest ball about them (Badoiu and Clarkson, "Smaller core-sets for balls", SODA 2003).

    :raises ForceError: not even the directions of the first motion are in such a cone.
    """
    count = len(directions.end) - begin
    while True:
        tool_axes = directions.of_range(begin, begin + count)
        cone_axis = tool_axes.sum(axis=0)
        for step in range(_CONE_STEPS):
            cone_axis /= max(float(np.linalg.norm(cone_axis)), 1e-12)
            farthest_axis = tool_axes[int(np.argmin(tool_axes @ cone_axis))]
            # the step towards the farthest point is 1 / (number of the step + 1)
            cone_axis = cone_axis + (farthest_axis - cone_axis) / (step + 2)
        cone_axis /= max(float(np.linalg.norm(cone_axis)), 1e-12)
        if float((tool_axes @ cone_axis).min()) > np.cos(max_tilt):
            return np.asarray(cone_axis)
        if count == 1:
            problem = f"the tool turns by more than {2 * np.degrees(max_tilt):.0f}° in one cutting move"
            line = int(program.motions.line[begin])
            raise ForceError(problem, file=program.documents[0].name, line=line, advice="Divide the move.")
        count = (count + 1) // 2


def _frame(direction: Array) -> Array:
    """Return the frame of the height map (4, 4) in `$BASE` whose z is a direction (3,) from the tip to the spindle.

    Its origin is that of `$BASE`; for z of `$BASE` the frame is `$BASE` itself.
    """
    frame = np.eye(4)
    if direction[2] < 1.0 - 1e-9:  # else it is z of $BASE, but for rounding
        # a coordinate axis that is not near the direction: the cross product must not vanish
        x = np.array([1.0, 0.0, 0.0]) if abs(direction[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        y = np.cross(direction, x)
        y /= np.linalg.norm(y)
        frame[:3, :3] = np.stack([np.cross(y, direction), y, direction], axis=-1)
    return frame
