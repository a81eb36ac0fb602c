"""KRL in, KRL out: nothing but numbers changes, and the controller gets what was asked for."""

from functools import partial

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from postproc.dialects import krl
from postproc.errors import ProgramError
from postproc.frames import pose_from_xyzabc
from postproc.program import CIRC, LIN, PTP, Program
from tests import programs
from tests.dialects.krl_programs import CELL, DATA, body, check_commands, forward, numbers, read, sources, targets
from tests.effort import calls_for_each

FULL = "LIN {X 100,Y 20,Z 30,A 10,B 20,C 170}"
MM = 1e-3


def up(program, *rows, by=1.0):
    """Shifts of the given motions by `by` mm along Z."""
    shift = np.zeros((len(program.motions), 3))
    shift[list(rows), 2] = by * MM
    return shift


def keep_unmoved(program, wanted, shift, turn=None):
    still = (np.abs(shift).sum(axis=1) == 0) & (turn is None or turn == 0.0)
    m = program.motions
    keep = still[wanted.motion] & (wanted.t == 1.0) & (wanted.kind == m.kind[wanted.motion])
    for k in range(1, len(keep)):  # a circle that starts elsewhere is another circle
        if wanted.kind[k] == CIRC and not keep[k - 1] and wanted.motion[k - 1] >= wanted.motion[k] - 1:
            keep[k] = False
    return replace(wanted, keep=keep)


def rewritten(text, data=None, raised=(), by=1.0, **options):
    """Rewrite with some motions raised and the others kept, check what the controller gets; the documents' lines."""
    program = read(text, data)
    shift = up(program, *raised, by=by)
    wanted = keep_unmoved(program, targets(program, shift, **options), shift)
    written = krl.rewrite(program, wanted)
    check_commands(program, wanted, written)
    return [document.text.splitlines() for document in written.documents], written


def kinds(written):
    return [issue.kind for issue in written.issues]


# --- properties --------------------------------------------------------------------------------------------------


@settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck))
@given(sources(), st.data())
def test_the_written_program_commands_the_targets(source, data):
    try:
        program = read(source, DATA)
    except ProgramError:
        assume(False)
    count = len(program.motions)
    rng = np.random.default_rng(data.draw(st.integers(0, 2**31)))
    shift = rng.uniform(-2, 2, (count, 3)) * MM * data.draw(st.sampled_from([0, 1]))
    turn = rng.uniform(-1e-3, 1e-3, count) * data.draw(st.sampled_from([0, 0, 1]))
    shift[rng.random(count) < data.draw(st.sampled_from([0.0, 0.5]))] = 0
    pieces = {row: np.arange(1, 6) / 6 for row in np.flatnonzero(program.motions.sweep > 6)}
    if data.draw(st.booleans()):
        pieces |= {row: rng.uniform(0.1, 0.9, 2).round(3) for row in np.flatnonzero(rng.random(count) < 0.4)}
    straight = data.draw(st.sampled_from([False, False, True]))
    wanted = targets(program, shift, turn, pieces=pieces, straight=straight)
    wanted = keep_unmoved(program, wanted, shift, turn)
    written = krl.rewrite(program, wanted)
    check_commands(program, wanted, written)
    if wanted.keep.all():
        assert [d.text for d in written.documents] == [source, DATA]


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(sources())
def test_rewriting_again_with_the_same_targets_changes_nothing(source):
    try:
        program = read(source, DATA)
    except ProgramError:
        assume(False)
    assume(not (program.motions.kind == CIRC).any())  # their auxiliary points are chosen anew
    first = krl.rewrite(program, targets(program, up(program, *range(len(program.motions)))))
    again = krl.read_program(first.documents, CELL, forward, "part")
    second = krl.rewrite(again, targets(again))
    assert [d.text for d in second.documents] == [d.text for d in first.documents]


def test_nothing_changes_when_all_targets_are_kept():
    text = (
        "\ufeff".encode() + body("; Größe", FULL + " C_Dis ;x", "  lin {x 1.5E1, y -0}", "LIN XP1", end="\n").encode()
    )
    program = read(text, DATA)
    written = krl.rewrite(program, targets(program, keep=True))
    assert written.documents[0].to_bytes() == text
    assert written.documents[1].text == DATA
    assert written.output_line.tolist() == [5, 6, 7]
    assert written.issues == ()


def test_only_krl_can_be_rewritten():
    program = read(body(FULL))
    foreign = Program("part", "gcode", program.documents, program.motions, program.bases, program.tools)
    with pytest.raises(ValueError, match="KRL"):
        krl.rewrite(foreign, targets(program))


