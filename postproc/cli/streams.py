"""Standard streams that may be closed, full or absent: what cannot be printed is no fault and changes nothing."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any


class _Sink(io.RawIOBase):
    """A raw stream that drops what its device does not take, and remembers why.

    A broken pipe is raised on: its reader has seen enough.
    """

    def __init__(self, stream: Any) -> None:
        """Take the place of a text stream, which is kept: with it the device would be closed."""
        super().__init__()
        self.stream, self.raw_stream = stream, _raw(stream)
        self.failure: OSError | None = None

    def writable(self) -> bool:
        """Return True."""
        return True

    def isatty(self) -> bool:
        """Return whether the device is a terminal."""
        return bool(self.raw_stream.isatty())

    def fileno(self) -> int:
        """Return the number of the file underneath."""
        number: int = self.raw_stream.fileno()
        return number

    def write(self, data: Any) -> int:
        """Write bytes; all of them count as written if the device is full."""
        try:
            count: int | None = self.raw_stream.write(data)
        except BrokenPipeError:
            raise
        except OSError as cause:
            self.failure = cause
            return len(data)
        return len(data) if count is None else count


def _raw(stream: Any) -> Any:
    """Return the raw stream under a text stream, also where Python does not buffer; None: there is none."""
    buffer = getattr(stream, "buffer", None)
    raw = getattr(buffer, "raw", buffer)
    return raw if isinstance(raw, io.RawIOBase) else None


def replace_absent() -> None:
    """Replace streams that are absent: under pythonw, as a service, or with a closed descriptor."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w", encoding="utf-8"))  # noqa: PTH123, SIM115


def make_robust() -> _Sink | None:
    """Let stdout drop what a full disk does not take.

    :returns: what knows of lost output; None where stdout stays as it is.
    """
    raw = _raw(sys.stdout)
    if raw is None or sys.platform == "win32":  # its console has a stream of its own kind
        return None
    sink = _Sink(sys.stdout)
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(sink),
        encoding=sys.stdout.encoding,
        errors="replace",
        line_buffering=sys.stdout.isatty(),
    )
    return sink


def lost_output(sink: _Sink | None) -> str | None:
    """Return a sentence if something could not be printed."""
    sys.stdout.flush()
    if sink is None or sink.failure is None:
        return None
    return f"What was to be printed could not be written ({sink.failure.strerror}). Files are those of a whole run."


def write_to_stdout(data: bytes) -> None:
    """Write a program to stdout; unlike what is printed, it may not get lost.

    :raises OSError: stdout is closed, or does not take all of it.
    """
    raw = _raw(sys.stdout)
    stream = raw.stream if isinstance(raw, _Sink) else sys.stdout
    if getattr(stream, "name", None) == os.devnull:  # see `replace_absent`
        raise OSError(errno.EBADF, "stdout is closed: the program could not be written there")
    sys.stdout.flush()
    if raw is None:
        sys.stdout.buffer.write(data)
        return
    with io.FileIO(raw.fileno(), "wb", closefd=False) as device:
        remaining_bytes = memoryview(data)
        while remaining_bytes:
            remaining_bytes = remaining_bytes[device.write(remaining_bytes) or 0 :]
