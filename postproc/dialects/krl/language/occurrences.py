"""Names in a piece of code that stand for variables or routines; components and constants of ENUMs are none."""

from __future__ import annotations

import re
from collections.abc import Iterator

from msgspec import Struct

_TOKEN = re.compile(
    r"\"[^\"]*\"|'[BbHh][0-9A-Fa-f]+'|[.#][ \t]*[A-Za-z_]\w*|\d[\w.]*|[A-Za-z_$][\w$]*|[\[\](){},]", re.ASCII
)
_TAG = re.compile(r"[ \t]*:")
_OPEN = re.compile(r"[ \t]*\(")


class Occurrence(Struct, frozen=True):
    """A name in a text.

    :ivar start: offset of its first character; `stop` the one behind its last.
    :ivar name: upper case.
    :ivar called: whether a bracket follows: it is a routine, or a function.
    """

    start: int
    stop: int
    name: str
    called: bool


def occurrences(text: str, start: int, stop: int) -> Iterator[Occurrence]:
    """Yield the names in ``text[start:stop]``, words of KRL among them.

    >>> [one.name for one in occurrences("LIN {X I, Y P.X}:Q", 0, 18)]
    ['LIN', 'I', 'P', 'Q']
    """
    open_: list[str] = []
    component = False  # the next name is one of an aggregate, or its type
    for match in _TOKEN.finditer(text, start, stop):
        first = match[0][0]
        if first in "([{":
            open_.append(first)
            component = first == "{"
        elif first in ")]}":
            del open_[-1:]
            component = False
        elif first == ",":
            component = bool(open_) and open_[-1] == "{"
        elif first.isalpha() or first in "_$":
            if component:
                component = _TAG.match(text, match.end(), stop) is not None
                continue
            called = _OPEN.match(text, match.end(), stop) is not None
            yield Occurrence(match.start(), match.end(), match[0].upper(), called)
