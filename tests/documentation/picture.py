"""The README's pictures: reports of samples as Chromium shows them.

python -m tests.documentation.picture        # takes them anew
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from click.testing import CliRunner

from postproc.cli import main
from tests.documentation.pages import ROOT
from tests.pages.browser import opened, running

SAMPLES = ROOT / "samples"
SIZE = (1440, 1560)


def take(path: Path, name: str, *options: str, section: str = "") -> None:
    """Convert a sample and take the picture of its report, or of a section of it."""
    with tempfile.TemporaryDirectory() as folder, running() as browser:
        arguments = [str(SAMPLES / f"{name}.nc"), "--cell", str(SAMPLES / "cell_kr270.toml"), *options, "-o", folder]
        CliRunner().invoke(main, ["convert", *arguments], catch_exceptions=False)
        with opened(browser, Path(folder) / f"{name}.report.html", width=SIZE[0], height=SIZE[1]) as page:
            if section:
                page.locator(f"#{section}").scroll_into_view_if_needed()
                page.wait_for_timeout(2000)
                page.locator(f"#{section}").screenshot(path=path)
            else:
                page.screenshot(path=path)


if __name__ == "__main__":
    take(SAMPLES / "pocket.png", "pocket")
    take(SAMPLES / "plate.png", "plate", "--process", str(SAMPLES / "plate.process.toml"), section="cut")
