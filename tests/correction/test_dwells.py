"""Dwells with the tool in material: the force ends, and a corrected tool goes on to where it is commanded."""

from dataclasses import dataclass

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction, forces, toolpath
from tests.dialects import krl_programs, rapid_reading
from tests.dialects.krl_programs import body, read
from tests.placement import setting

CELL = setting.cell(base=(0.0, 0.0, 500.0))
HEAD = "G21 G90\nS3000 M3\nG4 P1.0\n(FORCE FX=-110 FY=-190 FZ=330 FRAME=BASE)\nG0 X1300 Y-20 Z60\n"
WAITS = [
    ("G82 X1300 Y-20 Z0 R20 P1.0 F300\nX1320\nG80\nG0 Z60\n", (6, 7)),
    ("G1 Z0 F300\nG4 P0.5\nG1 Y20\nG0 Z60\n", (6,)),
    ("G1 Z0 F300\nG1 Y20\nG4 P0.5\nG0 Z60\n", (7,)),
    ("G1 Z0 F300\nM0\nG1 Y20\nG0 Z60\n", (6,)),
    ("G1 Z0 F300\nG2 X1320 Y0 I20 J0\nM0\nG3 X1340 Y20 I0 J20\nG0 Z60\n", (7,)),
]


def process(text, mode="convert"):
    result = setting.process_text(HEAD + text, CELL, mode=mode)
    assert not result.failed, result.issues
    return result


def issues_of(result, kind):
    return [issue for issue in result.issues if issue.kind == kind]


def distances(result):
    """Return from where the tool is to be to where it is commanded, at each target [mm]."""
    return np.linalg.norm(result.printed[:, :3] - 1e3 * result.nominal.position, axis=1)


@pytest.mark.parametrize(("text", "lines"), WAITS)
def test_a_corrected_tool_waits_at_the_nominal_place(text, lines):
    result = process(text)
    (issue,) = issues_of(result, "force-released")
    assert (issue.level, issue.source_line, issue.lines) == ("info", lines[0], lines)
    assert not issues_of(result, "dwell-in-material")
    waits = np.flatnonzero(np.isin(result.source_line, lines) & (result.t == 1.0) & ~result.rapid)
    offset = distances(result)
    np.testing.assert_allclose(offset[waits], 0.0, atol=2e-4)
    assert (offset[waits - 1] > 0.2).all()  # a millimetre before, the whole correction holds
    before = np.linalg.norm(result.nominal.position[waits - 1] - result.nominal.position[waits], axis=1)
    np.testing.assert_allclose(before, 1e-3, rtol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(result.deflection[waits], axis=1), 0.0, atol=1e-9)
    text_lines = result.documents[0].text.splitlines()
    for wait in waits.tolist():
        following = text_lines[int(result.output_line[wait]) :][:1]
        assert following in (["WAIT SEC 1"], ["WAIT SEC 0.5"], ["HALT"])


@pytest.mark.parametrize("line", ["WAIT SEC 3.0", "WAIT FOR $IN[5]", "halt", "WAIT SEC 0", "$OUT[1]=TRUE"])
@pytest.mark.parametrize("word", ["M111", "M3 S9000"])
def test_waits_in_lines_of_the_cell_count_too(word, line):
    lines = ["$OUT[2]=TRUE", line]
    cell = replace(CELL, m_codes={"M111": lines}, gcode=replace(CELL.gcode, spindle_on=lines))
    result = setting.process_text(HEAD + f"G1 Z0 F300\n{word}\nG1 Y20\nG0 Z60\n", cell)
    assert not result.failed, result.issues
    end = np.flatnonzero((result.source_line == 6) & (result.t == 1.0))
    is_wait = line not in ("WAIT SEC 0", "$OUT[1]=TRUE")
    assert (distances(result)[end] < 2e-4) == is_wait
    assert bool(issues_of(result, "force-released")) == is_wait


SUBPROGRAMS = {
    "waits": ("spindle_on.src", "DEF Spindle_On(n:IN)\n$OUT[1]=TRUE\nWAIT SEC 3\nEND\n"),
    "calls one that waits": ("SPINDLE_ON.SRC", "DEF SPINDLE_ON(n:IN)\nREADY ( )\nEND\n"),
    "calls itself": ("spindle_on.src", "DEF SPINDLE_ON(n:IN)\n; WAIT SEC 3\nSPINDLE_ON(n)\nEND\n"),
    "is unknown": ("spindle_off.src", "DEF SPINDLE_OFF()\nWAIT SEC 3\nEND\n"),
}


