"""Ctrl-C at the right moment: never between two files of one program, never twice in one process."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

from postproc.batch.outcome import Outcome


class Interrupted(KeyboardInterrupt):
    """An interrupt that came while a program was being written; it is written now, `outcome` says what."""

    def __init__(self, outcome: Outcome) -> None:
        super().__init__()
        self.outcome = outcome


@contextlib.contextmanager
def held_back() -> Iterator[list[int]]:
    """Hold interrupts back; the list yielded holds those that came. In other threads than the main one: nothing."""
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield came
        return
    before = signal.signal(signal.SIGINT, lambda number, _frame: came.append(number))
    try:
        yield came
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def ignored_by_children() -> Iterator[None]:
    """Ignore interrupts while worker processes start: they inherit it, and do not die noisily while they load."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def be_deaf() -> None:
    """Ignore interrupts in this process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def hear_once() -> None:
    """Let the next interrupt end the work in this process; those after it must not disturb the cleaning up."""
    signal.signal(signal.SIGINT, _end)


def _end(_number: int, _frame: FrameType | None) -> None:
    be_deaf()
    raise KeyboardInterrupt
