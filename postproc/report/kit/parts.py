"""Parts of a page and its plots as plain data; `templates/page.html` and `scripts/plots.js` show them."""

from __future__ import annotations

from typing import ClassVar, Literal, Protocol

import msgspec

State = Literal["ok", "warning", "failed"]
Kind = Literal["", "good", "warning", "error", "soft"]
"""Style of a text: plain, good, warning, error, or less important."""


class Part(Protocol):
    """A part of a section; `template` names the macro of `templates/page.html` that shows it."""

    template: ClassVar[str]


class Cell(msgspec.Struct, frozen=True):
    """Text of a table or a fact.

    :param sort: number by which the column is sorted; None: it is sorted by the text.
    :param href: file in the folder of the page that the text links to; empty: no link.
    """

    text: str
    kind: Kind = ""
    sort: float | None = None
    href: str = ""


class Row(msgspec.Struct, frozen=True):
    """Row of a table; a click on it chooses its place in all views.

    :param place: row of the page's columns; None: a click chooses nothing.
    :param source_line: source line of the place; None without a place.
    """

    cells: tuple[Cell | str, ...]
    place: int | None = None
    source_line: int | None = None


class Table(msgspec.Struct, frozen=True):
    """Table: the first column names the row, the others are numbers unless they are in `texts`.

    :param caption: what the table shows, for readers who do not see it.
    :param texts: indices of further columns that hold text, left aligned.
    :param sortable: a click on the head of a column sorts the rows.
    :param note: a sentence below the table.
    """

    template: ClassVar[str] = "table"
    head: tuple[str, ...]
    rows: tuple[Row, ...]
    caption: str
    texts: tuple[int, ...] = ()
    sortable: bool = False
    note: str = ""


class Facts(msgspec.Struct, frozen=True):
    """Names with their values."""

    template: ClassVar[str] = "facts"
    rows: tuple[tuple[str, Cell | str], ...]


class Tile(msgspec.Struct, frozen=True):
    """A large number with its label."""

    label: str
    value: str
    unit: str = ""
    note: str = ""
    kind: Kind = ""


class Tiles(msgspec.Struct, frozen=True):
    """Tiles in a row."""

    template: ClassVar[str] = "tiles"
    tiles: tuple[Tile, ...]


class Note(msgspec.Struct, frozen=True):
    """A sentence."""

    text: str
    kind: Kind = ""


class Notes(msgspec.Struct, frozen=True):
    """Sentences under a heading.

    :param title: the heading; empty: none.
    :param bulleted: the sentences are shown as a list with bullets.
    """

    template: ClassVar[str] = "notes"
    notes: tuple[Note, ...]
    title: str = ""
    bulleted: bool = False


class Verdict(msgspec.Struct, frozen=True):
    """The verdict, in one word and one sentence."""

    template: ClassVar[str] = "verdict"
    state: State
    word: str
    sentence: str


class View(msgspec.Struct, frozen=True):
    """An area that a script of the page draws into.

    :param name: name of the script's view: the element gets the id ``NAME-view``, its controls ``NAME-controls``.
    :param label: what the view shows and how it is used, for readers who do not see it.
    :param note: a sentence below the view.
    :param hint: how the view is used with mouse and keys; not printed.
    """

    template: ClassVar[str] = "view"
    name: str
    label: str
    note: str = ""
    hint: str = ""


class Drawing(msgspec.Struct, frozen=True):
    """A drawing to scale.

    :param svg: an svg element; it must not contain text of users, as it is not escaped.
    :param label: what the drawing shows, for readers who do not see it.
    :param note: a sentence below the drawing.
    """

    template: ClassVar[str] = "drawing"
    svg: str
    label: str
    note: str = ""


class Fold(msgspec.Struct, frozen=True):
    """Parts that are shown on request."""

    template: ClassVar[str] = "fold"
    title: str
    parts: tuple[Part, ...]


class Section(msgspec.Struct, frozen=True):
    """Section of a page.

    :param id: anchor of the section.
    :param parts: content, in order.
    :param width: ``"half"``: next to another section of half width; ``"side"``: always visible beside the others.
    :param printed: the section is printed too.
    """

    id: str
    title: str
    parts: tuple[Part, ...]
    width: Literal["full", "half", "side"] = "full"
    printed: bool = True


