"""Comparison by paths: what is missing is judged by how far the path leaves the nominal one, whatever divides it."""

from __future__ import annotations

import json
import math
import re
from functools import partial
from pathlib import Path

import pytest

from tests import commands
from tests.comparison.krl_moves import TURNED, circ, lin
from tests.krl_texts import BASE, HOME, SPEED, TOOL, krl_program
from tests.places import CELL_FILE

pytestmark = pytest.mark.usefixtures("work_folder")

SQUARE = [(0, 0), (40, 0), (40, 30), (0, 30), (0, 0)]
FORCE = ";FORCE FX=-150 FY=120 FZ=200"


def write_program(name, *moves):
    Path(f"{name}.src").write_text(krl_program(SPEED, BASE, TOOL, HOME, "", *moves, name=name))
    return f"{name}.src"


run = partial(commands.printed, cell=CELL_FILE)
comparison = partial(commands.comparison, cell=CELL_FILE)


def unmarked(path):
    """Leave out the line that says where a program comes from: the motions alone tell."""
    text = Path(path).read_text()
    Path(path).write_text(re.sub(r"^;POSTPROC .*\n", "", text, flags=re.M))
    return path


@pytest.mark.parametrize("corner", [1, 2, 3])
@pytest.mark.parametrize("force", ["", FORCE])
def test_a_missing_corner_of_a_square_fails_by_the_distance_of_the_corner(corner, force):
    one = write_program("ONE", force, *(lin(*spot) for spot in SQUARE))
    other = write_program("OTHER", force, *(lin(*spot) for k, spot in enumerate(SQUARE) if k != corner))
    content = comparison(one, other, code=3)
    assert content["only_nominal"] == 1
    (issue,) = [issue for issue in content["issues"] if issue["kind"] == "only-nominal"]
    height = 40.0 * 30.0 / math.hypot(40.0, 30.0)  # of the corner over the diagonal
    told = float(re.search(r"by ([\d.]+) mm", issue["message"])[1])
    # under the force the tip of the program that is not corrected is beside the diagonal
    assert told == pytest.approx(height, abs=0.01 if not force else 1.0)
    assert issue["level"] == "error"
    assert issue["source_line"] == 8 + corner - (1 if not force else 0) + (1 if not force else 0)
    assert any("leaves the nominal one by" in reason for reason in content["verdict"]["reasons"])


def test_a_missing_corner_of_a_corrected_square_fails_too():
    one = write_program("ONE", FORCE, *(lin(*spot) for spot in SQUARE))
    run("convert", one, "-o", "out", code=0)
    path = unmarked("out/ONE.src")
    lines = Path(path).read_text().splitlines(keepends=True)
    corner = [k for k, line in enumerate(lines) if line.startswith("LIN")][2]
    Path(path).write_text("".join([*lines[:corner], *lines[corner + 1 :]]))
    content = comparison(one, path, code=3)
    (issue,) = [issue for issue in content["issues"] if issue["kind"] == "only-nominal"]
    assert float(re.search(r"by ([\d.]+) mm", issue["message"])[1]) == pytest.approx(24.0, abs=0.5)


def test_a_point_of_a_line_or_an_arc_may_be_left_out():
    whole = [lin(0, 0), lin(60, 0), circ((80, 20), (60, 40)), lin(0, 40)]
    half = 20.0 / math.sqrt(2.0)
    divided = [
        lin(0, 0), lin(25, 0), lin(60, 0), circ((60 + half, 20 - half), (80, 20)),
        circ((60 + half, 20 + half), (60, 40)), lin(0, 40),
    ]  # fmt: skip
    content = comparison(write_program("ONE", *divided), write_program("OTHER", *whole))
    assert (content["pairs"], content["only_nominal"], content["verdict"]["state"]) == (4, 0, "ok")
    assert content["passed"] == 2
    assert content["passed_within_mm"] < 0.001
    assert "every target has its partner, or the path passes it" in content["verdict"]["reasons"]
    content = comparison(write_program("ONE", *whole), write_program("OTHER", *divided))
    assert (content["pairs"], content["inserted"], content["only_corrected"]) == (4, 2, 0)
    assert content["verdict"]["state"] == "ok"


@pytest.mark.parametrize(("bulges", "words"), [((0.008,), "1 target"), ((0.003, 0.008), "2 targets")])
def test_targets_that_are_left_out_and_passed_are_stated_with_their_distance(bulges, words):
    """Points of a line that is not quite straight: a line through its ends passes them."""
    points = [(20.0 * k, bulge) for k, bulge in enumerate(bulges, 1)]
    ends = [lin(0, 0), lin(80, 0), lin(80, 40)]
    one, other = (
        write_program("ONE", ends[0], *(lin(*spot) for spot in points), *ends[1:]),
        write_program("OTHER", *ends),
    )
    content = comparison(one, other)
    assert (content["passed"], content["only_nominal"]) == (len(bulges), 0)
    assert content["passed_within_mm"] == pytest.approx(0.008, abs=1e-6)
    is_not, them = ("is not", "it") if len(bulges) == 1 else ("are not", "them")
    sentence = f"{words} of the nominal program {is_not} in the corrected one; its path passes {them} within 0.0080 mm"
    assert sentence in run("compare", one, other, "-o", "found", "--overwrite", code=0)
    page = next(Path("found").glob("*.compare.report.html")).read_text("utf-8")
    assert sentence in page
    assert "times larger" not in page  # only rounding to enlarge


