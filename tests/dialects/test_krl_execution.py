"""Loops, branches and subprograms that move: read in the order in which they run, corrected where they stand.

What is read and what is written is executed by the controller of `tests.attack.krl_interpreter`.
"""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.dialects import krl
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.read import reader
from postproc.dialects.krl.read.motion_columns import merged_motions
from postproc.dialects.krl.read.plain_lines import plain_lines_of, plain_rows_of_trace
from postproc.dialects.krl.write.edited_rows import edited_rows, line_text
from postproc.dialects.krl.write.edits import Replacements
from postproc.errors import ProgramError
from postproc.program import Document
from postproc.toolpath.path import starts as starts_of
from tests.attack.krl import confirmed, read_job
from tests.dialects.krl_programs import CELL, body, check_commands, forward, numbers, read, targets
from tests.effort import calls
from tests.krl_texts import HOME, TURNED_HOME

FULL = "LIN {X 0,Y 0,Z 300,A 10,B 20,C 170}"
AWAY = "LIN {X 8,Y 0,Z 300,A 10,B 20,C 170}"
COUNT = 5
KEEPING = replace(CELL, krl=replace(CELL.krl, keep_unresolved=True))
COUNTERS_DAT = (
    "DEFDAT part\r\nDECL INT I=1\r\nDECL INT K=0\r\nDECL REAL Z=0\r\nDECL BOOL OK=TRUE\r\nDECL E6POS P[5]\r\n"
)
COUNTERS_DAT += "".join(f"P[{n}]={{X {n},Y 2,Z 3,A 4,B 5,C 6}}\r\n" for n in range(1, COUNT + 1))
COUNTERS_DAT += "DECL E6POS Q={X 50,Y 5,Z 5,A 1,B 2,C 3}\r\nDECL PT S[3]\r\n"
COUNTERS_DAT += "".join(f"S[{n}]={{N {n},FCNC {{X {n}0,Y 2,Z 3,A 4,B 5,C 6}}}}\r\n" for n in range(1, 4)) + "ENDDAT\r\n"
SUB = "DEF SUB(n:IN)\r\nDECL INT n\r\nLIN {X n,Y 1,Z 2,A 0,B 0,C 0} C_DIS\r\n$OUT[n]=TRUE\r\nEND\r\n"
STILL = "DEF SUB(n:IN)\r\nDECL INT n\r\nLIN {X 7,Y 1,Z 2,A 0,B 0,C 0} C_DIS\r\nEND\r\n"
OUT = "DEF SUB(n:OUT)\r\nDECL INT n\r\nn=n+1\r\nLIN {X n*10,Y 1,Z 2,A 0,B 0,C 0}\r\nEND\r\n"
DEEP = "DEF SUB(n:IN)\r\nDECL INT n\r\nINNER(n*10)\r\nEND\r\n"
DEEP += "DEF INNER(m:IN)\r\nDECL INT m\r\nLIN {X m,Y 1,Z 2,A 0,B 0,C 0}\r\nEND\r\n"

PROGRAMS = [
    # lines, subprograms, X of the motions behind the first
    (["FOR I=1 TO 3", "LIN {X 10*I,Y 0}", "ENDFOR"], "", [10, 20, 30]),
    (["FOR I=1 TO 5", "LIN P[I] C_DIS ; N", "ENDFOR"], "", [1, 2, 3, 4, 5]),
    (["FOR I=5 TO 1 STEP -2", "  LIN P[I]", "ENDFOR", "LIN P[I+2]"], "", [5, 3, 1, 1]),
    (["FOR I=2 TO 1", FULL, "ENDFOR", "LIN P[I]"], "", [2]),
    (["FOR I=1 TO 2", "FOR K=1 TO 2", "LIN {X I*10+K}", "ENDFOR", "$OUT[1]=TRUE", "ENDFOR"], "", [11, 12, 21, 22]),
    (["FOR I=1 TO 2", "LIN {X 5,Y 5,Z 5}", "LIN {X 6}", "ENDFOR"], "", [5, 6, 5, 6]),
    (
        ["I=2", "K=2", "SWITCH I", "CASE 1", "LIN {X 1}", "CASE K", "LIN {X 2}", "DEFAULT", "LIN {X 3}", "ENDSWITCH"],
        "",
        [2],
    ),
    (["K=5", "SWITCH I", "CASE K,K+1", "LIN {X 1}", "ENDSWITCH", "LIN {X 9}"], "", [9]),
    (["SWITCH OK", "CASE FALSE", "LIN {X 1}", "CASE TRUE", "LIN {X 2}", "ENDSWITCH"], "", [2]),
    (["DECL HUE H", "H=#RED", "SWITCH H", "CASE #BLUE", "LIN {X 1}", "CASE #RED", "LIN {X 2}", "ENDSWITCH"], "", [2]),
    (
        ["DECL HUE H", "H=#RED", "IF H==#RED THEN", "LIN {X 1}", "ENDIF", "IF H<>#RED THEN", "LIN {X 2}", "ENDIF"],
        "",
        [1],
    ),
    (["WHILE K<3", "K=K+1", "LIN {X K}", "ENDWHILE"], "", [1, 2, 3]),
    (["LIN P[1]", "RETURN", FULL, "LIN P[2]"], "", [1]),
    (["LIN P[1]", "IF OK THEN", "RETURN", "ENDIF", FULL], "", [1]),
    (["LIN P[1]", "IF NOT OK THEN", "RETURN", "ENDIF", AWAY], "", [1, 8]),
    (["FOR I=1 TO 4", "IF I==3 THEN", "RETURN", "ENDIF", "LIN P[I]", "ENDFOR", FULL], "", [1, 2]),
    (["SUB(4)", "RETURN", FULL], SUB, [4]),
    (["FOR I=1 TO 1", "IF I>9 THEN", "GOTO A", "ENDIF", "LIN P[2]", "A:", "ENDFOR"], "", [2]),
    (["REPEAT", "K=K+2", "LIN {X K}", "UNTIL K>=4"], "", [2, 4]),
    (["Z=1.5", "REPEAT", "LIN {X Z}", "Z=Z-0.5", "UNTIL Z<0.25"], "", [1.5, 1, 0.5]),
    (["LOOP", "K=K+1", "IF K==3 THEN", "EXIT", "ENDIF", "LIN {X K}", "ENDLOOP", "LIN {X 9}"], "", [1, 2, 9]),
    (["FOR I=1 TO 9", "LIN {X I}", "IF I==2 THEN", "EXIT", "ENDIF", "ENDFOR", "LIN {X I}"], "", [1, 2, 2]),
    (["IF OK AND (K==0) THEN", "LIN {X 1}", "ELSE", "LIN {X 2}", "ENDIF"], "", [1]),
    (["IF K==0 AND I==2 THEN", "LIN {X 1}", "ELSE", "LIN {X 2}", "ENDIF"], "", [2]),
    (["SWITCH I+1", "CASE 1", "LIN {X 1}", "CASE 3,2", "LIN {X 2}", "DEFAULT", "LIN {X 3}", "ENDSWITCH"], "", [2]),
    (["SWITCH I", "CASE 5", "LIN {X 1}", "ENDSWITCH", "LIN {X 2}"], "", [2]),
    (["SUB(4)", "LIN {X 5}"], SUB, [4, 5]),
    (["SUB(4)", "SUB(5)", "SUB(4)"], SUB, [4, 5, 4]),
    (["SUB(4)", "SUB(5)"], STILL, [7, 7]),
    (["FOR I=1 TO 3", "SUB(I)", "ENDFOR"], SUB, [1, 2, 3]),
    (["SUB(K)", "SUB(K)", "LIN {X K}"], OUT, [10, 20, 2]),
    (["SUB(1)", "INNER(2)", "SUB(3)"], DEEP, [10, 2, 30]),
    (["SUB()"], "DEF SUB()\r\nIF OK THEN\r\nLIN {X 1}\r\nRETURN\r\nENDIF\r\nLIN {X 2}\r\nEND\r\n", [1]),
    (["Z=SQRT(4.0)*COS(60)+ABS(-2)", "LIN {X Z,Y ATAN2(1,1)}", "LIN {X 10*SIN(30)}"], "", [3, 5]),
    (["CONST INT C=4", "FOR I=1 TO C STEP 3", "LIN {X C*I}", "ENDFOR"], "", [4, 16]),
    (["Q={X 5,Y 0,Z 0,A 90,B 0,C 0}", "LIN INV_POS(Q):P[1]"], "", [2]),
    (["Q=P[2]", "Q.Z=Q.Z-4", "LIN Q", "LIN {X 100+50,Y K*2}"], "", [2, 150]),
]
IDS = [" / ".join(lines)[:60] for lines, *_ in PROGRAMS]


def files_of(lines, subprograms):
    return {"part.src": body(FULL, *lines) + subprograms, "part.dat": COUNTERS_DAT}


