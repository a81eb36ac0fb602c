"""Habits of posts for Fanuc-style controls that LinuxCNC's interpreter does not share."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.cell import Cell, Machine
from postproc.errors import ProgramError
from postproc.program import LIN
from tests.commands import invoke
from tests.dialects.gcode_reading import CELL, ends, read
from tests.places import CELL_FILE

HIGH_FEED = (
    "(Using high feed G1 F5000. instead of G0.)\nG90 G94 G17 G21\nG53 G0 Z0.\nT1 M6\nS9000 M3\nG54\n"
    "G1 X10. Y20. F5000.\nG43 Z15. H1\n{force}Z-1. F300.\nX40. F900.\nZ15. F5000.\nM5\nG53 G0 Z0.\nM30\n"
)
CELL_HERE = replace(CELL, machine=replace(CELL.machine, clearance_Z=100.0))


def high_feed(force: str = "", cell: Cell = CELL_HERE):
    return read(HIGH_FEED.format(force=force), cell)


def test_moves_at_feed_before_the_position_is_known_begin_at_start():
    program = high_feed()
    m = program.motions
    assert m.kind[0] == LIN
    assert not m.rapid[0]
    np.testing.assert_allclose(ends(program)[:3], [[10, 20, 450], [10, 20, 15], [10, 20, -1]], atol=1e-9)
    np.testing.assert_allclose(m.feed[:3] * 60e3, [5000, 5000, 300])
    assert program.unforced.tolist() == [0, 1]
    told = [issue for issue in program.issues if issue.kind == "from-start"]
    assert [(issue.level, issue.source_line) for issue in told] == [("warning", 7)]


def test_coordinates_without_a_motion_code_are_one_error():
    """Not one for each line: the others were called arcs without I, J, K or R."""
    with pytest.raises(ProgramError) as caught:
        read("G17 G21 G90\nX1 Y2 F100\nX2 Y3\nX3 Y3 Z1\nM2\n", CELL_HERE)
    assert (caught.value.line, caught.value.problem) == (2, "coordinates without G0, G1, G2 or G3")


def test_a_first_block_at_feed_that_gives_all_axes_begins_at_start_too():
    program = read("G1 X10 Y20 Z15 F5000\nZ-1 F300\nM2\n", CELL_HERE)
    assert program.unforced.tolist() == [0]
    told = [issue for issue in program.issues if issue.kind == "from-start"]
    assert [(issue.level, issue.source_line) for issue in told] == [("warning", 1)]
    np.testing.assert_allclose(ends(program), [[10, 20, 15], [10, 20, -1]], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("G0 X10 Y10\nG1 Z-5 F9\n", "cutting move before the position is known"),
        ("G0 Z5\nG0 Y40\nG1 Z-9 F9\nG0 Z5\nG0 X1 Y4\nG1 Z-3\n", "cutting move before the position is known"),
        ("G0 Z5\nG0 Y40\nG1 X1 Z-9 F9\nG0 Z5\n", "cutting move before the position is known"),
        ("G1 X10 Y10 F9\nG91 Z-5\n", "incremental move before the position is known"),
        ("G1 X10 Y10 F9\nG2 X0 I-5\nG1 Z1\n", "arc before the position is known"),
        ("G1 X10 Y10 F9\nX5\nY3\n", "cutting move before the position is known"),
        ("G1 X10 Y10 F9\nG55 Z1\n", "change of the work offset before the position is known"),
        ("G1 X10 Y10 F9\nG81 Z-1 R1\nG0 Z5\n", "cutting move before the position is known"),
    ],
)
def test_other_moves_before_the_position_is_known_are_refused(text, problem):
    with pytest.raises(ProgramError, match=problem):
        read(f"{text}M2\n", CELL_HERE)


def test_a_force_on_a_move_from_start_is_an_error(tmp_path):
    program = tmp_path / "part.nc"
    forces = tmp_path / "part.csv"
    (tmp_path / "cell.toml").write_text(CELL_FILE.read_text() + "\n[machine]\nclearance_Z = 100\n")

    def convert(text, *options):
        program.write_text(text)
        arguments = [
            "convert",
            str(program),
            "--cell",
            str(tmp_path / "cell.toml"),
            "-o",
            str(tmp_path / "o"),
            *options,
        ]
        return invoke(*arguments)

    cutting = HIGH_FEED.format(force="(FORCE FX=100 FY=0 FZ=50)\n")
    assert convert(cutting).exit_code == 0
    early = convert("(FORCE FX=100 FY=0 FZ=50)\n" + HIGH_FEED.format(force=""))
    assert early.exit_code == 1
    assert "part.nc:8: a force on a move from [start] of the cell" in early.output
    forces.write_text("line,Fx,Fy,Fz\n8,0,0,5\n")
    assert "part.nc:8: a force on a move from" in convert(HIGH_FEED.format(force=""), "--forces", str(forces)).output
    forces.write_text("line,Fx,Fy,Fz\n7,0,0,0\n10,0,0,5\n")
    assert convert(HIGH_FEED.format(force=""), "--forces", str(forces)).exit_code == 0


@pytest.mark.parametrize("code", ["G41 D0", "G42D0", "G41.1 D0", "G0 G42 D0 X5"])
def test_radius_compensation_with_d0_has_no_effect(code):
    program = read(f"G0 X0 Y0 Z5\n{code}\nG1 X9 F90\nG40\nM2\n")
    without = read(f"G0 X0 Y0 Z5\n{'G0 X5' if 'X5' in code else ''}\nG1 X9 F90\nG40\nM2\n")
    np.testing.assert_array_equal(program.motions.target, without.motions.target)
    assert "radius-compensation" in {issue.kind for issue in program.issues}


@pytest.mark.parametrize("code", ["G41", "G41 D1", "G42 D0.5", "G42.1 D3", "D0"])
def test_other_radius_compensation_is_refused(code):
    with pytest.raises(ProgramError) as caught:
        read(f"G0 X0 Y0 Z5\n{code}\nG1 X9 F90\nM2\n")
    if code != "D0":
        assert "write D0" in str(caught.value)


@pytest.mark.parametrize("code", ["G41.1 D3", "G42.1 D#1", "G41.1"])
def test_a_diameter_in_the_program_is_refused_even_where_offsets_hold_wear(code):
    cell = replace(CELL, gcode=replace(CELL.gcode, radius_offsets="wear"))
    with pytest.raises(ProgramError, match=r"G4[12]\.1 is not supported.*diameter in the program"):
        read(f"#1=.5\nG0 X0 Y0 Z5\n{code}\nG1 X9 F90\nM2\n", cell)
    assert len(read("#1=0\nG0 X0 Y0 Z5\nG41.1 D#1\nG1 X9 F90\nM2\n", cell).motions) == 2


@pytest.mark.parametrize(
    "comment", ["(4x (M6) holes)", "( from (48.5, 53.5) to (59.5, 71) )", "(depth cut(s) at 0.3mm)"]
)
def test_brackets_in_a_comment_belong_to_it(comment):
    program = read(f"G0 X0 Y0 Z5\n{comment}\nG1 X9 F90\nM2\n")
    assert comment[1:-1].strip() in [event.text for event in program.events]
    assert [issue.source_line for issue in program.issues if issue.kind == "brackets"] == [2]
    assert not [i for i in read("G0 X0 Y0 Z5\n; a (b)\nG1 X9 F90\nM2\n").issues if i.kind == "brackets"]


@pytest.mark.parametrize(
    "comment", ["(a (b) X5)", "(a (b) G1 Z-5 (c) )", "(a (b) X#1)", "(a (b)", "(a) b)", "(a (b (c)))"]
)
def test_brackets_that_a_control_might_read_otherwise_are_refused(comment):
    """A control that ends the comment at its first closing bracket would execute what follows."""
    with pytest.raises(ProgramError):
        read(f"#1=3\nG0 X0 Y0 Z5\n{comment}\nG1 X9 F90\nM2\n")


@pytest.mark.parametrize(("name", "what"), [("a.spf", "Siemens Sinumerik"), ("a.prg", "several use .prg")])
def test_extensions_of_other_controls_are_named(tmp_path, name, what):
    (tmp_path / name).write_text("G0 X0 Y0 Z5\nG1 X9 F90\nM2\n")
    done = invoke("predict", tmp_path / name, cell=CELL_FILE)
    assert done.exit_code == 1
    assert what in done.output
    assert "--dialect gcode" in done.output.replace("\n", " ")


@pytest.mark.parametrize("words", ["G41 D1", "G42 D12", "G41", "G41 D0"])
def test_radius_compensation_by_wear_offsets_has_no_effect_and_is_reported(words):
    """Fusion and Mastercam, compensation "wear": the path is that of the tool's centre."""
    plain = "G21 G90\nG0 X0 Y0 Z5\nG1 Z0 F100\n{}\nX10\nG3 X20 Y10 I0 J10\nG40\nG1 X0\nM2\n"
    cell = replace(CELL, gcode=replace(CELL.gcode, radius_offsets="wear"))
    program = read(plain.format(f"{words} G1 X5"), cell)
    without = read(plain.format("G1 X5"), cell)
    np.testing.assert_array_equal(program.motions.target, without.motions.target)
    remark = "with D0" if words.endswith("D0") else "offsets that hold wear only"
    assert [remark in issue.message for issue in program.issues if issue.kind == "radius-compensation"] == [True]


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("G1 X[#<scale>*4] Y5 F9", "cutting move before the position is known"),  # SCALE is Siemens
        ("G1 X5 M67 E2 Q25", "M67 is not supported"),  # E is an output, not an extruder
    ],
)
def test_words_of_linuxcnc_are_not_taken_for_another_control(line, what):
    with pytest.raises(ProgramError) as caught:
        read(f"#<scale>=2\n{line}\nM2\n")
    assert caught.value.problem == what


