"""Where a program waits: WAIT SEC, WAIT FOR and HALT."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

import numpy as np

from postproc.dialects.krl.course import Course
from postproc.dialects.krl.language.source import Source
from postproc.program import Event, Ints

_WAIT = re.compile(
    r"^[ \t]*(?:WAIT[ \t]+SEC\b(?P<time>[^;\r\n]*)|WAIT[ \t]+FOR\b(?P<condition>[^;\r\n]*)|HALT\b)",
    re.IGNORECASE | re.MULTILINE,
)


def waits(course: Course, motions: Ints, waiting_calls: Iterable[int]) -> tuple[Event, ...]:
    """Return the waits of a program in execution order, each as a dwell at the next motion.

    :param motions: (M,) lines of the motions in the trace.
    :param waiting_calls: rows of the trace that call a routine which waits and is not in the trace.
    :returns: their value is the time [s]; NaN if it is not a number, or depends on a condition.
    """
    time_of_row = dict.fromkeys(waiting_calls, math.nan)
    for source in course.trace.sources:
        matches = [match for match in _WAIT.finditer(source.text) if _time(match) != 0.0]
        lines = np.array([source.line_at(match.start()) for match in matches], dtype=np.int64)
        rows, index = course.rows_of(source, lines)
        if course.may_run is not None:
            is_run = course.may_run[rows - 1]
            rows, index = rows[is_run], index[is_run]
        time_of_row |= {row: _time(matches[k]) for row, k in zip(rows.tolist(), index.tolist(), strict=True)}
    return tuple(
        Event(
            before=int(np.searchsorted(motions, row)),
            kind="dwell",
            line=course.trace.shown_line(row),
            value=time_of_row[row],
        )
        for row in sorted(time_of_row)
    )


def waits_on(source: Source, line: int) -> bool:
    """Return whether a line waits."""
    match = _WAIT.match(source.text, source.starts[line - 1])
    return match is not None and _time(match) != 0.0


def _time(wait: re.Match[str]) -> float:
    """Return the time of a wait [s]: 0 for ``WAIT SEC 0`` and ``WAIT FOR TRUE``, which only stop the advance run.

    NaN if it is an expression, or depends on a condition.
    """
    if wait["time"] is None:
        return 0.0 if (wait["condition"] or "").strip(" \t()").upper() == "TRUE" else math.nan
    try:
        return float(wait["time"])
    except ValueError:
        return math.nan
