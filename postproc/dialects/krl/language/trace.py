"""The execution trace as rows: which line of which file runs first, second, third …"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.chunks import compact
from postproc.dialects.krl.language.source import Place, Source
from postproc.errors import ProgramError
from postproc.program import Bools, Ints


class Trace(Struct, frozen=True, eq=False):
    """The L rows of an execution trace; row n, from 1, is one line of a file.

    It has no text: offsets are always those of the file of a row.

    :param sources: the files, that of the program first.
    :param file: (L,) number in `sources`.
    :param line: (L,) 1-based line of that file.
    :param shown: (L,) line of the program's own `.src` to report for the row: that of the call for lines of other
        files.
    :param is_count: (L,) True for rows that assign a number to the counter of a FOR, and are in no file: `line` is that
        of FOR.
    :param is_file: whether the trace is the `.src`, line by line.
    """

    sources: tuple[Source, ...]
    file: Ints
    line: Ints
    shown: Ints
    is_count: Bools
    is_file: bool = False

    @classmethod
    def of(cls, source: Source) -> Trace:
        """Return the trace of a program whose lines run one after the other."""
        count = len(source.starts)
        line = compact(np.arange(1, count + 1), np.int32)
        file, is_count = np.broadcast_to(np.int64(0), (count,)), np.broadcast_to(np.False_, (count,))
        return cls((source,), file, line, line, is_count, is_file=True)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.line)

    def source(self, row: int) -> Source:
        """Return the file of a row."""
        return self.sources[self.file.item(row - 1)]

    def place(self, row: int) -> Place:
        """Return the file and the line in it that a row of the trace stands for."""
        return Place(self.source(row), self.line.item(row - 1))

    def starts(self, rows: Ints) -> Ints:
        """Return the offsets (n,) at which the lines of n rows begin in their files."""
        file, line = self.file[rows - 1], self.line[rows - 1]
        starts = np.zeros(len(rows), dtype=np.int64)
        for number, source in enumerate(self.sources):
            in_file = file == number
            starts[in_file] = source.starts[line[in_file] - 1]
        return starts

    def shown_line(self, row: int) -> int:
        """Return the line of the program's own `.src` to report for a row."""
        return self.shown.item(row - 1)

    def error(self, problem: str, row: int, advice: str | None = None) -> ProgramError:
        """Return an error about a row; it names the file, the line and its text."""
        return self.place(row).error(problem, advice)
