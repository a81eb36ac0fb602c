"""Answers on a command line and in questions, as values: what is read and what is refused."""

from __future__ import annotations

import pytest

from postproc.cell import Box
from postproc.errors import InputError
from postproc.jobs import answers


@pytest.mark.parametrize(
    ("parse", "text", "value"),
    [
        (answers.numbers, "1, -2;3.5,", (1.0, -2.0, 3.5)),
        (answers.numbers, " ", ()),
        (answers.number, " 1e3 ", 1000.0),
        (answers.frame, " 12 ", 12),
        (answers.frame, "12,", (12.0,)),
        (answers.full_frame, "3", 3),
        (answers.full_frame, "1,2,3,4,5,6", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)),
        (answers.stated_frame, "1,2,3", (1.0, 2.0, 3.0)),
        (answers.numbered_frames, ["3=1,2,3", " 4 = 5,6,7", "3=1,2,3"], {3: (1.0, 2.0, 3.0), 4: (5.0, 6.0, 7.0)}),
        (
            answers.tools,
            ["1=412.5", "t2=1,2,3", "T3=1,2,3,4,5,6"],
            {1: (0.0, 0.0, 412.5), 2: (1.0, 2.0, 3.0), 3: (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)},
        ),
        (
            answers.work_offsets,
            ["g55=300,0,0", "G59.3=1,2,3,4"],
            {"G55": (300.0, 0.0, 0.0), "G59.3": (1.0, 2.0, 3.0, 4.0)},
        ),
        (answers.m_codes, ["M31", " m032 ", "33"], ["M31", "M32", "M33"]),
        (answers.switch, "hand", ([], [])),
        (answers.switch, "$OUT[1]=TRUE | $OUT[1]=FALSE", (["$OUT[1]=TRUE"], ["$OUT[1]=FALSE"])),
        (answers.tolerance, " ", None),
        (answers.tolerance, "0.05", 0.05),
        (answers.payload, "", None),
        (answers.payload, "28", (28.0, 0.0, 0.0, 0.0)),
        (answers.payload, "28,1,2,3", (28.0, 1.0, 2.0, 3.0)),
        (answers.choice_parser("a", "b"), " b ", "b"),
        (answers.place, "1,2,3", (1.0, 2.0, 3.0)),
        (answers.points, ["a=0,0,-120", "C = 1,2,3"], {"A": (0.0, 0.0, -120.0), "C": (1.0, 2.0, 3.0)}),
        (answers.cutter, "flat,12", answers.CutterShape("flat", 12.0)),
        (answers.cutter, "bull 12 6", answers.CutterShape("bull", 12.0, 6.0)),
        (answers.flutes, " 100 ", 100),
        (answers.flutes, "1", 1),
        (answers.speed, "12000", 12000.0),
        (answers.rotary_axes, "c,b", ["C", "B"]),
        (answers.rotary_axes, "A", ["A"]),
    ],
)
def test_an_answer_is_read_as_its_value(parse, text, value):
    assert parse(text) == value


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        (answers.numbers, "1,x"),
        (answers.number, "x"),
        (answers.number, "nan"),
        (answers.number, "-inf"),
        (answers.full_frame, "1,2"),
        (answers.full_frame, "1,2,3,4"),
        (answers.full_frame, "1,2,inf"),
        (answers.stated_frame, "3"),
        (answers.numbered_frames, ["0=1,2,3"]),
        (answers.numbered_frames, ["x=1,2,3"]),
        (answers.numbered_frames, ["3=1,2,3", "3=1,2,4"]),
        (answers.tools, ["1"]),
        (answers.tools, ["1=1,2"]),
        (answers.tools, ["x=1"]),
        (answers.tools, ["1=1", "T1=2"]),
        (answers.work_offsets, ["G53=1,2,3"]),
        (answers.work_offsets, ["G60=1,2,3"]),
        (answers.work_offsets, ["G59.4=1,2,3"]),
        (answers.work_offsets, ["G55=1,2"]),
        (answers.work_offsets, ["G55=1,2,3", "G55=1,2,4"]),
        (answers.m_codes, ["M"]),
        (answers.m_codes, ["M3x"]),
        (answers.m_codes, ["M30"]),
        (answers.line, '"'),
        (answers.line, "LIN {X 1}"),
        (answers.switch, "$OUT[1]=TRUE"),
        (answers.switch, "a|"),
        (answers.switch, "a|b|c"),
        (answers.tolerance, "0"),
        (answers.tolerance, "-1"),
        (answers.payload, "0"),
        (answers.payload, "28,1,2"),
        (answers.payload, "28,1,2,nan"),
        (answers.robot, "no_robot"),
        (answers.choice_parser("a", "b"), "c"),
        (answers.place, "1,2"),
        (answers.place, "1,2,nan"),
        (answers.points, ["D=1,2,3"]),
        (answers.points, ["A=1,2,3", "A=1,2,4"]),
        (answers.material, "cheese"),
        (answers.cutter, "flat"),
        (answers.cutter, "bull,12"),
        (answers.cutter, "flat,12,1"),
        (answers.cutter, "flat,0"),
        (answers.cutter, "bull,12,6.1"),
        (answers.cutter, "bull,12,0"),
        (answers.cutter, "round,3"),
        (answers.flutes, "0"),
        (answers.flutes, "101"),
        (answers.flutes, "2.5"),
        (answers.speed, "0"),
        (answers.stock, "X=0:100,Y=0:80,Z=0:-20"),
        (answers.stock, "X=0:100,X=0:80,Z=0:20"),
        (answers.stock, "no.stl"),
        (answers.stock, "X=0:100,Y=0:80,Z=0:0"),
        (answers.rotary_axes, ""),
        (answers.rotary_axes, "AA"),
        (answers.rotary_axes, "ABC"),
        (answers.rotary_axes, "AX"),
    ],
)
def test_another_answer_is_refused(parse, text):
    with pytest.raises(InputError):
        parse(text)


def test_a_stock_is_a_box_or_a_file(work_folder):
    box = Box(X=(0.0, 100.5), Y=(-8.0, 80.0), Z=(-20.0, 0.0))
    assert answers.stock("X=0:100.5, y = -8:80 ,Z=-20:0").box == box
    assert answers.stock(answers.box_text(box)).box == box
    (work_folder / "part.stl").write_text("")
    assert answers.stock("part.stl").file == "part.stl"


def test_rotary_axes_turn_about_the_axes_of_their_letters():
    made = answers.rotary(["C", "A"], "indexed", {"A": (1.0, 2.0, 3.0), "B": (7.0, 8.0, 9.0)})
    assert (made.axes, made.kind) == (["C", "A"], "indexed")
    assert (made.A.point, made.A.direction) == ((1.0, 2.0, 3.0), (1.0, 0.0, 0.0))
    assert made.B is None
    assert made.C is None
