"""Error of a frame that was touched at unknown points: covariance over the choices, by frames built here."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from postproc.elastostatics.uncertainty import length_bound
from postproc.touched_frames import TouchedFrames

CORNERS = np.array([[0.0, 0, 0], [0.4, 0, 0], [0.4, 0.3, 0], [0, 0.3, 0]])
PLACE = Rotation.from_euler("ZYX", [30, 10, 20], degrees=True)
PART = PLACE.apply(CORNERS) + np.array([1.5, -0.2, 0.7])


def frame(touched):
    """The frame of three touched points: origin, one on X, one on Y."""
    x = (touched[1] - touched[0]) / np.linalg.norm(touched[1] - touched[0])
    z = np.cross(x, touched[2] - touched[0])
    z /= np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z]), touched[0]


def errors(points, shift, fit, touched):
    """Where a frame of touched points (3,) has all points, less where the fit has them (n, 3)."""
    (before, origin), (after, moved) = frame(points[touched]), frame((points + shift)[touched])
    by_touch = (points - origin) @ before @ after.T + moved
    return by_touch - (points @ fit[:3, :3].T + fit[:3, 3])


def bounds(frames, points):
    """95 % bound (n,) of the error of a frame at points."""
    slopes = frames.slopes(points)
    return length_bound(slopes @ frames.covariance @ np.swapaxes(slopes, 1, 2))


def test_bound_holds_for_most_choices_of_touched_corners():
    rng = np.random.default_rng(7)
    is_inside, ratios = [], []
    for _ in range(60):
        shift = rng.normal(0.0, 1e-4, (4, 3)) + rng.normal(0.0, 1e-3, 3)
        frames = TouchedFrames.of(PART, shift, np.ones(4), np.zeros(4, dtype=np.int64))
        bound = bounds(frames, PART)
        lengths = [
            np.linalg.norm(errors(PART, shift, frames.shift, list(touched)), axis=1)
            for touched in permutations(range(4), 3)
        ]
        is_inside.append([length <= bound for length in lengths])
        ratios.append(np.sqrt(np.mean(np.square(lengths))) / bound.mean())
    assert 0.92 < np.mean(is_inside) < 1.0
    assert np.mean(ratios) > 0.35  # a bound of three times the RMS error would be too wide


def test_displacement_of_a_rigid_body_has_no_error():
    turn = Rotation.from_rotvec([1e-3, -2e-3, 5e-4])
    shift = turn.apply(PART) + np.array([1e-3, 2e-3, -5e-4]) - PART
    frames = TouchedFrames.of(PART, shift, np.array([1.0, 2.0, 0.5, 3.0]), np.zeros(4, dtype=np.int64))
    np.testing.assert_allclose(frames.shift[:3, :3], turn.as_matrix(), atol=1e-5)
    assert bounds(frames, PART).max() < 1e-6  # the fit is linear: the square of 2 mrad in 0.4 m


def test_frames_that_were_touched_on_their_own_parts_differ_from_the_common_fit():
    """Two parts, each displaced as a rigid body by ±0.1 mm: the common fit is off by that on both."""
    points = np.concatenate([PART, PART + np.array([0.0, 0.0, 0.2])])
    base = np.repeat([0, 1], 4)
    shift = np.where(base[:, None] == 0, 1e-4, -1e-4) * [1.0, 0.0, 0.0]
    frames = TouchedFrames.of(points, shift, np.ones(8), base)
    left = shift - (points @ frames.shift[:3, :3].T + frames.shift[:3, 3] - points)
    assert (np.linalg.norm(left, axis=1) < bounds(frames, points)).all()


@pytest.mark.parametrize("count", [1, 2, 5])
def test_cuts_along_a_line_give_the_error_of_their_displacement(count):
    points = np.linspace(0.0, 0.4, count)[:, None] * PLACE.apply([1.0, 0.0, 0.0])
    bend = 1e-4 * np.cos(np.linspace(0.0, 2.0 * np.pi, count))[:, None] * PLACE.apply([0.0, 0.0, 1.0])
    frames = TouchedFrames.of(points, bend + 1e-3, np.ones(count), np.zeros(count, dtype=np.int64))
    bound = bounds(frames, points)
    left = bend + 1e-3 - (points @ frames.shift[:3, :3].T + frames.shift[:3, 3] - points)
    rms = np.sqrt(np.mean(np.sum(left**2, axis=1)))
    np.testing.assert_allclose(bound, 1.96 * rms, rtol=0.02, atol=1e-9)  # `length_bound` is good to 2 %
