"""A window on an empty folder."""

from __future__ import annotations

import contextlib
from threading import Thread

import pytest

from postproc.app.server import Window


@pytest.fixture
def window(tmp_path):
    """A window that answers, on an empty folder."""
    folder = tmp_path / "shop"
    folder.mkdir()
    with Window(folder, 0) as served, answering(served):
        yield served


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
