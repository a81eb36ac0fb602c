"""The execution trace: the lines of files in execution order, loops unrolled and called routines inlined."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.chunks import compact
from postproc.dialects.krl.language.source import Place, Source
from postproc.errors import ProgramError
from postproc.program import Bools, Ints


class Trace(Struct, frozen=True, eq=False):
    """The lines of a program in execution order: a line that runs three times has three rows. Rows count from 1.

    A trace has no text of its own: each row names a line of a file, and offsets count in this file.

    :param sources: the files, first the `.src` of the program.
    :param file: (L,) index in `sources`.
    :param line: (L,) 1-based line of this file.
    :param reported_lines: (L,) line of the program's own `.src` to report for the row; for rows in other files, the
        line of the call.
    :param is_counter_row: (L,) True for rows that assign a number to the counter of a FOR. They are in no file; their
        `line` is that of FOR.
    :param is_file: True if the trace is the `.src` itself, line by line.
    """

    sources: tuple[Source, ...]
    file: Ints
    line: Ints
    reported_lines: Ints
    is_counter_row: Bools
    is_file: bool = False

    @classmethod
    def of(cls, source: Source) -> Trace:
        """Return the trace of a program whose lines run one after the other: its rows are the lines of the file."""
        count = len(source.starts)
        line = compact(np.arange(1, count + 1), np.int32)
        return cls(
            sources=(source,),
            file=np.broadcast_to(np.int64(0), (count,)),  # all rows are in the first and only source
            line=line,
            reported_lines=line,
            is_counter_row=np.broadcast_to(np.False_, (count,)),
            is_file=True,
        )

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.line)

    def source(self, row: int) -> Source:
        """Return the file of a 1-based row."""
        return self.sources[self.file.item(row - 1)]

    def place(self, row: int) -> Place:
        """Return the file and the line of a 1-based row."""
        return Place(self.source(row), self.line.item(row - 1))

    def starts(self, rows: Ints) -> Ints:
        """Return the offsets (n,) [characters] at which the lines of 1-based rows (n,) begin in their files."""
        file, line = self.file[rows - 1], self.line[rows - 1]
        starts = np.zeros(len(rows), dtype=np.int64)
        for number, source in enumerate(self.sources):
            in_file = file == number
            starts[in_file] = source.starts[line[in_file] - 1]
        return starts

    def reported_line(self, row: int) -> int:
        """Return the line of the program's own `.src` to report for a 1-based row."""
        return self.reported_lines.item(row - 1)

    def error(self, problem: str, row: int, advice: str | None = None) -> ProgramError:
        """Return an error about a 1-based row that names the file, the line and its text."""
        return self.place(row).error(problem, advice)
