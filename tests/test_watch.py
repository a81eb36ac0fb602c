"""`postproc watch`: programs are converted as they arrive, each once, whatever happens to files, folder and process.

python -m tests.test_watch [--files 500] [--kills 5] [--seed 1]        # on demand: more files, killed more often
"""

from __future__ import annotations

import argparse
import http.client
import json
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from threading import Event, Thread

import pytest

from postproc.errors import InputError, PostprocError
from postproc.jobs import Settings, convert_all, find_jobs, inputs, watching
from postproc.jobs.watching import server
from tests.commands import invoke
from tests.html_page import read_page
from tests.places import CELL_FILE, ROOT

PART = "G21 G90\nG0 X0 Y0 Z20\nG1 Z-1 F300\nX{x}\nG0 Z20\nM30\n"


@pytest.fixture
def watcher(tmp_path, monkeypatch):
    (tmp_path / "in").mkdir()
    said: list[str] = []
    monkeypatch.setattr(watching, "SCAN", 0.02)

    def make(cell=CELL_FILE, forces=None, **stated):
        said.clear()
        settings, options = Settings(cell, **stated), {} if forces is None else {"forces": forces}
        known = watching._Watcher(tmp_path / "in", tmp_path / "out", settings, options, 1, said.append)
        known.said = said
        return known

    return make


def converted(known, seconds=(0.0, 1.1)) -> list[str]:
    """Scan at some times; return the programs that were converted."""
    done = []
    for moment in seconds:
        ready = known.scan(1e6 + moment)
        done += [Path(outcome.program).name for outcome, _ in known.convert(ready)] if ready else []
    return done


def put(folder: Path, name: str, text: str) -> Path:
    path = folder / "in" / name
    path.write_text(text)
    return path


PROCESS = """[material]
name = "al_7075_hss"
[tools.default]
diameter_mm = {diameter}
flutes = 2
[stock]
box = {{ X = [-10, 20], Y = [-10, 10], Z = [-5, 0] }}
resolution_mm = 1
"""
MILLED = "G21 G90\nT1 M6\nS9000 M3\nG0 X-20 Y0 Z20\nG0 Z-1\nG1 X30 F300\nG0 Z20\nM30\n"


def process_stated(folder: Path) -> str:
    """The process that the report of a.nc was made with."""
    return json.loads((folder / "out" / "a.report.json").read_bytes())["inputs"]["forces"]


def test_a_program_has_the_process_of_its_name_else_that_of_all(watcher, tmp_path):
    """The rule of the window: NAME.process.toml of the results, else --process, else process.toml of the results."""
    (tmp_path / "out").mkdir()
    own_path, shared_path = tmp_path / "out" / "a.process.toml", tmp_path / "out" / "process.toml"
    stated_path = tmp_path / "stated.toml"
    sums = []
    for path, diameter in ((shared_path, 8), (stated_path, 10), (own_path, 12)):
        path.write_text(PROCESS.format(diameter=diameter))
        sums.append(inputs.sum_of(inputs.force_inputs(path)))
    known = watcher(forces=stated_path)
    put(tmp_path, "a.nc", MILLED)
    assert converted(known) == ["a.nc"]
    assert process_stated(tmp_path) == sums[2]
    own_path.unlink()
    assert converted(known, (3.0, 5.0)) == ["a.nc"], "the process of its name is gone: that of the option"
    assert process_stated(tmp_path) == sums[1]
    known = watcher()
    assert converted(known, (6.0, 8.0)) == ["a.nc"], "without the option: that of the results"
    assert process_stated(tmp_path) == sums[0]
    shared_path.write_text(PROCESS.format(diameter=6))
    assert converted(known, (9.0, 11.0)) == ["a.nc"], "a process that has changed"
    assert process_stated(tmp_path) not in sums
    assert converted(known, (12.0, 14.0)) == []


def test_a_program_is_converted_once_it_is_quiet_and_again_when_it_changes(watcher, tmp_path):
    known = watcher()
    path = put(tmp_path, "a.nc", PART.format(x=5))
    assert converted(known, (0.0, 0.9)) == []
    assert converted(known, (1.1, 2.0, 9.0)) == ["a.nc"]
    assert (tmp_path / "out" / "a.src").is_file()
    path.touch()
    assert converted(known, (10.0, 12.0)) == []  # the same contents
    path.write_text(PART.format(x=7))
    assert converted(known, (13.0, 13.5)) == []
    path.write_text(PART.format(x=8))
    assert converted(known, (14.2, 14.9)) == []  # still being written
    assert converted(known, (15.3,)) == ["a.nc"]
    assert "X 8" in (tmp_path / "out" / "a.src").read_text()