# --- numbers in place --------------------------------------------------------------------------------------------


def test_only_numbers_change_and_only_where_they_must():
    (lines, *_), _ = rewritten(
        body(
            "  LIN {X 100.5,Y -20,Z 30,A 10,B 20,C 170} C_Dis ; N10 Ø",
            "\tlin{E6POS: x 100, y 20, z 31, a 10, b 20, c 170, E1 0.0}C_DIS",
            FULL,
            end="\n",
        ),
        raised=[0, 1],
    )
    assert lines[3:6] == [
        "  LIN {X 100.5000,Y -20.0000,Z 31.0000,A 10.00000,B 20.00000,C 170.00000} C_Dis ; N10 Ø",
        "\tlin{E6POS: x 100.0000, y 20.0000, z 32.0000, a 10.00000, b 20.00000, c 170.00000, E1 0.0}C_DIS",
        FULL,
    ]


@pytest.mark.parametrize(
    ("number", "printed"),
    [
        ("30", "31.0000"),
        ("3E1", "31.0000"),
        ("30.12", "31.1200"),
        ("30.1234567", "31.1234567"),
        ("30.1234567890123", "31.123456789"),
        ("3.012345678E1", "31.123456780"),
        ("-1.00000", "0.00000"),
        ("-1.00004", "-0.00004"),
        ("-1.00000000000001", "0.000000000"),
    ],
)
def test_decimals_are_at_least_four_and_as_many_as_there_were(number, printed):
    for bulk_free in ("", ",E1 0,S 2"):  # the second is read by the general path
        line = f"LIN {{X 1,Y 2,Z {number},A 0,B 0,C 0{bulk_free}}}"
        (lines, *_), _ = rewritten(body(line), raised=[0])
        assert f",Z {printed}," in lines[3]


def test_mixed_line_ends_stay_with_their_lines():
    text = "DEF part( )\r\n" + FULL + "\n" + FULL + "\r\n; x\r\r\nEND"
    program = read(text)
    written = krl.rewrite(program, targets(program, up(program, 0, 1), pieces={1: [0.5]}))
    new = written.documents[0].text
    assert new.count("\r\n") == text.count("\r\n") + 1
    assert new.endswith("\r\n; x\r\r\nEND")
    check_commands(program, targets(program, up(program, 0, 1), pieces={1: [0.5]}), written)


def test_angles_stay_close_to_those_that_were_written():
    angles = np.array([[180, 0, -180], [200, 0, 0], [-10, 90, 20], [15, -90, 0], [0, 120, 0]])
    program = read(body(*("LIN {X 1,Y 2,Z 3,A %g,B %g,C %g}" % tuple(row) for row in angles)))  # noqa: UP031
    wanted = targets(program, up(program, 2, 3), np.array([1e-4, 1e-4, 0, 0, 1e-4]))
    written = krl.rewrite(program, wanted)
    again = check_commands(program, wanted, written)
    assert np.abs(numbers(again)[:, 3:] - angles).max() < 0.02
    assert np.array_equal(numbers(again)[2:4, 3:], angles[2:4])


def test_status_and_turn_change_only_when_they_differ():
    program = read(
        body(
            "PTP {X 1,Y 2,Z 3,A 4,B 5,C 6,S 2,T 34}", "PTP {X 1,Y 2,Z 3,A 4,B 5,C 6,S 'B010',T 'B100010'}", "PTP {X 1}"
        )
    )
    bits = np.array([6, 6, 6]), np.array([34, 3, 35])
    written = krl.rewrite(program, targets(program, up(program, 0, 1, 2), bits=bits))
    lines = written.documents[0].text.splitlines()[3:6]
    assert [line[line.index(",S") :] for line in lines[:2]] == [",S 6,T 34}", ",S 'B110',T 'B000011'}"]
    assert ",S" not in lines[2]


@pytest.mark.parametrize(
    ("text", "corrected"),
    [
        ("S 'B 110',T 'B 000011'", "S 'B 010',T 'B 100010'"),
        ("S 'b\t110',T 'b011'", "S 'b\t010',T 'b100010'"),
        ("S 'H6',T 'h 03'", "S 'H2',T 'h 22'"),
    ],
)
def test_status_and_turn_keep_their_notation(text, corrected):
    program = read(body(f"PTP {{X 1,Y 2,Z 3,A 4,B 5,C 6,{text}}}"))
    for bits, expected in (((6, 3), text), ((2, 34), corrected)):
        written = krl.rewrite(program, targets(program, up(program, 0), bits=tuple(np.array([b]) for b in bits)))
        line = written.documents[0].text.splitlines()[3]
        assert line[line.index("S ") :] == f"{expected}}}"


