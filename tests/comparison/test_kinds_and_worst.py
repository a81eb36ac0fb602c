"""What compare tells of the kind of motions, of the worst target, and of a nominal program that is no nominal one."""

from __future__ import annotations

import csv
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests import commands, kr270
from tests.comparison.krl_moves import TURNED, line_of
from tests.oracle.arm import Arm, abc
from tests.places import CELL_FILE

PART = f"""DEF part( )
$BASE={{X 1500,Y -200,Z 700,A 0,B 0,C 0}}
$TOOL={{X 0,Y 0,Z 350,A 0,B 0,C 0}}
$VEL.CP=0.02
$APO.CDIS=0.2
PTP {{A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}}
; FORCE FX=-150 FY=120 FZ=200
LIN {{X 10,Y 10,Z 0,{TURNED}}}
LIN {{X 60,Y 10,Z 0,{TURNED}}} C_DIS
LIN {{X 110,Y 10,Z 0,{TURNED}}}
SPLINE
  SPL {{X 120,Y 15,Z 0,{TURNED}}}
  SPL {{X 130,Y 25,Z 0,{TURNED}}}
  SPL {{X 140,Y 15,Z 0,{TURNED}}}
ENDSPLINE
LIN {{X 150,Y 10,Z 0,{TURNED}}}
CIRC {{X 170,Y 30,Z 0}},{{X 150,Y 50,Z 0,{TURNED}}}
LIN {{X 110,Y 50,Z 0,{TURNED}}}
; FORCE OFF
LIN {{X 110,Y 50,Z 40,{TURNED}}}
END
"""


@pytest.fixture(autouse=True)
def input_files(work_folder):
    Path("nominal").mkdir()
    Path("nominal/part.src").write_text(PART)


run = partial(commands.printed, cell=CELL_FILE, code=(0, 3))


def lines(*options):
    """Correct the program; return its lines without the one that says where it comes from."""
    run("convert", "nominal/part.src", "-o", "out", *options, code=(0,))
    return [line for line in Path("out/part.src").read_text().splitlines() if not line.startswith(";POSTPROC")]


def compared(text):
    Path("edited").mkdir()
    Path("edited/part.src").write_text("\n".join([*text, ""]))
    return commands.comparison("nominal/part.src", "edited/part.src", cell=CELL_FILE, code=(0, 3))


@pytest.mark.parametrize("options", [(), ("--linearize-arcs",)])
def test_motions_as_convert_writes_them_are_of_the_same_kinds(options):
    content = compared(lines(*options))
    assert (content["verdict"]["state"], content["issues"], content["splines"]) == ("ok", [], 3)
    assert "3 SPL" in run("compare", "nominal/part.src", "edited/part.src", "-o", "found")
    assert "3 SPL" in Path("found/part.compare.report.html").read_text(encoding="utf-8")


def test_a_spline_that_became_lines_is_told():
    text = [line.replace("SPL {", "SLIN {") for line in lines() if "SPLINE" not in line]
    content = compared(text)
    (issue,) = content["issues"]
    assert (issue["kind"], issue["count"], content["verdict"]["state"]) == ("kind", 3, "warning")
    assert (issue["source_line"], issue["corrected_line"]) == (
        line_of(PART, "SPL {"),
        line_of("\n".join(text), "SLIN"),
    )
    assert content["splines"] == 0


@pytest.mark.parametrize(("was", "now"), [("SPL {X 1[23]", "SLIN"), ("LIN {X 6", "PTP"), ("LIN {X 6", "CIRC")])
def test_one_motion_of_another_kind_is_told_and_no_other_force(was, now):
    text = lines()
    number = next(k for k, line in enumerate(text) if re.search(was, line))
    word = text[number].split()[0]
    text[number] = text[number].replace(word, now, 1)
    if now == "CIRC":
        text[number] = text[number].replace("{", "{X 35,Y 9,Z 0},{", 1)
    issues = compared(text)["issues"]
    (issue,) = [issue for issue in issues if issue["kind"] == "kind"]
    assert (issue["corrected_line"], issue["count"]) == (number + 1, 1)
    assert "force" not in {issue["kind"] for issue in issues}


PTP_CUTS = [((10, 10), (60, 10)), ((60, 10), (110, 10)), ((150, 50), (110, 50))]
"""Begin and end of lines of PART under force [mm]."""


