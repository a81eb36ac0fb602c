"""Each check on joint angles, poses and speeds that are made up: the rows it names, its words, and its limit."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.chunks import Runs
from postproc.correction import checks
from postproc.errors import Issue
from postproc.frames import rotation_from_vector
from postproc.kinematics import JointPath
from postproc.poses import Poses
from postproc.program import LIN, PTP
from postproc.robot import MeasuredRange
from postproc.toolpath import Toolpath
from tests.collision.setting import frame
from tests.kr270 import ROBOT
from tests.programs import program

MADE = program([("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("LIN", 100, 0, 0), ("RAPID", 100, 0, 50), ("PTP", 0, 0, 50)])
NORMAL = np.radians([10.0, -70.0, 105.0, 20.0, 50.0, 30.0])
STRETCHED = -np.arctan2(0.055, 1.1)
"""A3 of the stretched arm [rad]: the wrist is 55 mm below the axis of A4's elbow and 1.1 m ahead of it."""


def sample(motion, t=None, pose=None) -> Toolpath:
    """Samples at the ends of motions, unless places are given."""
    motion = np.array(motion)
    t = np.ones(len(motion)) if t is None else np.array(t)
    pose = MADE.motions.target[motion] if pose is None else pose
    return Toolpath(motion, t, Poses.of(pose), np.zeros(len(motion)))


def angles(count: int = 5, **changes) -> np.ndarray:
    """Normal joint angles in rows, A1=… a list for all rows [rad]."""
    q = np.tile(NORMAL, (count, 1))
    for name, values in changes.items():
        q[:, int(name[1]) - 1] = values
    return q


def lines(issues) -> dict[str, tuple]:
    """Kind → level, first line, number of lines."""
    return {issue.kind: (issue.level, issue.source_line, issue.count) for issue in issues}


def test_joints_beyond_either_limit_are_named_with_the_first_angle():
    q = angles(A1=np.radians([0, 185.0, 185.5, 186.0, 0]), A2=np.radians([-70, -70, -146.25, -70, -70]))
    issues = list(checks.joint_limit_issues(MADE, ROBOT, sample(range(5)), q))
    assert lines(issues) == {"joint-limit-A1": ("error", 3, 2), "joint-limit-A2": ("error", 3, 1)}
    assert issues[0].message == (
        "A1 = 185.500° is outside its limits -185…185°. Move the part, turn the tool about its axis ([gcode] "
        "redundancy_deg) or start elsewhere."
    )
    assert "A2 = -146.250° is outside its limits -146…0°" in issues[1].message
    limits, step = np.radians([0, 185.0, -185.0, 0, 0]), np.array([0.0, 1.0, -1.0, 0.0, 0.0])
    at_limit = angles(A1=limits + 5e-10 * step)
    assert list(checks.joint_limit_issues(MADE, ROBOT, sample(range(5)), at_limit)) == []
    beyond = angles(A1=limits + 1.5e-9 * step)
    assert lines(checks.joint_limit_issues(MADE, ROBOT, sample(range(5)), beyond)) == {
        "joint-limit-A1": ("error", 2, 2)
    }
    nan = angles(A1=[0, np.nan, 0, 0, 0])
    assert lines(checks.joint_limit_issues(MADE, ROBOT, sample(range(5)), nan)) == {"joint-limit-A1": ("error", 2, 1)}
    home = replace(MADE, motions=replace(MADE.motions, joints=np.zeros((5, 6))))
    assert (
        "choose another [machine] home or start"
        in next(checks.joint_limit_issues(home, ROBOT, sample(range(5)), q)).message
    )


LINEAR = program([("LIN", 10 * k, 0, 0) for k in range(5)])


@pytest.mark.parametrize(
    ("changes", "kind", "words"),
    [
        ({"A5": np.radians([9, 0.21, 0.19, -0.19, 9])}, "wrist-singularity", "A5 passes through 0°"),
        ({"A3": STRETCHED + np.radians([9, 0.21, 0.19, -0.19, 9])}, "elbow-singularity", "the arm is stretched out"),
    ],
)
def test_poses_near_a_singularity_are_named_on_path_motions(changes, kind, words):
    q = angles(**changes)
    (issue,) = checks.singularity_issues(LINEAR, ROBOT, sample(range(5)), q, np.zeros(0, dtype=int))
    assert (issue.kind, issue.level, issue.source_line, issue.count) == (kind, "error", 3, 2)
    assert words in issue.message
    ptp = program([("PTP", 10 * k, 0, 0) for k in range(5)])
    assert list(checks.singularity_issues(ptp, ROBOT, sample(range(5)), q, np.zeros(0, dtype=int))) == []


