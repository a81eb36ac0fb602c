"""Text of INSERT, which a post-processor copies into the program of the control: a comment, or a block of code.

A text is a comment only if no control would move by it: brackets with nothing behind them, the names of tools and
holders that SolidWorks CAM writes, and lines that begin with a word such as TOOL, STOCK or MATERIAL and have no code.
"""

from __future__ import annotations

import re

_COMMENT = re.compile(r"\([^()]*\)|\(.*$|;.*$")
_NAMES = re.compile(
    r"""\[HOLDER=.*                              # holder, and tool
    | [\d./]+\s?(MM|IN|")([ /].*)?               # tool, by its diameter
    | (TOOL|HOLDER|CUTTER|STOCK|MATERIAL|PART|PROGRAM|PROGRAMMER|OPERATION|SETUP|FIXTURE|CLAMPING|DRAWING|CUSTOMER
      |MACHINE|DATE|NOTE|MSG|STOP)\b.*""",
    re.VERBOSE,
)
_CODES = re.compile(r"(?<!\S)(G\d|N\d+ ?[A-Z]|M0*(\d\d?)(?![\d.])|#\d)|\bTOOL (CALL|DEF)\b|\b(CALL|CYCL|LBL)\b")
_THREAD = re.compile(r"\b(TAP|THREAD|DRILL|SCREW|BOLT|NUT|FOR)")
_MEANINGS = (
    (
        re.compile(r"\bTOOL (CALL|DEF)\b|(?<![A-Z])T\d|(?<![A-Z])M0*6(?!\d)"),
        "changes the tool",
        "Remove it: LOADTL does.",
    ),
    (re.compile(r"M98(?!\d)|\bM?CALL\b|\bCYCL\b|G65(?!\d)"), "calls a program", "Write its motion as GOTO statements."),
    (re.compile(r"G0*4(?!\d)"), "waits", "Write DELAY/n."),
    (re.compile(r"G0*(10|5[0-24-9]|6[89]|92)(?!\d)"), "moves the coordinates", "Remove it if it moves nothing."),
    (
        re.compile(r"(?<![A-Z])([XYZABCUVW][-+=]?[\d.]|G0*([0-3]|28|30|53)(?!\d))"),
        "moves the machine",
        "Write the motion as GOTO, GOHOME or RETRCT.",
    ),
)
"""Pattern of a block, its effect and advice; the first match counts, so that the clearest effects are first."""


def inserted_comment(text: str) -> str | None:
    """Return the comment in the text of an INSERT; None if it may be code of the control.

    :param text: in upper case.

    >>> inserted_comment("[HOLDER=C40-M12EM2] 20MM CRB 4FL 38 LOC")
    '[HOLDER=C40-M12EM2] 20MM CRB 4FL 38 LOC'
    >>> inserted_comment("(SAFE) G28 Z0") is None
    True
    """
    code = _COMMENT.sub("", text).strip()
    if not code and text:
        return text.strip("(); ")
    if not _NAMES.fullmatch(code):
        return None
    is_tap = _THREAD.search(code) is not None  # M6 is then a thread, not a code
    codes = [match[0] for match in _CODES.finditer(code) if not (is_tap and match[2])]
    return None if codes else text


def inserted_fault(text: str) -> tuple[str, str]:
    """Return problem and advice for the text of an INSERT that is code of a control.

    >>> inserted_fault("G28 Z0")
    ("'G28 Z0' is for one control and moves the machine", 'Write the motion as GOTO, GOHOME or RETRCT.')
    """
    code = _COMMENT.sub("", text)
    for pattern, meaning, advice in _MEANINGS:
        if pattern.search(code):
            return f"{text[:20]!r} is for one control and {meaning}", advice
    advice = "Remove it if it does not move the tool, or write it in brackets if it is a comment: INSERT/(…)."
    return f"{text[:20]!r} is for one control", advice
