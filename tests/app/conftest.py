"""A window on an empty folder."""

from __future__ import annotations

from threading import Thread

import pytest

from postproc.app.server import Window


@pytest.fixture
def window(tmp_path):
    """A window that answers, on an empty folder."""
    folder = tmp_path / "shop"
    folder.mkdir()
    with Window(folder, 0) as served:
        thread = Thread(target=served.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
        thread.start()
        yield served
        served.runs.stop_all()
        served.shutdown()
        thread.join()
