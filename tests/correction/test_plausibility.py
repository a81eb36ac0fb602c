"""Lengths in metres and loads that the arm cannot carry are asked about, with the key; usual values are not."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from postproc import cell as cells
from postproc import correction
from postproc.correction import plausibility
from postproc.dialects.text import decode
from postproc.frames import norm
from postproc.report import summary
from postproc.robot.rating import rated_payload
from postproc.under_load import MotionsUnderLoad, RobotInCell
from tests.commands import run
from tests.kr270 import CELL, CELL_TEXT, ROBOT
from tests.places import ROOT

GCODE = b"G21 G90\nG0 X0 Y0 Z5\nG1 Z0 F300\nX10\nM30\n"
KRL = b"DEF P()\n$BASE={%s}\n$TOOL={X 0,Y 0,Z %s,A 0,B 0,C 0}\nPTP {A1 0,A2 -90,A3 100,A4 0,A5 80,A6 0}\n" \
      b"LIN {X 0,Y 0,Z 150,A 180,B 0,C 180}\nEND\n"  # fmt: skip


def questions(cell=CELL, text=GCODE, dialect="gcode"):
    """Kind, key and line of what is asked about."""
    program = correction.read([decode("p", text)], ROBOT, cell, "p", dialect)
    return [
        (issue.kind, issue.message, issue.source_line) for issue in plausibility.setup_questions(program, cell, ROBOT)
    ]


def test_usual_values_raise_no_question():
    for file in sorted((ROOT / "samples").glob("*cell*.toml")):
        cell = cells.load(file)
        if cell.robot == CELL.robot:
            assert questions(cell) == [], file.name


@pytest.mark.parametrize("lengths", [{"Z": 0.35}, {"X": 0.12, "Z": 0.35}, {"Z": 4.9}, {"Z": 0.0}])
def test_a_tool_in_metres_is_asked_about_with_its_key(lengths):
    tool = replace(CELL.tool, X=0.0, Y=0.0, Z=0.0)
    ((kind, message, line),) = questions(replace(CELL, tool=replace(tool, **lengths)))
    assert (kind, line) == ("short-tool", 3)
    assert "is Z in mm? [tool] or [tools.n] of the cell is in mm" in message
    assert questions(replace(CELL, tool=replace(tool, Z=5.1))) == []


def test_a_base_in_metres_is_asked_about_and_none_at_the_root_is_not():
    ((kind, message, _),) = questions(replace(CELL, base=replace(CELL.base, X=1.5, Y=-0.2, Z=0.7)))
    assert kind == "near-base"
    assert "X 1.5, Y -0.2, Z 0.7" in message
    assert "are X, Y, Z in mm? [base] of the cell" in message
    assert questions(replace(CELL, base=replace(CELL.base, X=0.0, Y=0.0, Z=0.0))) == []


def test_frames_of_a_robot_program_are_its_own():
    base = b"X 1500,Y -200,Z 700,A 0,B 0,C 0"
    assert questions(text=KRL % (base, b"350"), dialect="krl") == []
    ((kind, message, line),) = questions(text=KRL % (base, b"0.35"), dialect="krl")
    assert (kind, line) == ("short-tool", 5)
    assert "$TOOL of the program" in message


@pytest.mark.parametrize(("mass_kg", "is_asked"), [(270.0, False), (271.0, True)])
def test_a_payload_beyond_the_rating_is_asked_about_with_both_numbers(mass_kg, is_asked):
    messages = [message for _, message, _ in questions(replace(CELL, payload=cells.Payload(mass_kg=mass_kg)))]
    assert len(messages) == is_asked
    assert all("mass_kg = 271 is more than the 270 kg of KUKA KR 270-2" in message for message in messages)


@pytest.mark.parametrize(
    ("name", "kg"),
    [("KUKA KR 6 R900-2", 6), ("kr120_r2700_2", 120), ("KR 210-2 L150", 150), ("ABB IRB 6700-200/2.60", 200),
     ("abb_irb6700_200_260", 200), ("ABB IRB 120", None), ("arm", None)],
)  # fmt: skip
def test_the_rating_is_in_the_name(name, kg):
    assert rated_payload(name) == kg


def test_the_verdict_on_a_tool_in_metres_is_amber(tmp_path):
    (tmp_path / "p.nc").write_bytes(GCODE)
    (tmp_path / "cell.toml").write_text(CELL_TEXT.replace("Z = 350.0", "Z = 0.35"))
    done = run("convert", tmp_path / "p.nc", "--cell", tmp_path / "cell.toml", "-o", tmp_path / "out")
    assert "Look before you run it" in done.output
    assert "is Z in mm?" in done.output


FORCED = b"G21 G90\nM3 S1000\nG0 X0 Y0 Z5\n(FORCE %s)\nG1 Z0 F300\nX10\n(FORCE OFF)\nG0 Z20\nM30\n"


def cutting_questions(text, cell=CELL, dialect="gcode"):
    """Kind, line and message of what is asked about moves with forces."""
    program = correction.read([decode("p", text)], ROBOT, cell, "p", dialect)
    motions = MotionsUnderLoad.of(program, RobotInCell.of(ROBOT, cell), None)
    issues = plausibility.force_questions(program, motions.forces, cell, ROBOT)
    return [(issue.kind, issue.source_line, issue.message) for issue in issues]


CUT = "G21 G90\n{before}\nG0 X0 Y0 Z5\nG1 Z2 F{feed}\n(FORCE FX=100)\n{at}\nG1 Z0\nX10\n(FORCE OFF)\n{after}\nG0 Z20\n"


@pytest.mark.parametrize(
    ("switches", "line", "cause"),
    [
        (("", "", ""), 7, "nothing switches it on before"),
        (("", "", "M3 S100"), 7, "nothing switches it on before"),
        (("M3 S100", "M5", ""), 7, "line 6 switches it off"),
        (("M5", "", ""), 7, "line 2 switches it off"),
        (("M3 S100", "", "M5"), None, ""),
        (("M4 S100", "", "M5"), None, ""),
        (("M5", "M3 S100", ""), None, ""),
    ],
)
def test_a_cut_with_the_spindle_off_is_asked_about(switches, line, cause):
    before, at, after = switches
    text = CUT.format(before=before, at=at, after=after, feed=300).encode()
    issues = cutting_questions(text)
    assert [(kind, at_line) for kind, at_line, _ in issues] == ([("spindle-off", line)] if line else [])
    assert all(cause in message for _, _, message in issues)
    by_hand = replace(CELL, gcode=replace(CELL.gcode, spindle_on=[], spindle_ccw=None))
    assert cutting_questions(text, by_hand) == []
    assert cutting_questions(text.replace(b"FX=100", b"FX=0")) == []


@pytest.mark.parametrize(
    ("on", "off", "lines", "is_asked"),
    [
        ("$OUT[1]=TRUE", "$OUT[1]=FALSE", ["$OUT[ 1 ] = true"], False),
        ("$OUT[1]=TRUE", "$OUT[1]=FALSE", ["$OUT[1]=FALSE", "WAIT SEC 1", "$OUT[1]=TRUE"], False),
        ("$OUT[1]=TRUE", "$OUT[1]=FALSE", ["$OUT[2]=TRUE"], True),
        ("$OUT[1]=TRUE", "$OUT[1]=FALSE", ["$OUT[1]=FALSE"], True),
        ("$OUT[1]=TRUE", "$OUT[1]=FALSE", ["IF $OUT[1]==TRUE THEN", "ENDIF"], True),
        ("$ANOUT[1]={S}/24000.0", "$ANOUT[1]=0.0", ["$ANOUT[1]=0.5"], False),
        ("SetDO doSpindle,1;", "SetDO doSpindle,0;", ["SetDO doSpindle, 1;"], False),
        ("SetDO doSpindle,1;", "SetDO doSpindle,0;", ["SetDO doCoolant,1;"], True),
        ("Set doSpindle;", "Reset doSpindle;", ["Reset doSpindle;"], True),
    ],
)
def test_an_m_code_of_the_cell_that_sets_the_signal_of_the_spindle_switches_it(on, off, lines, is_asked):
    gcode = replace(CELL.gcode, spindle_on=[on], spindle_off=[off], spindle_ccw=None)
    text = CUT.format(before="M52", at="", after="", feed=300).encode()
    issues = cutting_questions(text, replace(CELL, gcode=gcode, m_codes={"M52": lines}))
    assert [kind for kind, _, _ in issues] == ["spindle-off"] * is_asked


@pytest.mark.parametrize(
    ("m_codes", "words"),
    [({}, "if you start it by hand"), ({"M103": ["$OUT[3]=TRUE"]}, "if M103 starts it, or if you start it by hand")],
)
def test_a_cut_is_asked_about_where_neither_program_nor_cell_says_how_the_spindle_starts(m_codes, words):
    cell = replace(CELL, gcode=replace(CELL.gcode, spindle_on=None, spindle_ccw=None), m_codes=m_codes)
    text = CUT.format(before=" ".join(m_codes), at="", after="", feed=300).encode()
    (issue,) = cutting_questions(text, cell)
    assert issue[:2] == ("spindle-off", 7)
    assert words in issue[2]
    for spindle_on in ([], ["$OUT[3]=TRUE"]):
        stated = replace(cell, gcode=replace(cell.gcode, spindle_on=spindle_on))
        assert [kind for kind, _, _ in cutting_questions(text, stated)] == ["spindle-off"] * (
            bool(spindle_on) and not m_codes
        )
    assert cutting_questions(text.replace(b"FX=100", b"FX=0"), cell) == []
    switching = CUT.format(before="M3 S1000", at="", after="", feed=300).encode()
    assert cutting_questions(switching, cell) == [], "lines that are missing are a question of their own"


@pytest.mark.parametrize(
    ("feed", "is_asked"), [(0.6, True), (9.9, True), (10, False), (30000, False), (30100, True), (60000, True)]
)
def test_a_feed_in_another_unit_is_asked_about(feed, is_asked):
    issues = cutting_questions(CUT.format(before="M3 S100", at="", after="", feed=feed).encode())
    assert [(kind, line) for kind, line, _ in issues] == ([("feed-unit", 7)] if is_asked else [])
    robot_program = KRL % (b"X 1500,Y -200,Z 700,A 0,B 0,C 0", b"350")
    robot_program = robot_program.replace(b"LIN ", b"$VEL.CP=%f\n;FORCE FX=100\nLIN " % (min(feed, 1e5) / 60e3))
    assert cutting_questions(robot_program, dialect="krl") == []


@pytest.mark.parametrize(
    ("force", "kind"),
    [
        (b"FX=300 FY=200 MZ=30", ""), (b"FZ=2600", ""), (b"FX=2600 FZ=600", "force-rating"),
        (b"FX=5000 FZ=2000", "force-rating"),
        (b"FX=30 MZ=16", "moment-unit"), (b"FX=30 MX=14", ""), (b"MZ=30", ""),
    ],
)  # fmt: skip
def test_forces_beyond_the_rating_and_moments_in_newton_millimetres_are_asked_about(force, kind):
    program = correction.read([decode("p", FORCED % force)], ROBOT, CELL, "p", "gcode")
    motions = MotionsUnderLoad.of(program, RobotInCell.of(ROBOT, CELL), None)
    issues = list(plausibility.force_questions(program, motions.forces, CELL, ROBOT))
    assert [issue.kind for issue in issues] == ([kind] if kind else [])
    if kind:
        assert issues[0].lines == (5, 6)
        assert issues[0].level == ("info" if b"FZ=600" in force else "warning")


CHANGE = b"G21 G90\nT1 M6\nG0 X0 Y0 Z50\nG1 Z-3 F300\nX40\nG0 Z%d\nX%d\nT2 M6\nG0 Z60\nX20\nG1 Z-1 F300\nX30\nM30\n"


@pytest.mark.parametrize(
    ("height", "x", "length", "words"),
    [
        (50, 40, 400.0, ""), (40, 40, 400.0, "below all"), (48, 40, 400.0, "among"), (48, 400, 400.0, ""),
        (40, 400, 400.0, "below all"), (40, 40, 300.0, ""),
    ],
)  # fmt: skip
def test_a_longer_tool_that_is_mounted_among_the_cuts_is_a_warning(height, x, length, words):
    """Mount a tool of `length` instead of 350 mm, with the tip at Z `height`: the new tip is that much lower."""
    tools = {"1": cells.Frame(Z=350.0), "2": cells.Frame(Z=length)}
    cell = replace(CELL, tools=tools)
    program = correction.read([decode("p", CHANGE % (height, x))], ROBOT, cell, "p", "gcode")
    issues = list(plausibility.tool_change_warnings(program, "+Z"))
    assert bool(issues) == bool(words)
    if words:
        assert words in issues[0].message
        assert f"X {x}, Y 0, Z {350 + height - length:g}" in issues[0].message


RETRACTS = (
    b"DEF P()\n$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}\n$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}\n"
    b"PTP {A1 0,A2 -90,A3 100,A4 0,A5 80,A6 0}\nPTP {X 0,Y 0,Z 200,A 180,B 0,C 180}\n"
    b"LIN {X 0,Y 0,Z -3,A 180,B 0,C 180}\nLIN {X 80,Y 0,Z -3,A 180,B 0,C 180}\n"
    b"LIN {X 80,Y 0,Z 200,A 180,B 0,C 180}\nPTP {X 40,Y 0,Z 50,A 180,B 0,C 180}\n"
    b"LIN {X 40,Y 0,Z -2,A 180,B 0,C 180}\nLIN {X 40,Y 0,Z 160,A 180,B 0,C 180}\n"
    b"LIN {X 0,Y 0,Z 160,A 180,B 0,C 180}\n$TOOL={X %d,Y 0,Z %d,A 0,B 0,C 0}\n"
    b"PTP {X 50,Y 0,Z 200,A 180,B 0,C 180}\nLIN {X 50,Y 0,Z -1,A 180,B 0,C 180}\nEND\n"
)


@pytest.mark.parametrize(
    ("x", "length", "words"),
    [
        (0, 450, ""),  # the tip is mounted at 60, above all cuts and below the retract to 200
        (0, 512, "162 mm longer: where it is mounted its tip is at X 0, Y 0, Z -2 of $BASE, which is among"),
        (300, 349, ""),  # an angle head, 1 mm shorter along the spindle and longer from the flange
        (30, 512, "162 mm longer: where it is mounted its tip is at X -30, Y 0, Z -2 of $BASE, which is among"),
    ],
)  # fmt: skip
def test_retracts_at_feed_are_no_cuts_and_the_length_is_that_along_the_spindle(x, length, words):
    program = correction.read([decode("p", RETRACTS % (x, length))], ROBOT, CELL, "p", "krl")
    messages = [issue.message for issue in plausibility.tool_change_warnings(program, "+Z")]
    assert len(messages) == bool(words)
    assert all(words in message for message in messages)


def test_a_longer_tool_in_a_base_without_cuts_raises_no_question():
    text = (
        b"DEF P()\n$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}\n$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}\n"
        b"PTP {A1 0,A2 -90,A3 100,A4 0,A5 80,A6 0}\nPTP {X 0,Y 0,Z 200,A 180,B 0,C 180}\n"
        b"$TOOL={X 0,Y 0,Z 400,A 0,B 0,C 0}\nPTP {X 50,Y 0,Z 200,A 180,B 0,C 180}\n"
        b"$BASE={X 1500,Y -100,Z 700,A 0,B 0,C 0}\nLIN {X 0,Y 0,Z 150,A 180,B 0,C 180}\nEND\n"
    )
    program = correction.read([decode("p", text)], ROBOT, CELL, "p", "krl")
    assert (len(program.tools), len(program.bases)) == (2, 2)
    assert list(plausibility.tool_change_warnings(program, "+Z")) == []


@pytest.mark.parametrize(("frames", "mass_kg", "mode", "is_asked"), [
    (None, 90.0, "convert", True), (None, 90.0, "predict", True), (None, 90.0, "nominal", False),
    (None, 5.0, "convert", False), (None, 0.0, "convert", False), ("model", 90.0, "convert", False),
    ("controller", 90.0, "convert", False), ("controller", 90.0, "predict", False),
])  # fmt: skip
def test_frames_that_the_controller_measured_on_an_arm_that_sags_are_asked_about(frames, mass_kg, mode, is_asked):
    """A $BASE that is touched with the sagging arm contains the sag: the correction would move the part by it."""
    payload = cells.Payload(mass_kg=mass_kg, Z=200.0)
    cell = replace(CELL, frames=frames, payload=payload, part=replace(CELL.part, tolerance_mm=9.0))
    program = correction.read(
        [decode("p", b"G21 G90\nG0 X0 Y0 Z5\n(FORCE FX=50)\nG1 Z0 F300\nX10\nM30\n")], ROBOT, cell, "p", "gcode"
    )
    result = correction.process(program, ROBOT, cell, None, mode)
    issues = [issue for issue in result.issues if issue.kind == "frames-at-rest"]
    assert len(issues) == is_asked
    content = summary(result, cell.tolerance, cell.part_tolerance)
    assert (content.verdict.tolerance.held is None) == is_asked
    exceeded = summary(result, cell.tolerance, 1e-5).verdict.tolerance
    assert (exceeded.state, exceeded.held) == ("failed", False)
    if is_asked:
        shift = max(norm(result.deviation_before - result.deflection)[~result.rapid]) * 1e3
        assert f"up to {shift:.2g} mm from where the controller has it, by the payload." in issues[0].message
        assert (issues[0].level, issues[0].source_line) == ("warning", None)
        assert content.verdict.better.state == "warning"
        assert content.verdict.better.reasons[0].startswith("without a force the tip is up to")
        assert content.verdict.tolerance.reasons[0].startswith(
            "whether [part] tolerance_mm is held is unknown: the fra"
        )
