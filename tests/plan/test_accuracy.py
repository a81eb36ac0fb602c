from __future__ import annotations

import numpy as np
import pytest

from tests.plan import monte_carlo, setting


def test_expected_accuracy_is_what_identifications_from_noisy_readings_reach(tmp_path):
    """20 runs know the RMS to about 10 %; tests/benchmarks/plan_accuracy.py does 500."""
    result = setting.quick(tmp_path, configurations=15, levels=5, starts=1, rounds=2)
    found, failed = monte_carlo.errors(tmp_path, result, runs=20)
    assert failed == 0
    assert np.sqrt(np.mean(found**2)) == pytest.approx(result.accuracy.rms, rel=0.25)
    low, high = result.accuracy.interval
    assert np.mean((found > low) & (found < high)) >= 0.8


def test_accuracy_is_never_worse_than_the_two_steps_of_the_criterion(tmp_path):
    for grouped in (False, True):
        result = setting.quick(tmp_path, grouped=grouped, starts=1, rounds=1)
        assert result.accuracy.rms <= np.sqrt(result.plan.value) * (1 + 1e-9)
        low, high = result.accuracy.interval
        assert low < result.accuracy.rms < high
        mean_square = result.tests.weight @ result.accuracy.poses**2
        assert np.sqrt(mean_square) == pytest.approx(result.accuracy.rms)
