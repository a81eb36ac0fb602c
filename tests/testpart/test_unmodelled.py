"""The unmodelled share γ that a test part shows, against an integral over its prior."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import lognorm

from postproc.testpart.cut import Surfaces
from postproc.testpart.linear import LinearPrediction, unmodelled_share
from postproc.testpart.probing import ProbedSurfaces
from postproc.testpart.readings import Readings

SIGMA, MOVED = 5e-6, 3e-4
MEDIAN, LOG_SIGMA = 0.005, 1.5
"""Of γ before the readings: median, and standard deviation of its logarithm."""


@pytest.mark.parametrize(("n", "spread"), [(6, 4e-6), (6, 8e-6), (200, 5e-6), (200, 8e-6)])
def test_the_share_is_the_root_of_its_mean_square_after_the_readings(n, spread):
    """Readings of a gauge: independent, of variance σ² + (γ·moved)², and the model predicts them but for that."""
    readings, local = _readings(n)
    target = np.where(np.arange(n) % 2, spread, -spread)

    def density(gamma):
        variance = SIGMA**2 + (gamma * MOVED) ** 2
        fit = -0.5 * n * (np.log(variance / SIGMA**2) + spread**2 * (1.0 / variance - 1.0 / SIGMA**2))
        return lognorm.pdf(gamma, LOG_SIGMA, scale=MEDIAN) * np.exp(fit)

    limits = {"points": [1e-3, 5e-3, 2e-2, 5e-2], "limit": 500}
    square, whole = (quad(lambda g, k=k: g**k * density(g), 1e-6, 1.0, **limits)[0] for k in (2, 0))
    found = unmodelled_share(readings, local, np.eye(2), target)
    assert found == pytest.approx(np.sqrt(square / whole), rel=0.02)


def _readings(n):
    none, number = np.zeros((n, 3)), np.arange(n)
    names = tuple(f"W{k:03d}.gauge" for k in range(n))
    probed = ProbedSurfaces(
        names, number, np.zeros(n), none, none, np.zeros(n), np.ones(n), ("",) * n, np.full(n, -1), number, "probed.csv"
    )
    where = Surfaces(number, np.zeros(n), np.zeros((n, 2, 6)), np.zeros(n, dtype=bool), np.zeros((n, 6)), none)
    return Readings.of(probed, where, SIGMA), LinearPrediction(
        np.zeros(n), np.zeros((n, 2)), np.zeros(n), np.full(n, MOVED)
    )
