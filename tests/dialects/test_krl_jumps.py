"""GOTO out of loops and back to a label, whole arrays as parameters, members of members: as a controller executes them.

What is read and what is written is compared with an executor that shares no code with the package.
"""

import numpy as np
import pytest

from postproc.errors import ProgramError
from tests.attack import krl as attack

STRUCTURES_DAT = "\n".join(
    [
        "DEFDAT part",
        "STRUC INNER FRAME F,INT N",
        "STRUC INT_OR_REAL INT X,REAL R,INNER I",
        "DECL INT_OR_REAL S={X 1,R 2.5,I {F {X 1,Y 2,Z 3,A 0,B 0,C 180},N 2}}",
        "DECL INT_OR_REAL T[2]",
        "T[1]={X 1,R 2.5,I {F {X 5,Y 2,Z 3,A 0,B 0,C 180},N 2}}",
        "DECL E6POS P[3]",
        *(f"P[{n}]={{X {10 * n},Y 2,Z 3,A 0,B 0,C 180}}" for n in (1, 2, 3)),
        "DECL INT N[2]",
        "N[1]=1",
        "N[2]=3",
        "DECL INT I=1",
        "DECL INT J=1",
        "ENDDAT",
        "",
    ]
)
START = "LIN {X 0,Y 0,Z 0,A 0,B 0,C 180}"


def to(x):
    return f"LIN {{X {x},Y 1,Z 5,A 0,B 0,C 180}}"


def array(head, *body):
    return ["CUT(P[])", "LIN P[2]", "END", head, "DECL E6POS Q[]", *body]


def read_lines(lines, folder, *, keep=False):
    text = "\n".join(["DEF part( )", "BAS(#INITMOV,0)", START, *lines, "END", ""])
    files = {"part.src": text, "part.dat": STRUCTURES_DAT}
    return attack.read_job(files, folder, keep=keep), files


BACK = ["AGAIN:", to("I*5"), "I=I+1", "IF I<4 THEN", "GOTO AGAIN", "ENDIF", to(8)]
PROGRAMS = {
    "FOR left": ["FOR I=1 TO 3", "LIN P[I]", "IF I==2 THEN", "GOTO OUT", "ENDIF", to(9), "ENDFOR", to(8), "OUT:",
                 to("I")],
    "FOR not left": ["FOR I=1 TO 2", "LIN P[I]", "IF I==5 THEN", "GOTO OUT", "ENDIF", "ENDFOR", to(8), "OUT:", to("I")],
    "two FORs left": ["FOR I=1 TO 2", "FOR J=1 TO 3", "IF J==2 THEN", "GOTO OUT", "ENDIF", to(3), "ENDFOR", "ENDFOR",
                      to(4), "OUT:", to("I+J*10")],
    "the inner FOR left": ["FOR I=1 TO 2", to("I"), "IF I>0 THEN", "FOR J=1 TO 3", "LIN P[J]", "IF J==I THEN", "EXIT",
                           "ENDIF", "ENDFOR", "ENDIF", "ENDFOR"],
    "WHILE left": ["WHILE I<9", "LIN P[I]", "IF I==3 THEN", "GOTO OUT", "ENDIF", "I=I+1", "ENDWHILE", to(4), "OUT:",
                   to(5)],
    "back": BACK,
    "back at once": ["I=5", *BACK],
    "back, and out": ["AGAIN:", to(5), "I=I+1", "IF I==3 THEN", "GOTO OUT", "ENDIF", "IF I<9 THEN", "GOTO AGAIN",
                      "ENDIF",
                      to(8), "OUT:", to(7)],
    "back, or RETURN": ["AGAIN:", to(5), "IF I==1 THEN", "RETURN", "ENDIF", "IF I<4 THEN", "GOTO AGAIN", "ENDIF",
                        to(7)],
    "loops within": ["AGAIN:", "FOR J=1 TO 2", to("I+J"), "ENDFOR", "I=I+1", "IF I<3 THEN", "GOTO AGAIN", "ENDIF"],
    "an array": array("DEF CUT(Q[]:OUT)", "LIN Q[2]", "Q[2].X=50", "LIN Q[2]"),
    "an array in a loop": array("DEF CUT(Q[])", "FOR J=1 TO 3", "LIN Q[J]", "ENDFOR", "Q[1]=Q[3]", "LIN Q[1]"),
    "an array of an array": array("DEF CUT(Q[])", "DECL E6POS L[2]", "L[1]=Q[1]", "DEEP(L[])", "LIN L[2]", "DEEP(Q[])",
                                  "END", "DEF DEEP(R[])", "DECL E6POS R[]", "R[2]=R[1]", "R[2].Y=9"),
    "indices": ["CUT(N[])", "LIN P[N[2]]", "END", "DEF CUT(M[])", "DECL INT M[]", "M[2]=M[1]+1", "LIN P[M[2]]"],
    "members of members": ["S.I.F.X=77", "LIN S.I.F", "S.I.N=2.6", to("S.I.N"), to("S.I.F.X")],
    "a member X": ["S.X=2.6", to("S.X"), "S.R=2.6", to("S.R")],
    "members of elements": ["T[1].I.F.Y=9", "LIN T[1].I.F", to("T[1].I.F.Y"), "S.I=T[1].I", "LIN S.I.F", to("S.I.N")],
    "copies of structures": ["S=T[1]", "LIN S.I.F", "P[1]=T[1].I.F", "LIN T[1].I.F", to("T[1].I.F.X")],
}  # fmt: skip


