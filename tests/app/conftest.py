"""A window on an empty folder, and a folder with a corrected program."""

from __future__ import annotations

import contextlib
import shutil
from threading import Thread

import pytest

from postproc.app.server import Window
from tests.test_currency import made


@pytest.fixture
def window(tmp_path):
    """A window that answers, on an empty folder."""
    folder = tmp_path / "shop"
    folder.mkdir()
    with Window(folder, 0) as served, answering(served):
        yield served


@pytest.fixture(scope="session")
def original(tmp_path_factory):
    """A folder with a corrected program: tests work on copies."""
    return made(tmp_path_factory.mktemp("original") / "shop")


@pytest.fixture
def shop(original, tmp_path):
    """A copy of the folder with a corrected program."""
    return shutil.copytree(original, tmp_path / "made")


@contextlib.contextmanager
def answering(window):
    """Let a window answer; at the end its commands are stopped."""
    thread = Thread(target=window.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
    thread.start()
    try:
        yield
    finally:
        window.runs.stop_all()
        window.shutdown()
        thread.join()
