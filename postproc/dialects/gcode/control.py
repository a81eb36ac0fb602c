"""O-words, M98 and M99: what the lines of a file say about the order in which lines are executed.

Labels of IF, WHILE, DO and REPEAT belong to the subprogram that they stand in; that of RETURN says nothing. A number
alone (``O100``) begins a subprogram of Fanuc's kind, which M98 calls and M99 ends; ``O100 SUB`` … ``O100 ENDSUB`` is
LinuxCNC's.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from msgspec import Struct

from postproc.dialects.gcode.blocks import BlockError, Fault
from postproc.dialects.gcode.expressions import Reader, Value, whole
from postproc.dialects.gcode.parameters import ARGUMENTS, Key, Parameters, key_of
from postproc.dialects.gcode.words import MARK, Source
from postproc.program import Document, Ints, distinct

_CALLS = re.compile(rb"M0*9[89](?![\d.])")
_O_WORD = re.compile(rb"\n[\x01/]*(?:N\d+)?[\x01/]*O(?!\d+\x01*\n)")
_NOTABLE = re.compile(rb"[#\[O%]|M0*(?:2|30|98|99)(?![\d.])")
_HEAD = re.compile(r"(?:/[1-9]?)?(?:N\d+)?O(?=[\d#\[<])")
_LABEL = re.compile(r"<([^<>#]+)>|(\d+)")
_KEYWORD = re.compile("SUB|ENDSUB|CALL|DO|WHILE|REPEAT|IF|ELSEIF|ELSE|ENDIF|BREAK|CONTINUE|ENDWHILE|ENDREPEAT|RETURN|$")
_LITERAL = re.compile(
    r"[^#\[A-Z]+|[A-Z][+-]?(?:\d+\.?\d*|\.\d+)"
    r"|[A-Z](?![#\[+-]|(?:ABS|ACOS|ASIN|ATAN|COS|EXISTS|EXP|FIX|FUP|LN|ROUND|SIN|SQRT|TAN)\[)"
)
_ORDER = re.compile(r"M0*(2|30|98|99)(?![\d.])")
_SAYS_NOTHING = re.compile(r"[\x01/%]*(?:N\d+)?\x01*(?:M0*(?:2|30))?\x01*")
_NUMBERED = re.compile(r"[Oo]?(\d+)")
_TESTED = ("IF", "ELSEIF", "WHILE", "REPEAT")
_OPENED_BY = {
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


def is_controlled(source: Source) -> bool:
    """Return whether the lines of a program are executed in another order than they stand, or hold expressions."""
    code = source.code
    if b"#" in code or b"[" in code or _CALLS.search(code) is not None:
        return True
    return b"O" in code and _O_WORD.search(code) is not None


class Block(Struct, frozen=True):
    """A line whose words are known when it is executed.

    :param settings: parameters that the line sets, when all its values are known.
    :param parts: text, or a letter with the value behind it.
    """

    settings: tuple[tuple[Callable[[Parameters], Key], Value], ...]
    parts: tuple[str | tuple[str, Value], ...]

    def text(self, known: Parameters) -> str:
        """Execute what concerns parameters, and return the line with numbers alone.

        :raises BlockError: a value is not known.
        """
        text = "".join([part if isinstance(part, str) else _word(part[0], part[1](known)) for part in self.parts])
        if self.settings:
            for key, value in [(key(known), value(known)) for key, value in self.settings]:
                known.put(key, value)
        return text


class Order(Struct, frozen=True):
    """A line with an O-word.

    :param keyword: ``SUB``, ``CALL`` …; empty for a number alone.
    :param label: its name; of a call perhaps one to be worked out.
    :param values: the condition or number; arguments of a call; what a subprogram returns.
    """

    keyword: str
    label: str | Value
    values: tuple[Value, ...] = ()


class Unit(Struct, eq=False):
    """A file as a control executes it.

    :ivar notable: rows at which the order of execution or parameters matter, ascending.
    :ivar following: (L + 1,) the next such row, from each row on; L where there is none.
    :ivar subs: label of each subprogram, of LinuxCNC's kind, to its row; `numbers`: of Fanuc's.
    :ivar links: row of an O-word → rows of the structure that it belongs to, first to last.
    :ivar faults: what is wrong with its O-words.
    """

    document: Document
    source: Source
    lines: dict[int, Order | Block | None] = {}
    following: list[int] = []
    subs: dict[str, int] = {}
    numbers: dict[str, int] = {}
    links: dict[int, tuple[int, ...]] = {}
    faults: list[Fault] = []

    @classmethod
    def of(cls, document: Document, source: Source) -> Unit:
        """Look through a file."""
        unit = cls(document, source)
        at = np.array([match.start() for match in _NOTABLE.finditer(source.code)], dtype=np.int64)
        notable = distinct(np.searchsorted(source.ends, at) - 1)
        rows = np.append(notable, len(source))
        unit.following = rows[np.searchsorted(notable, np.arange(len(source) + 1))].tolist()
        unit._connect(notable)
        return unit

    def at(self, row: int) -> Order | Block | None:
        """Return what a notable row says; None: it opens or closes the tape (%).

        :raises BlockError: it cannot be read.
        """
        if row not in self.lines:
            self.lines[row] = _read(self.source.line(row).replace(MARK, ""))
        return self.lines[row]

    def only_defines(self) -> str | None:
        """Return the name of the subprogram that this file is, where it does nothing but define some; else None.

        LinuxCNC's kind: nothing stands outside of SUB … ENDSUB. Fanuc's kind ends with M99, and is called by number.
        """
        inside = np.zeros(len(self.source), dtype=np.bool_)
        for first in self.subs.values():
            inside[first : self.links.get(first, (first,))[-1] + 1] = True
        outside = np.flatnonzero(~inside).tolist()
        if self.subs and all(_SAYS_NOTHING.fullmatch(self.source.line(row)) for row in outside):
            return f"O<{next(iter(self.subs))}>"
        number = _NUMBERED.fullmatch(self.document.name.partition(".")[0])
        if number:
            ends = {end for row in outside if self.following[row] == row for end in ordered(self.source.line(row))}
            return f"O{int(number[1])}" if "99" in ends and not ends & {"2", "30"} else None
        return None

    def _connect(self, notable: Ints) -> None:
        """Find which O-words belong together."""
        open_: list[tuple[str, str, list[int]]] = []
        for row, order in self._orders(notable):
            label, keyword = str(order.label), order.keyword
            if keyword == "":
                self.numbers.setdefault(label, row)
            elif keyword == "SUB":
                if label in self.subs or any(word == "SUB" for word, *_ in open_):
                    problem = "a second subprogram of this name" if label in self.subs else "a subprogram in another"
                    self.faults.append(Fault(row, f"O{label} SUB: {problem}"))
                self.subs.setdefault(label, row)
            own = [at for at, (word, name, _) in enumerate(open_) if name == label and word != "SUB"]
            if keyword == "WHILE" and own and open_[own[-1]][0] == "DO":
                self._close(row, open_, own[-1])
            elif keyword in ("SUB", "IF", "WHILE", "DO", "REPEAT"):
                open_.append((keyword, label, [row]))
            elif keyword in _OPENED_BY:
                wanted = _OPENED_BY[keyword]
                fits = [
                    n
                    for n, (word, name, _) in enumerate(open_)
                    if word in wanted and (name == label or keyword == "RETURN")
                ]
                at = fits[-1] if fits else -1
                if at < 0:
                    self.faults.append(
                        Fault(row, f"O{label} {keyword} without O{label} {' or '.join(wanted)} before it")
                    )
                elif keyword in ("ELSEIF", "ELSE"):
                    open_[at][2].append(row)
                elif keyword.startswith("END"):
                    self._close(row, open_, at)
                elif keyword != "RETURN":
                    self.links[row] = (open_[at][2][0],)
        for keyword, label, rows in open_:
            self.faults.append(Fault(rows[0], f"O{label} {keyword} without its end"))
        for row, (opening,) in [(row, link) for row, link in self.links.items() if len(link) == 1]:
            self.links[row] = self.links.get(opening, (row, row))

    def _close(self, row: int, open_: list[tuple[str, str, list[int]]], at: int) -> None:
        for keyword, label, rows in open_[at + 1 :]:
            self.faults.append(Fault(rows[0], f"O{label} {keyword} without its end"))
        link = (*open_[at][2], row)
        self.links.update(dict.fromkeys(link, link))
        del open_[at:]

    def _orders(self, notable: Ints) -> Iterator[tuple[int, Order]]:
        for row in notable.tolist():
            if "O" in self.source.line(row):
                try:
                    order = self.at(row)
                except BlockError:
                    continue  # told when it is executed
                if isinstance(order, Order):
                    yield row, order


def _read(code: str) -> Order | Block | None:
    if code.startswith("%"):
        return None
    head = _HEAD.match(code)
    return _block(code) if head is None else _order(code, head.end())


def _order(code: str, at: int) -> Order:
    reader = Reader(code, at)
    name = _LABEL.match(code, at)
    label: str | Value
    if name is not None:
        reader.at = name.end()
        label = key_of(name[1]) if name[1] else str(int(name[2]))
    else:
        label = reader.value()
    keyword = _KEYWORD.match(code, reader.at)
    if keyword is None:
        raise BlockError("an O word amid other words", "An O number stands alone in its line.")
    reader.at = keyword.end()
    if not isinstance(label, str) and keyword[0] != "CALL":
        raise BlockError(f"O with a computed name before {keyword[0] or 'the end of the line'}", "Only CALL takes one.")
    values: list[Value] = []
    while reader.at < len(code):
        values.append(reader.expression())
    least, most = {"CALL": (0, ARGUMENTS), "RETURN": (0, 1), "ENDSUB": (0, 1)}.get(keyword[0], (0, 0))
    if keyword[0] in _TESTED:
        least = most = 1
    if not least <= len(values) <= most:
        problem = "too many values" if len(values) > most else "a value in [ ] is missing"
        raise BlockError(f"{keyword[0] or 'O number'}: {problem}", None)
    return Order(keyword[0], label, tuple(values))


def _block(code: str) -> Block:
    settings: list[tuple[Callable[[Parameters], Key], Value]] = []
    parts: list[str | tuple[str, Value]] = []
    reader = Reader(code)
    while reader.at < len(code):
        if code[reader.at] == "#":
            key = reader.parameter()
            if not code.startswith("=", reader.at):
                raise BlockError("a parameter without a word before it", "Write #1=… to set it, X#1 to use it.")
            reader.at += 1
            settings.append((key, reader.value()))
            continue
        literal = _LITERAL.match(code, reader.at)
        if literal is not None:
            parts.append(literal[0])
            reader.at = literal.end()
        elif code[reader.at] == "[":
            raise BlockError("an expression without a word before it", None)
        else:
            letter = code[reader.at]
            reader.at += 1
            parts.append((letter, reader.value()))
    return Block(tuple(settings), tuple(parts))


def _word(letter: str, value: float) -> str:
    """Return a word with a number that was worked out; codes and counts are taken for whole as rs274 does it."""
    if letter in "MNTLDHO":
        return f"{letter}{whole(value)}"
    if letter == "G":
        return f"G{whole(10.0 * value) / 10.0:g}"
    return letter + number(value)


def number(value: float) -> str:
    """Return a number as G-code writes it, to more digits than any control resolves."""
    text = f"{value:.8f}" if abs(value) >= 1.0 else f"{value:.12f}"
    return text.rstrip("0").rstrip(".") or "0"


def ordered(text: str) -> Mapping[str, str]:
    """Return the M2, M30, M98 and M99 in a line of plain words: number → the text of the word."""
    return {match[1]: match[0] for match in _ORDER.finditer(text)}
