"""How far two programs are apart between their targets, against formulas and against many places of both paths."""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from tests.commands import invoke, run
from tests.comparison.krl_moves import TURNED, circ, lin
from tests.kr270 import CELL_TEXT
from tests.krl_texts import BASE, HOME, INITMOV, SPEED, TOOL, krl_program
from tests.places import CELL_FILE, SAMPLES

pytestmark = pytest.mark.usefixtures("work_folder")


def write_program(name, *moves, tool="Z 350", at=""):
    """Write a program from (0, 0, 0) on."""
    start = f"LIN {{X 0,Y 0,Z 0,{TURNED}{at}}}"
    head = (INITMOV, SPEED, BASE, TOOL.replace("Z 350", tool), HOME, start)
    Path(f"{name}.src").write_text(krl_program(*head, *moves, name=name))
    return f"{name}.src"


def compared(nominal, corrected, *more, code=None, cell=CELL_TEXT):
    """Return the summary and the rows of the pairs."""
    Path("cell.toml").write_text(cell, encoding="utf-8")
    arguments = ["compare", nominal, corrected, "--cell", "cell.toml", "-o", "found", "--json", "--overwrite", *more]
    done = invoke(*arguments)
    assert done.exit_code in ((0, 3) if code is None else (code,)), done.output
    with Path(f"found/{Path(corrected).stem}.compare.pairs.csv").open(newline="") as file:
        return json.loads(done.output), list(csv.DictReader(file))


def between(rows):
    return [float(row["between_mm"]) if row["between_mm"] else math.nan for row in rows if row["state"] == "pair"]


def kinds(content):
    return {issue["kind"] for issue in content["issues"]}


def test_a_line_instead_of_a_half_circle_is_its_radius_away():
    one = write_program("ONE", circ((20, 20), (40, 0)), lin(60, 0))
    other = write_program("OTHER", lin(40, 0), lin(60, 0))
    content, rows = compared(one, other, code=3)  # by more than the largest permitted correction
    np.testing.assert_allclose(between(rows)[1:], [20.0, 0.0], atol=1e-5)
    assert content["between_targets"] == {
        "max_mm": pytest.approx(20.0, abs=1e-5),
        "nominal_file": "ONE.src",
        "nominal_line": 8,
        "corrected_file": "OTHER.src",
        "corrected_line": 8,
    }
    assert "between" in kinds(content)
    assert content["offset"]["max_mm"] < 1e-9


def test_two_lines_are_farthest_apart_at_an_end():
    one = write_program("ONE", lin(40, 0), lin(80, 0), lin(80, 40))
    other = write_program("OTHER", lin(40, 0.3), lin(80, 0.1), lin(80, 40))
    np.testing.assert_allclose(between(compared(one, other)[1])[1:], [0.3, 0.3, 0.1], atol=1e-6)


def _arc(begin, via, end, share):
    """Points (n, 2) of an arc through three points, at shares of its length, by complex numbers."""
    a, b, c = complex(*begin), complex(*via), complex(*end)
    w = (c - a) / (b - a)
    centre = (b - a) * (w - abs(w) ** 2) / (2j * w.imag) + a
    centre = -centre + 2 * a if abs(abs(centre - a) - abs(centre - c)) > 1e-6 * abs(c - a) else centre
    first, way = a - centre, np.angle((c - centre) / (a - centre)) % (2 * np.pi)
    middle = np.angle((b - centre) / (a - centre)) % (2 * np.pi)
    way = way if middle < way else way - 2 * np.pi
    point = centre + first * np.exp(1j * way * share)
    return np.stack([point.real, point.imag], axis=1)


@pytest.mark.parametrize("seed", range(4))
def test_arcs_that_differ_are_as_far_apart_as_a_hundred_thousand_places_say(seed):
    random = np.random.default_rng(seed)
    end = np.array([50.0, 10.0])
    vias = [
        np.array([25.0, 5.0]) + random.uniform(6.0, 14.0) * np.array([-0.2, 1.0]) + random.uniform(-3, 3, 2)
        for _ in "ab"
    ]
    ends = [end, end + random.uniform(-0.5, 0.5, 2)]
    files = [
        write_program(name, circ(via, to), lin(90, 0))
        for name, via, to in zip(("ONE", "OTHER"), vias, ends, strict=True)
    ]
    share = np.linspace(0.0, 1.0, 100_001)
    paths = [_arc((0, 0), via.round(5), to.round(5), share) for via, to in zip(vias, ends, strict=True)]
    np.testing.assert_allclose(paths[0][-1], ends[0], atol=1e-4)
    wanted = np.linalg.norm(paths[1] - paths[0], axis=1).max()
    assert between(compared(*files)[1])[1] == pytest.approx(wanted, abs=1e-4)


