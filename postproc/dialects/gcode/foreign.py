"""Programs for other controls, recognised by the lines that cannot be read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

_POST = "In the CAM system choose a post-processor for LinuxCNC, or for plain Fanuc (ISO) without cycles and macros"
_SKIPPED_PARTS = re.compile(r'\([^()"]*\)|;.*|(?<=[#Oo])<[^<>]*>')
"""Parts of a line that are not searched: comments, and the names of parameters and subprograms."""
_SEARCH_LENGTH = 300
"""Number of characters of a line that are searched (assumed)."""


class ForeignFormat(NamedTuple):
    """A kind of program that is not supported.

    :param name: of the control or format, for messages.
    :param line: pattern of a line that only such programs have.
    :param advice: what to do.
    """

    name: str
    line: re.Pattern[str]
    advice: str


FOREIGN = (
    ForeignFormat(
        "Heidenhain DIN/ISO",
        re.compile(r"\s*(%\S+\s+G7[01]\s*\*|N?\d*\s*[GXYZTM].*\*\s*$)", re.IGNORECASE),
        f"{_POST}, or for KUKA KRL, instead of Heidenhain.",
    ),
    ForeignFormat(
        "lathe",
        re.compile(r".*(?<![A-Z])(G7[0-6]\s*[PQUW]\s*[\d.#\[]|G50\s*S\s*\d|G92\s*S\s*\d)", re.IGNORECASE),
        "Only milling programs are supported.",
    ),
    ForeignFormat(
        "Okuma",
        re.compile(r"\s*(\$\w+\.(MIN|SUB|SSB|MSB|LIB|SDF)\b|(N\d+\s*)?G15\s*H\d)", re.IGNORECASE),
        f"{_POST}, instead of Okuma.",
    ),
    ForeignFormat(
        "ShopBot",
        re.compile(r"\s*('|(SA|J[2-5XYZ]|M[2-5XYZ]|CN|VS|JS|MS|TR)\s*(,|$))", re.IGNORECASE),
        f"{_POST}, or for KUKA KRL, instead of ShopBot.",
    ),
    ForeignFormat(
        "plotter (HP-GL) or isel",
        re.compile(r"\s*(IN$|SP\d+;|P[UD](-?\d|;)|IMF_PBL|(N\d+\s+)?(MOVE|FAST)(ABS|REL))", re.IGNORECASE),
        f"{_POST}, or for KUKA KRL, instead.",
    ),
    ForeignFormat(
        "Fanuc custom macro (B)",
        re.compile(r"\s*(N\d+\s*)?(WHILE\s*\[|IF\s*\[|GOTO\s*[\d#\[]|END\s*\d|ENDWHILE|ENDIF)", re.IGNORECASE),
        "Set the CAM system to expand loops, or write them with O words (o1 while [#1 LT 5] … o1 endwhile).",
    ),
    ForeignFormat(
        "Heidenhain Klartext",
        re.compile(
            r"\s*(\d+\s+)?(BEGIN PGM|END PGM|BLK FORM|TOOL (CALL|DEF)|CYCL (DEF|CALL)|CALL (PGM|LBL)|LBL \d|PLANE )"
            r"|\s*\d+\s+(L|LN|LP|CC?|CP|CR|CT|CTP|RND|CHF|APPR|DEP|FN|FL|FC|STOP)\b",
            re.IGNORECASE,
        ),
        f"{_POST}, or for KUKA KRL, instead of Heidenhain.",
    ),
    ForeignFormat(
        "APT cutter-location (CLSF)",
        re.compile(
            r"\s*(PARTNO|LOADTL|MULTAX|PPRINT|END-OF-PATH|TLDATA|CATMAT|\$\$\s*[^\s=]|RAPID\s*$"
            r"|(GOTO|GODLTA|FEDRAT|SPINDL|FROM|CUTTER|TOOL PATH|MSYS|PAINT|LOAD|COOLNT|CIRCLE|UNITS|INTOL|OUTTOL)\s*/)",
            re.IGNORECASE,
        ),
        "Rename it to .apt, or add --dialect apt.",
    ),
    ForeignFormat(
        "KUKA KRL",
        re.compile(
            r"\s*(&(ACCESS|REL|PARAM|COMMENT)\b|(GLOBAL\s+)?DEF(FCT|DAT)?(?!\s+(REAL|INT|BOOL|STRING|CHAR|AXIS|FRAME)\b(?!\s+\w+\s*\())\s+\w+|S?(LIN|PTP|CIRC)(_REL)?\s+[{\w]|BAS\s*\(#)",
            re.IGNORECASE,
        ),
        "Rename it to .src, or add --dialect krl.",
    ),
    ForeignFormat(
        "slicer (3-D printing)",
        re.compile(
            r"(?!.*M6[78]).*((?<![A-Z])G0*[0123](?!\d).*\sE-?\.?\d|(?<![A-Z])(M(82|83|10[4679]|140)(?!\d)|M190\s*[SR]))",
            re.IGNORECASE,
        ),
        f"It is for extrusion. {_POST}, and convert a milling program.",
    ),
    ForeignFormat(
        "Siemens Sinumerik",
        re.compile(
            r".*(?<![A-Z])(CYCLE\d{2,4}|POCKET[1-4]|SLOT[12]|HOLES[12]|MCALL|SUPA|TRAORI|TRAFOOF"
            r"|A?(TRANS|ROT|MIRROR|SCALE)(?![A-Z])"
            r"|STOPRE|EXTCALL|WORKPIECE|COMP(ON|OF|CAD|CURV|SURF)|FFW(ON|OF)|ORI(WKS|MKS|AXES|VECT)|CFC|CFTCP|CFIN"
            r"|CUT[23]D|[ABC]SPLINE(?![A-Z])|BRISK(?![A-Z])|SOFT(?![A-Z])|GROUP_(BEGIN|END)|REPEATB?"
            r"|DEF (REAL|INT|STRING|BOOL)|G(153|500|505)(?![\d.])"
            r"|MSG(?![A-Z])|(CR|AP|RP|TURN|R\d+|[ABC]3|[IJK]1)\s*=|[XYZIJKABC]\s*=\s*(R\d|[AID]C(?![A-Z]))|T\s*=\s*\"|%_N_)",
            re.IGNORECASE,
        ),
        f"{_POST}, or for KUKA KRL, instead of Siemens (Sinumerik 840D, 828D).",
    ),
    ForeignFormat(
        "Siemens Sinumerik",
        re.compile(r".*(?<![A-Z])G7[01](?![\d.])", re.IGNORECASE),
        f"{_POST}, or for KUKA KRL, instead of Siemens (Sinumerik 840D, 828D). If nothing but G70 or G71 is special, "
        "write G20 or G21.",
    ),
)
"""Kinds of programs that are recognised and refused; the first that matches a line counts."""


def recognise(lines: Sequence[str]) -> tuple[int, ForeignFormat] | None:
    """Return the index of the first line that shows a foreign format, and the format; None if no line shows one.

    :param lines: lines that cannot be read, with their comments, in order.
    """
    for index, line in enumerate(lines):
        for foreign_format in FOREIGN:
            if foreign_format.line.match(_SKIPPED_PARTS.sub("", line[:_SEARCH_LENGTH])):
                return index, foreign_format
    return None
