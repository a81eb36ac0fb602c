"""Cutting motions of a program that were not read."""

from __future__ import annotations

import re

from postproc.errors import Issue, together
from postproc.program import Program

_RAPID = re.compile(r"\s*S?PTP", re.IGNORECASE)


def refuse_unseen(program: Program) -> None:
    """Refuse routines that cut and are not followed: their motions would remain uncorrected under force.

    :raises ProgramError: there is one; the error names the cause.
    """
    if program.unfollowed:
        raise together(each.error for each in program.unfollowed)


def kept(program: Program) -> list[Issue]:
    """Return a warning if cutting motions were not read: the stock keeps the material that they remove."""
    lines = [f"{one.file}, line {one.line}" for one in program.unresolved if not _RAPID.match(one.text)]
    lines += [f"{each.subject}()" for each in program.issues if each.kind == "motions-elsewhere"]
    if not lines:
        return []
    more = f" and {len(lines) - 1} more" if len(lines) > 1 else ""
    message = (
        f"motions that are kept unread remove nothing from the stock: {lines[0]}{more}. If a later motion passes the "
        "same place, its force is computed for material that was already removed."
    )
    return [Issue("warning", "cuts-unseen", message, count=len(lines))]