def test_an_arc_divided_by_inserted_targets_is_not_apart():
    points = _arc((0, 0), (20, 20), (40, 0), np.linspace(0, 1, 9))
    one = write_program("ONE", circ((20, 20), (40, 0)), lin(60, 0))
    pieces = [circ(points[k + 1], points[k + 2]) for k in (0, 2, 4, 6)]
    content, rows = compared(one, write_program("OTHER", *pieces, lin(60, 0)))
    assert content["inserted"] == 3
    np.testing.assert_allclose(between(rows)[1:], 0.0, atol=1e-4)
    assert "between" not in kinds(content)
    chords = [lin(*point) for point in points[1:]]
    content, rows = compared(one, write_program("CHORDS", *chords, lin(60, 0)))
    assert content["inserted"] == 7
    assert between(rows)[1] == pytest.approx(20.0 * (1.0 - math.cos(math.pi / 16)), rel=1e-3)


def test_a_missing_line_tells_how_far_the_short_cut_goes():
    moves = [lin(40, 0), lin(40, 30), lin(80, 30), lin(120, 30), lin(120, 60), lin(160, 60)]
    one, other = write_program("ONE", *moves), write_program("OTHER", *moves[:3], *moves[4:])
    content, rows = compared(one, other)
    assert content["only_nominal"] == 1
    told = [value for value in between(rows) if value > 1e-6]
    corner = 40.0 / (40.0 + 30.0)  # of the way
    assert told == [pytest.approx(math.hypot(40.0 - corner * 40.0, corner * 30.0), abs=1e-5)]


def test_a_point_to_point_move_says_nothing_of_the_way():
    ptp = f"PTP {{X 60,Y 0,Z 30,{TURNED},S 2,T 2}}"
    files = [write_program(name, lin(40, 0), ptp, lin(80, 0)) for name in ("ONE", "OTHER")]
    values = between(compared(*files)[1])
    assert [math.isnan(value) for value in values] == [True, False, True, False]


def test_another_tool_length_is_seen_between_targets_too():
    moves = [circ((20, 20), (40, 0)), lin(60, 0)]
    content, rows = compared(write_program("ONE", *moves), write_program("OTHER", *moves, tool="Z 352"))
    assert content["differences"]["tool"] == content["pairs"]
    np.testing.assert_allclose(between(rows)[1:], 2.0, atol=1e-6)


def test_another_approximation_is_told():
    moves = [lin(40, 0) + " C_DIS", lin(40, 30) + " C_DIS", lin(80, 30)]
    one = write_program("ONE", "$APO.CDIS=1", *moves)
    content, _ = compared(one, write_program("OTHER", "$APO.CDIS=5", *moves))
    assert content["differences"]["approximation"] == 2
    assert any("is 5 mm instead of 1 mm" in issue["message"] for issue in content["issues"])
    content, _ = compared(one, write_program("EXACT", "$APO.CDIS=1", moves[0], lin(40, 30), moves[2]))
    (issue,) = [issue for issue in content["issues"] if issue["kind"] == "approximation"]
    assert (issue["source_line"], issue["count"]) == (10, 1)
    assert "is none instead of 1 mm" in issue["message"]
    assert compared(one, one)[0]["issues"] == []


@pytest.mark.parametrize(
    ("distance", "everywhere", "corner"),
    [("20", True, 7.07), ("20", False, 0.113), (None, False, None)],
)
def test_corners_that_approximation_cuts_count_against_gcode(distance, everywhere, corner):
    """Square lines of 40 mm or more, $APO.CDIS = 20: the parabola is 20·√2/4 = 7.07 mm from the corner."""
    Path("pocket.nc").write_bytes((SAMPLES / "pocket.nc").read_bytes())
    cell = str(CELL_FILE)
    assert invoke("convert", "pocket.nc", "-o", ".", cell=cell).exit_code == 0
    lines = Path("pocket.src").read_bytes().decode("cp1252").split("\r\n")
    lines = [line for line in lines if "postproc" not in line]  # without its origin
    if distance is not None:
        lines = [re.sub(r"APO\.CDIS=[0-9.]+", f"APO.CDIS={distance}", line) for line in lines]
    if everywhere:
        lines = [re.sub(r"^(LIN \{[^}]*\})(?! C_DIS)", r"\1 C_DIS", line) for line in lines]
    Path("edited.src").write_bytes("\r\n".join(lines).encode("cp1252"))
    content, _ = compared("pocket.nc", "edited.src", code=None if corner is None else 3)
    found = [issue["message"] for issue in content["issues"] if issue["kind"] == "between"]
    assert len(found) == (corner is not None)
    if corner is not None:
        assert float(re.search(r"by ([\d.]+) mm", found[0])[1]) == pytest.approx(corner, rel=2e-3)


