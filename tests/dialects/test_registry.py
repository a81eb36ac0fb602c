"""Dialects by name and by extension; those of other packages, also broken ones."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from postproc import jobs
from postproc.dialects import registry
from postproc.errors import InputError, ProgramError
from tests.commands import invoke
from tests.places import CELL_FILE


@pytest.fixture
def others(monkeypatch):
    """Return a function that pretends that other packages are installed."""

    def pretend(**places: str) -> None:
        found = [EntryPoint(name, place, registry.GROUP) for name, place in places.items()]
        monkeypatch.setattr(
            "importlib.metadata.entry_points", lambda group: [entry for entry in found if entry.group == group]
        )
        registry._plugins.cache_clear()

    yield pretend
    registry._plugins.cache_clear()


FANUC = """
from postproc.dialects.dialect import CamFormat
from postproc.dialects.gcode.reader import GCODE, read

FANUC = CamFormat("fanuc", (".fan", ".nc"), read)
NAMED_OTHERWISE = GCODE
NONE = object()
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Put a module `somebodys_dialects` where it can be imported."""
    (tmp_path / "somebodys_dialects.py").write_text(FANUC)
    (tmp_path / "somebodys_broken.py").write_text("import no_such_module_at_all\n")
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "somebody_exits.py").write_text("import sys; sys.exit(3)\n")
    yield
    sys.modules.pop("somebodys_dialects", None)


def test_every_dialect_of_ours_is_what_it_is_called():
    for name in registry.names():
        assert registry.dialect_of_name(name).name == name
        assert all(
            extension[0] == "." and extension == extension.lower()
            for extension in registry.dialect_of_name(name).extensions
        )


def test_nothing_is_imported_that_a_program_does_not_need():
    code = (
        "import sys; from pathlib import Path; from postproc.dialects import registry;"
        " registry.dialect_of_file(Path('a.src'));"
        "registry.written_in('krl'); registry.extensions(); needless = {'pygcode', 'postproc.dialects.rapid'};"
        "print(sorted(needless & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_no_extension_means_two_dialects():
    given = [extension for name in registry.names() for extension in registry.dialect_of_name(name).extensions]
    assert sorted(given) == sorted(registry.extensions())


def test_a_dialect_of_another_package_is_found_by_name_and_extension_and_does_not_replace_ours(package, others):
    others(fanuc="somebodys_dialects:FANUC", gcode="somebodys_dialects:NONE")
    assert registry.dialect_of_name("fanuc").name == "fanuc"
    assert registry.dialect_of_file(Path("a.FAN")).name == "fanuc"
    assert registry.dialect_of_file(Path("a.nc")).name == "gcode"
    assert registry.extensions()[".nc"] == "gcode"
    assert registry.dialect_of_name("gcode").extensions[0] == ".nc"
    assert "fanuc" in registry.names()


def test_a_program_of_another_packages_dialect_is_a_job(package, others, tmp_path):
    others(fanuc="somebodys_dialects:FANUC")
    (tmp_path / "part.fan").write_text("G1 X1\n")
    (job,) = jobs.find_jobs([str(tmp_path)])
    assert (job.dialect, job.output_names("convert")[0]) == ("fanuc", "part.src")


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ("somebodys_broken:X", "No module named 'no_such_module_at_all'"),
        ("somebodys_dialects:NO_SUCH", "AttributeError"),
        ("somebody_exits:X", "SystemExit: 3"),
        ("somebodys_dialects:NONE", "it has no name, extensions"),
        ("somebodys_dialects:NAMED_OTHERWISE", "calls itself 'gcode'"),
    ],
)
def test_a_broken_one_says_why_and_stops_nothing(package, others, place, reason):
    others(fanuc="somebodys_dialects:FANUC", broken=place)
    assert registry.dialect_of_file(Path("a.fan")).name == "fanuc"
    assert "broken" not in registry.names()
    assert reason in registry.broken_dialects()["broken"]
    with pytest.raises(InputError, match="'broken' cannot be used") as caught:
        registry.dialect_of_name("broken")
    assert reason in str(caught.value)
    with pytest.raises(ProgramError, match="unknown kind of program") as unknown:
        registry.dialect_of_file(Path("a.xyz"))
    assert reason in str(unknown.value)


def test_a_broken_one_asked_for_on_the_command_line_is_wrong_usage(package, others):
    others(broken="somebodys_broken:X")
    done = invoke("convert", "a.nc", "--dialect", "broken", cell="cell.toml")
    assert done.exit_code == 2
    assert "no_such_module_at_all" in done.stderr


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("part.dat", "Give the .src"),
        ("part.h", "Heidenhain"),
        ("part.spf", "Sinumerik"),
        ("part.LS", "FANUC"),
    ],
)
def test_a_file_that_is_no_program_to_read_is_named_and_says_what_to_do(name, words):
    with pytest.raises(ProgramError) as caught:
        registry.dialect_of_file(Path(name))
    assert words in str(caught.value)
    assert name in str(caught.value)


def test_what_is_written_in_which_dialect():
    assert registry.written_in("gcode")[0] == "krl"
    assert registry.written_in("krl")[0] == "krl"
    assert registry.written_in("gcode", "krl")[0] == "krl"
    with pytest.raises(InputError, match="gcode is only read"):
        registry.written_in("gcode", "gcode")
    with pytest.raises(InputError, match="written in krl again, not in gcode"):
        registry.written_in("krl", "gcode")


APT = (
    "UNITS/MM\nLOADTL/1\nFEDRAT/300,MMPM\nRAPID\nGOTO/0,0,20\nGOTO/0,0,-1\nGOTO/{x},0,-1\nRAPID\nGOTO/{x},0,20\nFINI\n"
)


def test_versions_of_creo_are_cutter_location_files_named_without_their_number(tmp_path):
    for version in (1, 2, 10):
        (tmp_path / f"part.ncl.{version}").write_text(APT.format(x=version))
    (tmp_path / "part.csv.1").write_text("")
    done = invoke("convert", tmp_path, cell=CELL_FILE)
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in (tmp_path / "corrected").iterdir()) == [
        "part.report.html", "part.report.json", "part.src", "part.targets.csv",
    ]  # fmt: skip
    text = (tmp_path / "corrected" / "part.src").read_text()
    assert "X 10," in text, "the newest version of the folder"
    (tmp_path / "part.ncl.11").write_text(APT.format(x=11))
    assert invoke("convert", tmp_path, cell=CELL_FILE).exit_code == 0
    assert "X 11," in (tmp_path / "corrected" / "part.src").read_text(), "replaces the earlier version"
    done = invoke("predict", tmp_path / "part.ncl.2", cell=CELL_FILE)
    assert "part.predict.report.json" in done.output


@pytest.mark.parametrize("name", ["part.ncl.", "part.ncl.1a", ".ncl.1", "part.nc.1"])
def test_other_numbers_behind_an_extension_are_no_versions(name):
    assert registry.without_version(Path(name)) == Path(name)
    with pytest.raises(ProgramError, match="unknown kind of program"):
        registry.dialect_of_file(Path(name))
