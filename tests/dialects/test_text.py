import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from postproc.dialects import text
from postproc.errors import ProgramError


def lines(content: str, piece: int = 1000) -> list[str]:
    return [content[a:b] for a, b in zip(*text.line_spans(content, piece), strict=True)]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r\r\n", "\r"])
def test_every_kind_of_line_end_counts_once(end: str) -> None:
    assert lines(f"a{end}{end}b{end}c") == ["a", "", "b", "c"]
    assert lines(f"a{end}") == ["a"]


def test_form_feed_and_unicode_separators_do_not_end_a_line() -> None:
    assert lines("a\fb\u2028c\u0085d\nä") == ["a\fb\u2028c\u0085d", "ä"]


@given(st.text(alphabet="a\r\né€"))
@example("\r")
@example("\r\r")
@example("")
def test_lines_are_those_of_the_regular_expression_that_defines_them(content: str) -> None:
    expected = re.split(r"\r?\r?\n|\r", content)
    if expected[-1] == "":
        expected.pop()
    assert lines(content) == expected


@pytest.mark.parametrize("size", [1, 3, 100])
def test_a_document_is_written_in_pieces_of_its_text(size: int) -> None:
    content = b"\xef\xbb\xbf" + "N1 (Fräsen €)\r\nN2\r\n".encode()
    document = text.decode("part.nc", content)
    assert all(len(piece.decode()) <= size for piece in document.pieces(size))
    assert b"".join(document.pieces(size)) == document.to_bytes() == content


@pytest.mark.parametrize("piece", [1, 2, 5])
@given(st.text(alphabet="a\r\né€"))
def test_lines_found_in_pieces_are_those_of_the_whole_text(piece: int, content: str) -> None:
    assert lines(content, piece) == lines(content)


@given(st.binary(min_size=1))
def test_a_decoded_file_encodes_back_to_its_bytes_or_is_refused(data: bytes) -> None:
    try:
        document = text.decode("part.nc", data)
    except ProgramError:
        assert b"\0" in data or not data.removeprefix(b"\xef\xbb\xbf").strip()
    else:
        assert document.to_bytes() == data


@pytest.mark.parametrize(
    ("data", "encoding", "content"),
    [
        ("(Fräser)".encode(), "utf-8", "(Fräser)"),
        (b"\xef\xbb\xbfG0", "utf-8", "G0"),
        ("(Fräser)".encode("cp1252"), "cp1252", "(Fräser)"),
        (b"(\x81\x8d)", "latin-1", "(\x81\x8d)"),
    ],
)
def test_encodings_found_in_real_files_are_recognised(data: bytes, encoding: str, content: str) -> None:
    document = text.decode("part.nc", data)
    assert (document.encoding, document.text) == (encoding, content)


@pytest.mark.parametrize("data", [b"", b"\xef\xbb\xbf", b" \r\n\t\n"])
def test_an_empty_file_is_an_error(data: bytes) -> None:
    with pytest.raises(ProgramError, match=r"part\.nc: the program is empty"):
        text.decode("part.nc", data)


def test_a_binary_file_is_an_error() -> None:
    with pytest.raises(ProgramError, match="binary file"):
        text.decode("part.nc", b"G0 X1\0\1")
