"""Edits of an execution trace by its rows: the new text of each row, and how many lines it has.

Only edited rows have a text; all other rows are the lines of their files.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.write.edits import Replacements
from postproc.dialects.text import line_spans
from postproc.program import Ints


class EditedRows(Struct, frozen=True, eq=False):
    """The rows of a trace as they are written.

    :ivar rows: (E,) rows whose new text differs from their lines in the files, ascending, from 1.
    :ivar texts: new text of each, with line end.
    :ivar keys: (L,) number of the new text of each row; 0 for unchanged rows. Rows of one line are equal if and only if
        their numbers are equal.
    :ivar begins: (L + 1,) number of lines that are written for the rows before each row, and finally for all rows.
    """

    rows: Ints
    texts: tuple[str, ...]
    keys: list[int]
    begins: Ints


def edited_rows(trace: Trace, edits: Replacements) -> EditedRows:
    """Return the rows of a trace after edits; each edit must be within one row."""
    rows = edits.rows()
    old_texts = [line_text(*trace.place(row)) for row in rows.tolist()]
    new_texts = _edited_texts(trace, rows, old_texts, edits)
    changed_indices = [
        index
        for index, (new_text, old_text) in enumerate(zip(new_texts, old_texts, strict=True))
        if new_text != old_text
    ]
    rows, texts = rows[changed_indices], [new_texts[index] for index in changed_indices]
    numbers: dict[str, int] = {}  # new text → its number
    keys = np.zeros(len(trace), dtype=np.int64)
    keys[rows - 1] = [numbers.setdefault(text, len(numbers) + 1) for text in texts]  # rows count from 1
    line_counts = np.ones(len(trace), dtype=np.int64)
    line_counts[rows - 1] = [line_count(text) for text in texts]
    return EditedRows(rows, tuple(texts), keys.tolist(), np.append(0, np.cumsum(line_counts)))


def _edited_texts(trace: Trace, rows: Ints, old_texts: Sequence[str], edits: Replacements) -> list[str]:
    """Return the new texts of rows of a trace, with their line ends.

    The old texts are joined, edited as one text, and separated again.

    :param rows: (E,) rows that have edits, ascending.
    :param old_texts: texts of their lines in the files.
    """
    if not len(rows):
        return []
    begins = np.append(0, np.cumsum([len(text) for text in old_texts], dtype=np.int64))
    shift = begins[:-1] - trace.starts(rows)  # from offsets in the file of each row to offsets in the joined text
    joined_edits = edits.shifted(lambda edit_rows: shift[np.searchsorted(rows, edit_rows)])
    text, bounds = joined_edits.apply("".join(old_texts)), joined_edits.new_offsets(begins).tolist()
    return [text[start:stop] for start, stop in pairwise(bounds)]


def line_text(source: Source, line: int) -> str:
    """Return a 1-based line of a file with its line end."""
    return source.lines_text(line, line)


def line_count(text: str) -> int:
    """Return the number of lines of a text."""
    if text.endswith("\n") and text.count("\r") in (0, text.count("\r\n")):
        return text.count("\n")  # only LF or only CR LF: much faster
    return len(line_spans(text)[0]) if text else 0
