"""Data of RAPID that change where the execution order is not plain: known only where they are certain."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.errors import PostprocError
from tests.dialects.rapid_reading import MOVE_HOME, at, module, read, tail

DEEP = f"MoveL Offs(p,0,0,-nDeep){tail()}"
DECLARATIONS = (
    f"  CONST robtarget p:={at(0, 0, 20)};\n  VAR num nDeep:=0;\n  VAR bool bLate:=FALSE;\n  VAR num a{{2}}:=[0,0];"
)
MOVE = f"MoveL {at(0, 0, 20)}{tail()}"

UNKNOWN = {
    "RETURN that an input decides, in a routine without moves": (
        ["calc;", DEEP],
        "PROC calc()\nIF di1=1 THEN\nRETURN;\nENDIF\nnDeep:=10;\nENDPROC",
        "NDEEP is not known",
    ),
    "GOTO in a routine without moves": (
        ["calc;", DEEP],
        "PROC calc()\nGOTO over;\nnDeep:=10;\nover:\nENDPROC",
        "NDEEP is not known",
    ),
    "an option that an instruction writes": (
        ["WaitDI di1,1\\MaxTime:=5\\TimeFlag:=bLate;", "IF bLate THEN", MOVE, "ENDIF"],
        "",
        "BLATE is not known",
    ),
    "an option that an instruction writes, in a branch": (
        ["IF di1=1 THEN", "WaitDI di1,1\\MaxTime:=5\\TimeFlag:=bLate;", "ENDIF", "IF bLate THEN", MOVE, "ENDIF"],
        "",
        "BLATE is not known",
    ),
    "data that a handler writes": (
        ["work;", DEEP],
        "PROC work()\nnDeep:=5;\nWaitDI di1,1;\nERROR\nnDeep:=10;\nTRYNEXT;\nENDPROC",
        "the handler of WORK may change it",
    ),
    "data of a routine that its handler writes": (
        ["work;"],
        f"PROC work()\nVAR num n:=0;\nn:=5;\nMoveL Offs(p,0,0,-n){tail()}\nERROR\nn:=10;\nTRYNEXT;\nENDPROC",
        "the handler of WORK may change it",
    ),
    "an element that a routine changes by its parameter": (
        ["work a{1};"],
        f"PROC work(INOUT num n)\nn:=10;\nMoveL Offs(p,0,0,-a{{1}}){tail()}\nENDPROC",
        "WORK may change it",
    ),
    "a parameter whose element the routine changes": (
        ["work a{1};"],
        f"PROC work(INOUT num n)\na{{1}}:=10;\nMoveL Offs(p,0,0,-n){tail()}\nENDPROC",
        "WORK may change it",
    ),
    "a function that moves": (
        ["nDeep:=probe();", MOVE],
        f"FUNC num probe()\n{MOVE_HOME}\nRETURN 1;\nENDFUNC",
        "the function PROBE moves the robot",
    ),
    "a function that moves, in a branch": (
        ["IF di1=1 THEN", "nDeep:=probe();", "ENDIF", MOVE],
        f"FUNC num probe()\n{MOVE_HOME}\nRETURN 1;\nENDFUNC",
        "whether PROBE is executed",
    ),
    "a function with a name of RAPID": ([DEEP], "FUNC num Abs(num n)\nRETURN 2*n;\nENDFUNC", "has the name"),
    "a routine that is called by a name put together": (
        ['CallByVar "work",1;', MOVE],
        f"PROC work1()\n{MOVE_HOME}\nENDPROC",
        "known at run time only",
    ),
    "rounds that depend on rounding": (
        [f"FOR i FROM 0 TO 0.3 STEP 0.1 DO\nMoveL Offs(p,0,0,i){tail()}\nENDFOR"],
        "",
        "rounding of the controller",
    ),
    "a comparison that depends on rounding": (
        ["nDeep:=0.1+0.2;", "IF nDeep=0.3 THEN", MOVE, "ENDIF"],
        "",
        "rounding of the controller",
    ),
    "RETURN in a loop of which the rounds are not known": (
        ["work;"],
        f"PROC work()\nWHILE di1=0 DO\nIF nDeep>3 THEN\nRETURN;\nENDIF\nENDWHILE\n{MOVE}\nENDPROC",
        "whether RETURN is executed",
    ),
    "a force in a branch": (
        ["IF di1=1 THEN", "! FORCE FX=100", "ENDIF", MOVE],
        "",
        "whether this force acts",
    ),
}


@pytest.mark.parametrize(("code", "routines", "words"), UNKNOWN.values(), ids=UNKNOWN)
def test_what_only_the_running_robot_knows_is_refused(code, routines, words):
    with pytest.raises(PostprocError) as caught:
        read(module(code, DECLARATIONS, routines))
    assert words in str(caught.value)
    assert caught.value.advice


KNOWN = {
    "a function that nothing calls": (
        ["nDeep:=3;", DEEP],
        "FUNC num next()\nnDeep:=nDeep+1;\nRETURN nDeep;\nENDFUNC",
        [17.0],
    ),
    "a loop without moves": (["FOR i FROM 1 TO 3 DO", "nDeep:=nDeep+i;", "ENDFOR", DEEP], "", [14.0]),
    "a loop without moves that ends its routine": (
        ["work;", MOVE],
        f"PROC work()\nWHILE nDeep<9 DO\nIncr nDeep;\nIF nDeep=4 THEN\nRETURN;\nENDIF\nENDWHILE\n{DEEP}\nENDPROC",
        [20.0],
    ),
    "a branch that is known not to run, before one that is not known": (
        ["IF nDeep=1 THEN", MOVE_HOME, "ELSEIF di1=1 THEN", "SetDO do1,1;", "ENDIF", DEEP],
        "",
        [20.0],
    ),
    "an element that a routine only reads": (
        ["work a{1};"],
        f"PROC work(INOUT num n)\nMoveL Offs(p,0,0,n-a{{2}}){tail()}\nENDPROC",
        [20.0],
    ),
}


@pytest.mark.parametrize(("code", "routines", "heights"), KNOWN.values(), ids=KNOWN)
def test_what_is_certain_is_read(code, routines, heights):
    motions = read(module(code, DECLARATIONS, routines)).motions
    np.testing.assert_allclose(motions.target[1:][:, 2, 3] * 1e3, heights, atol=1e-6)


def test_a_function_of_another_file_is_listed():
    program = read(module(["nDeep:=Foreign(3);", MOVE], DECLARATIONS).replace("PERS", "CONST"))
    (message,) = [issue.message for issue in program.issues if issue.kind == "external-call"]
    assert message.startswith("FOREIGN is")


def test_an_array_without_initial_value_has_the_elements_that_the_program_gives_it():
    data = DECLARATIONS + "\n  VAR robtarget tgt{2};\n  VAR num n{2,2};"
    fill = ["FOR i FROM 1 TO 2 DO", "tgt{i}:=Offs(p,i,0,0);", "n{2,i}:=n{1,i}+10*i;", "ENDFOR"]
    moves = [f"MoveL Offs(tgt{{2}},0,n{{2,1}},n{{1,1}}){tail()}"]
    np.testing.assert_allclose(read(module([*fill, *moves], data)).motions.target[-1, :3, 3], [0.002, 0.01, 0.02])
    assert [issue.kind for issue in read(module([*fill, *moves], data)).issues if issue.kind == "changed-data"] == []
    with pytest.raises(PostprocError, match="an element of TGT has no value yet"):
        read(module(["tgt{1}:=p;", *moves], data))
