"""One line of a program, several cutting moves: what a force CSV, which goes by lines, can say and what it cannot."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from tests.commands import invoke
from tests.machining.setting import forces, gcode, process, tool
from tests.places import SAMPLES

BOX = ((0, 100), (-40, 40), (-20, 0))
SLOT = ("G1 X110 F1200", "Y10", "X-10", "Y0")
TWICE = ("G0 X-10 Y0 Z5", "G1 Z-3 F2400", "M98 P200", "G1 Z-%g F600", "M98 P200", "G0 Z50", "M30", "O200", *SLOT, "M99")
LOOP = (
    "G0 X-10 Y0 Z5",
    "G1 Z0 F600",
    "o1 repeat [2]",
    "G91 G1 Z-2 F300",
    "G90 G1 X110 F1200",
    "G0 X-10",
    "o1 endrepeat",
)
HOLES = ("G0 X20 Y20 Z30", "G98 G83 X20 Y20 Z-10 R2 Q3 F200", "X40 Z-6", "G80")


def made(folder, text, process_text, name="part.nc", cell=SAMPLES / "cell_kr270.toml"):
    """Run `postproc forces`: its result, and the rows of its file by line (None: there is none)."""
    (folder / name).write_text(text)
    (folder / "process.toml").write_text(process_text)
    given = ("forces", folder / name, "--cell", cell, "--process", folder / "process.toml", "-o", folder / "f.csv")
    result = invoke(*given)
    if not (folder / "f.csv").exists():
        return result, None
    rows = {}
    for row in csv.DictReader((folder / "f.csv").read_text().splitlines()):
        rows.setdefault(int(row["line"]), []).append(tuple(float(row[key] or "nan") for key in ("t", "Fx", "Fy", "Fz")))
    return result, rows


def end(*blocks):
    """The program without a second M30 behind its subprogram."""
    return gcode(*blocks).removesuffix("M30\n")


PROCESS = process(tool(12, 2), BOX, 0.5)


def refused(folder, told, *given, **options):
    result, rows = made(folder, *given, **options)
    assert (result.exit_code != 0, rows) == (True, None)
    assert told in result.output
    assert "convert --process" in result.output


def test_a_subprogram_that_cuts_otherwise_the_second_time_is_refused(tmp_path):
    refused(tmp_path, "part.nc:12: the 2 cutting moves of this line have different forces", end(*TWICE) % 4, PROCESS)


def test_a_loop_that_cuts_otherwise_the_second_time_is_refused(tmp_path):
    text = gcode(*(block.replace("Z0", "Z1") for block in LOOP))  # 1 mm deep, and then 2 mm
    refused(tmp_path, "part.nc:8: the 2 cutting moves of this line have different forces", text, PROCESS)


def test_a_subprogram_of_another_file_is_refused(tmp_path):
    (tmp_path / "200.nc").write_text("\n".join(("O200", *SLOT, "M99", "")))
    text = gcode(*TWICE[:3], "G0 Z50")
    refused(tmp_path, "part.nc:6: the 4 cutting moves of this line have different forces", text, PROCESS)


def test_a_routine_of_another_file_is_refused_with_its_places(tmp_path):
    at = "{X %g,Y %g,Z %g,A 180,B 0,C 180}"
    moves = [f"LIN {at % point}" for point in ((-10, 0, -3), (110, 0, -3), (110, 0, 50))]
    (tmp_path / "slot.src").write_text("\n".join(("DEF slot()", *moves, "END", "")))
    lines = ("$BASE=BASE_DATA[3]", "$TOOL=TOOL_DATA[2]", "$VEL.CP=0.02", f"PTP {at % (-10, 0, 50)}", "slot()")
    text = "\n".join(("DEF part()", *lines, "END", ""))
    speed = PROCESS.replace("[tools.1]\n", "[tools.1]\nrpm = 6000\n")
    refused(
        tmp_path, "part.src:6: the 3 cutting moves of this line (slot.src:2, slot.src:3", text, speed, name="part.src"
    )


@pytest.mark.parametrize(("text", "cuts"), [(end(*TWICE) % 6, 4), (gcode(*LOOP), 2)], ids=["subprogram", "loop"])
def test_moves_of_a_line_that_cut_alike_are_written_once(tmp_path, text, cuts):
    """Each slot is as deep as the one above it: every execution of the line finds the same force."""
    result, rows = made(tmp_path, text, PROCESS)
    assert result.exit_code == 0, result.output
    program, found = forces(tmp_path, text, PROCESS)
    several = 0
    for line, given in rows.items():
        t, *force = np.array(given).T
        assert (np.diff(t) > 0.0).all()
        for motion in np.flatnonzero((program.motions.line == line) & ~program.motions.rapid):
            own = found.knots.motion == motion
            several += bool(np.abs(found.knots.wrench[own]).max() > 50.0)
            for axis in range(3):
                there = np.interp(t, found.knots.t[own], found.knots.wrench[own, axis])
                np.testing.assert_allclose(force[axis], there, atol=1e-2)  # t is rounded
    assert several == cuts
    given = ("convert", "part.nc", "--cell", SAMPLES / "cell_kr270.toml", "--forces", "f.csv", "-o", "out")
    paths = [str(tmp_path / each) if each in ("part.nc", "f.csv", "out") else str(each) for each in given]
    assert invoke(*paths).exit_code == 0


def test_the_largest_force_stands_for_all_holes_of_a_cycle(tmp_path):
    result, rows = made(tmp_path, gcode(*HOLES), PROCESS)
    assert result.exit_code == 0, result.output
    assert sorted(rows) == [5, 6]
    program, found = forces(tmp_path, gcode(*HOLES), PROCESS)
    for line, given in rows.items():
        own = np.isin(found.knots.motion, np.flatnonzero(program.motions.line == line))
        assert max(row[3] for row in given) == pytest.approx(np.abs(found.knots.wrench[own, 2]).max(), abs=2e-3)
