"""What differs, as the user is told it: where it is first, and how often."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from postproc.comparison.result import Comparison, Difference
from postproc.program import Ints, Program


def place_of(program: Program, row: int) -> tuple[str, int]:
    """Return the file and its line where a motion stands."""
    return program.places(np.array([row])).of(0)


def of_line(program: Program, line: int | None) -> tuple[str, int] | None:
    """Return the file and its line that a line of a reader's issue is, as far as motions tell."""
    if line is None:
        return None
    rows = np.flatnonzero(program.motions.line == line)
    return place_of(program, rows[0]) if len(rows) else (program.documents[0].name, line)


def here(
    kind: str, message: str, nominal: tuple[str, int] | None, corrected: tuple[str, int] | None, count: int = 1
) -> Difference:
    """Return a difference at a place of each program, or of one."""
    return Difference("warning", kind, message, nominal, corrected, count)


def at_rows(found: Comparison, kind: str, message: str, rows: Sequence[int], count: int) -> Difference:
    """Return a difference at a motion of each program; −1 where one has none."""
    one, other = (
        None if row < 0 else place_of(program, row)
        for program, row in zip((found.nominal, found.corrected), rows, strict=True)
    )
    return here(kind, message, one, other, count)


def at_pairs(found: Comparison, kind: str, message: str, pairs: Ints) -> Difference:
    """Return a difference at pairs (n,), the first of which is named."""
    return at_rows(found, kind, message, found.pair[pairs[0]].tolist(), len(pairs))
