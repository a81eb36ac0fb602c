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
    Opaque,
    Operation,
    Reference,
    Value,
    walk,
)
from postproc.dialects.krl.read.known import NOTHING, Known, Unknown
from postproc.dialects.krl.read.state import RELEVANT
from postproc.dialects.krl.read.variables import Variables


def without_value(variables: Variables, source: Source, values: Iterable[Value]) -> list[str]:
    """Return the variables in some values that have no value: the cell can give them one."""
    found: dict[str, None] = {}
    for value in walk(values):
        if not isinstance(value, Reference) or value.field is not None or value.name in RELEVANT:
            continue
        key = variables.key_of(value)
        if key is not None and "@" not in key and variables.value(key) in (None, NOTHING):
            found[source.text[value.start : value.stop]] = None
    return list(found)


def why_unknown(variables: Variables, source: Source, value: Value | Known) -> str:
    """Return why a value is not known, for a message."""
    if isinstance(value, Position | Unknown):
        return "it is computed while the program runs"
    if isinstance(value, Chain):
        for operand in value.operands:
            position = variables.position(operand)
            if position is None:
                return why_unknown(variables, source, operand)
            if isinstance(operand, Reference) and not position.complete:
                return f"not all components of {source.text[operand.start : operand.stop]} are given"
    text = source.text[value.start : value.stop].strip()[:80]
    if not text and isinstance(value, Reference):  # one that a program of the controller reads
        text = value.name if value.field is None else f"{value.name}.{value.field}"
    sides = [side for side in (value.left, value.right) if side is not None] if isinstance(value, Operation) else []
    if isinstance(value, Call) and value.name in PURE:
        sides = list(value.arguments)
    for side in sides:
        if isinstance(variables.evaluate(side), Unknown):
            return why_unknown(variables, source, side)
    if isinstance(value, Operation) and isinstance(known := variables.evaluate(value), Unknown) and known.why:
        return f"{text}: {known.why}"
    if isinstance(value, Reference) and value.name[0] == "$":
        known = variables.looked_up(value)
        if isinstance(known, Unknown) and known != NOTHING:
            return known.said(text)
        return f"{text} is computed while the program runs"
    if isinstance(value, Opaque | Condition | Call | Operation):
        return f"{text} is computed while the program runs"
    if isinstance(value, Reference):
        if variables.key_of(value) is None:
            unknown = [one for one in value.indices or () if one.start < one.stop and variables.index(one) is None]
            why = f": {why_unknown(variables, source, unknown[0])}" if unknown else ""
            return f"the index of {text} is not known before the program runs{why}"
        known = variables.looked_up(value)
        if isinstance(known, Unknown):
            return known.said(text)
    return f"{text} has the wrong type here"


def why_not_decided(variables: Variables, source: Source, values: Sequence[Value]) -> str:
    """Return why the values in a condition or in bounds are not known, for a message: ``: reason``.

    :returns: empty if each of them is known.
    """
    for call in calls(values):
        if variables.functions.pure(call):
            continue
        return f": it asks {call.spelt(source)}()"
    for one in walk(values):
        known = variables.looked_up(one) if isinstance(one, Reference) else NOTHING
        if isinstance(known, Unknown) and known != NOTHING:
            return f": {why_unknown(variables, source, one)}"
    for one in walk(values):
        if isinstance(one, Operation) and not isinstance(variables.evaluate(one), Number):
            return f": {why_unknown(variables, source, one)}"
    return ""
