"""Overrides, times and speeds of turning that a robot program sets: its feeds then differ from those that it states."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from postproc.errors import Issue
from postproc.frames import MM_PER_MIN, Array
from postproc.program import Ints, Program

_OVERRIDES = {
    "krl": re.compile(
        r"^[^;\"\n]*?\$(?:OV_PRO|OV_APPL|RED_VEL)[ \t]*=(?!=)[ \t]*([^;\r\n]*)", re.IGNORECASE | re.MULTILINE
    ),
    "rapid": re.compile(r"^[^!\"\n]*?\bSpeedRefresh[ \t]+([^;!\r\n]*)", re.IGNORECASE | re.MULTILINE),
}
"""Statements that set the override in per cent, by dialect."""
_TIME = re.compile(r"^[ \t]*TIME_BLOCK[ \t]+END[ \t]*=", re.IGNORECASE | re.MULTILINE)
"""Statement of KRL that gives motions of a spline block the time that they take, instead of a feed."""
_TURN_SPEEDS = {"krl": "$VEL.ORI1 or $VEL.ORI2", "rapid": "v_ori"}
"""What limits how fast the tool turns, by dialect."""
_FULL_OVERRIDE = 100.0
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


def slow_turn_issues(program: Program, programmed_feed: Array, cuts: Ints) -> Iterator[Issue]:
    """Yield a note where the tool turns on cuts as fast as the program lets it, which slows its tip.

    :param program: its feeds are the speeds of the tip; `programmed_feed` (M,) are the feeds that it states [m/s].
    :param cuts: (n,) rows of motions that cut.
    """
    share = program.motions.feed[cuts] / programmed_feed[cuts]
    # sorted, so that the slowest comes first, and cut off after those that are slower than programmed
    rows = cuts[np.argsort(share, kind="stable")[: np.count_nonzero(share < 1.0)]]
    if len(rows):
        feed, tip_speed = (column[rows[0]] * MM_PER_MIN for column in (programmed_feed, program.motions.feed))
        message = (
            f"{_TURN_SPEEDS[program.dialect]} slows the tip of a tool that turns while it cuts, here from {feed:.0f} "
            f"to {tip_speed:.0f} mm/min: forces are those of the slower feed"
        )
        yield program.motions.issue("info", "slow-turn", message, rows)


def _is_full_override(text: str) -> bool:
    """Return whether the text of an override is 100 %; False for a variable, whose value is not known."""
    try:
        return float(text) == _FULL_OVERRIDE
    except ValueError:
        return False
