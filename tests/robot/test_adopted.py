"""An arm of others in KUKA's form: numbers of the chain, assumed values, and arms that are none of KUKA's."""

from __future__ import annotations

import re

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import robot
from postproc.errors import ModelError
from postproc.frames import rotation_from_vector
from postproc.robot import urdf
from postproc.robot.from_urdf import adopt
from tests.kr270 import ROBOT
from tests.robot_urdfs import ros_urdf

DRAWN = ["kuka_kr270", "kuka_kr240_r2900_2", "kuka_kr500_r2830"]
"""Models whose joints are where the drawings give dimensions of."""
SIGNS = ((1, 1, 1, 1, 1, 1), (-1, 1, -1, 1, -1, 1), (1, -1, 1, -1, 1, -1))


def arm(model=ROBOT, **changes):
    """The robot with other fields of its nominal chain."""
    return replace(model, nominal=replace(model.nominal, **changes))


def placed(joint: int, xyz) -> np.ndarray:
    """Placements of the KR 270 with another place of one joint [m]."""
    placement = ROBOT.nominal.placement.copy()
    placement[joint, :3, 3] = xyz
    return placement


@pytest.mark.parametrize("name", DRAWN)
@pytest.mark.parametrize("signs", SIGNS)
@pytest.mark.parametrize("zero", [(0, 0, 0, 0, 0, 0), (150, -90, 90, -20, 45, 0), (-100, 20, -30, 80, -70, 0)])
def test_an_arm_with_frames_anywhere_on_its_axes_has_the_numbers_of_the_shipped_model(name, signs, zero):
    model = robot.load(robot.find(name))
    text = ros_urdf(model, signs, np.random.default_rng(8), zero=np.radians(zero))
    chain = adopt(text, "arm.urdf").chain
    np.testing.assert_allclose(chain.placement, model.nominal.placement, atol=1.5e-7)
    np.testing.assert_allclose(chain.flange, model.nominal.flange, atol=1.5e-7)
    np.testing.assert_allclose(chain.centre, model.nominal.centre, atol=0.6e-4)  # kept to 0.1 mm
    np.testing.assert_array_equal(chain.axis, model.nominal.axis)
    np.testing.assert_allclose(chain.mass, model.nominal.mass)
    for limit in ("lower", "upper", "speed"):
        np.testing.assert_allclose(getattr(chain, limit), getattr(model.nominal, limit), atol=1e-9)
    np.testing.assert_array_equal(chain.effort, 7.0)


@pytest.mark.parametrize("signs", SIGNS)
def test_frames_of_the_file_are_given_in_those_that_replace_them(signs):
    """A point of each link of the file, in the root by the file's chain and by the adopted one, at zero of both."""
    text = ros_urdf(ROBOT, signs, np.random.default_rng(3))
    adopted, source = adopt(text, "arm.urdf"), urdf.read_any(text, "arm.urdf")
    base = source.frames["base"][1]
    of_file = np.linalg.inv(base) @ np.concatenate([[np.eye(4)], source.chain.joint_frames(np.zeros((1, 6)))[0][0]])
    of_adopted = np.concatenate([[np.eye(4)], adopted.chain.joint_frames(np.zeros((1, 6)))[0][0]])
    np.testing.assert_allclose(of_adopted @ adopted.moved, of_file, atol=1e-6)


def test_the_file_that_is_written_is_read_as_the_same_chain():
    source = arm(lower=np.radians([-185.0, -146, -119, -350, -125, -350]))
    adopted = adopt(ros_urdf(source, SIGNS[1], np.random.default_rng(2)), "arm.urdf", "a & b")
    shapes = {(-1, "visual"): "base.stl", (2, "visual"): "two.stl", (2, "collision"): "three.stl"}
    text = adopted.urdf(shapes).decode()
    chain = urdf.read(text, "robot.urdf")
    for field in ("placement", "axis", "flange", "mass", "centre", "lower", "upper", "speed", "effort"):
        np.testing.assert_allclose(getattr(chain, field), getattr(adopted.chain, field), atol=1e-9)
    named = [(g.carrier, "visual" if g.drawn else "collision", g.file) for g in urdf.geometries(text, "robot.urdf")]
    assert named == [(-1, "visual", "base.stl"), (2, "visual", "two.stl"), (2, "collision", "three.stl")]
    assert 'name="a &amp; b"' in text
    assert not re.search(r'[" ]-0[" ]', text)


