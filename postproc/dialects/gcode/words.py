"""Words of G-code blocks: plain motion blocks in bulk, other blocks one by one with pygcode.

A plain block has at most an N word, one of G0…G3 and one each of X Y Z A B C I J K R F, all as decimal numbers. Most
blocks of a program are plain. They are read with a few passes over the bytes of the whole file and never become Python
objects. pygcode reads every other block (`words_of`). A property test checks that both readings of a plain block agree.

White space has no meaning in G-code, not even within a number (``X 1 . 5`` is X1.5, ``X1 2`` is X12: the rule of RS274
and of most controls). Only a comment separates words.

pygcode decides which words a block has and which codes exclude each other. It skips characters that it does not know
and stops at signs that it does not expect. Therefore a grammar of our own splits the block first, and pygcode must find
the same words.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.chunks import chunks, compact
from postproc.decimals import parsed_numbers, word_bounds
from postproc.errors import Level
from postproc.frames import Array
from postproc.program import Document, Ints, distinct

GROUPS = "G", "XYZ", "A", "B", "C", "IJK", "R", "F", "P", "Q", "L"
"""Letters whose words are kept, in groups."""
COLUMNS = "".join(GROUPS)
_COLUMN_OF_LETTER = {letter: (group, column) for group in GROUPS for column, letter in enumerate(group)}
_PLAIN_LETTERS = "GXYZABCIJKRF"
WORD_LIMIT = 1e7
"""Words of this magnitude or more (10 km, in mm) are refused as mistakes."""

Bytes = NDArray[np.uint8]
COMMENT_MARK = "\x01"
"""Replaces a comment in `Source.code`."""

_COMMENTS = {"(": r"\(([^()\r\n]*)\)", ";": r";([^\r\n]*)", '"': r"[Mm][Ss][Gg][ \t]*\"([^\"\r\n]*)\""}
"""Character of a comment → its pattern. Most programs use one form, and a search for one pattern is fast."""
_NESTED_BRACKET = re.compile(r"\([^()\r\n]*\(")
_NESTED_COMMENT = r"\(((?:[^()\r\n]|\([^()\r\n]*\))*)\)"
_STATUS_QUERY = re.compile(r"^[ \t]*\?(?=[ \t]*(?:[;(\r\n]|\Z))", re.MULTILINE)
_INNER_COMMENT = re.compile(r"\([^()]*\)")
_BLOCK_TEXT = re.compile(r"(?:[A-Z][-+]*(?:[\d.]+|[#\[].*))+", re.IGNORECASE)
_PACKING_TABLE = bytes(ord("\n") if c in b"\0\r" else c for c in range(256)).upper()
_COORDINATE_WORD = re.compile(rb"[XYZ][-+.\d#\[]")
_LINE_NUMBER = re.compile(rb"\nN\d{1,15}(?=[A-Z\n\x01])")

EARLY_PERCENT = "the program ends here, but coordinates follow", "Remove this %, or what follows it."
"""Problem and advice for a % between blocks."""

# classes of characters: line feed, digit, …, comment, and all that plain blocks do not have
_END, _DIGIT, _DOT, _SIGN, _LETTER, _MARK, _OTHER_CHARACTER = range(7)
_CLASSES = {
    b"\n": _END,
    b"0123456789": _DIGIT,
    b".": _DOT,
    b"+-": _SIGN,
    _PLAIN_LETTERS.encode(): _LETTER,
    b"\x01": _MARK,
}
_CLASS_TABLE = bytes(next((v for chars, v in _CLASSES.items() if c in chars), _OTHER_CHARACTER) for c in range(256))
"""Byte of a character → its class."""
_FOLLOWERS = {
    _END: (_END, _LETTER, _MARK),
    _DIGIT: (_DIGIT, _DOT, _END, _LETTER, _MARK),
    _DOT: (_DIGIT, _END, _LETTER, _MARK),
    _SIGN: (_DIGIT, _DOT),
    _LETTER: (_DIGIT, _DOT, _SIGN),
    _MARK: (_END, _LETTER, _MARK),
    _OTHER_CHARACTER: (),
}
"""Class of a character → classes of the characters that may follow it in a plain block."""
_WRONG_PAIR = bytes(p & 7 not in _FOLLOWERS.get(p >> 3, ()) for p in range(256))
"""Two classes as one byte, the first shifted by three bits → 1 if the second may not follow the first."""
_TO_NUMBERS = bytes(c if c in b"0123456789.+-" else ord(" ") for c in range(256))


class Source(Struct, frozen=True, eq=False):
    """A G-code file without the characters that a control ignores: its packed code.

    :param code: one byte a character, upper case, no white space, every comment one `COMMENT_MARK`; begins with a line
        feed, and every line ends with one, whatever the file uses.
    :param ends: (L + 1,) positions of the line feeds; row i, line i + 1 of the file, is
        ``code[ends[i] + 1 : ends[i + 1]]``.
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
        """Return the packed code of a row (from 0), which is line `row` + 1 of the file."""
        return self.code[self.ends[row] + 1 : self.ends[row + 1]].decode("ascii")

    def rows_with_coordinates(self, row: int) -> Ints:
        """Return the rows (n,) after `row` that have coordinates, ascending."""
        positions = [
            match.start() for match in _COORDINATE_WORD.finditer(self.code, int(self.ends[min(row + 1, len(self))]))
        ]
        return distinct(np.searchsorted(self.ends, np.array(positions, dtype=np.int64)) - 1)

    def has_coordinates_after_percent(self, row: int) -> bool:
        """Return whether a row begins or ends with %, which ends the program, and coordinates follow it."""
        line = self.code[self.ends[row] + 1 : self.ends[row + 1]].strip(COMMENT_MARK.encode())
        has_percent = line.startswith(b"%") or line.endswith(b"%")
        return has_percent and _COORDINATE_WORD.search(self.code, int(self.ends[row + 1])) is not None


