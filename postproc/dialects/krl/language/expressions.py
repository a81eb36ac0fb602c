"""From a piece of code to a value: the grammar of KRL's expressions."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import NoReturn

from msgspec.structs import replace

from postproc.dialects.krl.language.brackets import beyond, matching, skip_blanks, split
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
    STRING,
    TAG,
)
from postproc.dialects.krl.language.values import (
    Aggregate,
    Call,
    Chain,
    Number,
    Opaque,
    Operation,
    Reference,
    Value,
    Word,
)

_MOST_TERMS = 200
_LONGEST = 64
"""Characters of the longest INT in binary or hexadecimal notation."""
_ENDS = ",)]}cC"


def parse(source: Source, start: int, stop: int) -> tuple[Value, int]:
    """Return the value that begins at `start`, and the offset behind it.

    Comparisons and logic are `Opaque` and reach to the next comma or closing bracket.

    :raises ProgramError: braces or brackets are not balanced, an aggregate is not well formed.
    """
    begin = skip_blanks(source.text, start, stop)
    if begin < stop and source.text[begin] not in "+-":
        value, end = operand(source, begin, stop)
        after = skip_blanks(source.text, end, stop)
        if after == stop or source.text[after] in _ENDS:
            return value, end  # nothing is joined to it: so common that looking first is faster
    value, end = arithmetic(source, start, stop)
    after = skip_blanks(source.text, end, stop)
    if after < stop and LOGIC.match(source.text, after, stop):
        end = beyond(source, after, stop)
        return Opaque(value.start, end), end
    return value, end


def arithmetic(source: Source, start: int, stop: int) -> tuple[Value, int]:
    """Return the value that begins at `start`, up to what compares it or joins it to another by logic, and its end.

    :raises ProgramError: as for `parse`.
    """
    return _joined(source, start, stop, "+-", _product)


def _product(source: Source, start: int, stop: int) -> tuple[Value, int]:
    return _joined(source, start, stop, "*/", _factor)


def _joined(
    source: Source,
    start: int,
    stop: int,
    operators: str,
    part: Callable[[Source, int, int], tuple[Value, int]],
) -> tuple[Value, int]:
    """Return parts joined by operators, from left to right."""
    text = source.text
    value, end = part(source, start, stop)
    after, terms = skip_blanks(text, end, stop), 1
    while after < stop and text[after] in operators:
        terms += 1
        if terms > _MOST_TERMS:
            raise source.error(f"an expression has more than {_MOST_TERMS} terms", start, "Write it as several.")
        right, end = part(source, after + 1, stop)
        value = Operation(text[after], value, right, value.start, end)
        after = skip_blanks(text, end, stop)
    return value, end


def _factor(source: Source, start: int, stop: int) -> tuple[Value, int]:
    """Return a value with its sign, or frames joined by ``:``."""
    text = source.text
    start = skip_blanks(text, start, stop)
    if text[start:stop][:1] in ("+", "-") and not NUMBER.match(text, start, stop):
        if text[skip_blanks(text, start + 1, stop) : stop][:1] in ("+", "-"):
            raise source.error("two signs in a row", start)
        value, end = _factor(source, start + 1, stop)
        return Operation(text[start], None, value, start, end), end
    value, end = operand(source, start, stop)
    after = skip_blanks(text, end, stop)
    if after < stop and text[after] == ":":
        operands: list[Value] = [value]
        while after < stop and text[after] == ":":
            value, end = operand(source, after + 1, stop)
            operands.append(value)
            after = skip_blanks(text, end, stop)
        value = Chain(tuple(operands), operands[0].start, end)
    return value, end


def operand(source: Source, start: int, stop: int) -> tuple[Value, int]:
    """Return the value that begins at `start`, without what ``:`` or an operator joins to it, and the offset behind."""
    text = source.text
    start = skip_blanks(text, start, stop)
    if start >= stop:
        raise source.error("a value is missing", min(start, len(text) - 1))
    first = text[start]
    if first == "{":
        aggregate = parse_aggregate(source, start, stop)
        return aggregate, aggregate.stop
    if match := NAME.match(text, start, stop):
        return _variable(source, match, stop)
    if first == "(":
        return _in_brackets(source, start, stop)
    if match := NUMBER.match(text, start, stop):
        return Number(_finite(source, match), start, match.end(), match[0].lstrip("+-").isdigit()), match.end()
    if match := INTEGER_LITERAL.match(text, start, stop):
        if match.end() - start > _LONGEST:
            raise source.error(f"{match[0][:20]}… is not an INT", start)
        value = float(int(match[1], 2) if match[1] else int(match[2], 16))
        return Number(value, start, match.end(), True), match.end()
    if match := STRING.match(text, start, stop):
        return Word(match[0], start, match.end()), match.end()
    if match := ENUM.match(text, start, stop):
        return Word(match[0].upper(), start, match.end()), match.end()
    end = beyond(source, start, stop)
    return Opaque(start, end), end


def _in_brackets(source: Source, start: int, stop: int) -> tuple[Value, int]:
    close = matching(source, start, stop)
    value, end = parse(source, start + 1, close)
    if skip_blanks(source.text, end, close) < close or not isinstance(value, Number | Reference | Operation):
        return Opaque(start, close + 1), close + 1
    return replace(value, start=start, stop=close + 1), close + 1


def _variable(source: Source, name: re.Match[str], stop: int) -> tuple[Value, int]:
    text, start, end = source.text, name.start(), name.end()
    if name[0].upper() in ("TRUE", "FALSE"):
        return Word(name[0].upper(), start, end), end
    after = skip_blanks(text, end, stop)
    if after < stop and text[after] == "(":
        close = matching(source, after, stop)
        inner = split(source, after + 1, close)
        return Call(name[0].upper(), tuple(inner), start, close + 1), close + 1
    element, inside = None, (0, 0)
    path: list[str] = []
    while True:
        after = skip_blanks(text, end, stop)
        if after < stop and text[after] == "[":
            close = matching(source, after, stop)
            if path:
                path[-1] += text[after : close + 1].upper()
            elif element is None:
                element, inside = text[after + 1 : close].strip().upper(), (after + 1, close)
            else:
                break
            end = close + 1
        elif match := FIELD.match(text, end, stop):
            path.append(match[1].upper())
            end = match.end()
        else:
            break
    return Reference(name[0].upper(), element, ".".join(path) or None, start, end, inside), end


def parse_aggregate(source: Source, start: int, stop: int) -> Aggregate:
    """Return the aggregate whose ``{`` stands at `start`.

    :raises ProgramError: it is not closed, a comma or a component's name is missing, a component stands twice, a
        number is not finite.
    """
    text = source.text
    position = start + 1
    tag = ""
    if match := TAG.match(text, position, stop):
        tag, position = match[1].upper(), match.end()
    items: dict[str, Value] = {}
    while True:
        match = COMPONENT.match(text, position, stop)
        if match:
            name, more, position = match[1].upper(), match[3] is not None, match.end()
            value: Value = Number(
                _finite(source, match, 2), match.start(2), match.end(2), match[2].lstrip("+-").isdigit()
            )
        else:
            name, value, more, position = _component(source, start, position, stop)
        if name in items:
            raise source.error(f"component {name} stands twice", position - 1)
        items[name] = value
        if not more:
            break
    position = skip_blanks(text, position, stop)
    return Aggregate(source, start, position + 1, tag, items)


def _component(source: Source, opening: int, position: int, stop: int) -> tuple[str, Value, bool, int]:
    """Return name and value of a component that is not a plain number, whether another follows, and where it ends."""
    text = source.text
    match = ITEM_NAME.match(text, position, stop)
    if not match:
        _not_closed_or(source, opening, position, stop, "a component such as 'X 12.5' is expected")
    name = match[1].upper()
    if match.end() >= stop or text[match.end()] in ",}":
        _not_closed_or(source, opening, match.end(), stop, f"component {name} has no value")
    value, end = parse(source, match.end(), stop)
    end = skip_blanks(text, end, stop)
    if isinstance(value, Reference) and value.name in ("NAN", "INF", "INFINITY"):
        raise source.error(f"component {name} is not a finite number", value.start)
    if end >= stop or text[end] not in ",}":
        _not_closed_or(source, opening, end, stop, f"a comma is missing after component {name}")
    return name, value, text[end] == ",", end + (text[end] == ",")


def _not_closed_or(source: Source, opening: int, position: int, stop: int, problem: str) -> NoReturn:
    if skip_blanks(source.text, position, stop) >= stop or "}" not in source.text[position:stop]:
        raise source.error("the brace { is not closed", opening, "Check that the file is complete.")
    raise source.error(problem, position)


def _finite(source: Source, match: re.Match[str], group: int = 0) -> float:
    value = float(match[group])
    if not math.isfinite(value):
        raise source.error(f"{match[group][:40]} is not a finite number", match.start(group))
    return value
