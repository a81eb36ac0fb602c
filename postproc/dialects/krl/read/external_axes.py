"""External axes: E1 as the linear axis that carries the robot; all others must not move."""

from __future__ import annotations

import numpy as np

from postproc.dialects.krl.language.positions import EXTERNAL
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.read.motion_columns import MotionColumns
from postproc.errors import Issue, ProgramError
from postproc.frames import M_PER_MM, Array
from postproc.program import PTP, Bools, Carriage, Ints

_AXIS_TOLERANCE = 1e-4
"""External axes that vary by less than this [mm, deg] do not move; values closer to 0 than this are 0."""


def external_axes(
    trace: Trace,
    columns: MotionColumns,
    relative_rows: Ints,
    uses_root: Bools,
    direction: Array | None,
    predecessors: Ints | None,
) -> tuple[list[Issue], Carriage | None]:
    """Return the issues about external axes, and the linear axis that carries the robot, None if there is none.

    :param columns: the R motions.
    :param relative_rows: (n,) rows of motions with relative targets, whose values are steps.
    :param uses_root: (R,) True for motions whose path depends on the robot root: all but PTP to axis angles.
    :param direction: (3,) unit vector of E1 in the robot root, if it carries the robot; else None.
    :param predecessors: (R,) the motion at whose end each begins, see `Program.after`; None: the motion before it.
    :raises ProgramError: an axis moves that does not carry the robot, or the position of E1, which does, is not known.
    """
    external = columns.external
    if np.isnan(external).all():
        return [], None
    # steps of relative targets, and positions at the other targets
    steps = np.zeros(external.shape)
    steps[relative_rows] = np.nan_to_num(external[relative_rows])
    external = external.copy()
    external[relative_rows] = np.nan
    issues = _fixed_axis_warnings(trace, external, steps, columns.trace_row, carries_robot=direction is not None)
    if direction is None or (np.isnan(external[:, 0]).all() and not steps[:, 0].any()):
        return issues, None
    begin, end = _axis_positions(external[:, 0], steps[:, 0], predecessors)
    unknown_rows = np.flatnonzero(np.isnan(end) & uses_root)
    if len(unknown_rows):
        raise trace.error(
            "the position of E1, which carries the robot, is not known here",
            int(columns.trace_row[unknown_rows[0]]),
            "Give E1 in this target, or in a PTP before it.",
        )
    assumed_starts = np.flatnonzero(np.isnan(begin) & ~np.isnan(end))
    if len(assumed_starts):
        motion = assumed_starts[0]
        # the motion is its own predecessor if its start is not known: a warning says so already
        has_open_start = predecessors is not None and predecessors[motion] == motion
        if columns.kind[motion] != PTP and not has_open_start:
            reported_line = trace.reported_line(int(columns.trace_row[motion]))
            issues.append(_assumed_start_warning(float(end[motion]), reported_line))
    begin = np.where(np.isnan(begin), end, begin)
    return issues, Carriage(np.nan_to_num(begin) * M_PER_MM, np.nan_to_num(end) * M_PER_MM, direction)


