"""Statements of robot languages at which the program waits."""

from __future__ import annotations

import math
import re

RAPID_WAITS = frozenset(
    {
        "BREAK", "STOP", "TPREADFK", "TPREADNUM", "UIMSGBOX", "WAITAI", "WAITDI", "WAITDO", "WAITGI", "WAITSYNCTASK",
        "WAITTESTANDSET", "WAITTIME", "WAITUNTIL",
    }
)  # fmt: skip
"""Instructions of RAPID at which the robot stands; WaitRob only waits until it does."""
_KRL_WAIT = re.compile(r"[ \t]*(?:WAIT[ \t]+(?:SEC|FOR)|HALT)\b(?P<operand>.*)", re.IGNORECASE)
_RAPID_WAIT = re.compile(rf"[ \t]*(?:{'|'.join(sorted(RAPID_WAITS))})\b(?P<operand>.*)", re.IGNORECASE)


def krl_wait_time(code: str) -> float:
    """Return how long a statement of KRL waits [s]: NaN if the time is an expression, or depends on a condition.

    0 if it does not wait; ``WAIT SEC 0`` and ``WAIT FOR TRUE`` only stop the advance run.

    >>> krl_wait_time("WAIT SEC 0.5"), krl_wait_time("wait for (TRUE)"), krl_wait_time("HALT")
    (0.5, 0.0, nan)
    """
    return _stated_time(_KRL_WAIT.match(code))


def is_wait(line: str) -> bool:
    """Return whether the robot waits in a line of KRL or RAPID, whichever it is; comments do not count.

    >>> [is_wait(line) for line in ("WAIT SEC 3.0 ; spindle", "wait sec 0", "WaitTime 0.5;", "$OUT[1]=TRUE")]
    [True, False, True, False]
    """
    code = line.partition(";")[0]
    return any(_stated_time(pattern.match(code)) != 0.0 for pattern in (_KRL_WAIT, _RAPID_WAIT))


def _stated_time(statement: re.Match[str] | None) -> float:
    """Return the time that a wait states [s]; 0 if it takes none or is None, NaN if the time is not a number."""
    operand = "0" if statement is None else statement["operand"].strip(" \t()").upper()
    try:
        return 0.0 if operand == "TRUE" else float(operand)
    except ValueError:
        return math.nan
