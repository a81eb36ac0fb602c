"""Structure of a file by O-words, M98 and M99, and its lines with expressions.

Labels of IF, WHILE, DO and REPEAT are local to their subprogram; the label of RETURN has no meaning. A number alone
(``O100``) begins a subprogram in Fanuc style, which M98 calls and M99 ends. ``O100 SUB`` … ``O100 ENDSUB`` is LinuxCNC
style.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.dialects.gcode.expressions import (
    ARGUMENTS,
    Key,
    Parameters,
    Reader,
    Value,
    nearest_integer,
    parameter_key,
)
from postproc.dialects.gcode.words import COMMENT_MARK, BlockError, Fault, Source
from postproc.program import Document, Ints, distinct

_CALLS = re.compile(rb"M0*9[89](?![\d.])")
_O_WORD = re.compile(rb"\n[\x01/]*(?:N\d+)?[\x01/]*O(?!\d+\x01*\n)")
_NOTABLE = re.compile(rb"[#\[O%]|M0*(?:2|30|98|99)(?![\d.])")
_O_WORD_START = re.compile(r"(?:/[1-9]?)?(?:N\d+)?O(?=[\d#\[<])")
_LABEL = re.compile(r"<([^<>#]+)>|(\d+)")
_KEYWORD = re.compile("SUB|ENDSUB|CALL|DO|WHILE|REPEAT|IF|ELSEIF|ELSE|ENDIF|BREAK|CONTINUE|ENDWHILE|ENDREPEAT|RETURN|$")
_LITERAL = re.compile(
    r"[^#\[A-Z]+|[A-Z][+-]?(?:\d+\.?\d*|\.\d+)"
    r"|[A-Z](?![#\[+-]|(?:ABS|ACOS|ASIN|ATAN|COS|EXISTS|EXP|FIX|FUP|LN|ROUND|SIN|SQRT|TAN)\[)"
)
_END_WORD = re.compile(r"M0*(2|30|98|99)(?![\d.])")
_EMPTY_LINE = re.compile(r"[\x01/%]*(?:N\d+)?\x01*(?:M0*(?:2|30))?\x01*")
_O_NUMBER = re.compile(r"[Oo]?(\d+)")
_KEYWORDS_WITH_CONDITION = ("IF", "ELSEIF", "WHILE", "REPEAT")
_OPENING_KEYWORDS = {
    "ENDSUB": ("SUB",),
    "ELSEIF": ("IF",),
    "ELSE": ("IF",),
    "ENDIF": ("IF",),
    "ENDWHILE": ("WHILE",),
    "ENDREPEAT": ("REPEAT",),
    "RETURN": ("SUB",),
    "BREAK": ("WHILE", "DO"),
    "CONTINUE": ("WHILE", "DO"),
}


def needs_execution(source: Source) -> bool:
    """Return whether a program must be executed to know its lines: it has expressions, branches, loops or calls."""
    code = source.code
    if b"#" in code or b"[" in code or _CALLS.search(code) is not None:
        return True
    return b"O" in code and _O_WORD.search(code) is not None


class Block(Struct, frozen=True):
    """A line whose words are computed when it is executed.

    :param settings: key and value of each parameter that the line sets, after all its values have been evaluated.
    :param words: the words in order: plain text, or a letter with the expression of its value.
    """

    settings: tuple[tuple[Callable[[Parameters], Key], Value], ...]
    words: tuple[str | tuple[str, Value], ...]

    def executed_text(self, parameters: Parameters) -> str:
        """Set the parameters of the line in `parameters`, and return its words with numbers in place of expressions.

        :raises BlockError: a value is not known or not valid.
        """
        text = "".join(
            [word if isinstance(word, str) else _word_text(word[0], word[1](parameters)) for word in self.words]
        )
        if self.settings:  # all values are computed before the first parameter is set
            for key, value in [(key(parameters), value(parameters)) for key, value in self.settings]:
                parameters.put(key, value)
        return text


class OWord(Struct, frozen=True):
    """A line with an O-word, such as ``O100 WHILE [#1 LT 5]``: a label, a keyword and perhaps values.

    :param keyword: ``SUB``, ``CALL`` …; empty for a number alone, which begins a subprogram in Fanuc style.
    :param label: name or number of the subprogram, branch or loop; for a call possibly an expression.
    :param values: the values in brackets. IF, ELSEIF, WHILE: the condition; REPEAT: the number of rounds; CALL: the
        arguments; ENDSUB and RETURN: the value that the subprogram returns, if it has one.
    """

    keyword: str
    label: str | Value
    values: tuple[Value, ...] = ()


class _OpenStructure(NamedTuple):
    """A subprogram, branch or loop whose end has not been read: its first keyword, its label, rows of its O-words."""

    keyword: str
    label: str
    rows: list[int]

    def end_fault(self) -> Fault:
        """Return the fault of a structure that has no end."""
        return Fault(self.rows[0], f"O{self.label} {self.keyword} without its end")


class ProgramFile(Struct, eq=False):
    """A file with the structure of its subprograms, loops and branches.

    :ivar lines: row → its parsed line, filled by `parsed_line`.
    :ivar next_notable_row: (L + 1,) for each row, the first row from it on with an O-word, a parameter, an expression,
        a % or an M code that affects the execution order; L: there is none.
    :ivar subs: label of each subprogram in LinuxCNC style → its row; `numbered_subs`: the same in Fanuc style.
    :ivar structure_rows: row of an O-word → rows of the O-words of its structure, first to last.
    :ivar faults: faults of its O-words.
    """

    document: Document
    source: Source
    lines: dict[int, OWord | Block | None] = {}
    next_notable_row: list[int] = []
    subs: dict[str, int] = {}
    numbered_subs: dict[str, int] = {}
    structure_rows: dict[int, tuple[int, ...]] = {}
    faults: list[Fault] = []

    @classmethod
    def from_source(cls, document: Document, source: Source) -> ProgramFile:
        """Return a file with its structure.

        Rows are notable if they need more than copying: they have an O-word, a parameter, an expression, a % or an M
        code that affects the execution order.
        """
        file = cls(document, source)
        positions = np.array([match.start() for match in _NOTABLE.finditer(source.code)], dtype=np.int64)
        notable = distinct(np.searchsorted(source.ends, positions) - 1)  # line i begins after line feed i
        # for each row the next notable one, from itself on; the number of rows if there is none
        notable_and_end = np.append(notable, len(source))
        file.next_notable_row = notable_and_end[np.searchsorted(notable, np.arange(len(source) + 1))].tolist()
        file._link_structures(notable)
        return file

    def parsed_line(self, row: int) -> OWord | Block | None:
        """Return the parsed line of a row of `next_notable_row`; None for %. Each line is parsed once.

        :raises BlockError: the line cannot be read.
        """
        if row not in self.lines:
            self.lines[row] = _read_line(self.source.line(row).replace(COMMENT_MARK, ""))
        return self.lines[row]

    def defined_subprogram(self) -> str | None:
        """Return the name of the first subprogram of a file that only defines subprograms; None for a main program.

        In LinuxCNC style all lines are within SUB … ENDSUB. In Fanuc style the file ends with M99, and its
        name is a number.
        """
        is_in_subprogram = np.zeros(len(self.source), dtype=np.bool_)
        for first in self.subs.values():
            last = self.structure_rows.get(first, (first,))[-1]  # row of ENDSUB
            is_in_subprogram[first : last + 1] = True
        main_rows = np.flatnonzero(~is_in_subprogram).tolist()
        if self.subs and all(_EMPTY_LINE.fullmatch(self.source.line(row)) for row in main_rows):
            return f"O<{next(iter(self.subs))}>"
        number = _O_NUMBER.fullmatch(self.document.name.partition(".")[0])
        if number:
            ends = {
                end
                for row in main_rows
                if self.next_notable_row[row] == row  # others have no M code that ends a program
                for end in end_words(self.source.line(row))
            }
            return f"O{int(number[1])}" if "99" in ends and not ends & {"2", "30"} else None
        return None

    def _link_structures(self, notable: Ints) -> None:
        """Fill `structure_rows`, `subs`, `numbered_subs` and `faults` from the O-words of the file.

        :param notable: (n,) rows that may have O-words, ascending.
        """
        open_structures: list[_OpenStructure] = []
        for row, o_word in self._rows_with_o_words(notable):
            label, keyword = str(o_word.label), o_word.keyword
            if keyword == "":
                self.numbered_subs.setdefault(label, row)
            elif keyword == "SUB":
                self._add_subprogram(row, label, open_structures)
            indices = [  # open structures of the same label
                n
                for n, structure in enumerate(open_structures)
                if structure.label == label and structure.keyword != "SUB"
            ]
            # WHILE ends a DO of the same label, and begins a loop otherwise
            if keyword == "WHILE" and indices and open_structures[indices[-1]].keyword == "DO":
                self._close(row, open_structures, indices[-1])
            elif keyword in ("SUB", "IF", "WHILE", "DO", "REPEAT"):
                open_structures.append(_OpenStructure(keyword, label, [row]))
            elif keyword in _OPENING_KEYWORDS:
                self._add_to_structure(row, keyword, label, open_structures)
        for structure in open_structures:
            self.faults.append(structure.end_fault())
        # BREAK and CONTINUE, linked to their opening row alone so far, get the rows of the structure that is closed now
        for row, opening in [(row, link[0]) for row, link in self.structure_rows.items() if len(link) == 1]:
            self.structure_rows[row] = self.structure_rows.get(opening, (row, row))

    def _add_subprogram(self, row: int, label: str, open_structures: Sequence[_OpenStructure]) -> None:
        """Add a subprogram that begins at a row.

        Add a fault if another subprogram has its name, or if it begins within another subprogram.
        """
        if label in self.subs or any(structure.keyword == "SUB" for structure in open_structures):
            problem = "a second subprogram of this name" if label in self.subs else "a subprogram in another"
            self.faults.append(Fault(row, f"O{label} SUB: {problem}"))
        self.subs.setdefault(label, row)

    def _add_to_structure(self, row: int, keyword: str, label: str, open_structures: list[_OpenStructure]) -> None:
        """Add an O-word to the innermost open structure that it belongs to; add a fault if there is none.

        ELSEIF and ELSE continue a structure, words that begin with END close it, and RETURN changes nothing. BREAK and
        CONTINUE are linked to the first row of the structure alone until it is closed.
        """
        opening_keywords = _OPENING_KEYWORDS[keyword]
        indices = [
            n
            for n, structure in enumerate(open_structures)
            if structure.keyword in opening_keywords and (structure.label == label or keyword == "RETURN")
        ]
        if not indices:
            problem = f"O{label} {keyword} without O{label} {' or '.join(opening_keywords)} before it"
            self.faults.append(Fault(row, problem))
        elif keyword in ("ELSEIF", "ELSE"):
            open_structures[indices[-1]].rows.append(row)
        elif keyword.startswith("END"):
            self._close(row, open_structures, indices[-1])
        elif keyword != "RETURN":  # BREAK or CONTINUE
            self.structure_rows[row] = (open_structures[indices[-1]].rows[0],)

    def _close(self, row: int, open_structures: list[_OpenStructure], index: int) -> None:
        """Link the rows of an open structure, which ends at a row, and remove it from `open_structures`.

        Structures that were opened inside it have no end: they are faults, and removed too.

        :param index: index of the structure in `open_structures`.
        """
        for structure in open_structures[index + 1 :]:
            self.faults.append(structure.end_fault())
        link = (*open_structures[index].rows, row)
        self.structure_rows.update(dict.fromkeys(link, link))
        del open_structures[index:]

    def _rows_with_o_words(self, notable: Ints) -> Iterator[tuple[int, OWord]]:
        """Yield row and O-word of notable rows (n,) that have an O-word; unreadable lines are left out."""
        for row in notable.tolist():
            if "O" in self.source.line(row):
                try:
                    o_word = self.parsed_line(row)
                except BlockError:
                    continue  # reported when the line is executed
                if isinstance(o_word, OWord):
                    yield row, o_word


def _read_line(code: str) -> OWord | Block | None:
    """Return a line as an O-word if it begins with one, else as a block; None if it begins with %.

    :param code: packed code of the line, without comments, see `Source`.
    :raises BlockError: the line cannot be read.
    """
    if code.startswith("%"):
        return None
    o_word_start = _O_WORD_START.match(code)
    return _read_block(code) if o_word_start is None else _read_o_word(code, o_word_start.end())


def _read_o_word(code: str, position: int) -> OWord:
    """Return the O-word of a line, whose label begins at character `position`.

    :raises BlockError: its name, keyword or values are invalid.
    """
    reader = Reader(code, position)
    name = _LABEL.match(code, position)
    label: str | Value  # an expression if the name is computed
    if name is not None:
        reader.position = name.end()
        # a name in < >, or a number, in which leading zeros do not count
        label = parameter_key(name[1]) if name[1] else name[2].lstrip("0") or "0"
    else:
        label = reader.read_value()
    keyword = _KEYWORD.match(code, reader.position)
    if keyword is None:
        raise BlockError("an O word among other words", "Write an O number in a line of its own.")
    reader.position = keyword.end()
    if not isinstance(label, str) and keyword[0] != "CALL":
        raise BlockError(f"O with a computed name before {keyword[0] or 'the end of the line'}", "Only CALL takes one.")
    values: list[Value] = []
    while reader.position < len(code):
        values.append(reader.read_expression())
    # least and largest number of values of each keyword
    min_count, max_count = {"CALL": (0, ARGUMENTS), "RETURN": (0, 1), "ENDSUB": (0, 1)}.get(keyword[0], (0, 0))
    if keyword[0] in _KEYWORDS_WITH_CONDITION:
        min_count = max_count = 1
    if not min_count <= len(values) <= max_count:
        problem = "too many values" if len(values) > max_count else "a value in [ ] is missing"
        raise BlockError(f"{keyword[0] or 'O number'}: {problem}", None)
    return OWord(keyword[0], label, tuple(values))


def _read_block(code: str) -> Block:
    """Return a line as assignments of parameters, and words with their values.

    :raises BlockError: it is invalid.
    """
    settings: list[tuple[Callable[[Parameters], Key], Value]] = []
    words: list[str | tuple[str, Value]] = []
    reader = Reader(code)
    while reader.position < len(code):
        if code[reader.position] == "#":
            key = reader.read_parameter()
            if not code.startswith("=", reader.position):
                raise BlockError("a parameter without a word before it", "Write #1=… to set it, X#1 to use it.")
            reader.position += 1
            settings.append((key, reader.read_value()))
            continue
        literal = _LITERAL.match(code, reader.position)
        if literal is not None:
            words.append(literal[0])
            reader.position = literal.end()
        elif code[reader.position] == "[":
            raise BlockError("an expression without a word before it", "Write comments in ( ), or after a semicolon.")
        else:
            letter = code[reader.position]
            reader.position += 1
            words.append((letter, reader.read_value()))
    return Block(tuple(settings), tuple(words))


def _word_text(letter: str, value: float) -> str:
    """Return the text of a word with a computed number.

    M, N, T, L, H and O must be whole, G a whole number of tenths, as rs274 requires. D may be a diameter.

    :param value: the number that the expression after the letter has given.
    :raises BlockError: such a number is not whole.
    """
    if letter in "MNTLHO":
        return f"{letter}{nearest_integer(value)}"
    if letter == "G":
        return f"G{nearest_integer(10.0 * value) / 10.0:g}"
    return letter + _number_text(value)


def _number_text(value: float) -> str:
    """Return a number as G-code text, with more digits than any control resolves."""
    text = f"{value:.8f}" if abs(value) >= 1.0 else f"{value:.12f}"
    return text.rstrip("0").rstrip(".") or "0"


def end_words(text: str) -> Mapping[str, str]:
    """Return the M2, M30, M98 and M99 in a line of plain words: number → the text of the word."""
    return {match[1]: match[0] for match in _END_WORD.finditer(text)}