def test_a_wrist_above_the_axis_of_a1_is_named_within_five_millimetres():
    """The angle of A2 at which the wrist centre is 6 and 4 mm ahead of the axis, by bisection of another arm."""
    rows = []
    for ahead in (0.006, 0.004, -0.004):
        low, high = np.radians(-140.0), np.radians(-60.0)
        for _ in range(60):
            middle = 0.5 * (low + high)
            at = frame([0.0, middle, 0.0, 0.0, 0.5, 0.0], 4)[0, 3]
            low, high = (middle, high) if at < ahead else (low, middle)
        rows.append([0.0, low, 0.0, 0.0, 0.5, 0.0])
    (issue,) = checks.singularity_issues(LINEAR, ROBOT, sample(range(3)), np.array(rows), np.zeros(0, dtype=int))
    assert (issue.kind, issue.source_line, issue.count) == ("shoulder-singularity", 2, 2)
    assert "the wrist is above the A1 axis" in issue.message


@pytest.mark.parametrize(
    ("joint", "degrees", "kind"),
    [
        ("A4", 46.0, "wrist-singularity"),
        ("A6", -46.0, "wrist-singularity"),
        ("A1", 46.0, "joint-jump"),
        ("A4", 44.0, ""),
    ],
)
def test_a_joint_that_turns_by_more_than_45_degrees_between_samples_is_named(joint, degrees, kind):
    start = NORMAL[int(joint[1]) - 1]
    q = angles(**{joint: start + np.radians([0, 0, degrees, degrees, degrees])})
    issues = list(checks.singularity_issues(LINEAR, ROBOT, sample(range(5)), q, np.zeros(0, dtype=int)))
    assert [issue.kind for issue in issues] == ([kind] if kind else [])
    if not kind:
        return
    assert (issues[0].source_line, issues[0].count) == (3, 1)
    assert ("A4 and A6 turn by more than 45° at once" in issues[0].message) is (kind == "wrist-singularity")
    assert list(checks.singularity_issues(LINEAR, ROBOT, sample(range(5)), q, np.array([2]))) == []
    apart = [0, 1, 3, 4, 4]  # a motion between is not sampled
    assert list(checks.singularity_issues(LINEAR, ROBOT, sample(apart), q, np.zeros(0, dtype=int))) == []


@pytest.mark.parametrize(
    ("angle", "shift", "joints", "level"),
    [
        (179.81, 2e-9, False, "error"), (179.79, 2e-9, False, None), (179.81, 5e-10, False, "warning"),
        (180.0, 2e-9, True, "warning"),
    ],
)  # fmt: skip
def test_half_a_turn_is_an_error_where_it_is_corrected(angle, shift, joints, level):
    at = sample(range(5))
    pose = at.pose[:].copy()
    pose[1, 0, 3] += shift
    turn = np.radians([0.0, 0.0, angle, 0.0, 180.0])  # the last one is a joint interpolation
    made = MADE
    if joints:
        values = np.full((5, 6), np.nan)
        values[1] = 0.0
        made = replace(MADE, motions=replace(MADE.motions, joints=values))
    issues = list(checks.half_turn_issues(made, at, turn, Poses.of(pose)))
    assert [(issue.level, issue.kind, issue.source_line) for issue in issues] == (
        [(level, "half-turn", 3)] if level else []
    )


