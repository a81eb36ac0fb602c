"""Reading KRL: what real programs hold, and what must be refused."""

from functools import partial
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from postproc.cell import Frame, Krl, Tool
from postproc.dialects.krl.read import plain_settings
from postproc.errors import CellError, ForceError, PostprocError, ProgramError
from postproc.frames import pose_from_xyzabc, xyzabc_from_pose
from postproc.poses import Poses
from postproc.program import CIRC, LIN, PTP
from tests.dialects.krl_programs import CELL, DATA, body, forward, numbers, read, sources
from tests.effort import calls_for_each

FULL = "LIN {X 100,Y 20,Z 30,A 10,B 20,C 170}"
FIVE = "{X 5,Y 0,Z 0,A 0,B 0,C 0}"
SLOW = settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck))


def kinds(program):
    return [issue.kind for issue in program.issues]


def assert_same(one, other):
    for part in ("motions", "layout"):
        for name in getattr(one, part).__struct_fields__:
            a, b = getattr(getattr(one, part), name), getattr(getattr(other, part), name)
            if isinstance(a, np.ndarray | Poses):
                a, b = np.asarray(a), np.asarray(b)
                assert a.dtype == b.dtype, name
                assert np.array_equal(a, b, equal_nan=True), name
    assert one.issues == other.issues
    assert one.notes == other.notes
    assert np.array_equal(one.bases, other.bases)


# --- plain settings -----------------------------------------------------------------------------------------------

_SETTINGS = [
    "$VEL.CP=0.05", " $vel.cp = 1 ;FORCE FX=1", "$VEL.CP=.3", "$VEL.CP=0", "$VEL.CP=101", "$VEL.CP=-1", "$VEL.CP=SPEED",
    "$VEL.CP=0.1+0.1", "$APO.CDIS=0.8", "\t$APO.CDIS=2. ; $VEL.CP=9", "$APO.CDIS=0", "$APO.CDIS=-1", "$APO.CDIS=NEAR",
    "$VEL={CP 0.2,ORI1 200}", "$APO.CVEL=50", "$ACC.CP=2", "$OUT[3]=TRUE", "$ANOUT[1]=0.5", "$ORI_TYPE=#CONSTANT",
    "BAS(#VEL_CP,.4)", "BAS(#CP_PARAMS,0.4)", "$BASE=BASE_DATA[3]", "$TOOL=TOOL_DATA[2]", "$VEL.ORI1=200", "WAIT SEC 0",
    "; $VEL.CP=3", "$OUT[1]=$IN[2]", "SPEED=0.7", "NEAR=5", "$VEL.CP=0.1 $VEL.CP=0.2", "$ADVANCE=1",
]  # fmt: skip
_MOVES = [
    FULL, f"{FULL} C_DIS", "LIN {X 90,Y 10,Z 30} C_DIS", "LIN P1 C_DIS", "LIN_REL {X 1}",
    "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}",
    "CIRC {X 90,Y 10,Z 30},{X 80,Y 20,Z 30} C_DIS", "LIN {X 70,Y 10,Z 30} WITH $VEL.CP=0.5 C_DIS",
]  # fmt: skip
_AROUND = [
    ("IF $IN[1] THEN", "ENDIF"), ("IF TRUE THEN", "ENDIF"), ("FOR I=1 TO 2", "ENDFOR"), ("WHILE $IN[1]", "ENDWHILE"),
    ("SPLINE", "ENDSPLINE"), ("REPEAT", "UNTIL $IN[2]"), ("IF $IN[1] THEN", "ELSE"), ("RETURN", ""), ("WAY( )", ""),
    ("ENDIF", ""), ("LOOP", ""),
]  # fmt: skip


@st.composite
def settings_between_motions(draw):
    """A program in which settings, motions and control structures alternate, and a routine that it calls."""

    def lines(depth):
        out = []
        for _ in range(draw(st.integers(1, 5))):
            kind = draw(st.integers(0, 9))
            if kind < 6:
                out.append(draw(st.sampled_from(_SETTINGS)))
            elif kind < 9 or depth > 1:
                out.append(draw(st.sampled_from(_MOVES)))
            else:
                opening, closing = draw(st.sampled_from(_AROUND[: len(_AROUND) - 3 * (draw(st.integers(0, 5)) > 0)]))
                out += [opening, *lines(depth + 1), closing]
                out += ["ENDIF"] if closing == "ELSE" else []
        return out

    begin = ["DEF part( )", "DECL INT I", "DECL REAL SPEED,NEAR", "DECL POS P1", "BAS (#INITMOV,0 )"]
    begin += ["SPEED=0.25", "NEAR=1.5", "P1={X 60,Y 10,Z 30,A 0,B 0,C 180}", FULL]
    return "\r\n".join([*begin, *lines(0), *lines(0), "END", "DEF WAY( )", *lines(2), "END", ""])


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(settings_between_motions(), st.booleans())
def test_plain_settings_mean_what_they_mean_as_statements(source, keep):
    cell = replace(CELL, krl=replace(CELL.krl, keep_unresolved=keep))

    def outcome():
        try:
            return read(source, DATA, cell)
        except PostprocError as error:
            return str(error)

    one = outcome()
    with patch.object(plain_settings, "scan", lambda source: plain_settings.no_settings()):
        other = outcome()
    if isinstance(one, str) or isinstance(other, str):
        assert one == other
    else:
        assert_same(one, other)


@pytest.mark.parametrize("line", ["$VEL.CP=0.25 ;a", "$APO.CDIS=1.5", "$OUT[3]=TRUE"])
def test_single_slips_anywhere_in_a_plain_setting_are_read_or_refused_as_in_a_statement(line):
    for at in range(len(line) + 1):
        for slip in [*_SLIPS, "$", "="][at % 7 :: 7]:
            assert_read_alike(body(FULL, line[:at] + slip + line[at:], f"{FULL} C_DIS"))
        assert_read_alike(body(FULL, line[:at] + line[at + 1 :], f"{FULL} C_DIS"))


def test_speed_and_distance_hold_until_they_are_set_anew_in_whatever_order_that_is():
    part = "LIN {X 1,Y 2,Z 3} C_DIS"
    speeds = ("$VEL.CP=0.01", part, "$VEL.CP=0.025", part, "$APO.CDIS=0.2", part, "$APO.CDIS=0.02", part, "$VEL.CP=0.3")
    motions = read(body(FULL, *speeds, part)).motions
    assert motions.feed[-5:].tolist() == [0.01, 0.025, 0.025, 0.025, 0.3]
    assert motions.blend[-3:].tolist() == pytest.approx([2e-4, 2e-5, 2e-5], rel=1e-12)


def test_settings_between_motions_are_read_in_bulk():
    speeds = np.random.default_rng(7).uniform(0.01, 1.0, 9_000).round(4)
    lines = [line for v in speeds for line in (f"$VEL.CP={v}", f"$APO.CDIS={v}", "LIN {X 1,Y 2,Z 3} C_DIS ;FORCE FX=1")]
    program = read(body(FULL, *lines))
    assert program.motions.feed[1:].tolist() == speeds.tolist()
    np.testing.assert_allclose(program.motions.blend[1:], speeds / 1000.0, rtol=1e-12)
    assert calls_for_each(lambda count: partial(read, body(FULL, *lines[: 3 * count]))) < 25  # one by one: over 300


# --- plain lines -------------------------------------------------------------------------------------------------


def test_a_plain_program_gives_its_numbers_in_si_units():
    program = read(body("$VEL.CP=0.05", "$APO.CDIS=0.8", FULL + " C_DIS", "PTP {X 1,Y 2,Z 3,A 0,B 90,C 0,S 2,T 34}"))
    m = program.motions
    assert m.kind.tolist() == [LIN, PTP]
    assert m.rapid.tolist() == [False, True]
    assert m.line.tolist() == [6, 7]
    np.testing.assert_allclose(m.target[0], pose_from_xyzabc([100, 20, 30, 10, 20, 170]), atol=1e-15)
    assert m.feed[0] == 0.05
    assert np.isnan(m.feed[1])
    assert m.blend.tolist() == [0.0008, 0.0]
    assert (m.status.tolist(), m.turn.tolist()) == ([-1, 2], [-1, 34])
    assert np.isnan(m.joints).all()
    assert np.isnan(m.sweep).all()


def assert_read_alike(source):
    """Whether plain lines are read all at once or as statements, the program or its refusal is the same.

    How far plain targets are away is looked at only where nothing else is wrong: those errors may be left out.
    """

    def outcome(bulk):
        try:
            return read(source, DATA, bulk=bulk)
        except PostprocError as error:
            return str(error)

    one, other = outcome(True), outcome(False)
    if isinstance(one, str):
        lines, told = one.splitlines(), other.splitlines()
        near = [line for line in told if "out of any robot's reach" not in line]
        assert [line for line in lines if "out of any robot's reach" not in line] == near
        assert lines == ([line for line in told if line in lines] if near else told[:1])
    else:
        assert not isinstance(other, str), other
        assert_same(one, other)


@SLOW
@given(sources())
def test_plain_lines_mean_what_they_mean_as_statements(source):
    assert_read_alike(source)


HEAD, TAIL = "DEF part( )\r\n", "END\r\n"
_SLIPS = [*"{},;:.+-eE 019XZACST\t\"'[]()#_", "", "E1 ", "S 9", "NaN", "1e999", "\r", "\r\n", "ä", "C_DIS", "LIN", ", "]


@SLOW
@given(
    sources(), st.lists(st.tuples(st.floats(0, 1), st.integers(0, 2), st.sampled_from(_SLIPS)), min_size=1, max_size=3)
)
def test_plain_lines_with_slips_are_read_or_refused_as_statements_are(source, slips):
    for place, removed, slip in slips:
        at = len(HEAD) + round(place * (len(source) - len(HEAD) - len(TAIL)))
        source = source[:at] + slip + source[at + removed :]
    assert_read_alike(source)


def test_a_speed_that_is_not_known_is_told_beside_other_faults_also_where_plain_lines_have_it():
    full = "LIN {X 1,Y 2,Z 3,A 4,B 5,C 6}"
    assert_read_alike(body("{" + full, full, "$VEL.CP=:0.05", full, "$APO.CDIS=:3", full + " C_DIS"))
    with pytest.raises(ProgramError) as caught:
        read(body("{" + full, full, "$VEL.CP=:0.05", full))
    assert [error.line for error in (caught.value, *caught.value.further_errors)] == [4, 6]


