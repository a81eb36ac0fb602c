import math

import msgspec
import numpy as np
import pytest

from postproc.dialects import gcode
from postproc.dialects.text import decode
from postproc.errors import MAX_ERRORS, ForceError, InputError, ProgramError, group_issues
from postproc.program import CIRC, LIN, PTP, ForceNote
from tests.dialects.gcode_reading import AT_Z10, CELL, START_FLANGE, ends, forward, outcome, read


def kinds(program) -> list[str]:
    return [issue.kind for issue in program.issues]


def lines(program) -> list[int]:
    return program.motions.line.tolist()


def fault(text: str) -> ProgramError:
    with pytest.raises(ProgramError) as caught:
        read(text)
    return caught.value


# ---- motions


def test_first_rapid_is_a_joint_move_and_later_ones_are_straight_with_the_speed_of_the_cell() -> None:
    motions = read(AT_Z10 + "G1 Z-1 F600\nG0 Z10\nM30\n").motions
    assert motions.kind.tolist() == [PTP, LIN, LIN]
    assert motions.rapid.tolist() == [True, False, True]
    assert motions.line.tolist() == [2, 3, 4]
    np.testing.assert_allclose(motions.feed, [np.nan, 0.01, 0.4])
    assert motions.blend.tolist() == [5e-4] * 3
    assert motions.base.tolist() == motions.tool.tolist() == [0, 0, 0]
    assert motions.status.tolist() == motions.turn.tolist() == [-1, -1, -1]
    assert np.isnan(motions.joints).all()


def test_bases_and_tools_are_those_of_the_cell() -> None:
    program = read(AT_Z10 + "M30\n")
    np.testing.assert_array_equal(program.bases, CELL.base.pose()[None])
    np.testing.assert_array_equal(program.tools, CELL.tool.pose()[None])
    assert (program.name, program.dialect) == ("part", "gcode")
    assert program.documents[0].name == "part.nc"


@pytest.mark.parametrize("axis", ["+Z", "-Z", "+X", "-X"])
def test_tool_axis_points_down_in_the_program_frame(axis: str) -> None:
    tool = msgspec.structs.replace(CELL.tool, axis=axis)
    cell = msgspec.structs.replace(CELL, tool=tool, gcode=msgspec.structs.replace(CELL.gcode, redundancy_deg=37.0))
    rotation = read(AT_Z10 + "M30\n", cell).motions.target[0, :3, :3]
    unit = np.zeros(3)
    unit["XYZ".index(axis[1])] = 1.0 if axis[0] == "+" else -1.0
    np.testing.assert_allclose(rotation @ unit, [0.0, 0.0, -1.0], atol=1e-15)
    np.testing.assert_array_equal(rotation, cell.tool_orientation())


def test_a_first_cutting_move_with_all_axes_is_a_straight_move() -> None:
    motions = read("G1 X1 Y2 Z3 F600\nM30\n").motions
    assert (motions.kind.tolist(), motions.rapid.tolist()) == ([LIN], [False])


@pytest.mark.parametrize("bulk", [True, False])
@pytest.mark.parametrize(
    ("opening", "held_back", "line", "end"),
    [
        ("G0 X20 Y20\nG0 Z5\n", [2], 3, [20, 20, 5]),
        ("G0 Z60\nG0 X7\nG0 Y8 Z5\n", [2, 3], 4, [7, 8, 5]),
        ("G0 X1 Y1\nX1\nX2 Y3\nM8\nG43 H1 Z4\n", [2, 3, 4], 6, [2, 3, 4]),
        ("G20 G0 X1\nG21 Y2\nZ3\n", [2, 3], 4, [25.4, 2, 3]),
        ("G0 X1 (a) G54\nG91\nG90\nX2 Y2 Z2\n", [2], 5, [2, 2, 2]),
        ("G55 G0 X1 Y2\nZ3\n", [2], 3, [101, 2, -2]),
    ],
)
def test_rapid_moves_are_held_back_until_x_y_and_z_are_known(bulk: bool, opening: str, held_back, line, end) -> None:
    program = read(f"G21\n{opening}G1 X9 F600\nX9\nM30\n", bulk=bulk)
    np.testing.assert_allclose(ends(program)[0], end, atol=1e-9)
    assert program.motions.kind.tolist() == [PTP, LIN]
    assert program.motions.rapid.tolist() == [True, False]
    assert lines(program) == [line, line + 1]
    assert program.still.tolist() == [*held_back, line + 2]
    told = {issue.kind: (issue.level, issue.source_line, issue.count) for issue in program.issues}
    assert told["start-position"] == ("info", 2, len(held_back))
    assert told["null-move"] == ("info", line + 2, 1)


def test_the_position_of_the_start_has_no_part_in_any_motion() -> None:
    text = "G55 G0 X1\nG0 Y2\nG0 Z3\nG1 X9 F600\nM30\n"
    elsewhere = START_FLANGE.copy()
    elsewhere[:3, 3] += [0.3, -0.4, -0.5]
    document = decode("part.nc", text.encode())
    other = gcode.read(document, CELL, lambda _: elsewhere, "part")
    np.testing.assert_array_equal(read(text).motions.target, other.motions.target)


