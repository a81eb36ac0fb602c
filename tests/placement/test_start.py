"""Programs in a cell without [start]: where they start, on which branch, and that all that follows agrees."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction, kinematics
from postproc.cell import Box, Collision, ObstacleTable, Start
from postproc.collision import link_frames
from postproc.placement import turning
from postproc.placement.turning import chosen_start
from postproc.under_load import RobotInCell
from tests.commands import invoke
from tests.kr270 import CELL_TEXT, FOLDER
from tests.oracle import cell_sim
from tests.oracle.arm import Arm
from tests.placement.setting import ROBOTS, around, cell, read_with_robot

PART = "G21 G90\nG0 X0 Y-100 Z60\nG1 Z0 F600\nX200 F2000\nY100\nX0\nG0 Z60\nM30\n"
KRL = "DEF part()\n$VEL.CP=0.05\nPTP {{X 0,Y 0,Z 60,A 0,B 0,C 180{0}}}\nLIN {{X 0,Y 0,Z 5,A 0,B 0,C 180}}\nEND\n"


def in_line(name, base=(1200.0, 0.0, 600.0)):
    own = cell(name, base=base, tool=(0.0, 350.0))
    return replace(own, tool=replace(own.tool, axis="+Z"), gcode=replace(own.gcode, redundancy_deg=180.0))


def margin(result) -> float:
    """Smallest margin of a converted program: of the joints, and of A5 and A3 from singular poses [rad]."""
    form = kinematics.closed_form(result.robot)
    wrist = np.abs((result.q[:, 4] + form.bend + np.pi) % (2 * np.pi) - np.pi)
    return float(min(result.joint_margin.min(), wrist.min(), np.abs(form.elbow_angle_from_stretched(result.q)).min()))


@pytest.mark.parametrize("name", ROBOTS)
def test_the_branch_is_the_one_with_the_most_margin_of_all_that_convert(name):
    own = in_line(name)
    program, model = read_with_robot(PART, own)
    found = chosen_start(program, RobotInCell.of(model, own))
    first = kinematics.closed_form(model).branches(_flange(program, model, own)[None])[0]
    margins = []
    for q in first[np.isfinite(first).all(axis=1)]:
        there = replace(own, start=Start(tuple(np.degrees(q))))
        result = correction.process(read_with_robot(PART, there)[0], model, there, mode="predict")
        if not result.failed:
            margins.append(margin(result))
    chosen = replace(own, start=Start(found.joints))
    best = margin(correction.process(read_with_robot(PART, chosen)[0], model, chosen, mode="predict"))
    assert len(margins) >= 2
    assert best == pytest.approx(max(margins), abs=1e-3)
    assert name != "kuka_kr270" or max(margins) > min(margins) + np.radians(5.0)  # no mere turn of the wrist
    assert f"{np.degrees(best):.1f}" in found.message
    next_best = float(re.search(r"\(the next best has ([\d.]+)°\)", found.message)[1])
    assert next_best == pytest.approx(np.degrees(sorted(margins)[-2]), abs=0.2)


def test_a_branch_with_a_collision_is_taken_only_if_there_is_no_other():
    """A box at the elbow of the branch with the most margin, beyond it: the other one is taken, and drives."""
    own = in_line("kuka_kr270")
    program, model = read_with_robot(PART, own)
    first = chosen_start(program, RobotInCell.of(model, own))
    beyond = link_frames(model.nominal, np.radians(first.joints)[None])[0, 3, :3, 3] * 1e3 + [350.0, 0.0, 300.0]
    spans = [(float(at - 50), float(at + 50)) for at in beyond]
    box = ObstacleTable(name="beam", frame="root", box=Box(*spans))
    inside = replace(own, collision=Collision(obstacles=[box]))
    found = chosen_start(program, RobotInCell.of(model, inside))
    assert found.joints != first.joints
    assert "on the branch of those without collisions" in found.message
    there = replace(inside, start=Start(found.joints))
    result = correction.process(read_with_robot(PART, there)[0], model, there, mode="predict")
    assert not result.failed, result.issues
    both = replace(own, collision=Collision(obstacles=[box, ObstacleTable(name="part", box=Box(*[(-300, 300)] * 3))]))
    assert chosen_start(program, RobotInCell.of(model, both)).joints == first.joints


@pytest.mark.parametrize("axis", [3, 5])
@pytest.mark.parametrize(
    ("first", "last", "expected"), [(60, 380, -300), (-60, -380, 300), (60, 200, 60), (0, -300, 0)]
)
def test_a4_and_a6_start_with_the_whole_turn_that_leaves_the_most_room_along_the_path(axis, first, last, expected):
    """Their limits are ±350°."""
    own = in_line("kuka_kr270")
    _, model = read_with_robot(PART, own)
    q = np.radians(np.tile([[0.0], [-90.0], [100.0], [0.0], [80.0], [0.0]], 33))
    q[axis] = np.radians((np.linspace(first, last, 33) + 180.0) % 360.0 - 180.0)
    found = np.degrees(turning._unwind(RobotInCell.of(model, own), q))
    wanted = [0.0, -90.0, 100.0, 0.0, 80.0, 0.0]
    wanted[axis] = expected
    np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_a_program_whose_turn_is_free_starts_within_half_a_turn_of_a4_and_a6():
    """At a constant turn A4 would start at 280°, with more room: but the turn is chosen along the path later."""
    own = cell(redundancy="path")
    program, model = read_with_robot(around(1400, 150), own)
    joints = chosen_start(program, RobotInCell.of(model, own)).joints
    assert np.abs(np.array(joints)[[3, 5]]).max() < 180.0


@pytest.mark.parametrize(("turn", "a6"), [(90.0, 40.0), (180.0, 130.0), (270.0, 220.0)])
def test_a_program_of_a_constant_turn_starts_with_the_turn_of_a6_that_the_path_needs(turn, a6):
    """An arc of 260° about A1, with the tool upright: A1 goes from 130° to −130°, and A6 goes back as far.

    At 220° A6 ends at −40°, 130° from its limits; at the same flange, −140°, it would end at −400°.
    """
    own = in_line("kuka_kr270", base=(0.0, 0.0, 700.0))
    own = replace(own, gcode=replace(own.gcode, redundancy_deg=turn))
    program, model = read_with_robot(around(1400, 130), own)
    joints = chosen_start(program, RobotInCell.of(model, own)).joints
    np.testing.assert_allclose(np.array(joints)[[0, 3, 5]], [130.0, 0.0, a6], atol=1e-3)


def _flange(program, model, own):
    """Flange at the first target of a program, by an arm of another code."""
    tool = np.eye(4)
    tool[2, 3] = 0.35
    base = own.base.pose()
    return base @ program.motions.target[0] @ np.linalg.inv(tool)


def without_start(tmp_path, name="part.nc", text=PART):
    (tmp_path / name).write_text(text)
    (tmp_path / "cell.toml").write_text(re.sub(r"\[start\]\njoints.*\n", "", CELL_TEXT))
    return lambda *command: invoke(command[0], tmp_path / command[1], *command[2:], cell=tmp_path / "cell.toml")


def test_what_is_written_starts_there_and_is_read_back_the_same(tmp_path):
    """The joint angles, S and T of the written program, in the simulator of a controller; predict and compare agree."""
    run = without_start(tmp_path)
    done = run("convert", "part.nc", "-o", str(tmp_path / "out"))
    assert done.exit_code == 0, done.output
    assert "The cell has no [start]: the program starts at A1…A6" in done.output
    report = json.loads((tmp_path / "out" / "part.report.json").read_text("utf-8"))
    assert [issue["kind"] for issue in report["issues"]].count("start") == 1
    text = (tmp_path / "out" / "part.src").read_text()
    moves = cell_sim.read(text)
    line = next(line for line in text.splitlines() if line.startswith("PTP {A1"))
    angles = [float(each) for each in re.findall(r"A\d ([-\d.]+)", line)]
    sim = cell_sim.Cell(Arm.load(FOLDER), angles, (1500, -200, 700, 0, 0, 0), (0, 0, 350, 0, 0, 0))
    steps = np.diff([np.degrees(q) for _, _, _, q in sim.run(moves, shares=(0.5, 1.0))], axis=0)
    assert np.abs(steps).max() < 30.0
    again = run("predict", "out/part.src", "-o", str(tmp_path / "again"))
    assert again.exit_code == 0, again.output
    back = json.loads(next((tmp_path / "again").glob("*.report.json")).read_text("utf-8"))
    assert back["limits"]["min_joint_margin_deg"] == pytest.approx(report["limits"]["min_joint_margin_deg"], abs=0.01)
    other = run("compare", "part.nc", str(tmp_path / "out" / "part.src"), "-o", str(tmp_path / "compared"))
    assert other.exit_code == 0, other.output
    assert run("place", "part.nc", "--region", "X=1450:1500", "-o", str(tmp_path / "place")).exit_code == 0


@pytest.mark.parametrize(("status", "s"), [(",S 2,T 35", 2), (",S 6,T 19", 6), (",S 0,T 35", 0)])
def test_a_program_that_states_status_and_turn_starts_with_them(status, s):
    own = in_line("kuka_kr270")
    program, model = read_with_robot(KRL.format(status), own, "krl")
    found = chosen_start(program, RobotInCell.of(model, own))
    assert kinematics.status_of(model, np.radians(found.joints)[None])[0] == s


def test_a_program_that_depends_on_its_start_is_refused(tmp_path):
    home = "DEF part()\nPTP HOME\n$VEL.CP=0.05\nLIN {X 0,Y 0,Z 60,A 180,B 0,C 180}\nEND\n"
    done = without_start(tmp_path, "part.src", home)("convert", "part.src", "-o", str(tmp_path / "out"))
    assert done.exit_code == 1
    assert "Give [start] joints" in done.output


def test_a_program_out_of_reach_of_all_branches_is_refused():
    own = in_line("kuka_kr270", base=(5000.0, 0.0, 600.0))
    program, model = read_with_robot(PART, own)
    with pytest.raises(Exception, match="no branch of the arm reaches the first target"):
        chosen_start(program, RobotInCell.of(model, own))


def test_status_that_is_out_of_reach_names_the_line(tmp_path):
    far = "DEF part()\n$VEL.CP=0.05\nPTP {X 5000,Y 0,Z 60,A 180,B 0,C 180,S 2,T 35}\nEND\n"
    done = without_start(tmp_path, "part.src", far)("convert", "part.src", "-o", str(tmp_path / "out"))
    assert done.exit_code == 1
    assert f"{tmp_path / 'part.src'}:3: " in done.output
    assert "out of reach with the status S that it states. Move the part, or correct S, $BASE and $TOOL." in done.output


def test_a_first_target_out_of_reach_names_the_file_by_its_path(tmp_path):
    far = "G21 G90\nG0 X5000 Y-100 Z60\nG1 X200 F2000\nM30\n"
    done = without_start(tmp_path, "part.nc", far)("convert", str(tmp_path / "part.nc"), "-o", str(tmp_path / "out"))
    assert done.exit_code == 1
    assert f"{tmp_path / 'part.nc'}:2: the cell has no [start]" in done.output
    assert "reaches the first target of the program. Move the part, or give [start] joints.\n" in done.output
