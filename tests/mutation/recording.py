"""One run of the tests without any fault: which lines each test executes, and how long it takes.

A plugin of pytest. A line that a fixture of a module or session executes counts for every test that uses the fixture,
and what tests and package keep between calls (`functools.cache`) is forgotten before each test: a line counts for every
test that needs what it makes.
"""

from __future__ import annotations

import contextlib
import functools
import json
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from hypothesis import Phase, settings

OPTIONS = [
    "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:benchmark",
    "-W", "ignore:Module already imported so cannot be rewritten",  # Hypothesis: this file imports it
]  # fmt: skip


class WithoutChance:
    """Hypothesis tries the same examples in every run, and does not look for smaller ones when a test has failed."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self) -> None:
        """Replace what conftest.py has chosen."""
        settings.register_profile(
            "mutation", settings(), derandomize=True, database=None, phases=(Phase.explicit, Phase.generate)
        )
        settings.load_profile("mutation")


class Recorder(WithoutChance):
    """Lines and seconds of each test.

    :param files: absolute paths of the files of which lines are recorded.
    """

    def __init__(self, files: set[str]) -> None:
        self.files = files
        self.lines: set[tuple[str, int]] = set()
        self.of_fixture: dict[int, set[tuple[str, int]]] = {}
        self.tests: dict[str, dict[str, Any]] = {}
        self.failed: list[str] = []

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Record one test."""
        _forget()
        self.lines = set()
        start = time.process_time()
        threading.settrace(self._call)  # a server of a test answers in a thread
        sys.settrace(self._call)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            threading.settrace(None)
            for definitions in getattr(item, "_fixtureinfo").name2fixturedefs.values():  # noqa: B009
                for definition in definitions:
                    self.lines |= self.of_fixture.get(id(definition), set())
            by_file: dict[str, list[int]] = {}
            for name, line in sorted(self.lines.copy()):  # a thread may still add lines
                by_file.setdefault(name, []).append(line)
            self.tests[item.nodeid] = {"seconds": time.process_time() - start, "lines": by_file}

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[object]:
        """Keep the lines of a fixture for all tests that use it."""
        outer, self.lines = self.lines, set()
        try:
            return (yield)
        finally:
            self.of_fixture[id(fixturedef)] = self.lines
            self.lines = outer | self.lines

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Collect failures: a suite that fails without a fault can show none."""
        if report.failed:
            self.failed.append(report.nodeid)

    def _call(self, frame: FrameType, event: str, argument: object) -> Any:
        return self._line if frame.f_code.co_filename in self.files else None

    def _line(self, frame: FrameType, event: str, argument: object) -> Any:
        if event == "line":
            self.lines.add((frame.f_code.co_filename, frame.f_lineno))
        return self._line


def _forget() -> None:
    """Forget what functions of tests and package keep between calls."""
    for name, module in list(sys.modules.items()):
        if name.split(".")[0] in ("tests", "postproc"):
            for value in list(vars(module).values()):
                if isinstance(value, functools._lru_cache_wrapper):
                    with contextlib.suppress(AttributeError):
                        value.cache_clear()


def main() -> None:
    """Run the tests and write what was recorded.

    Arguments: file to write (JSON), number of files whose lines count, these files, the test files.
    """
    out, count, *names = sys.argv[1:]
    files, tests = names[: int(count)], names[int(count) :]
    signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background ignore it: tests of it would fail
    recorder = Recorder({str(Path(name).absolute()) for name in files})
    code = pytest.main([*OPTIONS, *tests], plugins=[recorder])
    here = Path.cwd()
    for test in recorder.tests.values():
        test["lines"] = {Path(name).relative_to(here).as_posix(): lines for name, lines in test["lines"].items()}
    ours = ("tests", "postproc", "__main__")
    imported = [
        name
        for name, module in list(sys.modules.items())
        if name.split(".")[0] not in ours and not str(getattr(module, "__file__", None) or "").startswith(str(here))
    ]
    found = {"code": int(code), "failed": recorder.failed, "tests": recorder.tests, "imported": imported}
    Path(out).write_text(json.dumps(found))


if __name__ == "__main__":
    main()
