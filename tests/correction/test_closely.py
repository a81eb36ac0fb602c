"""What happens between the places computed on an arc: joints at their fastest, at a limit, in a singularity.

The joint angles of the circles come from the arm that shares no code with the package, every 3°.
"""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace
from msgspec.structs import replace as changed

from postproc import cell as cells
from postproc import correction, kinematics, toolpath
from postproc.correction import inspection
from postproc.poses import Poses
from postproc.program import CIRC, LIN
from postproc.under_load import MotionsUnderLoad, PathUnderLoad, RobotInCell
from tests.kr270 import CELL, FOLDER, ROBOT, STRAIGHT_TOOL
from tests.oracle.arm import Arm
from tests.programs import program

CELL_WITH_START = changed(CELL, start=cells.Start(joints=(0.0, -70.0, 110.0, 0.0, 50.0, 0.0)))
ARM = Arm.load(FOLDER)
RNG = np.random.default_rng(8)
POSTURES = np.radians(RNG.uniform([-60, -100, 80, -80, 20, -80], [60, -50, 120, 80, 80, 80], size=(6, 6)))
NORMALS = RNG.normal(size=(6, 3))


def circle(posture, normal, radius_mm, feed, begin_deg=0.0, sweep_deg=360.0):
    """An arc about the tip of a posture (its tool frame is `$BASE`), and (n, 6) joint angles along it, every 3°."""
    base, normal = ARM.nominal_tcp(posture, STRAIGHT_TOOL), normal / np.linalg.norm(normal)
    along = np.cross(normal, [0.6, 0.0, 0.8])
    along /= np.linalg.norm(along)
    across = np.cross(normal, along)
    angles = np.radians(begin_deg + np.linspace(0.0, sweep_deg, round(sweep_deg / 3) + 1))
    spots = radius_mm * (np.cos(angles)[:, None] * along + np.sin(angles)[:, None] * across)
    made = program(
        [("PTP", *spots[0]), ("CIRC", *spots[-1], 0, 0, 0, sweep_deg, normal)],
        bases=base[None], tools=STRAIGHT_TOOL[None], orientation=np.eye(3),
    )  # fmt: skip
    made.motions.feed[1] = feed
    made.motions.status[0] = 2 + 4 * (posture[4] < 0.0)
    joints = []
    for spot in spots:
        pose = base.copy()
        pose[:3, 3] += base[:3, :3] @ spot / 1000.0
        joints.append(ARM.inverse(pose, STRAIGHT_TOOL, joints[-1] if joints else posture))
    return made, np.array(joints)


def errors(made, model=ROBOT, start=None):
    cell = CELL_WITH_START
    if start is not None:
        cell = changed(CELL_WITH_START, start=changed(CELL_WITH_START.start, joints=tuple(np.degrees(start).tolist())))
    return [
        issue.kind for issue in correction.process(made, model, cell, mode="nominal").issues if issue.level == "error"
    ]


@pytest.mark.parametrize("case", range(6))
def test_joints_are_as_fast_as_in_the_middle_of_the_arc(case):
    sweep, radius = (360.0, 180.0, 75.0)[case % 3], 20.0
    made, q = circle(POSTURES[case], NORMALS[case], radius, 0.1, 17.0 * case, sweep)
    slope = np.abs(np.diff(q, axis=0)).max(axis=0) / (np.radians(3.0) * radius / 1000.0)
    fastest = ROBOT.speed / slope
    made.motions.feed[1] = 0.985 * fastest.min()
    assert errors(made) == []
    faster = made.motions.feed.copy()
    faster[1] = 1.015 * fastest.min()
    made = replace(made, motions=replace(made.motions, feed=faster))
    assert errors(made) == [f"joint-speed-A{fastest.argmin() + 1}"]


@pytest.mark.parametrize("axis", range(6))
def test_a_limit_passed_in_the_middle_of_an_arc_is_found(axis):
    made, q = circle(POSTURES[axis], NORMALS[axis], 20.0, 0.01, 25.0)
    highest, span = q[:, axis].max(), np.ptp(q[:, axis])
    for upper, found in ((highest - 0.01 * span, [f"joint-limit-A{axis + 1}"]), (highest + 0.01 * span, [])):
        limits = ROBOT.upper.copy()
        limits[axis] = upper
        assert errors(made, replace(ROBOT, upper=limits), q[q[:, axis].argmin()]) == found