def test_axis_targets_have_no_row_and_stay_to_the_byte():
    axis = "PTP {A1 0,A2 -90,A3 90.0,A4 0,A5 0,A6 0} ; home"
    (lines, *_), _ = rewritten(body(axis, FULL, axis), raised=[1])
    assert (lines[3], lines[5]) == (axis, axis)


# --- components that are missing ---------------------------------------------------------------------------------


def test_missing_components_are_added_when_they_must_change():
    program = read(
        body(FULL, "LIN {X 7, Y 8} C_DIS", "lin {x 9,y 1} C_DIS", "LIN {Z 5,S 2,T 10,E1 0}", "LIN {E6POS: X 1}")
    )
    shift = np.array([[0, 0, 0], [0, 0, 1], [0, 0, 2], [1, 0, 2], [1, 0, 0]]) * MM
    wanted = targets(program, shift)
    written = krl.rewrite(program, wanted)
    check_commands(program, wanted, written)
    assert written.documents[0].text.splitlines()[4:8] == [
        "LIN {X 7.0000, Y 8.0000, Z 31.0000} C_DIS",
        "lin {x 9.0000,y 1.0000,z 32.0000} C_DIS",
        "LIN {Z 7.0000,X 10.0000,S 2,T 10,E1 0}",
        "LIN {E6POS: X 2.0000,Z 5.0000}",
    ]


def test_components_are_added_to_a_target_that_gives_an_external_axis_only():
    """A linear axis carries the robot on while the tool stays where it is."""
    program = read(body(FULL, "LIN {X 7}", "LIN {E1 0} C_DIS", "LIN_REL {E1 0}"))
    wanted = targets(program, np.array([[0, 0, 0], [0, 0, 0], [1, 0, 2], [0, 0, 2]]) * MM)
    written = krl.rewrite(program, wanted)
    check_commands(program, wanted, written)
    assert written.documents[0].text.splitlines()[5] == "LIN {X 8.0000,Z 32.0000,E1 0} C_DIS"


def test_a_kept_target_is_completed_when_its_predecessor_was_changed():
    (lines, *_), _ = rewritten(body(FULL, "LIN {X 7.5}", "LIN {X 8}", "LIN {X 9,Z 3}"), raised=[0])
    assert lines[4:7] == ["LIN {X 7.5,Z 30.0000}", "LIN {X 8}", "LIN {X 9,Z 3}"]


def test_added_numbers_have_all_the_digits_they_need():
    (lines, *_), _ = rewritten(body("LIN {X 1,Y 2,Z 3.12345678,A 0,B 0,C 0}", "LIN {X 7}", "LIN {X 8}"), raised=[0])
    assert lines[4:6] == ["LIN {X 7,Z 3.12345678}", "LIN {X 8}"]


def test_a_divided_motion_with_b_beyond_90_has_all_of_a_b_c():
    """The piece before it is printed with such a B too, and then a missing A is not certain."""
    last = "LIN {Y 27.699,B 144.334,C -55.800}"
    program = read(body("LIN {X 1,Y 2,Z 3,A 73.876,B -84.061,C -64.199}", last))
    for fraction in (0.1, 0.5, 0.95):
        wanted = targets(program, np.zeros((2, 3)), pieces={1: np.array([fraction])})
        written = krl.rewrite(program, wanted)
        assert "A 73.876" in written.documents[0].text.splitlines()[5]
        check_commands(program, wanted, written)


def test_a_target_behind_an_axis_target_keeps_what_the_controller_fills_in():
    axis = "PTP {A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0}"
    (lines, *_), _ = rewritten(body(FULL, axis, "LIN {X 7}", "LIN {X 8}"), raised=[0])
    assert lines[5:7] == ["LIN {X 7}", "LIN {X 8}"]


# --- relative targets --------------------------------------------------------------------------------------------


def test_a_relative_target_becomes_absolute_when_it_or_its_predecessor_changes():
    source = body(
        FULL, "  Lin_Rel {Z 30} C_DIS ; up", "LIN_REL {X 1} #TOOL", "LIN {X 1,Y 2,Z 3,A 0,B 0,C 0}", "LIN_REL {Y 1}"
    )
    (lines, *_), written = rewritten(source, raised=[0])
    assert lines[4] == "  Lin {X 100.0000,Y 20.0000,Z 60.0000,A 10.00000,B 20.00000,C 170.00000} C_DIS ; up"
    assert lines[5:8] == ["LIN_REL {X 1} #TOOL", "LIN {X 1,Y 2,Z 3,A 0,B 0,C 0}", "LIN_REL {Y 1}"]
    assert kinds(written) == ["relative-made-absolute"]
    (lines, *_), written = rewritten(source, raised=[2])
    assert lines[4] == "  Lin_Rel {Z 30} C_DIS ; up"
    assert lines[5].startswith("LIN {X 100.")
    assert "#TOOL" not in lines[5]


