"""In which file, and on which of its lines, compare says that something is; and what it calls the two programs."""

from __future__ import annotations

import csv
import json
import re
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from postproc.report.comparison import summary
from tests import commands
from tests.comparison.krl_moves import TURNED
from tests.html_page import read_page
from tests.krl_texts import BASE, HOME, INITMOV, SPEED, TOOL, krl_program
from tests.places import CELL_FILE

pytestmark = pytest.mark.usefixtures("work_folder")


HEAD_LINES = (INITMOV, SPEED, BASE, TOOL, HOME)

run = partial(commands.printed, cell=CELL_FILE)
comparison = partial(commands.comparison, cell=CELL_FILE)


def krl(path, count=30):
    lines = [f"LIN {{X {4.0 * n:.3f},Y {n % 5 * 3.0:.3f},Z 0.000,{TURNED}}} C_DIS" for n in range(count)]
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(krl_program(*HEAD_LINES, *lines, name=Path(path).stem))


def moved(path, by=3.0, which=10):
    """Move the target of one line of a file; return that line."""
    lines = Path(path).read_bytes().decode().splitlines(keepends=True)
    number = [k for k, line in enumerate(lines) if line.startswith("LIN")][which]
    lines[number] = re.sub(r"Z (-?[\d.]+)", lambda m: f"Z {float(m[1]) + by:.4f}", lines[number], count=1)
    Path(path).write_bytes("".join(lines).encode())
    return number + 1


def test_programs_of_one_name_are_told_apart_by_their_folders():
    krl("nominal/part.src")
    krl("corrected/part.src")
    line = moved("corrected/part.src")
    content = comparison("nominal/part.src", "corrected/part.src")
    assert (content["nominal"], content["corrected"]) == ("nominal/part.src", "corrected/part.src")
    worst = content["largest"][0]
    assert (worst["nominal_file"], worst["corrected_file"]) == ("nominal/part.src", "corrected/part.src")
    shown = run("compare", "nominal/part.src", "corrected/part.src", "-o", "found")
    assert f"between nominal/part.src:{line} and corrected/part.src:{line}" in shown
    assert "corrected/part.src against nominal/part.src" in shown
    page = read_page(Path("found/part.compare.report.html").read_bytes())
    assert "Line of nominal/part.src" in page.text("worst")
    assert "Line of corrected/part.src" in page.text("worst")
    krl("a/deep/down/part.src")
    krl("b/deep/down/part.src")
    content = comparison("a/deep/down/part.src", "b/deep/down/part.src")
    assert (content["nominal"], content["corrected"]) == ("a/deep/down/part.src", "b/deep/down/part.src")


def test_programs_of_several_names_are_called_by_these():
    krl("nominal/one.src")
    krl("corrected/two.src")
    content = comparison("nominal/one.src", "corrected/two.src")
    assert (content["nominal"], content["corrected"]) == ("one.src", "two.src")
    content = comparison("nominal/one.src", "nominal/one.src")
    assert (content["nominal"], content["corrected"]) == ("one.src", "one.src")


@pytest.fixture
def divided():
    krl("part.src", 60)
    Path("forces.csv").write_text("line,Fx,Fy,Fz,line_end\n8,-250,180,120,66\n")
    run("convert", "part.src", "--forces", "forces.csv", "-o", "out", "--lines-per-file", 20)
    return Path("out")


def test_a_line_of_a_divided_program_is_named_with_its_file_and_its_own_number(divided):
    part = divided / "part3.src"
    line = moved(part, which=4)
    content = comparison("part.src", divided / "partMain.src", "--forces", "forces.csv", code=3)
    assert content["provenance"]["state"] == "changed"
    with Path("found/partMain.compare.pairs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        text = (divided / row["corrected_file"]).read_text().splitlines()[int(row["corrected_line"]) - 1]
        assert text.startswith("LIN")
        assert row["nominal_file"] in ("part.src", "")
    told = json.dumps(content) + " ".join(content["verdict"]["reasons"])
    assert f"part3.src:{line}" in told
    named = re.findall(r"(part\w+\.src):(\d+)", told)
    assert len(named) >= 2
    for name, number in named:
        text = (divided / name).read_text().splitlines()[int(number) - 1]
        assert text.startswith("LIN"), (name, number)
    page = read_page(Path("found/partMain.compare.report.html").read_bytes())
    worst = content["largest"][0]
    assert f"{worst['corrected_file']}:{worst['corrected_line']}" in page.text("worst")


def test_a_line_of_a_subprogram_in_another_file_is_named_with_it():
    for folder in ("one", "two"):
        krl(f"{folder}/cut.src", 12)
        text = Path(f"{folder}/cut.src").read_text()
        Path(f"{folder}/cut.src").write_text("DEF cut( )\n" + text[text.index("LIN") :])
        Path(f"{folder}/job.src").write_text(
            krl_program(*HEAD_LINES, f"LIN {{X 0,Y 0,Z 9,{TURNED}}}", "cut()", name="job")
        )
    line = moved("two/cut.src", which=6)
    content = comparison("one/job.src", "two/job.src")
    worst = content["largest"][0]
    assert (worst["nominal_file"], worst["nominal_line"]) == ("one/cut.src", line)
    assert (worst["corrected_file"], worst["corrected_line"]) == ("two/cut.src", line)


def test_names_with_commas_stay_one_field():
    krl("part.src")
    Path("a,b.src").write_text(Path("part.src").read_text())
    comparison("a,b.src", "part.src")
    with Path("found/part.compare.pairs.csv").open(newline="") as file:
        assert {row["nominal_file"] for row in csv.DictReader(file)} == {"a,b.src"}


def test_a_target_out_of_reach_is_named_with_its_path():
    krl("nominal/part.src")
    krl("corrected/part.src")
    line = moved("corrected/part.src", by=9000.0)
    assert f"corrected/part.src:{line}: out of reach" in run(
        "compare", "nominal/part.src", "corrected/part.src", code=1
    )


def test_a_target_without_a_partner_follows_the_partner_of_the_target_before_it():
    pairing = SimpleNamespace(
        pair=np.array([[0, 0], [1, 2], [2, 4], [4, 9]]),
        inserted_rows=np.array([1, 3, 5, 6, 7, 8]),
        only_nominal=np.array([3]),
        passed_rows=np.array([5]),
        additional_rows=np.array([10]),
    )
    targets = summary._table_targets(pairing)
    rows = [(int(targets.nominal[k]), int(targets.corrected[k])) for k in targets.order]
    assert rows[4:8] == [(2, 4), (3, -1), (-1, 5), (-1, 6)]
    assert rows[-3:] == [(4, 9), (5, -1), (-1, 10)]
