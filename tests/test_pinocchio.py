"""The kernels against Pinocchio, the authority: every robot, configuration, payload, calibrated geometry and spring."""

from __future__ import annotations

import msgspec
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from postproc import files, kinematics, robot
from postproc.errors import ModelError
from postproc.robot import LINK_AXES, Displacement, LinkSprings, ModelFile, urdf
from tests.kr270 import OFFSET_TOOL
from tests.oracle.pinocchio_arm import JOINTS, Arm

FOLDERS = robot.shipped_models()
URDF = {name: (folder / "robot.urdf").read_text(encoding="utf-8") for name, folder in FOLDERS.items()}
CONTENT = {name: files.read_toml(folder / "model.toml", ModelFile, ModelError) for name, folder in FOLDERS.items()}
SEEDS = st.integers(0, 2**32 - 1)
MANY = settings(max_examples=30, deadline=None)


def origin(rng):
    x, y, z, r, p, w = rng.uniform(-1, 1, 6)
    return f'<origin xyz="{x} {y} {z}" rpy="{3 * r} {p} {3 * w}"/>'


def any_urdf(rng):
    """Six revolute joints with any placement, axis and mass; fixed joints before, behind and beside them."""
    text = ['<robot name="any"><link name="world"/><link name="link_0"/>']
    text.append(f'<joint name="f" type="fixed"><parent link="world"/><child link="link_0"/>{origin(rng)}</joint>')
    for n, name in enumerate(JOINTS, 1):
        axis = " ".join(str(v) for v in (np.eye(3)[rng.integers(3)] if rng.random() < 0.5 else rng.normal(size=3)))
        inertial = (
            f'<inertial>{origin(rng)}<mass value="{rng.uniform(1, 300)}"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        )
        text.append(f'<link name="link_{n}">{inertial}</link><link name="side_{n}">{inertial}</link>')
        text.append(
            f'<joint name="s{n}" type="fixed"><parent link="link_{n}"/><child link="side_{n}"/>{origin(rng)}</joint>'
            f'<joint name="{name}" type="revolute"><parent link="link_{n - 1}"/><child link="link_{n}"/>{origin(rng)}'
            f'<axis xyz="{axis}"/><limit lower="-{n}" upper="{n}.5" velocity="{n}" effort="{10 * n}"/></joint>'
        )
    text.append('<link name="adapter"/><link name="flange"/>')
    for n, (parent, child) in enumerate((("link_6", "adapter"), ("adapter", "flange"))):
        text.append(
            f'<joint name="e{n}" type="fixed"><parent link="{parent}"/><child link="{child}"/>{origin(rng)}</joint>'
        )
    return "".join(text) + "</robot>"


def assert_equal(chain, arm, q, tool=OFFSET_TOOL):
    pose, jacobian = kinematics.tcp(chain, q, tool)
    expected_pose, expected_jacobian = arm.tcp(q, tool)
    np.testing.assert_allclose(pose, expected_pose, rtol=0, atol=1e-12)
    np.testing.assert_allclose(jacobian, expected_jacobian, rtol=0, atol=1e-12)
    gravity = arm.gravity(q)
    scale = max(1.0, np.abs(gravity).max())
    np.testing.assert_allclose(kinematics.gravity_torque(chain, q) / scale, gravity / scale, rtol=0, atol=1e-12)


@MANY
@given(SEEDS)
def test_the_reader_and_the_kernels_equal_pinocchio_on_any_six_joints_in_series(seed):
    rng = np.random.default_rng(seed)
    text = any_urdf(rng)
    chain, arm = urdf.read(text, "any.urdf"), Arm(text)
    assert_equal(chain, arm, rng.uniform(-7, 7, (3, 6)))
    model = arm.model
    for values, n in ((chain.lower, -1.0), (chain.upper, 1.0)):
        assert np.sign(values).tolist() == [n] * 6
    np.testing.assert_array_equal(chain.effort, 10.0 * np.arange(1, 7))
    np.testing.assert_allclose(chain.mass, [inertia.mass for inertia in list(model.inertias)[1:]], rtol=1e-12)


def changed(rng, name):
    """A robot with calibrated geometry, springs of links and a payload; the same by Pinocchio; its coordinates."""
    content = CONTENT[name]
    places = [place for place in (*JOINTS, "flange") if rng.random() < 0.6]
    shift = {place: (rng.normal(size=3) * 1e-3, rng.normal(size=3) * 1e-3) for place in places}
    geometry = {
        place: Displacement(
            source="test",
            **dict(zip(("X_mm", "Y_mm", "Z_mm"), (move * 1e3).tolist(), strict=True)),
            **dict(zip(("RX_deg", "RY_deg", "RZ_deg"), np.degrees(turn).tolist(), strict=True)),
        )
        for place, (move, turn) in shift.items()
    }
    springs = [
        (link, axis) for link in ("base", *JOINTS) for axis in LINK_AXES if rng.random() < rng.choice([0, 0.3, 1])
    ]
    links = {
        link: LinkSprings(
            source="test",
            **{
                f"{axis}_{'um_per_N' if axis in 'XYZ' else 'urad_per_Nm'}": 0.1
                for other, axis in springs
                if other == link
            },
        )
        for link in {link for link, _ in springs}
    }
    content = msgspec.structs.replace(content, geometry=geometry, links=links)
    payload = (float(rng.uniform(1, 200)), rng.normal(size=3) * 0.3)
    model = robot.assemble(name, content, urdf.read(URDF[name], name)).with_payload(*payload)
    arm = Arm(URDF[name], shift, springs, payload)
    q = rng.normal(size=(3, model.actual.nv)) * 1e-3
    q[:, list(model.actuated)] = rng.uniform(model.lower, model.upper, (3, 6))
    return model, arm, q


@MANY
@given(SEEDS, st.sampled_from(sorted(URDF)))
def test_calibrated_geometry_springs_and_payload_equal_pinocchio(seed, name):
    rng = np.random.default_rng(seed)
    model, arm, q = changed(rng, name)
    assert list(model.actuated) == arm.actuated
    assert_equal(model.loaded, arm, q)
    assert_equal(model.nominal, Arm(URDF[name]), q[:, list(model.actuated)])
    nothing = replace(model, loaded=model.actual).with_payload(0.0, np.zeros(3))
    assert nothing.loaded is model.actual


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.sampled_from(sorted(URDF)))
def test_the_stiffness_of_load_and_weights_equals_pinocchios_hessian(seed, name):
    rng = np.random.default_rng(seed)
    model, arm, q = changed(rng, name)
    wrench = rng.normal(size=(len(q), 6)) * [500, 500, 500, 50, 50, 50]
    expected = arm.load_stiffness(q, OFFSET_TOOL, wrench)
    _, jacobian = kinematics.tcp(model.loaded, q, OFFSET_TOOL)
    np.testing.assert_allclose(kinematics.load_stiffness(jacobian, wrench), expected, rtol=0, atol=1e-9)


