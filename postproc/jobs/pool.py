"""Several programs at the same time, each in a worker process: `jobs.worker` at the other end of two pipes."""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from queue import Empty, SimpleQueue
from typing import Any

from postproc import interrupts
from postproc.jobs.job import Job
from postproc.jobs.outcome import FAILED, Outcome, Settings

_START = "from postproc.jobs.worker import main; main()"
_POLL = 0.2
"""Seconds between two looks at whether a signal came: on Windows none ends a wait."""


class Worker:
    """A worker process.

    :raises OSError: no process can be started.
    """

    def __init__(self) -> None:
        # a session of its own: Ctrl-C and a closed terminal reach the process that waits, and it alone decides
        apart: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            apart = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        path = os.pathsep.join(entry or str(os.getcwd()) for entry in sys.path)  # noqa: PTH109
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _START],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={"OPENBLAS_NUM_THREADS": "1", **os.environ, "PYTHONPATH": path},  # as `cli` has it: one thread
            **apart,
        )

    def work(self, job: Job, settings: Settings) -> Outcome:
        """Let it work on a job, and wait for what comes of it.

        :raises EOFError: the process ended instead.
        """
        try:
            assert self._process.stdin is not None
            assert self._process.stdout is not None
            pickle.dump((job, settings), self._process.stdin)
            self._process.stdin.flush()
            outcome: Outcome = pickle.load(self._process.stdout)
        except Exception as cause:
            raise EOFError from cause
        return outcome

    def end(self) -> None:
        """Let it end: at once if it computes, when its program is whole if it writes."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()

    def wait(self) -> int:
        """Wait for its end and return its exit code; negative: the signal that ended it."""
        assert self._process.stdout is not None
        code = self._process.wait()
        self._process.stdout.close()
        return code


def work_alone(job: Job, settings: Settings) -> Outcome:
    """Work on one job in a process of its own, which outlives the caller only to leave nothing half-written."""
    worker = Worker()
    try:
        return worker.work(job, settings)
    except EOFError:
        worker.end()
        return _died(job, worker.wait())
    finally:
        worker.end()
        worker.wait()


class Pool:
    """Workers, each driven by a thread that gives it one job after the other.

    :param waiting: jobs, taken from the left; those of one line one after the other.
    :param settings: for all of them.
    """

    def __init__(self, waiting: deque[Sequence[Job]], settings: Settings) -> None:
        self._waiting, self._settings = waiting, settings
        self._outcomes: SimpleQueue[Outcome | None] = SimpleQueue()
        self._workers: set[Worker] = set()
        self._lock = threading.Lock()
        self._ending = False

    def outcomes(self, count: int) -> Iterator[Outcome]:
        """Work with `count` workers, and yield what comes of each job as soon as it is known.

        A worker that dies takes its job with it, and another goes on. If none can be started, jobs are left waiting.
        When a signal asks for the end, no more jobs are begun; what is written by then is yielded, all of it.
        """
        drivers = [threading.Thread(target=self._drive, daemon=True) for _ in range(count)]
        for driver in drivers:
            driver.start()
        try:
            while count:
                if interrupts.came():
                    self._end()
                with contextlib.suppress(Empty):
                    outcome = self._outcomes.get(timeout=_POLL)
                    if outcome is None:
                        count -= 1
                    else:
                        yield outcome
        finally:
            self._end()
            for driver in drivers:
                driver.join()

    def _end(self) -> None:
        with self._lock:
            self._ending = True
            for worker in self._workers:
                worker.end()

    def _drive(self) -> None:
        """Have jobs done until there are none, or the end is asked for."""
        worker = None
        try:
            while (line := self._next()) is not None:
                job, *later = line
                try:
                    worker = worker or self._started()
                    self._outcomes.put(worker.work(job, self._settings))
                except OSError:  # no process can be started: the others do it, or the process that waits
                    self._waiting.appendleft(line)
                    break
                except EOFError:
                    code, worker = self._ended(worker), None
                    if not self._ending:
                        self._outcomes.put(_died(job, code))
                if later:
                    self._waiting.appendleft(later)
            self._ended(worker)
        finally:
            self._outcomes.put(None)

    def _next(self) -> Sequence[Job] | None:
        try:
            return None if self._ending else self._waiting.popleft()
        except IndexError:
            return None

    def _started(self) -> Worker:
        with self._lock:
            if self._ending:
                raise EOFError
            worker = Worker()
            self._workers.add(worker)
            return worker

    def _ended(self, worker: Worker | None) -> int:
        if worker is None:
            return 0
        with self._lock:
            self._workers.discard(worker)
        worker.end()
        return worker.wait()


def _died(job: Job, code: int) -> Outcome:
    how = f"signal {-code}" if code < 0 else f"exit code {code}"
    message = f"{job.program}: its worker process ended ({how}), perhaps for lack of memory. Use fewer --jobs."
    return Outcome(str(job.program), FAILED, message=message)
