"""The traceback of a fault of postproc in a file, to report the fault with."""

from __future__ import annotations

import os
import tempfile


def write_fault(traceback: str) -> str:
    """Write a traceback into a new file in the folder for temporary files; return its path.

    :return: empty: it could not be written.
    """
    try:
        handle, path = tempfile.mkstemp(prefix="postproc-fault-", suffix=".log")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(traceback)
    except OSError:
        return ""
    return path
