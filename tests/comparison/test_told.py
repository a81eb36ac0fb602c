"""What compare tells of corrected programs that do not say where they come from, held against what predict says."""

from __future__ import annotations

import csv
import json
import re
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from postproc import cell as cells
from postproc import correction, jobs
from postproc.comparison import compare
from tests import commands
from tests.comparison.krl_moves import TURNED
from tests.corrections import read_back
from tests.kr270 import CELL_TEXT, FOLDER
from tests.krl_texts import HEAD
from tests.places import SAMPLES

PROGRAM = (
    HEAD
    + f"""; FORCE FX=-150 FY=100 FZ=120
LIN {{X 0,Y 0,Z 0,{TURNED}}}
LIN {{X 60,Y 0,Z 0,{TURNED}}} C_DIS
; FORCE FX=120 FY=-90 FZ=80
SPLINE
  SPL {{X 70,Y 5,Z 0,{TURNED}}}
  SPL {{X 80,Y 20,Z 0,{TURNED}}}
  SCIRC {{X 90,Y 24,Z 0}},{{X 100,Y 20,Z 0,{TURNED}}}
  SLIN {{X 120,Y 20,Z 0,{TURNED}}}
ENDSPLINE
LIN {{X 140,Y 20,Z 0,{TURNED}}}
PTP {{X 140,Y 20,Z 60,{TURNED},S 2,T 2}}
PTP {{A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}}
END
"""
)


@pytest.fixture(autouse=True)
def input_files(work_folder):
    Path("cell.toml").write_text(CELL_TEXT, encoding="utf-8")
    Path("part.src").write_text(PROGRAM)


run = partial(commands.printed, cell="cell.toml", code=(0, 3))
comparison = partial(commands.comparison, cell="cell.toml", code=(0, 3))


def corrected_text():
    """Correct the program; return its text without the line that says where it comes from."""
    run("convert", "part.src", "-o", "out", code=(0,))
    return re.sub(r"^;POSTPROC .*\n", "", Path("out/part.src").read_text(), flags=re.MULTILINE)


def edited(text, before, after):
    new = re.sub(before, after, text, count=1, flags=re.MULTILINE)
    assert new != text
    Path("edited.src").write_text(new.replace("DEF part", "DEF edited"))
    return comparison("part.src", "edited.src")


def kinds(content):
    return {issue["kind"] for issue in content["issues"]}


def test_the_corrected_program_belongs_to_its_nominal_one():
    content = edited(corrected_text(), "^END$", "END ")
    assert (content["verdict"]["state"], content["issues"]) == ("ok", [])


@pytest.mark.parametrize("with_forces", [True, False])
@pytest.mark.parametrize("what", ["point of a spline", "auxiliary point in a spline"])
def test_a_spline_block_that_was_edited_is_told(what, with_forces):
    if not with_forces:
        Path("part.src").write_text(re.sub(r"; FORCE.*\n", "", PROGRAM))
    text = corrected_text()
    if what == "point of a spline":
        point = next(line for line in text.splitlines() if line.lstrip().startswith("SPL {"))
    else:
        point = next(line for line in text.splitlines() if line.lstrip().startswith("SCIRC"))
    moved = re.sub(r"Y (-?[\d.]+)", lambda m: f"Y {float(m[1]) + 0.2:.4f}", point, count=1)
    content = edited(text, re.escape(point), moved)
    assert content["verdict"]["state"] != "ok"
    line = 1 + Path("edited.src").read_text().splitlines().index(moved)
    assert f"edited.src:{line}" in json.dumps(content["issues"]) + json.dumps(
        [f"{pair['corrected_file']}:{pair['corrected_line']}" for pair in content["largest"]]
    ) + json.dumps(content["verdict"])


@pytest.mark.parametrize(("before", "after"), [("FX=-150", "FX=150"), ("FY=-90", "FY=-91"), ("FZ=80", "FZ=120")])
def test_a_force_comment_that_was_changed_is_told_with_its_line(before, after):
    written = corrected_text()
    name = before.split("=")[0]
    old = re.search(rf"{name}={float(before.split('=')[1]):g}(?:\.0*)?\b", written)
    assert old is not None, written
    content = edited(written, re.escape(old[0]), after)
    (issue,) = [issue for issue in content["issues"] if issue["kind"] == "force"]
    assert issue["corrected_line"] is not None
    assert content["verdict"]["state"] == "warning"


