"""Spline blocks: the same path as SLIN and SCIRC alone, corrected in the block; of SPL the targets."""

import re

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.dialects import krl
from postproc.dialects.text import decode
from postproc.errors import ForceError, ProgramError
from postproc.program import LIN, PTP, SPL
from tests.cells import sample
from tests.corrections import process_files
from tests.dialects.krl_programs import CELL, body, forward, numbers, read, read_documents, targets
from tests.krl_texts import FRAMES_AND_SPEED

START = "LIN {X 0,Y 0,Z 0,A 0,B 0,C 180}"
FORCE = ";FORCE FX=-110 FY=190 FZ=130"


def block(*lines, head="SPLINE", end="ENDSPLINE"):
    return body(*FRAMES_AND_SPEED, START, head, *lines, end, "LIN {Z 30}")


def test_slin_and_scirc_in_a_block_are_what_they_are_alone():
    pieces = ("SLIN {X 50}", "SCIRC {X 75,Y 25},{X 100,Y 0}", "SCIRC {X 75,Y -25},{X 50,Y 0},CA 270", "SLIN_REL {Y 5}")
    one, other = read(block(*pieces)), read(body(*FRAMES_AND_SPEED, START, *pieces, "LIN {Z 30}"))
    np.testing.assert_array_equal(numbers(one), numbers(other))
    for name in ("kind", "feed", "sweep", "centre", "target"):
        np.testing.assert_array_equal(getattr(one.motions, name), getattr(other.motions, name))


def test_spl_goes_to_its_target_and_nothing_is_known_of_its_path():
    program = read(block("SPL {X 50,Y 5}", "SPL_REL {X 10}", "SLIN {X 100}"))
    assert program.motions.kind.tolist() == [LIN, SPL, SPL, LIN, LIN]
    np.testing.assert_allclose(numbers(program)[1:4, 0], [50, 60, 100])
    (issue,) = [issue for issue in program.issues if issue.kind == "spline"]
    assert (issue.level, issue.count) == ("warning", 2)


def test_with_of_a_block_holds_in_it_alone():
    program = read(
        block(
            "SLIN {X 50}",
            "SLIN {X 60} WITH $VEL.CP=0.01",
            "SLIN {X 70}",
            head="SPLINE WITH $VEL={CP 0.2,ORI1 100.0,ORI2 100.0},$TOOL=TOOL_DATA[2],$ACC.CP=1.0",
        )
        .replace("{X 50}", "{X 50,Y 0,Z 0,A 0,B 0,C 180}")
        .replace("LIN {Z 30}", "LIN {X 0,Y 0,Z 30,A 0,B 0,C 180}")
    )
    assert program.motions.feed.tolist() == [0.05, 0.2, 0.01, 0.2, 0.05]
    assert (np.diff(program.motions.tool) != 0).tolist() == [True, False, False, True]


def test_a_ptp_spline_is_a_row_of_ptp():
    program = read(block("SPTP {X 50}", "SPTP {X 60,S 2,T 10}", head="PTP_SPLINE", end="ENDSPLINE C_SPL"))
    assert program.motions.kind.tolist() == [LIN, PTP, PTP, LIN]


def test_only_the_end_of_a_block_is_approximated():
    assert read(block("SLIN {X 50}", "SLIN {X 60}")).motions.blend.tolist() == [0] * 4
    approximated = read(
        body(*FRAMES_AND_SPEED, "$APO.CDIS=2", START, "SPLINE", "SLIN {X 50}", "SPL {X 60}", "ENDSPLINE c_spl", START)
    )
    assert approximated.motions.blend.tolist() == [0, 0, 0.002, 0]


