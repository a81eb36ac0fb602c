"""The frame of the stock in robot programs with several: that of most moves at feed."""

from __future__ import annotations

import csv

import pytest

from tests.commands import run
from tests.machining.test_branches import HOME, PROCESS
from tests.places import CELL_FILE

HEAD = "DEF part( )\nBAS (#INITMOV,0 )\n$BASE=BASE_DATA[3]\n$TOOL=TOOL_DATA[2]\n$VEL.CP=0.02\n" + HOME
ABOVE = "$BASE={X 1500,Y -200,Z 701,A 0,B 0,C 0}\nLIN {X -20,Y 30,Z 30,A 180,B 0,C 180}\n$BASE=BASE_DATA[3]\n"
FAR = "$BASE={X 0,Y 0,Z 0,A 0,B 0,C 0}\nLIN {X 1480,Y -170,Z 730,A 180,B 0,C 180}\n$BASE=BASE_DATA[3]\n"
MILL = (
    "LIN {X -20,Y 30,Z -2,A 180,B 0,C 180}\nLIN {X 120,Y 30,Z -2,A 180,B 0,C 180}\n"
    "LIN {X 120,Y 30,Z 30,A 180,B 0,C 180}\n"
)


def largest_force(folder, body):
    (folder / "part.src").write_text(f"{HEAD}{body}{HOME}END\n")
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
