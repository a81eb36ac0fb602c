"""Text of users and hosts in comments, strings and names: never a statement of the written program."""

import pytest

from postproc.dialects.krl.write.emit import _WORDS as KRL
from postproc.dialects.rapid.dialect import WORDS as RAPID
from postproc.safe_text import LONGEST, LONGEST_STRING, one_line, string_content

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
    assert one_line("x" * (LONGEST + 1)) == "x" * (LONGEST - 1) + "…"
    assert one_line("x" * LONGEST) == "x" * LONGEST
    assert len(string_content("x" * 1000)) <= LONGEST_STRING


def test_a_string_ends_where_it_should():
    assert string_content('say "stop" {now}') == "say 'stop' (now)"
