"""Why a value is not known, for messages."""

from __future__ import annotations

from postproc.dialects.krl.language.brackets import split
from postproc.dialects.krl.language.expressions import operand, parse
from postproc.dialects.krl.language.names import RESERVED
from postproc.dialects.krl.language.positions import Position
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import occurrences
from postproc.dialects.krl.language.values import Call, Chain, Opaque, Operation, Reference, Value
from postproc.dialects.krl.read.known import NOTHING, Known, Unknown
from postproc.dialects.krl.read.variables import Variables


def without_value(variables: Variables, source: Source, start: int, stop: int) -> list[str]:
    """Return the variables in a piece of code that have no value: the cell can give them one."""
    found: dict[str, None] = {}
    for one in occurrences(source.text, start, stop):
        if one.called or one.name in RESERVED or one.name in ("TRUE", "FALSE"):
            continue
        value, _ = operand(source, one.start, stop)
        key = variables.key_of(source, value) if isinstance(value, Reference) and value.field is None else None
        if key is not None and "@" not in key and variables.value(key) in (None, NOTHING):
            found[source.text[value.start : value.stop] if isinstance(value, Reference) else ""] = None
    return list(found)


def why_unknown(variables: Variables, source: Source, value: Value | Known) -> str:
    """Return why a value is not known, for a message."""
    if isinstance(value, Position | Unknown):
        return "it is computed while the program runs"
    if isinstance(value, Chain):
        for operand in value.operands:
            position = variables.position(source, operand)
            if position is None:
                return why_unknown(variables, source, operand)
            if isinstance(operand, Reference) and not position.complete:
                return f"not all components of {source.text[operand.start : operand.stop]} are given"
    text = source.text[value.start : value.stop].strip()[:80]
    if not text and isinstance(value, Reference):  # one that a program of the controller reads
        text = value.name if value.field is None else f"{value.name}.{value.field}"
    if isinstance(value, Operation):
        for side in (value.left, value.right):
            if side is not None and isinstance(variables.evaluate(source, side), Unknown):
                return why_unknown(variables, source, side)
    if isinstance(value, Opaque | Call | Operation) or (isinstance(value, Reference) and value.name[0] == "$"):
        return f"{text} is computed while the program runs"
    if isinstance(value, Reference):
        if variables.key_of(source, value) is None:
            indices = [span for span in split(source, *value.inside) if source.text[slice(*span)].strip()]
            unknown = [span for span in indices if variables.index(source, span) is None]
            why = f": {why_unknown(variables, source, parse(source, *unknown[0])[0])}" if unknown else ""
            return f"the index of {text} is not known before the program runs{why}"
        known = variables.looked_up(source, value)
        if isinstance(known, Unknown) and known.where:
            return f"{text} is changed while the program runs ({known.where})"
        if isinstance(known, Unknown):
            return f"{text} has no value in the program, its .dat, the $config.dat or [krl.values] of the cell"
    return f"{text} is not what is needed here"
