"""Messages name lines of files: behind a loop of ten rounds the same as behind one motion for each of its lines."""

import pytest
from msgspec.structs import replace

from postproc.cell import Krl
from postproc.errors import PostprocError
from tests.dialects.krl_programs import CELL, read

LOOP = ("FOR ROUNDS=1 TO 10", "STEPPED(ROUNDS)", "LIN {X 1,Y 2,Z 3,A 4,B 5,C 6}", "ENDFOR")
PLAIN = (
    "LIN {X 1,Y 2,Z 3,A 4,B 5,C 6}",
    "STEPPED(1)",
    "LIN {X 1,Y 2,Z 3,A 4,B 5,C 6}",
    "LIN {X 1,Y 2,Z 3,A 4,B 5,C 6}",
)
BEHIND = ("DEF STEPPED(K:IN)", "DECL INT K", "LIN {X K,Y 2,Z 3,A 4,B 5,C 6}", "LIN {X 1,Y 2,Z 3,A 4,B 5,C 6}", "END")
"""A routine that both call, below the main one."""
LOOP_DAT = """DEFDAT part PUBLIC
DECL INT ROUNDS=0
DECL INT I=1
DECL REAL V=0.5
DECL BOOL OK=FALSE
DECL E6POS P[3]
P[1]={X 1,Y 2,Z 3,A 4,B 5,C 6}
P[2]={X 11,Y 2,Z 3,A 4,B 5,C 6}
P[3]={X 21,Y 2,Z 3,A 4,B 5,C 6}
ENDDAT
"""
HERE, THERE = "LIN {X 7,Y 8,Z 9,A 4,B 5,C 6}", "LIN {X 17,Y 8,Z 9,A 4,B 5,C 6}"
FRAMES = "$BASE={X 900,Y 0,Z 500,A 0,B 0,C 0}"
MOVER = ("DEF MOVER()", THERE, "END")
SETTER = ("DEF SETTER()", "$VEL.CP=0.25", "END")
FUNCTION = ("DEFFCT REAL PEEK()", "$VEL.CP=0.25", "RETURN (5.5)", "ENDFCT")
JUMPER = ("DEF JUMPER()", "IF $IN[1] THEN", "GOTO OUT", "ENDIF", THERE, "OUT:", THERE, "END")
ENDLESS = ("LOOP", HERE, "I=I+1", "LIN P[I]", "ENDLOOP")