# --- inserted targets --------------------------------------------------------------------------------------------


def test_inserted_targets_stand_before_their_line_in_its_style():
    (lines, *_), written = rewritten(
        body(FULL + " C_DIS", "; to the end", "  lin {x 100, y 20, z 40, a 10, b 20, c 170} c_dis ; N20", FULL),
        raised=[1],
        pieces={1: [0.5]},
    )
    assert lines[4:7] == [
        "; to the end",
        "  lin {x 100.0000, y 20.0000, z 35.5000, a 10.00000, b 20.00000, c 170.00000} c_dis",
        "  lin {x 100.0000, y 20.0000, z 41.0000, a 10.00000, b 20.00000, c 170.00000} c_dis ; N20",
    ]
    assert written.output_line.tolist() == [4, 6, 7, 8]


@pytest.mark.parametrize(
    ("line", "tail"),
    [
        ("LIN {X 1,Y 2,Z 3,A 0,B 0,C 0}", " C_DIS"),
        ("LIN {X 1,Y 2,Z 3,A 0,B 0,C 0} C_VEL", " C_VEL"),
        ("SLIN {X 1,Y 2,Z 3,A 0,B 0,C 0}", " C_SPL"),
        ("PTP {X 1,Y 2,Z 3,A 0,B 0,C 0}", " C_PTP"),
        ("SLIN {X 1,Y 2,Z 3,A 0,B 0,C 0} WITH $VEL={CP 0.2}", " WITH $VEL={CP 0.2} C_SPL"),
    ],
)
def test_the_robot_does_not_stop_at_an_inserted_target(line, tail):
    program = read(body(FULL, line))
    written = krl.rewrite(program, targets(program, pieces={1: [0.25, 0.5]}))
    lines = written.documents[0].text.splitlines()
    assert [text.partition("}")[2] for text in lines[4:6]] == [tail, tail]
    assert lines[6].partition("}")[2] == line.partition("}")[2]


def test_the_robot_stops_at_an_inserted_target_where_the_distance_is_not_known():
    program = read(body(FULL, "$APO.CDIS=NEAR", "LIN {X 1,Y 2,Z 3}", "$APO.CDIS=1", "LIN {X 9,Y 2,Z 3}"))
    wanted = targets(program, pieces={1: [0.5], 2: [0.5]})
    written = krl.rewrite(program, wanted)
    check_commands(program, wanted, written, approximated=False)
    assert [line.count("C_DIS") for line in written.documents[0].text.splitlines()[5:10]] == [0, 0, 0, 1, 0]
    assert [(i.kind, i.source_line, "not known" in i.message) for i in written.issues] == [("stop-inserted", 6, True)]


def test_inserted_targets_of_an_inline_form_stand_inside_its_fold_with_numbers():
    lines = (
        FULL,
        ";FOLD LIN P1 Vel=0.1 m/s CPDAT1 Tool[2]:mill Base[3]:table;%{PE}%R 8.3.22,%P 1:LIN, 2:P1",
        "FDAT_ACT={TOOL_NO 2,BASE_NO 3,IPO_FRAME #BASE}",
        "BAS(#FRAMES)",
        "LIN XP1 C_DIS",
        ";ENDFOLD",
    )
    (src, dat), _ = rewritten(body(*lines), DATA, raised=[1], pieces={1: [0.5]})
    assert src[6] == "BAS(#FRAMES)"
    assert src[7].startswith("LIN {X ")
    assert src[7].endswith("} C_DIS")
    assert src[8:10] == ["LIN XP1 C_DIS", ";ENDFOLD"]
    assert dat[1].startswith("DECL E6POS XP1={X 100.2500,Y 200.5000,Z 301.0000,A 10.00000,")
    assert dat[1].endswith(",S 2,T 10,E1 5.0}")


def test_a_comment_is_not_repeated_on_inserted_targets():
    source = body(FULL, "LIN {X 1,Y 2,Z 3,A 0,B 0,C 0} C_DIS ; FORCE FX=5", "LIN {X 9} ;note")
    (lines, *_), _ = rewritten(source, pieces={1: [0.5], 2: [0.5]})
    assert [line.partition(";")[2] for line in lines[4:8]] == ["", " FORCE FX=5", "", "note"]


LONG = "LIN {X 200,Y 20,Z 30,A 10,B 20,C 170}"  # 100 mm from FULL