def test_status_and_turn_that_the_angles_do_not_have_are_named():
    """A5 and A1 negative: S has bit 2, T bits 0 and 4; angles within a hundredth of a degree of zero have no sign."""
    ptp = program([("PTP", 0, 0, 50)] * 4)
    q = angles(4, A1=-0.2, A5=-0.5)
    q[3] = 0.9e-4, NORMAL[1], NORMAL[2], NORMAL[3], 0.9e-4, NORMAL[5]
    elbow = 2
    good_turn = 0b000001 | 0b000010 | 0b010000
    motions = replace(
        ptp.motions, status=np.array([4 + elbow, elbow, 4 + elbow, 4 + elbow]),
        turn=np.array([good_turn, good_turn, good_turn ^ 0b100000, good_turn]),
    )  # fmt: skip
    made = replace(ptp, motions=motions)
    issues = list(checks.status_and_turn_issues(made, ROBOT, sample(range(4)), q))
    assert [(issue.kind, issue.source_line, issue.count) for issue in issues] == [
        ("status-turn", 2, 1), ("status-turn", 3, 1),
    ]  # fmt: skip
    assert "has the status S of this target" in issues[0].message
    assert "has the turn T of this target" in issues[1].message
    lines_too = replace(made, motions=replace(motions, kind=np.array([LIN, LIN, PTP, LIN])))
    (issue,) = checks.status_and_turn_issues(
        lines_too, ROBOT, sample(range(4)), q
    )  # of lines the controller ignores them
    assert issue.source_line == 3
    inside = sample([2, 2], t=[0.5, 1.0])
    assert len(list(checks.status_and_turn_issues(lines_too, ROBOT, inside, q[[1, 2]]))) == 1
    zero = replace(ptp, motions=replace(motions, status=np.zeros(4, dtype=int), turn=np.full(4, -1)))
    (issue,) = checks.status_and_turn_issues(zero, ROBOT, sample(range(4)), q)
    assert (issue.source_line, issue.count) == (1, 3)
    none = replace(ptp, motions=replace(motions, status=np.full(4, -1), turn=np.full(4, -1)))
    assert list(checks.status_and_turn_issues(none, ROBOT, sample(range(4)), q)) == []


def test_an_arc_along_which_the_tool_turns_with_the_path_does_not_turn_it_by_its_sweep():
    """A turn of 250° on an arc of 70.1°: 179.9° are left, and 180° less a tenth may go the other way."""
    motions = replace(MADE.motions, sweep=np.radians([np.nan, np.nan, 70.1, np.nan, np.nan]))
    turns_with_path = np.array([False, False, True, False, False])
    turn = np.radians([0.0, 0.0, 250.0, 0.0, 0.0])
    at = sample(range(5))
    made = replace(MADE, motions=motions, turns_with_path=turns_with_path)
    assert len(list(checks.half_turn_issues(made, at, turn, at.pose))) == 1
    small = np.radians([0.0, 0.0, 200.0, 0.0, 0.0])
    assert list(checks.half_turn_issues(made, at, small, at.pose)) == []
    assert len(list(checks.half_turn_issues(replace(made, turns_with_path=None), at, small, at.pose))) == 1


@pytest.mark.parametrize(("degrees", "is_wrong"), [(0.009, False), (0.011, True)])
def test_an_angle_within_a_hundredth_of_a_degree_of_zero_has_no_sign(degrees, is_wrong):
    """T says that A1 is negative, S that A5 is."""
    ptp = program([("PTP", 0, 0, 50)])
    q = angles(1, A1=np.radians(degrees), A5=np.radians(degrees))
    for status, turn in ((-1, 0b000011), (6, -1)):
        made = replace(ptp, motions=replace(ptp.motions, status=np.array([status]), turn=np.array([turn])))
        assert len(list(checks.status_and_turn_issues(made, ROBOT, sample([0]), q))) == is_wrong


def test_start_joints_beyond_a_limit_and_a5_at_zero():
    start = np.radians([0.0, 0.25, 100.0, 0.0, 0.19, 0.0])
    issues = list(checks.start_joint_issues(MADE, ROBOT, start))
    assert lines(issues) == {"start-joints": ("error", 1, 1), "start-singular": ("warning", 1, 1)}
    assert "A2 is outside its limits by 0.250°" in issues[0].message
    assert list(checks.start_joint_issues(MADE, ROBOT, np.radians([0.0, 0.0, 100.0, 0.0, 0.21, 0.0]))) == []


@pytest.mark.parametrize(("degrees", "told"), [(149.0, False), (151.0, True), (-151.0, True)])
def test_a_first_move_that_turns_the_hand_far_is_told(degrees, told):
    start = NORMAL.copy()
    q = np.tile(start, (5, 1))
    q[0, 3] += np.radians(degrees)
    q[1:, 5] += 3.0
    path = JointPath(q, np.zeros(5, dtype=int))
    issues = list(checks.first_move_issues(MADE, path, start))
    assert lines(issues) == ({"first-move-A4": ("warning", 1, 1)} if told else {})
    if told:
        assert f"turns A4 by {degrees:.0f}° from the [start] joints" in issues[0].message
    assert list(checks.first_move_issues(LINEAR, path, start)) == []


