"""rs274, the stand-alone interpreter of LinuxCNC, as the oracle for G-code: it prints canonical moves."""

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from postproc.frames import Array

RS274 = shutil.which("rs274")
needs_rs274 = pytest.mark.skipif(
    RS274 is None and not os.environ.get("CI"),
    reason="rs274 is not installed (Debian package linuxcnc-uspace); in CI it must be",
)


class RejectedError(Exception):
    """rs274 does not accept a program."""


class Move(NamedTuple):
    """A canonical move of rs274, mm; `rotation` > 0 is counterclockwise and counts turns."""

    command: str
    end: Array
    centre: Array | None
    plane: str
    rotation: int
    feed: float


def canonical(text: str) -> list[Move]:
    """Run rs274 on a program (that ends with M2) and return its moves."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "tool.tbl").write_text("".join(f"T{n} P{n} D0 Z0\n" for n in range(1, 10)))
        (folder / "part.ngc").write_text(text, newline="")
        result = subprocess.run(
            [RS274 or "rs274", "-g", "-t", "tool.tbl", "-v", "/dev/null", "part.ngc"],
            cwd=folder,
            env={**os.environ, "HOME": name},  # it keeps a memory map there
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            timeout=600,
        )
    if result.returncode:
        assert result.returncode == 1, result
        raise RejectedError(result.stdout + result.stderr)
    return list(_moves(result.stdout))


def accepts(text: str) -> bool:
    """Return whether rs274 accepts a program."""
    try:
        canonical(text)
    except RejectedError:
        return False
    return True


def _moves(output: str) -> Iterator[Move]:
    unit, plane, feed, end = 1.0, "XY", 0.0, np.zeros(3)
    for command, arguments in re.findall(r"^ *\d+ N\S* +(\w+)\((.*)\)$", output, re.MULTILINE):
        numbers = [float(n) for n in re.findall(r"-?\d+(?:\.\d+)?", arguments)]
        if command == "USE_LENGTH_UNITS":
            unit = {"CANON_UNITS_MM": 1.0, "CANON_UNITS_INCHES": 25.4}[arguments]
        elif command == "SELECT_PLANE":
            plane = arguments[-2:]
        elif command == "SET_FEED_RATE":
            feed = numbers[0] * unit
        elif command in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED"):
            end = np.array(numbers[:3]) * unit
            yield Move(command, end, None, plane, 0, feed)
        elif command == "ARC_FEED":
            start, order = end, {"XY": [0, 1, 2], "XZ": [2, 0, 1], "YZ": [1, 2, 0]}[plane]
            end, centre = np.empty(3), np.empty(3)
            end[order] = np.array([numbers[0], numbers[1], numbers[5]]) * unit
            centre[order] = np.array([numbers[2], numbers[3], start[order[2]] / unit]) * unit
            yield Move(command, end, centre, plane, int(numbers[4]), feed)
