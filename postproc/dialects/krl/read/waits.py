"""Where a program waits: WAIT SEC, WAIT FOR and HALT."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from postproc.dialects.krl.execution import Execution
from postproc.dialects.krl.language.routines import Routine
from postproc.dialects.krl.language.source import Source
from postproc.dialects.waits import krl_wait_time

_FIRST_CHARACTERS = frozenset("WwHh \t")
"""A line that waits begins with one of these: the word, or blanks before it."""


def waits(execution: Execution, routines: Iterable[Routine], waiting_calls: Iterable[int]) -> dict[int, float]:
    """Return the rows of the trace at which a program waits, ascending, and how long [s].

    NaN is a time that is not a number, or depends on a condition.

    :param routines: the routines whose lines may be in the trace.
    :param waiting_calls: rows of the trace that call a routine which waits and is not in the trace.
    """
    time_of_row = dict.fromkeys(waiting_calls, math.nan)
    for routine in routines:
        if routine.source not in execution.trace.sources:
            continue
        times = {line: time for line in routine.other_lines if (time := wait_time(routine.source, line)) != 0.0}
        lines = np.array(list(times), dtype=np.int64)
        rows, index = execution.rows_of(routine.source, lines)
        # a trace that is the file line by line has the routines that are not called too
        is_run = (rows >= execution.body.first) & (rows < execution.body.stop)
        if execution.may_run is not None:
            is_run &= execution.may_run[rows - 1]
        rows, index = rows[is_run], index[is_run]
        time_of_row |= {row: times[line] for row, line in zip(rows.tolist(), lines[index].tolist(), strict=True)}
    return dict(sorted(time_of_row.items()))


def wait_time(source: Source, line: int) -> float:
    """Return how long a line with code waits [s], see `waits.krl_wait_time`."""
    if source.text[source.starts.item(line - 1)] not in _FIRST_CHARACTERS:
        return 0.0  # decides most lines
    return krl_wait_time(source.text[slice(*source.code_span(line))])
