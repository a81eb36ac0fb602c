"""Words of KRL in a piece of code: names, key words, comments of the editor. Statements are read by `parser`."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator

from msgspec import Struct

from postproc.program import FORCE_COMMENT

NAME = re.compile(r"[A-Za-z_$][\w$]*", re.ASCII)
BLANKS = " \t"
_WORD = re.compile(r"\"[^\"]*\"?|(?<![\w$#.])[A-Za-z_$][\w$]*", re.ASCII)
_OPERATOR = re.compile(r"==|<>|<=|>=|<|>|(?:B_)?(?:AND|OR|EXOR)\b", re.IGNORECASE)
_NOT_WORD = re.compile(r"NOT\b", re.IGNORECASE)
_OCCURRENCE = re.compile(
    r"\"[^\"]*\"|'[BbHh][ \t]*[0-9A-Fa-f]+'|[.#][ \t]*[A-Za-z_]\w*|\d[\w.]*|[A-Za-z_$][\w$]*|[\[\](){},]", re.ASCII
)
NUMBER_PATTERN = r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
NUMBER = re.compile(NUMBER_PATTERN)
INDEX = re.compile(r"[0-9]{1,9}", re.ASCII)
COMPONENT = re.compile(
    rf"[ \t]*(?P<name>[A-Za-z_]\w*)[ \t]*(?:(?<=[ \t])|(?=[-+]))(?P<number>{NUMBER_PATTERN})[ \t]*"
    r"(?:(?P<comma>,)|(?=\}))",
    re.ASCII,
)
"""A component of an aggregate whose value is a number, with the comma that follows."""
ITEM_NAME = re.compile(r"[ \t]*(?P<name>[A-Za-z_]\w*)[ \t]*(?:\[[ \t]*\])?[ \t]*", re.ASCII)
TAG = re.compile(r"[ \t]*(?P<tag>[A-Za-z_]\w*)[ \t]*:", re.ASCII)
INTEGER_LITERAL = re.compile(
    r"'(?:(?P<binary_sign>[Bb][ \t]*)(?P<binary>[01]+)|(?P<hexadecimal_sign>[Hh][ \t]*)(?P<hexadecimal>[0-9A-Fa-f]+))'"
)
"""An INT in binary or hexadecimal notation, such as ``'B010'``, ``'B 010'`` or ``'H2F'``."""
STRING = re.compile(r'"[^"]*"')
ENUM = re.compile(r"#[A-Za-z_]\w*", re.ASCII)
FIELD = re.compile(r"[ \t]*\.[ \t]*(?P<name>[A-Za-z_][\w$]*)", re.ASCII)
LOGIC = re.compile(r"[<>=&|]|(?:B_)?(?:AND|OR|EXOR)\b", re.IGNORECASE)
DECLARATION = re.compile(
    r"(?:(?:DECL|GLOBAL|CONST|PUBLIC)[ \t]+)*(?:(?P<kind>[A-Za-z_]\w*)[ \t]+)?(?P<name>[A-Za-z_$][\w$]*)[ \t]*"
    r"(?P<bounds>\[[^\]]*\])?[ \t]*(?P<equals>=?)",
    re.ASCII | re.IGNORECASE,
)
ELEMENT = re.compile(
    r"(?P<name>[A-Za-z_$][\w$]*+)\[[ \t]*+(?P<index>[0-9]{1,9})[ \t]*+\][ \t]*+="
    r"[ \t]*+(?=\{[^{}\"';]*+\}[ \t]*+(?:;|$))",
    re.ASCII,
)
"""An array element of a data list that is initialised by an aggregate without nested ones."""
NEXT_NAME = re.compile(
    r"[ \t]*,[ \t]*(?P<name>[A-Za-z_$][\w$]*)[ \t]*(?P<bounds>\[[^\]]*\])?[ \t]*(?P<equals>=?)", re.ASCII
)
NEXT_INITIAL_VALUE = re.compile(r"[}\d'\"][ \t]*,[ \t]*[A-Za-z_$][\w$]*[ \t]*(?:\[[^\]]*\])?[ \t]*=", re.ASCII)
"""The end of an initial value, and behind it another name with an initial value."""
_COLON = re.compile(r"[ \t]*:")
_OPENING_BRACKET = re.compile(r"[ \t]*\(")
FORCE = re.compile(f";(?:{FORCE_COMMENT.pattern})", re.IGNORECASE)
"""The beginning of a comment about forces."""
_FOLD = re.compile(r"[ \t]*;[ \t]*(?P<end>END)?FOLD\b", re.IGNORECASE)


class Span(Struct, frozen=True):
    """A piece of a text: offsets of its first character and behind its last."""

    start: int
    stop: int

    def text_in(self, text: str) -> str:
        """Return the piece of a text; the offsets are those of `text`."""
        return text[self.start : self.stop]


def word_at(text: str, start: int, stop: int) -> str:
    """Return the word at an offset, upper case; empty if there is none."""
    match = NAME.match(text, start, stop)
    return match[0].upper() if match else ""


def skip_blanks(text: str, start: int, stop: int) -> int:
    """Return the offset of the first character at or behind `start` that is no blank; `stop` if there is none."""
    while start < stop and text[start] in BLANKS:
        start += 1
    return start


def skip_word(text: str, start: int, stop: int, *words: str) -> int:
    """Return the offset behind the word at `start`, blanks skipped; −1 if that word is not in `words` (upper case)."""
    start = skip_blanks(text, start, stop)
    word = word_at(text, start, stop)
    return start + len(word) if word in words else -1


def skip_sign(text: str, start: int, stop: int, sign: str) -> int:
    """Return the offset behind `sign` if it is at `start`, blanks before it skipped; −1 if another character is."""
    start = skip_blanks(text, start, stop)
    return start + 1 if start < stop and text[start] == sign else -1


def words_in(text: str, start: int, stop: int) -> Iterator[tuple[str, Span]]:
    """Yield the words of a piece of code, upper case, and their spans.

    Words in strings, constants of ENUMs (``#X``) and components (``.X``) are not among them.
    """
    for match in _WORD.finditer(text, start, stop):
        if match[0][0] != '"':  # strings match too, so that their words are skipped
            yield match[0].upper(), Span(*match.span())


def key_word(text: str, start: int, stop: int, word: str) -> Span | None:
    """Return the span of the first occurrence of a key word (upper case) outside of strings; None if there is none."""
    return next((span for name, span in words_in(text, start, stop) if name == word), None)


def operator_at(text: str, start: int, stop: int) -> tuple[str, int]:
    """Return the comparison or logical operator at an offset, upper case, and the offset behind it.

    Blanks before it are skipped. Without an operator: an empty text, and the offset behind the blanks.
    """
    start = skip_blanks(text, start, stop)
    match = _OPERATOR.match(text, start, stop)
    return (match[0].upper(), match.end()) if match else ("", start)


def read_negations(text: str, start: int, stop: int) -> tuple[bool, int]:
    """Return whether the words NOT at an offset negate the term behind them, and the offset of that term.

    An odd number of NOT negates the term. Blanks before the term are skipped, also without NOT.

    :param stop: offset at which the text to be read ends.
    """
    is_negated, start = False, skip_blanks(text, start, stop)
    while match := _NOT_WORD.match(text, start, stop):
        is_negated = not is_negated
        start = skip_blanks(text, match.end(), stop)
    return is_negated, start


def number(text: str) -> float:
    """Return the value of a text that is a number; NaN for any other text."""
    return float(text) if NUMBER.fullmatch(text) else float("nan")


def fold_at(text: str, start: int, stop: int) -> str:
    """Return ``FOLD`` or ``ENDFOLD`` if a line is the comment that begins or ends a fold; else an empty text."""
    fold = _FOLD.match(text, start, stop)
    return "" if fold is None else "ENDFOLD" if fold["end"] else "FOLD"


def indent(text: str) -> str:
    """Return the blanks with which a line begins."""
    return text[: len(text) - len(text.lstrip(BLANKS))]


def literal_value(literal: re.Match[str]) -> int:
    """Return the value of a match of `INTEGER_LITERAL`: an INT such as ``'B010'`` or ``'H2F'``."""
    return int(literal["binary"], 2) if literal["binary"] else int(literal["hexadecimal"], 16)


def literal_with_value(literal: re.Match[str], value: int) -> str:
    """Return an INT such as ``'B010'`` or ``'H2F'`` with another value, in the same notation.

    It gets leading zeros, so that it has at least as many digits as before.

    :param literal: match of `INTEGER_LITERAL`.
    """
    if literal["binary"]:
        return f"'{literal['binary_sign']}{value:0{len(literal['binary'])}b}'"
    return f"'{literal['hexadecimal_sign']}{value:0{len(literal['hexadecimal'])}X}'"


class Occurrence(Struct, frozen=True):
    """A name in a text.

    :ivar start: offset of its first character.
    :ivar stop: offset behind its last character.
    :ivar name: upper case.
    :ivar is_called: True if a bracket follows: it is a routine or a function.
    """

    start: int
    stop: int
    name: str
    is_called: bool


def names_in(text: str, start: int = 0, stop: int = sys.maxsize) -> set[str]:
    """Return all names in ``text[start:stop]``, upper case, also words of KRL, components and names in comments."""
    return {name.upper() for name in NAME.findall(text, start, stop)}


def occurrences(text: str, start: int, stop: int) -> Iterator[Occurrence]:
    """Yield the names in ``text[start:stop]``, also words of KRL.

    Components (X of ``{X 1}``, ``.X``) and constants of ENUMs (``#X``) are left out: they are no names of variables.

    >>> [item.name for item in occurrences("LIN {X I, Y P.X}:Q", 0, 18)]
    ['LIN', 'I', 'P', 'Q']
    """
    open_brackets: list[str] = []
    is_component = False  # the next name is a component of an aggregate, or the type of the aggregate
    for match in _OCCURRENCE.finditer(text, start, stop):
        first_character = match[0][0]  # other first characters are those of strings, numbers, components and ENUMs
        if first_character in "([{":
            open_brackets.append(first_character)
            is_component = first_character == "{"
        elif first_character in ")]}":
            del open_brackets[-1:]
            is_component = False
        elif first_character == ",":
            is_component = bool(open_brackets) and open_brackets[-1] == "{"
        elif first_character.isalpha() or first_character in "_$":
            if is_component:
                is_component = _COLON.match(text, match.end(), stop) is not None  # behind the type is a component
                continue
            is_called = _OPENING_BRACKET.match(text, match.end(), stop) is not None
            yield Occurrence(match.start(), match.end(), match[0].upper(), is_called)