class Words:
    """Values of the words in L lines, in the units of the program. A group without words takes no memory."""

    def __init__(self, row_count: int) -> None:
        self._row_count = row_count
        self._values: dict[str, Array] = {}

    def __getitem__(self, group: str) -> Array:
        """Return the values (L, n) of a group of letters, one of `GROUPS`; NaN where a line has no such word."""
        values = self._values.get(group)
        return np.broadcast_to(np.nan, (self._row_count, len(group))) if values is None else values

    def column(self, letter: str) -> Array:
        """Return the values (L,) of a letter; NaN where a line has no such word."""
        group, column = _COLUMN_OF_LETTER[letter]
        return self[group][:, column]

    def put(self, letter: str, rows: Ints | int, values: Array | float) -> None:
        """Set the words with a letter of lines (n,), or of a single line, to values (n,)."""
        group, column = _COLUMN_OF_LETTER[letter]
        if group not in self._values:
            self._values[group] = np.full((self._row_count, len(group)), np.nan)
        self._values[group][rows, column] = values

    def remove(self, rows: Ints) -> None:
        """Remove all words of lines (n,)."""
        for values in self._values.values():
            values[rows] = np.nan


def split(document: Document) -> Source:
    """Return a program in upper case, without comments and white space.

    A bracket that is not closed in its line stays in the code. Some controls end a comment at its first closing
    bracket. So brackets within a comment belong to it only if the text after the first closing bracket is no block.
    """
    text = document.text
    if "?" in text:
        text = _STATUS_QUERY.sub("$?", text)  # marks the command to Grbl: characters that are not ASCII become ? below
    text, comments = _mark_comments(text.replace(COMMENT_MARK, "?"))  # the file has no mark of its own then
    code_bytes = text.encode("ascii", "replace")
    if b"\r" in code_bytes:
        code_bytes = code_bytes.replace(b"\r\r\n", b"\0").replace(b"\r\n", b"\0")
    code_bytes = code_bytes.translate(_PACKING_TABLE, b" \t")
    code = b"\n" + code_bytes if code_bytes.endswith(b"\n") else b"\n" + code_bytes + b"\n"
    ends = line_feeds(code)
    marks = (
        np.flatnonzero(np.frombuffer(code, dtype=np.uint8) == ord(COMMENT_MARK))
        if comments
        else np.zeros(0, dtype=np.int64)
    )
    return Source(code, ends, comments, np.searchsorted(ends, marks))


def _mark_comments(text: str) -> tuple[str, tuple[str, ...]]:
    """Return a text with a `COMMENT_MARK` for each comment, and the comments in order, without brackets or semicolon.

    A comment with brackets inside stays in the text if some controls would read part of it as a block.
    """
    is_nested = _NESTED_BRACKET.search(text) is not None
    forms = [form for begin, form in _COMMENTS.items() if begin in text]
    if is_nested:
        forms[0] = _NESTED_COMMENT  # in place of the form with brackets, which is the first
    if not forms:
        return text, ()
    parts: list[str] = []
    comments: list[str] = []
    text_start = 0
    for match in re.finditer("|".join(forms), text):
        if is_nested and not _is_comment(match[0]):
            continue
        comments.append(match[match.lastindex or 1])  # each form has one group
        parts.append(text[text_start : match.start()])
        text_start = match.end()
    return COMMENT_MARK.join([*parts, text[text_start:]]), tuple(comments)


