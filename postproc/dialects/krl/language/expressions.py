"""From a piece of code to a value: the grammar of KRL's expressions."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from typing import NamedTuple, NoReturn

from msgspec.structs import replace

from postproc.dialects.krl.language.names import PURE, RESERVED
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import (
    COMPONENT,
    ENUM,
    FIELD,
    INTEGER_LITERAL,
    ITEM_NAME,
    LOGIC,
    NAME,
    NUMBER,
    NUMBER_PATTERN,
    STRING,
    TAG,
    literal_value,
    operator_at,
    read_negations,
    skip_blanks,
    skip_sign,
    word_at,
    words_in,
)
from postproc.dialects.krl.language.values import (
    Aggregate,
    Call,
    Chain,
    Condition,
    Number,
    OpaqueText,
    Operation,
    Reference,
    UnreadableText,
    Value,
    Word,
    parts,
)
from postproc.errors import ProgramError

_LEAVES = (Number, Word)
_MOST_TERMS = 200
"""Largest number of terms of an expression: no program has more, and a deeper tree exceeds the limit of recursion."""
_MAX_INT_LENGTH = 64
"""Characters of the longest INT in binary or hexadecimal notation."""
_VALUE_ENDS = ",)]}cC"
"""Characters behind a value that no operator begins with; C begins an approximation such as C_DIS."""
_INDEX = re.compile(r"\[(?:(?P<name>[A-Za-z_$][\w$]*)|(?P<number>[0-9]{1,9}))\]", re.ASCII)
"""An index that is one name or one whole number; nearly all indices are."""
_VALUE_WORDS = frozenset({"TRUE", "FALSE", "NOT", "B_NOT"})
"""Words in expressions that are no names of variables."""
_POSE = re.compile(
    r"\{"
    + ",".join(rf"[ \t]*{name}(?=[ \t+-])[ \t]*(?P<{name}>{NUMBER_PATTERN})[ \t]*" for name in "XYZABC")
    + r"(?=(?P<sign>[,}]))",
    re.ASCII | re.IGNORECASE,
)
"""The beginning of an aggregate that gives X, Y, Z, A, B, C as numbers, in this order."""
_CLOSING_BRACKETS = {"(": ")", "[": "]", "{": "}"}
_MAX_DEPTH = 100
"""Largest number of nested brackets: no program has more, and a deeper tree exceeds the limit of recursion."""

_Read = tuple[Value, int]
"""A value, and the offset behind its text."""


def value_in(source: Source, start: int, stop: int) -> Value:
    """Return the value of a piece of code.

    `UnreadableText`: the code cannot be read. `OpaqueText`: it is no known expression, or more text follows.

    :param start: offset of the piece in the file; `stop` the offset after it.
    """
    start = skip_blanks(source.text, start, stop)
    try:
        value, end = value_at(source, start, stop)
    except ProgramError as error:
        return unreadable_text(source, start, stop, error)
    next_start = skip_blanks(source.text, end, stop)
    return value if next_start == stop else opaque_text(source, start, stop, next_start)


def value_at(source: Source, start: int, stop: int) -> _Read:
    """Return the value that begins at `start`, and the offset behind it; `OpaqueText` if it is no known expression.

    The fastest reading is tried first: a single operand, then a sum, then a condition.

    :raises ProgramError: braces or brackets are not balanced, an aggregate is not well formed.
    """
    text = source.text
    begin = skip_blanks(text, start, stop)
    is_negated = text[begin : begin + 1] in ("N", "n") and word_at(text, begin, stop) == "NOT"
    first = None  # the first term and the offset behind it, once it is read
    if begin < stop and text[begin] not in "+-" and not is_negated:
        first = operand_at(source, begin, stop)
        _, end = first
        next_offset = skip_blanks(text, end, stop)
        if next_offset == stop or text[next_offset] in _VALUE_ENDS:
            return first  # a single operand, the most common case: the search for operators is skipped
    if not is_negated:
        first = sum_at(source, begin, stop, first)
        _, end = first
        next_offset = skip_blanks(text, end, stop)
        if next_offset == stop or not LOGIC.match(text, next_offset, stop):
            return first
    try:
        value, end = condition_at(source, begin, stop, first)
        next_offset = skip_blanks(text, end, stop)
        if next_offset == stop or text[next_offset] in ",)]}":
            return value, end
    except ProgramError:
        _, end = first or (None, begin)  # no condition: the text behind the first term is not read
    end = value_end(source, end, stop)
    return opaque_text(source, begin, end), end


def condition_at(source: Source, start: int, stop: int, first: _Read | None = None) -> _Read:
    """Return terms joined by comparisons and logic, such as ``A>1 AND NOT B``, and the offset behind them.

    :param first: the first term and the offset behind it, if it has been read already; no NOT precedes it.
    :raises ProgramError: as for `value_at`.
    """
    terms: list[Value] = []
    negations: list[bool] = []
    operators: list[str] = []
    begin = start
    while True:
        is_negated, start = (False, start) if first is not None else read_negations(source.text, start, stop)
        term, end = first or sum_at(source, start, stop)
        first = None  # the other terms have not been read
        terms.append(term)
        negations.append(is_negated)
        operator, operator_end = operator_at(source.text, end, stop)
        if not operator:
            return Condition(tuple(terms), tuple(negations), tuple(operators), begin, end), end
        operators.append(operator)
        start = operator_end


def sum_at(source: Source, start: int, stop: int, first: _Read | None = None) -> _Read:
    """Return a sum or a single value, and the offset behind it.

    It ends before a comparison, a logical operator or any other text.

    :param first: the first operand and the offset behind it, if it has been read already.
    :raises ProgramError: as for `value_at`.
    """
    return _operations_of_one_rank(source, start, stop, first, "+-", _product)


def _product(source: Source, start: int, stop: int, first: _Read | None) -> _Read:
    """Return factors joined by ``*`` and ``/``, from left to right, and the offset behind them.

    :param first: the first operand and the offset behind it, if it has been read already.
    :raises ProgramError: as for `value_at`.
    """
    return _operations_of_one_rank(source, start, stop, first, "*/", _factor)


def _operations_of_one_rank(
    source: Source,
    start: int,
    stop: int,
    first: _Read | None,
    operators: str,
    read_operand: Callable[[Source, int, int, _Read | None], _Read],
) -> _Read:
    """Return operands joined by operators of one rank, evaluated from left to right, and the offset behind them.

    :param first: the first value and the offset behind it, if it has been read already.
    :param operators: the characters of these operators, such as ``+-``.
    :param read_operand: reads one operand, including operators of higher rank.
    :raises ProgramError: there are more than `_MOST_TERMS` operands, or an operand cannot be read.
    """
    text = source.text
    value, end = read_operand(source, start, stop, first)
    next_offset, terms = skip_blanks(text, end, stop), 1
    while next_offset < stop and text[next_offset] in operators:
        terms += 1
        if terms > _MOST_TERMS:
            raise source.error(f"an expression has more than {_MOST_TERMS} terms", start, "Write it as several.")
        right, end = read_operand(source, next_offset + 1, stop, None)
        value = Operation(text[next_offset], value, right, value.start, end)
        next_offset = skip_blanks(text, end, stop)
    return value, end


def _factor(source: Source, start: int, stop: int, first: _Read | None) -> _Read:
    """Return a value with its sign, or frames joined by ``:``, and the offset behind it.

    The sign of a plain number is a part of the number.

    :param first: the first operand and the offset behind it, if it has been read already.
    :raises ProgramError: as for `value_at`, and for two signs in a row.
    """
    text = source.text
    start = skip_blanks(text, start, stop)
    if text[start:stop][:1] in ("+", "-") and not NUMBER.match(text, start, stop):
        if text[skip_blanks(text, start + 1, stop) : stop][:1] in ("+", "-"):
            raise source.error("two signs in a row", start, advice="Put the second sign and its value in brackets.")
        value, end = _factor(source, start + 1, stop, None)
        return Operation(text[start], None, value, start, end), end
    value, end = first or operand_at(source, start, stop)
    next_offset = skip_blanks(text, end, stop)
    if next_offset < stop and text[next_offset] == ":":
        operands: list[Value] = [value]
        while next_offset < stop and text[next_offset] == ":":
            value, end = operand_at(source, next_offset + 1, stop)
            operands.append(value)
            next_offset = skip_blanks(text, end, stop)
        value = Chain(tuple(operands), operands[0].start, end)
    return value, end


def operand_at(source: Source, start: int, stop: int) -> _Read:
    """Return the single operand that begins at `start`, and the offset behind it.

    It is a name, a number, a string, an aggregate or an expression in brackets; other text is `OpaqueText`.

    :raises ProgramError: as for `value_at`.
    """
    text = source.text
    start = skip_blanks(text, start, stop)
    if start >= stop:
        raise source.error(
            "a value is missing", min(start, len(text) - 1), advice="Write a number, a name or an expression there."
        )
    first = text[start]
    if first == "{":
        aggregate = parse_aggregate(source, start, stop)
        return aggregate, aggregate.stop
    if match := NAME.match(text, start, stop):
        if match[0].upper() == "B_NOT":
            value, end = operand_at(source, match.end(), stop)
            return Operation("B_NOT", None, value, start, end), end
        return _variable(source, match, stop)
    if first == "(":
        return _bracketed_value(source, start, stop)
    if match := NUMBER.match(text, start, stop):
        is_whole = match[0].lstrip("+-").isdigit()
        return Number(_finite_number(source, match), start, match.end(), is_whole), match.end()
    if match := INTEGER_LITERAL.match(text, start, stop):
        if match.end() - start > _MAX_INT_LENGTH:
            raise source.error(f"{match[0][:20]}… is not an INT", start, advice="Write the number in decimal notation.")
        return Number(float(literal_value(match)), start, match.end(), True), match.end()
    if match := STRING.match(text, start, stop):
        return Word(match[0], start, match.end()), match.end()
    if match := ENUM.match(text, start, stop):
        return Word(match[0].upper(), start, match.end()), match.end()
    end = value_end(source, start, stop)
    return opaque_text(source, start, end), end


def _bracketed_value(source: Source, start: int, stop: int) -> _Read:
    """Return the value in the bracket at `start`, with the span of the bracket, and the offset behind the bracket.

    Words, calls and aggregates become a `Condition` of one term, whose span is that of the bracket.

    :raises ProgramError: the value cannot be read.
    """
    close = closing_bracket(source, start, stop)
    value = value_in(source, start + 1, close)
    if isinstance(value, UnreadableText):
        raise value.error
    if isinstance(value, Reference):
        return replace(value, start=start, stop=close + 1, is_bracketed=True), close + 1
    if isinstance(value, Number | Operation | Condition | OpaqueText | Chain):
        return replace(value, start=start, stop=close + 1), close + 1
    return Condition((value,), (False,), (), start, close + 1), close + 1


def _variable(source: Source, name: re.Match[str], stop: int) -> _Read:
    """Return the variable, function call, TRUE or FALSE that begins with a name, and the offset behind it.

    :param name: match of the name in the text of the file.
    :raises ProgramError: a bracket is not closed.
    """
    text, start, end, upper_name = source.text, name.start(), name.end(), name[0].upper()
    if upper_name in ("TRUE", "FALSE"):
        return Word(upper_name, start, end), end
    next_offset = skip_blanks(text, end, stop)
    if next_offset == stop or text[next_offset] not in "([.":
        return Reference(upper_name, None, None, start, end), end
    if text[next_offset] == "(":
        close = closing_bracket(source, next_offset, stop)
        return Call(upper_name, list_values(source, next_offset + 1, close), start, close + 1), close + 1
    indices: tuple[Value, ...] | None = None
    inner: tuple[Value, ...] = ()
    members: list[str] = []
    while True:  # [indices] of the variable, then any number of .member, each with its own [indices]
        next_offset = skip_blanks(text, end, stop)
        if indices is None and not members and (index := _index(text, next_offset, stop)) is not None:
            indices, end = index
        elif next_offset < stop and text[next_offset] == "[":
            close = closing_bracket(source, next_offset, stop)
            if members:
                members[-1] += text[next_offset : close + 1].upper()
                inner += list_values(source, next_offset + 1, close)
            elif indices is None:
                indices = list_values(source, next_offset + 1, close)
            else:
                break
            end = close + 1
        elif match := FIELD.match(text, end, stop):
            members.append(match["name"].upper())
            end = match.end()
        else:
            break
    return Reference(upper_name, indices, ".".join(members) or None, start, end, inner), end


def _index(text: str, start: int, stop: int) -> tuple[tuple[Value, ...], int] | None:
    """Return the index in the bracket at `start`, and the offset behind the bracket; None if the index is not simple.

    A simple index is one name or one whole number, see `_INDEX`.
    """
    match = _INDEX.match(text, start, stop)
    if match is None:
        return None
    begin, end = start + 1, match.end() - 1
    if match["number"]:
        return (Number(float(match["number"]), begin, end, True),), match.end()
    name = match["name"].upper()
    return None if name in _VALUE_WORDS else ((Reference(name, None, None, begin, end),), match.end())


def list_values(source: Source, start: int, stop: int) -> tuple[Value, ...]:
    """Return the values between the commas of a list; an empty tuple for an empty list.

    A value that is left out, as in ``P[1,]``, is an `OpaqueText`.

    :raises ProgramError: brackets are not balanced.
    """
    text = source.text
    if text[start:stop].isalnum():
        return (value_in(source, start, stop),)  # one name or number, the most common case
    return tuple(
        value_in(source, begin, end) if text[begin:end].strip() else OpaqueText(begin, end)
        for begin, end in list_spans(source, start, stop)
    )


def opaque_text(source: Source, start: int, stop: int, excess_start: int = -1) -> OpaqueText:
    """Return a piece of code that is not understood, with the calls in it.

    :param excess_start: offset of the text that follows a readable value; −1 if the code does not begin with a value.
    :raises ProgramError: brackets are not balanced.
    """
    return OpaqueText(start, stop, _calls_in(source, start, stop), excess_start)


def unreadable_text(source: Source, start: int, stop: int, error: ProgramError) -> UnreadableText:
    """Return a piece of code that cannot be read, with the error, and the calls in it if they can be read."""
    try:
        return UnreadableText(start, stop, error, _calls_in(source, start, stop))
    except ProgramError:
        return UnreadableText(start, stop, error)


def _calls_in(source: Source, start: int, stop: int) -> tuple[Call, ...]:
    """Return the calls of routines in a piece of code, from left to right. Arguments of these calls are not searched.

    Without an opening bracket there is no call: most pieces of code need no search.

    :raises ProgramError: brackets are not balanced.
    """
    text, call_list = source.text, list[Call]()
    if "(" not in text[start:stop]:
        return ()
    for word, span in words_in(text, start, stop):
        is_call = span.start >= start and _is_routine(word) and skip_sign(text, span.stop, stop, "(") >= 0
        value, end = operand_at(source, span.start, stop) if is_call else (None, start)
        if isinstance(value, Call):
            call_list.append(value)
            start = end  # words in its arguments are before `start`
    return tuple(call_list)


def _is_routine(name: str) -> bool:
    """Return whether a name, upper case, before a bracket may be a routine of a program.

    Words of KRL and functions of the controller that change nothing are none.
    """
    return "$" not in name and name not in RESERVED and name not in PURE


def calls(values: Iterable[Value]) -> list[Call]:
    """Return the calls of routines in values, from left to right, each before the calls in its arguments.

    Calls of the functions of the controller that only compute a value (`PURE`) are left out.
    """
    call_list: list[Call] = []
    for value in values:
        if isinstance(value, _LEAVES) or (isinstance(value, Reference) and not value.indices and not value.inner):
            continue  # nearly all values: they contain no others
        if isinstance(value, Call) and _is_routine(value.name):
            call_list.append(value)
        if inner := parts(value):
            call_list += calls(inner)
    return call_list


def parse_aggregate(source: Source, start: int, stop: int) -> Aggregate:
    """Return the aggregate whose ``{`` is at `start`, such as ``{X 1,Y 2}`` or ``{E6POS: X 1,Y 2}``.

    Its components are read in three ways, the fastest first: a pose of six numbers, a number, any value.

    :raises ProgramError: it is not closed, a comma or a component's name is missing, a component is given twice, a
        number is not finite.
    """
    text, tag = source.text, ""
    items, has_next, position = _pose_components(text, start, stop)
    if not items and (match := TAG.match(text, position, stop)):
        tag, position = match["tag"].upper(), match.end()
    while has_next:
        match = COMPONENT.match(text, position, stop)
        if match:
            literal = match["number"]
            name, has_next, position = match["name"].upper(), match["comma"] is not None, match.end()
            number = float(literal)
            if number - number != 0.0:  # infinite: the call raises the error with its place
                number = _finite_number(source, match, "number")
            value: Value = Number(number, *match.span("number"), literal.lstrip("+-").isdigit())
        else:
            name, value, has_next, position = _component(source, start, position, stop)
        if name in items:
            raise source.error(f"component {name} is given twice", position - 1, advice="Remove one of them.")
        items[name] = value
    position = skip_blanks(text, position, stop)
    return Aggregate(source, start, position + 1, tag, items)


class _Components(NamedTuple):
    """The first components of an aggregate.

    :ivar items: component, upper case → value.
    :ivar has_next: True if another component follows.
    :ivar stop: offset behind these components and the comma that follows.
    """

    items: dict[str, Value]
    has_next: bool
    stop: int


def _pose_components(text: str, start: int, stop: int) -> _Components:
    """Return X, Y, Z, A, B, C of an aggregate that begins with these six as finite numbers in this order.

    No components for any other aggregate.

    :param start: offset of the opening brace.
    """
    match = _POSE.match(text, start, stop)
    if match is None:
        return _Components({}, True, start + 1)
    items: dict[str, Value] = {}
    for name in "XYZABC":
        literal = match[name]
        number = float(literal)
        if number - number != 0.0:  # infinite; faster than a call of math.isfinite
            return _Components({}, True, start + 1)
        items[name] = Number(number, *match.span(name), literal.lstrip("+-").isdigit())
    has_comma = match["sign"] == ","
    return _Components(items, has_comma, match.end() + has_comma)


class _Component(NamedTuple):
    """A component of an aggregate.

    :ivar name: upper case.
    :ivar has_comma: True if a comma follows it.
    :ivar stop: offset behind the component and this comma.
    """

    name: str
    value: Value
    has_comma: bool
    stop: int


def _component(source: Source, opening: int, position: int, stop: int) -> _Component:
    """Return a component of an aggregate that is not a plain number.

    :param opening: offset of the opening brace; `position` the offset of the component.
    :raises ProgramError: the component has no name, no value or no comma after it, or is not finite.
    """
    text = source.text
    match = ITEM_NAME.match(text, position, stop)
    if not match:
        _raise_aggregate_error(source, opening, position, stop, "a component such as 'X 12.5' is expected")
    name = match["name"].upper()
    if match.end() >= stop or text[match.end()] in ",}":
        _raise_aggregate_error(source, opening, match.end(), stop, f"component {name} has no value")
    value, end = value_at(source, match.end(), stop)
    end = skip_blanks(text, end, stop)
    if isinstance(value, Reference) and value.name in ("NAN", "INF", "INFINITY"):
        raise source.error(
            f"component {name} is not a finite number", value.start, advice="Write it as a finite number."
        )
    if end >= stop or text[end] not in ",}":
        _raise_aggregate_error(source, opening, end, stop, f"a comma is missing after component {name}")
    has_comma = text[end] == ","
    return _Component(name, value, has_comma, end + has_comma)


def _raise_aggregate_error(source: Source, opening: int, position: int, stop: int, problem: str) -> NoReturn:
    """Raise the error in an aggregate.

    :param opening: offset of its ``{``; `position` the offset of the problem.
    :param problem: message if the brace is closed.
    :raises ProgramError: always. A brace that is not closed is named as the problem in place of `problem`.
    """
    if skip_blanks(source.text, position, stop) >= stop or "}" not in source.text[position:stop]:
        raise source.error("the brace { is not closed", opening, "Check that the file is complete.")
    raise source.error(problem, position)


def _finite_number(source: Source, match: re.Match[str], group: str | int = 0) -> float:
    """Return the number in a group of a match in the text of a file.

    :raises ProgramError: it is not finite.
    """
    value = float(match[group])
    if not math.isfinite(value):
        raise source.error(
            f"{match[group][:40]} is not a finite number", match.start(group), advice="Write it as a finite number."
        )
    return value


# --- brackets --------------------------------------------------------------------------------------------------------


def closing_bracket(source: Source, start: int, stop: int) -> int:
    """Return the offset of the bracket that closes the one at `start`; brackets in strings do not count.

    :raises ProgramError: no bracket closes it before `stop`, or brackets are nested too deeply.
    """
    text = source.text
    closing_signs: list[str] = []
    offset = start
    while offset < stop:
        char = text[offset]
        if char == '"':
            offset = text.find('"', offset + 1, stop)
            if offset < 0:
                break
        elif char in _CLOSING_BRACKETS:
            closing_signs.append(_CLOSING_BRACKETS[char])
            if len(closing_signs) > _MAX_DEPTH:
                raise source.error(
                    f"more than {_MAX_DEPTH} brackets are nested", start, "Write it as several statements."
                )
        elif char in ")]}":
            if closing_signs.pop() != char:
                break
            if not closing_signs:
                return offset
        offset += 1
    raise source.error(f"{text[start]} is not closed", start, "Check that the line is complete.")


def list_spans(source: Source, start: int, stop: int) -> list[tuple[int, int]]:
    """Return the spans between the commas of a list: (first offset, offset behind); no spans for an empty list.

    Commas in brackets and strings do not count.

    :raises ProgramError: a bracket or a string is not closed.
    """
    text = source.text
    spans: list[tuple[int, int]] = []
    begin = offset = start
    while offset < stop:
        char = text[offset]
        if char in _CLOSING_BRACKETS:
            offset = closing_bracket(source, offset, stop)
        elif char == '"':
            offset = text.find('"', offset + 1, stop)
            if offset < 0:
                raise source.error("a string is not closed", start, advice='Close it with " on the same line.')
        elif char == ",":
            spans.append((begin, offset))
            begin = offset + 1
        offset += 1
    if spans or text[start:stop].strip():
        spans.append((begin, stop))
    return spans


def value_end(source: Source, start: int, stop: int) -> int:
    """Return the offset behind a value that is not parsed: that of the first comma or closing bracket behind it.

    Commas and brackets inside brackets and strings do not count. `stop` if there is none, or if a string is not closed.

    :raises ProgramError: one of its brackets is not closed.
    """
    text, offset = source.text, start
    while offset < stop and text[offset] not in ",)]}":
        if text[offset] in _CLOSING_BRACKETS:
            offset = closing_bracket(source, offset, stop)
        elif text[offset] == '"':
            offset = text.find('"', offset + 1, stop)
            if offset < 0:
                return stop
        offset += 1
    return offset
