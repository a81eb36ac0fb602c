"""`--dialect`: programs whose extension is not known are read as convert, compare and watch are told."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from postproc.jobs import watching
from tests.commands import invoke, run
from tests.places import ABB_CELL_FILE, CELL_FILE, SAMPLES

PART = "G21 G90\nG0 X0 Y0 Z20\nG1 Z-1 F300\nX40\nG0 Z20\nM30\n"


def convert(program: Path, *options: object, cell: Path = CELL_FILE) -> Path:
    """Convert a program into the folder out; return the folder."""
    folder = program.parent / "out"
    run("convert", program, *options, "-o", folder, cell=cell)
    return folder


def compared_pairs(nominal: Path, corrected: Path, *options: object, cell: Path = CELL_FILE) -> int:
    """Compare two programs; return the number of their pairs."""
    done = run(
        "compare", nominal, corrected, *options, "--json", "-o", nominal.parent / "compared", cell=cell, code=(0, 3)
    )
    return int(json.loads(done.stdout)["pairs"])


def test_compare_reads_a_nominal_program_of_unknown_extension(tmp_path):
    nominal = shutil.copy(SAMPLES / "pocket.nc", tmp_path / "pocket.prg")
    folder = convert(nominal, "--dialect", "gcode")
    assert compared_pairs(nominal, folder / "pocket.src", "--dialect", "gcode") > 100


def test_compare_reads_both_programs_of_unknown_extension(tmp_path):
    program = Path(shutil.copy(SAMPLES / "pocket.nc", tmp_path))
    folder = convert(program, "--to", "rapid", "--nominal", cell=ABB_CELL_FILE)
    nominal = (folder / "pocket.mod").rename(tmp_path / "nominal.prg")
    folder = convert(program, "--to", "rapid", "--overwrite", cell=ABB_CELL_FILE)
    written = (folder / "pocket.mod").rename(tmp_path / "pocket.prg")
    assert compared_pairs(nominal, written, "--dialect", "rapid", cell=ABB_CELL_FILE) > 100


def test_compare_reads_a_second_program_of_unknown_extension_beside_a_known_one(tmp_path):
    nominal = Path(shutil.copy(SAMPLES / "pocket.nc", tmp_path))
    written = (convert(nominal) / "pocket.src").rename(tmp_path / "pocket.txt")
    assert compared_pairs(nominal, written, "--dialect", "krl") > 100


def test_compare_takes_the_dialect_for_the_nominal_program_if_both_extensions_are_known(tmp_path):
    nominal = tmp_path / "saddle.nc"
    shutil.copy(SAMPLES / "gallery" / "saddle.apt", nominal)
    cell = SAMPLES / "gallery" / "cell_five_axes.toml"
    folder = convert(nominal, "--dialect", "apt", cell=cell)
    assert compared_pairs(nominal, folder / "saddle.src", "--dialect", "apt", cell=cell) > 100


def test_compare_without_a_dialect_says_how_to_state_it(tmp_path):
    nominal = shutil.copy(SAMPLES / "pocket.nc", tmp_path / "pocket.prg")
    done = invoke("compare", nominal, tmp_path / "pocket.src", cell=CELL_FILE)
    assert done.exit_code == 1
    assert "--dialect gcode" in done.output.replace("\n", " ")


def watched_programs(monkeypatch, pattern: Path, count: int, *options: object) -> list[str]:
    """Watch a pattern until a number of programs is converted; return their names as the command prints them."""
    endless_watch = watching.watch

    def watch(*arguments, stop, **keywords):
        for number, pair in enumerate(endless_watch(*arguments, stop=stop, **keywords), 1):
            yield pair
            if number == count:
                stop.set()

    monkeypatch.setattr(watching, "QUIET", 0.05)
    monkeypatch.setattr(watching, "watch", watch)
    done = invoke("watch", pattern, *options, "--json", cell=CELL_FILE)
    assert f"watching {pattern}" in done.stderr
    return [Path(json.loads(line)["program"]).name for line in done.stdout.splitlines()]


@pytest.mark.parametrize(("pattern", "programs"), [("*.prg", ["a.prg", "b.prg"]), ("a*.prg", ["a.prg"])])
def test_watch_converts_programs_of_unknown_extension_that_a_pattern_names(tmp_path, monkeypatch, pattern, programs):
    for name in ("a.prg", "b.prg", "notes.txt"):
        (tmp_path / name).write_text(PART)
    names = watched_programs(monkeypatch, tmp_path / pattern, len(programs), "--dialect", "gcode")
    assert names == programs
    assert sorted(path.name for path in (tmp_path / "corrected").glob("*.src")) == [
        f"{Path(name).stem}.src" for name in programs
    ]
