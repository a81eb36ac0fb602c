"""A process that has imported numpy, pytest and all else that is not ours, and forks for each mutant.

It works in a copy of the repository, in which the fault is written into the file: processes that a test starts meet it
too. Requests and answers are lines of JSON on stdin and stdout.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import signal
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.mutation.recording import OPTIONS, WithoutChance

FAILED, PASSED, BROKEN = 1, 0, 3


class Limits(WithoutChance):
    """Ends the process when a test takes far longer than without the fault.

    Seconds of the processor count, so that a busy machine kills no mutant; by the clock there is ten times that, for
    tests that wait.
    """

    def __init__(self, seconds: dict[str, float]) -> None:
        self.seconds = seconds

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Set the limits of a test: the signals end the process."""
        limit = 10.0 + 5.0 * self.seconds.get(item.nodeid, 1.0)
        signal.setitimer(signal.ITIMER_PROF, limit)
        signal.setitimer(signal.ITIMER_REAL, 10.0 * limit + 30.0)
        try:
            return (yield)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            signal.setitimer(signal.ITIMER_REAL, 0.0)


def _child(batches: list[list[str]], seconds: dict[str, float], log: str) -> None:
    """Run the tests, batch by batch, until one fails; ends this process."""
    os.setsid()
    out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(out, stream)
    sys.stdout = sys.stderr = os.fdopen(1, "w", buffering=1)
    for number in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # as in `recording.main`
    limits = Limits(seconds)
    # collecting counts too: a fault at import may never end
    signal.setitimer(signal.ITIMER_PROF, 120.0)
    code = BROKEN
    try:
        for batch in batches:
            code = int(pytest.main([*OPTIONS, "-x", "--tb=line", *batch], plugins=[limits]))
            if code != PASSED:
                break
    except BaseException:
        code = FAILED
    finally:
        sys.stdout.flush()
        os._exit(code)


def _forget_compiled(path: Path) -> None:
    """Delete what Python has compiled of a file: two faults of one size in one second would be taken for one."""
    for compiled in path.parent.glob(f"__pycache__/{path.stem}.*"):
        compiled.unlink()


def _run(request: dict) -> dict:
    """Plant the fault, run the tests in a child, and put the file back."""
    path, start = Path(request["file"]), time.monotonic()
    whole = path.read_bytes()
    _forget_compiled(path)
    path.write_bytes(request["text"].encode())
    try:
        child = os.fork()
        if child == 0:
            _child(request["batches"], request["seconds"], request["log"])
        _, status = os.waitpid(child, 0)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)  # what its tests started and left behind
    finally:
        path.write_bytes(whole)
        _forget_compiled(path)
    took = time.monotonic() - start
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        return {"outcome": "time" if number in (signal.SIGPROF, signal.SIGALRM) else "killed", "seconds": took}
    code = os.WEXITSTATUS(status)
    return {"outcome": "survived" if code == PASSED else "killed", "code": code, "seconds": took}


def main() -> None:
    """Import what is named on the first line, then answer requests."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in json.loads(sys.stdin.readline()):
            with contextlib.suppress(Exception):
                importlib.import_module(name)
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    for line in sys.stdin:
        print(json.dumps(_run(json.loads(line))), file=answers)


if __name__ == "__main__":
    main()
