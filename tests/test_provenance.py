"""The line that says where a program comes from: what it covers and notices; nothing is corrected twice."""

from __future__ import annotations

import hashlib
import json
import re

import pytest

from postproc import load_cell, load_robot, process, read_program
from postproc.dialects.krl.dialect import KRL
from postproc.dialects.text import decode
from postproc.provenance import Origin
from tests.commands import printed
from tests.places import CELL_FILE, SAMPLES

GCODE = "G90 G21\n(FORCE FX=300 FZ=200)\nS1000 F600\nG0 X0 Y0 Z10\nG1 Z0\nG1 X20\nG1 X40 Y20\nM2\n"
ORIGIN = Origin("9.9", "corrected", "a" * 64, "b" * 64, "c" * 64)


@pytest.fixture
def written(tmp_path):
    """Folder with part.nc and out/part.src."""
    (tmp_path / "part.nc").write_text(GCODE)
    printed("convert", tmp_path / "part.nc", "--cell", CELL_FILE, "-o", tmp_path / "out")
    return tmp_path


def sha(data):
    return hashlib.sha256(data).hexdigest()


def test_the_line_holds_the_sums_of_the_files_it_names(written):
    data = (written / "out" / "part.src").read_bytes()
    (line,) = [line for line in data.splitlines(keepends=True) if line.startswith(b";POSTPROC")]
    assert data.splitlines(keepends=True)[4] == line
    said = dict(part.split("=") for part in line.decode().split()[2:])
    assert said["mode"] == "corrected"
    assert said["text"] == sha(data.replace(line, b""))
    assert said["source"] == sha(GCODE.encode())
    assert said["cell"] == sha(CELL_FILE.read_bytes())
    folder = SAMPLES.parent / "robot_models" / "kuka_kr270"
    assert said["model"] == sha((folder / "robot.urdf").read_bytes() + (folder / "model.toml").read_bytes())
    assert said["forces"] == "-"
    forces = written / "f.csv"
    forces.write_text("line,Fx,Fy,Fz\n6,1,2,3\n")
    printed("convert", written / "part.nc", "--cell", CELL_FILE, "-o", written / "out", "--forces", forces)
    assert f"forces={sha(forces.read_bytes())}" in (written / "out" / "part.src").read_text()


def test_the_deviation_that_its_targets_make_up_for_is_no_error_of_the_part(written):
    """`predict` refuses a program as it was written by hand for it, not the corrected one."""
    part = written / "out" / "part.src"
    command = ["predict", part, "--cell", CELL_FILE, "-o", written / "again", "--part-tolerance", 0.6]
    reason = "the expected error on the part is up to"
    output = printed(*command)
    assert "its targets compensate the deviation predicted here" in output
    assert reason not in output
    part.write_bytes(b"".join(line for line in part.read_bytes().splitlines(keepends=True) if b";POSTPROC" not in line))
    assert reason in printed(*command, code=3)


def test_lines_of_the_targets_are_those_of_the_marked_text(written):
    text = (written / "out" / "part.src").read_text().splitlines()
    rows = (written / "out" / "part.targets.csv").read_text().splitlines()[1:]
    for row in rows:
        line, x = row.split(",")[0], row.split(",")[10]
        assert f"X {float(x):g}," in text[int(line) - 1]


def test_a_corrected_program_is_not_corrected_again_even_when_it_was_edited(written):
    src = written / "out" / "part.src"
    for change in ("", "; a comment more\n"):
        src.write_text(src.read_text() + change)
        output = printed("convert", src, "--cell", CELL_FILE, "-o", written / "again", code=1)
        assert "part.src:5: this program was corrected" in output
        assert "corrected twice" in output
        assert not (written / "again" / "part.src").exists()


def test_a_nominal_program_can_be_corrected_and_says_so_then(written):
    printed("convert", written / "part.nc", "--cell", CELL_FILE, "-o", written / "nominal", "--nominal")
    src = written / "nominal" / "part.src"
    assert " mode=nominal " in src.read_text()
    printed("convert", src, "--cell", CELL_FILE, "-o", written / "again")
    text = (written / "again" / "part.src").read_text()
    assert text.count(";POSTPROC") == 1
    assert " mode=corrected " in text
    same = re.compile("LIN .*")
    assert same.findall(text.partition("LIN")[2])[-1] == same.findall((written / "out" / "part.src").read_text())[-1]


