from __future__ import annotations

from pathlib import Path

import pytest

from tests.commands import convert
from tests.html_page import read_page

PART = "G21 G90\nG0 X0 Y0 Z5\n(FORCE FX=100)\nG1 X10 Y0 Z0 F600\nX20\n"


@pytest.fixture(autouse=True)
def input_files(work_folder):
    for name in ("one", "two", "three"):
        Path(f"{name}.nc").write_text(PART)


def _listed():
    text = read_page(Path("out/index.html").read_bytes()).text("programs")
    return {name for name in ("one", "two", "three", "gone") if f"{name}.nc" in text}


def test_a_folder_of_several_programs_has_an_overview_that_later_runs_renew():
    done = convert("one.nc", "two.nc")
    assert f"overview: {Path('out', 'index.html')}" in done.stdout
    assert _listed() == {"one", "two"}
    convert("three.nc")
    assert _listed() == {"one", "two", "three"}


def test_a_single_program_has_none():
    convert("one.nc")
    assert not Path("out/index.html").exists()


def test_a_program_of_which_nothing_came_stands_in_it():
    Path("gone.nc").write_text("G1 X1 Y2 Q3\n")
    convert("one.nc", "gone.nc", code=1)
    assert _listed() == {"one", "gone"}
    assert "gone.nc:1" in read_page(Path("out/index.html").read_bytes()).text("failed")


def test_an_index_of_somebody_else_is_not_replaced():
    Path("out").mkdir()
    Path("out/index.html").write_text("<h1>mine</h1>")
    done = convert("one.nc", "two.nc", code=1)
    assert "not written by postproc" in done.stderr
    assert "index.html" in done.stderr
    assert sorted(path.name for path in Path("out").iterdir()) == ["index.html"]
    convert("one.nc")  # one program has no overview: that of somebody else stays
    assert Path("out/index.html").read_text() == "<h1>mine</h1>"
    convert("one.nc", "two.nc", "--overwrite")
    assert _listed() == {"one", "two"}
