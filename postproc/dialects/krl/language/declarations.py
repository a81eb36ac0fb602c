"""Declarations: which names a line declares, of what type, and where their initial values stand."""

from __future__ import annotations

import re
from collections.abc import Iterator

from msgspec import Struct

from postproc.dialects.krl.language.brackets import split
from postproc.dialects.krl.language.expressions import parse
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import DECLARATION, NAME, NEXT_DECLARED, key_word
from postproc.errors import ProgramError


class Declared(Struct, frozen=True):
    """A declared or initialised name.

    :ivar name: upper case.
    :ivar at: offset of the name.
    :ivar bounds: ``[3]``, or None.
    :ivar kind: type, upper case; empty for an initialisation alone.
    :ivar public: declared GLOBAL.
    :ivar value: offset of its initial value; −1 where there is none.
    """

    name: str
    at: int
    bounds: str | None
    kind: str
    public: bool
    value: int


def declared(source: Source, start: int, stop: int) -> Iterator[Declared]:
    """Yield what one line declares, also several names: ``DECL E6POS A={…},B={…}``."""
    match = DECLARATION.match(source.text, start, stop)
    if not match:
        return
    first = _first(source, match)
    yield first
    end = match.end()
    while True:
        if source.text[end - 1] == "=":
            end = _value_stop(source, end, stop)
        following = NEXT_DECLARED.match(source.text, end, stop)
        if not following:
            return
        end = following.end()
        value = end if following[3] else -1
        yield Declared(following[1].upper(), following.start(1), following[2], first.kind, first.public, value)


def _first(source: Source, match: re.Match[str]) -> Declared:
    public = key_word(source.text, match.start(), match.start(2), "GLOBAL") is not None
    kind, value = (match[1] or "").upper(), match.end() if match[4] else -1
    return Declared(match[2].upper(), match.start(2), match[3], kind, public, value)


def _value_stop(source: Source, start: int, stop: int) -> int:
    """Return where an initial value ends; the end of the line where it cannot be read."""
    try:
        return parse(source, start, stop)[1]
    except ProgramError:
        return stop


def structure(source: Source, start: int, stop: int) -> tuple[str, dict[str, str]] | None:
    """Return name and members (name → type, upper case) of a ``STRUC PT INT N,FRAME F``; None if it is something else.

    :raises ProgramError: brackets are not balanced.
    """
    pieces = [NAME.findall(source.text, *span) for span in split(source, start, stop)]
    while pieces and pieces[0][:1] and pieces[0][0].upper() in ("GLOBAL", "DECL"):
        del pieces[0][0]
    if not pieces or len(pieces[0]) < 3 or pieces[0][0].upper() != "STRUC":
        return None
    name, pieces[0] = pieces[0][1].upper(), pieces[0][2:]
    kind, members = "", dict[str, str]()
    for words in pieces:
        kind = words[0].upper() if len(words) > 1 else kind
        members |= {word.upper(): kind for word in words[-1:]}
    return name, members


def declared_names(source: Source) -> tuple[frozenset[str], frozenset[str]]:
    """Return the names that a `.dat` declares for its own program, and those that are GLOBAL."""
    own: set[str] = set()
    public: set[str] = set()
    for line in range(1, len(source.starts) + 1):
        start, stop = source.code_span(line)
        if start < stop and source.text[start] != "&":
            for one in declared(source, start, stop):
                (public if one.public else own).add(one.name)
    return frozenset(own - public), frozenset(public)
