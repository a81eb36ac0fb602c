"""The sample cell and its robot, a KR 270 as shipped: what most tests run on."""

from postproc import cell, robot
from postproc.errors import ModelError
from postproc.files import read_toml
from postproc.robot.model_file import ModelFile
from tests.places import CELL_FILE

CELL_TEXT = CELL_FILE.read_text(encoding="utf-8")
CELL = cell.load(CELL_FILE)
FOLDER = robot.find(CELL.robot)
ROBOT = robot.load(FOLDER)
CONTENT = read_toml(FOLDER / "model.toml", ModelFile, ModelError)
"""Its `model.toml`."""