def test_after_a_restart_nothing_is_converted_again_even_if_the_record_is_lost(watcher, tmp_path):
    put(tmp_path, "a.nc", PART.format(x=5))
    put(tmp_path, "b.nc", "G999\n")
    assert sorted(converted(watcher())) == ["a.nc", "b.nc"]
    assert converted(watcher()) == []
    (tmp_path / "out" / watching.STATE).unlink()  # killed between output and record
    assert converted(watcher()) == ["b.nc"]
    (tmp_path / "out" / watching.STATE).write_text("{half")
    put(tmp_path, "a.nc", PART.format(x=6))
    assert sorted(converted(watcher())) == ["a.nc", "b.nc"]


def test_a_divided_program_is_known_after_a_restart_by_its_main_file(watcher, tmp_path):
    moves = "\n".join(f"X{5 + 0.1 * (n % 2):.1f}" for n in range(60))
    put(tmp_path, "a.nc", PART.format(x=5).replace("X5", moves))
    assert converted(watcher(lines_per_file=40)) == ["a.nc"]
    assert (tmp_path / "out" / "aMain.src").is_file()
    assert not (tmp_path / "out" / "a.src").exists()
    (tmp_path / "out" / watching.STATE).unlink()
    assert converted(watcher(lines_per_file=40)) == []


CALLING = "G21 G90\nG0 X0 Y0 Z20\nG1 Z-1 F300\nM98 P400\nG0 Z20\nM30\n"
SUBPROGRAM = "O400\nG91 G1 X{x}\nG90\nM99\n"


def test_a_program_follows_the_subprograms_in_other_files(watcher, tmp_path):
    """The file may come later than its caller, change, and go: each counts as a change of the caller."""
    known = watcher()
    put(tmp_path, "b.nc", CALLING)
    put(tmp_path, "c.nc", PART.format(x=5))
    assert sorted(converted(known)) == ["b.nc", "c.nc"]
    written = tmp_path / "out" / "b.src"
    assert not written.exists(), "its subprogram is missing"
    called = put(tmp_path, "O400.nc", SUBPROGRAM.format(x=20))
    assert sorted(converted(known, (2.0, 3.1))) == ["O400.nc", "b.nc"], "it came late"
    assert "X 20" in written.read_text()
    put(tmp_path, "O400.nc", SUBPROGRAM.format(x=45))
    assert sorted(converted(known, (4.0, 5.1))) == ["O400.nc", "b.nc"]
    assert "X 45" in written.read_text()
    put(tmp_path, "O400.nc", SUBPROGRAM.format(x=50))  # while it is not running
    assert sorted(converted(watcher())) == ["O400.nc", "b.nc"]
    assert "X 50" in written.read_text()
    assert converted(watcher()) == []
    (tmp_path / "out" / watching.STATE).unlink()
    known = watcher()
    assert sorted(converted(known)) == ["O400.nc", "b.nc"], "the state file is lost"
    called.unlink()
    assert converted(known, (10.0, 11.1)) == ["b.nc"]
    assert not written.exists()
    assert written.with_name("b.src.old").exists()


def test_a_subprogram_of_a_computed_number_and_one_of_another_extension_count(watcher, tmp_path):
    known = watcher()
    put(tmp_path, "b.nc", CALLING.replace("M98 P400", "#1=399\nm 98 p[#1+1]"))
    put(tmp_path, "d.nc", CALLING.replace("M98 P400", "o<bore> call [30]"))
    put(tmp_path, "0400.txt", SUBPROGRAM.format(x=20))
    put(tmp_path, "bore.ngc", "o<bore> sub\nG1 X#1\nM98 P400\no<bore> endsub\n")
    assert sorted(converted(known)) == ["b.nc", "bore.ngc", "d.nc"]
    put(tmp_path, "0400.txt", SUBPROGRAM.format(x=45))
    assert sorted(converted(known, (2.0, 3.1))) == ["b.nc", "bore.ngc", "d.nc"]
    assert "X 45" in (tmp_path / "out" / "b.src").read_text()
    assert "X 75" in (tmp_path / "out" / "d.src").read_text()


KRL_CALLING = """DEF m()
$BASE={X 1500,Y -50,Z 700,A 0,B 0,C 0}
$TOOL=TOOL_DATA[1]
$VEL.CP=0.02
PTP {A1 0,A2 -90,A3 100,A4 0,A5 80,A6 0}
LIN {X 0,Y 0,Z 60,A 0,B 90,C 0}
subx()
END
"""