PLANTED = {
    "posture": (r"S 2,T", "S 6,T"),
    "axis-target": (r"A3 110(?![\s\S]*A3 110)", "A3 111"),
    "orientation": (r"(?<=LIN \{X 60\.)(.*)A -?1[78]\d\.\d*", r"\1A 179.5"),
    "rapid": (r"(PTP \{X 1\d\d[.\d]*),Y ", r"\1,Y 1"),
    "twice": (r"^(LIN \{X 60\.[^\n]*\n)", r"\1\1"),
}


@pytest.mark.parametrize("kind", PLANTED)
def test_what_no_cutting_position_shows_is_told(kind):
    content = edited(corrected_text(), *PLANTED[kind])
    assert kind in kinds(content), content["issues"]
    assert content["verdict"]["state"] != "ok"


GEOMETRY = """
[geometry.A3]
X_mm = 0.4
Z_mm = -0.3
RY_deg = 0.02
source = "made up"
"""


@pytest.fixture(params=["nominal geometry", "calibrated geometry"])
def robot(request, tmp_path):
    if request.param == "calibrated geometry":
        shutil.copytree(FOLDER, tmp_path / "model")
        with (tmp_path / "model/model.toml").open("a", encoding="utf-8") as file:
            file.write(GEOMETRY)
        Path("cell.toml").write_text(CELL_TEXT.replace('"kuka_kr270"', '"model"'), encoding="utf-8")
    cell = cells.load("cell.toml")
    return cell, jobs.load_robot(cell.robot, cell.folder)


@pytest.mark.parametrize("name", ["pocket.nc", "inline.src"])
def test_what_each_would_cut_is_what_predict_and_convert_say(robot, name):
    cell, model = robot
    nominal = jobs.read_program(SAMPLES / name, model, cell)
    made = correction.process(nominal, model, cell)
    predicted = correction.process(nominal, model, cell, mode="predict")
    written = read_back(made, cell, model)
    as_written = correction.process(written, model, cell, mode="predict")
    found = compare(nominal, written, model, cell)
    ends = predicted.t == 1.0
    assert len(found.pair) == int(ends.sum())
    np.testing.assert_allclose(np.linalg.norm(found.cuts.nominal, axis=1), predicted.before[ends], atol=1e-9)
    np.testing.assert_allclose(
        np.linalg.norm(found.cuts.corrected_deviation, axis=1), made.after[made.t == 1.0], atol=1e-9
    )
    inserted = found.cuts.t == 1.0
    assert inserted.sum() == (made.t < 1.0).sum() > 0
    settled = made.before[made.t < 1.0]
    np.testing.assert_allclose(found.cuts.nominal_distance[inserted], settled, atol=2e-6)
    np.testing.assert_allclose(found.cuts.corrected_distance[inserted], made.after[made.t < 1.0], atol=2e-6)
    ends = as_written.t == 1.0
    tip = as_written.nominal[ends, :3, 3] + as_written.deviation_before[ends]
    np.testing.assert_allclose(tip, made.nominal[:, :3, 3] + made.deviation_after, atol=2e-6)


def test_the_row_between_counts_a_calibrated_geometry():
    shutil.copytree(FOLDER, "model")
    with Path("model/model.toml").open("a", encoding="utf-8") as file:
        file.write(GEOMETRY)
    Path("cell.toml").write_text(CELL_TEXT.replace('"kuka_kr270"', '"model"'), encoding="utf-8")
    run("convert", str(SAMPLES / "inline.src"), "-o", "out")
    content = comparison(SAMPLES / "inline.src", "out/inline.src")
    with Path("out/inline.targets.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if float(row["t"]) < 1.0 and row["rapid"] == "0"]
    largest = max(float(row["before_mm"]) for row in rows)
    assert content["between"]["nominal_max_mm"] > 0.999 * largest > 0.3


def test_a_program_corrected_for_a_process_is_compared_under_its_forces():
    nominal, process = (str(SAMPLES / name) for name in ("plate.nc", "plate.process.toml"))
    run("convert", nominal, "--process", process, "-o", "out")
    arguments = ("compare", nominal, "out/plate.src", "--forces", process, "-o", "found", "--json")
    content = json.loads(run(*arguments, code=(0,)))
    assert content["verdict"]["state"] == "ok"
    assert content["provenance"]["made_from_these"]["force file"] is True
    assert content["cut"]["corrected"]["max_mm"] < 0.001 < 0.1 < content["cut"]["nominal"]["max_mm"]
