"""Geometry of the nominal path: lengths, arcs, helices, where samples are put."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc import frames, toolpath
from tests.programs import DOWN, program

ARC = [("PTP", 50, 0, 0), ("CIRC", 0, 50, 10, 0, 0, 0, 90.0, (0, 0, 1)), ("LIN", 0, 250, 10)]


def test_a_helix_rises_linearly_and_its_length_is_that_of_the_helix():
    made = program(ARC)
    path = toolpath.segments(made, np.eye(4))
    np.testing.assert_allclose(path.length, [0, np.hypot(0.05 * np.pi / 2, 0.01), 0.2])
    sample = toolpath.at(made, path, np.array([1, 1]), np.array([0.5, 1.0]))
    half = 50 / np.sqrt(2)
    np.testing.assert_allclose(sample.pose[:, :3, 3] * 1000, [[half, half, 5], [0, 50, 10]], atol=1e-9)


def test_tangent_is_the_derivative_of_the_position():
    made = program(ARC)
    path = toolpath.segments(made, np.eye(4))
    motion, t, h = np.array([1, 1, 2]), np.array([0.3, 0.9, 0.5]), 1e-6
    ahead, behind = (toolpath.at(made, path, motion, t + s * h).pose[:, :3, 3] for s in (1, -1))
    slope = (ahead - behind) / np.linalg.norm(ahead - behind, axis=1, keepdims=True)
    np.testing.assert_allclose(toolpath.tangent(made, path, motion, t), slope, atol=1e-8)


def _still(made, **changes):
    """A displacement that changes nowhere; or by `ramp` [m] on each motion, until `ramp_end`."""
    count = len(made.motions)
    ramp_end = np.asarray(changes.pop("ramp_end", np.ones(count)))
    change, turning, size = (np.full(count, changes.pop(name, 0.0)) for name in ("ramp", "turning", "size"))
    assert not changes
    none = np.zeros(count, dtype=bool)
    return toolpath.DisplacementEstimate(np.arange(count), ramp_end, change, ramp_end < 1, turning, size, swings=none)


def _places(made, estimate):
    path = toolpath.segments(made, np.eye(4))
    return toolpath.places(made, path, 1e-5, estimate, toolpath.pieces(path, 1e-5, estimate))


def test_every_end_is_sampled_and_nothing_is_further_apart_than_20_mm():
    made = program([*ARC, ("CIRC", 0, 0, 10, 0, 125, 10, 180.0, (0, 0, 1))])
    motion, t = _places(made, _still(made, ramp_end=[1.0, 1.0, 0.005, 1.0]))
    assert (np.lexsort((t, motion)) == np.arange(len(t))).all()
    np.testing.assert_array_equal(motion[t == 1.0], [0, 1, 2, 3])
    assert 0.005 in t[motion == 2]
    for row, length in ((1, 0.025 * np.pi), (2, 0.2), (3, 0.125 * np.pi)):
        assert np.diff(np.concatenate([[0], t[motion == row]])).max() * length <= 0.020 + 1e-12


def test_an_arc_is_one_piece_of_two_samples_unless_it_is_large_or_the_displacement_turns_or_grows():
    made = program([("PTP", 5, 0, 0), ("CIRC", 0, 5, 0, 0, 0, 0, 90.0, (0, 0, 1))])
    np.testing.assert_array_equal(_places(made, _still(made, size=1e-4))[1], [1.0, 0.5, 1.0])
    path = toolpath.segments(made, np.eye(4))
    for change in ({"turning": 1e-4}, {"ramp": 1e-4}, {"size": 0.1}):
        found = toolpath.pieces(path, 1e-5, _still(made, **change))
        assert found.uncertain.all()
        np.testing.assert_array_equal(found.number, [2])
    kink = _still(made, ramp=1e-4, ramp_end=[1.0, 0.25])
    found = toolpath.pieces(path, 1e-5, kink)
    np.testing.assert_array_equal(found.begin, [0.0, 0.25])
    motion, t = toolpath.places(made, path, 1e-5, kink, found.with_enough_pieces(np.array([3, 2])))
    np.testing.assert_allclose(t[motion == 1], [*(np.arange(1, 7) / 24), *(0.25 + 0.1875 * np.arange(1, 5))])
    np.testing.assert_array_equal(
        found.with_enough_pieces(np.array([4, 1]))
        .refined_at(np.array([1, 1]), np.array([0.1, 0.2]), np.array([2, 3]))
        .number,
        [1, 2, 1, 3, 1],
    )


def test_dense_programs_get_no_extra_samples():
    made = program([("PTP", 0, 0, 0), *[("LIN", 0.5 * i, 0, 0) for i in range(1, 200)]])
    motion, _ = _places(made, _still(made))
    assert len(motion) == 200


def test_a_change_of_base_keeps_the_start_in_space():
    bases = frames.pose_from_xyzabc([[1000.0, 0, 0, 0, 0, 0], [1100.0, 0, 0, 90, 0, 0]])
    made = program([("PTP", 0, 0, 0), ("LIN", 0, 0, 0)], bases=bases, base=[0, 1])
    path = toolpath.segments(made, np.eye(4))
    start = path.start.at(np.array([1]))[0]
    np.testing.assert_allclose(start[:3, 3], [0, 0.1, 0], atol=1e-15)
    back = bases[1] @ start
    np.testing.assert_allclose(back[:3, :3], DOWN, atol=1e-15)


def test_a_point_of_the_flange_is_the_same_seen_through_its_pose():
    made = program(ARC)
    path = toolpath.segments(made, np.eye(4))
    sample = toolpath.at(made, path, np.array([0, 1, 2]), np.array([1.0, 0.3, 0.7]))
    frame = frames.pose_from_xyzabc([100.0, -200.0, 300.0, 20.0, 40.0, -70.0])
    moved = replace(made, bases=np.stack([frame, made.bases[0]]), tools=np.stack([made.tools[0], frame]))
    point = np.array([0.1, -0.2, 0.3])
    for other in (made, replace(made, bases=frame[None], tools=frame[None]), moved):
        expected = toolpath.flange_from_tcp(other, sample.motion, sample.pose[:]) @ np.append(point, 1.0)
        found = toolpath.flange_points(other, sample.motion, sample.pose[:], point)
        np.testing.assert_allclose(found, expected[:, :3], atol=1e-12)
