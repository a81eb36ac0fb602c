"""Values as KRL writes them: numbers, aggregates, names, chains of frames. Every value knows where it stands.

Offsets count characters from the beginning of the document.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from postproc.dialects.krl.language.source import Source


class Number(Struct, frozen=True):
    """A number.

    `integer` is True where it may be an INT: KRL divides two of these without a remainder.
    """

    value: float
    start: int
    stop: int
    integer: bool = False


class Word(Struct, frozen=True):
    """An enumeration value (``#BASE``), a string with its quotes, TRUE or FALSE; upper case but for strings."""

    text: str
    start: int
    stop: int


class Reference(Struct, frozen=True):
    """A variable: ``XP1``, ``P[3]``, ``FP1.BASE_NO``; upper case.

    `element` is its text between the brackets and `inside` where that stands; `field` is all that follows the first
    point (``BLOCK[2].Z``).
    """

    name: str
    element: str | None
    field: str | None
    start: int
    stop: int
    inside: tuple[int, int] = (0, 0)


class Call(Struct, frozen=True):
    """A function with the texts of its arguments' spans."""

    name: str
    arguments: tuple[tuple[int, int], ...]
    start: int
    stop: int

    def spelt(self, source: Source) -> str:
        """Return the name as the text has it."""
        return source.text[self.start : self.start + len(self.name)]


class Chain(Struct, frozen=True):
    """Frames joined by the geometric operator ``:``."""

    operands: tuple[Value, ...]
    start: int
    stop: int


class Operation(Struct, frozen=True):
    """Two numbers joined by ``+ - * /``; `left` is None where the operator is a sign."""

    operator: str
    left: Value | None
    right: Value
    start: int
    stop: int


class Opaque(Struct, frozen=True):
    """What is computed while the program runs: comparisons, logic, text."""

    start: int
    stop: int


class Aggregate(Struct, frozen=True, eq=False):
    """``{TAG: NAME value, …}``.

    :param source: the file it stands in.
    :param start: offset of ``{``.
    :param stop: offset behind ``}``.
    :param tag: ``E6POS`` of ``{E6POS: …}``, upper case; empty if there is none.
    :param items: component (upper case) → value.
    :param computed: True when an assignment to a component changed it, so that no text holds its numbers.
    """

    source: Source
    start: int
    stop: int
    tag: str
    items: Mapping[str, Value]
    computed: bool = False


Value = Number | Word | Reference | Call | Chain | Operation | Opaque | Aggregate
