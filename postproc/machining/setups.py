"""Set-ups of a program: motions that share a map of the stock, along one direction of the tool."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.errors import ForceError
from postproc.frames import Array
from postproc.machining.tool_path import TURNS, Directions
from postproc.program import Bools, Program

_CONE_STEPS = 60
"""Steps of the search for the middle of directions: the error of the middle falls with one over this (assumed)."""


class Setup(Struct, frozen=True, eq=False):
    """Motions with one map of the stock.

    :param frame: (4, 4) frame of the map in the `$BASE` of the stock (`home_base`): z from the tip to the spindle.
    :param motions: (M,) True for those motions.
    :param factor: by which the cells of the map are divided.
    """

    frame: Array
    motions: Bools
    factor: int = 1


def setups(program: Program, directions: Directions, widest: float) -> list[Setup]:
    """Divide the program into set-ups in order: each has a map of the stock along one direction of the tool.

    Cuts with another direction of the tool begin a set-up; while the tool turns as it cuts, only if it leaves a cone
    about the direction of the map. Rapid motions between belong to the set-up before them: that is the stock through
    which they lead.

    :param widest: largest angle between a tool that turns while it cuts and the direction of the map [rad].
    :raises ForceError: the tool turns too far in one move.
    """
    cuts = directions.cuts
    if not cuts.any():
        raise ForceError("no cutting move in this program", file=program.documents[0].name)
    ranges_of_cuts = np.flatnonzero(np.diff(cuts.astype(np.int8), prepend=0, append=0)).reshape(-1, 2).tolist()
    map_directions: list[Array] = []
    starts: list[int] = []
    for begin, end in ranges_of_cuts:
        first_direction = directions.end[begin]
        if (directions.of_range(begin, end) @ first_direction > np.cos(TURNS)).all():
            if not map_directions or first_direction @ map_directions[-1] < np.cos(TURNS):
                map_directions.append(first_direction)
                starts.append(begin)
            continue
        while begin < end:
            row = begin
            while (
                map_directions
                and row < end
                and (directions.of_range(row, row + 1) @ map_directions[-1] > np.cos(widest)).all()
            ):
                row += 1
            if row < end:
                map_directions.append(_middle_of_cone(program, directions, row, widest))
                starts.append(row)
            begin = row
    setup_number = np.searchsorted(starts[1:], np.arange(len(cuts)), side="right")
    return [Setup(_frame(direction), np.asarray(setup_number == k)) for k, direction in enumerate(map_directions)]


def divide_by_cells(ordered_setups: list[Setup], cell_factors: dict[int, int], cuts: Bools) -> list[Setup]:
    """Divide set-ups where the cells of their map become finer; parts without a cut are not divided.

    :param cell_factors: by which whole number cells are divided from a motion on, to the end of its set-up at least.
    :param cuts: (M,) cutting motions.
    """
    divided_setups = []
    for setup in ordered_setups:
        rows = np.flatnonzero(setup.motions)
        first_motions = [end_row for end_row in sorted(cell_factors) if setup.motions[end_row]]
        begin, factor, motion_rows = int(rows[0]), 1, np.arange(len(setup.motions))
        for end_row in [*first_motions, int(rows[-1]) + 1]:
            if cuts[begin:end_row].any():
                divided_setups.append(
                    Setup(setup.frame, np.asarray((motion_rows >= begin) & (motion_rows < end_row)), factor)
                )
                begin = end_row
            factor = max(factor, cell_factors.get(end_row, 1))
    return divided_setups


def _middle_of_cone(program: Program, directions: Directions, begin: int, widest: float) -> Array:
    """Return the axis (3,) of a cone about the directions of as many cutting motions as one holds, from `begin` on.

    The number of motions is halved until a cone of the half angle `widest` [rad] holds them. The axis is the centre of
    the smallest ball about the directions (Badoiu and Clarkson 2003).

    :raises ForceError: there is none for the first of them.
    """
    count = len(directions.end) - begin
    while True:
        axes = directions.of_range(begin, begin + count)
        middle = axes.sum(axis=0)
        for step in range(_CONE_STEPS):
            middle /= max(float(np.linalg.norm(middle)), 1e-12)
            middle = middle + (axes[int(np.argmin(axes @ middle))] - middle) / (step + 2)
        middle /= max(float(np.linalg.norm(middle)), 1e-12)
        if float((axes @ middle).min()) > np.cos(widest):
            return np.asarray(middle)
        if count == 1:
            problem = f"the tool turns by more than {2 * np.degrees(widest):.0f}° in one cutting move"
            line = int(program.motions.line[begin])
            raise ForceError(problem, file=program.documents[0].name, line=line, advice="Divide the move.")
        count = (count + 1) // 2


def _frame(direction: Array) -> Array:
    """Return the frame of the map (4, 4) in `$BASE` whose z is a direction (3,) from the tip to the spindle."""
    frame = np.eye(4)
    if direction[2] < 1.0 - 1e-9:
        x = np.array([1.0, 0.0, 0.0]) if abs(direction[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        y = np.cross(direction, x)
        y /= np.linalg.norm(y)
        frame[:3, :3] = np.stack([np.cross(y, direction), y, direction], axis=-1)
    return frame
