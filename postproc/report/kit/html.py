"""HTML made of elements: text is always escaped, unless it is HTML already."""

from __future__ import annotations

from collections.abc import Iterable

_ESCAPED = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&#34;"})
_VOID = frozenset({"meta"})
"""Elements that hold nothing, and are not closed."""


class Html(str):
    """Text that is HTML and stands as it is."""

    __slots__ = ()


def escaped(text: str) -> str:
    """Return a text as HTML that shows it; HTML as it is."""
    return text if isinstance(text, Html) else text.translate(_ESCAPED)


def joined(content: Iterable[str]) -> Html:
    """Return texts and HTML one behind the other."""
    return Html("".join(map(escaped, content)))


def element(name: str, /, *content: str, **attributes: object) -> Html:
    """Return an element.

    :param content: texts and HTML in it.
    :param attributes: ``_`` stands for ``-``, and one behind the name is dropped (``class_``); an attribute that is
        None or empty is left out.

    >>> element("p", "a < b", element("b", "!"), class_="note", title="", data_row=0)
    '<p class="note" data-row="0">a &lt; b<b>!</b></p>'
    """
    given = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escaped(str(value))}"'
        for key, value in attributes.items()
        if value is not None and value != ""
    )
    return Html(f"<{name}{given}>" + ("" if name in _VOID else f"{joined(content)}</{name}>"))