@pytest.mark.parametrize("line", ["LIN {X 100,Y 20,Z 30,A 10,B 20,C 170} C_DIS", "CIRC {X 9,Y 2,Z 3},{X 20,Y 9,Z 3}"])
def test_single_slips_anywhere_in_a_plain_line_are_read_or_refused_as_in_a_statement(line):
    for at in range(len(line) + 1):
        for slip in _SLIPS[at % 7 :: 7]:
            assert_read_alike(body("LIN {X 1,Y 2,Z 3,A 4,B 5,C 6}", line[:at] + slip + line[at:], line))
        assert_read_alike(body("LIN {X 1,Y 2,Z 3,A 4,B 5,C 6}", line[:at] + line[at + 1 :], line))


@pytest.mark.parametrize(
    "line",
    [
        "LIN {E6POS: X 100, Y 20, Z 30, A 10, B 20, C 170, E1 0.0, E2 0.0} C_Dis",
        "\tlin{x 100,y 20,z 30,a 10,b 20,c 170}C_DIS",
        "  Lin   { X 100 , Y 20 , Z 30 , A 10 , B 20 , C 170 } c_dis   ; SprutCAM",
        "LIN {POS: X 100.0000,Y 20.,Z 3E1,A 1.0E+1,B 200E-1,C 170} C_DIS C_DIS",
        'LIN {FRAME: X +100,Y 20,Z 30,A 10,B 20,C 170} C_DIS ;{X 5} "a;b"',
        "LIN {C 170,B 20,A 10,Z 30,Y 20,X 100} C_DIS",
        "LIN {X 100,Y 20,Z 30,A 10,B 20,C 170,S 2,T 'B100010'} C_DIS",
        "LIN {X 'H64',Y 20,Z 30,A 10,B 20,C 170} C_DIS",
        "SLIN {X 100,Y 20,Z 30,A 10,B 20,C 170} C_SPL",
    ],
)
def test_spellings_of_one_target_mean_the_same(line):
    program = read(body(line))
    np.testing.assert_allclose(numbers(program)[0], [100, 20, 30, 10, 20, 170])
    assert program.motions.blend[0] == 0.003
    assert_same(program, read(body(line), bulk=False))


def test_a_number_without_a_blank_before_it_is_read_only_with_a_sign():
    np.testing.assert_allclose(numbers(read(body("LIN {X-5.5,Y+2,Z 3,A 0,B 0,C 0}")))[0, :3], [-5.5, 2, 3])
    with pytest.raises(ProgramError, match="X5"):
        read(body("LIN {X5.5,Y 2}"))


def test_e_notation_of_the_controller_is_exact():
    program = read(body("LIN {X 214.483856,Y 1.16530820E-14,Z -6.5e+02,A 0,B 9.00000000E1,C 0}"))
    assert numbers(program)[0].tolist() == [214.483856, 1.16530820e-14, -650.0, 0.0, 90.0, 0.0]


def test_long_programs_are_read_in_bulk():
    rng = np.random.default_rng(5)
    values = rng.uniform(-900, 900, (20_000, 6)).round(4)
    lines = ["LIN {X %.4f,Y %.4f,Z %.4f,A %.4f,B %.4f,C %.4f} C_DIS" % tuple(row) for row in values]  # noqa: UP031
    assert np.array_equal(numbers(read(body(*lines))), values)
    assert calls_for_each(lambda count: partial(read, body(*lines[:count]))) < 0.05  # read one by one: over 100


@pytest.mark.parametrize(
    "line",
    [
        "CIRC {X 90,Y 10,Z 30},{X 80,Y 20,Z 30,A 10,B 20,C 170} C_DIS",
        "\tcirc{x 90,y 10,z 30,a 1,b 2,c 3} , {e6pos: x 80,y 20,z 30,e1 0.0}c_dis ; {X 5}",
        "SCIRC {POS: X 90.,Y 1E1,Z 30,S 2,T 10},{X +80,Y 20,Z 30,A 10} C_SPL",
        "CIRC {Y 10,X 90,Z 30},{X 80,Y 20,Z 30}",
        "CIRC {X 90,Y 10,Z 30,E1 0},{Z 30,X 80,Y 20} C_DIS",
        "CIRC XA,{X 80,Y 20,Z 30}",
        "CIRC {X 90,Y 10,Z 30},{X 80,Y 20,Z 30},CA 200 C_DIS",
    ],
)
def test_circles_are_read_in_bulk_as_one_by_one(line):
    points = "DECL POS XA\r\nXA={X 90,Y 10,Z 30}"
    program = read(body(points, "$APO.CDIS=2", FULL, line, FULL, "LIN {X 0} C_DIS", line, line.replace("80", "81")))
    assert program.motions.kind.tolist() == [LIN, CIRC, LIN, LIN, CIRC, CIRC]
    np.testing.assert_allclose(program.motions.target[1, 2, 3], 0.03, atol=1e-12)
    assert (program.motions.blend[1] > 0.0) == ("c_dis" in line.lower() or "C_SPL" in line)
    assert_same(program, read(body(points, "$APO.CDIS=2", FULL, line, FULL, "LIN {X 0} C_DIS", line,
                                   line.replace("80", "81")), bulk=False))  # fmt: skip
    with pytest.raises(ProgramError, match="2e"):
        read(body(FULL, "CIRC {X 90,Y 2E9,Z 1},{X 80,Y 20,Z 30} C_DIS"))


def test_long_programs_of_circles_are_read_in_bulk():
    ends = np.random.default_rng(6).uniform(-900, 900, (6_000, 9)).round(4).tolist()
    form = "CIRC {X %s,Y %s,Z %s},{X %s,Y %s,Z %s,A %s,B %s,C %s} C_DIS"
    lines = [form % tuple(row) for row in ends]
    assert calls_for_each(lambda count: partial(read, body(FULL, *lines[:count]))) < 0.1


def test_lines_that_are_alike_but_for_one_are_told_apart():
    """Lines that differ in their numbers only are decided at once: what is no number must not pass with them."""
    for odd in ("LIN {X #,Y 2,Z 3}", "LIN {X \1,Y 2,Z 3}", "LIN {X ,Y 2,Z 3}", "LIN {X 1 1,Y 2,Z 3}"):
        with pytest.raises(ProgramError):
            read(body(FULL, *["LIN {X 1,Y 2,Z 3}"] * 3, odd, "LIN {X 1,Y 2,Z 3}"))
    for component, fine, odd in (("S", "2", "99"), ("T", "35", "64"), ("E1", "0", "0 0")):
        line = "PTP {{X 1,Y 2,Z 3,A 0,B 0,C 0,{} {}}}"
        read(body(FULL, line.format(component, fine)))
        with pytest.raises(ProgramError):
            read(body(FULL, line.format(component, fine), line.format(component, odd)))


def test_bulk_lines_with_a_false_number_are_told_like_any_other():
    for text in ("1.2.3", "--5", ".", "1E", "5E+", "-E5"):
        with pytest.raises(ProgramError) as caught:
            read(body(FULL, f"LIN {{X 1,Y {text},Z 3}} C_DIS", FULL))
        assert caught.value.line == 5


# --- components that are missing ---------------------------------------------------------------------------------


def test_missing_components_keep_the_previous_value_and_are_told_once():
    program = read(body(FULL, "LIN {X 7}", "LIN {Z 8,C 160}", "PTP {Y -1}"))
    assert numbers(program)[1:].tolist() == [
        [7, 20, 30, 10, 20, 170],
        [7, 20, 8, 10, 20, 160],
        [7, -1, 8, 10, 20, 160],
    ]
    (issue,) = (issue for issue in program.issues if issue.kind == "missing-components")
    assert (issue.level, issue.source_line, issue.count) == ("info", 5, 3)


def test_angles_that_are_partly_missing_behind_a_b_beyond_90_degrees_are_refused():
    start = "LIN {X 1,Y 2,Z 3,A 10,B 100.5,C 20}"  # the same orientation is A -170, B 79.5, C -160
    assert len(read(body(start, "LIN {X 5}", "LIN {A 1,B 2,C 3}", "LIN {X 6,C 7}")).motions) == 4
    for line in ("LIN {X 5,C 30}", "LIN {A 1}", "LIN {B 20}"):
        with pytest.raises(ProgramError, match=r"previous B is 100\.5°") as caught:
            read(body(start, "LIN {X 5}", line))
        assert caught.value.line == 6


def test_missing_components_of_the_first_target_are_those_of_the_start_position():
    program = read(body("LIN {Z 10}"))
    tip = np.linalg.inv(CELL.base.pose()) @ forward(CELL.start_joints) @ CELL.tool.pose()
    expected = xyzabc_from_pose(tip)
    expected[2] = 10.0
    np.testing.assert_allclose(numbers(program)[0], expected, atol=1e-9)


def test_missing_components_right_after_a_change_of_frames_are_refused():
    with pytest.raises(ProgramError, match="not certain") as caught:
        read(body(FULL, f"$BASE={FIVE}", "LIN {X 7}"))
    assert caught.value.line == 6
    read(body(FULL, f"$BASE={FIVE}", FULL, "LIN {X 7}"))
    read(
        body(FULL, "$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}", "LIN {X 7}")
    )  # the same frame as before: nothing changed


def test_relative_targets_add_to_the_previous_position():
    program = read(body(FULL, "LIN_REL {Z 30}", "LIN_REL {X 10} #TOOL C_DIS", "PTP_REL {Y -5}", "SLIN_REL {X 1,Y 1}"))
    along = pose_from_xyzabc([0, 0, 0, 10, 20, 170])[:3, 0] * 10
    np.testing.assert_allclose(numbers(program)[1, :3], [100, 20, 60])
    np.testing.assert_allclose(numbers(program)[2, :3], np.array([100, 20, 60]) + along)
    np.testing.assert_allclose(numbers(program)[4, :3], np.array([101, 16, 60]) + along)
    assert program.motions.kind.tolist() == [LIN, LIN, LIN, PTP, LIN]


def test_relative_axis_targets_need_known_joints():
    program = read(body("PTP {A1 10,A2 -80,A3 90,A4 0,A5 40,A6 0}", "PTP_REL {A1 -30}", "PTP {A6 15}"))
    np.testing.assert_allclose(np.degrees(program.motions.joints[2]), [-20, -80, 90, 0, 40, 15])
    with pytest.raises(ProgramError, match="joint angles before"):
        read(body(FULL, "PTP_REL {A1 -30}"))


def test_axis_targets_stand_where_the_controllers_kinematics_puts_them():
    program = read(body("PTP {E6AXIS: A1 10,A2 -80,A3 90,A4 5,A5 40,A6 0,E1 0}"))
    flange = forward(np.radians([10, -80, 90, 5, 40, 0]))
    expected = np.linalg.inv(CELL.base.pose()) @ flange @ CELL.tool.pose()
    np.testing.assert_allclose(program.motions.target[0], expected, atol=1e-12)


# --- circles -----------------------------------------------------------------------------------------------------