INIT = replace(CELL, machine=replace(CELL.machine, clearance_Z=200.0))
"""As `postproc init` writes it: a height to retract to, but no home."""
CUT = "G0 X10 Y20\nZ5\nG1 Z-1 F90\n"


@pytest.mark.parametrize(
    "park", ["G28 G91 X0 Y0\nG90", "G53 G0 X-300 Y0", "G28", "G53 G0 X-300 Y0 Z0", "G30 G91 Y0\nG90"]
)
def test_without_home_the_tool_parks_above_its_place(park):
    program = read(f"{CUT}{park}\nG0 X50 Y60\nZ5\nG1 Z-2\n{park}\nM30\n", INIT)
    expected = [[10, 20, 5], [10, 20, -1], [10, 20, 200], [50, 60, 200], [50, 60, 5], [50, 60, -2], [50, 60, 200]]
    np.testing.assert_allclose(ends(program), expected, atol=1e-9)
    assert program.motions.rapid.tolist() == [True, False, True, True, True, False, True]
    assert [issue.level for issue in program.issues if issue.kind == "parked"] == ["info"] * 2
    assert INIT.machine.home is None


@pytest.mark.parametrize(
    "after",
    [
        "Z5",
        "G0 X1 Z5",
        "G0 X1\nZ5",
        "G0 X1 Y2 Z5",
        "G1 X1 Y2 F90",
        "G91 G0 X1 Y2",
        "G81 X1 Y2 Z-1 R1 F90",
        "G2 X1 Y2 I5",
    ],
)
def test_after_parking_x_and_y_are_programmed_first(after):
    """The machine would go on from another place."""
    for park in ("G28 G91 X0 Y0\nG90", "G53 G0 X-300 Y0"):
        with pytest.raises(ProgramError, match="must be programmed again after G28, G30 or G53"):
            read(f"{CUT}{park}\n{after}\nM30\n", INIT)
    assert len(read(f"{CUT}G28 G91 Z0\nG90\n{after if after[0] == 'Z' else 'X1'}\nM30\n", INIT).motions) == 4