@pytest.mark.parametrize(("lines", "subprograms", "x"), PROGRAMS, ids=IDS)
def test_a_program_moves_as_a_controller_moves_it_before_and_after_its_correction(lines, subprograms, x, tmp_path):
    files = files_of(lines, subprograms)
    program = read_job(files, tmp_path)
    np.testing.assert_allclose(numbers(program)[1:, 0], x, atol=1e-9)
    for seed in range(3):
        assert confirmed(program, files, tmp_path, np.random.default_rng(seed)) == "accepted"


def written(lines, subprograms="", shift=None, pieces=None):
    program = read(body(FULL, *lines) + subprograms, COUNTERS_DAT)
    wanted = targets(program, shift, pieces=pieces)
    out = krl.rewrite(program, wanted)
    check_commands(program, wanted, out)
    return program, out


def test_elements_of_an_array_are_corrected_in_the_data_and_the_loop_stays():
    lines = ["FOR I=1 TO 3", "  LIN S[I].FCNC C_VEL", "ENDFOR"]
    program, out = written(lines, shift=np.arange(12.0).reshape(4, 3) * 1e-3)
    text, data = (document.text for document in out.documents)
    assert "\r\n".join(lines) in text
    assert "S[2]={N 2,FCNC {X 26.0000,Y 9.0000,Z 11.0000,A 4.00000,B 5.00000,C 6.00000}}" in data
    assert program.motions.line.tolist() == [4, 6, 6, 6]
    assert out.output_line.tolist() == [4, 6, 6, 6]


def test_a_loop_whose_rounds_are_corrected_alike_stays_a_loop():
    shift = np.tile([1e-3, 0, 0], (5, 1))
    _, out = written(["FOR I=1 TO 4", "LIN {X 5,Y 5,Z 5,A 0,B 0,C 0}", "ENDFOR"], shift=shift)
    assert (
        "FOR I=1 TO 4\r\nLIN {X 6.0000,Y 5.0000,Z 5.0000,A 0.00000,B 0.00000,C 0.00000}\r\nENDFOR"
        in out.documents[0].text
    )


def test_a_loop_whose_rounds_differ_is_written_out_with_all_that_it_does():
    shift = np.arange(9.0).reshape(3, 3) * 1e-3
    _, out = written(["FOR I=1 TO 2", " LIN {X 5,Y 5,Z 5} ; N", " $OUT[I]=TRUE", "ENDFOR"], shift=shift)
    text = out.documents[0].text
    assert "; FOR I=1 TO 2 (written out)\r\nI=1\r\n LIN {X 8" in text
    assert text.count("$OUT[I]=TRUE") == 2
    assert text.count(" ; N") == 2
    assert "I=3\r\nEND" in text
    assert [issue.kind for issue in out.issues] == ["loop-written-out"]


def test_rounds_that_are_alike_stay_loops_beside_those_that_are_not():
    lines = ["FOR I=1 TO 5", "LIN P[I]", "ENDFOR", "FOR K=5 TO 1 STEP -1", "LIN {X 1,Y 1,Z 1}", "ENDFOR"]
    shift = np.zeros((11, 3))
    shift[9:] = 1e-3
    _, out = written(lines, shift=shift, pieces={1: [0.5]})
    text = out.documents[0].text.split("\r\n")
    assert text[4:12] == [
        "; FOR I=1 TO 5 (written out)",
        "I=1",
        "LIN {X 0.5000,Y 1.0000,Z 151.5000,A 4.00000,B 5.00000,C 6.00000} C_DIS",
        "LIN P[I]",
        "FOR I=2 TO 5",
        "LIN P[I]",
        "ENDFOR",
        "I=6",
    ]
    assert text[13:15] == ["FOR K=5 TO 3 STEP -1", "LIN {X 1.0000,Y 1.0000,Z 1.0000}"]
    assert text[16] == "FOR K=2 TO 1 STEP -1"
    assert text[19] == "K=0"


def test_a_subprogram_is_corrected_in_its_place_where_its_calls_agree_and_copied_where_they_do_not():
    _, out = written(["SUB(1)", "SUB(2)"], STILL, shift=np.tile([1e-3, 0, 0], (3, 1)))
    assert out.documents[0].text.count("DEF SUB") == 1
    _, out = written(["SUB(1)", "SUB(2)"], STILL, shift=np.arange(9.0).reshape(3, 3) * 1e-3)
    text = out.documents[0].text
    assert "SUB(1)\r\nSUB_2(2)\r\n" in text
    assert "DEF SUB_2(n:IN)" in text
    assert [issue.kind for issue in out.issues] == ["routine-copied"]


def test_inserted_targets_stand_in_each_round(tmp_path):
    files = files_of(["FOR I=1 TO 3", "LIN P[I]", "ENDFOR"], "")
    program = read_job(files, tmp_path)
    _, out = written(["FOR I=1 TO 3", "LIN P[I]", "ENDFOR"], pieces={2: [0.5]})
    assert out.output_line.tolist() == [4, 7, 9, 10, 12]
    assert len(program.motions) == 4


def test_a_program_that_does_not_end_is_refused_with_the_line():
    endless = ["FOR I=1 TO 2", "LOOP", FULL, "ENDLOOP", "ENDFOR"]
    for lines, line in ((["WHILE K<3", FULL, "ENDWHILE"], 5), (endless, 6)):
        with pytest.raises(ProgramError, match="never ends") as caught:
            read(body(FULL, *lines), COUNTERS_DAT)
        assert caught.value.line == line


def test_a_count_without_end_stops_with_a_message(monkeypatch):
    monkeypatch.setattr("postproc.dialects.krl.read.flow.MOST_UNCOUNTED", 1000)
    with pytest.raises(ProgramError, match="WHILE has not ended after 1000 statements") as caught:
        read(body(FULL, "WHILE K>-1", "K=K+1", FULL, "ENDWHILE"), COUNTERS_DAT)
    assert caught.value.line == 5
    monkeypatch.setattr("postproc.dialects.krl.read.flow.MOST_TRACED", 1000)
    with pytest.raises(ProgramError, match=r"too long: 10\d\d statements"):
        read(body(FULL, "FOR I=1 TO 40", "FOR K=1 TO 40+I*0", FULL, "ENDFOR", "ENDFOR"), COUNTERS_DAT)
    read(body(FULL, "FOR K=1 TO 900", "ENDFOR", "FOR I=1 TO 900", FULL, "ENDFOR"), COUNTERS_DAT)


def test_a_count_that_is_too_high_is_not_followed_first():
    with pytest.raises(ProgramError, match="FOR has 2000000000 rounds, more than") as caught:
        read(body(FULL, "FOR K=1 TO 2000000000", FULL, "ENDFOR"), COUNTERS_DAT)
    assert caught.value.line == 5
    read(body(FULL, "FOR K=1 TO 2000000000", FULL, "IF K==3 THEN", "EXIT", "ENDIF", "ENDFOR"), COUNTERS_DAT)


def calls_in_calls(depth, calls, leaf):
    subs = [f"DEF S{n}()\r\n" + f"S{n + 1}()\r\n" * calls + "END\r\n" for n in range(depth)]
    return body(FULL, "S0()", FULL) + "".join(subs) + f"DEF S{depth}()\r\n{leaf}\r\nEND\r\n"


def loops_in_loops(inner, rounds=60):
    return body(FULL, *[f"FOR {n}=1 TO {rounds}" for n in "IKNM"], inner, *["ENDFOR"] * 4, FULL)


TOO_MUCH = {
    "loops around motions": (loops_in_loops(FULL), "at least 1[0-9]{7} statements run from here on"),
    "loops": (loops_in_loops("Z=Z+1"), None),
    "calls of what moves": (calls_in_calls(12, 4, FULL), "at least [0-9]{8} statements run from here on"),
    "calls": (calls_in_calls(12, 4, "K=K+1"), None),
    "functions": (
        body(FULL, "K=F0(1)", "LIN P[K]")
        + "".join(
            f"DEFFCT INT F{n}(X:IN)\r\nINT X\r\nX=F{n + 1}(X)\r\nX=F{n + 1}(X)\r\nRETURN (X)\r\nENDFCT\r\n"
            for n in range(19)
        )
        + "DEFFCT INT F19(X:IN)\r\nINT X\r\nRETURN (X)\r\nENDFCT\r\n",
        "K is set to .*F0.. gives is not known",
    ),
    "branches": (
        body(FULL, "FOR I=1 TO 20000", "IF $IN[1] THEN", FULL, "ENDIF", "ENDFOR"),
        "branches whose condition is not known are reached more than",
    ),
    "cases": (
        body(FULL, "FOR I=1 TO 5000", "SWITCH I", *[f"CASE {n}" for n in range(5000)], FULL, "ENDSWITCH", "ENDFOR"),
        "loops around motions are too long",
    ),
}