@pytest.mark.parametrize("begin", [-33.0, -90.0, -95.0, -150.0])
def test_a_wrist_singularity_in_the_middle_of_an_arc_is_found(begin):
    """The wrist is straight at one place of a circle of 20 mm."""
    straight = POSTURES[0].copy()
    straight[4] = 0.0
    base = ARM.nominal_tcp(straight, STRAIGHT_TOOL)
    normal = np.array([0.0, 1.0, 0.0])
    centre, radius = np.array([-20.0, 0.0, 0.0]), 20.0

    def spot(angle):
        return centre + radius * np.array([np.cos(angle), 0.0, -np.sin(angle)])

    made = program(
        [("PTP", *spot(np.radians(begin))), ("CIRC", *spot(np.radians(begin + 190.0)), *centre, 190.0, normal)],
        bases=base[None], tools=STRAIGHT_TOOL[None], orientation=np.eye(3),
    )  # fmt: skip
    made.motions.feed[1], made.motions.status[0] = 1e-4, 2
    assert errors(made) == ["wrist-singularity"]


@pytest.mark.parametrize("case", range(4))
def test_a_slow_circle_about_a_wrist_singularity_passes(case):
    """A4 turns by more than 45° from one place computed to the next, but never at once."""
    straight = POSTURES[case].copy()
    straight[3:] = np.radians([20.0 * case, 0.0, 10.0])
    made, q = circle(straight, np.array([0.0, 0.0, 1.0]), 40.0, 1e-3, 20.0 * case, 200.0)
    assert np.ptp(q[:, 3]) > np.radians(100.0)
    assert np.abs(np.diff(q, axis=0)).max() < np.radians(20.0)
    assert errors(made) == []


def test_a_line_that_passes_a_limit_between_its_samples_is_refused():
    """A line across the plane of A1: reach, and with it A2 and A3, have their extreme between its ends."""
    made = program([("PTP", 0, 190.5, 0), ("LIN", 0, 209.5, 0)], orientation=CELL_WITH_START.tool_orientation())
    motions = MotionsUnderLoad.of(made, RobotInCell.of(ROBOT, CELL_WITH_START), None)
    path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    assert len(path) == 2
    middle = toolpath.at(made, motions.segments, np.array([1]), np.array([0.5]))
    (inside,) = [ARM.inverse(motions.program.bases[0] @ middle.pose[0], made.tools[0], path.joints.q[0])]
    beyond = np.maximum(*path.joints.q) < inside - 1e-6
    assert beyond.any()
    for axis in np.flatnonzero(beyond).tolist():
        upper = ROBOT.upper.copy()
        upper[axis] = 0.5 * (path.joints.q[:, axis].max() + inside[axis])
        assert errors(made, replace(ROBOT, upper=upper)) == [f"joint-limit-A{axis + 1}"]


def arcs_and_lines():
    """A path of lines and arcs, one of which turns the tool, under a force in FEED axes."""
    moves = [
        ("LIN", 0, 0, 50), ("CIRC", 40, 0, 50, 20, 0, 50, 180.0, (0, 0, 1)), ("LIN", 40, 0, 0), ("LIN", 41, 0, 0),
        ("CIRC", 61, 20, 0, 41, 20, 0, 90.0, (0, 0, 1)), ("LIN", 61, 120, 0), ("CIRC", 61, 160, 0, 61, 140, 0, 540.0,
        (0, 0, 1)), ("PTP", 0, 0, 60), ("LIN", 0, 100, 60),
    ]  # fmt: skip
    made = program(
        moves,
        [(3, (900.0, 500.0, -700.0, 0.0, 0.0, 0.0), "FEED")],
        orientation=CELL_WITH_START.tool_orientation(),
    )
    turned = made.motions.target[:]
    turned[8, :3, :3] = turned[8, :3, :3] @ np.array([[np.cos(1), 0, np.sin(1)], [0, 1, 0], [-np.sin(1), 0, np.cos(1)]])
    made = replace(made, motions=replace(made.motions, target=Poses.of(turned)))
    motions = MotionsUnderLoad.of(made, RobotInCell.of(ROBOT, CELL_WITH_START), None)
    path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    return path


@pytest.mark.parametrize("arc", [1, 4, 6])
@pytest.mark.parametrize("axis", range(6))
def test_an_arc_at_whose_end_a_joint_comes_near_its_limit_is_examined(arc, axis):
    """It steps by 5°, to 7.5° before the limit: as near as two more such steps."""
    path = arcs_and_lines()
    q = np.tile(np.radians([0.0, -70.0, 110.0, 20.0, 50.0, 0.0]), (len(path), 1))
    last = np.flatnonzero(path.sample.motion == arc)[-1]
    for gap, examined in ((7.5, [arc]), (10.5, [])):
        q[:, axis] = ROBOT.upper[axis] - np.radians(gap + 5.0)
        q[last:, axis] += np.radians(5.0)
        start = changed(CELL_WITH_START.start, joints=tuple(np.degrees(q[0])))
        near = RobotInCell.of(ROBOT, changed(CELL_WITH_START, start=start))
        path = replace(path, motions=replace(path.motions, robot_in_cell=near))
        arcs, _ = inspection.stretches_to_examine(path, q, np.zeros((len(path), 6)))
        assert arcs.motion.tolist() == examined


