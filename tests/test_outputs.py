"""Whose files stand in an output folder, what becomes of earlier ones, and how the written ones are called."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from postproc.errors import Issue, ProgramError
from postproc.files import find_foreign_file, seal, write_whole
from postproc.program import Document
from tests import fabricated
from tests.commands import convert, invoke, run
from tests.places import CELL_FILE

PART = {"part.src", "part.targets.csv", "part.report.html", "part.report.json"}


@pytest.fixture(autouse=True)
def computed(work_folder, monkeypatch):
    """Made-up results; what stands in the program chooses what happens."""

    def read(documents, _robot, _cell, name, _dialect):
        if "odd" in documents[0].text:
            raise ProgramError("odd word", file=documents[0].name, line=1, text="odd")
        return documents[0], name

    def process(read, _robot, _cell, _rows, mode, **_):
        document, name = read
        result = fabricated.result(mode=mode)
        if "far" in document.text:
            issue = Issue("error", "unreachable", "out of reach", 1)
            return fabricated.with_changes(result, issues=(issue,), documents=())
        if mode == "predict":
            return result
        return fabricated.with_changes(result, documents=(Document(f"{name}.src", f"DEF {name}()\n;{document.text}"),))

    monkeypatch.setattr("postproc.correction.read", read)
    monkeypatch.setattr("postproc.correction.process", process)
    Path("part.nc").write_text("G0 X0\n")


def names(folder: str = "out") -> set[str]:
    return {path.name for path in Path(folder).iterdir()}


def content() -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in Path("out").iterdir()}


def test_what_postproc_wrote_is_replaced():
    convert()
    before = content()
    Path("part.nc").write_text("G0 X1\n")
    convert()
    assert set(before) == names() == PART
    assert content()["part.src"] != before["part.src"]


@pytest.mark.parametrize("name", sorted(PART))
def test_a_file_that_postproc_did_not_write_is_an_error_and_stays(name):
    Path("out").mkdir()
    Path("out", name).write_text("{}")
    done = convert(code=1)
    assert f"not written by postproc, or changed since: {Path('out', name)}." in done.stderr
    assert "--overwrite" in done.stderr
    assert content() == {name: b"{}"}
    convert("part.nc", "--overwrite")
    assert names() == PART


@pytest.mark.parametrize("name", sorted(PART - {"part.report.json"}))
def test_a_file_that_was_changed_since_is_not_replaced(name):
    convert()
    Path("out", name).write_bytes(Path("out", name).read_bytes() + b"\n")
    before = content()
    assert str(Path("out", name)) in convert(code=1).stderr
    assert content() == before
    convert("part.nc", "--overwrite")
    assert content() != before


def test_without_its_report_only_the_program_says_whose_it_is():
    convert()
    Path("out/part.report.json").unlink()
    assert f"changed since: {Path('out/part.targets.csv')}, {Path('out/part.report.html')}. " in convert(code=1).stderr
    for name in ("targets.csv", "report.html"):
        Path(f"out/part.{name}").unlink()
    convert()
    for name in ("targets.csv", "report.html", "report.json"):
        Path(f"out/part.{name}").unlink()
    with Path("out/part.src").open("a") as file:
        file.write("HALT\n")
    assert f"changed since: {Path('out/part.src')}. " in convert(code=1).stderr


def test_all_folders_are_looked_at_before_anything_is_written():
    for name in ("a.nc", "b.nc"):
        Path(name).write_text("G0 X0\n")
    Path("out").mkdir()
    Path("out/b.src").write_text("mine")
    convert("a.nc", "b.nc", code=1)
    assert names() == {"b.src"}


def test_the_report_names_the_files_written_with_it():
    convert()
    entries = json.loads(Path("out/part.report.json").read_text())["files"]
    assert {entry["name"] for entry in entries} == PART - {"part.report.json"}


def test_the_program_of_another_language_does_not_stay_beside_the_report_of_the_new_one(monkeypatch):
    convert()
    assert "part.src" in names()
    result = fabricated.result()

    def process(*_, **__):
        return fabricated.with_changes(result, documents=(Document("part.mod", "MODULE part\nENDMODULE\n"),))

    monkeypatch.setattr("postproc.correction.process", process)
    cell = CELL_FILE.with_name("cell_irb6700.toml")
    done = invoke("convert", "part.nc", "--to", "rapid", "-o", "out", cell=cell)
    assert done.exit_code == 0, done.output
    assert names() == PART - {"part.src"} | {"part.mod"}
    with Path("out/part.mod").open("a") as file:
        file.write("! by hand\n")
    assert f"changed since: {Path('out/part.mod')}" in convert(code=1).stderr
    assert "part.mod" in names()


def test_a_program_of_a_stated_dialect_may_have_any_extension(monkeypatch):
    """Its word for approximation is that of its dialect."""
    result = fabricated.with_changes(fabricated.result(), documents=(Document("part.txt", "DEF part()\nEND\n"),))
    monkeypatch.setattr("postproc.correction.process", lambda *_, **__: result)
    Path("part.nc").rename("part.txt")
    done = invoke("convert", "part.txt", "--dialect", "krl", "-o", "out", cell=CELL_FILE)
    assert done.exit_code == 0, done.output
    assert names() == PART - {"part.src"} | {"part.txt"}
    assert json.loads(Path("out/part.report.json").read_text())["blending"]["by"] == "approximation (C_DIS)"


@pytest.mark.parametrize("text", ["odd", "far"])
def test_where_nothing_comes_of_a_program_the_earlier_one_does_not_look_current(text):
    convert()
    before = content()
    Path("part.nc").write_text(text)
    done = convert(code=1)
    assert content() == {f"{name}.old": old for name, old in before.items()}
    program = Path("out/part.src")
    assert f"{program} is of an earlier run: renamed to part.src.old, and its reports likewise." in done.stderr
    assert "earlier" not in convert(code=1).stderr
    Path("part.nc").write_text("G0 X2")
    convert()
    Path("part.nc").write_text(text)
    assert "renamed to part.src.old" in convert(code=1).stderr
    assert names() == {f"{name}.old{n}" for name in PART for n in ("", "2")}


def test_a_changed_earlier_program_is_not_touched_but_named():
    convert()
    Path("out/part.src").write_text("touched up by hand")
    Path("part.nc").write_text("odd")
    before = content()
    assert f"There before, not of this run: {Path('out/part.src')}." in convert("part.nc", "--overwrite", code=1).stderr
    assert content() == before


def test_the_result_of_a_program_that_left_its_folder_is_named():
    Path("parts").mkdir()
    for name in ("one.nc", "two.nc"):
        (Path("parts") / name).write_text("G0 X1")
    assert "no longer there" not in convert("parts").stderr
    Path("parts/one.nc").unlink()
    said = f"programs that are no longer there: {Path('out/one.src')}. Do not load them."
    assert said in convert("parts").stderr
    assert "the program is no longer there" in Path("out/index.html").read_text()
    assert "no longer there" not in convert("parts/two.nc").stderr  # the user did not name the folder
    Path("out/one.src").unlink()
    assert "no longer there" not in convert("parts").stderr


def test_an_unusable_cell_leaves_the_earlier_programs_and_names_them():
    convert()
    before = content()
    done = invoke("convert", "part.nc", "-o", "out", cell="none.toml")
    assert done.exit_code == 1
    assert done.stderr.splitlines()[0] == f"There before, not of this run: {Path('out/part.src')}."
    assert "none.toml: no such file" in done.stderr
    assert content() == before


def test_predict_and_convert_leave_each_others_results():
    convert()
    before = content()
    run("predict", "part.nc", "-o", "out", cell=CELL_FILE)
    assert names() - set(before) == {f"part.predict.{kind}" for kind in ("targets.csv", "report.html", "report.json")}
    assert {name: content()[name] for name in before} == before
    run("predict", "part.nc", "-o", "out", cell=CELL_FILE)
    convert()


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("1001.nc", "P1001"),
        ("my part-1.nc", "my_part_1"),
        ("a.b.nc", "a_b"),
        ("Gehäuse_Ø40.nc", "Gehaeuse_40"),
        ("a_name_of_more_than_24_characters.nc", "a_name_of_more_than_24_c"),
        ("loop.nc", "P_loop"),
    ],
)
def test_a_name_that_krl_does_not_allow_is_made_valid_and_said_in_one_line(file, name):
    Path(file).write_text("G0 X0\n")
    done = convert(file)
    (said,) = [line for line in done.stdout.splitlines() if "the controller does not accept" in line]
    assert said.startswith("info: ")
    assert f": written as {name}.src: " in said
    assert names() == {f"{name}{ending}" for ending in (".src", ".targets.csv", ".report.html", ".report.json")}
    assert f"DEF {name}(" in Path("out", f"{name}.src").read_text()


def test_of_many_programs_the_table_says_how_they_are_called():
    Path("1001.nc").write_text("G0 X0\n")
    lines = convert("part.nc", "1001.nc").stdout.splitlines()
    assert lines[2].endswith("written as P1001.src, 1 warning")
    assert lines[1].endswith("written, 1 warning")
    assert lines[3].startswith("all 2, at most")
    assert lines[4].startswith("  - part.nc and 1 more: ")
    assert lines[5] == f"overview: {Path('out', 'index.html')}"


def test_a_name_may_be_given_for_one_program():
    convert("part.nc", "--name", "P7")
    assert "P7.src" in names()
    assert "DEF P7(" in Path("out/P7.src").read_text()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("part.nc", "--name", "7 up"), 2, "does not begin with a letter"),
        (("part.nc", "--name", "LOOP"), 2, "a word of KRL"),
        (("part.nc", "other.nc", "--name", "P7"), 2, "one name for 2 programs"),
    ],
)
def test_a_name_that_cannot_be_given_is_an_error(arguments, code, message):
    Path("other.nc").write_text("G0 X0\n")
    assert message in convert(*arguments, code=code).stderr
    assert not Path("out").exists()


@pytest.mark.parametrize("pair", [("1001.nc", "P1001.nc"), ("a b.nc", "a_b.tap"), ("a" * 25 + ".nc", "a" * 26 + ".nc")])
def test_two_programs_that_would_get_one_name_are_an_error_before_anything_is_written(pair):
    for name in pair:
        Path(name).write_text("G0 X0\n")
    assert "would both be written as" in convert(*pair, code=1).stderr
    assert not Path("out").exists()


def test_a_single_file_carries_its_own_sum(tmp_path):
    path = tmp_path / "compensator.toml"
    assert find_foreign_file(path) == []
    write_whole(tmp_path, {path.name: seal(b"# made by us.\nL_mm = 5.0\n")})
    assert find_foreign_file(path) == []
    assert path.read_text().splitlines()[1] == "L_mm = 5.0"
    for text in (path.read_text().replace("5.0", "6.0"), "L_mm = 5.0\n", ""):
        path.write_text(text)
        assert find_foreign_file(path) == [path]


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (("identify", "compensator", "x.csv", "-o", "out"), ""),
        (("identify", "elastostatics", "x.csv", "--experiment", "x.toml", "-o", "out"), "model.toml"),
        (("identify", "elastostatics", "x.csv", "--experiment", "x.toml", "-o", "out"), "robot.urdf"),
        (("identify", "geometry", "x.csv", "--experiment", "x.toml", "-o", "out"), "identification.json"),
    ],
)
def test_identify_replaces_nothing_that_is_not_its_own(arguments, name):
    place = Path("out", name)
    place.parent.mkdir(parents=True, exist_ok=True) if name else None
    place.write_text("mine")
    done = invoke(*arguments)
    assert done.exit_code == 1
    assert f"not written by postproc, or changed since: {place}." in done.stderr
    assert place.read_text() == "mine"
    assert "changed since" not in invoke(*arguments, "--overwrite").stderr
