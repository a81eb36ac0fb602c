"""The bound u95 against 500 random runs of the loaded equilibrium."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics, robot
from tests.benchmarks.bound import against_chance
from tests.kr270 import ROBOT, SIDE_TOOL


def test_95_percent_of_random_parameters_forces_and_discrepancies_stay_within_the_bound():
    found, bound = against_chance(500)
    assert np.abs(bound / found - 1.0).max() < 0.1


@pytest.mark.parametrize("left_out", ["covariance", "spread", "discrepancy"])
def test_a_bound_without_one_of_its_sources_would_be_noticed(monkeypatch, left_out):
    whole = elastostatics.position_bound

    def without(model, q, tool, wrench, *, force_spread):
        covariance = model.covariance
        changed = {
            "covariance": {"covariance": type(covariance)(covariance.parameters, 0.0 * covariance.matrix)},
            "discrepancy": {"discrepancy": None},
            "spread": {},
        }[left_out]

        spread = 0.0 * force_spread if left_out == "spread" else force_spread
        return whole(replace(model, **changed), q, tool, wrench, force_spread=spread)

    monkeypatch.setattr(elastostatics, "position_bound", without)
    found, bound = against_chance(200)
    assert np.abs(bound / found - 1.0).max() > 0.15


def test_a_part_of_a_gear_that_is_zero_is_bounded_at_the_torque_at_rest():
    """Parts that the readings do not narrow are in [covariance] alone, with a value of zero."""
    part = robot.Knee("A3", 800.0)
    model = replace(
        ROBOT,
        carries_weight=True,
        covariance=robot.Covariance((robot.JointCompliance("A3"), part), np.diag([0.0, 1e-2])),
    )
    q = np.radians([[0.0, -70.0, 60.0, 10.0, 40.0, 20.0], [20.0, -40.0, 100.0, 0.0, 30.0, 0.0]])
    wrench = np.tile([100.0, -200.0, 400.0, 0.0, 0.0, 0.0], (2, 1))
    step = 1e-9
    here, there = (
        elastostatics.deflect(model.with_values({part: value}), q, SIDE_TOOL, wrench).twist[:, :3]
        for value in (0.0, step)
    )
    found = elastostatics.sensitivity(model, q, SIDE_TOOL, wrench)[:, :, 1]
    # k3 in files contains the part: more of the part at the same k3 is less of the rest
    rest = robot.JointCompliance("A3")
    less = elastostatics.deflect(model.with_values({part: 0.0, rest: model.value(rest) + step}), q, SIDE_TOOL, wrench)
    by_rest = (less.twist[:, :3] - here) / step
    np.testing.assert_allclose(found, ((there - here) / step - by_rest) * 1e-6, rtol=2e-2, atol=1e-7)
