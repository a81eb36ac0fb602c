"""The sample cell and its robot, a KR 270 as shipped: what most tests run on."""

import numpy as np

from postproc import cell, robot
from postproc.errors import ModelError
from postproc.files import read_toml
from postproc.frames import pose_from_xyzabc
from postproc.robot.model_file import ModelFile
from tests.places import CELL_FILE

CELL_TEXT = CELL_FILE.read_text(encoding="utf-8")
CELL = cell.load(CELL_FILE)
TOOL = CELL.tool.pose()
NO_TOOL = np.eye(4)
"""A tip at the flange."""
TURNED_TOOL = pose_from_xyzabc([30.0, -20.0, 350.0, 10.0, -20.0, 30.0])
OFFSET_TOOL = pose_from_xyzabc([130.0, -20.0, 350.0, 10.0, -20.0, 30.0])
"""Turned too, and farther off the axis of the flange."""
FOLDER = robot.find(CELL.robot)
ROBOT = robot.load(FOLDER)
CONTENT = read_toml(FOLDER / "model.toml", ModelFile, ModelError)
"""Its `model.toml`."""
