"""The pictures of the documentation: reports of samples as Chromium shows them.

python -m tests.documentation.picture [NAME …]        # takes them again, all or those named
"""

from __future__ import annotations

import io
import runpy
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Thread

from click.testing import CliRunner
from PIL import Image

from postproc.app.server import Window
from postproc.cli import main
from tests.documentation.pages import DOCS
from tests.pages.browser import opened, running
from tests.places import CELL_FILE, SAMPLES

PICTURES = DOCS / "pictures"
_DRAWN_MS = 900
_WIDE = 760
"""Pixels across a view in space."""
_STEPS = 10
_FRAME_MS = 150
_STILL_MS = 2500
_COLOURS = 128
"""Pages have few colours: a palette takes a third of the bytes."""


def invoke(*arguments: object) -> None:
    """Run a command of postproc."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output


def screenshot(page: Path, path: Path, width: int, height: int, section: str = "", *, ready: bool = True) -> None:
    """Take the picture of the head of a page, or of one of its sections; a page without plots is not `ready`."""
    with running() as browser, opened(browser, page, width=width, height=height, ready=ready) as opened_page:
        if section:
            opened_page.locator(f"#{section}").scroll_into_view_if_needed()
            opened_page.wait_for_timeout(2000)
            opened_page.locator(f"#{section}").screenshot(path=path)
        else:
            opened_page.screenshot(path=path)
    reduced(path)


def reduced(path: Path) -> None:
    """Store a picture with a palette."""
    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE)
    small.save(path, optimize=True)


def pocket(folder: Path) -> None:
    """Take the head of the report of a pocket."""
    invoke("convert", SAMPLES / "pocket.nc", "--cell", CELL_FILE, "-o", folder)
    screenshot(folder / "pocket.report.html", PICTURES / "pocket.png", 1440, 1560)


def plate(folder: Path) -> None:
    """Take the section "The cut" of a report with computed forces."""
    process = SAMPLES / "plate.process.toml"
    invoke("convert", SAMPLES / "plate.nc", "--cell", CELL_FILE, "--process", process, "-o", folder)
    screenshot(folder / "plate.report.html", PICTURES / "plate.png", 1440, 1560, "cut")


def place(folder: Path) -> None:
    """Take the map of places of a part."""
    region = "X=1000:2600,Y=-900:900,Z=400:1000,A=-90:90"
    forces = SAMPLES / "freeform.forces.csv"
    invoke("place", SAMPLES / "freeform.nc", "--cell", CELL_FILE, "--forces", forces, "--region", region, "-o", folder)
    screenshot(folder / "place.html", PICTURES / "place.png", 1200, 1200, "map")


def identification(folder: Path) -> None:
    """Take the head of the report of an identified model."""
    simulator = runpy.run_path(str(SAMPLES / "paper_study" / "simulator.py"))
    sys.argv = ["simulator.py", str(folder / "demo")]
    simulator["main"]()
    readings, experiment = folder / "demo" / "measurements.csv", folder / "demo" / "experiment.toml"
    invoke("identify", "elastostatics", readings, "--experiment", experiment, "-o", folder / "my_robot")
    screenshot(folder / "my_robot" / "report.html", PICTURES / "identification.png", 1440, 1200)


DEMO = SAMPLES / "demo"


def testpart(folder: Path) -> None:
    """Take the head of the page of a test part."""
    process = ("--process", DEMO / "process.toml", "--features", "8", "--depth", "3")
    invoke("testpart", "--cell", DEMO / "cell.toml", *process, "-o", folder / "out")
    screenshot(folder / "out" / "testpart.html", PICTURES / "testpart.png", 1200, 1120, ready=False)


def testpart_model(folder: Path) -> None:
    """Take the head of the report of a model from a test part, milled by a simulated robot."""
    part = DEMO / "testpart"
    given = ("--process", part / "testpart.process.toml", "--program", part / "testpart.nc")
    invoke("identify", "part", part / "probed.csv", "--cell", DEMO / "cell.toml", *given, "-o", folder / "my_robot")
    screenshot(folder / "my_robot" / "report.html", PICTURES / "testpart-model.png", 1200, 1250)


@dataclass(frozen=True)
class Part:
    """A part of the gallery: its program and how it is converted.

    :param program: below `samples`.
    :param options: of `convert`, files below `samples`.
    :param enlarged: factor by which deviations are drawn.
    """

    program: str
    options: tuple[str, ...]
    enlarged: float


PARTS = {
    "gallery-pocket": Part("pocket.nc", ("--cell", "cell_kr270.toml"), 25),
    "gallery-freeform": Part("freeform.nc", ("--cell", "cell_kr270.toml", "--forces", "freeform.forces.csv"), 30),
    "gallery-drilling": Part(
        "gallery/drilling.nc", ("--cell", "cell_kr270.toml", "--process", "gallery/drilling.process.toml"), 20
    ),
    "gallery-dome": Part("gallery/dome.nc", ("--cell", "gallery/cell_five_axes.toml"), 60),
    "gallery-saddle": Part("gallery/saddle.apt", ("--cell", "cell_kr270.toml"), 60),
    "gallery-long-plate": Part(
        "gallery/long_plate.nc", ("--cell", "cell_kr270.toml", "--process", "gallery/long_plate.process.toml"), 200
    ),
}


def report_of(part: Part, folder: Path) -> Path:
    """Convert a part of the gallery; return its report."""
    options = [option if option.startswith("--") else SAMPLES / option for option in part.options]
    invoke("convert", SAMPLES / part.program, *options, "-o", folder)
    return folder / f"{Path(part.program).stem}.report.html"


def shown(page, *, path: str, enlarged: float) -> Image.Image:
    """Return the view of the path in space with one path enlarged: `b` uncorrected, `a` as written."""
    for box in page.locator("#view3d-controls [data-path]").all():
        box.set_checked(box.get_attribute("data-path") == path)
    page.evaluate(
        """(factor) => {
          const slider = document.getElementById("view3d-enlarged");
          slider.value = Math.log10(factor);
          slider.dispatchEvent(new Event("input", { bubbles: true }));
        }""",
        enlarged,
    )
    page.wait_for_timeout(_DRAWN_MS)
    view = Image.open(io.BytesIO(page.locator("#view3d-view").screenshot())).convert("RGB")
    return view.resize((_WIDE, round(_WIDE * view.height / view.width)), Image.Resampling.LANCZOS)


def gallery(name: str) -> Callable[[Path], None]:
    """Return a function that takes the picture of a part: before correction on the left, after on the right."""

    def take(folder: Path) -> None:
        part = PARTS[name]
        with running() as browser, opened(browser, report_of(part, folder), width=1440, height=1500) as page:
            page.locator("#view3d").scroll_into_view_if_needed()
            page.wait_for_timeout(2000)
            views = [shown(page, path=path, enlarged=part.enlarged) for path in ("b", "a")]
        both = Image.new("RGB", (sum(view.width for view in views), views[0].height), "white")
        both.paste(views[0], (0, 0))
        both.paste(views[1], (views[0].width, 0))
        path = PICTURES / f"{name}.png"
        both.save(path)
        reduced(path)

    return take


def moving(folder: Path) -> None:
    """Take the moving picture: the deviation is enlarged step by step, then the corrected program is shown."""
    part = PARTS["gallery-pocket"]
    factors = [part.enlarged * step / _STEPS + 1e-3 for step in range(_STEPS + 1)]
    with running() as browser, opened(browser, report_of(part, folder), width=1440, height=1500) as page:
        page.locator("#view3d").scroll_into_view_if_needed()
        page.wait_for_timeout(2000)
        frames = [shown(page, path="b", enlarged=max(factor, 1.0)) for factor in factors]
        frames.append(shown(page, path="a", enlarged=part.enlarged))
    palette = frames[_STEPS].quantize(64, dither=Image.Dither.NONE)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    times = [_FRAME_MS] * _STEPS + [_STILL_MS, _STILL_MS]
    small[0].save(
        PICTURES / "pocket.gif", save_all=True, append_images=small[1:], duration=times, loop=0, optimize=True
    )


def app(folder: Path) -> None:
    """Take the window: the set-up of a program, the list with its answers, and a program with its report."""
    parts, results = folder / "parts", folder / "parts" / "corrected"
    results.mkdir(parents=True)
    for name in ("plate.nc", "pocket.nc"):
        shutil.copy(SAMPLES / name, parts / name)
    cell = Path(shutil.copy(CELL_FILE, results / "cell.toml"))
    invoke("convert", parts / "pocket.nc", "--cell", cell, "-o", results)
    pages = {"app-programs": "/", "app-setup": "/setup?name=plate.nc", "app-program": "/program?name=pocket.nc"}
    with Window(parts, 0) as window, running() as browser:
        Thread(target=window.serve_forever, daemon=True).start()
        page = browser.new_page(viewport={"width": 1200, "height": 900})
        page.goto(window.access.address)
        for name, path in pages.items():
            page.goto(f"http://127.0.0.1:{window.access.port}{path}")
            if page.locator("iframe").count():  # nothing is drawn in a report that is not on the screen
                page.locator("iframe").scroll_into_view_if_needed()
                page.frame_locator("iframe").locator(".main-svg").first.wait_for()
                page.wait_for_timeout(_STILL_MS)
            page.screenshot(path=PICTURES / f"{name}.png", full_page=True)
        window.shutdown()
    for name in pages:
        reduced(PICTURES / f"{name}.png")


ALL: dict[str, Callable[[Path], None]] = {
    **{each.__name__: each for each in (pocket, plate, place, identification, moving, app)},
    "testpart": testpart,
    "testpart-model": testpart_model,
    **{name: gallery(name) for name in PARTS},
}


if __name__ == "__main__":
    for name in sys.argv[1:] or list(ALL):
        with tempfile.TemporaryDirectory() as work:
            ALL[name](Path(work))
        print(f"taken: {name}")
