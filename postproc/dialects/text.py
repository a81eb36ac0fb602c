"""Program files as text: decoding that can be reversed to the byte, and the spans of lines. All dialects use it.

Line numbers are those an editor shows. A line ends with LF, CR, CR LF, or CR CR LF (one end: what a text-mode
transfer makes of CR LF); nothing else ends a line, neither form feed nor the Unicode separators.
"""

from __future__ import annotations

import codecs

import numpy as np

from postproc.errors import ProgramError
from postproc.program import Document, Ints

_LF, _CR = 10, 13
_PIECE = 1_000_000
"""Characters that are searched for line ends at once: arrays of a whole text would take several times its memory."""
_ENCODINGS = ("utf-8", "cp1252", "latin-1")


def decode(name: str, data: bytes) -> Document:
    """Return the content of a program file as text that encodes back to the same bytes.

    UTF-8 with or without byte order mark; other text is taken as cp1252, and as latin-1 where cp1252 has no
    character for a byte (comments in other code pages survive that way).

    :param name: file name with extension, for messages and for `Document.name`.
    :param data: content of the file.
    :raises ProgramError: the file is empty or blank, or it is binary (holds NUL bytes).
    """
    bom = codecs.BOM_UTF8 if data.startswith(codecs.BOM_UTF8) else b""
    body = data[len(bom) :]
    if not body.strip():
        raise ProgramError("the program is empty", file=name, advice="Check that the file was transferred completely.")
    nul = data.find(b"\0")
    if nul >= 0:
        raise ProgramError(
            f"binary file (byte {nul} is NUL)", file=name, advice="Give the program as text, saved as UTF-8 or ASCII."
        )
    for encoding in _ENCODINGS:
        try:
            return Document(name, body.decode(encoding), encoding, bom)
        except UnicodeDecodeError:
            continue
    raise AssertionError("latin-1 decodes any byte")  # pragma: no cover


def line_spans(text: str, piece: int = _PIECE) -> tuple[Ints, Ints]:
    """Return the starts (L,) and stops (L,) of the lines: ``text[starts[i]:stops[i]]`` is line i + 1.

    The line end is not part of the line. Text behind the last line end is a line only if it is not empty.

    :param piece: number of characters that are searched at once; extended to the next LF.
    """
    starts, stops, begin = [], [], 0
    while True:
        # behind LF no line end is cut in two: LF is always its last character
        piece_end = text.find("\n", begin + piece) + 1 or len(text)
        first, last = _spans(text[begin:piece_end])
        starts.append(first + begin)
        stops.append(last + begin)
        begin = piece_end
        if begin == len(text):
            return np.concatenate(starts), np.concatenate(stops)


def _spans(text: str) -> tuple[Ints, Ints]:
    """Return starts (L,) and stops (L,) of the lines of a text; line ends are LF, CR LF, CR CR LF and CR.

    `stops` are offsets of the first character of each line end, `ends` of its last character.
    """
    try:
        units = np.frombuffer(text.encode("latin-1"), dtype=np.uint8)
    except UnicodeEncodeError:
        units = np.frombuffer(text.encode("utf-32-le", "surrogatepass"), dtype=np.uint32)
    stops = ends = np.flatnonzero(units == _LF)
    carriage_returns = np.flatnonzero(units == _CR)
    if len(carriage_returns):
        # with two zeros, so that a CR at the end has two characters behind it
        following = np.concatenate([units, np.zeros(2, units.dtype)])
        next_unit, second_unit = following[carriage_returns + 1], following[carriage_returns + 2]
        lone_returns = carriage_returns[(next_unit != _LF) & ((next_unit != _CR) | (second_unit != _LF))]
        # ends - 1 and ends - 2 wrap round at the beginning of the text: the conditions below exclude that
        ends_with_cr, ends_with_two_cr = units[ends - 1] == _CR, units[ends - 2] == _CR
        ends_with_cr &= ends >= 1
        ends_with_two_cr &= ends_with_cr & (ends >= 2)
        stops = ends - ends_with_cr - ends_with_two_cr
        if len(lone_returns):
            ends, stops = np.concatenate([ends, lone_returns]), np.concatenate([stops, lone_returns])
            ends.sort()
            stops.sort()
    starts = np.concatenate([[0], ends + 1])
    if starts[-1] == len(units):  # no text behind the last line end
        starts = starts[:-1]
    else:
        stops = np.concatenate([stops, [len(units)]])
    return starts.astype(np.int64), stops.astype(np.int64)