def _fixed_axis_warnings(
    trace: Trace, external: Array, steps: Array, trace_row: Ints, *, carries_robot: bool
) -> list[Issue]:
    """Return the warnings on external axes that do not move, but are not at 0.

    :param external: (R, 6) positions of the axes at targets [mm, deg], NaN where not given.
    :param steps: (R, 6) steps of the axes in relative targets [mm, deg]; 0 for other targets.
    :param trace_row: (R,) rows of the trace with the motions.
    :param carries_robot: True if E1 carries the robot; it may move then and is left out.
    :raises ProgramError: an axis moves.
    """
    issues = []
    for axis, values in enumerate(external.T):
        if axis == 0 and carries_robot:
            continue
        given_rows = np.flatnonzero(~np.isnan(values))
        step_rows = np.flatnonzero(np.abs(steps[:, axis]) > _AXIS_TOLERANCE)
        if len(step_rows):
            raise _motion_error(trace, axis, f"by {steps[step_rows[0], axis]:g}", int(trace_row[step_rows[0]]))
        moved_rows = given_rows[np.abs(values[given_rows] - values[given_rows[:1]]) > _AXIS_TOLERANCE]
        if len(moved_rows):
            change = f"from {values[given_rows[0]]:g} to {values[moved_rows[0]]:g}"
            raise _motion_error(trace, axis, change, int(trace_row[moved_rows[0]]))
        if len(given_rows) and abs(values[given_rows[0]]) > _AXIS_TOLERANCE:
            reported_line = trace.reported_line(int(trace_row[given_rows[0]]))
            issues.append(_fixed_axis_warning(axis, values[given_rows[0]], reported_line, len(given_rows)))
    return issues


def _axis_positions(positions: Array, steps: Array, predecessors: Ints | None) -> tuple[Array, Array]:
    """Return the positions of an axis at the start (R,) and at the end (R,) of each motion; NaN where not known.

    :param positions: (R,) positions at targets; NaN where the axis keeps its position or moves by a step.
    :param steps: (R,) steps of relative targets, else 0.
    :param predecessors: (R,) the motion at whose end each begins, −1 for the start of the program, the motion itself if
        its start is not known; None: the motion before it.
    """
    is_given = ~np.isnan(positions)
    if predecessors is None:
        # row of the latest given position; −1 before the first
        given_row = np.maximum.accumulate(np.where(is_given, np.arange(len(positions)), -1))
        travel = np.cumsum(steps)  # its differences are the steps between two motions
        end = np.where(given_row < 0, np.nan, positions[given_row] + travel - travel[given_row])
        return np.append([np.nan], end[:-1]), np.asarray(end)
    begin, end = np.full(len(positions), np.nan), positions.copy()
    for row, previous_row in enumerate(predecessors.tolist()):
        begin[row] = end[previous_row] if 0 <= previous_row < row else np.nan
        if not is_given[row]:
            end[row] = begin[row] + steps[row]
    return begin, end


def _motion_error(trace: Trace, axis: int, change: str, trace_row: int) -> ProgramError:
    """Return the error that an external axis moves.

    :param axis: 0 for E1 … 5 for E6.
    :param change: text of the message behind "moves": from which value to which, or by which step.
    """
    name = EXTERNAL[axis]
    advice = "Only external axes that do not move are supported."
    if axis == 0:
        advice = (
            "If it is a linear axis that carries the robot, say in the cell where the robot goes for positive values, "
            "in its root: [external_axes.E1] direction = [0, 1, 0]. Others must not move."
        )
    return trace.error(f"the external axis {name} moves {change}", trace_row, advice)


def _fixed_axis_warning(axis: int, value: float, line: int, count: int) -> Issue:
    """Return the warning on an external axis that does not move, but is not at 0.

    :param axis: 0 for E1 … 5 for E6.
    :param value: position of the axis [mm or deg].
    :param line: line of the `.src` to report: of the first motion that gives the position.
    :param count: number of motions that give it.
    """
    name = EXTERNAL[axis]
    suffix = " (E1: or the cell must say where it goes, [external_axes.E1])" if axis == 0 else ""
    message = (
        f"{name} is at {value:g}: $BASE is taken as seen from the robot there. If {name} carries the robot or the "
        f"part, [base] of the cell must be that of this place{suffix}."
    )
    return Issue("warning", "external-axis", message, line, count=count, subject=name)


def _assumed_start_warning(value: float, line: int) -> Issue:
    """Return the warning that a motion is assumed to begin with E1 at a value [mm or deg]."""
    message = (
        f"The position of E1 before this line is not given: this motion is taken to begin with E1 at {value:g}. "
        "Give E1 in a PTP before it."
    )
    return Issue("warning", "external-axis", message, line, subject="E1")
