"""Each check of a path is part of the release: a program with that fault alone is refused, with its line."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction
from postproc.poses import Poses
from postproc.robot import MeasuredRange
from tests.kr270 import CELL, FOLDER, ROBOT, TOOL
from tests.oracle.arm import Arm
from tests.programs import program

ARM = Arm.load(FOLDER)
FORCE = [(2, (120.0, 50.0, 90.0, 4.0, -3.0, 2.0))]
NORMAL = (10.0, -70.0, 105.0, 20.0, 50.0, 30.0)


def between(first, last, model=ROBOT, cell=CELL, **settings):
    """Result of a straight cutting move from joint angles to others [deg], and a little back."""
    poses = [ARM.tcp(np.radians(angles), TOOL) for angles in (first, first, last, last)]
    poses[3][:3, 3] += 0.05 * (poses[0][:3, 3] - poses[2][:3, 3])
    moves = [(kind, *(1e3 * pose[:3, 3])) for kind, pose in zip(("PTP", "LIN", "LIN", "LIN"), poses, strict=True)]
    made = program(moves, notes=FORCE, bases=np.eye(4)[None], tools=TOOL[None])
    m = made.motions
    pose = m.target[:]
    pose[:, :3, :3] = np.array(poses)[:, :3, :3]
    joints = np.full((4, 6), np.nan)
    joints[0] = np.radians(first)
    feed = np.full(4, settings.pop("feed", 1e-4))
    motions = replace(m, target=Poses.of(pose), joints=joints, feed=feed, **settings)
    return correction.process(replace(made, motions=motions), model, cell)


def near(**changes):
    """Joint angles of the normal pose but for some [deg]."""
    angles = list(NORMAL)
    for name, value in changes.items():
        angles[int(name[1]) - 1] = value
    return tuple(angles)


STRETCHED = -2.862
"""A3 of the arm that is stretched out [deg]."""
OVER_A1 = -67.86
"""A3 at which the wrist is above the axis of A1, with A2 = -70 [deg]."""
CASES = {
    "wrist-singularity": (near(A5=3.0), near(A5=0.1)),
    "elbow-singularity": (near(A3=STRETCHED + 2.0), near(A3=STRETCHED + 0.1)),
    "shoulder-singularity": (near(A3=OVER_A1 + 2.0), near(A3=OVER_A1 + 0.1)),
    "joint-limit-A1": (near(A1=184.0), near(A1=185.2)),
    "joint-limit-A2": (near(A2=-145.0, A3=120.0), near(A2=-146.2, A3=120.0)),
    "joint-limit-A3": (near(A3=154.0), near(A3=155.2)),
    "joint-limit-A4": (near(A4=349.0), near(A4=350.3)),
    "joint-limit-A5": (near(A5=124.0), near(A5=125.3)),
    "joint-limit-A6": (near(A6=-349.0), near(A6=-350.3)),
}


@pytest.mark.parametrize("kind", CASES)
def test_a_move_into_a_limit_or_singularity_is_refused_and_the_same_move_before_it_is_not(kind):
    first, last = CASES[kind]
    result = between(first, last)
    assert kind in {issue.kind for issue in result.issues if issue.level == "error"}, result.issues
    assert {issue.source_line for issue in result.issues if issue.kind == kind} <= {3, 4}
    assert result.documents == ()
    before = tuple(a + 0.5 * (b - a) for a, b in zip(first, last, strict=True))
    allowed = between(first, before)
    assert not allowed.failed, allowed.issues
    assert allowed.documents


@pytest.mark.parametrize("axis", range(6))
def test_each_joint_that_would_turn_too_fast_is_refused(axis):
    """One joint may turn by 0.4 % of its speed only, as the move turns all of them by a degree or two."""
    last = tuple(angle + 1.5 for angle in NORMAL)
    assert not between(NORMAL, last, feed=0.05).failed
    slow = ROBOT.speed.copy()
    slow[axis] *= 0.004
    result = between(NORMAL, last, model=replace(ROBOT, speed=slow), feed=0.05)
    assert [issue.kind for issue in result.issues if issue.level == "error"] == [f"joint-speed-A{axis + 1}"]
    assert result.documents == ()


def test_a_correction_larger_than_allowed_and_loads_beyond_those_measured_are_found_on_the_whole_way():
    small = replace(CELL, output=replace(CELL.output, max_correction_mm=0.01))
    result = between(NORMAL, near(A1=11.0), cell=small)
    assert [issue.kind for issue in result.issues if issue.level == "error"] == ["correction-size"]
    model = replace(ROBOT, measured=MeasuredRange(np.full(6, 0.01), ""))
    result = between(NORMAL, near(A1=11.0), model=model)
    kinds = {issue.kind for issue in result.issues if issue.level == "warning"}
    assert {f"beyond-measured-A{n}" for n in range(1, 7)} <= kinds


@pytest.mark.parametrize(("status", "turn", "refused"), [(2, 2, False), (6, 2, True), (2, 3, True)])
def test_a_ptp_whose_status_or_turn_no_pose_of_the_arm_has_is_refused(status, turn, refused):
    """S says how the arm stands, T the signs of the joints; A1 cannot be negative there."""
    given = {"status": np.array([-1, -1, status, -1]), "turn": np.array([-1, -1, turn, -1])}
    kind = between(NORMAL, near(A1=11.0)).program.motions.kind.copy()
    kind[2] = kind[0]
    result = between(NORMAL, near(A1=11.0), kind=kind, **given)
    found = [issue.kind for issue in result.issues if issue.level == "error"]
    assert found == (["status-turn"] if refused else [])
