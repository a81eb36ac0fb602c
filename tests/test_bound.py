"""The bound u95 against 1000 random runs of the loaded equilibrium."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics
from tests.benchmarks.bound import against_chance


def test_95_percent_of_random_parameters_forces_and_discrepancies_stay_within_the_bound():
    found, bound = against_chance(1000)
    assert np.abs(bound / found - 1.0).max() < 0.1


@pytest.mark.parametrize("left_out", ["covariance", "spread", "discrepancy"])
def test_a_bound_without_one_of_its_sources_would_be_noticed(monkeypatch, left_out):
    whole = elastostatics.position_bound

    def without(model, q, tool, wrench, spread):
        covariance = model.covariance
        changed = {
            "covariance": {"covariance": type(covariance)(covariance.parameters, 0.0 * covariance.matrix)},
            "discrepancy": {"discrepancy": None},
            "spread": {},
        }[left_out]

        return whole(replace(model, **changed), q, tool, wrench, 0.0 * spread if left_out == "spread" else spread)

    monkeypatch.setattr(elastostatics, "position_bound", without)
    found, bound = against_chance(200)
    assert np.abs(bound / found - 1.0).max() > 0.15