def test_krl_follows_called_files_also_of_other_folders(watcher, tmp_path):
    library = tmp_path / "library"
    library.mkdir()
    cell = tmp_path / "cell.toml"
    cell.write_text(CELL_FILE.read_text() + '\n[krl]\nsearch = ["library"]\n[tool_data.1]\nZ = 350.0\n')
    put(tmp_path, "m.src", KRL_CALLING)
    known = watcher(cell=cell)
    assert converted(known) == ["m.src"]
    (library / "subx.src").write_text("DEF subx()\nsuby()\nEND\n")
    (library / "suby.src").write_text("DEF suby()\nLIN {X DEPTH}\nEND\n")
    (library / "suby.dat").write_text("DEFDAT suby\nDECL REAL DEPTH=20\nENDDAT\n")
    assert converted(known, (2.0, 3.1)) == ["m.src"], "late"
    (library / "suby.dat").write_text("DEFDAT suby\nDECL REAL DEPTH=25\nENDDAT\n")
    assert converted(known, (4.0, 5.1)) == ["m.src"], "values of a called file"
    (library / "other.src").write_text("DEF other()\nEND\n")
    assert converted(known, (6.0, 7.1)) == []
    library.rename(tmp_path / "away")
    assert converted(known, (8.0, 9.1)) == [], "the folder is waited for"
    assert known.said[-1] == f"{library} cannot be read at present. Waiting for it."
    (tmp_path / "away").rename(library)
    (library / "subx.src").unlink()
    assert converted(known, (10.0, 11.1)) == ["m.src"]


def test_files_that_lines_of_the_cell_call_count(watcher, tmp_path):
    cell = tmp_path / "cell.toml"
    cell.write_text(CELL_FILE.read_text() + '\n[m_codes]\nM31 = ["CLAMP()"]\n')
    put(tmp_path, "a.nc", PART.format(x=5).replace("M30", "M31\nM30"))
    known = watcher(cell=cell)
    assert converted(known) == ["a.nc"]
    put(tmp_path, "clamp.src", "DEF clamp()\nWAIT SEC 1\nEND\n")
    assert "a.nc" in converted(known, (2.0, 3.1))


def test_one_that_fails_stops_no_other_and_is_tried_again_when_it_changes(watcher, tmp_path):
    known = watcher()
    for name in ("a.nc", "c.nc"):
        put(tmp_path, name, PART.format(x=5))
    put(tmp_path, "b.nc", PART.format(x="wrong"))
    assert sorted(converted(known)) == ["a.nc", "b.nc", "c.nc"]
    assert {path.name for path in (tmp_path / "out").glob("*.src")} == {"a.src", "c.src"}
    put(tmp_path, "b.nc", PART.format(x=5))
    assert converted(known, (20.0, 22.0)) == ["b.nc"]


def test_after_a_change_of_the_cell_all_programs_are_converted_again(watcher, tmp_path):
    """Also those that failed: the cell is what most of them need changed. Not while it is being written."""
    cell = tmp_path / "cell.toml"
    text = CELL_FILE.read_text()
    cell.write_text(text)
    text += "\n[machine]\nclearance_Z = 200.0\n"
    put(tmp_path, "a.nc", PART.format(x=5))
    put(tmp_path, "b.nc", PART.format(x=6).replace("M30", "G28 Z0\nM30"))
    known = watcher(cell=cell)
    assert sorted(converted(known)) == ["a.nc", "b.nc"]
    assert {path.name for path in (tmp_path / "out").glob("*.src")} == {"a.src"}
    before = (tmp_path / "out" / "a.src").read_text()
    assert converted(known, (2.0, 4.0)) == []
    cell.write_text(text.replace("Z = 700.0", "Z = 650.0"))
    assert converted(known, (5.0, 5.9)) == []
    assert sorted(converted(known, (6.1, 7.2))) == ["a.nc", "b.nc"]
    assert known.said == ["The cell, a file used with it, an option or postproc has changed: all are converted again."]
    assert {path.name for path in (tmp_path / "out").glob("*.src")} == {"a.src", "b.src"}
    after = (tmp_path / "out" / "a.src").read_text()
    assert "Z 700" in before
    assert "Z 650" in after
    assert converted(known, (8.0, 10.0)) == []
    cell.write_text(text)  # while it is not running
    again = watcher(cell=cell)
    assert sorted(converted(again)) == ["a.nc", "b.nc"]
    (tmp_path / "out" / watching.STATE).unlink()  # the record is lost: the reports are of this cell
    assert converted(watcher(cell=cell)) == []
    cell.write_text(text.replace("Z = 700.0", "Z = 650.0"))
    assert sorted(converted(watcher(cell=cell))) == ["a.nc", "b.nc"]


