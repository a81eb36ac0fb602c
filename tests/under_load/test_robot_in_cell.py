"""A robot in its cell and a path under load, against frames, wrenches and arms written down anew."""

from __future__ import annotations

import dataclasses

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc import cell as cells
from postproc import forces, frames
from postproc.program import Carriage
from postproc.under_load import SHARE_OF_TOLERANCE, ImpossiblePathError, MotionsUnderLoad, PathUnderLoad, RobotInCell
from tests.kr270 import CELL, FOLDER, ROBOT
from tests.oracle.arm import Arm
from tests.programs import program

ARM = Arm.load(FOLDER)
DOWN = CELL.tool_orientation()
SOFT = cells.ToolCompliance(0.3, 0.2, 0.05, 20.0, 10.0, 5.0)
PAYLOAD = cells.Payload(mass_kg=80.0, X=50.0, Y=-100.0, Z=150.0)
BASES = frames.pose_from_xyzabc([[1500.0, -200, 700, 0, 0, 0], [1450.0, -150, 750, 30, -4, 6]])
TOOLS = frames.pose_from_xyzabc([[0.0, 0, 350, 0, 0, 0], [20.0, -30, 300, 15, 5, -10]])
NOTES = [(2, (200.0, -300.0, 150.0, 20.0, -30.0, 40.0), "BASE")]


def test_payload_start_and_output_of_the_cell_are_those_of_its_file_in_si_units():
    setting = RobotInCell.of(ROBOT, msgspec.structs.replace(CELL, payload=PAYLOAD))
    truth = dataclasses.replace(ARM, payload=(80.0, np.array([0.05, -0.1, 0.15])))
    q = np.radians([[10.0, -70, 105, 20, 50, -30]])
    tip = setting.tip(q, CELL.tool.pose(), np.zeros((1, 6)))[0]
    np.testing.assert_allclose(tip, truth.loaded_tcp(q[0], CELL.tool.pose(), np.zeros(6))[:3, 3], rtol=0, atol=2e-9)
    assert np.linalg.norm(tip - ARM.tcp(q[0], CELL.tool.pose())[:3, 3]) > 1e-4
    np.testing.assert_allclose(setting.forward(q[0]), ARM.nominal_tcp(q[0], np.eye(4)), rtol=0, atol=1e-12)
    start = ARM.nominal_tcp(np.radians([0.0, -90, 100, 0, 80, 0]), np.eye(4))
    np.testing.assert_allclose(setting.start_flange, start, rtol=0, atol=1e-12)
    assert (setting.spindle, setting.ramp, setting.tolerance) == ("+Z", pytest.approx(1e-3), pytest.approx(1e-5))


@pytest.mark.parametrize("own", [(0.3, 0.2, 0.05, 20.0, 10.0, 5.0), (0.05, 0.2, 30.0, 5.0, 10.0, 20.0)])
def test_holder_and_tool_add_their_largest_compliance_to_that_of_the_arm(own):
    setting = RobotInCell.of(ROBOT, CELL)
    soft = RobotInCell.of(ROBOT, msgspec.structs.replace(CELL, tool_compliance=cells.ToolCompliance(*own)))
    added = np.subtract(soft.tip_compliance(TOOLS[1]), setting.tip_compliance(TOOLS[1]))
    np.testing.assert_allclose(added, [max(own[:3]) * 1e-6, 20e-6], rtol=1e-9)


@pytest.mark.parametrize("component", range(6))
def test_a_tool_that_is_compliant_in_one_component_is_no_rigid_tool(component):
    own = np.eye(6)[component]
    setting = RobotInCell.of(ROBOT, msgspec.structs.replace(CELL, tool_compliance=cells.ToolCompliance(*own.tolist())))
    assert setting.tool_spring is not None
    assert setting.tool_spring.compliance.tolist() == pytest.approx(own * 1e-6)
    assert RobotInCell.of(ROBOT, CELL).tool_spring is None


def test_rest_is_nominal_only_of_a_calibrated_robot_of_nominal_geometry_without_payload():
    assert RobotInCell.of(ROBOT, CELL).rest_is_nominal
    assert not RobotInCell.of(ROBOT, msgspec.structs.replace(CELL, payload=PAYLOAD)).rest_is_nominal
    assert not RobotInCell.of(replace(ROBOT, subtract_reference=False), CELL).rest_is_nominal
    moved = ROBOT.actual.placement.copy()
    moved[3, 0, 3] += 1e-4
    chain = replace(ROBOT.actual, placement=moved)
    assert not RobotInCell.of(replace(ROBOT, actual=chain, loaded=chain), CELL).rest_is_nominal


