"""Forces that follow on from motion to motion, against a loop: two bases, a tilted map, arcs, plunges."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import frames, toolpath
from postproc.machining.profiles import BASE, FEED, Stations, smooth_steps
from postproc.machining.tool_path import ToolPoses
from postproc.poses import Poses
from postproc.program import CIRC
from tests.programs import program
from tests.toolpath.setting import arc, begins, point

BASES = frames.pose_from_xyzabc([[1500.0, -200, 700, 20, -35, 50], [1300.0, 300, 650, -70, 15, -100]])
MAP = frames.pose_from_xyzabc([10.0, 20, 30, 40, 25, -30])
"""Frame of the map in the first base; moves are given in it below."""
RAMP = 4e-3


def made():
    """Motions in the map: a plunge, lines, arcs and a rapid move, all but the first two in the second base."""
    z = (0.0, 0.0, 1.0)
    first = arc((30, 10, -5), z, (30, 30, -5), 200.0, climb=4.0)
    second = arc((0, 0, 0), z, (0, -15, 0), 100.0)
    moves = [
        ("RAPID", 0, 0, 10), ("LIN", 0, 0, -5), ("LIN", 30, 10, -5), first, ("LIN", 2, 1, 3), ("RAPID", 0, 0, 0),
        second, ("LIN", 40, 10, -3), ("LIN", 40, 10, 9), ("LIN", 20, 10, 9),
    ]  # fmt: skip
    out = program(moves, bases=BASES, base=[0] * 2 + [1] * 8)
    m = out.motions
    to_base = np.array([MAP if base == 0 else np.linalg.inv(BASES[1]) @ BASES[0] @ MAP for base in m.base])
    centre = np.einsum("nij,nj->ni", to_base[:, :3, :3], m.centre) + to_base[:, :3, 3]
    normal = np.einsum("nij,nj->ni", to_base[:, :3, :3], m.normal)
    return replace(
        out, motions=replace(m, target=Poses.of(to_base @ m.target[:]), centre=centre, normal=normal)
    ), to_base[:, :3, :3]


def upright(program, path):
    """The tool along z of the map on all motions."""
    return ToolPoses(program, path, MAP, "+Z", np.zeros(len(program.motions), dtype=bool))


def stations(rng, program):
    """Rows, places and wrenches of cutting motions: one or several each."""
    rows = []
    for k in np.flatnonzero(~program.motions.rapid).tolist():
        count = 1 if k in (4, 6) else int(rng.integers(2, 6))
        rows += [(k, t) for t in ([0.5] if count == 1 else np.sort(rng.uniform(0.02, 0.98, count)))]
    motion, t = (np.array(column) for column in zip(*rows, strict=True))
    return motion, t, rng.normal(0.0, 100.0, (len(t), 6))


def feed_axes(program, to_base, k, t):
    """FEED axes (3, 3) as columns in `$BASE`; those of the map along its z."""
    begin, h = begins(program, np.eye(4)), 1e-6
    travel = to_base[k].T @ (point(program, begin, k, t + h) - point(program, begin, k, t - h))
    travel[2] = 0.0
    if np.linalg.norm(travel) < 1e-4 * h:
        return to_base[k]
    x = travel / np.linalg.norm(travel)
    return to_base[k] @ np.stack([x, np.cross([0, 0, 1.0], x), [0, 0, 1.0]], axis=1)


def turned(rotation, wrench):
    return np.concatenate([rotation @ wrench[:3], rotation @ wrench[3:]])


def expected_at(program, to_base, given, length, k, t, *, linear_in_feed):
    """The wrench (6,) in `$BASE` axes."""
    motion, places, wrench = given
    own = motion == k
    if not own.any():
        return np.zeros(6)

    def full(t):
        return np.array([np.interp(t, places[own], column) for column in wrench[own].T])

    before = np.zeros(6)
    if k > 0:
        before = expected_at(program, to_base, given, length, k - 1, 1.0, linear_in_feed=linear_in_feed)
        one, other = (program.bases[program.motions.base[j], :3, :3] for j in (k - 1, k))
        before = turned(other.T @ one, before)
    reach = min(1.0, RAMP / length[k])
    axes = feed_axes(program, to_base, k, t)
    if t >= reach:
        return turned(axes, full(t))
    if linear_in_feed:
        start = turned(feed_axes(program, to_base, k, 0.0).T, before)
        return turned(axes, start + t / reach * (full(reach) - start))
    end = turned(feed_axes(program, to_base, k, reach), full(reach))
    return before + t / reach * (end - before)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("base_axes", [False, True])
def test_forces_along_motions_follow_on_from_those_before(seed, base_axes):
    program, to_base = made()
    path = toolpath.segments(program, np.eye(4))
    given = stations(np.random.default_rng(seed), program)
    found = smooth_steps(
        upright(program, path),
        Stations(*given, 0.0 * given[2]),
        np.full(len(program.motions), RAMP),
        sigma=0.2,
        axial_sigma=0.0,
        base_axes=base_axes,
    )
    np.testing.assert_allclose(found.sigma, 0.2 * np.abs(found.wrench))
    assert np.unique(found.motion).tolist() == np.unique(given[0]).tolist()
    for k in np.unique(given[0]).tolist():
        rows, own = found.motion == k, given[0] == k
        t, reach = found.t[rows], min(1.0, RAMP / path.length[k])
        steady = own.sum() == 1
        inner = [place for place in given[1][own] if reach + 1e-9 < place] if not steady else []
        np.testing.assert_allclose(t, np.unique([0.0, reach, *inner, 1.0]))
        plunge = k in (1, 8)
        in_base = plunge or (base_axes and program.motions.kind[k] != CIRC)
        assert found.frame[rows].tolist() == [BASE if in_base else FEED] * rows.sum()
        for place, wrench in zip(t, found.wrench[rows], strict=True):
            expected = expected_at(program, to_base, given, path.length, k, place, linear_in_feed=not in_base)
            have = wrench if in_base else turned(feed_axes(program, to_base, k, place), wrench)
            np.testing.assert_allclose(have, expected, atol=2e-4)


def test_a_small_change_is_spread_over_the_motion():
    """No knot more than the force needs: one at each end where it goes on as it was."""
    program, _ = made()
    path = toolpath.segments(program, np.eye(4))
    motion = np.array([2, 3, 4])
    wrench = np.array([[0, 0, 400.0, 0, 0, 0], [0, 0, 403.0, 0, 0, 0], [0, 0, 300.0, 0, 0, 0]])
    given = Stations(motion, np.full(3, 0.5), wrench, 0.0 * wrench)
    found = smooth_steps(upright(program, path), given, np.full(10, 1e-4), sigma=0.1, axial_sigma=0.0, base_axes=False)
    assert [found.t[found.motion == k].tolist() for k in (2, 3, 4)] == [
        pytest.approx([0.0, 1e-4 / path.length[2], 1.0]), [0.0, 1.0], pytest.approx([0.0, 1e-4 / path.length[4], 1.0]),
    ]  # fmt: skip
    np.testing.assert_allclose(found.wrench[found.motion == 3][:, 2], [400.0, 403.0])