@pytest.mark.parametrize("what", TOO_MUCH)
def test_what_runs_too_long_is_refused_after_little_work(what, monkeypatch):
    monkeypatch.setattr("postproc.dialects.krl.read.flow.MOST_TRACED", 400_000)
    monkeypatch.setattr("postproc.dialects.krl.read.flow.MOST_STATEMENTS", 200_000)
    text, problem = TOO_MUCH[what]

    def reading():
        if problem is None:
            assert len(read(text, COUNTERS_DAT).motions) == 2
        else:
            with pytest.raises(ProgramError, match=problem):
                read(text, COUNTERS_DAT)

    assert calls(reading) < 4_000_000


def test_the_least_number_of_statements_counts_none_that_may_not_run():
    many = ["FOR I=1 TO 900", "FOR K=1 TO 900", FULL, "ENDFOR", "ENDFOR"]
    for lines in (
        ["IF K==7 THEN", *many, "ENDIF"],
        ["FOR I=1 TO 900", "I=900", "FOR K=1 TO 900", "ENDFOR", FULL, "ENDFOR"],
        ["FOR I=1 TO 900", "FOR K=1 TO 900", "IF K==2 THEN", "EXIT", "ENDIF", FULL, "ENDFOR", "ENDFOR"],
        ["FOR I=900 TO 1", *many[1:4], "ENDFOR"],
        ["SUB()"],
    ):
        sub = "DEF SUB()\r\nIF K==1 THEN\r\nRETURN\r\nENDIF\r\n" + "\r\n".join(many) + "\r\nEND\r\n"
        assert len(read(body(FULL, *lines, FULL) + sub, COUNTERS_DAT.replace("INT K=0", "INT K=1")).motions) >= 2


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        (["IF $IN[1] THEN", "GOTO A", "ENDIF", FULL], "what runs next: the condition of IF (line 5) is not known. "),
        (["LOOP", FULL, "GOTO A", "ENDLOOP"], "the label A precedes GOTO"),
    ],
)
def test_a_jump_in_kept_motions_names_the_condition_that_is_not_known(lines, why):
    with pytest.raises(ProgramError) as caught:
        read(body("A:", *lines), COUNTERS_DAT, KEEPING)
    assert why in str(caught.value)


def test_a_program_whose_motions_all_stay_in_this_run_but_not_in_the_next_is_refused():
    lines = ["DECL REAL R", "R=1", "WHILE K<1", "R=$IN[1]", "K=K+1", "ENDWHILE", "LIN {X R,Y 0,Z 300,A 10,B 20,C 170}"]
    with pytest.raises(ProgramError, match=r"R is set to a value that is not known \(line 7"):
        read(body(*lines), COUNTERS_DAT, KEEPING)


@pytest.mark.parametrize("within", [True, False])
def test_statements_that_stay_in_each_round_count_in_loops_that_do_not_end(within):
    """A kept branch of 500 statements in a loop of unknown length, around motions and in a called routine."""
    loop = [
        "WHILE OK",
        "K=K+1",
        "IF GONE()==1 THEN",
        *["Z=Z+1"] * 500,
        *([AWAY, FULL] if within else []),
        "ENDIF",
        "ENDWHILE",
    ]
    text = body(FULL, *loop) if within else body("SUB()", FULL) + "\r\n".join(["DEF SUB()", *loop, "END", ""])
    assert calls(lambda: read(text, COUNTERS_DAT, KEEPING)) < 4_000_000


ENDLESS = {
    "ends where it began": ([FULL, "LOOP", AWAY, FULL, "ENDLOOP"], 3),
    "begins at joint angles": ([FULL, "LOOP", HOME, FULL, AWAY, "ENDLOOP", FULL], 4),
    "force of its own": ([FULL, "LOOP", HOME, ";FORCE FX=9", FULL, AWAY, "ENDLOOP"], 4),
    "counts": ([FULL, "LOOP", "K=K+1", AWAY, FULL, "ENDLOOP"], 3),
    "decides on outputs": (
        [
            FULL,
            "LOOP",
            *["K=K+1", "IF K>2 THEN", "K=0", "$OUT[K+1]=TRUE", "ELSE", "$OUT[2]=FALSE", "ENDIF"],
            AWAY,
            FULL,
            "ENDLOOP",
        ],
        3,
    ),
    "waits for outputs": ([FULL, "LOOP", "WAIT FOR $OUT[2]", AWAY, "$OUT[2]=TRUE", FULL, "ENDLOOP"], 3),
    "decides on outputs by SWITCH": (
        [
            FULL,
            *[
                "LOOP",
                "K=K+1",
                "SWITCH K",
                "CASE 1,2",
                "IF OK THEN",
                "$OUT[3]=TRUE",
                "ENDIF",
                "DEFAULT",
                "K=0",
                "ENDSWITCH",
            ],
            AWAY,
            FULL,
            "ENDLOOP",
        ],
        3,
    ),
    "waits for the start key": ([FULL, "LOOP", AWAY, FULL, "IF $IN[1] THEN", "HALT", "ENDIF", "ENDLOOP"], 3),
    "counter of its own": ([FULL, "LOOP", "FOR I=1 TO 2", AWAY, FULL, "ENDFOR", "ENDLOOP"], 5),
    "speed as before": (["$VEL.CP=0.1", FULL, "LOOP", "$VEL.CP=0.1", AWAY, FULL, "ENDLOOP"], 3),
    "calls": ([FULL, "LOOP", "SUB()", FULL, "ENDLOOP"], 3),
}


@pytest.mark.parametrize("what", ENDLESS)
def test_a_loop_without_exit_is_one_round_that_repeats(what):
    lines, count = ENDLESS[what]
    program = read(body(*lines) + f"DEF SUB()\r\n{AWAY}\r\nEND\r\n", COUNTERS_DAT)
    assert len(program.motions) == count
    assert "endless-loop" in {issue.kind for issue in program.issues}
    shift = np.full((count, 3), 1e-3)  # all alike: it ends where it began
    written = krl.rewrite(program, targets(program, shift))
    text = written.documents[0].text
    assert text.count("LOOP\r\n") == 2
    again = read(text, COUNTERS_DAT)
    assert len(again.motions) == count
    moved = np.where(np.isnan(program.motions.joints[:, :1]), 1e-3, 0.0)
    assert np.allclose(again.motions.target[:, :3, 3], program.motions.target[:, :3, 3] + moved)


def test_a_loop_without_exit_whose_branches_leave_different_forces_to_the_next_round_is_refused():
    branches = ["IF $IN[1] THEN", "; FORCE FX=9", FULL, "ELSE", "; FORCE FX=3", FULL, "ENDIF", HOME]
    with pytest.raises(ProgramError, match="which force acts is not known") as caught:
        read(body(HOME, "; FORCE FX=3", "LOOP", AWAY, *branches, "ENDLOOP"), COUNTERS_DAT)
    assert caught.value.text == AWAY
    read(body(HOME, "LOOP", "; FORCE FX=3", AWAY, *branches, "ENDLOOP"), COUNTERS_DAT)


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        (
            [FULL, "LOOP", *(f"LIN {{X {name}}}\r\n{name}={name}+1" for name in "RSTUVWKIZ"), FULL, "ENDLOOP"],
            r"each one changes I, K, R, S, T, U, V, W and 1 more for the next",
        ),
        ([FULL, "LOOP", AWAY, "ENDLOOP"], "its round ends 8.000 mm from where it began"),
        ([FULL, "LOOP", "LIN_REL {Z 1}", "ENDLOOP"], "its round ends 1.000 mm from where it began"),
        ([FULL, "LOOP", "LIN {A 9}", "ENDLOOP"], "its round ends in another orientation than it began"),
        ([FULL, "LOOP", "K=K+1", "LIN {X K}", FULL, "ENDLOOP"], "each one changes K for the next"),
        ([FULL, "LOOP", AWAY, "$VEL.CP=0.1", FULL, "ENDLOOP"], "leaves other frames, speeds or modes"),
        ([FULL, "LOOP", AWAY, FULL, "$BASE={X 1,Y 2,Z 3,A 0,B 0,C 0}", "ENDLOOP"], "leaves other frames"),
        ([FULL, "LOOP", AWAY, "; FORCE FX=9", FULL, "ENDLOOP"], "ends under another force than it began with"),
        ([FULL, "LOOP", HOME, AWAY, "; FORCE FX=9", FULL, "ENDLOOP"], "ends under another force than it began with"),
        (
            # the comment that restates the force in the branch is none of the program
            [HOME, "LOOP", "IF $IN[1] THEN", AWAY, FULL, "ENDIF", HOME, "; FORCE FX=9", FULL, HOME, "ENDLOOP"],
            "ends under another force than it began with",
        ),
        ([FULL, "IF $IN[1] THEN", "LOOP", AWAY, FULL, "ENDLOOP", "ENDIF"], "LOOP never ends"),
        ([FULL, "SUB()"], "LOOP never ends"),
        ([FULL, "LOOP", "GO()", "K=2", FULL, "ENDLOOP"], "each one changes K for the next"),
        ([FULL, "LOOP", "IF $IN[1] THEN", "K=2", "ENDIF", "LIN {X K}", FULL, "ENDLOOP"], "each one changes K"),
        *(
            (
                [FULL, "LOOP", "K=K+1", "IF K>2 THEN", *lines, "ENDIF", *behind, FULL, "ENDLOOP"],
                "each one changes K for",
            )
            for lines, behind in (
                ([AWAY], []),
                (["WAIT SEC 1"], []),
                (["; FORCE FX=9", "$OUT[1]=TRUE"], []),
                (["$VEL.CP=0.1"], []),
                (["I=2"], ["LIN {X I}"]),
                (["$OUT[1]=TRUE"], ["IF $OUT[1] THEN", AWAY, "ENDIF"]),
                (["GO()"], []),
                (["FOR I=1 TO 3", "$OUT[I]=TRUE", "ENDFOR"], []),
            )
        ),
    ],
)
def test_a_loop_without_exit_whose_rounds_differ_is_refused_with_its_line(lines, problem):
    sub = f"DEF SUB()\r\nLOOP\r\n{AWAY}\r\n{FULL}\r\nENDLOOP\r\nEND\r\n"
    sub += "DEF GO()\r\nLIN {X K}\r\nEND\r\n"
    with pytest.raises(ProgramError, match=problem) as caught:
        read(body(*lines) + sub, COUNTERS_DAT)
    assert "LOOP" in caught.value.text


