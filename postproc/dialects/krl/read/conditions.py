"""Whether a condition holds, as far as that is known before the program runs.

KRL ranks NOT first, then * / + −, AND, EXOR, OR, and comparisons last. Where brackets are left out so that this order
matters, a condition counts as known only if comparing first is the only way in which it makes sense.
"""

from __future__ import annotations

import re

import numpy as np

from postproc.dialects.krl.language.brackets import matching, skip_blanks, split
from postproc.dialects.krl.language.expressions import arithmetic
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.statements import calls
from postproc.dialects.krl.language.values import Number, Opaque, Word
from postproc.dialects.krl.read.known import Known
from postproc.dialects.krl.read.variables import Variables
from postproc.errors import ProgramError

_OPERATOR = re.compile(r"==|<>|<=|>=|<|>|(?:AND|OR|EXOR)\b", re.IGNORECASE)
_NOT = re.compile(r"NOT\b", re.IGNORECASE)
_LOGIC = ("AND", "EXOR", "OR")
_CLOSE = 1e-5
"""REALs that differ by less than this share may compare otherwise on a controller, which has fewer digits."""

Term = bool | Number | Word | None


def truth(variables: Variables, source: Source, start: int, stop: int) -> bool | None:
    """Return whether a condition holds; None where that is not known before the program runs."""
    try:
        if calls(source, start, stop):
            return None
        value, end = _condition(variables, source, start, stop)
    except ProgramError:
        return None
    return value if isinstance(value, bool) and skip_blanks(source.text, end, stop) == stop else None


def chosen(variables: Variables, source: Source, value: Known, start: int, stop: int) -> bool | None:
    """Return whether one of the values behind CASE is that of its SWITCH; None where that is not known."""
    found: bool | None = False
    for begin, end in split(source, start, stop):
        other, beyond = _term(variables, source, begin, end)
        same = _compared("==", _plain(value), other) if not source.text[beyond:end].strip() else None
        if same:
            return True
        found = None if same is None else found
    return found


def _condition(variables: Variables, source: Source, start: int, stop: int) -> tuple[Term, int]:
    """Return the value of terms joined by operators, and the offset behind it."""
    text = source.text
    terms: list[Term] = []
    negated: list[bool] = []
    operators: list[str] = []
    position = start
    while True:
        position, inverse = skip_blanks(text, position, stop), False
        while match := _NOT.match(text, position, stop):
            inverse = not inverse
            position = skip_blanks(text, match.end(), stop)
        term, position = _term(variables, source, position, stop)
        if inverse:
            term = not term if isinstance(term, bool) else None
        terms.append(term)
        negated.append(inverse)
        following = _OPERATOR.match(text, skip_blanks(text, position, stop), stop)
        if not following:
            return _joined(terms, negated, operators), position
        operators.append(following[0].upper())
        position = following.end()


def _joined(terms: list[Term], negated: list[bool], operators: list[str]) -> Term:
    mixed = any(operator in _LOGIC for operator in operators)
    index = 0
    while index < len(operators):
        if operators[index] in _LOGIC:
            index += 1
            continue
        left, right = terms[index], terms[index + 1]
        if negated[index] or negated[index + 1]:
            return None
        if mixed and (isinstance(left, bool) or isinstance(right, bool)):
            return None
        terms[index : index + 2] = [_compared(operators[index], left, right)]
        negated[index : index + 2] = [False]
        del operators[index]
        if index < len(operators) and operators[index] not in _LOGIC:
            return None  # a comparison of a comparison
    for logic in _LOGIC:
        while logic in operators:
            at = operators.index(logic)
            terms[at : at + 2] = [_logical(logic, terms[at], terms[at + 1])]
            del operators[at]
    return terms[0]


def _logical(operator: str, left: Term, right: Term) -> bool | None:
    known = [side for side in (left, right) if isinstance(side, bool)]
    if operator == "AND":
        return False if False in known else True if len(known) == 2 else None
    if operator == "OR":
        return True if True in known else False if len(known) == 2 else None
    return known[0] != known[1] if len(known) == 2 else None


def _term(variables: Variables, source: Source, start: int, stop: int) -> tuple[Term, int]:
    """Return a value without operators of logic or comparison, and the offset behind it."""
    value, end = arithmetic(source, start, stop)
    if isinstance(value, Opaque) and source.text[value.start : value.start + 1] == "(":
        close = matching(source, value.start, stop)
        inner, beyond = _condition(variables, source, value.start + 1, close)
        return (inner if skip_blanks(source.text, beyond, close) == close else None), close + 1
    return _plain(variables.evaluate(source, value)), end


def _plain(known: Known) -> Term:
    if isinstance(known, Word) and known.text in ("TRUE", "FALSE"):
        return known.text == "TRUE"
    return known if isinstance(known, Number | Word) else None


def _compared(operator: str, left: Term, right: Term) -> bool | None:
    if isinstance(left, Number) and isinstance(right, Number):
        return _numbers(operator, left, right)
    if left is None or right is None or operator not in ("==", "<>") or type(left) is not type(right):
        return None
    one, other = (side.text if isinstance(side, Word) else side for side in (left, right))
    return (one == other) == (operator == "==")


def _numbers(operator: str, left: Number, right: Number) -> bool | None:
    a, b = left.value, right.value
    if not (left.integer and right.integer):
        close = abs(a - b) <= _CLOSE * max(1.0, abs(a), abs(b))
        if close and not (a == b and float(np.float32(a)) == a):
            return None
    return {"==": a == b, "<>": a != b, "<": a < b, ">": a > b, "<=": a <= b, ">=": a >= b}[operator]
