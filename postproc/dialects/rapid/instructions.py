"""Instructions and functions of RAPID by their effect: they move the robot, set how it moves, change data or nothing.

Source of the effects: ABB, Technical reference manual, RAPID Instructions, Functions and Data types (3HAC16581 and
3HAC050917). Source of the names: the lists for editors in github.com/KnoP-01/rapid-for-vim (syntax/rapid.vim),
github.com/RoboDK/Industrial-Robots-VSCode (python/theme_ABB.py) and github.com/ernell/ABB-RAPID-UTILITY-LIBRARY
(SyntaxHighlight/RAPID.uew). A name that is in none of them counts as a routine of another file.
"""

from __future__ import annotations

import re

from msgspec import Struct

from postproc.dialects.rapid.language import HARMLESS, MOVING
from postproc.program import CIRC, LIN, PTP


class Form(Struct, frozen=True):
    """Arguments of an instruction that moves the robot.

    The order is: targets, speed, triggers, zone, tool, further arguments such as a signal and its value.

    :ivar kind: `LIN`, `CIRC` or `PTP`.
    :ivar target_count: number of targets; of two, the first is the point on the circle.
    :ivar takes_joints: True if the target is a jointtarget, not a robtarget.
    :ivar count_before_zone: number of arguments between speed and zone: triggers.
    :ivar most_behind_tool: largest number of arguments behind the tool.
    """

    kind: int
    target_count: int = 1
    takes_joints: bool = False
    count_before_zone: int = 0
    most_behind_tool: int = 0


