"""The frame of the stock in robot programs with several: that of most of the way at feed."""

from __future__ import annotations

import csv

import pytest

from tests.commands import run
from tests.machining.test_branches import HOME_LINE, PROCESS
from tests.places import CELL_FILE

NUMBERED_FRAMES = "DEF part( )\nBAS (#INITMOV,0 )\n$BASE=BASE_DATA[3]\n$TOOL=TOOL_DATA[2]\n$VEL.CP=0.02\n" + HOME_LINE
ABOVE = "$BASE={X 1500,Y -200,Z 701,A 0,B 0,C 0}\nLIN {X -20,Y 30,Z 30,A 180,B 0,C 180}\n$BASE=BASE_DATA[3]\n"
FAR = "$BASE={X 0,Y 0,Z 0,A 0,B 0,C 0}\nLIN {X 1480,Y -170,Z 730,A 180,B 0,C 180}\n$BASE=BASE_DATA[3]\n"
MILL = (
    "LIN {X -20,Y 30,Z -2,A 180,B 0,C 180}\nLIN {X 120,Y 30,Z -2,A 180,B 0,C 180}\n"
    "LIN {X 120,Y 30,Z 30,A 180,B 0,C 180}\n"
)


def largest_force(folder, body):
    (folder / "part.src").write_text(f"{NUMBERED_FRAMES}{body}{HOME_LINE}END\n")
    (folder / "process.toml").write_text(PROCESS)
    words = (folder / "part.src", "--process", folder / "process.toml", "-o", folder / "out", "--overwrite")
    told = run("convert", *words, code=(0, 3), cell=CELL_FILE).output
    with (folder / "out" / "part.forces.csv").open(encoding="utf-8", newline="") as file:
        return told, max(float(row["Fx"] or 0) ** 2 + float(row["Fy"] or 0) ** 2 for row in csv.DictReader(file)) ** 0.5


@pytest.mark.parametrize("positioning", [ABOVE, FAR])
def test_a_move_that_positions_in_another_frame_does_not_move_the_stock(tmp_path, positioning):
    told, force = largest_force(tmp_path, positioning + MILL)
    plain, reference = largest_force(tmp_path, "LIN {X -20,Y 30,Z 30,A 180,B 0,C 180}\n" + MILL)
    assert force == pytest.approx(reference, rel=0.01)
    assert "the program moves at feed in 2 frames $BASE" in told
    assert "frames $BASE" not in plain


def test_many_short_moves_in_another_frame_do_not_move_the_stock(tmp_path):
    """The stock stood in the frame of most moves: a contour of more points moved it."""
    other = "$BASE={X 1200,Y 100,Z 653,A 30,B 0,C 0}\n"
    short = "".join(f"LIN {{X {20 + n},Y 30,Z 10,A 180,B 0,C 180}}\n" for n in range(12))
    told, force = largest_force(tmp_path, MILL + other + short)
    _, reference = largest_force(tmp_path, MILL)
    assert force == pytest.approx(reference, rel=0.01)
    assert "the program moves at feed in 2 frames $BASE" in told


@pytest.mark.parametrize(("z", "is_asked"), [(700, False), (650, True)])
def test_two_frames_with_much_of_the_way_are_asked_about_unless_one_is_that_of_the_cell(tmp_path, z, is_asked):
    frames = [f"$BASE={{X 1500,Y -200,Z {height},A 0,B 0,C 0}}\n" for height in (z, 690)]
    told, _ = largest_force(tmp_path, frames[0] + MILL + MILL + frames[1] + MILL)
    reason = next(line for line in told.splitlines() if "the program moves at feed in 2 frames $BASE" in line)
    assert reason.lstrip().startswith("- line 8 and") == is_asked
