"""Habits of posts for Fanuc-style controls that LinuxCNC's interpreter does not share."""

import numpy as np
import pytest
from click.testing import CliRunner
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.cli import main
from postproc.errors import ProgramError
from postproc.program import LIN
from tests.dialects.gcode_reading import CELL, ends, read
from tests.documentation.pages import ROOT

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


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("G0 X10 Y10\nG1 Z-5 F9\n", "cutting move before the position is known"),
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
    cell = ROOT / "samples" / "cell_kr270.toml"
    (tmp_path / "cell.toml").write_text(cell.read_text() + "\n[machine]\nclearance_Z = 100\n")

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
        return CliRunner().invoke(main, arguments)

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
    done = CliRunner().invoke(main, ["predict", str(tmp_path / name), "--cell", str(ROOT / "samples/cell_kr270.toml")])
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


def test_commands_of_a_sender_are_not_cutter_locations():
    with pytest.raises(ProgramError) as caught:
        read("$H\n$$\n" + CUT)
    assert caught.value.problem == "unexpected character '$'"
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