def test_predict_tells_whether_the_text_is_what_was_written(written):
    src = written / "out" / "part.src"
    output = printed("predict", src, "--cell", CELL_FILE, "-o", written / "p")
    assert "written by postproc" in output
    assert "(corrected), unchanged since" in output
    said = json.loads((written / "p" / "part.predict.report.json").read_text())["provenance"]
    assert said["state"] == "intact"
    assert said["mode"] == "corrected"
    src.write_bytes(src.read_bytes().replace(b"$VEL.CP=0.01", b"$VEL.CP=0.02"))
    output = printed("predict", src, "--cell", CELL_FILE, "-o", written / "p")
    assert "unchanged" not in output
    assert "line 5: this program was changed since postproc" in output
    assert json.loads((written / "p" / "part.predict.report.json").read_text())["provenance"]["state"] == "changed"


def issues(path, mode, cell=CELL_FILE):
    """Level, kind and line of the issues of where a program comes from, and whether anything would be written."""
    settings = load_cell(cell)
    robot = load_robot(settings.robot)
    result = process(read_program(path, robot, settings), robot, settings, mode=mode)
    kinds = ("part-of-program", "corrected-before", "changed-since")
    found = [(issue.level, issue.kind, issue.source_line) for issue in result.issues if issue.kind in kinds]
    assert bool(result.documents) == (mode != "predict" and not result.failed)
    return found


def test_the_issue_of_a_corrected_program_names_its_kind_and_line(written):
    src = written / "out" / "part.src"
    for mode in ("convert", "nominal"):
        assert issues(src, mode) == [("error", "corrected-before", 5)]
    assert issues(src, "predict") == []
    src.write_bytes(src.read_bytes().replace(b"$VEL.CP=0.01", b"$VEL.CP=0.02"))
    for mode in ("convert", "nominal"):
        assert issues(src, mode) == [("error", "corrected-before", 5)]
    assert issues(src, "predict") == [("warning", "changed-since", 5)]


def test_the_issue_of_a_nominal_program_that_was_edited_is_a_warning(written):
    printed("convert", written / "part.nc", "--cell", CELL_FILE, "-o", written / "nominal", "--nominal")
    src = written / "nominal" / "part.src"
    for mode in ("convert", "nominal", "predict"):
        assert issues(src, mode) == []
    src.write_bytes(src.read_bytes().replace(b"$VEL.CP=0.01", b"$VEL.CP=0.02"))
    for mode in ("convert", "nominal", "predict"):
        assert issues(src, mode) == [("warning", "changed-since", 5)]


def test_the_issue_of_a_subprogram_that_was_corrected_names_its_kind(tmp_path):
    """It has no line: the call is right, the file that it calls is not."""
    program = (
        "DEF {name}( )\nBAS(#INITMOV,0)\n$VEL.CP=0.05\nPTP {{A1 0,A2 -70,A3 110,A4 0,A5 50,A6 20}}\n"
        ";FORCE FX=200 FY=100 FZ=-100\nLIN {{X 0,Y 0,Z 10,A 0,B 0,C 180}}\nsub()\nEND\n"
    )
    for name in ("one", "two"):
        (tmp_path / f"{name}.src").write_text(program.format(name=name))
    (tmp_path / "sub.src").write_text("DEF sub()\nLIN {X 20,Y 20,Z 0,A 0,B 0,C 180}\nEND\n")
    printed("convert", tmp_path / "one.src", "--cell", CELL_FILE, "-o", tmp_path / "out")
    two = tmp_path / "out" / "two.src"
    two.write_text((tmp_path / "two.src").read_text())
    assert issues(tmp_path / "two.src", "convert") == []
    assert issues(two, "convert") == [("error", "corrected-before", None)]
    assert issues(two, "predict") == []


