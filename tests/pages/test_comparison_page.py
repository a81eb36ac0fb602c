"""The page of a comparison in a real browser."""

from __future__ import annotations

import json

import pytest

from tests.commands import run
from tests.pages.browser import needs_chromium, opened
from tests.places import ROOT

pytestmark = needs_chromium


@pytest.fixture(scope="module")
def compared(results):
    samples = ROOT / "samples"
    arguments = ["compare", str(samples / "pocket.nc"), str(results / "pocket.src"), "-o", str(results)]
    run(*arguments, cell=samples / "cell_kr270.toml", catch_exceptions=False)
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
        assert page.locator("#along .xtitle").all_text_contents() == ["pair of targets, in the order of pocket.nc"] * 2
        _all_views_show_the_place_of_a_row(page)
        if width > 1000:
            _keys_and_clicks_choose_a_place(page)
            page.emulate_media(media="print")
            assert len(page.pdf(format="A4")) > 30_000
            assert page.locator("#view3d img.only-print").evaluate("(image) => image.naturalWidth") > 300


_SHOWN = """(line) => {
  const plots = [...document.querySelectorAll('#along .plot')];
  const dot = Number([...document.querySelectorAll('#view3d circle')].at(-1).dataset.at.split(' ')[0]);
  return plots.length === 2
    && plots.every((plot) => Number(plot.querySelector('.cursor')?.dataset.x) === selection.chosen + 1)
    && Math.abs(dot - columns.places.X[selection.chosen]) < 1e-3
    && columns.places.nominal_line[selection.chosen] === line
    && document.querySelector('#place dd').textContent === String(line);
}"""


_POINT_OF_LINE_100 = """(() => {
  const { data: [curve], _fullLayout: { xaxis, yaxis } } = document.querySelector('#along .plot');
  const place = columns.places.nominal_line.indexOf(100);
  return [xaxis._offset + xaxis.l2p(curve.x[place]), yaxis._offset + yaxis.l2p(curve.y[place])];
})()"""


def _all_views_show_the_place_of_a_row(page):
    row = page.locator("#worst tbody tr").nth(4)
    row.click()
    page.wait_for_function(_SHOWN, arg=int(row.get_attribute("data-source-line")), timeout=10_000)


def _keys_and_clicks_choose_a_place(page):
    plot = page.locator("#along .plot").first
    plot.focus()
    before = page.evaluate("selection.chosen")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowRight")
    assert page.evaluate("selection.chosen") == before + 11
    across, down = page.evaluate(_POINT_OF_LINE_100)
    box = plot.bounding_box()
    page.mouse.move(box["x"] + across, box["y"] + down)
    page.wait_for_timeout(150)
    page.mouse.down()
    page.mouse.up()
    page.wait_for_timeout(400)
    assert page.evaluate("columns.places.nominal_line[selection.chosen]") == 100
    page.evaluate("(() => { const e = document.querySelector('#histogram .plot');"
                  "e.emit('plotly_click', {points: [{customdata: e.data[0].customdata.at(-1)}]}) })()")  # fmt: skip
    assert page.evaluate("selection.chosen") == page.evaluate("facts.worst")