def arc(tail, start="LIN {X 10,Y 0,Z 0,A 0,B 90,C 0}"):
    return read(body(start, f"CIRC {{X 0,Y 10,Z 0}},{{X -10,Y 0,Z 0}}{tail}")).motions


def test_a_circle_turns_from_start_through_the_auxiliary_point_to_the_end():
    m = arc("")
    assert m.kind[1] == CIRC
    np.testing.assert_allclose(m.centre[1], 0.0, atol=1e-15)
    np.testing.assert_allclose(m.normal[1], [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(m.sweep[1], np.pi)
    back = read(body("LIN {X 10,Y 0,Z 0,A 0,B 90,C 0}", "CIRC {X 0,Y -10,Z 0},{X 0,Y 10,Z 0}")).motions
    np.testing.assert_allclose(back.normal[1], [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(back.sweep[1], 1.5 * np.pi)


@pytest.mark.parametrize(
    ("angle", "end", "up"),
    [(90, (0, 10), 1), (-90, (0, -10), -1), (360, (10, 0), 1), (450, (0, 10), 1), (-540, (-10, 0), -1)],
)
def test_a_circular_angle_says_where_the_arc_ends(angle, end, up):
    m = arc(f",CA {angle} C_DIS")
    np.testing.assert_allclose(m.target[1, :2, 3] * 1000, end, atol=1e-12)
    np.testing.assert_allclose(m.normal[1], [0, 0, up], atol=1e-12)
    np.testing.assert_allclose(np.degrees(m.sweep[1]), abs(angle))


def test_what_follows_a_circular_angle_starts_at_the_true_end_of_the_arc():
    program = read(
        body("LIN {X 10,Y 0,Z 0,A 0,B 90,C 0}", "CIRC {X 0,Y 10,Z 0},{X -10,Y 0,Z 0},CA 270", "LIN_REL {Z 5}")
    )
    np.testing.assert_allclose(numbers(program)[2, :3], [0, -10, 5], atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(-500_000, 500_000), min_size=9, max_size=9))
def test_all_three_points_lie_on_the_circle(values):
    points = np.array(values).reshape(3, 3) / 1000
    a, b = points[1] - points[0], points[2] - points[0]
    assume(np.linalg.norm(np.cross(a, b)) > 1e-2 * max(a @ a, b @ b, 1.0))
    text = ["{" + ",".join(f"{n} {v:.3f}" for n, v in zip("XYZ", p, strict=True)) + "}" for p in points]
    m = read(body(f"LIN {text[0][:-1]},A 0,B 0,C 0}}", f"CIRC {text[1]},{text[2]}")).motions
    radius = np.linalg.norm(points / 1000 - m.centre[1], axis=1)
    np.testing.assert_allclose(radius, radius[0], rtol=1e-7)
    normal, out = m.normal[1], points / 1000 - m.centre[1]
    angle = [np.arctan2(np.cross(out[0], o) @ normal, out[0] @ o) % (2 * np.pi) for o in out]
    assert angle[1] < angle[2]
    np.testing.assert_allclose(m.sweep[1], angle[2], rtol=1e-7)


def test_points_on_a_line_are_no_circle():
    with pytest.raises(ProgramError, match="on a line") as caught:
        read(body(FULL, "CIRC {X 110,Y 20,Z 30},{X 120,Y 20,Z 30}"))
    assert caught.value.line == 5


def test_turning_the_tool_on_an_arc_with_a_circular_angle_is_refused():
    lines = ["LIN {X 10,Y 0,Z 0,A 0,B 90,C 0}", "CIRC {X 0,Y 10,Z 0},{X -10,Y 0,Z 0,A 5,B 80,C 0},CA 90"]
    with pytest.raises(ProgramError, match="orientation"):
        read(body(*lines))


# --- frames ------------------------------------------------------------------------------------------------------


def base_of(*lines, cell=CELL, data=None):
    program = read(body(*lines), data, cell)
    return xyzabc_from_pose(program.bases[program.motions.base[-1]]).round(9).tolist()


def test_a_program_that_sets_no_frames_uses_those_of_the_cell():
    assert base_of(FULL) == [1500, -200, 700, 0, 0, 0]
    program = read(body("BAS(#INITMOV,0)", FULL))
    assert (program.motions.base.tolist(), program.motions.tool.tolist()) == ([0], [0])


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["$BASE={X 1,Y 2,Z 3,A 4,B 5,C 6}"], [1, 2, 3, 4, 5, 6]),
        (["$BASE={FRAME: X 1,Y 2,Z 3,A 0,B 0,C 0}"], [1, 2, 3, 0, 0, 0]),
        (["$BASE=$NULLFRAME"], [0, 0, 0, 0, 0, 0]),
        (["$BASE = BASE_DATA[3]"], [1200, 100, 650, 30, 0, 0]),
        (["BAS (#BASE,3)"], [1200, 100, 650, 30, 0, 0]),
        (["BAS(#BASE,0)"], [0, 0, 0, 0, 0, 0]),
        (["INT n", "n=3", "$BASE=BASE_DATA[n]"], [1200, 100, 650, 30, 0, 0]),
        ([f"BASE_DATA[7]={FIVE}", "$BASE=BASE_DATA[7]"], [5, 0, 0, 0, 0, 0]),
        (["$BASE={A 90}:{X 10}"], [0, 10, 0, 90, 0, 0]),
        (["$BASE=BASE_DATA[3]:{X 0,Y 0,Z 5,A 0,B 0,C 0}"], [1200, 100, 655, 30, 0, 0]),
        ([f"$BASE={FIVE}", "$BASE=$BASE:{Y 2}"], [5, 2, 0, 0, 0, 0]),
        ([f"$BASE={FIVE}", "$BASE.Z=7"], [5, 0, 7, 0, 0, 0]),
        (["DECL FRAME F1", f"F1={FIVE}", "$BASE=F1"], [5, 0, 0, 0, 0, 0]),
        (["FDAT_ACT={TOOL_NO 0,BASE_NO 3,IPO_FRAME #BASE}", "BAS(#FRAMES)"], [1200, 100, 650, 30, 0, 0]),
    ],
)
def test_bases_by_literal_by_number_and_by_chain(lines, expected):
    np.testing.assert_allclose(base_of(*lines, FULL), expected, atol=1e-9)


@pytest.mark.parametrize(
    ("lines", "line", "problem"),
    [
        (["$BASE={X 1505}", FULL], 4, r"\$BASE is not known: Y, Z, A, B, C are not given"),
        (["$TOOL={X 1,Y 0,Z 5,A 0,B 0}", FULL], 4, r"\$TOOL is not known: C is not given"),
        (["BASE_DATA[7]={X 5}", "BAS(#BASE,7)", FULL], 5, r"Y, Z, A, B, C are not given in BASE_DATA\[7\]"),
        (["FRAME OFF", "OFF={Z 5}", "$BASE=OFF", FULL], 6, "X, Y, A, B, C are not given"),
        (["FRAME OFF", "OFF={Z 5}", "LIN OFF:{X 1,Y 2,Z 3,A 4,B 5,C 6}"], 6, "not all components of OFF are given"),
    ],
)
def test_components_of_a_frame_that_are_not_given_are_not_zero(lines, line, problem):
    with pytest.raises(ProgramError, match=problem) as caught:
        read(body(*lines))
    assert caught.value.line == line


def test_frames_change_from_motion_to_motion():
    program = read(body(FULL, f"$TOOL={FIVE}", FULL, "$BASE=$NULLFRAME", FULL, f"$TOOL={FIVE}", FULL))
    assert program.motions.tool.tolist() == [0, 1, 1, 1]
    assert program.motions.base.tolist() == [0, 0, 1, 1]
    assert len(program.tools) == 2


def test_a_config_dat_gives_frames_that_the_cell_does_not(tmp_path):
    (tmp_path / "$config.dat").write_bytes(
        b"DEFDAT $CONFIG PUBLIC\r\nBASE_DATA[3]={X 1200.0004,Y 100.0,Z 650.0,A 30.0,B 0.0,C -360.0}\r\n"
        b"BASE_DATA[5]={X 55.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0} ;table\r\n"
        b"DECL E6AXIS XHOME={A1 5.0,A2 -90.0,A3 90.0,A4 0.0,A5 0.0,A6 0.0,E1 0.0}\r\nENDDAT\r\n"
    )
    cell = replace(CELL, config_dat="$config.dat", folder=str(tmp_path))
    assert base_of("$BASE=BASE_DATA[5]", FULL, cell=cell)[0] == 55
    assert base_of("$BASE=BASE_DATA[3]", FULL, cell=cell)[0] == 1200  # equal within rounding: the cell's
    program = read(body("PTP XHOME", FULL), cell=cell)
    assert np.degrees(program.motions.joints[0, 0]) == pytest.approx(5)
    assert "home-from-cell" not in kinds(program)
    with pytest.raises(CellError, match="config_dat"):
        read(body(FULL), cell=replace(cell, config_dat="other.dat"))


FRAME = "{X 2100.0,Y 100.0,Z 650.0,A 30.0,B 0.0,C 0.0}"
CELLS_OWN = r"\{X 1200, Y 100, Z 650, A 30, B 0, C 0\} by \[base_data\.3\] of the cell"


def _two_frames(folder, where: str, text: str):
    """The program and the cell where one more file says something about frames by number."""
    data = f"DEFDAT {where}\n{text}\nENDDAT\n"
    (folder / f"{where}.dat").write_text(data)
    (folder / "sub.src").write_text("DEF sub( )\n$VEL.CP=0.02\nEND\n")
    krl = Krl(initmov="cell", search=["."])
    cell = replace(CELL, folder=str(folder), krl=krl, config_dat="config.dat" if where == "config" else None)
    own = data if where == "part" else None
    return lambda cell=cell: read(body("sub( )", "$BASE=BASE_DATA[3]", FULL), own, cell=cell)


@pytest.mark.parametrize("where", ["config", "part", "sub"])
@pytest.mark.parametrize("form", ["BASE_DATA[3]={}", "DECL FRAME BASE_DATA[3]={}", "DECL GLOBAL FRAME BASE_DATA[3]={}"])
def test_a_file_that_contradicts_a_frame_of_the_cell_is_an_error_with_both(where, form, tmp_path):
    with pytest.raises(CellError, match=CELLS_OWN) as caught:
        _two_frames(tmp_path, where, form.format(FRAME))()
    assert f"{{X 2100, Y 100, Z 650, A 30, B 0, C 0}} by {where}.dat, line 2" in str(caught.value)


