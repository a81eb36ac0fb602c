"""Values that code outside the straight text changes: followed exactly, refused, or told; never silently wrong."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.cell import Frame, Krl, Tool
from postproc.dialects import krl
from postproc.dialects.krl.language.declarations import declared_names
from postproc.dialects.krl.read import folder, next_run
from postproc.dialects.krl.read import read_program as read_documents
from postproc.dialects.text import decode
from postproc.errors import ProgramError
from tests.dialects.krl_programs import CELL, body, check_commands, forward, numbers, read, targets

FULL = "LIN {X 100,Y 20,Z 30,A 10,B 20,C 170}"
POINTS_DAT = (
    "DEFDAT part PUBLIC\r\n"
    "DECL E6POS XP1={X 100.25,Y 200.5,Z 300,A 10,B 20,C 170,S 2,T 10}\r\n"
    "DECL E6POS XP3={X 1,Y 2,Z 3,A 10,B 20,C 170}\r\n"
    "DECL GLOBAL E6POS XG={X 7,Y 2,Z 3,A 10,B 20,C 170}\r\n"
    "DECL INT I=1\r\nDECL REAL SPD=0.5\r\nDECL BOOL OK\r\n"
    "DECL E6POS P[3]\r\n"
    "P[1]={X 1,Y 2,Z 3,A 4,B 5,C 6}\r\nP[2]={X 11,Y 2,Z 3,A 4,B 5,C 6}\r\nP[3]={X 21,Y 2,Z 3,A 4,B 5,C 6}\r\n"
    "DECL FRAME FR={X 5,Y 0,Z 0,A 0,B 0,C 0}\r\nENDDAT\r\n"
)
UNTOUCHED = [100.25, 200.5, 300]


def read_lines(*lines, subs="", data=POINTS_DAT, cell=CELL):
    return read(body(*lines) + subs.replace("\n", "\r\n"), data, cell)


def x_y_z(found, row=-1):
    return numbers(found)[row, :3].round(6).tolist()


def about(found, kind):
    return [(issue.subject, issue.source_line) for issue in found.issues if issue.kind == kind]


# --- what is known exactly -----------------------------------------------------------------------------------------

SHIFT = "DEF SHIFT( )\nXP1.Z=XP1.Z+20\nEND\n"


@pytest.mark.parametrize(
    ("lines", "subs", "expected"),
    [
        (["LIN XP1", "SHIFT( )", "LIN XP1"], SHIFT, [100.25, 200.5, 320]),
        (["lin xp1", "shift ( )", "lin xp1"], SHIFT.lower(), [100.25, 200.5, 320]),
        (["SHIFT()", "SHIFT()", "LIN XP1"], "GLOBAL " + SHIFT, [100.25, 200.5, 340]),
        (["OUTER()", "LIN XP1"], "DEF OUTER()\nSHIFT()\nEND\n" + SHIFT, [100.25, 200.5, 320]),
        (["UP(XP1,5)", "LIN XP1"], "DEF UP(P:OUT,H:IN)\nDECL E6POS P\nREAL H\nP.Z=P.Z+H\nEND\n", [100.25, 200.5, 305]),
        (["UP(XP1)", "LIN XP1"], "DEF UP(P)\nDECL E6POS P\nP={X 1,Y 2,Z 3,A 0,B 0,C 0}\nEND\n", [1, 2, 3]),
        (["UP(XP1)", "LIN XP1"], "DEF UP(P:IN)\nDECL E6POS P\nP.Z=5\nEND\n", UNTOUCHED),
        (["OK=FN(XP1)", "LIN XP1"], "DEFFCT BOOL FN(P:OUT)\nE6POS P\nP.X=1\nRETURN(TRUE)\nENDFCT\n", [1, 200.5, 300]),
        (["I=NEXT(I)", "LIN P[I]"], "DEFFCT INT NEXT(N:IN)\nINT N\nRETURN(N+1)\nENDFCT\n", [11, 2, 3]),
        (["BUMP()", "LIN P[I]"], "DEF BUMP()\nI=I+1\nEND\n", [11, 2, 3]),
        (["BUMP()", "LIN P[I]"], "DEF BUMP()\nDECL INT I\nI=3\nEND\n", [1, 2, 3]),
        (["LIN P[I+2]"], "", [21, 2, 3]),
        (["XP3=XP1", "XP1.X=9", "LIN XP3"], "", UNTOUCHED),
        (["XP3=XP1", "XP3.X=9", "LIN XP1"], "", UNTOUCHED),
        (["XP3={X I*2+1,Y SPD*4,Z -(1+2),A 0,B 0,C 0}", "I=50", "LIN XP3"], "", [3, 2, -3]),
        (["LIN {X 100+50,Y 2*3,Z -(4),A 0,B 0,C 0}"], "", [150, 6, -4]),
        (["BACK()", "LIN XP1"], "DEF BACK()\nXP1.X=1\nRETURN\nXP1.X=2\nEND\n", [1, 200.5, 300]),
        (["stack.block[2]=3", "stack.a.b=4", "LIN XP1"], "", UNTOUCHED),
    ],
)
def test_what_called_code_and_assignments_change_is_followed(lines, subs, expected):
    assert x_y_z(read_lines(*lines, subs=subs)) == expected


NUMBERS = POINTS_DAT.replace(
    "ENDDAT",
    "DECL INT N=1\r\nDECL INT K[2]\r\nSTRUC PT INT N,REAL V,W\r\nDECL PT S={N 1,V 1,W 1}\r\nDECL E6POS Q[2,2]\r\n"
    "Q[1,1]={X 1,Y 2,Z 3,A 0,B 0,C 0}\r\nQ[1,2]={X 2,Y 2,Z 3,A 0,B 0,C 0}\r\nENDDAT",
)
RAISE = "DEF RAISE(PX)\nDECL E6POS PX\nPX.Z=PX.Z+100\nN=2\nEND\n"


@pytest.mark.parametrize(
    ("lines", "subs"),
    [
        (["RAISE(P[N])", "LIN P[1]", "LIN P[2]"], RAISE),
        (["RAISE(Q[1,N])", "LIN Q[1,1]", "LIN Q[1,2]"], RAISE),
        (["RAISE(P[N])", "LIN P[1]", "LIN P[2]"], RAISE.replace("N=2", f"N=2\n{FULL}")),
        (["BOTH(N,P[N])", "LIN P[1]", "LIN P[2]"], RAISE.replace("RAISE(PX)", "BOTH(M,PX)").replace("N=2", "M=2")),
    ],
)
def test_an_argument_is_the_element_that_its_index_named_when_the_call_began(lines, subs):
    found = read_lines(*lines, subs=subs, data=NUMBERS)
    assert x_y_z(found, -2)[2] == 103
    assert x_y_z(found, -1)[2] == 3


def test_an_element_whose_index_is_changed_by_the_call_that_gives_its_value_is_not_known():
    function = "DEFFCT E6POS NEWP()\nN=2\nRETURN({X 77,Y 0,Z 0,A 0,B 0,C 0})\nENDFCT\n"
    with pytest.raises(ProgramError, match=r"which element P\[N\] is.*line 8") as caught:
        read_lines("P[N]=NEWP()", "LIN P[2]", subs=function, data=NUMBERS)
    assert "(line 4:" in caught.value.problem
    assert x_y_z(read_lines("P[N]=NEWP()", "LIN XP1", subs=function, data=NUMBERS)) == UNTOUCHED


SPOT = "LIN {X SPD*10,Y 2,Z 3,A 0,B 0,C 0}"
SETR = "DEF SETR(V:OUT,H:IN)\nREAL V,H\nV=H\nXP1.X=V*10\nEND\n"


@pytest.mark.parametrize(
    ("lines", "subs"),
    [
        (["COUNT(?)", "LIN XP1"], "DEF COUNT(N:IN)\nINT N\nXP1.X=N*10\nEND\n"),
        (["SPD=COUNT(?)", SPOT], "DEFFCT INT COUNT(V:IN)\nREAL V\nRETURN(V)\nENDFCT\n"),
        (["S.N=?", SPOT.replace("SPD", "S.N")], ""),
        (["S={N ?,V 1,W 1}", SPOT.replace("SPD", "S.N")], ""),
        (["K[2]=?", SPOT.replace("SPD", "K[2]")], ""),
        (["SPD=?", "COUNT(SPD)", SPOT], "DEF COUNT(N:OUT)\nINT N\nEND\n"),
        (["FOR I=? TO 2", SPOT.replace("SPD", "I"), "ENDFOR"], ""),
        (["SETR(I,?)", "LIN XP1"], SETR),  # whether V is 2.5 then, or what I makes of it, is documented nowhere
        (["SETR(K[2],?)", "LIN XP1"], SETR),
        (["SETR(S.N,?)", "LIN XP1"], SETR),
        (["PASS(I,?)", "LIN XP1"], SETR + "DEF PASS(V:OUT,H:IN)\nREAL V,H\nSETR(V,H)\nEND\n"),
    ],
)
def test_whatever_enters_an_int_must_be_a_whole_number(lines, subs):
    fitting = "2" if lines[0].startswith("FOR") else "2.0"
    assert x_y_z(read_lines(*(line.replace("?", fitting) for line in lines), subs=subs, data=NUMBERS))[0] == 20
    with pytest.raises(ProgramError):
        read_lines(*(line.replace("?", "2.5") for line in lines), subs=subs, data=NUMBERS)


def test_members_and_results_that_are_real_keep_their_fraction():
    assert x_y_z(read_lines("S.W=2.5", SPOT.replace("SPD", "S.W"), data=NUMBERS))[0] == 25
    half = "DEFFCT REAL HALF(N:IN)\nINT N\nRETURN(N)\nENDFCT\n"
    assert x_y_z(read_lines("SPD=HALF(5)", "SPD=SPD/2", SPOT, subs=half, data=NUMBERS))[0] == 25


@pytest.mark.parametrize(
    ("lines", "subs", "base_x", "tool_z", "feed"),
    [
        (["SETB()", "$BASE=FR"], "DEF SETB()\nFR.X=9\nEND\n", 9, 350, 2),
        (["SETB()", "$BASE=BASE_DATA[3]"], "DEF SETB()\nBASE_DATA[3]={X 7,Y 0,Z 0,A 0,B 0,C 0}\nEND\n", 7, 350, 2),
        (["SETB()", "BAS(#TOOL,2)"], "DEF SETB()\nTOOL_DATA[2].Z=99\nEND\n", 1500, 99, 2),
        (
            ["SETB()"],
            "DEF SETB()\n$BASE=BASE_DATA[3]\n$TOOL={X 0,Y 0,Z 5,A 0,B 0,C 0}\n$VEL.CP=0.25\nEND\n",
            1200,
            5,
            0.25,
        ),
        (["SETB(3,0.1)"], "DEF SETB(N:IN,V:IN)\nINT N\nREAL V\nBAS(#BASE,N)\nBAS(#VEL_CP,V)\nEND\n", 1200, 350, 0.1),
        (["SPD=1.5", "$VEL.CP=SPD"], "", 1500, 350, 1.5),
        (["FAST()", "$VEL.CP=SPD"], "DEF FAST()\nSPD=SPD*3\nEND\n", 1500, 350, 1.5),
    ],
)
def test_frames_and_speeds_set_by_called_code_are_in_force(lines, subs, base_x, tool_z, feed):
    found = read_lines(*lines, FULL, subs=subs)
    m = found.motions
    assert found.bases[m.base[0], 0, 3] * 1000 == pytest.approx(base_x)
    assert found.tools[m.tool[0], 2, 3] * 1000 == pytest.approx(tool_z)
    assert m.feed[0] == pytest.approx(feed)


# --- what is not known is refused ----------------------------------------------------------------------------------

FUNCTION = "DEFFCT BOOL FN(P:OUT)\nE6POS P\nP.Z=77\nRETURN(TRUE)\nENDFCT\n"
LATER = "DEF M()\nIF $IN[2] THEN\nGLOBAL INTERRUPT DECL 5 WHEN $IN[1] DO K()\nENDIF\nEND\nDEF K()\nXP1.X=5\nEND\n"
REFUSED = [
    (["IF FN(XP1) THEN", "ENDIF", "LIN XP1"], FUNCTION, 6, "XP1 is changed"),
    (["OK=NOT FN(XP1)", "LIN XP1"], FUNCTION, 5, "XP1 is changed"),
    (["WHILE FN(XP1)", "ENDWHILE", "LIN XP1"], FUNCTION, 6, "XP1 is changed"),
    (["I=2*FN(XP1)", "LIN XP1"], FUNCTION, 5, "XP1 is changed"),
    (["I=P[FN(XP1)].X", "LIN XP1"], FUNCTION, 5, "XP1 is changed"),
    (["IF OK THEN", "SHIFT()", "ENDIF", "LIN XP1"], SHIFT, 7, "XP1 is changed"),
    (["FOR I=1 TO $ANIN[1]", "SHIFT()", "ENDFOR", "LIN XP1"], SHIFT, 7, "XP1 is changed"),
    (["M()", "LIN XP1"], "DEF M()\nIF $IN[1] THEN\nXP1.Z=5\nENDIF\nEND\n", 5, "XP1 is changed"),
    (["M()", "LIN XP1"], "DEF M()\nIF $IN[1] THEN\nRETURN\nENDIF\nXP1.Z=5\nEND\n", 5, "XP1 is changed"),
    (["M(1)", "LIN XP1"], "DEF M(N:IN)\nINT N\nXP1.Z=XP1.Z+1\nM(N-1)\nEND\n", 5, "XP1 is changed"),
    (["M(XP1)", "LIN XP1"], "DEF M(A:OUT)\nE6POS A\nA.Z=5\nXP1.Z=6\nEND\n", 5, "XP1 is changed"),
    (["NOWHERE(XP1)", "LIN XP1"], "", 5, "XP1 is changed"),
    (["OK=NOWHERE(1,XP1)", "LIN XP1"], "", 5, "XP1 is changed"),
    (["INTERRUPT DECL 5 WHEN $IN[1] DO XP1.X=5", "LIN XP1"], "", 5, "XP1 is changed .*INTERRUPT in line 4"),
    (["GLOBAL INTERRUPT DECL 5 WHEN $IN[1] DO SHIFT()", FULL, "LIN XP1"], SHIFT, 6, "XP1 is changed"),
    (["interrupt decl 5 when $in[1] do shift()", "XP1={X 5}", "lin xp1"], SHIFT, 6, "xp1 is changed"),
    (["TRIGGER WHEN DISTANCE=0 DELAY=0 DO XP1.X=200", FULL, "LIN XP1"], "", 6, "XP1 is changed .*TRIGGER"),
    (["TRIGGER WHEN PATH=-5 DELAY=0 DO SHIFT() PRIO=-1", FULL, "LIN XP1"], SHIFT, 6, "XP1 is changed"),
    (["DIGIN ON I=1.0*$DIGIN1+0", "LIN P[I]"], "", 5, "I is changed"),
    (["ANIN ON SPD=0.1*$ANIN[1]+0", "$VEL.CP=SPD", FULL], "", 5, "SPD is changed"),
    (["SIGNAL I $IN[1] TO $IN[4]", "LIN P[I]"], "", 5, "I is changed"),
    (["IF OK THEN", "$VEL.CP=0.1", "ENDIF", FULL], "", 5, "changed inside IF"),
    (["IF OK THEN", "SETV()", "ENDIF", FULL], "DEF SETV()\n$VEL.CP=0.1\nEND\n", 5, r"may change \$VEL"),
    (["INTERRUPT DECL 5 WHEN $IN[1] DO SETV()", FULL], "DEF SETV()\n$VEL.CP=0.1\nEND\n", 4, r"\$VEL"),
    (["SETV($VEL.CP)", FULL], "DEF SETV(V:OUT)\nREAL V\nV=0.1\nEND\n", 4, r"\$VEL"),
    (["I=-I/2", "LIN P[I]"], "", 5, "I is set to .*the quotient of negative INTs"),
    (["XP1={X 5}", "LIN XP1"], "", 5, "not all of its components"),
    (["IF OK THEN", "M()", "ENDIF", "XP1=XP3", "LIN XP1"], LATER, 8, "XP1 is changed .*by M"),
    (["M()", FULL, "XP1=XP3", "LIN XP1"], LATER, 7, "XP1 is changed .*by "),
    (["M()", FULL], LATER.replace("XP1.X", "$VEL.CP"), 4, r"\$VEL"),
    (["XP1.X=XP1.X+$POS_ACT.X", "LIN XP1"], "", 5, r"XP1 is set to .*POS_ACT\.X is computed"),
]


@pytest.mark.parametrize(("lines", "subs", "line", "problem"), REFUSED, ids=[" / ".join(r[0])[:60] for r in REFUSED])
def test_what_may_be_otherwise_when_it_is_used_is_refused(lines, subs, line, problem):
    with pytest.raises(ProgramError, match=problem) as caught:
        read_lines(*lines, subs=subs)
    assert caught.value.line == line


def test_what_a_branch_changes_may_be_set_again():
    found = read_lines(
        "IF OK THEN", "$VEL.CP=0.1", "XP1.X=5", "ENDIF", "$VEL.CP=0.2", "XP1={X 3,Y 2,Z 1,A 0,B 0,C 0}", "LIN XP1"
    )
    assert (x_y_z(found), found.motions.feed[0]) == ([3, 2, 1], 0.2)


def test_a_branch_that_changes_nothing_is_no_doubt():
    assert len(read_lines("$VEL.CP=0.1", "IF OK THEN", "$VEL.CP=0.1", "$VEL.ORI1=200", "ENDIF", FULL).motions) == 1


# --- the written program -------------------------------------------------------------------------------------------


def written(*lines, subs="", data=POINTS_DAT):
    found = read_lines(*lines, subs=subs, data=data)
    shift = np.zeros((len(found.motions), 3))
    shift[:, 2] = 1e-3
    wanted = targets(found, shift)
    out = krl.rewrite(found, wanted)
    check_commands(found, wanted, out)
    return [document.text.splitlines() for document in out.documents]


@pytest.mark.parametrize(
    ("lines", "subs"),
    [
        (["LIN XP1", "SHIFT( )", "LIN XP1"], SHIFT),
        (["LIN XP1", "LOOK( )"], "DEF LOOK( )\nIF XP1.Z>5 THEN\n$OUT[1]=TRUE\nENDIF\nEND\n"),
        (["LIN XP1", "XP3=XP1", "LIN XP3"], ""),
        (["LIN XP1", "LOOK(XP1)"], "DEF LOOK(P:IN)\nE6POS P\n$OUT[1]=P.Z>5\nEND\n"),
        (["LIN XP1", "INTERRUPT DECL 4 WHEN $IN[1] DO LOOK(XP1)"], "DEF LOOK(P:IN)\nE6POS P\nEND\n"),
        (["LIN XP1", "OTHER()"], "DEF OTHER()\n$OUT[1]=XP1.X>5\nEND\n"),
        (["LIN XG"], ""),
    ],
)
def test_whoever_else_reads_a_point_finds_what_it_was(lines, subs):
    _, data = written(*lines, subs=subs)
    assert set(POINTS_DAT.splitlines()) <= set(data)


CUT = "DEF CUT(Q:IN)\nDECL E6POS Q\nLIN Q C_DIS\nEND\n"
CORRECTED = "DECL E6POS XP1={X 100.2500,Y 200.5000,Z 301.0000,A 10.00000,B 20.00000,C 170.00000,S 2,T 10}"


@pytest.mark.parametrize(
    ("lines", "subs"),
    [
        (["XP3=XP1", "LIN XP3"], ""),
        (["DECL FRAME FT", "FT=XP1", "LIN FT"], ""),
        (["XP3=XP1", "LIN XP3", "LIN XP3"], ""),
        (["DECL POS ZP", "ZP=XP1", "XP3=ZP", "LIN XP3"], ""),
        (["CUT(XP1)"], CUT),
        (["XP3=XP1", "CUT(XP3)", "CUT(XP3)"], CUT),
        (["CUT(XP1)"], CUT.replace("Q:IN", "Q:OUT")),
        (["CUT(XP1)"], CUT.replace("LIN Q C_DIS", "R=Q\nLIN R").replace("E6POS Q", "E6POS Q,R")),
    ],
)
def test_a_copied_point_is_corrected_where_its_numbers_are(lines, subs):
    source, data = written(*lines, subs=subs)
    assert data == [CORRECTED if line.startswith("DECL E6POS XP1=") else line for line in POINTS_DAT.splitlines()]
    assert source == (body(*lines) + subs.replace("\n", "\r\n")).splitlines()


@pytest.mark.parametrize(
    ("lines", "subs"),
    [
        (["XP3=XP1", "OK=XP1.Z>5", "LIN XP3"], ""),
        (["XP3=XP1", "IF XP3.Z>5 THEN", "$OUT[1]=TRUE", "ENDIF", "LIN XP3"], ""),
        (["XP3=XP1", "XP3.Z=XP3.Z+5", "LIN XP3"], ""),
        (["XP3=XP1", "P[1]=XP1", "P[1].X=3", "LIN XP3", "LIN P[1]"], ""),
        (["XG=XP1", "LIN XG"], ""),
        (["XP3=XG", "LIN XP3"], ""),
        (["CUT(XP1)"], CUT.replace("LIN Q C_DIS", "LIN Q C_DIS\n$OUT[1]=Q.Z>5")),
        (["CUT(XP1)", "LOOK(XP1)"], CUT + "DEF LOOK(P:IN)\nE6POS P\n$OUT[1]=P.Z>5\nEND\n"),
        (["CUT(XP1)", "OK=HIGH(XP1)"], CUT + "DEFFCT BOOL HIGH(P:IN)\nE6POS P\nRETURN(P.Z>300)\nENDFCT\n"),
        (["CUT(XP1)", "OTHER()"], CUT + "DEF OTHER()\n$OUT[1]=XP1.X>5\nEND\n"),
        (["CUT(XP1)", "INTERRUPT DECL 4 WHEN $IN[1] DO CUT2(XP1)"], CUT + "DEF CUT2(P:IN)\nE6POS P\nEND\n"),
        (["CUT(XP1)", "XP3=XP1", "CUT(FR:XP3)"], CUT),
    ],
)
def test_a_copied_point_that_is_read_elsewhere_stays_as_it_was(lines, subs):
    _, data = written(*lines, subs=subs)
    assert data == POINTS_DAT.splitlines()


def test_a_loop_that_passes_the_points_of_an_array_to_a_routine_stays_a_loop():
    lines = ["FOR I=1 TO 3", "CUT(P[I])", "ENDFOR"]
    source, data = written(*lines, subs=CUT)
    assert source == (body(*lines) + CUT.replace("\n", "\r\n")).splitlines()
    starts = [f"P[{n}]={{X {x}.0000,Y 2.0000,Z 4.0000," for n, x in ((1, 1), (2, 11), (3, 21))]
    points = [line for line in data if line.startswith("P[")]
    assert all(line.startswith(start) for line, start in zip(points, starts, strict=True))


# --- called programs of other files --------------------------------------------------------------------------------


def in_folder(folder, source, files, data=POINTS_DAT, cell=CELL):
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(text.replace("\n", "\r\n").encode())
    documents = [decode("part.src", source.encode()), decode("part.dat", data.encode())]
    documents = [replace(document, folder=str(folder)) for document in documents]
    return read_documents(documents, cell, forward, "part")


SETTINGS = """DEF MoveSettings(B:IN,T:IN,V:IN,A:IN)
INT B,T,A
REAL V
BAS(#BASE,B)
BAS(#TOOL,T)
$VEL.CP=V/1000.0
COUNTER=COUNTER+1
END
"""


@pytest.mark.parametrize("name", ["MoveSettings.src", "MOVESETTINGS.SRC", "lib/all.src"])
def test_programs_of_the_folder_and_of_the_search_path_are_followed(tmp_path, name):
    text = SETTINGS if "all" not in name else "DEF all()\nEND\nGLOBAL " + SETTINGS
    cell = replace(CELL, krl=Krl(search=["lib"]), folder=str(tmp_path))
    found = in_folder(tmp_path, body("MoveSettings(3,2,100.0,5)", FULL), {name: text}, cell=cell)
    m = found.motions
    assert m.feed.tolist() == [0.1]
    assert found.bases[m.base[0], 0, 3] == pytest.approx(1.2)
    assert found.tools[m.tool[0], 0, 3] == pytest.approx(0.02)
    assert about(found, "external-call") == []


def test_another_file_has_variables_of_its_own(tmp_path):
    other = {"other.src": "DEF other()\nXP1.Z=5\nXG.Z=6\nI=I+1\n$VEL.CP=SPD\nEND\n"}
    other["other.dat"] = "DEFDAT other\nDECL E6POS XP1={X 1,Y 1,Z 1}\nDECL INT I=5\nDECL REAL SPD=0.125\nENDDAT\n"
    found = in_folder(tmp_path, body("other()", "LIN XP1", "LIN XG", "LIN P[I]"), other)
    assert numbers(found)[:, 2].tolist() == [300, 6, 3]
    assert found.motions.feed.tolist() == [0.125] * 3


def test_motions_in_another_file_that_cannot_be_known_leave_the_start_of_the_next_motion_open(tmp_path):
    files = {"job.src": "DEF job()\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\nLIN $POS_ACT:{X 1}\nEND\n"}
    with pytest.raises(ProgramError, match=r"moves the robot \(job\.src, line [23]\)") as caught:
        in_folder(tmp_path, body("job()", FULL), files)
    assert caught.value.line == 4
    found = in_folder(tmp_path, body("job()", "PTP {A1 5,A2 -90,A3 90,A4 0,A5 20,A6 0}", FULL), files)
    assert about(found, "motions-elsewhere") == [("JOB", 4)]


def test_names_of_the_data_list_are_looked_up_only_if_other_files_may_declare_them_too(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(folder, "declared_names", lambda data: asked.append(data) or declared_names(data))
    in_folder(tmp_path, body("LIN XP1"), {})
    assert not asked
    in_folder(tmp_path, body("LIN XP1"), {"other.dat": "DEFDAT other PUBLIC\nDECL GLOBAL INT XP1=3\nENDDAT\n"})
    assert [data.document.name for data in asked] == ["part.dat"]


def test_a_file_that_is_not_understood_does_at_worst_what_it_may(tmp_path):
    files = {"odd.src": "DEF odd()\nXG.Z=5\nTHIS IS ODD (\nEND\n"}
    with pytest.raises(ProgramError, match=r"XG is changed while the program runs \(odd\.src, line 2\)"):
        in_folder(tmp_path, body("odd()", "LIN XG"), files)
    assert x_y_z(in_folder(tmp_path, body("odd()", "LIN XP1"), files)) == UNTOUCHED


def test_a_file_that_cannot_be_read_is_told(tmp_path):
    found = in_folder(tmp_path, body("odd()", FULL), {"odd.src": "DEF odd()\n$OUT[1]=TRUE\n"})
    (issue,) = (issue for issue in found.issues if issue.kind == "external-call")
    assert "no END" in issue.message


@pytest.mark.parametrize(
    ("effect", "problem"),
    [
        ("$TOOL={X 0,Y 0,Z 99,A 0,B 0,C 0}", r"N may change \$TOOL"),
        ("XG.X=XG.X+1", r"XG is changed while the program runs \(job\.src, line 5\)"),
        ("$OUT[1]=TRUE", ""),
    ],
)
def test_functions_in_targets_of_motions_elsewhere_change_what_they_write(tmp_path, effect, problem):
    job = f"DEF job()\nLIN Q[N()]\nEND\nDEFFCT INT N()\n{effect}\nRETURN 1\nENDFCT\n"
    files = {"job.src": job, "job.dat": "DEFDAT job\nDECL E6POS Q[1]\nENDDAT\n"}
    lines = ("job()", "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}", "LIN XG")
    if problem:
        with pytest.raises(ProgramError, match=problem):
            in_folder(tmp_path, body(*lines), files)
    else:
        assert len(numbers(in_folder(tmp_path, body(*lines), files))) == 2


SHARED = "DEFDAT shared PUBLIC\nDECL GLOBAL E6POS XS={X 1,Y 2,Z 3,A 0,B 0,C 0}\nDECL GLOBAL INT NS=1\nENDDAT\n"
SETS = "DEF calc()\nIF NS==3 THEN\n  xs.X = 5\nENDIF\nNS=2\nEND\n"


@pytest.mark.parametrize(
    ("lines", "calc", "names"),
    [
        (("LIN XS",), SETS, ["XS"]),
        (("LIN {X NS,Y 2,Z 3,A 0,B 0,C 0}", "LIN XS"), SETS, ["NS, XS"]),
        (("LIN XS",), "DEF calc()\nDECL E6POS XS\nXS.X=5\nEND\n", []),  # its own
        (("LIN XS",), "DEF calc()\nIF XS.X==5 THEN\nENDIF\nLIN XS\n;XS.X=5\nEND\n", []),
        (("calc()", "LIN {X NS,Y 2,Z 3,A 0,B 0,C 0}"), "DEF calc()\nNS=2\nEND\n", []),  # followed
        (("NS=4", "LIN {X NS,Y 2,Z 3,A 0,B 0,C 0}"), SETS, []),  # set by the program itself
        ((FULL,), SETS, []),
    ],
)
def test_shared_points_that_other_programs_change_are_named(tmp_path, lines, calc, names):
    found = in_folder(tmp_path, body(*lines), {"shared.dat": SHARED, "calc.src": calc})
    issues = [issue for issue in found.issues if issue.kind == "changed-elsewhere"]
    assert [issue.subject for issue in issues] == names
    assert all(f"{name} (calc.src)" in issues[0].message for each in names for name in each.split(", "))


def test_a_point_that_two_data_lists_declare_global_is_not_known_and_both_are_named(tmp_path):
    files = {
        f"{name}.dat": f"DEFDAT {name}\nDECL GLOBAL E6POS XS={{X {x},Y 2,Z 3}}\nENDDAT\n" for x, name in enumerate("ba")
    }
    files["a.src"] = "DEF a()\n$OUT[1]=TRUE\nEND\n"
    for lines in (("LIN XS",), ("a()", "LIN XS")):
        with pytest.raises(ProgramError, match=r"XS is .* \(it is GLOBAL in more than one \.dat: a\.dat, b\.dat\)"):
            in_folder(tmp_path, body(*lines), files)


PICK = "DEF pick()\nLIN XP2\nLIN XP3\nEND\n"
CHANGES = "DEF pick()\nLIN XP2\nLIN XP3\nXP2.X=XP2.X+5\nEND\n"
PICKED = """DEFDAT pick
E6POS XP2={X 7,Y 2,Z 3,A 10,B 20,C 170}
E6POS XP3={X 100,Y 20,Z 30,A 10,B 20,C 170}
ENDDAT
"""
BRANCHES = ("IF $IN[1] THEN", "pick()", "ELSE", "WAIT SEC 1", "pick()", "ENDIF", "pick()")


def test_points_of_another_file_are_the_same_in_each_round_of_a_loop_without_exit(tmp_path):
    lines = (FULL, "LOOP", "pick()", "ENDLOOP")
    found = in_folder(tmp_path, body(*lines), {"pick.src": PICK, "pick.dat": PICKED})
    assert numbers(found)[:, 0].tolist() == [100, 7, 100]
    with pytest.raises(ProgramError, match=r"rounds differ: each one changes XP2 of PICK for the next"):
        in_folder(tmp_path, body(*lines), {"pick.src": CHANGES, "pick.dat": PICKED})


def test_data_of_another_file_that_stay_changed_are_named_with_their_file(tmp_path):
    found = in_folder(tmp_path, body(FULL, "pick()"), {"pick.src": CHANGES, "pick.dat": PICKED})
    (issue,) = (issue for issue in found.issues if issue.kind == "changed-data")
    assert issue.subject == "XP2 of PICK"
    assert "XP2 of PICK (pick.src, line 4)" in issue.message


def test_points_of_another_file_are_the_same_in_all_branches_and_behind_them(tmp_path):
    files = {"pick.src": PICK, "pick.dat": PICKED}
    assert numbers(in_folder(tmp_path, body(FULL, *BRANCHES), files))[:, 0].tolist() == [100, 7, 100, 7, 100, 7, 100]
    one = (*BRANCHES[:2], "ENDIF", "pick()")
    assert numbers(in_folder(tmp_path, body(FULL, *one), files))[:, 0].tolist() == [100, 7, 100, 7, 100]


@pytest.mark.parametrize("branch", [1, 4])
def test_a_point_of_another_file_that_one_branch_changes_is_not_known_behind_them(tmp_path, branch):
    lines = list(BRANCHES)
    lines[branch] = "change()"
    source = PICK + "GLOBAL DEF change()\n{}\nLIN XP2\nLIN XP3\nEND\n"
    in_folder(tmp_path, body(FULL, *lines), {"pick.src": source.format("$OUT[1]=TRUE"), "pick.dat": PICKED})
    with pytest.raises(ProgramError, match="is called, which moves the robot"):
        in_folder(tmp_path, body(FULL, *lines), {"pick.src": source.format("XP2.X=XP2.X+5"), "pick.dat": PICKED})


def test_submit_programs_may_write_global_names_at_any_time(tmp_path):
    files = {"sps.sub": "DEF sps()\nLOOP\nXG.Z=XG.Z+1\nENDLOOP\nEND\n"}
    with pytest.raises(ProgramError, match="XG is changed while the program runs"):
        in_folder(tmp_path, body("LIN XG"), files)
    assert x_y_z(in_folder(tmp_path, body("LIN XP1"), files)) == UNTOUCHED


def test_each_program_that_is_nowhere_is_named_with_its_first_line():
    found = read_lines(
        "MSG()", "MoveSettings()", "RET=RSI_CREATE()", "IF CHECK(1) THEN", "ENDIF", "MSG()", "X=SIN(3)", "LIN XG"
    )
    assert about(found, "external-call") == [
        ("MSG", 4),
        ("MOVESETTINGS", 5),
        ("RSI_CREATE", 6),
        ("CHECK", 7),
        ("MSG", 9),
    ]
    assert any(issue.message.startswith("MoveSettings() is in no file") for issue in found.issues)
    assert all("GLOBAL XG" in issue.message for issue in found.issues if issue.kind == "external-call")


@pytest.mark.parametrize("call", ["RSI_MOVECORR()", "RET=RSI_ON()", "IF ST_ON1(1,2)==0 THEN\nENDIF"])
def test_a_sensor_that_moves_the_robot_is_refused(call):
    with pytest.raises(ProgramError, match="sensor") as caught:
        read(body(FULL, *call.split("\n"), FULL))
    assert caught.value.line == 5


@pytest.mark.parametrize(
    "loop",
    [
        ["LOOP", "IF $IN[1] THEN", "EXIT", "ENDIF", "ENDLOOP"],
        ["LOOP", "WAIT SEC 0.1", "I=I+1", "IF I>5 THEN", "EXIT", "ENDIF", "IF $IN[2] THEN", "I=9", "ENDIF", "ENDLOOP"],
        ["LOOP", "SWITCH I", "CASE 1", "EXIT", "ENDSWITCH", "ENDLOOP"],
    ],
)
def test_a_loop_without_motions_that_an_input_ends_is_complete(loop):
    program = read_lines("LIN XP1", *loop, "LIN XP3")
    assert len(program.motions) == 2


def test_a_call_that_mills_the_points_of_a_file_is_refused():
    with pytest.raises(ProgramError, match="points of a file, which are not in the program") as caught:
        read(body(FULL, 'CR_PROCESS_FILE("job.csv",1,-1,"OK")', FULL))
    assert caught.value.line == 5


def test_global_names_that_motions_depend_on_are_named_with_the_calls_that_may_change_them():
    data = POINTS_DAT.replace("DECL INT I", "DECL GLOBAL INT I").replace("DECL REAL SPD", "DECL GLOBAL REAL SPD")
    found = read_lines("MSG()", "$VEL.CP=SPD", "LIN P[I]", data=data)
    (issue,) = (issue for issue in found.issues if issue.kind == "external-call")
    assert "GLOBAL I, SPD" in issue.message


@pytest.mark.parametrize(
    ("lines", "names", "line"),
    [
        (["LIN XP1", "SHIFT()"], "XP1", 4),
        (["LIN P[I]", "I=I+1"], "I", 4),
        (["I=I+1", "LIN P[I]"], "I", 5),
        (["Q=XP1", "LIN Q", "XP1.Z=XP1.Z+5"], "XP1", 5),
        (["P[1]=XP1", "LIN P[1]", "LIN P[2]", "P[2].Z=50"], "P", 6),
        (["XP1.Z=5", "LIN XP1", "XP1.X=7"], "XP1", 5),
        (["XP1.Z=XP1.Z+5", "LIN XP1"], "XP1", 5),
        (["LIN XP1", "IF $IN[1] THEN", "XP1.Z=5", "ENDIF"], "XP1", 4),
        (["LIN XP1", "XP1=$POS_ACT"], "XP1", 4),
        (["$VEL.CP=SPD", "LIN XP1", "SPD=0.25"], "SPD", 5),
        (["$BASE=BASE_DATA[3]", "LIN XP1", "BASE_DATA[3].Z=BASE_DATA[3].Z+5"], "BASE_DATA", 5),
        (["$TOOL=TOOL_DATA[2]", "LIN XP1", "TOOL_DATA[2].Z=1"], "TOOL_DATA", 5),
        # BAS and functions of inline forms read data that they do not name
        (["BAS(#BASE,3)", "LIN XP1", "BASE_DATA[3].Z=BASE_DATA[3].Z+5"], "BASE_DATA", 5),
        (["BAS(#TOOL,2)", "LIN XP1", "TOOL_DATA[2].Z=1"], "TOOL_DATA", 5),
        (
            ["FDAT_ACT={TOOL_NO 2,BASE_NO 3}", "BAS(#FRAMES)", "LIN XP1", "BASE_DATA[3].Z=1"],
            "BASE_DATA",
            6,
        ),
        (["SLIN XP1 WITH $BASE=SBASE(3)", "BASE_DATA[3].Z=1"], "BASE_DATA", 4),
        (["SLIN XP1 WITH $TOOL=STOOL2({TOOL_NO 2,BASE_NO 3})", "TOOL_DATA[2].Z=1"], "TOOL_DATA", 4),
        (["TABLE()", "LIN XP1", "BASE_DATA[3].Z=BASE_DATA[3].Z+5"], "BASE_DATA", 5),
    ],
)
def test_a_program_whose_next_run_begins_with_other_values_is_told(lines, names, line):
    subs = SHIFT + "DEF TABLE()\nBAS(#BASE,3)\nEND\n"
    assert about(read_lines(*lines, subs=subs), "changed-data") == [(names, line)]


@pytest.mark.parametrize(
    "lines",
    [
        ["I=1", "LIN P[I]", "I=2", "LIN P[I]"],
        ["XP1.Z=5", "LIN XP1"],
        ["LIN XP1", "I=I+1"],
        ["$BASE=BASE_DATA[3]", "LIN XP1", "BASE_DATA[4]=BASE_DATA[3]"],
        ["PTP {A1 0,A2 -90,A3 90,A4 0,A5 90,A6 0}", "LIN XP1", "SPD=0.25"],
    ],
)
def test_changed_values_that_do_not_change_the_next_run_are_not_told(lines):
    assert about(read_lines(*lines), "changed-data") == []


def test_the_place_of_an_external_axis_in_a_subprogram_is_told_at_its_line():
    subs = "DEF AT_E1()\nPTP {X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T 2,E1 88.2}\nEND\n"
    lines = ["I=1", "LIN XP1", "AT_E1()", "AT_E1()"]  # the trace has five rows before the PTP, which is in line 10
    assert about(read_lines(*lines, subs=subs), "external-axis") == [("E1", 10)]


@pytest.mark.parametrize("head", ["DEFFCT INT[ VALUES()", "GLOBAL DEFFCT E6POS[ VALUES(I:IN)"])
def test_a_function_whose_type_has_an_open_bracket_is_refused_at_its_line(head):
    with pytest.raises(ProgramError, match=r"the bracket \[ is not closed") as caught:
        read_lines("LIN XP1", subs=f"{head}\nRETURN(I)\nENDFCT\n")
    assert (caught.value.line, caught.value.text) == (6, head)
    assert len(read_lines("LIN XP1", subs=head.replace("[", "[]") + "\nRETURN(I)\nENDFCT\n").motions) == 1


SHOW_PART = "DEF SHOWPART(N:IN)\nINT N\n$OUT[N]=TRUE\nEND\n"


@pytest.mark.parametrize(
    ("lines", "names", "line"),
    [
        (["LIN XP1", "IF I==3 THEN", "LIN XP3", "ENDIF", "I=I+1"], "I", 5),
        (["LIN XP1", "I=I+1", "IF I==4 THEN", "LIN XP3", "ENDIF"], "I", 6),
        (["LIN XP1", "SWITCH I", "CASE 4", "LIN XP3", "ENDSWITCH", "I=I+1"], "I", 5),
        (["LIN XP1", "IF I==3 THEN", ";FORCE FX=100", "ENDIF", "LIN XP1", "I=I+1"], "I", 5),
        (["IF I==3 THEN", "$VEL.CP=0.1", "ENDIF", "LIN XP1", "I=I+1"], "I", 5),
        (["IF I==3 THEN", "XP1.Z=5", "ENDIF", "LIN XP1", "I=I+1"], "I", 7),
        (["LIN XP1", "WHILE I==3", "LIN XP3", "I=I+1", "ENDWHILE", "I=I+1"], "I", 5),
        # a change that a later run makes only
        (["LIN P[2]", "I=I+1", "IF I==4 THEN", "P[2].Z=50", "ENDIF"], "I, P", 4),
    ],
)
def test_a_counter_that_decides_in_a_later_run_is_warned_of(lines, names, line):
    found = read_lines(*lines)
    (issue,) = (issue for issue in found.issues if issue.kind == "changed-data")
    assert (issue.subject, issue.source_line) == (names, line)
    assert "a later run may move differently from this line on" in issue.message


@pytest.mark.parametrize(
    "lines",
    [
        ["LIN XP1", "I=I+1", "IF I>9 THEN", "I=0", "ENDIF"],
        ["LIN XP1", "I=I+1", "IF I==4 THEN", "MSG(I)", "$OUT[3]=TRUE", "ENDIF"],
        ["LIN XP1", "SHOWPART(I)", "I=I+1"],
        ["LIN XP1", "I=I+1", "P[1].Z=I", "LIN P[2]"],  # another element
        ["LIN P[I]", "I=2", "LIN XP1", "I=1"],
        ["IF OK THEN", "I=7", "ENDIF", "LIN XP1", "OK=TRUE", "I=I+1"],
    ],
)
def test_a_counter_that_no_motion_depends_on_is_not_warned_of(lines):
    assert about(read_lines(*lines, subs=SHOW_PART), "changed-data") == []


def test_the_first_line_that_the_next_run_skips_or_runs_is_named():
    lines = ["LIN XP1", "IF OK THEN", "LIN XP3", "ENDIF", "LIN XP1", "OK=FALSE"]
    data = POINTS_DAT.replace("BOOL OK", "BOOL OK=TRUE")
    (issue,) = (issue for issue in read_lines(*lines, data=data).issues if issue.kind == "changed-data")
    assert (issue.subject, issue.source_line) == ("OK", 6)
    assert "The next run begins with the changed values and moves differently from this line on" in issue.message


def test_a_counter_that_the_program_sets_first_needs_no_second_run(monkeypatch):
    def followed(*_):
        raise AssertionError

    monkeypatch.setattr(next_run, "execution_of", followed)
    loop = ["FOR I=1 TO 2", "LIN P[I]", "ENDFOR"]
    assert len(read_lines(*loop, "I=7").motions) == 2
    assert len(read_lines("LIN XP1", "I=I+1", "IF $IN[1] THEN", "I=I-1", "ENDIF").motions) == 1  # it decides on nothing
    for before in ("LIN P[I]", "IF $IN[1] THEN\r\nI=1\r\nENDIF", "SHOW()"):
        with pytest.raises(AssertionError):
            read_lines(before, *loop, subs="DEF SHOW()\r\n$OUT[I]=TRUE\r\nEND\r\n")


@pytest.mark.parametrize(
    ("kind", "lasting"),
    [
        ("OUT", "ANIN ON V=0.1*$ANIN[1]+0"),
        ("OUT", "INTERRUPT DECL 4 WHEN $IN[1] DO V=5"),
        ("OUT", "INTERRUPT DECL 4 WHEN $IN[1] DO BUMP(V)"),
        ("IN", "ANIN ON V=0.1*$ANIN[1]+0"),
    ],
)
def test_a_parameter_that_changes_at_any_time_is_refused_since_the_variable_given_for_it_does(kind, lasting):
    subs = f"DEF SUB1(V:{kind})\nREAL V\n{lasting}\nEND\nDEF BUMP(W)\nREAL W\nW=W+1\nEND\n"
    lines = ["SUB1(SPD)", "LIN XP1"]
    if kind == "IN":
        assert x_y_z(read_lines(*lines, subs=subs)) == UNTOUCHED
        return
    for through in ("", "DEF SUB2(V)\nREAL V\nSUB1(V)\nEND\n"):
        called = ["SUB2(SPD)", "LIN XP1"] if through else lines
        with pytest.raises(ProgramError, match="a parameter that changes at any time"):
            read_lines(*called, subs=subs + through)


def test_functions_in_the_conditions_of_events_count_as_called():
    for event in (
        "TRIGGER WHEN PATH=FN(XP1) DELAY=0 DO $OUT[1]=TRUE",
        "TRIGGER WHEN DISTANCE=0 DELAY=FN(XP1) DO $OUT[1]=TRUE",
        "INTERRUPT DECL 3 WHEN FN(XP1)==1 DO NOTHING()",
    ):
        with pytest.raises(ProgramError, match="XP1 is changed while the program runs"):
            read_lines(
                event, "LIN XP1", subs="DEFFCT INT FN(Q:OUT)\nE6POS Q\nQ.Z=5\nRETURN 1\nENDFCT\nDEF NOTHING()\nEND\n"
            )


def test_an_imported_variable_is_the_same_one_under_another_name():
    with pytest.raises(ProgramError, match="XP1 is changed while the program runs"):
        read_lines("IMPORT E6POS YY IS /R1/PART..XP1", "YY.Z=77", "LIN XP1")
    with pytest.raises(ProgramError, match="XP1 is changed while the program runs"):
        read_lines("RAISE()", "LIN XP1", subs="DEF RAISE()\nIMPORT E6POS YY IS /R1/PART..XP1\nYY.Z=77\nEND\n")


STORE = "DEFDAT store PUBLIC\nDECL INT COUNT=1\nENDDAT\n"
TO_STORED = "DEF store()\nLIN {X COUNT,Y 2,Z 3,A 10,B 20,C 170}\nEND\n"
OTHER_HOME = "PTP {A1 5,A2 -90,A3 90,A4 0,A5 20,A6 0}"
IMPORT_COUNT = "IMPORT INT YY IS /R1/STORE..COUNT"


@pytest.mark.parametrize("changing", ["CHANGE()", "YY=3"])
def test_an_imported_variable_of_another_file_changes_there(changing, tmp_path):
    files = {"store.src": TO_STORED, "store.dat": STORE}
    change = f"DEF CHANGE()\r\n{IMPORT_COUNT}\r\nYY=3\r\nEND\r\n"
    data = POINTS_DAT if changing == "CHANGE()" else POINTS_DAT.replace("ENDDAT", f"{IMPORT_COUNT}\r\nENDDAT")
    changed = in_folder(tmp_path, body(changing, "STORE()", OTHER_HOME, FULL) + change, files, data)
    (message,) = (issue.message for issue in changed.issues if issue.kind == "motions-elsewhere")
    assert "COUNT is changed while the program runs" in message
    unchanged = in_folder(tmp_path, body("STORE()", FULL) + change, files, POINTS_DAT)
    assert x_y_z(unchanged, 0) == [1, 2, 3]


def test_a_variable_of_the_program_that_another_data_list_imports_may_change_there(tmp_path):
    files = {
        "store.src": "DEF store()\nYY=3\nEND\n",
        "store.dat": "DEFDAT store PUBLIC\nIMPORT INT YY IS /R1/PART..I\nENDDAT\n",
    }
    with pytest.raises(ProgramError, match="I is changed while the program runs"):
        in_folder(tmp_path, body("STORE()", "LIN P[I]"), files)


BROKEN_OFF = ("INTERRUPT DECL 5 WHEN $IN[1] DO STOP_IT()", FULL, "CHECK()")
CHECK = "DEF CHECK()\nINTERRUPT ON 5\nWAIT SEC 0.1\nEND\nDEF STOP_IT()\nINTERRUPT OFF 5\nBRAKE\n{}\nEND\n"


@pytest.mark.parametrize("motion", ["LIN_REL {X 5}", "LIN {X 5}", "CIRC XP3,{X 7,Y -90,Z 30}"])
def test_behind_a_call_that_an_interrupt_may_break_off_the_robot_may_be_anywhere(motion):
    with pytest.raises(ProgramError, match="RESUME of an interrupt may break off CHECK and the motion before it"):
        read_lines(*BROKEN_OFF, motion, subs=CHECK.format("RESUME"))
    assert len(numbers(read_lines(*BROKEN_OFF, motion, subs=CHECK.format("WAIT SEC 0")))) == 2
    assert x_y_z(read_lines(*BROKEN_OFF, "LIN XP1", motion, subs=CHECK.format("RESUME")), 1) == UNTOUCHED


def test_behind_a_call_that_an_interrupt_may_break_off_relative_motions_can_stay_as_they_are():
    cell = replace(CELL, krl=replace(CELL.krl, keep_unresolved=True))
    read_program = read_lines(*BROKEN_OFF, "LIN_REL {X 5}", "LIN XP1", subs=CHECK.format("RESUME"), cell=cell)
    assert [motion.text for motion in read_program.unresolved] == ["LIN_REL {X 5}"]
    assert [issue.source_line for issue in read_program.issues if issue.kind == "start-unknown"] == [8]


def test_components_of_frames_of_the_cell_can_be_computed_with():
    plain = read_lines("LIN {X 1,Y 2,Z BASE_DATA[3].Z,A 10,B 20,C 170}")
    moved = read_lines("BASE_DATA[3].Z=BASE_DATA[3].Z+5", "LIN {X 1,Y 2,Z BASE_DATA[3].Z,A 10,B 20,C 170}")
    assert x_y_z(plain) == [1, 2, CELL.base_data["3"].Z]
    assert x_y_z(moved) == [1, 2, CELL.base_data["3"].Z + 5]


# --- BAS(#INITMOV,0) -----------------------------------------------------------------------------------------------

OPEN = replace(CELL, krl=Krl())


def test_frames_left_to_initmov_are_told():
    found = read_lines(FULL, cell=OPEN)
    assert about(found, "initial-frames") == [("$BASE", 4), ("$TOOL", 4)]
    assert about(read_lines("$TOOL={X 0,Y 0,Z 5,A 0,B 0,C 0}", FULL, cell=OPEN), "initial-frames") == [("$BASE", 5)]
    assert (
        about(
            read_lines(*(f"{name}={{X 5,Y 0,Z 0,A 0,B 0,C 0}}" for name in ("$TOOL", "$BASE")), FULL, cell=OPEN),
            "initial-frames",
        )
        == []
    )
    assert about(read_lines("PTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}", cell=OPEN), "initial-frames") == []
    assert about(read_lines(FULL, cell=CELL), "initial-frames") == []
    assert about(read("DEF part()\r\n" + FULL + "\r\nEND\r\n", cell=OPEN), "initial-frames") == []


def test_a_cell_with_the_frames_that_initmov_gives_needs_no_word():
    tool = Tool(Z=350.0)
    cell = replace(OPEN, base=Frame(), tool=tool, tool_data={"1": tool})
    assert about(read_lines(FULL, cell=cell), "initial-frames") == []


def test_the_cell_says_which_frames_initmov_gives():
    cell = replace(CELL, krl=Krl(initmov="bas"), tool_data={"1": Tool(Z=123.0)})
    found = read_lines(FULL, cell=cell)
    m = found.motions
    np.testing.assert_allclose(found.bases[m.base[0]], np.eye(4), atol=1e-15)
    assert found.tools[m.tool[0], 2, 3] == pytest.approx(0.123)
    with pytest.raises(ProgramError, match=r"TOOL_DATA\[1\]"):
        read_lines(FULL, cell=replace(CELL, krl=Krl(initmov="bas")))


# --- errors --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "lines",
    [
        ["LOOP", FULL],
        ["WHILE $IN[1]", FULL],
        ["IF $IN[1] THEN", FULL, "ELSE"],
        ["FOR I=1 TO 2", FULL],
        ["REPEAT", FULL],
        ["SWITCH I", "CASE 1", FULL],
        ["IF $IN[1] THEN", "LOOP", FULL, "ENDIF"],
    ],
)
def test_a_called_routine_with_a_structure_that_is_not_closed_is_refused_at_its_line(lines):
    text = "\r\n".join(["DEF part()", FULL, "SUB()", FULL, "END", "DEF SUB()", "INT I", *lines, "END", ""])
    opener = next(line for line in lines if line not in (FULL, "CASE 1"))
    with pytest.raises(ProgramError, match=f"{opener.split()[0]} is not closed") as caught:
        read(text, "DEFDAT part\r\nENDDAT\r\n")
    assert caught.value.line == 8


def test_all_errors_of_a_program_are_told_in_order_of_lines():
    with pytest.raises(ProgramError) as caught:
        read_lines(
            "LIN {X 1,,Y 2}", FULL, "FOO BAR BAZ", "XP1={X 1,,Z}", "LIN XP1", "LIN {X}", "FOR I=1 TO 9", FULL, FULL
        )
    errors = [caught.value, *caught.value.further_errors]
    assert [error.line for error in errors] == [4, 6, 7, 9]


@pytest.mark.parametrize(
    "line",
    [
        "LIN P[" + "1" * 5000 + "]",
        "LIN P[" + "1" * 5000,
        "P[" + "1" * 5000 + "]={X 1}",
        "LIN {X " + "1" * 5000 + "}",
        "LIN {X 1E300,Y 2,Z 3,A 0,B 0,C 0}",
        "LIN {X 1,Y 2,Z 3,S 1E300}",
        "LIN {X 'H" + "F" * 5000 + "'}",
        "$BASE={X 1E300}",
        "$TOOL.X=1E200*1E200",
        "$VEL.CP=1E300",
        "BAS(#BASE,1E300)",
        "I=" + "(" * 5000 + "1" + ")" * 5000,
        "I=" + "-" * 5000 + "1",
        "LIN " + "P:" * 5000 + "P",
        "LIN P[\u00b2]",
        "LIN P[\u0661]",
        "CIRC {X 1E9,Y 0,Z 0},{X 1E-9,Y 0,Z 0}, CA 1E308",
        "DECL E6POS Q[" + "9" * 5000 + "]={X 1}",
        "TRIGGER WHEN PATH=1E999 DELAY=0 DO I=1",
        "LIN {X 1,Y 2,Z 3,A 1E308,B 1E308,C 1E308}",
    ],
)
def test_absurd_text_is_an_error_of_the_program(line):
    def message():
        try:
            read_lines(line, FULL)
        except ProgramError as error:
            return str(error)
        return ""

    assert len(message()) < 1000


def test_relative_motions_with_their_frame_behind_the_approximation():
    found = read_lines(FULL, "LIN_REL {Z 10} C_DIS #BASE", "LIN_REL {X 10} C_VEL #TOOL", "LIN_REL {Z 1} #TOOL C_DIS")
    along = pose_x(found)
    np.testing.assert_allclose(numbers(found)[1:3, :3], [[100, 20, 40], np.array([100, 20, 40]) + 10 * along])
    assert found.motions.blend[1] == 0.003
    source, _ = written(FULL, "LIN_REL {Z 10} C_DIS #BASE")
    assert source[4].rstrip() == "LIN {X 100.0000,Y 20.0000,Z 41.0000,A 10.00000,B 20.00000,C 170.00000} C_DIS"


def test_the_value_of_an_assignment_of_with_is_not_the_frame_of_a_relative_motion():
    program = read_lines(FULL, "SLIN_REL {Z 10} WITH $ACC.CP=#TOOL")
    np.testing.assert_allclose(numbers(program)[1, :3], [100, 20, 40])
    with pytest.raises(ProgramError, match=r"0\.1 #TOOL"):
        read_lines(FULL, "SLIN_REL {Z 10} WITH $VEL.CP=0.1 #TOOL")


def pose_x(found):
    return found.motions.target[0, :3, 0]


# --- interrupts that lead back to the path ---------------------------------------------------------------------------

STOPPED = "DEF STOPPED( )\nBRAKE\nWAIT FOR $IN[7]\n{}\nEND\n"
DECLARED = ["INTERRUPT DECL 3 WHEN $IN[6]==TRUE DO STOPPED( )", "INTERRUPT ON 3", "LIN XP1"]


@pytest.mark.parametrize("back", ["PTP $AXIS_RET", "ptp $axis_ret", "LIN $POS_RET", "SPTP $POS_RET"])
def test_an_interrupt_that_only_leads_back_to_the_path_leaves_it_as_it_is(back):
    assert x_y_z(read_lines(*DECLARED, subs=STOPPED.format(back))) == UNTOUCHED


@pytest.mark.parametrize(
    "away", ["PTP XP3", "PTP $AXIS_RET\nLIN XP3", "LIN $POS_RET:XP3", "LIN_REL {Z 5}", "PTP $POS_ACT"]
)
def test_an_interrupt_that_leads_elsewhere_is_refused(away):
    with pytest.raises(ProgramError, match="INTERRUPT moves the robot"):
        read_lines(*DECLARED, subs=STOPPED.format(away))


def test_a_motion_back_to_where_an_interrupt_was_is_not_followed_in_order():
    with pytest.raises(ProgramError):
        read_lines("STOPPED()", "LIN_REL {Z 5}", subs=STOPPED.format("PTP $AXIS_RET"))


@pytest.mark.parametrize("keep", [False, True])
def test_a_function_in_a_target_changes_what_a_later_condition_depends_on(keep):
    function = "DEFFCT REAL FN()\nI=I+1\nRETURN(5.5)\nENDFCT\n"
    lines = ["LIN {X FN(),Y 20,Z 30,A 10,B 20,C 170}", "IF I==1 THEN", FULL, "ELSE", "LIN XP3", "ENDIF", "LIN XP1"]
    cell = replace(CELL, krl=replace(CELL.krl, keep_unresolved=keep))
    if not keep:
        with pytest.raises(ProgramError, match=r"FN\(\) is computed while the program runs"):
            read_lines(*lines, subs=function, cell=cell)
        return
    kept = read_lines(*lines, subs=function, cell=cell)
    assert [motion.line for motion in kept.unresolved] == [4, 6, 8]  # FULL was read as a motion that runs
    assert x_y_z(kept) == UNTOUCHED
