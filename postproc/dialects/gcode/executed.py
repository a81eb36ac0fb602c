"""A program as it is executed: its lines in order, each as often as it is executed, put together from pieces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.dialects.gcode.blocks import Fault
from postproc.dialects.gcode.control import Unit
from postproc.dialects.gcode.words import Source
from postproc.program import Document, Ints


class Executed(Struct, frozen=True, eq=False):
    """A program as it is executed.

    :param source: its lines in order, each as often as it is executed.
    :param documents: the files that they stand in, the program first.
    :param document: (L,) which of these each line stands in.
    :param line: (L,) its 1-based line there.
    :param main: (L,) its line in the program itself: for one of another file, that of the call.
    :param faults: why it could not be executed (further), in rows of `source`.
    :param behind: lines of the program behind its end that hold coordinates and are never executed; `source` may have
        others.
    """

    source: Source
    documents: tuple[Document, ...]
    document: Ints
    line: Ints
    main: Ints
    faults: tuple[Fault, ...] = ()
    behind: tuple[int, ...] = ()


class Piece(NamedTuple):
    """Lines `first` to `last` (exclusive) of a file; `text` if one that is executed with other words than it has."""

    unit: int
    first: int
    last: int
    main: int
    text: str | None = None


def put_together(units: Sequence[Unit], pieces: Sequence[Piece], faults: Sequence[Fault], end: int) -> Executed:
    """Return pieces, in the order in which they are executed, as one program.

    :param units: the files that they are of.
    :param end: row of the first of them at which the program ends.
    """
    code = b"\n" + b"".join(_bytes(units, pieces))
    unit, first, last, main = np.array([piece[:4] for piece in pieces], dtype=np.int64).reshape(-1, 4).T
    count = last - first
    row = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)
    document, main = np.repeat(unit, count), np.repeat(main, count)
    comments, rows = _comments(units, document, row)
    ends = np.flatnonzero(np.frombuffer(code, dtype=np.uint8) == ord("\n"))
    source, line = Source(code, ends, comments, rows + 1), row + 1
    documents = tuple(unit.document for unit in units)
    behind = np.setdiff1d(units[0].source.coordinates(end), row[document == 0]) + 1
    main = np.where(main < 0, line, main + 1)
    return Executed(source, documents, document, line, main, tuple(faults), tuple(behind.tolist()))


def _bytes(units: Sequence[Unit], pieces: Sequence[Piece]) -> Iterator[bytes]:
    sources = [(unit.source.code, unit.source.ends.tolist()) for unit in units]
    for piece in pieces:
        if piece.text is not None:
            yield piece.text.encode("ascii") + b"\n"
        else:
            code, ends = sources[piece.unit]
            yield code[ends[piece.first] + 1 : ends[piece.last] + 1]


def _comments(units: Sequence[Unit], document: Ints, row: Ints) -> tuple[tuple[str, ...], Ints]:
    """Return the comments of the lines executed, and the row of each."""
    texts: list[str] = []
    at: list[Ints] = []
    index: list[Ints] = []
    for n, unit in enumerate(units):
        rows = np.flatnonzero(document == n)
        lines = unit.source.comment_lines - 1
        begin, stop = np.searchsorted(lines, row[rows], "left"), np.searchsorted(lines, row[rows], "right")
        count = stop - begin
        at.append(np.repeat(rows, count))
        index.append(len(texts) + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - begin, count))
        texts += unit.source.comments
    order = np.argsort(np.concatenate(at), kind="stable")
    chosen = np.concatenate(index)[order].tolist()
    return tuple(texts[n] for n in chosen), np.concatenate(at)[order]