def line_feeds(code: bytes) -> Ints:
    """Return the positions of the line feeds in packed code."""
    return compact(np.flatnonzero(np.frombuffer(code, dtype=np.uint8) == ord("\n")), np.int32)


def _is_comment(text: str) -> bool:
    """Return whether a comment with brackets is a comment on every control.

    It is not if a control that ends it at its first closing bracket would read the text after that as a block.
    """
    # the text between the first closing bracket and the last; a comment after a semicolon has none
    text_behind_bracket = _INNER_COMMENT.sub("", text.partition(")")[2])[:-1] if text.startswith("(") else ""
    return _BLOCK_TEXT.fullmatch("".join(text_behind_bracket.split())) is None


def read_plain(source: Source, rotary: str = "") -> tuple[Words, Ints]:
    """Read the plain motion blocks of a program (see the module) in bulk.

    :param rotary: letters of the rotary axes; a line with another letter of A, B, C is not plain.
    :returns: the words of the plain blocks, and the rows (n,) of all other lines with text, ascending.
    """
    words = Words(len(source))
    other_rows = [
        _read_lines(source, lines.start, min(lines.stop, len(source)), rotary, words) for lines in chunks(len(source))
    ]
    return words, np.concatenate(other_rows)


def _read_lines(source: Source, first: int, last: int, rotary: str, words: Words) -> Ints:
    """Read the plain blocks of some lines into `words`: N and one each of G0…G3, X, Y, Z …, all as decimal numbers.

    :param first: row of the first line; `last`: row after the last.
    :param rotary: letters of the rotary axes.
    :returns: rows (n,) of the lines that are not plain, which the parser for single blocks reads.
    """
    count = last - first
    code = source.code[source.ends[first] : source.ends[last] + 1]
    code = _LINE_NUMBER.sub(b"\n", code) if b"\nN" in code else code
    kind = np.frombuffer(code.translate(_CLASS_TABLE), dtype=np.uint8)  # class of each character
    ends = np.flatnonzero(kind == _END)
    needs_parser = np.zeros(count, dtype=bool)
    needs_parser[np.searchsorted(ends, _malformed_words(kind), side="left") - 1] = True

    letters = np.flatnonzero(kind == _LETTER)  # positions of the words
    row = np.repeat(np.arange(count), np.diff(np.searchsorted(letters, ends)))
    if needs_parser.any():
        is_plain = ~needs_parser[row]
        letters, row = letters[is_plain], row[is_plain]
        code = _blanked(code, ends, needs_parser)
    letter = np.frombuffer(code, dtype=np.uint8)[letters]
    value = _numbers(code)  # the number behind each of `letters`

    by_letter = {name: np.flatnonzero(letter == ord(name)) for name in _PLAIN_LETTERS if name.encode() in code}
    refused_row_parts = [row[np.abs(value) >= WORD_LIMIT]]
    for name, indices in by_letter.items():
        rows, letter_values = row[indices], value[indices]
        if name in "ABC" and name not in rotary:
            refused_row_parts.append(rows)
            continue
        words.put(name, first + rows, letter_values)
        refused_row_parts.append(rows[1:][rows[1:] == rows[:-1]])  # the letter twice in a line
        if name == "F":
            refused_row_parts.append(rows[letter_values < 0.0])
        elif name == "G":
            is_motion_code = np.isin(letter_values, (0.0, 1.0, 2.0, 3.0)) & ~np.signbit(letter_values)  # not G-0
            refused_row_parts.append(rows[~is_motion_code])
    refused_rows = np.concatenate(refused_row_parts)
    words.remove(first + refused_rows)
    needs_parser[refused_rows] = True
    return first + np.flatnonzero(needs_parser)


def _blanked(code: bytes, ends: Ints, is_blank: NDArray[np.bool_]) -> bytes:
    """Return code with blanks in some of its lines.

    :param ends: (n + 1,) positions of the line feeds; line i is ``code[ends[i] + 1 : ends[i + 1]]``.
    :param is_blank: (n,) lines to blank, with their line feeds.
    """
    characters = np.frombuffer(code, dtype=np.uint8).copy()
    characters[1:][np.repeat(is_blank, np.diff(ends))] = ord(" ")  # the first character is a line feed of no line
    return characters.tobytes()


def _numbers(code: bytes) -> Array:
    """Return the numbers of all words of plain blocks (n,), in order."""
    number_texts = code.translate(_TO_NUMBERS)  # blanks between the numbers
    characters = np.frombuffer(number_texts, dtype=np.uint8)
    values = parsed_numbers(characters, *word_bounds(characters))
    if values is None:  # numbers with more digits than the fast method reads
        return np.fromstring(number_texts, sep=" ")
    return values