def with_reach(factor: float) -> str:
    """The KR 270 with all lengths times a factor."""
    placement, flange = ROBOT.nominal.placement.copy(), ROBOT.nominal.flange.copy()
    placement[:, :3, 3] *= factor
    flange[:3, 3] *= factor
    model = arm(placement=placement, flange=flange)
    return ros_urdf(model, SIGNS[0]).replace(f'<robot name="{model.title}">', '<robot name="arm">')


REACH = 0.35 + 1.25 + np.hypot(1.1, 0.055)


@pytest.mark.parametrize("factor", [0.05, 0.4, 0.99, 1.01, 7.0])
def test_compliances_of_a_smaller_arm_grow_with_the_cube_of_its_size(factor):
    adopted = adopt(with_reach(factor), "arm.urdf")
    for joint, compliance in zip(robot.JOINTS, (0.623, 0.302, 0.416, 2.786, 3.483, 2.074), strict=True):
        spring = adopted.content.joints[joint]
        assert spring.compliance_urad_per_Nm == float(f"{compliance * max(1.0, factor**-3):.2g}")
        assert (spring.sigma_percent, spring.scaled_from, spring.assumed) == (40.0, "kuka_kr270", True)
    note = next(note for note in adopted.notes if note.startswith("compliances are ASSUMED"))
    words = f"{1e3 * REACH:.0f} to {1e3 * factor * REACH:.0f} mm" if factor < 1.0 else "unchanged, since the payload"
    assert words in note


@pytest.mark.parametrize(("reach", "is_arm"), [(0.099, False), (0.101, True), (19.9, True), (20.1, False)])
def test_only_lengths_that_an_arm_has_are_taken(reach, is_arm):
    text = with_reach(reach / REACH)
    if is_arm:
        source = adopt(text, "arm.urdf").content.geometry_nominal.source
        assert source == f"arm.urdf, reach of the wrist {1e3 * reach:.0f} mm"
        return
    with pytest.raises(ModelError, match="the wrist reaches"):
        adopt(text, "arm.urdf")


@pytest.mark.parametrize(
    ("name", "usual"), [("arm", 46.0 * REACH**3), ("KR 210 L150", 12.0 * (150.0 * REACH) ** 0.69)], ids=["arm", "KR"]
)
@pytest.mark.parametrize(("share", "is_believed"), [(0.49, False), (0.51, True), (1.99, True), (2.01, False)])
def test_masses_are_believed_within_a_factor_of_two_of_those_of_the_size(name, usual, share, is_believed):
    total = share * usual
    model = arm(mass=ROBOT.nominal.mass * total / ROBOT.nominal.mass.sum())
    text = ros_urdf(model, SIGNS[0]).replace(f'<robot name="{model.title}">', f'<robot name="{name}">')
    adopted = adopt(text, "arm.urdf")
    assert adopted.content.masses.assumed is not is_believed
    size = ("" if name == "arm" else "150 kg payload, ") + f"reach {1e3 * REACH:.0f} mm"
    note = f"the links weigh {total:.0f} kg; arms of this size ({size}) have about {usual:.2g} kg without the base. "
    assert any(line.startswith(note) for line in adopted.notes) is not is_believed


def test_links_without_a_mass_are_named_and_the_masses_assumed():
    mass = ROBOT.nominal.mass * [1, 1, 1, 0.5, 1, 1]
    mass[[4, 5]] = 0.0099, 0.0
    adopted = adopt(ros_urdf(arm(mass=mass), SIGNS[0]), "arm.urdf")
    assert adopted.content.masses.assumed
    assert any(note.startswith("A5, A6 carry no mass: give <inertial>") for note in adopted.notes)
    np.testing.assert_array_equal(adopted.chain.mass[4:], 0.0)
    np.testing.assert_array_equal(adopted.chain.centre[4:], 0.0)
    mass[:] = 0.0
    none = adopt(ros_urdf(arm(mass=mass), SIGNS[0]), "arm.urdf")
    assert (none.content.masses.source, none.content.masses.assumed) == ("arm.urdf: none given", True)
    assert not any("carry no mass" in note for note in none.notes)


def test_an_arm_whose_a2_crosses_a1_is_turned_to_the_front_by_the_axis_of_a2():
    for signs in SIGNS:
        upright = arm(placement=placed(1, [0.0, 0.0, 0.0]))
        chain = adopt(ros_urdf(upright, signs, zero=np.radians([30.0, 0, 0, 0, 0, 0])), "arm.urdf").chain
        np.testing.assert_allclose(chain.placement, upright.nominal.placement, atol=1.5e-7)