MOVES: dict[str, Form] = {
    "MOVEL": Form(LIN),
    "MOVEJ": Form(PTP),
    "MOVEC": Form(CIRC, target_count=2),
    "MOVEABSJ": Form(PTP, takes_joints=True),
    "MOVELDO": Form(LIN, most_behind_tool=2),
    "MOVEJDO": Form(PTP, most_behind_tool=2),
    "MOVECDO": Form(CIRC, target_count=2, most_behind_tool=2),
    "MOVELAO": Form(LIN, most_behind_tool=2),
    "MOVELGO": Form(LIN, most_behind_tool=2),
    "MOVELSYNC": Form(LIN, most_behind_tool=1),
    "MOVEJSYNC": Form(PTP, most_behind_tool=1),
    "MOVECSYNC": Form(CIRC, target_count=2, most_behind_tool=1),
    "TRIGGL": Form(LIN, count_before_zone=1),
    "TRIGGJ": Form(PTP, count_before_zone=1),
    "TRIGGC": Form(CIRC, target_count=2, count_before_zone=1),
}
"""Instruction that is followed → its arguments. TriggL, TriggJ and TriggC switch before their end."""
CONSTANT = {
    "ACCSET", "PATHACCLIM", "WORLDACCLIM", "GRIPLOAD", "MECHUNITLOAD", "EOFFSOFF", "PDISPOFF", "CORRCLEAR", "SOFTDEACT",
    "CORRDISCON", "STARTMOVE", "TRIGGIO", "TRIGGEQUIP", "TRIGGINT", "TRIGGSPEED", "TRIGGRAMPAO", "TRIGGCHECKIO",
}  # fmt: skip
"""Instructions whose names begin like those of moves, but that change neither the path nor the speed of milling."""
COUNTING = ("INCR", "DECR", "ADD", "CLEAR")
"""Instructions that change a number; they are followed."""
_WRITING_NAMES = """
CLKREAD TPREADFK TPREADNUM TPREADDNUM GETSYSDATA READBLOCK ALIASIO BITCLEAR BITSET BOOKERRNO CANCELLOAD CHECKPROGREF
CLEARIOBUFF CLEARRAWBYTES CLOSEDIR COPYFILE COPYRAWBYTES GETDATAVAL GETTRAPDATA IERROR IOBUSSTART IOBUSSTATE IODISABLE
IOENABLE IPERS IRMQMESSAGE ISIGNALAI ISIGNALAO ISIGNALGI ISIGNALGO IVARVALUE MAKEDIR OPENDIR PACKDNHEADER PACKRAWBYTES
READANYBIN READCFGDATA READERRDATA READRAWBYTES REMOVEDIR REMOVEFILE RENAMEFILE RESETRETRYCOUNT REWIND RMQEMPTYQUEUE
RMQFINDSLOT RMQGETMESSAGE RMQGETMSGDATA RMQGETMSGHEADER RMQREADWAIT RMQSENDMESSAGE RMQSENDWAIT SCWRITE SETDATASEARCH
SKIPWARN SOCKETACCEPT SOCKETBIND SOCKETCLOSE SOCKETCONNECT SOCKETCREATE SOCKETLISTEN SOCKETRECEIVE SOCKETRECEIVEFROM
SOCKETSEND SOCKETSENDTO SPYSTART SPYSTOP STARTLOAD SYSTEMSTOPACTION TESTSIGNDEFINE TESTSIGNRESET TEXTTABINSTALL TRYINT
UIMSGWRITE UIMSGWRITEABORT UISHOW UNPACKRAWBYTES WAITAO WAITGO WAITLOAD WAITTESTANDSET WRITEANYBIN WRITEBIN WRITEBLOCK
WRITERAWBYTES WRITESTRBIN WRITEVAR WZBOXDEF WZCYLDEF WZDISABLE WZDOSET WZENABLE WZFREE WZHOMEJOINTDEF WZLIMJOINTDEF
WZLIMSUP WZSPHDEF
"""
WRITING = frozenset((*COUNTING, *_WRITING_NAMES.split()))
"""Instructions that move nothing and change no data except their arguments."""
BY_NAME = frozenset(("SETDATAVAL", "SETALLDATAVAL"))
"""Instructions that change data whose names are computed at run time."""
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
"""Options of instructions to whose data the instruction writes a result."""
_PURE_NAMES = """
OFFS RELTOOL ORIENTZYX EULERZYX ABS SQRT POW EXP SIN COS TAN ASIN ACOS ATAN ATAN2 ROUND TRUNC MAX MIN NUMTOSTR VALTOSTR
STRLEN STRPART STRFIND STRMATCH STRMAP STRMEMB STRORDER STRTOBYTE BYTETOSTR DECTOHEX HEXTODEC BITAND BITOR BITXOR
BITNEG BITCHECK BITLSH BITRSH DIM PRESENT ISPERS ISVAR ARGNAME TYPE CPOS CROBT CJOINTT CTOOL CWOBJ CALCROBT CALCJOINTT
POSEINV POSEMULT POSEVECT DEFFRAME DEFDFRAME MIRPOS NORIENT DISTANCE DOTPROD CROSSPROD VECTMAGN DINPUT DOUTPUT AINPUT
AOUTPUT GINPUT GOUTPUT GINPUTDNUM GOUTPUTDNUM TESTDI CLKREAD CDATE CTIME GETTIME OPMODE RUNMODE ROBOS ISFILE READMOTOR
DNUMTONUM NUMTODNUM DNUMTOSTR ABSDNUM SQRTDNUM POWDNUM ROUNDDNUM TRUNCDNUM SINDNUM COSDNUM TANDNUM ASINDNUM ACOSDNUM
ATANDNUM ATAN2DNUM BITANDDNUM BITORDNUM BITXORDNUM BITNEGDNUM BITCHECKDNUM BITLSHDNUM BITRSHDNUM CSPEEDOVERRIDE
EVENTTYPE EXECHANDLER EXECLEVEL FILESIZE FILETIME FSSIZE GETMECUNITNAME GETMODALPAYLOADMODE GETSERVICEINFO GETSYSINFO
GETTASKNAME INDINPOS INDSPEED IOUNITSTATE ISBRAKECHECKACTIVE ISMECHUNITACTIVE ISSTOPMOVEACT ISSTOPSTATEEVENT
ISSYNCMOVEON ISSYSID MAXROBSPEED MODEXIST MODTIME MOTIONPLANNERNO NONMOTIONMODE OROBT PARIDROBVALID PATHLEVEL
PATHRECVALIDBWD PATHRECVALIDFWD PFRESTART PPMOVEDINMANMODE PROGMEMFREE RAWBYTESLEN REMAININGRETRIES ROBNAME
SOCKETGETSTATUS SOCKETPEEK STRDIGCALC STRDIGCMP TASKISACTIVE TASKISEXECUTING TASKRUNMEC TASKRUNROB TASKSINSYNC
TESTSIGNREAD TEXTGET TEXTTABFREETOUSE TEXTTABGET UICLIENTEXIST VALIDIO
"""
PURE = frozenset(_PURE_NAMES.split())
"""Functions of RAPID that change none of their arguments."""
_CHANGING_NAMES = """
STRTOVAL UIMESSAGEBOX UINUMENTRY UINUMTUNE UIALPHAENTRY UIDNUMENTRY UIDNUMTUNE UILISTVIEW READNUM READSTR READBIN
READSTRBIN READDIR READVAR CORRREAD TESTANDSET GETNEXTMECHUNIT GETNEXTSYM GETSIGNALORIGIN RMQGETSLOTNAME
CALCROTAXISFRAME CALCROTAXFRAMEZ DEFACCFRAME PARIDPOSVALID
"""
FUNCTIONS = PURE | frozenset(_CHANGING_NAMES.split())
"""Functions of RAPID. Functions that are not in `PURE` may change their arguments, but no other data."""
_PROCESS_MOVES = re.compile(
    "ARC(ADAPT|CALC)?[CL][12]?(START|END)?|ARC(ADAPT)?REPL|ARCMOVEEXTJ|BESETUPTOOLJ|CALIB[JL]|CAP[CL]|CONTACTL|CSSDEACTMOVEL|"
    "DAPROCM[JL]|DISP[CL]|DROPWOBJ|EGM(MOVE[CL]|RUNJOINT|RUNPOSE)|FCPRESS(1LSTART|[CL]|END)|FCREFSTART|GLUE[CJL]|"
    "HOLLOWWRISTRESET|MEASUREWEARL|NUT[JL]|PAINT([CL]|LSIG|LDO)|PATHRECMOVE[BF]WD|SPOTM?[JL]|STEPBWDPATH|"
    "SYNCMOVE(ON|OFF|RESUME|SUSPEND|UNDO)|SYNCTOSENSOR|WAITWOBJ"
)
"""Instructions of processes (arc and spot welding, gluing, painting, dispensing, force control …) that move the robot,
or lead it by other robots and conveyors."""
SETTINGS = {"SINGAREA", "CONFL", "CONFJ", "CIRPATHMODE", "VELSET"}
STOPPING = {"EXIT", "EXITCYCLE", "STOP", "BREAK"}


def is_unfollowed_motion(name: str) -> bool:
    """Return whether an instruction of RAPID moves the robot, or changes how it moves, and is not followed."""
    return (MOVING.match(name) is not None and name not in CONSTANT) or _PROCESS_MOVES.fullmatch(name) is not None


def is_of_rapid(name: str) -> bool:
    """Return whether a name is that of an instruction or function of RAPID."""
    groups = (MOVES, SETTINGS, CONSTANT, READING, WRITING, BY_NAME, STOPPING, FUNCTIONS)
    return any(name in names for names in groups) or is_unfollowed_motion(name)
