"""Motions at feed that retract, against a loop over the motions."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from postproc.frames import pose_from_xyzabc
from postproc.program import CIRC, LIN
from postproc.toolpath import sampling
from postproc.toolpath.retracts import retract_motions
from postproc.toolpath.sampling import Pieces


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("varies", [False, True])
def test_a_retract_is_straight_up_and_holds_until_the_tool_comes_down(seed, varies):
    """By a micrometre: less is no rise, no descent and not aside."""
    rng = np.random.default_rng(seed)
    up = np.linalg.qr(rng.normal(size=(3, 3)))[0][0]
    ups = np.array([up, -up])[rng.integers(0, 2, 40)] if varies else np.tile(up, (40, 1))
    side = np.cross(up, [0.3, 0.5, -0.8])
    side /= np.linalg.norm(side)
    rise = rng.choice([0.0, 0.9e-6, 1.1e-6, 0.02, -0.9e-6, -1.1e-6, -0.02], 40)
    aside = rng.choice([0.0, 0.9e-6, 1.1e-6, 0.01], 40)
    ends = np.cumsum(rise[:, None] * ups + aside[:, None] * side, axis=0)
    expected, state = [], False
    for n in range(40):
        if n and rise[n] > 1e-6 and aside[n] <= 1e-6:
            state = True
        elif n and rise[n] < -1e-6:
            state = False
        expected.append(state)
    assert retract_motions(ends, ups if varies else up).tolist() == expected


def test_one_motion_or_none_is_no_retract():
    assert retract_motions(np.array([[0.0, 0.0, 0.5]]), np.array([0.0, 0.0, 1.0])).tolist() == [False]
    assert retract_motions(np.zeros((0, 3)), np.array([0.0, 0.0, 1.0])).tolist() == []


def test_each_piece_has_an_even_number_of_samples_that_rounding_does_not_raise():
    samples = np.array([6.0, 0.1 * 3 * 20, 6.1, 0.5, 12.0, 24.0])
    number = np.array([1, 1, 1, 1, 3, 5])
    none = np.zeros(6)
    pieces = Pieces(none.astype(int), none, none + 1.0, number, number, samples, none.astype(bool))
    assert samples[1] > 6.0
    assert pieces.samples_per_piece.tolist() == [6, 6, 8, 2, 4, 6]


@pytest.mark.parametrize("place", [0.25, 0.5, 0.75])
@pytest.mark.parametrize("size", [0.0, 2e-4, 5e-3])
def test_lines_are_divided_by_the_largest_error_of_the_orientation_at_their_quarters(monkeypatch, place, size):
    """The root of error times half a metre over the tolerance, and 60° of the rotary axes at most."""
    target = pose_from_xyzabc([[0, 0, 0, 0, 0, 180.0], [10, 0, 0, 0, 0, 180.0], [20, 0, 0, 40.0, 0, 180.0]])
    start = np.concatenate([target[:1], target[:-1]])
    travel = np.array([0.3, 0.0, np.radians(150.0)])

    def at(rows, t):
        turned = [
            sampling.interpolate(start[row][None], target[row][None], np.array([share]))[0, :3, :3]
            for row, share in zip(rows, t, strict=True)
        ]
        error = Rotation.from_rotvec([0.0, size if t[0] == place else 0.0, 0.0]).as_matrix()
        return np.array([error @ pose for pose in turned])

    turning = SimpleNamespace(travel=travel, at=at)
    motions = SimpleNamespace(kind=np.array([LIN, LIN, LIN]), target=target)
    made = SimpleNamespace(
        turning=turning, motions=type("Sized", (SimpleNamespace,), {"__len__": lambda _: 3})(**vars(motions))
    )
    path = SimpleNamespace(start=SimpleNamespace(at=lambda rows: start[rows]))
    tolerance = 2e-5
    lever = sampling._LEVER
    by_error = max(1, int(np.ceil(np.sqrt(size * lever / tolerance) - 1e-9)))
    assert sampling.swivel_pieces(made, path, tolerance).tolist() == [by_error, 1, max(by_error, 3)]
    made.motions.kind = np.array([LIN, LIN, CIRC])
    assert sampling.swivel_pieces(made, path, tolerance).tolist() == [by_error, 1, 1]
    made.turning = None
    assert sampling.swivel_pieces(made, path, tolerance).tolist() == [1, 1, 1]