def test_only_the_axes_that_park_are_programmed_again():
    program = read(f"{CUT}G28 G91 Y0\nG90\nG0 Y7\nZ5\nG1 X3\nM30\n", INIT)
    np.testing.assert_allclose(ends(program)[2:], [[10, 20, 200], [10, 7, 200], [10, 7, 5], [3, 7, 5]], atol=1e-9)


@pytest.mark.parametrize("park", ["G91 G28 X0 Y0 Z0\nG90", "G53 G0 Z0\nG53 G0 X-300 Y0", "G91 G30 Z0\nG28 X0 Y0\nG90"])
@pytest.mark.parametrize(
    ("code", "axes"), [("G92 X0 Y0", "X"), ("G92 Z100", "Z"), ("G10 L20 P1 X0 Y0 Z0", "X and Y and Z"), ("G92 Y3", "Y")]
)
def test_the_place_of_a_machine_after_a_retract_is_no_origin(park, code, axes):
    """G92 and G10 L20 give coordinates to the place of the machine (NIST RS274NGC 3.5.18), which is not the robot's."""
    with pytest.raises(ProgramError) as caught:
        read(f"{CUT}{park}\n{code}\nG0 X50 Y60\nZ5\nG1 Z-2\nM30\n", INIT)
    assert f"{axes} after G28, G30 or G53" in caught.value.problem
    assert caught.value.text == code
    again = f"{CUT}{park}\nG0 X50 Y60\nZ5\n{code}\nG0 X7 Y8\nZ9\nG1 Z6\nM30\n"
    x, y, z = ends(read(again, INIT))[-1]
    assert [x, y, z] == {
        "G92 X0 Y0": [57, 68, 6],
        "G92 Z100": [7, 8, -89],
        "G10 L20 P1 X0 Y0 Z0": [57, 68, 11],
        "G92 Y3": [7, 65, 6],
    }[code]


