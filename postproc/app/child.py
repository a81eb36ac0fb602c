"""The command line as a process of a window: it ends when the window closes its pipe, or is gone.

The pipe is its stdin. Whoever ends the window, a signal or the task manager, closes it: nothing goes on unseen. It is
the same on all systems: Windows has no signal that ends another process in order.
"""

from __future__ import annotations

import _thread
import os
import runpy
import signal
import sys
import threading
import time
from pathlib import Path

from postproc import interrupts

PATIENCE_S = 20.0
"""What is being written is finished in this time."""


def _end_with_pipe(number: int) -> None:
    """Wait for the end of the pipe, then end this process as a signal that asks for it does."""
    try:
        while os.read(number, 1):
            pass
    except OSError:
        pass
    _thread.interrupt_main(signal.SIGTERM)  # unlike os.kill, which on Windows ends a process at once
    time.sleep(PATIENCE_S)
    os._exit(128 + signal.SIGTERM)


if __name__ == "__main__":
    interrupts.leave_at_once()
    pipe = os.dup(0)
    sys.stdin = Path(os.devnull).open(encoding="utf-8")  # noqa: SIM115 - nobody answers questions
    threading.Thread(target=_end_with_pipe, args=(pipe,), daemon=True).start()
    runpy.run_module("postproc", run_name="__main__", alter_sys=True)
