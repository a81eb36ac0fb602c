"""Each check of a path by itself, just within its bound and just beyond it; geometry from the oracle or the drawing."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from postproc import frames
from postproc.correction import checks
from postproc.errors import Issue
from postproc.kinematics import JointPath
from postproc.poses import Poses
from postproc.robot.model import MeasuredRange
from postproc.toolpath import Toolpath
from tests.corrections import correct_files
from tests.kr270 import FOLDER, ROBOT
from tests.oracle.arm import Arm
from tests.programs import program

ARM = Arm.load(FOLDER)
STRETCHED = -np.arctan2(55.0, 1100.0)
"""A3 of the KR 270 with the wrist centre on the line through axes 2 and 3: 55 mm below, 1100 mm ahead."""
Q = np.radians([10.0, -70.0, 105.0, 20.0, 50.0, -30.0])
LINES = [("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("LIN", 100, 0, 0), ("LIN", 100, 50, 0)]
MADE = program(LINES)


def sampled(motion, t=None, pose=None):
    motion = np.asarray(motion)
    pose = np.tile(np.eye(4), (len(motion), 1, 1)) if pose is None else pose
    return Toolpath(motion, np.ones(len(motion)) if t is None else np.asarray(t), Poses.of(pose), np.zeros(len(motion)))


def told(issues):
    return [(issue.kind, issue.level, issue.lines) for issue in issues]


def singular(q, motion=(1, 2, 3), made=MADE, apart=()):
    return list(checks.singularity_issues(made, ROBOT, sampled(motion), np.asarray(q), np.array(apart, dtype=np.int64)))


def changed(axis, *values):
    """Configurations that differ from `Q` in one angle [rad]."""
    q = np.tile(Q, (len(values), 1))
    q[:, axis] = values
    return q


@pytest.mark.parametrize(
    ("axis", "at", "within", "kind"),
    [(4, 0.0, np.radians(0.2), "wrist-singularity"), (2, STRETCHED, np.radians(0.2), "elbow-singularity")],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_wrist_and_elbow_singularities_are_errors_within_a_fifth_of_a_degree(axis, at, within, kind, sign):
    inside, outside = (at + sign * share * within for share in (0.99, 1.01))
    near = np.array([outside, inside, outside])
    assert told(singular(changed(axis, *near))) == [(kind, "error", (3,))]
    assert not singular(changed(axis, outside, outside, outside))
    assert not singular(changed(axis, inside, outside, outside), motion=(0, 2, 3))  # PTP may pass it


def wrist_ahead(a2):
    """How far ahead of the A1 axis the wrist centre is [m]; the flange is 230 mm before it."""
    flange = ARM.nominal_tcp(np.array([0.0, a2, *Q[2:]]), np.eye(4))
    return (flange[:3, 3] - 0.23 * flange[:3, 2])[0]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_wrist_centre_within_5_mm_of_the_a1_axis_is_an_error(sign):
    inside, outside = (
        brentq(lambda a2, share=share: wrist_ahead(a2) - sign * share * 0.005, -3.2, -1.8) for share in (0.98, 1.02)
    )
    q = changed(1, outside, outside, inside)
    assert told(singular(q)) == [("shoulder-singularity", "error", (4,))]
    assert "shoulder singularity" in singular(q)[0].message
    assert not singular(changed(1, outside, outside, outside))


@pytest.mark.parametrize(
    ("axis", "kind", "text"),
    [
        (0, "joint-jump", "a joint turns by more than 45°"), (1, "joint-jump", ""), (2, "joint-jump", ""),
        (3, "wrist-singularity", "A4 and A6 turn by more than 45° at once"), (4, "joint-jump", ""),
        (5, "wrist-singularity", ""),
    ],
)  # fmt: skip
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_that_turns_by_more_than_45_degrees_between_samples_jumps(axis, kind, text, sign):
    by = sign * np.radians([44.9, 45.1])
    start = Q[axis] - 0.5 * by[1]  # about the middle, clear of singularities
    assert not singular(changed(axis, start, start, start + by[0]))
    q = changed(axis, start, start, start + by[1])
    assert told(singular(q)) == [(kind, "error", (4,))]
    assert text in singular(q)[0].message
    both = q.copy()  # the joint that turns most says what it is
    both[2, 3 if axis != 3 else 0] += 0.9 * by[1]
    assert [issue.kind for issue in singular(both)] == [kind]
    assert not singular(q, apart=[3])
    assert not singular(q, motion=(1, 2, 0))
    assert not singular(q, motion=(0, 1, 3))  # a motion that stays as it is lies between
    assert told(singular(q, motion=(2, 2, 2))) == [(kind, "error", (3,))]
    assert not singular(q[[2, 2, 2]])


def test_of_the_first_sample_nothing_is_known_that_it_could_jump_from():
    q = changed(0, 0.0, 0.0)
    assert not singular(q, motion=(1, 2))


@pytest.mark.parametrize("axis", range(6))
def test_joint_angles_beyond_a_limit_are_errors_with_the_angle(axis):
    for limit, sign in ((ROBOT.lower[axis], -1.0), (ROBOT.upper[axis], 1.0)):
        fine = changed(axis, limit, limit + sign * 5e-10)
        assert not list(checks.joint_limit_issues(MADE, ROBOT, sampled((1, 2)), fine))
        q = changed(axis, limit, limit + sign * 1e-3, limit + sign * 2e-3)
        (issue,) = checks.joint_limit_issues(MADE, ROBOT, sampled((1, 2, 3)), q)
        assert (issue.kind, issue.level, issue.lines) == (f"joint-limit-A{axis + 1}", "error", (3, 4))
        angle = np.degrees(limit + sign * 1e-3)
        low, high = np.degrees([ROBOT.lower[axis], ROBOT.upper[axis]])
        assert f"A{axis + 1} = {angle:.3f}° is outside its limits {low:g}…{high:g}°" in issue.message
        q[0, axis] = np.nan
        (issue,) = checks.joint_limit_issues(MADE, ROBOT, sampled((1, 2, 3)), q)
        assert issue.lines == (2, 3, 4)


def test_each_joint_beyond_its_limits_is_an_error_of_its_own():
    q = np.array([ROBOT.upper + 0.1, ROBOT.lower - 0.1])
    found = told(checks.joint_limit_issues(MADE, ROBOT, sampled((2, 3)), q))
    assert found == [(f"joint-limit-A{n}", "error", (3, 4)) for n in range(1, 7)]


def five_poses(moved):
    """Poses of five samples, and what is commanded: (row, axis, by) are elsewhere [m, rad]."""
    pose, twist = np.tile(np.eye(4), (5, 1, 1)), np.zeros((5, 6))
    for row, axis, by in moved:
        twist[row, axis] = by
    commanded = pose.copy()
    commanded[:, :3, 3], commanded[:, :3, :3] = twist[:, :3], Rotation.from_rotvec(twist[:, 3:]).as_matrix()
    return pose, commanded


NEARLY = np.pi - np.radians(0.19)


def half_turn(moved, made=MADE, turn=NEARLY):
    """Issues of a program whose third motion turns the tool by half a circle; `moved` by sample and axis."""
    pose, commanded = five_poses(moved)
    sample = sampled((0, 1, 2, 2, 3), (1.0, 1.0, 0.5, 1.0, 1.0), pose)
    turns = np.array([np.pi, 0.0, turn, 0.0])
    return told(checks.half_turn_issues(made, sample, turns, commanded))


@pytest.mark.parametrize("axis", range(6))
def test_half_a_turn_is_an_error_where_either_of_its_ends_is_corrected(axis):
    for row in (1, 3):
        assert half_turn([(row, axis, 2e-9)]) == [("half-turn", "error", (3,))]
        assert half_turn([(row, axis, 0.5e-9)]) == [("half-turn", "warning", (3,))]
    for row in (0, 2, 4):  # no end of it
        assert half_turn([(row, axis, 1e-3)]) == [("half-turn", "warning", (3,))]
    assert half_turn([(1, axis, 1e-3)], turn=np.pi - np.radians(0.21)) == []


def test_half_a_turn_from_the_start_or_from_an_axis_target_is_a_warning():
    joints = MADE.motions.joints[:]
    joints[1] = Q
    from_axes = replace(MADE, motions=replace(MADE.motions, joints=joints))
    assert half_turn([(3, 0, 1e-3)], from_axes) == [("half-turn", "warning", (3,))]
    first = replace(MADE, after=np.array([-1, 0, -1, 2]))
    assert half_turn([(3, 0, 1e-3)], first) == [("half-turn", "warning", (3,))]
    elsewhere = replace(MADE, after=np.array([-1, 0, 0, 2]))  # it begins where the first motion ends
    assert half_turn([(0, 0, 1e-3)], elsewhere) == [("half-turn", "error", (3,))]
    assert half_turn([(1, 0, 1e-3)], elsewhere) == [("half-turn", "warning", (3,))]


def test_half_a_turn_with_the_path_is_the_turn_seen_from_the_path():
    sweep = np.array([0.0, 0.0, np.pi - 1.0, 0.0])
    led = replace(
        MADE, motions=replace(MADE.motions, sweep=sweep), turns_with_path=np.array([False, False, True, False])
    )
    assert half_turn([(3, 0, 1e-3)], led) == []
    assert half_turn([(3, 0, 1e-3)], led, turn=2 * np.pi - 1.0) == [("half-turn", "error", (3,))]
    assert half_turn([(3, 0, 1e-3)], replace(led, turns_with_path=None)) == [("half-turn", "error", (3,))]
    line = replace(led, turns_with_path=np.array([False, True, False, False]))  # another motion is led by its path
    assert half_turn([(3, 0, 1e-3)], line) == [("half-turn", "error", (3,))]
    axes = SimpleNamespace(active=np.array([False, False, True, False]))  # rotary axes say which way round
    assert half_turn([(3, 0, 1e-3)], replace(MADE, swivel=axes)) == []


TO = program([("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("PTP", 100, 0, 0)])


def status(q, s=-1, t=-1, **changes):
    m = TO.motions
    made = replace(TO, motions=replace(m, status=np.array([-1, -1, s]), turn=np.array([-1, -1, t]), **changes))
    return told(
        checks.status_and_turn_issues(made, ROBOT, sampled((0, 1, 2, 2), (1.0, 1.0, 0.5, 1.0)), np.array([q] * 4))
    )


def test_status_of_a_ptp_is_compared_bit_by_bit():
    assert [s for s in range(8) if not status(Q, s=s)] == [2]
    assert status(Q, s=3) == [("status-turn", "error", (3,))]
    assert not status(Q, s=2 + 16)  # bits beyond the third say nothing of the posture
    in_line = changed(4, np.radians(0.009))[0]
    assert not status(in_line, s=6)  # no sign that S could name
    assert status(changed(4, np.radians(0.011))[0], s=6)


@pytest.mark.parametrize("axis", range(6))
def test_turn_of_a_ptp_is_compared_axis_by_axis(axis):
    q = np.radians([10.0, -70.0, 105.0, 20.0, 50.0, 30.0])
    signs = int(((q < 0.0) * 2 ** np.arange(6)).sum())
    assert not status(q, t=signs)
    assert status(q, t=signs ^ 1 << axis) == [("status-turn", "error", (3,))]
    for angle, wrong in ((0.009, False), (-0.009, False), (0.011, True)):
        q[axis] = np.radians(angle)
        assert bool(status(q, t=signs | 1 << axis)) == wrong
    joints = np.full((3, 6), np.nan)
    joints[2] = q
    assert not status(q, t=signs ^ 1 << axis, joints=joints)  # an axis target has none
    assert not status(q, t=signs ^ 1 << axis, kind=TO.motions.kind[[0, 1, 1]])  # nor has a line


@pytest.mark.parametrize("axis", range(6))
def test_start_joints_beyond_a_limit_name_the_joint_and_by_how_much(axis):
    for limit, sign in ((ROBOT.lower, -1.0), (ROBOT.upper, 1.0)):
        at = changed(axis, limit[axis] + sign * np.radians(0.5))[0]
        (issue,) = checks.start_joint_issues(MADE, ROBOT, at)
        assert (issue.kind, issue.level, issue.source_line) == ("start-joints", "error", 1)
        assert f"A{axis + 1} is outside its limits by 0.500°" in issue.message
        assert not list(checks.start_joint_issues(MADE, ROBOT, changed(axis, limit[axis] + sign * 5e-10)[0]))
    near = [
        told(checks.start_joint_issues(MADE, ROBOT, changed(4, np.radians(angle))[0])) for angle in (-0.19, 0.19, 0.21)
    ]
    assert near == [[("start-singular", "warning", ())]] * 2 + [[]]


@pytest.mark.parametrize("axis", [3, 5])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_first_ptp_that_turns_the_hand_by_more_than_150_degrees_is_a_warning(axis, sign):
    def found(by, made=MADE):
        q = changed(axis, Q[axis] + sign * np.radians(by), Q[axis])
        return list(checks.first_move_issues(made, JointPath(q, np.full(2, 2)), Q))

    assert not found(149.9)
    (issue,) = found(150.2)
    assert (issue.kind, issue.level, issue.source_line) == (f"first-move-A{axis + 1}", "warning", 1)
    assert f"turns A{axis + 1} by {sign * 150:.0f}°" in issue.message
    joints = np.full((4, 6), np.nan)
    joints[0] = Q
    assert not found(170.0, replace(MADE, motions=replace(MADE.motions, joints=joints)))
    assert not found(170.0, program([LINES[1], LINES[2]]))


def test_a_ptp_to_another_posture_than_the_one_before_is_told():
    two = program([LINES[0], LINES[1], ("PTP", 0, 0, 0), LINES[2]])
    q = np.array([Q, Q, Q, Q, Q])
    sample = sampled((0, 1, 2, 2, 3), (1.0, 1.0, 0.5, 1.0, 1.0))

    def found(q, start=Q):
        return list(checks.posture_issues(two, ROBOT, sample, JointPath(q, np.full(5, 2)), start))

    assert not found(q)
    (issue,) = found(q, changed(4, -0.5)[0])
    assert (told([issue]), issue.message[:60]) == (
        [("posture", "info", (1,))],
        "The arm changes its posture (status S from 6 to 2): the way "[:60],
    )
    q[3:, 4] = -0.5
    assert told(found(q)) == [("posture", "info", (3,))]
    q = np.array([Q] * 5)
    q[1:3, 4] = -0.5  # of a line it is not asked; of the PTP it is that of the sample before its end
    (issue,) = found(q)
    assert "from 6 to 2" in issue.message


def speeds(motion, x, feed=0.05, made=None, turned=None, commanded=None, turn=0.0):
    """Speeds (N, 6) [rad/s] along a path of places x (N,) [m], on which all joints turn by 0.01 to 0.06 rad a piece."""
    n = len(motion)
    made = program([("LIN", 0, 0, 0)] * 6) if made is None else made
    made = replace(made, motions=replace(made.motions, feed=np.full(len(made.motions), feed)))
    pose = np.tile(np.eye(4), (n, 1, 1))
    pose[:, 0, 3] = x
    if turned is not None:
        pose[:, :3, :3] = Rotation.from_rotvec(np.outer(turned, [0.0, 1.0, 0.0])).as_matrix()
    position = pose[:, :3, 3] if commanded is None else np.column_stack([commanded, np.zeros((n, 2))])
    q = np.arange(n)[:, None] * np.arange(1, 7) * -0.01
    return checks.joint_speed(made, sampled(motion, pose=pose), np.full(len(made.motions), turn), q, position)


STEP = np.arange(1, 7) * 0.01


def test_joint_speed_is_how_far_joints_turn_over_the_time_that_the_feed_gives():
    found = speeds((1, 1, 2, 3), [0.0, 0.01, 0.03, 0.07])
    np.testing.assert_allclose(found, np.outer([0.0, 1 / 0.01, 1 / 0.02, 1 / 0.04], STEP * 0.05), rtol=1e-12)
    # the controller's speed is along the commanded path, if that is longer
    found = speeds((1, 1, 2, 3), [0.0, 0.01, 0.03, 0.07], commanded=[0.0, 0.02, 0.03, 0.11])
    np.testing.assert_allclose(found, np.outer([0.0, 1 / 0.02, 1 / 0.02, 1 / 0.08], STEP * 0.05), rtol=1e-12)


def known(motion, **given):
    x = np.linspace(0.0, 0.03, len(motion))
    return (speeds(motion, given.pop("x", x), **given) > 0.0).all(axis=1).tolist()


def test_joint_speed_is_known_only_where_the_feed_says_it():
    assert known((1, 1, 2, 4)) == [False, True, True, False]  # a motion that stays as it is lies between
    kinds = program([("LIN", 0, 0, 0), ("PTP", 0, 0, 0), ("LIN", 0, 0, 0)])
    assert known((0, 1, 2), made=kinds) == [False, False, True]
    moves = [("LIN", 0, 0, 0)] * 6
    frames_of = frames.pose_from_xyzabc(np.zeros((2, 6)))
    bases = program(moves, bases=frames_of, base=[0, 0, 1, 1, 1, 1])
    assert known((1, 2, 3), made=bases) == [False, False, True]
    tools = program(moves, tools=frames_of)
    tools = replace(tools, motions=replace(tools.motions, tool=np.array([0, 0, 1, 1, 1, 1])))
    assert known((1, 2, 3), made=tools) == [False, False, True]
    for feed in (0.0, np.nan):
        assert known((1, 2, 3), feed=feed) == [False, False, False]
    assert known((1, 2, 3), x=[0.0, 0.9e-6, 2.0e-6]) == [False, False, True]


@pytest.mark.parametrize(("turned", "by_feed"), [(0.9, True), (1.1, False)])
def test_a_piece_that_turns_the_tool_by_more_than_200_degrees_a_second_is_not_timed_by_the_feed(turned, by_feed):
    """The controller's orientation speed is slower there, and not known."""
    x = np.array([0.0, 0.01, 0.02])
    angles = np.radians(200.0) * x / 0.05 * turned
    assert known((1, 2, 3), x=x, turned=angles, turn=1.0) == [False, by_feed, by_feed]
    assert known((1, 2, 3), x=x, turned=angles, turn=0.0) == [False, True, True]  # no motion that turns it


