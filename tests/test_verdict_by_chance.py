"""Both expected errors and the chance of a verdict, against drawn arms that share no code with the package."""

from __future__ import annotations

import numpy as np
import pytest

from tests.benchmarks.verdict import trial

_RUNS = 60


@pytest.mark.parametrize("one_factor", [True, False], ids=["one factor", "components"])
def test_drawn_arms_and_forces_are_inside_and_better_as_often_as_stated(one_factor):
    found = trial("kuka_kr270", 40.0, _RUNS, 3, one_factor=one_factor)
    # 95 % within four standard deviations of a share of 60 runs: the targets of a run are not independent
    least = 0.95 - 4.0 * np.sqrt(0.95 * 0.05 / _RUNS)
    assert min(found.inside) > least
    assert found.stated[1] < found.stated[0]
    # not wide without need: the worst of two correlations of forces counts, so up to half more than what is found
    assert all(stated < 1.6 * reached for stated, reached in zip(found.stated, found.found, strict=True))
    # the chance is that of the less favourable correlation: drawn ones may be better, but not worse
    sigma = np.sqrt(found.chance * (1.0 - found.chance) / _RUNS)
    assert found.better > found.chance - 3.0 * sigma
