"""KRL with branches that the robot chooses, milled out of a stock: one branch runs, so what is left is not known."""

from __future__ import annotations

import pytest

from tests.commands import convert_text

PLUNGE = """DEF part( )
BAS (#INITMOV,0 )
$BASE=BASE_DATA[3]
$TOOL=TOOL_DATA[2]
$VEL.CP=0.02
PTP {A1 10,A2 -80,A3 110,A4 0,A5 60,A6 0}
PTP {X -20,Y 30,Z 20,A 180,B 0,C 180}
LIN {X -20,Y 30,Z -2,A 180,B 0,C 180}
"""
OUT, BACK = "LIN {X 120,Y 30,Z -2,A 180,B 0,C 180}\n", "LIN {X -20,Y 30,Z -2,A 180,B 0,C 180}\n"
UP = "LIN {X -20,Y 30,Z 20,A 180,B 0,C 180}\n"
HOME_LINE = "PTP {A1 10,A2 -80,A3 110,A4 0,A5 60,A6 0}\n"
ACROSS = "PTP {X 60,Y 30,Z -2,A 180,B 0,C 180}\nLIN {X 60,Y 30,Z 20,A 180,B 0,C 180}\n"
PROCESS = """[material]
name = "al_7075_t6_carbide"
[tools.default]
shape = "flat"
diameter_mm = 12.0
flutes = 3
rpm = 8000
[stock]
box = { X = [0.0, 100.0], Y = [0.0, 60.0], Z = [-20.0, 0.0] }
resolution_mm = 1.0
"""
SLOT = OUT + BACK


def mill_body(folder, body, code):
    return convert_text(folder, "part.src", f"{PLUNGE}{body}END\n", process=PROCESS, code=code).output


@pytest.mark.parametrize(
    ("body", "cut", "behind"),
    [
        (f"IF $IN[3] THEN\n{SLOT}ELSE\n{SLOT}ENDIF\n{UP}{HOME_LINE}", 10, 13),
        (f"SWITCH PGNO\nCASE 1\n{SLOT}CASE 2\n{SLOT}ENDSWITCH\n{UP}{HOME_LINE}", 11, 14),
        (f"IF $IN[3] THEN\n{SLOT}ENDIF\n{OUT}{HOME_LINE}", 10, 13),
        (f"IF $IN[3] THEN\n{SLOT}ENDIF\n{ACROSS}{HOME_LINE}", 10, 13),
        (f"IF $IN[3] THEN\nGOTO SKIP\nENDIF\n{SLOT}SKIP:\n{OUT}{HOME_LINE}", 12, 15),
        (f"IF $IN[3] THEN\nIF $IN[4] THEN\n{SLOT}ENDIF\n{SLOT}ENDIF\n{UP}{HOME_LINE}", 11, 14),
    ],
)
def test_material_that_a_branch_may_have_removed_is_not_taken_for_removed_behind_it(tmp_path, body, cut, behind):
    told = mill_body(tmp_path, body, 1)
    assert f"part.src:{cut}: whether this motion cuts is decided while the robot runs" in told
    assert f"the stock on line {behind} is not known" in told
    assert not list(tmp_path.glob("out/*.src"))


@pytest.mark.parametrize(
    "body",
    [
        f"IF $IN[3] THEN\n{SLOT}ENDIF\n{UP}{HOME_LINE}",
        f"{SLOT}IF $IN[3] THEN\n{SLOT}ENDIF\n{UP}{HOME_LINE}",  # the branch finds nothing to remove
        f"IF $IN[3] THEN\n$OUT[1]=TRUE\nENDIF\n{SLOT}{UP}{HOME_LINE}",
    ],
)
def test_branches_after_which_no_motion_comes_near_the_stock_are_milled(tmp_path, body):
    told = mill_body(tmp_path, body, (0, 3))
    assert "written to" in told