def test_targets_inserted_into_a_block_have_no_approximation():
    program = read(
        block("SLIN {X 50}", "SCIRC {X 75,Y 25},{X 100,Y 0}", ";FOLD P", "SLIN {X 150} WITH $VEL.CP=0.1", ";ENDFOLD")
    )
    wanted = targets(program, np.full((5, 3), 1e-3), pieces={1: [0.3, 0.6], 2: [0.5], 3: [0.5]})
    written = krl.rewrite(program, wanted)
    text = written.documents[0].text
    inside = text[text.index("SPLINE") : text.index("ENDSPLINE")]
    assert len(re.findall("(?m)^SLIN", inside)) == 5
    assert "C_" not in inside
    assert inside.count("WITH $VEL.CP=0.1") == 2
    again = read(text)
    np.testing.assert_allclose(again.motions.target, wanted.pose, atol=1e-7)


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (["SPL {X 50}"], "SPL outside of a spline block"),
        (["SPLINE", "LIN {X 50}", "ENDSPLINE"], "LIN in a SPLINE block"),
        (["SPLINE", "SPTP {X 50}", "ENDSPLINE"], "SPTP in a SPLINE block"),
        (["PTP_SPLINE", "SLIN {X 50}", "ENDSPLINE"], "SLIN in a PTP_SPLINE block"),
        (["SPLINE", "SLIN {X 50}"], "not closed"),
        (["SLIN {X 50}", "ENDSPLINE"], "ENDSPLINE without SPLINE"),
        (["SPLINE", "SPLINE", "SLIN {X 50}", "ENDSPLINE"], "inside of a spline block"),
        (["SPLINE", "SLIN {X 50}", "ENDSPLINE C_DIS"], "'C_DIS' is not understood"),
        (["TIME_BLOCK START", "SLIN {X 50}"], "TIME_BLOCK outside of a spline block"),
        (["CONST_VEL START=10", "SLIN {X 50}"], "CONST_VEL outside of a spline block"),
        (["SPLINE", "CONST_VEL BEGIN=10", "SLIN {X 50}", "ENDSPLINE"], "not understood"),
        (["SPLINE", "STOP WHEN PATH=10", "SLIN {X 50}", "ENDSPLINE"], "not understood"),
    ],
)
@pytest.mark.parametrize("bulk", [True, False])
def test_what_is_no_spline_block_is_refused(lines, says, bulk):
    with pytest.raises(ProgramError, match=says):
        read(body(*FRAMES_AND_SPEED, START, *lines, "LIN {Z 30}"), bulk=bulk)


TIMED = (
    "TIME_BLOCK START",
    "SLIN {X 50}",
    "TIME_BLOCK PART = 40",
    "const_vel start = 20 onstart ;from here",
    "SLIN {X 80}",
    "STOP WHEN PATH = -12.5 IF $IN[3]==FALSE",
    "SLIN {X 120}",
    "CONST_VEL END = 0",
    "SLIN {X 200}",
    "TIME_BLOCK END = 2.5",
)


def test_statements_of_time_change_no_path_and_are_kept():
    untimed = [line for line in TIMED if line.startswith("SLIN")]
    one, other = read(block(*TIMED)), read(block(*untimed))
    np.testing.assert_array_equal(numbers(one), numbers(other))
    assert krl.rewrite(one, targets(one, keep=True)).documents[0].text == one.documents[0].text


def test_what_counts_from_the_end_of_a_motion_stays_before_its_last_piece():
    program = read(block(*TIMED))
    wanted = targets(program, np.full((6, 3), 1e-3), pieces={row: [0.4, 0.7] for row in range(1, 5)})
    written = krl.rewrite(program, wanted)
    assert [issue.level for issue in written.issues if issue.kind == "trigger"] == []
    text = written.documents[0].text.splitlines()
    inside = text[text.index("SPLINE") + 1 : text.index("ENDSPLINE")]
    expected = [TIMED[0], *"123", *TIMED[2:4], *"123", *"12", TIMED[5], "3", *"12", TIMED[7], "3", TIMED[9]]
    assert [line if line in expected else "SLIN" for line in inside] == [
        "SLIN" if line in "123" else line for line in expected
    ]
    np.testing.assert_allclose(read(written.documents[0].text).motions.target, wanted.pose, atol=1e-7)


def test_a_stop_of_a_motion_that_stands_alone_is_kept():
    lines = ("STOP WHEN PATH=5 ONSTART IF $IN[1]", "SLIN {X 50} WITH $VEL.CP=0.1")
    assert len(read(body(*FRAMES_AND_SPEED, START, *lines)).motions) == 2


def test_a_block_is_corrected_as_the_same_lines_without_one():
    pieces = ("SLIN {X 50,Y 0,Z 0}", "SCIRC {X 75,Y 25},{X 100,Y 0}", "SLIN {X 400}")
    begin = (*FRAMES_AND_SPEED, FORCE, START.replace("LIN", "PTP"))
    one = process_files({"part.src": body(*begin, "SPLINE", *pieces, "ENDSPLINE")})
    other = process_files({"part.src": body(*begin, *pieces)})
    assert one.inserted > 1
    np.testing.assert_array_equal(one.printed, other.printed)
    np.testing.assert_array_equal(one.deviation_after, other.deviation_after)


