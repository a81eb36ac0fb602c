"""Motions under another `$ORI_TYPE` than ``#VAR`` that are corrected: they must be led to A, B, C of their own.

Under #CONSTANT the controller keeps the orientation that a motion starts with, under #IGNORE it chooses that of the
target, so that a correction of it, or of the one before, would be ignored; under #JOINT it would turn the tool in a way
of its own. Such motions get ``$ORI_TYPE=#VAR`` for themselves alone: spline motions by WITH, others by lines around as
many of them as stand one behind the other.

The auxiliary point of a SCIRC keeps its A, B, C, which were meant for the whole circle as it was: once the circle is
corrected, or divided, it ignores them (``$CIRC_MODE.AUX_PT.ORI=#IGNORE``). What only SCIRC may set is left out where
lines take its place.
"""

from __future__ import annotations

import re

from postproc.dialects.krl.layout import FREE, Layout
from postproc.program import Ints

LED_BY = "$ORI_TYPE="
_FREE = f"{LED_BY}{FREE}"
_UNHEEDED = "$CIRC_MODE.AUX_PT.ORI=#IGNORE"
_WITH = re.compile(r"[ \t]*WITH\b", re.IGNORECASE)
_OF_CIRCLES = re.compile(
    r"\$CIRC_(?:TYPE|MODE)[\w.]*[ \t]*=[ \t]*"
    r"(?:#\w+|\{(?:[^{}]|\{(?:[^{}]|\{[^{}]*\})*\})*\}|[\w$.]+[ \t]*(?:\([^()]*\))?)[ \t]*(?:,[ \t]*)?",
    re.IGNORECASE,
)
_LEFT_OVER = re.compile(r"[ \t]*(?:,|WITH\b)[ \t]*(?=C_[A-Z]+\b|$)", re.IGNORECASE)
_HEED = re.compile(r"(\$CIRC_MODE\.AUX_PT\.ORI[ \t]*=[ \t]*)(?:#\w+|[\w$.]+)", re.IGNORECASE)
_APPROXIMATION = re.compile(r"(?:[ \t]*\bC_[A-Z]+\b)*[ \t]*$", re.IGNORECASE)
_MODE = re.compile(r"(\$ORI_TYPE[ \t]*=[ \t]*)(?:#\w+|[\w$]+[ \t]*(?:\([^()]*\))?)", re.IGNORECASE)


def freed_tail(tail: str) -> str:
    """Return what follows the target of a spline motion, with its orientation freed.

    >>> freed_tail(" WITH $VEL.CP=0.1, $ORI_TYPE=SORI_TYP(LCPDAT1) C_SPL"), freed_tail(" C_SPL")
    (' WITH $VEL.CP=0.1, $ORI_TYPE=#VAR C_SPL', ' WITH $ORI_TYPE=#VAR C_SPL')
    """
    word = _WITH.match(tail)
    if word is None:
        return f" WITH {_FREE}{tail}"
    if _MODE.search(tail):
        return _MODE.sub(rf"\1{FREE}", tail)
    return f"{word[0]} {_FREE},{tail[word.end() :]}"


def unheeding_tail(tail: str) -> str:
    """Return what follows the target of a SCIRC, with A, B, C of its auxiliary point ignored.

    >>> unheeding_tail(" WITH $CIRC_MODE=SCIRC_M(L1)"), unheeding_tail(" C_SPL")
    (' WITH $CIRC_MODE=SCIRC_M(L1), $CIRC_MODE.AUX_PT.ORI=#IGNORE', ' WITH $CIRC_MODE.AUX_PT.ORI=#IGNORE C_SPL')
    """
    if _HEED.search(tail):
        return _HEED.sub(r"\1#IGNORE", tail)
    behind = _APPROXIMATION.search(tail)
    stop = behind.start() if behind else len(tail)
    return f"{tail[:stop]}{',' if _WITH.match(tail) else ' WITH'} {_UNHEEDED}{tail[stop:]}"


def straight_tail(tail: str) -> str:
    """Return what follows the target of a SCIRC for a line in place of it, without what only circles have.

    >>> straight_tail(" WITH $VEL.CP=0.1, $CIRC_MODE=SCIRC_M(L1) C_SPL"), straight_tail(" WITH $CIRC_TYPE=#PATH")
    (' WITH $VEL.CP=0.1 C_SPL', '')
    """
    if not _OF_CIRCLES.search(tail):
        return tail
    rest = _OF_CIRCLES.sub("", tail).rstrip(" \t")
    return _LEFT_OVER.sub(lambda found: " " if found.end() < len(rest) else "", rest)


def runs(layout: Layout, rows: Ints) -> list[tuple[int, int]]:
    """Return the first and last of motions (n,) that stand one behind the other, with comments at most between."""
    out: list[tuple[int, int]] = []
    for row in rows.tolist():
        if out and out[-1][1] == row - 1 and _adjoin(layout, row):
            out[-1] = out[-1][0], row
        else:
            out.append((row, row))
    return out


def _adjoin(layout: Layout, row: int) -> bool:
    """Return whether a motion stands behind the one before, in the same round of the same loop of the same routine."""
    source, before, line = layout.course.source, int(layout.line[row - 1]), int(layout.line[row])
    one, other = source.origin(before), source.origin(line)
    if one.source is not other.source or other.line - one.line != line - before:
        return False
    return all(start == stop for start, stop in map(source.code_span, range(before + 1, line)))