@pytest.mark.parametrize("what", SUBPROGRAMS)
def test_waits_in_subprograms_that_lines_of_the_cell_call_count_if_their_text_is_known(what, tmp_path):
    name, text = SUBPROGRAMS[what]
    library = tmp_path / "lib"
    library.mkdir()
    (library / name).write_text(text)
    (library / "ready.src").write_text("DEF READY()\nWAIT FOR $IN[1]\nEND\n")
    gcode = replace(CELL.gcode, spindle_on=["SPINDLE_ON({S})"])
    cell = replace(CELL, folder=str(tmp_path), krl=replace(CELL.krl, search=["lib", "none"]), gcode=gcode)
    result = setting.process_text(HEAD + "G1 Z0 F300\nM3 S9000\nG1 Y20\nG0 Z60\nM3 S7000\n", cell)
    assert not result.failed, result.issues
    end = np.flatnonzero((result.source_line == 6) & (result.t == 1.0))
    assert (distances(result)[end] < 2e-4) == ("waits" in what)
    issues = issues_of(result, "unknown-subprogram")
    assert [issue.source_line for issue in issues] == ([7] if what == "is unknown" else [])


@pytest.mark.parametrize(
    "text",
    [
        "G81 X1300 Y-20 Z0 R20 F300\nG80\nG0 Z60\n",
        "G1 Z0 F300\nG1 Y20\nG0 Z60\nG4 P2.0\n",
        "(FORCE OFF)\nG1 Z0 F300\nG4 P1.0\n",
    ],
)
def test_where_no_force_acts_before_a_wait_nothing_is_changed(text):
    result = process(text)
    assert not issues_of(result, "force-released")
    assert not issues_of(result, "dwell-in-material")


def test_an_uncorrected_program_is_predicted_to_come_to_the_nominal_place_while_it_waits():
    result = process("G1 Z0 F300\nG4 P0.5\nG1 Y20\nG0 Z60\n", "predict")
    wait = np.flatnonzero((result.source_line == 6) & (result.t == 1.0))
    deviation = 1e3 * np.linalg.norm(result.deviation_before, axis=1)
    assert deviation[wait] == pytest.approx(0.0, abs=1e-6)
    assert deviation.max() > 0.2


@dataclass(frozen=True)
class StatedKnots:
    """A source of forces along motions, as a file gives them."""

    places: tuple[tuple[int, float, float], ...]
    name = "stated.csv"

    def along(self, program, path):
        motion, t, size = map(np.array, zip(*self.places, strict=True))
        wrench = size[:, None] * [0.0, -190.0, 330.0, 0.0, 0.0, 0.0]
        return forces.Knots.along(motion, t, wrench, np.full(len(t), 0), sigma=0.1 * np.abs(wrench))


def test_forces_along_motions_fall_before_a_wait_and_rise_behind_it():
    program, _ = setting.read_with_robot(
        HEAD + "G1 Z0 F300\nG1 Y20\nG4 P0.5\nG1 Y30\nG1 Y30.5\nM0\nG1 Y70\nG0 Z60\n", CELL
    )
    cut, short, last = np.flatnonzero(~program.motions.rapid)[[1, 3, 4]].tolist()
    stated = [(cut, 0.0, 1.0), (cut, 0.5, 2.0), (cut, 1.0, 3.0), (cut + 1, 0.0, 3.0), (cut + 1, 1.0, 1.0)]
    stated += [(short, 0.5, 1.0), (last, 0.0, 1.0)]
    path = toolpath.segments(program, np.eye(4))
    load = forces.assign(program, path, StatedKnots(tuple(stated)), "+Z", ramp=2e-3)
    # 40 mm: the fall begins 2 mm before the end, at the force stated there; 10 mm: the rise ends behind 2 mm
    expected = {
        (cut, 0.25): 1.5,
        (cut, 0.95): 2.9,
        (cut, 0.975): 1.45,
        (cut, 1.0): 0.0,
        (cut + 1, 1e-9): 0.0,
        (cut + 1, 0.1): 1.3,
        (cut + 1, 0.2): 2.6,
        (cut + 1, 1.0): 1.0,
        (short, 0.5): 1.0,  # 0.5 mm: the fall has two fifths of it
        (short, 0.6): 1.0,
        (short, 0.8): 0.5,
        (last, 0.06): 1.0,
    }
    motion, t = map(np.array, zip(*expected, strict=True))
    sample = toolpath.at(program, path, motion, t)
    np.testing.assert_allclose(load.at(sample)[:, 2] / 330.0, list(expected.values()), atol=1e-6)
    spread = load.spread_at(sample)
    np.testing.assert_allclose(spread[[3, 4], 0, 2, 2], 0.0, atol=1e-4)
    assert spread[1, 0, 2, 2] > 80.0