@pytest.mark.parametrize(
    ("value", "agrees"),
    [
        ("{X 1200,Y 100,Z 650,A 30,B 0,C 0}", True),
        ("{X 1200,Y 100,Z 650,A -150,B 180,C 180}", True),  # the same orientation
        ("{X 1200.0009,Y 100,Z 650,A 30.0009,B 0,C 0}", True),
        ("{X 1200,Y 100,Z 650}", True),  # what is missing is the cell's
        ("{X 1200.002,Y 100,Z 650,A 30,B 0,C 0}", False),
        ("{X 1200,Y 100,Z 650,A 30,B 0.002,C 0}", False),
        ("{X 0,Y 0,Z 0,A 0,B 0,C 0}", False),
        ("{A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}", False),
    ],
)
def test_frames_by_number_may_differ_by_their_rounding(value, agrees, tmp_path):
    program = _two_frames(tmp_path, "config", f"BASE_DATA[3]={value}")
    if agrees:
        np.testing.assert_allclose(program().bases[1], CELL.base_data["3"].pose(), atol=1e-12)
    else:
        with pytest.raises(CellError, match=r"BASE_DATA\[3\] has two values"):
            program()


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"tool_data": {"2": Tool(Z=150.0)}}, r"TOOL_DATA\[2\] has two values: .*Z 150.*\[tool_data\.2\].*Z 350"),
        ({"base_data": {"3": Frame(X=1.0), "03": Frame(X=2.0)}}, r"\[base_data\.3\] of the cell, and .*base_data\.03"),
        ({"base_data": {"0": Frame(X=1.0)}}, r"number 0 is \$NULLFRAME, and \{X 1,.*\[base_data\.0\]"),
    ],
)
def test_tools_and_tables_of_the_cell_contradict_too(tables, message, tmp_path):
    read_it = _two_frames(tmp_path, "config", "TOOL_DATA[2]={X 0,Y 0,Z 350,A 0,B 0,C 0}")
    cell = replace(CELL, folder=str(tmp_path), config_dat="config.dat", **{"tool_data": {}, **tables})
    with pytest.raises(CellError, match=message):
        read_it(cell)


def test_a_frame_that_the_program_changes_is_no_contradiction(tmp_path):
    text = "{X 1200,Y 100,Z 650,A 30,B 0,C 0}"
    _two_frames(tmp_path, "sub", f"DECL GLOBAL FRAME BASE_DATA[3]={text}")
    cell = replace(CELL, folder=str(tmp_path), krl=Krl(initmov="cell", search=["."]))
    program = read(body(f"BASE_DATA[3]={FRAME}", "sub( )", "$BASE=BASE_DATA[3]", FULL), cell=cell)
    assert program.bases[1][0, 3] == pytest.approx(2.1)


def test_a_frame_number_that_nobody_knows_names_the_line_that_sets_it():
    with pytest.raises(ProgramError, match=r"BASE_DATA\[8\]") as caught:
        read(body("BAS(#BASE,8)", "PTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}", FULL))
    assert caught.value.line == 4
    assert "base_data" in caught.value.advice
    read(body("BAS(#BASE,8)", "PTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}", "BAS(#BASE,3)", FULL))


def test_initialising_after_frames_were_set_leaves_them_unknown():
    with pytest.raises(ProgramError, match="INITMOV"):
        read(body(f"$BASE={FIVE}", "BAS(#INITMOV,0)", FULL), cell=replace(CELL, krl=Krl()))


# --- speed and approximation -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lines", "feed", "cdis"),
    [
        (["$VEL.CP=0.001"], 0.001, 3),
        (["$vel.cp = 5.0E-2", "$apo.cdis=0.25"], 0.05, 0.25),
        (["BAS(#VEL_CP,0.3)", "$APO={CVEL 95.0,CPTP 95.0,CDIS 4.0,CORI 125.0}"], 0.3, 4),
        (["$VEL={CP 0.4,ORI1 200,ORI2 200}"], 0.4, 3),
        (["REAL V", "V=0.02", "$VEL.CP=V"], 0.02, 3),
        (["LDAT_ACT={VEL 2.0,ACC 100,APO_DIST 7.5,APO_FAC 50,ORI_TYP #VAR}", "BAS(#CP_DAT)", "BAS(#VEL_CP,1)"], 1, 7.5),
        (["$VEL.CP=0.1", "BAS(#INITMOV,0)"], 2, 3),
        # BAS.SRC: CASE #CP_DAT calls VEL_CP(LDAT_ACT.VEL), which keeps to DEF_VEL_CP, and CP_DAT
        (["$VEL.CP=0.1", "LDAT_ACT={VEL 0.02,ACC 100,APO_DIST 2}", "BAS(#CP_DAT)"], 0.02, 2),
        (["$VEL.CP=0.1", "LDAT_ACT={VEL 0.02,APO_DIST 2}", "LDAT_ACT.VEL=0.05", "BAS(#CP_DAT)"], 0.05, 2),
        (["LDAT_ACT={VEL 3.0,APO_DIST 2}", "BAS(#CP_DAT)"], 2, 2),
        (["BAS(#VEL_CP,3.0)"], 2, 3),
        (["LDAT_ACT.VEL=0.05", "LDAT_ACT.APO_DIST=2", "BAS(#CP_DAT)"], 0.05, 2),
        (["$VEL.CP=0.1", "PDAT_ACT={VEL 50,APO_DIST 9,APO_MODE #CDIS}", "BAS(#PTP_DAT)"], 0.1, 9),
        (["$VEL.CP=0.1", "PDAT_ACT={VEL 50,APO_DIST 9,APO_MODE #CPTP}", "BAS(#PTP_DAT)"], 0.1, 3),
        (["$VEL.CP=0.1", "PDAT_ACT=PDEFAULT", "BAS(#PTP_DAT)"], 0.1, 3),
    ],
)
def test_speed_and_approximation_in_force(lines, feed, cdis):
    program = read(body(*lines, FULL + " C_DIS"))
    assert program.motions.feed[0] == feed
    assert program.motions.blend[0] == pytest.approx(cdis / 1000)


def test_defaults_of_the_config_dat_are_those_of_bas():
    data = "DEFDAT part PUBLIC\r\nREAL DEF_VEL_CP=1.0\r\nREAL DEF_APO_CDIS=1.5\r\nENDDAT\r\n"
    lines = ("LDAT_ACT={VEL 2,APO_DIST 2}", "BAS(#CP_DAT)", FULL + " C_DIS", "BAS(#INITMOV,0)", FULL + " C_DIS")
    motions = read(body(FULL + " C_DIS", *lines), data).motions
    assert motions.feed.tolist() == [1.0, 1.0, 1.0]
    np.testing.assert_allclose(motions.blend, [1.5e-3, 2e-3, 1.5e-3])


def test_the_default_speed_is_told():
    program = read(body(FULL, "$VEL.CP=0.1", FULL))
    assert program.motions.feed.tolist() == [2.0, 0.1]
    (issue,) = program.issues
    assert (issue.kind, issue.level, issue.source_line, issue.count) == ("default-speed", "info", 4, 1)


def test_speeds_that_change_at_every_line_go_with_their_motions():
    lines = [text for k in range(1, 50) for text in (f"$VEL.CP=0.{k:03d}", f"LIN {{X {k},Y 0,Z 0,A 0,B 0,C 0}} C_DIS")]
    program = read(body(*lines))
    np.testing.assert_allclose(program.motions.feed, np.arange(1, 50) / 1000)


@pytest.mark.parametrize(
    ("tail", "blend"),
    [("", 0), (" C_VEL", 0), (" C_ORI", 0), (" C_PTP", 0), (" C_PTP C_DIS", 3), (" C_DIS", 3), (" C_SPL", 3)],
)
def test_only_distances_have_a_blend(tail, blend):
    assert read(body(FULL + tail)).motions.blend[0] == blend / 1000


def test_the_approximation_of_a_spline_ptp_has_no_distance():
    assert read(body("SPTP {X 1,Y 2,Z 3,A 0,B 0,C 0} C_SPL")).motions.blend[0] == 0.0


# --- named points ------------------------------------------------------------------------------------------------

INLINE = (
    ";FOLD PTP HOME Vel=100 % DEFAULT;%{PE}%MKUKATPBASIS,%CMOVE,%VPTP,%P 1:PTP, 2:HOME, 3:, 5:100, 7:DEFAULT",
    "$BWDSTART=FALSE",
    "PDAT_ACT=PDEFAULT",
    "FDAT_ACT=FHOME",
    "BAS(#PTP_PARAMS,100)",
    "$H_POS=XHOME",
    "PTP XHOME",
    ";ENDFOLD",
    ";FOLD LIN P1 CONT Vel=0.1 m/s CPDAT1 Tool[2]:mill Base[3]:table;%{PE}%R 8.3.22,%MKUKATPBASIS,%CMOVE,%VLIN,%P",
    "$BWDSTART=FALSE",
    "LDAT_ACT=LCPDAT1",
    "FDAT_ACT=FP1",
    "BAS(#CP_PARAMS,0.1)",
    "LIN XP1 C_DIS C_DIS",
    ";ENDFOLD",
    ";FOLD SLIN P2 Vel=0.2 m/s CPDAT1 Tool[2] Base[3];%{PE}",
    ";FOLD Parameters ;%{h}",
    ";Params Kuka.PointName=P2; Kuka.BlendingEnabled=False",
    ";ENDFOLD",
    "SLIN XP2 WITH $VEL = SVEL_CP(0.2, , LCPDAT1), $TOOL = STOOL2(FP1), $BASE = SBASE(FP1.BASE_NO), "
    "$IPO_MODE = SIPO_MODE(FP1.IPO_FRAME), $LOAD = SLOAD(FP1.TOOL_NO), $ACC = SACC_CP(LCPDAT1), "
    "$ORI_TYPE = SORI_TYP(LCPDAT1), $APO = SAPO(LCPDAT1), $JERK = SJERK(LCPDAT1), "
    "$COLLMON_TOL_PRO[1] = USE_CM_PRO_VALUES(0) C_Spl",
    ";ENDFOLD",
)
INLINE_DATA = (
    "&ACCESS RVP\r\nDEFDAT  PART PUBLIC\r\n"
    ";FOLD EXTERNAL DECLARATIONS;%{PE}%MKUKATPBASIS,%CEXT,%VCOMMON,%P\r\n"
    "EXT  BAS (BAS_COMMAND  :IN,REAL  :IN )\r\nDECL INT SUCCESS\r\n;ENDFOLD\r\n"
    'DECL BASIS_SUGG_T LAST_BASIS={POINT1[] "P2    ",POINT2[] "P2    ",CP_PARAMS[] "CPDAT1  ",CONT[] "C_DIS C_DIS"}\r\n'
    "DECL E6POS XP1={X 214.483856,Y 193.590897,Z 105.80865,A 6.59456158,B -23.4313526,C 9.77940178,S 2,T 3,E1 0.0}\r\n"
    'DECL FDAT FP1={TOOL_NO 2,BASE_NO 3,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}\r\n'
    "DECL LDAT LCPDAT1={VEL 2.00000,ACC 100.000,APO_DIST 1.50000,APO_FAC 50.0000,ORI_TYP #VAR,CIRC_TYP #BASE}\r\n"
    "DECL GLOBAL E6POS XP2={X 1.0,Y 2.0,Z 3.0,A 4.0,B 5.0,C 6.0,S 18,T 34}\r\nENDDAT\r\n"
)


