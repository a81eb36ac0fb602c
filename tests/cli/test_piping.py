"""`convert -` and `-o -`: programs through pipes."""

from __future__ import annotations

from tests.commands import CELL_OPTION
from tests.places import SAMPLES
from tests.processes import run_process


def without_origin(text):
    return [line for line in text.splitlines() if not line.startswith(b";POSTPROC")]


def test_a_program_through_a_pipe_is_that_of_files(tmp_path):
    source = (SAMPLES / "pocket.nc").read_bytes()
    done = run_process(
        "convert", "-", "--dialect", "gcode", "--name", "pocket", *CELL_OPTION, text=False, cwd=tmp_path, input=source
    )
    assert done.returncode == 0, done.stderr
    assert b"May be run." in done.stderr
    written = run_process("convert", SAMPLES / "pocket.nc", *CELL_OPTION, "-o", "out", text=False, cwd=tmp_path)
    assert written.returncode == 0
    assert without_origin(done.stdout) == without_origin((tmp_path / "out" / "pocket.src").read_bytes())
    to_stdout = run_process("convert", SAMPLES / "pocket.nc", *CELL_OPTION, "-o", "-", text=False, cwd=tmp_path)
    assert to_stdout.stdout == (tmp_path / "out" / "pocket.src").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]


def test_stdin_without_a_format_or_with_a_fault_writes_nothing(tmp_path):
    done = run_process("convert", "-", *CELL_OPTION, text=False, cwd=tmp_path, input=b"G0 X1")
    assert (done.returncode, done.stdout) == (2, b"")
    assert b"--dialect" in done.stderr
    done = run_process(
        "convert", "-", "--dialect", "gcode", *CELL_OPTION, text=False, cwd=tmp_path, input=b"G21\nG65 P9\n"
    )
    assert (done.returncode, done.stdout) == (1, b"")
    assert b":2" in done.stderr