@pytest.mark.parametrize("axis", range(6))
def test_joint_speeds_beyond_the_limit_are_errors_with_the_speed(axis):
    speed = np.zeros((3, 6))
    speed[1:, axis] = ROBOT.speed[axis] * np.array([0.999, 1.25])
    slow = replace(MADE, motions=replace(MADE.motions, rapid=np.zeros(4, dtype=bool)))

    def found(made, speed=speed):
        return list(checks.joint_speed_issues(made, ROBOT, sampled((1, 2, 3)), speed))

    (issue,) = found(slow)
    assert (issue.kind, issue.level, issue.lines) == (f"joint-speed-A{axis + 1}", "error", (4,))
    degrees = np.degrees(ROBOT.speed[axis])
    assert f"{1.25 * degrees:.0f}°/s at the programmed feed (limit {degrees:.0f}°/s). Lower the feed" in issue.message
    guessed = replace(slow, issues=(Issue("warning", "default-speed", ""),))
    assert [issue.level for issue in found(guessed)] == ["warning"]
    fast = replace(MADE, motions=replace(MADE.motions, rapid=np.array([False, False, False, True])))
    (issue,) = found(fast)
    assert "at the speed of rapid moves" in issue.message
    assert "Lower rapid_m_per_s" in issue.message
    both = speed.copy()
    both[1, axis] = 1.5 * ROBOT.speed[axis]
    assert [(issue.lines, "rapid" in issue.message) for issue in found(fast, both)] == [((3,), False), ((4,), True)]