def test_inline_forms_take_points_frames_speed_and_approximation_from_the_data_file():
    program = read(body(*INLINE), INLINE_DATA)
    m = program.motions
    assert m.kind.tolist() == [PTP, LIN, LIN]
    np.testing.assert_allclose(np.degrees(m.joints[0]), CELL.start.joints)
    assert numbers(program)[1, 0] == 214.483856
    assert m.feed[1:].tolist() == [0.1, 0.2]
    np.testing.assert_allclose(m.blend, [0, 0.0015, 0.0015])
    assert m.base.tolist() == [0, 1, 1]
    np.testing.assert_allclose(program.bases[1], CELL.base_data["3"].pose(), atol=1e-15)
    np.testing.assert_allclose(program.tools[1], CELL.tool_data["2"].pose(), atol=1e-15)
    assert kinds(program) == ["home-from-cell"]


SPLINE_HOME = (
    "SPTP XHOME WITH $VEL_AXIS[1]=SVEL_JOINT(100.0), $TOOL=STOOL2(FHOME), $BASE=SBASE(FHOME.BASE_NO), "
    "$IPO_MODE=SIPO_MODE(FHOME.IPO_FRAME), $LOAD=SLOAD(FHOME.TOOL_NO), $ACC_AXIS[1]=SACC_JOINT(PDEFAULT), "
    "$APO=SAPO_PTP(PDEFAULT), $GEAR_JERK[1]=SGEAR_JERK(PDEFAULT), $COLLMON_TOL_PRO[1]=USE_CM_PRO_VALUES(0)"
)


def test_the_home_position_of_an_inline_spline_form_needs_no_frame():
    """HOME, FHOME and PDEFAULT are in the $config.dat, which a programmer's desk seldom has."""
    program = read(body(SPLINE_HOME, FULL))
    assert program.motions.kind.tolist() == [PTP, LIN]
    np.testing.assert_allclose(np.degrees(program.motions.joints[0]), CELL.start.joints)
    assert (program.motions.base[1], program.motions.tool[1]) == (0, 0)
    assert "home-from-cell" in kinds(program)
    with pytest.raises(ProgramError, match=r"IPO_MODE is not known: FHOME\.IPO_FRAME has"):
        read(body(FULL.replace("LIN", "SPTP") + " WITH $IPO_MODE=SIPO_MODE(FHOME.IPO_FRAME)"))


@pytest.mark.parametrize(
    "lines",
    [
        ["$ORI_TYPE=SORI_TYP(LCPDAT1)", "PTP {X 1}"],
        ["$ORI_TYPE=SORI_TYP(LCPDAT1)", "PTP {X 1}", "$ORI_TYPE=#VAR", "LIN {X 2}"],
        ["$CIRC_TYPE=SCIRC_TYP(LCPDAT1)", "LIN {X 1}"],
        ["$APO=SAPO(LCPDAT1)", "LIN {X 1}"],
        ["$APO=SAPO_PTP(PPDAT1)", "LIN {X 1} C_DIS"],
        ["LDAT_ACT={VEL 2.0}", "BAS(#CP_DAT)", "LIN {X 1} C_DIS"],
        ["SLIN {X 1} WITH $ORI_TYPE=SORI_TYP({VEL 2.0}), $APO=SAPO({VEL 2.0}) C_SPL"],
        ["$ACC=SACC_CP(LCPDAT1)", "$ADVANCE=AHEAD", "$VEL.ORI1=TURN", "$VEL_AXIS[1]=FAST", "LIN {X 1}"],
        ["$VEL=SVEL_CP(2.0, , LCPDAT1)", "LIN {X 1}"],
    ],
)
def test_modes_that_are_not_known_are_no_matter_where_nothing_depends_on_them(lines):
    m = read(body(FULL, *lines)).motions
    assert len(m) == 1 + sum("{X" in line for line in lines)
    assert m.feed[-1] == 2.0 or m.kind[-1] == PTP


def test_settings_behind_with_hold_for_one_motion_only():
    program = read(body("$VEL.CP=0.3", f"SLIN XP2 WITH $VEL=SVEL_CP(0.2,,L), $BASE={FIVE}", "LIN XP2"), INLINE_DATA)
    assert program.motions.feed.tolist() == [0.2, 0.3]
    assert program.motions.base.tolist() == [1, 0]


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["DECL E6POS P1", "P1={X 1,Y 2,Z 3,A 4,B 5,C 6}", "LIN P1"], [1, 2, 3, 4, 5, 6]),
        (["DECL E6POS P1={X 1,Y 2,Z 3,A 4,B 5,C 6}", "LIN p1 C_DIS"], [1, 2, 3, 4, 5, 6]),
        (["DECL POS P1,P2", "P1={X 1,Y 2,Z 3,A 4,B 5,C 6}", "P2=P1", "P2.Z=9", "LIN P2"], [1, 2, 9, 4, 5, 6]),
        (["LIN P[2]"], [11.5, -2, 33, 4, 5, 6]),
        (["INT I", "I=1", "LIN P[I]"], [1, 2, 3, 4, 5, 6]),
        (["LIN {X 10,Y 0,Z 0,A 90,B 0,C 0}:{X 1,Y 2,Z 3,A 0,B 0,C 0} C_VEL"], [8, 1, 3, 90, 0, 0]),
        (["FRAME OFF", "OFF={X 0,Y 0,Z 5,A 0,B 0,C 0}", "LIN P[1] : OFF"], None),
    ],
)
def test_points_by_name_by_index_and_by_chain(lines, expected):
    found = read(body(*lines), DATA)
    if expected is None:
        along = pose_from_xyzabc([1, 2, 3, 4, 5, 6])
        expected = [*((along[:3, 3] * 1000) + along[:3, 2] * 5), 4, 5, 6]
    np.testing.assert_allclose(numbers(found)[-1], expected, atol=1e-9)


def test_a_point_takes_the_value_it_has_when_the_motion_is_reached():
    program = read(body("E6POS P1", "P1={X 1,Y 2,Z 3,A 4,B 5,C 6}", "LIN P1", "P1={X 9,Y 2,Z 3,A 4,B 5,C 6}", "LIN P1"))
    assert numbers(program)[:, 0].tolist() == [1, 9]


def test_home_that_is_in_no_file_is_the_start_of_the_cell():
    program = read(body("PTP $H_POS", "SPTP HOME", FULL))
    np.testing.assert_allclose(np.degrees(program.motions.joints[1]), CELL.start.joints)
    assert "home-from-cell" in kinds(program)


def test_a_move_to_the_present_position_is_no_motion():
    program = read(body("PTP $AXIS_ACT ; skip BCO", FULL, "LIN $POS_ACT"))
    assert program.motions.line.tolist() == [5]
    assert program.still.tolist() == [4, 6]


def test_a_move_to_the_present_position_moves_nothing_wherever_it_stands():
    program = read(
        body("IF $MODE_OP==#T1 THEN", "PTP $POS_ACT", "ENDIF", FULL, "LOOP", "LIN $POS_ACT C_DIS", "ENDLOOP")
    )
    assert program.motions.line.tolist() == [7]
    assert program.still.tolist() == [5, 9]


@pytest.mark.parametrize(
    ("circle", "whole"),
    [
        ("CIRC {X 110,Y 10},{X 120,Y 0}", "CIRC {X 110,Y 10,Z 30},{X 120,Y 0,Z 30}"),
        ("CIRC {X 110,Y 10},{X 120,Y 0},CA 365", "CIRC {X 110,Y 10,Z 30},{X 120,Y 0,Z 30},CA 365"),
        ("CIRC {X 110,Y 10,Z 30},{X 120,Y 0}", "CIRC {X 110,Y 10,Z 30},{X 120,Y 0,Z 30}"),
        ("CIRC {Y 10,X 110},{X 120,Y 0,Z 30}", "CIRC {X 110,Y 10,Z 30},{X 120,Y 0,Z 30}"),
    ],
)
def test_what_circles_lack_is_where_they_begin(circle, whole):
    start = "LIN {X 100,Y 0,Z 30,A 0,B 0,C 180}"
    one, other = (read(body(start, line, "LIN {X 130,Y 0,Z 30}")).motions for line in (circle, whole))
    for name in ("centre", "normal", "sweep", "target"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-12)
    assert "missing-components" in kinds(read(body(start, circle)))


# --- what is kept and passed over --------------------------------------------------------------------------------


def test_everything_else_is_passed_over():
    program = read(
        body(
            "EXT SPINDLE ( )",
            "INT i",
            "DECL REAL v",
            "CHAR s[20]",
            "GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )",
            "INTERRUPT ON 3",
            "$ADVANCE=5",
            "FOR I=1 TO 6",
            "  $VEL_AXIS[I]=100",
            "ENDFOR",
            "IF NOT $IN[1] THEN",
            "  HALT",
            "  RETURN",
            "ELSE",
            "  v=v+1.5",
            "ENDIF",
            "WAIT FOR $IN[2]",
            "WAIT SEC 0.5",
            'STR[]="a;b"',
            "TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[1]=TRUE",
            FULL,
            "CONTINUE",
            "$OUT[3]=FALSE",
            "PULSE($OUT[3],TRUE,0.5)",
            "SWITCH i",
            "CASE 1",
            "DEFAULT",
            "ENDSWITCH",
            "REPEAT",
            "UNTIL TRUE",
            "FULL_LABEL:",
        )
    )
    assert len(program.motions) == 1
    assert kinds(program) == ["default-speed"]


def test_calls_of_unknown_subprograms_are_warned_about():
    program = read(body("SPINDLE_ON(12000)", FULL, "TRIGGER WHEN PATH=-5 DELAY=0 DO GLUE(1) PRIO=-1", FULL))
    calls = [issue for issue in program.issues if issue.kind == "external-call"]
    assert [(issue.level, issue.source_line) for issue in calls] == [("warning", 4), ("warning", 6)]


def test_a_point_given_to_an_unknown_subprogram_is_no_longer_known():
    with pytest.raises(ProgramError, match=r"changed while the program runs \(line 6\)"):
        read(body("DECL E6POS P1", "P1={X 1,Y 2,Z 3}", "MEASURE(P1)", "LIN P1"))


