"""``$ORI_TYPE=#JOINT``: the wrist axes lead the orientation; against a cell that shares no code with the package."""

import re

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction, toolpath
from postproc.cell import ExternalAxis
from postproc.errors import ProgramError
from postproc.frames import angle_between, interpolate
from postproc.under_load import MotionsUnderLoad, RobotInCell
from tests.correction.simulated import check_targets, simulator
from tests.corrections import read_files
from tests.dialects.krl_programs import body
from tests.kr270 import CELL, ROBOT
from tests.oracle import cell_sim
from tests.oracle.arm import abc
from tests.oracle.elastic import loaded_tip

BASE, TOOL = "$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}", "$TOOL={X 10,Y -20,Z 350,A 0,B 5,C 0}"
BEGIN = "LIN {X 0,Y 0,Z 0,A 180,B 0,C 180}"
LINES = (
    "LIN {X 60,Y 30,Z 5,A 160,B 15,C 170} C_DIS",
    "SLIN {X 170,Y 30,Z 15,A 130,B 5,C 165}",
    "$BASE={X 1480,Y -190,Z 690,A 10,B 3,C -2}",
    "LIN {X 240,Y -60,Z 10,A 165,B 25,C 160}",
    "LIN {X 240,Y -60,Z 10,A 150,B 20,C 170}",
)
FORCE = ";FORCE FX=-110 FY=190 FZ=130"


def read_wrist_led(*lines, cell=None):
    text = body(
        "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0,E1 0}", BASE, TOOL, "$VEL.CP=0.05", BEGIN, "$ORI_TYPE=#JOINT", *lines
    )
    return text, read_files({"part.src": text}, cell or CELL)


def processed(*lines):
    text, program = read_wrist_led(*lines)
    return text, program, correction.process(program, ROBOT, CELL)


def test_the_wrist_leads_the_orientation_as_in_the_cell():
    text, program = read_wrist_led(
        *LINES, "SPLINE WITH $VEL.CP=0.02", "SLIN {X 230,Y 10,Z 5,A 160,B 15,C 170}", "ENDSPLINE"
    )
    setting = RobotInCell.of(ROBOT, CELL)
    segments = MotionsUnderLoad.of(program, setting, None).segments
    looked = 0
    for index, share, pose, _ in simulator("cell_kr270.toml").run(cell_sim.read(text), (0.2, 0.5, 0.9, 1.0)):
        row = np.array([index])
        here = toolpath.at(program, segments, row, np.array([share])).pose[0]
        np.testing.assert_allclose(here[:3, 3], pose[:3, 3], atol=1e-10)
        np.testing.assert_allclose(here[:3, :3], pose[:3, :3], atol=1e-9)
        if share == 0.5 and program.is_wrist_led[index]:
            begin, end = segments.start.at(row), program.motions.target[row]
            assert angle_between(here[:3, :3], interpolate(begin, end, np.array([0.5]))[0, :3, :3]) > 1e-3
            looked += 1
    assert looked == 5


