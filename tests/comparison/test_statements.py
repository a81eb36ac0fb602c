"""Statements that switch, wait or set accelerations: each that is planted or removed is listed, and no other."""

from __future__ import annotations

import json
from functools import partial

import pytest

from tests import commands
from tests.comparison.krl_moves import TURNED
from tests.places import CELL_FILE

PROGRAM = f"""DEF part( )
DECL INT n
$VEL.CP=0.05
$ACC.CP=2.0
$BASE={{X 1500,Y -200,Z 700,A 0,B 0,C 0}}
$TOOL={{X 0,Y 0,Z 350,A 0,B 0,C 0}}
PTP {{A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}}
$LOAD.M=12.5
LIN {{X 0,Y 0,Z 20,{TURNED}}}
$OUT[1]=TRUE ; spindle
WAIT SEC 2.0
; FORCE FX=200 FY=90 FZ=120
LIN {{X 0,Y 0,Z 0,{TURNED}}}
FOR n=1 TO 3
  $ANOUT[1]=0.4
  LIN {{X 40,Y 0,Z 0,{TURNED}}} C_DIS
  TRIGGER WHEN DISTANCE=1 DELAY=0 DO $OUT[2]=TRUE
  LIN {{X 40,Y 30,Z 0,{TURNED}}} C_DIS
  WAIT FOR $IN[3]
  LIN {{X 0,Y 0,Z 0,{TURNED}}} C_DIS
ENDFOR
$VEL.ORI1=100
LIN {{X 60,Y 0,Z 0,{TURNED}}}
; FORCE OFF
LIN {{X 60,Y 0,Z 30,{TURNED}}}
HALT
$OUT[1]=FALSE
END
"""
STATEMENTS = [
    "$ACC.CP=2.0", "$LOAD.M=12.5", "$OUT[1]=TRUE", "WAIT SEC 2.0", "$ANOUT[1]=0.4",
    "TRIGGER WHEN DISTANCE=1 DELAY=0 DO $OUT[2]=TRUE", "WAIT FOR $IN[3]", "$VEL.ORI1=100", "HALT", "$OUT[1]=FALSE",
]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("statements")
    (place / "part.src").write_text(PROGRAM)
    commands.printed("convert", str(place / "part.src"), "-o", str(place / "out"), cell=CELL_FILE)
    return place


run = partial(commands.printed, cell=CELL_FILE)


def differences(folder, text):
    """Return kind, message and both lines of the differences of a second program."""
    head = next(line for line in text.splitlines() if line.startswith(";POSTPROC"))
    second = folder / "out" / "second.src"
    second.write_text(text.replace(head + "\n", "").replace("DEF part", "DEF second"))
    options = ("-o", str(folder / "found"), "--json", "--overwrite")
    printed = run("compare", str(folder / "part.src"), str(second), *options, code=(0, 3))
    issues = json.loads(printed)["issues"]
    return [each for each in issues if each["kind"] == "statement"]


def test_a_corrected_program_has_the_statements_of_the_nominal_one(folder):
    assert differences(folder, (folder / "out" / "part.src").read_text()) == []


@pytest.mark.parametrize("statement", STATEMENTS)
def test_a_statement_that_is_removed_is_listed(folder, statement):
    lines = (folder / "out" / "part.src").read_text().splitlines()
    place = next(n for n, line in enumerate(lines) if line.strip().startswith(statement))
    (issue,) = differences(folder, "\n".join([*lines[:place], *lines[place + 1 :], ""]))
    assert issue["level"] == "warning"
    assert "in the nominal program only" in issue["message"]
    line = next(n for n, each in enumerate(PROGRAM.splitlines(), 1) if each.strip().startswith(statement))
    assert issue["source_line"] == line


def test_a_statement_that_is_added_changed_or_moved_is_listed(folder):
    text = (folder / "out" / "part.src").read_text()
    (issue,) = differences(folder, text.replace("$VEL.ORI1=100\n", "$VEL.ORI1=100\n$OUT[7]=TRUE\n"))
    assert "$OUT[7]=TRUE is at this place in the second program only" in issue["message"]
    changed = differences(folder, text.replace("WAIT SEC 2.0", "WAIT SEC 0.2"))
    assert [each["message"].split(" is ")[0] for each in changed] == ["WAIT SEC 2.0", "WAIT SEC 0.2"]
    moved = text.replace("$OUT[1]=TRUE ; spindle\n", "").replace("$VEL.ORI1=100\n", "$VEL.ORI1=100\n$OUT[1]=TRUE\n")
    messages = [each["message"] for each in differences(folder, moved)]
    assert ["nominal program only" in message for message in messages] == [True, False]