def test_subprograms_may_be_called_whether_they_move_or_not():
    harmless = body(FULL, "LAMP()") + "DEF LAMP()\r\n$OUT[1]=TRUE\r\nEND\r\n"
    assert kinds(read(harmless)) == ["default-speed"]
    moving = body(FULL, "SUB()") + "DEF SUB()\r\nDEEP()\r\nEND\r\nDEF DEEP()\r\nLIN {X 1,Y 2,Z 3}\r\nEND\r\n"
    assert read(moving).motions.line.tolist() == [4, 11]


def test_motions_of_a_subprogram_that_is_not_called_are_told_and_left():
    program = read(body(FULL) + "DEF SUB()\r\nLIN {X 1,Y 2,Z 3}\r\nLIN {X 2}\r\nEND\r\n")
    assert len(program.motions) == 1
    assert "uncalled-motions" in kinds(program)


def test_the_subprogram_with_the_programs_name_is_the_main_one():
    text = "DEF other()\r\nLIN {X 1,Y 2,Z 3}\r\nEND\r\n" + body(FULL)
    assert numbers(read(text))[0, 0] == 100
    assert numbers(read(text, name="OTHER"))[0, 0] == 1


# --- encodings, line ends, forces --------------------------------------------------------------------------------


def test_comments_in_any_encoding_and_mixed_line_ends_survive():
    lines = ["; Fräser Ø8", FULL + " C_DIS ; Maß", "LIN {X 1,Y 2,Z 3,A 4,B 5,C 6}"]
    text = body(*lines, end="\n").replace("DEF part( )\n", "DEF part( )\r\n")
    for encoding, bom in (("cp1252", b""), ("utf-8", b""), ("utf-8", b"\xef\xbb\xbf")):
        data = bom + text.encode(encoding)
        program = read(data)
        assert program.documents[0].to_bytes() == data
        assert program.motions.line.tolist() == [5, 6]
        assert numbers(program)[1].tolist() == [1, 2, 3, 4, 5, 6]


def test_force_comments_are_read_wherever_they_stand():
    program = read(
        body(
            "; FORCE FX=120 FZ=-3",
            FULL + " ;force FY=5 FRAME=TOOL",
            'STR[]="x;FORCE FX=9"',
            "; text ; FORCE FX=1",
            ";FORCE OFF",
        )
    )
    assert [(note.line, note.frame, note.wrench[:3]) for note in program.notes] == [
        (4, "BASE", (120, 0, -3)),
        (5, "TOOL", (0, 5, 0)),
        (8, "BASE", (0, 0, 0)),
    ]
    with pytest.raises(ForceError, match=r"part\.src:4"):
        read(body("; FORCE FX=abc", FULL))
    for comment in (";(FORCE FX=1 FY=2 FZ=3)", "; ( FORCE OFF)"):
        with pytest.raises(ForceError, match=r"in brackets.*Leave them out"):
            read(body(comment, FULL))


# --- errors ------------------------------------------------------------------------------------------------------

