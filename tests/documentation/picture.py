"""The README's picture: the report of samples/pocket.nc as Chromium shows it.

python -m tests.documentation.picture        # takes it anew
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from click.testing import CliRunner

from postproc.cli import main
from tests.documentation.pages import ROOT
from tests.pages.browser import opened, running

PICTURE = ROOT / "samples" / "pocket.png"
SIZE = (1440, 1560)


def take(path: Path) -> None:
    """Convert the sample and take the picture of its report."""
    with tempfile.TemporaryDirectory() as folder, running() as browser:
        arguments = [str(ROOT / "samples" / "pocket.nc"), "--cell", str(ROOT / "samples" / "cell_kr270.toml")]
        CliRunner().invoke(main, ["convert", *arguments, "-o", folder], catch_exceptions=False)
        with opened(browser, Path(folder) / "pocket.report.html", width=SIZE[0], height=SIZE[1]) as page:
            page.screenshot(path=path)


if __name__ == "__main__":
    take(PICTURE)