def test_after_an_error_of_the_cell_what_is_of_an_earlier_run_is_named(watcher, tmp_path):
    cell = tmp_path / "cell.toml"
    cell.write_text(CELL_FILE.read_text())
    known = watcher(cell=cell)
    put(tmp_path, "a.nc", PART.format(x=5))
    assert converted(known) == ["a.nc"]
    cell.write_text(CELL_FILE.read_text().replace('"kuka_kr270"', '"nope"'))
    put(tmp_path, "a.nc", PART.format(x=6))
    put(tmp_path, "b.nc", PART.format(x=7))
    ready = [path for moment in (5.0, 6.1, 7.2) for path in known.scan(1e6 + moment)]
    (old, _), (new, _) = known.convert(ready)
    assert old.message == new.message
    assert "nope" in old.message
    assert old.earlier_remark == f"There before, not of this run: {tmp_path / 'out' / 'a.src'}."
    assert new.earlier_remark == ""


@pytest.mark.parametrize("changed", ["process.toml", "material.toml", "stock.stl", "robot/model.toml", "--tolerance"])
def test_what_all_programs_are_converted_with_counts_as_the_cell_does(watcher, tmp_path, changed):
    shutil.copytree(ROOT / "robot_models" / "kuka_kr270", tmp_path / "robot")
    (tmp_path / "cell.toml").write_text(CELL_FILE.read_text().replace('"kuka_kr270"', '"robot"'))
    (tmp_path / "process.toml").write_text('[material]\nfile = "material.toml"\n[stock]\nfile = "stock.stl"\n')
    for name in ("material.toml", "stock.stl"):
        (tmp_path / name).write_text("not read here")
    options = {"cell": tmp_path / "cell.toml", "forces": tmp_path / "process.toml"}
    put(tmp_path, "a.nc", PART.format(x=5))
    assert converted(watcher(**options)) == ["a.nc"]
    assert converted(watcher(**options)) == []
    if changed == "--tolerance":
        options["tolerance_mm"] = 0.02
    else:
        with (tmp_path / changed).open("a") as file:
            file.write("# changed\n")
    assert converted(watcher(**options)) == ["a.nc"]
    assert converted(watcher(**options)) == []


ROWS = "line,Fx,Fy,Fz\n3,0,0,{force}\n4,0,0,{force}\n"


@pytest.fixture
def forces(tmp_path):
    (tmp_path / "forces").mkdir()

    def state(name: str, force: float) -> Path:
        path = tmp_path / "forces" / name
        path.write_text(ROWS.format(force=force))
        return path

    return state


def same_as_convert(tmp_path, name: str, text: str, **options) -> None:
    """Compare a program that was watched with what `convert` makes of the same files."""
    folder = tmp_path / f"alone {name} {time.monotonic_ns()}"
    folder.mkdir()
    (folder / name).write_text(text)
    (job,) = find_jobs([str(folder / name)], output=folder / "out", **options)
    (outcome,) = convert_all([job], Settings(CELL_FILE))
    assert outcome.code == 0
    written = f"{Path(name).stem}.src"
    assert (tmp_path / "out" / written).read_bytes() == (folder / "out" / written).read_bytes()


def test_a_program_waits_for_its_forces_and_follows_their_changes(watcher, tmp_path, forces):
    known = watcher(forces=tmp_path / "forces")
    put(tmp_path, "a.nc", PART.format(x=5))
    put(tmp_path, "b.nc", PART.format(x=6))
    put(tmp_path, "c.nc", PART.format(x=7).replace("X7", "(FORCE FZ=100)\nX7"))
    forces("b.csv", 500)
    assert sorted(converted(known)) == ["b.nc", "c.nc"]  # c states its own
    waits = f"a.nc waits for its forces: a.csv or a.forces.csv in {tmp_path / 'forces'}."
    assert [sentence for sentence in known.said if sentence.endswith(waits)] == known.said
    forces("A.forces.csv", 900)
    assert converted(known, (2.0, 2.9)) == []  # still being written
    assert converted(known, (3.1,)) == ["a.nc"]
    same_as_convert(tmp_path, "a.nc", PART.format(x=5), forces=tmp_path / "forces")
    forces("b.csv", 800)
    assert converted(known, (4.0, 5.1)) == ["b.nc"]
    same_as_convert(tmp_path, "b.nc", PART.format(x=6), forces=tmp_path / "forces")
    assert converted(watcher(forces=tmp_path / "forces")) == []
    forces("b.csv", 700)  # while it is not running
    assert converted(watcher(forces=tmp_path / "forces")) == ["b.nc"]


