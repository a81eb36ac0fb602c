"""What a person clicks once a program is corrected: place, compare, correct again, stop; two windows, keys alone."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from postproc import cell as cells
from postproc.app.server import Window
from postproc.frames import MM_PER_M, inverse
from postproc.jobs.cell_edit import edit
from postproc.jobs.programs import load_robot
from tests.app.conftest import answering
from tests.app.test_window import looked_at, opened
from tests.pages.browser import needs_chromium
from tests.places import ROOT

pytestmark = needs_chromium


@pytest.fixture(scope="module")
def corrected_shop(original, tmp_path_factory):
    folder = shutil.copytree(original, tmp_path_factory.mktemp("corrected") / "shop")
    (folder / "demo").mkdir()
    for name in ("experiment.toml", "measurements.csv"):
        shutil.copy(ROOT / "samples" / "demo" / name, folder / "demo")
    return folder


@pytest.fixture
def window(corrected_shop, tmp_path):
    """A window on a folder with a program that is corrected."""
    with Window(shutil.copytree(corrected_shop, tmp_path / "shop"), 0) as served, answering(served):
        yield served


@pytest.fixture(scope="module")
def read_only_window(corrected_shop):
    """One window for all tests that only look: they leave the folder as it is."""
    before = sorted(corrected_shop.rglob("*"))
    with Window(corrected_shop, 0) as served, answering(served):
        yield served
    assert sorted(corrected_shop.rglob("*")) == before


def to_program(page):
    page.get_by_role("link", name="part.nc", exact=True).click()
    page.get_by_role("heading", name="May it be run?").wait_for()


def after_the_run(page):
    page.wait_for_url("**/run?*")
    page.get_by_role("link", name="See whether to run it").click()
    page.get_by_role("heading", name="May it be run?").wait_for()


def test_look_for_a_place_and_take_it(browser, window, monkeypatch):
    """Without bodies in the cell, and in a small region: `tests.placement` searches with both."""
    begin = window.runs.begin

    def begin_in_region(key, title, arguments, **options):
        region = ["--region", "X=1300:1600"] if arguments[0] == "place" else []
        return begin(key, title, [*arguments, *region], **options)

    monkeypatch.setattr(window.runs, "begin", begin_in_region)
    cell = window.workspace.cell.read_text().partition("[collision]")[0]
    window.workspace.cell.write_text(cell)
    with opened(browser, window) as page:
        to_program(page)
        page.get_by_role("button", name="Look for the best place").click()
        after_the_run(page)
        page.get_by_role("link", name="Map of places").wait_for()
        looked_at(page, "10-place")
        page.get_by_role("button", name="Take the best place").click()
        after_the_run(page)
        assert page.locator(".verdict.warning").count() == 0, "the result is that of the new cell"
    edited = window.workspace.cell.read_text()
    assert edited != cell
    assert [item.is_current for item in window.workspace.items()] == [True]


def test_compare_and_correct_again(browser, window):
    with opened(browser, window, dark=True) as page:
        to_program(page)
        page.get_by_role("button", name="Compare").click()
        after_the_run(page)
        page.get_by_role("link", name="Comparison").click()
        page.locator("h1").wait_for()
        page.go_back()
        page.get_by_text("Correct again, with options").click()
        page.get_by_label("Tolerance of the part, mm").fill("0.9")
        looked_at(page, "11-options")
        page.get_by_role("button", name="Correct again").click()
        after_the_run(page)
        page.get_by_text("0.9 mm", exact=True).wait_for()


def test_slow_the_feed_where_the_tolerance_is_exceeded_and_keep_it_again(browser, window):
    cell = window.workspace.cell
    with opened(browser, window) as page:
        to_program(page)
        assert page.get_by_role("button", name="Slow the feed").count() == 0, "there is no tolerance of the part"
        edit(cell, {"part.tolerance_mm": "0.5"})
        page.reload()
        before = cell.read_text()
        page.get_by_role("button", name="Slow the feed").click()
        after_the_run(page)
        assert cells.load(cell).output.feed == "hold"
        report = json.loads((window.workspace.results / "part.report.json").read_text())
        assert report["feed"]["tolerance_mm"] == 0.5
        looked_at(page, "17-slowed")
        page.get_by_role("button", name="Keep the programmed feeds").click()
        after_the_run(page)
        assert cells.load(cell).output.feed == "program"
        assert [line.partition("#")[2] for line in before.splitlines() if "#" in line] == [
            line.partition("#")[2] for line in cell.read_text().splitlines() if "#" in line
        ]


def test_change_the_robot_of_the_cell(browser, window):
    cell = window.workspace.cell
    with opened(browser, window) as page:
        page.get_by_role("link", name="Cell", exact=True).click()
        page.get_by_label("Model").select_option("kuka_kr210_r2700_2")
        page.get_by_role("button", name="Change the robot").click()
        page.get_by_text("Saved.").wait_for()
        page.get_by_role("heading", name="KUKA KR 210 R2700-2").wait_for()
        assert cells.load(cell).robot == "kuka_kr210_r2700_2"
        looked_at(page, "18-robot")
        page.locator("input[name='base.X']").fill("1490")
        page.get_by_role("button", name="Save").click()
        page.get_by_text("Saved.").wait_for()
    assert cells.load(cell).base.X == 1490.0


def test_put_the_start_above_a_part_that_was_moved(browser, window):
    cell = window.workspace.cell
    comments = [line.partition("#")[2] for line in cell.read_text().splitlines() if "#" in line]
    with opened(browser, window) as page:
        page.get_by_role("link", name="Cell", exact=True).click()
        page.locator("input[name='base.Z']").fill("1200")
        page.locator("input[name='machine.clearance_Z']").fill("150")
        page.get_by_role("button", name="Save").click()
        page.get_by_text("below clearance_Z").wait_for()
        looked_at(page, "19-low-start")
        page.get_by_role("button", name="Start above the part").click()
        page.get_by_text("below clearance_Z").wait_for(state="detached")
        looked_at(page, "20-start-above")
    assert [line.partition("#")[2] for line in cell.read_text().splitlines() if "#" in line] == comments
    stated = cells.load(cell)
    robot = load_robot(stated.robot, stated.folder)
    tip = robot.nominal.joint_frames(stated.start_joints[None])[1][0] @ stated.tool.pose()
    place = (inverse(stated.base.pose()) @ tip)[:3, 3] * MM_PER_M
    np.testing.assert_allclose(place, [0.0, 0.0, 200.0], atol=10.0)  # joints are rounded to 0.1 degrees


def test_stop_a_long_run(browser, window):
    shutil.copy(ROOT / "samples" / "plate.nc", window.workspace.folder / "plate.nc")
    before = {path.name: path.read_bytes() for path in window.workspace.results.iterdir() if path.is_file()}
    with opened(browser, window, width=420) as page:
        runs = window.runs
        run = runs.begin("plate.nc", "Best place for plate.nc", ["place", "plate.nc", "--cell", "corrected/cell.toml",
                         "--process", "corrected/part.process.toml", "-o", "corrected/place-plate"])  # fmt: skip
        page.goto(f"http://127.0.0.1:{window.access.port}/run?number={run.number}")
        page.locator("#step", has_text="%").wait_for()
        looked_at(page, "12-working")
        page.get_by_role("button", name="Stop").click()
        page.get_by_role("heading", name="Stopped").wait_for()
        looked_at(page, "13-stopped")
    assert run.code not in (0, None)
    assert {path.name: path.read_bytes() for path in window.workspace.results.iterdir() if path.is_file()} == before


def test_two_windows_begin_one_command_and_do_not_change_what_it_reads(browser, window):
    cell = window.workspace.cell.read_bytes()
    with opened(browser, window) as first, opened(browser, window) as second:
        to_program(first)
        to_program(second)
        first.get_by_role("button", name="Look for the best place").click()
        second.get_by_role("button", name="Look for the best place").click()
        first.wait_for_url("**/run?*")
        second.wait_for_url("**/run?*")
        assert first.url == second.url
        second.get_by_role("link", name="Cell", exact=True).click()
        second.locator("input[name='base.X']").fill("1510")
        second.get_by_role("button", name="Save").click()
        assert "nothing was changed" in second.get_by_role("alert").inner_text()
        looked_at(second, "14-cell-in-use")
        assert window.workspace.cell.read_bytes() == cell
        second.goto(first.url)
        second.get_by_role("button", name="Stop").click()
        first.get_by_role("heading", name="Stopped").wait_for()


def reached(page, name, presses=60):
    """Press Tab until the control of this name has the focus: its text, label, or name in the form."""
    for _ in range(presses):
        page.keyboard.press("Tab")
        focused = (
            "(document.activeElement.innerText || document.activeElement.getAttribute('aria-label') || "
            "document.activeElement.name || '')"
        )
        if page.evaluate(f"{focused}.startsWith({name!r})"):
            return
    raise AssertionError(f"{name} is not reached by Tab")


def test_keys_alone_correct_again_and_save(browser, window):
    with opened(browser, window) as page:
        reached(page, "part.nc")
        page.keyboard.press("Enter")
        page.get_by_role("heading", name="May it be run?").wait_for()
        reached(page, "Save part.src")
        with page.expect_download():
            page.keyboard.press("Enter")
        reached(page, "Correct again, with options")
        page.keyboard.press("Enter")
        reached(page, "Correct again")
        page.keyboard.press("Enter")
        page.wait_for_url("**/run?*")
        page.get_by_role("link", name="See whether to run it").wait_for()


@pytest.mark.parametrize(
    "path",
    [
        "/", "/program?name=part.nc", "/setup?name=part.nc", "/cell", "/process", "/process?name=part.nc", "/robots",
        "/readings?name=demo/experiment.toml", "/testpart",
    ],
)  # fmt: skip
def test_a_screen_reader_finds_its_way(browser, read_only_window, path):
    window = read_only_window
    with opened(browser, window, width=420, dark=True) as page:
        page.goto(f"http://127.0.0.1:{window.access.port}{path}")
        for role in ("banner", "navigation", "main", "contentinfo", "status"):
            assert page.get_by_role(role).count() >= 1, role
        assert page.get_by_role("heading", level=1).count() == 1
        assert page.locator("html[lang]").count() == 1
        unnamed = page.evaluate(
            "[...document.querySelectorAll('a, input, select, button, iframe')].filter((e) => e.type !== 'hidden' && "
            "!(e.labels?.length || e.textContent.trim() || e.getAttribute('aria-label') || e.title))"
            ".map((e) => e.outerHTML)"
        )
        assert unnamed == []
        looked_at(page, f"20{path.partition('?')[0].replace('/', '-')}")


def test_a_report_is_drawn_in_its_frame(browser, read_only_window):
    with opened(browser, read_only_window) as page:
        to_program(page)
        report = page.frame_locator("iframe")
        report.locator("h1").wait_for()
        page.locator("iframe").scroll_into_view_if_needed()
        report.locator(".main-svg, canvas").first.wait_for()
        page.wait_for_timeout(500)
        picture = page.locator("iframe").screenshot()
    assert len(picture) > 20_000, "a blank frame is a few hundred bytes"


def test_keys_alone_state_what_cuts(browser, window):
    path = window.workspace.results / "part.process.toml"
    with opened(browser, window) as page:
        page.goto(f"http://127.0.0.1:{window.access.port}/process?name=part.nc")
        reached(page, "tools.1.flutes")
        page.keyboard.press("Control+a")
        page.keyboard.type("4")
        reached(page, "Save")
        page.keyboard.press("Enter")
        page.get_by_text("Saved.").wait_for()
    assert "flutes = 4" in path.read_text()