def test_the_corrected_program_holds_the_tool_in_the_cell_at_targets_and_between():
    text, program, result = processed(FORCE, LINES[0], LINES[2], LINES[3])
    assert not result.failed, result.issues
    (said,) = [issue for issue in result.issues if issue.kind == "wrist-led"]
    assert said.level == "warning"
    assert said.count == 2
    sim, nominal = simulator("cell_kr270.toml"), cell_sim.read(text)
    moves = cell_sim.read(result.documents[0].text)
    rows = check_targets(result, sim, moves, 4)
    assert len(rows) > 25
    tolerance, worst, lean, looked = 1e-3 * CELL.output.tolerance_mm, 0.0, 0.0, 0
    for index, share, _, q in sim.run(moves, (0.5, 1.0)):
        if index == 0:
            continue  # to axis angles
        row, last = rows[index - 1], rows[max(0, index - 2)]
        begin = last["t"] if last["source_line"] == row["source_line"] else 0.0
        t = begin + share * (row["t"] - begin)
        length = 1e-3 * np.linalg.norm([row[k] - last[k] for k in "XYZ"])
        if (
            share == 0.5
            and program.is_wrist_led[result.motion[index - 1]]
            and begin > 0.2
            and length > 1e-3
            and index % 3 == 0
        ):
            move = nominal[result.motion[index - 1]]
            base, tool = abc(*move["base"]), abc(*move["tool"])
            wrench = np.array([row[k] for k in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")])
            wrench = np.concatenate([base[:3, :3] @ wrench[:3], base[:3, :3] @ wrench[3:]])
            here = np.linalg.inv(base) @ loaded_tip(sim.arm, q, tool, wrench)
            there = {s: pose for i, s, pose, _ in sim.run(nominal, (t, 1.0)) if i == result.motion[index - 1]}[t]
            worst = max(worst, np.linalg.norm(here[:3, 3] - there[:3, 3]))
            lean = max(lean, float(angle_between(here[None, :3, :3], there[None, :3, :3])[0]))
            looked += 1
    assert looked > 4
    assert worst < tolerance
    assert 0.1 * lean < 1.05 * tolerance  # the number of pieces is an estimate


def test_what_needs_no_correction_comes_back_to_the_byte():
    text, _, result = processed(*LINES)
    assert result.documents[0].text == text


def test_motions_that_stay_are_simulated_as_they_are_led():
    lines = (FORCE, LINES[0].removesuffix(" C_DIS"), ";FORCE OFF", LINES[1], LINES[2], LINES[3])
    text, _, result = processed(*lines)
    assert not result.failed
    written = result.documents[0].text
    assert written.count("$ORI_TYPE=#VAR") == 1 + written.count("WITH $ORI_TYPE=#VAR")
    assert "$ORI_TYPE=#JOINT\r\n;FORCE OFF\r\n" in written
    assert written.endswith("\r\n".join([*text.splitlines()[-3:], ""]))
    again = correction.process(read_wrist_led(*lines)[1], ROBOT, CELL, mode="predict")
    assert np.abs(again.deviation_before).max() > 1e-5


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["CIRC {X 30,Y 20,Z 0},{X 60,Y 0,Z 0,A 160,B 0,C 180}"], "on another path than a line"),
        (["SPLINE", "SPL {X 60,Y 0,Z 0,A 160,B 0,C 180}", "ENDSPLINE"], "on another path than a line"),
        (["LIN {X 60,Y 0,Z 0,A 60,B 0,C 180}"], "turns by more than 90°"),
        (["LIN {X 60,Y 0,Z 0,A 180,B 89.5,C 180}"], "begins or ends near the singular pose of the wrist"),
    ],
)
def test_what_is_not_certain_is_refused_with_its_line(lines, message):
    with pytest.raises(ProgramError, match=message) as caught:
        read_wrist_led(*lines)
    assert caught.value.line == 10 + lines[0].startswith("SPLINE")


RAIL = replace(CELL, external_axes={"E1": ExternalAxis((0.0, 1.0, 0.0))})


def on_rail(*lines, e1):
    """The program of `read` with E1 in every target, `$BASE` as far along the rail."""
    base = BASE.replace("Y -200", f"Y {e1 - 200}")
    moves = [
        line.replace("}", f",E1 {e1}}}") if "LIN" in line else line for line in (BEGIN, "$ORI_TYPE=#JOINT", *lines)
    ]
    home = f"PTP {{A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0,E1 {e1}}}"
    text = body(home, base, TOOL, "$VEL.CP=0.05", *moves)
    return text, read_files({"part.src": text}, RAIL)


@pytest.mark.parametrize("e1", [0, 300])
def test_where_e1_stands_still_the_wrist_leads_as_without_it(e1):
    lines = (FORCE, LINES[0], "LIN {X 240,Y -60,Z 10,A 165,B 25,C 160}")
    _, _, without = processed(*lines)
    _, program = on_rail(*lines, e1=e1)
    assert program.is_wrist_led.sum() == 2
    result = correction.process(program, ROBOT, RAIL)
    assert not result.failed, result.issues
    written = re.sub(rf",\s*E1 {e1}(\.0*)?(?=[,}}])", "", result.documents[0].text)
    written = written.replace(f"Y {e1 - 200}", "Y -200")
    for got, wanted in zip(cell_sim.read(written)[1:], cell_sim.read(without.documents[0].text)[1:], strict=True):
        np.testing.assert_allclose(got["frame"], wanted["frame"], atol=2e-3)


def test_lines_while_the_robot_is_carried_are_refused():
    with pytest.raises(ProgramError, match="or while E1 moves") as caught:
        read_wrist_led(LINES[0].replace("}", ",E1 5}"), cell=RAIL)
    assert caught.value.line == 10
