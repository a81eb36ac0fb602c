"""Statements of a cutter-location file: lines joined, comments removed, plain GOTO statements as numbers in bulk.

A statement is a major word, then ``/`` and values separated by commas. ``$`` at the end of a line continues it on the
next line, ``$$`` begins a comment (ISO 4343:2000, 4.2). White space has no meaning except in text. A plain GOTO has
three or six decimal numbers; most statements of a program are plain and never become Python objects. Words without
effect are listed, and advice for those that are refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np
from msgspec import Struct

from postproc.chunks import ragged_range
from postproc.decimals import Bytes, parsed_numbers, word_bounds
from postproc.dialects.text import line_spans
from postproc.errors import did_you_mean
from postproc.frames import Array
from postproc.program import Document, Ints, distinct

# a matrix in a comment of Creo, "$$-> CSYS / 1.0, 0.0, $", goes on in lines of numbers
_COMMENT = re.compile(rb"\$\$(?:->[^\r\n$]*(?:\$[ \t]*[\r\n]{1,3}[-+0-9.,EeDd \t]*)+|[^\r\n]*)")
_CONTINUATION = re.compile(r"\$?\s+")
_LF, _BLANK, _DOLLAR, _COMMA = (ord(c) for c in "\n $,")
_GOTO = b"GOTO/"
_NUMERIC = np.frombuffer(bytes(c in b"0123456789+-.,\n" for c in range(256)), dtype=np.bool_)
_SPACE = np.frombuffer(bytes(c in b" \t\r\n\x0b\x0c" for c in range(256)), dtype=np.bool_)
_TO_NUMBERS = bytes(_BLANK if c in b",\n" else c for c in range(256))
LIMIT = 1e7
"""Numbers of this magnitude or more are refused as mistakes."""
LENGTH_TOLERANCE = 1e-3
"""Largest difference of the length of a direction from 1: files have three decimals or more."""
NEAR_MM = 1e-6
"""Points closer than this [mm] coincide: a nanometre, far below the digits of files."""


class StatementError(Exception):
    """A statement cannot be executed.

    :ivar problem: description of the error.
    :ivar advice: what the user can do; None without advice.
    :ivar row: row of the statement; None: the statement that is being executed.
    """

    def __init__(self, problem: str, advice: str | None, row: int | None = None) -> None:
        """Keep problem, advice and row."""
        super().__init__(problem, advice, row)
        self.problem, self.advice, self.row = problem, advice, row


def numbers_of(words: list[float | str], *counts: int) -> Array:
    """Return the values of a statement as numbers (n,).

    :param counts: valid numbers of values.
    :raises StatementError: a value is a word, or the number of values is not valid.
    """
    if any(isinstance(value, str) for value in words) or len(words) not in counts:
        count_text = " or ".join(map(str, counts))
        raise StatementError(f"{count_text} numbers are needed here", "Check the values behind /.")
    return np.array(words, dtype=float)


class Statements(Struct, frozen=True, eq=False):
    """S statements of a file, in order.

    :param document: the file.
    :param code: statements in upper case without white space and comments; each ends with a line feed.
    :param ends: (S + 1,) offsets in `code`: statement i is ``code[ends[i]:ends[i + 1] - 1]``.
    :param line: (S,) 1-based lines on which the statements begin.
    :param other_rows: (n,) rows of statements that are neither empty nor plain GOTO.
    :param goto_rows: (P,) rows of plain GOTO statements.
    :param numbers: (P, 6) numbers of these; the last three are NaN for a GOTO with three numbers.
    :param comments: 1-based line and text of each comment.
    :param spans: offsets of the beginnings and ends of the lines of the file.
    """

    document: Document
    code: bytes
    ends: Ints
    line: Ints
    other_rows: Ints
    goto_rows: Ints
    numbers: Array
    comments: tuple[tuple[int, str], ...]
    spans: tuple[Ints, Ints]

    def __len__(self) -> int:
        """Return the number of statements."""
        return len(self.line)

    def of(self, row: int) -> str:
        """Return the statement `row` without white space and comments, in upper case."""
        return self.code[self.ends[row] : self.ends[row + 1] - 1].decode("ascii")

    def text(self, row: int) -> str:
        """Return the first line of the statement `row` as it is in the file."""
        line = int(self.line[row]) - 1
        return self.document.text[self.spans[0][line] : self.spans[1][line]]


def split(document: Document) -> Statements:
    """Return the statements of a file."""
    raw = document.text.encode("ascii", "replace")
    starts, stops = line_spans(document.text)
    chars = np.frombuffer(raw + b"\n", dtype=np.uint8).copy()
    comment_spans = [match.span() for match in _COMMENT.finditer(raw)]
    for begin, end in comment_spans:
        chars[begin:end] = _BLANK
    keep = ~_SPACE[chars]
    keep[stops] = True  # one line feed replaces each line end
    chars[stops] = _LF
    code, line = _join_lines(np.frombuffer(chars[keep].tobytes().upper(), dtype=np.uint8))
    code_chars = np.frombuffer(code, dtype=np.uint8)
    ends = np.concatenate([[0], np.flatnonzero(code_chars == _LF) + 1])
    points, numbers = _plain_gotos(code_chars, ends)
    is_plain_or_empty = np.diff(ends) == 1  # an empty statement is a line feed
    is_plain_or_empty[points] = True
    return Statements(
        document=document,
        code=code,
        ends=ends,
        line=line,
        other_rows=np.flatnonzero(~is_plain_or_empty),
        goto_rows=points,
        numbers=numbers,
        comments=tuple(_comments(document.text, starts, comment_spans)),
        spans=(starts, stops),
    )


def _comments(text: str, starts: Ints, comment_spans: Sequence[tuple[int, int]]) -> Iterator[tuple[int, str]]:
    """Yield the 1-based line and the text behind ``$$`` of each comment.

    :param starts: (L,) offsets of the lines of the file.
    :param comment_spans: spans of the comments.
    """
    begins = np.array([begin for begin, _ in comment_spans], dtype=np.int64)
    lines = np.searchsorted(starts, begins, side="right").tolist()  # number of lines that begin at or before each
    for line, (begin, end) in zip(lines, comment_spans, strict=True):
        yield line, _comment(text[begin + len("$$") : end])


def _comment(text: str) -> str:
    """Return a comment as one line; ``$`` and line ends of a continued comment become blanks."""
    return _CONTINUATION.sub(" ", text).strip() if "\n" in text or "\r" in text else text.strip()


def _join_lines(chars: Bytes) -> tuple[bytes, Ints]:
    """Return the text with lines joined where they end with ``$``, and the 1-based first line of each statement.

    :param chars: bytes of the lines, each with a line feed at its end.
    """
    ends = np.flatnonzero(chars == _LF)
    is_continued = chars[ends - 1] == _DOLLAR
    is_continued[:1] &= ends[:1] > 0  # ends - 1 is −1, the last character, if the first line is empty
    is_continued[-1:] = False  # no line follows the last one
    if not is_continued.any():
        return chars.tobytes(), np.arange(1, len(ends) + 1)
    keep = np.ones(len(chars), dtype=np.bool_)
    keep[ends[is_continued]] = False
    keep[ends[is_continued] - 1] = False
    # a statement begins on a line if the line before it is not continued
    return chars[keep].tobytes(), np.flatnonzero(np.append(True, ~is_continued[:-1])) + 1


def _values_of_words(text: Bytes, first: Ints, last: Ints) -> Array | None:
    """Return the numbers (T,) in a text of numbers and blanks; None if a word is no number.

    :param first: (T,) offsets at which the words begin; `last` (T,) at which they end, see `word_bounds`.
    """
    values = parsed_numbers(text, first, last)
    if values is None:
        try:
            return np.array([float(word) for word in text.tobytes().split()])
        except ValueError:
            return None
    return values


def _plain_gotos(chars: Bytes, ends: Ints) -> tuple[Ints, Array]:
    """Return the rows of the plain GOTO statements (P,) and their numbers (P, 6), see `Statements`.

    A GOTO is plain if only digits, signs, points and commas follow its slash and they are three or six decimal numbers.

    :param chars: bytes of all statements.
    :param ends: (S + 1,) offsets, see `Statements`.
    """
    rows, count = _goto_candidates(chars, ends)
    for _ in range(2):  # a second time without the statements that are not plain
        text = _numbers_text(chars, ends, rows)
        first, last = word_bounds(text)
        length = np.diff(ends)[rows] - len(_GOTO)
        # offset in `text` at which the numbers of each statement begin, and its end
        begin = np.concatenate([[0], np.cumsum(length)])
        word_count = np.diff(np.searchsorted(first, begin))  # numbers that begin within each statement
        is_complete = word_count == count
        if is_complete.all():
            break
        rows, count = rows[is_complete], count[is_complete]  # others lack a number between two commas
    if not len(rows) or (values := _values_of_words(text, first, last)) is None:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 6))
    numbers = np.full((len(rows), 6), np.nan)
    row = np.repeat(np.arange(len(rows)), count)
    numbers[row, ragged_range(count)] = values
    large_rows = distinct(row[np.abs(values) >= LIMIT])  # not plain: they are refused when executed
    return np.delete(rows, large_rows), np.delete(numbers, large_rows, axis=0)


def _goto_candidates(chars: Bytes, ends: Ints) -> tuple[Ints, Ints]:
    """Return the GOTO statements that may be plain: rows (n,), and the numbers of values (n,), 3 or 6.

    They have only digits, signs, points and two or five commas behind the slash.

    :param chars: bytes of all statements.
    :param ends: (S + 1,) offsets, see `Statements`.
    """
    rows = np.flatnonzero(np.diff(ends) > len(_GOTO) + 1)
    for column, letter in enumerate(_GOTO):
        rows = rows[chars[ends[rows] + column] == letter]
    if not len(rows):
        return rows, rows
    other_character_count = _counts(~_NUMERIC[chars], ends, rows)
    rows = rows[other_character_count == len(_GOTO)]  # only the word and the slash
    count = _counts(chars == _COMMA, ends, rows) + 1
    has_point = (count == 3) | (count == 6)
    return rows[has_point], count[has_point]


def _numbers_text(chars: Bytes, ends: Ints, rows: Ints) -> Bytes:
    """Return the text behind the slash of GOTO statements, one after the other, with blanks for commas and line feeds.

    :param chars: bytes of all statements.
    :param ends: (S + 1,) offsets, see `Statements`.
    :param rows: (n,) the GOTO statements.
    """
    # 1 where the numbers of a statement begin and −1 behind their line feed: the running sum is 1 between them
    boundary = np.zeros(len(chars) + 1, dtype=np.int8)
    boundary[ends[rows] + len(_GOTO)] = 1
    boundary[ends[rows + 1]] -= 1
    is_in_numbers = np.cumsum(boundary[:-1], dtype=np.int8).view(np.bool_)
    return np.frombuffer(chars[is_in_numbers].tobytes().translate(_TO_NUMBERS), dtype=np.uint8)


def _counts(is_counted: np.typing.NDArray[np.bool_], ends: Ints, rows: Ints) -> Ints:
    """Return the number (n,) of counted characters in each statement of `rows`.

    :param is_counted: (C,) True for characters, of all statements, that are counted.
    :param ends: (S + 1,) offsets, see `Statements`.
    :param rows: (n,) the statements.
    """
    # number of counted characters before each character
    preceding_count = np.cumsum(np.append(0, is_counted), dtype=np.int64)
    return np.asarray(preceding_count[ends[rows + 1]] - preceding_count[ends[rows]])


_NUMBER = re.compile(r"[-+]?(?:\d{1,30}\.?\d{0,30}|\.\d{1,30})(?:[ED][-+]?\d{1,3})?")


def number(word: str) -> float | None:
    """Return the value of a word that is a number; None for other words, and for numbers of `LIMIT` or more.

    The exponent may be D, as in Fortran.
    """
    if not _NUMBER.fullmatch(word):
        return None
    value = float(word.replace("D", "E"))
    return value if abs(value) < LIMIT else None


def values(words: str) -> list[float | str]:
    """Return the values behind the slash of a statement: numbers, and all else as words.

    >>> values("250.,MMPM")
    [250.0, 'MMPM']
    """
    items: list[float | str] = []
    for word in words.split(",") if words else []:
        value = number(word)
        items.append(word if value is None else value)
    return items


TEXT = ("PARTNO", "PPRINT", "REMARK", "TITLES", "TPRINT", "NOTE")
"""Words followed by text up to the end of the statement."""

WITHOUT_EFFECT = frozenset(
    (
        "TLDATA",
        "PAINT",
        "END-OF-PATH",
        "INTOL",
        "OUTTOL",
        "TOLER",
        "TOLTBL",
        "LINTOL",
        "MCHTOL",
        "MACHIN",
        "SEQNO",
        "ISN",
        "CLPRNT",
        "TMARK",
        "LEADER",
        "DISPLY",
        "PLOT",
        "PPLOT",
        "SELECT",
        "SELCTL",
        "TOOLNO",
        "OFSTNO",
        "CATMAT",
        "AUTOPS",
        "PSIS",
        "CLEARP",
        "CLRSRF",
        "OPNAME",
        "LETTER",
        "PLABEL",
        "VERIFY",
        "HEADER",
        "PROGRM",
        "SELECTL",
        "OP_NAME",
        "MILL",
        "CSI_PROGRAM_COMMENT",
        "CSI_TOOL_PATH",
        "CSI_PATH_TOLERANCE",
    )
)
"""Words that move nothing on a robot. Source: Vericut, "Supported APT-CLS NC Program Records"; CATIA V5, "Syntax of
Generated APT Instructions"; Autodesk's posts "Generative Machining APT" and "CAMplete APT"."""

