"""Whether a condition holds, as far as that is known before the program runs.

KRL ranks NOT first, then * / + −, AND, EXOR, OR, and comparisons last. Where brackets are left out so that this order
matters, a condition counts as known only if comparing first is the only way in which it makes sense.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.tree import Case, Statement
from postproc.dialects.krl.language.values import Condition, Number, Value, Word
from postproc.dialects.krl.read.known import Known
from postproc.dialects.krl.read.variables import Variables
from postproc.errors import ProgramError

_LOGIC = ("AND", "EXOR", "OR")
_CLOSE = 1e-5
"""REALs that differ by less than this share may compare otherwise on a controller, which has fewer digits."""

Term = bool | Number | Word | None


def truth(variables: Variables, condition: Value | None) -> bool | None:
    """Return whether a condition holds; None where that is not known before the program runs."""
    try:
        if condition is None or calls([condition]):
            return None
        value = _term(variables, condition)
    except ProgramError:
        return None
    return value if isinstance(value, bool) else None


def chosen(variables: Variables, value: Known, cases: Sequence[Value]) -> bool | None:
    """Return whether one of the values behind CASE is that of its SWITCH; None where that is not known."""
    found: bool | None = False
    for case in cases:
        same = _compared("==", _plain(value), _term(variables, case))
        if same:
            return True
        found = None if same is None else found
    return found


def constant_cases(heads: Sequence[Statement]) -> dict[float | None, int] | None:
    """Return which of the parts of a SWITCH is chosen by each integer; None: by any other, −2 if there is no DEFAULT.

    :param heads: the statements CASE and DEFAULT, in order.
    :returns: None if not all values are integer constants.
    """
    table: dict[float | None, int] = {}
    for index, head in enumerate(heads):
        if head.word == "DEFAULT":
            table[None] = index
            break
        for value in head.cases if isinstance(head, Case) else (None,):
            if not isinstance(value, Number) or not value.integer:
                return None
            table.setdefault(value.value, index)
    return {None: -2, **table}


def _condition(variables: Variables, condition: Condition) -> Term:
    """Return the value of terms joined by operators."""
    terms = []
    for part, inverse in zip(condition.terms, condition.negated, strict=True):
        term = _term(variables, part)
        terms.append((not term if isinstance(term, bool) else None) if inverse else term)
    return _joined(terms, list(condition.negated), list(condition.operators))


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


def _term(variables: Variables, term: Value) -> Term:
    """Return the value of what comparisons and logic join."""
    if isinstance(term, Condition):
        return _condition(variables, term)
    return _plain(variables.evaluate(term))


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