def test_arcs_and_pieces_of_lines_are_examined_where_joints_limits_and_singularities_are_near():
    """All joints and speeds by chance; the rules of the module in plain loops, motion by motion."""
    path = arcs_and_lines()
    motions, made = path.motions, path.program
    form, sample, kind = kinematics.closed_form(ROBOT), path.sample, made.motions.kind
    # how near to zero: A5, the wrist ahead of A1 and A3 from the stretched arm
    step_of = np.array([0.3, 0.3, 0.3, 4.0, 4.0, 4.0])
    found_arcs, found_lines = 0, 0
    for seed in range(60):
        random = np.random.default_rng(seed)
        q = np.radians([0.0, -70.0, 110.0, 20.0, 50.0, 0.0]) + np.cumsum(
            np.radians(step_of) * random.normal(size=(len(path), 6)), axis=0
        ) * random.choice([0.02, 0.2, 2.0])
        near = random.integers(14)  # which limit or singularity the path is near
        if near < 6:
            q[:, near] += random.choice([ROBOT.lower, ROBOT.upper])[near] - q[random.integers(len(q)), near]
        elif near == 6:
            q[:, 4] -= q[random.integers(len(q)), 4]
        elif near == 7:
            q[:, 2] -= float(form.elbow_angle_from_stretched(q)[random.integers(len(q))])
        elif near in (8, 9):
            q[:, 1:3] += np.radians([-70.0, -67.86]) + random.normal(size=2) * 0.01 - q[random.integers(len(q)), 1:3]
        speed = ROBOT.speed * random.uniform(0.0, 0.8 if seed % 3 == 0 else 0.7, (len(path), 6))
        cell = changed(
            CELL_WITH_START,
            start=changed(CELL_WITH_START.start, joints=tuple(np.degrees(q[0] + random.normal(size=6) * 0.01))),
        )
        other = replace(path, motions=replace(motions, robot_in_cell=RobotInCell.of(ROBOT, cell)))
        arcs, lines = inspection.stretches_to_examine(other, q, speed)

        states = [cell.start_joints, *q]
        wrist, ahead, elbow = ([float(of(np.array([x]))[0]) for x in states] for of in (
            lambda x: x[:, 4], form.wrist_distance_ahead_of_a1, form.elbow_angle_from_stretched))  # fmt: skip
        room = [[*np.minimum(x - ROBOT.lower, ROBOT.upper - x), abs(a), abs(b), abs(c)]
                for x, a, b, c in zip(states, wrist, ahead, elbow, strict=True)]  # fmt: skip
        step = [[*np.abs(states[n + 1] - states[n]), *(abs(of[n + 1] - of[n]) for of in (wrist, ahead, elbow))]
                for n in range(len(q))]  # fmt: skip
        fast = (speed > 0.75 * ROBOT.speed).any(axis=1)
        expected = []
        for motion in np.flatnonzero(kind == CIRC):
            rows = np.flatnonzero(sample.motion == motion)
            most = 2.0 * np.max([step[n] for n in rows], axis=0)
            limit = [*most[:6], max(most[6], np.radians(1.0)), most[7] + 0.005, np.radians(20.0)]
            close = any((np.array(room[n + 1]) < limit).any() for n in rows)
            if fast[rows].any() or max(max(step[n][:6]) for n in rows) > np.radians(10.0) or close:
                expected.append(motion)
        assert arcs.motion.tolist() == expected, seed
        assert arcs.parts.tolist() == [{1: 36, 4: 18, 6: 108}[motion] for motion in expected]  # every 5°
        pieces = []
        for n, (motion, t) in enumerate(zip(sample.motion.tolist(), sample.t.tolist(), strict=True)):
            begin = sample.t[n - 1] if n and sample.motion[n - 1] == motion else 0.0
            way, turn = (float(each[motion]) * (t - begin) for each in (motions.segments.travel, motions.segments.turn))
            if kind[motion] != LIN or (way <= 0.002 and turn <= np.radians(0.5)):
                continue
            limit = [*(2.0 * s + way / 0.15 + 6.0 * turn for s in step[n][:7])]
            limit += [2.0 * step[n][7] + way + 0.5 * turn + 0.005, 5.0 * way + 3.0 * turn]
            if fast[n] or (np.minimum(room[n], room[n + 1]) < limit).any():
                pieces.append((motion, begin, t, int(np.ceil(max(way / 0.002, turn / np.radians(0.5)) - 1e-9))))
        assert (
            list(zip(*(x.tolist() for x in (lines.motion, lines.begin, lines.end, lines.parts)), strict=True)) == pieces
        )
        found_arcs, found_lines = found_arcs + len(expected), found_lines + len(pieces)
    assert 30 < found_arcs < 150
    assert found_lines > 60
