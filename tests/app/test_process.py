"""Tools, material and stock of a program: what its comments state, and a file that stays the truth."""

from __future__ import annotations

import shutil
import tomllib
from urllib.parse import urlencode

import pytest

from postproc.app.server import Window
from postproc.errors import InputError
from postproc.jobs.process_edit import edit_process, process_tables
from postproc.jobs.program_needs import needs_of
from postproc.jobs.setup_form import setup_form, start_arguments
from tests.app.conftest import answering
from tests.app.test_access import ask
from tests.app.test_window import looked_at, opened
from tests.machining.test_rapid_tools import BOTH, module
from tests.pages.browser import needs_chromium
from tests.test_currency import CELL_WITH_MESH, PROCESS, PROGRAM

FUSION = "(T1 D=12. CR=0. - ZMIN=-2. - flat end mill 3 flutes)\n" + PROGRAM
STATED = {"material.name": "al_7075_hss"}


def texts_of(path, program_file):
    """The texts of the fields by name."""
    return {
        field.name: field.text
        for table in process_tables(path, needs_of(program_file))
        for field in table.fields
        if field.text
    }


@pytest.fixture
def program_file(tmp_path):
    path = tmp_path / "part.nc"
    path.write_text(FUSION)
    return path


def test_a_program_without_a_process_gets_what_its_comments_state(program_file, tmp_path):
    path = tmp_path / "corrected" / "part.process.toml"
    texts = texts_of(path, program_file)
    assert (texts["tools.1.diameter_mm"], texts["tools.1.flutes"], texts["tools.1.shape"]) == ("12", "3", "flat")
    assert texts["stock.assumed"] == "true", "nobody has stated the stock"
    assert "material.name" not in texts
    assert not path.parent.exists(), "nothing is written before it is saved"
    assert edit_process(path, needs_of(program_file), STATED)
    content = tomllib.loads(path.read_text())
    assert content["tools"]["1"] == {"shape": "flat", "diameter_mm": 12, "flutes": 3}
    assert content["stock"]["assumed"] is True
    assert "flat end mill 3 flutes" in path.read_text()


@pytest.mark.parametrize(
    ("texts", "problem"),
    [
        ({}, "no"),
        (STATED | {"tools.1.flutes": ""}, r"tools\.1\.flutes is missing"),
        (STATED | {"tools.1.diameter_mm": "-3"}, "diameter_mm"),
        (STATED | {"tools.1.diameter_mm": "wide"}, "is no number"),
        (STATED | {"stock.box.X": "5, "}, "two numbers"),
        (STATED | {"stock.box.X": "5, 1"}, "from smaller to larger"),
        ({"material.name": "cheese"}, "cheese"),
    ],
)
def test_a_process_that_convert_would_refuse_is_not_written(program_file, tmp_path, texts, problem):
    path = tmp_path / "corrected" / "part.process.toml"
    with pytest.raises(InputError, match=problem):
        edit_process(path, needs_of(program_file), texts)
    assert not path.exists()
    assert not list(tmp_path.glob("corrected/.*")), "no trial file is left"


def test_an_edit_keeps_comments_and_all_else(program_file, tmp_path):
    path = tmp_path / "part.process.toml"
    text = PROCESS.replace("flutes = 3", "flutes = 3   # measured").replace(
        'file = "material.toml"', 'name = "al_7075_hss"'
    )
    path.write_text(text)
    assert not edit_process(path, needs_of(program_file), {})
    assert edit_process(path, needs_of(program_file), {"tools.1.diameter_mm": "11.9"})
    assert path.read_text() == text.replace("diameter_mm = 12", "diameter_mm = 11.9")


def test_a_tool_that_the_file_lacks_is_added(program_file, tmp_path):
    path = tmp_path / "part.process.toml"
    path.write_text(PROCESS.replace("tools.1", "tools.4").replace('file = "material.toml"', 'name = "al_7075_hss"'))
    assert [table.name for table in process_tables(path, needs_of(program_file)) if table.is_new] == ["tools.1"]
    assert edit_process(path, needs_of(program_file), {"tools.1.flutes": "2"})
    assert tomllib.loads(path.read_text())["tools"]["1"]["flutes"] == 2
    assert tomllib.loads(path.read_text())["tools"]["4"]["flutes"] == 3