DEEP_OR_LONG = {
    "brackets": (["K=" + "(" * 101 + "1" + ")" * 101], "more than 100 brackets are nested"),
    "brackets of a target": (["LIN {X " + "(" * 101 + "1" + ")" * 101 + "}"], "more than 100 brackets are nested"),
    "terms": (["K=1" + "+1" * 200], "more than 200 terms"),
    "factors": (["LIN {X 1" + "*1" * 200 + "}"], "more than 200 terms"),
    "characters": (["K=1" + "+1" * 500_000], "has 1000003 characters, 10000 are allowed"),
    "structures": (["IF $IN[1] THEN"] * 101 + ["ENDIF"] * 101, "more than 100 control structures are nested"),
}


@pytest.mark.parametrize("what", DEEP_OR_LONG)
def test_what_no_robot_reads_is_refused_at_once(what):
    lines, problem = DEEP_OR_LONG[what]
    with pytest.raises(ProgramError, match=problem):
        read(body(FULL, *lines, FULL), COUNTERS_DAT)


def test_what_is_just_not_too_deep_is_read():
    lines = ["K=" + "(" * 99 + "3" + ")" * 99, *["IF K==3 THEN"] * 99, "LIN {X 1" + "+1" * 199 + "}", *["ENDIF"] * 99]
    assert numbers(read(body(FULL, *lines), COUNTERS_DAT))[-1, 0] == 200


def test_reals_that_are_too_close_to_tell_decide_no_loop():
    with pytest.raises(ProgramError, match="inside UNTIL"):
        read(body(FULL, "REPEAT", FULL, "Z=Z+0.1", "UNTIL Z>=0.3"), COUNTERS_DAT)


def test_subprograms_of_other_files_are_corrected_there(tmp_path):
    files = files_of(["cut(1)", "cut(2)"], "")
    files["cut.src"] = "&ACCESS RVP\nDEF cut(n:IN)\nDECL INT n\nLIN XP1 C_DIS\nLIN {X n,Y 1,Z 2,A 0,B 0,C 0}\nEND"
    files["cut.dat"] = "DEFDAT cut\nDECL E6POS XP1={X 3,Y 3,Z 3,A 0,B 0,C 0}\nENDDAT\n"
    program = read_job(files, tmp_path)
    assert numbers(program)[1:, 0].tolist() == [3, 1, 3, 2]
    assert program.motions.line.tolist() == [4, 5, 5, 6, 6]
    assert confirmed(program, files, tmp_path, np.random.default_rng(2)) == "accepted"
    out = krl.rewrite(program, targets(program, np.arange(15.0).reshape(5, 3) * 1e-3))
    assert [document.name for document in out.documents] == ["part.src", "part.dat", "cut.src", "cut.dat"]
    assert "GLOBAL DEF cut_2(n:IN)" in out.documents[2].text
    assert out.documents[2].text.startswith("&ACCESS RVP\nDEF cut(n:IN)\nDECL INT n\nLIN {X 6.0000,")


def test_a_global_point_of_a_corrected_file_is_known_to_the_program_that_calls_it(tmp_path):
    files = files_of(["LIN XG", "cut()", "LIN XG"], "")
    files["cut.src"] = "DEF cut()\nLIN {X 3,Y 1,Z 2,A 0,B 0,C 0}\nLIN XG\nEND\n"
    files["cut.dat"] = "DEFDAT cut PUBLIC\nDECL GLOBAL E6POS XG={X 8,Y 3,Z 3,A 0,B 0,C 0}\nENDDAT\n"
    program = read_job(files, tmp_path)
    assert numbers(program)[1:, 0].tolist() == [8, 3, 8, 8]
    assert confirmed(program, files, tmp_path, np.random.default_rng(2)) == "accepted"


def test_a_subprogram_of_another_file_may_begin_with_a_loop(tmp_path):
    files = files_of(["cut()"], "")
    files["cut.src"] = "DEF cut()\nFOR I=1 TO 2\nLIN {X 3,Y I,Z 2,A 0,B 0,C 0}\nENDFOR\nEND\n"
    files["cut.dat"] = "DEFDAT cut\nDECL INT I=1\nENDDAT\n"
    program = read_job(files, tmp_path)
    assert numbers(program)[1:, 1].tolist() == [1, 2]
    assert confirmed(program, files, tmp_path, np.random.default_rng(2)) == "accepted"


def test_other_programs_that_call_a_corrected_file_are_named_and_their_names_not_taken(tmp_path):
    files = files_of(["cut()", "cut()"], "")
    files["cut.src"] = "DEF cut()\nLIN {X 3,Y 1,Z 2,A 0,B 0,C 0}\nEND\n"
    files["cut_2.src"] = "DEF cut_2()\n; cut()\nEND\n"
    files["next.src"] = "DEF next()\nCUT ( )\nEND\n"
    program = read_job(files, tmp_path)
    out = krl.rewrite(program, targets(program, np.arange(9.0).reshape(3, 3) * 1e-3))
    assert "GLOBAL DEF cut_3()" in out.documents[2].text
    [told] = [issue for issue in out.issues if issue.kind == "shared-file"]
    assert "next.src of its folders calls it too" in told.message
    assert told.subject == "cut.src, next.src"


# --- branches chosen at run time --------------------------------------------------------------------------------------

MEET = "LIN {X 9,Y 9,Z 9,A 0,B 0,C 0}"
BRANCHES = [
    # lines, at the end of which motion each begins
    (["IF $IN[1] THEN", "LIN P[1]", MEET, "ELSE", "LIN P[2]", MEET, "ENDIF", "LIN P[3]"], [-1, 0, 1, 0, 3, 2]),
    (["IF $IN[1] THEN", "LIN P[1]", FULL, "ENDIF", "LIN P[3]"], [-1, 0, 1, 0]),
    (["SWITCH $ANIN[1]", "CASE 1", "LIN P[1]", MEET, "DEFAULT", MEET, "ENDSWITCH", "LIN P[3]"], [-1, 0, 1, 0, 2]),
    (
        ["IF $IN[1] THEN", "IF $IN[2] THEN", "LIN P[4]", MEET, "ELSE", MEET, "ENDIF", "ELSE", MEET, "ENDIF", "LIN Q"],
        [-1, 0, 1, 0, 0, 2],
    ),
    (["FOR I=1 TO 2", "IF $IN[1] THEN", "LIN P[I]", MEET, "ELSE", MEET, "ENDIF", "ENDFOR"], [-1, 0, 1, 0, 2, 4, 2]),
]


@pytest.mark.parametrize(("lines", "after"), BRANCHES, ids=[" / ".join(lines)[:60] for lines, _ in BRANCHES])
def test_each_branch_is_corrected_from_where_they_divide_to_where_they_meet(lines, after):
    program = read(body(FULL, *lines), COUNTERS_DAT)
    assert program.after.tolist() == after
    starts = starts_of(program, program.motions.target.__getitem__, forward(CELL.start_joints))
    for row, before in enumerate(after[1:], 1):
        np.testing.assert_allclose(starts.at(np.array([row]))[0], program.motions.target[before], atol=1e-12)
    out = krl.rewrite(program, targets(program, np.full((len(program.motions), 3), 1e-3)))
    again = krl.read_program(out.documents, CELL, forward, "part")
    assert again.after.tolist() == after
    moved = again.motions.target[:, :3, 3] - program.motions.target[:, :3, 3]
    np.testing.assert_allclose(moved, 1e-3, atol=1e-7)
    assert krl.rewrite(program, targets(program, keep=True)).documents == program.documents


