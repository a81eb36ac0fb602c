"""What the robot can drive: margins by an arm of another library, reasons and their order, speeds."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.frames import wrap_angles
from postproc.kinematics.components import components
from postproc.placement import drive
from postproc.placement.drive import COLLISION, FREE, LIMIT, REACH, SINGULAR, SPEED, LeastMargins, Margins
from tests.collision.setting import frame
from tests.kr270 import ROBOT


def test_angles_are_wrapped_to_half_a_turn():
    angles = np.radians([0.0, 179.0, 181.0, -181.0, 540.0 - 1.0, -350.0, 720.0])
    np.testing.assert_allclose(np.degrees(wrap_angles(angles)), [0, 179, -179, 179, 179, 10, 0], atol=1e-9)


def poses(count: int = 40) -> np.ndarray:
    """Joint angles within the limits, A4 and A6 within half a turn."""
    low, high = ROBOT.lower.copy(), ROBOT.upper.copy()
    low[[3, 5]], high[[3, 5]] = -3.1, 3.1
    return np.random.default_rng(6).uniform(low, high, (count, 6))


def test_solved_angles_reach_the_flange_within_half_a_turn_of_the_middle_of_the_limits():
    q = poses()
    flange = components(np.array([frame(row, 6) for row in q]))
    middle = 0.5 * (ROBOT.lower + ROBOT.upper)
    is_back = np.zeros(len(q), dtype=bool)
    for branch in range(8):
        solved = drive.solve(ROBOT, flange, branch)
        good = np.isfinite(solved).all(axis=0)
        for row in np.flatnonzero(good):
            np.testing.assert_allclose(frame(solved[:, row], 6), frame(q[row], 6), atol=1e-9)
        assert (np.abs(solved[:, good] - middle[:, None]) <= np.pi + 1e-12).all()
        is_back |= (np.abs(wrap_angles(solved - q.T)) < 1e-7).all(axis=0)
    assert is_back.all()


def test_margins_are_those_of_the_arm_in_space():
    """The wrist centre is the frame of A5; the elbow angle is that between the upper arm and the line to the wrist."""
    q = poses()
    margins = drive.margins(ROBOT, q.T)
    np.testing.assert_allclose(margins.joint, np.minimum(q - ROBOT.lower, ROBOT.upper - q).min(axis=1), atol=1e-12)
    np.testing.assert_allclose(margins.wrist, np.abs(q[:, 4]), atol=1e-12)
    for row, angles in enumerate(q):
        shoulder, elbow, wrist = (frame(angles, carrier)[:3, 3] for carrier in (1, 2, 4))
        assert margins.shoulder[row] == pytest.approx(np.hypot(wrist[0], wrist[1]), abs=1e-9)
        upper, fore = elbow - shoulder, wrist - elbow
        cosine = upper @ fore / np.linalg.norm(upper) / np.linalg.norm(fore)
        assert margins.elbow[row] == pytest.approx(np.arccos(cosine), abs=1e-6)
    beyond = drive.margins(ROBOT, (ROBOT.upper + 0.1)[:, None])
    assert beyond.joint[0] == pytest.approx(-0.1)
    assert np.isnan(drive.margins(ROBOT, np.full((6, 1), np.nan)).joint[0])


KEEP = LeastMargins(joint=0.1, wrist=0.2, elbow=0.3, shoulder=0.4, speed=0.9, jump=0.5)
GOOD = {"joint": 0.1, "wrist": 0.2, "elbow": 0.3, "shoulder": 0.4, "speed": 0.9, "jump": 0.5, "hit": False}
STEP = 1e-9


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, FREE),
        ({"joint": np.nan}, REACH), ({"joint": 0.1 - STEP}, LIMIT), ({"wrist": 0.2 - STEP}, SINGULAR),
        ({"elbow": 0.3 - STEP}, SINGULAR), ({"shoulder": 0.4 - STEP}, SINGULAR), ({"jump": 0.5 + STEP}, SINGULAR),
        ({"speed": 0.9 + STEP}, SPEED), ({"speed": np.nan}, SPEED), ({"hit": True}, COLLISION),
        ({"hit": True, "speed": 1.0}, SPEED), ({"speed": 1.0, "jump": 1.0}, SINGULAR),
        ({"wrist": 0.0, "joint": 0.0}, LIMIT), ({"joint": np.nan, "wrist": np.nan, "speed": 1.0, "hit": True}, REACH),
    ],
)  # fmt: skip
def test_the_first_reason_to_refuse_counts(changes, expected):
    state = {name: np.array([[value]]) for name, value in (GOOD | changes).items()}
    margins = Margins(*(state[name] for name in ("joint", "wrist", "elbow", "shoulder")))
    reasons = drive.reason(margins, state["speed"], state["jump"], KEEP, state["hit"])
    assert reasons.shape == (1, 1)
    assert reasons[0, 0] == expected
    without = drive.reason(margins, state["speed"], state["jump"], KEEP)[0, 0]
    assert without == (FREE if expected == COLLISION else expected)
    assert drive.is_refused(reasons)[0, 0] == (expected != FREE)


def test_margins_are_those_of_the_documentation_and_the_least_ones_just_what_a_conversion_accepts():
    """The checks of a conversion refuse 0° to a joint limit, 0.2° of A5 and A3, 5 mm, all of a speed, turns of 45°."""
    keep, bare = LeastMargins(), drive.BARE_MARGINS
    assert np.degrees([keep.joint, keep.wrist, keep.elbow]) == pytest.approx([2.0, 1.0, 1.0])
    assert (keep.shoulder, keep.speed, np.degrees(keep.jump)) == (0.02, 0.95, pytest.approx(40.0))
    assert 0.0 < np.degrees(bare.joint) < 0.02
    for least, refused in ((np.degrees(bare.wrist), 0.2), (np.degrees(bare.elbow), 0.2), (bare.shoulder, 5e-3)):
        assert refused < least <= 1.26 * refused
    for largest, refused in ((bare.speed, 1.0), (np.degrees(bare.jump), 45.0)):
        assert 0.97 * refused < largest < refused


def test_the_largest_share_of_a_joint_speed_counts():
    step = np.array([[0.2, 0.0], [-0.9, 0.0], [0.1, 0.0], [0.0, -0.3], [0.0, 0.1], [0.0, 0.0]])
    share = drive.largest_speed_share(ROBOT, step, np.array([0.5, np.inf]))
    assert share[0] == pytest.approx(max(0.2 / ROBOT.speed[0], 0.9 / ROBOT.speed[1]) / 0.5)
    assert share[1] == 0.0
    assert drive.largest_speed_share(ROBOT, step, np.array([0.5, 2.0]))[1] == pytest.approx(0.3 / ROBOT.speed[3] / 2.0)