def test_joint_angles_of_a_ptp_are_taken_at_its_end_alone():
    axes = np.radians([20.0, -60, 100, 30, 40, -200])
    made = program([("PTP", 0, 0, 50), ("PTP", 0, 0, 60), ("LIN", 0, 0, 40)], orientation=DOWN)
    joints = made.motions.joints[:]
    joints[1] = axes
    made = replace(made, motions=replace(made.motions, joints=joints))
    setting = RobotInCell.of(ROBOT, CELL)
    motion, t = np.array([0, 1, 1, 2, 2]), np.array([1.0, 0.5, 1.0, 0.5, 1.0])
    heights = [50.0, 45.0, 60.0, 50.0, 40.0]
    pose = np.tile(np.eye(4), (5, 1, 1))
    pose[:, :3, :3] = DOWN
    pose[:, 2, 3] = np.array(heights) / 1e3
    path = setting.follow(made, motion, t, pose)
    np.testing.assert_allclose(path.q[2], axes, rtol=0, atol=1e-12)
    for row in (0, 1, 3, 4):
        at = ARM.nominal_tcp(path.q[row], TOOLS[0])
        np.testing.assert_allclose(at, BASES[0] @ pose[row], rtol=0, atol=1e-9)


DIRECTION = np.array([0.6, 0.0, 0.8])
RAIL = Carriage(np.array([0.0, 0.1, 0.1, 0.3]), np.array([0.1, 0.1, 0.3, 0.2]), DIRECTION)
CARRIAGES = pytest.mark.parametrize("carriage", [None, RAIL], ids=["fixed", "E1"])


def carried(path, row):
    """Where the robot root stands at a sample, seen from where it stands at E1 = 0."""
    motion, t = path.sample.motion[row], path.sample.t[row]
    return DIRECTION * (RAIL.begin[motion] * (1 - t) + RAIL.end[motion] * t) if path.program.carriage else np.zeros(3)


def two_frames(cell=CELL, carriage=None):
    """A path in two `$BASE` with two tools, under a force."""
    moves = [("PTP", 100, 0, 50), ("LIN", 100, 0, 0), ("LIN", 160, 0, 0), ("LIN", 160, 40, 5)]
    made = program(moves, NOTES, bases=BASES, tools=TOOLS, base=[0, 0, 1, 1], orientation=DOWN)
    made = replace(made, motions=replace(made.motions, tool=np.array([0, 0, 0, 1])), carriage=carriage)
    motions = MotionsUnderLoad.of(made, RobotInCell.of(ROBOT, cell), None)
    return PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))


@CARRIAGES
def test_poses_and_wrenches_in_the_root_are_turned_by_the_base_of_their_motion(carriage):
    path = two_frames(carriage=carriage)
    motion = path.sample.motion
    rows = np.arange(len(path))[::-1]
    assert set(motion) == {0, 1, 2, 3}
    assert len(path) == len(path.wrench) == len(path.joints.q)
    assert path.program is path.motions.program
    base = BASES[np.array([0, 0, 1, 1])[motion]]
    tool = TOOLS[np.array([0, 0, 0, 1])[motion]]
    pose, wrench = path.pose_in_root(rows), path.wrench_in_root(rows)
    for place, row in enumerate(rows):
        expected = base[row] @ path.sample.pose[row]
        expected[:3, 3] -= carried(path, row)
        np.testing.assert_allclose(pose[place], expected, rtol=0, atol=1e-14)
        np.testing.assert_array_equal(path.tool(rows)[place], tool[row])
        np.testing.assert_allclose(ARM.nominal_tcp(path.joints.q[row], tool[row]), expected, rtol=0, atol=1e-9)
        rotation = base[row, :3, :3]
        turned = np.concatenate([rotation @ path.wrench[row, :3], rotation @ path.wrench[row, 3:]])
        np.testing.assert_allclose(wrench[place], turned, rtol=0, atol=1e-10)
    end = np.flatnonzero((motion == 3) & (path.sample.t == 1.0))
    np.testing.assert_allclose(path.wrench[end], [NOTES[0][1]], rtol=1e-12)


