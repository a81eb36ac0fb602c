"""Distance to joint limits and to singular poses, against the URDF and the Jacobian of an independent arm."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from postproc import kinematics
from tests.kr270 import FOLDER, ROBOT, tool_at
from tests.oracle.arm import Arm

ORACLE = Arm.load(FOLDER)
OFF_AXIS_TOOL = tool_at(0.05, -0.02, 0.35)


def jacobian(q, tool):
    """(6, 6) position and rotation of the tool by the complex step."""
    linear = [ORACLE.gradient(lambda x, axis=axis: ORACLE.tcp(x, tool)[axis, 3], q) for axis in range(3)]
    angular = [ORACLE.moment_torque(q, unit) for unit in np.eye(3)]
    return np.array([*linear, *angular])


def smallest(q, tool):
    return np.linalg.svd(jacobian(q, tool), compute_uv=False)[-1]


@pytest.mark.parametrize("rows", [1, 2, 8192])
def test_margin_is_the_smallest_distance_of_each_joint_to_either_limit_of_the_urdf(rows, monkeypatch):
    monkeypatch.setattr("postproc.chunks.ROWS", rows)
    limits = {
        joint.get("name"): [float(joint.find("limit").get(side)) for side in ("lower", "upper")]
        for joint in ET.parse(FOLDER / "robot.urdf").getroot().findall("joint")
        if joint.get("type") == "revolute"
    }
    lower, upper = np.array([limits[f"A{n}"] for n in range(1, 7)]).T
    above, below = np.array([[0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [0.2, 0.1, 0.4, 0.3, 0.6, 0.5]])
    q = np.array([lower + above, upper - below, (lower + upper) / 2])
    np.testing.assert_allclose(kinematics.joint_margin(ROBOT, q), [0.1, 0.1, 0.3, 0.3, 0.5, 0.5], atol=1e-12)
    beyond = (lower + upper) / 2
    beyond[2] = upper[2] + 0.25
    assert kinematics.joint_margin(ROBOT, beyond[None])[2] == pytest.approx(-0.25)


def test_singular_value_is_the_smallest_along_the_path_whatever_the_tool_of_each_row():
    q = np.radians([[0, -70, 110, 0, 50, 0], [20, -60, 100, 30, -40, 10], [0, -70, 110, 0, 3, 0]])
    assert kinematics.smallest_singular_value(ROBOT, q, OFF_AXIS_TOOL) == pytest.approx(
        smallest(q[2], OFF_AXIS_TOOL), rel=1e-9
    )
    tools = np.stack([OFF_AXIS_TOOL, np.eye(4), OFF_AXIS_TOOL])
    expected = min(smallest(angles, tool) for angles, tool in zip(q[:2], tools[:2], strict=True))
    assert kinematics.smallest_singular_value(ROBOT, q[:2], tools[:2]) == pytest.approx(expected, rel=1e-9)
    assert np.isnan(kinematics.smallest_singular_value(ROBOT, q[:0], OFF_AXIS_TOOL))


@pytest.mark.parametrize("place", [0, 7, 12_345, 29_999])
def test_the_narrowest_place_of_a_long_path_is_found_between_the_rows_looked_at_first(place):
    """A5 runs smoothly through its smallest angle at one row of 30 000."""
    q = np.tile(np.radians([0.0, -70.0, 110.0, 0.0, 0.0, 0.0]), (30_000, 1))
    q[:, 4] = np.radians(5.0) + np.radians(1e-4) * np.abs(np.arange(30_000) - place)
    found = kinematics.smallest_singular_value(ROBOT, q, OFF_AXIS_TOOL)
    assert found == pytest.approx(smallest(q[place], OFF_AXIS_TOOL), rel=1e-9)


@pytest.mark.parametrize("place", range(1, 9))
def test_every_row_of_a_short_path_is_looked_at(place):
    """One row alone has A5 near zero; those next to it say nothing of it, and the first one has a smaller value."""
    q = np.tile(np.radians([0.0, -70.0, 110.0, 0.0, 50.0, 0.0]), (9, 1))
    q[0, 4], q[place, 4] = np.radians(20.0), np.radians(3.0)
    assert kinematics.smallest_singular_value(ROBOT, q, OFF_AXIS_TOOL) == pytest.approx(
        smallest(q[place], OFF_AXIS_TOOL), rel=1e-9
    )
