"""Overrides and times that a robot program sets itself: its feeds then differ from those that it states."""

from __future__ import annotations

import re
from collections.abc import Iterator

from postproc.errors import Issue
from postproc.program import Program

_OVERRIDES = {
    "krl": re.compile(
        r"^[^;\"\n]*?\$(?:OV_PRO|OV_APPL|RED_VEL)[ \t]*=(?!=)[ \t]*([^;\r\n]*)", re.IGNORECASE | re.MULTILINE
    ),
    "rapid": re.compile(r"^[^!\"\n]*?\bSpeedRefresh[ \t]+([^;!\r\n]*)", re.IGNORECASE | re.MULTILINE),
}
"""Statements that set the override in per cent, by dialect."""
_TIME = re.compile(r"^[ \t]*TIME_BLOCK[ \t]+END[ \t]*=", re.IGNORECASE | re.MULTILINE)
"""Statement of KRL that gives motions of a spline block the time that they take, instead of a feed."""
_FULL = 100.0
"""Override with which the robot moves as the program states [%]."""


def override_issues(program: Program) -> Iterator[Issue]:
    """Yield a warning where the robot does not move at the stated feed, for which forces are computed.

    For each file: its first override that is not 100 %, and its first spline block with a time (TIME_BLOCK).
    """
    pattern = _OVERRIDES.get(program.dialect)
    if pattern is None:
        return
    for document in program.documents:
        for match in pattern.finditer(document.text):
            if not _is_full_override(match[1]):
                line = document.text.count("\n", 0, match.start(1)) + 1
                message = (
                    f"the program sets the override to {match[1].strip()} % in line {line} of {document.name}: forces "
                    "are those at 100 %. State the feeds that the robot is to have, and leave the override at 100"
                )
                yield Issue("warning", "override", message, subject=document.name)
                break
        time_match = _TIME.search(document.text) if program.dialect == "krl" else None
        if time_match is not None:
            line = document.text.count("\n", 0, time_match.end()) + 1
            message = (
                f"TIME_BLOCK sets the time of motions in line {line} of {document.name}: forces are those at $VEL.CP. "
                "State the feed by $VEL.CP, without TIME_BLOCK"
            )
            yield Issue("warning", "override", message, subject=f"{document.name} TIME_BLOCK")


def _is_full_override(text: str) -> bool:
    """Return whether the text of an override is 100 %; False for a variable, whose value is not known."""
    try:
        return float(text) == _FULL
    except ValueError:
        return False
