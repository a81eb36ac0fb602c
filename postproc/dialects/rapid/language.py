"""RAPID as a language: names that the controller accepts, and instructions that are safe between moves."""

from __future__ import annotations

import re
import unicodedata

PREFIX = "mod_"
"""Prefix of the module's name, which must differ from the procedure's."""
MAX_LENGTH = 32 - len(PREFIX)
_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss"})

WORDS = frozenset(
    [
        "ALIAS",
        "AND",
        "BACKWARD",
        "CASE",
        "CONNECT",
        "CONST",
        "DEFAULT",
        "DIV",
        "DO",
        "ELSE",
        "ELSEIF",
        "ENDFOR",
        "ENDFUNC",
        "ENDIF",
        "ENDMODULE",
        "ENDPROC",
        "ENDRECORD",
        "ENDTEST",
        "ENDTRAP",
        "ENDWHILE",
        "ERROR",
        "EXIT",
        "FALSE",
        "FOR",
        "FROM",
        "FUNC",
        "GOTO",
        "IF",
        "INOUT",
        "LOCAL",
        "MOD",
        "MODULE",
        "NOSTEPIN",
        "NOT",
        "NOVIEW",
        "OR",
        "PERS",
        "PROC",
        "RAISE",
        "READONLY",
        "RECORD",
        "RETRY",
        "RETURN",
        "STEP",
        "SYSMODULE",
        "TEST",
        "THEN",
        "TO",
        "TRAP",
        "TRUE",
        "TRYNEXT",
        "UNDO",
        "VAR",
        "VIEWONLY",
        "WHILE",
        "WITH",
        "XOR",
    ]
)
"""Reserved words."""
HARMLESS = frozenset(
    [
        "CLKRESET",
        "CLKSTART",
        "CLKSTOP",
        "DECR",
        "INCR",
        "INVERTDO",
        "PULSEDO",
        "RESET",
        "SET",
        "SETAO",
        "SETDO",
        "SETGO",
        "STOP",
        "TPERASE",
        "TPWRITE",
        "WAITAI",
        "WAITDI",
        "WAITDO",
        "WAITGI",
        "WAITROB",
        "WAITTIME",
        "WAITUNTIL",
    ]
)
"""Instructions that neither move the robot nor change the meaning of moves."""
MOVING = re.compile(
    "MOVE|TRIGG|SEARCH|STARTMOVE|STOPMOVE|CLEARPATH|RESTOPATH|STOREPATH|IND[ACDR]|CONF[JL]|CIRPATH|SINGAREA|PDISP|EOFFS|"
    "SOFT|CORR|ACCSET|VELSET|PATHACC|GRIPLOAD|MECHUNITLOAD|WORLDACC"
)
"""First letters of instructions that move the robot or change how it moves."""


def fault_of(name: str) -> str | None:
    """Return why the controller would refuse a name for a program, or None if it would not.

    >>> fault_of("PART_1"), fault_of("_1")
    (None, 'it does not begin with a letter')
    """
    if len(name) > MAX_LENGTH:
        return f"it has {len(name)} characters, {MAX_LENGTH} are allowed"
    if not re.match(r"[A-Za-z]", name):
        return "it does not begin with a letter"
    if not _NAME.fullmatch(name):
        return "it has other characters than letters, digits and underscores"
    if name.upper() in WORDS | HARMLESS or MOVING.match(name.upper()):
        return "it is a word of RAPID"
    return None


def valid(name: str) -> str:
    """Return the name itself if the controller accepts it, otherwise a similar valid one.

    >>> valid("part_1"), valid("1001"), valid("Gehäuse oben.2"), valid("stop")
    ('part_1', 'P1001', 'Gehaeuse_oben_2', 'P_stop')
    """
    if fault_of(name) is None:
        return name
    plain = unicodedata.normalize("NFKD", name.translate(_UMLAUTS)).encode("ascii", "ignore").decode()
    found = re.sub(r"\W+", "_", plain).strip("_") or "PROGRAM"
    found = f"P{found}" if found[0].isdigit() else found
    found = found[:MAX_LENGTH].rstrip("_")
    return found if fault_of(found) is None else f"P_{found}"[:MAX_LENGTH]


NO_EXTERNAL_AXES = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
BEGIN = ("ConfJ\\On;", "ConfL\\Off;", "CirPathMode\\ObjectFrame;")
END = ("ConfL\\On;", "CirPathMode\\PathFrame;")
"""Settings for the moves, and the defaults of RAPID that are restored after them."""
_INSTRUCTION = re.compile(r"([A-Za-z]\w*)(?:[ \t\\][^;]*)?;", re.ASCII)
_ASSIGNMENT = re.compile(r"([A-Za-z]\w*)[\w.{},]*[ \t]*:=[^;]+;", re.ASCII)
_OURS = re.compile(r"(?:tool|wobj|speed|zone)_[0-9]+", re.IGNORECASE)
"""Names of data that moves refer to."""


def line_fault(line: str) -> str | None:
    """Return why a line is not allowed between moves, or None if it is.

    >>> line_fault("SetDO doSpindle,1;"), line_fault("$OUT[1]=TRUE")
    (None, 'it is not a RAPID instruction that ends with a semicolon')
    """
    if line.startswith("!") or not line:
        return None
    match = _ASSIGNMENT.fullmatch(line) or _INSTRUCTION.fullmatch(line)
    if match is None:
        return "it is not a RAPID instruction that ends with a semicolon"
    word = match[1]
    if word.upper() in WORDS:
        return f"{word} changes the execution order"
    if MOVING.match(word.upper()):
        return f"{word} moves the robot or changes how it moves"
    if _OURS.fullmatch(word):
        return f"{word} is used by the moves"
    return None


def procedure(line: str) -> str | None:
    """Return the name of a procedure of the user that a line calls; None for known instructions."""
    match = None if _ASSIGNMENT.fullmatch(line) else _INSTRUCTION.fullmatch(line)
    return None if match is None or match[1].upper() in HARMLESS else match[1]
