"""A command as a process of a window: it ends when the window closes the pipe to it, or ends.

The pipe is the stdin of the process. The operating system closes it however the window ends, so that no command goes
on unseen. Windows has no signal by which another process ends in order; a closed pipe works on all systems.
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
"""Time in which the process finishes the files that it writes, before it is ended [s]."""


def _end_with_pipe(number: int) -> None:
    """Wait until a pipe is closed; then interrupt the main thread as SIGTERM does, and end the process after a while.

    :param number: file descriptor of the pipe.
    """
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
