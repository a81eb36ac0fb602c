"""Values as KRL writes them: numbers, aggregates, variables, chains of frames, conditions; with their places in text.

Offsets count characters from the beginning of the document.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from msgspec import Struct

from postproc.dialects.krl.language.source import Source
from postproc.errors import ProgramError


class Number(Struct, frozen=True):
    """A number.

    `is_integer` is True where it may be an INT: KRL divides two of these without a remainder.
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

    :param indices: of an element; empty for ``P[ ]``, which is the whole array; None without brackets.
    :param field: all that follows the first point (``BLOCK[2].Z``).
    :param inner: values in the brackets of `field`.
    :param is_bracketed: it is in brackets: a routine that gets it cannot write it.
    """

    name: str
    indices: tuple[Value, ...] | None
    field: str | None
    start: int
    stop: int
    inner: tuple[Value, ...] = ()
    is_bracketed: bool = False


class Call(Struct, frozen=True):
    """A function with its arguments."""

    name: str
    arguments: tuple[Value, ...]
    start: int
    stop: int

    def spelling(self, source: Source) -> str:
        """Return the name of the function as the text spells it."""
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

    :param negated: whether NOT is before each.
    :param operators: between them, upper case.
    """

    terms: tuple[Value, ...]
    negated: tuple[bool, ...]
    operators: tuple[str, ...]
    start: int
    stop: int


class OpaqueText(Struct, frozen=True):
    """Text that is not understood as a value, perhaps empty.

    :param values: calls in it.
    :param excess_start: where the text begins that follows a value and does not belong to it; −1 if there is none.
    """

    start: int
    stop: int
    values: tuple[Value, ...] = ()
    excess_start: int = -1


class UnreadableText(Struct, frozen=True, eq=False):
    """Text that cannot be a value.

    :param error: why.
    :param values: calls in it; None where its brackets are not balanced.
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
    :param is_computed: True when an assignment to a component changed it, so that no text holds its numbers.
    :param row: of the execution trace whose statement contains it; 0 in data lists, and in the statement of a motion.
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
    """Return the values that a value is made of, in the order of the text.

    :raises ProgramError: brackets are not balanced.
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
    """Yield values and all that they are made of, in the order of the text.

    :raises ProgramError: as for `parts`.
    """
    for value in values:
        yield value
        yield from walk(parts(value))


def writable_variable(argument: Value) -> Reference | None:
    """Return the variable that a routine may write through an argument; None if there is none, as for ``(A)``."""
    return argument if isinstance(argument, Reference) and not argument.is_bracketed else None
