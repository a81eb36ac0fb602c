"""Names of RAPID: what the controller accepts, and what it keeps for itself."""

from __future__ import annotations

import re
import unicodedata

PREFIX = "mod_"
"""Before the name of the module: it must not be that of the procedure."""
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
"""Instructions that neither move the robot nor change how moves are understood here."""
MOVING = re.compile(
    "MOVE|TRIGG|SEARCH|STARTMOVE|STOPMOVE|CLEARPATH|RESTOPATH|STOREPATH|IND[ACDR]|CONF[JL]|CIRPATH|SINGAREA|PDISP|EOFFS|"
    "SOFT|CORR|ACCSET|VELSET|PATHACC|GRIPLOAD|MECHUNITLOAD|WORLDACC"
)
"""Beginnings of instructions that move the robot, or change how it moves."""


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
        return "it holds other characters than letters, digits and underscores"
    if name.upper() in WORDS | HARMLESS or MOVING.match(name.upper()):
        return "it is a word of RAPID"
    return None


def valid(name: str) -> str:
    """Return a name as it stands if the controller accepts it, otherwise one as close to it as possible.

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