REFUSED = [
    (["IF $IN[1] THEN", "LIN P[1]", "ELSE", "LIN P[2]", "ENDIF", "LIN P[3]"], 5, "end in different places"),
    (["IF $IN[1] THEN", "LIN {X 5}", FULL, "ENDIF", "LIN {X 3}"], 5, "components are missing"),
    (["IF $IN[1] THEN", "PTP P[1]", FULL, "ENDIF", "LIN P[2]"], 5, "PTP to X, Y, Z without S and T is inside a branch"),
    (["IF $IN[1] THEN", "I=3", MEET, "ELSE", "I=2", MEET, "ENDIF", "LIN P[I]"], 12, "I is changed"),
    (["IF $IN[1] THEN", "$VEL.CP=0.3", MEET, "ELSE", MEET, "ENDIF", "LIN P[1]"], 10, "differs behind the branches"),
]


@pytest.mark.parametrize(("lines", "line", "problem"), REFUSED, ids=[problem for *_, problem in REFUSED])
def test_branches_that_do_not_meet_are_refused_or_kept(lines, line, problem):
    text = body(FULL, *lines)
    with pytest.raises(ProgramError, match=problem) as caught:
        read(text, COUNTERS_DAT)
    assert caught.value.line == line
    assert "unresolved" in [issue.kind for issue in read(text, COUNTERS_DAT, KEEPING).issues]


# --- GOTO ------------------------------------------------------------------------------------------------------------

JUMPS = [
    (["GOTO A", "LIN P[1]", "A:", "LIN P[2]"], [8]),
    (["LIN P[1]", "IF I>5 THEN", "GOTO A", "ENDIF", "LIN P[2]", "A:", "LIN P[3]"], [5, 9, 11]),
    (["IF I==1 THEN", "LIN P[3]", "goto ende ; on", "LIN P[4]", "ENDIF", "LIN P[5]", "Ende :", "LIN {X 9}"], [6, 12]),
    (["IF TRUE THEN", "GOTO A", "LIN P[1]", "A:", "LIN P[2]", "ENDIF"], [9]),
    (["SWITCH I", "CASE 1", "GOTO A", "DEFAULT", "LIN P[2]", "ENDSWITCH", "LIN P[3]", "A:", "LIN P[4]"], [13]),
    (["I=2", "IF I<3 THEN", "GOTO B", "ENDIF", "I=9", "A:", "LIN P[1]", "B:", "LIN P[I]"], [13]),
    (["GOTO A", "A:", "$OUT[1]=TRUE", "GOTO B", "LIN P[1]", "B:", "LIN P[1]"], [11]),
]


@pytest.mark.parametrize(("lines", "moves"), JUMPS, ids=[" / ".join(lines)[:60] for lines, _ in JUMPS])
def test_goto_leads_to_a_label_behind_it_and_what_is_between_stays_as_it_is(lines, moves):
    text = body(FULL, *lines)
    program = read(text, COUNTERS_DAT)
    assert program.motions.line.tolist() == [4, *moves]
    wanted = targets(program, np.full((len(program.motions), 3), 1e-3))
    out = krl.rewrite(program, wanted)
    check_commands(program, wanted, out)
    old, new = text.split("\r\n"), out.documents[0].text.split("\r\n")
    assert {n for n, (a, b) in enumerate(zip(old, new, strict=True), 1) if a != b} <= {4, *moves}
    assert krl.rewrite(program, targets(program, keep=True)).documents == program.documents


@pytest.mark.parametrize("cell", [CELL, KEEPING])
@pytest.mark.parametrize("fork", [[], ["IF $IN[1] THEN", AWAY, "ELSE", FULL, AWAY, "ENDIF"]])
def test_nothing_runs_behind_exit_in_a_branch_without_motions(fork, cell):
    """Branches at an input, and --keep-unresolved, let the statements run once more along the complete trace."""
    left = ["IF I>1 THEN", "IF I==2 THEN", "EXIT", "ENDIF", "$BASE={X 50,Y 0,Z 0,A 0,B 0,C 0}", "ENDIF"]
    program = read(body(*fork, "FOR I=1 TO 3", "LIN P[I]", *left, "ENDFOR", FULL), COUNTERS_DAT, cell)
    assert numbers(program)[-3:, 0].tolist() == [1, 2, 0]
    assert not program.motions.base.any()


# --- what only the running robot knows ------------------------------------------------------------------------------

UNKNOWN = [
    # lines, those that stay, those that begin where it is not known
    (["LIN $POS_ACT:{Z 5}", "LIN {X 9,Y 9,Z 9,A 0,B 0,C 0}"], [5], [6]),
    (["Q=$POS_ACT", "Q.Z=Q.Z+5", "LIN Q", "LIN P[1]"], [7], [8]),
    (["LIN $POS_ACT:{Z 5}", "LIN {Z 9}", "LIN_REL {X 1}", "LIN P[1]", "LIN {X 3}"], [5, 6, 7], [8]),
    (["IF $IN[1] THEN", "LIN P[1]", "LIN {X 1,Y 1,Z 1,A 0,B 0,C 0}", "ENDIF", "LIN P[2]"], [6, 7], [9]),
    (["WHILE $IN[1]", "LIN P[1]", "ENDWHILE", "PTP P[2]", "LIN P[3]"], [6], [8]),
    (["Z=$ANIN[1]", "LIN {X 1,Y 1,Z Z,A 0,B 0,C 0}", "LIN P[2]"], [6], [7]),
    (["FOR I=1 TO 3", "LIN P[I]", "IF $IN[I] THEN", "EXIT", "ENDIF", "ENDFOR", "LIN P[4]"], [6], [11]),
    (["SUB(3)", "LIN P[4]"], [5], [6]),
    (["$BASE=$POS_ACT", "LIN P[4]", "$BASE={X 5,Y 0,Z 0,A 0,B 0,C 0}", "LIN P[4]"], [6], [8]),
]
LOST = "DEF SUB(n:IN)\r\nDECL INT n\r\nIF $IN[n] THEN\r\nRETURN\r\nENDIF\r\nLIN P[5]\r\nEND\r\n"


@pytest.mark.parametrize(("lines", "kept", "begins"), UNKNOWN, ids=[" / ".join(lines)[:60] for lines, *_ in UNKNOWN])
def test_what_only_the_running_robot_knows_is_refused_or_kept_as_it_is(lines, kept, begins):
    text = body(FULL, *lines) + (LOST if "SUB" in lines[0] else "")
    with pytest.raises(ProgramError):
        read(text, COUNTERS_DAT)
    program = read(text, COUNTERS_DAT, KEEPING)
    told = [issue.source_line for issue in program.issues if issue.kind == "unresolved"]
    assert told == kept
    assert [issue.lines for issue in program.issues if issue.kind == "start-unknown"] == [tuple(begins)]
    assert not set(kept) & set(program.motions.line.tolist())
    rows = np.searchsorted(program.motions.line, begins)
    assert program.after[rows].tolist() == rows.tolist()
    shift = np.full((len(program.motions), 3), 1e-3)
    out = krl.rewrite(program, targets(program, shift))
    old, new = text.split("\r\n"), out.documents[0].text.split("\r\n")
    assert [new[line - 1] for line in kept] == [old[line - 1] for line in kept]
    again = krl.read_program(out.documents, KEEPING, forward, "part")
    moved = again.motions.target[:, :3, 3] - program.motions.target[:, :3, 3]
    np.testing.assert_allclose(moved, 1e-3, atol=1e-7)
    assert krl.rewrite(program, targets(program, keep=True)).documents == program.documents


@pytest.mark.parametrize("lines", [["LIN $POS_ACT:{Z 5}"], ["IF $IN[1] THEN", "LIN P[1]", "ENDIF", FULL]])
def test_the_error_names_the_option_that_keeps_what_is_not_known(lines):
    with pytest.raises(ProgramError, match="--keep-unresolved") as caught:
        read(body(FULL, *lines), COUNTERS_DAT)
    assert caught.value.line == 5


def test_a_point_of_a_motion_that_is_kept_is_not_changed_for_it():
    text = body(FULL, "LIN P[1]", "WHILE $IN[1]", "LIN P[1]", "ENDWHILE", "LIN P[2]")
    program = read(text, COUNTERS_DAT, KEEPING)
    out = krl.rewrite(program, targets(program, np.full((3, 3), 1e-3)))
    assert "P[1]={X 1,Y 2,Z 3,A 4,B 5,C 6}" in out.documents[1].text
    assert "LIN {X 2.0000," in out.documents[0].text


