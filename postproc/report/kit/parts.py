"""What stands in a section of a page: plain data; `templates/page.html` says how each part looks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

State = Literal["ok", "warning", "failed"]
Kind = Literal["", "good", "warning", "error", "soft"]
"""How a text is shown: plain, or as good, as something to look at, as wrong, as less important."""


class Part(Protocol):
    """What can stand in a section; `template` names the macro of `templates/page.html` that shows it."""

    template: ClassVar[str]


@dataclass(frozen=True, slots=True)
class Cell:
    """Text of a table or a fact.

    :param sort: what the column is sorted by where that is not the text.
    :param href: file beside the page that the text leads to.
    """

    text: str
    kind: Kind = ""
    sort: float | None = None
    href: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """Row of a table; with `place` it chooses that place in all views.

    :param place: row of the page's columns, or None.
    :param source_line: of that place.
    """

    cells: tuple[Cell | str, ...]
    place: int | None = None
    source_line: int | None = None


@dataclass(frozen=True, slots=True)
class Table:
    """Table: the first column names the row, the others are numbers, but for those named in `texts`.

    :param caption: says what the table shows, for those who do not see it.
    :param texts: columns (from 0) that hold text, left aligned.
    :param sortable: its columns can be sorted by.
    :param note: a sentence below.
    """

    template: ClassVar[str] = "table"
    head: tuple[str, ...]
    rows: tuple[Row, ...]
    caption: str
    texts: tuple[int, ...] = ()
    sortable: bool = False
    note: str = ""


@dataclass(frozen=True, slots=True)
class Facts:
    """Names and what is known about them."""

    template: ClassVar[str] = "facts"
    rows: tuple[tuple[str, Cell | str], ...]


@dataclass(frozen=True, slots=True)
class Tile:
    """A number to be seen from afar."""

    label: str
    value: str
    unit: str = ""
    note: str = ""
    kind: Kind = ""


@dataclass(frozen=True, slots=True)
class Tiles:
    """Some of them, side by side."""

    template: ClassVar[str] = "tiles"
    tiles: tuple[Tile, ...]


@dataclass(frozen=True, slots=True)
class Note:
    """A sentence."""

    text: str
    kind: Kind = ""


@dataclass(frozen=True, slots=True)
class Notes:
    """Sentences, with a heading of their own or none.

    :param marked: as a list.
    """

    template: ClassVar[str] = "notes"
    notes: tuple[Note, ...]
    title: str = ""
    marked: bool = False


@dataclass(frozen=True, slots=True)
class Verdict:
    """What to think of it all, in one word and one sentence."""

    template: ClassVar[str] = "verdict"
    state: State
    word: str
    sentence: str


@dataclass(frozen=True, slots=True)
class View:
    """Room for something that a script of the page draws.

    :param name: of the script's view: the element gets the id ``NAME-view``, its controls ``NAME-controls``.
    :param label: what it shows and how it is used, for those who do not see it.
    :param note: a sentence below.
    """

    template: ClassVar[str] = "view"
    name: str
    label: str
    note: str = ""


@dataclass(frozen=True, slots=True)
class Fold:
    """Parts that are shown when asked for."""

    template: ClassVar[str] = "fold"
    title: str
    parts: tuple[Part, ...]


@dataclass(frozen=True, slots=True)
class Section:
    """Section of a page.

    :param id: its anchor.
    :param parts: what stands in it, in order.
    :param width: ``"half"`` may stand beside another one, ``"side"`` stays in sight beside all others.
    """

    id: str
    title: str
    parts: tuple[Part, ...]
    width: Literal["full", "half", "side"] = "full"
