"""Tools and stock in comments, in the forms of public posts; the expected values are read by eye."""

from __future__ import annotations

import pytest

from postproc.machining.tool_comments import Comment, commented_tools, stock_size

FORMS = [
    ("T1 D=16. CR=0. - ZMIN=-5. - flat end mill", 1, "flat", 16.0, 0.0),
    ("T1 D=8. CR=1. - BULL NOSE", 1, "bull", 8.0, 1.0),
    ("T5 D=20 CR=3 TAPER=0deg - ZMIN=-1 - bullnose end mill", 5, "bull", 20.0, 3.0),
    ("T2 D=12.7 CR=6.35 - BALL END MILL", 2, "ball", 12.7, 0.0),
    (" T212 |    3. FLAT ENDMILL | H0 ", 212, "flat", 3.0, 0.0),
    ("T2 | 6. BALL ENDMILL | H2 | D6.", 2, "ball", 6.0, 0.0),
    ("TOOL - 1 DIA. OFF. - 1 LEN. - 1 DIA. - 10.", 1, None, 10.0, 0.0),
    ("T1 = End Mill {6.0 mm}", 1, "flat", 6.0, 0.0),
    ("Tool 1: End Mill {0.25 inch}", 1, "flat", 6.35, 0.0),
    ("T1  10.0 mm Drill", 1, "drill", 10.0, 0.0),
    ("T5 D=6.8 CR=0. TAPER=118DEG - ZMIN=-12. - DRILL", 5, "drill", 6.8, 0.0),
    ("T3 D=6. CR=0. TAPER=90deg - ZMIN=-2. - spot drill", 3, None, 6.0, 0.0),
    (" T1 | 1/2 FLAT ENDMILL | H1 ", 1, "flat", 12.7, 0.0),
    (" T7 | 1-1/4 FLAT ENDMILL | H7 ", 7, "flat", 31.75, 0.0),
    ("T4 - 3/8 DRILL", 4, "drill", 9.525, 0.0),
    ("T1 D=5 CR=0 - ZMIN=-8 - Schaftfraser", 1, "flat", 5.0, 0.0),
    ("T6  Spiral O Metal 3.175*12mm  Makera    D=3.175 CR=0. - ZMIN=-26. - flat end mill", 6, "flat", 3.175, 0.0),
]


@pytest.mark.parametrize(("text", "number", "shape", "diameter", "corner"), FORMS)
def test_a_tool_comment_gives_number_shape_and_diameter(text, number, shape, diameter, corner):
    tools = commented_tools([Comment(2, text)], [], inches=False)
    assert set(tools) == {number}
    assert (tools[number].shape, tools[number].diameter_mm, tools[number].corner_radius_mm) == (shape, diameter, corner)
    assert tools[number].text == text.strip()


@pytest.mark.parametrize(
    "text", ["T4 D=59.728 CR=0. - ZMIN=-6.35 - FORM MILL", "T5 D=20 CR=3 TAPER=5deg - ZMIN=-1 - tapered mill"]
)
def test_a_cutter_that_no_process_can_describe_has_no_shape(text):
    (tool,) = commented_tools([Comment(1, text)], [], inches=False).values()
    assert tool.shape is None


def test_lengths_of_a_program_in_inches_become_mm_unless_the_comment_says_mm():
    tools = commented_tools(
        [Comment(1, "T1 D=0.5 CR=0.06 - bull nose end mill"), Comment(2, "T2 | 6 mm BALL ENDMILL")], [], inches=True
    )
    assert (tools[1].diameter_mm, tools[1].corner_radius_mm) == (12.7, 1.524)
    assert tools[2].diameter_mm == 6.0


def test_a_fraction_is_of_an_inch_whatever_the_units_of_the_program():
    for inches in (False, True):
        (tool,) = commented_tools([Comment(1, "T1 | 3/4 BALL ENDMILL | H1")], [], inches=inches).values()
        assert (tool.shape, tool.diameter_mm) == ("ball", 19.05)


def test_a_comment_without_a_number_belongs_to_the_tool_change_after_it():
    comment = Comment(4, "begin operation: TC: Endmill 12 mm")
    assert commented_tools([comment], [(7, 1), (40, 2)], inches=False)[1].diameter_mm == 12.0
    assert commented_tools([comment], [(40, 2)], inches=False) == {}


def test_flutes_are_read_where_they_are_stated():
    tools = commented_tools([Comment(1, "T2 D=10. CR=0. FLUTES=3 - flat end mill")], [], inches=False)
    assert tools[2].flutes == 3


def test_the_first_comment_with_a_diameter_counts():
    comments = [Comment(1, "T1 D=16. - flat end mill"), Comment(9, "T1 finishing, 2 mm of drill depth")]
    assert commented_tools(comments, [], inches=False)[1].diameter_mm == 16.0


def test_the_stock_is_read_from_its_lengths():
    vectric = [Comment(1, " Material Size"), Comment(2, " X= 300.0, Y= 450.0, Z= 19.05")]
    assert stock_size(vectric, inches=False) == (300.0, 450.0, 19.05)
    assert stock_size([Comment(1, "Rohteilmaße: 150 x 75 x 50 mm X/Y/Z")], inches=False) == (150.0, 75.0, 50.0)
    assert stock_size([Comment(1, "X= 300.0, Y= 450.0, Z= 19.05")], inches=False) is None