def test_an_arm_beside_the_root_keeps_its_place():
    for signs in SIGNS:
        beside = arm(placement=placed(0, [0.6, -0.4, 0.75]))
        text = ros_urdf(beside, signs, np.random.default_rng(1), zero=np.radians([150.0, -90, 90, 0, 0, 0]))
        np.testing.assert_allclose(adopt(text, "arm.urdf").chain.placement, beside.nominal.placement, atol=1.5e-7)


def turned(joint: int, vector) -> np.ndarray:
    """Placements of the KR 270 with the frame of one joint turned [rad]."""
    placement = ROBOT.nominal.placement.copy()
    placement[joint, :3, :3] = rotation_from_vector(np.array(vector, dtype=float))
    return placement


def translation(x, y, z) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


FLANGE = ROBOT.nominal.flange


def tilted(angle: float) -> np.ndarray:
    """The flange of the KR 270 turned about Z of the root [rad]."""
    turn = np.eye(4)
    turn[:3, :3] = rotation_from_vector(np.array([0.0, 0.0, angle]))
    return turn @ FLANGE


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"placement": placed(2, [0.0, 0.0, 0.0])}, "cannot be stretched out along"),
        ({"placement": placed(2, [0.0, 0.4, 0.0])}, "cannot be stretched out along"),
        ({"flange": FLANGE @ translation(0, 0, -0.24)}, "cannot be stretched out along"),
        ({"placement": turned(1, [0.02, 0.0, 0.0])}, "the axis of A2 is 1.15° off that of a KUKA arm"),
        ({"placement": turned(3, [0.0, 0.0, 0.003])}, "the axis of A4 is 0.172° off that of a KUKA arm"),
        ({"flange": tilted(0.003)}, "does not point along"),
    ],
)  # fmt: skip
def test_an_arm_that_has_no_zero_position_of_kukas_is_refused(changes, message):
    with pytest.raises(ModelError, match=re.escape(message)):
        adopt(ros_urdf(arm(**changes), SIGNS[0]), "arm.urdf")


def test_axes_that_miss_kukas_by_less_than_a_milliradian_are_taken_for_them():
    for joint, vector in ((1, [8e-4, 0.0, 0.0]), (3, [0.0, 0.0, 8e-4])):
        np.testing.assert_array_equal(
            adopt(ros_urdf(arm(placement=turned(joint, vector)), SIGNS[0]), "arm.urdf").chain.axis, ROBOT.nominal.axis
        )


def test_a_flange_that_is_tilted_by_less_than_a_milliradian_is_straight():
    chain = adopt(ros_urdf(arm(flange=tilted(8e-4)), SIGNS[0]), "arm.urdf").chain
    np.testing.assert_allclose(chain.flange[:3, :3], FLANGE[:3, :3], atol=1e-15)


def test_an_arm_without_a_flange_is_refused():
    text = ros_urdf(ROBOT, SIGNS[0]).replace('"tool0"', '"hand"').replace('"flange"', '"plate"')
    with pytest.raises(ModelError, match="no link named tool0 or flange behind the last joint"):
        adopt(text, "arm.urdf")


def test_the_flange_is_taken_where_there_is_no_tool0_and_the_base_link_where_there_is_no_base():
    text = ros_urdf(ROBOT, SIGNS[0]).replace('"tool0"', '"hand"').replace('"base"', '"foot"')
    chain = adopt(text, "arm.urdf").chain
    np.testing.assert_allclose(chain.flange, ROBOT.nominal.flange, atol=1e-7)
    np.testing.assert_allclose(chain.placement, ROBOT.nominal.placement, atol=1e-7)
    neither = adopt(text.replace('"base_link"', '"socket"'), "arm.urdf").chain  # the first link: it is the floor's
    np.testing.assert_allclose(neither.placement[0, :3, 3], ROBOT.nominal.placement[0, :3, 3] + [2, 3, 1], atol=1e-7)


def test_the_payload_is_that_of_the_name_in_the_urdf_and_the_compensator_is_noted():
    """The title is the user's: "KR 16 of cell 3" must not make a KR 270 soft."""
    text = with_reach(1.0).replace('<robot name="arm">', '<robot name="KUKA KR 120 R2700-2">')
    named = adopt(text, "arm.urdf", "KR 16 of cell 3")
    assert named.content.name == "KR 16 of cell 3"
    expected = adopt(text, "arm.urdf").content.joints
    assert {joint: spring.compliance_urad_per_Nm for joint, spring in named.content.joints.items()} == {
        joint: spring.compliance_urad_per_Nm for joint, spring in expected.items()
    }
    assert "a gravity compensator, if the arm has one, is not in the model" in named.notes
