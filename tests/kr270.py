"""The sample cell and its robot, a KR 270 as shipped: what most tests run on."""

import numpy as np

from postproc import cell, robot
from postproc.errors import ModelError
from postproc.files import read_toml
from postproc.frames import Array, pose_from_xyzabc
from postproc.robot.model_file import ModelFile
from tests.places import CELL_FILE

CELL_TEXT = CELL_FILE.read_text(encoding="utf-8")
CELL = cell.load(CELL_FILE)
FOLDER = robot.find(CELL.robot)
ROBOT = robot.load(FOLDER)
CONTENT = read_toml(FOLDER / "model.toml", ModelFile, ModelError)
"""Its `model.toml`."""


def tool_at(x: float, y: float, z: float) -> Array:
    """Return the pose (4, 4) of a tip at a point of the flange [m], turned as the flange."""
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


TOOL = CELL.tool.pose()
STRAIGHT_TOOL = tool_at(0.0, 0.0, 0.35)
SIDE_TOOL = tool_at(0.2, -0.06, 0.18)
TURNED_TOOL = pose_from_xyzabc([30.0, -20.0, 350.0, 10.0, -20.0, 30.0])
OFFSET_TOOL = pose_from_xyzabc([130.0, -20.0, 350.0, 10.0, -20.0, 30.0])
"""Turned too, and farther off the axis of the flange."""
