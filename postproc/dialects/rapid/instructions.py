"""What stands around the moves, and what may stand between them, whoever wrote it into the cell."""

from __future__ import annotations

import re

from postproc.dialects.rapid.names import HARMLESS, MOVING, WORDS

NO_EXTERNAL_AXES = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
BEGIN = ("ConfJ\\On;", "ConfL\\Off;", "CirPathMode\\ObjectFrame;")
END = ("ConfL\\On;", "CirPathMode\\PathFrame;")
"""What holds for the moves, and what holds in RAPID unless something else is said."""
_INSTRUCTION = re.compile(r"([A-Za-z]\w*)(?:[ \t\\][^;]*)?;", re.ASCII)
_ASSIGNMENT = re.compile(r"([A-Za-z]\w*)[\w.{},]*[ \t]*:=[^;]+;", re.ASCII)
_OURS = re.compile(r"(?:tool|wobj|speed|zone)_[0-9]+", re.IGNORECASE)
"""Names of the data that moves refer to."""


def fault_of(line: str) -> str | None:
    """Return why a line cannot stand between moves, None if it can.

    >>> fault_of("SetDO doSpindle,1;"), fault_of("$OUT[1]=TRUE")
    (None, 'it is no RAPID instruction that ends with a semicolon')
    """
    if line.startswith("!") or not line:
        return None
    match = _ASSIGNMENT.fullmatch(line) or _INSTRUCTION.fullmatch(line)
    if match is None:
        return "it is no RAPID instruction that ends with a semicolon"
    word = match[1]
    if word.upper() in WORDS:
        return f"{word} changes the order of moves"
    if MOVING.match(word.upper()):
        return f"{word} moves the robot, or changes how it moves"
    if _OURS.fullmatch(word):
        return f"{word} belongs to the moves"
    return None


def procedure(line: str) -> str | None:
    """Return the instruction of a line if it may do anything: a procedure of the user. None for known ones."""
    match = None if _ASSIGNMENT.fullmatch(line) else _INSTRUCTION.fullmatch(line)
    return None if match is None or match[1].upper() in HARMLESS else match[1]
