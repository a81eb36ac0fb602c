"""The lines of a `.dat`, as what they declare: what has to go where its program goes."""

from __future__ import annotations

from msgspec import Struct
from msgspec.structs import replace

from postproc.dialects.krl.language.declarations import declared
from postproc.dialects.krl.language.names import DECLARING
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import NAME, after_word, word_at


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
    """Return the lines of a `.dat` but for its header, DEFDAT and ENDDAT."""
    found = []
    for line in range(1, len(data.starts) + 1):
        start, stop = data.code_span(line)
        word = word_at(data.text, start, stop)
        if word in ("DEFDAT", "ENDDAT") or data.text[start : start + 1] == "&":
            continue
        begin, end = int(data.starts[line - 1]), int(data.stops[line - 1])
        beyond = int(data.starts[line]) if line < len(data.starts) else len(data.text)
        stated = list(declared(data, start, stop)) if word not in DECLARING else []
        names = frozenset(one.name for one in stated) or _declared_otherwise(data.text[start:stop], word)
        public = any(one.public for one in stated) or _is_public(data.text, start, stop)
        text = data.text[begin:beyond] if beyond > end else data.text[begin:end] + "\r\n"
        found.append(DataLine(line, text, names, public))
    everywhere = frozenset().union(*(one.names for one in found if one.public))
    return [one if one.public or one.names.isdisjoint(everywhere) else replace(one, public=True) for one in found]


def _is_public(text: str, start: int, stop: int) -> bool:
    """Return whether GLOBAL is the first word of a line, or follows DECL."""
    behind = after_word(text, start, stop, "DECL")
    return after_word(text, max(start, behind), stop, "GLOBAL") >= 0


def _declared_otherwise(code: str, word: str) -> frozenset[str]:
    """Return the name that a STRUC, ENUM, SIGNAL or CHANNEL declares."""
    if word not in DECLARING:
        return frozenset()
    return frozenset(name.upper() for name in NAME.findall(code)[1:2])
