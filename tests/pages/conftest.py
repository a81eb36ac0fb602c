"""One converted sample for all tests of pages."""

from __future__ import annotations

import pytest

from tests.commands import run
from tests.pages import browser as browsers
from tests.places import CELL_FILE, ROOT


@pytest.fixture(scope="session")
def results(tmp_path_factory):
    """Folder with the results of `convert` and `predict` for samples/pocket.nc."""
    folder = tmp_path_factory.mktemp("pages")
    arguments = [str(ROOT / "samples" / "pocket.nc"), "--cell", str(CELL_FILE)]
    for command in ("convert", "predict"):
        run(command, *arguments, "-o", folder, catch_exceptions=False)
    return folder


@pytest.fixture(scope="module")
def page(browser, results):
    """The report of a corrected program, opened from disk."""
    with browsers.opened(browser, results / "pocket.report.html") as page:
        yield page