@pytest.mark.parametrize("home", [None, [0.0, -90.0, 90.0, 0.0, 10.0, 0.0]])
@pytest.mark.parametrize(
    ("park", "after"),
    [
        ("G28 Y0", "G0 Y0\nG1 X20"),  # Z of the machine is still at -1, the robot is at clearance_Z
        ("G28 X0\nG28 Y0", "G0 X0 Y0\nG2 X20 I10"),
        ("G53 G0 X0 Y0", "G0 X0 Y0\nG91 G1 Z-5"),
        ("G28 X0 Y0", "G0 X0 Y0\nG92 Z0\nG1 X9"),
    ],
)
def test_a_height_that_depends_on_the_retract_of_the_robot_is_refused(home, park, after):
    cell = replace(INIT, machine=replace(INIT.machine, home=home))
    with pytest.raises(ProgramError, match=r"Z (must be programmed again )?after G28, G30 or G53") as caught:
        read(f"{CUT}{park}\n{after}\nM30\n", cell)
    assert str(caught.value.text) in after
    program = read(f"{CUT}{park}\nG0 X0 Y0\nZ-1\n{after}\nM30\n", cell)
    assert not program.motions.rapid[-1]


@pytest.mark.parametrize("retract", ["G91 G28 Z0\nG90", "G53 G0 Z0"])
def test_increments_from_the_height_of_a_retract_are_refused(retract):
    for after in ("G91 G0 Z-195\nG1 Z-5", "G91 G81 X5 Z-3 R-18 F100", "G91 G1 X5 Z-200"):
        with pytest.raises(ProgramError, match="Z must be programmed again") as caught:
            read(f"{CUT}{retract}\n{after}\nM30\n", INIT)
        assert str(caught.value.text) == after.partition("\n")[0]
        assert len(read(f"{CUT}{retract}\nG0 Z5\n{after}\nM30\n", INIT).motions) > 4
    program = read(f"{CUT}{retract}\nG91 G0 X5 Z0\nG90 G0 Z5\nG1 Z-2\nM30\n", INIT)
    np.testing.assert_allclose(ends(program)[-1], [15, 20, -2], atol=1e-9)


