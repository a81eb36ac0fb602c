"""Values as KRL writes them: numbers, aggregates, variables, chains of frames, conditions; with their spans.

Offsets count characters from the beginning of the document.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from msgspec import Struct

from postproc.dialects.krl.language.source import Source
from postproc.errors import ProgramError


class Number(Struct, frozen=True):
    """A number.

    :param is_integer: True if it may be an INT: KRL divides two INTs without a remainder.
    """

    value: float
    start: int
    stop: int
    is_integer: bool = False


class Word(Struct, frozen=True):
    """An enumeration value (``#BASE``), a string with its quotes, TRUE or FALSE; upper case but for strings."""

    text: str
    start: int
    stop: int


class Reference(Struct, frozen=True):
    """A variable: ``XP1``, ``P[3]``, ``FP1.BASE_NO``; upper case.

    :param indices: indices of an array element; empty for ``P[ ]``, the whole array; None without brackets.
    :param field: text behind the first point, such as ``BLOCK[2].Z``; None without a point.
    :param inner: values in the brackets of `field`.
    :param is_bracketed: True for ``(A)``: a routine with this argument cannot write the variable.
    """

    name: str
    indices: tuple[Value, ...] | None
    field: str | None
    start: int
    stop: int
    inner: tuple[Value, ...] = ()
    is_bracketed: bool = False


class Call(Struct, frozen=True):
    """A call of a routine or a function, with its arguments."""

    name: str
    arguments: tuple[Value, ...]
    start: int
    stop: int

    def spelling(self, source: Source) -> str:
        """Return the called name as the text spells it."""
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


class Condition(Struct, frozen=True):
    """Terms joined by comparisons and logic, in the order of the text; one term alone if it is in brackets.

    :param negated: for each term, whether NOT precedes it.
    :param operators: operators between the terms, upper case.
    """

    terms: tuple[Value, ...]
    negated: tuple[bool, ...]
    operators: tuple[str, ...]
    start: int
    stop: int


class OpaqueText(Struct, frozen=True):
    """Text that is not understood as a value, perhaps empty.

    :param values: calls in the text.
    :param excess_start: offset of the text that follows a readable value; −1 if there is no readable value.
    """

    start: int
    stop: int
    values: tuple[Value, ...] = ()
    excess_start: int = -1


class UnreadableText(Struct, frozen=True, eq=False):
    """Text that cannot be a value.

    :param error: reason.
    :param values: calls in the text; None if its brackets are not balanced.
    """

    start: int
    stop: int
    error: ProgramError
    values: tuple[Value, ...] | None = None


class Aggregate(Struct, frozen=True, eq=False):
    """``{TAG: NAME value, …}``.

    :param source: the file that contains it.
    :param start: offset of ``{``.
    :param stop: offset behind ``}``.
    :param tag: ``E6POS`` of ``{E6POS: …}``, upper case; empty if there is none.
    :param items: component (upper case) → value.
    :param is_computed: True if an assignment to a component changed it, so that its numbers are not in the text.
    :param row: row of the execution trace whose statement contains it; 0 in data lists, and in motion statements.
    """

    source: Source
    start: int
    stop: int
    tag: str
    items: Mapping[str, Value]
    is_computed: bool = False
    row: int = 0


_TEXT = (OpaqueText, UnreadableText)
Value = Number | Word | Reference | Call | Chain | Operation | Condition | OpaqueText | UnreadableText | Aggregate


def parts(value: Value) -> Iterable[Value]:
    """Return the values that a value directly contains, in the order of the text.

    :raises ProgramError: the value is an `UnreadableText` whose brackets are not balanced.
    """
    if isinstance(value, Reference):
        return (*value.indices, *value.inner) if value.indices else value.inner
    if isinstance(value, Aggregate):
        return value.items.values()
    if isinstance(value, Call):
        return value.arguments
    if isinstance(value, Operation):
        return (value.right,) if value.left is None else (value.left, value.right)
    if isinstance(value, Chain):
        return value.operands
    if isinstance(value, Condition):
        return value.terms
    if isinstance(value, UnreadableText) and value.values is None:
        raise value.error
    return (value.values or ()) if isinstance(value, _TEXT) else ()


def walk(values: Iterable[Value]) -> Iterator[Value]:
    """Yield values, each followed by all values inside it, in the order of the text.

    :raises ProgramError: as for `parts`.
    """
    for value in values:
        yield value
        yield from walk(parts(value))


def writable_variable(argument: Value) -> Reference | None:
    """Return the variable that a routine may write through an argument; None for ``(A)`` and other values."""
    return argument if isinstance(argument, Reference) and not argument.is_bracketed else None
