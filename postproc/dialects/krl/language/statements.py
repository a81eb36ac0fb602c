"""Statements: the word they begin with, what they declare or assign to, what they call."""

from __future__ import annotations

import re

from postproc.dialects.krl.language.expressions import operand
from postproc.dialects.krl.language.names import MOTIONS, PURE, RESERVED, TYPES
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import NAME, word_at
from postproc.dialects.krl.language.values import Call, Reference, Value

MOTION_WORDS = MOTIONS | {f"{word}_REL" for word in MOTIONS}
SPLINES = {"SPLINE": ("SPL", "SLIN", "SCIRC"), "PTP_SPLINE": ("SPTP",)}
"""Spline blocks, and the instructions that may stand in them; ENDSPLINE closes both."""
_UNDECLARED = re.compile(r"[A-Za-z_]\w*[ \t]+[A-Za-z_$][\w$]*[ \t]*(?:\[[^\]]*\])?[ \t]*(?:[,=].*)?$", re.A)
"""A declaration without DECL: type and name."""
_CALL = re.compile(r"(?<![\w$#.])([A-Za-z_]\w*)[ \t]*\(", re.A)
_STRING = re.compile(r'"[^"]*"')
_EQUALS = re.compile(r"[ \t]*=(?!=)")


def declares(text: str, start: int, stop: int) -> bool:
    """Return whether a statement is a declaration of variables."""
    word = word_at(text, start, stop)
    if word in ("DECL", "CONST") or word in TYPES:
        return True
    return word not in RESERVED and _UNDECLARED.match(text, start, stop) is not None


def assignment(source: Source, start: int, stop: int) -> tuple[Reference, int] | None:
    """Return what a statement assigns to and the offset behind ``=``; None if it is no assignment.

    :raises ProgramError: brackets are not balanced.
    """
    if not NAME.match(source.text, start, stop):
        return None
    target, position = operand(source, start, stop)
    equals = _EQUALS.match(source.text, position, stop)
    return (target, equals.end()) if isinstance(target, Reference) and equals else None


def calls(source: Source, start: int, stop: int) -> list[Call]:
    """Return the calls of routines and functions in a piece of code, from left to right, also those inside others.

    :raises ProgramError: brackets are not balanced.
    """
    text, found = source.text, []
    if "(" not in text[start:stop]:
        return []
    quoted = [match.span() for match in _STRING.finditer(text, start, stop)]
    for match in _CALL.finditer(text, start, stop):
        name = match[1].upper()
        if name in RESERVED or name in PURE or any(a < match.start() < b for a, b in quoted):
            continue
        value, _ = operand(source, match.start(), stop)
        if isinstance(value, Call):
            found.append(value)
    return found


def sole_call(source: Source, start: int, stop: int) -> Call | None:
    """Return the call that a piece of code consists of; None if it is something else."""
    value = _sole_operand(source, start, stop)
    return value if isinstance(value, Call) else None


def reference_of(source: Source, span: tuple[int, int]) -> Reference | None:
    """Return the variable that an argument consists of; None if it is something else.

    :raises ProgramError: brackets are not balanced.
    """
    value = _sole_operand(source, *span)
    return value if isinstance(value, Reference) else None


def _sole_operand(source: Source, start: int, stop: int) -> Value | None:
    """Return the named operand that a piece of code consists of; None if it is something else."""
    text = source.text
    while start < stop and text[start] in " \t":
        start += 1
    if not NAME.match(text, start, stop):
        return None
    value, end = operand(source, start, stop)
    return value if not text[end:stop].strip() else None