def trigger(when):
    return f"TRIGGER WHEN {when} DO $OUT[1]=TRUE"


@pytest.mark.parametrize(
    ("when", "piece", "now"),
    [
        ("DISTANCE=0 DELAY=0", 0, None),
        ("DISTANCE=0 DELAY=50", 0, None),
        ("DISTANCE=0 DELAY=-10", 0, None),
        ("distance = 1 delay = 0", 2, None),
        ("DISTANCE=1 DELAY=-500", 2, None),
        ("DISTANCE=1 DELAY=200", 2, None),
        ("PATH=-20 DELAY=0", 2, None),
        ("PATH=-60 DELAY=0", 1, "PATH=-10 DELAY=0"),
        ("PATH = -60.5 DELAY=100", 1, "PATH = -10.5 DELAY=100"),
        ("PATH=-95 DELAY=0", 0, "PATH=-15 DELAY=0"),
        ("PATH=-120 DELAY=0", 0, "PATH=-40 DELAY=0"),
        ("PATH=7.5 DELAY=0", 2, None),
        ("PATH=0 DELAY=0", 2, None),
        ("PATH=10 ONSTART DELAY=0", 0, None),
        ("PATH=30 ONSTART DELAY=0", 1, "PATH=10 ONSTART DELAY=0"),
        ("PATH=99 ONSTART DELAY=0", 2, "PATH=49 ONSTART DELAY=0"),
    ],
)
def test_a_trigger_stands_before_the_piece_on_which_it_switches(when, piece, now):
    """Pieces of 20, 30 and 50 mm at 0.05 m/s."""
    source = body("$VEL.CP=0.05", FULL, trigger(when), "; comment", LONG, FULL)
    (lines, *_), written = rewritten(source, raised=[2], pieces={1: [0.2, 0.5]})
    at = lines.index(trigger(now or when))
    assert [line.startswith("LIN {") for line in lines[5:10]].count(True) == 3
    assert sum(line.startswith("LIN {") for line in lines[5:at]) == piece
    assert "\n".join(lines).count("TRIGGER") == 1
    assert written.output_line.tolist() == [n for n, line in enumerate(lines, 1) if line.startswith("LIN {")]
    assert kinds(written) == []


def test_triggers_in_any_order_all_stand_where_they_must():
    order = ["DISTANCE=1 DELAY=0", "PATH=-60 DELAY=0", "DISTANCE=0 DELAY=0", "PATH=-1 DELAY=0"]
    source = body(FULL, *map(trigger, order), LONG, FULL, trigger(order[0]), LONG)
    (lines, *_), written = rewritten(source, raised=[2], pieces={1: [0.2, 0.5], 3: [0.1]})
    short = [line[:15] if line.startswith("LIN") else line.removeprefix("TRIGGER WHEN ")[:8] for line in lines[4:]]
    assert [s if s.startswith(("DIST", "PATH")) else s[:3] for s in short] == [
        "DISTANCE", "LIN", "PATH=-10", "LIN", "PATH=-1 ", "DISTANCE", "LIN", "LIN", "LIN", "DISTANCE", "LIN", "END"
    ]  # fmt: skip
    assert lines[4] == trigger(order[2])
    assert lines[9] == trigger(order[0])
    assert written.output_line.tolist() == [n for n, line in enumerate(lines, 1) if line.startswith("LIN {")]


def test_a_trigger_behind_which_other_statements_stand_refers_to_the_first_piece():
    source = body(FULL, trigger("PATH=-95 DELAY=0"), "$VEL.CP=0.1", LONG)
    (lines, *_), written = rewritten(source, raised=[1], pieces={1: [0.5]})
    assert lines[4] == trigger("PATH=-45 DELAY=0")
    assert kinds(written) == []


@pytest.mark.parametrize(
    "lines",
    [
        [trigger("PATH=-5 DELAY=0"), "$VEL.CP=0.1"],
        [trigger("DISTANCE=1 DELAY=0"), "$VEL.CP=0.1"],
        [trigger("DISTANCE=0 DELAY=1500")],
        [trigger("PATH=-55 DELAY=200")],
        [trigger("PATH=D DELAY=0")],
        [trigger("DISTANCE=1 DELAY=-T")],
        [trigger("DISTANCE=I DELAY=0")],
    ],
)
def test_a_trigger_that_cannot_be_kept_right_is_an_error(lines):
    """Pieces of 50 mm at 0.05 m/s."""
    source = body("$VEL.CP=0.05", FULL, *lines, LONG)
    _, written = rewritten(source, raised=[1], pieces={1: [0.5]})
    (issue,) = written.issues
    assert (issue.kind, issue.level, issue.source_line) == ("trigger", "error", 6)
    _, written = rewritten(source, raised=[1])
    assert not written.issues


