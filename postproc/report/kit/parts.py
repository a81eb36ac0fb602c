"""What stands in a section of a page: plain data; `templates/page.html` says how each part looks."""

from __future__ import annotations

from typing import ClassVar, Literal, Protocol

import msgspec

State = Literal["ok", "warning", "failed"]
Kind = Literal["", "good", "warning", "error", "soft"]
"""How a text is shown: plain, or as good, as something to look at, as wrong, as less important."""


class Part(Protocol):
    """What can stand in a section; `template` names the macro of `templates/page.html` that shows it."""

    template: ClassVar[str]


class Cell(msgspec.Struct, frozen=True):
    """Text of a table or a fact.

    :param sort: what the column is sorted by where that is not the text.
    :param href: file beside the page that the text leads to.
    """

    text: str
    kind: Kind = ""
    sort: float | None = None
    href: str = ""


class Row(msgspec.Struct, frozen=True):
    """Row of a table; with `place` it chooses that place in all views.

    :param place: row of the page's columns, or None.
    :param source_line: of that place.
    """

    cells: tuple[Cell | str, ...]
    place: int | None = None
    source_line: int | None = None


class Table(msgspec.Struct, frozen=True):
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


class Facts(msgspec.Struct, frozen=True):
    """Names and what is known about them."""

    template: ClassVar[str] = "facts"
    rows: tuple[tuple[str, Cell | str], ...]


class Tile(msgspec.Struct, frozen=True):
    """A number to be seen from afar."""

    label: str
    value: str
    unit: str = ""
    note: str = ""
    kind: Kind = ""


class Tiles(msgspec.Struct, frozen=True):
    """Some of them, side by side."""

    template: ClassVar[str] = "tiles"
    tiles: tuple[Tile, ...]


class Note(msgspec.Struct, frozen=True):
    """A sentence."""

    text: str
    kind: Kind = ""


class Notes(msgspec.Struct, frozen=True):
    """Sentences, with a heading of their own or none.

    :param marked: as a list.
    """

    template: ClassVar[str] = "notes"
    notes: tuple[Note, ...]
    title: str = ""
    marked: bool = False


class Verdict(msgspec.Struct, frozen=True):
    """What to think of it all, in one word and one sentence."""

    template: ClassVar[str] = "verdict"
    state: State
    word: str
    sentence: str


class View(msgspec.Struct, frozen=True):
    """Room for something that a script of the page draws.

    :param name: of the script's view: the element gets the id ``NAME-view``, its controls ``NAME-controls``.
    :param label: what it shows and how it is used, for those who do not see it.
    :param note: a sentence below.
    """

    template: ClassVar[str] = "view"
    name: str
    label: str
    note: str = ""


class Fold(msgspec.Struct, frozen=True):
    """Parts that are shown when asked for."""

    template: ClassVar[str] = "fold"
    title: str
    parts: tuple[Part, ...]


class Section(msgspec.Struct, frozen=True):
    """Section of a page.

    :param id: its anchor.
    :param parts: what stands in it, in order.
    :param width: ``"half"`` may stand beside another one, ``"side"`` stays in sight beside all others.
    """

    id: str
    title: str
    parts: tuple[Part, ...]
    width: Literal["full", "half", "side"] = "full"
