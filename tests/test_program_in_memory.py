"""The way in for hosts: a program that is in no file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from postproc.errors import CellError
from postproc.jobs import Settings, convert_all, convert_program, find_jobs, load_setup, read_program
from postproc.program import Program

SAMPLES = Path(__file__).parent.parent / "samples"
SETTINGS = Settings(SAMPLES / "cell_kr270.toml")


def pocket() -> Program:
    cell, robot = load_setup(SETTINGS)
    return read_program(SAMPLES / "pocket.nc", robot, cell)


def test_a_program_in_memory_gives_the_same_bytes_as_the_file_that_it_was_read_from(tmp_path):
    outcome = convert_program(pocket(), SETTINGS, tmp_path / "memory")
    (by_file,) = convert_all(find_jobs([str(SAMPLES / "pocket.nc")], output=tmp_path / "file"), SETTINGS)
    assert outcome.code == by_file.code == 0
    names = [Path(path).name for path in outcome.written]
    assert names == [Path(path).name for path in by_file.written] != []
    for name in names:
        assert (tmp_path / "memory" / name).read_bytes() == (tmp_path / "file" / name).read_bytes()


@pytest.mark.parametrize(("name", "to"), [("inline.src", None), ("pocket.nc", "rapid")])
def test_so_it_is_for_krl_and_for_other_dialects_to_write(tmp_path, name, to):
    cell = SAMPLES / ("cell_irb6700.toml" if to else "cell_kr270.toml")
    settings = Settings(cell)
    program = read_program(SAMPLES / name, *reversed(load_setup(settings)))
    outcome = convert_program(program, settings, tmp_path / "memory", to=to)
    (by_file,) = convert_all(find_jobs([str(SAMPLES / name)], output=tmp_path / "file", to=to), settings)
    assert outcome.code == by_file.code == 0
    for path in map(Path, by_file.written):
        assert (tmp_path / "memory" / path.name).read_bytes() == path.read_bytes()


def test_a_name_that_krl_does_not_allow_is_made_valid_and_told(tmp_path):
    program = pocket()
    text = replace(program.documents[0], name="1001.nc", folder="")
    outcome = convert_program(replace(program, name="1001", documents=(text,)), SETTINGS, tmp_path)
    assert Path(outcome.written[0]).name == "P1001.src"
    assert "DEF P1001(" in (tmp_path / "P1001.src").read_text()
    assert any("written as P1001.src" in issue["message"] for issue in outcome.summary["issues"])


def test_what_is_out_of_reach_is_told_with_its_line_and_nothing_is_written(tmp_path):
    program = pocket()
    target = program.motions.target.copy()
    target[-1, 0, 3] = 40.0
    motions = replace(program.motions, target=target)
    outcome = convert_program(replace(program, motions=motions), SETTINGS, tmp_path / "out")
    assert outcome.code == 1
    assert [issue.source_line for issue in outcome.issues if issue.level == "error"] == [int(motions.line[-1])]
    assert not (tmp_path / "out").exists()


def test_a_cell_that_cannot_be_read_is_an_error_before_anything_is_written(tmp_path):
    with pytest.raises(CellError, match="no such file"):
        convert_program(pocket(), Settings(tmp_path / "no.toml"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_arrays_of_the_host_are_not_changed(tmp_path):
    program = pocket()
    before = program.motions.target.copy()
    convert_program(program, SETTINGS, tmp_path)
    assert np.array_equal(before, program.motions.target)