def test_a_program_whose_first_rapid_move_is_complete_holds_nothing_back() -> None:
    program = read("G21 G0 X1 Y2 Z3\nM30\n")
    assert program.issues == ()
    assert program.still.tolist() == []


def test_events_of_lines_held_back_come_before_the_first_motion() -> None:
    assert events(read("G0 X0 Y0 S100 M3 (go)\nG0 Z5 M8\nG1 Z0 F9 M9 M5\nM30\n")) == [
        (0, "comment", 1, 0.0, "go"),
        (0, "spindle_on", 1, 100.0, ""),
        (0, "coolant_on", 2, 0.0, ""),
        (1, "spindle_off", 3, 0.0, ""),
        (1, "coolant_off", 3, 0.0, ""),
    ]


def test_moves_that_go_nowhere_are_left_out_and_lines_stay_right() -> None:
    program = read(AT_Z10 + "G1 F100\nG1 X0\nX1\nX1 Y0\nX2\nG91 X0\nM30\n")
    assert lines(program) == [2, 5, 7]
    (issue,) = [issue for issue in program.issues if issue.kind == "null-move"]
    assert (issue.level, issue.source_line, issue.count) == ("info", 4, 3)


def test_inches_and_millimetres_may_change_within_a_program() -> None:
    motions = read("G20 G0 X1 Y2 Z3\nG1 X2 F10\nG21 X2\nF60 Y0\nG20 F10 Y1\nG91 X.1\nM30\n").motions
    expected = [
        [25.4, 50.8, 76.2],
        [50.8, 50.8, 76.2],
        [2, 50.8, 76.2],
        [2, 0, 76.2],
        [2, 25.4, 76.2],
        [4.54, 25.4, 76.2],
    ]
    np.testing.assert_allclose(motions.target[:, :3, 3] * 1e3, expected, atol=1e-12)
    np.testing.assert_allclose(motions.feed[1:] * 60e3, [254, 254, 60, 254, 254], rtol=1e-12)


def test_increments_add_up_from_the_last_absolute_position() -> None:
    program = read("G0 X1 Y1 Z1\nG91 X1\nG1 Y.5 F9\nX-.25 Z1\nG90 X0\nG91 X1 Y1\nM30\n")
    expected = [[1, 1, 1], [2, 1, 1], [2, 1.5, 1], [1.75, 1.5, 2], [0, 1.5, 2], [1, 2.5, 2]]
    np.testing.assert_array_equal(ends(program).round(9), expected)


def test_a_later_code_of_a_block_holds_for_the_coordinates_before_it() -> None:
    np.testing.assert_allclose(ends(read("X1 Y1 Z1 G0 G20\nM2\n"))[0], [25.4] * 3)


# ---- arcs


@pytest.mark.parametrize(
    ("plane", "words", "centre", "normal"),
    [
        ("G17", "X10 I5", [5, 0, 10], [0, 0, 1]),
        ("G18", "X10 I5", [5, 0, 10], [0, 1, 0]),
        ("G19", "Y10 J5", [0, 5, 10], [1, 0, 0]),
    ],
)
def test_arcs_turn_about_the_normal_of_their_plane(plane: str, words: str, centre, normal) -> None:
    motions = read(AT_Z10 + f"{plane} G3 {words} F100\nG2 X0 Y0 {words[-2]}-5\nM30\n").motions
    assert motions.kind.tolist() == [PTP, CIRC, CIRC]
    np.testing.assert_allclose(motions.centre[1:] * 1e3, [centre, centre], atol=1e-12)
    np.testing.assert_array_equal(motions.normal[1:], [normal, np.negative(normal)])
    np.testing.assert_allclose(motions.sweep[1:], math.pi)
    assert np.isnan(motions.centre[0]).all()
    assert np.isnan(motions.sweep[0])


@pytest.mark.parametrize("words", ["I5", "I5 J0", "X0 Y0 I5", "G91 X0 I5", "G90.1 I5 J0", "I5 P1"])
def test_an_arc_that_ends_where_it_began_is_a_full_circle(words: str) -> None:
    motions = read(AT_Z10 + f"G2 {words} F100\nM30\n").motions
    assert motions.sweep[1] == pytest.approx(2.0 * math.pi, abs=0.0)
    np.testing.assert_allclose(motions.centre[1] * 1e3, [5, 0, 10], atol=1e-12)


def test_helices_rise_along_the_normal_and_may_have_several_turns() -> None:
    motions = read(AT_Z10 + "G3 X10 Z4 I5 P3 F100\nG3 I-5 Z0\nM30\n").motions
    np.testing.assert_allclose(motions.sweep[1:], [5.0 * math.pi, 2.0 * math.pi])
    np.testing.assert_allclose(motions.centre[1:, 2] * 1e3, [10, 4])
    np.testing.assert_allclose(motions.target[1:, 2, 3] * 1e3, [4, 0])


@pytest.mark.parametrize(
    ("words", "centre", "sweep"),
    [
        ("G2 X10 R6.25", [5, -3.75], 2 * math.asin(0.8)),
        ("G3 X10 R6.25", [5, 3.75], 2 * math.asin(0.8)),
        ("G2 X10 R-6.25", [5, 3.75], 2 * math.pi - 2 * math.asin(0.8)),
        ("G3 X10 R-6.25", [5, -3.75], 2 * math.pi - 2 * math.asin(0.8)),
        ("G3 X10 R4.9995", [5, 0], math.pi),
    ],
)
def test_radius_arcs_lie_where_sign_and_direction_put_them(words: str, centre, sweep: float) -> None:
    motions = read(AT_Z10 + f"{words} F100\nM30\n").motions
    np.testing.assert_allclose(motions.centre[1, :2] * 1e3, centre, atol=1e-12)
    assert motions.sweep[1] == pytest.approx(sweep)


