"""Statements of cutter-location files one by one: the moves, events and errors of each, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.cell import Frame, Machine
from postproc.dialects.apt import systems
from postproc.dialects.apt.cycles import Cycle
from postproc.dialects.apt.survey import survey
from postproc.dialects.text import decode
from postproc.errors import InputError
from postproc.program import CIRC, LIN, PTP
from tests.dialects.apt_reading import AT_Z9, points, read
from tests.dialects.gcode_reading import CELL


def after_head(text, cell=CELL, head=AT_Z9):
    """Program of lines behind four of HEAD, which leads to X0 Y0 Z9; FINI ends it."""
    return read(f"{head}{text}\nFINI\n", cell)


def ends(text, cell=CELL):
    return points(after_head(text, cell))[1:].round(6).tolist()


def directions(program):
    return -program.motions.target[:, :3, 2]


def problems(text, cell=CELL):
    """Line and problem of each error."""
    with pytest.raises(InputError) as refused:
        read(text, cell)
    return str(refused.value)


@pytest.mark.parametrize("rapid", [False, True])
def test_the_first_move_counts_even_if_it_leads_to_the_start_of_the_cell(rapid):
    """X50 Y-100 Z450 by the forward kinematics of these tests."""
    begin = "UNITS/MM\nFEDRAT/600\n" + "RAPID\n" * rapid
    program = read(f"{begin}GOTO/50,-100,450\nGOTO/50,-100,400\nFINI\n")
    np.testing.assert_allclose(points(program), [[50, -100, 450], [50, -100, 400]], atol=1e-9)
    assert program.motions.kind.tolist() == [PTP if rapid else LIN, LIN]


def test_a_step_is_from_the_place_of_the_tool_in_the_unit_of_the_file():
    program = read("UNITS/INCHES\nFEDRAT/10,IPM\nRAPID\nGOTO/1,2,3,0,0.6,0.8\nGODLTA/0.5,-1,2\nFINI\n")
    np.testing.assert_allclose(points(program)[-1], [38.1, 25.4, 127.0], atol=1e-9)
    np.testing.assert_allclose(directions(program)[-1], [0, 0.6, 0.8], atol=1e-12)
    assert "GODLTA before the position is known" in problems("UNITS/MM\nFEDRAT/9\nGODLTA/1,2,3\nFINI\n")


MACHINE_WITH_HOME = Machine(home=(0.0, -90.0, 90.0, 0.0, 10.0, 0.0), clearance_Z=100.0)


def test_gohome_with_a_place_goes_there_in_rapid():
    program = after_head("GOTO/1,0,9\nGOHOME/4,5,60\nGOTO/7,5,60")
    np.testing.assert_allclose(points(program)[1:], [[1, 0, 9], [4, 5, 60], [7, 5, 60]], atol=1e-9)
    assert program.motions.rapid.tolist() == [True, False, True, False]
    assert "GOHOME" not in [issue.kind for issue in program.issues]


@pytest.mark.parametrize("word", ["RETRCT", "GOHOME"])
def test_a_retract_is_along_the_tool_up_to_the_clearance(word):
    """From Z9 by 91 mm up, 68.25 to the side with a tool of 0.6 in 0.8; not where the tool is high enough."""
    cell = replace(CELL, machine=Machine(clearance_Z=100.0))
    program = after_head(f"GOTO/1,0,9,0.6,0,0.8\n{word}\n{word}\nGOTO/80,0,99.9999995\n{word}", cell)
    np.testing.assert_allclose(points(program)[1:], [[1, 0, 9], [69.25, 0, 100], [80, 0, 99.9999995]], atol=1e-6)
    assert program.motions.rapid.tolist() == [True, False, True, False]
    for z, is_refused in ((0.21, False), (0.19, True)):
        text = f"{AT_Z9}GOTO/1,0,9,{np.sqrt(1 - z * z):.12f},0,{z}\n{word}\nFINI\n"
        if is_refused:
            assert "retract with a nearly horizontal tool" in problems(text, cell)
        else:
            assert points(read(text, cell))[-1, 2] == pytest.approx(100.0)
    assert f"{word}: " in problems(f"{AT_Z9}{word}\nFINI\n")
    before = read(f"UNITS/MM\n{word}\nRAPID\nGOTO/0,0,9\nFINI\n", cell)
    assert len(before.motions) == 1
    assert "RETRCT: how high it goes" in problems(f"{AT_Z9}RETRCT/5\nFINI\n", cell)


def test_behind_gohome_the_tool_comes_down_from_the_clearance():
    """Along its direction; a feed there is an error. A place above the clearance is reached at once."""
    cell = replace(CELL, machine=MACHINE_WITH_HOME)
    low = after_head("GOHOME\nRAPID\nGOTO/5,0,9,0.6,0,0.8", cell)
    np.testing.assert_allclose(points(low)[-2:], [[73.25, 0, 100], [5, 0, 9]], atol=1e-9)
    assert low.motions.kind.tolist()[-2:] == [PTP, LIN]
    assert low.motions.rapid.tolist()[-2:] == [True, True]
    high = after_head("GOHOME\nRAPID\nGOTO/5,0,101", cell)
    assert high.motions.kind.tolist()[-2:] == [PTP, PTP]
    assert "GOTO at feed behind GOHOME" in problems(f"{AT_Z9}GOHOME\nGOTO/5,0,9\nFINI\n", cell)
    np.testing.assert_allclose(points(high)[1], [0, 0, 100], atol=1e-9)
    without = after_head("GOHOME\nRAPID\nGOTO/5,0,9", replace(CELL, machine=Machine(home=MACHINE_WITH_HOME.home)))
    assert without.motions.kind.tolist() == [PTP, PTP, PTP]


def test_a_direction_holds_until_the_next_and_may_be_stated_alone():
    program = after_head("GOTO/1,0,9,0,0.6,0.8\nGOTO/2,0,9\nTLAXIS/0.6,0,0.8\nGOTO/3,0,9\nGOTO/4,0,9,0,0,1\nGOTO/5,0,9")
    expected = [[0, 0, 1], [0, 0.6, 0.8], [0, 0.6, 0.8], [0.6, 0, 0.8], [0, 0, 1], [0, 0, 1]]
    np.testing.assert_allclose(directions(program), expected, atol=1e-12)
    rounded = after_head("TLAXIS/0.60004,0,0.8\nGOTO/1,0,9")
    exact = np.array([0.60004, 0, 0.8]) / np.hypot(0.60004, 0.8)
    np.testing.assert_allclose(directions(rounded)[-1], exact, atol=1e-12)
    rounded = after_head("GOTO/1,0,9,0.60004,0,0.8\nGOTO/2,0,9")
    np.testing.assert_allclose(directions(rounded)[1:], [exact, exact], atol=1e-12)
    for statement in ("TLAXIS/0.7,0,0.8", "TLAXIS/0.6,0,0.81"):
        assert "does not have length 1" in problems(f"{AT_Z9}{statement}\nGOTO/1,0,9\nFINI\n")


def test_all_directions_that_have_not_length_1_are_named_with_their_lines():
    text = problems(
        f"{AT_Z9}GOTO/1,0,9,0,0,1\nGOTO/2,0,9,0,1,1\nGOTO/3,0,9,0,0,2\nGOTO/4,0,9\nGOTO/5,0,9,1,1,1\nFINI\n"
    )
    assert text.count("are not a direction of length 1") == 3
    for line in (6, 7, 9):
        assert f":{line}:" in text


@pytest.mark.parametrize(("z", "is_open"), [(1.0, False), (0.99999, True), (0.8, True)])
def test_multax_off_of_a_tilted_tool_needs_a_direction_again(z, is_open):
    """The rounding of a vertical one does not."""
    tilted = f"GOTO/1,0,9,{np.sqrt(1 - z * z):.12f},0,{z}\nMULTAX/OFF\n"
    text = f"{AT_Z9}{tilted}GOTO/2,0,9\nFINI\n"
    if is_open:
        assert "GOTO without a direction behind MULTAX/OFF" in problems(text)
    else:
        assert len(read(text).motions) == 3
    for more in ("GOTO/2,0,9,0,0,1\nGOTO/3,0,9", "TLAXIS/0,0,1\nGOTO/2,0,9"):
        np.testing.assert_allclose(directions(after_head(tilted + more))[-1], [0, 0, 1], atol=1e-12)
    for word in ("MULTAX", "MULTAX/ON"):
        assert len(after_head(f"GOTO/1,0,9,0.6,0,0.8\n{word}\nGOTO/2,0,9").motions) == 3
    assert "MULTAX is not understood" in problems(f"{AT_Z9}MULTAX/2\nFINI\n")


def heights(cycle, more="", hole="GOTO/10,0,4"):
    """Z of all moves behind the first, and whether each is rapid, of one hole with the top at Z4 and the tool at Z9."""
    program = after_head(f"{cycle}\n{hole}\nCYCLE/OFF{more}")
    return points(program)[1:, 2].round(6).tolist(), program.motions.rapid[1:].tolist(), program


def test_a_hole_is_drilled_from_near_its_top_and_the_tool_goes_back():
    """Above the hole at Z9, down to CLEAR in rapid, RAPTO further, at feed to the depth, and back."""
    z, rapid, program = heights("CYCLE/DRILL,DEPTH,12,MMPM,90,CLEAR,3,RAPTO,1,RETURN,8,DWELL,0.5")
    assert z == [9.0, 7.0, 6.0, -8.0, 12.0]
    assert rapid == [True, True, True, False, True]
    assert program.motions.feed[4] * 60e3 == pytest.approx(90.0)
    assert [(event.kind, event.value, event.before) for event in program.events] == [("dwell", 0.5, 5)]
    assert not program.motions.blend[4]  # an exact stop at the bottom
    low = after_head("RAPID\nGOTO/10,0,5\nCYCLE/DRILL,DEPTH,12,MMPM,90,CLEAR,3\nGOTO/20,0,4\nCYCLE/OFF")
    assert points(low)[1:].round(6).tolist() == [[10, 0, 5], [10, 0, 7], [20, 0, 7], [20, 0, -8], [20, 0, 7]]


def test_the_feed_of_a_hole_is_that_before_it_or_its_own():
    for words, feed in (("", 600.0), (",MMPM,90", 90.0), (",IPM,2", 50.8), (",MMPR,0.1", 120.0), (",IPR,0.01", 304.8)):
        text = f"SPINDL/1200,RPM,CLW\nCYCLE/DRILL,DEPTH,12{words},CLEAR,3\nGOTO/10,0,4\nCYCLE/OFF"
        program = after_head(text)
        cutting = ~program.motions.rapid
        np.testing.assert_allclose(program.motions.feed[cutting] * 60e3, feed)
    assert "no speed of the spindle" in problems(
        f"{AT_Z9}CYCLE/DRILL,DEPTH,1,MMPR,1,CLEAR,3\nGOTO/1,0,4\nCYCLE/OFF\nFINI\n"
    )


def test_pecks_go_on_from_just_above_the_last_depth():
    """STEP from where the feed begins; DEEP goes up to CLEAR in between, BRKCHP does not."""
    up = 0.254
    z, rapid, _ = heights("CYCLE/DEEP,DEPTH,12,STEP,5,MMPM,90,CLEAR,3,RAPTO,1")
    assert z == [9.0, 7.0, 6.0, 1.0, 7.0, 1.0 + up, -4.0, 7.0, -4.0 + up, -8.0, 7.0]
    assert rapid == [True, True, True, False, True, True, False, True, True, False, True]
    z, _, _ = heights("CYCLE/BRKCHP,DEPTH,12,STEP,5,MMPM,90,CLEAR,3,RAPTO,1")
    assert z == [9.0, 7.0, 6.0, 1.0, 1.0 + up, -4.0, -4.0 + up, -8.0, 7.0]
    z, _, _ = heights("CYCLE/BRKCHP2,DEPTH,12,1STPECK,8,SUBPECK,5,FEDTO,12,MMPM,90,RAPTO,3".replace("DEPTH,12,", ""))
    assert z == [9.0, 7.0, -1.0, -1.0 + up, -6.0, -6.0 + up, -8.0, 7.0]
    plain = Cycle(12.0, 3.0, 3.0, None, 90.0, 0.0, 0.0, 0.0, retracts_fully=False)
    assert list(plain.pecks()) == []
    whole = Cycle(12.0, 3.0, 3.0, None, 90.0, 0.0, 5.0, 5.0, retracts_fully=True)
    assert list(whole.pecks()) == [-2.0, -7.0]  # the last one, at the depth, is that of the hole


@pytest.mark.parametrize(
    ("words", "is_refused"),
    [
        ("DEPTH,12,CLEAR,3", False), ("DEPTH,-1,CLEAR,3", True), ("DEPTH,12,CLEAR,0", True),
        ("DEPTH,12,CLEAR,3,RAPTO,3", False), ("DEPTH,12,CLEAR,3,RAPTO,3.1", True), ("DEPTH,12,CLEAR,3,RAPTO,-1", True),
        ("DEPTH,12,CLEAR,3,RETURN,3", False), ("DEPTH,12,CLEAR,3,RETURN,2.9", True),
        ("DEPTH,12,CLEAR,3,RETURN,0", False),
    ],
)  # fmt: skip
def test_heights_of_a_hole_that_contradict_each_other_are_refused(words, is_refused):
    text = f"{AT_Z9}CYCLE/DRILL,{words}\nGOTO/10,0,4\nCYCLE/OFF\nFINI\n"
    if is_refused:
        assert "the heights of the cycle contradict each other" in problems(text)
    else:
        assert points(read(text))[:, 2].min() == pytest.approx(-8.0)


@pytest.mark.parametrize(("first", "is_refused"), [("8", False), ("0", True), ("-1", True)])
def test_the_first_peck_is_above_zero(first, is_refused):
    text = f"{AT_Z9}CYCLE/DEEP2,FEDTO,12,1STPECK,{first},SUBPECK,5,RAPTO,3\nGOTO/10,0,4\nCYCLE/OFF\nFINI\n"
    if is_refused:
        assert "1STPECK is not above zero" in problems(text)
    else:
        assert points(read(text))[3, 2] == pytest.approx(-1.0)  # 8 mm from 3 above the top at 4


def test_a_tool_that_turns_on_the_way_to_a_hole_is_refused():
    cycle = "CYCLE/DRILL,DEPTH,5,CLEAR,3\n"
    assert "the tool turns in a cycle" in problems(f"{AT_Z9}{cycle}GOTO/1,0,4,0,0,-1\nFINI\n")
    same = after_head(f"GOTO/1,0,9,0,0.6,0.8\n{cycle}GOTO/20,0,4,0,0.6,0.8\nCYCLE/OFF")
    bottom = np.array([20, 0, 4]) - 5.0 * np.array([0, 0.6, 0.8])
    np.testing.assert_allclose(points(same)[-2], bottom, atol=1e-9)
    assert "a cycle before the position is known" in problems(f"UNITS/MM\nFEDRAT/9\n{cycle}GOTO/1,0,4\nFINI\n")


ARC = "CIRCLE/-10,0,9,0,0,1,10\n"


def test_an_arc_needs_a_place_a_feed_and_an_end_of_its_own():
    for text, problem in (
        (f"UNITS/MM\nFEDRAT/9\n{ARC}GOTO/-10,10,9\nFINI\n", "arc before the position is known"),
        (f"{AT_Z9}{ARC}{ARC}GOTO/-10,10,9\nFINI\n", "an arc where none is possible"),
        (f"{AT_Z9}CYCLE/DRILL,DEPTH,5,CLEAR,3\n{ARC}GOTO/-10,10,9\nFINI\n", "an arc where none is possible"),
        (f"{AT_Z9}{ARC}RAPID\nGOTO/-10,10,9\nFINI\n", "an arc in rapid"),
        (f"{AT_Z9}CIRCLE/-10,0,9,0,0,1.01,10\nGOTO/-10,10,9\nFINI\n", "the axis of the arc does not have length 1"),
        (f"{AT_Z9}CIRCLE/-10,0,9,0,0,.99,10\nGOTO/-10,10,9\nFINI\n", "the axis of the arc does not have length 1"),
    ):
        assert problem in problems(text)
    made = after_head(f"{ARC}GOTO/-10,10,9")
    assert made.motions.kind.tolist() == [PTP, CIRC]
    np.testing.assert_allclose(made.motions.centre[1] * 1e3, [-10, 0, 9], atol=1e-9)
    assert made.motions.feed[1] * 60e3 == pytest.approx(600.0)


@pytest.mark.parametrize("turns", ["1", "10000"])
def test_turns_of_a_helix_are_whole_numbers_up_to_ten_thousand(turns):
    nx = "CIRCLE/-10,0,9,0,0,-1,10,.06,.5,9,0,TIMES,{}\nGOTO/-10,10,9"
    sweep = after_head(nx.format(turns)).motions.sweep[-1]
    assert sweep == pytest.approx(2 * np.pi * (int(turns) - 0.75))
    for wrong in ("0", "1.5", "10001", "MANY", "-2"):
        assert "TIMES is not a number of turns" in problems(f"{AT_Z9}{nx.format(wrong)}\nFINI\n")


@pytest.mark.parametrize(
    ("angle", "y", "problem"),
    [
        ("90", 10, None), ("450", 10, None), ("90.5", 10, None), ("90.7", 10, "disagrees with its end"),
        ("0", 10, "not above zero"), ("3690", 10, "not above zero"), ("3330", 10, None),
    ],
)  # fmt: skip
def test_a_stated_angle_leads_to_the_end_within_a_tenth_of_a_millimetre(angle, y, problem):
    """On a radius of 10 mm that is 0.57°; an angle may have several turns, up to ten."""
    text = f"{AT_Z9}MOVARC/-10,0,9,0,0,1,10,ANGLE,{angle}\nGOTO/-10,{y},9\nFINI\n"
    if problem:
        assert problem in problems(text)
        return
    turns = int(float(angle) // 360)
    assert read(text).motions.sweep[-1] == pytest.approx(2 * np.pi * (turns + 0.25))


@pytest.mark.parametrize(("words", "problem"), [
    ("-10,0,9,0,0,1,10,ANGLE", "MOVARC is not understood"), ("-10,0,9,0,0,1,10,TURN,90", "MOVARC is not understood"),
])  # fmt: skip
def test_movarc_needs_its_words(words, problem):
    assert problem in problems(f"{AT_Z9}MOVARC/{words}\nGOTO/-10,10,9\nFINI\n")


def tangent(circle, line, direction="0,1,0", on="ON"):
    return f"INDIRV/{direction}\nTLON,GOFWD/(CIRCLE/{circle}),{on},(LINE/{line})"


def test_an_arc_along_indirv_ends_where_its_line_does():
    """From X0 Y0 about X-10 Y0 along +Y: counter-clockwise; beyond half a turn the second end is named."""
    quarter = after_head(tangent("-10,0,9,10", "-10,0,9,-10,10,9"))
    assert quarter.motions.sweep[-1] == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(points(quarter)[-1], [-10, 10, 9], atol=1e-9)
    large = after_head(tangent("-10,0,9,10", "-10,0,9,-10,-10,9", on="ON,2,INTOF"))
    assert large.motions.sweep[-1] == pytest.approx(1.5 * np.pi)
    back = after_head(tangent("-10,0,9,10", "-10,0,9,-10,-10,9", direction="0,-1,0"))
    np.testing.assert_allclose((back.motions.sweep[-1], back.motions.normal[-1, 2]), (np.pi / 2, -1.0), atol=1e-12)
    for line, on in (("-10,0,9,-10,-10,9", "ON"), ("-10,0,9,-10,10,9", "ON,2,INTOF")):
        assert "the arc ends on the other side of its line" in problems(
            f"{AT_Z9}{tangent('-10,0,9,10', line, on=on)}\nFINI\n"
        )
    for on in ("ON", "ON,2,INTOF"):  # half a circle may be written either way
        half = after_head(tangent("-10,0,9,10", "-10,0,9,-20,0,9", on=on))
        assert half.motions.sweep[-1] == pytest.approx(np.pi)
    assert "TLON is not understood" in problems(
        f"{AT_Z9}{tangent('-10,0,9,10', '-10,0,9,-20,0,9', on='ON,3,INTOF')}\nFINI\n"
    )
    twice = f"{tangent('-10,0,9,10', '-10,0,9,-10,10,9')}\nTLON,GOFWD/(CIRCLE/-10,0,9,10),ON,(LINE/-10,0,9,-20,0,9)"
    assert "TLON is not understood" in problems(f"{AT_Z9}{twice}\nFINI\n")  # INDIRV holds for one arc
    assert "arc before the position is known" in problems(
        f"UNITS/MM\nFEDRAT/9\n{tangent('-10,0,9,10', '-10,0,9,-10,10,9')}\nFINI\n"
    )


def test_several_points_of_one_statement_divide_an_arc():
    divided = after_head(f"{ARC}GOTO/-10,10,9,-20,0,9,-10,-10,9")
    assert divided.motions.kind.tolist() == [PTP, CIRC, CIRC, CIRC]
    np.testing.assert_allclose(divided.motions.sweep[1:], np.pi / 2)
    assert "3 or 6 numbers" in problems(f"{AT_Z9}GOTO/-10,10,9,-20,0,9,1,2,3\nFINI\n")


def test_the_tool_of_a_change_is_one_of_the_cell_and_its_spindle_stands():
    tools = {"1": Frame(Z=300.0), "2": Frame(Z=350.0)}
    cell = replace(CELL, tools=tools)
    program = after_head("GOTO/1,0,9\nSPINDL/900,RPM,CLW\nLOADTL/2\nGOTO/2,0,9", cell, "LOADTL/1\n" + AT_Z9)
    assert [(event.kind, event.value) for event in program.events] == [
        ("tool_change", 1), ("spindle_on", 900), ("spindle_off", 0), ("tool_change", 2),
    ]  # fmt: skip
    assert program.motions.tool.tolist() == [1, 1, 2, 2]
    np.testing.assert_allclose(points(program)[1:], [[1, 0, 9], [1, 0, 9], [2, 0, 9]], atol=1e-9)
    assert program.motions.rapid.tolist() == [True, False, True, False]
    again = after_head("GOTO/1,0,9\nLOADTL/1\nGOTO/2,0,9", cell, "LOADTL/1\n" + AT_Z9)
    assert len(again.motions) == 3
    assert "null-move" not in [issue.kind for issue in again.issues]
    for word, problem in (
        ("3", "tool 3 is not in the cell"), ("1.5", "not a whole number"), ("-1", "not a whole number"),
    ):  # fmt: skip
        assert problem in problems(f"{AT_Z9}LOAD/TOOL,{word},ADJUST,1\nFINI\n", cell)
    assert after_head("LOADTL/7\nGOTO/2,0,9").events[0].value == 7  # a cell without tools has any


def test_a_dwell_is_in_seconds_and_turns_of_the_spindle_are_refused():
    for text in ("DELAY/1.5", "DWELL/1.5", "DELAY/DWELL,1.5"):
        (event,) = after_head(f"{text}\nGOTO/2,0,9").events
        assert (event.kind, event.value, event.before) == ("dwell", 1.5, 1)
    assert "DELAY in turns" in problems(f"{AT_Z9}DELAY/2,REV\nFINI\n")


def test_the_spindle_keeps_its_direction_and_speed_until_others_are_given():
    program = after_head(
        "SPINDL/900,RPM,CCLW\nSPINDL/1000\nGOTO/1,0,9\nSPINDL/OFF\nSPINDL/ON\nGOTO/2,0,9\nSPINDL/CLW\nGOTO/3,0,9"
    )
    assert [(event.kind, event.value) for event in program.events] == [
        ("spindle_ccw", 900), ("spindle_ccw", 1000), ("spindle_off", 0), ("spindle_on", 1000), ("spindle_on", 1000),
        ("spindle_off", 0),
    ]  # fmt: skip


def test_a_file_ends_with_spindle_and_coolant_off_if_they_are_on():
    for text, kinds in (
        ("GOTO/1,0,9", []),
        ("SPINDL/900,RPM,CLW\nCOOLNT/ON\nGOTO/1,0,9", ["spindle_on", "coolant_on", "spindle_off", "coolant_off"]),
        ("SPINDL/900,RPM,CLW\nSPINDL/OFF\nCOOLNT/ON\nCOOLNT/OFF\nGOTO/1,0,9",
         ["spindle_on", "spindle_off", "coolant_on", "coolant_off"]),
    ):  # fmt: skip
        assert [event.kind for event in after_head(text).events] == kinds


def kinds_of(program):
    return [(issue.level, issue.kind, issue.source_line) for issue in program.issues]


def test_statements_behind_the_end_are_reported_with_all_their_lines():
    """FINI on the first line ends it too: nothing moves."""
    program = read(f"{AT_Z9}GOTO/1,0,9\nFINI\nGOTO/5,5,5\nRAPID\nFINI\n")
    assert len(program.motions) == 2
    (issue,) = [issue for issue in program.issues if issue.kind == "after-end"]
    assert (issue.level, issue.lines, issue.count) == ("warning", (7, 8), 2)
    assert "the program moves nothing" in problems(f"FINI\n{AT_Z9}GOTO/1,0,9\n")


@pytest.mark.parametrize(
    ("last", "is_cut_off"), [("FINI", False), ("END", False), ("END-OF-PATH", False), ("END-OF-PATH\nGOTO/2,0,9", True)]
)
def test_a_file_without_an_end_is_a_warning(last, is_cut_off):
    program = read(f"{AT_Z9}GOTO/1,0,9\n{last}\n")
    assert ("program-end" in [issue.kind for issue in program.issues]) == is_cut_off


def test_a_program_that_begins_with_partno_on_its_first_line_needs_fini():
    assert "begins with PARTNO but ends without FINI" in problems(f"PARTNO A\n{AT_Z9}GOTO/1,0,9\n")
    assert len(read(f"PARTNO A\n{AT_Z9}GOTO/1,0,9\nFINI\n").motions) == 2


def test_optional_statements_are_executed_and_said_to_be():
    program = after_head("OPSKIP/ON\nGOTO/1,0,9\nOPSKIP/OFF\nGOTO/2,0,9")
    assert [kind for kind in kinds_of(program) if kind[1] == "block-delete"] == [("info", "block-delete", 5)]


def test_work_offsets_and_systems_are_stated_once_and_may_be_repeated():
    program = after_head("MSYS/0,0,0,1,0,0,0,1,0\nMSYS/0,0,0,1,0,0,0,1,0\nZERO/2\nZERO/2\nGOTO/1,0,9")
    assert [kind for kind in kinds_of(program) if kind[1] == "coordinate-system"] == [
        ("info", "coordinate-system", 5), ("info", "coordinate-system", 7),
    ]  # fmt: skip
    (zero,) = [issue.message for issue in program.issues if "ZERO" in issue.message]
    assert "those of work offset 2, which is $BASE" in zero
    assert len(after_head("MCS/1,0,0,0,1,0,0,0,1,0,0,0\nGOTO/1,0,9").motions) == 2


CSYS = "TRNTYP/WORLD,0,0,0\nCSYS/{}\n"
LEVEL, TURNED = "1.,0,0,0,0,1.,0,0,0,0,1.,0", "0,-1.,0,5.,1.,0,0,6.,0,0,1.,7."


def test_axes_of_a_setup_are_at_right_angles_and_known_to_be_those_of_the_fixture():
    assert ends(CSYS.format(TURNED) + "GOTO/1,0,9") == [[1.0, 0.0, 9.0]]
    assert ends(f"CSYS/{LEVEL}\nGOTO/1,0,9") == [[1.0, 0.0, 9.0]]
    assert "CSYS without TRNTYP" in problems(f"{AT_Z9}CSYS/{TURNED}\nGOTO/1,0,9\nFINI\n")
    for wrong in ("1.,0,0,0,0,1.,0.01,0,0,0,1.,0", "1.,0,0,0,0,1.,0,0,0,0,.99,0", "1.,0.02,0,0,0,1.,0,0,0,0,1.,0"):
        assert "CSYS has no axes of length 1 at right angles" in problems(
            f"{AT_Z9}{CSYS.format(wrong)}GOTO/1,0,9\nFINI\n"
        )


COMPENSATED = "CUTCOM/{}\nGOTO/1,0,9\nCIRCLE/3,0,9,0,0,{},2\nGOTO/3,{},9\nCUTCOM/OFF\nGOTO/9,0,9"


@pytest.mark.parametrize(("side", "axis", "y", "is_centre"), [
    ("LEFT", 1, -2, True), ("RIGHT", -1, 2, True), ("LEFT", -1, 2, False), ("RIGHT", 1, -2, False),
])  # fmt: skip
def test_an_inside_arc_smaller_than_the_cutter_shows_the_path_of_its_centre(side, axis, y, is_centre):
    """To the left of the path counter-clockwise arcs are inside, to its right clockwise ones."""
    text = f"CUTTER/10\n{COMPENSATED.format(side, axis, y)}"
    if is_centre:
        assert "radius-compensation" in [issue.kind for issue in after_head(text).issues]
    else:
        assert "the radius of the tool is in the control" in problems(f"{AT_Z9}{text}\nFINI\n")
    small = problems(f"{AT_Z9}CUTTER/3.9\n{COMPENSATED.format('LEFT', 1, -2)}\nFINI\n")
    assert "the radius of the tool is in the control" in small


def test_compensation_without_a_side_needs_wear_offsets():
    assert "the radius of the tool is in the control" in problems(f"{AT_Z9}CUTCOM/ON\nGOTO/1,0,9\nFINI\n")
    wear = replace(CELL, gcode=replace(CELL.gcode, radius_offsets="wear"))
    program = after_head("CUTCOM/ON\nGOTO/1,0,9\nCUTCOM/OFF\nCUTCOM/OFF\nGOTO/2,0,9", wear)
    assert [kind for kind in kinds_of(program) if kind[1] == "radius-compensation"] == [
        ("info", "radius-compensation", 5)
    ]


@pytest.mark.parametrize("direction", ["0,0,-1", "0,0,1"])
def test_a_tool_from_below_alone_is_read_and_from_both_sides_is_not(direction):
    program = read(f"UNITS/MM\nFEDRAT/600\nRAPID\nGOTO/0,0,9,{direction}\nGOTO/5,0,9\nFINI\n")
    np.testing.assert_allclose(directions(program), [[float(word) for word in direction.split(",")]] * 2, atol=1e-12)
    level = read("UNITS/MM\nFEDRAT/600\nRAPID\nGOTO/0,0,9,0,0,1\nFINI\n").motions.target[0, :3, :3]
    turned = level if direction == "0,0,1" else np.diag([1.0, -1.0, -1.0]) @ level  # half a turn about X
    np.testing.assert_allclose(program.motions.target[:, :3, :3], [turned, turned], atol=1e-12)
    other = "0,0,-1" if direction == "0,0,1" else "0,0,1"
    text = problems(
        f"UNITS/MM\nFEDRAT/600\nRAPID\nGOTO/0,0,9,{direction}\nGOTO/1,0,9,0,1,0\nGOTO/5,0,9,{other}\nFINI\n"
    )
    sides = ("above", "below") if direction == "0,0,1" else ("below", "above")
    assert f"the tool comes from {sides[1]}, and from {sides[0]} in line 4" in text
    assert ":6:" in text
    side = read("UNITS/MM\nFEDRAT/600\nRAPID\nGOTO/0,0,9,0,1,0\nGOTO/1,0,9,0,0,-1\nFINI\n")
    np.testing.assert_allclose(directions(side), [[0, 1, 0], [0, 0, -1]], atol=1e-12)


def test_moves_of_zero_length_are_left_out_but_for_a_turn_of_the_tool():
    program = after_head("GOTO/1,0,9\nGOTO/1,0,9\nGOTO/1,0,9,0,0.6,0.8\nGOTO/1,0,9,0,0.6,0.8\nGOTO/2,0,9")
    np.testing.assert_allclose(points(program)[1:], [[1, 0, 9], [1, 0, 9], [2, 0, 9]], atol=1e-9)
    (issue,) = [issue for issue in program.issues if issue.kind == "null-move"]
    assert (issue.lines, issue.count) == ((6, 8), 2)
    assert program.still.tolist() == [6, 8]


def test_forces_of_comments_hold_from_the_next_motion_up_to_the_end_of_the_program():
    text = (
        f"$$ FORCE FX=1\n{AT_Z9}$$ FORCE FX=2\nGOTO/1,0,9\nPPRINT/FORCE FX=3\nGOTO/2,0,9\n$$ last\nFINI\n"
        "GOTO/9,9,9\n$$ FORCE FX=4\n$$ behind it\n"
    )
    program = read(text)
    assert [(note.wrench[0], note.before) for note in program.notes] == [(1.0, 0), (2.0, 1), (3.0, 2)]
    assert [(event.kind, event.text, event.before) for event in program.events] == [("comment", "last", 3)]


def surveyed(text):
    return survey(decode("part.apt", text.encode()))


def test_a_survey_leaves_out_tool_numbers_that_are_none():
    assert surveyed(f"LOADTL/{'9' * 5000}\nLOADTL/7\n").tool_changes == ((2, 7),)


def test_a_survey_has_tools_cutters_switches_and_unit():
    found = surveyed(
        "UNITS/INCHES\n$$ made by hand\nLOADTL/3\nCUTTER/10,0,5\nSPINDL/900,RPM\nLOAD/TOOL,12,ADJUST,1\nCOOLNT/MIST\n"
    )
    assert found.tool_changes == ((3, 3), (6, 12))
    assert found.comments == ((2, "made by hand"), (4, "CUTTER/10,0,5"))
    assert found.switches == {"spindle", "coolant"}
    assert found.inches
    off = surveyed("UNITS/MM\nSPINDL/OFF\nCOOLNT/FLOOD,OFF\nGOTO/1,2,3\n")
    assert (off.tool_changes, off.comments, off.switches, off.inches) == ((), (), frozenset(), False)


AXES = ("$$ 1.0 0.0 0.0 0.0", "$$ 0.0 1.0 0.0 0.0", "$$ 0.0 0.0 1.0 0.0")


@pytest.mark.parametrize("row", [None, 0, 1, 2])
def test_each_axis_of_a_system_of_catia_counts(row):
    second = [line.replace("0.0", "0.5", 1) if k == row else line for k, line in enumerate(AXES)]
    lines = [
        "*CATIA0",
        "Axis 1",
        *(line[3:] for line in AXES),
        "more",
        "*CATIA0",
        "Axis 2",
        *(line[3:] for line in second),
    ]
    comments = list(enumerate(lines, start=1))
    assert systems.changed_axis_systems(comments) == ([] if row is None else [7])


@pytest.mark.parametrize(
    ("text", "is_moved"),
    [("-> CSYS / 1,0,0,0,$ 0,1,0,0,$ 0,0,1,0", False), ("-> CSYS / 1,0,0,5,$ 0,1,0,0,$ 0,0,1,0", True),
     ("CSYS / 1,0,0,5", False), ("-> FEATNO / 5", False), ("-> CSYS / A", True)],
)  # fmt: skip
def test_a_system_of_a_sequence_of_creo_is_compared_with_that_of_the_machine(text, is_moved):
    assert systems.is_moved(text) == is_moved
    assert systems.sequence_lines([(5, "-> FEATNO / 9"), (2, "-> FEATNO / 8"), (3, "more")]) == [2, 5]
    assert [systems.sequence_at([2, 5], line) for line in (1, 2, 4, 5, 9)] == [0, 1, 1, 2, 2]