@pytest.mark.parametrize("name", PROGRAMS)
def test_is_read_and_written_as_a_controller_executes_it(name, tmp_path):
    program, files = read_lines(PROGRAMS[name], tmp_path)
    rng = np.random.default_rng(1)
    assert attack.confirmed(program, files, tmp_path, rng, checked=False) == "accepted"


REFUSED = {
    "a label is in a loop around motions": [
        "FOR I=1 TO 2",
        "IF I==2 THEN",
        "GOTO SKIP",
        "ENDIF",
        to(3),
        "SKIP:",
        "ENDFOR",
    ],
    "GOTO always leads back": ["AGAIN:", to(5), "IF I<4 THEN", "GOTO AGAIN", "ENDIF"],
    r"whether GOTO is run, .* of IF \(line 6\) is not known": [
        "AGAIN:",
        to(5),
        "IF $IN[1] THEN",
        "GOTO AGAIN",
        "ENDIF",
    ],
    "the label AGAIN precedes GOTO, or": ["GOTO AGAIN", to(77), *BACK],
    "the label AGAIN precedes GOTO": [*BACK, "IF I<9 THEN", "GOTO AGAIN", "ENDIF"],
    "a force comment is on the line of IF": [
        "AGAIN:",
        to(5),
        "I=I+1",
        "IF I<4 THEN ; FORCE FX=5",
        "GOTO AGAIN",
        "ENDIF",
    ],
    "has two names in it, one as its parameter": array("DEF CUT(Q[])", "P[1].X=3", "LIN Q[2]"),
    "its parameter is not one of that type": ["CUT(P[])", "END", "DEF CUT(Q)", "DECL E6POS Q", "LIN Q"],
    r"Q\[2\] is changed while the program runs": [
        "INTERRUPT DECL 4 WHEN $IN[1] DO P[2]=P[1]",
        "INTERRUPT ON 4",
        *array("DEF CUT(Q[])", "LIN Q[2]"),
    ],
    "S.I.F has no value": ["S.I.F={X 4}", "LIN S.I.F"],
    "S.R has no value": ["S={X 4}", to("S.R")],
}


@pytest.mark.parametrize("problem", REFUSED)
def test_what_is_not_known_is_refused(problem, tmp_path):
    with pytest.raises(ProgramError, match=problem):
        read_lines(REFUSED[problem], tmp_path)


def test_a_loop_by_goto_that_is_not_followed_is_not_taken_for_one_round(tmp_path):
    """Its label is inside: the values of its rounds, which were followed in vain, were those behind its first round."""
    lines = [
        "AGAIN:",
        "I=I+1",
        "LIN P[I]",
        "IF I==5 THEN",
        "GOTO INNER",
        "ENDIF",
        "INNER:",
        "IF I<3 THEN",
        "GOTO AGAIN",
        "ENDIF",
    ]
    with pytest.raises(ProgramError, match="precedes GOTO"):
        read_lines(lines, tmp_path, keep=True)
