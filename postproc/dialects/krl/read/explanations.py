"""Why a value is not known, for messages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.names import PURE
from postproc.dialects.krl.language.positions import Position
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.values import (
    Call,
    Chain,
    Condition,
    Number,
    OpaqueText,
    Operation,
    Reference,
    Value,
    walk,
)
from postproc.dialects.krl.read.known import NO_VALUE, UnknownValue, VariableValue
from postproc.dialects.krl.read.state import MOTION_SETTINGS
from postproc.dialects.krl.read.variables import Variables

_MAX_TEXT_LENGTH = 80
"""Characters of an expression that a message shows."""


def names_without_value(variables: Variables, source: Source, values: Iterable[Value]) -> list[str]:
    """Return the names, as spelled, of variables without a value in some expressions, if the cell can give a value.

    Local variables, fields of structures and settings of motions are left out: the cell cannot give them a value.

    :raises ProgramError: brackets are not balanced.
    """
    spellings: dict[str, None] = {}
    for value in walk(values):
        if not isinstance(value, Reference) or value.field is not None or value.name in MOTION_SETTINGS:
            continue
        key = variables.key_of(value)
        # "@" is in the stored names of local variables of a call
        if key is not None and "@" not in key and variables.value(key) in (None, NO_VALUE):
            spellings[source.text[value.start : value.stop]] = None
    return list(spellings)


def why_unknown(variables: Variables, source: Source, value: Value | VariableValue) -> str:
    """Return why the value of an expression is not known, as text for a message.

    For an operation, a pure function or a chain of frames, the reason is that of its first unknown part.

    :param source: the file that contains the expression.
    :param value: the expression; a position or an `UnknownValue` stands for a value that is in no text.
    :returns: the text that the value has the wrong type, if the value is known.
    :raises ProgramError: a part of the expression cannot be read.
    """
    if isinstance(value, Position | UnknownValue):
        return "it is computed while the program runs"
    if isinstance(value, Chain) and (reason := _why_chain_unknown(variables, source, value)):
        return reason
    text = source.text[value.start : value.stop].strip()[:_MAX_TEXT_LENGTH]
    if not text and isinstance(value, Reference):  # a variable that KUKA's BAS reads: the program does not name it
        text = value.name if value.field is None else f"{value.name}.{value.field}"
    parts = [side for side in (value.left, value.right) if side is not None] if isinstance(value, Operation) else []
    if isinstance(value, Call) and value.name in PURE:
        parts = list(value.arguments)
    for part in parts:
        if isinstance(variables.evaluate(part), UnknownValue):
            return why_unknown(variables, source, part)
    if isinstance(value, Operation) and isinstance(result := variables.evaluate(value), UnknownValue) and result.reason:
        return f"{text}: {result.reason}"
    if isinstance(value, Reference) and value.name[0] == "$":
        result = variables.value_of(value)
        if isinstance(result, UnknownValue) and result != NO_VALUE:
            return result.message_for(text)
        return f"{text} is computed while the program runs"
    if isinstance(value, OpaqueText | Condition | Call | Operation):
        return f"{text} is computed while the program runs"
    reason = _why_variable_unknown(variables, source, value, text) if isinstance(value, Reference) else ""
    return reason or f"{text} has the wrong type here"


def _why_chain_unknown(variables: Variables, source: Source, chain: Chain) -> str:
    """Return why the position of frames joined by ``:`` is not known, as text for a message.

    :returns: empty if the positions of all frames are known and complete.
    """
    for operand in chain.operands:
        position = variables.position(operand)
        if position is None:
            return why_unknown(variables, source, operand)
        if isinstance(operand, Reference) and not position.is_complete:
            return f"not all components of {source.text[operand.start : operand.stop]} are given"
    return ""


def _why_variable_unknown(variables: Variables, source: Source, reference: Reference, spelling: str) -> str:
    """Return why the value of a variable of the program is not known, as text for a message; empty if it is known.

    :param reference: the variable, an array element or a field; `spelling` is its name in the message.
    """
    if variables.key_of(reference) is None:  # which element is meant is not known
        # an empty text is the index of a whole array
        unknown_indices = [
            index for index in reference.indices or () if index.start < index.stop and variables.index(index) is None
        ]
        suffix = f": {why_unknown(variables, source, unknown_indices[0])}" if unknown_indices else ""
        return f"the index of {spelling} is not known before the program runs{suffix}"
    if reference.field is not None and "[" in reference.field:
        return f"{spelling} is an element of an array in a structure, which is not followed: use a variable of its own"
    result = variables.value_of(reference)
    return result.message_for(spelling) if isinstance(result, UnknownValue) else ""


def why_not_decided(variables: Variables, source: Source, values: Sequence[Value]) -> str:
    """Return why a condition, or the bounds of a FOR, are not known: ``: reason``, for the end of a message.

    :param values: the expressions of the condition or the bounds.
    :returns: empty if there is neither a call with side effects, nor an unknown variable, nor an unknown operation.
    """
    for call in calls(values):
        if not variables.functions.is_pure(call):
            return f": it asks {call.spelling(source)}()"
    for part in walk(values):
        result = variables.value_of(part) if isinstance(part, Reference) else NO_VALUE
        if isinstance(result, UnknownValue) and result != NO_VALUE:
            return f": {why_unknown(variables, source, part)}"
    for part in walk(values):
        if isinstance(part, Operation) and not isinstance(variables.evaluate(part), Number):
            return f": {why_unknown(variables, source, part)}"
    return ""
