"""Room that features take in the block: the wall left between them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from postproc.testpart import design, features
from postproc.testpart.features import Cutting, Feature, Kind

CUTTING = Cutting(0.01, 6000.0, 0.018, 1, 0.0, 0.0005)
WALL = 0.5 * CUTTING.diameter


@pytest.mark.parametrize("side", [0, 1, -1])
def test_the_outline_is_what_the_tool_sweeps_with_half_a_wall_on_each_side(side):
    kind = Kind(3e-3, side)
    across = [move.end[1] for move in features.passes(kind, CUTTING)]
    radius = 0.5 * CUTTING.diameter
    low, high = min(across) - radius - 0.5 * WALL, max(across) + radius + 0.5 * WALL
    middle, half = features.outline(kind, CUTTING)
    np.testing.assert_allclose([middle - half, middle + half], [low, high], atol=1e-12)


def test_features_that_do_not_touch_leave_the_wall_and_parallel_ones_are_no_further_apart_than_that():
    rng = np.random.default_rng(2)
    kinds = [Kind(3e-3, side) for side in (0, 1, -1)]
    chosen = tuple(Feature(kinds[k % 3], *rng.uniform(0.0, 0.12, 2), rng.uniform(0.0, 2.0 * np.pi)) for k in range(40))
    apart = design._apart_features(chosen, CUTTING)
    swept = [_swept(feature) for feature in chosen]
    for i, one in enumerate(swept):
        for j in np.flatnonzero(apart[i, :i]):
            assert _distance(one, swept[j]) > CUTTING.diameter + WALL
    assert 0.1 < apart.mean() < 0.9
    least = CUTTING.diameter + 2.0 * CUTTING.trims[-1].wall + WALL
    for pitch, expected in ((least - 1e-5, False), (least + 0.1 * CUTTING.diameter, True)):
        pair = tuple(Feature(kinds[0], 0.05 - pitch * k * np.sin(0.4), pitch * k * np.cos(0.4), 0.4) for k in (0, 1))
        assert design._apart_features(pair, CUTTING)[0, 1] == expected


def _swept(feature):
    """Points (n, 2) of the rectangle in which the axis of the tool moves, a millimetre from one to the next."""
    ends = np.array([move.end[:2] for move in features.passes(feature.kind, CUTTING)])
    spans = [np.linspace(each.min(), each.max(), 2 + int(1e3 * np.ptp(each))) for each in ends.T]
    u, v = (each.ravel() for each in np.meshgrid(*spans))
    c, s = np.cos(feature.angle), np.sin(feature.angle)
    return np.column_stack([feature.x + c * u - s * v, feature.y + s * u + c * v])


def _distance(one, other):
    return cdist(one, other).min()
