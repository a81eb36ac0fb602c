"""PTPs and the first move from [start] against the stock: all axes move at once. The path is that of an arm of our own.

The oracle drives its arm (`tests/oracle/arm.py`) along the straight line between two sets of joint angles, and looks
where the axis of the tool is: inside the box, or farther from it than the tool is wide.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from msgspec.structs import replace

import postproc
from postproc import correction, machining
from postproc.cell import Start
from postproc.frames import xyzabc_from_pose
from postproc.machining.leaning import depth_inside
from postproc.machining.stock import from_box
from postproc.machining.tool import Cutter
from postproc.under_load import RobotInCell, segments_in_cell
from tests.machining.setting import gcode, process, tool
from tests.oracle.arm import Arm
from tests.places import SAMPLES

ROBOTS = {"kuka_kr270": "cell_kr270.toml", "kuka_kr16": "cell_kr16.toml"}
TOOLS = {"flat": (12.0, 0.0), "ball": (10.0, 0.0), "bull": (16.0, 3.0)}
BOX = np.array([[0.0, 100.0], [0.0, 80.0], [-60.0, 0.0]])
CELL_MM = 1.0


class Planted:
    """A cell, an arm of the oracle, and joint angles of poses of the tool above, beside and in the box."""

    def __init__(self, robot: str, seed: int) -> None:
        self.cell = postproc.load_cell(SAMPLES / ROBOTS[robot])
        self.robot = postproc.load_robot(self.cell.robot)
        self.arm = Arm.load(SAMPLES.parent / "robot_models" / self.cell.robot)
        self.random = np.random.default_rng(seed)
        self.tool, self.base = self.cell.tool.pose(), self.cell.base.pose()

    def in_base(self, q):
        return np.linalg.inv(self.base) @ self.arm.nominal_tcp(q, self.tool)

    def joints(self, place):
        """Joint angles at which the tip is at a place [mm] and the spindle above it."""
        pose = np.eye(4)
        pose[:3, :3] = np.diag([-1.0, 1.0, -1.0]) if self.cell.tool.axis == "+Z" else DOWN_X
        pose[:3, 3] = 1e-3 * np.asarray(place)
        q = self.arm.inverse(self.base @ pose, self.tool, np.array(self.cell.start_joints))
        np.testing.assert_allclose(self.in_base(q), pose, atol=1e-7)
        return q

    def depth(self, begin, end, radius):
        """How deep the axis of the tool is in the box [mm]; outside, its radius less its distance."""
        deepest = -np.inf
        for share in np.linspace(0.0, 1.0, 300):
            pose = self.in_base(begin + share * (end - begin))
            column, sign = (2, -1.0) if self.cell.tool.axis == "+Z" else (0, -1.0)
            axis = 1e3 * pose[:3, 3] + np.arange(0.0, 200.0, 2.0)[:, None] * sign * pose[:3, column]
            outside = np.maximum(BOX[:, 0] - axis, axis - BOX[:, 1])
            distance = np.linalg.norm(np.maximum(outside, 0.0), axis=1)
            inside = -outside.max(axis=1)
            deepest = max(deepest, float(np.where(inside > 0.0, inside, radius - distance).max()))
        return deepest


DOWN_X = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


def rapid_issues(planted, path, shape):
    """Issues of the sweep about rapid moves through material."""
    program = postproc.read_program(path, planted.robot, planted.cell)
    diameter, corner = TOOLS[shape]
    text = process(tool(diameter, 2, shape, corner) + "rpm = 6000\n", BOX, CELL_MM)
    (path.parent / "process.toml").write_text(text.replace("[tools.1]", "[tools.default]"))
    place = RobotInCell.of(planted.robot, planted.cell)
    path_in_cell = segments_in_cell(program, place)
    found = machining.estimate(program, path_in_cell, machining.load(path.parent / "process.toml"), place.spindle)
    return [issue for issue in found.issues if issue.kind == "rapid-in-material"]


def pairs(planted, shape, wanted):
    """A way from a random place to another that goes through the box by 3 mm, or stays 3 mm away from it."""
    radius = TOOLS[shape][0] / 2
    for _ in range(60):
        side = planted.random.choice([-1.0, 1.0])
        height = planted.random.uniform(-50.0, -10.0) if wanted else planted.random.uniform(20.0, 120.0)
        begin = planted.joints([50.0 - side * 120.0, planted.random.uniform(10.0, 70.0), height])
        end = planted.joints([50.0 + side * 100.0, planted.random.uniform(10.0, 70.0), planted.random.uniform(15, 40)])
        deep = planted.depth(begin, end, radius)
        if deep > 3.0 if wanted else deep < -3.0:
            return begin, end
    raise AssertionError("no such way")


CASES = [(robot, shape, seed) for robot in ROBOTS for seed, shape in enumerate(TOOLS)]


@pytest.mark.parametrize("through", [True, False])
@pytest.mark.parametrize(("robot", "shape", "seed"), CASES)
def test_the_first_move_from_start_is_found_in_the_stock_and_not_beside_it(tmp_path, robot, shape, seed, through):
    planted = Planted(robot, seed)
    begin, end = pairs(planted, shape, through)
    planted.cell = replace(planted.cell, start=Start(joints=tuple(np.degrees(begin).tolist())))
    x, y, z = 1e3 * planted.in_base(end)[:3, 3]
    text = gcode(f"G0 X{x:.4f} Y{y:.4f} Z{z:.4f}", "G0 Z60", "G0 X-30 Y40", "G0 Z-5", "G1 X50 F1000", "G0 Z60")
    (tmp_path / "part.nc").write_text(text)
    issues = rapid_issues(planted, tmp_path / "part.nc", shape)
    assert bool(issues) == through
    for issue in issues:
        assert (issue.level, issue.source_line, issue.lines) == ("error", 4, (4,))
        assert "choose [start] joints with the tip above the part" in issue.message


@pytest.mark.parametrize("through", [True, False])
@pytest.mark.parametrize(("robot", "shape", "seed"), CASES)
def test_a_ptp_of_krl_is_found_in_the_stock_and_not_beside_it(tmp_path, robot, shape, seed, through):
    planted = Planted(robot, 100 + seed)
    begin, end = pairs(planted, shape, through)
    frames = [
        f"{name}={{X {frame.X},Y {frame.Y},Z {frame.Z},A {frame.A},B {frame.B},C {frame.C}}}"
        for name, frame in (("$BASE", planted.cell.base), ("$TOOL", planted.cell.tool))
    ]
    to = ["PTP {" + ",".join(f"A{k + 1} {v:.5f}" for k, v in enumerate(np.degrees(q))) + "}" for q in (begin, end)]
    x, y, _, *angles = xyzabc_from_pose(planted.in_base(end))
    turned = ",".join(f"{name} {value:.5f}" for name, value in zip("ABC", angles, strict=True))
    lines = [
        f"LIN {{X {px:.3f},Y {py:.3f},Z {pz:.3f},{turned}}}"
        for px, py, pz in ((x, y, 60.0), (-30.0, 40.0, 60.0), (-30.0, 40.0, -5.0), (50.0, 40.0, -5.0))
    ]
    text = ["DEF part()", *frames, *to, "$VEL.CP=0.02", *lines, "END", ""]
    (tmp_path / "part.src").write_text("\n".join(text))
    issues = rapid_issues(planted, tmp_path / "part.src", shape)
    assert [issue.lines for issue in issues] == ([(5,)] if through else [])


def test_the_depth_of_a_leaning_tool_is_that_of_its_lowest_corner():
    """A flat tool of radius r that leans by α reaches r·sin α below its tip; the map locates its rim to a cell."""
    cell, radius, lean, top = 5e-4, 8e-3, np.radians(20.0), 0.0
    stock = from_box(np.array([-0.05, -0.05, -0.04]), np.array([0.05, 0.05, top]), cell)
    towards = np.array([[np.sin(lean), 0.0, np.cos(lean)]])
    for height in (1.5e-3, 4e-3):
        expected = radius * np.sin(lean) - height
        depth = depth_inside(stock, Cutter(radius, 0.0, 2), np.array([[0.0, 0.0, height]]), towards)
        assert depth == pytest.approx(max(expected, 0.0), abs=cell)
        assert (depth > 0.0) == (expected > 0.0)


def test_a_first_move_that_comes_down_on_its_way_names_its_lowest_height(tmp_path):
    """Both ends are above the first target or at it; the tip, moved by all axes at once, is lower between."""
    planted = Planted("kuka_kr270", 7)
    target = [50.0, 40.0, 30.0]
    end = planted.joints(target)
    for _ in range(200):
        begin = end + planted.random.uniform(-0.6, 0.6, 6)
        heights = [1e3 * planted.in_base(begin + share * (end - begin))[2, 3] for share in np.linspace(0.0, 1.0, 400)]
        if heights[0] > 40.0 and min(heights) < 15.0:
            break
    cell = replace(planted.cell, start=Start(joints=tuple(np.degrees(begin).tolist())))
    (tmp_path / "part.nc").write_text(gcode("G0 X50 Y40 Z30", "G1 X60 F1000"))
    program = postproc.read_program(tmp_path / "part.nc", planted.robot, cell)
    (issue,) = [each for each in correction.process(program, planted.robot, cell).issues if each.kind == "start-below"]
    assert "passes below the first target" in issue.message
    lowest = float(re.search(r"comes down to Z (-?[\d.]+) mm", issue.message)[1])
    assert lowest == pytest.approx(min(heights), abs=0.2)


def test_a_first_target_below_the_clearance_is_no_fault_of_the_start(tmp_path):
    """A program that begins with G0 to a place near the part comes down to it; only a start that is low is a fault."""
    planted = Planted("kuka_kr270", 7)
    above, below = ([50.0, 40.0, height] for height in (250.0, 150.0))
    (tmp_path / "part.nc").write_text(gcode("G0 X60 Y40 Z30", "G1 X70 F1000"))
    machine = replace(planted.cell.machine, clearance_Z=200.0)
    for place, faults in ((above, 0), (below, 1)):
        start = Start(joints=tuple(np.degrees(planted.joints(place)).tolist()))
        cell = replace(planted.cell, start=start, machine=machine)
        program = postproc.read_program(tmp_path / "part.nc", planted.robot, cell)
        issues = correction.process(program, planted.robot, cell).issues
        assert [each.level for each in issues if each.kind == "start-below"] == ["warning"] * faults, issues