CASES = {
    "target of an input": ["I=$ANIN[1]", "LIN P[I]"],
    "index out of the array": ["I=9", "LIN P[I]"],
    "condition of an input": ["IF $IN[1] THEN", HERE, "ENDIF"],
    "condition of an input, frames": ["IF $IN[1] THEN", FRAMES, "ENDIF", HERE],
    "condition of an input, called": ["IF $IN[1] THEN", "MOVER()", "ENDIF", HERE],
    "branches that end apart": ["IF $IN[1] THEN", HERE, "ELSE", THERE, "ENDIF", HERE],
    "value changed in a branch": ["IF $IN[1] THEN", "I=2", "ENDIF", "LIN P[I]"],
    "value of a called routine": ["ASK(I)", "LIN P[I]"],
    "bounds of an input": ["FOR I=1 TO $ANIN[1]", "LIN P[1]", "ENDFOR"],
    "a REAL counts": ["FOR V=1 TO 2", "LIN P[1]", "ENDFOR"],
    "a REAL bounds": ["FOR I=1 TO V", "LIN P[1]", "ENDFOR"],
    "no step": ["FOR I=1 TO 2 STEP 0", "LIN P[1]", "ENDFOR"],
    "too many rounds": ["FOR I=1 TO 2000000", "LIN P[1]", "ENDFOR"],
    "WHILE of an input": ["WHILE $IN[1]", HERE, "ENDWHILE"],
    "REPEAT of an input": ["REPEAT", HERE, "UNTIL $IN[1]"],
    "WHILE without an end": ["WHILE NOT OK", HERE, "ENDWHILE"],
    "LOOP left by an input": ["LOOP", HERE, "IF $IN[1] THEN", "EXIT", "ENDIF", "ENDLOOP"],
    "rounds of LOOP differ": ENDLESS,
    "round of LOOP ends elsewhere": ["LOOP", HERE, FRAMES, "LIN {Z 7}", "ENDLOOP"],
    "endless LOOP": ["LOOP", HERE, "ENDLOOP"],
    "endless LOOP under new speeds": ["LOOP", HERE, "$VEL.CP=$VEL.CP*0.5", "ENDLOOP"],
    "GOTO back": ["AGAIN:", HERE, "GOTO AGAIN"],
    "GOTO back on an input": ["AGAIN:", HERE, "IF $IN[1] THEN", "GOTO AGAIN", "ENDIF"],
    "GOTO nowhere": [HERE, "GOTO NOWHERE", THERE],
    "GOTO into a loop": ["GOTO INSIDE", "FOR I=1 TO 2", "INSIDE:", HERE, "ENDFOR"],
    "interrupt that moves": ["INTERRUPT DECL 4 WHEN $IN[1]==TRUE DO MOVER()", "INTERRUPT ON 4", HERE],
    "interrupt that sets": ["INTERRUPT DECL 4 WHEN $IN[1]==TRUE DO SETTER()", "INTERRUPT ON 4", HERE],
    "interrupt that changes": ["INTERRUPT DECL 4 WHEN $IN[1]==TRUE DO I=2", "INTERRUPT ON 4", "LIN P[I]"],
    "trigger that moves": ["TRIGGER WHEN DISTANCE=0 DELAY=0 DO MOVER()", HERE],
    "trigger that sets": ["TRIGGER WHEN DISTANCE=0 DELAY=0 DO SETTER()", HERE],
    "ANIN": ["ANIN ON V=0.1*$ANIN[1]+0", "$VEL.CP=V", HERE],
    "speed of an input": ["$VEL.CP=$ANIN[1]", HERE],
    "speed too high": ["$VEL.CP=99", HERE],
    "frame of an input": ["$BASE=BASE_DATA[$ANIN[1]]", HERE],
    "frame not in the cell": ["$BASE=BASE_DATA[17]", HERE],
    "incomplete frame": ["$BASE={X 5}", HERE],
    "frame by EK": ["$BASE=EK(MACHINE_DEF[2].ROOT,#EASYS,EX_AX_DATA[1])", HERE],
    "components missing": ["$BASE=BASE_DATA[3]", "LIN {X 5}"],
    "part of a rotation missing": ["LIN {X 5,Y 5,Z 5,A 0,B 95,C 0}", "LIN {X 5,A 10}"],
    "relative rotation": ["LIN_REL {A 5}"],
    "circle on a line": ["CIRC {X 2,Y 2,Z 3},{X 3,Y 2,Z 3,A 4,B 5,C 6}"],
    "circle without a point": ["CIRC {X 2,Y 2,Z 3}"],
    "CA of nothing": ["CIRC {X 2,Y 9,Z 3},{X 3,Y 2,Z 3,A 4,B 5,C 6},CA 0"],
    "position now": ["LIN $POS_ACT"],
    "tail": ["LIN {X 7,Y 8,Z 9,A 4,B 5,C 6} C_WHAT"],
    "C_VEL": ["LIN {X 7,Y 8,Z 9,A 4,B 5,C 6} C_VEL", HERE],
    "out of reach": ["LIN {X 70000000,Y 8,Z 9,A 4,B 5,C 6}"],
    "statement": ["LIN {X 7,Y 8,Z 9,A 4,B 5,C 6}", "WHAT IS THIS"],
    "BAS": ["BAS(#WHAT,3)", HERE],
    "SPL outside": ["SPL {X 7,Y 8,Z 9,A 4,B 5,C 6}"],
    "LIN in a spline block": ["SPLINE", HERE, "ENDSPLINE"],
    "spline block not closed": ["SPLINE", "SLIN {X 7,Y 8,Z 9,A 4,B 5,C 6}"],
    "spline block in another": ["SPLINE", "SPLINE", "SLIN {X 7,Y 8,Z 9,A 4,B 5,C 6}", "ENDSPLINE", "ENDSPLINE"],
    "spline block whose function sets": ["SPLINE", "SLIN {X PEEK(),Y 8,Z 9,A 4,B 5,C 6}", "ENDSPLINE", HERE],
    "IF not closed": ["IF OK THEN", HERE],
    "ENDIF alone": [HERE, "ENDIF"],
    "asynchronous axes": ["ASYPTP {E1 5}", HERE],
    "synchronised": ['SYNCCMD(#MOTIONSYNC,"A",3)', HERE],
    "synchronised, between": ['SYNCCMD(#PROGSYNC,"A",3)', HERE, 'SYNCCMD(#PROGSYNC,"B",3)', HERE],
    "jumping routine": ["JUMPER()", HERE],
    "calls itself": ["PART()", HERE],
    "sensor": ["TOUCHSENSE()", HERE],
    "workpiece on the robot": ["$IPO_MODE=#TCP", HERE],
    "orientation mode": ["$ORI_TYPE=$ANIN[1]", HERE],
    "state of the next run": ["I=I+1", "LIN P[I]"],
    "a branch of forces": [";FORCE FX=10 FRAME=BASE", "IF $IN[1] THEN", ";FORCE FX=20 FRAME=BASE", "ENDIF", HERE],
    "force beside a statement": ["LIN {X 7,Y 8,Z 9,A 4,B 5,C 6} ;FORCE FX=10 FRAME=BASE", HERE],
    "external axis": ["LIN {X 7,Y 8,Z 9,A 4,B 5,C 6,E1 5}", "LIN {X 7,Y 8,Z 9,A 4,B 5,C 6,E1 15}"],
}


def messages(first, lines, *, keep):
    """Text, line and wording of the line of all errors and issues of a program that begins with some lines."""
    text = "\n".join(["DEF part()", "BAS(#INITMOV,0)", HERE, *first, *lines, "END", *BEHIND, *MOVER, *SETTER, *FUNCTION,
                      *JUMPER, ""])  # fmt: skip
    try:
        program = read(text, LOOP_DAT, replace(CELL, krl=Krl(initmov="cell", keep_unresolved=keep)))
    except PostprocError as cause:
        return [(error.problem, error.advice, error.line, error.text) for error in (cause, *cause.further_errors)]
    unfollowed = [(call.line, str(call.error)) for call in program.unfollowed]
    unresolved = [(motion.line, motion.text) for motion in program.unresolved]
    return [(issue.kind, issue.message, issue.source_line) for issue in program.issues] + unfollowed + unresolved


@pytest.mark.parametrize("keep", [False, True])
@pytest.mark.parametrize("case", CASES)
def test_messages_behind_many_rounds_name_the_lines_of_the_file(case, keep):
    actual, expected = (messages(first, CASES[case], keep=keep) for first in (LOOP, PLAIN))
    assert actual == expected
