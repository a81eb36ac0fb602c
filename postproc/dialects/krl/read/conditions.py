"""Whether a condition holds, as far as that is known before the program runs.

KRL ranks NOT first, then * / + −, AND, EXOR, OR, and comparisons last. Where brackets are left out so that this order
matters, a condition counts as known only if comparing first is the only way in which it makes sense.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from operator import and_, or_, xor

import numpy as np

from postproc.dialects.krl.language.tree import Case, Statement
from postproc.dialects.krl.language.values import Condition, Number, Word
from postproc.dialects.krl.read.known import VariableValue

_LOGIC_OPERATORS = ("AND", "EXOR", "OR")
_BITWISE: dict[str, Callable[[int, int], int]] = {"B_AND": and_, "B_EXOR": xor, "B_OR": or_}
_REAL_TOLERANCE = 1e-5
"""REALs that differ by less than this share may compare otherwise on a controller, which has fewer digits."""

NO_CASE = -1
"""In place of the index of a CASE: none of them is chosen."""

Term = bool | Number | Word | None


def condition_value(values: Sequence[VariableValue], condition: Condition) -> Term:
    """Return the value of a condition; None if it is not known.

    :param values: values of the terms of the condition, in order.
    """
    terms: list[Term] = []
    for value, is_negated in zip(values, condition.negated, strict=True):
        term = as_term(value)
        if is_negated:
            term = not term if isinstance(term, bool) else None
        terms.append(term)
    if any(
        (is_negated or is_next_negated) and operator not in _LOGIC_OPERATORS
        for (is_negated, is_next_negated), operator in zip(
            pairwise(condition.negated), condition.operators, strict=True
        )
    ):
        return None  # the value depends on whether NOT or the operator is applied first
    return _combined_value(terms, list(condition.operators))


def matches_case(value: VariableValue, case: VariableValue) -> bool | None:
    """Return whether the value of a SWITCH equals a value behind CASE; None if that is not known."""
    return _comparison_holds("==", as_term(value), as_term(case))


def constant_cases(heads: Sequence[Statement]) -> dict[float | None, int] | None:
    """Return a table: integer behind CASE → index in `heads` of the first CASE with it.

    The key None stands for all other integers. Its index is that of DEFAULT; `NO_CASE` if there is no DEFAULT.

    :param heads: the statements CASE and DEFAULT of a SWITCH, in order.
    :returns: None instead of a table if not all values behind CASE are integer constants.
    """
    table: dict[float | None, int] = {}
    for index, head in enumerate(heads):
        if head.word == "DEFAULT":
            table[None] = index
            break
        for value in head.cases if isinstance(head, Case) else (None,):  # None: the statement cannot be read
            if not isinstance(value, Number) or not value.is_integer:
                return None
            table.setdefault(value.value, index)
    return {None: NO_CASE, **table}  # replaced if there is a DEFAULT


def _combined_value(terms: list[Term], operators: list[str]) -> Term:
    """Return the value of terms joined by operators; None if it is not known.

    Bitwise operators come first, then comparisons, then AND, EXOR, OR. KRL compares last: a value that then differs is
    not known.

    :param terms: the terms of the condition; the list is reduced to the result.
    :param operators: the operators between the terms; the list is emptied.
    """
    if not _apply_bitwise(terms, operators):
        return None
    is_mixed = any(operator in _LOGIC_OPERATORS for operator in operators)
    index = 0
    while index < len(operators):
        if operators[index] in _LOGIC_OPERATORS:
            index += 1
            continue
        left, right = terms[index], terms[index + 1]
        if is_mixed and (isinstance(left, bool) or isinstance(right, bool)):
            return None  # a BOOL next to a comparison and AND, EXOR or OR: either may be meant to come first
        terms[index : index + 2] = [_comparison_holds(operators[index], left, right)]
        del operators[index]
        if index < len(operators) and operators[index] not in _LOGIC_OPERATORS:
            return None  # a comparison of a comparison
    for logic in _LOGIC_OPERATORS:
        while logic in operators:
            index_of_logic = operators.index(logic)
            terms[index_of_logic : index_of_logic + 2] = [
                _logic_value(logic, terms[index_of_logic], terms[index_of_logic + 1])
            ]
            del operators[index_of_logic]
    return terms[0]


def _apply_bitwise(terms: list[Term], operators: list[str]) -> bool:
    """Replace terms joined by B_AND, B_EXOR and B_OR, in this order, by their values.

    These operators take INTs alone, so that no comparison can come before them.

    :param terms: the terms, `operators` the operators between them; both lists are changed.
    :returns: False if a term of a bitwise operator is not a known INT; the lists are of no use then.
    """
    for operator, bitwise in _BITWISE.items():
        while operator in operators:
            index = operators.index(operator)
            left, right = terms[index], terms[index + 1]
            if not (isinstance(left, Number) and isinstance(right, Number) and left.is_integer and right.is_integer):
                return False
            value = float(bitwise(int(left.value), int(right.value)))
            terms[index : index + 2] = [Number(value, left.start, right.stop, is_integer=True)]
            del operators[index]
    return True


def _logic_value(operator: str, left: Term, right: Term) -> bool | None:
    """Return the value of AND, OR or EXOR (`operator`) of two terms.

    A term that is no BOOL counts as not known.

    :returns: None if the value depends on a term that is not known.
    """
    operands = [side for side in (left, right) if isinstance(side, bool)]
    if operator == "AND":
        return False if False in operands else True if len(operands) == 2 else None
    if operator == "OR":
        return True if True in operands else False if len(operands) == 2 else None
    return operands[0] != operands[1] if len(operands) == 2 else None


def as_term(value: VariableValue) -> Term:
    """Return a BOOL as a Python bool, numbers and words unchanged, None for all other values."""
    if isinstance(value, Word) and value.text in ("TRUE", "FALSE"):
        return value.text == "TRUE"
    return value if isinstance(value, (Number, Word)) else None


def _comparison_holds(operator: str, left: Term, right: Term) -> bool | None:
    """Return whether a comparison such as ``left >= right`` holds.

    :returns: None if a term is not known, or the comparison makes no sense for terms of these types.
    """
    if isinstance(left, Number) and isinstance(right, Number):
        return _number_comparison_holds(operator, left, right)
    if left is None or right is None or operator not in ("==", "<>") or type(left) is not type(right):
        return None
    left_value, right_value = (side.text if isinstance(side, Word) else side for side in (left, right))
    return left_value == right_value if operator == "==" else left_value != right_value


def _number_comparison_holds(operator: str, left: Number, right: Number) -> bool | None:
    """Return whether a comparison of numbers holds.

    :returns: None if a number is a REAL and the two are equal within the digits of a controller, unless both are the
        same number of 32 bits.
    """
    a, b = left.value, right.value
    if not (left.is_integer and right.is_integer):
        is_close = abs(a - b) <= _REAL_TOLERANCE * max(1.0, abs(a), abs(b))
        if is_close and not (a == b and float(np.float32(a)) == a):
            return None
    return {"==": a == b, "<>": a != b, "<": a < b, ">": a > b, "<=": a <= b, ">=": a >= b}[operator]