def test_forces_that_are_removed_take_their_result_with_them(watcher, tmp_path, forces):
    known = watcher(forces=tmp_path / "forces")
    put(tmp_path, "a.nc", PART.format(x=5))
    file = forces("a.csv", 900)
    forces("b.csv", 900)
    assert converted(known) == ["a.nc"]
    file.unlink()
    ready = [path for moment in (5.0, 6.1) for path in known.scan(1e6 + moment)]
    ((outcome, _),) = known.convert(ready)
    assert (outcome.code, outcome.message) == (1, f"{file}: no such file.")
    assert not (tmp_path / "out" / "a.src").is_file()
    assert (tmp_path / "out" / "a.src.old").is_file()
    assert converted(known, (7.0, 9.0)) == []
    forces("a.csv", 900)
    assert converted(known, (10.0, 11.1)) == ["a.nc"]


def test_two_files_of_forces_for_a_program_are_its_error_alone(watcher, tmp_path, forces):
    known = watcher(forces=tmp_path / "forces")
    for name in ("a", "b"):
        put(tmp_path, f"{name}.nc", PART.format(x=5))
        forces(f"{name}.csv", 900)
    file = forces("a.forces.csv", 900)
    ready = [path for moment in (0.0, 1.1) for path in known.scan(1e6 + moment)]
    outcomes = {job.program.name: outcome for outcome, job in known.convert(ready)}
    assert {name: outcome.code for name, outcome in outcomes.items()} == {"a.nc": 1, "b.nc": 0}
    assert "2 force files for a.nc: a.csv and a.forces.csv" in outcomes["a.nc"].message
    file.unlink()
    assert converted(known, (5.0, 6.1)) == ["a.nc"]


@pytest.mark.parametrize(
    "changed",
    ["none", "forces/a.csv", "robot/model.toml", "$config.dat", "--tolerance", "--part-tolerance", "--linearize-arcs"],
)
def test_without_its_record_what_the_output_depends_on_is_in_the_written_program(watcher, tmp_path, forces, changed):
    shutil.copytree(ROOT / "robot_models" / "kuka_kr270", tmp_path / "robot")
    cell = CELL_FILE.read_text().replace('"kuka_kr270"', '"robot"')
    (tmp_path / "cell.toml").write_text(f'config_dat = "$config.dat"\n{cell}')
    (tmp_path / "$config.dat").write_text("DEFDAT $CONFIG\nENDDAT\n")
    options = {"cell": tmp_path / "cell.toml", "forces": tmp_path / "forces"}
    put(tmp_path, "a.nc", PART.format(x=5))
    forces("a.csv", 900)
    assert converted(watcher(**options)) == ["a.nc"]
    (tmp_path / "out" / watching.STATE).unlink()
    stated = {
        "--tolerance": {"tolerance_mm": 0.02},
        "--part-tolerance": {"part_tolerance_mm": 0.3},
        "--linearize-arcs": {"linearize_arcs": True},
    }.get(changed, {})
    if changed != "none" and not stated:
        with (tmp_path / changed).open("a") as file:
            file.write(
                "4,0,0,1\n".replace("4", "5")
                if changed.endswith(".csv")
                else "# changed\n"
                if "toml" in changed
                else ";\n"
            )
    assert converted(watcher(**options, **stated)) == ([] if changed == "none" else ["a.nc"])


def test_other_code_converts_again(watcher, tmp_path, monkeypatch):
    put(tmp_path, "a.nc", PART.format(x=5))
    assert converted(watcher()) == ["a.nc"]
    assert converted(watcher()) == []
    monkeypatch.setattr("postproc.jobs.inputs.code_sum", lambda: "0" * 64)
    assert converted(watcher()) == ["a.nc"]


def test_the_overview_lists_programs_that_came_one_by_one_also_those_that_failed(watcher, tmp_path):
    known = watcher()
    page = tmp_path / "out" / "index.html"
    put(tmp_path, "a.nc", PART.format(x=5))
    assert converted(known) == ["a.nc"]
    assert "a.nc" in page.read_text()
    put(tmp_path, "b.nc", "G999\n")
    assert converted(known, (2.0, 4.0)) == ["b.nc"]
    put(tmp_path, "c.nc", PART.format(x=7))
    assert converted(known, (5.0, 7.0)) == ["c.nc"]
    text = page.read_text()
    assert all(name in text for name in ("a.nc", "b.nc", "c.nc", "G999"))
    put(tmp_path, "b.nc", PART.format(x=6))
    assert converted(watcher()) == ["b.nc"]
    assert "G999" not in page.read_text()
    page.write_text("<p>mine")
    put(tmp_path, "d.nc", PART.format(x=8))
    other = watcher()
    assert converted(other) == ["d.nc"]
    assert page.read_text() == "<p>mine"
    assert other.said == [f"{page} was not written by postproc: there is no overview."]


