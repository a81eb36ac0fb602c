"""Instructions and functions of RAPID by what they do: move the robot, set how it moves, change data or nothing.

Source: ABB, Technical reference manual, RAPID Instructions, Functions and Data types (3HAC16581).
"""

from __future__ import annotations

from msgspec import Struct

from postproc.dialects.rapid.language import HARMLESS
from postproc.program import CIRC, LIN, PTP


class Form(Struct, frozen=True):
    """Arguments of an instruction that moves the robot.

    :ivar points: how many targets come first; of two, the first is the point on the circle.
    :ivar behind: how many arguments may follow the tool.
    """

    kind: int
    points: int = 1
    joints: bool = False
    before_zone: int = 0
    behind: int = 0


MOVES: dict[str, Form] = {
    "MOVEL": Form(LIN),
    "MOVEJ": Form(PTP),
    "MOVEC": Form(CIRC, points=2),
    "MOVEABSJ": Form(PTP, joints=True),
    "MOVELDO": Form(LIN, behind=2),
    "MOVEJDO": Form(PTP, behind=2),
    "MOVECDO": Form(CIRC, points=2, behind=2),
    "MOVELAO": Form(LIN, behind=2),
    "MOVELGO": Form(LIN, behind=2),
    "MOVELSYNC": Form(LIN, behind=1),
    "MOVEJSYNC": Form(PTP, behind=1),
    "MOVECSYNC": Form(CIRC, points=2, behind=1),
    "TRIGGL": Form(LIN, before_zone=1),
    "TRIGGJ": Form(PTP, before_zone=1),
    "TRIGGC": Form(CIRC, points=2, before_zone=1),
}
"""Instructions that are followed; TriggL and its like switch at a distance from their end."""
CONSTANT = {
    "ACCSET", "PATHACCLIM", "WORLDACCLIM", "GRIPLOAD", "MECHUNITLOAD", "EOFFSOFF", "PDISPOFF", "CORRCLEAR", "SOFTDEACT",
    "CORRDISCON", "STARTMOVE", "TRIGGIO", "TRIGGEQUIP", "TRIGGINT", "TRIGGSPEED", "TRIGGRAMPAO", "TRIGGCHECKIO",
}  # fmt: skip
"""Instructions of the family of moves that change neither the path nor the speed that counts here."""
COUNTING = ("INCR", "DECR", "ADD", "CLEAR")
"""Instructions that change a number, which are followed."""
WRITING = {*COUNTING, "CLKREAD", "TPREADFK", "TPREADNUM", "TPREADDNUM", "GETSYSDATA", "READBLOCK"}
READING = HARMLESS - WRITING | {
    "TPSHOW", "ERRWRITE", "ERRLOG", "ACTUNIT", "DEACTUNIT", "WRITE", "OPEN", "CLOSE", "IDELETE", "ISIGNALDI",
    "ISIGNALDO", "IENABLE", "IDISABLE", "IWATCH", "ISLEEP", "ITIMER", "EXITCYCLE", "BREAK", "SPEEDREFRESH",
    "MOTIONSUP", "SINGAREA", "CONFL", "CONFJ", "CIRPATHMODE", "VELSET", "SETDO", "PULSEDO", "CONNECT", "UIMSGBOX",
    "LOAD", "UNLOAD", "ERASEMODULE", "WAITSYNCTASK", "SAVE", "SETSYSDATA",
}  # fmt: skip
"""Instructions that change no data of the program."""
RESULT_OPTIONS = {
    "TIMEFLAG", "VALUEATTIMEOUT", "RESULT", "ERRORNUMBER", "ERRORSTRING", "BREAKFLAG", "DICTIONARYSTRING",
}  # fmt: skip
"""Options of instructions whose data they change."""
_PURE_NAMES = """
OFFS RELTOOL ORIENTZYX EULERZYX ABS SQRT POW EXP SIN COS TAN ASIN ACOS ATAN ATAN2 ROUND TRUNC NUMTOSTR VALTOSTR
STRLEN STRPART STRFIND STRMATCH STRMAP STRMEMB STRORDER STRTOBYTE BYTETOSTR DECTOHEX HEXTODEC BITAND BITOR BITXOR
BITNEG BITCHECK BITLSH BITRSH DIM PRESENT ISPERS ISVAR ARGNAME TYPE CPOS CROBT CJOINTT CTOOL CWOBJ CALCROBT
POSEINV POSEMULT POSEVECT DEFFRAME DEFDFRAME MIRPOS NORIENT DISTANCE DOTPROD VECTMAGN DINPUT DOUTPUT AINPUT AOUTPUT
GINPUT GOUTPUT TESTDI CLKREAD CDATE CTIME GETTIME OPMODE RUNMODE ROBOS ISFILE READMOTOR DNUMTONUM NUMTODNUM
"""
PURE = frozenset(_PURE_NAMES.split())
"""Functions of RAPID that change none of their arguments (ABB, "RAPID Instructions, Functions and Data types")."""
_RUN_TIME_NAMES = """
STRTOVAL UIMESSAGEBOX UINUMENTRY UINUMTUNE UIALPHAENTRY UIDNUMENTRY UILISTVIEW UICLIENTEXIST READNUM READSTR READBIN
READSTRBIN READDIR FILESIZE FILETIME MODTIME SOCKETGETSTATUS TESTSIGNREAD ISSTOPSTATEEVENT ISSYSID ISBRAKECHECKACTIVE
GETMECUNITNAME GETNEXTMECHUNIT GETTASKNAME GETNEXTSYM GETMODALPAYLOADMODE RAND CALCJOINTT CALCROTAXISFRAME
CALCROTAXFRAMEZ ISPERS ISVAR EVENTTYPE EXECHANDLER EXECLEVEL MAXROBSPEED MOTORPLANNER NONMOTIONMODE
PARIDPOSVALID PARIDROBVALID PATHLEVEL PATHRECVALIDBWD PATHRECVALIDFWD PFRESTART POWERMODE ROBNAME SAFETYCONTROLLER
STRDIGCALC STRDIGCMP STRFORMAT TASKRUNMEC TASKRUNROB TASKSINSYNC TESTANDSET VALIDIO VECTMAGN VALUETOSTR GETSERVICEINFO
GETSIGNALORIGIN HEXTODEC DECTOHEX BITANDDNUM BITCHECKDNUM CSPEEDOVERRIDE CROBOTT CPATHLENGTH ENTRYSTATUS
"""
FUNCTIONS = PURE | frozenset(_RUN_TIME_NAMES.split())
"""Functions of RAPID. Those besides `PURE` give their value at run time, and may change their arguments but no other
data."""
SETTINGS = {"SINGAREA", "CONFL", "CONFJ", "CIRPATHMODE", "VELSET"}
STOPPING = {"EXIT", "EXITCYCLE", "STOP", "BREAK"}