Colour = Literal["before", "after", "correction", "force", "soft", "ink", "warning"]
"""A colour of the style sheet, by its meaning: light and dark pages have their own shades."""
Numbers = list[float]


class Axis(msgspec.Struct, frozen=True, kw_only=True):
    """An axis; `categories` are names at 0, 1, 2 …"""

    title: str = ""
    logarithmic: bool = False
    range: tuple[float, float] | None = None
    categories: list[str] | None = None


class Curve(msgspec.Struct, frozen=True, tag="curve"):
    """A line through points.

    :param places: row of the page's columns of each point: a click chooses that place, and the chosen place is marked.
        None: the curve is not linked.
    """

    x: Numbers
    y: Numbers
    name: str
    colour: Colour
    dots: bool = False
    dashed: bool = False
    places: list[int] | None = None


class Points(msgspec.Struct, frozen=True, tag="points"):
    """Dots, with 95 % intervals and texts.

    :param half: half width of the interval of each dot; None: no interval.
    :param across: the intervals are along x, not along y.
    :param texts: text that is shown when the pointer is on a dot.
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
    """Thin lines from (x, low) to (x, high), between two dots."""

    x: Numbers
    low: Numbers
    high: Numbers


class Bars(msgspec.Struct, frozen=True, tag="bars"):
    """Horizontal bars, one for each category of y, with a text at their end; bars with `chosen` are emphasised."""

    lengths: Numbers
    texts: list[str]
    chosen: list[bool]


class Histogram(msgspec.Struct, frozen=True, tag="histogram"):
    """A histogram: bars between edges (one more than bars).

    :param places: row of the page's columns that a click on each bar chooses; None: a click chooses nothing.
    """

    edges: Numbers
    heights: Numbers
    name: str
    places: list[int | None] | None = None


class Matrix(msgspec.Struct, frozen=True, tag="matrix"):
    """A square of numbers between −1 and 1, one row and column for each name."""

    names: list[str]
    values: list[Numbers]


class Lines(msgspec.Struct, frozen=True, tag="lines"):
    """A line in space, in the unit of its plot; NaN separates its pieces. `places`: see `Curve`."""

    x: Numbers
    y: Numbers
    z: Numbers
    name: str
    colour: Colour
    width: float = 3.0
    dots: bool = False
    places: list[int] | None = None


class Map(msgspec.Struct, frozen=True, tag="map"):
    """Values on a grid, and the reasons why cells have no value.

    :param values: (rows, columns); None where a cell is refused.
    :param reasons: (rows, columns) index in `names` of the reason; 0 = not refused.
    :param names: names of the reasons; the first, of cells that are not refused, is not shown.
    :param title: title of the values, with their unit.
    """

    x: Numbers
    y: Numbers
    values: list[list[float | None]]
    reasons: list[list[int]]
    names: tuple[str, ...]
    title: str


class Mark(msgspec.Struct, frozen=True):
    """A vertical line across a plot at x = `at`, or with `level` a horizontal one at y = `at`, with a text."""

    at: float
    text: str
    colour: Colour
    level: bool = False


PlotItem = Curve | Points | Span | Bars | Histogram | Matrix | Map | Lines


class Plot(msgspec.Struct, frozen=True, kw_only=True):
    """A plot.

    :param label: what the plot shows, for readers who do not see it.
    :param height: [px].
    :param unit: unit of the axes of a plot in space.
    :param steps: indices of the traces that each step of a slider shows; None: no slider.
    :param step_names: name of each step.
    """

    template: ClassVar[str] = "plot"
    label: str
    traces: list[PlotItem]
    x: Axis = Axis()
    y: Axis = Axis()
    marks: list[Mark] = []
    height: int = 320
    unit: str = "m"
    note: str = ""
    steps: list[list[int]] | None = None
    step_names: list[str] | None = None

    @property
    def is_linked(self) -> bool:
        """True if a click on a point of the plot chooses a place of the page."""
        return any(getattr(trace, "places", None) is not None for trace in self.traces)

    @property
    def as_json(self) -> str:
        """The plot as JSON, safe in HTML."""
        return safe_json(self)


def safe_json(content: object) -> str:
    """Return the content as JSON that may be put into a script element of HTML; NaN becomes null."""
    return msgspec.json.encode(content).decode().replace("<", "\\u003c")