def test_results_of_programs_that_are_no_longer_there_are_named(watcher, tmp_path):
    known = watcher()
    page = tmp_path / "out" / "index.html"
    path = put(tmp_path, "a.nc", PART.format(x=5))
    put(tmp_path, "b.nc", PART.format(x=6))
    assert sorted(converted(known)) == ["a.nc", "b.nc"]
    assert converted(known, (2.0, 3.1)) == []
    path.unlink()
    assert converted(known, (4.0, 4.5)) == []
    assert known.said == [], "an editor may write it again"
    assert converted(known, (5.1, 6.2)) == []
    written = tmp_path / "out" / "a.src"
    note = f"Written by an earlier run from programs that are no longer there: {written}. Do not load them."
    assert known.said == [note]
    text = read_page(page.read_bytes()).text("programs")
    assert "a.nc do not load the program is no longer there" in text
    assert "b.nc do not load" not in text
    (tmp_path / "in" / "b.nc").rename(tmp_path / "in" / "c.nc")
    assert converted(known, (7.0, 8.1, 9.2)) == ["c.nc"]
    assert known.said == [note, note.replace("a.src", "b.src")], "each once"
    assert read_page(page.read_bytes()).text("programs").count("no longer there") == 2
    known = watcher()
    assert converted(known) == []
    assert known.said == [note.replace(f"{written}", f"{written}, {written.with_name('b.src')}")], "after a restart"
    put(tmp_path, "a.nc", PART.format(x=5))
    assert converted(known, (10.0, 11.1, 12.2)) == []
    assert "a.nc do not load" not in read_page(page.read_bytes()).text("programs")


def test_an_output_folder_that_cannot_be_written_is_waited_for_and_a_removed_one_is_filled_again(watcher, tmp_path):
    known = watcher()
    put(tmp_path, "a.nc", PART.format(x=5))
    (tmp_path / "out").write_text("a file of this name")
    assert converted(known, (0.0, 2.0, 3.0)) == []
    assert known.said == [f"{tmp_path / 'out'} cannot be written at present. Waiting for it."]
    (tmp_path / "out").unlink()
    assert converted(known, (4.0,)) == ["a.nc"]
    shutil.rmtree(tmp_path / "out")
    assert converted(known, (5.0, 6.5)) == ["a.nc"]
    assert (tmp_path / "out" / "a.src").is_file()


def test_a_locked_file_is_waited_for(watcher, tmp_path, monkeypatch):
    known = watcher()
    put(tmp_path, "a.nc", PART.format(x=5))
    opened = Path.read_bytes

    def locked(path: Path) -> bytes:
        if path.name == "a.nc":
            raise PermissionError(13, "in use")
        return opened(path)

    monkeypatch.setattr(Path, "read_bytes", locked)
    assert converted(known, (0.0, 2.0, 3.0)) == []
    assert len(known.said) == 1
    assert "a.nc cannot be opened at present" in known.said[0]
    monkeypatch.setattr(Path, "read_bytes", opened)
    assert converted(known, (4.0,)) == ["a.nc"]


def test_a_folder_that_vanishes_is_waited_for(watcher, tmp_path):
    known = watcher()
    (tmp_path / "in").rename(tmp_path / "away")
    assert converted(known, (0.0, 2.0)) == []
    assert known.said == [f"{tmp_path / 'in'} cannot be read at present. Waiting for it."]
    (tmp_path / "away").rename(tmp_path / "in")
    put(tmp_path, "a.nc", PART.format(x=5))
    assert converted(known, (3.0, 5.0)) == ["a.nc"]


def test_a_folder_that_is_not_there_is_an_error(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        watching.watch(tmp_path / "none", tmp_path / "out", Settings(CELL_FILE), {})
    done = invoke("watch", tmp_path / "none", cell=CELL_FILE)
    assert done.exit_code == 1
    assert done.output.startswith(f"Error: {tmp_path / 'none'}: no such folder")


def test_results_into_the_folder_that_is_watched_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"would be taken for programs that arrive. Give another folder with -o"):
        watching.watch(tmp_path, Path(), Settings(CELL_FILE), {})


@pytest.mark.parametrize("text", [PART.format(x=5), "G999\n"], ids=["written", "failed"])
def test_with_json_each_program_is_one_line(tmp_path, monkeypatch, text):
    (tmp_path / "in").mkdir()
    put(tmp_path, "a.nc", text)
    monkeypatch.setattr(watching, "QUIET", 0.05)
    endless = watching.watch

    def until_the_first(*given, stop, **more):
        for pair in endless(*given, stop=stop, **more):
            yield pair
            stop.set()

    monkeypatch.setattr(watching, "watch", until_the_first)
    done = invoke("watch", tmp_path / "in", "--json", cell=CELL_FILE)
    (line,) = done.stdout.splitlines()
    entry = json.loads(line)
    assert entry["program"] == str(tmp_path / "in" / "a.nc")
    assert (entry["exit_code"], len(entry["written"])) == ((0, 4) if "G1" in text else (1, 0))
    assert f"watching {tmp_path / 'in'}" in done.stderr


