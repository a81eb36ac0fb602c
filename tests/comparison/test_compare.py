"""`postproc compare` on pairs of programs with a difference planted."""

from __future__ import annotations

import csv
import json
import math
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests import commands
from tests.comparison.krl_moves import line_of
from tests.html_page import read_page
from tests.places import CELL_FILE

GCODE = """G21 G90 G17
(ROUGHING)
G0 X0 Y0 Z20
(FORCE FX=-250 FY=180 FZ=120)
G1 Z-2 F600
X40 F1500
X40 Y30
G3 X30 Y40 I-10 J0
G1 X0
(FORCE FX=-90 FY=60 FZ=40)
(FINISHING)
G1 X0 Y0
X25 Y12
X40 Y0
(FORCE OFF)
G0 Z30
M30
"""
_PIECES = np.array([22.0, 40.0, 30.0, 5.0 * math.pi, 30.0, 40.0, math.hypot(25.0, 12.0), math.hypot(15.0, 12.0)])
_HALVES = np.array([0.0, 0.5, 0.5, 0.5, 0.5, 0.0, 0.5, 0.5]) * _PIECES
_CUT_LENGTHS = _PIECES - _HALVES + np.append(_HALVES[1:], 0.0)
"""Length of the cut for which each end stands [mm]: the first and the sixth begin with another force than before."""
OTHERS = """DEF OTHER( )
BAS (#INITMOV,0 )
$VEL.CP = 0.05
$BASE = {X 1500,Y -200,Z 700,A 0,B 0,C 0}
$TOOL = {X 0,Y 0,Z 350,A 0,B 0,C 0}
PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}
LIN {X 0.000,Y 0.000,Z 5.000,A 180.000,B 0.000,C 180.000} C_DIS
LIN {X 0.000,Y 0.000,Z -2.000,A 180.000,B 0.000,C 180.000} C_DIS
LIN {X 40.000,Y 0.000,Z -2.000,A 180.000,B 0.000,C 180.000} C_DIS
LIN {X 40.000,Y 30.000,Z -2.000,A 180.000,B 0.000,C 180.000} C_DIS
LIN {X 20.000,Y 35.000,Z -2.000,A 180.000,B 0.000,C 180.000} C_DIS
LIN {X 0.000,Y 30.000,Z -2.000,A 180.000,B 0.000,C 180.000} C_DIS
LIN {X 0.000,Y 30.000,Z 20.000,A 180.000,B 0.000,C 180.000}
END
"""
"""A program of another post-processor: no comment of ours, no forces."""


@pytest.fixture(autouse=True)
def input_files(work_folder):
    Path("part.nc").write_text(GCODE)
    Path("other.src").write_text(OTHERS)


run = partial(commands.printed, cell=CELL_FILE)


def corrected_text():
    commands.convert()
    return Path("out/part.src").read_bytes().decode()


def edited(text, before, after, count=1):
    assert before in text
    Path("out/edited.src").write_bytes(text.replace(before, after, count).replace("DEF part", "DEF edited").encode())
    return "out/edited.src"


def compare(nominal, corrected, *more, code=0):
    return json.loads(run("compare", nominal, corrected, "-o", "found", "--json", *more, code=code))


