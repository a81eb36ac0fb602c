"""The arm on the screen of the cell is where the robot is."""

from __future__ import annotations

import numpy as np
import pytest

from postproc import robot
from postproc.jobs.cell_picture import cell_picture
from tests.oracle.arm import Arm, abc

CELL_OF_ROBOT = """robot = "{name}"
[base]
X = 1500
Y = -200
Z = 700
A = 90
[tool]
X = 40
Z = 350
B = 30
"""
START = "[start]\njoints = [20, -80, 95, 15, 60, -30]\n"


@pytest.mark.parametrize("name", sorted(robot.shipped_models()))
@pytest.mark.parametrize(("start", "angles"), [(START, (20, -80, 95, 15, 60, -30)), ("", (0, -90, 100, 0, 80, 0))])
def test_tip_and_base_are_where_the_controller_has_them(tmp_path, name, start, angles):
    path = tmp_path / "cell.toml"
    path.write_text(CELL_OF_ROBOT.format(name=name) + start)
    picture = cell_picture(path)
    arm = Arm.load(robot.shipped_models()[name])
    tip = arm.nominal_tcp(np.radians(angles), abc(40, 0, 350, 0, 30, 0))[:3, 3] * 1000
    assert picture.tip == pytest.approx(tip, abs=1e-6), "mm; both are exact but for rounding"
    assert picture.base == pytest.approx([1500, -200, 700])
    assert picture.base_axes == pytest.approx(np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), abs=1e-12)
    assert picture.arm[0] == pytest.approx([0, 0, 0])
    assert np.linalg.norm(picture.tip - picture.arm[-1]) == pytest.approx(np.hypot(40, 350))
    assert picture.is_start is bool(start)
