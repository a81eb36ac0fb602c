"""Values that expressions give: BOOL, bits, quotients, rounding, pure functions. The oracle runs all."""

import numpy as np
import pytest

from postproc.errors import ProgramError
from tests.attack.krl import confirmed, read_job
from tests.dialects.krl_programs import body, read

FULL = "LIN {X 10,Y 20,Z 300,A 10,B 20,C 170}"
OTHER = "LIN {X -30,Y 25,Z 310,A 10,B 20,C 170}"
VALUES_DAT = """DEFDAT part PUBLIC
DECL E6POS XP1={X 40,Y 60,Z 10,A 10,B 20,C 170}
DECL FRAME F1={X 4,Y 6,Z 1,A 10,B 0,C 0}
DECL BOOL FLIP=FALSE
DECL BOOL FINISH=FALSE
DECL INT N=7
DECL INT K=0
DECL INT I=0
DECL REAL R=2.6
ENDDAT
"""
FUNCTIONS = """DEFFCT BOOL ODD(V:IN)
INT V
RETURN (V/2*2<>V)
ENDFCT
DEFFCT INT HALF(V:IN)
INT V
INT W
W=V/2
RETURN (W)
ENDFCT
DEFFCT E6POS AT(V:IN)
INT V
E6POS Q
Q=XP1
Q.X=V*10
IF ODD(V) THEN
Q.Y=-15.5
ENDIF
RETURN Q
ENDFCT
DEFFCT REAL HEIGHT(V:IN)
REAL V
RETURN (V*1.5+N)
ENDFCT
"""
POINT = "LIN {X K*5,Y N,Z 300,A 10,B 20,C 170}"
KNOWN = {
    "a BOOL that is turned over": [
        "FOR I=1 TO 4",
        "FLIP=NOT FLIP",
        "IF FLIP THEN",
        FULL,
        "ELSE",
        OTHER,
        "ENDIF",
        "ENDFOR",
    ],
    "a BOOL by a comparison": ["FINISH=(N>1)", "IF FINISH THEN", OTHER, "ENDIF"],
    "a BOOL of two": ["FINISH=(N>9) OR NOT FLIP", "FLIP=FINISH AND (N<>7)", "IF FLIP EXOR FINISH THEN", OTHER, "ENDIF"],
    "a BOOL ends a loop": ["REPEAT", "K=K+1", POINT, "FINISH=(K>=3)", "UNTIL FINISH"],
    "a quotient with a remainder": ["K=N/2", POINT, "K=(N+2)/4*3", POINT],
    "odd and even": ["FOR I=1 TO 5", "IF I/2*2==I THEN", FULL, "ELSE", OTHER, "ENDIF", "ENDFOR"],
    "a REAL rounded to an INT": ["K=R", POINT, "K=-2.7", POINT, "N=R*3.2", POINT, "K=0.2", POINT],
    "bits": ["K=N B_AND 3", POINT, "K='HF0' B_OR 5", POINT, "K=N B_EXOR 2", POINT, "K=B_NOT N", POINT],
    "bits in a condition": ["IF (N B_AND 4)==4 THEN", OTHER, "ENDIF", "IF N B_AND 4==4 THEN", FULL, "ENDIF"],
    "frames in brackets": ["LIN (F1:F1):XP1", "F1=(F1:F1)", "LIN F1:XP1"],
    "a function in IF": ["FOR I=1 TO 3", "IF ODD(I) THEN", FULL, "ELSE", OTHER, "ENDIF", "ENDFOR"],
    "functions joined": [
        "IF ODD(N) AND (HALF(N)==3) THEN",
        OTHER,
        "ENDIF",
        "WHILE HALF(K)<2",
        "K=K+1",
        POINT,
        "ENDWHILE",
    ],
    "a function in bounds": ["FOR I=HALF(2) TO HALF(N) STEP HALF(2)", "K=I", POINT, "ENDFOR"],
    "a function gives a target": ["FOR I=1 TO 3", "LIN AT(I)", "ENDFOR", "LIN F1:AT(2)"],
    "a function in a component": ["LIN {X HEIGHT(2.5),Y HALF(N)+1,Z 300,A 10,B 20,C 170}"],
    "a function selects": ["SWITCH HALF(N)", "CASE 3", OTHER, "DEFAULT", FULL, "ENDSWITCH"],
    "a function of a function": ["K=HALF(HALF(N*2)+1)*2", POINT, "LIN AT(HALF(N))"],
    "a function gives a speed": ["$VEL.CP=HEIGHT(0.1)/100", OTHER],
    "the largest INT": ["K=2147483647", "N=K-2147483640", "K=1", POINT],
}


@pytest.mark.parametrize("lines", KNOWN.values(), ids=KNOWN)
def test_what_an_expression_gives_is_what_the_controller_makes_of_it(tmp_path, lines):
    files = {"part.src": body(FULL, *lines, OTHER, end="\n") + FUNCTIONS, "part.dat": VALUES_DAT}
    program = read_job(files, tmp_path)
    assert confirmed(program, files, tmp_path, np.random.default_rng(0)) == "accepted"


UNKNOWN = {
    "a negative quotient": (["K=-N/2", POINT], "quotient of negative INTs"),
    "the middle between two INTs": (["K=2.5", POINT], "to which side 2.5 is rounded"),
    "an INT of 33 bits": (["K=2147483647+1", POINT], "beyond 32 bits"),
    "a product of 33 bits": (["K=65536", "K=K*K", POINT], "beyond 32 bits"),
    "a literal of 33 bits": (["K=3000000000", POINT], "beyond 32 bits"),
    "a REAL beyond 32 bits": (["K=R*1.0E12", POINT], "beyond 32 bits"),
    "the counter of a loop": (["FOR K=2147483646 TO 2147483647", POINT, "ENDFOR"], "bounds are not known"),
    "bits of a REAL": (["K=R B_AND 1", POINT], "R B_AND 1"),
}


@pytest.mark.parametrize(("lines", "problem"), UNKNOWN.values(), ids=UNKNOWN)
def test_what_no_source_states_is_refused(lines, problem):
    with pytest.raises(ProgramError, match=problem):
        read(body(FULL, *lines), VALUES_DAT)


CHANGING = {
    "a variable of the program": "DEFFCT BOOL ASKED(V:IN)\nINT V\nN=N+1\nRETURN (V>1)\nENDFCT\n",
    "its argument": "DEFFCT BOOL ASKED(V:OUT)\nINT V\nV=V+1\nRETURN (V>1)\nENDFCT\n",
    "an output": "DEFFCT BOOL ASKED(V:IN)\nINT V\n$OUT[1]=TRUE\nRETURN (V>1)\nENDFCT\n",
    "what an input says": "DEFFCT BOOL ASKED(V:IN)\nINT V\nRETURN ($IN[1])\nENDFCT\n",
}


@pytest.mark.parametrize("function", CHANGING.values(), ids=CHANGING)
def test_a_function_that_changes_something_or_is_not_known_does_not_decide(function):
    with pytest.raises(ProgramError, match=r"condition|different places"):
        read(body(FULL, "IF ASKED(K) THEN", OTHER, "ENDIF", FULL + " C_DIS") + function, VALUES_DAT)


def test_an_aggregate_keeps_the_values_that_its_components_had():
    data = VALUES_DAT.replace("ENDDAT", "STRUC PT INT M,FRAME F\nDECL PT S\nENDDAT")
    program = read(body("K=4", "S={M 1,F {X K,Y 2,Z 3,A 0,B 0,C 0}}", "K=9", "LIN S.F"), data)
    assert program.layout.numbers[0, 0] == 4.0
