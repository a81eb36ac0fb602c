"""The place that was clicked or pointed at anywhere."""

from postproc.report.deviation.content import Deviation
from postproc.report.kit import Section, View


def section(told: Deviation) -> Section | None:
    """Return room for the details; it stays in sight beside the other sections."""
    if not len(told.result):
        return None
    label = "Details of the chosen place: lines, pose, joints, force, deviation, correction"
    return Section("place", "Place", (View("place", label),), "side")
