"""How far a command is: a bar on a terminal, or lines for a program that started the command.

With ``POSTPROC_PROGRESS=lines`` in the environment, stderr gets lines such as ``␞progress 0.42 places``: the record
separator (U+001E), the share done (``-``: unknown), what it counts. The window reads them.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator

VARIABLE, LINES = "POSTPROC_PROGRESS", "lines"
MARK = "\x1eprogress"
_UNKNOWN = "-"
"""Share of a step that cannot be counted."""
_STEP = 0.01
"""Smallest change of the share that is worth a line (assumed)."""


@contextlib.contextmanager
def show(label: str) -> Iterator[Callable[[int, int], None] | None]:
    """Yield the function that shows how many of a number are done; None where nobody looks.

    :param label: what is counted, such as ``"places"``.
    """
    if as_lines():
        write_line = line_writer()
        yield lambda count, total: write_line(label, count / max(total, 1))
    elif not sys.stderr.isatty():
        yield None
    else:
        from rich.console import Console
        from rich.progress import Progress

        with Progress(console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(label)
            yield lambda count, total: bar.update(task, completed=count, total=total)


def as_lines() -> bool:
    """Return whether a program that started the command reads its progress."""
    return os.environ.get(VARIABLE) == LINES


def line_writer() -> Callable[[str, float], None]:
    """Return the function that writes a step and the share of it that is done, 0 to 1, as a line to standard error."""
    last_step, last_share = "", 0.0

    def write_line(step: str, share: float) -> None:
        """Write a line if the step is another one, the share has changed enough, or the step is done."""
        nonlocal last_step, last_share
        if step == last_step and abs(share - last_share) < _STEP and share < 1.0:
            return
        last_step, last_share = step, share
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.write(f"{MARK} {min(max(share, 0.0), 1.0):.3f} {step}\n")
            sys.stderr.flush()

    return write_line


def write_step(name: str) -> None:
    """Write a line of progress to stderr: a step begins, and how much of it is done is unknown.

    A closed stderr is ignored.
    """
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(f"{MARK} {_UNKNOWN} {name}\n")
        sys.stderr.flush()


def parse_progress(line: str) -> tuple[float | None, str] | None:
    """Return the share (None: unknown) and the step of a line of progress; None for any other line."""
    words = line.rstrip("\r\n").split(" ", 2)
    if len(words) != 3:
        return None
    mark, share, step = words
    if mark != MARK:
        return None
    if share == _UNKNOWN:
        return None, step
    try:
        return float(share), step
    except ValueError:
        return None
