"""The comparison of collected programs with rs274, and some of the programs that LinuxCNC installs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.attack.collected import Outcome, _as_rs274_takes_it, difference, read_or_error, shop, tried
from tests.oracle.rs274 import canonical, needs_rs274

pytestmark = needs_rs274

PROGRAM = (
    "G21 G90 G17 G98\nT3 M6\nM3 S900\nG0 X0 Y0 Z20\nZ2\nG1 Z-1 F100\nX10 F400\nG2 X20 Y10 I0 J10\nG0 Z20\nX40 Y0\n"
    "Z5\nG81 Z-4 R1 F90\nX50\nG80\nG53 G0 Z0\nG0 X5\nZ1\nG1 Z-2\nM2\n"
)
CHANGES = {
    "an end": ("X10 F400", "X10.001 F400", "end"),
    "a feed": ("X10 F400", "X10 F401", "feed"),
    "a centre": ("G2 X20 Y10 I0 J10", "G2 X20 Y10 I10 J0", "centre"),
    "a direction": ("G2 X20", "G3 X20", "turns the other way"),
    "a line": ("G2 X20 Y10 I0 J10", "G1 X20 Y10", "an arc on one side only"),
    "a rapid": ("G0 Z20\nX40 Y0", "G0 Z19\nX40 Y0", "rapids"),
    "a rapid missing": ("Z20\nX40 Y0\nZ5", "Z20\nX40 Y0", "rapids"),
    "a rapid as a cut": ("G0 Z20\nX40", "G1 Z20\nG0 X40", "cut 4 "),
    "a place after the retract": ("G0 X5\nZ1", "G0 X6\nZ1", "end"),
    "a tool": ("T3", "T4", "switched"),
    "a spindle": ("S900", "S901", "switched"),
    "a hole missing": ("X50\n", "", ""),
    "the last cut": ("G1 Z-2\n", "", "cuts instead of"),
}


def differing(tmp_path: Path, text: str, other: str) -> str:
    path = tmp_path / "part.ngc"
    path.write_text(text)
    program = read_or_error(path, shop(text))
    assert not isinstance(program, Exception)
    return difference(program, canonical(other), text)


def test_the_same_program_is_the_same(tmp_path):
    assert differing(tmp_path, PROGRAM, PROGRAM) == ""


@pytest.mark.parametrize(("old", "new", "said"), CHANGES.values(), ids=CHANGES)
def test_what_differs_is_noticed(tmp_path, old, new, said):
    assert old in PROGRAM
    found = differing(tmp_path, PROGRAM, PROGRAM.replace(old, new))
    assert found
    assert said in found


@pytest.mark.parametrize(
    ("text", "outcome"),
    [
        (PROGRAM, Outcome("same")),
        ("G0 X0 Y0 Z5 U0\nG1 X9 F90\nM2\n", "not read by rs274"),
        ("G0 X0 Y0 Z5\nG1 X9 F90\nM64 P0\nM2\n", Outcome("refused here only", "M64 is not supported")),
        ("G0 Z5\nG0 Y4\nG1 Z-9 F90\nG0 Z5\nG0 X1 Y4\nG1 Z-3\nM2\n", Outcome("same")),
        ("G0 X0 Y0 Z5\nG1 X9 F90\nG200\nM2\n", Outcome("refused by both", "G200 is not known")),
        ("G0 X0 Y0 Z5\nG1 X9 A10 F90\nZ1\nM2\n", Outcome("same")),
    ],
)
def test_what_came_of_a_program_is_said(tmp_path, text, outcome):
    path = tmp_path / "part.ngc"
    path.write_text(text)
    bare, found = tried(path)
    assert outcome in (found, found.word)
    assert bare == (
        "refused" if "refused" in found.word or "A10" in text or text[:5] == "G0 Z5" or "G53" in text else "read"
    )


@pytest.mark.parametrize("n", [1, 20, 40])
def test_lines_shorter_than_the_digits_of_rs274_are_left_out_on_both_sides(tmp_path, n):
    x = [0.0, *np.cumsum(np.tile([3e-5, 1.3e-4, 6e-5, 9e-5], 12)).tolist(), 0.5, 0.7]
    lines = [f"G1 X{one:.6f} Y{0.0809 + 0.4 * one:.6f}" for one in x]
    text = "\n".join(["G20 G90 G17 F6", "G0 X0 Y0 Z0", *lines, "M2\n"])
    assert differing(tmp_path, text, text) == ""
    wrong = text.replace(lines[n], f"G1 X{x[n]:.6f} Y{0.0819 + 0.4 * x[n]:.6f}")
    assert "end" in differing(tmp_path, text, wrong)
    assert "end" in differing(tmp_path, wrong, text)


def test_moves_that_begin_at_start_here_and_at_zero_there_are_the_same(tmp_path):
    text = "G21 G90\nG53 G0 Z0\nG1 X20 Y5 F900\nG0 Z9\nG1 Z-2 F100\nX50\nG53 G0 Z0\nG1 X7 F900\nM2\n"
    assert differing(tmp_path, text, text) == ""
    for line, wrong in (("X20 Y5", "X21 Y5"), ("Z-2", "Z-3"), ("X50", "X51"), ("X7", "X8")):
        assert "end" in differing(tmp_path, text, text.replace(line, wrong))


def test_what_rs274_refuses_without_an_effect_is_left_out_for_it(tmp_path):
    text = (
        "\ufeffG21 G90 G50\nG0 X0 Y0 Z20\nG2 X5 I2.5 K0. F90\nN4 G0 G91 G28 Z0.\nG90 G0 Z9\nG98 G81 X5 Y5 Z-1 R2\nG80\n"
        "N8 Z30.\nX6 (Z)\nG1 Z2\nX9\n%\n"
    )
    path = tmp_path / "part.ngc"
    path.write_text(text, encoding="utf-8")
    assert tried(path)[1] == Outcome("same")
    changed = canonical(_as_rs274_takes_it(path.read_bytes().decode("latin-1").replace("X9", "X8")) + "M2\n")
    program = read_or_error(path, shop(text))
    assert not isinstance(program, Exception)
    assert "end" in difference(program, changed, text)


def test_numbers_of_six_digits_are_lines_too(tmp_path):
    text = "G0 X0 Y0 Z5\nN100110 G1 X9 F90\nN1001100 G1 X5\nM2\n"
    assert differing(tmp_path, text, text) == ""
    assert len(canonical(text)) == 3


@pytest.mark.parametrize("name", ["arcspiral", "b-index", "cds", "daisy", "flowsnake", "skeleton", "tort"])
def test_programs_that_linuxcnc_installs_are_read_as_rs274_reads_them(name):
    assert tried(Path(f"/usr/share/linuxcnc/ncfiles/{name}.ngc"))[1] == Outcome("same")