def spherical_arm(rng):
    """An arm of the class that has a closed form: any lengths, directions, zero positions and signs of the axes."""
    heading, bend = rng.uniform(-3, 3), rng.choice([0.0, rng.uniform(-1, 1)])
    tilts = rng.uniform(-3, 3, 2)
    a1, c2, c3, c4, side = *rng.uniform(0.1, 1.2, 4), rng.uniform(-0.05, 0.05)
    turned = rng.uniform(-3, 3)  # of the wrist's second axis about the forearm at zero
    ahead, up = np.array([np.cos(heading), np.sin(heading), 0.0]), np.array([0.0, 0.0, 1.0])
    across = np.cross(up, ahead)
    bar = [np.sin(t) * ahead + np.cos(t) * up for t in tilts]
    fore = np.cross(across, bar[1])
    second = np.cos(turned) * across + np.sin(turned) * fore
    hand = np.cos(bend) * bar[1] + np.sin(bend) * np.cross(second, bar[1])
    elbow_offset = rng.uniform(-0.1, 0.1)
    shoulder = rng.uniform(-0.5, 0.5) * up + a1 * ahead
    elbow = shoulder + c2 * bar[0]
    wrist = elbow + c3 * bar[1] + elbow_offset * fore + side * across
    along = wrist + rng.uniform(-0.2, 0.2) * second  # each joint lies anywhere on its axis
    points = np.array([[0, 0, 0.1], shoulder, elbow, wrist - 0.3 * bar[1], along, wrist + c4 * hand])
    points = points + rng.uniform(-0.5, 0.5, 3)  # A1 does not go through the root
    axes = [up, across, across, bar[1], second, hand]
    signs = rng.choice([-1.0, 1.0], 6)
    text = ['<robot name="arm"><link name="link_0"/><link name="flange"/>']
    for n, name in enumerate(JOINTS, 1):
        step = points[n - 1] - (points[n - 2] if n > 1 else 0.0)
        text.append(
            f'<link name="link_{n}"/><joint name="{name}" type="revolute"><parent link="link_{n - 1}"/>'
            f'<child link="link_{n}"/><origin xyz="{" ".join(map(repr, map(float, step)))}"/>'
            f'<axis xyz="{" ".join(map(repr, map(float, signs[n - 1] * axes[n - 1])))}"/>'
            '<limit lower="-3" upper="3" velocity="1" effort="0"/></joint>'
        )
    text.append(f'<joint name="e" type="fixed"><parent link="link_6"/><child link="flange"/>{origin(rng)}</joint>')
    return "".join(text) + "</robot>"


@MANY
@given(SEEDS)
def test_every_branch_of_the_closed_form_of_any_arm_with_spherical_wrist_stands_at_the_pose(seed):
    rng = np.random.default_rng(seed)
    text = spherical_arm(rng)
    model = robot.assemble("arm", CONTENT["kuka_kr270"], urdf.read(text, "arm.urdf"))
    form, arm = kinematics.closed_form(model), Arm(text)
    q = rng.uniform(-2.5, 2.5, (20, 6))
    pose, _ = arm.tcp(q, np.eye(4))
    branches = form.branches(pose)
    exists = np.isfinite(branches).all(axis=2)
    own = form.branch_of(q)
    for branch in range(8):
        rows = np.flatnonzero(exists[:, branch])
        if len(rows):
            np.testing.assert_allclose(arm.tcp(branches[rows, branch], np.eye(4))[0], pose[rows], rtol=0, atol=1e-11)
        assert (form.branch_of(branches[rows, branch]) == branch).all()
    apart = branches[np.arange(len(q)), own] - q
    np.testing.assert_allclose((apart + np.pi) % (2 * np.pi) - np.pi, 0.0, atol=1e-7)
    assert exists[:, :4].sum() % 2 == 0
    np.testing.assert_array_equal(exists[:, :4], exists[:, 4:])
