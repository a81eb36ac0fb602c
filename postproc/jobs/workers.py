"""Worker processes: each converts one program after the other. Both ends of the pipes to them are in this module.

A worker writes nothing but staged files. So it can be ended at any moment: by Ctrl-C, by the end of the process that
started it, or for lack of memory.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import signal
import subprocess
import sys
import threading
import traceback
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from queue import Empty, SimpleQueue
from typing import Any

from postproc.cell import Cell
from postproc.jobs.conversion import convert, failure
from postproc.jobs.output_plan import Task
from postproc.jobs.settings import FAILED, Outcome, Settings, load_setup
from postproc.robot import RobotModel

_START = "from postproc.jobs.workers import main; main()"


class LocalWorkers:
    """Processes on this machine, each driven by a thread that waits for its results.

    :param count: number of processes; each is started when there is a task for it.
    :param settings: settings of all tasks.
    """

    def __init__(self, count: int, settings: Settings) -> None:
        self._settings = settings
        self._threads = ThreadPoolExecutor(count)
        self._free: SimpleQueue[_Process] = SimpleQueue()
        self._all: set[_Process] = set()
        self._lock = threading.Lock()
        self._ending = False

    def begin(self, task: Task) -> Future[Outcome]:
        """Begin a task as soon as there is a free process."""
        return self._threads.submit(self._work, task)

    def outcome(self, future: Future[Outcome], task: Task) -> Outcome | None:
        """Return what came of a task; None if no process could be started for it."""
        del task
        return None if isinstance(future.exception(), OSError) else future.result()

    def lost(self, task: Task) -> None:
        """Return None: a process that ends is noticed at once."""

    def end(self) -> None:
        """End the processes at once."""
        with self._lock:
            self._ending = True
            for process in self._all:
                process.kill()
        self._threads.shutdown(cancel_futures=True)
        for process in self._all:
            process.wait()

    def _work(self, task: Task) -> Outcome:
        process = self._process()
        try:
            outcome = process.work(task, self._settings)
        except EOFError:
            with self._lock:
                self._all.discard(process)
            return _died(task, process.wait())
        self._free.put(process)
        return outcome

    def _process(self) -> _Process:
        with contextlib.suppress(Empty):
            return self._free.get_nowait()
        with self._lock:
            if self._ending:
                raise OSError
            process = _Process()
            self._all.add(process)
            return process


def work_alone(task: Task, settings: Settings) -> Outcome:
    """Return what comes of a task in a process of its own."""
    process = _Process()
    try:
        return process.work(task, settings)
    except EOFError:
        return _died(task, process.wait())
    finally:
        process.kill()
        process.wait()


class _Process:
    """A worker process.

    :raises OSError: none can be started.
    """

    def __init__(self) -> None:
        # in a session of its own: Ctrl-C and a closed terminal reach the process that waits, and it alone decides
        apart: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            apart = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        path = os.pathsep.join(entry or str(os.getcwd()) for entry in sys.path)  # noqa: PTH109
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _START],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={"OPENBLAS_NUM_THREADS": "1", **os.environ, "PYTHONPATH": path},  # one thread, as in `cli`
            **apart,
        )

    def work(self, task: Task, settings: Settings) -> Outcome:
        """Let it work on a task, and wait for the outcome.

        :raises EOFError: the process ended instead.
        """
        try:
            assert self._process.stdin is not None
            assert self._process.stdout is not None
            pickle.dump((task, settings), self._process.stdin)
            self._process.stdin.flush()
            outcome: Outcome = pickle.load(self._process.stdout)
        except Exception as cause:
            raise EOFError from cause
        return outcome

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def wait(self) -> int:
        """Wait for its end and return its exit code; negative: the signal that ended it."""
        code = self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        return code


def _died(task: Task, code: int) -> Outcome:
    how = f"signal {-code}" if code < 0 else f"exit code {code}"
    program = task.job.program
    message = f"{program}: its worker process ended ({how}), perhaps for lack of memory. Use fewer --jobs."
    return Outcome(str(program), FAILED, message=message, keeps_earlier=True)


def main() -> None:
    """Run a worker: tasks from standard input, outcomes to standard output, until the other end is closed."""
    outcomes = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever else may print must not get between outcomes
    logging.captureWarnings(True)
    for name in ("SIGINT", "SIGHUP", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)  # the process that waits decides
    tasks: SimpleQueue[tuple[Task, Settings]] = SimpleQueue()
    threading.Thread(target=_receive, args=(tasks,), daemon=True).start()
    code = 0
    try:
        while True:
            pickle.dump(_converted(*tasks.get()), outcomes)
            outcomes.flush()
    except BrokenPipeError:
        pass
    except BaseException:
        traceback.print_exc()
        code = 1
    os._exit(code)


def _receive(tasks: SimpleQueue[tuple[Task, Settings]]) -> None:
    """Pass tasks on; end this process when the other end of the pipe is closed, whatever it is doing."""
    try:
        while True:
            tasks.put(pickle.load(sys.stdin.buffer))
    except (EOFError, OSError, pickle.UnpicklingError):
        os._exit(0)


@lru_cache(maxsize=1)
def _setup(settings: Settings) -> tuple[Cell, RobotModel]:
    return load_setup(settings)


def _converted(task: Task, settings: Settings) -> Outcome:
    try:
        cell, robot = _setup(settings)
    except Exception as cause:
        return failure(task.job, cause)
    return convert(task, settings, cell, robot)