def test_a_modal_arc_needs_only_its_words() -> None:
    motions = read(AT_Z10 + "G2 X10 I5 F100\nX20 I5\nI3\nM30\n").motions
    np.testing.assert_allclose(motions.sweep[1:], [math.pi, math.pi, 2 * math.pi])


def test_arc_ends_are_as_programmed_even_where_the_radii_differ_by_rounding() -> None:
    motions = read(AT_Z10 + "G2 X10.02 I5 F100\nM30\n").motions
    assert motions.target[1, 0, 3] == pytest.approx(10.02e-3, abs=1e-15)
    assert motions.centre[1, 0] == pytest.approx(5e-3, abs=1e-15)


def test_an_offset_of_zero_across_the_plane_is_read_over() -> None:
    plain = read(AT_Z10 + "G2 X10 I5 F100\nG3 X0 R6\nG18 X5 I2.5\nM30\n")
    for zero in ("K0", "K-0.000", "k.0"):
        text = AT_Z10 + f"G2 X10 I5 {zero} F100\nG3 X0 R6 {zero}\nG18 X5 I2.5 {zero.lower().replace('k', 'J')}\nM30\n"
        np.testing.assert_array_equal(read(text).motions.centre, plain.motions.centre)
        np.testing.assert_array_equal(read(text).motions.sweep, plain.motions.sweep)
    assert fault(AT_Z10 + "G2 X10 K0 F9\nM30\n").problem == "arc without I, J, K or R"
    assert "across its plane" in fault(AT_Z10 + "G2 X10 I5 K.001 F9\nM30\n").problem


def test_other_axes_that_stay_at_zero_are_read_over() -> None:
    program = read("G21 G90\nG0 X0 Y0 Z10 A0.\nG1 Z0 U0 F100 B-0.0\nG2 X10 I5 A0.000 C+0\nA0\nM30\n")
    plain = read("G21 G90\nG0 X0 Y0 Z10\nG1 Z0 F100\nG2 X10 I5\n\nM30\n")
    np.testing.assert_array_equal(program.motions.target, plain.motions.target)
    told = {i.subject: (i.level, i.source_line) for i in group_issues(program.issues) if i.kind == "other-axis"}
    assert told == {"A": ("info", 2), "U": ("info", 3), "B": ("info", 3), "C": ("info", 4)}


# ---- work offsets


def test_g54_is_the_base_itself_and_others_come_from_the_cell() -> None:
    program = read("G0 X1 Y2 Z3\nG55 X1\nG54 Y0\nG56 X0 Y0 Z0\nM30\n")
    position = ends(program)
    np.testing.assert_allclose(position[:3], [[1, 2, 3], [101, 2, 3], [101, 0, 3]], atol=1e-12)
    np.testing.assert_allclose(position[3], [10, 20, 30], atol=1e-12)
    pose = CELL.work_offsets["G56"].pose()
    np.testing.assert_allclose(program.motions.target[3, :3, :3], pose[:3, :3] @ CELL.tool_orientation())


def test_axes_left_open_after_a_change_of_offset_stay_where_the_machine_is() -> None:
    position = ends(read("G56 G0 X5 Y6 Z7\nG54 Z0\nG56 X5 Y6 Z7\nM30\n"))
    np.testing.assert_allclose(position[1, :2], position[0, :2], atol=1e-12)
    np.testing.assert_allclose(position[2], position[0], atol=1e-12)


def test_arcs_are_turned_with_their_work_offset() -> None:
    text = "{} G0 X0 Y0 Z0\nG3 X10 I5 F100\nM30\n"
    plain, turned = read(text.format("G54")).motions, read(text.format("G56")).motions
    pose = CELL.work_offsets["G56"].pose()
    np.testing.assert_allclose(turned.centre[1], pose[:3, :3] @ plain.centre[1] + pose[:3, 3], atol=1e-15)
    np.testing.assert_allclose(turned.normal[1], pose[:3, :3] @ plain.normal[1], atol=1e-15)
    assert turned.sweep[1] == plain.sweep[1]


def test_g54_too_may_be_given_in_the_cell() -> None:
    cell = msgspec.structs.replace(CELL, work_offsets={"G54": CELL.work_offsets["G55"]})
    np.testing.assert_allclose(ends(read("G0 X1 Y2 Z3\nM30\n", cell)), [[101, 2, -2]], atol=1e-12)


# ---- events, comments, forces


def events(program) -> list[tuple]:
    return [(e.before, e.kind, e.line, e.value, e.text) for e in program.events]