# --- circles -----------------------------------------------------------------------------------------------------

START = "LIN {X 10,Y 0,Z 0,A 0,B 90,C 0} C_DIS"


def test_a_circle_is_corrected_in_place():
    (lines, *_), _ = rewritten(
        body(START, "CIRC {X 0,Y 10,Z 0}, {X -10,Y 0,Z 0,A 0,B 90,C 0} C_DIS ; arc"), raised=[0, 1]
    )
    assert lines[4].endswith(", {X -10.0000,Y 0.0000,Z 1.0000,A 0.00000,B 90.00000,C 0.00000} C_DIS ; arc")
    assert lines[4].startswith("CIRC {X 0.0000,Y 10.0000,Z 0.5000}, ")


def test_a_circle_is_divided_into_circles_or_lines():
    source = body(START, "circ {x 0,y 10,z 0},{x -10,y 0,z 0} C_DIS")
    (lines, *_), _ = rewritten(source, raised=[1], pieces={1: [0.5]})
    assert lines[4].startswith("circ {x 7.0711,y 7.0711,z ")
    assert lines[5].startswith("circ {x -7.0711,y 7.0711,z ")
    (lines, *_), _ = rewritten(source, raised=[1], pieces={1: [0.25, 0.5, 0.75]}, straight=True)
    assert [line[:6] for line in lines[4:8]] == ["lin {x"] * 4
    assert lines[7].startswith("lin {x -10.0000,y 0.0000,z 1.0000} C_DIS")


def test_a_circular_angle_is_dropped_when_the_arc_is_written_anew():
    source = body(START, "CIRC {X 0,Y 10,Z 0},{X -10,Y 0,Z 0},CA 450 C_DIS ; more than once around")
    (lines, *_), written = rewritten(source, raised=[1], pieces={1: [0.2, 0.4, 0.6, 0.8]})
    assert not any("CA" in line for line in lines)
    assert lines[8].endswith("{X 0.0000,Y 10.0000,Z 1.0000} C_DIS ; more than once around")
    assert kinds(written) == ["angle-dropped"]


def test_a_kept_circle_with_an_angle_keeps_it():
    source = body(START, "CIRC {X 0,Y 10,Z 0},{X -10,Y 0,Z 0},CA 90 C_DIS", "LIN {X 5,Y 0,Z 0,A 0,B 90,C 0}")
    (lines, *_), written = rewritten(source, raised=[2])
    assert lines[4] == source.splitlines()[4]
    assert kinds(written) == []


# --- named points ------------------------------------------------------------------------------------------------


def test_a_point_used_once_is_corrected_where_it_is_declared():
    (src, dat), written = rewritten(body(FULL, "LIN XP1 C_DIS"), DATA, raised=[1])
    assert src[4] == "LIN XP1 C_DIS"
    assert dat[1] == (
        "DECL E6POS XP1={X 100.2500,Y 200.5000,Z 301.0000,A 10.00000,B 20.00000,C 170.00000,S 2,T 10,E1 5.0}"
    )
    assert dat[2:] == DATA.splitlines()[2:]
    assert kinds(written) == []


def test_a_point_used_twice_with_the_same_correction_stays_one_point():
    (src, dat), _ = rewritten(body(FULL, "LIN XP1", FULL, "LIN XP1 C_DIS"), DATA, raised=[1, 3])
    assert (src[4], src[6]) == ("LIN XP1", "LIN XP1 C_DIS")
    assert len(dat) == len(DATA.splitlines())


def test_a_point_used_twice_with_different_corrections_becomes_two():
    program = read(body(FULL, "LIN XP1", FULL, "lin xp1 C_DIS", "LIN XP1"), DATA)
    shift = up(program, 1) + up(program, 3, by=2.0)
    wanted = keep_unmoved(program, targets(program, shift), shift)
    written = krl.rewrite(program, wanted)
    check_commands(program, wanted, written)
    src, dat = (document.text.splitlines() for document in written.documents)
    assert [src[line] for line in (4, 6, 7)] == ["LIN XP1_2", "lin xp1_3 C_DIS", "LIN XP1"]
    assert dat[1] == DATA.splitlines()[1]
    assert dat[2].startswith("DECL E6POS XP1_2={X 100.2500,Y 200.5000,Z 301.0000,")
    assert dat[3].startswith("DECL E6POS xp1_3={X 100.2500,Y 200.5000,Z 302.0000,")
    assert kinds(written) == ["new-point"]


