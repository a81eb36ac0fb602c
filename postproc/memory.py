"""How the process deals with freed memory."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Numbers of glibc's parameters (malloc.h)."""
_LARGE = 1 << 30


def keep_freed() -> None:
    """Keep freed memory for what comes next, on Linux with glibc; elsewhere do nothing.

    Left to itself, glibc gives large arrays back to the system when they are freed, and the system clears them before
    it hands them out again: for arrays of 10⁵ poses this costs more than to compute them. The process then needs as
    much memory as it did at its peak until it ends (mallopt(3)).
    """
    if sys.platform != "linux":
        return
    with suppress(OSError, AttributeError):
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_THRESHOLD, _LARGE)
        library.mallopt(_TRIM_THRESHOLD, _LARGE)
