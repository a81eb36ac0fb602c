"""`start` and `init PROGRAM`: what a program needs, what is asked, what is kept."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from postproc import cell as cells
from postproc.errors import InputError
from postproc.jobs import answers, guided_start
from postproc.jobs.program_needs import needs_of
from postproc.machining import process as processes
from tests.commands import CELL_IN_NUMBERS, invoke
from tests.places import ROOT

PART = """%
(T1 D=16. CR=0. - ZMIN=-5. - flat end mill)
G21 G90 G17
G28 G91 Z0
G90
T1 M6
S8000 M3
G0 X-30 Y20
G43 H1 Z20
G0 Z-2
G1 X80 F900
G0 Z20
M5
M30
"""
MANY = """%
(T1 D=16. CR=0. - flat end mill)
(T3 D=6. CR=3. - ball end mill)
G21 G90 G17
G28 G91 Z0
G90
M31
T1 M6
S8000 M3
G55
G0 X0 Y0
G43 H1 Z20
G1 Z-2 F500
G1 X50
G4 P500
G0 Z20
T3 M6
S12000 M3
G0 X10 Y10
G0 Z5
G1 Z-3 F300
G1 X40
G0 Z20
M5
M30
"""
ALL = (*CELL_IN_NUMBERS, "--material", "al_6082_t6_carbide", "--flutes", "3")


@pytest.fixture(autouse=True)
def input_files(work_folder):
    Path("part.nc").write_text(PART)
    Path("many.nc").write_text(MANY)


KRL = """DEF part()
BAS(#INITMOV,0)
{frame}
$TOOL={{X 0,Y 0,Z 350,A 0,B 0,C 0}}
PTP {{A1 0,A2 -90,A3 100,A4 0,A5 80,A6 0}}
LIN {{X -70,Y 200,Z 50,A 0,B 0,C 180}}
LIN {{X 0,Y 0,Z -1,A 0,B 0,C 180}}
;FORCE FX=100 FY=-40
LIN {{X 80,Y 5,Z -2,A 0,B 0,C 180}}
; FORCE OFF
LIN {{X 80,Y 5,Z 90,A 0,B 0,C 180}}
END
"""
RAPID = """MODULE part
PROC main()
! FORCE FX=-200 FZ=100
MoveL pA,v20,fine,tMill;
ENDPROC
ENDMODULE
"""


@pytest.mark.parametrize(
    ("moves", "low", "high"),
    [
        (["G0 X50 Y0 Z10", "G1 Z-2", "G3 X50 Y0 I-50 J0"], (-50, -50, -2), (50, 50, -2)),
        (["G0 X0 Y0 Z10", "G1 Z-2", "G2 X40 Y0 R20", "G1 X60"], (0, 0, -2), (60, 20, -2)),
        (["G0 X0 Y5 Z10", "G1 Z-2", "G18", "G3 X40 Z-2 I20 K0", "G17"], (0, 5, -2), (40, 5, 18)),
        (["G0 X0 Y5 Z10", "G1 Z-2", "G18", "G2 X40 Z-2 I20 K0", "G17"], (0, 5, -22), (40, 5, -2)),
        (["G0 X0 Y0 Z10", "G1 Z-2 X10", "G0 Z10", "G0 X-500", "G0 X0"], (0, 0, -2), (10, 0, -2)),
    ],
)
def test_the_cuts_of_a_program_include_what_arcs_reach_between_their_ends(moves, low, high):
    Path("arc.nc").write_text("\n".join(["G21 G90 G17 G94", "S9000 M3", "F1000", *moves, "M30", ""]))
    np.testing.assert_allclose(needs_of(Path("arc.nc")).span, (low, high), atol=0.02)


@pytest.mark.parametrize(
    ("name", "text", "span"),
    [
        ("a.src", KRL.format(frame="$BASE={X 1500,Y 0,Z 700,A 0,B 0,C 0}"), ((0.0, 0.0, -2.0), (80.0, 5.0, -2.0))),
        ("b.src", KRL.format(frame="$BASE=BASE_DATA[3]"), ((0.0, 0.0, -2.0), (80.0, 5.0, -2.0))),
        ("d.src", KRL.format(frame="$BASE=TABLE"), None),
        ("c.mod", RAPID, None),
    ],
)
def test_forces_in_comments_of_robot_programs_count_also_where_frames_are_not_known_yet(name, text, span):
    Path(name).write_text(text)
    needs = needs_of(Path(name))
    assert needs.has_forces
    assert needs.span == span
    Path(name).write_text("".join(line for line in text.splitlines(keepends=True) if "FORCE" not in line))
    assert not needs_of(Path(name)).has_forces


def test_a_program_shows_what_it_needs():
    needs = needs_of(Path("many.nc"))
    assert (needs.tools, needs.work_offsets, needs.m_codes) == ((1, 3), ("G55",), ("M31",))
    assert needs.switches == {"spindle"}
    assert needs.settings == ("dwell_unit",)
    assert needs.cutters[3].shape == "ball"
    assert needs.has_speeds
    assert not needs.has_forces
    assert not needs.refusal


@pytest.mark.parametrize(
    ("blocks", "setting"),
    [
        ("G0 X0 Y0 Z20\nG1 Z-1 F500\nG1 X30", None),
        ("G0 X0 Y0 Z20\nG41 D1 X1 Y1\nG1 Z-1 F500\nX30\nG40 X40", "radius_offsets"),
        ("G0 X5 Z5\nG53 G0 X0 Y0\nG1 Z-1 F500\nX30", "home"),
        ("G0 X0 Y0 Z20\nG1 Z-1 F500\nG4 P800\nX30", "dwell_unit"),
        ("G4 P1\nG0 X5 Z5\nG53 G0 X0 Y0\nG1 Z-1 F500\nX30", "home"),  # P1 is no time in milliseconds
        ("G0 X0 Y0 Z20\nG82 X1 Z-1 R1 P500. F500\nX3\nG80", "dwell_unit"),
    ],
)
def test_a_setting_is_needed_where_the_program_cannot_be_read_without_it(blocks, setting):
    Path("a.nc").write_text(f"G21 G90 G17\nM3 S9000\n{blocks}\nM30\n")
    needs = needs_of(Path("a.nc"))
    assert needs.settings == (() if setting is None else (setting,))


FOURTH_AXIS = """G21 G90 G17 G94
T1 M6
G0 G54 X-12. Y0. A0. S4500 M3
Z3.
G1 Z-2. F200.
X50. F400.
G0 Z25.
G91 G28 Z0.
G28 X0. Y0. A0.
M30
"""


def test_an_axis_that_is_only_ever_zero_is_no_rotary_axis():
    Path("a.nc").write_text(FOURTH_AXIS)
    needs = needs_of(Path("a.nc"))
    assert (needs.rotary, needs.refusal) == ((), "")
    made = invoke("init", "a.nc", *CELL_IN_NUMBERS)
    assert made.exit_code == 0, made.output
    assert "it converts" in made.output
    Path("a.nc").write_text(FOURTH_AXIS.replace("X50.", "X50. A-.5"))
    assert needs_of(Path("a.nc")).rotary == ("A",)


def test_a_tilted_tool_that_retracts_by_g53_needs_no_home_place():
    """Such a place lets no tilted tool retract; the clearance of the cell does."""
    Path("a.nc").write_text(
        "G21 G90 G94 G17\nS9000 M3\nG0 A-30. C90.\nG43.4 H1\nG0 X0. Y0. Z60.\nG1 Z0. F800.\nX10. A-25. C80.\n"
        "G0 Z60.\nG49\nG53 G0 Z0.\nM30\n"
    )
    needs = needs_of(Path("a.nc"))
    assert (needs.refusal, needs.settings, needs.rotary) == ("", (), ("A", "C"))


def test_a_program_that_no_answer_makes_readable_says_so_and_nothing_is_asked():
    Path("a.nc").write_text("G21 G90\nG0 X0 Y0 Z5\nG65 P9010 A1\nM30\n")
    done = invoke("start", "a.nc", *ALL)
    assert done.exit_code == 1
    assert "a.nc:3" in done.output
    assert "nothing was asked" in done.output
    assert not Path("corrected").exists()


def test_a_box_around_the_sweep_leaves_out_where_rapid_moves_come_down():
    needs = needs_of(Path("part.nc"))
    box = needs.stock_box({1: 16.0})
    assert box.X[0] == -30.0 + 8.0 + 5.0  # the tool comes down at X -30, radius 8, 5 mm beside the stock
    assert box.X[1] == 80.0 + 8.0 + 5.0


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (
            "holes.nc",
            "G21 G90 G94\nT1 M6\nS9000 M3\nG0 X10 Y10 Z20\nG85 X10 Y10 Z-9 R2 F300\nG89 X30 Z-9 R2 P1\nG80\nM30\n",
        ),
        (
            "holes.src",
            "DEF holes()\n$BASE={X 1500,Y 0,Z 700,A 0,B 0,C 0}\n$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}\n$VEL.CP=0.3\n"
            "PTP {A1 0,A2 -90,A3 100,A4 0,A5 80,A6 0}\nPTP {X 10,Y 10,Z 60,A 180,B 0,C 180}\n"
            "LIN {X 10,Y 10,Z -9,A 180,B 0,C 180}\nLIN {X 10,Y 10,Z 60,A 180,B 0,C 180}\n"
            "LIN {X 30,Y 10,Z 60,A 180,B 0,C 180}\nLIN {X 30,Y 10,Z -9,A 180,B 0,C 180}\n"
            "LIN {X 30,Y 10,Z 250,A 180,B 0,C 180}\nEND\n",
        ),
    ],
)
def test_the_box_around_the_sweep_ends_below_retracts_at_feed(name, text):
    """Two holes at X 10 and 30 with a drill of 8 mm: 4 + 5 mm on each side, 5 mm below, up to Z 0."""
    Path(name).write_text(text)
    box = needs_of(Path(name)).stock_box({1: 8.0})
    assert (box.X, box.Y, box.Z) == ((1.0, 39.0), (1.0, 19.0), (-14.0, 0.0))


def test_a_tilted_tool_cuts_on_its_way_up():
    Path("wall.nc").write_text(
        "G21 G90 G94 G17\nS9000 M3\nG0 A-80. C90.\nG43.4 H1\nG0 X0. Y0. Z60.\nG1 Z0. F800.\nG1 Z40.\nX10.\nG0 Z60.\n"
        "G49\nM30\n"
    )
    assert needs_of(Path("wall.nc")).span == ((0.0, 0.0, 0.0), (10.0, 0.0, 40.0))


def test_without_a_terminal_all_that_is_missing_is_listed_with_its_option():
    done = invoke("start", "part.nc")
    assert done.exit_code == 2
    for option in ("--robot", "--base", "--tool X,Y,Z", "--material", "--flutes 1=3"):
        assert f"\n  {option}" in done.output
    assert "--cutter" not in done.output  # the comment states it


def test_options_alone_make_cell_process_and_a_corrected_program():
    done = invoke("start", "part.nc", *ALL, "-o", "out")
    assert done.exit_code == 0, done.output
    assert "the stock is assumed" in done.output
    assert Path("out/part.src").is_file()
    cell = cells.load("out/cell.toml")
    assert (cell.base.X, cell.base.Y, cell.tool.Z, cell.gcode.spindle_on) == (1500.0, -200.0, 350.0, [])
    process = processes.load("out/part.process.toml")
    assert process.tools["1"].diameter_mm == 16.0
    assert process.tools["1"].flutes == 3
    assert json.loads(Path("out/part.report.json").read_text())["before"]["max_mm"] > 0.0


def test_forces_in_comments_need_no_process():
    done = invoke("start", str(ROOT / "samples" / "pocket.nc"), *CELL_IN_NUMBERS, "-o", "out")
    assert done.exit_code == 0, done.output
    assert not list(Path("out").glob("*.process.toml"))


def test_on_a_terminal_only_what_is_missing_is_asked(monkeypatch):
    monkeypatch.setattr("postproc.cli.start.is_terminal", lambda: True)
    answers = ["", "1500,-200", "1500,-200,700", "", "", "hand", "", "al_6082_t6_carbide", "", "three", "3", ""]
    done = invoke("start", "part.nc", "-o", "out", "--no-open", input="\n".join(answers) + "\n")
    assert done.exit_code == 0, done.output
    assert "2 numbers" in done.output  # an answer is checked at once, and asked for again
    assert "'three': give the number of cutting edges" in done.output
    assert "Coolant" not in done.output
    assert "Tool change" not in done.output
    assert cells.load("out/cell.toml").base.Z == 700.0


def test_answers_are_kept_when_the_user_interrupts_and_used_when_he_goes_on(monkeypatch):
    monkeypatch.setattr("postproc.cli.start.is_terminal", lambda: True)
    done = invoke("start", "part.nc", "-o", "out", input="kuka_kr270\n1400,-100,600\n")
    assert done.exit_code != 0
    kept = tomllib.loads(Path("out/part.answers.toml").read_text())["answers"]
    assert kept == {"robot": "kuka_kr270", "base": "1400,-100,600"}
    rest = ["0,0,350", "", "hand", "", "al_6082_t6_carbide", "", "3", ""]
    done = invoke("start", "part.nc", "-o", "out", "--no-open", input="\n".join(rest) + "\n")
    assert done.exit_code == 0, done.output
    assert "Robot, or" not in done.output
    assert cells.load("out/cell.toml").base.X == 1400.0


def test_answers_about_the_text_are_asked_again_when_the_program_has_changed():
    invoke("start", "part.nc", *ALL, "--cutter", "1=flat,16", "-o", "out")
    Path("part.nc").write_text(PART.replace("D=16.", "D=10."))
    done = invoke("start", "part.nc", "--flutes", "3", "-o", "out")
    assert done.exit_code == 0, done.output
    assert processes.load("out/part.process.toml").tools["1"].diameter_mm == 10.0


def test_a_cell_that_was_edited_is_used_as_it_is():
    invoke("start", "part.nc", *ALL, "-o", "out")
    path = Path("out/cell.toml")
    path.write_text(path.read_text().replace("Z = 350.0", "Z = 300.0"))
    done = invoke("start", "part.nc", "-o", "out")
    assert done.exit_code == 0, done.output
    assert "is used as it is" in done.output
    assert cells.load(path).tool.Z == 300.0
    assert invoke("start", "part.nc", *ALL, "-o", "out").exit_code == 0  # the answers that the file was made of
    before = path.read_bytes()
    done = invoke("start", "part.nc", "--base", "1400,-200,700", "-o", "out")
    assert done.exit_code == 2
    assert "base: the cell file is used as it is, and these answers would not count" in done.output
    assert path.read_bytes() == before


def test_a_cell_that_cannot_be_is_not_written_and_the_next_answer_counts():
    wrong = [word.replace("1500", "1e9") for word in ALL]
    assert invoke("start", "part.nc", *wrong, "-o", "out").exit_code == 1
    assert not Path("out/cell.toml").exists()
    assert invoke("start", "part.nc", *ALL, "-o", "out").exit_code == 0


def test_where_the_tolerance_is_not_held_a_better_place_is_offered(monkeypatch):
    done = invoke("start", "part.nc", *ALL, "--part-tolerance", "0.001", "-o", "out")
    assert done.exit_code == 3
    assert "another place of the part may help.\n  postproc place part.nc --cell" in done.output
    monkeypatch.setattr("postproc.cli.start.is_terminal", lambda: True)
    done = invoke("start", "part.nc", "-o", "out", "--no-open", input="\n" * 20 + "y\n")
    assert "Look for one now?" in done.output


def test_an_option_that_is_no_answer_is_wrong_usage():
    done = invoke("start", "part.nc", *CELL_IN_NUMBERS, "--material", "cheese", "--flutes", "3")
    assert done.exit_code == 2
    assert "--material" in done.output
    assert "al_6082_t6_carbide" in done.output


def test_init_with_a_program_lists_what_it_needs_and_says_that_it_converts():
    done = invoke("init", "many.nc")
    assert done.exit_code == 2
    for option in ("--tools 1=", "--tools 3=", "--work-offset G55=", "--m-code M31", "--dwell-unit"):
        assert option in done.output
    options = ("--robot", "kuka_kr270", "--base", "1500,-200,700", "--tools", "1=350", "--tools", "3=340")
    done = invoke(
        "init", "many.nc", *options, "--work-offset", "G55=10,0,0", "--m-code", "M31", "--dwell-unit", "ms"
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "many.nc: it converts." in done.output
    cell = cells.load("cell.toml")
    assert (cell.tools["3"].Z, cell.work_offsets["G55"].X, cell.m_codes) == (340.0, 10.0, {"M31": []})


def test_init_with_a_program_says_what_still_stops_it():
    done = invoke("init", "part.nc", "--robot", "kuka_kr270", "--base", "4000,0,700", "--tool", "0,0,350")
    assert done.exit_code == 1
    assert "part.nc: it does not convert yet" in done.output
    assert Path("cell.toml").is_file()


def test_init_writes_indexed_axes_with_their_points():
    Path("a.nc").write_text(
        "G21 G90\nM3 S9000\nG0 X0 Y0 Z50\nG0 A30\nG1 Z20 F500\nG1 X50\nG0 Z50\nG81 X5 Z25 R40 F200\nG80\nM30\n"
    )
    done = invoke("init", "a.nc", *CELL_IN_NUMBERS, "--rotary-kind", "indexed", "--rotary-point", "A=0,0,-120")
    assert done.exit_code == 0, done.output
    assert "no answer makes" not in done.output  # cycles are read with indexed axes only
    rotary = cells.load("cell.toml").rotary
    assert (rotary.kind, rotary.axes, rotary.A.point, rotary.A.direction) == (
        "indexed", ["A"], (0.0, 0.0, -120.0), (1.0, 0.0, 0.0),
    )  # fmt: skip


def test_a_program_of_the_robot_is_not_asked_where_it_retracts():
    Path("part.src").write_text("DEF PART( )\nLIN {X 0,Y 0,Z 0,A 0,B 0,C 180}\nEND\n")

    def asked_keys(*names):
        answers, keys = guided_start.Answers({"robot": "kuka_kr270"}), []
        needs = guided_start.merge_needs([needs_of(Path(name)) for name in names])
        while question := guided_start.next_question(needs, answers, keys, process=False):
            keys.append(question.key)
        return keys

    assert "clearance" not in asked_keys("part.src")
    assert "clearance" in asked_keys("part.nc")
    assert "clearance" in asked_keys("part.src", "part.nc")


def test_the_only_tool_of_a_program_may_be_given_by_its_number():
    frame = ("--robot", "kuka_kr270", "--base", "1500,-200,700")
    started = invoke("start", "part.nc", *ALL[:4], "--tools", "1=0,0,360", *ALL[6:], "-o", "out")
    assert started.exit_code == 0, started.output
    assert "not used" not in started.output
    assert cells.load("out/cell.toml").tool.Z == 360.0
    made = invoke("init", "part.nc", *frame, "--tools", "1=360")
    assert made.exit_code == 0, made.output
    assert cells.load("cell.toml").tool.Z == 360.0


@pytest.mark.parametrize("words", ["1500,-200", "1500,-200,700,0", "1500,-200,700,0,0", "1,2,3,4,5,6,7"])
def test_frames_of_another_length_than_three_or_six_numbers_are_refused(words):
    """A work offset may also be turned about Z alone, by a fourth number."""
    with pytest.raises(InputError):
        answers.full_frame(words)
    with pytest.raises(InputError):
        answers.tools([f"1={words}"])
    if words.count(",") != 3:
        with pytest.raises(InputError):
            answers.work_offsets([f"G55={words}"])
    whole = "1500,-200,700,0,90,0"
    values = answers.full_frame(whole)
    assert values == answers.tools([f"1={whole}"])[1] == answers.work_offsets([f"G55={whole}"])["G55"]


NUMBERED = """DEF part()
; BASE_DATA[9] is not used
$BASE=BASE_DATA[{base}]
FDAT_ACT=FP1
BAS(#FRAMES)
$TOOL=TOOL_DATA[2]
BAS(#VEL_PTP,20)
PTP {{A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}}
$VEL.CP=0.02
; FORCE FX=100
LIN {{X 0,Y 0,Z 10,A 90,B 0,C 180}}
LIN {{X 60,Y 0,Z 10,A 90,B 0,C 180}}
END
"""
TOOL_DAT = "DEFDAT part\nDECL FDAT FP1={{TOOL_NO {tool},BASE_NO 3,IPO_FRAME #BASE}}\n{more}ENDDAT\n"


def write_numbered(*, base=3, tool=2, more=""):
    Path("part.src").write_text(NUMBERED.format(base=base))
    Path("part.dat").write_text(TOOL_DAT.format(tool=tool, more=more))


@pytest.mark.parametrize(
    ("content", "frames"),
    [
        ({}, ("base_data.3", "tool_data.2")),
        ({"base": 4}, ("base_data.3", "tool_data.2")),  # another frame is in force before the first motion
        ({"more": "TOOL_DATA[2]={X 0,Y 0,Z 350,A 0,B 0,C 0}\n"}, ("base_data.3",)),
        ({"more": "DECL FDAT FP2={TOOL_NO 7,BASE_NO 8,IPO_FRAME #BASE}\n"}, ("base_data.3", "tool_data.2")),
        ({"base": 0}, ("base_data.3", "tool_data.2")),
    ],
)
def test_frames_of_the_controller_are_needed_where_a_program_cannot_be_read_without_them(content, frames):
    write_numbered(**content)
    assert needs_of(Path("part.src")).frames == frames


def test_start_asks_for_the_frames_by_number_instead_of_base_and_tool():
    write_numbered()
    asked = invoke("start", "part.src", "--robot", "kuka_kr270")
    assert asked.exit_code == 2
    assert "frames by number: BASE_DATA[3], TOOL_DATA[2]" in asked.output
    assert "--base-data 3=X,Y,Z    BASE_DATA[3], which the program uses, in the robot root" in asked.output
    assert "--base X" not in asked.output
    assert "--tool X" not in asked.output
    frames = ("--base-data", "3=1500,100,700,10,0,0", "--tool-data", "2=0,0,350")
    started = invoke("start", "part.src", "--robot", "kuka_kr270", *frames, "-o", "out")
    assert started.exit_code == 0, started.output
    cell = cells.load("out/cell.toml")
    assert (cell.base_data["3"].Y, cell.base_data["3"].A, cell.tool_data["2"].Z) == (100.0, 10.0, 350.0)
    assert (cell.base.Y, cell.tool.Z) == (100.0, 350.0), "what [start] and the part are seen from"
    written = invoke("start", "part.src", "--robot", "kuka_kr270", *frames, "-o", "out")
    assert written.exit_code == 0, "the same answers again"


def test_init_takes_frames_by_number_and_asks_for_the_base_of_other_programs():
    write_numbered()
    frames = ("--base-data", "3=1500,100,700", "--tool-data", "2=0,0,350")
    made = invoke("init", "part.src", "--robot", "kuka_kr270", *frames)
    assert made.exit_code == 0, made.output
    assert cells.load("cell.toml").base_data["3"].X == 1500.0
    both = invoke("init", "both.toml", "part.src", "part.nc", "--robot", "kuka_kr270", *frames)
    assert both.exit_code == 2
    assert "--base X,Y,Z" in both.output
    Path("$config.dat").write_text(
        "DEFDAT $CONFIG\nBASE_DATA[3]={X 1400,Y 0,Z 600,A 0,B 0,C 0}\n"
        "TOOL_DATA[2]={X 0,Y 0,Z 300,A 0,B 0,C 0}\nENDDAT\n"
    )
    own = ("--config-dat", "$config.dat", "--base", "3", "--tool", "2")
    stated = invoke("init", "own.toml", "part.src", "--robot", "kuka_kr270", *own)
    assert stated.exit_code == 0, stated.output
    cell = cells.load("own.toml")
    assert (cell.base.X, cell.tool.Z, cell.base_data) == (1400.0, 300.0, {})


@pytest.mark.parametrize("text", ["3", "3=1500,0", "x=1500,0,700", "0=1,2,3", "3=7", "3=1,2,3,4"])
def test_a_frame_by_number_is_given_whole(text):
    with pytest.raises(InputError):
        answers.numbered_frames([text])


def test_an_unknown_robot_is_answered_with_the_nearest_names_in_one_sentence_each():
    done = invoke("start", "part.nc", "--robot", "kuka_kr720")
    assert done.exit_code == 2
    assert "no robot 'kuka_kr720'. Did you mean " in " ".join(done.stderr.split())
    assert done.stderr.rstrip().endswith("kuka_kr6_r900_2.")
    assert ".." not in done.stderr
