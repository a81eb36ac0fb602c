"""Where a program waits: WAIT SEC, WAIT FOR and HALT."""

from __future__ import annotations

import re

import numpy as np

from postproc.dialects.krl.course import Course
from postproc.program import Event, Ints

_WAIT = re.compile(
    r"^[ \t]*(?:WAIT[ \t]+SEC\b(?P<time>[^;\r\n]*)|WAIT[ \t]+FOR\b(?P<condition>[^;\r\n]*)|HALT\b)",
    re.IGNORECASE | re.MULTILINE,
)


def waits(course: Course, motions: Ints) -> tuple[Event, ...]:
    """Return the waits of a program in execution order, each as a dwell at the next motion.

    ``WAIT SEC 0`` and ``WAIT FOR TRUE``, which only stop the advance run, are left out.

    :param motions: (M,) lines of the motions in the trace.
    :returns: their value is the time [s]; 0 if it is not a number, or depends on a condition.
    """
    events = []
    for source in course.trace.sources:
        times = {}  # line → time
        for match in _WAIT.finditer(source.text):
            time = _time(match["time"] or "")
            if time != 0.0 and (match["condition"] or "").strip(" \t()").upper() != "TRUE":
                times[source.line_at(match.start())] = time or 0.0
        lines = np.array(list(times), dtype=np.int64)
        rows, index = course.rows_of(source, lines)
        for row, line in zip(rows.tolist(), lines[index].tolist(), strict=True):
            next_motion = int(np.searchsorted(motions, row))
            shown_line = course.trace.shown_line(row)
            events.append(Event(before=next_motion, kind="dwell", line=shown_line, value=times[line]))
    return tuple(sorted(events, key=lambda event: event.before))


def _time(text: str) -> float | None:
    """Return the number of ``WAIT SEC`` [s]; None if it is an expression, or there is none."""
    try:
        return float(text)
    except ValueError:
        return None
