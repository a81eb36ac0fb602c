"""Whether the user can be asked on a terminal."""

from __future__ import annotations

import sys


def is_terminal() -> bool:
    """Return whether stdin is a terminal; False without stdin, as under pythonw."""
    return sys.stdin is not None and sys.stdin.isatty()