def test_events_stand_before_the_motion_of_their_line_and_stops_after_it() -> None:
    text = "(part 1)\nT2 M6\nG0 X0 Y0 Z10 S9000 M3 M8 (go)\nG4 P1.5\nG1 Z0 F100 M0\nS8000\nM5 M9\nG0 Z10\nM30 (end)\n"
    assert events(read(text)) == [
        (0, "comment", 1, 0.0, "part 1"),
        (0, "tool_change", 2, 2.0, ""),
        (0, "comment", 3, 0.0, "go"),
        (0, "spindle_on", 3, 9000.0, ""),
        (0, "coolant_on", 3, 0.0, ""),
        (1, "dwell", 4, 1.5, ""),
        (2, "stop", 5, 0.0, ""),
        (2, "spindle_on", 6, 8000.0, ""),
        (2, "spindle_off", 7, 0.0, ""),
        (2, "coolant_off", 7, 0.0, ""),
        (3, "comment", 9, 0.0, "end"),
    ]


def test_a_tool_change_stops_the_spindle_first() -> None:
    assert events(read("G0 X0 Y0 Z10 S100 M3\nT2 M6\nT3 M6 S50 M4\nG1 Z0 F100\nM5\nM30\n")) == [
        (0, "spindle_on", 1, 100.0, ""),
        (1, "spindle_off", 2, 0.0, ""),
        (1, "tool_change", 2, 2.0, ""),
        (1, "tool_change", 3, 3.0, ""),
        (1, "spindle_ccw", 3, 50.0, ""),
        (2, "spindle_off", 5, 0.0, ""),
    ]


def test_the_end_of_the_program_switches_off_what_still_runs() -> None:
    assert events(read("G0 X0 Y0 Z10 S100 M4 M7\nM30\n")) == [
        (0, "spindle_ccw", 1, 100.0, ""),
        (0, "coolant_on", 1, 0.0, ""),
        (1, "spindle_off", 2, 0.0, ""),
        (1, "coolant_off", 2, 0.0, ""),
    ]


@pytest.mark.parametrize(
    ("tail", "line", "count"),
    [
        ("M30\nG0 X5\n", 4, 1),
        ("M2\n\n(next)\n%\nO1001\nG1 X5 (y)\n", 7, 2),
        ("%\n%\n nonsense\n", 5, 1),
        ("M30\n%\n", None, 0),
        ("M30 ; end\n\n (made by hand)\r\n % \n", None, 0),
        ("G0 X1 M30", None, 0),
    ],
)
def test_code_after_the_end_is_told_and_not_executed(tail: str, line: int | None, count: int) -> None:
    program = read(AT_Z10 + tail)
    told = [(issue.level, issue.source_line, issue.count) for issue in program.issues if issue.kind == "after-end"]
    assert told == ([("warning", line, count)] if line else [])
    assert len(program.motions) == 1 + ("X1" in tail)


def test_nothing_after_the_end_of_the_program_is_read() -> None:
    for end in ("M30", "M2", "M02", "%", "G0 Z20 M30"):
        program = read(AT_Z10 + f"{end}\nG41 nonsense ( \n(FORCE FX=)\n#1=2\n")
        assert program.events == program.notes == ()
    assert len(program.motions) == 2


def test_force_comments_become_notes_and_no_events() -> None:
    program = read(AT_Z10 + "G1 Z0 F100 (force FX=120 FY=-40.5 FRAME=TOOL)\nX1 ; FORCE OFF\n(FORCED COOLING)\nM30\n")
    assert program.notes == (
        ForceNote(3, (120.0, -40.5, 0.0, 0.0, 0.0, 0.0), "TOOL", 1),
        ForceNote(4, (0.0,) * 6, before=2),
    )
    assert events(program) == [(3, "comment", 5, 0.0, "FORCED COOLING")]


def test_a_force_comment_that_cannot_be_read_names_its_line() -> None:
    with pytest.raises(ForceError, match=r"part\.nc:3: .*"):
        read(AT_Z10 + "(FORCE FX=abc)\nM30\n")


def test_message_comments_are_plain_comments_and_semicolons_and_brackets_may_hold_each_other() -> None:
    program = read(AT_Z10 + "(MSG, hello; you) G1 (b) X1 F10 ; c (d) ; e\nM30\n")
    assert [e.text for e in program.events] == ["MSG, hello; you", "b", "c (d) ; e"]
    assert lines(program) == [2, 3]


@pytest.mark.parametrize(
    ("block", "blend"), [("G61", 0.0), ("G61.1", 0.0), ("G64", 5e-4), ("G64 P.02", 4e-5), ("G64 P9 Q1", 5e-4)]
)
def test_exact_stop_and_blending_modes_set_the_approximation_distance(block: str, blend: float) -> None:
    motions = read(AT_Z10 + f"G1 X1 F100\nG61\n{block}\nX2\nM30\n").motions
    assert motions.blend[1] == 5e-4
    assert motions.blend[2] == pytest.approx(blend, abs=1e-18)


def test_blending_tolerance_is_in_the_units_of_the_program() -> None:
    assert read("G20 G64 P.001\nG0 X0 Y0 Z1\nM30\n").motions.blend[0] == pytest.approx(50.8e-6)


# ---- issues


