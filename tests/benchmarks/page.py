"""How soon the report of a large program can be used: size, and seconds from navigation, in headless Chromium.

Run: python -m tests.benchmarks.page [--targets N] [--repeats N]

A finishing pass is converted, and compared with what it became; both pages are opened from disk, 1440 × 1000 pixels,
drawn by the processor. Printed are, of the quickest of some openings, seconds since navigation by the clock, and the
processor time of all processes of the browser up to there, which other work on the machine changes less:

- text: the verdict can be read;
- rows: a click on a row of the worst shows its place;
- picture: the path in space is seen, coloured, with its worst places;
- path: a click on the path in space shows the place there;
- turn: the mouse has turned it;
- all: all views are drawn by the library.

The browser paints by the processor, as it does on a machine without a graphics card; with one it is sooner.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

from click.testing import CliRunner

from postproc.cli import main as postproc
from tests.benchmarks import programs
from tests.pages.browser import running
from tests.places import CELL_FILE

_HZ = 100.0
_POLLED_MS = 20
_TEXT = "performance.getEntriesByName('first-contentful-paint').length > 0"
_ROWS = """typeof stage !== 'undefined' && (() => {
  const row = document.querySelector('#worst tbody tr:nth-child(3)');
  row.click();
  return document.querySelector('#place dd')?.textContent === row.dataset.sourceLine;
})()"""
_PICTURE = "document.querySelector('#view3d svg.over circle') !== null"
_MARK = "document.querySelector('#view3d svg.over circle').getAttribute('cx')"
_TURNED = f"{_MARK} !== window.before"
_ALL = "stage.empty && document.querySelector('#view3d .sketch') === null"
_PATH = "selection.place !== null && selection.place !== window.before"


def reports(folder: Path, targets: int) -> tuple[Path, Path]:
    """Return the report of a finishing pass with so many targets, and the page of its comparison."""
    program = folder / "pass.nc"
    program.write_text(programs.lines(targets, "G1 X{:.3f} Y{:.3f} Z{:.3f}"))
    for command in (["convert", str(program)], ["compare", str(program), str(folder / "pass.src")]):
        done = CliRunner().invoke(postproc, [*command, "--cell", str(CELL_FILE), "-o", str(folder)])
        if done.exit_code not in (0, 3):
            raise SystemExit(done.output)
    return folder / "pass.report.html", folder / "pass.compare.report.html"


def _used(root: int) -> float:
    """Return the processor time of all descendants of a process that live [s]."""
    times, parents = {}, {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):
            continue
        pid = int(stat.parent.name)
        parents[pid], times[pid] = int(fields[1]), (int(fields[11]) + int(fields[12])) / _HZ

    def below(pid: int) -> bool:
        while pid in parents and pid != root:
            pid = parents[pid]
        return pid == root

    return sum(spent for pid, spent in times.items() if pid != root and below(pid))


def opening(path: Path) -> dict[str, tuple[float, float]]:
    """Open a page once; return for each stage seconds since navigation, and processor time [s]."""
    out: dict[str, tuple[float, float]] = {}
    with running() as browser:
        page = browser.new_page(viewport={"width": 1440, "height": 1000})
        page.set_default_timeout(60_000)
        page.goto("about:blank")
        spent, began = _used(os.getpid()), time.perf_counter()

        def reached(stage: str) -> None:
            out[stage] = time.perf_counter() - began, _used(os.getpid()) - spent

        page.goto(path.resolve().as_uri(), wait_until="commit")
        for stage, condition in (("text", _TEXT), ("rows", _ROWS), ("picture", _PICTURE)):
            page.wait_for_function(condition, polling=_POLLED_MS)
            reached(stage)
        page.evaluate("document.getElementById('view3d').scrollIntoView()")
        box = page.locator("#view3d svg.over").bounding_box()
        page.evaluate("window.before = selection.place")
        for step in range(100):
            across = 0.3 + 0.4 * (step * 0.618 % 1.0)
            page.mouse.move(
                box["x"] + across * box["width"], box["y"] + (0.4 + 0.4 * (step * 0.414 % 1.0)) * box["height"]
            )
            page.evaluate("new Promise((next) => requestAnimationFrame(() => requestAnimationFrame(next)))")
            if page.evaluate(_PATH):
                page.mouse.down()
                page.mouse.up()
                break
        page.wait_for_function("selection.chosen !== window.before")
        reached("path")
        page.evaluate(f"window.before = {_MARK}")
        page.mouse.down()
        page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.7 * box["height"], steps=4)
        page.mouse.up()
        page.wait_for_function(_TURNED, polling=_POLLED_MS)
        reached("turn")
        page.wait_for_function(_ALL, polling=_POLLED_MS)
        reached("all")
        page.close()
    return out


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--targets", type=int, default=200_000)
    parser.add_argument("--repeats", type=int, default=3)
    wanted = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for path in reports(Path(folder), wanted.targets):
            print(f"{path.name}, {wanted.targets} targets: {path.stat().st_size / 1e6:.1f} MB")
            openings = [opening(path) for _ in range(wanted.repeats)]
            print(f"{'stage':8s} {'seconds':>8s} {'processor':>10s}")
            for stage in openings[0]:
                seconds, processor = (min(each[stage][k] for each in openings) for k in (0, 1))
                print(f"{stage:8s} {seconds:8.2f} {processor:10.2f}")


if __name__ == "__main__":
    main()
