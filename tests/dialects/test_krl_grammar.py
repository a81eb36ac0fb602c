"""The independent grammar of KRL: it takes what shops and controllers write, and refuses what no controller takes."""

from pathlib import Path

import numpy as np
import pytest

from tests.attack.krl_generator import Generator
from tests.oracle.krl_grammar import Refused, check, parser, unknown_names
from tests.places import SAMPLES

SOURCE = """&ACCESS RVP
&REL 7
DEF part( )
DECL INT n, m[3]
DECL E6POS there
EXT BAS (BAS_COMMAND :IN,REAL :IN )
SIGNAL gripper $OUT[1] TO $OUT[4]
;FOLD INI;%{PE}
  BAS (#INITMOV,0 ) ; a comment with "quotes; and {braces
;ENDFOLD (INI)
GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
INTERRUPT ON 3
$BASE=BASE_DATA[3]:{X 1,Y -2.5E-3,Z 'HFF',A 0,B 0,C 0}
$VEL.CP=0.1
msg[]="a;b"
PTP {A1 0,A2 -90,A3 90,A4 0,A5 -3*n,A6 0} C_PTP C_DIS
LIN {E6POS: X 1,Y 2,Z 3,A 0,B 90,C 0,S 'B 010',T 'B100010',E1 0.0} C_DIS
lin xp1:{x 1} c_vel
LIN_REL {Z 10} C_DIS #BASE
LIN_REL {Z 10} #TOOL
CIRC {X 1,Y 2,Z 3},{X 4,Y 5,Z 6},CA -400.5 C_DIS C_DIS
SLIN p[n+1].fcnc WITH $VEL.CP=0.2,$ORI_TYPE=#CONSTANT C_SPL
SCIRC aux, INV_POS(there):xp1, CA 30 WITH $APO.CDIS=1 C_SPL
TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[2]=TRUE
TRIGGER WHEN PATH=-5 ONSTART DELAY=10 DO switched(1, n) PRIO=-1
SPLINE WITH $VEL.CP=0.2
  SPL XP1
  SLIN {X 3}
  TRIGGER WHEN PATH=0 DELAY=0 DO $OUT[3]=FALSE
  SCIRC XP2,XP3
ENDSPLINE C_SPL
FOR n=1 TO 10 STEP -2*m[1]
  IF NOT $IN[n] AND (n<>3) OR (n<=2) EXOR TRUE THEN
    again:
    WAIT FOR $IN[2]==TRUE
    GOTO again
  ELSE
    EXIT
  ENDIF
ENDFOR
SWITCH n B_AND 'B 101'
CASE 1,2
  REPEAT
    WAIT SEC 0.5
  UNTIL n>3
CASE #RED
  HALT
DEFAULT
  WHILE TRUE
    LOOP
      EXIT
    ENDLOOP
  ENDWHILE
ENDSWITCH
ANIN ON n=1.0*$ANIN[1]+0
ANOUT ON $ANOUT[1]=2.0*n+0 DELAY=0.5 MINIMUM=0 MAXIMUM=1
CONTINUE
PULSE($OUT[1],TRUE,0.5)
GOTO again2
again2:
RETURN
END

GLOBAL DEFFCT REAL FN(a:IN,b:OUT,list[])
DECL REAL a,b,list[]
RETURN (a+b)/2
ENDFCT
"""
DECLARATIONS_DAT = """DEFDAT part PUBLIC
DECL GLOBAL STRUC PT INT N,FRAME FCNC,CHAR NAME[8]
ENUM COLOUR RED,GREEN
DECL E6POS XP1={X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T 10,E1 0.0}
DECL FDAT FP1={TOOL_NO 2,BASE_NO 3,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}
DECL CONST INT K=-3
DECL PT P[2]
P[1]={N 1,FCNC {X 1,Y 2},NAME[] "a"}
IMPORT E6POS YY IS /R1/OTHER..XP1
EXTFCT REAL MEAN (REAL :IN,REAL[] :OUT)
ENDDAT
"""


def refusal(name, text):
    with pytest.raises(Refused) as caught:
        check(name, text)
    return str(caught.value)


def test_all_that_the_language_has_is_taken():
    for end in ("\n", "\r\n", "\r\r\n"):
        check("part.src", SOURCE.replace("\n", end))
        check("PART.dat", DECLARATIONS_DAT.replace("\n", end))
    check("part.src", SOURCE.lower())


def test_samples_and_random_programs_are_taken():
    for path in SAMPLES.glob("inline.*"):
        check(path.name, path.read_bytes().decode("cp1252"))
    for seed in range(60):
        for name, text in Generator(np.random.default_rng(seed)).programs().items():
            check(Path(name).name, text)