ERRORS = [
    (["LIN {X NaN,Y 2}"], 4, "not a finite number"),
    (["LIN {X 1,Y INF}"], 4, "not a finite number"),
    (["LIN {X 1E999,Y 2}"], 4, "1E999 is not a finite number"),
    (["LIN {X 1,Y 2,X 3}"], 4, "X is given twice"),
    (["LIN {X 1,Q 2}"], 4, "Q is not a component"),
    (["LIN {X 1,A1 2}"], 4, "X is not a component"),
    (["LIN {X 1 Y 2}"], 4, "comma is missing"),
    (["LIN {X 1,,Y 2}"], 4, "component such as"),
    (["LIN {X,Y 2}"], 4, "X has no value"),
    (["LIN {}"], 4, "component such as"),
    (["LIN {X 1,Y 2"], 4, "not closed"),
    (["LIN"], 4, "value is missing"),
    (["LIN {X OFFS,Y 2}"], 4, "X is not a number"),
    (["LIN {E6AXIS: X 1,Y 2}"], 4, "not a component of a position|not the type"),
    (["PTP {POS: A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}"], 4, "not the type"),
    (["PTP {X 1,Y 2,Z 3,S 32,T 0}"], 4, "S 32 is out of range"),
    (["PTP {X 1,Y 2,Z 3,S 2,T 64}"], 4, "T 64 is out of range"),
    (["PTP {X 1,Y 2,Z 3,S 2,T 1.5}"], 4, "out of range"),
    (["LIN {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}"], 4, "axis angles"),
    (["LIN NOWHERE"], 4, "NOWHERE has no value"),
    (["LIN P[9]"], 4, r"P\[9\] has no value"),
    (["LIN P[n]"], 4, "index"),
    (["LIN $POS_ACT:{Z 5}"], 4, "computed while the program runs"),
    (["LIN P[1]:$POS_ACT"], 4, "computed while the program runs"),
    (["XP1=$POS_ACT", "XP1.X=5", "LIN XP1"], 6, r"XP1 is set to .* \(line 4: \$POS_ACT is computed"),
    (["DECL REAL R", "GONE(R)", "XP1.X=R", "LIN XP1"], 7, r"XP1 is set to .* \(line 6: R is changed .* \(line 5\)"),
    (["XP1.X=NOWHERE", "LIN XP1"], 5, r"XP1 is set to .* \(line 4: NOWHERE has no value"),
    (["XP1.X=XP1.X+$IN[1]", "LIN XP1"], 5, r"XP1 is set to .* \(line 4: \$IN\[1\] is computed"),
    (["LIN P[1]+5"], 4, "computed"),
    (["LIN CALC(3)"], 4, "computed"),
    (["FOR I=1 TO $ANIN[1]", FULL, "ENDFOR"], 4, "inside FOR: its bounds"),
    (["FOR I=1 TO 9", "XP1={X 5}", "ENDFOR", "LIN XP1"], 7, "XP1 is set to .*not all of its components are given"),
    (["WHILE TRUE", "LIN P[1]", "ENDWHILE"], 4, "WHILE never ends"),
    (["LOOP", FULL, "ENDLOOP"], 4, "LOOP never ends"),
    (["REPEAT", FULL, "UNTIL $IN[2]"], 6, "inside UNTIL"),
    (["IF $IN[1] THEN", FULL, "ENDIF"], 4, "the branches end in different places"),
    (["SWITCH $ANIN[1]", "CASE 1", FULL, "ENDSWITCH"], 4, "the branches end in different places"),
    (["A:", FULL, "GOTO A"], 6, "the label A precedes GOTO"),
    (["GOTO A", FULL], 4, "there is no label A in PART"),
    (["IF $IN[1] THEN", "GOTO A", "ENDIF", FULL, "A:"], 4, "the branches end in different places"),
    (["A:", FULL, "IF $IN[1] THEN", "GOTO A", "ENDIF"], 7, r"whether GOTO is run.* of IF \(line 6\) is not"),
    (
        ["SWITCH NOWHERE", "CASE 1", "GOTO A", "ENDSWITCH", FULL, "A:"],
        6,
        r"SWITCH \(line 4\) is not .* what NOWHERE will be",
    ),
    (["FOR I=1 TO 2", "GOTO A", FULL, "A:", "ENDFOR"], 5, "GOTO leads to a label in a loop"),
    (["FOR I=1 TO 2", "IF I>9 THEN", "GOTO A", "ENDIF", FULL, "A:", "ENDFOR"], 9, "a label is in a loop"),
    (["FOR I=1 TO 2", "A:", FULL, "IF I>9 THEN", "GOTO A", "ENDIF", "ENDFOR"], 5, "a label is in a loop"),
    (
        ["I=0", "A:", "I=I+1", FULL, "B:", "IF I>9 THEN", "GOTO B", "ENDIF", "IF I<2 THEN", "GOTO A", "ENDIF"],
        8,
        "a label is in a loop",
    ),
    (["SPLINE", "LIN {X 1,Y 0,Z 0,A 0,B 0,C 180}", "ENDSPLINE"], 5, "LIN in a SPLINE block"),
    (["ENDIF"], 4, "ENDIF without IF"),
    (["IF $IN[1] THEN", "$BASE={X 1}", "ENDIF"], 5, "changed inside IF"),
    (["IF $IN[1] THEN", "BAS(#TOOL,1)", "ENDIF"], 5, "changed inside IF"),
    (["TRIGGER WHEN DISTANCE=0 DELAY=0 DO $VEL.CP=1"], 4, "TRIGGER changes what motions"),
    (["$IPO_MODE=#TCP"], 4, "IPO_MODE"),
    (["FDAT_ACT={TOOL_NO 1,BASE_NO 1,IPO_FRAME #TCP}", "BAS(#FRAMES)"], 5, "IPO_MODE"),
    ([FULL, "$ORI_TYPE=#JOINT", "CIRC {X 0,Y 0,Z 0},{X 1,Y 5,Z 9,A 50,B 0,C 170}"], 6, "ORI_TYPE=#JOINT"),
    ([FULL, "$ORI_TYPE=#IGNORE", "SLIN {A 11}"], 6, "ORI_TYPE=#IGNORE"),
    ([FULL, "$ORI_TYPE=#IGNORE", "SLIN {X 5}", "$ORI_TYPE=#VAR", "SLIN {A 11}"], 6, "ORI_TYPE=#IGNORE"),
    ([FULL, "$CIRC_TYPE=#CHORD", "CIRC {X 0,Y 0,Z 0},{X 1,Y 5,Z 9}"], 5, "CIRC_TYPE is not known: there is no #CHORD"),
    ([FULL, "$ORI_TYPE=#JOINT", "$CIRC_TYPE=#PATH", "CIRC {X 0,Y 0,Z 0},{X 1,Y 5,Z 9}"], 7, "ORI_TYPE=#JOINT and"),
    ([FULL, "$ORI_TYPE=MODE", "LIN {X 1}"], 5, "ORI_TYPE is not known: MODE has no value"),
    ([FULL, "$ORI_TYPE=CHOSEN(3)", "LIN {X 1}"], 5, r"ORI_TYPE is not known: CHOSEN\(3\) is computed"),
    ([FULL, "$ORI_TYPE=SORI_TYP(LCPDAT1)", "LIN {X 1}"], 5, "ORI_TYPE is not known: LCPDAT1 has no value"),
    ([FULL, "$ORI_TYPE=SORI_TYP(CHOSEN(3))", "LIN {X 1}"], 5, "ORI_TYPE is not known"),
    ([FULL, "$ORI_TYPE=SORI_TYP( )", "LIN {X 1}"], 5, "ORI_TYPE is not known"),
    ([FULL, "SLIN {X 1} WITH $ORI_TYPE=SORI_TYP(LCPDAT1)"], 5, "ORI_TYPE is not known: LCPDAT1 has no value"),
    ([FULL, "SPLINE WITH $ORI_TYPE=SORI_TYP(LCPDAT1)", "SPL {X 1}", "ENDSPLINE"], 5, "ORI_TYPE is not known"),
    ([FULL, "$CIRC_TYPE=SCIRC_TYP(L1)", "CIRC {X 0,Y 0,Z 0},{X 1,Y 5,Z 9}"], 5, "CIRC_TYPE is not known: L1 has no"),
    ([FULL, "SLIN {X 1} WITH $IPO_MODE=SIPO_MODE(FP1.IPO_FRAME)"], 5, "IPO_MODE is not known: FP1.IPO_FRAME has no"),
    ([FULL, "$IPO_MODE=#TOOL", "LIN {X 1}"], 5, "IPO_MODE is not known: there is no #TOOL"),
    ([FULL, "LDAT_ACT=LCPDAT1", "BAS(#CP_DAT)", "LIN {X 1}"], 6, "VEL.CP is not known .*LCPDAT1 has no value"),
    ([FULL, "BAS(#CP_DAT)", "LIN {X 1}"], 5, "VEL.CP is not known .*LDAT_ACT.VEL has no value"),
    ([FULL, "LDAT_ACT.ACC=50", "BAS(#CP_DAT)", "LIN {X 1}"], 6, "VEL.CP is not known .*LDAT_ACT.VEL has no value"),
    ([FULL, "BAS(#CP_DAT)", "$VEL.CP=0.1", "LIN {X 1}"], 5, "ORI_TYPE is not known: LDAT_ACT.ORI_TYP has no value"),
    ([FULL, "LDAT_ACT={VEL 1,ORI_TYP MODE}", "BAS(#CP_DAT)", "LIN {X 1}"], 6, "ORI_TYPE is not known: "),
    ([FULL, "LDAT_ACT={VEL 1,APO_DIST FAR}", "BAS(#CP_DAT)", "LIN {X 1} C_DIS"], 6, "CDIS is not known"),
    ([FULL, "FDAT_ACT={TOOL_NO 2,BASE_NO 3,IPO_FRAME MODE}", "BAS(#FRAMES)", "LIN {X 1}"], 6, "IPO_MODE is not known"),
    ([FULL, "$APO=SAPO(LCPDAT1)", "LIN {X 1} C_DIS"], 5, "CDIS is not known: LCPDAT1 has no value"),
    ([FULL, "$APO=NEAR(3)", "LIN {X 1} C_DIS"], 5, r"CDIS is not known: NEAR\(3\) is computed"),
    (
        [FULL, "XHOME=REST", "PTP XHOME", "LIN {X 1}"],
        6,
        "XHOME is set to a value that is not known .line 5: REST has no value",
    ),
    ([FULL, "$CIRC_TYPE=#PATH", "CIRC {X 0,Y 0,Z 0},{X 1,Y 5,Z 9},CA 100"], 6, "circle with CA"),
    ([FULL, "$ORI_TYPE=#CONSTANT", "LIN {A 5}", "$ORI_TYPE=#VAR", "LIN {X 5}"], 8, "A, B, C are missing behind"),
    ([FULL, "$ORI_TYPE=#CONSTANT", "LIN {A 5}", "$ORI_TYPE=#VAR", "LIN_REL {X 5}"], 8, "A, B, C are missing behind"),
    (["$BASE=EK(MACHINE_DEF[2].ROOT,#DKP400,{X 0})"], 4, "external kinematics"),
    (["BAS(#EX_BASE,1)"], 4, "EX_BASE"),
    (["$BASE=FOO[2]", FULL], 4, "BASE is not known"),
    (["$BASE=CALC()", FULL], 4, "BASE is not known"),
    (["BAS(#FRAMES)", FULL], 4, "FDAT_ACT"),
    (["$ROBROOT={X 5}"], 4, "ROBROOT"),
    ([FULL, "V1=-7/2", "LIN {X V1}"], 6, r"X is not a number: V1 is set to .*\(line 5: -7/2: .*quotient of neg"),
    (["P1=CALC(2)", "LIN P1"], 5, r"P1 is set to a value that is not known .line 4: CALC\(\) is in no file"),
    (["V1=SIN(V0)", "$VEL.CP=V1", FULL], 5, r"line 4: V0 has no value"),
    (
        ["I=-1", "LOOP", "IF I/2>1 THEN", "EXIT", "ENDIF", FULL, "ENDLOOP"],
        7,
        r"IF \(line 6\) is not known: I/2: .*quot",
    ),
    (
        ["LOOP", "IF $IN[1] THEN", "EXIT", "ENDIF", FULL, "ENDLOOP"],
        6,
        r"loop is left here: .* IF \(line 5\) is not known",
    ),
    (["I=-3", "FOR J=1 TO I/2", FULL, "ENDFOR"], 5, "its bounds are not known .*I/2: .*quotient of negative"),
    (["FOR I=1 TO 2.5", FULL, "ENDFOR"], 4, "one of its bounds is a REAL, 2.5"),
    (["FOR I=1 TO CALC(2)", FULL, "ENDFOR"], 4, r"its bounds are not known .*: it asks CALC\(\)"),
    (["FOR I=1 TO MANY", FULL, "ENDFOR"], 4, r"krl.values\] of the cell what MANY will be"),
    (["IF CALC(2)>1 THEN", FULL, "ENDIF"], 4, r"condition is not known before the program runs: it asks CALC\(\)"),
    ([FULL, "$ORI_TYPE=#CONSTANT", "IF $IN[1] THEN", "LIN {X 7}", FULL, "ENDIF"], 6, "ORI_TYPE=#CONSTANT keeps"),
    ([FULL, "IF $IN[1] THEN", FULL, "ENDIF", "LIN_REL {X 5}"], 5, "a relative motion where branches"),
    ([FULL, "IF $IN[1] THEN", FULL, "ENDIF", "LIN {X 5}"], 5, "components are missing where branches"),
    (["$VEL.CP=0"], 4, "speed"),
    (["$VEL.CP=-0.1"], 4, "speed"),
    (["$VEL.CP=V0"], 4, "speed .* not known"),
    (["$APO.CDIS=D0", "LIN {X 1} C_DIS"], 4, "CDIS"),
    (["LIN {X 1,E1 0}", "LIN {X 2,E1 5}"], 5, "external axis E1 moves from 0 to 5"),
    (["LIN {X 1,E1 0}", "PTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0,E1 1}"], 5, "external axis E1"),
    (["LIN_REL {E1 5}"], 4, "external axis"),
    (["ASYPTP {E1 5}"], 4, "external axes"),
    (["LIN_REL {A 5}"], 4, "relative A, B, C"),
    (["CIRC_REL {X 1},{X 2}"], 4, "lie on a line"),
    ([FULL, "SCIRC_REL {X 1,Y 1},{X 2,A 5}"], 5, "relative A, B, C"),
    ([FULL, "CIRC {X 1,Y 2,Z 3}"], 5, "auxiliary point and an end point"),
    ([FULL, "IF $IN[1]", "$OUT[1]=TRUE", "ENDIF"], 5, "IF without THEN"),
    ([FULL, "if then", "ENDIF"], 5, "IF without a condition"),
    ([FULL, "IF $IN[1] THEN LIN {X 1}", "ENDIF"], 5, "'LIN {X 1}' follows THEN"),
    ([FULL, "IF $IN[1] THEN", "ELSE LIN {X 1}", "ENDIF"], 6, "follows ELSE"),
    ([FULL, "LOOP LIN {X 1}", "EXIT", "ENDLOOP"], 5, "follows LOOP"),
    ([FULL, "SWITCH 1", "CASE 1 PTP {X 1}", "ENDSWITCH"], 6, "a motion follows CASE"),
    ([FULL, "LOOP", "EXIT", "ENDLOOP LIN {X 1}"], 7, "follows ENDLOOP"),
    ([FULL, "EXIT"], 5, "EXIT outside of a loop"),
    ([FULL, "IF $IN[1] THEN", "EXIT ;out", "ENDIF"], 6, "EXIT outside of a loop"),
    ([FULL, "FOR I=1 TO 3 STEP 0", "LIN {X 1}", "ENDFOR"], 5, "FOR cannot count by STEP 0"),
    ([FULL, "FOR I=1 TO 3 STEEP 2", "LIN {X 1}", "ENDFOR"], 5, "FOR is not understood.* STEP step"),
    ([FULL, "FOR I=1 TO 3 STEP 0.5", "LIN {X 1}", "ENDFOR"], 5, "FOR cannot count by STEP 0.5"),
    ([FULL, "LIN_REL $POS_ACT"], 5, "the current robot position"),
    ([FULL, "CIRC {X 1,Y 2,Z 3},$POS_ACT"], 5, "the current robot position"),
    (["IF $IN[1] THEN", "PTP $POS_ACT:{Z 5}", "ENDIF"], 5, "the target is not known"),
    ([FULL, "CIRC {X 1,Y 2,Z 3},{X 4,Y 9,Z 3},CA 0"], 5, "circular angle"),
    ([FULL, "CIRC {X 1,Y 2,Z 3},{X 4,Y 9,Z 3},CA Q"], 5, "circular angle"),
    ([FULL + " C_DIS C_WHAT"], 4, "not understood"),
    (["SLIN {X 1} WITH $WHAT=5"], 4, "not understood"),
    (["SLIN {X 1} WITH 5"], 4, "not understood"),
    (["LNI {X 1}"], 4, "not understood"),
    (["SOME WORDS HERE"], 4, "not understood"),
    (["BAS(#WHAT,1)"], 4, "not understood"),
    (["BAS"], 4, "not understood"),
    (["FOO(1,(2)"], 4, "not closed"),
    (["LIN A_NAME_THAT_IS_FAR_TOO_LONG"], 4, "longer than 24"),
]


@pytest.mark.parametrize(("lines", "line", "problem"), ERRORS, ids=[error[0][-1][:40] for error in ERRORS])
@pytest.mark.parametrize("bulk", [True, False])
def test_what_is_not_understood_names_file_line_and_text(lines, line, problem, bulk):
    with pytest.raises(ProgramError, match=problem) as caught:
        read(body(*lines, "LIN {X 1,Y 2,Z 3,A 0,B 0,C 0}"), DATA, bulk=bulk)
    error = caught.value
    assert (error.file, error.line) == ("part.src", line)
    assert error.text.strip()
    assert str(error).startswith(f"part.src:{line}: ")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("DEF part( )\r\nLIN {X 1}\r\n", "DEF PART has no END"),
        ("DEF part( )\r\nLIN {X 1,Y", "has no END"),
        ("DEF part( )\r\nLIN {X 1}\r\nDEF b( )\r\nEND\r\n", "has no END"),
        ("LIN {X 1}\r\n", "no DEF"),
        ("DEF part( )\r\nIF TRUE THEN\r\nEND\r\n", "IF is not closed"),
        ("DEF part( )\r\nEND\r\nLIN {X 1}\r\n", "outside of DEF"),
        ("DEF part( )\r\nEND\r\nLIN P1\r\n", "outside of DEF"),
        ("DEF part( )\r\n$OUT[1]=TRUE\r\nEND\r\n", "no motions"),
        ("DEF 1part( )\r\nLIN {X 1}\r\nEND\r\n", "not a valid name"),
        ("DEF A_NAME_THAT_IS_FAR_TOO_LONG( )\r\nLIN {X 1}\r\nEND\r\n", "27 characters"),
        ("DEF part( )\r\nSUB()\r\nLIN {X 1}\r\nEND\r\nDEF SUB()\r\nPTP P1\r\n", "no END"),
    ],
)
def test_incomplete_programs_are_refused(text, problem):
    with pytest.raises(ProgramError, match=problem):
        read(text)


