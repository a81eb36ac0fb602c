"""`init --robodk`: a cell from a station, asked by the package robodk itself of a stand-in for RoboDK."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from postproc import cell as cells
from postproc import robot
from tests.commands import invoke
from tests.hosts.robodk_server import Arm, station
from tests.oracle.arm import Arm as Oracle

with warnings.catch_warnings():
    warnings.simplefilter("ignore", PendingDeprecationWarning)  # robodk warns about itself
    from robodk import robolink, robomath

JOINTS = [5.0, -70.0, 110.0, 10.0, 50.0, -20.0]
BASE = [1500.0, -200.0, 700.0, 10.0, -20.0, 30.0]
TOOL_POSE = [12.0, 0.5, 350.0, 0.0, 90.0, 0.0]


def arm(name="KUKA KR 210 R2700-2", joints=JOINTS, model="kuka_kr210_r2700_2"):
    """A robot whose flange is where the oracle has it."""
    flange = Oracle.load(robot.find(model)).nominal_tcp(np.radians(joints[:6]), np.eye(4))
    flange[:3, 3] *= 1e3
    frame, tool = (np.array(robomath.KUKA_2_Pose(xyzabc).Rows()) for xyzabc in (BASE, TOOL_POSE))
    return Arm(name, joints, frame, tool, flange)


@pytest.fixture(autouse=True)
def input_files(work_folder):
    Path("milling.rdk").write_bytes(b"RDK")


@pytest.fixture
def init(monkeypatch):
    def run(arms, *arguments):
        with station(arms) as (port, opened):
            monkeypatch.setenv("ROBODK_API_PORT", str(port))
            return invoke("init", *arguments), opened

    return run


def keys(frame):
    return [frame.X, frame.Y, frame.Z, frame.A, frame.B, frame.C]


def test_robot_base_tool_and_start_are_those_of_the_station(init):
    done, opened = init([arm()], "--robodk", "milling.rdk")
    assert done.exit_code == 0, done.output
    assert [Path(name) for name in opened] == [Path("milling.rdk").resolve()]
    made = cells.load("cell.toml")
    assert made.robot == "kuka_kr210_r2700_2"
    np.testing.assert_allclose(keys(made.base), BASE, atol=1e-5)
    poses = [np.array(robomath.KUKA_2_Pose(xyzabc).Rows()) for xyzabc in (keys(made.tool), TOOL_POSE)]
    np.testing.assert_allclose(*poses, atol=1e-5)
    assert list(made.start.joints) == JOINTS
    assert "flange" not in done.stderr


def test_the_open_station_is_asked_without_opening_a_file_and_options_win(init):
    done, opened = init([arm()], "--robodk", "open", "--base", "1000,0,500", "--robot", "kuka_kr120_r2700_2")
    assert done.exit_code == 0, done.output
    assert opened == []
    made = cells.load("cell.toml")
    assert (made.robot, keys(made.base)) == ("kuka_kr120_r2700_2", [1000, 0, 500, 0, 0, 0])


def test_a_model_of_another_arm_is_told_by_where_the_flange_stands(init):
    done, _ = init([arm()], "--robodk", "open", "--robot", "kuka_kr240_r2900_2")
    assert done.exit_code == 0, done.output
    assert "is it the same arm" in done.stderr
    assert "mm away from that of KUKA KR 210 R2700-2 in RoboDK" in done.stderr


def test_a_robot_that_is_not_shipped_has_to_be_named(init):
    done, _ = init([arm("KUKA KR 999 R1-9")], "--robodk", "open")
    assert done.exit_code == 2
    assert "The robot of the station is KUKA KR 999 R1-9" in done.stderr
    assert "--robot" in done.stderr
    assert not Path("cell.toml").exists()


def test_external_axes_are_told(init):
    done, _ = init([arm(joints=[*JOINTS, 1000.0])], "--robodk", "open")
    assert done.exit_code == 0, done.output
    assert "1 external axes of the station are not taken over" in done.stderr


@pytest.mark.parametrize("count", [0, 2])
def test_a_station_without_one_robot_is_refused(init, count):
    done, _ = init([arm(), arm("ABB IRB 1")][:count], "--robodk", "open")
    assert done.exit_code == 1
    assert f"{count} robots with six joints" in done.stderr
    assert not Path("cell.toml").exists()


def test_a_robodk_that_is_not_there_is_a_message_that_says_what_to_give_instead(monkeypatch):
    monkeypatch.setenv("ROBODK_API_PORT", "1")
    monkeypatch.setenv("ROBODK_ROOT", str(Path("nowhere").resolve()))
    monkeypatch.setattr(robolink, "__ROBODK_BINARY_PATH_CACHE", None, raising=False)
    done = invoke("init", "--robodk", "open")
    assert done.exit_code == 1
    assert "RoboDK does not answer" in done.stderr
    assert "give --base, --tool and --start" in done.stderr
    assert done.stdout == ""


def test_without_the_package_the_message_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "robodk", None)
    done = invoke("init", "--robodk", "milling.rdk")
    assert done.exit_code == 1
    assert "pip install robodk" in done.stderr


def test_a_station_that_is_not_there_is_told(init):
    done, _ = init([arm()], "--robodk", "nothing.rdk")
    assert done.exit_code == 1
    assert "nothing.rdk: no such file" in done.stderr