def test_a_motion_too_short_to_cut_has_no_force_before_a_wait_and_the_one_before_ends_without():
    corner = "{X 70,Y 40,Z 0,A 180,B 0,C 180}"
    lines = ["LIN {X 50,Y 0,Z 0,A 180,B 0,C 180}", ";FORCE FX=-110 FY=-190 FZ=330", f"LIN {corner}"]
    text = body(*lines, ";FORCE FX=110 FY=-190 FZ=330", f"LIN {corner}", "WAIT SEC 1", ";FORCE OFF", "LIN {Z 90}")
    program, model = setting.read_with_robot(text, krl_programs.CELL, "krl")
    result = correction.process(program, model, krl_programs.CELL, None)
    assert not result.failed, result.issues
    assert not issues_of(result, "dwell-in-material")
    offset = distances(result)
    assert offset.max() > 0.2
    ends = np.flatnonzero((result.t == 1.0) & np.isin(result.motion, [1, 2]))
    np.testing.assert_allclose(offset[ends], 0.0, atol=2e-4)


def test_a_spline_piece_keeps_its_force_to_the_end_and_a_wait_behind_it_is_warned_of():
    points = ["{X 50,Y 0,Z 0,A 180,B 0,C 180}", "{X 70,Y 40}", "{X 90,Y 70}"]
    force = ";FORCE FX=-110 FY=-190 FZ=330"
    spline = ["SPLINE", force, f"SPL {points[1]}", f"SPL {points[2]}", "ENDSPLINE", "WAIT SEC 1"]
    text = body(f"LIN {points[0]}", *spline, ";FORCE OFF", "LIN {Z 90}")
    program, model = setting.read_with_robot(text, krl_programs.CELL, "krl")
    result = correction.process(program, model, krl_programs.CELL, None)
    assert not result.failed, result.issues
    (issue,) = issues_of(result, "dwell-in-material")
    beyond = distances(result)[(result.t == 1.0) & np.isin(result.source_line, issue.lines or (issue.source_line,))]
    assert f"cuts up to {beyond.max():.2f} mm beyond the nominal one" in issue.message
    assert "End the spline before" in issue.message


def test_a_wait_in_one_of_two_branches_is_warned_of_with_what_to_do():
    corner = "LIN {X 70,Y 40,Z 0,A 180,B 0,C 180}"
    lines = ["LIN {X 50,Y 0,Z 0,A 180,B 0,C 180}", ";FORCE FX=-110 FY=-190 FZ=330", "IF $IN[1] THEN", corner]
    ends = [*lines, "WAIT SEC 1", "ELSE", "LIN {X 60,Y 9,Z 0,A 180,B 0,C 180}", corner]
    for waits_in_both in (False, True):
        last = "LIN {X 70,Y 40,Z 90,A 180,B 0,C 180}"
        text = body(*ends, *(["WAIT SEC 1"] if waits_in_both else []), "ENDIF", ";FORCE OFF", last)
        program, model = setting.read_with_robot(text, krl_programs.CELL, "krl")
        result = correction.process(program, model, krl_programs.CELL, None)
        assert not result.failed, result.issues
        warnings = issues_of(result, "dwell-in-material")
        assert ["Wait in all of them" in issue.message for issue in warnings] == [True][waits_in_both:]
        branch_ends = np.isin(
            result.source_line, [index for index, line in enumerate(text.splitlines(), 1) if line == corner]
        )
        assert (distances(result)[branch_ends & (result.t == 1.0)] < 2e-4).all() == waits_in_both


CUT_FORCE = ";FORCE FX=-110 FY=-190 FZ=330"
HOME = "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}"
POINTS = [f"LIN {{X {x},Y 0,Z 0,A 180,B 0,C 180}}" for x in (50, 70)]


@pytest.mark.parametrize("wait", [["WAIT SEC 1"], ["IF $IN[1] THEN", "HALT", "ENDIF"], ["PAUSE()"]])
@pytest.mark.parametrize(("before", "begin"), [([CUT_FORCE, POINTS[1]], []), ([HOME], [HOME])])
def test_a_round_ends_at_the_nominal_place_if_the_next_one_begins_with_a_wait(before, begin, wait):
    round_lines = ["LOOP", *wait, *begin, CUT_FORCE, *POINTS, "ENDLOOP"]
    text = body(*before, *round_lines) + "DEF PAUSE()\r\nWAIT SEC 1\r\nEND\r\n"
    program, model = setting.read_with_robot(text, krl_programs.CELL, "krl")
    result = correction.process(program, model, krl_programs.CELL, None)
    assert not result.failed, result.issues
    assert not issues_of(result, "dwell-in-material")
    lines = [number for number, line in enumerate(text.splitlines(), 1) if line == POINTS[1]]
    ends = np.isin(result.source_line, lines) & (result.t == 1.0)
    assert np.count_nonzero(ends) == len(lines) == 1 + (not begin)
    np.testing.assert_allclose(distances(result)[ends], 0.0, atol=2e-4)
    assert distances(result).max() > 0.2


