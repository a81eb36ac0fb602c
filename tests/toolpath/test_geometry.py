"""Poses on a path that has every term, against scipy and against motions followed one by one."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc import toolpath
from postproc.poses import Poses
from postproc.program import SPL
from tests.programs import program
from tests.toolpath.setting import START, begins, mixed, point, swivel, swivelled, turned, with_carriage

PLACES = (0.001, 0.2, 0.5, 0.77, 1.0)


def every_place(made):
    """Each motion at each place, and the path."""
    motion, t = np.repeat(np.arange(len(made.motions)), len(PLACES)), np.tile(PLACES, len(made.motions))
    return toolpath.segments(made, START), motion, t


@pytest.mark.parametrize("made", [mixed(), with_carriage(mixed())], ids=["still", "carried"])
def test_motions_start_where_the_robot_stands(made):
    path = toolpath.segments(made, START)
    np.testing.assert_allclose(path.start.at(np.arange(len(made.motions))), begins(made), atol=1e-14)
    np.testing.assert_allclose(path.begin(np.arange(len(made.motions))), begins(made)[:, :3, 3], atol=1e-14)


def test_positions_and_orientations_on_the_way():
    made = mixed()
    path, motion, t = every_place(made)
    begin = begins(made)
    sample = toolpath.at(made, path, motion, t)
    place = np.where(made.motions.rapid[motion] & (motion == 0), 1.0, t)  # of PTP the end alone is known
    spots = np.array([point(made, begin, k, s) for k, s in zip(motion, place, strict=True)])
    np.testing.assert_allclose(sample.pose[:, :3, 3], spots, atol=1e-14)
    np.testing.assert_allclose(toolpath.positions(made, path, motion, t), spots, atol=1e-14)
    turns = [turned(begin[k], made.motions.target[k], s) for k, s in zip(motion, place, strict=True)]
    np.testing.assert_allclose(sample.pose[:, :3, :3], turns, atol=1e-12)
    # ends are those of the program to the last bit: what needs no correction is written as it was
    np.testing.assert_array_equal(sample.pose[t == 1.0], made.motions.target)
    np.testing.assert_array_equal(toolpath.positions(made, path, motion, t)[t == 1.0], made.motions.target[:, :3, 3])
    np.testing.assert_allclose(sample.pose[:, 3], np.tile([0.0, 0, 0, 1], (len(t), 1)))
    np.testing.assert_allclose(sample.distance, path.length[motion] * t)
    np.testing.assert_array_equal(sample.is_end, t == 1.0)
    assert len(sample) == len(t)
    some = sample.take(np.array([3, 7]))
    np.testing.assert_array_equal(some.pose, sample.pose[[3, 7]])
    np.testing.assert_array_equal(
        [some.motion, some.t, some.distance], [motion[[3, 7]], t[[3, 7]], sample.distance[[3, 7]]]
    )


def test_lengths_and_turns():
    made = mixed()
    path, begin = toolpath.segments(made, START), begins(made)
    target, m = made.motions.target, made.motions
    for k in range(len(m)):
        angle = (Rotation.from_matrix(begin[k, :3, :3]).inv() * Rotation.from_matrix(target[k, :3, :3])).magnitude()
        assert path.turn[k] == pytest.approx(angle, abs=1e-12)
        length = np.linalg.norm(target[k, :3, 3] - begin[k, :3, 3])
        if m.kind[k] == 1:
            foot = m.centre[k] + ((begin[k, :3, 3] - m.centre[k]) @ m.normal[k]) * m.normal[k]
            rise = (target[k, :3, 3] - begin[k, :3, 3]) @ m.normal[k]
            length = np.hypot(m.sweep[k] * np.linalg.norm(begin[k, :3, 3] - foot), rise)
        assert path.length[k] == pytest.approx(0.0 if k == 0 else length, abs=1e-14)
    np.testing.assert_array_equal(path.travel, path.length)
    carried = with_carriage(made)
    way = toolpath.segments(carried, START).travel
    e1 = np.abs(carried.carriage.end - carried.carriage.begin)
    assert (e1 > 2 * path.length).any()
    np.testing.assert_allclose(way, np.maximum(toolpath.segments(carried, START).length, e1), atol=1e-14)


def test_velocity_on_arcs_is_the_derivative_of_the_position():
    made = mixed()
    path = toolpath.segments(made, START)
    motion, t = np.repeat(path.arcs.motion, 4), np.tile([1e-5, 0.3, 0.6, 1.0], len(path.arcs.motion))
    h = 1e-6
    slope = (path.arcs.position(motion, t + h) - path.arcs.position(motion, t - h)) / (2 * h)
    np.testing.assert_allclose(path.arcs.velocity(motion, t), slope, atol=1e-9)
    np.testing.assert_allclose(
        toolpath.tangent(made, path, motion, t), slope / np.linalg.norm(slope, axis=1)[:, None], atol=1e-7
    )


def test_the_tangent_of_lines_and_of_chords_of_splines():
    made = mixed()
    made = replace(made, motions=replace(made.motions, kind=np.array([2, 1, 1, SPL, 0, 0, 1])))
    path, begin = toolpath.segments(made, START), begins(made)
    chord = made.motions.target[:, :3, 3] - begin[:, :3, 3]
    chord /= np.linalg.norm(chord, axis=1)[:, None]
    found = toolpath.tangent(made, path, np.array([3, 4, 5, 0]), np.full(4, 0.4))
    np.testing.assert_allclose(found, [*chord[3:6], (0, 0, 0)], atol=1e-12)
    assert path.length[3] == pytest.approx(np.linalg.norm(made.motions.target[3, :3, 3] - begin[3, :3, 3]))
    sample = toolpath.at(made, path, np.array([3]), np.array([0.25]))  # the chord stands for the piece
    np.testing.assert_allclose(sample.pose[0, :3, 3], point(made, begin, 3, 0.25), atol=1e-14)
    np.testing.assert_allclose(sample.pose[0, :3, :3], turned(begin[3], made.motions.target[3], 0.25), atol=1e-12)


def test_a_line_that_goes_nowhere_has_no_tangent():
    made = program([("PTP", 5, 5, 5), ("LIN", 5, 5, 5)])
    path = toolpath.segments(made, START)
    assert not toolpath.tangent(made, path, np.array([1]), np.array([0.5])).any()


@pytest.mark.parametrize("degrees", [4e-6, 3e-5, 2e-4, 3e-3, 0.1])
def test_small_turns_are_in_proportion_too(degrees):
    """Below a millionth the matrices are mixed, above they are turned: to 1e-12 it is the same."""
    made = mixed()
    target = made.motions.target[:]
    small = Rotation.from_rotvec(np.radians(degrees) * np.array([0.6, -0.48, 0.64]))
    target[3, :3, :3] = small.as_matrix() @ begins(made)[3, :3, :3]
    made = replace(made, motions=replace(made.motions, target=Poses.of(target)))
    path, begin = toolpath.segments(made, START), begins(made)
    for t in (0.1, 0.5, 0.9):
        found = toolpath.at(made, path, np.array([3]), np.array([t])).pose[0, :3, :3]
        back = Rotation.from_matrix(found @ begin[3, :3, :3].T).as_rotvec()
        np.testing.assert_allclose(back, t * small.as_rotvec(), atol=2e-12)


def test_on_a_circle_that_turns_the_tool_the_rider_on_the_path_sees_an_even_rotation():
    made = mixed()
    made = replace(made, turns_with_path=np.array([False, True, False, False, False, False, True]))
    path, motion, t = every_place(made)
    begin, m = begins(made), made.motions
    sample = toolpath.at(made, path, motion, t)
    for k, s, pose in zip(motion, t, sample.pose, strict=True):
        expected = turned(begin[k], m.target[k], 1.0 if k == 0 else s)
        if made.turns_with_path[k]:
            here, there = (Rotation.from_rotvec(m.normal[k] * m.sweep[k] * share).as_matrix() for share in (s, 1.0))
            seen = there.T @ m.target[k, :3, :3]  # the end as the rider sees it
            expected = here @ turned(begin[k], np.block([[seen, np.zeros((3, 1))], [np.zeros(3), 1.0]]), s)
            relative = (Rotation.from_matrix(begin[k, :3, :3]).inv() * Rotation.from_matrix(seen)).magnitude()
            assert path.turn[k] == pytest.approx(m.sweep[k] + relative, abs=1e-12)
        np.testing.assert_allclose(pose[:3, :3], expected, atol=1e-12)
        np.testing.assert_allclose(pose[:3, 3], point(made, begin, k, 1.0 if k == 0 else s), atol=1e-14)


def test_rotary_axes_turn_the_tool_evenly_where_they_are_active():
    made = mixed()
    angles = np.array([(0, 0), (10, 20), (40, -15), (-20, 50), (30, 30), (5, -40), (0, 10), (25, 35)], dtype=float)
    axes = swivel(made, "CB", angles, inactive=(0, 1, 5))
    target = made.motions.target[:]
    for k in range(len(target)):
        target[k, :3, :3] = axes.frames[axes.frame[k]] @ swivelled(made, "CB", angles[k + 1])
    made = replace(made, motions=replace(made.motions, target=Poses.of(target)), swivel=axes)
    path, motion, t = every_place(made)
    begin = begins(made)
    for k, s, pose in zip(motion, t, toolpath.at(made, path, motion, t).pose, strict=True):
        if s == 1.0 or k == 0:
            expected = target[k, :3, :3]
        elif axes.active[k]:
            expected = axes.frames[axes.frame[k]] @ swivelled(made, "CB", angles[k] + s * (angles[k + 1] - angles[k]))
        else:
            expected = turned(begin[k], target[k], s)
        np.testing.assert_allclose(pose[:3, :3], expected, atol=1e-12)
    for k in range(1, len(target)):
        ends = (Rotation.from_matrix(begin[k, :3, :3]).inv() * Rotation.from_matrix(target[k, :3, :3])).magnitude()
        places = np.append(1e-9, np.linspace(0.0025, 1.0, 400))
        fine = Rotation.from_matrix(toolpath.at(made, path, np.full(401, k), places).pose[:, :3, :3])
        way = (fine[:-1].inv() * fine[1:]).magnitude().sum()
        assert path.turn[k] == pytest.approx(max(ends, axes.travel[k]))
        assert path.turn[k] >= max(way, ends) - 1e-7


def test_the_arc_through_three_points_is_the_one_they_were_taken_from():
    rng = np.random.default_rng(5)
    for _ in range(30):
        turn = Rotation.random(random_state=rng)
        radius, sweep = 10 ** rng.uniform(-4.0, 1.0), rng.uniform(0.3, 6.0)
        centre = radius * rng.normal(size=3)
        angles = np.array([0.0, rng.uniform(0.2, 0.8) * sweep, sweep])
        spots = centre + radius * turn.apply(np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1))
        found = toolpath.circle_through(*spots[:, None])
        expected = centre, spots[0] - centre, radius * turn.apply([0.0, 1.0, 0.0]), sweep
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one[0], other, atol=1e-10 * max(radius, np.max(other)))


def test_three_points_on_a_line_give_a_circle_without_a_radius():
    a = np.array([[0.1, 0.2, 0.3], [1.0, 1.0, 1.0]])
    b, c = a + np.array([0.05, 0.05, 0.0]), a + np.array([0.1, 0.1, 0.0])
    centre, radial, across, angle = toolpath.circle_through(a, b, c)
    np.testing.assert_allclose(centre, a, atol=1e-14)
    np.testing.assert_allclose([radial, across], 0.0, atol=1e-14)
    assert np.isfinite(angle).all()


@pytest.mark.parametrize("length", [1e-3, 1.0, 100.0])
def test_a_flat_arc_of_any_size_is_an_arc(length):
    """The sagitta is a billionth of the chord: beyond rounding, and no line."""
    a, b, c = (np.array([[x * length, y * length, 0.0]]) for x, y in ((0.0, 0.0), (0.5, 1e-9), (1.0, 0.0)))
    centre, _, _, angle = toolpath.circle_through(a, b, c)
    assert angle[0] == pytest.approx(8e-9, rel=1e-6)
    assert centre[0] == pytest.approx([0.5 * length, -length / 8e-9, 0.0], rel=1e-6)
