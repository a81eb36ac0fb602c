"""From `$BASE` into the root and back: one base and one tool, or several; a robot that stands still, or is carried."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import frames, toolpath
from tests.toolpath.setting import BASES, TOOLS, mixed, single, with_carriage

MOTION, T = np.array([0, 2, 3, 4, 5, 6]), np.array([1.0, 0.3, 0.8, 0.25, 0.5, 1.0])
POSE = frames.pose_from_xyzabc(np.random.default_rng(3).uniform(-90, 90, (6, 6)))
COLUMNS = np.random.default_rng(4).normal(size=(6, 2, 3, 2))


MADE = {
    "several": mixed(),
    "one": single(mixed()),
    "carried": with_carriage(mixed()),
    "one, carried": with_carriage(single(mixed())),
}


@pytest.fixture(params=MADE.values(), ids=MADE)
def made(request):
    return request.param


def frames_of(made, t):
    """Bases (6, 4, 4) as the robot sees them where it stands, and tools (6, 4, 4)."""
    base, tool = made.bases[made.motions.base[MOTION]].copy(), made.tools[made.motions.tool[MOTION]]
    if made.carriage is not None and t is not None:
        begin, end = made.carriage.begin[MOTION], made.carriage.end[MOTION]
        base[:, :3, 3] -= (begin + t * (end - begin))[:, None] * made.carriage.direction
    return base, tool


@pytest.mark.parametrize("t", [T, None, 1.0], ids=["on the way", "at 0", "at ends"])
def test_poses_and_points(made, t):
    base, tool = frames_of(made, t)
    root = base @ POSE
    np.testing.assert_allclose(toolpath.pose_in_root(made, MOTION, POSE, t), root, atol=1e-14)
    np.testing.assert_allclose(toolpath.pose_in_base(made, MOTION, root, t), POSE, atol=1e-14)
    np.testing.assert_allclose(toolpath.points_in_base(made, MOTION, root[:, :3, 3], t), POSE[:, :3, 3], atol=1e-14)
    flange = root @ np.linalg.inv(tool)
    np.testing.assert_allclose(toolpath.flange_from_tcp(made, MOTION, POSE, t), flange, atol=1e-14)
    point = np.array([0.1, -0.2, 0.3])
    spot = (flange @ np.append(point, 1.0))[:, :3]
    np.testing.assert_allclose(toolpath.flange_points(made, MOTION, POSE, point, t), spot, atol=1e-14)


def test_without_a_place_motions_are_at_their_ends(made):
    base, tool = frames_of(made, 1.0)
    root = base @ POSE
    np.testing.assert_allclose(toolpath.pose_in_root(made, MOTION, POSE), root, atol=1e-14)
    np.testing.assert_allclose(toolpath.pose_in_base(made, MOTION, root), POSE, atol=1e-14)
    np.testing.assert_allclose(toolpath.points_in_base(made, MOTION, root[:, :3, 3]), POSE[:, :3, 3], atol=1e-14)
    np.testing.assert_allclose(toolpath.flange_from_tcp(made, MOTION, POSE), root @ np.linalg.inv(tool), atol=1e-14)
    spot = (root @ np.linalg.inv(tool))[:, :3, 3]
    np.testing.assert_allclose(toolpath.flange_points(made, MOTION, POSE, np.zeros(3)), spot, atol=1e-14)


def test_several_bases_with_one_tool_and_one_base_with_several_tools():
    m = mixed().motions
    for changes in ({"tools": TOOLS[:1]}, {"bases": BASES[:1]}):
        motions = replace(m, **{"tool" if "tools" in changes else "base": np.zeros_like(m.base)})
        made = replace(mixed(), motions=motions, **changes)
        base, tool = frames_of(made, None)
        flange = base @ POSE @ np.linalg.inv(tool)
        np.testing.assert_allclose(toolpath.flange_from_tcp(made, MOTION, POSE), flange, atol=1e-14)
        point = np.array([0.1, -0.2, 0.3])
        spot = (flange @ np.append(point, 1.0))[:, :3]
        np.testing.assert_allclose(toolpath.flange_points(made, MOTION, POSE, point), spot, atol=1e-14)


def test_forces_and_moments_turn_and_nothing_else(made):
    rotation = made.bases[made.motions.base[MOTION], :3, :3]
    expected = np.stack([[r @ half for half in pair] for r, pair in zip(rotation, COLUMNS, strict=True)])
    np.testing.assert_allclose(toolpath.columns_in_root(made, MOTION, COLUMNS), expected, atol=1e-14)
    wrench = COLUMNS[..., 0].reshape(-1, 6)
    np.testing.assert_allclose(
        toolpath.wrench_in_root(made, MOTION, wrench), expected[..., 0].reshape(-1, 6), atol=1e-14
    )
