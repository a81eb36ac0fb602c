"""What happens between the places computed on an arc: joints at their fastest, at a limit, in a singularity.

The joint angles of the circles come from the arm that shares no code with the package, every 3°.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from msgspec.structs import replace as changed

from postproc import cell as cells
from postproc import correction, robot, toolpath
from postproc.under_load import MotionsUnderLoad, PathUnderLoad, RobotInCell
from tests.oracle.arm import Arm
from tests.programs import program

CELL = cells.load(Path(__file__).parents[2] / "samples/cell_kr270.toml")
MODEL = robot.load(robot.find("kuka_kr270"))
ARM = Arm.load(robot.find("kuka_kr270"))
TOOL = np.eye(4)
TOOL[2, 3] = 0.35
RNG = np.random.default_rng(8)
POSTURES = np.radians(RNG.uniform([-60, -100, 80, -80, 20, -80], [60, -50, 120, 80, 80, 80], size=(6, 6)))
NORMALS = RNG.normal(size=(6, 3))


def circle(posture, normal, radius_mm, feed, begin_deg=0.0, sweep_deg=360.0):
    """An arc about the tip of a posture (its tool frame is `$BASE`), and (n, 6) joint angles along it, every 3°."""
    base, normal = ARM.nominal_tcp(posture, TOOL), normal / np.linalg.norm(normal)
    along = np.cross(normal, [0.6, 0.0, 0.8])
    along /= np.linalg.norm(along)
    across = np.cross(normal, along)
    angles = np.radians(begin_deg + np.linspace(0.0, sweep_deg, round(sweep_deg / 3) + 1))
    spots = radius_mm * (np.cos(angles)[:, None] * along + np.sin(angles)[:, None] * across)
    made = program(
        [("PTP", *spots[0]), ("CIRC", *spots[-1], 0, 0, 0, sweep_deg, normal)],
        bases=base[None], tools=TOOL[None], orientation=np.eye(3),
    )  # fmt: skip
    made.motions.feed[1] = feed
    made.motions.status[0] = 2 + 4 * (posture[4] < 0.0)
    joints = []
    for spot in spots:
        pose = base.copy()
        pose[:3, 3] += base[:3, :3] @ spot / 1000.0
        joints.append(ARM.inverse(pose, TOOL, joints[-1] if joints else posture))
    return made, np.array(joints)


def errors(made, model=MODEL, start=None):
    cell = CELL
    if start is not None:
        cell = changed(CELL, start=changed(CELL.start, joints=tuple(np.degrees(start).tolist())))
    return [
        issue.kind for issue in correction.process(made, model, cell, mode="nominal").issues if issue.level == "error"
    ]


@pytest.mark.parametrize("case", range(6))
def test_joints_are_as_fast_as_in_the_middle_of_the_arc(case):
    sweep, radius = (360.0, 180.0, 75.0)[case % 3], 20.0
    made, q = circle(POSTURES[case], NORMALS[case], radius, 0.1, 17.0 * case, sweep)
    slope = np.abs(np.diff(q, axis=0)).max(axis=0) / (np.radians(3.0) * radius / 1000.0)
    fastest = MODEL.speed / slope
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
        limits = MODEL.upper.copy()
        limits[axis] = upper
        assert errors(made, replace(MODEL, upper=limits), q[q[:, axis].argmin()]) == found


@pytest.mark.parametrize("begin", [-33.0, -90.0, -95.0, -150.0])
def test_a_wrist_singularity_in_the_middle_of_an_arc_is_found(begin):
    """The wrist is straight at one place of a circle of 20 mm."""
    straight = POSTURES[0].copy()
    straight[4] = 0.0
    base = ARM.nominal_tcp(straight, TOOL)
    normal = np.array([0.0, 1.0, 0.0])
    centre, radius = np.array([-20.0, 0.0, 0.0]), 20.0

    def spot(angle):
        return centre + radius * np.array([np.cos(angle), 0.0, -np.sin(angle)])

    made = program(
        [("PTP", *spot(np.radians(begin))), ("CIRC", *spot(np.radians(begin + 190.0)), *centre, 190.0, normal)],
        bases=base[None], tools=TOOL[None], orientation=np.eye(3),
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
    made = program([("PTP", 0, 190.5, 0), ("LIN", 0, 209.5, 0)], orientation=CELL.tool_pose_in_program())
    motions = MotionsUnderLoad.of(made, RobotInCell.of(MODEL, CELL), None)
    path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    assert len(path) == 2
    middle = toolpath.at(made, motions.segments, np.array([1]), np.array([0.5]))
    (inside,) = [ARM.inverse(motions.program.bases[0] @ middle.pose[0], made.tools[0], path.joints.q[0])]
    beyond = np.maximum(*path.joints.q) < inside - 1e-6
    assert beyond.any()
    for axis in np.flatnonzero(beyond).tolist():
        upper = MODEL.upper.copy()
        upper[axis] = 0.5 * (path.joints.q[:, axis].max() + inside[axis])
        assert errors(made, replace(MODEL, upper=upper)) == [f"joint-limit-A{axis + 1}"]
