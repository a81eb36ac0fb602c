"""Ctrl-C and the signals that end a process: heard where nothing can be left half-done, held back elsewhere.

A `KeyboardInterrupt` that may come between any two statements cannot be cleaned up after with certainty. So it comes
only inside `allow`; inside `defer` a signal is noted, and is raised when all that belongs together is done.

Signals reach the main thread alone; in other threads nothing here does anything.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

_ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))
"""Signals that ask a process to end: Ctrl-C, kill, the terminal closed, Ctrl-Break of Windows."""

_Handler = Callable[[int, FrameType | None], object]


class Interrupt(KeyboardInterrupt):
    """A signal asked for the end; `number` says which."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class _State:
    """State of this process.

    :cvar is_deferring: True inside `defer`: signals are noted.
    :cvar is_raising: True inside `allow`: a signal is raised at once.
    :cvar number: the signal that was noted; None: there was none.
    """

    is_deferring = False
    is_raising = False
    number: int | None = None


def leave_at_once() -> None:
    """Let Ctrl-C end the process with one line and no traceback, until the work begins.

    For a process that is ours alone. Signals that its starter had it ignore (nohup) stay ignored.
    """
    for number in _ENDING:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _leave)


@contextlib.contextmanager
def defer() -> Iterator[None]:
    """Note signals that ask for the end; raise them when all that belongs together is done.

    :raises Interrupt: a signal came.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    if not _State.is_deferring:
        _State.number = None
        with _handle_signals(lambda handler: handler in (_leave, signal.default_int_handler), _note):
            _State.is_deferring = True
            try:
                yield
            finally:
                number, _State.number, _State.is_deferring = _State.number, None, False
                if number is not None:
                    raise Interrupt(number)
        return
    # inside another `defer`, which raises the signal at its end; only an `allow` around this one is suspended
    was_raising, _State.is_raising = _State.is_raising, False
    try:
        yield
    finally:
        if was_raising:
            _begin_raising()


@contextlib.contextmanager
def allow() -> Iterator[None]:
    """Inside `defer`: raise a signal at once, but only once, so that nothing disturbs the cleaning up.

    It is raised again at the end where the exception got lost (a destructor and some libraries swallow it) or became
    another one.

    :raises Interrupt: a signal came.
    """
    if not _State.is_deferring or threading.current_thread() is not threading.main_thread():
        yield
        return
    was_raising = _State.is_raising
    try:
        _begin_raising()
        yield
    finally:
        _State.is_raising = False
        if _State.number is not None:
            raise Interrupt(_State.number)
        _State.is_raising = was_raising


@contextlib.contextmanager
def interruptible_search() -> Iterator[None]:
    """Let Ctrl-C raise `KeyboardInterrupt`, for a search that then returns the best it has."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is not _leave:
        yield
        return
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, _leave)


def is_pending() -> bool:
    """Return whether a signal has been noted."""
    return _State.number is not None


@contextlib.contextmanager
def _handle_signals(is_replaceable: Callable[[object], bool], handler: _Handler) -> Iterator[None]:
    """Inside the context, handle signals that ask for the end; other handlers than replaceable ones stay.

    :param is_replaceable: whether a present handler may be replaced.
    """
    handlers = {number: signal.getsignal(number) for number in _ENDING}
    numbers = [number for number in _ENDING if is_replaceable(handlers[number])]
    for number in numbers:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, handlers[number])


def _leave(number: int, _frame: FrameType | None) -> None:
    """Handle a signal before the work begins: end the process with one line."""
    with contextlib.suppress(OSError):
        os.write(2, b"Interrupted.\n")
    os._exit(128 + number)


def _note(number: int, _frame: FrameType | None) -> None:
    """Handle a signal during the work: raise it where it is expected, else keep it for later.

    :raises Interrupt: inside `allow`.
    """
    _State.number = number
    if _State.is_raising:
        _State.is_raising = False
        raise Interrupt(number)


def _begin_raising() -> None:
    """Let signals raise `Interrupt` from now on.

    :raises Interrupt: a signal has come already.
    """
    _State.is_raising = True
    if _State.number is not None:
        _State.is_raising = False
        raise Interrupt(_State.number)