@pytest.mark.parametrize(
    ("block", "seconds"),
    [("G4 P2.5", 2.5), ("G4 X2.5", 2.5), ("G04 U.5", 0.5), ("G4 F3", 3.0), ("G4 S2", 2.0), ("G4 P1 S300", 1.0)],
)
def test_the_time_of_a_dwell_is_in_the_word_that_the_control_reads(block, seconds):
    """Fanuc: X, U or P; Sinumerik: F, the feed before stays; Marlin: S."""
    program = read(f"M3 S900\n{CUT}F250\n{block}\nX70\nM30\n")
    events = [(event.kind, event.value) for event in program.events if event.kind in ("dwell", "spindle_on")]
    assert ("dwell", seconds) in events
    assert ("spindle_on", 2.0) not in events
    assert program.motions.feed[-1] * 60e3 == pytest.approx(250.0)
    np.testing.assert_allclose(ends(program)[-1], [70, 20, -1], atol=1e-9)
    assert [issue.kind for issue in program.issues if issue.source_line == 6] == ["dwell"] * (block == "G4 S2")


@pytest.mark.parametrize(
    ("block", "problem"),
    [
        ("G4", "G4 without a time"),
        ("G4 X-1", "G4 without a time"),
        ("G0 G4 X5", "G4 X in one block with a motion code"),
        ("T1.1", "T1.1 is not a whole number"),
        ("M8.1", "M8.1 is not a whole number"),
        ("M29 S500", "M29 is not supported"),
        ("M13 S500", "M13 is not supported"),
        ("M3 P50 X5", "I, J, K, R or P without an arc"),
    ],
)
def test_what_cannot_be_meant_is_refused(block, problem):
    with pytest.raises(ProgramError) as caught:
        read(f"{CUT}{block}\nX70\nM30\n")
    assert caught.value.problem.startswith(problem)
    assert caught.value.advice or block == "M3 P50 X5"


def test_a_share_of_the_full_speed_is_read_unless_a_line_of_the_cell_needs_rpm():
    """Snapmaker: M3 P0 to P100, in percent."""
    text = f"{CUT}M3 P100\nX70\nM4 P50 S9000\nX80\nM30\n"
    program = read(text)
    kinds = [(event.kind, event.value) for event in program.events]
    assert kinds == [("spindle_on", 0.0), ("spindle_ccw", 9000.0), ("spindle_off", 0.0)]
    told = [issue.message for issue in program.issues if issue.kind == "spindle-speed" and issue.level == "warning"]
    assert told[0].startswith("P100 of M3 is ignored")
    lines = {"spindle_on": ["; on {S}"], "spindle_ccw": ["; off"]}
    with pytest.raises(ProgramError, match=r"M3 P100: the speed is a share") as caught:
        read(text, replace(CELL, gcode=replace(CELL.gcode, **lines)))
    assert caught.value.text == "M3 P100"


@pytest.mark.parametrize("text", ["tool (1); G0 X500", "", "%", "#1=2 G81"])
def test_a_message_of_eding_cnc_is_a_comment(text):
    program = read(f'msg "{text}"\n{CUT}N10 MSG "{text}" X60\nM30\n')
    np.testing.assert_allclose(ends(program)[-1], [60, 20, -1], atol=1e-9)
    assert [event.text for event in program.events if event.kind == "comment"] == [text] * 2
    with pytest.raises(ProgramError) as caught:
        read('G0 X1 Y1 Z1\nMSG "open\nG1 X2 F9\nM30\n')
    assert caught.value.line == 2


@pytest.mark.parametrize("code", ["G41.2", "G42.2"])
def test_radius_compensation_in_three_dimensions_has_no_effect_if_offsets_hold_wear(code):
    text = f"{CUT}{code} D4 X70\nM30\n"
    with pytest.raises(ProgramError, match=f"{code} is not supported") as caught:
        read(text)
    assert "radius_offsets" in str(caught.value.advice)
    program = read(text, replace(CELL, gcode=replace(CELL.gcode, radius_offsets="wear")))
    np.testing.assert_allclose(ends(program)[-1], [70, 20, -1], atol=1e-9)


