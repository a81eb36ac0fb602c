from __future__ import annotations

import numpy as np

from postproc.plan.sensitivity import Arm
from tests.plan.setting import ORACLE, POINTS, ROBOT, differences, in_flange


def test_poses_and_velocities_agree_with_an_arm_that_shares_no_code():
    arm = Arm.of(ROBOT)
    q = np.random.default_rng(0).uniform(-2, 2, (5, 6))
    posed = arm.pose(q)
    points = np.array(list(POINTS.values()))
    moved = posed.velocity(posed.point(points))
    for row, angles in enumerate(q):
        assert np.abs(posed.flange[row] - ORACLE.frames(angles)[-1]).max() < 1e-12
        for place, point in enumerate(points):
            slope = differences(lambda x, p=point: ORACLE.tcp(x, in_flange(p))[:3, 3], angles)
            assert np.abs(moved[row, place].T - slope).max() < 1e-8
