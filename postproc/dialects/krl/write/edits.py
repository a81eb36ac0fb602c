"""Edits of files: pieces replaced, lines inserted; all other text is unchanged to the byte."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc.chunks import compact, ragged_range
from postproc.decimals import Bytes, fixed_point_text
from postproc.dialects.krl.language.trace import Trace
from postproc.frames import Array
from postproc.program import Ints, distinct

Codes: TypeAlias = NDArray[np.uint8] | NDArray[np.uint32]
_PIECES = 1 << 16
"""Number of pieces that are replaced at once."""


class _Pieces(NamedTuple):
    """N pieces of a text that are replaced: first the pieces of `add_numbers`, then those of `add`.

    :ivar starts: (N,) offsets of the pieces; `stops` (N,) the offsets behind them.
    :ivar lengths: (N,) numbers of characters of the new texts.
    """

    starts: Ints
    stops: Ints
    lengths: Ints


class Replacements(Struct, eq=False):
    """Pieces of a text to be replaced, in any order; they must not overlap.

    Insertions at one offset keep the order in which they were added. In an execution trace (the lines of a program in
    execution order), a piece is within the line of one row, and its offsets count in the file of this row; in a plain
    text, the row is 0.

    The first five fields have one array for each number of decimals in each call of `add_numbers`.

    :ivar _starts: offsets of the replaced numbers; `_stops` the offsets behind them.
    :ivar _lengths: numbers of characters of the new numbers; `_numbers` these characters, one after the other.
    :ivar _rows: rows of the trace that contain the numbers.
    :ivar _text_pieces: start, stop and new text of each piece of `add`; `_text_rows` the rows that contain them.
    """

    _starts: list[Ints] = []
    _stops: list[Ints] = []
    _lengths: list[Ints] = []
    _numbers: list[Bytes] = []
    _rows: list[Ints] = []
    _text_pieces: list[tuple[int, int, str]] = []
    _text_rows: list[int] = []

    def add(self, start: int, stop: int, text: str, row: int = 0) -> None:
        """Add the replacement of ``text[start:stop]`` by another text; ``start == stop`` inserts.

        :param row: row of the execution trace (line in execution order) that contains the piece; 0 in a plain text.
        """
        self._text_pieces.append((start, stop, text))
        self._text_rows.append(row)

    def add_numbers(self, starts: Ints, stops: Ints, values: Array, decimals: Ints, rows: Ints) -> None:
        """Add the replacements of n pieces by numbers in fixed-point notation.

        :param starts: (n,) offsets of the pieces; `stops` (n,) the offsets behind them.
        :param values: (n,) the numbers.
        :param decimals: (n,) number of decimals of each.
        :param rows: (n,) rows of the execution trace (lines in execution order) with the pieces; 0 in a plain text.
        """
        for decimal_count in distinct(decimals).tolist():
            pieces = np.flatnonzero(decimals == decimal_count)
            digits = fixed_point_text(values[pieces], decimal_count)
            has_digit = digits != 0  # shorter numbers are padded with zero bytes
            self._starts.append(compact(starts[pieces], np.int32))
            self._stops.append(compact(stops[pieces], np.int32))
            self._rows.append(compact(rows[pieces], np.int32))
            self._lengths.append(has_digit.sum(axis=1, dtype=np.int32))
            self._numbers.append(digits[has_digit])

    def rows(self) -> Ints:
        """Return the rows (n,) of the execution trace that have pieces to be replaced, ascending, each once."""
        return distinct(np.concatenate([*self._rows, np.array(self._text_rows, dtype=np.int64)]))

    def shifted(self, shifts: Callable[[Ints], Ints]) -> Replacements:
        """Return these replacements for a text in which the lines of the rows follow each other.

        :param shifts: rows (n,) → what is added (n,) to offsets in their files, to get offsets in this text.
        """
        row_shifts = [shifts(rows) for rows in self._rows]
        starts = [start + shift for start, shift in zip(self._starts, row_shifts, strict=True)]
        stops = [stop + shift for stop, shift in zip(self._stops, row_shifts, strict=True)]
        text_shifts = shifts(np.array(self._text_rows, dtype=np.int64)).tolist()
        text_pieces = [
            (start + shift, stop + shift, text)
            for shift, (start, stop, text) in zip(text_shifts, self._text_pieces, strict=True)
        ]
        return replace(self, _starts=starts, _stops=stops, _text_pieces=text_pieces)

    def __bool__(self) -> bool:
        """Return whether there is a piece to replace."""
        return bool(self._text_pieces or self._starts)

    def new_offsets(self, offsets: Ints) -> Ints:
        """Return the offsets (n,) after all replacements; text inserted at an offset is behind it.

        :param offsets: (n,) offsets in the old text that are not inside a piece.
        """
        starts, stops, lengths = self._pieces()
        order = np.argsort(starts, kind="stable")
        growth = (lengths - (stops - starts))[order]  # of the text by each replacement
        preceding_growth = np.append(0, np.cumsum(growth, dtype=np.int64))  # of the pieces before each, then of all
        # left: a piece that begins at an offset does not precede it
        return np.asarray(offsets + preceding_growth[np.searchsorted(starts[order], offsets, side="left")])

    def _pieces(self) -> _Pieces:
        """Return all pieces: those of `add_numbers`, then those of `add`, in the order in which they were added."""
        text_pieces = np.array([(start, stop, len(text)) for start, stop, text in self._text_pieces], dtype=np.int32)
        # reshape: `text_pieces` may be empty
        starts, stops, lengths = text_pieces.reshape(-1, 3).T
        return _Pieces(
            np.concatenate([*self._starts, starts]),
            np.concatenate([*self._stops, stops]),
            np.concatenate([*self._lengths, lengths]),
        )

    def apply(self, text: str, count: int = _PIECES) -> str:
        """Return the text with all pieces replaced.

        :param count: number of pieces that are replaced at once; it limits the memory.
        """
        if not self:
            return text
        inserted_text = "".join(piece for _, _, piece in self._text_pieces)
        is_ascii = text.isascii() and inserted_text.isascii()
        starts, stops, lengths = self._pieces()
        new_codes = np.concatenate([*self._numbers, _codes(inserted_text, is_ascii)])
        # offset of the text of each piece in `new_codes`
        first_codes = np.cumsum(lengths, dtype=np.int64) - lengths
        order = np.lexsort((stops, starts))  # an insertion precedes a piece that begins at its offset
        texts, copied_to = [], 0
        for first in range(0, len(order), count):
            pieces = order[first : first + count]
            end = int(stops[pieces[-1]])
            codes = _replace_pieces(
                _codes(text[copied_to:end], is_ascii),
                starts[pieces] - copied_to,
                stops[pieces] - copied_to,
                new_codes,
                first_codes[pieces],
                lengths[pieces],
            )
            texts.append(codes.tobytes().decode("ascii" if is_ascii else "utf-32-le"))
            copied_to = end
        return "".join([*texts, text[copied_to:]])


def _codes(text: str, is_ascii: bool) -> Codes:
    """Return the code of each character of a text: bytes for ASCII, else 32-bit code points."""
    if is_ascii:
        return np.frombuffer(text.encode("ascii"), dtype=np.uint8)
    return np.frombuffer(text.encode("utf-32-le"), dtype="<u4")


def _replace_pieces(text: Codes, starts: Ints, stops: Ints, pieces: Codes, begin: Ints, length: Ints) -> Codes:
    """Return a text up to its last replaced piece, with new pieces in place of ``text[starts:stops]``.

    :param starts: (n,) offsets of the replaced pieces in the text, ascending; `stops` (n,) the offsets behind them.
    :param pieces: characters of the new pieces; piece i is ``pieces[begin[i] : begin[i] + length[i]]``.
    :param begin: (n,) offsets in `pieces`; `length` (n,) numbers of characters.
    """
    # the result alternates between runs of old characters (even) and of new ones (odd): first offset and length of each
    first = np.empty(2 * len(starts), dtype=np.int64)
    count = np.empty_like(first)
    first[0::2] = np.append(0, stops[:-1])
    count[0::2] = starts - first[0::2]
    first[1::2], count[1::2] = begin, length
    is_new = np.repeat(np.arange(len(first)) % 2 == 1, count)
    offset = ragged_range(count, first)  # of each character of the result: in `text`, or in `pieces` if it is new
    codes = np.empty(len(offset), dtype=text.dtype)
    codes[~is_new], codes[is_new] = text[offset[~is_new]], pieces[offset[is_new]]
    return codes


class InsertedLines(Struct, eq=False):
    """Collects lines that are inserted into an execution trace, the lines of a program in execution order, or removed.

    Rows of the trace count from 1.

    :ivar replacements: gets the insertions and removals.
    :ivar _insertion_rows: for each inserted line, the row before which it is inserted.
    :ivar _inserted_targets: the target on each inserted line; −1 for none.
    :ivar _removed_rows: rows whose lines are removed.
    """

    trace: Trace
    replacements: Replacements
    _insertion_rows: list[int] = []
    _inserted_targets: list[int] = []
    _removed_rows: list[int] = []

    def add(self, next_row: int, text: str, target: int = -1) -> None:
        """Insert a text with its line end before a row of the trace, behind texts that are already inserted there.

        :param target: index of the target on the new line; −1 if there is none.
        """
        source, line = self.trace.place(next_row)
        offset = source.starts.item(line - 1)
        self.replacements.add(offset, offset, text, next_row)
        self._insertion_rows.append(next_row)
        self._inserted_targets.append(target)

    def insert_behind(self, row: int, text: str) -> None:
        """Insert a text without line end as a line behind a row of the trace.

        It precedes texts that `add` inserts before the next row. The line end of the row is repeated.
        """
        source, line = self.trace.place(row)
        stop = source.stops.item(line - 1)
        line_end = source.text[
            stop : source.starts[line]
        ]  # `line` counts from 1: starts[line] is that of the next line
        self.replacements.add(stop, stop, line_end + text, row)
        self._insertion_rows.append(row + 1)
        self._inserted_targets.append(-1)

    def move_line(self, row: int, next_row: int, text: str) -> None:
        """Remove the line of a row of the trace, and insert a text with its line end before row `next_row`."""
        source, line = self.trace.place(row)
        self.replacements.add(source.starts.item(line - 1), source.starts.item(line), "", row)
        self._removed_rows.append(row)
        self.add(next_row, text)

    def output_lines(self, rows: Ints) -> Ints:
        """Return the lines (K,) of K targets in the trace as it is written, with inserted and without removed lines.

        A line moves down by the number of lines inserted before it, and up by the number of lines removed before it.

        :param rows: (K,) rows on which the targets were; for inserted targets any number, which is replaced.
        """
        order = np.argsort(self._insertion_rows, kind="stable")
        insertion_rows = np.array(self._insertion_rows, dtype=np.int64)[order]
        inserted_targets = np.array(self._inserted_targets, dtype=np.int64)[order]
        removed_rows = np.sort(np.array(self._removed_rows, dtype=np.int64))
        # an insertion before a row moves the row itself: side="right"
        output_line = rows + np.searchsorted(insertion_rows, rows, side="right") - np.searchsorted(removed_rows, rows)
        # insertions are sorted: insertion n, from 0, has n inserted lines before it
        insertions = np.flatnonzero(inserted_targets >= 0)
        next_rows = insertion_rows[insertions]
        output_line[inserted_targets[insertions]] = next_rows + insertions - np.searchsorted(removed_rows, next_rows)
        return np.asarray(output_line)
