"""What the text of a G-code program shows before it is read with a cell: tools, offsets, M codes, rotary axes."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

from postproc.cell import FIXED_M_CODES
from postproc.dialects.dialect import Survey
from postproc.dialects.gcode import codes
from postproc.dialects.gcode.modes import TCP_ON
from postproc.dialects.gcode.words import Source, split
from postproc.program import Document

_CODES = re.compile(rb"[GMT]0*\d[\d.]*")
_CODE_LINE = re.compile(rb"[^\n]*[MT]0*\d[^\n]*")
_ROTARY = re.compile(rb"([ABC])[-+]?[\d.]*[1-9]")
"""A word of a rotary axis that is not zero: A0 in each block is what posts for mills with a fourth axis write."""
_OFFSETS = {f"G{code:g}" for code in codes.WORK_OFFSETS[1:]}


def survey(document: Document) -> Survey:
    """Return what a text shows: comments, tool changes, codes and rotary axes.

    Nothing is executed: a code whose number is an expression is not seen, and a call or loop counts once.
    """
    source = split(document)
    words = set(_code_words(source.code))
    machine_codes = sorted(
        (word for word in words if word[0] == "M" and _is_machine_code(float(word[1:]))), key=_code_number
    )
    rotary = tuple(sorted({match[1].decode() for match in _ROTARY.finditer(source.code)}))
    switches = {name for name, group in (("spindle", codes.SPINDLE[:2]), ("coolant", codes.COOLANT[:2]))
                if words & {f"M{code:g}" for code in group}}  # fmt: skip
    return Survey(
        comments=tuple(zip(source.comment_lines.tolist(), source.comments, strict=True)),
        tool_changes=tuple(_tool_changes(source)),
        work_offsets=tuple(sorted(words & _OFFSETS, key=_code_number)),
        m_codes=tuple(machine_codes),
        rotary=rotary,
        tip_controlled=bool(words & set(TCP_ON)),
        switches=frozenset(switches),
        inches="G20" in words,
    )


def _is_machine_code(code: float) -> bool:
    """Return whether only the machine knows an M code, so that the cell must give KRL lines for it."""
    if code in codes.ACCEPTED_M or code in codes.OVERRIDES or code != int(code):
        return False
    return int(code) not in FIXED_M_CODES


def _tool_changes(source: Source) -> Iterator[tuple[int, int]]:
    """Yield line and tool number of each M6; in a program without M6 that has a tool, of each T instead.

    The tool of M6 is the last T up to its line. A T that is not whole is left out.
    """
    changes, selections, tool = [], [], None
    for match in _CODE_LINE.finditer(source.code):
        words = list(_code_words(match[0]))
        line = source.code.count(b"\n", 0, match.start())  # the code begins with a line feed
        for word in words:
            if word[0] == "T" and float(word[1:]) == int(float(word[1:])):
                tool = int(float(word[1:]))
                selections.append((line, tool))
        if f"M{codes.CHANGE:g}" in words and tool is not None:
            changes.append((line, tool))
    yield from changes or selections


def _code_words(code: bytes) -> Iterator[str]:
    """Yield the G, M and T words of a text as codes are written: ``G54`` for ``G054.0``.

    A word without a valid number is left out.

    :param code: packed lines, see `Source.code`.
    """
    for match in _CODES.finditer(code):
        text = match[0].decode("ascii")
        try:
            number = float(text[1:])
        except ValueError:  # 1.2.3 is no number
            continue
        if math.isfinite(number):
            yield f"{text[0]}{number:g}"


def _code_number(word: str) -> float:
    """Return the number of a code, 54 of ``G54``, by which codes are sorted."""
    return float(word[1:])