@pytest.mark.parametrize(
    ("text", "kind", "level", "line"),
    [
        ("G21 G0 X0 Y0 Z0\nG43 H1 Z50\nM30\n", "tool-length", "info", 2),
        ("G21\n/G0 X0 Y0 Z0\nM30\n", "block-delete", "info", 2),
        ("G0 X0 Y0 Z0\nM30\n", "units", "info", None),
        ("G0 X0 Y0 Z0\nG1 X2.1255 Y1 F30\nX0 Y0\nM30\n", "units", "warning", None),
        ("G0 X0 Y0 Z0\nG1 X2.125 Y1 F30\nX0 Y0\nM30\n", "units", "info", None),
        ("G0 X0 Y0 Z0\nG1 X2.12555 Y1 F30\nX0 Y0\nM30\n", "units", "info", None),
        ("G0 X0 Y0 Z0\nG1 X2.1255 Y45 F30\nX0 Y0\nM30\n", "units", "info", None),
        ("G0 X0 Y0 Z0\nG1 X2.1255 Y1 F200\nX0 Y0\nM30\n", "units", "info", None),
        ("G0 X0 Y0 Z0\nG1 X2 Y1 F30 (X1.2345)\nX0 Y0\nM30\n", "units", "info", None),
        ("G21 G0 X0 Y0 Z0\n(no end)\n", "program-end", "warning", 2),
        ("G21 G0 X0 Y0 Z0\nM3\nM30\n", "spindle-speed", "warning", 2),
    ],
)
def test_what_the_user_should_know_is_told(text: str, kind: str, level: str, line: int | None) -> None:
    (issue,) = read(text).issues
    assert (issue.kind, issue.level, issue.source_line) == (kind, level, line)


def test_a_usual_program_gives_no_issue() -> None:
    assert read("%\nO1000 (PART)\nG21 G90 G17 G40 G49 G80 G94 G54\nG0 X0 Y0 Z5\nG1 Z0 F100\nM30\n%\n").issues == ()


# ---- real input


REAL = "%\nO1000 (FRÄSEN)\nN10 G0 G17 G21 G40 G49 G80 G90 G98\nN20 G54 X0. Y0. S9000 M3\nN30 G43 H1 Z+5.\n"
REAL += "N40 G1 Z-1 F300.\nN50 X -10 Y1 . 5\nN60 G2X0Y0I5.J-.75\nN70 M30\n%\n"
CLEAN = "O1000\nG0 G21 G90\nG0 X0 Y0 S9000 M3\nG43 H1 Z5\nG1 Z-1 F300\nX-10 Y1.5\nG2 X0 Y0 I5 J-0.75\nM30\n"


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
@pytest.mark.parametrize("case", [str, str.lower])
def test_files_as_cam_systems_write_them_are_read_alike(end: str, encoding: str, case) -> None:
    document = decode("part.nc", case(REAL).replace("\n", end).encode(encoding))
    program = gcode.read(document, CELL, forward, "part")
    assert lines(program) == [5, 6, 7, 8]
    assert program.still.tolist() == [4]
    np.testing.assert_array_equal(program.motions.target, read(CLEAN).motions.target)
    assert program.documents[0].to_bytes() == case(REAL).replace("\n", end).encode(encoding)
    assert program.events[0].text == case("FRÄSEN")


@pytest.mark.parametrize(
    "text",
    [
        "g0x1y2z3\nm2",
        "G0 X1\tY2  Z3\nM2",
        "  G 0 X + 1 Y 0 2 . Z 3\nM2",
        "G00X01.Y+2.0Z3.000M2",
        "N1 G0 (a) X1 (b) Y2 Z3 ; c\nM2",
        "/ G0 X1 Y2 Z3\n/M2",
        "G0 Z3 Y2 X1\nN2\n\n()\nM2",
        "%\nG0 X1 Y2 Z3\n%",
        "\n (head)\n % name\nG0 X1 Y2 Z3\n%\nrest",
        "N9 O5 (name)\nG0 X1 Y2 Z3 M2",
        "G0\nX1 Y2 Z3\nM2",
    ],
)
def test_spellings_do_not_matter(text: str) -> None:
    np.testing.assert_array_equal(ends(read(text)), ends(read("G0 X1 Y2 Z3\nM2\n")))
    assert outcome(text, bulk=True) == outcome(text, bulk=False)


def test_a_hundred_thousand_lines_keep_their_numbers() -> None:
    body = [f"X{n / 1000:.3f} Y{n % 7}" if n % 1000 else f"(layer {n})" for n in range(100_000)]
    program = read("G0 X0 Y0 Z0\r\nG1 F100\r\n" + "\r\n".join(body) + "\r\nM30\r\n")
    expected = [1, *(n + 3 for n in range(100_000) if n % 1000)]
    assert lines(program) == expected
    np.testing.assert_allclose(ends(program)[1:, 0], [n / 1000 for n in range(100_000) if n % 1000], atol=1e-9)
    assert len(program.events) == 100


def test_arrays_cannot_be_changed() -> None:
    motions = read(AT_Z10 + "M30\n").motions
    columns = {name: getattr(motions, name) for name in type(motions).__slots__}
    columns |= {"position": motions.target.position, "rotation": motions.target.rotation}
    columns |= {"joints": motions.joints.values, "run": motions.joints.run}
    del columns["target"]
    for column in columns.values():
        with pytest.raises(ValueError, match="read-only"):
            column[0] = 0


# ---- errors


