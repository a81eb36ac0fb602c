"""Programs of the folder are corrected by themselves while the switch is on, one after the other."""

from __future__ import annotations

import contextlib
import json
import threading
import time

from postproc.app.runs import Runs
from postproc.app.workspace import Workspace
from postproc.errors import PostprocError
from postproc.jobs.arrivals import Arrivals
from postproc.jobs.watching import SCAN

_STATE = ".postproc-app.json"


class Automatic:
    """The switch, and what it switches.

    :ivar is_on: kept in the folder of the results when it is off.
    """

    def __init__(self, workspace: Workspace, runs: Runs) -> None:
        self._workspace, self._runs = workspace, runs
        self._arrivals = Arrivals(workspace.folder, workspace.results, workspace.cell)
        self._end = threading.Event()
        self._state = workspace.results / _STATE
        self.is_on = self._stated()

    def _stated(self) -> bool:
        try:
            return bool(json.loads(self._state.read_bytes())["automatic"])
        except (OSError, ValueError, KeyError, TypeError):
            return True

    def switch(self, *, is_on: bool) -> None:
        """Switch it on or off; what runs goes on."""
        self.is_on = is_on
        if is_on:
            self._state.unlink(missing_ok=True)
        else:
            self._state.parent.mkdir(exist_ok=True)
            self._state.write_text(json.dumps({"automatic": False}), encoding="utf-8")

    def start(self) -> None:
        """Look after the folder until `stop`."""
        threading.Thread(target=self._run, daemon=True).start()

    def stop(self) -> None:
        """Begin nothing more."""
        self._end.set()

    def _run(self) -> None:
        while not self._end.wait(SCAN):
            # the folder may be gone for a moment, as on a network drive, and the next scan finds it
            with contextlib.suppress(OSError, PostprocError):
                self.step(time.monotonic())

    def step(self, time_s: float) -> None:
        """Begin with the first program that is ready, if nothing runs.

        :param time_s: monotonic time [s].
        """
        active = {run.key for run in self._runs.active()}
        if not self.is_on:
            return
        paths = self._arrivals.ready(time_s, active)
        if active or not paths:
            return
        items = {item.name: item for item in self._workspace.items()}
        for path in paths:
            self._arrivals.finish(path)
            item = items.get(path.name)
            if item is None or item.current or item.twin or self._end.is_set():
                continue
            self._runs.begin(path.name, f"Correct {path.name}", self._workspace.conversion(path.name))
            return
