"""Real processes of the command line, held at places that a test chooses.

A process says by a file that it has come to a place, and waits there until another file tells it to go on, or a signal
ends it. No test depends on how fast anything is: a busy machine makes it slower, and no different.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from tests.places import SAMPLES

CELL_16 = str(SAMPLES / "cell_kr16.toml")
COMMAND = [sys.executable, "-m", "postproc"]
ENDINGS = (".src", ".targets.csv", ".report.html", ".report.json")
LONG = 300.0
"""Seconds after which a process hangs, however busy the machine is."""

_CUSTOMIZE = """
import importlib, os, time
from pathlib import Path
from typing import Any

def held(function, nth, place):
    calls = []
    def wrapped(*args, **kwargs):
        calls.append(1)
        if len(calls) == nth:
            (place / f"here-{os.getpid()}").touch()
            end = time.monotonic() + 300.0  # nobody is left behind by a test that failed
            while not (place / "go").exists() and time.monotonic() < end:
                time.sleep(0.01)
        return function(*args, **kwargs)
    return wrapped

module, name, nth = os.environ["HELD_AT"].split(":")
place = Path(__file__).parent
target = importlib.import_module(module)
setattr(target, name, held(getattr(target, name), int(nth), place))
"""


def run_process(*arguments: object, text: bool = True, **options: Any) -> subprocess.CompletedProcess[Any]:
    """Run `postproc` in a process of its own to its end.

    :param text: whether its output is text; bytes otherwise.
    :param options: of `subprocess.run`: cwd, env, input.
    """
    words = [*COMMAND, *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=text, timeout=LONG, check=False, **options)


class Held:
    """A running `postproc` that waits at a place, in itself or in its workers.

    :param at: ``module:function:n``: before the n-th call of this function in a process.
    :param arguments: of the command.
    """

    def __init__(self, at: str, *arguments: str) -> None:
        self.place = Path("held").absolute()
        self.place.mkdir()
        (self.place / "sitecustomize.py").write_text(_CUSTOMIZE)
        path = os.pathsep.join([str(self.place), *filter(None, [os.environ.get("PYTHONPATH")])])
        self.environment = os.environ | {"PYTHONPATH": path, "HELD_AT": at}
        self.process = subprocess.Popen(
            [*COMMAND, *arguments], env=self.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            start_new_session=True,
        )  # fmt: skip

    def waiting(self, count: int = 1) -> list[int]:
        """Return the ids of the processes that wait, when there are so many."""
        end = time.monotonic() + LONG
        while len(found := list(self.place.glob("here-*"))) < count:
            assert time.monotonic() < end, "never came there"
            assert self.process.poll() is None, self.process.communicate()
            time.sleep(0.01)
        return [int(path.name.removeprefix("here-")) for path in found]

    def signal(self, number: int) -> None:
        """Send a signal to the process that was started."""
        self.process.send_signal(number)

    def go(self) -> None:
        """Let them go on."""
        (self.place / "go").touch()

    def end(self) -> tuple[int, str, str]:
        """Return exit code, stdout and stderr when every process that holds a pipe of it is gone, workers too."""
        stdout, stderr = self.process.communicate(timeout=LONG)
        return self.process.returncode, stdout, stderr


def programs(count: int, folder: str = ".") -> None:
    """Write so many short KRL programs: p00.src, p01.src …"""
    head = (SAMPLES / "long_lin.src").read_text().splitlines()[:24]
    source = "\n".join([*head[:8], ";FORCE FX=80 FY=-40 FZ=120", *head[8:], "END", ""])
    for index in range(count):
        Path(folder, f"p{index:02}.src").write_text(source.replace("DEF long_lin", f"DEF p{index:02}"))


def written(folder: str = "out") -> set[str]:
    """Return the names of the programs in a folder, each whole; an overview and leftovers do not count."""
    if not Path(folder).exists():
        return set()
    names = {path.name for path in Path(folder).iterdir() if not path.name.startswith(".postproc")} - {"index.html"}
    stems = {name.split(".")[0] for name in names}
    assert names == {stem + ending for stem in stems for ending in ENDINGS}
    for stem in stems:
        entries = json.loads(Path(folder, f"{stem}.report.json").read_bytes())["files"]
        assert {entry["name"] for entry in entries} == {stem + ending for ending in ENDINGS[:-1]}
        for entry in entries:
            assert hashlib.sha256(Path(folder, entry["name"]).read_bytes()).hexdigest() == entry["sha256"]
    return stems
