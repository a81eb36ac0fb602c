"""convert, predict and compare state the same numbers for one program in one place: they share one simulation."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest

from tests import commands

SAMPLES = Path(__file__).parents[1] / "samples"
CELL = str(SAMPLES / "cell_kr270.toml")
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
run = partial(commands.printed, cell=CELL)


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
