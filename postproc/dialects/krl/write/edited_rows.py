"""Edits of an execution trace (lines in execution order) by its rows: the new text of each row, and its lines.

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
    """The L rows of a trace (lines of a program in execution order) as they are written.

    :ivar rows: (E,) rows whose new text differs from their lines in the files, ascending, from 1.
    :ivar texts: new text of each, with line end.
    :ivar text_numbers: (L,) number of the new text of each row; 0 for unchanged rows. Rows of one line are equal if and
        only if their numbers are equal.
    :ivar begins: (L + 1,) number of lines that are written for the rows before each row, and finally for all rows; row
        n, from 1, has the element n − 1.
    """

    rows: Ints
    texts: tuple[str, ...]
    text_numbers: list[int]
    begins: Ints


def edited_rows(trace: Trace, edits: Replacements) -> EditedRows:
    """Return the rows of a trace (lines in execution order) after edits; each edit must be within one row."""
    rows = edits.rows()
    old_texts = [line_text(*trace.place(row)) for row in rows.tolist()]
    new_texts = _edited_texts(trace, rows, old_texts, edits)
    changed_indices = [
        index
        for index, (new_text, old_text) in enumerate(zip(new_texts, old_texts, strict=True))
        if new_text != old_text
    ]
    rows, texts = rows[changed_indices], [new_texts[index] for index in changed_indices]
    number_of_text: dict[str, int] = {}
    text_numbers = np.zeros(len(trace), dtype=np.int64)  # 0: unchanged
    text_numbers[rows - 1] = [
        number_of_text.setdefault(text, len(number_of_text) + 1) for text in texts
    ]  # rows count from 1
    line_counts = np.ones(len(trace), dtype=np.int64)
    line_counts[rows - 1] = [line_count(text) for text in texts]
    begins = np.append(0, np.cumsum(line_counts))
    return EditedRows(rows, texts=tuple(texts), text_numbers=text_numbers.tolist(), begins=begins)


def _edited_texts(trace: Trace, rows: Ints, old_texts: Sequence[str], edits: Replacements) -> list[str]:
    """Return the new texts of rows of a trace (lines in execution order), with their line ends.

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
    """Return the number of lines of a text, the last of which may have no line end."""
    if text.endswith("\n") and text.count("\r") in (0, text.count("\r\n")):
        return text.count("\n")  # only LF or only CR LF: much faster
    return len(line_spans(text)[0]) if text else 0