def test_an_error_names_file_line_text_and_advice() -> None:
    error = fault("(part)\r\nG0 X0 Y0 Z0\r\nN20 g41 D1 x5\r\n")
    assert (error.file, error.line, error.text) == ("part.nc", 3, "N20 g41 D1 x5")
    assert error.problem == "G41 is not supported"
    assert "tool centre line" in str(error.advice)


@pytest.mark.parametrize("data", [b"", b"\n\n", b"\xef\xbb\xbf \r\n", b"G0 X0\0"])
def test_empty_and_binary_files_are_errors(data: bytes) -> None:
    with pytest.raises(ProgramError, match=r"part\.nc: "):
        read(data)


@pytest.mark.parametrize(
    ("block", "problem"),
    [
        ("G1 X5", "without a feed"),
        ("G1 X5 F0", "without a feed"),
        ("G1 X5 F-3", "negative feed"),
        ("G2 X10 F9", "without I, J, K or R"),
        ("G2 X10 I5 R5 F9", "with R and with I, J or K"),
        ("O5 O6", "an O word among other words"),
        ("G0 X1 O5", "an O word among other words"),
        ("X1O5Y2", "an O word among other words"),
        ("G2 X10 K5 F9", "offset across its plane"),
        ("G18 G2 X10 J5 F9", "offset across its plane"),
        ("G19 G2 Y10 I5 F9", "offset across its plane"),
        ("G90.1 G2 X10 I5 F9", "incomplete absolute centre"),
        ("G2 X10 I4 F9", "radii of the arc disagree: 4.0000 mm at the start, 6.0000 mm at the end"),
        ("G2 X10 R4 F9", "R too small to reach the end point: 4.0000 mm where 5.0000 mm is the least"),
        ("G2 X0 Y0 R4 F9", "ends where it begins"),
        ("G2 R4 F9", "without an end point"),
        ("G2 X0 Y0 I0 J0 F9", "radius zero"),
        ("G2 X10 I5 P1.5 F9", "not a whole number"),
        ("G2 X10 I5 P0 F9", "below 1"),
        ("G0 X1 I5", "without an arc"),
        ("G0 P1", "without an arc"),
        ("G0 X1 X2", "2 X words"),
        ("G0 G1 X1 F9", "one modal group"),
        ("M3 M5", "one modal group"),
        ("M7 M8", "one modal group"),
        ("G0 X", "X without a number"),
        ('T"D10_END_MILL" M6', "a tool by its name, not by a number"),
        ("G6.2 P4 K0 X1 Y1 R1", "G6.2 is not supported"),
        ("BSPLINE SD=3 X1", "this is not plain G-code, but a Siemens Sinumerik program"),
        ("$OKUMA.SSB%", "this is not plain G-code, but an Okuma program"),
        ("$1001.SUB%", "this is not plain G-code, but an Okuma program"),
        ("G0 XNAN", "X without a number"),
        ("G0 Xinf", "X without a number"),
        ("G0 X1e3", "E word"),
        ("G0 X1,5", "unexpected character ','"),
        ("G0 X1.2.3", "unexpected character '.'"),
        ("G0 X=5", "X without a number"),
        ("G0 X1*55", "unexpected character"),
        ("G0 \N{FULLWIDTH LATIN CAPITAL LETTER X}1", "not ASCII"),
        ("G0 X12345678", "is out of range"),
        ("G0 X" + "9" * 400, "is out of range"),
        ("G0 X#5", "parameter #5 has no value"),
        ("G0 X[1+]", "a value was expected"),
        ("G0 X" + "[" * 3000, "more than 50 brackets or signs one in another"),
        ("G0 X#" + "-" * 3000 + "1", "more than 50 brackets or signs one in another"),
        ("G80\nX5 Z-9", "coordinates without G0, G1, G2 or G3"),
        ("G4", "G4 without a time"),
        ("G4 X-1", "G4 without a time"),
        ("G4 P1 G2 X10 I5 F9", "G4 in one block with an arc"),
        ("G2 X10 I5 F9\nG4 P1 X20 I5", "G4 in one block with an arc"),
        ("O100 sub", "O100 SUB without its end"),
        ("o<cut> call", "neither in this file nor in its folder"),
        ("M98 P1000", "neither in this file nor in its folder"),
        ("M101", "M101 is not known"),
        ("G57", "work offset G57 is not in the cell"),
        ("G12.3", "G12.3 is not known"),
        ("G1.25 X1", "not valid"),
        ("G0 X1 N5", "N is not the first word"),
        ("N1.5 G0 X1", "not valid"),
        ("T1.5", "T1.5 is not a whole number"),
        ("N" + "9" * 5000 + " G0 X1", "too many digits"),
        ("L" + "9" * 400, "too many digits"),
        ("G0" * 100_000, "more than 100 words"),
        ("G1 X1" + " E" * 100_000 + "x", "E without a number"),
        ("S-1", "negative spindle speed"),
        ("H1", "H word without a code"),
        ("G0 A.001", "A word without a code"),
        ("G0 U1", "U word without a code"),
        ("G1 X1E2F9", "E word without a code"),
        ("(a (b) c1)", "bracket"),
        ("(not closed", "bracket"),
        ("G0 X1 )", "bracket"),
        ("G0 X1 % Y1", "unexpected character '%'"),
    ],
)
def test_what_cannot_be_read_is_an_error(block: str, problem: str) -> None:
    error = fault(AT_Z10 + block + "\nM30\n")
    assert problem in error.problem
    assert error.line == 3 + block.count("\n")
    assert error.file == "part.nc"