COORDINATES_ADVICE = "Let the CAM system write all coordinates in one machining axis system."
_EXPAND = "Let the CAM system write the motion as GOTO statements."
REFUSED = {
    "ORIGIN": COORDINATES_ADVICE,
    "TRANS": COORDINATES_ADVICE,
    "TRACUT": COORDINATES_ADVICE,
    "ROTATE": COORDINATES_ADVICE,
    "ROTABL": COORDINATES_ADVICE,
    "ROTHED": COORDINATES_ADVICE,
    "INDEX": "Let the CAM system write the calls out.",
    "COPY": "Let the CAM system write the copies out.",
    "CALSUB": "Let the CAM system write the calls out.",
    "DEFSUB": "Let the CAM system write the calls out.",
    "ENDSUB": "Let the CAM system write the calls out.",
    "CALL": "Let the CAM system write the calls out.",
    "NURBS": _EXPAND,
    "SPLINE": _EXPAND,
    "GODLTA": "Write GODLTA/dx,dy,dz.",
    "THREAD": _EXPAND,
    "ARC": "Write CIRCLE, or GOTO statements.",
    "DNTCUT": "Remove DNTCUT, CUT and the statements between them if the tool must not move there.",
    "PREFUN": "It is a G code of one control. Remove it if it does not move the tool.",
    "TURRET": "Only milling programs are supported.",
    "SET": "Let the CAM system write absolute coordinates.",
}
"""Words that change motion in ways that are not supported: what to do."""

KNOWN = (
    *("GOTO", "GODLTA", "FROM", "GOHOME", "RETRCT", "RAPID", "FEDRAT", "UNITS", "MULTAX", "TLAXIS", "CIRCLE", "MOVARC"),
    *("INDIRV", "TLON", "CYCLE", "SPINDL", "COOLNT", "LOADTL", "LOAD", "DELAY", "STOP", "OPSTOP", "OPSKIP", "AUXFUN"),
    *("INSERT", "CUTCOM", "MODE", "MSYS", "MCS", "ZERO", "CSYS", "TRNTYP", "END", "REWIND", "FINI", *TEXT),
)


def refusal(word: str) -> tuple[str, str]:
    """Return problem and advice for a major word that is not read."""
    if word in REFUSED:
        return f"{word} is not supported", REFUSED[word]
    suggestion = did_you_mean(word, KNOWN)
    name = word[:20]
    advice = f'If it moves nothing, write [apt] without_effect = ["{name}"] in the cell: it holds for all such lines.'
    return f"unknown statement {name!r}", f"{suggestion} {advice}" if suggestion else advice
