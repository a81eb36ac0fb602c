"""One block that is more than a plain motion, read by pygcode.

pygcode decides which words a block holds and which codes exclude each other. It skips characters that it does not
know and stops at signs that it does not expect, so a block is first split by a grammar of our own, and what pygcode
reads must be the same words.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from msgspec import Struct

from postproc.dialects.gcode.words import LIMIT, MARK

_WORD = re.compile(rf"{MARK}*([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))")
_PROGRAM_NUMBER = re.compile(rf"{MARK}*(?:N\d+{MARK}*)?[O:]\d+{MARK}*")


_MOST_WORDS = 100
"""A block of more words than all letters and modal groups could make is no block."""
_CHARACTERS = {
    "/": "Write / first in its block.",
    "@": "Polar coordinates are not read: let the CAM system write X and Y.",
    "^": "Polar coordinates are not read: let the CAM system write X and Y.",
    "$": "Only one spindle is read: leave $ and its number out.",
}
_O_ADVICE = "An O number stands alone in its line."


class Fault(Struct, frozen=True):
    """Why a line cannot be read: its row, what is wrong there, what to do.

    `lost` is the block, where it is not known what it changes: positions, modes and feed may be others from there on.
    """

    row: int
    problem: str
    advice: str | None = None
    lost: str = ""


class BlockError(Exception):
    """A block cannot be read. Its arguments are the problem and the advice (or None)."""


def words_of(code: str) -> list[tuple[str, float]]:
    """Return the words of a packed block, (letter, value) in order, without its N word or program number.

    :param code: see `postproc.dialects.gcode.words.Source.line`.
    :raises BlockError: something is not a word, a word is double or out of range, or two codes exclude each other.
    """
    from pygcode.block import Block

    if _PROGRAM_NUMBER.fullmatch(code):
        return []
    own = _split(code)
    try:
        block = Block(" ".join(letter + number for letter, number in own))
    except AssertionError as cause:
        raise BlockError(_conflict(own), "Write one block for each.") from cause
    except Exception as cause:  # pygcode has many kinds, and not all of them on purpose
        raise BlockError(f"not a valid block: {cause}", None) from cause
    words = [(word.letter, float(word.value)) for word in block.words]
    for found, (letter, number) in zip(words, own, strict=False):
        if found != (letter, float(number)):
            raise BlockError(f"{letter}{number} is not valid", "G has one decimal at most; M, N, T are whole numbers.")
    if words and words[0][0] == "N":
        del words[0]
    for letter, value in words:
        if letter == "N":
            raise BlockError("N must stand first in its block", None)
        if not abs(value) < LIMIT:
            raise BlockError(f"{letter}{value:g} is out of any plausible range", None)
    return words


def _split(code: str) -> list[tuple[str, str]]:
    own: list[tuple[str, str]] = []
    position, stop = 0, len(code.rstrip(MARK))
    while position < stop:
        match = _WORD.match(code, position)
        if match is None:
            raise BlockError(*_not_a_word(code[position:].lstrip(MARK)))
        if match[1] in "LNT" and len(match[2]) > 15:
            raise BlockError(f"{match[0].lstrip(MARK)[:20]}… is out of any plausible range", None)
        if match[1] == "O":
            raise BlockError("an O word amid other words", _O_ADVICE)
        own.append((match[1], _plain(match[1], match[2])))
        if len(own) > _MOST_WORDS:
            raise BlockError(f"more than {_MOST_WORDS} words in one block", "Check the line ends of the file.")
        position = match.end()
    for letter, count in Counter(letter for letter, _ in own).items():
        if count > 1 and letter not in "GM":
            raise BlockError(f"{count} {letter} words in one block", "Write one block for each.")
    return own


def _plain(letter: str, number: str) -> str:
    """Write a number as pygcode takes it: no plus sign, no empty decimals in codes."""
    number = number.lstrip("+")
    if letter in "GMT" and "." in number:
        number = number.rstrip("0").rstrip(".") or "0"
    return number


def _not_a_word(rest: str) -> tuple[str, str | None]:
    character, following = rest[0], rest[1:2]
    if character in "()":
        return "a bracket that belongs to no comment", "Close comments in their line; do not nest them."
    if character.isalpha():
        return f"{character} without a number", "Write words like X1.5." if following == "=" else None
    if character == "?":
        return "a question mark, or a character that is not ASCII, outside comments", None
    return f"unexpected character {character!r}", _CHARACTERS.get(character)


def _conflict(own: Sequence[tuple[str, str]]) -> str:
    found = [f"{letter}{float(number):g}" for letter, number in own if letter in "GM"]
    return f"two codes of one modal group, or a code twice, in one block: {' '.join(found)}"
