"""What a reader of a KRL program should know: what was assumed, and about which names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from postproc.dialects.krl.layout import Layout
from postproc.dialects.krl.read.main_routine import MainRoutine
from postproc.dialects.krl.read.motion_columns import MotionColumns
from postproc.dialects.krl.read.state import State
from postproc.errors import Issue
from postproc.program import Ints

_MOST_NAMES = 10
"""So many names of points are told in one message."""


def issues_of(
    main: MainRoutine, states: Sequence[State], state: Ints, rows: MotionColumns, layout: Layout
) -> Iterator[Issue]:
    """Yield what was assumed of a program.

    :param states: all that is in force anywhere; `state` (M,) which of them at each motion.
    """
    yield from _absent(main)
    yield from _uncalled(main)
    yield from _initial_frames(main, states, state, rows, layout)


def _absent(main: MainRoutine) -> Iterator[Issue]:
    """Each called program that is in no file, and what it is trusted not to do."""
    shared = sorted(main.run.variables.used & main.run.variables.public)
    more = "" if len(shared) <= _MOST_NAMES else f" and {len(shared) - _MOST_NAMES} more"
    points = f", nor the GLOBAL {', '.join(shared[:_MOST_NAMES])}{more}" if shared else ""
    for name, line in main.run.absent:
        fault = main.run.library.faults.get(name.upper())
        where = f"stands in a file that cannot be read ({fault})" if fault else "is in no file that was searched"
        message = (
            f"{name}() {where}: it is assumed not to move the robot nor to change $BASE, $TOOL, speeds{points}. "
            "Put its .src beside the program, or name its folder in the cell: [krl] search."
        )
        yield Issue("warning", "external-call", message, line, subject=name.upper())


def _uncalled(main: MainRoutine) -> Iterator[Issue]:
    """Routines of the program with motions that it does not call."""
    program = main.run.library.program
    for routine in program.routines.values():
        if routine is main.run.routine or routine in main.run.reached:
            continue
        motion = main.run.analysis.of(program, routine).motion
        if motion is None or motion.source is not main.run.source:
            continue
        if not routine.first < motion.line < routine.last:
            continue  # told for the routine in which it stands
        message = (
            f"DEF {routine.name} has motions but {main.run.routine.name} does not call it; they are left as they are."
        )
        yield Issue("warning", "uncalled-motions", message, motion.line, subject=routine.name)


def _initial_frames(
    main: MainRoutine, states: Sequence[State], state: Ints, rows: MotionColumns, layout: Layout
) -> Iterator[Issue]:
    """Frames that are the cell's only because the program leaves them as BAS(#INITMOV,0) sets them."""
    axis = np.zeros(len(rows), dtype=np.bool_)
    axis[[row for row, move in layout.statements.items() if move.end.position.axis]] = True
    for name, table in (("$BASE", "[base]"), ("$TOOL", "[tool]")):
        assumed = np.array([name in main.run.settings.assumed_frames(one, main.run.source) for one in states])
        found = np.flatnonzero(assumed[state] & ~axis)
        if not len(found):
            continue
        real = "BASE(0), that is $ROBROOT" if name == "$BASE" else "TOOL_DATA[1]"
        message = (
            f"{name} is never set behind BAS(#INITMOV,0): {table} of the cell is assumed, but KUKA's BAS makes it "
            f'{real}. Say in the cell which is meant: [krl] initmov = "cell" or "bas".'
        )
        yield Issue(
            "warning",
            "initial-frames",
            message,
            int(main.run.source.shown(rows.line[found])[0]),
            subject=name,
            count=len(found),
        )