@pytest.mark.parametrize(("begin", "end"), PTP_CUTS)
@pytest.mark.parametrize("part", [-1, 0])
def test_a_cut_that_became_a_joint_motion_is_not_to_be_run_where_it_leaves_the_path(begin, end, part):
    """Against an arm of its own: joints change in proportion from target to target, and so does the correction.

    :param part: which of the written motions along the line is the PTP, the last or the first one.
    """
    text, source = lines(), PART.splitlines()
    rows = list(csv.DictReader(Path("out/part.targets.csv").read_text().splitlines()))
    nominal_line = next(n for n, line in enumerate(source, 1) if line.startswith(f"LIN {{X {end[0]},Y {end[1]},Z 0,"))
    # the ;POSTPROC line, left out of the text, is above all motions
    number = [int(row["output_line"]) - 2 for row in rows if int(row["source_line"]) == nominal_line][part]
    text[number] = text[number].replace("LIN", "PTP").replace("C_DIS", "").rstrip()
    before = next(line for line in reversed(text[:number]) if line.startswith(("LIN", "CIRC", "SLIN", "  SPL")))
    arm, tool = Arm.load(kr270.FOLDER), abc(0, 0, 350)
    q = np.radians([0.0, -70, 110, 0, 50, 0])
    ends = []
    for line in (before, text[number]):
        values = [float(v) for v in re.findall(r"[XYZABC] (-?[\d.]+)", line.rpartition("{")[2])]
        q = arm.inverse(abc(1500, -200, 700) @ abc(*values), tool, q)
        ends.append(q)
    share = np.linspace(0.0, 1.0, 301)[:, None]
    tip = arm.tcp((1 - share) * ends[0] + share * ends[1], tool)[:, :3, 3] * 1e3 - np.array([1500, -200, 700])

    def off_line(points):
        """Return the ways from the line to points."""
        ways = points - np.array([*begin, 0.0])
        ways[:, 0] -= np.clip(ways[:, 0], *sorted((0, end[0] - begin[0])))
        return ways

    first, last = off_line(tip)[[0, -1]]
    distance = np.linalg.norm(off_line(tip - (1 - share) * first - share * last), axis=1).max()
    content = compared(text)
    found = [issue for issue in content["issues"] if issue["message"].startswith("PTP instead of a cut")]
    assert len(found) == (distance > 0.01)
    assert (content["verdict"]["state"] == "failed") == (distance > 0.01)
    for issue in found:
        assert (issue["level"], issue["source_line"], issue["corrected_line"]) == ("error", nominal_line, number + 1)
        assert float(re.search(r"[\d.]+ mm", issue["message"])[0][:-3]) == pytest.approx(distance, abs=1e-3)


@pytest.mark.parametrize("off", [0.05, 20.0])
def test_the_worst_target_is_named_with_its_lines_in_both_programs(off):
    text = lines()
    number = next(k for k, line in enumerate(text) if "Y 10" not in line and "C_DIS" in line and "X 60" in line)
    z = re.search(r"Z (-?[\d.]+)", text[number])
    text[number] = text[number].replace(z[0], f"Z {float(z[1]) + off:.4f}")
    content = compared(text)
    source = line_of(PART, "X 60")
    where = f"nominal/part.src:{source} and edited/part.src:{number + 1}: "
    told = [reason for reason in content["verdict"]["reasons"] if reason.startswith(where)]
    assert any("under the forces given" in reason for reason in told)
    assert any("max_correction_mm" in reason for reason in told) == (off > 8.0)
    cut = content["cut"]
    assert (cut["nominal_file"], cut["nominal_line"]) == ("nominal/part.src", source)
    assert (cut["corrected_file"], cut["corrected_line"]) == ("edited/part.src", number + 1)
    assert where in run("compare", "nominal/part.src", "edited/part.src", "-o", "found")
    assert where in Path("found/part.compare.report.html").read_text(encoding="utf-8")


def test_a_nominal_program_that_was_corrected_is_refused():
    run("convert", "nominal/part.src", "-o", "out", code=(0,))
    said = run("compare", "out/part.src", "out/part.src", "-o", "found", code=(1,))
    assert "out/part.src:" in said
    assert "was corrected by postproc" in said
    assert "as NOMINAL" in said
    assert not Path("found").exists()