def meet(moved, rows):
    """Branches end with these motions, whose ends are commanded elsewhere by (motion, axis, by)."""
    pose, commanded = five_poses(moved)
    wrench = np.outer(np.arange(5.0), np.arange(1.0, 7.0))
    sample = sampled((0, 1, 2, 2, 3), (1.0, 1.0, 0.5, 1.0, 1.0), pose)
    return list(checks.correction_issues_at_joins(replace(MADE, joins=rows), sample, commanded, wrench))


@pytest.mark.parametrize("axis", range(6))
def test_branches_that_are_corrected_differently_where_they_meet_are_an_error(axis):
    assert not meet([(1, axis, 0.79e-6)], ((1, 2),))
    for row in (1, 3):
        (issue,) = meet([(row, axis, 0.81e-6)], ((1, 2),))
        assert (issue.kind, issue.level, issue.source_line, issue.count, issue.lines) == (
            "branch-forces",
            "error",
            2,
            2,
            (2, 3),
        )
        assert "line 2: F = (1, 2, 3) N, line 3: F = (3, 6, 9) N" in issue.message
    assert not meet([(1, axis, 1e-3), (3, axis, 1e-3)], ((1, 2),))
    assert not meet([(2, axis, 1e-3)], ((1, 2),))  # no end
    assert [issue.lines for issue in meet([(3, axis, 1e-3)], ((-1, 2),))] == [(3,)]  # the start is not corrected
    assert not meet([(1, axis, 1e-3)], ((-1, 2), (-1,)))
    assert [issue.lines for issue in meet([(4, axis, 1e-3)], ((-1,), (1, 2), (2, 3)))] == [(3, 4)]


