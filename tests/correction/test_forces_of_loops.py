"""The force file of a written program with a loop: a line has one force for all of its passes."""

from __future__ import annotations

import csv
from functools import partial

import pytest

from tests.commands import invoke
from tests.places import CELL_FILE

PROGRAM = """DEF twice( )
DECL INT I
BAS(#INITMOV,0)
$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}
$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}
$VEL.CP=0.04
PTP {X 0,Y 0,Z 5,A 180,B 0,C 180}
FOR I=1 TO 2
LIN {X 0,Y 0,Z 0}
LIN {X 100,Y 0,Z 0}
LIN {X 100,Y 0,Z 5}
LIN {X 0,Y 0,Z 5}
ENDFOR
END
"""
FORCES = "line,t,Fx,Fy,Fz,frame\n10,0,10,20,30,FEED\n10,0.5,100,20,30,FEED\n10,1,10,20,30,FEED\n"


run = partial(invoke, cell=CELL_FILE)


@pytest.mark.parametrize("mode", [["--nominal"], []])
def test_the_file_of_a_loop_is_read_with_the_written_program(tmp_path, mode):
    (tmp_path / "twice.src").write_text(PROGRAM)
    (tmp_path / "f.csv").write_text(FORCES)
    given = ("convert", tmp_path / "twice.src", "--forces", tmp_path / "f.csv", *mode, "-o", tmp_path / "out")
    made = run(*given)
    assert made.exit_code in (0, 3), made.output
    forces = tmp_path / "out" / "twice.forces.csv"
    with forces.open(newline="") as file:
        rows = list(csv.DictReader(file))
    places = [(int(row["line"]), float(row["t"] or 1.0)) for row in rows]
    assert places == sorted(set(places))
    assert max(float(row["Fx"]) for row in rows) == 100.0
    again = run("predict", tmp_path / "out" / "twice.src", "--forces", forces, "-o", tmp_path / "again")
    assert again.exit_code in (0, 3), again.output
    with (tmp_path / "again" / "twice.predict.targets.csv").open(newline="") as file:
        largest = max(float(row["Fx"]) for row in csv.DictReader(file))
    assert largest == pytest.approx(100.0, abs=0.01)


def test_passes_with_other_forces_have_no_file_and_a_warning(tmp_path):
    """The first pass cuts, the second one is in air."""
    (tmp_path / "twice.src").write_text(PROGRAM)
    (tmp_path / "process.toml").write_text(
        '[material]\nname = "al_6082_t6_carbide"\n[tools.1]\ndiameter_mm = 10\nflutes = 2\nrpm = 8000\n'
        "[stock]\nresolution_mm = 1.0\nbox = { X = [20, 80], Y = [-20, 20], Z = [-10, 2] }\n"
    )
    given = ("convert", tmp_path / "twice.src", "--process", tmp_path / "process.toml", "--nominal")
    made = run(*given, "-o", tmp_path / "out")
    assert made.exit_code in (0, 3), made.output
    assert "passes of this line have different forces" in made.output
    assert not (tmp_path / "out" / "twice.forces.csv").exists()
