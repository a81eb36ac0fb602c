"""E1 as a linear axis that carries the robot, against a simulator that is told but where the robot stands."""

import re

import numpy as np
import pytest
from msgspec.structs import replace as changed

from postproc import cell as cells
from postproc import correction
from postproc.cell import ExternalAxis
from postproc.errors import CellError, ProgramError
from tests.correction.simulated import rows_of, simulator
from tests.corrections import krl_files, process_files, read_files
from tests.kr270 import CELL, CELL_TEXT, ROBOT
from tests.krl_texts import FRAMES_AND_SPEED, HOME
from tests.oracle import cell_sim
from tests.oracle.arm import abc

DIRECTION = (0.6, 0.8, 0.0)
RAIL = changed(CELL, external_axes={"E1": ExternalAxis((3.0, 4.0, 0.0))})
FORCE = ";FORCE FX=-110 FY=190 FZ=130 MZ=2"
START = "PTP {X 0,Y 0,Z 0,A 180,B 0,C 180,E1 100}"


def text_of(*lines):
    return "\r\n".join(["DEF part( )", *FRAMES_AND_SPEED, *lines, "END", ""])


def read_on_rail(text, cell=RAIL, data=None):
    return read_files(krl_files(text, data), cell)


def process_on_rail(text, cell=RAIL, data=None, **options):
    return process_files(krl_files(text, data), cell, **options)


def carried(text):
    """Moves of a written program with E1 [mm] where each ends, as its lines say it."""
    moves = cell_sim.read(text)
    lines, e1 = text.splitlines(), 0.0
    for move in moves:
        found = re.findall(r"E1 ([-\d.]+)", lines[move["line"] - 1])
        e1 = float(found[-1]) if found else e1
        move["e1"] = e1
    return moves


def base_at(move, e1):
    """$BASE as the robot sees it that stands at E1."""
    return abc(*np.subtract(move["base"][:3], np.multiply(DIRECTION, e1)), *move["base"][3:])