@pytest.mark.parametrize("block", ["G53", "G53 G90 G91.1 G40", "G53 G0", "G53 G49 M5"])
def test_g53_without_axes_has_no_effect(block):
    """G53 is not modal: it holds for the block in which it is written (Fanuc, Haas, Mach3)."""
    program = read(f"{CUT}{block}\nG1 X70\nZ9\nM30\n")
    np.testing.assert_allclose(ends(program)[-3:], [[10, 20, -1], [70, 20, -1], [70, 20, 9]], atol=1e-9)
    assert [issue.level for issue in program.issues if issue.kind == "machine-position"] == ["info"]


def test_older_fanuc_controls_take_h_for_the_radius():
    cell = replace(CELL, gcode=replace(CELL.gcode, radius_offsets="wear"))
    np.testing.assert_allclose(ends(read(f"{CUT}G42 H19 X70\nM30\n", cell))[-1], [70, 20, -1], atol=1e-9)
    with pytest.raises(ProgramError, match="G42 is not supported"):
        read(f"{CUT}G42 H19 X70\nM30\n")


def test_decimal_commas_are_refused_with_what_to_write():
    with pytest.raises(ProgramError) as caught:
        read(CUT + "X1,5\nM30\n")
    assert (caught.value.line, caught.value.text) == (4, "X1,5")
    assert "X10.5" in str(caught.value.advice)


def test_line_numbers_of_a_program_with_cr_alone_are_those_of_its_lines():
    with pytest.raises(ProgramError) as caught:
        read(f"{CUT}(a)\nG77 ; b\nM30\n".replace("\n", "\r"))
    assert (caught.value.line, caught.value.text) == (5, "G77 ; b")


def test_commands_to_grbl_that_show_something_move_nothing():
    plain = read(CUT + "M30\n")
    program = read("$$\n$I ; build\n$G\n?\n ? (state)\n$X\n" + CUT + "M30\n")
    np.testing.assert_array_equal(ends(program), ends(plain))
    lines = [issue.source_line for issue in program.issues if issue.kind == "sender-command"]
    assert lines == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize("line", ["$110=500", "$J=X10 F100", "$C", "$HXX", "X?", "\N{PILCROW SIGN}", "\x01", "?1"])
def test_other_commands_to_grbl_are_refused(line):
    with pytest.raises(ProgramError) as caught:
        read(f"{CUT}{line}\nM30\n")
    assert caught.value.line == 4


def test_homing_by_grbl_needs_the_place_of_the_machine():
    with pytest.raises(ProgramError, match="machine"):
        read("$H\n" + CUT, replace(CELL, machine=Machine()))


def test_commands_of_a_sender_are_not_cutter_locations():
    with pytest.raises(ProgramError, match="APT cutter-location"):
        read("$$ PART 7\nGOTO/1,2,3\n")


@pytest.mark.parametrize(
    ("line", "what"), [("DEF REAL WIDTH=5", "a Siemens"), ("DEF INT N", "a Siemens"), ("DEF part( )", "a KUKA KRL")]
)
def test_def_of_siemens_is_not_that_of_krl(line, what):
    with pytest.raises(ProgramError, match=f"but {what}"):
        read(f"{line}\n{CUT}")


def test_a_second_post_with_comments_in_square_brackets_is_told_where_comments_go():
    with pytest.raises(ProgramError) as caught:
        read("[MACHINES WITH WINCNC CONTROL ONLY]\n" + CUT)
    assert "( )" in str(caught.value.advice)


