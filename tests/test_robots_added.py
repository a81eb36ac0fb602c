"""`robots add`: an arm written by others becomes the same arm with KUKA's names and signs."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from postproc import kinematics, robot
from postproc.errors import InputError, ModelError
from postproc.jobs.first_steps import add_robot
from tests.commands import invoke, run
from tests.kr270 import ROBOT
from tests.robot_urdfs import PREFIXED, ROS, ROS_A, ros_urdf

pytestmark = pytest.mark.usefixtures("work_folder")

SIGNS = ((1, 1, 1, 1, 1, 1), (-1, 1, -1, 1, -1, 1), (-1, -1, -1, -1, -1, -1))
TITLE = "KUKA KR 270-2 (2000 series)"


def written(text: str) -> Path:
    Path("arm.urdf").write_text(text)
    return Path("arm.urdf")


KUKA = [name for name in robot.shipped_models() if name.startswith("kuka_")]


@pytest.mark.parametrize("shipped", KUKA)
@pytest.mark.parametrize("signs", SIGNS)
@pytest.mark.parametrize("scrambled", [False, True])
def test_the_arm_added_stands_where_pinocchio_says_that_the_urdf_stands(shipped, signs, scrambled):
    rng = np.random.default_rng(5)
    path = written(ros_urdf(robot.load(robot.find(shipped)), signs, rng if scrambled else None))
    added = robot.load(add_robot(path, "mine").folder)
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    q = rng.uniform(added.lower, added.upper, (10, 6))
    poses, _ = kinematics.tcp(added.nominal, q, np.eye(4))
    for row in range(len(q)):
        pin.framesForwardKinematics(model, data, q[row] * signs)
        base, tool0 = (data.oMf[model.getFrameId(name)] for name in ("base", "tool0"))
        np.testing.assert_allclose(poses[row], (base.inverse() * tool0).homogeneous, atol=1e-6)  # lengths to 0.1 µm
    for name, limit in (("lower", added.lower), ("upper", added.upper)):
        np.testing.assert_allclose(limit, getattr(robot.load(robot.find(shipped)), name), atol=1e-9)


def test_the_comment_of_each_joint_states_its_limits_in_degrees():
    folder = add_robot(written(ros_urdf(ROBOT, SIGNS[0])), "mine").folder
    comments = re.findall(r"<!-- (\S+)° to (\S+)°, (\S+)°/s -->", (folder / "robot.urdf").read_text())
    stated = np.array(comments, dtype=float).T
    for values, limits in zip(stated, (ROBOT.lower, ROBOT.upper, ROBOT.speed), strict=True):
        np.testing.assert_allclose(values, np.degrees(limits), rtol=1e-3)


def test_weights_turn_the_joints_as_in_the_urdf():
    path = written(ros_urdf(ROBOT, SIGNS[1], np.random.default_rng(1)))
    added = robot.load(add_robot(path, "mine").folder)
    model = pin.buildModelFromUrdf(str(path))
    q = np.random.default_rng(2).uniform(added.lower, added.upper, (5, 6))
    expected = [pin.computeGeneralizedGravity(model, model.createData(), row * SIGNS[1]) * SIGNS[1] for row in q]
    torque = kinematics.gravity_torque(added.nominal, q)
    np.testing.assert_allclose(torque, expected, atol=2.0)  # centres of mass are kept to 0.1 mm
    assert np.abs(expected).max() > 2000.0


@pytest.mark.parametrize("names", [ROS, ROS_A, PREFIXED])
def test_names_of_joints_and_links_do_not_matter(names):
    added = add_robot(written(ros_urdf(ROBOT, SIGNS[0], names=names)), "mine")
    own = robot.load(added.folder).nominal
    np.testing.assert_allclose(own.placement, ROBOT.nominal.placement, atol=1e-9)


def test_angles_written_with_four_decimals_leave_no_tilt():
    text = ros_urdf(robot.load(robot.find("kuka_kr16_2")), SIGNS[0]).replace("1.570796326795", "1.5708")
    assert "1.5708" in text
    added = robot.load(add_robot(written(text), "mine").folder)
    shipped = robot.load(robot.find("kuka_kr16_2")).nominal
    q = np.random.default_rng(3).uniform(-1, 1, (5, 6))
    pose, expected = (kinematics.tcp(chain, q, np.eye(4))[0] for chain in (added.nominal, shipped))
    np.testing.assert_allclose(pose, expected, atol=1e-9)


def test_what_is_not_known_is_marked_as_assumed_and_told():
    text = ros_urdf(robot.load(robot.find("kuka_kr16_2")), SIGNS[1])
    masses = [line for line in text.splitlines() if "<mass" in line]
    for line in masses:
        text = text.replace(line, line.partition(">")[0] + "/>")
    added = add_robot(written(text), "mine")
    assert [note for note in added.notes if note.startswith("no link has a mass")]
    assert [
        note for note in added.notes if note.startswith("joints turn the other way") and note.endswith("A1, A3, A5")
    ]
    shown = {entry.name: entry for entry in robot.load(added.folder).sources}
    assert all(shown[f"compliance A{axis}"].assumed for axis in range(1, 7))
    assert shown["link masses"].assumed
    assert not shown["geometry, limits"].assumed
    assert not shown["joint speeds"].assumed


REACH = {"kuka_kr270": 0.35 + 1.25 + np.hypot(1.1, 0.055), "kuka_kr16_2": 0.26 + 0.68 + np.hypot(0.67, 0.035)}


def renamed(shipped: str, name: str) -> str:
    model = robot.load(robot.find(shipped))
    return ros_urdf(model, SIGNS[0]).replace(f'<robot name="{model.title}">', f'<robot name="{name}">')


@pytest.mark.parametrize(
    ("shipped", "name", "payload"),
    [
        ("kuka_kr16_2", "kr16_2", 16.0),
        ("kuka_kr270", "kuka_kr210l150", 150.0),
        ("kuka_kr270", "KUKA KR 120 R2700-2", 120.0),
        ("kuka_kr270", "KR 210-2 L150", 150.0),
    ],
)
def test_compliances_are_scaled_by_the_load_moment_that_the_name_states(shipped, name, payload):
    added = robot.load(add_robot(written(renamed(shipped, name)), "mine").folder)
    moment = 270.0 * REACH["kuka_kr270"] / (payload * REACH[shipped])
    np.testing.assert_allclose(added.compliance / ROBOT.compliance, moment**0.75, rtol=0.05)


def test_without_a_payload_a_longer_arm_is_not_taken_to_be_stiffer():
    small = robot.load(add_robot(written(renamed("kuka_kr16_2", "arm")), "small").folder)
    np.testing.assert_allclose(
        small.compliance / ROBOT.compliance, (REACH["kuka_kr270"] / REACH["kuka_kr16_2"]) ** 3, rtol=0.05
    )
    long = robot.load(add_robot(written(renamed("kuka_kr240_r2900_2", "arm")), "long").folder)
    np.testing.assert_allclose(long.compliance / ROBOT.compliance, 1.0, rtol=0.05)


@pytest.mark.parametrize(("factor", "believed"), [(0.2, False), (1.0, True), (4.0, False)])
@pytest.mark.parametrize("name", ["KUKA KR 270-2", "arm"])
def test_masses_that_no_arm_of_the_size_has_are_assumed_and_named(factor, believed, name):
    text = re.sub(
        r'<mass value="([^"]*)"', lambda found: f'<mass value="{float(found[1]) * factor}"', renamed("kuka_kr270", name)
    )
    added = add_robot(written(text), "mine")
    shown = {entry.name: entry for entry in robot.load(added.folder).sources}
    assert shown["link masses"].assumed is not believed
    total = robot.load(added.folder).nominal.mass.sum()
    assert any(note.startswith(f"the links weigh {total:.0f} kg") for note in added.notes) is not believed


@pytest.mark.parametrize("signs", SIGNS)
@pytest.mark.parametrize("zero", [(0, 90, -90, 0, 0, 0), (30, -90, 90, -20, 45, 0), (0, 0, 0, 0, -90, 0)])
def test_a_zero_position_that_differs_from_kukas_is_changed(signs, zero):
    angles = np.radians(zero)
    path = written(ros_urdf(ROBOT, signs, np.random.default_rng(4), zero=angles))
    added = add_robot(path, "mine")
    own = robot.load(added.folder)
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    q = np.random.default_rng(5).uniform(own.lower, own.upper, (10, 6))
    poses, _ = kinematics.tcp(own.nominal, q, np.eye(4))
    for row in range(len(q)):
        pin.framesForwardKinematics(model, data, (q[row] - angles) * signs)
        base, tool0 = (data.oMf[model.getFrameId(name)] for name in ("base", "tool0"))
        np.testing.assert_allclose(poses[row], (base.inverse() * tool0).homogeneous, atol=1e-6)
        expected = pin.computeGeneralizedGravity(model, data, (q[row] - angles) * signs) * signs
        np.testing.assert_allclose(kinematics.gravity_torque(own.nominal, q[row : row + 1])[0], expected, atol=2.0)
    np.testing.assert_allclose(own.lower, ROBOT.lower, atol=1e-9)
    np.testing.assert_allclose(own.upper, ROBOT.upper, atol=1e-9)
    moved = ", ".join(f"A{joint} {angle}°" for joint, angle in enumerate(zero, 1) if angle)
    assert f"the URDF's zero position is not KUKA's, but {moved} there: angles and limits are changed" in added.notes


def test_the_name_that_is_given_is_the_title_in_reports():
    added = add_robot(written(renamed("kuka_kr270", "kr270")), "mine")
    assert robot.load(added.folder).title == "mine"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<robot name="', '<xacro:include filename="x"/><robot name="', "Expand it first"),
        ('<link name="tool0"/>', '<link name="hand"/>', "names link 'tool0'"),
        ('"joint_6" type="revolute"', '"joint_6" type="fixed"', "5 revolute joints in series"),
        ('velocity="1.4660765716752369"', 'velocity="0"', "limits of joint joint_2 are missing or impossible"),
        ('"joint_2" type="revolute"', '"joint_2" type="prismatic"', "joint_2 is prismatic"),
        ('<axis xyz="0.0 1.0 0.0"/>', '<axis xyz="0 0 1"/>', "the axis of A2 is 90° off that of a KUKA arm"),
    ],
)  # fmt: skip
def test_an_arm_that_cannot_be_taken_over_is_told_and_nothing_is_written(old, new, message):
    text = ros_urdf(ROBOT, SIGNS[0])
    assert old in text
    with pytest.raises(ModelError, match=message):
        add_robot(written(text.replace(old, new, 1)), "mine")
    assert not Path("mine").exists()


def test_a_link_of_a_gripper_or_of_the_floor_is_not_taken_for_the_flange_or_the_root():
    text = ros_urdf(ROBOT, SIGNS[0])
    more = (
        '<link name="gripper_tool0"/><link name="table_base"/><joint name="g" type="fixed"><parent link="tool0"/>'
        '<child link="gripper_tool0"/><origin xyz="0 0 0.2"/></joint><joint name="t" type="fixed">'
        '<parent link="world"/><child link="table_base"/><origin xyz="1 0 0"/></joint></robot>'
    )
    added = robot.load(add_robot(written(text.replace("</robot>", more)), "mine").folder)
    np.testing.assert_allclose(added.nominal.placement, ROBOT.nominal.placement, atol=1e-9)
    ambiguous = text.replace("</robot>", more).replace('"tool0"', '"kr_tool0"')
    with pytest.raises(ModelError, match="several links could be tool0: kr_tool0, gripper_tool0"):
        add_robot(written(ambiguous), "other")


def test_a_flange_that_is_turned_about_its_axis_is_told_and_kukas_is_taken():
    text = ros_urdf(ROBOT, SIGNS[0])
    turned = text.replace('<parent link="flange"/><child link="tool0"/>', '<parent link="flange"/><child link="mid"/>')
    turned = turned.replace(
        "</robot>",
        '<link name="mid"/><joint name="m" type="fixed"><parent link="mid"/><child link="tool0"/>'
        '<origin xyz="0 0 0" rpy="0 0 1.0471975511965976"/></joint></robot>',
    )
    added = add_robot(written(turned), "mine")
    assert [note for note in added.notes if "against KUKA's flange by 60°" in note]
    np.testing.assert_allclose(robot.load(added.folder).nominal.flange, ROBOT.nominal.flange, atol=1e-9)


@pytest.mark.parametrize("name", ["kuka_kr270", "kuka_kr16_2", "kuka_kr120_r2700_2"])
def test_the_urdf_of_a_shipped_model_is_read_with_z_of_its_flange_pointing_out(name):
    shipped = robot.find(name)
    added = robot.load(add_robot(shipped / "robot.urdf", "mine").folder).nominal
    angles = np.radians([[0, -90, 90, 0, 0, 0], [30, -70, 110, 40, 50, -20]])
    expected = robot.load(shipped).nominal.joint_frames(angles)[1]
    np.testing.assert_allclose(added.joint_frames(angles)[1], expected, atol=1e-9)


def test_line_ends_and_byte_order_mark_of_windows_are_read():
    text = ros_urdf(ROBOT, SIGNS[0])
    Path("arm.urdf").write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert robot.load(add_robot(Path("arm.urdf"), "mine").folder).title == "mine"


def test_a_wrist_whose_axes_do_not_cross_is_refused():
    text = ros_urdf(ROBOT, SIGNS[0])
    shifted = text.replace('xyz="0.230000000000 0.000000000000', 'xyz="0.230000000000 0.100000000000')
    assert shifted != text
    with pytest.raises(ModelError, match="spherical wrist"):
        add_robot(written(shifted), "mine")


def test_a_model_that_is_there_is_replaced_with_overwrite_only():
    path = written(ros_urdf(ROBOT, SIGNS[0]))
    add_robot(path, "mine")
    Path("mine/model.toml").write_text("# my own numbers\n")
    with pytest.raises(InputError, match="holds a robot model already"):
        add_robot(path, "mine")
    assert Path("mine/model.toml").read_text() == "# my own numbers\n"
    add_robot(path, "mine", overwrite=True)
    assert robot.load("mine").title == "mine"


@pytest.mark.parametrize("name", ["kuka_kr270", "../up", "1st", ""])
def test_a_name_that_cannot_be_is_refused(name):
    path = written(ros_urdf(ROBOT, SIGNS[0]))
    if name == "":
        path.write_text(path.read_text().replace(TITLE, "270"))
    with pytest.raises(InputError, match=r"Give (another )?--name"):
        add_robot(path, name)


def test_the_command_tells_what_is_assumed_and_what_to_write_into_the_cell():
    path = written(ros_urdf(ROBOT, SIGNS[0]))
    done = run("robots", "add", path, "--name", "mine", "-o", "models/mine")
    assert "compliances are ASSUMED" in done.stderr
    assert 'robot = "models/mine"' in done.stdout
    assert invoke("robots", "models/mine").stdout.startswith("mine")


def test_speeds_have_a_source_of_their_own_where_they_are_not_the_robots():
    def shown(name):
        return {entry.name: entry for entry in robot.load(robot.find(name)).sources}

    assert shown("kuka_kr60_3")["joint speeds"].value == "128, 102, 128, 260, 245, 322 °/s"
    for name in ("kuka_kr270", "kuka_kr500_r2830"):
        assert shown(name)["joint speeds"].assumed
        assert not shown(name)["geometry, limits"].assumed
    same = shown("kuka_kr300_r2700_2")
    assert same["joint speeds"].source == same["geometry, limits"].source


def test_lengths_in_millimetres_are_refused():
    text = ros_urdf(ROBOT, SIGNS[0])
    numbers = re.compile(r'(?<=<origin xyz=")[^"]*')
    text = numbers.sub(lambda match: " ".join(f"{1e3 * float(word):g}" for word in match[0].split()), text)
    with pytest.raises(ModelError, match=r"reaches \S+ m. Lengths of a URDF are in metres"):
        add_robot(written(text), "mine")
