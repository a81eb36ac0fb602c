"""The quick arm of the oracle against the slow one, whose equilibrium is found from the potential alone."""

import numpy as np
import pytest

from postproc import robot as robots
from tests.oracle.arm import Arm, abc
from tests.oracle.elastic import inverse, loaded_tip


@pytest.mark.parametrize("name", ["kuka_kr270", "kuka_kr16_2"])
def test_the_fixed_point_is_the_stationary_point_of_the_potential(name):
    arm = Arm.load(robots.find(name))
    tool = abc(10, 0, 350, 0, 10, 0)
    rng = np.random.default_rng(5)
    for _ in range(3):
        q = np.radians([10, -70, 110, 20, 50, 5]) + rng.uniform(-0.3, 0.3, 6)
        wrench = rng.uniform(-300, 300, 6) * [1, 1, 1, 0.05, 0.05, 0.05]
        slow = arm.loaded_tcp(q, tool, wrench)
        np.testing.assert_allclose(loaded_tip(arm, q, tool, wrench), slow, rtol=0, atol=1e-12)
        assert np.linalg.norm((slow - arm.tcp(q, tool))[:3, 3]) > 1e-5
        np.testing.assert_allclose(inverse(arm, arm.nominal_tcp(q, tool), tool, q + 0.1), q, rtol=0, atol=1e-11)