LINE = "LIN {E6POS: X 1,Y 2,Z 3,A 0,B 90,C 0,S 'B 010',T 'B100010',E1 0.0} C_DIS"
PLANTED = [
    # text, what takes its place, what is said
    (LINE, "LIN {X 1,Y 2,Z}", "no KRL"),
    (LINE, "LIN {X 1,,Y 2}", "no KRL"),
    (LINE, "LIN {X 1 Y 2}", "no KRL"),
    (LINE, "LIN {X 1,Y 2", "no KRL"),
    (LINE, "LIN {X 1,Y 2}}", "no KRL"),
    (LINE, "LIN {X 1.2.3}", "no KRL"),
    (LINE, "LIN {X 1,2}", "no KRL"),
    (LINE, "LIN {X --1}", "no KRL"),
    (LINE, "LIN {X 1} C_DIST", "no KRL"),
    (LINE, "LIN {X 1} C_DIS,", "no KRL"),
    (LINE, "LIN {X 1} {X 2}", "no KRL"),
    (LINE, "LIN", "no KRL"),
    (LINE, "LIN {X 1} LIN {X 2}", "no KRL"),
    (LINE, "LIN {X 1,X 2}", "stands twice"),
    (LINE, "LIN {X 1E999}", "not finite"),
    (LINE, "LIN {X 1,A1 2}", "no position"),
    (LINE, "LIN {X 1,Q 2}", "no position"),
    (LINE, "PTP {A1 1,A7 2}", "no position"),
    (LINE, "CIRC {A1 1,A2 2},{X 1}", "no position"),
    (LINE, "CIRC {X 1}", "no KRL"),
    (LINE, "LIN {X 1},CA 20", "no KRL"),
    (LINE, "LIN XP1 WITH", "no KRL"),
    (LINE, "LIN XP1:", "no KRL"),
    (LINE, "SLIN XP1 C_DIS WITH $VEL.CP=1", "no KRL"),
    (LINE, "$VEL.CP=", "no KRL"),
    (LINE, "$VEL.CP==1", "no KRL"),
    (LINE, "$VEL.CP 1", "no KRL"),
    (LINE, "N+1=2", "no KRL"),
    (LINE, "FOR=3", "no KRL"),
    (LINE, "LIN IF", "no KRL"),
    (LINE, "DECL INT LATE", "no KRL"),
    (LINE, "FN(1,2", "no KRL"),
    (LINE, "a_name_of_five_and_twentyx=1", "26 characters"),
    (LINE, "EXIT", "EXIT outside"),
    (LINE, "GOTO again", "GOTO into"),
    (LINE, "GOTO nowhere", "which is nowhere"),
    (LINE, "RETURN 5", "RETURN with a value"),
    (LINE, "SPL XP1", "no KRL"),
    (LINE, LINE + " " * 1000, "characters"),
    (LINE, "LIN XP1 \x01", "a control character"),
    (LINE, "&REL 3", "a header"),
    (LINE, ";FOLD again", "does not end"),
    (LINE, ";ENDFOLD", "without FOLD"),
    (LINE, "TRIGGER WHEN DISTANCE=0 DO $OUT[2]=TRUE", "no KRL"),
    (LINE, "TRIGGER WHEN TIME=0 DELAY=0 DO $OUT[2]=TRUE", "no KRL"),
    (LINE, "INTERRUPT DECL 3 WHEN $IN[1]", "no KRL"),
    (LINE, "LOOP", "no KRL"),
    (LINE, "WAIT 3", "no KRL"),
    ("  SLIN {X 3}", "  $OUT[1]=TRUE", "no KRL"),
    ("ENDSPLINE C_SPL", "ENDSPLINE C_SPL C_SPL", "no KRL"),
    ("    again:\n", "    again:\n    again:\n", "stands twice"),
    ("  ENDIF\n", "", "no KRL"),
    ("ENDFOR\n", "ENDWHILE\n", "no KRL"),
    ("END\n", "", "no KRL"),
    ("DEF part", "DEF other", "stands in the file"),
    ("DEF part", "DEF 1part", "no KRL"),
    ("DEFFCT REAL FN", "DEFFCT REAL part", "is defined twice"),
    ("RETURN (a+b)/2", "RETURN", "RETURN with a value"),
    ("UNTIL n>3", "UNTIL", "no KRL"),
    ("CASE 1,2", "CASE", "no KRL"),
]  # fmt: skip
PLANTED_DATA = [
    ("DEFDAT part", "DEFDAT other", "stands in the file"),
    ("ENDDAT", "", "no KRL"),
    ("P[1]={", "LIN {", "no KRL"),
    ("XP1={X 1,", "XP1={X 1,X 1,", "stands twice"),
    ("DECL CONST INT K=-3", "DECL CONST INT K=", "no KRL"),
    ("DECL PT P[2]", "DECL P[2]", "no KRL"),
]


@pytest.mark.parametrize(("text", "planted", "said"), PLANTED)
def test_a_planted_error_in_a_program_is_refused_in_its_line(text, planted, said):
    assert SOURCE.count(text) >= 1
    wrong = SOURCE.replace(text, planted, 1)
    message = refusal("part.src", wrong)
    assert said in message
    if text == LINE and said not in ("does not end",) and planted not in ("LOOP",):
        assert message.startswith(f"part.src:{SOURCE[: SOURCE.index(LINE)].count(chr(10)) + 1}:")


@pytest.mark.parametrize(("text", "planted", "said"), PLANTED_DATA)
def test_a_planted_error_in_a_data_list_is_refused(text, planted, said):
    assert said in refusal("part.dat", DECLARATIONS_DAT.replace(text, planted, 1))


def test_not_binds_first_and_comparisons_last_and_the_geometric_operator_before_arithmetic():
    def shape(text):
        tree = parser().parse(f"DEF P()\nX={text}\nEND\n", start="source")
        (assignment,) = tree.find_data("assignment")
        return assignment.children[1].data

    assert shape("A==B AND C") == "expression"
    assert shape("A OR B AND C") == "disjunction"
    assert shape("A EXOR B AND C") == "exclusion"
    assert shape("A AND B+C") == "conjunction"
    assert shape("A+B*C") == "sum"
    assert shape("A*B:C") == "product"
    assert shape("-A:B") == "signed"
    assert shape("NOT A==B") == "expression"
    assert shape("A:B:C") == "geometric"


def test_names_that_nothing_declares_are_found():
    files = {"part.src": "DEF part()\nLIN XP1\nLIN XP2\nSUB(Z)\nEND\n", "part.dat": "DEFDAT part\nINT Z=1\nENDDAT\n"}
    assert unknown_names(files) == {"XP1", "XP2", "SUB"}