@pytest.mark.parametrize(("code", "table"), [("G57", "[work_offsets.G57]"), ("G59.2", '[work_offsets."G59.2"]')])
def test_the_table_of_a_missing_work_offset_is_named_as_toml_has_it(code: str, table: str) -> None:
    assert table in str(fault(f"{AT_Z10}{code}\nM30\n"))


REFUSED_G = (
    5.1,
    7,
    16,
    33,
    38.2,
    41,
    42.1,
    43.1,
    44,
    51,
    53.1,
    54.1,
    68,
    68.2,
    74,
    76,
    87,
    95,
    96,
)
REFUSED_M = (19, 60, 61, 62, 68, 97)


@pytest.mark.parametrize("code", [*(f"G{n}" for n in REFUSED_G), *(f"M{n}" for n in REFUSED_M)])
def test_codes_that_could_change_the_motion_are_refused_with_advice(code: str) -> None:
    error = fault(AT_Z10 + f"{code}\nM30\n")
    assert (error.line, error.problem) == (3, f"{code} is not supported")
    assert error.advice


@pytest.mark.parametrize(
    ("text", "problem", "line"),
    [
        ("G0 X0 Y0\nG1 X5 F9\nG0 Z1\n", "cutting move before the position is known", 2),
        ("G1 X5 Y5 F9\n", "cutting move before the position is known", 1),
        ("G0 X10 Y10\nG1 Z-5 F9\n", "cutting move before the position is known", 2),
        ("G0 X10 Y10\nG1 X1 Y1 Z-5 F9\n", "cutting move before the position is known", 2),
        ("G2 X1 Y1 Z1 I5 F9\n", "arc before the position is known", 1),
        ("G0 X0 Y0\nG3 X10 Z1 I5 F9\n", "arc before the position is known", 2),
        ("G0 X0 Y0\nG55 G0 Z1\n", "change of the work offset before the position is known", 2),
        ("G0 X0 Y0\nG2 X10 I5 F9\nG0 Z0\n", "arc before the position is known", 2),
        ("G91\nG0 Z5\n", "incremental move before the position is known", 2),
        ("G0 X0 Y0\nG91 Z5\n", "incremental move before the position is known", 2),
        ("%\nG0 X0 Y0 Z0\n", "begins with %", 2),
        ("(only a comment)\nM30\n", "moves nothing", None),
        ("G0 X0 Y0\nM30\n", "moves nothing", None),
    ],
)
def test_programs_that_begin_or_end_badly_are_errors(text: str, problem: str, line: int | None) -> None:
    error = fault(text)
    assert problem in error.problem
    assert error.line == line
    assert outcome(text, bulk=True) == outcome(text, bulk=False)


def test_a_cutting_move_too_early_gives_advice() -> None:
    assert "Program X, Y and Z in rapid moves" in str(fault("G0 X10 Y10\nG1 Z-5 F9\n").advice)
    assert "never all programmed" in str(fault("G0 X10 Y10\nM30\n").advice)


def problems(text: str) -> list[tuple[int | None, str]]:
    with pytest.raises(InputError) as caught:
        read(text)
    return [(error.line, error.problem) for error in (caught.value, *caught.value.further_errors)]


def test_all_errors_of_a_program_are_told_in_order_of_lines() -> None:
    text = AT_Z10 + (
        "G1 X1 F100\nM101\n(FORCE FX=1 FX=2)\nG1 X[1+#2]\n(not closed\nG0 X1 Y2 Z3\nG2 X9 I1\nG57\nX5 X6\nM30\n"
    )
    assert problems(text) == [
        (4, "M101 is not known"),
        (5, "force comment cannot be read"),
        (6, "parameter #2 has no value"),
        (7, "a bracket outside of comments"),
        (9, "radii of the arc disagree: 1.0000 mm at the start, 7.0000 mm at the end"),
        (10, "work offset G57 is not in the cell"),
        (11, "2 X words in one block"),
    ]


@pytest.mark.parametrize(
    "text",
    [
        "G76 X1 Y1 Z-1 R1 F10\nX2 Y2\nX3\nG80\nG1 X5\n",  # what the cycle's modes mean is not known
        "G28 X1\nG1 F9 X2\nG2 X10 I4\n",  # where the tool stands is not known
        "G1 X#1 F#2\nY5\nX9\n",  # whether there is a feed is not known
        "G2 X[3] I#5 F1\nI5\n",
        "G91 G0 X--1\nG90 G2 X10 Y0 I5 F9\n",
    ],
)
def test_an_error_causes_no_others(text: str) -> None:
    assert [line for line, _ in problems(AT_Z10 + text + "M30\n")] == [3]


def test_what_is_understood_of_a_bad_block_holds_for_the_next_ones() -> None:
    text = AT_Z10 + "G41 D1 G1 G91 X5 F100\nX1\nG90 X0 Y0\nG18 M101\nG2 X10 I5\nX20 J5\nM30 M102\nG41 nonsense\n"
    assert problems(text) == [
        (3, "G41 is not supported"),
        (6, "M101 is not known"),
        (8, "arc with an offset across its plane"),
        (9, "M102 is not known"),
    ]


