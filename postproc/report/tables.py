"""Tables of text, for a terminal."""

from __future__ import annotations

from collections.abc import Collection, Sequence


def table(head: Sequence[str], rows: Sequence[Sequence[str]], right: Collection[int] = (), indent: str = "") -> str:
    """Return a table as text, as wide as it needs to be.

    :param head: of each column.
    :param rows: cells of each row, as many as heads.
    :param right: columns whose cells end in line: numbers.
    :param indent: in front of each line.

    >>> print(table(("axis", "mm"), [("X", "1.5"), ("Y", "-12.0")], right=(1,)))
    axis     mm
    X       1.5
    Y     -12.0
    """
    cells = [tuple(head), *map(tuple, rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return "\n".join(
        indent
        + "  ".join(
            cell.rjust(width) if column in right else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    )
