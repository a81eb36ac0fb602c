"""Plots as plain data. `scripts/plots.js` hands them to the library that draws them."""

from __future__ import annotations

from typing import ClassVar, Literal

import msgspec

Colour = Literal["before", "after", "correction", "force", "soft", "ink", "warning"]
"""A colour of the style sheet, the same in light and dark: what it stands for."""
Numbers = list[float]


class Axis(msgspec.Struct, frozen=True, kw_only=True):
    """An axis; `categories` are names at 0, 1, 2 …"""

    title: str = ""
    logarithmic: bool = False
    range: tuple[float, float] | None = None
    categories: list[str] | None = None


class Curve(msgspec.Struct, frozen=True, tag="curve"):
    """A line through points.

    :param places: row of the page's columns that each point is; then a click chooses it, and the chosen one is marked.
    """

    x: Numbers
    y: Numbers
    name: str
    colour: Colour
    dots: bool = False
    dashed: bool = False
    places: list[int] | None = None


class Points(msgspec.Struct, frozen=True, tag="points"):
    """Dots, with the half widths of their 95 % intervals, and texts shown when pointed at.

    :param across: the intervals lie along x, not y.
    """

    x: Numbers
    y: Numbers
    name: str
    colour: Colour
    half: list[float | None] | None = None
    across: bool = False
    hollow: bool = False
    texts: list[str] | None = None


class Span(msgspec.Struct, frozen=True, tag="span"):
    """Thin lines from (x, low) to (x, high), to tie dots together."""

    x: Numbers
    low: Numbers
    high: Numbers


class Bars(msgspec.Struct, frozen=True, tag="bars"):
    """Lying bars, one for each category of y, with a text at their end; chosen ones stand out."""

    lengths: Numbers
    texts: list[str]
    chosen: list[bool]


class Counts(msgspec.Struct, frozen=True, tag="counts"):
    """How many lie between edges: standing bars without gaps. `places`: the one that a click on each bar chooses."""

    edges: Numbers
    counts: list[int]
    name: str
    places: list[int | None] | None = None


class Matrix(msgspec.Struct, frozen=True, tag="matrix"):
    """A square of numbers between −1 and 1, one row and column for each name."""

    names: list[str]
    values: list[Numbers]


class Lines(msgspec.Struct, frozen=True, tag="lines"):
    """A line in space, in the unit of its plot; pieces are parted by NaN. `places`: see `Curve`."""

    x: Numbers
    y: Numbers
    z: Numbers
    name: str
    colour: Colour
    width: float = 3.0
    dots: bool = False
    places: list[int] | None = None


class Mark(msgspec.Struct, frozen=True):
    """An upright or level line across a plot, with a text."""

    at: float
    text: str
    colour: Colour
    level: bool = False


Traced = Curve | Points | Span | Bars | Counts | Matrix | Lines


class Plot(msgspec.Struct, frozen=True, kw_only=True):
    """A plot.

    :param label: what it shows, for those who do not see it.
    :param unit: of the axes of a plot in space.
    :param steps: for each step of a slider, which of the traces are shown; a name for each in `step_names`.
    """

    template: ClassVar[str] = "plot"
    label: str
    traces: list[Traced]
    x: Axis = Axis()
    y: Axis = Axis()
    marks: list[Mark] = []
    height: int = 320
    unit: str = "m"
    note: str = ""
    steps: list[list[int]] | None = None
    step_names: list[str] | None = None

    @property
    def linked(self) -> bool:
        """Whether a click on it chooses a place."""
        return any(getattr(trace, "places", None) is not None for trace in self.traces)

    @property
    def encoded(self) -> str:
        """The plot as JSON that may stand in HTML."""
        return encoded(self)


def encoded(content: object) -> str:
    """Return JSON that may stand in a script element of HTML; NaN becomes null."""
    return msgspec.json.encode(content).decode().replace("<", "\\u003c")
