"""Every screen by keyboard alone: Tab reaches each control in the order of the page, and the focus is seen.

The report in its frame is last on its screen, and has tests of its own.
"""

from __future__ import annotations

import shutil

import pytest

from postproc.app.server import Window
from tests.app.conftest import answering
from tests.app.test_window import looked_at, opened
from tests.pages.browser import needs_chromium
from tests.places import ROOT
from tests.test_currency import PROGRAM

pytestmark = needs_chromium

SCREENS = (
    "/", "/program?name=part.nc", "/program?name=new.nc", "/setup?name=new.nc", "/cell", "/process",
    "/process?name=part.nc", "/process?name=new.nc", "/robots", "/robots?name=kuka_kr270",
    "/readings?name=demo/experiment.toml", "/testpart", "/run?number=0", "/run?number=1", "/nothing",
)  # fmt: skip
_CONTROLS = """() => [...document.querySelectorAll(
  'a[href], button, input:not([type=hidden]), select, textarea, summary, [tabindex="0"]')]
  .filter((e) => e.checkVisibility() && !e.disabled)
  .map((e, k) => { e.dataset.control = k; return e.outerHTML.slice(0, 120); })"""
_FOCUS = """() => {
  const e = document.activeElement;
  if (e === document.body || e.tagName === 'IFRAME') return null;
  const style = getComputedStyle(e), box = e.getBoundingClientRect();
  const seen = style.outlineStyle !== 'none' && parseFloat(style.outlineWidth) >= 1;
  return { number: Number(e.dataset.control), is_seen: seen,
           is_on_screen: box.bottom > 0 && box.top < innerHeight && box.width > 0 };
}"""
_UNNAMED = """() => [...document.querySelectorAll('a, input, select, button, summary, iframe, fieldset, table, svg')]
  .filter((e) => e.type !== 'hidden')
  .filter((e) => !(e.labels?.length || e.textContent.trim() || e.getAttribute('aria-label') || e.title))
  .map((e) => e.outerHTML.slice(0, 120))"""
_BROKEN_REFERENCES = """() => [...document.querySelectorAll('[aria-labelledby], [aria-describedby]')].flatMap((e) =>
  ['aria-labelledby', 'aria-describedby'].map((a) => e.getAttribute(a)))
  .filter((id) => id && !document.getElementById(id))"""


@pytest.fixture(scope="module")
def window(original, tmp_path_factory):
    """A window on a folder with a corrected program, a new one, readings, and commands that have ended."""
    folder = shutil.copytree(original, tmp_path_factory.mktemp("keyboard") / "shop")
    (folder / "new.nc").write_text("(T1 D=12. CR=0. - ZMIN=-2. - flat end mill)\n" + PROGRAM)
    (folder / "demo").mkdir()
    for name in ("experiment.toml", "measurements.csv"):
        shutil.copy(ROOT / "samples" / "demo" / name, folder / "demo")
    with Window(folder, 0) as served, answering(served):
        for command in (["convert", "part.nc", "--cell", "corrected/none.toml"], ["robots"]):
            served.runs.begin("part.nc", "Correct part.nc", command).wait()
        yield served


def to(page, window, path):
    page.goto(f"http://127.0.0.1:{window.access.port}{path}")


@pytest.mark.parametrize("path", SCREENS)
def test_tab_reaches_every_control_in_order_and_the_focus_is_seen(browser, window, path):
    with opened(browser, window, width=420, dark=True) as page:
        to(page, window, path)
        page.evaluate("for (const e of document.querySelectorAll('details')) e.open = true")
        controls, order = page.evaluate(_CONTROLS), []
        for _ in range(2 * len(controls) + 4):
            page.keyboard.press("Tab")
            focus = page.evaluate(_FOCUS)
            if focus is None:
                break
            order.append(focus["number"])
            assert focus["is_seen"], f"no focus is seen: {controls[focus['number']]}"
            assert focus["is_on_screen"], f"beyond the screen: {controls[focus['number']]}"
        assert order[: len(controls)] == list(range(len(controls)))
        assert page.evaluate(_UNNAMED) == []
        assert page.evaluate(_BROKEN_REFERENCES) == []


def test_the_skip_link_leads_past_the_menu(browser, window):
    with opened(browser, window) as page:
        page.keyboard.press("Tab")
        looked_at(page, "60-skip")
        page.keyboard.press("Enter")
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.closest('main') !== null")


def test_faults_of_the_set_up_are_read_with_their_fields(browser, window):
    with opened(browser, window) as page:
        to(page, window, "/setup?name=new.nc")
        page.get_by_role("button", name="Correct new.nc").press("Enter")
        page.locator(".fault").first.wait_for()
        assert page.evaluate(_BROKEN_REFERENCES) == []
        described = (
            "[...document.querySelectorAll('[aria-invalid=true]')].map((e) => e.hasAttribute('aria-describedby'))"
        )
        assert set(page.evaluate(described)) == {True}
        page.locator("[aria-invalid=true]:focus").wait_for()
        looked_at(page, "61-faults")


def test_a_change_of_the_list_keeps_the_focus_and_the_chooser_of_files(browser, shop):
    with Window(shop, 0) as window, answering(window), opened(browser, window) as page:
        page.evaluate("document.querySelector('.drop input').dataset.same = 'yes'")
        page.get_by_role("link", name="part.nc", exact=True).focus()
        (shop / "other.nc").write_text(PROGRAM)
        page.get_by_role("row", name="other.nc").wait_for()
        assert page.evaluate("document.activeElement.textContent") == "part.nc"
        assert page.evaluate("document.querySelector('.drop input').dataset.same") == "yes"
        (shop / "other.nc").unlink()
        page.get_by_role("row", name="other.nc").wait_for(state="detached")
        page.locator("input[type=file]").set_input_files(ROOT / "samples" / "plate.nc")
        page.wait_for_url("**/setup?*")
