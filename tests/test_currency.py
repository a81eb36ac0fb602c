"""A result is current if it is that of the present inputs: their sums decide, never their dates."""

from __future__ import annotations

import json
import os
import shutil

import pytest

from postproc import robot
from postproc.jobs import Settings, conversion, currency, find_jobs
from postproc.jobs.runs import convert_all
from tests.places import ROOT

PROGRAM = "G17 G21 G90 G54\nT1 M6\nS9000 M3\nG0 X-20 Y10 Z10\nG0 Z-2\nG1 X40 F600\nG0 Z30\nM30\n"
CELL_WITH_MESH = """robot = "../model"
config_dat = "config.dat"
[base]
X = 1500
Z = 700
[tool]
Z = 350
[start]
joints = [0, -90, 100, 0, 80, 0]
[collision]
[[collision.obstacles]]
mesh = "table.stl"
part = true
"""
PROCESS = """[material]
file = "material.toml"
[tools.1]
diameter_mm = 12
flutes = 3
[stock]
file = "stock.stl"
resolution_mm = 1
"""
MATERIAL = "[material]\nKtc_N_per_mm2 = 700\nKac_N_per_mm2 = 9\nsigma_percent = 10\n"
FILES = (
    "part.nc",
    "corrected/cell.toml",
    "corrected/config.dat",
    "corrected/table.stl",
    "corrected/part.process.toml",
    "corrected/material.toml",
    "corrected/stock.stl",
    "model/model.toml",
    "model/robot.urdf",
    "corrected/part.src",
)


@pytest.fixture(scope="module")
def converted(tmp_path_factory):
    """A folder with a program and its result, made from own files of every kind."""
    return made(tmp_path_factory.mktemp("shop"))


def made(folder):
    """A folder with a program and its result."""
    results = folder / "corrected"
    results.mkdir(parents=True)
    shutil.copytree(robot.shipped_models()["kuka_kr270"], folder / "model")
    contents = {"cell.toml": CELL_WITH_MESH, "part.process.toml": PROCESS, "material.toml": MATERIAL}
    contents["config.dat"] = "DEFDAT $CONFIG PUBLIC\nDECL FRAME BASE_DATA[16]\nENDDAT\n"
    for name, text in contents.items():
        (results / name).write_text(text)
    for name in ("table.stl", "stock.stl"):
        shutil.copy(ROOT / "samples" / "plate.blank.stl", results / name)
    (folder / "part.nc").write_text(PROGRAM)
    convert_shop(folder)
    return folder


def convert_shop(folder, forces="part.process.toml"):
    results = folder / "corrected"
    jobs = find_jobs([str(folder / "part.nc")], forces=forces and results / forces, output=results)
    (outcome,) = convert_all(jobs, Settings(cell=results / "cell.toml"))
    assert outcome.summary is not None, (outcome.message, outcome.issues)


@pytest.fixture
def folder(converted, tmp_path):
    return shutil.copytree(converted, tmp_path / "shop")


def changes(folder, forces="part.process.toml"):
    results = folder / "corrected"
    setup = currency.Setup.of(results / "cell.toml")
    return currency.changes(results / "part.report.json", folder / "part.nc", setup, forces and results / forces)


def test_a_result_is_current_wherever_the_folder_is(folder):
    assert changes(folder) == ()


def test_touched_files_with_the_same_content_change_nothing(folder):
    for name in FILES:
        os.utime(folder / name, (4e9, 4e9))
    assert changes(folder) == ()


@pytest.mark.parametrize("name", FILES)
def test_an_edited_file_counts_whatever_its_date(folder, name):
    path = folder / name
    status = path.stat()
    content = path.read_bytes()
    path.write_bytes(content + (b"\n" if path.suffix in (".nc", ".src") else b"\n# edited\n"))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert len(changes(folder)) == 1
    path.write_bytes(content)
    assert changes(folder) == ()


@pytest.mark.parametrize("name", FILES)
def test_without_one_of_its_files_a_result_is_not_current(folder, name):
    (folder / name).unlink()
    assert changes(folder) != ()


def test_a_process_that_is_new_or_gone_counts(folder):
    assert changes(folder, forces=None) != ()
    convert_shop(folder, forces=None)
    assert changes(folder, forces=None) == ()
    assert changes(folder) != ()


def test_the_version_of_postproc_counts(folder, monkeypatch):
    monkeypatch.setattr(currency, "VERSION", "99.0")
    assert changes(folder) == ("postproc",)


@pytest.mark.parametrize("name", ["inputs", "files"])
def test_a_report_that_does_not_say_what_it_was_made_from_is_not_current(folder, name):
    report = folder / "corrected" / "part.report.json"
    content = json.loads(report.read_text())
    del content[name]
    report.write_text(json.dumps(content))
    assert changes(folder) == (currency.UNKNOWN,)


def test_a_cell_that_is_edited_during_a_conversion_is_refused(folder, monkeypatch):
    """Else the result would state the sum of a cell that it was not computed with."""
    original = conversion.convert_program

    def slow(*arguments):
        result = original(*arguments)
        path = folder / "corrected" / "cell.toml"
        path.write_text(path.read_text().replace("X = 1500", "X = 1501"))
        return result

    monkeypatch.setattr(conversion, "convert_program", slow)
    results = folder / "corrected"
    jobs = find_jobs([str(folder / "part.nc")], forces=results / "part.process.toml", output=results)
    (outcome,) = convert_all(jobs, Settings(cell=results / "cell.toml"))
    assert "were changed while the program was converted" in outcome.message
    assert not (results / "part.src").exists(), "that of an earlier run is set aside, as after any failure"


SUBPROGRAM = "DEF CUT( )\nLIN {X 20,Y 0,Z 0,A 180,B 0,C 180}\nEND\n"
MAIN = """DEF part( )
$BASE={X 1500,Y 0,Z 700,A 0,B 0,C 0}
$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}
$VEL.CP=0.02
PTP {A1 0,A2 -90,A3 100,A4 0,A5 80,A6 0}
PTP {X 0,Y 0,Z 50,A 180,B 0,C 180}
LIN DEPTH
CUT()
END
"""
DEPTH_DAT = "DEFDAT part\nDECL FRAME DEPTH={X 0,Y 0,Z 0,A 180,B 0,C 180}\nENDDAT\n"


@pytest.mark.parametrize("name", ["part.src", "part.dat", "CUT.src"])
def test_data_and_subprograms_of_a_krl_program_count(tmp_path, name):
    folder, results = tmp_path, tmp_path / "corrected"
    results.mkdir()
    for file, text in {"part.src": MAIN, "part.dat": DEPTH_DAT, "CUT.src": SUBPROGRAM}.items():
        (folder / file).write_text(text)
    cell = results / "cell.toml"
    cell.write_text(
        CELL_WITH_MESH.replace("../model", "kuka_kr270").replace('config_dat = "config.dat"\n', "").split("[coll")[0]
    )
    (outcome,) = convert_all(find_jobs([str(folder / "part.src")], output=results), Settings(cell=cell))
    assert outcome.summary is not None, (outcome.message, outcome.issues)

    def now():
        return currency.changes(results / "part.report.json", folder / "part.src", currency.Setup.of(cell), None)

    assert now() == ()
    (folder / name).write_text((folder / name).read_text() + ";\n")
    assert now() == ("the program",)
    (folder / name).unlink()
    assert now() != ()