@pytest.mark.parametrize(
    ("data", "line", "problem"),
    [
        ("DEFDAT part\r\nDECL E6POS XP1={X 1}\r\n", 2, "ENDDAT is missing"),
        ("DECL E6POS XP1={X 1}\r\nENDDAT\r\n", 2, "DEFDAT is missing"),
        ("DEFDAT part\r\nDECL E6POS XP1={X 1,Y 2\r\nENDDAT\r\n", 2, "not closed"),
        ("DEFDAT part\r\nDECL E6POS XP1={X 1,X 2}\r\nENDDAT\r\n", 2, "twice"),
        ("DEFDAT part\r\nDECL E6POS XP1={X 1,S 99}\r\nENDDAT\r\n", 2, "S 99"),
    ],
)
def test_errors_in_the_data_file_name_it(data, line, problem):
    with pytest.raises(ProgramError, match=problem) as caught:
        read(body("LIN XP1"), data)
    assert (caught.value.file, caught.value.line) == ("part.dat", line)


def test_what_no_motion_uses_may_be_beyond_understanding():
    data = (
        'DEFDAT part\r\nDECL WEIRD W={A {B 1,C #X},D[] "t"}\r\nDECL E6POS XP1={X 1,Y 2,Z 3,A 4,B 5,C 6}\r\nENDDAT\r\n'
    )
    assert len(read(body("LIN XP1"), data).motions) == 1


def test_several_points_may_be_declared_on_one_line():
    two = "DECL E6POS A={X 1,Y 2,Z 3,A 4,B 5,C 6},B={X 7,Y 2,Z 3,A 4,B 5,C 6}"
    data = f"DEFDAT part\r\n{two}\r\nDECL E6POS C,D\r\nENDDAT\r\n"
    assert numbers(read(body("LIN A", "LIN B"), data))[:, 0].tolist() == [1, 7]


def test_a_constant_orientation_that_does_not_change_is_accepted():
    program = read(body(FULL, "$ORI_TYPE=#CONSTANT", "LIN {X 1,Y 2,Z 3,A 10,B 20,C 170}", "LIN {X 5}"))
    assert program.layout.orientation.tolist() == [0, 1, 1]


def test_frames_close_to_each_other_are_not_one():
    cell = replace(CELL, base=Frame(X=1500.0, Y=-200.0, Z=700.0001))
    assert read(body("$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}", FULL), cell=cell).motions.base.tolist() == [1]


def test_a_chain_has_the_status_the_turn_and_the_external_axes_of_its_last_operand():
    data = f"DEFDAT part\nDECL E6POS XP1={{X 1,Y 2,Z 3,A 0,B 0,C 0,S 6,T 27,E1 3.5}}\nFRAME FR={FIVE}\nENDDAT\n"
    program = read(body("PTP FR:XP1", "PTP XP1:FR"), data)
    assert program.motions.status.tolist() == [6, -1]
    assert program.motions.turn.tolist() == [27, -1]
    (issue,) = (issue for issue in program.issues if issue.kind == "external-axis")
    assert (issue.level, issue.source_line, issue.message[:12]) == ("warning", 4, "E1 is at 3.5")


def test_an_external_axis_at_zero_is_not_worth_a_word():
    program = read(body("LIN {X 1,Y 2,Z 3,A 0,B 0,C 0,E1 0.0}"))
    assert not [issue for issue in program.issues if issue.kind == "external-axis"]


def test_blending_without_a_distance_is_told():
    others = ["LIN {X 1,Y 2,Z 3,A 0,B 0,C 0} ; C_VEL", "LIN {X 3} C_ORI C_DIS", "PTP {X 4} C_PTP C_ORI"]
    program = read(body(others[0], "lin {X 2} c_vel", *others[1:], "LIN_REL {X 1} C_Ori"))
    (issue,) = (issue for issue in program.issues if issue.kind == "blending-by-speed")
    assert (issue.source_line, issue.count) == (5, 2)


# --- arrays of two dimensions -------------------------------------------------------------------------------------


GRID = (
    "DEFDAT part\nDECL E6POS P[2,2]\nP[1,1]={X 1,Y 0,Z 9,A 0,B 0,C 0}\nP[1,2]={X 2,Y 0,Z 9,A 0,B 0,C 0}\n"
    "P[ 2 , 1 ]={X 3,Y 0,Z 9,A 0,B 0,C 0}\nDECL INT I=2\nENDDAT\n"
)


def test_elements_of_an_array_of_two_dimensions_are_told_apart():
    program = read(body("LIN P[1,2]", "LIN P[1, 1]", "LIN P[I,I-1]", "P[1,1].X=7", "LIN P[I-1,1]"), GRID)
    assert numbers(program)[:, 0].tolist() == [2, 1, 3, 7]


def test_an_index_of_two_that_is_not_known_is_refused():
    with pytest.raises(ProgramError, match=r"the index of P\[1,\$OV_PRO\] is not known .*: \$OV_PRO is computed"):
        read(body("LIN P[1,$OV_PRO]"), GRID)
    with pytest.raises(ProgramError, match=r"P\[2,2\] has no value"):
        read(body("LIN P[2,2]"), GRID)


JOB = "DEFDAT part\nSTRUC JOB REAL Q[6],INT N\nDECL JOB JB\nENDDAT\n"


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        (["JB={N 3}", "JB.Q[2]=5", "LIN {X JB.Q[2],Y 0,Z 9,A 0,B 0,C 0}"], r"JB.Q\[2\] is an element of an array in a"),
        (["JB.N=3", "LIN {X JB.N,Y 0,Z 9,A 0,B 0,C 0}"], "its structure had no value as a whole: give all members"),
    ],
)
def test_the_reason_why_a_member_of_a_structure_is_not_known_is_told(lines, reason):
    with pytest.raises(ProgramError, match=reason):
        read(body(*lines), JOB)
    assert numbers(read(body("JB={N 3}", "JB.N=4", "LIN {X JB.N,Y 0,Z 9,A 0,B 0,C 0}"), JOB))[0, 0] == 4.0


def test_a_loop_over_an_unknown_index_makes_all_elements_unknown():
    with pytest.raises(ProgramError, match=r"P\[1,1\] is changed while the program runs"):
        read(body("FOR J=1 TO $ANIN[1]", "P[1,J].X=5", "ENDFOR", "LIN P[1,1]"), GRID)


def test_what_an_interrupt_changes_is_told_with_its_line_once():
    with pytest.raises(ProgramError) as caught:
        read(body("INTERRUPT DECL 4 WHEN $IN[1]==TRUE DO XP1=XP2", "INTERRUPT ON 4", "LIN XP1"), DATA)
    assert "(by INTERRUPT in line 4)" in str(caught.value)


@pytest.mark.parametrize("word", ["INTERRUPT DECL 4 WHEN $IN[1]==TRUE DO", "TRIGGER WHEN DISTANCE=0 DELAY=0 DO"])
def test_an_event_that_may_change_a_frame_is_named_by_the_line_of_the_error(word):
    with pytest.raises(ProgramError) as caught:
        read(body(f"{word} $BASE=BASE_DATA[2]", "LIN XP1"), DATA)
    assert caught.value.line == 4
    problem = f"{word.split()[0]} changes what motions depend on at any time: $BASE"
    assert caught.value.problem == problem


def _frame(x, y, z):
    """X…C in a base that stands at `FULL`, with its axes."""
    start = pose_from_xyzabc([100, 20, 30, 10, 20, 170])
    return (start @ [x / 1000, y / 1000, z / 1000, 1.0])[:3] * 1000


@pytest.mark.parametrize("axes", ["", " #BASE", " #TOOL"])
@pytest.mark.parametrize("word", ["CIRC_REL", "scirc_rel"])
def test_both_points_of_a_relative_circle_count_from_its_start(word, axes):
    via, end = ([10, 12, 3], [25, -4, 8])
    if axes == " #TOOL":
        spots = _frame(*via), _frame(*end)
    else:
        spots = np.add(via, [100, 20, 30]), np.add(end, [100, 20, 30])
    absolute = ",".join(f"{{X {x!r},Y {y!r},Z {z!r}}}" for x, y, z in (map(float, spot) for spot in spots))
    for angle in ("", ",CA 200"):
        relative = f"{word} {{X 10,Y 12,Z 3}},{{X 25,Y -4,Z 8}}{angle}{axes} C_DIS"
        one = read(body(FULL, relative, "LIN_REL {X 5}"))
        other = read(body(FULL, f"CIRC {absolute}{angle} C_DIS", "LIN_REL {X 5}"))
        for name in ("target", "centre", "normal", "sweep", "blend"):
            mine, its = (getattr(program.motions, name) for program in (one, other))
            np.testing.assert_allclose(mine, its, rtol=0, atol=1e-9, err_msg=name)


def test_what_is_wrong_with_one_bas_is_reported_for_each():
    lines = ("IF $IN[1] THEN", "GOTO A", "ENDIF", "BAS(#NOW)", "BAS(#THEN)", "IF $IN[2] THEN", "GOTO A", "ENDIF", FULL)
    with pytest.raises(ProgramError) as caught:
        read(body(*lines, "A:"), cell=replace(CELL, krl=Krl(initmov="cell", keep_unresolved=True)))
    assert [error.line for error in (caught.value, *caught.value.further_errors)] == [7, 8]


def test_motions_that_lead_on_from_where_the_robot_stands_are_told_to_go_along():
    lines = ("LIN_REL {Z 1}", "LIN {X 3}", FULL.replace("X 100", "X 70"))
    cell = replace(CELL, krl=Krl(initmov="cell", keep_unresolved=True))
    program = read(body(FULL, "IF $IN[1] THEN", *lines, "ENDIF", "LIN XX", *lines), cell=cell)
    told = [issue for issue in program.issues if issue.kind == "unresolved"]
    assert [issue.source_line for issue in told] == [6, 7, 8, 10, 11, 12]
    moved = [
        issue.source_line for issue in told if "the correction of the motion before it moves it too" in issue.message
    ]
    assert moved == [6, 7, 11, 12]
