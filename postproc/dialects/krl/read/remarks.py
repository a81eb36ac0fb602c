"""Comments and folds of a KRL program that may name what is done: operations, tools, layers."""

from __future__ import annotations

import re
from itertools import islice

import numpy as np

from postproc.dialects.krl.language.source import Source
from postproc.program import FORCE_COMMENT, Event, Ints

_COMMENT = re.compile(r"(?:\A|[\r\n])[ \t]*(;[^\r\n;]*)")
_OF_THE_EDITOR = re.compile(
    rf";\s*(?:{FORCE_COMMENT.pattern}|ENDFOLD|POSTPROC\b|Params\b|Make your|%|\*|"
    r"FOLD\s*(?:$|%|INI\b|BASISTECH|USER\b|S?PTP\b|S?LIN|S?CIRC|OUT\b|WAIT|SET_|Moduleparameters|DECLARATIONS))",
    re.IGNORECASE,
)
"""Forces, our own line, and what KUKA's editor writes."""
_FOLD = re.compile(r"\A;\s*(?:FOLD\b)?\s*", re.IGNORECASE)
_MOST = 2000
"""Of more comments than this none names an operation."""


def remarks(source: Source, motions: Ints) -> tuple[Event, ...]:
    """Return the comments of a file, each before the first motion (M,), by its line, that is behind it."""
    found = [*islice(_COMMENT.finditer(source.text), _MOST + 1)]
    if len(found) > _MOST:
        return ()
    out = []
    for match in found:
        text = _FOLD.sub("", match[1]).strip(" \t-=*")
        if text and not _OF_THE_EDITOR.match(match[1].rstrip()):
            line = source.line_at(match.start(1))
            shown = int(source.shown(np.array([line]))[0])
            out.append(Event(int(np.searchsorted(motions, line)), "comment", shown, 0.0, text))
    return tuple(out)
