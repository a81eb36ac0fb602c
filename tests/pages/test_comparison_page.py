"""The page of a comparison in a real browser."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from postproc.cli import main
from tests.documentation.pages import ROOT
from tests.pages.browser import needs_chromium, opened

pytestmark = needs_chromium


@pytest.fixture(scope="module")
def compared(results):
    samples = ROOT / "samples"
    arguments = ["compare", str(samples / "pocket.nc"), str(results / "pocket.src"), "-o", str(results)]
    done = CliRunner().invoke(main, [*arguments, "--cell", str(samples / "cell_kr270.toml")], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return results


@pytest.mark.parametrize(("width", "dark"), [(1440, False), (420, True)])
def test_page_draws_its_plots_without_network_and_fits_the_screen(browser, compared, width, dark):
    content = json.loads((compared / "pocket.compare.report.json").read_text(encoding="utf-8"))
    with opened(browser, compared / "pocket.compare.report.html", width=width, dark=dark) as page:
        assert page.locator("#view3d canvas").count() > 0
        assert page.locator("#along .main-svg").count() >= 2
        assert f"{content['offset']['max_mm']:.4f}" in page.locator("#numbers").inner_text()
        lines = page.locator("#worst [data-source-line]")
        assert lines.first.get_attribute("data-source-line") == str(content["largest"][0]["nominal_line"])
        assert page.evaluate("document.documentElement.scrollWidth") <= width
