"""Dwells with the tool in material: the force ends, and a corrected tool goes on to where it is commanded."""

import numpy as np
import pytest

from tests.dialects import rapid_reading
from tests.dialects.krl_programs import body, read
from tests.placement import setting

HEAD = "G21 G90\nS3000 M3\nG4 P1.0\n(FORCE FX=-110 FY=-190 FZ=330 FRAME=BASE)\nG0 X1300 Y-20 Z60\n"


def dwells(text, mode="convert"):
    result = setting.process_text(HEAD + text, setting.cell(base=(0.0, 0.0, 500.0)), mode=mode)
    assert not result.failed, result.issues
    return result, [issue for issue in result.issues if issue.kind == "dwell-in-material"]


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("G82 X1300 Y-20 Z0 R20 P1.0 F300\nX1320\nG80\nG0 Z60\n", (6, 7)),
        ("G1 Z0 F300\nG4 P0.5\nG1 Y20\nG0 Z60\n", (6,)),
        ("G1 Z0 F300\nG1 Y20\nG4 P0.5\nG0 Z60\n", (7,)),
        ("G1 Z0 F300\nM0\nG1 Y20\nG0 Z60\n", (6,)),
    ],
)
def test_a_corrected_program_that_waits_in_material_is_warned_of(text, lines):
    result, (issue,) = dwells(text)
    assert (issue.level, issue.source_line, issue.lines) == ("warning", lines[0], lines)
    ends = np.isin(result.source_line, lines) & (result.t == 1.0) & ~result.rapid
    beyond = 1e3 * np.linalg.norm(result.deflection[ends], axis=1).max()
    assert beyond > 0.1
    commanded = np.linalg.norm(result.printed[ends, :3] - 1e3 * result.nominal.position[ends], axis=1).max()
    assert beyond == pytest.approx(commanded, rel=0.02)  # from the nominal place to the commanded one
    assert f"cuts up to {beyond:.2f} mm beyond the nominal one" in issue.message


@pytest.mark.parametrize(
    "text",
    [
        "G81 X1300 Y-20 Z0 R20 F300\nG80\nG0 Z60\n",
        "G1 Z0 F300\nG1 Y20\nG0 Z60\nG4 P2.0\n",
        "(FORCE OFF)\nG1 Z0 F300\nG4 P1.0\n",
    ],
)
def test_where_no_force_ends_in_a_dwell_nothing_is_told(text):
    assert dwells(text)[1] == []


def test_an_uncorrected_program_comes_to_the_nominal_place_while_it_waits():
    assert dwells("G1 Z0 F300\nG4 P0.5\nG1 Y20\nG0 Z60\n", "predict")[1] == []


def test_waits_of_krl_are_known_and_those_that_take_no_time_are_not():
    lines = ["LIN {X 7}", "WAIT SEC 0", "LIN {X 8}", " wait sec 0.5 ;x", "LIN {X 9}", "WAIT FOR TRUE", "LIN {X 8}"]
    lines += ["WAIT FOR $IN[3]", "FOR I=1 TO 2", "LIN {Y 5}", "WAIT SEC T", "ENDFOR", "HALT", "; WAIT SEC 3"]
    lines += ["LIN {X 7}", "PAUSE()", "SHOW()"]
    subs = "DEF PAUSE()\r\nREADY()\r\nEND\r\nDEF READY()\r\nWAIT FOR $IN[1]\r\nEND\r\n"
    subs += "DEF SHOW()\r\nWAIT SEC 0\r\n$OUT[1]=TRUE\r\nEND\r\n"
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
