"""From an empty folder and a program to a corrected program, as a person clicks."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from tests.pages.browser import needs_chromium
from tests.places import ROOT

pytestmark = needs_chromium
LONG_MS = 120_000
"""A busy machine takes minutes for what it does in seconds; no test measures time."""
WIDTHS = (420, 1400)
PICTURES = os.environ.get("APP_PICTURES", "")
"""Folder for pictures of the screens; empty: none are kept."""


@contextlib.contextmanager
def opened(browser, window, *, width=1400, dark=False):
    """The first page of a window; at the end nothing was said on the console, and nothing loaded from elsewhere."""
    said = []
    context = browser.new_context(
        viewport={"width": width, "height": 1000}, color_scheme="dark" if dark else "light", accept_downloads=True
    )
    page = context.new_page()
    page.set_default_timeout(LONG_MS)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: None if request.url.startswith(
        (f"http://127.0.0.1:{window.access.port}/", "data:", "blob:")) else said.append(request.url))  # fmt: skip
    page.goto(window.access.address)
    yield page
    context.close()
    assert said == []


def looked_at(page, name):
    """Check that nothing is cut off at any width; keep pictures if asked."""
    # The page may be loading. `wait_for_function` would evaluate text in the page, which its security policy forbids.
    page.wait_for_load_state("domcontentloaded")
    size = page.viewport_size
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 1000})
        needed, visible = page.evaluate("[document.documentElement.scrollWidth, document.documentElement.clientWidth]")
        assert needed <= visible, (name, width)
        if PICTURES:
            for scheme in ("light", "dark"):
                page.emulate_media(color_scheme=scheme)
                page.screenshot(path=Path(PICTURES) / f"{name}-{width}-{scheme}.png", full_page=True)
    page.emulate_media(color_scheme="light")
    page.set_viewport_size(size)


def answered(page):
    """Fill in what the program does not say: lists are chosen from, numbers typed."""
    page.locator("select[name=robot]").select_option("kuka_kr270")
    for name, value in {"base/X": 1500, "base/Y": 0, "base/Z": 700, "tool/Z": 350, "tool.1/Z": 350}.items():
        if (field := page.locator(f"input[name='{name}']")).count():
            field.fill(str(value))
    page.locator("select[name=material]").select_option("al_7075_hss")
    page.locator("input[name='flutes.1'], input[name='flutes.0']").first.fill("3")
    diameter = page.locator("input[name$='/diameter']").first
    if not diameter.input_value():
        diameter.fill("12")


def test_from_an_empty_folder_to_a_corrected_program(browser, window):
    with opened(browser, window) as page:
        looked_at(page, "1-empty")
        page.get_by_role("heading", name="Add the program").wait_for()
        page.locator("input[type=file]").set_input_files(ROOT / "samples" / "plate.nc")
        page.wait_for_url("**/setup?*")
        looked_at(page, "2-setup")
        page.get_by_role("button", name="Correct plate.nc").click()
        page.locator(".fault").first.wait_for()  # what is missing is said
        page.wait_for_load_state()
        looked_at(page, "3-missing")
        answered(page)
        page.get_by_role("button", name="Correct plate.nc").click()
        page.wait_for_url("**/run?*")
        looked_at(page, "4-run")
        page.get_by_role("link", name="See whether to run it").click()
        page.get_by_role("heading", name="May it be run?").wait_for()
        report = page.frame_locator("iframe")
        report.locator("h1").wait_for()
        looked_at(page, "5-program")
        with page.expect_download() as download:
            page.get_by_role("link", name="Save plate.src", exact=True).click()
        saved = Path(download.value.path()).read_bytes()
        assert saved == (window.workspace.results / "plate.src").read_bytes()
        assert b"LIN" in saved
        page.get_by_role("link", name="Programs", exact=True).click()
        looked_at(page, "6-programs")
        cell_before = window.workspace.cell.read_text()
        page.get_by_role("link", name="Cell", exact=True).click()
        looked_at(page, "7-cell")
        page.locator("input[name='base.X']").fill("1510")
        page.get_by_role("button", name="Save").click()
        page.get_by_text("Saved.").wait_for()
        cell_after = window.workspace.cell.read_text()
        assert comments(cell_before) == comments(cell_after)
        assert cell_before != cell_after
        page.get_by_role("link", name="Robots", exact=True).click()
        looked_at(page, "8-robots")
        page.get_by_role("link", name="kuka_kr270", exact=True).click()
        looked_at(page, "9-robot")


def comments(text):
    return [line.partition("#")[2] for line in text.splitlines() if "#" in line]


def test_keyboard_alone_comes_to_the_first_act(browser, window):
    (window.workspace.folder / "pocket.nc").write_bytes((ROOT / "samples" / "pocket.nc").read_bytes())
    with opened(browser, window) as page:
        for _ in range(8):
            page.keyboard.press("Tab")
            if page.evaluate("document.activeElement.className") == "act first":
                break
        page.keyboard.press("Enter")
        page.wait_for_url("**/setup?*")
        unnamed = page.evaluate(
            "[...document.querySelectorAll('input, select, button')].filter((e) => e.type !== 'hidden' && "
            "!(e.labels?.length || e.textContent.trim() || e.getAttribute('aria-label'))).map((e) => e.name)"
        )
        assert unnamed == []


def test_a_name_with_markup_is_text(browser, window):
    (window.workspace.folder / "a&b'c.nc").write_bytes((ROOT / "samples" / "pocket.nc").read_bytes())
    with opened(browser, window) as page:
        page.get_by_role("link", name="a&b'c.nc", exact=True).click()
        page.wait_for_url("**/setup?*")
        assert page.get_by_role("heading", level=1).inner_text() == "a&b'c.nc"


def test_no_guessed_base_or_tool_is_filled_in(browser, window):
    """A number that was clicked away moves the robot: base, tool and robot are empty until somebody says them."""
    (window.workspace.folder / "plate.nc").write_bytes((ROOT / "samples" / "plate.nc").read_bytes())
    with opened(browser, window) as page:
        page.goto(f"http://127.0.0.1:{window.access.port}/setup?name=plate.nc")
        assert page.locator("select[name=robot]").input_value() == ""
        frames = '[name^="base/"], [name^="tool"]'
        values = page.evaluate(f"[...document.querySelectorAll('{frames}')].map((e) => e.value)")
        assert len(values) >= 12
        assert set(values) == {""}