def test_a_round_whose_force_ends_before_a_wait_begins_with_a_force_comment():
    text = body(HOME, CUT_FORCE, "LOOP", *POINTS, "WAIT SEC 1", HOME, "ENDLOOP")
    program, model = setting.read_with_robot(text, krl_programs.CELL, "krl")
    result = correction.process(program, model, krl_programs.CELL, None)
    assert not result.failed, result.issues
    lines = result.documents[0].text.splitlines()
    assert lines[lines.index("LOOP") + 1].startswith(";FORCE FX=-110")


def test_waits_of_krl_are_known_and_those_that_take_no_time_are_not():
    lines = ["LIN {X 7}", "WAIT SEC 0", "LIN {X 8}", " wait sec 0.5 ;x", "LIN {X 9}", "WAIT FOR TRUE", "LIN {X 8}"]
    lines += ["WAIT FOR $IN[3]", "FOR I=1 TO 2", "LIN {Y 5}", "WAIT SEC T", "ENDFOR", "HALT", "; WAIT SEC 3"]
    lines += ["LIN {X 7}", "PAUSE()", "SHOW()"]
    subs = "DEF PAUSE()\r\nREADY()\r\nEND\r\nDEF READY()\r\nWAIT FOR $IN[1]\r\nEND\r\n"
    subs += "DEF SHOW()\r\nWAIT SEC 0\r\n$OUT[1]=TRUE\r\nEND\r\n"
    assert read(body("LIN {X 100,Y 20,Z 30,A 10,B 20,C 170}") + subs).events == ()  # not called
    events = read(body("LIN {X 100,Y 20,Z 30,A 10,B 20,C 170}", *lines) + subs).events
    waits = [(event.before, event.line, event.value) for event in events if event.kind == "dwell"]
    unknown = pytest.approx(np.nan, nan_ok=True)
    assert waits == [
        (3, 8, 0.5),
        (5, 12, unknown),
        (6, 15, unknown),
        (7, 15, unknown),
        (7, 17, unknown),
        (8, 20, unknown),
    ]


def test_a_wait_of_krl_is_behind_each_motion_that_may_be_the_last_before_it():
    def point(x):
        return f"LIN {{X {x},Y 20,Z 30,A 10,B 20,C 170}}"

    lines = [point(7), "IF $IN[1] THEN", "WAIT SEC 1", point(8), point(9), "ELSE", "WAIT SEC 2", "WAIT SEC 3", point(9)]
    lines += ["ENDIF", "WAIT SEC 4", point(5), "IF $IN[2] THEN", "HALT", "ENDIF", "WAIT SEC 5", point(6)]
    events = read(body(*lines)).events
    waits = [(event.value, event.before - 1) for event in events if event.kind == "dwell"]
    assert waits[:-2] == [(1.0, 0), (2.0, 0), (3.0, 0), (4.0, 2), (4.0, 3)]
    assert np.isnan(waits[-2][0])
    assert [motion for _, motion in waits[-2:]] == [4, 4]


def test_waits_of_rapid_are_known_in_execution_order():
    move = f"MoveL {rapid_reading.at(0, 0, 20)}{rapid_reading.tail()}"
    lines = [
        "FOR i FROM 1 TO 2 DO",
        move,
        "WaitTime 0;",
        "Hold;",
        "ENDFOR",
        "WaitDI di1,1;",
        "WaitUntil TRUE;",
        "Stop;",
    ]
    lines += [move, "IF di1=1 THEN", "Break;", "ENDIF"]
    text = rapid_reading.module(lines, routines="PROC Hold()\nWaitTime\\InPos,0.5;\nENDPROC")
    events = rapid_reading.read(text).events
    assert [(event.kind, event.before) for event in events] == [("dwell", count) for count in (2, 3, 3, 3, 4)]


def test_a_wait_of_rapid_that_begins_a_loop_without_end_is_behind_its_last_move_too():
    move = f"MoveL {rapid_reading.at(0, 0, 20)}{rapid_reading.tail()}"
    lines = ["WHILE TRUE DO", "Hold;", rapid_reading.MOVE_HOME, move, "ENDWHILE"]
    text = rapid_reading.module(lines, routines="PROC Hold()\nWaitTime 0.5;\nENDPROC")
    assert [event.before for event in rapid_reading.read(text).events] == [1, 3]
