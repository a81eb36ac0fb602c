"""External axes: E1 where it carries the robot; all others must stand still."""

from __future__ import annotations

import numpy as np

from postproc.dialects.krl.language.positions import EXTERNAL
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.read.motion_columns import MotionColumns
from postproc.errors import Issue, ProgramError
from postproc.frames import M_PER_MM, Array
from postproc.program import Carriage, Ints

_SAME = 1e-4
"""External axes that vary by less than this [mm, deg] stand still."""


def external_axes(
    source: Source, rows: MotionColumns, relative: Ints, direction: Array | None
) -> tuple[list[Issue], Carriage | None]:
    """Return what to tell of external axes, and the one that carries the robot.

    :param relative: rows of relative targets, which say nothing of where the axes are.
    :param direction: (3,) of E1, if it carries the robot.
    :raises ProgramError: another axis moves.
    """
    external = rows.numbers[:, 8:]
    if np.isnan(external).all():
        return [], None
    external = external.copy()
    external[relative] = np.nan
    issues = []
    for axis, values in enumerate(external.T):
        given = np.flatnonzero(~np.isnan(values))
        if axis == 0 and direction is not None and len(given):
            continue
        moving = given[np.abs(values[given] - values[given[:1]]) > _SAME]
        if len(moving):
            raise _moves(source, axis, float(values[given[0]]), float(values[moving[0]]), int(rows.line[moving[0]]))
        if len(given) and abs(values[given[0]]) > _SAME:
            issues.append(_standing(axis, values[given[0]], int(rows.line[given[0]]), len(given)))
    if direction is None or np.isnan(external[:, 0]).all():
        return issues, None
    end = _kept(external[:, 0]) * M_PER_MM
    return issues, Carriage(np.append(end[:1], end[:-1]), end, direction)


def _moves(source: Source, axis: int, before: float, after: float, line: int) -> ProgramError:
    name = EXTERNAL[axis]
    advice = "Only external axes that stand still are supported."
    if axis == 0:
        advice = (
            "If it is a linear axis that carries the robot, say in the cell where the robot goes for positive values, "
            "in its root: [external_axes.E1] direction = [0, 1, 0]. Others must stand still."
        )
    return source.line_error(f"the external axis {name} moves from {before:g} to {after:g}", line, advice)


def _standing(axis: int, value: float, line: int, count: int) -> Issue:
    name = EXTERNAL[axis]
    more = " (E1: or the cell must say where it goes, [external_axes.E1])" if axis == 0 else ""
    message = (
        f"{name} stands at {value:g}: $BASE is taken as seen from the robot there. If {name} carries the robot or the "
        f"part, [base] of the cell must be that of this place{more}."
    )
    return Issue("warning", "external-axis", message, line, count=count, subject=name)


def _kept(values: Array) -> Array:
    """Return values (R,) with missing ones as the one before; those before the first as that."""
    given = ~np.isnan(values)
    place = np.maximum.accumulate(np.where(given, np.arange(len(values)), -1))
    return np.asarray(values[np.where(place < 0, int(np.argmax(given)), place)])
