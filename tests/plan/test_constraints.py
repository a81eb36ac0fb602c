from __future__ import annotations

import numpy as np
import pytest
import trimesh

from postproc.errors import PlanError
from postproc.plan import constraints, search
from postproc.plan.sensitivity import direction
from tests.plan import setting
from tests.plan.setting import BASIC, RIG

STRAIGHT_UP = np.radians([[0.0, -90.0, 90.0, 0.0, 0.0, 0.0]])
DOWN = np.zeros((1, 2))


def failed(site, q, tilt=DOWN):
    return {name for name, rows in constraints.failures(site, q, tilt).items() if rows.all()}


def test_a_comfortable_pose_passes_everything(tmp_path):
    site = setting.site(tmp_path)
    q = np.radians([[-30.0, -80.0, 95.0, 40.0, 60.0, 20.0]])
    assert failed(site, q) == set()
    assert constraints.are_feasible(site, q, DOWN).all()


def test_random_poses_that_pass_keep_every_limit_by_an_independent_forward_kinematics(tmp_path):
    """Markers, load point, wrist and weight above the floor and out of the box; limits with margin; load in cone."""
    site = setting.site(tmp_path)
    rng = np.random.default_rng(0)
    q, tilt = search.draw_poses(site, 1500, rng)
    good = constraints.are_feasible(site, q, tilt)
    assert 0.05 < good.mean() < 0.9
    turn = np.radians(20)
    axes = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    low = np.radians([-185, -146, -119, -350, -125, -350]) + np.radians(5)
    for angles, down in zip(q[good][:60], direction(tilt[good])[:60], strict=True):
        frames = setting.ORACLE.frames(angles)
        hook = (frames[-1] @ [*setting.LOAD_POINT, 1.0])[:3]
        spots = [(frames[-1] @ [*p, 1.0])[:3] for p in setting.POINTS.values()]
        spots += [frames[4][:3, 3], hook, hook + 0.4 * down + [0, 0, -0.2]]
        for spot in spots:
            assert spot[2] > 0.0
            inside = np.abs(axes @ (spot - [1.9, 0.0, 0.35])) - [0.45, 0.6, 0.35]
            assert inside.max() > 0.0
        assert (angles >= low - 1e-9).all()
        assert np.degrees(np.arccos(-down[2])) <= 30.0 + 1e-9


def test_the_parts_of_the_arm_join_the_axes_of_an_independent_arm(tmp_path):
    site = setting.site(tmp_path)
    q = np.random.default_rng(4).uniform(-2, 2, (6, 6))
    parts = constraints.arm_parts(site, constraints.State.of(site, q, None))
    assert [part.name for part in parts] == ["column", "link 2", "elbow", "forearm", "hand"]
    for row, angles in enumerate(q):
        frames = setting.ORACLE.frames(angles)
        joints = [frame[:3, 3] for frame in frames]
        along = frames[3][:3, :3] @ setting.ORACLE.axes[3]
        foot = joints[3] + along * ((joints[2] - joints[3]) @ along)  # of A3 on the axis of A4
        corners = [np.zeros(3), joints[1], joints[2], foot, joints[4], frames[6][:3, 3]]
        for part, start, end in zip(parts, corners[:-1], corners[1:], strict=True):
            np.testing.assert_allclose(part.start[row], start, atol=1e-12)
            np.testing.assert_allclose(part.end[row], end, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "q", "expected"),
    [
        ("[floor]\nZ = 1500", [0.0, -20, 60, 0, 30, 0], "floor"),
        (
            "[[boxes]]\nname = 'press'\nX = 1400\nZ = 1800\nsize = [500, 500, 500]",
            [0.0, -80, 95, 0, 60, 0],
            "box press",
        ),
        ("[tracker]\nX = -4000\nY = 0\nZ = 1000", [0.0, -80, 95, 0, 60, 0], "line of sight to marker P1"),
    ],
)
def test_the_constraint_that_a_pose_breaks_is_named(tmp_path, text, q, expected):
    site = setting.site(tmp_path, BASIC + RIG + text + "\n")
    assert expected in failed(site, np.radians([q]))


def test_a_marker_is_seen_only_within_its_acceptance_angle(tmp_path):
    text = BASIC.replace("Z = 262\n", "Z = 262\nnormal = [0, 0, 1]\n") + RIG
    text += "[tracker]\nX = 6000\nY = 0\nZ = 2000\nacceptance_deg = 40\n"
    site = setting.site(tmp_path, text)
    ahead = np.radians([[0.0, -90.0, 90.0, 0.0, 0.0, 0.0]])  # the flange looks along +X, to the tracker
    aside = ahead + np.radians([[60.0, 0, 0, 0, 0, 0]])
    name = "acceptance angle of marker P1"
    assert name not in failed(site, ahead)
    assert name in failed(site, aside)


