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

    Insertions at one offset keep the order in which they were added. In an execution trace, a piece is within the line
    of one row, and its offsets count in the file of this row; in a plain text, the row is 0.

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

        :param row: row of the execution trace that contains the piece; 0 in a plain text.
        """
        self._text_pieces.append((start, stop, text))
        self._text_rows.append(row)

    def add_numbers(self, starts: Ints, stops: Ints, values: Array, decimals: Ints, rows: Ints) -> None:
        """Add the replacements of n pieces by numbers in fixed-point notation.

        :param starts: (n,) offsets of the pieces; `stops` (n,) the offsets behind them.
        :param values: (n,) the numbers.
        :param decimals: (n,) number of decimals of each.
        :param rows: (n,) rows of the execution trace that contain the pieces; 0 in a plain text.
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
        """Return the rows (n,) that have pieces, ascending."""
        return distinct(np.concatenate([*self._rows, np.array(self._text_rows, dtype=np.int64)]))

    def shifted(self, shifts: Callable[[Ints], Ints]) -> Replacements:
        """Return these replacements for a text in which the lines of the rows follow each other.

        :param shifts: rows (n,) → distances (n,) from offsets in the files of the rows to offsets in this text.
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
        growth = (lengths - (stops - starts))[order]
        preceding_growth = np.append(0, np.cumsum(growth, dtype=np.int64))  # of the pieces before each, then of all
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

        :param count: number of pieces that are replaced at once.
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
    """Collects lines that are inserted and removed. Lines are given as 1-based rows of the trace.

    :ivar replacements: gets the insertions and removals.
    :ivar _insertion_lines: for each inserted line, the line before which it is inserted.
    :ivar _inserted_targets: the target on each inserted line; −1 for none.
    :ivar _removed_lines: lines that are removed.
    """

    trace: Trace
    replacements: Replacements
    _insertion_lines: list[int] = []
    _inserted_targets: list[int] = []
    _removed_lines: list[int] = []

    def add(self, next_line: int, text: str, target: int = -1) -> None:
        """Insert a text with its line end before a line, behind texts that are already inserted before it.

        :param target: index of the target on the new line; −1 if there is none.
        """
        source, line = self.trace.place(next_line)
        offset = source.starts.item(line - 1)
        self.replacements.add(offset, offset, text, next_line)
        self._insertion_lines.append(next_line)
        self._inserted_targets.append(target)

    def insert_behind(self, line: int, text: str) -> None:
        """Insert a text without line end as a line behind line `line`.

        It precedes texts that `add` inserts before the next line. The line end of `line` is repeated.
        """
        source, number = self.trace.place(line)
        stop = source.stops.item(number - 1)
        line_end = source.text[stop : source.starts[number]]  # `number` counts from 1: starts[number] is the next line
        self.replacements.add(stop, stop, line_end + text, line)
        self._insertion_lines.append(line + 1)
        self._inserted_targets.append(-1)

    def move_line(self, line: int, next_line: int, text: str) -> None:
        """Remove line `line`, and insert a text with its line end before line `next_line`."""
        source, number = self.trace.place(line)
        self.replacements.add(source.starts.item(number - 1), source.starts.item(number), "", line)
        self._removed_lines.append(line)
        self.add(next_line, text)

    def output_lines(self, line: Ints) -> Ints:
        """Return the lines (K,) of K targets in the written text.

        A line moves down by the number of lines inserted before it, and up by the number of lines removed before it.

        :param line: (K,) lines on which the targets were; for inserted targets any number, which is replaced.
        """
        order = np.argsort(self._insertion_lines, kind="stable")
        insertion_lines = np.array(self._insertion_lines, dtype=np.int64)[order]
        inserted_targets = np.array(self._inserted_targets, dtype=np.int64)[order]
        removed_lines = np.sort(np.array(self._removed_lines, dtype=np.int64))
        # an insertion before a line moves the line itself: side="right"
        output_line = line + np.searchsorted(insertion_lines, line, side="right") - np.searchsorted(removed_lines, line)
        # insertions are sorted: insertion n, from 0, has n inserted lines before it
        insertions = np.flatnonzero(inserted_targets >= 0)
        next_lines = insertion_lines[insertions]
        output_line[inserted_targets[insertions]] = next_lines + insertions - np.searchsorted(removed_lines, next_lines)
        return np.asarray(output_line)
