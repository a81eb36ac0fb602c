"""Assumed arms hold real ones: extreme points of published collision meshes lie inside at all angles."""

from __future__ import annotations

import csv

import numpy as np
import pinocchio as pin
import pytest
from msgspec.structs import replace

from postproc.collision.bodies import Body, arm_capsules
from postproc.robot.chain import Chain
from tests.places import ROOT

_AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]], dtype=float)
_ARMS = {
    "KR 16-2": [(0, 0, 675), (260, 0, 0), (680, 0, 0), (670, 0, -35), (0, 0, 0), (0, 0, 0), (158, 0, 0)],
    "KR 120 R2500": [(0, 0, 675), (350, 0, 0), (1150, 0, 0), (1000, 0, -41), (0, 0, 0), (0, 0, 0), (215, 0, 0)],
    "KR 150-2": [(0, 0, 750), (350, 0, 0), (1250, 0, 0), (0, 0, -55), (1100, 0, 0), (230, 0, 0), (0, 0, 0)],
    "KR 150 R3100": [(0, 0, 645), (330, 0, 0), (1350, 0, 0), (1420, 0, 115), (0, 0, 0), (215, 0, 0), (0, 0, 0)],
    "IRB 6640": [(0, 0, 780), (320, 0, 0), (0, 0, 1075), (0, 0, 200), (1392, 0, 0), (200, 0, 0), (0, 0, 0)],
}
"""Joints A1 to A6 and flange, each in the frame before it, in mm: of the published URDF files of the meshes."""


def published() -> dict[tuple[str, int], np.ndarray]:
    """Extreme points [m] by arm and link; the file names their source."""
    lines = (ROOT / "tests" / "collision" / "arms.csv").read_text().splitlines()
    table: dict[tuple[str, int], list[list[float]]] = {}
    for row in csv.DictReader(line for line in lines if not line.startswith("#")):
        table.setdefault((row["arm"], int(row["link"])), []).append([1e-3 * float(row[key]) for key in "xyz"])
    return {key: np.array(points) for key, points in table.items()}


def chain(name: str) -> Chain:
    frames = np.tile(np.eye(4), (7, 1, 1))
    frames[:, :3, 3] = 1e-3 * np.array(_ARMS[name])
    zero, far = np.zeros(6), np.full(6, 3.0)
    return Chain(frames[:6], _AXES, np.ones(6, dtype=bool), frames[6], zero, np.zeros((6, 3)), -far, far, far, zero)


def beyond(points: np.ndarray, body: Body) -> np.ndarray:
    """By how much points (P, 3) in the frame of a capsule's carrier are outside of it [m]; negative inside."""
    radius, length = body.size
    local = (points - body.pose[:3, 3]) @ body.pose[:3, :3]
    local[:, 2] -= np.clip(local[:, 2], -0.5 * length, 0.5 * length)
    return np.linalg.norm(local, axis=1) - radius


def turned(points: np.ndarray, name: str, link: int, step: int) -> list[np.ndarray]:
    """Points of a link in the frame of the one before it (step -1) or behind it (1), at angles of the joint between."""
    joint = link if step < 0 else link + 1
    offset = 1e-3 * np.array(_ARMS[name][joint - 1], dtype=float)
    rotations = [pin.exp3(_AXES[joint - 1] * angle) for angle in np.radians(np.arange(0, 360, 30))]
    if step < 0:
        return [points @ rotation.T + offset for rotation in rotations]
    return [(points - offset) @ rotation for rotation in rotations]


def outside(name: str, link: int, points: np.ndarray) -> np.ndarray:
    """By how much points of a link stick out of the assumed arm, whatever the angles of the joints next to it [m]."""
    capsules = list(arm_capsules(chain(name)))
    distances = [beyond(points, body) for body in capsules if body.carrier == link - 1]
    for step in (-1, 1):
        if 0 <= link + step <= 6:
            places = turned(points, name, link, step)
            neighbours = [body for body in capsules if body.carrier == link - 1 + step]
            distances += [np.max([beyond(place, body) for place in places], axis=0) for body in neighbours]
    return np.min(distances, axis=0)


@pytest.mark.parametrize("name", _ARMS)
def test_no_point_of_a_real_arm_is_outside_of_the_assumed_one(name):
    table = published()
    assert [link for arm, link in table if arm == name] == list(range(7))
    for link in range(7):
        points = table[name, link]
        assert outside(name, link, points).max() <= 0.0, (link, points[outside(name, link, points).argmax()])


@pytest.mark.parametrize("link", range(7))
def test_one_of_the_real_arms_comes_close_to_the_surface_of_each_assumed_link(link):
    """45 mm: what is much thicker would refuse programs that can be driven."""
    table = published()
    assert max(outside(name, link, table[name, link]).max() for name in _ARMS) > -0.045


def capsules_with_offset(offset):
    """Return the capsules of an arm whose joints, and flange, are all at the same offset from the joint before."""
    arm = chain("KR 16-2")
    placement, flange = arm.placement.copy(), arm.flange.copy()
    placement[:, :3, 3] = flange[:3, 3] = offset
    return list(arm_capsules(replace(arm, placement=placement, flange=flange)))


def test_each_link_follows_the_axis_of_its_joint_and_then_goes_straight_to_the_next_joint():
    """Offsets along and across the axis of every joint; the base has its post upright. Balls and tubes come first."""
    offset = np.array([0.3, 0.4, 0.5])
    capsules = capsules_with_offset(offset)
    for carrier, axis in enumerate([_AXES[0], *_AXES], -1):
        corners = [np.zeros(3), axis * offset, offset]
        bodies = [body for body in capsules if body.carrier == carrier][-2:]
        for body, begin, end in zip(bodies, corners[:-1], corners[1:], strict=True):
            half = 0.5 * body.size[1] * body.pose[:3, 2]
            np.testing.assert_allclose([body.pose[:3, 3] - half, body.pose[:3, 3] + half], [begin, end], atol=1e-9)


def test_balls_of_foot_and_shoulder_are_level_behind_joint_2_and_that_of_the_elbow_behind_joint_3_along_the_forearm():
    """Joint 2 is ahead of, beside and above joint 1: the height does not count."""
    offset = np.array([0.3, 0.4, 0.5])
    capsules = capsules_with_offset(offset)
    length = 7.0 * np.sqrt(0.5)
    for carrier, share, ahead in [(-1, 0.12, (0.6, 0.8, 0)), (0, 0.12, (0.6, 0.8, 0)), (2, 0.06, (1, 0, 0))]:
        ball = next(body for body in capsules if body.carrier == carrier)
        np.testing.assert_allclose(ball.pose[:3, 3], -share * length * np.array(ahead), atol=1e-3)


@pytest.mark.parametrize(("name", "carrier", "share"), [("KR 16-2", 2, 0.063), ("KR 150-2", 3, 0.055)])
def test_the_forearm_is_narrower_at_the_wrist_whichever_link_ends_there(name, carrier, share):
    offsets = 1e-3 * np.array(_ARMS[name])
    length = np.linalg.norm(offsets, axis=1).sum()
    span = np.linalg.norm(offsets[carrier + 1])
    direction = offsets[carrier + 1] / span
    reach = {
        round(body.size[0] / length, 9): body.pose[:3, 3] @ direction + 0.5 * body.size[1]
        for body in arm_capsules(chain(name)) if body.carrier == carrier and abs(body.pose[:3, 2] @ direction) > 0.999
    }  # fmt: skip
    assert reach == {share: pytest.approx(span - 0.058 * length), 0.045: pytest.approx(span)}