def test_new_names_are_free_and_short_enough():
    name = "XPOINT_WITH_24_CHARACTRS"
    data = f"DEFDAT part\nDECL E6POS {name}={{X 1,Y 2,Z 3,A 4,B 5,C 6}}\nDECL INT {name[:17]}_18D4_2=5\nENDDAT\n"
    (src, dat), _ = rewritten(body(f"LIN {name}", FULL, f"LIN {name}"), data, raised=[0])
    assert src[3] == f"LIN {name[:17]}_18D4_3"
    assert dat[2].startswith(f"DECL E6POS {name[:17]}_18D4_3={{X 1.0000,")


def test_a_point_that_is_also_used_otherwise_stays_as_it_is():
    (src, dat), _ = rewritten(body(FULL, "LIN XP1", "IF XP1.Z>5 THEN", "HALT", "ENDIF"), DATA, raised=[1])
    assert src[4] == "LIN XP1_2"
    assert dat[1] == DATA.splitlines()[1]


def test_a_global_point_stays_as_it_is_for_the_programs_that_share_it():
    (src, dat), written = rewritten(body(FULL, "LIN XP2"), DATA, raised=[1])
    assert src[4] == "LIN XP2_2"
    assert dat[2] == DATA.splitlines()[2]
    assert dat[3].startswith("DECL E6POS XP2_2={X -50.5000,Y 20.0000,Z 251.12345678")
    assert kinds(written) == ["new-point"]


def test_an_incomplete_point_is_completed_in_the_data_file():
    (_, dat), _ = rewritten(body(FULL, "LIN XP2"), DATA, raised=[0])
    assert dat[2] == "DECL GLOBAL E6POS XP2={X -50.5,Y 20,Z 250.12345678}"
    program = read(body(FULL, "LIN XP2"), DATA)
    wanted = targets(program, turn=np.array([0.0, 1e-3]))
    written = krl.rewrite(program, wanted)
    check_commands(program, wanted, written)
    assert (
        written.documents[1].text.splitlines()[3].startswith("DECL E6POS XP2_2={X -50.5000,Y 20.0000,Z 250.12345678,A ")
    )


def test_elements_of_arrays_are_corrected_or_replaced_by_numbers():
    (src, dat), _ = rewritten(body("LIN P[1]", "LIN P[2]"), DATA, raised=[0])
    assert src[3:5] == ["LIN P[1]", "LIN P[2]"]
    assert dat[4] == "P[1]={X 1.0000,Y 2.0000,Z 4.0000,A 4.00000,B 5.00000,C 6.00000}"
    (src, dat), written = rewritten(body("LIN P[1]", FULL, "LIN P[1] C_DIS"), DATA, raised=[2])
    assert (src[3], src[5]) == ("LIN P[1]", "LIN {X 1.0000,Y 2.0000,Z 4.0000,A 4.00000,B 5.00000,C 6.00000} C_DIS")
    assert dat == DATA.splitlines()
    assert kinds(written) == ["point-replaced"]


def test_points_of_the_source_file_are_corrected_where_they_are_assigned():
    source = body("DECL E6POS P1", "P1={X 1,Y 2,Z 3,A 4,B 5,C 6}", "LIN P1", "P1={X 7,Y 2,Z 3,A 4,B 5,C 6}", "LIN P1")
    (src, *_), _ = rewritten(source, raised=[1])
    assert src[4] == "P1={X 1,Y 2,Z 3,A 4,B 5,C 6}"
    assert src[6] == "P1={X 7.0000,Y 2.0000,Z 4.0000,A 4.00000,B 5.00000,C 6.00000}"


def test_chains_of_frames_are_replaced_by_numbers():
    (src, *_), written = rewritten(body("LIN P[1]:{X 1,Y 0,Z 0,A 0,B 0,C 0} C_VEL ; off"), DATA, raised=[0])
    along = pose_from_xyzabc([1, 2, 3, 4, 5, 6])
    x, y, z = along[:3, 3] * 1000 + along[:3, 0]
    assert src[3] == f"LIN {{X {x:.4f},Y {y:.4f},Z {z + 1:.4f},A 4.00000,B 5.00000,C 6.00000}} C_VEL ; off"
    assert kinds(written) == ["point-replaced"]


def test_a_ptp_to_a_shared_point_keeps_its_status_and_turn():
    (src, dat), _ = rewritten(body("PTP XP1", FULL, "PTP XP1"), DATA, raised=[2])
    assert src[5] == "PTP XP1_2"
    assert dat[2].endswith(",S 2,T 10,E1 5.0}")


