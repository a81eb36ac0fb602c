"""Comments and folds of a KRL program that may name operations, tools or layers."""

from __future__ import annotations

import re

import numpy as np

from postproc.dialects.krl.language.source import Source
from postproc.program import FORCE_COMMENT, Event, Ints

_COMMENT = re.compile(r";[^\r\n;]*")  # begins with a character that is found fast
_OF_THE_EDITOR = re.compile(
    rf";\s*(?:{FORCE_COMMENT.pattern}|ENDFOLD|POSTPROC\b|Params\b|Make your|%|\*|"
    r"FOLD\s*(?:$|%|INI\b|BASISTECH|USER\b|S?PTP\b|S?LIN|S?CIRC|OUT\b|WAIT|SET_|Moduleparameters|DECLARATIONS))",
    re.IGNORECASE,
)
"""Forces, our own line, and what KUKA's editor writes."""
_FOLD = re.compile(r"\A;\s*(?:FOLD\b)?\s*", re.IGNORECASE)
_BLANKS = " \t"
_MOST = 2000
"""Of more comments than this none names an operation."""


def remarks(source: Source, motions: Ints) -> tuple[Event, ...]:
    """Return the comments of a file, each before the first motion (M,), by its line, that is behind it."""
    text = source.text
    starts = np.array([match.start() for match in _COMMENT.finditer(text)], dtype=np.int64)
    lines = np.searchsorted(source.starts, starts, side="right")
    begins = source.starts[lines - 1]
    alone = begins == starts
    behind = np.flatnonzero(~alone)
    for k, begin, start in zip(behind.tolist(), begins[behind].tolist(), starts[behind].tolist(), strict=True):
        alone[k] = text[begin] in _BLANKS and not text[begin:start].strip(_BLANKS)
    if np.count_nonzero(alone) > _MOST:
        return ()
    out = []
    for start, line in zip(starts[alone].tolist(), lines[alone].tolist(), strict=True):
        comment = _COMMENT.match(text, start)
        name = _FOLD.sub("", comment[0]).strip(" \t-=*") if comment else ""
        if comment and name and not _OF_THE_EDITOR.match(comment[0].rstrip()):
            shown = int(source.shown(np.array([line]))[0])
            out.append(Event(int(np.searchsorted(motions, line)), "comment", shown, 0.0, name))
    return tuple(out)
