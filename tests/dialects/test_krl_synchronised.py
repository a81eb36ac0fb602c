"""SYNCCMD (KUKA.RoboTeam): motions during which another robot moves in time with this one are not corrected."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.dialects import krl
from postproc.dialects.krl.read import unresolved
from postproc.errors import ProgramError
from tests.dialects.krl_programs import CELL, body, read, targets

WAIT, DRIVE = 'SYNCCMD(#ProgSync, "A1", 3)', 'synccmd (#motionsync,"A2",2)'
KEEP = replace(CELL, krl=replace(CELL.krl, keep_unresolved=True))


def lin(x):
    return f"LIN {{X {x},Y 0,Z 5,A 0,B 0,C 170}}"


def routine(name, *lines):
    return ["END", f"DEF {name}()", *lines]


REFUSED = {
    "two": ([lin(1), WAIT, lin(2), lin(3), WAIT, lin(4)], (6, 7), "between SYNCCMD (line 5) and SYNCCMD (line 8)"),
    "three": ([WAIT, lin(1), WAIT, WAIT, lin(2)], (5,), "between SYNCCMD (line 4) and SYNCCMD (line 6)"),
    "motions": ([lin(1), DRIVE, lin(2), lin(3)], (6, 7), "behind SYNCCMD (line 5)"),
    "axes": ([lin(1), WAIT, "PTP {A1 0,A2 -90,A3 90,A4 0,A5 45,A6 0}", WAIT, lin(2)], (6,), "between SYNCCMD"),
    "a name": (["DECL SYNCTYPE W", lin(1), 'SYNCCMD(W,"A",3)', lin(2)], (7,), "behind SYNCCMD (line 6)"),
    "a variable": ([lin(1), "$SYNC_LIST='B0011'", lin(2)], (6,), "behind SYNCCMD (line 5)"),
    "a branch": ([lin(1), "IF $IN[1] THEN", WAIT, "ENDIF", lin(2), WAIT, lin(3)], (8,), "SYNCCMD (line 6) and SYNCCMD"),
    "an interrupt": ([lin(1), f"INTERRUPT DECL 3 WHEN $IN[1] DO {WAIT}", lin(2)], (6,), "behind SYNCCMD (line 5)"),
    "an interrupt, and a SYNCCMD behind it": (
        [lin(1), f"INTERRUPT DECL 3 WHEN $IN[1] DO {WAIT}", lin(2), WAIT, lin(3)],
        (6, 8),
        "between SYNCCMD (line 5) and SYNCCMD (line 7)",
    ),
    "an interrupt of a routine": (
        [lin(1), "GLOBAL INTERRUPT DECL 3 WHEN $IN[1] DO MEET()", "INTERRUPT ON 3", lin(2), *routine("MEET", WAIT)],
        (7,),
        "behind SYNCCMD (line 5)",
    ),
    "rounds": (["INT I", lin(1), "FOR I=1 TO 2", lin(2), WAIT, "ENDFOR", lin(3)], (7,), "between SYNCCMD (line 8)"),
    "rounds to the end": (
        ["INT I", lin(1), "FOR I=1 TO 2", lin(2), DRIVE, "ENDFOR", lin(3)],
        (7, 10),
        "between SYNCCMD (line 8) and SYNCCMD (line 8)",
    ),
    "an endless loop": ([lin("1.0"), "LOOP", lin(2), WAIT, lin(1), "ENDLOOP"], (6, 8), "between SYNCCMD"),
    "an endless loop behind another": (
        [lin(1), WAIT, lin(3), "LOOP", lin(2), WAIT, lin(3), "ENDLOOP"],
        (6, 8, 10),
        "between SYNCCMD (line 5)",
    ),
    "routines": (
        [lin(1), "MEET()", lin(2), "MEET()", lin(3), *routine("MEET", WAIT)],
        (6,),
        "between SYNCCMD (line 5)",
    ),
    "functions": (
        [
            "INT I",
            lin(1),
            "I=F()",
            lin(2),
            "END",
            "DEFFCT INT F()",
            "MEET()",
            "RETURN(1)",
            "ENDFCT",
            "DEF MEET()",
            DRIVE,
        ],
        (7,),
        "behind SYNCCMD (line 6)",
    ),
    "a routine that moves": (
        [lin(1), "CUT()", lin(2), *routine("CUT", lin(3), WAIT, lin(4), WAIT, lin(5))],
        (11,),
        "between SYNCCMD (line 10) and SYNCCMD (line 12)",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_motion_in_time_with_another_robot_is_refused_or_left_as_it_is(case):
    lines, kept, where = REFUSED[case]
    text = body(*lines)
    with pytest.raises(ProgramError, match="another robot may move in time with it") as caught:
        read(text)
    assert where in str(caught.value)
    assert "--keep-unresolved" in str(caught.value)
    program = read(text, cell=KEEP)
    assert {one.line for one in program.unresolved} == set(kept)
    (written,) = krl.rewrite(program, targets(program, np.full((len(program.motions), 3), 1e-3))).documents
    before, after = text.splitlines(), written.text.splitlines()
    for line in kept:
        assert before[line - 1] in after
    moves = [line for number, line in enumerate(before, 1) if line.startswith("LIN") and number not in kept]
    assert not set(moves) & set(after)


@pytest.mark.parametrize(
    "lines",
    [
        [lin(1), WAIT, lin(2)],
        [lin(1), "MEET()", lin(2), *routine("MEET", WAIT)],
        [lin(1), WAIT, WAIT, lin(2)],
        [lin(1), lin(2), *routine("OTHER", DRIVE)],
        ['MSG("SYNCCMD")', lin(1), lin(2)],
        [lin(1), lin(2), DRIVE],
    ],
)
def test_motions_of_this_robot_alone_are_corrected_and_the_statement_is_kept(lines):
    program = read(body(*lines))
    assert len(program.motions) == 2
    (written,) = krl.rewrite(program, targets(program, np.full((2, 3), 1e-3))).documents
    for line in lines:
        assert (line in written.text) == (not line.startswith("LIN"))


def test_motions_driven_with_those_of_another_robot_are_refused():
    """What `SLIN … Sync=AutoSync` of RoboTeam's inline form writes behind WITH."""
    motion = "S" + lin(2) + " WITH $VEL=SVEL_CP(0.1,,L1),$SYNC_ID[]=\"AutoSync\",$SYNC_LIST='B0011' C_SPL"
    with pytest.raises(ProgramError, match=r"\$SYNC_ID in WITH is not understood"):
        read(body(lin(1), motion))


@pytest.mark.parametrize("before", range(9))
def test_a_word_that_synchronises_is_found_wherever_it_is_in_a_text(before: int):
    assert unresolved._synchronises(" " * before + "SyncCmd(#X)", 4)
    assert not unresolved._synchronises(" " * before + "SyncCm(#X)", 4)


def test_a_loop_over_points_of_which_no_motion_is_corrected_stays_as_it_is():
    data = f"DEFDAT part\nDECL INT I=0\nDECL E6POS P[2]\nP[1]={lin(1)[4:]}\nP[2]={lin(2)[4:]}\nENDDAT\n"
    program = read(body(lin(1), DRIVE, "FOR I=1 TO 2", "LIN P[I]", "ENDFOR"), data.replace("\n", "\r\n"), KEEP)
    written = krl.rewrite(program, targets(program, np.array([[1e-3, 0.0, 0.0]])))
    assert [document.text for document in written.documents][1] == program.documents[1].text
    assert "LIN {X 2.0000," in written.documents[0].text