def _malformed_words(kind: Bytes) -> Ints:
    """Return positions (n,) at which a word is not plain: a wrong next character, two dots, or no digit at a dot.

    :param kind: (N,) class of each character, such as `_DIGIT`.
    """
    pairs = (kind[:-1] << 3) | kind[1:]  # a class takes three bits
    wrong = np.flatnonzero(np.frombuffer(pairs.tobytes().translate(_WRONG_PAIR), dtype=np.bool_)) + 1
    dots = np.flatnonzero(kind[:-1] == _DOT)
    bare_dots = dots[(kind[dots - 1] != _DIGIT) & (kind[dots + 1] != _DIGIT)]
    positions = [wrong, bare_dots]
    if bytes((_DOT, _DOT)) in kind.tobytes().translate(None, bytes((_DIGIT,))):
        # two dots with only digits between them
        non_digits = np.flatnonzero(kind != _DIGIT)
        is_second_dot = (kind[non_digits[1:]] == _DOT) & (kind[non_digits[:-1]] == _DOT)
        positions.append(non_digits[1:][is_second_dot])
    return np.concatenate(positions)


def no_plain_words(source: Source) -> tuple[Words, Ints]:
    """Return empty words and the rows (n,) of all lines with text: `read_plain` without plain lines (for tests)."""
    rows = [row for row in range(len(source)) if source.line(row).strip(COMMENT_MARK)]
    return Words(len(source)), np.array(rows, dtype=np.int64)


_WORD = re.compile(rf"{COMMENT_MARK}*([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))")
_PROGRAM_NUMBER = re.compile(rf"{COMMENT_MARK}*(?:N\d+{COMMENT_MARK}*)?[O:]\d+{COMMENT_MARK}*")


_BARE_HOME = re.compile(
    rf"{COMMENT_MARK}*(?:N\d{{1,15}}{COMMENT_MARK}*)?G(28|30){COMMENT_MARK}*([XYZ]{{1,3}}){COMMENT_MARK}*"
)

_MOST_WORDS = 100
"""More words than all letters and modal groups together: such a block is refused."""
_MOST_DIGITS = 15
"""Whole numbers of more digits are not exact as floats, and could name another line, tool or count (N, T, L)."""
_CHARACTER_ADVICE = {
    "/": "Write / at the beginning of the block.",
    ",": "Write decimals with a point: X10.5. Corners (,R and ,C) are not read: let the CAM system write them out.",
    "@": "Polar coordinates are not read: let the CAM system write X and Y.",
    "^": "Polar coordinates are not read: let the CAM system write X and Y.",
    ":": "Write the number of the program as O1001 or :1001.",
    "$": "Remove settings of a Grbl controller ($110=500), and the number of a spindle ($1).",
}
_WHOLE_NUMBER_ADVICE = {
    "M": "Write one M code for each function.",
    "T": "Write the number of the tool alone, like T1: $TOOL contains its length (Fagor: the offset after the point).",
}
_O_ADVICE = "Write an O number in a line of its own."


class Fault(Struct, frozen=True):
    """Why a line cannot be read.

    :param row: row of the line.
    :param problem: what is wrong.
    :param advice: what to do; None: the problem says it.
    :param lost_text: text of a block whose effect is unknown: position, modes and feed of later lines are in doubt.
        Empty: the fault has no effect on later lines.
    """

    row: int
    problem: str
    advice: str | None = None
    lost_text: str = ""


class Remark(NamedTuple):
    """A remark on a line for the user.

    :param row: row of the line.
    :param level, kind, message: see `Issue`.
    """

    row: int
    level: Level
    kind: str
    message: str


class BlockError(Exception):
    """A block cannot be read.

    :ivar problem: what is wrong; `advice`: what to do, or None.
    """

    def __init__(self, problem: str, advice: str | None) -> None:
        super().__init__(problem, advice)
        self.problem, self.advice = problem, advice

    def fault(self, row: int, lost_text: str = "") -> Fault:
        """Return the error as a fault of a row; `lost_text`: see `Fault`."""
        return Fault(row, self.problem, self.advice, lost_text)


