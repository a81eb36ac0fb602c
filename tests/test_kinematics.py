"""Kinematics: closed form against Pinocchio on many poses, derivatives against finite differences, S and T."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from postproc import frames, kinematics, robot
from postproc.errors import ModelError, PostprocError
from tests.kr270 import FOLDER, ROBOT, TURNED_TOOL
from tests.oracle.arm import Arm

STEP = 1e-6
OFFSET_AND_FOREARM = {
    "abb_irb6700_200_260": (-200, 1142.5),
    "kuka_kr120_r2700_2": (-115, 1220),
    "kuka_kr16_2": (35, 670),
    "kuka_kr210_r2700_2": (-115, 1220),
    "kuka_kr240_r2900_2": (-115, 1220),
    "kuka_kr270": (55, 1100),
    "kuka_kr300_r2700_2": (-115, 1220),
    "kuka_kr500_r2830": (55, 1025),
    "kuka_kr60_3": (-145, 820),
    "kuka_kr6_r900_2": (-25, 420),
}
"""Of the drawings: how far the axis of A4 lies below A3, and how far the wrist is from A3, mm."""


@pytest.fixture(scope="module", params=sorted(robot.shipped_models()))
def model(request):
    return robot.load(robot.find(request.param))


def followed(robot, flange, start, free, axis_target, status, turn):
    return kinematics.follow(
        robot, flange, start, is_ptp_target=free, axis_target=axis_target, status=status, turn=turn
    )


def by_wrist(robot, count, motion, joints, tip, base, tool):
    return kinematics.ByWrist.of(robot, count, motion=motion, joints=joints, tip=tip, base=base, tool=tool)


def test_forward_after_inverse_returns_20_000_random_poses(model):
    q = np.random.default_rng(1).uniform(model.lower, model.upper, (20_000, 6))
    pose, _ = kinematics.tcp(model.nominal, q, np.eye(4))
    branches = kinematics.closed_form(model).branches(pose)
    apart = np.abs((branches - q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=2)
    best = np.nanargmin(apart, axis=1)
    found = branches[np.arange(len(q)), best]
    back, _ = kinematics.tcp(model.nominal, found, np.eye(4))
    assert np.abs(back - pose).max() < 1e-9


def test_forward_kinematics_equals_the_oracle_read_from_the_urdf(model):
    arm = Arm.load(robot.find(model.name))
    q = np.random.default_rng(2).uniform(model.lower, model.upper, (20, 6))
    pose, _ = kinematics.tcp(model.nominal, q, TURNED_TOOL)
    np.testing.assert_allclose(pose, [arm.tcp(row, TURNED_TOOL) for row in q], atol=1e-12)


@pytest.mark.parametrize("count", [0, 64, 65, 67])
def test_many_configurations_at_once_are_each_what_they_are_alone(model, count):
    q = np.random.default_rng(6).uniform(model.lower, model.upper, (count, 6))
    together = (*kinematics.tcp(model.loaded, q, TURNED_TOOL), kinematics.gravity_torque(model.loaded, q))
    for row in range(count):
        one = q[row : row + 1]
        alone = (*kinematics.tcp(model.loaded, one, TURNED_TOOL), kinematics.gravity_torque(model.loaded, one))
        for one, all_ in zip(alone, together, strict=True):
            np.testing.assert_allclose(one[0], all_[row], rtol=1e-12, atol=1e-9)
    assert [len(part) for part in together] == [count] * 3


def test_flange_at_zero_is_stretched_along_x_with_kuka_orientation(model):
    pose, _ = kinematics.tcp(model.nominal, np.zeros((1, 6)), np.eye(4))
    np.testing.assert_allclose(frames.xyzabc_from_pose(pose)[0, 3:], [0.0, 90.0, 0.0], atol=1e-9)
    assert pose[0, 0, 3] > 0.9


def test_positive_a1_turns_clockwise_seen_from_above_and_positive_a2_lowers_the_arm(model):
    pose, _ = kinematics.tcp(model.nominal, np.radians([[10.0, 0, 0, 0, 0, 0], [0, 10.0, 0, 0, 0, 0]]), np.eye(4))
    rest, _ = kinematics.tcp(model.nominal, np.zeros((1, 6)), np.eye(4))
    assert pose[0, 1, 3] < -0.1
    assert pose[1, 2, 3] < rest[0, 2, 3]


def test_jacobian_equals_central_differences_of_the_pose(model):
    q = np.random.default_rng(3).uniform(model.lower, model.upper, (50, 6))
    _, jacobian = kinematics.tcp(model.nominal, q, TURNED_TOOL)
    for joint in range(6):
        change = np.eye(6)[joint] * STEP
        plus, minus = (kinematics.tcp(model.nominal, q + sign * change, TURNED_TOOL)[0] for sign in (1, -1))
        np.testing.assert_allclose(frames.twist_between(minus, plus) / (2 * STEP), jacobian[:, :, joint], atol=1e-8)


def test_load_stiffness_equals_differences_of_the_joint_torques_of_a_dead_load(model):
    rng = np.random.default_rng(4)
    q, wrench = rng.uniform(model.lower, model.upper, (50, 6)), rng.normal(size=(50, 6))
    _, jacobian = kinematics.tcp(model.nominal, q, TURNED_TOOL)
    hessian = kinematics.load_stiffness(jacobian, wrench)
    for joint in range(6):
        change = np.eye(6)[joint] * STEP
        plus, minus = (kinematics.tcp(model.nominal, q + sign * change, TURNED_TOOL)[1] for sign in (1, -1))
        slope = np.einsum("nij,ni->nj", (plus - minus) / (2 * STEP), wrench)
        np.testing.assert_allclose(slope, hessian[:, :, joint], atol=1e-8)


def test_gravity_torque_and_stiffness_are_derivatives_of_the_potential_energy(model):
    arm = Arm.load(robot.find(model.name))
    q = np.random.default_rng(5).uniform(model.lower, model.upper, (10, 6))
    expected = [arm.gradient(arm.weight_energy, row) for row in q]
    np.testing.assert_allclose(kinematics.gravity_torque(model.loaded, q), expected, atol=1e-8)
    stiffness = kinematics.gravity_stiffness(model.loaded, q)
    for joint in range(6):
        change = np.eye(6)[joint] * STEP
        slope = kinematics.gravity_torque(model.loaded, q + change) - kinematics.gravity_torque(
            model.loaded, q - change
        )
        np.testing.assert_allclose(slope / (2 * STEP), stiffness[:, :, joint], atol=1e-4)


def test_status_and_turn_of_the_usual_home_position_are_2_and_the_signs_of_the_axes(model):
    q = np.radians([[0, -90, 90, 0, 10, 0], [0, -90, 90, 0, -10, 0], [5, -90, -50, 0, 20, -1.0]])
    np.testing.assert_array_equal(kinematics.status_of(model, q), [2, 6, 1])
    np.testing.assert_array_equal(kinematics.turn_of(q), [0b000010, 0b010010, 0b100110])


def test_status_and_branch_are_those_of_the_posture_where_joint_2_turns_the_other_way(tmp_path):
    text = (FOLDER / "robot.urdf").read_text(encoding="utf-8")
    (tmp_path / "robot.urdf").write_text(
        text.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>', 1), encoding="utf-8"
    )
    (tmp_path / "model.toml").write_bytes((FOLDER / "model.toml").read_bytes())
    reversed_robot = robot.load(tmp_path)
    q = np.radians([[5, -90, 90, 0, 10, 0], [5, -70, 100, 30, -40, 20], [5, -90, -50, 0, 20, -1.0]])
    reversed_q = q * [1, -1, 1, 1, 1, 1]
    assert kinematics.status_of(reversed_robot, reversed_q).tolist() == [2, 6, 1]
    poses = np.array([Arm.load(FOLDER).nominal_tcp(row, np.eye(4)) for row in q])
    solution = kinematics.branch_joints(reversed_robot, poses, np.array([2, 6, 1]))
    np.testing.assert_allclose(solution, reversed_q, rtol=0, atol=1e-9)


def test_status_bit_1_changes_where_the_wrist_centre_crosses_the_line_through_axes_2_and_3(model):
    edge = kinematics.closed_form(model).stretched_elbow_angle
    offset, forearm = OFFSET_AND_FOREARM[model.name]
    assert np.degrees(edge) == pytest.approx(-np.degrees(np.arctan2(offset, forearm)), abs=1e-6)
    q = np.array([[0, -0.5, edge + away, 0, 0.3, 0] for away in (1e-4, 0.0, -1e-4)])
    assert (kinematics.status_of(model, q) & 2).tolist() == [2, 2, 0]


def test_follow_keeps_turns_and_branch_along_a_line_and_takes_s_and_t_of_a_ptp(model):
    start = np.radians([10.0, -70.0, 100.0, 170.0, 40.0, 200.0])
    q = start + np.linspace(0, 1, 30)[:, None] * np.radians([5, 5, 5, 20, 5, 30.0])
    pose, _ = kinematics.tcp(model.nominal, q, np.eye(4))
    n = len(q)
    free = np.zeros(n, dtype=bool)
    path = followed(model, pose.__getitem__, start, free, np.empty((0, 6)), np.empty(0), np.empty(0))
    np.testing.assert_allclose(path.q, q, atol=1e-9)
    flipped = np.radians([10.0, -70.0, 100.0, -10.0, -40.0, 20.0])
    free[0] = True
    status, turn = kinematics.status_of(model, flipped[None]), kinematics.turn_of(flipped[None])
    path = followed(model, pose.__getitem__, start, free, np.full((1, 6), np.nan), status, turn)
    np.testing.assert_allclose(path.q[0], flipped, atol=1e-9)
    np.testing.assert_allclose(kinematics.tcp(model.nominal, path.q, np.eye(4))[0], pose, atol=1e-9)


def test_turns_of_a_long_path_are_kept_where_no_joint_crosses_half_a_turn_any_more():
    """A4 alone passes 180° at the begin of 20,000 samples, more than are computed at once."""
    start = np.radians([10.0, -70.0, 100.0, 170.0, 40.0, 20.0])
    q = np.tile(start, (20_000, 1))
    q[:, 3] += np.radians(np.minimum(np.arange(len(q)) * 0.01, 20.0))
    pose, _ = kinematics.tcp(ROBOT.nominal, q, np.eye(4))
    no_targets = (np.zeros(len(q), dtype=bool), np.empty((0, 6)), np.empty(0), np.empty(0))
    path = followed(ROBOT, pose.__getitem__, start, *no_targets)
    np.testing.assert_allclose(np.degrees(path.q), np.degrees(q), atol=1e-7)


def test_out_of_reach_names_the_rows(model):
    pose = np.tile(np.eye(4), (3, 1, 1))
    pose[:, :3, 3] = [[1.2, 0.2, 1.0], [9.0, 0, 1.0], [1.2, 0.2, 1.0]]
    with pytest.raises(kinematics.UnreachableError) as found:
        followed(
            model, pose.__getitem__, np.radians([0, -70, 110, 0, 50, 0]), np.zeros(3, dtype=bool),
            np.empty((0, 6)), np.empty(0), np.empty(0),
        )  # fmt: skip
    assert 1 in found.value.rows


def test_an_arm_without_spherical_wrist_is_refused(tmp_path):
    for name in ("robot.urdf", "model.toml"):
        (tmp_path / name).write_text(
            (FOLDER / name).read_text(encoding="utf-8").replace('xyz="0.23 0 0"', 'xyz="0.23 0 0.02"'), encoding="utf-8"
        )
    with pytest.raises(ModelError, match="spherical wrist"):
        kinematics.closed_form(robot.load(tmp_path))


def test_a_path_of_many_ptp_and_lin_moves_takes_the_branch_and_the_turns_that_each_asks_for():
    """Every joint angle is chosen first; the path is asked for by poses, S and T alone."""
    wanted = np.radians(
        [
            [10, -70, 100, 150, 40, 120],  # PTP with S and T
            [12, -70, 100, 165, 40, 150],  # LIN
            [14, -72, 100, 190, 40, 200],  # LIN, through half a turn of A4 and A6
            [16, -72, 98, 200, 42, 230],  # PTP without S and T: the branch and the nearest turn are kept
            [-20, -60, 90, -30, -50, -340],  # PTP to angles
            [-22, -60, 90, -35, -50, -345],  # LIN
            [15, -72, 98, 20, 42, -310],  # PTP with S, other than before: the nearest turn
            [15, -72, 98, -160, -42, 170],  # PTP with S and T
            [15, -72, 96, -150, -42, 190],  # LIN
            [15, -72, 96, -150, -42, -170],  # PTP with S and T: a whole turn of A6 back
            [17, -71, 96, -152, -43, -185],  # PTP without S and T
        ]
    )
    ptp = np.array([0, 3, 4, 6, 7, 9, 10])
    free = np.isin(np.arange(len(wanted)), ptp)
    axes = np.full((len(ptp), 6), np.nan)
    axes[2] = wanted[4]
    bits = ((wanted[ptp] < 0.0) * 2 ** np.arange(6)).sum(axis=1)
    status = np.array([2, -1, -1, 2, 6, 6, -1])
    turn = np.where([True, False, False, False, True, True, False], bits, -1)
    poses = np.array([Arm.load(FOLDER).nominal_tcp(row, np.eye(4)) for row in wanted])
    start = np.radians([0.0, -90.0, 90.0, 0.0, 60.0, 0.0])
    path = followed(ROBOT, poses.__getitem__, start, free, axes, status, turn)
    np.testing.assert_allclose(np.degrees(path.q), np.degrees(wanted), atol=1e-7)
    assert path.branch.tolist() == [2, 2, 2, 2, 6, 6, 2, 6, 6, 6, 6]
    assert kinematics.status_of(ROBOT, wanted).tolist() == path.branch.tolist()


def test_turns_beyond_the_limits_are_taken_only_where_none_inside_has_the_sign_that_is_asked_for():
    q = np.radians([[10.0, -70, 100, 30, 40, 20]])
    pose = Arm.load(FOLDER).nominal_tcp(q[0], np.eye(4))[None]

    def solved(turn):
        path = followed(
            ROBOT, pose.__getitem__, q[0], np.array([True]), np.full((1, 6), np.nan), np.array([2]), np.array([turn])
        )
        return np.degrees(path.q[0]).round(6).tolist()

    assert solved(0b000010) == [10, -70, 100, 30, 40, 20]
    assert solved(0b101010) == [10, -70, 100, -330, 40, -340]
    assert solved(0b001010) == [10, -70, 100, -330, 40, 20]
    assert solved(0b000011) == [10, -70, 100, 30, 40, 20]  # A1 at -350° is out of its limits, 10° is not
    assert solved(0b000000) == [10, -70, 100, 30, 40, 20]  # and so is A2 at 290°


def test_a_path_without_solution_names_all_its_rows_and_one_that_starts_on_the_other_branch_stays_there():
    oracle = Arm.load(FOLDER)
    q = np.radians([[10.0, -70, 100, 30, -40, 20], [12.0, -70, 100, 30, -42, 20]])
    pose = np.array([oracle.nominal_tcp(row, np.eye(4)) for row in q])
    none = (np.zeros(2, dtype=bool), np.empty((0, 6)), np.empty(0), np.empty(0))
    path = followed(ROBOT, pose.__getitem__, q[0], *none)
    np.testing.assert_allclose(path.q, q, atol=1e-9)
    assert path.branch.tolist() == [6, 6]
    pose[:, 0, 3] += 9.0
    with pytest.raises(kinematics.UnreachableError, match="2 poses") as found:
        followed(ROBOT, pose.__getitem__, q[0], *none)
    assert found.value.rows == (0, 1)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0.001 -1"/>'),  # A1 is not vertical
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0.001"/>'),  # A2 is not level
        # A6 passes through the wrist centre, but is not square to A5: A1 to A3 are found all the same
        ('"0.23 0 0"/><axis xyz="-1 0 0"/>', '"0.23 0.0023 0"/><axis xyz="-1 -0.01 0"/>'),
    ],
)
def test_an_arm_whose_first_axes_are_not_vertical_and_parallel_is_refused(tmp_path, old, new):
    text = (FOLDER / "robot.urdf").read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "robot.urdf").write_text(text.replace(old, new, 1), encoding="utf-8")
    (tmp_path / "model.toml").write_bytes((FOLDER / "model.toml").read_bytes())
    with pytest.raises(ModelError, match="vertical A1, parallel A2 and A3"):
        kinematics.closed_form(robot.load(tmp_path))


@pytest.mark.parametrize("size", [1e-9, 1e-4, 4.9e-3, 5.1e-3, 0.5, 3.0])
def test_twists_by_components_are_exact_on_both_sides_of_the_series(size):
    axes = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0.6, -0.48, 0.64]])
    start = frames.pose_from_xyzabc([[100.0, 200, 300, 10 * n, 20, -30] for n in range(4)])
    shift = np.array([0.1, -0.2, 0.3])
    end = start.copy()
    end[:, :3, :3] = Rotation.from_rotvec(size * axes).as_matrix() @ start[:, :3, :3]
    end[:, :3, 3] += shift
    found = kinematics.twist_between(kinematics.components(start), kinematics.components(end)).T
    np.testing.assert_allclose(found[:, :3], np.tile(shift, (4, 1)), rtol=0, atol=1e-15)
    np.testing.assert_allclose(found[:, 3:], size * axes, rtol=0, atol=2e-15 if size < 0.1 else 1e-14)


def test_signs_of_joints_at_zero_are_not_left_to_rounding():
    small = np.outer([-2e-6, -0.5e-6, 0.0, 0.5e-6], np.ones(6))
    assert kinematics.turn_of(small).tolist() == [0b111111, 0, 0, 0]
    q = np.tile(np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]), (4, 1))
    q[:, 4] = small[:, 4]
    form = kinematics.closed_form(ROBOT)
    assert form.branch_of(q).tolist() == [6, 2, 2, 2]  # within 1e-6 rad of A4 and A6 in line: as with A5 > 0
    assert kinematics.status_of(ROBOT, q).tolist() == [6, 6, 2, 2]  # S is the sign as it is
    poses = np.array([Arm.load(FOLDER).nominal_tcp(row, np.eye(4)) for row in q])
    in_line = kinematics.branch_joints(ROBOT, poses[2:3], np.array([2]))
    np.testing.assert_allclose(in_line, q[2:3], rtol=0, atol=1e-9)  # A4 is 0 where only its sum with A6 counts


def test_without_pinocchio_what_needs_it_says_so(monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(kinematics.hessian, "import_module", missing)
    kinematics.hessian.pinocchio_model.cache_clear()
    with pytest.raises(PostprocError, match="needs Pinocchio, which is not installed"):
        kinematics.gravity_stiffness(ROBOT.loaded, np.zeros((1, 6)))


def test_margins_of_poses_with_tools_of_their_own_and_of_few_and_many_rows():
    oracle = Arm.load(FOLDER)
    q = np.radians([10.0, -70, 105, 20, 50, -30]) + np.random.default_rng(9).uniform(-0.3, 0.3, (40, 6))
    tools = frames.pose_from_xyzabc(np.random.default_rng(9).uniform(-100.0, 100.0, (40, 6)))

    def smallest(row, tool):
        linear = [oracle.gradient(lambda x, k=k: oracle.tcp(x, tool)[k, 3], row) for k in range(3)]
        angular = [oracle.moment_torque(row, unit) for unit in np.eye(3)]
        return np.linalg.svd([*linear, *angular], compute_uv=False)[-1]

    each = [smallest(row, tool) for row, tool in zip(q, tools, strict=True)]
    np.testing.assert_allclose(kinematics.smallest_singular_values(ROBOT, q, tools), each, rtol=1e-9)
    assert kinematics.smallest_singular_value(ROBOT, q, tools) == pytest.approx(min(each), rel=1e-9)
    many = np.repeat(q, 200, axis=0)
    assert kinematics.smallest_singular_value(ROBOT, many, np.repeat(tools, 200, axis=0)) == pytest.approx(min(each))


@pytest.mark.parametrize("axis", range(6))
def test_load_stiffness_of_a_force_or_moment_along_one_axis_alone(axis):
    q = np.random.default_rng(10).uniform(ROBOT.lower, ROBOT.upper, (3, 6))
    wrench = np.tile(np.eye(6)[axis], (3, 1))
    hessian = kinematics.load_stiffness(kinematics.tcp(ROBOT.nominal, q, TURNED_TOOL)[1], wrench)
    for joint in range(6):
        change = np.eye(6)[joint] * STEP
        plus, minus = (kinematics.tcp(ROBOT.nominal, q + sign * change, TURNED_TOOL)[1] for sign in (1, -1))
        np.testing.assert_allclose((plus - minus)[:, axis] / (2 * STEP), hessian[:, :, joint], atol=1e-8)


@pytest.fixture(scope="module")
def wrist_led():
    """Return three lines on which A4 to A6 turn the tool, of eight motions, and what they are made of."""
    robot_model = robot.load(robot.find("kuka_kr270"))
    begin = np.radians([[0, -80, 100, 10, 50, 5], [20, -70, 95, -20, 60, 30], [-15, -85, 110, 40, 45, -60.0]])
    end = np.radians([[4, -78, 98, 40, 62, 5], [20.5, -70, 95, -60, 40, 90], [-15, -84, 109, 40, 75, -60.0]])
    tools = np.array([TURNED_TOOL, TURNED_TOOL @ frames.pose_from_xyzabc([0, 0, 50, 20, 0, 0]), TURNED_TOOL])
    bases = np.array(
        [frames.pose_from_xyzabc([0, 0, 0, *angles])[:3, :3] for angles in ([0, 0, 0], [30, 5, -8], [0, 90, 0])]
    )
    motion = np.array([1, 4, 6])
    tip = np.stack([kinematics.tcp(robot_model.nominal, q, tools)[0][:, :3, 3] for q in (begin, end)], axis=1)
    return robot_model, motion, begin, end, tip, bases, tools


def test_the_wrist_turns_the_tool_in_proportion_while_its_tip_is_on_the_line(wrist_led):
    """The closed form, of the tip on the line with that orientation, has A4 to A6 in proportion between both ends."""
    robot_model, motion, begin, end, tip, bases, tools = wrist_led
    wrist = by_wrist(robot_model, 8, motion, (begin, end), tip, bases, tools)
    assert wrist.active.tolist() == [False, True, False, False, True, False, True, False]
    places, share = np.array([6, 1, 4, 4, 1, 6]), np.array([0.0, 0.3, 0.9, 1.0, 0.55, 0.4])
    for m, t, orientation in zip(places, share, wrist.at(places, share), strict=True):
        row = motion.tolist().index(m)
        pose = np.eye(4)
        pose[:3, :3] = bases[row] @ orientation
        pose[:3, 3] = (1 - t) * tip[row, 0] + t * tip[row, 1]
        branches = kinematics.closed_form(robot_model).branches((pose @ np.linalg.inv(tools[row]))[None])[0]
        q = (1 - t) * begin[row] + t * end[row]
        gap = np.abs((branches[:, 3:] - q[3:] + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
        assert np.nanmin(gap) < 1e-9
        assert np.abs(branches[np.nanargmin(gap), :3] - q[:3]).max() < np.radians(8.0)


def test_the_rotation_on_a_line_led_by_the_wrist_is_its_sum_with_a_margin(wrist_led):
    """A fifth more than the rotation on eight pieces; motions that the wrist does not lead have none."""
    robot_model, motion, begin, end, tip, bases, tools = wrist_led
    wrist = by_wrist(robot_model, 8, motion, (begin, end), tip, bases, tools)
    for _row, m in enumerate(motion):
        orientations = wrist.at(np.full(9, m), np.linspace(0.0, 1.0, 9))
        total = sum(Rotation.from_matrix(a.T @ b).magnitude() for a, b in itertools.pairwise(orientations))
        assert wrist.travel[m] == pytest.approx(1.2 * total, rel=1e-9)
    assert (wrist.travel[~wrist.active] == 0.0).all()


def test_lines_on_which_the_wrist_cannot_lead_are_named(wrist_led):
    """Their ends are on two branches, or the tip is out of reach between them."""
    robot_model, motion, begin, end, tip, bases, tools = wrist_led
    far, other_branch = tip.copy(), end.copy()
    far[2, 1] += [9.0, 0.0, 0.0]
    other_branch[0, 4] = -other_branch[0, 4]
    bent = tip.copy()
    bent[0, 1] = kinematics.tcp(robot_model.nominal, other_branch[:1], tools[:1])[0][0, :3, 3]
    for ends, tips, rows in ((end, far, (6,)), (other_branch, bent, (1,))):
        with pytest.raises(kinematics.UnreachableError) as refused:
            by_wrist(robot_model, 8, motion, (begin, ends), tips, bases, tools)
        assert refused.value.rows == rows
