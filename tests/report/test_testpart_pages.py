"""Page and lines of a chosen test part, and of a model that was identified from one: numbers, sentences, drawing."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.cell import Box
from postproc.identification.record import Parameter
from postproc.report.testpart import agreement_lines, design_lines, design_page, part_lines, part_page
from postproc.testpart import features
from postproc.testpart.design import Candidates, Design
from postproc.testpart.features import Cutting, Feature, FirstNumbers, Kind, Placement
from postproc.testpart.model import Agreement, PartIdentification, ProbedPoint, TouchOffError
from tests.html_page import read_page
from tests.testpart.test_tables_and_surfaces import motions_of

CUTTING = Cutting(diameter=0.01, rpm=3000.0, feed=0.012, tool=1, top=0.0)
BOX = Box(X=(10.0, 210.0), Y=(-20.0, 130.0), Z=(-40.0, 0.0))
FEATURES = (
    Feature(Kind(0.003, 1), 0.060, 0.030, 0.3), Feature(Kind(0.0055, 0), 0.150, 0.080, -2.0),
    Feature(Kind(0.004, -1), 0.070, 0.090, 1.1),
)  # fmt: skip
TOUCHES = np.array([[0.02, -0.01, 0.0], [0.2, -0.0125, 0.0], [0.11, 0.12, 0.0]])
BASE, SECOND = Placement(), Placement("2")
PARAMETERS = tuple(SimpleNamespace(name=f"k{n}", title=f"compliance of joint {n}") for n in range(1, 5))
PRIOR = SimpleNamespace(
    parameters=PARAMETERS, values=np.array([2.0, -5.0, 0.0, 8.0]), sigma=np.array([0.5, 1.0, 0.3, 0.8, 0.24])
)


def programs(count=1, mass=0.0):
    """The features in one placement of the block, or the last one in another."""
    hung = features.hanging_places(np.array([0.01, -0.02, -0.04]), np.array([0.21, 0.13, 0.0]), 0.0) if mass else None
    if count == 1:
        return {BASE: features.program(FEATURES, CUTTING, mass, hung, touches=TOUCHES)}
    first = features.program(FEATURES[:2], CUTTING, touches=TOUCHES)
    second = features.program(FEATURES[2:], CUTTING, mass, hung, touches=TOUCHES[:2], first=FirstNumbers(3, 1, 4))
    return {BASE: first, SECOND: second}


def design(**changes):
    none = np.zeros(0)
    candidates = Candidates(
        (FEATURES[2], FEATURES[0], FEATURES[1]), none, none, none, none, 1e-3 * np.array([0.5, 0.1, 0.3]), None
    )
    values = {
        "chosen": np.array([1, 2, 0]), "sigma": np.array([0.5, 0.9, 0.95, 0.2, 0.7]), "sigma_without_weight": None,
        "change": np.array([0.25, 0.45, 1.0, 0.305]), "before": 0.2468e-3, "after": 0.1234e-3, "deflection": 1.2345e-3,
        "seconds": 333.0, "tests": "the whole block",
    }  # fmt: skip
    return Design(candidates, **(values | changes))


def page_of(parts, **changes):
    content = design_page(design(**changes), PRIOR, CUTTING, parts, BOX, "kuka_kr270")
    return content.decode(), read_page(content)


def rows_of(html, section):
    """Cells of each row of the table of a section."""
    table = re.search(rf'<section id="{section}".*?</section>', html, re.DOTALL).group()
    cells = [
        re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL) for row in re.findall(r"<tr.*?</tr>", table, re.DOTALL)
    ]
    return [[re.sub(r"<[^>]*>|\s+", " ", cell).strip() for cell in row] for row in cells]


def test_the_page_of_a_part_has_its_size_errors_and_features():
    html, read = page_of(programs())
    assert "kuka_kr270, tool 10 mm, 3000 1/min, 720 mm/min" in read.text()
    probed = len(programs()[BASE].feature)
    tiles = read.text("numbers")
    for text in ("Features 3", f"Probed points {probed}", "Cutting time 5.5 min", "Expected error now, RMS 0.247 mm",
                 "Expected error with the part, RMS 0.123 mm", "deflection 1.23 mm: the whole block"):  # fmt: skip
        assert text in tiles
    head, *rows = rows_of(html, "features")
    assert head == ["feature", "kind", "depth, mm", "X, mm", "Y, mm", "direction, °", "deflection, mm"]
    assert rows == [
        ["F01", "step, down-milling", "3", "60.0", "30.0", "17", "0.100"],
        ["F02", "groove", "5.5", "150.0", "80.0", "-115", "0.300"],
        ["F03", "step, up-milling", "4", "70.0", "90.0", "63", "0.500"],
    ]
    head, *rows = rows_of(page_of(programs(2))[0], "features")
    assert head[:3] == ["feature", "block at", "kind"]
    assert [row[:3] for row in rows] == [
        ["F01", "[base]", "step, down-milling"], ["F02", "[base]", "groove"],
        ["F03", "[base_data.2]", "step, up-milling"],
    ]  # fmt: skip


def test_a_parameter_that_a_part_does_not_show_is_named():
    """Standard deviations in per cent of the value, now and with the part; changes beyond 100 % are not seen."""
    html, read = page_of(programs())
    head, *rows = rows_of(html, "parameters")
    assert head == ["parameter", "now, σ %", "with the part, σ %", "change seen later, %", ""]
    hidden = "value not shown by this part"
    assert rows == [
        ["compliance of joint 1", "25", "12", "25", ""], ["compliance of joint 2", "20", "18", "45", ""],
        ["compliance of joint 3", "-", "-", "not seen", hidden],
        ["compliance of joint 4", "10", "2", "30", ""], ["scale of the forces", "24", "17", "", ""],
    ]  # fmt: skip
    remarks = read.text("parameters")
    assert "A change of 30 % from one part to the next would not be seen for sure in k2 (45 %), k4 (30 %): " in remarks
    assert "the weight on the tool leaves" not in remarks
    seen = page_of(programs(), change=np.array([0.3, 0.3, 1.0, 0.1]))[1].text("parameters")
    assert "would not be seen" not in seen
    never = page_of(programs(), change=np.array([1.0, 0.3, 0.1, 0.1]))[1].text("parameters")
    assert "would not be seen for sure in k1: " in never
    weighted = page_of(programs(mass=60.0), sigma_without_weight=np.array([0.6, 0.9, 0.95, 0.3, 0.85]))[1].text(
        "parameters"
    )
    leaves = "the weight on the tool leaves 70 % of the standard deviation of the forces; without it 85 % would be left"
    assert f"Here {leaves}." in weighted


def test_the_steps_name_block_touch_off_points_programs_and_weight():
    steps = page_of(programs())[1].text("steps")
    assert "Clamp a block of X 10 … 210, Y -20 … 130, Z -40 … 0 mm in $BASE." in steps
    assert "at T01 X20 Y-10, T02 X200 Y-12.5, T03 X110 Y120: it is at Z 0 of $BASE" in steps
    assert "Cut testpart.src, or testpart.nc by your own post: uncorrected" in steps
    assert "--program testpart.nc -o MODEL" in steps
    assert "M0" not in steps
    two = page_of(programs(2, mass=62.5))[1].text("steps")
    assert "With the block at [base] of the cell cut testpart.src, or testpart.nc by your own post: uncorrected" in two
    assert "With the block at [base_data.2] of the cell cut testpart_2.src, or testpart_2.nc by your own post" in two
    assert "--program testpart.nc testpart_2.nc -o MODEL" in two
    assert "hang 62.5 kg on the tool" in two
    idle = {BASE: features.program((), CUTTING), SECOND: programs()[BASE]}
    third = page_of(idle)[1].text("steps")
    assert "Nothing is cut with the block at [base]: the same time shows more elsewhere." in third
    assert "--program testpart_2.nc -o MODEL" in third
    assert "at T01 X20 Y-10, " in third


SCALE = 900.0 / 200.0
"""Of the drawing [px/mm]: the block is as wide as the drawing."""


def in_base(x, y):
    """X and Y in `$BASE` [m] of a place of the drawing [px], whose Y is down from the upper edge of the block."""
    return 1e-3 * np.array([10.0 + float(x) / SCALE, 130.0 - float(y) / SCALE])


def distances(points, begin, end):
    along = np.clip((points - begin) @ (end - begin) / ((end - begin) @ (end - begin)), 0.0, 1.0)
    return np.linalg.norm(points - begin - along[:, None] * (end - begin), axis=1)


PIXEL = 1e-3 * 0.1 / SCALE
"""Size of a tenth of a pixel on the block [m]."""


def test_the_drawing_shows_the_area_that_the_tool_covers_on_each_pass():
    """By the moves of the program that make the probed points: an outline is a radius from its move all around it."""
    (part,) = programs().values()
    moves = motions_of(part.text)
    svg = re.search(r"<svg.*?</svg>", page_of(programs())[0], re.DOTALL).group()
    outlines = [
        (
            np.array(
                [in_base(*place.split(",")) if "," in place else in_base(*place.split()) for place in line.split(" L")]
            ),
            style,
        )
        for line, style in re.findall(r'<path d="M([^"]*)Z" ([^>]*)/>', svg)
    ]
    numbers = sorted({line for line in part.line.tolist() if line})
    assert len(outlines) == len(numbers)
    for number in numbers:
        begin, end = (place[:2] for place in moves[number][:2])
        errors = [np.abs(distances(points, begin, end) - 0.005).max() for points, _ in outlines]
        points, style = outlines[int(np.argmin(errors))]
        assert min(errors) < PIXEL
        direction = (end - begin) / np.linalg.norm(end - begin)
        assert np.ptp(points @ direction) == pytest.approx(np.linalg.norm(end - begin) + 0.01, abs=3 * PIXEL)
        assert len(points) == 50
        surface = {part.feature[k].partition(".")[2] for k in np.flatnonzero(part.line == number)}
        assert ("stroke-dasharray" in style) == any(name.startswith("ref_") for name in surface)
        assert ("fill-opacity" in style) != ("stroke-dasharray" in style)


def test_the_drawing_has_all_probed_points_touch_off_points_numbers_and_edges():
    (part,) = programs().values()
    svg = re.search(r"<svg.*?</svg>", page_of(programs())[0], re.DOTALL).group()
    assert 'viewBox="-60 -8 970 709"' in svg
    assert '<rect x="0" y="0" width="900" height="675" fill="none"' in svg
    drawn = re.findall(r'<circle cx="([^"]*)" cy="([^"]*)" r="3" fill="(\w+)"', svg)
    is_probed = [not name.endswith((".top", ".gauge")) for name in part.feature]
    assert len(drawn) == sum(is_probed)
    for (x, y, fill), point, name in zip(drawn, part.point[is_probed], np.array(part.feature)[is_probed], strict=True):
        np.testing.assert_allclose(in_base(x, y), point[:2], atol=PIXEL)
        assert fill == ("none" if ".ref_" in name else "currentColor")
    crosses = re.findall(r'<path d="M([\d.]+) ([\d.]+)H([\d.]+)M([\d.]+) ([\d.]+)V([\d.]+)"', svg)
    for cross, touch in zip(crosses, TOUCHES, strict=True):
        left, level, right, middle, top, bottom = map(float, cross)
        np.testing.assert_allclose(in_base(middle, level), touch[:2], atol=PIXEL)
        np.testing.assert_allclose([middle - left, right - middle, level - top, bottom - level], 6.0, atol=0.11)
    texts = [
        (text, np.array([x, y], dtype=float))
        for x, y, text in re.findall(r'<text x="([^"]*)" y="([^"]*)"[^>]*>([^<]*)</text>', svg)
    ]
    assert [text for text, _ in texts] == [
        "F01 · 3", "F02 · 5.5", "F03 · 4", "T01", "T02", "T03", "X 10", "X 210", "Y -20", "Y 130",
    ]  # fmt: skip
    for (_, place), feature in zip(texts, FEATURES, strict=False):  # the text is 15 px high: centred on the middle
        np.testing.assert_allclose(in_base(place[0], place[1] - 5.0), [feature.x, feature.y], atol=PIXEL)
    for (_, place), touch in zip(texts[3:6], TOUCHES, strict=True):  # above the cross
        np.testing.assert_allclose(in_base(place[0], place[1] + 9.0), touch[:2], atol=PIXEL)
    corners = [place.tolist() for _, place in texts[6:]]
    assert [x for x, _ in corners[:2]] == [0.0, 900.0]
    assert all(675.0 < y < 701.0 for _, y in corners[:2])
    assert all(-60.0 < x < 0.0 for x, _ in corners[2:])
    assert corners[2][1] == 675.0
    assert 0.0 < corners[3][1] < 20.0


def test_each_placement_of_the_block_has_its_drawing_with_the_others_features_faint():
    html, read = page_of(programs(2))
    drawings = re.findall(r"<svg.*?</svg>", html, re.DOTALL)
    assert len(drawings) == 2
    shown = [re.findall(r">(F\d\d) ·", svg) for svg in drawings]
    assert shown == [["F01", "F02"], ["F03"]]
    assert [re.findall(r">(T\d\d)<", svg) for svg in drawings] == [["T01", "T02", "T03"], ["T04", "T05"]]
    # a step has passes for the groove, the step and two trims; a groove one less
    assert [svg.count('stroke-opacity="0.15"') for svg in drawings] == [4, 7]
    assert "Block at [base], testpart.nc. Seen from the spindle." in read.text("drawing")
    assert "Block at [base_data.2], testpart_2.nc. Seen from the spindle." in read.text("drawing")
    assert "Block at" not in page_of(programs())[1].text("drawing")
    idle = {BASE: features.program((), CUTTING), SECOND: programs()[BASE]}
    assert page_of(idle)[0].count("<svg ") == 1


def test_lines_of_a_chosen_part_say_what_it_shows():
    assert design_lines(design(), PRIOR, CUTTING, programs()) == [
        "3 features, 5.5 min of cutting, full cuts at 720 mm/min",
        "expected error where you mill (the whole block): 0.247 mm now, 0.123 mm with the part, of 1.23 mm deflection "
        "(RMS)",
        "standard deviations left: k1 50 %, k2 90 %, k4 20 %, forces 70 % of those now",
        "not shown by this part: k3",
        "a change of 30 % from one part to the next would not be seen for sure in k2 (45 %), k4 (30 %): cutting forces "
        "load them little here. A weight on the tool (--weight), the block higher and further away (--placement), or "
        "more depth shows more",
    ]
    sharp = design(
        sigma=np.array([0.5, 0.9, 0.9, 0.2, 0.7]), change=np.full(4, 0.3), sigma_without_weight=np.full(5, 0.86)
    )
    lines = design_lines(sharp, PRIOR, CUTTING, programs(2))
    assert lines[1] == "block at [base]: 2, [base_data.2]: 1"
    assert lines[3:] == [
        "standard deviations left: k1 50 %, k2 90 %, k3 90 %, k4 20 %, forces 70 % of those now",
        "the weight on the tool leaves 70 % of the standard deviation of the forces; without it 86 % would be left",
    ]


POINTS = [
    ProbedPoint(f"F0{n}.left", 0.1 * n, 0.05 * n, 0.09 * n, 0.001 * n * (-1) ** n, 0.002 + 0.001 * n)
    for n in range(1, 5)
]
IDENTIFIED = PartIdentification(
    verdict=SimpleNamespace(line="usable: all well", refused=False), robot="kuka_kr270",
    parameters={
        "k1": Parameter(2.5, 0.25, "µrad/(N·m)", True, prior=2.0), "k2": Parameter(-3.0, 0.6, "mm", True, prior=-4.0),
        "k3": Parameter(7.0, 0.5, "µrad/(N·m)", False, prior=7.0, source="prior"),
        "k4": Parameter(1.0, 0.5, "1", True, prior=0.0),
    },
    force_scale=Parameter(1.2345, 0.0567, "1", True, prior=1.0), sigma_mm=0.0042, left_mm=0.0051, without_mm=0.0321,
    deviation_mm=0.1234, unmodelled_percent=1.26, discrepancy=[],
    touch_off=[TouchOffError("[base]", -0.0347, 0.0123, 0.5, ["T01", "T02", "T03"])], points=POINTS, held_by_prior=[],
    outliers=[], warnings=["the tool is worn"],
)  # fmt: skip


def test_lines_of_an_identified_part_have_values_with_their_intervals():
    lines = part_lines(IDENTIFIED)
    assert lines == [
        "usable: all well", "k1 2.5 ± 0.25 µrad/(N·m) (was 2)", "k2 -3 ± 0.6 mm (was -4)",
        "k3 7 µrad/(N·m) (prior, not determined by the part)", "k4 1 ± 0.5 1 (was 0)",
        "forces 1.234 ± 0.057 times those computed",
        "deviations 0.1234 mm RMS; the model before leaves 0.0321, this one 0.0051; probe 0.0042",
        "unmodelled error 1.3 % of the deflection",
        "the program ran 0.035 ± 0.012 mm below its height over the uncut top",
    ]  # fmt: skip
    unknown = replace(IDENTIFIED, parameters={
        "k1": Parameter(None, 0.25, "mm", True, prior=2.0), "k2": Parameter(1.0, None, "mm", True, prior=2.0),
        "k3": Parameter(1.0, 0.25, "mm", True),
    }, touch_off=[
        TouchOffError("[base]", 0.0, 0.1, 0.5, []), TouchOffError("[base_data.2]", 0.25, 0.1, 0.5, []),
    ])  # fmt: skip
    assert [line for line in part_lines(unknown) if line.startswith("k")] == []
    assert part_lines(unknown)[-2:] == [
        "the program ran 0.000 ± 0.1 mm above its height over the uncut top at [base]",
        "the program ran 0.250 ± 0.1 mm above its height over the uncut top at [base_data.2]",
    ]


@pytest.mark.parametrize(
    ("holds", "fault", "first"),
    [
        (True, "", "the model holds: as it was"), (False, "", "THE MODEL DOES NOT HOLD: as it was"),
        (True, "blunt tool", "NOT DECIDED: blunt tool"), (False, "blunt tool", "NOT DECIDED: blunt tool"),
    ],
)  # fmt: skip
def test_agreement_is_said_unless_the_part_has_a_fault(holds, fault, first):
    agreement = Agreement(holds, fault, "as it was", 1.0, 4, 0.5, [], [])
    assert agreement_lines(IDENTIFIED, agreement) == [
        first, "deviations 0.1234 mm RMS, of which the model leaves 0.0321; probe 0.0042",
    ]  # fmt: skip


def test_the_page_of_an_identified_part_has_tiles_plots_and_tables():
    content = part_page(IDENTIFIED, "model-a")
    html, read = content.decode(), read_page(content)
    assert "model-a" in read.text()
    assert "4 probed points" in read.text()
    for text in ("Usable usable: all well", "Deviations, RMS 0.123 mm", "Left by the model before 0.0321 mm",
                 "Left by this model 0.0051 mm noise of the probe 0.0042 mm", "Forces over those computed 1.234",
                 "± 0.057", "Unmodelled error 1.3 % of the deflection", "Program over the block -0.035 mm",
                 "± 0.012 by 3 touch-off points, [base]"):  # fmt: skip
        assert text in read.text("verdict")
    assert "the tool is worn." in read.text("issues")
    head, *rows = rows_of(html, "parameters")
    assert head == ["parameter", "value", "± 95 %", "unit", "before", "from"]
    assert rows == [
        ["k1", "2.5", "0.25", "µrad/(N·m)", "2", "part"], ["k2", "-3", "0.6", "mm", "-4", "part"],
        ["k3", "7", "0.5", "µrad/(N·m)", "7", "prior"], ["k4", "1", "0.5", "", "0", "part"],
        ["scale of the forces", "1.234", "0.057", "", "1", "part"],
    ]  # fmt: skip
    assert rows_of(html, "points")[1:] == [
        [f"F0{n}.left", f"{0.1 * n:.4f}", f"{0.05 * n:.4f}", f"{0.09 * n:.4f}", f"{0.001 * n * (-1) ** n:.4f}",
         f"{0.002 + 0.001 * n:.4f}"]
        for n in range(1, 5)
    ]  # fmt: skip
    predictions, errors, changes = read.plots
    line, before, after = predictions["traces"]
    assert line["x"] == line["y"] == [0.1, 0.4]
    for trace, factor in ((before, 0.05), (after, 0.09)):
        assert trace["x"] == pytest.approx([factor * n for n in range(1, 5)])
        assert trace["y"] == pytest.approx([0.1 * n for n in range(1, 5)])
        assert trace["texts"] == [f"F0{n}.left" for n in range(1, 5)]
    assert (before["hollow"], after.get("hollow", False)) == (True, False)
    (error,) = errors["traces"]  # in micrometres, with 1.96 standard deviations
    assert error["x"] == [0.0, 1.0, 2.0, 3.0]
    assert error["y"] == pytest.approx([-1.0, 2.0, -3.0, 4.0])
    assert error["half"] == pytest.approx([5.88, 7.84, 9.8, 11.76])
    (change,) = changes["traces"]  # in per cent of the values before
    assert changes["y"]["categories"] == change["texts"] == ["k1", "k2", "k3", "forces"]
    assert change["x"] == pytest.approx([25.0, -25.0, 0.0, 23.45])
    assert change["half"] == pytest.approx([12.5, 15.0, 100 * 0.5 / 7.0, 5.67])
    assert change["across"] is True
    refused = part_page(replace(IDENTIFIED, verdict=SimpleNamespace(line="refused: no", refused=True)), "model-a")
    assert "Refused refused: no" in read_page(refused).text("verdict")
