"""How each part of a page looks, in HTML; `style.css` gives it its shape."""

from __future__ import annotations

from collections.abc import Iterable

from postproc.report.kit.html import Html, element, joined
from postproc.report.kit.parts import (
    Cell,
    Facts,
    Fold,
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
from postproc.report.kit.plots import Plot


def sections(of: Iterable[Section]) -> Html:
    """Return sections with all that stands in them."""
    return joined(
        element(
            "section",
            element("h2", section.title, id=f"{section.id}-title"),
            *map(_shown, section.parts),
            id=section.id,
            class_=section.width,
            aria_labelledby=f"{section.id}-title",
        )
        for section in of
    )


def _shown(part: Part) -> Html:
    match part:
        case Table():
            return _table(part)
        case Facts():
            rows = (element("div", element("dt", name), element("dd", _cell(value))) for name, value in part.rows)
            return element("dl", *rows, class_="facts")
        case Tiles():
            return element("dl", *map(_tile, part.tiles), class_="tiles")
        case Notes():
            return _notes(part)
        case Verdict():
            return element("p", element("strong", part.word), " ", part.sentence, class_=f"verdict {part.state}")
        case Plot():
            drawn = element("div", class_="plot", role="img", aria_label=part.label, style=f"height:{part.height}px")
            numbers = element("script", Html(part.encoded), type="application/json")
            return element("figure", drawn, numbers, _if_any("figcaption", part.note))
        case View():
            return element(
                "figure",
                element("div", id=f"{part.name}-controls", class_="controls"),
                element("div", id=f"{part.name}-view", class_="view", role="group", tabindex=0, aria_label=part.label),
                _if_any("figcaption", part.note),
            )
        case Fold():
            return element("details", element("summary", part.title), *map(_shown, part.parts))
    raise TypeError(f"no part of a page: {part!r}")


def _if_any(name: str, text: str, **attributes: object) -> Html:
    return element(name, text, **attributes) if text else Html()


def _cell(content: Cell | str) -> str:
    if isinstance(content, str):
        return content
    if content.href:
        return element("a", content.text, href=content.href)
    return element("span", content.text, class_=content.kind)


def _table(table: Table) -> Html:
    def kind(column: int) -> str:
        return "text" if column == 0 or column in table.texts else ""

    def title(text: str) -> str:
        return element("button", text, type="button") if table.sortable else text

    def row(row: Row) -> Html:
        return element(
            "tr",
            *(
                element(
                    "td" if column else "th",
                    _cell(content),
                    scope="" if column else "row",
                    class_=kind(column),
                    data_sort=None if isinstance(content, str) else content.sort,
                )
                for column, content in enumerate(row.cells)
            ),
            data_place=row.place,
            tabindex=None if row.place is None else 0,
            data_source_line=row.source_line,
        )

    titles = (element("th", title(text), scope="col", class_=kind(column)) for column, text in enumerate(table.head))
    return joined(
        (
            element(
                "div",
                element(
                    "table",
                    element("caption", table.caption),
                    element("thead", element("tr", *titles)) if any(table.head) else "",
                    element("tbody", *map(row, table.rows)),
                    class_="sortable" if table.sortable else "",
                ),
                class_="scroll",
                tabindex=0,
                role="region",
                aria_label=table.caption,
            ),
            _if_any("p", table.note, class_="note"),
        )
    )


def _tile(tile: Tile) -> Html:
    unit = (" ", element("small", tile.unit)) if tile.unit else ()
    return element(
        "div",
        element("dt", tile.label),
        element("dd", tile.value, *unit, class_=tile.kind),
        _if_any("dd", tile.note, class_="note"),
    )


def _notes(part: Notes) -> Html:
    def each(name: str, notes: tuple[Note, ...]) -> Html:
        return joined(element(name, note.text, class_=note.kind) for note in notes)

    told = element("ul", each("li", part.notes)) if part.marked else each("p", part.notes)
    return joined((_if_any("h3", part.title), told))