def test_nothing_is_said_of_passed_targets_if_every_target_has_its_partner():
    one, other = (write_program(name, *(lin(*spot) for spot in SQUARE)) for name in ("ONE", "OTHER"))
    content = comparison(one, other)
    assert (content["passed"], content["passed_within_mm"]) == (0, None)
    assert "passes" not in run("compare", one, other, "-o", "found", "--overwrite", code=0)


def test_a_slit_that_is_left_out_fails_though_the_path_stays_on_the_nominal_one():
    moves = [lin(0, 0), lin(40, 0), lin(40, 25), lin(40, 0), lin(80, 0)]
    content = comparison(write_program("ONE", *moves), write_program("OTHER", moves[0], moves[1], moves[4]), code=3)
    (issue,) = [issue for issue in content["issues"] if issue["kind"] == "only-nominal"]
    assert "by 25.0000 mm" in issue["message"]


def test_a_nominal_and_a_corrected_program_of_gcode_belong_together_without_saying_so():
    """The nominal program divides its arcs by their curvature, the corrected one by the force."""
    Path("part.nc").write_text(
        "G90 G21 G17\nF900\nG0 X0 Y0 Z20\n(FORCE FX=-200 FY=150 FZ=90 FRAME=FEED)\nG1 Z-1\nG1 X40\n"
        "G3 X40 Y30 I0 J15\nG2 X40 Y60 I0 J15\nG1 X0\n(FORCE OFF)\nG0 Z20\nM2\n"
    )
    run("convert", "part.nc", "-o", "corrected", code=0)
    run("convert", "part.nc", "--nominal", "-o", "nominal", code=0)
    content = comparison("nominal/part.src", "corrected/part.src")
    assert content["verdict"]["state"] == "ok"
    assert content["provenance"]["made_from_these"]["program"] is True
    offset = json.loads(Path("corrected/part.report.json").read_text())["max_correction_mm"]
    assert content["offset"]["max_mm"] == pytest.approx(offset, rel=0.05)
    content = comparison(unmarked("nominal/part.src"), unmarked("corrected/part.src"))
    assert (content["only_nominal"], content["only_corrected"]) == (0, 0)
    assert content["cut"]["corrected"]["max_mm"] < 0.001
    assert content["between"]["corrected_max_mm"] < 0.01


def test_forces_in_a_file_that_is_not_given_are_asked_for_in_an_ok_verdict():
    one = write_program("ONE", *(lin(*spot) for spot in SQUARE))
    Path("forces.csv").write_text("line,Fx,Fy,Fz,line_end\n7,-250,180,120,12\n")
    run("convert", one, "--forces", "forces.csv", "-o", "out", code=0)
    Path("elsewhere").mkdir()
    Path("forces.csv").rename("elsewhere/forces.csv")
    content = comparison(one, "out/ONE.src")
    assert content["verdict"]["state"] == "ok"
    assert content["offset"]["max_mm"] > 0.1
    assert any("--forces" in reason for reason in content["verdict"]["reasons"])
    assert "force file" not in content["provenance"]["made_from_these"]
    assert comparison(one, "out/ONE.src", "--forces", "elsewhere/forces.csv")["cut"]["corrected"]["max_mm"] < 0.001
    Path("forces.csv").write_text("line,Fx,Fy,Fz,line_end\n7,-100,180,120,12\n")
    content = comparison(one, "out/ONE.src", "--forces", "forces.csv", code=3)
    assert "another force file" in " ".join(content["verdict"]["reasons"])


def test_another_orientation_type_is_reported_but_for_the_one_that_the_correction_needs():
    moves = [lin(*spot) for spot in SQUARE]
    one = write_program("ONE", *moves)
    content = comparison(one, write_program("OTHER", *moves[:2], "$ORI_TYPE=#CONSTANT", *moves[2:]))
    (issue,) = content["issues"]
    assert (issue["kind"], issue["count"]) == ("orientation-type", 3)
    assert "$ORI_TYPE is #CONSTANT instead of #VAR" in issue["message"]
    assert content["verdict"]["state"] == "warning"
    assert content["differences"]["orientation_type"] == 3
    content = comparison("OTHER.src", one)
    assert content["verdict"]["state"] == "ok"


def test_another_turn_of_a_point_to_point_target_is_reported():
    def moves(turn):
        return [lin(0, 0), f"PTP {{X 60,Y 0,Z 30,{TURNED}{turn}}}", lin(80, 0)]

    one = write_program("ONE", *moves(",S 2,T 2"))
    assert comparison(one, write_program("SAME", *moves(",S 2,T 2")))["issues"] == []
    for turn in (",S 2,T 18", ",S 2", ""):
        content = comparison(one, write_program("OTHER", *moves(turn)))
        assert "posture" in {issue["kind"] for issue in content["issues"]}, turn
        assert content["verdict"]["state"] == "warning"