HEIGHTS = [
    ((60.0, 60.0), None, None), ((49.2, 60.0), None, None), ((48.9, 60.0), None, "begins below the first target: "),
    ((99.1, 120.0), 100.0, None), ((98.9, 120.0), 100.0, "begins below clearance_Z: "),
    ((60.0, 48.9, 60.0), None, "passes below the first target: "), ((60.0, 49.2, 60.0), None, None),
    ((60.0, 38.9, 60.0), 40.0, "passes below clearance_Z: "), ((60.0, 45.0, 60.0), 40.0, None),
    ((45.0, 45.0), 40.0, "begins below the first target: "), ((45.0, 45.0), 50.0, "begins below the first target: "),
]  # fmt: skip


@pytest.mark.parametrize(("z", "clearance", "words"), HEIGHTS)
def test_a_first_move_below_its_target_or_clearance_is_a_warning(z, clearance, words):
    """The first target is at Z 50; a millimetre is allowed."""
    tip = np.zeros((len(z), 3))
    tip[:, 2] = np.array(z) * 1e-3
    issues = list(checks.start_height_issues(MADE, tip, None if clearance is None else clearance * 1e-3))
    assert len(issues) == (words is not None)
    if words:
        assert words in issues[0].message
        low = z[0] if "begins" in words else min(z)
        limit = clearance if "clearance" in words else 50.0
        assert f"{low:.1f} mm of $BASE, {limit - low:.1f} mm below it." in issues[0].message
        assert (issues[0].level, issues[0].kind, issues[0].source_line) == ("warning", "start-below", 1)
    joints = np.zeros((5, 6))
    by_axes = replace(MADE, motions=replace(MADE.motions, joints=joints))
    assert list(checks.start_height_issues(by_axes, tip, clearance)) == []


def test_a_ptp_that_changes_the_posture_is_told_with_both_states():
    start = NORMAL.copy()
    q = angles(A5=[-0.5, -0.5, 0.5, -0.5, 0.5])  # the posture on the lines between is not its subject
    issues = list(checks.posture_issues(MADE, ROBOT, sample(range(5)), JointPath(q, np.zeros(5, dtype=int)), start))
    assert lines(issues) == {"posture": ("info", 1, 2)}
    assert "status S from 2 to 6" in issues[0].message
    start[4] = -0.5
    (issue,) = checks.posture_issues(MADE, ROBOT, sample(range(5)), JointPath(q, np.zeros(5, dtype=int)), start)
    assert (issue.source_line, issue.count) == (5, 1)
    assert "status S from 6 to 2" in issue.message
    second = program([("LIN", 0, 0, 0), ("PTP", 100, 0, 0)])
    turned = JointPath(angles(2, A5=[-0.5, 0.5]), np.zeros(2, dtype=int))
    assert lines(checks.posture_issues(second, ROBOT, sample([0, 1]), turned, NORMAL)) == {"posture": ("info", 2, 1)}


def test_joint_speeds_are_angles_over_the_time_of_the_longer_way_at_the_feed():
    """Rows: the first, 50 mm, 100 mm, which is commanded as 110 mm, a rapid of 50 mm, and a joint interpolation."""
    at = sample(range(5))
    q = np.cumsum(np.tile([0.01, -0.02, 0.03, 0.0, 0.05, -0.06], (5, 1)), axis=0)
    position = at.pose[:, :3, 3].copy()
    position[2:, 0] += 0.010
    speed = checks.joint_speed(MADE, at, np.zeros(5), q, position)
    step = np.abs(q[1] - q[0])
    np.testing.assert_allclose(speed[0], 0.0)
    np.testing.assert_allclose(speed[1], step * 0.05 / 0.05)
    np.testing.assert_allclose(speed[2], step * 0.05 / 0.11)
    np.testing.assert_allclose(speed[3], step * 0.5 / 0.05)
    np.testing.assert_allclose(speed[4], 0.0)