@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize(("first", "second"), [("Müller Teil.nc", "Mueller Teil.nc"), ("PART.NC", "part.nc")])
def test_two_programs_of_one_written_name_do_not_replace_each_other(watcher, tmp_path, first, second, together):
    """Else the shop that loads the program of the first part would mill the second."""
    known = watcher()
    put(tmp_path, first, PART.format(x=30))
    if not together:
        assert converted(known) == [first]
    put(tmp_path, second, PART.format(x=50))
    outcomes = []
    for moment in (10.0, 11.1):
        ready = known.scan(1e6 + moment)
        outcomes += [outcome for outcome, _ in known.convert(ready)] if ready else []
    refused_names = {Path(outcome.program).name for outcome in outcomes}
    assert refused_names == ({first, second} if together else {second})
    assert all(outcome.code == 1 and "would both be written as" in outcome.message for outcome in outcomes)
    written = list((tmp_path / "out").glob("*.src"))
    assert len(written) == (0 if together else 1)
    assert all(b"X 30," in path.read_bytes() for path in written)
    (tmp_path / "in" / second).rename(tmp_path / "in" / "other.nc")
    assert sorted(converted(known, (20.0, 21.1))) == sorted([*([first] if together else []), "other.nc"])
    assert "X 50," in (tmp_path / "out" / "other.src").read_text()


def test_a_name_that_is_not_utf8_stops_nothing(watcher, tmp_path):
    """As on a network drive on which names are in the code page of old programs."""
    put(tmp_path, "good.nc", PART.format(x=5))
    name = "au\udcdfen.nc"
    try:
        put(tmp_path, name, PART.format(x=6))
    except OSError:
        pytest.skip("this file system has no such names")
    known = watcher()
    assert converted(known, (0.0, 2.0, 4.0)) == ["good.nc"]
    assert known.said == [f"{tmp_path / 'in' / name}: its name is not UTF-8. Rename the file."]


def test_other_files_and_those_of_editors_are_left_alone(watcher, tmp_path):
    for name in (".a.nc.swp", "~a.nc", ".b.nc", "readme.txt"):
        put(tmp_path, name, PART.format(x=5))
    (tmp_path / "in" / "folder.nc").mkdir()
    assert converted(watcher()) == []