def test_the_issue_of_a_part_of_a_program_names_its_kind_and_line(written):
    cell = written / "cell.toml"
    cell.write_text(CELL_FILE.read_text().replace("[output]", "[output]\nlines_per_file = 8"))
    printed("convert", written / "part.nc", "--cell", cell, "-o", written / "parts")
    parts = sorted(path for path in (written / "parts").glob("part*.src") if path.stem != "partMain")
    assert len(parts) > 1
    for part in parts:  # a part that sets no speed cannot be read alone
        lines = part.read_text().splitlines()
        (line,) = [number for number, text in enumerate(lines, 1) if text.startswith(";POSTPROC 1 part=")]
        assert lines[line - 1].endswith(" of=partMain")
        for mode in ("convert", "nominal", "predict"):
            assert issues(part, mode, cell) == [("error", "part-of-program", line)]


def test_a_program_that_comes_back_byte_for_byte_is_not_marked(tmp_path):
    src = b"DEF part( )\r\n$VEL.CP=0.05\r\nLIN {X 100,Y 0,Z 50,A 180,B 0,C 180}\r\nEND\r\n"
    (tmp_path / "part.src").write_bytes(src)
    for options in ([], ["--nominal"]):
        printed("convert", tmp_path / "part.src", "--cell", CELL_FILE, "-o", tmp_path / "out", *options)
        assert (tmp_path / "out" / "part.src").read_bytes() == src


def documents(text, data="DEFDAT part\nENDDAT\n"):
    return decode("part.src", text.encode()), decode("part.dat", data.encode())


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r\r\n"])
def test_marking_keeps_every_other_byte_and_the_line_ends(end):
    text = f"&ACCESS RVP{end}  def Part ( ){end};x{end}END{end}"
    marked, moved = KRL.writer.mark(documents(text), ORIGIN)
    assert moved == 3
    (line,) = [line for line in marked[0].text.split(end) if "POSTPROC" in line]
    assert marked[0].text.replace(line + end, "") == text
    said = KRL.writer.origin(marked)
    assert (said.state, said.mode, said.version, said.line) == ("intact", "corrected", "9.9", 3)
    again, moved = KRL.writer.mark(marked, ORIGIN)
    assert (again[0].text, moved) == (marked[0].text, 0)


def test_any_change_is_noticed_in_either_file():
    text = "DEF part( )\r\nLIN XP1\r\nEND\r\n"
    marked, _ = KRL.writer.mark(documents(text), ORIGIN)
    assert KRL.writer.origin(marked).state == "intact"
    src, dat = (document.text for document in marked)
    line = src.splitlines(keepends=True)[1]
    for other in (
        documents(src.replace("XP1", "XP2"), dat),
        documents(src + "\n", dat),
        documents(src.replace("\r\n", "\n"), dat),
        documents(src, dat.replace("part", "Part")),
        documents(src, dat)[:1],
        documents(src.replace(line, line + line), dat),
        documents(src.replace("POSTPROC 1", "POSTPROC 2"), dat),
        documents(src.replace("text=", "text=0"), dat),
        documents(src.replace(line, ";POSTPROC\r\n"), dat),
    ):
        assert KRL.writer.origin(other).state == "changed"
    assert (
        KRL.writer.origin(documents(src.replace(line, line + "\r\n").replace("\r\n\r\n", "\r\n"), dat)).state
        == "intact"
    )
    assert KRL.writer.origin(documents(src.replace("1 version", "1  version"), dat)).state == "intact"
    assert KRL.writer.origin(documents(text.replace("LIN", ";POSTPROCESSED\r\nLIN"))).state == "none"


@pytest.mark.parametrize("comment", ["; Postproc: KRC4 mill V3", ";POSTPROC VERSION 3", "; postproc - 5 axes"])
def test_a_comment_of_another_post_processor_is_only_a_comment(comment):
    text = f"DEF part( )\r\n{comment}\r\nLIN {{X 1}}\r\nEND\r\n"
    assert KRL.writer.origin(documents(text)).state == "none"
    marked, _ = KRL.writer.mark(documents(text), ORIGIN)
    assert comment in marked[0].text.splitlines()
    assert KRL.writer.origin(marked).state == "intact"
