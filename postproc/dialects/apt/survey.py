"""Survey of a cutter-location file before it is read with a cell: tools, cutters, spindle, coolant."""

from __future__ import annotations

import re

from postproc.dialects.apt.statements import split
from postproc.dialects.dialect import Survey
from postproc.program import Document

_LOAD = re.compile(r"(?:LOADTL/|LOAD/TOOL,)(\d{1,15})(?!\d)")
"""A tool change; the reader reports longer numbers as errors."""


def survey(document: Document) -> Survey:
    """Return the survey of a text; ``CUTTER/…`` counts as a comment, because it describes the tool that follows."""
    statements = split(document)
    comments, changes, switches = list(statements.comments), [], set()
    inches = False
    for row in statements.other_rows.tolist():
        text, line = statements.of(row), int(statements.line[row])
        if match := _LOAD.match(text):
            changes.append((line, int(match[1])))
        elif text.startswith("CUTTER/"):
            comments.append((line, text))
        elif text.startswith("SPINDL/") and not text.endswith("OFF"):
            switches.add("spindle")
        elif text.startswith("COOLNT/") and not text.endswith("OFF"):
            switches.add("coolant")
        elif text.startswith("UNITS/"):
            inches = "INCH" in text
    comments.sort(key=lambda comment: comment[0])
    return Survey(comments=tuple(comments), tool_changes=tuple(changes), switches=frozenset(switches), inches=inches)
