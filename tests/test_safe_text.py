"""Text of users and hosts in comments, strings and names: never a statement of the written program."""

import pytest

from postproc.dialects.krl.write.emit import _WORDS as KRL
from postproc.dialects.rapid.new_module import WORDS as RAPID
from postproc.safe_text import LONGEST_STRING, MAX_COMMENT, one_line, string_content
from tests.commands import run
from tests.places import ROOT

ENDS = ["\n", "\r", "\r\n", "\v", "\f", "\x1a", "\x1c", "\x85", "\u2028", "\u2029", "\0"]


@pytest.mark.parametrize("end", ENDS, ids=map(repr, ENDS))
@pytest.mark.parametrize("safe", [one_line, string_content, KRL.printable, RAPID.printable])
def test_a_text_stays_one_line(safe, end):
    text = safe(f"pocket{end}LIN (X 500)")
    assert len(text.splitlines()) == 1
    assert end not in text
    assert text == "pocket LIN (X 500)"


def test_ordinary_text_is_kept():
    assert one_line("Tasche Nr. 3 (außen)\t½ fertig, 50 % {A}") == "Tasche Nr. 3 (außen)\t½ fertig, 50 % {A}"


def test_long_text_is_cut_off_and_shows_it():
    assert one_line("x" * (MAX_COMMENT + 1)) == "x" * (MAX_COMMENT - 1) + "…"
    assert one_line("x" * MAX_COMMENT) == "x" * MAX_COMMENT
    assert len(string_content("x" * 1000)) <= LONGEST_STRING


def test_a_string_ends_where_it_should():
    assert string_content('say "stop" {now}') == "say 'stop' (now)"


HOSTILE = 'pocket\x0bHALT\x85HALT\u2028HALT;x "q" {b}'
CAM = {
    "we ird'{A}\nHALT.nc": f"G21 G90\nG0 X50 Y50 Z5\n({HOSTILE})\nG1 Z-1 F300\nX60 ; {HOSTILE}\nM2\n",
    "part.apt": f"PARTNO {HOSTILE}\nUNITS/MM\nRAPID\nGOTO/50,50,5\nPPRINT {HOSTILE}\n"
    "FEDRAT/300,MMPM\nGOTO/60,50,-1\nFINI\n",
}


@pytest.mark.parametrize(
    ("name", "cell", "options"),
    [("we ird'{A}\nHALT.nc", "cell_kr270.toml", ()), ("part.apt", "cell_irb6700.toml", ("--to", "rapid"))],
)
def test_comments_and_names_of_cam_programs_are_comments_of_the_written_program(tmp_path, name, cell, options):
    source = tmp_path / name
    source.write_text(CAM[name], encoding="utf-8")
    arguments = ["convert", str(source), "--cell", str(ROOT / "samples" / cell), "-o", str(tmp_path / "out"), *options]
    run(*arguments)
    (written,) = [path for path in (tmp_path / "out").iterdir() if path.suffix in (".src", ".mod")]
    assert written.stem.replace("_", "").isalnum()
    text = written.read_bytes().decode("cp1252")
    assert set(text) <= {"\r", "\n", *map(chr, range(32, 127))}
    lines = [line.strip() for line in text.split("\r\n") if "HALT" in line and not line.startswith("DEF ")]
    assert len(lines) >= 1
    assert all(line.startswith((";", "!")) for line in lines), lines
