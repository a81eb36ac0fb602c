"""Work on the chunks of one large array in two places at once: here and in a helper process."""

from __future__ import annotations

import atexit
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import get_context
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from postproc.memory import keep_freed

T = TypeVar("T")

_AHEAD = 2
"""Chunks that wait at the helper, so that it never does."""
_ROWS = 8192
"""Rows of a chunk: with their matrices they fit the cache."""


def chunk_count(count: int) -> int:
    """Return how many chunks `count` rows make; one, empty, for none."""
    return max(1, -(-count // _ROWS))


def chunk_rows(index: int) -> slice:
    """Return the rows of a chunk."""
    return slice(index * _ROWS, (index + 1) * _ROWS)


def chunks(count: int) -> Iterator[slice]:
    """Yield the rows of each chunk of `count` rows: several passes over a chunk cost little."""
    return map(chunk_rows, range(chunk_count(count)))


def without_gaps(rows: NDArray[np.int64]) -> NDArray[np.int64] | slice:
    """Return rows (n,) as a slice if each is the one behind that before: what they select is then not copied."""
    if len(rows) and (np.diff(rows) == 1).all():
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows


class Run(Protocol):
    """Calls a function for chunk 0…count − 1 of its arguments and yields the results in order."""

    def __call__(self, function: Callable[..., T], count: int, chunk: Callable[[int], tuple[Any, ...]]) -> Iterator[T]:
        """Call `function(*chunk(i))` for each i; a chunk is made only when it is its turn."""
        ...

    def later(
        self, function: Callable[..., T], count: int, chunk: Callable[[int], tuple[Any, ...]]
    ) -> Callable[[], Iterator[T]]:
        """Return what yields the results; they are worked on elsewhere meanwhile, or when they are asked for."""
        ...


class Here:
    """Work in this process."""

    def __call__(self, function: Callable[..., T], count: int, chunk: Callable[[int], tuple[Any, ...]]) -> Iterator[T]:
        """Work on one chunk after the other."""
        return (function(*chunk(index)) for index in range(count))

    def later(
        self, function: Callable[..., T], count: int, chunk: Callable[[int], tuple[Any, ...]]
    ) -> Callable[[], Iterator[T]]:
        """Return what works on the chunks when it is called."""
        return lambda: self(function, count, chunk)


class Shared:
    """Work in this process and in a helper.

    Functions and arguments must be picklable. An exception of any chunk is raised here; if the helper dies, its chunks
    are worked on here.
    """

    def __init__(self, helper: Executor) -> None:
        self._helper = helper
        self._promised: list[Future[Any]] = []

    def __call__(self, function: Callable[..., T], count: int, chunk: Callable[[int], tuple[Any, ...]]) -> Iterator[T]:
        """Work from the front here, and at the helper from the back once it is through with what was left to it."""
        waiting: list[Future[T]] = []
        done = 0
        try:
            while done + len(waiting) < count:
                while self._ahead(waiting) < _AHEAD and done + len(waiting) + 1 < count:
                    waiting.append(self._helper.submit(function, *chunk(count - len(waiting) - 1)))
                yield function(*chunk(done))
                done += 1
            while waiting:
                yield waiting[-1].result()
                done += 1
                waiting.pop()
        except BrokenExecutor:
            yield from here(function, count - done, lambda index: chunk(done + index))

    def _ahead(self, waiting: list[Future[T]]) -> int:
        """Return how many chunks the helper still has before it."""
        return sum(not future.done() for future in (*self._promised, *waiting))

    def later(
        self, function: Callable[..., T], count: int, chunk: Callable[[int], tuple[Any, ...]]
    ) -> Callable[[], Iterator[T]]:
        """Leave all chunks to the helper."""
        try:
            futures = [self._helper.submit(function, *chunk(index)) for index in range(count)]
        except BrokenExecutor:
            return here.later(function, count, chunk)
        self._promised = [*futures]

        def results() -> Iterator[T]:
            for index in range(count):
                try:
                    result = futures[index].result()
                except BrokenExecutor:
                    result = function(*chunk(index))
                yield result

        return results


here = Here()


@contextmanager
def helper_process(module: str, *, wanted: bool) -> Iterator[Run]:
    """Start a helper process that gets ready while this one goes on; without one if not wanted or on one core.

    :param module: what the helper imports first: the slow part of its start.
    """
    if not wanted or (os.cpu_count() or 1) < 2:
        yield here
        return
    helper = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_import, initargs=(module,))
    helper.submit(int)  # a pool starts its process with its first task
    try:
        yield Shared(helper)
    finally:
        helper.shutdown(cancel_futures=True)


def _import(module: str) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the process that waits
    atexit.register(os._exit, 0)  # the results are delivered: nobody need wait until all modules are torn down
    keep_freed()
    import_module(module)
