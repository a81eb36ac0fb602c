"""Names of KRL: which names the controller accepts, and which words are reserved."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from zlib import crc32

from postproc.dialects.krl.language.tokens import NAME

MAX_LENGTH = 24
"""Longest name the controller accepts."""

_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss"})
CONTROLLER_DATA = frozenset({"BASE_DATA", "TOOL_DATA", "FDAT_ACT", "LDAT_ACT", "PDAT_ACT"})
"""Data of the controller, which all files share."""


def words(text: str) -> frozenset[str]:
    """Return the words of a text separated by blanks."""
    return frozenset(text.split())


MOTIONS = words("LIN PTP CIRC SLIN SPTP SCIRC SPL")
"""Motion instructions that are read; each may carry ``_REL``."""

MOTION_WORDS = MOTIONS | {f"{word}_REL" for word in MOTIONS}

CIRCLES = ("CIRC", "SCIRC")
"""Motion instructions with an auxiliary point."""

FRAMES = ("#BASE", "#TOOL")
"""Axes in which the target of a relative motion is given."""

APPROXIMATIONS = words("C_DIS C_VEL C_ORI C_PTP C_SPL")
"""Words behind the points of a motion: it is approximated."""

SPLINES = {"SPLINE": ("SPL", "SLIN", "SCIRC"), "PTP_SPLINE": ("SPTP",)}
"""Spline blocks, and the instructions that may be in them; ENDSPLINE closes both."""

OPENING = {"FOR": "ENDFOR", "WHILE": "ENDWHILE", "LOOP": "ENDLOOP", "IF": "ENDIF", "SWITCH": "ENDSWITCH"}
"""Control structures and the word that closes each; REPEAT … UNTIL is not among them."""

TYPES = words("INT REAL BOOL CHAR FRAME POS E6POS E3POS AXIS E6AXIS E3AXIS")
"""Predefined types, which need no DECL."""

WITHOUT_MOTION = words(
    "ANIN ANOUT BRAKE CASE CHANNEL CLEAR CONFIRM CONTINUE DEFAULT DIGIN ELSE ENUM ERR_CLEAR ERR_RAISE EXIT EXT EXTFCT "
    "EXTFCTP EXTP HALT IMPORT ON_ERROR_PROCEED PULSE RESUME SIGNAL STRUC WAIT"
)
"""Statements that move nothing and change nothing that a motion depends on."""

DECLARATIONS = words("CHANNEL ENUM EXT EXTFCT EXTFCTP EXTP IMPORT SIGNAL STRUC")
"""Statements that declare and do nothing."""

PURE = words(
    "ABS ACOS ATAN2 COS SIN SQRT TAN FORWARD INVERSE INV_POS VARSTATE STRLEN STRDECLLEN STRCOMP STRFIND GETVARSIZE EK "
    "EO SACC_CP SACC_JOINT SAPO SAPO_PTP SBASE SCIRC_M SCIRC_TYP SCIRC_TYPE SGEAR_JERK SIPO_MODE SJERK SLOAD SORI_TYP "
    "SORI_TYPE STOOL STOOL2 SVEL_CP SVEL_JOINT SVEL_PTP USE_CM_PRO_VALUES SYNCCMD GETCYCDEF EXISTS_KRLMSG "
    "EXISTS_KRLDLG ROUND"
)
"""Functions of the controller that change nothing."""

STANDARD = words(
    "IR_STOPM PULSE CWRITE CREAD COPEN CCLOSE CIOCTL SREAD SWRITE CAST_TO CAST_FROM CLEAR STRCLEAR STRCOPY STRADD "
    "STRTOREAL STRTOINT DELETE_BACKWARD_BUFFER ERR_CLEAR ERR_RAISE SET_KRLMSG SET_KRLDLG CLEAR_KRLMSG GET_MSGBUFFER "
    "MBX_REC MD_CMD MD_GETSTATE MD_ASGN TRIGGER_RESET"
)
"""Programs and functions of the controller that neither move the robot nor change more than their arguments."""

SYNCHRONISING = words("SYNCCMD $SYNC_ID $SYNC_LIST")
"""Names that synchronise a robot with others (KUKA.RoboTeam): the program `SYNCCMD`, and the variables of
synchronised motions.
"""
BY_SENSOR = words("RSI_ON RSI_MOVECORR ST_ON ST_ON1")
"""Routines of KUKA.RobotSensorInterface by which a sensor moves the robot; none has a .src to read."""
BY_FILE = words("CR_PROCESS_FILE")
"""Routines of KUKA.CAMRob that move the robot along the points of a file."""

RESERVED = (
    MOTIONS
    | TYPES
    | WITHOUT_MOTION
    | OPENING.keys()
    | words(
        "AND B_AND B_EXOR B_NOT B_OR CIRC_REL CONST C_DIS C_ORI C_PTP C_SPL C_VEL DECL DEF DEFDAT DEFFCT DELAY DO END "
        "ENDDAT ENDFCT ENDFOR ENDIF ENDLOOP ENDSPLINE ENDSWITCH ENDWHILE EXOR FALSE GLOBAL GOTO INTERRUPT LIN_REL "
        "MAXIMUM MINIMUM NOT OR PRIO PTP_REL PUBLIC REPEAT RETURN SEC SPL SPLINE STEP THEN TO TRIGGER TRUE UNTIL WHEN "
        "WITH"
    )
)
"""Words that cannot be the name of a program or a point."""


def fault_of(name: str) -> str | None:
    """Return the reason why the controller refuses a name of a program or a point; None if it accepts the name.

    >>> fault_of("PART_1"), fault_of("1001")
    (None, 'it does not begin with a letter or underscore')
    """
    if len(name) > MAX_LENGTH:
        return f"it has {len(name)} characters, {MAX_LENGTH} are allowed"
    if not (name[:1].isascii() and name[:1].isalpha()) and name[:1] != "_":
        return "it does not begin with a letter or underscore"
    if not NAME.fullmatch(name):
        return "it holds other characters than letters, digits and underscores"
    if name.upper() in RESERVED:
        return "it is a word of KRL"
    return None


def valid_name(name: str) -> str:
    """Return a name unchanged if the controller accepts it, otherwise one as close to it as possible.

    >>> valid_name("part_1"), valid_name("1001"), valid_name("Gehäuse oben.2"), valid_name("loop")
    ('part_1', 'P1001', 'Gehaeuse_oben_2', 'P_loop')
    """
    if fault_of(name) is None:
        return name
    ascii_name = unicodedata.normalize("NFKD", name.translate(_UMLAUTS)).encode("ascii", "ignore").decode()
    new_name = re.sub(r"\W+", "_", ascii_name).strip("_") or "PROGRAM"
    new_name = (
        f"P_{new_name}" if new_name.upper() in RESERVED else f"P{new_name}" if new_name[0].isdigit() else new_name
    )
    return new_name[:MAX_LENGTH].rstrip("_")


def unused_name(name: str, used_names: Iterable[str]) -> str:
    """Return a name that is not among `used_names` (upper case): `name`, shortened if needed, with ``_2``, ``_3`` …"""
    return Names(set(used_names)).unused_name(name)


class Names:
    """New names that are not in use.

    :param used_names: names in use, upper case; `unused_name` adds each new name.
    """

    def __init__(self, used_names: set[str]) -> None:
        """Begin with the names that are in use."""
        self.used_names = used_names
        self._next_number: dict[str, int] = {}  # name, upper case → number to try next

    def unused_name(self, name: str) -> str:
        """Return a new name, and add it to `used_names`: `name`, shortened if necessary, with ``_2``, ``_3`` …

        Shortened names differ where the names do, also those for files that are written by different runs: four digits
        are computed from the whole name.
        """
        number = self._next_number.get(name.upper(), 2)
        while True:
            tail = f"_{number}"
            candidate = name + tail
            if len(candidate) > MAX_LENGTH:
                tail = f"_{crc32(name.upper().encode()) & 0xFFFF:04X}{tail}"
                candidate = name[: MAX_LENGTH - len(tail)] + tail
            number += 1
            if candidate.upper() not in self.used_names:
                break
        self._next_number[name.upper()] = number
        self.used_names.add(candidate.upper())
        return candidate
