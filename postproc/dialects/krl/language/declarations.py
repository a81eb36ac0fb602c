"""Declarations: the names that a line declares, their types and initial values; the lines of a `.dat`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

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
    key_word,
    skip_word,
    word_at,
)
from postproc.errors import ProgramError


class DeclaredName(Struct, frozen=True):
    """A declared or initialised name.

    :ivar name: upper case.
    :ivar name_start: offset of the name.
    :ivar bounds: text of the bracket of an array, such as ``[3]``; None without one.
    :ivar kind: type, upper case; empty for an initialisation alone.
    :ivar is_global: True if it is declared GLOBAL.
    :ivar value_start: offset of its initial value; −1 without one.
    """

    name: str
    name_start: int
    bounds: str | None
    kind: str
    is_global: bool
    value_start: int


def declared_in(source: Source, start: int, stop: int) -> Iterator[DeclaredName]:
    """Yield the names that one line declares, in order; there may be several, as in ``DECL E6POS A={…},B={…}``.

    :param start: offset of the code of the line; `stop` the offset behind it.
    """
    match = DECLARATION.match(source.text, start, stop)
    if not match:
        return
    first = _first_name(source, match)
    yield first
    end = match.end()
    while True:
        if source.text[end - 1] == "=":  # a match ends with the sign if an initial value follows
            end = _value_stop(source, end, stop)
        next_name = NEXT_NAME.match(source.text, end, stop)
        if not next_name:
            return
        end = next_name.end()
        value_start = end if next_name["equals"] else -1
        yield DeclaredName(
            name=next_name["name"].upper(),
            name_start=next_name.start("name"),
            bounds=next_name["bounds"],
            kind=first.kind,
            is_global=first.is_global,
            value_start=value_start,
        )


def _first_name(source: Source, match: re.Match[str]) -> DeclaredName:
    """Return the first name that a line declares, from its match of `DECLARATION`."""
    is_global = key_word(source.text, match.start(), match.start("name"), "GLOBAL") is not None
    return DeclaredName(
        name=match["name"].upper(),
        name_start=match.start("name"),
        bounds=match["bounds"],
        kind=(match["kind"] or "").upper(),
        is_global=is_global,
        value_start=match.end() if match["equals"] else -1,
    )


def _value_stop(source: Source, start: int, stop: int) -> int:
    """Return the offset behind the initial value at `start`; `stop`, the end of the line, if it cannot be read."""
    try:
        _, value_stop = value_at(source, start, stop)
    except ProgramError:
        return stop
    return value_stop


class Structure(NamedTuple):
    """A type that STRUC declares; names in upper case.

    :ivar name: name of the type.
    :ivar members: name of a member → its type.
    """

    name: str
    members: dict[str, str]


def structure(source: Source, start: int, stop: int) -> Structure | None:
    """Return the type that a STRUC declares, such as ``STRUC PT INT N,FRAME F``; None if the code is something else.

    :raises ProgramError: brackets are not balanced.
    """
    # the words between two commas; the first list begins with STRUC and the name of the type
    word_lists = [NAME.findall(source.text, *span) for span in list_spans(source, start, stop)]
    while word_lists and word_lists[0][:1] and word_lists[0][0].upper() in ("GLOBAL", "DECL"):
        del word_lists[0][0]
    if not word_lists or len(word_lists[0]) < 3 or word_lists[0][0].upper() != "STRUC":
        return None
    name, word_lists[0] = word_lists[0][1].upper(), word_lists[0][2:]
    kind, members = "", dict[str, str]()
    for words in word_lists:  # type and member, or a member alone: it has the type of the member before
        kind = words[0].upper() if len(words) > 1 else kind
        members |= {word.upper(): kind for word in words[-1:]}
    return Structure(name, members)


def declared_names(source: Source) -> tuple[frozenset[str], frozenset[str]]:
    """Return the names, upper case, that a `.dat` declares only for its own program, and its GLOBAL names."""
    local_names: set[str] = set()
    global_names: set[str] = set()
    for begin, end in zip(source.starts.tolist(), source.stops.tolist(), strict=True):
        # such as P[3]={…}: most lines of long data lists, and never GLOBAL
        if element := ELEMENT.match(source.text, begin, end):
            local_names.add(element["name"].upper())
            continue
        start, stop = code_span(source.text, begin, end)
        if start < stop and source.text[start] != "&":  # & begins a line of the header
            for item in declared_in(source, start, stop):
                (global_names if item.is_global else local_names).add(item.name)
    return frozenset(local_names - global_names), frozenset(global_names)


class DataLine(Struct, frozen=True, eq=False):
    """A line of a `.dat` between DEFDAT and ENDDAT.

    :param line: 1-based.
    :param text: text of the line, with its line end.
    :param names: names that the line declares or initialises, upper case.
    :param is_global: True if these names are GLOBAL.
    """

    line: int
    text: str
    names: frozenset[str]
    is_global: bool


def data_lines(data: Source) -> list[DataLine]:
    """Return the lines of a `.dat` without its header, DEFDAT and ENDDAT.

    Lines with data of the controller are GLOBAL. If one line declares a name GLOBAL, all lines with it are GLOBAL.
    """
    lines = []
    for line in range(1, len(data.starts) + 1):
        start, stop = data.code_span(line)
        word = word_at(data.text, start, stop)
        if word not in ("DEFDAT", "ENDDAT") and data.text[start : start + 1] != "&":  # &: header
            lines.append(_data_line(data, line, word))
    global_names = frozenset().union(*(item.names for item in lines if item.is_global))
    return [
        item if item.is_global or item.names.isdisjoint(global_names) else replace(item, is_global=True)
        for item in lines
    ]


def _data_line(data: Source, line: int, word: str) -> DataLine:
    """Return a line of a `.dat` with the names that it declares or initialises, and with a line end.

    :param line: 1-based.
    :param word: first word of the line, upper case.
    """
    start, stop = data.code_span(line)
    # STRUC, ENUM, SIGNAL … declare no variables as DECL does: `_other_declared_names` reads their names
    is_variable_line = word not in DECLARATIONS
    declarations = list(declared_in(data, start, stop)) if is_variable_line else []
    names = frozenset(item.name for item in declarations) or _other_declared_names(data.text[start:stop], word)
    is_global = any(item.is_global for item in declarations) or _has_global(data.text, start, stop)
    text = data.lines_text(line, line)
    if not text.endswith(("\r", "\n")):  # the last line of the file
        text += "\r\n"
    return DataLine(line, text, names, is_global or not names.isdisjoint(CONTROLLER_DATA))


def _has_global(text: str, start: int, stop: int) -> bool:
    """Return whether GLOBAL is the first word of a line, or follows DECL."""
    decl_stop = skip_word(text, start, stop, "DECL")  # −1 without DECL
    return skip_word(text, max(start, decl_stop), stop, "GLOBAL") >= 0


def _other_declared_names(code: str, word: str) -> frozenset[str]:
    """Return the name, upper case, that a STRUC, ENUM, SIGNAL or CHANNEL declares; an empty set for other lines.

    :param code: the code of the line.
    :param word: the first word of the line, upper case.
    """
    second_word = NAME.findall(code)[1:2] if word in DECLARATIONS else ()
    return frozenset(name.upper() for name in second_word)