def targets():
    with Path("out/part.targets.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_corrected_program_against_its_gcode_is_what_convert_said_of_it():
    corrected_text()
    content = compare("part.nc", "out/part.src")
    said = json.loads(Path("out/part.report.json").read_text())
    rows = targets()
    assert (content["pairs"], content["inserted"]) == (len(rows) - said["inserted_targets"], said["inserted_targets"])
    assert (content["only_nominal"], content["only_corrected"]) == (0, 0)
    assert content["provenance"]["state"] == "intact"
    assert set(content["provenance"]["made_from_these"].values()) == {True}
    assert content["verdict"]["state"] == "ok"
    ends = [row for row in rows if float(row["t"]) == 1.0 and row["rapid"] == "0"]
    offsets = [np.linalg.norm([float(row[k]) - float(row[f"{k}_cmd"]) for k in "XYZ"]) for row in ends]
    assert content["offset"]["max_mm"] == pytest.approx(max(offsets), abs=1e-6)
    assert content["largest"][0]["corrected_line"] == int(ends[int(np.argmax(offsets))]["output_line"])
    for which, column in (("nominal", "before_mm"), ("corrected", "after_mm")):
        values = [float(row[column]) for row in ends]
        assert content["cut"][which]["max_mm"] == pytest.approx(max(values), abs=2e-6)
        mean_square = np.average(np.square(values), weights=_CUT_LENGTHS)
        assert content["cut"][which]["rms_mm"] == pytest.approx(np.sqrt(mean_square), abs=2e-6)


@pytest.mark.parametrize("has_forces", [True, False])
def test_statistics_follow_from_the_table_of_pairs_and_the_lengths_for_which_they_count(has_forces):
    if not has_forces:
        Path("part.nc").write_text(re.sub(r"\(FORCE.*\)\n", "", GCODE))
    content = compare("part.nc", "other.src", code=3)
    with Path("found/other.compare.pairs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["cut_length_mm"] for row in rows if row["state"] != "pair"} == {""}
    pairs = [row for row in rows if row["state"] == "pair"]
    lengths = np.array([float(row["cut_length_mm"]) for row in pairs])
    assert [length == 0.0 for length in lengths] == [row["rapid"] == "1" for row in pairs]
    columns = {"offset_mm": content["offset"]}
    if has_forces:
        columns |= {f"cut_{name}_mm": content["cut"][name] for name in ("nominal", "corrected")}
    for column, stated in columns.items():
        values = np.array([float(row[column]) for row in pairs])
        assert stated["rms_mm"] == pytest.approx(np.sqrt(lengths @ values**2 / lengths.sum()), abs=2e-6)
        assert stated["mean_mm"] == pytest.approx(lengths @ values / lengths.sum(), abs=2e-6)
        beyond = lengths[values > stated["p95_mm"] + 1e-6].sum()
        not_below = lengths[values > stated["p95_mm"] - 1e-6].sum()
        assert beyond <= 0.05 * lengths.sum() < not_below
    degrees = np.array([float(row["rotation_deg"]) for row in pairs])
    assert content["rotation"]["rms_deg"] == pytest.approx(np.sqrt(lengths @ degrees**2 / lengths.sum()), abs=2e-6)


def test_every_pair_is_the_one_that_convert_made():
    corrected_text()
    compare("part.nc", "out/part.src")
    made = {int(row["output_line"]): (int(row["source_line"]), float(row["t"])) for row in targets()}
    with Path("found/part.compare.pairs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["corrected_line"]) for row in rows] == sorted(made)
    for row in rows:
        source, t = made[int(row["corrected_line"])]
        assert (row["state"] == "pair") == (t == 1.0)
        assert row["state"] == "inserted" or int(row["nominal_line"]) == source


def test_operations_are_told_apart():
    corrected_text()
    one, other = compare("part.nc", "out/part.src")["operations"]
    assert (one["name"], other["name"]) == ("ROUGHING", "FINISHING")
    assert one["offset"]["max_mm"] > other["offset"]["max_mm"] > 0.0
    assert one["cut"]["nominal"]["max_mm"] > 2.0 * other["cut"]["nominal"]["max_mm"]


def test_a_moved_point_is_the_largest_offset_and_its_line_is_named():
    text = corrected_text()
    row = [row for row in targets() if row["source_line"] == "13"][-1]
    old = f"X {row['X_cmd']},"
    edited_file = edited(text, old, f"X {float(row['X_cmd']) + 3.0:.4f},")
    content = compare("part.nc", edited_file, code=3)
    assert content["largest"][0]["nominal_line"] == 13
    assert content["largest"][0]["corrected_line"] == int(row["output_line"])
    assert content["largest"][0]["mm"] == pytest.approx(3.0, abs=0.5)
    assert content["cut"]["corrected"]["max_mm"] == pytest.approx(3.0, abs=0.05)
    assert content["provenance"]["state"] == "changed"
    assert content["verdict"]["state"] == "failed"


def test_inserted_targets_are_told_by_what_they_cut():
    text = corrected_text()
    content = compare("part.nc", "out/part.src")
    rows = [row for row in targets() if float(row["t"]) < 1.0 and row["rapid"] == "0"]
    said = json.loads(Path("out/part.report.json").read_text())
    assert content["between"]["corrected_max_mm"] < said["between_max_mm"] + 1e-3
    largest = max(float(row["before_mm"]) for row in rows)
    assert 0.999 * largest < content["between"]["nominal_max_mm"] < 1.001 * said["before"]["max_mm"]
    row = next(row for row in rows if row["source_line"] != "5")  # not the plunge: the move is level
    moved = f"Z {float(row['Z_cmd']) + 0.05:.4f},"
    lines = text.splitlines(keepends=True)
    place = int(row["output_line"]) - 1
    lines[place] = lines[place].replace(f"Z {row['Z_cmd']},", moved)
    Path("out/part.src").write_bytes("".join(lines).encode())
    content = compare("part.nc", "out/part.src", code=3)
    assert content["between"]["corrected_line"] == place + 1
    assert content["between"]["corrected_max_mm"] == pytest.approx(0.05, abs=1e-3)
    assert any(f"part.src:{place + 1}: between targets it leaves 0.05" in why for why in content["verdict"]["reasons"])


@pytest.mark.parametrize(("height", "state"), [(0.005, "ok"), (0.05, "warning")])
def test_a_point_inserted_beside_the_path_is_a_doubt_without_forces(height, state):
    """It is on the path for the search of partners; nothing explains why it is where it is."""
    corner = "LIN {X 40.000,Y 0.000,Z -2.000"
    line = next(line for line in OTHERS.splitlines(keepends=True) if line.startswith(corner))
    inserted_line = line.replace("X 40.000,Y 0.000,Z -2.000", f"X 20.000,Y 0.000,Z {height - 2.0:.3f}")
    Path("edited.src").write_text(OTHERS.replace(line, inserted_line + line).replace("OTHER", "EDITED"))
    content = compare("other.src", "edited.src")
    assert (content["inserted"], content["verdict"]["state"]) == (1, state)
    text = "other.src:9 and edited.src:10: on the way to this target the programs are 0.0500 mm apart, and no forces"
    assert content["verdict"]["reasons"][0].startswith(text) == (state == "warning")


@pytest.mark.parametrize("digit", range(3))
def test_one_edited_digit_fails_the_comparison(digit):
    text = corrected_text()
    row = [row for row in targets() if row["rapid"] == "0"][3 * digit + 2]
    line = int(row["output_line"])
    lines = text.splitlines(keepends=True)
    changed = re.sub(r"(Y -?\d+\.\d{3})(\d)", lambda m: m[1] + str((int(m[2]) + 1) % 10), lines[line - 1], count=1)
    assert changed != lines[line - 1]
    Path("out/part.src").write_bytes("".join([*lines[: line - 1], changed, *lines[line:]]).encode())
    content = compare("part.nc", "out/part.src", code=3)
    assert content["provenance"]["state"] == "changed"
    assert "was changed since postproc wrote it" in content["verdict"]["reasons"][0]


@pytest.mark.parametrize(("speed", "speed_text"), [("0.04", "40"), ("20", "20000")])
def test_a_changed_speed_is_named_with_both_lines(speed, speed_text):
    text = corrected_text()
    first = re.search(r"\$VEL\.CP ?= ?0\.0250*\b.*", text)
    assert first is not None
    content = compare("part.nc", edited(text, first[0], f"$VEL.CP={speed}"), code=3)
    assert content["differences"]["speed"] >= 1
    (issue,) = [issue for issue in content["issues"] if issue["kind"] == "speed"]
    assert issue["source_line"] == 6
    assert f" {speed_text} mm/s instead of 25 mm/s" in issue["message"]
    assert content["offset"]["max_mm"] < 1.0


def test_a_missing_line_leaves_its_target_alone():
    text = corrected_text()
    row = [row for row in targets() if row["source_line"] == "13"][-1]
    line = text.splitlines(keepends=True)[int(row["output_line"]) - 1]
    Path("out/part.src").write_bytes(text.replace(line, "").encode())
    content = compare("part.nc", "out/part.src", code=3)
    assert content["only_nominal"] == 1
    (issue,) = [issue for issue in content["issues"] if issue["kind"] == "only-nominal"]
    assert issue["source_line"] == 13
    assert content["offset"]["max_mm"] < 1.0


def test_another_base_is_named_and_moves_every_target():
    text = corrected_text()
    found = re.search(r"\$BASE ?= ?\{X 1500[^}]*\}", text)
    assert found is not None
    content = compare("part.nc", edited(text, found[0], found[0].replace("X 1500", "X 1502")), code=3)
    assert content["differences"]["base"] == content["pairs"]
    assert content["offset"]["mean_mm"] == pytest.approx(2.0, abs=0.6)
    assert "2.0000 mm" in next(issue["message"] for issue in content["issues"] if issue["kind"] == "base")


def test_the_same_path_in_another_base_has_no_offset():
    """Bases that differ while the targets make up for it: the robot goes to the same places."""
    moved = re.sub(
        r"LIN \{X (-?[\d.]+)", lambda m: f"LIN {{X {float(m[1]) - 10.0:.3f}", OTHERS.replace("X 1500", "X 1510")
    )
    Path("moved.src").write_text(moved.replace("OTHER", "MOVED"))
    content = compare("other.src", "moved.src")
    assert content["offset"]["max_mm"] < 1e-9
    assert content["differences"]["base"] == content["pairs"] == 7


def test_a_part_of_a_divided_program_is_refused_with_the_name_of_the_whole():
    run("convert", "part.nc", "-o", "out", "--lines-per-file", "40")
    said = run("compare", "part.nc", "out/part1.src", "-o", "found", code=1)
    assert "out/part1.src" in said
    assert "Name partMain instead" in said
    assert compare("part.nc", "out/partMain.src")["verdict"]["state"] == "ok"


def test_an_added_line_is_told_apart_from_inserted_ones():
    line = "LIN {X 40.000,Y 30.000"
    added = "LIN {X 40.000,Y 15.000,Z -2.000,A 180.000,B 0.000,C 180.000} C_DIS\n"
    beside = "LIN {X 46.000,Y 15.000,Z -2.000,A 180.000,B 0.000,C 180.000} C_DIS\n"
    for text, inserted, alone in ((added, 1, 0), (beside, 0, 1)):
        Path("more.src").write_text(OTHERS.replace(line, text + line).replace("OTHER", "MORE"))
        content = compare("other.src", "more.src", "--overwrite")
        assert (content["pairs"], content["inserted"], content["only_corrected"]) == (7, inserted, alone)
        assert content["only_nominal"] == 0


def test_an_arc_that_is_sent_astray_by_its_auxiliary_point_is_told():
    """No target shows it: both ends of the arc stand where they should."""
    text = corrected_text()
    line = next(line for line in text.splitlines() if line.startswith("CIRC"))
    told = compare("part.nc", "out/part.src")
    assert [issue for issue in told["issues"] if issue["kind"] == "between"] == []
    moved = re.sub(r"X [-0-9.]+", "X 5.0", line, count=1)
    foreign = re.sub(r"^;POSTPROC .*\n", "", text.replace(line, moved), flags=re.M)
    Path("foreign.src").write_bytes(foreign.replace("DEF part", "DEF foreign").encode())
    told = compare("part.nc", "foreign.src", "--overwrite", code=3)
    (issue,) = [issue for issue in told["issues"] if issue["kind"] == "between"]
    assert "auxiliary point of its arc" in issue["message"]
    assert issue["corrected_line"] == line_of(foreign, "CIRC {X 5.0")
    assert told["verdict"]["state"] != "ok"


def test_another_program_s_krl_is_compared_without_provenance_and_forces():
    turned = "X 20.000,Y 35.000,Z -2.000,A 179.500"
    Path("turned.src").write_text(OTHERS.replace("X 20.000,Y 35.000,Z -2.000,A 180.000", turned))
    content = compare("other.src", "turned.src")
    assert content["provenance"]["state"] == "none"
    assert content["cut"] is None
    assert content["rotation"]["max_deg"] == pytest.approx(0.5, abs=1e-9)
    assert content["offset"]["max_mm"] < 1e-9


def test_forces_of_a_file_tell_what_both_would_cut():
    Path("forces.csv").write_text("line,Fx,Fy,Fz,line_end\n9,-250,180,120,12\n")
    run("convert", "other.src", "--forces", "forces.csv", "-o", "out")
    content = compare("other.src", "out/other.src", "--forces", "forces.csv")
    assert content["cut"]["corrected"]["max_mm"] < 0.002 < 0.1 < content["cut"]["nominal"]["max_mm"]
    content = compare("other.src", "other.src", "--forces", "forces.csv", code=3)
    assert content["cut"]["corrected"] == content["cut"]["nominal"]
    assert "tolerance" in content["verdict"]["reasons"][0]


OPTIONS = {
    "tolerance": ["--tolerance", "0.0005"],
    "lines per file": ["--lines-per-file", "40"],
    "never divided": ["--lines-per-file", "0"],
    "lines": ["--linearize-arcs"],
    "all": ["--tolerance", "0.05", "--lines-per-file", "60", "--linearize-arcs", "--keep-unresolved"],
}


@pytest.mark.parametrize("options", OPTIONS)
def test_a_program_written_with_options_is_intact_or_changed(options):
    run("convert", "part.nc", *OPTIONS[options], "-o", "out")
    main = next(name for name in ("out/partMain.src", "out/part.src") if Path(name).exists())
    assert (
        compare(
            "part.nc",
            main,
        )["provenance"]["state"]
        == "intact"
    )
    path = next(path for path in sorted(Path("out").glob("part*.src")) if "\nLIN" in path.read_text())
    lines = path.read_bytes().decode().splitlines(keepends=True)
    number = [k for k, line in enumerate(lines) if line.startswith("LIN")][-1]
    lines[number] = lines[number].replace("Z ", "Z 1", 1) if "Z -" not in lines[number] else ""
    path.write_bytes("".join(lines).encode())
    content = compare("part.nc", main, code=3)
    assert content["provenance"]["state"] == "changed"


def plain_and_forces() -> str:
    """Write the program without force comments, and its forces as CSV; return the written program's name."""
    lines = GCODE.splitlines()
    Path("plain.nc").write_text("\n".join("(-)" if "FORCE" in line else line for line in lines) + "\n")
    Path("mine.csv").write_text("line,line_end,Fx,Fy,Fz\n5,9,-1000,720,480\n12,14,-360,240,160\n")
    run("convert", "plain.nc", "--forces", "mine.csv", "-o", "out")
    return "out/plain.src"


def test_a_file_of_forces_that_was_forgotten_is_asked_for_by_its_name():
    written = plain_and_forces()
    printed = run("compare", "plain.nc", written, code=1)
    assert "it was corrected for the forces in mine.csv, which are not given. Give --forces mine.csv." in printed
    content = compare("plain.nc", written, "--forces", "mine.csv")
    assert content["verdict"]["state"] == "ok"


def test_without_the_forces_pairs_that_may_be_others_are_counted():
    """Against the pairs under the forces: all that differ are among those that are said to be uncertain."""
    written = plain_and_forces()
    known = compare("plain.nc", written, "--forces", "mine.csv")
    Path("mine.csv").unlink()
    Path("out/plain.targets.csv").unlink()
    content = compare("plain.nc", written, "--overwrite", code=(0, 3))
    (issue,) = [each for each in content["issues"] if each["kind"] == "pairing"]
    assert issue["level"] == "warning"
    bound = float(re.search(r"known to ([\d.]+) mm", issue["message"])[1])
    assert abs(content["offset"]["max_mm"] - known["offset"]["max_mm"]) <= bound + 0.005


def test_without_the_forces_pairs_follow_from_the_list_of_targets_of_the_conversion():
    """Against the list itself: each end of a motion has its own line of the source, and the offset written there."""
    written = plain_and_forces()
    Path("mine.csv").unlink()
    content = compare("plain.nc", written)
    assert (content["verdict"]["state"], content["issues"]) == ("ok", [])
    with Path("out/plain.targets.csv").open() as file:
        targets = [row for row in csv.DictReader(file) if float(row["t"]) == 1.0]
    lines = [(row["source_line"], row["output_line"]) for row in targets]
    with Path("found/plain.compare.pairs.csv").open() as file:
        pairs = [row for row in csv.DictReader(file) if row["state"] == "pair"]
    assert [(row["nominal_line"], row["corrected_line"]) for row in pairs] == lines
    offset = [math.dist(*([float(row[axis + end]) for axis in "XYZ"] for end in ("", "_cmd"))) for row in targets]
    assert [float(row["offset_mm"]) for row in pairs] == pytest.approx(offset, abs=1.1e-4)
    # a list that was changed states nothing
    table = Path("out/plain.targets.csv")
    table.write_text(table.read_text().replace(",1.000000000,", ",0.900000000,", 1))
    kinds = [each["kind"] for each in compare("plain.nc", written, "--overwrite", code=(0, 3))["issues"]]
    assert kinds == ["pairing"]


def test_a_ptp_instead_of_the_first_line_behind_an_axis_target_is_a_difference():
    Path("edited.src").write_text(OTHERS.replace("OTHER", "EDITED").replace("LIN {", "PTP {", 1))
    content = compare("other.src", "edited.src", code=(0, 3))
    (issue,) = [each for each in content["issues"] if each["kind"] == "kind"]
    assert (issue["source_line"], issue["corrected_line"], issue["count"]) == (7, 7, 1)


def test_programs_without_a_common_target_are_told_apart():
    Path("axes.src").write_text(OTHERS[: OTHERS.index("LIN")].replace("OTHER", "AXES") + "END\n")
    content = compare("other.src", "axes.src", code=3)
    assert (content["pairs"], content["only_nominal"]) == (0, 7)
    assert content["verdict"]["state"] == "failed"


def test_a_nominal_program_and_one_made_from_another_are_called_that():
    run("convert", "part.nc", "--nominal", "-o", "out")
    content = compare("part.nc", "out/part.src", code=3)
    assert content["provenance"]["mode"] == "nominal"
    assert content["offset"]["max_mm"] < 1e-3
    Path("part.nc").write_text(GCODE.replace("X25 Y12", "X25 Y12.5"))
    content = compare("part.nc", "out/part.src", "--overwrite", code=3)
    assert content["provenance"]["made_from_these"]["program"] is False
    assert any("another program" in reason for reason in content["verdict"]["reasons"])


def test_gcode_is_no_second_program_and_inputs_are_not_replaced():
    assert "this one is G-code" in run("compare", "other.src", "part.nc", code=1)
    corrected_text()
    run("compare", "part.nc", "out/part.src", "-o", "found")
    Path("found/part.compare.pairs.csv").write_text("mine\n")
    assert "part.compare.pairs.csv" in run("compare", "part.nc", "out/part.src", "-o", "found", code=1)
    assert Path("found/part.compare.pairs.csv").read_text() == "mine\n"


def test_page_and_terminal_say_what_the_json_says():
    corrected_text()
    content = compare("part.nc", "out/part.src")
    shown = run("compare", "part.nc", "out/part.src", "-o", "found")
    assert f"{content['pairs']} pairs, {content['inserted']} inserted" in shown
    assert f"{content['offset']['max_mm']:.4f}" in shown
    page = read_page(Path("found/part.compare.report.html").read_bytes())
    assert {"verdict", "view3d", "along", "histogram", "worst", "issues", "operations"} <= set(page.ids)
    assert f"{content['offset']['max_mm']:.4f}" in page.text("numbers")
    assert str(content["largest"][0]["corrected_line"]) in page.text("worst")
    assert "ROUGHING" in page.text("operations")


def test_operations_of_krl_are_told_apart_by_its_folds_and_comments():
    lines = OTHERS.splitlines(keepends=True)
    first, second = (next(k for k, text in enumerate(lines) if part in text) for part in ("Z 5.000", "Y 30.000,Z -2"))
    named = [*lines[:first], ";FOLD Roughing;%{PE}\n", ";ENDFOLD\n", *lines[first:second]]
    named += [
        "  ; ---- Finishing T2 ----\n",
        ";FORCE FX=10 FY=0 FZ=5\n",
        ";FOLD LIN P1 Vel=1 m/s;%{PE}\n",
        *lines[second:],
    ]
    Path("named.src").write_text("".join(named).replace("OTHER", "NAMED"))
    content = compare("named.src", "other.src", code=3)
    assert [(each["name"], each["nominal_line"]) for each in content["operations"]] == [
        ("Roughing", first + 3),
        ("Finishing T2", second + 6),
    ]