@pytest.mark.parametrize(("distance", "code"), [(4.0, 3), (1.0, 0), (0.02, 0)])
def test_a_corner_cut_by_more_than_the_robot_would_deflect_is_not_to_be_run(distance, code):
    """Under 500 N the robot deflects by 0.5 mm or so; a square corner is cut by √2/4 of the approximation distance."""
    force = ";FORCE FX=-400 FY=250 FZ=150"
    one = write_program("ONE", force, lin(40, 0), lin(40, 30), lin(80, 30))
    convert_in_cell("ONE.src", CELL_TEXT)
    lines = [line for line in Path("out/ONE.src").read_text().splitlines() if not line.startswith(";POSTPROC")]
    number = next(
        n for n, line in enumerate(lines) if line.startswith("LIN") and "X 40" in line and "C_DIS" not in line
    )
    lines[number] += " C_DIS"
    lines.insert(number, f"$APO.CDIS={distance}")
    Path("OTHER.src").write_text("\n".join(lines))
    content, _ = compared(one, "OTHER.src", code=code)
    assert 0.4 < content["cut"]["nominal"]["max_mm"] < 1.0
    corners = [issue for issue in content["issues"] if "cuts the corner" in issue["message"]]
    assert [issue["level"] for issue in corners] == ([] if distance < 0.03 else ["error" if code else "warning"])
    for issue in corners:
        cut = float(re.search(r"by ([\d.]+) mm", issue["message"])[1])
        assert cut == pytest.approx(distance * math.sqrt(2.0) / 4.0, rel=2e-2)


def test_a_corner_that_convert_rounds_is_no_difference_after_another_edit():
    """The robot releases the correction before a stop at an inserted target with the program's own C_DIS."""
    force = ";FORCE FX=-400 FY=250 FZ=150"
    program = write_program("ONE", "$APO.CDIS=0.2", force, f"{lin(40, 0)} C_DIS", "WAIT SEC 1", lin(40, 30))
    convert_in_cell("ONE.src", CELL_TEXT)
    text = Path("out/ONE.src").read_text()
    before_wait = text.split("WAIT SEC 1")[0].splitlines()[-3:]
    assert before_wait[0].endswith("C_DIS")
    assert before_wait[1] == ";FORCE OFF"
    for edit in ("; checked", "$VEL.CP=0.011"):
        Path("OTHER.src").write_text(text.replace("WAIT SEC 1", f"WAIT SEC 1\n{edit}"))
        content, _ = compared(program, "OTHER.src", code=3)
        assert not [issue for issue in content["issues"] if "cuts the corner" in issue["message"]]


CARRIED = CELL_TEXT + "\n[external_axes.E1]\ndirection = [0, 1, 0]\n"


def test_another_place_of_the_axis_that_carries_the_robot_is_told_and_changes_what_is_cut():
    force = ";FORCE FX=-250 FY=180 FZ=120"
    moves = [lin(40, 0, more=",E1 0.0"), lin(40, 30, more=",E1 0.0"), lin(80, 30, more=",E1 0.0")]
    one = write_program("ONE", force, *moves, at=",E1 0.0")
    content, _ = compared(one, one, cell=CARRIED)
    assert content["differences"]["external_axis"] == 0
    same = content["cut"]["nominal"]["max_mm"]
    assert content["cut"]["corrected"]["max_mm"] == pytest.approx(same)
    other = write_program("OTHER", force, *(move.replace("E1 0.0", "E1 250.0") for move in moves), at=",E1 250.0")
    content, rows = compared(one, other, cell=CARRIED)
    assert content["differences"]["external_axis"] == content["pairs"]
    assert any("E1 is at 250.0000 mm instead of 0.0000 mm" in issue["message"] for issue in content["issues"])
    assert content["offset"]["max_mm"] < 1e-9  # the tool goes where it went
    assert 1e-3 < abs(content["cut"]["corrected"]["max_mm"] - same) < 0.5 * same
    np.testing.assert_allclose(between(rows)[1:], 0.0, atol=1e-6)


