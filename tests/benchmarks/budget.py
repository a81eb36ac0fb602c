"""Where the processor's time of one `convert` goes, by stage, without a change of the package.

Run: python -m tests.benchmarks.budget PART --cell CELL -o OUT

A timer interrupts the process every two milliseconds of its processor time; the time since the interrupt before is
counted for the innermost module on the stack that is named in `STAGES`. Prints JSON: stage → seconds.
"""

from __future__ import annotations

import contextlib
import json
import signal
import sys
import time
from collections import Counter
from types import FrameType

STAGES = {
    "importlib": "start",
    "/dialects/gcode/reader.py": "read",
    "/dialects/krl/read/": "read",
    "/toolpath/": "path and forces",
    "/under_load": "path and forces",
    "/forces/": "path and forces",
    "/kinematics/": "kinematics",
    "/elastostatics/": "equilibrium",
    "/correction/checks.py": "checks",
    "/correction/inspection.py": "checks",
    "/correction/targets.py": "targets",
    "/dialects/krl/write/": "write",
    "/provenance.py": "write",
    "/correction/verify.py": "simulate",
    "/report/csv_files.py": "CSV",
    "/report/": "page",
    "/files/": "files",
    "/jobs/output_plan.py": "files",
}
"""Part of a module's path → its stage."""
WITHIN = {
    "equilibrium": {"kinematics": "equilibrium"},
    "checks": {"kinematics": "checks", "path and forces": "checks"},
    "simulate": {
        "kinematics": "simulate",
        "equilibrium": "simulate",
        "path and forces": "simulate",
        "read": "read back",
    },
    "read back": dict.fromkeys(("read", "kinematics", "path and forces"), "read back"),
    "write": {"read": "write"},
    "read": {"kinematics": "read"},
}
"""Stage → what stages called by it count as."""
ORDER = (
    "start", "read", "path and forces", "kinematics", "equilibrium", "checks", "targets", "write", "read back",
    "simulate", "CSV", "page", "files", "rest",
)  # fmt: skip
_INTERVAL = 0.002


def stage(frame: FrameType | None) -> str:
    """Return the stage that a stack belongs to."""
    found = "rest"
    while frame is not None:
        name = frame.f_code.co_filename
        own = next((value for part, value in STAGES.items() if part in name), None)
        if own == "start":
            return own
        if own is not None:
            found = WITHIN.get(own, {}).get(found, own if found == "rest" else found)
        frame = frame.f_back
    return found


def main() -> None:
    """Convert one program and print where the time went."""
    spent: Counter[str] = Counter({"start": int(1e9 * time.process_time())})
    last = time.process_time_ns()

    def count(_signal: int, frame: FrameType | None) -> None:
        nonlocal last
        now = time.process_time_ns()
        spent[stage(frame)] += now - last
        last = now

    signal.signal(signal.SIGPROF, count)
    signal.setitimer(signal.ITIMER_PROF, _INTERVAL, _INTERVAL)
    from postproc.cli import main as postproc

    sys.argv.insert(1, "convert")
    with contextlib.suppress(SystemExit):
        postproc()
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    sys.stderr.write(json.dumps({name: spent[name] / 1e9 for name in ORDER}) + "\n")


if __name__ == "__main__":
    main()
