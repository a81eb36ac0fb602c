"""One converted sample for all tests of pages."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from postproc.cli import main
from tests.pages import browser as browsers
from tests.places import ROOT


@pytest.fixture(scope="session")
def results(tmp_path_factory):
    """Folder with the results of `convert` and `predict` for samples/pocket.nc."""
    folder = tmp_path_factory.mktemp("pages")
    arguments = [str(ROOT / "samples" / "pocket.nc"), "--cell", str(ROOT / "samples" / "cell_kr270.toml")]
    for command in ("convert", "predict"):
        done = CliRunner().invoke(main, [command, *arguments, "-o", str(folder)], catch_exceptions=False)
        assert done.exit_code == 0, done.output
    return folder


@pytest.fixture(scope="module")
def page(browser, results):
    """The report of a corrected program, opened from disk."""
    with browsers.opened(browser, results / "pocket.report.html") as page:
        yield page
