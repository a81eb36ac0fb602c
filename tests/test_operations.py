"""Operations of programs as CAM systems write them."""

from __future__ import annotations

import pytest

import postproc
from postproc.operations import operation_indices, operations, text_lines
from tests.machining.setting import CELL, ROBOT
from tests.places import SAMPLES

CUT = "G0 X0 Y0 Z5|G1 Z-1 F900|X9|G0 Z5"
FUSION = (
    f"(1001)|(T1 D=10. CR=0. - flat end mill)||(2D Adaptive1)|T1 M6|S9000 M3|{CUT}||(2D Contour2)|{CUT}"
    f"|(Drill3)|N50 T2 M6|S900 M3|{CUT}"
)
CAMBAM = f"(MADE USING CAMBAM)|(Untitled 21/11/2026 10:15:00)|(T1 : 6.0)|T1 M6|(Profile1)|{CUT}"
FREECAD = (
    "(Exported by FreeCAD)|(begin operation: TC: Endmill)|M6 T1|(finish operation: TC: Endmill)"
    f"|(begin operation: Pocket)|(Pocket)|(Compensated Tool Path)|{CUT}"
    f"|(finish operation: Pocket)|(begin operation: Contour)|{CUT}"
)
VECTRIC = f"T1 M6|( Toolpath:- VCarve 1 )|()|{CUT}|( Toolpath:- Profile 2 )|{CUT}"
REMARKS = "(Face)|T1 M6|G0 X0 Y0 Z5|G1 Z-1 F900|X9|(ramp 2 deg)|X20 (corner)|(level 2)|X30|G0 Z5"
BESIDE = f"(Face)|T1 M6|{CUT}|M9 (air off)|M5 (vacuum off)|(Bore)|T2 M6|(Long hole)|S900 M3|{CUT}"
EMPTY = f"(Face)|T1 M6|{CUT}|(Bore)|G54|(Bore)|G0 X5|(Slot)|G0 X6|{CUT}"


def found(folder, lines):
    (folder / "part.nc").write_text("\n".join(("G21 G90 G17", *lines.split("|"), "M30", "")))
    program = postproc.read_program(folder / "part.nc", ROBOT, CELL)
    out = operations(program)
    assert [each.first for each in out] == [0, *(each.last + 1 for each in out[:-1])]
    assert out[-1].last == len(program.motions) - 1
    return program, [(each.name, each.tool) for each in out]


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (FUSION, [("2D Adaptive1", 1), ("2D Contour2", 1), ("Drill3", 2)]),
        (CAMBAM, [("Profile1", 1)]),
        (FREECAD, [("Pocket", 1), ("Contour", 1)]),
        (VECTRIC, [("VCarve 1", 1), ("Profile 2", 1)]),
        (f"T1 M6|{CUT}|T2 M6|{CUT}", [("T1", 1), ("T2", 2)]),
        (CUT, [("operation 1", 0)]),
        (REMARKS, [("Face", 1)]),
        (EMPTY, [("Face", 1), ("Slot", 1)]),
        (BESIDE, [("Face", 1), ("Bore", 2)]),
    ],
    ids=[
        "Fusion",
        "CamBam",
        "FreeCAD",
        "Vectric",
        "tools only",
        "nothing",
        "remarks in a cut",
        "without a cut",
        "comments beside statements",
    ],
)
def test_names_and_tools(tmp_path, lines, expected):
    assert found(tmp_path, lines)[1] == expected


@pytest.mark.parametrize("piece", [0, 1, 5, 20])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_lines_do_not_depend_on_how_a_long_text_is_divided(piece, end):
    text = end.join([*FUSION.split("|"), "", "last"])
    assert list(text_lines(text, piece)) == text.split(end)
    assert list(text_lines(text + end, piece)) == text.split(end)
    assert list(text_lines("", piece)) == []


def test_many_comments_within_cuts_name_nothing(tmp_path):
    remarks = "|".join(f"(piece {k}a)|X{k}" for k in range(100))
    _, names = found(tmp_path, f"(Face)|T1 M6|G0 X0 Y0 Z5|G1 Z-1 F900|{remarks}|G0 Z5|(Bore)|{CUT}")
    assert names == [("Face", 1), ("Bore", 1)]
    some = found(tmp_path, f"(Face)|T1 M6|{CUT}|G1 X5|(Wall)|X7|{CUT}")[0]
    assert [each.name for each in operations(some)] == ["Face", "Wall"]
    assert [each.name for each in operations(some, at_retracts=True)] == ["Face"]


def test_the_operations_of_a_subprogram_follow_the_execution(tmp_path):
    lines = "(Left)|T1 M6|G0 X0 Y0 Z5|M98 P7|(Right)|G0 X50|M98 P7|M30|O7|G91 G1 X9 F900|G90|M99"
    program, names = found(tmp_path, lines)
    assert names == [("Left", 1), ("Right", 1)]
    assert operation_indices(operations(program), [0, len(program.motions) - 1]).tolist() == [0, 1]


def test_the_samples():
    plate = postproc.read_program(SAMPLES / "plate.nc", ROBOT, CELL)
    assert [(each.name, each.tool, each.line) for each in operations(plate)] == [("Pocket", 1, 12), ("Contour", 1, 68)]


def test_of_a_krl_program_comments_count(tmp_path):
    frames = "$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}|$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}"
    cut = "PTP {X 0,Y 0,Z 50,A 0,B 0,C 180}|LIN {X 9,Y 0,Z 50,A 0,B 0,C 180}"
    home = "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}"
    text = f"DEF part()|BAS(#INITMOV, 0)|$VEL.CP=0.1|{frames}|{home}|;Roughing|{cut}|;Smoothing|{cut}|END|"
    (tmp_path / "part.src").write_text(text.replace("|", "\n"))
    program = postproc.read_program(tmp_path / "part.src", ROBOT, CELL)
    assert [each.name for each in operations(program)] == ["Roughing", "Smoothing"]
