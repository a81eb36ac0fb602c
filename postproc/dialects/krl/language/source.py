"""One file of a KRL program with its lines: line numbers of offsets, code without comments, errors with their line."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.dialects.text import line_spans
from postproc.errors import ProgramError
from postproc.program import Document, Ints

MOST_CHARACTERS = 10_000
"""Characters of the longest statement that is read; controllers write up to 1000."""
SRC, DAT, OTHER_FILE = 0, 1, 2
"""`Source.index`: the `.src` of the program, its `.dat`, and any other file, such as the `$config.dat`."""
_BLANKS = " \t\r"
"""Blanks around code."""


class Source(Struct, frozen=True, eq=False):
    """A document and the offsets of its lines.

    :param document: the file.
    :param text: its content.
    :param index: `SRC`, `DAT` or `OTHER_FILE`.
    :param starts: (L,) offset of the first character of each line.
    :param stops: (L,) offset behind the last character of each line, without the line end.
    :param statements: 1-based line → parsed statement, filled by `parser.statement`.
    :param declared: offset of an initial value → parsed value, filled when it is first needed.
    """

    document: Document
    text: str
    index: int
    starts: Ints
    stops: Ints
    statements: dict[int, object] = {}
    declared: dict[int, object] = {}

    @classmethod
    def of(cls, document: Document, index: int) -> Source:
        """Return a document with its lines.

        :param index: `SRC`, `DAT` or `OTHER_FILE`.
        :raises ProgramError: the code of a line is longer than `MOST_CHARACTERS`.
        """
        starts, stops = line_spans(document.text)
        source = cls(document, document.text, index, starts, stops)
        # only a line that is too long with its comment can have code that is too long
        for line in (np.flatnonzero(stops - starts > MOST_CHARACTERS) + 1).tolist():  # lines count from 1
            start, stop = source.code_span(line)
            if stop - start > MOST_CHARACTERS:
                problem = f"the statement has {stop - start} characters, {MOST_CHARACTERS} are allowed"
                raise source.line_error(problem, line, "Write it as several statements.")
        return source

    def lines_text(self, first: int, last: int) -> str:
        """Return the 1-based lines first … last with their line ends; empty if `last` precedes `first`."""
        if last < first:
            return ""
        # `starts` counts from 0: starts[last] is the beginning of the line behind
        stop = self.starts.item(last) if last < len(self.starts) else len(self.text)
        return self.text[self.starts.item(first - 1) : stop]

    def place(self, line: int) -> Place:
        """Return a 1-based line as a place."""
        return Place(self, line)

    def line_at(self, offset: int) -> int:
        """Return the 1-based line that contains an offset."""
        return int(np.searchsorted(self.starts, offset, side="right"))  # number of lines that begin at or before it

    def line_at_each(self, offsets: Ints) -> Ints:
        """Return the 1-based line (n,) that contains each of `offsets` (n,), see `line_at`."""
        return np.searchsorted(self.starts, offsets, side="right")

    def code_span(self, line: int) -> tuple[int, int]:
        """Return the span of the code of a 1-based line, without its comment and the blanks around it.

        :returns: offset of its first character, and offset behind its last; equal for a line without code.
        """
        text, start, stop = self.text, self.starts.item(line - 1), self.stops.item(line - 1)
        if (
            start < stop
            and text[start] not in _BLANKS
            and text[stop - 1] not in _BLANKS
            and text.find(";", start, stop) < 0
        ):
            return start, stop  # most lines; this method is called several times for each
        return code_span(text, start, stop)

    def error(self, problem: str, offset: int, advice: str | None = None) -> ProgramError:
        """Return an error that names the file, the line that contains an offset, and the text of the line."""
        return self.line_error(problem, self.line_at(offset), advice)

    def line_error(self, problem: str, line: int, advice: str | None = None) -> ProgramError:
        """Return an error that names the file, a 1-based line, and the text of the line."""
        text = self.text[self.starts[line - 1] : self.stops[line - 1]]
        return ProgramError(problem, file=self.document.name, line=line, text=text, advice=advice)


class Place(NamedTuple):
    """A 1-based line of a file."""

    source: Source
    line: int

    def __str__(self) -> str:
        """Return the place for messages: ``line 12``, with the file if it is not the `.src` of the program."""
        return f"line {self.line}" if self.source.index == SRC else f"{self.source.document.name}, line {self.line}"

    def error(self, problem: str, advice: str | None = None) -> ProgramError:
        """Return an error that names the file, the line, and the text of the line."""
        return self.source.line_error(problem, self.line, advice)


def code_span(text: str, start: int, stop: int) -> tuple[int, int]:
    """Return the span of the code within a line, without its comment and the blanks around it.

    :param start: offset of the line; `stop` the offset of its end.
    :returns: offset of the first character of the code, and offset behind its last; equal without code.
    """
    stop = comment_start(text, start, stop)
    while start < stop and text[start] in _BLANKS:
        start += 1
    while stop > start and text[stop - 1] in _BLANKS:
        stop -= 1
    return start, stop


def comment_start(text: str, start: int, stop: int) -> int:
    """Return the offset of the first ``;`` of a line outside of strings: its comment; `stop` if there is none."""
    semicolon = text.find(";", start, stop)
    if semicolon < 0:
        return stop
    quote = text.find('"', start, semicolon)
    if quote < 0:
        return semicolon
    in_string = False
    for offset in range(quote, stop):
        if text[offset] == '"':
            in_string = not in_string
        elif text[offset] == ";" and not in_string:
            return offset
    return stop