@CARRIAGES
def test_the_loaded_tip_and_the_share_of_the_tool_come_back_in_the_base_of_the_motion(carriage):
    path = two_frames(carriage=carriage, cell=msgspec.structs.replace(CELL, tool_compliance=SOFT))
    rows = np.flatnonzero(path.sample.motion >= 1)[::3]
    q, wrench = path.joints.q[rows], path.wrench_in_root(rows)
    tip, share = path.tip_in_base(rows, q, wrench, np.zeros((len(rows), 6)))
    whole, expected_share = path.robot_in_cell.tip_and_tool_deflection(q, path.tool(rows), wrench)
    assert np.abs(share).max() > 1e-5
    for place, row in enumerate(rows):
        base = BASES[[0, 0, 1, 1][path.sample.motion[row]]]
        in_base = np.linalg.inv(base) @ [*(whole[place] + carried(path, row)), 1.0]
        np.testing.assert_allclose(tip[place], in_base[:3], rtol=0, atol=2e-9)
        np.testing.assert_allclose(share[place], base[:3, :3].T @ expected_share[place], rtol=0, atol=2e-9)
        rigid = ARM.loaded_tcp(q[place], path.tool(rows)[place], wrench[place])[:3]
        turned = Rotation.from_matrix(rigid[:, :3]).as_matrix()
        own = turned @ (SOFT.diagonal()[:3] * (turned.T @ wrench[place, :3]))
        np.testing.assert_allclose(expected_share[place], own, rtol=0, atol=2e-7)
    hard = two_frames(carriage=carriage)
    tip, share = hard.tip_in_base(rows, q, wrench, np.zeros((len(rows), 6)))
    assert not share.any()
    for place, row in enumerate(rows):
        loaded = ARM.loaded_tcp(q[place], hard.tool(rows)[place], wrench[place])[:, 3]
        loaded[:3] += carried(hard, row)
        base = BASES[[0, 0, 1, 1][hard.sample.motion[row]]]
        np.testing.assert_allclose(tip[place], (np.linalg.inv(base) @ loaded)[:3], rtol=0, atol=3e-9)


def test_places_are_chosen_by_a_share_of_the_tolerance(monkeypatch):
    """Places for forces that swing, and along arcs, are chosen for 0.4 of the tolerance."""
    asked, swung, followed = [], forces.swing_places, forces.refined_arcs
    monkeypatch.setattr(forces, "swing_places", lambda *given: (asked.append(given[-1]), swung(*given))[1])
    monkeypatch.setattr(forces, "refined_arcs", lambda *given: (asked.append(given[-1]), followed(*given))[1])
    two_frames()
    assert SHARE_OF_TOLERANCE == 0.4
    assert asked == pytest.approx([0.4e-5, 0.4e-5], rel=1e-12)


def test_places_asked_for_in_addition_are_sampled_in_place_of_those_of_the_forces():
    motions = two_frames().motions
    also = (np.array([1, 3]), np.array([0.123, 0.777]))
    path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False), also)
    for motion, t in zip(*also, strict=True):
        assert ((path.sample.motion == motion) & (path.sample.t == t)).any()


def test_where_the_axes_of_the_feed_turn_with_the_tool_there_are_samples_between_the_ends():
    turned = [DOWN, DOWN, Rotation.from_euler("y", 40, degrees=True).as_matrix() @ DOWN]
    moves = [("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("LIN", 60, 10, 0)]
    made = program(moves, [(2, (2000.0, -3000.0, 1500.0, 0.0, 0.0, 0.0), "FEED")], orientation=np.array(turned))
    motions = MotionsUnderLoad.of(made, RobotInCell.of(ROBOT, CELL), None)
    motion, t = motions.swing_places
    assert len(motion) > 3
    path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    for one, at in zip(motion, t, strict=True):
        assert ((path.sample.motion == one) & (np.abs(path.sample.t - at) < 1e-12)).any()


def test_a_sample_out_of_reach_names_its_line():
    far = program([("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("LIN", -1500, 200, -500)], orientation=DOWN)
    motions = MotionsUnderLoad.of(far, RobotInCell.of(ROBOT, CELL), None)
    with pytest.raises(ImpossiblePathError) as found:
        PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    assert (found.value.issue.kind, found.value.issue.level, found.value.issue.source_line) == (
        "unreachable",
        "error",
        3,
    )
    assert str(found.value) == found.value.issue.message
    assert "out of reach (on the branch of [start] joints)" in found.value.issue.message