def test_an_external_axis_that_stands_elsewhere_is_told_without_the_cell_knowing_it():
    moves = [lin(40, 0, more=",E1 100.0,E2 5.0"), lin(40, 30, more=",E1 100.0,E2 5.0")]
    one = write_program("ONE", *moves)
    content, _ = compared(one, write_program("OTHER", *(move.replace("E2 5.0", "E2 7.5") for move in moves)))
    (issue,) = [issue for issue in content["issues"] if issue["kind"] == "external-axis"]
    assert issue["message"] == "E2 is at 7.5 in the corrected program, and at 5 in the nominal one."
    content, _ = compared(one, write_program("LESS", *(move.replace(",E2 5.0", "") for move in moves)))
    (issue,) = [issue for issue in content["issues"] if issue["kind"] == "external-axis"]
    assert "E2 is at 0 or not given in the corrected program" in issue["message"]


def corrected_lines(force, cell):
    """Write nominal.src; return its corrected program, without the line that says what it was made of."""
    at = [f",E1 {60.0 * k}" if cell == CARRIED else "" for k in range(4)]
    arc = circ((100, 80), (140, 40)).removesuffix("}") + at[2] + "}"
    moves = [f";FORCE {force}", lin(60, 40, more=at[1]), arc, lin(140, 20, more=at[3])]
    write_program("nominal", *moves, at=at[0])
    convert_in_cell("nominal.src", cell)
    lines = Path("out/nominal.src").read_text(encoding="utf-8").splitlines()
    return [line for line in lines if not line.startswith(";POSTPROC")]


def outwards(arc, by):
    """Return a line of that arc with its auxiliary point moved away from the centre, (100, 40)."""
    x, y = (float(value) for value in re.search(r"X ([-\d.]+),Y ([-\d.]+)", arc).groups())
    scale = 1.0 + by / math.hypot(x - 100, y - 40)
    moved = f"X {100 + scale * (x - 100):.4f},Y {40 + scale * (y - 40):.4f}"
    return re.sub(r"X [-\d.]+,Y [-\d.]+", moved, arc, count=1)


def convert_in_cell(source, cell):
    Path("cell.toml").write_text(cell, encoding="utf-8")
    run("convert", source, "-o", "out", "--overwrite", cell="cell.toml")


@pytest.mark.parametrize("force", ["FX=-150 FY=100 FZ=120", "FX=-180 FY=90 FZ=60 FRAME=FEED"])
@pytest.mark.parametrize("cell", [CELL_TEXT, CARRIED], ids=["still", "carried"])
def test_a_moved_auxiliary_point_of_a_corrected_arc_is_told(force, cell):
    lines = corrected_lines(force, cell)
    Path("other.src").write_text("\n".join(lines))
    content, _ = compared("nominal.src", "other.src", cell=cell, code=0)
    assert content["issues"] == []
    arcs = [k for k, line in enumerate(lines) if line.startswith("CIRC")]
    for arc, moved in ((arcs[0], 0.1), (arcs[-1], 0.3), (arcs[-1], 1.0)):
        via = outwards(lines[arc], moved)
        Path("other.src").write_text("\n".join([*lines[:arc], via, *lines[arc + 1 :]]))
        content, _ = compared("nominal.src", "other.src", cell=cell, code=3)
        (issue,) = [issue for issue in content["issues"] if issue["kind"] == "between"]
        assert (issue["corrected_file"], issue["corrected_line"]) == ("other.src", arc + 1)
        assert "auxiliary point of its arc" in issue["message"]
        assert content["between"]["corrected_line"] == arc + 1
        assert content["between"]["corrected_max_mm"] > 0.3 * moved


@pytest.mark.parametrize("name", ["pocket", "plate"])
def test_arcs_of_corrected_samples_are_where_they_should_be(name):
    Path(f"{name}.nc").write_bytes((SAMPLES / f"{name}.nc").read_bytes())
    convert_in_cell(f"{name}.nc", CELL_TEXT)
    content, _ = compared(f"{name}.nc", f"out/{name}.src", code=0)
    assert "between" not in kinds(content)
