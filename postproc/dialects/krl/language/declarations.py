"""Declarations: the names that a line declares, their types and initial values; the lines of a `.dat`."""

from __future__ import annotations

import re
from collections.abc import Iterator

from msgspec import Struct
from msgspec.structs import replace

from postproc.dialects.krl.language.expressions import list_spans, value_at
from postproc.dialects.krl.language.names import CONTROLLER_DATA, DECLARATIONS
from postproc.dialects.krl.language.source import Source, code_span
from postproc.dialects.krl.language.tokens import (
    DECLARATION,
    ELEMENT,
    NAME,
    NEXT_NAME,
    after_word,
    key_word,
    word_at,
)
from postproc.errors import ProgramError


class DeclaredName(Struct, frozen=True):
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


def declared_in(source: Source, start: int, stop: int) -> Iterator[DeclaredName]:
    """Yield the names that one line declares; there may be several, as in ``DECL E6POS A={…},B={…}``."""
    match = DECLARATION.match(source.text, start, stop)
    if not match:
        return
    first = _first_name(source, match)
    yield first
    end = match.end()
    while True:
        if source.text[end - 1] == "=":
            end = _value_stop(source, end, stop)
        next_name = NEXT_NAME.match(source.text, end, stop)
        if not next_name:
            return
        end = next_name.end()
        value = end if next_name["equals"] else -1
        yield DeclaredName(
            next_name["name"].upper(), next_name.start("name"), next_name["bounds"], first.kind, first.public, value
        )


def _first_name(source: Source, match: re.Match[str]) -> DeclaredName:
    """Return the first name that a line declares, from its match of `DECLARATION`."""
    public = key_word(source.text, match.start(), match.start("name"), "GLOBAL") is not None
    kind, value = (match["kind"] or "").upper(), match.end() if match["equals"] else -1
    return DeclaredName(match["name"].upper(), match.start("name"), match["bounds"], kind, public, value)


def _value_stop(source: Source, start: int, stop: int) -> int:
    """Return where an initial value ends; the end of the line where it cannot be read."""
    try:
        return value_at(source, start, stop)[1]
    except ProgramError:
        return stop


def structure(source: Source, start: int, stop: int) -> tuple[str, dict[str, str]] | None:
    """Return the name of a STRUC and its members, as of ``STRUC PT INT N,FRAME F``.

    :returns: upper-case name, and type by name of the members; None if the code is something else.
    :raises ProgramError: brackets are not balanced.
    """
    pieces = [NAME.findall(source.text, *span) for span in list_spans(source, start, stop)]
    while pieces and pieces[0][:1] and pieces[0][0].upper() in ("GLOBAL", "DECL"):
        del pieces[0][0]
    if not pieces or len(pieces[0]) < 3 or pieces[0][0].upper() != "STRUC":
        return None
    name, pieces[0] = pieces[0][1].upper(), pieces[0][2:]
    kind, members = "", dict[str, str]()  # a type holds for all members up to the next type
    for words in pieces:
        kind = words[0].upper() if len(words) > 1 else kind
        members |= {word.upper(): kind for word in words[-1:]}
    return name, members


def declared_names(source: Source) -> tuple[frozenset[str], frozenset[str]]:
    """Return the names that a `.dat` declares for its own program, and those that are GLOBAL."""
    local_names: set[str] = set()
    public: set[str] = set()
    for begin, end in zip(source.starts.tolist(), source.stops.tolist(), strict=True):
        if element := ELEMENT.match(source.text, begin, end):  # most lines of long data lists
            local_names.add(element["name"].upper())
            continue
        start, stop = code_span(source.text, begin, end)
        if start < stop and source.text[start] != "&":
            for item in declared_in(source, start, stop):
                (public if item.public else local_names).add(item.name)
    return frozenset(local_names - public), frozenset(public)


class DataLine(Struct, frozen=True, eq=False):
    """A line of a `.dat` between DEFDAT and ENDDAT.

    :param line: 1-based.
    :param text: with its end.
    :param names: what it declares or gives a value to, upper case.
    :param public: whether that is GLOBAL.
    """

    line: int
    text: str
    names: frozenset[str]
    public: bool


def data_lines(data: Source) -> list[DataLine]:
    """Return the lines of a `.dat` without its header, DEFDAT and ENDDAT.

    Data of the controller count as GLOBAL, and so do all lines about a name that one line declares GLOBAL.
    """
    lines = []
    for line in range(1, len(data.starts) + 1):
        start, stop = data.code_span(line)
        word = word_at(data.text, start, stop)
        if word in ("DEFDAT", "ENDDAT") or data.text[start : start + 1] == "&":
            continue
        begin, end = int(data.starts[line - 1]), int(data.stops[line - 1])
        next_start = int(data.starts[line]) if line < len(data.starts) else len(data.text)
        declarations = list(declared_in(data, start, stop)) if word not in DECLARATIONS else []
        names = frozenset(item.name for item in declarations) or _other_declared_names(data.text[start:stop], word)
        public = any(item.public for item in declarations) or _is_public(data.text, start, stop)
        public = public or not names.isdisjoint(CONTROLLER_DATA)
        text = data.text[begin:next_start] if next_start > end else data.text[begin:end] + "\r\n"
        lines.append(DataLine(line, text, names, public))
    public_names = frozenset().union(*(item.names for item in lines if item.public))
    return [
        item if item.public or item.names.isdisjoint(public_names) else replace(item, public=True) for item in lines
    ]


def _is_public(text: str, start: int, stop: int) -> bool:
    """Return whether GLOBAL is the first word of a line, or follows DECL."""
    after_decl = after_word(text, start, stop, "DECL")
    return after_word(text, max(start, after_decl), stop, "GLOBAL") >= 0


def _other_declared_names(code: str, word: str) -> frozenset[str]:
    """Return the name that a STRUC, ENUM, SIGNAL or CHANNEL declares."""
    if word not in DECLARATIONS:
        return frozenset()
    return frozenset(name.upper() for name in NAME.findall(code)[1:2])
