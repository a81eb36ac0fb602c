"""From text to words: comments, line ends and white space taken out, and plain motion blocks read in bulk.

A plain block holds at most an N word, one of G0…G3 and one each of X Y Z A B C I J K R F, all as decimal numbers. Such
blocks are nearly all of a program; they are read with a few passes over the bytes of the whole file and never become
Python objects. Every other block is left to `postproc.dialects.gcode.blocks`, which asks pygcode. Both readings of a
plain block are equal (property test).

White space means nothing in G-code, also within a number (``X 1 . 5`` is X1.5, ``X1 2`` is X12: the rule of RS274
and of most controls); only a comment separates.
"""

from __future__ import annotations

import re

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.decimals import numbers_in, parsed
from postproc.frames import Array
from postproc.program import Document, Ints, distinct

COLUMNS = "GXYZABCIJKRFPQL"
_PLAIN = "GXYZABCIJKRF"
LIMIT = 1e7
"""A word whose magnitude is not below this (10 km, in mm) is taken for a mistake."""

Bytes = NDArray[np.uint8]
MARK = "\x01"
"""Stands for a comment in `Source.code`."""

_COMMENTS = {"(": r"\(([^()\r\n]*)\)", ";": r";([^\r\n]*)"}
"""Character with which a comment begins → its form: one form alone, which most programs have, is found fast."""
_PACK = bytes(ord("\n") if c in b"\0\r" else c for c in range(256)).upper()
_COORDINATE = re.compile(rb"[XYZ][-+.\d#\[]")
_LINE_NUMBER = re.compile(rb"\nN\d{1,15}(?=[A-Z\n\x01])")

CUT_SHORT = "the program ends here, but coordinates follow", "Remove this %, or what stands behind it."
"""What is wrong with a % amid the blocks, and what to do."""

_END, _DIGIT, _DOT, _SIGN, _LETTER, _MARK, _OTHER = range(7)
_CLASSES = {b"\n": _END, b"0123456789": _DIGIT, b".": _DOT, b"+-": _SIGN, _PLAIN.encode(): _LETTER, b"\x01": _MARK}
_CLASS = bytes(next((v for chars, v in _CLASSES.items() if c in chars), _OTHER) for c in range(256))
_FOLLOWERS = {
    _END: (_END, _LETTER, _MARK),
    _DIGIT: (_DIGIT, _DOT, _END, _LETTER, _MARK),
    _DOT: (_DIGIT, _END, _LETTER, _MARK),
    _SIGN: (_DIGIT, _DOT),
    _LETTER: (_DIGIT, _DOT, _SIGN),
    _MARK: (_END, _LETTER, _MARK),
    _OTHER: (),
}
_WRONG_PAIR = bytes(p & 7 not in _FOLLOWERS.get(p >> 3, ()) for p in range(256))
_TO_NUMBERS = bytes(c if c in b"0123456789.+-" else ord(" ") for c in range(256))


class Source(Struct, frozen=True, eq=False):
    """A G-code file without what means nothing to a control.

    :param code: one byte a character, upper case, no white space, every comment one `MARK`; begins with a line feed,
        and every line ends with one, whatever the file uses.
    :param ends: (L + 1,) positions of the line feeds; line i + 1 of the file is ``code[ends[i] + 1 : ends[i + 1]]``.
    :param comments: text of the comments without brackets or semicolon, in order.
    :param comment_lines: (C,) their 1-based lines.
    """

    code: bytes
    ends: Ints
    comments: tuple[str, ...]
    comment_lines: Ints

    def __len__(self) -> int:
        return len(self.ends) - 1

    def line(self, row: int) -> str:
        """Return the packed code of line `row` + 1."""
        return self.code[self.ends[row] + 1 : self.ends[row + 1]].decode("ascii")

    def coordinates(self, row: int) -> Ints:
        """Return the rows behind a line that hold coordinates."""
        found = [match.start() for match in _COORDINATE.finditer(self.code, int(self.ends[min(row + 1, len(self))]))]
        return distinct(np.searchsorted(self.ends, np.array(found, dtype=np.int64)) - 1)

    def goes_on(self, row: int) -> bool:
        """Return whether coordinates stand behind a line that begins with %, which would end the program there."""
        ends = self.code[self.ends[row] + 1 : self.ends[row + 1]].strip(MARK.encode())[:1] == b"%"
        return ends and _COORDINATE.search(self.code, int(self.ends[row + 1])) is not None


