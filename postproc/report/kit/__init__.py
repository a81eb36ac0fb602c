"""What every page is made of: one frame, one set of parts and plots, one look. It knows nothing of robots."""

from postproc.report.kit.columns import Columns
from postproc.report.kit.frame import Page
from postproc.report.kit.parts import (
    Cell,
    Facts,
    Fold,
    Kind,
    Note,
    Notes,
    Part,
    Row,
    Section,
    Table,
    Tile,
    Tiles,
    Verdict,
    View,
)
from postproc.report.kit.plots import Axis, Bars, Counts, Curve, Lines, Mark, Matrix, Plot, Points, Span, Traced

__all__ = [
    "Axis",
    "Bars",
    "Cell",
    "Columns",
    "Counts",
    "Curve",
    "Facts",
    "Fold",
    "Kind",
    "Lines",
    "Mark",
    "Matrix",
    "Note",
    "Notes",
    "Page",
    "Part",
    "Plot",
    "Points",
    "Row",
    "Section",
    "Span",
    "Table",
    "Tile",
    "Tiles",
    "Traced",
    "Verdict",
    "View",
]
