"""Whether the user can be asked."""

from __future__ import annotations

import sys


def is_terminal() -> bool:
    """Return whether stdin is a terminal; False where there is none, as under pythonw."""
    return sys.stdin is not None and sys.stdin.isatty()