def test_a_mistake_that_goes_on_is_told_once() -> None:
    assert problems(AT_Z10 + "G1 X1\nX2\nX3\nM30\n") == [(3, "cutting move without a feed")]
    assert problems("G91\nG0 X1\nX2\nM30\n") == [(2, "incremental move before the position is known")]


def test_the_first_errors_of_a_hopeless_file_are_enough() -> None:
    found = problems(AT_Z10 + "M101\n" * 100_000)
    assert [line for line, _ in found] == list(range(3, 3 + MAX_ERRORS + 1))


def test_the_first_error_of_a_program_is_reported_whatever_its_kind() -> None:
    assert fault(AT_Z10 + "G1 X5\nG41\n").line == 3
    assert fault(AT_Z10 + "G41\nG1 X5\n").line == 3
    assert fault("G41\nG1 X5\n").line == 1
    assert fault(AT_Z10 + "G2 X10 I1 F9\nG1 F0 X1\nG41\n").line == 3


# ---- programs of other kinds

FOREIGN = {
    "Heidenhain": [
        "0 BEGIN PGM PART MM\n1 BLK FORM 0.1 Z X+0 Y+0 Z-20\n2 TOOL CALL 5 Z S8000\n3 L X+10 Y+10 R0 FMAX M3\n",
        "N10 G0 X1 Y1 Z1\n12 L  Z-5  F500\n13 CC X+0 Y+0\n",
        "0  BEGIN PGM 1001 MM \r\n1  L  Z+100 R0 FMAX\r\n",
    ],
    "Sinumerik": [
        "N10 G71 G90\nN20 G0 X1 Y1 Z1\n",
        'MSG("roughing")\nG0 X1 Y1 Z1\n',
        "G0 X1 Y1 Z5\nG2 X10 Y5 CR=7.5 F100\n",
        "CYCLE832(0.01,1,1)\nG0 X1 Y1 Z5\n",
        "G0 G90 X1 Y1 Z5\nSUPA G0 Z0 D0\n",
        'T="FRAESER_10"\nM6\nG0 X1 Y1 Z5\n',
        "N10G0X1Y1Z1\nN20G71\n",
        "G0 X1 Y1 Z1\nR1=5\n",
        "TRANS X10 Y20\nG0 X1 Y1 Z1\n",
        "%_N_PART_MPF\n;$PATH=/_N_WKS_DIR\nG0 X1 Y1 Z1\nTRAORI\n",
        "G0 X1 Y1 Z1\nG1 X=AC(5) F10\n",
    ],
    "APT": [
        "PARTNO/PART\nUNITS/MM\nLOADTL/1\nGOTO/1.0,2.0,3.0\n",
        "TOOL PATH/MILL,TOOL,D10\nTLDATA/MILL,10,0,75,0,0\nMSYS/0,0,0,1,0,0,0,1,0\nRAPID\nGOTO/1,2,3\n",
        "$$ made by CATIA\nFEDRAT/ 500.0,MMPM\n",
    ],
    "slicer": [
        ";FLAVOR:Marlin\nM104 S200\nM82\nG28\nG1 X1 Y1 E0.5 F1500\n",
        "G90\nG0 X1 Y1 Z1\nG1 X5 Y5 E.25 F900\n",
    ],
    "KRL": ["&ACCESS RVP\nDEF part( )\nPTP {X 1}\nEND\n", "DEF part()\nLIN XP1\nEND\n"],
}


@pytest.mark.parametrize(("name", "text"), [(name, text) for name, texts in FOREIGN.items() for text in texts])
def test_programs_for_other_controls_are_named(name: str, text: str) -> None:
    (error,) = problems(text)
    assert name in error[1]
    assert "post-processor for LinuxCNC" in fault(text).advice or name in ("KRL", "APT")


@pytest.mark.parametrize(
    "block",
    [
        "(MSG, tool) G41",
        "G41 ; CYCLE832 is not used",
        "M101 (TRANS X10)",
        "G12 (TOOL CALL 5)",
        "G0 X=5",
        "#1=#2",
        "G5 X1 E",
        "#ROTATE 90",
        "G6 TRANSFER",
        "G6 SOFTEN",
    ],
)
def test_a_word_in_a_comment_or_a_single_mistake_makes_no_other_control(block: str) -> None:
    assert "not plain G-code" not in fault(AT_Z10 + block + "\nM30\n").problem


def test_a_program_that_can_be_read_is_never_named_after_another_control() -> None:
    assert (
        len(read("(MSG BEGIN PGM TRANS CYCLE832 SUPA)\nG21 G0 X1 Y1 Z1 (CR=5)\nG1 X2 F10 ; GOTO/1,2,3\nM30\n").motions)
        == 2
    )


@pytest.mark.parametrize("feed", ["F60", "F[60]"])
def test_a_percent_sign_amid_the_blocks_is_an_error(feed: str) -> None:
    with pytest.raises(ProgramError, match="the program ends here, but coordinates follow") as caught:
        read(f"%\nG21 G90 G0 X1 Y2 Z3\n%\nO2\nG1 X9 {feed}\nM30\n%\n")
    assert caught.value.line == 3
    assert len(read(f"%\nG21 G90 G0 X1 Y2 Z3\nG1 X2 {feed}\n%\n(the end)\n").motions) == 2
