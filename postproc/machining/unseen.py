"""Cutting motions that a program makes and that are not among those that are known."""

from __future__ import annotations

import re

from postproc.errors import Issue, together
from postproc.program import Program

_RAPID = re.compile(r"\s*S?PTP", re.IGNORECASE)


def refuse_unseen(program: Program) -> None:
    """Refuse routines that cut and are not followed: their motions would stay uncorrected under force.

    :raises ProgramError: there is one; it is about what cannot be followed.
    """
    if program.unfollowed:
        raise together(each.error for each in program.unfollowed)


def kept(program: Program) -> list[Issue]:
    """Return a warning if motions that cut stay as they are: the stock keeps what they take."""
    lines = [f"{one.file}, line {one.line}" for one in program.unresolved if not _RAPID.match(one.text)]
    lines += [f"{each.subject}()" for each in program.issues if each.kind == "motions-elsewhere"]
    if not lines:
        return []
    more = f" and {len(lines) - 1} more" if len(lines) > 1 else ""
    message = (
        f"what stays as it is cuts nothing of the stock: {lines[0]}{more}. Where a later motion comes to the same "
        "place, its force is that of material that is not there any more."
    )
    return [Issue("warning", "cuts-unseen", message, count=len(lines))]
