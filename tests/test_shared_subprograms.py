"""Two programs that call one subprogram of another file: neither is left with what was corrected for the other."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from postproc.cli import main
from postproc.errors import InputError
from postproc.files import write_whole

CELL = Path(__file__).parents[1] / "samples" / "cell_kr270.toml"
START = "BAS(#INITMOV,0)\n$VEL.CP=0.05\nPTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}\n"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("cell.toml").write_text(CELL.read_text())
    for name, force in (("one", 200), ("two", -300), ("three", 200)):
        program(name, force)
    Path("sub.src").write_text("DEF sub()\nLIN {X 20,Y 20,Z 0,A 0,B 0,C 180}\nEND\n")


def program(name: str, force: int) -> None:
    Path(f"{name}.src").write_text(
        f"DEF {name}( )\n{START};FORCE FX={force} FY=100 FZ=-100\nLIN {{X 0,Y 0,Z 10,A 0,B 0,C 180}}\nsub()\n"
        "LIN {X 50,Y 0,Z 10,A 0,B 0,C 180}\nEND\n"
    )


def run(*arguments: str, code: int = 0):
    done = CliRunner().invoke(main, [*arguments, "--cell", "cell.toml"])
    assert done.exit_code == code, done.output
    return done


@pytest.mark.parametrize("more", [[], ["--overwrite"]])
def test_what_was_corrected_for_another_program_is_not_replaced(more):
    run("convert", "one.src", "-o", "out")
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    told = run("convert", "two.src", "-o", "out", *more, code=1).stderr
    assert "out/sub.src: this file was written for one, which calls it too" in told
    assert "another folder with -o" in told
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before
    run("convert", "one.src", "-o", "out")  # its own


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_in_one_run_the_second_is_refused(jobs):
    done = run("convert", "one.src", "two.src", "-o", "out", "--jobs", jobs, "--overwrite", code=1)
    written = {path.stem for path in Path("out").glob("*.src")} - {"sub"}
    assert len(written) == 1
    assert "sub.src" in done.stderr
    run("predict", f"out/{written.pop()}.src", "-o", "told")


def test_programs_that_are_corrected_alike_share_it():
    run("convert", "one.src", "three.src", "-o", "out")
    assert {path.name for path in Path("out").glob("*.src")} == {"one.src", "three.src", "sub.src"}
    for name in ("one", "three"):
        assert "unchanged since" in run("predict", f"out/{name}.src", "-o", "told").output


def test_what_another_program_calls_stays_where_one_does_not_call_it_any_more():
    run("convert", "one.src", "three.src", "-o", "out")
    text = Path("one.src").read_text()
    Path("one.src").write_text(text.replace("sub()\n", ""))
    run("convert", "one.src", "-o", "out")
    Path("one.src").write_text(text.replace("X 50", "X 1e9"))
    run("convert", "one.src", "-o", "out", code=1)
    assert not Path("out/one.src").exists()
    assert "unchanged since" in run("predict", "out/three.src", "-o", "told").output


def test_a_corrected_subprogram_is_not_corrected_again():
    run("convert", "one.src", "-o", "out")
    assert "mode=corrected" in Path("out/sub.src").read_text()
    shutil.copy("two.src", "out/two.src")
    told = run("convert", "out/two.src", "-o", "again", code=1).output
    assert "sub.src, which this program calls, was corrected" in told
    run("predict", "out/two.src", "-o", "again")


def test_a_subprogram_that_is_also_a_program_of_the_run_is_named():
    told = run("convert", ".", "-o", "out", code=1).stderr
    assert "one.src calls sub.src, which is also converted as a program of its own" in told


def test_a_file_that_came_meanwhile_is_not_replaced_unless_it_is_the_same(tmp_path):
    (tmp_path / "sub.src").write_bytes(b"other")

    def contents(text):
        yield text
        (tmp_path / "sub.src").write_bytes(b"other")  # while it is written

    (tmp_path / "sub.src").unlink()
    with pytest.raises(InputError, match="came there meanwhile"):
        write_whole(tmp_path, {"one.src": contents(b"1"), "sub.src": b"own"}, shared={"sub.src": None})
    assert {path.name for path in tmp_path.glob("*.src")} >= {"sub.src"}
    (tmp_path / "sub.src").unlink()
    write_whole(tmp_path, {"one.src": contents(b"1"), "sub.src": b"other"}, shared={"sub.src": None})
    assert (tmp_path / "one.src").read_bytes() == b"1"
