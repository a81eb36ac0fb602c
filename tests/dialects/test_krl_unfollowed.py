"""Routines reached by a call that is followed and by one that is not: the second finds them as they were."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.dialects import krl
from postproc.dialects.text import decode
from postproc.errors import ProgramError
from tests.attack.krl import confirmed, read_job
from tests.dialects.krl_programs import CELL, forward, targets
from tests.krl_texts import TURNED_HOME

FULL = "LIN {X 0,Y 0,Z 300,A 10,B 20,C 170}"
CUT = "DEF CUT()\nLIN {X 110,Y 20,Z 30,A 10,B 20,C 170}\nEND\n"
FUNCTION = "DEFFCT INT FN()\nCUT()\nRETURN(1)\nENDFCT\n"
UNKNOWN = f"DEF AWAY()\nWHILE $IN[1]\nCUT()\n{TURNED_HOME}\nENDWHILE\nEND\n"


def main(*lines, subs=""):
    return "\n".join(["DEF part()", "INT I", "BAS(#INITMOV,0)", FULL, *lines, "END", ""]) + subs


def rewritten_files(folder, files, *, keep):
    """What is written with all targets moved by 1 mm, and the issues."""
    for name, text in files.items():
        (folder / name).write_text(text)
    cell = replace(CELL, folder=str(folder), krl=replace(CELL.krl, keep_unresolved=keep))
    document = replace(decode("part.src", files["part.src"].encode()), folder=str(folder))
    program = krl.read_program([document], cell, forward, "part")
    written = krl.rewrite(program, targets(program, np.tile([1e-3, 0, 0], (len(program.motions), 1))))
    return {document.name: document.text for document in written.documents}, written.issues


@pytest.mark.parametrize(
    ("files", "keep", "file"),
    [
        ({"part.src": main("CUT()", "I=FN()", FULL, subs=CUT + FUNCTION)}, True, "part.src"),
        ({"part.src": main("CUT()", "I=FN()", FULL, subs=FUNCTION), "cut.src": CUT}, True, "cut.src"),
        (
            {"part.src": main("CUT()", "AWAY()", TURNED_HOME, FULL), "cut.src": CUT, "away.src": UNKNOWN},
            False,
            "cut.src",
        ),
        (
            {"part.src": main("CUT()", "AWAY()", TURNED_HOME, FULL), "cut.src": CUT, "away.src": UNKNOWN},
            True,
            "cut.src",
        ),
        ({"part.src": main("CUT()", "WHILE $IN[1]", "CUT()", "ENDWHILE", FULL, subs=CUT)}, True, "part.src"),
    ],
)
def test_what_a_call_reaches_that_is_not_followed_stays_and_corrected_calls_get_a_copy(tmp_path, files, keep, file):
    written, issues = rewritten_files(tmp_path, files, keep=keep)
    before, behind = written[file].upper().split("DEF CUT_2()")
    assert CUT.split("\n", 1)[1].upper() in before
    assert "LIN {X 111.0000," in behind
    assert "\nCUT_2()\n" in written["part.src"]
    assert files["part.src"].count("I=FN()") == written["part.src"].count("I=FN()")
    (told,) = (issue.message for issue in issues if issue.kind == "routine-copied")
    assert told == (
        "CUT() is also called where calls are not followed, and stays as it is there: this one calls its copy CUT_2()."
    )


def test_a_call_that_is_not_followed_and_reaches_the_program_itself_is_refused(tmp_path):
    function = FUNCTION.replace("CUT", "part")
    files = {"part.src": main("AWAY()", TURNED_HOME, FULL), "away.src": f"DEF AWAY()\nINT I\nI=FN()\nEND\n{function}"}
    with pytest.raises(ProgramError, match="calls this program again"):
        rewritten_files(tmp_path, files, keep=False)


INTERRUPTING = "DEF AWAY()\nGLOBAL INTERRUPT DECL 5 WHEN $IN[1] DO DRIVE()\nINTERRUPT ON 5\nEND\n"


@pytest.mark.parametrize("word", ["GLOBAL ", ""])
def test_interrupts_that_move_the_robot_are_refused_where_the_call_that_declares_them_is_not_followed(tmp_path, word):
    """A local one ends with the routine that declares it."""
    away = INTERRUPTING.replace("GLOBAL ", word) + f"DEF DRIVE()\n{TURNED_HOME}\nEND\n"
    files = {"part.src": main("WHILE $IN[3]", "AWAY()", "ENDWHILE", FULL, subs=away)}
    if not word:
        rewritten_files(tmp_path, files, keep=True)
        return
    with pytest.raises(ProgramError, match="GLOBAL interrupt that moves the robot") as caught:
        rewritten_files(tmp_path, files, keep=True)
    assert caught.value.line == 6


def test_copies_of_functions_are_functions(tmp_path):
    function = "DEFFCT INT FN(N:IN)\nINT N\nLIN {X N*10,Y 2,Z 3,A 0,B 0,C 0}\nRETURN(1)\nENDFCT\n"
    files = {"part.src": main("FN(1)", "FN(2)", subs="GLOBAL " + function), "part.dat": "DEFDAT part\nENDDAT\n"}
    program = read_job(files, tmp_path)
    assert confirmed(program, files, tmp_path, np.random.default_rng(0)) == "accepted"
    written, _ = rewritten_files(tmp_path, {"part.src": files["part.src"]}, keep=False)
    assert "GLOBAL DEFFCT INT FN_2(N:IN)\n" in written["part.src"]
    assert written["part.src"].count(" FN(N:IN)") == 1


SLOW = "DEFFCT INT SLOW()\nBAS(#VEL_CP,0.1)\n$TOOL=TOOL_DATA[2]\nRETURN(2)\nENDFCT\n"


@pytest.mark.parametrize(
    "lines",
    [
        ["IF $IN[4] THEN", "LIN {X SLOW(),Y 55}", "ENDIF"],
        ["LIN {X SLOW(),Y 55}"],
        ["SPLINE", "SLIN {X SLOW(),Y 55}", "SLIN {X 5,Y 60}", "ENDSPLINE"],
    ],
)
def test_what_the_target_of_a_motion_that_stays_calls_may_change_what_later_motions_depend_on(tmp_path, lines):
    (tmp_path / "part.src").write_text(main(*lines, TURNED_HOME, FULL, subs=SLOW))
    cell = replace(CELL, folder=str(tmp_path), krl=replace(CELL.krl, keep_unresolved=True))
    document = replace(decode("part.src", (tmp_path / "part.src").read_bytes()), folder=str(tmp_path))
    program = krl.read_program([document], cell, forward, "part")
    left = {one.line for one in program.unresolved}
    assert max(left) == 6 + len(lines)  # LIN behind them: its speed and tool are not known
    assert len(program.motions) == 2  # the first LIN, and the PTP to joint angles


def test_a_call_whose_argument_moves_the_robot_stays_as_it_is(tmp_path):
    function = "DEFFCT INT FN()\nLIN {X 7}\nRETURN(1)\nENDFCT\n"
    files = {
        "part.src": main("OTHER(FN())", TURNED_HOME, FULL, subs=function),
        "other.src": CUT.replace("CUT()", "OTHER(N:IN)\nINT N"),
    }
    written, _ = rewritten_files(tmp_path, files, keep=True)
    assert "other.src" not in written
    assert "LIN {X 1.0000,Y 0.0000,Z 300.0000" in written["part.src"]
    assert "\nOTHER(FN())\n" in written["part.src"]


@pytest.mark.parametrize("keep", [False, True])
def test_the_motion_behind_a_call_that_is_not_followed_begins_where_nobody_knows(tmp_path, keep):
    files = {"part.src": main("AWAY()", TURNED_HOME, FULL), "part.dat": "DEFDAT part\nENDDAT\n", "away.src": UNKNOWN}
    program = read_job(files | {"cut.src": CUT}, tmp_path, keep=keep)
    assert program.after.tolist() == [-1, 1, 1]
    assert [issue.source_line for issue in program.issues if issue.kind == "start-unknown"] == [6]
