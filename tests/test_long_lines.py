"""Lines and keys of 100,000 characters cost their length, not its square: a square would take hours here.

Files that are no files, or too large, are refused.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
import trimesh

from postproc import files
from postproc.cell import CellFile
from postproc.dialects.krl.language.tokens import FORCE
from postproc.dialects.krl.read.comments import _EDITOR_COMMENT
from postproc.errors import MAX_ERRORS, CellError, ForceError, ProgramError
from postproc.jobs import read_documents
from postproc.program import FORCE_COMMENT, parse_force_note
from tests import commands
from tests.places import CELL_FILE

LONG = 100_000


@pytest.mark.parametrize(
    "text",
    [
        "FORCE" + " " * LONG,
        "FORCE" + " " * LONG + "x",
        "FORCE" + "-" * LONG + "abc",
        "FORCE abc" + " " * LONG + "1",
        "FORCE " + "a" * LONG,
        " " * LONG + "x",
        "(" * LONG,
        "FX " * (LONG // 3),
        "FX=" + " " * LONG,
        "FORCE abc def ;" * (LONG // 15),
    ],
    ids=range(10),
)
def test_comments_about_forces(text):
    FORCE_COMMENT.match(text)
    _EDITOR_COMMENT.match(f";{text}")
    list(FORCE.finditer(f";{text}"))


def test_a_comment_with_many_words_is_read_once():
    text = "FORCE FX=1" + " FRAME=TOOL" * (LONG // 11)
    assert parse_force_note(text + " " * LONG, 1, "a.nc").frame == "TOOL"


@pytest.mark.parametrize(
    ("text", "prose"),
    [("Force exact path", True), ("FORCE --- exact path", True), ("FORCE exact 5", False), ("FORCE OFF", False),
     ("FORCE exact path" + "x" * 300, False)],
)  # fmt: skip
def test_prose_is_no_force_comment_but_a_long_one_is_refused_as_such(text, prose):
    assert (FORCE_COMMENT.match(text) is None) is prose
    if not prose and not text.endswith("OFF"):
        with pytest.raises(ForceError):
            parse_force_note(text, 1, "a.nc")


def cell(folder: Path, text: str) -> CellError:
    (folder / "cell.toml").write_text(text)
    with pytest.raises(CellError) as caught:
        files.read_toml(folder / "cell.toml", CellFile, CellError)
    return caught.value


def test_of_many_unknown_keys_the_first_are_named(tmp_path):
    cause = cell(tmp_path, "".join(f"key{k} = 1\n" for k in range(LONG // 10)))
    assert len([cause, *cause.further_errors]) == MAX_ERRORS + 1


@pytest.mark.parametrize("key", ["X1" + ".1" * (LONG // 2), "[" + "a . " * LONG + "b]", '"a".' * 31 + "b"])
def test_a_key_of_very_many_parts_is_refused(tmp_path, key):
    cause = cell(tmp_path, f"# a comment\n{key} = 1\n")
    assert (cause.problem, cause.line) == ("a key of more than 30 parts", 2)


@pytest.mark.parametrize("text", ["x" * LONG, "x " * LONG, "- " * LONG], ids=range(3))
def test_other_long_lines_of_toml_are_errors_of_their_line(tmp_path, text):
    assert "not valid TOML" in str(cell(tmp_path, text))


@pytest.mark.skipif(os.name != "posix", reason="pipes and links of POSIX")
def test_what_is_no_file_is_refused_with_its_cause(tmp_path):
    os.mkfifo(tmp_path / "pipe.nc")
    (tmp_path / "loop.nc").symlink_to(tmp_path / "loop.nc")
    (tmp_path / "folder.nc").mkdir()
    for path, cause in (
        (tmp_path / "pipe.nc", "a device or a pipe, not a file"),
        (Path("/dev/zero"), "a device or a pipe, not a file"),
        (tmp_path / "folder.nc", "a folder, not a file"),
        (tmp_path / "loop.nc", "Too many levels of symbolic links"),
        (tmp_path / "none.nc", "no such file"),
    ):
        with pytest.raises(ProgramError, match=cause):
            read_documents(path, "gcode")


@pytest.mark.skipif(os.name != "posix", reason="links of POSIX")
@pytest.mark.parametrize("loop", ["a.nc", "cell.toml", "f.csv"])
def test_links_that_lead_to_themselves_are_named(tmp_path, monkeypatch, loop):
    monkeypatch.chdir(tmp_path)
    Path("a.nc").write_text("G21 G90\nG0 X0 Y0 Z20\nM30\n")
    shutil.copy(CELL_FILE, "cell.toml")
    Path("f.csv").write_text("line,Fx,Fy,Fz\n2,1,2,3\n")
    Path(loop).unlink()
    Path(loop).symlink_to(loop)
    printed = commands.printed("convert", "a.nc", "--forces", "f.csv", "-o", "out", cell="cell.toml", code=1)
    assert f"{loop}: cannot be read (Too many levels of symbolic links)" in printed


def test_a_mesh_that_ends_too_early_or_has_no_reader_is_named_so(tmp_path):
    content = trimesh.creation.box().export(file_type="stl")
    (tmp_path / "box.stl").write_bytes(content)
    assert len(files.read_mesh(tmp_path / "box.stl", CellError, "mesh").faces) == 12
    (tmp_path / "box.stl").write_bytes(content[:-120])
    with pytest.raises(CellError, match=r"cannot be read \(the file ends after 9 of 12 facets\)"):
        files.read_mesh(tmp_path / "box.stl", CellError, "mesh")
    (tmp_path / "box.xyzzy").write_bytes(content)
    with pytest.raises(CellError, match=r"no reader of \.xyzzy is installed"):
        files.read_mesh(tmp_path / "box.xyzzy", CellError, "mesh")


def test_files_of_more_than_a_gibibyte_are_refused(tmp_path):
    with (tmp_path / "large.nc").open("wb") as file:
        file.truncate(files.reading.MOST_BYTES + 1)
    with pytest.raises(ProgramError, match=r"a file of 1\.0 GiB: at most 1 GiB are read"):
        read_documents(tmp_path / "large.nc", "gcode")