def test_targets_of_spl_are_corrected_as_those_of_lines_and_nothing_is_inserted():
    begin = (*FRAMES_AND_SPEED, FORCE, START.replace("LIN", "PTP"))
    spl = process_files(
        {"part.src": body(*begin, "SPLINE", "SPL {X 400,Y 10}", "SPL {X 100,Y 50}", "ENDSPLINE")}, *sample()
    )
    lin = process_files({"part.src": body(*begin, "SLIN {X 400,Y 10}", "SLIN {X 100,Y 50}")})
    assert spl.inserted == 0
    ends = lin.t == 1.0
    np.testing.assert_allclose(spl.printed, lin.printed[ends], atol=1e-9)
    assert spl.after.max() < 1e-6
    assert lin.inserted > 0


def test_a_block_without_forces_comes_back_byte_for_byte():
    pieces = "SPL {X 9}", "SCIRC {X 75,Y 25},{X 99}", "TRIGGER WHEN PATH=0 DELAY=0 DO $OUT[1]=TRUE", "SLIN {Y 3}"
    begin = (*FRAMES_AND_SPEED, START.replace("LIN", "PTP"), "SPLINE WITH $VEL.CP=0.1")
    text = body(*begin, *pieces, "ENDSPLINE C_SPL", "LIN {X 0}")
    assert process_files({"part.src": text}).documents[0].text == text


def test_a_feed_force_on_spl_is_refused():
    begin = (*FRAMES_AND_SPEED, ";FORCE FX=100 FRAME=FEED", START.replace("LIN", "PTP"))
    with pytest.raises(ForceError, match="spline, whose direction is not known"):
        process_files({"part.src": body(*begin, "SPLINE", "SPL {X 400,Y 10}", "ENDSPLINE")})


def test_global_points_of_other_files(tmp_path):
    point = "DECL GLOBAL E6POS XG={X 10,Y 20,Z 30,A 0,B 0,C 180}\nDECL E6POS XL={X 1}\n"
    (tmp_path / "points.dat").write_text(f"DEFDAT points PUBLIC\n{point}ENDDAT\n")
    (tmp_path / "twice.dat").write_text("DEFDAT twice PUBLIC\nDECL GLOBAL E6POS XT={X 1}\nENDDAT\n")
    (tmp_path / "again.dat").write_text("DEFDAT again PUBLIC\nDECL GLOBAL E6POS XT={X 2}\nENDDAT\n")

    def reading(target):
        document = replace(
            decode("part.src", body(*FRAMES_AND_SPEED, START, f"LIN {target}").encode()), folder=str(tmp_path)
        )
        return read_documents([document], CELL, forward, "part")

    program = reading("XG")
    np.testing.assert_array_equal(numbers(program)[1], [10, 20, 30, 0, 0, 180])
    written = krl.rewrite(program, targets(program, np.full((2, 3), 1e-3)))
    assert "LIN {X 11.0000,Y 21.0000,Z 31.0000" in written.documents[0].text
    for name in ("XL", "XT"):
        with pytest.raises(ProgramError, match="the target is not known"):
            reading(name)


def test_a_block_in_a_subprogram_and_in_a_loop():
    main = (
        "DEF part( )",
        "DECL INT I",
        "BAS (#INITMOV,0 )",
        *FRAMES_AND_SPEED,
        START,
        "FOR I=1 TO 2",
        "cut( )",
        "ENDFOR",
        "END",
    )
    cut = ("DEF cut( )", "SPLINE WITH $VEL.CP=0.1", "SLIN_REL {X 10}", "SPL_REL {Y 5}", "ENDSPLINE", "END", "")
    source = "\r\n".join([*main, *cut])
    program = read(source)
    assert program.motions.kind.tolist() == [LIN, LIN, SPL, LIN, SPL]
    assert program.motions.feed.tolist() == [0.05, 0.1, 0.1, 0.1, 0.1]
    np.testing.assert_allclose(numbers(program)[1:, :2], [[10, 0], [10, 5], [20, 5], [20, 10]])
    assert krl.rewrite(program, targets(program, keep=True)).documents[0].text == source
