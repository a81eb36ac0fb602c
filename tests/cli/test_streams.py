"""Streams that are closed, full or absent: no fault, and the exit code is that of the command."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.places import CELL_FILE, SAMPLES

CONVERT = ("convert", SAMPLES / "pocket.nc", "--cell", CELL_FILE, "-o", "out")


def shell(command, folder, *arguments):
    words = " ".join(f"'{word}'" for word in (sys.executable, "-m", "postproc", *map(str, arguments)))
    return subprocess.run(["sh", "-c", f"{words} {command}"], cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_a_full_disk_under_stdout_loses_what_is_printed_and_nothing_else(tmp_path):
    done = shell("> /dev/full", tmp_path, *CONVERT)
    assert done.returncode == 0, done.stderr
    assert "could not be written (No space left on device)" in done.stderr
    assert (tmp_path / "out" / "pocket.src").is_file()


@pytest.mark.skipif(sys.platform == "win32", reason="a shell of Unix closes descriptors")
@pytest.mark.parametrize("closed", [">&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_closed_streams_are_no_fault(tmp_path, closed):
    done = shell(closed, tmp_path, "robots")
    assert done.returncode == 0
    assert "fault" not in done.stderr


def test_absent_streams_are_no_fault():
    code = "import sys; sys.stdin = sys.stdout = sys.stderr = None; from postproc.cli import main; main(['robots'])"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_quiet_prints_errors_alone(tmp_path):
    done = shell("--quiet", tmp_path, *CONVERT)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert (tmp_path / "out" / "pocket.src").is_file()
    done = shell("--quiet", tmp_path, "convert", "none.nc", "--cell", CELL_FILE)
    assert done.returncode == 1
    assert "none.nc" in done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize(("stdout", "reason"), [("> /dev/full", "No space left"), (">&-", "stdout is closed")])
def test_a_program_that_stdout_does_not_take_is_an_error(tmp_path, stdout, reason):
    done = shell(f"--quiet {stdout}", tmp_path, *CONVERT[:-1], "-")
    assert done.returncode == 1
    assert reason in done.stderr
