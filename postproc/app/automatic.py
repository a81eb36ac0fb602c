"""Automatic correction of the programs of a folder while its switch is on, one program after the other."""

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

_STATE_FILE = ".postproc-app.json"
_CONVERSIONS = ("convert", "start")
"""Commands that convert a program: after them it is finished, also if they fail. Other commands only read it."""


class AutomaticConversion:
    """Automatic conversion of the programs of a window, which a switch on its page turns on and off.

    :ivar is_on: programs are converted; the switch is saved in the folder of the results.
    """

    def __init__(self, workspace: Workspace, runs: Runs) -> None:
        self._workspace, self._runs = workspace, runs
        self._arrivals = Arrivals(workspace.folder, workspace.results, workspace.cell)
        self._last_run: Run | None = None
        """The last command that `step` began."""
        self._oldest_number = 0
        """Number of the first command that may have run since the last step."""
        self._end = threading.Event()
        self._state = workspace.results / _STATE_FILE
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
        """Begin to scan the folder, in a thread, until `stop`."""
        threading.Thread(target=self._scan_folder, daemon=True).start()

    def stop(self) -> None:
        """End the scans: no further command begins; a running one goes on."""
        self._end.set()

    def _scan_folder(self) -> None:
        """Scan the folder every `SCAN` seconds until `stop`."""
        while not self._end.wait(SCAN):
            # the folder may be missing for a moment, as on a network drive: the next scan finds it again
            with contextlib.suppress(OSError, PostprocError):
                self.step(time.monotonic())

    def step(self, time_s: float) -> None:
        """Begin to correct the first program that is ready and has no current results.

        Nothing begins while the switch is off or a command runs. Programs whose results are up to date are
        finished; those that users convert themselves count as converted when their command has ended.

        :param time_s: monotonic time [s].
        """
        is_idle, user_programs = self._poll_runs()
        paths = [
            path for path in self._arrivals.ready(time_s, user_programs) if not self._workspace.name_fault(path.name)
        ]
        if not (self.is_on and is_idle and paths):
            return
        items = {item.name: item for item in self._workspace.items()}
        for path in paths:
            item = items.get(path.name)
            if item is None or item.is_current:
                self._arrivals.finish(path)  # until it changes again
                continue
            if not self._end.is_set():
                title = f"Correct {path.name}"
                self._last_run = self._runs.begin(path.name, title, self._workspace.conversion_arguments(path.name))
                self._arrivals.finish(path)
            return

    def _poll_runs(self) -> tuple[bool, set[str]]:
        """Return whether no command runs, and the names of programs that users have converted since the last call.

        Programs that `step` converts are not among them: if such a program changes meanwhile, it is converted again.
        Commands that still run count at the next call too.
        """
        recent_runs = self._runs.runs_since(self._oldest_number)
        active_runs = [run for run in recent_runs if run.is_running]
        # without a running command, only later ones count at the next call
        next_number = self._oldest_number + len(recent_runs)
        self._oldest_number = min((run.number for run in active_runs), default=next_number)
        user_runs = (run for run in recent_runs if run is not self._last_run and run.arguments[0] in _CONVERSIONS)
        return not active_runs, {run.key for run in user_runs}  # the key of a conversion is its program
