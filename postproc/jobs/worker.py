"""A worker process: takes jobs from its standard input, gives outcomes to its standard output.

The pipe is the lifeline. When the other end is closed, on purpose or because the process there died in whatever way,
the worker stops computing at once, or finishes what it is writing, and ends. No signal and nothing shared is needed.
"""

from __future__ import annotations

import _thread
import logging
import os
import pickle
import signal
import sys
import threading
import traceback
from functools import lru_cache
from queue import SimpleQueue
from typing import BinaryIO

from postproc import interrupts
from postproc.cell import Cell
from postproc.jobs.conversion import convert_one, failure
from postproc.jobs.job import Job
from postproc.jobs.outcome import Outcome, Settings
from postproc.jobs.setup import load_setup
from postproc.robot import RobotModel

_Task = tuple[Job, Settings]


def main() -> None:
    """Work until there are no more jobs, and leave without tearing down."""
    outcomes = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever else may print must not come between outcomes
    logging.captureWarnings(True)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # also where the process that waits ignores it
    code = 0
    interrupts.leave_at_once()
    try:
        with interrupts.held_back():
            _serve(outcomes)
    except (KeyboardInterrupt, BrokenPipeError):
        code = 130
    except BaseException:
        traceback.print_exc()
        code = 1
    os._exit(code)


def _serve(outcomes: BinaryIO) -> None:
    tasks: SimpleQueue[_Task | None] = SimpleQueue()
    threading.Thread(target=_receive, args=(sys.stdin.buffer, tasks), daemon=True).start()
    while (task := tasks.get()) is not None and not interrupts.came():
        pickle.dump(_work(*task), outcomes)
        outcomes.flush()


def _receive(stream: BinaryIO, tasks: SimpleQueue[_Task | None]) -> None:
    """Pass tasks on as they come; at the end of the stream interrupt what is being worked on."""
    try:
        while True:
            tasks.put(pickle.load(stream))
    except (EOFError, OSError, pickle.UnpicklingError):
        tasks.put(None)
        _thread.interrupt_main()


@lru_cache(maxsize=1)
def _setup(settings: Settings) -> tuple[Cell, RobotModel]:
    return load_setup(settings)


def _work(job: Job, settings: Settings) -> Outcome:
    try:
        cell, robot = _setup(settings)
    except Exception as cause:
        return failure(job, cause)
    return convert_one(job, settings, cell, robot)