def test_a_subprogram_that_also_runs_as_it_stands_is_corrected_in_a_copy():
    program = read(body(FULL, "SUB(1)", "WHILE $IN[1]", "SUB(2)", "ENDWHILE") + STILL, COUNTERS_DAT, KEEPING)
    text = krl.rewrite(program, targets(program, np.full((2, 3), 1e-3))).documents[0].text
    assert "SUB_2(1)\r\nWHILE $IN[1]\r\nSUB(2)\r\n" in text
    assert STILL in text


def test_a_point_of_a_subprogram_that_also_runs_as_it_stands_is_not_changed_for_its_copy():
    sub = "DEF SUB()\r\nLIN Q\r\nEND\r\n"
    program = read(body(FULL, "IF $IN[1] THEN", "SUB()", "ENDIF", FULL, "SUB()") + sub, COUNTERS_DAT, KEEPING)
    source, data = krl.rewrite(program, targets(program, np.full((3, 3), 1e-3))).documents
    assert "DECL E6POS Q={X 50,Y 5,Z 5,A 1,B 2,C 3}" in data.text
    assert "DECL E6POS Q_2={X 51.0000," in data.text
    assert sub in source.text
    assert "LIN Q_2" in source.text


# --- force comments hold in the order in which lines run --------------------------------------------------------------

ONE, TWO, THREE = (f"; FORCE FX={n}" for n in (1, 2, 3))
HARD = f"DEF HARD()\r\n{THREE}\r\nEND\r\n"
MOVING = f"DEF HARD()\r\n{THREE}\r\n{FULL}\r\nEND\r\n"
HELD = [
    # lines, subprograms, force on the motions
    ([ONE, FULL, "HARD()", FULL], HARD, [0, 1, 3]),
    ([ONE, "IF OK THEN", TWO, "ELSE", THREE, "ENDIF", FULL], "", [0, 2]),
    ([ONE, "IF NOT OK THEN", TWO, "ENDIF", FULL], "", [0, 1]),
    ([ONE, "FOR I=2 TO 1", TWO, "ENDFOR", FULL], "", [0, 1]),
    ([ONE, "FOR I=1 TO 2", FULL, TWO, "ENDFOR", FULL], "", [0, 1, 2, 2]),
    ([ONE, "FOR I=1 TO 2", "IF I==2 THEN", "HARD()", "ENDIF", FULL, "ENDFOR"], HARD, [0, 1, 3]),
    ([ONE, FULL, "IF $IN[1] THEN", TWO, FULL, ONE, FULL, "ELSE", FULL, "ENDIF", FULL], "", [0, 1, 2, 1, 1, 1]),
    ([ONE, FULL, "IF $IN[1] THEN", TWO, FULL, ONE, FULL, "ENDIF", FULL], "", [0, 1, 2, 1, 1]),
    (["IF $IN[1] THEN", TWO, FULL, "HARD()", "ELSE", TWO, FULL, "ENDIF", ONE, FULL], HARD, [0, 2, 2, 1]),
    ([ONE, "IF $IN[1] THEN", THREE, FULL, "ELSE", "HARD()", FULL, "ENDIF", FULL], HARD, [0, 3, 3, 3]),
    (
        [ONE, FULL, "IF $IN[1] THEN", "IF $IN[2] THEN", TWO, FULL, ONE, FULL, "ENDIF", "ENDIF", FULL],
        "",
        [0, 1, 2, 1, 1],
    ),
]


@pytest.mark.parametrize(("lines", "subprograms", "forces"), HELD, ids=[" / ".join(lines)[:60] for lines, *_ in HELD])
def test_a_force_comment_holds_from_where_it_runs(lines, subprograms, forces):
    program = read(body(FULL, *lines) + subprograms, COUNTERS_DAT)
    held = [0.0] * len(program.motions)
    for note in program.notes:
        held[note.before :] = [note.wrench[0]] * len(held[note.before :])
    assert held == forces
    assert krl.rewrite(program, targets(program, keep=True)).documents == program.documents


UNHELD = [
    (["IF $IN[1] THEN", TWO, "ENDIF", FULL], "", CELL, 8, "branches that meet before it leave different ones"),
    ([ONE, "IF $IN[1] THEN", FULL, TWO, "ELSE", FULL, "ENDIF", "PTP Q", FULL], "", CELL, 13, "leave different ones"),
    (
        [ONE, "IF $IN[1] THEN", TWO, FULL, ONE, "ELSE", FULL, "ENDIF", FULL],
        "",
        CELL,
        12,
        "corrected, they would not meet",
    ),
    (["PTP Q", ONE, "IF $IN[1] THEN", FULL, "LIN Q", "ENDIF", FULL], "", CELL, 10, "corrected, they would not meet"),
    (["IF $IN[1] THEN", "IF $IN[2] THEN", TWO, "ENDIF", FULL, "ENDIF"], "", CELL, 9, "leave different ones"),
    (["WHILE $IN[1]", TWO, "ENDWHILE", FULL], "", CELL, 5, "force comment is inside WHILE"),
    (["WHILE $IN[1]", "HARD()", "ENDWHILE", FULL], HARD, CELL, 5, "inside WHILE: its condition is not known"),
    (["IF $IN[1] THEN", TWO, "ENDIF", FULL], "", KEEPING, 8, "which force acts is not known: branches"),
    (["WHILE $IN[1]", TWO, FULL, "ENDWHILE", FULL], "", KEEPING, 9, r"not known: a force comment .*line 6"),
    (
        ["WHILE $IN[1]", "HARD()", "ENDWHILE", FULL],
        MOVING,
        KEEPING,
        8,
        "not known: HARD is called, which holds a force",
    ),
]


@pytest.mark.parametrize(("lines", "subs", "cell", "line", "problem"), UNHELD, ids=[p for *_, p in UNHELD])
def test_a_motion_under_a_force_that_is_not_known_is_refused(lines, subs, cell, line, problem):
    with pytest.raises(ProgramError, match=problem) as caught:
        read(body(FULL, *lines) + subs, COUNTERS_DAT, cell)
    assert caught.value.line == line


def test_branches_that_end_under_different_forces_stay_as_they_are_if_they_may():
    lines = [ONE, "IF $IN[1] THEN", TWO, FULL, "ELSE", FULL, "ENDIF", ONE, FULL]
    with pytest.raises(ProgramError, match="they would not meet"):
        read(body(FULL, *lines), COUNTERS_DAT)
    program = read(body(FULL, *lines), COUNTERS_DAT, KEEPING)
    assert [issue.source_line for issue in program.issues if issue.kind == "unresolved"] == [8, 10]
    assert program.motions.line.tolist() == [4, 13]


@pytest.mark.parametrize(
    ("lines", "word"),
    [
        (["FOR I=1 TO 2 ; FORCE FX=9", FULL, "ENDFOR"], "FOR"),
        (["FOR I=1 TO 2", FULL, "ENDFOR ; FORCE FX=9", FULL], "ENDFOR"),
        (["REPEAT", FULL, "I=I+1", "UNTIL I>3 ; FORCE FX=9", FULL], "UNTIL"),
        (["WHILE I<3 ; FORCE FX=9", FULL, "I=I+1", "ENDWHILE"], "WHILE"),
        ([FULL, "LOOP ; FORCE FX=9", AWAY, FULL, "ENDLOOP"], "LOOP"),
    ],
)
def test_a_force_comment_on_the_line_of_a_loop_is_refused(lines, word):
    with pytest.raises(ProgramError, match=rf"a force comment is on the line of {word}\."):
        read(body(*lines), COUNTERS_DAT)


def test_a_for_that_counts_by_a_real_is_refused_with_the_name_of_its_counter():
    with pytest.raises(ProgramError, match="its counter Z is a REAL"):
        read(body("FOR Z=1 TO 2", FULL, "ENDFOR"), COUNTERS_DAT)


def test_rows_of_one_line_have_equal_keys_if_they_are_written_alike():
    program = read(body("FOR I=1 TO 3", FULL, "ENDFOR", "LIN P[I]"), COUNTERS_DAT)
    trace, edits = program.layout.execution.trace, Replacements()
    rows = program.layout.trace_row[:3].tolist()
    assert len(set(trace.starts(np.array(rows)).tolist())) == 1
    begin, same = trace.starts(program.layout.trace_row[2:4]).tolist()
    for row, text in zip(rows, ("1", "2", "1"), strict=True):
        start = begin + FULL.index("X 0") + 2
        edits.add(start, start + 1, text, row)
    edits.add(same, same + 3, "LIN", program.layout.trace_row.item(3))  # what is there
    edits.add(begin, begin, "HALT\r\n", rows[1])
    edited = edited_rows(trace, edits)
    assert edited.rows.tolist() == rows
    assert edited.texts == tuple(f"{before}{FULL.replace('X 0', f'X {x}')}\r\n" for before, x in
                                 (("", 1), ("HALT\r\n", 2), ("", 1)))  # fmt: skip
    keys = [edited.text_numbers[row - 1] for row in rows]
    assert keys[0] == keys[2] != keys[1]
    assert np.count_nonzero(edited.text_numbers) == 3
    assert np.diff(edited.begins)[np.array(rows) - 1].tolist() == [1, 2, 1]


