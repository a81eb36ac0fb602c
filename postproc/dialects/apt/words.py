"""Major words of cutter-location files that have no effect, and advice for those that are refused."""

from __future__ import annotations

from postproc.errors import did_you_mean

TEXT = ("PARTNO", "PPRINT", "REMARK", "TITLES", "TPRINT", "NOTE")
"""Words followed by text up to the end of the statement."""

WITHOUT_EFFECT = frozenset(
    (
        "CUTTER",
        "TLDATA",
        "PAINT",
        "END-OF-PATH",
        "INTOL",
        "OUTTOL",
        "TOLER",
        "TOLTBL",
        "LINTOL",
        "MCHTOL",
        "MACHIN",
        "SEQNO",
        "ISN",
        "CLPRNT",
        "TMARK",
        "LEADER",
        "DISPLY",
        "PLOT",
        "PPLOT",
        "SELECT",
        "SELCTL",
        "TOOLNO",
        "OFSTNO",
        "CATMAT",
        "AUTOPS",
        "PSIS",
        "CLEARP",
        "CLRSRF",
        "OPNAME",
        "LETTER",
        "PLABEL",
        "VERIFY",
        "HEADER",
        "PROGRM",
    )
)
"""Words that move nothing on a robot. Source: Vericut, "Supported APT-CLS NC Program Records"."""

_COORDINATES = "Let the CAM system write all coordinates in one machining axis system."
_EXPAND = "Let the CAM system write the motion as GOTO statements."
REFUSED = {
    "ORIGIN": _COORDINATES,
    "TRANS": _COORDINATES,
    "TRACUT": _COORDINATES,
    "ROTATE": _COORDINATES,
    "ROTABL": _COORDINATES,
    "ROTHED": _COORDINATES,
    "INDEX": "Let the CAM system write the calls out.",
    "COPY": "Let the CAM system write the copies out.",
    "CALSUB": "Let the CAM system write the calls out.",
    "DEFSUB": "Let the CAM system write the calls out.",
    "ENDSUB": "Let the CAM system write the calls out.",
    "CALL": "Let the CAM system write the calls out.",
    "NURBS": _EXPAND,
    "SPLINE": _EXPAND,
    "GODLTA": "Write GODLTA/dx,dy,dz.",
    "THREAD": _EXPAND,
    "ARC": "Write CIRCLE, or GOTO statements.",
    "DNTCUT": "Remove DNTCUT, CUT and what is between them if the tool must not move there.",
    "PREFUN": "It is a G code of one control. Remove it if it does not move the tool.",
    "TURRET": "Only milling programs are supported.",
    "SET": "Let the CAM system write absolute coordinates.",
}
"""Words that change motion in ways that are not supported: what to do."""

KNOWN = (
    *("GOTO", "GODLTA", "FROM", "GOHOME", "RETRCT", "RAPID", "FEDRAT", "UNITS", "MULTAX", "TLAXIS", "CIRCLE", "MOVARC"),
    *("INDIRV", "TLON", "CYCLE", "SPINDL", "COOLNT", "LOADTL", "LOAD", "DELAY", "STOP", "OPSTOP", "OPSKIP", "AUXFUN"),
    *("INSERT", "CUTCOM", "MODE", "MSYS", "END", "REWIND", "FINI", *TEXT),
)


def refusal(word: str) -> tuple[str, str]:
    """Return problem and advice for a major word that is not read."""
    if word in REFUSED:
        return f"{word} is not supported", REFUSED[word]
    near = did_you_mean(word, KNOWN)
    return f"unknown statement {word[:20]!r}", near or "Remove it if it does not move the tool."