def split(document: Document, line_starts: Ints) -> Source:
    """Take comments, white space, line ends and lower case out of a program.

    A bracket that belongs to no comment (nested, or not closed in its line) stays in the code.

    :param line_starts: as `postproc.dialects.text.line_starts` gives them for the text.
    """
    text = document.text.replace(MARK, "?")
    comments: tuple[str, ...] = ()
    at = np.empty(0, dtype=np.int64)
    forms = [form for begin, form in _COMMENTS.items() if begin in text]
    if forms:
        parts: list[str] = []
        told: list[str] = []
        starts: list[int] = []
        behind = 0
        for match in re.finditer("|".join(forms), text):
            starts.append(match.start())
            told.append(match[match.lastindex or 1])
            parts.append(text[behind : starts[-1]])
            behind = match.end()
        comments, at = tuple(told), np.array(starts, dtype=np.int64)
        text = MARK.join([*parts, text[behind:]])
    packed = text.encode("ascii", "replace")
    if b"\r" in packed:
        packed = packed.replace(b"\r\r\n", b"\0").replace(b"\r\n", b"\0")
    packed = packed.translate(_PACK, b" \t")
    code = b"\n" + packed if packed.endswith(b"\n") else b"\n" + packed + b"\n"
    ends = np.flatnonzero(np.frombuffer(code, dtype=np.uint8) == ord("\n"))
    return Source(code, ends, comments, np.searchsorted(line_starts, at, side="right"))


def read_plain(source: Source, rotary: str = "") -> tuple[dict[str, Array], Ints]:
    """Read the plain motion blocks of a program in bulk.

    :param rotary: letters of rotary axes; lines with others of A, B, C are not plain.
    :returns: one column (L,) for each letter of `COLUMNS`, the value of its word in each line and NaN where there is
        none, in the units of the program; and the rows of the lines that are not plain, (n,), for which the columns
        hold nothing.
    """
    code = _LINE_NUMBER.sub(b"\n", source.code) if b"\nN" in source.code else source.code
    kind = np.frombuffer(code.translate(_CLASS), dtype=np.uint8)
    ends = np.flatnonzero(kind == _END)
    odd = np.zeros(len(source), dtype=bool)
    odd[np.searchsorted(ends, _malformed(kind), side="left") - 1] = True

    letters = np.flatnonzero(kind == _LETTER)
    row = np.repeat(np.arange(len(source)), np.diff(np.searchsorted(letters, ends)))
    if odd.any():
        plain = ~odd[row]
        letters, row = letters[plain], row[plain]
        blank = np.repeat(odd, np.diff(ends))
        chars = np.frombuffer(code, dtype=np.uint8)[1:].copy()
        chars[blank] = ord(" ")
        code = chars.tobytes()
        letters = letters - 1
    letter = np.frombuffer(code, dtype=np.uint8)[letters]
    digits = code.translate(_TO_NUMBERS)
    value = parsed(np.frombuffer(digits, dtype=np.uint8), *numbers_in(np.frombuffer(digits, dtype=np.uint8)))
    if value is None:
        value = np.fromstring(digits, sep=" ")

    present = [name for name in _PLAIN if name not in "ABC" or name.encode() in code]
    by_letter = {name: np.flatnonzero(letter == ord(name)) for name in present}
    refused = [row[words] for name, words in by_letter.items() if name in "ABC" and name not in rotary]
    refused += [row[np.abs(value) >= LIMIT], row[by_letter["F"]][value[by_letter["F"]] < 0.0]]
    g = by_letter["G"]
    refused.append(row[g][~np.isin(value[g], (0.0, 1.0, 2.0, 3.0)) | np.signbit(value[g])])
    columns = {name: np.full(len(source), np.nan) for name in COLUMNS}
    for name, words in by_letter.items():
        rows = row[words]
        columns[name][rows] = value[words]
        refused.append(rows[1:][rows[1:] == rows[:-1]])  # the same letter twice
    again = np.concatenate(refused)
    for column in columns.values():
        column[again] = np.nan
    odd[again] = True
    return columns, np.flatnonzero(odd)


def _malformed(kind: Bytes) -> Ints:
    """Return positions at which the code is not that of plain words: wrong followers, two dots, no digit."""
    pairs = (kind[:-1] << 3) | kind[1:]
    wrong = np.flatnonzero(np.frombuffer(pairs.tobytes().translate(_WRONG_PAIR), dtype=np.bool_)) + 1
    dots = np.flatnonzero(kind[:-1] == _DOT)
    bare = dots[(kind[dots - 1] != _DIGIT) & (kind[dots + 1] != _DIGIT)]
    found = [wrong, bare]
    if bytes((_DOT, _DOT)) in kind.tobytes().translate(None, bytes((_DIGIT,))):
        marks = np.flatnonzero(kind != _DIGIT)
        found.append(marks[1:][(kind[marks[1:]] == _DOT) & (kind[marks[:-1]] == _DOT)])
    return np.concatenate(found)


def leave_all(source: Source) -> tuple[dict[str, Array], Ints]:
    """Return what `read_plain` returns if no line were plain: all that say something are left to pygcode."""
    rows = [row for row in range(len(source)) if source.line(row).strip(MARK)]
    return {name: np.full(len(source), np.nan) for name in COLUMNS}, np.array(rows, dtype=np.int64)