def test_behind_what_is_kept_a_comment_says_which_force_acts():
    program = read(body(FULL, "WHILE $IN[1]", TWO, FULL, "ENDWHILE", "PTP Q", THREE, FULL), COUNTERS_DAT, KEEPING)
    assert [(note.before, note.wrench[0]) for note in program.notes] == [(2, 3.0)]
    assert program.motions.line.tolist() == [4, 9, 11]


def test_a_called_file_that_cannot_be_followed_is_an_error_in_the_line_of_its_call(tmp_path):
    cut = "DEF cut()\nINTERRUPT DECL 4 WHEN $IN[1] DO BAS(#VEL_CP,0.8)\n"
    files = files_of(["IF $IN[1] THEN", MEET, "ELSE", "cut()", "ENDIF", MEET], "")
    files["cut.src"] = cut + "INTERRUPT ON 4\nLIN {X 3,Y 1,Z 2,A 0,B 0,C 0}\nEND\n"
    with pytest.raises(ProgramError, match="CUT changes what motions depend on at any time") as caught:
        read_job(files, tmp_path)
    assert caught.value.line == 8
    assert caught.value.problem.endswith("$VEL (cut.src, line 2)")


ALIASED = "DEF SUB(r)\r\nREAL r\r\nr=3\r\n{}\r\nEND\r\n"
LINE_TO = "LIN {{X {},Y 1,Z 2,A 0,B 0,C 0}}"


@pytest.mark.parametrize("condition", ["NOT I==1", "OK==TRUE AND I==1", "I==1==OK", "OK AND (NOT I==1)"])
def test_a_condition_that_depends_on_the_rank_of_its_operators_is_refused(condition):
    with pytest.raises(ProgramError, match="whose condition is not known"):
        read(body(FULL, f"IF {condition} THEN", AWAY, "ENDIF", FULL), COUNTERS_DAT)


NESTED = "".join(f"DEF D{n}()\r\nD{n + 1}()\r\nEND\r\n" for n in range(25)) + f"DEF D25()\r\n{AWAY}\r\nEND\r\n"


@pytest.mark.parametrize(
    ("call", "subs", "why"),
    [
        ("SUB(1,2)", SUB, "it takes 1 arguments, 2 are given"),
        ("SUB(P[])", f"DEF SUB(A:OUT)\r\nDECL E6POS A\r\n{AWAY}\r\nEND\r\n", r"P\[\] is a whole array"),
        ("D0()", NESTED, "more than 20 calls are within each other"),
        ("SUB()", f"DEF SUB()\r\nGOTO A\r\n{AWAY}\r\nA:\r\nEND\r\n", r"it jumps \(line 9\)"),
        ("SUB(K,K)", f"DEF SUB(a:OUT,b:OUT)\r\nDECL INT a,b\r\n{AWAY}\r\nEND\r\n", "K has two names in it"),
    ],
)
def test_a_call_that_cannot_be_followed_is_refused_with_its_cause(call, subs, why):
    with pytest.raises(ProgramError, match=f"in a way that cannot be followed: {why}"):
        read(body(FULL, call, FULL) + subs, COUNTERS_DAT)


def test_a_variable_that_a_routine_also_knows_under_its_own_name_is_not_followed_under_two():
    deep = f"DEF DEEP()\r\n{LINE_TO.format('Z')}\r\nEND\r\n"
    for sub in (ALIASED.format(LINE_TO.format("Z")), ALIASED.format("DEEP()") + deep):
        with pytest.raises(ProgramError, match="cannot be followed: Z has two names in it"):
            read(body(FULL, "SUB(Z)") + sub, COUNTERS_DAT)
    with pytest.raises(ProgramError, match="K is changed"):
        read(body(FULL, "SUB(Z)", "LIN P[K]") + ALIASED.format("K=Z"), COUNTERS_DAT)
    for inside in ("r", "r+1-1"):
        program = read(body(FULL, "SUB(Z)", LINE_TO.format("Z")) + ALIASED.format(LINE_TO.format(inside)), COUNTERS_DAT)
        assert numbers(program)[:, 0].tolist() == [0, 3, 3]


@pytest.mark.parametrize("statement", ["DIGIN ON I=1.0*$DIGIN1+0", "INTERRUPT DECL 4 WHEN $IN[1] DO I=3"])
def test_a_variable_that_changes_at_any_time_does_so_under_the_name_of_a_parameter_too(statement):
    sub = "DEF SUB(n)\r\nDECL INT n\r\nFOR n=1 TO 2\r\nLIN P[n]\r\nENDFOR\r\nEND\r\n"
    assert len(read(body(FULL, "SUB(I)") + sub, COUNTERS_DAT).motions) == 3
    with pytest.raises(ProgramError, match="its bounds are not known"):
        read(body(FULL, statement, "SUB(I)") + sub, COUNTERS_DAT)
    two = "DEF TWO(n,r)\r\nINT n\r\nREAL r\r\nr=n\r\nK=2\r\nEND\r\n"
    lines = [FULL, statement, "Z=5", "TWO(I,Z)", "LIN P[K]"]
    assert len(read(body(*lines) + two, COUNTERS_DAT).motions) == 2
    with pytest.raises(ProgramError, match="component X is not a number"):
        read(body(*lines, LINE_TO.format("Z")) + two, COUNTERS_DAT)


@pytest.mark.parametrize("action", ["Z=3", "SUB(Z)", "GONE(Z)"])
def test_an_action_changes_variables_of_the_routine_that_declares_it(action):
    lines = ["DECL REAL Z", FULL, "Z=2", f"TRIGGER WHEN DISTANCE=0 DELAY=0 DO {action}", FULL]
    with pytest.raises(ProgramError, match="component X is not a number"):
        read(body(*lines, LINE_TO.format("Z")) + ALIASED.format(""))
    assert len(read(body(*lines, FULL) + ALIASED.format("")).motions) == 3


def test_a_global_point_is_corrected_by_numbers_where_another_file_uses_it(tmp_path):
    files = files_of(["cut()", "LIN XG", "LIN XG"], "")
    files["part.dat"] = COUNTERS_DAT.replace("ENDDAT", "DECL GLOBAL E6POS XG={X 8,Y 3,Z 3,A 0,B 0,C 0}\r\nENDDAT")
    files["cut.src"] = "DEF cut()\nLIN XG\nEND\n"
    program = read_job(files, tmp_path)
    out = krl.rewrite(program, targets(program, np.arange(12.0).reshape(4, 3) * 1e-3))
    text = {document.name: document.text for document in out.documents}
    assert "LIN {X 11.0000," in text["cut.src"]
    assert "LIN XG_2" in text["part.src"]


ROUNDS = ["FOR I=1 TO 100", "LIN {X 1}", "ENDFOR"]
"""Lines before those of a test: a hundred rounds, so that lines of the file are not lines of the execution trace."""


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        (["IF $IN[1] THEN", "$BASE={X 1,Y 1,Z 1,A 0,B 0,C 0}", "ENDIF", FULL], "changed inside IF (line 8)"),
        (["SPLINE", "SLIN {X 3}", "SPLINE", "SLIN {X 4}", "ENDSPLINE"], "inside of a spline block (line 8)"),
        (["RSI_ON( )", FULL], "the path is not known. Text: 'RSI_ON( )'"),
    ],
)
def test_messages_behind_a_loop_name_lines_of_the_file(lines, problem):
    with pytest.raises(ProgramError) as caught:
        read(body(FULL, *ROUNDS, *lines), COUNTERS_DAT)
    assert problem in str(caught.value)


def test_motions_that_stay_behind_a_loop_name_lines_of_the_file():
    lines = ["WHILE $IN[1]", "LIN {X 3}", "FOR I=1 TO 2", "LIN {X Q.X*I}", "ENDFOR", "ENDWHILE"]
    program = read(body(FULL, *ROUNDS, *lines), COUNTERS_DAT, KEEPING)
    assert [stays.why for stays in program.unresolved if stays.line == 11] == ["motion inside FOR (line 10)"]


def test_an_uncalled_routine_of_a_program_with_a_loop_is_reported():
    program = read(body(FULL, *ROUNDS) + "DEF OTHER( )\r\nLIN {X 5}\r\nEND\r\n", COUNTERS_DAT)
    (issue,) = [issue for issue in program.issues if issue.kind == "uncalled-motions"]
    assert (issue.source_line, issue.subject) == (10, "OTHER")


