"""The report of a program in a real browser: linked views, keys, numbers."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import re

import numpy as np
import pytest

from postproc.report import page as rendered
from postproc.report.formatting import estimate_text
from tests import fabricated
from tests.pages.browser import needs_chromium, opened, without_webgl
from tests.places import SAMPLES

pytestmark = needs_chromium
IDS = ("verdict", "view3d", "along", "histogram", "worst", "place", "issues")


def _chosen(page):
    """Source line of the chosen place as the details tell it."""
    page.wait_for_timeout(60)
    return int(page.locator("#place dd").first.inner_text())


_COLOURS = """(canvas) => new Set(new Uint32Array(
  canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.buffer)).size"""


def _targets(results):
    with (results / "pocket.targets.csv").open(encoding="utf-8") as file:
        return [{name: float(text or "nan") for name, text in row.items()} for row in csv.DictReader(file)]


def _camera(page):
    return page.evaluate("document.getElementById('view3d-view')._fullLayout.scene.camera.eye")


def test_it_opens_from_disk_and_has_every_part(page):
    assert page.title() == "pocket.nc: deviation report"
    for name in IDS:
        assert page.locator(f"#{name}").count() == 1
    assert page.locator("#view3d canvas").count() >= 1
    assert page.locator("#along .main-svg").count() >= 1


@pytest.mark.parametrize("wrong", ["<script>nothing.of(this)</script>", "<img src='https://example.com/picture.png'>"])
def test_a_page_that_complains_or_loads_something_would_be_noticed(browser, tmp_path, wrong):
    (tmp_path / "wrong.html").write_text(f"<html><body>{wrong}</body></html>", encoding="utf-8")
    with pytest.raises(AssertionError), opened(browser, tmp_path / "wrong.html", ready=False) as page:
        page.wait_for_timeout(200)


def test_its_numbers_are_those_of_the_report(page, results):
    report = json.loads((results / "pocket.report.json").read_text(encoding="utf-8"))
    text = page.locator("#numbers").inner_text()
    for key in ("max_mm", "rms_mm", "mean_mm", "p95_mm"):
        assert estimate_text(report["before"][key], report["u95"]["max_mm"]) in text
    assert all(reason[1:] in page.locator("#verdict").text_content() for reason in report["verdict"]["reasons"])
    cutting = [row for row in _targets(results) if not row["rapid"]]
    at = page.evaluate("({before: Array.from(places.at.before), after: Array.from(places.at.after), "
                       "rapid: Array.from(places.at.rapid)})")  # fmt: skip
    for key in ("before", "after"):
        shown = np.array(at[key])[np.array(at["rapid"]) == 0]
        assert shown.max() == pytest.approx(report[key]["max_mm"], rel=1e-6)
        np.testing.assert_allclose(shown, [row[f"{key}_mm"] for row in cutting], atol=6e-7)


def test_every_target_is_there_with_its_joints_forces_and_command(page, results):
    names = {"X": "X", "Y": "Y", "Z": "Z", "Fx": "Fx", "Fz": "Fz", "A1": "A1", "A5": "A5", "source_line": "source_line"}
    at = page.evaluate("(names) => Object.fromEntries(names.map((n) => [n, Array.from(places.at[n])]))", list(names))
    rows = _targets(results)
    for name, column in names.items():
        np.testing.assert_allclose(at[name], [row[column] for row in rows], atol=6e-4, err_msg=name)
    moved = page.evaluate("['X','Y','Z'].map((a) => Array.from(places.at['c' + a]))")
    np.testing.assert_allclose(moved[1], [row["Y_cmd"] - row["Y"] for row in rows], atol=1e-5)


def test_the_worst_place_is_chosen_at_first_and_told_in_full(page, results):
    page.keyboard.press("Home")
    page.locator("#place-controls [data-go=worst]").click()
    worst = max(_targets(results), key=lambda row: row["before_mm"])
    assert _chosen(page) == worst["source_line"]
    text = page.locator("#place").inner_text()
    assert f"{worst['before_mm']:.4f} mm" in text
    assert f"{worst['Fx']:.1f}, {worst['Fy']:.1f}, {worst['Fz']:.1f} N" in text
    assert f"{worst['A2']:.2f}°" in text


def test_the_mouse_and_the_keys_turn_the_path(page):
    before = _camera(page)
    box = page.locator("#view3d-view").bounding_box()
    page.locator("#view3d-view").scroll_into_view_if_needed()
    box = page.locator("#view3d-view").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] + 120, middle[1] + 10, steps=6)
    page.mouse.up()
    page.wait_for_timeout(300)
    turned = _camera(page)
    assert math.dist(before.values(), turned.values()) > 0.1

    def azimuth():
        eye = _camera(page)
        return math.degrees(math.atan2(eye["y"], eye["x"]))

    page.locator("#view3d-view").focus()
    start = azimuth()
    page.keyboard.press("ArrowRight")
    page.wait_for_timeout(100)
    assert (azimuth() - start) % 360 == pytest.approx(10.0, abs=0.1)
    far = math.hypot(*_camera(page).values())
    page.keyboard.press("+")
    page.wait_for_timeout(100)
    assert math.hypot(*_camera(page).values()) == pytest.approx(far / 1.2)
    page.get_by_role("button", name="Top").click()
    page.wait_for_timeout(100)
    assert _camera(page)["z"] > 2.0


def test_the_path_is_coloured_by_what_is_asked_for(page, results):
    page.locator("#view3d-colour").select_option("force")
    page.wait_for_timeout(200)
    shown = page.evaluate(
        "(() => { const {line} = document.getElementById('view3d-view').data[0];"
        "return [Array.from(line.color), line.cmax, document.querySelector('#view3d .colours text').textContent] })()"
    )
    largest = max(math.hypot(row["Fx"], row["Fy"], row["Fz"]) for row in _targets(results) if not row["rapid"])
    assert max(shown[0]) == shown[1] == pytest.approx(largest, rel=1e-5)
    assert shown[2] == "Force, N"
    page.locator("#view3d-colour").select_option("before")


def test_the_deviation_is_enlarged_by_the_factor_shown(page, results):
    slider = page.locator("#view3d-enlarged")
    as_it_was = slider.input_value()
    slider.fill("2")
    page.wait_for_timeout(200)
    assert page.locator("#view3d-factor").inner_text() == "100 ×"
    rows = {(round(row["X"], 2), round(row["Y"], 2), round(row["Z"], 2)): row for row in _targets(results)}
    nominal, enlarged = page.evaluate(
        "(() => { const {data} = document.getElementById('view3d-view'); "
        "return [0, 2].map((i) => data[i].x.map((x, k) => [x, data[i].y[k], data[i].z[k]])"
        ".filter((p) => p[0] !== null)) })()"
    )
    ends = page.evaluate("Array.from(columns.drawn.place).map((p) => [p, places.at.rapid[p], places.at.bX[p]])")
    assert len(enlarged) == sum(not rapid for _, rapid, _ in ends)
    drawn = [
        tuple(p)
        for p in page.evaluate("Array.from(columns.drawn.x).map((x, k) => [x, columns.drawn.y[k], columns.drawn.z[k]])")
    ]
    cutting = [(point, entry) for point, entry in zip(drawn, ends, strict=True) if not entry[1]]
    checked = 0
    for (point, (_, _, off)), shifted in zip(cutting, enlarged, strict=True):
        row = rows.get(tuple(round(value, 2) for value in point))
        if row is not None:  # a target, not a point of an arc between
            assert shifted[0] - point[0] == pytest.approx(100 * off, abs=2e-3)
            checked += 1
    assert checked > 300
    slider.fill(as_it_was)
    assert len(nominal) > len(enlarged)


def test_pointing_at_the_path_shows_a_place_and_a_click_keeps_it(page):
    page.get_by_role("button", name="Oblique").click()
    _pointing_finds_a_place(page)


def _pointing_finds_a_place(page):
    page.locator("#view3d-view").scroll_into_view_if_needed()
    box = page.locator("#view3d-view").bounding_box()
    page.evaluate("selection.choose(0)")
    for across in np.linspace(0.25, 0.65, 60):
        page.mouse.move(box["x"] + across * box["width"], box["y"] + 0.68 * box["height"])
        page.evaluate("new Promise((next) => requestAnimationFrame(() => requestAnimationFrame(next)))")
        if page.evaluate("selection.place"):
            break
    for _ in range(5):  # on a busy machine the view is still drawn, and turns, while the button is pressed
        page.wait_for_timeout(300)
        pointed = page.evaluate("selection.place")
        page.mouse.down()
        page.mouse.up()
        page.wait_for_timeout(300)
        if pointed and page.evaluate("selection.chosen") == pointed:
            break
    assert pointed
    assert page.evaluate("selection.chosen") == pointed
    assert _chosen(page) == page.evaluate("(i) => places.at.source_line[i]", pointed)


def test_a_click_on_the_plot_shows_the_place_there(page):
    page.wait_for_function("stage.empty")  # what is drawn later moves what is below it
    page.locator("#along-view").scroll_into_view_if_needed()
    box = page.locator("#along-view .nsewdrag").first.bounding_box()
    at = box["x"] + 0.4 * box["width"], box["y"] + box["height"] / 2
    page.mouse.move(*at)
    page.wait_for_timeout(150)
    page.mouse.down()
    page.mouse.up()
    page.wait_for_timeout(400)
    axis = page.evaluate("document.getElementById('along-view')._fullLayout.xaxis.range")
    wanted = axis[0] + 0.4 * (axis[1] - axis[0])
    found = page.evaluate("places.at.length[selection.chosen]")
    assert found == pytest.approx(wanted, abs=0.02 * axis[1])
    line = page.locator("#along-view .cursor")
    assert float(line.get_attribute("data-x")) == pytest.approx(found)
    assert line.bounding_box()["x"] == pytest.approx(at[0], abs=0.02 * box["width"])
    dot = page.locator("#view3d circle").last.get_attribute("data-at").split()
    wanted = page.evaluate("['X', 'Y', 'Z'].map((axis) => places.at[axis][selection.chosen])")
    np.testing.assert_allclose([float(value) for value in dot], wanted, atol=1e-3)


def test_the_keys_step_along_the_path(page):
    page.evaluate("selection.choose(100)")
    page.locator("#along-view").focus()
    page.keyboard.press("ArrowRight")
    assert page.evaluate("selection.chosen") == 101
    page.keyboard.press("Shift+ArrowRight")
    assert page.evaluate("selection.chosen") == 111


def test_plots_run_over_time_too(page):
    page.locator("#along-over").select_option("time")
    page.wait_for_timeout(200)
    x = page.evaluate("document.getElementById('along-view').data[0].x")
    assert x[-1] == pytest.approx(page.evaluate("places.at.time[places.count - 1]"))
    page.locator("#along-over").select_option("length")


def test_a_row_of_the_worst_chooses_its_place_by_click_and_by_key(page):
    rows = page.locator("#worst tbody tr")
    rows.nth(3).click()
    assert _chosen(page) == int(rows.nth(3).get_attribute("data-source-line"))
    rows.nth(5).focus()
    page.keyboard.press("Enter")
    assert _chosen(page) == int(rows.nth(5).get_attribute("data-source-line"))
    assert "chosen" in rows.nth(5).get_attribute("class")


def test_the_worst_are_sorted_by_any_column(page):
    head = page.locator("#worst thead th", has_text="Source line")
    head.locator("button").click()
    lines = [int(row.get_attribute("data-source-line")) for row in page.locator("#worst tbody tr").all()]
    assert head.get_attribute("aria-sort") == "descending"
    assert lines == sorted(lines, reverse=True)
    assert len(set(lines)) > 5
    head.locator("button").focus()
    page.keyboard.press("Enter")
    lines = [int(row.get_attribute("data-source-line")) for row in page.locator("#worst tbody tr").all()]
    assert lines == sorted(lines)


def test_a_bar_of_the_histogram_chooses_its_worst_place(page):
    low, high = page.evaluate(
        "(() => { const v = document.getElementById('histogram-view');"
        "const k = v.data[0].y.indexOf(Math.max(...v.data[0].y));"
        "v.emit('plotly_click', {points: [{curveNumber: 0, customdata: v.data[0].customdata[k]}]});"
        "return v.data[0].customdata[k] })()"
    )
    value = page.evaluate("places.at.before[selection.chosen]")
    assert low <= value <= high
    within = page.evaluate("Array.from(places.at.before)")
    assert value == max(each for each in within if low <= each <= high)


def test_a_line_can_be_asked_for(page):
    page.locator("#place-line").fill("57")
    page.keyboard.press("Enter")
    assert _chosen(page) == 57


def test_a_line_without_a_target_leads_to_the_nearest_and_says_so(page):
    page.locator("#place-line").fill("3")
    page.keyboard.press("Enter")
    lines = set(page.evaluate("Array.from(places.at.source_line)"))
    nearest = min(lines, key=lambda line: abs(line - 3))
    assert 3 not in lines
    assert _chosen(page) == nearest
    assert page.locator("#place .said").inner_text() == f"no target on line 3: nearest is line {nearest}"
    page.locator("#place-line").fill("57")
    page.keyboard.press("Enter")
    assert page.locator("#place .said").inner_text() == ""


def test_after_a_click_the_keys_are_heard(page):
    page.locator("#view3d-view").scroll_into_view_if_needed()
    box = page.locator("#view3d-view").bounding_box()
    page.mouse.click(box["x"] + 5, box["y"] + 40)
    assert page.evaluate("document.activeElement.id") == "view3d-view"
    page.keyboard.press("w")
    assert page.evaluate("selection.chosen") == page.evaluate("facts.worst.before")


_SIZE = """(() => {
  const { glplot } = document.getElementById('view3d-view')._fullLayout.scene._scene;
  const { projection, view, model } = glplot.cameraParams;
  const { dataScale } = document.getElementById('view3d-view')._fullLayout.scene._scene;
  const times = (a, b) => Array.from({ length: 16 }, (_, k) =>
    [0, 1, 2, 3].reduce((sum, j) => sum + a[4 * j + (k % 4)] * b[4 * (k >> 2) + j], 0));
  const m = times(projection, times(view, model)).map((value, k) => value * (k < 12 ? dataScale[k >> 2] : 1));
  const at = (p) => [0, 1, 3].map((r) => m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r]);
  return [[40, 35, 0], [80, 65, 0], [60, 50, 50]].map((p) => { const [x, y, w] = at(p); return [x / w, y / w]; });
})()"""


def test_the_path_keeps_its_size_and_place_when_the_robot_is_shown(page):
    page.get_by_role("button", name="Oblique").click()
    page.wait_for_timeout(300)
    without = page.evaluate(_SIZE)
    page.locator("#view3d-robot").check()
    page.wait_for_timeout(600)
    np.testing.assert_allclose(page.evaluate(_SIZE), without, atol=2e-3)
    page.locator("#view3d-robot").uncheck()
    page.wait_for_timeout(600)
    np.testing.assert_allclose(page.evaluate(_SIZE), without, atol=2e-3)


def test_a_slider_moves_the_robot_along_the_program(page):
    page.locator("#view3d-robot").check()
    slider = page.locator("#view3d-time")
    tips = []
    for share in ("0.2", "0.9"):
        slider.fill(share)
        page.wait_for_timeout(400)
        chosen, time, last = page.evaluate(
            "[selection.chosen, places.at.time[selection.chosen], places.at.time.at(-1)]"
        )
        assert time == pytest.approx(float(share) * last, abs=0.02 * last)
        mesh = page.evaluate("(() => { const d = document.getElementById('view3d-view').data.at(-1);"
                             "return [d.type, d.x.length, d.x.at(-1), d.y.at(-1), d.z.at(-1)] })()")  # fmt: skip
        assert mesh[0] == "mesh3d"
        place = page.evaluate("(i) => places.position(i)", chosen)
        assert math.dist(mesh[2:], place) < 12.0  # the rim of the cone's end
        tips.append(place)
    assert math.dist(*tips) > 10.0
    run = page.locator("#view3d-run")
    slider.fill("0.1")
    run.click()
    page.wait_for_timeout(700)
    run.click()
    stopped = page.evaluate("selection.chosen")
    assert page.evaluate("places.at.time[selection.chosen] / places.at.time.at(-1)") > 0.105
    page.wait_for_timeout(200)
    assert page.evaluate("selection.chosen") == stopped
    page.locator("#view3d-robot").uncheck()


def test_a_browser_that_cannot_inflate_unpacks_the_library_itself(browser, results, tmp_path):
    content = (results / "pocket.report.html").read_text(encoding="utf-8")
    assert len(content) < 2_600_000
    old = tmp_path / "old.html"
    old.write_text(content.replace("<body>", "<body><script>delete window.DecompressionStream</script>", 1), "utf-8")
    with opened(browser, old) as page:
        assert page.evaluate("typeof DecompressionStream") == "undefined"
        assert page.evaluate("typeof Plotly.react") == "function"


@pytest.fixture(scope="module")
def phone(browser, results):
    """The report on the screen of a phone."""
    with opened(browser, results / "pocket.report.html", width=420, height=900) as page:
        yield page


def test_on_a_phone_the_place_is_folded_until_it_is_asked_for(phone, page):
    button = phone.locator("aside h2 button")
    assert not phone.locator("#place-view").is_visible()
    assert phone.locator("#place-controls").is_visible()
    assert phone.locator("aside").bounding_box()["height"] < 130
    button.click()
    assert phone.locator("#place-view").is_visible()
    button.click()
    assert not phone.locator("#place-view").is_visible()
    assert page.locator("#place-view").is_visible()
    assert not page.locator("aside h2 button").is_visible()


def test_the_keyboard_reaches_everything(page):
    reached = set()
    page.locator("h1").click()
    for _ in range(120):
        page.keyboard.press("Tab")
        reached |= set(page.evaluate(
            "(() => { const e = document.activeElement; return [e.id, e.closest('section')?.id ?? ''] })()"
        ))  # fmt: skip
    assert {
        "view3d-view",
        "view3d-colour",
        "view3d-enlarged",
        "along-view",
        "along-over",
        "worst",
        "place-line",
    } <= reached


def test_every_picture_has_a_text_alternative(page):
    for view in page.locator("[role=img], [role=group], #view3d-view, #along-view, #histogram-view").all():
        assert len(view.get_attribute("aria-label")) > 20
    assert page.locator("table:not(:has(caption))").count() == 0


def test_what_is_not_drawn_yet_says_so(page):
    assert not page.locator(".waiting").count()
    assert page.evaluate(
        "(() => { const e = document.createElement('div'); document.body.append(e); stage.add(e, () => e.remove());"
        "return [e.className, getComputedStyle(e, '::before').content] })()"
    ) == ["waiting", '"is drawn in a moment"']
    assert page.evaluate(
        "(() => { const e = document.getElementById('histogram-view').cloneNode(); e.classList.add('waiting');"
        "document.body.append(e); const height = e.offsetHeight; e.remove(); return height })()"
    ) >= 2 * page.evaluate("parseFloat(getComputedStyle(document.body).fontSize)")  # the text is above the caption


@pytest.mark.parametrize("dark", [False, True])
def test_a_phone_shows_it_without_scrolling_sideways(phone, dark):
    phone.emulate_media(color_scheme="dark" if dark else "light")
    phone.wait_for_timeout(300)
    assert phone.evaluate("document.documentElement.scrollWidth") <= 420
    back = phone.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (sum(json.loads(back.replace("rgb(", "[").replace(")", "]"))) < 200) == dark
    ticks = phone.evaluate("document.querySelector('#along .xtick text').style.fill")
    assert ticks == phone.evaluate(
        "(() => { const e = document.createElement('i'); e.style.color = theme.colour('soft');return e.style.color })()"
    )


def test_on_paper_the_path_is_there_with_what_was_chosen_for_it(browser, results):
    with opened(browser, results / "pocket.report.html", dark=True) as page:
        assert len(page.pdf(format="A4")) > 50_000
        page.emulate_media(media="print")
        told = page.locator("#view3d-controls label").filter(visible=True).all_inner_texts()
        assert [" ".join(text.split()) for text in told[1:]] == ["tool without correction", "commanded path", "by 20 ×"]
        assert page.locator("#view3d-colour").input_value() == "before"
        assert not page.locator("#view3d-controls").locator("button, input").filter(visible=True).count()
        picture = page.locator("#view3d img.only-print")
        assert picture.is_visible()
        assert picture.evaluate("(image) => image.naturalWidth") > 300


def test_on_paper_it_is_a_record_of_two_sheets(page):
    sheets = page.pdf(format="A4", prefer_css_page_size=True)
    page.emulate_media(media="print")
    assert re.findall(rb"/Type /Pages.*?/Count (\d+)", sheets, re.S) == [b"2"]
    for shown in ("verdict", "view3d", "numbers", "worst", "record"):
        assert page.locator(f"#{shown}").is_visible()
    assert not page.locator(".hint, #along, #source-view").filter(visible=True).count()
    page.emulate_media(media="screen")


def test_the_program_is_beside_the_path_and_line_and_place_lead_to_each_other(page):
    text = (SAMPLES / "pocket.nc").read_text().splitlines()
    page.evaluate("selection.choose(facts.worst.before)")
    chosen = page.locator("#source-view .chosen")
    line = page.evaluate("places.at.source_line[selection.chosen]")
    assert chosen.get_attribute("data-line") == str(line)
    assert chosen.evaluate("(row) => row.lastChild.textContent") == text[line - 1]
    page.locator("#source-view").evaluate("(view) => { view.scrollTop = 0; }")
    page.wait_for_timeout(200)
    first_row = page.locator("#source-view .leads").first
    number = int(first_row.get_attribute("data-line"))
    first_row.click()
    assert page.evaluate("places.at.source_line[selection.chosen]") == number != line
    page.evaluate("selection.choose(facts.worst.before)")
    page.wait_for_timeout(200)
    assert chosen.is_visible()
    assert int(chosen.get_attribute("data-line")) == line
    page.locator("#source-view").press("ArrowUp")
    assert page.evaluate("places.at.source_line[selection.chosen]") < line


def test_the_picture_is_on_the_first_screen_also_after_printing(page):
    page.pdf(format="A4")
    page.evaluate("scrollTo(0, 0)")
    box = page.locator("#view3d-view").bounding_box()
    assert box["y"] + 0.5 * box["height"] < 900


def test_the_record_states_when_with_what_and_for_whom(page, results):
    report = json.loads((results / "pocket.report.json").read_text(encoding="utf-8"))
    assert report["program"]
    told = page.locator("#record").inner_text()
    digits = hashlib.sha256((SAMPLES / "pocket.nc").read_bytes()).hexdigest()[:16]
    assert digits in told
    assert "cell_kr270.toml" in told


def test_a_prediction_has_the_same_page_with_one_deviation(browser, results):
    with opened(browser, results / "pocket.predict.report.html") as page:
        text = page.locator("body").inner_text()
        assert "after" not in page.locator("#worst").inner_text().lower()
        assert "Predicted deviation" in text
        assert page.locator("#view3d-colour option").all_inner_texts()[0] == "Predicted deviation"
        assert page.evaluate("Object.keys(facts.histograms)") == ["before"]


def test_of_50_000_targets_the_worst_is_drawn(browser, tmp_path):
    """Six times as many as the view draws."""
    base = fabricated.result(50_000)
    before = base.before.copy()
    before[31_457] = 5e-3
    path = tmp_path / "large.html"
    path.write_bytes(b"".join(rendered(fabricated.with_changes(base, before=before), 1e-5)))
    with opened(browser, path) as page:
        assert _chosen(page) == 31_457 + 3
        colours = page.evaluate("document.getElementById('view3d-view').data[0].line.color")
        assert max(colours) == pytest.approx(5.0)
        curve = page.evaluate("document.getElementById('along-view').data[0].y")
        assert max(value for value in curve if value is not None) == pytest.approx(5.0)
        assert len(curve) < 4_000


_MARKS = """[...document.querySelectorAll('#view3d .over :is(circle, text)')]
  .map((mark) => ['x', 'y'].map((axis) => Number(mark.getAttribute(axis) ?? mark.getAttribute('c' + axis))))"""


def test_a_browser_that_cannot_draw_in_space_shows_the_path_and_where_it_is_worst(browser, results, page):
    """The sketch is all there is, seen as the library shows it; it is pointed at and turned."""
    page.get_by_role("button", name="Oblique").click()
    page.evaluate("selection.choose(facts.worst.before)")
    page.wait_for_timeout(300)
    drawn = page.evaluate(_MARKS)
    assert page.locator("#view3d .sketch").count() == 0
    with without_webgl(browser) as other, opened(other, results / "pocket.report.html") as page:
        assert page.locator("#view3d .sketch").is_visible()
        np.testing.assert_allclose(page.evaluate(_MARKS), drawn, atol=0.6)
        assert len(drawn) > 20
        _pointing_finds_a_place(page)
        before = page.evaluate(_MARKS)
        box = page.locator("#view3d-view").bounding_box()
        page.mouse.move(box["x"] + 300, box["y"] + 200)
        page.mouse.down()
        page.mouse.move(box["x"] + 400, box["y"] + 210, steps=5)
        page.mouse.up()
        page.wait_for_timeout(100)
        after = page.evaluate(_MARKS)  # other numbers may be in sight
        assert len(after) != len(before) or abs(np.subtract(after, before)).max() > 20.0
        colours = page.locator("#view3d .sketch").evaluate(_COLOURS)
        assert colours > 20
