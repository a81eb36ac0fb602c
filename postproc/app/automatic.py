"""Programs of the folder are corrected by themselves while the switch is on, one after the other."""

from __future__ import annotations

import contextlib
import json
import threading
import time

from postproc.app.runs import Run, Runs
from postproc.app.workspace import Workspace
from postproc.errors import PostprocError
from postproc.jobs.arrivals import Arrivals
from postproc.jobs.watching import SCAN

_STATE = ".postproc-app.json"
_CONVERSIONS = ("convert", "start")
"""Commands after which a program is finished, whatever came of it; others only read it."""


class AutomaticConversion:
    """Automatic conversion of the programs of a window, which a switch on its page turns on and off.

    :ivar is_on: whether programs are converted; that it is off is saved in the folder of the results.
    """

    def __init__(self, workspace: Workspace, runs: Runs) -> None:
        self._workspace, self._runs = workspace, runs
        self._arrivals = Arrivals(workspace.folder, workspace.results, workspace.cell)
        self._last_run: Run | None = None
        """The last command that `step` began."""
        self._oldest_number = 0
        """Number of the first command that may have run since the last step."""
        self._end = threading.Event()
        self._state = workspace.results / _STATE
        self.is_on = self._read_state()

    def _read_state(self) -> bool:
        """Return whether automatic conversion is on; True without a readable state file."""
        try:
            return bool(json.loads(self._state.read_bytes())["automatic"])
        except (OSError, ValueError, KeyError, TypeError):
            return True

    def switch(self, *, is_on: bool) -> None:
        """Turn the conversion on or off; a command that runs is not stopped."""
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
        """Scan the folder every `SCAN` seconds until the end is asked for."""
        while not self._end.wait(SCAN):
            # the folder may be gone for a moment, as on a network drive, and the next scan finds it
            with contextlib.suppress(OSError, PostprocError):
                self.step(time.monotonic())

    def step(self, time_s: float) -> None:
        """Begin to correct the first program that is ready, if the switch is on and no command runs.

        :param time_s: monotonic time [s].
        """
        is_idle, busy = self._commands()
        paths = [path for path in self._arrivals.ready(time_s, busy) if not self._workspace.name_fault(path.name)]
        if not (self.is_on and is_idle and paths):
            return
        items = {item.name: item for item in self._workspace.items()}
        for path in paths:
            item = items.get(path.name)
            if item is None or item.is_current:
                self._arrivals.finish(path)
                continue
            if not self._end.is_set():
                title = f"Correct {path.name}"
                self._last_run = self._runs.begin(path.name, title, self._workspace.conversion(path.name))
                self._arrivals.finish(path)
            return

    def _commands(self) -> tuple[bool, set[str]]:
        """Return whether no command runs, and the names of programs that users have corrected since the last step.

        Commands begun by `step` are left out: if a program changes during such a command, it is converted again.
        """
        recent = self._runs.runs_since(self._oldest_number)
        active = [run for run in recent if run.code is None]
        self._oldest_number = min((run.number for run in active), default=self._oldest_number + len(recent))
        user_runs = (run for run in recent if run is not self._last_run and run.arguments[0] in _CONVERSIONS)
        return not active, {run.key for run in user_runs}