def test_a_correction_larger_than_allowed_is_an_error():
    def found(*sizes):
        return list(checks.correction_size_issues(MADE, np.array([1, 2, 3]), np.array(sizes), 2e-3))

    assert not found(0.0, 2e-3, 1e-3)
    (issue,) = found(0.0, 2.1e-3, 3e-3)
    assert told([issue]) == [("correction-size", "error", (3, 4))]
    assert "the correction of 3.000 mm is larger than max_correction_mm = 2." in issue.message
    assert told(found(0.0, np.nan, 0.0)) == [("correction-size", "error", (3,))]


def test_rounding_that_grows_by_more_than_the_tolerance_is_a_warning():
    found = told(checks.blending_issues(MADE, np.array([1, 2, 3]), np.array([1e-5, -1.0, 1.1e-5]), 1e-5))
    assert found == [("blending", "warning", (4,))]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_loads_beyond_those_measured_are_warnings_with_both_torques(sign):
    tool = frames.pose_from_xyzabc([20.0, -30.0, 350.0, 10.0, 20.0, 30.0])
    wrench = sign * np.array([300.0, -200.0, 500.0, 40.0, -60.0, 80.0])
    force = ARM.gradient(lambda x: wrench[:3] @ ARM.tcp(x, tool)[:3, 3], Q)
    torque = np.abs(force + ARM.moment_torque(Q, wrench[3:]))
    q, wrenches = np.array([Q, Q]), np.array([0.5 * wrench, wrench])
    for joint in range(6):
        for share, beyond in ((1.09, False), (1.11, True)):
            measured = np.full(6, 1e9)
            measured[joint] = torque[joint] / share
            model = replace(ROBOT, measured=MeasuredRange(measured, ""))
            found = list(checks.torque_warnings(MADE, model, np.array([2, 3]), q, tool, wrenches))
            assert told(found) == ([(f"beyond-measured-A{joint + 1}", "warning", (4,))] if beyond else [])
        assert f"up to {torque[joint]:.0f} N·m on A{joint + 1}" in found[0].message
        assert f"measured up to {measured[joint]:.0f}:" in found[0].message
    assert not list(checks.torque_warnings(MADE, replace(ROBOT, measured=None), np.array([2, 3]), q, tool, wrenches))


def test_a_circle_that_turns_the_tool_with_the_path_names_the_setting():
    text = (
        "DEF P( )\n$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}\n$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}\n"
        "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}\n$VEL.CP=0.1\n$ORI_TYPE=#VAR\n$CIRC_TYPE=%s\n"
        "LIN {X 100,Y 0,Z 50,A 180,B 0,C 180}\n"
        "CIRC {X 130,Y 30,Z 50},{X 160,Y 0,Z 50,A 180,B 0,C 180}\nEND\n"
    )
    for circle, is_named in (("#PATH", True), ("#BASE", False)):
        result = correct_files({"part.src": text % circle})
        said = [issue.message for issue in result.issues if issue.kind == "half-turn"]
        assert [("$CIRC_TYPE=#BASE (KRL) keeps its orientation" in message) for message in said] == [True] * is_named
