"""The test part: written, probed, and made a model of, without leaving the window."""

from __future__ import annotations

import json

import numpy as np
import pytest

from postproc.app.server import Window
from tests.app.conftest import answering
from tests.app.test_access import ask
from tests.app.test_models import SHOP_CELL
from tests.app.test_window import looked_at, opened
from tests.pages.browser import needs_chromium
from tests.testpart import trial

PROCESS = """[material]
name = "al_7075_t6_carbide"
sigma_percent = 10
[tools.1]
diameter_mm = 10
flutes = 3
rpm = 6000
[stock]
box = { X = [0, 90], Y = [0, 80], Z = [-30, 0] }
resolution_mm = 1
"""
PROBED = b"feature,source_line,t,X,Y,Z,nx,ny,nz,deviation_mm\nF01.left,1,0.5,0,0,0,1,0,0,0.01\n"


@pytest.fixture
def window(tmp_path):
    """A window on a folder with a cell and a process."""
    folder = tmp_path / "shop"
    (folder / "corrected").mkdir(parents=True)
    (folder / "corrected" / "cell.toml").write_text(
        SHOP_CELL.replace("Z = 700", "Y = -200\nZ = 700") + "[start]\njoints = [0, -70, 110, 0, 50, 0]\n"
    )
    (folder / "corrected" / "process.toml").write_text(PROCESS)
    with Window(folder, 0) as served, answering(served):
        yield served


def test_only_a_probing_file_of_a_part_is_taken(window):
    status, _, content = ask(window, "POST", "/add-probed?name=probing.csv", PROBED)
    assert status == 400, "there is no part"
    folder = window.workspace.folder / "testpart"
    folder.mkdir()
    (folder / "testpart.nc").write_text("M30\n")
    status, _, content = ask(window, "POST", "/add-probed?name=x.csv", b"a,b\n1,2\n")
    assert status == 400
    assert "no probing file" in json.loads(content)["fault"]
    assert [path.name for path in folder.iterdir()] == ["testpart.nc"]
    assert ask(window, "POST", "/add-probed?name=../../x.csv", PROBED)[0] == 200
    assert (folder / "probed.csv").read_bytes() == PROBED, "always under its own name"


@pytest.mark.parametrize("name", ["../corrected/cell.toml", "testpart.json", "probing.csv", ""])
def test_only_files_of_the_part_are_sent(window, name):
    assert ask(window, "GET", f"/testpart-file?name={name}")[0] == 400


def filled_in(folder):
    """The probing file of a part that a simulated robot has milled; it shares no code with the package."""
    arm = trial.truth(np.random.default_rng(1))
    text = (folder / "testpart.nc").read_text()
    return trial.machine(arm).probed(text, (folder / "probing.csv").read_text(), np.random.default_rng(2)).encode()


@needs_chromium
def test_write_a_part_probe_it_and_see_its_model(browser, window):
    folder = window.workspace.folder / "testpart"
    with opened(browser, window) as page:
        page.get_by_role("link", name="Test part", exact=True).click()
        looked_at(page, "60-testpart")
        page.get_by_label("Features at most").fill("3")
        page.get_by_role("button", name="Write the part").click()
        page.get_by_role("link", name="See the result").click()
        page.get_by_text("Points to probe:").click()
        rows = page.get_by_role("region", name="Points to probe").get_by_role("row")
        assert rows.count() == len((folder / "probing.csv").read_text().splitlines())
        looked_at(page, "61-to-probe")
        with page.expect_download() as download:
            page.get_by_role("link", name="Save testpart.src").click()
        assert download.value.path().read_bytes() == (folder / "testpart.src").read_bytes()
        content = {"name": "from the machine.csv", "mimeType": "text/csv", "buffer": filled_in(folder)}
        page.get_by_label("Choose the probing file").set_input_files(content)
        page.get_by_role("button", name="Identify the model").click()
        page.get_by_role("link", name="See the result").click()
        page.get_by_role("heading", name="4. May it be used? Yes").wait_for()
        page.frame_locator("iframe").locator("h1").wait_for()
        looked_at(page, "62-model")
        page.get_by_role("button", name="Check the model of the cell with it").click()
        page.get_by_role("heading", name="Done").wait_for()
    assert (window.workspace.folder / "models" / "testpart" / "model.toml").is_file()
