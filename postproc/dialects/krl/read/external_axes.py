"""External axes: E1 as the linear axis that carries the robot; all others must not move."""

from __future__ import annotations

import numpy as np

from postproc.dialects.krl.language.positions import EXTERNAL
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.read.motion_columns import MotionColumns
from postproc.errors import Issue, ProgramError
from postproc.frames import M_PER_MM, Array
from postproc.program import PTP, Bools, Carriage, Ints

_SAME = 1e-4
"""External axes that vary by less than this [mm, deg] do not move."""


def external_axes(
    source: Source, rows: MotionColumns, relative: Ints, placed: Bools, direction: Array | None, after: Ints | None
) -> tuple[list[Issue], Carriage | None]:
    """Return the issues about external axes, and the linear axis that carries the robot.

    :param relative: rows of relative targets, whose values are steps.
    :param placed: (R,) True for motions whose path depends on the robot root: all but PTP to axis angles.
    :param direction: (3,) of E1, if it carries the robot.
    :param after: (R,) the motion at whose end each begins, see `Program.after`.
    :raises ProgramError: another axis moves, or the position of E1 is not known.
    """
    external = rows.external
    if np.isnan(external).all():
        return [], None
    steps = np.zeros(external.shape)
    steps[relative] = np.nan_to_num(external[relative])
    external = external.copy()
    external[relative] = np.nan
    issues = []
    for axis, values in enumerate(external.T):
        if axis == 0 and direction is not None:
            continue
        given = np.flatnonzero(~np.isnan(values))
        stepping = np.flatnonzero(np.abs(steps[:, axis]) > _SAME)
        if len(stepping):
            raise _moves(source, axis, f"by {steps[stepping[0], axis]:g}", int(rows.line[stepping[0]]))
        moving = given[np.abs(values[given] - values[given[:1]]) > _SAME]
        if len(moving):
            change = f"from {values[given[0]]:g} to {values[moving[0]]:g}"
            raise _moves(source, axis, change, int(rows.line[moving[0]]))
        if len(given) and abs(values[given[0]]) > _SAME:
            issues.append(_fixed_axis(axis, values[given[0]], int(rows.line[given[0]]), len(given)))
    if direction is None or (np.isnan(external[:, 0]).all() and not steps[:, 0].any()):
        return issues, None
    begin, end = _along(external[:, 0], steps[:, 0], after)
    unknown = np.flatnonzero(np.isnan(end) & placed)
    if len(unknown):
        raise source.line_error(
            "the position of E1, which carries the robot, is not known here",
            int(rows.line[unknown[0]]),
            "Give E1 in this target, or in a PTP before it.",
        )
    taken = np.flatnonzero(np.isnan(begin) & ~np.isnan(end))
    if len(taken) and rows.kind[taken[0]] != PTP and (after is None or after[taken[0]] != taken[0]):
        issues.append(_start(float(end[taken[0]]), int(rows.line[taken[0]])))
    begin = np.where(np.isnan(begin), end, begin)
    return issues, Carriage(np.nan_to_num(begin) * M_PER_MM, np.nan_to_num(end) * M_PER_MM, direction)


def _along(given: Array, steps: Array, after: Ints | None) -> tuple[Array, Array]:
    """Return the positions of an axis (R,) at the start and at the end of each motion; NaN where not known.

    :param given: (R,) NaN where it is kept, or moves by a step (R,).
    """
    known = ~np.isnan(given)
    if after is None:
        last = np.maximum.accumulate(np.where(known, np.arange(len(given)), -1))
        moved = np.cumsum(steps)
        end = np.where(last < 0, np.nan, given[last] + moved - moved[last])
        return np.append([np.nan], end[:-1]), np.asarray(end)
    begin, end = np.full(len(given), np.nan), given.copy()
    for row, before in enumerate(after.tolist()):
        begin[row] = end[before] if 0 <= before < row else np.nan
        if not known[row]:
            end[row] = begin[row] + steps[row]
    return begin, end


def _moves(source: Source, axis: int, change: str, line: int) -> ProgramError:
    name = EXTERNAL[axis]
    advice = "Only external axes that do not move are supported."
    if axis == 0:
        advice = (
            "If it is a linear axis that carries the robot, say in the cell where the robot goes for positive values, "
            "in its root: [external_axes.E1] direction = [0, 1, 0]. Others must not move."
        )
    return source.line_error(f"the external axis {name} moves {change}", line, advice)


def _fixed_axis(axis: int, value: float, line: int, count: int) -> Issue:
    name = EXTERNAL[axis]
    more = " (E1: or the cell must say where it goes, [external_axes.E1])" if axis == 0 else ""
    message = (
        f"{name} is at {value:g}: $BASE is taken as seen from the robot there. If {name} carries the robot or the "
        f"part, [base] of the cell must be that of this place{more}."
    )
    return Issue("warning", "external-axis", message, line, count=count, subject=name)


def _start(value: float, line: int) -> Issue:
    message = (
        f"The position of E1 before this line is not given: this motion is taken to begin with E1 at {value:g}. "
        "Give E1 in a PTP before it."
    )
    return Issue("warning", "external-axis", message, line, subject="E1")
