"""Commands that run for a window: each is `postproc` with arguments, in its own process."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from postproc.errors import InputError, argument
from postproc.progress import LINES, VARIABLE, parse_progress

MAX_COMMANDS = 4
"""Largest number of commands at the same time; more would only share the processors."""
PATIENCE_S = 25.0
"""Longest time to wait for a stopped command [s]: it ends itself a little earlier, see `child.PATIENCE_S`."""
_WINDOWS_FLAGS = 0x200 | 0x0800_0000
"""CREATE_NEW_PROCESS_GROUP and CREATE_NO_WINDOW: a window that pythonw started opens no console for each command."""
_MAX_OUTPUT_CHARACTERS = 200_000
"""Largest number of characters of output that are kept: the last ones."""


def command_line(arguments: Sequence[str]) -> str:
    """Return a command as a user would type it in a terminal."""
    return " ".join(["postproc", *(argument(word) for word in arguments)])


class Run:
    """A command that runs, or has run.

    :ivar number: number of the command in the order of the window, from 0.
    :ivar title: heading of its page.
    :ivar arguments: words after `postproc`.
    :ivar key: subject of the command, such as ``"part.nc"``; two commands with one key do not run at the same time.
    :ivar page: address that shows its result; empty: the page of the program `key`.
    :ivar is_stopped: the user stopped it.
    :ivar step: present step of its work, such as "moves".
    :ivar share: share of this step that is done, 0 to 1; None: unknown.
    """

    def __init__(
        self, number: int, key: str, title: str, arguments: Sequence[str], folder: Path, page: str = ""
    ) -> None:
        self.page = page
        self.number, self.key, self.title, self.arguments = number, key, title, tuple(arguments)
        self.is_stopped = False
        self.share: float | None = None
        self.step = ""
        self._text = ""
        variables = {"PYTHONIOENCODING": "utf-8", "PYTHONUNBUFFERED": "1", "NO_COLOR": "1", VARIABLE: LINES}
        self._process: subprocess.Popen[bytes] = subprocess.Popen(
            # -P: Python does not import modules from the folder, such as a numpy.py
            [sys.executable, "-P", "-m", "postproc.app.child", *arguments],
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env={**os.environ, **variables},
            # Ctrl-C goes to the window alone, which stops its commands
            creationflags=_WINDOWS_FLAGS if os.name == "nt" else 0,
            start_new_session=os.name != "nt",
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        """Read the output of the command until it ends; keep its progress and the last characters of its text."""
        assert self._process.stdout is not None
        with self._process.stdout as stream:
            for data in stream:
                line = data.decode(errors="replace").replace("\r\n", "\n")
                if (progress := parse_progress(line)) is not None:
                    self.share, self.step = progress
                else:
                    self._text = (self._text + line)[-_MAX_OUTPUT_CHARACTERS:]
        self._process.wait()
        self._close_pipe()

    def _close_pipe(self) -> None:
        """Close the input of the command, which may have ended already."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()

    @property
    def code(self) -> int | None:
        """Exit code; None while the command runs."""
        return None if self._reader.is_alive() else self._process.returncode

    @property
    def is_running(self) -> bool:
        """Whether the command runs."""
        return self.code is None

    @property
    def text(self) -> str:
        """Last characters that the command has printed so far."""
        return self._text

    @property
    def is_failure(self) -> bool:
        """True if the command has ended with an error, and not because it was stopped."""
        # exit code 3: the files are written, and the verdict is red
        return not self.is_running and self.code not in (0, 3) and not self.is_stopped

    @property
    def progress(self) -> str:
        """Present step of the command and share done, as text; without the share if it is unknown."""
        return self.step if self.share is None else f"{self.step}: {100 * self.share:.0f} %"

    @property
    def command(self) -> str:
        """The command as a user would type it in a terminal."""
        return command_line(self.arguments)

    def stop(self) -> None:
        """Ask the command to end by closing its standard input, if it runs; files that it has written are complete."""
        if self.is_running:
            self.is_stopped = True
            self._close_pipe()

    def wait(self, seconds: float | None = None) -> None:
        """Wait until the command has ended, at most for `seconds`; None: without a limit."""
        self._reader.join(seconds)


class Runs:
    """The commands of a window."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._runs: list[Run] = []
        self._lock = threading.Lock()

    def begin(
        self,
        key: str,
        title: str,
        arguments: Sequence[str],
        change: Callable[[], object] | None = None,
        page: str = "",
    ) -> Run:
        """Begin a command and return it; return the running command if it has the same key and arguments.

        Parameters as of `Run`.

        :param change: function that changes a file which commands read, before this command begins; None: no change.
        :raises InputError: too many commands run already, or another one with this key. With `change`: a command runs,
            and nothing is changed.
        """
        with self._lock:
            if change is not None:
                self._check_idle()
                change()
            active = self.active_runs()
            for run in active:
                if run.key == key and run.arguments == tuple(arguments):
                    return run
                if run.key == key:
                    problem = f"{run.title!r} runs already: nothing was begun"
                    raise InputError(problem, advice="Wait until it has ended, or stop it.")
            if len(active) >= MAX_COMMANDS:
                raise InputError(
                    f"{MAX_COMMANDS} commands run already", advice="Wait until one has ended, or stop one."
                )
            self._runs.append(Run(len(self._runs), key, title, arguments, self.folder, page))
            return self._runs[-1]

    def edit(self, change: Callable[[], object]) -> None:
        """Change a file that commands read, if no command runs: a result must come from one content of the file.

        :param change: function that changes the file.
        :raises InputError: a command runs; nothing is changed.
        """
        with self._lock:
            self._check_idle()
            change()

    def _check_idle(self) -> None:
        """Check that no command runs, which would read the cell while it is changed.

        :raises InputError: a command runs.
        """
        for run in self.active_runs():
            problem = f"{run.title!r} runs and reads the cell: nothing was changed"
            raise InputError(problem, advice="Wait until it has ended, or stop it.")

    def run_of_number(self, number: str) -> Run:
        """Return the command with a number, a text from an address.

        :raises InputError: there is no command with this number.
        """
        is_number = number.isascii() and number.isdecimal() and len(number) < 10  # an address may contain anything
        if not is_number or int(number) >= len(self._runs):
            raise InputError("no such run", advice="The window was started anew: results are in the list of programs.")
        return self._runs[int(number)]

    @property
    def count(self) -> int:
        """Number of commands begun so far."""
        return len(self._runs)

    def active_runs(self) -> list[Run]:
        """Return the commands that run now."""
        return [run for run in self._runs if run.is_running]

    def runs_since(self, number: int) -> list[Run]:
        """Return the commands with `number` or a greater number, in order."""
        return self._runs[number:]

    def latest_run(self, key: str) -> Run | None:
        """Return the latest command with a key, see `Run`; None if no command has it."""
        return next((run for run in reversed(self._runs) if run.key == key), None)

    def stop_all(self) -> None:
        """Stop all running commands, and wait for the end of each, at most `PATIENCE_S`."""
        # all are asked to end before the first is waited for
        for run in self._runs:
            run.stop()
        for run in self._runs:
            run.wait(PATIENCE_S)