@pytest.mark.parametrize(
    ("block", "feed", "lines"),
    [
        ("G20 F6", 152.4, [1]),
        ("F6 G20", 152.4, [1]),
        ("G21 F6", 6.0, []),
        ("G20\nF6", 152.4, []),
        ("G20\nG21 F6", 6.0, [2]),
    ],
)
def test_a_feed_in_the_block_that_changes_units_is_in_the_new_ones_and_is_reported(block, feed, lines):
    """rs274 takes it in the units before: the control of a shop may have inches from the start."""
    program = read(f"{block}\nG0 X0 Y0 Z1\nG1 X2\nM2\n")
    assert program.motions.feed[1] * 60e3 == pytest.approx(feed)
    found = [(issue.level, issue.source_line) for issue in program.issues if issue.kind == "feed-units"]
    assert found == [("warning", line) for line in lines]


def test_g9_stops_exactly_at_the_end_of_its_block():
    blend = read("G21 G90\nG0 X0 Y0 Z5 F600\nG1 X1\nG9 X2\nX3\nM2").motions.blend
    np.testing.assert_allclose(blend[1:] * 1e3, [0.5, 0.0, 0.5])
    blend = read("G21 G90 G61\nG0 X0 Y0 Z5 F600\nG9 G1 X2\nX3\nM2").motions.blend
    np.testing.assert_allclose(blend, 0.0)


def test_a_percent_sign_behind_the_last_block_ends_the_program():
    program = read("%\nG21 G90\nG0 X0 Y0 Z5 F600\nG1 X1\nX6 F700.0%\n")
    assert ends(program)[-1, 0] == pytest.approx(6.0)
    with pytest.raises(ProgramError, match="the program ends here, but coordinates follow"):
        read("%\nG21 G90\nG0 X0 Y0 Z5 F600\nG1 X6 F700.0%\nX9\n")


ABSOLUTE = "G21 G90\nG0 X10 Y10 Z5\nG1 Z0 F100\nG2 X30 Y10 I20 J10\nG2 X20 Y0 I20 J10\nG3 X40 Y0 I30 J0\nM2\n"


def test_centres_are_coordinates_where_only_so_all_radii_agree():
    program = read(ABSOLUTE)
    stated = read(ABSOLUTE.replace("G90\n", "G90 G90.1\n"))
    np.testing.assert_array_equal(program.motions.centre, stated.motions.centre)
    np.testing.assert_array_equal(program.motions.sweep, stated.motions.sweep)
    assert [issue.level for issue in program.issues if issue.kind == "absolute-centres"] == ["info"]
    assert "absolute-centres" not in {issue.kind for issue in stated.issues}


@pytest.mark.parametrize(
    "text",
    [
        ABSOLUTE.replace("I30 J0", "I10 J0"),  # one arc is right only by increments
        ABSOLUTE.replace("G90\n", "G90 G91.1\n"),  # the program says that they are increments
        ABSOLUTE.replace("I20 J10\nG2", "I21 J10\nG2"),  # right in neither way
    ],
)
def test_centres_that_do_not_all_agree_are_refused_as_increments(text):
    with pytest.raises(ProgramError) as caught:
        read(text)
    assert caught.value.problem.startswith("radii of the arc disagree")


def test_text_before_the_first_percent_sign_is_not_read():
    code = "%\nO1\nG21 G90\nG0 X0 Y0 Z5\nG1 Z0 F100\nX9\nM30\n%\n"
    program = read(f"Part seven, made by\nthe shop\n{code}")
    assert program.motions.line.tolist() == [line + 2 for line in read(code).motions.line.tolist()]
    assert [issue.source_line for issue in program.issues if issue.kind == "leader"] == [1]
    assert program.documents[0].text.startswith("Part seven")
    with pytest.raises(ProgramError, match="the program ends here"):
        read(f"G0 X0 Y0 Z9\n{code}")


def test_l0_without_a_cycle_has_no_effect():
    assert len(read("G21 G90 L0\nG0 X0 Y0 Z5 L0\nG1 Z0 F100\nM2\n").motions) == 2
    with pytest.raises(ProgramError, match="Q or L without a cycle"):
        read("G0 X0 Y0 Z5 L2\nG1 Z0 F100\nM2\n")
