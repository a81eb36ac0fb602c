"""RAPID just within and just beyond each limit: targets, frames, durations, jumps, names and lines of the cell."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.dialects.rapid import language
from postproc.errors import PostprocError
from postproc.program import CIRC, LIN, PTP
from tests.dialects.rapid_reading import AXES, MOVE_HOME, TOOLDATA, WOBJ, at, module, read, tail
from tests.dialects.test_rapid_execution import move, positions, refusal, routine

GOOD = f"MoveL {at(0, 0, 20)}{tail()}"


def configured(configuration, axes=AXES):
    return f"[[0,0,20],[0,1,0,0],{configuration},{axes}]"


LIMITS = {
    "coordinate": (at(100000, 0, 0), at(0, -100001, 0), "no robot reaches this target"),
    "coordinate z": (at(0, 0, -100000), at(0, 0, 100001), "no robot reaches this target"),
    "coordinate x": (at(0, 0, 20), at(-100001, 0, 0), "no robot reaches this target"),
    "quaternion": (at(0, 0, 20, "[0,1.00049,0,0]"), at(0, 0, 20, "[0,1.00051,0,0]"), "not a unit quaternion"),
    "small quaternion": (at(0, 0, 20, "[0,0,0.99951,0]"), at(0, 0, 20, "[0,0,0,0.99949]"), "not a unit quaternion"),
    "real part": (at(0, 0, 20, "[-1,0,0,0]"), at(0, 0, 20, "[1.1,0,0,0]"), "not a unit quaternion"),
    "cfx": (configured("[0,0,0,7]"), configured("[0,0,0,8]"), "configuration (cf1, cf4, cf6, cfx) is not understood"),
    "cfx below 0": (configured("[0,0,0,0]"), configured("[0,0,0,-1]"), "configuration (cf1, cf4, cf6, cfx) is not"),
    "cf1": (configured("[-9,0,0,0]"), configured("[0.5,0,0,0]"), "configuration (cf1, cf4, cf6, cfx) is not"),
    "cf4": (configured("[0,-3,0,0]"), configured("[0,0.5,0,0]"), "configuration (cf1, cf4, cf6, cfx) is not"),
    "cf6": (configured("[0,0,4,0]"), configured("[0,0,-1.5,0]"), "configuration (cf1, cf4, cf6, cfx) is not"),
    **{
        f"axis {letter}": (
            configured("[0,0,0,0]", f"[{','.join(['0'] * 6)}]"),
            configured("[0,0,0,0]", f"[{','.join('-2.5' if k == column else '9E9' for k in range(6))}]"),
            f"the external axis eax_{letter} is at -2.5",
        )
        for column, letter in enumerate("abcdef")
    },
}


@pytest.mark.parametrize("kind", LIMITS)
@pytest.mark.parametrize("as_via", [False, True])
def test_a_target_is_refused_beyond_its_limit_at_its_line(kind, as_via):
    """The first of several; the point on a circle has the same limits, but no external axes."""
    within, beyond, words = LIMITS[kind]
    if as_via and kind.startswith("axis"):
        return
    end = at(40, 0, 20)
    lines = [f"MoveL {within}{tail()}", f"MoveC {within if as_via else at(20, 20, 20)},{end}{tail()}"]
    if not as_via:
        assert len(read(module(lines)).motions) == 3
    bad = f"MoveC {beyond},{end}{tail()}" if as_via else f"MoveL {beyond}{tail()}"
    good = f"MoveC {at(20, 20, 20)},{end}{tail()}" if as_via else GOOD
    with pytest.raises(PostprocError) as refused:
        read(module([GOOD, good, GOOD, bad, GOOD, bad]))
    assert words in refused.value.problem
    assert refused.value.text == bad
    first = module([]).splitlines().index(f"    {MOVE_HOME}") + 1
    assert refused.value.line == first + 4


@pytest.mark.parametrize(("column", "letter"), list(enumerate("abcdef")))
def test_external_axes_of_joint_targets_are_refused_too(column, letter):
    axes = ",".join("7" if k == column else "0" for k in range(6))
    bad = f"MoveAbsJ [[0,10,20,0,60,0],[{axes}]],v200,fine,tMill\\WObj:=wPart;"
    with pytest.raises(PostprocError) as refused:
        read(module([GOOD, bad, GOOD]))
    assert f"the external axis eax_{letter} is at 7" in refused.value.problem
    assert f"{letter} at 0, or at 9E9" in refused.value.advice
    assert refused.value.text == bad


FRAMES = {
    "tool held by the room": (TOOLDATA, TOOLDATA.replace("[TRUE,", "[FALSE,"), "the tool is fixed in the room"),
    "tool too far": (TOOLDATA, TOOLDATA.replace("[0,0,350]", "[0,100001,0]"), "the frame is beyond any cell"),
    "tool not a unit": (
        TOOLDATA,
        TOOLDATA.replace("[1,0,0,0]]", "[1.0006,0,0,0]]", 1),
        "the frame is not a unit quaternion",
    ),
    "user frame too far": (WOBJ, WOBJ.replace("1500", "-100001"), "the frame is beyond any cell"),
    "object frame too far": (WOBJ, WOBJ.replace("[0,0,0]", "[0,0,100001]"), "the frame is beyond any cell"),
    "object frame not a unit": (WOBJ, WOBJ.replace("[[0,0,0],[1,0,0,0]]", "[[0,0,0],[0,0.9994,0,0]]"), "not a unit"),
    "work object in the hand": (WOBJ, WOBJ.replace("[FALSE,TRUE", "[TRUE,TRUE"), "the robot holds the work object"),
    "work object that moves": (WOBJ, WOBJ.replace("[FALSE,TRUE", "[FALSE,FALSE"), "moves with the mechanical unit"),
    "work object of a unit": (WOBJ, WOBJ.replace('""', '"M7"'), "moves with the mechanical unit 'M7'"),
}


@pytest.mark.parametrize("kind", FRAMES)
def test_a_frame_that_cannot_be_used_is_refused_at_the_first_move_with_it(kind):
    before, after, words = FRAMES[kind]
    text = module([GOOD])
    assert before in text
    with pytest.raises(PostprocError) as refused:
        read(text.replace(before, after))
    assert words in refused.value.problem
    assert refused.value.text == MOVE_HOME


def test_frames_at_the_limits_are_read():
    """A hundred metres, and three decimals of a quaternion."""
    text = module([GOOD]).replace(TOOLDATA, TOOLDATA.replace("[0,0,350]", "[0,0,-100000]"))
    assert read(text).tools[0][2, 3] == pytest.approx(-100.0)
    text = module([GOOD]).replace(TOOLDATA, TOOLDATA.replace("[1,0,0,0]]", "[1.0004,0,0,0]]", 1))
    np.testing.assert_allclose(read(text).tools[0][:3, :3], np.eye(3), atol=1e-12)


def test_equal_frames_have_one_row_and_tools_without_a_name_another():
    """Tools with a name and equal values are one, whose names are kept; a tool written into the move has its own."""
    data = "\n".join(
        f"  PERS tooldata {name}:=[TRUE,[[0,0,{z}],[1,0,0,0]],[5,[0,0,100],[1,0,0,0],0,0,0]];"
        for name, z in (("tSame", 350), ("tLong", 400))
    )
    literal = "[TRUE,[[0,0,350],[1,0,0,0]],[5,[0,0,100],[1,0,0,0],0,0,0]]"
    tools = ["tSame", "tLong", "tMill", literal, "tLong", literal, "tSame"]
    program = read(module([f"MoveL {at(0, 0, 20)},v50,z1,{tool}\\WObj:=wPart;" for tool in tools], data))
    assert program.motions.tool.tolist() == [0, 0, 1, 0, 2, 1, 2, 0]
    np.testing.assert_allclose([tool[2, 3] for tool in program.tools], [0.35, 0.4, 0.35])
    assert program.tool_keys == (("tMill", "tSame"), ("tLong",), ())
    assert program.motions.base.tolist() == [0] * 8


def test_a_duration_gives_the_speed_along_the_line_or_the_arc():
    """40 mm in 2 s, a half circle of 40 mm in 4 s; joint motions have no speed."""
    code = [
        f"MoveL {at(0, 0, 20)},v50,fine,tMill\\WObj:=wPart;",
        f"MoveL {at(40, 0, 20)},v50\\T:=2,fine,tMill\\WObj:=wPart;",
        f"MoveC {at(20, 20, 20)},{at(0, 0, 20)},v50\\T:=4,fine,tMill\\WObj:=wPart;",
        f"MoveJ {at(30, 0, 20)},v50\\T:=4,fine,tMill\\WObj:=wPart;",
        f"MoveL {at(0, 0, 20)},v50,fine,tMill\\WObj:=wPart;",
    ]
    program = read(module(code))
    assert program.motions.kind.tolist() == [PTP, LIN, LIN, CIRC, PTP, LIN]
    np.testing.assert_allclose(program.motions.feed, [np.nan, 0.05, 0.02, 0.02 * np.pi / 4, np.nan, 0.05], rtol=1e-5)
    still = f"MoveL {at(40, 0, 20)},v50\\T:=3,fine,tMill\\WObj:=wPart;"
    with pytest.raises(PostprocError, match="a move without length has a duration") as refused:
        read(module([*code[:2], still, code[2]]))
    assert refused.value.text == still


TURNED = at(40, 0, 20, "[0.0087,0.99996,0,0]")
STAYS = at(40, 0, 20)


@pytest.mark.parametrize(
    ("setting", "kind", "target", "words"),
    [
        ("SingArea\\LockAxis4", "MoveL", TURNED, "the turn of the tool is not known under SingArea\\LockAxis4"),
        ("SingArea\\LockAxis4", "MoveL", STAYS, None),
        ("SingArea\\LockAxis4", "MoveJ", TURNED, None),
        ("SingArea\\LockAxis4", "MoveC", TURNED, "the turn of the tool is not known under SingArea\\LockAxis4"),
        ("SingArea\\Wrist", "MoveC", TURNED, "the turn along a circle is not known under SingArea\\Wrist"),
        ("SingArea\\Wrist", "MoveC", STAYS, None),
        ("SingArea\\Wrist", "MoveL", TURNED, None),
        ("CirPathMode\\CirPointOri", "MoveC", TURNED, "this CirPathMode is not followed"),
        ("CirPathMode\\CirPointOri", "MoveC", STAYS, None),
        ("CirPathMode\\CirPointOri", "MoveL", TURNED, None),
        ("CirPathMode\\ObjectFrame", "MoveC", TURNED, None),
        ("CirPathMode\\PathFrame", "MoveC", TURNED, None),
    ],
)
def test_a_turn_that_is_not_known_is_refused_where_the_tool_turns(setting, kind, target, words):
    via = f"{at(20, 20, 20)}," if kind == "MoveC" else ""
    last = f"{kind} {via}{target}{tail()}"
    text = module([GOOD, f"{setting};", last])
    if words is None:
        assert len(read(text).motions) == 3
        return
    with pytest.raises(PostprocError) as refused:
        read(text)
    assert refused.value.problem == words
    assert refused.value.text == last


@pytest.mark.parametrize(
    ("jump", "in_entry", "in_routine", "without_moves"),
    [
        ("RETURN;", True, False, True), ("GOTO over;", False, False, True), ("RAISE 5;", False, False, True),
        ("TRYNEXT;", False, False, True), ("RETRY;", False, False, True), ("EXIT;", True, True, True),
        ("Stop;", True, True, True),
    ],
)  # fmt: skip
def test_a_jump_that_an_input_decides_is_followed_where_it_skips_no_move(jump, in_entry, in_routine, without_moves):
    """RETURN in the program itself ends it; in a routine without moves what it may change is not known."""
    code = [f"IF di1=1 {jump}", "over:", move("x")]
    if in_entry:
        assert positions(code) == [1]
    else:
        error = refusal(code)
        assert f"it is not known whether {jump.split()[0].rstrip(';')} is executed: DI1" in error.problem
        assert error.text.startswith("IF di1=1")
    text = routine(f"IF di1=1 {jump}", "over:", move("x"))
    if in_routine:
        assert positions(["work;", move("y")], text) == [1, 2]
    else:
        assert "is executed: DI1" in refusal(["work;", move("y")], text).problem
    text = routine("x:=3;", f"IF di1=1 {jump}", "over:", "y:=5;")
    assert without_moves
    if jump in ("EXIT;", "Stop;"):
        assert positions(["work;", move("x")], text) == [3]
        assert positions(["work;", move("y")], text) == [5]
    else:
        for name in "xy":
            assert f"{name.upper()} is not known: WORK may change it" in refusal(["work;", move(name)], text).problem


@pytest.mark.parametrize(
    ("name", "fault", "valid"),
    [
        ("part_1", None, "part_1"), ("A", None, "A"), ("a" * 28, None, "a" * 28),
        ("a" * 29, "it has 29 characters, 28 are allowed", "a" * 28), ("_1", "does not begin with a letter", "P1"),
        ("1001", "does not begin with a letter", "P1001"), ("Gehäuse", "other characters", "Gehaeuse"),
        ("a b-c.d", "other characters", "a_b_c_d"), ("Öl  Ärger", "letter", "Oel_Aerger"),
        ("stop", "word of RAPID", "P_stop"), ("WHILE", "word of RAPID", "P_WHILE"), ("MoveX", "instruction", "P_MoveX"),
        ("Searchlight", "instruction", "P_Searchlight"), ("reMove", None, "reMove"), ("éclair", "letter", "eclair"),
        ("...", "letter", "P_PROGRAM" if language.fault_of("PROGRAM") else "PROGRAM"), ("Straße", "other", "Strasse"),
        ("a" * 27 + "._b", "it has 30", "a" * 27), ("Move" + "x" * 24, "instruction", "P_Move" + "x" * 22),
        ("9" * 28, "letter", "P" + "9" * 27), ("x€", "other", "x"),
    ],
    ids=lambda value: str(len(str(value))),
)  # fmt: skip
def test_names_are_those_that_the_controller_accepts(name, fault, valid):
    """28 letters, digits and underscores: the module has a prefix of four, and 32 are allowed."""
    if fault is None:
        assert language.fault_of(name) is None
    else:
        assert fault in language.fault_of(name)
    assert language.valid_name(name) == valid
    assert language.fault_of(valid) is None


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("", None), ("! anything; at all", None), ("SetDO do1,1;", None), ("Set do1;", None), ("n:=n+1;", None),
        ("a{2}:=3;", None), ("r.trans.x := 5;", None), ("myRoutine;", None), ("SetDO do1,1", "not a RAPID instruction"),
        ("SetDO do1,1; Stop;", "not a RAPID instruction"), ("1Stop;", "not a RAPID instruction"),
        ("GOTO a;", "GOTO changes the execution order"), ("exit;", "exit changes the execution order"),
        ("MoveL p,v1,z1,t;", "MoveL moves the robot"), ("velset 50,800;", "velset moves the robot"),
        ("tool_0:=tool_1;", "tool_0 is used by the moves"), ("WOBJ_12:=w;", "WOBJ_12 is used by the moves"),
        ("speed_1.v_tcp:=5;", "speed_1 is used by the moves"), ("zone_x:=5;", None), ("mytool_0:=5;", None),
        ("tool_0b:=5;", None), ("TPWrite\\Num:=5;", None),
    ],
    ids=lambda value: str(len(str(value))),
)  # fmt: skip
def test_lines_of_the_cell_between_moves(line, fault):
    problem = language.line_fault(line)
    assert problem is None if fault is None else fault in problem


def test_quadrants_begin_at_whole_right_angles_but_for_rounding():
    """cf1, cf4 and cf6 are those of J1, J4 and J6; a millionth of a degree is rounding."""
    for angle, quadrant in (
        (0.0, 0),
        (89.9, 0),
        (90.0, 1),
        (179.0, 1),
        (181.0, 2),
        (-0.1, -1),
        (-90.0, -1),
        (-91.0, -2),
    ):
        for offset, change in ((0.0, 0), (-5e-7, 0), (-2e-6, -1 if angle % 90 == 0 else 0)):
            abb = np.array([angle + offset, 10.0, 20.0, angle + offset, 30.0, angle + offset])
            q = language.joints_from_abb(abb)
            cf = language.configuration(q[None], np.array([2]))[0]
            assert cf.tolist() == [quadrant + change] * 3 + [0]
    expected = {0: 2, 1: 6, 2: 0, 3: 4, 4: 3, 5: 7, 6: 1, 7: 5}  # KUKA's bit 1 is the opposite of ABB's
    for status, cfx in expected.items():
        assert language.configuration(np.zeros((1, 6)), np.array([status]))[0, 3] == cfx
        assert language.status_from_cfx(np.array([cfx])).tolist() == [status]
