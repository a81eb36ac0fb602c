"""The strict reader of robot.urdf: what is not a six-axis arm is refused, and the message names what is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from postproc import frames
from postproc.errors import ModelError
from postproc.robot import urdf
from tests.kr270 import FOLDER

TEXT = (FOLDER / "robot.urdf").read_text(encoding="utf-8")
LIMIT = '<limit lower="-1" upper="1" velocity="1" effort="0"/>'


def test_numbers_of_the_file_are_those_of_the_chain():
    chain = urdf.read(TEXT, "robot.urdf")
    np.testing.assert_array_equal(chain.placement[:, :3, 3], [
        [0, 0, 0.75], [0.35, 0, 0], [1.25, 0, 0], [0, 0, -0.055], [1.1, 0, 0], [0.23, 0, 0],
    ])  # fmt: skip
    np.testing.assert_array_equal(chain.axis, [[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]])
    np.testing.assert_array_equal(chain.mass, [367.4, 232.1, 191.5, 47.9, 23.7, 12.2])
    np.testing.assert_allclose(frames.xyzabc_from_pose(chain.flange), [0, 0, 0, 0, 90, 0], atol=1e-12)
    np.testing.assert_allclose(np.degrees(chain.lower), [-185, -146, -119, -350, -125, -350])


def test_roll_pitch_and_yaw_turn_in_the_order_of_the_specification():
    text = TEXT.replace('rpy="0 1.5707963267948966 0"', 'rpy="0.3 0.2 0.1"')
    expected = frames.pose_from_xyzabc(np.degrees([0, 0, 0, 0.1, 0.2, 0.3]))
    np.testing.assert_allclose(urdf.read(text, "robot.urdf").flange, expected, atol=1e-15)


@pytest.mark.parametrize("turns", [-2, -1, 0, 1, 2])
@pytest.mark.parametrize(("error", "rest"), [(4e-6, 0.0), (2e-3, 2e-3)])
def test_rounded_right_angles_of_other_peoples_files_are_exact(turns, error, rest):
    """ROS files have them with few digits; 2 mrad are a deliberate angle. Our own files are taken as they are."""
    text = TEXT.replace('rpy="0 1.5707963267948966 0"', f'rpy="{turns * np.pi / 2 + error} 0 0"')
    for flange, deviation in (
        (urdf.read_any(text, "robot.urdf").frames["flange"][1], rest),
        (urdf.read(text, "robot.urdf").flange, error),
    ):
        angle = turns * np.pi / 2 + deviation
        np.testing.assert_allclose(flange[1:3, 1], [np.cos(angle), np.sin(angle)], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</robot>", "", "not a URDF"),
        ('<robot name="kuka_kr270">', '<robot name="kuka_kr270"/><robot>', "not a URDF"),
        ('name="A3" type="revolute"', 'name="A3" type="prismatic"', "joint A3 is prismatic"),
        ('name="A3" type="revolute"', 'name="A3" type="continuous"', "joint A3 is continuous"),
        ('name="A6"', 'name="A7"', "joints are A1, A2, A3, A4, A5, A7"),
        ('name="A6" type="revolute"', 'name="A6" type="fixed"', "joints are A1, A2, A3, A4, A5"),
        ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1"/><mimic joint="A2"/>', "joint A1 is a mimic"),
        ('<parent link="link_5"/>', '<parent link="link_4"/>', "joint A6 is parallel to A5"),
        ('<parent link="link_5"/>', '<parent link="link_9"/>', "joint A6 names link 'link_9'"),
        ('<parent link="link_5"/>', "", "joint A6 has no <parent>"),
        ('<child link="flange"/>', '<child link="base_link"/>', "not one tree"),
        ('<link name="flange"/>', '<link name="flange"/><link name="loose"/>', "not one tree"),
        ('<link name="flange"/>', '<link name="flange"/><link name="flange"/>', "the same name"),
        ('"flange"', '"tool0"', "no link named 'flange'"),
        ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 0"/>', "joint A1 has no axis"),
        ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0"/>', "3 numbers expected"),
        ('xyz="0.35 0 0"', 'xyz="0.35 0 zero"', "3 numbers expected"),
        ('xyz="0.35 0 0"', 'xyz="nan 0 0"', "not finite"),
        ('<mass value="47.9"/>', '<mass value="-1"/>', "negative mass"),
        ('<mass value="47.9"/>', "", "inertial has no <mass>"),
        ('upper="0"', 'upper="-3"', "limits of joint A2 are missing or impossible"),
        ('velocity="3.211405823669566"', "", "limits of joint A6 are missing or impossible"),
    ],
)
def test_what_is_not_a_six_axis_arm_is_refused(old, new, message):
    assert old in TEXT
    with pytest.raises(ModelError, match=message) as found:
        urdf.read(TEXT.replace(old, new), "robot.urdf")
    assert "robot.urdf" in str(found.value)


def test_what_moves_beside_the_arm_is_refused():
    gripper = (
        f'<link name="jaw"/><joint name="G" type="revolute"><parent link="flange"/><child link="jaw"/>{LIMIT}</joint>'
    )
    with pytest.raises(ModelError, match="A6, G"):
        urdf.read(TEXT.replace("</robot>", gripper + "</robot>"), "robot.urdf")
