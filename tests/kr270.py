"""The sample cell and its robot, a KR 270 as shipped: what most tests run on."""

from postproc import cell, robot
from tests.places import CELL_FILE

CELL_TEXT = CELL_FILE.read_text(encoding="utf-8")
CELL = cell.load(CELL_FILE)
ROBOT = robot.load(robot.find(CELL.robot))
