"""Every kind of part and plot of the kit in a real browser."""

from __future__ import annotations

import base64
import re

import numpy as np

from postproc.report.kit import (
    Axis,
    Bars,
    Cell,
    Curve,
    Facts,
    Fold,
    Histogram,
    Lines,
    Map,
    Mark,
    Matrix,
    Note,
    Notes,
    Page,
    Plot,
    Points,
    Row,
    Section,
    Span,
    Table,
    Tile,
    Tiles,
    Verdict,
)
from postproc.report.kit.parts import PlotItem
from tests.html_page import read_page
from tests.pages.browser import needs_chromium, opened

pytestmark = needs_chromium
_NAN = float("nan")
PLOTS: tuple[Plot, ...] = (
    Plot(
        label="curves",
        traces=[Curve([1, 2, 3], [1.0, 4.0, 9.0], "a", "before", dots=True), Span([1, 2], [0.5, 1], [2, 3])],
        y=Axis(logarithmic=True, title="mm"),
        marks=[Mark(2.0, "limit", "soft", level=True)],
    ),
    Plot(
        label="intervals",
        traces=[Points([0.0, 0.0], [0.0, 1.0], "v", "after", half=[3.0, None], across=True, texts=["k1 <b>", "k2"])],
        y=Axis(categories=["k1", "k2"]),
    ),
    Plot(label="bars", traces=[Bars([1.0, 2.0], ["one", "two"], [True, False])], y=Axis(categories=["x", "y"])),
    Plot(label="counts", traces=[Histogram([0.0, 1.0, 2.0], [3, 4], "n")], marks=[Mark(1.2, "here", "after")]),
    Plot(label="matrix", traces=[Matrix(["k1", "k2"], [[1.0, -0.5], [-0.5, 1.0]])]),
    Plot(
        label="space",
        traces=[
            Lines([0, 1, _NAN], [0, 1, _NAN], [0, 1, _NAN], "a", "after"),
            Lines([0], [0], [1], "b", "ink", dots=True),
        ],
        steps=[[0, 1], [1]],
        step_names=["all", "b"],
    ),
    Plot(
        label="map",
        traces=[
            Map([0.0, 1.0], [0.0, 1.0], [[1.0, None], [2.0, None]], [[0, 1], [0, 2]], ("free", "far", "fast"), "mm"),
            Curve([0.0, 1.0], [0.0, 1.0], "line", "warning"),
        ],
    ),
)


def _page():
    table = Table(("Name", "Value"), (Row(("b", "2.0")), Row((Cell("a", "good"), Cell("10.0")))), "t", sortable=True)
    parts = (
        Verdict("failed", "No.", "<i>Never</i>."),
        Tiles((Tile("a", "1", "mm", "note"),)),
        Facts((("a", Cell("1", "warning")),)),
        Notes((Note("one", "good"), Note("two")), "Title", bulleted=True),
        Fold("more", (table,)),
    )
    sections = (Section("parts", "Parts", parts), *(Section(f"plot{i}", p.label, (p,)) for i, p in enumerate(PLOTS)))
    return b"".join(Page("Kind", "Title <x>", "subtitle", sections).render())


def test_every_kind_of_plot_is_among_those_drawn():
    kinds = {type(trace) for plot in PLOTS for trace in plot.traces}
    assert kinds == set(PlotItem.__args__)


def test_every_part_is_shown_and_every_plot_drawn(browser, tmp_path):
    content = _page()
    read = read_page(content)
    assert "<i>Never</i>." in read.text("parts")
    path = tmp_path / "page.html"
    path.write_bytes(content)
    with opened(browser, path) as page:
        page.wait_for_function("document.querySelectorAll('.plot .main-svg').length >= 6")
        page.locator("summary").click()
        page.get_by_role("button", name="Value").click()
        assert page.locator("#parts tbody th").all_inner_texts() == ["a", "b"]
        assert page.locator("#plot4").get_by_text(re.compile("[−-]0.50")).count() == 2
        assert page.locator("#plot2").get_by_text("two").count() == 1
        assert page.locator("#plot1").get_by_text("k2").count() == 1
        assert page.locator("#plot5 canvas").count() >= 1
        assert page.locator("#plot6 .legendtext").all_text_contents() == ["far", "fast", "line"]


def test_a_page_without_plots_is_small(tmp_path):
    section = Section("notes", "Notes", (Notes((Note("nothing else"),)),))
    assert len(b"".join(Page("Kind", "Title", "", (section,)).render())) < 20_000


def test_marks_and_pointing_meet_the_line_that_the_library_drew(browser, tmp_path):
    """The ends of a line, seen in a picture of the page, are where the marks are and where the pointer finds them."""
    line = Lines([-40.0, 25.0], [10.0, 60.0], [0.0, 30.0], "", "before", width=6.0, places=[0, 1])
    box = Lines([-90.0, 90.0], [-80.0, 80.0], [-60.0, 60.0], "", "soft", width=0.1)
    plot = Plot(label="a line", traces=[box, line], unit="mm", height=500)
    path = tmp_path / "page.html"
    path.write_bytes(b"".join(Page("Kind", "Title", "", (Section("plot", "Plot", (plot,)),)).render()))
    with opened(browser, path) as page:
        view = page.locator(".plot").first
        for turned in ("ArrowRight", "ArrowUp", "+"):
            page.evaluate("selection.choose(null)")
            view.focus()
            page.keyboard.press(turned)
            _shown(page)
            ends = _ends_of_colour(page, "#b4451f")
            corner = page.locator(".plot .gl-container").bounding_box()
            for place in (0, 1):
                page.evaluate("(place) => selection.choose(place)", place)
                _shown(page)
                mark = page.locator("svg.over circle").last
                seen = np.array([corner[by] + float(mark.get_attribute(f"c{by}")) for by in "xy"])
                apart = np.linalg.norm(ends - seen, axis=1)
                assert apart.min() < 5.0, (turned, place, ends, seen)
                page.mouse.move(corner["x"] + 3, corner["y"] + 3)
                page.evaluate("selection.choose(null)")
                page.mouse.move(*(0.9 * ends[apart.argmin()] + 0.1 * ends[apart.argmax()]))
                page.wait_for_function("(place) => selection.place === place", arg=place)


def _shown(page):
    """Wait until what was asked for is on the screen."""
    for _ in range(4):
        page.evaluate("new Promise((next) => requestAnimationFrame(() => setTimeout(next, 50)))")


_PIXELS = """async ([picture, colour]) => {
  const image = new Image();
  image.src = `data:image/png;base64,${picture}`;
  await image.decode();
  const canvas = Object.assign(document.createElement('canvas'), {width: image.width, height: image.height});
  const context = canvas.getContext('2d');
  context.drawImage(image, 0, 0);
  const { data } = context.getImageData(0, 0, image.width, image.height);
  const found = [];
  for (let k = 0; k < data.length / 4; k++)
    if (colour.every((value, c) => Math.abs(data[4 * k + c] - value) < 40))
      found.push([k % image.width, Math.floor(k / image.width)]);
  return found;
}"""


def _ends_of_colour(page, colour):
    """The two pixels of a colour that are farthest apart in a picture of the page: (2, 2), across and down."""
    picture = base64.b64encode(page.screenshot()).decode()
    points = np.array(page.evaluate(_PIXELS, [picture, [int(colour[k : k + 2], 16) for k in (1, 3, 5)]]), dtype=float)
    assert len(points) > 50
    along = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][0]
    order = np.argsort(points @ along)
    return points[order[[0, -1]]]