def simulated(result, shares=(0.25, 0.5, 0.75, 1.0)):
    """How far the loaded tip is from nominal [m], for each target and share of the line to it."""
    sim, moves = simulator("cell_kr270.toml"), carried(result.documents[0].text)
    rows, q, off = rows_of(result), np.radians(CELL.start.joints), []
    before = None
    for move, row in zip(moves, rows, strict=True):
        nominal = np.array([row[k] for k in "XYZ"])
        tool = abc(*move["tool"])
        wrench = np.array([row[k] for k in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")])
        for share in shares if move["kind"] == "LIN" and before is not None and before[0]["kind"] == "LIN" else (1.0,):
            pose, e1, aim = abc(*move["frame"]), move["e1"], nominal
            if share < 1.0:
                last, spot = before
                pose = sim.between(move, abc(*last["frame"]), share)
                e1 = last["e1"] + share * (e1 - last["e1"])
                aim = spot + share * (nominal - spot)
            base = base_at(move, e1)
            q = sim.arm.inverse(base @ pose, tool, q)
            tip = (np.linalg.inv(base) @ sim.arm.loaded_tcp(q, tool, wrench))[:3, 3]
            off.append((row["source_line"], share, np.linalg.norm(tip - aim / 1000)))
        before = move, nominal
    return off


def test_the_linear_axis_alone_may_move_under_force():
    """The tool stays but for what the arm is stiffer in its other pose; that axis, not the feed, times the motion."""
    lines = (FORCE, START, "LIN {Z -5,E1 100}", "LIN {E1 130}", "LIN {X 40}")
    result = process_on_rail(text_of(*lines))
    assert not result.failed, result.issues
    assert max(off for _, _, off in simulated(result)) < 1e-6


def test_a_robot_that_stands_elsewhere_cuts_as_with_another_base():
    lines = (FORCE, START, "LIN {X 200,E1 100}", "CIRC {X 250,Y 50},{X 200,Y 100}", "LIN {X 0,Y 100,Z -5}")
    one = process_on_rail(text_of(*lines))
    other = text_of(*(line.replace(",E1 100", "") for line in lines)).replace("X 1500,Y -200", "X 1440,Y -280")
    other = process_on_rail(other, CELL)
    assert not one.failed
    np.testing.assert_allclose(one.printed, other.printed, atol=1e-6)
    np.testing.assert_allclose(one.q, other.q, atol=1e-9)
    np.testing.assert_allclose(one.deviation_before, other.deviation_before, atol=1e-12)


def test_a_moving_robot_stands_at_every_target_and_between_as_the_simulator_says():
    result = process_on_rail(
        text_of(
            FORCE, START, "LIN {X 100,Y 0,Z 0,A 180,B 0,C 180,E1 100}", "LIN {X 600,Y 500,E1 700} C_DIS",
            "LIN {X 620,Y 500,E1 200}", "LIN {X 300,Y 200,E1 -300}", "LIN {X 300,Y 210}",
        )
    )  # fmt: skip
    assert not result.failed, result.issues
    assert result.inserted >= 2
    found = simulated(result)
    at_ends = [off for line, share, off in found if share == 1.0 and line > 6]
    between = [off for line, share, off in found if share < 1.0 and line > 7]
    assert len(between) >= 12
    assert max(at_ends) < 1.2e-6
    assert max(between) < CELL.tolerance


def test_arcs_on_the_way_are_followed_by_the_carriage():
    result = process_on_rail(
        text_of(FORCE, START, "LIN {X 100,E1 100}", "CIRC {X 200,Y 100},{X 300,Y 0,E1 300}", "LIN {X 9}")
    )
    assert not result.failed
    assert max(off for line, share, off in simulated(result, (1.0,)) if line > 6) < 1.2e-6


def test_inserted_targets_have_the_carriage_in_proportion():
    result = process_on_rail(
        text_of(FORCE, START, "LIN {X 100,E1 100}", "LIN {X 400,E1 700,E2 5} C_DIS", "LIN {X 410,E2 5}")
    )
    rows = [row for row in rows_of(result) if row["source_line"] == 8]
    lines = result.documents[0].text.splitlines()
    assert len(rows) > 1
    for row in rows:
        line = lines[int(row["output_line"]) - 1]
        assert float(re.search(r"E1 ([-\d.]+)", line)[1]) == pytest.approx(100 + 600 * row["t"], abs=1e-3)
        assert row["E1"] == pytest.approx(100 + 600 * row["t"], abs=1e-3)
        assert "E2 5" in line
    assert "E1 700,E2 5} C_DIS" in lines[int(rows[-1]["output_line"]) - 1]


def test_points_of_the_data_list_carry_e1_to_inserted_targets():
    data = "DEFDAT part\r\nDECL E6POS XP1={X 400,Y 0,Z 0,A 180,B 0,C 180,E1 700,E2 0}\r\nENDDAT\r\n"
    result = process_on_rail(text_of(FORCE, START, "LIN {X 100,E1 100}", "LIN XP1 C_DIS", "LIN {X 410}"), data=data)
    rows = [row for row in rows_of(result) if row["source_line"] == 8]
    lines = result.documents[0].text.splitlines()
    assert len(rows) > 1
    for row in rows[:-1]:
        found = re.search(r"E1 ([-\d.]+)", lines[int(row["output_line"]) - 1])
        assert float(found[1]) == pytest.approx(100 + 600 * row["t"], abs=1e-3)
    assert "E1 700" in result.documents[1].text


def test_without_forces_a_program_comes_back_byte_for_byte():
    text = text_of(
        START, "LIN {X 100,E1 100}", "LIN {X 400,E1 700.50} C_DIS", "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0,E1 0}",
        "LIN {X 0,Y 0,Z 0,A 180,B 0,C 180,E1 0}", "LIN_REL {Z 10}",
    )  # fmt: skip
    assert process_on_rail(text).documents[0].text == text


def test_joint_angles_with_e1_are_where_the_robot_is_carried():
    joints = "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0,E1 %g}"
    near, far = read_on_rail(text_of(joints % 0, "LIN_REL {Z 5}")), read_on_rail(text_of(joints % 500, "LIN_REL {Z 5}"))
    step = far.motions.target[:, :3, 3] - near.motions.target[:, :3, 3]
    np.testing.assert_allclose(step, [np.multiply(0.5, DIRECTION)] * 2, atol=1e-12)
    result = correction.process(far, ROBOT, RAIL)
    np.testing.assert_allclose(result.q[0], correction.process(near, ROBOT, RAIL).q[0], atol=1e-9)


def test_what_is_written_reads_back_with_the_same_prediction():
    result = process_on_rail(text_of(FORCE, START, "LIN {X 100,E1 100}", "LIN {X 400,E1 700}", "LIN {X 410}"))
    again = correction.process(read_on_rail(result.documents[0].text), ROBOT, RAIL, mode="predict")
    assert not again.failed
    np.testing.assert_allclose(again.before[again.t == 1.0][1:], result.before[1:], atol=2e-6)


def test_only_such_programs_have_the_column():
    assert "E1" not in rows_of(process_on_rail(text_of(START.replace(",E1 100", ""), "LIN {X 100}")))[0]
    assert "E1" in rows_of(process_on_rail(text_of(START, "LIN {X 100}")))[0]


@pytest.mark.parametrize(
    ("lines", "cell", "says"),
    [
        ((START, "LIN {X 100,E1 200}"), CELL, r"E1 moves from 100 to 200.*\[external_axes.E1\] direction"),
        ((START, "LIN {X 100,E2 1}", "LIN {X 100,E2 2}"), RAIL, "E2 moves from 1 to 2"),
        ((START, "LIN_REL {X 100,E1 5}"), CELL, "E1 moves by 5"),
        ((START, "LIN_REL {X 100,E1 5,E3 -2}"), RAIL, "E3 moves by -2"),
        (("LIN {X 100,Y 0,Z 0,A 180,B 0,C 180}", START), RAIL, "part.src:5: the position of E1.*Give E1"),
        (("PTP {X 100,Y 0,Z 0,A 180,B 0,C 180}", "LIN_REL {E1 50}"), RAIL, "part.src:5: the position of E1"),
        ((START, "CIRC {X 50,Y 50},{X 100,Y 0,E1 200},CA 90"), RAIL, "part.src:6: E1 moves along a circle with CA"),
        (("$BASE=EK(MACHINE_DEF[2].ROOT,#EASYS,{X 1})", START), RAIL, "external kinematics"),
    ],
)
def test_other_external_axes_are_refused(lines, cell, says):
    with pytest.raises(ProgramError, match=says):
        read_on_rail(text_of(*lines), cell)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("[external_axes.E2]\ndirection = [0, 1, 0]", "Only E1"),
        ("[external_axes.E1]\ndirection = [0, 0, 0]", "is zero"),
    ],
)
def test_a_cell_that_cannot_be_meant_is_refused(table, says, tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text(CELL_TEXT + f"\n{table}\n")
    with pytest.raises(CellError, match=says):
        cells.load(path)


def places(program):
    """E1 at the start and the end of each motion [mm]."""
    carriage = program.carriage
    return np.stack([carriage.begin, carriage.end], axis=1) * 1000


def test_e1_is_known_from_the_first_ptp_on():
    lines = ("PTP {X 0,Y 0,Z 0,A 180,B 0,C 180,E1 100}", "LIN {X 50}", "LIN {X 60,E1 120}")
    program = read_on_rail(text_of(HOME, *lines))
    np.testing.assert_allclose(places(program)[2:], [[100, 100], [100, 120]])
    assert not [issue for issue in program.issues if issue.kind == "external-axis"]
    told = read_on_rail(text_of(lines[0].replace("PTP", "LIN"), *lines[1:]))
    (issue,) = [issue for issue in told.issues if issue.kind == "external-axis"]
    assert issue.source_line == 5
    assert "E1 at 100" in issue.message


def test_relative_motions_step_e1():
    program = read_on_rail(
        text_of(START, "LIN_REL {X 50,E1 20}", "LIN_REL {X 50}", "PTP_REL {E1 -70}", "LIN {X 1,E1 5}")
    )
    np.testing.assert_allclose(places(program)[:, 1], [100, 120, 120, 50, 5])


def test_relative_motions_that_are_corrected_keep_where_e1_goes():
    lines = (FORCE, START, "LIN_REL {X 300,E1 400}", "LIN_REL {X 20,E1 0}", "LIN_REL {X -50,E1 -100}", ";FORCE OFF")
    text = text_of(*lines, "LIN {X 0}", "LIN {X 10}")
    program, result = read_on_rail(text), process_on_rail(text)
    assert not result.failed, result.issues
    again = read_on_rail(result.documents[0].text)
    np.testing.assert_allclose(places(program)[:, 1], [100, 500, 500, 400, 400, 400])
    ends = np.array([row["t"] for row in rows_of(result)]) == 1.0
    np.testing.assert_allclose(places(again)[ends, 1], places(program)[:, 1], atol=1e-3)
    assert "E1 0" not in result.documents[0].text.partition(START)[2]
    off = [off for line, share, off in simulated(result) if share == 1.0 and line > 6]
    assert max(off) < 1.2e-6


def test_a_base_that_moves_stands_where_kept_motions_and_branches_leave_it():
    cell = changed(RAIL, krl=changed(RAIL.krl, keep_unresolved=True))
    kept = read_on_rail(
        text_of(START, "LIN {X 50,E1 300}", "LIN $POS_ACT:XP", "LIN {X 9,Y 0,Z 0,E1 50,A 180,B 0,C 180}"), cell
    )
    np.testing.assert_allclose(places(kept), [[100, 100], [100, 300], [50, 50]])
    with pytest.raises(ProgramError, match=r"part\.src:8: the position of E1"):
        read_on_rail(text_of(START, "LIN {X 50,E1 300}", "LIN $POS_ACT:XP", "LIN {X 9,Y 0,Z 0,A 180,B 0,C 180}"), cell)
    lines = ("LIN {X 50,Y 0,Z 0,A 180,B 0,C 180,E1 %d}", "LIN {X 80,Y 0,Z 0,A 180,B 0,C 180,E1 %d}")
    branches = (
        START,
        "IF $IN[1] THEN",
        lines[0] % 300,
        lines[1] % 400,
        "ELSE",
        lines[1],
        "ENDIF",
        "LIN {X 9,Y 0,Z 0,A 180,B 0,C 180}",
    )
    one = read_on_rail(text_of(*(line.replace("%d", "400") for line in branches)))
    np.testing.assert_allclose(places(one), [[100, 100], [100, 300], [300, 400], [100, 400], [400, 400]])
    with pytest.raises(ProgramError, match="E1 differs between the ends"):
        read_on_rail(text_of(*(line.replace("%d", "400" if n == 3 else "450") for n, line in enumerate(branches))))


def test_axes_that_never_change_are_kept():
    all_axes = "E1 100,E2 12.5,E3 -7,E4 0,E5 0,E6 90"
    text = text_of(FORCE, START.replace("E1 100", all_axes), f"LIN {{X 300,{all_axes}}}", "LIN {X 310,E3 -7}")
    result = process_on_rail(text)
    assert not result.failed
    for line in result.documents[0].text.splitlines():
        if line.startswith(("LIN {X 1", "LIN {X 2")):
            assert "E2 12.5,E3 -7,E4 0,E5 0,E6 90" in line
    assert {i.subject for i in result.program.issues if i.kind == "external-axis"} == {"E2", "E3", "E6"}