@pytest.mark.parametrize("payload_mass", [0.0, 90.0])
def test_static_torques_are_those_of_the_energy_of_weights_payload_spring_and_load(payload_mass, tmp_path):
    limits = "max_torque_Nm = [1e4, 1e4, 1e4, 1e4, 1e4, 600]\n"
    payload = f"[payload]\nmass_kg = {payload_mass}\nX = 40\nY = 30\nZ = 150\n" if payload_mass else ""
    site = setting.site(tmp_path, BASIC + RIG.rstrip() + "\n" + limits + payload)
    q = np.random.default_rng(4).uniform(-1.5, 1.5, (5, 6))
    tilt = np.full((5, 2), 0.2)
    state = constraints.State.of(site, q, tilt)
    force = site.rig.force * direction(tilt)
    tool, payload_centre = setting.in_flange(setting.LOAD_POINT), setting.in_flange([0.04, 0.03, 0.15])
    for row in range(5):

        def energy(x, row=row):
            arm = setting.ORACLE
            weight_energy = arm.weight_energy(x) + payload_mass * 9.81 * arm.tcp(x, payload_centre)[2, 3]
            return weight_energy + arm.spring_energy(x[1]) - force[row] @ arm.tcp(x, tool)[:3, 3]

        expected = setting.differences(energy, q[row])
        assert np.abs(constraints.torques(site, state)[row] - expected).max() < 1e-3
    heavy = np.abs(constraints.torques(site, state)[:, 5]) > 600
    assert (constraints.failures(site, q, tilt)["static torque of A6"] == heavy).all()


def test_a_mesh_of_the_cell_keeps_the_arm_out(tmp_path):
    trimesh.creation.box(extents=[500, 500, 500]).export(tmp_path / "press.stl")
    text = BASIC + RIG + '[[meshes]]\nfile = "press.stl"\nX = 1400\nZ = 1800\n'
    site = setting.site(tmp_path, text)
    assert "mesh press.stl" in failed(site, np.radians([[0.0, -80, 95, 0, 60, 0]]))
    assert "mesh press.stl" not in failed(site, np.radians([[90.0, -80, 95, 0, 60, 0]]))


@pytest.mark.parametrize(
    ("one_in", "found", "calls"),
    [
        (4, 100, 1),  # of 400 poses drawn at once
        (8, 100, 2),
        (200, 80, 40),  # as many as can be found in 40 rounds
        (0, 0, 10),  # none in 10: there are none
    ],
)
def test_poses_of_a_level_are_drawn_until_there_are_enough_or_none_seem_to_be_possible(
    tmp_path, monkeypatch, one_in, found, calls
):
    asked = []

    def feasible(_, q, __):
        asked.append(len(q))
        rows = np.arange(len(q))
        return rows % one_in == 0 if one_in else rows < 0

    monkeypatch.setattr(constraints, "are_feasible", feasible)
    q, tilt = search.draw_feasible_poses(setting.site(tmp_path), -1.0, 100, np.random.default_rng(0))
    assert (len(q), len(tilt), len(asked)) == (found, found, calls)
    assert (q[:, 1] == -1.0).all()


def test_constraints_that_leave_no_pose_say_which_one_blocks(tmp_path):
    text = BASIC.replace("Z = 262\n", "Z = 262\nnormal = [0, 0, 1]\n")
    text = text.replace("Z = 255\n", "Z = 255\nnormal = [0, 0, -1]\n")  # never both towards the tracker
    with pytest.raises(PlanError, match=r"acceptance angle of marker P[12] forbids"):
        setting.quick(tmp_path, text=text + RIG + "[tracker]\nX = 4000\nY = 0\nZ = 1500\nacceptance_deg = 40\n")
    with pytest.raises(PlanError, match=r"what blocks is: floor.*without it \d+ poses were possible"):
        setting.quick(tmp_path, text=BASIC + RIG + "[floor]\nZ = 5000\n")


def test_a_margin_larger_than_the_range_of_a_joint_names_the_joint(tmp_path):
    with pytest.raises(PlanError, match="nothing of the range of A2"):
        setting.site(tmp_path, margin=80.0)


def test_an_experiment_without_rig_says_what_to_give(tmp_path):
    with pytest.raises(PlanError, match=r"no \[rig\].*mass_kg"):
        setting.site(tmp_path, BASIC)


def test_the_coarse_shape_leaves_a_small_arm_room_too(tmp_path, monkeypatch):
    from postproc import robot

    monkeypatch.setattr(setting, "ROBOT", robot.load(robot.find("kuka_kr16_2")))
    site = setting.site(tmp_path, BASIC.replace("kr270", "kr16_2") + "\n[rig]\nmass_kg = 16\nmax_angle_deg = 30\n")
    assert constraints.are_feasible(site, *search.draw_poses(site, 500, np.random.default_rng(0))).mean() > 0.1


def test_the_forearm_begins_at_the_elbow_wherever_a_urdf_puts_the_origin_of_its_axis(tmp_path, monkeypatch):
    """That of the KR 16 is at the wrist; its arm by another chain."""
    from postproc import robot

    folder = robot.find("kuka_kr16_2")
    monkeypatch.setattr(setting, "ROBOT", robot.load(folder))
    arm = setting.Oracle.load(folder)
    site = setting.site(tmp_path, BASIC.replace("kr270", "kr16_2") + "\n[rig]\nmass_kg = 16\nmax_angle_deg = 30\n")
    q = np.random.default_rng(5).uniform(-1.5, 1.5, (5, 6))
    forearm = constraints.arm_parts(site, constraints.State.of(site, q, None))[3]
    for row, angles in enumerate(q):
        frames = arm.frames(angles)
        elbow, origin, wrist = (frames[joint][:3, 3] for joint in (2, 3, 4))
        along = frames[3][:3, :3] @ arm.axes[3]
        assert abs((elbow - origin) @ along) > 0.5
        np.testing.assert_allclose(forearm.end[row], wrist, atol=1e-12)
        # on the axis of A4, at right angles from the elbow
        np.testing.assert_allclose(np.cross(forearm.start[row] - origin, along), 0.0, atol=1e-12)
        assert (forearm.start[row] - elbow) @ along == pytest.approx(0.0, abs=1e-12)
