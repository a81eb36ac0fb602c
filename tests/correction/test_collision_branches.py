"""[collision] checks the motions that the robot can drive: along branches, behind them, around loops."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.correction.runs import Run, previous_samples, runs
from postproc.program import Carriage
from tests.commands import invoke
from tests.programs import program

CELL_WITH_CLAMP = """robot = "kuka_kr270"
base = { X = 1400.0, Y = 150.0, Z = 750.0, A = 30.0, B = 4.0, C = -6.0 }
tool = { Z = 300.0 }
start = { joints = [0, -90, 100, 0, 80, 0] }
krl = { initmov = "cell" }
[base_data.3]
X = 1400.0
Y = 150.0
Z = 750.0
A = 30.0
B = 4.0
C = -6.0
[tool_data.2]
Z = 300.0
[collision]
clearance_mm = 5.0
holder = [ { diameter_mm = 12, length_mm = 40 }, { diameter_mm = 63, length_mm = 80 } ]
obstacles = [ { name = "clamp", box = { X = [40, 60], Y = [25, 35], Z = [-20, 40] } } ]
"""
POINTS = {  # left and right of the clamp, below and above its top
    "LEFT LOW": "{X -20,Y 30,Z 10,A 180,B 0,C 180}",
    "LEFT HIGH": "{X -20,Y 30,Z 60,A 180,B 0,C 180}",
    "RIGHT LOW": "{X 120,Y 30,Z 10,A 180,B 0,C 180}",
    "RIGHT HIGH": "{X 120,Y 30,Z 60,A 180,B 0,C 180}",
    "JOINTS LEFT": "{A1 -9.90553,A2 -82.71442,A3 116.42842,A4 8.24949,A5 58.24142,A6 15.83698}",
    "JOINTS RIGHT": "{A1 -11.48109,A2 -75.55478,A3 111.23408,A4 8.35531,A5 56.48375,A6 13.97783}",
}
NUMBERED_FRAMES = """DEF part( )
BAS (#INITMOV,0 )
$BASE=BASE_DATA[3]
$TOOL=TOOL_DATA[2]
$VEL.CP=0.02
"""


def refused_lines(tmp_path, body: str, *options: str) -> list[int]:
    """Return the lines (1: the first of `body`) of the collisions for which a program is refused; none: it is not.

    :param body: statements, with names of `POINTS`.
    """
    for name, point in POINTS.items():
        body = body.replace(name, point)
    (tmp_path / "cell.toml").write_text(CELL_WITH_CLAMP)
    path = tmp_path / "part.src"
    path.write_text(f"{NUMBERED_FRAMES}{body}\nEND\n")
    done = invoke("convert", str(path), "-o", str(tmp_path / "out"), *options, cell=str(tmp_path / "cell.toml"))
    lines = [
        int(line) - NUMBERED_FRAMES.count("\n") for line in re.findall(r"part\.src:(\d+): collision:", done.output)
    ]
    assert bool(lines) == bool(done.exit_code), done.output
    assert bool(lines) != Path(tmp_path, "out", "part.src").exists()
    return lines


RIGHT = "LIN RIGHT HIGH\nLIN RIGHT LOW"
PLACES = {
    "no motion leads from the end of THEN to ELSE": (
        f"PTP LEFT HIGH\nIF $IN[3] THEN\n{RIGHT}\nELSE\nLIN LEFT LOW\nLIN LEFT HIGH\n{RIGHT}\nENDIF\nLIN RIGHT HIGH",
        [],
    ),
    "from the IF to THEN": (
        f"PTP LEFT HIGH\nLIN LEFT LOW\nIF $IN[3] THEN\nLIN RIGHT LOW\nELSE\nLIN LEFT HIGH\n{RIGHT}\nENDIF", [4],
    ),
    "from the IF to ELSE": (
        f"PTP LEFT HIGH\nLIN LEFT LOW\nIF $IN[3] THEN\nLIN LEFT HIGH\n{RIGHT}\nELSE\nLIN RIGHT LOW\nENDIF", [8],
    ),
    "from the IF to a later CASE": (
        "PTP LEFT HIGH\nLIN LEFT LOW\nSWITCH PGNO\nCASE 1\nLIN LEFT HIGH\nPTP JOINTS LEFT\nCASE 2\nLIN LEFT HIGH\n"
        "CASE 3\nPTP JOINTS RIGHT\nENDSWITCH\nPTP JOINTS LEFT",
        [10, 12],
    ),
    "behind THEN": (
        "PTP LEFT HIGH\nIF $IN[3] THEN\nLIN LEFT LOW\nELSE\nLIN RIGHT HIGH\nENDIF\nPTP JOINTS RIGHT", [7],
    ),
    "behind ELSE": (
        "PTP LEFT HIGH\nIF $IN[3] THEN\nLIN RIGHT HIGH\nELSE\nLIN LEFT LOW\nENDIF\nPTP JOINTS RIGHT", [7],
    ),
    "behind neither": (
        "PTP LEFT HIGH\nIF $IN[3] THEN\nLIN RIGHT HIGH\nELSE\nLIN LEFT LOW\nENDIF\nPTP JOINTS LEFT", [],
    ),
    "behind an IF whose branch does not run": (
        "PTP LEFT HIGH\nLIN LEFT LOW\nIF $IN[3] THEN\nLIN LEFT HIGH\nLIN RIGHT HIGH\nENDIF\nPTP JOINTS RIGHT", [7],
    ),
    "behind the inner of two branches": (
        "PTP LEFT HIGH\nIF $IN[3] THEN\nIF $IN[4] THEN\nLIN LEFT LOW\nELSE\nLIN RIGHT HIGH\nENDIF\nELSE\n"
        "LIN RIGHT HIGH\nENDIF\nPTP JOINTS RIGHT",
        [11],
    ),
    "from a branch to the branch that follows": (
        "PTP LEFT HIGH\nIF $IN[3] THEN\nLIN LEFT LOW\nELSE\nLIN RIGHT HIGH\nENDIF\n"
        "IF $IN[4] THEN\nPTP JOINTS RIGHT\nELSE\nPTP JOINTS LEFT\nENDIF",
        [8],
    ),
    "from the end of a round to the next": (
        f"PTP LEFT HIGH\nLOOP\nPTP JOINTS LEFT\n{RIGHT}\nENDLOOP", [3],
    ),
    "a round that ends where it begins": (
        f"PTP LEFT HIGH\nLOOP\nPTP JOINTS LEFT\n{RIGHT}\nLIN RIGHT HIGH\nLIN LEFT HIGH\nENDLOOP", [],
    ),
    "from a branch at the end of a round": (
        "PTP LEFT HIGH\nLOOP\nPTP JOINTS LEFT\nLIN RIGHT HIGH\nIF $IN[3] THEN\nLIN RIGHT LOW\nELSE\n"
        "LIN LEFT HIGH\nENDIF\nENDLOOP",
        [3],
    ),
}  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
def test_motions_that_control_flow_can_lead_to_are_checked_and_no_others(tmp_path, place):
    body, lines = PLACES[place]
    assert refused_lines(tmp_path, body) == lines[:1]


def test_a_motion_behind_one_that_stays_as_it_is_has_no_known_path_but_its_end_is_checked(tmp_path):
    """The point is not known; from the one before it the straight motion of the joints goes through the clamp."""
    kept = "PTP LEFT HIGH\n;FORCE FX=50\nLIN LEFT LOW\n;FORCE OFF\nP=$POS_ACT\nLIN P\n"
    assert not refused_lines(tmp_path, f"{kept}PTP RIGHT LOW\nLIN RIGHT HIGH", "--keep-unresolved")
    inside = "{X 50,Y 30,Z 10,A 180,B 0,C 180}"
    assert refused_lines(tmp_path, f"{kept}PTP {inside}\nLIN RIGHT HIGH", "--keep-unresolved") == [7]
    assert refused_lines(tmp_path, f"{kept}PTP RIGHT LOW\nLIN LEFT LOW", "--keep-unresolved") == [8]


def path_of(**changes):
    """Return a program of six motions, and the motion of each of twelve samples."""
    made = program([("RAPID", 10 * k, 0, 0) for k in range(6)])
    return replace(made, **changes), np.repeat(np.arange(6), 2)


def test_runs_end_where_the_tool_changes_or_a_motion_begins_elsewhere():
    q = np.arange(72.0).reshape(12, 6)
    made, motion = path_of()
    assert list(runs(made, motion, q)) == [Run(slice(0, 12), 0, -1)]
    made = replace(made, motions=replace(made.motions, tool=np.array([0, 0, 2, 2, 2, 0])))
    tools = [Run(slice(0, 4), 0, -1), Run(slice(4, 10), 2, 3), Run(slice(10, 12), 0, 9)]
    assert list(runs(made, motion, q)) == tools
    made = replace(made, after=np.array([-1, 0, 0, 3, -1, 4]))
    assert list(runs(made, motion, q)) == [
        Run(slice(0, 4), 0, -1),
        Run(slice(4, 6), 2, 1),
        Run(slice(6, 8), 2, 6),
        Run(slice(8, 10), 2, -1),
        Run(slice(10, 12), 0, 9),
    ]
    assert previous_samples(made, motion).tolist() == [-1, 0, 1, 2, 1, 4, 6, 6, -1, 8, 9, 10]


def test_a_motion_runs_once_more_for_each_further_state_in_which_it_may_begin():
    q = np.arange(72.0).reshape(12, 6)
    q[5] = q[3] + 0.9e-6
    q[7] = q[3] + 1.1e-6
    made, motion = path_of(
        after=np.array([-1, 0, 1, 2, 3, 1]), transitions=((5, 2), (5, 3), (5, 3), (5, -1), (5, -1), (0, 1), (0, -1))
    )
    extra = [Run(slice(10, 12), 0, 7), Run(slice(10, 12), 0, -1), Run(slice(0, 2), 0, 3)]
    assert list(runs(made, motion, q))[2:] == extra
    e1 = np.array([0.0, 0.1, 0.2, 0.2, 0.2, 0.2, 0.2])
    carried = replace(made, carriage=Carriage(e1[:-1], e1[1:], np.array([1.0, 0.0, 0.0])))
    assert list(runs(carried, motion, q))[2:] == extra
    e1[3] = 0.3
    carried = replace(made, carriage=Carriage(e1[:-1], e1[1:], np.array([1.0, 0.0, 0.0])))
    assert list(runs(carried, motion, q))[2:] == [Run(slice(10, 12), 0, 5), *extra]
