"""Standard streams that may be closed, full or absent: text that cannot be printed must not stop a command."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any


class _LossyStream(io.RawIOBase):
    """A raw stream that drops bytes which its device does not take.

    :ivar failure: last error of the device; None: no bytes were dropped.
    """

    def __init__(self, stream: Any) -> None:
        """Write to the device of a text stream. The text stream is kept: with it the device would be closed."""
        super().__init__()
        self.stream, self.raw_stream = stream, _raw_stream(stream)
        self.failure: OSError | None = None

    def writable(self) -> bool:
        """Return True: the stream is for writing."""
        return True

    def isatty(self) -> bool:
        """Return whether the device is a terminal."""
        return bool(self.raw_stream.isatty())

    def fileno(self) -> int:
        """Return the file descriptor of the device."""
        number: int = self.raw_stream.fileno()
        return number

    def write(self, data: Any) -> int:
        """Write bytes and return their number; if the device fails, they are dropped and count as written.

        :raises BrokenPipeError: nobody reads the pipe any more: the command need not go on.
        """
        try:
            count: int | None = self.raw_stream.write(data)  # None: the device would block
        except BrokenPipeError:
            raise
        except OSError as cause:
            self.failure = cause
            return len(data)
        return len(data) if count is None else count


def _raw_stream(stream: Any) -> Any:
    """Return the raw stream under a text stream, buffered or not; None if it has no raw stream, as under tests."""
    buffer = getattr(stream, "buffer", None)
    raw = getattr(buffer, "raw", buffer)
    return raw if isinstance(raw, io.RawIOBase) else None


def replace_absent() -> None:
    """Replace standard streams that are None by the null device: under pythonw, as a service, or if they are closed."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w", encoding="utf-8"))  # noqa: PTH123, SIM115


def make_robust() -> _LossyStream | None:
    """Replace stdout by a stream that drops text which a full disk does not take.

    :returns: the stream, for `lost_output`; None if stdout stays as it is: on Windows, or without a raw stream.
    """
    raw = _raw_stream(sys.stdout)
    if raw is None or sys.platform == "win32":  # the console of Windows has another kind of stream
        return None
    stream = _LossyStream(sys.stdout)
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(stream),
        encoding=sys.stdout.encoding,
        errors="replace",
        line_buffering=sys.stdout.isatty(),
    )
    return stream


def lost_output(stream: _LossyStream | None) -> str | None:
    """Return a sentence if something could not be printed; None if everything was.

    :param stream: result of `make_robust`.
    """
    sys.stdout.flush()
    if stream is None or stream.failure is None:
        return None
    return f"What was to be printed could not be written ({stream.failure.strerror}). Files are those of a whole run."


def write_to_stdout(data: bytes) -> None:
    """Write a program to stdout, past the stream of `make_robust`: no byte of it may be dropped.

    :raises OSError: stdout is closed, or does not take all bytes.
    """
    raw = _raw_stream(sys.stdout)
    # the text stream of the device
    stream = raw.stream if isinstance(raw, _LossyStream) else sys.stdout
    if getattr(stream, "name", None) == os.devnull:  # stdout was None, see `replace_absent`
        raise OSError(errno.EBADF, "stdout is closed: the program could not be written there")
    sys.stdout.flush()
    if raw is None:
        sys.stdout.buffer.write(data)
        return
    with io.FileIO(raw.fileno(), "wb", closefd=False) as device:
        remaining_bytes = memoryview(data)
        while remaining_bytes:
            remaining_bytes = remaining_bytes[device.write(remaining_bytes) or 0 :]  # None: no byte was written
