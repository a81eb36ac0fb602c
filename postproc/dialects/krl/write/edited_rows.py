"""Edits of an execution trace, by its rows: which rows read alike, and how many lines each is written as.

Only rows that are edited are written, each from the line of its file.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.write.edits import Replacements
from postproc.dialects.text import line_spans
from postproc.program import Ints


class EditedRows(Struct, frozen=True, eq=False):
    """The rows of a trace as they are written.

    :ivar rows: (E,) rows that are written otherwise than their lines in the files, in order.
    :ivar texts: what they are written as.
    :ivar keys: (L,) number of the text of each row, 0 where it is that of its line: rows of one line are written alike
        if and only if their numbers are equal.
    :ivar begins: (L + 1,) number of lines that are written for the rows before each, and for all.
    """

    rows: Ints
    texts: tuple[str, ...]
    keys: list[int]
    begins: Ints


def edited_rows(trace: Trace, edits: Replacements) -> EditedRows:
    """Return the rows of a trace after edits; each edit is within one row."""
    rows = edits.rows()
    pieces = [line_text(*trace.place(row)) for row in rows.tolist()]
    begins = np.append(0, np.cumsum([len(piece) for piece in pieces], dtype=np.int64))
    shift = begins[:-1] - trace.starts(rows)
    texts: list[str] = []
    if len(rows):
        row_edits = edits.shifted(lambda pieces: shift[np.searchsorted(rows, pieces)])
        text, bounds = row_edits.apply("".join(pieces)), row_edits.new_offsets(begins)
        texts = [text[start:stop] for start, stop in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True)]
    indices = [
        index for index, (new_text, old_text) in enumerate(zip(texts, pieces, strict=True)) if new_text != old_text
    ]
    texts = [texts[index] for index in indices]
    rows = rows[indices]
    numbers: dict[str, int] = {}
    keys = np.zeros(len(trace), dtype=np.int64)
    keys[rows - 1] = [numbers.setdefault(text, len(numbers) + 1) for text in texts]
    count = np.ones(len(trace), dtype=np.int64)
    count[rows - 1] = [line_count(text) for text in texts]
    return EditedRows(rows, tuple(texts), keys.tolist(), np.append(0, np.cumsum(count)))


def line_text(source: Source, first: int, last: int = 0) -> str:
    """Return a 1-based line of a file with its line end; with `last`, the lines first … last."""
    last = last or first
    if last < first:
        return ""
    stop = int(source.starts[last]) if last < len(source.starts) else len(source.text)
    return source.text[int(source.starts[first - 1]) : stop]


def line_count(text: str) -> int:
    """Return how many lines a text has."""
    if text.endswith("\n") and text.count("\r") in (0, text.count("\r\n")):
        return text.count("\n")  # counted much faster
    return len(line_spans(text)[0]) if text else 0