@pytest.mark.parametrize("lines", [["LIN P[1]"], ["SUB(4)"], ["FOR I=1 TO 3", "LIN P[I]", "ENDFOR"]])
def test_motions_behind_a_return_are_left_as_they_are_and_reported(lines):
    """Whether the program calls routines or has loops makes no difference."""
    dead_lines = [FULL, "LIN P[2]"]
    program = read(body(FULL, *lines, "RETURN", *dead_lines) + SUB, COUNTERS_DAT)
    (issue,) = [issue for issue in program.issues if issue.kind == "never-reached"]
    assert (issue.source_line, issue.count) == (6 + len(lines), 2)
    assert f"RETURN (line {5 + len(lines)})" in issue.message
    written_lines = krl.rewrite(program, targets(program, np.full((len(program.motions), 3), 1e-3))).documents[0].text
    assert "\r\n".join(["RETURN", *dead_lines, "END"]) in written_lines


def test_a_motion_in_front_of_a_return_in_a_loop_is_reached():
    lines = ["FOR I=1 TO 3", "IF I==2 THEN", "RETURN", "ENDIF", "LIN P[I]", "ENDFOR"]
    assert "never-reached" not in {issue.kind for issue in read(body(FULL, *lines), COUNTERS_DAT).issues}


HIGH = "PTP {A1 40,A2 -80,A3 95,A4 0,A5 45,A6 0}"
TURNED = "PTP {X 9,Y 20,Z 30,A 10,B 20,C 170,S 2,T 10}"
FIRST, SECOND = ([f"IF $IN[{n}] THEN", TURNED_HOME, f"LIN P[{n}]"] for n in (1, 2))
SELECTED = {
    "jobs that end at home": [*FIRST, TURNED_HOME, "ENDIF", *SECOND, TURNED_HOME, "ENDIF", TURNED_HOME],
    "jobs that end elsewhere": [*FIRST, "ENDIF", *SECOND, "ENDIF", TURNED_HOME, "LIN P[2]"],
    "jobs within jobs": [*FIRST, "ELSE", *SECOND, "ENDIF", "ENDIF", TURNED_HOME, "LIN P[2]"],
    "a switch": [
        "SWITCH $ANIN[1]",
        "CASE 1",
        *FIRST[1:],
        "CASE 2",
        *SECOND[1:],
        "DEFAULT",
        TURNED_HOME,
        "ENDSWITCH",
        TURNED_HOME,
    ],
    "a detour by joint angles": [TURNED_HOME, "IF $IN[1] THEN", HIGH, TURNED_HOME, "ENDIF", "LIN P[1]"],
    "home before the end": ["IF $IN[1] THEN", TURNED_HOME, "ENDIF", TURNED_HOME, "LIN P[2]"],
    "rounds": ["FOR I=1 TO 2", "IF $IN[1] THEN", TURNED_HOME, "LIN P[I]", "ENDIF", TURNED_HOME, "ENDFOR", "LIN P[1]"],
    "a PTP with S and T": [FULL, "IF $IN[1] THEN", TURNED, FULL, "ENDIF", "LIN P[1]"],
}


@pytest.mark.parametrize("lines", SELECTED.values(), ids=SELECTED)
def test_branches_by_joint_angles_are_what_a_controller_makes_of_them(tmp_path, lines):
    files = {"part.src": body(FULL, *lines, end="\n"), "part.dat": COUNTERS_DAT}
    program = read_job(files, tmp_path)
    assert confirmed(program, files, tmp_path, np.random.default_rng(0)) == "branches"


@pytest.mark.parametrize(
    "lines",
    [
        ["IF $IN[1] THEN", TURNED_HOME, "LIN P[1]", "ENDIF", "LIN P[2]", TURNED_HOME],
        ["IF $IN[1] THEN", "IF $IN[2] THEN", TURNED_HOME, "ENDIF", "LIN P[1]", TURNED_HOME, "ENDIF", TURNED_HOME],
        ["IF $IN[1] THEN", TURNED_HOME, "ENDIF", "IF $IN[2] THEN", "LIN P[1]", "ENDIF", TURNED_HOME],
        ["LOOP", FULL, "IF $IN[1] THEN", TURNED_HOME, "ENDIF", "ENDLOOP"],
    ],
)
def test_a_line_that_begins_in_one_of_two_places_is_refused(lines):
    with pytest.raises(ProgramError, match="end in different places"):
        read(body(FULL, *lines), COUNTERS_DAT)


def test_the_trace_has_no_text_but_that_of_the_files():
    lines = ["FOR I=1 TO 5", "Z=I", "TRIGGER WHEN PATH=1 DELAY=0 DO $OUT[1]=TRUE", "LIN {X Z,Y 1}", "SUB(I)"]
    lines += ["IF I>2 THEN", "K=I", "ELSE", "K=0", "ENDIF", "ENDFOR"]
    program = read(body(FULL, *lines) + SUB, COUNTERS_DAT)
    execution = program.layout.execution
    assert len(program.motions) == 11
    assert len(execution.trace) > 50
    assert execution.trace.sources == (execution.main.source,)
    assert execution.trace.line.max() <= len(execution.main.source.starts)
    starts = [execution.main.source.starts[line - 1] for line in execution.trace.line[program.layout.trace_row - 1]]
    assert program.layout.keyword.tolist() == starts


@pytest.mark.parametrize("literal", ["{X 4,Y 5,Z 6,A 1,B 2,C 3}", "{E6POS: X 4, Y 5, Z 6, A 1, B 2, C 3, S 2, T 10}"])
def test_a_point_that_a_call_gives_is_corrected_in_the_call(literal):
    """Its numbers are in another line than its motion, and at another place in the trace than in the file."""
    lines = ["FOR I=1 TO 2", f"GO({literal})", "ENDFOR", f"  GO({literal}) ; last"]
    text = body(FULL, *lines) + "DEF GO(P:IN)\r\nDECL E6POS P\r\nLIN P\r\nEND\r\n"
    program = read(text, COUNTERS_DAT)
    shift = np.zeros((len(program.motions), 3))
    shift[1:] = 1e-3
    wanted = targets(program, shift)
    written = krl.rewrite(program, wanted)
    check_commands(program, wanted, written)
    assert "FOR I=1 TO 2" in written.documents[0].text
    assert written.documents[0].text.count("5.0000") == 2


CIRCLES = "DEF SUB(n:IN)\r\nDECL INT n\r\n$VEL.CP=0.2 ; slow\r\n"
CIRCLES += "CIRC {X 5,Y 5,Z 300},{X 0,Y 9,Z 300,A 10,B 20,C 170} C_DIS\r\n"
CIRCLES += "  lin {x 7, y 1, z 2, a 0, b 0, c 0, s 2, t 10} c_dis ; x\r\n$APO.CDIS=2\r\n"
CIRCLES += "PTP {X 8,Y 1,Z 2,A 0,B 0,C 0}\r\nEND\r\n"


@pytest.mark.parametrize(
    ("lines", "subs"),
    [
        *((lines, subs) for lines, subs, _ in PROGRAMS),
        (["FOR I=1 TO 3", "SUB(I)", "$VEL.CP=0.1", FULL, "ENDFOR", AWAY, "SUB(2)"], CIRCLES),
        (["$VEL.CP=0.3", "SUB(1)", "IF $IN[1] THEN", FULL, "ELSE", "SUB(1)", FULL, "ENDIF"], STILL),
    ],
)
@pytest.mark.parametrize("end", ["\r\n", "\n"])
def test_plain_lines_of_a_trace_are_those_that_a_scan_of_it_finds(lines, subs, end, monkeypatch):
    def compared(trace, known, *, bulk):
        lines = [line_text(*trace.place(row)) for row in range(1, len(trace) + 1)]
        text = Source.of(Document("trace.src", "".join(lines)), 0)
        found, scanned = plain_rows_of_trace(trace, known, bulk=bulk), plain_lines_of(text)
        motions = merged_motions([*scanned.motions], np.arange(sum(map(len, scanned.motions))))
        later = text.starts[motions.trace_row - 1] - trace.starts(motions.trace_row)
        for name, ours, theirs in zip(
            motions.__struct_fields__, found.motions[0].columns(), motions.columns(), strict=True
        ):
            if name in ("keyword", "target", "tail", "via_target", "via_spans"):
                moved = ours + later.reshape(-1, *[1] * (ours.ndim - 1))
                ours = np.where(ours < 0, ours, moved)
            np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_array_equal(found.settings.line, scanned.settings.line)
        np.testing.assert_array_equal(found.settings.values, scanned.settings.values)
        return found

    monkeypatch.setattr(reader, "plain_rows_of_trace", compared)
    read((body(FULL, *lines) + subs).replace("\r\n", end), COUNTERS_DAT)
