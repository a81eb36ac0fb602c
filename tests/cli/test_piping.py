"""`convert -` and `-o -`: programs through pipes."""

from __future__ import annotations

import subprocess
import sys

from tests.places import SAMPLES

CELL = ("--cell", SAMPLES / "cell_kr270.toml")


def run(folder, *arguments, stdin=b""):
    words = [sys.executable, "-m", "postproc", *map(str, arguments)]
    return subprocess.run(words, cwd=folder, input=stdin, capture_output=True, check=False)


def without_origin(text):
    return [line for line in text.splitlines() if not line.startswith(b";POSTPROC")]


def test_a_program_through_a_pipe_is_that_of_files(tmp_path):
    source = (SAMPLES / "pocket.nc").read_bytes()
    done = run(tmp_path, "convert", "-", "--dialect", "gcode", "--name", "pocket", *CELL, stdin=source)
    assert done.returncode == 0, done.stderr
    assert b"May be run." in done.stderr
    written = run(tmp_path, "convert", SAMPLES / "pocket.nc", *CELL, "-o", "out")
    assert written.returncode == 0
    assert without_origin(done.stdout) == without_origin((tmp_path / "out" / "pocket.src").read_bytes())
    to_stdout = run(tmp_path, "convert", SAMPLES / "pocket.nc", *CELL, "-o", "-")
    assert to_stdout.stdout == (tmp_path / "out" / "pocket.src").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]


def test_stdin_without_a_format_or_with_a_fault_writes_nothing(tmp_path):
    done = run(tmp_path, "convert", "-", *CELL, stdin=b"G0 X1")
    assert (done.returncode, done.stdout) == (2, b"")
    assert b"--dialect" in done.stderr
    done = run(tmp_path, "convert", "-", "--dialect", "gcode", *CELL, stdin=b"G21\nG65 P9\n")
    assert (done.returncode, done.stdout) == (1, b"")
    assert b":2" in done.stderr
