"""convert, predict and compare state the same numbers for one program in one place: they share one simulation."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from functools import partial
from pathlib import Path

import pytest
import tomlkit

from postproc.report.formatting import two_digit_text
from tests import commands
from tests.places import CELL_FILE, SAMPLES

SQUARE = "G21 G90 G17\nG0 X0 Y0 Z20\nG0 Z-1\nG1 X80 F900\nG3 X80 Y30 I0 J15\nG1 X40\nG1 X38.2\nG1 Y0\nG0 Z20\nM2\n"
FORCES = "line,Fx,Fy,Fz,frame,sigma_percent\n4,-160,220,90,FEED,10\n5,-160,220,90,FEED,10\n" + "".join(
    f"{line},{fx},-150,200,BASE,10\n" for line, fx in ((6, 60), (7, -260), (8, 180))
)
PROCESS = """[material]
name = "al_6082_t6_carbide"
[tools.default]
shape = "flat"
diameter_mm = 12
flutes = 3
rpm = 8000
[stock]
box = { X = [8, 110], Y = [-20, 60], Z = [-20, 0] }
resolution_mm = 0.8
"""
run = partial(commands.printed, cell=CELL_FILE)


def reports(folder, kind):
    """Reports of the three commands on one program: forces in comments, in a file, or computed."""
    source, options = folder / "part.nc", []
    if kind == "comments":
        lines = SQUARE.splitlines()
        source.write_text("\n".join([*lines[:3], "(FORCE FX=-160 FY=220 FZ=90 FRAME=FEED)", *lines[3:], ""]))
    else:
        source.write_text(SQUARE)
        path = folder / ("forces.csv" if kind == "file" else "process.toml")
        path.write_text(FORCES if kind == "file" else PROCESS)
        options = ["--forces" if kind == "file" else "--process", str(path)]
    out = ["-o", str(folder / "out")]
    run("convert", str(source), *options, *out)
    run("predict", str(source), *options, *out)
    given = ["--forces", options[1]] if options else []
    run("compare", str(source), str(folder / "out" / "part.src"), *given, *out, code=(0, 3))
    names = ("part.report.json", "part.predict.report.json", "part.compare.report.json")
    return [json.loads((folder / "out" / name).read_text()) for name in names]


@pytest.mark.parametrize("kind", ["comments", "file", "process"])
def test_convert_predict_and_compare_state_the_same_numbers(tmp_path, kind):
    converted, predicted, compared = reports(tmp_path, kind)
    # compare looks at the inserted targets in `between`, convert at all targets in `before`
    nominal = max(compared["cut"]["nominal"]["max_mm"], compared["between"]["nominal_max_mm"])
    assert nominal == pytest.approx(converted["before"]["max_mm"], abs=2e-3)
    corrected = compared["cut"]["corrected"]["max_mm"]
    assert corrected == pytest.approx(converted["after"]["max_mm"], abs=1e-4)
    between = compared["between"]["corrected_max_mm"]
    # compare looks at more places of short lines and arcs
    assert converted["between_max_mm"] - 1e-4 < between < converted["between_max_mm"] + 1.5e-3
    # rounding of the printed numbers is in the first alone
    for key in ("uncorrected_mm", "corrected_mm", "uncorrected_rms_mm", "corrected_rms_mm", "chance"):
        assert predicted["verdict"]["better"][key] == pytest.approx(converted["verdict"]["better"][key], abs=2e-4), key
    if kind != "process":  # the deflected tool cuts with other forces
        assert predicted["before"] == pytest.approx(converted["before"], abs=1e-6)


SMALL = SQUARE.replace("G0 X0 Y0 Z20\n", "G0 X0 Y0 Z20\n(FORCE FX=-60 FY=90 FZ=40 FRAME=FEED)\n")
KRL = """DEF lines()
$VEL.CP = 0.05
PTP {X 0, Y 0, Z 60, A 180, B 0, C 180}
LIN {X 50, Y 40, Z 0}
LIN {X 90}
END
"""
PLACED = {
    "pocket": ("cell_kr270.toml", "pocket.nc", ()),
    "KRL": ("cell_kr270.toml", "lines.src", ("--forces", "lines.csv")),
    "KRL in a frame by number": ("cell_kr270.toml", "inline.src", ()),
    "KR 16": ("cell_kr16.toml", "part.nc", ()),
    "RAPID": ("cell_irb6700.toml", "part.nc", ()),
    "process": ("cell_kr270.toml", "bare.nc", ("--process", "process.toml")),
    "two programs": ("cell_kr270.toml", "part*.nc", ()),
    "no start": ("no_start.toml", "part.nc", ()),
    "turn": ("turned.toml", "part.nc", ()),
    "linear axis": ("carried.toml", "part.nc", ()),
}


@pytest.mark.parametrize("kind", PLACED)
def test_place_states_the_numbers_of_convert_at_todays_place_and_at_the_best_one(tmp_path, monkeypatch, kind):
    monkeypatch.chdir(tmp_path)
    _inputs(tmp_path)
    cell, programs, options = PLACED[kind]
    text = Path(cell).read_text()
    x = tomllib.loads(text)["base"]["X"]
    region = "E1=-600:-300" if kind == "linear axis" else f"X={x - 150}:{x - 50}"
    printed = commands.printed("place", programs, *options, "--region", region, "-o", "place", cell=cell)
    content = json.loads(Path("place/place.json").read_text())
    best = content["best"]
    moved = tomlkit.parse(text)
    place_frames = tomllib.loads(Path("place/place.toml").read_text())
    assert set(place_frames) == ({"base", "base_data"} if "number" in kind else {"base"})
    moved.update(place_frames)
    if kind == "linear axis":  # the robot is carried along Y: as the part moved the other way
        moved["base"]["Y"] -= best["E1"]
    Path("moved.toml").write_text(tomlkit.dumps(moved))
    language = ("--to", "rapid") if kind == "RAPID" else ()
    for place, path in (("today", cell), ("best", "moved.toml")):
        run("convert", programs, *options, *language, "-o", place, cell=path, code=(0, 3))
        results = [json.loads(report.read_text()) for report in Path(place).glob("*.report.json")]
        assert len(results) == (2 if kind == "two programs" else 1)
        better = [result["verdict"]["better"] for result in results]
        for key in ("uncorrected_mm", "corrected_mm"):
            assert content[place][key] == pytest.approx(max(answer[key] for answer in better), abs=2e-6), (place, key)
        assert content[place]["chance"] == pytest.approx(min(answer["chance"] for answer in better), abs=1e-6)
        assert content[place]["deflection_mm"] == pytest.approx(max(r["before"]["max_mm"] for r in results), abs=1e-6)
        stated = f"corrected up to {two_digit_text(content[place]['corrected_mm'])} mm (95 %)"
        assert any(line.startswith(f"  {place}:") and stated in line for line in printed.splitlines())
    assert best["corrected_mm"] < content["today"]["corrected_mm"]


def _inputs(folder):
    for name in ("cell_kr270.toml", "cell_kr16.toml", "cell_irb6700.toml", "pocket.nc", "inline.src", "inline.dat"):
        shutil.copy(SAMPLES / name, folder)
    (folder / "lines.src").write_text(KRL)
    (folder / "lines.csv").write_text("line,Fx,Fy,Fz,frame,sigma_percent\n4,-60,90,40,BASE,10\n5,-80,90,40,BASE,10\n")
    (folder / "part.nc").write_text(SMALL)
    (folder / "part2.nc").write_text(SMALL.replace("FX=-60", "FX=-20").replace("X40", "X30"))
    (folder / "bare.nc").write_text(SQUARE)
    (folder / "process.toml").write_text(PROCESS)
    text = (folder / "cell_kr270.toml").read_text()
    (folder / "no_start.toml").write_text(re.sub(r"\[start\]\njoints = .*\n", "", text))
    (folder / "turned.toml").write_text(text.replace("[gcode]", '[gcode]\nredundancy = "best"'))
    (folder / "carried.toml").write_text(text + "\n[external_axes.E1]\ndirection = [0, 1, 0]\n")


def test_a_place_where_convert_refuses_a_program_is_not_recommended(tmp_path, monkeypatch):
    """The stock is checked by convert alone: at rapid moves through it another place helps as little as today's."""
    monkeypatch.chdir(tmp_path)
    _inputs(tmp_path)
    Path("through.nc").write_text(SQUARE.replace("G0 Z20\nM2", "G0 X20 Y40\nG0 Z20\nM2"))
    command = ("place", "through.nc", "--process", "process.toml", "--region", "X=1400:1410", "-o", "place")
    printed = commands.printed(*command, cell="cell_kr270.toml", code=1)
    content = json.loads(Path("place/place.json").read_text())
    assert content["best"] is None
    assert "through.nc" in content["today"]["reason"]
    assert "No place of the region was found at which the programs can be driven" in printed