@pytest.fixture
def window(tmp_path, program_file):
    """A window on a folder with a cell and a program, and no process."""
    folder = tmp_path / "shop"
    (folder / "corrected").mkdir(parents=True)
    shutil.copy(program_file, folder)
    cell = (
        CELL_WITH_MESH.partition("[collision]")[0]
        .replace('"../model"', '"kuka_kr270"')
        .replace('config_dat = "config.dat"\n', "")
    )
    (folder / "corrected" / "cell.toml").write_text(cell)
    with Window(folder, 0) as served, answering(served):
        yield served


@needs_chromium
def test_fill_in_what_cuts_and_correct(browser, window):
    path = window.workspace.results / "part.process.toml"
    with opened(browser, window) as page:
        page.get_by_role("link", name="Process", exact=True).click()
        looked_at(page, "30-processes")
        page.get_by_role("link", name="part.nc", exact=True).click()
        page.get_by_text("flat end mill 3 flutes").wait_for()
        looked_at(page, "31-process-new")
        page.get_by_role("button", name="Save").click()
        page.get_by_role("alert").wait_for()
        assert not path.exists()
        page.locator("select[name='material.name']").select_option("al_7075_hss")
        page.get_by_role("button", name="Save").click()
        page.get_by_text("Saved.").wait_for()
        looked_at(page, "32-process-saved")
        page.get_by_role("button", name="Correct part.nc").click()
        page.get_by_role("link", name="See whether to run it").click()
        page.get_by_text("The stock is assumed: check it first.").wait_for()
        looked_at(page, "33-assumed")
        page.get_by_role("link", name="Programs", exact=True).click()
        page.get_by_role("row", name="part.nc").get_by_text("The stock is assumed: check it first.").wait_for()
        page.go_back()
        page.get_by_role("link", name="Tools, material, stock").click()
        page.get_by_role("checkbox").uncheck()
        page.get_by_role("group", name="Z").get_by_label("to").fill("1")
        page.get_by_role("button", name="Save").click()
        page.get_by_text("Saved.").wait_for()
    content = tomllib.loads(path.read_text())["stock"]
    assert "assumed" not in content
    assert content["box"]["Z"][1] == 1
    assert window.workspace.items()[0].changes == ("tools, material, stock or forces",)


def test_the_process_is_not_changed_while_a_command_runs(window):
    run = window.runs.begin("part.nc", "Watch", ("watch", ".", "--cell", "corrected/cell.toml"))
    status, _, page = ask(window, "POST", "/process?name=part.nc", urlencode(STATED).encode())
    assert status == 400
    assert b"nothing was changed" in page
    assert b"<option selected>al_7075_hss" in page, "what was chosen is still on the page"
    assert not (window.workspace.results / "part.process.toml").exists()
    run.stop()


def test_the_process_for_all_programs_is_that_of_a_program_without_one(shop):
    results = shop / "corrected"
    with Window(shop, 0) as window:
        assert window.workspace.process_file("part.nc") == results / "part.process.toml"
        assert window.workspace.process_file("other.nc") is None
        shutil.copy(results / "part.process.toml", results / "process.toml")
        assert window.workspace.process_file("other.nc") == results / "process.toml"
        assert window.workspace.process_file("part.nc") == results / "part.process.toml"


def test_each_tool_of_a_module_gets_a_table_by_its_name(tmp_path):
    path, part = tmp_path / "part.process.toml", tmp_path / "part.mod"
    part.write_text(module(BOTH))
    names = [table.name for table in process_tables(path, needs_of(part))]
    assert names == ["material", "tools.tMill", "tools.tBall", "stock", "spindle"]
    path.write_text(PROCESS.replace("tools.1", "tools.TMILL").replace('file = "material.toml"', 'name = "al_7075_hss"'))
    assert [table.name for table in process_tables(path, needs_of(part)) if table.is_new] == ["tools.tBall"]
    assert edit_process(path, needs_of(part), {"tools.tBall.flutes": "2", "tools.tBall.diameter_mm": "8"})
    tools = tomllib.loads(path.read_text())["tools"]
    assert (list(tools), tools["tBall"]["diameter_mm"]) == (["TMILL", "tBall"], 8)


def test_the_window_asks_for_the_cutter_of_each_tool_of_a_module(tmp_path):
    part = tmp_path / "part.mod"
    part.write_text(module(BOTH))
    texts = {"cutter.tMill": "flat,10", "flutes.tBall": "2"}
    form = setup_form(needs_of(part), texts, cell=False, process=True)
    keys = [field.question.key for field in form.fields]
    assert [key for key in keys if key.startswith("cutter")] == ["cutter.tMill", "cutter.tBall"]
    assert start_arguments(part, form)[3:5] == ["--cutter=tMill=flat,10", "--flutes=tBall=2"]
