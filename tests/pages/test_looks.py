"""Nothing on a page is cut off, or written over something else, on a screen of any width."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.report import page as rendered
from tests import fabricated
from tests.commands import run
from tests.pages.browser import faults_of_looks, needs_chromium, opened
from tests.places import ROOT

pytestmark = needs_chromium
WIDTHS = (420, 1200, 1440)
SETTLED_MS = 500
"""After this a page of another width is drawn."""
PLANTED = (("#worst", "width", "3000px"), ("#histogram .xtick text", "fontSize", "60px"))
"""Elements, and a size that they do not have room for."""
_STYLE = """([selector, size, value]) => {
  const elements = [...document.querySelectorAll(selector)];
  const before = elements[0].style[size];
  for (const element of elements) element.style[size] = value;
  return before;
}"""


@pytest.fixture(scope="module")
def pages(results, tmp_path_factory):
    """Pages of programs: one with arcs, what it is compared with, and one with a bound."""
    samples = ROOT / "samples"
    arguments = ["compare", str(samples / "pocket.nc"), str(results / "pocket.src"), "-o", str(results)]
    run(*arguments, cell=samples / "cell_kr270.toml", catch_exceptions=False)
    hard = tmp_path_factory.mktemp("looks") / "hard.html"
    result = fabricated.result()
    result = fabricated.with_changes(result, bound=np.full(len(result), 3e-5), after=result.before * 1e-4)
    hard.write_bytes(b"".join(rendered(result, 1e-5)))
    return {
        "corrected": results / "pocket.report.html",
        "predicted": results / "pocket.predict.report.html",
        "compared": results / "pocket.compare.report.html",
        "bounded": hard,
    }


@pytest.mark.parametrize("name", ["corrected", "predicted", "compared", "bounded"])
def test_nothing_is_cut_off_or_written_over_something_else(browser, pages, name):
    """Opened narrow, then made wider: plots are drawn again at each width. What would not fit is noticed."""
    with opened(browser, pages[name], width=WIDTHS[0]) as page:
        for width in WIDTHS:
            page.set_viewport_size({"width": width, "height": 1000})
            page.wait_for_timeout(SETTLED_MS)
            assert faults_of_looks(page) == [], width
        for selector, size, value in PLANTED if name == "corrected" else ():
            before = page.evaluate(_STYLE, [selector, size, value])
            assert faults_of_looks(page) != [], selector
            page.evaluate(_STYLE, [selector, size, before])
            assert faults_of_looks(page) == [], f"{selector} as before"