@pytest.mark.parametrize(("degrees", "is_timed"), [(199.0, True), (201.0, False)])
def test_a_turn_faster_than_the_orientation_speed_is_not_timed_by_the_feed(degrees, is_timed):
    """Half a millimetre at 1 mm/s, on which the tool turns at 199 or 201°/s."""
    made = program([("LIN", 0, 0, 0), ("LIN", 1, 0, 0)])
    made.motions.feed[:] = 0.001
    pose = made.motions.target[:].copy()
    pose[1, :3, :3] = rotation_from_vector(np.array([0.0, np.radians(degrees) * 0.5, 0.0])) @ pose[0, :3, :3]
    pose[1, 0, 3] = 0.0005
    at = Toolpath(np.array([0, 1]), np.ones(2), Poses.of(pose), np.zeros(2))
    q = np.tile(NORMAL, (2, 1))
    q[1] += 0.1
    speed = checks.joint_speed(made, at, np.radians([0.0, 100.0]), q, pose[:, :3, 3])
    np.testing.assert_allclose(speed[1], 0.1 * 0.001 / 0.0005 if is_timed else 0.0)


@pytest.mark.parametrize("change", ["base", "tool"])
def test_a_motion_in_other_frames_is_not_timed_from_the_one_before(change):
    frames = getattr(MADE.motions, change).copy()
    frames[2:] = 1
    made = replace(MADE, motions=replace(MADE.motions, **{change: frames}))
    at = sample(range(5))
    q = np.cumsum(np.full((5, 6), 0.01), axis=0)
    speed = checks.joint_speed(made, at, np.zeros(5), q, at.pose[:, :3, 3])
    assert (speed.max(axis=1) > 0.0).tolist() == [False, True, False, True, False]


@pytest.mark.parametrize("is_default", [False, True])
def test_joints_that_are_too_fast_are_named_with_the_feed_that_is_slow_enough(is_default):
    speed = np.zeros((5, 6))
    speed[1, 1], speed[2, 1], speed[3, 4] = 1.2 * ROBOT.speed[1], 1.5 * ROBOT.speed[1], 2.0 * ROBOT.speed[4]
    speed[2, 0] = ROBOT.speed[0]
    made = replace(MADE, issues=(Issue("warning", "default-speed", ""),)) if is_default else MADE
    issues = list(checks.joint_speed_issues(made, ROBOT, sample(range(5)), speed))
    level = "warning" if is_default else "error"
    assert lines(issues) == {"joint-speed-A2": (level, 2, 2), "joint-speed-A5": (level, 4, 1)}
    limit = np.degrees(ROBOT.speed[1])
    assert issues[0].message == (
        f"A2 would turn at {1.5 * limit:.0f}°/s at the programmed feed (limit {limit:.0f}°/s). Lower the feed to 2000 "
        "mm/min or turn the tool about its axis."
    )
    assert "at the speed of rapid moves" in issues[1].message
    assert "Lower rapid_m_per_s in [gcode] of the cell" in issues[1].message


@pytest.mark.parametrize(("dialect", "feed"), [("gcode", "1200 mm/min"), ("krl", "0.02 m/s"), ("rapid", "20 mm/s")])
def test_feeds_are_in_the_unit_of_the_program(dialect, feed):
    assert checks._feed_text(0.02, dialect).startswith(feed)


@pytest.mark.parametrize(
    ("value", "words"), [(1999.9, "1900"), (2000.0, "2000"), (0.0129, "0.012"), (9.99, "9.9"), (10.0, "10")]
)
def test_feeds_are_rounded_down_to_two_digits(value, words):
    assert checks._round_down(value) == words


def test_branches_that_end_a_turn_apart_are_an_error():
    made = replace(MADE, joins=((1, 2), (1, 3), (-1, 4)))
    q = angles(A6=[0.0, 0.1, 0.1 + 2 * np.pi, 0.1 + 3.1, 0.2])
    issues = list(checks.joint_issues_at_joins(made, sample(range(5)), q, NORMAL))
    assert [(issue.kind, issue.source_line, issue.count, issue.lines) for issue in issues] == [
        ("branch-joints", 2, 2, (2, 3))
    ]
    assert "end with A6 at 6° and 366°" in issues[0].message
    far = NORMAL.copy()
    far[5] = -3.2
    (_, from_start) = checks.joint_issues_at_joins(made, sample(range(5)), q, far)
    assert from_start.lines == (5,)
    (of_first,) = checks.joint_issues_at_joins(replace(MADE, joins=((0, 2),)), sample(range(5)), q, far)
    assert (of_first.lines, of_first.source_line) == ((1, 3), 1)
    alike = replace(MADE, joins=((0, 1),))
    assert list(checks.joint_issues_at_joins(alike, sample(range(5)), q, far)) == []