def test_relative_circles_become_absolute_where_they_are_corrected():
    circles = ("CIRC_REL {X 10,Y 12},{X 25,Y -4} C_DIS ;in", "SCIRC_REL {y 9,x 3},{x 6},CA 400", "CIRC_REL {Y 5},{X 5}")
    (src,), written = rewritten(body(FULL, *circles), raised=[1, 2], pieces={2: [0.25, 0.5, 0.75]})
    assert src[4].startswith("CIRC {X 1")
    assert "},{X 125.0000,Y 16.0000,Z 31.0000," in src[4]
    assert src[4].endswith(" C_DIS ;in")
    assert sum(line.startswith("SCIRC {y ") for line in src) == 4
    assert "relative-made-absolute" in kinds(written)
    same = read(body(FULL, *circles))
    assert krl.rewrite(same, targets(same, keep=True)).documents[0].text == body(FULL, *circles)


# --- size --------------------------------------------------------------------------------------------------------


def test_long_programs_are_rewritten_in_bulk():
    values = np.random.default_rng(7).uniform(-170, 170, (20_000, 6)).round(4).tolist()

    def prepared(count):
        rows = ("LIN {X %s,Y %s,Z %s,A %s,B %s,C %s} C_DIS" % tuple(row) for row in values[:count])  # noqa: UP031
        program = read(body(*rows))
        pose = program.motions.target[:]
        pose[:, :3, 3] += 1e-4
        return program, programs.ends(program.motions, pose)

    program, wanted = prepared(len(values))
    check_commands(program, wanted, krl.rewrite(program, wanted))
    assert calls_for_each(lambda count: partial(krl.rewrite, *prepared(count))) < 0.1


def test_long_programs_of_circles_are_rewritten_in_bulk():
    values = np.random.default_rng(8).uniform(-170, 170, (3_000, 9)).round(4).tolist()

    def prepared(count):
        form = "CIRC {X %s,Y %s,Z %s},{X %s,Y %s,Z %s,A %s,B %s,C %s} C_DIS"
        program = read(body(START, *(form % tuple(row) for row in values[:count])))
        return program, targets(program, np.full((len(program.motions), 3), 1e-4))

    program, wanted = prepared(200)
    check_commands(program, wanted, krl.rewrite(program, wanted))
    assert calls_for_each(lambda count: partial(krl.rewrite, *prepared(count)), 1000, 3000) < 0.1


def test_angles_behind_a_b_beyond_90_degrees_are_written_together():
    program = read(body("LIN {X 0,Y 0,Z 0,A 0,B 169.9853,C 0.001}", "LIN {X 1,Y 1,Z 1}"))
    turn = np.array([1e-6, 0.0])
    wanted = targets(program, np.zeros((2, 3)), turn)
    lines = krl.rewrite(program, wanted).documents[0].text.splitlines()
    (line,) = [line for line in lines if "X 1" in line]
    assert all(f"{name} " in line for name in "ABC") or not any(f"{name} " in line for name in "ABC")
    check_commands(program, wanted, krl.rewrite(program, wanted))


def test_motions_of_all_kinds_are_where_they_were_said_to_be():
    source = body(
        "PTP {X 1,Y 2,Z 3,A 4,B 5,C 6,S 2,T 10}", START, "CIRC {X 0,Y 10,Z 0},{X -10,Y 0,Z 0}", "LIN_REL {Z 5}"
    )
    (lines, *_), written = rewritten(source, raised=[0, 1, 2, 3], pieces={1: [0.5], 2: [0.5], 3: [0.5]})
    words = [lines[line - 1].split()[0] for line in written.output_line]
    assert words == ["PTP", "LIN", "LIN", "CIRC", "CIRC", "LIN", "LIN"]
    assert {LIN, CIRC, PTP} == set(read("\r\n".join([*lines, ""])).motions.kind.tolist())


def test_a_target_written_as_numbers_keeps_its_external_axes_and_its_status():
    data = DATA.replace("C 6}", "C 6,E1 5}").replace("PUBLIC\r\n", "PUBLIC\r\nFRAME FR={X 1,Y 2,Z 3,A 0,B 0,C 0}\r\n")
    source = body("PTP FR:XP1", "LIN FR:XP1", "LIN P[1] C_DIS", "$OUT[1]=P[1].X>3")
    program = read(source, data)
    assert (program.motions.status[0], program.motions.turn[0]) == (2, 10)
    (lines, *_), _ = rewritten(source, data, raised=[0, 1, 2], pieces={1: [0.5]})
    assert lines[3].endswith(",S 2,T 10,E1 5}")
    assert lines[4].endswith(",E1 5} C_DIS")
    assert lines[5].endswith(",E1 5}")
    assert lines[6].endswith(",E1 5} C_DIS")
