"""From readings of the folder to a model that the cell uses."""

from __future__ import annotations

import shutil
from urllib.parse import urlencode

import pytest

from postproc import progress
from postproc.app.server import Window
from postproc.jobs.experiments import model_of, readings_of
from tests.app.conftest import answering
from tests.app.test_access import ask
from tests.app.test_window import looked_at, opened
from tests.pages.browser import needs_chromium
from tests.places import ROOT

DEMO = ROOT / "samples" / "demo"
NAME = "readings/experiment.toml"
SHOP_CELL = """# Cell of the shop.
robot = "kuka_kr270"   # until it is measured
[base]
X = 1500
Z = 700
[tool]
Z = 350
"""


@pytest.fixture
def window(tmp_path):
    """A window on a folder with a cell and the readings of the demo."""
    folder = tmp_path / "shop"
    (folder / "corrected").mkdir(parents=True)
    (folder / "corrected" / "cell.toml").write_text(SHOP_CELL)
    (folder / "readings").mkdir()
    for name in ("experiment.toml", "measurements.csv", "validation.csv"):
        shutil.copy(DEMO / name, folder / "readings")
    with Window(folder, 0) as served, answering(served):
        yield served


def test_readings_are_found_by_their_columns(window):
    folder = window.workspace.folder
    (folder / "readings" / "forces.csv").write_text("line,t,Fx\n")
    (folder / ".hidden").mkdir()
    shutil.copy(DEMO / "experiment.toml", folder / ".hidden")
    (entry,) = readings_of(folder)
    assert [path.name for path in entry.files] == ["measurements.csv", "validation.csv"]
    assert model_of(folder / "models" / "readings") is None


@pytest.mark.parametrize("name", ["../experiment.toml", "/etc/experiment.toml", "corrected/cell.toml", ""])
def test_readings_lead_to_nothing_outside(window, tmp_path, name):
    shutil.copy(DEMO / "experiment.toml", tmp_path)
    form = urlencode({"name": name}).encode()
    assert ask(window, "GET", f"/readings?{urlencode({'name': name})}")[0] == 400
    for path in ("/identify", "/validate", "/use-model"):
        assert ask(window, "POST", path, form)[0] == 400
    form = urlencode({"name": NAME, "readings": "../corrected/cell.toml"}).encode()
    assert ask(window, "POST", "/identify", form)[0] == 400
    assert window.runs.active_runs() == []


def test_a_model_that_may_not_be_used_is_not_taken(window):
    folder = window.workspace.folder / "models" / "readings"
    shutil.copytree(ROOT / "robot_models" / "kuka_kr270", folder)
    form = urlencode({"name": NAME}).encode()
    assert ask(window, "POST", "/use-model", form)[0] == 400, "nobody knows where it comes from"
    assert window.workspace.cell.read_text() == SHOP_CELL


def test_a_step_of_unknown_length_is_read(capsys):
    progress.write_step("joint springs and compensator")
    line = capsys.readouterr().err
    assert progress.parse_progress(line) == (None, "joint springs and compensator")


@needs_chromium
def test_identify_a_model_and_use_it(browser, window):
    with opened(browser, window) as page:
        page.get_by_role("link", name="Robots", exact=True).click()
        looked_at(page, "50-robots")
        page.get_by_role("link", name=NAME).click()
        looked_at(page, "51-readings")
        page.get_by_role("button", name="Identify the model").click()
        result = page.get_by_role("link", name="See the result")
        page.locator("#step", has_text="springs").or_(result).wait_for()  # a fast machine is past its steps
        looked_at(page, "52-identifying")
        result.click()
        page.get_by_role("heading", name="May it be used? Yes").wait_for()
        page.frame_locator("iframe").locator("h1").wait_for()
        looked_at(page, "53-model")
        page.get_by_role("button", name="Check it with readings").click()
        page.get_by_role("heading", name="Done").wait_for()
        looked_at(page, "54-checked")
        page.get_by_role("link", name="See the result").click()
        page.get_by_role("button", name="Use this model in the cell").click()
        page.get_by_text("The cell uses this model.").wait_for()
        looked_at(page, "55-used")
    assert window.workspace.cell.read_text() == SHOP_CELL.replace("kuka_kr270", "../models/readings")
