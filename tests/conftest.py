"""What holds for all tests."""

import gc
import itertools
import os
import re
import signal

import pytest
from hypothesis import HealthCheck, settings

from tests.pages import browser as browsers

settings.register_profile(
    "postproc",
    deadline=None,  # how long an example takes says nothing about the code on a machine that others use too
    suppress_health_check=[HealthCheck.too_slow],
    derandomize="CI" in os.environ,
)
settings.load_profile("postproc")
_FOLDER_NUMBERS = itertools.count()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Give all tests of the documentation to one worker: they share the folder in which the pages are followed."""
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid):
            return "tests/documentation" if nodeid.startswith("tests/documentation/") else super()._split_scope(nodeid)

    return Scheduling(config, log)


def pytest_collection_finish():
    """Leave modules and collected tests out of garbage collection: full ones would go through all of them."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def disk_is_not_waited_for():
    """Files of tests need not survive a power cut."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def signals_are_heard():
    """Signals that the shell has ignored (nohup, a background job) are delivered, to the tests and to what they start.

    SIGINT then raises KeyboardInterrupt as in the foreground: by default it would end the run.
    """
    numbers = [getattr(signal, name) for name in ("SIGHUP", "SIGINT", "SIGTERM") if hasattr(signal, name)]
    ignored = [number for number in numbers if signal.getsignal(number) is signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    yield
    for number in ignored:
        signal.signal(number, signal.SIG_IGN)


@pytest.fixture
def tmp_path(tmp_path_factory, request):
    """Folder of the test, with a number of its own.

    pytest looks for a free number among the folders of all tests before it: half a minute for 5000 tests.
    """
    name = re.sub(r"\W", "_", request.node.name)[:30]
    folder = tmp_path_factory.getbasetemp() / f"{next(_FOLDER_NUMBERS)}_{name}"
    folder.mkdir(mode=0o700)
    return folder


@pytest.fixture
def work_folder(tmp_path, monkeypatch):
    """Folder of the test, in which it works: relative paths are below it."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def browser():
    """One browser for all tests of a process: Playwright's own loop runs once in a thread."""
    with browsers.running() as running:
        yield running