def arriving(folder: Path, count: int, kills: int, pause: float, seed: int) -> tuple[list[str], set[str]]:
    """Run `watch` while programs arrive at random times, killing and starting it again; it must end by itself.

    :param pause: longest time between two programs [s].
    :returns: names that were reported as written, in order; names of the programs in the output folder.
    """
    chance = random.Random(seed)
    (folder / "in").mkdir()
    command = [sys.executable, "-m", "postproc", "watch", str(folder / "in"), "--cell", str(CELL_FILE)]
    log = folder / "log"

    def start() -> subprocess.Popen[bytes]:
        with log.open("ab") as output:
            return subprocess.Popen([*command, "-o", str(folder / "out")], stdout=output, stderr=subprocess.STDOUT)

    def done() -> int:
        return len(list((folder / "out").glob("*.report.json")))

    process = start()
    killed = sorted(chance.sample(range(count // 4, count), kills))
    try:
        for number in range(count):
            put(folder, f"p{number}.nc", PART.format(x=number + 1))
            time.sleep(pause * chance.random())
            if number in killed:
                before = done()
                while done() == before < number:
                    time.sleep(0.05)
                process.kill()
                process.wait()
                process = start()
        waited = 0
        while done() < count and waited < 1200 + 40 * count:
            time.sleep(0.1)
            waited += 1
        time.sleep(1.5)
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
    finally:
        process.kill()
    said = [line.partition(":")[0] for line in log.read_text().splitlines() if ".nc: written" in line]
    return said, {path.stem for path in (folder / "out").glob("*.src")}


def check_arrived(said: list[str], written: set[str], count: int, kills: int) -> None:
    """Each program was written once; of the one that was being converted at a kill, nothing may have been said."""
    assert len(said) == len(set(said)) >= count - kills
    assert written == {f"p{number}" for number in range(count)}


def test_killed_and_started_again_each_is_converted_once(tmp_path):
    check_arrived(*arriving(tmp_path, 12, 1, 0.3, 1), 12, 1)


_ENDED = """
import os, sys, time
if {polling}:
    sys.modules["watchfiles"] = None
if {converting}:
    from postproc.jobs import runs
    def convert(*arguments, **options):
        os.write(1, b"converting\\n")  # print, interrupted, would write it again
        for _ in range(12_000):  # one long sleep would miss a signal that comes just before it begins
            time.sleep(0.01)
    runs.convert = convert
from postproc.__main__ import main
main()
"""


@pytest.mark.parametrize(
    ("polling", "converting", "number"),
    [
        pytest.param(False, False, signal.SIGINT, id="notified, idle"),
        pytest.param(False, True, signal.SIGTERM, id="notified, converting"),
        pytest.param(True, False, signal.SIGTERM, id="polling, idle"),
        pytest.param(True, True, signal.SIGINT, id="polling, converting"),
    ],
)
def test_a_signal_ends_it_at_once(tmp_path, polling, converting, number):
    (tmp_path / "in").mkdir()
    if converting:
        put(tmp_path, "a.nc", PART.format(x=5))
    code = _ENDED.format(polling=polling, converting=converting)
    command = [sys.executable, "-u", "-c", code, "watch", str(tmp_path / "in"), "--cell", str(CELL_FILE), "--serve"]
    process = subprocess.Popen(
        [*command, "--port", "0"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8"
    )
    try:
        assert process.stdout is not None
        wanted = "converting" if converting else "watching"
        while not (line := process.stdout.readline()).startswith(wanted):
            assert line
        time.sleep(0.0 if converting else 2 * watching.SCAN)
        process.send_signal(number)
        said, _ = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    assert process.returncode == 128 + number
    assert said == ("ended.\n" if converting else "Interrupted.\n")


def test_the_overview_is_served_on_this_machine_and_reloads_itself(tmp_path):
    (tmp_path / "secret.toml").write_text("x")
    (tmp_path / "part.report.html").write_text("<p>part")
    there = server(tmp_path, 0)
    assert there.server_address[0] == "127.0.0.1"
    Thread(target=there.serve_forever, daemon=True).start()

    def get(path: str, host: str = "127.0.0.1:1") -> tuple[int, bytes, str | None]:
        connection = http.client.HTTPConnection("127.0.0.1", there.server_address[1], timeout=10)
        connection.request("GET", path, headers={"Host": host})
        answer = connection.getresponse()
        found = answer.status, answer.read(), answer.getheader("Refresh")
        connection.close()
        return found

    try:
        assert get("/")[0] == 200
        assert b"No program has been converted yet" in get("/")[1]
        (tmp_path / "index.html").write_text("<p>overview")
        assert get("/") == (200, b"<p>overview", "2")
        assert get("/part.report.html") == (200, b"<p>part", None)
        assert get("/", host="evil.example:8350")[0] == 403
        for path in ("/secret.toml", "/../secret.toml", "/%2e%2e/x.html", "/.postproc-watch.json/", "/a/b.html"):
            assert get(path)[0] == 404, path
    finally:
        there.shutdown()
        there.server_close()


def test_a_port_in_use_is_an_error(tmp_path):
    one = server(tmp_path, 0)
    try:
        with pytest.raises(PostprocError, match="Give another --port"):
            server(tmp_path, one.server_address[1])
    finally:
        one.server_close()


@pytest.mark.parametrize("library", [True, False])
def test_it_ends_when_it_is_told_to(tmp_path, monkeypatch, library):
    if not library:
        monkeypatch.setitem(sys.modules, "watchfiles", None)
    (tmp_path / "in").mkdir()
    put(tmp_path, "a.nc", PART.format(x=5))
    monkeypatch.setattr(watching, "QUIET", 0.05)
    stop, done = Event(), []
    for outcome, _ in watching.watch(tmp_path / "in", tmp_path / "out", Settings(CELL_FILE), {}, stop=stop):
        done.append(outcome.code)
        stop.set()
    assert done == [0]


if __name__ == "__main__":
    options = argparse.ArgumentParser()
    for option, default in (("--files", 500), ("--kills", 5), ("--seed", 1)):
        options.add_argument(option, type=int, default=default)
    asked = options.parse_args()
    with tempfile.TemporaryDirectory() as place:
        found = arriving(Path(place), asked.files, asked.kills, 0.3, asked.seed)
    check_arrived(*found, asked.files, asked.kills)
    print(f"{asked.files} programs arrived, {asked.kills} times killed: {len(found[1])} written, each once")


def test_forces_in_comments_win_over_the_process_for_all(watcher, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "process.toml").write_text(PROCESS.format(diameter=8))
    known = watcher()
    put(tmp_path, "a.nc", MILLED.replace("G1", "(FORCE FX=10 FY=20 FZ=30)\nG1", 1))
    assert converted(known) == ["a.nc"]
    report = json.loads((tmp_path / "out" / "a.report.json").read_bytes())
    assert report["inputs"]["forces"] == "-", "no file"
    assert (tmp_path / "out" / "a.src").is_file()
