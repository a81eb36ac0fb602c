"""Plots along the path."""

from postproc.report.deviation.content import Deviation
from postproc.report.kit import Section, View

_LABEL = (
    "Plots over the length of the path or over time: deviation before and after, its parts along axes and feed, force, "
    "correction, margins, speed. Left and right arrow keys move the chosen place; the same numbers are in targets.csv."
)


def section(told: Deviation) -> Section | None:
    """Return room for the plots."""
    if not len(told.result) or told.nothing is not None:
        return None
    note = (
        "Gaps are rapid moves; dotted: a joint changes the direction of its torque. Drag to look closer, double click "
        "to see all again; left and right arrow keys step. Along, across, normal: along the feed, square to feed and "
        "spindle, along the spindle. Time is without accelerations."
    )
    return Section("along", "Along the path", (View("along", _LABEL, note),))
