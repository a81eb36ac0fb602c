"""The path in space, coloured, with its deviations enlarged, the part frame and the robot."""

from postproc.report.deviation.content import Deviation
from postproc.report.kit import Section, View

_LABEL = (
    "The nominal path in space, coloured by a value. Drag or use the arrow keys to turn it, the wheel or + and − to "
    "come nearer; a click or N and P choose a place, W the worst one. The table of the worst places says the same in "
    "numbers."
)


def section(told: Deviation) -> Section | None:
    """Return room for the view."""
    if not len(told.result) or told.nothing is not None:
        return None
    note = (
        "Drag or arrow keys turn, wheel or + − zoom, a click chooses a place; N, P: next, previous place, W: the "
        "worst. Grey: rapid moves. The overlay is enlarged; the path itself is not."
    )
    return Section("view3d", "The path in space", (View("view3d", _LABEL, note),))