def words_of(code: str) -> list[tuple[str, float]]:
    """Return the words of a block, (letter, value) in order, without its N word or program number.

    G28 and G30 may have letters without numbers for the axes that go home (``G28 X Y``, Marlin): their value is NaN.

    :param code: packed code of the block, see `Source`.
    :raises BlockError: part of the block is not a word, a word is repeated or out of range, or two codes exclude each
        other.
    """
    from pygcode.block import Block

    if _PROGRAM_NUMBER.fullmatch(code):
        return []
    bare = _BARE_HOME.fullmatch(code)
    if bare is not None and len(set(bare[2])) == len(bare[2]):
        return [("G", float(bare[1])), *((letter, float("nan")) for letter in bare[2])]
    pairs = _letters_and_numbers(code)  # as texts
    try:
        block = Block(" ".join(letter + number for letter, number in pairs))
    except AssertionError as cause:
        raise BlockError(_conflict_problem(pairs), "Write one block for each.") from cause
    except Exception as cause:  # pygcode raises exceptions of many kinds
        raise BlockError(f"not a valid block: {cause}", None) from cause
    words = [(word.letter, float(word.value)) for word in block.words]
    # pygcode must find the words of the grammar above
    for block_word, (letter, number) in zip(words, pairs, strict=False):
        if block_word != (letter, float(number)):
            raise BlockError(f"{letter}{number} is not valid", "G has one decimal at most; M, N, T are whole numbers.")
    if words and words[0][0] == "N":
        del words[0]
    for letter, value in words:
        if letter == "N":
            raise BlockError("N is not the first word of its block", None)
        if not abs(value) < WORD_LIMIT:  # also NaN
            raise BlockError(f"{letter}{value:g} is out of range: the largest number is {WORD_LIMIT:g}", None)
    return words


def _letters_and_numbers(code: str) -> list[tuple[str, str]]:
    """Return letter and number text of each word of a block, in order; comments before and between words are skipped.

    :param code: upper case, without white space, with a `COMMENT_MARK` for each comment.
    :returns: number texts as pygcode reads them, see `_pygcode_number`.
    :raises BlockError: a character, number or word is invalid, or a letter other than G and M occurs twice.
    """
    pairs: list[tuple[str, str]] = []
    position, stop = 0, len(code.rstrip(COMMENT_MARK))
    while position < stop:
        match = _WORD.match(code, position)
        if match is None:
            raise BlockError(*_fault_of_text(code[position:].lstrip(COMMENT_MARK)))
        letter, number = match[1], _pygcode_number(match[1], match[2])
        # N, T and L are whole numbers: longer ones are not exact as floats
        if letter in "LNT" and len(match[2]) > _MOST_DIGITS:
            raise BlockError(f"{match[0].lstrip(COMMENT_MARK)[:20]}… has too many digits", None)
        if letter in "MT" and "." in number:
            raise BlockError(f"{letter}{match[2]} is not a whole number", _WHOLE_NUMBER_ADVICE[letter])
        if letter == "O":
            raise BlockError("an O word among other words", _O_ADVICE)
        pairs.append((letter, number))
        if len(pairs) > _MOST_WORDS:
            raise BlockError(f"more than {_MOST_WORDS} words in one block", "Check the line ends of the file.")
        position = match.end()
    for letter, count in Counter(letter for letter, _ in pairs).items():
        if count > 1 and letter not in "GM":  # a block may have several codes
            raise BlockError(f"{count} {letter} words in one block", "Write one block for each.")
    return pairs


def _pygcode_number(letter: str, number: str) -> str:
    """Return the text of a number in the form that pygcode reads: no plus sign; in G, M and T no zeros after the point.

    ``+1.50`` of X becomes ``1.50``, ``54.10`` of G ``54.1``.
    """
    number = number.lstrip("+")
    if letter in "GMT" and "." in number:
        number = number.rstrip("0").rstrip(".") or "0"
    return number


def _fault_of_text(text: str) -> tuple[str, str | None]:
    """Return problem and advice (or None) for the rest of a block, which does not begin with a word."""
    character = text[0]
    if character in "()":
        return "a bracket outside of comments", "Close each comment in its line. Do not nest comments."
    if character in "Tt" and text[1:].lstrip().startswith('"'):
        advice = "Give the tool a number in the CAM system (T5), and its length by [tools.5] in the cell."
        return "a tool by its name, not by a number", advice
    if character.isalpha():
        return f"{character} without a number", "Write each letter with its number, like X1.5."
    if character == "?":
        return "a question mark or a character that is not ASCII outside of comments", None
    return f"unexpected character {character!r}", _CHARACTER_ADVICE.get(character)


def _conflict_problem(code_words: Sequence[tuple[str, str]]) -> str:
    """Return the problem of a block whose codes exclude each other; it names the codes.

    :param code_words: letter and number text of each word.
    """
    code_names = [f"{letter}{float(number):g}" for letter, number in code_words if letter in "GM"]
    return f"two codes of one modal group, or a code twice, in one block: {' '.join(code_names)}"
