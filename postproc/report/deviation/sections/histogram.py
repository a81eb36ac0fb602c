"""How many targets deviate by how much."""

from postproc.report.deviation.content import Deviation
from postproc.report.kit import Section, View


def section(told: Deviation) -> Section | None:
    """Return room for the histogram; `facts.histograms` has its numbers, over all cutting targets."""
    if not len(told.result) or told.nothing is not None:
        return None
    label = "Histogram of the deviation at cutting targets, before and after; a click on a bar chooses its worst place."
    note = "All cutting targets, each with its own scale. A click on a bar chooses the worst place in it."
    return Section("histogram", "Distribution of the deviation", (View("histogram", label, note),))