def test_branches_that_are_corrected_differently_are_an_error():
    made = replace(MADE, joins=((1, 2), (1, 3), (-1, 4)))
    at = sample(range(5))
    pose = at.pose[:].copy()
    pose[1, 0, 3] += 1e-3
    pose[2, 0, 3] += 1e-3 + 7e-7
    pose[3, 0, 3] += 1e-3 + 9e-7
    wrench = np.zeros((5, 6))
    wrench[1, :3], wrench[3, :3] = (10.0, 0.0, -5.5), (10.5, 0.0, 0.0)
    issues = list(checks.correction_issues_at_joins(made, at, Poses.of(pose), Runs.of(wrench)))
    assert [(issue.kind, issue.lines) for issue in issues] == [("branch-forces", (2, 4))]
    assert "(line 2: F = (10, 0, -5.5) N, line 4: F = (10.5, 0, 0) N)" in issues[0].message
    pose[4, 2, 3] += 1e-6
    assert [issue.lines for issue in checks.correction_issues_at_joins(made, at, Poses.of(pose), Runs.of(wrench))] == [
        (2, 4),
        (5,),
    ]


def test_a_correction_beyond_its_limit_and_rounding_beyond_the_tolerance_are_named():
    size = np.array([0.0, 2e-3, 3.1e-3, np.nan, 1e-3])
    (issue,) = checks.correction_size_issues(MADE, np.arange(5), np.nan_to_num(size, nan=4e-3), 3e-3)
    assert (issue.kind, issue.level, issue.source_line, issue.count) == ("correction-size", "error", 3, 2)
    assert "the correction of 4.000 mm is larger than max_correction_mm = 3." in issue.message
    assert list(checks.correction_size_issues(MADE, np.arange(2), size[:2], 2e-3)) == []
    assert len(list(checks.correction_size_issues(MADE, np.arange(5), size, 1.0))) == 1
    (issue,) = checks.blending_issues(MADE, np.arange(5), np.array([0, 1e-4, 2.5e-4, 0, 0]), 1e-4)
    assert (issue.kind, issue.level, issue.source_line, issue.count) == ("blending", "warning", 3, 1)
    assert "by up to 0.250 mm more than the programmed one; tolerance_mm is 0.1." in issue.message
    assert list(checks.blending_issues(MADE, np.zeros(0, dtype=int), np.zeros(0), 1e-4)) == []


def test_loads_beyond_ten_percent_over_the_measured_ones_are_named():
    """Torques by differences of the work of a force: J'F of A1 and A2."""
    tool = np.eye(4)
    tool[2, 3] = 0.35
    force = np.array([300.0, -200.0, 400.0])
    step = 1e-6 * np.eye(6)
    tips = [[(frame(NORMAL + s * row, 6) @ tool)[:3, 3] for s in (1, -1)] for row in step]
    torque = np.array([(plus - minus) @ force for plus, minus in tips]) / 2e-6
    wrench = np.zeros((5, 6))
    wrench[:, :3] = np.array([0.5, 1.0, 1.0, 1.0, 0.2])[:, None] * force
    measured = np.abs(torque) * np.array([1.0 / 1.09, 1.0 / 1.11, 10.0, 10.0, 10.0, 1e9])
    measured[5] = 1.0
    model = replace(ROBOT, measured=MeasuredRange(measured, ""))
    issues = list(checks.torque_warnings(MADE, model, np.arange(5), angles(), tool, wrench))
    assert lines(issues) == {"beyond-measured-A2": ("warning", 2, 3)}
    assert f"up to {abs(torque[1]):.0f} N·m on A2; the robot model was measured up to {measured[1]:.0f}" in (
        issues[0].message
    )
    assert list(checks.torque_warnings(MADE, ROBOT, np.arange(5), angles(), tool, wrench)) == []
